# SPDX-License-Identifier: MIT
"""Files in: regions, boundaries and data of every format; odd files; arrays; a user's gmsh."""

import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from mpi4py import MPI

import gmsh
import numpy as np
import odd_files
import pytest
import ufl
from conftest import LIMIT
from dolfinx import fem
from dolfinx.io import XDMFFile
from odd_files import POINTS, TAGS, TETS, attribute, data2, msh2, xdmf

from variform import meshes

COMM = MPI.COMM_WORLD
ROOT = Path(__file__).parent.parent
HALVES = {"1": 1 / 6, "2": 1 / 3}

NO_H5PY = "h5py is not installed: meshio writes HDF5 by it"


def volumes(body: meshes.Body) -> dict[str, float]:
    one = fem.Constant(body.mesh, 1.0)
    return {name: integral(one, body.dx(name)) for name in body.regions}


def integral(integrand: ufl.core.expr.Expr, measure: ufl.Measure) -> float:
    return COMM.allreduce(fem.assemble_scalar(fem.form(integrand * measure)))


def area(body: meshes.Body, *names: str) -> float:
    return integral(fem.Constant(body.mesh, 1.0), body.ds(*names))


def halves(body: meshes.Body) -> None:
    assert volumes(body) == pytest.approx(HALVES, rel=1e-12)


@pytest.fixture
def session() -> Iterator[None]:
    """A gmsh session of the test's own."""
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    yield
    gmsh.finalize()


# Odd files


def test_odd_files(tmp_path) -> None:
    """Each odd file is read right, or refused in one sentence with its name; 2 ranks as 1."""
    assert len(odd_files.FILES) >= 60
    odd_files.write(tmp_path)
    command = [sys.executable, str(ROOT / "tests" / "odd_files.py"), str(tmp_path)]
    results = []
    for start in [], ["mpirun", "-n", "2"]:
        done = subprocess.run(
            [*start, *command],
            # Waiting ranks let the others work: rank 0 reads alone.
            env=os.environ | {"PYTHONPATH": str(ROOT), "OMPI_MCA_mpi_yield_when_idle": "1"},
            capture_output=True,
            text=True,
            timeout=LIMIT,
            check=False,
        )
        assert done.returncode == 0, done.stderr[-2000:]
        results.append(json.loads(done.stdout.splitlines()[-1]))
    for found in results:
        for name, (_, wanted) in odd_files.FILES.items():
            if isinstance(wanted, str):
                assert isinstance(found[name], str), (name, found[name])
                assert name in found[name] and wanted in found[name], found[name]
                assert found[name].count("\n") == 0, found[name]
            else:
                assert found[name] == pytest.approx(wanted, rel=1e-9), name


# Tags and data


def test_data_are_no_tags(tmp_path) -> None:
    """Values of cells before the tags stay data, scalars and vectors, and so do those of points.

    With E = 1.5 and 2.5 on volumes 1/6 and 1/3 the integral of E is 13/12.
    """
    file = tmp_path / "data.xdmf"
    more = attribute("E", "1.5 2.5", kind="Float")
    more += attribute("fiber", "1 0 0 0 0 1", "2 3", "Float") + TAGS
    more += attribute("T", "0 1 2 3 4", "5", "Float", "Node")
    file.write_text(xdmf(more))
    body = meshes.read(COMM, file)
    halves(body)
    assert set(body.data) == {"E", "fiber", "T"}
    E, fiber, T = (body.data[name] for name in ("E", "fiber", "T"))
    assert integral(E, body.dx()) == pytest.approx(13 / 12, rel=1e-12)
    assert integral(E, body.dx("2")) == pytest.approx(2.5 / 3, rel=1e-12)
    assert fiber.ufl_shape == (3,) and fiber.function_space.ufl_element().degree == 0
    assert integral(fiber[0], body.dx("1")) == pytest.approx(1 / 6, rel=1e-12)
    assert integral(fiber[2], body.dx("2")) == pytest.approx(1 / 3, rel=1e-12)
    assert integral(fiber[0], body.dx("2")) == 0
    # The mean of a linear function over a tetrahedron is that of its vertices.
    assert T.function_space.ufl_element().degree == 1
    assert integral(T, body.dx("1")) == pytest.approx((0 + 1 + 2 + 3) / 4 / 6, rel=1e-12)
    assert integral(T, body.dx("2")) == pytest.approx((0 + 1 + 2 + 4) / 4 / 3, rel=1e-12)


