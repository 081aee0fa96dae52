# SPDX-License-Identifier: MIT
"""What the diagonal of a tangent tells: a typical stiffness, which fields are pressures."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np

from ... import _dolfinx
from ...assembly import System
from ...supports import is_mixed


def typical_diagonal(A: PETSc.Mat, free: np.ndarray) -> float:
    """Geometric mean of |A_ii| over rows given by local numbers, on all ranks; 0 if all are 0.

    The mean and not the maximum: a few stiff springs are no measure of the body's forces.
    """
    d = np.abs(A.getDiagonal().array_r[free])
    d = d[d > 0]
    total, count = A.comm.tompi4py().allreduce(np.array([np.log(d).sum(), d.size]))
    return float(np.exp(total / count)) if count else 0.0


def pressures(system: System, A: PETSc.Mat) -> int:
    """Degrees of freedom of fields beside the displacement that are no minimum of the potential.

    Of pressures and other multipliers: their block -C of the tangent has no positive entry on its
    diagonal, and each of them makes one eigenvalue negative. Collective.

    Args:
        system: System of one field or several.
        A: Its assembled tangent, scaled or not.
    """
    V = system.u.function_space
    if not is_mixed(V):
        return 0
    diagonal, total = A.getDiagonal().array_r, 0
    for field in range(1, V.num_sub_spaces):
        numbers = _dolfinx.collapse(V.sub(field))[1]
        own = np.setdiff1d(numbers[numbers < len(diagonal)], system.constrained)
        positive, count = system.comm.allreduce(np.array([(diagonal[own] > 0).sum(), len(own)]))
        total += 0 if positive else int(count)
    return total
