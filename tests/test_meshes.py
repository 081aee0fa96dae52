# SPDX-License-Identifier: MIT
"""Bodies made from numbers: volumes, areas, normals and names of every generator; errors."""

from math import hypot, pi, sqrt
from pathlib import Path

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from bodies import BODIES, COMM, integral, number_of_cells, size
from dolfinx import fem
from dolfinx.mesh import exterior_facet_indices

from variform import meshes

ROOT = Path(__file__).parent.parent
SIMPLICES = ("triangle", "tetrahedron")


def rate(errors: list[float], h: list[float]) -> float:
    """Slope of log error over log h, by least squares: single steps of gmsh's meshes scatter."""
    return np.polyfit(np.log(h), np.log(errors), 1)[0]


@pytest.fixture(scope="module", params=BODIES)
def body(request: pytest.FixtureRequest) -> meshes.Body:
    return BODIES[request.param]()


def test_flux_of_position_is_volume(body: meshes.Body) -> None:
    """The integral of n . x over the whole boundary is d times the volume."""
    x, n = ufl.SpatialCoordinate(body.mesh), ufl.FacetNormal(body.mesh)
    flux = integral(ufl.inner(n, x), body.ds(degree=6))
    assert flux == pytest.approx(body.mesh.geometry.dim * size(body), rel=1e-12)


def test_names_part_the_boundary(body: meshes.Body) -> None:
    """Each exterior facet has exactly one name, and a generator's body has one region."""
    exterior = np.sort(exterior_facet_indices(body.mesh.topology))
    named = [body.facets(name) for name in body.boundaries]
    assert np.array_equal(np.sort(np.concatenate(named)), exterior)
    assert np.array_equal(body.facets(*body.boundaries), exterior)
    assert np.array_equal(body.facets(), exterior)
    assert all(facets.dtype == np.int32 for facets in named)
    assert np.array_equal(body.cells("body"), body.cells())
    assert body.interfaces == ()
    assert sum(size(body, name) for name in body.boundaries) == pytest.approx(
        size(body, *body.boundaries), rel=1e-12
    )


def test_whole_boundary_adds_up_in_one_form() -> None:
    """Measures of one body join in a form: ds() + ds(left) + dx(body) is the sum of the three."""
    body = BODIES["bar"]()
    one = fem.Constant(body.mesh, 1.0)
    form = fem.form(one * body.ds() + one * body.ds("left") + one * body.dx("body"))
    area = 2 * (0.2 + 0.3 + 0.06)
    assert COMM.allreduce(fem.assemble_scalar(form)) == pytest.approx(area + 0.06 + 0.06, rel=1e-12)


SIDES = {"left": (0, 0), "right": (0, 1), "front": (1, 0), "back": (1, 1)}
SIDES |= {"bottom": (-1, 0), "top": (-1, 1)}


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize(
    ("lengths", "n", "cells", "number"),
    [
        ((1.0, 0.2, 0.3), (3, 2, 1), "tetrahedron", 36),
        ((1.0, 0.2, 0.3), (3, 2, 1), "hexahedron", 6),
        ((1.0, 0.2, 0.3), None, "tetrahedron", None),
        ((1.0, 0.2), (3, 2), "triangle", 12),
        ((1.0, 0.2), (3, 2), "quadrilateral", 6),
        ((1.0, 0.2), None, "triangle", None),
    ],
)
def test_sides_of_a_block_are_where_their_names_say(lengths, n, cells, number, order) -> None:
    """On x_i = c with outward normal e: area = V / length, integral of x_i = c area, n = e."""
    origin = (1.0, 2.0, 3.0)[: len(lengths)]
    h = 0.15 if n is None else None
    body = meshes.block(COMM, lengths, h, n, cells, order, origin)
    volume = np.prod(lengths)
    assert body.mesh.ufl_domain().ufl_coordinate_element().degree == order
    assert body.mesh.topology.cell_name() == cells
    assert size(body) == pytest.approx(volume, rel=1e-12)
    assert number is None or number_of_cells(body) == number
    x, normal = ufl.SpatialCoordinate(body.mesh), ufl.FacetNormal(body.mesh)
    assert set(body.boundaries) == set(SIDES) - ({"front", "back"} if len(lengths) == 2 else set())
    for name in body.boundaries:
        axis, end = SIDES[name]
        area, where = volume / lengths[axis], origin[axis] + end * lengths[axis]
        i = axis % len(lengths)
        assert size(body, name) == pytest.approx(area, rel=1e-12)
        assert integral(x[i], body.ds(name)) == pytest.approx(where * area, rel=1e-12)
        assert integral(normal[i], body.ds(name)) == pytest.approx((2 * end - 1) * area, rel=1e-12)


