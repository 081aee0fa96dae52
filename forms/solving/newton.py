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
from ..differentiation import dependents
from ..paths import REASONS, Convergence
from ..problems import Problem
from .damping import Damping
from .finite import ADVICE, not_finite
from .linear import presets
from .linear.action import Action
from .linear.kept import Kept
from .linear.rigid import rigid_modes
from .options import SolverOptions
from .scaling import EPS, Scaled
from .stability import inertia

# Below this fraction of the force level the search goes by |R|: differences of the energy are
# quadratic in |R| and drown in its rounding long before |R| reaches a tight tolerance.
NEAR, NEARER = 1e-3, 1e-5
# Newton iterations of a run; a sheet of wrinkles that turns slack and taut takes its time.
MOST, MOST_DAMPED, MOST_NEAR = 30, 200, 12
# Part of the eigenvalues that are negative where a start is no neighbor of any equilibrium: a tenth
# where a throw of the nodes by a tenth of the cells has inverted some; a buckled body has a few.
RUINED = 0.05
# Damping below which a tangent's eigenvalues are its own.
LIGHT = 1e-8
NAN = "nan or infinite"

CONVERGED_CODE, NEAR_CODE = 2, 3  # SNES_CONVERGED_FNORM_ABS and _RELATIVE

PROJECTIONS = ("auto", "always", "never")


