# SPDX-License-Identifier: MIT
# %% [markdown]
# # Torsion: Rivlin's cylinder, and how fast the answer becomes exact
#
# An incompressible cylinder of radius A = 1 m is twisted by tau = 1 rad/m at a fixed length: one of
# the few exact solutions of finite elasticity, r = R, theta = Theta + tau Z, z = Z.
#
# psi = C1 (I1 - 3) + p (J - 1),  C1 = 0.5 Pa
# moment M = pi C1 tau A^4 = pi/2 N m,  axial force N = -pi/2 C1 tau^2 A^4 = -pi/4 N
#
# Twisted rubber wants to grow longer, so the ends must push: the Poynting effect. You get
# `results/torsion/`: `torsion.png`, `convergence.png` (errors over the size of the cells),
# `torsion.bp` for ParaView, and `torsion.json`.

# %%
from math import pi
from pathlib import Path

from mpi4py import MPI

import matplotlib
import numpy as np
import ufl

from variform import forms, meshes

matplotlib.use("Agg")
import matplotlib.pyplot as plt

folder = Path("results/torsion")
comm = MPI.COMM_WORLD
say = print if comm.rank == 0 else lambda *words: None

# %% [markdown]
# Cells of order 2 follow the round surface as closely as quadratic displacements deserve. The ends
# move rigidly, as in the exact solution. We write J^(-2/3) I1 for I1: the same where J = 1, but now
# p is the mean stress, zero at rest.


# %%
def twisted(h):
    """Body of cells of edge h, and its path to one radian."""
    body = meshes.cylinder(comm, radius=1.0, height=1.0, h=h, order=2)
    t = forms.load_factor(body)
    w = forms.displacement_pressure(body, degree=2)
    u, p = ufl.split(w)
    F = forms.deformation_gradient(u)
    psi = forms.energies.with_pressure(forms.energies.isochoric_neo_hookean(F, mu=1.0), F, p)
    fixed = forms.clamp(w, body.facets("bottom"))
    turned = forms.rotate(w, body.facets("top"), angle=t, center=(0, 0, 0))
    path = forms.follow(psi * ufl.dx, w, [fixed, turned], t, step=0.5, progress=False)
    return body, path


# %% [markdown]
# The resultants are those of the residual: consistent, so that they converge as an energy does.


# %%
def errors(body, path):
    """Errors of moment and force, and of the displacement in the mean over the body."""
    force, moment = forms.resultant(path.problem, body.facets("top"))
    u, _ = ufl.split(path.u)
    X, Y, Z = ufl.SpatialCoordinate(body.mesh)
    c, s = ufl.cos(Z), ufl.sin(Z)
    off = u - ufl.as_vector((c * X - s * Y - X, s * X + c * Y - Y, 0 * Z))
    mean = np.sqrt(forms.integral(ufl.inner(off, off) * body.dx(degree=6)) / pi)
    return {"moment": moment[2] - pi / 2, "force": force[2] + pi / 4, "displacement": mean}


names = {"moment": "M [N m]", "force": "N [N]", "displacement": "u [m]"}
sizes, table = [], {name: [] for name in names}
for h in (0.4, 0.28, 0.2):
    body, path = twisted(h)
    cells = body.mesh.topology.index_map(3).size_global
    sizes.append((pi / cells) ** (1 / 3))
    for name, error in errors(body, path).items():
        table[name].append(abs(float(error)))
    found = ", ".join(f"{table[name][-1]:.2e} in {label}" for name, label in names.items())
    say(f"{cells:5} cells of {sizes[-1]:.3f} m: errors {found}")

# %% [markdown]
# The rate is the slope of log error over log size, the cube root of a cell's mean volume.

# %%
rates = {n: float(np.polyfit(np.log(sizes), np.log(table[n]), 1)[0]) for n in names}
say("rates: " + ", ".join(f"{rate:.2f} ({name})" for name, rate in rates.items()))
if comm.rank == 0:
    folder.mkdir(parents=True, exist_ok=True)
    figure, axes = plt.subplots(figsize=(6, 4), dpi=150, layout="constrained")
    for name, marker in zip(names, "os^", strict=True):
        label = f"{names[name]}: rate {rates[name]:.2f}"
        axes.loglog(sizes, table[name], marker=marker, label=label)
    axes.set(xlabel="mean size of the cells [m]", ylabel="error", ylim=(5e-5, 2e-2))
    axes.set_xticks(sizes, [f"{size:.2f}" for size in sizes])
    axes.xaxis.minorticks_off()
    axes.legend(loc="upper left")
    figure.savefig(folder / "convergence.png")

# %% [markdown]
# Colored by where the material was, the lines on the surface show the twist.

# %%
X = ufl.SpatialCoordinate(body.mesh)[0]
forms.picture(path, folder / "torsion.png", X, "X at rest\n[m]")
vtx = forms.VTX(folder / "torsion.bp", path.u, p=ufl.split(path.u)[1])
vtx(path)
vtx.close()

# %% [markdown]
# The check: the exact moment to 0.02 %, the force to 0.1 %; fourth order, and third in u.

# %%
assert table["moment"][-1] < 2e-4 * pi / 2 and table["force"][-1] < 1e-3 * pi / 4
assert min(rates["moment"], rates["force"]) > 3.6 and rates["displacement"] > 2.8
forms.summary(path, folder / "torsion.json", sizes=sizes, errors=table, rates=rates)

# %% [markdown]
# Try next: `order=1`, whose flat facets cost the fourth order, or more twist (`angle=2 * t`).
