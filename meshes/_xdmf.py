# SPDX-License-Identifier: MIT
"""XDMF files, as DOLFINx and meshio write them, to arrays."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from mpi4py import MPI

import basix
import numpy as np
from dolfinx.io import XDMFFile
from numpy.typing import NDArray

from ._dolfinx import (
    coordinate_element,
    coordinate_map,
    create_mesh,
    from_vtk_order,
    geometry_dofmap,
)
from ._grid import Grid

__all__ = ["read_xdmf"]

# XDMF's topology types: cell and number of nodes. Its numbers appear in a topology of type Mixed.
TYPES = {
    "polyline": ("interval", 2),
    "edge_3": ("interval", 3),
    "triangle": ("triangle", 3),
    "triangle_6": ("triangle", 6),
    "quadrilateral": ("quadrilateral", 4),
    "quadrilateral_9": ("quadrilateral", 9),
    "tetrahedron": ("tetrahedron", 4),
    "tetrahedron_10": ("tetrahedron", 10),
    "hexahedron": ("hexahedron", 8),
    "hexahedron_27": ("hexahedron", 27),
}
SHORT = {"tri_6": "triangle_6", "quad_9": "quadrilateral_9", "tet_10": "tetrahedron_10"}
SHORT |= {"hex_27": "hexahedron_27"}
NUMBERS = {2: "polyline", 4: "triangle", 5: "quadrilateral", 6: "tetrahedron", 9: "hexahedron"}
NUMBERS |= {34: "edge_3", 35: "quadrilateral_9", 36: "triangle_6"}
NUMBERS |= {38: "tetrahedron_10", 50: "hexahedron_27"}


@dataclass
class Entities:
    """Cells or facets of one type in a file: nodes in DOLFINx's order, and tags if it has them."""

    grid: str
    cell: str
    nodes: NDArray[np.int64]
    tags: NDArray[np.int32] | None

    @property
    def dim(self) -> int:
        """Dimension of each entity."""
        return len(basix.topology(basix.CellType[self.cell])) - 1


def read_xdmf(file: Path, gdim: int | None) -> Grid:
    """Read the mesh and the tags of its cells and facets on this process alone.

    Raises:
        ValueError: A file that is no XDMF, is truncated, or holds no mesh that DOLFINx can read.
    """
    try:
        grids = ElementTree.parse(file).getroot().findall("./Domain/Grid")
    except ElementTree.ParseError as error:
        raise ValueError(
            f"{file.name}: it is no whole XML ({error}): it may be truncated, write it again."
        ) from None
    grids = [grid for grid in grids if grid.find("Topology") is not None]
    geometry = next((g for grid in grids if (g := grid.find("Geometry")) is not None), None)
    if geometry is None:
        raise ValueError(f"{file.name}: no grid with Topology and Geometry: it holds no mesh.")
    try:
        if any(item.get("Format") == "HDF" for grid in grids for item in grid.iter("DataItem")):
            points, entities = _read_hdf(file, grids)
        else:
            points = _numbers(file, geometry).astype(np.float64)
            entities = [e for grid in grids for e in _entities(file, grid)]
    except (RuntimeError, OSError, KeyError, IndexError, ValueError) as error:
        raise ValueError(f"{file.name}: {error}: it may be truncated, write it again.") from error
    return _grid(file.name, points, entities, gdim)


