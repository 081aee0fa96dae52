# SPDX-License-Identifier: MIT
"""Document 003, I, II, Voigt: each formula against a reference that does not use it; misprints.

References are complex steps of the energy (exact to rounding), sums written out, or the UFL side.
Digits are those of max |found - wanted| / max |wanted|.
"""

import ast
import sys

import numpy as np
import pytest
from cases import (
    FIBER,
    LMBDA,
    MU,
    agree,
    off,
    random_rotation,
)
from conftest import ROOT
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from materials import (
    CONSTANTS,
    EYE,
    F0,
    MATERIALS,
    cauchy_from,
    elasticity_from,
    every_material,
    states,
    step,
    stress_from,
)

from variform.forms.formulas import elasticity as el
from variform.forms.formulas import materials as ma

# I. Strain tensors


def motion(X):
    """A motion that is not affine, x_i of shape (..., 3)."""
    x, y, z = (X[..., i] for i in range(3))
    return np.stack([x + 0.3 * x * y, y - 0.2 * z**2 + 0.1 * x, z + 0.25 * x * z - 0.1 * y], -1)


@pytest.mark.capability(51)
def test_line_elements_follow_the_motion(rng):
    """(1), (2): F dX is the derivative of x(X) along dX; columns of F are those along e_j."""
    X, dX = rng.normal(size=(2, 5, 3))
    columns = np.stack([step(motion, X, e) for e in EYE], axis=-1)
    F = el.deformation_gradient(columns, EYE)
    agree(F, columns, 15)
    agree(el.line_element(F, dX), step(motion, X, dX), 14)
    before = rng.normal(size=(5, 3, 3))
    agree(el.deformation_gradient(columns @ before, before), columns, 12)


@pytest.mark.capability(51)
def test_products_of_line_elements(rng):
    """(3), (4): dx1 . dx2 = dX1 . C dX2 and dX1 . dX2 = dx1 . b^-1 dx2."""
    F, dX1, dX2 = states(rng), *rng.normal(size=(2, 6, 3))
    dx1, dx2 = (np.array([f @ d for f, d in zip(F, dX, strict=True)]) for dX in (dX1, dX2))
    agree(el.spatial_product(F, dX1, dX2), (dx1 * dx2).sum(-1), 13)
    agree(el.material_product(F, dx1, dx2), (dX1 * dX2).sum(-1), 12)
    agree(el.stretch(F, dX1), np.linalg.norm(dx1, axis=-1) / np.linalg.norm(dX1, axis=-1), 14)
    agree(el.right_cauchy_green(F), [f.T @ f for f in F], 15)
    agree(el.left_cauchy_green(F), [f @ f.T for f in F], 15)
    agree(el.volume_ratio(F), np.linalg.det(F), 14)


@pytest.mark.capability(51)
def test_strains_of_pairs(rng):
    """(5): dX1 . E dX2 = dx1 . e dx2 = 1/2 (dx1 . dx2 - dX1 . dX2), and so for E, e themselves."""
    F, dX1, dX2 = states(rng), *rng.normal(size=(2, 6, 3))
    dx1, dx2 = el.line_element(F, dX1), el.line_element(F, dX2)
    wanted = ((dx1 * dx2).sum(-1) - (dX1 * dX2).sum(-1)) / 2
    agree(el.pair_strain(F, dX1, dX2), wanted, 13)
    agree(el.pair_strain_spatial(F, dx1, dx2), wanted, 12)
    E = np.array(
        [[[(f[:, i] @ f[:, j] - EYE[i, j]) / 2 for j in range(3)] for i in range(3)] for f in F]
    )
    agree(el.green_strain(F), E, 14)
    G = np.linalg.inv(F)
    agree(el.almansi_strain(F), np.swapaxes(G, -1, -2) @ E @ G, 12)


# II. Elasticity tensors


