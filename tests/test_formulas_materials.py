# SPDX-License-Identifier: MIT
"""Document 003, III-V: isotropic and transversely isotropic materials and their misprints."""

import functools

import numpy as np
import pytest
import recorder
from cases import (
    ENERGIES,
    FIBER,
    LMBDA,
    MU,
    TRANSVERSE,
    Pointwise,
    agree,
    off,
)
from materials import (
    CONSTANTS,
    EYE,
    F0,
    MATERIALS,
    H,
    cauchy_from,
    elasticity_from,
    every_material,
    states,
    stress_from,
)

from variform.forms.formulas import elasticity as el
from variform.forms.formulas import materials as ma


@functools.cache
def evaluator(name):
    return Pointwise(ENERGIES[name])


# III. Isotropic hyperelasticity


@pytest.mark.capability(58)
def test_invariants_are_those_of_the_eigenvalues(rng):
    """(13): sum, sum of squares and product of the eigenvalues of C."""
    C = el.right_cauchy_green(states(rng))
    values = np.linalg.eigvalsh(C)
    for found, wanted in zip(
        el.invariants(C), (values.sum(-1), (values**2).sum(-1), values.prod(-1)), strict=True
    ):
        agree(found, wanted, 13)


@pytest.mark.capability(58)
def test_stress_of_any_isotropic_energy(rng):
    """(14), (15): S and sigma of a psi(I, II, III), from its three partial derivatives."""

    def psi(k1, k2, k3):
        return k1 * k2**0.5 + 0.3 * k2 * np.log(k3) + k3**1.5 / k1

    F = states(rng)
    C = el.right_cauchy_green(F)
    at = el.invariants(C)
    partial = [
        np.imag(psi(*(x + 1j * H * (i == j) for j, x in enumerate(at)))) / H for i in range(3)
    ]

    def of_F(F):
        return psi(*el.invariants(el.right_cauchy_green(F)))

    agree(el.isotropic_cauchy(F, *partial), cauchy_from(of_F, F), 12)
    agree(el.isotropic_second_piola(C, *partial), np.linalg.solve(F, stress_from(of_F, F)), 12)


# IV, V. The materials


@pytest.mark.capability(59, 61, 63)
@every_material
def test_cauchy_stress_is_that_of_the_energy(name, rng):
    """(18), (23): sigma = J^-1 dpsi/dF F^T."""
    psi, sigma, _ = MATERIALS[name]
    F = states(rng)
    agree(sigma(F), cauchy_from(psi, F), 13)


@pytest.mark.capability(59, 61, 63)
@every_material
def test_elasticity_is_that_of_the_stress(name, rng):
    """(19), (20), (24): c from the derivative of sigma."""
    _, sigma, c = MATERIALS[name]
    F = states(rng)
    agree(c(F), elasticity_from(sigma, F), 13)


@pytest.mark.capability(53, 59, 61, 63)
@every_material
def test_materials_equal_the_automatic_side(name, rng):
    """psi, P, S, sigma and c that UFL derives from the energy."""
    psi, sigma, c = MATERIALS[name]
    for F in states(rng):
        ufl = evaluator(name)(F)
        S = el.pull_back(sigma(F), F)
        agree(psi(F), ufl["psi"], 12)
        agree(S, ufl["S"], 12)
        agree(el.first_piola(S, F), ufl["P"], 12)
        agree(sigma(F), ufl["sigma"], 12)
        agree(ma.voigt_elasticity(c(F)), ufl["c"], 12)


@pytest.mark.capability(59, 61, 63)
@pytest.mark.digits(15)
@every_material
def test_rest(name):
    """At F = I energy and stress are zero."""
    psi, sigma, _ = MATERIALS[name]
    assert abs(psi(EYE)) < 1e-15 and np.abs(sigma(EYE)).max() < 1e-15


