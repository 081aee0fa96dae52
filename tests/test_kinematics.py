# SPDX-License-Identifier: MIT
"""Kinematics: the identities of document 003, (1)-(5), (13), (22), and the plane models."""

from mpi4py import MPI

import basix.ufl
import numpy as np
import pytest
import ufl
from cases import random_state, unit_mesh
from dolfinx import fem
from ufl.corealg.traversal import unique_pre_traversal

from variform import forms
from variform.forms import kinematics
from variform.forms.differentiation import dependents
from variform.meshes._dolfinx import create_mesh


def evaluate(expression):
    """A UFL expression without mesh as NumPy array."""
    shape = expression.ufl_shape
    lowered = ufl.algorithms.expand_derivatives(expression)
    values = [lowered[i](()) if shape else lowered(()) for i in np.ndindex(shape)]
    return np.array(values, float).reshape(shape)


def matrix(values):
    return ufl.as_matrix(np.asarray(values).tolist())


def at_center(expression, mesh):
    point = np.full((1, mesh.geometry.dim), 1 / 3)
    values = fem.Expression(expression, point).eval(mesh, np.array([0], dtype=np.int32))
    return values.reshape(expression.ufl_shape)


def test_strains_and_products_of_line_elements(rng):
    """1/2 (dx1.dx2 - dX1.dX2) = dX1.E dX2 = dx1.e dx2 for any line elements and any F."""
    F = random_state(rng)
    dX1, dX2 = rng.normal(size=(2, 3))
    dx1, dx2 = F @ dX1, F @ dX2
    f, vectors = matrix(F), [ufl.as_vector(v.tolist()) for v in (dX1, dX2, dx1, dx2)]
    half_difference = (dx1 @ dx2 - dX1 @ dX2) / 2
    assert evaluate(forms.kinematics.spatial_product(f, *vectors[:2])) == pytest.approx(dx1 @ dx2)
    assert evaluate(forms.kinematics.material_product(f, *vectors[2:])) == pytest.approx(dX1 @ dX2)
    E, e = evaluate(forms.kinematics.green_strain(f)), evaluate(forms.kinematics.almansi_strain(f))
    assert dX1 @ E @ dX2 == pytest.approx(half_difference, rel=1e-12)
    assert dx1 @ e @ dx2 == pytest.approx(half_difference, rel=1e-12)


def test_invariants(rng):
    """I = tr C, II = C : C, III = det C = J^2; IV = A.C A = a.a, V = A.C^2 A."""
    F, A = random_state(rng), np.array([0.6, 0.0, 0.8])
    C, f, a = F.T @ F, matrix(F), ufl.as_vector(A.tolist())
    both = *kinematics.invariants(f), *kinematics.fiber_invariants(f, a)
    found = [evaluate(i) for i in both]
    wanted = [np.trace(C), np.sum(C * C), np.linalg.det(C), A @ C @ A, A @ C @ C @ A]
    assert found == pytest.approx(wanted, rel=1e-12)
    assert evaluate(forms.kinematics.deformed_fiber(f, a)) == pytest.approx(F @ A)
    assert evaluate(forms.kinematics.right_cauchy_green(f)) == pytest.approx(C)
    assert evaluate(forms.kinematics.left_cauchy_green(f)) == pytest.approx(F @ F.T)
    assert evaluate(forms.kinematics.volume_ratio(f)) == pytest.approx(np.linalg.det(F))


def test_isochoric_part_keeps_the_volume(rng):
    """det(J^(-1/3) F) = 1."""
    f = matrix(random_state(rng))
    assert evaluate(ufl.det(forms.kinematics.isochoric(f))) == pytest.approx(1, rel=1e-12)


