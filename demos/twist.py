# SPDX-License-Identifier: MIT
# %% [markdown]
# # Twist: a rubber block turned by 360 degrees
#
# The energy is written once; residual, tangent, load steps and picture follow from it.
#
# psi = mu/2 (tr C - 3) - mu ln J + lmbda/2 (ln J)^2
#
# One end of a block of 1 m x 0.2 m x 0.2 m is clamped, the other turns once around.
# You get `results/twist/`: a picture, `twist.bp` for ParaView, and `twist.json`.

# %%
from math import pi
from pathlib import Path

from mpi4py import MPI

import numpy as np
import ufl

from variform import forms, meshes

folder = Path("results/twist")
comm = MPI.COMM_WORLD
say = print if comm.rank == 0 else lambda *words: None

# %% [markdown]
# The body comes with names for its faces; the load factor `t` is the angle of the right one.

# %%
body = meshes.block(comm, (1.0, 0.2, 0.2), h=0.07)
t = forms.load_factor(body)
u = forms.displacement(body, degree=2)
F = forms.deformation_gradient(u)
mu, lmbda = 1.0, 10.0  # Pa
psi = forms.energies.neo_hookean(F, mu, lmbda)
fixed = forms.clamp(u, body.facets("left"))
twist = forms.rotate(u, body.facets("right"), angle=t, axis=(1, 0, 0))

# %% [markdown]
# After each load step we keep the moment that the turned end needs, and the smallest volume ratio.

# %%
record = {
    "moment": lambda system: forms.resultant(system, body.facets("right"))[1][0],
    "smallest J": lambda system: forms.smallest_volume_ratio(F, body.mesh),
}
vtx = forms.VTX(folder / "twist.bp", u, sigma=forms.stress.cauchy(psi, F))
path = forms.follow(
    psi * ufl.dx,
    u,
    [fixed, twist],
    t,
    to=2 * pi,
    step=pi / 12,
    record=record,
    on_step=vtx,
)
vtx.close()

# %% [markdown]
# The picture shows the von Mises stress: the shear that carries the moment.

# %%
sigma = forms.stress.cauchy(psi, F)
deviator = sigma - ufl.tr(sigma) / 3 * ufl.Identity(3)
von_mises = ufl.sqrt(1.5 * ufl.inner(deviator, deviator))
forms.picture(path, folder / "twist.png", von_mises, "von Mises\nstress [Pa]")

# %% [markdown]
# Two checks. At small angles the moment is G J_t angle / L with the torsion constant of a square,
# 0.1406 a^4 (Timoshenko and Goodier, Theory of Elasticity, section 109; the clamped ends add some
# percent on a body this short). And no cell may be near collapse.

# %%
small = path.steps[0]
saint_venant = mu * 0.1406 * 0.2**4 * small.load / 1.0
ratio = small.records["moment"] / saint_venant
say(f"moment over Saint-Venant's at {np.degrees(small.load):.0f} degrees: {ratio:.3f}")
say(f"moment after one turn: {path.record('moment')[-1]:.4e} N m")
assert 1.0 < ratio < 1.15
assert path.record("smallest J").min() > 0.5
forms.summary(path, folder / "twist.json", moment_over_saint_venant=ratio)

# %% [markdown]
# Try next: `energies.stable_neo_hookean`, two turns (`to=4 * pi`), or
# `-variform_snes_monitor` on the command line.
