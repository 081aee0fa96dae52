# SPDX-License-Identifier: MIT
"""Sheets in space: their gradient, energies, volume and sides; a sphere under pressure."""

from math import pi

from mpi4py import MPI

import basix.ufl
import numpy as np
import pytest
import ufl
from cases import MU, agree, random_rotation, rates
from dolfinx import mesh
from test_variation import expansion

from variform import forms, meshes
from variform.forms import energies
from variform.meshes._dolfinx import create_mesh

SHEETS = {
    "disk": (lambda o: meshes.disk(MPI.COMM_SELF, 1.0, 0.2, o), pi, 0),
    "annulus": (lambda o: meshes.disk(MPI.COMM_SELF, 1.0, 0.2, o, inner_radius=0.5), 0.75 * pi, 0),
    "quarter disk": (lambda o: meshes.disk(MPI.COMM_SELF, 1.0, 0.2, o, quarter=True), pi / 4, 0),
    "square": (lambda o: meshes.square(MPI.COMM_SELF, 2.0, 0.3, o), 4, 0),
    "quarter square": (lambda o: meshes.square(MPI.COMM_SELF, 2.0, 0.3, o, quarter=True), 1, 0),
    "pillow": (lambda o: meshes.pillow(MPI.COMM_SELF, 2.0, 0.3, o), 8, 0),
    "sphere": (lambda o: meshes.spherical_sheet(MPI.COMM_SELF, 1.0, 0.2, o), 4 * pi, 4 / 3 * pi),
    "hemisphere": (
        lambda o: meshes.spherical_sheet(MPI.COMM_SELF, 1.0, 0.2, o, "hemisphere"),
        2 * pi,
        2 / 3 * pi,
    ),
    "octant": (
        lambda o: meshes.spherical_sheet(MPI.COMM_SELF, 1.0, 0.2, o, "octant"),
        pi / 2,
        pi / 6,
    ),
    # Its volume is that of the cone over it: two thirds of the cylinder's 2 pi.
    "cylinder": (
        lambda o: meshes.cylindrical_sheet(MPI.COMM_SELF, 1.0, 2.0, 0.2, o),
        4 * pi,
        4 / 3 * pi,
    ),
}


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("name", SHEETS)
def test_areas_volumes_and_sides(name, order):
    """Area and volume to h^2 (h^4) of the surface's curvature; all normals on one side."""
    make, area, volume = SHEETS[name]
    body = make(order)
    u = forms.displacement(body, degree=order)
    allowed = {1: 1e-2, 2: 1e-4}[order]
    dx = ufl.dx(degree=4)
    assert forms.integral(1 * ufl.dx(domain=body.mesh, degree=4)) == pytest.approx(
        area, rel=allowed
    )
    side = forms.membranes.orientation(body)
    assert np.all(side.x.array == 1)
    found = forms.integral(forms.enclosed_volume(u, side, dx))
    assert found == pytest.approx(volume, rel=2 * allowed, abs=1e-14)
    if volume == 0:
        up = forms.membranes.area_vector(forms.membrane_gradient(u))[2]
        assert forms.integral(up * ufl.dx) == pytest.approx(
            0 if name == "pillow" else area, rel=allowed
        )


def test_the_pillow_has_its_upper_side_up():
    body = meshes.pillow(MPI.COMM_SELF, 2.0, 0.5)
    up = forms.membranes.area_vector(forms.membrane_gradient(forms.displacement(body)))[2]
    assert forms.integral(up * body.dx("upper")) == pytest.approx(4, rel=1e-12)
    assert forms.integral(up * body.dx("lower")) == pytest.approx(-4, rel=1e-12)


SHEET_ENERGIES = {
    "neo_hookean_sheet": lambda F: energies.neo_hookean_sheet(F, MU),
    "mooney_rivlin_sheet": lambda F: energies.mooney_rivlin_sheet(F, 0.4, 0.25),
    "saint_venant_kirchhoff_sheet": lambda F: energies.saint_venant_kirchhoff_sheet(F, 2.0, 0.3),
    "sheet": lambda F: energies.sheet(F, lambda I1, I2, I3: I2 - 2 * I1 + I3**2 - 2 * I3 + 3),
    "reduced": lambda F: energies.yeoh(forms.membranes.incompressible_sheet(F), 0.6, -0.05, 0.02),
    "principal": lambda F: energies.principal(
        lambda s1, s2: MU / 2 * (s1**2 + s2**2 + 1 / (s1 * s2) ** 2 - 3)
    )(F),
}


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("name", SHEET_ENERGIES)
def test_residual_and_tangent_are_the_derivatives(name, order, rng):
    """Taylor rates 2 and 3 on a curved surface, with the pressure's potential."""
    body = meshes.spherical_sheet(MPI.COMM_SELF, 1.0, 0.7, order, "octant")
    u = forms.displacement(body, degree=2)
    u.interpolate(lambda x: 0.2 * x)
    u.x.array[:] += 0.02 * rng.normal(size=u.x.array.size)
    F = forms.membrane_gradient(u)
    potential = 0.1 * SHEET_ENERGIES[name](F) * ufl.dx - 0.05 * forms.enclosed_volume(u)
    linear, quadratic = expansion(potential, u, rng, amplitude=0.05, matrix=order == 1)
    assert rates(linear)[-1] == pytest.approx(2, abs=0.15)
    assert rates(quadratic)[-1] == pytest.approx(3, abs=0.15)


