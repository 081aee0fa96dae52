# SPDX-License-Identifier: MIT
"""Energies in singular values inside forms: equal to plain UFL wherever UFL can say the same."""

import ctypes
import gc
import json
import shlex
import subprocess
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest
import ufl
from cases import LMBDA, MU, agree, unit_mesh, whole
from dolfinx import fem, mesh
from dolfinx.mesh import CellType

from variform import forms, meshes
from variform.forms import _dolfinx, energies, stress
from variform.forms.native import jit
from variform.forms.native.library import library

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


def test_two_sets_of_tags_are_refused():
    body = unit_mesh(3)
    cells = np.arange(6, dtype=np.int32)
    tags = [mesh.meshtags(body, 3, cells, np.full(6, k, np.int32)) for k in (1, 2)]
    u = forms.displacement(body)
    psi = energies.hencky(forms.deformation_gradient(u), MU, LMBDA)
    one, two = (ufl.Measure("dx", body, subdomain_data=t) for t in tags)
    with pytest.raises(ValueError, match="2 different sets of tags for its cell integrals"):
        forms.compiled(psi * one(1) + psi * two(2))


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


def test_states_without_an_energy_are_infinite_and_refused():
    """Ln of an inverted state: the energy is inf, so that a line search turns back."""
    body = unit_mesh(3)
    u = forms.displacement(body)
    u.interpolate(lambda x: np.array([-2 * x[0], 0 * x[0], 0 * x[0]]))
    psi = energies.hencky(forms.deformation_gradient(u), MU, LMBDA)
    assert forms.integral(psi * ufl.dx) == np.inf
    with pytest.raises(forms.NotConverged, match="energy is not finite at the start"):
        forms.solve(psi * ufl.dx, u, [forms.clamp(u, whole(body, lambda x: x[2] < 1e-9))])


def quadratic(u):
    return forms.deformation_gradient(forms.displacement(u.function_space.mesh, degree=2))


