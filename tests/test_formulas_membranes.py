# SPDX-License-Identifier: MIT
"""Document 001: invariants of 3x2 gradients, their eigensystems, the sheet, and what is misprinted.

References are 60-digit central differences of |f1 x f2| and F : F, which know no singular value,
and of singular vectors aligned with those found. Digits are max |found - wanted| / max |wanted|.
"""

import itertools

import numpy as np
import pytest
import recorder
from cases import MU, agree, off, random_rotation
from mpmath import mp

from variform.forms.formulas import membrane_eigensystems as me
from variform.forms.formulas import membrane_invariants as mi

H = 1e-40
F0 = np.array([[1.1, 0.3], [-0.2, 0.7], [0.4, 0.25]])  # where misprints are measured
STRETCHES = {
    "generic": (1.3, 0.8),
    "compressed": (0.7, 0.6),
    "equal": (0.9, 0.9),
    "nearly equal": (1.1 + 1e-9, 1.1),
    "stretched": (1.6, 1.3),
    "slender": (1.4, 0.02),
}
every_state = pytest.mark.parametrize("state", STRETCHES)
distinct = pytest.mark.parametrize("state", ["generic", "compressed", "slender"])


def gradient(state):
    rng = np.random.default_rng(7)
    turn = random_rotation(rng)[:2, :2]
    V = np.linalg.qr(turn)[0]
    return random_rotation(rng)[:, :2] * STRETCHES[state] @ V.T


def invariants(F):
    """I1, I2, I3 in mpmath, of a 3x2 or 2x2 matrix."""
    a, b = ([row[k] for row in F] for k in range(2))
    I2 = sum(x**2 for x in (*a, *b))
    if len(F) == 2:
        I3 = a[0] * b[1] - a[1] * b[0]
    else:
        cross = [a[i - 2] * b[i - 1] - a[i - 1] * b[i - 2] for i in range(3)]
        I3 = mp.sqrt(sum(x**2 for x in cross))
    return mp.sqrt(I2 + 2 * I3), I2, I3


