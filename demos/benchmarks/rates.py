# SPDX-License-Identifier: MIT
"""Rates of every element and kind of energy: a step, its pieces, and how far the machine would go.

Run ``docker/enter python3 -m demos.benchmarks.rates`` (``--small``: toy sizes; ``--write`` puts the
tables into README.md); one JSON line per row, and ``results/rates.csv``. Each row is measured in a
process of its own, so that its memory is its own; CPU seconds, medians.

A step: the block 1 x 0.2 x 0.2, clamped at one end, the other turned by 20 degrees and pulled by
1/30, by ``forms.follow`` with its presets, compiled before. A product is that of the step's Krylov
method: by the assembled matrix for degree 1, by the moduli at the points from degree 2 on.

The limits are a roofline's: bytes that have to move at least once, over the bandwidth of a vector
update, or operations, over those of a product of two matrices by BLAS, whichever takes longer.
Operations are counted in FFCx's trees of the same forms and in the loops of kernels/moduli.h (a
function such as ln counts as one); what energies in singular values do at a point is not counted.
"""

import json
import resource
import subprocess
import sys
import time

from mpi4py import MPI
from petsc4py import PETSc

import basix
import ffcx.codegeneration.lnodes as tree
import ffcx.options
import numpy as np
import ufl
from ffcx.analysis import analyze_ufl_objects
from ffcx.codegeneration.backend import FFCXBackend
from ffcx.codegeneration.integral_generator import IntegralGenerator
from ffcx.ir.representation import compute_ir
from ufl.algorithms import expand_derivatives

from variform import forms, meshes
from variform.forms import energies
from variform.forms.differentiation import dependents, expanded
from variform.forms.entities import with_owned_entities
from variform.forms.native import canonical
from variform.forms.quadrature import with_quadrature
from variform.forms.splitting import form_of_moduli, split

from .peers.problem import LMBDA, MU, STEPS, STRETCH, TWIST
from .record import Table, insert, machine, markdown, median_times

# Cells across the block: some 30 to 60 thousand unknowns.
ELEMENTS = {"P1": 14, "P2": 7, "P3": 4, "Q1": 13, "Q2": 6, "P2-P1": 7}
ENERGIES = {
    "neo-Hookean": lambda F: energies.neo_hookean(F, MU, LMBDA),
    "Mooney-Rivlin": lambda F: energies.mooney_rivlin(F, 0.3, 0.2) + energies.volumetric(F, 1.8),
    "Guccione": lambda F: (
        energies.guccione(F, 1.0, 4.0, 1.0, 2.0, ufl.as_vector([1, 0, 0]))
        + energies.volumetric(F, 1.8)
    ),
    "fixed corotated": lambda F: energies.fixed_corotated(F, MU, LMBDA),
}
REPEATS = 7
PIECES = "energy", "residual", "tangent", "product"
ROWS, HALF = 9, 45  # of a gradient, and the upper triangle of moduli


def scene(element, energy, m):
    """Problem and load factor."""
    cells = "hexahedron" if element[0] == "Q" else "tetrahedron"
    body = meshes.block(MPI.COMM_SELF, (1.0, 0.2, 0.2), n=(5 * m, m, m), cells=cells)
    mixed = "-" in element
    w = forms.displacement_pressure(body) if mixed else forms.displacement(body, int(element[1]))
    u, t = w["u"], forms.load_factor(body)
    F = forms.deformation_gradient(u)
    psi = ENERGIES[energy](F)
    if mixed:
        psi = energies.with_pressure(energies.isochoric_neo_hookean(F, MU), F, w["p"], 100 * MU)
    turn = {"angle": TWIST / STEPS * t, "axis": (1, 0, 0), "shift": (STRETCH / STEPS * t, 0, 0)}
    held = [forms.clamp(w, body.facets("left")), forms.rotate(w, body.facets("right"), **turn)]
    return forms.Problem(psi * ufl.dx, w, held), t


