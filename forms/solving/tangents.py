# SPDX-License-Identifier: MIT
"""The tangent on its way into a linear solver: projected, damped, preconditioned, factorized."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from petsc4py import PETSc

from ..differentiation import dependents
from ..problems import Problem
from .damping import Damping
from .linear import presets
from .linear.action import Action
from .linear.kept import Kept
from .linear.rigid import rigid_modes
from .options import SolverOptions
from .scaling import Scaled
from .settings import Settings
from .stability import inertia


class Tangent:
    """A problem's tangent, and the solver of its linear systems.

    Args:
        problem: Whose tangent it is.
        options: PETSc options of the solver.
        settings: Numbers that it is tuned by.
        force: Function that returns the force level [N], which damping is compared with where the
            tangent has no stiffness at all.

    Attributes:
        A: Matrix of the assembled tangent.
        scaled: The problem in one unit.
        preset: Options in use that are the package's own.
        projecting: Whether the tangent is made positive semi-definite.
        damping: What is added where it is singular; None so far.
        spoiled: Whether the last one was not finite; its steps are not taken.
        left_multigrid: Whether MUMPS has taken the place of multigrid.
        ksp: SNES's linear solver.
        kept: How long its preconditioner is kept.
        count: Tangents that were assembled so far.
    """

    kept: Kept
    ksp: PETSc.KSP

    def __init__(
        self,
        problem: Problem,
        options: SolverOptions,
        settings: Settings,
        force: Callable[[], float],
    ) -> None:
        self.problem, self._options, self._settings = problem, options, settings
        self._force = force
        self.A = problem.create_matrix()
        self.scaled = Scaled(problem, self.A)
        self.projecting = self.spoiled = self.left_multigrid = False
        self.damping: Damping | None = None
        self.count = 0
        self._action: Action | None = None
        self.preset = presets.preset(problem, self.A, settings)
        if self.preset.get("pc_type") in ("gamg", "mg"):
            problem.forms.use_moduli()
        if problem.minimization and problem.is_displacement:
            self.A.setNearNullSpace(rigid_modes(problem.u.function_space))

    def configure(self, base: Mapping[str, str]) -> None:
        """Put the options of SNES and of the preset, before SNES is made."""
        preset, user = self.preset, self._options.user
        own = "pc_type" not in user
        if not own:  # another preconditioner has no use for this one's options
            preset = {k: v for k, v in preset.items() if k.split("_")[0] not in ("pc", "mat", "mg")}
        # Where multigrid is kept, the tangent that it was built of is out of date on purpose. An
        # energy in singular values without moduli would find these anew at each product.
        matrix_free = own and preset.get("pc_type") == "mg"
        moduli = self.problem.forms.moduli
        products = self.problem.forms.tangent_ufl if moduli is None else moduli.rest_ufl
        matrix_free &= products is None or not dependents(products)
        matrix_free &= len(self.problem.terms) == 1
        self._action = Action(self.problem, self.A) if matrix_free else None
        if self._action is not None and not self._action.pays():
            self._action.destroy()
            self._action = None
        self._options.apply({**base, **preset})
        self._chosen = preset if own else {}

    def attach(self, ksp: PETSc.KSP) -> None:
        """Take SNES's linear solver."""
        self.ksp = ksp
        ksp.setPostSolve(self._hold)
        options = self._options
        self.kept = Kept(
            self.problem, ksp, self._chosen, options.prefix, options.user, self._settings
        )

    def detach(self) -> None:
        """Free what belongs to a linear solver that is made anew."""
        self.kept.destroy()
        if self._action is not None:
            self._action.destroy()
            self._action = None

    @property
    def product(self) -> PETSc.Mat:
        """What linear solvers multiply with."""
        return self.A if self._action is None else self._action.matrix

    def assemble(self) -> None:
        """Assemble the tangent at u, if the solver needs it, and hand it over. Collective."""
        if self._action is not None:
            self._action.assembled = self.projecting or self.damping is not None
            if not self._action.assembled and not self.kept.due:
                self.problem.prepare()
                self._action.update()
                self.kept.prepare(self.A)
                return
        self.scaled.tangent(self.projecting)
        if self.problem.repatterned:
            self.kept.repattern()
            self.ksp.setOperators(self.product, self.A)
        self.use()

    def use(self) -> None:
        """Damp the assembled tangent if need be, and hand it to the linear solver. Collective."""
        self.count += 1
        self.refresh()
        self.spoiled = not self.scaled.is_finite()
        if self.spoiled:
            # MUMPS and GAMG would raise in the midst of SNES.
            self.A.zeroEntries()
            self.A.shift(1.0)
        elif self.projecting and self.damping is None:
            self.damp()
        if self.damping is not None and not self.spoiled:
            self.damping.add(self.A)
        self.kept.prepare(self.A)

    def refresh(self) -> None:
        """Bring products without a matrix to the present state. Collective."""
        if self._action is not None and not self._action.assembled:
            self._action.update()

    def stable_by_curvature(self) -> bool | None:
        """Whether CG sees no negative curvature at the present state; None without. Collective.

        Where it does, MUMPS is to take the place of multigrid for good, and counts.
        """
        if not (self.kept.used and self.problem.minimization) or self.majorizes:
            return None
        self.refresh()
        return not self.kept.sees_negative_curvature()

    def damp(self) -> None:
        """Damp the tangent from now on; compared with the assembled one, or with the forces."""
        force = self._force() or 1.0
        size = self.scaled.size
        self.damping = Damping(self.problem, self.A, self.scaled.free, self._settings, force / size)

    def solve(self, b: PETSc.Vec, x: PETSc.Vec) -> bool:
        """Solve K x = b; whether that succeeded. Collective."""
        try:
            self.ksp.solve(b, x)
        except PETSc.Error:
            self.ksp.reset()
            return False
        return bool(self.ksp.getConvergedReason() > 0)

    def forget_failure(self) -> None:
        """Start the linear solver anew after a failure, which MUMPS does not forget."""
        if self.ksp.getConvergedReason() < 0 and not self.kept.used:
            self.ksp.reset()  # of multigrid it would take the levels
            self.ksp.setOperators(self.product, self.A)

    def may_leave_multigrid(self) -> bool:
        """Choose MUMPS in place of multigrid for good; False where that was not in use."""
        if not self.kept.used:
            return False
        self.preset = presets.direct(self.problem.symmetric)
        self.left_multigrid = True
        return True

    @property
    def majorizes(self) -> bool:
        """Whether contact of surfaces enters projected, so that the tangent is not its own."""
        return any(getattr(term, "majorized", False) for term in self.problem.terms)

    def majorize(self, so: bool = True) -> bool:
        """Have contact of surfaces projected from now on; whether that is anything new.

        As they come to touch, the tangent passes states where it is not definite. Up to a size
        MUMPS is faster there, beyond it multigrid with more iterations of Newton's method.
        """
        able: list[Any] = [term for term in self.problem.terms if hasattr(term, "majorized")]
        if so and (self.majorizes or self.problem.size <= self._settings.factorized_up_to):
            return False
        for term in able:
            term.majorized = so
        self.kept.renew()
        return bool(able)

    def is_ruined(self) -> bool:
        """Whether so much of the last tangent is negative that its step leads nowhere."""
        if not (self._is_its_own() and self.problem.minimization):
            return False
        negative = inertia(self.ksp, self.problem)
        return negative is not None and negative > self._settings.ruined * self.problem.size

    def negative(self) -> int | None:
        """Negative eigenvalues of the last tangent, where it was the full one and factorized."""
        return inertia(self.ksp, self.problem) if self._is_its_own() else None

    def _is_its_own(self) -> bool:
        light = self.damping is None or self.damping.strength <= self._settings.light
        return not self.projecting and light

    def _hold(self, ksp: PETSc.KSP, b: PETSc.Vec, step: PETSc.Vec) -> None:
        """Keep supports exact: multigrid's coarse levels may move them by its tolerance."""
        self.problem.clear(step.array)
        if self.spoiled:
            step.set(0)
        self.kept.count()

    def begin(self) -> bool:
        """Forget what earlier solves have left; whether the solvers have to be made anew."""
        self.forget_damping()
        self.scaled.begin()
        self.projecting = self.spoiled = False
        self.majorize(False)
        again = self.left_multigrid
        if again:
            self.left_multigrid = False
            self.preset = presets.preset(self.problem, self.A, self._settings)
        return again

    def forget_damping(self) -> None:
        """Take the damping back."""
        if self.damping is not None:
            self.damping.destroy()
            self.damping = None

    def memory(self) -> dict[str, Any]:
        """What is kept from one load to the next: damping, and that multigrid failed."""
        left = presets.direct(self.problem.symmetric) == self.preset
        damping = self.damping and (self.damping.scale, self.damping.strength)
        return {"direct": left, "majorizes": self.majorizes, "damping": damping}

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Take the damping of an earlier one's memory, after the first tangent. Collective."""
        if memory.get("majorizes"):
            self.majorize()
        if memory["damping"]:
            if self.damping is None:
                self.damp()
            assert self.damping is not None
            self.damping.scale, self.damping.strength = memory["damping"]

    def destroy(self) -> None:
        """Free the matrices."""
        self.detach()
        self.forget_damping()
        for item in (self.A, self.scaled):
            item.destroy()
