# SPDX-License-Identifier: MIT
"""Numbers read off a solution, files and pictures."""

import json
import os

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from cases import at_plane, unit_mesh

from variform import forms, meshes


@pytest.fixture
def sheared():
    """A unit cube after simple shear, solved; mesh, F, psi and the path."""
    mesh = unit_mesh(3, 2)
    u, t = forms.displacement(mesh, degree=2), forms.load_factor(mesh)
    F = forms.deformation_gradient(u)
    psi = forms.energies.neo_hookean(F, 1.0, 2.0)
    supports = [
        forms.clamp(u, at_plane(mesh, 2, 0.0)),
        forms.translate(u, at_plane(mesh, 2, 1.0), (0.4 * t, 0.0, 0.0)),
    ]
    top = at_plane(mesh, 2, 1.0)
    record = {"top": lambda s: forms.resultant(s, top), "J": lambda s: np.float64(1.0)}
    path = forms.follow(psi * ufl.dx, u, supports, t, step=0.5, record=record, progress=False)
    return mesh, F, psi, path


def test_resultants_of_both_ends_are_opposite(sheared):
    """Nothing else holds the body: the two ends' forces and moments cancel."""
    mesh, _, _, path = sheared
    force, moment = forms.resultant(path.problem, at_plane(mesh, 2, 1.0))
    opposite, counter = forms.resultant(path.problem, at_plane(mesh, 2, 0.0))
    assert force[0] > 0.1
    assert force == pytest.approx(-opposite, abs=1e-9)
    assert moment == pytest.approx(-counter, abs=1e-9)
    assert np.array(path.steps[-1].records["top"]) == pytest.approx(np.array([force, moment]))


def test_moment_moves_with_its_point(sheared):
    """M(c) = M(0) - c x force."""
    mesh, _, _, path = sheared
    force, moment = forms.resultant(path.problem, at_plane(mesh, 2, 1.0))
    with pytest.raises(ValueError, match=r"about is a point of 3 coordinates, got \(1, 2\)"):
        forms.resultant(path.problem, at_plane(mesh, 2, 1.0), about=(1, 2))
    _, moved = forms.resultant(path.problem, at_plane(mesh, 2, 1.0), about=(1, 2, 3))
    assert moved == pytest.approx(moment - np.cross([1, 2, 3], force), abs=1e-12)


REACTIONS = """
import json
from mpi4py import MPI
import numpy as np
import ufl
from dolfinx.mesh import locate_entities
from variform import forms, meshes

body = meshes.block(MPI.COMM_WORLD, (2.0, 1.0, 0.5), n=(4, 2, 1), cells="hexahedron")
w, t = forms.displacement_pressure(body), forms.load_factor(body)
u, p = ufl.split(w)
F = forms.deformation_gradient(u)
psi = forms.energies.with_pressure(forms.energies.neo_hookean(F, 10.0, 0.0), F, p, 20.0)
weight = forms.body_force(u, ufl.as_vector([0.0, -0.3 * t, 0.1 * t]))
ends = [(0, 0, 0), (0, 0, 0.25), (0, 0, 0.5)], [(1.5, 0, 0), (1.5, 0, 0.25), (1.5, 0, 0.5)]
left, right = forms.pin(w, ends[0]), forms.pin(w, ends[1], axes=(1,))
side = forms.pin(w, (1.5, 0, 0.25), axes=(2,))
path = forms.follow(psi * ufl.dx + weight, w, [left, right, side], t, step=1.0, progress=False)
edges = locate_entities(
    body.mesh, 1, lambda x: np.isclose(x[0], 1.5) & np.isclose(x[1], 0)
)
cells = np.arange(body.mesh.topology.index_map(3).size_local, dtype=np.int32)
f = forms.results.nodal_forces(path)
owned = f.x.array[: f.function_space.dofmap.index_map.size_local * 3].reshape(-1, 3)
X = ufl.SpatialCoordinate(body.mesh)
turning = ufl.cross(X + u, ufl.as_vector([0, -0.3, 0.1]))
arm = [forms.integral(turning[i] * ufl.dx) for i in range(3)]
found = {
    "left": forms.resultant(path, left),
    "points": forms.resultant(path, ends[0]),
    "one": forms.resultant(path, (0.0, 0, 0.25)),
    "pin": forms.resultant(path, forms.pin(w, (0, 0, 0.25))),
    "right": forms.resultant(path, right),
    "side": forms.resultant(path, side),
    "edges": forms.resultant(path, edges, dim=1),
    "both": forms.resultant(path, np.array(ends[1])),
    "all": forms.resultant(path, cells, dim=3),
    "nodes": [body.mesh.comm.allreduce(owned.sum(axis=0)), np.zeros(3)],
}
found = {key: [a.tolist() for a in value] for key, value in found.items()}
largest = np.sort(np.concatenate(body.mesh.comm.allgather(np.linalg.norm(owned, axis=1))))
found |= {"arm": arm, "largest": largest[-7:].tolist()}
if body.mesh.comm.rank == 0:
    print(json.dumps(found))
"""


