# SPDX-License-Identifier: MIT
"""gmsh: a session that leaves the user's own alone, and the way from a model to arrays."""

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ._dolfinx import from_gmsh_order
from ._grid import Grid

__all__ = [
    "extract",
    "generate",
    "gmsh",
    "merge",
    "name_entities",
    "require_groups",
    "session",
    "set_size",
]

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

# Everything that decides what is meshed, so that neither the user's session nor a ~/.gmshrc does.
OPTIONS = {
    "General.Terminal": 0,
    "General.NumThreads": 1,
    "Mesh.Algorithm": 6,
    "Mesh.Algorithm3D": 1,
    "Mesh.ElementOrder": 1,
    "Mesh.HighOrderOptimize": 0,
    "Mesh.MeshSizeExtendFromBoundary": 1,
    "Mesh.MeshSizeFactor": 1,
    "Mesh.MeshSizeFromCurvature": 0,
    "Mesh.MeshSizeFromPoints": 1,
    "Mesh.MeshSizeMax": 1e22,
    "Mesh.MeshSizeMin": 0,
    "Mesh.RecombineAll": 0,
    "Mesh.SecondOrderIncomplete": 0,
    "Mesh.SecondOrderLinear": 0,
}

_numbers = count(1)


class _Gmsh:
    """The module gmsh, imported when it is first used: bodies from XDMF go without."""

    def __getattr__(self, name: str) -> Any:
        try:
            module = import_module("gmsh")
        except ImportError as error:
            raise ImportError(
                f"this body is meshed or read by gmsh, which cannot be imported ({error}): install "
                "Debian's python3-gmsh or variform's extra 'meshes', or read an .xdmf."
            ) from error
        return getattr(module, name)


gmsh = _Gmsh()


@contextmanager
def session() -> Iterator[None]:
    """An empty current gmsh model, quiet, with settled options.

    A session that is already running goes on afterwards with its models, its current model and its
    options as they were; otherwise one is started and finalized.
    """
    started = not gmsh.isInitialized()
    if started:
        # No handler for Ctrl-C: it can be installed in the main thread only.
        gmsh.initialize(readConfigFiles=False, interruptible=False)
    saved = {name: gmsh.option.getNumber(name) for name in OPTIONS}
    current, models = gmsh.model.getCurrent(), set(gmsh.model.list())
    try:
        for name, value in OPTIONS.items():
            gmsh.option.setNumber(name, value)
        gmsh.model.add(next(n for i in _numbers if (n := f"variform{i}") not in models))
        yield
    finally:
        if started:
            gmsh.finalize()
        else:
            for name in set(gmsh.model.list()) - models:
                gmsh.model.setCurrent(name)
                gmsh.model.remove()
            if current in models:
                gmsh.model.setCurrent(current)
            for name, value in saved.items():
                gmsh.option.setNumber(name, value)


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


def merge(path: str) -> None:
    """Read a file into the current model.

    Raises:
        Exception: gmsh's own, when it cannot.
    """
    try:
        gmsh.merge(path)
    except Exception:
        # gmsh's parser keeps the unread rest of a script with an error, and would take it for the
        # start of the next one: let it swallow harmless ones until it has done with the rest.
        with TemporaryDirectory() as folder:
            harmless = Path(folder, "harmless.geo")
            harmless.write_text("Mesh.MeshSizeFactor = 1;\n")
            for _ in range(1000):
                try:
                    gmsh.merge(str(harmless))
                    break
                except Exception:
                    continue
        raise


def name_entities(dim: int, names: dict[str, list[int]]) -> None:
    """Make a physical group, numbered from 1, of each name and its entities of dimension `dim`."""
    for tag, (name, entities) in enumerate(names.items(), start=1):
        gmsh.model.addPhysicalGroup(dim, entities, tag, name)


def require_groups(source: str, dim: int) -> None:
    """Raise ValueError if no physical group holds cells of dimension `dim`."""
    if not gmsh.model.getPhysicalGroups(dim):
        entity = {2: "Surface", 3: "Volume"}[dim]
        raise ValueError(
            f"{source}: no physical group of dimension {dim} names the cells: add "
            f'Physical {entity}("body") = {{1}}; to the .geo, or '
            f"gmsh.model.addPhysicalGroup({dim}, [1], name='body') before writing the .msh."
        )


