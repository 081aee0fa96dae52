# SPDX-License-Identifier: MIT
"""1, 2 and 3 ranks give the same numbers, and no rank hangs."""

import json

import numpy as np
import pytest

SCENES = """
import json
from mpi4py import MPI
import numpy as np, scenes, ufl
from variform import forms, meshes

comm = MPI.COMM_WORLD
neo_hookean = forms.energies.neo_hookean


def solved(scene, tight):
    "Numbers of a scene; its points are where the displacement is read."
    tolerance = {"rtol": 1e-12, "ctol": 1e-10} if tight else {}
    virtual_work = None
    if scene == "twist":
        body, t, u, F, potential, supports, held, points = scenes.twist(comm, h=0.12, turn=0.8)
    elif scene == "mixed":
        body, t, u, F, potential, supports, held, points = scenes.mixed(comm, n=6, force=3.0)
    elif scene == "follower":
        body = meshes.block(comm, (4.0, 1.0, 1.0), n=(8, 2, 2), cells="hexahedron")
        t, u = forms.load_factor(body), forms.displacement(body)
        F = forms.deformation_gradient(u)
        potential = neo_hookean(F, 1.0, 2.0) * ufl.dx
        virtual_work = forms.follower_pressure(
            u, 0.01 * t, ufl.TestFunction(u.function_space), body.ds("top"))
        supports = [forms.clamp(u, body.facets("left"))]
        held, points = body.facets("left"), [(4.0, 1.0, 1.0), (2.1, 0.3, 0.7)]
    elif scene == "sheet":
        body = meshes.block(comm, (2.0, 1.0), h=0.25)
        t, u = forms.load_factor(body), forms.displacement(body, degree=2)
        psi = lambda F: neo_hookean(F, 1.0, 2.0)
        F = forms.plane_stress(u, psi)
        potential = psi(F) * ufl.dx
        supports = [forms.clamp(u, body.facets("left")),
                    forms.translate(u, body.facets("right"), (0.6 * t, 0.0))]
        held, points = body.facets("right"), [(1.0, 1.0), (1.3, 0.2)]
    elif scene == "operator":
        body = meshes.block(comm, (2.0, 0.4, 0.4), h=0.2)
        t, u = forms.load_factor(body), forms.displacement(body)
        F, X = forms.deformation_gradient(u), ufl.SpatialCoordinate(body.mesh)
        stretch = 1 / (1 - 0.8 * t * (X[2] - 0.2))
        A = ufl.as_matrix([[stretch, 0, 0], [0, 1, 0], [0, 0, 1]])
        psi = forms.energies.activated(F, A, 1.0) + forms.energies.fixed_corotated(F, 0.1, 1.0)
        soft = forms.energies.as_rigid_as_possible(F, 0.05)
        potential = psi * ufl.dx + soft * body.ds("right")
        virtual_work = forms.follower_pressure(
            u, 0.01 * t, ufl.TestFunction(u.function_space), body.ds("top"))
        supports = [forms.clamp(u, body.facets("left"))]
        held, points = body.facets("left"), [(2.0, 0.4, 0.4), (1.1, 0.1, 0.3)]
    elif scene == "membrane":
        body = meshes.spherical_sheet(comm, 1.0, 0.4, 2, "octant")
        t, u = forms.load_factor(body), forms.displacement(body, degree=2)
        F = forms.membrane_gradient(u)
        side = forms.membranes.orientation(body)
        psi = forms.energies.principal(lambda s1, s2: (s1**2 + s2**2 + (s1 * s2)**-2 - 3) / 2)(F)
        potential = psi * ufl.dx - 1.1 * t * forms.enclosed_volume(u, side)
        supports = [forms.roller(u, body.facets(f"{a}0"), k) for k, a in enumerate("xyz")]
        held, points = body.facets("x0"), []
    elif scene == "scrambled":
        body = meshes.block(comm, (1.0, 1.0, 1.0), n=(4, 4, 4))
        t, u = forms.load_factor(body), forms.displacement(body)
        F = forms.deformation_gradient(u)
        potential = forms.energies.fixed_corotated(F, 1.0, 10.0) * ufl.dx
        supports = [forms.clamp(u, body.facets(name)) for name in body.boundaries if name != "top"]
        supports.append(forms.translate(u, body.facets("top"), (0.2, 0, 0.3)))
        x = u.function_space.tabulate_dof_coordinates()
        throw = np.random.default_rng(1).uniform(-0.4, 0.4, (5, 5, 5, 3))
        grid = np.round(4 * x).astype(int)
        inside = ((grid > 0) & (grid < 4)).all(axis=1)
        thrown = throw[grid[:, 0], grid[:, 1], grid[:, 2]]
        u.x.array[:] = np.where(inside[:, None], thrown, 0).ravel()
        held, points = body.facets("top"), [(0.5, 0.5, 0.75), (0.3, 0.3, 0.3)]
    if scene == "scrambled":
        path = forms.solve(potential, u, supports, projection="always", **tolerance)
    else:
        path = forms.follow(potential, u, supports, t, step=0.5, virtual_work=virtual_work,
                            progress=False, **tolerance)
    moved = forms.displacement_of(u)
    force, moment = forms.resultant(path.problem, held)
    return {
        "displacement": [forms.at(moved, point).tolist() for point in points]
        or [forms.integral(ufl.inner(u, u) * ufl.dx)],
        "force": force.tolist(), "moment": moment.tolist(),
        "volume": forms.integral(forms.enclosed_volume(u, side)) if scene == "membrane"
        else forms.volume(F, ufl.dx(body.mesh)),
        "J": 1.0 if scene in ("sheet", "membrane") else forms.smallest_volume_ratio(F, body.mesh),
        "iterations": [s.convergence.iterations for s in path.steps],
    }


found = {}
for scene in ["twist", "mixed", "follower", "sheet", "operator", "membrane", "scrambled"]:
    for tolerance in ["tight", "default"]:
        try:
            found[f"{scene}, {tolerance}"] = solved(scene, tolerance == "tight")
        except Exception as error:  # the others go on
            found[f"{scene}, {tolerance}"] = {"error": f"{type(error).__name__}: {error}"}
if comm.rank == 0:
    print(json.dumps(found))
"""


