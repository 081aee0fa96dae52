# SPDX-License-Identifier: MIT
"""Whether a path stays on its branch: its stability is watched, what it passes is located."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from dolfinx import fem

from ...paths import Convergence, Event, Path
from ..corrector import Corrector
from ..critical import Critical
from ..extrapolation import State, slope, through
from ..newton import Newton

RATES = 4  # states whose load factors' slope is taken
GAP = 0.4  # distance of states from a bifurcation that is passed, over the critical step
BESIDE = 0.1  # the same over the step that it was found in afterwards
NOTHING: np.ndarray = np.empty(0)


class Branch:
    """States of a path by their places, and the number of negative eigenvalues along.

    Where the number changes within a step that is not short, the place is located by a secant on
    the eigenvalue that passes zero, and the path is led there: to a state just before and one just
    behind. On a smooth branch the eigenvalue is found to change there, and that is an event; where
    the state behind was on another branch it is not, and the path goes its own way.

    Args:
        path: Path of the problem.
        newton: Its solver.
        corrector: That of the path.
        q: Load factor, or the scalar unknowns in its place.
        way: Length of the whole way, or a measure of it.

    Attributes:
        count: Negative eigenvalues at the last state; None where they are not known.
        level: Force level [N] of the path.
    """

    def __init__(
        self,
        path: Path,
        newton: Newton,
        corrector: Corrector,
        q: Sequence[fem.Constant],
        way: float,
    ) -> None:
        self.path, self.newton, self.corrector, self.q = path, newton, corrector, tuple(q)
        self.way, self.settings, self.level = way, newton.settings, 0.0
        self.count: int | None = None
        self._critical = Critical(path.problem, corrector, self.move)
        self._past = [self.here(0.0)]
        self._goal, self._order = 0.0, 1
        self._gates: list[float] = []
        self._resumed_step = 0.0
        self._located = self._located_before = False

    @property
    def load(self) -> float:
        """Load factor of the last accepted state."""
        return self._past[0].load

    @property
    def place(self) -> float:
        """Place of the last accepted state."""
        return self._past[0].place

    def aim(self, goal: float) -> None:
        """Set load factor, supports or constraint for a place; to be written. Collective."""
        raise NotImplementedError

    def look_anew(self) -> None:
        """Another state is to be found."""
        self._located_before, self._located = self._located, False

    def pass_gates(self) -> float:
        """Forget the places that were to be gone through; the step before them, at the last."""
        while self._gates and abs(self._gates[0] - self.place) <= 1e-9 * self.way:
            self._gates.pop(0)
            if not self._gates:
                return self._resumed_step
        return 0.0

    def unlike(self, outcome: Convergence) -> str:
        """Whether the number of negative eigenvalues changes over a step too long. Collective."""
        count = outcome.negative
        stable = self.newton.tangent.stable_by_curvature()
        if stable is False:
            self.newton.leave_multigrid()
            count = self.corrector.refactor()
        elif stable:
            self.count, count = self.count or 0, 0
        if count is not None and self.count is not None and count != self.count:
            count = self.corrector.refactor()  # the factors may be of an iterate before
        before = self.count
        if before is None and self._order == 1:
            before = self.corrector.negative_at_start
            if count is not None:  # of a tangent at the start, perhaps
                count = self.corrector.refactor()
        if count is None or before is None or count == before or not self.path.problem.symmetric:
            self.count = count
            return ""
        here = self.here(self._goal)
        before = self._at_last_state(before)
        self.aim(self._goal)
        self.put(here)
        if count == before:
            self.count = count
            return ""
        step = abs(self._goal - self.place)
        states = [here, *self._past]
        if step > self.settings.critical * self.way and self._may_be_another_branch(states):
            why = f"negative eigenvalues {before} -> {count} within it"
            if self._located_before:  # not where it was told: halve the step
                self.put(here)
                return why
            place = self._critical.place(states, before, self.settings.critical * self.way / 8)
            gap = np.sign(self._goal - self.place) * GAP * self.settings.critical * self.way
            gates = [place - gap, place + gap]
            between = [g for g in gates if (g - self.place) * (self._goal - g) > 0]
            self._gates = [g for g in between if abs(g - self.place) > 0.1 * abs(gap)]
            self._resumed_step, self._located = step, bool(self._gates)
            self.put(here)
            return why
        place = self._critical.place(states, before, 1e-6 * self.way)
        self.path.events.append(self._event(states, place, before, count))
        self.put(here)
        self.count = count
        return ""

    def _at_last_state(self, told: int) -> int:
        """Negative eigenvalues at the last accepted state; another is of an event before it.

        What was told of it came from factors of an iterate, on whose other side the event may be.
        """
        if len(self._past) < 2 or not self.path.steps:
            return told
        self.put(self._past[0])
        found = self.corrector.refactor()
        if found is None or found == told:
            return told
        self.path.events.append(self._past_event(told, found))
        last = self.path.steps[-1]
        convergence = replace(last.convergence, negative=found)
        self.path.steps[-1] = replace(last, convergence=convergence)
        return found

    def _past_event(self, before: int, after: int) -> Event:
        """What lies between the last two accepted states, by one on either side of it, too."""
        states = list(self._past)
        high, low = states[0].place, states[1].place
        about = self._critical.place(states, before, 0.0, most=2)  # by the eigenvalues at both
        for place in (about - BESIDE * (high - low), about + BESIDE * (high - low)):
            if not (place - low) * (high - place) > 0:
                continue
            self.aim(place)
            self.move(through(states, place))
            if self.corrector.solve(self.level).converged:
                states.insert(2, self.here(place))  # the first two remain those between which it is
        place = self._critical.place(states, before, 1e-6 * self.way)
        return self._event(self._past, place, before, after)

    def _may_be_another_branch(self, states: Sequence[State]) -> bool:
        """Whether a change of the count calls for short steps: not where the load factor turns."""
        return self.path.problem.minimization and not self._turned(states)

    def _event(self, states: Sequence[State], place: float, before: int, after: int) -> Event:
        """A limit point where the load factor turns, else a bifurcation. Collective."""
        load = through(states, place).load
        if len(self.q) > 1:
            kind = "limit point" if self._folds(states) else "bifurcation"
            return Event(load, kind, before, after)
        found = self._turned(states) or (self.corrector.border is not None and self._folds(states))
        if abs(after - before) == 1 and found:
            return Event(self._extremum(states, place), "limit point", before, after)
        return Event(load, "bifurcation", before, after)

    def _turned(self, states: Sequence[State]) -> bool:
        """Whether the load factor has an extremum between the first two states.

        Of several scalars: whether a limit point lies there. Collective then.
        """
        if len(self.q) > 1:
            return self._folds(states)
        if len(states) < 3:
            return False
        loads = [state._replace(values=NOTHING) for state in states[:RATES]]
        before = slope([loads[1], loads[0], *loads[2:]]).load
        return before * slope(loads).load < 0

    def _folds(self, states: Sequence[State]) -> bool:
        """Whether K alone is singular between the first two states, and not the bordered tangent.

        No scalar need turn there. The Schur complement then passes infinity: as many of its
        eigenvalues change their sign as of K; at a bifurcation it is finite. Collective.
        """
        border, counts = self.corrector.border, []
        for state in states[:2]:
            self.put(state)
            count = self.corrector.refactor()
            turned = None if count is None or border is None else border.negative()
            if count is None or turned is None:
                return False
            counts.append((count, turned))
        (here, s_here), (before, s_before) = counts
        return abs(here - before) == abs(s_here - s_before)

    def _extremum(self, states: Sequence[State], place: float) -> float:
        """Load factor at which it turns between the first two states, solved for. Collective.

        Near the place where the curve through all turns, or else near a given one.
        """
        ends, rising = states[:2], len(states) > 2 and states[1].load > states[2].load
        turning = _turning_place(states, ends, rising)
        place = turning if _lies_within(turning, ends) else place
        if _lies_within(place, ends):
            self.aim(place)
            self.move(through(states, place))
            if self.corrector.solve(self.level).converged:
                here = self.here(place)
                states = sorted([here, *states], key=lambda state: -state.place)
                rising = here.load > (ends[0].load + ends[1].load) / 2
                place = _turning_place(states, ends, rising)
        return through(states, place).load

    def here(self, place: float) -> State:
        """The present state, at a place."""
        return State(self.path.u.x.array.copy(), tuple(float(c.value) for c in self.q), place)

    def move(self, state: State) -> None:
        """Set the unknown and the scalars to a state's; local."""
        self.path.u.x.array[:] = state.values
        self.take_loads(state)

    def take_loads(self, state: State) -> None:
        """Set the scalars to a state's; local."""
        for c, load in zip(self.q, state.loads, strict=True):
            c.value = load

    def put(self, state: State) -> None:
        """Take a state for the present one. Collective."""
        self.move(state)
        for support in self.path.problem.supports:
            support.update()


def _lies_within(place: float, ends: Sequence[State]) -> bool:
    """Whether a place is between two states, and not all but at one of them."""
    step = ends[0].place - ends[1].place
    return BESIDE / 10 < (place - ends[1].place) / step < 1 - BESIDE / 10


def _turning_place(states: Sequence[State], ends: Sequence[State], rising: bool) -> float:
    """Where, between two of the states, the curve through all has its largest or least load."""
    loads = [state._replace(values=NOTHING) for state in states]
    places = np.linspace(ends[1].place, ends[0].place, 4001)
    q = np.array([through(loads, place).load for place in places])
    return float(places[int(np.argmax(q if rising else -q))])
