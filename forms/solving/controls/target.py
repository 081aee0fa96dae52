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
from ..bordered import Bordered, by_constant

MAX_HALVINGS = 8


class Held:
    """The constraint functional(u, q) = aim."""

    def __init__(self, bordered: Bordered, functional: ufl.Form) -> None:
        self.bordered = bordered
        functional = with_quadrature(functional, bordered.degree)
        self._g = compiled(functional)
        self._g_u = compiled(residual(functional, bordered.problem.u))
        g_q = by_constant(functional, bordered.q)
        self._g_q = None if g_q.empty() else compiled(g_q)
        self.start = self.aim = self.measure()

    def measure(self) -> float:
        """The functional at the present state."""
        return self.bordered.integral(self._g)

    @property
    def scale(self) -> float:
        """What the functional's error is compared with."""
        return abs(self.aim) or abs(self.aim - self.start)

    def value(self) -> float:
        """Distance of the functional from its target. Collective."""
        return self.measure() - self.aim

    def gradient(self, g_u: PETSc.Vec) -> float:
        """Derivative by u, into a vector; by q. Collective."""
        self.bordered.assemble(self._g_u, g_u)
        return self.bordered.integral(self._g_q) if self._g_q is not None else 0.0


class Targets:
    """From target to target, each approached in halved steps where it fails.

    Args:
        path: Path of the problem.
        bordered: Its solver.
        functional: What is prescribed.
        targets: Its values.
    """

    word, symbol = "control", "q"
    total: float | None

    def __init__(
        self, path: Path, bordered: Bordered, functional: ufl.Form, targets: Sequence[float]
    ) -> None:
        self.path, self.bordered, self._held = path, bordered, Held(bordered, functional)
        self.targets, self.total = [float(target) for target in targets], float(len(targets))
        self.load = bordered.load
        self._reached, self._part, self._halvings = self._held.start, 1.0, 0
        self._before = path.u.x.array.copy()

    @property
    def done(self) -> float:
        """Targets that are reached."""
        return float(len(self.path.steps))

    @property
    def ended(self) -> str:
        """Whether all targets are reached, in words."""
        count = len(self.path.steps)
        return f"All {count} targets reached" if count == len(self.targets) else ""

    def begin(self) -> None:
        """Measure the scales at the start, where a run that is taken up measures them, too."""
        self.bordered.scaled.measure()

    def propose(self) -> Convergence:
        """Solve for the next target, or for a part of the way to it. Collective."""
        target, held = self.targets[len(self.path.steps)], self._held
        held.aim = target
        if self._part < 1:
            held.aim = self._reached + self._part * (target - self._reached)
        return self.bordered.solve(held)

    def accept(self, outcome: Convergence) -> tuple[Convergence, dict[str, Any]] | None:
        """Take the state; a step where the target itself is reached."""
        target = self.targets[len(self.path.steps)]
        self._before, self.load = self.path.u.x.array.copy(), self.bordered.load
        self._reached, self._part = self._held.aim, 1.0
        if self._reached != target:
            return None
        self._halvings = 0
        return outcome, {"target": target}

    def stepped(self) -> None:
        """The steps alone tell the end."""

    def refuse(self, outcome: Convergence) -> tuple[str, str]:
        """Halve the way to the target; what to say where that was done often enough."""
        self.restore()
        self._part, self._halvings = self._part / 2, self._halvings + 1
        if self._halvings <= MAX_HALVINGS:
            return "", ""
        return (
            f"{outcome.sentence()}, on the way to {self.targets[len(self.path.steps)]:.6g} from "
            f"{self._reached:.6g}. The last converged state is kept.",
            outcome.advice or "Give targets that lie closer.",
        )

    def restore(self) -> None:
        """Put the last converged state back."""
        self.path.u.x.array[:], self.bordered.q.value = self._before, self.load

    def memory(self) -> tuple[list[np.ndarray], dict[str, Any]]:
        """The last state, and what the functional was there and at the start."""
        numbers = {"reached": self._reached, "start": self._held.start, "q": self.load}
        return [self._before], {**numbers, "damping": self.bordered.memory()}

    def saved(self) -> None:
        """Nothing is kept that a run that is taken up would not have."""

    def resume(self, saved: Saved) -> None:
        """Go on where a checkpoint holds the path. Collective."""
        done = [step.records["target"] for step in self.path.steps]
        if done != self.targets[: len(done)]:
            raise ValueError(
                f"the checkpoint's targets were {done}, these begin with "
                f"{self.targets[: len(done)]}: give each path a folder of its own."
            )
        numbers = saved.control
        self._reached, self._held.start = numbers["reached"], numbers["start"]
        self._before, self.load = saved.states[0], numbers["q"]
        self.bordered.recall(numbers["damping"])
        self.restore()

    def release(self, sound: bool) -> None:
        """Free the solver. Collective."""
        self.bordered.destroy()
