# SPDX-License-Identifier: MIT
"""Fibers of the ventricle against the parametrization that defines them, and active tension."""

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from cases import FIBER, Pointwise, fiber, random_rotation, random_state

from variform import forms, meshes
from variform.forms import energies

WALLS = {
    "benchmark": {},
    "thick": {"endo": (1.0, 2.0), "epi": (10.0, 30.0), "angles": (60.0, -45.0)},
    "ball": {"endo": (5.0, 5.0), "epi": (6.0, 9.0), "angles": (0.0, 30.0)},
}
every_wall = pytest.mark.parametrize("wall", WALLS.values(), ids=WALLS)


def drawn(rng, wall, count=200, t=None):
    """Depths t, points x, and unit vectors along dx/du and dx/dv, -pi < u < 0, by differences."""
    endo, epi = np.array(wall.get("endo", (7, 17))), np.array(wall.get("epi", (10, 20)))
    t = rng.uniform(0, 1, count) if t is None else np.full(count, float(t))
    u, v = rng.uniform(-0.98 * np.pi, -1.3, count), rng.uniform(-np.pi, np.pi, count)
    rs, rl = endo[:, None] + (epi - endo)[:, None] * t

    def place(u, v):
        return np.array([rs * np.sin(u) * np.cos(v), rs * np.sin(u) * np.sin(v), rl * np.cos(u)]).T

    h = 1e-5
    along = (place(u + h, v) - place(u - h, v)) / (2 * h)
    around = (place(u, v + h) - place(u, v - h)) / (2 * h)
    units = [d / np.linalg.norm(d, axis=1)[:, None] for d in (along, around)]
    return t, place(u, v), *units


def axes_of(wall):
    return {key: wall[key] for key in ("endo", "epi") if key in wall}


@every_wall
def test_depth_is_recovered(rng, wall):
    """The depth of random points comes back to rounding, and that of both surfaces."""
    for t in (None, 0, 1):
        wanted, x, *_ = drawn(rng, wall, t=t)
        assert np.abs(meshes.ellipsoid_depth(x, **axes_of(wall)) - wanted).max() < 1e-13


@every_wall
def test_fibers_are_the_definition(rng, wall):
    """F = n(dx/du) sin a + n(dx/dv) cos a, a linear in t, to the error of the differences."""
    first, last = wall.get("angles", (90.0, -90.0))
    t, x, along, around = drawn(rng, wall)
    a = np.radians(first + (last - first) * t)[:, None]
    f = meshes.ellipsoid_fibers(x, **wall)
    assert np.abs(np.linalg.norm(f, axis=1) - 1).max() < 1e-14
    assert np.abs(f - along * np.sin(a) - around * np.cos(a)).max() < 1e-8


def test_fibers_of_the_benchmark_lie_in_the_surfaces(rng):
    """Tangential everywhere; from the apex up inside, around in the middle, down outside."""
    for t, up in ((0, 1), (1, -1), (0.5, 0)):
        _, x, *_ = drawn(rng, {}, t=t)
        f = meshes.ellipsoid_fibers(x)
        normal = x / np.array([7 + 3 * t, 7 + 3 * t, 17 + 3 * t]) ** 2
        assert np.abs(np.einsum("ni,ni->n", f, normal)).max() < 1e-14
        turn = np.cross(x, f)[:, 2]  # positive: counterclockwise about z
        if up:
            assert np.abs(turn).max() < 1e-13 and np.all(up * f[:, 2] > 0)
        else:
            assert np.abs(f[:, 2]).max() < 1e-13 and np.all(turn > 0)
    # A right-handed helix between the inner surface and the middle.
    _, x, *_ = drawn(rng, {}, t=0.25)
    f = meshes.ellipsoid_fibers(x)
    assert np.all(f[:, 2] > 0) and np.all(np.cross(x, f)[:, 2] > 0)