def test_isochoric_invariants(rng):
    """I1 = tr C, I2 = ((tr C)^2 - C : C)/2 of C = J^(-2/3) F^T F; both 3 at rest, exactly."""
    for _ in range(5):
        F = random_state(rng)
        C = np.linalg.det(F) ** (-2 / 3) * F.T @ F
        found = [evaluate(i) for i in kinematics.isochoric_invariants(matrix(F))]
        wanted = [np.trace(C), (np.trace(C) ** 2 - np.sum(C * C)) / 2]
        assert found == pytest.approx(wanted, rel=1e-14)
    rest = kinematics.isochoric_invariants(matrix(np.eye(3)))
    assert [evaluate(i) for i in rest] == [3, 3]


@pytest.mark.parametrize("variable", [False, True])
def test_strains_and_invariants_of_the_isochoric_part(variable, rng):
    """Of J^(-1/3) F they are what NumPy finds, whether the power of J is taken out of them or not.

    Of a ``ufl.variable`` it is not: what is differentiated by has to stay inside.
    """
    F, A = random_state(rng), np.array([0.6, 0.0, 0.8])
    a, f = ufl.as_vector(A.tolist()), ufl.variable(matrix(F))
    part = kinematics.isochoric(f)
    if variable:
        part = ufl.variable(part)
    C = np.linalg.det(F) ** (-2 / 3) * F.T @ F
    strains = kinematics.right_cauchy_green(part), kinematics.green_strain(part)
    for found, wanted in zip(strains, (C, (C - np.eye(3)) / 2), strict=True):
        assert np.abs(evaluate(found) - wanted).max() < 1e-14
    both = *kinematics.invariants(part), *kinematics.fiber_invariants(part, a)
    wanted = [np.trace(C), np.sum(C * C), 1, A @ C @ A, A @ C @ C @ A]
    assert [evaluate(i) for i in both] == pytest.approx(wanted, rel=1e-14)
    inside = [any(node == part for node in unique_pre_traversal(e)) for e in (*strains, *both)]
    assert inside == [variable, variable, variable, variable, True, variable, variable]


@pytest.mark.parametrize("dim", [2, 3])
def test_solid_and_plane_strain(dim):
    """F = I + grad u, with F33 = 1 and no other entry out of the plane."""
    mesh = unit_mesh(dim)
    u = forms.displacement(mesh)
    G = np.array([[0.1, 0.2, 0.3], [-0.2, 0.3, 0.1], [0.05, 0.1, -0.1]])[:dim, :dim]
    u.interpolate(lambda x: G @ x[:dim])
    wanted = np.eye(3)
    wanted[:dim, :dim] += G
    assert at_center(forms.deformation_gradient(u), mesh) == pytest.approx(wanted)


def test_axisymmetric_hoop_stretch_and_volume():
    """U = (a r, b z): F = diag(1 + a, 1 + b, 1 + a); a cylinder's volume is pi R^2 H."""
    mesh = unit_mesh(2)
    u = forms.displacement(mesh)
    u.interpolate(lambda x: (0.2 * x[0], -0.1 * x[1]))
    F = forms.axisymmetric(u)
    assert at_center(F, mesh) == pytest.approx(np.diag([1.2, 0.9, 1.2]))
    deformed = forms.integral(ufl.det(F) * forms.circumference(u) * ufl.dx)
    assert deformed == pytest.approx(np.pi * 1.2**2 * 0.9, rel=1e-12)


def test_incompressible_plane_stress_keeps_the_volume():
    """F33 = 1 / det F2, so that J = 1."""
    mesh = unit_mesh(2)
    u = forms.displacement(mesh)
    u.interpolate(lambda x: (0.3 * x[0] + 0.1 * x[1], 0.2 * x[1]))
    F = forms.plane_stress_incompressible(u)
    assert at_center(ufl.det(F), mesh) == pytest.approx(1, rel=1e-14)


