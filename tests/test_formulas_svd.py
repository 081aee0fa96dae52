# SPDX-License-Identifier: MIT
"""Document 000: energies in principal stretches, quotients, blocks, and dP/dF through the SVD.

References are 80-digit central differences of psi(F), whose stretches are roots of the eigenvalues
of F^T F: no singular vector enters. Digits are those of max |found - wanted| / max |wanted|.
"""

import functools
import itertools

import numpy as np
import pytest
from cases import LMBDA, MU, agree, off, random_rotation
from mpmath import mp

from variform.forms.formulas import quotients as qu
from variform.forms.formulas import svd_derivatives as sd

H = 1e-40


def user_hessian(s):
    J, first, second = qu.volume_derivatives(s)
    volume = first[..., :, None] * first[..., None, :] + J[..., None, None] * second
    return 3 * MU * s[..., :, None] ** 2 * np.eye(s.shape[-1]) + LMBDA * volume


# An energy as a user writes it, smooth in F: mu/4 tr C^2 + lambda/2 det C.
USER = qu.Energy(
    lambda s: MU / 4 * np.sum(s**4, -1) + LMBDA / 2 * np.prod(s, -1) ** 2,
    lambda s: MU * s**3 + LMBDA * np.prod(s, -1)[..., None] * qu.volume_derivatives(s)[1],
    user_hessian,
)
ENERGIES = {
    "fixed_corotated": qu.fixed_corotated(MU, LMBDA),
    "arap": qu.arap(MU),
    "neo_hookean": qu.neo_hookean(MU, LMBDA),
    "hencky": qu.hencky(MU, LMBDA),
    "saint_venant_kirchhoff": qu.saint_venant_kirchhoff(MU, LMBDA),
    "user": USER,
}
SMOOTH = ("saint_venant_kirchhoff", "user")  # smooth in F at s_i + s_j = 0 too
LOGARITHMIC = ("neo_hookean", "hencky")  # J > 0
every_energy = pytest.mark.parametrize("name", ENERGIES)

STRETCHES = {
    "generic": (1.3, 0.9, 0.6),
    "inverted": (1.2, 0.8, -0.5),
    "flat": (1.4, 0.7, 0.0),
    "equal": (1.2, 1.2, 0.8),
    "nearly equal": (1.1 + 1e-9, 1.1, 0.8),
    "all equal": (1.2, 1.2, 1.2),
    "inverted, equal": (1.1, 1.1, -0.4),
    "plane": (1.3, 0.6),
    "plane inverted": (1.3, -0.6),
    "plane equal": (0.9, 0.9),
}


def rotation(rng, d):
    return random_rotation(rng) if d == 3 else sd.plane_rotation(rng.uniform(0, 6))


def gradient(state):
    rng = np.random.default_rng(len(state))
    d = len(STRETCHES[state])
    return rotation(rng, d) * STRETCHES[state] @ rotation(rng, d).T


# Exact values


def exact(name, s):
    """psi^ in mpmath, written down a second time."""
    mu, la = mp.mpf(MU), mp.mpf(LMBDA)
    J, d = mp.fprod(s), len(s)
    if name in ("fixed_corotated", "arap"):
        la = la if name == "fixed_corotated" else 0
        return mu * sum((x - 1) ** 2 for x in s) + la / 2 * (J - 1) ** 2
    if name == "neo_hookean":
        return mu / 2 * (sum(x**2 for x in s) - d) - mu * mp.log(J) + la / 2 * mp.log(J) ** 2
    if name == "hencky":
        return mu * sum(mp.log(x) ** 2 for x in s) + la / 2 * mp.log(J) ** 2
    if name == "user":
        return mu / 4 * sum(x**4 for x in s) + la / 2 * J**2
    E = [(x**2 - 1) / 2 for x in s]
    return mu * sum(x**2 for x in E) + la / 2 * sum(E) ** 2


