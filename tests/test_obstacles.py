# SPDX-License-Identifier: MIT
"""Laws of obstacles: distances, the barrier, its rule, its derivatives; what is refused."""

from mpi4py import MPI

import basix
import numpy as np
import pytest
import ufl
from dolfinx import fem

from variform import forms, meshes
from variform.forms import boundaries, obstacles
from variform.forms.intervals import Intervals

BODY = meshes.block(MPI.COMM_SELF, (1.0, 1.0, 1.0), n=2)
SPACE = ufl.SpatialCoordinate(BODY.mesh)
SHAPES = {
    "plane": obstacles.plane((0.1, 0.2, 0.3), (1, 2, -2)),
    "sphere": obstacles.sphere((0.1, -0.2, 0.3), 0.4),
    "inside a sphere": obstacles.sphere((0.1, -0.2, 0.3), 4.0, inside=True),
    "cylinder": obstacles.cylinder((0.1, 0.2, 0.3), (0.0, 1.0, 1.0), 0.5),
    "inside a cylinder": obstacles.cylinder((0.1, 0.2, 0.3), (0, 1, 1), 4.0, inside=True),
    "cone": obstacles.cone((0.1, 0.2, 0.3), (0.3, 0.0, -1.0), 0.6),
    "box": obstacles.box((-0.5, -0.4, -0.3), (0.5, 0.6, 0.7)),
}


def values(distance, points):
    """A distance at points in space."""
    return Intervals(distance(SPACE), SPACE, "it")(points, points)[0]


def nearest(name, points, rng):
    """Distance from the nearest of many points of a surface, and how far these are apart."""
    n = 400
    a, b = np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n), indexing="ij")
    a, b = a.ravel(), b.ravel()
    if name == "box":
        faces = []
        low, high = np.array([-0.5, -0.4, -0.3]), np.array([0.5, 0.6, 0.7])
        for k in range(3):
            for end in (0.0, 1.0):
                faces.append(low + np.insert(np.c_[a, b], k, end, axis=1) * (high - low))
        surface = np.concatenate(faces)
    else:  # the cone, about its axis
        axis = np.array([0.3, 0.0, -1.0]) / np.hypot(0.3, 1.0)
        e = np.cross(axis, [0.0, 1.0, 0.0])
        f = np.cross(axis, e)
        turn, s = 2 * np.pi * a[:, None], 8 * b[:, None] ** 2
        round_ = np.cos(turn) * e + np.sin(turn) * f
        surface = np.array([0.1, 0.2, 0.3]) + s * (np.cos(0.6) * axis + np.sin(0.6) * round_)
    return np.array([np.sqrt(((surface - x) ** 2).sum(axis=1).min()) for x in points])


@pytest.mark.parametrize("name", SHAPES)
def test_distances_have_gradients_of_length_one(name, rng):
    """|grad phi| = 1 outside, by central differences: 1e-8."""
    x = rng.uniform(-2, 2, (200, 3))
    x = x[values(SHAPES[name], x) > 0.05]
    assert len(x) > 20
    h, slopes = 1e-5, []
    for k in range(3):
        step = np.eye(3)[k] * h
        slopes.append((values(SHAPES[name], x + step) - values(SHAPES[name], x - step)) / (2 * h))
    assert np.linalg.norm(slopes, axis=0) == pytest.approx(1, abs=1e-6)


@pytest.mark.parametrize("name", ["box", "cone"])
def test_boxes_and_cones_have_true_distances(name, rng):
    """Beside faces, edges, corners and apex: the nearest of 160,000 points of the surface."""
    x = rng.uniform(-2, 2, (60, 3))
    x = x[values(SHAPES[name], x) > 0.3]
    assert values(SHAPES[name], x) == pytest.approx(nearest(name, x, rng), abs=3e-3)


