# SPDX-License-Identifier: MIT
"""Bodies with inertia: displacement, velocity and acceleration, and the potential of a step.

What a step lowers stands in :mod:`forms.schemes`; its terms are UFL forms like any other, with
Constants for the scheme's numbers, so that nothing is compiled or set up again from step to step.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray

from . import _checks, _dolfinx
from .dissipation import Dissipation
from .increment import Increment
from .inertia import Inertia, given
from .kinematics import circumference, is_revolved
from .native import jit
from .prescribed import PrescribedMotion
from .problems import Problem
from .schemes import Scheme, Weights
from .supports import Support
from .surface_friction import SurfaceFriction
from .unknowns import displacement_field
from .variation import residual

Array = NDArray[np.float64]


class State(NamedTuple):
    """A motion at a time: the solution s of a step, and u, v, a with all entries of the unknown."""

    s: Array
    u: Array
    v: Array
    a: Array


class Motion:
    """A body in motion: its state, and the problem that a step in time is. Collective.

    Args:
        potential: Total potential [J], or a residual, or a list as of :class:`forms.Problem`.
        u: Unknown; its displacement has inertia, pressures and other fields have none.
        supports: Prescribed displacements, which may depend on t.
        t: Time [s].
        rho: Mass per reference volume [kg/m^3].
        scheme: Scheme in time.
        virtual_work: Linear form added to the residual.
        dissipation: Dissipation potentials.
        lumped: Whether the mass is lumped at the nodes.
        thickness: Of a sheet [m].
        dx: Measure of what has mass; by default all cells.

    Attributes:
        problem: What a step solves.
        velocity, acceleration: v and a at the last accepted time.
        held: Supports as functions of time.
        step: Length of the last step [s], 0 before the first.
        momenta: Momentum and angular momentum that a body which nothing holds has by the midpoint
            rule, shape (6,); else 0.
        stage: What the step in question minimizes.
        lags: Whether a dissipation lags.
        without_inertia, dissipated_power: Those of :class:`forms.increment.Increment`.
        dt, begun: Length of the step in question, and the time it begins at [s].
    """

    def __init__(
        self,
        potential: Any,
        u: fem.Function,
        supports: Iterable[Support] | Support,
        t: fem.Constant,
        rho: Any,
        scheme: Scheme,
        virtual_work: ufl.Form | None = None,
        dissipation: Sequence[Dissipation] | Dissipation = (),
        lumped: bool = False,
        thickness: Any = 1.0,
        dx: ufl.Measure | None = None,
    ) -> None:
        field = displacement_field(_checks.function(u, "a motion"))
        if field is None:
            raise ValueError(f"a motion needs a displacement, which {u.name} has not.")
        self.u, self.t, self.scheme, self._field, self.step = u, t, scheme, field, 0.0
        V, mesh = u.function_space, u.function_space.mesh
        self.velocity, self.acceleration = fem.Function(V, name="velocity"), fem.Function(V)
        self.acceleration.name = "acceleration"
        self._velocity_before = np.zeros_like(u.x.array)
        given_: Any = dissipation
        listed = tuple(given_) if isinstance(given_, list | tuple) else (given_,)
        parts = list(potential) if isinstance(potential, list | tuple) else [potential]
        self._check(parts, listed, rho)
        weight = given(mesh, thickness, "a thickness")
        self._revolved = any(is_revolved(p) for p in parts if isinstance(p, ufl.Form))
        around = circumference(field.expression) if self._revolved else ufl.as_ufl(1.0)
        dx = _checks.measure(ufl.dx if dx is None else dx, "a mass")
        self.inertia = Inertia(u, field, rho, weight * around, dx, lumped)
        self._part, self._nodes = self.inertia.part, self.inertia.nodes
        what = u, field, self.velocity, self.inertia, scheme
        added = Increment(*what, listed, weight * around, around)
        self.lags = added.lags
        self._last, self._before, self._lag = added.last, added.before, added.lag
        self._start, self._drift, self._assign = added.start, added.drift, added.assign
        self.without_inertia, self.dissipated_power = added.without_inertia, added.dissipated_power
        own = added.forms
        arguments = [p for p in parts if isinstance(p, ufl.Form) and p.arguments()]
        if arguments:  # a residual has no energy for them to be added to
            own = [residual(form, u) for form in own]
        self.problem = Problem([*parts, *own, *added.terms], u, supports, virtual_work)
        self.problem.motion = self
        self.held = PrescribedMotion(self.problem, t)
        self._vector = self.problem.create_vector()
        self.given, self.stage = self.held.at(float(t.value)), scheme.stage(1.0, 0.0)
        self.dt, self.begun = 0.0, float(t.value)
        slants = self.problem.slants
        held = len(self.problem.constrained) + (0 if slants is None else slants.count)
        held = self.problem.comm.allreduce(held)
        self._free, self._owned = scheme.middle and not held, self._vector.getLocalSize()
        self._masses = self.inertia.of(np.ones_like(u.x.array))
        self.momenta: NDArray = np.zeros(6)
        self._momenta_ahead: NDArray = self.momenta

    def _check(self, parts: Sequence[Any], listed: Sequence[Any], rho: Any) -> None:
        for each in listed:
            if not isinstance(each, Dissipation | SurfaceFriction):
                raise ValueError(
                    "dissipation takes what forms.dissipation returns, as kelvin_voigt(eta), got "
                    f"{type(each).__name__}."
                )
            if isinstance(each, SurfaceFriction) and each.contact not in parts:
                raise ValueError(
                    "friction acts in a contact of the potential, got one of surfaces that is not "
                    "in it: pass [psi * ufl.dx, contact]."
                )
        if rho is None:
            raise ValueError("a motion needs the mass density, rho = 1000.0 [kg/m^3], got none.")
        number = _checks.number(rho)
        if number is not None and not 0 < number < np.inf:
            raise ValueError(f"a motion needs a mass density rho > 0 [kg/m^3], got {number:g}.")

    # ---- the state

    def begin(self, velocity: Any = None) -> None:
        """Take u's values for the first displacement, and find the first acceleration. Collective.

        M a = -Pi'(u; t) - phi'(v), where supports leave it free.

        Args:
            velocity: First velocity: a Function of the unknown, or a vector in UFL or numbers.
        """
        held, u = self.problem.constrained, self.u
        self._put_velocity(velocity)
        given = self.held.at(float(self.t.value))
        self.problem.put(u.x.array, given.value)
        self.problem.put(self.velocity.x.array, given.velocity)
        for function in (u, self.velocity):
            function.x.scatter_forward()
        self._last.x.array[:] = u.x.array
        self.acceleration.x.array[:] = 0
        self._let_forces_be_those_of_the_state()
        self.problem.residual(self._vector)
        self.problem.put(self.acceleration.x.array, given.acceleration)
        self.acceleration.x.scatter_forward()
        forces = self._vector.array_r.copy()
        forces += self.inertia.of(self.acceleration.x.array)
        change = self.inertia.solve(-forces, held, self.problem.slants)
        self.acceleration.x.array[: self._owned] += change
        self.acceleration.x.scatter_forward()
        self._let_forces_be_those_of_the_state()
        self._measure_momenta()

    def _measure_momenta(self) -> None:
        if self._free:
            momentum = self.inertia.of(self.velocity.x.array)
            self.momenta = self.inertia.balance(momentum, self.u.x.array)

    def _put_velocity(self, velocity: Any) -> None:
        place, v = self._field.place, self.velocity
        if isinstance(velocity, fem.Function) and velocity.function_space == v.function_space:
            v.x.array[:] = velocity.x.array
        elif velocity is not None:
            dim = self._field.components
            value = _checks.vector(velocity, (dim,), "a velocity")
            W = self._field.collapsed[0]
            points = _dolfinx.interpolation_points(W)
            expression = jit.expression(value, points, W.mesh)
            (v if place is None else v.sub(place)).interpolate(expression)
        v.x.array[self.inertia.others] = 0
        v.x.scatter_forward()

    def aim(self, dt: float) -> None:
        """Set time, supports and potential for a step, and u to where it leads freely. Collective.

        Velocity and acceleration stay those of the last accepted state.
        """
        begin, middle = float(self.t.value), self.scheme.middle
        stage, own = self.scheme.stage(dt, self.step), self._owned
        last, v, a = (f.x.array for f in (self._last, self.velocity, self.acceleration))
        h = dt / 2 if middle else dt
        moved, fields = self._nodes.ravel(), np.asarray(self.u.x.array)
        fields[:] = last
        fields[moved] += (h * v + h**2 / 2 * a)[moved]
        self.given = given = self.held.at(begin + dt)
        value, velocity, acceleration = given
        if middle:
            self.held.halve()
            value, velocity = (value + last[:own]) / 2, (value - last[:own]) / dt
            acceleration = (given.velocity - v[:own]) / dt
            self.t.value = begin + h
        self.problem.put(fields, value)
        self._start.x.array[:] = self._sum(stage.start)
        self._drift.x.array[:] = self._sum(stage.drift)
        # So that inertia and rates there are those of the prescribed motion.
        self.problem.put(self._start.x.array, value - acceleration / stage.inertia)
        self.problem.put(self._drift.x.array, velocity - stage.rate * value)
        for function in (self.u, self._start, self._drift):
            function.x.scatter_forward()
        self._value, self._lag.x.array[:] = value, last
        self.stage, self.dt, self.begun = stage, dt, begin
        self._assign(stage.inertia, stage.rate, stage.strain)

    def relag(self) -> None:
        """Let dissipations lag at the step's present solution; local."""
        self._lag.x.array[:] = self.u.x.array

    def stay(self) -> None:
        """Begin the step's solve from the last state, and not from where that leads freely."""
        self.u.x.array[:] = self._last.x.array
        self.problem.put(self.u.x.array, self._value)
        self.u.x.scatter_forward()

    def _sum(self, weights: Weights) -> Array:
        known = (self._last, self.velocity, self.acceleration, self._before)
        arrays = [f.x.array for f in known] + [self._velocity_before]
        total = np.zeros_like(self._velocity_before)
        for weight, values in zip(weights, arrays, strict=True):
            if weight:
                total += weight * values
        return total

    def found(self) -> State:
        """The motion that a step's solution means; nothing is taken yet. Collective."""
        stage, others = self.stage, self.inertia.others
        s = self.u.x.array.copy()
        a = stage.inertia * (s - self._start.x.array)
        v = stage.rate * s + self._drift.x.array
        u = s
        if self.scheme.middle:
            u, v = 2 * s - self._last.x.array, 2 * v - self.velocity.x.array
            u[others] = s[others]
            self.problem.put(v, self.given.velocity)
            if self._free:
                v[: self._owned] += self._rigid_rest(s, u, v)
        self.problem.put(u, self.given.value)
        a[others] = v[others] = 0
        return State(s, u, v, a)

    def _rigid_rest(self, s: Array, u: Array, v: Array) -> Array:
        """What v misses of the body's momenta, as a rigid motion, own entries. Collective.

        Those follow from the forces in the middle of the step alone, whatever tolerances and
        rounding leave in each of the nodes.
        """
        inertia = self.inertia
        with self.without_inertia(viscous=True):
            self.problem.residual(self._vector)
        forces = np.asarray(self._vector.array_r)
        self._momenta_ahead = self.momenta - self.dt * inertia.balance(forces, s)
        left = self._momenta_ahead - inertia.balance(inertia.of(v), u)
        return inertia.rigid(left, u, self._masses, not self._revolved)

    def take(self, state: State) -> None:
        """Take a state for the last accepted one; time and supports go to its time. Collective."""
        self._before.x.array[:] = self._last.x.array
        self._velocity_before[:] = self.velocity.x.array
        middle = 0.5 * (self.dt + self.step) if self.step else self.dt / 2
        before = self.acceleration.x.array.copy()
        for function, values in (
            (self.u, state.u),
            (self._last, state.u),
            (self.velocity, state.v),
            (self.acceleration, state.a),
        ):
            function.x.array[:] = values
            function.x.scatter_forward()
        self.step = self.dt
        self.momenta = self._momenta_ahead
        self.held.at(self.begun + self.dt)
        self.held.keep()
        if self.scheme.middle:
            # Forces at the state itself: inertia from the last two middles.
            end = state.a + (state.a - before) * (self.dt / 2 / middle)
            self._start.x.array[:] = state.u - end / self.stage.inertia
            self._start.x.scatter_forward()

    @property
    def last(self) -> Array:
        """Displacement at the last accepted time, with ghosts."""
        return np.asarray(self._last.x.array)

    def back(self) -> None:
        """Return to the last accepted state. Collective."""
        self.u.x.array[:] = self._last.x.array
        self.t.value = self.begun
        self.problem.rollback()

    # ---- what is measured

    def records(self, momentum: Array) -> dict[str, Any]:
        """Kinetic energy and momenta of the last accepted state, whose M v is given. Collective."""
        return self.inertia.momenta(self.velocity.x.array, momentum, not self._revolved)

    def error(self, state: State) -> tuple[float, float]:
        """Largest local error of a displacement in the step, and what it is compared with [m].

        That is the largest displacement, or in the first step, if it is larger, the one that the
        body's stiffness lets the first acceleration make, |a| |du| / |da|. Collective.
        """
        weight, first = self.scheme.error(self.dt, self.step), not self.step
        free = np.setdiff1d(self._nodes, self.problem.constrained)
        free = free[free < self._owned]  # of ghosts it is not said whether they are held
        change = state.a - self.acceleration.x.array
        arrays = (state.a, change, state.u - self.last, state.u, state.v)
        own = np.array([np.abs(x[free]).max(initial=0.0) for x in arrays])
        own[3:] = [np.abs(x[self._nodes]).max(initial=0.0) for x in arrays[3:]]
        a, da, du, u, v = np.max(self.problem.comm.allgather(own), axis=0)
        by_value = self.scheme.order == 1 or (first and self.scheme.two_step)
        scale = max(u, self.dt * v)
        if first and da > 0:
            scale = max(scale, a * du / da)
        return float(weight * (a if by_value else da)), float(scale)

    # ---- what a checkpoint keeps

    def memory(self) -> list[Array]:
        """States that the next step is made of."""
        known = [self._last.x.array, self.velocity.x.array, self.acceleration.x.array]
        if self.scheme.two_step:
            known += [self._before.x.array, self._velocity_before]
        return [values.copy() for values in known]

    def recall(self, states: Sequence[Array], step: float) -> None:
        """Go on from states; t has their time. Collective."""
        known = [self._last.x.array, self.velocity.x.array, self.acceleration.x.array]
        known += [self._before.x.array, self._velocity_before]
        for target, values in zip(known, states, strict=False):
            target[:] = values
        self.u.x.array[:] = self._last.x.array
        self.step = step
        self.held.at(float(self.t.value))
        self._let_forces_be_those_of_the_state()

    def _let_forces_be_those_of_the_state(self) -> None:
        """Let the potential have the inertia and the rates of the last accepted state."""
        self._assign(1.0, 1.0, (1.0, -1.0, 0.0, 1.0, 0.0))
        self._start.x.array[:] = self._last.x.array - self.acceleration.x.array
        self._drift.x.array[:] = self.velocity.x.array - self._last.x.array
        self._lag.x.array[:] = self._last.x.array
        self.held.keep()

    def destroy(self) -> None:
        """Free the vectors. Collective."""
        self._vector.destroy()
        self.held.destroy()