def test_moduli_may_vary_over_the_leading_axes(rng):
    """One call with an array of moduli equals calls one by one."""
    F, mu, lmbda = states(rng, 3), np.array([1.0, 2.0, 3.0]), np.array([0.5, 1.5, 4.0])
    for f in (ma.neo_hookean, ma.neo_hookean_cauchy, ma.neo_hookean_elasticity):
        agree(f(F, mu, lmbda), [f(*one) for one in zip(F, mu, lmbda, strict=True)], 15)
    for f in (ma.transversely_isotropic_cauchy, ma.transversely_isotropic_elasticity):
        k = ma.Constants(*rng.uniform(0.5, 1, size=(5, 3)))
        one_by_one = [f(F[i], FIBER, ma.Constants(*(x[i] for x in k))) for i in range(3)]
        agree(f(F, FIBER, k), one_by_one, 15)


@pytest.mark.capability(60)
@pytest.mark.digits(13)
def test_lame_parameters():
    """(17): a bar of these moduli under tension has the Poisson ratio that was put in."""
    for nu in (-0.4, 0.0, 0.27, 0.49):
        mu, lmbda = ma.lame_from_shear(MU, nu)
        assert mu == MU
        compliance = np.linalg.inv(ma.voigt_elasticity(ma.isotropic_elasticity(lmbda, mu)))
        assert -compliance[0, 1] / compliance[0, 0] == pytest.approx(nu, abs=1e-13)
        assert 1 / compliance[3, 3] == pytest.approx(mu, rel=1e-14)


@pytest.mark.misprint(6, "c off by {0:.2g}, c_iijj alone")
def test_misprint_20():
    """(20): lambda' = mu/J moves c_iijj by (mu - lambda)/J; nothing else changes."""
    J = np.linalg.det(F0)
    right = ma.neo_hookean_elasticity(F0, MU, LMBDA)
    printed = ma.neo_hookean_elasticity(F0, MU, LMBDA, as_printed=True)
    agree(printed - right, (MU - LMBDA) / J * np.einsum("ij,kl->ijkl", EYE, EYE), 14)
    assert off(printed, right) == pytest.approx(0.2209, abs=1e-4)


@pytest.mark.capability(62)
def test_fiber_invariants(rng):
    """(22): IV = |F A|^2, V = |C A|^2."""
    F = states(rng)
    IV, V = ma.fiber_invariants(F, FIBER)
    agree(IV, [(f @ FIBER) @ (f @ FIBER) for f in F], 14)
    agree(V, [FIBER @ f.T @ f @ f.T @ f @ FIBER for f in F], 14)


@pytest.mark.misprint(7, "stress off by {0:.2g}")
def test_misprint_21():
    """(21): with beta ln J the stress (23) is off by beta/J ((IV - 1) I + 2 ln J a (x) a)."""
    a, J = F0 @ FIBER, np.linalg.det(F0)
    sigma = ma.transversely_isotropic_cauchy(F0, FIBER, CONSTANTS)
    printed = cauchy_from(
        lambda F: ma.transversely_isotropic(F, FIBER, CONSTANTS, as_printed=True), F0
    )
    lost = CONSTANTS.beta / J * ((a @ a - 1) * EYE + 2 * np.log(J) * np.outer(a, a))
    agree(sigma - printed, lost, 12)
    assert off(printed, sigma) == pytest.approx(0.01798, abs=1e-4)


@pytest.mark.misprint(8, "c off by -2 lambda J i, at rest too; {0:.2g} with the printed i")
def test_misprint_24_volume():
    """(24): 2J - 1 for J - 1 takes 2 lambda J i away, at rest 2 lambda i."""
    right = ma.neo_hookean_quadratic_elasticity(F0, MU, LMBDA)
    printed = ma.neo_hookean_quadratic_elasticity(F0, MU, LMBDA, as_printed=True)
    J, minor = np.linalg.det(F0), ma.fourth_order_identity()
    # With the symmetric part of the printed i, only the factor is left of the difference.
    symmetric = (printed + np.swapaxes(printed, 2, 3)) / 2
    agree(symmetric - right, -2 * LMBDA * J * minor, 14)
    assert off(printed, right) == pytest.approx(1.3207, abs=1e-4)
    rest = ma.neo_hookean_quadratic_elasticity(EYE, MU, LMBDA, as_printed=True)
    strain = el.green_strain(F0)
    wanted = LMBDA * np.trace(strain) * EYE + 2 * (MU - LMBDA) * strain
    agree(el.stress_rate(rest, strain), wanted, 14)


