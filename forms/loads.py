# SPDX-License-Identifier: MIT
"""Loads: potentials to be added to the energy, and virtual works where no potential exists.

Signs: a load's potential is minus its work, so ``psi * dx + load`` is the total potential. A load
that is a virtual work is added to the residual (``virtual_work=`` of a solve). On a body of
revolution forces carry the weight :func:`forms.circumference`, as energies do; the pressures below
put it in themselves.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray
from ufl.algorithms import extract_coefficients
from ufl.algorithms.map_integrands import map_integrand_dags
from ufl.checks import is_cellwise_constant
from ufl.corealg.multifunction import MultiFunction

from ._checks import measure, same_space, vector
from ._types import Expr
from .differentiation import nodes
from .kinematics import Revolved, axisymmetric, circumference, deformation_gradient, is_axisymmetric
from .points import crossings, representer


def body_force(u: Expr, b: Expr, dx: ufl.Measure = ufl.dx) -> ufl.Form:
    """Potential of a dead body force, - int b . u dV.

    Args:
        u: Displacement [m].
        b: Force per reference volume [N/m^3], same shape as u.
        dx: Measure of the reference body.

    Raises:
        ValueError: b and u have different shapes.
    """
    b = vector(b, u.ufl_shape, "a body force")
    same_space(b, u, "a body force")
    return -ufl.inner(b, u) * measure(dx, "a body force")


def gravity(
    u: Expr,
    density: Expr,
    g: float = 9.81,
    direction: Sequence[float] | None = None,
    dx: ufl.Measure = ufl.dx,
) -> ufl.Form:
    """Potential of dead weight, - int density g direction . u dV.

    Args:
        u: Displacement [m].
        density: Mass per reference volume [kg/m^3]; times :func:`forms.circumference` on a body of
            revolution, times the thickness for a sheet. With the load factor in it weight grows.
        g: Acceleration [m/s^2].
        direction: Where down is, any length; by default against the last coordinate, (0, 0, -1).
        dx: Measure of the reference body.

    Raises:
        ValueError: a direction of length 0 or of another shape than u.
    """
    (dim,) = u.ufl_shape
    down = [0.0] * (dim - 1) + [-1.0] if direction is None else direction
    length = float(np.linalg.norm(np.asarray(down, float)))
    if np.shape(down) != (dim,) or not 0 < length < np.inf:
        raise ValueError(
            f"gravity needs a direction of {dim} components, not all zero; got {direction}."
        )
    return body_force(u, density * ufl.as_vector([g * c / length for c in down]), dx)


def point_load(u: Expr, point: Sequence[float], force: Expr) -> ufl.Form:
    """Potential of a dead force at one point of the body, - f . u(X), on any mesh. Collective.

    The point need not be a node: u there is written as int g u dV, g a function of the one cell at
    the point, so that the potential is a form as any other. In the plane and in space the stress
    is singular at the point, and u there grows without bound as the mesh is refined; of beams,
    membranes and anything far away the answer converges.

    Args:
        u: Displacement [m], or that part of ``ufl.split`` of a mixed unknown.
        point: Reference position [m], anywhere in the body.
        force: Force [N], constant in space, same shape as u, as ``(0, 0, -10 * t)``; on a plane
            mesh per unit thickness, on a body of revolution that of the whole ring.

    Raises:
        ValueError: a point outside the body, or a force of another shape or one that varies.
    """
    mesh, k = _interpolated(u, "a point load")
    f = _constant_force(u, force, "a point load")
    x = _point(mesh, point, "a point load")
    load = representer(mesh, k, x[None], np.ones(1), "the point")
    return -load * ufl.inner(f, u) * load.dx


def line_load(u: Expr, a: Sequence[float], b: Sequence[float], force: Expr) -> ufl.Form:
    """Potential of a dead force along a straight line, - int_a^b f . u ds, on any mesh. Collective.

    The line need not follow edges: it is cut where it leaves a cell, and each part integrated by
    Gauss's rule, exactly in straight cells, as :func:`point_load` at each of its points.

    Args:
        u: Displacement [m], or that part of ``ufl.split`` of a mixed unknown.
        a: Where the line begins [m], in the reference body.
        b: Where it ends [m].
        force: Force per reference length [N/m], constant in space, same shape as u.

    Raises:
        ValueError: a line that leaves the body or has no length, or a force of another shape or one
            that varies.
    """
    mesh, k = _interpolated(u, "a line load")
    f = _constant_force(u, force, "a line load")
    first, last = (_point(mesh, x, "a line load") for x in (a, b))
    length = float(np.linalg.norm(last - first))
    if not length > 0:
        raise ValueError(f"a line load needs two points, got {tuple(a)} twice: use point_load.")
    cuts = np.concatenate([[0.0], crossings(mesh, first, last), [1.0]])
    # A function of degree k has k times the dimension along a line through a hexahedron.
    y, w = np.polynomial.legendre.leggauss(k * mesh.topology.dim // 2 + 1)
    parts = np.diff(cuts)
    s = (cuts[:-1, None] + parts[:, None] * (1 + y) / 2).ravel()
    weights = length * (parts[:, None] * w / 2).ravel()
    x = first + s[:, None] * (last - first)
    load = representer(mesh, k, x, weights, "the line's point")
    return -load * ufl.inner(f, u) * load.dx


def dead_traction(u: Expr, t: Expr, ds: ufl.Measure) -> ufl.Form:
    """Potential of a traction of fixed direction, - int t . u dA.

    Args:
        u: Displacement [m].
        t: Force per reference area [Pa], same shape as u.
        ds: Measure of the loaded boundary, as ``body.ds("right")``.

    Raises:
        ValueError: t and u have different shapes.
    """
    return -ufl.inner(vector(t, u.ufl_shape, "a traction"), u) * measure(ds, "a traction")


def follower_pressure(u: Expr, p: Expr, v: Expr, ds: ufl.Measure, F: Expr | None = None) -> Expr:
    """Virtual work of a pressure that stays normal to the deformed boundary.

    + int p n . v da = int p J F^-T N . v dA  (a pressure p > 0 pushes against the normal n)

    On a body of revolution, dA = 2 pi R ds.

    Args:
        u: Displacement [m].
        p: Pressure per deformed area [Pa]. One that is constant in space gets the weight 2 pi R of
            a body of revolution here; one that varies is taken to carry it.
        v: Test function of u's space (of the displacement in a mixed space).
        ds: Measure of the loaded boundary, as ``body.ds("left")``.
        F: Deformation gradient, where it is not that of u alone; that of a body of revolution is
            found in the potential that is solved with.

    Returns:
        Linear form for ``virtual_work``. Its tangent is unsymmetric in general.

    Raises:
        ValueError: p is no scalar, v is not of u's shape, or ds is no measure.
    """
    p, v = ufl.as_ufl(p), ufl.as_ufl(v)
    if p.ufl_shape != () or v.ufl_shape != u.ufl_shape:
        raise ValueError(
            f"follower_pressure needs a scalar p and a test function v of shape {u.ufl_shape}, got "
            f"shapes {p.ufl_shape} and {v.ufl_shape}; the order is (u, p, v, ds)."
        )

    def density(F: Expr) -> Expr:
        weight = circumference(u) if is_axisymmetric(F) and _is_uniform(p) else 1
        return weight * ufl.inner(p * _deformed_normal(u, F), v)

    return of_kinematics(u, F, density) * measure(ds, "a pressure")


def pressure_potential(u: Expr, p: Expr, ds: ufl.Measure, F: Expr | None = None) -> ufl.Form:
    """Potential of a uniform pressure where one exists: p times the volume it pushes back.

    p int 1/d x . (J F^-T N) dA,  x = X + u
    body of revolution: p int r/2 (J F^-T N)_r 2 pi R ds,  r = R + u_r

    It is the potential of :func:`follower_pressure` if the loaded boundary is closed, or if its
    rim cannot move or moves only in planes through the origin (symmetry planes x = 0, y = 0, …), of
    a body of revolution in any planes z = const. Otherwise its derivative has forces on the rim;
    use :func:`follower_pressure` there. On a rim in symmetry planes these forces are normal to the
    planes and change no displacement, but they are part of the planes' reactions: for
    :func:`forms.resultant` use :func:`follower_pressure`, too.

    Args:
        u: Displacement [m], as many components d as the mesh has.
        p: Pressure [Pa], constant in space.
        ds: Measure of the loaded boundary, as ``body.ds("inner")``.
        F: Deformation gradient of a body of revolution; by default it is found in the potential
            that this one is added to.

    Raises:
        ValueError: p varies in space, for which no such potential exists.
    """
    p = ufl.as_ufl(p)
    if not _is_uniform(p):
        raise ValueError(
            "a pressure that varies in space has no potential p V: use follower_pressure. (The "
            "weight of a body of revolution is put in by pressure_potential itself.)"
        )
    X = ufl.SpatialCoordinate(ufl.domain.extract_unique_domain(u))
    if X.ufl_shape != u.ufl_shape:
        raise ValueError(
            f"pressure_potential needs a displacement of shape {X.ufl_shape}, got {u.ufl_shape}; "
            "of a mixed unknown w pass the u of u, p = ufl.split(w)."
        )
    x = X + u

    def density(F: Expr) -> Expr:
        normal = _deformed_normal(u, F)
        if is_axisymmetric(F):
            return p * x[0] / 2 * normal[0] * circumference(u)
        return p / u.ufl_shape[0] * ufl.inner(x, normal)

    return of_kinematics(u, F, density) * measure(ds, "a pressure")


def spring(u: Expr, k: Expr, dx: ufl.Measure, direction: Expr | None = None) -> ufl.Form:
    """Potential of springs at every point of a boundary (or of the body), int k/2 |u|^2.

    Args:
        u: Displacement [m].
        k: Stiffness per reference area [N/m^3] (per volume [N/m^4] with a cell measure).
        dx: Measure of where the springs are attached.
        direction: Unit vector; the springs then resist only u . direction.
    """
    stretch2 = ufl.inner(u, u) if direction is None else ufl.dot(u, direction) ** 2
    return k / 2 * stretch2 * measure(dx, "a spring")


class _Alternative(ufl.classes.Label):
    """Label of a plane load's density that holds the density on a body of revolution."""

    def __init__(self, revolved: Expr) -> None:
        super().__init__()
        self.revolved = revolved


