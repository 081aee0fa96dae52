# SPDX-License-Identifier: MIT
"""Derivatives of what is measured on a solution by its parameters, by adjoints.

R(u, m) = 0 at free degrees of freedom, u = g(m) at supported ones. For J(u, m) + R(u, m)[w],

    K_ff^T lambda = (J_u + K^T w)_f,   a = w - lambda,   lambda = 0 where u is prescribed,
    dJ/dm = J_m + R_m[a] + (J_u + K^T a)_held . dg/dm,

exact in the discrete problem: one linear solve for all parameters. Where a scalar q holds a
functional G(u, q) at a value (:func:`forms.control`), the bordered system takes the place of K.
"""

from __future__ import annotations

from typing import Any

from petsc4py import PETSc

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from numpy.typing import NDArray

from .. import insertion
from ..compilation import compiled
from ..measured import Functional, Reaction
from ..parameters import (
    Slope,
    SupportSlopes,
    check_parameters,
    held_by,
    is_field,
    name_of,
)
from ..paths import Path
from ..problems import Problem
from .linearized import Linearized

Array = NDArray[np.float64]
REMEMBERED = 4  # compiled derivatives that a problem keeps


def gradient(
    path: Path | Problem,
    J: ufl.Form | Reaction | fem.Constant,
    parameters: Any,
    *,
    rtol: float | None = None,
) -> Any:
    """Derivative of a functional of the solution by parameters, the solution following them.

    dJ/dm = J_m + J_u . du/dm,  R(u(m), m) = 0, by one adjoint solve for all parameters. The state
    is that at the path's end; what led there has no part in it, as no material here remembers.

    Args:
        path: What ``solve``, ``follow``, ``arc_length`` or ``control`` returned, or its problem,
            at a converged state. After ``control`` the scalar q moves with the parameters, so that
            the functional keeps its value; after the others it is a parameter like any other.
        J: Functional of the unknown and of parameters; or a :class:`forms.Reaction`; or the q that
            ``control`` has found.
        parameters: One, or a list: a Constant (load factors too), a Function of any space, or a
            support, by whose prescribed values is differentiated. They may stand in the potential,
            in the operands, parameters and texts of energies in singular values, in supports
            (Constants) and in J.
        rtol: Tolerance of the linear solve, in its residual; by default 1e-10 where the problem is
            solved by a factorization, 1e-6 by multigrid, as exact as the gradient is then.

    Returns:
        For each parameter: of a scalar Constant a number, of another an array of its shape; of a
        Function one of its space, whose entries are the derivatives by its own (divide by a mass
        for a density); of a support a Function of the unknown's space, 0 elsewhere. Alike on all
        ranks. Collective; compiled at the first call, and kept with the problem.

    Raises:
        ValueError: J or a parameter of another kind, a parameter that nothing contains, a state out
            of equilibrium, a term with a history.
        NotConverged: the tangent is singular, as at a limit point.
    """
    single = not isinstance(parameters, list | tuple)
    found = sensitivity(path, J, parameters, "gradient").gradient(rtol)
    return found[0] if single else found


def sensitivity(path: Any, J: Any, parameters: Any, what: str) -> Sensitivity:
    """The compiled derivatives of a call, new or those of an earlier one. Collective."""
    problem = getattr(path, "problem", path)
    if not isinstance(problem, Problem):
        raise ValueError(
            f"{what} needs a path or a problem at its solution, got {type(problem).__name__}: pass "
            "what forms.solve or forms.follow returned."
        )
    border = getattr(path, "held", None)
    listed = check_parameters(parameters, problem, what)
    given = (J, *(border or ()), *listed)
    known = vars(problem).setdefault("_sensitivities", [])
    for made in known:
        if len(made.given) == len(given) and all(
            a is b for a, b in zip(made.given, given, strict=True)
        ):
            return made
    made = Sensitivity(problem, J, listed, border, what)
    made.given = given
    known.append(made)
    del known[:-REMEMBERED]
    return made


