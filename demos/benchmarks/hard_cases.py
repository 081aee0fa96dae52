# SPDX-License-Identifier: MIT
"""Twenty hard cases: variform in one call beside DOLFINx's own Newton solver.

Both solvers get the same mesh, compiled residual, tangent and loads; DOLFINx's has its defaults,
MUMPS, and as many equal load steps as ``Case.steps``. The table of the cases is in README.md, the
cases are in hard_scenes.py. Solved means: converged, and the state passes a check of its own:
forces, prescribed values, J > 0 in whole cells, the number that is known, and the energy and
stability of the end of the connected path. Run ``docker/enter python3 -m
demos.benchmarks.hard_cases`` (names of cases after it choose some, ``--small`` the cheap ones); one
JSON line per case and solver, and ``results/hard_cases.csv``; ``--write`` puts the table into
README.md; ``--ends`` finds the ends by small steps instead. One process only.
"""

import json
import sys
import time
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from petsc4py import PETSc

import numpy as np
from dolfinx.fem import petsc as fem_petsc
from dolfinx.nls.petsc import NewtonSolver

from variform import forms

from .hard_scenes import CASES, COMM
from .record import Table, insert, markdown

CLOSE, ROUNDING = 1e-6, 1e-12  # energies: relative [-], and at rest [J]
SMALL = ("confined", "pressure", "scrambled", "disk", "balloon")


def faults(case, path):
    """What is wrong with the state in u, a list of words; and the numbers looked at."""
    system, u = forms.Problem(case.potential, case.u, case.supports, case.virtual_work), case.u
    for support in case.supports:
        support.update()
    wrong, numbers = [], {}
    b = system.create_vector()
    system.residual(b)
    R, constrained = b.array.copy(), system.constrained
    free = np.setdiff1d(np.arange(R.size), constrained)
    scale = max(np.linalg.norm(R[constrained]), case.force)
    if u.function_space.num_sub_spaces == 2 and u.function_space.dofmap.bs == 1:
        pressures = np.asarray(u.function_space.sub(1).collapse()[1]).ravel()
        volumes, free = R[pressures], np.setdiff1d(free, pressures)
        numbers["volume error"] = float(np.linalg.norm(volumes))
    numbers["|R|/force"] = float(np.linalg.norm(R[free]) / scale)
    system.prescribe(b)
    off = np.abs(u.x.array - b.array)[constrained].max(initial=0.0)
    numbers["off supports"] = float(off)
    for name, most in (("|R|/force", 1e-6), ("off supports", 1e-8), ("volume error", 1e-6)):
        if not numbers.get(name, 0.0) <= most:
            wrong.append(f"{name} {numbers[name]:.1e}")
    b.destroy()
    if case.positive:
        numbers["smallest J"], upper, _ = forms.validity.volume_bounds(system)
        if not numbers["smallest J"] > 0:
            wrong.append(f"J = {numbers['smallest J']:.2g} … {upper:.2g}")
    if case.end is not None:
        wrong += another_end(case, system, path, numbers)
    for name, found, expected, tolerance in case.known(path):
        numbers[name] = float(found)
        if expected is not None and not abs(found - expected) <= tolerance:
            wrong.append(f"{name} {found:.6g} for {expected:.6g}")
    return wrong, numbers


def another_end(case, system, path, numbers):
    """How the state in u, and what the path to it passed, differ from the connected path's."""
    wrong, end = [], case.end
    numbers["energy"] = system.energy()
    if not abs(numbers["energy"] - end.energy) <= CLOSE * abs(end.energy) + ROUNDING:
        wrong.append(f"energy {numbers['energy']:.7g} for {end.energy:.7g}")
    if end.negative is not None:
        numbers["negative"] = forms.negative_eigenvalues(system)
        if numbers["negative"] != end.negative:
            wrong.append(f"{numbers['negative']} negative eigenvalues for {end.negative}")
    if path is not None:
        numbers |= {f"{event.kind} {n}": event.load for n, event in enumerate(path.events)}
        found = [(event.kind, event.load) for event in path.events]
        same = len(found) == len(end.events) and all(
            kind == known and abs(load - place) <= tolerance
            for (kind, load), (known, place, tolerance) in zip(found, end.events, strict=True)
        )
        if not same:
            wrong.append(f"passed {found} for {list(end.events)}")
    return wrong


@dataclass
class Outcome:
    """How a solver fared.

    Attributes:
        counts: Steps, refused steps, Newton iterations and linear iterations of the steps taken.
        tangents: Tangents assembled, those of predictors and of refused steps included.
        seconds: CPU time, checks left out.
        reason: Why the last solve ended.
        wrong: What is wrong with the state.
        numbers: What has been looked at.
    """

    counts: Any = field(default_factory=lambda: np.zeros(4, int))
    tangents: int = 0
    seconds: float = 0.0
    reason: str = ""
    wrong: list = field(default_factory=lambda: ["no convergence"])
    numbers: dict = field(default_factory=dict)

    @contextmanager
    def timed(self, owner, name):
        """Measure the time, and count the calls of a method that assembles the tangent."""
        assemble, start = getattr(owner, name), time.process_time()

        def tangent(*arguments, **options):
            self.tangents += 1
            assemble(*arguments, **options)

        setattr(owner, name, tangent)
        try:
            yield
        finally:
            setattr(owner, name, assemble)
            self.seconds += time.process_time() - start


def by_variform(case):
    """Variform's one call for each start."""
    outcome = Outcome()
    for start in case.starts:
        case.begin(start)
        converged = True
        with outcome.timed(forms.Problem, "tangent"):
            try:
                path = case.call()
            except forms.NotConverged as error:
                path, converged = error.path, False
        runs = [step.convergence for step in path.steps]
        newton, linear = (
            sum(getattr(run, name) for run in runs) for name in ("iterations", "linear_iterations")
        )
        outcome.counts += [len(runs), path.refused, newton, linear]
        outcome.reason = path.reason
        if converged:
            outcome.wrong, outcome.numbers = faults(case, path)
        if outcome.wrong:
            break
    return outcome


