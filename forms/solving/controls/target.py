# SPDX-License-Identifier: MIT
"""Targets: functionals of u go through given values, and as many scalars are found along."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from petsc4py import PETSc

import numpy as np
import ufl

from ...compilation import compiled
from ...files.checkpoint import Saved
from ...ledger import KINK
from ...paths import Convergence, Path
from ...quadrature import with_quadrature
from ...variation import residual
from ..border import Border, Values, by_constant
from ..corrector import Corrector
from ..extrapolation import State
from ..newton import Newton
from ..pace import Pace
from .continuation import Continuation

LEAST = 1e-4  # of the way to a target, below which a step ends the path
STILL = 1e-6  # of a functional's size, below which its range is what tolerances have left
BEND = 0.3  # change of the way's direction, from which on targets are a corner and no curve


class Held:
    """The constraint functional(u, q) = aim.

    Attributes:
        start: The functional at the start of the path.
        aim: Its present value asked for.
        span: How far it goes, among several; 0 of one alone.
    """

    def __init__(self, border: Border, functional: ufl.Form) -> None:
        self.border = border
        functional = with_quadrature(functional, border.problem.displacement_degree)
        self._g = compiled(functional)
        self._g_u = compiled(residual(functional, border.problem.u))
        slopes = [by_constant(functional, q) for q in border.q]
        self._g_q = [None if slope.empty() else compiled(slope) for slope in slopes]
        self.start = self.aim = self.measure()
        self.span = 0.0

    def measure(self) -> float:
        """The functional at the present state. Collective."""
        return self.border.integral(self._g)

    @property
    def scale(self) -> float:
        """What the functional's error is compared with."""
        return max(abs(self.aim), self.span) or abs(self.aim - self.start)

    def reach(self) -> float:
        """How far the functional would go if all moved by the body's size. Collective."""
        border = self.border
        g_u = border.problem.create_vector()
        border.assemble(self._g_u, g_u)
        found = float(g_u.norm(PETSc.NormType.NORM_1)) * border.tangent.scaled.size
        g_u.destroy()
        return found

    def value(self) -> float:
        """Distance of the functional from its target. Collective."""
        return self.measure() - self.aim

    def gradient(self, g_u: PETSc.Vec) -> Values:
        """Derivative by u, into a vector; by each q. Collective."""
        self.border.assemble(self._g_u, g_u)
        slopes = [0.0 if form is None else self.border.integral(form) for form in self._g_q]
        return np.array(slopes)