def test_condensed_thickness_stretch_has_no_normal_stress(rng):
    """Plane stress: P33 = 0 at every quadrature point, also far from rest."""
    mesh = unit_mesh(2, 3)
    u = forms.displacement(mesh, degree=2)
    u.x.array[:] = 0.02 * rng.normal(size=u.x.array.size) + stretched(u, 1.6)
    F = forms.plane_stress(u, lambda F: forms.energies.neo_hookean(F, 1.0, 20.0))
    psi = forms.energies.neo_hookean(F, 1.0, 20.0)
    dependent = dependents(psi * ufl.dx)[0]
    dependent.update()
    P33 = forms.stress.first_piola(psi, F)[2, 2]
    dx = ufl.dx(metadata={"quadrature_degree": 4})
    assert np.sqrt(forms.integral(P33**2 * dx)) < 1e-12
    assert np.ptp(dependent.x.array) > 0.1


def stretched(u, stretch):
    moved = fem.Function(u.function_space)
    moved.interpolate(lambda x: ((stretch - 1) * x[0], 0 * x[1]))
    return moved.x.array


def test_condensation_without_a_root_is_nan_and_recovers():
    """Turned inside out, ln J has no root: NaN, which a solve refuses; back again it is found."""
    mesh = unit_mesh(2)
    u = forms.displacement(mesh)
    F = forms.plane_stress(u, lambda F: forms.energies.neo_hookean(F, 1.0, 2.0))
    dependent = dependents(ufl.det(F) * ufl.dx)[0]
    u.x.array[:] = stretched(u, -0.5)
    dependent.update()
    assert np.isnan(dependent.x.array).all()
    u.x.array[:] = 0
    dependent.update()
    assert dependent.x.array == pytest.approx(1, rel=1e-12)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda u, w: forms.deformation_gradient(w),
            "needs 2 components on this mesh, got 3; for a",
        ),
        (lambda u, w: forms.axisymmetric(u[0]), r"2 or 3 components, got shape \(\)"),
        (
            lambda u, w: kinematics.fiber_invariants(ufl.Identity(3), ufl.as_vector([1, 0])),
            r"\(2,\)",
        ),
        (lambda u, w: forms.energies.neo_hookean(ufl.Identity(2), 1, 1), r"got shape \(2, 2\)"),
    ],
)
def test_wrong_shapes_are_refused(call, message):
    mesh = unit_mesh(2)
    u, w = forms.displacement(mesh), forms.displacement_pressure(mesh)
    with pytest.raises(ValueError, match=message):
        call(u, w)


def test_a_membrane_is_refused():
    """Cells that do not fill their space have no 3x3 deformation gradient of this kind."""
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0.5]])
    element = basix.ufl.element("Lagrange", "triangle", 1, shape=(3,))
    surface = create_mesh(MPI.COMM_SELF, element, points, np.array([[0, 1, 2]], dtype=np.int64))
    u = forms.displacement(surface)
    with pytest.raises(ValueError, match="got cells of dimension 2 in 3 dimensions"):
        forms.deformation_gradient(u)


def test_the_hoop_stretch_on_the_axis_is_its_limit():
    """F33 -> 1 + u_r,r at r = 0: fields at nodes on the axis are finite."""
    mesh = unit_mesh(2, 2)
    u = forms.displacement(mesh)
    u.interpolate(lambda x: (0.2 * x[0], 0 * x[1]))
    F = forms.axisymmetric(u)
    assert forms.at(forms.field(F, mesh), (0.0, 0.5)).reshape(3, 3)[2, 2] == pytest.approx(1.2)


def test_models_for_plane_bodies_refuse_solids():
    u = forms.displacement(unit_mesh(3))
    for model in (forms.axisymmetric, forms.plane_stress_incompressible):
        with pytest.raises(ValueError, match=r"got shape \(3,\)"):
            model(u)
    with pytest.raises(ValueError, match=r"got shape \(3,\)"):
        forms.plane_stress(u, lambda F: forms.energies.neo_hookean(F, 1, 1))
    plane = forms.displacement(unit_mesh(2))
    F = forms.deformation_gradient(plane)
    with pytest.raises(ValueError, match="as a function of F, .* got Sum"):
        forms.plane_stress(plane, forms.energies.neo_hookean(F, 1, 1))
