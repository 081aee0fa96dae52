# SPDX-License-Identifier: MIT
"""Supports: displacements, or other fields, prescribed on named boundaries.

A support's value may be any UFL expression of the reference point and of the load factor; it is
evaluated anew at each load. ``facets`` are local facet indices, as ``body.facets("left")``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from numbers import Real
from typing import Any

import numpy as np
import ufl
from dolfinx import default_scalar_type, fem
from dolfinx.mesh import entities_to_geometry
from numpy.typing import NDArray
from ufl.algorithms.analysis import extract_constants, extract_type

from . import _checks, _dolfinx
from ._parallel import bounding_box
from ._types import Expr
from .directions import Slant, coordinate_axis, slant
from .native import jit
from .unknowns import Field, field_of

Facets = NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class Prescribed:
    """One boundary condition of a support: the whole vector, one component, or a direction's."""

    condition: fem.DirichletBC | None
    value: fem.Function
    expression: fem.Expression | None
    cells: NDArray[np.int32]

    def update(self) -> None:
        """Evaluate the prescribed value at the present load factor; collective."""
        if self.expression is not None:
            self.value.interpolate(self.expression, self.cells)
            self.value.x.scatter_forward()


@dataclass(frozen=True, eq=False)
class Support:
    """A displacement prescribed on facets, as boundary conditions that follow the load.

    Attributes:
        space: Space of the unknown.
        parts: Its conditions.
        slant: Directions at nodes along which nothing moves, where they are no components.
    """

    space: fem.FunctionSpace
    parts: tuple[Prescribed, ...]
    slant: Slant | None = None

    @property
    def conditions(self) -> list[fem.DirichletBC]:
        """The DOLFINx boundary conditions."""
        return [part.condition for part in self.parts if part.condition is not None]

    def update(self) -> None:
        """Evaluate the prescribed displacement at the present load factor; collective."""
        for part in self.parts:
            part.update()

    def depends_on(self, t: fem.Constant) -> bool:
        """Whether the prescribed values contain a constant."""
        written = [p.expression.ufl_expression for p in self.parts if p.expression is not None]
        return any(c is t for expression in written for c in extract_constants(expression))


def clamp(u: fem.Function, facets: Facets) -> Support:
    """No displacement on the facets. Collective; arguments as :func:`prescribe`."""
    return prescribe(u, facets, [0.0] * field_of(u, "a support")[1].components)


def roller(u: fem.Function, facets: Facets, axis: Any = None, by: Expr = 0.0) -> Support:
    """No displacement along one direction, u . n = 0 or by, free otherwise. Collective.

    ``roller(u, facets, 0)`` holds u_x; ``roller(u, facets)`` lets a plane face slide on itself,
    whatever its angle: a plane of symmetry. On a curved face n is the normal at each node of the
    reference body, the mean of its facets' normals: points move in tangent planes. Exact, by no
    penalty. Where supports meet all of them hold; components that others prescribe go first, and a
    direction that they leave less than 1e-6 of is theirs.

    Args:
        u: Displacement unknown, or a mixed one whose first part it is.
        facets: Local facet indices.
        axis: Axis of coordinates, 0, 1 or 2; or the direction n, of any length, as numbers or in
            UFL, as a function of the reference point that is evaluated once; by default the
            normals of the facets, outward.
        by: Prescribed displacement along n [m], a number or UFL as of :func:`prescribe`: a plane
            that moves, ``roller(u, body.facets("end"), by=0.2 * t)``.

    Raises:
        ValueError: an axis that the body does not have, a direction of length 0, no facets on any
            rank, or facets without a normal at one of their nodes.
    """
    w, field = _moved(u)
    dim = field.components
    if isinstance(axis, Real):
        if axis not in range(dim):
            raise ValueError(f"a roller needs an axis from 0 to {dim - 1}, got {axis}.")
    else:
        held = slant(w, field, facets, axis)
        found = coordinate_axis(held, w.function_space.mesh.comm)
        if found is None:
            return _slanted(w, field, _checks.facets(w.function_space.mesh, facets), held, by)
        axis, sign = found
        by = by if sign > 0 else -by
    return prescribe(u, facets, [by if i == axis else None for i in range(dim)])


