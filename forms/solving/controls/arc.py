# SPDX-License-Identifier: MIT
"""Arc length: steps along the path, each returned to equilibrium in a plane across it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from petsc4py import PETSc

import numpy as np
from dolfinx import fem
from numpy.typing import NDArray

from ...files.checkpoint import Saved
from ...ledger import ORDINARY
from ...paths import Convergence, Path
from ...problems import Problem
from ..border import Border, Values
from ..corrector import Corrector
from ..extrapolation import State, slope, through
from ..newton import Newton
from ..pace import Pace
from ..supported import failure
from .continuation import Continuation

SHORTEST = 1e-6  # of the first step
TANGENT = 4  # states that the path's tangent is taken from
SHARPEST = 0.8  # cosine of the largest angle between the path's tangents at the ends of a step


class ArcLength(Continuation):
    """Steps of a length along the path, until a load, a number of steps or a condition.

    Args:
        path: Path of the problem.
        newton: Its solver.
        border: With the load factor.
        step: Change of q in the first step.
        to: Load factor at which the path ends; None for none.
        steps: Largest number of steps.
        until: Whether the path is at its end, told after each step.
        largest: Largest displacement of a step over the model's size.
        along: Direction in which the path is left, in place of that of growing q.
    """

    word, symbol = "arc length", "q"
    total: float | None = None

    def __init__(
        self,
        path: Path,
        newton: Newton,
        border: Border,
        step: float,
        to: float | None,
        steps: int,
        until: Callable[[Problem], bool] | None,
        largest: float,
        along: fem.Function | None,
    ) -> None:
        self._border, self._step, self._to = border, step, to
        self._steps, self._until, self._largest, self._along = steps, until, largest, along
        self.plane = Plane(border)
        self.ended, self.used_up = "", False
        pace = Pace(1.0, 0.0, settings=newton.settings)
        span = abs(step) if along is None else 1.0
        super().__init__(path, newton, Corrector(newton, border), border.q, pace, 1.0, span)

    @property
    def done(self) -> float:
        """Steps that were taken."""
        return float(len(self.path.steps))

    def _ending(self, count: int) -> str:
        if self._to is not None and self.load == self._to:
            return f"Load factor {self._to:.6g} reached in {count} steps"
        if self._until is not None and count and self._until(self.path.problem):
            return f"The end of the path reached in {count} steps"
        self.used_up = count >= self._steps
        return f"{self._steps} steps taken in {count} steps" if self.used_up else ""

    def begin(self) -> None:
        """Return to equilibrium where the start is not in it, and find the first tangent."""
        outcome = self._at_load(self.load)
        if not outcome.converged:
            self.restore()
            sentence = f"{outcome.sentence()}, at the start, q = {self.load:.6g}."
            raise failure(self.path, sentence, outcome.advice)
        self._past = [self._past[0]._replace(values=self.path.u.x.array.copy())]
        super().begin()
        first = self.plane.first(self._step, self._along, self.corrector)
        self.count = self.plane.negative
        size = self.newton.tangent.scaled.size
        self.pace.ahead, self.pace.least = first, SHORTEST * first
        self.way = size / self.plane.largest

    def _at_load(self, load: float) -> Convergence:
        """Correct the present state at a load factor. Collective."""
        plane = self._border.constraints
        self._border.constraints = [HeldLoad(self._border, load)]
        outcome = self.corrector.solve(self.level, free=True)
        self._border.constraints = plane
        return outcome

    def next_place(self) -> float:
        """A step ahead, not longer than the largest displacement allows."""
        self.pace.most = self._largest * self.newton.tangent.scaled.size / self.plane.largest
        return self.place + self.pace.toward(np.inf)

    def aim(self, goal: float) -> None:
        """Set the plane."""
        self._border.constraints = [self.plane]
        self.plane.length = goal - self.place

    def guess(self, state: State) -> None:
        """Start on the curve through the last states, or on the tangent at the only one."""
        self.take_loads(state)
        if self._order == 1:
            self.plane.leave()

    def length(self, here: State) -> float:
        """Length of the path up to a new state."""
        # The tangent's norm by the place, 1 at the last state, goes with the square of the way.
        length = (here.place - self.place) * (1 + (self.plane.stretch - 1) / 3)
        known = self.path.balances
        return (known[-1].place if known else 0.0) + length

    def refusal(self, outcome: Convergence) -> str:
        """Why a state is not the path's; where the path turns too far from the step, too."""
        cosine = self.plane.turn([self.here(self._goal), *self._past[: TANGENT - 1]])
        if cosine < SHARPEST and self.pace.step > 2 * self.pace.least:
            return f"the path turns by {np.degrees(np.arccos(max(cosine, -1.0))):.0f} degrees"
        return super().refusal(outcome)

    def take(self, state: State, outcome: Convergence, kind: str = ORDINARY) -> None:
        """Remember a state; solve for ``to`` exactly where it was passed."""
        to, load = self._to, self.load
        if to is not None and (load - to) * (state.load - to) <= 0:
            states = [state, *self._past]
            share = (to - load) / (state.load - load) if state.load != load else 1.0
            curve = through(states, self.place + share * (self._goal - self.place))
            found = self._exactly(curve.values, to)
            if found is not None:
                state = state._replace(values=found, loads=(to,))
        super().take(state, outcome, kind)
        self.plane.take()
        self._past = self.plane.placed(self._past)

    def _exactly(self, values: NDArray[np.float64], to: float) -> NDArray[np.float64] | None:
        self.path.u.x.array[:], self.q[0].value = values, to
        outcome = self._at_load(to)
        if not outcome.converged:
            raise failure(self.path, f"{outcome.sentence()}, at the load factor {to}.")
        self.q[0].value = to  # to the last digit, by which the end is known
        return self.path.u.x.array.copy()

    def stepped(self) -> None:
        """See whether the path is at its end."""
        self.ended = self._ending(len(self.path.steps))

    def ending(self, outcome: Convergence) -> tuple[str, str]:
        """What to say where no shorter step succeeds."""
        return (
            f"{self._why or outcome.sentence()}, at q = {self.load:.6g} even for a step of "
            f"{SHORTEST:g} of the first one. The last converged state is kept.",
            outcome.advice,
        )

    def memory(self) -> tuple[list[np.ndarray], dict[str, Any]]:
        """The last states and the path's tangent there, and the numbers."""
        states, numbers = super().memory()
        ours = {"slope": self.plane.slope, "way": self.way, "least": self.pace.least}
        return [*states, self.plane.direction()], {**numbers, **ours}

    def resume(self, saved: Saved) -> None:
        """Go on where a checkpoint holds the path. Collective."""
        numbers = saved.control
        direction = saved.states.pop()
        self.way, self.pace.least = numbers["way"], numbers["least"]
        super().resume(saved)
        self.plane.resume(direction, numbers["slope"])
        self.stepped()

    def release(self, sound: bool) -> None:
        """Free the solver. Collective."""
        self.plane.destroy()
        super().release(sound)


