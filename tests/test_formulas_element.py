# SPDX-License-Identifier: MIT
"""Document 003, VI-VIII: elements by hand, what is misprinted, and the match with the UFL side."""

from itertools import product
from math import factorial, prod

from mpi4py import MPI

import basix
import basix.ufl
import numpy as np
import pytest
import ufl
from cases import ENERGIES, FIBER, LMBDA, MU, TRANSVERSE, agree, at_plane, off
from dolfinx import fem
from dolfinx import mesh as dmesh

from variform import forms
from variform.forms.formulas import elasticity as el
from variform.forms.formulas import element as fe
from variform.forms.formulas import materials as ma
from variform.forms.formulas import quadrature, shapes

H = 1e-40
CELLS = ("tet4", "tet10", "hex8", "hex27")
RULES = {
    "tet4": quadrature.tetrahedron(1),
    "tet10": quadrature.tetrahedron(2),
    "hex8": quadrature.hexahedron(2),
    "hex27": quadrature.hexahedron(3),
}
CONSTANTS = ma.transversely_isotropic_constants(**TRANSVERSE)
MATERIALS = {
    "neo_hookean": (
        lambda F: ma.neo_hookean(F, MU, LMBDA),
        lambda F: ma.neo_hookean_cauchy(F, MU, LMBDA),
        lambda F: ma.neo_hookean_elasticity(F, MU, LMBDA),
    ),
    "transversely_isotropic": (
        lambda F: ma.transversely_isotropic(F, FIBER, CONSTANTS),
        lambda F: ma.transversely_isotropic_cauchy(F, FIBER, CONSTANTS),
        lambda F: ma.transversely_isotropic_elasticity(F, FIBER, CONSTANTS),
    ),
}
every_cell = pytest.mark.parametrize("cell", CELLS)
every_material = pytest.mark.parametrize("name", MATERIALS)


def distorted(cell):
    """Nodes of an element that is not affine."""
    X = shapes.NODES[cell]
    return X + 0.05 * np.sin(7 * np.arange(X.size)).reshape(X.shape)


def moved(X):
    """Nodes after a motion that is not affine."""
    x, y, z = X.T
    motion = [x + 0.2 * x * y, y + 0.15 * x - 0.1 * z**2, z + 0.25 * x * z - 0.1 * y]
    return np.stack(motion, axis=-1)


class State:
    """Everything at the points of one deformed element."""

    def __init__(self, cell, rule=None, x=None):
        self.points, self.weights = rule or RULES[cell]
        self.X = distorted(cell)
        self.x = moved(self.X) if x is None else x
        self.N, dN = (
            shapes.shape_functions(cell, self.points),
            shapes.shape_gradients(cell, self.points),
        )
        self.G, self.det = fe.gradients(dN, self.x)
        self.G0, det0 = fe.gradients(dN, self.X)
        self.dv, self.dV = self.weights * self.det, self.weights * det0
        self.F = fe.deformation_gradient(self.x, self.G0)


# Shape functions and quadrature


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


@every_cell
def test_gradients_are_the_derivatives(cell, rng):
    """dN_a/dxi by complex steps, and sum_a dN_a/dxi = 0."""
    points = rng.uniform(-0.5, 0.5, size=(4, 5, 3))
    found = shapes.shape_gradients(cell, points)
    for j, e in enumerate(np.eye(3)):
        step = np.imag(shapes.shape_functions(cell, points + 1j * H * e)) / H
        agree(found[..., j], step, 14)
    assert np.abs(found.sum(axis=-2)).max() < 1e-14


def basix_order(cell, mirrored=False):
    """Number in basix's order of each of our nodes, by their places.

    basix counts the corners of the cube [0, 1]^3 row by row, where we go around the faces, and has
    the edges of the tetrahedron in another order. ``mirrored``: x and y of our cell exchanged.
    """
    kind, degree = KINDS[cell]
    e = basix.create_element(basix.ElementFamily.P, getattr(basix.CellType, kind), degree)
    places = shapes.NODES[cell] if cell[0] == "t" else (shapes.NODES[cell] + 1) / 2
    places = places[:, [1, 0, 2]] if mirrored else places
    distance = np.abs(places[:, None] - e.points[None]).max(axis=-1)
    assert np.sum(distance < 1e-12) == len(places)
    return np.argmin(distance, axis=1)


