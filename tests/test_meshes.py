# SPDX-License-Identifier: MIT
"""Bodies: volumes, areas and names of every generator and file type; errors; n ranks = 1 rank."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from math import hypot, pi, sqrt
from pathlib import Path

from mpi4py import MPI

import gmsh
import numpy as np
import pytest
import ufl
from conftest import LIMIT
from dolfinx import fem
from dolfinx.io import XDMFFile
from dolfinx.mesh import exterior_facet_indices

from variform import meshes

COMM = MPI.COMM_WORLD
ROOT = Path(__file__).parent.parent
SIMPLICES = ("triangle", "tetrahedron")


def integral(integrand: ufl.core.expr.Expr, measure: ufl.Measure) -> float:
    value = fem.assemble_scalar(fem.form(integrand * measure))
    return measure.ufl_domain().ufl_cargo().comm.allreduce(value)


def size(body: meshes.Body, *boundary: str, degree: int = 6) -> float:
    """Area of the named boundary; of the body, its volume, without names."""
    measure = body.ds(*boundary, degree=degree) if boundary else body.dx(degree=degree)
    return integral(fem.Constant(body.mesh, 1.0), measure)


def number_of_cells(body: meshes.Body) -> int:
    return body.mesh.topology.index_map(body.mesh.topology.dim).size_global


def rate(errors: list[float], h: list[float]) -> float:
    """Slope of log error over log h, by least squares: single steps of gmsh's meshes scatter."""
    return np.polyfit(np.log(h), np.log(errors), 1)[0]


BODIES = {
    "bar": lambda: meshes.block(COMM, (1, 0.2, 0.3), h=0.1, origin=(1, 2, 3)),
    "bar2": lambda: meshes.block(COMM, (1, 0.2, 0.3), h=0.15, order=2),
    "bar_n": lambda: meshes.block(COMM, (1, 0.2, 0.3), n=(3, 2, 1)),
    "bar_n2": lambda: meshes.block(COMM, (1, 0.2, 0.3), n=(3, 2, 1), order=2),
    "bar_hex": lambda: meshes.block(COMM, (1, 0.2, 0.3), n=(3, 2, 1), cells="hexahedron"),
    "bar_hex2": lambda: meshes.block(COMM, (1, 0.2, 0.3), h=0.2, cells="hexahedron", order=2),
    "sheet": lambda: meshes.block(COMM, (1, 0.2), h=0.1),
    "sheet_n2": lambda: meshes.block(COMM, (1, 0.2), n=(3, 2), order=2, origin=(-1, 1)),
    "sheet_quad": lambda: meshes.block(COMM, (1, 0.2), n=2, cells="quadrilateral"),
    "sheet_quad2": lambda: meshes.block(COMM, (1, 0.2), n=2, cells="quadrilateral", order=2),
    "cook": lambda: meshes.cook(COMM, h=12.0),
    "cook_n2": lambda: meshes.cook(COMM, n=3, order=2),
    "cook_quad": lambda: meshes.cook(COMM, n=(4, 3), cells="quadrilateral"),
    "cook_tet": lambda: meshes.cook(COMM, n=4, cells="tetrahedron", thickness=10.0),
    "cook_hex2": lambda: meshes.cook(COMM, h=16.0, cells="hexahedron", thickness=10.0, order=2),
    "cylinder": lambda: meshes.cylinder(COMM, 1.0, 2.0, h=0.6),
    "tube2": lambda: meshes.cylinder(COMM, 1.0, 2.0, 0.5, h=0.5, order=2),
    "quarter": lambda: meshes.cylinder(COMM, 1.0, 0.5, 0.5, h=0.3, sector=pi / 2),
    "half": lambda: meshes.cylinder(COMM, 1.0, 0.5, 0.5, h=0.3, sector=pi),
    "octant": lambda: meshes.sphere_octant(COMM, 0.5, 1.0, h=0.3),
    "octant2": lambda: meshes.sphere_octant(COMM, 0.5, 1.0, h=0.4, order=2),
    "ellipsoid": lambda: meshes.ellipsoid(COMM, h=6.0),
}


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


