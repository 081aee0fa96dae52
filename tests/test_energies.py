# SPDX-License-Identifier: MIT
"""Laws of every energy: rest, objectivity, small-strain moduli, stresses in closed form, domain."""

import functools
import math

import numpy as np
import pytest
import reference
import ufl
from cases import (
    ENERGIES,
    FIBER,
    KAPPA,
    LMBDA,
    MU,
    STRETCHES,
    TRANSVERSE,
    Pointwise,
    random_rotation,
    random_state,
)
from mpmath import mpf

from variform.forms import energies, stress

EVERY = ENERGIES | STRETCHES
every_energy = pytest.mark.parametrize("name", EVERY)


@functools.cache
def evaluator(name):
    return Pointwise(EVERY[name])


@every_energy
def test_rest_is_free_of_energy_and_stress(name):
    """psi(I) = 0 and P(I) = 0, to rounding of terms of the size of the moduli."""
    rest = evaluator(name)(np.eye(3))
    assert abs(rest["psi"]) < 1e-14
    assert np.abs(rest["P"]).max() < 1e-14


@every_energy
def test_objectivity(name, rng):
    """psi(Q F) = psi(F), P(Q F) = Q P(F) and S(Q F) = S(F) = S^T for every rotation Q."""
    at = evaluator(name)
    for _ in range(5):
        F, Q = random_state(rng), random_rotation(rng)
        plain, turned = at(F), at(Q @ F)
        size = np.abs(plain["P"]).max()
        assert turned["psi"] == pytest.approx(plain["psi"], rel=1e-11)
        assert np.abs(turned["P"] - Q @ plain["P"]).max() < 1e-11 * size
        assert np.abs(turned["S"] - plain["S"]).max() < 1e-11 * size
        assert np.abs(plain["S"] - plain["S"].T).max() < 1e-12 * size


@every_energy
def test_isotropy_or_symmetry_about_the_fiber(name, rng):
    """psi(F Q) = psi(F): all rotations for isotropic energies, those about the fiber for others."""
    at = evaluator(name)
    F, angle = random_state(rng), 1.1
    Q = random_rotation(rng)
    if name in ("transversely_isotropic", "guccione"):
        K = np.cross(np.eye(3), -FIBER)
        axial = np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K
        assert abs(at(F @ Q)["psi"] / at(F)["psi"] - 1) > 1e-3
        Q = axial
    assert at(F @ Q)["psi"] == pytest.approx(at(F)["psi"], rel=1e-11)


@pytest.mark.parametrize(
    ("name", "mu", "lmbda"),
    [
        ("neo_hookean", MU, LMBDA),
        ("neo_hookean_quadratic", MU, LMBDA),
        # the C : C term, 0.1 |C - I|^2 = 0.4 E : E, adds 0.4 to mu
        ("isotropic", MU + 0.4, LMBDA),
        ("isochoric_neo_hookean", MU, KAPPA - 2 / 3 * MU),
        ("volumetric_quadratic", MU, KAPPA - 2 / 3 * MU),
        ("volumetric_log", MU, KAPPA - 2 / 3 * MU),
        ("mooney_rivlin", 2 * (0.4 + 0.25), KAPPA - 4 / 3 * 0.65),
        ("yeoh", 2 * 0.65, KAPPA - 4 / 3 * 0.65),
        ("saint_venant_kirchhoff", MU, LMBDA),
        ("stable_neo_hookean", MU, LMBDA),
        ("fixed_corotated", MU, LMBDA),
        ("corotated_linear", MU, LMBDA),
        ("as_rigid_as_possible", MU, KAPPA),
        ("symmetric_dirichlet", MU, 0.0),
        ("hencky", MU, LMBDA),
        # 2 mu = sum mu_p alpha_p = 2.66
        ("ogden", 1.33, KAPPA - 2 / 3 * 1.33),
        ("neo_hookean_stretches", MU, LMBDA),
        ("saint_venant_kirchhoff_stretches", MU, LMBDA),
        ("stable_neo_hookean_stretches", MU, LMBDA),
        ("extended_hencky", MU, LMBDA),
        ("activated", MU, KAPPA),
        # mu/2 sum s^2 - mu J has the Hessian of mu (sum e_i^2 - .. ): mu, and lmbda = kappa - mu
        ("written_by_a_user", MU, KAPPA - MU),
    ],
)
def test_small_strains_have_the_lame_parameters(name, mu, lmbda):
    """c(I) = lmbda I (x) I + 2 mu i, in the Voigt order 11, 22, 33, 12, 23, 13."""
    wanted = np.diag([2 * mu] * 3 + [mu] * 3)
    wanted[:3, :3] += lmbda
    assert np.abs(evaluator(name)(np.eye(3))["c"] - wanted).max() < 1e-13 * mu * 10