def of_kinematics(u: Expr, F: Expr | None, density: Callable[[Expr], Expr]) -> Expr:
    """Density of a load with F; in the plane, without an F, both that there may be."""
    if F is not None:
        return density(F)
    plane = density(deformation_gradient(u))
    if u.ufl_shape != (2,):
        return plane
    return ufl.classes.Variable(plane, _Alternative(density(axisymmetric(u))))


def with_kinematics(*together: Any) -> tuple[Any, ...]:
    """Forms of one problem, plane loads turned into those of a body of revolution if it is one.

    A load of u alone cannot know; the deformation gradient in the energy beside it does.
    """
    labels = {
        type(node.label())
        for form in together
        if isinstance(form, ufl.Form)
        for node in nodes(form)
        if isinstance(node, ufl.classes.Variable)
    }
    if not {Revolved, _Alternative} <= labels:
        return together
    return tuple(
        map_integrand_dags(_Revolution(), form) if isinstance(form, ufl.Form) else form
        for form in together
    )


class _Revolution(MultiFunction):
    """Replace a plane load's density by that on a body of revolution."""

    def expr(self, o: Expr, *operands: Expr) -> Expr:
        return self.reuse_if_untouched(o, *operands)

    def terminal(self, o: Expr) -> Expr:
        return o

    def variable(self, o: Expr, operand: Expr, label: Expr) -> Expr:
        if isinstance(label, _Alternative):
            return label.revolved
        return self.reuse_if_untouched(o, operand, label)


