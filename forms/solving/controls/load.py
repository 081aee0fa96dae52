# SPDX-License-Identifier: MIT
"""Load steps: the load factor goes its way, and the path of equilibria with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from dolfinx import fem

from ...files.checkpoint import Saved
from ...ledger import JUMP, KINK, ORDINARY, START, Balance
from ...paths import Convergence, Event, Path
from ...programs import kinks
from ..accounts import Accounts
from ..certificates import certified_volume, crossing
from ..corrector import Corrector
from ..extrapolation import State, through
from ..newton import Newton
from ..pace import Pace
from ..settings import Settings
from .between import AHEAD, Gap, Reader, gaps, joined
from .continuation import Continuation

PIECES = 4  # steps of a smooth piece, at least
AROUND = 2  # states on either side of a step that one within is interpolated from
LEAST = 1e-4  # of the way, below which a step ends the path


class End(NamedTuple):
    """End of a piece of the way: its place, load factor, direction; whether loads bend there."""

    place: float
    load: float
    direction: float
    kink: bool


class LoadSteps(Continuation):
    """From load to load; the place is how far the load factor has come.

    Out of a singular start, as a flat sheet's, and over a jump on purpose the energy is minimized
    (:class:`forms.solving.newton.Newton`), and such a step is a row of its own in the ledger.

    Args:
        path: Path of the problem.
        newton: Its solver.
        t: Load factor.
        to: Where it goes, one value after the other.
        pace: Lengths of the steps.
        jump: Whether the path goes on where no equilibrium is connected.
    """

    def __init__(
        self,
        path: Path,
        newton: Newton,
        t: fem.Constant,
        to: Sequence[float],
        pace: Pace,
        jump: bool,
    ) -> None:
        self._begin, self._jump = float(t.value), jump
        self._ends = _ends(self._begin, to, kinks(path.problem, t))
        way = self._ends[-1].place
        super().__init__(path, newton, Corrector(newton), [t], pace, way, way)
        self._first, self._kind, self._singular = pace.ahead, ORDINARY, True

    @property
    def done(self) -> float:
        """Share of the way that is done."""
        return min(self.place / self.way, 1.0)

    @property
    def ended(self) -> str:
        """Whether the last load is reached, in words."""
        reached = f"Load factor {self.load:.6g} reached in {len(self.path.steps)} steps"
        return reached if self.place == self.way else ""

    def _next_end(self) -> End:
        """The end of the piece of the way that is walked on."""
        return next((end for end in self._ends if end.place > self.place), self._ends[-1])

    @property
    def direction(self) -> float:
        """Whether the load factor grows or falls, 1 or -1."""
        return self._next_end().direction

    def begin(self) -> None:
        """Measure the scales, and the forces that the first load makes. Collective."""
        super().begin()
        self.aim(self.pace.toward(self.way))
        b = self.path.problem.create_vector()
        self.newton.tangent.scaled.residual(b)
        self.level = float(b.norm())
        b.destroy()
        self.restore()

    def next_place(self) -> float:
        """So far as the pace allows, or the end of a piece exactly."""
        end = self._next_end().place
        left = end - self.place
        step = self.pace.toward(left)
        return end if step >= left else self.place + step

    def aim(self, goal: float) -> None:
        """Set the load factor, and the supports' values. Collective."""
        place, load = 0.0, self._begin
        for end in self._ends:
            if goal < end.place:
                load += end.direction * (goal - place)
                break
            place, load = end.place, end.load
        self.q[0].value = load
        for support in self.path.problem.supports:
            support.update()

    def propose(self) -> Convergence:
        """Solve at the next load, from the extrapolated state. Collective."""
        if self._kind == ORDINARY:
            outcome = super().propose()
            if outcome.converged or not (self.corrector.singular and self._singular):
                return outcome
            self.restore()
            if self.is_unheld():
                return outcome
            self._kind = START
        self._goal, self._why = self.next_place(), ""
        self.aim(self._goal)
        self.newton.predict()
        return self.newton.solve()

    def accept(self, outcome: Convergence) -> tuple[Convergence, dict[str, Any]] | None:
        """Certify a state; one that minimizes the energy is a row of its own. Collective."""
        if self._kind == ORDINARY:
            taken = super().accept(outcome)
            if taken is not None:
                self._singular = False
                if any(end.kink and end.place == self.place for end in self._ends[:-1]):
                    del self._past[1:]  # what comes is no continuation of this curve
                    # The ledger integrates over each smooth piece by itself.
                    piece = self._next_end().place - self.place
                    self.pace.ahead = min(self.pace.ahead, piece / PIECES)
                    self._read_behind()
            return taken
        kind, self._kind = self._kind, ORDINARY
        self._singular = kind == START
        if self._accounts is not None:
            self._reading = self._accounts.read(self._goal, self.direction, self.side())
        before, self.count = self.count, outcome.negative
        if self.count is None and self.path.problem.symmetric:
            self.count = self.corrector.refactor()
        self.bounds = certified_volume(self.path.problem)
        state = self.here(self._goal)
        known = self.path.balances
        self.take(state, outcome, kind)
        if kind == JUMP:
            released = self.path.ledger[-1].unaccounted if len(known) > 1 else None
            self.path.events.append(Event(self.load, "jump", before, self.count, released))
        self.pace.ahead = self.pace.step
        return replace(outcome, tangents=self.spent()), {}

    def take(self, state: State, outcome: Convergence, kind: str = ORDINARY) -> None:
        """Remember a state, and see to the account of the steps behind."""
        super().take(state, outcome, kind)
        if kind == ORDINARY:
            self._close_gaps()

    def _close_gaps(self) -> None:
        """Solve for a state within each step whose account misses too much. Collective.

        It lies on the curve through the states around, and nothing but the ledger knows of it: the
        path is the same without. Terms that remember where they were cannot go back, and virtual
        works are integrated along their own states.
        """
        problem, accounts = self.path.problem, self._accounts
        if accounts is None or accounts.by_forces or problem.history():
            return
        ended = any(
            end.place == self.place for end in self._ends if end.kink or end is self._ends[-1]
        )
        ahead, count = (0, AHEAD + 1) if ended else (AHEAD, 1)
        states, tried = list(self._past), set[float]()
        while self._closes_gap(accounts, states, tried, ahead, count):
            count = self.settings.remembered  # the polynomials of the steps around are new

    def _closes_gap(
        self, accounts: Accounts, states: list[State], tried: set[float], ahead: int, count: int
    ) -> bool:
        """Whether a state within one of the last steps was of use to its account. Collective."""
        known = self.path.balances
        length = len(known)
        for gap in gaps(known, self.path.floor, ahead, count):
            places = [state.place for state in states]
            if gap.begin.place not in places or gap.middle in tried:
                continue
            tried.add(gap.middle)
            at = places.index(gap.begin.place)
            reading = self._read_within(accounts, gap, states, at)
            found = known if reading is None else joined(known, gap, reading)
            if len(found) > len(known):
                known[:] = found
                states.insert(at, self.here(gap.middle))
            self.put(self._past[0])
        return len(known) > length

    def _read_within(
        self, accounts: Accounts, gap: Gap, states: Sequence[State], at: int
    ) -> Balance | None:
        """Solve for a state within a gap, as far as its account needs. Collective.

        What the path's next solve begins with, preconditioner and forces, is left as it was.

        Args:
            accounts: Accounts of the path.
            gap: The gap.
            states: Known states, the latest first.
            at: Number of the one at the gap's begin.

        Returns:
            What was read at it; None where it was not found.
        """
        criteria, kept = self.newton.criteria, self.newton.tangent.kept
        moved = self.newton.tangent.scaled.moved(states[at - 1].values, states[at].values)
        around = states[max(at - AROUND, 0) : at + AROUND]
        reader = Reader(accounts, gap, around, moved, self.settings.within)
        before = criteria.reactions
        self.aim(gap.middle)
        self.path.u.x.array[:] = through(around, gap.middle).values
        with kept.aside():
            solved = self.corrector.solve(self.level, enough=reader).converged
        criteria.reactions = before
        return reader.reading if solved else None

    def _read_behind(self) -> None:
        """Read the powers behind a kink. Collective."""
        if self._accounts is not None and self.path.balances:
            behind = self._accounts.read(self.place, self.direction, self.direction)
            self.path.balances.append(behind._replace(kind=KINK))
            self._accounts.cut()

    def side(self) -> float:
        """That from which the load comes, where it stops or turns."""
        return -self.direction if self._goal == self._next_end().place else 0.0

    def refuse(self, outcome: Convergence) -> tuple[str, str]:
        """Try a shorter step; from a singular start, or over a jump, minimize the energy."""
        if self._kind != ORDINARY:
            self.count_tangents()
            self.restore()
            if self.pace.refuse(np.inf, 2):
                return "", ""
            return self.ending(outcome)
        said = super().refuse(outcome)
        if not said[0] or (not self.path.steps and self.is_unheld()):
            return said
        if self._singular:
            self._kind, self.pace.ahead = START, self._first
            return "", ""
        if self._jump:
            self._kind = JUMP  # by little, so that the new branch does little work on the way
            self.pace.ahead = self.settings.critical * self.way
            return "", ""
        return said

    def ending(self, outcome: Convergence) -> tuple[str, str]:
        """What to say where no shorter step succeeds."""
        sentence, advice = super().ending(outcome)
        if self.path.problem.has_energy and not advice:
            advice = (
                "Go on with forms.arc_length, or to the next state at rest: forms.settle by damped "
                "motion, jump=True by minimizing the energy."
            )
        return sentence, advice

    def memory(self) -> tuple[list[np.ndarray], dict[str, Any]]:
        """The last states, the numbers, and the way."""
        states, numbers = super().memory()
        return states, {**numbers, "begin": self._begin, "singular": self._singular}

    def resume(self, saved: Saved) -> None:
        """Go on where a checkpoint holds the path; one of another way is refused. Collective."""
        numbers = saved.control
        if numbers["begin"] != self._begin:
            raise ValueError(
                f"the checkpoint's path began at load factor {numbers['begin']:.6g}, this one "
                f"begins at {self._begin:.6g}: give each path a folder of its own."
            )
        place, load = numbers["places"][0], numbers["loads"][0]
        self.aim(place)
        if place > self.way or abs(float(self.q[0].value) - load) > 1e-9 * self.way:
            way = ", ".join(f"{end.load:.6g}" for end in self._ends)
            raise ValueError(
                f"the checkpoint is at load factor {load:.6g}, which is not on the way from "
                f"{self._begin:.6g} to {way}: start anew, or go further."
            )
        super().resume(saved)
        self._singular = numbers["singular"]


