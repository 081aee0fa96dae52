# SPDX-License-Identifier: MIT
"""Transversely isotropic energies: one family of fibers."""

from __future__ import annotations

import ufl

from .._checks import direction
from .._types import Expr
from ..kinematics import fiber_invariants, green_strain
from .invariants import _checked, neo_hookean_quadratic


def transversely_isotropic_neo_hookean(
    F: Expr, mu: Expr, lmbda: Expr, alpha: Expr, beta: Expr, gamma: Expr, fiber: Expr
) -> Expr:
    """Transversely isotropic neo-Hookean energy.

    psi = mu/2 (I - 3) - mu ln J + lmbda/2 (J - 1)^2
          + (alpha + 2 beta ln J + gamma (IV - 1)) (IV - 1) - alpha/2 (V - 1)

    Args:
        F: Deformation gradient, shape (3, 3).
        mu: In-plane shear modulus [Pa].
        lmbda: Constant [Pa].
        alpha: Constant [Pa]; the axial shear modulus is mu - alpha.
        beta: Constant [Pa].
        gamma: Constant [Pa].
        fiber: Unit direction A in the reference body, shape (3,).

    Returns:
        Energy per reference volume [J/m^3]: zero and free of stress at F = I; J > 0.

    Source: document 003, (21), with 2 beta ln J where the print has beta ln J: only so do the
    stress (23), the tangent (24) and the constants (25) belong to it.
    """
    constants = {"mu": mu, "lmbda": lmbda, "alpha": alpha, "beta": beta, "gamma": gamma}
    J = ufl.det(_checked(F, "transversely_isotropic_neo_hookean", **constants))
    IV, V = fiber_invariants(F, fiber)
    axial = (alpha + 2 * beta * ufl.ln(J) + gamma * (IV - 1)) * (IV - 1) - alpha / 2 * (V - 1)
    return neo_hookean_quadratic(F, mu, lmbda) + axial


def transversely_isotropic_constants(mu: float, nu: float, E_A: float, G_A: float) -> dict:
    """Constants (lmbda, alpha, beta, gamma) from four engineering moduli.

    n = 2 mu (1 + nu) / E_A,  m = 1 - nu - 2 n nu^2
    lmbda = 2 mu (nu + n nu^2) / m,  alpha = mu - G_A,  beta = mu nu^2 (1 - n) / (2 m)
    gamma = E_A (1 - nu) / (8 m) - (lmbda + 2 mu) / 8 + alpha / 2 - beta

    Args:
        mu: In-plane shear modulus [Pa].
        nu: Poisson ratio, in plane and under axial load.
        E_A: Axial Young's modulus [Pa].
        G_A: Axial shear modulus [Pa].

    Returns:
        Keyword arguments mu, lmbda, alpha, beta, gamma of
        :func:`transversely_isotropic_neo_hookean` [Pa].

    Raises:
        ValueError: moduli that no stable material has.

    Source: document 003, (25), with n inverted: the print has n = E_A / (2 mu (1 + nu)), which
    returns another axial modulus than was put in.
    """
    return transversely_isotropic_constants_five(E_A, 2 * mu * (1 + nu), nu, nu, G_A)


def transversely_isotropic_constants_five(
    E_A: float, E_t: float, nu_t: float, nu_A: float, G_A: float
) -> dict:
    """Constants (mu, lmbda, alpha, beta, gamma) from all five engineering moduli.

    n = E_t / E_A,  m = 1 - nu_t - 2 n nu_A^2,  mu = E_t / (2 (1 + nu_t))
    lmbda = E_t (nu_t + n nu_A^2) / ((1 + nu_t) m),  alpha = mu - G_A
    beta = E_t (nu_A (1 + nu_t) - nu_t - n nu_A^2) / (4 m (1 + nu_t))
    gamma = E_A (1 - nu_t) / (8 m) - (lmbda + 2 mu) / 8 + alpha / 2 - beta

    Args:
        E_A: Axial Young's modulus [Pa].
        E_t: Transverse (in-plane) Young's modulus [Pa].
        nu_t: Poisson ratio in the plane of isotropy.
        nu_A: Poisson ratio under axial load, -eps_t / eps_A.
        G_A: Axial shear modulus [Pa].

    Returns:
        Keyword arguments mu, lmbda, alpha, beta, gamma of
        :func:`transversely_isotropic_neo_hookean` [Pa].

    Raises:
        ValueError: a modulus that is not positive, |nu_t| >= 1, or m <= 0.
    """
    for name, value in (("E_A", E_A), ("E_t", E_t), ("G_A", G_A)):
        if not value > 0:
            raise ValueError(f"{name} must be positive, got {value}.")
    if not -1 < nu_t < 1:
        raise ValueError(f"the in-plane Poisson ratio must lie between -1 and 1, got {nu_t}.")
    n = E_t / E_A
    m = 1 - nu_t - 2 * n * nu_A**2
    if not m > 0:
        raise ValueError(
            f"no stable material has these moduli: 1 - nu_t - 2 (E_t/E_A) nu_A^2 = {m:.3g}, "
            "which must be positive; lower a Poisson ratio or raise E_A."
        )
    mu = E_t / (2 * (1 + nu_t))
    lmbda = E_t * (nu_t + n * nu_A**2) / ((1 + nu_t) * m)
    alpha = mu - G_A
    beta = E_t * (nu_A * (1 + nu_t) - nu_t - n * nu_A**2) / (4 * m * (1 + nu_t))
    gamma = E_A * (1 - nu_t) / (8 * m) - (lmbda + 2 * mu) / 8 + alpha / 2 - beta
    return {"mu": mu, "lmbda": lmbda, "alpha": alpha, "beta": beta, "gamma": gamma}


def guccione(F: Expr, C: Expr, bf: Expr, bt: Expr, bfs: Expr, fiber: Expr) -> Expr:
    """Guccione's exponential energy of passive heart muscle.

    psi = C/2 (exp Q - 1)
    Q = bf E11^2 + bt (E22^2 + E33^2 + 2 E23^2) + 2 bfs (E12^2 + E13^2), axis 1 along the fiber

    Q is invariant under rotation about the fiber, so the fiber alone defines it:
    with E11 = A . E A and |E A|^2 = E11^2 + E12^2 + E13^2,
    Q = bf E11^2 + bt (E : E - 2 |E A|^2 + E11^2) + 2 bfs (|E A|^2 - E11^2).

    Args:
        F: Deformation gradient, shape (3, 3).
        C: Scale [Pa], C > 0.
        bf: Exponent along the fiber.
        bt: Exponent across the fiber.
        bfs: Exponent of the fiber shears.
        fiber: Unit direction A in the reference body, shape (3,).

    Returns:
        Energy per reference volume [J/m^3], finite for every F. It has no volume term: add
        :func:`with_pressure` or :func:`volumetric`, and best pass ``isochoric(F)`` for F.

    Source: Land et al., Proc. R. Soc. A 471 (2015) 20150641, section 2.
    """
    E = green_strain(_checked(F, "guccione", C=C, bf=bf, bt=bt, bfs=bfs))
    fiber = direction(fiber, "a fiber")
    EA = E * fiber
    E11, EA2 = ufl.dot(fiber, EA), ufl.dot(EA, EA)
    across = ufl.inner(E, E) - 2 * EA2 + E11**2
    Q = bf * E11**2 + bt * across + 2 * bfs * (EA2 - E11**2)
    return C / 2 * (ufl.exp(Q) - 1)