@pytest.mark.capability(52)
@pytest.mark.misprint(5, "half the power ({0:.3g})")
@every_material
def test_stress_power_is_the_rate_of_the_energy(name, rng):
    """(6), (7): psi_dot = P : F_dot = 1/2 S : C_dot = S : E_dot."""
    psi, sigma, _ = MATERIALS[name]
    F, F_dot = states(rng), rng.normal(size=(6, 3, 3))
    rate = step(psi, F, F_dot)
    S = el.pull_back(sigma(F), F)
    C_dot, E_dot = (step(f, F, F_dot) for f in (el.right_cauchy_green, el.green_strain))
    agree(el.stress_power(el.first_piola(S, F), F_dot), rate, 12)
    agree(el.stress_power_cauchy_green(S, C_dot), rate, 12)
    agree(el.stress_power_green(S, E_dot), rate, 12)
    printed = el.stress_power_green(S, E_dot, as_printed=True)
    agree(printed, rate / 2, 12)
    assert off(printed, rate) == pytest.approx(0.5)


@pytest.mark.capability(52)
@pytest.mark.misprint(5, "twice the energy (off by {0:.3g})")
@every_material
def test_energy_is_the_work_along_a_path(name):
    """(6), (7): both work integrals return psi; the printed (7), without 1/2, returns 2 psi."""
    psi, sigma, _ = MATERIALS[name]
    G1, G2 = F0 - EYE, np.array([[0.1, 0, 0.2], [0, -0.1, 0], [0.1, 0.2, 0]])

    def F(t):
        return EYE + np.multiply.outer(t, G1) + np.multiply.outer(t**2, G2)

    def F_dot(t):
        return G1 + np.multiply.outer(2 * t, G2)

    def root(C):  # a stress S depends on C alone: take F = C^(1/2)
        values, vectors = np.linalg.eigh(C)
        return np.einsum("qij,qj,qkj->qik", vectors, np.sqrt(values), vectors)

    def P(F):
        return el.first_piola(el.pull_back(sigma(F), F), F)

    def S(C):
        return el.pull_back(sigma(root(C)), root(C))

    def C(t):
        return el.right_cauchy_green(F(t))

    def C_dot(t):
        half = np.swapaxes(F(t), -1, -2) @ F_dot(t)
        return half + np.swapaxes(half, -1, -2)

    wanted = psi(F(np.array([0.8])))[0] - psi(F(np.array([0.2])))[0]
    agree(el.work(P, F, F_dot, 0.2, 0.8), wanted, 12)
    agree(el.work_cauchy_green(S, C, C_dot, 0.2, 0.8), wanted, 12)
    printed = el.work_cauchy_green(S, C, C_dot, 0.2, 0.8, as_printed=True)
    agree(printed, 2 * wanted, 12)
    assert off(printed, wanted) == pytest.approx(1)


def neo_hookean_of_C(C):
    J2 = el.volume_ratio(C)
    return MU / 2 * (np.trace(C, axis1=-2, axis2=-1) - 3 - np.log(J2)) + LMBDA / 8 * np.log(J2) ** 2


def neo_hookean_S_of_C(C):
    lnJ = np.log(el.volume_ratio(C))[..., None, None] / 2
    return MU * EYE + (LMBDA * lnJ - MU) * np.linalg.inv(C)


@pytest.mark.capability(54)
def test_directional_derivatives(rng):
    """(8), (9), (31): DE[u], DS[u] = CC : DE[u] and D(dE_dot)[u] by complex steps along u."""
    F, grad_u, grad_v = states(rng), *rng.normal(size=(2, 6, 3, 3))
    DE = el.strain_derivative(F, grad_u)
    agree(DE, step(el.green_strain, F, grad_u), 14)
    CC = el.pull_back_elasticity(ma.neo_hookean_elasticity(F, MU, LMBDA), F)
    DS = step(lambda F: neo_hookean_S_of_C(el.right_cauchy_green(F)), F, grad_u)
    agree(el.stress_derivative(CC, DE), DS, 11)
    twice = step(lambda F: el.strain_derivative(F, grad_v), F, grad_u)
    agree(el.strain_rate_derivative(grad_v, grad_u), twice, 14)


