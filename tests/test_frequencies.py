# SPDX-License-Identifier: MIT
"""Frequencies: closed forms of bars, beams and strings, free bodies, unstable states, ranks."""

from math import pi

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from conftest import scripts
from scipy.optimize import brentq

from variform import forms, meshes


def strip(length, height, n, degree=2, energy=None):
    """A bar in the plane without lateral contraction, E = 1, rho = 1."""
    body = meshes.block(
        MPI.COMM_SELF, (length, height), n=(n, 1), cells="quadrilateral", origin=(0, -height / 2)
    )
    u = forms.displacement(body, degree)
    psi = energy or (lambda F: forms.energies.saint_venant_kirchhoff(F, 0.5, 0.0))
    return body, u, psi(forms.deformation_gradient(u)) * ufl.dx


def test_axial_modes_of_a_bar():
    """omega_n = (2 n - 1) pi/2 sqrt(E / rho) / L, to 1e-3; the modes are sines."""
    body, u, potential = strip(1.0, 0.02, 40)
    held = [forms.clamp(u, body.facets("left")), forms.roller(u, body.facets("top"), 1)]
    found = forms.frequencies(forms.Problem(potential, u, held), rho=1.0, count=3)
    exact = (2 * np.arange(1, 4) - 1) * pi / 2
    assert np.sqrt(found.omega2) == pytest.approx(exact, rel=1e-5)
    assert found.frequencies == pytest.approx(exact / (2 * pi), rel=1e-5)
    for n, mode in enumerate(found.modes):
        middle = forms.at(mode, (0.5, 0.0))[0] / forms.at(mode, (1.0, 0.0))[0]
        assert middle == pytest.approx(np.sin(exact[n] / 2) / np.sin(exact[n]), rel=1e-4)


def timoshenko(slenderness, shear):
    """First two omega of a cantilever by Timoshenko's beam, E = rho = L = 1, nu = 0."""
    h = 1 / slenderness
    A, inertia, G = h, h**3 / 12, 0.5
    s2, r2 = inertia / (shear * A * G), inertia / A  # EI / (k A G L^2), I / (A L^2)

    def condition(omega):
        b2 = omega**2 * A / inertia
        half = (r2 + s2) / 2
        root = np.sqrt(((r2 - s2) / 2) ** 2 + 1 / b2)
        a, b = np.sqrt(root - half), np.sqrt(root + half)
        wave = np.sqrt(b2)
        p, q = wave * a, wave * b
        first = 2 + (b2 * (r2 - s2) ** 2 + 2) * np.cosh(p) * np.cos(q)
        mixed = wave * (r2 + s2) / np.sqrt(1 - b2 * r2 * s2) * np.sinh(p) * np.sin(q)
        return first - mixed

    euler = np.array([1.87510407, 4.69409113]) ** 2 * np.sqrt(inertia / A)
    return [brentq(condition, 0.97 * w, 1.001 * w) for w in euler]


def test_bending_modes_of_a_beam():
    """The first two of a cantilever, L/h = 50, are Timoshenko's to 1e-3."""
    body, u, potential = strip(1.0, 0.02, 50)
    problem = forms.Problem(potential, u, forms.clamp(u, body.facets("left")))
    found = forms.frequencies(problem, rho=1.0, count=2)
    assert np.sqrt(found.omega2) == pytest.approx(timoshenko(50, 5 / 6), rel=1e-3)


def string(ends, n):
    """First two omega across a stretched string over the formula with bending, less 1."""
    mu, stretch, height = 1.0, 1.5, 0.02

    def psi(F):
        return forms.energies.neo_hookean(F, mu, 0.0)

    body, u, potential = strip(1.0, height, n, energy=psi)
    nominal = mu * (stretch - 1 / stretch)  # with lmbda = 0 nothing narrows
    for side, sign in (("left", -1), ("right", 1)):
        potential += forms.dead_traction(u, (sign * nominal, 0), body.ds(side))
    u.interpolate(lambda x: np.stack([(stretch - 1) * x[0], 0 * x[1]]))
    path = forms.solve(potential, u, ends(body, u))
    assert forms.at(u, (1.0, 0.0)) == pytest.approx([stretch - 1, 0], abs=1e-9)
    found = forms.frequencies(path, rho=1.0, count=3)
    n = np.arange(1, 3)
    # The strain of a fiber at y is - y w'' / stretch, of stiffness dP/dstretch.
    slope = mu * (1 + stretch**-2)
    bending = 1 + slope * (n * pi * height) ** 2 / (24 * stretch * nominal)
    exact = n * pi * np.sqrt(nominal / stretch) * bending
    omega = np.sqrt(found.omega2)[[1, 2]]  # the first one goes along the string
    return omega / exact - 1


def test_a_stretched_string():
    """omega_n = n pi/L sqrt(P / (stretch rho)) and its bending, ends that may turn, 1e-3."""

    def faces(body, u):
        ends = [forms.roller(u, body.facets(side), 1) for side in ("left", "right")]
        return [*ends, forms.pin(u, (0, 0), axes=[0])]

    for n in (60, 120):
        assert np.abs(string(faces, n)).max() < 5e-4


def test_a_string_pinned_on_its_middle_line():
    """The same to 1e-3, always from below: one node gives way, the more the finer the mesh."""

    def pins(body, u):
        return [forms.pin(u, (0, 0)), forms.pin(u, (1, 0), axes=[1])]

    coarse, fine = string(pins, 16), string(pins, 60)
    assert (-1e-3 < coarse).all() and (fine < coarse).all() and (coarse < 0).all()


