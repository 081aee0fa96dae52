# SPDX-License-Identifier: MIT
"""Document 001, section 4: the incompressible neo-Hookean sheet and its eigensystem.

Shapes, errors and U, s, V as in :mod:`forms.formulas.membrane_invariants`; mu [Pa] is a number or
an array of the leading axes, energies and their derivatives are per reference volume. The document
numbers no equation here: functions name what they compute.

``as_printed=True`` gives what the document prints where that is wrong: the rank-one term in the
first line of the Hessian, the sign of gamma in lambda_1, the exchanged last two eigenvalues.
"""

from __future__ import annotations

import numpy as np

from ._algebra import Array, Scalar, over, squares
from .membrane_invariants import (
    assemble,
    basis,
    energy_gradient,
    entries,
    gradients,
    hessians,
    invariants,
    invariants_of_gradient,
    membrane,
    stretched,
    turned,
)

TWIST = 2  # its place in membrane_invariants.basis; flip and the two normals follow


def incompressible(F: Array, mu: Scalar) -> Array:
    """psi_IncNeo = mu/2 (tr(F^T F) - 3) = mu/2 (I2 - 3) of a 3x3 F with J = 1."""
    F = np.asarray(F)
    if F.shape[-2:] != (3, 3):
        raise ValueError(f"psi_IncNeo needs gradients (..., 3, 3), got shape {F.shape}.")
    return np.asarray(mu / 2 * (squares(F) - 3))


def normal_stretch(F: Array) -> Array:
    """1/I3, the stretch along the normal that keeps J = 1."""
    I3 = invariants_of_gradient(F)[..., 2]
    if np.any(I3 == 0):
        raise ValueError("The normal stretch divides by I3, which is 0 here.")
    return np.asarray(1 / I3)


def solid_gradient(F: Array) -> Array:
    """The 3x3 gradient of the sheet, [F, n/I3] with n = f1 x f2 / I3: J = 1."""
    F, stretch = membrane(F, "The 3x3 gradient"), normal_stretch(F)
    third = over(stretch**2, 1) * np.cross(F[..., 0], F[..., 1])
    return np.concatenate([F, third[..., None]], -1)


def sheet(F: Array, mu: Scalar) -> Array:
    """psi_sheet = mu/2 (I2 + I3^-2 - 3)."""
    I2 = invariants_of_gradient(F)[..., 1]
    return np.asarray(mu / 2 * (I2 + normal_stretch(F) ** 2 - 3))


def sheet_derivatives(s: Array, mu: Scalar) -> tuple[Array, Array]:
    """Derivatives of psi_sheet by I1, I2, I3: (0, mu/2, -mu I3^-3), and 3 mu I3^-4 at I3, I3."""
    s1, s2 = stretched(s, "psi_sheet")
    mu, zero, I3 = np.broadcast_arrays(mu, np.zeros_like(s1), s1 * s2)
    second = np.zeros((*I3.shape, 3, 3))
    second[..., 2, 2] = 3 * mu / I3**4
    return np.stack([zero, mu / 2, -mu / I3**3], -1), second


def sheet_gradient(U: Array, s: Array, V: Array, mu: Scalar) -> Array:
    """dpsi_sheet/dF = mu (F - I3^-3 dI3/dF)."""
    return energy_gradient(U, s, V, sheet_derivatives(s, mu)[0])


def sheet_hessian(U: Array, s: Array, V: Array, mu: Scalar, as_printed: bool = False) -> Array:
    """mu/2 [H2 + 6 I3^-4 dI3/dF (x) dI3/dF - 2 I3^-3 H3], the first line of the Hessian.

    Printed: dI2/dF (x) dI2/dF, against the second line.
    """
    s1, s2 = stretched(s, "Hessian of psi_sheet")
    I3, g, H = over(s1 * s2, 4), gradients(U, s, V), hessians(U, s, V)
    factor = g[..., 1 if as_printed else 2, :, :]
    product = np.einsum("...ij,...kl->...ijkl", factor, factor)
    H2, H3 = H[..., 1, :, :, :, :], H[..., 2, :, :, :, :]
    return over(mu, 4) / 2 * (H2 + 6 / I3**4 * product - 2 / I3**3 * H3)


def sheet_hessian_short(U: Array, s: Array, V: Array, mu: Scalar) -> Array:
    """Its second line, mu [Id4 + 3 I3^-4 (U [s2 0; 0 s1; 0 0] V^T) (x) (the same) - I3^-3 H3]."""
    s1, s2 = stretched(s, "Hessian of psi_sheet")
    I3, zero = over(s1 * s2, 4), np.zeros_like(s1)
    factor = turned(U, entries(s2, zero, zero, s1, zero, zero), V)
    product = np.einsum("...ij,...kl->...ijkl", factor, factor)
    identity = np.einsum("ik,jl->ijkl", np.eye(3), np.eye(2))
    H3 = hessians(U, s, V)[..., 2, :, :, :, :]
    return over(mu, 4) * (identity + 3 / I3**4 * product - H3 / I3**3)


# Eigensystem


