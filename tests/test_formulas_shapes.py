# SPDX-License-Identifier: MIT
"""Shape functions, faces and quadrature rules of the hand-written elements."""

from itertools import product
from math import factorial, prod

import basix
import basix.ufl
import numpy as np
import pytest
from cases import agree
from elements import KINDS, basix_order, distorted, every_cell
from materials import H

from variform.forms.formulas import element as fe
from variform.forms.formulas import quadrature, shapes


@pytest.mark.capability(69)
@every_cell
def test_shape_functions_interpolate(cell, rng):
    """N_a(xi_b) = d_ab, and polynomials of the element's degree are reproduced."""
    nodes, points = shapes.NODES[cell], rng.uniform(0, 0.3, size=(5, 3))
    agree(shapes.shape_functions(cell, nodes), np.eye(len(nodes)), 15)
    degree = {"tet4": 1, "tet10": 2, "hex8": 1, "hex27": 2}[cell]
    powers = [p for p in product(range(degree + 1), repeat=3) if cell[0] == "h" or sum(p) <= degree]
    assert len(powers) == len(nodes)
    for p in powers:
        found = shapes.shape_functions(cell, points) @ np.prod(nodes ** list(p), axis=-1)
        agree(found, np.prod(points ** list(p), axis=-1), 14)


@pytest.mark.capability(69)
@every_cell
def test_gradients_are_the_derivatives(cell, rng):
    """dN_a/dxi by complex steps, and sum_a dN_a/dxi = 0."""
    points = rng.uniform(-0.5, 0.5, size=(4, 5, 3))
    found = shapes.shape_gradients(cell, points)
    for j, e in enumerate(np.eye(3)):
        step = np.imag(shapes.shape_functions(cell, points + 1j * H * e)) / H
        agree(found[..., j], step, 14)
    assert np.abs(found.sum(axis=-2)).max() < 1e-14


@pytest.mark.capability(69)
@every_cell
def test_shape_functions_are_those_of_basix(cell, rng):
    """Values and gradients of the Lagrange element, our cube being twice as long."""
    kind, degree = KINDS[cell]
    e = basix.create_element(basix.ElementFamily.P, getattr(basix.CellType, kind), degree)
    points, order = rng.uniform(0, 0.3, size=(6, 3)), basix_order(cell)
    table = e.tabulate(1, points)[..., order, 0]
    ours, scale = (points, 1) if cell[0] == "t" else (2 * points - 1, 2)
    agree(shapes.shape_functions(cell, ours), table[0], 13)
    agree(scale * shapes.shape_gradients(cell, ours), np.moveaxis(table[1:], 0, -1), 13)


@pytest.mark.capability(77)
@pytest.mark.digits(13)
@every_cell
def test_faces_close_the_element(cell):
    """Over all faces of a distorted element int n da = 0 and 1/3 int x . n da = volume."""
    X = distorted(cell)
    points, weights = quadrature.square(4) if cell[0] == "h" else quadrature.triangle(5)
    area, volume = np.zeros(3), 0.0
    for facet, corners in enumerate(shapes.FACETS[cell]):
        xi, tangents = shapes.facet_map(cell, facet, points)
        N, dN = shapes.shape_functions(cell, xi), shapes.shape_gradients(cell, xi)
        others = [
            a
            for a in range(len(shapes.NODES[cell][: 4 if cell[0] == "t" else 8]))
            if a not in corners
        ]
        if cell in ("tet4", "hex8"):
            assert np.abs(N[:, others]).max() < 1e-15
        n_da = fe.surface_element(dN, X, tangents) * weights[:, None]
        area += n_da.sum(axis=0)
        volume += np.sum(fe.interpolate(N, X) * n_da) / 3
    rule = quadrature.hexahedron(4) if cell[0] == "h" else quadrature.tetrahedron(5)
    _, det = fe.gradients(shapes.shape_gradients(cell, rule[0]), X)
    assert np.abs(area).max() < 1e-14 * 24
    assert volume == pytest.approx(det @ rule[1], rel=1e-13)


@pytest.mark.capability(77)
@every_cell
def test_faces_lie_between_their_corners(cell):
    """The face's map takes its corners to those of the cell, and has the tangents it returns."""
    ends = [[0, 0], [1, 0], [0, 1]] if cell[0] == "t" else [[-1, -1], [1, -1], [1, 1], [-1, 1]]
    for facet, corners in enumerate(shapes.FACETS[cell]):
        xi, tangents = shapes.facet_map(cell, facet, ends)
        agree(xi, shapes.NODES[cell][list(corners)], 15)
        along = [shapes.facet_map(cell, facet, e)[0] for e in np.eye(2)]
        agree(along - shapes.facet_map(cell, facet, np.zeros(2))[0], tangents, 15)


@pytest.mark.capability(78)
@pytest.mark.digits(14)
@pytest.mark.parametrize(
    ("rule", "argument", "points"),
    [
        *[("tetrahedron", degree, q) for degree, q in ((0, 1), (1, 1), (2, 4), (3, 15), (5, 15))],
        *[("triangle", degree, q) for degree, q in ((1, 1), (2, 3), (4, 7), (5, 7))],
    ],
)
def test_simplex_rules_are_exact(rule, argument, points):
    """Integrals of x^i y^j z^k are i! j! k! / (i + j + k + dim)! up to the degree, not above."""
    xi, w = getattr(quadrature, rule)(argument)
    dim = xi.shape[1]
    assert len(w) == points

    def worst(degree):
        errors = []
        for p in product(range(degree + 1), repeat=dim):
            if sum(p) == degree:
                exact = prod(map(factorial, p)) / factorial(degree + dim)
                errors.append(abs(w @ np.prod(xi ** list(p), axis=-1) / exact - 1))
        return max(errors)

    reached = {1: 1, 3: 2, 4: 2, 7: 5, 15: 5}[points]
    assert all(worst(d) < 1e-14 for d in range(reached + 1))
    assert worst(reached + 1) > 1e-3


@pytest.mark.capability(78)
@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_gauss_rules_are_exact(n):
    """Products of powers up to 2n - 1 in each direction, not 2n."""
    for rule, dim in ((quadrature.square, 2), (quadrature.hexahedron, 3)):
        xi, w = rule(n)
        assert xi.shape == (n**dim, dim)

        def error(p, xi=xi, w=w):
            exact = prod(0 if k % 2 else 2 / (k + 1) for k in p)
            return abs(w @ np.prod(xi ** list(p), axis=-1) - exact)

        assert all(error(p) < 1e-14 for p in product(range(2 * n), repeat=dim))
        assert all(error(2 * n * e) > 1e-3 for e in np.eye(dim, dtype=int))
    if n == 2:
        agree(w, np.ones(8), 15)
