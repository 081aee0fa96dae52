# SPDX-License-Identifier: MIT
"""Plain Newton by PETSc SNES with a lagged Jacobian, whose contraction says if a step is too long.

K(x_0) y_0 = R(x_0),  x_1 = x_0 - y_0,  K(x_0) y_1 = R(x_1),  theta = |y_1| / |y_0|

No line search, no projection, no damping: what leads to *some* equilibrium leads off the path. A
first contraction theta above a half refuses the step after one tangent: below it the condition of
Newton-Kantorovich holds for the simplified iteration (Deuflhard, *Newton Methods for Nonlinear
Problems*, 2011, section 5.1), and the equilibrium found is the one that the path leads to.
"""

from __future__ import annotations

from collections.abc import Callable

from petsc4py import PETSc

import numpy as np

from .. import _petsc
from ..paths import REASONS, Convergence
from .border import Border
from .finite import explained
from .ladder import Failure
from .newton import Newton
from .snes import CONVERGED, NOT_FINITE

STUCK = 1e4  # goals up to which a residual that no correction lowers may be rounding
FAR = 10.0  # first correction over the model's size from which on a tangent counts as singular


class Corrector:
    """The corrector of a path: one SNES, used from step to step; collective.

    Its first correction carries the prescribed values along (the tangent's columns at supports are
    lifted to the right-hand side), so that there is one tangent for predictor and corrector. With
    iterative linear solvers, where a new tangent costs no more than an old one, theta is that of
    Newton's own corrections.

    Args:
        newton: Solver of the problem, whose tangent, criteria and options these are.
        border: Scalar unknowns beside the field; None for none.

    Attributes:
        theta: First contraction of the last solve; 0 where its first correction was the last.
        singular: Whether the last solve failed because the tangent at its start is singular.
        met: Whether a term shortened a step of the last solve, or obstacles acted on an iterate.
        negative_at_start: Negative eigenvalues of the first tangent of the last solve.
    """

    def __init__(self, newton: Newton, border: Border | None = None) -> None:
        self.newton, self.border = newton, border
        self.problem, self._settings = newton.problem, newton.settings
        self.theta, self.singular, self.met = 0.0, False, False
        self.negative_at_start: int | None = None
        self._enough: Callable[[float], bool] | None = None
        self._b = newton.problem.create_vector()
        self._snes: PETSc.SNES | None = None
        self._of: PETSc.SNES | None = None
        self._lift = self._free = False
        self._sizes: list[float] = []
        self._residuals: list[float] = []
        self._used, self._age, self._reason = 0, 0, ""
        self._factors, self._of_factors = False, None

    def solve(
        self,
        level: float = 0.0,
        free: bool = False,
        keep: bool = False,
        enough: Callable[[float], bool] | None = None,
    ) -> Convergence:
        """Correct the present state to equilibrium; it is left at the last iterate. Collective.

        Args:
            level: Force [N] that the residual is compared with, where the reactions are smaller.
            free: Newton's method in full, a tangent at each iterate, whatever its contraction, and
                damped where it is singular: for the start of a path.
            keep: Begin with the factors of the solve before, where they are still at hand, until
                their corrections do not contract.
            enough: Whether an iterate will do, by the displacement [m] that is expected of the next
                correction; collective. Linear solves are as loose then as outside of paths.
        """
        self._enough = enough
        newton, scaled = self.newton, self.newton.tangent.scaled
        newton.used()
        self._renewed = False
        crossed = self.problem.crossed()
        self.met = bool(crossed)
        if crossed:
            self.theta, self.singular = 0.0, False
            return Convergence(False, crossed, NOT_FINITE, 0, 0, 0, np.inf, level, np.inf)
        if scaled.rounding == 0:
            scaled.measure()
        before = newton.problem.u.x.array.copy()
        values = None if self.border is None else self.border.values()
        while True:
            outcome = self._run(level, free, keep)
            keep = False
            if outcome.code != Failure.LINEAR or not self._solves_better():
                break
            newton.problem.u.x.array[:] = before
            if self.border is not None and values is not None:
                self.border.put(values)
        newton.criteria.imbalance, newton.tangent.kept.exact = None, np.inf
        return explained(outcome, self.problem, newton.tangent.A)

    def forget_factors(self) -> None:
        """Begin the next solve with a tangent of its own."""
        self._factors = False

    @property
    def tangents(self) -> int:
        """Tangents that were assembled so far; products without a matrix need none."""
        return self.newton.tangent.count

    def negative(self) -> int | None:
        """Negative eigenvalues of the last tangent; None where they are not known. Collective."""
        return self.newton.tangent.negative()

    def refactor(self) -> int | None:
        """Assemble and factorize the tangent at the present state; its negative eigenvalues."""
        tangent = self.newton.tangent
        tangent.assemble()
        tangent.ksp.setOperators(tangent.product, tangent.A)
        if tangent.spoiled:
            return None
        try:
            tangent.ksp.setUp()
        except PETSc.Error:
            tangent.ksp.reset()
            return None
        return self.negative()

    def _solves_better(self) -> bool:
        """After a linear solve that failed: a fresh preconditioner, or MUMPS. Collective.

        MUMPS if the first solve of a step fails, at a state near the path. A later one that fails
        is at an iterate of a step too long. Beyond the size of factorizations contact is projected
        first.
        """
        kept = self.newton.tangent.kept
        if kept.slow:
            return self.newton.leave_multigrid()
        if kept.used and self.problem.couples and self.newton.tangent.majorize():
            return True
        if self._sizes and not self._renewed:
            self._renewed = kept.renew_if_stale()
            return self._renewed
        return not self._sizes and (kept.renew_if_stale() or self.newton.leave_multigrid())

    def _make(self) -> PETSc.SNES:
        """The SNES, made anew where the linear solver was."""
        runs = self.newton.runs
        if self._snes is None or self._of is not runs.snes:
            self.destroy(vectors=False)
            callbacks = self._function, self._jacobian, self._test, self._check
            self._of = runs.snes
            if self.border is None:
                product, A = self.newton.tangent.product, self.newton.tangent.A
                self._snes = runs.create(callbacks, self._b, (product, A), runs.snes.getKSP())
            else:
                ksp = self.border.solver(self.newton.tangent)
                matrix = ksp.getOperators()[0]
                vector = self.border.create_vector()
                self._snes = runs.create(callbacks, vector, (matrix, matrix), ksp)
                vector.destroy()
        return self._snes

    def _run(self, level: float, free: bool, keep: bool) -> Convergence:
        newton, tangent, criteria = self.newton, self.newton.tangent, self.newton.criteria
        if tangent.kept.slow:
            newton.leave_multigrid()
        if "snes_linesearch_type" in newton.options.user and self._misses():
            # Such a search would take a part of the way to the prescribed values, too.
            newton.predict()
        snes = self._make()
        tangent.projecting, tangent.spoiled, self.singular = False, False, False
        if not free:
            tangent.forget_damping()
        criteria.imbalance, criteria.correction = level, np.inf
        self._weight = level or 1.0  # force [N] by which the scalar equations are weighed
        tangent.forget_failure()
        self._lift, self._free, self._reason, self.theta = self._misses(), free, "", 0.0
        self._sizes, self._residuals, self._used, self._age = [], [], 0, 0
        tangent.kept.exact = np.inf if self._enough else self._settings.exact
        x = snes.getFunction()[0].duplicate()
        self._before = x.duplicate()
        self._get(x)
        if "snes_max_it" not in newton.options.user:
            snes.setTolerances(max_it=self._settings.most)
        tangents, solves, code = self.tangents, 0, Failure.LINEAR.value
        keep &= self._factors and snes is self._of_factors and not self._lift
        lag = -1 if keep else -2
        _petsc.lag_jacobian(snes, 1 if free or tangent.kept.used else lag)
        try:
            snes.solve(None, x)
            solves = snes.getLinearSolveIterations()
            code = code if tangent.spoiled else int(snes.getConvergedReason())
            self._put(x)
        except PETSc.Error as error:  # its vectors stay locked: all is made anew
            self._reason = _petsc.said(error)
            self._b = self._b.duplicate()
            newton.runs.remake()
        for vector in (x, self._before):
            vector.destroy()
        self.singular |= code == Failure.LINEAR and not self._sizes
        self._of_factors = self._snes
        self._factors = code == CONVERGED and not (free or tangent.kept.used)
        return Convergence(
            converged=code == CONVERGED,
            reason=self._reason or criteria.reached() if code == CONVERGED else self._why(code),
            code=code,
            iterations=len(self._sizes),
            projected=0,
            linear_iterations=solves,
            residual=criteria.last.residual,
            force_level=criteria.last.force,
            correction=float(criteria.correction),
            residuals=tuple(self._residuals),
            negative=self.negative() if code == CONVERGED else None,
            tangents=self.tangents - tangents,
            contraction=self.theta,
        )

    def _misses(self) -> bool:
        """Whether the state misses the prescribed values, by more than rounding. Collective."""
        scaled = self.newton.tangent.scaled
        scaled.get(self._b)
        before = self._b.array_r.copy()
        scaled.prescribe(self._b)
        missed = float(np.abs(self._b.array_r - before).max(initial=0.0))
        return bool(max(self.problem.comm.allgather(missed)) > 0)

    def _why(self, code: int) -> str:
        singular = REASONS[Failure.LINEAR]
        if self.border is not None and self.border.singular:
            singular = self.border.words()
        words = singular if code == Failure.LINEAR else REASONS.get(code, f"reason {code}")
        return self._reason or words

    def _get(self, z: PETSc.Vec) -> None:
        """Copy the state, scaled, into a vector."""
        if self.border is None:
            self.newton.tangent.scaled.get(z)
            return
        self.newton.tangent.scaled.get(self._b)
        self.border.join(self._b, self.border.values(), z)

    def _put(self, z: PETSc.Vec) -> None:
        """Take the state of a vector."""
        y = z
        if self.border is not None:
            y = self._b
            self.border.put(self.border.part(z, y))
        self.newton.tangent.scaled.put(y)

    def _function(self, snes: PETSc.SNES, z: PETSc.Vec, f: PETSc.Vec) -> None:
        problem, scaled, energy = self.problem, self.newton.tangent.scaled, 0.0
        self._put(z)
        if self._lift:
            problem.lifted_residual(self._b)
            self._b.pointwiseMult(self._b, scaled.D)
            problem.clear(self._b.array)
        else:
            energy, self.newton.criteria.reactions = scaled.energy_and_residual(self._b)
        if self.border is None:
            self._b.copy(f)
        else:
            self.border.join(self._b, self.border.errors(self._weight), f)
        # ln J with J < 0 spoils the energy before every part of the residual.
        if not np.isfinite(energy):
            f.set(np.nan)

    def _jacobian(self, snes: PETSc.SNES, z: PETSc.Vec, A: PETSc.Mat, P: PETSc.Mat) -> None:
        tangent = self.newton.tangent
        self._put(z)
        if self._free and self._sizes:
            tangent.forget_damping()
        tangent.assemble()
        self._used += 1
        self._age = 1 if self._sizes and tangent.kept.used else 0
        if self.border is not None:
            tangent.ksp.setOperators(tangent.product, tangent.A)
            self.border.update(self._weight, self._free)

    def _check(self, z: PETSc.Vec, step: PETSc.Vec) -> bool:
        """Let the first correction end at the prescribed values; keep to what terms allow."""
        lifted, fraction, own = self._lift, 1.0, self._b.getLocalSize()
        if lifted:
            self._b.array[:] = z.array_r[:own]
            self.newton.tangent.scaled.prescribe(self._b)
            taken = step.array[:own]
            self.problem.clear(taken)
            taken += z.array_r[:own] - self._b.array_r
        if self.problem.bounds_steps:
            moves = {}
            if self.border is None:
                step.copy(self._b)
            else:
                dq = self.border.part(step, self._b)
                moves = {q: -float(d) for q, d in zip(self.border.q, dq, strict=True)}
            fraction = self.newton.runs.allowed(self._b, moves)
            step.scale(min(fraction, 1.0))
            self.met |= fraction < 1 or self.problem.touches()
        # What a term has shortened is still to go, for prescribed values too.
        self._lift = lifted and fraction < 1
        return lifted or fraction < 1

    def _test(self, snes: PETSc.SNES, iteration: int, norms: tuple[float, float, float]) -> int:
        """SNES's convergence test, in which the contraction decides; a code, 0 to go on."""
        tangent, criteria, settings = self.newton.tangent, self.newton.criteria, self._settings
        before, z = criteria.last, snes.getSolution()
        norm = float(norms[2])
        if np.isfinite(norm) and self.border is not None:
            norm = self.border.residual(snes.getFunction()[0])
        self._residuals.append(norm)
        if not np.isfinite(norm):  # of a lifted residual the tangent is to blame
            return Failure.LINEAR if iteration == 0 and self._lift else NOT_FINITE
        off = 0.0
        if self.border is not None:
            criteria.imbalance = max(criteria.imbalance or 0.0, self.border.load_level())
            off = self.border.off()
        if iteration == 0:
            criteria.take(norm)
            tangent.kept.goal = criteria.goal
            z.copy(self._before)
            return 0
        if iteration == 1:
            self.negative_at_start = self.negative()
        if tangent.spoiled or (self.border is not None and self.border.singular):
            return Failure.LINEAR
        criteria.corrected(z, self._before)
        z.copy(self._before)
        criteria.take(norm)
        tangent.kept.goal = criteria.goal
        ratio = self._contraction(snes, norm / before.residual if before.residual > 0 else 0.0)
        size, most = tangent.scaled.size, criteria.ctol * tangent.scaled.size
        if iteration == 1 and criteria.correction > FAR * size and not self._free:
            self.singular = True
            return Failure.LINEAR
        if self._enough and not self._lift and self._enough(criteria.correction * ratio):
            self._reason = "near enough"
            return CONVERGED
        settled = norm <= criteria.goal and off <= criteria.rtol and not self._lift
        # Extrapolation magnifies what is left, in soft directions above all; back-solves are cheap.
        close = most if self._free or tangent.kept.used else settings.settle * most
        if settled and criteria.correction * ratio <= close:
            return CONVERGED
        # Where a stiff part beside a soft one is rounded, forces fall no further.
        stuck = norm > 0.5 * before.residual and norm <= STUCK * criteria.goal
        stuck &= off <= criteria.rtol and criteria.correction <= 1e-3 * most and not self._lift
        if stuck and iteration > 1:
            return CONVERGED
        if tangent.kept.slow:
            return Failure.LINEAR
        # By the second correction of one tangent: later ones by kept factors may meet errors in
        # soft directions that the first ones have made, which another tangent mends.
        if self._age == 2 and not self._free and ratio > settings.refuse:
            if self._used == 0 and not tangent.kept.used:  # by factors of an earlier solve
                _petsc.lag_jacobian(snes, -2)
                return 0
            if criteria.correction > most:
                self._reason = f"corrections contract by {ratio:.2g} only"
                return Failure.NO_CONTRACTION
        if self._age > 1 and ratio > settings.reuse and not (self._free or tangent.kept.used):
            if self._used >= settings.most_tangents:
                return Failure.USED_UP
            _petsc.lag_jacobian(snes, -2)
        return Failure.USED_UP if iteration >= snes.getTolerances()[3] else 0

    def _contraction(self, snes: PETSc.SNES, forces: float) -> float:
        """Ratio of the last two corrections; that of forces for iterative first and loose ones."""
        criteria, update = self.newton.criteria, snes.getSolutionUpdate()
        own = update.array_r[: self._b.getLocalSize()]
        size = float(np.sqrt(self.problem.comm.allreduce(float(own @ own))))
        self._sizes.append(size)
        self._age += 1
        if len(self._sizes) == 1:
            self._tiny = criteria.correction <= criteria.ctol * self.newton.tangent.scaled.size
            return min(1.0, forces) if self.newton.tangent.kept.used else 1.0
        last = self._sizes[-2]
        theta = size / last if last > 0 else 0.0
        if len(self._sizes) == 2:
            # Of corrections at the tolerance the ratio is noise.
            self.theta = 0.0 if self._tiny else theta
        return min(theta, forces) if self._enough and self.newton.tangent.kept.used else theta

    def destroy(self, vectors: bool = True) -> None:
        """Free the PETSc objects."""
        if self.border is not None:
            if self._snes is not None:
                self._snes.destroy()
            self.border.release()
        self._snes = None
        if vectors:
            self._b.destroy()
            if self.border is not None:
                self.border.destroy()
