# SPDX-License-Identifier: MIT
"""Bodies with inertia: displacement, velocity and acceleration, and the potential of a step.

What a step lowers stands in :mod:`forms.schemes`; its terms are UFL forms like any other, with
Constants for the scheme's numbers, so that nothing is compiled or set up again from step to step.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
import ufl
from dolfinx import default_scalar_type, fem
from numpy.typing import NDArray
from ufl.algorithms import expand_derivatives

from . import _checks, _dolfinx
from ._types import Expr
from .compilation import compiled
from .dissipation import Dissipation
from .inertia import Inertia, given
from .kinematics import circumference, is_revolved
from .native import jit
from .prescribed import PrescribedMotion
from .problems import Problem
from .quadrature import with_quadrature
from .schemes import Scheme, Strain, Weights
from .supports import Support
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
        self._last, self._before, self._start, self._drift, self._lag = (
            fem.Function(V) for _ in range(5)
        )
        self._velocity_before = np.zeros_like(u.x.array)
        self._c, self._b, self._inverse, self._strain_inverse = (
            _constant(mesh, 0.0) for _ in range(4)
        )
        self._strain = [_constant(mesh) for _ in range(5)]
        given_: Any = dissipation
        listed = tuple(given_) if isinstance(given_, list | tuple) else (given_,)
        parts = list(potential) if isinstance(potential, list | tuple) else [potential]
        self._check(parts, listed, rho)
        weight = given(mesh, thickness, "a thickness")
        self._revolved = any(is_revolved(p) for p in parts if isinstance(p, ufl.Form))
        self._round = circumference(field.expression) if self._revolved else ufl.as_ufl(1.0)
        self._weight = weight * self._round
        dx = _checks.measure(ufl.dx if dx is None else dx, "a mass")
        self.inertia = Inertia(u, field, rho, self._weight, dx, lumped)
        self._part, self._nodes = self.inertia.part, self.inertia.nodes
        self.lags = any(each.lags for each in listed)
        found = [self._dissipated(each, self._density(each)) for each in listed]
        rates = [parts_ for parts_ in found if parts_ is not None]
        arguments = [p for p in parts if isinstance(p, ufl.Form) and p.arguments()]
        own = [self.inertia.form(field.expression - self._part(self._start), self._c)]
        own += [form for form, _ in rates]
        own = [with_quadrature(form, field.degree) for form in own]
        if arguments:  # a residual has no energy for them to be added to
            own = [residual(form, u) for form in own]
        self.problem = Problem([*parts, *own], u, supports, virtual_work)
        self.problem.motion = self
        self._powers = [compiled(with_quadrature(power, field.degree)) for _, power in rates]
        self.held = PrescribedMotion(self.problem, t)
        self._vector = self.problem.create_vector()
        self.given, self.stage = self.held.at(float(t.value)), scheme.stage(1.0, 0.0)
        self.dt, self.begun = 0.0, float(t.value)
        held = self.problem.comm.allreduce(len(self.problem.constrained))
        self._free, self._owned = scheme.middle and not held, self._vector.getLocalSize()
        self._masses = self.inertia.of(np.ones_like(u.x.array))
        self.momenta: NDArray = np.zeros(6)
        self._momenta_ahead: NDArray = self.momenta

    def _check(self, parts: Sequence[Any], listed: Sequence[Any], rho: Any) -> None:
        for each in listed:
            if not isinstance(each, Dissipation):
                raise ValueError(
                    "dissipation takes what forms.dissipation returns, as kelvin_voigt(eta), got "
                    f"{type(each).__name__}."
                )
        if rho is None:
            raise ValueError("a motion needs the mass density, rho = 1000.0 [kg/m^3], got none.")
        number = _checks.number(rho)
        if number is not None and not 0 < number < np.inf:
            raise ValueError(f"a motion needs a mass density rho > 0 [kg/m^3], got {number:g}.")

    def _density(self, each: Dissipation) -> Callable[[Expr], ufl.Form]:
        """How the density of a dissipation is integrated."""
        if each.dx is not None:
            thick = each.dx.integral_type() == "cell" and not each.per_area
            return lambda f: f * (self._weight if thick else self._round) * each.dx
        rho = self.inertia.rho if each.per_mass else 1.0
        return lambda f: rho * f * self._weight * self.inertia.dx

    def _dissipated(self, each: Dissipation, density: Any) -> tuple[ufl.Form, ufl.Form] | None:
        """Potential of a dissipation over a step, and the power it takes; None of a zero one."""
        x = self._field.expression
        if each.of is None:
            rate, inverse = self._b * x + self._part(self._drift), self._inverse
        else:
            rate, inverse = self._strain_rate(each.of), self._strain_inverse
        variable = ufl.variable(rate)
        at = (self._part(self._lag),) if each.lags else ()
        phi = each.phi(variable, *at)
        if getattr(phi, "ufl_shape", None) != ():
            raise ValueError(
                f"a dissipation's phi is a scalar of the rate, got {type(phi).__name__} of shape "
                f"{getattr(phi, 'ufl_shape', ())}."
            )
        power = ufl.inner(ufl.diff(phi, variable), variable)
        if isinstance(phi, ufl.classes.Zero) or isinstance(power, ufl.classes.Zero):
            return None
        return density(inverse * phi), density(power)

    def _strain_rate(self, of: Any) -> Expr:
        b0, b1, b2, g, k = self._strain
        last = of(self._part(self._last))
        first = expand_derivatives(ufl.derivative(last, self._last, self.velocity))
        rate = b0 * of(self._field.expression) + b1 * last + g * first
        if self.scheme.two_step:
            rate += b2 * of(self._part(self._before))
        if self.scheme.middle:
            second = ufl.derivative(first, self._last, self.velocity)
            rate += k * expand_derivatives(second)
        return rate

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
        u.x.array[held], self.velocity.x.array[held] = given.value, given.velocity
        for function in (u, self.velocity):
            function.x.scatter_forward()
        self._last.x.array[:] = u.x.array
        self.acceleration.x.array[:] = 0
        self._let_forces_be_those_of_the_state()
        self.problem.residual(self._vector)
        self.acceleration.x.array[held] = given.acceleration
        self.acceleration.x.scatter_forward()
        forces = self._vector.array_r.copy()
        forces += self.inertia.of(self.acceleration.x.array)
        self.acceleration.x.array[: self._owned] += self.inertia.solve(-forces, held)
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
        stage, held = self.scheme.stage(dt, self.step), self.problem.constrained
        last, v, a = (f.x.array for f in (self._last, self.velocity, self.acceleration))
        h = dt / 2 if middle else dt
        moved, fields = self._nodes.ravel(), np.asarray(self.u.x.array)
        fields[:] = last
        fields[moved] += (h * v + h**2 / 2 * a)[moved]
        self.given = given = self.held.at(begin + dt)
        value, velocity, acceleration = given
        if middle:
            self.held.halve()
            value, velocity = (value + last[held]) / 2, (value - last[held]) / dt
            acceleration = (given.velocity - v[held]) / dt
            self.t.value = begin + h
        fields[held] = value
        self._start.x.array[:] = self._sum(stage.start)
        self._drift.x.array[:] = self._sum(stage.drift)
        # So that inertia and rates there are those of the prescribed motion.
        self._start.x.array[held] = value - acceleration / stage.inertia
        self._drift.x.array[held] = velocity - stage.rate * value
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
        self.u.x.array[self.problem.constrained] = self._value
        self.u.x.scatter_forward()

    def _sum(self, weights: Weights) -> Array:
        known = (self._last, self.velocity, self.acceleration, self._before)
        arrays = [f.x.array for f in known] + [self._velocity_before]
        return sum(w * x for w, x in zip(weights, arrays, strict=True) if w)  # type: ignore

    def _assign(self, c: float, b: float, strain: Strain) -> None:
        """Give the potential its numbers."""
        self._c.value, self._b.value, self._inverse.value = c, b, 1 / b
        self._strain_inverse.value = 1 / strain[0]
        for constant, number in zip(self._strain, strain, strict=True):
            constant.value = number

    def found(self) -> State:
        """The motion that a step's solution means; nothing is taken yet. Local."""
        stage, held, others = self.stage, self.problem.constrained, self.inertia.others
        s = self.u.x.array.copy()
        a = stage.inertia * (s - self._start.x.array)
        v = stage.rate * s + self._drift.x.array
        u = s
        if self.scheme.middle:
            u, v = 2 * s - self._last.x.array, 2 * v - self.velocity.x.array
            u[others] = s[others]
            v[held] = self.given.velocity
            if self._free:
                v[: self._owned] += self._rigid_rest(s, u, v)
        u[held] = self.given.value
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
        """U at the last accepted time, with ghosts."""
        return np.asarray(self._last.x.array)

    def back(self) -> None:
        """Return to the last accepted state. Collective."""
        self.u.x.array[:] = self._last.x.array
        self.t.value = self.begun
        self.problem.rollback()

    @contextmanager
    def without_inertia(self, viscous: bool = False) -> Iterator[None]:
        """The problem with its potential alone, as in statics, within a block.

        Args:
            viscous: Whether dissipation stays.
        """
        constants = [self._c] + ([] if viscous else [self._inverse, self._strain_inverse])
        kept = [float(constant.value) for constant in constants]
        for constant in constants:
            constant.value = 0.0
        try:
            yield
        finally:
            for constant, value in zip(constants, kept, strict=True):
                constant.value = value

    # ---- what is measured

    def records(self, momentum: Array) -> dict[str, Any]:
        """Kinetic energy and momenta of the last accepted state, whose M v is given. Collective."""
        return self.inertia.momenta(self.velocity.x.array, momentum, not self._revolved)

    def dissipated_power(self) -> float:
        """phi'(rate) : rate at the present state [W]. Collective."""
        own = sum(fem.assemble_scalar(power) for power in self._powers)
        return float(self.problem.comm.allreduce(own)) if self._powers else 0.0

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


def _constant(mesh: Any, value: float = 1.0) -> fem.Constant:
    return fem.Constant(mesh, default_scalar_type(value))