KINDS = {
    "tet4": ("tetrahedron", 1),
    "tet10": ("tetrahedron", 2),
    "hex8": ("hexahedron", 1),
    "hex27": ("hexahedron", 2),
}


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


@every_cell
def test_faces_lie_between_their_corners(cell):
    """The face's map takes its corners to those of the cell, and has the tangents it returns."""
    ends = [[0, 0], [1, 0], [0, 1]] if cell[0] == "t" else [[-1, -1], [1, -1], [1, 1], [-1, 1]]
    for facet, corners in enumerate(shapes.FACETS[cell]):
        xi, tangents = shapes.facet_map(cell, facet, ends)
        agree(xi, shapes.NODES[cell][list(corners)], 15)
        along = [shapes.facet_map(cell, facet, e)[0] for e in np.eye(2)]
        agree(along - shapes.facet_map(cell, facet, np.zeros(2))[0], tangents, 15)


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


# VI. Linearized equilibrium


@pytest.fixture
def directions(rng):
    return rng.normal(size=(2, 27, 3))


@every_material
@every_cell
def test_works_and_their_linearizations(cell, name, directions):
    """(29) = (52) = dv . T;  (32) = (34) = dv . K u;  (33) point by point;  (36) symmetry."""
    psi, sigma, c = MATERIALS[name]
    s = State(cell)
    v, u = (d[: len(s.X)] for d in directions)
    grad_v, grad_u = fe.velocity_gradient(v, s.G), fe.velocity_gradient(u, s.G)
    grad0_v, grad0_u = fe.velocity_gradient(v, s.G0), fe.velocity_gradient(u, s.G0)
    sig, cc = sigma(s.F), c(s.F)
    S, CC = el.pull_back(sig, s.F), el.pull_back_elasticity(cc, s.F)

    def energy(x):
        return np.sum(psi(State(cell, x=x).F) * s.dV)

    work = np.imag(energy(s.x + 1j * H * v)) / H
    agree(fe.internal_work(S, el.strain_derivative(s.F, grad0_v), s.dV), work, 11)
    none = np.zeros((1, 3))
    spatial = fe.virtual_work(
        sig, fe.small_strain(grad_v), s.dv, none, none, none, none, np.ones(1)
    )
    agree(spatial, work, 11)

    def force(x):
        t = State(cell, x=x)
        return fe.internal_force(sigma(t.F), t.G, t.dv)

    stiffness = np.sum(v * np.imag(force(s.x + 1j * H * u)) / H)
    agree(fe.linearized_material(S, CC, s.F, grad0_v, grad0_u, s.dV), stiffness, 11)
    agree(fe.linearized_spatial(sig, cc, grad_v, grad_u, s.dv), stiffness, 11)
    agree(fe.linearized_spatial(sig, cc, grad_u, grad_v, s.dv), stiffness, 11)

    DE_v, DE_u = el.strain_derivative(s.F, grad0_v), el.strain_derivative(s.F, grad0_u)
    first = np.einsum("qij,qijkl,qkl,q->q", DE_v, CC, DE_u, s.dV)
    dd, eps = fe.small_strain(grad_v), fe.small_strain(grad_u)
    agree(first, np.einsum("qij,qijkl,qkl,q->q", dd, cc, eps, s.dv), 11)
    second = np.einsum("qij,qki,qkj,q->q", S, grad0_u, grad0_v, s.dV)
    agree(second, np.einsum("qij,qki,qkj,q->q", sig, grad_u, grad_v, s.dv), 11)


# VII. Discretization


@every_cell
def test_kinematics_of_an_element(cell, directions):
    """(37)-(43): x, F and l of the mapped element, by complex steps along xi and along v."""
    s, v = State(cell), directions[0][: len(shapes.NODES[cell])]

    def place(nodes, xi):
        return fe.interpolate(shapes.shape_functions(cell, xi), nodes)

    def slope(nodes):
        columns = [np.imag(place(nodes, s.points + 1j * H * e)) / H for e in np.eye(3)]
        return np.stack(columns, axis=-1)

    agree(place(s.x, shapes.NODES[cell]), s.x, 15)
    F = slope(s.x) @ np.linalg.inv(slope(s.X))
    agree(s.F, F, 13)
    agree(s.det, np.linalg.det(slope(s.x)), 13)
    # F_dot F^-1 when the nodes move with v
    F_dot = np.imag(fe.deformation_gradient(s.x + 1j * H * v, s.G0)) / H
    L = F_dot @ np.linalg.inv(F)
    agree(fe.velocity_gradient(v, s.G), L, 13)
    agree(fe.virtual_velocity_gradient(v, s.G), L, 13)
    agree(fe.virtual_rate(v, s.G), el.rate_of_deformation(L), 13)
    agree(fe.small_strain(L), el.rate_of_deformation(L), 15)


