# SPDX-License-Identifier: MIT
"""Bodies from NumPy arrays."""

from collections.abc import Mapping, Sequence
from typing import Any

from mpi4py import MPI

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._dolfinx import from_vtk_order
from ._grid import Grid
from ._parts import CELLS, Part, assemble, sets_of_tags
from .body import Body, distribute

__all__ = ["from_arrays"]

WHO = "from_arrays"

# What a number of nodes means in the plane and in space, if no type of cell is given.
BY_NODES = {
    2: {3: "triangle", 4: "quadrilateral", 6: "triangle", 9: "quadrilateral"},
    3: {3: "triangle", 6: "triangle", 9: "quadrilateral"}
    | {4: "tetrahedron", 10: "tetrahedron", 8: "hexahedron", 27: "hexahedron"},
}


def from_arrays(
    comm: MPI.Comm,
    points: ArrayLike | None = None,
    cells: ArrayLike | None = None,
    *,
    regions: Mapping[str, ArrayLike] | ArrayLike | None = None,
    boundaries: Mapping[str, ArrayLike] | None = None,
    data: Mapping[str, ArrayLike | Mapping[int, ArrayLike]] | None = None,
    point_data: Mapping[str, ArrayLike] | None = None,
    cell: str | None = None,
    numbers: ArrayLike | None = None,
    gdim: int | None = None,
) -> Body:
    """Make a body from arrays on rank 0, check it, and distribute it. Collective.

    The arrays of rank 0 count; the other ranks may give the same, or none.

    Args:
        comm: Communicator of the mesh.
        points: Coordinates [m], shape (N, 2) or (N, 3).
        cells: Rows of `points` that are the nodes of each cell, in VTK's order (that of meshio; of
            quadrilaterals all around), shape (number of cells, nodes of each), order 1 or 2.
        regions: Indices of the cells of each name, or a mask of them; or the tag of each cell,
            which then is the name: "1", "2", …. Names may overlap; cells without one: body.
        boundaries: Of each name the vertices of its facets, shape (n, vertices of each); or a set
            of points, shape (n,): those facets of the surface whose vertices are all in it.
        data: Of each name values of the cells, shape (number of cells, …), in the order of `cells`;
            or of the points, if there are as many as points; or a dictionary from the cells' own
            `numbers` to values, NaN where it has none.
        point_data: Values of the points, shape (N, …), where their number is that of the cells too.
        cell: "triangle", "quadrilateral", "tetrahedron" or "hexahedron"; None: by the number of
            nodes, of which four are a tetrahedron if points have three coordinates.
        numbers: Number by which the cells' source, a file say, calls each: what messages name, and
            the keys of `data`. None: 0, 1, ….
        gdim: Dimension of space, 2 or 3. None: 2 for a mesh of surfaces with z = 0, else 3.

    Returns:
        The body; `body.data` has the data as functions, as :class:`Body` says.

    Raises:
        ValueError: Arrays that make no body.
    """
    if gdim not in (None, 2, 3):
        raise ValueError(f"gdim must be 2, 3 or None, got gdim={gdim}.")

    def make() -> Grid:
        x, nodes, kind = _mesh(points, cells, cell)
        own = np.arange(len(nodes)) if numbers is None else _array("numbers", numbers, "iu")
        if own.shape != (len(nodes),) or len(np.unique(own)) < len(own):
            raise ValueError(
                f"{WHO} needs one number for each of {len(nodes)} cells, each another, got numbers "
                f"of shape {own.shape}, {len(np.unique(own))} of them different."
            )
        part = Part(kind, kind, nodes[:, from_vtk_order(kind, nodes.shape[1])])
        part.sets, part.tags = _regions(regions, len(nodes))
        sides, node_sets = _boundaries(boundaries or {}, part, len(x))
        at_points = {
            name: _values(name, values, len(x), "points")
            for name, values in (point_data or {}).items()
        }
        for name, values in (data or {}).items():
            if isinstance(values, Mapping):
                part.data[name] = _by_number(name, values, own)
                continue
            many = np.shape(values)[:1]
            if many == (len(x),) and len(x) == len(nodes):
                raise ValueError(
                    f"{WHO}: there are {len(x)} cells and as many points, so data '{name}' may be "
                    "of both: give it by number, {0: …, 1: …}, or in point_data."
                )
            if many == (len(x),):
                at_points[name] = _values(name, values, len(x), "points")
            else:
                part.data[name] = _values(name, values, len(nodes), "cells")
        grid = assemble(WHO, x, [part, *sides], node_sets, at_points, gdim, own.astype(np.int64))
        for name in node_sets:
            if name not in grid.boundary_names:
                raise ValueError(
                    f"{WHO}: the boundary '{name}' holds no facet of the surface: add the points "
                    "of whole facets."
                )
        return grid

    return distribute(comm, make)