def test_whole_numbers_of_any_name_are_both(tmp_path) -> None:
    """The only whole numbers under a name that tells nothing are regions, and data as well."""
    (tmp_path / "a.xdmf").write_text(xdmf(attribute("grain", "1 2")))
    body = meshes.read(COMM, tmp_path / "a.xdmf")
    halves(body)
    assert integral(body.data["grain"], body.dx()) == pytest.approx(1 / 6 + 2 / 3, rel=1e-12)
    (tmp_path / "b.xdmf").write_text(xdmf(TAGS))
    assert not meshes.read(COMM, tmp_path / "b.xdmf").data


def test_tensors_and_last_steps(tmp_path) -> None:
    """Nine numbers are a tensor by rows; of a series in time the last step counts."""
    tensor = " ".join(map(str, range(18)))
    grid = odd_files.grid(TAGS + attribute("A", tensor, "2 9", "Float"))
    steps = "".join(
        f'<Grid Name="t">{attribute("E", f"{i} {2 * i}", kind="Float")}</Grid>' for i in (1, 2)
    )
    series = f'<Grid Name="s" GridType="Collection" CollectionType="Temporal">{steps}</Grid>'
    (tmp_path / "a.xdmf").write_text(f"<Xdmf><Domain>{grid}{series}</Domain></Xdmf>")
    body = meshes.read(COMM, tmp_path / "a.xdmf")
    halves(body)
    assert body.data["A"].ufl_shape == (3, 3)
    assert integral(body.data["A"][0, 1], body.dx("1")) == pytest.approx(1 / 6, rel=1e-12)
    assert integral(body.data["A"][1, 0], body.dx("2")) == pytest.approx(12 / 3, rel=1e-12)
    assert integral(body.data["E"], body.dx("2")) == pytest.approx(4 / 3, rel=1e-12)


@pytest.mark.parametrize("suffix", ["msh", "vtu", "vtk"])
def test_data_of_other_files(tmp_path, suffix) -> None:
    """Data come from a .msh by the elements' numbers, from .vtu and .vtk by order; NaN where none.

    In the .msh they are listed backwards.
    """
    file = tmp_path / f"a.{suffix}"
    if suffix == "msh":
        nodal = {i: float(i - 1) for i in (5, 4, 3, 2, 1)}
        more = data2("E", {2: 2.5, 1: 1.5}) + data2("T", nodal, "NodeData")
        file.write_text(msh2(more=more + data2("part", {2: 7.0})))
    else:
        meshio = pytest.importorskip("meshio")
        cell_data = {"E": [[1.5, 2.5]], "regions": [[1, 2]], "part": [[np.nan, 7.0]]}
        cell_data = {name: [np.array(v) for v in values] for name, values in cell_data.items()}
        tets = [("tetra", np.array(TETS))]
        points = np.array(POINTS, dtype=float)
        meshio.Mesh(points, tets, {"T": np.arange(5.0)}, cell_data).write(file)
    body = meshes.read(COMM, file)
    halves(body)
    assert integral(body.data["E"], body.dx()) == pytest.approx(13 / 12, rel=1e-12)
    assert integral(body.data["T"], body.dx("2")) == pytest.approx(7 / 4 / 3, rel=1e-12)
    assert integral(body.data["part"], body.dx("2")) == pytest.approx(7 / 3, rel=1e-12)
    assert np.isnan(integral(body.data["part"], body.dx("1")))


# meshio


