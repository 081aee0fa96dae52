# SPDX-License-Identifier: MIT
"""Equilibrium while functionals of u go through given values: volume or displacement control."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import ufl
from dolfinx import fem

from .. import _checks
from ..files.checkpoint import Archive, Checkpoint
from ..paths import Held, Path, check_record
from ..problems import Problem
from ..supports import Support
from .border import Border, Values, scalar
from .controls.target import Targets
from .reuse import newton_for, problem_for, release
from .settings import Settings
from .stepping import advance


def control(
    potential: ufl.Form | Problem,
    u: fem.Function | None = None,
    supports: Iterable[Support] = (),
    q: fem.Constant | Sequence[fem.Constant] | None = None,
    functional: ufl.Form | Sequence[ufl.Form] | None = None,
    targets: Sequence[Any] = (),
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

    R(u, q) = 0,  g_i(u, q) = target_i;  i = 1 to k, as many scalars q_i

    The constant q, a pressure or a load factor in the potential, is found along: past the limit
    point, where no larger q has an equilibrium, it falls again. A target that fails is approached
    in halved steps. Several functionals, as the volumes of two chambers, or an end's displacement
    and rotation, go together along straight lines from one row of targets to the next.

    Args:
        potential: Total potential [J] of u that contains q; or a :class:`forms.Problem`, which
            comes with its unknown and supports.
        u: Unknown, starting from its present values, in equilibrium or near it.
        supports: Prescribed displacements.
        q: Scalar unknown; its value is the first guess. Or a list of k.
        functional: What is prescribed, a functional of u, as :func:`forms.enclosed_volume`, and
            perhaps of q: ``q * enclosed_volume(u)`` is an enclosed ideal gas, p V = n R T. Or a
            list of k, of which none follows from the others.
        targets: Its values, one step each; of k functionals rows of k numbers. One that stands
            still is held.
        virtual_work: Linear form added to the residual, for loads without a potential.
        options: PETSc options over the presets, without prefix.
        prefix: Prefix of the options on the command line, which wins over ``options``.
        rtol: Tolerance of |R_free| relative to the force level, and of the functional relative to
            its target (or to its change from the start, where the target is 0); of several each
            to its target or to the range of its values, if that is larger.
        ctol: Tolerance of the last correction relative to the model's size.
        settings: Numbers that the solver and the steps are tuned by.
        refuse_inverted: Refuse steps to states where J > 0 everywhere is not certain.
        record: Functions of the problem, evaluated after each step.
        on_step: Called with the path after each step.
        checkpoint: Where the path is saved, and taken up when the script is started again; see
            :class:`forms.Checkpoint`.
        progress: Show a progress bar on rank 0.

    Returns:
        Path; ``load`` of each step is q, the first one of several, and its records hold "target",
        and of several lists, also "q".

    Raises:
        NotConverged: a step failed at MAX_HALVINGS halvings; u and q hold the last state.
        ValueError: the potential does not contain q, a functional does not depend on u, no
            targets, rows of other lengths; functionals that change alike with u at the start, or
            scalars that load the body alike.
    """
    check_record(record)
    scalars, functionals, rows = _checked(q, functional, targets)
    problem = problem_for(potential, u, supports, virtual_work)
    for each in functionals:
        _checks.form_of(each, problem.u.function_space.mesh, "a functional")
    archive = None if checkpoint is None else Archive(checkpoint, problem.u, "path of control")
    newton = newton_for(problem, options, prefix, rtol, ctol, "never", settings, factorized=True)
    held = Held(tuple(scalars), tuple(functionals))
    path = Path(problem.u, problem, begin=float(scalars[0].value), held=held)
    try:
        border = Border(problem, scalars, newton.tangent)
        along = Targets(path, newton, border, functionals, rows)
        along.refuse_inverted = refuse_inverted
    except BaseException:
        release(newton, sound=False)
        raise
    return advance(along, record, on_step, archive, progress)


def _checked(
    q: Any, functional: Any, targets: Sequence[Any]
) -> tuple[list[fem.Constant], list[ufl.Form], Values]:
    """Scalars, functionals, and targets of shape (targets, functionals), checked; local."""
    several = isinstance(q, list | tuple)
    scalars = [scalar(each, "control") for each in (q if several else [q])]
    functionals = list(functional) if isinstance(functional, list | tuple) else [functional]
    for each in functionals:
        if not isinstance(each, ufl.Form) or len(targets) == 0:
            raise ValueError(
                "control needs a functional of u, a UFL form, and its targets, got "
                f"{type(each).__name__} and {len(targets)} targets."
            )
    if len(functionals) != len(scalars) or not scalars:
        raise ValueError(
            f"control finds as many scalars q as it holds functionals, got {len(scalars)} and "
            f"{len(functionals)}: give one for each."
        )
    for what, listed in (("q", scalars), ("functional", functionals)):
        for n, each in enumerate(listed):
            if any(each is other for other in listed[:n]):
                raise ValueError(
                    f"control needs each {what} once, got number {n + 1} twice: leave one out."
                )
    shapes = [np.shape(row) for row in targets]
    for n, shape in enumerate(shapes, start=1):
        if shape != ((len(scalars),) if several else ()):
            raise ValueError(
                f"control needs {len(scalars) if several else 'one'} "
                f"{'numbers' if several else 'number'} for each target, one for each functional, "
                f"got an array of shape {shape} as target {n}."
            )
    return scalars, functionals, np.array(targets, float).reshape(-1, len(scalars))
