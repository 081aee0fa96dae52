# SPDX-License-Identifier: MIT
"""Files of every kind that are read: volumes, areas and names; n ranks = 1 rank."""

import re
from math import pi
from pathlib import Path

from mpi4py import MPI

import gmsh
import numpy as np
import pytest
import ufl
from bodies import (
    BODIES,
    COMM,
    GEO,
    SQUARE,
    TWO,
    area,
    box,
    integral,
    msh,
    number_of_cells,
    size,
)
from dolfinx import fem
from dolfinx.io import XDMFFile

from variform import meshes


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


def test_order_and_dimension_of_a_mesh_are_its_own(session, tmp_path) -> None:
    """A mesh is neither raised to another order nor pressed into the plane."""
    box()
    gmsh.write(str(tmp_path / "box.msh"))
    with pytest.raises(ValueError, match="a mesh of order 1 cannot be read with order=2"):
        meshes.read(COMM, tmp_path / "box.msh", order=2)
    with pytest.raises(ValueError, match="gdim=2 needs a surface mesh with z = 0"):
        meshes.read(COMM, tmp_path / "box.msh", gdim=2)


# Ranks

PROGRAM = """
import json, sys
from mpi4py import MPI
import ufl
from bodies import integral
from dolfinx import fem
from variform import meshes

comm, folder = MPI.COMM_WORLD, sys.argv[1]

def facts(body):
    imap, one = body.mesh.topology.index_map(body.facet_tags.dim), fem.Constant(body.mesh, 1.0)
    x, n = ufl.SpatialCoordinate(body.mesh), ufl.FacetNormal(body.mesh)
    facts = [integral(one, body.dx()), integral(ufl.inner(x, n), body.ds(degree=4))]
    for name in body.boundaries:
        facts += [integral(one, body.ds(name, degree=4))]
        facts += [comm.allreduce(int((body.facets(name) < imap.size_local).sum()))]
    facts += [integral(one, body.dx(name)) for name in body.regions]
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


def test_n_ranks_are_one_rank(parallel, tmp_path) -> None:
    """Volumes, areas, numbers of facets and errors are the same on 1, 2 and 3 ranks; none hangs."""
    (tmp_path / "plate.geo").write_text(GEO)
    (tmp_path / "short.msh").write_text(msh(SQUARE, TWO)[:-40])
    (tmp_path / "empty.msh").write_text(msh([*SQUARE, (2, 0, 0)], [*TWO, (1, 2, (2, 5))]))
    plate = meshes.read(MPI.COMM_SELF, tmp_path / "plate.geo")
    with XDMFFile(MPI.COMM_SELF, tmp_path / "plate.xdmf", "w") as xdmf:
        xdmf.write_mesh(plate.mesh)
        xdmf.write_meshtags(plate.cell_tags, plate.mesh.geometry)
        xdmf.write_meshtags(plate.facet_tags, plate.mesh.geometry)
    results = [parallel(PROGRAM, ranks, tmp_path) for ranks in (1, 2, 3)]
    errors = results[0]["errors"]
    kinds = ["FileNotFoundErrorno file", "ValueErrorshort.msh", "ValueErrorempty.msh: 1 of"]
    kinds += ["ValueErrorblock needs either", 'ValueErrorno boundary named "lfet"']
    assert all(error.startswith(kind) for error, kind in zip(errors, kinds, strict=True))
    for result in results[1:]:
        assert result.pop("errors") == errors
        for name, facts in result.items():
            assert facts == pytest.approx(results[0][name], rel=1e-12), name


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