def derivatives(psi, F):
    """Gradient and Hessian of psi(I1, I2, I3) by central differences of 60 digits."""
    rows, columns = F.shape
    n = rows * columns
    with mp.workdps(60):
        h = mp.mpf(10) ** -15

        def value(*steps):
            G = [[mp.mpf(x) for x in row] for row in F.tolist()]
            for place, step in steps:
                G[place // columns][place % columns] += step
            return psi(*invariants(G))

        g = [float((value((p, h)) - value((p, -h))) / (2 * h)) for p in range(n)]
        K = np.empty((n, n))
        for p, q in itertools.product(range(n), repeat=2):
            total = sum(a * b * value((p, a * h), (q, b * h)) for a in (1, -1) for b in (1, -1))
            K[p, q] = total / (4 * h**2)
    return np.reshape(g, F.shape), K


INVARIANTS = [lambda I1, I2, I3: I1, lambda I1, I2, I3: I2, lambda I1, I2, I3: I3]


def exact_sheet(I1, I2, I3):
    return mp.mpf(MU) / 2 * (I2 + I3**-2 - 3)


def decompositions(F, F_dot, U, V, h):
    """U, s, V of F + h F_dot with 50 digits, columns turned to those of U and V."""
    G = mp.matrix(F.tolist()) + h * mp.matrix(F_dot.tolist())
    values, vectors = mp.eigsy(G.T * G)
    s, u, v = [], [], []
    for k in (1, 0):
        column = vectors[:, k]
        column *= mp.sign(sum(x * y for x, y in zip(column, V[:, 1 - k].tolist(), strict=True)))
        s.append(mp.sqrt(values[k]))
        v.append(list(column))
        u.append(list(G * column / s[-1]))
    normal = [u[0][i - 2] * u[1][i - 1] - u[0][i - 1] * u[1][i - 2] for i in range(3)]
    sense = mp.sign(sum(x * y for x, y in zip(normal, U[:, 2].tolist(), strict=True)))
    u.append([sense * x for x in normal])
    return [mp.matrix(u).T, mp.matrix(s), mp.matrix(v).T]


def exact_rates(F, F_dot, U, V):
    with mp.workdps(50):
        h = mp.mpf(10) ** -15
        up, down = (decompositions(F, F_dot, U, V, sign * h) for sign in (1, -1))
        rates = [(a - b) / (2 * h) for a, b in zip(up, down, strict=True)]
        return [np.array(x.tolist(), dtype=float) for x in rates]


# Decomposition and invariants


@pytest.mark.capability(24)
@every_state
def test_svd(state):
    """F = U Sigma V^T, U in O(3) with the normal last, V in O(2), falling stretches."""
    F = gradient(state)
    U, s, V = mi.svd(F)
    agree(s, np.array(STRETCHES[state]), 13)
    agree(mi.turned(U, mi.padded(np.diag(s)), V), F, 14)
    agree(U @ U.T, np.eye(3), 14)
    agree(V @ V.T, np.eye(2), 14)
    assert np.abs(U[:, 2] @ F).max() < 1e-15
    assert [x.shape for x in mi.svd(np.stack([[F, F, F]]))] == [(1, 3, *x.shape) for x in (U, s, V)]


@pytest.mark.capability(25)
@every_state
def test_invariants(state):
    """I1, I2, I3 from the stretches and from F alone are those of 60 digits."""
    F = gradient(state)
    with mp.workdps(60):
        wanted = [float(x) for x in invariants([[mp.mpf(x) for x in row] for row in F.tolist()])]
    agree(mi.invariants(mi.svd(F)[1]), wanted, 14)
    agree(mi.invariants_of_gradient(F), wanted, 14)
    several = np.stack([[F, 2 * F], [3 * F, F]])
    agree(mi.invariants_of_gradient(several), mi.invariants(mi.svd(several)[1]), 14)


# 1. Rates


@pytest.mark.capability(27)
@distinct
def test_rates_of_the_decomposition(state, rng):
    """(1)-(3): rates of U, s, V are those of 50 digits; sum and matrix (2) return F_dot."""
    F, F_dot = gradient(state), rng.normal(size=(4, 3, 2))
    U, s, V = mi.svd(F)
    found = mi.rates(U, s, V, F_dot)
    U_dot, V_dot = mi.rotation_rates(U, V, found)
    for k, direction in enumerate(F_dot):
        U_exact, s_exact, V_exact = exact_rates(F, direction, U, V)
        agree(U_dot[k], U_exact, 11)
        agree(found.s_dot[k], s_exact.ravel(), 12)
        agree(V_dot[k], V_exact, 12)
    agree(mi.velocity_sum(U, s, V, U_dot, found.s_dot, V_dot), F_dot, 12)
    agree(mi.velocity(s, found), U.T @ F_dot @ V, 12)
    spin, turn = U.T @ U_dot, np.swapaxes(V_dot, -1, -2) @ V
    assert np.abs(spin + np.swapaxes(spin, -1, -2)).max() < 1e-13 * np.abs(spin).max()
    agree(np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], -1), found.omega, 12)
    agree(turn[:, 1, 0], found.alpha, 13)


@pytest.mark.capability(27)
def test_sum_of_the_rates():
    """(3): wz + alpha = (c - b)/(s_1 + s_2), at s_1 = s_2 too, where the rates do not exist."""
    s, b, c = np.array([1.3, 0.8]), np.array([0.3, -0.4]), np.array([0.7, 0.2])
    agree(mi.in_plane_sum([0.9, 0.9], b, c), (c - b) / 1.8, 15)
    wz, alpha = mi.in_plane_rates(s, b, c)
    agree(mi.in_plane_sum(s, b, c), wz + alpha, 14)
    agree(s[1] * wz + s[0] * alpha, -b, 14)
    agree(s[0] * wz + s[1] * alpha, c, 14)


