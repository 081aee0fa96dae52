# SPDX-License-Identifier: MIT
"""The curve through the last states of a path: extrapolated from, interpolated on."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..ledger import lagrange
from ..problems import Problem

CLOSE = 0.03  # spacing of states, over the way to go, below which their tolerances are magnified


class State(NamedTuple):
    """An equilibrium: values of the unknown, ghosts included, scalars, place on the path.

    The scalars are the load factor, or what stands in for it: one q, or several.
    """

    values: NDArray[np.float64]
    loads: tuple[float, ...]
    place: float

    @property
    def load(self) -> float:
        """The first of the scalars, by which a path's steps are named."""
        return self.loads[0]


def extrapolate(problem: Problem, past: Sequence[State], to: float) -> tuple[int, State]:
    """Move u on along the polynomial through the last states, as many as are of use. Collective.

    Where the energy is not finite there, or an obstacle is crossed on the way, fewer.

    Args:
        problem: Problem, whose unknown is moved.
        past: States, the latest first.
        to: Place.

    Returns:
        How many states were used, and the state on the polynomial.
    """
    states = [past[0]]
    for state in past[1:]:
        if abs(states[-1].place - state.place) >= CLOSE * abs(to - past[0].place):
            states.append(state)
    for count in range(len(states), 1, -1):
        found = through(states[:count], to)
        problem.u.x.array[:] = found.values
        if (not problem.has_energy or np.isfinite(problem.energy())) and not problem.crossed():
            return count, found
    problem.u.x.array[:] = past[0].values
    return 1, past[0]


def through(states: Sequence[State], to: float) -> State:
    """State at a place of the polynomial through states."""
    values, loads = _combined(states, lagrange(_places(states), to)[0])
    return State(values, loads, to)


def slope(states: Sequence[State]) -> State:
    """Derivative by the place, at the first of the states, of the polynomial through all."""
    values, loads = _combined(states, lagrange(_places(states), states[0].place)[1])
    return State(values, loads, 1.0)


def _places(states: Sequence[State]) -> NDArray[np.float64]:
    return np.array([state.place for state in states])


def _combined(
    states: Sequence[State], weights: NDArray[np.float64]
) -> tuple[NDArray[np.float64], tuple[float, ...]]:
    values, loads = np.zeros_like(states[0].values), np.zeros(len(states[0].loads))
    for state, weight in zip(states, weights, strict=True):
        values += weight * state.values
        loads += weight * np.array(state.loads)
    return values, tuple(loads.tolist())
