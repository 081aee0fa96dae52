# SPDX-License-Identifier: MIT
"""Document 001, sections 1-3: the invariants of a 3x2 deformation gradient and their derivatives.

J. Panetta, Analytic Eigensystems for Isotropic Membrane Energies. F = U Sigma V^T is 3x2, U is in
O(3) with the surface normal as its third column, V in O(2), s_1 >= s_2 >= 0. Numbers in parentheses
are the document's equations and sections. F and what is like F have shape (..., 3, 2), s (..., 2),
U (..., 3, 3), V (..., 2, 2), Hessians (..., 3, 2, 3, 2); leading axes are carried along and
broadcast. U^T F_dot V = [a b; c d; e f]. Derivatives take U, s, V of :func:`svd` and do not depend
on the signs of its columns.

``as_printed=True`` gives what the document prints where that is wrong. Every ValueError names the
equation: another shape, singular values that it divides by.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ._algebra import Array, Scalar, over, transpose

ROOT = 1 / np.sqrt(2)
# The eigenmatrices of 2D: stretch, the stretch of opposite signs, twist, flip.
PLANE = ROOT * np.array([[[1, 0], [0, 1]], [[1, 0], [0, -1]], [[0, -1], [1, 0]], [[0, 1], [1, 0]]])


def membrane(F: Array, equation: str) -> Array:
    """F as an array, after checking its shape."""
    F = np.asarray(F)
    if F.shape[-2:] != (3, 2):
        raise ValueError(f"{equation} needs gradients (..., 3, 2), got shape {F.shape}.")
    return F


def stretched(s: Array, equation: str) -> tuple[Array, Array]:
    """The singular values s_1 and s_2, after checking that there are two and that none is 0."""
    s = np.asarray(s)
    if s.shape[-1:] != (2,):
        raise ValueError(f"{equation} needs singular values (..., 2), got shape {s.shape}.")
    if np.any(s == 0):
        raise ValueError(f"{equation} divides by the singular values, of which one is 0 here.")
    return s[..., 0], s[..., 1]


def svd(F: Array) -> tuple[Array, Array, Array]:
    """U in O(3), s and V in O(2) with F = U [diag(s); 0] V^T; U's third column is the normal."""
    U, s, Vt = np.linalg.svd(membrane(F, "F = U Sigma V^T"), full_matrices=True)
    return U, s, transpose(Vt)


def turned(U: Array, matrix: Array, V: Array) -> Array:
    """U matrix V^T of a 3x2 matrix."""
    return U @ membrane(matrix, "U [.] V^T") @ transpose(V)


def entries(a: Scalar, b: Scalar, c: Scalar, d: Scalar, e: Scalar, f: Scalar) -> Array:
    """The matrix [a b; c d; e f], shape (..., 3, 2)."""
    stacked = np.stack(np.broadcast_arrays(a, b, c, d, e, f), -1)
    return stacked.reshape(*stacked.shape[:-1], 3, 2)


def padded(matrix: Array) -> Array:
    """A 2x2 matrix with a third row of zeros: membrane eigenmatrices from those of 2D."""
    matrix = np.asarray(matrix)
    if matrix.shape[-2:] != (2, 2):
        raise ValueError(f"Padding needs matrices (..., 2, 2), got shape {matrix.shape}.")
    return np.concatenate([matrix, np.zeros((*matrix.shape[:-2], 1, 2))], -2)


# Invariants


def invariants(s: Array) -> Array:
    """I1 = s_1 + s_2, I2 = s_1^2 + s_2^2, I3 = s_1 s_2, in the last axis."""
    s1, s2 = np.moveaxis(np.asarray(s), -1, 0)
    return np.stack([s1 + s2, s1**2 + s2**2, s1 * s2], -1)


def invariants_of_gradient(F: Array) -> Array:
    """The same without singular values: I2 = F : F, I3 = |f1 x f2|, I1 = (I2 + 2 I3)^(1/2)."""
    F = membrane(F, "I1, I2, I3")
    I2 = np.sum(F**2, (-2, -1))
    I3 = np.sqrt(np.sum(np.cross(F[..., 0], F[..., 1]) ** 2, -1))
    return np.stack([np.sqrt(I2 + 2 * I3), I2, I3], -1)


def second_invariant(A: Array, as_printed: bool = False) -> Array:
    """The other I2 of footnote 1, 1/2 (tr(A)^2 - tr(A^2)): det A, so I3, for 2x2 matrices.

    Printed with |A|_F^2 for tr(A^2), the same for symmetric A only.
    """
    A = np.asarray(A)
    if A.shape[-2:] != (2, 2):
        raise ValueError(f"Footnote 1 needs matrices (..., 2, 2), got shape {A.shape}.")
    squares = np.einsum("...ij,...ij->..." if as_printed else "...ij,...ji->...", A, A)
    return np.asarray((np.trace(A, axis1=-2, axis2=-1) ** 2 - squares) / 2)


