# SPDX-License-Identifier: MIT
"""Residual and tangent are the derivatives of the potential, and equal the forms by hand."""

import numpy as np
import pytest
import ufl
from cases import ENERGIES, STRETCHES, rates, unit_mesh
from dolfinx import fem
from dolfinx.mesh import CellType

from variform import forms
from variform.forms import stress
from variform.forms.differentiation import dependents
from variform.forms.quadrature import with_quadrature

H = 0.004 / 2.0 ** np.arange(3)


def solid(u, psi):
    return psi(forms.deformation_gradient(u)) * ufl.dx


def axisymmetric(u, psi):
    return psi(forms.axisymmetric(u)) * forms.circumference(u) * ufl.dx


def incompressible_sheet(u, psi):
    return psi(forms.plane_stress_incompressible(u)) * ufl.dx


def sheet(u, psi):
    F = forms.plane_stress(u, psi, degree=2)
    return psi(F) * ufl.dx


KINEMATICS = {
    "solid": (3, solid),
    "plane_strain": (2, solid),
    "axisymmetric": (2, axisymmetric),
    "plane_stress": (2, sheet),
    "plane_stress_incompressible": (2, incompressible_sheet),
}


def expansion(potential, u, rng, amplitude=1.0, matrix=True):
    """Remainders of E(u + h v) after the linear term, and after the quadratic one, over h.

    K[v, v] is by the assembled matrix or, without, by the form K[v, .], which compiles up to ten
    times as fast where the energy is long.
    """
    potential = with_quadrature(potential, 1)
    R = forms.residual(potential, u)
    K = forms.tangent(R, u)
    direction = fem.Function(u.function_space)
    E, r, K = map(forms.compiled, (potential, R, K if matrix else ufl.action(K, direction)))
    chained = dependents(potential)

    def energy():
        for coefficient in chained:
            coefficient.update()
        return fem.assemble_scalar(E)

    start = u.x.array.copy()
    v = amplitude * rng.normal(size=start.size)
    E0 = energy()
    first = fem.assemble_vector(r).array @ v
    if matrix:
        A = fem.assemble_matrix(K)
        A.scatter_reverse()
        second = v @ (A.to_scipy() @ v)
    else:
        direction.x.array[:] = v
        second = fem.assemble_vector(K).array @ v
    linear, quadratic = [], []
    for h in H:
        u.x.array[:] = start + h * v
        change = energy() - E0
        linear.append(abs(change - h * first))
        quadratic.append(abs(change - h * first - h**2 / 2 * second))
    u.x.array[:] = start
    return linear, quadratic


# plane_stress condenses energies in plain UFL only.
CASES = [(name, kinematics) for name in ENERGIES for kinematics in KINEMATICS]
CASES += [(n, k) for n in STRETCHES for k in KINEMATICS if k != "plane_stress"]


@pytest.mark.parametrize(("name", "kinematics"), CASES)
def test_residual_and_tangent_are_the_derivatives(name, kinematics, rng):
    """E(u + h v) = E + h R[v] + h^2/2 K[v, v] + O(h^3): halving h divides by 4, then by 8."""
    dim, potential = KINEMATICS[kinematics]
    u = forms.displacement(unit_mesh(dim))
    u.x.array[:] = 0.1 * rng.normal(size=u.x.array.size)
    psi = potential(u, (ENERGIES | STRETCHES)[name])
    matrix = name in STRETCHES or kinematics not in ("solid", "plane_stress")
    linear, quadratic = expansion(psi, u, rng, amplitude=0.5, matrix=matrix)
    assert rates(linear)[-1] == pytest.approx(2, abs=0.15)
    assert rates(quadratic)[-1] == pytest.approx(3, abs=0.15)


@pytest.mark.parametrize("kappa", [None, 50.0])
@pytest.mark.parametrize("dim", [2, 3])
def test_mixed_potential_too(dim, kappa, rng):
    """The same expansion for a displacement-pressure potential, in both unknowns at once."""
    w = forms.displacement_pressure(unit_mesh(dim))
    w.x.array[:] = 0.05 * rng.normal(size=w.x.array.size)
    u, p = ufl.split(w)
    F = forms.deformation_gradient(u)
    psi = forms.energies.with_pressure(forms.energies.mooney_rivlin(F, 0.4, 0.2), F, p, kappa)
    linear, quadratic = expansion(psi * ufl.dx, w, rng, amplitude=0.1, matrix=dim == 2)
    assert rates(linear)[-1] == pytest.approx(2, abs=0.15)
    assert rates(quadratic)[-1] == pytest.approx(3, abs=0.15)


