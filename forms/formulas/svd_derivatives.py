# SPDX-License-Identifier: MIT
"""Document 000: dP/dF of isotropic energies through the singular value decomposition.

F = U Sigma V^T with rotations U and V; the smallest singular value carries the sign of det F. All
tensors are those of d = 3 or d = 2 dimensions: F, P, U, V (..., d, d), stretches s (..., d), dP/dF
(..., d, d, d, d), as matrices (..., d^2, d^2); leading axes are carried along and broadcast. The
energies and the quotients in B_ij are in :mod:`forms.formulas.quotients`:

    U, s, V = signed_svd(F)
    A, B = tangent_blocks(energy, s)
    dP = differential(U, V, A, B, dF)

Every ValueError names the formula: tensors and parameters of another shape, an axis that is no unit
vector, a division by 0.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ._algebra import Array, Scalar, over, transpose, unit_axis
from .quotients import (
    LEAST,
    PAIRS,
    Energy,
    clamp,
    difference_quotient,
    pair,
    stretches,
    sum_quotient,
)

# Permuted row p of the d^2 x d^2 matrix is row ORDER[d][p] of the flattened one.
ORDER = {2: (0, 3, 1, 2), 3: (0, 4, 8, 1, 3, 2, 6, 5, 7)}


def square(tensor: Array, formula: str) -> Array:
    """The tensor as an array, after checking that it is one of 2 or 3 dimensions."""
    tensor = np.asarray(tensor)
    if tensor.shape[-2:] not in ((2, 2), (3, 3)):
        raise ValueError(
            f"{formula} needs tensors (..., 2, 2) or (..., 3, 3), got shape {tensor.shape}."
        )
    return tensor


def signed_svd(F: Array) -> tuple[Array, Array, Array]:
    """Rotations U, V and s with F = U diag(s) V^T.

    |s_1| >= |s_2| >= |s_3|; only the last is negative, where det F is.
    """
    F = square(F, "F = U Sigma V^T")
    if not np.all(np.isfinite(F)):
        raise ValueError("F = U Sigma V^T needs finite entries.")
    U, s, Vt = np.linalg.svd(F)
    V = np.array(transpose(Vt))
    for orthogonal in (U, V):
        reflected = np.linalg.det(orthogonal) < 0
        orthogonal[..., :, -1] *= np.where(reflected, -1.0, 1.0)[..., None]
        s[..., -1] *= np.where(reflected, -1.0, 1.0)
    return U, s, V


def compose(U: Array, s: Array, V: Array) -> Array:
    """U diag(s) V^T: F from its stretches, P from the principal stresses psi_i."""
    return (square(U, "U Sigma V^T") * stretches(s, "U Sigma V^T")[..., None, :]) @ transpose(
        square(V, "U Sigma V^T")
    )


# Rotations


def cross_matrix(k: Array) -> Array:
    """Matrix cp of the cross product: cp x is k x x."""
    k = np.asarray(k)
    if k.shape[-1:] != (3,):
        raise ValueError(f"cp needs vectors with 3 components, got shape {k.shape}.")
    zero = np.zeros(k.shape[:-1], dtype=k.dtype)
    k1, k2, k3 = np.moveaxis(k, -1, 0)
    entries = np.stack([zero, -k3, k2, k3, zero, -k1, -k2, k1, zero], -1)
    return entries.reshape(*k.shape[:-1], 3, 3)


def axis_rotation(k: Array, theta: Scalar) -> Array:
    """Rodrigues' formula R = I + sin(theta) K + (1 - cos(theta)) K^2, K = cp(k), |k| = 1."""
    K = cross_matrix(unit_axis(k, "Rodrigues' formula"))
    return np.eye(3) + over(np.sin(theta), 2) * K + over(1 - np.cos(theta), 2) * (K @ K)


def rodrigues(r: Array) -> Array:
    """The same from r = theta k, without the division by theta: exact at r = 0 and near it."""
    K, theta = cross_matrix(r), np.linalg.norm(np.asarray(r), axis=-1)
    # sin(theta)/theta and (1 - cos(theta))/theta^2; numpy's sinc(x) is sin(pi x)/(pi x).
    first, second = np.sinc(theta / np.pi), np.sinc(theta / (2 * np.pi)) ** 2 / 2
    return np.eye(3) + over(first, 2) * K + over(second, 2) * (K @ K)


def plane_rotation(theta: Scalar) -> Array:
    """R = [[cos, -sin], [sin, cos]] of an angle, in 2D."""
    c, s = np.cos(theta), np.sin(theta)
    return np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], -2)


