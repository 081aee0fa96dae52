# SPDX-License-Identifier: MIT
"""Numbers read off a solution: reactions, values at points, volume, smallest J. All collective."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mpi4py import MPI

import basix
import numpy as np
import ufl
from dolfinx import fem, geometry
from numpy.typing import NDArray
from ufl.algorithms import estimate_total_polynomial_degree, expand_derivatives

from . import _checks, _dolfinx
from ._parallel import bounding_box
from ._types import Expr
from .compilation import compiled as compile_form
from .differentiation import update_dependents
from .fields import quadrature_degrees
from .loads import with_kinematics
from .native import jit
from .problems import Problem
from .unknowns import displacement_field, is_mixed

Array = NDArray[np.float64]


def resultant(
    problem: Problem | Any, facets: NDArray[np.int32], about: Sequence[float] = (0, 0, 0)
) -> tuple[Array, Array]:
    """Force and moment that a support exerts on the body through a boundary.

    force = sum_a R_a,  moment = sum_a (X_a + u_a - c) x R_a  over the boundary's nodes a

    R is the residual without boundary conditions, so the resultants are consistent: they balance
    the loads to rounding, and converge twice as fast as integrated stresses. A node on the edge of
    two supports counts for both.

    Args:
        problem: Path, or its problem, at a converged state.
        facets: Local facet indices of the boundary.
        about: Point c that the moment is taken about [m].

    Returns:
        Force [N] and moment [N m], shape (3,) each, alike on all ranks. On a plane mesh the third
        force and the first two moments are 0, and both are per unit thickness.

    Raises:
        ValueError: no facets on any rank, or a point of another dimension.
    """
    problem = getattr(problem, "problem", problem)
    V = problem.u.function_space
    if np.shape(about) not in ((V.mesh.geometry.dim,), (3,)):
        raise ValueError(f"about is a point of {V.mesh.geometry.dim} coordinates, got {about}.")
    center = np.zeros(3)
    center[: len(about)] = about
    facets = _checks.facets(V.mesh, facets)
    b = problem.create_vector()
    problem.residual(b)
    field = problem.displacement
    if field is None:
        raise ValueError(f"forces act on a displacement, and {problem.u.name} has none.")
    W, numbers = field.collapsed
    dim = W.mesh.geometry.dim
    nodes = _owned_nodes(W, facets)
    dofs = nodes[:, None] * dim + np.arange(dim)
    parent = numbers[dofs]
    R, x = np.zeros((len(nodes), 3)), np.zeros((len(nodes), 3))
    R[:, :dim] = b.array_r[parent]
    b.destroy()
    x[:] = W.tabulate_dof_coordinates()[nodes]
    x[:, :dim] += problem.u.x.array[parent]
    x -= center
    local = np.concatenate([R.sum(axis=0), np.cross(x, R).sum(axis=0)])
    total = problem.comm.allreduce(local)
    return total[:3], total[3:]


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
    cell, distance = _closest_cell(mesh, x)
    nearest, rank = mesh.comm.allreduce((distance, mesh.comm.rank), MPI.MINLOC)
    low, high = bounding_box(mesh.comm, mesh.geometry.x)
    if nearest > tolerance * np.linalg.norm(high - low):
        raise ValueError(
            f"the point {tuple(float(c) for c in point)} lies {nearest:.3g} outside the mesh; "
            "give reference coordinates."
        )
    value = f.eval(x, [cell]) if mesh.comm.rank == rank else None
    return np.atleast_1d(mesh.comm.bcast(value, root=rank))


def displacement_of(u: fem.Function) -> fem.Function:
    """The displacement of an unknown: u itself, or a copy of that field of a mixed one."""
    field = displacement_field(_checks.function(u, "displacement_of"))
    if field is None or field.place is None:
        return u
    f = u.sub(field.place).collapse()
    f.name = "displacement"
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


def _owned_nodes(W: fem.FunctionSpace, facets: NDArray[np.int32]) -> NDArray[np.int32]:
    nodes = fem.locate_dofs_topological(W, W.mesh.topology.dim - 1, facets)
    return nodes[nodes < W.dofmap.index_map.size_local]


def _closest_cell(mesh: Any, x: Array) -> tuple[int, float]:
    """Nearest owned cell to a point, and its distance; local."""
    dim = mesh.topology.dim
    owned = np.arange(mesh.topology.index_map(dim).size_local, dtype=np.int32)
    if not len(owned):
        return -1, np.inf
    tree = _dolfinx.bounding_boxes(mesh, dim, owned)
    middles = geometry.create_midpoint_tree(mesh, dim, owned)
    found = geometry.compute_collisions_points(tree, x)
    inside = geometry.compute_colliding_cells(mesh, found, x).links(0)
    if len(inside):
        return int(inside[0]), 0.0
    cell = geometry.compute_closest_entity(tree, middles, mesh, x)
    # Typed as a list in DOLFINx 0.9, which takes arrays only.
    squared = geometry.squared_distance(mesh, dim, cell, x)  # type: ignore[arg-type]
    return int(cell[0]), float(np.sqrt(squared[0]))