def peak():
    """Peak memory of this process, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def operations(form):
    """Floating-point operations of a form's kernel for one cell; None with singular values."""
    form = with_quadrature(with_owned_entities(expand_derivatives(expanded(form))))
    if dependents(form):
        return None
    options = ffcx.options.get_options({"scalar_type": np.float64})
    written = canonical.canonical(form)
    ir = compute_ir(analyze_ufl_objects([written], np.float64), {}, "rates", options, False)
    made = [IntegralGenerator(i, FFCXBackend(i, options)).generate() for i in ir.integrals]
    return sum(map(count, made))


def count(node):
    """Operations of a part of FFCx's tree."""
    if isinstance(node, list | tuple):
        return sum(map(count, node))
    if not isinstance(node, tree.LNode) or isinstance(node, tree.ArrayAccess | tree.MultiIndex):
        return 0
    inner = sum(count(value) for name, value in vars(node).items() if name not in ("lhs", "index"))
    if isinstance(node, tree.ForRange):
        return (int(node.end.value) - int(node.begin.value)) * count(node.body)
    if isinstance(node, tree.AssignOp):
        return inner + (not isinstance(node, tree.Assign))
    if isinstance(node, tree.NaryOp):
        return inner + len(node.args) - 1
    if isinstance(node, tree.BinOp):
        return inner + count(node.lhs) + 1
    return inner + isinstance(node, tree.MathFunction | tree.Conditional | tree.Neg)


def of_moduli(tangent):
    """Points of a tangent's rule, and operations of the kernel of its moduli; None if uncounted."""
    (((derivatives, degree), own),) = split(tangent)[0].items()
    mesh = tangent.arguments()[0].ufl_function_space().mesh
    points = basix.make_quadrature(mesh.basix_cell(), degree)[1].size
    if dependents(tangent):
        return points, None
    return points, operations(form_of_moduli(own, tangent, derivatives, degree))


def limits(problem, stored):
    """Bytes and operations of each piece, of all cells together; None where not counted."""
    V, mesh = problem.u.function_space, problem.u.function_space.mesh
    cells = mesh.topology.index_map(3).size_local
    nodes, corners = V.dofmap.list.shape[1], mesh.geometry.dofmap.shape[1]
    given = 4 * cells * (nodes + corners) + 24 * len(mesh.geometry.x) + 8 * problem.size
    form = problem.forms
    energy, residual = map(operations, (form.potential, form.residual_ufl))
    found = {"energy": (given, energy), "residual": (given + 16 * problem.size, residual)}
    found["tangent"] = given + 24 * stored, None
    found["product"] = 12 * stored + 20 * problem.size, 2 * stored / cells
    if form.moduli is not None:
        (points, kernel), blocks = of_moduli(form.tangent_ufl), nodes * (nodes + 1) // 2
        loops = points * (nodes * ROWS * 18 + blocks * 54)
        found["tangent"] = given + 24 * stored, None if kernel is None else kernel + loops
        if problem.displacement_degree > 1:
            moved = cells * (8 * HALF * points + 4 * nodes) + 32 * problem.size
            found["product"] = moved, points * (4 * 9 * nodes + 2 * ROWS**2)
    return {k: (b, None if f is None else f * cells) for k, (b, f) in found.items()}


