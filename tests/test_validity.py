# SPDX-License-Identifier: MIT
"""Laws of the bounds of J: never above a J, narrow, the same on any number of ranks."""

import itertools
import json
from fractions import Fraction

from mpi4py import MPI

import basix.ufl
import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh

from demos.benchmarks.validity import KINDS, OneCell, sweep
from variform import forms, meshes
from variform.forms.bernstein import Bernstein
from variform.forms.validity import Bounds, VolumeBounds, can_bound, volume_bounds

TRIANGLE, QUADRILATERAL = mesh.CellType.triangle, mesh.CellType.quadrilateral
TETRAHEDRON, HEXAHEDRON = mesh.CellType.tetrahedron, mesh.CellType.hexahedron
CELLS = [TRIANGLE, QUADRILATERAL, TETRAHEDRON, HEXAHEDRON]
F = np.array([[1.2, 0.3, 0.1], [-0.2, 0.9, 0.4], [0.1, -0.1, 1.1]])
ELEMENTS = [f"{family}{k}" for family in "PQ" for k in (1, 2, 3)]
NARROW = 0.02


def unit(cell, n=2):
    """A square or cube of n cells along each edge; half of its simplices are mirrored."""
    if cell in (TRIANGLE, QUADRILATERAL):
        return mesh.create_unit_square(MPI.COMM_SELF, n, n, cell)
    return mesh.create_unit_cube(MPI.COMM_SELF, n, n, n, cell)


def moved(u, function):
    """The unknown with a displacement put in."""
    u.interpolate(function)
    return u


@pytest.mark.parametrize("simplex", [True, False])
def test_halves_and_products_are_the_polynomials(rng, simplex):
    """Products by multi-indices, and the basis itself, against values at random points."""
    f = Bernstein(simplex, (2, 2, 2) if simplex else (2, 1, 3))
    g = Bernstein(simplex, (3, 3, 3) if simplex else (1, 3, 2))
    product, to = f.times(g)
    a, b = rng.normal(size=len(f.indices)), rng.normal(size=len(g.indices))
    c = np.zeros(len(product.indices))
    pairs = np.outer(a * f.multinomials, b * g.multinomials)
    np.add.at(c, to.ravel(), pairs.ravel())
    x = rng.uniform(0, 1 / 3 if simplex else 1, (50, 3))
    expected = (f.values(x) @ a) * (g.values(x) @ b)
    assert product.values(x) @ (c / product.multinomials) == pytest.approx(expected, abs=1e-12)
    assert f.coefficients(f.values(f.points) @ a) == pytest.approx(a, abs=1e-12)
    for space in f, g, product:
        values = space.values(corners(simplex))
        found = [k for k, *_ in space.corners]
        assert sorted(np.argmax(values, axis=1)) == sorted(found)
        lines = [sorted(k for line in way for k in line) for _, way in space.directions]
        assert all(line == list(range(len(space.indices))) for line in lines)


def corners(simplex):
    cube = np.array(list(itertools.product([0.0, 1.0], repeat=3)))
    return cube[cube.sum(axis=1) <= 1] if simplex else cube


@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("cell", CELLS, ids=lambda c: c.name)
def test_a_homogeneous_deformation(cell, degree):
    """Lower = upper = det F to 1e-12; also where it is turned inside out, and in a mixed space."""
    body = unit(cell)
    dim = body.geometry.dim
    for G in F[:dim, :dim], -np.eye(dim)[::-1] @ F[:dim, :dim]:
        u = moved(forms.displacement(body, degree), lambda x, G=G: G @ x[:dim] - x[:dim])
        bounds = volume_bounds(u)
        assert bounds[:2] == pytest.approx(2 * (np.linalg.det(G),), rel=1e-12)
        assert len(bounds.place) == dim and np.all(np.abs(np.subtract(bounds.place, 0.5)) < 0.5)
    if degree > 1:
        w = forms.displacement_pressure(body, degree)
        w.put("p", 7.0)
        w.sub(0).interpolate(lambda x: F[:dim, :dim] @ x[:dim] - x[:dim])
        assert volume_bounds(w)[:2] == pytest.approx(2 * (np.linalg.det(F[:dim, :dim]),), rel=1e-12)


