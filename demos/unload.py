# SPDX-License-Identifier: MIT
# %% [markdown]
# # Unload: the ventricle's shape without pressure
#
# An image shows a heart under pressure; a simulation needs its shape at rest. The ventricle of the
# cardiac benchmark's problem 2 (Land et al. 2015) is taken for one that was seen at 10 kPa: the
# places at rest are the unknown of one solve, and loaded again every node has to come back.
#
# psi = C/2 (exp Q - 1) + p (J - 1),  Q = E : E  (Guccione with bf = bt = bfs = 1)
#
# You get `results/unload/`: `unload.png`, `unload.bp`, and `unload.json`.

# %%
from pathlib import Path

from mpi4py import MPI

import ufl

from variform import forms, meshes

folder = Path("results/unload")
comm = MPI.COMM_WORLD
say = print if comm.rank == 0 else lambda *words: None

# %% [markdown]
# The problem is written as for a body at rest. Displacements are of the mesh's own order, 2, so
# that the mesh can take the shape at rest.

# %%
body = meshes.ellipsoid(comm, h=6.0, order=2)
t, w = forms.load_factor(body), forms.displacement_pressure(body)
u, p = w["u"], w["p"]
F = forms.deformation_gradient(u)
fiber = meshes.ellipsoid_fiber_field(body)
psi = forms.energies.guccione(forms.kinematics.isochoric(F), 10.0, 1.0, 1.0, 1.0, fiber)
psi = forms.energies.with_pressure(psi, F, p)
v, _ = ufl.split(ufl.TestFunction(w.function_space))
press = forms.follower_pressure(u, 10.0 * t, v, body.ds("endo"))
base = forms.clamp(w, body.facets("base"))
problem = forms.Problem(psi * ufl.dx, w, [base], virtual_work=press)


# %% [markdown]
# Volumes of the wall and of the cavity, which is closed by the plane of the base, z = 5 mm.


# %%
def volumes():
    """Wall and cavity of the mesh as it is [mm^3]."""
    X, n = ufl.SpatialCoordinate(body.mesh), ufl.FacetNormal(body.mesh)
    inside = -ufl.dot(X - ufl.as_vector((0, 0, 5.0)), n) / 3
    return forms.integral(1 * body.dx()), forms.integral(inside * body.ds("endo"))


seen = volumes()
found = forms.unload(problem, t, step=0.1)
rest = volumes()
say(f"wall {seen[0]:.1f} -> {rest[0]:.1f}, cavity {seen[1]:.1f} -> {rest[1]:.1f} mm^3 at rest")
say(f"loaded again: off by {found.distance:.1e} of the size")

# %% [markdown]
# The picture shows it loaded again, in the shape that was seen, over its shape at rest.

# %%
path = found.again
vtx = forms.VTX(folder / "unload.bp", w)
vtx(path)
vtx.close()
size = ufl.sqrt(ufl.inner(u, u))
forms.picture(path, folder / "unload.png", size, "distance\nfrom rest [mm]", view=(0.3, -1.0, 0.2))

# %% [markdown]
# Every node is back where it was seen; the muscle has kept its volume, the cavity is far smaller.

# %%
assert found.distance < 1e-8
assert abs(rest[0] / seen[0] - 1) < 2e-3
assert 0.2 < rest[1] / seen[1] < 0.8
forms.summary(path, folder / "unload.json", distance=found.distance, seen=seen, rest=rest)

# %% [markdown]
# Try next: fibers that were seen in the loaded heart, `carried=fiber`, with the constants of the
# benchmark's problem 3; or a pressure at which there is no shape at rest any more.
