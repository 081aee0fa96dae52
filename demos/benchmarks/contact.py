# SPDX-License-Identifier: MIT
"""Contact with obstacles: Hertz's errors over dhat, cells and degree; what a barrier costs.

A parabola of radius R = 1, linear elastic, nu = 0.3, pressed on a plane to a / R = 0.05, in plane
strain (a cylinder) and as a body of revolution (a sphere); 20 a wide and high, cells of a / 10 to
a / 40 at the contact, larger away from it. Half-width by the second moment of the projected
pressure, peak of that pressure, each against Hertz at the measured force. The same of a cylinder on
another, as surfaces, and of a sphere in space. Then the time of a step with an obstacle, and with
10,816 triangles of surfaces, that nothing touches over one without, and what multigrid and MUMPS
make of a ball pressed into a block. Run ``docker/enter python3 -m demos.benchmarks.contact``
(``--small``: toy sizes); one JSON line per row, ``results/contact.csv`` and ``results/contact.png``
and ``.svg``; ``--write`` puts the tables into README.md. One process only.
"""

import sys
import time

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem
from matplotlib.figure import Figure

from variform import forms, meshes
from variform.forms import contact, obstacles
from variform.forms.solving.settings import Settings

from .hertz import NU, STIFF, A, E, R, graded, in_space, known, parabola, width
from .record import Table, insert, markdown, median_times, save

SIZES = {1: (10, 20, 40), 2: (10, 20)}
REACHES = (0.4, 0.2, 0.1, 0.05, 0.025)  # dhat over h


def hertz(kind, degree, per, reach, stiffness=None):
    """A row: errors of half-width and peak, steps, iterations, CPU time."""
    start = time.process_time()
    path, body = parabola(kind, degree, per, reach, stiffness)
    seconds = time.process_time() - start
    p = contact.pressure(path)
    a, peak = known(kind, -contact.force(path)[1])
    return {
        "body": kind,
        "element": f"Q{degree}",
        "a/h": per,
        "dhat/h": reach,
        "dofs": path.problem.size,
        "width": float(f"{width(kind, p, body) / a - 1:.3g}"),
        "peak": float(f"{p.x.array.max() / peak - 1:.3g}"),
        "steps": len(path.steps),
        "tangents": path.tangents,
        "seconds": round(seconds, 2),
    }


def rows(x, y, sign, start):
    """Points of a graded quarter of a cylinder, parabola at y = 0, and quadrilaterals of them."""
    X, depth = np.meshgrid(x, y, indexing="ij")
    points = np.stack([X, sign * (depth + X**2 / (2 * R) * (1 - depth / y[-1]))], axis=-1)
    n = np.arange(X.size).reshape(X.shape) + start
    corners = n[:-1, :-1], n[1:, :-1], n[1:, 1:], n[:-1, 1:]
    order = corners if sign > 0 else corners[::-1]
    cells = np.stack([each.ravel() for each in order], axis=1)
    return points.reshape(-1, 2), cells, n


def cylinders(per, reach, degree=1, more=1.3):
    """A row: cylinder on cylinder, of equal radii and other meshes, as surfaces."""
    h, meshed, names, start = A / per, [], {}, 0
    for name, sign, size in (("upper", 1, h), ("lower", -1, h / more)):
        x, y = graded(size, 2 * A, 20 * A), graded(size, A, 20 * A)
        points, cells, n = rows(x, y, sign, start)
        meshed.append((points, cells))
        names |= {name: n[:, 0], f"{name} end": n[:, -1]}
        names["middle"] = np.r_[names.get("middle", np.empty(0, int)), n[0]]
        start += n.size
    dhat = reach * h / more
    meshed[0][0][:, 1] += dhat
    points, cells = (np.concatenate(parts) for parts in zip(*meshed, strict=True))
    body = meshes.from_arrays(MPI.COMM_SELF, points, cells, cell="quadrilateral", boundaries=names)
    u, t = forms.displacement(body, degree), forms.load_factor(body)
    e = ufl.sym(forms.deformation_gradient(u)) - ufl.Identity(3)
    psi = E / (2 * (1 + NU)) * (ufl.inner(e, e) + NU / (1 - 2 * NU) * ufl.tr(e) ** 2)
    term = forms.touching(u, body.ds("upper", "lower"), stiffness=0.2 * E, dhat=dhat)
    held = [
        forms.roller(u, body.facets("middle"), 0),
        forms.roller(u, body.facets("lower end"), 1),
        forms.translate(u, body.facets("upper end"), (None, -0.009 * t)),
    ]
    start = time.process_time()
    path = forms.follow([psi * ufl.dx, term], u, held, t, progress=False)
    seconds = time.process_time() - start
    p, P = contact.pressure(path), -contact.force(path, body.facets("upper"))[1]
    a = np.sqrt(8 * P * R / (np.pi * STIFF))
    found = {"body": "two cylinders", "element": f"Q{degree}", "a/h": per, "dhat/h": reach}
    found["dofs"] = path.problem.size
    x = ufl.SpatialCoordinate(body.mesh)[0]
    for name in ("upper", "lower"):
        ds = body.ds(name, degree=6)
        second = forms.integral(p * x**2 * ds) / forms.integral(p * ds)
        there = fem.locate_dofs_topological(p.function_space, 1, body.facets(name))
        found[f"width, {name}"] = float(f"{np.sqrt(4 * second) / a - 1:.3g}")
        found[f"peak, {name}"] = float(f"{p.x.array[there].max() / (4 * P / (np.pi * a)) - 1:.3g}")
    return {
        **found,
        "a/R": float(f"{a / R:.3g}"),
        "steps": len(path.steps),
        "tangents": path.tangents,
        "seconds": round(seconds, 2),
    }


