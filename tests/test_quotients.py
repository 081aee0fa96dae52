# SPDX-License-Identifier: MIT
"""Difference and sum quotients of the compiled kernels: right at every gap, and what they cost."""

import importlib
import shutil

import numpy as np
import pytest
import reference
from kernels import CLAMP, Kernels, every_energy
from mpmath import mp

from variform.forms.operators.evaluate import evaluate
from variform.forms.operators.jets import Kind


@pytest.mark.parametrize("size", [1.0, 1e-3, 0.0])
def test_sum_quotient_is_bounded_by_the_clamp(kernels, rng, size):
    """Where s_2 + s_3 = 0, ARAP's twist eigenvalue is -4 mu over 1e-6 min(|F|, 1), not below."""
    R, Q = reference.rotation(rng, 3), reference.rotation(rng, 3)
    s = np.array([1, 0.5, -0.5]) * size
    A = kernels.evaluate(reference.arap, np.array([R @ np.diag(s) @ Q, np.diag(s)]))[2]
    least = np.linalg.eigvalsh(A.reshape(-1, 9, 9))[:, 0]
    bound = -4 * reference.MU / (CLAMP * max(size, CLAMP))
    assert least == pytest.approx(bound, rel=1e-5)
    # Rank 1 and less: every sum of two stretches vanishes somewhere, none divides by zero.
    lines = size * R[:, :1] * Q[:1]
    assert np.isfinite(kernels.evaluate(reference.fixed_corotated, lines)[2]).all()


@pytest.mark.parametrize("psi_hat", [reference.hencky, reference.extended])
def test_difference_quotient_at_every_gap(kernels, rng, psi_hat):
    """D = (psi_1 - psi_2) / (s_1 - s_2) for gaps 1e-16 to 0.3 around 1/2, where `extended` jumps.

    The jump is anywhere in the gap, down to 1e-8 of it from its ends; s = F is exact here.
    """

    def slope(x, lnJ):
        if psi_hat is reference.hencky:
            return (2 * reference.MU * mp.log(x) + reference.LMBDA * lnJ) / x
        return reference.MU * (x - 4 + 16 * (x - 0.5) if x < 0.5 else x - x**-2)

    gap, part = 10 ** rng.uniform(-16, -0.5, 2000), 10 ** rng.uniform(-8, 0, 2000)
    part = np.where(rng.random(2000) < 0.5, part, 1 - part)
    # Here the jump and the curvature of psi_11 change its value at the end by opposite amounts.
    gap[:200] = 10 ** rng.uniform(-6.6, -6.2, 200)
    part[:200] = 1 - rng.uniform(1.9, 2.2, 200) * gap[:200]
    F = np.zeros((2000, 3, 3))
    F[:, 0, 0], F[:, 1, 1], F[:, 2, 2] = 0.5 + part * gap, 0.5 - (1 - part) * gap, 0.4 - 0.3 * part
    A = kernels.evaluate(psi_hat, F)[2]
    with mp.workdps(50):
        for s, a in zip(F.diagonal(axis1=1, axis2=2).tolist(), A, strict=True):
            x, y, lnJ = mp.mpf(s[0]), mp.mpf(s[1]), mp.log(mp.mpf(s[0]) * s[1] * s[2])
            if x > y:
                exact = float((slope(x, lnJ) - slope(y, lnJ)) / (x - y))
                error = abs(a[0, 1, 0, 1] + a[0, 1, 1, 0] - exact) / np.abs(a).max()
                assert error < 1e-13, f"{error:.1e} at {s}"


def test_difference_quotient_survives_a_jump_of_the_second_derivative(kernels):
    """Of psi_hat = sum (s - 1)_+^2, no rule can integrate a jump: D is as good as the division."""
    jump = lambda s, f: sum(f.where(x, 1, 0 * x, (x - 1) ** 2) for x in s)  # noqa: E731
    for gap in 1e-2, 1e-5, 1e-8:
        A = kernels.evaluate(jump, np.diag([1 + gap, 1 - gap, 0.5]))[2]
        assert A[0, 1, 0, 1] + A[0, 1, 1, 0] == pytest.approx(1, abs=1e-14 + 4e-16 / gap)


def diagonals(*s):
    """Diagonal matrices of the columns s."""
    s = np.stack(np.broadcast_arrays(*s), axis=-1)
    return s[:, None] * np.eye(s.shape[1])


# Evaluations beside the state's own while the pair's gap is in a decade: what the kernels promise.
SIMPSON, LOBATTO, GAUSS = 1, 2, 6
DECADES = {(-14, -8): SIMPSON, (-7, -4): LOBATTO, (-3, -1.2): GAUSS, (-1, -0.5): 0}


