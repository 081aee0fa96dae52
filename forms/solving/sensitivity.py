# SPDX-License-Identifier: MIT
"""Derivatives of what is measured on a solution by its parameters, by adjoints.

R(u, m) = 0 at free degrees of freedom, u = g(m) at supported ones. For J(u, m) + R(u, m)[w],

    K_ff^T lambda = (J_u + K^T w)_f,   a = w - lambda,   lambda = 0 where u is prescribed,
    dJ/dm = J_m + R_m[a] + (J_u + K^T a)_held . dg/dm,

exact in the discrete problem: one linear solve for all parameters. Where scalars q hold as many
functionals G(u, q) at values (:func:`forms.control`), the bordered system takes the place of K.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from numpy.typing import NDArray

from .. import insertion
from ..compilation import compiled
from ..measured import Displacements, Functional, Reaction, measured
from ..parameters import Slope, SupportSlopes, check_parameters, held_by, name_of
from ..paths import Path
from ..problems import Problem
from ..supports import Support
from .holding import Holding, fill
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
            at a converged state. After ``control`` every q moves with the parameters, so that
            the functionals keep their values; after the others it is a parameter like any other.
        J: Functional of the unknown and of parameters; or a :class:`forms.Reaction`; or a q that
            ``control`` has found.
        parameters: One, or a list: a Constant (load factors too), a Function of any space, or a
            support, by whose prescribed values is differentiated. They may stand in the potential,
            in the operands, parameters and texts of energies in singular values, in supports
            (Constants) and in J.
        rtol: Tolerance of the linear solve, in its residual. By default 1e-10 where the problem is
            solved by a factorization; with multigrid the adjoint's error in energy is at most
            3e-6 of its own, by an estimate, so that five to six digits of the gradient, as a whole,
            are right: more by rtol.

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
    if getattr(path, "velocity", None) is not None or problem.motion is not None:
        raise ValueError(f"{what} needs a state at rest: paths in time are not differentiated.")
    border = getattr(path, "held", None)
    listed = check_parameters(parameters, problem, what)
    given = (J, *((*border.q, *border.functionals) if border else ()), *listed)
    known = vars(problem).setdefault("_sensitivities", [])
    if isinstance(J, Displacements):
        raise ValueError(f"{what} differentiates one number, got displacements: integrate them.")
    for made in known:
        if len(made.given) == len(given) and all(
            a is b for a, b in zip(made.given, given, strict=True)
        ):
            return made
    made = Sensitivity(problem, [measured(J, problem, border, what)], listed, border)
    for m, known_of in zip(listed, made.slopes, strict=True):
        if known_of.empty:
            raise ValueError(
                f"{what} by {name_of(m)}: neither the potential, nor the supports, nor what is "
                "differentiated contain it; was it turned into a number on the way, as by float() "
                "or .value?"
            )
    made.given = given
    known.append(made)
    del known[:-REMEMBERED]
    return made


class Slopes:
    """Partial derivatives by one parameter: of residual, equation, what is measured, supports.

    Args:
        sensitivity: Whose forms they are of.
        m: Parameter.

    Attributes:
        R: Of R[a]; None for a support.
        G: Of the equations that scalars hold.
        J: Of each functional that is measured, by its place.
        supports: Of prescribed values.
    """

    def __init__(self, sensitivity: Sensitivity, m: Any) -> None:
        self.R = self.supports = None
        self.G: list[Slope] = []
        self.J: dict[int, Slope] = {}
        self._is_support = isinstance(m, Support)
        if self._is_support:
            return
        self.R = Slope(sensitivity.R, m)
        functionals = [j if isinstance(j, Functional) else None for j in sensitivity.measured]
        self.J = {n: Slope(j.form, m) for n, j in enumerate(functionals) if j is not None}
        if sensitivity.border is not None:
            self.G = [Slope(form, m) for form in sensitivity.border.forms]
        self.supports = SupportSlopes(sensitivity.problem, m)

    @property
    def moves_supports(self) -> bool:
        """Whether prescribed values have a part in the derivative."""
        return self._is_support or not (self.supports is None or self.supports.empty)

    @property
    def empty(self) -> bool:
        """Whether nothing depends on the parameter."""
        listed = [self.R, *self.G, *self.J.values()]
        return not self.moves_supports and all(s is None or s.empty for s in listed)

    def weighted(self, c: list[Array], nu: Array) -> list[tuple[float, Slope]]:
        """Summands of the derivative at fixed prescribed values, and their factors."""
        held = [(-float(each), s) for each, s in zip(nu, self.G, strict=False)]
        found = [(1.0, self.R), *held, *((c[n][0], s) for n, s in self.J.items())]
        return [(factor, s) for factor, s in found if s is not None and not s.empty]


class Sensitivity:
    """Derivatives of c . (what is measured) by parameters, compiled; at the present state.

    Args:
        problem: What is solved.
        measured: Objects of :mod:`forms.measured`.
        parameters: Checked parameters.
        border: What is held, if anything.

    Attributes:
        R: Residual at the function of adjoints.
        slopes: Partial derivatives by each parameter.
    """

    def __init__(
        self, problem: Problem, measured: list[Any], parameters: list[Any], border: Any
    ) -> None:
        check_memory(problem)
        self.problem, self.parameters, self.measured = problem, parameters, measured
        self.given: tuple[Any, ...] = ()
        self._a = fem.Function(problem.u.function_space, name="adjoint")
        self.R = ufl.action(problem.forms.residual_ufl, self._a)
        K = problem.forms.tangent_ufl
        self._Ka: Any = ufl.action(K if problem.symmetric else ufl.adjoint(K), self._a)
        self.border = None if border is None else Holding(problem, border, self.R, measured)
        found = () if self.border is None else self.border.q
        if any(m is q for m in parameters for q in found):
            raise ValueError("the scalar that control has found is no parameter: leave it out.")
        self.slopes = [Slopes(self, m) for m in parameters]
        self._b, self._linear = problem.create_vector(), problem.create_vector()

    def gradient(self, rtol: float | None = None) -> list[Any]:
        """Derivative of one number by each parameter at the present state. Collective."""
        with Linearized(self.problem, rtol, near=True) as linear:
            linear.check_equilibrium("gradient")
            return self.adjoint(linear, [np.ones(1)])

    def adjoint(self, linear: Linearized, c: list[Array]) -> list[Any]:
        """Derivative of sum_n c_n . values_n, by one solve and one for each q. Collective.

        Args:
            linear: The tangent at the present state.
            c: Factors of the values of each that is measured.
        """
        problem, b = self.problem, self._b
        problem.prepare()
        explicit = sum(j.by_state(problem, f) for j, f in zip(self.measured, c, strict=True))
        weighed = self._weigh(c)
        w = self._a.x.array.copy()
        by_w = self._transposed(w) if weighed else np.zeros_like(explicit)
        fill(b, explicit + by_w)
        y = b.duplicate()
        energy = None if self.border is not None else self._energy(explicit, by_w, w)
        linear.solve(b, y, transposed=True, energy=energy)
        lam: Array = np.array(y.array_r)
        nu: Array = np.zeros(0)
        if self.border is not None:
            lam, nu = self.border.eliminated(linear, lam, w, c, (b, y), self._set)
        y.destroy()
        adjoint = w.copy()
        adjoint[: len(lam)] -= lam
        self._set(adjoint)
        held = np.zeros(len(lam))
        if any(s.moves_supports for s in self.slopes):
            found = explicit + self._transposed()
            for each, by_state in zip(nu, self.border.by_state if self.border else [], strict=True):
                found -= each * by_state
            held[:] = problem.held_part(found)
        pairs = zip(self.parameters, self.slopes, strict=True)
        return [self._by(m, slopes, held, c, nu) for m, slopes in pairs]

    def _energy(self, explicit: Array, by_w: Array, w: Array) -> Callable[..., float]:
        """Energy a . K a of a = w - lambda, as a function of lambda and its residual r; K = K^T.

        w . K w - 2 lambda . K w + lambda . K lambda,  K w = b - J_u,  K lambda = b - r
        """
        linear = self._linear
        fill(linear, explicit - by_w)
        own = self.problem.comm.allreduce(float(w[: len(by_w)] @ by_w))
        return lambda lam, r: own + lam.dot(linear) - lam.dot(r)

    def _set(self, values: Array) -> None:
        """Put owned values into the function of adjoints, ghosts brought up to date."""
        self._a.x.array[: len(values)] = values
        self._a.x.scatter_forward()

    def _weigh(self, c: list[Array]) -> bool:
        """Put the residual's weights w into the function of adjoints; whether there are any."""
        found = [
            f[0] * w
            for j, f in zip(self.measured, c, strict=True)
            if (w := j.weights(self.problem)) is not None
        ]
        self._set(sum(found) if found else np.zeros_like(self._a.x.array))
        return bool(found)

    def _transposed(self, w: Array | None = None) -> Array:
        """K^T a, the tangent without boundary conditions; owned. Collective.

        Args:
            w: Values of a with ghosts, of weights: where these are 0 but at supports, as those of
                reactions are, the cells there are enough.
        """
        problem, b = self.problem, self._b
        if len(problem.terms) > 1:
            return by_matrix(problem, self._a, b, transposed=True)
        with b.localForm() as local:
            local.set(0)
        if w is not None and self._is_at_supports(w):
            x = problem.create_vector()
            with x.localForm() as local:
                for condition in problem.conditions:
                    condition.set(local.array)
                local.array[:] -= w
            problem.forms.lift(b, x)
            x.destroy()
        else:
            if not isinstance(self._Ka, fem.Form):
                self._Ka = compiled(self._Ka)
            fem_petsc.assemble_vector(b, self._Ka)
        b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        return np.array(b.array_r)

    def _is_at_supports(self, w: Array) -> bool:
        """Whether K^T w is K w by the cells at supports alone. Collective."""
        free = w[: self._b.getLocalSize()].copy()
        free[self.problem.constrained] = 0
        found = self.problem.comm.allreduce(bool(free.any()), MPI.LOR)
        return self.problem.symmetric and self.problem.slants is None and not found

    def _by(self, m: Any, slopes: Slopes, held: Array, c: list[Array], nu: Array) -> Any:
        if isinstance(m, Support):
            found = fem.Function(self.problem.u.function_space, name="gradient")
            rows, by = held_by(self.problem, m), held.copy()
            if self.problem.slants is not None:
                self.problem.slants.pull(by)
            found.x.array[rows] = by[rows]
            found.x.scatter_forward()
            return found
        weighted = slopes.weighted(c, nu)
        if isinstance(m, fem.Function):
            found = fem.Function(m.function_space, name="gradient")
            for factor, slope in weighted:
                slope.add_numbers(found, factor)
            return found
        total = sum((factor * slope.numbers() for factor, slope in weighted), np.zeros(m.ufl_shape))
        if slopes.supports is not None and slopes.moves_supports:
            total = np.array(total)
            for k in slopes.supports.entries(self._b):
                total[k] += self.problem.comm.allreduce(float(held @ self._b.array_r))
        return float(total) if m.ufl_shape == () else total


def check_memory(problem: Problem) -> None:
    """Refuse terms whose state depends on earlier ones.

    Raises:
        ValueError: there is one.
    """
    for term in problem.terms:
        if term.history():
            raise ValueError(
                "derivatives need a state that only the present loads decide, got a term that "
                f"keeps a history, {type(term).__name__}: paths in time are not differentiated."
            )


def by_matrix(problem: Problem, a: fem.Function, b: PETSc.Vec, transposed: bool) -> Array:
    """K a or K^T a without boundary conditions, by a matrix that terms add to. Collective."""
    A = insertion.create_matrix(problem.forms.tangent_form)
    insertion.assemble(A, problem.forms.tangent_form, [])
    for term in problem.terms[1:]:
        term.tangent(A)
    A.assemble()
    x = A.createVecRight()
    x.array[:] = a.x.array[: len(x.array_r)]
    (A.multTranspose if transposed else A.mult)(x, b)
    found = np.array(b.array_r)
    for item in (A, x):
        item.destroy()
    return found
