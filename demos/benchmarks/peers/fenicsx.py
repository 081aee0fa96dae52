# SPDX-License-Identifier: MIT
"""The block as a DOLFINx mesh, for vanilla DOLFINx and for variform alike."""

from pathlib import Path

from mpi4py import MPI

import basix.ufl
import numpy as np
from dolfinx import fem, mesh

from .problem import block

COMM = MPI.COMM_WORLD


def create(m):
    """Mesh of the block, and the facets of its two ends."""
    points, cells = block(m)
    if COMM.rank:
        cells, points = cells[:0], points[:0]
    element = basix.ufl.element("Lagrange", "tetrahedron", 1, shape=(3,))
    body = mesh.create_mesh(COMM, cells=cells, x=points, e=element)
    ends = [
        mesh.locate_entities_boundary(body, 2, lambda x, at=at: np.isclose(x[0], at))
        for at in (0.0, 1.0)
    ]
    return body, *ends


def blas():
    """Which BLAS this process has loaded: on it the factorizations hang."""
    maps = Path("/proc/self/maps")
    text = maps.read_text() if maps.exists() else ""
    return "OpenBLAS" if "openblas" in text else "reference" if "libblas" in text else "unknown"


def at_vertices(u):
    """Displacements of the vertices in the order of :func:`.problem.block`, on rank 0."""
    body = u.function_space.mesh
    V1 = fem.functionspace(body, ("Lagrange", 1, (3,)))
    u1 = fem.Function(V1)
    u1.interpolate(u)
    owned = body.topology.index_map(3).size_local
    dofmap = body.geometry.dofmap[:owned].ravel()
    numbers = body.geometry.input_global_indices[dofmap]
    values = u1.x.array.reshape(-1, 3)[V1.dofmap.list[:owned].ravel()]
    parts = COMM.gather((numbers, values), root=0)
    if parts is None:
        return None
    result = np.empty((1 + max(n.max() for n, _ in parts), 3))
    for numbers, values in parts:
        result[numbers] = values
    return result
