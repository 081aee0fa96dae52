# SPDX-License-Identifier: MIT
"""From a state that is no equilibrium, or a vanished one, by damped motion to the next at rest."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from dolfinx import default_scalar_type, fem

from .._parallel import bounding_box
from ..dissipation import Dissipation
from ..ledger import Row
from ..motion import Motion
from ..paths import Path, Step, check_record, recorded
from ..problems import Problem
from ..schemes import Euler
from ..supports import Support
from .certificates import certified_clearance, certified_volume
from .controls.load import attempt
from .controls.time import ROUGH, TimeSteps
from .motions import LEAST, check_positive, motion_of
from .newton import Newton
from .pace import Pace
from .reuse import newton_for, problem_for, release
from .settings import Settings
from .stability import negative_eigenvalues
from .stepping import advance
from .supported import failure

CALM = 1e-6  # of the largest kinetic energy, that a body at rest has at most
SLOW = 1e-3  # of the largest inertia, that a body at rest has at most
FEW = 5  # steps, at least
REST = "rest"  # kind of the row of the equilibrium itself


def settle(
    potential: Any,
    u: fem.Function | None = None,
    supports: Iterable[Support] | Support = (),
    t: fem.Constant | None = None,
    to: float | None = None,
    *,
    rho: Any = 1.0,
    time: float | None = None,
    tolerance: float = 1e-3,
    dissipation: Sequence[Dissipation] | Dissipation = (),
    thickness: Any = 1.0,
    options: Mapping[str, Any] | None = None,
    prefix: str = "variform_",
    settings: Settings | None = None,
    record: Mapping[str, Callable[[Problem], Any]] | None = None,
    on_step: Callable[[Path], None] | None = None,
    progress: bool = True,
) -> Path:
    """Let the body move, damped by implicit Euler, until it is at rest, at one load. Collective.

    Where :func:`forms.follow` ends at a limit point, ``forms.settle(psi, u, supports, t,
    to=1.01 * t.value)`` carries the body over; ``path.ledger`` has the joules released, moved and
    lost on the way, and the last step is the equilibrium at rest, solved for as by ``solve``.

    Args:
        potential: Total potential [J], or a :class:`forms.Problem`, of statics.
        u: Unknown, starting from its present values, at rest.
        supports: Prescribed displacements.
        t: Load factor, where it is to be changed first.
        to: What it is set to; by default it stays.
        rho: Mass per reference volume [kg/m^3]; it sets how long the way takes, and where it leads
            if there are several states ahead.
        time: Longest time of the motion [s]; by default as long as it takes.
        tolerance: As of :func:`forms.transient`.
        dissipation: What :mod:`forms.dissipation` returns, beside the scheme's own.
        thickness: Of a sheet [m].
        options: PETSc options over the presets, without prefix.
        prefix: Prefix of the options on the command line.
        settings: Numbers that the solver is tuned by.
        record: Functions of the problem, evaluated after each step and kept; collective.
        on_step: Called with the path after each step.
        progress: Show a progress bar on rank 0.

    Returns:
        Path of the motion, whose steps are times, the last one the state at rest.

    Raises:
        NotConverged: the body is not at rest in time, or no equilibrium is where it came to rest.
        ValueError: no potential, or what :func:`forms.transient` refuses.
    """
    check_record(record)
    check_positive("settle", time=time, tolerance=tolerance)
    problem = problem_for(potential, u, supports, None)
    if not problem.has_energy:
        raise ValueError("a body comes to rest where its potential is least, got no potential.")
    u = problem.u
    if to is not None:
        if not isinstance(t, fem.Constant):
            raise ValueError(f"settle to a load needs its load factor t, got {type(t).__name__}.")
        t.value = to
    clock = fem.Constant(u.function_space.mesh, default_scalar_type(0.0))
    motion = motion_of(
        problem, None, (), clock, rho, Euler(), None, dissipation, thickness=thickness
    )
    settings = settings or Settings()
    given = (options, prefix, 1e-8, 1e-6, "auto", settings)
    path = Path(u, motion.problem)
    path.velocity, path.acceleration = motion.velocity, motion.acceleration
    longest = np.inf if time is None else time
    first = _first_step(motion, tolerance)
    if first > 0:
        newton = newton_for(motion.problem, *given)
        pace = Pace(min(first, longest), first * LEAST, np.inf, settings)
        steps = TimeSteps(path, newton, motion, [longest], pace, None, tolerance, _is_at_rest)
        steps.total = None if time is None else 1.0
        advance(steps, record, on_step, None, progress)
        if not _is_at_rest(path):
            raise failure(path, f"The body still moves at t = {longest:.6g}: give it more time=.")
    motion.destroy()
    _come_to_rest(path, problem, newton_for(problem, *given), record)
    return path


def _first_step(motion: Motion, tolerance: float) -> float:
    """Step whose local error is the tolerance of a rough scale; 0 at an equilibrium. Collective."""
    motion.begin()
    mesh = motion.u.function_space.mesh
    low, high = bounding_box(mesh.comm, mesh.geometry.x)
    size = float(np.linalg.norm(high - low))
    own = float(np.abs(motion.acceleration.x.array).max(initial=0.0))
    largest = max(mesh.comm.allgather(own))
    return float(np.sqrt(2 * tolerance * ROUGH * size / largest)) if largest > 0 else 0.0


def _is_at_rest(path: Path) -> bool:
    """Whether nothing moves, and nothing is about to."""
    kinetic, inertia = path.record("kinetic"), path.record("inertia")
    calm = kinetic[-1] <= CALM * kinetic.max() and inertia[-1] <= SLOW * inertia.max()
    return len(kinetic) > FEW and bool(calm)


def _come_to_rest(
    path: Path,
    problem: Problem,
    newton: Newton,
    record: Mapping[str, Callable[[Problem], Any]] | None,
) -> None:
    """Solve for the equilibrium where the motion has ended; a step and a row of its own."""
    u, last = path.u, path.steps[-1] if path.steps else None
    before, energy = u.x.array.copy(), problem.energy()
    outcome = attempt(newton)
    if not outcome.converged:
        u.x.array[:] = before
        problem.rollback()
    release(newton, outcome.converged)
    if not outcome.converged:
        raise failure(path, f"{outcome.sentence()}, where the body has come to rest.")
    problem.commit()
    if outcome.negative is None and problem.symmetric:
        outcome = replace(outcome, negative=negative_eigenvalues(problem))
    time, notes = (last.load, last.records) if last else (0.0, {"kinetic": 0.0})
    stored, kinetic = problem.energy() - energy, notes["kinetic"]
    path.accounts.append(Row(time, stored, 0.0, 0.0, kinetic - stored, REST, -kinetic))
    for function in (path.velocity, path.acceleration):
        if function is not None:
            function.x.array[:] = 0
    path.problem = problem
    still = {name: 0.0 * np.asarray(value) for name, value in notes.items()}
    found = {**still, **recorded(record, problem)}
    bounds, clear = certified_volume(problem), certified_clearance(problem)
    path.steps.append(Step(time, outcome, found, bounds, clear))
    path.end(f"At rest at t = {time:.6g} in {len(path.steps)} steps")
