# SPDX-License-Identifier: MIT
"""Lengths of steps along a path, from the contraction of Newton's method."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .settings import Settings

ROUNDED = 1 + 1e-9  # a remainder that is only rounding would become a step of its own


@dataclass
class Pace:
    """The next step: as long as its first contraction is to be.

    s <- s (aim / theta)^(1/p), p the order of the extrapolation, as the first correction over which
    theta is the contraction is the extrapolation's error, and goes with s^p.

    Attributes:
        ahead: Next step.
        least: Step below which the path ends.
        most: Largest step.
        calm: Whether the last step was refused, after which the next one does not grow.
        step: Step in question.
    """

    ahead: float
    least: float
    most: float = np.inf
    settings: Settings = field(default_factory=Settings, repr=False)
    calm: bool = False
    step: float = 0.0

    def toward(self, left: float) -> float:
        """Length of the next step where so much is left: no small rest remains."""
        self.step = min(self.ahead, self.most)
        if left <= min(1.2 * self.step, self.most) * ROUNDED:
            self.step = left
        elif left < 2 * self.step:
            self.step = left / 2
        return self.step

    def accept(self, theta: float, order: int) -> None:
        """A step of some contraction was taken."""
        settings = self.settings
        ratio = settings.grow
        if theta > 0:
            ratio = min(max((settings.aim / theta) ** (1 / order), 0.3), settings.grow)
        longer = self.step * (min(ratio, 1.0) if self.calm else ratio)
        cut = self.step < self.ahead and ratio >= 1  # by the end of the way, not by a contraction
        self.ahead = max(longer, self.ahead) if cut else longer
        self.calm = False

    def refuse(self, theta: float, order: int) -> bool:
        """A step was refused; whether a smaller one may be tried."""
        least, most = self.settings.shrink
        ratio = (self.settings.aim / theta) ** (1 / order) if 0 < theta < np.inf else least
        self.ahead = self.step * min(max(ratio, least), most)
        self.calm = True
        return self.ahead >= self.least

    def memory(self) -> dict[str, Any]:
        """What a checkpoint has to keep."""
        return {"ahead": self.ahead, "calm": self.calm}

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Go on as an earlier one, within present limits."""
        self.ahead = min(max(memory["ahead"], self.least), self.most)
        self.calm = memory["calm"]
