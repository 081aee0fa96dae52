# SPDX-License-Identifier: MIT
"""Work and precision: which model and method for an error of 1 %, and for 0.001 %.

The scenes are those of ``scenes.py``: a smooth one, one with singular edges, a nearly
incompressible one, and three that a plane, axisymmetric or membrane model may stand for. Each is
solved by several elements, solvers, kinds of energy or models on finer and finer meshes
(``comparisons.py``). "error" is relative: against a closed form, or against the limit of a power
law through three meshes of the best element ("uncertain": how far the finest of them is from that
limit); "stress" is the error in the norm of the energy. "seconds" are CPU seconds of matrices,
Newton's method and linear solver, without mesh, degrees of freedom and compiling; medians of three
below a second. Run ``docker/enter python3 -m demos.benchmarks.work_precision`` (``--small``: a few
curves at toy sizes; no operators, no slab, no tube, no choice of the solver); one JSON line per
row, ``results/work_precision.csv``, ``.png`` and ``.svg``, and the same pictures
``results/work_precision_quadrature``; ``--write`` puts the tables into README.md. One process only.
"""

import sys
import time
from functools import cache

import numpy as np
from matplotlib.figure import Figure

from variform import forms
from variform.forms.solving.linear import presets as linear

from .comparisons import (
    PANELS,
    QUADRATURE,
    REFERENCES,
    RULES,
    SCENES,
    SMALL,
    SMALL_REFERENCES,
    Case,
)
from .record import Table, insert, markdown, save

TARGETS = {"1 %": 1e-2, "0.001 %": 1e-5}


def measured(case):
    """Row of one solve, without its error; the preset of the linear solver is put back."""
    degree = {} if case.degree is None else {"degree": case.degree}
    problem = SCENES[case.scene][case.model](case.element, case.n, **degree)
    system = forms.Problem(problem.potential, problem.unknown, problem.supports)
    preset, options = linear.preset, {}
    if case.method == "MUMPS":
        linear.preset = lambda *given: linear.direct(system.symmetric)
    elif case.method != "preset":
        linear.preset = lambda *given: linear.multigrid(int(case.element[1]))
        options = {"ksp_rtol": float(case.method.split()[-1])}
    times = []
    try:
        # The first solve is the one that compiles, and is not counted.
        while len(times) < 2 or (max(times[1:]) < 1 and len(times) < 4):
            problem.unknown.x.array[:] = 0
            start, newton = time.process_time(), forms.solving.Newton(system, options)
            newton.predict()
            outcome = newton.solve()
            newton.destroy()
            times.append(time.process_time() - start)
    finally:
        linear.preset = preset
    return {
        **case._asdict(),
        "dofs": system.size,
        "converged": outcome.converged,
        "Newton": outcome.iterations,
        "linear": outcome.linear_iterations,
        "seconds": float(f"{np.median(times[1:]):.3g}"),
        "value": problem.value(),
        "energy": system.energy(),
        "exact": problem.exact,
    }


def limit(sizes, values):
    """Where values on three meshes tend to, v + C n^-r through them; and the finest one's error."""
    n, (a, b, c) = np.array(sizes, float), values
    rates = np.linspace(0.5, 10, 2000)
    quotients = (n[1] ** -rates - n[0] ** -rates) / (n[2] ** -rates - n[1] ** -rates)
    rate = rates[np.argmin(abs(quotients - (b - a) / (c - b)))]
    rest = (c - b) / (n[1] ** -rate - n[2] ** -rate) * n[2] ** -rate
    return c + rest, abs(rest)


class Measurements:
    """Rows with errors; a case that several comparisons share is measured once."""

    def __init__(self, references):
        self.table = Table("work_precision")
        self.measured, self.references = cache(measured), references
        self.limits = {}

    def reference(self, scene):
        """Limits of value and energy, and the relative uncertainty of the value."""
        if scene not in self.limits:
            model, element, sizes = self.references[scene]
            rows = [self.measured(Case(scene, model, element, n)) for n in sizes]
            value, rest = limit(sizes, [row["value"] for row in rows])
            energy, _ = limit(sizes, [row["energy"] for row in rows])
            self.limits[scene] = value, energy, rest / abs(value)
        return self.limits[scene]

    def add(self, comparison, scene, curve):
        """Measure a curve's cases and keep their rows."""
        for n in curve.sizes:
            case = Case(scene, curve.model, curve.element, n, curve.method, curve.degree)
            row = dict(self.measured(case))
            value, energy, exact = row.pop("value"), row.pop("energy"), row.pop("exact")
            known = (exact, None, 0.0) if exact else self.reference(scene)
            row["error"] = float(f"{abs(value / known[0] - 1):.3g}")
            if scene == "pad":
                row["stress"] = float(f"{abs(energy / known[1] - 1) ** 0.5:.3g}")
            row["uncertain"] = float(f"{known[2]:.1g}")
            self.table.add(comparison=comparison, curve=curve.label, **row)


def cheapest(rows, target, error="error"):
    """The fastest row whose error, and that of all finer ones of its curve, is below a target.

    The finer ones, since an error that changes its sign is small by chance; the finest row of a
    curve is taken at its word.
    """
    found = [
        row
        for row in rows
        if all(
            r["converged"] and r[error] + r["uncertain"] <= target
            for r in rows
            if r["curve"] == row["curve"] and r["dofs"] >= row["dofs"]
        )
    ]
    return min(found, key=lambda row: row["seconds"], default=None)


