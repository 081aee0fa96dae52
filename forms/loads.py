# SPDX-License-Identifier: MIT
"""Loads: potentials to be added to the energy, and virtual works where no potential exists.

Signs: a load's potential is minus its work, so ``psi * dx + load`` is the total potential. A load
that is a virtual work is added to the residual (``virtual_work=`` of a solve).
"""

from __future__ import annotations

import ufl
from ufl.algorithms import extract_coefficients
from ufl.checks import is_cellwise_constant

from ._checks import measure, vector
from .kinematics import Expr, deformation_gradient


def body_force(u: Expr, b: Expr, dx: ufl.Measure = ufl.dx) -> ufl.Form:
    """Potential of a dead body force, - int b . u dV.

    Args:
        u: Displacement [m].
        b: Force per reference volume [N/m^3], same shape as u.
        dx: Measure of the reference body.

    Raises:
        ValueError: b and u have different shapes.
    """
    return -ufl.inner(vector(b, u.ufl_shape, "a body force"), u) * measure(dx, "a body force")


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

    Args:
        u: Displacement [m].
        p: Pressure per deformed area [Pa].
        v: Test function of u's space (of the displacement in a mixed space).
        ds: Measure of the loaded boundary.
        F: Deformation gradient, needed where it is not that of u alone (a body of revolution,
            whose ds also carries the weight :func:`forms.circumference`).

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
    return ufl.inner(p * _deformed_normal(u, F), v) * measure(ds, "a pressure")


def pressure_potential(u: Expr, p: Expr, ds: ufl.Measure) -> ufl.Form:
    """Potential of a uniform pressure where one exists: p times the volume it pushes back.

    p int 1/d x . (J F^-T N) dA,  x = X + u

    It is the potential of :func:`follower_pressure` if the loaded boundary is closed, or if its
    rim cannot move or moves only in planes through the origin (symmetry planes x = 0, y = 0, …).
    Otherwise its derivative has forces on the rim; use :func:`follower_pressure` there. On a rim in
    symmetry planes these forces are normal to the planes and change no displacement, but they are
    part of the planes' reactions: for :func:`forms.resultant` use :func:`follower_pressure`, too.

    Args:
        u: Displacement [m], as many components d as the mesh has.
        p: Pressure [Pa], constant in space.
        ds: Measure of the loaded boundary.

    Raises:
        ValueError: p varies in space, for which no such potential exists.
    """
    p = ufl.as_ufl(p)
    if extract_coefficients(p) or not is_cellwise_constant(p):
        raise ValueError(
            "a pressure that varies in space has no potential p V: use follower_pressure."
        )
    X = ufl.SpatialCoordinate(ufl.domain.extract_unique_domain(u))
    if X.ufl_shape != u.ufl_shape:
        raise ValueError(
            f"pressure_potential needs a displacement of shape {X.ufl_shape}, got {u.ufl_shape}; "
            "of a mixed unknown w pass the u of u, p = ufl.split(w)."
        )
    x = X + u
    density = p / u.ufl_shape[0] * ufl.inner(x, _deformed_normal(u, None))
    return density * measure(ds, "a pressure")


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


def _deformed_normal(u: Expr, F: Expr | None) -> Expr:
    """Vector J F^-T N = n da/dA, with as many components as the mesh has."""
    domain = ufl.domain.extract_unique_domain(u)
    dim = u.ufl_shape[0]
    N = ufl.FacetNormal(domain)
    if dim == 2:  # F is 3x3 on plane meshes: its third column and row hold the thickness or hoop.
        N = ufl.as_vector([N[0], N[1], 0])
    n = ufl.cofac(deformation_gradient(u) if F is None else F) * N
    return n if dim == 3 else ufl.as_vector([n[0], n[1]])
