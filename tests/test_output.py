# SPDX-License-Identifier: MIT
"""Files for other programs: VTU, OBJ, PLY and CSV, read back by PyVista, meshio and NumPy."""

from mpi4py import MPI

import meshio
import numpy as np
import pytest
import pyvista
import ufl
from cases import off
from dolfinx.mesh import CellType, create_unit_cube, create_unit_square

from variform import forms, meshes
from variform.forms.files import VTU, Surfaces, table

CELLS = {
    "triangle": lambda: create_unit_square(MPI.COMM_SELF, 2, 3),
    "quadrilateral": lambda: create_unit_square(MPI.COMM_SELF, 2, 3, CellType.quadrilateral),
    "tetrahedron": lambda: create_unit_cube(MPI.COMM_SELF, 2, 2, 2),
    "hexahedron": lambda: create_unit_cube(MPI.COMM_SELF, 2, 2, 2, CellType.hexahedron),
}


def polynomial(x, k):
    """A displacement of degree k, three components."""
    return np.array([x[0] ** k - x[1], x[0] * x[1] ** (k - 1), x[2] ** k + x[0]])


@pytest.mark.parametrize("cells", CELLS)
@pytest.mark.parametrize("degree", [1, 2, 3])
def test_vtu_is_read_by_pyvista_and_meshio(cells, degree, tmp_path):
    """Values at nodes, and between them: VTK interpolates with the order of nodes in the file."""
    mesh = CELLS[cells]()
    dim = mesh.geometry.dim
    u = forms.displacement(mesh, degree)
    u.interpolate(lambda x: polynomial(x, degree)[:dim])
    writer = VTU(tmp_path / "new" / "run.pvd", u)
    writer.write(0.5)
    u.x.array[:] *= 2
    writer.write(1.0)
    reader = pyvista.get_reader(str(tmp_path / "new" / "run.pvd"))
    assert reader.time_values == [0.5, 1.0]
    reader.set_active_time_point(1)
    grid = reader.read()[0]
    assert grid.n_cells == mesh.topology.index_map(mesh.topology.dim).size_global
    assert grid.n_points == u.function_space.dofmap.index_map.size_global
    wanted = 2 * polynomial(grid.points.T, degree)
    wanted[dim:] = 0
    assert np.abs(grid["displacement"].T - wanted).max() < 1e-13
    points = np.zeros((20, 3))
    points[:, :dim] = np.random.default_rng(1).uniform(0.05, 0.95, (20, dim))
    sampled = pyvista.PolyData(points).sample(grid)
    assert np.all(sampled["vtkValidPointMask"] == 1)
    wanted = 2 * polynomial(points.T, degree)
    wanted[dim:] = 0
    # VTK finds a point in a cell to 1e-5; another order of nodes is wrong by 1e-2.
    assert np.abs(sampled["displacement"].T - wanted).max() < 1e-4
    if degree == 3 and cells == "hexahedron":  # meshio does not know the version of these
        return
    read = meshio.read(tmp_path / "new" / "run_0001.vtu")
    assert off(read.point_data["displacement"], grid["displacement"]) < 1e-15
    assert sum(len(block.data) for block in read.cells) == grid.n_cells
    if degree == 2:
        names = {"triangle": "triangle6", "quadrilateral": "quad9"}
        names |= {"tetrahedron": "tetra10", "hexahedron": "hexahedron27"}
        assert read.cells[0].type == names[cells]


def test_fields_of_a_vtu(tmp_path):
    """Scalars, vectors and tensors of a plane body, 1, 3 and 9 components, cell by cell."""
    mesh = CELLS["triangle"]()
    u = forms.displacement(mesh, 2)
    u.interpolate(lambda x: polynomial(x, 2)[:2])
    F = forms.deformation_gradient(u)
    fields = {"J": ufl.det(F), "F": F, "H": ufl.grad(u), "<v>": 3 * u}
    VTU(tmp_path / "run.pvd", u, **fields).write(0.0)
    grid = pyvista.read(tmp_path / "run_0000.vtu")
    assert grid.n_points == 6 * grid.n_cells
    x, y, _ = grid.points.T
    H = np.zeros((len(x), 3, 3))
    H[:, 0, 0], H[:, 0, 1], H[:, 1, 0], H[:, 1, 1] = 2 * x, -1, y, x
    assert off(grid["H"], H.reshape(-1, 9)) < 1e-13
    assert off(grid["F"], (H + np.eye(3)).reshape(-1, 9)) < 1e-13
    assert off(grid["J"], np.linalg.det(H + np.eye(3))) < 1e-13
    assert off(grid["<v>"], 3 * grid["displacement"]) < 1e-13


