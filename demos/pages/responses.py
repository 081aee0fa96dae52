# SPDX-License-Identifier: MIT
"""How energies respond: nominal stress over stretch and shear, computed from them, and drawn."""

import io

from mpi4py import MPI

import numpy as np
import scipy.optimize
import ufl
from dolfinx import fem, mesh

from variform import forms
from variform.forms.differentiation import update_dependents
from variform.forms.native import jit
from variform.forms.operators.evaluate import at_points

from .energies import ACROSS, ALONG, FAMILIES, FIGURES, MU


class Stress:
    """First Piola-Kirchhoff stress of an energy at one F at a time, by one compiled kernel.

    Args:
        psi: Function of F.
        shape: Of F, (3, 3) or (3, 2).

    Attributes:
        energy: psi at the last F.
    """

    def __init__(self, psi, shape=(3, 3)):
        self.mesh = mesh.create_unit_cube(MPI.COMM_SELF, 1, 1, 1)
        self.F = fem.Constant(self.mesh, np.eye(*shape))
        F = ufl.variable(self.F)
        density = psi(F)
        P = forms.stress.first_piola(density, F)
        point = np.full((1, 3), 0.25)
        entries = [density] + [P[i, j] for i in range(shape[0]) for j in range(shape[1])]
        self._parts = at_points(ufl.as_vector(entries), self.mesh, point)
        self._kernel = jit.expression(self._parts, point, self.mesh)

    def __call__(self, F):
        """P at an array F."""
        self.F.value[:] = F
        update_dependents(self._parts)
        values = self._kernel.eval(self.mesh, np.array([0], dtype=np.int32))
        self.energy, *P = values.ravel()
        return np.reshape(P, self.F.value.shape)


def _diagonal(stretches, shape):
    F = np.zeros(shape)
    np.fill_diagonal(F, stretches)
    return F


def response(P, stretches, given, kind):
    """P11 over a stretch that is given in one direction or two, free of stress in the others.

    Args:
        P: Stress of F, as :class:`Stress`.
        stretches: Values, increasing, 1 among them.
        given: Number of directions that are stretched: 1 or 2.
        kind: As a family's; "incompressible": J = 1, and a pressure makes the last stress zero.

    Returns:
        P11, shape of the stretches; NaN from where no lateral stretch is found.
    """
    shape = (3, 2) if kind == "sheets" else (3, 3)
    free = shape[1] - given

    def at(stretch, lateral):
        s = [stretch] * given + list(lateral)
        if kind == "incompressible":
            s.append(1 / np.prod(s))
        T = np.diag(P(_diagonal(s, shape))[: shape[1]])
        if kind != "incompressible":
            return T[0], T[given:]
        # P - p F^-T, with the pressure that frees the last direction.
        T = T - T[-1] * s[-1] / np.array(s)
        return T[0], T[given:-1]

    if kind == "incompressible":
        free -= 1
    values = np.full(len(stretches), np.nan)
    start = int(np.argmin(np.abs(stretches - 1)))
    for way in (range(start, len(stretches)), range(start, -1, -1)):
        lateral = np.ones(free)
        for k in way:
            if free:
                found = scipy.optimize.root(
                    lambda x, s=stretches[k]: at(s, x)[1], lateral, tol=1e-10
                )
                if not (found.success and np.all(found.x > 0.02)):
                    break
                lateral = found.x
            values[k] = at(stretches[k], lateral)[0]
    return values


def shear(P, amounts, kind):
    """P12 over simple shear x1 = X1 + gamma X2."""
    values = []
    for gamma in amounts:
        F = np.eye(3, 2 if kind == "sheets" else 3)
        F[0, 1] = gamma
        values.append(P(F)[0, 1])
    return np.array(values)


def curves(family, points=61):
    """For each row with a curve: label, fiber across or not, and (x, P/mu) of three states."""
    shape = (3, 2) if family.kind == "sheets" else (3, 3)
    for row in family.rows:
        if row.psi is None:
            continue
        for direction in (ALONG, ACROSS) if family.kind == "fibers" else (None,):
            psi = row.psi if direction is None else lambda F, r=row, a=direction: r.psi(F, a)
            P = Stress(psi, shape)
            out = []
            for given, (low, high) in enumerate(family.stretches, 1):
                s = np.unique([*np.linspace(low, high, points), 1.0])
                out.append((s, response(P, s, given, family.kind) / MU))
            gamma = np.linspace(0, family.shear, points)
            out.append((gamma, shear(P, gamma, family.kind) / MU))
            yield row.label or row.name, direction is ACROSS, out


def draw(family, filename):
    """The picture of a family: three panels, one line per energy."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.6, 3.5), dpi=100)
    axes = figure.subplots(1, 3)
    colors = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
    used, rows = {}, sum(row.psi is not None for row in family.rows)
    for label, across, states in curves(family):
        color = used.setdefault(label, colors[len(used)])
        # Each line is thinner than the one below it, so that none hides another that it equals.
        width = 4 - 2.6 * (len(used) - 1) / (rows - 1)
        for panel, (x, stress) in zip(axes, states, strict=True):
            style = {"ls": "--", "lw": 1.4} if across else {"lw": width, "label": label}
            panel.plot(x, stress, color=color, **style)
    for panel, title in zip(axes, ("uniaxial", "equibiaxial", "simple shear"), strict=True):
        panel.set_title(title, fontsize=10)
        panel.grid(color="0.9")
        panel.tick_params(labelsize=9)
        panel.axhline(0, color="0.5", lw=0.8, zorder=0.5)
    for panel, ends in zip(axes, family.stretches, strict=False):
        panel.set(xlabel="stretch [-]", ylabel="nominal stress P₁₁/μ [-]", xlim=ends)
        panel.set_ylim(family.stress)
        panel.axvline(1, color="0.5", lw=0.8, zorder=0.5)
    axes[2].set(xlabel="shear [-]", ylabel="nominal stress P₁₂/μ [-]", xlim=(0, family.shear))
    low, high = axes[2].get_ylim()
    axes[2].set_ylim(max(family.stress[0], low, -0.2), min(family.stress[1], high))
    handles, labels = axes[0].get_legend_handles_labels()
    columns = 2 if max(map(len, labels)) > 30 else 3
    figure.legend(
        handles,
        labels,
        loc="lower center",
        ncols=min(columns, len(labels)),
        fontsize=9,
        frameon=False,
    )
    figure.tight_layout(rect=(0, 0.02 + 0.06 * -(-len(labels) // columns), 1, 1))
    save(figure, filename)


def save(figure, filename):
    """Write a figure as a PNG of 128 colors, which is a third of the size."""
    from PIL import Image

    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    picture = Image.open(buffer).convert("RGB")
    picture.quantize(128, dither=Image.Dither.NONE).save(filename, optimize=True)


def pictures():
    """Draw all families."""
    for family in FAMILIES:
        if family.name:
            draw(family, FIGURES / f"energy_{family.name}.png")
            yield FIGURES / f"energy_{family.name}.png"
