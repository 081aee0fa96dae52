# SPDX-License-Identifier: MIT
"""Laws of the compiled point kernels: singular values, stress and tangent of isotropic energies."""

import math
import zlib

import numpy as np
import pytest
import reference
from kernels import CLAMP, every_energy

from variform.forms import energies


def condition(energy, label, F, s):
    """|F| / distance to where the energy is singular; None inside the clamp or 1e-9 from s = 0."""
    size, n = np.abs(s).max(), len(s)
    sums = [abs(s[i] + s[j]) for i in range(n) for j in range(i)]
    if F.shape == (3, 2):
        sums += list(np.abs(s))
    if not energy.smooth and min(sums) < CLAMP * max(min(size, 1), CLAMP):
        return None
    if energy.singular and np.abs(s).min() < 1e-9 * size:
        return None
    near = [] if energy.smooth else sums
    # "mixed": eps |F| in F, the SVD's backward error, is that much in the smallest stretch.
    if energy.singular or label == "mixed":
        near = near + list(np.abs(s))
    return max(1, size / min(near)) if near else 1


def compare(kernels, psi_hat, energy, count, rows=3, cols=3, plane=False, improper=False):
    """Compare with the reference at states of every class; returns their number, worst error."""
    rng = np.random.default_rng(zlib.crc32(psi_hat.__name__.encode()))
    labels, F = zip(*reference.states(rng, count, rows, cols, energy.inverted), strict=True)
    F = np.array(F)
    if plane:
        # f is larger than |s_2|, so that both conventions give the sign of det F to s_2.
        F2, F = F, np.zeros((len(F), 3, 3))
        F[:, :2, :2] = F2
        F[:, 2, 2] = np.linalg.norm(F2, axis=(1, 2)) * np.linspace(0.75, 1.5, len(F2))
    kind = {"plane": plane, "improper": improper}
    W, P, A = kernels.evaluate(psi_hat, F, **kind)
    assert np.isfinite(W).all() and np.isfinite(P).all() and np.isfinite(A).all()
    s = kernels.svd(F, plane, improper)[1]
    compared, worst = 0, 0.0
    for k, label in enumerate(labels):
        factor = condition(energy, label, F[k], s[k])
        # An unsigned stretch has a kink at 0.
        if factor is None or (improper and label in ("flat", "thin")):
            continue
        w, p, a = reference.derivatives(psi_hat, F[k], improper)
        size, largest = max(np.abs(a).max(), energy.terms), np.abs(F[k]).max()
        error = max(
            np.abs(A[k] - a).max() / size,
            np.abs(P[k] - p).max() / max(np.abs(p).max(), size * largest),
            abs(W[k] - w) / max(abs(w), size * largest**2),
        )
        assert error <= 1e-13 * factor, f"{error:.1e} > 1e-13 * {factor:.1e} at {label} {F[k]}"
        compared, worst = compared + 1, max(worst, error / factor)
    return compared, worst


@every_energy
def test_stress_and_tangent_to_50_digits(kernels, psi_hat):
    """W, P and dP/dF are those of psi(F) at rest, at repeated, nearly equal, inverted stretches.

    Errors are in max norm, of dP/dF over |dP/dF|, of P over max(|P|, |dP/dF| |F|). 1e-13 is 450
    roundings; 3e-15 is what is reached, 1e-14 where a third derivative jumps between stretches.
    """
    compare(kernels, psi_hat, reference.ENERGIES[psi_hat], 2)


@pytest.mark.parametrize("psi_hat", reference.SHEETS, ids=lambda psi_hat: psi_hat.__name__)
def test_sheets_to_50_digits(kernels, psi_hat):
    """The same for 3x2 operands, where the normal adds (psi_i / s_i) n n."""
    compare(kernels, psi_hat, reference.SHEETS[psi_hat], 2, rows=3, cols=2)


VARIANTS = {
    "2x2": {"rows": 2, "cols": 2},
    "2x2, unsigned": {"rows": 2, "cols": 2, "improper": True},
    "3x3, unsigned": {"improper": True},
    "plane": {"rows": 2, "cols": 2, "plane": True},
}


