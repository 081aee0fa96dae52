# SPDX-License-Identifier: MIT
"""Isotropic energies in invariants of C = F^T F.

Parameters are numbers or any UFL expression (Constant, Function). J <= 0 makes energies with ln J
or J^(-2/3) infinite or NaN; a solve refuses such states. The others are finite for every F.
"""

from __future__ import annotations

from collections.abc import Callable

import ufl

from .._checks import in_ufl
from .._types import Expr
from ..kinematics import green_strain, invariants, isochoric_invariants
from .moduli import check_moduli, check_positive

VOLUMETRIC = ("quadratic", "simo", "log")


def neo_hookean(F: Expr, mu: Expr, lmbda: Expr) -> Expr:
    """Compressible neo-Hookean energy with a logarithmic volume term.

    psi = mu/2 (I - 3) - mu ln J + lmbda/2 (ln J)^2

    Args:
        F: Deformation gradient, shape (3, 3).
        mu: Shear modulus [Pa], mu > 0.
        lmbda: First Lamé parameter [Pa], lmbda >= 0.

    Returns:
        Energy per reference volume [J/m^3]: zero and free of stress at F = I, infinite as J -> 0+,
        NaN for J < 0.

    Raises:
        ValueError: F is not 3x3, or mu a number not above 0.

    Source: document 003, (16).
    """
    lnJ = ufl.ln(ufl.det(_checked(F, "neo_hookean", mu=mu, lmbda=lmbda)))
    return mu / 2 * (ufl.inner(F, F) - 3) - mu * lnJ + lmbda / 2 * lnJ**2


def neo_hookean_quadratic(F: Expr, mu: Expr, lmbda: Expr) -> Expr:
    """Compressible neo-Hookean energy with a quadratic volume term.

    psi = mu/2 (I - 3) - mu ln J + lmbda/2 (J - 1)^2

    Arguments, value at rest and domain as :func:`neo_hookean`.
    Source: document 003, the isotropic part of (21).
    """
    J = ufl.det(_checked(F, "neo_hookean_quadratic", mu=mu, lmbda=lmbda))
    return mu / 2 * (ufl.inner(F, F) - 3) - mu * ufl.ln(J) + lmbda / 2 * (J - 1) ** 2


def isotropic(F: Expr, psi: Callable[[Expr, Expr, Expr], Expr]) -> Expr:
    """Energy psi(I, II, III) in the invariants of C that document 003 uses (13).

    I = tr C,  II = C : C,  III = J^2.

    Args:
        F: Deformation gradient, shape (3, 3).
        psi: Function of (I, II, III) that returns a UFL scalar [J/m^3].

    Source: document 003, III; its stresses (14), (15) are those of ``forms.stress``.
    """
    return in_ufl(psi, "isotropic's psi", *invariants(_checked(F, "isotropic")))


def volumetric(F: Expr, kappa: Expr, law: str = "quadratic") -> Expr:
    """Volumetric energy U(J), to be added to an energy of the isochoric part.

    quadratic: kappa/2 (J - 1)^2;  simo: kappa/4 (J^2 - 1 - 2 ln J);  log: kappa/2 (ln J)^2

    Args:
        F: Deformation gradient, shape (3, 3).
        kappa: Bulk modulus [Pa], kappa > 0; the same at small strains for all three laws.
        law: "quadratic" (finite for every J), "simo" or "log" (J > 0).

    Raises:
        ValueError: unknown law, F not 3x3, or kappa a number not above 0.
    """
    J = ufl.det(_checked(F, "volumetric", kappa=kappa))
    check_positive("bulk modulus kappa", kappa)
    if law == "quadratic":
        return kappa / 2 * (J - 1) ** 2
    if law == "simo":
        return kappa / 4 * (J**2 - 1 - 2 * ufl.ln(J))
    if law == "log":
        return kappa / 2 * ufl.ln(J) ** 2
    raise ValueError(f"volumetric knows the laws {', '.join(VOLUMETRIC)}, got {law!r}.")