def block(n, degree=1, ball=None, load=0.05, surfaces=False):
    """A block pulled at its top beside an obstacle, or lifted to a ball; a problem of it."""
    body = meshes.block(MPI.COMM_SELF, (1.0, 1.0, 1.0), n=n, cells="tetrahedron")
    u = forms.displacement(body, degree)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0)
    potential = psi * ufl.dx + forms.dead_traction(u, (0, 0, load), body.ds("top"))
    if ball is not None:
        tool = obstacles.sphere((0.5, 0.5, 1.5 + ball), 0.5)
        potential += forms.obstacle(u, tool, body.ds("top"), name="ball")
    terms = [forms.touching(u, body.ds("top", "bottom"), stiffness=0.1, parts=2)] * surfaces
    return forms.Problem([potential, *terms], u, [forms.clamp(u, body.facets("bottom"))])


def overhead(n, repeats=5):
    """A row: CPU time of a solve without contact, and with an obstacle or surfaces far apart."""
    problems = {
        "without": block(n),
        "obstacle": block(n, ball=0.5),
        "surfaces": block(n, surfaces=True),
    }

    def solves(problem):
        problem.u.x.array[:] = 0
        forms.solve(problem)

    for problem in problems.values():
        solves(problem)
    times = median_times({k: lambda p=p: solves(p) for k, p in problems.items()}, repeats)
    ratios = {
        f"ratio, {name}": float(f"{times[name] / times['without']:.4g}")
        for name in ("obstacle", "surfaces")
    }
    faces = len(problems["surfaces"].terms[1].surface.faces)
    size = problems["without"].size
    return {"what": "overhead", "dofs": size, "triangles": faces, **times, **ratios}


def presets(n, degree):
    """Rows: iterations and time of a ball pressed on, and of the same load without it."""
    settings = {
        "multigrid": Settings(direct_up_to=0, factorized_up_to=0),
        "MUMPS": Settings(direct_up_to=10**9),
    }
    for solver, chosen in settings.items():
        for ball in (None, 0.02):
            problem = block(n, degree, ball, load=0.6)
            forms.solve(problem, settings=chosen)  # compiles, too
            problem.u.x.array[:] = 0
            start = time.process_time()
            path = forms.solve(problem, settings=chosen)
            seconds, outcome = time.process_time() - start, path.steps[0].convergence
            yield {
                "what": "presets",
                "element": f"P{degree}",
                "dofs": problem.size,
                "solver": solver,
                "contact": ball is not None,
                "newton": outcome.iterations,
                "linear": outcome.linear_iterations,
                "tried": ", ".join(outcome.tried),
                "seconds": round(seconds, 2),
            }
            problem.destroy()


