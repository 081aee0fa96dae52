# SPDX-License-Identifier: MIT
"""Boundaries of obstacles: where a measure is, sizes of its facets, a rule with their nodes."""

from __future__ import annotations

from itertools import product
from typing import Any

from mpi4py import MPI

import basix
import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray

from . import _dolfinx

Array = NDArray[Any]
KINDS = {"cell": fem.IntegralType.cell, "exterior_facet": fem.IntegralType.exterior_facet}


def entities(mesh: Any, measure: Any) -> NDArray[np.int32]:
    """Where a measure, or an integral, of an obstacle is: cells, or (cell, local facet); local."""
    kind = KINDS[measure.integral_type()]
    ids = measure.subdomain_id()
    found = []
    for number in ids if isinstance(ids, tuple) else (ids,):
        number = number if isinstance(number, int) else -1
        data = measure.subdomain_data()
        found.append(_dolfinx.integration_entities(_cpp(mesh), kind, data, number))
    width = 2 if kind == fem.IntegralType.exterior_facet else 1
    return np.unique(np.concatenate(found).reshape(-1, width), axis=0).astype(np.int32)


def _cpp(mesh: Any) -> Any:
    return getattr(mesh, "_cpp_object", mesh)


def sizes(mesh: Any, ds: ufl.Measure) -> tuple[float, float]:
    """Smallest and mean size of a boundary's facets [m]. Collective."""
    dim, where = mesh.topology.dim, entities(mesh, ds)
    if where.shape[1] == 2:
        mesh.topology.create_connectivity(dim, dim - 1)
        table = mesh.topology.connectivity(dim, dim - 1)
        numbers = table.array.reshape(table.num_nodes, -1)[where[:, 0], where[:, 1]]
        dim -= 1
    else:
        numbers = where[:, 0]
    h = mesh.h(dim, np.ascontiguousarray(numbers, np.int32))
    least = mesh.comm.allreduce(float(h.min(initial=np.inf)), MPI.MIN)
    total, count = mesh.comm.allreduce(np.array([h.sum(), len(h)]))
    if count == 0:
        raise ValueError("an obstacle needs a boundary, got one without facets on any rank.")
    return least, float(total / count)


def facet_type(mesh: Any, ds: ufl.Measure) -> basix.CellType:
    """Kind of the facets that a measure integrates over."""
    cell = getattr(basix.CellType, mesh.topology.cell_name())
    if ds.integral_type() == "cell":
        return cell
    kinds = set(basix.cell.subentity_types(cell)[-2])
    if len(kinds) > 1 or kinds == {basix.CellType.point}:
        raise ValueError(f"obstacles know no facets of {cell.name} cells.")
    return kinds.pop()


def points_on(
    u: fem.Function, field: Any, measure: Any, points: Array
) -> list[tuple[Array, Array, Array]]:
    """Points of a boundary's facets, kind of local facet by kind; local.

    Args:
        u: Unknown.
        field: Its displacement.
        measure: Where the facets are.
        points: On a reference facet, shape (p, facet's dimension).

    Returns:
        Reference positions, shape (facets, p, dim); values of the k functions that are not zero on
        the facet, (p, k); local numbers of their degrees of freedom, (facets, k, dim).
    """
    mesh, dim = u.function_space.mesh, u.function_space.mesh.geometry.dim
    where = entities(mesh, measure)
    cells, charts = where[:, 0], _charts(mesh, points, where.shape[1] == 2)
    whole = field.space.ufl_element()
    element = whole if field.place is None else whole.sub_elements[field.place]
    scalar = element.sub_elements[0]
    numbers = field.view.dofmap.list[cells]
    numbers = dim * numbers if field.place is None else numbers[:, ::dim]
    geometry = _dolfinx.geometry_dofmap(mesh)[cells]
    chart = mesh.ufl_domain().ufl_coordinate_element().sub_elements[0]
    sides = where[:, 1] if where.shape[1] == 2 else np.zeros(len(where), np.int32)
    found = []
    for side, at in enumerate(charts):
        mine = sides == side
        N, shape = scalar.tabulate(0, at)[0], chart.tabulate(0, at)[0]
        kept = np.flatnonzero(np.abs(N).max(axis=0) > 1e-12)
        X = np.einsum("pa,fai->fpi", shape, mesh.geometry.x[geometry[mine], :dim])
        found.append((X, N[:, kept], numbers[mine][:, kept, None] + np.arange(dim)))
    return found


def _charts(mesh: Any, points: Array, on_facets: bool) -> list[Array]:
    """Points of a rule in the reference cell, on each of its facets."""
    cell = getattr(basix.CellType, mesh.topology.cell_name())
    if not on_facets:
        return [points]
    x, facets = basix.geometry(cell), basix.topology(cell)[-2]
    charts = []
    for facet in facets:
        axes = x[facet[1 : 1 + points.shape[1]]] - x[facet[0]]
        charts.append(x[facet[0]] + points @ axes)
    return charts


def rule(cell: basix.CellType, parts: int) -> tuple[Array, Array]:
    """Points and weights on a reference facet: at all nodes of degree 1 and 2, of degree 3.

    Simpson's rule on intervals, its products on quadrilaterals, and on triangles vertices (1/40),
    middles of edges (1/15) and the middle (9/40), in each of the parts; the weights are positive.
    """
    s: Array = np.linspace(0, 1, 2 * parts + 1)
    w: Array = np.full(len(s), 2.0, np.float64)
    w[1::2], w[[0, -1]] = 4.0, 1.0
    w /= 6 * parts
    if cell == basix.CellType.interval:
        return s[:, None], w
    if cell == basix.CellType.quadrilateral:
        x, y = np.meshgrid(s, s, indexing="ij")
        return np.c_[x.ravel(), y.ravel()], np.outer(w, w).ravel()
    found: dict[tuple[int, int], float] = {}  # by six times the coordinates in parts
    for i, j in product(range(parts), repeat=2):
        for sign in (1, -1):
            corners = [(0, 0), (sign, 0), (0, sign)]
            base = (i, j) if sign == 1 else (i + 1, j + 1)
            if sum(base) + (sign == 1) > parts:
                continue
            v = [(6 * (base[0] + a), 6 * (base[1] + b)) for a, b in corners]
            for a, b in ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0)):
                at = (v[a][0] + v[b][0]) // 2, (v[a][1] + v[b][1]) // 2
                found[at] = found.get(at, 0.0) + (1 / 40 if a == b else 1 / 15)
            middle = (sum(p[0] for p in v) // 3, sum(p[1] for p in v) // 3)
            found[middle] = found.get(middle, 0.0) + 9 / 40
    points: Array = np.array(list(found), float) / (6 * parts)
    return points, np.array(list(found.values()), float) / parts**2