def box() -> None:
    """Box 1 x 2 x 3 of two halves, soft (1) below z = 1.5; sides base (10) and interface (13)."""
    occ = gmsh.model.occ
    halves = [(3, occ.addBox(0, 0, z, 1, 2, 1.5)) for z in (0, 1.5)]
    occ.fragment(halves[:1], halves[1:])
    occ.synchronize()
    for z, tag, name in (0, 10, "base"), (1.5, 13, "interface"):
        found = gmsh.model.getEntitiesInBoundingBox(-1, -1, z - 0.01, 2, 3, z + 0.01, 2)
        gmsh.model.addPhysicalGroup(2, [face for _, face in found], tag, name)
    for tag, z, name in (1, 0, "soft"), (2, 1.5, "hard"):
        found = gmsh.model.getEntitiesInBoundingBox(-1, -1, z - 0.01, 2, 3, z + 1.51, 3)
        gmsh.model.addPhysicalGroup(3, [volume for _, volume in found], tag, name)
    gmsh.option.setNumber("Mesh.MeshSizeMax", 0.6)
    gmsh.model.mesh.generate(3)


@pytest.mark.parametrize("data_format", ["HDF", "XML", "Binary"])
def test_xdmf_of_meshio(session, tmp_path, monkeypatch, data_format) -> None:
    """What meshio makes of a .msh, cells and facets mixed in one grid, comes back with its tags."""
    meshio = pytest.importorskip("meshio")
    pytest.importorskip("h5py", reason=NO_H5PY)
    box()
    gmsh.write(str(tmp_path / "box.msh"))
    mesh = meshio.read(tmp_path / "box.msh")
    monkeypatch.chdir(tmp_path)  # its raw files are named relative to the working folder
    meshio.write("box.xdmf", mesh, data_format=data_format)
    body = meshes.read(COMM, tmp_path / "box.xdmf")
    assert volumes(body) == pytest.approx({"1": 3, "2": 3}, rel=1e-12)
    assert set(body.boundaries) == {"10", "13"} and body.interfaces == ("13",)
    assert area(body, "10") == pytest.approx(2, rel=1e-12)
    tets = meshio.Mesh(mesh.points, [("tetra", mesh.cells_dict["tetra"])])
    meshio.write("tets.xdmf", tets, data_format=data_format)
    body = meshes.read(COMM, tmp_path / "tets.xdmf")
    assert volumes(body) == pytest.approx({"body": 6}, rel=1e-12) and not body.boundaries


def test_numbers_in_hdf_without_h5py(tmp_path, monkeypatch) -> None:
    """Without h5py DOLFINx reads what it wrote; more is refused with what to install."""
    monkeypatch.setitem(sys.modules, "h5py", None)
    body = meshes.block(COMM, (1.0, 0.2, 0.3), n=2)
    with XDMFFile(COMM, tmp_path / "body.xdmf", "w") as file:
        file.write_mesh(body.mesh)
        file.write_meshtags(body.cell_tags, body.mesh.geometry)
        file.write_meshtags(body.facet_tags, body.mesh.geometry)
    copy = meshes.read(COMM, tmp_path / "body.xdmf")
    assert volumes(copy) == pytest.approx({"1": 0.06}, rel=1e-12)
    assert len(copy.boundaries) == 6
    text = (tmp_path / "body.xdmf").read_text()
    own = attribute("E", "0", "1", "Float").replace('"XML">0', '"HDF">body.h5:/E')
    (tmp_path / "body.xdmf").write_text(text.replace("</Geometry>", f"</Geometry>{own}", 1))
    with pytest.raises(ImportError, match="body.xdmf: its numbers are in HDF5, .*python3-h5py"):
        meshes.read(COMM, tmp_path / "body.xdmf")


def test_hdf_of_dolfinx_by_h5py(tmp_path) -> None:
    """With h5py the same file gives the same areas, whichever of the two reads it."""
    pytest.importorskip("h5py", reason="h5py is not installed: the other way is tested above")
    body = meshes.block(COMM, (1.0, 0.2, 0.3), n=2, order=2)
    with XDMFFile(COMM, tmp_path / "body.xdmf", "w") as file:
        file.write_mesh(body.mesh)
        file.write_meshtags(body.cell_tags, body.mesh.geometry)
        file.write_meshtags(body.facet_tags, body.mesh.geometry)
    copy = meshes.read(COMM, tmp_path / "body.xdmf")
    areas = {str(tag): area(body, name) for name, tag in body.boundaries.items()}
    assert {name: area(copy, name) for name in copy.boundaries} == pytest.approx(areas, rel=1e-12)