@pytest.mark.capability(28)
@every_state
def test_normal_velocity(state, rng):
    """1.1: n_dot is that of f1 x f2 / |f1 x f2|; the spin has no part along n; any signs of U."""

    def normal(F):
        n = np.cross(F[..., 0], F[..., 1])
        return n / np.sqrt(np.sum(n**2, -1))[..., None]

    F, F_dot = gradient(state), rng.normal(size=(3, 2))
    wanted = np.imag(normal(F + 1j * H * F_dot)) / H
    U, s, V = mi.svd(F)
    for reflected in (U, U * [1, 1, -1], U * [-1, 1, 1]):
        turned_V = V * (reflected[0, :2] / U[0, :2])
        spin, rate = mi.normal_velocity(reflected, s, turned_V, F_dot)
        agree(rate, wanted * np.sign(reflected[:, 2] @ normal(F)), 13)
        agree(spin, np.cross(normal(F), wanted), 13)


# 2, 3. Derivatives of the invariants


@pytest.mark.capability(29, 30)
@every_state
def test_gradients_and_hessians_of_the_invariants(state, rng):
    """dI/dF and d2I/dF2 are those of 60 digits; products, 6x6 matrices and eigenpairs agree."""
    F, F_dot = gradient(state), rng.normal(size=(2, 3, 2))
    U, s, V = mi.svd(F)
    g, Hs, products = (
        mi.gradients(U, s, V),
        mi.hessians(U, s, V),
        mi.hessian_products(U, s, V, F_dot),
    )
    for k, psi in enumerate(INVARIANTS):
        wanted, K = derivatives(psi, F)
        agree(g[k], wanted, 13)
        agree(mi.to_matrix(Hs)[k], K, 12)
        agree(products[:, k].reshape(2, 6), F_dot.reshape(2, 6) @ K, 12)


@pytest.mark.capability(31)
@every_state
def test_eigenpairs_of_the_invariants(state):
    """Each of the six orthonormal matrices is multiplied by its eigenvalue; I1 has three zeros."""
    U, s, V = mi.svd(gradient(state))
    Q, values = mi.basis(U, V), mi.eigenvalues(s)
    agree(np.einsum("aij,bij->ab", Q, Q), np.eye(6), 14)
    products = mi.hessian_products(U, s, V, Q)
    agree(products, np.einsum("ka,aij->akij", values, Q), 13)
    a, b = STRETCHES[state]
    agree(values[0], [0, 0, 2 / (a + b), 0, 1 / a, 1 / b], 13)
    assert np.count_nonzero(values[0] == 0) == 3
    agree(values[1:], [[2] * 6, [1, -1, 1, -1, b / a, a / b]], 13)


@pytest.mark.capability(32)
def test_eigenmatrices_are_padded_from_2d(rng):
    """The four of 2D, padded with a row of zeros, are eigenmatrices with the same eigenvalues."""
    F = np.array([[1.2, 0.3], [-0.1, 0.8]])
    U, s, Vt = np.linalg.svd(F)
    Q = U @ mi.PLANE @ Vt
    space = random_rotation(rng)
    full = np.block([[U, np.zeros((2, 1))], [np.zeros((1, 2)), np.ones((1, 1))]])
    agree(mi.basis(space @ full, Vt.T)[:4], space @ mi.padded(Q), 14)
    for k, psi in enumerate(INVARIANTS):
        K = derivatives(psi, F)[1]
        for p in range(4):
            wanted = mi.eigenvalues(s)[k, p] * Q[p].ravel()
            assert np.abs(K @ Q[p].ravel() - wanted).max() < 1e-13


