# SPDX-License-Identifier: MIT
"""Displacement and other fields at the nodes of one space, and the cells between them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import basix
import basix.ufl
import numpy as np
import ufl
from dolfinx import fem, plot
from numpy.typing import NDArray

from .._types import Expr
from ..fields import Evaluation
from ..results import displacement_of

Array = NDArray[np.float64]


class Nodes:
    """Displacement and fields of an unknown, brought up to date as often as one likes.

    Args:
        u: Unknown; of a mixed one the displacement is taken.
        fields: UFL expressions. With any, all is on discontinuous elements of the displacement's
            degree, u unchanged by that.

    Attributes:
        displacement: The displacement on its own space.
        functions: That, and one function for each field.
    """

    def __init__(self, u: fem.Function, fields: Mapping[str, Expr]) -> None:
        self._unknown = u
        W = displacement_of(u).function_space
        mesh, degree = W.mesh, W.ufl_element().embedded_superdegree
        V = _lagrange(mesh, degree, (mesh.geometry.dim,), bool(fields))
        self.displacement = fem.Function(V, name="displacement")
        shapes = {name: ufl.as_ufl(e).ufl_shape for name, e in fields.items()}
        written = [
            fem.Function(_lagrange(mesh, degree, shape, True), name=name)
            for name, shape in shapes.items()
        ]
        self._evaluations = [
            Evaluation(e, f) for e, f in zip(fields.values(), written, strict=True)
        ]
        self.functions = [self.displacement, *written]

    def update(self) -> None:
        """Take the present state. Collective."""
        self.displacement.interpolate(displacement_of(self._unknown))
        for evaluation in self._evaluations:
            evaluation.update()


def _lagrange(mesh: Any, k: int, shape: tuple[int, ...], discontinuous: bool) -> fem.FunctionSpace:
    """Lagrange space with its nodes at equal distances, as VTK interpolates between them."""
    element = basix.ufl.element(
        "Lagrange",
        mesh.topology.cell_name(),
        k,
        lagrange_variant=basix.LagrangeVariant.equispaced,
        shape=shape,
        discontinuous=discontinuous,
    )
    return fem.functionspace(mesh, element)


class Grid(NamedTuple):
    """Cells of all ranks in VTK's order of nodes, shape (cells, nodes), their type, and points."""

    cells: NDArray[np.int64]
    kind: int
    points: Array


def grid(V: fem.FunctionSpace) -> Grid | None:
    """All cells of a mesh with the nodes of a space; on rank 0, None on the others. Collective."""
    mesh, dofmap = V.mesh, V.dofmap
    owned = np.arange(mesh.topology.index_map(mesh.topology.dim).size_local, dtype=np.int32)
    # mypy sees the overload for meshes only.
    cells, types, points = plot.vtk_mesh(V, owned)  # type: ignore[arg-type]
    width = len(dofmap.list[0]) if len(dofmap.list) else 1
    numbers = dofmap.index_map.local_to_global(cells.reshape(-1, width + 1)[:, 1:].ravel())
    own = points[: dofmap.index_map.size_local]
    part = (numbers.reshape(-1, width), types[:1], own) if len(owned) else (None, types[:1], own)
    parts = mesh.comm.gather(part, root=0)
    if parts is None:
        return None
    together = np.concatenate([cells for cells, _, _ in parts if cells is not None])
    (kind, *_) = [int(types[0]) for _, types, _ in parts if len(types)]
    return Grid(together, kind, np.concatenate([points for *_, points in parts]))


def values(f: fem.Function) -> Array | None:
    """Values at all nodes, shape (nodes, components), on rank 0; None elsewhere. Collective."""
    dofmap = f.function_space.dofmap
    own = f.x.array.reshape(-1, dofmap.bs)[: dofmap.index_map.size_local]
    parts = f.function_space.mesh.comm.gather(own, root=0)
    return None if parts is None else np.concatenate(parts)
