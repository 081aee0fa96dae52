# SPDX-License-Identifier: MIT
"""Conversions between elastic moduli. Plain numbers or UFL expressions, all in Pa."""

from __future__ import annotations

from math import isfinite
from numbers import Real

from .._types import Expr


def lame_from_shear(mu: Expr, nu: Expr) -> tuple[Expr, Expr]:
    """Lamé parameters (mu, lmbda) from shear modulus and Poisson ratio.

    lmbda = 2 mu nu / (1 - 2 nu).  Source: document 003, (17).

    Raises:
        ValueError: nu is a number outside -1 < nu < 1/2, or mu a number not above 0.
    """
    check_poisson_ratio(nu)
    check_positive("shear modulus mu", mu)
    return mu, 2 * mu * nu / (1 - 2 * nu)


def lame_from_young(E: Expr, nu: Expr) -> tuple[Expr, Expr]:
    """Lamé parameters (mu, lmbda) from Young's modulus and Poisson ratio.

    mu = E / (2 (1 + nu)),  lmbda = E nu / ((1 + nu) (1 - 2 nu)).

    Raises:
        ValueError: nu is a number outside -1 < nu < 1/2, or E a number not above 0.
    """
    check_poisson_ratio(nu)
    check_positive("Young's modulus E", E)
    return E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu))


def bulk_modulus(mu: Expr, lmbda: Expr) -> Expr:
    """Bulk modulus kappa = lmbda + 2/3 mu of small strains."""
    return lmbda + 2 * mu / 3


def check_poisson_ratio(nu: Expr) -> None:
    """Refuse a numeric Poisson ratio outside the stable range; let UFL expressions pass."""
    if isinstance(nu, Real) and not -1 < float(nu) < 0.5:
        raise ValueError(
            f"a compressible material needs a Poisson ratio between -1 and 1/2, got nu = {nu}; "
            "for nu = 1/2 use energies.with_pressure without kappa."
        )


def check_moduli(name: str, **parameters: Expr) -> None:
    """Refuse numbers that are not finite, and mu and lmbda of an unstable material."""
    for parameter, value in parameters.items():
        if isinstance(value, Real) and not isfinite(value):
            raise ValueError(f"{name} needs a finite {parameter}, got {value}.")
    mu, lmbda = parameters.get("mu", 1.0), parameters.get("lmbda", 0.0)
    check_positive("shear modulus mu", mu)
    isotropic_moduli = isinstance(mu, Real) and isinstance(lmbda, Real) and "beta" not in parameters
    if isotropic_moduli and not float(lmbda) + 2 / 3 * float(mu) > 0:
        raise ValueError(
            f"{name} needs a positive bulk modulus lmbda + 2/3 mu, got lmbda = {lmbda}, mu = {mu}."
        )


def check_positive(name: str, value: Expr) -> None:
    """Refuse a numeric modulus that is not a positive number; let UFL expressions pass."""
    if isinstance(value, Real) and not float(value) > 0:
        raise ValueError(f"the {name} must be positive, got {value}.")
