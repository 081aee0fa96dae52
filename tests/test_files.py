# SPDX-License-Identifier: MIT
"""Files in: regions, boundaries and data of odd files and of arrays; data on n ranks."""

from pathlib import Path

import gmsh
import mesh_texts
import numpy as np
import odd_files
import pytest
from bodies import COMM, area, box, integral, volumes
from conftest import printed
from mesh_texts import POINTS, TAGS, TETS, attribute, data2, msh2, xdmf

from variform import meshes
from variform.meshes import _grid

ROOT = Path(__file__).parent.parent
HALVES = {"1": 1 / 6, "2": 1 / 3}


def halves(body: meshes.Body) -> None:
    assert volumes(body) == pytest.approx(HALVES, rel=1e-12)


# Odd files


def test_odd_files(run, tmp_path, monkeypatch) -> None:
    """Each odd file is read right, or refused in one sentence with its name; 2 ranks as 1."""
    assert len(odd_files.FILES) >= 60
    odd_files.write(tmp_path)
    # Waiting ranks let the others work: rank 0 reads alone.
    monkeypatch.setenv("OMPI_MCA_mpi_yield_when_idle", "1")
    program = ROOT / "tests" / "odd_files.py"
    results = [printed(run(program, tmp_path, ranks=ranks)) for ranks in (1, 2)]
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
    grid = mesh_texts.grid(TAGS + attribute("A", tensor, "2 9", "Float"))
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


# Ranks

PROGRAM = """
import json, sys
from mpi4py import MPI
import numpy as np
from dolfinx import fem
from variform import meshes
from variform.meshes import _grid

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


def test_data_of_n_ranks_are_those_of_one(session, run, tmp_path) -> None:
    """Integrals of data, over regions that overlap too, are the same on 1, 2 and 3 ranks.

    The coordinates as data of points are the coordinates.
    """
    (tmp_path / "program.py").write_text(PROGRAM)
    box(0.6)
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
    command = "-m", "mpi4py", tmp_path / "program.py", tmp_path
    results = [printed(run(*command, ranks=ranks)) for ranks in (1, 2, 3)]
    for result in results[1:]:
        for name, facts in result.items():
            assert facts == pytest.approx(results[0][name], rel=1e-11), name


@pytest.mark.parametrize("suffix", ["msh", "xdmf"])
def test_the_benchmark_of_reading(run, tmp_path, suffix) -> None:
    """At toy size the benchmark's box has all its cells, read by us on two ranks and by DOLFINx."""
    reading = "-m", "demos.benchmarks.reading"
    file = tmp_path / f"box.{suffix}"
    run(*reading, "make", tmp_path, "4")
    ours = printed(run(*reading, file, "ours", ranks=2))
    dolfinx = printed(run(*reading, file, "dolfinx"))
    assert ours["cells"] == dolfinx["cells"] == 6 * 4**3
    assert ours["ranks"] == len(ours["peak"]) == 2


@pytest.mark.slow
def test_rank_0_holds_little_more_than_the_others(run, tmp_path) -> None:
    """Of a million tetrahedra on two ranks: at most 100 bytes a cell above the ranks' mean.

    And of an .xdmf at most 1.5 times what DOLFINx's own reader takes, which reads in shares.
    """
    reading = "-m", "demos.benchmarks.reading"
    run(*reading, "make", tmp_path, "54")
    peaks = {}
    for suffix in "msh", "xdmf":
        line = printed(run(*reading, tmp_path / f"box.{suffix}", "ours", ranks=2))
        peaks[suffix] = line["peak"]
        assert line["cells"] == 6 * 54**3
        assert line["peak"][0] - np.mean(line["peak"]) <= 100e-6 * line["cells"], line
    theirs = printed(run(*reading, tmp_path / "box.xdmf", "dolfinx", ranks=2))["peak"]
    assert max(peaks["xdmf"]) <= 1.5 * max(theirs)


def test_checks_in_batches_are_those_of_the_whole(monkeypatch) -> None:
    """However many facets are sorted at once: the same boundaries, and the same refusals."""
    monkeypatch.setattr(_grid, "BATCH", 1 << 18)
    whole = verdicts()
    for batch in 1, 7:
        monkeypatch.setattr(_grid, "BATCH", batch)
        assert verdicts() == whole
    assert [found[: len(start)] for found, start in zip(whole[2:], REFUSED, strict=True)] == REFUSED


REFUSED = ["from_arrays: 1 facets belong to three", "from_arrays: 2 of 2 cells are inverted"]
REFUSED += ["from_arrays: 1 of 1 facets of 'side' are no facets"]


def verdicts() -> list[object]:
    """Areas of a cube's faces, named by hand; its surface; and what is said of three bad bodies."""
    grid = np.stack(np.meshgrid(*3 * [np.arange(4)], indexing="ij"), axis=-1).reshape(-1, 3)
    number = {tuple(point): k for k, point in enumerate(grid)}
    around = [(0, 0), (1, 0), (1, 1), (0, 1)]
    corners = [(*c, z) for z in (0, 1) for c in around]
    low = [point for point in grid if point.max() < 3]
    cells = [[number[tuple(point + c)] for c in corners] for point in low]
    floor = [row[:4] for row, p in zip(cells, low, strict=True) if not p[2]]
    top = [row[4:] for row, p in zip(cells, low, strict=True) if p[2] == 2]
    sides = {"floor": floor, "top": top[:2]}
    body = meshes.from_arrays(COMM, grid, cells, cell="hexahedron", boundaries=sides)
    found: list[object] = [{name: round(area(body, name), 12) for name in sides}]
    found.append(len(body.facets()))
    ends = [*np.eye(3), np.zeros(3), -np.ones(3), (1, 1, 1), (0, 0, -0.5)]
    for rows, named in (
        ([[0, 1, 2, 3], [0, 1, 2, 4], [0, 1, 2, 5]], {}),
        ([[0, 1, 2, 4], [0, 1, 2, 3]], {}),
        ([[0, 1, 2, 3]], {"side": [[0, 1, 4]]}),
    ):
        with pytest.raises(ValueError) as told:
            meshes.from_arrays(COMM, ends, rows, boundaries=named)
        found.append(str(told.value))
    return found
