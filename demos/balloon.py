# SPDX-License-Identifier: MIT
# %% [markdown]
# # Balloon: rubber sheets blown up past the largest pressure
#
# Blow up a balloon: first it is hard, then suddenly easy. The pressure has a peak, and a solver
# that prescribes the pressure stops there. Prescribe the volume and the pressure is found along.
#
# psi = mu/2 (I2 + I3^-2 - 3),  I2 = F : F, I3 = |f1 x f2| of the 3x2 gradient F of a surface
#
# A sphere (one octant) and a flat clamped disk (one quarter), both of neo-Hookean sheets.
# You get `results/balloon/`: `balloon.png`, `pressure.png`, `balloon.bp`, and `balloon.json`.

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

folder = Path("results/balloon")
comm = MPI.COMM_WORLD
say = print if comm.rank == 0 else lambda *words: None

# %% [markdown]
# One sheet of unit thickness and shear modulus: the potential with a pressure `p` that is not
# known, and the volume that the sheet encloses with the planes of symmetry.


# %%
def sheet(body, held):
    """Unknown, pressure, volume and total potential of a surface."""
    u, p = forms.displacement(body, degree=2), fem.Constant(body.mesh, 0.0)
    volume = forms.enclosed_volume(u)
    psi = forms.energies.neo_hookean_sheet(forms.membrane_gradient(u), mu=1.0)
    return u, p, volume, psi * ufl.dx - p * volume, held(u)


def mirrored(u, body, axes):
    """Planes of symmetry."""
    return [forms.roller(u, body.facets(f"{axis}0"), "xyz".index(axis)) for axis in axes]


# %% [markdown]
# The sphere of radius 1: all its fibers have the stretch l, and p = 2 (1/l - 1/l^7).

# %%
ball = meshes.spherical_sheet(comm, 1.0, 0.3, 2, "octant")
u, p, volume, potential, held = sheet(ball, lambda u: mirrored(u, ball, "xyz"))
start = forms.integral(volume)
stretches = np.linspace(1.02, 3, 45)
path = forms.control(potential, u, held, p, volume, start * stretches**3)
sphere = np.array([step.load for step in path.steps])
exact = 2 * (1 / stretches - stretches**-7.0)

# %% [markdown]
# The disk of radius 1, clamped at its rim. Flat, it has no stiffness against the pressure at all.

# %%
flat = meshes.disk(comm, 1.0, 0.1, 2, quarter=True)
u, p, volume, potential, held = sheet(
    flat, lambda u: [forms.clamp(u, flat.facets("outer")), *mirrored(u, flat, "xy")]
)
vtx = forms.VTX(folder / "balloon.bp", u)
apex = {"apex": lambda system: forms.at(u, (0, 0, 0))[2]}
path = forms.control(
    potential, u, held, p, volume, np.linspace(0.05, 2.5, 50), record=apex, on_step=vtx
)
vtx.close()
disk = np.array([step.load for step in path.steps])
height = path.record("apex")
area = forms.membranes.membrane_invariants(forms.membrane_gradient(u))[2]
forms.picture(path, folder / "balloon.png", 1 / area, "thickness over\nthat at rest")

# %% [markdown]
# The peaks, by a parabola through the highest steps, against the known limit pressures: of the
# sphere 1.2394629 at the stretch 7^(1/6), of the disk 1.8791735 at the height 1.17389 of its apex.


# %%
def peak(x, y):
    """Place and value of the largest y."""
    near = slice(y.argmax() - 2, y.argmax() + 3)
    a, b, c = np.polyfit(x[near], y[near], 2)
    return -b / (2 * a), c - b**2 / (4 * a)


limits = {"sphere": peak(stretches, sphere), "disk": peak(height, disk)}
for name, (place, pressure) in limits.items():
    say(f"{name}: limit pressure {pressure:.5f} at {place:.4f}")
assert abs(limits["sphere"][1] / 1.2394629 - 1) < 1e-3
assert abs(limits["disk"][1] / 1.8791735 - 1) < 2e-3 and abs(limits["disk"][0] - 1.174) < 0.02
if comm.rank == 0:
    figure, axes = plt.subplots(figsize=(8, 5))
    axes.plot(stretches, exact, "k-", lw=1, label="sphere, exact (over the stretch)")
    axes.plot(stretches, sphere, "C0.", label="sphere, 60 curved triangles")
    axes.plot(height, disk, "C1.-", lw=1, label="clamped disk (over the height of its apex)")
    axes.axhline(1.8791735, color="C1", lw=0.8, ls=":")
    axes.set(xlabel="stretch; height over radius", ylabel="pressure p r / (mu t)")
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig(folder / "pressure.png", dpi=150)
forms.summary(path, folder / "balloon.json", limits=limits, error=np.abs(sphere - exact).max())

# %% [markdown]
# Try next: `mooney_rivlin_sheet(F, 0.4, 0.1)`, whose pressure rises again; an annulus; a pillow.