class Plane:
    """The constraint t . (y - y_n) = s in the scaled unknown, over its displacements."""

    def __init__(self, border: Border) -> None:
        self.border = border
        self.scaled = border.tangent.scaled
        b = border.problem.create_vector()
        self.t, self.base, self.y, self._earlier, self._next = (b.duplicate() for _ in range(5))
        b.destroy()
        self.slope, self.length, self.stretch, self.rate = 0.0, 0.0, 1.0, 0.0
        self._turned = False
        self.negative: int | None = None

    @property
    def scale(self) -> float:
        """What the distance from the plane is compared with."""
        return self.scaled.size

    def first(self, step: float, along: fem.Function | None, corrector: Corrector) -> float:
        """Set the first tangent; length of the first step."""
        border = self.border
        border.constraints = [self]
        self.negative = corrector.refactor()
        border.update(1.0, damped=True)
        if border.direction() is None:
            raise ValueError(
                "the tangent at the start could not be factorized: is the body held, and the "
                "energy's second derivative finite there?"
            )
        norm = self._take(border.y_q[0], -1.0)
        if norm == 0:
            raise ValueError("the load does not move the body: nothing to follow.")
        length, self.slope = abs(step) * norm, 1 / norm
        if along is not None:
            self._turn(along.x.array)
            length, self.slope = abs(step) / self.largest, 0.0
        if step < 0:
            self.t.scale(-1)
            self.slope *= -1
        self.take()
        return length

    def direction(self) -> NDArray[np.float64]:
        """The tangent as values of the unknown."""
        values = fem.Function(self.border.problem.u.function_space)
        values.x.petsc_vec.pointwiseMult(self.t, self.scaled.D)
        values.x.scatter_forward()
        return values.x.array

    def resume(self, direction: NDArray[np.float64], slope: float) -> None:
        """Take the tangent of an earlier path."""
        u, values = self.border.problem.u, self.border.problem.u.x.array.copy()
        u.x.array[:] = direction
        self.scaled.get(self.t)
        u.x.array[:] = values
        self.slope = slope
        self.take()

    def _turn(self, direction: NDArray[np.float64]) -> float:
        """Make t the unit vector of values of the unknown; their norm."""
        u = self.border.problem.u
        before = u.x.array.copy()
        u.x.array[:] = direction
        self.scaled.get(self.y)
        u.x.array[:] = before
        return self._take(self.y, 1.0)

    @property
    def largest(self) -> float:
        """Largest displacement component of t."""
        own = np.abs(self.t.array_r[self.scaled.displacements])
        return float(max(self.border.problem.comm.allgather(own.max(initial=0.0))))

    def leave(self) -> None:
        """Move along the tangent."""
        u = self.border.problem.u
        u.x.array[:] += self.length * self.direction()
        self.border.q[0].value = float(self.border.q[0].value) + self.length * self.slope

    def value(self) -> float:
        """Distance from the plane. Collective."""
        self.scaled.get(self.y)
        self.y.axpy(-1, self.base)
        return float(self.t.dot(self.y)) - self.length

    def gradient(self, g_u: PETSc.Vec) -> Values:
        """Its normal t, into a vector; nothing by q."""
        self.t.copy(g_u)
        return np.zeros(1)

    def turn(self, states: Sequence[State]) -> float:
        """Find the tangent at a new state; cosine of the angle with the last one."""
        self.t.copy(self._earlier)
        rates = slope(states)
        norm = self._turn(rates.values)
        self.stretch, self.rate = norm, rates.load / norm
        self.t.copy(self._next)
        self._turned = True
        cosine = float(self.t.dot(self._earlier))
        self._earlier.copy(self.t)
        return cosine

    def take(self) -> None:
        """Start the next step from the present state, along the tangent found there."""
        if self._turned:
            self._next.copy(self.t)
            self.slope, self._turned = self.rate, False
        self.scaled.get(self.base)

    def placed(self, states: Sequence[State]) -> list[State]:
        """States by their distance from the plane through the first one, as long as it grows.

        In this coordinate the path is as smooth as it is, whatever the lengths of steps were.
        """
        u, place, found = self.border.problem.u, states[0].place, [states[0]]
        for state in states[1:]:
            u.x.array[:] = state.values
            self.scaled.get(self.y)
            self.y.axpy(-1, self.base)
            there = place + float(self.t.dot(self.y))
            if there >= found[-1].place:
                break
            found.append(state._replace(place=there))
        u.x.array[:] = states[0].values
        return found

    def _take(self, direction: PETSc.Vec, sign: float) -> float:
        """Make t the unit vector of a direction's displacements; its norm."""
        direction.copy(self.t)
        self.t.array[self.scaled.others] = 0
        norm = float(self.t.norm())
        if norm > 0:
            self.t.scale(sign / norm)
        return norm

    def destroy(self) -> None:
        """Free the vectors."""
        for item in (self.t, self.base, self.y, self._earlier, self._next):
            item.destroy()


class HeldLoad:
    """The constraint q = to."""

    def __init__(self, border: Border, to: float) -> None:
        self.border, self.to, self.scale = border, to, abs(to) or 1.0

    def value(self) -> float:
        """Distance of q from its value."""
        return float(self.border.q[0].value) - self.to

    def gradient(self, g_u: PETSc.Vec) -> Values:
        """Nothing by u; 1 by q."""
        g_u.set(0)
        return np.ones(1)