def engineering_moduli(c):
    """E_A, E_t, nu_t, nu_A, G_A of a 6x6 stiffness whose axis is e1."""
    S = np.linalg.inv(c)
    return np.array([1 / S[0, 0], 1 / S[1, 1], -S[1, 2] / S[1, 1], -S[0, 1] / S[0, 0], 1 / S[3, 3]])


def test_transversely_isotropic_moduli_come_back():
    """(25): the material has the mu, nu, E_A, G_A that its constants were made from."""
    constants = energies.transversely_isotropic_constants(**TRANSVERSE)
    axis = ufl.as_vector([1.0, 0.0, 0.0])
    at = Pointwise(
        lambda F: energies.transversely_isotropic_neo_hookean(F, **constants, fiber=axis)
    )
    E_A, E_t, nu_t, nu_A, G_A = engineering_moduli(at(np.eye(3))["c"])
    mu, nu = TRANSVERSE["mu"], TRANSVERSE["nu"]
    assert [E_A, G_A] == pytest.approx([TRANSVERSE["E_A"], TRANSVERSE["G_A"]], rel=1e-12)
    assert [E_t, nu_t, nu_A] == pytest.approx([2 * mu * (1 + nu), nu, nu], rel=1e-12)


def test_five_transversely_isotropic_moduli_come_back():
    """All five engineering moduli come back, and the four-constant form is the case nu_t = nu_A."""
    wanted = {"E_A": 9.0, "E_t": 3.0, "nu_t": 0.35, "nu_A": 0.2, "G_A": 0.8}
    constants = energies.transversely_isotropic_constants_five(**wanted)
    axis = ufl.as_vector([1.0, 0.0, 0.0])
    at = Pointwise(
        lambda F: energies.transversely_isotropic_neo_hookean(F, **constants, fiber=axis)
    )
    found = engineering_moduli(at(np.eye(3))["c"])
    assert found == pytest.approx(list(wanted.values()), rel=1e-12)


def test_neo_hookean_stress_and_elasticity(rng):
    """(18), (19) with lambda' = lambda/J: sigma and c of the neo-Hookean energy (16)."""
    for _ in range(5):
        F = random_state(rng)
        J, b = np.linalg.det(F), F @ F.T
        sigma = MU / J * (b - np.eye(3)) + LMBDA / J * np.log(J) * np.eye(3)
        mu_now, lmbda_now = (MU - LMBDA * np.log(J)) / J, LMBDA / J
        c = np.diag([2 * mu_now] * 3 + [mu_now] * 3)
        c[:3, :3] += lmbda_now
        found = evaluator("neo_hookean")(F)
        assert np.abs(found["sigma"] - sigma).max() < 1e-12 * np.abs(sigma).max()
        assert np.abs(found["c"] - c).max() < 1e-12 * np.abs(c).max()


