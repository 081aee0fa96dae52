# SPDX-License-Identifier: MIT
"""What control holds, in the adjoint system: its scalars move with the parameters."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from petsc4py import PETSc

import numpy as np
import ufl
from numpy.typing import NDArray

from ..measured import Functional, Scalar
from ..parameters import Slope
from ..paths import Held
from ..problems import Problem
from .linearized import Linearized

Array = NDArray[np.float64]


class Holding:
    """The equations G_j(u, q) = values of control, in the adjoint system.

    y = K^-T (J_u + K^T w),  z_j = K^-T G_j,u,  lambda = y - sum_j nu_j z_j,
    sum_j (G_j,q - R_q . z_j) nu_j = J_q + R_q[w] - R_q . y  by each q

    Args:
        problem: What is solved.
        border: Scalars q, and the functionals that they hold.
        R: Residual at the function of adjoints.
        measured: Objects of :mod:`forms.measured`.

    Attributes:
        q: The scalars.
        forms: The functionals.
        by_state: Their derivatives by the unknown, owned, at the last state.
    """

    def __init__(
        self,
        problem: Problem,
        border: Held,
        R: ufl.Form,
        measured: list[Any],
    ) -> None:
        self.problem, self.q = problem, border.q
        self.functionals = [Functional(form, problem) for form in border.functionals]
        self.forms = [functional.form for functional in self.functionals]
        self._R_q = [Slope(R, q) for q in self.q]
        self._G_q = [[Slope(form, q) for form in self.forms] for q in self.q]
        self._J_q = [
            [Slope(j.form, q) if isinstance(j, Functional) else None for j in measured]
            for q in self.q
        ]
        self._is_q = [[isinstance(j, Scalar) and j.q is q for j in measured] for q in self.q]
        self.by_state: list[Array] = []

    def eliminated(
        self,
        linear: Linearized,
        y: Array,
        w: Array,
        c: list[Array],
        room: tuple[PETSc.Vec, PETSc.Vec],
        put: Callable[[Array], None],
    ) -> tuple[Array, Array]:
        """Owned lambda, and nu. Collective."""
        self.by_state = [f.by_state(self.problem, np.ones(1)) for f in self.functionals]
        z = []
        for by_state in self.by_state:
            fill(room[0], by_state)
            linear.solve(*room, transposed=True)
            z.append(np.array(room[1].array_r))

        def loads(a: Array) -> Array:
            put(a)
            return np.array([float(slope.numbers()) for slope in self._R_q])

        J_q = loads(w)
        for k, (slopes, are_q) in enumerate(zip(self._J_q, self._is_q, strict=True)):
            for f, slope, is_q in zip(c, slopes, are_q, strict=True):
                J_q[k] += f[0] * (float(is_q) if slope is None else float(slope.numbers()))
        G_q = np.array([[float(slope.numbers()) for slope in slopes] for slopes in self._G_q])
        nu = np.linalg.solve(G_q - np.array([loads(each) for each in z]).T, J_q - loads(y))
        return y - sum(n * each for n, each in zip(nu, z, strict=True)), nu


def fill(b: PETSc.Vec, values: Array) -> None:
    """Put owned values into a vector, 0 into its ghosts; local."""
    with b.localForm() as local:
        local.set(0)
    b.array[:] = values
