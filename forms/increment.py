# SPDX-License-Identifier: MIT
"""What a step in time adds to the potential: inertia and dissipation, in UFL."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import ufl
from dolfinx import default_scalar_type, fem
from ufl.algorithms import expand_derivatives

from ._types import Expr
from .compilation import compiled
from .dissipation import Dissipation
from .inertia import Inertia
from .quadrature import with_quadrature
from .schemes import Scheme, Strain
from .surface_friction import Sliding, SurfaceFriction
from .unknowns import Field


class Increment:
    """Forms of a step, whose numbers are Constants, and what they refer to Functions.

    Args:
        u: Unknown.
        field: Its displacement.
        velocity: v at the last accepted time.
        inertia: Mass of the body.
        scheme: Scheme in time.
        dissipations: Dissipation potentials.
        thickness: Weight of densities in cells, thickness times circumference.
        around: Weight of densities on boundaries, the circumference.

    Attributes:
        start, drift: u* and d of :mod:`forms.schemes`.
        last, before: u at the last accepted time, and at the one before.
        lag: Where dissipations lag.
        lags: Whether one does.
        forms, terms: What is added to the potential.
    """

    def __init__(
        self,
        u: fem.Function,
        field: Field,
        velocity: fem.Function,
        inertia: Inertia,
        scheme: Scheme,
        dissipations: Sequence[Dissipation | SurfaceFriction],
        thickness: Expr,
        around: Expr,
    ) -> None:
        V, mesh = u.function_space, u.function_space.mesh
        self.start, self.drift, self.last, self.before, self.lag = (
            fem.Function(V) for _ in range(5)
        )
        self._field, self._velocity, self._inertia, self._scheme = field, velocity, inertia, scheme
        self._weight, self._round, self._part = thickness, around, inertia.part
        self._c, self._b, self._inverse, self._strain_inverse = (
            _constant(mesh, 0.0) for _ in range(4)
        )
        self._strain = [_constant(mesh) for _ in range(5)]
        self.lags = any(each.lags for each in dissipations)
        written = [each for each in dissipations if isinstance(each, Dissipation)]
        found = [self._dissipated(each, self._density(each)) for each in written]
        rates = [both for both in found if both is not None]
        own = [inertia.form(field.expression - self._part(self.start), self._c)]
        own += [form for form, _ in rates]
        self.forms = [with_quadrature(form, field.degree) for form in own]
        self._powers = [compiled(with_quadrature(power, field.degree)) for _, power in rates]
        step = self._b, self._inverse, self.drift, self.lag
        pairs = [each for each in dissipations if isinstance(each, SurfaceFriction)]
        self.terms = [Sliding(each, *step) for each in pairs]
        self._comm = mesh.comm

    def assign(self, c: float, b: float, strain: Strain) -> None:
        """Give the potential its numbers."""
        self._c.value, self._b.value, self._inverse.value = c, b, 1 / b
        self._strain_inverse.value = 1 / strain[0]
        for constant, number in zip(self._strain, strain, strict=True):
            constant.value = number

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

    def dissipated_power(self) -> float:
        """phi'(rate) : rate at the present state [W]. Collective."""
        own = sum(fem.assemble_scalar(power) for power in self._powers)
        total = float(self._comm.allreduce(own)) if self._powers else 0.0
        return total + sum(term.power() for term in self.terms)

    def _density(self, each: Dissipation) -> Callable[[Expr], ufl.Form]:
        """How the density of a dissipation is integrated."""
        if each.dx is not None:
            thick = each.dx.integral_type() == "cell" and not each.per_area
            return lambda f: f * (self._weight if thick else self._round) * each.dx
        rho = self._inertia.rho if each.per_mass else 1.0
        return lambda f: rho * f * self._weight * self._inertia.dx

    def _dissipated(self, each: Dissipation, density: Any) -> tuple[ufl.Form, ufl.Form] | None:
        """Potential of a dissipation over a step, and the power it takes; None of a zero one."""
        x = self._field.expression
        if each.of is None:
            rate, inverse = self._b * x + self._part(self.drift), self._inverse
        else:
            rate, inverse = self._strain_rate(each.of), self._strain_inverse
        variable = ufl.variable(rate)
        at = (self._part(self.lag),) if each.lags else ()
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
        last = of(self._part(self.last))
        first = expand_derivatives(ufl.derivative(last, self.last, self._velocity))
        rate = b0 * of(self._field.expression) + b1 * last + g * first
        if self._scheme.two_step:
            rate += b2 * of(self._part(self.before))
        if self._scheme.middle:
            second = ufl.derivative(first, self.last, self._velocity)
            rate += k * expand_derivatives(second)
        return rate


def _constant(mesh: Any, value: float = 1.0) -> fem.Constant:
    return fem.Constant(mesh, default_scalar_type(value))