# 1. Differentiating the SVD


class Rates(NamedTuple):
    """s_dot (..., 2); omega (..., 3) of U^T U_dot and alpha (...) of V_dot^T V, both skew."""

    s_dot: Array
    omega: Array
    alpha: Array


def in_plane_rates(s: Array, b: Scalar, c: Scalar) -> tuple[Array, Array]:
    """Rates omega_z and alpha of (3): s_2 wz + s_1 alpha = -b, s_1 wz + s_2 alpha = c."""
    s1, s2 = np.moveaxis(np.asarray(s), -1, 0)
    determinant = s1**2 - s2**2
    if np.any(determinant == 0):
        raise ValueError("(3) divides by s_1^2 - s_2^2, which is 0 here: only wz + alpha exists.")
    return (s1 * c + s2 * b) / determinant, -(s1 * b + s2 * c) / determinant


def in_plane_sum(s: Array, b: Scalar, c: Scalar) -> Array:
    """Sum wz + alpha = (c - b)/(s_1 + s_2) of the rates in (3), which exists at s_1 = s_2 too."""
    s1, s2 = stretched(s, "wz + alpha")
    return (c - b) / (s1 + s2)


def normal_rates(s: Array, e: Scalar, f: Scalar) -> tuple[Array, Array]:
    """Rates omega_x = f/s_2 and omega_y = -e/s_1 of the normal (1.1), about U's columns."""
    s1, s2 = stretched(s, "1.1")
    return f / s2, -e / s1


def rates(U: Array, s: Array, V: Array, F_dot: Array) -> Rates:
    """Rates of the singular value decomposition under F_dot, (2) solved."""
    M = transpose(U) @ membrane(F_dot, "(2)") @ V
    omega_z, alpha = in_plane_rates(s, M[..., 0, 1], M[..., 1, 0])
    omega_x, omega_y = normal_rates(s, M[..., 2, 0], M[..., 2, 1])
    s_dot = np.stack([M[..., 0, 0], M[..., 1, 1]], -1)
    return Rates(s_dot, np.stack([omega_x, omega_y, omega_z], -1), alpha)


def velocity(s: Array, rates: Rates) -> Array:
    """U^T F_dot V from the rates, the right-hand side of (2)."""
    s1, s2 = np.moveaxis(np.asarray(s), -1, 0)
    (wx, wy, wz), alpha = np.moveaxis(rates.omega, -1, 0), rates.alpha
    d1, d2 = np.moveaxis(rates.s_dot, -1, 0)
    return entries(d1, -(s2 * wz + s1 * alpha), s1 * wz + s2 * alpha, d2, -s1 * wy, s2 * wx)


def rotation_rates(U: Array, V: Array, rates: Rates) -> tuple[Array, Array]:
    """U_dot = U (U^T U_dot) and V_dot = V (V_dot^T V)^T with the skew matrices below (1)."""
    (wx, wy, wz), alpha = np.moveaxis(rates.omega, -1, 0), rates.alpha
    zero = np.zeros_like(wx)
    spin = np.stack([zero, -wz, wy, wz, zero, -wx, -wy, wx, zero], -1)
    turn = np.stack([zero, alpha, -alpha, zero], -1)
    U_dot = U @ spin.reshape(*zero.shape, 3, 3)
    return U_dot, V @ turn.reshape(*zero.shape, 2, 2)


def velocity_sum(U: Array, s: Array, V: Array, U_dot: Array, s_dot: Array, V_dot: Array) -> Array:
    """F_dot = U_dot Sigma V^T + U Sigma_dot V^T + U Sigma V_dot^T (1)."""
    Sigma, Sigma_dot = (padded(over(x, 1) * np.eye(2)) for x in (np.asarray(s), np.asarray(s_dot)))
    return turned(U_dot, Sigma, V) + turned(U, Sigma_dot, V) + turned(U, Sigma, V_dot)


def split(U: Array, V: Array, F_dot: Array) -> tuple[Array, Array]:
    """F_dot as stretching and turning in the plane [a b; c d; 0 0] and tilting [0 0; 0 0; e f]."""
    M = transpose(U) @ membrane(F_dot, "1.1") @ V
    tilt = M * np.array([[0.0], [0.0], [1.0]])
    return turned(U, M - tilt, V), turned(U, tilt, V)


def normal_velocity(U: Array, s: Array, V: Array, F_dot: Array) -> tuple[Array, Array]:
    """Angular velocity of the normal, wx u1 + wy u2, and n_dot = its cross product with n (1.1)."""
    M = transpose(U) @ membrane(F_dot, "1.1") @ V
    wx, wy = normal_rates(s, M[..., 2, 0], M[..., 2, 1])
    # det U = -1 turns the axes round, not the motion: u1 x n = -det(U) u2.
    sense = np.linalg.det(U)[..., None]
    spin = sense * (over(wx, 1) * U[..., :, 0] + over(wy, 1) * U[..., :, 1])
    return spin, np.cross(spin, U[..., :, 2])


