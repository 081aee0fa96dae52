# SPDX-License-Identifier: MIT
"""Cells at points, and functions whose integrals are values at points. Collective."""

from __future__ import annotations

from typing import Any

import basix
import numpy as np
import ufl
from dolfinx import fem, geometry
from dolfinx.mesh import entities_to_geometry
from numpy.typing import NDArray

from . import _dolfinx
from ._parallel import bounding_box
from .native import jit

Array = NDArray[np.float64]


def cells_at(mesh: Any, x: Array) -> tuple[NDArray[np.int32], Array]:
    """The cell at each point, and how far the point is from it.

    Of several cells that touch a point one is taken, the same on any number of ranks.

    Args:
        mesh: Mesh.
        x: Points, shape (n, 3), alike on all ranks.

    Returns:
        Local number of the cell on the one rank that owns it, -1 on the others; distances [m],
        alike on all ranks. A mesh without cells on any rank is infinitely far.
    """
    # DOLFINx's tolerances are lengths: the mesh is looked at in units of its own size.
    low, high = bounding_box(mesh.comm, mesh.geometry.x)
    size, coordinates = float(np.linalg.norm(high - low)) or 1.0, mesh.geometry.x.copy()
    mesh.geometry.x[:] = (coordinates - low) / size
    try:
        found = _found(mesh, np.asarray((x - low) / size, np.float64))
    finally:
        mesh.geometry.x[:] = coordinates
    found[:, 0] *= size
    every = np.array(mesh.comm.allgather(found))
    best = np.array(
        [min(range(len(every)), key=lambda r: tuple(every[r, k])) for k in range(len(x))]
    )
    mine = best == mesh.comm.rank
    cells = np.where(mine & np.isfinite(found[:, 0]), found[:, 2], -1).astype(np.int32)
    return cells, every[:, :, 0].min(axis=0)


def _found(mesh: Any, x: Array) -> Array:
    """Distance of each point, number of the cell as it was input, local number; local."""
    found = np.full((len(x), 3), np.inf)
    dim = mesh.topology.dim
    owned = np.arange(mesh.topology.index_map(dim).size_local, dtype=np.int32)
    if not (len(owned) and len(x)):
        return found
    originals = _dolfinx.original_cells(mesh)
    numbers: Any = owned if originals is None else originals
    tree = _dolfinx.bounding_boxes(mesh, dim, owned)
    middles = geometry.create_midpoint_tree(mesh, dim, owned)
    near = geometry.compute_collisions_points(tree, x)
    inside = geometry.compute_colliding_cells(mesh, near, x)
    for k in range(len(x)):
        if len(cells := inside.links(k)):
            cell, distance = cells[np.argmin(numbers[cells])], 0.0
        else:
            closest = geometry.compute_closest_entity(tree, middles, mesh, x[k : k + 1])
            # Typed as a list in DOLFINx 0.9, which takes arrays only.
            squared = geometry.squared_distance(
                mesh,
                dim,
                closest,  # type: ignore[arg-type]
                x[k : k + 1],
            )
            cell, distance = closest[0], float(np.sqrt(squared[0]))
        found[k] = distance, numbers[cell], cell
    return found


def require_inside(mesh: Any, x: Array, distance: Array, tolerance: float, what: str) -> None:
    """Refuse points that lie outside the mesh by more than a part of its size."""
    low, high = bounding_box(mesh.comm, mesh.geometry.x)
    worst = int(np.argmax(distance))
    if distance[worst] > tolerance * np.linalg.norm(high - low):
        dim = mesh.geometry.dim
        raise ValueError(
            f"{what} {tuple(float(c) for c in x[worst, :dim])} lies {distance[worst]:.3g} outside "
            "the mesh; give reference coordinates."
        )


class Representer(fem.Function):
    """Function g with int g v dx = sum_i w_i v(x_i): values at points that move with the mesh.

    Args:
        V: Discontinuous functions.
        cells: The cell of each point that this rank owns.
        values: w_i phi(x_i) of its functions, a row for each.
    """

    def __init__(self, V: fem.FunctionSpace, cells: NDArray[np.int32], values: Array) -> None:
        super().__init__(V, name="load")
        self._cells, self._values = cells, values
        mesh, degree = V.mesh, 2 * V.ufl_element().embedded_superdegree
        cell_type = getattr(basix.CellType, mesh.topology.cell_name())
        points, self._rule = basix.make_quadrature(cell_type, degree)
        self._phi = V.ufl_element().tabulate(0, points)[0]
        self._scale = jit.expression(abs(ufl.JacobianDeterminant(mesh)), points, mesh)
        self.dx = ufl.dx(domain=mesh, metadata={"quadrature_degree": degree})
        self.renew()

    def renew(self) -> None:
        """Bring the function up to date with the places of the mesh's nodes. Collective."""
        V = self.function_space
        self.x.array[:] = 0.0
        for cell, values in zip(self._cells, self._values, strict=True):
            scale = self._scale.eval(V.mesh, np.array([cell])).ravel()
            M = self._phi.T @ ((self._rule * scale)[:, None] * self._phi)
            self.x.array[V.dofmap.cell_dofs(int(cell))] += np.linalg.solve(M, values)
        self.x.scatter_forward()


