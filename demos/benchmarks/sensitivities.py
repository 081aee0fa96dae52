# SPDX-License-Identifier: MIT
"""What a gradient costs beside the solve that it is the gradient of, by the adjoint.

Run ``docker/enter python3 -m demos.benchmarks.sensitivities`` (``--small``: toy sizes; ``--write``
puts the table into README.md); one JSON line per row, and ``results/sensitivities.csv``. Forward is
a whole path, or one solve, compiled before; backward is ``forms.gradient`` of a reaction by all
parameters, compiled before, its adjoint system by multigrid to an error of 3e-5 in energy and by
factors to 1e-10. CPU seconds, medians of three. The plate is torch-fem's published one.
"""

import resource
import sys
import time

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem, mesh

from variform import forms, meshes

from .peers import stretched
from .record import Table, insert, markdown

COMM = MPI.COMM_WORLD
REPEATS = 3


def moduli(body):
    """A modulus that varies from cell to cell."""
    mu = fem.Function(fem.functionspace(body.mesh, ("DG", 0)), name="mu")
    mu.interpolate(lambda x: 1 + 0.3 * np.sin(5 * x[0]))
    return mu


def block(dim, n, degree, steps, mixed=False):
    """A block that is pulled askew, its moduli by cell, in some load steps."""
    body = meshes.block(COMM, (1.0,) * dim, n=(n,) * dim)
    w = forms.displacement_pressure(body) if mixed else forms.displacement(body, degree)
    t, mu, F = forms.load_factor(body), moduli(body), forms.deformation_gradient(w["u"])
    psi = forms.energies.neo_hookean(F, mu, 2 * mu)
    if mixed:
        psi = forms.energies.isochoric_neo_hookean(F, mu)
        psi = forms.energies.with_pressure(psi, F, w["p"], 100.0)
    pull = forms.translate(w, body.facets("right"), (0.2 * t,) + (0.05 * t,) * (dim - 1))
    problem = forms.Problem(psi * ufl.dx, w, [forms.clamp(w, body.facets("left")), pull])
    loads = [k / steps for k in range(1, steps + 1)]
    return problem, t, loads, forms.Reaction(body.facets("right")), mu


def box(n):
    """A plate of 4 x n x n cubic cells pulled to ten times its thickness, as torch-fem's."""
    thick = 4 / n
    body = meshes.block(COMM, (thick, 1.0, 1.0), n=(4, n, n), cells="hexahedron")
    u, t = forms.displacement(body), forms.load_factor(body)
    moduli = [fem.Constant(body.mesh, value) for value in (stretched.MU, stretched.LMBDA)]
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), *moduli)
    held = [forms.roller(u, body.facets("left"), 0)]
    pull = (stretched.STRETCH - 1) * thick
    held.append(forms.translate(u, body.facets("right"), (pull * t, None, None)))
    for axis in (1, 2):
        middle = mesh.locate_entities(body.mesh, 2, lambda x, k=axis: np.isclose(x[k], 0.5))
        held.append(forms.roller(u, middle, axis))
    problem = forms.Problem(psi * ufl.dx, u, held)
    return problem, t, stretched.factors(), forms.Reaction(body.facets("right")), moduli


SCENES = {
    "plate, 2 Lamé constants, Q1, 10 steps": (box, 64, 4),
    "square, P2, 5 steps": (lambda n: block(2, n, 2, 5), 80, 4),
    "cube, P2-P1, 5 steps": (lambda n: block(3, n, 2, 5, mixed=True), 6, 2),
    "cube, P2, 5 steps": (lambda n: block(3, n, 2, 5), 14, 3),
    "cube, P1, 1 step": (lambda n: block(3, n, 1, 1), 55, 4),
}


def measured(make, n):
    """CPU seconds forward and backward, and memory."""
    problem, t, loads, force, parameters = make(n)

    def forward():
        t.value = problem.u.x.array[:] = 0.0
        if len(loads) > 1:
            return forms.follow(problem, t=t, to=loads, step=loads[0], progress=False)
        t.value = loads[0]
        return forms.solve(problem)

    path, times, memory = forward(), [], 0
    for _ in range(REPEATS):
        start = time.process_time()
        path = forward()
        middle = time.process_time()
        memory = memory or resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        forms.gradient(path, force, parameters)  # the first time it is compiled
        again = time.process_time()
        found = forms.gradient(path, force, parameters)
        times.append((middle - start, time.process_time() - again))
    front, back = np.median(times, axis=0)
    found = found if isinstance(found, list) else [found]
    more = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / memory - 1
    count = sum(getattr(g, "x", None) is None or g.x.array.size for g in found)
    return {
        "unknowns": problem.size,
        "parameters": int(count),
        "forward": round(float(front), 2),
        "backward": round(float(back), 3),
        "ratio": round(float(back / front), 3),
        "more memory": round(more, 3),
    }


def main(small=False, write=False):
    """Measure, print and write the table."""
    table = Table("sensitivities", COMM.rank == 0)
    for name, (make, n, toy) in SCENES.items():
        table.add(scene=name, **measured(make, toy if small else n))
    table.write()
    if write and COMM.rank == 0:
        columns = "scene", "unknowns", "parameters", "forward, s", "backward, s", "ratio", "memory"
        rows = [[f"{v:,}" if isinstance(v, int) else v for v in row.values()] for row in table.rows]
        rows = [[*row[:-1], f"+{row[-1]:.0%}"] for row in rows]
        insert("sensitivities", markdown(columns, rows))
    return table.rows


if __name__ == "__main__":
    main("--small" in sys.argv, "--write" in sys.argv)