# Files


@pytest.fixture
def session() -> Iterator[None]:
    """A gmsh session of the test's own, in which the files to be read are made."""
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    yield
    gmsh.finalize()


def box(h: float = 0.4, order: int = 1) -> None:
    """Box 1 x 2 x 3 of two halves, soft below z = 1.5, with named ends and a named interface."""
    occ = gmsh.model.occ
    halves = [(3, occ.addBox(0, 0, z, 1, 2, 1.5)) for z in (0, 1.5)]
    occ.fragment(halves[:1], halves[1:])
    occ.synchronize()
    ends = {0: "base", 1.5: "interface", 3: ""}
    for z, name in ends.items():
        e = 1e-3
        found = gmsh.model.getEntitiesInBoundingBox(-e, -e, z - e, 1 + e, 2 + e, z + e, 2)
        gmsh.model.addPhysicalGroup(2, [tag for _, tag in found], 10 + int(2 * z), name)
    for tag, z, name in (1, 0, "soft"), (2, 1.5, "hard"):
        found = gmsh.model.getEntitiesInBoundingBox(-e, -e, z - e, 1 + e, 2 + e, z + 1.5 + e, 3)
        gmsh.model.addPhysicalGroup(3, [volume for _, volume in found], tag, name)
    gmsh.option.setNumber("Mesh.MeshSizeMax", h)
    gmsh.option.setNumber("Mesh.ElementOrder", order)
    gmsh.model.mesh.generate(3)
    gmsh.option.setNumber("Mesh.ElementOrder", 1)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize(("version", "binary"), [(2.2, 0), (2.2, 1), (4.1, 0), (4.1, 1)])
def test_read_msh(session, tmp_path, version, binary, order) -> None:
    """A .msh of any version gives back volumes, areas and names; a nameless group its number."""
    box(order=order)
    gmsh.option.setNumber("Mesh.MshFileVersion", version)
    gmsh.option.setNumber("Mesh.Binary", binary)
    gmsh.write(str(tmp_path / "box.msh"))
    body = meshes.read(COMM, tmp_path / "box.msh", scale=2.0)
    assert set(body.boundaries) == {"base", "interface", "16"}
    assert set(body.regions) == {"soft", "hard"}
    assert size(body) == pytest.approx(8 * 6, rel=1e-12)
    assert integral(fem.Constant(body.mesh, 1.0), body.dx("soft")) == pytest.approx(24, rel=1e-12)
    assert size(body, "base") == pytest.approx(8, rel=1e-12)
    z = ufl.SpatialCoordinate(body.mesh)[2]
    assert integral(z, body.ds("16")) == pytest.approx(6 * 8, rel=1e-12)
    assert len(np.intersect1d(body.cells("soft"), body.cells("hard"))) == 0
    assert body.interfaces == ("interface",)
    dS = ufl.Measure("dS", body.mesh, subdomain_data=body.facet_tags)
    inside = dS(body.boundaries["interface"])
    one = ufl.avg(fem.Constant(body.mesh, 1.0))
    assert integral(one, inside) == pytest.approx(8, rel=1e-12)
    with pytest.raises(ValueError, match=r"boundary 'interface' lies inside the body.*dS.*=13\)"):
        body.ds("interface")


GEO = """
SetFactory("OpenCASCADE");
Rectangle(1) = {0, 0, 0, 2, 1};
Disk(2) = {1, 0.5, 0, 0.2};
BooleanFragments{ Surface{1}; Delete; }{ Surface{2}; Delete; }
Physical Surface("soft") = {2};
Physical Surface("hard") = {3};
Physical Curve("left") = Curve In BoundingBox{-0.1, -0.1, -0.1, 0.1, 1.1, 0.1};
Mesh.MeshSizeMax = 0.2;
"""


