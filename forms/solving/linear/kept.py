# SPDX-License-Identifier: MIT
"""How long a preconditioner is kept: a lagged preconditioner, and how exact its solves are."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from petsc4py import PETSc

import numpy as np

from ...problems import Problem
from .conjugate import conjugate_gradients
from .cycle import cycled
from .fieldsplit import FieldSplit
from .order import OrderMultigrid

CYCLES = 2.0  # by aggregation alone, that cost as much as one over the order
PROBED = 1e-3  # relative tolerance of a solve that looks for negative curvature


class Kept:
    """When a multigrid preconditioner is built, and how far its linear solves go.

    A lagged preconditioner: built at the start of a path, and again when it slows down. What is
    kept are the coarser operators, and where no tangent is assembled
    (:class:`forms.solving.linear.action.Action`) the smoother too; else smoothers, and the blocks
    of a mixed unknown, see the present tangent. Newton's directions are solved for to the preset's
    tolerance (an inexact Newton method), the last one as far as it takes to get below the goal.

    Args:
        problem: Problem that is solved.
        ksp: Solver with its options set.
        preset: Options in use that are the package's own; empty where the user chose.
        prefix: Prefix of the options.
        user: Options that are the user's.
        settings: Numbers that it is tuned by (:class:`forms.solving.settings.Settings`).

    Attributes:
        used: Whether there is anything to keep.
        due: Whether it is built anew at the next tangent.
        stale: Whether the last solve used a preconditioner of an earlier state.
        slow: Whether a factorization would be faster.
        goal: Norm of the forces [N] at which Newton's method is to end; 0 where unknown.
        exact: Largest relative tolerance of solves within a path, whose contraction is to tell of
            Newton's method and not of them; infinite elsewhere.
    """

    def __init__(
        self,
        problem: Problem,
        ksp: PETSc.KSP,
        preset: Mapping[str, str],
        prefix: str,
        user: Mapping[str, Any],
        settings: Any,
    ) -> None:
        self.exact = np.inf
        self._probing = self._beside = False
        self.used, self.goal = preset.get("ksp_type") in ("cg", "gmres"), 0.0
        self._settings, self._worth = settings, settings.slower
        self._levels: OrderMultigrid | None = None
        self._blocks: FieldSplit | None = None
        kind = preset.get("pc_type") if self.used else None
        if kind == "mg":
            V = problem.u.function_space
            self._levels = OrderMultigrid(V, problem, ksp, prefix)
        elif kind == "gamg":
            cycled(ksp, user)
            self._worth = CYCLES * settings.slower
        elif kind == "python":
            self._blocks = FieldSplit(problem, ksp, prefix)
        self._ksp, self.stale, self.due = ksp, False, True
        self._first = self._extra = 0.0
        self._problem = problem
        self.slow, self._small = False, problem.size <= settings.factorized_up_to
        self._own = "ksp_rtol" not in user, "ksp_max_it" not in user
        self._rtol, *_, self._most = ksp.getTolerances()
        self._asked = self._rtol
        if self.used:
            # Not earlier: SNES asks for a new preconditioner after each tangent.
            ksp.setPreSolve(self._begin)

    def _begin(self, ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """Say what is kept, and set the tolerances of this solve. Collective."""
        settings = self._settings
        if self._probing:
            return
        ksp.getPC().setReusePreconditioner(self.stale)
        norm = b.norm()
        enough = settings.below * self.goal / norm if norm > 0 else 0.0
        self._asked = min(self._rtol, self.exact) if self._own[0] else self._rtol
        if self._own[0] and enough >= 10.0**-settings.digits:
            self._asked = min(enough, settings.loosest)
        most = self._most
        if self._own[1] and self.stale:
            most = min(most, max(20, int(settings.patience * self._first * -np.log10(self._asked))))
        ksp.setTolerances(rtol=self._asked, max_it=most)

    def begin(self) -> None:
        """Forget how earlier solves went, and build anew at the next tangent."""
        self.stale, self.due, self.slow = False, True, False
        self._first, self._extra, self.goal, self._asked = 0.0, 0.0, 0.0, self._rtol

    def repattern(self) -> None:
        """The next tangent has another pattern: nothing that was made of the last one fits."""
        if self._levels is not None:
            self._levels.forget()
        else:
            self._ksp.getPC().reset()
        self.due = True

    def renew(self) -> None:
        """Build anew at the next tangent."""
        self.due = True

    def renew_if_stale(self) -> bool:
        """Build anew at the next tangent where the last one was not its own; whether it was so."""
        self.due |= self.stale
        return self.stale

    def prepare(self, A: PETSc.Mat) -> None:
        """Build the preconditioner for a tangent just assembled, or keep it. Collective."""
        if not self.used:
            return
        if self.due and self._levels is not None:
            self._levels.update(A)
        if self._blocks is not None:
            self._blocks.update(A, coarse=self.due)
        if self.due:
            self._first = self._extra = 0.0
        self.stale, self.due = not self.due, False

    def count(self) -> None:
        """Take note of the iterations of the linear solve that has just ended."""
        if not self.used or self._probing or self._beside:
            return
        iterations, digits = self._ksp.getIterationNumber(), -np.log10(self._asked)
        each = iterations / digits
        self._first = self._first or each
        self._extra += max(0.0, iterations - self._first * digits)
        if self._extra > self._worth:
            self.renew()
        exhausted = self._ksp.getConvergedReason() == PETSc.KSP.ConvergedReason.DIVERGED_MAX_IT
        self.slow = self._small and not self.stale and (each > self._settings.slow or exhausted)

    def solve_to(self, rtol: float, b: PETSc.Vec, x: PETSc.Vec) -> bool:
        """Solve for a right-hand side to a tolerance, by what is kept; whether it was reached.

        Neither counts nor changes anything of what is kept. Collective.
        """
        ksp = self._ksp
        ksp.getPC().setReusePreconditioner(self.stale)
        ksp.setTolerances(rtol=rtol, max_it=max(self._most, 500))
        kind = ksp.getNormType()
        ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
        self._probing = True
        try:
            ksp.solve(b, x)
        except PETSc.Error:
            return False
        finally:
            self._probing = False
            ksp.setNormType(kind)
        return bool(ksp.getConvergedReason() > 0)

    def spare(self) -> bool:
        """Keep what there is, if anything was built, for the next tangent; whether it was due."""
        due, built = self.due, self._first > 0
        self.due = due and not built
        return due

    @contextmanager
    def aside(self) -> Iterator[None]:
        """Have solves beside a path neither count nor decide when anything is built anew."""
        due, self._beside = self.spare(), True
        try:
            yield
        finally:
            self._beside = False
            self.due |= due

    def solve_near(
        self,
        x: PETSc.Vec,
        r: PETSc.Vec,
        near: Callable[[PETSc.Vec, PETSc.Vec], float],
        least: float,
    ) -> int | None:
        """Improve x by CG until its error in energy is small enough; iterations, None if in vain.

        As :func:`forms.solving.linear.conjugate.conjugate_gradients`, by what is kept, of which
        nothing is counted or changed. Collective.
        """
        ksp = self._ksp
        if ksp.getType() != "cg":
            return None
        ksp.getPC().setReusePreconditioner(self.stale)
        try:
            ksp.setUp()
            A, _ = ksp.getOperators()
            reached, count = conjugate_gradients(A, ksp.getPC(), x, r, near, least, self._most)
        except PETSc.Error:
            return None
        return count if reached else None

    def sees_negative_curvature(self) -> bool:
        """Whether CG for a right-hand side without symmetry meets negative curvature. Collective.

        Its Lanczos vectors find an eigenvalue below zero that stands apart, as the preconditioned
        ones of an unstable body do; where none is seen there need be none.
        """
        ksp, A = self._ksp, self._ksp.getOperators()[0]
        b, x = A.createVecLeft(), A.createVecRight()
        begin, end = b.getOwnershipRange()
        b.array[:] = np.sin(1.0 + 0.7 * np.arange(begin, end) ** 1.5)
        self._problem.clear(b.array)
        ksp.getPC().setReusePreconditioner(True)
        ksp.setTolerances(rtol=PROBED, max_it=self._most)
        self._probing = True
        try:
            ksp.solve(b, x)
        finally:
            self._probing = False
        for item in (b, x):
            item.destroy()
        return ksp.getConvergedReason() == PETSc.KSP.ConvergedReason.DIVERGED_INDEFINITE_MAT

    def destroy(self) -> None:
        """Free the matrices."""
        for item in (self._levels, self._blocks):
            if item is not None:
                item.destroy()
        self.used, self._levels, self._blocks = False, None, None
