# SPDX-License-Identifier: MIT
# %% [markdown]
# # Muscle: a bar that rolls itself up
#
# Fibers along a bar contract on its inner side and stretch on its outer side; nothing else pulls.
#
# psi = mu |F A - R|^2 + lmbda/2 (det(F A) - 1)^2,  R the rotation of F A
#
# A contraction that grows linearly with the height z, A = diag(1/(1 - k z), 1, 1), has rest states
# without any stress: F A = R, a circular arc of curvature k. At k = 2 pi / L it is a closed ring.
# You get `results/muscle/`: pictures of three stages, `muscle.bp`, and `muscle.json`.

# %%
from math import pi
from pathlib import Path

from mpi4py import MPI

import numpy as np
import ufl

from variform import forms, meshes

folder = Path("results/muscle")
comm = MPI.COMM_WORLD
say = print if comm.rank == 0 else lambda *words: None

# %% [markdown]
# The load factor t is the part of the ring that has been closed. The height z is counted from the
# middle of the bar, where the fibers keep their length.

# %%
length, height = 6.0, 0.5
body = meshes.block(comm, (length, height, height), n=(24, 1, 2), cells="hexahedron")
t = forms.load_factor(body)
u = forms.displacement(body, degree=2)
F = forms.deformation_gradient(u)
X = ufl.SpatialCoordinate(body.mesh)
z = X[2] - height / 2
k = 2 * pi * t / length
A = ufl.as_matrix([[1 / (1 - k * z), 0, 0], [0, 1, 0], [0, 0, 1]])
mu, lmbda = 1.0, 2.0
psi = forms.energies.activated(F, A, mu) + lmbda / 2 * (ufl.det(F * A) - 1) ** 2
wall = forms.clamp(u, body.facets("left"))

# %% [markdown]
# The arc that the bar should follow: a point at (x, y, z) goes to the angle k x on a circle of
# radius 1/k - z.


# %%
def arc():
    """Displacement of the exact solution at the present load."""
    angle, radius = k * X[0], 1 / k - z
    return ufl.as_vector([radius * ufl.sin(angle) - X[0], 0, 1 / k - radius * ufl.cos(angle) - z])


def error(system):
    """Root of the mean square distance from the arc, over the bar's length."""
    distance = u - arc()
    square = forms.integral(ufl.inner(distance, distance) * ufl.dx(degree=6))
    return np.sqrt(square / (length * height**2)) / length


# %% [markdown]
# Ten steps close the ring. The contraction 1/(1 - k z) of the fibers colors the pictures.

# %%
fiber = ufl.sqrt(ufl.inner(F * ufl.as_vector([1, 0, 0]), F * ufl.as_vector([1, 0, 0])))
stages = {0.25: "quarter", 0.6: "half_closed", 1.0: "muscle"}
vtx = forms.VTX(folder / "muscle.bp", u, sigma=forms.stress.cauchy(psi, F))


def draw(path):
    """Write the fields, and the pictures of three stages."""
    vtx(path)
    for load, name in stages.items():
        if path.load == load:
            forms.picture(
                path,
                folder / f"{name}.png",
                fiber,
                "stretch of\nthe fibers",
                limits=(0.7, 1.3),
                view=(-0.4, -1.0, 0.25),
            )


path = forms.follow(
    psi * ufl.dx, u, [wall], t, to=list(stages), record={"error": error}, on_step=draw
)
vtx.close()

# %% [markdown]
# The arc is met to the error of the elements, and the ring holds almost no energy: compare with the
# bar that is kept straight while its fibers pull.

# %%
ring = path.problem.energy()
straight = forms.integral(
    (mu * (1 / (1 - k * z) - 1) ** 2 + lmbda / 2 * (1 / (1 - k * z) - 1) ** 2) * ufl.dx(degree=8)
)
say(f"mean distance from the ring: {path.steps[-1].records['error']:.1e} of the length")
say(f"energy: {ring:.1e} J in the ring, {straight:.1e} J if kept straight")
assert path.record("error").max() < 2e-3
assert ring < 1e-3 * straight
forms.summary(path, folder / "muscle.json", ring=ring, straight=straight)

# %% [markdown]
# Try next: `n=(48, 2, 4)` (the error falls by 8), fibers that contract in one half only, or
# `energies.activated(F, A, mu, improper=True)`.