def test_scalar_unknown(rng):
    """A scalar unknown is served alike: D int (1 + u^2) |grad u|^2, twice."""
    mesh = unit_mesh(2, 2)
    u = fem.Function(fem.functionspace(mesh, ("Lagrange", 2)))
    u.x.array[:] = rng.normal(size=u.x.array.size)
    potential = (1 + u**2) * ufl.inner(ufl.grad(u), ufl.grad(u)) * ufl.dx
    linear, quadratic = expansion(potential, u, rng)
    assert rates(linear)[-1] == pytest.approx(2, abs=0.15)
    assert rates(quadratic)[-1] == pytest.approx(3, abs=0.15)


def assembled(form):
    compiled = fem.form(form)
    if compiled.rank == 1:
        return fem.assemble_vector(compiled).array
    matrix = fem.assemble_matrix(compiled)
    return matrix.to_dense()


CELLS = {
    "tetrahedron": (3, CellType.tetrahedron),
    "hexahedron": (3, CellType.hexahedron),
    "triangle": (2, CellType.triangle),
}


@pytest.mark.parametrize("cells", CELLS)
@pytest.mark.parametrize("name", ["neo_hookean", "transversely_isotropic"])
def test_virtual_work_by_hand_equals_the_automatic_one(name, cells, rng):
    """(29) and (52), (32) and (34) assembled on a deformed mesh equal the Gateaux derivatives."""
    dim, kind = CELLS[cells]
    u = forms.displacement(unit_mesh(dim, 1, kind))
    u.x.array[:] = 0.1 * rng.normal(size=u.x.array.size)
    V = u.function_space
    v, du = ufl.TestFunction(V), ufl.TrialFunction(V)
    F = forms.deformation_gradient(u)
    psi = ENERGIES[name](F)
    dx = ufl.dx(metadata={"quadrature_degree": 2})
    automatic = forms.residual(psi * dx, u)
    R, K = assembled(automatic), assembled(forms.tangent(automatic, u))
    S, sigma = stress.second_piola(psi, F), stress.cauchy(psi, F)
    CC, c = stress.material_elasticity(psi, F), stress.spatial_elasticity(psi, F)
    by_hand = {
        "(29)": (forms.by_hand.material_virtual_work(S, F, u, v, dx), R),
        "(52)": (forms.by_hand.spatial_virtual_work(sigma, F, u, v, dx), R),
        "(32)": (forms.by_hand.linearized_material(S, CC, F, u, v, du, dx), K),
        "(34)": (forms.by_hand.linearized_spatial(sigma, c, F, u, v, du, dx), K),
    }
    for equation, (form, wanted) in by_hand.items():
        error = np.abs(assembled(form) - wanted).max() / np.abs(wanted).max()
        assert error < 1e-12, equation
    assert np.abs(K - K.T).max() < 1e-13 * np.abs(K).max()


def test_virtual_work_of_a_body_of_revolution(rng):
    """(29), (34) with the hoop's rate: the same in the meridian plane."""
    u = forms.displacement(unit_mesh(2))
    u.x.array[:] = 0.1 * rng.normal(size=u.x.array.size)
    V = u.function_space
    v, du = ufl.TestFunction(V), ufl.TrialFunction(V)
    F = forms.axisymmetric(u)
    psi = ENERGIES["neo_hookean"](F)
    # Measures hold no weights: put the circumference into the stresses.
    ring = forms.circumference(u)
    dx = ufl.dx(metadata={"quadrature_degree": 2})
    automatic = forms.residual(ring * psi * dx, u)
    S, sigma = ring * stress.second_piola(psi, F), ring * stress.cauchy(psi, F)
    c = ring * stress.spatial_elasticity(psi, F)
    R, K = assembled(automatic), assembled(forms.tangent(automatic, u))
    r = assembled(forms.by_hand.material_virtual_work(S, F, u, v, dx))
    k = assembled(forms.by_hand.linearized_spatial(sigma, c, F, u, v, du, dx))
    assert np.abs(r - R).max() < 1e-12 * np.abs(R).max()
    assert np.abs(k - K).max() < 1e-12 * np.abs(K).max()


