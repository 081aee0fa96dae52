# SPDX-License-Identifier: MIT
"""Does ``forms.follow`` end at the state that the load path leads to?

Each scene of fidelity_scenes.py is followed by variform with its defaults, and by DOLFINx's
``NewtonSolver`` and PETSc's SNES (line search bt) in ten equal steps, all with the same mesh, the
same compiled residual and tangent, and the same loads; by FElupe's Newton with its own elements
where it is installed and the scene can be written in it (fidelity_felupe.py). What is right was
found by plain Newton over many small steps and over twice as many (small_steps.py), and is kept, in
figures, in fidelity.json.

``docker/enter python3 -m demos.benchmarks.fidelity`` prints one JSON line per scene and solver and
writes ``results/fidelity.csv``; parts of scenes' names after it choose some ("twist 360" P1),
``--small`` the cheap ones; ``--write`` puts the table into README.md; ``--references`` finds the
references of the chosen scenes anew and writes fidelity.json. Each scene has a process of its own.
"""

import json
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from pathlib import Path

from petsc4py import PETSc

import numpy as np
from dolfinx.fem import petsc as fem_petsc
from dolfinx.nls.petsc import NewtonSolver

from variform import forms

from . import fidelity_felupe, small_steps
from .fidelity_scenes import NAMES, build
from .record import Table, insert, markdown

FILE = Path(__file__).resolve().parent / "fidelity.json"
RIGHT = 1e-4  # of the largest displacement
STOPS = 0.02  # of the way, within which a stop is where small steps stop
STEPS = 10  # equal ones, of DOLFINx and SNES
SMALL = ("bar, twist 180, fixed_corotated 1.5, P1", "tube, pull", "ball, blow 1300", "strip, tip")
VERDICTS = ("right", "noted", "wrong", "stopped", "failed")
LIMIT = 60  # s of a scene's process, all solvers and compiling


def verdict(scene, reference, load, noted=(), resolution=STOPS):
    """What a run is worth, and how far its end is from the reference's, over the largest |u|.

    Args:
        scene: Scene whose unknown holds the end.
        reference: Its figures.
        load: Load factor reached.
        noted: Events that the solver spoke of.
        resolution: Part of the way between its stop and that of small steps that is none.
    """
    away = abs(load - reference["load"]) / abs(scene.to - scene.begin)
    if load != scene.to:  # it says so
        return ("stopped" if reference["reached"] or away > resolution else "right"), None
    if not reference["reached"]:
        return ("noted" if noted else "wrong"), None
    found = small_steps.off(small_steps.figures(scene), reference)
    if found <= RIGHT:
        return "right", found
    return ("noted" if noted else "wrong"), found


@contextmanager
def counted(owner, name):
    """Count the calls of a method that assembles tangents, those of refused steps included."""
    method, calls = getattr(owner, name), []

    def noted(*arguments, **options):
        calls.append(name)
        return method(*arguments, **options)

    setattr(owner, name, noted)
    try:
        yield calls
    finally:
        setattr(owner, name, method)


def by_variform(scene, reference):
    """``forms.follow`` with its defaults, after a start of its twin compiled all there is."""
    options, twin = {"settings": scene.settings, "progress": False}, build(scene.name)
    twin.reset()
    with suppress(forms.NotConverged):  # the run itself will say so
        forms.follow(twin.problem, t=twin.t, to=twin.begin + 1e-3 * twin.to, **options)
    scene.reset()
    start = time.process_time()
    with counted(forms.Problem, "tangent") as tangents:
        try:
            path = forms.follow(scene.problem, t=scene.t, to=scene.to, **options)
        except forms.NotConverged as error:
            path = error.path
    seconds = time.process_time() - start
    events = [event.sentence() for event in path.events]
    said, away = verdict(scene, reference, path.load, events)
    work = sum(abs(row.loads) + abs(row.supports) for row in path.ledger)
    unaccounted = sum(abs(row.unaccounted) for row in path.ledger)
    return {
        "verdict": said,
        "off": away,
        "load": path.load,
        "tangents": len(tangents),
        "seconds": seconds,
        "steps": len(path.steps),
        "refused": path.refused,
        "unaccounted": unaccounted / work if work else None,
        "events": events,
        "reason": path.reason,
    }


def old_problem(scene):
    """The scene as DOLFINx's problem, for its Newton solver."""
    system = scene.problem
    # 0.10 gave the old problem a longer name.
    old = getattr(fem_petsc, "NewtonSolverNonlinearProblem", fem_petsc.NonlinearProblem)
    return old(system.forms.residual_form, scene.u, system.conditions, system.forms.tangent_form)


