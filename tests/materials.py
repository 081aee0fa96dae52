# SPDX-License-Identifier: MIT
"""Document 003's materials with parameters, and derivatives at any state by complex steps."""

import numpy as np
import pytest
from cases import (
    FIBER,
    LMBDA,
    MU,
    TRANSVERSE,
    random_state,
)

from variform.forms.formulas import elasticity as el
from variform.forms.formulas import materials as ma

EYE, H = np.eye(3), 1e-40
BASIS = np.einsum("ik,jl->ijkl", EYE, EYE)  # BASIS[i, j] = e_i (x) e_j
CONSTANTS = ma.transversely_isotropic_constants(**TRANSVERSE)
# The state at which misprints are measured.
F0 = np.array([[1.2, 0.3, -0.1], [-0.2, 0.9, 0.25], [0.15, -0.05, 1.1]])
MATERIALS = {
    "neo_hookean": (
        lambda F: ma.neo_hookean(F, MU, LMBDA),
        lambda F: ma.neo_hookean_cauchy(F, MU, LMBDA),
        lambda F: ma.neo_hookean_elasticity(F, MU, LMBDA),
    ),
    "neo_hookean_quadratic": (
        lambda F: ma.neo_hookean_quadratic(F, MU, LMBDA),
        lambda F: ma.neo_hookean_quadratic_cauchy(F, MU, LMBDA),
        lambda F: ma.neo_hookean_quadratic_elasticity(F, MU, LMBDA),
    ),
    "transversely_isotropic": (
        lambda F: ma.transversely_isotropic(F, FIBER, CONSTANTS),
        lambda F: ma.transversely_isotropic_cauchy(F, FIBER, CONSTANTS),
        lambda F: ma.transversely_isotropic_elasticity(F, FIBER, CONSTANTS),
    ),
}
every_material = pytest.mark.parametrize("name", MATERIALS)


def states(rng, count=6):
    return np.array([random_state(rng) for _ in range(count)])


def step(f, x, direction):
    """Derivative of f at x along a direction, exact to rounding."""
    return np.imag(f(x + 1j * H * direction)) / H


def stress_from(psi, F):
    """P = dpsi/dF, one complex step per entry."""
    return step(psi, F[..., None, None, :, :], BASIS)


def cauchy_from(psi, F):
    J = np.linalg.det(F)[..., None, None]
    return np.einsum("...ij,...kj->...ik", stress_from(psi, F), F) / J


def elasticity_from(sigma, F):
    """c_ijkl = J^-1 F_jJ F_lL dP_iJ/dF_kL - d_ik sigma_jl, dP/dF by complex steps of sigma(F)."""

    def P(G):
        J = el.volume_ratio(G)[..., None, None]
        return J * np.einsum("...ij,...kj->...ik", sigma(G), np.linalg.inv(G))

    A = np.moveaxis(step(P, F[..., None, None, :, :], BASIS), (-4, -3), (-2, -1))
    J = np.linalg.det(F)[..., None, None, None, None]
    pushed = np.einsum("...jJ,...lL,...iJkL->...ijkl", F, F, A) / J
    return pushed - np.einsum("ik,...jl->...ijkl", EYE, sigma(F))
