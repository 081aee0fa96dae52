# SPDX-License-Identifier: MIT
"""Where Newton's method succeeds: size of the load step against distortion of the start.

A block 2 x 1 x 1 of P1 tetrahedra is clamped at one end and turned by an angle at the other, in one
step; its free nodes start thrown about by up to a h in each direction, h the length of an edge.
Methods: DOLFINx's own NewtonSolver (full steps), PETSc's SNES with its default search along |R|,
both with the usual lifting and up to MOST iterations, and variform with projection "never", "auto"
(its default) and "always". All get the same compiled residual and tangent, and MUMPS. Right is the
state at the end of small load steps from rest. Run ``docker/enter python3 -m
demos.benchmarks.newton_atlas`` (``--small``: toy sizes); one JSON line per row,
``results/newton_atlas.csv``, ``results/newton_atlas.png`` and ``.svg``; ``--write`` puts the table
into README.md. One process only.
"""

import sys
import time
from collections import Counter

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import ufl
from dolfinx.fem import petsc as fem_petsc
from dolfinx.nls.petsc import NewtonSolver
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from variform import forms, meshes
from variform.forms import energies

from .record import Table, insert, markdown, save

MU, LMBDA = 1.0, 10.0
ENERGIES = {
    "stable neo-Hookean": energies.stable_neo_hookean,
    "fixed corotated": energies.fixed_corotated,
}
ANGLES = (15, 30, 60, 90, 120, 150, 165)
THROWS = (0, 0.05, 0.1, 0.2, 0.3, 0.5, 1, 2)
MOST = 100
CLOSE = 1e-4  # of the block's length: the tolerances of the solvers differ
WHY = {
    "m": "iterations used up",
    "l": "line search found nothing lower",
    "w": "another state than small steps lead to",
    "n": "not finite",
    "s": "linear solver failed",
}
CODES = {-1: "n", -3: "s", -4: "n", -5: "m", -6: "l", -8: "l"}


class Scene:
    """The block, its system, the start and the right state of every angle."""

    def __init__(self, energy, n):
        self.body = meshes.block(MPI.COMM_SELF, (2.0, 1.0, 1.0), n=(2 * n, n, n))
        self.t, self.u = forms.load_factor(self.body), forms.displacement(self.body)
        psi = ENERGIES[energy](forms.deformation_gradient(self.u), mu=MU, lmbda=LMBDA)
        held = [
            forms.clamp(self.u, self.body.facets("left")),
            forms.rotate(self.u, self.body.facets("right"), self.t, (1, 0, 0)),
        ]
        self.follow = lambda to: forms.follow(
            psi * ufl.dx, self.u, held, self.t, to=to, step=np.pi / 24, progress=False
        )
        self.system = forms.Problem(psi * ufl.dx, self.u, held)
        x = self.u.function_space.tabulate_dof_coordinates()
        free = (x[:, 0] > 1e-9) & (x[:, 0] < 2 - 1e-9)
        throw = np.random.default_rng(0).uniform(-1, 1, x.shape) / n
        self.throw = np.where(free[:, None], throw, 0).ravel()
        # 0.10 gave the old problem a longer name.
        old = getattr(fem_petsc, "NewtonSolverNonlinearProblem", fem_petsc.NonlinearProblem)
        written = self.system.forms
        self.problem = old(
            written.residual_form, self.u, self.system.conditions, written.tangent_form
        )

    def solved(self, angles):
        """The right states by small steps, checked to be stable."""
        self.right = {}
        for angle in angles:
            self.u.x.array[:] = 0
            path = self.follow(np.radians(angle))
            if path.steps[-1].convergence.negative:
                raise RuntimeError(f"the state at {angle} degrees is not stable: {path.reason}")
            self.right[angle] = self.u.x.array.copy()

    def begin(self, angle, amplitude):
        """Put unknown and supports to a start."""
        self.u.x.array[:] = amplitude * self.throw
        self.t.value = np.radians(angle)
        for support in self.system.supports:
            support.update()


def full_steps(scene):
    """DOLFINx's NewtonSolver: iterations and a letter for what went wrong."""
    solver = NewtonSolver(MPI.COMM_SELF, scene.problem)
    solver.max_it = MOST
    ksp = solver.krylov_solver
    ksp.setType("preonly")
    ksp.getPC().setType("lu")
    ksp.getPC().setFactorSolverType("mumps")
    try:
        return solver.solve(scene.u)[0], ""
    except (RuntimeError, PETSc.Error) as error:
        if not np.isfinite(scene.u.x.array).all():
            return MOST, "n"
        return MOST, "m" if "maximum number" in str(error) else "s"


def search(scene):
    """SNES newtonls with bt along |R|, its default."""
    problem, system = scene.problem, scene.system
    snes, A, b = PETSc.SNES().create(MPI.COMM_SELF), system.create_matrix(), system.create_vector()
    x = scene.u.x.petsc_vec.copy()

    def residual(snes, x, f):
        problem.form(x)
        x.copy(scene.u.x.petsc_vec)
        problem.F(x, f)

    snes.setFunction(residual, b)
    snes.setJacobian(lambda snes, x, A, P: problem.J(x, A), A)
    snes.setTolerances(max_it=MOST)
    snes.getKSP().setType("preonly")
    snes.getKSP().getPC().setType("lu")
    snes.getKSP().getPC().setFactorSolverType("mumps")
    snes.solve(None, x)
    x.copy(scene.u.x.petsc_vec)
    count, code = snes.getIterationNumber(), snes.getConvergedReason()
    for item in (snes, A, b, x):
        item.destroy()
    return count, "" if code > 0 else CODES.get(code, "s")