@pytest.mark.parametrize("binary", [False, True])
def test_msh_of_meshio(session, tmp_path, binary) -> None:
    """Meshio's .msh of version 4.1: with entities as gmsh's own, without them one body and data."""
    meshio = pytest.importorskip("meshio")
    box()
    gmsh.write(str(tmp_path / "box.msh"))
    mesh = meshio.read(tmp_path / "box.msh")
    mesh.write(tmp_path / "again.msh", file_format="gmsh", binary=binary)
    body = meshes.read(COMM, tmp_path / "again.msh")
    assert volumes(body) == pytest.approx({"soft": 3, "hard": 3}, rel=1e-12)
    assert area(body, "base") == pytest.approx(2, rel=1e-12)
    tets, points = [("tetra", np.array(TETS))], np.array(POINTS, dtype=float)
    bare = meshio.Mesh(points, tets, {"T": np.arange(5.0)}, {"E": [np.array([1.5, 2.5])]})
    bare.write(tmp_path / "bare.msh", file_format="gmsh", binary=binary)
    body = meshes.read(COMM, tmp_path / "bare.msh")
    assert volumes(body) == pytest.approx({"body": 0.5}, rel=1e-12)
    assert integral(body.data["E"], body.dx()) == pytest.approx(13 / 12, rel=1e-12)
    bare.field_data = {"soft": np.array([1, 3])}
    bare.write(tmp_path / "named.msh", file_format="gmsh", binary=binary)
    with pytest.raises(ValueError, match="named.msh: it names 'soft', and says of no cell"):
        meshes.read(COMM, tmp_path / "named.msh")


def test_abaqus(tmp_path) -> None:
    """Sets of elements, of nodes and surfaces become names; a set of nodes those of whole facets.

    Of the nodes of z = 0 one facet lies inside: nothing of the surface has them all.
    """
    more = "*ELSET, ELSET=Upper\n7\n*SURFACE, TYPE=ELEMENT, NAME=Slope\nUpper, S3\n"
    more += "*NSET, NSET=Wall\n10, 20, 40, 50\n*NSET, NSET=Inside\n10, 20, 30\n"
    more += "*NSET, NSET=Corner\n10\n"
    (tmp_path / "a.inp").write_text(odd_files.INP + more)
    body = meshes.read(COMM, tmp_path / "a.inp")
    assert volumes(body) == pytest.approx({"Upper": 1 / 6, "body": 1 / 3}, rel=1e-12)
    assert set(body.boundaries) == {"Slope", "Wall"}
    assert area(body, "Slope") == pytest.approx(np.sqrt(3) / 2, rel=1e-12)
    assert area(body, "Wall") == pytest.approx(1 / 2 + 1, rel=1e-12)


@pytest.mark.parametrize("kind", ["C3D10", "C3D8", "CPS4", "CPE6"])
def test_types_of_abaqus(tmp_path, kind) -> None:
    """Solids and plane elements of order 1 and 2 come with their faces S1, S2, …: together all."""
    cells = {"C3D10": "tetrahedron", "C3D8": "hexahedron", "CPS4": "quadrilateral"}
    cell = cells.get(kind, "triangle")
    order = 2 if kind in ("C3D10", "CPE6") else 1
    sides = {"tetrahedron": 4, "hexahedron": 6, "quadrilateral": 4, "triangle": 3}[cell]
    dim = 2 if kind in ("CPS4", "CPE6") else 3
    x = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)])
    if cell == "hexahedron":
        x = np.vstack([x, x + np.array([0, 0, 1])])
    elif cell == "triangle":
        x = x[[0, 1, 3]]
    elif cell == "tetrahedron":
        x = np.vstack([x[[0, 1, 3]], [(0, 0, 1)]])
    if order == 2:
        edges = [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)][: 3 if dim == 2 else 6]
        x = np.vstack([x, [(x[a] + x[b]) / 2 for a, b in edges]])
    lines = ["*NODE", *(f"{i}, {a}, {b}, {c}" for i, (a, b, c) in enumerate(x, 1))]
    lines += [f"*ELEMENT, TYPE={kind}", ", ".join(map(str, range(1, len(x) + 2)))]
    lines[-1] = "1, " + ", ".join(map(str, range(1, len(x) + 1)))
    for i in range(1, sides + 1):
        lines += [f"*SURFACE, TYPE=ELEMENT, NAME=side{i}", f"1, S{i}"]
    (tmp_path / "a.inp").write_text("\n".join(lines) + "\n")
    body = meshes.read(COMM, tmp_path / "a.inp")
    volume = {"tetrahedron": 1 / 6, "triangle": 1 / 2}.get(cell, 1)
    assert volumes(body) == pytest.approx({"body": volume}, rel=1e-12)
    assert len(body.boundaries) == sides and body.mesh.geometry.dim == dim
    assert sum(area(body, name) for name in body.boundaries) == pytest.approx(area(body), rel=1e-12)


