# SPDX-License-Identifier: MIT
# %% [markdown]
# # Reese: an incompressible block under a stamp that leaves a quarter of its height
#
# A block (2 x 2 x 1 mm) on a smooth table is pressed down in the middle of its top by a dead
# pressure; the top does not move sideways. After S. Reese's block, as nearly incompressible as it
# is soft: the material has to flow out from under the load, and most elements fail or lock.
#
# psi = mu/2 (J^(-2/3) I1 - 3) + kappa/4 (J^2 - 1 - 2 ln J),  mu = 80.194 MPa, nu = 0.4999
#
# Pressure 4 p/p0 MPa, up to p/p0 = 100, in one call. You get `results/reese/`: `reese.png` (how far
# the middle goes down), `block.png`, `reese.bp`, and `reese.json`.

# %%
from pathlib import Path

from mpi4py import MPI

import numpy as np
import ufl
from matplotlib.figure import Figure

from variform import forms, meshes

folder = Path("results/reese")
comm = MPI.COMM_WORLD
say = print if comm.rank == 0 else lambda *words: None
mu, nu = 80.194, 0.4999
kappa = 2 * mu * (1 + nu) / (3 * (1 - 2 * nu))

# %% [markdown]
# With a pressure q as second unknown the volume law U(J) is written as the largest value of
# q (J - 1) - U*(q). At that q, j = q/kappa + sqrt(1 + (q/kappa)^2) is J, and U*(q) = q (j - 1) -
# U(j). So both ways have the same solution.


# %%
def taylor_hood(body):
    """Unknown, displacement, F and energy with a pressure: Q2-Q1."""
    u, q = ufl.split(w := forms.displacement_pressure(body))
    F = forms.deformation_gradient(u)
    j = q / kappa + ufl.sqrt(1 + (q / kappa) ** 2)
    law = q * (ufl.det(F) - j) + kappa / 4 * (j**2 - 1 - 2 * ufl.ln(j))
    return w, u, F, forms.energies.isochoric_neo_hookean(F, mu) + law


def displacement(body):
    """The same with a displacement only: Q2."""
    u = forms.displacement(body, degree=2)
    F = forms.deformation_gradient(u)
    psi = forms.energies.isochoric_neo_hookean(F, mu)
    return u, u, F, psi + forms.energies.volumetric(F, kappa, "simo")


# %% [markdown]
# By symmetry a quarter of the block, a unit cube: two planes of symmetry, the table, and the load
# on the inner quarter of the top.


# %%
def pressed(n, element, on_step=None):
    """Path to p/p0 = 100 with n x n x n hexahedra, and F."""
    body = meshes.block(comm, (1.0, 1.0, 1.0), n=n, cells="hexahedron")
    t = forms.load_factor(body)
    w, u, F, psi = element(body)
    x = ufl.SpatialCoordinate(body.mesh)
    stamp = ufl.conditional(ufl.And(ufl.lt(x[0], 0.5), ufl.lt(x[1], 0.5)), 4 * t, 0)
    load = forms.dead_traction(u, ufl.as_vector([0, 0, -stamp]), body.ds("top"))
    sides = ("left", 0), ("front", 1), ("bottom", 2), ("top", 0), ("top", 1)
    held = [forms.roller(w, body.facets(name), axis) for name, axis in sides]
    middle = {"middle": lambda s: forms.at(forms.displacement_of(w), (0, 0, 1))[2]}
    path = forms.follow(psi * ufl.dx + load, w, held, t, 100, record=middle, progress=False)
    return path, F


# %%
runs = {"Q2": (displacement, (2,)), "Q2-Q1": (taylor_hood, (2, 4, 6))}
curves = {}
for name, (element, ns) in runs.items():
    for n in ns:
        path, F = pressed(n, element)
        loads = [step.load for step in path.steps]
        curves[f"{name}, {n} x {n} x {n}"] = [0, *loads], [0, *path.record("middle").tolist()]
        say(f"{name}, n = {n}: the middle goes down to {path.record('middle')[-1]:.4f} mm.")
        say(path.reason)

# %% [markdown]
# The last path is that of the finest mesh with a pressure: the block as a picture, and the chart.

# %%
J = forms.smallest_volume_ratio(F, path.u.function_space.mesh)
forms.picture(path, folder / "block.png", view=(-1.0, -1.4, 0.6), label="|u| [mm]")
vtx = forms.VTX(folder / "reese.bp", path.u)
vtx(path)
vtx.close()
if comm.rank == 0:
    axes = (figure := Figure((8, 16 / 3), 150, layout="constrained")).subplots()
    for (name, curve), style in zip(curves.items(), ("s--", "^--", "o--", "o-"), strict=True):
        axes.plot(curve[0], -np.array(curve[1]), style, label=name)
    axes.set(xlabel="p / p0", ylabel="the middle of the top goes down by [mm]")
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig(folder / "reese.png")

# %% [markdown]
# The check: our finer meshes end at -0.7603 mm (n = 8) and -0.7605 mm (n = 10). Q2 alone locks.

# %%
ends = {name: curve[1][-1] for name, curve in curves.items()}
assert abs(ends["Q2-Q1, 6 x 6 x 6"] + 0.7605) < 0.002 and J > 0
assert ends["Q2, 2 x 2 x 2"] > -0.55
forms.summary(path, folder / "reese.json", ends=ends, curves=curves, smallest_J=J)

# %% [markdown]
# Try next: Q2 with n = 4, which has several equilibria: the one that the path ends in is up to
# rounding, and so to the number of ranks. Tetrahedra (leave out `cells`); nu = 0.499999.
