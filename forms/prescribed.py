# SPDX-License-Identifier: MIT
"""Values, velocities and accelerations that supports prescribe at a time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray
from ufl.algorithms import expand_derivatives

from . import _dolfinx
from .native import jit
from .problems import Problem
from .supports import Prescribed


class Held(NamedTuple):
    """What supports prescribe, as own entries of the unknown's layout, 0 elsewhere."""

    value: NDArray
    velocity: NDArray
    acceleration: NDArray


class PrescribedMotion:
    """Supports as functions of time, with their derivatives by it, exact ones in UFL.

    Args:
        problem: Problem with the supports.
        t: Time.

    Attributes:
        moves: Whether any support depends on time.
    """

    def __init__(self, problem: Problem, t: fem.Constant) -> None:
        self._problem, self._t = problem, t
        self._b = problem.create_vector()
        self.moves = any(support.depends_on(t) for support in problem.supports)
        parts = [part for support in problem.supports for part in support.parts]
        rates = [_rates(part, t) for part in parts] if self.moves else []
        self._parts = list(zip(parts, rates, strict=True)) if self.moves else []
        self._kept: list[NDArray] = []

    def at(self, time: float) -> Held:
        """What is prescribed at a time, which t and the supports are left at. Collective."""
        self._t.value = time
        for support in self._problem.supports:
            support.update()
        value = self._read()
        if not self.moves:
            return Held(value, 0 * value, 0 * value)
        rates = []
        for order in (0, 1):
            kept = [part.value.x.array.copy() for part, _ in self._parts]
            for part, expressions in self._parts:
                part.value.x.array[:] = 0
                if (expression := expressions[order]) is not None:
                    part.value.interpolate(expression, part.cells)
                    part.value.x.scatter_forward()
            rates.append(self._read())
            for (part, _), values in zip(self._parts, kept, strict=True):
                part.value.x.array[:] = values
        return Held(value, *rates)

    def keep(self) -> None:
        """Remember the supports as they are now, at a state that is accepted; local."""
        self._kept = [part.value.x.array.copy() for part, _ in self._parts]

    def halve(self) -> None:
        """Let supports prescribe the middle between the state kept and the present time; local."""
        for (part, _), values in zip(self._parts, self._kept, strict=True):
            part.value.x.array[:] = (part.value.x.array + values) / 2

    def _read(self) -> NDArray:
        self._b.set(0)
        self._problem.prescribe(self._b)
        return np.array(self._b.array_r)

    def destroy(self) -> None:
        """Free the vector."""
        self._b.destroy()


def _rates(part: Prescribed, t: fem.Constant) -> list[fem.Expression | None]:
    """First and second derivative by time of a prescribed value; None where it is zero."""
    if part.expression is None:
        return [None, None]
    variable = ufl.variable(t)
    expression = ufl.replace(part.expression.ufl_expression, {t: variable})
    W = part.value.function_space
    found: list[fem.Expression | None] = []
    for _ in range(2):
        expression = expand_derivatives(ufl.diff(expression, variable))
        zero = isinstance(expression, ufl.classes.Zero)
        points = _dolfinx.interpolation_points(W)
        found.append(None if zero else jit.expression(expression, points, W.mesh))
    return found