@pytest.mark.misprint(12, "{0:.2g} outside")
def test_misprint_31():
    """(31): (grad0 u)^T grad0 dv is not D(dE_dot)[u], but the same inside S : [...]."""
    grad_u, grad_v = np.array([[0.3, 0.1, -0.2], [0.0, 0.2, 0.4], [0.1, -0.3, 0.2]]), F0 - EYE
    right = el.strain_rate_derivative(grad_v, grad_u)
    printed = el.strain_rate_derivative(grad_v, grad_u, as_printed=True)
    assert off(printed, right) == pytest.approx(0.5357, abs=1e-4)
    agree((printed + printed.T) / 2, right, 15)
    S = el.green_strain(F0)
    agree(np.sum(S * printed), np.sum(S * right), 14)


@pytest.mark.capability(55)
def test_tensors_of_any_energy(rng):
    """(7), (10), (14): S = 2 dpsi/dC, CC = 2 dS/dC, against the closed forms of (16)."""
    C = el.right_cauchy_green(states(rng))
    agree(el.second_piola(neo_hookean_of_C, C), neo_hookean_S_of_C(C), 13)
    G, lnJ = np.linalg.inv(C), np.log(np.linalg.det(C))[:, None, None, None, None] / 2
    pairs = np.einsum("...ik,...jl->...ijkl", G, G) + np.einsum("...il,...jk->...ijkl", G, G)
    CC = LMBDA * np.einsum("...ij,...kl->...ijkl", G, G) + (MU - LMBDA * lnJ) * pairs
    agree(el.material_elasticity(neo_hookean_S_of_C, C), CC, 13)


@pytest.mark.capability(55)
def test_material_elasticity_is_the_second_derivative_of_the_energy(rng):
    """(10): 4 d2psi/dCdC by eighth-order differences of complex steps, along symmetric a, b."""
    C = el.right_cauchy_green(F0)
    CC = el.material_elasticity(neo_hookean_S_of_C, C)
    h, weights = 0.002, {1: 4 / 5, 2: -1 / 5, 3: 4 / 105, 4: -1 / 280}
    for _ in range(3):
        a, b = (x + x.T for x in rng.normal(size=(2, 3, 3)))
        d = sum(
            w * sign * step(neo_hookean_of_C, C + sign * k * h * b, a)
            for k, w in weights.items()
            for sign in (-1, 1)
        )
        agree(np.einsum("ij,ijkl,kl", a, CC, b), 4 * d / h, 11)


@pytest.mark.capability(53)
@every_material
def test_measures_of_stress(name, rng):
    """P, S, J sigma and sigma of one energy, from P = dpsi/dF, there and back."""
    psi, _, _ = MATERIALS[name]
    F = states(rng)
    P, sigma = stress_from(psi, F), cauchy_from(psi, F)
    S = np.linalg.solve(F, P)
    agree(el.first_piola(S, F), P, 13)
    agree(el.kirchhoff(S, F), np.linalg.det(F)[:, None, None] * sigma, 13)
    agree(el.push_forward(S, F), sigma, 13)
    agree(el.pull_back(sigma, F), S, 12)


@pytest.mark.capability(56)
@every_material
def test_push_forward_of_the_elasticity_tensor(name, rng):
    """(12): c = J^-1 F F F F CC with CC = dS/dE by complex steps of S along F, and back."""
    _, sigma, _ = MATERIALS[name]
    F = states(rng)
    c = elasticity_from(sigma, F)
    CC = el.pull_back_elasticity(c, F)
    for _ in range(3):
        grad_u = rng.normal(size=(6, 3, 3))
        DS = step(lambda F: el.pull_back(sigma(F), F), F, grad_u)
        DE = step(el.green_strain, F, grad_u)
        agree(np.einsum("...ijkl,...kl->...ij", CC, DE), DS, 11)
    agree(el.push_forward_elasticity(CC, F), c, 12)


