# SPDX-License-Identifier: MIT
"""Points and weights of document 003, (58): integrals are sum_i W_i f(xi_i).

Simplex rules are symmetric and no tensor products; those of the cube and square are. The weights
add up to the size of the reference cell: 1/6 and 1/2, 8 and 4.
"""

from __future__ import annotations

from itertools import permutations, product
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

# Orbits (barycentric coordinates of one point, weight of each of its images as part of the size).
_ROOT15 = np.sqrt(15)
_TRIANGLE = {
    1: [((1 / 3, 1 / 3, 1 / 3), 1.0)],
    2: [((2 / 3, 1 / 6, 1 / 6), 1 / 3)],
    5: [  # Radon's 7 points
        ((1 / 3, 1 / 3, 1 / 3), 9 / 40),
        (((9 + 2 * _ROOT15) / 21, *2 * [(6 - _ROOT15) / 21]), (155 - _ROOT15) / 1200),
        (((9 - 2 * _ROOT15) / 21, *2 * [(6 + _ROOT15) / 21]), (155 + _ROOT15) / 1200),
    ],
}
_ROOT5 = np.sqrt(5)
_TETRAHEDRON = {
    1: [((1 / 4, 1 / 4, 1 / 4, 1 / 4), 1.0)],
    2: [(((5 + 3 * _ROOT5) / 20, *3 * [(5 - _ROOT5) / 20]), 1 / 4)],
    5: [  # Keast's 15 points
        ((1 / 4, 1 / 4, 1 / 4, 1 / 4), 16 / 135),
        (((13 + 3 * _ROOT15) / 34, *3 * [(7 - _ROOT15) / 34]), (2665 + 14 * _ROOT15) / 37800),
        (((13 - 3 * _ROOT15) / 34, *3 * [(7 + _ROOT15) / 34]), (2665 - 14 * _ROOT15) / 37800),
        ((*2 * [(10 - 2 * _ROOT15) / 40], *2 * [(10 + 2 * _ROOT15) / 40]), 10 / 189),
    ],
}


def tetrahedron(degree: int) -> tuple[Array, Array]:
    """Points (q, 3) and weights (q,) exact for polynomials of a degree: q = 1, 4 or 15.

    Raises:
        ValueError: degree above 5.
    """
    return _simplex(_TETRAHEDRON, degree, 1 / 6)


def triangle(degree: int) -> tuple[Array, Array]:
    """Points (q, 2) and weights (q,) exact for polynomials of a degree: q = 1, 3 or 7.

    Raises:
        ValueError: degree above 5.
    """
    return _simplex(_TRIANGLE, degree, 1 / 2)


def hexahedron(n: int) -> tuple[Array, Array]:
    """Points (n^3, 3) and weights of the Gauss rule on [-1, 1]^3, exact to degree 2n - 1 in each.

    For n = 2 all weights are 1.
    """
    return _gauss(n, 3)


def square(n: int) -> tuple[Array, Array]:
    """Points (n^2, 2) and weights of the Gauss rule on [-1, 1]^2, as :func:`hexahedron`."""
    return _gauss(n, 2)


def _simplex(rules: dict[int, Any], degree: int, size: float) -> tuple[Array, Array]:
    found = [rule for d, rule in rules.items() if d >= degree]
    if not found:
        raise ValueError(f"(58): the rules of simplices reach degree {max(rules)}, got {degree}.")
    points, weights = [], []
    for place, weight in found[0]:
        images = sorted(set(permutations(place)))
        points += [image[1:] for image in images]
        weights += len(images) * [weight * size]
    return np.array(points), np.array(weights)


def _gauss(n: int, dim: int) -> tuple[Array, Array]:
    if n < 1:
        raise ValueError(f"(58): a Gauss rule has at least one point in each direction, got {n}.")
    x, w = np.polynomial.legendre.leggauss(n)
    weights = [np.prod(ws) for ws in product(w, repeat=dim)]
    return np.array(list(product(x, repeat=dim))), np.array(weights)
