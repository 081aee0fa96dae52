# SPDX-License-Identifier: MIT
"""Conjugate gradients that stop by the energy of their error, estimated as they go."""

from __future__ import annotations

from collections.abc import Callable

from petsc4py import PETSc

PAST = 3  # decreases that tell of those to come
SLOWEST = 0.95  # contraction of the squared error that is reckoned with at most


def conjugate_gradients(
    A: PETSc.Mat,
    pc: PETSc.PC,
    x: PETSc.Vec,
    r: PETSc.Vec,
    near: Callable[[PETSc.Vec, PETSc.Vec], float],
    least: float,
    most: int,
) -> tuple[bool, int]:
    """Improve x until |x* - x|_K^2 <= near(x, r), or |r| <= least. Collective.

    |x* - x_k|_K^2 = sum_{j >= k} alpha_j r_j . z_j  (Hestenes, Stiefel): the squared error is the
    sum of the decreases to come, here that of a geometric series with the ratio of the last ones.
    PETSc's CG tells a test of convergence none of its step lengths alpha.

    Args:
        A: K, symmetric.
        pc: Preconditioner, symmetric, positive definite.
        x: Start; afterwards the last iterate.
        r: b - K x; afterwards of the last iterate.
        near: Function of x and r that returns the squared error in energy to be reached.
        least: Norm of r that is enough in any case.
        most: Iterations at most.

    Returns:
        Whether x is near enough, and the iterations; False, too, where K or the preconditioner is
        seen not to be positive definite.

    Source: Hestenes, Stiefel, J. Res. Natl. Bur. Stand. 49 (1952), theorem 6:1.
    """
    z, p, q = (r.duplicate() for _ in range(3))
    decreases: list[float] = []
    before, reached = 0.0, r.norm() <= least
    while not reached and len(decreases) < most:
        pc.apply(r, z)
        product = r.dot(z)
        if not product > 0:
            break
        if decreases:
            p.aypx(product / before, z)
        else:
            z.copy(p)
        A.mult(p, q)
        work = p.dot(q)
        if not work > 0:
            break
        x.axpy(product / work, p)
        r.axpy(-product / work, q)
        decreases.append(product**2 / work)
        before = product
        reached = bool(_to_come(decreases) <= near(x, r) or r.norm() <= least)
    for vector in (z, p, q):
        vector.destroy()
    return reached, len(decreases)


def _to_come(decreases: list[float]) -> float:
    """Sum of the decreases to come, of the last ones; infinite where too few are known."""
    if len(decreases) < PAST:
        return float("inf")
    last, middle, first = decreases[-1], decreases[-2], decreases[-PAST]
    ratio = min(max(last / middle, (last / first) ** (1 / (PAST - 1))), SLOWEST)
    return last * ratio / (1 - ratio)
