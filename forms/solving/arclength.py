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
from .border import Border, scalar
from .controls.arc import ArcLength
from .reuse import newton_for, problem_for, release
from .settings import Settings
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
    options: Mapping[str, Any] | None = None,
    prefix: str = "variform_",
    rtol: float = 1e-8,
    ctol: float = 1e-6,
    settings: Settings | None = None,
    refuse_inverted: bool = False,
    record: Mapping[str, Callable[[Problem], Any]] | None = None,
    on_step: Callable[[Path], None] | None = None,
    checkpoint: Checkpoint | None = None,
    progress: bool = True,
) -> Path:
    """Follow an equilibrium path by its length: over limit points of load and displacement.

    t . (u - u_n) = s,  t the unit tangent of the path at the last state (u_n, q_n)

    Each step starts on the curve through the last states and returns to equilibrium in the plane
    at the distance s (Riks' method). The contraction of Newton's method sets s, which is also
    refused where the path turns by more than 37 degrees within it. Limit points and bifurcations
    are located: ``path.events``. Collective.

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
        options: PETSc options over the presets, without prefix.
        prefix: Prefix of the options on the command line, which wins over ``options``.
        rtol: Tolerance of |R_free| relative to the force level.
        ctol: Tolerance of the last correction relative to the model's size.
        settings: Numbers that the solver and the steps are tuned by.
        refuse_inverted: Refuse steps to states where J > 0 everywhere is not certain.
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
    newton = newton_for(problem, options, prefix, rtol, ctol, "never", settings, factorized=True)
    path = Path(problem.u, problem, begin=float(q.value))
    try:
        border = Border(problem, [q], newton.tangent)
        steps_of = ArcLength(path, newton, border, step, to, steps, until, largest, along)
        steps_of.refuse_inverted = refuse_inverted
    except BaseException:
        release(newton, sound=False)
        raise
    advance(steps_of, record, on_step, archive, progress)
    path.completed = not (steps_of.used_up and (to is not None or until is not None))
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