@pytest.fixture(scope="module")
def solved(parallel_once):
    """All scenes on 1, 2 and 3 ranks, in one run each."""
    return [parallel_once(SCENES, ranks) for ranks in (1, 2, 3)]


@pytest.mark.parametrize("tolerance", ["tight", "default"])
@pytest.mark.parametrize(
    "scene", ["twist", "mixed", "follower", "sheet", "operator", "membrane", "scrambled"]
)
def test_ranks_give_the_same_numbers(scene, tolerance, solved):
    """Solved to 1e-12, 1, 2 and 3 ranks agree to 1e-10; at the defaults to ten times 1e-6."""
    allowed = 1e-10 if tolerance == "tight" else 1e-5
    one, *others = (found[f"{scene}, {tolerance}"] for found in solved)
    for other in (one, *others):
        assert "error" not in other, other["error"]
    for other in others:
        for name in ("displacement", "force", "moment", "volume", "J"):
            size = np.abs(one[name]).max()
            assert np.abs(np.subtract(other[name], one[name])).max() < allowed * size, name


FILES = """
import json
from mpi4py import MPI
import ufl
from variform import forms, meshes

comm = MPI.COMM_WORLD
body = meshes.block(comm, (1.0, 0.3, 0.3), h=0.15)
t, u = forms.load_factor(body), forms.displacement(body, degree=2)
F = forms.deformation_gradient(u)
psi = forms.energies.neo_hookean(F, 1.0, 5.0)
supports = [forms.clamp(u, body.facets("left")),
            forms.rotate(u, body.facets("right"), t, axis=(1, 0, 0))]
vtx = forms.VTX("run.bp", u, sigma=forms.stress.cauchy(psi, F))
path = forms.follow(psi * ufl.dx, u, supports, t, step=0.5, on_step=vtx)
vtx.close()
forms.picture(path, "run.png", ufl.det(F), "J", size=(600, 400))
forms.summary(path, "run.json")
if comm.rank == 0:
    print(json.dumps(path.completed))
"""


def test_files_and_pictures_of_two_ranks(parallel, tmp_path):
    """Rank 0 writes one picture and one summary, equal to those of one rank to the eye."""
    from matplotlib.image import imread

    pictures = []
    for ranks in (1, 2):
        assert parallel(FILES, ranks)
        pictures.append(imread(tmp_path / "run.png")[..., :3])
        assert json.loads((tmp_path / "run.json").read_text())["ranks"] == ranks
    different = np.abs(pictures[0] - pictures[1]).max(axis=-1) > 0.1
    assert different.mean() < 0.01