def by_newton_solver(scene, reference):
    """DOLFINx's ``NewtonSolver`` with its defaults and MUMPS."""
    problem = old_problem(scene)
    with counted(problem, "J") as tangents:
        solver = NewtonSolver(scene.problem.comm, problem)
        _use_mumps(solver.krylov_solver)
        row = equal_steps(scene, reference, lambda: solver.solve(scene.u))
    return {**row, "tangents": len(tangents)}


def by_snes(scene, reference):
    """PETSc's SNES with the line search bt, its tolerances and MUMPS."""
    problem, u = old_problem(scene), scene.u
    A, b = fem_petsc.create_matrix(problem.a), fem_petsc.create_vector(problem.L)
    snes, x = PETSc.SNES().create(scene.problem.comm), b.duplicate()

    def put(z):
        z.copy(u.x.petsc_vec)
        u.x.scatter_forward()

    def residual(snes, z, f):
        put(z)
        problem.F(z, f)

    def tangent(snes, z, J, P):
        put(z)
        problem.J(z, P)

    snes.setFunction(residual, b)
    snes.setJacobian(tangent, A)
    snes.setTolerances(max_it=50)
    snes.setType("newtonls")  # with bt, where no option says otherwise
    _use_mumps(snes.getKSP())

    def solve():
        u.x.petsc_vec.copy(x)
        snes.solve(None, x)
        put(x)
        if snes.getConvergedReason() <= 0:
            raise RuntimeError(f"SNES: reason {snes.getConvergedReason()}")

    with counted(problem, "J") as tangents:
        row = equal_steps(scene, reference, solve)
    for each in (snes, A, b, x):
        each.destroy()
    return {**row, "tangents": len(tangents)}


def _use_mumps(ksp):
    ksp.setType("preonly")
    ksp.getPC().setType("lu")
    ksp.getPC().setFactorSolverType("mumps")


def equal_steps(scene, reference, solve):
    """Ten equal steps, or as many as converge."""
    scene.reset()
    load, start, reason = scene.begin, time.process_time(), ""
    for step in range(1, STEPS + 1):
        ahead = scene.begin + (scene.to - scene.begin) * step / STEPS
        scene.go(scene.to if step == STEPS else ahead)
        try:
            solve()
        except (RuntimeError, PETSc.Error) as error:
            reason = " ".join(str(error).split())
            break
        load = float(scene.t.value)
    seconds = time.process_time() - start
    said, away = verdict(scene, reference, load, resolution=1 / STEPS + STOPS)
    return {"verdict": said, "off": away, "load": load, "seconds": seconds, "reason": reason}


def by_felupe(scene, reference):
    """FElupe's ``newtonraphson`` with its defaults."""
    row = fidelity_felupe.run(scene, STEPS)
    load = float(scene.t.value)
    said, away = verdict(scene, reference, load, resolution=1 / STEPS + STOPS)
    known = {key: row[key] for key in ("tangents", "seconds", "reason")}
    return {"verdict": said, "off": away, "load": load, **known}


SOLVERS = {"NewtonSolver": by_newton_solver, "SNES": by_snes, "variform": by_variform}
PEER = "FElupe"


def solvers_of(name):
    """The solvers of a scene."""
    peer = fidelity_felupe.is_there() and fidelity_felupe.can_express(name)
    return {**SOLVERS, PEER: by_felupe} if peer else SOLVERS


def measure(name, reference):
    """Print the rows of a scene: one of each solver."""
    scene = build(name)
    mesh = float(np.linalg.norm(scene.u.function_space.mesh.geometry.x))
    if reference["unknowns"] != scene.problem.size or abs(mesh / reference["mesh"] - 1) > 1e-8:
        print(f"{name}: the reference is of another mesh, find it anew with --references.")
        return
    for solver, run in solvers_of(name).items():
        row = run(scene, reference)
        for key, digits in (("off", 2), ("unaccounted", 2), ("load", 6)):
            if row.get(key) is not None:
                row[key] = float(f"{row[key]:.{digits}g}")
        row["seconds"] = round(row["seconds"], 2)
        for key, load in (("part", row["load"]), ("small steps", reference["load"])):
            row[key] = round((load - scene.begin) / (scene.to - scene.begin), 4)
        row = {"scene": name, "solver": solver, "unknowns": scene.problem.size, **row}
        print(json.dumps(row), flush=True)


def measured(name):
    """Rows of a scene by a process of its own: what a solver does there harms no other scene."""
    command = [sys.executable, "-m", "demos.benchmarks.fidelity", name, "--alone"]
    why = ""
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT)
        out = done.stdout
        if done.returncode:
            why = f"its process ended with {done.returncode}: {done.stderr[-300:]}"
    except subprocess.TimeoutExpired as error:
        out, why = (error.stdout or b"").decode(), f"no end within {LIMIT} s"
    rows = [json.loads(line) for line in out.splitlines() if line.startswith("{")]
    if not rows and not why:
        print(out, end="", flush=True)
    for solver in list(solvers_of(name))[len(rows) :] if why else ():
        known = {"unknowns": rows[0]["unknowns"] if rows else 0, "tangents": 0, "seconds": 0.0}
        part = {"part": 0.0, "small steps": rows[0]["small steps"] if rows else 1.0}
        failed = {"verdict": "failed", "reason": why, "steps": 0, "refused": 0}
        rows.append({"scene": name, "solver": solver, **known, **part, **failed})
    return rows