@pytest.mark.parametrize("variant", VARIANTS)
@every_energy
def test_variants_to_50_digits(kernels, psi_hat, variant):
    """The same for 2x2 operands, for unsigned stretches, and for 3x3 ones that are plane."""
    compare(kernels, psi_hat, reference.ENERGIES[psi_hat], 1, **VARIANTS[variant])


@pytest.mark.slow
def test_thousands_of_states_to_50_digits(kernels):
    """The same at more than 2,000 states in all."""
    total = 0
    for variant, kind in {"3x3": {}, **VARIANTS}.items():
        for psi_hat, energy in reference.ENERGIES.items():
            n, worst = compare(kernels, psi_hat, energy, 5 if kind else 12, **kind)
            print(f"{psi_hat.__name__:24} {variant:14} {n:5} states, worst {worst:.1e}")
            total += n
    for psi_hat, energy in reference.SHEETS.items():
        n, worst = compare(kernels, psi_hat, energy, 12, rows=3, cols=2)
        print(f"{psi_hat.__name__:24} {'sheet':14} {n:5} states, worst {worst:.1e}")
        total += n
    assert total > 2000


@every_energy
def test_smoothness_is_found(kernels, psi_hat):
    """psi_hat(s1, -s2, -s3) = psi_hat(s1, s2, s3) tells the energies that are smooth in F."""
    assert kernels.function(psi_hat, 3, 0).smooth == reference.ENERGIES[psi_hat].smooth


@pytest.mark.parametrize("alone", [False, True])
@pytest.mark.parametrize("improper", [False, True])
@pytest.mark.parametrize("shape", [(3, 3), (2, 2), (3, 2)])
def test_singular_values_reconstruct(kernels, rng, shape, improper, alone):
    """F = U diag(s) V^T with orthogonal U, V, to 1e-14 of |F|; s sorted; the sign is det F's.

    One matrix by itself and four in lockstep go different ways.
    """
    rows, cols = shape
    for label, F in reference.matrices(rng, rows, cols):
        if alone:
            parts = [kernels.svd(F[k : k + 1], improper=improper) for k in range(len(F))]
            U, s, V = (np.concatenate(part) for part in zip(*parts, strict=True))
        else:
            U, s, V = kernels.svd(F, improper=improper)
        # Powers of two: exact, and the products below do not overflow.
        unit = np.exp2(np.floor(np.log2(np.abs(F).max(axis=(1, 2)) + 1e-307)))[:, None]
        S = np.zeros_like(F)
        S[:, range(cols), range(cols)] = s / unit
        F = F / unit[:, None]
        assert np.abs(U @ S @ V.swapaxes(1, 2) - F).max() < 1e-14, label
        for Q in U, V:
            assert np.abs(Q.swapaxes(1, 2) @ Q - np.eye(Q.shape[-1])).max() < 1e-14, label
        assert (np.abs(s[:, 1:]) <= np.abs(s[:, :-1])).all() and (s[:, :-1] >= 0).all(), label
        assert np.abs(np.linalg.det(V) - 1).max() < 1e-14, label
        if rows == cols and improper:
            assert (s >= 0).all(), label
        else:
            assert np.abs(np.linalg.det(U) - 1).max() < 1e-14, label
        if rows == cols and not improper and label in ("random", "states"):
            det = np.linalg.det(F)
            clear = np.abs(det) > 1e-13
            assert (np.sign(s[:, -1]) == np.sign(det))[clear].all(), label


@pytest.mark.parametrize("f", [0.7, -0.7, 0.0])
def test_plane_singular_values_keep_the_third(kernels, rng, f):
    """[[F2, 0], [0, f]] has the s, U, V of F2, and f last, whatever its size and sign."""
    F2 = rng.standard_normal((100, 2, 2))
    F = np.zeros((100, 3, 3))
    F[:, :2, :2], F[:, 2, 2] = F2, f
    for improper in (False, True):
        U, s, V = kernels.svd(F, plane=True, improper=improper)
        for whole, part in zip((U, s, V), kernels.svd(F2, improper=improper), strict=True):
            assert (
                (whole[:, :2, :2] == part).all() if part.ndim == 3 else (whole[:, :2] == part).all()
            )
        assert (s[:, 2] * U[:, 2, 2] == f).all() and (V[:, 2, 2] == 1).all()
        assert (s[:, 2] == (abs(f) if improper else f)).all()
        assert (U[:, 2, :2] == 0).all() and (U[:, :2, 2] == 0).all()