FAILURES = """
import sys
from mpi4py import MPI
import ufl
from variform import forms, meshes

comm = MPI.COMM_WORLD
body = meshes.block(comm, (1.0, 0.3), h=0.15)
u, t = forms.displacement(body), forms.load_factor(body)
psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 5.0)
supports = [forms.clamp(u, body.facets("left")),
            forms.translate(u, body.facets("right"), (-3.0 * t, 0.0))]


def fail(what):
    if what == "folder":
        forms.summary(forms.solve(psi * ufl.dx, u, supports), "/proc/none/run.json")
    elif what == "vtx":
        forms.VTX("/proc/none/run.bp", u)
    elif what == "point":
        forms.at(u, (2.0, 0.0))
    elif what == "empty":
        forms.clamp(u, body.facets("left")[:0])
    elif what == "name":
        body.facets("lfet")
    elif what == "diverges":
        forms.follow(psi * ufl.dx, u, supports, t, min_step=0.05, progress=False,
                     options={"snes_max_it": 2})


said = []
for what in sys.argv[1].split(","):
    u.x.array[:], t.value = 0, 0
    try:
        fail(what)
    except Exception as error:
        said.append(f"{what}: {type(error).__name__} {error}\\n")
    else:
        said.append(f"{what}: no error\\n")
sys.stdout.write("".join(said))  # one write, so that ranks do not mix
"""
ERRORS = {
    "folder": "FileNotFoundError",
    "vtx": "FileNotFoundError",
    "point": "ValueError the point (2.0, 0.0) lies 1 outside the mesh",
    "empty": "ValueError a support needs facets, got none on any rank",
    "name": 'ValueError no boundary named "lfet"',
    "diverges": "NotConverged SNES stopped after",
}


@pytest.fixture(scope="module")
def said(run, tmp_path_factory):
    """What two ranks print whose calls fail, one after the other."""
    folder = tmp_path_factory.mktemp("failing")
    (folder / "failing.py").write_text(FAILURES)
    return run("failing.py", ",".join(ERRORS), ranks=2, cwd=folder)


@pytest.mark.parametrize("what", ERRORS)
def test_errors_reach_all_ranks_at_once(what, said):
    """Each rank raises the same error; none waits for another."""
    assert said.stdout.count(f"{what}: {ERRORS[what]}") == 2, said.stdout + said.stderr


def test_command_line_wins(run, tmp_path):
    """-variform_snes_max_it on the command line goes over the options of the script."""
    file = tmp_path / "one.py"
    text = FAILURES.replace("(-3.0 * t, 0.0)", "(0.3, 0.4)")
    text = text.replace('"/proc/none/run.json"', '"run.json"')
    file.write_text(text.replace("supports),", 'supports, options={"snes_max_it": 30}),'))
    assert "no error" in run(file, "folder", cwd=tmp_path).stdout
    stopped = run(file, "folder", "-variform_snes_max_it", "1", cwd=tmp_path).stdout
    assert "stopped after 1 iterations (the iterations were used up)" in stopped


ALONE = """
import sys
from mpi4py import MPI
from variform import forms
comm = MPI.COMM_WORLD
if comm.rank == comm.size - 1 or sys.argv[1] == "all":
    raise ValueError("the mesh is too coarse")
comm.barrier()
print("went on")
"""


@pytest.mark.parametrize("who", ["one", "all"])
@pytest.mark.parametrize("ranks", [2, 3])
def test_an_exception_of_one_rank_ends_all(who, ranks, run, tmp_path):
    """With the message; where all raise, nobody has to be killed."""
    file = tmp_path / "script.py"
    file.write_text(ALONE)
    done = run(file, who, ranks=ranks, cwd=tmp_path, check=False)
    assert done.returncode != 0
    assert "went on" not in done.stdout
    count = ranks if who == "all" else 1
    assert done.stderr.count("ValueError: the mesh is too coarse") == count
    assert f"rank {ranks - 1} of {ranks} ended" in done.stderr
    assert ("MPI_ABORT was invoked" in done.stderr) == (who == "one")