def test_h_bounds_structured_cells() -> None:
    """Structured cells made with h are the fewest with edges no longer than h."""
    body = meshes.block(COMM, (1.0, 0.3, 0.2), h=0.1, cells="hexahedron")
    assert number_of_cells(body) == 10 * 3 * 2
    assert number_of_cells(meshes.block(COMM, (1.0, 0.2), h=0.3, cells="quadrilateral")) == 4


@pytest.mark.parametrize("cells", ["triangle", "quadrilateral", "tetrahedron", "hexahedron"])
def test_cooks_panel(cells: str) -> None:
    """Area (44 + 16) 48 / 2 = 1440, sides 44, 16, |(48, 44)|, |(48, 16)|, times the thickness."""
    solid = cells in ("tetrahedron", "hexahedron")
    t = 10.0 if solid else 1.0
    body = meshes.cook(COMM, n=4, cells=cells, thickness=t)
    areas = {"left": 44, "right": 16, "bottom": hypot(48, 44), "top": hypot(48, 16)}
    areas = {name: t * length for name, length in areas.items()}
    if solid:
        areas |= {"back": 1440, "front": 1440}
        z = ufl.SpatialCoordinate(body.mesh)[2]
        assert integral(z, body.ds("front")) == pytest.approx(14400, rel=1e-12)
        assert integral(z, body.ds("back")) == pytest.approx(0, abs=1e-9)
    assert number_of_cells(body) == 16 * (2 if cells == "triangle" else 1) * (
        6 if cells == "tetrahedron" else 1
    )
    assert size(body) == pytest.approx(1440 * t, rel=1e-12)
    assert {name: size(body, name) for name in body.boundaries} == pytest.approx(areas, rel=1e-12)


@pytest.mark.parametrize(("order", "least"), [(1, 1.7), (2, 3.5)])
def test_curved_bodies_converge(order: int, least: float) -> None:
    """Volume and curved areas err by O(h^2) with flat facets, O(h^4) with nodes on the surface."""
    h = [0.6, 0.3, 0.15]
    bodies = [meshes.cylinder(COMM, 1.0, 1.0, h=s, order=order) for s in h]
    assert rate([pi - size(b) for b in bodies], h) > least
    assert rate([2 * pi - size(b, "outer") for b in bodies], h) > least
    h = [0.4, 0.2, 0.1]
    bodies = [meshes.sphere_octant(COMM, 0.5, 1.0, h=s, order=order) for s in h]
    assert rate([abs(pi / 6 * (1 - 1 / 8) - size(b)) for b in bodies], h) > least
    assert rate([pi / 2 - size(b, "outer") for b in bodies], h) > least
    assert rate([pi / 8 - size(b, "inner") for b in bodies], h) > least


def test_areas_of_a_tube() -> None:
    """Order 2 at h = 0.25: curved and flat areas of a quarter tube right to 3 digits and more."""
    tube = meshes.cylinder(COMM, 1.0, 2.0, 0.5, h=0.25, order=2, sector=pi / 2)
    areas = {"outer": pi, "inner": pi / 2, "x0": 1, "y0": 1}
    areas |= {name: pi / 4 * (1 - 0.25) for name in ("bottom", "top")}
    assert {name: size(tube, name) for name in tube.boundaries} == pytest.approx(areas, rel=3e-4)
    x = ufl.SpatialCoordinate(tube.mesh)
    for i, name, at in (0, "x0", 0), (1, "y0", 0), (2, "bottom", 0), (2, "top", 2):
        off = integral((x[i] - at) ** 2, tube.ds(name))
        assert off == pytest.approx(0, abs=1e-20)
    for name, radius in ("outer", 1), ("inner", 0.5):
        off = integral((ufl.sqrt(x[0] ** 2 + x[1] ** 2) - radius) ** 2, tube.ds(name, degree=6))
        assert sqrt(off / areas[name]) < 1e-3
    half = meshes.cylinder(COMM, 1.0, 2.0, h=0.5, sector=pi)
    assert set(half.boundaries) == {"bottom", "top", "outer", "y0", "cut"}
    x = ufl.SpatialCoordinate(half.mesh)
    assert integral(x[0], half.ds("y0")) == pytest.approx(1, rel=1e-12)
    assert integral(x[0], half.ds("cut")) == pytest.approx(-1, rel=1e-12)