def test_shapes_in_closed_form():
    """Each at a point worked out by hand, in the plane, too."""
    flat = meshes.block(MPI.COMM_SELF, (1.0, 1.0), n=1)
    plane = ufl.SpatialCoordinate(flat.mesh)

    def at(distance, *x):
        return Intervals(distance(plane), plane, "it")(np.array([x]), np.array([x]))[0][0]

    assert at(obstacles.plane((0, 1), (0, 3)), 5.0, 3.0) == pytest.approx(2)
    assert at(obstacles.sphere((0, 0), 2), 3.0, 4.0) == pytest.approx(3)
    assert at(obstacles.cone((0, 0), (0, -1), np.pi / 4), 1.0, 0.0) == pytest.approx(0.5**0.5)
    assert at(obstacles.cone((0, 0), (0, -1), np.pi / 4), 0.3, 0.4) == pytest.approx(0.5)
    assert at(obstacles.box((0, 0), (1, 1)), 4.0, 5.0) == pytest.approx(5)
    walls = obstacles.container((0.0, None), (2.0, 3.0))
    assert [at(wall, 0.5, 0.5) for wall in walls] == pytest.approx([0.5, 1.5, 2.5])
    x = np.array([[0.1, 0.2 + 3, 0.3 - 3]])  # sqrt(18) across the axis (0, 1, 1)
    assert values(SHAPES["cylinder"], x)[0] == pytest.approx(18**0.5 - 0.5)


def test_barrier_in_closed_form():
    """Zero with two derivatives at dhat, infinite at 0, NaN below; the pressure as stated."""
    d = fem.Constant(BODY.mesh, 0.0)
    y = ufl.variable(d)
    b = obstacles.barrier(y, 0.1, 5.0)
    parts = [b, ufl.diff(b, y), ufl.diff(ufl.diff(b, y), y)]
    place = Intervals(0 * SPACE[0], SPACE, "it")
    assert place.constants == []
    compiled = [forms.compiled(part * ufl.dx(domain=BODY.mesh, degree=0)) for part in parts]

    def at(value):
        d.value = value
        return [fem.assemble_scalar(form) for form in compiled]

    for value in (0.1, 0.2):
        assert at(value) == [0, 0, 0]
    below = np.array(at(0.1 * (1 - 1e-4)))
    # b = k dhat (1 - y)^3 + ..: orders 3, 2 and 1
    assert below == pytest.approx([5 * 0.1 * 1e-12, -5 * 3e-8, 5 * 6e-4 / 0.1], rel=1e-3)
    y = 0.53243604
    assert at(0.1 * y)[1] == pytest.approx(-5, rel=1e-6)
    assert at(0.1 * y)[1] == pytest.approx(-5 * ((1 - y) ** 2 / y - 2 * (1 - y) * np.log(y)))
    assert np.isinf(at(0.0)[0]) and np.isnan(at(-1e-3)[0])


@pytest.mark.parametrize("cell", ["interval", "triangle", "quadrilateral"])
@pytest.mark.parametrize("parts", [1, 2, 3])
def test_rule(cell, parts):
    """Degree 3 in all of its parts, weights positive, and the nodes of degree 1 and 2 in it."""
    kind = getattr(basix.CellType, cell)
    points, weights = boundaries.rule(kind, parts)
    exact, at = basix.make_quadrature(kind, 3)
    for i in range(4):
        for j in range(4 - i if points.shape[1] == 2 else 1):
            f = [p[:, 0] ** i * (p[:, -1] ** j if p.shape[1] == 2 else 1) for p in (points, exact)]
            assert weights @ f[0] == pytest.approx(at @ f[1], abs=1e-14)
    assert weights.min() > 0 and len(np.unique(points.round(12), axis=0)) == len(points)
    for degree in (1, 2):
        if parts % degree == 0 or degree == 2:
            element = basix.create_element(basix.ElementFamily.P, kind, degree)
            for node in element.points:
                assert np.abs(points - node).max(axis=1).min() < 1e-14


