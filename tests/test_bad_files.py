# SPDX-License-Identifier: MIT
"""Files that make no body are refused by name, with what is wrong and how often."""

from pathlib import Path

import gmsh
import numpy as np
import pytest
from bodies import BODIES, COMM, CUBE, GEO, SQUARE, TWO, box, msh, size
from dolfinx.io import XDMFFile

from variform import meshes

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