def test_misprint_41(directions):
    """(41): sum dv_a (x) N_a is the virtual velocity, a vector, and no gradient."""
    s, v = State("tet10"), directions[0][:10]
    printed = fe.virtual_velocity_gradient(v, s.N, as_printed=True)
    assert printed.shape == (4, 3) and fe.virtual_velocity_gradient(v, s.G).shape == (4, 3, 3)
    agree(printed, np.einsum("qa,ai->qi", s.N, v), 15)


@every_cell
def test_strain_displacement_matrix(cell, directions):
    """(45)-(47): sum_a B_a u_a is the Voigt vector of sym grad u."""
    s, u = State(cell), directions[0][: len(shapes.NODES[cell])]
    found = np.einsum("qaIi,ai->qI", fe.strain_displacement(s.G), u)
    eps = el.rate_of_deformation(fe.velocity_gradient(u, s.G))
    agree(found, ma.voigt_strain(eps), 14)


@every_cell
def test_stiffness_of_two_nodes(cell, rng):
    """(44) = dv_a . K_c,ab u_b and (50) = dv_a . K_sigma,ab u_b for every pair of nodes."""
    s = State(cell)
    c = ma.transversely_isotropic_elasticity(s.F, FIBER, CONSTANTS)
    sigma = ma.transversely_isotropic_cauchy(s.F, FIBER, CONSTANTS)
    K_c = fe.constitutive_stiffness(s.G, ma.voigt_elasticity(c), s.dv)
    K_s = fe.initial_stress_stiffness(s.G, sigma, s.dv)
    v, u = rng.normal(size=(2, 3))
    for a, b in rng.integers(len(s.X), size=(6, 2)):
        G_a, G_b = s.G[:, a], s.G[:, b]
        wanted = v @ K_c[a, :, b] @ u
        assert fe.constitutive_work(v, G_a, c, u, G_b, s.dv) == pytest.approx(wanted, rel=1e-12)
        wanted = v @ K_s[a, :, b] @ u
        assert fe.initial_stress_work(v, G_a, sigma, u, G_b, s.dv) == pytest.approx(
            wanted, rel=1e-12
        )


def test_isotropic_matrix(rng):
    """(49) is the Voigt matrix of (19), with J = det F."""
    F = np.eye(3) + 0.1 * rng.normal(size=(4, 3, 3))
    found = fe.neo_hookean_matrix(np.linalg.det(F), MU, LMBDA)
    agree(found, ma.voigt_elasticity(ma.neo_hookean_elasticity(F, MU, LMBDA)), 14)
    assert fe.isotropic_matrix(2.0, 3.0).tolist() == [
        *([8, 2, 2, 0, 0, 0], [2, 8, 2, 0, 0, 0], [2, 2, 8, 0, 0, 0]),
        *([0, 0, 0, 3, 0, 0], [0, 0, 0, 0, 3, 0], [0, 0, 0, 0, 0, 3]),
    ]


def force(cell, sigma, x, rule=None):
    s = State(cell, rule, x)
    return fe.internal_force(sigma(s.F), s.G, s.dv)


@every_material
@every_cell
def test_force_and_tangent_are_derivatives(cell, name):
    """(55) is the derivative of int psi dV, (48) + (51) that of (55); the tangent is symmetric."""
    psi, sigma, c = MATERIALS[name]
    s = State(cell)
    n = len(s.X)
    T, K = np.empty((n, 3)), np.empty((n, 3, n, 3))
    for b, j in product(range(n), range(3)):
        e = np.zeros((n, 3))
        e[b, j] = 1
        x = s.x + 1j * H * e
        T[b, j] = np.imag(np.sum(psi(fe.deformation_gradient(x, s.G0)) * s.dV)) / H
        K[:, :, b, j] = np.imag(force(cell, sigma, x)) / H
    agree(force(cell, sigma, s.x), T, 12)
    found = fe.element_tangent(s.G, ma.voigt_elasticity(c(s.F)), sigma(s.F), s.dv)
    agree(found, K, 12)
    matrix = fe.element_matrix(found)
    agree(matrix, matrix.T, 14)
    agree(matrix[3:6, 6:9], found[1, :, 2], 15)