def four_eigenpairs(U: Array, s: Array, V: Array, mu: Scalar) -> tuple[Array, Array]:
    """Eigenvalues (..., 4) and eigenmatrices (..., 4, 3, 2): twist, flip, two turns of the normal.

    mu - mu I3^-3, mu + mu I3^-3, mu - mu I3^-3 s_2/s_1, mu - mu I3^-3 s_1/s_2.
    """
    s1, s2 = stretched(s, "four eigenpairs")
    term = mu / (s1 * s2) ** 3
    values = [mu - term, mu + term, mu - term * s2 / s1, mu - term * s1 / s2]
    return np.stack(values, -1), basis(U, V)[..., TWIST:, :, :]


def reduced_hessian(s: Array, mu: Scalar) -> Array:
    """Hessian on D1 and D2, mu I + mu I3^-4 [3 s2^2, 2 I3; 2 I3, 3 s1^2], shape (..., 2, 2)."""
    s1, s2 = stretched(s, "reduced Hessian")
    I3 = s1 * s2
    rows = [np.stack([3 * s2**2, 2 * I3], -1), np.stack([2 * I3, 3 * s1**2], -1)]
    return over(mu, 2) * (np.eye(2) + np.stack(rows, -2) / over(I3, 2) ** 4)


def reduced_basis(U: Array, V: Array) -> Array:
    """D1 = U [1 0; 0 0; 0 0] V^T and D2 = U [0 0; 0 1; 0 0] V^T, shape (..., 2, 3, 2)."""
    units = np.stack([entries(1.0, 0, 0, 0, 0, 0), entries(0.0, 0, 0, 1, 0, 0)])
    return turned(U[..., None, :, :], units, V[..., None, :, :])


def beta_gamma(s: Array) -> tuple[Array, Array]:
    """Quantities beta = 3 (s_2^2 - s_1^2) and gamma = (16 I3^2 + beta^2)^(1/2)."""
    s1, s2 = np.moveaxis(np.asarray(s), -1, 0)
    beta = 3 * (s2 - s1) * (s2 + s1)
    return beta, np.hypot(4 * s1 * s2, beta)


def reduced_eigenpairs(s: Array, mu: Scalar, as_printed: bool = False) -> tuple[Array, Array]:
    """lambda_1, lambda_2 (..., 2) and v_1 = [beta - gamma; 4 I3], v_2 = [beta + gamma; 4 I3].

    lambda = mu + mu (3 I2 -+ gamma)/(2 I3^4). Printed: + gamma for both. The vectors, rows of
    (..., 2, 2), are not of unit length and suffer from cancellation at s_1 >> s_2.
    """
    stretched(s, "reduced eigenpairs")
    beta, gamma = beta_gamma(s)
    I2, I3 = np.moveaxis(invariants(s), -1, 0)[1:]
    lower = gamma if as_printed else -gamma
    values = [mu + mu * (3 * I2 + sign) / (2 * I3**4) for sign in (lower, gamma)]
    rows = [np.stack([beta + sign, 4 * I3], -1) for sign in (-gamma, gamma)]
    return np.stack(values, -1), np.stack(rows, -2)


def last_eigenpairs(
    U: Array, s: Array, V: Array, mu: Scalar, as_printed: bool = False
) -> tuple[Array, Array]:
    """The final two eigenpairs, (..., 2) and (..., 2, 3, 2), of unit norm and free of cancellation.

    U [beta -+ gamma, 0; 0, 4 I3; 0, 0] V^T with mu + mu (3 I2 -+ gamma)/(2 I3^4); printed with the
    two eigenvalues exchanged. No difference is formed: (3 I2 - gamma)(3 I2 + gamma) = 20 I3^2, and
    of beta -+ gamma the sum gives the other matrix too, which is orthogonal to its own.
    """
    s1, s2 = stretched(s, "last two eigenpairs")
    beta, gamma = beta_gamma(s)
    I2, I3 = s1**2 + s2**2, s1 * s2
    lower = mu + mu * 10 / (I3**2 * (3 * I2 + gamma))
    upper = mu + mu * (3 * I2 + gamma) / (2 * I3**4)
    larger = np.abs(beta) + gamma
    length = np.hypot(larger, 4 * I3)
    long, short = larger / length, 4 * I3 / length
    # v_2 = [long, short], v_1 = [-short, long] for beta >= 0, and the other way round below.
    x = np.where(beta >= 0, short, long)
    y = np.where(beta >= 0, long, short)
    zero = np.zeros_like(x)
    matrices = [entries(-x, zero, zero, y, zero, zero), entries(y, zero, zero, x, zero, zero)]
    values = [upper, lower] if as_printed else [lower, upper]
    eigenmatrices = turned(U[..., None, :, :], np.stack(matrices, -3), V[..., None, :, :])
    return np.stack(values, -1), eigenmatrices


def eigensystem(U: Array, s: Array, V: Array, mu: Scalar) -> tuple[Array, Array]:
    """All six eigenvalues (..., 6) and orthonormal eigenmatrices (..., 6, 3, 2), the four first."""
    (first, four), (last, two) = four_eigenpairs(U, s, V, mu), last_eigenpairs(U, s, V, mu)
    return np.concatenate([first, last], -1), np.concatenate([four, two], -3)


def projected_hessian(U: Array, s: Array, V: Array, mu: Scalar) -> Array:
    """The nearest positive semi-definite Hessian: negative eigenvalues replaced by 0."""
    values, matrices = eigensystem(U, s, V, mu)
    return assemble(np.maximum(values, 0), matrices)