def by_dolfinx(case, to):
    """DOLFINx's Newton solver with equal load steps up to a load factor."""
    outcome, start = Outcome(), time.process_time()
    system = forms.Problem(case.potential, case.u, case.supports, case.virtual_work)
    # 0.10 gave the old problem a longer name.
    old = getattr(fem_petsc, "NewtonSolverNonlinearProblem", fem_petsc.NonlinearProblem)
    problem = old(system.forms.residual_form, case.u, system.conditions, system.forms.tangent_form)
    solver = NewtonSolver(COMM, problem)
    solver.krylov_solver.setType("preonly")
    solver.krylov_solver.getPC().setType("lu")
    solver.krylov_solver.getPC().setFactorSolverType("mumps")
    outcome.seconds = time.process_time() - start
    for begin in case.starts:
        case.begin(begin)
        with outcome.timed(problem, "J"):
            solver.setJ(problem.J, solver.A)
            outcome.reason = equal_steps(case, solver, to, outcome.counts)
        if outcome.reason:
            outcome.wrong = ["no convergence"]
            break
        outcome.reason = f"All {case.steps} steps converged."
        outcome.wrong, outcome.numbers = faults(case, None)
        if outcome.wrong:
            break
    return outcome


def equal_steps(case, solver, to, counts):
    """Solve at equal load steps; why that ended before the last one, or nothing."""
    for step in range(1, case.steps + 1):
        case.t.value = to * step / case.steps
        for support in case.supports:
            support.update()
        try:
            iterations, _ = solver.solve(case.u)
        except (RuntimeError, PETSc.Error) as error:
            words = " ".join(str(error).split())
            if not np.isfinite(case.u.x.array).all():
                words = "the state is not finite"
            return f"Step {step} of {case.steps}: {words}."
        counts += [1, 0, iterations, iterations]
    return ""


def measure(name, measurements):
    """Rows of one case: variform, DOLFINx."""
    case = CASES[name]()
    for solver in ("variform", "DOLFINx"):
        if solver == "variform":
            outcome = by_variform(case)
            to = float(case.t.value) if case.to is None else case.to
        else:
            outcome = by_dolfinx(case, to)
        names = ("steps", "refused", "iterations", "linear iterations")
        row = {"case": name, "solver": solver, "solved": not outcome.wrong}
        row |= dict(zip(names, map(int, outcome.counts), strict=True))
        row |= {"tangents": outcome.tangents, "seconds": round(outcome.seconds, 2)}
        row |= {"reason": "; ".join([*outcome.wrong, outcome.reason])}
        row |= {"numbers": {key: float(f"{x:.7g}") for key, x in outcome.numbers.items()}}
        measurements.add(**row)


def find_end(name):
    """Print where small steps lead to, and what certifies them: the numbers of ``Case.end``."""
    case = CASES[name]()
    if case.small is None:
        return
    case.begin(case.starts[0])
    try:
        path = case.small()
    except forms.NotConverged as error:
        path = error.path
    ledger, symmetric = path.ledger, path.problem.symmetric
    line = {"case": name, "energy": path.problem.energy()}
    line |= {"negative": forms.negative_eigenvalues(path) if symmetric else None}
    line |= {"events": [(event.kind, event.load) for event in path.events]}
    line |= {"steps": len(path.steps), "refused": path.refused}
    line |= {"unaccounted": ledger.missed / ledger.exchanged if ledger else None}
    line |= {"J": min((s.bounds.lower for s in path.steps if s.bounds), default=None)}
    line |= {"by": [row.kind for row in ledger if row.kind], "reason": path.reason}
    print(json.dumps(line), flush=True)


def table(rows):
    """Lines of the README's table."""
    columns = ("steps (refused)", "Newton", "tangents", "s")
    heads = [f"{solver}: solved" for solver in ("variform", "DOLFINx")]
    lines = []
    for ours, other in zip(rows[::2], rows[1::2], strict=True):
        cells = [f"{list(CASES).index(ours['case']) + 1} {ours['case']}"]
        for row in (ours, other):
            cells += ["yes" if row["solved"] else "**no**", f"{row['steps']} ({row['refused']})"]
            cells += [row["iterations"], row["tangents"], f"{row['seconds']:.2f}"]
        why = [f"{row['solver']}: {row['reason']}" for row in (ours, other) if not row["solved"]]
        cells.append(" ".join(why).replace("|R|", "R"))
        lines.append(cells)
    count = [sum(row["solved"] for row in rows[k::2]) for k in (0, 1)]
    seconds = [sum(row["seconds"] for row in rows[k::2]) for k in (0, 1)]
    return [
        *markdown(["case", heads[0], *columns, heads[1], *columns, "why not"], lines),
        "",
        f"variform solves {count[0]} of {len(rows) // 2} in {seconds[0]:.1f} s, "
        f"DOLFINx's Newton solver {count[1]} in {seconds[1]:.1f} s.",
    ]


def main(names, write=False):
    """Run, print and write the table."""
    measurements = Table("hard_cases")
    for name in names:
        measure(name, measurements)
    measurements.write()
    if write:
        insert("hard cases", table(measurements.rows))
    return measurements.rows


if __name__ == "__main__":
    words = [word for word in sys.argv[1:] if not word.startswith("--")]
    chosen = words or (SMALL if "--small" in sys.argv else list(CASES))
    if "--ends" in sys.argv:
        for name in chosen:
            find_end(name)
    else:
        main(chosen, write="--write" in sys.argv)
