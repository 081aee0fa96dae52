# SPDX-License-Identifier: MIT
"""Kills cold runs while they compile: does the next run succeed, and at once?

Each cold run has an empty cache of compiled code and is killed, with all that it has started, at a
random moment between its first file there and its end; the next run uses what it has left. Then
two cold runs at a time share a cache. Run ``docker/enter python3 -m demos.benchmarks.kills``; one
JSON line per row, and ``results/kills.csv``; ``--small`` kills 2 runs instead of 20 on each number
of ranks.
"""

import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from .record import Table

ROOT = Path(__file__).resolve().parents[2]
KILLS, PAIRS = 20, 3
RANKS = (1, 2)
HANGS = 900  # s, against hangs only
SCENE = """
from mpi4py import MPI
import ufl
from dolfinx import mesh
from variform import forms
body = mesh.create_unit_cube(MPI.COMM_WORLD, 2, 2, 2)
u = forms.displacement(body)
F = forms.deformation_gradient(u)
problem = forms.Problem(forms.energies.hencky(F, 1.0, 2.0) * ufl.dx, u)
problem.residual(problem.create_vector())
problem.tangent(problem.create_matrix())
forms.field(forms.stress.cauchy(forms.energies.neo_hookean(F, 1.0, 2.0), F), body)
assert problem.energy() == 0
"""


def start(script, cache, ranks=1, **variables):
    """A process in a session of its own, with its own cache of compiled code."""
    words = [sys.executable, "-c", script]
    words = ["mpirun", "-n", str(ranks), *words] if ranks > 1 else words
    variables |= {"PYTHONPATH": str(ROOT), "XDG_CACHE_HOME": str(cache)}
    return subprocess.Popen(
        words,
        env={**os.environ, **variables},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def kill(process):
    """Kill a process and all of its session: ranks have process groups of their own."""
    for entry in Path("/proc").glob("[0-9]*/stat"):
        try:
            session = int(entry.read_text().rpartition(")")[2].split()[3])
            if session == process.pid:
                os.kill(int(entry.parent.name), signal.SIGKILL)
        except OSError:  # it has ended meanwhile
            continue
    process.kill()
    process.communicate()


def begun(process, cache):
    """Wait for the first file in a cache; False if the process ends before."""
    while not list((cache / "fenics").glob("*")):
        if process.poll() is not None:
            return False
        time.sleep(0.002)
    return True


def ended(process):
    """Wait for a process: its last words if it failed, or nothing."""
    try:
        _, said = process.communicate(timeout=HANGS)
    except subprocess.TimeoutExpired:
        kill(process)
        return f"did not end within {HANGS} s"
    return (said.strip().splitlines() or ["failed"])[-1] if process.returncode else ""


def timed(cache, ranks):
    """Seconds of a run, those of them before its first file, and its last words if it failed."""
    begin = time.perf_counter()
    process = start(SCENE, cache, ranks)
    begun(process, cache)
    first = time.perf_counter() - begin
    said = ended(process)
    return time.perf_counter() - begin, first, said


def unfinished(cache):
    """Pieces that a killed run has left: locks, and files not yet marked as whole."""
    names = {path.name for path in cache.glob("fenics/**/*")}
    return sorted(
        name
        for name in names
        if name.endswith(".lock") or (name.endswith(".c") and name + ".cached" not in names)
    )


def killed(ranks, draw, longest):
    """A row: one cold run killed, and the next run; nothing if it ended before it was killed."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        cache = Path(folder)
        process = start(SCENE, cache, ranks)
        begun(process, cache)
        moment = draw.uniform(0, longest)
        time.sleep(moment)
        early = process.poll() is None
        kill(process)
        if not early:
            return None
        left = unfinished(cache)
        seconds, _, said = timed(cache, ranks)
        return {
            "ranks": ranks,
            "killed after [s]": round(moment, 2),
            "unfinished": len(left),
            "next run": said or "succeeds",
            "seconds": round(seconds, 2),
            "unfinished then": len(unfinished(cache)),
        }


def pair(ranks):
    """A row: two cold runs at a time."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        begin = time.perf_counter()
        both = [start(SCENE, Path(folder), ranks) for _ in range(2)]
        said = [ended(process) for process in both]
        seconds = time.perf_counter() - begin
        outcome = "; ".join(filter(None, said)) or "both succeed"
        return {"ranks": ranks, "two at a time": outcome, "seconds": round(seconds, 2)}


def main(small=False):
    """Run and print; returns the rows."""
    table, draw = Table("kills"), random.Random(1)
    for ranks in RANKS:
        with tempfile.TemporaryDirectory() as folder:
            seconds, first, said = timed(Path(folder), ranks)
            warm, _, again = timed(Path(folder), ranks)
        cold = {"ranks": ranks, "cold [s]": round(seconds, 2), "warm [s]": round(warm, 2)}
        table.add(**cold, outcome=said or again or "succeeds")
        wanted = 2 if small else KILLS
        while wanted:
            if row := killed(ranks, draw, seconds - first):
                table.add(**row)
                wanted -= 1
        for _ in range(1 if small else PAIRS):
            table.add(**pair(ranks))
    table.write()
    return table.rows


if __name__ == "__main__":
    main(small="--small" in sys.argv)
