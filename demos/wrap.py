# SPDX-License-Identifier: MIT
# %% [markdown]
# # Wrap: a cylinder pushed through a rubber sheet, held at two edges
#
# A sheet that is stretched a little, between two edges that stay where they are, and a rigid
# cylinder that comes from below. Without friction the sheet slides: its stretch is the same
# everywhere, on the cylinder and beside it, and the pressure there is tension over radius.
#
# W = int mu/2 (I2 + I3^-2 - 3) dA + int b(distance of x from the axis - R) dA
#
# You get `results/wrap/`: `wrap.png`, `force.png`, `wrap.bp` and `wrap.json`.

# %%
from pathlib import Path

from mpi4py import MPI

import matplotlib
import numpy as np
import ufl

from variform import forms, meshes

matplotlib.use("Agg")
import matplotlib.pyplot as plt

folder = Path("results/wrap")
comm = MPI.COMM_WORLD
say = print if comm.rank == 0 else lambda *words: None
L, width, R, mu, first, rise = 1.0, 0.4, 0.25, 1.0, 1.05, 0.6  # half the length

# %% [markdown]
# A grid of triangles in space, its four edges named.

# %%
nx, ny = 48, 6
s, y = np.meshgrid(np.linspace(-L, L, nx + 1), np.linspace(0, width, ny + 1), indexing="ij")
points = np.c_[s.ravel(), y.ravel(), 0 * y.ravel()]
number = np.arange(len(points)).reshape(nx + 1, ny + 1)
a, b, c, d = (
    part.ravel() for part in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:])
)
cells = np.concatenate([np.c_[a, b, c], np.c_[a, c, d]])
edges = {"left": number[0], "right": number[-1], "front": number[:, 0], "back": number[:, -1]}
sheet = meshes.from_arrays(comm, points, cells, boundaries=edges, gdim=3)

# %% [markdown]
# The start: stretched by 1.05, which is equilibrium with the edges held; sideways the width stays.

# %%
u, t = forms.displacement(sheet, degree=2), forms.load_factor(sheet)
psi = forms.energies.neo_hookean_sheet(forms.membrane_gradient(u), mu)
axis = (0.0, 0.0, t - R - 0.02)
roll = forms.obstacles.cylinder(axis, (0, 1, 0), R)
dhat = 0.004
tool = forms.obstacle(u, roll, ufl.dx, dhat=dhat, name="roll")
ends = [
    forms.translate(u, sheet.facets(e), (k * (first - 1) * L, 0, 0))
    for e, k in (("left", -1), ("right", 1))
]
held = [*ends, *(forms.roller(u, sheet.facets(edge), 1) for edge in ("front", "back"))]
u.interpolate(lambda x: np.vstack([(first - 1) * x[0], 0 * x[0], 0 * x[0]]))
vtx = forms.VTX(folder / "wrap.bp", u)
record = {"roll": forms.contact.recorder("roll")}
path = forms.follow(psi * ufl.dx + tool, u, held, t, to=rise, record=record, on_step=vtx)
vtx.close()

# %% [markdown]
# In closed form: half a sheet, of length first L, is straight from its edge to where it touches and
# an arc of radius R' = R + d beyond, at an angle a: the stretch l, the tension T = mu (l - l^-3) of
# a sheet that keeps its width, the force 2 T sin a. The gap d at the pressure T / R' is the
# barrier's; it is read off.


# %%
def closed(height, radius):
    """Angle, stretch and force on the cylinder whose top, sheet included, is at a height."""
    down, across = height - radius, first * L
    far = np.hypot(across, down)
    a = np.arcsin(radius / far) + np.arctan2(down, across)  # of the tangent from the edge
    drawn = (np.sqrt(far**2 - radius**2) + radius * a) / L
    return a, drawn, 2 * mu * (drawn - drawn**-3) * np.sin(a) * width


loads = np.array([step.load for step in path.steps])
force = -path.record("roll")[:, 2]  # on the cylinder, down
middle = forms.at(u, (0.0, width / 2, 0.0))[2]
top = loads - 0.02
a, stretch, expected = closed(middle, R + middle - top[-1])
ratio = float(force[-1] / expected)
say(f"angle {np.degrees(a):.1f}, stretch {stretch:.4f}, force {force[-1]:.4f} for {expected:.4f}")
assert abs(ratio - 1) < 0.01
pull, _ = forms.resultant(path, np.concatenate([sheet.facets("left"), sheet.facets("right")]))
assert abs(pull[2] + force[-1]) < 1e-6 * force[-1]
assert all(step.clearance.distance > 0 for step in path.steps)

# %%
pressure = forms.contact.pressure(path)
forms.picture(path, folder / "wrap.png", pressure, "contact pressure\n[N/m²]")
if comm.rank == 0:
    figure, axes = plt.subplots(figsize=(7, 4.5))
    on = top > 0.01
    axes.plot(top[on], [closed(h, R)[2] for h in top[on]], "k:", label="closed form, no gap")
    axes.plot(top, force, "o", ms=3, label="with a barrier")
    axes.set(xlabel="rise of the cylinder [m]", ylabel="force on it [N]")
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig(folder / "force.png", dpi=150)
forms.summary(path, folder / "wrap.json", ratio=ratio)

# %% [markdown]
# Try next: a ball, `forms.obstacles.sphere`; edges that let go, `forms.spring`; a tension field.