def choice(rows, target, error):
    """What to take in words, and what the next best curve costs."""
    best = cheapest(rows, target, error)
    if best is None:
        return ["none measured", ""]
    others = [row for row in rows if row["curve"] != best["curve"]]
    second = cheapest(others, target, error)
    said = [f"{r['curve']}: {r['dofs']:,} dofs, {r['seconds']:.2g} s" for r in (best, second) if r]
    return [*said, "none measured"][:2]


def table(rows):
    """For each comparison the cheapest curve and the next best for each target."""
    lines = []
    for name in dict.fromkeys(row["comparison"] for row in rows):
        chosen = [row for row in rows if row["comparison"] == name]
        whats = ("error", "stress") if name == "elements, smooth" else ("error",)
        for what in whats:
            found = [choice(chosen, target, what) for target in TARGETS.values()]
            title = f"{name}: stress" if what == "stress" else name
            lines.append([title, *found[0], *found[1]])
    heads = [head for target in TARGETS for head in (f"for {target} take", "next best")]
    return markdown(["comparison", *heads], lines)


def quadrature_table(rows):
    """Error in percent and seconds on the finest mesh, by the degree of the rule."""
    lines = []
    for name, element in dict.fromkeys((row["comparison"], row["element"]) for row in rows):
        found = [r for r in rows if (r["comparison"], r["element"]) == (name, element)]
        most = max(row["dofs"] for row in found)
        last = {row["curve"]: row for row in found if row["dofs"] == most}
        cells = [last.get(f"{element}, {rule}") for rule in RULES]
        cells = [f"{100 * r['error']:.3g} %, {r['seconds']:.2g} s" if r else "" for r in cells]
        lines.append([name.removeprefix("quadrature, "), element, f"{most:,}", *cells])
    return markdown(["energy", "element", "dofs", *RULES], lines)


def looks(labels):
    """Color by a label's first word, marker and line by the rest: alike ones lie side by side."""
    parts = [label.partition(", ")[::2] for label in labels]
    firsts, rests = (list(dict.fromkeys(part)) for part in zip(*parts, strict=True))
    for first, rest in parts:
        number = rests.index(rest)
        style = {"marker": "os^v"[number], "ls": ("-", "--", ":", "-.")[number]}
        yield {"color": f"C{firsts.index(first)}", **style}


def draw(axes, rows, what="error"):
    """Curves of one comparison, lines at the targets, gray where the reference is no better."""
    labels = list(dict.fromkeys(row["curve"] for row in rows))
    for label, look in zip(labels, looks(labels), strict=True):
        points = [(row["seconds"], row[what]) for row in rows if row["curve"] == label]
        axes.loglog(*zip(*points, strict=True), lw=1.2, ms=4, label=label, **look)
    for name, target in TARGETS.items():
        axes.axhline(target, color="0.3", lw=0.9, ls=":")
        place = {"xycoords": ("axes fraction", "data"), "textcoords": "offset points"}
        axes.annotate(name, (1, target), (2, 0), **place, va="center", fontsize=7)
    uncertain = max(row["uncertain"] for row in rows)
    if uncertain and what == "error":
        axes.axhspan(1e-12, uncertain, color="0.92", zorder=0, label="reference uncertain")
    axes.set(ylim=(1e-7, 2), xlabel="CPU time [s]")
    axes.grid(alpha=0.25)
    place = "lower left" if what == "stress" else "best"
    axes.legend(fontsize=7, framealpha=0.7, ncols=1 + (len(labels) in (7, 8)), loc=place)


def pictures(rows):
    """One panel for each comparison, and a picture of their own for the quadrature rules."""
    names = list(dict.fromkeys(row["comparison"] for row in rows))
    rules = [name for name in names if name.startswith("quadrature")]
    panels = [(name, "error") for name in names if name not in rules]
    if "elements, smooth" in names:
        panels.insert(1, ("elements, smooth", "stress"))
    for name, chosen, wide in (
        ("work_precision", panels, 3),
        ("work_precision_quadrature", [(rule, "error") for rule in rules], 2),
    ):
        high = -(-len(chosen) // wide)
        figure = Figure((12, 3.8 * high if wide == 3 else 5), 150, layout="constrained")
        grid = figure.subplots(high, wide, sharey=True, squeeze=False)
        for axes in grid.flat[len(chosen) :]:
            axes.axis("off")
        for axes, (comparison, what) in zip(grid.flat, chosen, strict=False):
            draw(axes, [row for row in rows if row["comparison"] == comparison], what)
            axes.set_title(f"{comparison}: stress" if what == "stress" else comparison)
        for axes in grid[:, 0]:
            axes.set_ylabel("relative error")
        save(figure, name)


def main(small=False, write=False):
    """Measure, print and write the tables and the pictures."""
    measurements = Measurements(SMALL_REFERENCES if small else REFERENCES)
    for name, (scene, curves) in {**PANELS, **QUADRATURE}.items():
        for curve in curves:
            if not small:
                measurements.add(name, scene, curve)
            elif curve.label in SMALL.get(name, ()):
                measurements.add(name, scene, curve._replace(sizes=curve.sizes[:2]))
    measurements.table.write()
    rows = measurements.table.rows
    pictures(rows)
    if write:
        rules = [row for row in rows if row["comparison"].startswith("quadrature")]
        insert("work precision", table([row for row in rows if row not in rules]))
        insert("quadrature", quadrature_table(rules))
    return rows


if __name__ == "__main__":
    main(small="--small" in sys.argv, write="--write" in sys.argv)
