# SPDX-License-Identifier: MIT
"""Where an eigenvalue of the tangent passes zero between two states of a path."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ..problems import Problem
from .corrector import Corrector
from .extrapolation import State, through

INVERSE_ITERATIONS = 6
MOST = 6  # tangents of a search


class Critical:
    """A secant on the eigenvalue nearest to zero, kept between bounds by the count of negatives.

    Tangents are taken on the curve through the states, which all have been solved for.

    Args:
        problem: Problem.
        corrector: Whose tangent is factorized.
        move: Sets the unknown and the load factor to a state's.
    """

    def __init__(
        self, problem: Problem, corrector: Corrector, move: Callable[[State], None]
    ) -> None:
        self._problem, self._corrector, self._move = problem, corrector, move

    def place(
        self, states: Sequence[State], before: int, tolerance: float, most: int = MOST
    ) -> float:
        """Place between the first two states where the count ceases to be what it was. Collective.

        Args:
            states: The state after, that before, and earlier ones.
            before: Negative eigenvalues at the state before.
            tolerance: How near, in places.
            most: Tangents that it may take.

        Returns:
            The place; the unknown is left somewhere on the curve.
        """
        high, low = states[0].place, states[1].place
        f_high, f_low = (self._eigenvalue(states, place, before) for place in (high, low))
        found = _secant(low, high, f_low, f_high)
        for _ in range(most - 2):
            if not np.isfinite(found) or abs(high - low) <= tolerance:
                break
            f = self._eigenvalue(states, found, before)
            if f > 0:
                near, low, f_low = abs(found - low), found, f
            else:
                near, high, f_high = abs(found - high), found, f
            last, found = found, _secant(low, high, f_low, f_high)
            if min(near, abs(found - last)) <= tolerance:
                break
        return float(found)

    def _eigenvalue(self, states: Sequence[State], place: float, before: int) -> float:
        """The one nearest to zero; positive where the count is that before. Collective."""
        self._move(through(states, place))
        count = self._corrector.refactor()
        if count is None:
            return 0.0
        size = self._nearest()
        return size if count == before else -size

    def _nearest(self) -> float:
        """Magnitude of the eigenvalue nearest to zero, by inverse iteration. Collective."""
        tangent = self._corrector.newton.tangent
        v, w = self._problem.create_vector(), self._problem.create_vector()
        start, end = v.getOwnershipRange()
        v.array[:] = np.sin(1.0 + 0.7 * np.arange(start, end) ** 1.5)
        self._problem.clear(v.array)
        size = 0.0
        for _ in range(INVERSE_ITERATIONS):
            v.normalize()
            if not tangent.solve(v, w):
                break
            size = 1 / w.norm()
            v, w = w, v
        for item in (v, w):
            item.destroy()
        return size


def _secant(low: float, high: float, f_low: float, f_high: float) -> float:
    """Zero of the line, not nearer to an end than a hundredth of the way."""
    fraction = f_low / (f_low - f_high) if f_low > f_high else 0.5
    return low + min(max(fraction, 0.01), 0.99) * (high - low)