def extract(source: str, gdim: int | None = None) -> Grid:
    """Turn the current model's mesh and physical groups into arrays.

    Args:
        source: What messages call it.
        gdim: Dimension of space; None: 2 for a surface mesh with z = 0, else 3.

    Returns:
        The grid: cells are the elements of highest dimension that are in physical groups.

    Raises:
        ValueError: No elements, no physical groups for them, several cell types, an entity in two
            groups, or a gdim that does not hold the mesh.
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
    index = np.zeros(int(nodes.max()) + 1, dtype=np.int64)
    index[nodes.astype(np.int64)] = np.arange(len(nodes))
    points = coordinates.reshape(-1, 3)

    cell_type, cells, regions, labels, region_names = _tagged(source, tdim, 0, index)
    cell, order = CELLS[cell_type]
    facet_type = {"triangle": 1, "quadrilateral": 1, "tetrahedron": 2, "hexahedron": 3}[cell]
    facet_type += {1: 0, 2: 7}[order]
    _, facets, boundaries, _, boundary_names = _tagged(source, tdim - 1, facet_type, index)
    used = points[np.unique(cells)]
    flat = tdim == 2 and bool((used[:, 2] == 0).all())
    if gdim is None:
        gdim = 2 if flat else 3
    elif gdim == 2 and not flat:
        raise ValueError(f"{source}: gdim=2 needs a surface mesh with z = 0 at all nodes, pass 3.")
    return Grid(
        source,
        cell,
        order,
        gdim,
        points,
        cells,
        regions,
        facets,
        boundaries,
        region_names,
        boundary_names,
        labels,
    )


def _tagged(
    source: str, dim: int, wanted: int, index: NDArray[np.int64]
) -> tuple[int, NDArray[np.int64], NDArray[np.int32], NDArray[np.int64], dict[str, int]]:
    """Elements of the physical groups of one dimension: type, nodes, tags, numbers, names."""
    names: dict[str, int] = {}
    owner: dict[int, str] = {}
    found: dict[int, list[tuple[NDArray[np.int64], NDArray[np.int64], int]]] = {}
    for _, tag in gmsh.model.getPhysicalGroups(dim):
        name = gmsh.model.getPhysicalName(dim, tag) or str(tag)
        if name in names:
            raise ValueError(
                f"{source}: two physical groups of dimension {dim} are named '{name}': rename one."
            )
        names[name] = tag
        for entity in gmsh.model.getEntitiesForPhysicalGroup(dim, tag):
            if entity in owner:
                raise ValueError(
                    f"{source}: entity {entity} of dimension {dim} is in both '{owner[entity]}' "
                    f"and '{name}': put it in one physical group only."
                )
            owner[entity] = name
            for kind, numbers, nodes in zip(*gmsh.model.mesh.getElements(dim, entity), strict=True):
                rows = index[nodes.astype(np.int64)].reshape(len(numbers), -1)
                found.setdefault(int(kind), []).append((rows, numbers.astype(np.int64), tag))
    allowed = {wanted} if wanted else {t for t in found if t in CELLS}
    if len(found) > 1 or not set(found) <= allowed:
        kinds = " and ".join(
            f"{sum(len(r) for r, _, _ in found[t])} of type "
            f"'{gmsh.model.mesh.getElementProperties(t)[0]}'"
            for t in sorted(found)
        )
        raise ValueError(
            f"{source}: the physical groups of dimension {dim} hold {kinds}: a body needs one "
            "type, of triangles, quadrilaterals, tetrahedra or hexahedra of order 1 or 2."
        )
    kind = wanted or next(iter(found))
    num_nodes = gmsh.model.mesh.getElementProperties(kind)[3]
    parts = found.get(kind, [])
    rows = np.concatenate([r for r, _, _ in parts] or [np.empty((0, num_nodes), np.int64)])
    numbers = np.concatenate([n for _, n, _ in parts] or [np.empty(0, np.int64)])
    tags = np.concatenate(
        [np.full(len(r), tag, np.int32) for r, _, tag in parts] or [np.empty(0, np.int32)]
    )
    return kind, rows[:, from_gmsh_order(CELLS[kind][0], num_nodes)], tags, numbers, names
