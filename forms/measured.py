# SPDX-License-Identifier: MIT
"""Numbers measured on a solution, with their derivatives: functionals, reactions, displacements.

Each is J(u, m) + R(u, m)[w]: a functional, and the residual at weights w that are no unknowns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any
from weakref import WeakKeyDictionary

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
from .points import cells_at, require_inside
from .problems import Problem
from .quadrature import with_quadrature
from .results import _counted, _displacement, _selected, resultant

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

    @property
    def size(self) -> int:
        """Number of values."""
        return 1

    def values(self, problem: Problem) -> Array:
        """The value, as an array of one. Collective."""
        return np.array([self(problem)])

    def weights(self, problem: Problem) -> Array:
        """Entries w of the unknown, ghosts left out, with which the value is R . w. Collective."""
        dofs, counted = self._nodes(problem)
        gdim = dofs.shape[1]
        directions = np.tile(self._d, (len(dofs), 1))
        if self.about is not None:
            W = _displacement(problem).collapsed[0]
            x = np.array(W.tabulate_dof_coordinates()[: len(dofs)])
            x[:, :gdim] += problem.u.x.array[dofs]
            directions[:] = np.cross(self._d, x - _padded(self.about))
        w = np.zeros(len(problem.u.x.array))
        w[dofs] = _selected(counted, directions[:, :gdim])
        return w

    def by_state(self, problem: Problem, c: Array) -> Array:
        """Derivative by the unknown at fixed R, R_a x d by a moment's arms, times c. Collective."""
        b = _owned(problem)
        if self.about is not None:
            dofs, counted = self._nodes(problem)
            room = problem.create_vector()
            problem.residual(room)
            R = c[0] * room.array_r
            room.destroy()
            forces = np.zeros((len(dofs), 3))
            forces[:, : dofs.shape[1]] = _selected(counted, R[dofs])
            b[dofs] = np.cross(forces, self._d)[:, : dofs.shape[1]]
        return b

    def _nodes(self, problem: Problem) -> tuple[NDArray[np.int32], Any]:
        """Entries of the unknown at owned nodes, (nodes, components), and what of them counts."""
        W, numbers = _displacement(problem).collapsed
        counted = _counted(problem, W, numbers, self.where, self.dim)
        shape = counted.shape[:2]
        return numbers[: shape[0] * shape[1]].reshape(shape), counted


@dataclass(frozen=True, eq=False)
class Displacements:
    """Displacements at points of the reference body, anywhere in it, as data of a fit.

    Args:
        points: Reference positions [m], shape (k, d) or (k, 3), alike on all ranks.
        axes: Components that were measured, as (0, 2); by default all.

    Raises:
        ValueError: points of another shape.
    """

    points: Any
    axes: Sequence[int] | None = None
    _known: WeakKeyDictionary = field(init=False, repr=False, default_factory=WeakKeyDictionary)

    def __post_init__(self) -> None:
        found = np.atleast_2d(np.asarray(self.points, float))
        if found.ndim != 2 or found.shape[1] not in (2, 3) or not np.all(np.isfinite(found)):
            raise ValueError(
                "displacements are measured at finite points of shape (k, 2) or (k, 3), got "
                f"{np.shape(self.points)}."
            )
        object.__setattr__(self, "points", np.pad(found, ((0, 0), (0, 3 - found.shape[1]))))

    def components(self, problem: Problem) -> tuple[int, ...]:
        """Components that were measured."""
        dim = _displacement(problem).components
        axes = tuple(range(dim)) if self.axes is None else tuple(self.axes)
        if not axes or any(axis not in range(dim) for axis in axes):
            raise ValueError(
                f"displacements of this body have the axes 0 to {dim - 1}, got {axes}."
            )
        return axes

    def shape(self, problem: Problem) -> tuple[int, int]:
        """Shape of the values: points, components."""
        return len(self.points), len(self.components(problem))

    def values(self, problem: Problem) -> Array:
        """Displacements, flat, shape (points * components,), alike on all ranks. Collective."""
        return self.along(problem, problem.u.x.array)

    def along(self, problem: Problem, u: Array) -> Array:
        """Values of other entries of the unknown at the points, flat. Collective."""
        found = np.zeros(self.shape(problem))
        for i, dofs, phi in self._rows(problem):
            found[i] = phi @ u[dofs]
        return problem.comm.allreduce(found).ravel()

    def by_state(self, problem: Problem, c: Array) -> Array:
        """Weights c of the values, times their derivative by the unknown. Collective."""
        b = problem.create_vector()
        c = c.reshape(self.shape(problem))
        with b.localForm() as local:
            local.set(0)
            for i, dofs, phi in self._rows(problem):
                for k, rows in enumerate(dofs.T):
                    local.array[rows] += phi * c[i, k]
        b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        found = np.array(b.array_r)
        b.destroy()
        return found

    def weights(self, problem: Problem) -> None:
        """None: no residual is in it."""

    def _rows(self, problem: Problem) -> list[tuple[int, NDArray[np.int32], Array]]:
        """Of each point in a cell of this rank its number, entries (nodes, components), values."""
        if problem.u not in self._known:
            self._known[problem.u] = self._located(problem)
        return self._known[problem.u]

    def _located(self, problem: Problem) -> list[tuple[int, NDArray[np.int32], Array]]:
        axes = list(self.components(problem))
        W, numbers = _displacement(problem).collapsed
        mesh, bs = W.mesh, W.dofmap.bs
        cells, distance = cells_at(mesh, self.points)
        require_inside(mesh, self.points, distance, 1e-6, "the measured point")
        probe = fem.Function(W)
        rows: list[tuple[int, NDArray[np.int32], Array]] = []
        for i in np.flatnonzero(cells >= 0):
            nodes = W.dofmap.cell_dofs(int(cells[i]))
            phi: Array = np.empty(len(nodes))
            for a, node in enumerate(nodes):
                probe.x.array[bs * node] = 1.0
                phi[a] = probe.eval(self.points[i : i + 1], cells[i : i + 1])[0]
                probe.x.array[bs * node] = 0.0
            rows.append((int(i), numbers[bs * nodes[:, None] + axes], phi))
        return rows


