# SPDX-License-Identifier: MIT
"""A gmsh session of the user's: models, options and views come back as they were."""

import gmsh
import odd_files
import pytest
from bodies import COMM, GEO, number_of_cells, size, volumes
from mesh_texts import data2, msh2

from variform import meshes


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
