# SPDX-License-Identifier: MIT
"""Newton's method by PETSc SNES, with the energy as its objective and named, unit-free norms."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from petsc4py import PETSc

import numpy as np

from ..paths import REASONS, Convergence
from ..problems import Problem
from .criteria import Criteria
from .finite import explained, undefined
from .ladder import Failure, Merit, Way
from .options import SolverOptions
from .predictor import predict
from .settings import Settings
from .snes import CONVERGED, Runs
from .tangents import Tangent

PROJECTIONS = ("auto", "always", "never")


class Newton:
    """SNES on a problem, reused from load step to load step.

    When it has converged :class:`forms.solving.criteria.Criteria` say. Where the problem is a
    minimization the line search lowers the energy until |R_free| is a thousandth of the force
    level, then |R|; otherwise |R| from the start. It refuses a trial state whose energy or residual
    is not finite. After a failure the same state goes on by the first of
    :data:`forms.solving.ladder.LADDER`'s ways that fits.

    Args:
        problem: What to solve.
        options: PETSc options without prefix, over the presets; those in PETSc's database, and on
            the command line, win over both.
        prefix: Prefix of the options there, as in ``-variform_snes_monitor``. The solver's own
            prefix in the database, as ``variform_1_``, is unique: nothing of the user's is changed.
        rtol: Tolerance of the residual; the option snes_rtol goes over it, and snes_atol [N] sets
            an absolute one (none by default).
        ctol: Tolerance of the last correction, relative to the model's size.
        projection: When to make the tangent positive semi-definite (:meth:`Problem.tangent`), so
            that its direction lowers the energy from any state: "auto", after the search along the
            full tangent's has failed, or at once where MUMPS counts more than a twentieth of its
            eigenvalues negative; "always", from the start; "never". Near the solution the full
            tangent is used again, so that convergence is quadratic.
        settings: Numbers that it is tuned by, and the ladder.

    Raises:
        ValueError: another word, or "always" where there is no potential to be minimized.
    """

    criteria: Criteria
    _crept: PETSc.Vec | None

    def __init__(
        self,
        problem: Problem,
        options: Mapping[str, Any] | None = None,
        prefix: str = "variform_",
        rtol: float = 1e-8,
        ctol: float = 1e-6,
        projection: str = "auto",
        settings: Settings | None = None,
    ) -> None:
        if projection not in PROJECTIONS:
            raise ValueError(f"projection is one of {', '.join(PROJECTIONS)}, got {projection!r}.")
        if projection == "always":
            problem.prepare_projection()
        self.problem, self.projection = problem, projection
        self.settings = settings or Settings()
        self.options = SolverOptions(prefix, options)
        user = self.options.user
        self.tangent = Tangent(problem, self.options, self.settings, lambda: self.criteria.start)
        rtol, atol = float(user.get("snes_rtol", rtol)), float(user.get("snes_atol", 0.0))
        self.criteria = Criteria(self.tangent.scaled, rtol, ctol, atol)
        self.runs = Runs(
            problem, self.tangent, self.criteria, self.options, self.settings, self.is_ruined
        )
        self._solved = False

    @property
    def snes(self) -> PETSc.SNES:
        """SNES of the first way."""
        return self.runs.snes

    def predict(self) -> None:
        """Move u by one tangent solve that carries the prescribed values to the present load.

        Collective; see :mod:`forms.solving.predictor`.
        """
        predict(self)

    def solve(self) -> Convergence:
        """Newton iterations from u's present values, supports applied; u is left at the last one.

        Collective. Call :meth:`predict` first when prescribed values have changed.
        """
        problem, scaled, runs = self.problem, self.tangent.scaled, self.runs
        if scaled.rounding == 0:
            scaled.measure()
        if self.criteria.imbalance is None:
            self.measure_imbalance()
        if self.tangent.kept.slow:
            self.leave_multigrid()
        scaled.get(runs.x)
        scaled.prescribe(runs.x)
        scaled.put(runs.x)
        crossed = problem.crossed()
        if crossed or (problem.has_energy and not np.isfinite(problem.energy())):
            self.criteria.imbalance = None
            why = crossed or undefined(problem)
            return Convergence(False, why, -1, 0, 0, 0, np.inf, 0.0, np.inf)
        self.used()
        ruined, runs.ruined, runs.until = runs.ruined, False, self.settings.near
        runs.merit = Merit.ENERGY if problem.minimization else Merit.RESIDUAL
        self.tangent.projecting = self.projection == "always" or (ruined and self.may_project())
        self._start, self._crept, runs.patient = runs.x.copy(), None, problem.minimization
        runs.patient |= not runs.knows(Merit.NONE)
        outcome = self._run()
        while self._goes_on(outcome):
            outcome = self._run(outcome)
        self._start.destroy()
        self.criteria.imbalance = None
        return explained(outcome, problem, self.tangent.A)

    def _run(self, before: Convergence | None = None) -> Convergence:
        """One run of SNES, its counts added to those of an earlier one."""
        tangent, criteria = self.tangent, self.criteria
        run = self.runs.run(resumed=before is not None)
        code, why = run.code, run.raised or REASONS.get(run.code, f"reason {run.code}")
        last = before or Convergence(False, "", 0, 0, 0, 0, np.inf, 0.0, np.inf)
        return Convergence(
            converged=code == CONVERGED,
            reason=criteria.reached() if code == CONVERGED else why,
            code=code,
            iterations=last.iterations + run.iterations,
            projected=last.projected + (run.iterations if tangent.projecting else 0),
            linear_iterations=last.linear_iterations + run.linear_iterations,
            residual=criteria.last.residual,
            force_level=criteria.last.force,
            correction=float(criteria.correction),
            negative=None if run.iterations == 0 else tangent.negative(),
            tried=(*last.tried, self.runs.words),
            # A run that goes on from another one meets its last residual again.
            residuals=last.residuals + run.residuals[before is not None :],
        )

    def _goes_on(self, outcome: Convergence) -> bool:
        """Take the first way of the ladder that fits a failure; False where none does."""
        if self.runs.ruined:
            self._start.copy(self.runs.x)
            self.runs.ruined = False
        if outcome.code == Failure.USED_UP and "snes_max_it" in self.options.user:
            return False
        return any(
            self._takes(way, outcome) for way in self.settings.ladder if outcome.code in way.on
        )

    def _takes(self, way: Way, outcome: Convergence) -> bool:
        """Whether a way fits; it is taken then. Collective."""
        tangent, runs = self.tangent, self.runs
        if way.after not in (None, runs.merit):
            return False
        if way.linear in ("faster", "direct"):
            return (tangent.kept.slow or way.linear == "direct") and self.leave_multigrid()
        if way.linear == "renewed":
            return tangent.kept.renew_if_stale()
        if way.tangent == "stiffer":
            return tangent.damping is not None and tangent.damping.stiffen()
        if way.tangent == "projected" and not self.may_project():
            return False
        if way.until is not None and not (way.until < runs.until and self.may_damp()):
            return False
        if way.merit is Merit.NONE and not self._may_step(outcome):
            return False
        if way.back and self._crept is None:
            return False
        runs.merit, runs.until = way.merit or runs.merit, way.until or runs.until
        if way.tangent in ("full", "projected"):
            tangent.projecting = way.tangent == "projected"
        if way.merit is Merit.NONE and not self.problem.minimization:
            self._crept = runs.x.copy() if outcome.code == Failure.CREEPING else None
            self._start.copy(runs.x)
        elif way.back and self._crept is not None:
            self._crept.copy(runs.x)
            self._crept, runs.patient = None, True
        return True

    def may_project(self) -> bool:
        """Whether the projected tangent is still to be tried."""
        if self.projection != "auto" or self.tangent.projecting:
            return False
        try:
            self.problem.prepare_projection()
        except ValueError:
            return False
        return True

    def may_damp(self) -> bool:
        """Whether the steps are damped, from now on if need be."""
        if self.tangent.damping is None and self.may_project():
            self.tangent.damp()
        return self.tangent.damping is not None

    def _may_step(self, outcome: Convergence) -> bool:
        """Whether full steps are to be tried: with an energy only from near the solution."""
        near = outcome.residual <= self.settings.near * outcome.force_level
        untried = self.runs.knows(Merit.NONE) and self.runs.merit is not Merit.NONE
        return untried and (near or not self.problem.minimization)

    def leave_multigrid(self) -> bool:
        """Turn from the multigrid preset to MUMPS for good; False where it was not in use."""
        if not self.tangent.may_leave_multigrid():
            return False
        self.runs.remake()
        return True

    def is_ruined(self) -> bool:
        """Whether the start is no neighbor of any equilibrium, which calls for projection."""
        return self.projection == "auto" and self.tangent.is_ruined()

    def measure_imbalance(self) -> None:
        """Remember |R_free| before u moves: the part of a load increment that is a force."""
        self.tangent.scaled.residual(self.runs.b)
        self.criteria.imbalance = self.runs.b.norm()

    def used(self) -> None:
        """Take note of a solve, after which options that PETSc did not ask for are warned of."""
        self._solved = True

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Take the memory of an earlier Newton, after the first tangent. Collective."""
        if memory["direct"]:
            self.leave_multigrid()
        self.tangent.recall(memory)

    def begin(self) -> None:
        """Forget what earlier solves have left, but for matrices and places: as if new. Collective.

        So that a path is the same to the last digit whatever was solved before it.
        """
        self.options.resume()
        if self.tangent.begin() or self.tangent.kept.used:
            self.runs.remake()
        self.tangent.kept.begin()
        self.criteria.begin()
        self.runs.ruined = self._solved = False

    def rest(self) -> None:
        """End a use, until :meth:`begin`; warns of options that PETSc never asked for."""
        if self._solved:
            self.options.warn_of_unused()
        self.options.rest()

    def destroy(self) -> None:
        """Free the PETSc objects, and this solver's options."""
        self.options.clear()
        self.runs.destroy()
        self.tangent.destroy()
