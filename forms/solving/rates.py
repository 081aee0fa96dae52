# SPDX-License-Identifier: MIT
"""How a solution moves with Constants: forward sensitivities, one linear solve for each number.

K_ff du_f = -(R_m)_f - K_fh dg,  du_h = dg;  R_m + K du is then the change of the reactions.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from petsc4py import PETSc

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from numpy.typing import NDArray

from ..compilation import compiled
from ..measured import Displacements, Functional, Reaction, Scalar
from ..parameters import Slope, SupportSlopes
from ..paths import Held
from ..problems import Problem
from .linearized import Linearized
from .sensitivity import by_matrix, check_memory

Array = NDArray[np.float64]


class Rate(NamedTuple):
    """Change of a solution by one number.

    Attributes:
        du: Of the unknown, ghosts included.
        dR: Of the residual without boundary conditions, owned: of the reactions.
        dq: Of the scalars that hold functionals.
    """

    du: Array
    dR: Array
    dq: Array


class _Bordered(NamedTuple):
    """R_q, z = K^-1 R_q by each q; G_u of each functional; G_q - G_u . z of each by each."""

    R_q: list[Array]
    z: list[Array]
    G_u: list[Array]
    schur: Array


class Rates:
    """Changes of a solution, and of what is measured on it, by Constants; compiled.

    Args:
        problem: What is solved.
        measured: Objects of :mod:`forms.measured`.
        parameters: Constants.
        border: What is held, if anything.
    """

    def __init__(
        self, problem: Problem, measured: list[Any], parameters: list[fem.Constant], border: Any
    ) -> None:
        check_memory(problem)
        self.problem, self.measured, self.parameters = problem, measured, parameters
        self._du = fem.Function(problem.u.function_space, name="rate")
        self._Ku: Any = ufl.action(problem.forms.tangent_ufl, self._du)
        R = problem.forms.residual_ufl
        self._R = [Slope(R, m) for m in parameters]
        self._supports = [SupportSlopes(problem, m) for m in parameters]
        self._J = [
            [Slope(j.form, m) if isinstance(j, Functional) else None for j in measured]
            for m in parameters
        ]
        self._b, self._x = problem.create_vector(), problem.create_vector()
        held: Held = border or Held((), ())
        self._q, self._G = held.q, [Functional(form, problem) for form in held.functionals]
        self._R_q = [Slope(R, q) for q in self._q]
        self._G_q = [[Slope(G.form, q) for q in self._q] for G in self._G]
        self._G_m = [[Slope(G.form, m) for G in self._G] for m in parameters]
        self._J_q = [
            [Slope(j.form, q) for q in self._q] if isinstance(j, Functional) else []
            for j in measured
        ]

    @property
    def empty(self) -> list[bool]:
        """Whether nothing depends on a parameter, of each."""
        return [
            R.empty and s.empty and all(j is None or j.empty for j in J)
            for R, s, J in zip(self._R, self._supports, self._J, strict=True)
        ]

    def __call__(self, linear: Linearized) -> tuple[list[Rate], list[Array]]:
        """Rates, and of each that is measured its Jacobian, (values, numbers). Collective."""
        problem = self.problem
        problem.prepare()
        border = self._bordered(linear)
        states = [
            None if isinstance(j, Displacements) else j.by_state(problem, np.ones(1))
            for j in self.measured
        ]
        weights = [j.weights(problem) for j in self.measured]
        rates: list[Rate] = []
        columns: list[list[Array]] = [[] for _ in self.measured]
        for p, m in enumerate(self.parameters):
            slopes = [None if s is None else s.numbers() for s in self._J[p]]
            G_m = [slope.numbers() for slope in self._G_m[p]]
            loads, moves = self._loads(p), self._moves(p)
            for n, k in enumerate(np.ndindex(m.ufl_shape)):
                rate = self._rate(linear, loads[n], moves[n], border, G_m, k)
                rates.append(rate)
                for i, j in enumerate(self.measured):
                    explicit = 0.0 if (slope := slopes[i]) is None else float(slope[k])
                    columns[i].append(self._change(i, j, rate, states[i], weights[i], explicit))
        return rates, [np.array(each).T for each in columns]

    def _loads(self, p: int) -> list[Array]:
        """R_m for each number of a parameter; owned. Collective."""
        return [self._assembled(self._R[p]) for _ in self._R[p].entries()]

    def _moves(self, p: int) -> list[Array | None]:
        """Change of prescribed values by each number of a parameter; None where there is none."""
        if self._supports[p].empty:
            return [None] * int(np.prod(self.parameters[p].ufl_shape, dtype=int))
        return [np.array(self._b.array_r) for _ in self._supports[p].entries(self._b)]

    def _assembled(self, slope: Slope) -> Array:
        with self._b.localForm() as local:
            local.set(0)
        slope.add_vector(self._b)
        self._b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        return np.array(self._b.array_r)

    def _bordered(self, linear: Linearized) -> _Bordered:
        """Parts of the bordered system at the present state. Collective."""
        R_q = [self._assembled(slope) for slope in self._R_q]
        z = [self._solved(linear, each) for each in R_q]
        G_u = [G.by_state(self.problem, np.ones(1)) for G in self._G]
        schur = [
            [float(s.numbers()) - self._dot(g, y) for s, y in zip(slopes, z, strict=True)]
            for g, slopes in zip(G_u, self._G_q, strict=True)
        ]
        return _Bordered(R_q, z, G_u, np.array(schur))

    def _rate(
        self,
        linear: Linearized,
        load: Array,
        moved: Array | None,
        border: _Bordered,
        G_m: list[Array],
        k: Any,
    ) -> Rate:
        right: Array = load
        du: Array = np.zeros(len(load))
        dq: Array = np.zeros(len(G_m))
        if moved is not None:
            self._put(moved)
            right, du = load + self._product(), moved
        du = du - self._solved(linear, right)
        total: Array = load
        if len(dq):
            changes = [float(m[k]) + self._dot(g, du) for m, g in zip(G_m, border.G_u, strict=True)]
            dq[:] = -np.linalg.solve(border.schur, changes)
        for change, R_q, z in zip(dq, border.R_q, border.z, strict=True):
            du, total = du - change * z, total + change * R_q
        self._put(du)
        return Rate(self._du.x.array.copy(), total + self._product(), dq)

    def _change(
        self, i: int, j: Any, rate: Rate, state: Any, weights: Any, explicit: float
    ) -> Array:
        """Derivative of the values of one that is measured. Collective."""
        if isinstance(j, Displacements):
            return j.along(self.problem, rate.du)
        if isinstance(j, Scalar):
            return np.array([d for d, q in zip(rate.dq, self._q, strict=True) if q is j.q])
        found = explicit + self._dot(state, rate.du[: len(state)])
        if isinstance(j, Reaction):
            found += self._dot(weights[: len(rate.dR)], rate.dR)
        for change, by_q in zip(rate.dq, self._J_q[i], strict=False):
            found += float(by_q.numbers()) * change
        return np.array([found])

    def _solved(self, linear: Linearized, right: Array) -> Array:
        with self._b.localForm() as local:
            local.set(0)
        self._b.array[:] = right
        linear.solve(self._b, self._x)
        return np.array(self._x.array_r)

    def _put(self, values: Array) -> None:
        self._du.x.array[: len(values)] = values
        self._du.x.scatter_forward()

    def _product(self) -> Array:
        """K du, the tangent without boundary conditions; owned. Collective."""
        b = self._b
        if len(self.problem.terms) > 1:
            return by_matrix(self.problem, self._du, b, transposed=False)
        if not isinstance(self._Ku, fem.Form):
            self._Ku = compiled(self._Ku)
        with b.localForm() as local:
            local.set(0)
        fem_petsc.assemble_vector(b, self._Ku)
        b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        return np.array(b.array_r)

    def _dot(self, a: Array, b: Array) -> float:
        return float(self.problem.comm.allreduce(float(a @ b)))