@pytest.mark.parametrize("cells", CELLS)
@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("kind", ["obj", "ply"])
def test_surfaces_enclose_the_body(cells, degree, kind, tmp_path):
    """Of an affine motion: closed, normals outward, volume det F and area of each side, exact."""
    mesh = CELLS[cells]()
    dim = mesh.geometry.dim
    A = np.array([[0.5, 0.2, 0.0], [0.0, -0.3, 0.1], [0.3, 0.0, 0.2]])[:dim, :dim]
    u = forms.displacement(mesh, degree)
    u.interpolate(lambda x: A @ x[:dim])
    writer = Surfaces(tmp_path / f"run.{kind}", u)
    writer.write()
    u.x.array[:] = 0
    writer.write()
    surface = pyvista.read(tmp_path / f"run_0000.{kind}")
    F = np.eye(dim) + A
    facets = {"triangle": 12, "quadrilateral": 6, "tetrahedron": 48, "hexahedron": 24}[cells]
    assert surface.n_cells == facets * degree**2 * (1 if "t" == cells[0] else 2)
    if dim == 3:
        assert surface.is_manifold
        normals = surface.compute_normals(cell_normals=True, auto_orient_normals=False)
        volume = surface.volume
        centers = surface.cell_centers().points
        flux = np.einsum("ij,ij->i", centers, normals.cell_data["Normals"])
        sizes = surface.compute_cell_sizes()["Area"]
        assert flux @ sizes / 3 == pytest.approx(np.linalg.det(F), rel=1e-5)
        assert volume == pytest.approx(np.linalg.det(F), rel=1e-5)
    else:
        assert surface.area == pytest.approx(np.linalg.det(F), rel=1e-6)
    read = meshio.read(tmp_path / f"run_0001.{kind}")
    assert abs(read.points.min()) < 1e-15 and read.points.max() == pytest.approx(1)
    assert np.concatenate([b.data for b in read.cells]).shape == (surface.n_cells, 3)


WRITTEN = """
import json
from mpi4py import MPI
import numpy as np
import ufl
from variform import forms, meshes
from variform.forms.files import VTU, Surfaces, table

body = meshes.block(MPI.COMM_WORLD, (1.0, 1.0, 1.0), n=2)
u, t = forms.displacement(body, 2), forms.load_factor(body)
F = forms.deformation_gradient(u)
psi = forms.energies.neo_hookean(F, 1.0, 2.0)
held = [forms.clamp(u, body.facets("bottom")), forms.translate(u, body.facets("top"), (t, 0, 0))]
writers = VTU("plain.pvd", u), VTU("J.pvd", u, J=ufl.det(F)), Surfaces("s.ply", u)
def write(path):
    for writer in writers:
        writer(path)
path = forms.follow(
    psi * ufl.dx, u, held, t, to=0.2, step=0.1, on_step=write, progress=False,
    record={"top": lambda p: forms.resultant(p, body.facets("top")),
            "bounds": forms.validity.volume_bounds, "say": lambda p: "fine"},
)
rows = table(path, "deep/run.csv")
account = table(path.ledger, "deep/ledger.csv")
V = forms.integral(ufl.det(F) * ufl.dx)
if body.mesh.comm.rank == 0:
    print(json.dumps([len(path.steps), V, rows]))
"""