# Arrays


def test_from_arrays() -> None:
    """Names of regions may overlap; facets come by rows or as a set of points; data by number."""
    body = meshes.from_arrays(
        COMM,
        POINTS,
        TETS,
        regions={"upper": [0], "all": [True, True]},
        boundaries={"x0": [0, 2, 3, 4], "slope": [(3, 2, 1)], "inside": [(0, 1, 2)]},
        data={"E": {104: 2.5, 17: 1.5}, "fiber": [(1, 0, 0), (0, 0, 1)], "T": np.arange(5.0)},
        numbers=[17, 104],
    )
    assert volumes(body) == pytest.approx({"upper": 1 / 6, "all": 1 / 2}, rel=1e-12)
    assert area(body, "x0") == pytest.approx(1 / 2 + 1, rel=1e-12)
    assert area(body, "slope") == pytest.approx(np.sqrt(3) / 2, rel=1e-12)
    assert body.interfaces == ("inside",)
    assert integral(body.data["E"], body.dx("upper")) == pytest.approx(1.5 / 6, rel=1e-12)
    assert integral(body.data["E"], body.dx()) == pytest.approx(13 / 12, rel=1e-12)
    assert integral(body.data["fiber"][2], body.dx()) == pytest.approx(1 / 3, rel=1e-12)
    assert integral(body.data["T"], body.dx("upper")) == pytest.approx(1 / 4, rel=1e-12)
    halves(meshes.from_arrays(COMM, POINTS, TETS, regions=np.array([1, 2])))
    flat = meshes.from_arrays(COMM, [(0, 0), (2, 0), (2, 1), (0, 1)], [(0, 1, 2, 3)])
    assert flat.mesh.topology.cell_name() == "quadrilateral"
    assert volumes(flat) == pytest.approx({"body": 2}, rel=1e-12)
    shell = meshes.from_arrays(
        COMM, [(0, 0, 0), (2, 0, 1), (2, 1, 1), (0, 1, 0)], [(0, 1, 2, 3)], cell="quadrilateral"
    )
    assert volumes(shell) == pytest.approx({"body": np.sqrt(5)}, rel=1e-12)


BAD_ARRAYS = {
    r"needs points of shape .*, got \(5,\) and \(2, 4\)": {"points": range(5)},
    "needs points as one array, got rows of several lengths": {"points": [(0, 0), (1, 0, 0)]},
    "needs cells of whole numbers, got the type float64": {"cells": [(0.5, 1, 2, 3)]},
    "cells of 5 nodes and cell=None make no triangles": {"cells": [(0, 1, 2, 3, 4)]},
    "cells of 4 nodes and cell='wedge' make no": {"cell": "wedge"},
    "has the node 9, of 5": {"cells": [(0, 1, 2, 9)]},
    "region 'a' needs indices from 0 to 1": {"regions": {"a": [2]}},
    "region 'a' needs .* a mask of 2 cells, got 3": {"regions": {"a": [True, False, True]}},
    r"one tag for each of 2 cells, got \(3,\)": {"regions": [1, 2, 3]},
    "region 'a' holds no cell": {"regions": {"a": []}},
    "boundary 'b' needs rows of 3 points from 0 to 4": {"boundaries": {"b": [(0, 1)]}},
    "1 of 1 facets of 'b' are no facets": {"boundaries": {"b": [(0, 3, 4)]}},
    "boundary 'b' holds no facet of the surface": {"boundaries": {"b": [0, 1]}},
    r"data 'E' has the shape \(3,\), and there are 2 cells": {"data": {"E": [1, 2, 3]}},
    "data 'E' of numbers, got the type <U": {"data": {"E": ["a", "b"]}},
    "data 'E' has values for 1 cells that there are not, the first is number 5": {
        "data": {"E": {5: 1.0}}
    },
    "needs one number for each of 2 cells": {"numbers": [4, 4]},
    "there are 4 cells and as many points, so data 'E' may be of both": {
        "points": POINTS[:4],
        "cells": 4 * [(0, 1, 2, 3)],
        "data": {"E": np.ones(4)},
    },
    "1 of 2 cells come twice": {"cells": [TETS[0], TETS[0]]},
    "gdim must be 2, 3 or None, got gdim=1": {"gdim": 1},
    "gdim=2 needs a surface mesh with z = 0": {"gdim": 2},
}


