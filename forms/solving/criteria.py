# SPDX-License-Identifier: MIT
"""When Newton's method has converged: forces against a force level, corrections against a size."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from petsc4py import PETSc

import numpy as np

from .scaling import Scaled


class Level(NamedTuple):
    """Norm of the out-of-balance forces, and the force that it is compared with [N]."""

    residual: float
    force: float


class Criteria:
    """|R_free| <= rtol * force level, and max |du| <= ctol * model size.

    R_free are the out-of-balance forces where nothing is prescribed. The force level is the larger
    of the reactions' norm and of the imbalance that the load increment made; its floor is the
    rounding error of the forces. du is the last correction, or with iterative linear solves the
    next one to be expected.

    Args:
        scaled: The problem in one unit.
        rtol: Tolerance of the residual relative to the force level.
        ctol: Tolerance of the correction relative to the model's size.
        atol: Absolute tolerance of the residual [N].

    Attributes:
        reactions: Norm of the forces at supports at the last residual [N].
        imbalance: |R_free| before u moved [N]; None where it is not measured.
        correction: Largest last change of a displacement [m].
        last: The last level.
        goal: Norm of the forces at which the residual is small [N].
        watcher: Called with a residual's norm and the goal at each iteration; None for nobody.
    """

    def __init__(self, scaled: Scaled, rtol: float, ctol: float, atol: float) -> None:
        self.scaled, self.rtol, self.ctol, self.atol = scaled, rtol, ctol, atol
        self.watcher: Callable[[float, float], None] | None = None
        self.begin()

    def begin(self) -> None:
        """Forget the last solve."""
        self.reactions, self.correction, self.goal = 0.0, np.inf, 0.0
        self.imbalance: float | None = None
        self.last = Level(np.inf, 0.0)
        self._floor = 0.0

    @property
    def start(self) -> float:
        """Force that the load increment made, or else the reactions' [N]."""
        return self.imbalance or self.reactions

    @property
    def force(self) -> float:
        """Force level [N]."""
        return max(self.reactions, self.imbalance or 0.0)

    def corrected(self, x: PETSc.Vec, before: PETSc.Vec) -> None:
        """Take note of the last correction. Collective."""
        self.correction = self.scaled.correction(x, before)

    def take(self, norm: float) -> None:
        """Take note of a residual's norm. Collective."""
        self.last, self._floor = Level(norm, self.force), self.scaled.floor()
        self.goal = max(self.rtol * self.force, self.atol, self._floor)
        if self.watcher is not None:
            self.watcher(norm, self.goal)

    def hold(self, before: Level, first: bool, iterative: bool) -> bool:
        """Whether both tolerances are reached.

        Args:
            before: Level of the iteration before.
            first: Whether no correction has been made, and none is needed.
            iterative: With iterative solves the next correction is smaller than the last one as
                the forces are; with a factorization it takes one step to see how much smaller.
        """
        ratio = min(1.0, self.last.residual / before.residual) if iterative else 1.0
        settled = first or self.correction * ratio <= self.ctol * self.scaled.size
        return self.last.residual <= self.goal and settled

    def reached(self) -> str:
        """What was reached, in words."""
        if self.last.residual > self.goal:
            return "corrections vanish, the forces are at their rounding"
        if self.last.residual > max(self.rtol * self.last.force, self._floor):
            return f"snes_atol = {self.atol:g} reached"
        return "both tolerances reached"