# VIII. Residual form


@every_cell
def test_virtual_work_is_that_of_the_residual(cell, directions):
    """(52)-(57): dv . (T - F) with a body force and a traction on one face, per present volume."""
    s = State(cell)
    v = directions[0][: len(s.X)]
    sigma = ma.neo_hookean_cauchy(s.F, MU, LMBDA)
    f = np.stack([0.3 + s.points[:, 0], s.points[:, 1] ** 2, -0.5 + 0 * s.dv], axis=-1)
    rule = quadrature.square(2) if cell[0] == "h" else quadrature.triangle(2)
    xi, tangents = shapes.facet_map(cell, 1, rule[0])
    N, dN = shapes.shape_functions(cell, xi), shapes.shape_gradients(cell, xi)
    da = rule[1] * np.linalg.norm(fe.surface_element(dN, s.x, tangents), axis=-1)
    t = np.stack([xi[:, 2], 0.2 + xi[:, 1], 0.7 + 0 * da], axis=-1)
    F = fe.external_force(s.N, f, s.dv) + fe.external_force(N, t, da)
    R = fe.residual(fe.internal_force(sigma, s.G, s.dv), F)
    dd = fe.virtual_rate(v, s.G)
    v_q, v_s = fe.interpolate(s.N, v), fe.interpolate(N, v)
    work = fe.virtual_work(sigma, dd, s.dv, f, v_q, t, v_s, da)
    assert np.sum(v * R) == pytest.approx(work, rel=1e-12)
    assert fe.element_vector(v) @ fe.element_vector(R) == pytest.approx(work, rel=1e-12)
    # all of the load arrives: sum_a F_a = int f dv + int t da
    agree(F.sum(axis=0), s.dv @ f + da @ t, 13)
    # sigma^ = D eps^ (27), (45): T_a = int B_a^T sigma^ dv
    B = fe.strain_displacement(s.G)
    T = np.einsum("qaIi,qI,q->ai", B, ma.voigt_stress(sigma), s.dv)
    agree(fe.internal_force(sigma, s.G, s.dv), T, 13)


@every_cell
def test_misprint_58_sum(cell):
    """(58): sum_a T_a vanishes whatever the stress is; the element's force is the stack of T_a."""
    T = force(cell, MATERIALS["neo_hookean"][1], State(cell).x)
    assert np.abs(fe.element_vector(T, as_printed=True)).max() < 1e-14 * np.abs(T).max()
    assert fe.element_vector(T).tolist() == [entry for row in T for entry in row]


@pytest.mark.parametrize(
    ("cell", "rule", "printed_error"),
    [
        ("tet4", quadrature.tetrahedron(2), 0.0),
        ("tet10", quadrature.tetrahedron(2), 0.2486),
        ("hex8", quadrature.hexahedron(2), 0.9188),
        ("hex8", quadrature.hexahedron(3), 0.92),
        ("hex27", quadrature.hexahedron(3), 1.0),
    ],
)
def test_misprint_58_stress_outside(cell, rule, printed_error):
    """(58): one stress (that of the center) in front of the sum is right for constant F alone."""
    s, sigma = State(cell, rule), MATERIALS["neo_hookean"][1]
    right = fe.quadrature_force(sigma(s.F), s.G, s.weights, s.det)
    agree(right, fe.internal_force(sigma(s.F), s.G, s.dv), 14)
    center = shapes.NODES[cell].mean(axis=0)[None]
    middle = State(cell, (center, np.ones(1)))
    printed = fe.quadrature_force(sigma(middle.F)[0], s.G, s.weights, s.det, as_printed=True)
    assert off(printed, right) == pytest.approx(printed_error, abs=1e-4)


def integrated(cell, rule, name="neo_hookean", as_printed=False):
    _, sigma, c = MATERIALS[name]
    X = distorted(cell)
    integrator = fe.Integrator(cell, X, moved(X), lambda F: (sigma(F), c(F)), as_printed)
    integrator.process(*rule)
    return integrator


