# SPDX-License-Identifier: MIT
"""Energies in singular values inside forms: equal to plain UFL wherever UFL can say the same."""

import gc

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from cases import LMBDA, MU, agree, unit_mesh, whole
from dolfinx import fem, mesh
from dolfinx.mesh import CellType

from variform import forms, meshes
from variform.forms import _dolfinx, energies, stress

PAIRS = {
    "neo_hookean": (energies.neo_hookean, energies.neo_hookean_stretches),
    "saint_venant_kirchhoff": (
        energies.saint_venant_kirchhoff,
        energies.saint_venant_kirchhoff_stretches,
    ),
}
MESHES = {
    "tetrahedron": lambda: unit_mesh(3),
    "hexahedron": lambda: unit_mesh(3, 1, CellType.hexahedron),
    "triangle": lambda: unit_mesh(2, 2),
    "quadrilateral": lambda: unit_mesh(2, 2, CellType.quadrilateral),
    "curved": lambda: meshes.sphere_octant(MPI.COMM_SELF, 0.5, 1.0, h=0.7, order=2).mesh,
}


def numbers(potential, u, **kinds):
    """Energy, residual and tangent as numbers."""
    system = forms.Problem(potential, u, **kinds)
    b, A = system.create_vector(), system.create_matrix()
    system.residual(b)
    system.tangent(A)
    values = A.getValuesCSR()[2]
    return system.energy(), b.array.copy(), values.copy()


def same(found, wanted, digits=12):
    for a, b in zip(found, wanted, strict=True):
        agree(np.atleast_1d(a), np.atleast_1d(b), digits)


def moved(body, rng, degree=1, amount=0.03):
    u = forms.displacement(body, degree=degree)
    u.x.array[:] = amount / degree**2 * rng.normal(size=u.x.array.size)
    return u, forms.deformation_gradient(u)


@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("cells", MESHES)
@pytest.mark.parametrize("name", PAIRS)
def test_the_same_energy_both_ways(name, cells, degree, rng):
    """Energy, residual and tangent equal those of the energy written in F, to 12 digits."""
    if cells in ("hexahedron", "curved") and degree == 3:
        degree, cells = 3, "quadrilateral"  # order 3 in 3D is covered by tetrahedra
    body = MESHES[cells]()
    if _dolfinx.geometry_degree(body) > degree:
        degree = 2
    u, F = moved(body, rng, degree)
    plain, operator = PAIRS[name]
    same(numbers(operator(F, MU, LMBDA) * ufl.dx, u), numbers(plain(F, MU, LMBDA) * ufl.dx, u))


@pytest.mark.parametrize("rule", [0, 1, 3, 6])
def test_any_quadrature_degree(rule, rng):
    u, F = moved(unit_mesh(2, 2), rng, 2)
    dx = ufl.dx(degree=rule)
    plain, operator = PAIRS["neo_hookean"]
    same(numbers(operator(F, MU, LMBDA) * dx, u), numbers(plain(F, MU, LMBDA) * dx, u))


def test_axisymmetric_and_isochoric_operands(rng):
    """F of a body of revolution, and J^(-1/3) F: the chain rule goes through the operand."""
    u = forms.displacement(unit_mesh(2, 2), degree=2)
    u.x.array[:] = 0.02 * rng.normal(size=u.x.array.size)
    F = forms.axisymmetric(u)
    plain, operator = PAIRS["neo_hookean"]
    weight = forms.circumference(u)
    same(*(numbers(e(F, MU, LMBDA) * weight * ufl.dx, u) for e in (operator, plain)))
    G = forms.kinematics.isochoric(F)
    same(*(numbers(e(G, MU, LMBDA) * weight * ufl.dx, u) for e in (operator, plain)))


def test_products_powers_and_several_operands(rng):
    """One form with T(u) psi(F), psi(F A)^2 and ordinary terms, on cells and facets."""
    u, F = moved(unit_mesh(3), rng)
    A = ufl.as_matrix([[1.2, 0.1, 0.0], [0.0, 0.9, 0.2], [0.1, 0.0, 1.1]])
    s, t = (energies.saint_venant_kirchhoff, energies.saint_venant_kirchhoff_stretches)
    n, m = PAIRS["neo_hookean"]

    def potential(one, two):
        T = 1 + ufl.inner(u, u)
        inside = T * one(F, MU, LMBDA) + two(F * A, MU, LMBDA) ** 2 + one(F, 1.0, 1.0) * ufl.det(F)
        return (inside + ufl.inner(u, u)) * ufl.dx + two(F, MU, 0.5) * u[0] ** 2 * ufl.ds

    same(numbers(potential(m, t), u), numbers(potential(n, s), u))


