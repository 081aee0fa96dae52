# SPDX-License-Identifier: MIT
"""Document 003, VI-VIII: elements by hand, formula by formula, and what is misprinted."""

from itertools import product

import numpy as np
import pytest
from cases import FIBER, LMBDA, MU, agree, off
from elements import MATERIALS, RULES, State, distorted, every_cell, every_material, moved
from materials import CONSTANTS, H

from variform.forms.formulas import elasticity as el
from variform.forms.formulas import element as fe
from variform.forms.formulas import materials as ma
from variform.forms.formulas import quadrature, shapes

# VI. Linearized equilibrium


@pytest.fixture
def directions(rng):
    return rng.normal(size=(2, 27, 3))


@pytest.mark.capability(66, 67)
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


@pytest.mark.capability(68, 69, 70, 71)
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


@pytest.mark.misprint(13, "a vector, no gradient")
def test_misprint_41(directions):
    """(41): sum dv_a (x) N_a is the virtual velocity, a vector, and no gradient."""
    s, v = State("tet10"), directions[0][:10]
    printed = fe.virtual_velocity_gradient(v, s.N, as_printed=True)
    assert printed.shape == (4, 3) and fe.virtual_velocity_gradient(v, s.G).shape == (4, 3, 3)
    agree(printed, np.einsum("qa,ai->qi", s.N, v), 15)


@pytest.mark.capability(72)
@every_cell
def test_strain_displacement_matrix(cell, directions):
    """(45)-(47): sum_a B_a u_a is the Voigt vector of sym grad u."""
    s, u = State(cell), directions[0][: len(shapes.NODES[cell])]
    found = np.einsum("qaIi,ai->qI", fe.strain_displacement(s.G), u)
    eps = el.rate_of_deformation(fe.velocity_gradient(u, s.G))
    agree(found, ma.voigt_strain(eps), 14)


@pytest.mark.capability(73, 74)
@pytest.mark.digits(12)
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


@pytest.mark.capability(73)
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


@pytest.mark.capability(73, 74, 75, 77)
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


@pytest.mark.capability(76, 77)
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


@pytest.mark.misprint(14, "zero for every stress")
@every_cell
def test_misprint_58_sum(cell):
    """(58): sum_a T_a vanishes whatever the stress is; the element's force is the stack of T_a."""
    T = force(cell, MATERIALS["neo_hookean"][1], State(cell).x)
    assert np.abs(fe.element_vector(T, as_printed=True)).max() < 1e-14 * np.abs(T).max()
    assert fe.element_vector(T).tolist() == [entry for row in T for entry in row]


@pytest.mark.capability(78)
@pytest.mark.misprint(15, "tet10 {1:.2g}, hex8 {2:.2g}, hex27 {4:.2g}; none for tet4")
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


@pytest.mark.capability(79)
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


@pytest.mark.misprint(
    16,
    "off by {0:.3g} for tet10 with 4 points, {2:.2g} for hex8 with 3^3; none with 2^3, where "
    "W_i = 1",
)
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


@pytest.mark.capability(80)
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
