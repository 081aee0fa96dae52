# SPDX-License-Identifier: MIT
"""Equilibrium paths through limit points, where neither load nor displacement grows steadily."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np
import ufl
from dolfinx import fem

from ..files.checkpoint import Archive, Checkpoint
from ..paths import Path, check_record
from ..problems import Problem
from ..supports import Support
from .bordered import Bordered, scalar
from .controls.arc import ArcLength
from .reuse import problem_for
from .stepping import advance


def arc_length(
    potential: ufl.Form | Problem,
    u: fem.Function | None = None,
    supports: Iterable[Support] = (),
    q: fem.Constant | None = None,
    *,
    step: float,
    to: float | None = None,
    steps: int = 1000,
    until: Callable[[Problem], bool] | None = None,
    largest: float = 0.05,
    along: fem.Function | None = None,
    virtual_work: ufl.Form | None = None,
    rtol: float = 1e-8,
    ctol: float = 1e-6,
    max_iterations: int = 15,
    record: Mapping[str, Callable[[Problem], Any]] | None = None,
    on_step: Callable[[Path], None] | None = None,
    checkpoint: Checkpoint | None = None,
    progress: bool = True,
) -> Path:
    """Follow an equilibrium path by its length: over limit points of load and displacement.

    t . (u - u_n) = s,  t the unit tangent of the path at the last state (u_n, q_n)

    Each step starts along t and returns to equilibrium in the plane at the distance s (Riks'
    method). s grows after easy steps and is halved where Newton's method fails or the path turns
    by more than 37 degrees from the step. Collective.

    Args:
        potential: Total potential [J] of u that contains q; or a :class:`forms.Problem`, which
            comes with its unknown and supports.
        u: Unknown, starting from its present values, in equilibrium at the present q or near it.
        supports: Prescribed displacements; they do not depend on q.
        q: Load factor, found along.
        step: Change of q in the first step; its sign is the direction in which the path is left.
        to: Load factor at which the path ends when it is first passed, solved for exactly.
        steps: Largest number of steps.
        until: Function of the problem that tells, after each step, whether the path is at its end.
        largest: Largest displacement of a step over the model's size.
        along: Direction in which the path is left, in place of that of growing q: a mode of
            :func:`forms.lowest_modes` turns into another branch at a bifurcation. ``step`` is then
            the largest displacement [m] of the first step.
        virtual_work: Linear form added to the residual, for loads without a potential.
        rtol: Tolerance of |R_free| relative to the force level.
        ctol: Tolerance of the last correction relative to the model's size.
        max_iterations: Newton iterations per step.
        record: Functions of the problem, evaluated after each step.
        on_step: Called with the path after each step.
        checkpoint: Where the path is saved, and taken up when the script is started again; see
            :class:`forms.Checkpoint`.
        progress: Show a line of progress on rank 0.

    Returns:
        Path; not ``completed`` where the steps were used up before ``to`` or ``until``. ``load`` of
        each step is q, and ``convergence.negative`` the number of negative
        eigenvalues of the tangent in that state.

    Raises:
        NotConverged: a step failed at SHORTEST of the first length; u and q hold the last state.
        ValueError: the potential does not contain q, or steps without length or end.
    """
    _check(step, to, steps, until, largest, float(getattr(q, "value", 0.0)))
    check_record(record)
    q = scalar(q, "arc_length")
    problem = problem_for(potential, u, supports, virtual_work)
    archive = None if checkpoint is None else Archive(checkpoint, problem.u, "path of arc_length")
    bordered = Bordered(problem, q, rtol, ctol, max_iterations)
    path = Path(problem.u, problem, begin=bordered.load)
    with bordered.kept_if_sound():
        steps_of = ArcLength(path, bordered, step, to, steps, until, largest, along)
    advance(steps_of, record, on_step, archive, progress)
    asked = to is not None or until is not None
    path.completed = not (asked and "steps taken" in path.reason)
    return path


def _check(
    step: float,
    to: float | None,
    steps: int,
    until: Callable[[Problem], bool] | None,
    largest: float,
    q: float,
) -> None:
    if not (np.isfinite(step) and step != 0):
        raise ValueError(f"step is the first change of q, a number but not 0, got {step}.")
    if not (largest > 0 and steps >= 1):
        raise ValueError(
            f"largest must be positive and steps at least 1, got {largest} and {steps}."
        )
    if to is not None and (not np.isfinite(to) or to == q):
        raise ValueError(f"to must be a load factor other than the present {q}, got {to}.")
    if until is not None and not callable(until):
        raise ValueError(f"until is a function of the problem, got {type(until).__name__}.")
