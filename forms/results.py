# SPDX-License-Identifier: MIT
"""Numbers read off a solution: reactions, values at points, volume, smallest J. All collective."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mpi4py import MPI

import basix
import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray
from ufl.algorithms import estimate_total_polynomial_degree, expand_derivatives

from . import _checks
from ._parallel import bounding_box
from ._types import Expr
from .compilation import compiled as compile_form
from .differentiation import update_dependents
from .fields import quadrature_degrees
from .loads import with_kinematics
from .native import jit
from .points import cells_at, require_inside
from .problems import Problem
from .supports import Support, near, nodes_at
from .unknowns import Field, displacement_field, is_mixed

Array = NDArray[np.float64]


def resultant(
    problem: Problem | Any,
    facets: Any,
    about: Sequence[float] = (0, 0, 0),
    dim: int | None = None,
) -> tuple[Array, Array]:
    """Force and moment that supports exert on the body through a boundary, a line, at points.

    force = sum_a R_a,  moment = sum_a (X_a + u_a - c) x R_a  over the nodes a

    R is the residual without boundary conditions, so the resultants are consistent: they balance
    the loads to rounding, and converge twice as fast as integrated stresses. A node on the edge of
    two supports counts for both.

    Args:
        problem: Path, or its problem, at a converged state.
        facets: Where: local facet indices of a boundary; or those of entities of dimension dim; or
            a support, of which the held components, or directions, count; or the
            position of a node, or of several, shape (k, 3).
        about: Point c that the moment is taken about [m].
        dim: Dimension of the entities, 1 for the edges of a solid, its own for cells of a region,
            whose nodes all count; by default that of facets.

    Returns:
        Force [N] and moment [N m], shape (3,) each, alike on all ranks. On a plane mesh the third
        force and the first two moments are 0, and both are per unit thickness.

    Raises:
        ValueError: no problem, no facets on any rank, no node at a point, or a point of another
            dimension.
    """
    problem = _problem(problem, "resultant")
    mesh = problem.u.function_space.mesh
    gdim = mesh.geometry.dim
    if np.shape(about) not in ((gdim,), (3,)):
        raise ValueError(f"about is a point of {gdim} coordinates, got {about}.")
    if dim is not None and dim not in range(mesh.topology.dim + 1):
        raise ValueError(f"this mesh has entities of dimension 0 to {gdim}, got dim = {dim}.")
    center = np.zeros(3)
    center[: len(about)] = about
    W, numbers = _displacement(problem).collapsed
    counted = _counted(problem, W, numbers, facets, dim)
    count = W.dofmap.index_map.size_local
    R, x = np.zeros((count, 3)), np.zeros((count, 3))
    parent = numbers[: count * gdim].reshape(count, gdim)
    R[:, :gdim] = _selected(counted, _residual(problem)[parent])
    x[:] = W.tabulate_dof_coordinates()[:count]
    x[:, :gdim] += problem.u.x.array[parent]
    x -= center
    local = np.concatenate([R.sum(axis=0), np.cross(x, R).sum(axis=0)])
    total = problem.comm.allreduce(local)
    return total[:3], total[3:]


def nodal_forces(problem: Problem | Any) -> fem.Function:
    """Residual of the displacement as a function: the force [N] at each node. Collective.

    At a converged state it is what supports exert on the body, and 0, to the solve's tolerance, at
    the other nodes; at any other state the forces that are out of balance, too. For files and
    pictures, and to see where a solve that failed was out of balance.

    Args:
        problem: Path, or its problem; evaluated at the present state.

    Returns:
        Function of the displacement's space whose values are forces and no densities: their sum is
        the resultant.
    """
    problem = _problem(problem, "nodal_forces")
    W, numbers = _displacement(problem).collapsed
    f = fem.Function(W, name="nodal_forces")
    owned = W.dofmap.index_map.size_local * W.dofmap.bs
    f.x.array[:owned] = _residual(problem)[numbers[:owned]]
    f.x.scatter_forward()
    return f


def _problem(problem: Any, what: str) -> Problem:
    found = getattr(problem, "problem", problem)
    if not isinstance(found, Problem):
        name = getattr(found, "name", "") if isinstance(found, fem.Function) else ""
        raise ValueError(
            f"{what} needs a path or a problem, whose residual it reads, got "
            f"{' '.join([type(found).__name__, name]).rstrip()}: pass what forms.solve returned."
        )
    return found


def _displacement(problem: Problem) -> Field:
    if problem.displacement is None:
        raise ValueError(f"forces act on a displacement, and {problem.u.name} has none.")
    return problem.displacement


def _residual(problem: Problem) -> Array:
    """Owned part of the residual without boundary conditions. Collective."""
    b = problem.create_vector()
    problem.residual(b)
    values = np.array(b.array_r)
    b.destroy()
    return values


def _counted(
    problem: Problem, W: fem.FunctionSpace, numbers: NDArray[np.int32], where: Any, dim: int | None
) -> Array | NDArray[np.bool_]:
    """What of owned nodes counts for a resultant: components, shape (nodes, components).

    Of a support along directions n of its own it is n n^T, shape (nodes, components, components).
    """
    mesh, count, components = W.mesh, W.dofmap.index_map.size_local, W.dofmap.bs
    if isinstance(where, Support):
        if where.space != problem.u.function_space:
            raise ValueError(
                "resultant needs a support of the problem's unknown, got one of another: make it "
                "with the unknown that was solved for."
            )
        if (slant := where.slant) is not None:
            place = np.full(numbers.max(initial=-1) + 1, count)
            place[numbers[: count * components : components]] = np.arange(count)
            at = place[slant.dofs[:, 0]]
            own, along = at < count, np.zeros((count, components, components))
            along[at[own]] = np.einsum("ni,nj->nij", *2 * [slant.normals[own]])
            return along
        held = np.concatenate([bc.dof_indices()[0] for bc in where.conditions])
        return np.isin(numbers[: count * components], held).reshape(count, components)
    nodes = np.zeros(count, dtype=bool)
    if _is_position(where):
        at = nodes_at(W, where, "resultant")
        size = np.abs(bounding_box(mesh.comm, mesh.geometry.x)).max()
        nodes = near(W.tabulate_dof_coordinates()[:count], at, 1e-9 * size)
    else:
        dim = mesh.topology.dim - 1 if dim is None else dim
        found = _checks.entities(mesh, where, dim, "a support")
        mesh.topology.create_connectivity(dim, mesh.topology.dim)
        located = fem.locate_dofs_topological(W, dim, found)
        nodes[located[located < count]] = True
    return np.repeat(nodes[:, None], components, axis=1)


def _selected(counted: Array | NDArray[np.bool_], values: Array) -> Array:
    """What counts of values, shape (nodes, components)."""
    if counted.ndim == 2:
        return np.where(counted, values, 0.0)
    return np.asarray(np.einsum("nij,nj->ni", counted, values))


def _is_position(where: Any) -> bool:
    """Whether a place is given by coordinates, and not by the numbers of entities."""
    if not isinstance(where, list | tuple | np.ndarray):
        return False
    try:
        array = np.asarray(where)
    except ValueError:
        return False
    return array.size > 0 and (array.dtype.kind == "f" or array.ndim == 2)


def at(f: fem.Function, point: Sequence[float], tolerance: float = 1e-8) -> Array:
    """Value of a function at a point of the reference body, alike on all ranks.

    Args:
        f: Function, as a displacement or the outcome of :func:`forms.field`; for a mixed unknown
            its ``displacement_of(w)``.
        point: Coordinates in the reference body [m].
        tolerance: Distance from the mesh, relative to its size, at which a point still counts as
            on it (curved boundaries, rounding).

    Returns:
        Value, shape of the function (a scalar has shape (1,)).

    Raises:
        ValueError: the point lies outside the mesh or has too few coordinates, or f is no function
            of one space.
    """
    if is_mixed(_checks.function(f, "at").function_space):
        raise ValueError("at needs a function of one space: pass displacement_of(w), not w.")
    mesh = f.function_space.mesh
    if len(point) != mesh.geometry.dim:
        raise ValueError(f"a point of this mesh has {mesh.geometry.dim} coordinates, got {point}.")
    x = np.zeros((1, 3))
    x[0, : len(point)] = point
    cells, distance = cells_at(mesh, x)
    require_inside(mesh, x, distance, tolerance, "the point")
    here = cells[0] >= 0
    rank = mesh.comm.allreduce(mesh.comm.rank if here else 0)
    value = f.eval(x, cells) if here else None
    return np.atleast_1d(mesh.comm.bcast(value, root=rank))


def displacement_of(u: fem.Function) -> fem.Function:
    """The displacement of an unknown: u itself, or a copy of that field of a mixed one."""
    field = displacement_field(_checks.function(u, "displacement_of"))
    if field is None or field.place is None:
        return u
    W, numbers = field.collapsed
    f = fem.Function(W, name="displacement")
    f.x.array[:] = u.x.array[numbers]
    return f


def integral(form: ufl.Form) -> float:
    """Value of a functional, summed over all ranks.

    Integrals without a quadrature degree get the default of all that is compiled
    (:func:`forms.quadrature.with_quadrature`): of a potential it is the value that a solve lowers.
    """
    if not isinstance(form, ufl.Form):
        raise ValueError(
            f"integral needs a functional, got {type(form).__name__}: integrate a density with dx."
        )
    _checks.arity(form, 0, "integral needs a functional")
    (form,) = with_kinematics(form)
    # A component of a cross product, say, that is zero already as an expression.
    if expand_derivatives(form).empty():
        return 0.0
    update_dependents(form)
    compiled = compile_form(form)
    return float(compiled.mesh.comm.allreduce(fem.assemble_scalar(compiled)))


def volume(F: Expr, dx: ufl.Measure) -> float:
    """Deformed volume int J dV [m^3]; on a plane mesh per unit thickness.

    Exact on straight cells: J is a polynomial, and dx without a degree gets J's.
    """
    J = ufl.det(F)
    if "quadrature_degree" not in dx.metadata():
        degree = estimate_total_polynomial_degree(expand_derivatives(J))
        dx = dx(metadata={**dx.metadata(), "quadrature_degree": degree})
    return integral(J * dx)


def smallest_volume_ratio(F: Expr, mesh: Any, degree: int = 4) -> float:
    """Smallest J = det F over the quadrature points of all cells.

    It may be smaller between them; :func:`forms.validity.volume_bounds` bounds it everywhere.

    Args:
        F: Deformation gradient.
        mesh: Mesh, or an object with a ``mesh``.
        degree: Degree of the quadrature rule whose points are looked at; in plane stress that of
            the thickness stretch.
    """
    mesh = _checks.mesh_of(mesh)
    cell = getattr(basix.CellType, mesh.topology.cell_name())
    at_points = quadrature_degrees(F)
    points, _ = basix.make_quadrature(cell, max(at_points, default=degree))
    update_dependents(F)
    owned = np.arange(mesh.topology.index_map(mesh.topology.dim).size_local, dtype=np.int32)
    values = jit.expression(ufl.det(F), points, mesh).eval(mesh, owned)
    return float(mesh.comm.allreduce(float(np.min(values, initial=np.inf)), MPI.MIN))