@every_material
@every_cell
def test_points_gathered_one_by_one(cell, name):
    """(59), (60) with weights: force and stiffness equal (55), (48) + (51)."""
    _, sigma, c = MATERIALS[name]
    s = State(cell)
    found = integrated(cell, RULES[cell], name)
    agree(found.force, force(cell, sigma, s.x), 14)
    K = fe.element_tangent(s.G, ma.voigt_elasticity(c(s.F)), sigma(s.F), s.dv)
    agree(found.stiffness, K, 14)


@pytest.mark.parametrize(
    ("cell", "rule", "printed_error"),
    [
        ("tet10", quadrature.tetrahedron(2), 23.0),
        ("hex8", quadrature.hexahedron(2), 0.0),
        ("hex8", quadrature.hexahedron(3), 2.9965),
        ("hex27", quadrature.hexahedron(3), 2.2970),
    ],
)
def test_misprint_59(cell, rule, printed_error):
    """(59), (60): without W_i tet10 with 4 points is 24 times too large, hex8 with 2^3 is not."""
    right = integrated(cell, rule).force
    printed = integrated(cell, rule, as_printed=True).force
    assert off(printed, right) == pytest.approx(printed_error, abs=1e-3)


def test_jacobian_of_58_is_the_present_one():
    """(58), (59): with det J^(e) of the reference configuration the force is another."""
    s, sigma = State("tet10"), MATERIALS["neo_hookean"][1]
    T = fe.internal_force(sigma(s.F), s.G, s.dv)
    reference = fe.internal_force(sigma(s.F), s.G, s.dV)
    P = el.first_piola(el.pull_back(sigma(s.F), s.F), s.F)
    agree(fe.internal_force(P, s.G0, s.dV), T, 13)
    agree(s.dv, np.linalg.det(s.F) * s.dV, 13)
    assert off(reference, T) == pytest.approx(0.1168, abs=1e-4)


def test_assembly():
    """Two cells that share a node: sums at the shared node, nothing between the others."""
    cells = np.array([[0, 1], [1, 2]])
    T = np.arange(1.0, 13).reshape(2, 2, 3)
    found = fe.assemble_vector(T, cells, 3).reshape(3, 3)
    assert found.tolist() == [[1, 2, 3], [4 + 7, 5 + 8, 6 + 9], [10, 11, 12]]
    K = np.arange(1.0, 73).reshape(2, 2, 3, 2, 3)
    A = fe.assemble_matrix(K, cells, 3)
    agree(A[3:6, 3:6], K[0, 1, :, 1] + K[1, 0, :, 0], 15)
    agree(A[:3, 3:6], K[0, 0, :, 1], 15)
    agree(A[6:, 3:6], K[1, 1, :, 0], 15)
    assert np.abs(A[:3, 6:]).max() == np.abs(A[6:, :3]).max() == 0


# The match

LOAD = 0.03  # small enough for full Newton steps in four load steps


BODIES = {
    "tet4": ("tet4", False, 2),
    "tet10": ("tet10", False, 3),
    "tet10-curved": ("tet10", True, 4),
    "hex8": ("hex8", False, 3),
    "hex27": ("hex27", False, 5),
}


def body(cell, curved=False):
    """Two cubes of these cells; curved: geometry of order 2."""
    kind = getattr(dmesh.CellType, KINDS[cell][0])
    mesh = dmesh.create_box(MPI.COMM_SELF, [[0, 0, 0], [2, 1, 1]], [2, 1, 1], kind)
    if not curved:
        return mesh
    V = fem.functionspace(mesh, ("Lagrange", 2))
    cells, x = V.dofmap.list, V.tabulate_dof_coordinates()
    element = basix.ufl.element("Lagrange", KINDS[cell][0], 2, shape=(3,))
    return dmesh.create_mesh(MPI.COMM_SELF, cells=cells, x=x, e=ufl.Mesh(element))


def shake(mesh, rng):
    """Move all nodes of the geometry at random."""
    mesh.geometry.x[:] += rng.uniform(-0.04, 0.04, size=mesh.geometry.x.shape)