@pytest.mark.parametrize("match", BAD_ARRAYS)
def test_bad_arrays(match) -> None:
    """Arrays that make no body are refused with what is wrong with them."""
    with pytest.raises(ValueError, match=match):
        meshes.from_arrays(COMM, **({"points": POINTS, "cells": TETS} | BAD_ARRAYS[match]))


# A user's gmsh


@pytest.mark.parametrize(("option", "value"), [("OCCTargetUnit", "M"), ("OCCScaling", 2.0)])
def test_a_users_units_are_not_the_files(session, tmp_path, option, value, capfd) -> None:
    """A STEP file of 1000 mm^3 is that under any option of the session, which keeps it."""
    gmsh.model.occ.addBox(0, 0, 0, 10, 10, 10)
    gmsh.model.occ.synchronize()
    gmsh.write(str(tmp_path / "box.step"))
    name = f"Geometry.{option}"
    kind = "String" if isinstance(value, str) else "Number"
    getattr(gmsh.option, f"set{kind}")(name, value)
    body = meshes.read(COMM, tmp_path / "box.step", h=10)
    assert sum(volumes(body).values()) == pytest.approx(1000, rel=1e-12)
    assert getattr(gmsh.option, f"get{kind}")(name) == value


def test_everything_of_a_session_comes_back(session, tmp_path) -> None:
    """Options of every kind, views and their options, and variables stay; those of a .geo go.

    The options that gmsh lists in an .opt are all that differ from its own.
    """

    def everything() -> str:
        gmsh.write(str(tmp_path / "all.opt"))
        return (tmp_path / "all.opt").read_text(errors="replace")

    gmsh.option.setNumber("Mesh.MeshSizeMax", 1 / 3)
    gmsh.option.setNumber("Mesh.Smoothing", 7)
    gmsh.option.setString("Solver.Name0", "mine")
    gmsh.option.setColor("Mesh.Points", 1, 2, 3, 4)
    view = gmsh.view.add("mine")
    gmsh.view.option.setNumber(view, "NbIso", 33)
    gmsh.parser.setNumber("width", [2.0, 3.0])
    gmsh.parser.setString("title", ["a", "b"])
    before = everything()
    script = 'If (Exists(width))\n  Error("seen");\nEndIf\nDefineConstant[ h = {0.5, Name "h"} ];\n'
    script += "Mesh.Smoothing = 3;\nMesh.ElementOrder = 2;\nGeometry.Tolerance = 0.001;\n"
    script += "General.Verbosity = 99;\nSolver.AutoMesh = 0;\nMesh.Color.Points = {9, 9, 9};\n"
    (tmp_path / "a.geo").write_text(script + odd_files.GEO_SQUARE)
    body = meshes.read(COMM, tmp_path / "a.geo")
    assert body.mesh.ufl_domain().ufl_coordinate_element().degree == 2
    (tmp_path / "a.msh").write_text(msh2(more=data2("E", {1: 1.5, 2: 2.5})))
    assert set(meshes.read(COMM, tmp_path / "a.msh").data) == {"E"}
    assert everything() == before
    assert gmsh.option.getNumber("Mesh.MeshSizeMax") == 1 / 3
    assert gmsh.option.getColor("Mesh.Points") == (1, 2, 3, 4)
    assert list(gmsh.view.getTags()) == [view]
    assert set(gmsh.parser.getNames()) == {"width", "title"}
    assert list(gmsh.parser.getNumber("width")) == [2.0, 3.0]
    assert gmsh.parser.getString("title") == ["a", "b"]
    assert "h" not in gmsh.onelab.getNames()