@pytest.mark.misprint(9, "none on strains; shear moduli twice too large in (28)")
def test_misprint_24_identity():
    """(24): the printed i acts alike on strains, but puts 2 mu for mu into the matrix (28)."""
    printed, right = ma.fourth_order_identity(as_printed=True), ma.fourth_order_identity()
    eps = el.green_strain(F0)
    agree(el.stress_rate(printed, eps), eps, 15)
    agree(el.stress_rate(right, eps), eps, 15)
    agree(np.diag(ma.voigt_elasticity(2 * MU * right)), MU * np.array([2, 2, 2, 1, 1, 1]), 15)
    agree(np.diag(ma.voigt_elasticity(2 * MU * printed)), MU * np.full(6, 2.0), 15)
    agree(right, np.swapaxes(right, 0, 1), 15)
    assert off(np.swapaxes(printed, 0, 1), printed) == 1


@pytest.mark.misprint(10, "half the action on strains ({3:.2g})")
def test_misprint_24_fiber_tensor():
    """(24): two of the four terms are symmetric in ij alone, with half the action on strains."""
    a, b = F0 @ FIBER, F0 @ F0.T
    right, printed = ma.fiber_tensor(a, b), ma.fiber_tensor(a, b, as_printed=True)
    for i, j, k, n in ((0, 1, 2, 1), (0, 0, 1, 2), (2, 1, 0, 1)):
        terms = [(i, n, j, k), (i, k, j, n), (j, n, i, k), (j, k, i, n)]
        assert right[i, j, k, n] == pytest.approx(
            sum(a[p] * a[q] * b[r, s] for p, q, r, s in terms)
        )
    for flip, symmetric in (((1, 0, 2, 3), True), ((0, 1, 3, 2), False), ((2, 3, 0, 1), False)):
        agree(right.transpose(flip), right, 15)
        assert (off(printed.transpose(flip), printed) < 1e-15) == symmetric
    eps = el.green_strain(F0)
    agree(2 * el.stress_rate(printed, eps), el.stress_rate(right, eps), 14)
    assert off(printed, right) == pytest.approx(0.5, abs=1e-4)


@pytest.mark.misprint(
    10,
    "in (28) the axial shear modulus depends on the axis: {0:.2g} or {2:.2g} for 0.9",
)
def test_misprint_24_axial_shear():
    """(25) alpha: with the two-term a the axial shear modulus mu - alpha depends on the axis."""
    k = ma.Constants(1.3, 0.0, 0.4, 0.0, 0.0)
    found = {}
    for axis in range(3):
        matrix = ma.voigt_elasticity(
            MU * 2 * ma.fourth_order_identity()
            - k.alpha * ma.fiber_tensor(EYE[axis], EYE, as_printed=True)
        )
        right = ma.voigt_elasticity(ma.transversely_isotropic_elasticity(EYE, EYE[axis], k))
        # The two shears that contain the axis, of 12, 23, 13.
        pairs = [i for i, pair in enumerate(ma.VOIGT[3:], 3) if axis in pair]
        assert [right[i, i] for i in pairs] == pytest.approx([0.9, 0.9])
        found[axis] = [matrix[i, i] for i in pairs]
        recorder.figure(*found[axis])
    wanted = {0: [1.3, 1.3], 1: [0.9, 1.3], 2: [0.9, 0.9]}
    assert all(found[axis] == pytest.approx(wanted[axis]) for axis in range(3)), found


@pytest.mark.misprint(
    10,
    "with the two errors above c is off by {0:.2g}, (28) unsymmetric by {1:.2g}",
)
def test_misprint_24_total():
    """(24), (26): all as printed: half off, and a matrix (28) that is not symmetric."""
    right = ma.transversely_isotropic_elasticity(F0, FIBER, CONSTANTS)
    printed = ma.transversely_isotropic_elasticity(F0, FIBER, CONSTANTS, as_printed=True)
    assert off(printed, right) == pytest.approx(0.2855, abs=1e-4)
    matrix = ma.voigt_elasticity(printed)
    assert off(matrix.T, matrix) == pytest.approx(0.02871, abs=1e-4)