@pytest.mark.capability(57)
@every_material
def test_truesdell_rate(name, rng):
    """(11): the Truesdell rate J^-1 F S_dot F^T along F_dot = l F is c : d."""
    _, sigma, c = MATERIALS[name]
    F, L = states(rng), rng.normal(size=(6, 3, 3))
    S_dot = step(lambda F: el.pull_back(sigma(F), F), F, L @ F)
    wanted = F @ S_dot @ np.swapaxes(F, -1, -2) / np.linalg.det(F)[:, None, None]
    agree(el.truesdell_rate(sigma(F), step(sigma, F, L @ F), L), wanted, 12)
    d = el.rate_of_deformation(L)
    agree(el.stress_rate(c(F), d), wanted, 12)
    agree(d, [(entry + entry.T) / 2 for entry in L], 15)


# Voigt


@pytest.mark.capability(65)
@pytest.mark.digits("exact")
def test_voigt_order(rng):
    """(27), (28), (45), (46): the order 11, 22, 33, 12, 23, 13, doubled shears in strains."""
    sigma, c = rng.normal(size=(3, 3)), rng.normal(size=(3, 3, 3, 3))
    order = ["11", "22", "33", "12", "23", "13"]
    index = [(int(i) - 1, int(j) - 1) for i, j in order]
    assert ma.voigt_stress(sigma).tolist() == [sigma[p] for p in index]
    assert ma.voigt_strain(sigma).tolist() == [sigma[p] * (2 if p[0] != p[1] else 1) for p in index]
    assert ma.voigt_elasticity(c).tolist() == [[c[p + q] for q in index] for p in index]


@pytest.mark.capability(65)
def test_voigt_product_is_the_contraction(rng):
    """sigma^ = c^ eps^ equals sigma = c : eps."""
    F = states(rng)
    c, eps = ma.transversely_isotropic_elasticity(F, FIBER, CONSTANTS), el.almansi_strain(F)
    product = np.einsum("...IJ,...J->...I", ma.voigt_elasticity(c), ma.voigt_strain(eps))
    agree(product, ma.voigt_stress(el.stress_rate(c, eps)), 14)


# Laws for any state

numbers = st.floats(-0.3, 0.3)
matrices = st.lists(numbers, min_size=9, max_size=9).map(lambda x: np.reshape(x, (3, 3)))
seeds = st.integers(0, 2**32 - 1)
law = settings(max_examples=20, deadline=None, derandomize=True, database=None)


def state(entries):
    F = EYE + entries
    assume(np.linalg.det(F) > 0.2)
    return F


@pytest.mark.capability(63)
@pytest.mark.digits(11)
@law
@given(matrices, seeds)
def test_objectivity(entries, seed):
    """psi(Q F) = psi, sigma(Q F) = Q sigma Q^T, c(Q F) = Q Q Q Q c for rotations Q."""
    F, Q = state(entries), random_rotation(np.random.default_rng(seed))
    for psi, sigma, c in MATERIALS.values():
        assert abs(psi(Q @ F) - psi(F)) < 1e-13
        assert np.abs(sigma(Q @ F) - Q @ sigma(F) @ Q.T).max() < 1e-11
        turned = np.einsum("ia,jb,kc,ld,abcd->ijkl", Q, Q, Q, Q, c(F), optimize=True)
        assert np.abs(c(Q @ F) - turned).max() < 1e-11 * np.abs(turned).max()


@pytest.mark.capability(63)
@pytest.mark.digits(12)
@law
@given(matrices)
def test_symmetries(entries):
    """Sigma is symmetric, c has minor and major symmetries, also after pull-back."""
    F = state(entries)
    for _, sigma, c in MATERIALS.values():
        assert np.abs(sigma(F) - sigma(F).T).max() < 1e-13
        for tensor in (c(F), el.pull_back_elasticity(c(F), F)):
            for flip in ((1, 0, 2, 3), (0, 1, 3, 2), (2, 3, 0, 1)):
                assert np.abs(tensor.transpose(flip) - tensor).max() < 1e-12 * np.abs(tensor).max()


