# SPDX-License-Identifier: MIT
"""Checkpoints on 1, 2 and 3 ranks: of no partition; a path goes on; errors reach all."""

import json
from collections import ChainMap

import numpy as np
import pytest

FIELDS = """
import json, sys
from mpi4py import MPI
import basix.ufl, numpy as np
from dolfinx import fem, mesh
from variform import forms, meshes
from variform.forms.files.checkpoint import Archive

folder, what = sys.argv[1:]
comm = MPI.COMM_WORLD
bodies = {
    "gmsh": meshes.block(comm, (1.0, 0.3, 0.3), h=0.15).mesh,
    "square": mesh.create_unit_square(comm, 5, 4),
    "cube": mesh.create_unit_cube(comm, 3, 2, 2),
    "hexahedra": mesh.create_unit_cube(comm, 3, 2, 2, mesh.CellType.hexahedron),
    "surface": meshes.spherical_sheet(comm, 1.0, 0.4, 2, "octant").mesh,
}
off = {}
for name, body in bodies.items():
    cell, d = body.basix_cell(), body.geometry.dim
    vectors = [basix.ufl.element("P", cell, k, shape=(d,)) for k in (1, 2, 3)]
    mixed = basix.ufl.mixed_element([vectors[1], basix.ufl.element("P", cell, 1)])
    for degree, element in zip((1, 2, 3, "mixed"), (*vectors, mixed)):
        u = fem.Function(fem.functionspace(body, element))
        field = lambda x: np.array([np.sin(5 * x[0] + x[1]), x[1] ** 3 - x[2], x[2] * x[0]])[:d]
        for part in [u.sub(0), u.sub(1)] if degree == "mixed" else [u]:
            scalar = not part.function_space.num_sub_spaces
            part.interpolate((lambda x: 2 + field(x)[0]) if scalar else field)
        u.x.scatter_forward()
        wanted = u.x.array.copy()
        archive = Archive(forms.Checkpoint(f"{folder}/{name}{degree}"), u, "field")
        if what != "1":
            u.x.array[:] = 0
            found, other = archive.read().states
            assert not u.x.array.any()
            errors = np.abs(found - wanted).max(), np.abs(other - 2 * wanted).max()
            off[f"{name} {degree}"] = comm.allreduce(max(errors), MPI.MAX)
        outcome = forms.paths.Convergence(True, "", 2, 1, 0, 1, 0.0, 0.0, 0.0, ())
        step = forms.paths.Step(0.5, outcome, {})
        archive.write([wanted, 2 * wanted], [step] * int(what), {}, now=True)
if comm.rank == 0:
    print(json.dumps(off))
"""


def test_checkpoints_are_of_no_partition(parallel, tmp_path):
    """Written on 1, 2, 3 ranks and read on 2, 3, 1: each value is back at its point.

    P1, P2, P3, P2-P1 on tetrahedra, triangles, hexahedra and a surface in space.
    """
    for turn, ranks in enumerate((1, 2, 3, 1)):
        off = parallel(FIELDS, ranks, tmp_path / "run", turn + 1)
        assert len(off) == (20 if turn else 0)
        assert max(off.values(), default=0) < 1e-13, off


PATHS = """
import json, sys
from mpi4py import MPI
import scenes, ufl
from variform import forms

comm = MPI.COMM_WORLD


class Stopped(Exception):
    pass


def follow(scene, folder, stop, rtol):
    numbers = {"twist": (0.2, 1.5), "mixed": (4, 6.0)}[scene]
    _, t, u, _, potential, supports, held, points = getattr(scenes, scene)(comm, *numbers)

    def on_step(path):
        if path.load > stop:
            raise Stopped

    path = forms.follow(potential, u, supports, t, step=0.1, max_step=0.1, on_step=on_step,
                        checkpoint=forms.Checkpoint(folder),
                        record={"load": lambda s: float(t.value)}, rtol=rtol, progress=False)
    moved = forms.displacement_of(u)
    force, moment = forms.resultant(path.problem, held)
    numbers = {
        "displacement": [forms.at(moved, point).tolist() for point in points],
        "force": force.tolist(), "moment": moment.tolist(),
        "square": forms.integral(ufl.inner(u, u) * ufl.dx),
    }
    return {"numbers": numbers, "resumed": path.resumed, "loads": path.record("load").tolist()}


found = {}
for scene, folder, stop, rtol in json.loads(sys.argv[1]):
    try:
        found[folder] = follow(scene, folder, stop, rtol)
    except Stopped:
        found[folder] = "broken off"
    except Exception as error:  # the others go on
        found[folder] = f"{type(error).__name__}: {error}"
if comm.rank == 0:
    print(json.dumps(found))
"""
PATHS_ON_RANKS = {
    "twist": ("twist", (1, 2, 3), 1e-12, 1e-8),
    "mixed": ("mixed", (3, 2, 1), 1e-12, 1e-8),
    "twist on 2": ("twist", (2, 2, 2), 1e-8, 1e-10),
}