def test_read_geo(tmp_path: Path) -> None:
    """A .geo is meshed, in the plane z = 0 with gdim 2; h and order overrule what it asks for."""
    file = tmp_path / "plate.geo"
    file.write_text(GEO)
    body = meshes.read(COMM, str(file), order=2)
    assert body.mesh.geometry.dim == 2
    assert size(body) == pytest.approx(2, rel=1e-12)
    disk = integral(fem.Constant(body.mesh, 1.0), body.dx("soft"))
    assert disk == pytest.approx(pi * 0.2**2, rel=2e-3)  # seven curved edges
    assert size(body, "left") == pytest.approx(1, rel=1e-12)
    assert number_of_cells(meshes.read(COMM, file, h=0.1)) > 3 * number_of_cells(body)
    assert meshes.read(COMM, file, gdim=3).mesh.geometry.dim == 3


@pytest.mark.parametrize("suffix", ["step", "brep"])
def test_read_cad(session, tmp_path, suffix, capfd) -> None:
    """CAD gives volumes and faces named by number; solids that touch share their faces."""
    gmsh.model.occ.addBox(0, 0, 0, 1, 1, 1)
    gmsh.model.occ.addBox(1, 0, 0, 1, 1, 1)
    gmsh.model.occ.synchronize()
    gmsh.write(str(tmp_path / f"boxes.{suffix}"))
    body = meshes.read(COMM, tmp_path / f"boxes.{suffix}", h=0.5, scale=1e-3, order=2)
    assert set(body.regions) == {"volume1", "volume2"}
    assert len(body.boundaries) == 11 and len(body.interfaces) == 1
    assert size(body) == pytest.approx(2e-9, rel=1e-12)
    outer = [name for name in body.boundaries if name not in body.interfaces]
    assert [size(body, name) for name in outer] == pytest.approx(10 * [1e-6], rel=1e-12)


def test_read_cad_faces(session, tmp_path) -> None:
    """A CAD file with faces only gives a surface in space, its boundaries the edges."""
    gmsh.model.occ.addRectangle(0, 0, 1, 1, 2)
    gmsh.model.occ.synchronize()
    gmsh.write(str(tmp_path / "sheet.step"))
    body = meshes.read(COMM, tmp_path / "sheet.step")
    assert (body.mesh.topology.dim, body.mesh.geometry.dim) == (2, 3)
    assert set(body.regions) == {"face1"}
    assert set(body.boundaries) == {"edge1", "edge2", "edge3", "edge4"}
    assert size(body) == pytest.approx(2, rel=1e-12)
    assert size(body, *body.boundaries) == pytest.approx(6, rel=1e-12)


@pytest.mark.parametrize("binary", [0, 1])
def test_read_stl(session, tmp_path, binary) -> None:
    """A closed surface of triangles is filled: a box with 6 faces, a ball cut into some."""
    gmsh.option.setNumber("Mesh.Binary", binary)
    for name, volume, tolerance in ("box", 1.0, 1e-6), ("ball", 4 / 3 * pi, 0.06):
        gmsh.model.add(name)
        add = gmsh.model.occ
        add.addBox(0, 0, 0, 1, 1, 1) if name == "box" else add.addSphere(0, 0, 0, 1)
        add.synchronize()
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.3)
        gmsh.model.mesh.generate(2)
        gmsh.write(str(tmp_path / f"{name}.stl"))
        body = meshes.read(COMM, tmp_path / f"{name}.stl", h=0.3)
        assert size(body) == pytest.approx(volume, rel=tolerance)
        assert np.array_equal(body.facets(*body.boundaries), body.facets())
        assert len(body.boundaries) == 6 if name == "box" else len(body.boundaries) > 1
    assert set(body.regions) == {"volume1"}


