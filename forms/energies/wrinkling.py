# SPDX-License-Identifier: MIT
"""Sheets that carry no compression: tension-field energies of cloth, bags, sails.

A thin sheet gives way to compression by wrinkles finer than any mesh. The relaxed energy takes for
each state the least energy that wrinkles can reach: a sheet narrower than its natural width under
uniaxial tension is as stiff as that tension, one that is slack in both directions costs nothing.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from numbers import Real
from typing import Any

import ufl

from .._types import Expr
from ..operators.energy import SingularValueEnergy
from .moduli import check_moduli, check_poisson_ratio, check_positive

# At rest, where the singular values are 1 up to rounding, a sheet counts as taut: it is to have the
# stiffness of its energy there.
TAUT = 1e-12

# Share of the stiffness that stays under compression. It makes Newton's method converge where a
# sheet is at its natural width, as in uniaxial tension; the demo airbag rises 0.15 % less.
RESIDUAL = 1e-4


def tension_field(
    psi_hat: Callable[..., Expr],
    width: Callable[..., Expr],
    check: Callable[..., None] | None = None,
) -> SingularValueEnergy:
    """Relaxed energy of a sheet with the energy psi_hat(s1, s2) [J/m^3].

    psi(F) = (1 - k) psi_hat(a, b) + k psi_hat(s1, s2)
    a = max(s1, s2, 1),  b = max(min(s1, s2), width(a)),  k = residual

    Taut where both stretches are above their bounds, wrinkled where the smaller is below the
    natural width, slack where both are below 1. Stress is continuous, its slope is not. Without
    the residual stiffness k wrinkles and slack sheets have none of their own: :func:`forms.solve`
    copes by damping its steps, and takes more of them.

    Args:
        psi_hat: Function of the two stretches and of parameters with names.
        width: Natural width under uniaxial tension, the s2 at which d psi_hat/d s2 (s1, s2) = 0:
            a function of s1 and of the same parameters; width(1) = 1.
        check: Called with the energy's name and its parameters (residual too), to refuse bad ones.

    Returns:
        Energy of a 3x2 (or 2x2) deformation gradient, as :func:`forms.energies.principal` gives,
        with the parameters of psi_hat and ``residual`` (by default RESIDUAL).

    Raises:
        ValueError: psi_hat or width is no function of stretches.

    Source: Pipkin, IMA J. Appl. Math. 36 (1986) 85-99.
    """
    if not callable(width) or isinstance(width, ufl.core.expr.Expr):
        raise ValueError(
            "tension_field needs the natural width as a function, as lambda s1, s2: 1 / "
            f"ufl.sqrt(s1), got {type(width).__name__}."
        )
    given = list(inspect.signature(psi_hat).parameters.values()) if callable(psi_hat) else []
    if len(given) < 2:
        raise ValueError(
            "tension_field needs psi_hat as a function of two stretches and of parameters, as "
            f"lambda s1, s2, mu: ..., got {psi_hat!r}."
        )

    def relaxed(
        s1: Expr, s2: Expr, *args: Any, residual: Expr = RESIDUAL, **parameters: Any
    ) -> Expr:
        # One condition for both, so that equal stretches are told apart in one way.
        ordered = ufl.ge(s1, s2)
        larger, smaller = ufl.conditional(ordered, s1, s2), ufl.conditional(ordered, s2, s1)
        a = ufl.conditional(ufl.ge(larger, 1 - TAUT), larger, 1)
        natural = width(a, *args, **parameters)
        b = ufl.conditional(ufl.ge(smaller, natural - TAUT), smaller, natural)
        field = psi_hat(a, b, *args, **parameters)
        return (1 - residual) * field + residual * psi_hat(s1, s2, *args, **parameters)

    relaxed.__name__ = getattr(psi_hat, "__name__", "psi_hat")
    relaxed.__doc__ = psi_hat.__doc__
    # The energy finds the two stretches by their names, and takes the parameters of psi_hat; mypy
    # does not know that a function may bear a signature.
    stretches = [given[k].replace(name=name) for k, name in enumerate(("s1", "s2"))]
    extra = inspect.signature(relaxed).parameters["residual"]
    names = [*stretches, *given[2:], extra]
    relaxed.__signature__ = inspect.Signature(names)  # type: ignore[attr-defined]
    return SingularValueEnergy(relaxed, check=check)


def _check_sheet(name: str, E: Expr, nu: Expr, residual: Expr) -> None:
    _check_residual(residual)
    check_positive("Young's modulus E", E)
    check_poisson_ratio(nu)


def _check_mu(name: str, mu: Expr, residual: Expr) -> None:
    _check_residual(residual)
    check_moduli(name, mu=mu)


def _check_residual(residual: Expr) -> None:
    if isinstance(residual, Real) and not 0 <= float(residual) < 1:
        raise ValueError(f"the residual stiffness must be at least 0 and below 1, got {residual}.")


def _saint_venant_kirchhoff_tension_field(s1: Expr, s2: Expr, E: Expr, nu: Expr) -> Expr:
    """St Venant-Kirchhoff sheet in plane stress without compression [J/m^3].

    psi = E / (2 (1 - nu^2)) (e1^2 + e2^2 + 2 nu e1 e2),  e_i = (s_i^2 - 1)/2, where taut;
    psi = E/2 e1^2 where wrinkled, e2 < -nu e1; psi = 0 where slack, e1 < 0 (e1 >= e2)

    Of a sheet's deformation gradient F, shape (3, 2), Young's modulus E [Pa] and the Poisson
    ratio nu; for small strains and large rotations. For residual see :func:`tension_field`.
    """
    e1, e2 = (s1**2 - 1) / 2, (s2**2 - 1) / 2
    return E / (2 * (1 - nu**2)) * (e1**2 + e2**2 + 2 * nu * e1 * e2)


def _narrowed(s1: Expr, E: Expr, nu: Expr) -> Expr:
    # Beyond s1^2 = 1 + 1/nu, where this material has no width left, it stays as narrow as there.
    return ufl.sqrt(ufl.max_value(1 - nu * (s1**2 - 1), 1e-6))


def _neo_hookean_tension_field(s1: Expr, s2: Expr, mu: Expr) -> Expr:
    """Incompressible neo-Hookean sheet without compression [J/m^3].

    psi = mu/2 (s1^2 + s2^2 + (s1 s2)^-2 - 3) where taut; psi = mu/2 (s1^2 + 2/s1 - 3) where
    wrinkled, s2 < s1^(-1/2); psi = 0 where slack, s1 < 1 (s1 >= s2)

    Of a sheet's deformation gradient F, shape (3, 2), and the shear modulus mu [Pa].
    For residual see :func:`tension_field`.
    """
    return mu / 2 * (s1**2 + s2**2 + 1 / (s1 * s2) ** 2 - 3)


_saint_venant_kirchhoff_tension_field.__name__ = "saint_venant_kirchhoff_tension_field"
_neo_hookean_tension_field.__name__ = "neo_hookean_tension_field"
saint_venant_kirchhoff_tension_field = tension_field(
    _saint_venant_kirchhoff_tension_field, _narrowed, _check_sheet
)
neo_hookean_tension_field = tension_field(
    _neo_hookean_tension_field, lambda s1, mu: 1 / ufl.sqrt(s1), _check_mu
)
