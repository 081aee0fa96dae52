# SPDX-License-Identifier: MIT
"""What contact does to a body: pressure, gap, force, and how close it is. All collective.

Each takes a path, or its problem, and the name of an obstacle, or of a contact of surfaces; without
one, all of them.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from petsc4py import PETSc

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from numpy.typing import NDArray

from . import _checks, _dolfinx
from ._types import Expr
from .barriers import Clearance
from .boundaries import entities
from .compilation import compiled
from .fields import Evaluation
from .insertion import assemble, create_matrix
from .kinematics import circumference, is_revolved
from .obstacles import Obstacle, obstacles_in
from .problems import Problem
from .surface_contact import Touching
from .variation import residual

Found = tuple[Obstacle, Expr, Any]


def force(of: Any, on: str | NDArray[np.int32] | None = None) -> NDArray[np.float64]:
    """Force that the body exerts on an obstacle, or that a part of its boundary exerts.

    sum of the nodal forces -dB/du of the barrier's potential B on the body, times -1

    They are part of the residual, so that at equilibrium loads, supports and obstacles balance to
    rounding. ``record={"floor": forms.contact.recorder("floor")}`` keeps it with each step.

    Args:
        of: Path or its problem; at present values.
        on: Name of the obstacle; None for all. Or facets of a boundary, as body.facets("lower"),
            for what their nodes exert on surfaces and obstacles: the forces of a contact of
            surfaces as a whole add up to 0.

    Returns:
        Force [N], shape (3,), alike on all ranks: on a plane mesh per unit thickness, its third
        component 0. On a body of revolution (force in r around the ring, force along z, 0).

    Raises:
        ValueError: no problem, or none with such a contact.
    """
    problem = _problem(of, "force")
    name = on if isinstance(on, str) else None
    obstacles, surfaces = _found(problem, name)
    problem.prepare()
    b = problem.create_vector()
    with b.localForm() as local:
        local.set(0)
    if obstacles:
        form = _kept(problem, name, "force", lambda: residual(_form(obstacles), problem.u))
        fem_petsc.assemble_vector(b, form)
    for term in surfaces:
        term.residual(b)
    b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
    field = problem.displacement
    assert field is not None
    nodes: NDArray = np.arange(len(field.dofs) // field.components)
    if on is not None and name is None:
        nodes = np.intersect1d(nodes, _nodes(problem, on))
    own = b.array_r[field.dofs].reshape(-1, field.components)[nodes]
    total = np.zeros(3)
    total[: field.components] = problem.comm.allreduce(own.sum(axis=0))
    b.destroy()
    return total


def recorder(on: str | NDArray[np.int32] | None = None) -> Any:
    """The force on an obstacle, or of a boundary, as a function of the problem, for ``record=``."""
    return partial(force, on=on)


def pressure(of: Any, name: str | None = None) -> fem.Function:
    """Contact pressure as a function, the L2 projection of the barrier's nodal forces.

    int p q dA = int -b'(d) q dA for all q; of surfaces p = t . n, int t . v dA = sum f . v

    on the boundaries where it acts, of the degree of the displacement. Point values of a barrier
    are not the pressure: where the boundary is coarse or curved they vary from point to point of a
    facet by as much as they are, and only their integrals balance. The projection goes beyond zero,
    by some percent, beside the edge of contact. f are the forces at the nodes, n the normals of the
    deformed surface there.

    Args:
        of: Path or its problem; at present values.
        name: Of the obstacle, or of the contact of surfaces.

    Returns:
        Pressure [Pa] per reference area, a scalar of the whole body that is 0 away from the
        boundary. Of a sheet it is the magnitude of t, the difference of what presses on its sides.
    """
    problem = _problem(of, "pressure")
    field = problem.displacement
    assert field is not None
    V, numbers = _space(problem)
    obstacles, surfaces = _found(problem, name)
    v, w = ufl.TestFunction(V), ufl.TrialFunction(V)
    one = circumference(field.expression) if is_revolved(problem.forms.potential) else 1.0
    where = [label.measure for label, *_ in obstacles]
    where += [measure for term in surfaces for measure in term.measures]
    measures = _union(V.mesh, where)
    mass = _kept(problem, name, "mass", lambda: sum(one * v * w * ds for ds in measures))
    problem.prepare()
    A, moments, p = create_matrix(mass), fem.Function(V), fem.Function(V, name="contact_pressure")
    assemble(A, mass, [])
    b = moments.x.petsc_vec
    if obstacles:
        form = _kept(problem, name, "pressure", lambda: _slopes(obstacles, v))
        fem_petsc.assemble_vector(b, form)
        b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
    # Rows away from the boundary are empty, and so are the moments: CG leaves the values there 0.
    ksp = PETSc.KSP().create(problem.comm)
    ksp.setOperators(A)
    ksp.setType("cg")
    ksp.getPC().setType("jacobi")
    ksp.setTolerances(rtol=1e-14, max_it=1000)
    ksp.solve(b, p.x.petsc_vec)
    for term in surfaces:
        # Not magnitudes at the points, whose signs alternate where dhat is longer than the pieces.
        forces, traction = _put(problem, 0.0, term.surface.own_forces(term.forces())), []
        for axis in range(field.components):
            moments.x.array[:] = forces[numbers + axis]
            t = fem.Function(V)
            ksp.solve(b, t.x.petsc_vec)
            traction.append(t.x.array.copy())
        vectors = np.stack(traction, axis=1)
        if V.mesh.topology.dim < field.components:
            p.x.array[:] += np.linalg.norm(vectors, axis=1)
        else:
            p.x.array[:] += np.sum(vectors * _normals(problem, V, name, where), axis=1)
    p.x.scatter_forward()
    for item in (ksp, A):
        item.destroy()
    return p


def gap(of: Any, name: str | None = None) -> fem.Function:
    """Distance to the nearest obstacle or other surface as a function. Collective.

    phi / |grad phi| + gap at X + u of obstacles, to first order, everywhere in the body; of
    surfaces the distance of the pieces about each node, dhat where nothing is nearer.

    Args:
        of: Path or its problem; at present values.
        name: Of the obstacle, or of the contact of surfaces.

    Returns:
        Distance [m], of the degree of the displacement.
    """
    problem = _problem(of, "gap")
    V, numbers = _space(problem)
    obstacles, surfaces = _found(problem, name)
    g = fem.Function(V, name="gap")
    if obstacles:
        nearest: Expr = None
        for _, distance, _ in obstacles:
            d = distance.ufl_operands[0]
            nearest = d if nearest is None else ufl.min_value(nearest, d)
        Evaluation(nearest, g).update()
    else:
        g.x.array[:] = max(term.dhat for term in surfaces)
    problem.prepare()
    for term in surfaces:
        found = _put(problem, np.inf, term.surface.own_values(term.gaps()))[numbers]
        g.x.array[:] = np.minimum(g.x.array, found)
    g.x.scatter_forward()
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
    surfaces = what != "clearance" and any(isinstance(each, Touching) for each in problem.terms)
    if not (problem.forms.barriers or surfaces):
        raise ValueError(
            f"contact.{what} needs a problem with an obstacle in its potential: add "
            "forms.obstacle(…) to it."
        )
    return problem


def _found(problem: Problem, name: str | None) -> tuple[list[Found], list[Touching]]:
    """Obstacles and contacts of surfaces of a name; all of them without."""
    obstacles = obstacles_in(problem.forms.potential)
    surfaces = [term for term in problem.terms if isinstance(term, Touching)]
    found = [one for one in obstacles if name in (None, one[0].name)]
    touching = [term for term in surfaces if name in (None, term.name)]
    if not (found or touching):
        names = [label.name for label, *_ in obstacles] + [term.name for term in surfaces]
        raise ValueError(
            f"the problem has the contacts {', '.join(dict.fromkeys(names))}, got {name!r}."
        )
    return found, touching


def _form(found: list[Found]) -> ufl.Form:
    return ufl.Form(list(dict.fromkeys(integral for *_, integral in found)))


def _slopes(found: list[Found], v: Expr) -> ufl.Form:
    """Moments of the pressure -db/dd."""
    integrals = []
    for _, distance, integral in found:
        slope = -ufl.diff(integral.integrand(), distance)
        integrals.append(integral.reconstruct(integrand=slope * v))
    return ufl.Form(integrals)


def _space(problem: Problem) -> tuple[fem.FunctionSpace, NDArray[np.int32]]:
    """Scalars of the displacement's degree, and their nodes' first components; made once."""
    kept, field = problem.__dict__.setdefault("_contact", {}), problem.displacement
    assert field is not None
    if "space" not in kept:
        kept["space"] = _dolfinx.collapse(field.view.sub(0))
    return kept["space"]


def _normals(problem: Problem, V: fem.FunctionSpace, name: str | None, where: Any) -> NDArray:
    """Unit normals of the deformed boundary at the nodes of scalars V, shape (n, dim). Collective.

    Areas int cof F N q dA of the linear elements' functions q, which all are positive.
    """
    kept, field, mesh = problem.__dict__.setdefault("_contact", {}), problem.displacement, V.mesh
    assert field is not None
    dim = field.components
    if "linear" not in kept:
        kept["linear"] = fem.functionspace(mesh, ("Lagrange", 1, (dim,)))
    F = ufl.Identity(dim) + ufl.grad(field.expression)
    area = ufl.det(F) * ufl.inv(F).T * ufl.FacetNormal(mesh)
    v = ufl.TestFunction(kept["linear"])

    def areas() -> ufl.Form:
        return sum(ufl.inner(area, v) * ds(degree=2 * field.degree) for ds in _union(mesh, where))

    A, n = fem.Function(kept["linear"]), fem.Function(V)
    b = A.x.petsc_vec
    fem_petsc.assemble_vector(b, _kept(problem, name, "areas", areas))
    b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
    A.x.scatter_forward()
    found = []
    for axis in range(dim):
        n.interpolate(A.sub(axis).collapse())
        n.x.scatter_forward()
        found.append(n.x.array.copy())
    normals = np.stack(found, axis=1)
    return normals / np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None]


def _put(problem: Problem, rest: float, own: tuple[NDArray, NDArray]) -> NDArray:
    """Numbers of this rank's nodes and values there, as an array of the unknown with ghosts."""
    carrier = fem.Function(problem.u.function_space)
    carrier.x.array[:] = rest
    carrier.x.array[own[0]] = own[1]
    carrier.x.scatter_forward()
    return np.asarray(carrier.x.array)