def test_pushes_and_pulls_are_inverse(rng):
    """(12) and sigma = J^-1 F S F^T, there and back; c by push-forward equals c from A."""
    mesh = unit_mesh(3)
    u = forms.displacement(mesh)
    u.x.array[:] = 0.1 * rng.normal(size=u.x.array.size)
    F = forms.deformation_gradient(u)
    psi = ENERGIES["saint_venant_kirchhoff"](F)
    S, sigma = stress.second_piola(psi, F), stress.cauchy(psi, F)
    CC, c = stress.material_elasticity(psi, F), stress.spatial_elasticity(psi, F)
    pairs = [
        (stress.push_forward(S, F), sigma),
        (stress.pull_back(sigma, F), S),
        (stress.kirchhoff(psi, F), ufl.det(F) * sigma),
        (
            stress.voigt_elasticity(stress.push_forward_elasticity(CC, F)),
            stress.voigt_elasticity(c),
        ),
        (stress.voigt_elasticity(stress.pull_back_elasticity(c, F)), stress.voigt_elasticity(CC)),
    ]
    dx = ufl.dx(metadata={"quadrature_degree": 1})
    for found, wanted in pairs:
        difference = found - wanted
        error = forms.integral(ufl.inner(difference, difference) * dx)
        assert error < 1e-24 * forms.integral(ufl.inner(wanted, wanted) * dx)


def test_voigt_product_is_the_contraction(rng):
    """sigma^ = c^ eps^ (27), (28), (45) equals sigma_ij = c_ijkl eps_kl."""
    mesh = unit_mesh(3)
    u = forms.displacement(mesh)
    u.x.array[:] = 0.1 * rng.normal(size=u.x.array.size)
    F = forms.deformation_gradient(u)
    c = stress.spatial_elasticity(ENERGIES["transversely_isotropic"](F), F)
    eps = forms.kinematics.almansi_strain(F)
    i, j, k, n = ufl.indices(4)
    contracted = stress.voigt_stress(ufl.as_tensor(c[i, j, k, n] * eps[k, n], (i, j)))
    product = stress.voigt_elasticity(c) * stress.voigt_strain(eps)
    difference = contracted - product
    dx = ufl.dx(metadata={"quadrature_degree": 1})
    size = forms.integral(ufl.inner(product, product) * dx)
    assert forms.integral(ufl.inner(difference, difference) * dx) < 1e-26 * size


def test_forms_of_the_wrong_kind_are_refused():
    mesh = unit_mesh(2)
    u, other = forms.displacement(mesh), forms.displacement(mesh)
    psi = ENERGIES["neo_hookean"](forms.deformation_gradient(u))
    R = forms.residual(psi * ufl.dx, u)
    with pytest.raises(ValueError, match="got ListTensor|got Sum; integrate a density with ufl.dx"):
        forms.residual(psi, u)
    with pytest.raises(ValueError, match="residual needs a potential.*a form with 1 arguments"):
        forms.residual(R, u)
    with pytest.raises(ValueError, match="tangent needs a residual.*a form with 0 arguments"):
        forms.tangent(psi * ufl.dx, u)
    with pytest.raises(ValueError, match="does not contain"):
        forms.residual(psi * ufl.dx, other)
    with pytest.raises(ValueError, match="needs the ufl.variable F"):
        stress.first_piola(psi, ufl.Identity(3))
    with pytest.raises(ValueError, match="psi was not written with this F"):
        stress.first_piola(psi, forms.deformation_gradient(u))


def test_wrong_derivatives_would_be_caught(rng):
    """The expansion can fail: a tangent that is 1 % off leaves a remainder of second order."""
    u = forms.displacement(unit_mesh(2))
    u.x.array[:] = 0.1 * rng.normal(size=u.x.array.size)
    potential = solid(u, ENERGIES["neo_hookean"])
    linear, quadratic = expansion(potential, u, rng, amplitude=0.5)
    wrong = np.array(quadratic) + 0.01 * np.array(linear)
    assert rates(wrong)[-1] < 2.5