@pytest.mark.parametrize("cell", CELLS, ids=lambda c: c.name)
def test_an_inverted_corner_between_the_points(cell):
    """J = 1 - 1.01 x y is -0.01 in one corner, and positive at all points of degree 14."""
    body = unit(cell, 1)
    dim = body.geometry.dim

    def squeezed(x):
        u = np.zeros((dim, x.shape[1]))
        u[0] = -1.01 * x[0] ** 2 / 2 * x[1]
        return u

    u = moved(forms.displacement(body, 3), squeezed)
    gradient = forms.deformation_gradient(u)
    assert forms.smallest_volume_ratio(gradient, body, 14) > 0.005
    bounds = volume_bounds(u)
    assert bounds.upper == pytest.approx(-0.01, abs=1e-13)
    assert -0.01 - NARROW * 1.01 <= bounds.lower <= -0.01 + 1e-13


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("cell", CELLS, ids=lambda c: c.name)
def test_the_sign_is_found_by_halving(cell, sign):
    """J = least + 4 (x - 1/3)^2, least = +-1e-4: its coefficients do not tell its sign.

    A tetrahedron, which is halved along its longest edges, cannot follow a plane as closely: 1e-2.
    """
    least = sign * (1e-2 if cell == TETRAHEDRON else 1e-4)
    body = unit(cell, 1)
    dim = body.geometry.dim

    def along(x):
        u = np.zeros((dim, x.shape[1]))
        u[0] = least * x[0] + 4 / 3 * (x[0] - 1 / 3) ** 3 - x[0]
        return u

    lower, upper, place = volume_bounds(moved(forms.displacement(body, 3), along))
    assert lower <= least + 1e-14 and least - 1e-14 <= upper
    assert lower > 0 if least > 0 else upper <= 0
    assert upper - lower <= NARROW * 16 / 9
    assert abs(place[0] - 1 / 3) < 0.1 or cell == TETRAHEDRON


def test_what_halving_cannot_tell_is_left_open():
    """J = 4 (x - 1/3)^2 touches zero: the bounds enclose it, closely, and the call comes back."""
    body = unit(TRIANGLE, 1)
    u = forms.displacement(body, 3)
    u.interpolate(lambda x: np.array([4 / 3 * (x[0] - 1 / 3) ** 3 - x[0], 0 * x[0]]))
    lower, upper, _ = volume_bounds(u)
    assert -1e-4 < lower <= 0 < upper < 1e-4


@pytest.mark.parametrize("element", ELEMENTS)
@pytest.mark.parametrize("kind", KINDS)
def test_random_displacements(kind, element):
    """Never above a J of a dense lattice, and narrow; only surfaces that collapse stay open."""
    for dim in (2, 3) if kind in ("straight", "curved") else (2,):
        found = sweep(kind, dim, element, 40, seed=7, cells=2)
        assert found["above"] == found["wide"] == 0 and found["margin"] > -1e-13
        assert found["open"] == 0 or kind == "surface"


@pytest.mark.parametrize(("element", "order"), [("P1", 2), ("P2", 3), ("Q1", 2), ("P3", 2)])
def test_a_geometry_of_another_degree(element, order):
    """The same on cells of another degree than that of the displacement."""
    for dim in 2, 3:
        found = sweep("curved", dim, element, 40, seed=3, cells=2, order=order)
        assert found["above"] == found["wide"] == found["open"] == 0


@pytest.mark.parametrize("kind", ["straight", "curved"])
def test_linear_elements_by_their_vertices(kind, rng):
    """P1: J is constant. Q1 in the plane: J det dX is linear along edges, least J at a vertex."""
    for element, dim in ("P1", 2), ("P1", 3), ("Q1", 2):
        one = OneCell(kind, dim, element, rng)
        for u in one.random(rng, 50):
            J = one.ratios(u[None])
            lower, upper, _ = one.bound(u)
            assert lower == pytest.approx(J.min(), abs=1e-13 + NARROW * np.ptp(J))
            assert upper == pytest.approx(J.min(), abs=1e-13)