@every_energy
def test_evaluations_of_a_difference_quotient(kernels, rng, psi_hat):
    """D at a gap above 0.1 or at rest costs none, below 1e-8 one, below 1e-4 two, else six.

    A rule that were wrong would never repeat the one before, and only cost time: the next is taken.
    For polynomials of up to fourth order two evaluations are enough at every gap.
    """
    quartic = [reference.fixed_corotated, reference.corotated_linear, reference.arap]
    quartic.append(reference.saint_venant_kirchhoff)
    assert (kernels.calls(psi_hat, np.eye(3)[None]) == 1).all()
    for decades, most in DECADES.items():
        gap = 10 ** rng.uniform(*decades, 50)
        calls = kernels.calls(psi_hat, diagonals(1 + gap, 1, 0.4))
        assert calls.max() <= 1 + (min(most, LOBATTO) if psi_hat in quartic else most), decades


@pytest.mark.parametrize(
    "psi_hat", [e for e, kind in reference.ENERGIES.items() if kind.smooth and kind.inverted]
)
def test_evaluations_of_a_sum_quotient(kernels, rng, psi_hat):
    """T of a smooth energy at s_2 + s_3 = gap costs as much as D at that gap."""
    for decades, most in DECADES.items():
        gap = 10 ** rng.uniform(*decades, 50)
        assert kernels.calls(psi_hat, diagonals(2, 1, gap - 1)).max() <= 1 + most, decades


def test_evaluations_where_a_derivative_jumps(kernels, rng):
    """Halving ends 2^-30 from a third derivative's jump, and after 79 halvings of five points each.

    A jump of the second derivative can only be divided: it takes all 79.
    """
    jump = lambda s, f: sum(f.where(x, 0.5, 0 * x, (x - 0.5) ** 2) for x in s)  # noqa: E731
    gap, part = 10 ** rng.uniform(-12, -1.3, 200), rng.random(200)
    F = diagonals(0.5 + part * gap, 0.5 - (1 - part) * gap, 0.2)
    assert kernels.calls(reference.extended, F).max() <= 3 + 5 * (1 + 2 * 35)
    assert kernels.calls(jump, F).max() <= 3 + 5 * (1 + 2 * 79)


def test_difference_quotient_where_the_jump_is_weak(kernels, rng):
    """ln^2 s + a (s - 1/2)_+^3 for a from 1e-10 to 30: two rules agree by chance at few states.

    D is right to 1e-13 of dP/dF but for 1 state in 200, and there to 1e-9.
    """

    def kink(s, f, a):
        return sum(f.ln(x) ** 2 + f.where(x, 0.5, 0 * x, a * (x - 0.5) ** 3) for x in s)

    n = 4000
    gap, part, a = 10 ** rng.uniform(-5, -1.5, n), rng.random(n), 10 ** rng.uniform(-10, 1.5, n)
    F = diagonals(0.5 + part * gap, 0.5 - (1 - part) * gap, 0.3)
    function = kernels.function(kink, 3, 1)
    numbers = np.hstack([F.reshape(n, 9), a[:, None]])
    (A,) = evaluate(Kind(function, (3, 3), False, False, CLAMP), numbers, (2,))
    errors = np.empty(n)
    with mp.workdps(40):
        for k in range(n):
            x, y = mp.mpf(F[k, 0, 0]), mp.mpf(F[k, 1, 1])
            rise = 2 * (mp.log(x) / x - mp.log(y) / y) + 3 * mp.mpf(a[k]) * (x - mp.mpf(0.5)) ** 2
            errors[k] = abs(A[k, 0, 1, 0, 1] + A[k, 0, 1, 1, 0] - float(rise / (x - y)))
    errors /= np.abs(A).max(axis=(1, 2, 3, 4))
    assert np.count_nonzero(errors > 1e-13) <= n // 200
    assert errors.max() < 1e-9


COUNTED = """static long swept;
long sweeps(void) { const long n = swept; swept = 0; return n; }
#define SWEEPS (swept++, 30)"""


def test_rotations_end_by_themselves(tmp_path, monkeypatch, rng):
    """Jacobi sweeps, the last of which finds nothing to do: at most 5 for random 3x3 matrices.

    4 with two columns; 9 for singular ones, one by one and in lockstep; never the bound of 30.
    """
    module = importlib.import_module("variform.forms.native.library")
    counting = shutil.copytree(module.SOURCE, tmp_path / "kernels")
    text = (counting / "svd.h").read_text()
    assert text.count("#define SWEEPS 30 ") == 1
    (counting / "svd.h").write_text(text.replace("#define SWEEPS 30 ", f"{COUNTED} "))
    monkeypatch.setattr(module, "SOURCE", counting)
    kernels = Kernels()
    kernels.ffi.cdef("long sweeps(void);")
    for shape, usual in {(3, 3): 5, (3, 2): 4, (2, 2): 4}.items():
        for label, F in reference.matrices(rng, *shape):
            for together in (1, 4) if shape == (3, 3) else (1,):
                most = 0
                for k in range(0, len(F), together):
                    kernels.lib.sweeps()
                    kernels.svd(F[k : k + together])
                    most = max(most, kernels.lib.sweeps())
                assert most <= (usual if label == "random" else 9), (label, shape, together)
