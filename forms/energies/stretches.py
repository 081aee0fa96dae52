# SPDX-License-Identifier: MIT
"""Energies in the singular values s1, s2, s3 of F: right at rest, flat, inverted, everywhere.

Each is called as the other energies are, ``fixed_corotated(F, mu, lmbda)``; the function written
here is psi_hat, from which stress and tangent follow by differentiation. Each also works on arrays:
``P, dPdF = fixed_corotated.evaluate(F_array, mu, lmbda)``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from numbers import Real

import ufl

from .._types import Expr
from ..operators.energy import SingularValueEnergy
from .moduli import check_moduli


def principal(
    psi_hat: Callable[..., Expr], *, improper: bool = False, clamp: float = 1e-6
) -> SingularValueEnergy:
    """The energy psi(F) = psi_hat(s1, s2, s3) of a function of the singular values.

    ``energy = principal(lambda s1, s2, s3: ...)``; then ``energy(F)`` in a potential. See
    :class:`forms.operators.SingularValueEnergy` for the arguments and for what may stand in it.
    """
    return SingularValueEnergy(psi_hat, improper=improper, clamp=clamp)


def _energy(psi_hat: Callable[..., Expr]) -> SingularValueEnergy:
    return SingularValueEnergy(psi_hat, check=check_moduli)


@_energy
def fixed_corotated(s1: Expr, s2: Expr, s3: Expr, mu: Expr, lmbda: Expr) -> Expr:
    """Fixed corotated energy: finite for every F, with a resistance to the change of volume.

    psi = mu sum_i (s_i - 1)^2 + lmbda/2 (J - 1)^2 = mu |F - R|^2 + lmbda/2 (J - 1)^2

    Of a deformation gradient F, shape (3, 3), the shear modulus mu [Pa] and the first Lamé
    parameter lmbda [Pa] of small strains; per reference volume [J/m^3]. Not smooth where two
    singular values are opposite.

    Source: Stomakhin et al., Proc. SCA (2012) 25-32; derivatives by document 000.
    """
    return mu * _squares(s1 - 1, s2 - 1, s3 - 1) + lmbda / 2 * (s1 * s2 * s3 - 1) ** 2


@_energy
def corotated_linear(s1: Expr, s2: Expr, s3: Expr, mu: Expr, lmbda: Expr) -> Expr:
    """Corotated linear elasticity, psi = mu sum_i (s_i - 1)^2 + lmbda/2 (sum_i s_i - 3)^2.

    Arguments and domain as :func:`fixed_corotated`.
    """
    return mu * _squares(s1 - 1, s2 - 1, s3 - 1) + lmbda / 2 * (s1 + s2 + s3 - 3) ** 2


@_energy
def as_rigid_as_possible(s1: Expr, s2: Expr, s3: Expr, mu: Expr) -> Expr:
    """Distance from the nearest rotation, psi = mu sum_i (s_i - 1)^2 = mu |F - R|^2 (ARAP).

    Arguments and domain as :func:`fixed_corotated`; with :func:`activated` it moves muscles.
    """
    return mu * _squares(s1 - 1, s2 - 1, s3 - 1)


@_energy
def symmetric_dirichlet(s1: Expr, s2: Expr, s3: Expr, mu: Expr) -> Expr:
    """Symmetric Dirichlet energy, psi = mu/4 sum_i (s_i^2 + s_i^-2 - 2); infinite where J = 0.

    The factor makes mu the shear modulus at small strains. As it is even in each singular value
    it does not tell inverted states from others: only its barrier at s_i = 0 keeps them apart.

    Source: Smith, Schaefer, ACM Trans. Graph. 34 (2015) 70, up to the factor.
    """
    return mu / 4 * sum(s**2 + 1 / s**2 - 2 for s in (s1, s2, s3))


@_energy
def hencky(s1: Expr, s2: Expr, s3: Expr, mu: Expr, lmbda: Expr) -> Expr:
    """Hencky energy of logarithmic strains, psi = mu sum_i (ln s_i)^2 + lmbda/2 (ln J)^2; J > 0."""
    logs = [ufl.ln(s) for s in (s1, s2, s3)]
    return mu * _squares(*logs) + lmbda / 2 * sum(logs) ** 2


def _check_ogden(name: str, mu: Sequence, alpha: Sequence) -> None:
    for key, value in (("mu", mu), ("alpha", alpha)):
        if not isinstance(value, list | tuple) or not value:
            raise ValueError(f"{name} needs {key} as a list, one entry per term, got {value!r}.")
    if len(mu) != len(alpha):
        raise ValueError(
            f"{name} needs as many mu as alpha, got {len(mu)} and {len(alpha)}: one of each per "
            "term."
        )


def _ogden(s1: Expr, s2: Expr, s3: Expr, mu: Sequence[Expr], alpha: Sequence[Expr]) -> Expr:
    """Isochoric Ogden energy of any number of terms [J/m^3]; J > 0.

    psi = sum_p mu_p/alpha_p (sum_i (J^(-1/3) s_i)^alpha_p - 3);  2 mu = sum_p mu_p alpha_p

    Of F, shape (3, 3), the moduli mu_p [Pa], a list, and as many exponents alpha_p.

    Add :func:`volumetric` or :func:`with_pressure`: alone it does not resist a change of volume.
    Source: Ogden, Proc. R. Soc. Lond. A 326 (1972) 565-584.
    """
    m = ufl.ln(s1 * s2 * s3) / 3
    logs = [ufl.ln(s) - m for s in (s1, s2, s3)]
    terms = zip(mu, alpha, strict=True)
    return sum(m / a * (sum(ufl.exp(a * x) for x in logs) - 3) for m, a in terms)


ogden = SingularValueEnergy(_ogden, check=_check_ogden)


@_energy
def neo_hookean_stretches(s1: Expr, s2: Expr, s3: Expr, mu: Expr, lmbda: Expr) -> Expr:
    """:func:`neo_hookean` (16) written in singular values, to compare the two ways; J > 0."""
    lnJ = ufl.ln(s1 * s2 * s3)
    return mu / 2 * (_squares(s1, s2, s3) - 3) - mu * lnJ + lmbda / 2 * lnJ**2


@_energy
def saint_venant_kirchhoff_stretches(s1: Expr, s2: Expr, s3: Expr, mu: Expr, lmbda: Expr) -> Expr:
    """:func:`saint_venant_kirchhoff` written in singular values, to compare the two ways."""
    e = [(s**2 - 1) / 2 for s in (s1, s2, s3)]
    return mu * _squares(*e) + lmbda / 2 * sum(e) ** 2


@_energy
def stable_neo_hookean_stretches(s1: Expr, s2: Expr, s3: Expr, mu: Expr, lmbda: Expr) -> Expr:
    """:func:`stable_neo_hookean` written in singular values: its tangent can be projected."""
    m, k = 4 * mu / 3, lmbda + 5 * mu / 6
    a = 1 + 3 * m / (4 * k)
    I1, J = _squares(s1, s2, s3), s1 * s2 * s3
    barrier = m / 2 * ufl.ln((I1 + 1) / 4)
    return m / 2 * (I1 - 3) + k / 2 * (J - a) ** 2 - barrier - k / 2 * (1 - a) ** 2


def extended(energy: SingularValueEnergy, below: float) -> SingularValueEnergy:
    """An energy continued below a stretch, so that it is finite for flat and inverted states.

    With q_i = max(s_i, a) and d_i = min(s_i - a, 0):
    psi(s) = prod_i (1 + d_i d/dq_i + d_i^2/2 d^2/dq_i^2) psi_hat(q)

    the Taylor expansion of second order in each singular value below a: stress and tangent stay
    continuous there.

    Args:
        energy: Energy in singular values that is smooth where they are at least a.
        below: Stretch a, 0 < a < 1, below which the expansion holds.

    Raises:
        ValueError: another energy, or a outside (0, 1).

    Source: after Stomakhin et al., Proc. SCA (2012) 25-32, who extend along rays.
    """
    if not isinstance(energy, SingularValueEnergy):
        raise ValueError(
            "extended needs an energy in singular values, as hencky, got "
            f"{getattr(energy, '__name__', type(energy).__name__)}."
        )
    if not (isinstance(below, Real) and 0 < below < 1):
        raise ValueError(f"extended needs a stretch below between 0 and 1, got {below}.")
    return energy.mapped(lambda psi_hat: _taylor(psi_hat, below), f"extended_{energy.name}")


def _taylor(psi_hat: Callable[..., Expr], a: float) -> Callable[..., Expr]:
    def continued(*s: Expr) -> Expr:
        low = [ufl.lt(x, a) for x in s]
        q = [ufl.variable(ufl.conditional(c, a, x)) for c, x in zip(low, s, strict=True)]
        d = [ufl.conditional(c, x - a, 0) for c, x in zip(low, s, strict=True)]
        psi = psi_hat(*q)
        for qi, di in zip(q, d, strict=True):
            slope = ufl.diff(psi, qi)
            psi = psi + di * slope + di**2 / 2 * ufl.diff(slope, qi)
        return psi

    return continued


def _squares(*x: Expr) -> Expr:
    return sum(xi**2 for xi in x)