def representer(mesh: Any, k: int, x: Array, weights: Array, what: str) -> Representer:
    """Function g with a measure and int g v dx = sum_i w_i v(x_i) for every v of degree k.

    In the cell K at x_i, g = sum_a c_a phi_a with M c = w_i phi(x_i), M_ab = int_K phi_a phi_b by
    the rule of the measure ``g.dx``: exact by construction, in curved cells, too. Collective.

    Args:
        mesh: Mesh.
        k: Degree of the functions v.
        x: Points, shape (n, 3), alike on all ranks.
        weights: Weight of each.
        what: What a point is called in messages.

    Raises:
        ValueError: a point outside the mesh.
    """
    cells, distance = cells_at(mesh, x)
    require_inside(mesh, x, distance, 1e-8, what)
    V = fem.functionspace(mesh, ("Discontinuous Lagrange", k))
    probe, mine = fem.Function(V), np.flatnonzero(cells >= 0)
    values = np.empty((len(mine), V.dofmap.dof_layout.num_dofs))
    for row, i in zip(values, mine, strict=True):
        cell = cells[i : i + 1]
        for a, dof in enumerate(V.dofmap.cell_dofs(int(cell[0]))):
            probe.x.array[dof] = 1.0
            row[a] = weights[i] * probe.eval(x[i : i + 1], cell)[0]
            probe.x.array[dof] = 0.0
    return Representer(V, cells[mine], values)


def crossings(mesh: Any, a: Array, b: Array) -> Array:
    """Parameters s in (0, 1) at which the segment a + s (b - a) crosses facets, alike on all ranks.

    Facets by their corners, quadrilaterals as two triangles. Segments that lie in a facet cross
    the neighbours of its edges.
    """
    dim = mesh.topology.dim
    mesh.topology.create_entities(dim - 1)
    mesh.topology.create_connectivity(dim - 1, dim)
    imap = mesh.topology.index_map(dim - 1)
    facets = np.arange(imap.size_local, dtype=np.int32)
    found: Any = np.empty(0)
    if len(facets):
        corners = mesh.geometry.x[entities_to_geometry(mesh, dim - 1, facets)]
        reach = 1e-9 * np.linalg.norm(b - a)
        low, high = np.minimum(a, b) - reach, np.maximum(a, b) + reach
        close = np.all(corners.min(axis=1) <= high, axis=1)
        close &= np.all(corners.max(axis=1) >= low, axis=1)
        corners = corners[close]
        simplices = [corners[:, :dim]] + ([corners[:, 1:]] if corners.shape[1] > dim else [])
        found = np.concatenate([_crossed(c, a, b) for c in simplices])
    every: Any = np.sort(np.concatenate(mesh.comm.allgather(found)))
    every = every[(every > 1e-9) & (every < 1 - 1e-9)]
    return every[np.diff(every, prepend=-1.0) > 1e-9]


def _crossed(corners: Array, a: Array, b: Array) -> Array:
    """Parameters at which a segment crosses points, edges (in a plane or surface) or triangles."""
    if not len(corners):
        return np.empty(0)
    # a + s (b - a) = c0 + sum_k y_k (ck - c0), in the least-squares sense: 2 or 3 unknowns.
    edges = corners[:, 1:] - corners[:, :1]
    A = np.concatenate([np.broadcast_to(b - a, (len(corners), 1, 3)), -edges], axis=1)
    G = np.einsum("fik,fjk->fij", A, A)
    sizes = np.sqrt(np.einsum("fii->fi", G))
    usable = np.linalg.det(G / (sizes[:, :, None] * sizes[:, None, :])) > 1e-12
    A, edges, first = A[usable], edges[usable], corners[usable, 0]
    right = np.einsum("fik,fk->fi", A, first - a)
    y = np.linalg.solve(G[usable], right[..., None])[..., 0]
    off = np.linalg.norm(np.einsum("fi,fik->fk", y, A) - (first - a), axis=1)
    inside = (y[:, 1:] > -1e-9).all(axis=1) & (y[:, 1:].sum(axis=1) < 1 + 1e-9)
    return y[inside & (off < 1e-9 * np.linalg.norm(b - a)), 0]