@pytest.mark.capability(33)
@every_state
def test_any_energy_by_the_chain_rule(state):
    """Gradient and Hessian of psi = I1^2 I3 + sin I2 + I1 I2."""
    F = gradient(state)
    U, s, V = mi.svd(F)
    I1, I2, I3 = mi.invariants(s)
    first = np.array([2 * I1 * I3 + I2, np.cos(I2) + I1, I1**2])
    second = np.array([[2 * I3, 1, 2 * I1], [1, -np.sin(I2), 0], [2 * I1, 0, 0]])
    g, K = derivatives(lambda I1, I2, I3: I1**2 * I3 + mp.sin(I2) + I1 * I2, F)
    agree(mi.energy_gradient(U, s, V, first), g, 13)
    agree(mi.to_matrix(mi.energy_hessian(U, s, V, first, second)), K, 12)


# 4. The sheet


@pytest.mark.capability(34, 35)
@every_state
def test_sheet_is_the_solid_with_unit_volume(state):
    """The 3x3 gradient has J = 1 and the columns of F; psi_IncNeo of it is psi_sheet."""
    F = np.stack([gradient(state), 1.3 * gradient(state)])
    G = me.solid_gradient(F)
    agree(np.linalg.det(G), np.ones(2), 12)
    assert np.array_equal(G[..., :2], F)
    assert np.abs(np.einsum("...i,...ij->...j", G[..., 2], F)).max() < 1e-13 * np.abs(G).max()
    mu = np.array([1.3, 2.0])
    agree(me.incompressible(G, mu), me.sheet(F, mu), 14)
    agree(me.normal_stretch(F), 1 / mi.invariants(mi.svd(F)[1])[:, 2], 12)
    agree(me.incompressible(G, mu), mu / 2 * (np.sum(G**2, (1, 2)) - 3), 14)


@pytest.mark.capability(35, 36, 37)
@every_state
def test_derivatives_and_eigensystem_of_the_sheet(state):
    """Gradient, both lines of the Hessian and its six eigenpairs are those of 60 digits.

    Some eigenvalues are negative unless both stretches are large.
    """
    F = gradient(state)
    U, s, V = mi.svd(F)
    g, K = derivatives(exact_sheet, F)
    agree(me.sheet_gradient(U, s, V, MU), g, 12)
    agree(mi.to_matrix(me.sheet_hessian(U, s, V, MU)), K, 11)
    agree(mi.to_matrix(me.sheet_hessian_short(U, s, V, MU)), K, 11)
    chain = mi.energy_hessian(U, s, V, *me.sheet_derivatives(s, MU))
    agree(mi.to_matrix(chain), K, 11)
    values, Q = me.eigensystem(U, s, V, MU)
    flat = Q.reshape(6, 6)
    agree(flat @ flat.T, np.eye(6), 14)
    for value, q in zip(values, flat, strict=True):
        assert np.abs(K @ q - value * q).max() < 1e-12 * np.abs(K).max()
    agree(np.sort(values), np.linalg.eigvalsh(K), 12)
    assert (values.min() > 0) == (state in ("nearly equal", "stretched"))


@pytest.mark.capability(38)
@every_state
def test_reduced_hessian(state):
    """On D1, D2 the Hessian is the printed 2x2 matrix, with beta, gamma and v_1, v_2."""
    F = gradient(state)
    U, s, V = mi.svd(F)
    K = derivatives(exact_sheet, F)[1]
    D = me.reduced_basis(U, V).reshape(2, 6)
    reduced = me.reduced_hessian(s, MU)
    agree(reduced, D @ K @ D.T, 11)
    beta, gamma = me.beta_gamma(s)
    a, b = (mp.mpf(x) for x in s)
    assert abs(beta - float(3 * (b**2 - a**2))) < 1e-14 * gamma
    assert gamma == pytest.approx(float(mp.sqrt(16 * (a * b) ** 2 + 9 * (b**2 - a**2) ** 2)), 1e-14)
    values, vectors = me.reduced_eigenpairs(s, MU)
    agree(values, np.linalg.eigvalsh(reduced), 12)
    agree(vectors, [[beta - gamma, 4 * s[0] * s[1]], [beta + gamma, 4 * s[0] * s[1]]], 15)
    for value, v in zip(values, vectors, strict=True):
        v = v / np.linalg.norm(v)
        assert np.abs(reduced @ v - value * v).max() < 1e-11 * np.abs(reduced).max()


