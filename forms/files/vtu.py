# SPDX-License-Identifier: MIT
"""VTU files of each step and a PVD file that lists them. Collective, on any number of ranks."""

from __future__ import annotations

from base64 import b64encode
from pathlib import Path as FilePath
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
from dolfinx import fem
from numpy.typing import NDArray

from .._parallel import on_rank_zero
from .._types import Expr
from ..paths import Path
from .nodes import Grid, Nodes, grid, values

# VTK's cells of arbitrary order by their quadratic ones, of the same nodes in the same order:
# every program reads those.
_QUADRATIC = {68: 21, 69: 22, 70: 28, 71: 24, 72: 29}
_NODES = {21: 3, 22: 6, 28: 9, 24: 10, 29: 27}
_TYPES = {"float64": "Float64", "int64": "Int64", "uint8": "UInt8"}


class VTU:
    """Writer of the displacement and other fields at each load step, for ParaView and PyVista.

    ``follow(…, on_step=forms.files.VTU("twist.pvd", u, sigma=stress.cauchy(psi, F)))`` writes
    twist_0000.vtu, twist_0001.vtu, … and, anew at each step, twist.pvd with their load factors.
    Points are those of the reference body: apply "Warp by vector" with the displacement. One file a
    step, whatever the number of ranks: rank 0 gathers and writes it; for bodies that do not fit
    there is :class:`forms.VTX`. meshio reads all of them but hexahedra of degree 3.

    Args:
        filename: Name that ends in .pvd.
        u: Unknown; of a mixed one the displacement is written.
        fields: UFL expressions to be evaluated at each step. With any, all is written on
            discontinuous elements of the displacement's degree, u unchanged by that.

    Raises:
        ValueError: the name does not end in .pvd, or a field bears the displacement's name.
        OSError: a file cannot be written; alike on all ranks.
    """

    def __init__(self, filename: str | FilePath, u: fem.Function, **fields: Expr) -> None:
        self._file = FilePath(filename)
        if self._file.suffix != ".pvd":
            raise ValueError(
                f"a list of VTU files needs a name that ends in .pvd, got {self._file.name}."
            )
        if "displacement" in fields:
            raise ValueError("the displacement is written as it is: give the field another name.")
        self._nodes = Nodes(u, fields)
        self._grid = grid(self._nodes.displacement.function_space)
        self._steps: list[tuple[float, str]] = []

    def __call__(self, path: Path) -> None:
        """Write the state of a path at its load factor."""
        self.write(path.load)

    def write(self, load: float) -> None:
        """Write the present state of the unknown under a load factor (ParaView's time)."""
        self._nodes.update()
        found = {f.name: (values(f), f.ufl_shape) for f in self._nodes.functions}
        comm = self._nodes.displacement.function_space.mesh.comm
        name = f"{self._file.stem}_{len(self._steps):04}.vtu"
        self._steps.append((float(load), name))

        def write() -> None:
            assert self._grid is not None
            self._file.parent.mkdir(parents=True, exist_ok=True)
            shaped = {key: _spatial(v, shape) for key, (v, shape) in found.items()}
            _replace(self._file.with_name(name), _vtu(self._grid, shaped))
            _replace(self._file, _pvd(self._steps))

        on_rank_zero(comm, write)


def _spatial(v: Any, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Values with the components that VTK knows: 1, 3 of a vector, 9 of a tensor."""
    if len(shape) > 2 or max(shape, default=1) > 3:
        return v
    whole = np.zeros((len(v), *(3,) * len(shape)))
    whole[(slice(None), *(slice(n) for n in shape))] = v.reshape(len(v), *shape)
    return whole.reshape(len(v), -1)


def _vtu(grid: Grid, fields: dict[str, NDArray[np.float64]]) -> str:
    count, width = grid.cells.shape
    kind = _QUADRATIC.get(grid.kind, grid.kind)
    kind = kind if _NODES.get(kind, width) == width else grid.kind
    data = "".join(_array(name, v) for name, v in fields.items())
    cells = (
        _array("connectivity", grid.cells.ravel())
        + _array("offsets", width * np.arange(1, count + 1))
        + _array("types", np.full(count, kind, np.uint8))
    )
    # Hexahedra of any order have their nodes in another order since 2.1, which meshio refuses.
    version = "2.2" if kind == 72 else "1.0"
    return (
        f'<VTKFile type="UnstructuredGrid" version="{version}" byte_order="LittleEndian" '
        'header_type="UInt64">\n<UnstructuredGrid>\n'
        f'<Piece NumberOfPoints="{len(grid.points)}" NumberOfCells="{count}">\n'
        f"<Points>\n{_array('Points', grid.points)}</Points>\n<Cells>\n{cells}</Cells>\n"
        f'<PointData Vectors="displacement">\n{data}</PointData>\n'
        "</Piece>\n</UnstructuredGrid>\n</VTKFile>\n"
    )


def _array(name: str, a: NDArray) -> str:
    kind = _TYPES[a.dtype.name]
    raw = np.ascontiguousarray(a, a.dtype.newbyteorder("<")).tobytes()
    text = b64encode(np.array(len(raw), "<u8").tobytes() + raw).decode()
    components = f' NumberOfComponents="{a.shape[1]}"' if a.ndim == 2 else ""
    opening = f'<DataArray type="{kind}" Name={quoteattr(name)}{components} format="binary">'
    return f"{opening}{text}</DataArray>\n"


def _pvd(steps: list[tuple[float, str]]) -> str:
    lines = "".join(
        f'<DataSet timestep="{load!r}" part="0" file={quoteattr(name)}/>\n' for load, name in steps
    )
    return f'<VTKFile type="Collection" version="0.1">\n<Collection>\n{lines}' + (
        "</Collection>\n</VTKFile>\n"
    )


def _replace(file: FilePath, text: str) -> None:
    """Write a file that is never seen half written."""
    part = file.with_name(f".{file.name}.part")
    part.write_text(text)
    part.replace(file)