def _interpolated(u: Expr, what: str) -> tuple[Any, int]:
    """Mesh and degree of the functions that a displacement is made of."""
    functions = extract_coefficients(ufl.as_ufl(u))
    if len(functions) != 1 or not isinstance(functions[0], fem.Function) or len(u.ufl_shape) != 1:
        raise ValueError(
            f"{what} needs the displacement, a vector of one unknown, got {type(u).__name__} of "
            f"shape {getattr(u, 'ufl_shape', ())}."
        )
    V = functions[0].function_space
    return V.mesh, max(1, V.ufl_element().embedded_superdegree)


def _constant_force(u: Expr, force: Expr, what: str) -> Expr:
    f = vector(force, u.ufl_shape, what)
    if not _is_uniform(f):
        raise ValueError(
            f"{what} needs a force that is constant in space, got {f}: write numbers, Constants "
            "and the load factor."
        )
    return f


def _point(mesh: Any, point: Any, what: str) -> NDArray[np.float64]:
    x = np.zeros(3)
    if np.shape(point) != (mesh.geometry.dim,) or not np.all(np.isfinite(point)):
        raise ValueError(
            f"{what} needs a point of {mesh.geometry.dim} finite coordinates, got {point}."
        )
    x[: len(point)] = point
    return x


def _is_uniform(p: Expr) -> bool:
    return not extract_coefficients(p) and is_cellwise_constant(p)


def _deformed_normal(u: Expr, F: Expr) -> Expr:
    """Vector J F^-T N = n da/dA, with as many components as the mesh has."""
    domain = ufl.domain.extract_unique_domain(u)
    dim = u.ufl_shape[0]
    N = ufl.FacetNormal(domain)
    if dim == 2:  # F is 3x3 on plane meshes: its third column and row hold the thickness or hoop.
        N = ufl.as_vector([N[0], N[1], 0])
    n = ufl.cofac(F) * N
    return n if dim == 3 else ufl.as_vector([n[0], n[1]])