@pytest.mark.parametrize("order", [2, 3])
def test_a_curved_body_is_stretched(order):
    """X is curved, x = F X: numerator and denominator are proportional, J = det F to 1e-12."""
    body = meshes.sphere_octant(MPI.COMM_SELF, 0.5, 1.0, 0.4, order=2)
    u = moved(forms.displacement(body, order), lambda x: F @ x - x)
    assert volume_bounds(u)[:2] == pytest.approx(2 * (np.linalg.det(F),), rel=1e-12)


@pytest.mark.parametrize("b", [0.3, -0.1])
@pytest.mark.parametrize("cell", CELLS[:2], ids=lambda c: c.name)
def test_a_body_of_revolution(cell, b):
    """u_r = a R + b R^3, u_z = c z: J = (1 + a + b R^2)(1 + a + 3 b R^2)(1 + c)."""
    a, c = 0.1, -0.2
    u = forms.displacement(unit(cell, 3), 3)
    u.interpolate(lambda x: np.array([a * x[0] + b * x[0] ** 3, c * x[1]]))
    J = np.array([(1 + a + b * R**2) * (1 + a + 3 * b * R**2) * (1 + c) for R in (0, 1)])
    psi = forms.energies.neo_hookean(forms.axisymmetric(u), 1.0, 2.0)
    problem = forms.Problem(psi * forms.circumference(u) * ufl.dx, u)
    bounds = volume_bounds(problem)
    assert bounds == VolumeBounds(u, axisymmetric=True)() == volume_bounds(u, True)
    assert bounds.upper == pytest.approx(J.min(), rel=1e-12)  # at a corner, also where 0/0
    assert J.min() * (1 - NARROW) - NARROW * np.ptp(J) < bounds.lower < J.min() + 1e-12
    assert (bounds.place[0] < 1 / 3) == (b > 0)
    # The same unknown in plane strain: (1 + a + 3 b R^2)(1 + c).
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0)
    plane = volume_bounds(forms.Problem(psi * ufl.dx, u))
    assert plane.upper == pytest.approx(min((1 + a), (1 + a + 3 * b)) * (1 + c), rel=1e-12)


def test_a_radius_that_turns_negative():
    """u_r = -1.2 R: on both sides of the axis is an inverted body, whose J = (-0.2)^2 is positive.

    u_r = -1.2 R + R^2 is pushed through the axis near it only: J = (R - 0.2)(2 R - 0.2) < 0.
    """
    body = unit(TRIANGLE, 4)
    u = moved(forms.displacement(body, 2), lambda x: np.array([-1.2 * x[0], 0 * x[1]]))
    assert volume_bounds(u, True)[:2] == pytest.approx((0.04, 0.04), rel=1e-10)
    u.interpolate(lambda x: np.array([-1.2 * x[0] + x[0] ** 2, 0 * x[1]]))
    lower, upper, place = volume_bounds(u, True)
    R = np.linspace(0, 1, 1001)
    J = (R - 0.2) * (2 * R - 0.2)
    assert upper < 0 and lower <= J.min() + 1e-12 and upper >= J.min() - 1e-6
    assert upper - lower <= NARROW * (0.06 - J.min())  # its cell ends at R = 1/4, where J = 0.015
    assert place[0] < 0.25


@pytest.mark.parametrize("order", [1, 2])
def test_membranes(order):
    """A sphere blown up to twice its radius: 4 to 1e-12. A flat sheet turned and stretched."""
    body = meshes.spherical_sheet(MPI.COMM_SELF, 1.0, 0.4, order, "octant")
    u = moved(forms.displacement(body, order), lambda x: x)
    assert volume_bounds(u)[:2] == pytest.approx((4, 4), rel=1e-12)
    body = meshes.square(MPI.COMM_SELF, 2.0, 0.5, order)
    Q = np.linalg.qr(F)[0]
    u = moved(forms.displacement(body, order), lambda x: Q @ np.diag([1.5, 0.5, 1.0]) @ x - x)
    assert volume_bounds(u)[:2] == pytest.approx((0.75, 0.75), rel=1e-12)
    u.interpolate(lambda x: np.array([-x[0], 0 * x[0], 0 * x[0]]))  # onto a line
    lower, upper, _ = volume_bounds(u)
    assert lower == 0 and upper < 1e-12