def row(element, energy, m):
    """One row, in this process."""
    before = peak()
    problem, t = scene(element, energy, m)
    size, cells = problem.size, problem.u.function_space.mesh.topology.index_map(3).size_local

    def step():
        t.value = problem.u.x.array[:] = 0.0
        return forms.follow(problem, t=t, to=1.0, step=1.0, max_step=1.0, progress=False)

    step()  # compiles
    memory, seconds, counts = peak() - before, [], None
    for _ in range(1 if m < 3 else 3):
        start = time.process_time()
        path = step()
        seconds.append(time.process_time() - start)
        counts = [s.convergence for s in path.steps]
    newton = sum(c.iterations for c in counts)
    A, b = problem.create_matrix(), problem.create_vector()
    x, y = problem.create_vector(), problem.create_vector()
    x.array[:] = np.cos(np.arange(size))
    problem.tangent(A)
    work = {
        "energy": problem.energy,
        "residual": lambda: problem.residual(b),
        "tangent": lambda: problem.tangent(A),
        "product": lambda: A.mult(x, y),
    }
    moduli = problem.forms.moduli
    if moduli is not None and problem.displacement_degree > 1:
        moduli.fill()
        given, kept = x.array_r.copy(), np.zeros(size)
        work["product"] = lambda: moduli.multiply(given, kept)
    times = median_times(work, 1 if m < 3 else REPEATS)
    stored = int(A.getInfo()["nz_used"])
    made = {
        "element": element,
        "law": energy,
        "unknowns": size,
        "cells": cells,
        "step": 1e6 * float(np.median(seconds)) / size / newton,
        "Newton": newton,
        "linear": sum(c.linear_iterations for c in counts),
        "memory": 1e3 * memory / size,
    }
    for name, (moved, done) in limits(problem, stored).items():
        made[name] = times[name] / size * 1e6
        made[f"{name}: bytes"], made[f"{name}: operations"] = moved / size, done and done / size
    return made


def roof():
    """Bandwidth of y += a x in B/s, and operations of a product of matrices by BLAS in 1/s."""
    x, y = (PETSc.Vec().createSeq(5_000_000) for _ in range(2))
    A = np.ones((1000, 1000))
    best = [np.inf, np.inf]
    for _ in range(10):
        for k, work in enumerate((lambda: y.axpy(0.5, x), lambda: A @ A)):
            start = time.perf_counter()
            work()
            best[k] = min(best[k], time.perf_counter() - start)
    return 24 * 5e6 / best[0], 2e9 / best[1]


def pages(rows, bandwidth, flops):
    """The two tables: rates, and the roofline beside each."""
    columns = ("element, energy", "unknowns", "step, µs", "Newton, CG", "kB per unknown", *PIECES)
    first, second = [], []
    for r in rows:
        name = f"{r['element']} {r['law']}"
        speeds = [f"{1 / r[p]:.3g}" for p in PIECES]
        counts = f"{r['Newton']}, {r['linear']}"
        kept = f"{r['memory']:.2f}"
        first.append((name, f"{r['unknowns']:,}", f"{r['step']:.3g}", counts, kept, *speeds))
        parts = []
        for p in PIECES:
            moved, done = r[f"{p}: bytes"], r[f"{p}: operations"]
            limit = max(moved / bandwidth, (done or 0) / flops) * 1e6
            bound = "B" if done is None or moved / bandwidth > done / flops else "F"
            work = "not counted" if done is None else f"{done:,.0f}"
            share = "" if done is None else f": {limit / r[p]:.0%} {bound}"
            parts.append(f"{moved:,.0f} B, {work}{share}")
        second.append((name, *parts))
    return [*markdown(columns, first), "", *markdown(("element, energy", *PIECES), second)]


def main(small=False, write=False):
    """Measure each row in a process of its own, print and write the tables."""
    table = Table("rates")
    for element, m in ELEMENTS.items():
        for energy in ENERGIES:
            if "-" in element and energy != "neo-Hookean":
                continue  # with a pressure: the isochoric energy
            words = ["--row", element, energy, str(2 if small else m)]
            command = [sys.executable, "-m", "demos.benchmarks.rates", *words]
            done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
            table.add(**json.loads(done.stdout.splitlines()[-1]))
    bandwidth, flops = roof()
    table.write()
    lines = pages(table.rows, bandwidth, flops)
    about = machine()
    lines += ["", f"One core of {about['processor']}: {bandwidth / 1e9:.1f} GB/s, "]
    lines[-1] += f"{flops / 1e9:.1f} Gflop/s."
    print("\n".join(lines))
    if write:
        insert("rates", lines)


if __name__ == "__main__":
    if "--row" in sys.argv:
        element, energy, m = sys.argv[sys.argv.index("--row") + 1 :][:3]
        print(json.dumps(row(element, energy, int(m)), ensure_ascii=False))
    else:
        main("--small" in sys.argv, "--write" in sys.argv)