def _nodes(problem: Problem, facets: Any) -> NDArray[np.int32]:
    """Local numbers of the displacement's nodes on facets. Collective."""
    field, mesh = problem.displacement, problem.u.function_space.mesh
    assert field is not None
    dim = mesh.topology.dim - 1
    found = _checks.entities(mesh, facets, dim, "a force of contact")
    mesh.topology.create_connectivity(dim, mesh.topology.dim)
    return fem.locate_dofs_topological(field.collapsed[0], dim, found)


def _union(mesh: Any, measures: list[ufl.Measure]) -> list[ufl.Measure]:
    """Measures of all that some are of, each facet and each cell once."""
    found = []
    for kind in dict.fromkeys(each.integral_type() for each in measures):
        mine = [entities(mesh, each) for each in measures if each.integral_type() == kind]
        every = np.unique(np.concatenate(mine), axis=0).ravel()
        found.append(ufl.Measure(kind, domain=mesh, subdomain_data=[(1, every)])(1))
    return found


def _kept(problem: Problem, name: str | None, what: str, make: Callable[[], ufl.Form]) -> fem.Form:
    """A form that is compiled once for a problem and a contact."""
    kept = problem.__dict__.setdefault("_contact", {})
    if (name, what) not in kept:
        kept[name, what] = compiled(make())
    return kept[name, what]
