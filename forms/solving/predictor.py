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
    problem, tangent, runs = newton.problem, newton.tangent, newton.runs
    scaled = tangent.scaled
    tangent.projecting = newton.projection == "always"
    # Measuring leaves the tangent at u behind, which is that of the predictor.
    assembled = scaled.rounding == 0 and not (tangent.projecting or scaled.mixed)
    if scaled.rounding == 0:
        scaled.measure()
    newton.measure_imbalance()
    scaled.get(runs.x)
    jump = runs.x.copy()
    scaled.prescribe(jump)
    jump.axpy(-1, runs.x)
    # A start may miss the supports by rounding: no reason for a step at the whole load.
    missed = jump.norm(PETSc.NormType.INFINITY)
    jump.destroy()
    if missed <= 1e3 * EPS * scaled.size:
        return
    problem.lifted_residual(runs.b)
    runs.b.pointwiseMult(runs.b, scaled.D)
    runs.b.scale(-1)
    # Not the jump itself, a length among forces: it is prescribed below.
    problem.clear(runs.b.array)
    start = runs.x.copy()
    _carry(newton, assembled)
    # Without the carried step where that leaves no finite energy, or crosses an obstacle.
    for x in (runs.x, start):
        scaled.prescribe(x)
        scaled.put(x)
        if (not problem.has_energy or np.isfinite(problem.energy())) and not problem.crossed():
            break
    start.destroy()


def _carry(newton: Any, assembled: bool) -> None:
    """Move x by the tangent solve for b, damped where that is singular; else not at all."""
    tangent, runs = newton.tangent, newton.runs
    du = runs.b.duplicate()
    damped = tangent.damping is not None
    while True:
        if assembled and not damped:
            tangent.use()
        else:
            tangent.assemble()
        assembled = False
        tangent.ksp.setOperators(tangent.product, tangent.A)
        solved = tangent.solve(runs.b, du)
        if tangent.spoiled:
            break
        if solved and np.isfinite(du.norm()):
            runs.ruined = newton.is_ruined()
            if not runs.ruined:
                runs.x.axpy(1, du)
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