def isochoric_neo_hookean(F: Expr, mu: Expr) -> Expr:
    """Isochoric neo-Hookean energy psi = mu/2 (J^(-2/3) I - 3) [J/m^3]; J > 0.

    Add :func:`volumetric` or :func:`with_pressure`: alone it does not resist a change of volume.
    """
    I1, _ = isochoric_invariants(_checked(F, "isochoric_neo_hookean", mu=mu))
    return mu / 2 * (I1 - 3)


def mooney_rivlin(F: Expr, c10: Expr, c01: Expr) -> Expr:
    """Isochoric Mooney-Rivlin energy [J/m^3]; J > 0.

    psi = c10 (I1 - 3) + c01 (I2 - 3),  I1 = tr C,  I2 = (I1^2 - C : C) / 2  of  C = J^(-2/3) F^T F

    Args:
        F: Deformation gradient, shape (3, 3).
        c10: Constant of I1 [Pa]; mu = 2 (c10 + c01) at small strains.
        c01: Constant of I2 [Pa].

    Add :func:`volumetric` or :func:`with_pressure`.
    """
    I1, I2 = isochoric_invariants(_checked(F, "mooney_rivlin", c10=c10, c01=c01))
    return c10 * (I1 - 3) + c01 * (I2 - 3)


def yeoh(F: Expr, c1: Expr, c2: Expr, c3: Expr) -> Expr:
    """Isochoric Yeoh energy [J/m^3]; J > 0.

    psi = c1 (I1 - 3) + c2 (I1 - 3)^2 + c3 (I1 - 3)^3,  I1 = J^(-2/3) tr C;  mu = 2 c1

    Add :func:`volumetric` or :func:`with_pressure`.
    Source: Yeoh, Rubber Chem. Technol. 66 (1993) 754-771.
    """
    I1, _ = isochoric_invariants(_checked(F, "yeoh", c1=c1, c2=c2, c3=c3))
    k = I1 - 3
    return c1 * k + c2 * k**2 + c3 * k**3


def saint_venant_kirchhoff(F: Expr, mu: Expr, lmbda: Expr) -> Expr:
    """St Venant-Kirchhoff energy psi = mu E : E + lmbda/2 (tr E)^2 [J/m^3], E = 1/2 (C - I).

    Finite for every F; it softens under strong compression and has no barrier at J = 0.
    """
    E = green_strain(_checked(F, "saint_venant_kirchhoff", mu=mu, lmbda=lmbda))
    return mu * ufl.inner(E, E) + lmbda / 2 * ufl.tr(E) ** 2


def stable_neo_hookean(F: Expr, mu: Expr, lmbda: Expr) -> Expr:
    """Stable neo-Hookean energy: free of stress at rest, finite and smooth for inverted states.

    psi = m/2 (I - 3) + l/2 (J - a)^2 - m/2 ln((I + 1)/4) - l/2 (1 - a)^2
    m = 4/3 mu,  l = lmbda + 5/6 mu,  a = 1 + 3/4 m/l

    Args:
        F: Deformation gradient, shape (3, 3).
        mu: Shear modulus at small strains [Pa], mu > 0.
        lmbda: First Lamé parameter at small strains [Pa]; lmbda + 5/6 mu > 0.

    Source: Smith, de Goes, Kim, ACM Trans. Graph. 37 (2018) 12, with the paper's constants m, l
    chosen so that small strains have the Lamé parameters given. The last term makes psi(I) = 0.
    """
    J = ufl.det(_checked(F, "stable_neo_hookean", mu=mu, lmbda=lmbda))
    m, k = 4 * mu / 3, lmbda + 5 * mu / 6
    a = 1 + 3 * m / (4 * k)
    I1 = ufl.inner(F, F)
    return (
        m / 2 * (I1 - 3)
        + k / 2 * (J - a) ** 2
        - m / 2 * ufl.ln((I1 + 1) / 4)
        - k / 2 * (1 - a) ** 2
    )


def _checked(F: Expr, name: str, **parameters: Expr) -> Expr:
    """F, after checking its shape, that numbers are finite and that a shear modulus is positive."""
    if F.ufl_shape != (3, 3):
        raise ValueError(
            f"{name} needs a 3x3 F, got shape {F.ufl_shape}: pass "
            "forms.deformation_gradient(u), which is 3x3 on plane meshes too."
        )
    check_moduli(name, **parameters)
    return F
