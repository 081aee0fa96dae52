# SPDX-License-Identifier: MIT
"""Numbers in HDF5: read by h5py, or without it by DOLFINx what DOLFINx writes."""

from importlib import import_module
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from mpi4py import MPI

import basix
import numpy as np
from dolfinx.io import XDMFFile
from numpy.typing import NDArray

from ._dolfinx import coordinate_element, coordinate_map, create_mesh, geometry_dofmap
from ._parts import Part, sets_of_tags

__all__ = ["has_h5py", "read_by_dolfinx", "read_dataset"]


def has_h5py() -> bool:
    """Whether h5py can be imported."""
    try:
        import_module("h5py")
    except ImportError:
        return False
    return True


def read_dataset(file: Path, place: str) -> NDArray[Any]:
    """Numbers at a place "numbers.h5:/path/of/them" beside an .xdmf."""
    h5py = import_module("h5py")
    name, _, path = place.partition(":")
    with h5py.File(file.parent / name, "r") as data:
        return np.asarray(data[path][()])


def read_by_dolfinx(
    file: Path, grids: list[ElementTree.Element], series: list[ElementTree.Element]
) -> tuple[NDArray[np.float64], list[Part]]:
    """Points, cells, and the tags of cells and facets, each in a grid with one attribute.

    Raises:
        ImportError: There is more in the file than that.
    """
    text = {(i.text or "").strip().split(":")[0] for g in grids for i in g.iter("DataItem")}
    plain = text == {file.with_suffix(".h5").name} and not series
    for grid in grids:
        topology, attributes = grid.find("Topology"), grid.findall("Attribute")
        assert topology is not None
        kind = topology.get("TopologyType", topology.get("Type", ""))
        plain &= kind.lower() != "mixed" and len(attributes) < 2
        own = grid.find("Geometry") is not None and grid is grids[0]
        plain &= not (own and attributes)
    if not plain:
        raise ImportError(
            f"{file.name}: its numbers are in HDF5, and it takes h5py to read all of them, which "
            "cannot be imported: install Debian's python3-h5py, or write them as XML "
            "(meshio: data_format='XML')."
        )
    name = next(g.get("Name", "") for g in grids if g.find("Geometry") is not None)
    parts: list[Part] = []
    with XDMFFile(MPI.COMM_SELF, str(file), "r") as xdmf:
        points = xdmf.read_geometry_data(name)
        shape, order = xdmf.read_cell_type(name)
        cells = xdmf.read_topology_data(name)
        parts.append(Part(name, shape.name, np.asarray(cells, np.int64)))
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
            of_facets = basix.cell.subentity_types(mesh.basix_cell())[tags.dim][0]
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
            sets, numbers = sets_of_tags(tags.values)
            if tags.dim < tdim:
                parts.append(Part(tag_name, of_facets.name, nodes, sets, numbers))
                continue
            cell_of = mesh.topology.original_cell_index[tags.indices]
            parts[0].sets = {key: cell_of[members] for key, members in sets.items()}
            parts[0].tags = numbers
    return points, parts
