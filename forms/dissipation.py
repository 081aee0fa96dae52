# SPDX-License-Identifier: MIT
"""Viscosity: dissipation potentials phi of a rate, for motions (:func:`forms.transient`).

The force of a dissipation potential is its derivative by the rate, phi'(rate), and the power it
takes phi'(rate) : rate.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import ufl

from . import _checks
from ._types import Expr
from .kinematics import deformation_gradient


@dataclass(frozen=True)
class Dissipation:
    """A dissipation potential int phi(rate) dx.

    ``Dissipation(lambda v: c / 3 * ufl.inner(v, v) ** 1.5, dx=body.ds("sail"))`` is a drag c |v|^2.

    Attributes:
        phi: Scalar function of the rate in UFL, convex, least at 0 [W/m^3], on boundaries [W/m^2].
        of: Function of the displacement whose rate it is, as Green's strain; None for the
            displacement itself, whose rate is the velocity [m/s].
        dx: Measure; None for all cells of the body.
        per_mass: Whether phi is per mass [W/kg], to be multiplied by rho.
        per_area: Whether phi is per area of a sheet, not to be multiplied by its thickness.
        lags: Whether phi is a function of the rate and of the displacement that it lags at: a step
            is solved again at its own end until the forces agree.
    """

    phi: Callable[..., Expr]
    of: Callable[[Expr], Expr] | None = None
    dx: ufl.Measure | None = None
    per_mass: bool = False
    per_area: bool = False
    lags: bool = False

    def __post_init__(self) -> None:
        if not callable(self.phi) or not (self.of is None or callable(self.of)):
            raise ValueError(
                "a dissipation needs phi, a function of the rate, and of, a function of the "
                f"displacement or None, got {type(self.phi).__name__} and {type(self.of).__name__}."
            )
        if self.dx is not None:
            _checks.measure(self.dx, "a dissipation")


def kelvin_voigt(
    eta: float | Expr,
    zeta: float | Expr = 0.0,
    F: Callable[[Expr], Expr] = deformation_gradient,
    dx: ufl.Measure | None = None,
) -> Dissipation:
    """Kelvin-Voigt viscosity in the rate D of Green's strain, which no rigid motion dissipates.

    phi(D) = eta D : D + zeta/2 (tr D)^2,  D = dE/dt,  E = (F^T F - I) / 2

    Args:
        eta: Viscosity in shear [Pa s].
        zeta: Second viscosity [Pa s].
        F: Deformation gradient as a function of u, as forms.axisymmetric, forms.membrane_gradient.
        dx: Measure; by default all cells.

    Raises:
        ValueError: no number or scalar, or a negative one.
    """
    for value, name in ((eta, "eta"), (zeta, "zeta")):
        _checks.not_negative(value, "a viscosity", name, "Pa s")

    def phi(D: Expr) -> Expr:
        return eta * ufl.inner(D, D) + zeta / 2 * ufl.tr(D) ** 2

    def strain(u: Expr) -> Expr:
        gradient: Any = F(u)
        C = gradient.T * gradient
        return (C - ufl.Identity(C.ufl_shape[0])) / 2

    return Dissipation(phi, strain, dx)


def mass_damping(alpha: float | Expr) -> Dissipation:
    """Damping in proportion to the mass, force - alpha rho v: a medium that everything moves in.

    phi(v) = alpha rho/2 |v|^2; a vibration omega fades with exp(-alpha t / 2), whatever omega is.

    Args:
        alpha: Rate [1/s].

    Raises:
        ValueError: no number or scalar, or a negative one.
    """
    _checks.not_negative(alpha, "a damping", "alpha", "1/s")
    return Dissipation(lambda v: alpha / 2 * ufl.inner(v, v), per_mass=True)


def dashpots(c: float | Expr, ds: ufl.Measure) -> Dissipation:
    """Dashpots on a boundary, traction - c v.

    phi(v) = c/2 |v|^2; with c = rho times a speed of waves they let these out.

    Args:
        c: Viscosity per area [Pa s/m].
        ds: Measure of the boundary, as body.ds("base").

    Raises:
        ValueError: no number or scalar, or a negative one, or no measure.
    """
    _checks.not_negative(c, "the viscosity of dashpots", "c", "Pa s/m")
    return Dissipation(lambda v: c / 2 * ufl.inner(v, v), dx=_checks.measure(ds, "dashpots"))
