# SPDX-License-Identifier: MIT
"""Energy, stress and tangent of an isotropic energy to more digits than a double holds.

Nothing of what the kernels use is used here: no singular vectors, no derivative of psi_hat, no
quotient. The energy psi(F) = psi_hat(s(F)) is differentiated by central differences, with s(F) from
the roots of the characteristic polynomial of F^T F. Beside it: energies, written once for mpmath
and UFL, and states of every class at which they are compared.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from mpmath import mp, mpf
from numpy.typing import NDArray

# Truncation is STEP^2 times a ratio of derivatives, at most 1e-34 for states 1e-8 from a
# singularity; rounding is 10^-DIGITS / STEP^2 times at most 1e32 (badly scaled states).
DIGITS = 110
STEP = mpf(10) ** -25

MU, LMBDA = 1.3, 2.1

# What an energy may call besides arithmetic, here in mpmath; tests have the same for UFL.
MP = SimpleNamespace(ln=mp.log, where=lambda x, y, below, above: below if x < y else above)


def _stretches_2(F: list[list[Any]], improper: bool) -> list[Any]:
    """Of a matrix with two columns, by (s1 +- s2)^2 = tr C +- 2 sqrt(det C)."""
    square = sum(x * x for row in F for x in row)
    if len(F) == 2:
        J = F[0][0] * F[1][1] - F[0][1] * F[1][0]
    else:
        a, b = ([row[k] for row in F] for k in (0, 1))
        J = mp.sqrt(sum((a[i - 2] * b[i - 1] - a[i - 1] * b[i - 2]) ** 2 for i in range(3)))
    total, gap = mp.sqrt(square + 2 * abs(J)), mp.sqrt(max(square - 2 * abs(J), 0))
    s1 = (total + gap) / 2
    return [s1, (abs(J) if improper else J) / s1]


def _stretches_3(F: list[list[Any]], improper: bool) -> list[Any]:
    """Of a 3x3 matrix, by Viete's trigonometric roots; the last has the sign of det F."""
    (a, b, c), (d, e, f), (g, h, i) = F
    J = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
    xx, yy, zz = a * a + d * d + g * g, b * b + e * e + h * h, c * c + f * f + i * i
    xy, xz, yz = a * b + d * e + g * h, a * c + d * f + g * i, b * c + e * f + h * i
    mean = (xx + yy + zz) / 3
    xx, yy, zz = xx - mean, yy - mean, zz - mean
    p = mp.sqrt((xx * xx + yy * yy + zz * zz + 2 * (xy * xy + xz * xz + yz * yz)) / 6)
    if p == 0:
        s1 = s2 = mp.sqrt(mean)
    else:
        det = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
        angle = mp.acos(max(min(det / (2 * p * p * p), 1), -1)) / 3
        cosine, sine = mp.cos_sin(angle)
        s1 = mp.sqrt(mean + 2 * p * cosine)
        s2 = mp.sqrt(mean + p * (mp.sqrt(3) * sine - cosine))
    return [s1, s2, (abs(J) if improper else J) / (s1 * s2)]


def stretches(F: list[list[Any]], improper: bool = False) -> list[Any]:
    """Singular values, largest first, the last with the sign of det F unless improper."""
    return (_stretches_3 if len(F[0]) == 3 else _stretches_2)(F, improper)


def derivatives(
    psi_hat: Callable[..., Any], F: NDArray[np.float64], improper: bool = False
) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
    """W, P = dpsi/dF and A = d2psi/dF2 at F, rounded to double.

    Args:
        psi_hat: Energy psi_hat(s, functions) of the list of stretches; functions as in MP.
        F: Operand, shape (3, 3), (2, 2) or (3, 2).
        improper: All stretches >= 0.

    Returns:
        W, P of F's shape, A[i, j, k, l] = dP_ij / dF_kl.
    """
    rows, cols = F.shape
    with mp.workdps(DIGITS):
        state = [mpf(float(x)) for x in F.ravel()]
        step = STEP * mpf(float(np.abs(F).max()))

        def energy(*moves: tuple[int, int]) -> Any:
            x = list(state)
            for k, sign in moves:
                x[k] = x[k] + sign * step
            return psi_hat(
                stretches([x[cols * r : cols * (r + 1)] for r in range(rows)], improper), MP
            )

        n = rows * cols
        W = energy()
        up, down = [energy((k, 1)) for k in range(n)], [energy((k, -1)) for k in range(n)]
        P = np.array([float((up[k] - down[k]) / (2 * step)) for k in range(n)])
        A = np.empty((n, n))
        for k in range(n):
            A[k, k] = float((up[k] + down[k] - 2 * W) / step**2)
            for m in range(k):
                both = energy((k, 1), (m, 1)) + energy((k, -1), (m, -1))
                mixed = both + 2 * W - up[k] - down[k] - up[m] - down[m]
                A[k, m] = A[m, k] = float(mixed / (2 * step**2))
        return float(W), P.reshape(F.shape), A.reshape(2 * F.shape)