def picture(rows):
    """Errors of the half-width over dhat / h, a panel for each body, and over the CPU time."""
    figure = Figure((11, 4), 150, layout="constrained")
    panels = figure.subplots(1, 3)
    styles = {1: "o-", 2: "s--"}
    for axes, kind in zip(panels, ("cylinder", "sphere"), strict=False):
        for degree, sizes in SIZES.items():
            for n, per in enumerate(sizes):
                chosen = [
                    r
                    for r in rows
                    if (r["body"], r["element"], r["a/h"]) == (kind, f"Q{degree}", per)
                ]
                if chosen:
                    x = [r["dhat/h"] for r in chosen]
                    label = f"Q{degree}, a/h = {per}"
                    axes.loglog(
                        x,
                        [abs(r["width"]) for r in chosen],
                        styles[degree],
                        color=f"C{n}",
                        label=label,
                    )
        axes.axhline(0.01, color="0.7", lw=1)
        axes.set(title=f"half-width, {kind}", xlabel="dhat / h", ylabel="relative error")
    for n, kind in enumerate(("cylinder", "sphere")):
        chosen = [r for r in rows if r["body"] == kind]
        x, y = [r["seconds"] for r in chosen], [abs(r["peak"]) for r in chosen]
        panels[2].loglog(x, y, "ox"[n], color=f"C{n}", label=kind)
    panels[2].set(title="peak of the pressure", xlabel="CPU time [s]")
    for axes in panels:
        axes.grid(alpha=0.3)
        axes.legend(fontsize=7)
    save(figure, "contact")


def tables(rows):
    """Errors in percent by dhat / h; what a barrier costs."""
    found = [r for r in rows if "width" in r and "a/R" not in r]
    kinds = list(dict.fromkeys((r["body"], r["element"], r["a/h"], r["dofs"]) for r in found))
    reaches = list(dict.fromkeys(r["dhat/h"] for r in found))
    lines = []
    for kind in kinds:
        mine = [r for r in found if (r["body"], r["element"], r["a/h"], r["dofs"]) == kind]
        cells = [
            f"{100 * r['width']:+.2f}, {100 * r['peak']:+.2f}, {r['seconds']:.1f} s" for r in mine
        ]
        lines.append([*kind[:3], f"{kind[3]:,}", *cells])
    head = ["body", "element", "a/h", "dofs", *(f"dhat/h = {reach}" for reach in reaches)]
    table = markdown(head, lines)
    costs = [r for r in rows if r.get("what") == "presets"]
    lines = [
        [
            f"{r['element']}, {r['dofs']:,}",
            r["solver"],
            "a ball pressed on" if r["contact"] else "none",
            r["newton"],
            r["linear"],
            f"{r['seconds']:.1f} s",
        ]
        for r in costs
    ]
    head = ["element, dofs", "solver", "contact", "Newton", "linear", "CPU time"]
    return [*table, "", *markdown(head, lines)]


def surfaces(measurements, small=False):
    """Rows of surfaces, of a sphere in space, and of contact that nothing touches; their table."""
    for per in (5,) if small else (10, 20):
        for reach in (0.1,) if small else (0.4, 0.1):
            measurements.add(**cylinders(per, reach))
    for reach in (0.2,) if small else (0.1, 0.05):
        measurements.add(**in_space(4 if small else 21, reach))
    measurements.add(**overhead(4 if small else 26))
    lines = []
    for r in measurements.rows:
        for side in (", upper", ", lower", ""):
            if f"width{side}" in r and "a/R" in r:
                errors = [f"{100 * r[f'{what}{side}']:+.2f}" for what in ("width", "peak")]
                counts = f"{r['dofs']:,}", r["steps"], r["tangents"], f"{r['seconds']:.1f} s"
                lines.append([r["body"] + side, r["a/h"], r["dhat/h"], *errors, *counts])
    head = ["body", "a/h", "dhat/h", "half-width [%]", "peak [%]", "dofs", "steps", "tangents"]
    return markdown([*head, "CPU time"], lines)


def main(small=False, write=False):
    """Measure, print and write the tables and the picture."""
    measurements = Table("contact")
    between = surfaces(measurements, small)
    if write:
        insert("contact of surfaces", between)
    for kind in ("cylinder", "sphere"):
        for degree, sizes in SIZES.items():
            for per in (5,) if small else sizes:
                for reach in (0.4, 0.1) if small else REACHES:
                    measurements.add(**hertz(kind, degree, per, reach))
    picture([r for r in measurements.rows if "width" in r and "a/R" not in r])
    for degree, n in ((1, 4), (2, 3)) if small else ((1, 26), (2, 13)):
        for row in presets(n, degree):
            measurements.add(**row)
    measurements.write()
    if write:
        insert("contact", tables(measurements.rows))
    return measurements.rows


if __name__ == "__main__":
    main(small="--small" in sys.argv, write="--write" in sys.argv)
