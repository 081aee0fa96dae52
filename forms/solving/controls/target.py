# SPDX-License-Identifier: MIT
"""Targets: a functional of u goes through given values, and a scalar is found along."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from petsc4py import PETSc

import numpy as np
import ufl

from ...compilation import compiled
from ...files.checkpoint import Saved
from ...paths import Convergence, Path
from ...quadrature import with_quadrature
from ...variation import residual
from ..border import Border, Values, by_constant
from ..corrector import Corrector
from ..newton import Newton
from ..pace import Pace
from .continuation import Continuation

LEAST = 1e-4  # of the way to a target, below which a step ends the path


class Held:
    """The constraint functional(u, q) = aim."""

    def __init__(self, border: Border, functional: ufl.Form) -> None:
        self.border = border
        functional = with_quadrature(functional, border.problem.displacement_degree)
        self._g = compiled(functional)
        self._g_u = compiled(residual(functional, border.problem.u))
        slopes = [by_constant(functional, q) for q in border.q]
        self._g_q = [None if slope.empty() else compiled(slope) for slope in slopes]
        self.start = self.aim = self.measure()

    def measure(self) -> float:
        """The functional at the present state. Collective."""
        return self.border.integral(self._g)

    @property
    def scale(self) -> float:
        """What the functional's error is compared with."""
        return abs(self.aim) or abs(self.aim - self.start)

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

    The place is how far the functional has come, there and back included.

    Args:
        path: Path of the problem.
        newton: Its solver.
        border: With the scalar unknown.
        functional: What is prescribed.
        targets: Its values.
    """

    word, symbol = "control", "q"

    def __init__(
        self,
        path: Path,
        newton: Newton,
        border: Border,
        functional: ufl.Form,
        targets: Sequence[float],
    ) -> None:
        self._held = held = Held(border, functional)
        border.constraints = [held]
        self.targets = [float(target) for target in targets]
        ends = np.array([held.start, *self.targets])
        way = float(np.abs(np.diff(ends)).sum()) or 1.0
        pace = Pace(way, 0.0, settings=newton.settings)
        q = border.q[0]
        self._border, self.total = border, float(len(self.targets))
        self._from, self._reached, self._started = held.start, 0.0, False
        super().__init__(path, newton, Corrector(newton, border), q, pace, way, 1.0)

    @property
    def done(self) -> float:
        """Targets that are reached."""
        return float(len(self.path.steps))

    @property
    def _target(self) -> float:
        return self.targets[len(self.path.steps)]

    @property
    def ended(self) -> str:
        """Whether all targets are reached, in words."""
        count = len(self.path.steps)
        return f"All {count} targets reached" if count == len(self.targets) else ""

    def next_place(self) -> float:
        """The target, or so far as the pace allows."""
        way = abs(self._target - self._from)
        self.pace.least = LEAST * way
        left = self._reached + way - self.place
        step = self.pace.toward(left)
        return self._reached + way if step >= left else self.place + step

    def aim(self, goal: float) -> None:
        """Set the constraint."""
        way, done = self._target - self._from, goal - self._reached
        end = done >= abs(way) * (1 - 1e-12)
        self._held.aim = self._target if end else self._from + np.sign(way) * done

    def guess(self, load: float) -> None:
        """Start from the extrapolated scalar."""
        if self._order > 1:
            self.q.value = load

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
        if self._held.aim != target:
            return None
        turn = len(self.path.steps) + 1 < len(self.targets)
        ahead = self.targets[len(self.path.steps) + 1] - target if turn else 0.0
        if ahead * (target - self._from) < 0:
            del self._past[1:]  # the way leads back
        self._from, self._reached = target, self.place
        return taken[0], {"target": target}

    def ending(self, outcome: Convergence) -> tuple[str, str]:
        """What to say where no shorter step succeeds."""
        return (
            f"{self._why or outcome.sentence()}, on the way to {self._target:.6g} from "
            f"{self._from:.6g}. The last converged state is kept.",
            outcome.advice or "Give targets that lie closer.",
        )

    def memory(self) -> tuple[list[np.ndarray], dict[str, Any]]:
        """The last states, and where the functional was."""
        states, numbers = super().memory()
        ours = {"from": self._from, "reached": self._reached, "start": self._held.start}
        return states, {**numbers, **ours}

    def resume(self, saved: Saved) -> None:
        """Go on where a checkpoint holds the path. Collective."""
        done = [step.records["target"] for step in self.path.steps]
        if done != self.targets[: len(done)]:
            raise ValueError(
                f"the checkpoint's targets were {done}, these begin with "
                f"{self.targets[: len(done)]}: give each path a folder of its own."
            )
        numbers = saved.control
        self._from, self._reached = numbers["from"], numbers["reached"]
        self._held.start, self._started = numbers["start"], True
        super().resume(saved)
