# SPDX-License-Identifier: MIT
"""Document 000: the blocks of dP/dF(Sigma), as derived symbolically, as printed, and as divided.

The derivation is compared with the printed A and B_ij by SymPy; quotients with 50 digits at the
rounded stretches.
"""

import ctypes
import subprocess

import numpy as np
import pytest
import sympy as sp
from cases import LMBDA, MU, agree, off, random_rotation
from mpmath import mp
from test_formulas_svd import ENERGIES, SMOOTH, STRETCHES, applies, exact

from variform.forms.formulas import derivation as de
from variform.forms.formulas import quotients as qu
from variform.forms.formulas import svd_derivatives as sd

both = pytest.mark.parametrize("d", [2, 3])
every_energy = pytest.mark.parametrize("name", ENERGIES)


# The derivation


def printed_blocks(result, d):
    """diag(A, B12, ...) with the printed B_ij, and the same with the split form."""
    s, t = result.parameters[:d], result.principal
    single, split = sp.zeros(d * d), sp.zeros(d * d)
    single[:d, :d] = split[:d, :d] = sp.Matrix(t).jacobian(s)
    for p, (i, j) in enumerate(qu.PAIRS[d]):
        x, y = s[i] * t[i] - s[j] * t[j], s[j] * t[i] - s[i] * t[j]
        rows = slice(d + 2 * p, d + 2 * p + 2)
        single[rows, rows] = sp.Matrix([[x, y], [y, x]]) / (s[i] ** 2 - s[j] ** 2)
        x, y = (t[i] - t[j]) / (s[i] - s[j]) / 2, (t[i] + t[j]) / (s[i] + s[j]) / 2
        split[rows, rows] = sp.Matrix([[x + y, x - y], [x - y, x + y]])
    return single, split


@pytest.mark.capability(13)
@pytest.mark.digits("symbolic")
@both
def test_derivation_gives_the_printed_blocks(d):
    """dPdF, permuted, is diag(A, B12, B13, B23) with unspecified t_i, in both forms of B_ij."""
    result = de.derive(d)
    order = sd.ORDER[d]
    found = sp.Matrix(d * d, d * d, lambda p, q: result.dPdF[order[p], order[q]])
    for wanted in printed_blocks(result, d):
        assert (found - wanted).applyfunc(sp.simplify) == sp.zeros(d * d)


@pytest.mark.capability(14)
@pytest.mark.digits("symbolic")
@both
def test_steps_of_the_derivation(d):
    """dS/dF inverts dF/dS, the chain rule holds, and det dF/dS has the roots s_i^2 = s_j^2."""
    result = de.derive(d)
    s = result.parameters[:d]
    assert (result.dFdS * result.dSdF).applyfunc(sp.simplify) == sp.eye(d * d)
    product = result.dPdS * result.dSdF - result.dPdF
    assert product.applyfunc(sp.simplify) == sp.zeros(d * d)
    roots = sp.prod(s[i] ** 2 - s[j] ** 2 for i, j in qu.PAIRS[d])
    assert sp.expand(result.dFdS.det() + roots) == 0


@pytest.mark.capability(13)
@both
def test_parametrized_tensors(d, rng):
    """F(S) and P(S) at numbers are U Sigma V^T and U P^ V^T; the limits are their derivatives."""
    result = de.derive(d)
    angles = len(result.parameters) - d
    s, r = rng.uniform(0.5, 1.5, d), rng.uniform(0.2, 1, angles)
    u, v = (r[:3], r[3:]) if d == 3 else r
    at = dict(zip(result.parameters, [*s, *r], strict=True))
    agree(np.array(result.F.subs(at).tolist(), float), sd.deformation_gradient(s, u, v), 14)
    t = dict(zip(result.principal, rng.normal(size=d), strict=True))
    stress = np.array(result.P.subs(t).subs(at).tolist(), float)
    agree(stress, sd.deformation_gradient(list(t.values()), u, v), 14)
    # Differences of F(S) at u = v = 0, fourth order, h = 1e-3: an error of 1e-13 or so.
    h, weights = 1e-3, {1: 8, -1: -8, 2: -1, -2: 1}
    for column in range(d + angles):
        slope = np.zeros((d, d))
        for k, weight in weights.items():
            x = np.array([*s, *np.zeros(angles)])
            x[column] += k * h
            u, v = (x[3:6], x[6:]) if d == 3 else x[2:]
            slope += weight * sd.deformation_gradient(x[:d], u, v) / (12 * h)
        limit = np.array(result.dFdS[:, column].subs(at).tolist(), float).ravel()
        assert np.abs(slope.ravel() - limit).max() < 1e-11


