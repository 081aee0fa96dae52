# SPDX-License-Identifier: MIT
# %% [markdown]
# # Pose: which contraction draws a given curve?
#
# `muscle` the other way round. The fibers of a bar contract by a field a(x) that nobody knows; the
# curve that its middle line is to follow is drawn.
#
# psi = mu |F A - R|^2 + lmbda/2 (det(F A) - 1)^2,  A = diag(1 + a, 1, 1)
#
# A curve of curvature k(s) and the bar's length is reached without any stress by
# 1 + a = 1/(1 - k z), z the height over the middle line: the field found is compared with that.
# You get `results/pose/`: `pose.png`, `fit.png`, `pose.bp`, and `pose.json`.

# %%
from pathlib import Path

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem

from variform import forms, meshes

folder = Path("results/pose")
comm = MPI.COMM_WORLD
say = print if comm.rank == 0 else lambda *words: None

# %% [markdown]
# The bar in the plane, held at its left end, and the activation: a field of degree 1, 0 at first.

# %%
length, height = 6.0, 0.5
body = meshes.block(comm, (length, height), n=(48, 4), cells="quadrilateral")
u, X = forms.displacement(body, degree=2), ufl.SpatialCoordinate(body.mesh)
a = fem.Function(fem.functionspace(body.mesh, ("Lagrange", 1)), name="activation")
F = forms.deformation_gradient(u)
A = ufl.as_matrix([[1 + a, 0, 0], [0, 1, 0], [0, 0, 1]])
mu, lmbda = 1.0, 2.0
psi = forms.energies.activated(F, A, mu) + lmbda / 2 * (ufl.det(F * A) - 1) ** 2
problem = forms.Problem(psi * ufl.dx, u, [forms.clamp(u, body.facets("left"))])

# %% [markdown]
# The drawing: a wave whose direction turns by 1.2 sin(pi s / 3), so that its curvature is known.

# %%
s = np.linspace(0.0, length, 49)
fine = np.linspace(0.0, length, 4801)
angle = 1.2 * np.sin(np.pi * fine / 3)
steps = np.diff(fine) * np.array([np.cos(angle), np.sin(angle)])[:, :-1]
steps += np.diff(fine) / 2 * np.diff(np.array([np.cos(angle), np.sin(angle)]))
curve = np.concatenate([np.zeros((2, 1)), np.cumsum(steps, axis=1)], axis=1)[:, ::100].T
middle = np.column_stack([s, np.full_like(s, height / 2)])
drawn = curve - np.column_stack([s, np.zeros_like(s)])

# %% [markdown]
# The fit: places of the middle line, to a thousandth of the length; and of all fields that draw the
# curve the smoothest. The derivative by all activations is one adjoint solve for each trial.

# %%
data = forms.Data(problem, forms.Displacements(middle), drawn, sigma=length / 1000, name="curve")
smooth = 20 * ufl.inner(ufl.grad(a), ufl.grad(a)) * ufl.dx
fit = forms.fit(data, a, regularization=smooth, tolerance=1e-4)
say(fit)
if comm.rank == 0:
    folder.mkdir(parents=True, exist_ok=True)
    fit.plot(folder / "fit.png")

# %% [markdown]
# The bar in its pose, colored by the activation, and how far its middle line is from the drawing.

# %%
path = forms.solve(problem)
vtx = forms.VTX(folder / "pose.bp", u, activation=a)
vtx(path)
vtx.close()
forms.picture(path, folder / "pose.png", a, "activation [-]")
distance = np.linalg.norm(fit.fitted[0] - drawn, axis=1).max() / length

# %% [markdown]
# The energy left is compared with that of the bar kept straight under the same activation. Fibers
# contract inside of each bend: across the bar a changes as k z does.

# %%
straight = forms.integral((mu * a**2 + lmbda / 2 * a**2) * ufl.dx)
energy = problem.energy()
kz = 0.4 * np.pi * ufl.cos(np.pi * X[0] / 3) * (X[1] - height / 2)
along = forms.integral(a * kz * ufl.dx) / forms.integral(kz**2 * ufl.dx)
say(f"largest distance from the curve: {distance:.1e} of the length, {fit.evaluations} evaluations")
say(f"energy: {energy:.1e} J in the pose, {straight:.1e} J if kept straight; a = {along:.3f} k z")
assert fit.converged and distance < 2e-3
assert energy < 0.05 * straight and abs(along - 1) < 0.15
forms.summary(path, folder / "pose.json", distance=distance, energy=energy, straight=straight)

# %% [markdown]
# Try next: a curve of your own, as a table of points at equal lengths; a softer or a stiffer
# regularization; a bar in space whose fibers also twist it.