def deformation_gradient(s: Array, u: Array, v: Array) -> Array:
    """F(s, u, v) = U(u) diag(s) V(v)^T: rotation vectors u, v (..., 3), in 2D angles (...)."""
    rotation = rodrigues if stretches(s, "F(s, u, v)").shape[-1] == 3 else plane_rotation
    return compose(rotation(u), s, rotation(v))


# Storage


def to_vector(P: Array) -> Array:
    """P_ij as entry d i + j, i and j from 0."""
    P = square(P, "P_3(i-1)+j")
    return P.reshape(*P.shape[:-2], -1)


def from_vector(vector: Array) -> Array:
    """The inverse of :func:`to_vector`."""
    vector = np.asarray(vector)
    if vector.shape[-1:] not in ((4,), (9,)):
        raise ValueError(f"P_ij needs vectors of 9 or 4 entries, got shape {vector.shape}.")
    d = 2 if vector.shape[-1] == 4 else 3
    return vector.reshape(*vector.shape[:-1], d, d)


def to_matrix(T: Array) -> Array:
    """T_ijkl as entry (d i + j, d k + l) of a matrix, 9 x 9 or 4 x 4."""
    T = np.asarray(T)
    if T.shape[-4:] not in ((2, 2, 2, 2), (3, 3, 3, 3)):
        raise ValueError(
            "dP_3(i-1)+j / dF_3(k-1)+l needs tensors (..., d, d, d, d), d = 2 or 3,"
            f" got shape {T.shape}."
        )
    size = T.shape[-1] ** 2
    return T.reshape(*T.shape[:-4], size, size)


def _dimension(matrix: Array, formula: str) -> int:
    if matrix.shape[-2:] not in ((4, 4), (9, 9)):
        raise ValueError(f"{formula} needs matrices 9 x 9 or 4 x 4, got shape {matrix.shape}.")
    return 2 if matrix.shape[-1] == 4 else 3


def to_tensor(matrix: Array) -> Array:
    """The inverse of :func:`to_matrix`."""
    matrix = np.asarray(matrix)
    d = _dimension(matrix, "dP_ij / dF_kl")
    return matrix.reshape(*matrix.shape[:-2], d, d, d, d)


def permuted(matrix: Array) -> Array:
    """Rows and columns in the order 11, 22, 33 | 12, 21 | 13, 31 | 23, 32 (2D: 11, 22 | 12, 21)."""
    matrix = np.asarray(matrix)
    order = ORDER[_dimension(matrix, "diag(A, B12, ...)")]
    return matrix[..., order, :][..., :, order]


def unpermuted(matrix: Array) -> Array:
    """The inverse of :func:`permuted`."""
    matrix = np.asarray(matrix)
    back = np.argsort(ORDER[_dimension(matrix, "diag(A, B12, ...)")])
    return matrix[..., back, :][..., :, back]


# Blocks


def block_single(energy: Energy, s: Array, i: int, j: int, least: float | None = None) -> Array:
    """B_ij = [[si pi - sj pj, sj pi - si pj], [., .]] / (si^2 - sj^2), p = psi^'s derivatives.

    Shape (..., 2, 2), on the entries ij, ji; least clamps the denominator, which is not advisable:
    at s_i = s_j it makes the block 0.
    """
    s, si, sj = pair(s, i, j, "B_ij")
    denominator = si**2 - sj**2
    if least is not None:
        denominator = clamp(denominator, least)
    elif np.any(denominator == 0):
        raise ValueError("B_ij divides by s_i^2 - s_j^2, which is 0 here: take the split form.")
    psi = energy.gradient(s)
    psi_i, psi_j = psi[..., i], psi[..., j]
    a, b = (si * psi_i - sj * psi_j) / denominator, (sj * psi_i - si * psi_j) / denominator
    return np.stack([np.stack([a, b], -1), np.stack([b, a], -1)], -2)


def block_split(difference: Array, total: Array) -> Array:
    """B_ij = difference/2 [[1, 1], [1, 1]] + total/2 [[1, -1], [-1, 1]] from the two quotients."""
    same, other = np.ones((2, 2)), np.array([[1.0, -1.0], [-1.0, 1.0]])
    return over(difference, 2) / 2 * same + over(total, 2) / 2 * other


