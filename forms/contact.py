# SPDX-License-Identifier: MIT
"""What obstacles do to a body: pressure, gap, force, and how close it is. All collective.

Each takes a path, or its problem, and the name of an obstacle; without one, all of them.
"""

from __future__ import annotations

from functools import partial
from typing import Any

from petsc4py import PETSc

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from numpy.typing import NDArray

from . import _dolfinx
from ._types import Expr
from .barriers import Clearance
from .compilation import compiled
from .fields import Evaluation
from .insertion import assemble, create_matrix
from .kinematics import circumference, is_revolved
from .obstacles import Obstacle, obstacles_in
from .problems import Problem
from .variation import residual


def force(of: Any, name: str | None = None) -> NDArray[np.float64]:
    """Force that the body exerts on an obstacle.

    sum of the nodal forces -dB/du of the barrier's potential B on the body, times -1

    They are part of the residual, so that at equilibrium loads, supports and obstacles balance to
    rounding. ``record={"floor": forms.contact.recorder("floor")}`` keeps it with each step.

    Args:
        of: Path or its problem; at present values.
        name: Of the obstacle.

    Returns:
        Force [N], shape (3,), alike on all ranks: on a plane mesh per unit thickness, its third
        component 0. On a body of revolution (force in r around the ring, force along z, 0).

    Raises:
        ValueError: no problem, or none with such an obstacle.
    """
    problem = _problem(of, "force")
    form = _kept(problem, name, "force", lambda found: residual(_form(found), problem.u))
    problem.prepare()
    b = _dolfinx.create_vector(form)
    with b.localForm() as local:
        local.set(0)
    fem_petsc.assemble_vector(b, form)
    b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
    field = problem.displacement
    assert field is not None
    own = b.array_r[field.dofs].reshape(-1, field.components)
    total = np.zeros(3)
    total[: field.components] = problem.comm.allreduce(own.sum(axis=0))
    b.destroy()
    return total


def recorder(name: str | None = None) -> Any:
    """The force on an obstacle as a function of the problem, for ``record=``."""
    return partial(force, name=name)


def pressure(of: Any, name: str | None = None) -> fem.Function:
    """Contact pressure as a function, the L2 projection of the barrier's nodal forces.

    int p q dA = int -b'(d) q dA for all q

    on the boundaries where the obstacle acts, of the degree of the displacement. Point values of a
    barrier are not the pressure: where the boundary is coarse or curved they vary from point to
    point of a facet by as much as they are, and only their integrals balance. The projection goes
    beyond zero, by some percent, beside the edge of contact.

    Args:
        of: Path or its problem; at present values.
        name: Of the obstacle.

    Returns:
        Pressure [Pa] per reference area, a scalar of the whole body that is 0 away from the
        boundary.
    """
    problem = _problem(of, "pressure")
    field = problem.displacement
    assert field is not None
    mesh = problem.u.function_space.mesh
    V = _space(problem)
    found = _found(problem, name)
    v, w = ufl.TestFunction(V), ufl.TrialFunction(V)
    one = circumference(field.expression) if is_revolved(problem.forms.potential) else 1.0
    measures = dict.fromkeys(_plain(label.measure) for label, *_ in found)
    moments = _kept(problem, name, "pressure", lambda all: _slopes(all, v))
    mass = _kept(problem, name, "mass", lambda _: sum(one * v * w * ds for ds in measures))
    problem.prepare()
    A, b = create_matrix(mass), _dolfinx.create_vector(moments)
    assemble(A, mass, [])
    with b.localForm() as local:
        local.set(0)
    fem_petsc.assemble_vector(b, moments)
    b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
    # Rows away from the boundary are empty, and so are the moments: CG leaves the values there 0.
    p = fem.Function(V, name="contact_pressure")
    ksp = PETSc.KSP().create(mesh.comm)
    ksp.setOperators(A)
    ksp.setType("cg")
    ksp.getPC().setType("jacobi")
    ksp.setTolerances(rtol=1e-14, max_it=1000)
    ksp.solve(b, p.x.petsc_vec)
    p.x.scatter_forward()
    for item in (ksp, A, b):
        item.destroy()
    return p


def gap(of: Any, name: str | None = None) -> fem.Function:
    """Distance to the nearest of the obstacles as a function, to first order. Collective.

    phi / |grad phi| + gap at X + u, everywhere in the body, of the degree of the displacement.

    Args:
        of: Path or its problem; at present values.
        name: Of the obstacle.
    """
    problem = _problem(of, "gap")
    field = problem.displacement
    assert field is not None
    nearest: Expr = None
    for _, distance, _ in _found(problem, name):
        d = distance.ufl_operands[0]
        nearest = d if nearest is None else ufl.min_value(nearest, d)
    g = fem.Function(_space(problem), name="gap")
    Evaluation(nearest, g).update()
    return g


def clearance(of: Any) -> Clearance:
    """Smallest distance from any obstacle, at all points where one acts.

    Positive: no node and no point of the rules is beyond one. Between them, beside a curved
    obstacle of radius R, a facet of size h may reach h^2 / (32 R) deeper, less by the square of
    parts=, and what is thinner than their distance may stand between two points.

    Args:
        of: Path or its problem; at present values.

    Returns:
        Distance [m], place in the deformed body and name of the obstacle.
    """
    return _problem(of, "clearance").forms.barriers.clearance()


def _problem(of: Any, what: str) -> Problem:
    problem = getattr(of, "problem", of)
    if not isinstance(problem, Problem):
        raise ValueError(
            f"contact.{what} needs a path or a problem, got {type(of).__name__}: pass what "
            "forms.solve returned."
        )
    if not problem.forms.barriers:
        raise ValueError(
            f"contact.{what} needs a problem with an obstacle in its potential: add "
            "forms.obstacle(…) to it."
        )
    return problem


def _found(problem: Problem, name: str | None) -> list[tuple[Obstacle, Expr, Any]]:
    everything = obstacles_in(problem.forms.potential)
    found = [one for one in everything if name in (None, one[0].name)]
    if not found:
        names = ", ".join(dict.fromkeys(label.name for label, *_ in everything))
        raise ValueError(f"the problem has the obstacles {names}, got {name!r}.")
    return found


def _form(found: list[tuple[Obstacle, Expr, Any]]) -> ufl.Form:
    return ufl.Form(list(dict.fromkeys(integral for *_, integral in found)))


def _slopes(found: list[tuple[Obstacle, Expr, Any]], v: Expr) -> ufl.Form:
    """Moments of the pressure -db/dd."""
    integrals = []
    for _, distance, integral in found:
        slope = -ufl.diff(integral.integrand(), distance)
        integrals.append(integral.reconstruct(integrand=slope * v))
    return ufl.Form(integrals)


def _space(problem: Problem) -> fem.FunctionSpace:
    """Scalars of the displacement's degree, made once."""
    kept, field = problem.__dict__.setdefault("_contact", {}), problem.displacement
    assert field is not None
    if "space" not in kept:
        mesh = problem.u.function_space.mesh
        kept["space"] = fem.functionspace(mesh, ("Lagrange", field.degree))
    return kept["space"]


def _plain(ds: ufl.Measure) -> ufl.Measure:
    """A measure without the rule of obstacles."""
    return ds.reconstruct(metadata={})


def _kept(problem: Problem, name: str | None, what: str, make: Any) -> fem.Form:
    """A form that is compiled once for a problem and an obstacle."""
    kept = problem.__dict__.setdefault("_contact", {})
    if (name, what) not in kept:
        kept[name, what] = compiled(make(_found(problem, name)))
    return kept[name, what]
