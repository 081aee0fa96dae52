# SPDX-License-Identifier: MIT
"""Laws of the default quadrature: which degree an integrand gets, and what it costs in accuracy."""

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem

from variform import forms, meshes
from variform.forms import energies
from variform.forms.quadrature import with_quadrature


def degrees(potential, u):
    """Default degrees of a form's integrals."""
    k = u.function_space.ufl_element().embedded_superdegree
    return [i.metadata()["quadrature_degree"] for i in with_quadrature(potential, k).integrals()]


def body(cells, order=1):
    if order == 2:
        return meshes.sphere_octant(MPI.COMM_SELF, 0.5, 1.0, 0.5, order=2)
    if cells in ("triangle", "quadrilateral"):
        return meshes.cook(MPI.COMM_SELF, n=2, cells=cells)
    return meshes.block(MPI.COMM_SELF, (1.0, 1.0, 1.0), n=(2, 2, 2), cells=cells)


@pytest.mark.parametrize("energy", ["neo_hookean", "fixed_corotated"])
@pytest.mark.parametrize(
    ("cells", "order", "expected"),
    [
        ("tetrahedron", 1, {1: 1, 2: 2, 3: 4}),
        ("triangle", 1, {1: 1, 2: 2, 3: 4}),
        ("hexahedron", 1, {1: 2, 2: 4}),
        ("quadrilateral", 1, {1: 2, 2: 4}),
        ("tetrahedron", 2, {2: 4}),
    ],
)
def test_energies_of_gradients(energy, cells, order, expected):
    """2 k - 2 in straight simplices, at least 1; 2 k in all other cells."""
    domain = body(cells, order)
    for k, degree in expected.items():
        u = forms.displacement(domain, k)
        F = forms.deformation_gradient(u)
        assert degrees(getattr(energies, energy)(F, 1.0, 2.0) * ufl.dx, u) == [degree]


def test_whatever_else_is_in_the_integrand_counts():
    """Parameters that vary, the displacement itself, a pressure; what is chosen is kept."""
    domain = body("tetrahedron")
    mesh = domain.mesh
    u = forms.displacement(domain, 2)
    F = forms.deformation_gradient(u)
    x = ufl.SpatialCoordinate(mesh)

    def energy(mu):
        return energies.neo_hookean(F, mu, 2.0)

    constant = fem.Constant(mesh, 1.0)
    by_cell = fem.Function(fem.functionspace(mesh, ("DG", 0)))
    quadratic = fem.Function(fem.functionspace(mesh, ("Lagrange", 2)))
    cubic = fem.Function(fem.functionspace(mesh, ("Lagrange", 3)))
    found = {
        2: [energy(constant), energy(by_cell), energy(1 + x[0]), energy(1 + ufl.CellVolume(mesh))],
        4: [energy(1 + quadratic), energy(1 + cubic), energy(1.0) - ufl.dot(u, u)],
    }
    for degree, integrands in found.items():
        for psi in integrands:
            assert degrees(psi * ufl.dx, u) == [degree]
    both = energy(1.0) * ufl.dx + forms.body_force(u, ufl.as_vector([0, 0, 1]))
    assert degrees(both, u) == [2, 4]
    assert degrees(energy(1.0) * ufl.dx(degree=7), u) == [7]
    load = forms.dead_traction(u, ufl.as_vector([0, 0, 1]), domain.ds("right"))
    assert degrees(load, u) == [5]
    w = forms.displacement_pressure(domain)
    v, p = ufl.split(w)
    F = forms.deformation_gradient(v)
    mixed = energies.with_pressure(energies.isochoric_neo_hookean(F, 1.0), F, p) * ufl.dx
    assert [i.metadata()["quadrature_degree"] for i in with_quadrature(mixed, 2).integrals()] == [4]


def test_revolution_and_condensed_sheets_keep_theirs():
    """The radius and u/r are no gradients; the thickness lives on points of its own degree."""
    domain = body("triangle")
    u = forms.displacement(domain, 2)
    F = forms.axisymmetric(u)
    psi = energies.neo_hookean(F, 1.0, 2.0)
    assert degrees(psi * forms.circumference(u) * ufl.dx, u) == [4]

    def energy(F):
        return energies.neo_hookean(F, 1.0, 2.0)

    assert degrees(energy(forms.plane_stress(u, energy)) * ufl.dx, u) == [4]


