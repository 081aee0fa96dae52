# SPDX-License-Identifier: MIT
# %% [markdown]
# # Snap: a deep arch that falls over, followed over every limit point
#
# A circular arch of 215 degrees, clamped at one end and hinged at the other, pressed down at its
# crown. At P = 900 N no more load can be borne: the arch falls over, the load and the crown go
# forth and back, and later it bears more again. Load steps end at the first peak; `arc_length`
# follows the path by its length and counts the directions in which the state is unstable.
#
# psi = E/2 e : e, e = 1/2 (F^T F - I), E = 1.2e7 N/mm^2 as in the benchmark, a strip 1 mm high and
# wide with nu = 0, so that plane strain is a beam
#
# You get `results/snap/`: `snap.png`, `path.png`, `snap.bp` and `snap.json`.

# %%
from pathlib import Path

from mpi4py import MPI

import matplotlib
import numpy as np
import ufl
from dolfinx import fem

from variform import forms, meshes

matplotlib.use("Agg")
import matplotlib.pyplot as plt

folder = Path("results/snap")
comm = MPI.COMM_WORLD
say = print if comm.rank == 0 else lambda *words: None
R, angle, E, n = 100.0, np.radians(215), 1.2e7, 95  # mm, 1, N/mm^2, cells

# %% [markdown]
# A straight strip of quadratic quadrilaterals, bent to the arch before the unknown is made. One
# more cell at the hinge, a thousand times as stiff, keeps that end straight; a pin in its middle
# lets it turn.

# %%
cell = R * angle / n
body = meshes.block(comm, (R * angle + cell, 1.0), n=(n + 1, 1), cells="quadrilateral")
x = body.mesh.geometry.x
phi = np.pi / 2 - angle / 2 + x[:, 0] / R
x[:, :2] = (R - 0.5 + x[:, 1])[:, None] * np.c_[np.cos(phi), np.sin(phi)]

u, q = forms.displacement(body, degree=2), fem.Constant(body.mesh, 0.0)
hinge = (-R * np.sin(angle / 2), R * np.cos(angle / 2))
constant = fem.functionspace(body.mesh, ("DG", 0))


def cells_where(condition):
    """1 in the cells whose middle fulfills a condition, 0 in the others."""
    found = fem.Function(constant)
    found.interpolate(lambda x: np.where(condition(np.arctan2(x[0], x[1])), 1.0, 0.0))
    return found


beyond = cells_where(lambda turn: -turn > angle / 2)  # turn: from the crown, clockwise
crown = cells_where(lambda turn: np.abs(turn) < 0.5 * cell / R)
area = forms.integral(crown * ufl.dx)

# %% [markdown]
# The potential with the load `q` spread over the cell at the crown, and the path until the arch
# hangs and bears 1000 N.

# %%
F = forms.deformation_gradient(u)
psi = (1 + 999 * beyond) * forms.energies.saint_venant_kirchhoff(F, mu=E / 2, lmbda=0.0)
potential = psi * ufl.dx + forms.body_force(u, ufl.as_vector([0 * q, -q * crown / area]))
held = [forms.clamp(u, body.facets("left")), forms.pin(u, hinge)]
vtx = forms.VTX(folder / "snap.bp", u)


def record(system):
    """Mean displacement of the loaded cell [mm]."""
    return [forms.integral(u[i] * crown * ufl.dx) / area for i in (0, 1)]


path = forms.arc_length(
    potential,
    u,
    held,
    q,
    step=50.0,
    until=lambda system: q.value > 1000,
    record={"crown": record},
    on_step=vtx,
)
vtx.close()
load = np.array([step.load for step in path.steps])
moved, negative = path.record("crown"), np.array([s.convergence.negative for s in path.steps])
peak = load[: np.flatnonzero(np.diff(load) < 0)[0] + 1].max()
say(f"limit load {peak:.1f} N (beam theory: 899 N)")
assert abs(peak / 899 - 1) < 0.015

# %%
forms.picture(
    path, folder / "snap.png", title=f"hanging arch at {load[-1]:.0f} N", label="|u| [mm]"
)
if comm.rank == 0:
    figure, axes = plt.subplots(figsize=(8, 5))
    for i, name in ((0, "sideways"), (1, "down")):
        axes.plot(-moved[:, i], load, "-", lw=1, color=f"C{i}", label=f"crown, {name}")
        axes.plot(-moved[negative > 0, i], load[negative > 0], ".", color=f"C{i}")
    axes.axhline(899, color="k", lw=0.8, ls=":", label="limit load of the beam, 899 N")
    axes.set(xlabel="displacement [mm] (dots: unstable)", ylabel="load [N]")
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig(folder / "path.png", dpi=150)
forms.summary(path, folder / "snap.json", limit=peak, reference=899.0)

# %% [markdown]
# Try next: hinge both ends; `lowest_modes(path)` at the peak; a checkpoint every ten steps.