class Scalar:
    """A scalar that ``control`` has found, as a value."""

    def __init__(self, q: fem.Constant) -> None:
        self.q, self.size = q, 1

    def values(self, problem: Problem) -> Array:
        """The value, as an array of one."""
        return np.array([float(self.q.value)])

    def by_state(self, problem: Problem, c: Array) -> Array:
        """0: it is no function of the state."""
        return _owned(problem)

    def weights(self, problem: Problem) -> None:
        """None: no residual is in it."""


class Functional:
    """A functional of the unknown, with its value and its derivative by the unknown, compiled."""

    def __init__(self, form: ufl.Form, problem: Problem) -> None:
        _checks.arity(form, 0, "a gradient needs a functional")
        (form,) = with_kinematics(form)
        self.form, self.size = with_quadrature(form), 1
        self._value: Any = None
        v = ufl.TestFunction(problem.u.function_space)
        slope = expand_derivatives(rate(self.form, problem.u, v))
        self._slope = None if slope.empty() else compiled(slope)
        self._whole = slope

    def values(self, problem: Problem) -> Array:
        """The value, as an array of one. Collective."""
        if self._value is None:
            if expand_derivatives(self.form).empty():
                return np.zeros(1)
            self._value = compiled(self.form)
        update_dependents(self.form)
        return np.array([problem.comm.allreduce(fem.assemble_scalar(self._value))])

    def by_state(self, problem: Problem, c: Array) -> Array:
        """Derivative by the unknown, owned, times c. Collective."""
        if self._slope is None:
            return _owned(problem)
        update_dependents(self._whole)
        b = problem.create_vector()
        with b.localForm() as local:
            local.set(0)
        fem_petsc.assemble_vector(b, self._slope)
        b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        found = c[0] * b.array_r
        b.destroy()
        return found

    def weights(self, problem: Problem) -> None:
        """None: no residual is in it."""


def measured(J: Any, problem: Problem, border: Any, what: str) -> Any:
    """What is differentiated, as one of the above.

    Args:
        J: What is given.
        problem: Whose solution it is measured on.
        border: What is held (:class:`forms.paths.Held`), if anything.
        what: Who asks, for messages.

    Raises:
        ValueError: it is none of them.
    """
    if isinstance(J, Reaction | Displacements):
        return J
    if isinstance(J, ufl.Form):
        return Functional(J, problem)
    if border is not None and any(J is q for q in border.q):
        return Scalar(J)
    raise ValueError(
        f"{what} differentiates a functional (a UFL form), a forms.Reaction, or the scalar that "
        f"control has found, got {type(J).__name__}."
    )


def _owned(problem: Problem) -> Array:
    dofmap = problem.u.function_space.dofmap
    return np.zeros(dofmap.index_map.size_local * dofmap.bs)


def _padded(v: Sequence[float]) -> Array:
    found = np.zeros(3)
    found[: len(v)] = v
    return found
