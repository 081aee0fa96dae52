# SPDX-License-Identifier: MIT
"""Potential -> residual -> tangent by Gateaux derivatives, and the virtual work written by hand.

The derivative is automatic: ``residual(potential, u)`` is R[v] = d/dh potential(u + h v) at h = 0,
``tangent(residual, u)`` is K[v, du] = d/dh R[v](u + h du). The hand-written forms (29)-(34), (52)
of document 003 are here because they are what a reader compares with; they are pulled back to the
reference body, so grad v = dF[v] F^-1 and dv = J dV.
"""

from __future__ import annotations

import ufl
from dolfinx import fem
from ufl.algorithms import expand_derivatives

from .kinematics import Expr
from .loads import with_kinematics
from .operators.chain import rate


def derivative(form: ufl.Form, u: fem.Function, du: Expr) -> ufl.Form:
    """Gateaux derivative of a form at u in direction du.

    D form(u)[du] = d/dh form(u + h du) at h = 0

    Args:
        form: Functional or linear form of u.
        u: Unknown: scalar, vector or mixed.
        du: Argument or function of the same space.

    Energies in singular values and coefficients that depend on u
    (:class:`~forms.operators.chain.Dependent`) are differentiated through: the derivative is then
    taken in several coefficients at once, each in its own direction.
    """
    return rate(form, u, du)


def residual(potential: ufl.Form, u: fem.Function) -> ufl.Form:
    """Residual R[v] = D potential(u)[v], a linear form in a new test function v.

    Raises:
        ValueError: potential is no functional, or does not depend on u.
    """
    _check(potential, u, 0, "residual needs a potential (a functional of u)")
    (potential,) = with_kinematics(potential)
    return derivative(potential, u, ufl.TestFunction(u.function_space))


def tangent(R: ufl.Form, u: fem.Function) -> ufl.Form:
    """Tangent K[v, du] = D R[v](u)[du], a bilinear form in a new trial function du.

    Raises:
        ValueError: R is no linear form, or does not depend on u.
    """
    _check(R, u, 1, "tangent needs a residual (a form linear in one test function)")
    return derivative(R, u, ufl.TrialFunction(u.function_space))


def spatial_virtual_work(sigma: Expr, F: Expr, u: fem.Function, v: Expr, dx: ufl.Measure) -> Expr:
    """Internal virtual work of the Cauchy stress, the first term of (52).

    int sigma : dd dv = int sigma : sym(grad v) J dV,  grad v = DF[v] F^-1

    Args:
        sigma: Cauchy stress [Pa], shape (3, 3).
        F: Deformation gradient of u, shape (3, 3).
        u: Displacement the body is deformed by.
        v: Virtual velocity, a test function of u's space.
        dx: Measure of the reference body.

    Source: document 003, (35), (52).
    """
    return ufl.inner(sigma, ufl.sym(_spatial_gradient(F, u, v))) * ufl.det(F) * dx


def material_virtual_work(S: Expr, F: Expr, u: fem.Function, v: Expr, dx: ufl.Measure) -> Expr:
    """Internal virtual work of the second Piola-Kirchhoff stress, int S : DE[v] dV (29)."""
    return ufl.inner(S, _strain_rate(F, u, v)) * dx


def linearized_material(
    S: Expr, CC: Expr, F: Expr, u: fem.Function, v: Expr, du: Expr, dx: ufl.Measure
) -> Expr:
    """Linearized internal virtual work in the reference body (30), (32).

    int DE[v] : CC : DE[du] dV + int S : [DF[du]^T DF[v]] dV

    Args:
        S: Second Piola-Kirchhoff stress [Pa], shape (3, 3).
        CC: Material elasticity tensor [Pa], shape (3, 3, 3, 3).
        F: Deformation gradient of u.
        u: Displacement the body is deformed by.
        v: Virtual velocity.
        du: Increment.
        dx: Measure of the reference body.

    Source: document 003, (30)-(32) with the dV that the first integral lacks in print.
    """
    constitutive = _contract(_strain_rate(F, u, v), CC, _strain_rate(F, u, du))
    initial = ufl.inner(S, _rate(F, u, du).T * _rate(F, u, v))
    return (constitutive + initial) * dx


def linearized_spatial(
    sigma: Expr, c: Expr, F: Expr, u: fem.Function, v: Expr, du: Expr, dx: ufl.Measure
) -> Expr:
    """Linearized internal virtual work in the deformed body (34), pulled back.

    int dd : c : eps dv + int sigma : [(grad du)^T grad v] dv

    Args:
        sigma: Cauchy stress [Pa], shape (3, 3).
        c: Spatial elasticity tensor [Pa], shape (3, 3, 3, 3).
        F: Deformation gradient of u.
        u: Displacement the body is deformed by.
        v: Virtual velocity.
        du: Increment.
        dx: Measure of the reference body.

    Source: document 003, (33)-(35).
    """
    grad_v, grad_du = _spatial_gradient(F, u, v), _spatial_gradient(F, u, du)
    constitutive = _contract(ufl.sym(grad_v), c, ufl.sym(grad_du))
    initial = ufl.inner(sigma, grad_du.T * grad_v)
    return (constitutive + initial) * ufl.det(F) * dx


def _rate(F: Expr, u: fem.Function, v: Expr) -> Expr:
    """DF[v], which is grad v for a solid and has a hoop entry for a body of revolution."""
    return expand_derivatives(ufl.derivative(F, u, v))


def _strain_rate(F: Expr, u: fem.Function, v: Expr) -> Expr:
    """DE[v] = sym(F^T DF[v]) (31)."""
    return ufl.sym(F.T * _rate(F, u, v))


def _spatial_gradient(F: Expr, u: fem.Function, v: Expr) -> Expr:
    return _rate(F, u, v) * ufl.inv(F)


def _contract(a: Expr, c: Expr, b: Expr) -> Expr:
    i, j, k, n = ufl.indices(4)
    return a[i, j] * c[i, j, k, n] * b[k, n]


def _check(form: ufl.Form, u: fem.Function, arity: int, need: str) -> None:
    if not isinstance(form, ufl.Form):
        raise ValueError(f"{need}, got {type(form).__name__}; integrate a density with ufl.dx.")
    if len(form.arguments()) != arity:
        raise ValueError(f"{need}, got a form with {len(form.arguments())} arguments.")
    if u not in form.coefficients():
        raise ValueError(
            f"{need}, got a form that does not contain {u}: was it written with another Function?"
        )
