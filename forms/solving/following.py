# SPDX-License-Identifier: MIT
"""Solving at one load, and following a load path with adaptive steps."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import ufl
from dolfinx import fem

from ..files.checkpoint import Archive, Checkpoint
from ..paths import Path, Step, check_record, recorded
from ..problems import Problem
from ..supports import Support
from .certificates import certified_clearance, certified_volume
from .controls.load import LoadSteps, attempt, pace_of
from .reuse import newton_for, problem_for, release
from .settings import Settings
from .stepping import advance
from .supported import failure


def solve(
    potential: ufl.Form | Problem,
    u: fem.Function | None = None,
    supports: Iterable[Support] = (),
    *,
    virtual_work: ufl.Form | None = None,
    options: Mapping[str, Any] | None = None,
    prefix: str = "variform_",
    rtol: float = 1e-8,
    ctol: float = 1e-6,
    projection: str = "auto",
    settings: Settings | None = None,
    record: Mapping[str, Callable[[Problem], Any]] | None = None,
    load: float = 1.0,
) -> Path:
    """Solve for u at the present loads, in one step from its present values. Collective.

    Args:
        potential: Total potential [J] (or a residual, linear in a test function); or a
            :class:`forms.Problem`, which comes with its unknown and supports.
        u: Unknown; holds the solution afterwards, or its old values if the solve fails.
        supports: Prescribed displacements.
        virtual_work: Linear form added to the residual, for loads without a potential.
        options: PETSc options over the presets, without prefix, as ``{"snes_max_it": 50}``.
        prefix: Prefix of the options on the command line, which wins over ``options``.
        rtol: Tolerance of |R_free| relative to the force level, see :class:`Newton`.
        ctol: Tolerance of the last correction relative to the model's size.
        projection: When to make the tangent positive semi-definite: "auto", "always" or "never",
            see :class:`Newton`.
        settings: Numbers that the solver is tuned by, and the ladder of its ways.
        record: Functions of the problem, evaluated at the solution; collective.
        load: Load factor to be noted in the path and its files.

    Returns:
        Path of one step.

    Raises:
        NotConverged: Newton's method failed; u has its old values.
        ValueError: forms or supports of the wrong kind.
    """
    check_record(record)
    problem = problem_for(potential, u, supports, virtual_work)
    u = problem.u
    newton = newton_for(problem, options, prefix, rtol, ctol, projection, settings)
    path, start = Path(u, problem), time.perf_counter()
    before = u.x.array.copy()
    converged = False
    try:
        outcome = attempt(newton)
        converged = outcome.converged
    finally:
        if not converged:
            u.x.array[:] = before
            problem.rollback()
        release(newton, converged)
    path.seconds = time.perf_counter() - start
    if not converged:
        shown = f"; -{prefix}snes_monitor shows each iteration" if outcome.iterations else ""
        raise failure(
            path,
            f"{outcome.sentence()}. The old state is kept.",
            outcome.advice or f"Reach the load in steps with forms.follow{shown}.",
        )
    problem.commit()
    bounds = certified_volume(problem)
    clear = certified_clearance(problem)
    path.steps.append(Step(load, outcome, recorded(record, problem), bounds, clear))
    path.completed = True
    path.reason = f"{outcome.sentence()}.{path.verdict()}"
    return path


def follow(
    potential: ufl.Form | Problem,
    u: fem.Function | None = None,
    supports: Iterable[Support] = (),
    t: fem.Constant | None = None,
    to: float | Sequence[float] = 1.0,
    *,
    step: float | None = None,
    min_step: float | None = None,
    max_step: float | None = None,
    jump: bool = False,
    refuse_inverted: bool = False,
    virtual_work: ufl.Form | None = None,
    options: Mapping[str, Any] | None = None,
    prefix: str = "variform_",
    rtol: float = 1e-8,
    ctol: float = 1e-6,
    projection: str = "auto",
    settings: Settings | None = None,
    record: Mapping[str, Callable[[Problem], Any]] | None = None,
    on_step: Callable[[Path], None] | None = None,
    checkpoint: Checkpoint | None = None,
    progress: bool = True,
) -> Path:
    """Follow the path of equilibria while the load factor goes to its last value.

    Each state is extrapolated from the last ones and corrected by plain Newton; the contraction of
    its corrections sets the lengths of the steps, and refuses those that might lead to another
    equilibrium. Energy, stability and volume ratios of each state are looked at
    (``path.ledger``, ``path.events``). Collective.

    Args:
        potential: Total potential [J] (or a residual, linear in a test function); or a
            :class:`forms.Problem`, which comes with its unknown and supports.
        u: Unknown, starting from its present values.
        supports: Prescribed displacements, which may depend on t.
        t: Load factor that the potential and the supports were written with.
        to: Last load factor; or several, one after the other, each of which ends a step: the load
            factor may go back. Kinks of the loads (:func:`forms.programs.table`) end steps, too.
        step: First step of t; by default a tenth of the way.
        min_step: Smallest step; by default 1e-4 of the way.
        max_step: Largest step; none by default.
        jump: Go on where no equilibrium is connected to the last one, as behind a limit point, by
            minimizing the energy at the next load: an event that records the energy set free.
        refuse_inverted: Refuse steps to states where J > 0 everywhere is not certain, which else
            are noted.
        virtual_work: Linear form added to the residual, for loads without a potential.
        options: PETSc options over the presets, without prefix.
        prefix: Prefix of the options on the command line, which wins over ``options``.
        rtol: Tolerance of |R_free| relative to the force level, see :class:`Newton`.
        ctol: Tolerance of the last correction relative to the model's size.
        projection: When to make the tangent positive semi-definite: "auto", "always" or "never",
            see :class:`Newton`.
        settings: Numbers that the solver is tuned by, and the ladder of its ways.
        record: Functions of the problem, evaluated after each step and kept; collective.
        on_step: Called with the path after each step, as a :class:`forms.VTX` writer.
        checkpoint: Where the path is saved, and taken up when the script is started again; see
            :class:`forms.Checkpoint`.
        progress: Show a progress bar on rank 0.

    Returns:
        Path with all steps.

    Raises:
        NotConverged: the step became smaller than min_step; u and t hold the last converged state,
            and the exception's ``path`` the steps so far.
        ValueError: forms or supports of the wrong kind, steps that are not positive, nothing that
            depends on t, or a checkpoint of another path.
        OSError: checkpoints cannot be written from the start.
    """
    if not isinstance(t, fem.Constant):
        raise ValueError(
            f"follow needs the load factor of forms.load_factor, got {type(t).__name__}."
        )
    stops = [float(stop) for stop in np.atleast_1d(to)]
    lengths = np.abs(np.diff([float(t.value), *stops]))
    if not (stops and np.all(lengths > 0)):
        raise ValueError(
            f"the load factor is at {to} already: use solve, or another to=."
            if len(stops) == 1
            else f"the load factors of to= differ each from the one before, got {stops}."
        )
    way = float(lengths.sum())
    pace = pace_of(way, step, min_step, max_step, settings or Settings())
    check_record(record)
    problem = problem_for(potential, u, supports, virtual_work)
    if not problem.depends_on(t):
        raise ValueError(
            "nothing depends on the load factor t: write a load or a support with it, or use solve."
        )
    u = problem.u
    archive = None if checkpoint is None else Archive(checkpoint, u, "path of follow")
    newton = newton_for(problem, options, prefix, rtol, ctol, projection, settings)
    path = Path(u, problem, begin=float(t.value))
    steps = LoadSteps(path, newton, t, stops, pace, jump)
    steps.refuse_inverted = refuse_inverted
    return advance(steps, record, on_step, archive, progress)