@every_energy
def test_tangent_is_symmetric_and_isotropic(kernels, rng, psi_hat):
    """A_ijkl = A_klij; P(R F Q) = R P(F) Q and A(R F Q) = A(F) turned, to 100 roundings of |A|."""
    F = np.eye(3) + 0.2 * rng.uniform(-1, 1, (50, 3, 3))
    R, Q = reference.rotation(rng, 3), reference.rotation(rng, 3)
    W, P, A = kernels.evaluate(psi_hat, F)
    w, p, a = kernels.evaluate(psi_hat, R @ F @ Q)
    size = np.abs(A).max(axis=(1, 2, 3, 4))
    assert (np.abs(A - A.transpose(0, 3, 4, 1, 2)).max(axis=(1, 2, 3, 4)) < 1e-14 * size).all()
    assert (np.abs(W - w) < 2e-14 * size).all()
    assert (np.abs(R @ P @ Q - p).max(axis=(1, 2)) < 2e-14 * size).all()
    turned = np.einsum("ia,bj,kc,dl,nabcd->nijkl", R, Q, R, Q, A)
    # The bounds of A are 2e-13 apart in directions where the stretches are close.
    assert (np.abs(turned - a).max(axis=(1, 2, 3, 4)) < 1e-13 * size).all()


@pytest.mark.parametrize("shape", [(3, 3), (2, 2), (3, 2)])
@pytest.mark.parametrize("psi_hat", [reference.arap, reference.saint_venant_kirchhoff])
def test_projection_is_the_nearest_semidefinite_tangent(kernels, rng, psi_hat, shape):
    """Projected, A has the eigenvectors of A and its eigenvalues, the negative ones raised to 0."""
    rows, cols = shape
    labels, F = zip(*reference.states(rng, 5, rows, cols, rows == cols), strict=True)
    keep = [label not in ("mirrored", "scaled", "mixed") for label in labels]
    F = 0.8 * np.array(F)[keep]  # compressed: some eigenvalues are negative
    n = rows * cols
    exact = kernels.evaluate(psi_hat, F)[2].reshape(-1, n, n)
    projected = kernels.evaluate(psi_hat, F, True)[2].reshape(-1, n, n)
    values, vectors = np.linalg.eigh(exact)
    expected = vectors * np.maximum(values, 0)[:, None] @ vectors.swapaxes(1, 2)
    size = np.abs(exact).max(axis=(1, 2))
    assert (values[:, 0] < -0.1 * size).any() and (values[:, 0] > -1e-14 * size).any()
    assert (np.abs(projected - expected).max(axis=(1, 2)) < 1e-13 * size).all()
    assert (np.linalg.eigvalsh(projected)[:, 0] > -1e-14 * size).all()