FREE = """
import json
from mpi4py import MPI
import numpy as np, ufl
from variform import forms, meshes

body = meshes.block(MPI.COMM_WORLD, (1.0, 0.4, 0.2), n=(5, 2, 1))
u = forms.displacement(body, 2)
psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 10.0, 20.0) * ufl.dx
found = forms.frequencies(forms.Problem(psi, u), rho=2.0, count=9)
if MPI.COMM_WORLD.rank == 0:
    print(json.dumps({"omega2": found.omega2.tolist(), "names": found.names}))
"""


def test_a_free_body_has_six_rigid_motions_on_any_ranks(run, tmp_path):
    """Below 1e-6 of the first elastic omega^2, with their names; frequencies alike to 1e-8."""
    start = scripts(run, tmp_path)
    one, two = start(FREE, 1), start(FREE, 2)
    for found in (one, two):
        omega2 = np.array(found["omega2"])
        assert np.abs(omega2[:6]).max() < 1e-6 * omega2[6] and omega2[6] > 1
        assert sum(name.startswith("translation along") for name in found["names"]) == 3
        assert sum(name.startswith("rotation about") for name in found["names"]) == 3
        assert found["names"][6:] == ["", "", ""]
    assert one["omega2"][6:] == pytest.approx(two["omega2"][6:], rel=1e-8)


def test_an_unstable_state_has_a_negative_square():
    """A column pressed beyond Euler's load: omega^2 falls through zero there; a motion's path."""
    body, u, potential = strip(1.0, 0.05, 20)
    t = forms.load_factor(body)
    press = forms.dead_traction(u, (-t * pi**2 / 48 * 0.05**2, 0), body.ds("right"))
    problem = forms.Problem(potential + press, u, forms.clamp(u, body.facets("left")))
    found = []
    for load in (0.98, 1.02):
        t.value = load
        forms.solve(problem)
        found.append(forms.frequencies(problem, rho=1.0, count=1))
    assert found[0].omega2[0] > 0 > found[1].omega2[0] and found[1].frequencies[0] < 0
    assert found[0].omega2[0] == pytest.approx(-found[1].omega2[0], rel=0.3)
    u.x.array[:], t.value = 0, 0
    path = forms.transient(problem, t=t, to=1e-3, rho=1.0, progress=False)
    moving = forms.frequencies(path, count=1).omega2[0]
    u.x.array[:], t.value = 0, 0
    assert moving == pytest.approx(forms.frequencies(problem, 1.0, 1).omega2[0], rel=1e-3)


def test_pressure_and_circumference():
    """A nearly incompressible bar beside one of mere displacement; a ring's breathing."""
    body = meshes.block(MPI.COMM_SELF, (1.0, 0.2), n=(20, 4), cells="quadrilateral")
    found = []
    for mixed in (False, True):
        u = forms.displacement_pressure(body) if mixed else forms.displacement(body, 2)
        F = forms.deformation_gradient(u["u"])
        psi = forms.energies.isochoric_neo_hookean(F, 1.0)
        if mixed:
            psi = forms.energies.with_pressure(psi, F, u["p"], 5.0)
        else:
            psi += forms.energies.volumetric(F, 5.0)
        held = forms.clamp(u, body.facets("left"))
        found.append(forms.frequencies(forms.Problem(psi * ufl.dx, u, held), 1.0, 3).omega2)
    assert found[0] == pytest.approx(found[1], rel=5e-3)
    # A thin ring breathes with omega = sqrt(E / rho) / r where it may get higher, nu = 0.
    ring = meshes.block(MPI.COMM_SELF, (0.01, 0.01), n=1, cells="quadrilateral", origin=(2.0, 0))
    u = forms.displacement(ring)
    psi = forms.energies.saint_venant_kirchhoff(forms.axisymmetric(u), 0.5, 0.0)
    potential = psi * forms.circumference(u) * ufl.dx
    held = forms.roller(u, ring.facets("bottom"), 1)
    lowest = forms.frequencies(forms.Problem(potential, u, held), rho=1.0, count=1).omega2[0]
    assert np.sqrt(lowest) == pytest.approx(1 / 2.005, rel=1e-4)


def test_bad_input_of_frequencies():
    """No mass density, none that is positive, a count that is none, no potential."""
    body, u, potential = strip(1.0, 0.2, 4, degree=1)
    problem = forms.Problem(potential, u, forms.clamp(u, body.facets("left")))
    for options, words in (
        ({}, "frequencies need the mass density, rho = 1000.0"),
        ({"rho": 0.0}, "frequencies need a mass density rho > 0 .*, got 0"),
        ({"rho": 1.0, "count": 0}, "frequencies are from 1 to 16 here, got count = 0"),
        ({"rho": 1.0, "count": 99}, "frequencies are from 1 to 16 here, got count = 99"),
    ):
        with pytest.raises(ValueError, match=words):
            forms.frequencies(problem, **options)
    push = forms.follower_pressure(u, 0.1, ufl.TestFunction(u.function_space), body.ds("top"))
    unsymmetric = forms.Problem(potential, u, problem.supports, virtual_work=push)
    with pytest.raises(ValueError, match="a body with a potential and a displacement"):
        forms.frequencies(unsymmetric, rho=1.0)
