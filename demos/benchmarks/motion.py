# SPDX-License-Identifier: MIT
"""Bodies in motion: published swings, momenta over 10^4 steps, schemes against each other, cost.

Turek and Hron's CSM1 and CSM3 over dt; a block thrown spinning by the midpoint rule and by implicit
Euler; error over CPU time of four schemes; CPU time of a step over that of a static iteration. Run
``docker/enter python3 -m demos.benchmarks.motion`` (``--small``: toy sizes); one JSON line per row,
and ``results/motion.csv``; ``--write`` puts the tables into README.md. One process only.
"""

import resource
import sys
import time

from mpi4py import MPI

import numpy as np
import ufl

from variform import forms, meshes

from .record import Table, insert, markdown

TIP, REPEATS = (0.6, 0.2), 5
PUBLISHED = {"ux": (-14.305, 14.305), "uy": (-63.607, 65.160), "Hz": 1.0995}


def flag(n):
    """The bar of Turek and Hron's solid tests, 4 n^2 times 10 quadratic quadrilaterals."""
    y = np.linspace(0.19, 0.21, 2 * n + 1)
    arc = 0.2 + np.sqrt(0.05**2 - (y - 0.2) ** 2)
    across = np.linspace(0, 1, 20 * n + 1)[:, None]
    points = np.stack([arc + (0.6 - arc) * across, y + 0 * across], axis=-1).reshape(-1, 2)
    corner = np.add.outer(np.arange(20 * n) * len(y), np.arange(2 * n)).ravel()
    cells = corner[:, None] + [0, len(y), len(y) + 1, 1]
    at_arc = {"arc": np.arange(len(y))}
    body = meshes.from_arrays(MPI.COMM_SELF, points, cells, cell="quadrilateral", boundaries=at_arc)
    t, u = forms.load_factor(body), forms.displacement(body, 2)
    psi = forms.energies.saint_venant_kirchhoff(forms.deformation_gradient(u), 0.5e6, 2e6)
    potential = psi * ufl.dx + forms.gravity(u, 1000.0, 2.0)
    return potential, u, forms.clamp(u, body.facets("arc")), t


def swing(n, dt, to):
    """CSM1 and CSM3: the place at rest, mean and amplitude of the last period, frequency."""
    potential, u, held, t = flag(n)
    forms.follow(t * potential, u, held, t, progress=False)
    rest = 1e3 * forms.at(u, TIP)
    u.x.array[:], t.value = 0, 0
    start = time.process_time()
    path = forms.transient(
        *(potential, u, held, t),
        to=to,
        rho=1000.0,
        dt=dt,
        record={"tip": lambda problem: forms.at(u, TIP)},
        progress=False,
    )
    seconds = time.process_time() - start
    tip = 1e3 * path.record("tip")
    times = np.array([step.load for step in path.steps])
    row = {"dt": dt or "local error", "steps": len(times), "rest x": rest[0], "rest y": rest[1]}
    last = times > to - 1 / PUBLISHED["Hz"]
    for name, values in zip(("ux", "uy"), tip.T, strict=True):
        low, high = values[last].min(), values[last].max()
        row |= {f"{name} mean": (high + low) / 2, f"{name} amplitude": (high - low) / 2}
    above = tip[:, 1] - row["uy mean"]
    up = np.flatnonzero((above[:-1] < 0) & (above[1:] >= 0))
    crossed = times[up] - above[up] * (times[up + 1] - times[up]) / (above[up + 1] - above[up])
    row["Hz"] = (len(crossed) - 1) / (crossed[-1] - crossed[0]) if len(crossed) > 1 else np.nan
    account = path.ledger
    return row | {"unaccounted": account.missed / account.exchanged, "CPU s": seconds}


def thrown(scheme, steps, rtol=1e-12):
    """A soft block thrown spinning: what is kept, and how memory grows."""
    body = meshes.block(MPI.COMM_SELF, (1.0, 0.4, 0.2), n=(4, 2, 1))
    t, u = forms.load_factor(body), forms.displacement(body)
    psi = forms.energies.fixed_corotated(forms.deformation_gradient(u), 10.0, 20.0) * ufl.dx
    arm = ufl.SpatialCoordinate(body.mesh) - ufl.as_vector([0.5, 0.2, 0.1])
    velocity = ufl.as_vector([1.0, 0.2, 0.1]) + ufl.cross(ufl.as_vector([0.3, 0.5, 2.0]), arm)
    memory = []

    def watch(path):
        if len(path.steps) in (steps // 10, steps):
            memory.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)

    start = time.process_time()
    path = forms.transient(
        *(psi, u, (), t),
        to=0.02 * steps,
        dt=0.02,
        rho=1.0,
        scheme=scheme,
        velocity=velocity,
        rtol=rtol,
        on_step=watch,
        progress=False,
    )
    seconds = time.process_time() - start
    momentum, turning = path.record("momentum"), path.record("angular_momentum")
    energy = np.cumsum([row.stored + row.kinetic for row in path.ledger])
    half = steps // 2
    return {
        "scheme": scheme,
        "steps": steps,
        "momentum": np.abs(momentum - momentum[0]).max() / np.linalg.norm(momentum[0]),
        "angular momentum": np.abs(turning - turning[0]).max() / np.linalg.norm(turning[0]),
        "second half's excursion": np.ptp(energy[half:]) / np.ptp(energy[:half]),
        "energy at the end": energy[-1] / path.record("kinetic")[0],
        "kB a step": 1024 * (memory[-1] - memory[0]) / (0.9 * steps),
        "CPU s": seconds,
    }