def test_one_point_is_exact_for_linear_elements(rng):
    """P1: the gradient is constant in a cell, so any rule gives the same energy and forces."""
    u = forms.displacement(body("tetrahedron"), 1)
    psi = energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0)
    u.x.array[:] = 0.05 * rng.normal(size=u.x.array.size)
    one, many = forms.Problem(psi * ufl.dx, u), forms.Problem(psi * ufl.dx(degree=6), u)
    assert one.energy() == pytest.approx(many.energy(), rel=1e-13)
    a, b = one.create_vector(), many.create_vector()
    one.residual(a)
    many.residual(b)
    assert np.allclose(a.array, b.array, rtol=0, atol=1e-13 * np.abs(b.array).max())


@pytest.mark.parametrize("k", [2, 3])
def test_order_of_convergence_stays(k):
    """The energy of a bent block goes to its limit as fast with the default as with 2 k + 2."""
    errors = []
    for degree in (None, 2 * k + 2):
        found = []
        for n in (2, 4, 8) if k == 2 else (1, 2, 4):
            domain = meshes.block(MPI.COMM_SELF, (1.0, 1.0, 1.0), n=(n, n, n))
            u = forms.displacement(domain, k)
            u.interpolate(lambda x: 0.2 * np.array([np.sin(2 * x[1]), x[2] ** 3, np.cos(x[0])]))
            psi = energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0)
            dx = ufl.dx if degree is None else ufl.dx(degree=degree)
            found.append(forms.Problem(psi * dx, u).energy())
        errors.append(np.abs(np.diff(found)))
    rates = [np.log2(e[0] / e[1]) for e in errors]
    assert rates[0] > min(rates[1], 2 * k - 2) - 0.3


ROUGH = {
    "neo_hookean": lambda u, F: energies.neo_hookean(F, 1.0, 2.0) * ufl.dx,
    "fixed_corotated": lambda u, F: energies.fixed_corotated(F, 1.0, 2.0) * ufl.dx,
    "loaded": lambda u, F: (
        energies.stable_neo_hookean(F, 1.0, 2.0) * ufl.dx
        + forms.body_force(u, ufl.SpatialCoordinate(u.function_space.mesh))
        + forms.spring(u, 1.0, ufl.ds)
    ),
}


@pytest.mark.parametrize("cells", ["tetrahedron", "quadrilateral"])
@pytest.mark.parametrize("case", ROUGH)
def test_one_rule_wherever_a_form_is_compiled(case, cells, rng):
    """At a rough state, where rules differ by 1e-3: system, integral and compiled agree."""
    u = forms.displacement(body(cells), 2)
    u.x.array[:] = 0.02 * rng.standard_normal(u.x.array.size)
    potential = ROUGH[case](u, forms.deformation_gradient(u))
    system = forms.Problem(potential, u)
    assert forms.integral(potential) == pytest.approx(system.energy(), rel=1e-14)
    b = system.create_vector()
    system.residual(b)
    compiled = fem.assemble_vector(forms.compiled(forms.residual(potential, u))).array
    assert np.abs(compiled - b.array).max() < 1e-13 * np.abs(b.array).max()
    finer = {"quadrature_degree": 6}
    fine = ufl.Form([i.reconstruct(metadata=finer) for i in potential.integrals()])
    assert abs(forms.integral(fine) / system.energy() - 1) > 1e-6


def test_a_volume_is_exact(rng):
    """J of P2 has degree 3, above the default of energies: volume() asks for it."""
    u = forms.displacement(body("tetrahedron"), 2)
    u.x.array[:] = 0.02 * rng.standard_normal(u.x.array.size)
    F = forms.deformation_gradient(u)
    exact = forms.volume(F, ufl.dx(degree=3))
    assert forms.volume(F, ufl.dx(u.function_space.mesh)) == pytest.approx(exact, rel=1e-14)
    assert abs(forms.integral(ufl.det(F) * ufl.dx) / exact - 1) > 1e-9
