# SPDX-License-Identifier: MIT
"""Newton's method by PETSc SNES, with the energy as its objective and named, unit-free norms."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from .. import _petsc
from ..paths import REASONS, Convergence
from ..problems import Problem
from .criteria import Criteria
from .finite import ADVICE, not_finite, undefined
from .ladder import Failure, Merit, Way
from .options import SolverOptions
from .predictor import predict
from .settings import Settings
from .tangents import Tangent

CONVERGED, NOT_FINITE = 2, -4  # SNES_CONVERGED_FNORM_ABS, SNES_DIVERGED_FNORM_NAN
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
        self.options = SolverOptions(prefix, options, apart="bordered_")
        user = self.options.user
        self.tangent = Tangent(problem, self.options, self.settings, lambda: self.criteria.start)
        rtol, atol = float(user.get("snes_rtol", rtol)), float(user.get("snes_atol", 0.0))
        self.criteria = Criteria(self.tangent.scaled, rtol, ctol, atol)
        self.b = problem.create_vector()
        self.x, self._before = self.b.duplicate(), self.b.duplicate()
        self._merit, self._until = Merit.ENERGY, self.settings.near
        self._known: tuple[np.ndarray, float] | None = None
        self.ruined = self._solved = False
        self._raised = ""
        self._build()

    def _build(self) -> None:
        """Make a SNES for each merit; they share the linear solver."""
        base = {
            "snes_type": "newtonls",
            "snes_linesearch_type": "bt",
            "snes_max_it": str(self.settings.most),
            "snes_divergence_tolerance": "-1",
        }
        self.tangent.configure(base)
        self.snes = self._create(None)
        ksp = self.snes.getKSP()
        self._solvers = {Merit.RESIDUAL: self.snes}
        if self.problem.minimization:
            # An objective once set cannot be taken back.
            self._solvers = {Merit.ENERGY: self.snes, Merit.RESIDUAL: self._create(ksp)}
            self.snes.setObjective(self._objective)
        if "snes_linesearch_type" not in self.options.user:
            self.options["snes_linesearch_type"] = "basic"
            self._solvers[Merit.NONE] = self._create(ksp)
            self.options["snes_linesearch_type"] = base["snes_linesearch_type"]
        self.tangent.attach(ksp)

    def _create(self, ksp: PETSc.KSP | None) -> PETSc.SNES:
        snes = PETSc.SNES().create(self.problem.comm)
        snes.setOptionsPrefix(self.options.prefix)
        snes.setFunction(self._residual, self.b.duplicate())
        snes.setJacobian(self._tangent, self.tangent.product, self.tangent.A)
        snes.setConvergenceTest(self._test)
        snes.setLineSearchPreCheck(self._check_step)
        if ksp is not None:
            snes.setKSP(ksp)
        try:
            snes.setFromOptions()
        except PETSc.Error as error:
            self.options.clear()
            raise ValueError(f"PETSc refused its options, {_petsc.said(error)}.") from None
        return snes

    def _remake(self) -> None:
        """Make the solvers anew."""
        self.tangent.detach()
        for snes in self._solvers.values():
            snes.destroy()
        self._build()

    def predict(self) -> None:
        """Move u by one tangent solve that carries the prescribed values to the present load.

        Collective; see :mod:`forms.solving.predictor`.
        """
        predict(self)

    def solve(self) -> Convergence:
        """Newton iterations from u's present values, supports applied; u is left at the last one.

        Collective. Call :meth:`predict` first when prescribed values have changed.
        """
        problem, scaled = self.problem, self.tangent.scaled
        if scaled.rounding == 0:
            scaled.measure()
        if self.criteria.imbalance is None:
            self.measure_imbalance()
        if self.tangent.kept.slow:
            self.leave_multigrid()
        scaled.get(self.x)
        scaled.prescribe(self.x)
        scaled.put(self.x)
        if problem.has_energy and not np.isfinite(problem.energy()):
            self.criteria.imbalance = None
            return Convergence(False, undefined(problem), -1, 0, 0, 0, np.inf, 0.0, np.inf)
        self._solved = True
        self._merit = Merit.ENERGY if problem.minimization else Merit.RESIDUAL
        self.tangent.projecting = self.projection == "always" or (
            self.ruined and self.may_project()
        )
        self._until, self.ruined = self.settings.near, False
        self._start = self.x.copy()
        outcome = self._run()
        while self._goes_on(outcome):
            outcome = self._run(outcome)
        self._start.destroy()
        self.criteria.imbalance = None
        return self._explained(outcome)

    def _goes_on(self, outcome: Convergence) -> bool:
        """Take the first way of the ladder that fits a failure; False where none does."""
        if self.ruined:
            self._start.copy(self.x)
            self.ruined = False
        if outcome.code == Failure.USED_UP and "snes_max_it" in self.options.user:
            return False
        return any(
            self._takes(way, outcome) for way in self.settings.ladder if outcome.code in way.on
        )

    def _takes(self, way: Way, outcome: Convergence) -> bool:
        """Whether a way fits; it is taken then. Collective."""
        tangent, damping = self.tangent, self.tangent.damping
        if way.after not in (None, self._merit):
            return False
        if way.linear in ("faster", "direct"):
            return (tangent.kept.slow or way.linear == "direct") and self.leave_multigrid()
        if way.linear == "renewed":
            return tangent.kept.renew_if_stale()
        if way.tangent == "stiffer":
            return damping is not None and damping.stiffen()
        if way.tangent == "projected" and not self.may_project():
            return False
        if way.until is not None and not (way.until < self._until and self.may_damp()):
            return False
        if way.merit is Merit.NONE and not self._may_step(outcome):
            return False
        self._merit = way.merit or self._merit
        self._until = way.until or self._until
        if way.tangent in ("full", "projected"):
            tangent.projecting = way.tangent == "projected"
        if way.merit is Merit.NONE and not self.problem.minimization:
            self._start.copy(self.x)
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
        untried = Merit.NONE in self._solvers and self._merit is not Merit.NONE
        return untried and (near or not self.problem.minimization)

    def leave_multigrid(self) -> bool:
        """Turn from the multigrid preset to MUMPS for good; False where it was not in use."""
        if not self.tangent.may_leave_multigrid():
            return False
        self._remake()
        return True

    def is_ruined(self) -> bool:
        """Whether the start is no neighbor of any equilibrium, which calls for projection."""
        return self.projection == "auto" and self.tangent.is_ruined()

    def _explained(self, outcome: Convergence) -> Convergence:
        """The outcome, with the cause of linear solves that fail where the tangent shows it."""
        if outcome.converged or outcome.code != Failure.LINEAR:
            return outcome
        self.tangent.scaled.tangent()
        cause = not_finite(self.problem, self.tangent.A)
        if cause:
            return replace(outcome, reason=cause, advice=ADVICE)
        return replace(outcome, reason=self._raised) if self._raised else outcome

    def measure_imbalance(self) -> None:
        """Remember |R_free| before u moves: the part of a load increment that is a force."""
        self.tangent.scaled.residual(self.b)
        self.criteria.imbalance = self.b.norm()

    def _run(self, before: Convergence | None = None) -> Convergence:
        """One SNES solve from self.x, its counts added to those of an earlier one."""
        tangent, criteria, settings = self.tangent, self.criteria, self.settings
        snes, energetic = self._solvers[self._merit], self._merit is Merit.ENERGY
        self._resumed, self._known, self._raised = before is not None, None, ""
        tangent.spoiled = False
        damped = tangent.projecting or tangent.damping is not None
        if "snes_max_it" not in self.options.user:
            longest = settings.most_damped if energetic else settings.most_near
            snes.setTolerances(max_it=longest if damped else settings.most)
        self.x.copy(self._before)
        criteria.correction = np.inf
        self._history: list[float] = []
        tangent.forget_failure()
        code, iterations, linear_iterations = self._ended(snes)
        tangent.scaled.put(self.x)
        last = before or Convergence(False, "", 0, 0, 0, 0, np.inf, 0.0, np.inf)
        return Convergence(
            converged=code == CONVERGED,
            reason=criteria.reached() if code == CONVERGED else REASONS.get(code, f"reason {code}"),
            code=code,
            iterations=last.iterations + iterations,
            projected=last.projected + (iterations if tangent.projecting else 0),
            linear_iterations=last.linear_iterations + linear_iterations,
            residual=criteria.last.residual,
            force_level=criteria.last.force,
            correction=float(criteria.correction),
            negative=None if iterations == 0 else tangent.negative(),
            tried=(*last.tried, self._words()),
            # A run that goes on from another one meets its last residual again.
            residuals=last.residuals + tuple(self._history[before is not None :]),
        )

    def _ended(self, snes: PETSc.SNES) -> tuple[int, int, int]:
        """Run SNES from x; its reason, iterations and linear iterations. Collective.

        One that raises leaves its vectors locked: all is made anew then.
        """
        try:
            snes.solve(None, self.x)
        except PETSc.Error as error:
            self._raised = _petsc.said(error)
            self.x, self.b = self.b.duplicate(), self.b.duplicate()
            self._before.copy(self.x)
            self._remake()
            return Failure.LINEAR, max(0, len(self._history) - 1), 0
        # A step of zero length counts as converged for PETSc.
        code = Failure.LINEAR if self.tangent.spoiled else int(snes.getConvergedReason())
        return int(code), snes.getIterationNumber(), snes.getLinearSolveIterations()

    def _words(self) -> str:
        """What the present run does, in words."""
        way = self._merit.value
        if self._merit is Merit.ENERGY:
            plain = "full tangent" if self.tangent.damping is None else "damped tangent"
            way = "projected tangent" if self.tangent.projecting else plain
        return f"{way} with MUMPS" if self.tangent.left_multigrid else way

    def _objective(self, snes: PETSc.SNES, x: PETSc.Vec) -> float:
        # A line search begins with the energy of the state at which the last one ended.
        known = self._known is not None and np.array_equal(self._known[0], x.array_r)
        if not self.problem.comm.allreduce(known, MPI.LAND):
            self.tangent.scaled.put(x)
            self._known = x.array_r.copy(), self.problem.energy()
        assert self._known is not None
        return self._known[1]

    def _residual(self, snes: PETSc.SNES, x: PETSc.Vec, f: PETSc.Vec) -> None:
        problem = self.problem
        self.tangent.scaled.put(x)
        # A state without a finite energy is refused also where the search goes by |R|: ln J with
        # J < 0 spoils the energy before every part of the residual.
        sound = self._merit is Merit.ENERGY or not problem.has_energy
        sound = sound or np.isfinite(problem.energy())
        self.criteria.reactions = self.tangent.scaled.residual(self.b)
        self.b.copy(f)
        if not sound:
            f.set(np.nan)

    def _tangent(self, snes: PETSc.SNES, x: PETSc.Vec, A: PETSc.Mat, P: PETSc.Mat) -> None:
        self.tangent.scaled.put(x)
        self.tangent.assemble()

    def _check_step(self, x: PETSc.Vec, step: PETSc.Vec) -> bool:
        """Keep a step within what terms allow, and stiffen damping until it lowers the energy.

        Returns:
            Whether the step was changed.
        """
        tangent, changed = self.tangent, self._bounded(step)
        if tangent.damping is None or self._merit is not Merit.ENERGY:
            return changed
        force = self.snes.getFunction()[0]
        while not force.dot(step) > 0 and tangent.damping.stiffen():
            tangent.assemble()
            tangent.forget_failure()
            tangent.solve(force, step)
            changed = True
        tangent.forget_failure()
        return changed

    def _bounded(self, step: PETSc.Vec) -> bool:
        """Shorten a step that a term forbids; whether it was changed. Collective."""
        if len(self.problem.terms) == 1:  # forms bound no step
            return False
        self.b.pointwiseMult(step, self.tangent.scaled.D)
        self.b.scale(-1)  # SNES takes x - step
        fraction = self.problem.largest_step(self.b)
        step.scale(min(fraction, 1.0))
        return fraction < 1

    def _test(self, snes: PETSc.SNES, iteration: int, norms: tuple[float, float, float]) -> int:
        """SNES's convergence test: 0 to go on, else a code of :class:`Failure` or PETSc."""
        tangent, criteria, before = self.tangent, self.criteria, self.criteria.last
        energetic, x = self._merit is Merit.ENERGY, snes.getSolution()
        self._history.append(float(norms[2]))
        if not np.isfinite(norms[2]):
            return NOT_FINITE
        if iteration:
            criteria.corrected(x, self._before)
            if energetic and tangent.damping is not None:
                self._before.axpy(-1, x)
                step = snes.getSolutionUpdate().norm()
                tangent.damping.after(self._before.norm() / step if step else 1.0)
        x.copy(self._before)
        if tangent.spoiled:
            return Failure.LINEAR
        criteria.take(norms[2])
        tangent.kept.goal = criteria.goal
        first = iteration == 0 and not self._resumed
        if criteria.hold(before, first, iterative=tangent.kept.used and iteration > 0):
            return CONVERGED
        if energetic and norms[2] <= self._until * criteria.force:
            return Failure.NEAR
        if tangent.kept.slow:
            return Failure.LINEAR
        if iteration == 1 and energetic and self.is_ruined():
            self.ruined = True
            return Failure.NO_DESCENT
        return Failure.USED_UP if iteration >= snes.getTolerances()[3] else 0

    def memory(self) -> dict[str, Any]:
        """What is kept from one load to the next: damping, and that multigrid failed."""
        return self.tangent.memory()

    def renew(self) -> None:
        """Keep nothing of the preconditioner for the next step."""
        self.tangent.kept.renew()

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Take the memory of an earlier Newton, after the first tangent. Collective."""
        tangent = self.tangent
        if memory["direct"]:
            self.leave_multigrid()
        if memory["damping"]:
            if tangent.damping is None:
                tangent.damp()
            assert tangent.damping is not None
            tangent.damping.scale, tangent.damping.strength = memory["damping"]

    def begin(self) -> None:
        """Forget what earlier solves have left, but for matrices and places: as if new. Collective.

        So that a path is the same to the last digit whatever was solved before it.
        """
        self.options.resume()
        if self.tangent.begin():
            self._remake()
        self.tangent.kept.begin()
        self.criteria.begin()
        self.ruined = self._solved = False
        self._known = None

    def rest(self) -> None:
        """End a use, until :meth:`begin`; warns of options that PETSc never asked for."""
        unused = self.options.unused()
        if unused and self._solved:
            warnings.warn(
                f"PETSc did not use the options {', '.join(unused)}: are they misspelled, or meant "
                "for another solver?",
                stacklevel=4,
            )
        self.options.rest()

    def destroy(self) -> None:
        """Free the PETSc objects (their callbacks refer to this one) and this solver's options."""
        self.options.clear()
        self.tangent.destroy()
        for item in (*self._solvers.values(), self.b, self.x, self._before):
            item.destroy()
