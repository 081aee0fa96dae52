# SPDX-License-Identifier: MIT
"""Meshes of other programs, by meshio: XDMF and its HDF5, .msh, Abaqus."""

import sys

import gmsh
import numpy as np
import pytest
from bodies import COMM, area, box, integral, volumes
from dolfinx.io import XDMFFile
from mesh_texts import INP, POINTS, TETS, attribute

from variform import meshes

NO_H5PY = "h5py is not installed: meshio writes HDF5 by it"


@pytest.mark.parametrize("data_format", ["HDF", "XML", "Binary"])
def test_xdmf_of_meshio(session, tmp_path, monkeypatch, data_format) -> None:
    """What meshio makes of a .msh, cells and facets mixed in one grid, comes back with its tags."""
    meshio = pytest.importorskip("meshio")
    pytest.importorskip("h5py", reason=NO_H5PY)
    box(0.6)
    gmsh.write(str(tmp_path / "box.msh"))
    mesh = meshio.read(tmp_path / "box.msh")
    monkeypatch.chdir(tmp_path)  # its raw files are named relative to the working folder
    meshio.write("box.xdmf", mesh, data_format=data_format)
    body = meshes.read(COMM, tmp_path / "box.xdmf")
    assert volumes(body) == pytest.approx({"1": 3, "2": 3}, rel=1e-12)
    assert set(body.boundaries) == {"10", "13", "16"} and body.interfaces == ("13",)
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
    box(0.6)
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
    (tmp_path / "a.inp").write_text(INP + more)
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
