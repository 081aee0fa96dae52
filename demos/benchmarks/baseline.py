# SPDX-License-Identifier: MIT
"""What every path of the demos and benchmarks did, as a file that a change is held against.

Each call of ``forms.solve``, ``follow``, ``control`` and ``arc_length`` in the demos, the cases of
demos/validation but Land's, and the twenty hard cases: load factors, Newton and linear iterations,
negative eigenvalues, refused steps, energy and largest displacement at the end. Of the Newton
atlas, a coarse one: the iterations of variform's ways. A change of the solver's code that keeps its
rules gives the same counts, and the same numbers to 1e-7; one that changes the rules says which.

``docker/enter python3 -m demos.benchmarks.baseline`` compares with baseline.json and ends with 1
where something differs; names of scenes (twist, hard:arch, …) choose some; ``--write`` writes the
file; ``--small`` takes the quickest. One process only; pictures and files are left out.
"""

import contextlib
import io
import json
import os
import runpy
import sys
import tempfile
import time
from pathlib import Path

from mpi4py import MPI

import numpy as np

from demos.validation.cases import CASES as VALIDATION
from variform import forms

from . import hard_cases, newton_atlas
from .record import machine

FILE = Path(__file__).resolve().parent / "baseline.json"
CALLS = ("solve", "follow", "control", "arc_length")
DEMOS = ("twist", "bar", "cook", "muscle", "reese", "scramble", "torsion", "snap", "balloon")
DEMOS += ("airbag", "sheet_or_solid", "import_cad")
SMALL = ("scramble", "hard:disk", "hard:confined")
CLOSE = 1e-7  # of the numbers, relative: two builds of one code differ by 1e-10


def numbers(path):
    """What one path did."""
    runs = [step.convergence for step in path.steps]
    problem = path.problem
    return {
        "loads": [float(f"{step.load:.10g}") for step in path.steps],
        "iterations": [run.iterations for run in runs],
        "linear": [run.linear_iterations for run in runs],
        "negative": [run.negative for run in runs],
        "refused": path.refused,
        "completed": path.completed,
        "energy": problem.energy(),
        "largest": float(np.abs(path.u.x.array).max(initial=0.0)),
    }


@contextlib.contextmanager
def recorded(found, pictures=False):
    """Note down every path that a call of the public functions returns, or raises."""
    kept = {name: getattr(forms, name) for name in (*CALLS, "picture")}

    def noting(call):
        def noted(*arguments, **options):
            try:
                path = call(*arguments, **options)
            except forms.NotConverged as error:
                found.append(numbers(error.path))
                raise
            found.append(numbers(path))
            return path

        return noted

    for name in CALLS:
        setattr(forms, name, noting(kept[name]))
    if not pictures:
        forms.picture = lambda *arguments, **options: None
    try:
        yield
    finally:
        for name, call in kept.items():
            setattr(forms, name, call)


def demo(name):
    """Paths of a demo, its own checks included; its charts are drawn all the same."""
    found = []
    with recorded(found):
        runpy.run_module(f"demos.{name}", run_name="__main__")
    return found


def hard(name):
    """Paths of one hard case from all its starts, whether they end well or not."""
    found, case = [], hard_cases.CASES[name]()
    with recorded(found):
        for start in case.starts:
            case.begin(start)
            with contextlib.suppress(forms.NotConverged):
                case.call()
    return found


def validation(name):
    """Paths of a case of the validation gallery."""
    found = []
    with recorded(found, pictures=True):
        Path("results").mkdir()
        VALIDATION[name].run(Path("results"), MPI.COMM_SELF)
    return found


def atlas():
    """Iterations of variform's ways to solve in the coarse Newton atlas, by start."""
    rows = []
    for energy in newton_atlas.ENERGIES:
        rows += newton_atlas.measured(
            energy, 2, newton_atlas.ANGLES[1:5:3], newton_atlas.THROWS[::5]
        )
    keys = ("energy", "method", "angle", "throw")
    return [
        {**{key: row[key] for key in keys}, "iterations": row["iterations"], "why": row["failure"]}
        for row in rows
        if row["method"].startswith("variform")
    ]


SCENES = {name: lambda name=name: demo(name) for name in DEMOS}
SCENES |= {f"hard:{name}": lambda name=name: hard(name) for name in hard_cases.CASES}
SCENES |= {
    f"validation:{name}": lambda name=name: validation(name)
    for name in VALIDATION
    if not name.startswith("land")
}
SCENES["newton_atlas"] = atlas


def differences(found, kept):
    """Sentences on what differs between two lists of rows."""
    if len(found) != len(kept):
        return [f"{len(found)} paths for {len(kept)}"]
    said = []
    for number, (new, old) in enumerate(zip(found, kept, strict=True)):
        for key in old:
            a, b = new[key], old[key]
            floats = isinstance(b, float) or key == "loads"
            same = a == b
            if floats and np.shape(a) == np.shape(b):
                scale = np.abs(b).max(initial=1e-12) if key == "loads" else max(abs(b), 1e-12)
                same = bool(np.all(np.abs(np.subtract(a, b)) <= CLOSE * scale))
            if not same:
                said.append(f"path {number}, {key}: {a} for {b}")
    return said


def main(names, write=False):
    """Run the scenes, compare or write; whether all is as it was."""
    kept = json.loads(FILE.read_text()) if FILE.exists() else {"scenes": {}}
    scenes, wrong, home = dict(kept["scenes"]), 0, Path.cwd()
    for name in names:
        start = time.process_time()
        with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
            os.chdir(folder)
            try:
                found = SCENES[name]()
            finally:
                os.chdir(home)
        found = json.loads(json.dumps(found))
        said = [] if write else differences(found, kept["scenes"].get(name, []))
        wrong += bool(said)
        count = sum(sum(np.atleast_1d(row["iterations"])) for row in found)
        seconds = time.process_time() - start
        print(f"{name}: {len(found)} paths, {count} iterations, {seconds:.1f} s", flush=True)
        for sentence in said:
            print(f"    {sentence}", flush=True)
        scenes[name] = found
        if write:
            FILE.write_text(json.dumps({"machine": machine(), "scenes": scenes}, indent=1) + "\n")
    return wrong == 0


if __name__ == "__main__":
    words = [word for word in sys.argv[1:] if not word.startswith("--")]
    if unknown := sorted(set(words) - set(SCENES)):
        sys.exit(f"no scene {', '.join(unknown)}: there are {', '.join(SCENES)}.")
    chosen = words or (SMALL if "--small" in sys.argv else list(SCENES))
    given, sys.argv = sys.argv[1:], sys.argv[:1]  # demos read the rest
    sys.exit(0 if main(chosen, write="--write" in given) else 1)