@pytest.mark.capability(63)
@pytest.mark.parametrize("as_printed", [False, True])
def test_components_equal_tensors(as_printed, rng):
    """(26) equals (23) and (24), as printed and corrected."""
    F = states(rng)
    args = F, FIBER, CONSTANTS
    agree(
        ma.transversely_isotropic_cauchy_components(*args),
        ma.transversely_isotropic_cauchy(*args),
        14,
    )
    agree(
        ma.transversely_isotropic_elasticity_components(*args, as_printed),
        ma.transversely_isotropic_elasticity(*args, as_printed),
        14,
    )


def engineering(c, axis=0):
    """E_A, E_t, nu_t, nu_A, G_A of c at rest, the axis being e1."""
    S = np.linalg.inv(ma.voigt_elasticity(c))
    return [1 / S[0, 0], 1 / S[1, 1], -S[1, 2] / S[1, 1], -S[0, 1] / S[0, 0], 1 / S[3, 3]]


@pytest.mark.capability(64)
@pytest.mark.digits(13)
def test_constants_return_the_moduli():
    """(25): E_A, nu, G_A, mu come back; nu both in the plane and under axial load."""
    found = engineering(ma.transversely_isotropic_elasticity(EYE, EYE[0], CONSTANTS))
    mu, nu, E_A, G_A = TRANSVERSE.values()
    assert found == pytest.approx([E_A, 2 * mu * (1 + nu), nu, nu, G_A], rel=1e-13)


@pytest.mark.misprint(
    11,
    "E_A = 9 becomes {0:.5g}, E_t 3.302 becomes {1:.5g}, nu in the plane 0.27 becomes "
    "{2:.3g}; no constants at all for E_A / E_t > (1 - nu) / (2 nu^2)",
)
def test_misprint_25():
    """(25): with n inverted, the E_A of 9 becomes 18.306, E_t 4.0543, nu_t 0.55933; m <= 0 at 5."""
    k = ma.transversely_isotropic_constants(**TRANSVERSE, as_printed=True)
    found = engineering(ma.transversely_isotropic_elasticity(EYE, EYE[0], k))
    recorder.figure(*found)
    assert found == pytest.approx([18.306, 4.0543, 0.55933, 0.27, 0.8], rel=3e-5)
    mu, nu = 1.3, 0.27
    limit = 2 * mu * (1 + nu) * (1 - nu) / (2 * nu**2)
    ma.transversely_isotropic_constants(mu, nu, 0.99 * limit, 0.8, as_printed=True)
    with pytest.raises(ValueError, match=r"\(25\) divides by m = .* must be > 0, got -0.0073"):
        ma.transversely_isotropic_constants(mu, nu, 1.01 * limit, 0.8, as_printed=True)


@pytest.mark.capability(64)
def test_five_constants_are_those_of_the_stiffness():
    """(25): constants read off the inverse of the compliance of linear elasticity, axis e3."""
    E_A, E_t, nu_t, nu_A, G_A = 9.0, 3.0, 0.35, 0.2, 0.8
    S = np.array(
        [
            [1 / E_t, -nu_t / E_t, -nu_A / E_A],
            [-nu_t / E_t, 1 / E_t, -nu_A / E_A],
            [-nu_A / E_A, -nu_A / E_A, 1 / E_A],
        ]
    )
    C = np.linalg.inv(S)
    mu, lmbda, alpha = (C[0, 0] - C[0, 1]) / 2, C[0, 1], (C[0, 0] - C[0, 1]) / 2 - G_A
    beta = (C[0, 2] - C[0, 1]) / 4
    gamma = (C[2, 2] - C[0, 1] - 2 * mu - 8 * beta + 4 * alpha) / 8
    found = ma.transversely_isotropic_constants_five(E_A, E_t, nu_t, nu_A, G_A)
    agree(found, [mu, lmbda, alpha, beta, gamma], 14)
    mu, nu, E_A, G_A = TRANSVERSE.values()
    four = ma.transversely_isotropic_constants_five(E_A, 2 * mu * (1 + nu), nu, nu, G_A)
    agree(four, CONSTANTS, 14)