@pytest.mark.capability(15)
@both
@every_energy
def test_generated_code(name, d, rng):
    """The function made of dPdF gives the tangent at Sigma; many states at once."""
    s, energy = rng.uniform(0.6, 1.4, (2, 4, d)), ENERGIES[name]
    wanted = sd.to_matrix(sd.tangent_at_stretches(*sd.tangent_blocks(energy, s, smooth=True)))
    found = de.tangent_matrix(s, energy.gradient(s), energy.hessian(s))
    agree(found, wanted, 12)
    agree(
        de.tangent_matrix(s[1, 2], energy.gradient(s)[1, 2], energy.hessian(s)[1, 2]),
        found[1, 2],
        15,
    )


@pytest.mark.capability(15)
@both
def test_generated_c_code(d, rng, tmp_path):
    """The C function, compiled, returns the same numbers."""
    source, library = tmp_path / "tangent.c", tmp_path / "tangent.so"
    source.write_text(de.c_code(d))
    command = ["cc", "-std=c99", "-Wall", "-Werror", "-shared", "-fPIC", "-o", library, source]
    subprocess.run(command, check=True)
    s, p, h = rng.uniform(0.6, 1.4, d), rng.normal(size=d), rng.normal(size=(d, d))
    out = np.empty((d * d, d * d))
    addresses = [x.ctypes.data_as(ctypes.c_void_p) for x in (s, p, h, out)]
    ctypes.CDLL(str(library)).dPdF(*addresses)
    agree(out, de.tangent_matrix(s, p, h), 14)


@pytest.mark.capability(3)
@both
def test_energy_of_an_expression(d, rng):
    """A SymPy psi(s) becomes an energy: the Hencky one as the closed form has it."""
    s = sp.symbols(f"s1:{d + 1}", positive=True)
    logs = [sp.log(x) for x in s]
    psi = MU * sum(x**2 for x in logs) + LMBDA / 2 * sum(logs) ** 2
    made, x = de.energy(psi, s), rng.uniform(0.5, 1.5, (2, 4, d))
    for found, wanted in zip(made, ENERGIES["hencky"], strict=True):
        agree(found(x), wanted(x), 13)
    assert de.energy(sum(s), s).hessian(x).tolist() == np.zeros((2, 4, d, d)).tolist()


# Quotients


def reference(name, s, i, j, sign):
    """(psi_i - sign psi_j)/(s_i - sign s_j) with 60 digits; on a gap of 0, at a gap of 1e-25."""
    with mp.workdps(90):
        x = [mp.mpf(y) for y in s]
        if x[i] == sign * x[j]:
            x[i] += mp.mpf(10) ** -25
        h = mp.mpf(10) ** -30

        def slope(k):
            up, down = list(x), list(x)
            up[k], down[k] = up[k] + h, down[k] - h
            return (exact(name, up) - exact(name, down)) / (2 * h)

        return float((slope(i) - sign * slope(j)) / (x[i] - sign * x[j]))


GAPS = [*10.0 ** np.arange(-16, 0), 0.2, 0.25, 0.3, 0.35, 0.5, 1.0, 0.0]


@pytest.mark.capability(20)
@pytest.mark.digits(13)
@every_energy
def test_difference_quotient(name, rng):
    """Right to 13 digits at any gap, 0 included, where it is psi_ii - psi_ij; either order."""
    energy = ENERGIES[name]
    for gap in GAPS:
        m, k = rng.uniform(0.8, 1.4), rng.uniform(0.5, 1.5)
        s = np.array([m + gap / 2, k, m - gap / 2])
        scale = np.abs(energy.hessian(s)).max()
        wanted = reference(name, s, 0, 2, 1)
        for i, j in ((0, 2), (2, 0)):
            assert abs(qu.difference_quotient(energy, s, i, j) - wanted) < 1e-13 * scale, gap
    H = energy.hessian(s)
    assert qu.difference_quotient(energy, s, 0, 2) == pytest.approx(H[0, 0] - H[0, 2], rel=1e-14)


@pytest.mark.capability(20)
def test_polynomials_take_the_mean_everywhere():
    """A collapsed pair (1.5 m, m) loses digits in the fraction, none in the mean."""
    energy = ENERGIES["fixed_corotated"]
    for m in (1e-3, 1e-6, 1e-9):
        s = np.array([0.9, 1.5 * m, m])
        wanted = reference("fixed_corotated", s, 1, 2, 1)
        agree(qu.difference_quotient(energy, s, 1, 2, 2, None), wanted, 15)
        agree(qu.segment_mean(energy.hessian, s, 1, 2, 1, 2), wanted, 15)
    assert abs(qu.difference_quotient(energy, s, 1, 2) - wanted) > 1e-9