class Targets(Continuation):
    """From target to target, over states in between where one step is too long.

    The place is how far the functional has come, there and back included. Several go together,
    along straight lines; the place is then how far the one has come that goes farthest, each over
    the range of its values. Where the lines turn by little they follow a curve, along which the
    path is extrapolated and its work integrated; at a corner both begin anew.

    Args:
        path: Path of the problem.
        newton: Its solver.
        border: With the scalar unknowns.
        functionals: What is prescribed, as many.
        targets: Their values, shape (targets, functionals).
    """

    word, symbol = "control", "q"

    def __init__(
        self,
        path: Path,
        newton: Newton,
        border: Border,
        functionals: Sequence[ufl.Form],
        targets: Values,
    ) -> None:
        self._held = [Held(border, functional) for functional in functionals]
        border.constraints = [*self._held]
        self.targets, self._from = targets, np.array([held.start for held in self._held])
        ends = np.array([self._from, *targets])
        self._ranges: Values = np.ones(len(self._held))
        if len(self._held) > 1:
            border.check()
            self._measure(ends)
        way = float(sum(map(self._length, np.diff(ends, axis=0)))) or 1.0
        pace = Pace(way, 0.0, settings=newton.settings)
        self._border, self.total = border, float(len(targets))
        self._reached, self._started = 0.0, False
        super().__init__(path, newton, Corrector(newton, border), border.q, pace, way, 1.0)

    def _measure(self, ends: Values) -> None:
        """Find how far each of several functionals goes, and which stand still. Collective."""
        spans, sizes = np.ptp(ends, axis=0), np.abs(ends).max(axis=0)
        reaches = np.array([held.reach() for held in self._held])
        moving = spans > STILL * np.maximum(sizes, reaches)
        if not moving.any():
            moving = spans > 0
        self._ranges = np.where(moving, spans, np.inf)
        at_zero = ~moving & (sizes <= STILL * reaches)
        for held, span in zip(self._held, np.where(at_zero, reaches, spans), strict=True):
            held.span = float(span)

    def _length(self, change: Values) -> float:
        """How far the functionals go by a change of theirs."""
        return float(np.abs(change / self._ranges).max())

    @property
    def done(self) -> float:
        """Targets that are reached."""
        return float(len(self.path.steps))

    @property
    def _target(self) -> Values:
        return self.targets[len(self.path.steps)]

    @property
    def ended(self) -> str:
        """Whether all targets are reached, in words."""
        count = len(self.path.steps)
        return f"All {count} targets reached" if count == len(self.targets) else ""

    def next_place(self) -> float:
        """The target, or so far as the pace allows."""
        way = self._length(self._target - self._from)
        self.pace.least = LEAST * way
        left = self._reached + way - self.place
        step = self.pace.toward(left)
        return self._reached + way if step >= left else self.place + step

    def aim(self, goal: float) -> None:
        """Set the constraints."""
        change, done = self._target - self._from, goal - self._reached
        way = self._length(change)
        end = done >= way * (1 - 1e-12)
        aims = self._target if end else self._from + change / way * done
        for held, aim in zip(self._held, aims, strict=True):
            held.aim = float(aim)

    def guess(self, state: State) -> None:
        """Start from the extrapolated scalars."""
        if self._order > 1:
            self.take_loads(state)

    def propose(self) -> Convergence:
        """Solve for the next target, or for a part of the way to it. Collective."""
        outcome = super().propose()
        if outcome.converged or self._started:
            return outcome
        # The first step may leave from a singular start, or from one that is not in equilibrium.
        self.restore()
        self._goal, self._order = self.next_place(), 2
        self.aim(self._goal)
        return self.corrector.solve(self.level, free=True)

    def accept(self, outcome: Convergence) -> tuple[Convergence, dict[str, Any]] | None:
        """Take the state; a step where the target itself is reached."""
        taken = super().accept(outcome)
        if taken is None:
            return None
        self._started = True
        target = self._target
        if np.any(np.array([held.aim for held in self._held]) != target):
            return None
        if self._turns():
            del self._past[1:]  # the way leads back, or elsewhere
            self._cut_account()
        self._from, self._reached = target, self.place
        notes = {"target": _plain(target)}
        if len(self.q) > 1:
            notes["q"] = list(self._past[0].loads)
        return taken[0], notes

    def _turns(self) -> bool:
        """Whether the way goes back, or round a corner, at the present target."""
        at = len(self.path.steps)
        if at + 1 == len(self.targets):
            return False
        legs = self._target - self._from, self.targets[at + 1] - self._target
        lengths = [self._length(leg) for leg in legs]
        if not min(lengths) > 0:
            return False
        before, after = (leg / n for leg, n in zip(legs, lengths, strict=True))
        return self._length(after - before) > BEND

    def _cut_account(self) -> None:
        """Have the ledger integrate what comes by itself: the scalars have a kink here."""
        if self._accounts is not None and self.path.balances:
            self.path.balances.append(self.path.balances[-1]._replace(kind=KINK, work=0.0))
            self._accounts.cut()

    def ending(self, outcome: Convergence) -> tuple[str, str]:
        """What to say where no shorter step succeeds."""
        return (
            f"{self._why or outcome.sentence()}, on the way to {_words(self._target)} from "
            f"{_words(self._from)}. The last converged state is kept.",
            outcome.advice or "Give targets that lie closer.",
        )

    def memory(self) -> tuple[list[np.ndarray], dict[str, Any]]:
        """The last states, and where the functional was."""
        states, numbers = super().memory()
        starts = np.array([held.start for held in self._held])
        ours = {"from": _plain(self._from), "reached": self._reached, "start": _plain(starts)}
        return states, {**numbers, **ours}

    def resume(self, saved: Saved) -> None:
        """Go on where a checkpoint holds the path. Collective."""
        done = [step.records["target"] for step in self.path.steps]
        ours = [_plain(target) for target in self.targets[: len(done)]]
        if done != ours:
            raise ValueError(
                f"the checkpoint's targets were {done}, these begin with {ours}: give each path a "
                "folder of its own."
            )
        numbers = saved.control
        self._from, self._reached = np.atleast_1d(numbers["from"]), numbers["reached"]
        for held, start in zip(self._held, np.atleast_1d(numbers["start"]), strict=True):
            held.start = float(start)
        self._started = True
        super().resume(saved)


def _plain(values: Values) -> Any:
    """One number, or a list."""
    return values.tolist() if len(values) > 1 else float(values[0])


def _words(values: Values) -> str:
    told = ", ".join(f"{value:.6g}" for value in values)
    return f"({told})" if len(values) > 1 else told