BAD = {
    "not symmetric": (
        lambda F, u: energies.principal(lambda s1, s2, s3: s1 + 2 * s2 + s3)(F),
        r"must not depend on the order of the singular values, got .* \[1, 3, 2\]",
    ),
    "not finite": (
        lambda F, u: energies.principal(lambda s1, s2, s3: ufl.ln(s1 + s2 + s3 - 4))(F),
        "must be finite near rest, got nan",
    ),
    "no scalar": (
        lambda F, u: energies.principal(lambda s1, s2, s3: F * s1)(F),
        r"must return a scalar, got the shape \(3, 3\)",
    ),
    "arguments": (
        lambda F, u: energies.principal(lambda mu, a, b, c: mu * a),
        r"singular values first, as .*, got \(mu, a, b, c\)",
    ),
    "no function": (lambda F, u: energies.principal(F), "is a function of them, .* got Variable"),
    "clamp": (
        lambda F, u: energies.principal(lambda a, b, c: a, clamp=0.0),
        "clamp must be between 0 and 1, got 0.0",
    ),
    "shape": (
        lambda F, u: energies.fixed_corotated(u, 1, 1),
        r"needs an F of shape \(3, 3\) or \(2, 2\), got \(3,\)",
    ),
    "two stretches": (
        lambda F, u: energies.principal(lambda s1, s2: s1 + s2)(F),
        r"of 2 singular values needs an F of shape \(2, 2\) or \(3, 2\), got \(3, 3\)",
    ),
    "parameters": (lambda F, u: energies.hencky(F, 1.0), "missing a required argument: 'lmbda'"),
    "negative": (lambda F, u: energies.hencky(F, -1.0, 1.0), "mu must be positive, got -1.0"),
    "second derivative by UFL": (
        lambda F, u: forms.compiled(
            ufl.derivative(
                forms.residual(energies.hencky(F, 1, 1) * ufl.dx, u)
                + ufl.inner(u, ufl.TestFunction(u.function_space)) * ufl.dx,
                u,
            )
        ),
        "which would take it for a constant",
    ),
    "diff of a stress": (
        lambda F, u: forms.compiled(
            ufl.diff(stress.first_piola(energies.hencky(F, 1, 1), F), F)[0, 0, 0, 0] * ufl.dx
        ),
        "which would take it for a constant",
    ),
    "gradient in space": (
        lambda F, u: forms.compiled((1 + energies.hencky(quadratic(u), 1, 1).dx(0)) * ufl.dx),
        "have no derivative in space",
    ),
    "divergence of a stress": (
        lambda F, u: forms.compiled(
            (u[0] + ufl.div(stress.first_piola(energies.hencky(F, 1, 1), F))[0]) * ufl.dx
        ),
        "have no derivative in space",
    ),
    "stress of a parameter in F": (
        lambda F, u: stress.first_piola(energies.hencky(F, 1 + ufl.tr(F) ** 2, 1.0), F),
        "a parameter of hencky depends on the unknown",
    ),
    "test function": (
        lambda F, u: energies.hencky(F, 1 + ufl.TestFunction(u.function_space)[0], 1.0),
        "a test or trial function has no place in them",
    ),
    "no mesh": (
        lambda F, u: energies.hencky(1.1 * ufl.Identity(3), 1.0, 1.0),
        "needs an F of a mesh, got one of numbers only",
    ),
    "zero": (
        lambda F, u: forms.compiled(
            forms.derivative(
                energies.hencky(F, 1, 1) * ufl.dx,
                forms.displacement(u.function_space.mesh),
                ufl.TestFunction(u.function_space),
            )
        ),
        "the form is zero",
    ),
    "no value": (
        lambda F, u: forms.compiled(
            ufl.Coefficient(u.ufl_function_space())[0] * energies.hencky(F, 1, 1) * ufl.dx
        ),
        "has no value: use a Function or Constant of DOLFINx",
    ),
    "complex": (
        lambda F, u: energies.hencky.evaluate(1j * np.ones((1, 3, 3)), 1.0, 1.0),
        "evaluate needs F as numbers",
    ),
    "nan parameter": (
        lambda F, u: energies.hencky.evaluate([np.eye(3)], np.array([np.nan]), 1.0),
        r"needs finite parameters, got \[nan\]",
    ),
    "reserved name": (
        lambda F, u: energies.principal(lambda s1, s2, s3, project: s1),
        "may not be named project",
    ),
    "nameless": (
        lambda F, u: energies.principal(lambda s1, s2, s3, *more: s1),
        "needs parameters with names",
    ),
    "deep": (
        lambda F, u: forms.compiled(
            forms.tangent(forms.residual(energies.hencky(F, 1, 1) * ufl.dx(degree=40), u), u)
        ),
        "MiB per cell for .*, more than 4: lower the quadrature degree",
    ),
    "no parameter": (
        lambda F, u: energies.hencky(F, "1", 1.0),
        "hencky needs mu as a number or a UFL scalar, got str",
    ),
    "tensor": (
        lambda F, u: energies.hencky(F, F, 1.0),
        r"needs mu as a number or a UFL scalar, got Variable of shape \(3, 3\)",
    ),
    "unknown parameter": (
        lambda F, u: energies.hencky(F, 1.0, 1.0, nu=3),
        r"hencky\(F, mu, lmbda\): got an unexpected keyword argument 'nu'",
    ),
    "independent": (
        lambda F, u: energies.principal(lambda a, b, c: 0 * a)(F),
        "does not depend on the singular values, got 0",
    ),
    "NumPy": (
        lambda F, u: energies.principal(lambda a, b, c: np.log(a))(F),
        "failed on UFL scalars .* write it with ufl.ln",
    ),
    "no UFL": (
        lambda F, u: energies.hencky(np.eye(3), 1.0, 1.0),
        "needs a deformation gradient in UFL, got ndarray; for arrays there is hencky.evaluate",
    ),
    "no numbers": (
        lambda F, u: energies.hencky.evaluate("F", 1.0, 1.0),
        "hencky.evaluate needs F as numbers, got str",
    ),
    "parameters of another length": (
        lambda F, u: energies.hencky.evaluate([np.eye(3)], np.ones(2), 1.0),
        r"numbers or one per F, shape \(1,\), got \(2,\)",
    ),
    "activation of another kind": (
        lambda F, u: energies.activated(F, "A", 1.0),
        "needs A as a matrix of numbers or in UFL, got str",
    ),
    "terms": (
        lambda F, u: energies.ogden(F, [1.0], [2.0, 3.0]),
        "as many mu as alpha, got 1 and 2",
    ),
    "no list": (lambda F, u: energies.ogden(F, 1.0, 2.0), "needs mu as a list, .* got 1.0"),
    "extension": (
        lambda F, u: energies.extended(energies.hencky, 1.5),
        "stretch below between 0 and 1, got 1.5",
    ),
    "extended what": (
        lambda F, u: energies.extended(energies.neo_hookean, 0.5),
        "needs an energy in singular values, as hencky, got neo_hookean",
    ),
    "activation": (
        lambda F, u: energies.activated(F, np.eye(4), 1.0),
        r"needs A of shape \(3, 3\), got \(4, 4\)",
    ),
    "activated": (
        lambda F, u: energies.activated(u, np.eye(3), 1.0),
        r"activated needs a 3x3 F, got shape \(3,\)",
    ),
    "interior facets": (
        lambda F, u: forms.compiled(energies.hencky(F, 1.0, 1.0)("+") * ufl.dS),
        "over cells and exterior facets, got an integral of type interior_facet",
    ),
    "interior beside": (
        lambda F, u: forms.compiled(energies.hencky(F, 1.0, 1.0) * ufl.dx + u("+")[0] * ufl.dS),
        "over cells and exterior facets, got 1 of those and 1 others",
    ),
    "rule": (
        lambda F, u: forms.compiled(
            energies.hencky(F, 1.0, 1.0) * ufl.dx(scheme="vertex", degree=1)
        ),
        "by the default rule, got vertex",
    ),
    "ufl.derivative": (
        lambda F, u: forms.compiled(ufl.derivative(energies.hencky(F, 1.0, 1.0) * ufl.dx, u)),
        "by forms.derivative, forms.residual",
    ),
    "ufl.diff": (
        lambda F, u: forms.compiled(ufl.diff(energies.hencky(F, 1.0, 1.0), F)[0, 0] * ufl.dx),
        "not by ufl.derivative or ufl.diff",
    ),
    "fem.form": (
        lambda F, u: fem.form(energies.hencky(F, 1.0, 1.0) * ufl.dx),
        "is compiled by forms.compiled",
    ),
    "nested": (
        lambda F, u: forms.compiled(energies.hencky(energies.hencky(F, 1, 1) * F, 1, 1) * ufl.dx),
        "contains an energy in singular values itself",
    ),
    "dependent parameter": (
        lambda F, u: forms.residual(energies.hencky(F, 1 + u[0] ** 2, 1.0) * ufl.dx, u),
        "a parameter of hencky depends on the unknown",
    ),
    "third derivative": (
        lambda F, u: forms.derivative(
            forms.tangent(forms.residual(energies.hencky(F, 1, 1) * ufl.dx, u), u), u, u
        ),
        "the third derivative of an energy in singular values is not available",
    ),
    "array": (
        lambda F, u: energies.hencky.evaluate(np.eye(3), 1.0, 1.0),
        r"needs F of shape \(n, 3, 3\), got \(3, 3\)",
    ),
    "nan": (
        lambda F, u: energies.hencky.evaluate(np.full((2, 3, 3), np.nan), 1.0, 1.0),
        r"needs finite F, got \[\[nan, .* at 0",
    ),
    "no number": (
        lambda F, u: energies.principal(lambda a, b, c: u[0] * (a + b + c)).evaluate([np.eye(3)]),
        "which has no value outside a mesh",
    ),
    "many parameters": (
        lambda F, u: energies.ogden(F, [1.0] * 40, [2.0] * 40),
        "may have 64 parameters, got 80",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_gets_one_sentence(case):
    call, message = BAD[case]
    u = forms.displacement(unit_mesh(3))
    with pytest.raises(ValueError, match=message):
        call(forms.deformation_gradient(u), u)


def test_parameters_of_another_mesh_are_refused():
    u = forms.displacement(unit_mesh(3))
    other = fem.Function(fem.functionspace(unit_mesh(3), ("DG", 0)))
    with pytest.raises(ValueError, match="hencky's parameters and F must be of one mesh"):
        energies.hencky(forms.deformation_gradient(u), other, 1.0)


def test_plane_stress_wants_plain_energies():
    u = forms.displacement(unit_mesh(2))
    with pytest.raises(ValueError, match="condenses energies in plain UFL"):
        forms.plane_stress(u, lambda F: energies.hencky(F, 1.0, 1.0))


NO_COMPILER = """
from mpi4py import MPI
import ufl
from variform import forms
from dolfinx import mesh
u = forms.displacement(mesh.create_unit_cube(MPI.COMM_WORLD, 2, 2, 2))
psi = forms.energies.hencky(forms.deformation_gradient(u), 1.0, 1.0)
try:
    forms.Problem(psi * ufl.dx, u)
except RuntimeError as error:
    print(MPI.COMM_WORLD.gather(str(error)))
"""


AT_ONCE = """
from mpi4py import MPI
import ufl
from variform import forms
from dolfinx import mesh
u = forms.displacement(mesh.create_unit_cube(MPI.COMM_WORLD, 2, 2, 2))
u.interpolate(lambda x: 0.1 * x)
psi = forms.energies.hencky(forms.deformation_gradient(u), 1.0, 1.0)
energy = forms.Problem(psi * ufl.dx, u).energy()
if MPI.COMM_WORLD.rank == 0:
    print(energy)
"""


@pytest.mark.slow
def test_programs_that_start_at_once_share_an_empty_cache(run, tmp_path, monkeypatch):
    """Three programs of two ranks each compile the same kernels into one folder at a time."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    with ThreadPoolExecutor(3) as pool:
        done = list(pool.map(lambda _: run("-c", AT_ONCE, ranks=2), range(3)))
    wanted = 3 * np.log(1.1) ** 2 + 9 / 2 * np.log(1.1) ** 2
    assert [float(d.stdout) for d in done] == pytest.approx([wanted] * 3, rel=1e-12)
    assert len(list((tmp_path / "fenics").glob("libvariform_*"))) == 1


@pytest.mark.parametrize("ranks", [1, 2])
def test_a_missing_compiler_is_named(ranks, run, tmp_path, monkeypatch):
    """One sentence with the compiler's name on every rank, and no hang."""
    monkeypatch.setenv("CC", "no-such-compiler")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    out = run("-c", NO_COMPILER, ranks=ranks).stdout
    assert out.count("compiling the operators' kernels failed") == ranks
    assert out.count("is a C compiler installed (no-such-compiler)") == ranks


def test_the_clamp_is_1e_6():
    """Unless told otherwise T = (psi_2 + psi_3) / 1e-6 where s = (1, x, -x)."""
    F = np.diag([1.0, 0.5, -0.5])[None]
    for energy in (
        energies.as_rigid_as_possible,
        energies.principal(lambda s1, s2, s3, mu: mu * s1 * s2 * s3 + s1 + s2 + s3),
    ):
        P, A = energy.evaluate(F, MU)
        T = A[0, 1, 2, 1, 2] - A[0, 1, 2, 2, 1]
        assert T == pytest.approx((P[0, 1, 1] + P[0, 2, 2]) / 1e-6, rel=1e-12)


def test_64_parameters_act_and_65_are_refused(rng):
    def weighted(s1, s2, s3, mu):
        total = sum((k + 1) * m for k, m in enumerate(mu))
        return total * ((s1 - 1) ** 2 + (s2 - 1) ** 2 + (s3 - 1) ** 2)

    F = np.eye(3)[None] + 0.1 * rng.normal(size=(1, 3, 3))
    mu = rng.uniform(1, 2, 64)
    found = energies.principal(weighted).energy(F, mu.tolist())[0]
    wanted = energies.as_rigid_as_possible.energy(F, mu @ np.arange(1, 65))[0]
    assert found == pytest.approx(wanted, rel=1e-13)
    with pytest.raises(ValueError, match="may have 64 parameters, got 65"):
        energies.principal(weighted).energy(F, [1.0] * 65)


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


def test_only_indefinite_cells_pay_for_eigenvalues():
    """Rigid modes and unknowns without stiffness are no reason: a factorization tells that."""
    lib, ffi = library(MPI.COMM_SELF)
    lapack = ctypes.CDLL(PETSc.__file__)
    factorize, eigen = (
        ffi.cast("void *", ctypes.cast(f, ctypes.c_void_p).value)
        for f in (lapack.dpotrf_, lapack.dsyev_)
    )
    kind = "void(*)(char *, char *, int *, double *, int *, double *, double *, int *, int *)"
    solved, count = ffi.cast(kind, eigen), 0

    def counted(*arguments):
        nonlocal count
        count += 1
        solved(*arguments)

    counting = ffi.callback(kind, counted)
    body = unit_mesh(2, 2)
    u = forms.displacement(body)
    F = forms.deformation_gradient(u)
    psi = energies.saint_venant_kirchhoff(F, MU, LMBDA)
    cases = [(psi, 1.0, 0), (ufl.inner(ufl.grad(u[1]), ufl.grad(u[1])), 1.0, 0), (psi, 0.4, 8)]
    lib.projection_set(factorize, counting)
    try:
        for potential, stretch, cells in cases:
            u.interpolate(lambda x, stretch=stretch: (stretch - 1) * x[:2])
            tangent = forms.tangent(forms.residual(potential * ufl.dx, u), u)
            count = 0
            fem.assemble_matrix(forms.compiled(tangent, project=True))
            assert count == cells
    finally:
        lib.projection_set(factorize, eigen)


ONE_RANK_FIRST = """
from mpi4py import MPI
from variform.forms.operators.stretches import StretchFunction
function = StretchFunction(lambda a, b: a**2 + b**2, 2, "psi_hat")
if MPI.COMM_WORLD.rank == 0:
    function.compiled(MPI.COMM_SELF)
kernel, module = function.compiled(MPI.COMM_WORLD)
points = MPI.COMM_WORLD.gather(kernel.num_points)
if MPI.COMM_WORLD.rank == 0:
    print(*points)
"""


def test_a_rank_that_has_compiled_alone_takes_part_again(run):
    """Compiling is collective whatever a rank knows, and the jet is one of a single state."""
    assert run("-c", ONE_RANK_FIRST, ranks=2).stdout.strip() == "1 1"


SANITIZED = """
import os
os.environ.pop("LD_PRELOAD")  # the compiler goes without
from mpi4py import MPI
import numpy as np
import ufl
from dolfinx import fem, mesh
from variform import forms
from variform.forms import energies

rng = np.random.default_rng(1)
body = mesh.create_unit_square(MPI.COMM_SELF, 1, 1)
u = forms.displacement(body)
u.x.array[:] = 0.4 * rng.normal(size=u.x.array.size)
psi = energies.as_rigid_as_possible(forms.deformation_gradient(u), 1.0)
for potential in psi * ufl.dx(degree=2), (psi + ufl.inner(u, u)) * ufl.dx(degree=2):
    K = forms.tangent(forms.residual(potential, u), u)
    assert np.isfinite(fem.assemble_matrix(forms.compiled(K, project=True)).data).all()


def term(s):
    return ufl.conditional(ufl.lt(s, 1), s**2, s**2 + (s - 1) ** 3) - s


# The own loop into PETSc's arrays: cells, facets, springs, supports, two fields, a matrix again.
w = forms.displacement_pressure(body)
(v, p), left = ufl.split(w), mesh.locate_entities_boundary(body, 1, lambda x: np.isclose(x[0], 0))
F = forms.deformation_gradient(v)
mixed = energies.with_pressure(energies.isochoric_neo_hookean(F, 1.0), F, p)
plain = energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0)
u.x.array[:] *= 0.1
for potential, unknown, field in (
    (plain * ufl.dx + psi * ufl.ds + forms.spring(u, 2.0, ufl.ds), u, u),
    (mixed * ufl.dx + forms.spring(v, 2.0, ufl.ds), w, v),
):
    for held in [], [forms.roller(unknown, left, 0)], [forms.clamp(unknown, left)]:
        system = forms.Problem(potential, unknown, held)
        A = system.create_matrix()
        assert A.getAttr("variform_insertion") is not None
        for projected in [False, False] + [True] * system.minimization:
            system.tangent(A, projected)
            assert np.isfinite(A.norm())
assert forms.solve(plain * ufl.dx, u, [forms.clamp(u, left)]).completed


three = energies.principal(lambda a, b, c: term(a) + term(b) + term(c) - 2 * a * b * c)
two = energies.principal(lambda a, b: term(a) + term(b) - 2 * a * b)
for energy, shape in (three, (3, 3)), (two, (3, 2)), (two, (2, 2)):
    F = np.eye(*shape) + 10 ** rng.uniform(-9, 0, (50, 1, 1)) * rng.normal(size=(50, *shape))
    F[3:6] = 0
    for n in 1, 5, 50:
        for project in False, True:
            assert np.isfinite(energy.evaluate(F[:n], project=project)[1]).all()
print("finished")
"""


def test_nothing_is_read_or_written_beyond_its_array(run, tmp_path, monkeypatch):
    """The compiler's sanitizers of addresses and of undefined behavior find nothing in the C.

    In point and cell kernels, projection, and insertion with supports and facets.
    """
    libraries = []
    for name in "libasan.so", "libubsan.so", "libstdc++.so.6":
        command = [*shlex.split(jit.compiler()), f"-print-file-name={name}"]
        found = subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()
        if not Path(found).is_absolute():
            pytest.skip(f"the compiler has no {name}")
        libraries.append(found)
    flags = ["-O0", "-fsanitize=address,undefined", "-fno-sanitize-recover=undefined"]
    flags += jit._native()
    options = {"cffi_extra_compile_args": flags}
    (tmp_path / "dolfinx_jit_options.json").write_text(json.dumps(options))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("LD_PRELOAD", " ".join(libraries))
    monkeypatch.setenv("ASAN_OPTIONS", "detect_leaks=0")
    if run("-c", "from mpi4py import MPI", check=False).returncode:
        pytest.skip("MPI itself does not start with this compiler's libasan loaded")
    done = run("-c", SANITIZED, cwd=tmp_path)
    assert done.stdout.strip() == "finished"
    assert list((tmp_path / "cache" / "fenics").glob("libvariform_*"))