# 2. Gradients


def gradients(U: Array, s: Array, V: Array) -> Array:
    """Gradients of I1, I2 = 2 F and I3, in the axis before the last two: (..., 3, 3, 2)."""
    s1, s2 = np.moveaxis(np.asarray(s), -1, 0)
    one, zero = np.ones_like(s1), np.zeros_like(s1)
    diagonals = ((one, one), (2 * s1, 2 * s2), (s2, s1))
    matrices = np.stack([entries(x, zero, zero, y, zero, zero) for x, y in diagonals], -3)
    return turned(U[..., None, :, :], matrices, V[..., None, :, :])


# 3. Hessians


def hessian_products(U: Array, s: Array, V: Array, F_dot: Array) -> Array:
    """Hessians of I1, I2, I3 applied to F_dot, in the axis before the last two: (..., 3, 3, 2)."""
    s1, s2 = stretched(s, "Hessians of I1 and I3")
    M = transpose(U) @ membrane(F_dot, "Hessians of I1, I2, I3") @ V
    a, b, c, d, e, f = (M[..., i, j] for i in range(3) for j in range(2))
    turn = (c - b) / (s1 + s2)
    H1 = entries(np.zeros_like(turn), -turn, turn, np.zeros_like(turn), e / s1, f / s2)
    H3 = entries(d, -c, -b, a, s2 / s1 * e, s1 / s2 * f)
    return turned(U[..., None, :, :], np.stack([H1, 2 * M, H3], -3), V[..., None, :, :])


def basis(U: Array, V: Array) -> Array:
    """Six orthonormal matrices U [.] V^T, shape (..., 6, 3, 2).

    Stretch, the stretch of opposite signs, twist, flip, the two turns of the normal.
    """
    tilts = np.array([[[0.0, 0], [0, 0], [1, 0]], [[0, 0], [0, 0], [0, 1]]])
    return turned(U[..., None, :, :], np.concatenate([padded(PLANE), tilts]), V[..., None, :, :])


def eigenvalues(s: Array) -> Array:
    """Eigenvalues of the Hessians of I1, I2, I3 on :func:`basis`, shape (..., 3, 6)."""
    s1, s2 = stretched(s, "eigenvalues of I1 and I3")
    one, zero = np.ones_like(s1), np.zeros_like(s1)
    first = [zero, zero, 2 / (s1 + s2), zero, 1 / s1, 1 / s2]  # the zeros: its null space
    third = [one, -one, one, -one, s2 / s1, s1 / s2]
    return np.stack([np.stack(row, -1) for row in (first, [2 * one] * 6, third)], -2)


def assemble(values: Array, matrices: Array) -> Array:
    """Hessian sum_k lambda_k Q_k (x) Q_k of eigenvalues (..., 6), eigenmatrices (..., 6, 3, 2)."""
    return np.einsum("...k,...kij,...klm->...ijlm", values, matrices, matrices)


def hessians(U: Array, s: Array, V: Array) -> Array:
    """Hessians of I1, I2, I3, shape (..., 3, 3, 2, 3, 2)."""
    return assemble(eigenvalues(s), basis(U, V)[..., None, :, :, :])


def to_matrix(H: Array) -> Array:
    """H_ijkl as entry (2 i + j, 2 k + l) of a 6x6 matrix, indices from 0."""
    H = np.asarray(H)
    if H.shape[-4:] != (3, 2, 3, 2):
        raise ValueError(f"The 6x6 matrix needs Hessians (..., 3, 2, 3, 2), got shape {H.shape}.")
    return H.reshape(*H.shape[:-4], 6, 6)


def energy_gradient(U: Array, s: Array, V: Array, psi_I: Array) -> Array:
    """dpsi/dF = sum_k psi_k dI_k/dF of any psi(I1, I2, I3), psi_k in psi_I (..., 3)."""
    return np.einsum("...k,...kij->...ij", psi_I, gradients(U, s, V))


def energy_hessian(U: Array, s: Array, V: Array, psi_I: Array, psi_II: Array) -> Array:
    """d2psi/dF2 = sum_kl psi_kl dI_k/dF (x) dI_l/dF + sum_k psi_k d2I_k/dF2, psi_II (..., 3, 3)."""
    g = gradients(U, s, V)
    products = np.einsum("...ab,...aij,...bkl->...ijkl", psi_II, g, g, optimize=True)
    return products + np.einsum("...a,...aijkl->...ijkl", psi_I, hessians(U, s, V))