@pytest.mark.parametrize("encoding", ["HDF5", "ASCII"])
@pytest.mark.parametrize("made", ["bar_n", "bar_n2", "bar_hex2", "sheet", "cook_n2", "cook_quad"])
def test_read_xdmf_of_dolfinx(tmp_path, encoding, made) -> None:
    """What DOLFINx writes comes back with the same areas, the names being the tags."""
    body, file = BODIES[made](), tmp_path / "body.xdmf"
    with XDMFFile(COMM, file, "w", encoding=getattr(XDMFFile.Encoding, encoding)) as xdmf:
        xdmf.write_mesh(body.mesh)
        xdmf.write_meshtags(body.cell_tags, body.mesh.geometry)
        xdmf.write_meshtags(body.facet_tags, body.mesh.geometry)
    copy = meshes.read(COMM, file)
    assert copy.mesh.geometry.dim == body.mesh.geometry.dim
    assert number_of_cells(copy) == number_of_cells(body)
    assert size(copy) == pytest.approx(size(body), rel=1e-12)
    assert set(copy.regions) == {"1"}
    assert {name: size(copy, name) for name in copy.boundaries} == pytest.approx(
        {str(tag): size(body, name) for name, tag in body.boundaries.items()}, rel=1e-12
    )


def test_a_users_session_goes_on(session, tmp_path) -> None:
    """A session of the user's keeps its models, its current model and its options."""
    gmsh.model.add("mine")
    gmsh.model.occ.addBox(0, 0, 0, 1, 1, 1)
    gmsh.model.occ.synchronize()
    gmsh.option.setNumber("Mesh.ElementOrder", 2)
    before = gmsh.model.list()
    (tmp_path / "plate.geo").write_text(GEO)
    (tmp_path / "bad.geo").write_text("Point(1) = {0, 0, 0};\nLin(2) = {1,\n};\n")
    assert number_of_cells(meshes.block(COMM, (1, 1), n=1)) == 2
    meshes.read(COMM, tmp_path / "plate.geo")
    with pytest.raises(ValueError, match=r"bad.geo: gmsh cannot read it \(.*syntax error"):
        meshes.read(COMM, tmp_path / "bad.geo")
    # gmsh's parser would go on with the rest of the bad script.
    assert size(meshes.read(COMM, tmp_path / "plate.geo")) == pytest.approx(2, rel=1e-12)
    assert gmsh.isInitialized() and gmsh.model.list() == before
    assert gmsh.model.getCurrent() == "mine" and len(gmsh.model.getEntities(3)) == 1
    assert gmsh.option.getNumber("Mesh.ElementOrder") == 2


def test_no_session_stays_open() -> None:
    """A session that the package started is finalized, after an error too."""
    meshes.block(COMM, (1, 1), n=1)
    assert not gmsh.isInitialized()


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


SQUARE = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
TWO = ((2, 1, (1, 2, 3)), (2, 1, (1, 3, 4)))
CUBE = [(x, y, z) for z in (0, 1) for y in (0, 1) for x in (0, 1)]


def msh(points, elements, names=((2, 1, "body"), (1, 2, "left"))) -> str:
    """A .msh 2.2; elements are (gmsh's type, physical tag, nodes)."""
    lines = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat", "$PhysicalNames", str(len(names))]
    lines += [f'{dim} {tag} "{name}"' for dim, tag, name in names]
    lines += ["$EndPhysicalNames", "$Nodes", str(len(points))]
    lines += [f"{i} {x} {y} {z}" for i, (x, y, z) in enumerate(points, 1)]
    lines += ["$EndNodes", "$Elements", str(len(elements))]
    for i, (kind, tag, nodes) in enumerate(elements, 1):
        physical = f"2 {tag} {tag}" if tag else "0"
        lines.append(f"{i} {kind} {physical} {' '.join(map(str, nodes))}")
    return "\n".join([*lines, "$EndElements", ""])