# Names


def test_names_of_faces_in_step(session, tmp_path, monkeypatch, capfd) -> None:
    """Names of faces that gmsh drops are told of, with the .geo that gives them."""
    gmsh.model.occ.addBox(0, 0, 0, 1, 1, 1)
    gmsh.model.occ.synchronize()
    gmsh.write(str(tmp_path / "box.step"))
    text = (tmp_path / "box.step").read_text()
    names = iter(["inlet", "outlet", "", "NONE", "", ""])
    text = re.sub(r"ADVANCED_FACE\('", lambda found: found[0] + next(names), text)
    (tmp_path / "box.step").write_text(text)
    message = r"box.step: gmsh does not read the names of its faces \('inlet', 'outlet'\)"
    with pytest.warns(UserWarning, match=message) as told:
        body = meshes.read(COMM, tmp_path / "box.step", h=1)
    assert set(body.boundaries) == {f"face{i}" for i in range(1, 7)}
    lines = re.search(r'Merge "box.step"; .*\};', str(told[0].message))
    assert lines is not None
    (tmp_path / "named.geo").write_text(lines[0].replace("; ", ";\n") + "\n")
    body = meshes.read(COMM, tmp_path / "named.geo", h=1)
    assert set(body.boundaries) == {"inlet"} and set(body.regions) == {"body"}
    assert area(body, "inlet") == pytest.approx(1, rel=1e-12)

    def known(dim: int, tag: int) -> str:
        return {1: "Shapes/part/inlet", 2: "Shapes/part/wall", 3: "Shapes/part/wall"}.get(tag, "")

    monkeypatch.setattr(gmsh.model, "getEntityName", known)
    body = meshes.read(COMM, tmp_path / "box.step", h=1)
    assert set(body.boundaries) == {"inlet", "wall", "face4", "face5", "face6"}
    assert area(body, "wall") == pytest.approx(2, rel=1e-12)


# Ranks

PROGRAM = """
import json, sys
from mpi4py import MPI
import numpy as np
from dolfinx import fem
from variform import meshes

comm, folder = MPI.COMM_WORLD, sys.argv[1]
out = {}
x = [(i / 8, j / 8) for j in range(9) for i in range(9)]
cells = [(9 * j + i, 9 * j + i + 1, 9 * j + i + 10, 9 * j + i + 9)
         for j in range(8) for i in range(8)]
middle = np.mean(np.array(x)[np.array(cells)], axis=1)
bodies = {
    "arrays": meshes.from_arrays(
        comm, *((x, cells) if comm.rank == 0 else ()),
        regions={"left": middle[:, 0] < 0.5, "lower": middle[:, 1] < 0.5},
        boundaries={"x0": np.flatnonzero(np.array(x)[:, 0] == 0)},
        data={"E": middle[:, 0], "X": np.array(x)},
    ),
    "xdmf": meshes.read(comm, folder + "/box.xdmf"),
    "msh": meshes.read(comm, folder + "/box.msh"),
}
for name, body in bodies.items():
    one = fem.Constant(body.mesh, 1.0)
    outer = [b for b in body.boundaries if b not in body.interfaces]
    measures = [body.dx(), body.ds(*outer)] + [body.dx(r) for r in body.regions]
    facts = [fem.assemble_scalar(fem.form(one * m)) for m in measures]
    for key in sorted(body.data):
        f = body.data[key]
        g = f[0] if f.ufl_shape else f
        for m in (m for m in measures if m.integral_type() == "cell"):
            facts.append(fem.assemble_scalar(fem.form(g * g * m)))
    X = body.data["X"]
    Y = fem.Function(X.function_space)
    Y.interpolate(lambda p: p[: X.ufl_shape[0]])
    facts.append(float(np.abs(X.x.array - Y.x.array).max()))
    assert facts[-1] < 1e-14, facts[-1]
    out[name] = [comm.allreduce(fact) for fact in facts[:-1]]
errors = []
for change in {"cells": [(0, 1, 2, 99)]}, {"boundaries": {"b": [0]}}, {"data": {"E": {999: 1}}}:
    try:
        meshes.from_arrays(comm, **({"points": x, "cells": cells} | change))
    except ValueError as error:
        errors.append(str(error))
assert len(errors) == 3 and comm.allgather(errors) == comm.size * [errors], errors
if comm.rank == 0:
    print(json.dumps(out))
"""