def _array(name: str, values: ArrayLike | None, kinds: str) -> NDArray[Any]:
    try:
        array = np.asarray(values)
    except ValueError:
        raise ValueError(f"{WHO} needs {name} as one array, got rows of several lengths.") from None
    if array.size and array.dtype.kind not in kinds:
        what = "whole numbers" if kinds == "iu" else "numbers"
        raise ValueError(f"{WHO} needs {name} of {what}, got the type {array.dtype}.")
    return array


def _mesh(
    points: ArrayLike | None, cells: ArrayLike | None, cell: str | None
) -> tuple[NDArray[np.float64], NDArray[np.int64], str]:
    x, nodes = _array("points", points, "iuf"), _array("cells", cells, "iu")
    if x.ndim != 2 or x.shape[1] not in (2, 3) or nodes.ndim != 2 or not len(nodes):
        raise ValueError(
            f"{WHO} needs points of shape (N, 2) or (N, 3) and cells of shape (number, nodes of "
            f"each), got {x.shape} and {nodes.shape}."
        )
    many = nodes.shape[1]
    kind = cell or BY_NODES[x.shape[1]].get(many, "")
    if many not in CELLS.get(kind, ()) or kind == "interval":
        raise ValueError(
            f"{WHO}: cells of {many} nodes and cell={cell!r} make no triangles, quadrilaterals, "
            "tetrahedra or hexahedra of order 1 or 2."
        )
    return x.astype(np.float64), nodes.astype(np.int64), kind


def _regions(
    regions: Mapping[str, ArrayLike] | ArrayLike | None, number: int
) -> tuple[dict[str, NDArray[np.int64]], dict[str, int]]:
    if regions is None:
        return {}, {}
    if not isinstance(regions, Mapping):
        tags = _array("regions", regions, "iu")
        if tags.shape != (number,):
            raise ValueError(
                f"{WHO} needs regions as one tag for each of {number} cells, got {tags.shape}."
            )
        return sets_of_tags(tags)
    sets = {}
    for name, members in regions.items():
        found: NDArray[Any] = _array(f"region '{name}'", members, "iub").reshape(-1)
        if found.dtype.kind == "b" and len(found) == number:
            found = np.flatnonzero(found)
        elif found.dtype.kind == "b" or (
            found.size and not 0 <= int(found.min()) <= int(found.max()) < number
        ):
            raise ValueError(
                f"{WHO}: the region '{name}' needs indices from 0 to {number - 1} or a mask of "
                f"{number} cells, got {len(found)} values that are not."
            )
        sets[str(name)] = np.unique(found.astype(np.int64))
    return sets, {}


def _boundaries(
    boundaries: Mapping[str, ArrayLike], part: Part, number: int
) -> tuple[Sequence[Part], dict[str, NDArray[np.int64]]]:
    side, corners = {
        "triangle": ("interval", 2),
        "quadrilateral": ("interval", 2),
        "tetrahedron": ("triangle", 3),
        "hexahedron": ("quadrilateral", 4),
    }[part.cell]
    parts, node_sets = [], {}
    for name, values in boundaries.items():
        rows = _array(f"boundary '{name}'", values, "iu")
        inside = not rows.size or 0 <= rows.min() <= rows.max() < number
        if not inside or rows.ndim not in (1, 2) or (rows.ndim == 2 and rows.shape[1] != corners):
            raise ValueError(
                f"{WHO}: the boundary '{name}' needs rows of {corners} points from 0 to "
                f"{number - 1}, or a set of points, got the shape {rows.shape}."
            )
        rows = rows.astype(np.int64)
        if rows.ndim == 1:
            node_sets[str(name)] = rows
        else:
            parts.append(Part(name, side, rows, {str(name): np.arange(len(rows))}))
    return parts, node_sets


def _values(name: str, values: ArrayLike, number: int, what: str) -> NDArray[np.float64]:
    array = _array(f"data '{name}'", values, "iufb")
    if array.shape[:1] != (number,):
        raise ValueError(
            f"{WHO}: data '{name}' has the shape {array.shape}, and there are {number} {what}."
        )
    return array.astype(np.float64)


def _by_number(
    name: str, values: Mapping[int, ArrayLike], own: NDArray[np.generic]
) -> NDArray[np.float64]:
    keys = np.array(list(values), dtype=np.int64)
    rows = _array(f"data '{name}'", np.array(list(values.values())), "iufb")
    order = np.argsort(own)
    place = order[np.minimum(np.searchsorted(own, keys, sorter=order), len(own) - 1)]
    unknown = keys[own[place] != keys]
    if len(unknown):
        raise ValueError(
            f"{WHO}: data '{name}' has values for {len(unknown)} cells that there are not, the "
            f"first is number {unknown[0]}."
        )
    whole = np.full((len(own), *rows.shape[1:]), np.nan)
    whole[place] = rows
    return whole