def singular_values(F):
    """Signed singular values in falling order, from the eigenvalues of F^T F."""
    values = mp.eigsy(F.T * F, eigvals_only=True)
    s = sorted((mp.sqrt(abs(x)) for x in values), reverse=True)
    return [*s[:-1], s[-1] * (-1 if mp.det(F) < 0 else 1)]


@functools.cache
def neighbours(state):
    """Singular values at F + h (a e_p + b e_q), a and b of {-1, 0, 1}, 80 digits, h = 1e-20."""
    F = gradient(state)
    with mp.workdps(80):
        h, d = mp.mpf(10) ** -20, len(F)
        found = {}
        for p, q in itertools.combinations_with_replacement(range(d * d), 2):
            for a, b in itertools.product((1, -1), repeat=2):
                G = mp.matrix(F.tolist())
                G[p // d, p % d] += a * h
                G[q // d, q % d] += b * h
                found[p, q, a, b] = singular_values(G)
    return found


def exact_derivatives(name, state):
    """P and dP/dF as central differences of psi(F)."""
    d = len(STRETCHES[state])
    P, K = np.zeros(d * d), np.zeros((d * d, d * d))
    with mp.workdps(80):
        h = mp.mpf(10) ** -20
        psi = {key: exact(name, s) for key, s in neighbours(state).items()}
        for p, q in itertools.combinations_with_replacement(range(d * d), 2):
            x = psi[p, q, 1, 1] - psi[p, q, 1, -1] - psi[p, q, -1, 1] + psi[p, q, -1, -1]
            K[p, q] = K[q, p] = x / (4 * h**2)
            if p == q:
                P[p] = (psi[p, p, 1, 1] - psi[p, p, -1, -1]) / (4 * h)
    return P.reshape(d, d), K


def applies(name, state):
    return not (name in LOGARITHMIC and min(STRETCHES[state]) <= 0)


def blocks(name, F, **options):
    U, s, V = sd.signed_svd(F)
    return U, V, *sd.tangent_blocks(ENERGIES[name], s, smooth=name in SMOOTH, **options)


# Energies


@pytest.mark.capability(3)
@every_energy
def test_energies_have_their_derivatives(name):
    """psi_i and psi_ij are complex steps of psi^ and psi_i; psi^ is that written in mpmath."""
    energy = ENERGIES[name]
    for state in filter(functools.partial(applies, name), STRETCHES):
        s, steps = np.array(STRETCHES[state]), 1j * H * np.eye(len(STRETCHES[state]))
        agree(energy.value(s), float(exact(name, [mp.mpf(x) for x in s])), 14)
        agree(energy.gradient(s), np.imag(energy.value(s + steps)) / H, 14)
        agree(energy.hessian(s), np.imag(energy.gradient(s + steps)).T / H, 14)


def test_moduli_may_vary_over_the_leading_axes(rng):
    """One call with arrays of moduli equals calls one by one; stretches may be lists."""
    s, mu, lmbda = rng.uniform(0.5, 1.5, (4, 3)), rng.uniform(1, 2, 4), rng.uniform(1, 2, 4)
    for make in (qu.fixed_corotated, qu.neo_hookean, qu.hencky, qu.saint_venant_kirchhoff):
        for part in range(3):
            one_by_one = [make(*m)[part](x.tolist()) for x, *m in zip(s, mu, lmbda, strict=True)]
            agree(make(mu, lmbda)[part](s), one_by_one, 15)


# Decomposition and rotations


@pytest.mark.capability(1)
@pytest.mark.parametrize("state", STRETCHES)
def test_signed_svd(state):
    """F = U Sigma V^T with rotations; only the last, smallest stretch has a sign: that of det F."""
    F, wanted = gradient(state), np.array(STRETCHES[state])
    U, s, V = sd.signed_svd(F)
    agree(s, wanted, 14)
    agree(sd.compose(U, s, V), F, 14)
    for X in (U, V):
        agree(X @ X.T, np.eye(len(s)), 14)
        agree(np.linalg.det(X), 1.0, 14)
    assert not np.any(s[:-1] < 0)
    for found, one in zip(sd.signed_svd(np.stack([[F, -F, F.T]])), (U, s, V), strict=True):
        assert found.shape == (1, 3, *one.shape)
        assert np.array_equal(found[0, 0], one)


@pytest.mark.capability(1)
def test_unsigned_svd_is_no_substitute():
    """An inverted F with all s > 0 gets the stress of another state."""
    F, energy = gradient("inverted"), ENERGIES["fixed_corotated"]
    U, s, Vt = np.linalg.svd(F)
    P, _ = exact_derivatives("fixed_corotated", "inverted")
    agree(sd.first_piola(energy, F), P, 14)
    assert off(sd.compose(U, energy.gradient(s), Vt.T), P) == pytest.approx(1.3599, abs=1e-4)


def exact_rotation(r):
    """exp(cp(r)) by its series, 60 digits."""
    with mp.workdps(60):
        a, b, c = map(mp.mpf, r)
        K = mp.matrix([[0, -c, b], [c, 0, -a], [-b, a, 0]])
        R, term = mp.eye(3), mp.eye(3)
        for n in range(1, 80):
            term = term * K / n
            R += term
        return R


@pytest.mark.capability(9)
@pytest.mark.parametrize("size", [3.0, np.pi, 0.7, 1e-4, 1e-8, 1e-20, 1e-170, 0.0])
def test_rodrigues(size, rng):
    """Rodrigues' formula is exp(cp(r)); R - I is exact to the last digits however small r is."""
    k = np.array([0.6, -0.48, 0.64])
    r = size * k
    with mp.workdps(60):
        wanted = exact_rotation(r) - mp.eye(3)
        change = np.array(wanted.tolist(), dtype=float)
    agree(sd.rodrigues(r), change + np.eye(3), 14)
    off_diagonal = ~np.eye(3, dtype=bool)
    if size:
        agree(sd.rodrigues(r)[off_diagonal], change[off_diagonal], 14)
        agree(sd.axis_rotation(k, size), change + np.eye(3), 14)
    else:
        assert np.array_equal(sd.rodrigues(r), np.eye(3))
    several = rng.normal(size=(2, 3, 3))
    assert np.array_equal(sd.rodrigues(several)[1, 2], sd.rodrigues(several[1, 2]))


@pytest.mark.capability(10, 12)
def test_cross_matrix_and_plane_rotation(rng):
    """The matrix cp makes k x x; the 2D rotation turns e1 to (cos, sin) and angles add up."""
    k, x = rng.normal(size=(2, 5, 3))
    agree(np.einsum("...ij,...j->...i", sd.cross_matrix(k), x), np.cross(k, x), 15)
    a, b = rng.uniform(-3, 3, (2, 4))
    R = sd.plane_rotation(a)
    agree(R[..., 0], np.stack([np.cos(a), np.sin(a)], -1), 15)
    agree(R @ sd.plane_rotation(b), sd.plane_rotation(a + b), 14)
    agree(np.linalg.det(R), np.ones(4), 15)


@pytest.mark.capability(11)
def test_parametrization(rng):
    """F(s, u, v) has the stretches s and turns by u and v: exact values, in 3D and 2D."""
    s, u, v = rng.normal(size=(3, 4, 3))
    with mp.workdps(60):
        wanted = [
            (exact_rotation(b) * mp.diag(a.tolist()) * exact_rotation(c).T).tolist()
            for a, b, c in zip(s, u, v, strict=True)
        ]
    agree(sd.deformation_gradient(s, u, v), np.array(wanted, dtype=float), 14)
    F = sd.deformation_gradient(s[:, :2], u[:, 0], v[:, 0])
    planes = [
        sd.deformation_gradient([*a[:2], 1], [0, 0, b], [0, 0, c])
        for a, b, c in zip(s, u[:, 0], v[:, 0], strict=True)
    ]
    agree(F, np.array(planes)[:, :2, :2], 14)


# Storage


@pytest.mark.capability(8, 16)
@pytest.mark.digits("exact")
@pytest.mark.parametrize("d", [2, 3])
def test_storage_and_permutation(d):
    """P_ij at d i + j, dP_ij/dF_kl at (d i + j, d k + l); 11 22 33 | 12 21 | 13 31 | 23 32."""
    T = np.arange(2.0 * d**4).reshape(2, d, d, d, d)
    names = {2: "11 22 12 21", 3: "11 22 33 12 21 13 31 23 32"}[d].split()
    order = [(int(i) - 1, int(j) - 1) for i, j in names]
    matrix, P = sd.to_matrix(T), T[:, 1, 0]
    assert sd.to_vector(P).tolist() == [[p[i, j] for i in range(d) for j in range(d)] for p in P]
    assert np.array_equal(sd.from_vector(sd.to_vector(P)), P)
    for i, j, k, m in itertools.product(range(d), repeat=4):
        assert matrix[1, d * i + j, d * k + m] == T[1, i, j, k, m]
    assert np.array_equal(sd.to_tensor(matrix), T)
    assert sd.permuted(matrix)[0].tolist() == [[T[(0, *p, *q)] for q in order] for p in order]
    assert np.array_equal(sd.unpermuted(sd.permuted(matrix)), matrix)


@pytest.mark.capability(16)
@pytest.mark.digits("exact")
def test_block_diagonal():
    """diag(A, B12, B13, B23): A and B where they belong, zeros elsewhere."""
    A, B = np.arange(1.0, 10).reshape(3, 3), np.arange(10.0, 22).reshape(3, 2, 2)
    found = sd.block_diagonal(A, B)
    wanted = np.zeros((9, 9))
    wanted[:3, :3], wanted[3:5, 3:5], wanted[5:7, 5:7], wanted[7:, 7:] = A, *B
    assert np.array_equal(found, wanted)
    plane = sd.block_diagonal(A[:2, :2], B[:1])
    assert np.array_equal(
        plane, np.block([[A[:2, :2], np.zeros((2, 2))], [np.zeros((2, 2)), B[0]]])
    )


# Stress and its derivative


@pytest.mark.capability(4, 5, 6, 7, 23)
@pytest.mark.parametrize(
    ("name", "state"), [x for x in itertools.product(ENERGIES, STRETCHES) if applies(*x)]
)
def test_stress_and_tangent_are_derivatives_of_the_energy(name, state):
    """P = U P^ V^T and dP/dF are those of psi(F), by all of the document's forms."""
    F = gradient(state)
    P, K = exact_derivatives(name, state)
    agree(sd.first_piola(ENERGIES[name], F), P, 13)
    U, V, A, B = blocks(name, F)
    T = sd.tangent(U, V, A, B)
    agree(sd.to_matrix(T), K, 13)
    dF = np.random.default_rng(1).normal(size=(3, *F.shape))
    wanted = sd.from_vector(sd.to_vector(dF) @ K)
    agree(sd.tangent_action(T, dF), wanted, 13)
    agree(sd.differential(U, V, A, B, dF), wanted, 13)
    agree(sd.frozen_differential(sd.tangent_at_stretches(A, B), U, V, dF), wanted, 13)


@pytest.mark.capability(2, 6)
@pytest.mark.parametrize("d", [2, 3])
@every_energy
def test_frozen_rotations(name, d, rng):
    """Both dP and P from K = R^T F Q for any rotations R, Q, unless the material has axes."""
    F, dF = np.eye(d) + 0.3 * rng.normal(size=(d, d)), rng.normal(size=(d, d))
    R, Q = rotation(rng, d), rotation(rng, d)
    wanted = sd.differential(*blocks(name, F), dF)
    T = sd.tangent(*blocks(name, R.T @ F @ Q))
    agree(sd.frozen_differential(T, R, Q, dF), wanted, 13)

    def P(F):
        return sd.first_piola(ENERGIES[name], F)

    agree(sd.turned_stress(P, F, R, Q), P(F), 13)
    anisotropic = sd.turned_stress(lambda F: F * np.arange(1, d + 1), F, R, Q)
    assert off(anisotropic, F * np.arange(1, d + 1)) > 0.1


def test_leading_axes(rng):
    """Many states at once give what each gives alone, blocks of shape (..., 3, 2, 2)."""
    F, dF = np.eye(3) + 0.3 * rng.normal(size=(2, 4, 3, 3)), rng.normal(size=(2, 1, 3, 3))
    U, V, A, B = blocks(
        "neo_hookean", np.where(np.linalg.det(F)[..., None, None] > 0, F, np.eye(3))
    )
    assert B.shape == (2, 4, 3, 2, 2)
    one = sd.differential(U[1, 2], V[1, 2], A[1, 2], B[1, 2], dF[1, 0])
    agree(sd.differential(U, V, A, B, dF)[1, 2], one, 15)
    agree(sd.tangent(U, V, A, B)[1, 2], sd.tangent(U[1, 2], V[1, 2], A[1, 2], B[1, 2]), 15)


CALLS = [
    (lambda: qu.stretches([1, 2, 3, 4], "A"), r"A needs stretches .* got shape \(4,\)"),
    (lambda: sd.signed_svd(np.ones((3, 2))), r"F = U Sigma V\^T needs .* got shape \(3, 2\)"),
    (lambda: sd.signed_svd([[1, np.nan], [0, 1]]), r"F = U Sigma V\^T needs finite entries"),
    (lambda: sd.compose(np.eye(3), [1, 2, 3], np.ones(3)), r"U Sigma V\^T .* got shape \(3,\)"),
    (lambda: sd.cross_matrix([1, 2]), r"cp needs vectors with 3 components, got shape \(2,\)"),
    (lambda: sd.axis_rotation([1, 1, 0], 1), r"Rodrigues' formula needs .* \|A\| = 1.41421356"),
    (lambda: sd.deformation_gradient([1], [0], [0]), r"F\(s, u, v\) needs .* got shape \(1,\)"),
    (lambda: sd.to_vector(np.ones((3, 2))), r"P_3\(i-1\)\+j needs tensors .* shape \(3, 2\)"),
    (lambda: sd.from_vector(np.ones(6)), r"P_ij needs vectors of 9 or 4 .* shape \(6,\)"),
    (lambda: sd.to_matrix(np.ones((2, 2))), r"dF_3\(k-1\)\+l needs .* got shape \(2, 2\)"),
    (lambda: sd.to_tensor(np.ones((9, 4))), r"dP_ij / dF_kl needs matrices .* shape \(9, 4\)"),
    (lambda: sd.permuted(np.eye(3)), r"diag\(A, B12, \.\.\.\) needs matrices .* shape \(3, 3\)"),
    (lambda: sd.unpermuted(np.eye(5)), r"diag\(A, B12, \.\.\.\) needs matrices .* \(5, 5\)"),
    (
        lambda: sd.block_diagonal(np.eye(3), np.ones((1, 2, 2))),
        r"diag\(A, B12, \.\.\.\) needs B \(\.\.\., 3, 2, 2\), got shape \(1, 2, 2\)",
    ),
    (lambda: sd.differential(np.eye(2), np.eye(2), np.eye(4), 0, 0), r"A needs .* \(4, 4\)"),
    (lambda: sd.tangent_action(0, np.ones(4)), r"dP needs tensors .* got shape \(4,\)"),
    (
        lambda: sd.turned_stress(lambda F: F, [1, 2], np.eye(2), np.eye(2)),
        r"P\(F\) = R P\(R\^T F Q\) Q\^T needs tensors .* shape \(2,\)",
    ),
    (
        lambda: ENERGIES["neo_hookean"].gradient([1.0, -0.5]),
        r"neo-Hookean energy contains ln J and needs J > 0, got J = -0.5",
    ),
    (
        lambda: ENERGIES["hencky"].hessian([[1.0, 2, 3], [-1, -0.25, 1]]),
        r"Hencky energy contains ln s and needs s > 0, got s = -1\.",
    ),
]


@pytest.mark.parametrize(("call", "message"), CALLS)
def test_errors_name_the_formula(call, message):
    with pytest.raises(ValueError, match=message):
        call()
