# SPDX-License-Identifier: MIT
"""References of the fidelity benchmark: plain Newton over many equal load steps, with its proof.

Nothing of variform's stepping is in it: full Newton steps with a new tangent each, started at the
last state, prescribed values carried along by the first one. A step that fails is halved, down to
a thousandth of the way, below which small steps stop. A reference is certain if steps half as long
end at the same state (or stop at the same load) with the same negative eigenvalues on the way, and
if the energy changes as the work of loads and supports says, to the trapezoidal rule's error.
"""

import time
from dataclasses import dataclass, field

from petsc4py import PETSc

import numpy as np

from variform import forms

MOST, LEAST, CLOSE = 12, 1e-3, 1e-6
EQUAL, LARGE = 60, 30  # equal steps of the first run, and above 5,000 unknowns
MISSED = 0.1  # part of a step's work that its energy may miss; a jump misses about all of it


@dataclass
class Run:
    """One run of equal steps.

    Attributes:
        load: Last load factor reached.
        counts: Negative eigenvalues where they change, as pairs of a load and the number.
        tangents: Tangents assembled.
        seconds: CPU time.
        missed: What the trapezoidal rule misses of the energy, over all work.
        worst: The same of the worst step, over its own work.
        state: Unknown at the end.
    """

    load: float
    counts: list = field(default_factory=list)
    tangents: int = 0
    seconds: float = 0.0
    missed: float = 0.0
    worst: float = 0.0
    state: np.ndarray | None = None


class Plain:
    """Plain Newton for a scene, with MUMPS: L D L^T where the tangent is symmetric, else LU."""

    def __init__(self, scene):
        self.scene, self.problem = scene, scene.problem
        self.A, self.b = self.problem.create_matrix(), self.problem.create_vector()
        self.x = self.b.duplicate()
        self.ksp = PETSc.KSP().create(self.problem.comm)
        self.ksp.setOperators(self.A)
        self.ksp.setType("preonly")
        pc = self.ksp.getPC()
        pc.setType("cholesky" if self.problem.symmetric else "lu")
        pc.setFactorSolverType("mumps")
        self.ksp.setOptionsPrefix("small_steps_")
        options = PETSc.Options("small_steps_")
        options["mat_mumps_icntl_14"], options["mat_mumps_icntl_13"] = 100, 1
        self.ksp.setFromOptions()
        points = scene.u.function_space.mesh.geometry.x
        self.size = float(np.linalg.norm(points.max(axis=0) - points.min(axis=0)))
        self.tangents, self.count = 0, None

    def solve(self, load):
        """Equilibrium at a load, from the present state; whether it was found."""
        self.scene.go(load)
        held, u = self.problem.constrained, self.scene.u
        for iteration in range(MOST):
            if iteration:
                self.problem.residual(self.b)
            else:
                self.problem.lifted_residual(self.b)
            if not np.isfinite(self.b.norm()):
                return False
            self.b.array[held] = 0
            self.problem.tangent(self.A)
            self.A.assemble()
            self.tangents += 1
            try:
                self.ksp.setOperators(self.A)
                self.ksp.solve(self.b, self.x)
            except PETSc.Error:
                return False
            change = self.x.array_r.copy()
            if not np.isfinite(change).all():
                return False
            u.x.array[: len(change)] -= change
            if not iteration:
                self.b.array[:] = u.x.array[: len(change)]
                self.problem.prescribe(self.b)
                u.x.array[held] = self.b.array_r[held]
            if not np.isfinite(self.problem.energy()):
                return False
            if iteration and np.abs(change).max() <= 1e-8 * self.size:
                if self.problem.symmetric:
                    self.count = self.ksp.getPC().getFactorMatrix().getMumpsInfog(12)
                return True
        return False

    def destroy(self):
        """Free the PETSc objects."""
        for each in (self.ksp, self.A, self.b, self.x):
            each.destroy()


class Works:
    """Energy and work from state to state, by the trapezoidal rule along the chord of u."""

    def __init__(self, scene):
        self.scene, problem = scene, scene.problem
        self.problem = problem
        if problem.forms.virtual_work is not None:
            self.problem = forms.Problem(scene.potential, problem.u, problem.supports)
        self.b = self.problem.create_vector()
        self.last = self.read()
        self.off, self.work, self.worst = 0.0, 0.0, 0.0

    def read(self):
        """Load, energy, its gradient, unknown."""
        self.problem.residual(self.b)
        u = self.scene.u.x.array.copy()
        return float(self.scene.t.value), self.problem.energy(), self.b.array_r.copy(), u

    def energy(self, load, u):
        """Energy of a state under another load, which is set for that."""
        x, now = self.scene.u.x.array, float(self.scene.t.value)
        kept = x.copy()
        x[:], self.scene.t.value = u, load
        value = self.problem.energy()
        x[:], self.scene.t.value = kept, now
        return value

    def take(self):
        """Account for the step to the present state."""
        here = self.read()
        (t0, E0, G0, u0), (t1, E1, G1, u1) = self.last, here
        moved = (G0 + G1) @ (u1 - u0)[: len(G0)] / 2
        loaded = (self.energy(t1, u0) - E0 + E1 - self.energy(t0, u1)) / 2
        off, work = E1 - E0 - moved - loaded, abs(moved) + abs(loaded)
        self.off, self.work, self.last = self.off + off, self.work + work, here
        self.worst = max(self.worst, abs(off) / max(work, 1e-12))


