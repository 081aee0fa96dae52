# SPDX-License-Identifier: MIT
"""Laws of interval bounds: no value inside a box is outside them, and points have no width."""

from mpi4py import MPI

import numpy as np
import pytest
import ufl

from variform import forms, meshes
from variform.forms.intervals import Intervals

BODY = meshes.block(MPI.COMM_SELF, (1.0, 1.0, 1.0), n=1)
X = ufl.SpatialCoordinate(BODY.mesh)
T = forms.load_factor(BODY, 0.3)
V = ufl.variable(X)


def _root(x):
    return np.sqrt((x * x).sum(axis=1))


EXPRESSIONS = {
    "length": (ufl.sqrt(ufl.dot(X, X)), _root),
    "polynomial": (
        X[0] * X[1] - T * X[2] ** 3 - X[0] ** 2,
        lambda x: x[:, 0] * x[:, 1] - 0.3 * x[:, 2] ** 3 - x[:, 0] ** 2,
    ),
    "quotient": (
        ufl.exp(X[0]) / (1 + X[1] ** 2) + X[2] ** -2,
        lambda x: np.exp(x[:, 0]) / (1 + x[:, 1] ** 2) + x[:, 2] ** -2,
    ),
    "circular": (
        ufl.sin(9 * X[0]) * ufl.cos(5 * X[1]) + ufl.tan(X[2]) - ufl.acos(X[0]),
        lambda x: (
            np.sin(9 * x[:, 0]) * np.cos(5 * x[:, 1]) + np.tan(x[:, 2]) - np.arccos(x[:, 0])
        ),
    ),
    "hyperbolic": (
        ufl.cosh(X[0]) + ufl.sinh(X[1]) - ufl.tanh(X[2]) + ufl.atan(X[0]) + ufl.asin(X[1]),
        lambda x: (
            np.cosh(x[:, 0])
            + np.sinh(x[:, 1])
            - np.tanh(x[:, 2])
            + np.arctan(x[:, 0])
            + np.arcsin(x[:, 1])
        ),
    ),
    "angle": (ufl.atan2(X[1], X[0]), lambda x: np.arctan2(x[:, 1], x[:, 0])),
    "pieces": (
        ufl.max_value(abs(X[0]) - 0.2, ufl.min_value(X[1], X[2])),
        lambda x: np.maximum(abs(x[:, 0]) - 0.2, np.minimum(x[:, 1], x[:, 2])),
    ),
    "branches": (
        ufl.conditional(
            ufl.And(ufl.lt(X[0], X[1]), ufl.Not(ufl.ge(X[2], 0.1))),
            X[2],
            ufl.conditional(ufl.Or(ufl.gt(X[0], 0.5), ufl.le(X[1], -0.5)), -X[0], X[1] ** 3),
        ),
        lambda x: np.where(
            (x[:, 0] < x[:, 1]) & (x[:, 2] < 0.1),
            x[:, 2],
            np.where((x[:, 0] > 0.5) | (x[:, 1] <= -0.5), -x[:, 0], x[:, 1] ** 3),
        ),
    ),
    "gradient": (
        ufl.diff(ufl.sqrt(ufl.dot(V, V)) * V[1], V)[2],
        lambda x: x[:, 2] * x[:, 1] / _root(x),
    ),
    "root": (
        abs(X[0]) ** 1.5 + ufl.ln(X[1] + 2),
        lambda x: abs(x[:, 0]) ** 1.5 + np.log(x[:, 1] + 2),
    ),
}


@pytest.mark.parametrize("name", EXPRESSIONS)
def test_bounds_contain_every_value(name, rng):
    """Boxes of any width: values at 50 points of each are inside; of a point both are its value."""
    expression, value = EXPRESSIONS[name]
    bounds = Intervals(expression, X, "it")
    low = rng.uniform(-1, 1, (500, 3))
    high = np.minimum(low + rng.uniform(0, 1, (500, 3)) * 10.0 ** -rng.integers(0, 4, (500, 1)), 1)
    a, b = bounds(low, high)
    narrow = 0
    for _ in range(50):
        x = low + rng.uniform(0, 1, low.shape) * (high - low)
        f = value(x)
        assert np.all(a <= f + 1e-12 * (1 + abs(f))) and np.all(f <= b + 1e-12 * (1 + abs(f)))
        same = bounds(x, x)
        assert same[0] == pytest.approx(f, rel=1e-12, abs=1e-12)
        assert np.array_equal(*same)
        narrow = max(narrow, np.sum(b - a < 1e-2 * (1 + abs(f))))
    assert narrow > 100  # and the bounds of narrow boxes are not all of the line


def test_constants_move():
    """A Constant takes an interval, too, each point its own."""
    bounds = Intervals(X[0] - 2 * T, X, "it")
    assert bounds.constants == [T]
    x = np.zeros((2, 3))
    low, high = bounds(x, x, {T: (np.array([0.0, 1.0]), np.array([0.5, 3.0]))})
    assert low.tolist() == [-1.0, -6.0] and high.tolist() == [0.0, -2.0]
    assert bounds(x, x)[0].tolist() == [-0.6, -0.6]


def test_what_is_no_function_of_the_place_is_refused():
    """A field of the body, and a function without bounds, one sentence each."""
    u = forms.displacement(BODY)
    with pytest.raises(ValueError, match=r"a wall is a function of the place x.* got displacement"):
        Intervals(X[0] - u[0], X, "a wall")
    with pytest.raises(ValueError, match=r"a wall is a function of the place x.*\(BesselJ\)"):
        Intervals(ufl.bessel_J(0, X[0]), X, "a wall")