@pytest.mark.parametrize("cells", ["tetrahedron", "hexahedron", "triangle", "quadrilateral"])
def test_facets_and_subdomains(cells, rng):
    """Named facets and cells, each with its own parameters, beside a follower load."""
    body = MESHES[cells]()
    dim = body.topology.dim
    u, F = moved(body, rng, 1 if cells == "tetrahedron" else 2)  # that order compiles fast
    half = mesh.locate_entities(body, dim, lambda x: x[0] <= 0.5 + 1e-9)
    every = np.arange(body.topology.index_map(dim).size_local, dtype=np.int32)
    cell_tags = mesh.meshtags(body, dim, every, np.isin(every, half).astype(np.int32))
    facets = whole(body)
    ends = whole(body, lambda x: np.isclose(x[0], 0) | np.isclose(x[1], 1))
    facet_tags = mesh.meshtags(body, dim - 1, facets, 1 + np.isin(facets, ends).astype(np.int32))
    dx = ufl.Measure("dx", body, subdomain_data=cell_tags)
    ds = ufl.Measure("ds", body, subdomain_data=facet_tags)
    soft = fem.Constant(body, 0.7)

    def potential(e):
        inside = e(F, MU, LMBDA) * dx(0) + e(F, soft, 2 * soft) * dx(1) + 0.1 * e(F, 1.0, 1.0) * dx
        return inside + e(F, soft, 0.3) * ds(2) + 0.2 * e(F, 0.5, 0.3) * ds((1, 2))

    load = forms.follower_pressure(u, soft, ufl.TestFunction(u.function_space), ds(1))
    plain, operator = PAIRS["neo_hookean"]
    same(*(numbers(potential(e), u, virtual_work=load) for e in (operator, plain)))


def test_parameters_that_vary(rng):
    """Mu a DG0 field, lmbda a P2 field, a vector Constant, x, and a gradient inside psi_hat."""
    body = unit_mesh(3)
    u, F = moved(body, rng)
    mu = fem.Function(fem.functionspace(body, ("DG", 0)))
    mu.x.array[:] = rng.uniform(1, 2, mu.x.array.size)
    T = fem.Function(fem.functionspace(body, ("Lagrange", 2)))
    T.interpolate(lambda x: 1 + x[0] * x[1])
    c = fem.Constant(body, (0.3, 0.7))
    X = ufl.SpatialCoordinate(body)
    lmbda = T + c[1] * X[2] + ufl.inner(ufl.grad(T), ufl.grad(T))
    plain, operator = PAIRS["neo_hookean"]
    same(*(numbers(e(F, mu, lmbda) * ufl.dx, u) for e in (operator, plain)))
    written = energies.principal(
        lambda s1, s2, s3: mu / 4 * sum((s**2 - 1) ** 2 for s in (s1, s2, s3))
        + lmbda / 8 * (s1**2 + s2**2 + s3**2 - 3) ** 2
    )
    wanted = energies.saint_venant_kirchhoff(F, mu, lmbda)
    same(numbers(written(F) * ufl.dx, u), numbers(wanted * ufl.dx, u))
    mu.x.array[:] *= 3
    c.value[1] = 5.0
    same(numbers(written(F) * ufl.dx, u), numbers(wanted * ufl.dx, u))


def test_mixed_unknown(rng):
    """Isochoric operator with a pressure: the tangent in both unknowns equals plain UFL's."""
    w = forms.displacement_pressure(unit_mesh(2))
    w.x.array[:] = 0.02 * rng.normal(size=w.x.array.size)
    u, p = ufl.split(w)
    F = forms.deformation_gradient(u)

    def potential(e):
        psi = e(forms.kinematics.isochoric(F), MU, LMBDA)
        return energies.with_pressure(psi, F, p, 50.0) * ufl.dx

    plain, operator = PAIRS["neo_hookean"]
    same(numbers(potential(operator), w), numbers(potential(plain), w))


def test_sheet_in_space(rng):
    """A 3x2 gradient: psi_hat(s1, s2) of membrane strains equals the energy in C, when flat too."""
    flat = mesh.create_unit_square(MPI.COMM_SELF, 2, 2)
    r = fem.Function(fem.functionspace(flat, ("Lagrange", 2, (3,))))
    r.interpolate(lambda x: np.array([x[0], x[1], 0.3 * x[0] * x[1]]))
    r.x.array[:] += 0.02 * rng.normal(size=r.x.array.size)
    G = ufl.grad(r)
    C = G.T * G
    plain = MU / 4 * (ufl.inner(C, C) - 2 * ufl.tr(C) + 2) + LMBDA / 8 * (ufl.tr(C) - 2) ** 2
    membrane = energies.principal(
        lambda s1, s2: MU / 4 * ((s1**2 - 1) ** 2 + (s2**2 - 1) ** 2)
        + LMBDA / 8 * (s1**2 + s2**2 - 2) ** 2
    )
    same(numbers(membrane(G) * ufl.dx, r), numbers(plain * ufl.dx, r))
    r.interpolate(lambda x: np.array([x[0], x[1], 0 * x[0]]))
    same(numbers(membrane(G) * ufl.dx, r)[2:], numbers(plain * ufl.dx, r)[2:])