@pytest.mark.capability(39)
@pytest.mark.digits(13)
@pytest.mark.parametrize("s", [(1.0, 1e-5), (1e-5, 1.0), (0.95, 1.0), (1.0, 1.0)])
def test_last_eigenpairs_do_not_cancel(s):
    """Against 60 digits; at s_1 >> s_2 the printed beta + gamma loses 9 of them."""
    s, I3 = np.array(s), np.eye(3)
    found, Q = me.last_eigenpairs(I3, s, np.eye(2), MU)
    with mp.workdps(60):
        a, b = (mp.mpf(x) for x in s)
        beta = 3 * (b**2 - a**2)
        gamma = mp.sqrt(16 * (a * b) ** 2 + beta**2)
        for k, root in enumerate((-gamma, gamma)):
            value = MU + MU * (3 * (a**2 + b**2) + root) / (2 * (a * b) ** 4)
            v = mp.matrix([beta + root, 4 * a * b])
            v = np.array((v / mp.norm(v)).tolist(), dtype=float).ravel()
            assert found[k] == pytest.approx(float(value), rel=1e-14)
            found_v = np.diag(Q[k]) * np.sign(Q[k][1, 1] * v[1])
            assert found_v == pytest.approx(v, rel=1e-13)
            assert not Q[k][~np.eye(3, 2, dtype=bool)].any()
    if s[0] / s[1] > 1e4:
        x, y = me.reduced_eigenpairs(s, MU)[1][1]
        assert abs(x / y * v[1] / v[0] - 1) > 1e-9


# What is misprinted


@pytest.mark.misprint(1, "Hessian off by {0:.3g}")
def test_misprint_rank_one_term():
    """Line 1 of the Hessian with dI2/dF is off by 2.8, also against its own second line."""
    U, s, V = mi.svd(F0)
    right = me.sheet_hessian(U, s, V, MU)
    printed = me.sheet_hessian(U, s, V, MU, as_printed=True)
    I3, g = mi.invariants(s)[2], mi.gradients(U, s, V)
    lost = 3 * MU / I3**4 * (np.multiply.outer(g[1], g[1]) - np.multiply.outer(g[2], g[2]))
    agree(printed - right, lost, 13)
    assert off(printed, right) == pytest.approx(2.839, abs=1e-3)


@pytest.mark.misprint(2, "lambda_1 becomes lambda_2, off by {0:.2g}")
@pytest.mark.misprint(
    3,
    "each eigenmatrix with the other's eigenvalue, {1:.3g} and {2:.2g} times its own",
)
def test_misprint_eigenvalues():
    """lambda_1 with + gamma is lambda_2; the final two eigenvalues stand exchanged."""
    U, s, V = mi.svd(F0)
    right, vectors = me.reduced_eigenpairs(s, MU)
    printed, same = me.reduced_eigenpairs(s, MU, as_printed=True)
    assert np.array_equal(vectors, same)
    agree(printed, right[[1, 1]], 15)
    assert off(printed, right) == pytest.approx(0.7633, abs=1e-4)
    K = mi.to_matrix(me.sheet_hessian(U, s, V, MU))
    for as_printed, wanted in ((False, 0.0), (True, right[1] - right[0])):
        values, Q = me.last_eigenpairs(U, s, V, MU, as_printed)
        residual = K @ Q.reshape(2, 6).T - values * Q.reshape(2, 6).T
        assert np.linalg.norm(residual, axis=0) == pytest.approx([wanted, wanted], abs=1e-12)
        recorder.figure(*(values / right) if as_printed else ())


