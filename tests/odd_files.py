# SPDX-License-Identifier: MIT
"""Broken and odd mesh files, each with what has to come of it: an error's words, or the volumes.

`write(folder)` makes them; `python3 tests/odd_files.py FOLDER` reads them, on any number of ranks.
"""

import json
import sys
from pathlib import Path

from mpi4py import MPI

import ufl
from dolfinx import fem
from mesh_texts import (
    FIBER,
    INP,
    POINTS,
    TAGS,
    TETS,
    attribute,
    data2,
    mixed,
    msh2,
    msh4,
    vtk,
    vtu,
    xdmf,
)

from variform import meshes

# Either words of the message, or the volume of each region.
Outcome = str | dict[str, float]
SIXTH, THIRD = 1 / 6, 1 / 3
HALVES = {"1": SIXTH, "2": THIRD}
BOTH = {"body": 0.5}
TETRA10 = [*POINTS[:4], *((0.5, 0, 0), (0.5, 0.5, 0), (0, 0.5, 0), (0, 0, 0.5))]
TETRA10 += [(0.5, 0, 0.5), (0, 0.5, 0.5)]
SURFACE = [(0, 1, 2), (0, 1, 3)]
TRUNCATED = "it may be truncated"
GEO_SQUARE = (
    "Point(1) = {0, 0, 0, 1};\nPoint(2) = {1, 0, 0, 1};\nPoint(3) = {1, 1, 0, 1};\n"
    "Point(4) = {0, 1, 0, 1};\nLine(1) = {1, 2};\nLine(2) = {2, 3};\nLine(3) = {3, 4};\n"
    "Line(4) = {4, 1};\nCurve Loop(1) = {1, 2, 3, 4};\nPlane Surface(7) = {1};\n"
)
FILES: dict[str, tuple[str | bytes, Outcome]] = {
    # .msh, version 2
    "plain.msh": (msh2(), HALVES),
    "named.msh": (msh2(names=[(3, 1, "soft"), (3, 2, "hard")]), {"soft": SIXTH, "hard": THIRD}),
    "utf8.msh": (msh2(names=[(3, 1, "Knöchel ☃")]), {"Knöchel ☃": SIXTH, "2": THIRD}),
    "blank.msh": (msh2(names=[(3, 1, "left half")]), {"left half": SIXTH, "2": THIRD}),
    "quote.msh": (msh2(names=[(3, 1, "it's")]), {"it's": SIXTH, "2": THIRD}),
    "two names alike.msh": (
        msh2(names=[(3, 1, "a"), (3, 2, "a")]),
        "two physical groups of dimension 3 are named 'a'",
    ),
    "name of another's number.msh": (
        msh2(names=[(3, 1, "2")]),
        "two physical groups of dimension 3 are named '2'",
    ),
    "tags of one entity.msh": (msh2(entity=1), HALVES),
    "in two groups.msh": (
        msh2(cells=[*TETS, TETS[0]], tags=(1, 2, 2), entity=1),
        {"1": SIXTH, "2": 0.5},
    ),
    "no tags.msh": (msh2(tags=(0, 0)), BOTH),
    "one tag.msh": (msh2(tags=(0, 3)), {"3": THIRD}),
    "negative tag.msh": (msh2(tags=(1, -2)), HALVES),
    "twice.msh": (msh2(cells=[*TETS, TETS[0]], tags=(1, 2, 1)), "1 of 3 cells come twice"),
    "unused point.msh": (msh2([*POINTS, (9, 9, 9)]), HALVES),
    "missing node.msh": (msh2(cells=[TETS[0], (0, 2, 1, 7)]), "missing node.msh: "),
    "flat.msh": (msh2([*POINTS[:4], (0.3, 0.3, 0)]), "cells are degenerate"),
    "not finite.msh": (msh2([*POINTS[:4], (0, 0, "nan")]), "some coordinates are not finite"),
    "letters.msh": (msh2([*POINTS[:4], (0, 0, "x")]), "letters.msh: "),
    "folded.msh": (msh2([*POINTS[:4], (0, 0, 2)]), "cells are inverted"),
    "prism.msh": (
        msh2([*POINTS, (1, 1, 1)], [(0, 1, 2, 3, 4, 5)], (1,), kind=6),
        "1 of type 'Prism 6': a body needs one",
    ),
    "order 3.msh": (
        msh2([(i / 9, i % 4, 0) for i in range(10)], [tuple(range(10))], (1,), kind=21),
        "of type 'Triangle 10': a body needs one type",
    ),
    "cubic claim.msh": (msh2(kind=11), "cubic claim.msh: "),
    "kind unknown.msh": (msh2(kind=999), "kind unknown.msh: "),
    "lines only.msh": (msh2(cells=[(0, 1)], tags=(1,), kind=1), "no triangles, quadrilaterals"),
    "no cells.msh": (msh2(cells=[], tags=()), "no cells.msh: no triangles"),
    "no nodes.msh": (msh2(points=[]), "no nodes.msh: "),
    "cut in nodes.msh": (msh2()[:80], "cut in nodes.msh: "),
    "cut in elements.msh": (msh2()[:-40], "cut in elements.msh: "),
    "cut in an element.msh": (msh2()[:-20], "cut in an element.msh: "),
    "empty.msh": ("", "empty.msh: gmsh cannot read it"),
    "blank lines.msh": ("\n\n \n", "blank lines.msh: "),
    "binary rubbish.msh": (bytes(range(256)) * 8, "binary rubbish.msh: "),
    "head only.msh": ("$MeshFormat\n2.2 0 8\n$EndMeshFormat\n", "head only.msh: "),
    "version 9.msh": (msh2().replace("2.2 0 8", "9.9 0 8"), "version 9.msh: "),
    "carriage returns.msh": (msh2().replace("\n", "\r\n"), HALVES),
    "data.msh": (msh2(more=data2("E", {1: 1.5, 2: 2.5})), HALVES),
    "data of other elements.msh": (msh2(more=data2("E", {77: 1.5})), HALVES),
    "data cut.msh": (msh2(more=data2("E", {1: 1.5, 2: 2.5})[:-20]), "data cut.msh: "),
    "data twice.msh": (
        msh2(more=data2("E", {1: 1.0}) + data2("E", {2: 1.0}, "NodeData")),
        "data twice.msh: two sets of data are named 'E'",
    ),
    # .msh, version 4
    "groups.msh": (msh4("1 1|1 2"), HALVES),
    "overlap.msh": (
        msh4("2 1 2|1 2", '3 1 "one"\n3 2 "all"\n'),
        {"one": SIXTH, "all": 0.5},
    ),
    "without group.msh": (
        msh4("0|0"),
        'there are 2 entities: add Physical Volume("body") = {1, 2}',
    ),
    "one volume.msh": (msh4("0", entities=1), BOTH),
    "cut 4.msh": (msh4("1 1|1 2")[:-30], "cut 4.msh: "),
    "no entities.msh": (
        msh4("0", entities=1).replace("$Entities\n0 0 0 1\n1 0 0 -2 1 1 1 0 0\n$EndEntities\n", ""),
        BOTH,
    ),
    "names without entities.msh": (
        msh4("0", '3 1 "soft"\n', 1).replace(
            "$Entities\n0 0 0 1\n1 0 0 -2 1 1 1 0 0\n$EndEntities\n", ""
        ),
        "it names 'soft', and says of no cell",
    ),
    # .xdmf
    "plain.xdmf": (xdmf(), BOTH),
    "data first.xdmf": (xdmf(attribute("E", "1.5 2.5", kind="Float") + TAGS), HALVES),
    "whole data first.xdmf": (xdmf(attribute("E", "1000 2000", kind="Float") + TAGS), HALVES),
    "whole data.xdmf": (xdmf(attribute("E", "1000 2000", kind="Float")), BOTH),
    "vector.xdmf": (xdmf(FIBER), BOTH),
    "vector first.xdmf": (xdmf(FIBER + TAGS), HALVES),
    "whole vector.xdmf": (xdmf(FIBER.replace("Float", "Int")), BOTH),
    "tags as floats.xdmf": (xdmf(TAGS.replace("Int", "Float")), HALVES),
    "tags of another name.xdmf": (xdmf(attribute("f", "1 2")), HALVES),
    "two whole.xdmf": (xdmf(attribute("f", "1 2") + attribute("g", "3 4")), BOTH),
    "negative tags.xdmf": (xdmf(attribute("tags", "-1 0")), {"-1": SIXTH, "0": THIRD}),
    "utf8.xdmf": (xdmf(attribute("Härte", "1.5 2", kind="Float") + TAGS), HALVES),
    "nodal.xdmf": (xdmf(TAGS + attribute("T", "0 1 2 3 4", "5", "Float", "Node")), HALVES),
    "too few values.xdmf": (xdmf(attribute("E", "1.5", "1", "Float")), "'E' has 1 numbers for 2"),
    "other shape.xdmf": (xdmf(attribute("E", "1.5", "2", "Float")), "has 1 numbers and not 2"),
    "letters.xdmf": (xdmf(attribute("E", "a b", "2", "Float")), "other things than numbers"),
    "two alike.xdmf": (xdmf(FIBER + FIBER), "two of its attributes are named 'fiber'"),
    "no numbers.xdmf": (xdmf(attribute("E", "", "2", "Float")), "no plain numbers in a Attribute"),
    "missing node.xdmf": (xdmf(cells=[TETS[0], (0, 2, 1, 9)]), "has the node 9, of 5"),
    "negative node.xdmf": (xdmf(cells=[TETS[0], (0, 2, 1, -1)]), "negative node.xdmf: "),
    "twice.xdmf": (xdmf(cells=[TETS[0], TETS[0]]), "1 of 2 cells come twice"),
    "wedge.xdmf": (xdmf(cells=[(0, 1, 2, 3, 4, 0)], kind="Wedge"), "topology type 'wedge' is not"),
    "no type.xdmf": (xdmf(kind=""), "its topology type '' is not one of"),
    "mixed.xdmf": (
        mixed([4, 0, 1, 2, 6, *TETS[0], 6, *TETS[1], 4, 0, 1, 3], "7 1 2 8"),
        HALVES,
    ),
    "mixed with lines.xdmf": (mixed([2, 2, 0, 1, 6, *TETS[0], 6, *TETS[1]], "5 1 2"), HALVES),
    "mixed cut.xdmf": (mixed([6, *TETS[0], 6, 0, 2]), "ends within a tetrahedron"),
    "mixed unknown.xdmf": (mixed([6, *TETS[0], 77, 0]), "has a cell of type 77"),
    "mixed two types.xdmf": (mixed([6, *TETS[0], 8, 0, 1, 2, 3, 4, 0]), "has a cell of type 8"),
    "cut.xdmf": (xdmf()[:-30], "it is no whole XML"),
    "hdf missing.xdmf": (
        xdmf().replace('Format="XML">0', 'Format="HDF">gone.h5:/x', 1),
        "'gone.h5",
    ),
    "format unknown.xdmf": (xdmf().replace('"XML"', '"ABC"'), "the format 'abc' of a Geometry"),
    "html.xdmf": ("<html><body>404</body></html>", "html.xdmf: no grid with Topology"),
    "latin.xdmf": (xdmf(attribute("Härte", "1 2")).encode("latin-1"), "latin.xdmf: it is no whole"),
    "order 2 flat points.xdmf": (
        xdmf(cells=[tuple(range(10))], kind="Tetrahedron_10", points=len(TETRA10) * [(0, 0, 0)]),
        "1 of 1 cells are degenerate",
    ),
    "order 2.xdmf": (
        xdmf(cells=[(0, 1, 2, 3, 4, 5, 6, 7, 8, 9)], kind="Tet_10", points=TETRA10),
        {"body": SIXTH},
    ),
    # .inp
    "plain.inp": (INP, BOTH),
    "sets.inp": (
        f"{INP}*ELSET, ELSET=soft\n7\n*Elset, elset=hard\n9\n",
        {"soft": SIXTH, "hard": THIRD},
    ),
    "set in element.inp": (
        INP.replace("7, 10", "7, 10").replace("C3D4", "C3D4, ELSET=all") + "*ELSET,ELSET=one\n9,\n",
        {"all": 0.5, "one": THIRD},
    ),
    "second block has the set.inp": (
        INP.replace("9, 10", "*ELEMENT, TYPE=C3D4H, ELSET=hard\n9, 10"),
        {"body": SIXTH, "hard": THIRD},
    ),
    "one set of two blocks.inp": (
        INP.replace("C3D4", "C3D4, ELSET=e").replace(
            "9, 10", "*ELEMENT, TYPE=C3D4,\nELSET=E\n9, 10"
        ),
        {"e": 0.5},
    ),
    "generate.inp": (f"{INP}*ELSET, ELSET=odd, GENERATE\n7, 9, 2\n", {"odd": 0.5}),
    "set of sets.inp": (
        f"{INP}*ELSET, ELSET=a\n7\n*ELSET, ELSET=b\nA, 9\n",
        {"a": SIXTH, "b": 0.5},
    ),
    "unknown set.inp": (f"{INP}*ELSET, ELSET=b\nnone\n", "it refers to 'NONE', which is not in it"),
    "unknown element.inp": (f"{INP}*ELSET, ELSET=b\n8\n", "it refers to 8, which is not in it"),
    "unknown node.inp": (INP.replace("20, 50", "20, 60"), "it refers to 60"),
    "unknown type.inp": (INP.replace("C3D4", "C3D20"), "elements of the type 'C3D20'"),
    "two parts.inp": (f"*PART, NAME=a\n*END PART\n*PART, NAME=b\n{INP}", "it has several parts"),
    "cut.inp": (INP[:-5], "cut.inp: "),
    "letters.inp": (INP.replace("-2.", "two"), "letters.inp: could not convert"),
    "no elements.inp": (INP[:40], "no elements.inp: "),
    "empty.inp": ("", "it has no nodes or no elements"),
    "include.inp": ("*INCLUDE, INPUT=gone.inp\n", "it includes 'gone.inp', which is not beside"),
    # .vtk, .vtu
    "plain.vtk": (vtk(), BOTH),
    "tags.vtk": (
        vtk(more="CELL_DATA 2\nSCALARS materials int 1\nLOOKUP_TABLE default\n1\n2\n"),
        HALVES,
    ),
    "data.vtk": (vtk(more="CELL_DATA 2\nSCALARS E double 1\nLOOKUP_TABLE default\n1\n2\n"), BOTH),
    "wedge.vtk": (vtk([(0, 1, 2, 3, 4, 0)], 13), "cells of meshio's type wedge"),
    "unknown type.vtk": (vtk(kind=99), "unknown type.vtk: "),
    "points only.vtk": (vtk([(0,)], 1), "points only.vtk: "),
    "missing node.vtk": (vtk([TETS[0], (0, 2, 1, 9)]), "has the node 9, of 5"),
    "cut.vtk": (vtk()[:-25], "cut.vtk: "),
    "empty.vtk": ("", "empty.vtk: meshio cannot read it"),
    "not.vtk": ("hello\n", "not.vtk: meshio cannot read it"),
    "plain.vtu": (vtu(), BOTH),
    "tags.vtu": (
        vtu('<DataArray type="Int64" Name="regions" format="ascii">1 2</DataArray>'),
        HALVES,
    ),
    "unknown type.vtu": (vtu(kinds="10 99"), "unknown type.vtu: "),
    "cut.vtu": (vtu()[:-50], "cut.vtu: meshio cannot read it"),
    "connectivity.vtu": (vtu(connectivity="0 1 2 3 0 2 1"), "connectivity.vtu: "),
    "empty.vtu": ("", "empty.vtu: meshio cannot read it"),
    # .geo, CAD, .stl
    "plain.geo": (GEO_SQUARE, {"body": 1.0}),
    "two surfaces.geo": (
        GEO_SQUARE + "Plane Surface(9) = {1};\n",
        'there are 2 entities: add Physical Surface("body") = {7, 9}',
    ),
    "overlap.geo": (
        GEO_SQUARE + 'Physical Surface("a") = {7};\nPhysical Surface("b") = {7};\n',
        {"a": 1.0, "b": 1.0},
    ),
    "empty group.geo": (
        GEO_SQUARE + 'Physical Surface("a") = {7};\nPhysical Curve("hole") = {99};\n',
        {"a": 1.0},
    ),
    "syntax.geo": ("Point(1) = {0, 0, 0\n", "syntax.geo: gmsh cannot read it"),
    "empty.geo": ("", "empty.geo: gmsh cannot read it"),
    "rubbish.step": ("hello", "rubbish.step: gmsh cannot read it"),
    "rubbish.brep": ("hello", "rubbish.brep: "),
    "rubbish.igs": ("hello", "rubbish.igs: "),
    "empty.step": ("", "empty.step: "),
    "rubbish.stl": ("hello", "rubbish.stl: no triangles"),
    "cut.stl": ("solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\n", "cut.stl: "),
    # others
    "mesh.med": ("hello", "read knows the suffixes"),
    "no suffix": ("hello", "read knows the suffixes"),
}


def write(folder: Path) -> None:
    """Write all files."""
    for name, (content, _) in FILES.items():
        data = content if isinstance(content, bytes) else content.encode()
        (folder / name).write_bytes(data)


def outcomes(comm: MPI.Comm, folder: Path) -> dict[str, Outcome]:
    """Read all files: the error's sentence, or the volume of each region. Collective."""
    found: dict[str, Outcome] = {}
    for name in FILES:
        try:
            body = meshes.read(comm, folder / name)
        except (ValueError, ImportError, RuntimeError) as error:
            found[name] = f"{type(error).__name__}: {error}"
            continue
        # Of each cell, so that one form serves them all.
        v = ufl.TestFunction(fem.functionspace(body.mesh, ("DG", 0)))
        sizes = fem.assemble_vector(fem.form(v * ufl.dx)).array
        found[name] = {
            region: comm.allreduce(float(sizes[body.cells(region)].sum()))
            for region in body.regions
        }
    return found


if __name__ == "__main__":
    found = outcomes(MPI.COMM_WORLD, Path(sys.argv[1]))
    assert MPI.COMM_WORLD.allgather(found) == MPI.COMM_WORLD.size * [found]
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps(found))