def test_two_singular_values_in_the_plane(rng):
    """psi_hat(s1, s2) on a plane body has no stress out of the plane; (s1, s2, 1) has."""
    u, F = moved(unit_mesh(2, 2), rng, 1)
    two = energies.principal(lambda s1, s2: MU * ((s1 - 1) ** 2 + (s2 - 1) ** 2))(F)
    three = energies.as_rigid_as_possible(F, MU)
    same(numbers(two * ufl.dx, u), numbers(three * ufl.dx, u))
    dilated = energies.corotated_linear(F, MU, LMBDA)
    assert forms.integral(stress.first_piola(two, F)[2, 2] * ufl.dx) == 0
    u.x.array[:] = 0
    u.interpolate(lambda x: 0.1 * x[:2])
    found = forms.integral(stress.first_piola(dilated, F)[2, 2] * ufl.dx)
    assert found == pytest.approx(LMBDA * 0.2, rel=1e-12)


def test_fields_and_integrals_of_stress(rng):
    """stress, field and integral see the operator: Cauchy stress at nodes equals plain UFL's."""
    body = unit_mesh(3)
    _, F = moved(body, rng, 2)
    plain, operator = (e(F, MU, LMBDA) for e in PAIRS["neo_hookean"])
    for degree in (0, 1):
        found, wanted = (
            forms.field(stress.cauchy(psi, F), body, degree).x.array for psi in (operator, plain)
        )
        agree(found, wanted, 12)
    c = [
        forms.integral(stress.spatial_elasticity(psi, F)[0, 1, 2, 1] * ufl.dx(degree=2))
        for psi in (operator, plain)
    ]
    assert c[0] == pytest.approx(c[1], rel=1e-11)
    value = forms.integral(plain * ufl.dx(degree=2))  # as the solver integrates
    assert forms.integral(operator * ufl.dx) == pytest.approx(value, rel=1e-12)


def test_activation_is_document_002(rng):
    """Psi = mu |F A - R|^2 and P = 2 mu (F A - R) A^T, A not symmetric, F inverted or not."""
    body = unit_mesh(3)
    A = np.array([[0.7, 0.2, 0.0], [-0.1, 1.1, 0.3], [0.0, 0.1, 1.2]])
    for improper in (False, True):
        for sign in (1, -1):
            value = np.diag([1, 1, sign]) @ (np.eye(3) + 0.2 * rng.normal(size=(3, 3)))
            F = ufl.variable(fem.Constant(body, value))
            psi = energies.activated(F, A, MU, improper=improper)
            U, _, Vt = np.linalg.svd(value @ A)
            turn = np.diag([1, 1, 1 if improper else np.linalg.det(U @ Vt)])
            R = U @ turn @ Vt
            wanted = MU * np.sum((value @ A - R) ** 2)
            assert forms.integral(psi * ufl.dx) == pytest.approx(wanted, rel=1e-13)
            P = 2 * MU * (value @ A - R) @ A.T
            found = [
                forms.integral(stress.first_piola(psi, F)[i, j] * ufl.dx)
                for i, j in np.ndindex(3, 3)
            ]
            agree(found, P.ravel(), 12)


def test_activation_in_the_plane_and_in_time(rng):
    """A (2, 2) acts in the plane; a Constant in it needs no new compilation."""
    u, F = moved(unit_mesh(2, 2), rng, 1)
    body = u.function_space.mesh
    t = fem.Constant(body, 1.0)
    psi = energies.activated(F, ufl.as_matrix([[t, 0], [0, 1 / t]]), MU)
    wanted = energies.as_rigid_as_possible(F, MU)
    assert forms.integral(psi * ufl.dx) == pytest.approx(forms.integral(wanted * ufl.dx), rel=1e-13)
    t.value = 1.5
    u.interpolate(lambda x: np.array([x[0] / 1.5 - x[0], 1.5 * x[1] - x[1]]))
    assert abs(forms.integral(psi * ufl.dx)) < 1e-28


def test_a_term_that_begins_far_from_rest_is_no_smooth_energy():
    """With max(s - 1.3, 0)^2 the tangent at s2 = -s3 + gap is the stress's difference quotient."""
    limit = energies.principal(
        lambda s1, s2, s3: sum(
            ufl.conditional(ufl.gt(s, 1.3), (s - 1.3) ** 2, 0) for s in (s1, s2, s3)
        )
        + s1**2
        + s2**2
        + s3**2
    )
    F = np.diag([2.0, 1.65, -1.6])[None]
    _, A = limit.evaluate(F)
    wanted = np.zeros((3, 3, 3, 3))
    for k, n in np.ndindex(3, 3):
        step = np.zeros((1, 3, 3))
        step[0, k, n] = 1e-6
        wanted[:, :, k, n] = (limit.evaluate(F + step)[0] - limit.evaluate(F - step)[0])[0] / 2e-6
    assert np.abs(A[0] - wanted).max() < 1e-6 * np.abs(wanted).max()


