# SPDX-License-Identifier: MIT
"""Two blocks of different meshes on each other, as a body."""

from demos.benchmarks import stacks
from variform import meshes


def stack(comm, below, above, gap, dim=2):
    """Two unit blocks of below and above cells along each edge, a gap between them."""
    points, cells, names = stacks.stack(below, above, gap, dim)
    kind = {2: "quadrilateral", 3: "hexahedron"}[dim]
    return meshes.from_arrays(comm, points, cells, cell=kind, boundaries=names)
