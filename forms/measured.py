# SPDX-License-Identifier: MIT
"""Numbers measured on a solution, with their derivatives: functionals and reactions.

Each is J(u, m) + R(u, m)[w]: a functional, and the residual at weights w that are no unknowns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from petsc4py import PETSc

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from numpy.typing import NDArray
from ufl.algorithms import expand_derivatives

from . import _checks
from .compilation import compiled
from .differentiation import rate, update_dependents
from .loads import with_kinematics
from .problems import Problem
from .quadrature import with_quadrature
from .results import _counted, _displacement, resultant

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Reaction:
    """Component of the force, or moment, that supports exert on the body: a record with a gradient.

    d . sum_a R_a, or with a point c, d . sum_a (X_a + u_a - c) x R_a, as :func:`forms.resultant`

    ``record={"force": forms.Reaction(body.facets("right"), (1, 0, 0))}`` notes it, and
    ``forms.gradient`` differentiates it.

    Args:
        where: Facets, or another place, as :func:`forms.resultant` takes it.
        direction: Direction d, not normalized: of the force [N], or of the moment's axis [N m].
        about: Point c of a moment [m]; None for the force.
        dim: Dimension of the entities, as :func:`forms.resultant` takes it.

    Raises:
        ValueError: a direction or a point that has not 2 or 3 components.
    """

    where: Any
    direction: Sequence[float] = (1.0, 0.0, 0.0)
    about: Sequence[float] | None = None
    dim: int | None = None
    _d: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        for what, given in (("direction", self.direction), ("point", self.about)):
            if given is not None and np.shape(given) not in ((2,), (3,)):
                raise ValueError(f"a reaction needs a {what} of 2 or 3 components, got {given}.")
        object.__setattr__(self, "_d", _padded(self.direction))

    def __call__(self, problem: Any) -> float:
        """Value at the present state, of a problem or a path. Collective."""
        about = (0.0, 0.0, 0.0) if self.about is None else self.about
        force, moment = resultant(problem, self.where, about, self.dim)
        return float(self._d @ (force if self.about is None else moment))

    def weights(self, problem: Problem) -> Array:
        """Entries w of the unknown's owned part with which the value is R . w. Collective."""
        dofs, counted, x = self._nodes(problem)
        gdim = dofs.shape[1]
        directions = np.tile(self._d, (len(dofs), 1))
        if self.about is not None:
            x[:, :gdim] += problem.u.x.array[dofs]
            directions[:] = np.cross(self._d, x - _padded(self.about))
        w = np.zeros(len(problem.u.x.array))
        w[dofs] = np.where(counted, directions[:, :gdim], 0.0)
        return w

    def lever(self, problem: Problem, R: Array) -> Array:
        """Derivative of R . w by the unknown through the moment's arms: R_a x d. Local."""
        b = np.zeros(len(R))
        if self.about is not None:
            dofs, counted, _ = self._nodes(problem)
            forces = np.zeros((len(dofs), 3))
            forces[:, : dofs.shape[1]] = np.where(counted, R[dofs], 0.0)
            b[dofs] = np.cross(forces, self._d)[:, : dofs.shape[1]]
        return b

    def _nodes(self, problem: Problem) -> tuple[NDArray[np.int32], NDArray[np.bool_], Array]:
        W, numbers = _displacement(problem).collapsed
        counted = _counted(problem, W, numbers, self.where, self.dim)
        count, gdim = counted.shape
        dofs = numbers[: count * gdim].reshape(count, gdim)
        return dofs, counted, np.array(W.tabulate_dof_coordinates()[:count])


class Functional:
    """A functional of the unknown, with its value and its derivative by the unknown, compiled."""

    def __init__(self, form: ufl.Form, problem: Problem) -> None:
        _checks.arity(form, 0, "a gradient needs a functional")
        (form,) = with_kinematics(form)
        self.form = with_quadrature(form)
        self._value: Any = None
        slope = expand_derivatives(
            rate(self.form, problem.u, ufl.TestFunction(problem.u.function_space))
        )
        self._slope = None if slope.empty() else compiled(slope)
        self._whole = slope

    def __call__(self, problem: Problem) -> float:
        """Value at the present state. Collective."""
        if expand_derivatives(self.form).empty():
            return 0.0
        if self._value is None:
            self._value = compiled(self.form)
        update_dependents(self.form)
        return float(problem.comm.allreduce(fem.assemble_scalar(self._value)))

    def add_by_state(self, b: PETSc.Vec) -> None:
        """Add the derivative by the unknown to a vector with ghosts, which are added up later."""
        if self._slope is not None:
            update_dependents(self._whole)
            fem_petsc.assemble_vector(b, self._slope)


def _padded(v: Sequence[float]) -> Array:
    found = np.zeros(3)
    found[: len(v)] = v
    return found