def precision(n, to, counts):
    """Errors of the tip at a time by four schemes over dt, against small steps."""
    potential, u, held, t = flag(n)

    def run(scheme, count):
        u.x.array[:], t.value = 0, 0
        start = time.process_time()
        options = {"dt": to / count, "rho": 1000.0, "progress": False, "rtol": 1e-9}
        path = forms.transient(potential, u, held, t, to=to, scheme=scheme, **options)
        loss = sum(row.scheme for row in path.ledger)
        return u.x.array.copy(), time.process_time() - start, loss

    known, _, _ = run("midpoint", 8 * counts[-1])
    for scheme in ("euler", "bdf2", "newmark", "midpoint"):
        for count in counts:
            found, seconds, loss = run(scheme, count)
            error = np.abs(found - known).max() / np.abs(known).max()
            yield {
                "scheme": scheme,
                "dt": to / count,
                "error": error,
                "lost by the scheme [J/m]": loss,
                "CPU s": seconds,
            }


def cost(h):
    """CPU time of a step in time over its iterations times a static one's; medians.

    Of the steps behind the first: both paths begin with what is done once. By Newton iterations,
    and by linear ones, of which each step takes as many as its accuracy asks for.
    """
    body = meshes.block(MPI.COMM_SELF, (2.0, 1.0, 1.0), h=h)
    t, u = forms.load_factor(body), forms.displacement(body, 2)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0) * ufl.dx
    held, ratios, row = forms.clamp(u, body.facets("left")), [], {}
    weight = forms.body_force(u, ufl.as_vector([0 * t, 0 * t, -0.05 * t]))
    always = {"progress": False, "record": {"clock": lambda problem: time.process_time()}}
    for _ in range(REPEATS):
        each = []
        for moving in (False, True):
            u.x.array[:], t.value = 0, 0
            if moving:
                potential = psi + forms.gravity(u, 0.05, 1.0)
                options = {"to": 0.5, "dt": 0.05, "rho": 1.0}
                path = forms.transient(potential, u, held, t, **options, **always)
            else:
                options = {"step": 0.2, "max_step": 0.2}
                path = forms.follow(psi + weight, u, held, t, **options, **always)
            clock, rest = path.record("clock"), path.steps[-len(path.record("clock")) + 1 :]
            ends = [step.convergence for step in rest]
            newton = sum(end.iterations for end in ends)
            linear = sum(end.linear_iterations for end in ends)
            seconds = clock[-1] - clock[0]
            each.append((seconds / newton, seconds / linear if linear else np.nan))
        ratios.append(np.divide(each[1], each[0]))
        row = {"unknowns": path.problem.size, "static s": each[0][0], "moving s": each[1][0]}
    per = np.median(ratios, axis=0)
    return row | {"ratio": float(per[0]), "ratio by linear iterations": float(per[1])}


def main(words):
    """Measure, print and write."""
    small = "--small" in words
    table = Table("motion")
    steps = (0.02, 0.01) if small else (0.02, 0.01, 0.005, 0.0025, None)
    swings = [swing(1 if small else 4, dt, 2.0 if small else 10.0) for dt in steps]
    throws = [thrown(scheme, 200 if small else 10_000) for scheme in ("midpoint", "euler")]
    counts = (20, 40) if small else (50, 100, 200, 400, 800)
    errors = list(precision(1, 0.5, counts))
    costs = [cost(0.5 if small else 0.088)]
    for part, rows in (("swing", swings), ("thrown", throws), ("scheme", errors), ("cost", costs)):
        for row in rows:
            table.add(part=part, **row)
    table.write()
    if "--write" in words:
        lines = []
        for rows in (swings, throws, errors, costs):
            cells = [[_short(value) for value in row.values()] for row in rows]
            lines += [*markdown(tuple(rows[0]), cells), ""]
        insert("motion", lines[:-1])
    return 0


def _short(value):
    return value if isinstance(value, str) else f"{value:.5g}"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
