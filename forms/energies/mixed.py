# SPDX-License-Identifier: MIT
"""Incompressibility: the displacement-pressure potential of any energy."""

from __future__ import annotations

import ufl

from .._types import Expr
from .moduli import check_positive


def with_pressure(psi: Expr, F: Expr, p: Expr, kappa: Expr | None = None) -> Expr:
    """Mixed displacement-pressure potential of an energy.

    psi + p (J - 1) - p^2 / (2 kappa);  without kappa the last term is absent and J = 1.

    Stationary in p: J - 1 = p / kappa, which is psi + kappa/2 (J - 1)^2 with the volume term
    enforced in the mean of the pressure's space. The pressure p is positive in tension: the Cauchy
    stress gains p I.

    Best write psi with ``isochoric(F)``: J = 1 holds in the mean only, and an energy that also
    changes with J can lose its stability under pressure (Guccione's ventricle under 10 kPa stops
    at 1.3 kPa with F, and converges with isochoric(F)).

    Args:
        psi: Energy density [J/m^3] of F, without a volume term.
        F: Deformation gradient, shape (3, 3).
        p: Pressure unknown [Pa], see :func:`forms.displacement_pressure`.
        kappa: Bulk modulus [Pa], kappa > 0; none for an incompressible body.

    Returns:
        Density [J/m^3] whose stationary point (a saddle) is the solution.

    Raises:
        ValueError: p is no scalar, or kappa a number not above 0.
    """
    if ufl.as_ufl(p).ufl_shape != ():
        raise ValueError(f"the pressure must be a scalar, got shape {p.ufl_shape}.")
    potential = psi + p * (ufl.det(F) - 1)
    if kappa is None:
        return potential
    check_positive("bulk modulus kappa", kappa)
    return potential - p**2 / (2 * kappa)