GOOD = {
    "unused points, far apart": msh([*SQUARE, (9, 9, 9)], TWO),
    "numbered clockwise": msh(SQUARE, [TWO[0], (2, 1, (1, 4, 3))]),
    "edges only in part": msh(SQUARE, [*TWO, (1, 2, (4, 1))]),
    "no physical group": msh(SQUARE, [(2, 0, nodes) for _, _, nodes in TWO], ()),
    "an edge of two names": msh(
        SQUARE, [*TWO, (1, 2, (4, 1)), (1, 3, (1, 4))], ((2, 1, "b"), (1, 2, "left"), (1, 3, "top"))
    ),
}


@pytest.mark.parametrize("what", GOOD)
def test_harmless_meshes(tmp_path, what) -> None:
    """Unused points, clockwise cells and unnamed edges are no errors; z = 0 makes a plane body."""
    (tmp_path / "m.msh").write_text(GOOD[what])
    body = meshes.read(COMM, tmp_path / "m.msh")
    assert body.mesh.geometry.dim == 2 and body.mesh.geometry.x.shape == (4, 3)
    assert size(body) == pytest.approx(1, rel=1e-12)


BAD_FILES = {
    "no triangles, quadrilaterals, tetrahedra or hexahedra found": msh(SQUARE, [(1, 2, (1, 2))]),
    r"1 of 2 cells are degenerate .*first is number 2": msh(
        [*SQUARE[:3], (0.5, 0.5, 0)], [(2, 1, (1, 2, 3)), (2, 1, (1, 3, 4))]
    ),
    # Node 5 lies beyond the corner (1, 1): three triangles of the fan fold over.
    r"of 4 cells are inverted \(folded over their neighbors\), the first is number 2": msh(
        [*SQUARE, (1.5, 0.5, 0)], [(2, 1, (i, i % 4 + 1, 5)) for i in (1, 2, 3, 4)]
    ),
    r"1 of 1 cells are degenerate or turned inside out .*number 1": msh(
        [(0, 0, 0), (1, 0, 0), (0.2, 0.2, 0), (0, 1, 0)], [(3, 1, (1, 2, 3, 4))]
    ),
    # A second-order triangle with a node of an edge drawn beyond the opposite vertex.
    r"1 of 1 cells are degenerate or turned inside out \(det J <= 0\)": msh(
        [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0.5, 0.9, 0), (0.5, 0.5, 0), (0, 0.5, 0)],
        [(9, 1, (1, 2, 3, 4, 5, 6))],
    ),
    "1 of 3 cells come twice: write each cell once": msh(SQUARE, [*TWO, (2, 1, (2, 3, 1))]),
    "1 facets belong to three cells or more: cells overlap": msh(
        [*SQUARE, (0.2, 0.9, 0)], [*TWO, (2, 1, (1, 3, 5))]
    ),
    "hold 1 of type 'Triangle 3' and 1 of type 'Quadrilateral 4': a body needs one": msh(
        [*SQUARE, (2, 0, 0)], [(3, 1, (1, 2, 3, 4)), (2, 1, (2, 5, 3))]
    ),
    "hold 1 of type 'Prism 6': a body needs one type": msh(
        CUBE, [(6, 1, (1, 2, 3, 5, 6, 7))], ((3, 1, "body"),)
    ),
    # Group 3 has no name, so it is called by its number, as group 2 is already.
    "two physical groups of dimension 1 are named '3'": msh(
        SQUARE, [*TWO, (1, 2, (4, 1)), (1, 3, (1, 2))], ((2, 1, "b"), (1, 2, "3"))
    ),
    "1 of 1 facets of 'left' are no facets of its cells": msh(
        [*SQUARE, (2, 0, 0)], [*TWO, (1, 2, (2, 5))]
    ),
    "some coordinates are not finite": msh([*SQUARE[:3], ("nan", 1, 0)], TWO),
}


@pytest.mark.parametrize("match", BAD_FILES)
def test_bad_msh(tmp_path, match) -> None:
    """Each kind of mesh that makes no body is refused, with its file's name and how many."""
    (tmp_path / "bad.msh").write_text(BAD_FILES[match])
    with pytest.raises(ValueError, match=match):
        meshes.read(COMM, tmp_path / "bad.msh")
    assert not gmsh.isInitialized()


