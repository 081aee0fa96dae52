# SPDX-License-Identifier: MIT
"""What the diagonal of a tangent tells: a typical stiffness, which fields are pressures."""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from ...problems import Problem


def typical_diagonal(A: PETSc.Mat, free: np.ndarray) -> float:
    """Geometric mean of |A_ii| over rows given by local numbers, on all ranks; 0 if all are 0.

    The mean and not the maximum: a few stiff springs are no measure of the body's forces.
    """
    d = np.abs(A.getDiagonal().array_r[free])
    d = d[d > 0]
    total, count = A.comm.tompi4py().allreduce(np.array([np.log(d).sum(), d.size]))
    return float(np.exp(total / count)) if count else 0.0


def pressures(problem: Problem, A: PETSc.Mat) -> int:
    """Degrees of freedom of pressures and other multipliers, that are not supported. Collective.

    By the roles of the fields; of one without a declared role the block -C of the tangent has no
    positive entry on its diagonal. Each of them makes one eigenvalue negative.

    Args:
        problem: Problem of one field or several.
        A: Its assembled tangent, scaled or not.
    """
    total = 0
    for field in problem.fields.values():
        if field.role.curvature == "+":
            continue
        own = np.setdiff1d(field.dofs, problem.constrained)
        if field.role.curvature == "?" and has_positive(A, own):
            continue
        total += int(problem.comm.allreduce(len(own)))
    return total


def has_positive(A: PETSc.Mat, rows: np.ndarray) -> bool:
    """Whether a diagonal entry of some rows, by local numbers, is positive on any rank."""
    found = bool(np.any(A.getDiagonal().array_r[rows] > 0))
    return bool(A.comm.tompi4py().allreduce(found, MPI.LOR))