def scene(degree=1, distance=None, **given):
    """A block near a ball, in a random state."""
    u = forms.displacement(BODY, degree)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0)
    ball = obstacles.sphere((0.4, 0.5, 1.53), 0.5) if distance is None else distance
    given = {"dhat": 0.1, "stiffness": 0.7, **given}
    return u, psi * ufl.dx, forms.obstacle(u, ball, BODY.ds("top"), **given)


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("own", [False, True])
def test_derivatives(degree, own, rng):
    """E(u + h v) = E + h R[v] + h^2/2 K[v, v] + O(h^3), a distance of one's own, too."""
    square = None
    if own:
        c = ufl.as_vector((0.4, 0.5, 1.53))

        def square(x):
            return ufl.dot(x - c, x - c) - 0.25

    u, _, barrier = scene(degree, square)
    R = forms.residual(barrier, u)
    E, r, K = forms.compiled(barrier), forms.compiled(R), forms.compiled(forms.tangent(R, u))
    u.x.array[:] = 0.005 * rng.normal(size=u.x.array.size)
    v = rng.normal(size=u.x.array.size)
    start = u.x.array.copy()
    A = forms.Problem(barrier, u).create_matrix()
    fem.petsc.assemble_matrix(A, K)
    A.assemble()
    b = fem.petsc.assemble_vector(r)
    x, y = b.duplicate(), b.duplicate()
    x.array[:] = v
    A.mult(x, y)
    energy, remainders = fem.assemble_scalar(E), []
    assert energy > 0
    for h in (4e-5, 2e-5, 1e-5):
        u.x.array[:] = start + h * v
        taylor = energy + h * b.array @ v + h**2 / 2 * y.array @ v
        remainders.append(abs(fem.assemble_scalar(E) - taylor))
    assert np.log2(np.divide(remainders[:-1], remainders[1:])) == pytest.approx(3, abs=0.15)


def test_distances_need_no_gradients_of_length_one(rng):
    """7 phi is phi; |x|^2 - R^2 counts as (r^2 - R^2) / (2 r), d up to d^2 / (2 r)."""
    c = np.array((0.4, 0.5, 1.53))
    ball = obstacles.sphere(c, 0.5)

    def square(x):
        return ufl.dot(x - ufl.as_vector(c), x - ufl.as_vector(c)) - 0.25

    energies = [
        forms.integral(scene(distance=phi)[2]) for phi in (ball, lambda x: 7 * ball(x), square)
    ]
    assert energies[1] == pytest.approx(energies[0], rel=1e-12)
    assert 1.1 < energies[2] / energies[0] < 1.2
    ((label, _, _),) = obstacles.obstacles_in(scene(distance=square, gap=0.01)[2])
    x = c + rng.normal(size=(100, 3))
    r = np.linalg.norm(x - c, axis=1)
    assert label.bounds(x, x)[0] == pytest.approx((r**2 - 0.25) / (2 * r) + 0.01, rel=1e-12)
    assert forms.integral(scene(distance=ball, gap=0.1)[2]) == 0
    shifted = obstacles.sphere(c, 0.49)
    gap = forms.integral(scene(distance=ball, gap=0.01)[2])
    assert gap == pytest.approx(forms.integral(scene(distance=shifted)[2]), rel=1e-12)


def test_bodies_of_revolution_get_their_weight():
    """The same obstacle on a ring: 2 pi R in every part, told by the energy beside it."""
    body = meshes.block(MPI.COMM_SELF, (1.0, 1.0), n=4, origin=(1.0, 0.0))
    u = forms.displacement(body)
    wall = forms.obstacle(
        u, obstacles.plane((0, 1.05), (0, -1)), body.ds("top"), dhat=0.1, stiffness=1.0
    )
    F = forms.axisymmetric(u)
    psi = forms.energies.neo_hookean(F, 1.0, 2.0) * forms.circumference(u)
    y = 0.5
    each = 0.1 * (1 - y) ** 2 * np.log(2)
    assert forms.integral(wall) == pytest.approx(each)
    ring = forms.Problem(psi * ufl.dx + wall, u).energy()
    assert ring == pytest.approx(each * np.pi * (2**2 - 1**2))