def _slanted(w: fem.Function, field: Field, facets: Facets, held: Slant, by: Expr) -> Support:
    """A roller along directions of its own, with the values of u . n as a part. Collective."""
    V = w.function_space
    value = _checks.number(by)
    if value is None:
        _check_value(by, V.mesh)
    elif value == 0:
        return Support(V, (), held)
    first = field.view.sub(0)
    part = replace(_part(first, facets, [by]), condition=None)
    whole, own = fem.locate_dofs_topological(
        (first, part.value.function_space), V.mesh.topology.dim - 1, facets
    )
    order = np.argsort(whole)
    at = own[order[np.searchsorted(whole[order], held.dofs[:, 0])]]
    return Support(V, (part,), replace(held, value=part.value, at=at))


def translate(u: fem.Function, facets: Facets, by: Sequence[Expr | None]) -> Support:
    """Translation of the facets; a component None is left free. Collective.

    ``translate(u, facets, (0.2 * t, None, 0))`` pulls along x in proportion to the load factor t.
    """
    return prescribe(u, facets, by)


def rotate(
    u: fem.Function,
    facets: Facets,
    angle: Expr,
    axis: Sequence[float] = (0, 0, 1),
    center: Sequence[float] | None = None,
    shift: Sequence[Expr] | None = None,
) -> Support:
    """Rigid rotation of the facets about an axis, with an optional translation. Collective.

    u = (R - I)(X - c) + shift,  R = I + sin(angle) K + (1 - cos(angle)) K^2 (Rodrigues)

    Args:
        u: Displacement unknown, or a mixed one whose first part it is.
        facets: Local facet indices.
        angle: Angle [rad], as ``2 * pi * t``; right-handed about the axis.
        axis: Direction of the axis, any length; on a plane mesh (0, 0, 1) or (0, 0, -1).
        center: A point c of the axis [m]; by default the middle of the facets' bounding box.
        shift: Translation added [m].

    Raises:
        ValueError: zero axis, wrong number of components, or no facets on any rank.
    """
    w, field = _moved(u)
    dim, mesh = field.components, w.function_space.mesh
    if _checks.number(angle) is None:
        _check_value(angle, mesh)
    k = np.asarray(axis, float)
    if k.shape != (3,) or not np.linalg.norm(k) > 0:
        raise ValueError(f"rotate needs an axis of three components, not all zero; got {axis}.")
    if dim == 2 and (k[0] or k[1]):
        raise ValueError(f"on a plane mesh rotate needs the axis (0, 0, 1), got {axis}.")
    k = k / np.linalg.norm(k)
    c = np.zeros(3)
    if center is None:
        c[:] = _middle(mesh, facets)
    else:
        c[: len(center)] = center
    K = np.array([[0, -k[2], k[1]], [k[2], 0, -k[0]], [-k[1], k[0], 0]])[:dim, :dim]
    Q = ufl.sin(angle) * ufl.as_matrix(K.tolist())
    Q += (1 - ufl.cos(angle)) * ufl.as_matrix((K @ K).tolist())
    arm = ufl.SpatialCoordinate(mesh) - ufl.as_vector(c[:dim].tolist())
    moved = Q * arm
    return prescribe(u, facets, [moved[i] + (0 if shift is None else shift[i]) for i in range(dim)])


