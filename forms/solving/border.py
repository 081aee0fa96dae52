# SPDX-License-Identifier: MIT
"""Bordered systems: scalar unknowns beside the field, as many scalar equations beside equilibrium.

R(u, q) = 0,  g(u, q) = 0;  [[K, R_q], [g_u, g_q]] [du, dq] = -[R, g]

A pressure q that holds a volume, a load factor that holds a displacement or a distance along the
path. One solve with the factors of K and one for each q, inside SNES's KSP, solve the bordered
system, which is regular at a limit point too.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

from petsc4py import PETSc

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from numpy.typing import NDArray
from ufl.algorithms import expand_derivatives

from ..compilation import compiled
from ..differentiation import rate
from ..problems import Problem
from .alike import counted, dependent, refuse_alike
from .tangents import Tangent

Values = NDArray[np.float64]


class Constraint(Protocol):
    """One scalar equation: its error, scale, and derivatives."""

    @property
    def scale(self) -> float:
        """What the errors are compared with."""

    def value(self) -> float:
        """The constraint g, 0 where it holds."""

    def gradient(self, g_u: PETSc.Vec) -> Values:
        """Assemble g_u, of the scaled unknown, into a vector; return g_q, by each of the q."""


class Border:
    """Scalar unknowns q, their equations, and the solver of the bordered system.

    A vector of the whole system is the field's, with the q behind it on the last rank.

    Args:
        problem: Its potential contains all q.
        q: Scalar unknowns.
        tangent: The problem's, in whose unit the field is.

    Attributes:
        constraints: The equations, one for each q; set by who leads the path.
        singular: Whether the last system could not be solved.

    Raises:
        ValueError: a q is not in the potential.
    """

    def __init__(self, problem: Problem, q: Sequence[fem.Constant], tangent: Tangent) -> None:
        self.problem, self.q, self.tangent = problem, tuple(q), tangent
        slopes = [by_constant(problem.forms.residual_ufl, c) for c in self.q]
        for n, slope in enumerate(slopes, start=1):
            if slope.empty():
                which = "q" if len(slopes) == 1 else f"q number {n}"
                raise ValueError(f"the potential does not contain {which}: write a load with it.")
        self._R_q = [compiled(slope) for slope in slopes]
        self.constraints: list[Constraint] = []
        self.singular = False
        self._alike: list[int] = []
        self._b = problem.create_vector()
        self.R_q, self.y_q, self._g_u = ([self._b.duplicate() for _ in q] for _ in range(3))
        self._y = self._b.duplicate()
        self._G = np.zeros((len(self.q),) * 2)
        self._weights: Values = np.ones(len(self.q))
        self._ready = self._damped = False
        self._ksp: PETSc.KSP | None = None
        comm = problem.comm
        self._last = comm.rank == comm.size - 1
        self._own = self._b.getLocalSize()

    def values(self) -> Values:
        """The scalar unknowns."""
        return np.array([float(c.value) for c in self.q])

    def put(self, values: Values) -> None:
        """Set the scalar unknowns."""
        for c, value in zip(self.q, values, strict=True):
            c.value = value

    def create_vector(self) -> PETSc.Vec:
        """PETSc vector of the whole system."""
        local = self._own + len(self.q) * self._last
        return PETSc.Vec().createMPI((local, PETSc.DECIDE), comm=self.problem.comm)

    def join(self, y: PETSc.Vec, values: Values, z: PETSc.Vec) -> None:
        """Put a field's vector and scalars into one of the whole system; local."""
        z.array[: self._own] = y.array_r
        if self._last:
            z.array[self._own :] = values

    def part(self, z: PETSc.Vec, y: PETSc.Vec) -> Values:
        """Put the field's part of a vector into y, return its scalars. Collective."""
        y.array[:] = z.array_r[: self._own]
        behind = z.array_r[self._own :].copy() if self._last else None
        return self.problem.comm.bcast(behind, root=self.problem.comm.size - 1)

    def residual(self, f: PETSc.Vec) -> float:
        """Norm of the field's part of a vector. Collective."""
        own = f.array_r[: self._own]
        return float(np.sqrt(self.problem.comm.allreduce(float(own @ own))))

    def errors(self, force: float) -> Values:
        """The equations' errors over their scales, times a force [N]. Collective."""
        self._errors = np.array([c.value() for c in self.constraints])
        self._scales = np.array([c.scale for c in self.constraints])
        return self._errors * self._weigh(force)

    def _weigh(self, force: float) -> Values:
        scales = np.array([c.scale for c in self.constraints])
        return force / np.where(scales > 0, scales, 1.0)

    def off(self) -> float:
        """Largest error of an equation over its scale, at the state of :meth:`errors`."""
        errors = np.abs(self._errors)
        with np.errstate(divide="ignore", invalid="ignore"):
            return float(np.where(errors > 0, errors / self._scales, 0.0).max())

    def load_level(self) -> float:
        """Norm of the loads q R_q [N], which the residual is the imbalance of. Collective."""
        norms = [R.norm() for R in self.R_q]
        return float(np.abs(self.values()) @ norms)

    def update(self, force: float, damped: bool) -> None:
        """Take the derivatives at the present state, whose tangent is assembled. Collective.

        Args:
            force: Weight of the equations [N].
            damped: Whether a singular tangent may be damped.
        """
        self._weights = self._weigh(force)
        for form, R in zip(self._R_q, self.R_q, strict=True):
            self.assemble(form, R)
        for n, (constraint, g_u) in enumerate(zip(self.constraints, self._g_u, strict=True)):
            self._G[n] = constraint.gradient(g_u)
        self._ready, self._damped, self.singular = False, damped and self.can_damp, False

    @property
    def can_damp(self) -> bool:
        """Whether the tangent is that of a displacement's potential."""
        return self.problem.minimization and self.problem.is_displacement

    def solver(self, tangent: Tangent) -> PETSc.KSP:
        """The KSP of the bordered system, around that of the tangent."""
        self.release()
        comm = self.problem.comm
        size = self.create_vector()
        elimination = _Elimination(self)
        A = PETSc.Mat().createPython((size.getSizes(), size.getSizes()), elimination, comm=comm)
        A.setUp()
        size.destroy()
        self._ksp = PETSc.KSP().create(comm)
        self._ksp.setType("preonly")
        self._ksp.setOperators(A)
        pc = self._ksp.getPC()
        pc.setType("python")
        pc.setPythonContext(elimination)
        A.destroy()
        return self._ksp

    def solve(self, f: PETSc.Vec, z: PETSc.Vec) -> None:
        """Solve the bordered system by elimination. Collective."""
        g = self.part(f, self._b)
        dq = self._eliminated(g)
        if dq is None:
            self.singular = True
            z.set(0)
            return
        for y, change in zip(self.y_q, dq, strict=True):
            self._y.axpy(-change, y)
        self.join(self._y, dq, z)

    def _eliminated(self, g: Values) -> Values | None:
        """K^-1 R in _y, and the change of q; None if no solve succeeds. Collective."""
        tangent, size = self.tangent, self.tangent.scaled.size
        while not tangent.spoiled:
            solved = tangent.solve(self._b, self._y) and self._solved_loads()
            if solved:
                schur = self._schur()
                off = g - self._weights * np.array([u.dot(self._y) for u in self._g_u])
                self._alike = dependent(schur)
                if self._alike:
                    return None  # neither the field nor q changes the constraint
                dq = np.linalg.solve(schur, off)
                moved = self._y.array_r - sum(
                    c * y.array_r for c, y in zip(dq, self.y_q, strict=True)
                )
                longest = np.abs(moved[tangent.scaled.displacements]).max(initial=0.0)
                longest = max(self.problem.comm.allgather(float(longest)))
                if np.isfinite(longest) and (longest <= size or not self._damped):
                    return dq
            if not (self._damped and self._stiffened()):
                return None
        return None

    def _schur(self) -> Values:
        """G - g_u K^-1 R_q, weighed: how the equations go with each q. Collective."""
        slopes = [[u.dot(y) for y in self.y_q] for u in self._g_u]
        return (self._G - np.array(slopes)) * self._weights[:, None]

    def negative(self) -> int | None:
        """Eigenvalues of the Schur complement with a negative real part; None where unknown.

        K is factorized at the present state. Collective.
        """
        self.update(1.0, damped=False)
        schur = self._schur() if self._solved_loads() else np.full_like(self._G, np.nan)
        if not np.all(np.isfinite(schur)):
            return None
        return int((np.linalg.eigvals(schur).real < 0).sum())

    def check(self) -> None:
        """Refuse equations and q that say the same at the present state. Collective.

        Raises:
            ValueError: they do.
        """
        self.update(1.0, damped=False)
        explicit = self._G != 0
        refuse_alike(self._g_u, ~explicit.any(axis=1), "functional", "change with u")
        refuse_alike(self.R_q, ~explicit.any(axis=0), "q", "load the body")

    def words(self) -> str:
        """That the last system was singular, and by which of several equations."""
        which = ""
        if len(self.q) > 1 and self._alike:
            which = f", no q changes functional {counted(self._alike)}"
            which += " without the others" * (len(self._alike) > 1)
        return f"the bordered system is singular{which}"

    def _stiffened(self) -> bool:
        """Damp the tangent, or damp it more; False where that is no use. Collective."""
        tangent = self.tangent
        tangent.ksp.reset()  # MUMPS does not forget a failure
        if tangent.damping is None:
            tangent.damp()
        elif not tangent.damping.stiffen():
            return False
        tangent.assemble()
        tangent.ksp.setOperators(tangent.product, tangent.A)
        self._ready = False
        return True

    def _solved_loads(self) -> bool:
        if not self._ready:
            pairs = zip(self.R_q, self.y_q, strict=True)
            self._ready = all([self.tangent.solve(R, y) for R, y in pairs])
        return self._ready

    def direction(self) -> Values | None:
        """Solve K y_q = R_q with the tangent just taken; None where that fails. Collective."""
        self._ready = False
        while not self.tangent.spoiled:
            if self._solved_loads() and np.isfinite(sum(y.norm() for y in self.y_q)):
                return self.values()
            if not (self._damped and self._stiffened()):
                break
        return None

    def assemble(self, form: fem.Form, b: PETSc.Vec) -> None:
        """Assemble a linear form of the scaled unknown at free degrees of freedom. Collective."""
        self.problem.prepare()
        with b.localForm() as local:
            local.set(0)
        fem_petsc.assemble_vector(b, form)
        b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        b.pointwiseMult(b, self.tangent.scaled.D)
        self.problem.clear(b.array)

    def integral(self, form: fem.Form) -> float:
        """Assemble a functional at the present state. Collective."""
        self.problem.prepare()
        return float(self.problem.comm.allreduce(fem.assemble_scalar(form)))

    def release(self) -> None:
        """Free the solver."""
        if self._ksp is not None:
            self._ksp.destroy()
            self._ksp = None

    def destroy(self) -> None:
        """Free the PETSc objects."""
        self.release()
        for item in (self._b, self._y, *self.R_q, *self.y_q, *self._g_u):
            item.destroy()


class _Elimination:
    """What PETSc calls for the bordered system, as a preconditioner."""

    def __init__(self, border: Border) -> None:
        self._border = border

    def apply(self, pc: PETSc.PC, f: PETSc.Vec, z: PETSc.Vec) -> None:
        self._border.solve(f, z)


def scalar(q: Any, asked: str) -> fem.Constant:
    """The scalar unknown of a call.

    Raises:
        ValueError: it is no scalar Constant.
    """
    if not isinstance(q, fem.Constant) or q.ufl_shape != ():
        raise ValueError(f"{asked} needs a scalar Constant q, got {type(q).__name__}.")
    return q


def by_constant(form: ufl.Form, q: fem.Constant) -> ufl.Form:
    """Derivative of a form with respect to a scalar Constant; empty where it has no part in it."""
    return expand_derivatives(rate(form, q, ufl.as_ufl(1)))