@pytest.mark.parametrize("ranks", [1, 2, 3])
def test_reactions_at_pins_lines_and_points_balance_the_weight(parallel, ranks):
    """A heavy beam on two rows of pins, 3 nodes each: forces, and moments in the deformed state.

    The right one takes what turns about the left: sum x cross R = - int x cross b dV.
    """
    found = {k: np.array(v) for k, v in parallel(REACTIONS, ranks).items()}
    held = found["left"] + found["right"] + found["side"]
    assert held[0] == pytest.approx([0, 0.3, -0.1], abs=1e-9)  # the weight of 1 m^3
    assert held[1] == pytest.approx(-found["arm"], abs=1e-9)
    assert np.abs(found["right"][0]).max() > 0.15 and found["right"][0, 0] == 0
    for a, b in (
        ("left", "points"),
        ("one", "pin"),
        ("edges", "both"),
    ):
        assert found[a] == pytest.approx(found[b], abs=1e-12), (a, b)
    assert found["both"] == pytest.approx(found["right"] + found["side"], abs=1e-9)
    assert found["all"] == pytest.approx(held, abs=1e-9)
    assert found["nodes"][0] == pytest.approx(held[0], abs=1e-9)
    # Six nodes are held; all others are in balance.
    assert found["largest"][1] > 1e-3 and found["largest"][0] < 1e-9


def test_places_of_resultants_that_are_none(sheared):
    """One sentence each: an unknown for a path, points off the nodes, another's support."""
    mesh, _, _, path = sheared
    other = forms.displacement(mesh)
    for call, message in (
        (
            lambda: forms.resultant(path.u, at_plane(mesh, 2, 1.0)),
            "resultant needs a path or a problem, .* got Unknown displacement: pass",
        ),
        (
            lambda: forms.results.nodal_forces(3),
            "nodal_forces needs a path or a problem.* got int:",
        ),
        (lambda: forms.resultant(path, (0.1, 0.0, 0.0)), r"has a node, got \[0.1, 0.0, 0.0\]; the"),
        (lambda: forms.resultant(path, (0.1, 0.0)[:1]), r"a point of 3 finite coordinates, got"),
        (lambda: forms.resultant(path, forms.pin(other, (0, 0, 0))), "got one of another: make it"),
        (
            lambda: forms.resultant(path, np.array([10**6]), dim=1),
            "1 of 1 entities of dimension 1 are not of this unknown's mesh",
        ),
        (lambda: forms.resultant(path, np.array([0]), dim=4), "of dimension 0 to 3, got dim = 4"),
    ):
        with pytest.raises(ValueError, match=message):
            call()


def test_resultant_is_the_work_of_a_rigid_motion(sheared):
    """Force . e_x = int P : grad v dV for v = e_x on the top, 0 at the other nodes."""
    mesh, F, psi, path = sheared
    v = forms.displacement(mesh, degree=2)
    for part in forms.translate(v, at_plane(mesh, 2, 1.0), (1.0, 0.0, 0.0)).conditions:
        part.set(v.x.array)
    P = forms.stress.first_piola(psi, F)
    work = forms.integral(ufl.inner(P, ufl.grad(v)) * ufl.dx(degree=2))
    force, _ = forms.resultant(path.problem, at_plane(mesh, 2, 1.0))
    assert force[0] == pytest.approx(work, rel=1e-12)