def _ends(begin: float, to: Sequence[float], bends: Sequence[float]) -> list[End]:
    """Pieces of the way: between the values that it is to go to, and kinks of the loads."""
    ends, place, load = [], 0.0, begin
    for n, value in enumerate(to):
        direction = float(np.sign(value - load))
        between = sorted(b for b in bends if (b - load) * (value - b) > 0)
        for bend in between[:: int(direction)]:
            place, load = place + abs(bend - load), bend
            ends.append(End(place, load, direction, True))
        place, load = place + abs(value - load), value
        turns = n + 1 < len(to) and (to[n + 1] - value) * direction < 0
        ends.append(End(place, load, direction, turns or value in bends))
    return ends


def pace_of(
    way: float,
    step: float | None,
    least: float | None,
    most: float | None,
    settings: Settings,
) -> Pace:
    """Lengths of load steps with their defaults; refuses lengths that are not positive."""
    most = np.inf if most is None else most
    first = min(way / 10, most) if step is None else step
    least = way * LEAST if least is None else least
    if not (np.isfinite(way) and min(first, least, most) > 0):
        raise ValueError(
            f"load steps must be positive and the way finite, got step = {first}, min_step = "
            f"{least}, max_step = {most} over a way of {way}."
        )
    return Pace(first, min(least, first), max(most, first), settings)


def attempt(newton: Newton) -> Convergence:
    """One Newton solve at the present load, boundary values carried along first. Collective.

    A state in which surfaces cross is none, whatever way led there.
    """
    for support in newton.problem.supports:
        support.update()
    newton.predict()
    outcome = newton.solve()
    crossed = crossing(newton.problem) if outcome.converged else ""
    return replace(outcome, converged=False, reason=crossed) if crossed else outcome