class ByHand:
    """The same body, loads and points without DOLFINx but for its node numbers and coordinates.

    Tetrahedra of DOLFINx may be inside out (it takes |det J|): their nodes are read mirrored, x and
    y of the reference cell exchanged, and so are the points of the rule.
    """

    def __init__(self, V, cell, degree):
        kind, _ = KINDS[cell]
        self.cell, self.X = cell, V.tabulate_dof_coordinates()
        points, weights = basix.make_quadrature(getattr(basix.CellType, kind), degree)
        face = basix.CellType.quadrilateral if cell[0] == "h" else basix.CellType.triangle
        face_points, face_weights = basix.make_quadrature(face, degree)
        if cell[0] == "h":  # [0, 1] -> [-1, 1]
            points, weights = 2 * points - 1, 8 * weights
            face_points, face_weights = 2 * face_points - 1, 4 * face_weights
        self.weights, self.face = weights, (face_points, face_weights)
        self.cells, self.points = [], []
        for dofs in V.dofmap.list:
            straight = dofs[basix_order(cell)]
            first = fe.jacobian(shapes.shape_gradients(cell, points[:1]), self.X[straight])
            mirrored = np.linalg.det(first)[0] < 0
            self.cells.append(dofs[basix_order(cell, mirrored)])
            self.points.append(points[:, [1, 0, 2]] if mirrored else points)
        self.cells, self.points = np.array(self.cells), np.array(self.points)
        self.N = shapes.shape_functions(cell, self.points)
        self.dN = shapes.shape_gradients(cell, self.points)
        self.G0, det0 = fe.gradients(self.dN, self.X[self.cells])
        self.dV = self.weights * det0

    def boundary(self):
        """Cell and face of each face that belongs to one cell alone."""
        faces = {}
        for i, nodes in enumerate(self.cells):
            for facet, corners in enumerate(shapes.FACETS[self.cell]):
                faces.setdefault(frozenset(nodes[list(corners)]), []).append((i, facet))
        return [owners[0] for owners in faces.values() if len(owners) == 1]

    def load(self, b, t):
        """F of dead loads: b per reference volume, t per reference area on all of the boundary."""
        X = fe.interpolate(self.N, self.X[self.cells])
        total = fe.assemble_vector(
            fe.external_force(self.N, b(X), self.dV), self.cells, len(self.X)
        )
        for i, facet in self.boundary():
            xi, tangents = shapes.facet_map(self.cell, facet, self.face[0])
            N, dN = shapes.shape_functions(self.cell, xi), shapes.shape_gradients(self.cell, xi)
            nodes = self.X[self.cells[i]]
            dA = self.face[1] * np.linalg.norm(fe.surface_element(dN, nodes, tangents), axis=-1)
            F = fe.external_force(N, t(fe.interpolate(N, nodes)), dA)
            total += fe.assemble_vector(F[None], self.cells[[i]], len(self.X))
        return total

    def internal(self, material, u):
        """Assembled T and K_c + K_sigma at displacements (nodes, 3)."""
        _, sigma, c = material
        x = (self.X + u)[self.cells]
        G, det = fe.gradients(self.dN, x)
        F = fe.deformation_gradient(x, self.G0)
        dv = self.weights * det
        T = fe.internal_force(sigma(F), G, dv)
        K = fe.element_tangent(G, ma.voigt_elasticity(c(F)), sigma(F), dv)
        nodes = len(self.X)
        return fe.assemble_vector(T, self.cells, nodes), fe.assemble_matrix(K, self.cells, nodes)


def body_load(X):
    x, y, z = (X[..., i] for i in range(3))
    return LOAD * np.stack([0.3 + 0 * x, -0.2 * x * y, 0.5 + z], axis=-1)


def traction(X):
    x, y, z = (X[..., i] for i in range(3))
    return LOAD * np.stack([0.1 * y, 0.2 + x, -0.3 * z], axis=-1)


def potential(u, name, degree):
    """psi, body force and dead traction, the loads written once more in UFL."""
    x, y, z = ufl.SpatialCoordinate(u.function_space.mesh)
    metadata = {"quadrature_degree": degree}
    dx, ds = ufl.dx(metadata=metadata), ufl.ds(metadata=metadata)
    b = LOAD * ufl.as_vector([0.3, -0.2 * x * y, 0.5 + z])
    t = LOAD * ufl.as_vector([0.1 * y, 0.2 + x, -0.3 * z])
    psi = ENERGIES[name](forms.deformation_gradient(u))
    return psi * dx + forms.body_force(u, b, dx) + forms.dead_traction(u, t, ds)