class Newton:
    """SNES on a problem, reused from load step to load step.

    Converged means |R_free| <= rtol * force level and max |du| <= ctol * model size, du the last
    correction, or with iterative linear solves the next one to be expected. R_free are the
    out-of-balance forces where nothing is prescribed; the force level is the larger of the
    reactions' norm and of the imbalance that the load increment made, with the rounding error of
    the forces, eps * typical K_ii * model size * sqrt(n), as its floor.

    Where the problem is a minimization the line search lowers the energy until |R_free| is a
    thousandth of the force level, then |R|; otherwise |R| from the start. It refuses a
    trial state whose energy or residual is not finite. If lowering the energy fails (an indefinite
    tangent gives no descent, a singular one no direction) the same state goes on with the projected
    and damped tangent (:class:`forms.solving.damping.Damping`), near the solution with the full
    one. Without an energy to lower, full steps from the start are tried where the descent of |R|
    creeps. If the multigrid preset fails, MUMPS. Each of these runs may take snes_max_it
    iterations, damped ones MOST_DAMPED.

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

    Raises:
        ValueError: another word, or "always" where there is no potential of displacements alone.
    """

    def __init__(
        self,
        problem: Problem,
        options: Mapping[str, Any] | None = None,
        prefix: str = "variform_",
        rtol: float = 1e-8,
        ctol: float = 1e-6,
        projection: str = "auto",
    ) -> None:
        if projection not in PROJECTIONS:
            raise ValueError(f"projection is one of {', '.join(PROJECTIONS)}, got {projection!r}.")
        if projection == "always":
            problem.prepare_projection()
        self.projection, self._projecting = projection, False
        self._known: tuple[np.ndarray, float] | None = None
        self._ruined = self._spoiled = False
        self._raised = ""
        self._damping: Damping | None = None
        self._left_multigrid = False
        self.problem, self.ctol = problem, ctol
        self.A, self.b = problem.create_matrix(), problem.create_vector()
        self.x = self.b.duplicate()
        self._x_before = self.b.duplicate()
        self._options = SolverOptions(prefix, options, apart="bordered_")
        self._user = self._options.user
        self.rtol = float(self._user.get("snes_rtol", rtol))
        self.atol = float(self._user.get("snes_atol", 0.0))
        self._preset = presets.preset(problem, self.A)
        self._solved = False
        self._imbalance: float | None = None
        self._reactions, self._correction = 0.0, np.inf
        self._last, self._floor = (np.inf, 0.0), 0.0
        self.scaled = Scaled(problem, self.A)
        if problem.minimization and problem.is_displacement:
            self.A.setNearNullSpace(rigid_modes(problem.u.function_space))
        self._build(self._preset)

    def _build(self, preset: Mapping[str, str]) -> None:
        """Make the SNES: ``snes``, and ``_by_residual``, the same without the energy."""
        base = {
            "snes_type": "newtonls",
            "snes_linesearch_type": "bt",
            "snes_max_it": str(MOST),
            "snes_divergence_tolerance": "-1",
        }
        if "pc_type" in self._user:  # another preconditioner has no use for this one's options
            preset = {k: v for k, v in preset.items() if k.split("_")[0] not in ("pc", "mat", "mg")}
        own = "pc_type" not in self._user
        # Where multigrid is kept, the tangent that it was built of is out of date on purpose. An
        # energy in singular values would find these anew at each product.
        matrix_free = own and preset.get("pc_type") == "mg"
        matrix_free &= not dependents(self.problem.forms.tangent_ufl)
        matrix_free &= len(self.problem.terms) == 1
        self._action = Action(self.problem, self.A) if matrix_free else None
        self._options.apply({**base, **preset})
        self.snes = self._by_residual = self._create(None)
        self._full: PETSc.SNES | None = None
        if self.problem.minimization:
            # An objective once set cannot be taken back; the factorization is shared.
            self._by_residual = self._create(self.snes.getKSP())
            self.snes.setObjective(self._objective)
        if "snes_linesearch_type" not in self._user:
            # Newton's own steps, for where the descent of |R| gets slow.
            self._options["snes_linesearch_type"] = "basic"
            self._full = self._create(self.snes.getKSP())
            self._options["snes_linesearch_type"] = base["snes_linesearch_type"]
        self.snes.getKSP().setPostSolve(self._hold)
        ksp, chosen = self.snes.getKSP(), preset if own else {}
        self._kept = Kept(self.problem, ksp, chosen, self._options.prefix, self._user)

    def _create(self, ksp: PETSc.KSP | None) -> PETSc.SNES:
        snes = PETSc.SNES().create(self.problem.comm)
        snes.setOptionsPrefix(self._options.prefix)
        snes.setFunction(self._residual, self.b.duplicate())
        snes.setJacobian(self._tangent, self._product, self.A)
        snes.setConvergenceTest(self._test)
        snes.setLineSearchPreCheck(self._downhill)
        if ksp is not None:
            snes.setKSP(ksp)
        try:
            snes.setFromOptions()
        except PETSc.Error as error:
            self._options.clear()
            raise ValueError(f"PETSc refused its options, {_petsc.said(error)}.") from None
        return snes

    def solve(self) -> Convergence:
        """Newton iterations from u's present values, supports applied; u is left at the last one.

        Collective. Call :meth:`predict` first when prescribed values have changed.
        """
        problem = self.problem
        if self.scaled.rounding == 0:
            self.scaled.measure()
        if self._imbalance is None:
            self.measure_imbalance()
        if self._kept.slow:
            self._leave_multigrid()
        self.scaled.get(self.x)
        self.scaled.prescribe(self.x)
        self.scaled.put(self.x)
        if problem.has_energy and not np.isfinite(problem.energy()):
            self._imbalance = None
            return Convergence(False, self._undefined(), -1, 0, 0, 0, np.inf, 0.0, np.inf)
        self._solved = True
        objective = problem.minimization
        self._projecting = self.projection == "always" or (self._ruined and self._may_project())
        self._near, self._stepping, self._ruined = NEAR, False, False
        start = self.x.copy()
        outcome = self._run(objective)
        while True:
            code = outcome.code
            if self._ruined:
                start.copy(self.x)
                self._ruined = False
            if code == -5 and "snes_max_it" in self._user:
                break
            if code == -3 and self._kept.slow and self._leave_multigrid():
                pass
            elif code == -3 and self._kept.stale:
                self._kept.renew()
            elif code == -3 and self._damping is not None and self._damping.stiffen():
                pass
            elif code in (-3, -5, -6) and objective and self._may_project():
                self._projecting = True
            elif code == -3 and self._leave_multigrid():
                pass
            elif code in (-6, NEAR_CODE) and objective:
                objective = self._projecting = False
            elif code in (-5, -6) and self._near == NEAR and self._may_damp():
                # |R| has local minima where sheets turn slack or taut: go on downhill, nearer.
                objective, self._near = True, NEARER
            elif code in (-5, -6) and not self._stepping and self._may_step(outcome):
                # |R| is no measure of the distance where bending is much softer than stretching:
                # full steps go where a descent of |R| creeps, from the start or from nearby.
                objective, self._projecting, self._stepping = False, False, True
                if not problem.minimization:
                    start.copy(self.x)
            else:
                break
            outcome = self._run(objective, outcome)
        start.destroy()
        self._imbalance = None
        return self._explained(outcome)

    def _explained(self, outcome: Convergence) -> Convergence:
        """The outcome, with the cause of linear solves that fail where the tangent shows it."""
        if outcome.converged or outcome.code != -3:
            return outcome
        self.scaled.tangent()
        cause = not_finite(self.problem, self.A)
        if cause:
            return replace(outcome, reason=cause, advice=ADVICE)
        return replace(outcome, reason=self._raised) if self._raised else outcome

    def _undefined(self) -> str:
        """Why the energy is not finite at the start, in words. Collective."""
        problem = self.problem
        if not all(np.all(np.isfinite(c.value)) for c in problem.forms.constants):
            return f"{REASONS[-1]}: a Constant in the potential is {NAN}"
        if not np.isfinite(problem.u.x.petsc_vec.norm()):
            return f"{REASONS[-1]}: the unknown holds {NAN}"
        return f"{REASONS[-1]}: cells are inverted there, or a parameter is out of its range"

    def _may_project(self) -> bool:
        """Whether the projected tangent is still to be tried."""
        if self.projection != "auto" or self._projecting:
            return False
        try:
            self.problem.prepare_projection()
        except ValueError:
            return False
        return True

    def _may_step(self, outcome: Convergence) -> bool:
        """Whether full steps are to be tried: with an energy only from near the solution."""
        near = outcome.residual <= NEAR * outcome.force_level
        return self._full is not None and (near or not self.problem.minimization)

    def _may_damp(self) -> bool:
        """Whether the steps are damped, from now on if need be."""
        if self._damping is None and self._may_project():
            self._damp()
        return self._damping is not None

    def _leave_multigrid(self) -> bool:
        """Turn from the multigrid preset to MUMPS for good; False where it was not in use."""
        if not self._kept.used:
            return False
        self._preset = presets.direct(self.problem.symmetric)
        self._left_multigrid = True
        self._remake()
        return True

    def _remake(self) -> None:
        """Make the solvers anew."""
        self._kept.destroy()
        self._drop_action()
        for snes in (self.snes, self._by_residual, self._full):
            if snes is not None:
                snes.destroy()
        self._build(self._preset)

    def _is_ruined(self) -> bool:
        """Whether so much of the last tangent is negative that its step leads nowhere."""
        full = not self._projecting and (self._damping is None or self._damping.strength <= LIGHT)
        if self.projection != "auto" or not (full and self.problem.minimization):
            return False
        negative = inertia(self.snes.getKSP(), self.problem)
        return negative is not None and negative > RUINED * self.problem.size

    def _drop_action(self) -> None:
        if self._action is not None:
            self._action.destroy()
            self._action = None

    def memory(self) -> dict[str, Any]:
        """What is kept from one load to the next: damping, and that multigrid failed."""
        damping, left = self._damping, presets.direct(self.problem.symmetric) == self._preset
        return {"direct": left, "damping": damping and (damping.scale, damping.strength)}

    def renew(self) -> None:
        """Keep nothing of the preconditioner for the next step."""
        self._kept.renew()

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Take the memory of an earlier Newton, after the first tangent. Collective."""
        if memory["direct"]:
            self._leave_multigrid()
        if memory["damping"]:
            if self._damping is None:
                self._damp()
            assert self._damping is not None
            self._damping.scale, self._damping.strength = memory["damping"]

    def predict(self) -> None:
        """Move u by one tangent solve that carries the prescribed values to the present load.

        K du = -R at free degrees of freedom, du = prescribed - u at the others, so that SNES
        afterwards starts from exact boundary values and its residuals are forces only. Collective.
        """
        problem = self.problem
        self._projecting = self.projection == "always"
        # Measuring leaves the tangent at u behind, which is that of the predictor.
        assembled = self.scaled.rounding == 0 and not (self._projecting or self.scaled.mixed)
        if self.scaled.rounding == 0:
            self.scaled.measure()
        self.measure_imbalance()
        self.scaled.get(self.x)
        jump = self.x.copy()
        self.scaled.prescribe(jump)
        jump.axpy(-1, self.x)
        # A start may miss the supports by rounding: no reason for a step at the whole load.
        if jump.norm(PETSc.NormType.INFINITY) <= 1e3 * EPS * self.scaled.size:
            jump.destroy()
            return
        problem.lifted_residual(self.b)
        self.b.pointwiseMult(self.b, self.scaled.D)
        self.b.scale(-1)
        # Not the jump itself, a length among forces: it is prescribed below.
        self.b.array[problem.constrained] = 0
        start = self.x.copy()
        self._carry(self.b, assembled)
        for x in (self.x, start):  # without the carried step where that leaves no finite energy
            self.scaled.prescribe(x)
            self.scaled.put(x)
            if not problem.has_energy or np.isfinite(problem.energy()):
                break
        jump.destroy()
        start.destroy()

    def _carry(self, b: PETSc.Vec, assembled: bool) -> None:
        """Move x by the tangent solve for b, damped where that is singular; else not at all."""
        du, ksp, damped = b.duplicate(), self.snes.getKSP(), self._damping is not None
        while True:
            if assembled and not damped:
                self._use_tangent()
            else:
                self._assemble_tangent()
            assembled = False
            ksp.setOperators(self._product, self.A)
            solved = self._solve_linear(b, du)
            if self._spoiled:
                break
            if solved and np.isfinite(du.norm()):
                self._ruined = self._is_ruined()
                if not self._ruined:
                    self.x.axpy(1, du)
                break
            if self._kept.stale:
                self._kept.renew()
                continue
            if self._leave_multigrid():  # a reset would take the levels from it
                ksp = self.snes.getKSP()
                continue
            ksp.reset()  # MUMPS does not forget a failure
            if not self._may_damp():
                break
            if damped and self._damping is not None and not self._damping.stiffen():
                break
            damped = True
        du.destroy()

    def _solve_linear(self, b: PETSc.Vec, x: PETSc.Vec) -> bool:
        """Solve K x = b; whether that succeeded. Collective."""
        ksp = self.snes.getKSP()
        try:
            ksp.solve(b, x)
        except PETSc.Error:
            ksp.reset()
            return False
        return bool(ksp.getConvergedReason() > 0)

    def _ended(self, snes: PETSc.SNES) -> tuple[int, int, int]:
        """Run SNES from x; its reason, iterations and linear iterations. Collective.

        One that raises leaves its vectors locked: all is made anew then.
        """
        try:
            snes.solve(None, self.x)
        except PETSc.Error as error:
            self._raised = _petsc.said(error)
            self.x, self.b = self.b.duplicate(), self.b.duplicate()
            self._x_before.copy(self.x)
            self._remake()
            return -3, max(0, len(self._history) - 1), 0
        # A step of zero length counts as converged for PETSc.
        code = -3 if self._spoiled else int(snes.getConvergedReason())
        linear_iterations = snes.getLinearSolveIterations()
        return code, snes.getIterationNumber(), linear_iterations

    def _forget_failure(self) -> None:
        """Start the linear solver anew after a failure, which MUMPS does not forget."""
        ksp = self.snes.getKSP()
        if ksp.getConvergedReason() < 0 and not self._kept.used:
            ksp.reset()  # of multigrid it would take the levels
            ksp.setOperators(self._product, self.A)

    def measure_imbalance(self) -> None:
        """Remember |R_free| before u moves: the part of a load increment that is a force."""
        self.scaled.residual(self.b)
        self._imbalance = self.b.norm()

    @property
    def _product(self) -> PETSc.Mat:
        """What linear solvers multiply with."""
        return self.A if self._action is None else self._action.matrix

    def _assemble_tangent(self) -> None:
        if self._action is not None:
            self._action.assembled = self._projecting or self._damping is not None
            if not self._action.assembled and not self._kept.due:
                self.problem.prepare()
                self._kept.prepare(self.A)
                return
        self.scaled.tangent(self._projecting)
        self._use_tangent()

    def _use_tangent(self) -> None:
        """Damp the assembled tangent if need be, and hand it to the linear solver. Collective."""
        self._spoiled = not self.scaled.is_finite()
        if self._spoiled:
            # Its step is not taken. MUMPS and GAMG would raise in the midst of SNES.
            self.A.zeroEntries()
            self.A.shift(1.0)
        elif self._projecting and self._damping is None:
            self._damp()
        if self._damping is not None and not self._spoiled:
            self._damping.add(self.A)
        self._kept.prepare(self.A)

    def _damp(self) -> None:
        """Damp the tangent from now on; compared with the assembled one, or with the forces."""
        force = self._imbalance or self._reactions or 1.0
        self._damping = Damping(self.problem, self.A, self.scaled.free, force / self.scaled.size)

    def begin(self) -> None:
        """Forget what earlier solves have left, but for matrices and places: as if new. Collective.

        So that a path is the same to the last digit whatever was solved before it.
        """
        self._options.resume()
        if self._damping is not None:
            self._damping.destroy()
            self._damping = None
        self.scaled.begin()
        if self._left_multigrid:
            self._left_multigrid = False
            self._preset = presets.preset(self.problem, self.A)
            self._remake()
        self._kept.begin()
        self._ruined = self._spoiled = self._solved = False
        self._imbalance, self._known = None, None
        self._reactions, self._correction = 0.0, np.inf
        self._last = np.inf, 0.0

    def rest(self) -> None:
        """End a use, until :meth:`begin`; warns of options that PETSc never asked for."""
        unused = self._options.unused()
        if unused and self._solved:
            warnings.warn(
                f"PETSc did not use the options {', '.join(unused)}: are they misspelled, or meant "
                "for another solver?",
                stacklevel=4,
            )
        self._options.rest()

    def destroy(self) -> None:
        """Free the PETSc objects (their callbacks refer to this one) and this solver's options."""
        self._options.clear()
        self._kept.destroy()
        self._drop_action()
        if self._damping is not None:
            self._damping.destroy()
        vectors = (self.b, self.x, self._x_before, self.scaled)
        if self._full is not None:
            self._full.destroy()
        for item in (self.snes, self._by_residual, self.A, *vectors):
            item.destroy()

    def _run(self, objective: bool, before: Convergence | None = None) -> Convergence:
        """One SNES solve from self.x, its counts added to those of an earlier one."""
        snes = self.snes if objective else self._by_residual
        if self._stepping and self._full is not None:
            snes = self._full
        self._energetic, self._resumed = objective, before is not None
        self._known, self._spoiled, self._raised = None, False, ""
        damped = self._projecting or self._damping is not None
        if "snes_max_it" not in self._user:
            most = MOST if not damped else MOST_DAMPED if objective else MOST_NEAR
            snes.setTolerances(max_it=most)
        self.x.copy(self._x_before)
        self._correction = np.inf
        self._history: list[float] = []
        self._forget_failure()
        code, iterations, linear_iterations = self._ended(snes)
        self.scaled.put(self.x)
        converged = code == CONVERGED_CODE
        reached = "both tolerances reached"
        if self._last[0] > max(self.rtol * self._last[1], self._floor):
            reached = f"snes_atol = {self.atol:g} reached"
        return Convergence(
            converged=converged,
            reason=reached if converged else REASONS.get(code, f"reason {code}"),
            code=code,
            iterations=iterations + (before.iterations if before else 0),
            projected=(iterations if self._projecting else 0)
            + (before.projected if before else 0),
            linear_iterations=linear_iterations + (before.linear_iterations if before else 0),
            residual=self._last[0],
            force_level=self._last[1],
            correction=float(self._correction),
            negative=None if iterations == 0 else self._negative(),
            tried=(before.tried if before else ()) + (self._way(objective),),
            # A run that goes on from another one meets its last residual again.
            residuals=(before.residuals + tuple(self._history[1:]))
            if before
            else tuple(self._history),
        )

    def _way(self, objective: bool) -> str:
        """What the present run does, in words."""
        if self._stepping:
            way = "full steps"
        elif not objective:
            way = "|R|"
        elif self._projecting:
            way = "projected tangent"
        else:
            way = "full tangent" if self._damping is None else "damped tangent"
        return f"{way} with MUMPS" if self._left_multigrid else way

    def _negative(self) -> int | None:
        """Negative eigenvalues of the last tangent, where it was the full one and factorized."""
        damped = self._damping is not None and self._damping.strength > LIGHT
        if self._projecting or damped:
            return None
        return inertia(self.snes.getKSP(), self.problem)

    def _objective(self, snes: PETSc.SNES, x: PETSc.Vec) -> float:
        # A line search begins with the energy of the state at which the last one ended.
        known = self._known is not None and np.array_equal(self._known[0], x.array_r)
        if not self.problem.comm.allreduce(known, MPI.LAND):
            self.scaled.put(x)
            self._known = x.array_r.copy(), self.problem.energy()
        assert self._known is not None
        return self._known[1]

    def _residual(self, snes: PETSc.SNES, x: PETSc.Vec, f: PETSc.Vec) -> None:
        problem = self.problem
        self.scaled.put(x)
        # A state without a finite energy is refused also where the search goes by |R|: ln J with
        # J < 0 spoils the energy before every part of the residual.
        valid = self._energetic or not problem.has_energy or np.isfinite(problem.energy())
        self._reactions = self.scaled.residual(self.b)
        self.b.copy(f)
        if not valid:
            f.set(np.nan)

    def _tangent(self, snes: PETSc.SNES, x: PETSc.Vec, A: PETSc.Mat, P: PETSc.Mat) -> None:
        self.scaled.put(x)
        self._assemble_tangent()

    def _hold(self, ksp: PETSc.KSP, b: PETSc.Vec, step: PETSc.Vec) -> None:
        """Keep supports exact: multigrid's coarse levels may move them by its tolerance."""
        step.array[self.problem.constrained] = 0
        if self._spoiled:
            step.set(0)
        self._kept.count()

    def _downhill(self, x: PETSc.Vec, step: PETSc.Vec) -> bool:
        """Keep a step within what terms allow, and stiffen damping until it lowers the energy.

        Returns:
            Whether the step was changed.
        """
        changed = self._bounded(step)
        if self._damping is None or not self._energetic:
            return changed
        force = self.snes.getFunction()[0]
        while not force.dot(step) > 0 and self._damping.stiffen():
            self._assemble_tangent()
            self._forget_failure()
            self._solve_linear(force, step)
            changed = True
        self._forget_failure()
        return changed

    def _bounded(self, step: PETSc.Vec) -> bool:
        """Shorten a step that a term forbids; whether it was changed. Collective."""
        if len(self.problem.terms) == 1:  # forms bound no step
            return False
        self.b.pointwiseMult(step, self.scaled.D)
        self.b.scale(-1)  # SNES takes x - step
        fraction = self.problem.largest_step(self.b)
        if fraction >= 1:
            return False
        step.scale(fraction)
        return True

    def _test(self, snes: PETSc.SNES, iteration: int, norms: tuple[float, float, float]) -> int:
        fnorm, before = norms[2], self._last[0]
        self._history.append(float(fnorm))
        if not np.isfinite(fnorm):
            return -4
        first, x = iteration == 0 and not self._resumed, snes.getSolution()
        if iteration:
            self._correction = self.scaled.correction(x, self._x_before)
            if self._energetic and self._damping is not None:
                self._x_before.axpy(-1, x)
                step = snes.getSolutionUpdate().norm()
                self._damping.after(self._x_before.norm() / step if step else 1.0)
        x.copy(self._x_before)
        if self._spoiled:
            return -3
        level = max(self._reactions, self._imbalance or 0.0)
        self._last = (fnorm, level)
        self._floor = self.scaled.floor()
        self._kept.goal = max(self.rtol * level, self.atol, self._floor)
        small = fnorm <= self._kept.goal
        # With iterative solves the next correction is smaller than the last one as the forces are;
        # with a factorization it takes one step to see how much smaller.
        ratio = min(1.0, fnorm / before) if self._kept.used and iteration else 1.0
        settled = first or self._correction * ratio <= self.ctol * self.scaled.size
        if small and settled:
            return CONVERGED_CODE
        if self._energetic and fnorm <= self._near * level:
            return NEAR_CODE
        if self._kept.slow:
            return -3
        if iteration == 1 and self._energetic and self._is_ruined():
            self._ruined = True
            return -6
        return -5 if iteration >= snes.getTolerances()[3] else 0