@pytest.mark.misprint(4, "none: true of both")
def test_gradient_of_I3_is_orthogonal_to_four_eigenmatrices():
    """The remark names dI2/dF; dI3/dF is meant, which the rank-one term holds. True of both."""
    U, s, V = mi.svd(F0)
    for g in mi.gradients(U, s, V)[1:]:
        found = np.einsum("aij,ij->a", mi.basis(U, V), g)
        assert np.abs(found[2:]).max() < 1e-15 and np.abs(found[:2]).min() > 0.1


E2, E3 = np.eye(2), np.eye(3)
CALLS = [
    (lambda: mi.svd(E3), r"F = U Sigma V\^T needs gradients .* got shape \(3, 3\)"),
    (lambda: mi.turned(0, E2, 0), r"U \[\.\] V\^T needs gradients .* got shape \(2, 2\)"),
    (lambda: mi.padded(F0), r"Padding needs matrices \(\.\.\., 2, 2\), got shape \(3, 2\)"),
    (lambda: mi.invariants_of_gradient([1]), r"I1, I2, I3 needs gradients .* shape \(1,\)"),
    (lambda: mi.second_invariant(F0), r"Footnote 1 needs matrices .* got shape \(3, 2\)"),
    (lambda: mi.in_plane_rates([[1, 2], [1, 1]], 1, 1), r"\(3\) divides by s_1\^2 - s_2\^2"),
    (lambda: mi.in_plane_sum([1.0, 1, 1], 1, 1), r"wz \+ alpha needs .* got shape \(3,\)"),
    (lambda: mi.normal_rates([[1.0, 0.0], [2.0, 1.0]], 1, 1), "1.1 divides by the singular values"),
    (lambda: mi.rates(E3, [1, 2], E2, E2), r"\(2\) needs .* \(2, 2\)"),
    (lambda: mi.split(E3, E2, E2), r"1\.1 needs gradients .* \(2, 2\)"),
    (lambda: mi.normal_velocity(E3, [1, 2], E2, E2), r"1\.1 needs gradients .* \(2, 2\)"),
    (lambda: mi.hessian_products(E3, np.ones(2), E2, E2), r"I1, I2, I3 needs .* \(2, 2\)"),
    (lambda: mi.hessian_products(E3, [1.0, 0.0], E2, F0), "I1 and I3 divides .* of which one is 0"),
    (lambda: mi.eigenvalues([0.0, 1.0]), "eigenvalues of I1 and I3 divides by the singular"),
    (lambda: mi.to_matrix(np.eye(6)), r"6x6 matrix needs Hessians .* got shape \(6, 6\)"),
    (lambda: me.incompressible(F0, 1), r"psi_IncNeo needs gradients .* got shape \(3, 2\)"),
    (lambda: me.normal_stretch([F0, np.ones((3, 2))]), "The normal stretch divides by I3"),
    (lambda: me.solid_gradient(E3), r"The 3x3 gradient needs .* got shape \(3, 3\)"),
    (lambda: me.sheet_derivatives([1.0, 0.0], 1), "psi_sheet divides by the singular values"),
    (lambda: me.four_eigenpairs(0, [0.0, 0.0], 0, 1), "four eigenpairs divides by"),
    (lambda: me.reduced_hessian([1.0, 0.0], 1), "reduced Hessian divides by"),
    (lambda: me.reduced_eigenpairs([1.0, 0.0], 1), "reduced eigenpairs divides by"),
    (lambda: me.last_eigenpairs(0, [1.0, 0.0], 0, 1), "last two eigenpairs divides by"),
    (lambda: me.sheet_hessian(0, [1.0, 0.0], 0, 1), "Hessian of psi_sheet divides by"),
    (lambda: me.sheet_hessian_short(0, [1.0], 0, 1), r"Hessian of psi_sheet needs .* \(1,\)"),
]


@pytest.mark.parametrize(("call", "message"), CALLS)
def test_errors_name_the_formula(call, message):
    with pytest.raises(ValueError, match=message):
        call()
