# SPDX-License-Identifier: MIT
"""The only file of the package that depends on DOLFINx's version.

Tested with 0.9 and 0.11.  `dolfinx.io.gmshio` became `dolfinx.io.gmsh` in 0.10 and returns another
tuple there; both take the mesh from a gmsh model without checking it, so the package hands arrays
over itself and needs only the few names below.
"""

from typing import Any

from mpi4py import MPI

import basix
import basix.ufl
import dolfinx
import numpy as np
import ufl
from dolfinx import cpp, graph
from dolfinx.io.utils import distribute_entity_data
from dolfinx.mesh import Mesh, MeshTags, meshtags_from_entities, to_type
from numpy.typing import NDArray

__all__ = [
    "coordinate_element",
    "coordinate_map",
    "create_mesh",
    "create_tagged_mesh",
    "from_gmsh_order",
    "from_vtk_order",
    "geometry_dofmap",
]


def from_gmsh_order(cell: str, num_nodes: int) -> NDArray[np.int64]:
    """Permutation p with dolfinx_nodes[i] = gmsh_nodes[p[i]] of one cell or facet."""
    return np.array(cpp.io.perm_gmsh(to_type(cell), num_nodes), dtype=np.int64)


def from_vtk_order(cell: str, num_nodes: int) -> NDArray[np.int64]:
    """Permutation p with dolfinx_nodes[i] = vtk_nodes[p[i]], the order of XDMF too."""
    return np.array(cpp.io.perm_vtk(to_type(cell), num_nodes), dtype=np.int64)


def coordinate_element(cell: str, order: int, gdim: int) -> basix.ufl._ElementBase:
    """Lagrange element of the given order for the coordinates, equispaced as gmsh's nodes are."""
    variant = basix.LagrangeVariant.equispaced
    return basix.ufl.element("Lagrange", cell, order, variant, shape=(gdim,))


def create_mesh(
    comm: MPI.Comm,
    element: basix.ufl._ElementBase,
    points: NDArray[np.float64],
    cells: NDArray[np.int64],
) -> Mesh:
    """Distribute a mesh; collective. Arguments as :func:`create_tagged_mesh`."""
    # By name: 0.10 put the element before the points.
    return dolfinx.mesh.create_mesh(comm, cells=cells, x=points, e=ufl.Mesh(element))


def coordinate_map(geometry: Any) -> Any:
    """Coordinate element of a mesh's geometry (0.11: a list of them, one per cell type)."""
    return geometry.cmaps[0] if hasattr(geometry, "cmaps") else geometry.cmap


def geometry_dofmap(geometry: Any) -> NDArray[np.int32]:
    """Geometry nodes of each local cell, shape (cells, nodes) (0.11: a list, as above)."""
    return geometry.dofmaps[0] if hasattr(geometry, "cmaps") else geometry.dofmap


def create_tagged_mesh(
    comm: MPI.Comm,
    element: basix.ufl._ElementBase,
    points: NDArray[np.float64],
    cells: NDArray[np.int64],
    regions: NDArray[np.int32],
    facets: NDArray[np.int64],
    boundaries: NDArray[np.int32],
) -> tuple[Mesh, MeshTags, MeshTags]:
    """Distribute a mesh given in shares, with its cell and facet tags. Collective.

    Args:
        comm: Communicator.
        element: Coordinate element, the same on all ranks.
        points: This rank's share of the coordinates, shape (N, gdim); so are the others.
        cells: Nodes of the cells in DOLFINx's order, shape (number of cells, nodes per cell).
        regions: Tag of each cell.
        facets: Nodes of the tagged facets, in DOLFINx's order.
        boundaries: Tag of each of these facets.

    Returns:
        The mesh without ghost cells, the cell tags, the facet tags.
    """
    mesh = create_mesh(comm, element, points, cells)
    tdim = mesh.topology.dim
    mesh.topology.create_connectivity(tdim, tdim - 1)
    mesh.topology.create_connectivity(tdim - 1, tdim)
    tags = []
    for dim, entities, values in (tdim, cells, regions), (tdim - 1, facets, boundaries):
        mesh.topology.create_connectivity(dim, 0)
        local, local_values = distribute_entity_data(mesh, dim, entities, values)
        # Not the C++ class itself: 0.11 takes its wrapper only.
        adjacency = graph.adjacencylist(np.asarray(local, dtype=np.int32))
        tags.append(
            meshtags_from_entities(mesh, dim, adjacency, local_values.astype(np.int32, copy=False))
        )
    tags[0].name, tags[1].name = "regions", "boundaries"
    return mesh, tags[0], tags[1]
