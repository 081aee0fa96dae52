# SPDX-License-Identifier: MIT
"""Tangents and products from moduli at the points, against FFCx's kernels and the assembled matrix.

Run ``docker/enter python3 -m demos.benchmarks.moduli``; one JSON line per row, and
``results/moduli.csv``. First single products and tangents, then whole paths of the block that
peers/README.md describes, with moduli and without. CPU time, interleaved in one process, medians.
"""

import sys
import time
from unittest import mock

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc

from variform import forms, meshes
from variform.forms import energies
from variform.forms.compilation import compiled
from variform.forms.terms import FormTerm

from .peers.fenicsx import create
from .peers.problem import LMBDA, MU, STEPS, STRETCH, TWIST
from .record import Table, median_times

# Cells along an edge of a cube, or of the block across, for about 10 to 80 thousand cells.
KERNELS = {("P", 1): 24, ("P", 2): 12, ("P", 3): 8, ("Q", 1): 20, ("Q", 2): 10}
PATHS = {(1, 15): 3, (2, 8): 3, (3, 4): 3, (1, 23): 1, (2, 11): 1}
ENERGIES = {
    "neo_hookean": lambda F: energies.neo_hookean(F, MU, LMBDA),
    "mooney_rivlin": lambda F: energies.mooney_rivlin(F, 0.3, 0.2) + 5 * (ufl.det(F) - 1) ** 2,
    "fixed_corotated": lambda F: energies.fixed_corotated(F, MU, LMBDA),
}


def kernels(kind, degree, n, energy):
    """Cells, deviations from FFCx's numbers, and the ways to a product and to a tangent."""
    cell = {"P": "tetrahedron", "Q": "hexahedron"}[kind]
    body = meshes.block(MPI.COMM_SELF, (1.0, 1.0, 1.0), n=(n, n, n), cells=cell)
    u = forms.displacement(body, degree)
    u.interpolate(lambda x: 0.1 * np.stack([x[0] * x[1], np.sin(3 * x[0]), x[0] * x[2]]))
    psi = ENERGIES[energy](forms.deformation_gradient(u))
    plain, by_moduli = (forms.Problem(psi * ufl.dx, u) for _ in range(2))
    by_moduli.forms.use_moduli()
    moduli, x = by_moduli.forms.moduli, fem.Function(u.function_space)
    x.x.array[:] = np.random.default_rng(0).standard_normal(len(x.x.array))
    action = compiled(ufl.action(plain.forms.tangent_ufl, x))
    A, B = plain.create_matrix(), by_moduli.create_matrix()
    y, kept = plain.create_vector(), np.zeros_like(x.x.array)

    def without():
        y.array[:] = 0
        fem_petsc.assemble_vector(y, action)

    def from_moduli():
        kept[:] = 0
        moduli.multiply(x.x.array, kept)

    ways = {
        "product: matrix": lambda: A.mult(x.x.petsc_vec, y),
        "product: FFCx's action": without,
        "product: moduli": from_moduli,
        "moduli computed": moduli.fill,
        "tangent: FFCx's kernel": lambda: plain.tangent(A),
        "tangent: moduli": lambda: by_moduli.tangent(B),
    }
    moduli.fill()
    for way in ways.values():
        way()
    without()
    off = np.abs(kept - y.array_r).max() / np.abs(kept).max()
    difference = B.copy()  # a sum would take B's places
    difference.axpy(-1, A)
    return body.mesh.topology.index_map(3).size_local, (off, difference.norm() / A.norm()), ways


def path(degree, m, steps, energy, moduli):
    """CPU seconds of a path, Newton's and linear iterations, and where it ends."""
    body, left, right = create(m)
    t = forms.load_factor(body)
    u = forms.displacement(body, degree)
    psi = ENERGIES[energy](forms.deformation_gradient(u))
    twist = forms.rotate(u, right, angle=TWIST * t, axis=(1, 0, 0), shift=(STRETCH * t, 0, 0))
    problem = forms.Problem(psi * ufl.dx, u, [forms.clamp(u, left), twist])
    usual = FormTerm.use_moduli if moduli else lambda self: None
    each = 1 / STEPS
    with mock.patch.object(FormTerm, "use_moduli", usual):
        start = time.process_time()
        made = forms.follow(
            problem, t=t, to=steps / STEPS, step=each, max_step=each, progress=False
        )
        seconds = time.process_time() - start
    counts = [(s.convergence.iterations, s.convergence.linear_iterations) for s in made.steps]
    problem.destroy()
    return seconds, counts, u.x.array.copy()


def main(small=False):
    """Measure, print and write the table."""
    table = Table("moduli")
    for (kind, degree), n in KERNELS.items():
        for energy in ENERGIES:
            cells, off, ways = kernels(kind, degree, 2 if small else n, energy)
            times = median_times(ways, 1 if small else 7)
            row = {way: round(1e6 * t / cells, 3) for way, t in times.items()}
            product = times["product: moduli"] / times["product: matrix"]
            tangent = times["tangent: moduli"] / times["tangent: FFCx's kernel"]
            table.add(
                element=f"{kind}{degree}",
                energy=energy,
                cells=cells,
                **row,
                product=round(product, 3),
                tangent=round(tangent, 3),
                deviation=float(f"{max(off):.1e}"),
            )
    for (degree, m), steps in ({(2, 4): 1} if small else PATHS).items():
        for energy in ("neo_hookean", "fixed_corotated"):
            found = {False: [], True: []}
            for turn in range(1 if small else 4):
                for moduli, runs in found.items():
                    run = path(degree, m, steps, energy, moduli)
                    if small or turn:  # the first compiles
                        runs.append(run)
            before, after = (np.median([run[0] for run in runs]) for runs in found.values())
            (_, old, start), (_, new, end) = found[False][-1], found[True][-1]
            table.add(
                element=f"P{degree}",
                energy=energy,
                unknowns=len(end),
                steps=steps,
                seconds=round(before, 2),
                by_moduli=round(after, 2),
                path=round(after / before, 3),
                iterations=[i for i, _ in new],
                same=[i for i, _ in old] == [i for i, _ in new],
                linear=[sum(i for _, i in counts) for counts in (old, new)],
                deviation=float(f"{np.abs(end - start).max() / np.abs(end).max():.1e}"),
            )
    table.write()


if __name__ == "__main__":
    main(small="--small" in sys.argv)
