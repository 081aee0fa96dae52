# SPDX-License-Identifier: MIT
"""Virtual work and its linearization written by hand, to be compared with the automatic forms.

Document 003, (29)-(34), (52), pulled back to the reference body: grad v = dF[v] F^-1, dv = J dV.
"""

from __future__ import annotations

import ufl
from dolfinx import fem
from ufl.algorithms import expand_derivatives

from ._types import Expr

__all__ = [
    "linearized_material",
    "linearized_spatial",
    "material_virtual_work",
    "spatial_virtual_work",
]


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
