# SPDX-License-Identifier: MIT
"""From what files hold, cells and facets of some types with sets and data, to one grid."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import basix
import numpy as np
from numpy.typing import NDArray

from ._grid import Grid
from ._groups import encode, merge_copies, row_keys

__all__ = ["CELLS", "Part", "assemble", "sets_of_tags", "shaped", "split_tags"]

# Number of nodes of DOLFINx's cells of order 1 and 2.
CELLS = {
    "interval": (2, 3),
    "triangle": (3, 6),
    "quadrilateral": (4, 9),
    "tetrahedron": (4, 10),
    "hexahedron": (8, 27),
}

# Cell data under these names are tags, whatever their type: the first of them that there is.
TAG_NAMES = (
    *("gmsh:physical", "cell_tags", "facet_tags", "mesh_tags", "meshtags", "medit:ref"),
    *("regions", "region", "materials", "material", "material_id", "materialid", "mat_id", "mat"),
    *("boundaries", "boundary", "subdomains", "subdomain", "markers", "marker", "labels", "tags"),
    *("tag", "name_to_read"),
)
# The numbers of gmsh's entities are whole, and no tags.
NO_TAGS = ("gmsh:geometrical",)
# Whole numbers under another name are tags if there are no more different ones than this: else
# they are numbers of cells, say.
MOST = 1000


@dataclass
class Part:
    """Cells or facets of one type.

    Attributes:
        name: What messages call it.
        cell: DOLFINx's name of the type.
        nodes: Points of each, in DOLFINx's order, shape (number, nodes of each).
        sets: Indices of the members of each named set.
        tags: Number of the set's name, where it has one.
        data: Values of each, shape (number, …).
    """

    name: str
    cell: str
    nodes: NDArray[np.int64]
    sets: dict[str, NDArray[np.int64]] = field(default_factory=dict)
    tags: dict[str, int] = field(default_factory=dict)
    data: dict[str, NDArray[np.float64]] = field(default_factory=dict)

    @property
    def dim(self) -> int:
        """Dimension of each cell or facet."""
        return len(basix.topology(basix.CellType[self.cell])) - 1

    @property
    def order(self) -> int:
        """Order of the geometry; 0: not one that DOLFINx reads."""
        numbers = CELLS.get(self.cell, ())
        return numbers.index(self.nodes.shape[1]) + 1 if self.nodes.shape[1] in numbers else 0


def split_tags(
    arrays: Mapping[str, NDArray[np.generic]], only: bool = False
) -> tuple[str | None, dict[str, NDArray[np.float64]]]:
    """Which of the arrays over cells are tags, and the others as numbers.

    Tags are one whole number per cell: the array with the first of gmsh's, DOLFINx's and meshio's
    usual names that there is; else the only array of an integer type, unless it numbers the cells:
    since this is a guess, it is among the others too.
    `only`: a single array is tags under any name, since nothing else is written this way.
    """
    whole = {
        name: values
        for name, values in arrays.items()
        if values.size == len(values) and _are_whole(values)
    }
    known = [name for tag in TAG_NAMES for name in whole if name.lower() == tag]
    others = [
        name
        for name, values in whole.items()
        if values.dtype.kind in "iu" and name not in NO_TAGS and len(np.unique(values)) <= MOST
    ]
    if only and len(arrays) == 1:
        known += whole
    chosen = known[0] if known else others[0] if len(others) == 1 else None
    data = {
        name: np.asarray(values, dtype=np.float64)
        for name, values in arrays.items()
        if (name != chosen or name not in known) and values.dtype.kind in "iufb"
    }
    return chosen, data


def _are_whole(values: NDArray[np.generic]) -> bool:
    if values.dtype.kind not in "iuf" or not len(values):
        return False
    numbers = np.asarray(values, dtype=np.float64)
    return bool(np.isfinite(numbers).all() and (numbers == np.round(numbers)).all()) and bool(
        np.abs(numbers).max() < 2**31
    )


def shaped(values: NDArray[Any]) -> NDArray[np.float64]:
    """Values of shape (n, 1) as scalars, (n, 9) as tensors (n, 3, 3); others as they are."""
    width = values.shape[1:]
    shape = () if width == (1,) else (3, 3) if width == (9,) else width
    return np.asarray(values, dtype=np.float64).reshape(len(values), *shape)


def sets_of_tags(
    values: NDArray[np.generic],
) -> tuple[dict[str, NDArray[np.int64]], dict[str, int]]:
    """Sets called by their tags, "1", "2", …, and the tags themselves."""
    numbers = np.asarray(values).ravel().astype(np.int64)
    tags = {str(tag): int(tag) for tag in np.unique(numbers)}
    return {name: np.flatnonzero(numbers == tag) for name, tag in tags.items()}, tags


def assemble(
    source: str,
    points: NDArray[np.float64],
    parts: Sequence[Part],
    node_sets: Mapping[str, NDArray[np.int64]] | None = None,
    point_data: Mapping[str, NDArray[np.float64]] | None = None,
    gdim: int | None = None,
    labels: NDArray[np.int64] | None = None,
) -> Grid:
    """Join parts to the grid of their cells of highest dimension, with named regions and facets.

    Args:
        source: What messages call it.
        points: Coordinates, shape (N, 2) or (N, 3).
        parts: Cells, facets, and what lies on lower dimensions, which is dropped.
        node_sets: Points of named sets: a boundary of those facets of the body's surface all of
            whose vertices are in the set. A set with no such facet is dropped.
        point_data: Values of the points, shape (N, …).
        gdim: Dimension of space; None: 2 for a surface mesh with z = 0, else 3.
        labels: Number that the source gives to each cell.

    Returns:
        The grid. Cells of no set are the region "body".

    Raises:
        ValueError: No cells, several types, points that there are not, or a gdim that does not
            hold the mesh.
    """
    parts = [part for part in parts if len(part.nodes)]
    tdim = max((part.dim for part in parts), default=0)
    cells = [part for part in parts if part.dim == tdim]
    if tdim < 2 or len({(p.cell, p.order) for p in cells}) != 1 or not cells[0].order:
        kinds = sorted({f"{p.cell} cells of {p.nodes.shape[1]} nodes" for p in cells})
        raise ValueError(
            f"{source}: it holds {' and '.join(kinds) or 'no cells'}: a body needs one type, of "
            "triangles, quadrilaterals, tetrahedra or hexahedra of order 1 or 2."
        )
    for part in parts:
        if part.nodes.min() < 0 or part.nodes.max() >= len(points):
            raise ValueError(
                f"{source}: a {part.cell} has the node {part.nodes.max()}, of {len(points)} "
                "points numbered from 0: it may be truncated, write it again."
            )
    x = np.zeros((len(points), 3))
    x[:, : points.shape[1]] = points
    nodes = np.concatenate([part.nodes for part in cells])
    flat = tdim == 2 and not x[np.unique(nodes), 2].any()
    if gdim == 2 and not flat:
        raise ValueError(f"{source}: gdim=2 needs a surface mesh with z = 0 at all nodes, pass 3.")
    sets, tags = _join(cells)
    corners = len(basix.topology(basix.CellType[cells[0].cell])[0])
    kept, sets, surplus = merge_copies(row_keys(nodes[:, :corners]), sets)
    if surplus:
        raise ValueError(
            f"{source}: {surplus} of {len(nodes)} cells come twice: write each cell once, or once "
            "for each of its regions."
        )
    data = _join_data(cells)
    if len(kept) < len(nodes):
        nodes, data = nodes[kept], {name: values[kept] for name, values in data.items()}
        labels = None if labels is None else labels[kept]
    rest = "body" if "body" not in sets else "rest"
    regions, region_names = encode(len(nodes), sets, _numbered(tags, sets), rest)
    grid = Grid(
        source,
        cells[0].cell,
        cells[0].order,
        gdim or (2 if flat else 3),
        x,
        nodes,
        regions,
        np.empty((0, 0), np.int64),
        np.empty(0, np.int32),
        region_names,
        {},
        np.empty(0, np.int64) if labels is None else labels,
        data,
        {name: np.asarray(v, np.float64) for name, v in (point_data or {}).items()},
    )
    sides = [part for part in parts if part.dim == tdim - 1 and part.sets]
    for part in sides:
        if part.cell != grid.facet_cell:
            raise ValueError(
                f"{source}: {len(part.nodes)} {part.cell}s are named, which are no facets of its "
                f"{grid.cell} cells: leave them out, or name its {grid.facet_cell}s."
            )
    _add_boundaries(grid, sides, node_sets or {})
    return grid


def _join(
    parts: Sequence[Part],
) -> tuple[dict[str, NDArray[np.int64]], dict[str, int]]:
    found: dict[str, list[NDArray[np.int64]]] = {}
    tags: dict[str, int] = {}
    start = 0
    for part in parts:
        for name, members in part.sets.items():
            found.setdefault(name, []).append(np.asarray(members, np.int64) + start)
        tags |= part.tags
        start += len(part.nodes)
    return {name: np.unique(np.concatenate(those)) for name, those in found.items()}, tags


def _numbered(tags: Mapping[str, int], sets: Mapping[str, object]) -> dict[str, int]:
    """The tags that there are, and numbers for the names that have none."""
    # DOLFINx integrates everywhere where a measure says -1.
    numbered = {name: tag for name, tag in tags.items() if name in sets and tag >= 0}
    free = max(0, *numbered.values()) + 1 if numbered else 1
    for name in sets:
        if name not in numbered:
            numbered[name], free = free, free + 1
    return numbered


def _join_data(parts: Sequence[Part]) -> dict[str, NDArray[np.float64]]:
    """Values of all cells; NaN where a part has none."""
    number = sum(len(part.nodes) for part in parts)
    found: dict[str, NDArray[np.float64]] = {}
    start = 0
    for part in parts:
        stop = start + len(part.nodes)
        for name, values in part.data.items():
            whole = found.setdefault(name, np.full((number, *values.shape[1:]), np.nan))
            whole[start:stop] = values
        start = stop
    return found


def _add_boundaries(
    grid: Grid, parts: Sequence[Part], node_sets: Mapping[str, NDArray[np.int64]]
) -> None:
    """Name facets by sets of them, and by sets of points."""
    corners = grid.facet_corners
    sets, tags = _join(parts)
    vertices = [part.nodes[:, :corners] for part in parts]
    number = sum(len(v) for v in vertices)
    exterior = grid.exterior_facets() if node_sets else np.empty((0, corners), np.int64)
    for name, points in node_sets.items():
        inside = np.zeros(len(grid.points), dtype=bool)
        inside[points] = True
        members = np.flatnonzero(inside[exterior].all(axis=1)) + number
        if len(members):
            sets[name] = np.union1d(sets[name], members) if name in sets else members
    rows = np.concatenate([*vertices, exterior])
    first, sets, _ = merge_copies(row_keys(rows), sets)
    values, grid.boundary_names = encode(len(first), sets, _numbered(tags, sets))
    grid.facets, grid.boundaries = rows[first[values != -1]], values[values != -1]