@pytest.mark.parametrize("shape", [(3, 3), (2, 2), (3, 2)])
def test_what_is_not_finite(kernels, shape):
    """An operand that is not finite gives NaN; infinite energy gives infinite P and A."""
    F = np.tile(np.eye(*shape), (3 * math.prod(shape), 1, 1))
    for k, bad in enumerate((np.nan, np.inf, -np.inf)):
        for i in range(math.prod(shape)):
            F[k * math.prod(shape) + i].ravel()[i] = bad
    for psi_hat in reference.arap, reference.hencky:
        for project in (False, True):
            assert all(np.isnan(out).all() for out in kernels.evaluate(psi_hat, F, project))
    assert np.isnan(kernels.svd(F)[1]).all()
    rest = np.eye(*shape)
    singular = [0 * rest, rest * [1, 0, 1][: shape[1]]]
    if shape != (3, 2):
        singular.append(rest * [1, -0.5, 1][: shape[1]])
    for psi_hat, F in (
        (reference.hencky, singular),
        (reference.symmetric_dirichlet, singular[:2]),
        (reference.saint_venant_kirchhoff, [1e200 * rest, 1e154 * rest]),
    ):
        for want in ("WPA", "A", "P", "W"):
            for out in kernels.evaluate(psi_hat, np.array(F), want=want):
                assert out is None or (out == np.inf).all()
    # Sums of entries near the largest double overflow in the rotation by U and V.
    steep = lambda s, f: 5e307 * sum(x**2 for x in s)  # noqa: E731
    turned = np.random.default_rng(1).standard_normal((50, *shape))
    A = kernels.evaluate(steep, turned / np.abs(turned).sum(axis=(1, 2))[:, None, None])[2]
    A = A.reshape(50, -1)
    assert (np.isfinite(A).all(axis=1) | (A == np.inf).all(axis=1)).all()
    tiny = kernels.evaluate(reference.arap, 1e-300 * rest)
    assert all(np.isfinite(out).all() for out in tiny)


def test_parts_that_are_not_wanted_change_nothing(kernels, rng):
    """W, P and A are the same numbers alone as together."""
    F = np.eye(3) + 0.1 * rng.standard_normal((20, 3, 3))
    together = kernels.evaluate(reference.fixed_corotated, F)
    for k, name in enumerate("WPA"):
        alone = kernels.evaluate(reference.fixed_corotated, F, want=name)
        assert [part is not None for part in alone] == [part == name for part in "WPA"]
        assert (alone[k] == together[k]).all()


def test_parameters_follow_the_operand(kernels, rng):
    """Moduli in X act like numbers in psi_hat, in the quotients' own evaluations as well."""

    def general(s, f, mu, lmbda):
        return mu * sum((x - 1) ** 2 for x in s) + lmbda / 2 * (math.prod(s) - 1) ** 2

    F = np.eye(3) + 10 ** rng.uniform(-9, -1, (50, 1, 1)) * rng.standard_normal((50, 3, 3))
    moduli = reference.MU, reference.LMBDA
    given = kernels.evaluate(general, F, parameters=moduli)
    for out, number in zip(given, kernels.evaluate(reference.fixed_corotated, F), strict=True):
        assert out == pytest.approx(number, rel=1e-14, abs=1e-14)


def test_projection_of_any_hessian(rng):
    """The Hessian of psi_hat, whatever it is, is replaced by the nearest semi-definite one.

    psi_hat = (p - c) M (p - c) / 2 of the power sums p has the Hessian J^T M J where p = c.
    """

    def general(s1, s2, s3, M, c):
        d = [s1**k + s2**k + s3**k - c[k - 1] for k in (1, 2, 3)]
        squares = sum(m * x**2 for m, x in zip(M[:3], d, strict=True)) / 2
        return squares + M[3] * d[0] * d[1] + M[4] * d[0] * d[2] + M[5] * d[1] * d[2]

    n, s = 1000, np.array([2.0, 1.0, 0.4])
    inverse = np.linalg.inv([np.ones(3), 2 * s, 3 * s**2])
    H = rng.standard_normal((n, 3, 3))
    H = H + H.swapaxes(1, 2) + rng.uniform(-2, 6, (n, 1, 1)) * np.eye(3)
    M = inverse.T @ H @ inverse
    entries = [M[:, i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    centre = [float(np.sum(s**k)) for k in (1, 2, 3)]
    F = np.tile(np.diag(s), (n, 1, 1))
    _, A = energies.principal(general).evaluate(F, entries, centre, project=True)
    values, vectors = np.linalg.eigh(H)
    wanted = vectors * np.maximum(values, 0)[:, None] @ vectors.swapaxes(1, 2)
    assert 0.2 < np.mean(values[:, 0] > 0) < 0.8
    found = np.einsum("niijj->nij", A)
    assert (np.abs(found - wanted).max(axis=(1, 2)) < 1e-12 * np.abs(H).max(axis=(1, 2))).all()
