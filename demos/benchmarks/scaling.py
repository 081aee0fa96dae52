# SPDX-License-Identifier: MIT
"""Strong and weak scaling over MPI ranks, and what it means for a billion unknowns on a cluster.

The block of ``peers/problem.py``, twisted and pulled. Run ``docker/enter python3 -m
demos.benchmarks.scaling`` (``--small``: a toy size on 1 and 2 ranks): it starts itself on 1, 2 and
4 ranks by mpirun, one JSON line per row, and writes ``results/scaling.csv``, ``.png`` and ``.svg``;
``--write`` puts the tables into README.md. ``mpirun -n 8 python3 -m demos.benchmarks.scaling --one
--m 40`` makes one row.

"seconds" are CPU seconds of the slowest rank, medians of several rounds after a barrier, so that no
piece pays for the one before. A rank that waits for another within a piece burns CPU: on idle
cores its CPU seconds are those of the wall, and waiting counts as it would for a user. On a busy
machine they are too many; ``OMPI_MCA_mpi_yield_when_idle=1`` before the command, which OpenMPI does
itself with more ranks than cores, then leaves most of the waiting to others and out of the figures.

"strong": the same block on more ranks, efficiency T(1) / (N T(N)). "weak": as many cells per rank,
T(1) / T(N) per cell. "apart": as many runs on one rank each at once, T(1) / T, which is what the
machine leaves of two cores before any communication. "mesh": ``meshes.block``, and the order of a
checkpoint, on one process. "others": cores that other processes took meanwhile.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import time
import tracemalloc
from functools import cache
from pathlib import Path

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import ufl
from matplotlib.figure import Figure

from variform import forms, meshes
from variform.forms import energies
from variform.forms.files.identity import NodeOrder

from . import cluster
from .peers.fenicsx import create
from .peers.problem import LMBDA, MU, STEPS, STRETCH, TWIST, bent
from .record import Table, insert, markdown, save

COMM = MPI.COMM_WORLD
RANKS = (1, 2, 4)
# Cubes across; six tetrahedra each, five times as many along the block.
STRONG = {("P1", 23): RANKS, ("P2", 8): RANKS}
WEAK = {1: 15, 2: 19, 4: 24}  # m^3 grows as the ranks
SMALL, SMALL_WEAK = {("P1", 8): (1, 2)}, {1: 8, 2: 10}
PIECES = {"residual": 9, "tangent": 9, "SpMV": 30, "V-cycle": 9, "set-up": 1, "solve": 1, "step": 1}
LIMIT = 900  # s, for one row


def timed(work, repeats=1):
    """CPU seconds of a collective piece of work: of the slowest rank, and the mean of all."""
    seconds = []
    for _ in range(repeats):
        COMM.Barrier()
        start = time.process_time()
        work()
        seconds.append(time.process_time() - start)
    every = COMM.allgather(float(np.median(seconds)))
    return max(every), float(np.mean(every))


def traffic(event):
    """Messages, bytes and reductions that an event of PETSc's log has cost so far, of one rank."""
    found = PETSc.Log.Event(event).getPerfInfo()
    # PETSc counts a message where it is sent and where it is received.
    sums = found["numMessages"] / 2, found["messageLength"] / 2, found["numReductions"]
    return np.max(COMM.allgather(sums), axis=0)


def peak():
    """Largest resident memory so far of any rank [MB]."""
    return COMM.allreduce(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, MPI.MAX)


def measured(element, m):
    """Row of one size on the ranks of this process."""
    degree, before = int(element[1]), peak()
    body, left, right = create(m)
    t, u = forms.load_factor(body), forms.displacement(body, degree)
    psi = energies.neo_hookean(forms.deformation_gradient(u), MU, LMBDA)
    potential = psi * ufl.dx(degree=degree)
    turn = forms.rotate(u, right, angle=TWIST * t, axis=(1, 0, 0), shift=(STRETCH * t, 0, 0))
    held = [forms.clamp(u, left), turn]
    system = forms.Problem(potential, u, held)
    PETSc.Log.begin()
    seconds, about = _pieces(system, u)
    u.x.array[:] = 0
    paths = []

    def step():
        size = {"to": 1 / STEPS, "step": 1 / STEPS, "max_step": 1 / STEPS}
        paths.append(forms.follow(potential, u, held, t, progress=False, **size))

    seconds["step"] = timed(step)
    end = paths[0].steps[-1].convergence
    cells = COMM.allgather(body.topology.index_map(3).size_local)
    dofs = u.function_space.dofmap
    ghosts = COMM.allreduce(dofs.index_map.num_ghosts, MPI.MAX)
    row = {"element": element, "m": m, "ranks": COMM.size, "dofs": system.size}
    row |= {"cells": sum(cells), "imbalance": max(cells) * COMM.size / sum(cells)}
    row |= {"halo of a vector [B]": 8 * dofs.bs * ghosts, **about}
    row |= {"Newton": end.iterations, "linear": end.linear_iterations, "energy": system.energy()}
    row |= {"memory before [MB]": round(before), "memory [MB]": round(peak())}
    for name, (largest, mean) in seconds.items():
        row |= {f"{name} [s]": float(f"{largest:.4g}"), f"{name}, mean [s]": float(f"{mean:.4g}")}
    return row


