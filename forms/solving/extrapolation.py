# SPDX-License-Identifier: MIT
"""The curve through the last states of a path: extrapolated from, interpolated on."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..problems import Problem

CLOSE = 0.03  # spacing of states, over the way to go, below which their tolerances are magnified


class State(NamedTuple):
    """An equilibrium: values of the unknown, ghosts included, load factor, place on the path."""

    values: NDArray[np.float64]
    load: float
    place: float


def extrapolate(problem: Problem, past: Sequence[State], to: float) -> tuple[int, float]:
    """Move u on along the polynomial through the last states, as many as are of use. Collective.

    Where the energy is not finite there, fewer.

    Args:
        problem: Problem, whose unknown is moved.
        past: States, the latest first.
        to: Place.

    Returns:
        How many states were used, and the load factor of the polynomial.
    """
    states = [past[0]]
    for state in past[1:]:
        if abs(states[-1].place - state.place) >= CLOSE * abs(to - past[0].place):
            states.append(state)
    for count in range(len(states), 1, -1):
        values, load = through(states[:count], to)
        problem.u.x.array[:] = values
        if not problem.has_energy or np.isfinite(problem.energy()):
            return count, load
    problem.u.x.array[:] = past[0].values
    return 1, past[0].load


def through(states: Sequence[State], to: float) -> tuple[NDArray[np.float64], float]:
    """Values and load factor at a place of the polynomial through states (Lagrange)."""
    values, load = np.zeros_like(states[0].values), 0.0
    for state, weight in zip(states, _weights([s.place for s in states], to), strict=True):
        values += weight * state.values
        load += weight * state.load
    return values, float(load)


def slope(states: Sequence[State]) -> tuple[NDArray[np.float64], float]:
    """Derivatives by the place, at the first of the states, of the polynomial through all."""
    x = np.array([s.place for s in states])
    values, load = np.zeros_like(states[0].values), 0.0
    for j, state in enumerate(states):
        rest = [k for k in range(1, len(x)) if k != j]
        if j == 0:
            weight = np.sum(1 / (x[0] - x[1:]))
        else:
            weight = np.prod((x[0] - x[rest]) / (x[j] - x[rest])) / (x[j] - x[0])
        values += weight * state.values
        load += weight * state.load
    return values, float(load)


def _weights(places: Sequence[float], to: float) -> list[float]:
    x = np.array(places)
    others = [np.delete(x, j) for j in range(len(x))]
    return [float(np.prod((to - o) / (x[j] - o))) for j, o in enumerate(others)]
