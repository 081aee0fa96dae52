# SPDX-License-Identifier: MIT
"""What a solve returns: its steps, how each went, what was recorded, and how it ended."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite
from typing import Any, NamedTuple

import numpy as np
import ufl
from dolfinx import fem

from .barriers import Clearance
from .ledger import START, Balance, Ledger, rows
from .problems import Problem
from .validity import Bounds

USUAL = {"full tangent", "|R|"}
ELEMENTS_OWN = (
    " Of the discrete element, perhaps: with a pressure it has instabilities of its own in "
    "compression; see on another mesh, or with Q2, whether they stay."
)
SHOWN = 3  # events in a sentence

REASONS = {
    3: "the energy cannot be lowered further",
    -1: "the energy is not finite at the start",
    -3: "the linear solver failed",
    -4: "the residual is not finite",
    -5: "the iterations were used up",
    -6: "the line search found no lower value",
    -8: "the descent of |R| crept",
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
            is stable; None where it is not known (LU, projected, damped tangents). With multigrid,
            in a path, 0 where CG has seen no negative curvature.
        tried: Ways that were taken in turn, the last one to this end, as "full tangent", "|R|".
        advice: What to do where the cause is known; empty where it is not.
        tangents: Tangents that were assembled.
        contraction: Ratio of the first two corrections by one tangent, within a path; else None.
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
    tangents: int = 0
    contraction: float | None = None

    def sentence(self) -> str:
        """One sentence: outcome, iterations, norms."""
        verb = "converged" if self.converged else "stopped"
        projected = f", {self.projected} of them projected" if self.projected else ""
        unusual = set(self.tried) - USUAL
        ways = f" by way of {', '.join(dict.fromkeys(self.tried))}" if unusual else ""
        # There is no last correction where no iteration was made.
        last = f", last correction {self.correction:.1e}" if isfinite(self.correction) else ""
        return (
            f"SNES {verb} after {self.iterations} iterations{projected}{ways} "
            f"({self.reason}), |R| = {self.residual:.1e} at a force level of "
            f"{self.force_level:.1e}{last}"
        )


@dataclass(frozen=True)
class Step:
    """One converged load step.

    Attributes:
        load: Load factor.
        convergence: How Newton went.
        records: What was recorded.
        bounds: Bounds of the smallest volume ratio J (of a membrane's area ratio) over whole cells;
            None for elements that have none (:func:`forms.validity.can_bound`).
        clearance: Smallest distance from obstacles, where it is and from which; None without any.
    """

    load: float
    convergence: Convergence
    records: dict[str, Any]
    bounds: Bounds | None = None
    clearance: Clearance | None = None


class Event(NamedTuple):
    """What a path passed.

    Attributes:
        load: Load factor at which.
        kind: "bifurcation", "limit point", or "jump".
        before, after: Negative eigenvalues on either side, None where they are not known.
        released: Energy [J] that a jump set free; None where it is not known.
    """

    load: float
    kind: str
    before: int | None
    after: int | None
    released: float | None = None

    def sentence(self) -> str:
        """The event in words."""
        counts = f", {self.before} -> {self.after} negative eigenvalues"
        freed = "" if self.released is None else f", {self.released:.4g} J released"
        return f"{self.kind} at load factor {self.load:.6g}{counts}{freed}"


class Held(NamedTuple):
    """Scalars that were found, and as many functionals that they hold."""

    q: tuple[fem.Constant, ...]
    functionals: tuple[ufl.Form, ...]


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
        tangents: Tangents that were assembled, those of refused steps and of events included.
        events: Bifurcations, limit points and jumps, in order.
        balances: Energy and powers of the states, the first one included.
        floor: Energy [J] that tolerances leave unknown.
        accounts: Rows of the ledger that are known step by step, those of motions.
        velocity, acceleration: Of a motion at its last time; None in statics.
        held: What ``control`` holds, and the scalars that it has found; None elsewhere.
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
    tangents: int = 0
    events: list[Event] = field(default_factory=list)
    balances: list[Balance] = field(default_factory=list)
    floor: float = 0.0
    accounts: Ledger = field(default_factory=Ledger)
    velocity: fem.Function | None = None
    acceleration: fem.Function | None = None
    held: Held | None = None

    @property
    def ledger(self) -> Ledger:
        """Account of each step: where the work of loads and supports went."""
        return self.accounts or rows(self.balances)

    @property
    def load(self) -> float:
        """Last converged load factor; the first one while there is no step."""
        return self.steps[-1].load if self.steps else self.begin

    def record(self, name: str) -> np.ndarray:
        """A recorded quantity over the steps, shape (steps, ...); objects where parts differ."""
        values = [step.records[name] for step in self.steps]
        try:
            return np.array(values)
        except ValueError:  # numbers beside a point, as in Bounds
            return np.array(values, dtype=object)

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

    def take_up(self, steps: Sequence[Step], counts: Mapping[str, Any]) -> None:
        """Take the steps of an earlier run, whose path goes on."""
        self.steps += steps
        self.refused, self.seconds = counts["refused"], counts["seconds"]
        self.resumed = self.load

    def end(self, words: str) -> None:
        """Take note that the path is complete, and why it ended."""
        self.completed = True
        self.reason = (
            f"{words} ({self.refused} refused), "
            f"{sum(step.convergence.iterations for step in self.steps)} iterations."
            f"{self.verdict()}{self.ledger.sentence(self.floor)}"
        )

    def verdict(self) -> str:
        """What the certificates of the states say, in sentences."""
        mesh = self.u.function_space.mesh
        solid = mesh.topology.dim == mesh.geometry.dim
        inverted = inversion(self.steps) if solid else ""
        unstable = instability(self.steps)
        if unstable and any(f.role.curvature in "-0" for f in self.problem.fields.values()):
            unstable += ELEMENTS_OWN
        left = sum(balance.kind == START for balance in self.balances)
        begun = f" {left} of the steps by minimizing the energy, from a singular state." * bool(
            left
        )
        return f"{begun}{passed(self.events)}{unstable}{inverted}"


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
    """Where a path is unstable, as a sentence; empty where it is nowhere or not known."""
    counts = [(s.load, s.convergence.negative) for s in steps if s.convergence.negative is not None]
    spans: list[list[float]] = []
    before: int = 0
    for load, negative in counts:
        if negative and not before:
            spans.append([load])
        elif before and not negative:
            spans[-1].append(load)
        before = negative
    if not spans:
        return ""
    most = max(negative for _, negative in counts)
    word = f"{most} negative {'eigenvalue' if most == 1 else 'eigenvalues'}"
    if len(steps) == 1:
        return f" Unstable: {word}."
    ends = [f"to {span[1]:.6g}" if len(span) > 1 else "on" for span in spans]
    pairs = zip(spans, ends, strict=True)
    where = ", and ".join(f"from load factor {span[0]:.6g} {end}" for span, end in pairs)
    return f" Unstable {where} ({word} at most)."


def inversion(steps: Sequence[Step]) -> str:
    """Where J > 0 everywhere is not so, as a sentence; empty where it is, or is not known."""
    bounds = [(s.load, s.bounds) for s in steps if s.bounds is not None and not s.bounds.lower > 0]
    if not bounds:
        return ""
    load, worst = min(bounds, key=lambda each: each[1].upper)
    place = ", ".join(f"{x:.3g}" for x in worst.place)
    if worst.upper > 0:
        return f" J > 0 is not certain at ({place}), where it is {worst.upper:.2g} at most."
    since = f" from load factor {bounds[0][0]:.6g} on" if len(steps) > 1 else ""
    return (
        f" Cells are inverted{since}: J is {worst.upper:.2g} or less at ({place}), load factor "
        f"{load:.6g}; is the mesh fine enough there?"
    )


def passed(events: Sequence[Event]) -> str:
    """What a path passed, as a sentence; empty where that is nothing."""
    if not events:
        return ""
    shown = [event.sentence() for event in events[:SHOWN]]
    more = f", and {len(events) - SHOWN} more" if len(events) > SHOWN else ""
    return f" Passed: {'; '.join(shown)}{more}."