def fixed_corotated(s: Any, f: Any) -> Any:
    return MU * sum((x - 1) ** 2 for x in s) + LMBDA / 2 * (math.prod(s) - 1) ** 2


def corotated_linear(s: Any, f: Any) -> Any:
    return MU * sum((x - 1) ** 2 for x in s) + LMBDA / 2 * sum(x - 1 for x in s) ** 2


def arap(s: Any, f: Any) -> Any:
    return MU * sum((x - 1) ** 2 for x in s)


def symmetric_dirichlet(s: Any, f: Any) -> Any:
    return MU * sum(x**2 + 1 / x**2 - 2 for x in s)


def hencky(s: Any, f: Any) -> Any:
    return MU * sum(f.ln(x) ** 2 for x in s) + LMBDA / 2 * f.ln(math.prod(s)) ** 2


def ogden(s: Any, f: Any) -> Any:
    isochoric = sum(0.5 * (x**1.3 - 1) + 0.2 * (x**-2 - 1) for x in s)
    return isochoric - 0.25 * f.ln(math.prod(s)) + LMBDA / 2 * (math.prod(s) - 1) ** 2


def stable_neo_hookean(s: Any, f: Any) -> Any:
    square, alpha = sum(x**2 for x in s), 1 + 0.75 * MU / LMBDA
    return MU / 2 * (square - f.ln(square + 1)) + LMBDA / 2 * (math.prod(s) - alpha) ** 2


def neo_hookean(s: Any, f: Any) -> Any:
    lnJ = f.ln(math.prod(s))
    return MU / 2 * sum(x**2 - 1 for x in s) - MU * lnJ + LMBDA / 2 * lnJ**2


def saint_venant_kirchhoff(s: Any, f: Any) -> Any:
    squares = sum(x**2 - 1 for x in s)
    return MU / 4 * sum((x**2 - 1) ** 2 for x in s) + LMBDA / 8 * squares**2


def extended(s: Any, f: Any) -> Any:
    """1/s below s = 1/2 by its Taylor polynomial: the third derivative jumps by 96."""
    inverse = (f.where(x, 0.5, 2 - 4 * (x - 0.5) + 8 * (x - 0.5) ** 2, 1 / x) for x in s)
    return MU * sum(x**2 / 2 + y - 1.5 for x, y in zip(s, inverse, strict=True))


def sheet(s: Any, f: Any) -> Any:
    """Incompressible neo-Hookean sheet; even in each stretch."""
    return MU / 2 * (s[0] ** 2 + s[1] ** 2 + 1 / (s[0] * s[1]) ** 2 - 3)


class Kind(NamedTuple):
    """What a test has to know about an energy.

    smooth: psi_hat(-s_i, -s_j) = psi_hat(s). inverted: defined for s <= 0. singular: not at s = 0.
    terms: size of second derivatives that cancel in psi_hat itself, where F is small.
    """

    smooth: bool = False
    inverted: bool = False
    singular: bool = False
    terms: float = 0.0


