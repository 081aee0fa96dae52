# SPDX-License-Identifier: MIT
"""VTX files for ParaView. Collective, correct on any number of ranks."""

from __future__ import annotations

from pathlib import Path as FilePath

from dolfinx import fem, io

from .._parallel import on_rank_zero
from .._types import Expr
from ..paths import Path
from .nodes import Nodes


class VTX:
    """Writer of the displacement and other fields at each load step, for ParaView.

    ``follow(…, on_step=VTX("twist.bp", u, sigma=stress.cauchy(psi, F)))``; a folder ``twist.bp`` is
    made. In ParaView apply "Warp by vector" with the displacement.

    Args:
        filename: Name that ends in .bp.
        u: Unknown; of a mixed one the displacement is written.
        fields: UFL expressions to be evaluated at each step. With any, all is written on
            discontinuous elements of the displacement's degree, u unchanged by that.

    Raises:
        ValueError: the name does not end in .bp.
        OSError: the folder cannot be made; alike on all ranks.
    """

    def __init__(self, filename: str | FilePath, u: fem.Function, **fields: Expr) -> None:
        self._file = FilePath(filename)
        if self._file.suffix != ".bp":
            raise ValueError(f"a VTX file needs a name that ends in .bp, got {self._file.name}.")
        self._nodes = Nodes(u, fields)
        mesh = self._nodes.displacement.function_space.mesh
        on_rank_zero(mesh.comm, self._check_writable)
        outputs = self._nodes.functions
        self._writer = io.VTXWriter(mesh.comm, str(self._file), outputs, engine="BP4")

    def _check_writable(self) -> None:
        """Make the folder and a file in it: adios2 ends the process where it cannot."""
        self._file.mkdir(parents=True, exist_ok=True)
        probe = self._file / ".writable"
        probe.touch()
        probe.unlink()

    def __call__(self, path: Path) -> None:
        """Write the state of a path at its load factor."""
        self.write(path.load)

    def write(self, load: float) -> None:
        """Write the present state of the unknown under a load factor (ParaView's time)."""
        self._nodes.update()
        self._writer.write(load)

    def close(self) -> None:
        """Close the file; further writes are errors."""
        self._writer.close()