@pytest.mark.capability(21)
@pytest.mark.digits(13)
@pytest.mark.parametrize("name", [*SMOOTH, "neo_hookean"])
def test_sum_quotient_of_smooth_energies(name, rng):
    """Right to 13 digits at any s_i + s_j, 0 included, where it is psi_ii + psi_ij."""
    energy = ENERGIES[name]
    for gap in GAPS:
        m, k = rng.uniform(0.8, 1.4), rng.uniform(0.5, 1.5)
        s = np.array([-k, m + gap / 2, gap / 2 - m])
        scale = np.abs(energy.hessian(s)).max()
        wanted = reference(name, s, 1, 2, -1)
        for i, j in ((1, 2), (2, 1)):
            found = qu.sum_quotient(energy, s, i, j, smooth=True)
            assert abs(found - wanted) < 1e-13 * scale, gap
    H = energy.hessian(s)
    found = qu.sum_quotient(energy, s, 1, 2, smooth=True, switch=None)
    assert found == pytest.approx(H[1, 1] + H[1, 2], rel=1e-14)


@pytest.mark.capability(21, 23)
@pytest.mark.digits(14)
@pytest.mark.parametrize("name", SMOOTH)
def test_two_stretches_of_zero(name):
    """s_i = s_j = 0: both quotients of a smooth energy have their limits."""
    energy, s = ENERGIES[name], np.array([0.9, 0.0, 0.0])
    H = energy.hessian(s)
    assert abs(qu.difference_quotient(energy, s, 1, 2) - (H[1, 1] - H[1, 2])) < 1e-14
    assert abs(qu.sum_quotient(energy, s, 1, 2, smooth=True) - (H[1, 1] + H[1, 2])) < 1e-14


@pytest.mark.capability(22)
def test_clamped_sum_quotient():
    """Exact down to 1e-6; below it 0.5 and 0.9 lost, and of a smooth energy all that there is."""
    pole = ENERGIES["arap"]
    for total, kept in ((1e-1, 1), (1e-5, 1), (2e-6, 1), (5e-7, 0.5), (1e-7, 0.1), (-1e-7, 0.1)):
        s = np.array([1.2, 0.5 + total, -0.5])
        exact_total = s[1] + s[2]
        wanted = 2 * MU - 4 * MU / exact_total
        found = qu.sum_quotient(pole, s, 1, 2)
        assert found == pytest.approx(kept * wanted, rel=1e-6)
        # The bound can be set; none is left of it here.
        assert qu.sum_quotient(pole, s, 1, 2, least=1e-12) == pytest.approx(wanted, rel=1e-9)
    s = np.array([1.2, 0.5 + 1e-9, -0.5])
    assert abs(qu.sum_quotient(ENERGIES["saint_venant_kirchhoff"], s, 1, 2)) < 0.01
    smooth = qu.sum_quotient(ENERGIES["saint_venant_kirchhoff"], s, 1, 2, smooth=True)
    agree(smooth, reference("saint_venant_kirchhoff", s, 1, 2, -1), 13)


@pytest.mark.capability(22)
@pytest.mark.digits("exact")
def test_clamp():
    """The magnitude is raised to the bound, the sign kept, that of 0 is +."""
    x = np.array([2.0, 1e-6, 3e-7, 0.0, -0.0, -3e-7, -5.0])
    assert qu.clamp(x).tolist() == [2, 1e-6, 1e-6, 1e-6, 1e-6, -1e-6, -5]
    assert qu.clamp(x, 3.0).tolist() == [3, 3, 3, 3, 3, -3, -5]


@pytest.mark.capability(17, 18, 19)
@every_energy
def test_both_forms_of_a_block(name):
    """B_ij as printed is the split form, at every state with distinct s_i^2; B_ij = B_ji."""
    for state in ("generic", "inverted", "flat", "plane", "plane inverted"):
        if not applies(name, state):
            continue
        s = np.array(STRETCHES[state])
        energy = ENERGIES[name]
        A, B = sd.tangent_blocks(energy, s)
        agree(A, energy.hessian(s), 15)
        for p, (i, j) in enumerate(qu.PAIRS[len(s)]):
            agree(sd.block_single(energy, s, i, j), B[p], 13)
            agree(sd.block_single(energy, s, j, i), B[p], 13)
            q = [reference(name, s, i, j, sign) for sign in (1, -1)]
            agree(np.linalg.eigh(B[p])[0], sorted(q), 13)


