# SPDX-License-Identifier: MIT
"""B3: stress and tangent of fixed corotated at states where its singular value decomposition hurts.

psi = mu sum_i (s_i - 1)^2 + lmbda/2 (J - 1)^2, s3 with the sign of J. ``python3 -m
demos.benchmarks.peers.points WAY…`` scores ways, each in the environment of its library: stress and
tangent are right (to 1e-5), wrong (finite) or NaN. What is right is found by differences of psi
itself; rank 1 and zero, where psi has kinks, have no right value and are scored finite or NaN.
"""

import json
import sys
import time

import numpy as np

from .problem import LMBDA, MU
from .ways import WAYS

RIGHT = 1e-5
STEP = 1e-3


def rotation(seed):
    """A random rotation."""
    Q, R = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    Q = Q * np.sign(np.diag(R))
    return Q * np.linalg.det(Q)


def states():
    """Deformation gradients by name."""
    U, V = rotation(1), rotation(2)

    def turned(*s):
        return U @ np.diag(s) @ V.T

    return {
        "generic": turned(1.3, 0.9, 0.6),
        "identity": np.eye(3),
        "rotation": rotation(3),
        "two equal, rotated": turned(1.4, 1.4, 0.7),
        "two equal, diagonal": np.diag([1.4, 1.4, 0.7]),
        "singular, rotated": turned(1.2, 0.8, 0.0),
        "singular, diagonal": np.diag([1.2, 0.8, 0.0]),
        "inverted": turned(1.2, 0.9, -0.5),
        "rank 1": turned(1.2, 0.0, 0.0),
        "zero": np.zeros((3, 3)),
    }


def energy(F):
    """Energy of gradients (..., 3, 3), from singular values alone."""
    s, J = np.linalg.svd(F, compute_uv=False), np.linalg.det(F)
    s[..., 2] *= np.where(J < 0, -1, 1)
    return MU * ((s - 1) ** 2).sum(-1) + LMBDA / 2 * (J - 1) ** 2


def derivative(function):
    """Derivative of a function of gradients by differences of fourth order."""

    def differences(F):
        moved = STEP * np.eye(9).reshape(9, 3, 3)
        parts = [
            weight * function(F[..., None, :, :] + shift * moved)
            for shift, weight in ((-2, 1 / 12), (-1, -2 / 3), (1, 2 / 3), (2, -1 / 12))
        ]
        return sum(parts) / STEP

    return differences


def right_values(F):
    """Stress (9,) and tangent (9, 9) by differences of the energy."""
    stress = derivative(energy)
    return stress(F), derivative(stress)(F)


def score(found, right):
    """One word on one result."""
    if not np.all(np.isfinite(found)):
        return "NaN"
    if right is None:
        return "finite"
    error = np.abs(found - right).max() / max(1, np.abs(right).max())
    return "right" if error < RIGHT else "wrong"


def row(way, both, count):
    """Scores of a way at every state, and its points per second."""
    result = {"way": way}
    for name, F in states().items():
        with np.errstate(all="ignore"):
            found = [np.asarray(part, dtype=float)[0] for part in both(F[None])]
        smooth = name not in ("rank 1", "zero")
        right = [part.ravel() for part in right_values(F)] if smooth else [None, None]
        words = [score(f.ravel(), r) for f, r in zip(found, right, strict=True)]
        result[name] = " / ".join(words)
    F = np.eye(3) + 0.3 * np.random.default_rng(0).normal(size=(count, 3, 3))
    times = []
    with np.errstate(all="ignore"):
        both(F)
        for _ in range(3):
            start = time.process_time()
            both(F)
            times.append(time.process_time() - start)
    return result | {"points per second": round(count / float(np.median(times)))}


def main(names):
    """Print a JSON row for each way."""
    for name in names:
        make, count = WAYS[name]
        for way, both in make().items():
            print(json.dumps(row(way, both, count)), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:] or WAYS)