def test_inverted_tetrahedra_are_counted(session, tmp_path) -> None:
    """One node of a good mesh pushed through the opposite side turns the cells around it."""
    box(h=0.7)
    gmsh.option.setNumber("Mesh.MshFileVersion", 2.2)
    gmsh.write(str(tmp_path / "box.msh"))
    tags, x, _ = gmsh.model.mesh.getNodes(3)
    gmsh.model.mesh.setNode(tags[0], x[:3] + np.array([0.9, 0.0, 0.0]), [])
    gmsh.write(str(tmp_path / "bad.msh"))
    assert size(meshes.read(COMM, tmp_path / "box.msh")) == pytest.approx(6, rel=1e-12)
    with pytest.raises(ValueError, match=r"bad.msh: \d+ of \d+ cells are (inverted|degenerate)"):
        meshes.read(COMM, tmp_path / "bad.msh")


@pytest.mark.parametrize("version", [2.2, 4.1])
def test_an_entity_in_two_groups(session, tmp_path, version) -> None:
    """A volume or a surface in two physical groups belongs to both: each has its own measure."""
    box()
    gmsh.model.addPhysicalGroup(3, [1, 2], name="all")
    held = gmsh.model.getEntitiesForPhysicalGroup(2, 10)
    gmsh.model.addPhysicalGroup(2, held, 40, name="held")
    gmsh.option.setNumber("Mesh.MshFileVersion", version)
    gmsh.write(str(tmp_path / "box.msh"))
    body = meshes.read(COMM, tmp_path / "box.msh")
    one = fem.Constant(body.mesh, 1.0)
    volumes = {name: integral(one, body.dx(name)) for name in body.regions}
    assert volumes == pytest.approx({"soft": 3, "hard": 3, "all": 6}, rel=1e-12)
    assert len(body.cells("all")) == len(body.cells("soft", "all")) == len(body.cells())
    assert size(body, "base") == pytest.approx(2, rel=1e-12)
    assert size(body, "held", "base") == pytest.approx(2, rel=1e-12)
    assert np.array_equal(body.facets("held"), body.facets("base"))
    assert body.interfaces == ("interface",)


@pytest.mark.parametrize(
    ("name", "content", "match"),
    [
        ("a.geo", "Point(1) = {0, 0, 0};\n", "a.geo: no surface and no volume"),
        ("b.geo", GEO.replace("Physical", "//"), "b.geo: no physical group of dimension 2"),
        ("c.geo", GEO.rstrip(), "its last line 'Mesh.MeshSizeMax = 0.2;' has no newline"),
        ("d.msh", msh(SQUARE, TWO)[:-40], "d.msh: gmsh cannot read it .*: it may be truncated"),
        ("e.msh", "", "e.msh: gmsh cannot read it"),
        ("f.step", "hello", "f.step: gmsh cannot read it .*no .step at all"),
        ("g.brep", "hello", "g.brep: no volume and no face in it"),
        ("h.stl", "hello", "h.stl: no triangles in it"),
        ("i.xdmf", "<Xdmf><Domain>", r"i.xdmf: it is no whole XML \(no element found"),
        ("j.xdmf", "<Xdmf><Domain></Domain></Xdmf>", "j.xdmf: no grid with Topology and Geometry"),
    ],
)
def test_bad_files(tmp_path, name, content, match, capfd) -> None:
    """Files without a body, truncated or of another kind are refused by name."""
    (tmp_path / name).write_text(content)
    with pytest.raises(ValueError, match=match):
        meshes.read(COMM, tmp_path / name)


def test_missing_file(tmp_path) -> None:
    """A missing file is refused with its path."""
    with pytest.raises(FileNotFoundError, match=r"no file '.*none.msh' in '.*': check the path"):
        meshes.read(COMM, tmp_path / "none.msh")


