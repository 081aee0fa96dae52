# SPDX-License-Identifier: MIT
"""Document 003, IV and V: its two materials, their constants, and Voigt's notation.

Numbers in parentheses are the document's equations; shapes, units and errors as in
:mod:`forms.formulas.elasticity`. ``as_printed=True`` gives what the document prints where that is
wrong.
"""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np

from ._algebra import EYE, Array, Scalar, checked, dyad, outer, over, positive, squares, unit_axis
from .elasticity import left_cauchy_green, line_element, right_cauchy_green, volume_ratio

VOIGT = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))  # (27): 11, 22, 33, 12, 23, 13


# IV. Compressible neo-Hookean material


def neo_hookean(F: Array, mu: Scalar, lmbda: Scalar) -> Array:
    """Neo-Hookean energy psi = mu/2 (I - 3) - mu ln J + lmbda/2 (ln J)^2 (16)."""
    lnJ = np.log(positive(F, "(16)"))
    return mu / 2 * (squares(F) - 3) - mu * lnJ + lmbda / 2 * lnJ**2


def lame_from_shear(mu: Scalar, nu: Scalar) -> tuple[Scalar, Scalar]:
    """(mu, lmbda) with lmbda = 2 mu nu / (1 - 2 nu) (17); -1 < nu < 1/2."""
    if not np.all(np.abs(np.real(np.asarray(nu)) + 0.25) < 0.75):
        raise ValueError(f"(17) needs a Poisson ratio between -1 and 1/2, got nu = {nu}.")
    return mu, 2 * mu * nu / (1 - 2 * nu)


def neo_hookean_cauchy(F: Array, mu: Scalar, lmbda: Scalar) -> Array:
    """Cauchy stress mu/J (b - I) + lmbda/J ln J I of (16) (18)."""
    J = positive(F, "(18)")
    return over(mu / J, 2) * (left_cauchy_green(F) - EYE) + over(lmbda * np.log(J) / J, 2) * EYE


def isotropic_elasticity(lmbda: Scalar, mu: Scalar) -> Array:
    """c_ijkl = lmbda d_ij d_kl + mu (d_ik d_jl + d_il d_jk) (19)."""
    return over(lmbda, 4) * dyad(EYE, EYE) + over(mu, 4) * (2 * fourth_order_identity())


def effective_moduli(
    J: Scalar, mu: Scalar, lmbda: Scalar, as_printed: bool = False
) -> tuple[Scalar, Scalar]:
    """(lmbda', mu') = (lmbda / J, (mu - lmbda ln J) / J) (20); printed: lmbda' = mu / J."""
    smallest = np.min(np.real(np.asarray(J)))
    if not smallest > 0:
        raise ValueError(f"(20) contains ln J and needs J > 0, got J = {smallest:.3g}.")
    return (mu if as_printed else lmbda) / J, (mu - lmbda * np.log(J)) / J


def neo_hookean_elasticity(F: Array, mu: Scalar, lmbda: Scalar, as_printed: bool = False) -> Array:
    """Spatial elasticity tensor of the energy (16): (19) with the moduli (20)."""
    return isotropic_elasticity(*effective_moduli(volume_ratio(F, "(19)"), mu, lmbda, as_printed))


# V. Transversely isotropic neo-Hookean material


class Constants(NamedTuple):
    """Constants of the transversely isotropic material [Pa], in the order of (25)'s symbols."""

    mu: Scalar
    lmbda: Scalar
    alpha: Scalar
    beta: Scalar
    gamma: Scalar


def fiber_invariants(F: Array, A: Array) -> tuple[Array, Array]:
    """IV = A . C A = a . a with a = F A, V = A . C^2 A (22); |A| = 1."""
    CA = np.einsum("...ij,...j->...i", right_cauchy_green(F), unit_axis(A, "(22)"))
    return np.einsum("...i,...i->...", A, CA), np.einsum("...i,...i->...", CA, CA)