class Sensitivity:
    """Derivatives of one J by parameters, compiled; evaluated at the problem's present state.

    Args:
        problem: What is solved.
        J: Functional, Reaction, or the q of ``border``.
        parameters: Checked parameters.
        border: Scalar q and functional that it holds, if any.
        what: Who asks, for messages.
    """

    def __init__(
        self, problem: Problem, J: Any, parameters: list[Any], border: Any, what: str
    ) -> None:
        self.problem, self.parameters, self.given = problem, parameters, ()
        for term in problem.terms:
            if term.history():
                raise ValueError(
                    f"{what} needs a state that only the present loads decide, got a term that "
                    f"keeps a history, {type(term).__name__}: paths in time are not differentiated."
                )
        self._q, self._reaction, self._J = None, None, None
        if isinstance(J, Reaction):
            self._reaction = J
        elif isinstance(J, ufl.Form):
            self._J = Functional(J, problem)
        elif not (border is not None and J is border[0]):
            raise ValueError(
                f"{what} differentiates a functional (a UFL form), a forms.Reaction, or the scalar "
                f"that control has found, got {type(J).__name__}."
            )
        self._is_q = self._J is None and self._reaction is None
        self._a = fem.Function(problem.u.function_space, name="adjoint")
        R = ufl.action(problem.forms.residual_ufl, self._a)
        K = problem.forms.tangent_ufl
        K = K if problem.symmetric else ufl.adjoint(K)
        self._Ka: Any = ufl.action(K, self._a)
        self._border = None if border is None else _Held(problem, border, R, self._J)
        self._slopes = [self._slopes_of(m, R) for m in parameters]
        for m, (slopes, supports) in zip(parameters, self._slopes, strict=True):
            if self._border is not None and m is self._border.q:
                raise ValueError(
                    f"{what} by the scalar that control has found: it is no parameter."
                )
            if supports is not None and supports.empty and all(s.empty for s in slopes.values()):
                raise ValueError(
                    f"{what} by {name_of(m)}: neither the potential, nor the supports, nor what "
                    "is differentiated contain it; was it turned into a number on the way, as by "
                    "float() or .value?"
                )
        self._b = problem.create_vector()

    def _slopes_of(self, m: Any, R: ufl.Form) -> tuple[dict[str, Slope], SupportSlopes | None]:
        if not isinstance(m, fem.Constant | fem.Function):
            return {}, None
        slopes = {"R": Slope(R, m)}
        if self._J is not None:
            slopes["J"] = Slope(self._J.form, m)
        if self._border is not None:
            slopes["G"] = Slope(self._border.form, m)
        return slopes, SupportSlopes(self.problem, m)

    def value(self) -> float:
        """J at the present state. Collective."""
        if self._reaction is not None:
            return self._reaction(self.problem)
        if self._J is not None:
            return self._J(self.problem)
        assert self._border is not None
        return float(self._border.q.value)

    def gradient(self, rtol: float | None = None) -> list[Any]:
        """Derivative by each parameter at the present state. Collective."""
        with Linearized(self.problem, rtol) as linear:
            linear.check_equilibrium("gradient")
            return self.adjoint(linear)

    def adjoint(self, linear: Linearized) -> list[Any]:
        """Derivative by each parameter, by one solve (two in a bordered system). Collective."""
        problem, b = self.problem, self._b
        problem.prepare()
        explicit = self._explicit()
        w = self._weighted()
        _fill(b, explicit + self._transposed() if self._reaction else explicit)
        y = b.duplicate()
        linear.solve(b, y, transposed=True)
        lam, nu = np.array(y.array_r), 0.0
        if self._border is not None:
            lam, nu = self._border.eliminated(linear, lam, b, y, self._is_q, w, self._set)
        y.destroy()
        owned = len(lam)
        adjoint = w.copy()
        adjoint[:owned] -= lam
        self._set(adjoint)
        held = self._held(explicit, nu)
        return [
            self._by(m, slopes, supports, held, nu)
            for m, (slopes, supports) in zip(self.parameters, self._slopes, strict=True)
        ]

    def _set(self, values: Array) -> None:
        """Put owned values into the function of adjoints, ghosts brought up to date."""
        self._a.x.array[: len(values)] = values
        self._a.x.scatter_forward()

    def _explicit(self) -> Array:
        """J_u at fixed weights of the residual, and what moves them; owned. Collective."""
        problem, b = self.problem, self._b
        if self._reaction is not None:
            problem.residual(b)
            return self._reaction.lever(problem, np.array(b.array_r))
        with b.localForm() as local:
            local.set(0)
        if self._J is not None:
            self._J.add_by_state(b)
        b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        return np.array(b.array_r)

    def _weighted(self) -> Array:
        """Weights w of the residual, which are put into the function of adjoints. Collective."""
        w = np.zeros_like(self._a.x.array)
        if self._reaction is not None:
            w = self._reaction.weights(self.problem)
        self._set(w)
        return self._a.x.array.copy()

    def _transposed(self) -> Array:
        """K^T a, the tangent without boundary conditions; owned. Collective."""
        b = self._b
        if len(self.problem.terms) > 1:
            return _by_matrix(self.problem, self._a, b)
        if not isinstance(self._Ka, fem.Form):
            self._Ka = compiled(self._Ka)
        with b.localForm() as local:
            local.set(0)
        fem_petsc.assemble_vector(b, self._Ka)
        b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        return np.array(b.array_r)

    def _held(self, explicit: Array, nu: float) -> Array:
        """Derivative by the prescribed values, 0 at free degrees of freedom; owned. Collective."""
        moving = [s for _, s in self._slopes if s is not None and not s.empty]
        if not moving and not any(s is None for _, s in self._slopes):
            return np.zeros(0)
        found = explicit + self._transposed()
        if self._border is not None:
            found -= nu * self._border.by_state
        held = np.zeros(len(found))
        rows = self.problem.constrained
        held[rows] = found[rows]
        return held

    def _by(self, m: Any, slopes: dict, supports: Any, held: Array, nu: float) -> Any:
        weights = {"R": 1.0, "J": 1.0, "G": -nu}
        if supports is None:
            found = fem.Function(self.problem.u.function_space, name="gradient")
            rows = held_by(self.problem, m)
            found.x.array[rows] = held[rows]
            found.x.scatter_forward()
            return found
        if is_field(m):
            found = fem.Function(m.function_space, name="gradient")
            for name, slope in slopes.items():
                if slope.empty:
                    continue
                part = fem.Function(m.function_space)
                slope.add_numbers(part)
                found.x.array[:] += weights[name] * part.x.array
            return found
        total = sum(weights[name] * slope.numbers() for name, slope in slopes.items())
        if not supports.empty:
            total = np.array(total)
            for k in supports.entries(self._b):
                own = float(held @ self._b.array_r)
                total[k] += self.problem.comm.allreduce(own)
        return float(total) if m.ufl_shape == () else np.array(total)