def _grid(
    source: str, points: NDArray[np.float64], entities: list[Entities], gdim: int | None
) -> Grid:
    tdim = max((e.dim for e in entities), default=0)
    cells, kinds = [e for e in entities if e.dim == tdim], sorted({e.cell for e in entities})
    if tdim < 2 or len({(e.cell, e.nodes.shape[1]) for e in cells}) != 1:
        raise ValueError(
            f"{source}: it holds {' and '.join(kinds)} cells: a body needs one type, of triangles, "
            "quadrilaterals, tetrahedra or hexahedra."
        )
    # DOLFINx writes tagged cells a second time, in a grid of their own.
    mesh = cells[0]
    tagged = [e for e in cells if e.tags is not None]
    facets = [e for e in entities if e.dim == tdim - 1 and e.tags is not None]
    for found in tagged, facets:
        if len({e.grid for e in found}) > 1:
            raise ValueError(
                f"{source}: {len(found)} sets of tags of dimension {found[0].dim} "
                f"({', '.join(e.grid for e in found)}): write one, so that each has one name."
            )
    regions: NDArray[np.int32] = np.full(len(mesh.nodes), -1, dtype=np.int32)
    if tagged and tagged[0].tags is not None:
        nodes, marks = np.sort(mesh.nodes, axis=1), np.sort(tagged[0].nodes, axis=1)
        _, where = np.unique(np.vstack([nodes, marks]), axis=0, return_inverse=True)
        tag_of = np.full(where.max() + 1, -1, dtype=np.int32)
        tag_of[where.ravel()[len(nodes) :]] = tagged[0].tags
        regions = tag_of[where.ravel()[: len(nodes)]]
    region_names = {str(tag): int(tag) for tag in np.unique(regions[regions != -1])}
    if (regions == -1).any():
        region_names["body"] = max(region_names.values(), default=0) + 1
        regions[regions == -1] = region_names["body"]
    order = {3: 1, 6: 2, 4: 1, 9: 2, 10: 2, 8: 1, 27: 2}[mesh.nodes.shape[1]]
    facet = basix.cell.subentity_types(basix.CellType[mesh.cell])[tdim - 1][0]
    num_nodes = coordinate_element(facet.name, order, tdim).basix_element.dim
    on: NDArray[np.int64] = np.empty((0, num_nodes), np.int64)
    tags: NDArray[np.int32] = np.empty(0, np.int32)
    if facets and facets[0].tags is not None:
        on, tags = facets[0].nodes, facets[0].tags
    if points.shape[1] == 3 and tdim == 2 and not points[:, 2].any() and gdim is None:
        gdim = 2
    if gdim == 2 and (tdim == 3 or points[:, 2:].any()):
        raise ValueError(f"{source}: gdim=2 needs a surface mesh with z = 0 at all nodes, pass 3.")
    x = np.zeros((len(points), 3))
    x[:, : points.shape[1]] = points
    names = {str(tag): int(tag) for tag in np.unique(tags)}
    return Grid(
        source,
        mesh.cell,
        order,
        gdim or points.shape[1],
        x,
        mesh.nodes,
        regions,
        on,
        tags,
        region_names,
        names,
    )


def _entities(file: Path, grid: ElementTree.Element) -> list[Entities]:
    """Entities of one grid whose numbers are in the file itself, or in raw binary beside it."""
    topology = grid.find("Topology")
    if topology is None:
        return []
    name = grid.get("Name", "")
    kind = topology.get("TopologyType", topology.get("Type", "")).lower()
    kind = SHORT.get(kind, kind)
    numbers = _numbers(file, topology).astype(np.int64)
    rows: dict[str, list[NDArray[np.int64]]] = {}
    places: dict[str, list[int]] = {}
    if kind == "mixed":
        flat, at, count = numbers.ravel(), 0, 0
        while at < len(flat):
            kind = NUMBERS[int(flat[at])]
            at += 2 if kind == "polyline" else 1
            length = TYPES[kind][1]
            rows.setdefault(kind, []).append(flat[at : at + length])
            places.setdefault(kind, []).append(count)
            at, count = at + length, count + 1
    elif kind in TYPES:
        rows[kind] = list(numbers.reshape(-1, TYPES[kind][1]))
        places[kind] = list(range(len(rows[kind])))
    else:
        raise ValueError(f"its topology type '{kind}' is not one of {', '.join(TYPES)}")
    attributes = [a for a in grid.findall("Attribute") if a.get("Center") == "Cell"]
    # meshio keeps gmsh's physical groups under this name, beside others.
    attributes.sort(key=lambda a: a.get("Name") != "gmsh:physical")
    values = _numbers(file, attributes[0]).ravel() if attributes else None
    if values is not None and (values != np.round(values)).any():
        values = None  # a field, not tags
    found = []
    for kind, nodes in rows.items():
        cell, length = TYPES[kind]
        array = np.array(nodes)[:, from_vtk_order(cell, length)]
        tags = None if values is None else values[places[kind]].astype(np.int32)
        found.append(Entities(name, cell, array, tags))
    return found