def test_fibers_turn_with_the_point(rng):
    """F(Q x) = Q f(x) for rotations about the axis; on the axis itself f is a unit vector."""
    c, s = np.cos(0.7), np.sin(0.7)
    Q = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    _, x, *_ = drawn(rng, {})
    assert np.abs(meshes.ellipsoid_fibers(x @ Q.T) - meshes.ellipsoid_fibers(x) @ Q.T).max() < 1e-13
    on_axis = meshes.ellipsoid_fibers(np.array([[0, 0, -17.0], [0, 0, -18.5], [0, 0, -20.0]]))
    assert np.linalg.norm(on_axis, axis=1) == pytest.approx(1, abs=1e-15)


@pytest.mark.parametrize("order", [1, 2])
def test_field_is_the_function_at_every_point(order):
    """The UFL field equals the arrays' at quadrature points, and has the length 1 there."""
    body = meshes.ellipsoid(MPI.COMM_SELF, h=6.0, order=order)
    f = meshes.ellipsoid_fiber_field(body)
    dx = ufl.dx(degree=4)
    volume = forms.integral(1.0 * body.dx(degree=4))
    assert forms.integral((ufl.dot(f, f) - 1) ** 2 * dx) < 1e-28 * volume
    nodes = forms.field(f, body, degree=1)
    x = nodes.function_space.tabulate_dof_coordinates()
    wanted = meshes.ellipsoid_fibers(x)
    off_axis = np.hypot(x[:, 0], x[:, 1]) > 1e-6
    found = nodes.x.array.reshape(-1, 3)
    assert np.abs(found - wanted)[off_axis].max() < 1e-11


def test_field_of_a_section_is_that_in_space():
    """In the meridian plane y = 0 of a (r, z) body the components are those along x, y and z."""
    body = meshes.block(MPI.COMM_SELF, (1.0, 1.0), n=(2, 4), cells="quadrilateral")
    x = body.mesh.geometry.x
    t, angle = x[:, 0].copy(), 0.1 + 1.5 * x[:, 1]
    x[:, 0], x[:, 1] = (7 + 3 * t) * np.sin(angle), -(17 + 3 * t) * np.cos(angle)
    nodes = forms.field(meshes.ellipsoid_fiber_field(body), body, degree=1)
    points = nodes.function_space.tabulate_dof_coordinates()[:, [0, 2, 1]]
    found = nodes.x.array.reshape(-1, 3)
    assert np.abs(found - meshes.ellipsoid_fibers(points)).max() < 1e-12


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: meshes.ellipsoid_fibers(np.array([[0, 0, -18.0], [0.1, 0, 0]])),
            r"1 of 2 points lie outside the wall between the half axes \(7.0, 17.0\) and "
            r"\(10.0, 20.0\), the first is \(0.1, 0.0, 0.0\)",
        ),
        (lambda: meshes.ellipsoid_depth(np.array([[0, 0, -25.0]])), "1 of 1 points lie outside"),
        (lambda: meshes.ellipsoid_depth(np.zeros((1, 3))), "1 of 1 points lie outside"),
        (lambda: meshes.ellipsoid_depth(np.array([[np.nan, 0, 0]])), "1 of 1 points lie outside"),
        (lambda: meshes.ellipsoid_depth(np.zeros(3)), r"shape \(n, 3\), got \(3,\)"),
        (
            lambda: meshes.ellipsoid_depth(np.zeros((1, 3)), endo=(11, 17)),
            r"smaller than epi's, got endo=\(11, 17\) and epi=\(10.0, 20.0\)",
        ),
        (
            lambda: meshes.ellipsoid_depth(np.zeros((1, 3)), endo=(0, 17)),
            r"endo\[0\] must be positive, got endo\[0\]=0",
        ),
        (
            lambda: meshes.ellipsoid_fiber_field(meshes.block(MPI.COMM_SELF, (1, 1, 1), n=1)),
            r"8 of 8 points lie outside .* the unit",
        ),
    ],
)
def test_points_outside_the_wall_are_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()


PARALLEL = """
import json
from mpi4py import MPI
import ufl
from variform import forms, meshes
comm = MPI.COMM_WORLD
body = meshes.ellipsoid(comm, h=6.0, order=2)
f = meshes.ellipsoid_fiber_field(body)
x = ufl.SpatialCoordinate(body.mesh)
value = forms.integral(ufl.dot(f, x) ** 2 * f[2] * ufl.dx(degree=4))
try:
    # Only the rank that holds the apex sees a point outside.
    meshes.ellipsoid_fiber_field(body, epi=(10.0, 19.0))
    message = ""
except ValueError as error:
    message = str(error)
messages = comm.allgather(message)
if comm.rank == 0:
    print(json.dumps([value, messages]))
"""