def test_data_of_n_ranks_are_those_of_one(session, tmp_path) -> None:
    """Integrals of data, over regions that overlap too, are the same on 1, 2 and 3 ranks.

    The coordinates as data of points are the coordinates.
    """
    (tmp_path / "program.py").write_text(PROGRAM)
    box()
    numbers, x, _ = gmsh.model.mesh.getNodes()
    _, (cells,), (nodes,) = gmsh.model.mesh.getElements(3)
    view = gmsh.view.add("X")
    gmsh.view.addHomogeneousModelData(view, 0, gmsh.model.getCurrent(), "NodeData", numbers, x)
    other = gmsh.view.add("E")
    gmsh.view.addHomogeneousModelData(
        other, 0, gmsh.model.getCurrent(), "ElementData", cells, cells.astype(float)
    )
    file = str(tmp_path / "box.msh")
    gmsh.write(file)
    for v in view, other:
        gmsh.view.write(v, file, append=True)
    index = np.zeros(int(numbers.max()) + 1, dtype=int)
    index[numbers] = np.arange(len(numbers))
    more = attribute("E", " ".join(map(str, cells / 2)), str(len(cells)), "Float")
    more += attribute("X", " ".join(map(str, x)), f"{len(numbers)} 3", "Float", "Node")
    more += attribute("tags", " ".join(map(str, cells % 3)), str(len(cells)))
    rows = index[nodes].reshape(-1, 4)
    (tmp_path / "box.xdmf").write_text(xdmf(more, cells=rows, points=x.reshape(-1, 3)))
    results = []
    for ranks in 1, 2, 3:
        start = [] if ranks == 1 else ["mpirun", "-n", str(ranks)]
        done = subprocess.run(
            [*start, sys.executable, "-m", "mpi4py", str(tmp_path / "program.py"), str(tmp_path)],
            env=os.environ | {"PYTHONPATH": str(ROOT)},
            capture_output=True,
            text=True,
            timeout=LIMIT,
            check=False,
        )
        assert done.returncode == 0, done.stderr[-2000:]
        results.append(json.loads(done.stdout.splitlines()[-1]))
    for result in results[1:]:
        for name, facts in result.items():
            assert facts == pytest.approx(results[0][name], rel=1e-11), name


@pytest.mark.parametrize("suffix", ["msh", "xdmf"])
def test_the_benchmark_of_reading(tmp_path, suffix) -> None:
    """At toy size the benchmark's box has all its cells, read by us on two ranks and by DOLFINx."""
    reading = [sys.executable, "-m", "demos.benchmarks.reading"]
    file = tmp_path / f"box.{suffix}"
    calls = [
        [*reading, "make", str(tmp_path), "4"],
        ["mpirun", "-n", "2", *reading, str(file), "ours"],
        [*reading, str(file), "dolfinx"],
    ]
    lines = []
    for call in calls:
        done = subprocess.run(
            call,
            cwd=ROOT,
            env=os.environ | {"PYTHONPATH": str(ROOT)},
            capture_output=True,
            text=True,
            timeout=LIMIT,
            check=False,
        )
        assert done.returncode == 0, done.stderr[-2000:]
        lines.append(done.stdout.splitlines()[-1:])
    ours, dolfinx = (json.loads(line[0]) for line in lines[1:])
    assert ours["cells"] == dolfinx["cells"] == 6 * 4**3
    assert ours["ranks"] == len(ours["peak"]) == 2