def _numbers(file: Path, parent: ElementTree.Element) -> NDArray[Any]:
    """Numbers of the DataItem in an element, in the shape that it states."""
    item = parent.find("DataItem")
    if item is None or item.text is None:
        raise ValueError(f"no numbers in a {parent.tag}")
    shape = [int(n) for n in item.get("Dimensions", "").split()]
    whole = item.get("DataType", item.get("NumberType", "Float")) in ("Int", "UInt")
    size = item.get("Precision", "4")
    if item.get("Format") == "Binary":
        dtype = np.dtype(f"{'i' if whole else 'f'}{size}")
        data: NDArray[Any] = np.fromfile(file.parent / item.text.strip(), dtype)
    else:
        data = np.array(item.text.split(), dtype=np.int64 if whole else np.float64)
    return data.reshape(shape)


def _read_hdf(
    file: Path, grids: list[ElementTree.Element]
) -> tuple[NDArray[np.float64], list[Entities]]:
    """The same from a file whose numbers are in HDF5, by DOLFINx."""
    for item in (item for grid in grids for item in grid.iter("DataItem")):
        data = (item.text or "").strip().split(":")[0]
        if not (file.parent / data).is_file():
            raise ValueError(f"its numbers are in '{data}', which is not beside it")
    name = next(g.get("Name", "") for g in grids if g.find("Geometry") is not None)
    entities = []
    with XDMFFile(MPI.COMM_SELF, str(file), "r") as xdmf:
        points = xdmf.read_geometry_data(name)
        shape, order = xdmf.read_cell_type(name)
        cells = xdmf.read_topology_data(name)
        entities.append(Entities(name, shape.name, np.asarray(cells, np.int64), None))
        element = coordinate_element(shape.name, order, points.shape[1])
        mesh = create_mesh(MPI.COMM_SELF, element, points, cells)
        tdim, geometry = mesh.topology.dim, mesh.geometry
        for dim in tdim - 1, tdim:
            mesh.topology.create_connectivity(dim, 0)
            mesh.topology.create_connectivity(dim, tdim)
            mesh.topology.create_connectivity(tdim, dim)
        for grid in grids:
            attribute, tag_name = grid.find("Attribute"), grid.get("Name", "")
            if attribute is None or attribute.get("Center") != "Cell":
                continue
            tags = xdmf.read_meshtags(mesh, tag_name)
            kind = mesh.basix_cell() if tags.dim == tdim else None
            kind = kind or basix.cell.subentity_types(mesh.basix_cell())[tags.dim][0]
            layout = coordinate_map(geometry).create_dof_layout()
            number = len(basix.topology(mesh.basix_cell())[tags.dim])
            closure = np.array([layout.entity_closure_dofs(tags.dim, i) for i in range(number)])
            to_cell = mesh.topology.connectivity(tags.dim, tdim)
            owner = to_cell.array[to_cell.offsets[tags.indices]]
            local = np.zeros(len(owner), dtype=np.int64)
            if tags.dim < tdim:
                sides = mesh.topology.connectivity(tdim, tags.dim).array.reshape(-1, number)
                local = np.argmax(sides[owner] == tags.indices[:, None], axis=1)
            dofs = geometry_dofmap(geometry)[owner[:, None], closure[local]]
            nodes = geometry.input_global_indices[dofs]
            entities.append(Entities(tag_name, kind.name, nodes, tags.values.astype(np.int32)))
    return points, entities
