# SPDX-License-Identifier: MIT
"""The shape at rest of a body that is known under load, found in one solve, and loaded again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray
from ufl.algorithms.analysis import extract_coefficients, extract_type

from .. import _dolfinx
from .._parallel import bounding_box
from ..native import jit
from ..paths import NotConverged, Path
from ..points import Representer
from ..problems import Problem
from ..rest import nodes_of, on_given_shape
from .following import follow, solve

Array = NDArray[np.float64]
EXACT: dict[str, Any] = {"rtol": 1e-11, "ctol": 1e-10}
TURNS = 30  # of directions that are carried along
STILL = 1e-12  # change of a direction at which they stand still


@dataclass(eq=False)
class Unloaded:
    """Outcome of :func:`forms.unload`. The mesh is at rest; u leads from there to the given places.

    Attributes:
        path: Path of the rest shape's solve, over the load factor.
        given: Places of the mesh's nodes that were given, shape (nodes, 3) of this rank.
        again: Path of loading the body at rest; None where it was not asked for.
        distance: Largest distance of a node, loaded again, from its given place, over the body's
            size; NaN where it was not asked for.
        turns: How often directions that are carried along were taken anew.
    """

    path: Path
    given: Array
    again: Path | None = None
    distance: float = float("nan")
    turns: int = 0


def unload(
    problem: Problem,
    t: fem.Constant,
    to: float = 1.0,
    *,
    carried: Sequence[fem.Function] | fem.Function = (),
    check: bool = True,
    step: float | None = None,
    progress: bool = True,
    **tolerances: Any,
) -> Unloaded:
    """Find the shape at rest of a body whose mesh is its shape under load. Collective.

    R(u; X)[v] = 0 for the places at rest X, with X + u(X) = x given at every node

    The problem is written as for a body at rest: energy, loads, supports. It is solved with the
    mesh's places as those under load (the unknown is u as a function of them), while t goes to its
    value; then the mesh is moved to the places at rest, where u, the problem and its forms hold as
    they were written. Loads are those of the body at rest: a dead traction is a force per area
    there, a follower pressure is one in either shape. Loads at points and lines, which are given
    where these are in the loaded shape, move with the body and keep their forces.

    Args:
        problem: Of a potential and virtual works in UFL; the mesh in its loaded shape, of the order
            of the displacements.
        t: Load factor, 0 where the body is at rest.
        to: Its value in the shape that is given.
        carried: Functions with directions that are known in the loaded shape, as fibers from an
            image: they become those at rest, f a / |f a|, f = dX/dx.
        check: Load the body at rest again, and compare.
        step: First step of t; by default a tenth of the way.
        progress: Show a progress bar on rank 0.
        **tolerances: rtol and ctol of the solves, 1e-11 and 1e-10 by default.

    Returns:
        The path, the given places, and how well they are met again.

    Raises:
        ValueError: displacements of another degree than the mesh, terms that are no forms, loads
            on the rim of a surface, supports that turn, directions of another kind.
        NotConverged: no shape at rest beyond a load factor, which is told; the mesh is as it was.

    Source: Govindjee, Mihalic, Comput. Methods Appl. Mech. Engrg. 136 (1996) 47-57.
    """
    field = _checked(problem, t)
    given = [carried] if isinstance(carried, fem.Function) else list(carried)
    u, mesh = problem.u, problem.u.function_space.mesh
    for a in given:
        if a.function_space.mesh is not mesh or a.ufl_shape != (mesh.geometry.dim,):
            raise ValueError(
                f"what unload carries along are directions of {mesh.geometry.dim} components on "
                f"the problem's mesh, got {a.name} of shape {a.ufl_shape}."
            )
    nodes_of(u, field)  # refuses meshes of another order
    exact = {**EXACT, **tolerances}
    inverse = Problem(on_given_shape(problem.forms.residual_ufl, field), u, problem.supports)
    start = u.x.array.copy()
    known, turns = np.array(mesh.geometry.x, float), 0
    loaded = [a.x.array.copy() for a in given]
    # Directions turn back with the body: each solve takes those that the last one led to.
    turned = [_turned(a, field.expression, values) for a, values in zip(given, loaded, strict=True)]
    try:
        path = follow(inverse, t=t, to=to, step=step, progress=progress, **exact)
        while given and _carried(given, turned) > STILL:
            if (turns := turns + 1) > TURNS:
                raise NotConverged("the directions that are carried along do not come to rest.")
            path.steps[-1:] = solve(inverse, load=to, **exact).steps
    except NotConverged as error:
        for a, values in zip(given, loaded, strict=True):
            a.x.array[:] = values
        u.x.array[:] = start
        raise NotConverged(
            f"no shape at rest is found beyond load factor {float(t.value):.6g}: {error}"
        ) from error
    finally:
        inverse.destroy()
    mesh.geometry.x[:] -= nodes_of(u, field)
    for load in extract_coefficients(problem.forms.residual_ufl):
        if isinstance(load, Representer):
            load.renew()
    problem.destroy()
    found = Unloaded(path, known, turns=turns)
    if check:
        _load_again(found, problem, t, to, step, exact, progress)
    return found


def _checked(problem: Any, t: Any) -> Any:
    """The displacement of a problem that can be unloaded."""
    if not isinstance(problem, Problem):
        raise ValueError(f"unload needs a forms.Problem, got {type(problem).__name__}.")
    if not isinstance(t, fem.Constant):
        raise ValueError(f"unload needs a load factor, got {type(t).__name__}.")
    if problem.displacement is None:
        raise ValueError(f"unload needs a displacement, got the unknown {problem.u.name}.")
    if len(problem.terms) > 1:
        raise ValueError(
            "unload needs a problem of UFL forms alone, got one with other terms: it cannot write "
            "them in the loaded shape."
        )
    for part in (part for support in problem.supports for part in support.parts):
        written = None if part.expression is None else part.expression.ufl_expression
        if written is not None and extract_type(written, ufl.classes.SpatialCoordinate):
            raise ValueError(
                "unload needs supports whose values do not depend on places, which it moves: hold "
                "by clamp, roller, pin or translate."
            )
    return problem.displacement


def _turned(a: fem.Function, u: Any, values: Array) -> tuple[fem.Expression, fem.Function]:
    """Expression of a direction at rest, f a / |f a|, and the function of the loaded one in it."""
    was = fem.Function(a.function_space, name=a.name)
    was.x.array[:] = values
    f = ufl.Identity(len(u)) - ufl.grad(u)
    moved = ufl.dot(f, was)
    length = ufl.sqrt(ufl.inner(moved, moved))
    points = _dolfinx.interpolation_points(a.function_space)
    return jit.expression(moved / length, points, a.function_space.mesh), was


def _carried(given: list[fem.Function], rules: list[tuple[fem.Expression, Any]]) -> float:
    """Give functions their directions at rest; the largest change of an entry. Collective."""
    change = 0.0
    for a, (rule, _) in zip(given, rules, strict=True):
        before = a.x.array.copy()
        a.interpolate(rule)
        a.x.scatter_forward()
        change = max(change, float(np.abs(a.x.array - before).max(initial=0.0)))
    return float(given[0].function_space.mesh.comm.allreduce(change, MPI.MAX))


def _load_again(
    found: Unloaded,
    problem: Problem,
    t: fem.Constant,
    to: float,
    step: float | None,
    exact: dict[str, Any],
    progress: bool,
) -> None:
    """Load the body at rest, and measure how far its nodes are from the given places."""
    u, mesh, field = problem.u, problem.u.function_space.mesh, problem.displacement
    assert field is not None
    u.x.array[:], t.value = 0.0, 0.0
    found.again = follow(problem, t=t, to=to, step=step, progress=progress, **exact)
    off = mesh.geometry.x + nodes_of(u, field) - found.given
    low, high = bounding_box(mesh.comm, found.given)
    worst = mesh.comm.allreduce(float(np.linalg.norm(off, axis=1).max(initial=0.0)), MPI.MAX)
    found.distance = worst / float(np.linalg.norm(high - low))
