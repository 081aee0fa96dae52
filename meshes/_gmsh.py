# SPDX-License-Identifier: MIT
"""gmsh: meshing, and the way from a model to arrays."""

import numpy as np
from numpy.typing import NDArray

from ._dolfinx import from_gmsh_order
from ._grid import Grid
from ._parts import Part, assemble
from ._session import gmsh

__all__ = ["extract", "generate", "name_entities", "require_groups", "set_size"]

# gmsh's element types that DOLFINx knows: the cell's name and its order.
CELLS = {
    1: ("interval", 1),
    2: ("triangle", 1),
    3: ("quadrilateral", 1),
    4: ("tetrahedron", 1),
    5: ("hexahedron", 1),
    8: ("interval", 2),
    9: ("triangle", 2),
    10: ("quadrilateral", 2),
    11: ("tetrahedron", 2),
    12: ("hexahedron", 2),
}

PRIMARY = {name: kind for kind, (name, order) in CELLS.items() if order == 1}

# Cells with a smallest scaled Jacobian (gmsh's minSJ) up to this are straightened, by halves.
TANGLED = 1e-3
STRAIGHTENING = 8


def generate(dim: int, order: int) -> None:
    """Mesh the current model up to dimension `dim`, curved cells untangled where need be."""
    gmsh.option.setNumber("Mesh.ElementOrder", order)
    gmsh.model.mesh.generate(dim)
    if order > 1:
        # Straight inner and curved outer edges may cross in a coarse mesh. (gmsh's own optimizer
        # for it ends the whole process where it finds no way.)
        for step in range(STRAIGHTENING):
            if not _straighten(dim, 0.5 if step < STRAIGHTENING - 1 else 1.0):
                break


def _straighten(dim: int, part: float) -> int:
    """Move the nodes of tangled second-order cells towards their straight shape; their number."""
    mesh, moved = gmsh.model.mesh, 0
    for kind, numbers, nodes in zip(*mesh.getElements(dim), strict=True):
        bad = mesh.getElementQualities(numbers, "minSJ") <= TANGLED
        if not bad.any():
            continue
        moved += int(bad.sum())
        _, _, _, num_nodes, local, primary = mesh.getElementProperties(kind)
        points = np.zeros((num_nodes, 3))
        points[:, :dim] = np.reshape(local, (num_nodes, dim))
        first = PRIMARY[CELLS[int(kind)][0]]
        _, values, _ = mesh.getBasisFunctions(first, points.ravel(), "Lagrange")
        weights = np.reshape(values, (num_nodes, primary))
        for element in nodes.reshape(len(numbers), -1)[bad]:
            x = np.array([mesh.getNode(node)[0] for node in element])
            straight = weights @ x[:primary]
            for node, old, new in zip(
                element[primary:], x[primary:], straight[primary:], strict=True
            ):
                mesh.setNode(node, (1 - part) * old + part * new, [])
    return moved


def set_size(h: float) -> None:
    """Ask for cells of edge length h [m] everywhere."""
    gmsh.option.setNumber("Mesh.MeshSizeMax", h)
    gmsh.model.mesh.setSize(gmsh.model.getEntities(0), h)


def name_entities(dim: int, names: dict[str, list[int]]) -> None:
    """Make a physical group, numbered from 1, of each name and its entities of dimension `dim`."""
    for tag, (name, entities) in enumerate(names.items(), start=1):
        gmsh.model.addPhysicalGroup(dim, entities, tag, name)


def require_groups(source: str, dim: int) -> None:
    """Name the only entity of dimension `dim` "body" if no physical group holds one.

    Raises:
        ValueError: There are several, so that which of them belong to the body is not plain.
    """
    if gmsh.model.getPhysicalGroups(dim):
        return
    # In a .msh also those count that hold no elements: but what has no cells is no part of it.
    meshed = [tag for _, tag in gmsh.model.getEntities(dim) if _has_elements(dim, tag)]
    entities = meshed or [tag for _, tag in gmsh.model.getEntities(dim)]
    if len(entities) == 1:
        gmsh.model.addPhysicalGroup(dim, entities, name="body")
        return
    kind = {2: "Surface", 3: "Volume"}[dim]
    shown = ", ".join(map(str, entities[:20])) + (", …" if len(entities) > 20 else "")
    raise ValueError(
        f"{source}: no physical group of dimension {dim} names the cells, and there are "
        f'{len(entities)} entities: add Physical {kind}("body") = {{{shown}}}; to the .geo, or '
        f"gmsh.model.addPhysicalGroup({dim}, [{shown}], name='body') before writing the .msh."
    )


def _has_elements(dim: int, entity: int) -> bool:
    return any(len(n) for n in gmsh.model.mesh.getElements(dim, entity)[1])


