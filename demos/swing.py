# SPDX-License-Identifier: MIT
# %% [markdown]
# # Swing: a heavy bar behind a cylinder is let go, and never comes to rest
#
# The solid test CSM3 of Turek and Hron: a bar grows out of a fixed cylinder, is let go and swings
# under its own weight. Nothing damps it: what its weight loses is stored in bending, moves, and
# comes back. The account of every step shows where the joules are.
#
# psi = mu/2 |F^T F - I|^2 / 2 + lmbda/8 (tr (F^T F - I))^2 (St Venant-Kirchhoff, plane strain),
# mu = 0.5 MPa, lmbda = 2 MPa, rho = 1000 kg/m^3, g = 2 m/s^2
#
# You get `results/swing/`: `swing.png`, `energy.png`, `swing.gif`, `swing.bp` and `swing.json`.

# %%
from pathlib import Path

from mpi4py import MPI

import matplotlib
import numpy as np
import ufl

from variform import forms, meshes
from variform.forms.files.animations import Animation

matplotlib.use("Agg")
import matplotlib.pyplot as plt

folder = Path("results/swing")
comm = MPI.COMM_WORLD
say = print if comm.rank == 0 else lambda *words: None
rho, mu, lmbda, n = 1000.0, 0.5e6, 2.0e6, 2  # kg/m^3, Pa, Pa, a measure of the mesh

# %% [markdown]
# The bar is 20 mm high and ends at x = 0.6 m; on its left it ends at the cylinder of radius 50 mm
# about (0.2, 0.2). Quadratic quadrilaterals, four of them over the height.

# %%
y = np.linspace(0.19, 0.21, 2 * n + 1)
arc = 0.2 + np.sqrt(0.05**2 - (y - 0.2) ** 2)
points = np.array(
    [
        [a + (0.6 - a) * s, b]
        for s in np.linspace(0, 1, 20 * n + 1)
        for a, b in zip(arc, y, strict=True)
    ]
)
corner = np.add.outer(np.arange(20 * n) * len(y), np.arange(2 * n)).ravel()
cells = corner[:, None] + [0, len(y), len(y) + 1, 1]
body = meshes.from_arrays(
    comm, points, cells, cell="quadrilateral", boundaries={"arc": np.arange(len(y))}
)

# %% [markdown]
# A motion takes what a solve takes, and the mass density; t is the time.

# %%
t, u = forms.load_factor(body), forms.displacement(body, degree=2)
psi = forms.energies.saint_venant_kirchhoff(forms.deformation_gradient(u), mu, lmbda)
potential = psi * ufl.dx + forms.gravity(u, rho, 2.0)
vtx, movie = forms.VTX(folder / "swing.bp", u), Animation(folder / "swing.gif", every=0.04)

path = forms.transient(
    potential,
    u,
    forms.clamp(u, body.facets("arc")),
    t,
    to=2.0,
    rho=rho,
    record={"tip": lambda problem: forms.at(u, (0.6, 0.2))},
    on_step=lambda path: [write(path) for write in (vtx, movie)],
)
vtx.close()
movie.close()

# %% [markdown]
# Turek and Hron give the tip's mean and amplitude over a period, and the frequency.

# %%
time, tip = np.array([step.load for step in path.steps]), path.record("tip") * 1e3
last = time > 2 - 1 / 1.0995
middle = [(tip[last, i].max() + tip[last, i].min()) / 2 for i in (0, 1)]
swing = [np.ptp(tip[last, i]) / 2 for i in (0, 1)]
down = [
    time[k] for k in range(1, len(time) - 1) if tip[k, 1] < min(tip[k - 1, 1], tip[k + 1, 1], -100)
]
frequency = 1 / (down[-1] - down[0])
for name, m, a, known in (("x", middle[0], swing[0], 14.305), ("y", middle[1], swing[1], 65.160)):
    say(f"u{name} = {m:.3f} +- {a:.3f} mm (published amplitude {known} mm)")
say(f"frequency {frequency:.4f} Hz (published 1.0995 Hz)")
assert abs(swing[0] / 14.305 - 1) < 0.03 and abs(swing[1] / 65.160 - 1) < 0.01
assert abs(frequency / 1.0995 - 1) < 0.01

account = path.ledger
unaccounted = account.missed / account.exchanged
say(f"unaccounted: {unaccounted:.1e} of the joules exchanged, in {len(path.steps)} steps")
assert unaccounted < 1e-3

# %%
forms.picture(path, folder / "swing.png", title="2 s after it was let go", label="|u| [m]")
if comm.rank == 0:
    figure, axes = plt.subplots(figsize=(8, 4.5))
    parts = {"bending and weight": "stored", "motion": "kinetic"}
    for name, key in parts.items():
        axes.plot(time, np.cumsum([getattr(row, key) for row in account]), label=name)
    total = np.cumsum([row.stored + row.kinetic for row in account])
    axes.plot(time, total, "k", lw=0.8, label="sum")
    axes.set(xlabel="time [s]", ylabel="energy since the start [J/m]")
    axes.legend()
    figure.savefig(folder / "energy.png", dpi=150)
known = {"amplitude": swing, "mean": middle, "frequency": frequency, "unaccounted": unaccounted}
forms.summary(path, folder / "swing.json", **known)

# %% [markdown]
# Try next: scheme="euler"; dissipation=forms.dissipation.mass_damping(5.0); forms.frequencies about
# the state at rest.
