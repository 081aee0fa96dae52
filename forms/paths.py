# SPDX-License-Identifier: MIT
"""What a solve returns: its steps, how each went, what was recorded, and how it ended."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite
from typing import Any

import numpy as np
from dolfinx import fem

from .problems import Problem

USUAL = {"full tangent", "|R|"}

REASONS = {
    3: "the energy cannot be lowered further",
    -1: "the energy is not finite at the start",
    -3: "the linear solver failed",
    -4: "the residual is not finite",
    -5: "the iterations were used up",
    -6: "the line search found no lower value",
    -8: "a local minimum of the residual was reached",
    -9: "the residual grew too large",
    -11: "the trust region became too small",
    -14: "the energy is not finite",  # a code later than PETSc 3.22
}


class NotConverged(RuntimeError):
    """A solve that did not reach its tolerances; the unknown holds the last converged state."""

    path: Any = None


@dataclass(frozen=True)
class Convergence:
    """How a Newton solve ended.

    Attributes:
        converged: Whether both tolerances were reached.
        reason: Why it stopped, in words.
        code: PETSc's SNESConvergedReason.
        iterations: Newton iterations.
        projected: Those of them that used the projected tangent.
        linear_iterations: Iterations of the linear solver in all.
        residual: Norm of the out-of-balance forces at free degrees of freedom [N].
        force_level: Force [N] that the residual is compared with.
        correction: Largest last change of a displacement component [m].
        residuals: Norm of the out-of-balance forces at the start and after each iteration [N].
        negative: Negative eigenvalues of the last tangent that was factorized, 0 where the state
            is stable; None where it is not known (multigrid, LU, projected, damped tangents).
        tried: Ways that were taken in turn, the last one to this end, as "full tangent", "|R|".
        advice: What to do where the cause is known; empty where it is not.
        solver: Whose iterations these are, in words.
    """

    converged: bool
    reason: str
    code: int
    iterations: int
    projected: int
    linear_iterations: int
    residual: float
    force_level: float
    correction: float
    residuals: tuple[float, ...] = ()
    negative: int | None = None
    tried: tuple[str, ...] = ()
    advice: str = ""
    solver: str = "SNES"

    def sentence(self) -> str:
        """One sentence: outcome, iterations, norms."""
        verb = "converged" if self.converged else "stopped"
        projected = f", {self.projected} of them projected" if self.projected else ""
        unusual = set(self.tried) - USUAL
        ways = f" by way of {', '.join(dict.fromkeys(self.tried))}" if unusual else ""
        # There is no last correction where no iteration was made.
        last = f", last correction {self.correction:.1e}" if isfinite(self.correction) else ""
        return (
            f"{self.solver} {verb} after {self.iterations} iterations{projected}{ways} "
            f"({self.reason}), |R| = {self.residual:.1e} at a force level of "
            f"{self.force_level:.1e}{last}"
        )


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
        problem: What was solved, for reactions and further solves.
        steps: Converged load steps in order.
        refused: Load steps that were tried and halved.
        reason: One sentence on why the path ended.
        completed: Whether the last load asked for was reached.
        seconds: Wall time of the path [s].
        resumed: Load of the checkpoint that the path was taken up from, if any.
        begin: Load factor that the path begins at.
    """

    u: fem.Function
    problem: Problem
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

    def __repr__(self) -> str:
        """How far it came, how, and what was recorded, in a few lines."""
        runs = [step.convergence for step in self.steps]
        recorded = sorted(self.steps[-1].records) if self.steps else []
        lines = [
            f"<Path of {self.u.name}, {self.problem.size} unknowns: load factor {self.begin:.6g} "
            f"to {self.load:.6g} in {len(self.steps)} steps ({self.refused} refused), "
            f"{sum(run.iterations for run in runs)} iterations, {self.seconds:.3g} s",
            f" {self.reason or 'Not at its end.'}",
            *([f" recorded: {', '.join(recorded)}"] if recorded else []),
        ]
        return "\n".join(lines) + ">"

    def take_up(self, steps: Sequence[Any], counts: Mapping[str, Any]) -> None:
        """Take the steps of an earlier run, whose path goes on."""
        self.steps += [Step(*step) for step in steps]
        self.refused, self.seconds = counts["refused"], counts["seconds"]
        self.resumed = self.load

    def end(self, words: str) -> None:
        """Take note that the path is complete, and why it ended."""
        self.completed = True
        self.reason = (
            f"{words} ({self.refused} refused), "
            f"{sum(step.convergence.iterations for step in self.steps)} iterations."
            f"{instability(self.steps)}"
        )


def recorded(record: Mapping[str, Callable] | None, problem: Problem) -> dict[str, Any]:
    """Quantities to be kept with a step. Collective."""
    return {name: function(problem) for name, function in (record or {}).items()}


def check_record(record: Mapping[str, Any] | None) -> None:
    """Refuse records that are no functions."""
    for name, function in (record or {}).items():
        if not callable(function):
            raise ValueError(
                f"record needs functions of the problem, got {type(function).__name__} for "
                f"{name!r}."
            )


def instability(steps: Sequence[Any]) -> str:
    """Where a path has become unstable, as a sentence; empty where it has not or is not known."""
    counts = [(s.load, s.convergence.negative) for s in steps]
    unstable = [load for load, negative in counts if negative]
    if not unstable:
        return ""
    most = max(negative for _, negative in counts if negative)
    word = "eigenvalue" if most == 1 else "eigenvalues"
    if len(counts) == 1:
        return f" Unstable: {most} negative {word}."
    return f" Unstable from load factor {unstable[0]:.6g} on ({most} negative {word} at most)."