def extract(source: str, gdim: int | None = None) -> Grid:
    """Turn the current model's mesh, physical groups and views into arrays.

    Args:
        source: What messages call it.
        gdim: Dimension of space; None: 2 for a surface mesh with z = 0, else 3.

    Returns:
        The grid: cells are the elements of highest dimension that are in physical groups; the last
        step of each view of elements or nodes is its data, NaN where there is none.

    Raises:
        ValueError: No elements, no physical groups for them, several cell types, or a gdim that
            does not hold the mesh.
    """
    types = gmsh.model.mesh.getElementTypes()
    tdim = max((gmsh.model.mesh.getElementProperties(t)[1] for t in types), default=0)
    if tdim < 2:
        raise ValueError(
            f"{source}: no triangles, quadrilaterals, tetrahedra or hexahedra found: a .geo needs "
            "surfaces or volumes, a .msh a physical group of them."
        )
    require_groups(source, tdim)
    nodes, coordinates, _ = gmsh.model.mesh.getNodes()
    index = np.full(int(nodes.max()) + 1, -1, dtype=np.int64)
    index[nodes.astype(np.int64)] = np.arange(len(nodes))
    cells, labels = _tagged(source, tdim, index)
    facets, _ = _tagged(source, tdim - 1, index)
    point_data = {}
    for name, kind, numbers, values in _views(source):
        if kind == "ElementData":
            # Labels are unique, but neither sorted nor dense.
            order = np.argsort(labels, kind="stable")
            place = np.minimum(np.searchsorted(labels, numbers, sorter=order), len(labels) - 1)
            rows = order[place]
            found = labels[rows] == numbers
            if found.any():
                cells[0].data[name] = _spread(len(labels), rows[found], values[found])
        else:
            known = (numbers >= 0) & (numbers < len(index))
            known[known] = index[numbers[known]] >= 0
            point_data[name] = _spread(len(nodes), index[numbers[known]], values[known])
    points = coordinates.reshape(-1, 3)
    return assemble(source, points, [*cells, *facets], None, point_data, gdim, labels)


def _spread(
    number: int, rows: NDArray[np.int64], values: NDArray[np.float64]
) -> NDArray[np.float64]:
    whole = np.full((number, *values.shape[1:]), np.nan)
    whole[rows] = values
    return whole


def _views(source: str) -> list[tuple[str, str, NDArray[np.int64], NDArray[np.float64]]]:
    """Data on elements and nodes of the current model: name, kind, numbers, values."""
    found: dict[str, tuple[str, str, NDArray[np.int64], NDArray[np.float64]]] = {}
    for view in gmsh.view.getTags():
        name = gmsh.view.option.getString(view, "Name")
        last = max(0, int(gmsh.view.option.getNumber(view, "NbTimeStep")) - 1)
        try:
            kind, numbers, flat, _, width = gmsh.view.getHomogeneousModelData(view, last)
        except Exception:  # gmsh raises bare Exceptions: a list of shapes, or another model's
            continue
        if kind not in ("ElementData", "NodeData") or not len(numbers):
            continue
        if name in found:
            raise ValueError(f"{source}: two sets of data are named '{name}': rename one.")
        shape = {1: (), 9: (3, 3)}.get(width, (width,))
        values = np.asarray(flat).reshape(len(numbers), *shape)
        found[name] = name, kind, np.asarray(numbers, np.int64), values
    return list(found.values())


def _tagged(
    source: str, dim: int, index: NDArray[np.int64]
) -> tuple[list[Part], NDArray[np.int64]]:
    """Elements of the physical groups of one dimension, each once; and their numbers."""
    found: dict[int, list[tuple[NDArray[np.int64], NDArray[np.int64]]]] = {}
    spans: dict[int, list[tuple[int, int, int]]] = {}
    sets: dict[str, list[tuple[int, int, int]]] = {}
    tags: dict[str, int] = {}
    sizes: dict[int, int] = {}
    for _, tag in gmsh.model.getPhysicalGroups(dim):
        name = gmsh.model.getPhysicalName(dim, tag) or str(tag)
        if name in sets:
            raise ValueError(
                f"{source}: two physical groups of dimension {dim} are named '{name}': rename one."
            )
        sets[name], tags[name] = [], tag
        for entity in gmsh.model.getEntitiesForPhysicalGroup(dim, tag):
            if entity not in spans:
                spans[entity] = []
                elements = zip(*gmsh.model.mesh.getElements(dim, entity), strict=True)
                for kind, numbers, nodes in elements:
                    kind, start = int(kind), sizes.get(int(kind), 0)
                    rows = index[nodes.astype(np.int64)].reshape(len(numbers), -1)
                    # With each view that it appends to a file gmsh writes the mesh once more.
                    _, first = np.unique(numbers, return_index=True)
                    if len(first) < len(numbers):
                        rows, numbers = rows[np.sort(first)], numbers[np.sort(first)]
                    found.setdefault(kind, []).append((rows, numbers.astype(np.int64)))
                    sizes[kind] = start + len(numbers)
                    spans[entity].append((kind, start, sizes[kind]))
            sets[name] += spans[entity]
    if len({CELLS.get(kind, (kind,))[0] for kind in found}) > 1 or not set(found) <= set(CELLS):
        kinds = " and ".join(
            f"{sizes[kind]} of type '{gmsh.model.mesh.getElementProperties(kind)[0]}'"
            for kind in sorted(found)
        )
        raise ValueError(
            f"{source}: the physical groups of dimension {dim} hold {kinds}: a body needs one "
            "type, of triangles, quadrilaterals, tetrahedra or hexahedra of order 1 or 2."
        )
    parts: list[Part] = []
    labels: list[NDArray[np.int64]] = [np.empty(0, np.int64)]
    for kind, pieces in found.items():
        rows = np.concatenate([r for r, _ in pieces])
        labels += [n for _, n in pieces]
        rows = rows[:, from_gmsh_order(CELLS[kind][0], rows.shape[1])]
        part_sets = {}
        for name, those in sets.items():
            members = [np.arange(a, b) for k, a, b in those if k == kind]
            part_sets[name] = np.concatenate([np.empty(0, np.int64), *members])
        parts.append(Part(f"dimension {dim}", CELLS[kind][0], rows, part_sets, tags))
    if not parts and sets:
        name = next(iter(sets))
        raise ValueError(
            f"{source}: the {'boundary' if dim < 3 else 'region'} '{name}' holds no elements of "
            f"the mesh: mesh its entities, or remove the name."
        )
    return parts, np.concatenate(labels)
