# SPDX-License-Identifier: MIT
"""Iterations and times of multigrid and of the field split over the size, beside MUMPS.

A bar 1 x 0.2 x 0.2 and a cube, both ends clamped. Run ``docker/enter python3 -m
demos.benchmarks.multigrid`` (also under mpirun; names of elements after it choose some;
``--small``: toy sizes); one JSON line per row, and ``results/multigrid.csv``; ``--write`` puts the
table into README.md. "solve" is one tangent solve to 1e-8 for random forces at rest, with the
iterations of the iterative solver; "twist" two load steps by Newton's method, to 0.3 rad (bar) and
0.45 (cube). Seconds of rank 0's CPU.
"""

import sys
import time

from mpi4py import MPI

import numpy as np
import ufl

from variform import forms, meshes
from variform.forms import energies
from variform.forms.solving.linear import presets as linear

from .record import Table, insert, markdown

COMM = MPI.COMM_WORLD
# Size, cells along it for one across, and how far its end is turned [rad].
BODIES = {"bar": ((1.0, 0.2, 0.2), 5, 0.3), "cube": ((1.0, 1.0, 1.0), 1, 0.45)}
# Cells across.
SIZES = {
    "P1": {"bar": (12, 18)},
    "P2": {"bar": (6, 10)},
    "Q2": {"bar": (6, 10)},
    "P2-P1": {"bar": (4, 6, 8), "cube": (10, 14)},
    "Q2-Q1": {"bar": (4, 6, 8), "cube": (10, 14)},
}
MOST_DIRECT = 80_000  # degrees of freedom; MUMPS above would want many GB


def twisted(body, element, n):
    """Unknown, load factor, potential and supports; incompressible where the element is mixed."""
    cells = "hexahedron" if element[0] == "Q" else "tetrahedron"
    size, along, _ = BODIES[body]
    body = meshes.block(COMM, size, n=(along * n, n, n), cells=cells)
    t = forms.load_factor(body)
    if "-" in element:
        w = forms.displacement_pressure(body)
        u, p = ufl.split(w)
        F = forms.deformation_gradient(u)
        psi = energies.with_pressure(energies.isochoric_neo_hookean(F, 1.0), F, p)
    else:
        w = forms.displacement(body, int(element[1]))
        psi = energies.neo_hookean(forms.deformation_gradient(w), 1.0, 1.5)
    held = [forms.clamp(w, body.facets("left"))]
    held += [forms.rotate(w, body.facets("right"), angle=t, axis=(1, 0, 0))]
    return w, t, psi * ufl.dx, held


def preset(element, direct):
    """Options of the linear solver, whatever the size."""
    if direct:
        return linear.direct(symmetric=True)
    return linear.field_split() if "-" in element else linear.multigrid(int(element[1]))


def solved(body, element, n):
    """One tangent solve at rest: iterations, and seconds of assembly, set-up and solve."""
    w, _, potential, held = twisted(body, element, n)
    system = forms.Problem(potential, w, held)
    newton = forms.solving.Newton(system, options={"ksp_rtol": 1e-8})
    start = time.process_time()
    newton.tangent.scaled.measure()
    assembled = time.process_time()
    newton.tangent.assemble()
    ksp = newton.snes.getKSP()
    ksp.setOperators(newton.tangent.A)
    b, x = newton.runs.b.duplicate(), newton.runs.b.duplicate()
    b.array[:] = np.random.default_rng(COMM.rank).standard_normal(b.getLocalSize())
    b.array[system.constrained] = 0
    ksp.setUp()
    ready = time.process_time()
    ksp.solve(b, x)
    times = {"assembly": assembled - start, "set-up": ready - assembled}
    times["solve"] = time.process_time() - ready
    row = {"dofs": system.size, "iterations": ksp.getIterationNumber()}
    newton.destroy()
    return row | {key: round(value, 2) for key, value in times.items()}


def walked(body, element, n):
    """Two load steps: Newton iterations, linear ones, seconds."""
    w, t, potential, held = twisted(body, element, n)
    start = time.process_time()
    to = BODIES[body][2]
    path = forms.follow(potential, w, held, t, to=to, step=to / 2, progress=False)
    ends = [step.convergence for step in path.steps]
    return {
        "dofs": path.problem.size,
        "Newton": sum(end.iterations for end in ends),
        "iterations": sum(end.linear_iterations for end in ends),
        "seconds": round(time.process_time() - start, 1),
    }


def columns(rows):
    """The table of the page: one line for each body, element and size."""
    lines = {}
    for row in rows:
        line = lines.setdefault((row["body"], row["element"], row["dofs"]), ["", "", ""])
        if row["what"] == "solve":
            line[0] = row["iterations"]
        else:
            column = 1 if row["solver"] == "multigrid" else 2
            line[column] = f"{row['seconds']:.3g} ({row['Newton']})"
    names = ["body", "element", "unknowns", "iterations", "multigrid, seconds", "MUMPS, seconds"]
    found = [[body, kind, f"{dofs:,}", *line] for (body, kind, dofs), line in lines.items()]
    return markdown(names, found)


def main(elements=(), small=False, write=False):
    """Measure, print and write the table."""
    table, chosen = Table("multigrid", COMM.rank == 0), linear.preset
    for element in elements or SIZES:
        for body, sizes in SIZES[element].items():
            for n in (2,) if small else sizes:
                size = 0
                for direct in (False, True):
                    if direct and size > MOST_DIRECT:
                        continue
                    linear.preset = lambda *given, e=element, d=direct: preset(e, d)
                    solver = "MUMPS" if direct else "multigrid"
                    found = [] if direct else [{"what": "solve", **solved(body, element, n)}]
                    found.append({"what": "twist", **walked(body, element, n)})
                    size = found[-1]["dofs"]
                    for row in found:
                        table.add(body=body, element=element, solver=solver, **row, ranks=COMM.size)
    linear.preset = chosen
    table.write()
    if write and COMM.rank == 0:
        insert("multigrid", columns(table.rows))
    return table.rows


if __name__ == "__main__":
    names = [word for word in sys.argv[1:] if word in SIZES]
    main(names, small="--small" in sys.argv, write="--write" in sys.argv)