def variform(projection):
    """As forms.solve does it, on a system that is compiled already."""

    def method(scene):
        newton = forms.solving.Newton(scene.system, projection=projection)
        newton.predict()
        run = newton.solve()
        newton.destroy()
        return run.iterations, "" if run.converged else CODES.get(run.code, "s")

    return method


METHODS = {
    "DOLFINx, full steps": full_steps,
    "SNES, bt along R": search,
    "variform, never": variform("never"),
    "variform, auto": variform("auto"),
    "variform, always": variform("always"),
}


def measured(energy, n, angles, throws):
    """Rows of one energy."""
    scene = Scene(energy, n)
    scene.solved(angles)
    for method, solve in METHODS.items():
        for amplitude in throws:
            for angle in angles:
                scene.begin(angle, amplitude)
                start = time.process_time()
                count, why = solve(scene)
                seconds = time.process_time() - start
                off = np.abs(scene.u.x.array - scene.right[angle]).max()
                if not why and not off <= CLOSE * 2.0:
                    why = "w"
                yield {
                    "energy": energy,
                    "method": method,
                    "angle": angle,
                    "throw": amplitude,
                    "iterations": count,
                    "failure": why,
                    "off": float(f"{off:.1e}"),
                    "seconds": round(seconds, 3),
                }


def picture(rows):
    """Iterations, a letter where it failed: a column for each method, a line for each energy."""
    angles, throws = (sorted({row[key] for row in rows}) for key in ("angle", "throw"))
    across, up = (max(len(values), 6) for values in (angles, throws))
    size = 0.42 * across * len(METHODS) + 2.2, 0.36 * up * len(ENERGIES) + 1.8
    figure = Figure(size, 100, layout="constrained")
    panels = figure.subplots(len(ENERGIES), len(METHODS), sharex=True, sharey=True)
    shades = ScalarMappable(LogNorm(4, 128), "viridis_r")
    for line, energy in zip(panels, ENERGIES, strict=True):
        for axes, method in zip(line, METHODS, strict=True):
            chosen = [r for r in rows if (r["energy"], r["method"]) == (energy, method)]
            colors = np.ones((len(throws), len(angles), 4))
            for row in chosen:
                x, y = angles.index(row["angle"]), throws.index(row["throw"])
                word, ink = row["failure"], "red"
                if not word:
                    word, count = row["iterations"], row["iterations"]
                    colors[y, x], ink = shades.to_rgba(count), "white" if count > 20 else "black"
                axes.text(x, y, word, color=ink, ha="center", va="center", fontsize=9)
            axes.imshow(colors, origin="lower", interpolation="none", aspect="auto")
        line[0].set_ylabel(f"{energy}\nthrow of the nodes / h")
    for axes, method in zip(panels[0], METHODS, strict=True):
        axes.set_title(method)
    for axes in panels[-1]:
        axes.set_xlabel("turn in one step [degrees]")
    panels[0, 0].set_xticks(range(len(angles)), [f"{x:g}" for x in angles])
    panels[0, 0].set_yticks(range(len(throws)), [f"{x:g}" for x in throws])
    bar = figure.colorbar(shades, ax=panels, aspect=30, pad=0.01, ticks=[4, 8, 16, 32, 64, 128])
    bar.ax.minorticks_off()
    bar.ax.set_yticklabels(["4", "8", "16", "32", "64", "128"])
    bar.set_label("Newton iterations to the right state")
    words = (f"{letter}: {why}" for letter, why in WHY.items() if letter in failures(rows))
    figure.supxlabel("red letters, failed.  " + ";  ".join(words), fontsize=10)
    save(figure, "newton_atlas")


def failures(rows):
    """How often each letter occurs, most frequent first."""
    return dict(Counter(row["failure"] for row in rows if row["failure"]).most_common())


def table(rows):
    """A line for each energy and method."""
    lines = []
    for energy, method in dict.fromkeys((row["energy"], row["method"]) for row in rows):
        chosen = [r for r in rows if (r["energy"], r["method"]) == (energy, method)]
        counts = [r["iterations"] for r in chosen if not r["failure"]]
        middle = f"{np.median(counts):g} ({max(counts)})" if counts else ""
        seconds = sum(r["seconds"] for r in chosen)
        why = ", ".join(f"{n} {WHY[letter]}" for letter, n in failures(chosen).items())
        share = f"{len(counts)} of {len(chosen)}"
        lines.append([energy, method, share, middle, f"{seconds:.1f}", why])
    heads = ("energy", "method", "right", "iterations: median (most)", "CPU s in all", "failures")
    return markdown(heads, lines)


def main(small=False, write=False):
    """Measure, print and write the table and the picture."""
    angles, throws = (ANGLES[1:5:3], THROWS[::5]) if small else (ANGLES, THROWS)
    measurements = Table("newton_atlas")
    for energy in ENERGIES:
        for row in measured(energy, 2 if small else 4, angles, throws):
            measurements.add(**row)
    measurements.write()
    picture(measurements.rows)
    if write:
        insert("newton atlas", table(measurements.rows))
    return measurements.rows


if __name__ == "__main__":
    main(small="--small" in sys.argv, write="--write" in sys.argv)