def prescribe(u: Any, facets: Facets, values: Sequence[Expr | None] | Expr) -> Support:
    """Prescribed displacement on facets, component by component, or another field. Collective.

    Args:
        u: Unknown, whose displacement is meant, or a field of it, as ``w["theta"]``.
        facets: Local facet indices (owned and ghost).
        values: One entry per component [m]: a number or a UFL expression of the reference point
            and the load factor, or None for a free component; of a scalar field the value itself.

    Returns:
        Support for :func:`forms.solve` and :func:`forms.follow`. At nodes that two supports share
        the later one in their list wins.

    Raises:
        ValueError: wrong number of values, nothing prescribed, or no facets on any rank.
    """
    w, field = field_of(u, "a support")
    dim, V = field.components, w.function_space
    if dim == 1 and not isinstance(values, list | tuple | np.ndarray):
        values = [values]
    if not isinstance(values, list | tuple | np.ndarray) or len(values) != dim:
        raise ValueError(f"a support needs {dim} values, one per component, got {values}.")
    for value in values:
        if value is not None and _checks.number(value) is None:
            _check_value(value, V.mesh)
    if all(value is None for value in values):
        raise ValueError("a support needs at least one value that is not None.")
    facets = _checks.facets(V.mesh, facets)
    view = field.view
    if all(value is not None for value in values):
        return Support(V, (_part(view, facets, list(values)),))
    return Support(
        V, tuple(_part(view.sub(i), facets, [v]) for i, v in enumerate(values) if v is not None)
    )


def pin(
    u: fem.Function,
    point: Sequence[float] | Sequence[Sequence[float]],
    axes: Sequence[int] | None = None,
) -> Support:
    """No displacement of one node, or of several. Collective.

    Takes rigid motions from a body that nothing else holds, or lets a face turn about a point. In
    the plane and in space a single node carries no force without a peak of stress about it.

    Args:
        u: Displacement unknown, or a mixed one whose first part it is.
        point: Reference position of a node [m], or of several, shape (k, 3).
        axes: Components that are held, as (0, 2); by default all.

    Raises:
        ValueError: no node at a point, or axes that the body does not have.
    """
    w, field = _moved(u)
    dim, V = field.components, w.function_space
    axes = range(dim) if axes is None else axes
    if not len(axes) or any(axis not in range(dim) for axis in axes):
        raise ValueError(f"pin needs axes between 0 and {dim - 1}, got {list(axes)}.")
    view = field.view
    spaces = [_dolfinx.collapse(view.sub(axis))[0] for axis in axes]
    at = nodes_at(spaces[0], point, "pin")
    high = bounding_box(V.mesh.comm, V.mesh.geometry.x)[1]
    parts = []
    for axis, W in zip(axes, spaces, strict=True):
        dofs = fem.locate_dofs_geometrical(
            (view.sub(axis), W), lambda x: near(x.T, at, 1e-9 * abs(high).max())
        )
        g = fem.Function(W, name="pinned")
        bc = fem.dirichletbc(g, dofs, view.sub(axis))
        parts.append(Prescribed(bc, g, None, np.empty(0, np.int32)))
    return Support(V, tuple(parts))


def nodes_at(W: fem.FunctionSpace, point: Any, what: str) -> NDArray[np.float64]:
    """Positions of the nodes at given points, shape (k, 3), alike on all ranks. Collective.

    Args:
        W: Space whose nodes they are.
        point: One point, or several, of as many coordinates as the mesh has.
        what: Who asks, for messages.

    Raises:
        ValueError: a point that is none, or at which there is no node.
    """
    mesh, dim = W.mesh, W.mesh.geometry.dim
    points: Any = np.atleast_2d(_coordinates(point))
    if points.shape[-1] not in (dim, 3) or points.ndim != 2 or not np.all(np.isfinite(points)):
        raise ValueError(f"{what} needs a point of {dim} finite coordinates, got {point}.")
    points = np.pad(points, ((0, 0), (0, 3 - points.shape[1])))
    nodes = W.tabulate_dof_coordinates()
    own = np.full((len(points), 4), np.inf)
    for k, x in enumerate(points):
        if len(nodes):
            off = np.linalg.norm(nodes - x, axis=1)
            own[k] = off.min(), *nodes[off.argmin()]
    every = np.array(mesh.comm.allgather(own))
    low, high = bounding_box(mesh.comm, mesh.geometry.x)
    found = np.array([min(every[:, k].tolist()) for k in range(len(points))])
    for x, distance, node in zip(points, found[:, 0], found[:, 1:], strict=True):
        if not distance <= 1e-6 * np.linalg.norm(high - low):
            raise ValueError(
                f"{what} needs a point where the unknown has a node, got {x[:dim].tolist()}; "
                f"the nearest node is at {np.round(node, 6).tolist()}."
            )
    return found[:, 1:]