def neo_hookean_quadratic(F: Array, mu: Scalar, lmbda: Scalar) -> Array:
    """psi_nh = mu/2 (I - 3) - mu ln J + lmbda/2 (J - 1)^2 (21)."""
    J = positive(F, "(21)")
    return mu / 2 * (squares(F) - 3) - mu * np.log(J) + lmbda / 2 * (J - 1) ** 2


def transversely_isotropic(
    F: Array, A: Array, constants: Constants, as_printed: bool = False
) -> Array:
    """psi_nh + [alpha + 2 beta ln J + gamma (IV - 1)] (IV - 1) - alpha/2 (V - 1) (21).

    Printed: beta ln J, to which neither the stress (23) nor (24) nor the constants (25) belong.
    """
    mu, lmbda, alpha, beta, gamma = constants
    IV, V = fiber_invariants(F, A)
    lnJ = np.log(positive(F, "(21)"))
    axial = alpha + (1 if as_printed else 2) * beta * lnJ + gamma * (IV - 1)
    return neo_hookean_quadratic(F, mu, lmbda) + axial * (IV - 1) - alpha / 2 * (V - 1)


def neo_hookean_quadratic_cauchy(F: Array, mu: Scalar, lmbda: Scalar) -> Array:
    """Cauchy stress sigma_nh = mu/J (b - I) + lmbda (J - 1) I (23)."""
    J = positive(F, "(23)")
    return over(mu / J, 2) * (left_cauchy_green(F) - EYE) + over(lmbda * (J - 1), 2) * EYE


def transversely_isotropic_cauchy(F: Array, A: Array, constants: Constants) -> Array:
    """Cauchy stress sigma_nh + sigma_trns (23), with a = F A.

    sigma_trns = 2 beta/J (a . a - 1) I + 2/J [alpha + 2 beta ln J + 2 gamma (a . a - 1)] a (x) a
                 - alpha/J (b a (x) a + a (x) b a)
    """
    mu, lmbda, alpha, beta, gamma = constants
    J, b, a, k = _fiber_state(F, A, "(23)")
    ba = np.einsum("...ij,...j->...i", b, a)
    axial = alpha + 2 * beta * np.log(J) + 2 * gamma * k
    return (
        neo_hookean_quadratic_cauchy(F, mu, lmbda)
        + over(2 * beta / J * k, 2) * EYE
        + over(2 / J * axial, 2) * outer(a, a)
        - over(alpha / J, 2) * (outer(ba, a) + outer(a, ba))
    )


def fourth_order_identity(as_printed: bool = False) -> Array:
    """i_ijkl = 1/2 (d_ik d_jl + d_il d_jk) (24); printed: d_ik d_jl, without minor symmetry."""
    identity: Array = np.einsum("ik,jl->ijkl", EYE, EYE)
    return identity if as_printed else (identity + np.swapaxes(identity, 2, 3)) / 2


def fiber_tensor(a: Array, b: Array, as_printed: bool = False) -> Array:
    """a_i a_l b_jk + a_i a_k b_jl + b_ik a_j a_l + b_il a_j a_k (24).

    Printed: the first and third term, symmetric in ij alone, with half the action on strains.
    """
    aa = outer(a, a)
    printed = np.einsum("...il,...jk->...ijkl", aa, b) + np.einsum("...ik,...jl->...ijkl", b, aa)
    return printed if as_printed else printed + np.swapaxes(printed, -1, -2)


def neo_hookean_quadratic_elasticity(
    F: Array, mu: Scalar, lmbda: Scalar, as_printed: bool = False
) -> Array:
    """c_nh = lmbda (2J - 1) I (x) I + 2/J [mu - lmbda J (J - 1)] i (24).

    Printed: 2J - 1 in the second bracket too, and i without minor symmetry.
    """
    J = positive(F, "(24)")
    second = 2 / J * (mu - lmbda * J * ((2 * J - 1) if as_printed else (J - 1)))
    volume = over(lmbda * (2 * J - 1), 4) * dyad(EYE, EYE)
    return volume + over(second, 4) * fourth_order_identity(as_printed)