ENERGIES = {
    fixed_corotated: Kind(inverted=True),
    corotated_linear: Kind(inverted=True),
    arap: Kind(inverted=True),
    symmetric_dirichlet: Kind(smooth=True, inverted=True, singular=True),
    hencky: Kind(singular=True),
    ogden: Kind(singular=True),
    stable_neo_hookean: Kind(smooth=True, inverted=True, terms=MU),
    neo_hookean: Kind(smooth=True, singular=True),
    saint_venant_kirchhoff: Kind(smooth=True, inverted=True),
    extended: Kind(inverted=True),
}
SHEETS = {
    arap: Kind(),
    corotated_linear: Kind(),
    saint_venant_kirchhoff: Kind(smooth=True),
    sheet: Kind(smooth=True, singular=True),
    hencky: Kind(singular=True),
    extended: Kind(),
}


def rotation(rng: np.random.Generator, n: int) -> NDArray[np.float64]:
    """Random rotation of n dimensions."""
    Q, R = np.linalg.qr(rng.standard_normal((n, n)))
    Q = Q * np.sign(np.diag(R))
    Q[:, 0] *= np.linalg.det(Q)
    return Q


def states(
    rng: np.random.Generator, count: int, rows: int, cols: int, inverted: bool
) -> Iterator[tuple[str, NDArray[np.float64]]]:
    """`count` states of every class: (class, F)."""

    def turned(s):
        S = np.zeros((rows, cols))
        np.fill_diagonal(S, s)
        return rotation(rng, rows) @ S @ rotation(rng, cols)

    def gaps(n, least=-16.5):
        return 10 ** rng.uniform(least, -0.3, n)

    rest = np.eye(rows, cols)
    for _ in range(count):
        s = np.sort(rng.uniform(0.3, 2, cols))[::-1]
        signs = rng.choice([-1, 1], cols)
        yield "rest", rest
        yield "near rest", rest + gaps(1) * rng.standard_normal((rows, cols))
        yield "rotation", turned(np.ones(cols))
        yield "random", turned(s)
        yield "equal", turned(s[0])
        yield "two equal", turned(np.append(s[[0, 0]], s[-1])[:cols])
        yield "diagonal, nearly equal", rest * (1 + gaps(1) * np.arange(cols))
        yield "nearly equal", turned(1.1 * (1 + gaps(cols)))
        yield "around 1/2", turned(0.5 * (1 + gaps(cols) * signs))
        yield "scaled", turned(10 ** rng.uniform(-8, 8) * s)
        yield "mixed", turned(10 ** rng.uniform(-4, 4) * 10 ** rng.uniform(-1, 1, cols))
        if inverted:
            yield "inverted", turned(s * [*[1] * (cols - 1), -1])
            yield "flat", turned([*s[:-1], 0])
            yield "thin", turned([*s[:-1], 10 ** rng.uniform(-12, -1) * signs[0]])
            yield "mirrored", turned([*s[:-1], -s[-2] * (1 - gaps(1)[0])])


def matrices(
    rng: np.random.Generator, rows: int, cols: int, n: int = 300
) -> Iterator[tuple[str, NDArray[np.float64]]]:
    """Matrices that break a careless SVD: (class, n x rows x cols)."""
    shape = n, rows, cols
    F = rng.standard_normal(shape)
    near = F.copy()
    near[:, :, 1] = near[:, :, 0] * 10 ** rng.uniform(-200, 0, (n, 1))
    below = F.copy()
    below[:, 0] = below[:, 1] * 10 ** rng.uniform(-200, -10, (n, 1))
    lines = rng.standard_normal((n, rows, 1)) * rng.standard_normal((n, 1, cols))
    planes = rng.standard_normal((n, rows, 2)) @ rng.standard_normal((n, 2, cols))
    yield "random", F
    yield "states", np.array([F for _, F in states(rng, n // 10, rows, cols, True)])
    yield "zeros", F * (rng.random(shape) < 0.5)
    yield "signs", rng.integers(-1, 2, shape).astype(float)
    yield "rank 1", lines
    yield "rank 2", planes
    yield "second column a remnant", near
    yield "first row a remnant", below
    yield "columns 1e-100 to 1", F * 10 ** rng.uniform(-100, 0, (n, 1, cols))
    for decades in (20, 150, 300):
        yield f"entries 1e+-{decades}", F * 10 ** rng.uniform(-decades, decades, shape)
    for decades in (-300, -31, -29, 29, 31, 300):
        yield f"scaled 1e{decades}", F * 10.0**decades