def test_a_state_that_is_not_finite():
    """Nothing is known where a displacement is NaN or infinite, and other cells change nothing."""
    for bad in np.nan, np.inf, 1e200:
        u = forms.displacement(unit(TETRAHEDRON), 2)
        u.x.array[17] = bad
        assert volume_bounds(u).lower == -np.inf


def test_rounding_proves_nothing(rng):
    """A tetrahedron flat to rounding: never lower > 0 where J is not positive in exact numbers.

    Nor is much of what is there lost to rounding: J = 1e-9 is told.
    """
    one = OneCell("straight", 3, "P1", rng)
    X = one.u.function_space.tabulate_dof_coordinates()
    positive = []
    for _ in range(300):
        G = rng.normal(size=(3, 3))
        G[2] = rng.normal(size=2) @ G[:2]
        u = X @ G.T - X
        lower, exact = one.bound(u).lower, exact_volume(X, u) / exact_volume(X, 0 * u)
        positive.append(exact > 0)
        assert lower <= max(exact, 0)
        G[2] += 1e-9 * np.cross(G[0], G[1]) / np.sum(np.cross(G[0], G[1]) ** 2)
        assert one.bound(X @ G.T - X)[:2] == pytest.approx((1e-9, 1e-9), rel=1e-3)
    assert 50 < sum(positive) < 250  # as rounding will have it


def exact_volume(X, u):
    """Six times the volume of a tetrahedron at X + u, in fractions."""
    x = [
        [Fraction(a) + Fraction(b) for a, b in zip(*p, strict=True)] for p in zip(X, u, strict=True)
    ]
    a, b, c = ([p - q for p, q in zip(x[k], x[0], strict=True)] for k in (1, 2, 3))
    return sum(a[i] * (b[i - 2] * c[i - 1] - b[i - 1] * c[i - 2]) for i in range(3))


def test_a_cell_in_a_thousand():
    """One corner of one cell, inverted, in a mesh where J = 1 elsewhere: found, and where it is."""
    body = unit(HEXAHEDRON, 6)
    u = forms.displacement(body, 2)
    x = u.function_space.tabulate_dof_coordinates()
    (node,) = np.flatnonzero(np.linalg.norm(x - [1 / 3, 1 / 2, 2 / 3], axis=1) < 1e-9)
    u.x.array[3 * node] = 0.06
    lower, upper, place = volume_bounds(u)
    assert lower <= upper < 0
    assert np.linalg.norm(np.subtract(place, [1 / 3, 1 / 2, 2 / 3])) < 0.2
    u.x.array[:] = 0
    assert volume_bounds(u)[:2] == pytest.approx((1, 1), rel=1e-12)


RANKS = """
import json
from mpi4py import MPI
import numpy as np, ufl
from variform import forms, meshes
from variform.forms.validity import volume_bounds

comm, found = MPI.COMM_WORLD, {}


def wave(size):
    waves = lambda x: [np.sin(3 * x[1] + x[0]), np.cos(4 * x[2]) * x[0], x[0] * x[1]]
    return lambda x: size * np.array(waves(x))


for cells in "tetrahedron", "hexahedron":
    body = meshes.block(comm, (1.0, 1.0, 1.0), n=(3, 3, 3), cells=cells)
    for degree in 1, 2, 3:
        u = forms.displacement(body, degree)
        for size in 0.0, 0.1, 0.4:
            u.interpolate(wave(size))
            found[f"{cells} {degree} {size}"] = volume_bounds(u)
    # One node, of a cell in the corner: one rank has it, and all say so.
    x = u.function_space.tabulate_dof_coordinates()
    u.x.array[:] = 0
    near = np.flatnonzero(np.linalg.norm(x - 1, axis=1) < 1e-9)
    u.x.array[3 * near] = -0.2
    found[f"{cells} corner"] = volume_bounds(u)
body = meshes.spherical_sheet(comm, 1.0, 0.4, 2, "octant")
u = forms.displacement(body, 2)
u.interpolate(wave(0.2))
found["sheet"] = volume_bounds(u)
body = meshes.block(comm, (1.0, 1.0), n=(1, 1), cells="quadrilateral")  # ranks without a cell
u = forms.displacement(body, 2)
u.interpolate(lambda x: 0.3 * np.array([x[0] * x[1], -x[0] ** 2]))
found["one cell"] = volume_bounds(u, axisymmetric=True)
every = comm.gather(found)
if comm.rank == 0:
    assert all(other == found for other in every)
    print(json.dumps(found))
"""


