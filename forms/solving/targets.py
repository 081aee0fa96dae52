# SPDX-License-Identifier: MIT
"""Equilibrium while a functional of u goes through given values: volume or displacement control."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import ufl
from dolfinx import fem

from .. import _checks
from ..files.checkpoint import Archive, Checkpoint
from ..paths import Path, check_record
from ..problems import Problem
from ..supports import Support
from .border import Border, scalar
from .controls.target import Targets
from .reuse import newton_for, problem_for, release
from .settings import Settings
from .stepping import advance


def control(
    potential: ufl.Form | Problem,
    u: fem.Function | None = None,
    supports: Iterable[Support] = (),
    q: fem.Constant | None = None,
    functional: ufl.Form | None = None,
    targets: Sequence[float] = (),
    *,
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
    """Follow equilibrium while a functional of u goes through given values. Collective.

    The constant q, a pressure or a load factor in the potential, is found along: past the limit
    point, where no larger q has an equilibrium, it falls again. A target that fails is approached
    in halved steps.

    Args:
        potential: Total potential [J] of u that contains q; or a :class:`forms.Problem`, which
            comes with its unknown and supports.
        u: Unknown, starting from its present values, in equilibrium or near it.
        supports: Prescribed displacements.
        q: Scalar unknown; its value is the first guess.
        functional: What is prescribed, a functional of u, as :func:`forms.enclosed_volume`, and
            perhaps of q: ``q * enclosed_volume(u)`` is an enclosed ideal gas, p V = n R T.
        targets: Its values, one step each.
        virtual_work: Linear form added to the residual, for loads without a potential.
        options: PETSc options over the presets, without prefix.
        prefix: Prefix of the options on the command line, which wins over ``options``.
        rtol: Tolerance of |R_free| relative to the force level, and of the functional relative to
            its target (or to its change from the start, where the target is 0).
        ctol: Tolerance of the last correction relative to the model's size.
        settings: Numbers that the solver and the steps are tuned by.
        refuse_inverted: Refuse steps to states where J > 0 everywhere is not certain.
        record: Functions of the problem, evaluated after each step.
        on_step: Called with the path after each step.
        checkpoint: Where the path is saved, and taken up when the script is started again; see
            :class:`forms.Checkpoint`.
        progress: Show a progress bar on rank 0.

    Returns:
        Path; ``load`` of each step is q, and its records hold "target".

    Raises:
        NotConverged: a step failed at MAX_HALVINGS halvings; u and q hold the last state.
        ValueError: the potential does not contain q, the functional does not depend on u, or no
            targets.
    """
    check_record(record)
    q = scalar(q, "control")
    if not isinstance(functional, ufl.Form) or len(targets) == 0:
        raise ValueError(
            "control needs a functional of u, a UFL form, and its targets, got "
            f"{type(functional).__name__} and {len(targets)} targets."
        )
    problem = problem_for(potential, u, supports, virtual_work)
    _checks.form_of(functional, problem.u.function_space.mesh, "a functional")
    archive = None if checkpoint is None else Archive(checkpoint, problem.u, "path of control")
    newton = newton_for(problem, options, prefix, rtol, ctol, "never", settings, factorized=True)
    path = Path(problem.u, problem, begin=float(q.value), held=(q, functional))
    try:
        border = Border(problem, [q], newton.tangent)
        along = Targets(path, newton, border, functional, targets)
        along.refuse_inverted = refuse_inverted
    except BaseException:
        release(newton, sound=False)
        raise
    return advance(along, record, on_step, archive, progress)