@pytest.mark.parametrize("name", SHEET_ENERGIES)
def test_rest_and_rigid_motions_cost_nothing(name, rng):
    body = meshes.cylindrical_sheet(MPI.COMM_SELF, 1.0, 1.0, 0.6, 2)
    u = forms.displacement(body, degree=2)
    psi = SHEET_ENERGIES[name](forms.membrane_gradient(u))
    Q, shift = random_rotation(rng), rng.normal(size=(3, 1))
    for motion in (lambda x: 0 * x, lambda x: Q @ x + shift - x):
        u.interpolate(motion)
        assert abs(forms.integral(psi * ufl.dx(degree=4))) < 1e-13


def test_the_ways_to_write_a_sheet_agree(rng):
    """The sheet's energy, the solid's with normal stretch 1/I3, psi_hat(s1, s2): 12 digits."""
    body = meshes.disk(MPI.COMM_SELF, 1.0, 0.5)
    u = forms.displacement(body, degree=2)
    u.x.array[:] = 0.05 * rng.normal(size=u.x.array.size)
    F = forms.membrane_gradient(u)
    solid = forms.membranes.incompressible_sheet(F)
    ways = [
        energies.neo_hookean_sheet(F, MU),
        energies.isochoric_neo_hookean(solid, MU),
        energies.mooney_rivlin_sheet(F, MU / 2, 0.0),
        SHEET_ENERGIES["principal"](F),
    ]
    assert forms.integral((ufl.det(solid) - 1) ** 2 * ufl.dx(degree=4)) < 1e-28
    systems = [forms.Problem(psi * ufl.dx, u) for psi in ways]
    found = []
    for system in systems:
        b, A = system.create_vector(), system.create_matrix()
        system.residual(b)
        system.tangent(A)
        found.append((b.array.copy(), A.getValuesCSR()[2].copy()))
    for other in found[1:]:
        for a, b in zip(other, found[0], strict=True):
            agree(a, b, 12)


def test_areas_grow_with_I3():
    """A sphere blown up by 1.3: its area is int I3 dA, its volume that of the larger sphere."""
    body = meshes.spherical_sheet(MPI.COMM_SELF, 1.0, 0.3, 2)
    u = forms.displacement(body, degree=2)
    u.interpolate(lambda x: 0.3 * x)
    F = forms.membrane_gradient(u)
    I1, I2, I3 = forms.membranes.membrane_invariants(F)
    area = forms.integral(1 * ufl.dx(domain=body.mesh, degree=4))
    dx = ufl.dx(degree=4)
    assert forms.integral(I3 * dx) == pytest.approx(1.69 * area, rel=1e-12)
    assert forms.integral(I1 * dx) == pytest.approx(2.6 * area, rel=1e-12)
    assert forms.integral(I2 * dx) == pytest.approx(2 * 1.69 * area, rel=1e-12)
    rest = forms.displacement(body, degree=2)
    before = forms.integral(forms.enclosed_volume(rest, 1, dx))
    assert forms.integral(forms.enclosed_volume(u, 1, dx)) == pytest.approx(1.3**3 * before)


def test_pressure_is_the_derivative_of_the_volume(rng):
    """On a closed surface - int p n . v da = - p D V[v], to 13 digits."""
    body = meshes.spherical_sheet(MPI.COMM_SELF, 1.0, 0.5, 2)
    u = forms.displacement(body, degree=2)
    u.x.array[:] = 0.02 * rng.normal(size=u.x.array.size)
    v = ufl.TestFunction(u.function_space)
    work = forms.membranes.membrane_pressure(u, 0.7, v, dx=ufl.dx(degree=6))
    derived = forms.residual(-0.7 * forms.enclosed_volume(u, dx=ufl.dx(degree=6)), u)
    found, wanted = (forms.Problem(form, u).create_vector() for form in (work, derived))
    for b, form in ((found, work), (wanted, derived)):
        forms.Problem(form, u).residual(b)
    agree(found.array, wanted.array, 13)


