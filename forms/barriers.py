# SPDX-License-Identifier: MIT
"""How far the points of a boundary may go before an obstacle: no step crosses one.

Positions move along straight lines within a step, obstacles with their Constants. A part of a way
is free where the distance's bounds over it (:mod:`forms.intervals`) are positive; ways are walked
part by part, halved where they are not, so that what lies between two states is seen as well.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from mpi4py import MPI

import numpy as np
from numpy.typing import NDArray

from .boundaries import points_on
from .obstacles import Obstacle, obstacles_in

Array = NDArray[np.float64]
KEPT = 0.1  # of a distance that no step may take
TOUCHING = 1e-6  # of dhat, below which a body counts as touching
NARROW = 0.02  # of a way found free, below which the next part is not halved further
SHORTEST = 2.0**-40  # of a way


class Clearance(NamedTuple):
    """Smallest distance from an obstacle at the points where it acts.

    Attributes:
        distance: In m, the gap included; negative beyond.
        place: Where, in the deformed body.
        obstacle: Its name; empty where there is none.
    """

    distance: float
    place: tuple[float, ...]
    obstacle: str

    def words(self) -> str:
        """Where and how much, in words."""
        beyond = (
            f"{-self.distance:.3g} beyond" if self.distance < 0 else f"{self.distance:.3g} from"
        )
        return f"at {_place(self.place)} the body is {beyond} the obstacle {self.obstacle}"


class Barrier:
    """One obstacle, at the points of its rule in this rank's facets.

    Args:
        label: The obstacle.
        integral: Of the potential, where it acts.
    """

    def __init__(self, label: Obstacle, integral: Any) -> None:
        self.label, self._bounds = label, label.bounds
        u, field = label.unknown, label.field
        self._u, dim = u, u.function_space.mesh.geometry.dim
        points = np.array(integral.metadata()["quadrature_points"], float)
        self._parts = points_on(u, field, label.measure, points)
        self._dim = dim
        self._last: tuple[Array, dict[Any, float]] = (np.empty((0, dim)), {})
        self.remember()

    @property
    def dofs(self) -> NDArray[np.int32]:
        """Local numbers of what moves the points, those of ghosts included."""
        return np.unique(np.concatenate([d.ravel() for *_, d in self._parts])).astype(np.int32)

    def places(self) -> Array:
        """Places of the points at u, shape (n, dim); local."""
        u = self._u.x.array
        return self._stacked([X + _moved(N, u, dofs) for X, N, dofs in self._parts])

    def ways(self, step: Array) -> Array:
        """Moves of the points by a step of the unknown, ghosts included; local."""
        return self._stacked([_moved(N, step, dofs) for _, N, dofs in self._parts])

    def _stacked(self, arrays: list[Array]) -> Array:
        return np.concatenate([a.reshape(-1, self._dim) for a in arrays])

    def remember(self) -> None:
        """Take the present state for the last accepted one; local."""
        values = {c: float(c.value) for c in self._bounds.constants if c.ufl_shape == ()}
        self._last = self.places(), values

    def clearance(self) -> Clearance:
        """Smallest distance at the present state; local."""
        x = self.places()
        if not len(x):
            return Clearance(np.inf, (), self.label.name)
        d = self._bounds(x, x)[0]
        worst = int(np.argmin(d))
        return Clearance(float(d[worst]), tuple(x[worst].tolist()), self.label.name)

    def acting(self) -> NDArray[np.int32]:
        """Local numbers, those of ghosts included, of what moves points within reach; local."""
        found, u = [np.empty(0, np.int32)], self._u.x.array
        for X, N, dofs in self._parts:
            x = (X + _moved(N, u, dofs)).reshape(-1, self._dim)
            if len(x):
                near = (self._bounds(x, x)[0] < self.reach).reshape(len(dofs), len(N))
                found.append(dofs[near.any(axis=1)].ravel())
        return np.unique(np.concatenate(found)).astype(np.int32)

    @property
    def reach(self) -> float:
        """Distance below which the obstacle acts [m]."""
        return float(self.label.reach.value)

    def largest_step(self, step: Array, moves: Mapping[Any, float]) -> float:
        """Fraction of a step, and of moves of Constants, that leaves KEPT of all distances."""
        x = self.places()
        start = {c: float(c.value) for c in moves if c in self._bounds.constants}
        found = _free(self._bounds, x, self.ways(step), start, moves, KEPT)
        return found[0]

    def crossed(self) -> tuple[float, ...]:
        """Where the straight way from the last accepted state meets the obstacle; local."""
        before, values = self._last
        moves = {c: float(c.value) - value for c, value in values.items()}
        x = self.places()
        fraction, point = _free(self._bounds, before, x - before, values, moves, 0.0)
        return () if fraction >= 1 else tuple(x[point].tolist())


def _place(x: tuple[float, ...]) -> str:
    return f"({', '.join(f'{0.0 if abs(one) < 1e-12 else one:.4g}' for one in x)})"


def _moved(N: Array, u: Array, dofs: NDArray[np.int32]) -> Array:
    return np.einsum("pk,fki->fpi", N, u[dofs])


def _free(
    bounds: Any,
    x: Array,
    dx: Array,
    start: Mapping[Any, float],
    moves: Mapping[Any, float],
    kept: float,
) -> tuple[float, int]:
    """Largest fraction of straight ways, alike for all points, that keeps part of all distances.

    Args:
        bounds: Of the distance.
        x: Where the points are.
        dx: Where to, from there.
        start: Constants there.
        moves: How far they go.
        kept: Part of its distance that no point loses.

    Returns:
        Fraction, and the number of the point that sets it, -1 for none. A way that is not finite,
        as a singular tangent gives one, is not gone at all.
    """
    lost = np.flatnonzero(~np.isfinite(dx).all(axis=1))
    if len(lost):
        return 0.0, int(lost[0])
    moving = {c: (value, moves[c]) for c, value in start.items() if moves.get(c)}
    least = kept * bounds(x, x, {c: (v, v) for c, (v, _) in moving.items()})[0]
    done, part = np.zeros(len(x)), np.ones(len(x))
    fraction, point = 1.0, -1
    active = np.arange(len(x))
    while len(active):
        a = done[active]
        b = np.minimum(a + part[active], fraction)
        ends = x[active] + a[:, None] * dx[active], x[active] + b[:, None] * dx[active]
        between = {
            c: tuple(sorted((v + a * m, v + b * m), key=_first)) for c, (v, m) in moving.items()
        }
        low = bounds(np.minimum(*ends), np.maximum(*ends), between)[0]
        free = low > least[active]
        done[active[free]] = b[free]
        part[active] *= np.where(free, 2.0, 0.5)
        stuck = ~free & (part[active] < np.maximum(NARROW * a, SHORTEST))
        if stuck.any():
            worst = active[stuck][np.argmin(done[active[stuck]])]
            if done[worst] < fraction:
                fraction, point = float(done[worst]), int(worst)
        active = active[(done[active] < fraction) & ~stuck]
    return fraction, point


def _first(value: Any) -> float:
    return float(np.sum(value))


class Barriers:
    """All obstacles of a potential.

    Args:
        potential: In UFL.
        comm: Communicator of the mesh.

    Attributes:
        all: The obstacles.
    """

    def __init__(self, potential: Any, comm: MPI.Comm) -> None:
        self._comm = comm
        self.all = [Barrier(label, integral) for label, _, integral in obstacles_in(potential)]

    def __bool__(self) -> bool:
        """Whether there are any."""
        return bool(self.all)

    def remember(self) -> None:
        """Take the present state for the last accepted one; local."""
        for barrier in self.all:
            barrier.remember()

    def largest_step(self, step: Array, moves: Mapping[Any, float]) -> float:
        """Fraction of a step, ghosts included, and of moves of Constants. Collective."""
        if not self.all:
            return 1.0
        own = min(barrier.largest_step(step, moves) for barrier in self.all)
        return self._comm.allreduce(own, MPI.MIN)

    def crossed(self) -> str:
        """What the straight way from the last accepted state crosses, in words. Collective."""
        if not self.all:
            return ""
        found = [(b.crossed(), b.label.name) for b in self.all]
        here = next(((name, at) for at, name in found if at), None)
        met = [one for one in self._comm.allgather(here) if one]
        if not met:
            return ""
        name, at = min(met)
        return f"the body would cross the obstacle {name} on its way to {_place(at)}"

    def clearance(self) -> Clearance:
        """Smallest distance from all, at the points where they act. Collective."""
        own = min(
            (b.clearance() for b in self.all), key=lambda c: c[0], default=Clearance(np.inf, (), "")
        )
        return min(self._comm.allgather(own), key=lambda c: (c.distance, c.place))

    def near(self) -> bool:
        """Whether any obstacle acts at the present state. Collective."""
        own = any(b.clearance().distance < b.reach for b in self.all)
        return bool(self.all) and bool(self._comm.allreduce(own, MPI.LOR))

    def acting(self) -> NDArray[np.int32]:
        """Local numbers, those of ghosts included, of what moves points within reach; local."""
        return np.concatenate([np.empty(0, np.int32), *(b.acting() for b in self.all)])

    def begin(self) -> None:
        """Take the present state for a start. Collective.

        Raises:
            ValueError: the body touches an obstacle there, or is beyond it.
        """
        found = self.clearance()
        reach = {b.label.name: b.reach for b in self.all}
        shift = {b.label.name: b.label.shift for b in self.all}
        if self.all and not found.distance > TOUCHING * reach[found.obstacle]:
            dhat, gap = reach[found.obstacle], shift[found.obstacle]
            more = dhat - found.distance
            needed = float(f"{(gap or 0.0) + more + 5e-4 * abs(more):.3e}")
            advice = f"gap={needed:.4g}" if gap is not None else f"a gap larger by {more:.4g}"
            raise ValueError(
                f"a path starts on the free side of obstacles, and {found.words()}: move one of "
                f"the two, or start with {advice}, which moves the obstacle's surface back."
            )
        self.remember()