def test_transversely_isotropic_stress(rng):
    """(23): sigma of the corrected energy with 2 beta ln J."""
    k = energies.transversely_isotropic_constants(**TRANSVERSE)
    eye = np.eye(3)
    for _ in range(5):
        F = random_state(rng)
        J, b, a = np.linalg.det(F), F @ F.T, F @ FIBER
        IV1 = a @ a - 1
        sigma = k["mu"] / J * (b - eye) + k["lmbda"] * (J - 1) * eye
        sigma += 2 * k["beta"] / J * IV1 * eye
        factor = k["alpha"] + 2 * k["beta"] * np.log(J) + 2 * k["gamma"] * IV1
        sigma += 2 / J * factor * np.outer(a, a)
        sigma -= k["alpha"] / J * (np.outer(b @ a, a) + np.outer(a, b @ a))
        found = evaluator("transversely_isotropic")(F)["sigma"]
        assert np.abs(found - sigma).max() < 1e-12 * np.abs(sigma).max()


def test_guccione_is_the_formula_in_fiber_axes(rng):
    """Q by invariants equals Q by components of E in axes along and across the fiber."""
    F = np.eye(3) + 0.15 * rng.normal(size=(3, 3))
    axes = np.stack([FIBER, [-0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
    E = axes @ ((F.T @ F - np.eye(3)) / 2) @ axes.T
    Q = 8 * E[0, 0] ** 2 + 2 * (E[1, 1] ** 2 + E[2, 2] ** 2 + 2 * E[1, 2] ** 2)
    Q += 2 * 4 * (E[0, 1] ** 2 + E[0, 2] ** 2)
    psi = 2 / 2 * (np.exp(Q) - 1) + KAPPA / 2 * (np.linalg.det(F) - 1) ** 2
    assert evaluator("guccione")(F)["psi"] == pytest.approx(psi, rel=1e-12)


def isochoric_bars(s):
    """I1, I2 of J^(-1/3) F, from its stretches."""
    root = math.prod(s) ** (mpf(1) / 3)
    b = [(x / root) ** 2 for x in s]
    return sum(b), b[0] * b[1] + b[1] * b[2] + b[2] * b[0]


# As they are defined, with the parameters of cases.py; the volume term is that of all three.
ISOCHORIC = {
    "isochoric_neo_hookean": lambda I1, I2: MU / 2 * (I1 - 3),
    "mooney_rivlin": lambda I1, I2: 0.4 * (I1 - 3) + 0.25 * (I2 - 3),
    "yeoh": lambda I1, I2: 0.65 * (I1 - 3) - 0.05 * (I1 - 3) ** 2 + 0.02 * (I1 - 3) ** 3,
}


@pytest.mark.parametrize("strain", [0, 1e-8, 1e-6, 1e-4, 1e-2, 0.3, 1, "drawn out", "pressed flat"])
@pytest.mark.parametrize("name", ISOCHORIC)
def test_isochoric_energies_to_all_digits(name, strain, rng):
    """psi, P and the elasticity are those of psi(J^(-1/3) F) in 110 digits, to 14 digits.

    Of the moduli, and of the largest entry where that is more: near rest psi and P are differences
    of terms of the moduli's size, as F itself is one of I and the gradient, to 16 digits.
    """

    def psi(s, f):
        J = math.prod(s)
        return ISOCHORIC[name](*isochoric_bars(s)) + KAPPA / 4 * (J**2 - 1 - 2 * f.ln(J))

    given = {"drawn out": np.diag([7, 0.3, 0.4]), "pressed flat": np.diag([1.2, 1.3, 0.1])}
    F = given.get(strain)
    while F is None or np.linalg.det(F) < 0.1:
        F = np.eye(3) + strain * rng.uniform(-1, 1, size=(3, 3))
    F = random_rotation(rng) @ F @ random_rotation(rng) if strain in given else F
    found = evaluator(name)(F)
    W, P, A = reference.derivatives(psi, F)
    sigma, J = P @ F.T / np.linalg.det(F), np.linalg.det(F)
    c = np.einsum("iJkL,jJ,lL->ijkl", A, F, F) / J - np.einsum("ik,jl->ijkl", np.eye(3), sigma)
    wanted = {"psi": W, "P": P, "c": [[c[*ij, *kl] for kl in stress.VOIGT] for ij in stress.VOIGT]}
    for key, value in wanted.items():
        assert np.abs(found[key] - value).max() < 1e-14 * max(KAPPA, np.abs(value).max())


@every_energy
def test_inverted_states(name):
    """Det F < 0: energies with ln J or J^(-2/3) are not finite, the others are."""
    psi = evaluator(name)(np.diag([1.1, 0.9, -0.5]))["psi"]
    logarithmic = ("hencky", "ogden", "neo_hookean_stretches")
    finite = name in ("saint_venant_kirchhoff", "stable_neo_hookean", "guccione")
    finite |= name in STRETCHES and name not in logarithmic
    # (ln J^2 is defined for J < 0: an energy in III sees no inversion.)
    assert np.isfinite(psi) == (finite or name == "isotropic")


def test_moduli():
    """E, nu -> mu, lmbda -> kappa by the relations of linear elasticity."""
    mu, lmbda = energies.lame_from_young(10.0, 0.3)
    assert energies.lame_from_shear(mu, 0.3) == pytest.approx((mu, lmbda))
    assert mu * (3 * lmbda + 2 * mu) / (lmbda + mu) == pytest.approx(10.0)
    assert lmbda / (2 * (lmbda + mu)) == pytest.approx(0.3)
    assert energies.bulk_modulus(mu, lmbda) == pytest.approx(10.0 / (3 * (1 - 0.6)))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda F: energies.lame_from_shear(1.0, 0.5), r"got nu = 0.5; for nu = 1/2 use"),
        (lambda F: energies.lame_from_young(-2.0, 0.3), r"Young's modulus E must be .*got -2.0"),
        (lambda F: energies.neo_hookean(F, -1.0, 1.0), r"shear modulus mu must be .* got -1.0"),
        (lambda F: energies.neo_hookean(F, 1.0, np.nan), "needs a finite lmbda, got nan"),
        (lambda F: energies.yeoh(F, 1.0, np.inf, 1.0), "yeoh needs a finite c2, got inf"),
        (lambda F: energies.neo_hookean(F, np.float32("nan"), 1.0), "finite mu, got nan"),
        (
            lambda F: energies.guccione(F, 1.0, 1.0, 1.0, 1.0, (1, 0)),
            r"a fiber needs the shape \(3,\), got \(2,\)",
        ),
        (
            lambda F: energies.guccione(F, 1.0, 1.0, 1.0, 1.0, (2, 0, 0)),
            "a fiber needs a unit vector, got one of length 2",
        ),
        (lambda F: energies.neo_hookean(F, 1.0, -10.0), "positive bulk modulus .* lmbda = -10.0"),
        (lambda F: energies.volumetric(F, 1.0, "cubic"), r"quadratic, simo, log, got 'cubic'"),
        (lambda F: energies.volumetric(F, 0.0), r"bulk modulus kappa must be positive, got 0.0"),
        (lambda F: energies.with_pressure(0, F, F), r"must be a scalar, got shape \(3, 3\)"),
        (
            lambda F: energies.transversely_isotropic_constants(1.0, 0.45, 0.5, 1.0),
            r"1 - nu_t - 2 \(E_t/E_A\) nu_A\^2 = -1.8",
        ),
        (
            lambda F: energies.transversely_isotropic_constants_five(-9.0, 3.0, 0.3, 0.3, 1.0),
            "E_A must be positive, got -9.0",
        ),
        (
            lambda F: energies.transversely_isotropic_constants_five(9.0, 3.0, 1.5, 0.3, 1.0),
            "between -1 and 1, got 1.5",
        ),
    ],
)
def test_bad_parameters_are_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call(ufl.variable(ufl.Identity(3)))
