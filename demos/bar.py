# SPDX-License-Identifier: MIT
# %% [markdown]
# # Bar: a beam of heart muscle bent by a pressure that follows it
#
# Problem 1 of the benchmark for cardiac mechanics software, Land et al., Proc. R. Soc. A 471 (2015)
# 20150641: a bar of 10 x 1 x 1 mm, clamped at x = 0, with 0.004 kPa on its lower side, normal to it
# wherever it goes. The muscle is incompressible and stiffer along its fibers, which run along x.
#
# psi = C/2 (exp Q - 1) + p (J - 1),  C = 2 kPa
# Q = bf E11^2 + bt (E22^2 + E33^2 + 2 E23^2) + 2 bfs (E12^2 + E13^2),  bf, bt, bfs = 8, 2, 4
#
# The bar bends upwards until the middle of its upper end edge, (10, 0.5, 1), is at z = 4.17 mm.
# You get `results/bar/`: `bar.png` (the stretch of the fibers in the bent bar), `bar.bp` for
# ParaView, and `bar.json`.

# %%
from pathlib import Path

from mpi4py import MPI

import numpy as np
import ufl

from variform import forms, meshes

folder = Path("results/bar")
comm = MPI.COMM_WORLD
say = print if comm.rank == 0 else lambda *words: None

# %% [markdown]
# Hexahedra, since bending is symmetric and so should be the mesh: quadratic displacement, linear
# pressure. The mixed unknown w holds both, and its parts are what energies are written in.

# %%
body = meshes.block(comm, (10.0, 1.0, 1.0), n=(20, 2, 2), cells="hexahedron")
t = forms.load_factor(body)
w = forms.displacement_pressure(body)
u, p = ufl.split(w)
F = forms.deformation_gradient(u)
fiber = ufl.as_vector((1.0, 0.0, 0.0))
muscle = forms.energies.guccione(F, C=2.0, bf=8.0, bt=2.0, bfs=4.0, fiber=fiber)
psi = forms.energies.with_pressure(muscle, F, p)

# %% [markdown]
# A pressure on a side with a free rim is the derivative of no energy. So it enters as a virtual
# work, linear in the test function of the displacement, and makes the tangent unsymmetric.

# %%
v, _ = ufl.split(ufl.TestFunction(w.function_space))
load = forms.follower_pressure(u, 0.004 * t, v, body.ds("bottom"))
fixed = forms.clamp(w, body.facets("left"))

# %% [markdown]
# We follow the load to t = 1 and keep, after each step, where the benchmark's point has got to, and
# how much of the volume has been lost: an unknown p conserves it in the mean.


# %%
def place(system):
    """Where the benchmark's point is [mm]."""
    X = np.array((10, 0.5, 1))
    return X + forms.at(forms.displacement_of(w), X)


record = {"place": place, "volume": lambda system: forms.volume(F, body.dx())}
vtx = forms.VTX(folder / "bar.bp", w, stress=forms.stress.cauchy(psi, F))
path = forms.follow(
    psi * ufl.dx, w, [fixed], t, virtual_work=load, record=record, on_step=vtx, step=0.2
)
vtx.close()
for step in path.steps:
    x, y, z = step.records["place"]
    say(f"{4 * step.load:6.3f} Pa: x = {x:7.4f}, y = {y:7.4f}, z = {z:7.4f} mm")

# %% [markdown]
# The picture shows the stretch of the fibers, |F A|: they lengthen below, shorten above.

# %%
stretch = ufl.sqrt(forms.kinematics.fiber_invariants(F, fiber)[0])
forms.picture(path, folder / "bar.png", stretch, "fiber\nstretch [-]", view=(0.3, -1.0, 0.3))

# %% [markdown]
# The check is the converged answer of the benchmark: z = 4.17 mm and x = 9.18 mm. By symmetry the
# point stays in the plane y = 0.5, and no volume may be lost.

# %%
x, y, z = path.record("place")[-1]
volume = path.record("volume")[-1]
say(f"the point is at x = {x:.4f}, z = {z:.4f} mm; volume {volume:.6f} mm^3")
assert abs(z - 4.17) < 0.01 and abs(x - 9.18) < 0.01
assert abs(y - 0.5) < 1e-6 and abs(volume - 10) < 1e-6
forms.summary(path, folder / "bar.json", x=x, z=z, volume=volume)

# %% [markdown]
# Try next: fibers at an angle, `fiber = ufl.as_vector((cos(a), sin(a), 0.0))`, which twist the bar;
# tetrahedra (leave out `cells`), or a load of fixed direction, `forms.dead_traction`.
