# SPDX-License-Identifier: MIT
"""Document 003, I-III: strains, stresses, elasticity tensors, isotropic energies.

Numbers in parentheses are the document's equations. Tensors fill the last axes: F, C, S, sigma
(..., 3, 3), elasticity tensors (..., 3, 3, 3, 3), vectors (..., 3); leading axes are carried along
and broadcast. Moduli, J and energies are numbers or arrays of the leading axes; moduli, stresses
and energies are in Pa = J/m^3. All functions take complex arguments, for complex steps.

``as_printed=True`` gives what the document prints where that is wrong. Every ValueError names the
equation: tensors of another shape, singular F, J <= 0 in a logarithm, an axis that is no unit
vector, moduli that no material has.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ._algebra import (
    EYE,
    Array,
    Scalar,
    checked,
    determinant,
    gauss,
    inverse,
    over,
    regular,
    symmetric_derivative,
    transpose,
)

# I. Strain tensors


def line_element(F: Array, dX: Array) -> Array:
    """Deformed line element dx = F dX (1)."""
    return np.einsum("...ij,...j->...i", checked(F, "(1)"), dX)


def deformation_gradient(dx: Array, dX: Array) -> Array:
    """F = sum_j dx_j (x) dX_j* (2) from three line elements in columns, before and after.

    For dX = I column j of dx is the derivative of x with respect to X_j.
    """
    return checked(dx, "(2)") @ inverse(dX, "(2)")


def volume_ratio(F: Array, equation: str = "J") -> Array:
    """J = det F = dv / dV, as a triple product."""
    return determinant(F, equation)


def right_cauchy_green(F: Array) -> Array:
    """Right Cauchy-Green tensor C = F^T F, below (3)."""
    return transpose(checked(F, "(3)")) @ F


def left_cauchy_green(F: Array) -> Array:
    """Left Cauchy-Green tensor b = F F^T, below (4)."""
    return checked(F, "(4)") @ transpose(F)


def spatial_product(F: Array, dX1: Array, dX2: Array) -> Array:
    """dx1 . dx2 = dX1 . C dX2 (3)."""
    return np.einsum("...i,...ij,...j->...", dX1, right_cauchy_green(F), dX2)


def material_product(F: Array, dx1: Array, dx2: Array) -> Array:
    """dX1 . dX2 = dx1 . b^-1 dx2 (4)."""
    return np.einsum("...i,...ij,...j->...", dx1, inverse(left_cauchy_green(F), "(4)"), dx2)


def green_strain(F: Array) -> Array:
    """Green strain E = 1/2 (C - I) (5)."""
    return (right_cauchy_green(F) - EYE) / 2


def almansi_strain(F: Array) -> Array:
    """Almansi strain e = 1/2 (I - b^-1) (5)."""
    return (EYE - inverse(left_cauchy_green(F), "(5)")) / 2


def pair_strain(F: Array, dX1: Array, dX2: Array) -> Array:
    """Strain of two line elements, 1/2 (dx1 . dx2 - dX1 . dX2) = dX1 . E dX2, above (5)."""
    return np.einsum("...i,...ij,...j->...", dX1, green_strain(F), dX2)


def pair_strain_spatial(F: Array, dx1: Array, dx2: Array) -> Array:
    """The same from the deformed line elements, dx1 . e dx2, above (5)."""
    return np.einsum("...i,...ij,...j->...", dx1, almansi_strain(F), dx2)


def stretch(F: Array, dX: Array) -> Array:
    """Stretch |dx| / |dX| of a line element, the root of (3) over dX . dX."""
    return np.sqrt(spatial_product(F, dX, dX) / np.einsum("...i,...i->...", dX, dX))


# II. Elasticity tensors


def stress_power(P: Array, F_dot: Array) -> Array:
    """psi_dot = P : F_dot [W/m^3] (6)."""
    return np.einsum("...ij,...ij->...", P, F_dot)


def stress_power_cauchy_green(S: Array, C_dot: Array) -> Array:
    """psi_dot = 1/2 S : C_dot [W/m^3] (7)."""
    return np.einsum("...ij,...ij->...", S, C_dot) / 2


def stress_power_green(S: Array, E_dot: Array, as_printed: bool = False) -> Array:
    """psi_dot = dpsi/dE : E_dot = S : E_dot [W/m^3], last term of (7); printed: half of it."""
    return np.einsum("...ij,...ij->...", S, E_dot) * (0.5 if as_printed else 1.0)


def work(
    P: Callable[[Array], Array],
    F: Callable[[Array], Array],
    F_dot: Callable[[Array], Array],
    t0: float,
    t1: float,
    points: int = 20,
) -> float:
    """Change of the energy along a path, int P(F) : F_dot dt (6), by Gauss-Legendre points.

    F and F_dot give the path and its rate, shape (points, 3, 3), at times of shape (points,).
    """
    t, w = gauss(t0, t1, points)
    return float(w @ stress_power(P(F(t)), F_dot(t)))


def work_cauchy_green(
    S: Callable[[Array], Array],
    C: Callable[[Array], Array],
    C_dot: Callable[[Array], Array],
    t0: float,
    t1: float,
    points: int = 20,
    as_printed: bool = False,
) -> float:
    """The same from S(C): 1/2 int S(C) : C_dot dt (7); printed without the 1/2."""
    t, w = gauss(t0, t1, points)
    return float(w @ stress_power_cauchy_green(S(C(t)), C_dot(t))) * (2.0 if as_printed else 1.0)


def strain_derivative(F: Array, grad_u: Array) -> Array:
    """DE[u] = 1/2 (F^T grad0 u + (grad0 u)^T F) (8), grad0 the gradient in X."""
    product_ = transpose(checked(F, "(8)")) @ grad_u
    return (product_ + transpose(product_)) / 2


def stress_derivative(CC: Array, DE: Array) -> Array:
    """DS[u] = CC : DE[u] (8), (9)."""
    return np.einsum("...ijkl,...kl->...ij", CC, DE)


def strain_rate_derivative(grad_v: Array, grad_u: Array, as_printed: bool = False) -> Array:
    """D(dE_dot)[u] = 1/2 ((grad0 dv)^T grad0 u + (grad0 u)^T grad0 dv) (31).

    Printed: (grad0 u)^T grad0 dv, which is the same only inside S : [...].
    """
    product_ = transpose(checked(grad_u, "(31)")) @ grad_v
    return product_ if as_printed else (product_ + transpose(product_)) / 2


def second_piola(psi: Callable[[Array], Array], C: Array) -> Array:
    """S = 2 dpsi/dC (7), (14) of any energy psi(C), by complex steps: exact to rounding."""
    return 2 * symmetric_derivative(psi, C)


def material_elasticity(S: Callable[[Array], Array], C: Array) -> Array:
    """CC = dS/dE = 2 dS/dC (10) of any stress S(C), by complex steps: exact to rounding."""
    return 2 * np.moveaxis(symmetric_derivative(S, C), (-4, -3), (-2, -1))


def first_piola(S: Array, F: Array) -> Array:
    """First Piola-Kirchhoff stress P = F S."""
    return checked(F, "P = F S") @ S


def kirchhoff(S: Array, F: Array) -> Array:
    """Kirchhoff stress J sigma = F S F^T."""
    return first_piola(S, F) @ transpose(F)


def push_forward(S: Array, F: Array) -> Array:
    """Cauchy stress sigma = J^-1 F S F^T, above (15)."""
    return kirchhoff(S, F) / over(regular(F, "(15)"), 2)


def pull_back(sigma: Array, F: Array) -> Array:
    """Second Piola-Kirchhoff stress S = J F^-1 sigma F^-T, the inverse of :func:`push_forward`."""
    G = inverse(F, "(15)")
    return over(volume_ratio(F), 2) * (G @ sigma @ transpose(G))


def push_forward_elasticity(CC: Array, F: Array) -> Array:
    """c_ijkl = J^-1 F_iI F_jJ F_kK F_lL CC_IJKL (12)."""
    pushed = np.einsum("...ia,...jb,...kc,...ld,...abcd->...ijkl", F, F, F, F, CC, optimize=True)
    return pushed / over(regular(F, "(12)"), 4)


def pull_back_elasticity(c: Array, F: Array) -> Array:
    """CC_IJKL = J F^-1_Ii F^-1_Jj F^-1_Kk F^-1_Ll c_ijkl, the inverse of (12)."""
    return push_forward_elasticity(c, inverse(F, "(12)"))


def rate_of_deformation(velocity_gradient: Array) -> Array:
    """Rate of deformation d = 1/2 (l + l^T), in (11)."""
    return (checked(velocity_gradient, "(11)") + transpose(velocity_gradient)) / 2


def stress_rate(c: Array, d: Array) -> Array:
    """Truesdell rate of the Cauchy stress from the material, c : d (11)."""
    return np.einsum("...ijkl,...kl->...ij", c, d)


def truesdell_rate(sigma: Array, sigma_dot: Array, velocity_gradient: Array) -> Array:
    """sigma_dot - l sigma - sigma l^T + tr(l) sigma, the rate meant in (11) (not printed there)."""
    l_sigma = checked(velocity_gradient, "(11)") @ sigma
    trace = np.einsum("...ii->...", velocity_gradient)
    return sigma_dot - l_sigma - transpose(l_sigma) + over(trace, 2) * sigma


# III. Isotropic hyperelasticity


def invariants(C: Array) -> tuple[Array, Array, Array]:
    """I = tr C, II = C : C, III = det C = J^2 (13); II is not the classical (I^2 - C : C)/2."""
    C = checked(C, "(13)")
    return np.einsum("...ii->...", C), np.einsum("...ij,...ij->...", C, C), volume_ratio(C)


def isotropic_second_piola(C: Array, psi_I: Scalar, psi_II: Scalar, psi_III: Scalar) -> Array:
    """S = 2 psi_I I + 4 psi_II C + 2 J^2 psi_III C^-1 (14), psi_I = dpsi/dI and so on."""
    third = volume_ratio(C, "(14)") * psi_III
    return (
        2 * over(psi_I, 2) * EYE + 4 * over(psi_II, 2) * C + 2 * over(third, 2) * inverse(C, "(14)")
    )


def isotropic_cauchy(F: Array, psi_I: Scalar, psi_II: Scalar, psi_III: Scalar) -> Array:
    """Cauchy stress 2 J^-1 psi_I b + 4 J^-1 psi_II b^2 + 2 J psi_III I (15)."""
    J, b = regular(F, "(15)"), left_cauchy_green(F)
    return (
        2 * over(psi_I / J, 2) * b
        + 4 * over(psi_II / J, 2) * (b @ b)
        + 2 * over(J * psi_III, 2) * EYE
    )