def test_an_integral_of_nothing_is_zero():
    """A component of a cross product that vanishes as an expression, before any number is known."""
    mesh = unit_mesh(2, 2)
    X = ufl.SpatialCoordinate(mesh)
    upwards = ufl.as_vector([0.0, 0.0, 1.0])
    lever = ufl.cross(ufl.as_vector([X[0], X[1], 0.0]), upwards)
    found = [forms.integral(lever[i] * ufl.dx) for i in range(3)]
    assert found == pytest.approx([0.5, -0.5, 0.0], abs=1e-15) and found[2] == 0.0
    u, v = forms.displacement(mesh), forms.displacement(mesh)
    assert forms.integral(ufl.derivative(X[0] * ufl.dx, u, v)) == 0.0


def test_fields_and_points(sheared):
    """An affine field is interpolated exactly and read exactly at any point, also on corners."""
    mesh, _, _, _ = sheared
    x = ufl.SpatialCoordinate(mesh)
    f = forms.field(ufl.as_vector([x[0] + 2 * x[1], 3 * x[2]]), mesh)
    for point in ((0.3, 0.2, 0.9), (1, 1, 1), (0, 0.5, 0), (1 + 1e-12, 0.1, 0.1)):
        assert forms.at(f, point) == pytest.approx(
            [point[0] + 2 * point[1], 3 * point[2]], abs=1e-9
        )
    assert forms.at(forms.field(x[0] ** 2, mesh, degree=2), (0.3, 0.3, 0.3)) == pytest.approx(0.09)
    with pytest.raises(ValueError, match=r"\(1.5, 0.0, 0.0\) lies 0.5 outside the mesh"):
        forms.at(f, (1.5, 0, 0))


def test_fields_that_live_at_quadrature_points(tmp_path):
    """The stress of a condensed sheet is projected: exact where it is constant, P33 = 0."""
    mesh = unit_mesh(2, 2)
    u = forms.displacement(mesh, degree=2)
    u.interpolate(lambda x: (0.4 * x[0], 0.1 * x[1]))
    F = forms.plane_stress(u, lambda F: forms.energies.neo_hookean(F, 1.0, 2.0))
    psi = forms.energies.neo_hookean(F, 1.0, 2.0)
    forms.Problem(psi * ufl.dx, u).prepare()
    P = forms.stress.first_piola(psi, F)
    values = forms.at(forms.field(P, mesh), (0.3, 0.6)).reshape(3, 3)
    stretch = forms.at(forms.field(F[2, 2], mesh), (0.3, 0.6))[0]
    P11 = 1.4 - 1 / 1.4 + 2 * np.log(1.4 * 1.1 * stretch) / 1.4
    assert values[0, 0] == pytest.approx(P11, rel=1e-12)
    assert abs(values[2, 2]) < 1e-13
    forms.picture(u, tmp_path / "sheet.png", P[0, 0], "P11 [Pa]", limits=(0, 2), size=(300, 200))
    forms.VTX(tmp_path / "sheet.bp", u, P=P).write(0.0)


def test_wrong_arguments_are_refused(sheared):
    mesh, _, psi, path = sheared
    w = forms.displacement_pressure(mesh)
    for call, message in (
        (lambda: forms.at(w, (0, 0, 0)), r"pass displacement_of\(w\)"),
        (lambda: forms.at(psi, (0, 0, 0)), "needs the unknown itself.* got Sum"),
        (lambda: forms.at(path.u, (0, 0)), r"has 3 coordinates, got \(0, 0\)"),
        (lambda: forms.resultant(path, "top"), "local facet indices.* got str top"),
        (lambda: forms.integral(psi), "got Sum: integrate a density with dx"),
        (
            lambda: forms.solve(psi * ufl.dx, path.u, record={"a": 1.0}),
            "record needs functions of the problem, got float for 'a'",
        ),
        (lambda: forms.picture(mesh, "a.png"), "needs the unknown itself.* got Mesh"),
    ):
        with pytest.raises(ValueError, match=message):
            call()