def _pieces(system, u):
    """Seconds of each piece, and counts of what was done."""
    u.interpolate(lambda x: bent(x.T).T)
    newton = forms.solving.Newton(system, options={"ksp_rtol": 1e-8})
    A, b, x = newton.tangent.A, newton.runs.b, newton.runs.b.duplicate()
    work = {"residual": lambda: system.residual(b), "tangent": lambda: system.tangent(A)}
    seconds = {name: timed(do, PIECES[name]) for name, do in work.items()}
    # A right-hand side, and a tangent at rest, that no partition changes.
    b.array[:] = u.x.petsc_vec.array_r
    b.array[system.constrained] = 0
    u.x.array[:] = 0
    newton.tangent.scaled.measure()
    ksp = newton.snes.getKSP()
    pc = ksp.getPC()

    def prepare():
        newton.tangent.kept.prepare(A)
        ksp.setOperators(A)
        ksp.setUp()

    work = {"set-up": prepare, "SpMV": lambda: A.mult(b, x), "V-cycle": lambda: pc.apply(b, x)}
    events = {"set-up": "PCSetUp", "SpMV": "MatMult", "V-cycle": "PCApply"}
    about = {"stored": int(A.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"])}
    for name, do in work.items():
        before = traffic(events[name])
        seconds[name] = timed(do, PIECES[name])
        messages, size, reductions = (traffic(events[name]) - before) / PIECES[name]
        about |= {f"{name}, messages": messages, f"{name} [B]": size}
        about |= {f"{name}, reductions": reductions}
    seconds["solve"] = timed(lambda: ksp.solve(b, x))
    cycle = pc if pc.getType() == "python" else pc.getMGCoarseSolve().getPC()
    levels = cycle.getPythonContext().levels
    about |= {"iterations": ksp.getIterationNumber(), "levels": levels.getMGLevels()}
    about["coarsest"] = levels.getMGCoarseSolve().getOperators()[0].getSize()[0]
    newton.destroy()
    return seconds, about


def meshed(m):
    """Row of the package's own mesh of as many cells, made and checked by one process."""
    before, start = peak(), time.process_time()
    body = meshes.block(COMM, (1.0, 0.2, 0.2), n=(5 * m, m, m), cells="tetrahedron")
    cells = body.mesh.topology.index_map(3).size_global
    row = {"what": "mesh", "m": m, "ranks": COMM.size, "cells": cells}
    row |= {"mesh [s]": round(time.process_time() - start, 2)}
    row |= {"memory before [MB]": round(before), "memory [MB]": round(peak())}
    geometry = body.mesh.geometry
    tracemalloc.start()
    NodeOrder(COMM, np.arange(cells), geometry.dofmap, geometry.index_map(), 3)
    return row | {"checkpoint [B]": tracemalloc.get_traced_memory()[1]}


@cache
def started(ranks, *arguments, at_once=1):
    """Row of this module run on some ranks; of several at once the largest seconds."""
    words = ["mpirun", "-n", str(ranks), sys.executable, "-m", __spec__.name, "--one"]
    # Not what MPI has put into the environment of this very process.
    options = {"env": dict(os.environ), "stdout": subprocess.PIPE, "text": True}
    before = _busy()
    runs = [subprocess.Popen([*words, *arguments], **options) for _ in range(at_once)]
    try:
        rows = [json.loads(run.communicate(timeout=LIMIT)[0].splitlines()[-1]) for run in runs]
    finally:
        for run in runs:
            run.kill()
    wall, busy = np.subtract(_busy(), before)
    row = {k: max(r[k] for r in rows) if "[s]" in k else v for k, v in rows[0].items()}
    return {**row, "others": max(0.0, round(busy / wall, 2))}


def _busy():
    """Wall seconds, and CPU seconds of all processes but those that this one started."""
    stat = Path("/proc/stat")
    user, nice, system = stat.read_text().split()[1:4] if stat.exists() else (0, 0, 0)
    own = resource.getrusage(resource.RUSAGE_CHILDREN)
    total = (int(user) + int(nice) + int(system)) / os.sysconf("SC_CLK_TCK")
    return time.perf_counter(), total - own.ru_utime - own.ru_stime


def compared(row, base):
    """Efficiencies of a row's pieces: seconds of the base for as many cells as a rank has here."""
    share = row["cells"] / row["ranks"] / base["cells"]
    names = [f"{name} [s]" for name in PIECES]
    return row | {f"{k[:-4]}, efficiency": round(share * base[k] / row[k], 3) for k in names}


def main(small=False, write=False):
    """Start the runs, print and write the rows, the chart and on demand the tables."""
    table = Table("scaling")
    strong, weak = (SMALL, SMALL_WEAK) if small else (STRONG, WEAK)

    cases = [("strong", element, {n: m for n in ranks}) for (element, m), ranks in strong.items()]
    for what, element, sizes in [*cases, ("weak", "P1", weak)]:
        base = None
        for ranks, m in sizes.items():
            words = "--element", element, "--m", str(m)
            row = started(ranks, *words)
            base = base or row
            table.add(what=what, **compared(row, base))
            if what == "strong" and ranks == 1:
                row = started(1, *words, at_once=2)
                table.add(what="apart", **compared(row, base))
    table.add(**started(1, "--mesh", "--m", str(max(m for _, m in strong))))
    table.write()
    plot(table.rows)
    lines = cluster.lines(table.rows)
    if write:
        insert("scaling", listed(table.rows))
        insert("estimate", lines)
    return table.rows


def listed(rows):
    """The Markdown table of all runs: CPU seconds of the slowest rank (efficiency)."""
    columns = ["", "ranks", "dofs", "CG", *PIECES, "halo, kB", "MB per rank", "others"]
    lines = []
    for r in rows:
        if r["what"] == "mesh":
            continue
        alone = r["ranks"] == 1 and r["what"] != "apart"
        cells = [f"{r['what']}, {r['element']}", r["ranks"], f"{r['dofs']:,}", r["iterations"]]
        for name in PIECES:
            efficiency = r.get(f"{name}, efficiency")
            cells.append(f"{r[f'{name} [s]']:.3g}" + ("" if alone else f" ({efficiency:.2f})"))
        cells += [f"{r['SpMV [B]'] / 1e3:.1f}", r["memory [MB]"], f"{r['others']:.1f}"]
        lines.append(cells)
    return markdown(columns, lines)


def plot(rows):
    """Efficiencies over the ranks, strong and weak."""
    kinds = list(dict.fromkeys((r["what"], r["element"]) for r in rows if r["what"] in TITLES))
    figure = Figure((1.4 + 3.8 * len(kinds), 3.6), layout="constrained")
    panels = figure.subplots(1, len(kinds), sharey=True)
    for ax, (what, element) in zip(panels, kinds, strict=True):
        found = [r for r in rows if (r["what"], r.get("element")) == (what, element)]
        ranks = [r["ranks"] for r in found]
        for name, marker in zip(PIECES, "osd^v<>", strict=True):
            ax.plot(ranks, [r[f"{name}, efficiency"] for r in found], marker=marker, label=name)
        cores = len(os.sched_getaffinity(0))
        if max(ranks) > cores:
            ax.axvspan(cores + 0.1, max(ranks) + 0.2, color="0.93", zorder=0)
            ax.text(
                max(ranks) + 0.1,
                0.03,
                f"more ranks than\nthe {cores} cores",
                ha="right",
                va="bottom",
            )
        ax.axhline(1, color="0.6", linewidth=0.8)
        ax.set(title=TITLES[what].format(element, found[0]), xlabel="ranks", xticks=ranks)
    panels[0].set(ylabel="parallel efficiency (CPU seconds)", ylim=(0, None))
    handles, names = panels[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside right upper")
    save(figure, "scaling")


TITLES = {
    "strong": "strong, {0}: {1[dofs]:,} unknowns",
    "weak": "weak, {0}: {1[cells]:,} cells per rank",
}


def arguments():
    """Command line."""
    parser = argparse.ArgumentParser()
    for name in ("small", "write", "one", "mesh"):
        parser.add_argument(f"--{name}", action="store_true")
    parser.add_argument("--element", default="P1", choices=("P1", "P2"))
    parser.add_argument("--m", type=int, default=8, help="cubes across")
    return parser.parse_args()


if __name__ == "__main__":
    given = arguments()
    if given.one:
        result = meshed(given.m) if given.mesh else measured(given.element, given.m)
        if COMM.rank == 0:
            print(json.dumps(result))
    else:
        main(given.small, given.write)