def walk(scene, n):
    """Equal steps, halved where Newton fails."""
    scene.reset()
    plain, works, run = Plain(scene), Works(scene), Run(scene.begin)
    begin, way, done, step = time.process_time(), scene.to - scene.begin, 0.0, 1 / n
    accounts = 0.0
    while done < 1 - 1e-12:
        before = scene.u.x.array.copy()
        # Behind a halved step the next equal load comes first.
        ahead = min((np.floor(done * n + 1e-9) + 1) / n, done + step)
        if plain.solve(scene.to if ahead > 1 - 1e-12 else scene.begin + way * ahead):
            done, step = ahead, min(2 * step, 1 / n)
            run.load = float(scene.t.value)
            if plain.count is not None and (not run.counts or run.counts[-1][1] != plain.count):
                run.counts.append((run.load, plain.count))
            start = time.process_time()
            works.take()
            accounts += time.process_time() - start
        else:
            scene.u.x.array[:] = before
            step = (ahead - done) / 2
            if step < LEAST:
                break
    run.seconds = time.process_time() - begin - accounts
    scene.go(run.load)
    run.tangents, run.state = plain.tangents, scene.u.x.array.copy()
    run.missed, run.worst = works.off / max(works.work, 1e-12), works.worst
    plain.destroy()
    return run


def figures(scene):
    """The state in u in a few numbers: what one that follow finds is compared with."""
    u = scene.u.x.array
    values, u = u[scene.nodes], u[scene.moved]
    smallest = None
    if scene.F is not None:
        smallest = forms.smallest_volume_ratio(scene.F, scene.u.function_space.mesh, 6)
    return {
        "energy": scene.problem.energy(),
        "norm": float(np.sqrt(np.mean(u**2))),
        "largest": float(np.abs(u).max()),
        "nodes": [[float(x) for x in row] for row in values],
        "smallest J": smallest,
    }


def off(found, reference):
    """How far two states' displacements differ, over the largest one."""
    nodes = np.abs(np.subtract(found["nodes"], reference["nodes"])).max()
    norms = abs(found["norm"] / reference["norm"] - 1)
    return float(max(nodes / reference["largest"], norms))


def reference(scene):
    """Figures of the path's end, of how it was found, and how certain it is."""
    n = LARGE if scene.problem.size > 5000 else EQUAL
    runs = [walk(scene, n)]
    while True:
        runs.append(walk(scene, 2 * n))
        doubts = doubted(scene, *runs[-2:])
        if not doubts or len(runs) == 3:
            break
        n *= 2
    first, last = runs[0], runs[-1]
    scene.u.x.array[:] = last.state
    found = {key: rounded(value) for key, value in figures(scene).items()}
    return {
        "unknowns": scene.problem.size,
        "mesh": rounded(np.linalg.norm(scene.u.function_space.mesh.geometry.x)),
        "load": rounded(last.load),
        "reached": last.load == scene.to,
        **found,
        "counts": [(rounded(load), count) for load, count in last.counts],
        "steps": 2 * n,
        "missed": [float(f"{run.missed:.2g}") for run in runs],
        "worst step": float(f"{last.worst:.2g}"),
        "doubts": doubts,
        "tangents": first.tangents,
        "seconds": round(first.seconds, 2),
    }


def doubted(scene, run, finer):
    """What speaks against a run and one of half the steps, in words."""
    doubts, way = [], scene.to - scene.begin
    complete = [each.load == scene.to for each in (run, finer)]
    if not all(complete):
        if abs(run.load - finer.load) > 0.02 * abs(way):
            doubts.append(f"stops at {run.load:.6g}, with half the steps at {finer.load:.6g}")
    else:
        apart = np.abs(run.state - finer.state).max() / np.abs(finer.state).max()
        if not apart <= CLOSE:
            doubts.append(f"half the steps end {apart:.1e} away")
    if [c for _, c in run.counts] != [c for _, c in finer.counts]:
        doubts.append(f"counts {run.counts} and {finer.counts}")
    if finer.worst > MISSED:
        doubts.append(f"a step misses {finer.worst:.2g} of its work")
    if abs(finer.missed) > max(0.5 * abs(run.missed), 1e-4):
        doubts.append(f"the rule misses {run.missed:.1e}, then {finer.missed:.1e} of the work")
    return doubts


def rounded(value):
    """A number, or lists of them, to ten digits."""
    if isinstance(value, list | tuple):
        return [rounded(each) for each in value]
    return value if value is None or isinstance(value, bool) else float(f"{float(value):.10g}")
