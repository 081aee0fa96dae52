# SPDX-License-Identifier: MIT
"""Energies of sheets: functions of a 3x2 deformation gradient, per reference volume of the sheet.

Multiply by the thickness to integrate over the surface: ``h * psi * dx``. Energies of an
incompressible solid serve sheets through :func:`forms.membranes.incompressible_sheet`.
"""

from __future__ import annotations

from collections.abc import Callable

import ufl

from .._checks import in_ufl
from .._types import Expr
from ..membranes import membrane_invariants
from .moduli import check_moduli, check_poisson_ratio, check_positive


def neo_hookean_sheet(F: Expr, mu: Expr) -> Expr:
    """Incompressible neo-Hookean sheet, psi = mu/2 (I2 + I3^-2 - 3) [J/m^3].

    Args:
        F: Deformation gradient of a sheet, shape (3, 2).
        mu: Shear modulus [Pa].

    Raises:
        ValueError: F is not 3x2, or mu a number not above 0.

    Source: document 001, section 4, psi_sheet.
    """
    check_moduli("neo_hookean_sheet", mu=mu)
    _, I2, I3 = membrane_invariants(F)
    return mu / 2 * (I2 + I3**-2 - 3)


def mooney_rivlin_sheet(F: Expr, c10: Expr, c01: Expr) -> Expr:
    """Incompressible Mooney-Rivlin sheet [J/m^3].

    psi = c10 (I2 + I3^-2 - 3) + c01 (I3^2 + I2 I3^-2 - 3)

    Args:
        F: Deformation gradient of a sheet, shape (3, 2).
        c10: Constant [Pa]; mu = 2 (c10 + c01) at small strains.
        c01: Constant [Pa].
    """
    check_moduli("mooney_rivlin_sheet", c10=c10, c01=c01)
    _, I2, I3 = membrane_invariants(F)
    return c10 * (I2 + I3**-2 - 3) + c01 * (I3**2 + I2 / I3**2 - 3)


def saint_venant_kirchhoff_sheet(F: Expr, E: Expr, nu: Expr) -> Expr:
    """St Venant-Kirchhoff sheet in plane stress [J/m^3]; for small strains and large rotations.

    psi = E / (2 (1 - nu^2)) ((1 - nu) e : e + nu (tr e)^2),  e = 1/2 (F^T F - I)

    Args:
        F: Deformation gradient of a sheet, shape (3, 2).
        E: Young's modulus [Pa].
        nu: Poisson ratio, -1 < nu < 1/2.
    """
    check_positive("Young's modulus E", E)
    check_poisson_ratio(nu)
    membrane_invariants(F)  # checks the shape
    e = (F.T * F - ufl.Identity(2)) / 2
    return E / (2 * (1 - nu**2)) * ((1 - nu) * ufl.inner(e, e) + nu * ufl.tr(e) ** 2)


def sheet(F: Expr, psi: Callable[[Expr, Expr, Expr], Expr]) -> Expr:
    """Energy psi(I1, I2, I3) [J/m^3] in document 001's invariants of a 3x2 gradient.

    Args:
        F: Deformation gradient of a sheet, shape (3, 2).
        psi: Function of (I1, I2, I3) = (s1 + s2, s1^2 + s2^2, s1 s2) that returns a UFL scalar.
    """
    return in_ufl(psi, "sheet's psi", *membrane_invariants(F))
