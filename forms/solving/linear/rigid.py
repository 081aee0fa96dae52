# SPDX-License-Identifier: MIT
"""Rigid motions, which multigrid by aggregation has to know."""

from __future__ import annotations

from petsc4py import PETSc

from dolfinx import fem


def rigid_modes(V: fem.FunctionSpace) -> PETSc.NullSpace:
    """Rigid translations and rotations of a vector space, orthonormal. Collective."""
    dim = V.mesh.geometry.dim
    x = V.tabulate_dof_coordinates()
    modes = []
    planes = [(0, 1)] if dim == 2 else [(0, 1), (1, 2), (2, 0)]
    for n in range(dim + len(planes)):
        mode = fem.Function(V)
        values = mode.x.array.reshape(-1, dim)
        if n < dim:
            values[:, n] = 1
        else:
            i, j = planes[n - dim]
            values[:, i], values[:, j] = -x[:, j], x[:, i]
        modes.append(mode.x.petsc_vec.copy())
    for n, mode in enumerate(modes):
        for other in modes[:n]:
            mode.axpy(-mode.dot(other), other)
        mode.normalize()
    return PETSc.NullSpace().create(vectors=modes, comm=V.mesh.comm)
