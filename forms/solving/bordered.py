# SPDX-License-Identifier: MIT
"""Bordered systems: one scalar unknown beside the field, one scalar equation beside equilibrium.

R(u, q) = 0,  g(u, q) = 0

A pressure q that holds a volume, a load factor that holds a displacement or a distance along the
path. Two solves with the factors of K, the tangent of u, solve the bordered system
[[K, R_q], [g_u, g_q]], which is regular at a limit point too. Where K has no stiffness in some
direction, as a flat sheet, it is damped.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Protocol

from petsc4py import PETSc

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from ufl.algorithms import expand_derivatives
from ufl.algorithms.analysis import extract_constants

from ..compilation import compiled
from ..differentiation import dependents, expanded
from ..operators.jets import Jet
from ..paths import Convergence
from ..problems import Problem
from .damping import Damping
from .finite import ADVICE, not_finite
from .linear import presets
from .options import SolverOptions
from .scaling import Scaled
from .settings import Settings
from .stability import inertia

PREFIX = "variform_bordered_"


class Constraint(Protocol):
    """The scalar equation: g at the present state, its scale, and its derivatives."""

    @property
    def scale(self) -> float:
        """What the constraint's error is compared with."""

    def value(self) -> float:
        """The constraint g, 0 where it holds."""

    def gradient(self, g_u: PETSc.Vec) -> float:
        """Assemble g_u, of the scaled unknown, into a vector; return g_q."""


