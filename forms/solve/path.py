# SPDX-License-Identifier: MIT
"""What a solve returns: its steps, how each went, what was recorded, and how it ended."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from dolfinx import fem

from ..assembly import System
from .convergence import Convergence, NotConverged
from .stability import instability
from .supported import free_motions


@dataclass(frozen=True)
class Step:
    """One converged load step: the load factor, how Newton went, what was recorded."""

    load: float
    convergence: Convergence
    records: dict[str, Any]


@dataclass(eq=False)
class Path:
    """Outcome of a solve: the unknown at the last converged load, and how it got there.

    Attributes:
        u: Unknown, holding the last converged state.
        system: Compiled system, for reactions and further solves.
        steps: Converged load steps in order.
        refused: Load steps that were tried and halved.
        reason: One sentence on why the path ended.
        completed: Whether the last load asked for was reached.
        seconds: Wall time of the path [s].
        resumed: Load of the checkpoint that the path was taken up from, if any.
        begin: Load factor that the path begins at.
    """

    u: fem.Function
    system: System
    steps: list[Step] = field(default_factory=list)
    refused: int = 0
    reason: str = ""
    completed: bool = False
    seconds: float = 0.0
    resumed: float | None = None
    begin: float = 0.0

    @property
    def load(self) -> float:
        """Last converged load factor; the first one while there is no step."""
        return self.steps[-1].load if self.steps else self.begin

    def record(self, name: str) -> np.ndarray:
        """A recorded quantity over the steps, shape (steps, ...)."""
        return np.array([step.records[name] for step in self.steps])

    def end(self, words: str) -> None:
        """Take note that the path is complete, and why it ended."""
        self.completed = True
        self.reason = (
            f"{words} ({self.refused} refused), "
            f"{sum(step.convergence.iterations for step in self.steps)} iterations."
            f"{instability(self.steps)}"
        )


def recorded(record: Mapping[str, Callable] | None, problem: System) -> dict[str, Any]:
    """Quantities to be kept with a step. Collective."""
    return {name: function(problem) for name, function in (record or {}).items()}


def check_record(record: Mapping[str, Any] | None) -> None:
    """Refuse records that are no functions."""
    for name, function in (record or {}).items():
        if not callable(function):
            raise ValueError(
                f"record needs functions of the system, got {type(function).__name__} for {name!r}."
            )


def failure(path: Path, sentence: str, advice: str = "") -> NotConverged:
    """Exception with the path so far, and advice. Collective.

    Where rigid motions are left that nothing holds, they are the cause, and named in place of the
    advice. Called with the unknown at the last converged state.
    """
    free = free_motions(path.system)
    if free:
        advice = (
            f"Nothing holds the body against {', '.join(free)}: add a support, a pin or a spring."
        )
    sentence = f"{sentence} {advice}".rstrip()
    path.reason = sentence
    error = NotConverged(sentence)
    error.path = path
    return error