@pytest.mark.capability(19)
@pytest.mark.digits("exact")
def test_split_of_arrays():
    """[[1, 1], [1, 1]]/2 times the one, [[1, -1], [-1, 1]]/2 times the other quotient."""
    found = sd.block_split(np.array([2.0, 0.0]), np.array([0.0, 6.0]))
    assert found.tolist() == [[[1, 1], [1, 1]], [[3, -3], [-3, 3]]]


@pytest.mark.capability(20)
@pytest.mark.parametrize("name", ["fixed_corotated", "saint_venant_kirchhoff", "hencky"])
def test_tangent_at_equal_stretches_does_not_depend_on_the_svd(name, rng):
    """F = 1.2 I, U = V any rotation: one tangent with the limits, not if clamped."""
    s, energy = np.full(3, 1.2), ENERGIES[name]
    Q1, Q2 = random_rotation(rng), random_rotation(rng)
    A, B = sd.tangent_blocks(energy, s)
    agree(sd.tangent(Q1, Q1, A, B), sd.tangent(Q2, Q2, A, B), 14)
    clamped = np.stack([sd.block_single(energy, s, i, j, least=1e-6) for i, j in qu.PAIRS[3]])
    assert not clamped.any()
    assert off(sd.tangent(Q1, Q1, A, clamped), sd.tangent(Q2, Q2, A, clamped)) > 0.01


CALLS = [
    (lambda: de.derive(4), "The derivation exists in 2 and 3 dimensions, got 4"),
    (lambda: de.c_code(1), "The generated code exists in 2 and 3 dimensions, got 1"),
    (
        lambda: de.tangent_matrix([1.0, 2.0], np.ones(3), np.eye(2)),
        r"generated dP/dF needs psi_i .*\(\.\.\., 2, 2\), got shapes \(3,\) and \(2, 2\)",
    ),
    (
        lambda: de.tangent_matrix([1.0, 2.0], np.ones(2), np.eye(3)),
        r"generated dP/dF needs psi_i .* got shapes \(2,\) and \(3, 3\)",
    ),
    (
        lambda: de.tangent_matrix([[3.0, 2.0, 1.0], [1.0, 2.0, -2.0]], np.ones(3), np.eye(3)),
        r"generated dP/dF divides by s_i\^2 - s_j\^2",
    ),
    (
        lambda: de.tangent_matrix([1.0], [1.0], [[1.0]]),
        r"generated dP/dF needs stretches .* \(1,\)",
    ),
    (lambda: de.energy(sp.Symbol("x") ** 2, (sp.Symbol("x"),)), "expression exists in .* got 1"),
    (lambda: de.energy(sp.sympify("a*s1*s2 + b"), sp.symbols("s1:3")), "parameters, a, b are left"),
    (lambda: de.energy(sp.sympify("s1*s2 + s3"), sp.symbols("s1:4")), "changes when s1 and s3 are"),
    (
        lambda: de.energy(sp.sympify("s1*s2"), sp.symbols("s1:3")).value([1.0, 2, 3]),
        r"psi\(s\) needs stretches \(\.\.\., 2\), got shape \(3,\)",
    ),
    (lambda: qu.clamp(1.0, 0.0), "The clamp needs a bound > 0, got 0.0"),
    (
        lambda: qu.difference_quotient(ENERGIES["arap"], [1.0, 2.0], 0, 2),
        r"\(psi_i - psi_j\)/\(s_i - s_j\) needs two of the indices 0 to 1, got 0 and 2",
    ),
    (
        lambda: qu.sum_quotient(ENERGIES["arap"], [1.0, 2.0, 3.0], 1, 1),
        r"\(psi_i \+ psi_j\)/\(s_i \+ s_j\) needs two of the indices 0 to 2, got 1 and 1",
    ),
    (
        lambda: qu.segment_mean(ENERGIES["arap"].hessian, [1.0, 2.0, 3.0], -1, 1),
        "segment mean needs two of the indices 0 to 2, got -1 and 1",
    ),
    (
        lambda: sd.block_single(ENERGIES["arap"], [[3.0, 2.0, 1.0], [1.0, 2.0, -2.0]], 1, 2),
        r"B_ij divides by s_i\^2 - s_j\^2, which is 0 here: take the split form",
    ),
    (lambda: sd.tangent_blocks(ENERGIES["arap"], 1.0), r"diag\(A, B12.* needs stretches .* \(\)"),
]


@pytest.mark.parametrize(("call", "message"), CALLS)
def test_errors_name_the_formula(call, message):
    with pytest.raises(ValueError, match=message):
        call()