def transversely_isotropic_elasticity(
    F: Array, A: Array, constants: Constants, as_printed: bool = False
) -> Array:
    """Spatial elasticity tensor c_nh + c_trns (24), with the 4-tensors i and a above.

    c_trns = 8 gamma/J a (x) a (x) a (x) a + 4 beta/J (a (x) a (x) I + I (x) a (x) a)
             - alpha/J a - 4 beta/J (a . a - 1) i
    """
    mu, lmbda, alpha, beta, gamma = constants
    J, b, a, k = _fiber_state(F, A, "(24)")
    aa = outer(a, a)
    return (
        neo_hookean_quadratic_elasticity(F, mu, lmbda, as_printed)
        + over(8 * gamma / J, 4) * dyad(aa, aa)
        + over(4 * beta / J, 4) * (dyad(aa, EYE) + dyad(EYE, aa))
        - over(alpha / J, 4) * fiber_tensor(a, b, as_printed)
        - over(4 * beta / J * k, 4) * fourth_order_identity(as_printed)
    )


def transversely_isotropic_constants(
    mu: float, nu: float, E_A: float, G_A: float, as_printed: bool = False
) -> Constants:
    """Constants from shear modulus, Poisson ratio, axial Young's and shear modulus (25).

    n = 2 mu (1 + nu) / E_A, m = 1 - nu - 2 n nu^2; nu in the plane and under axial load.
    Printed: n inverted, which returns another axial modulus than was put in.
    """
    E_t = 2 * mu * (1 + nu)
    n = E_A / E_t if as_printed else E_t / E_A
    m = _stable(1 - nu - 2 * n * nu**2)
    lmbda, alpha = 2 * mu * (nu + n * nu**2) / m, mu - G_A
    beta = mu * nu**2 * (1 - n) / (2 * m)
    gamma = E_A * (1 - nu) / (8 * m) - (lmbda + 2 * mu) / 8 + alpha / 2 - beta
    return Constants(mu, lmbda, alpha, beta, gamma)


def transversely_isotropic_constants_five(
    E_A: float, E_t: float, nu_t: float, nu_A: float, G_A: float
) -> Constants:
    """The constants of (25) from all five moduli; (25) is the case nu_t = nu_A.

    n = E_t / E_A, m = 1 - nu_t - 2 n nu_A^2, nu_A = -eps_t / eps_A under axial load,
    lmbda = E_t (nu_t + n nu_A^2) / ((1 + nu_t) m),
    beta = E_t (nu_A (1 + nu_t) - nu_t - n nu_A^2) / (4 (1 + nu_t) m)
    """
    n, mu = E_t / E_A, E_t / (2 * (1 + nu_t))
    m = _stable(1 - nu_t - 2 * n * nu_A**2)
    lmbda, alpha = 2 * mu * (nu_t + n * nu_A**2) / m, mu - G_A
    beta = mu * (nu_A * (1 + nu_t) - nu_t - n * nu_A**2) / (2 * m)
    gamma = E_A * (1 - nu_t) / (8 * m) - (lmbda + 2 * mu) / 8 + alpha / 2 - beta
    return Constants(mu, lmbda, alpha, beta, gamma)


def transversely_isotropic_cauchy_components(F: Array, A: Array, constants: Constants) -> Array:
    """sigma_ij written out in components (26), the same as (23)."""
    mu, lmbda, alpha, beta, gamma = constants
    J, b, a, k = _fiber_state(F, A, "(26)")
    sigma = np.empty((*J.shape, 3, 3), dtype=J.dtype)
    axial = alpha + 2 * beta * np.log(J) + 2 * gamma * k
    for i, j in product(range(3), repeat=2):
        b_a = sum(b[..., i, s] * a[..., s] * a[..., j] for s in range(3))
        a_b = sum(a[..., i] * b[..., j, r] * a[..., r] for r in range(3))
        nh = mu / J * (b[..., i, j] - EYE[i, j]) + lmbda * (J - 1) * EYE[i, j]
        trns = 2 * beta / J * k * EYE[i, j] + 2 / J * axial * a[..., i] * a[..., j]
        sigma[..., i, j] = nh + trns - alpha / J * (b_a + a_b)
    return sigma