def near(x: NDArray[np.float64], points: NDArray[np.float64], distance: float) -> NDArray[np.bool_]:
    """Which of the positions x, shape (n, 3), are at one of some points; local."""
    found = np.zeros(len(x), dtype=bool)
    for point in points:
        found |= np.linalg.norm(x - point, axis=1) <= distance
    return found


def _coordinates(point: Any) -> NDArray[np.float64]:
    try:
        return np.asarray(point, dtype=float)
    except (TypeError, ValueError):
        return np.array([np.nan])


def _check_value(value: Expr, mesh: Any) -> None:
    if not isinstance(value, ufl.core.expr.Expr) or value.ufl_shape != ():
        raise ValueError(
            "a prescribed component is a number, a scalar UFL expression of the reference point "
            f"and the load factor, or None, got {type(value).__name__}."
        )
    _checks.same_space(value, mesh, "a support")
    if extract_type(value, ufl.classes.FacetNormal):
        raise ValueError(
            "a prescribed component is evaluated at nodes, where there is no facet normal: write "
            "the direction as an expression of ufl.SpatialCoordinate."
        )


def _part(view: fem.FunctionSpace, facets: Facets, values: list[Expr]) -> Prescribed:
    """Boundary condition on a space, or on a view of one, with its value's own space."""
    whole = len(view.component()) == 0
    W = view if whole else _dolfinx.collapse(view)[0]
    fdim = W.mesh.topology.dim - 1
    dofs = fem.locate_dofs_topological(view if whole else (view, W), fdim, facets)
    g = fem.Function(W, name="prescribed")
    # In a view the numbers are those of components, in W.dofmap.list of nodes.
    expression, own = None, dofs if whole else dofs[1] // W.dofmap.bs
    numbers = [_checks.number(value) for value in values]
    if None not in numbers:
        constant = np.asarray(numbers, default_scalar_type)
        g.x.array[:] = np.tile(constant, g.x.array.size // len(values))
    else:
        value = ufl.as_vector(values) if len(values) > 1 else ufl.as_ufl(values[0])
        expression = jit.expression(value, _dolfinx.interpolation_points(W), W.mesh)
    # Not only the cells at the facets: a rank may own a dof whose facet lives elsewhere.
    touched = np.isin(W.dofmap.list, own).any(axis=1)
    bc = fem.dirichletbc(g, dofs) if whole else fem.dirichletbc(g, dofs, view)
    part = Prescribed(bc, g, expression, np.flatnonzero(touched).astype(np.int32))
    part.update()
    return part


def _middle(mesh: Any, facets: Facets) -> NDArray[np.float64]:
    """Middle of the bounding box of facets on all ranks; collective."""
    facets = _checks.facets(mesh, facets)
    dim = mesh.topology.dim
    mesh.topology.create_connectivity(dim - 1, dim)
    nodes = entities_to_geometry(mesh, dim - 1, facets).ravel() if len(facets) else facets
    low, high = bounding_box(mesh.comm, mesh.geometry.x[nodes])
    return (low + high) / 2


def _moved(u: Any) -> tuple[fem.Function, Field]:
    """An unknown and its displacement.

    Raises:
        ValueError: it has none, or a field that is none was given.
    """
    w, field = field_of(u, "a support")
    dim = w.function_space.mesh.geometry.dim
    if not field.is_displacement:
        raise ValueError(
            f"this support needs a displacement of {dim} components, got {field.name} of {w.name} "
            f"with {field.components}: use forms.prescribe for other fields."
        )
    return w, field