class _Held:
    """The equation G(u, q) = value of control, in the adjoint system.

    y = K^-T (J_u + K^T w), z = K^-T G_u, lambda = y - nu z, nu = (J_q + R_q[w] - R_q . y) /
    (G_q - R_q . z).
    """

    def __init__(
        self, problem: Problem, border: tuple[fem.Constant, ufl.Form], R: ufl.Form, J: Any
    ) -> None:
        self.problem, self.q = problem, (q := border[0])
        self.functional = Functional(border[1], problem)
        self.form = self.functional.form
        self._R_q = Slope(R, q)
        self._G_q = Slope(self.form, q)
        self._J_q = None if J is None else Slope(J.form, q)
        self.by_state: Array = np.zeros(0)

    def eliminated(
        self, linear: Linearized, y: Array, b: Any, room: Any, is_q: bool, w: Array, put: Any
    ) -> tuple[Array, float]:
        """Owned lambda, and nu. Collective."""
        with b.localForm() as local:
            local.set(0)
        self.functional.add_by_state(b)
        b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        self.by_state = np.array(b.array_r)
        linear.solve(b, room, transposed=True)
        z = np.array(room.array_r)
        J_q = float(is_q) if self._J_q is None else float(self._J_q.numbers())
        put(w)
        J_q += float(self._R_q.numbers())
        put(y)
        load = float(self._R_q.numbers())
        put(z)
        nu = (J_q - load) / (float(self._G_q.numbers()) - float(self._R_q.numbers()))
        return y - nu * z, nu


def _fill(b: PETSc.Vec, values: Array) -> None:
    with b.localForm() as local:
        local.set(0)
    b.array[:] = values


def _by_matrix(problem: Problem, a: fem.Function, b: PETSc.Vec) -> Array:
    """K^T a by a matrix without boundary conditions, where terms add to the tangent. Collective."""
    A = insertion.create_matrix(problem.forms.tangent_form)
    insertion.assemble(A, problem.forms.tangent_form, [])
    for term in problem.terms[1:]:
        term.tangent(A)
    A.assemble()
    x = A.createVecRight()
    x.array[:] = a.x.array[: len(x.array_r)]
    A.multTranspose(x, b)
    found = np.array(b.array_r)
    for item in (A, x):
        item.destroy()
    return found