def find_references(names):
    """Find the references of scenes and write them."""
    for name in names:
        found = small_steps.reference(build(name))
        kept = json.loads(FILE.read_text()) if FILE.exists() else {}
        kept[name] = found
        lines = [f" {json.dumps(each)}: {json.dumps(kept[each])}" for each in NAMES if each in kept]
        FILE.write_text("{\n" + ",\n".join(lines) + "\n}\n")
        state = "certain" if not found["doubts"] else "; ".join(found["doubts"])
        print(f"{name}: {state}, to {found['load']:.6g}, {found['tangents']} tangents", flush=True)


def table(rows, references):
    """Lines of the README's table, and sums."""
    lines = []
    for name in dict.fromkeys(row["scene"] for row in rows):
        reference = references[name]
        own = [row for row in rows if row["scene"] == name and row["solver"] != PEER]
        end = "end" if reference["reached"] else f"stop at {100 * own[0]['small steps']:.3g} %"
        cells = [name, own[0]["unknowns"], end + (", uncertain" if reference["doubts"] else "")]
        cells += [f"{reference['tangents']}, {reference['seconds']:.2f}"]
        for row in own:
            said = row["verdict"] if row["verdict"] == "right" else f"**{row['verdict']}**"
            if row["verdict"] in ("right", "stopped") and row["part"] < 1:
                said += f" at {100 * row['part']:.3g} %"
            events = len(row.get("events", ()))
            cells += [said + (f", {events} event{'s' * (events > 1)}" if events else "")]
            cells += [f"{row['tangents']}, {row['seconds']:.2f}"]
            if row["solver"] == "variform":
                cells += [f"{row['steps']} ({row['refused']})"]
        lines.append(cells)
    heads = ["scene", "unknowns", "small steps", "tangents, s"]
    heads += ["NewtonSolver", "tangents, s", "SNES bt", "tangents, s"]
    heads += ["variform", "tangents, s", "steps (refused)"]
    lines = [*markdown(heads, lines), "", *markdown(*sums(rows, references, SOLVERS))]
    theirs = {row["scene"] for row in rows if row["solver"] == PEER}
    if not theirs:
        return lines
    same = [row for row in rows if row["scene"] in theirs]
    return [*lines, "", *markdown(*sums(same, references, [PEER, *SOLVERS]))]


def sums(rows, references, solvers):
    """Heads and lines: of each solver verdicts, tangents, CPU."""
    names = dict.fromkeys(row["scene"] for row in rows)
    lines = []
    for solver in solvers:
        own = [row for row in rows if row["solver"] == solver]
        counts = [sum(row["verdict"] == kind for row in own) for kind in VERDICTS]
        tangents, seconds = (sum(row[key] for row in own) for key in ("tangents", "seconds"))
        lines.append([solver, *counts, tangents, f"{seconds:.1f}"])
    known = [references[name] for name in names]
    spent = [sum(each[key] for each in known) for key in ("tangents", "seconds")]
    blank = len(VERDICTS) * [""]
    lines.append([f"{small_steps.EQUAL} small steps", *blank, spent[0], f"{spent[1]:.1f}"])
    return [f"{len(names)} scenes", *VERDICTS, "tangents", "CPU s"], lines


def main(names, write=False):
    """Run, print and write the table."""
    references = json.loads(FILE.read_text())
    measurements = Table("fidelity")
    for name in names:
        if name not in references:
            print(f"{name}: no reference, find it with --references.", flush=True)
            continue
        for row in measured(name):
            measurements.add(**row)
    measurements.write()
    lines = table(measurements.rows, references)
    print("\n".join(lines))
    if write:
        insert("fidelity", lines)
    return measurements.rows


def chosen(words):
    """Scenes whose name contains one of the words; all without words."""
    if unknown := [word for word in words if not any(word in name for name in NAMES)]:
        sys.exit(f"no scene {', '.join(unknown)}: there are\n" + "\n".join(NAMES))
    return [name for name in NAMES if not words or any(word in name for word in words)]


if __name__ == "__main__":
    words = [word for word in sys.argv[1:] if not word.startswith("--")]
    scenes = chosen(words or (SMALL if "--small" in sys.argv else []))
    if "--alone" in sys.argv:
        measure(words[0], json.loads(FILE.read_text())[words[0]])
    elif "--references" in sys.argv:
        find_references(scenes)
    else:
        main(scenes, write="--write" in sys.argv)