def test_evaluators_follow_what_stands_in_psi_hat():
    k = 1.0
    energy = energies.principal(lambda a, b, c: k * ((a - 1) ** 2 + (b - 1) ** 2 + (c - 1) ** 2))
    F = 1.1 * np.eye(3)[None]
    first = energy.energy(F)[0]
    k = 2.0
    assert energy.energy(F)[0] == pytest.approx(2 * first)
    assert energy.energy(np.empty((0, 3, 3))).shape == (0,)


def test_a_load_factor_inside_an_operand_is_seen():
    """Follow accepts a t that only an activation contains, and refuses one that nothing does."""
    body = unit_mesh(3)
    u, t = forms.displacement(body), forms.load_factor(body)
    F = forms.deformation_gradient(u)
    held = [forms.clamp(u, whole(body, lambda x: x[0] < 1e-9))]
    potential = energies.activated(F, (1 + t) * ufl.Identity(3), MU) * ufl.dx
    assert forms.follow(potential, u, held, t, progress=False).completed
    t.value = 0
    potential = energies.fixed_corotated(F, MU, LMBDA) * ufl.dx
    with pytest.raises(ValueError, match="nothing depends on the load factor"):
        forms.follow(potential, u, held, t, progress=False)


def test_evaluators_are_the_kernels(rng):
    """P, dPdF = energy.evaluate(F): what a form assembles, for three and for two stretches."""
    body = unit_mesh(3)
    F = np.eye(3) + 0.3 * rng.normal(size=(4, 3, 3))
    P, A = energies.fixed_corotated.evaluate(F, MU, lmbda=LMBDA)
    value = ufl.variable(fem.Constant(body, F[2]))
    psi = energies.fixed_corotated(value, MU, LMBDA)
    rows = ufl.as_vector(
        [stress.first_elasticity(psi, value)[1, 0, i, j] for i, j in np.ndindex(3, 3)]
    )
    found = forms.field(rows, body, 0).x.array[:9]
    agree(found, A[2, 1, 0].ravel(), 12)
    varying = energies.fixed_corotated.evaluate(F, MU * np.ones(4), LMBDA)[0]
    assert np.array_equal(varying, P)
    W = energies.ogden.energy(F[:1], [1.0, -0.5], [2.0, -2.0])
    assert np.isfinite(W).all()
    sheet = energies.principal(lambda s1, s2, mu: mu * ((s1 - 1) ** 2 + (s2 - 1) ** 2))
    assert sheet.evaluate(F[:, :, :2], 2.0)[1].shape == (4, 3, 2, 3, 2)


def test_a_form_outlives_its_parts(rng):
    """A compiled form keeps its kernels: nothing else refers to them after a collection."""
    _, F = moved(unit_mesh(3), rng)
    form = forms.compiled(energies.hencky(F, MU, LMBDA) * ufl.dx)
    before = fem.assemble_scalar(form)
    del F
    gc.collect()
    assert fem.assemble_scalar(form) == before


def test_16_functions_act_in_an_operand_and_17_are_refused(rng):
    body = unit_mesh(2)
    _, F = moved(body, rng)  # one function, and those of mu
    parts = [fem.Function(fem.functionspace(body, ("DG", 0))) for _ in range(16)]
    for part in parts:
        part.x.array[:] = rng.uniform(1, 2, part.x.array.size)
    plain, operator = PAIRS["neo_hookean"]

    def energy(e, count):
        mu = sum((k + 1) * part for k, part in enumerate(parts[:count]))
        return forms.integral(e(F, mu, LMBDA) * ufl.dx)

    assert energy(operator, 15) == pytest.approx(energy(plain, 15), rel=1e-12)
    with pytest.raises(ValueError, match="may contain 16 functions, got 17"):
        energy(operator, 16)


def test_8_operators_act_in_an_integral_and_9_are_refused(rng):
    _, F = moved(unit_mesh(2), rng)
    plain, operator = PAIRS["neo_hookean"]

    def energy(e, count):
        psi = sum(e(k * F, MU, LMBDA) for k in range(1, count + 1))
        return forms.integral(psi * ufl.dx(degree=1))

    assert energy(operator, 8) == pytest.approx(energy(plain, 8), rel=1e-12)
    with pytest.raises(ValueError, match="may have 8 energies in singular values at .* got 9"):
        energy(operator, 9)
