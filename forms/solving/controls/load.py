# SPDX-License-Identifier: MIT
"""Load steps: the load factor goes to its last value, in steps halved where one fails."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from dolfinx import fem

from ...files.checkpoint import Saved
from ...paths import Convergence, Path
from ...problems import Problem
from ..newton import Newton
from ..reuse import release


@dataclass
class Walk:
    """Lengths of load steps: halved on failure, grown by half after an easy step."""

    begin: float
    end: float
    ahead: float
    least: float
    most: float
    done: float = 0.0

    @classmethod
    def start(
        cls, begin: float, end: float, step: float | None, least: float | None, most: float | None
    ) -> Walk:
        """Steps with their defaults; refuses lengths that are not positive."""
        way = abs(end - begin)
        if way == 0:
            raise ValueError(f"the load factor is at {end} already: use solve, or another to=.")
        first = way / 10 if step is None else step
        least = way / 1000 if least is None else least
        most = 2 * first if most is None else most
        if not (np.isfinite(way) and min(first, least, most) > 0):
            raise ValueError(
                f"load steps must be positive and the way finite, got step = {first}, min_step = "
                f"{least}, max_step = {most} from {begin} to {end}."
            )
        return cls(begin, end, first, min(least, first), max(most, first))

    @property
    def finished(self) -> bool:
        """Whether the way is done."""
        return self.done >= abs(self.end - self.begin)

    @property
    def fraction(self) -> float:
        """Share of the way that is done."""
        return min(self.done / abs(self.end - self.begin), 1.0)

    def aim(self) -> float:
        """Load factor of the next step, the last one exactly."""
        left = abs(self.end - self.begin) - self.done
        # A remainder that is only rounding would become a step of its own.
        if left <= self.ahead * (1 + 1e-9):
            self.ahead = left
            return self.end
        return self.begin + np.sign(self.end - self.begin) * (self.done + self.ahead)

    def advance(self, easily: bool) -> None:
        """A step has converged."""
        self.done += self.ahead
        if easily:
            self.ahead = min(self.most, 1.5 * self.ahead)

    def halve(self) -> bool:
        """A step has failed; whether a smaller one may be tried."""
        self.ahead /= 2
        return self.ahead >= self.least

    def resume(self, saved: Mapping[str, float]) -> None:
        """Go on from the numbers of an earlier walk; refuses one of another way."""
        if saved["begin"] != self.begin:
            raise ValueError(
                f"the checkpoint's path began at load factor {saved['begin']:.6g}, this one begins "
                f"at {self.begin:.6g}: give each path a folder of its own."
            )
        way, done = self.end - self.begin, saved["done"] * np.sign(saved["end"] - self.begin)
        if not 0 < done / way <= 1 + 1e-9:
            raise ValueError(
                f"the checkpoint is at load factor {self.begin + done:.6g}, which is not on the "
                f"way from {self.begin:.6g} to {self.end:.6g}: start anew, or go further."
            )
        self.done, self.ahead = saved["done"], min(max(saved["ahead"], self.least), self.most)


class State(NamedTuple):
    """Values of the unknown, ghosts included, and how far along the way they belong."""

    values: np.ndarray
    done: float


class LoadSteps:
    """Newton's method from load to load, each state extrapolated from the last ones.

    Args:
        path: Path of the problem.
        newton: Its solver.
        t: Load factor.
        walk: Lengths of the steps.
        prefix: Prefix of PETSc's options, for advice.
    """

    word, symbol = "load", "t"
    total: float | None = 1.0

    def __init__(
        self, path: Path, newton: Newton, t: fem.Constant, walk: Walk, prefix: str
    ) -> None:
        self.path, self.newton, self.t, self.walk, self._prefix = path, newton, t, walk, prefix
        self.load = float(t.value)
        self._past = [State(path.u.x.array.copy(), walk.done)]

    @property
    def done(self) -> float:
        """Share of the way that is done."""
        return self.walk.fraction

    @property
    def ended(self) -> str:
        """Whether the last load is reached, in words."""
        reached = f"Load factor {self.load:.6g} reached in {len(self.path.steps)} steps"
        return reached if self.walk.finished else ""

    def begin(self) -> None:
        """The start need not be in equilibrium: the first step moves on from it."""

    def propose(self) -> Convergence:
        """Solve at the next load, from the extrapolated state. Collective."""
        self.t.value = self.walk.aim()
        place = self.walk.done + self.walk.ahead
        extrapolate(self.path.problem, self._past, place, self.newton.settings.bent)
        return attempt(self.newton)

    def accept(self, outcome: Convergence) -> tuple[Convergence, dict[str, Any]]:
        """Remember the state for the next ones."""
        settings = self.newton.settings
        self.load = float(self.t.value)
        place = self.walk.done + self.walk.ahead
        self._past = [State(self.path.u.x.array.copy(), place), *self._past]
        del self._past[settings.remembered :]
        self.walk.advance(outcome.iterations <= settings.easy)
        return outcome, {}

    def stepped(self) -> None:
        """The steps alone tell the end."""

    def refuse(self, outcome: Convergence) -> tuple[str, str]:
        """Halve the step; what to say where it is too short."""
        self.restore()
        if self.walk.halve():
            return "", ""
        return (
            f"{outcome.sentence()}, at load factor {self.load:.6g} even for a step of "
            f"{2 * self.walk.ahead:.3g}. The last converged state is kept.",
            outcome.advice
            or f"Try a smaller min_step; -{self._prefix}snes_monitor shows each iteration.",
        )

    def restore(self) -> None:
        """Put the last converged state back."""
        self.path.u.x.array[:] = self._past[0].values
        self.t.value = self.load

    def memory(self) -> tuple[list[np.ndarray], dict[str, Any]]:
        """The last states, and the lengths of the steps."""
        places = [state.done for state in self._past]
        numbers = {**vars(self.walk), "places": places, "newton": self.newton.tangent.memory()}
        return [state.values for state in self._past], numbers

    def saved(self) -> None:
        """The run that is taken up has no preconditioner either."""
        self.newton.tangent.kept.renew()

    def resume(self, saved: Saved) -> None:
        """Go on where a checkpoint holds the path. Collective."""
        first = replace(self.walk).aim()
        self.walk.resume(saved.control)
        if not self.walk.finished:
            # Newton takes its reference levels from the first step: it has to see that one again.
            self.t.value = first
            _predict(self.newton)
            self.newton.recall(saved.control["newton"])
            self.newton.tangent.kept.renew()
        self.load = self.path.load
        places = saved.control["places"]
        self._past = [State(*s) for s in zip(saved.states, places, strict=True)]
        self.restore()

    def release(self, sound: bool) -> None:
        """Give the solver back. Collective."""
        release(self.newton, sound)


def attempt(newton: Newton) -> Convergence:
    """One Newton solve at the present load, boundary values carried along first. Collective."""
    _predict(newton)
    return newton.solve()


def _predict(newton: Newton) -> None:
    for support in newton.problem.supports:
        support.update()
    newton.predict()


def extrapolate(problem: Problem, past: Sequence[State], to: float, bent: float) -> None:
    """Move u on along the curve through the last states, if the energy stays finite there.

    Along the parabola through three of them where it bends little, else along the line through two.
    """
    u, last = problem.u.x.array, past[0].values
    guesses = [_through(past[:count], to) for count in range(2, len(past) + 1)]
    if len(guesses) == 2:
        line, curve = guesses
        dofmap = problem.u.function_space.dofmap
        owned = slice(dofmap.index_map.size_local * dofmap.bs)
        squares = [float(d @ d) for d in ((curve - line)[owned], (line - last)[owned])]
        bend, way = problem.comm.allreduce(np.array(squares))
        if bend > bent**2 * way:
            guesses.pop()
    for guess in reversed(guesses):
        u[:] = guess
        if not problem.has_energy or np.isfinite(problem.energy()):
            return
    u[:] = last


def _through(states: Sequence[State], to: float) -> np.ndarray:
    """Value at a place of the polynomial through states (Lagrange)."""
    places = [s.done for s in states]
    result = np.zeros_like(states[0].values)
    for state in states:
        others = [place for place in places if place != state.done]
        weight = np.prod([(to - place) / (state.done - place) for place in others])
        result += weight * state.values
    return result