def transversely_isotropic_elasticity_components(
    F: Array, A: Array, constants: Constants, as_printed: bool = False
) -> Array:
    """c_ijkl written out in components (26), the same as (24)."""
    mu, lmbda, alpha, beta, gamma = constants
    J, b, a, k = _fiber_state(F, A, "(26)")
    c = np.empty((*J.shape, 3, 3, 3, 3), dtype=J.dtype)
    volume = mu - lmbda * J * ((2 * J - 1) if as_printed else (J - 1))
    for i, j, m, n in product(range(3), repeat=4):
        a_i, a_j, a_m, a_n = (a[..., index] for index in (i, j, m, n))
        unit = EYE[i, m] * EYE[j, n]
        fiber = a_i * a_n * b[..., j, m] + b[..., i, m] * a_j * a_n
        if not as_printed:
            unit = (unit + EYE[i, n] * EYE[j, m]) / 2
            fiber = fiber + a_i * a_m * b[..., j, n] + b[..., i, n] * a_j * a_m
        nh = lmbda * (2 * J - 1) * EYE[i, j] * EYE[m, n] + 2 / J * volume * unit
        trns = 8 * gamma / J * a_i * a_j * a_m * a_n - alpha / J * fiber
        trns = trns + 4 * beta / J * (a_i * a_j * EYE[m, n] + EYE[i, j] * a_m * a_n)
        c[..., i, j, m, n] = nh + trns - 4 * beta / J * k * unit
    return c


def voigt_stress(sigma: Array) -> Array:
    """Vector (11, 22, 33, 12, 23, 13) of a symmetric stress, shape (..., 6) (27)."""
    return np.stack([checked(sigma, "(27)")[..., i, j] for i, j in VOIGT], axis=-1)


def voigt_elasticity(c: Array) -> Array:
    """6x6 matrix of an elasticity tensor in the order (27) (28); symmetric if c is."""
    return np.stack([voigt_stress(c[..., i, j, :, :]) for i, j in VOIGT], axis=-2)


def voigt_strain(eps: Array) -> Array:
    """Vector (11, 22, 33, 2*12, 2*23, 2*13) of a strain (45), or of a strain rate (46)."""
    return voigt_stress(checked(eps, "(45)")) * np.array([1, 1, 1, 2, 2, 2])


def stress_from_voigt(vector: Array) -> Array:
    """Symmetric stress (..., 3, 3) of a Voigt vector, the inverse of (27)."""
    full = [[0, 3, 5], [3, 1, 4], [5, 4, 2]]
    return np.asarray(vector)[..., full]


def strain_from_voigt(vector: Array) -> Array:
    """Symmetric strain (..., 3, 3) of a Voigt vector, the inverse of (45)."""
    return stress_from_voigt(vector / np.array([1, 1, 1, 2, 2, 2]))


def elasticity_from_voigt(matrix: Array) -> Array:
    """Elasticity tensor with minor symmetries of a 6x6 matrix, the inverse of (28)."""
    rows = stress_from_voigt(matrix)  # (..., I, k, l)
    return np.moveaxis(stress_from_voigt(np.moveaxis(rows, -3, -1)), (-4, -3), (-2, -1))


def _fiber_state(F: Array, A: Array, equation: str) -> tuple[Array, Array, Array, Array]:
    """J, b, a = F A and a . a - 1."""
    J, a = positive(F, equation), line_element(F, unit_axis(A, equation))
    return J, left_cauchy_green(F), a, np.einsum("...i,...i->...", a, a) - 1


def _stable(m: float) -> float:
    if not m > 0:
        raise ValueError(f"(25) divides by m = 1 - nu - 2 n nu^2, which must be > 0, got {m:.3g}.")
    return m
