# SPDX-License-Identifier: MIT
"""Bodies in motion: inertia and viscosity as terms of the potential, from time to time."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import ufl
from dolfinx import fem

from .. import _checks
from ..dissipation import Dissipation
from ..files.checkpoint import Archive, Checkpoint
from ..motion import Motion
from ..paths import Path, check_record
from ..problems import Problem
from ..schemes import Scheme, scheme_of
from ..supports import Support
from .controls.time import TimeSteps
from .pace import Pace
from .reuse import newton_for
from .settings import Settings
from .stepping import advance

LEAST = 1e-9  # of the whole time, below which a step ends the motion


def transient(
    potential: Any,
    u: fem.Function | None = None,
    supports: Iterable[Support] | Support = (),
    t: fem.Constant | None = None,
    to: float | Sequence[float] = 1.0,
    *,
    rho: Any = None,
    scheme: str | Scheme = "newmark",
    dt: float | None = None,
    tolerance: float = 2e-5,
    step: float | None = None,
    min_step: float | None = None,
    max_step: float | None = None,
    velocity: Any = None,
    dissipation: Sequence[Dissipation] | Dissipation = (),
    lumped: bool = False,
    thickness: Any = 1.0,
    dx: ufl.Measure | None = None,
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
    """Follow a body's motion in time, rho u'' + phi'(u') + Pi'(u; t) = 0. Collective.

    Each step minimizes Pi + c/2 int rho |s - u*|^2 + 1/b int phi(b s + d), whose numbers are the
    scheme's (:mod:`forms.schemes`): everything that a potential may contain moves, and nothing
    needs to hold the body. Supports that depend on t have their velocity and acceleration. In
    ``path.ledger`` each step's joules are stored, moved, dissipated, or lost by the scheme.

    Args:
        potential: Total potential [J] (or a residual, linear in a test function); or a
            :class:`forms.Problem`, of statics, which comes with its unknown and supports.
        u: Unknown, starting from its present values.
        supports: Prescribed displacements, which may depend on t.
        t: Time [s], the load factor that loads and supports are written with.
        to: Last time; or several, ascending, each of which ends a step, as kinks of loads do.
        rho: Mass per reference volume [kg/m^3], a number or a scalar in UFL.
        scheme: "newmark" (the trapezoidal rule, order 2), "midpoint" (order 2, keeps momenta),
            "bdf2" (order 2, calms fast vibrations), "euler" (order 1, calms all), or an object of
            :mod:`forms.schemes`.
        dt: Fixed length of the steps; by default the local error sets it.
        tolerance: Largest local error of a step, over the largest displacement so far, or the
            body's size where that is smaller.
        step: First step; by default a thousandth of the time, or ``dt``.
        min_step: Smallest step; by default 1e-9 of the time.
        max_step: Largest step; none by default.
        velocity: First velocity [m/s]: a vector of numbers or in UFL of the reference point, or a
            Function of the unknown's space, as ``path.velocity``; by default 0.
        dissipation: What :mod:`forms.dissipation` returns, one or several.
        lumped: Whether the mass is lumped at the nodes: linear elements, quadratic hexahedra.
        thickness: Of a sheet [m], by which rho is multiplied. On bodies of revolution the
            circumference is put in by itself.
        dx: Measure of what has mass; by default all cells.
        refuse_inverted: Refuse steps to states where J > 0 everywhere is not certain.
        virtual_work: Linear form added to the residual, for loads without a potential.
        options: PETSc options over the presets, without prefix.
        prefix: Prefix of the options on the command line, which wins over ``options``.
        rtol: Tolerance of |R_free| relative to the force level: reactions, or inertia.
        ctol: Tolerance of the last correction relative to the model's size.
        projection: When to make the tangent positive semi-definite, see :class:`Newton`.
        settings: Numbers that the solver is tuned by.
        record: Functions of the problem, evaluated after each step and kept; collective.
        on_step: Called with the path after each step, as a :class:`forms.VTX` writer.
        checkpoint: Where the motion is saved, and taken up when the script is started again.
        progress: Show a progress bar on rank 0.

    Returns:
        Path with all steps; ``step.load`` is the time. Each records "kinetic" energy, "momentum",
        "angular_momentum" about the origin, "dt", and the local "error" [m]. ``path.velocity`` and
        ``path.acceleration`` are those of the last time.

    Raises:
        NotConverged: the step became smaller than min_step; u and t hold the last state.
        ValueError: no mass density or one that is not positive, a time that is none, steps that
            are not positive, times that do not ascend, or what :class:`forms.Problem` refuses.
    """
    if not isinstance(t, fem.Constant) or np.shape(t.value) != ():
        raise ValueError(
            "a motion needs its time, the load factor of forms.load_factor, got "
            f"{type(t).__name__}."
        )
    stops = times_to(float(t.value), to)
    way = stops[-1] - float(t.value)
    settings = settings or Settings()
    check_positive(
        "a motion", dt=dt, step=step, min_step=min_step, max_step=max_step, tolerance=tolerance
    )
    check_record(record)
    found = scheme_of(scheme)
    motion = motion_of(
        potential, u, supports, t, rho, found, virtual_work, dissipation, lumped, thickness, dx
    )
    problem = motion.problem
    archive = None
    if checkpoint is not None:
        archive = Archive(checkpoint, problem.u, "motion of transient")
    newton = newton_for(problem, options, prefix, rtol, ctol, projection, settings)
    least = way * LEAST if min_step is None else min_step
    most = np.inf if max_step is None else max_step
    first = step or dt or way / 1000
    pace = Pace(min(first, most), min(least, first), dt or most, settings)
    path = Path(problem.u, problem, begin=float(t.value))
    path.velocity, path.acceleration = motion.velocity, motion.acceleration
    steps = TimeSteps(path, newton, motion, stops, pace, dt, tolerance)
    steps.start_with(velocity)
    steps.refuse_inverted = refuse_inverted
    return advance(steps, record, on_step, archive, progress)


def motion_of(
    potential: Any,
    u: fem.Function | None,
    supports: Iterable[Support] | Support,
    t: fem.Constant,
    rho: Any,
    scheme: Scheme,
    virtual_work: ufl.Form | None = None,
    dissipation: Sequence[Dissipation] | Dissipation = (),
    lumped: bool = False,
    thickness: Any = 1.0,
    dx: ufl.Measure | None = None,
) -> Motion:
    """A motion of a potential, or of a problem of statics. Collective.

    Raises:
        ValueError: a problem together with what belongs to another, or one that moves already.
    """
    others: Any = ()
    if isinstance(potential, Problem):
        held = (supports,) if isinstance(supports, Support) else tuple(supports)
        given, problem = (u, virtual_work, *held), potential
        if any(each is not None for each in given):
            raise ValueError(
                "a problem comes with its unknown, supports and virtual work: pass it alone, or a "
                "potential with others."
            )
        if problem.motion is not None:
            raise ValueError(
                "a motion needs a problem of statics, got that of another motion: pass the "
                "potential, and velocity=path.velocity to go on."
            )
        others = problem.terms[1:]
        u, supports, virtual_work = problem.u, problem.supports, problem.forms.virtual_work
        potential = problem.forms.potential
        if virtual_work is not None and potential.arguments():
            virtual_work = None  # the residual has it already
    if isinstance(supports, Support):
        supports = (supports,)
    parts = [potential, *others] if others else potential
    arguments = virtual_work, dissipation, lumped, thickness, dx
    return Motion(parts, _checks.function(u, "a motion"), supports, t, rho, scheme, *arguments)


def times_to(begin: float, to: float | Sequence[float]) -> list[float]:
    """Times that end a step, after checking that they ascend from the present one.

    Raises:
        ValueError: times that do not ascend, or are not finite.
    """
    stops = [float(stop) for stop in np.atleast_1d(to)]
    if not (stops and np.all(np.isfinite(stops)) and np.all(np.diff([begin, *stops]) > 0)):
        raise ValueError(
            f"times ascend from the present one, t = {begin:.6g}, got to = {to}: set t.value for "
            "another beginning."
        )
    return stops


def check_positive(who: str, **lengths: float | None) -> None:
    """Refuse lengths of time, and tolerances, that are not positive and finite."""
    for name, value in lengths.items():
        if value is not None and not 0 < value < np.inf:
            raise ValueError(f"{who} needs {name} > 0, got {value}.")
