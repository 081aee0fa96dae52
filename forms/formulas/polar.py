# SPDX-License-Identifier: MIT
"""Document 002: the energy |F A - R|^2 of the polar decomposition G = F A = R S, its derivatives.

Sections in parentheses are the document's. G, F, A and their differentials have shape (..., 3, 3),
Hessians (..., 3, 3, 3, 3); leading axes are carried along and broadcast. Energies are per unit of
stiffness, so without one.

The document's R is a rotation and its S positive semi-definite, which is both true only for det G
>= 0. ``group`` says what to give up: "SO(3)", the default, keeps R a rotation and lets the smallest
singular value carry the sign of det G; "O(3)" keeps S. All formulas hold in both, with the singular
values of the group.

The document's A is symmetric. Here it need not be, where the transposes are put in;
``as_printed=True`` leaves them out. Every ValueError names the section: tensors of another shape,
sums and differences of singular values that are 0 and divided by.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from ._algebra import EYE, Array, checked, over, squares, transpose
from .svd_derivatives import signed_svd

Group = Literal["SO(3)", "O(3)"]
ROUNDING = 8 * np.finfo(float).eps  # of singular values, relative to the largest


class Polar(NamedTuple):
    """G = R S = U diag(s) V^T with R = U V^T and S = V diag(s) V^T."""

    R: Array
    S: Array
    U: Array
    s: Array
    V: Array


def polar(G: Array, group: Group = "SO(3)") -> Polar:
    """Polar decomposition through the singular value decomposition (1)."""
    G = checked(G, "1")
    if group == "SO(3)":
        U, s, V = signed_svd(G)
    elif group == "O(3)":
        U, s, Vt = np.linalg.svd(G)
        V = transpose(Vt)
    else:
        raise ValueError(f'1 knows the groups "SO(3)" and "O(3)", got "{group}".')
    return Polar(U @ transpose(V), (V * s[..., None, :]) @ transpose(V), U, s, V)


def _divisor(s: Array, sign: int, section: str) -> Array:
    """Matrix s_i + sign s_j with ones on the diagonal, after checking the other entries."""
    names = {1: "s_i + s_j", -1: "s_i - s_j"}
    matrix = s[..., :, None] + sign * s[..., None, :]
    smallest = ROUNDING * np.max(np.abs(s), -1)[..., None, None]
    if np.any((np.abs(matrix) <= smallest) & (EYE == 0)):
        raise ValueError(f"{section} divides by {names[sign]}, which is 0 here.")
    return np.where(EYE == 0, matrix, 1.0)


def activated(F: Array, A: Array) -> Array:
    """Activated gradient G = F A, and dG = dF A."""
    return checked(F, "G = F A") @ checked(A, "G = F A")


# 2. Singular values and vectors


def projected(p: Polar, dG: Array) -> Array:
    """M = U^T dG V (2, 3.2)."""
    return transpose(p.U) @ checked(dG, "3.2") @ p.V


def stretch_rates(G: Array, dG: Array, group: Group = "SO(3)", as_printed: bool = False) -> Array:
    """Rates ds_i = (U^T dG V)_ii (2), of simple singular values.

    At equal ones the printed formula depends on the arbitrary U, V; right are the eigenvalues of
    the symmetric part of the block of U^T dG V, in falling order. No rates exist at s_i + s_j = 0.
    """
    p = polar(G, group)
    M = projected(p, dG)
    found: Array = np.einsum("...ii->...i", M).copy()
    if as_printed:
        return found
    _divisor(p.s, 1, "2")
    if group == "O(3)" and np.any(p.s[..., 2] <= ROUNDING * p.s[..., 0]):
        raise ValueError("2 needs s_i > 0 in O(3), where |s_i| has a kink at 0: take SO(3).")
    s = np.broadcast_to(p.s, found.shape)
    symmetric = (M + transpose(M)) / 2
    for state in np.ndindex(s.shape[:-1]):
        # From the largest downwards: rows i to k have the singular value s_i.
        i = 0
        while i < 3:
            k = i + int(np.sum(s[state][i:] >= s[state][i] - ROUNDING * np.abs(s[state]).max()))
            found[state][i:k] = np.linalg.eigvalsh(symmetric[state][i:k, i:k])[::-1]
            i = k
    return found


def factor_rates(G: Array, dG: Array, group: Group = "SO(3)") -> tuple[Array, Array, Array]:
    """dU, ds and dV from U^T dG V = (U^T dU) Sigma + dSigma + Sigma (dV^T V) (2), step 3.

    Both factors are skew: (U^T dU)_ij = (M_ij s_j + s_i M_ji) / (s_j^2 - s_i^2), and (dV^T V)_ij
    = (s_i M_ij + M_ji s_j) / (s_i^2 - s_j^2).
    """
    p = polar(G, group)
    M, s = projected(p, dG), p.s
    off = 1 - EYE
    gaps = _divisor(s, 1, "2") * _divisor(s, -1, "2")
    columns, rows = M * s[..., None, :], M * s[..., :, None]
    spin_U = -off * (columns + transpose(columns)) / gaps
    spin_V = off * (rows + transpose(rows)) / gaps
    return p.U @ spin_U, np.einsum("...ii->...i", M), p.V @ transpose(spin_V)


# 3. The rotation


def body_spin(p: Polar, dG: Array) -> Array:
    """Skew Omega~_ij = (M_ij - M_ji) / (s_i + s_j) (3.3)."""
    M = projected(p, dG)
    return (M - transpose(M)) / _divisor(p.s, 1, "3.3")


def angular_velocity(G: Array, dG: Array, group: Group = "SO(3)") -> Array:
    """Skew Omega = R^T dR = V Omega~ V^T (3.1, 3.4)."""
    p = polar(G, group)
    return p.V @ body_spin(p, dG) @ transpose(p.V)


def rotation_differential(G: Array, dG: Array, group: Group = "SO(3)") -> Array:
    """Differential dR = U Omega~ V^T (3.4)."""
    p = polar(G, group)
    return p.U @ body_spin(p, dG) @ transpose(p.V)


def stretch_differential(G: Array, dG: Array, group: Group = "SO(3)") -> Array:
    """Differential dS = V D V^T with D = M - Omega~ Sigma, symmetric (3.2)."""
    p = polar(G, group)
    D = projected(p, dG) - body_spin(p, dG) * p.s[..., None, :]
    return p.V @ D @ transpose(p.V)


def sylvester(Omega: Array, S: Array, dS: Array) -> Array:
    """R^T dG = Omega S + dS, the right-hand side (3.1)."""
    return checked(Omega, "3.1") @ checked(S, "3.1") + checked(dS, "3.1")


# 4. Energy and gradient


def energy(F: Array, A: Array, group: Group = "SO(3)") -> Array:
    """Psi = |F A - R|^2 (1)."""
    G = activated(F, A)
    return squares(G - polar(G, group).R)


def energy_traces(F: Array, A: Array, group: Group = "SO(3)") -> Array:
    """Psi = tr(G^T G) - 2 tr(R^T G) + tr(I) (4.1)."""
    G = activated(F, A)
    return np.asarray(squares(G) - 2 * np.einsum("...ij,...ij->...", polar(G, group).R, G) + 3)


def gradient_activated(G: Array, group: Group = "SO(3)") -> Array:
    """dPsi/dG = 2 (G - R) (4.2)."""
    return 2 * (checked(G, "4.2") - polar(G, group).R)


def first_piola(F: Array, A: Array, group: Group = "SO(3)", as_printed: bool = False) -> Array:
    """P = 2 (F A - R) A^T (4.4); printed with A, the same for symmetric A."""
    return gradient_activated(activated(F, A), group) @ (A if as_printed else transpose(A))


# 5, 6. Hessian


def hessian_product(
    F: Array, A: Array, dF: Array, group: Group = "SO(3)", as_printed: bool = False
) -> Array:
    """Differential dP = 2 (dF A - dR) A^T (5); printed with A, the same for symmetric A."""
    dG = activated(dF, A)
    dR = rotation_differential(activated(F, A), dG, group)
    return 2 * (dG - dR) @ (A if as_printed else transpose(A))


def rotation_derivative(F: Array, A: Array, group: Group = "SO(3)") -> Array:
    """dR_im/dF_kl = U_ia (dOmega~_ab/dF_kl) V_mb (6).

    dOmega~_ab/dF_kl = (U_ka (A V)_lb - U_kb (A V)_la) / (s_a + s_b), as dG = E_kl A.
    """
    p = polar(activated(F, A), group)
    M = np.einsum("...ka,...lb->...abkl", p.U, A @ p.V)
    spin = (M - np.swapaxes(M, -4, -3)) / over(_divisor(p.s, 1, "6"), 2)
    return np.einsum("...ia,...abkl,...mb->...imkl", p.U, spin, p.V, optimize=True)


def hessian(F: Array, A: Array, group: Group = "SO(3)", as_printed: bool = False) -> Array:
    """H_ijkl = dP_ij/dF_kl = 2 (d_ik (A A^T)_lj - dR_im/dF_kl A_jm) (6).

    Printed: A^2 and A_mj, the same for symmetric A.
    """
    A = checked(A, "6")
    right = A if as_printed else transpose(A)
    first = np.einsum("ik,...lj->...ijkl", EYE, A @ right)
    second = np.einsum("...imkl,...mj->...ijkl", rotation_derivative(F, A, group), right)
    return 2 * (first - second)


def identity_eigenvalues(G: Array, group: Group = "SO(3)") -> Array:
    """Eigenvalues of the Hessian for A = I (not printed), falling: 2 six times, 2 - 4/(s_i + s_j).

    Shape (..., 9). Indefinite as soon as some s_i + s_j < 2.
    """
    sums = _divisor(polar(G, group).s, 1, "2 - 4/(s_i + s_j)")
    lower = np.stack([2 - 4 / sums[..., i, j] for i, j in ((0, 1), (0, 2), (1, 2))], -1)
    all_nine = np.concatenate([np.full((*lower.shape[:-1], 6), 2.0), lower], -1)
    return -np.sort(-all_nine, -1)