def test_files_are_the_same_on_any_number_of_ranks(parallel, tmp_path):
    """Points with their values, cells, the volume inside the surface, and the tables."""
    found = []
    for ranks in (1, 2, 3):
        steps, volume, rows = parallel(WRITTEN, ranks)
        last = f"{steps - 1:04}"
        plain = pyvista.read(tmp_path / f"plain_{last}.vtu")
        J = pyvista.read(tmp_path / f"J_{last}.vtu")
        surface = pyvista.read(tmp_path / f"s_{last}.ply")
        order = np.lexsort(np.round(plain.points, 6).T)
        found.append((plain.n_cells, plain.points[order], plain["displacement"][order]))
        assert J.n_points == 10 * J.n_cells and J.n_cells == plain.n_cells
        found[-1] += (np.sort(J["J"]), surface.area, surface.n_points)
        # A surface of flat pieces: the body's volume to the order of the square of their size.
        assert surface.volume == pytest.approx(volume, rel=2e-3)
        read = np.genfromtxt(
            tmp_path / "deep" / "run.csv", delimiter=",", names=True, dtype=None, encoding=None
        )
        assert len(read) == steps
        assert {"load", "iterations", "top_0_0", "top_1_2", "bounds_lower"} <= set(read.dtype.names)
        for name in ("load", "top_0_0", "bounds_lower"):
            assert read[name].tolist() == [row[name] for row in rows]
        assert read["say"].tolist() == ["fine"] * steps and read["load"][-1] == 0.2
        account = np.genfromtxt(tmp_path / "deep" / "ledger.csv", delimiter=",", names=True)
        assert "stored" in account.dtype.names and len(account) >= steps
        found[-1] += (read["top_0_0"],)
    for other in found[1:]:
        for a, b in zip(other, found[0], strict=True):
            assert np.allclose(a, b, rtol=1e-7, atol=1e-9)


def test_names_of_files_are_checked(tmp_path):
    """One sentence each."""
    u = forms.displacement(CELLS["triangle"]())
    for call, sentence in (
        (lambda: VTU("run.vtu", u), "a name that ends in .pvd, got run.vtu."),
        (lambda: VTU("run.pvd", u, displacement=2 * u), "give the field another name"),
        (lambda: Surfaces("run.stl", u), "a name that ends in .obj or .ply, got run.stl."),
        (lambda: table([], "run.txt"), "a name that ends in .csv, got run.txt."),
        (lambda: table([1.0]), "rows that are mappings or named tuples, got a float."),
    ):
        with pytest.raises(ValueError, match=sentence):
            call()
    (tmp_path / "taken").write_text("")
    with pytest.raises(OSError, match="taken"):
        VTU(tmp_path / "taken" / "run.pvd", u).write(0.0)


def test_vtx_has_its_nodes_where_paraview_takes_them_to_be(tmp_path):
    """Of degree 3 at thirds of an edge, and not at Gauss and Lobatto's points."""
    adios2 = pytest.importorskip("adios2")
    u = forms.displacement(CELLS["triangle"](), 3)
    u.interpolate(lambda x: polynomial(x, 3)[:2])
    writer = forms.VTX(tmp_path / "run.bp", u)
    writer.write(0.0)
    writer.close()
    with adios2.FileReader(str(tmp_path / "run.bp")) as file:
        x, v = file.read("geometry"), file.read("displacement")
    assert np.abs(x[:, 0] * 6 - np.rint(x[:, 0] * 6)).max() < 1e-12  # two cells along x
    assert np.abs(v[:, :2].T - polynomial(x.T, 3)[:2]).max() < 1e-13


def test_a_sheet_in_space_is_written(tmp_path):
    """A surface mesh: its cells are the surface, displaced out of its plane."""
    body = meshes.square(MPI.COMM_SELF, 1.0, 0.25)
    u = forms.displacement(body, 2)
    u.interpolate(lambda x: (0 * x[0], 0 * x[0], 1 + 0 * x[0]))
    Surfaces(tmp_path / "sheet.obj", u, scale=2.0).write()
    VTU(tmp_path / "sheet.pvd", u).write(0.0)
    surface = pyvista.read(tmp_path / "sheet_0000.obj")
    assert surface.area == pytest.approx(1, rel=1e-6)
    assert np.abs(surface.points[:, 2] - 2).max() < 1e-6
    assert pyvista.read(tmp_path / "sheet_0000.vtu").area == pytest.approx(1, rel=1e-6)
