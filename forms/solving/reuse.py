# SPDX-License-Identifier: MIT
"""Problems and solvers that are found again, so that a second solve sets nothing up.

A problem that a user made keeps its solver. Of those that calls make of a potential, an unknown and
supports the last one of each communicator is kept, and found while these are the same objects.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

from mpi4py import MPI

import numpy as np
from dolfinx import fem

from ..problems import Problem
from ..supports import Support
from .newton import Newton
from .options import SolverOptions
from .settings import Settings

_SAME = (MPI.IDENT, MPI.CONGRUENT)
_last: list[tuple[tuple[Any, ...], Problem]] = []
_in_use: list[Problem] = []


def problem_for(
    potential: Any,
    u: fem.Function | None,
    supports: Iterable[Support] | Support,
    virtual_work: Any,
) -> Problem:
    """The problem of a call: the one given, one made before, or a new one. Collective.

    Raises:
        ValueError: a problem was given together with what belongs to another, or a potential
            without an unknown; or as :class:`forms.Problem`.
    """
    if isinstance(supports, Support):
        supports = (supports,)
    supports = tuple(supports)
    if isinstance(potential, Problem):
        others = u not in (None, potential.u) or virtual_work is not None
        if others or (supports and supports != potential.supports):
            raise ValueError(
                "a problem comes with its unknown, supports and virtual work: pass it alone, or a "
                "potential with others."
            )
        return potential
    given = (potential, u, virtual_work, *supports)
    for known, problem in _last:
        if len(known) == len(given) and all(a is b for a, b in zip(known, given, strict=True)):
            return problem
    problem = Problem(potential, u, supports, virtual_work)  # type: ignore[arg-type]
    for entry in list(_last):
        # Another communicator's may not be freed here: its other ranks are elsewhere. One in use
        # is that of a path whose record or on_step solves something else.
        alike = MPI.Comm.Compare(entry[1].comm, problem.comm) in _SAME
        if alike and entry[1] not in _in_use:
            entry[1].destroy()
            _last.remove(entry)
    _last.append((given, problem))
    return problem


def newton_for(
    problem: Problem,
    options: Mapping[str, Any] | None,
    prefix: str,
    rtol: float,
    ctol: float,
    projection: str,
    settings: Settings | None,
    factorized: bool = False,
) -> Newton:
    """A problem's solver with these settings, as if it were new. Collective.

    With ``factorized`` the preset is MUMPS at any size, for paths past limit points, where the
    tangent is indefinite.
    """
    problem.begin()
    settings = settings or Settings()
    if factorized:
        most = {kind: np.iinfo(np.int64).max for kind in settings.split_from}
        settings = replace(settings, direct_up_to=np.iinfo(np.int64).max, split_from=most)
    if problem in _in_use:
        return Newton(problem, options, prefix, rtol, ctol, projection, settings)
    asked = SolverOptions(prefix, options).user
    given = (prefix, rtol, ctol, projection, asked, settings)
    if problem.solver is not None and problem.solver[0] != given:
        problem.destroy()
    if problem.solver is None:
        newton = Newton(problem, options, prefix, rtol, ctol, projection, settings)
        problem.solver = given, newton
    else:
        newton = problem.solver[1]
        newton.begin()
    _in_use.append(problem)
    return newton


def solver_of(problem: Problem) -> tuple[Newton, bool]:
    """The solver that the last solve has left, and whether it is kept. Collective.

    Of a problem without one a new one, that is kept; in the midst of a path, as in ``record``, one
    of its own, which is the caller's to destroy.
    """
    if problem in _in_use:
        return Newton(problem), False
    if problem.solver is None:
        release(newton_for(problem, None, "variform_", 1e-8, 1e-6, "auto", None), sound=True)
    return problem.solver[1], True


def release(newton: Newton, sound: bool) -> None:
    """End the use of a solver: kept by its problem if the last solve ended well. Collective."""
    problem = newton.problem
    newton.rest()
    if problem.solver is None or problem.solver[1] is not newton:
        newton.destroy()
        return
    _in_use.remove(problem)
    if not sound:
        problem.destroy()