@pytest.mark.capability(65)
@pytest.mark.digits(12)
@law
@given(matrices)
def test_voigt_round_trips(entries):
    """Vector -> tensor -> vector, and tensor -> vector -> tensor, change nothing."""
    F = state(entries)
    sigma, eps = MATERIALS["neo_hookean"][1](F), el.green_strain(F)
    c = MATERIALS["transversely_isotropic"][2](F)
    assert np.abs(ma.stress_from_voigt(ma.voigt_stress(sigma)) - sigma).max() < 1e-13
    assert np.abs(ma.strain_from_voigt(ma.voigt_strain(eps)) - eps).max() < 1e-15
    assert np.abs(ma.elasticity_from_voigt(ma.voigt_elasticity(c)) - c).max() < 1e-12
    matrix = np.arange(144.0).reshape(2, 2, 6, 6)
    assert np.array_equal(ma.voigt_elasticity(ma.elasticity_from_voigt(matrix)), matrix)
    assert np.array_equal(ma.voigt_stress(ma.stress_from_voigt(matrix)), matrix)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: el.line_element(np.eye(2), [1, 2]), r"\(1\) needs tensors .* got shape \(2, 2\)"),
        (lambda: el.deformation_gradient(F0, np.ones((3, 3))), r"\(2\) divides by .* 0 here"),
        (lambda: el.almansi_strain(np.diag([1.0, 1, 0])), r"\(5\) divides by the determinant"),
        (lambda: el.push_forward(EYE, np.zeros((3, 3))), r"\(15\) divides by the determinant"),
        (lambda: ma.neo_hookean(-F0, 1, 1), r"\(16\) belongs to .* ln J, got J = -1.29 <= 0"),
        (lambda: ma.neo_hookean_cauchy(np.diag([1.0, 1, -2]), 1, 1), r"\(18\) .* got J = -2 <="),
        (lambda: ma.effective_moduli(-0.5, 1, 1), r"\(20\) .* needs J > 0, got J = -0.5"),
        (lambda: ma.lame_from_shear(1.0, 0.5), r"\(17\) .* -1 and 1/2, got nu = 0.5"),
        (lambda: ma.lame_from_shear(1.0, -1.0), r"\(17\) .* -1 and 1/2, got nu = -1.0"),
        (lambda: ma.fiber_invariants(F0, [1, 1, 0]), r"\(22\) needs a unit axis, got \|A\| = 1.41"),
        (
            lambda: ma.fiber_invariants(F0, [FIBER, FIBER / 2, FIBER]),
            r"\(22\) needs a unit axis, got \|A\| = 0.5: divide",
        ),
        (lambda: ma.fiber_invariants(F0, [1, 0]), r"\(22\) .* 3 components, got shape \(2,\)"),
        (
            lambda: ma.transversely_isotropic_elasticity(F0, 2 * FIBER, CONSTANTS),
            r"\(24\) needs a unit axis, got \|A\| = 2",
        ),
        (
            lambda: ma.transversely_isotropic_cauchy(-F0, FIBER, CONSTANTS),
            r"\(23\) belongs to .* got J = -1.29",
        ),
        (
            lambda: ma.transversely_isotropic_constants_five(3.0, 9.0, 0.5, 0.5, 1.0),
            r"\(25\) divides by m = 1 - nu - 2 n nu\^2, which must be > 0, got -1",
        ),
        (lambda: ma.voigt_stress([1, 2]), r"\(27\) needs tensors .* got shape \(2,\)"),
    ],
)
def test_errors_name_the_equation(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_the_oracle_stands_alone():
    """forms.formulas imports NumPy, SymPy and its own modules; nothing else in forms imports it."""
    folder = ROOT / "forms" / "formulas"
    for file in (ROOT / "forms").glob("**/*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Import):
                names, level = [alias.name for alias in node.names], 0
            elif isinstance(node, ast.ImportFrom):
                names, level = [node.module or ""], node.level
            else:
                continue
            if file.parent != folder:
                assert not any("formulas" in name for name in names), file
            elif level:
                assert level == 1, file
            else:
                tops = {name.split(".")[0] for name in names}
                assert tops <= sys.stdlib_module_names | {"numpy", "sympy"}, file