@pytest.mark.parametrize(
    ("inner", "order", "found"), [(0.95, 2, "off 'inner'"), (0.999, 1, "gmsh: ")]
)
def test_cells_too_large_for_a_thin_wall(inner, order, found):
    """Curved cells much longer than a wall is thick would be straight, or cross: one sentence."""
    message = (
        rf"sphere_octant: no mesh of its curved surfaces with cells of 0.6 \(.*{found}.*h, of a"
    )
    with pytest.raises(ValueError, match=message):
        meshes.sphere_octant(COMM, inner, 1.05 if order == 2 else 1.0, h=0.6, order=order)


def test_ellipsoid_is_the_benchmarks() -> None:
    """Volume of the wall, area of the base and of both spheroids below z = 5, by quadrature."""

    def below(rs: float, rl: float, b: float = 5.0) -> float:
        return pi * rs**2 * ((b + rl) - (b**3 + rl**3) / (3 * rl**2))

    def area(rs: float, rl: float, b: float = 5.0) -> float:
        u = np.linspace(np.arccos(b / rl), pi, 20001)
        f = 2 * pi * rs * np.sin(u) * np.hypot(rs * np.cos(u), rl * np.sin(u))
        return float(np.sum((f[1:] + f[:-1]) / 2 * np.diff(u)))

    body = meshes.ellipsoid(COMM, h=2.0, order=2)
    assert size(body) == pytest.approx(below(10, 20) - below(7, 17), rel=2e-4)
    base = pi * (100 * (1 - 25 / 400) - 49 * (1 - 25 / 289))
    areas = {"endo": area(7, 17), "epi": area(10, 20), "base": base}
    assert {name: size(body, name) for name in body.boundaries} == pytest.approx(areas, rel=5e-4)
    z = ufl.SpatialCoordinate(body.mesh)[2]
    assert integral(z, body.ds("base")) == pytest.approx(5 * size(body, "base"), rel=1e-12)


# Errors