def test_volumes():
    """U = (a x, b y, c z): volume and smallest J are (1 + a)(1 + b)(1 + c)."""
    mesh = unit_mesh(3, 2)
    u = forms.displacement(mesh)
    u.interpolate(lambda x: (0.5 * x[0], -0.2 * x[1], 0.1 * x[2]))
    F = forms.deformation_gradient(u)
    assert forms.volume(F, ufl.dx(mesh)) == pytest.approx(1.5 * 0.8 * 1.1)
    assert forms.smallest_volume_ratio(F, mesh) == pytest.approx(1.5 * 0.8 * 1.1)


def test_summary_is_json(sheared, tmp_path):
    """The summary holds outcome, steps with records, sizes and versions; the file equals it."""
    path = sheared[3]
    made = forms.summary(path, tmp_path / "deep" / "run.json", answer=np.arange(3))
    read = json.loads((tmp_path / "deep" / "run.json").read_text())
    assert read == made
    assert read["completed"] and len(read["steps"]) == 2
    assert read["steps"][-1]["load"] == 1.0 and read["answer"] == [0, 1, 2]
    assert np.shape(read["steps"][0]["records"]["top"]) == (2, 3)
    assert read["unknowns"] == 3 * 125 and read["cells"] == 48 and read["ranks"] == 1
    assert read["versions"]["dolfinx"]
    with pytest.raises(TypeError, match="got Mesh"):
        forms.summary(path, wrong=path.u.function_space.mesh)
    odd = forms.summary(path, inf=np.inf, nan={"a": [np.nan, 1.0]})
    assert odd["inf"] is None and odd["nan"] == {"a": [None, 1.0]}


@pytest.mark.parametrize("fields", [False, True])
def test_vtx_holds_the_steps(sheared, tmp_path, fields):
    """The .bp folder holds the displacement (and fields) of every step, as adios2 reads it back."""
    adios2 = pytest.importorskip("adios2")
    _, F, psi, path = sheared
    more = {"sigma": forms.stress.cauchy(psi, F)} if fields else {}
    writer = forms.VTX(tmp_path / "run.bp", path.u, **more)
    writer.write(0.0)
    writer(path)
    writer.close()
    with adios2.FileReader(str(tmp_path / "run.bp")) as file:
        names = file.available_variables()
        assert int(names["displacement"]["AvailableStepsCount"]) == 2
        assert ("sigma" in names) == fields
    with pytest.raises(ValueError, match=r"ends in .bp, got run.vtu"):
        forms.VTX(tmp_path / "run.vtu", path.u)


def colors(file):
    from matplotlib.image import imread

    return imread(file)[..., :3]


@pytest.mark.parametrize("dim", [2, 3])
def test_picture_shows_the_body(dim, tmp_path):
    """The picture has the asked size, a white rim (nothing cut off) and colors in the middle."""
    body = meshes.block(MPI.COMM_SELF, (1.0, 0.4, 0.4)[:dim], n=(4, 2, 2)[:dim])
    u = forms.displacement(body, degree=2)
    u.interpolate(lambda x: 0.2 * x[:dim])
    file = tmp_path / "new" / "body.png"
    forms.picture(u, file, title="block", label="|u| [m]", size=(600, 400))
    image = colors(file)
    assert image.shape == (400, 600, 3)
    rim = np.concatenate([image[0], image[-1], image[:, 0], image[:, -1]])
    assert np.all(rim == 1)
    colorful = np.ptp(image, axis=-1) > 0.2
    assert 0.05 < colorful.mean() < 0.9
    F = forms.deformation_gradient(u)
    forms.picture(u, file, ufl.det(F), "J", size=(600, 400), scale=2.0, reference=False)
    assert colors(file).shape == (400, 600, 3)
    with pytest.raises(ValueError, match=r"colored by a scalar, got shape \(3, 3\)"):
        forms.picture(u, file, F)
    with pytest.raises(ValueError, match=r"ends in .png, got body.jpg"):
        forms.picture(u, "body.jpg")


def test_no_display_is_one_sentence(monkeypatch, tmp_path):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.setenv("PATH", os.fspath(tmp_path))
    body = meshes.block(MPI.COMM_SELF, (1.0, 0.4), n=(4, 2))
    u = forms.displacement(body, degree=2)
    with pytest.raises(RuntimeError, match="needs a display or Xvfb, found neither: apt-get"):
        forms.picture(u, tmp_path / "a.png")