def test_ranks_give_the_same_bounds(parallel):
    """1, 2 and 3 ranks: the same bounds and places; a cell that one rank has is known to all."""
    one, *others = (parallel(RANKS, ranks) for ranks in (1, 2, 3))
    assert one["tetrahedron corner"][1] < 0 and one["hexahedron corner"][1] < 0
    for other, name in itertools.product(others, one):
        assert other[name][:2] == pytest.approx(one[name][:2], rel=1e-12), name
        if "0.0" not in name:  # where all cells are alike, rounding chooses one
            assert other[name][2] == pytest.approx(one[name][2], abs=1e-9), name


def test_bounds_are_recorded(tmp_path):
    """With each step of a path, from its problem; and in its summary."""
    body = meshes.block(MPI.COMM_SELF, (1.0, 1.0), n=(2, 2))
    t, u = forms.load_factor(body), forms.displacement(body, 2)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0)
    pushed = forms.translate(u, body.facets("right"), (-0.3 * t, None))
    held = [forms.clamp(u, body.facets("left")), pushed]
    record = {"J": volume_bounds}
    path = forms.follow(psi * ufl.dx, u, held, t, step=0.5, record=record, progress=False)
    lower, upper = path.record("J")[:, :2].astype(float).T
    assert np.all(np.diff(lower) < 0) and np.all(lower <= upper) and lower[-1] > 0.6
    assert isinstance(path.steps[-1].records["J"], Bounds)
    assert path.steps[-1].records["J"] == volume_bounds(path) == volume_bounds(u)
    assert forms.summary(path)["steps"][0]["records"]["J"][:2] == [lower[0], upper[0]]
    assert json.loads(json.dumps(volume_bounds(path))) == [
        *volume_bounds(path)[:2],
        [*volume_bounds(path).place],
    ]


def test_what_has_no_bounds_is_refused():
    """Bubbles, degree 4, no displacement, a revolved solid: one sentence, and can_bound tells."""
    body = unit(TRIANGLE)
    bubble = basix.ufl.enriched_element(
        [basix.ufl.element("P", "triangle", 1), basix.ufl.element("bubble", "triangle", 3)]
    )
    for element in basix.ufl.blocked_element(bubble, shape=(2,)), ("Lagrange", 4, (2,)):
        u = forms.unknown(body, u=(element, forms.Role.DISPLACEMENT))
        assert not can_bound(u)
        with pytest.raises(
            ValueError, match=r"elements of degree 1 to 3 in triangles.* got .* on tri"
        ):
            volume_bounds(u)
    theta = forms.unknown(body, theta=(("Lagrange", 1), forms.Role.SCALAR))
    solid = forms.displacement(unit(TETRAHEDRON))
    assert can_bound(solid) and not can_bound(solid, axisymmetric=True) and not can_bound(theta)
    for call, message in (
        (lambda: VolumeBounds(theta), "needs a displacement, and theta has none"),
        (lambda: volume_bounds(solid, True), "got cells of dimension 3 in 3 dimensions"),
        (lambda: volume_bounds(body), "needs the unknown itself.* got Mesh"),
    ):
        with pytest.raises(ValueError, match=message):
            call()
    for variant in basix.LagrangeVariant.legendre, basix.LagrangeVariant.gll_centroid:
        element = basix.ufl.element("P", "triangle", 3, variant, shape=(2,), discontinuous=True)
        u = fem.Function(fem.functionspace(body, element))
        u.interpolate(lambda x: F[:2, :2] @ x[:2] - x[:2])
        # The degrees of freedom of the first are no values at points.
        assert can_bound(u) == (variant != basix.LagrangeVariant.legendre)
    assert volume_bounds(u)[:2] == pytest.approx(2 * (np.linalg.det(F[:2, :2]),), rel=1e-12)