class Bordered:
    """Newton's method for (u, q).

    Args:
        problem: Its potential contains q.
        q: Scalar unknown.
        rtol: Tolerance of |R_free| relative to the force level, and of g relative to its scale.
        ctol: Tolerance of the last correction relative to the model's size.
        max_iterations: Newton iterations per solve.

    Raises:
        ValueError: q is not in the potential, or stands inside the operand of an energy in
            singular values.
    """

    def __init__(
        self,
        problem: Problem,
        q: fem.Constant,
        rtol: float = 1e-8,
        ctol: float = 1e-6,
        max_iterations: int = 30,
    ) -> None:
        self.problem = problem
        self.q, self.rtol, self.ctol, self.most = q, rtol, ctol, max_iterations
        self.degree = problem.displacement_degree
        R_q = by_constant(problem.forms.residual_ufl, q)
        if R_q.empty():
            raise ValueError("the potential does not contain q: write a load with it.")
        self._R_q = compiled(R_q)
        self.A, self.b = self.problem.create_matrix(), self.problem.create_vector()
        self.scaled = Scaled(self.problem, self.A)
        self.R, self.R_q, self.du, self.du_q, self.g_u = (self.b.duplicate() for _ in range(5))
        self.damping: Damping | None = None
        self.fresh = True  # not solved yet: the start may be flat
        self.ksp = PETSc.KSP().create(self.problem.comm)
        self.options = SolverOptions(PREFIX)
        self.options.apply(presets.direct(self.problem.symmetric))
        self.ksp.setOptionsPrefix(self.options.prefix)
        self.ksp.setFromOptions()

    @property
    def load(self) -> float:
        """The scalar unknown."""
        return float(self.q.value)

    def solve(self, constraint: Constraint) -> Convergence:
        """Newton iterations from present values; u and q are left at the last ones. Collective."""
        if self.scaled.rounding == 0:
            self.scaled.measure()
        if self.damping is not None:
            self.damping.restart()
        correction, level, residuals = np.inf, 0.0, []
        reason, converged, iteration, negative = "the iterations were used up", False, 0, None
        advice = ""
        for iteration in range(self.most + 1):
            reactions = self.scaled.residual(self.R)
            self.assemble(self._R_q, self.R_q)
            # The load itself, q R_q, is what the residual is the imbalance of.
            level = max(level, reactions, abs(self.load) * self.R_q.norm())
            residuals.append(self.R.norm())
            off = constraint.value()
            if not np.isfinite(residuals[-1] + off):
                reason = "the state is not finite"
                break
            small = residuals[-1] <= max(self.rtol * level, self.scaled.floor())
            if small and abs(off) <= self.rtol * constraint.scale:
                converged = correction <= self.ctol * self.scaled.size
                if converged:
                    self.fresh = False
                    reason = "both tolerances reached"
                    break
            if iteration == self.most:
                break
            g_q = constraint.gradient(self.g_u)
            # A flat sheet's K is singular, and MUMPS need not notice.
            dq = self._step(off, g_q, damped=iteration == 0 and self.fresh and self.can_damp)
            if dq is None:
                self.scaled.tangent()
                cause = not_finite(self.problem, self.A)
                reason = cause or "the bordered system is singular"
                advice = ADVICE if cause else ""
                break
            negative = inertia(self.ksp, self.problem)
            correction = self.move(-1.0, self.du, dq)
        return Convergence(
            converged=converged,
            reason=reason,
            code=2 if converged else -5,
            iterations=iteration,
            projected=0,
            linear_iterations=2 * iteration,
            residual=residuals[-1],
            force_level=level,
            correction=float(correction),
            residuals=tuple(residuals),
            negative=negative,
            advice=advice,
            solver="Newton's method",
        )

    def memory(self) -> float | None:
        """Scale of the damping, where there is one."""
        return None if self.damping is None else self.damping.scale

    def recall(self, scale: float | None) -> None:
        """Go on as the solver of an earlier run, with its damping. Collective."""
        self.fresh = False
        if scale is not None:
            self.damping = Damping(self.problem, self.A, self.scaled.free, Settings())
            self.damping.scale = scale

    def tangent(self) -> int | None:
        """Solve K du_q = R_q at the present state: the path goes along (-du_q, 1). Collective.

        Returns:
            Number of negative eigenvalues of K, None where it is not known.
        """
        self.assemble(self._R_q, self.R_q)
        self.scaled.tangent()
        if self.fresh and self.can_damp:
            self._damp()
        self.ksp.setOperators(self.A)
        if not (self.scaled.is_finite() and self._solves(self.R_q, self.du_q)):
            self.du_q.set(np.nan)
            return None
        return inertia(self.ksp, self.problem)

    def _solves(self, b: PETSc.Vec, x: PETSc.Vec) -> bool:
        """Solve K x = b; whether that succeeded. Collective."""
        try:
            self.ksp.solve(b, x)
        except PETSc.Error:
            return False
        return bool(self.ksp.getConvergedReason() > 0)

    @property
    def can_damp(self) -> bool:
        """Whether the tangent is that of a displacement's potential."""
        return self.problem.minimization and self.problem.is_displacement

    def _step(self, off: float, g_q: float, damped: bool) -> float | None:
        """Change of q, and of u in du, with g + dg = 0; None if no solve succeeds.

        u changes by -(K^-1 R + dq K^-1 R_q), so dg = -g_u . K^-1 R + dq (g_q - g_u . K^-1 R_q).
        Where K is singular, which a step longer than the model shows too, the damping grows.
        """
        while True:
            self.scaled.tangent()
            if not self.scaled.is_finite():
                return None
            if damped:
                self._damp()
            self.ksp.setOperators(self.A)
            if self._solves(self.R, self.du) and self._solves(self.R_q, self.du_q):
                slope = self.g_u.dot(self.du_q) - g_q
                if slope == 0:  # neither the field nor q changes the constraint
                    return None
                dq = (off - self.g_u.dot(self.du)) / slope
                self.du.axpy(dq, self.du_q)
                if self.largest(self.du) <= self.scaled.size:
                    return float(dq)
            self.ksp.reset()  # MUMPS does not forget a failure
            if not self.can_damp:
                return None
            if damped and self.damping is not None and not self.damping.stiffen():
                return None
            damped = True

    def _damp(self) -> None:
        """Add the damping to the tangent, made at its first use."""
        if self.damping is None:
            self.damping = Damping(self.problem, self.A, self.scaled.free, Settings())
        self.damping.add(self.A)

    def move(self, factor: float, direction: PETSc.Vec, dq: float) -> float:
        """Change u by factor times a scaled direction, and q by dq; largest change of u [m]."""
        self.b.pointwiseMult(direction, self.scaled.D)
        x = self.problem.u.x.petsc_vec
        x.axpy(factor, self.b)
        x.ghostUpdate(addv=PETSc.InsertMode.INSERT, mode=PETSc.ScatterMode.FORWARD)
        self.q.value = self.load + dq
        return abs(factor) * self.largest(direction)

    def largest(self, x: PETSc.Vec) -> float:
        """Largest displacement component of a vector, on all ranks; collective."""
        own = np.abs(x.array_r[self.scaled.displacements])
        return float(max(self.problem.comm.allgather(own.max(initial=0.0))))

    def assemble(self, form: fem.Form, b: PETSc.Vec) -> None:
        """Assemble a linear form of the scaled unknown at free degrees of freedom. Collective."""
        self.problem.prepare()
        with b.localForm() as local:
            local.set(0)
        fem_petsc.assemble_vector(b, form)
        b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        b.pointwiseMult(b, self.scaled.D)
        b.array[self.problem.constrained] = 0

    def integral(self, form: fem.Form) -> float:
        """Assemble a functional at the present state. Collective."""
        self.problem.prepare()
        return float(self.problem.comm.allreduce(fem.assemble_scalar(form)))

    @contextmanager
    def kept_if_sound(self) -> Iterator[None]:
        """Free the PETSc objects if what is built upon them is refused."""
        try:
            yield
        except BaseException:
            self.destroy()
            raise

    def destroy(self) -> None:
        """Free the PETSc objects."""
        self.options.clear()
        if self.damping is not None:
            self.damping.destroy()
        vectors = (self.b, self.R, self.R_q, self.du, self.du_q, self.g_u)
        for item in (self.ksp, self.A, self.scaled, *vectors):
            item.destroy()


def scalar(q: Any, asked: str) -> fem.Constant:
    """The scalar unknown of a call.

    Raises:
        ValueError: it is no scalar Constant.
    """
    if not isinstance(q, fem.Constant) or q.ufl_shape != ():
        raise ValueError(f"{asked} needs a scalar Constant q, got {type(q).__name__}.")
    return q


def by_constant(form: ufl.Form, q: fem.Constant) -> ufl.Form:
    """Derivative of a form with respect to a scalar Constant; empty where it does not depend on it.

    Raises:
        ValueError: q stands inside the operand of an energy in singular values.
    """
    form = expand_derivatives(expanded(form))
    if any(q in extract_constants(c.jets.packed) for c in dependents(form) if isinstance(c, Jet)):
        raise ValueError(
            "q stands inside the operand of an energy in singular values, whose derivative by it "
            "is not available: let q be a load or a pressure."
        )
    variable = ufl.variable(q)
    integrals = []
    for integral in form.integrals():
        seen = ufl.replace(integral.integrand(), {q: variable})
        slope = expand_derivatives(ufl.diff(seen, variable))
        if not isinstance(slope, ufl.classes.Zero):
            integrals.append(integral.reconstruct(integrand=slope))
    return ufl.Form(integrals)
