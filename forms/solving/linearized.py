# SPDX-License-Identifier: MIT
"""The tangent at a converged state, ready for right-hand sides: what the last solve left is used.

Factors and multigrid of an earlier state serve as preconditioners of the tangent at this one: its
systems are solved by correcting, x <- x + P^-1 (b - K x), or by CG with multigrid, to a tolerance
that is seen in the residual.
"""

from __future__ import annotations

from collections.abc import Callable
from types import TracebackType

from petsc4py import PETSc

import numpy as np

from ..paths import NotConverged
from ..problems import Problem
from .linear import presets
from .newton import Newton
from .reuse import solver_of

SLOW = 0.3  # contraction above which factors of an earlier state are made anew
MOST = 40  # corrections
TIGHT, LOOSE = 1e-10, 1e-6
NEAR = 3e-6  # error of an adjoint in energy, over its own
OFF = 1e-3  # forces out of balance, over the forces that there are, of a state to be refused


class Linearized:
    """K x = b, or K^T x = b, of a problem at its present state, 0 where supports prescribe values.

    Collective; a context, at whose end the solver is the problem's again.

    Args:
        problem: At a converged state.
        rtol: Tolerance of |b - K x| relative to |b|; by default 1e-10 with a factorization, and
            with multigrid 1e-6.
        near: Whether with multigrid an error of 3e-6 in energy is small enough, where the solve is
            told of the energy that counts.
    """

    def __init__(self, problem: Problem, rtol: float | None = None, near: bool = False) -> None:
        self.problem, self._asked = problem, rtol
        self._may_be_near = near and rtol is None
        self.iterations = 0
        self._own: PETSc.KSP | None = None

    def __enter__(self) -> Linearized:
        self._newton, self._kept = solver_of(self.problem)
        tangent = self._tangent = self._newton.tangent
        self._newton.options.resume()
        tangent.forget_damping()
        fresh = tangent.count == 0 or tangent.spoiled or tangent.projecting
        tangent.projecting = tangent.spoiled = False
        if tangent.scaled.rounding == 0:
            tangent.scaled.measure()
        # Built anew it would cost more than the iterations that it saves in one or two solves.
        self._due = tangent.kept.spare()
        tangent.ksp.setOperators(tangent.product, tangent.A)
        tangent.assemble()
        self._rtol = self._asked or (LOOSE if tangent.kept.used else TIGHT)
        self._stale = not fresh and not tangent.kept.used
        self._r, self._dx, self._b = (self.problem.create_vector() for _ in range(3))
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: TracebackType | object) -> None:
        for item in (self._r, self._dx, self._b, self._own):
            if item is not None:
                item.destroy()
        self._own = None
        self._tangent.kept.due |= self._due
        if not self._tangent.kept.used:
            self._tangent.ksp.getPC().setReusePreconditioner(False)
        self._newton.options.rest()
        if not self._kept:
            self._newton.destroy()

    def solve(
        self,
        b: PETSc.Vec,
        x: PETSc.Vec,
        transposed: bool = False,
        energy: Callable[[PETSc.Vec, PETSc.Vec], float] | None = None,
    ) -> None:
        """Solve K x = b, or with the transposed; b is left as it is. Collective.

        Args:
            b: Right-hand side.
            x: Solution.
            transposed: Whether K^T takes the place of K.
            energy: Function of x and b - K x that returns the energy a . K a of what x is needed
                for, which the error is compared with.

        Raises:
            NotConverged: the tangent is singular, as at a limit point.
        """
        D = self._tangent.scaled.D
        transposed = transposed and not self.problem.symmetric
        b = self._scaled(b)
        norm = b.norm()
        x.set(0)
        if norm == 0:
            return
        near = energy is not None and self._near(b, x, norm, energy)
        if not near and not (np.isfinite(norm) and self._solved(b, x, norm, transposed)):
            raise NotConverged(
                "the tangent's linear system could not be solved to "
                f"{self._rtol:g}: is the state a limit point, or not in equilibrium?"
            )
        x.pointwiseMult(x, D)

    def check_equilibrium(self, what: str) -> None:
        """Refuse a state that was not solved for. Collective.

        Its forces out of balance are compared with the reactions, and with K_ii u_i.

        Raises:
            ValueError: it is not in equilibrium.
        """
        scaled = self._tangent.scaled
        reactions = scaled.residual(self._r)
        off, level = self._r.norm(), max(reactions, scaled.unknowable())
        if off <= OFF * level:
            return
        diagonal = self._tangent.A.getDiagonal()
        scaled.get(self._dx)
        self._dx.pointwiseMult(self._dx, diagonal)
        diagonal.destroy()
        level = max(level, self._dx.norm())
        if not off <= OFF * level:
            raise ValueError(
                f"{what} needs a state in equilibrium, got forces of {off:.2g} N out of balance "
                f"and of {level:.2g} N in all: solve first, and pass what the solve returned."
            )

    def _scaled(self, b: PETSc.Vec) -> PETSc.Vec:
        self._b.pointwiseMult(b, self._tangent.scaled.D)
        self.problem.clear(self._b.array)
        return self._b

    def _near(
        self,
        b: PETSc.Vec,
        x: PETSc.Vec,
        norm: float,
        energy: Callable[[PETSc.Vec, PETSc.Vec], float],
    ) -> bool:
        """Solve until the error in energy is small enough; False where another way is to be taken.

        The gradient's own error is that in energy: of forces at supports, whose residual falls
        with it, and of integrals over the body, whose residual falls later.
        """
        kept, scaled = self._tangent.kept, self._tangent.scaled
        if not (self._may_be_near and kept.used and self.problem.symmetric):
            return False
        if self._own is not None or scaled.mixed or not np.isfinite(norm):
            return False
        self._begun(b, x, norm)
        count = kept.solve_near(x, self._r, lambda x, r: NEAR**2 * energy(x, r), self._rtol * norm)
        if count is None:
            x.set(0)
            return False
        self.problem.clear(x.array)
        self.iterations += count
        return True

    def _solved(self, b: PETSc.Vec, x: PETSc.Vec, norm: float, transposed: bool) -> bool:
        """Correct x until |b - K x| is small enough; with factors made anew where need be."""
        if self._own is None and self._corrected(b, x, norm, transposed):
            return True
        if self._own is None and self._tangent.kept.used:
            self._factorize()
            x.set(0)
            return self._corrected(b, x, norm, transposed)
        return False

    def _corrected(self, b: PETSc.Vec, x: PETSc.Vec, norm: float, transposed: bool) -> bool:
        last = self._begun(b, x, norm)
        for _ in range(MOST):
            if not self._step(norm, transposed):
                return False
            x.axpy(1.0, self._dx)
            self._product(x, self._r, transposed)
            self._r.aypx(-1.0, b)
            now = self._r.norm()
            if now <= self._rtol * norm:
                return True
            if not now <= SLOW * last:
                if not self._stale:
                    # Rounding of an ill-conditioned tangent lets it come no nearer.
                    return bool(now <= max(1e-6, self._rtol) * norm and now >= 0.1 * last)
                self._stale = False
                x.set(0)
                b.copy(self._r)
                now = norm
            last = now
        return False

    def _begun(self, b: PETSc.Vec, x: PETSc.Vec, norm: float) -> float:
        """Begin at 0, or for multigrid at the multiple of u of least energy; norm of what is left.

        How a body moves with what is measured on it is often much like how it has moved.
        """
        b.copy(self._r)
        if not (self._own is None and self._tangent.kept.used and self.problem.symmetric):
            return norm
        u, r = self._dx, self._r
        self._tangent.scaled.get(u)
        self.problem.clear(u.array)
        self._product(u, r, False)
        work = u.dot(r)
        part = u.dot(b) / work if work > 0 else 0.0
        r.aypx(-part, b)
        left = float(r.norm())
        if left < norm:
            x.axpy(part, u)
            return left
        b.copy(r)
        return norm

    def _step(self, norm: float, transposed: bool) -> bool:
        """Solve for a correction by what there is; whether that succeeded."""
        r, dx, tangent = self._r, self._dx, self._tangent
        if self._own is not None:
            (self._own.solveTranspose if transposed else self._own.solve)(r, dx)
            return bool(self._own.getConvergedReason() > 0)
        ksp = tangent.ksp
        if tangent.kept.used:
            solved = tangent.kept.solve_to(0.5 * self._rtol * norm / r.norm(), r, dx)
            self.iterations += ksp.getIterationNumber()
            return solved
        ksp.getPC().setReusePreconditioner(self._stale)
        try:
            (ksp.solveTranspose if transposed else ksp.solve)(r, dx)
        except PETSc.Error:
            ksp.reset()
            return False
        self.iterations += 1
        if ksp.getConvergedReason() <= 0 or not np.isfinite(dx.norm()):
            ksp.reset()  # MUMPS does not forget a failure
            return False
        return True

    def _product(self, x: PETSc.Vec, y: PETSc.Vec, transposed: bool) -> None:
        matrix = self._tangent.product if self._own is None else self._tangent.A
        (matrix.multTranspose if transposed else matrix.mult)(x, y)

    def _factorize(self) -> None:
        """MUMPS where multigrid fails, as in an unstable state."""
        tangent = self._tangent
        tangent.scaled.tangent()
        self._own = PETSc.KSP().create(self.problem.comm)
        self._own.setOperators(tangent.A)
        self._own.setType("preonly")
        pc = self._own.getPC()
        options = presets.direct(self.problem.symmetric)
        pc.setType(options["pc_type"])
        pc.setFactorSolverType("mumps")
        self._stale = False

    @property
    def newton(self) -> Newton:
        """Whose tangent it is."""
        return self._newton
