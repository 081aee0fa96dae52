# SPDX-License-Identifier: MIT
"""Kills leave a whole checkpoint: at each moment of writing, and at random ones."""

import os
import re
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from conftest import LIMIT

MOMENTS = """
import io, json, os, signal, sys, warnings
from mpi4py import MPI
import numpy as np
from variform import forms, meshes
import variform.forms.files.checkpoint

warnings.simplefilter("error")  # none is broken
checkpoint = sys.modules["variform.forms.files.checkpoint"]
die = lambda: os.kill(os.getpid(), signal.SIGKILL)
u = forms.displacement(meshes.block(MPI.COMM_SELF, (1.0, 1.0), n=(40, 40)))
size = len(u.x.array)
step = forms.paths.Step(0.5, forms.paths.Convergence(True, "", 2, 1, 0, 1, 0.0, 0.0, 0.0, ()), {})

def write(archive, number):
    archive.write(2 * [np.full(size, 1.0 * number)], number * [step], {"number": number})

class Half(io.FileIO):
    def write(self, data):
        super().write(data[: len(data) // 2])
        die()

def opened(file, mode, *rest):
    return Half(file, mode) if "w" in mode else open(file, mode, *rest)

def after(action):
    def both(*arguments, **named):
        action(*arguments, **named)
        die()
    return both

path = type(checkpoint.FilePath())
faults = {
    "half": (checkpoint, "open", opened),
    "written": (os, "fsync", lambda number: die()),
    "synced": (os, "fsync", after(os.fsync)),
    "named": (os, "replace", after(os.replace)),
    "removing": (path, "unlink", lambda *arguments, **named: die()),
    "removed": (path, "unlink", after(path.unlink)),
}
found = {}
for name, (where, what, fault) in faults.items():
    archive = checkpoint.Archive(forms.Checkpoint(name), u, "path")
    for number in (1, 2, 3):
        write(archive, number)
    child = os.fork()
    if child == 0:
        setattr(where, what, fault)
        write(archive, 4)
        os._exit(0)
    killed = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL
    again = checkpoint.Archive(forms.Checkpoint(name), u, "path")
    saved = again.read()
    number = saved.control["number"]
    same = all(np.all(state == number) for state in saved.states)
    write(again, 5)
    files = sorted(file for file in os.listdir(name))
    found[name] = [killed, number, len(saved.steps), same, len(files)]
print(json.dumps(found))
"""


def test_a_kill_at_each_moment_of_writing_leaves_a_whole_checkpoint(parallel):
    """The old one while the file is written, the new one once it has its name."""
    found = parallel(MOMENTS, 1)
    for name in ("half", "written", "synced"):
        assert found[name] == [True, 3, 3, True, 2], name
    for name in ("named", "removing", "removed"):
        assert found[name] == [True, 4, 4, True, 2], name


KILLED = """
import sys
from mpi4py import MPI
import os
import numpy as np, ufl
from variform import forms, meshes

folder, to = sys.argv[1], float(sys.argv[2])
comm = MPI.COMM_WORLD
body = meshes.block(comm, (1.0, 0.3), n=(30, 9))
t, u = forms.load_factor(body), forms.displacement(body, degree=2)
psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 5.0) * ufl.dx
supports = [forms.clamp(u, body.facets("left")),
            forms.translate(u, body.facets("right"), (0.2 * t, 0.3 * t))]
pids = comm.gather(os.getpid())

def on_step(path):
    if pids and (path.resumed is None or path.load > path.resumed):
        # In one piece: a kill between two writes would leave half a line.
        print(" ".join(map(str, [*pids, path.load])), flush=True)

checkpoint = None if folder == "none" else forms.Checkpoint(folder)
path = forms.follow(psi, u, supports, t, to=to, step=1e-4, min_step=1e-6, max_step=1e-4,
                    on_step=on_step, checkpoint=checkpoint, rtol=1e-10, progress=False)
square = forms.integral(ufl.inner(u, u) * ufl.dx)
total = u.x.petsc_vec.sum()
if comm.rank == 0:
    print(repr(square), path.load, len(path.steps), repr(total))
"""


def kill_after(delay, ranks, folder, root):
    """Start a run, kill all its ranks some seconds after its first step; last load, errors."""
    words = [sys.executable, "killed.py", "run", "1.0"]
    process = subprocess.Popen(
        ["mpirun", "-n", str(ranks), *words] if ranks > 1 else words,
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(root)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    *pids, load = process.stdout.readline().split() or [0]
    time.sleep(delay)
    for pid in map(int, pids):  # ranks have process groups of their own
        os.kill(pid, signal.SIGKILL)
    os.killpg(process.pid, signal.SIGKILL)
    out, errors = process.communicate(timeout=LIMIT)
    assert pids, errors
    return float([load, *(line.split()[-1] for line in out.splitlines())][-1]), errors


@pytest.mark.slow
@pytest.mark.parametrize(("ranks", "kills"), [(1, 20), (2, 5)])
def test_kills_at_random_moments(ranks, kills, run, root, tmp_path, rng):
    """After each kill -9 the next run resumes at the last step or, killed in writing, before it."""
    (tmp_path / "killed.py").write_text(KILLED)
    reached = resumed = 0.0
    for kill in range(kills):
        load, errors = kill_after(rng.uniform(0, 0.5), ranks, tmp_path, root)
        assert ("Resumed" in errors) == (kill > 0) and "broken" not in errors, errors
        if kill:
            resumed = float(re.search(r"Resumed at load factor (\S+) from run", errors)[1])
            assert reached - 1.01e-4 < resumed < reached + 1e-9
        # Resumed before it and killed after one step, a run is where the last one was.
        assert load > resumed + 0.9e-4
        reached = load
    to = reached + 1e-3
    found, wanted = (
        run("killed.py", folder, to, ranks=ranks, cwd=tmp_path).stdout.splitlines()[-1]
        for folder in ("run", "none")
    )
    if ranks == 1:
        assert found == wanted
    assert np.array(found.split(), float) == pytest.approx(np.array(wanted.split(), float), 1e-10)