BAD_ARGUMENTS = {
    r"block needs two or three edge lengths, got 1: size=\(1,\)": lambda: meshes.block(
        COMM, (1,), 1
    ),
    r"size\[1\] must be positive, got size\[1\]=-0.2": lambda: meshes.block(COMM, (1, -0.2), 0.1),
    r"size\[0\] must be positive, got size\[0\]=nan": lambda: meshes.block(
        COMM, (float("nan"), 1), 1
    ),
    "h must be positive, got h=0": lambda: meshes.block(COMM, (1, 1), h=0),
    "block needs either h .* or n .*, got h=None and n=None": lambda: meshes.block(COMM, (1, 1)),
    "got h=0.1 and n=3": lambda: meshes.block(COMM, (1, 1), 0.1, 3),
    r"block needs 2 positive whole numbers of cells, got n=\(3, 0\)": lambda: meshes.block(
        COMM, (1, 1), n=(3, 0)
    ),
    r"needs 3 positive whole numbers of cells, got n=\(3, 1\)": lambda: meshes.block(
        COMM, (1, 1, 1), n=(3, 1)
    ),
    r"block needs 2 coordinates of the origin, got \(0, 0, 0\)": lambda: meshes.block(
        COMM, (1, 1), 1, origin=(0, 0, 0)
    ),
    "block in 2 dimensions makes cells of triangle or quadrilateral, got cells='hexahedron'": (
        lambda: meshes.block(COMM, (1, 1), 1, cells="hexahedron")
    ),
    "order of the geometry must be 1 or 2, got order=3": lambda: meshes.cook(COMM, 2, order=3),
    "cook .* makes cells of .*hexahedron, got cells='hex'": lambda: meshes.cook(
        COMM, 2, cells="hex"
    ),
    "cook needs either h .*, got h=None and n=None": lambda: meshes.cook(COMM),
    "cook needs 2 positive whole numbers of cells, got n=0": lambda: meshes.cook(COMM, 0),
    "thickness must be positive, got thickness=0": lambda: meshes.cook(COMM, 2, thickness=0),
    "radius must be positive, got radius=0": lambda: meshes.cylinder(COMM, 0, 1, h=1),
    "height must be positive, got height=-1": lambda: meshes.cylinder(COMM, 1, -1, h=1),
    "0 <= inner_radius < radius, got inner_radius=2 and radius=1": lambda: meshes.cylinder(
        COMM, 1, 1, 2, h=1
    ),
    "0 < sector <= 2 pi, got sector=7": lambda: meshes.cylinder(COMM, 1, 1, h=1, sector=7),
    "sphere_octant needs inner < outer, got inner=2, outer=1": lambda: meshes.sphere_octant(
        COMM, 2, 1, h=1
    ),
    "inner must be positive, got inner=0": lambda: meshes.sphere_octant(COMM, 0, 1, h=1),
    r"smaller than epi's, got endo=\(11, 17\) and epi=\(10.0, 20.0\)": lambda: meshes.ellipsoid(
        COMM, 1, endo=(11, 17)
    ),
    r"\|base\| < 17.0, .* got base=17": lambda: meshes.ellipsoid(COMM, 1, base=17),
    r"mesh.med: read knows the suffixes .msh, .*, got '.med'": lambda: meshes.read(
        COMM, "mesh.med"
    ),
    "mesh.msh is a mesh already, got h=0.1": lambda: meshes.read(COMM, "mesh.msh", h=0.1),
    "scale must be positive, got scale=0": lambda: meshes.read(COMM, "mesh.msh", scale=0),
    "gdim must be 2, 3 or None, got gdim=1": lambda: meshes.read(COMM, "mesh.msh", gdim=1),
}


@pytest.mark.parametrize("match", BAD_ARGUMENTS)
def test_bad_arguments(match: str) -> None:
    """Each argument that makes no body is refused with its value."""
    with pytest.raises(ValueError, match=match):
        BAD_ARGUMENTS[match]()


def test_unknown_names() -> None:
    """An unknown name is refused with the list of the known ones."""
    body = BODIES["sheet"]()
    match = 'no boundary named "lfet"; this body has: bottom, left, right, top.'
    for ask in body.facets, body.ds:
        with pytest.raises(ValueError, match=match):
            ask("right", "lfet")
    for ask in body.cells, body.dx:
        with pytest.raises(ValueError, match='no region named "muscle"; this body has: body.'):
            ask("muscle")


def test_a_name_without_entities() -> None:
    """A body is refused whose names own no facet or cell."""
    b = BODIES["sheet"]()
    with pytest.raises(ValueError, match="the boundary 'hole' holds no facet of the mesh"):
        meshes.Body(b.mesh, b.cell_tags, b.facet_tags, b.regions, {"hole": 99})
    with pytest.raises(ValueError, match="the region 'bone' holds no cell of the mesh"):
        meshes.Body(b.mesh, b.cell_tags, b.facet_tags, {"bone": 99}, b.boundaries)


@pytest.mark.parametrize("h", [2.5, 3.0])
def test_tangled_cells_of_a_coarse_curved_mesh_are_straightened(h):
    """Cells of a thick shell that the curved sides tangle are mended; volume and names stay right.

    The body is that of revolution between two ellipses cut at z = 5: V is an integral of r^2.
    """
    body = meshes.ellipsoid(MPI.COMM_SELF, h=h, order=2)

    def cap(short, long, base=5.0):
        return np.pi * short**2 * (base + long - (base**3 + long**3) / (3 * long**2))

    exact = cap(10.0, 20.0) - cap(7.0, 17.0)
    measure = body.dx(degree=6)
    volume = fem.assemble_scalar(fem.form(fem.Constant(body.mesh, 1.0) * measure))
    assert volume == pytest.approx(exact, rel=2e-3)
    assert set(body.boundaries) == {"endo", "epi", "base"}