@pytest.fixture(scope="module")
def followed(run, tmp_path_factory):
    """All paths without a break, and broken off twice: one run for each number of ranks in turn."""
    folder = tmp_path_factory.mktemp("paths")
    (folder / "script.py").write_text(PATHS)
    found = []
    for turn, stop in enumerate((0.25, 0.55, 2.0)):
        jobs = {}
        for name, (scene, ranks, rtol, _) in PATHS_ON_RANKS.items():
            jobs.setdefault(ranks[turn], []).append((scene, f"{name}, broken off", stop, rtol))
            if turn == 0:
                jobs[ranks[0]].append((scene, f"{name}, plain", 2.0, rtol))
        done = [
            run("script.py", json.dumps(paths), ranks=ranks, cwd=folder)
            for ranks, paths in jobs.items()
        ]
        answers = [json.loads(one.stdout.strip().splitlines()[-1]) for one in done]
        found.append((dict(ChainMap(*answers)), "".join(one.stderr for one in done)))
    return found


@pytest.mark.parametrize("name", PATHS_ON_RANKS)
def test_a_path_goes_on_on_ranks(name, followed):
    """Broken off twice, it ends where it ends without a break, on these or other ranks."""
    allowed = PATHS_ON_RANKS[name][-1]
    broken = f"{name}, broken off"
    wanted = followed[0][0][f"{name}, plain"]
    for turn, (answers, errors) in enumerate(followed[:2]):
        assert answers[broken] == "broken off"
        assert errors.count(f"Resumed at load factor 0.2 from {broken}") == turn
    found = followed[2][0][broken]
    assert found["resumed"] == pytest.approx(0.5) and wanted["resumed"] is None
    assert found["loads"] == wanted["loads"]
    for key, values in wanted["numbers"].items():
        off = np.abs(np.subtract(found["numbers"][key], values)).max()
        assert off < allowed * np.abs(values).max(), key


FAILURES = """
import pathlib, resource, sys, warnings
from mpi4py import MPI
import ufl
from variform import forms, meshes

comm = MPI.COMM_WORLD

def attempt(what):
    mesh = meshes.block(comm, (1.0, 1.0), n=(3 if what == "mesh" else 4, 4))
    u, t = forms.displacement(mesh), forms.load_factor(mesh)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 5.0) * ufl.dx
    supports = [forms.clamp(u, mesh.facets("left")),
                forms.translate(u, mesh.facets("right"), (0.0, 0.3 * t))]
    record = {"x": lambda system: {comm.rank}} if what == "record" else None
    folder = "/proc/none" if what == "folder" else "run"
    checkpoint = forms.Checkpoint(folder, resume=what not in ("record", "full", "shown"))
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    warnings.simplefilter("default" if what == "shown" else "error")
    if what in ("full", "shown") and comm.rank == 0:
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limits[1]))
    try:
        forms.follow(psi, u, supports, t, max_step=0.2, record=record, progress=False,
                     checkpoint=checkpoint)
    except (Exception, Warning) as error:
        return f"{what}: {type(error).__name__} {error}\\n"
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    return f"{what}: no error\\n"

said = [attempt(what) for what in ("write", "mesh", "record", "full", "shown", "folder")]
comm.barrier()
if comm.rank == 0:
    for file in pathlib.Path("run").iterdir():
        file.write_bytes(b"PK")
comm.barrier()
said.append(attempt("broken"))
sys.stdout.write("".join(said))  # one write, so that ranks do not mix
"""


def test_errors_reach_all_ranks(run, tmp_path):
    """Each of two ranks raises the same sentence; none waits for another."""
    (tmp_path / "script.py").write_text(FAILURES)
    done = run("script.py", ranks=2, cwd=tmp_path)
    for sentence in (
        "write: no error",
        "mesh: ValueError run/checkpoint-000006.npz is of another mesh, 32 cells and 25 nodes, ",
        "record: ValueError a checkpoint keeps records of numbers",
        "full: UserWarning no checkpoint of step 1 was written in run ([Errno 27]",
        "shown: no error",
        "folder: OSError checkpoints cannot be written in /proc/none",
        "broken: ValueError run/checkpoint-000006.npz is broken (",
    ):
        assert done.stdout.count(sentence) == 2, done.stdout
    assert done.stderr.count("UserWarning: no checkpoint of step 1 was written in run (") == 2