@every_material
@pytest.mark.parametrize("name_of_body", BODIES)
def test_automatic_residual_and_tangent_are_those_by_hand(name_of_body, name, rng):
    """R = T - F and K = K_c + K_sigma, assembled by hand, equal the Gateaux derivatives."""
    cell, curved, degree = BODIES[name_of_body]
    mesh = body(cell, curved)
    shake(mesh, rng)
    u = forms.displacement(mesh, degree=KINDS[cell][1])
    u.x.array[:] = rng.uniform(-0.04, 0.04, size=u.x.array.size)
    R_form = forms.residual(potential(u, name, degree), u)
    R = fem.assemble_vector(fem.form(R_form)).array
    K = fem.assemble_matrix(fem.form(forms.tangent(R_form, u))).to_dense()
    hand = ByHand(u.function_space, cell, degree)
    T, K_hand = hand.internal(MATERIALS[name], u.x.array.reshape(-1, 3))
    F = hand.load(body_load, traction)
    assert np.abs(F).max() > 1e-2 * np.abs(R).max()
    agree(fe.residual(T, F), R, 12)
    agree(K_hand, K, 12)
    agree(K_hand, K_hand.T, 14)


def test_newton_by_hand_finds_the_solution_of_snes(rng):
    """Assembly and Newton-Raphson with R = T - F and its tangent end where forms.solve ends."""
    mesh = body("hex8")
    left = at_plane(mesh, 0, 0)
    shake(mesh, rng)
    u = forms.displacement(mesh)
    degree = BODIES["hex8"][2]
    forms.solve(potential(u, "neo_hookean", degree), u, [forms.clamp(u, left)])
    hand = ByHand(u.function_space, "hex8", degree)
    fixed = fem.locate_dofs_topological(u.function_space, 2, left)
    free = np.setdiff1d(np.arange(u.x.array.size), 3 * fixed[:, None] + np.arange(3))
    F, found = hand.load(body_load, traction), np.zeros((len(hand.X), 3))
    for factor in (0.25, 0.5, 0.75, 1.0):
        norms = []
        for _ in range(8):
            T, K = hand.internal(MATERIALS["neo_hookean"], found)
            R = fe.residual(T, factor * F)[free]
            norms.append(np.linalg.norm(R))
            found.ravel()[free] -= np.linalg.solve(K[np.ix_(free, free)], R)
        assert norms[-1] < 1e-14, norms
    assert np.abs(found).max() > 0.05
    agree(u.x.array, found.ravel(), 9)


# Errors


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: shapes.shape_functions("hex20", np.zeros(3)), r"\(37\) is here for .*'hex20'"),
        (lambda: shapes.shape_gradients("tet4", np.zeros(2)), r"\(37\) needs .* got shape \(2,\)"),
        (lambda: shapes.facet_map("tet4", 4, np.zeros((1, 2))), "tet4 has the faces 0 to 3, got 4"),
        (lambda: shapes.facet_map("hex8", -1, np.zeros((1, 2))), "hex8 has .* 0 to 5, got -1"),
        (lambda: shapes.facet_map("quad", 0, np.zeros((1, 2))), r"\(37\) is here for .*'quad'"),
        (lambda: quadrature.tetrahedron(6), r"\(58\): .* reach degree 5, got 6"),
        (lambda: quadrature.hexahedron(0), r"\(58\): .* at least one point .* got 0"),
        (
            lambda: fe.gradients(
                shapes.shape_gradients("tet4", np.zeros((1, 3))), -np.eye(4)[:, 1:]
            ),
            r"\(58\) needs det J\^\(e\) > 0, got -1",
        ),
        (lambda: fe.interpolate(np.ones((1, 4)), np.ones((8, 3))), r"\(37\) .* 4 nodes.*\(8, 3\)"),
        (lambda: fe.jacobian(np.ones((1, 4, 3)), np.ones((8, 3))), r"\(58\) .* 4 nodes.*\(8, 3\)"),
        (
            lambda: fe.velocity_gradient(np.ones((4, 2)), np.ones((1, 4, 3))),
            r"\(40\) .* 4 nodes.*\(4, 2\)",
        ),
        (
            lambda: fe.deformation_gradient(np.ones((8, 3)), np.ones((1, 4, 3))),
            r"\(43\) .* 4 nodes.*\(8, 3\)",
        ),
        (lambda: fe.neo_hookean_matrix(np.array([1.0, -0.1]), 1, 1), r"\(20\) .* got J = -0.1"),
    ],
)
def test_errors_name_the_equation(call, message):
    with pytest.raises(ValueError, match=message):
        call()