def test_field_and_its_error_are_alike_on_all_ranks(parallel):
    """An integral of the field on 1 and 3 ranks; one rank's error reaches the others."""
    (one, _), (three, messages) = parallel(PARALLEL, 1), parallel(PARALLEL, 3)
    assert three == pytest.approx(one, rel=1e-11)
    assert len(set(messages)) == 1 and "points lie outside the wall" in messages[0]


TA = 3.0


def tension(F):
    return energies.active_tension(F, TA, fiber())


def test_active_stress_is_the_tension_along_the_fiber(rng):
    """S = Ta A A and psi = Ta/2 (|F A|^2 - 1) at every F, inverted ones too; objective."""
    at = Pointwise(tension)
    wanted = TA * np.outer(FIBER, FIBER)
    for F in (np.eye(3), random_state(rng), random_state(rng), np.diag([1.1, 0.9, -0.5])):
        found = at(F)
        assert np.abs(found["S"] - wanted).max() < 1e-14 * TA
        assert found["psi"] == pytest.approx(TA / 2 * (np.sum((F @ FIBER) ** 2) - 1), abs=1e-14)
        turned = at(random_rotation(rng) @ F)
        assert turned["psi"] == pytest.approx(found["psi"], abs=1e-13)


def test_active_stress_is_the_derivative(rng):
    """psi(F + h D) = psi + h P : D + h^2/2 Ta |D A|^2, exactly: the energy is quadratic in F."""
    at = Pointwise(tension)
    F, D = random_state(rng), rng.normal(size=(3, 3))
    start = at(F)
    for h in (1.0, 0.5):
        wanted = start["psi"] + h * np.sum(start["P"] * D)
        wanted += h**2 / 2 * TA * np.sum((D @ FIBER) ** 2)
        assert at(F + h * D)["psi"] == pytest.approx(wanted, rel=1e-13)


def test_active_bar_shortens_by_the_closed_form():
    """A free incompressible neo-Hookean bar: mu (l - 1/l^2) + Ta l = 0, so l^3 = mu / (mu + Ta)."""
    mu, Ta = 2.0, 1.5
    body = meshes.block(MPI.COMM_SELF, (2.0, 1.0, 1.0), n=1, cells="hexahedron")
    t, w = forms.load_factor(body), forms.displacement_pressure(body)
    u, p = ufl.split(w)
    F = forms.deformation_gradient(u)
    psi = energies.isochoric_neo_hookean(F, mu) + energies.active_tension(F, Ta * t, (1.0, 0, 0))
    planes = [forms.roller(w, body.facets(n), i) for i, n in enumerate(("left", "front", "bottom"))]
    energy = energies.with_pressure(psi, F, p) * ufl.dx
    forms.follow(energy, w, planes, t, step=0.5, progress=False)
    length = 2 + forms.at(forms.displacement_of(w), (2, 1, 1))[0]
    assert length == pytest.approx(2 * (mu / (mu + Ta)) ** (1 / 3), rel=1e-9)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda F: energies.active_tension(F, np.nan, (1, 0, 0)), "needs a finite Ta, got nan"),
        (lambda F: energies.active_tension(F, 1.0, (2, 0, 0)), "unit vector, got one of length 2"),
        (lambda F: energies.active_tension(F, 1.0, (0, 0, 0)), "unit vector, got one of length 0"),
        (lambda F: energies.active_tension(F, 1.0, (1, 0)), r"needs the shape \(3,\), got \(2,\)"),
        (
            lambda F: energies.active_tension(ufl.as_matrix([[1, 0], [0, 1]]), 1.0, (1, 0, 0)),
            r"active_tension needs a 3x3 F, got shape \(2, 2\)",
        ),
    ],
)
def test_bad_tensions_are_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call(ufl.variable(ufl.Identity(3)))
