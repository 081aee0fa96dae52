# SPDX-License-Identifier: MIT
# %% [markdown]
# # Press: a rigid ball into rubber, a tool that is a formula
#
# A rigid ball of radius R is pressed into a slab of incompressible rubber that is bonded to its
# ground. The ball is no mesh: it is a distance, written with the load factor so that it moves, and
# its barrier is one more summand of the potential.
#
# W = int psi(F) + p (J - 1) dV + int b(|x - c(t)| - R) dA, psi = mu/2 (J^(-2/3) I - 3)
#
# You get `results/press/`: `press.png`, `force.png`, `press.bp` and `press.json`.

# %%
from pathlib import Path

from mpi4py import MPI

import matplotlib
import numpy as np
import ufl

from variform import forms, meshes

matplotlib.use("Agg")
import matplotlib.pyplot as plt

folder = Path("results/press")
comm = MPI.COMM_WORLD
say = print if comm.rank == 0 else lambda *words: None
R, mu, width, height, depth = 10.0, 1.0, 100.0, 40.0, 4.0  # mm, N/mm^2

# %% [markdown]
# A body of revolution: its meridian plane, coordinates (r, z), cells finer towards the ball.

# %%
body = meshes.block(comm, (1.0, 1.0), n=(36, 24), cells="quadrilateral")
x = body.mesh.geometry.x
x[:, 0] = width * (0.3 * x[:, 0] + 0.7 * x[:, 0] ** 3)
x[:, 1] = -height * (1 - x[:, 1]) * (0.3 + 0.7 * (1 - x[:, 1]) ** 2)

w, t = forms.displacement_pressure(body), forms.load_factor(body)
u = w["u"]
F = forms.axisymmetric(u)
psi = forms.energies.isochoric_neo_hookean(F, mu) + w["p"] * (ufl.det(F) - 1)

# %% [markdown]
# The ball touches the slab where its path begins, at t = 0: `gap=` takes the reach dhat of the
# barrier back, so that nothing acts there yet. Stiffness and everything else have defaults.

# %%
dhat = 0.05
ball = forms.obstacles.sphere((0.0, R - t), R)
tool = forms.obstacle(u, ball, body.ds("top"), dhat=dhat, gap=dhat, name="ball")
potential = psi * forms.circumference(u) * ufl.dx + tool
held = [forms.clamp(w, body.facets("bottom")), forms.roller(w, body.facets("left"), 0)]
stops = [0.5, 1.0, 2.0, 3.0, depth]
vtx = forms.VTX(folder / "press.bp", forms.displacement_of(w))
path = forms.follow(
    potential,
    w,
    held,
    t,
    to=stops,
    record={"ball": forms.contact.recorder("ball")},
    on_step=lambda path: vtx(path) if path.load in stops else None,
)
vtx.close()

# %% [markdown]
# Force over depth beside Hertz on a half-space, and its correction for a bonded slab of small
# strains, F = 16/9 E R^(1/2) t^(3/2) (1 + 1.133 c + 1.283 c^2 + 0.769 c^3 + 0.0975 c^4) with
# c = (R t)^(1/2) / H, E = 3 mu (Dimitriadis et al., Biophys. J. 82 (2002) 2798-2810). The number to
# check is that of a finer mesh with a smaller dhat: 17.70 N at 1 mm, 4 % below the formula.

# %%
depths = np.array([step.load for step in path.steps])
force = path.record("ball")[:, 1]
c = np.sqrt(R * depths) / height
hertz = 16 / 9 * 3 * mu * np.sqrt(R) * depths**1.5
slab = hertz * np.polyval([0.0975, 0.769, 1.283, 1.133, 1], c)
at = int(np.flatnonzero(depths == 1.0)[0])
support, _ = forms.resultant(path, body.facets("bottom"))
say(
    f"{force[at]:.2f} N at 1 mm, {100 * (force[at] / slab[at] - 1):+.1f} % of the small-strain slab"
)
assert abs(force[at] / 17.70 - 1) < 0.02
assert abs(support[1] - force[-1]) < 1e-6 * force[-1]
assert all(step.clearance.distance > 0 for step in path.steps)

# %%
forms.picture(path, folder / "press.png", F[1, 1], "stretch\nalong z")
if comm.rank == 0:
    figure, axes = plt.subplots(figsize=(7, 4.5))
    axes.plot(depths, force, "o-", ms=3, label="with a barrier")
    axes.plot(depths, slab, "k:", label="bonded slab, small strains")
    axes.plot(depths, hertz, "k--", lw=0.8, label="Hertz, half-space")
    axes.set(xlabel="depth [mm]", ylabel="force [N]")
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig(folder / "force.png", dpi=150)
forms.summary(path, folder / "press.json", force=float(force[at]), slab=float(slab[at]))

# %% [markdown]
# Try next: a cone, `forms.obstacles.cone((0, -t), (0, 1), 1.2)`; a dhat half as large; the ball of
# twice the radius; the way back, `to=[depth, 0.2]`.