@pytest.mark.parametrize("degree", [1, 2])
def test_sphere_under_pressure(degree):
    """Pressure 2 mu t/r (1/l - 1/l^7) gives the stretch l = 1.2, to h^2 and better than h^3."""
    stretch, errors = 1.2, []
    p = 2 * (1 / stretch - stretch**-7)
    for h in (0.4, 0.2):
        body = meshes.spherical_sheet(MPI.COMM_SELF, 1.0, h, degree, "octant")
        u, t = forms.displacement(body, degree=degree), forms.load_factor(body)
        psi = energies.neo_hookean_sheet(forms.membrane_gradient(u), 1.0)
        held = [forms.roller(u, body.facets(f"{a}0"), k) for k, a in enumerate("xyz")]
        potential = psi * ufl.dx - t * p * forms.enclosed_volume(u)
        path = forms.follow(potential, u, held, t, step=0.25, progress=False)
        volume = forms.integral(forms.enclosed_volume(u, 1, ufl.dx(degree=6)))
        errors.append(abs(volume / (pi / 6 * stretch**3) - 1))
        assert path.completed
    order = rates(errors)[-1]
    assert errors[-1] < {1: 0.06, 2: 2e-4}[degree]
    assert order == pytest.approx(2, abs=0.4) if degree == 1 else order > 3


def surface(cells, points):
    element = basix.ufl.element("Lagrange", "triangle", 1, shape=(3,))
    return create_mesh(MPI.COMM_SELF, element, np.array(points, float), np.array(cells))


def test_cells_that_are_numbered_the_other_way_are_found():
    """One cell of a square turned: its side is -1, and the volume under the sheet is right."""
    points = [(0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1), (0.5, 0.5, 1)]
    body = surface([(0, 1, 4), (2, 1, 4), (2, 3, 4), (3, 0, 4)], points)
    side = forms.membranes.orientation(body)
    assert sorted(side.x.array) == [-1, 1, 1, 1]
    u = forms.displacement(body)
    assert forms.integral(forms.enclosed_volume(u, side)) == pytest.approx(1 / 3)


def test_surfaces_without_two_sides_are_refused():
    n = 12
    strip = []
    for k in range(n):
        angle = 2 * pi * k / n
        for r in (-0.3, 0.3):
            radius = 1 + r * np.cos(angle / 2)
            strip.append((radius * np.cos(angle), radius * np.sin(angle), r * np.sin(angle / 2)))
    cells = []
    for k in range(n):
        a, b = 2 * k, 2 * k + 1
        c, d = (2 * k + 2, 2 * k + 3) if k < n - 1 else (1, 0)
        cells += [(a, b, c), (b, d, c)]
    with pytest.raises(ValueError, match="the surface has one side only"):
        forms.membranes.orientation(surface(cells, strip))
    star = [(0, 0, 0), (0, 0, 1), (1, 0, 0), (0, 1, 0), (-1, -1, 0)]
    with pytest.raises(ValueError, match="3 cells meet at an edge"):
        forms.membranes.orientation(surface([(0, 1, 2), (0, 1, 3), (0, 1, 4)], star))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda u, F: energies.neo_hookean_sheet(ufl.Identity(3), 1.0),
            r"needs a 3x2 F, got shape \(3, 3\)",
        ),
        (lambda u, F: energies.neo_hookean_sheet(F, -1.0), "mu must be positive, got -1.0"),
        (lambda u, F: energies.saint_venant_kirchhoff_sheet(F, 1.0, 0.5), "got nu = 0.5"),
        (lambda u, F: forms.membrane_gradient(u[0]), r"displacement of shape \(3,\), got \(\)"),
        (
            lambda u, F: forms.membranes.membrane_pressure(u, u, u),
            r"scalar p and a test function v of shape \(3,\), got shapes \(3,\) and \(3,\)",
        ),
        (lambda u, F: forms.deformation_gradient(u), "cells of dimension 2 in 3 dimensions"),
        (lambda u, F: meshes.spherical_sheet(MPI.COMM_SELF, 1.0, 0.5, part="half"), "got 'half'"),
        (lambda u, F: meshes.disk(MPI.COMM_SELF, 1.0, 0.5, inner_radius=2.0), "inner_radius=2.0"),
    ],
)
def test_bad_input_gets_one_sentence(call, message):
    body = meshes.square(MPI.COMM_SELF, 1.0, 1.0)
    u = forms.displacement(body)
    with pytest.raises(ValueError, match=message):
        call(u, forms.membrane_gradient(u))


def test_a_plane_mesh_is_no_surface_in_space():
    u = forms.displacement(mesh.create_unit_square(MPI.COMM_SELF, 1, 1))
    with pytest.raises(ValueError, match="needs a surface mesh, .* got 2 in 2"):
        forms.membrane_gradient(u)
