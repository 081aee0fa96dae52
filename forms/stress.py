# SPDX-License-Identifier: MIT
"""Stresses and elasticity tensors of any energy, by differentiation with respect to F.

psi must be an expression of F, and F a ``ufl.variable`` as the functions of
:mod:`forms.kinematics` return it. Equation numbers are those of document 003.
"""

from __future__ import annotations

import ufl
from ufl.corealg.traversal import unique_pre_traversal

from ._types import Expr
from .differentiation import diff

VOIGT = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))  # (27): 11, 22, 33, 12, 23, 13


def first_piola(psi: Expr, F: Expr) -> Expr:
    """First Piola-Kirchhoff stress P = dpsi/dF [Pa] (6): force per reference area.

    Raises:
        ValueError: F is no ``ufl.variable``, or not the one that psi was written with.
    """
    if not isinstance(F, ufl.classes.Variable):
        raise ValueError(
            "the stress is dpsi/dF and needs the ufl.variable F that psi was written with; "
            "take F from forms.deformation_gradient, or wrap yours in ufl.variable first."
        )
    found = (e for e in unique_pre_traversal(ufl.as_ufl(psi)) if isinstance(e, type(F)))
    if all(e.label() != F.label() for e in found):
        raise ValueError(
            "psi was not written with this F, so that dpsi/dF would be 0: pass the same F to the "
            "energy and to the stress."
        )
    return diff(psi, F)


def second_piola(psi: Expr, F: Expr) -> Expr:
    """Second Piola-Kirchhoff stress S = F^-1 P = 2 dpsi/dC [Pa] (7), (14); symmetric."""
    return ufl.inv(F) * first_piola(psi, F)


def kirchhoff(psi: Expr, F: Expr) -> Expr:
    """Kirchhoff stress J sigma = P F^T [Pa]."""
    return first_piola(psi, F) * F.T


def cauchy(psi: Expr, F: Expr) -> Expr:
    """Cauchy stress sigma = J^-1 P F^T [Pa] (15): force per deformed area."""
    return kirchhoff(psi, F) / ufl.det(F)


def push_forward(S: Expr, F: Expr) -> Expr:
    """Cauchy stress J^-1 F S F^T of a second Piola-Kirchhoff stress."""
    return F * S * F.T / ufl.det(F)


def pull_back(sigma: Expr, F: Expr) -> Expr:
    """Second Piola-Kirchhoff stress J F^-1 sigma F^-T of a Cauchy stress."""
    G = ufl.inv(F)
    return ufl.det(F) * G * sigma * G.T


def first_elasticity(psi: Expr, F: Expr) -> Expr:
    """First elasticity tensor A_iJkL = d2psi / dF_iJ dF_kL [Pa], shape (3, 3, 3, 3)."""
    return diff(first_piola(psi, F), F)


def material_elasticity(psi: Expr, F: Expr) -> Expr:
    """Material elasticity tensor dS/dE = 4 d2psi/dCdC [Pa] (10), shape (3, 3, 3, 3).

    From A = d2psi/dFdF:  CC_IJKL = F^-1_Ii F^-1_Kk (A_iJkL - delta_ik S_JL),
    which needs no form of psi in terms of C.
    """
    i, k, I, J, K, L = ufl.indices(6)  # noqa: E741 - the indices of (12)
    G, S, A = ufl.inv(F), second_piola(psi, F), first_elasticity(psi, F)
    geometric = A[i, J, k, L] - ufl.Identity(3)[i, k] * S[J, L]
    return ufl.as_tensor(G[I, i] * G[K, k] * geometric, (I, J, K, L))


def spatial_elasticity(psi: Expr, F: Expr) -> Expr:
    """Spatial elasticity tensor c = J^-1 F F F F CC [Pa] (12), shape (3, 3, 3, 3).

    c_ijkl = J^-1 F_jJ F_lL A_iJkL - delta_ik sigma_jl, the same without inverting F.
    """
    i, j, k, n, J, L = ufl.indices(6)
    A, sigma = first_elasticity(psi, F), cauchy(psi, F)
    pushed = F[j, J] * F[n, L] * A[i, J, k, L] / ufl.det(F)
    return ufl.as_tensor(pushed - ufl.Identity(3)[i, k] * sigma[j, n], (i, j, k, n))


def push_forward_elasticity(CC: Expr, F: Expr) -> Expr:
    """Spatial tensor c_ijkl = J^-1 F_iI F_jJ F_kK F_lL CC_IJKL of a material one (12)."""
    i, j, k, n, I, J, K, L = ufl.indices(8)  # noqa: E741 - the indices of (12)
    pushed = F[i, I] * F[j, J] * F[k, K] * F[n, L] * CC[I, J, K, L] / ufl.det(F)
    return ufl.as_tensor(pushed, (i, j, k, n))


def pull_back_elasticity(c: Expr, F: Expr) -> Expr:
    """Material tensor of a spatial one, the inverse of :func:`push_forward_elasticity`."""
    return push_forward_elasticity(c, ufl.inv(F))


def voigt_stress(sigma: Expr) -> Expr:
    """Voigt vector (11, 22, 33, 12, 23, 13) of a symmetric stress, shape (6,) (27)."""
    return ufl.as_vector([sigma[i, j] for i, j in VOIGT])


def voigt_strain(eps: Expr) -> Expr:
    """Voigt vector (11, 22, 33, 2*12, 2*23, 2*13) of a symmetric strain, shape (6,) (45)."""
    return ufl.as_vector([(1 if i == j else 2) * eps[i, j] for i, j in VOIGT])


def voigt_elasticity(c: Expr) -> Expr:
    """6x6 matrix of an elasticity tensor with minor symmetries (28), in the order (27)."""
    return ufl.as_matrix([[c[i, j, k, n] for k, n in VOIGT] for i, j in VOIGT])