def tangent_blocks(
    energy: Energy,
    s: Array,
    least: float = LEAST,
    smooth: bool = False,
    points: int = 8,
    switch: float | None = 0.3,
) -> tuple[Array, Array]:
    """A = psi_ij, shape (..., d, d), and B_12, B_13, B_23 (2D: B_12), shape (..., pairs, 2, 2).

    The arguments are those of :func:`difference_quotient` and :func:`sum_quotient`.
    """
    s = stretches(s, "diag(A, B12, ...)")
    B = [
        block_split(
            difference_quotient(energy, s, i, j, points, switch),
            sum_quotient(energy, s, i, j, least, smooth, points, switch),
        )
        for i, j in PAIRS[s.shape[-1]]
    ]
    return energy.hessian(s), np.stack(B, -3)


def block_diagonal(A: Array, B: Array) -> Array:
    """diag(A, B12, B13, B23) from A (..., 3, 3) and B (..., 3, 2, 2); 2D: diag(A, B12)."""
    A, B = _blocks(A, B)
    d = A.shape[-1]
    matrix = np.zeros((*np.broadcast_shapes(A.shape[:-2], B.shape[:-3]), d**2, d**2))
    matrix[..., :d, :d] = A
    for p in range(len(PAIRS[d])):
        rows = slice(d + 2 * p, d + 2 * p + 2)
        matrix[..., rows, rows] = B[..., p, :, :]
    return matrix


def _blocks(A: Array, B: Array) -> tuple[Array, Array]:
    A, B = square(A, "A"), np.asarray(B)
    pairs = len(PAIRS[A.shape[-1]])
    if B.shape[-3:] != (pairs, 2, 2):
        raise ValueError(f"diag(A, B12, ...) needs B (..., {pairs}, 2, 2), got shape {B.shape}.")
    return A, B


# Stress and its derivative


def first_piola(energy: Energy, F: Array) -> Array:
    """P = U P^ V^T with P^ = diag(psi_i), the principal stresses."""
    U, s, V = signed_svd(F)
    return compose(U, energy.gradient(s), V)


def turned_stress(P: Callable[[Array], Array], F: Array, R: Array, Q: Array) -> Array:
    """R P(R^T F Q) Q^T: equal to P(F) for every isotropic material and all rotations R, Q."""
    return R @ P(transpose(R) @ square(F, "P(F) = R P(R^T F Q) Q^T") @ Q) @ transpose(Q)


def frozen_differential(T: Array, R: Array, Q: Array, dF: Array) -> Array:
    """Differential dP = R [dP/dF(K) : (R^T dF Q)] Q^T; T = dP/dF at K = R^T F Q, any rotations."""
    turned = transpose(square(R, "dP")) @ square(dF, "dP") @ square(Q, "dP")
    return R @ np.einsum("...klmn,...mn->...kl", T, turned) @ transpose(Q)


def tangent_at_stretches(A: Array, B: Array) -> Array:
    """dP/dF(Sigma), shape (..., d, d, d, d), from its blocks."""
    return to_tensor(unpermuted(block_diagonal(A, B)))


def differential(U: Array, V: Array, A: Array, B: Array, dF: Array) -> Array:
    """Differential dP = U [dP/dF(Sigma) : (U^T dF V)] V^T block by block, without the tensor."""
    A, B = _blocks(A, B)
    turned = transpose(square(U, "dP")) @ square(dF, "dP") @ square(V, "dP")
    stretching = np.einsum("...ij,...jj->...i", A, turned)
    dP = stretching[..., None] * np.eye(A.shape[-1])
    for p, (i, j) in enumerate(PAIRS[A.shape[-1]]):
        block = B[..., p, :, :]
        dP[..., i, j] = block[..., 0, 0] * turned[..., i, j] + block[..., 0, 1] * turned[..., j, i]
        dP[..., j, i] = block[..., 1, 0] * turned[..., i, j] + block[..., 1, 1] * turned[..., j, i]
    return U @ dP @ transpose(V)


def tangent(U: Array, V: Array, A: Array, B: Array) -> Array:
    """dP_ij/dF_rs = (dP/dF(Sigma))_klmn U_ik U_rm V_sn V_jl, shape (..., d, d, d, d)."""
    T = tangent_at_stretches(A, B)
    return np.einsum(
        "...klmn,...ik,...rm,...sn,...jl->...ijrs",
        T,
        square(U, "dP/dF"),
        U,
        square(V, "dP/dF"),
        V,
        optimize=True,
    )


def tangent_action(T: Array, dF: Array) -> Array:
    """Differential dP_ij = dP_ij/dF_rs dF_rs."""
    return np.einsum("...ijrs,...rs->...ij", T, square(dF, "dP"))
