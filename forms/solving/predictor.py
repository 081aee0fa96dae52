# SPDX-License-Identifier: MIT
"""The predictor of a load step: one tangent solve that carries the prescribed values along.

K du = -R at free degrees of freedom, du = prescribed - u at the others, so that SNES afterwards
starts from exact boundary values and its residuals are forces only.
"""

from __future__ import annotations

from typing import Any

from petsc4py import PETSc

import numpy as np

from .scaling import EPS


def predict(newton: Any) -> None:
    """Move u to the prescribed values of the present load. Collective.

    Args:
        newton: :class:`forms.solving.newton.Newton`, whose state x becomes the predicted one.
    """
    problem, tangent = newton.problem, newton.tangent
    scaled = tangent.scaled
    tangent.projecting = newton.projection == "always"
    # Measuring leaves the tangent at u behind, which is that of the predictor.
    assembled = scaled.rounding == 0 and not (tangent.projecting or scaled.mixed)
    if scaled.rounding == 0:
        scaled.measure()
    newton.measure_imbalance()
    scaled.get(newton.x)
    jump = newton.x.copy()
    scaled.prescribe(jump)
    jump.axpy(-1, newton.x)
    # A start may miss the supports by rounding: no reason for a step at the whole load.
    missed = jump.norm(PETSc.NormType.INFINITY)
    jump.destroy()
    if missed <= 1e3 * EPS * scaled.size:
        return
    problem.lifted_residual(newton.b)
    newton.b.pointwiseMult(newton.b, scaled.D)
    newton.b.scale(-1)
    # Not the jump itself, a length among forces: it is prescribed below.
    newton.b.array[problem.constrained] = 0
    start = newton.x.copy()
    _carry(newton, assembled)
    for x in (newton.x, start):  # without the carried step where that leaves no finite energy
        scaled.prescribe(x)
        scaled.put(x)
        if not problem.has_energy or np.isfinite(problem.energy()):
            break
    start.destroy()


def _carry(newton: Any, assembled: bool) -> None:
    """Move x by the tangent solve for b, damped where that is singular; else not at all."""
    tangent, du = newton.tangent, newton.b.duplicate()
    damped = tangent.damping is not None
    while True:
        if assembled and not damped:
            tangent.use()
        else:
            tangent.assemble()
        assembled = False
        tangent.ksp.setOperators(tangent.product, tangent.A)
        solved = tangent.solve(newton.b, du)
        if tangent.spoiled:
            break
        if solved and np.isfinite(du.norm()):
            newton.ruined = newton.is_ruined()
            if not newton.ruined:
                newton.x.axpy(1, du)
            break
        if tangent.kept.renew_if_stale() or newton.leave_multigrid():
            continue
        tangent.ksp.reset()  # MUMPS does not forget a failure; multigrid would lose its levels
        if not newton.may_damp():
            break
        if damped and tangent.damping is not None and not tangent.damping.stiffen():
            break
        damped = True
    du.destroy()