def test_order_and_dimension_of_a_mesh_are_its_own(session, tmp_path) -> None:
    """A mesh is neither raised to another order nor pressed into the plane."""
    box()
    gmsh.write(str(tmp_path / "box.msh"))
    with pytest.raises(ValueError, match="a mesh of order 1 cannot be read with order=2"):
        meshes.read(COMM, tmp_path / "box.msh", order=2)
    with pytest.raises(ValueError, match="gdim=2 needs a surface mesh with z = 0"):
        meshes.read(COMM, tmp_path / "box.msh", gdim=2)


def test_an_open_surface_is_refused(tmp_path) -> None:
    """A surface with a hole bounds no volume: its open edges are counted."""
    vertices = "".join(f"vertex {x}\n" for x in ("0 0 0", "1 0 0", "0 1 0"))
    facet = f"facet normal 0 0 1\nouter loop\n{vertices}endloop\nendfacet\n"
    (tmp_path / "open.stl").write_text(f"solid s\n{facet}endsolid s\n")
    with pytest.raises(ValueError, match="open.stl: 3 edges of its 1 triangles do not join two"):
        meshes.read(COMM, tmp_path / "open.stl")


def test_xdmf_without_its_numbers(tmp_path) -> None:
    """An .xdmf whose .h5 is gone, cut short, or whose cells are of two types, is refused."""
    body, file = BODIES["sheet"](), tmp_path / "body.xdmf"
    with XDMFFile(COMM, file, "w") as xdmf:
        xdmf.write_mesh(body.mesh)
    numbers = file.with_suffix(".h5").read_bytes()
    file.with_suffix(".h5").write_bytes(numbers[: len(numbers) // 2])
    with pytest.raises(ValueError, match="body.xdmf: .*: it may be truncated"):
        meshes.read(COMM, file)
    file.with_suffix(".h5").unlink()
    with pytest.raises(ValueError, match="its numbers are in 'body.h5', which is not beside it"):
        meshes.read(COMM, file)
    file.write_text(
        """<Xdmf><Domain><Grid Name="g"><Topology TopologyType="Mixed"><DataItem DataType="Int"
        Dimensions="9" Format="XML">4 0 1 2 5 0 2 3 1</DataItem></Topology><Geometry><DataItem
        Dimensions="4 2" Format="XML">0 0 1 0 1 1 0 1</DataItem></Geometry></Grid>
        </Domain></Xdmf>"""
    )
    with pytest.raises(ValueError, match="holds quadrilateral cells of 4 nodes and triangle"):
        meshes.read(COMM, file)


# Ranks

PROGRAM = """
import json, sys
from mpi4py import MPI
import ufl
from dolfinx import fem
from variform import meshes

comm, folder = MPI.COMM_WORLD, sys.argv[1]

def total(value):
    return comm.allreduce(value)

def facts(body):
    imap, one = body.mesh.topology.index_map(body.facet_tags.dim), fem.Constant(body.mesh, 1.0)
    x, n = ufl.SpatialCoordinate(body.mesh), ufl.FacetNormal(body.mesh)
    facts = [total(fem.assemble_scalar(fem.form(one * body.dx())))]
    facts += [total(fem.assemble_scalar(fem.form(ufl.inner(x, n) * body.ds(degree=4))))]
    for name in body.boundaries:
        facts += [total(fem.assemble_scalar(fem.form(one * body.ds(name, degree=4))))]
        facts += [total(int((body.facets(name) < imap.size_local).sum()))]
    for name in body.regions:
        facts += [total(fem.assemble_scalar(fem.form(one * body.dx(name))))]
    return facts

out = {
    "block": facts(meshes.block(comm, (1.0, 0.2, 0.2), h=0.1)),
    "hexahedra": facts(meshes.block(comm, (1, 0.2, 0.2), n=2, cells="hexahedron", order=2)),
    "octant": facts(meshes.sphere_octant(comm, 0.5, 1.0, h=0.4, order=2)),
    "two cells": facts(meshes.block(comm, (1, 1), n=1)),
    "geo": facts(meshes.read(comm, folder + "/plate.geo")),
    "xdmf": facts(meshes.read(comm, folder + "/plate.xdmf")),
}
errors = []
for call in (
    lambda: meshes.read(comm, folder + "/none.msh"),
    lambda: meshes.read(comm, folder + "/short.msh"),
    lambda: meshes.read(comm, folder + "/empty.msh"),
    lambda: meshes.block(comm, (1, 1)),
    lambda: meshes.block(comm, (1, 1), n=1).ds("lfet"),
):
    try:
        call()
    except Exception as error:
        errors.append(type(error).__name__ + str(error))
out["errors"] = errors
assert comm.allgather(errors) == comm.size * [errors], errors
if comm.rank == 0:
    print(json.dumps(out))
"""


def test_n_ranks_are_one_rank(tmp_path) -> None:
    """Volumes, areas, numbers of facets and errors are the same on 1, 2 and 3 ranks; none hangs."""
    (tmp_path / "program.py").write_text(PROGRAM)
    (tmp_path / "plate.geo").write_text(GEO)
    (tmp_path / "short.msh").write_text(msh(SQUARE, TWO)[:-40])
    (tmp_path / "empty.msh").write_text(msh([*SQUARE, (2, 0, 0)], [*TWO, (1, 2, (2, 5))]))
    plate = meshes.read(MPI.COMM_SELF, tmp_path / "plate.geo")
    with XDMFFile(MPI.COMM_SELF, tmp_path / "plate.xdmf", "w") as xdmf:
        xdmf.write_mesh(plate.mesh)
        xdmf.write_meshtags(plate.cell_tags, plate.mesh.geometry)
        xdmf.write_meshtags(plate.facet_tags, plate.mesh.geometry)
    env = os.environ | {"PYTHONPATH": str(ROOT)}
    program = [sys.executable, str(tmp_path / "program.py"), str(tmp_path)]
    results = []
    for ranks in 1, 2, 3:
        start = [] if ranks == 1 else ["mpirun", "-n", str(ranks)]
        done = subprocess.run(
            [*start, *program],
            env=env,
            capture_output=True,
            text=True,
            timeout=LIMIT,
            check=False,
        )
        assert done.returncode == 0, done.stderr[-2000:]
        results.append(json.loads(done.stdout.splitlines()[-1]))
    errors = results[0]["errors"]
    kinds = ["FileNotFoundErrorno file", "ValueErrorshort.msh", "ValueErrorempty.msh: 1 of"]
    kinds += ["ValueErrorblock needs either", 'ValueErrorno boundary named "lfet"']
    assert all(error.startswith(kind) for error, kind in zip(errors, kinds, strict=True))
    for result in results[1:]:
        assert result.pop("errors") == errors
        for name, facts in result.items():
            assert facts == pytest.approx(results[0][name], rel=1e-12), name


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


def test_named_facets_that_no_cell_has_are_refused(tmp_path: Path) -> None:
    """An edge to a point that no cell uses, and one through the body, are no boundary."""
    file = tmp_path / "loose.msh"
    file.write_text(
        "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n"
        '$PhysicalNames\n2\n2 1 "body"\n1 2 "right"\n$EndPhysicalNames\n'
        "$Nodes\n5\n1 0 0 0\n2 1 0 0\n3 1 1 0\n4 0 1 0\n5 2 2 0\n$EndNodes\n"
        "$Elements\n5\n1 2 2 1 1 1 2 3\n2 2 2 1 1 1 3 4\n"
        "3 1 2 2 1 2 3\n4 1 2 2 1 3 5\n5 1 2 2 1 2 4\n$EndElements\n"
    )
    message = "loose.msh: 2 of 3 facets of 'right' are no facets of its cells"
    with pytest.raises(ValueError, match=message):
        meshes.read(COMM, file)