def test_defaults():
    """A tenth of the smallest facet, and about the body's modulus, in proportion to it."""
    stiff = []
    for E in (1.0, 100.0):
        for degree in (1, 2):
            u = forms.displacement(BODY, degree)
            psi = forms.energies.neo_hookean(forms.deformation_gradient(u), E / 2.6, E / 2)
            far = obstacles.plane((0, 0, 2), (0, 0, -1))
            form = forms.obstacle(u, far, BODY.ds("top"))
            problem = forms.Problem(psi * ufl.dx + form, u)
            (barrier,) = problem.forms.barriers.all
            stiff.append(float(barrier.label.stiffness.value))
            assert float(barrier.label.reach.value) == pytest.approx(0.05 * 2**0.5 / 1, rel=0.5)
            assert problem.energy() == 0 and not np.any(u.x.array)
    assert stiff[2:] == [100 * k for k in stiff[:2]]
    assert 0.1 < min(stiff[:2]) and max(stiff[:2]) < 2


def test_a_distance_moves_with_the_load_factor():
    """Its energy is that of the same obstacle where it has come to."""
    t = forms.load_factor(BODY, 0.0)
    moving = obstacles.plane((0, 0, 1.2 - t), (0, 0, -1))
    u, psi, barrier = scene(distance=moving)
    problem = forms.Problem(psi + barrier, u)
    assert problem.depends_on(t)
    found = []
    for value in (0.0, 0.15):
        t.value = value
        found.append(problem.energy())
    there = scene(distance=obstacles.plane((0, 0, 1.05), (0, 0, -1)))[2]
    assert found == pytest.approx([0, forms.integral(there)])


def test_wrong_arguments_are_refused():
    """One sentence each: what was expected, what came, what to do."""
    u, _, _ = scene()
    floor, ds = obstacles.plane((0, 0, 0), (0, 0, 1)), BODY.ds("bottom")
    flat = meshes.block(MPI.COMM_SELF, (1.0, 1.0), n=1)
    w = forms.displacement_pressure(BODY)
    cases = [
        (lambda: forms.obstacle(u, floor, ds, dhat=9.0), r"up to the smallest facet of its bound"),
        (lambda: forms.obstacle(u, floor, ds, dhat=0), r"dhat of obstacle is a length above 0"),
        (lambda: forms.obstacle(u, floor, ds, stiffness=-1), r"is a pressure above 0, got -1"),
        (lambda: forms.obstacle(u, floor, ufl.dx), r"needs the measure of a boundary.* over cells"),
        (lambda: forms.obstacle(u, floor, BODY.ds("top", degree=2)), r"rule of its own, got a mea"),
        (lambda: forms.obstacle(u, 3, ds), r"distance of obstacle is a function.* got int"),
        (lambda: forms.obstacle(u, [], ds, name="wall"), r"the obstacle wall has no distance"),
        (lambda: forms.obstacle(u, lambda x: x, ds), r"is a scalar, got shape \(3,\)"),
        (lambda: forms.obstacle(u, lambda x: u[0], ds), r"is a function of the place x, of numb"),
        (lambda: forms.obstacle(w["p"], floor, ds), r"needs the displacement, got the field p"),
        (lambda: forms.obstacle(u, floor, ds, parts=0), r"parts of obstacle is a whole number"),
        (lambda: obstacles.plane((0, 0), (0, 0)), r"a direction of an obstacle has a length above"),
        (lambda: obstacles.cone((0, 0), (0, 1), 2.0), r"between 0 and pi/2, got 2.0"),
        (
            lambda: obstacles.cylinder((0, 0), (0, 1), 1)(ufl.SpatialCoordinate(flat.mesh)),
            r"a cylinder is one in space",
        ),
        (lambda: floor(ufl.SpatialCoordinate(flat.mesh)), r"a normal needs the shape \(2,\)"),
    ]
    for call, message in cases:
        with pytest.raises(ValueError, match=message):
            call()


def test_a_body_without_stiffness_has_no_barrier():
    """Where nothing resists at rest the stiffness is asked for."""
    u = forms.displacement(BODY)
    soft = ufl.inner(u, u) ** 2 * ufl.dx
    wall = forms.obstacle(u, obstacles.plane((0, 0, 2), (0, 0, -1)), BODY.ds("top"))
    with pytest.raises(ValueError, match="no stiffness at rest where the obstacle obstacle acts"):
        forms.Problem(soft + wall, u)
