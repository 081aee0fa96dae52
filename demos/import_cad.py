# SPDX-License-Identifier: MIT
# %% [markdown]
# # Import: a bracket from a CAD file, its faces found by what they look like
#
# A STEP file knows faces but no names for them. We make one (an L of two plates, in mm, with a
# fillet and a hole), read it as `face1`, `face2`, …, look up which is which, screw the back to a
# wall and hang 60 N on a pin through the hole. The bracket is of soft plastic, neo-Hookean:
#
# psi = mu/2 (tr C - 3) - mu ln J + lmbda/2 (ln J)^2,  E = 50 MPa, nu = 0.4
#
# You get `results/import_cad/`: `bracket.step`, `import_cad.png` with the von Mises stress,
# `import_cad.bp` for ParaView, and `import_cad.json`.

# %%
from pathlib import Path

from mpi4py import MPI

import gmsh
import numpy as np
import ufl

from variform import forms, meshes

folder = Path("results/import_cad")
comm = MPI.COMM_WORLD
say = print if comm.rank == 0 else lambda *words: None

# %% [markdown]
# The file, as your CAD program would write it. Its kernel also tells the exact volume.
# (OCC, the kernel, reports on what it writes; nothing to worry about.)

# %%
exact = 0.0
if comm.rank == 0:
    folder.mkdir(parents=True, exist_ok=True)
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    cad = gmsh.model.occ
    base, wall = cad.addBox(0, 0, 0, 60, 40, 6), cad.addBox(0, 0, 0, 6, 40, 50)
    (_, solid), *_ = cad.fuse([(3, base)], [(3, wall)])[0]
    ((_, corner),) = cad.getEntitiesInBoundingBox(5.9, -1, 5.9, 6.1, 41, 6.1, dim=1)
    rounded = cad.fillet([solid], [corner], [8.0])
    (_, solid), *_ = cad.cut(rounded, [(3, cad.addCylinder(40, 20, -1, 0, 0, 8, 8))])[0]
    cad.synchronize()
    exact = cad.getMass(3, solid)
    gmsh.write(str(folder / "bracket.step"))
    gmsh.finalize()
exact = comm.bcast(exact)

# %% [markdown]
# Reading it makes the mesh. Curved cells (`order=2`) keep the hole round.

# %%
body = meshes.read(comm, folder / "bracket.step", h=6.0, order=2)
volume = forms.integral(1 * body.dx())
say(f"volume {volume:.3f} mm^3, by CAD {exact:.3f} mm^3")

# %% [markdown]
# Which face is which? Area and centroid tell: of all, that of the back has the least x, and that of
# the hole is nearest to its axis. (Or open the file in gmsh: the numbers are the same.)

# %%
X = ufl.SpatialCoordinate(body.mesh)
area, middle = {}, {}
for face in body.boundaries:
    dA = body.ds(face, degree=4)
    area[face] = forms.integral(1 * dA)
    middle[face] = np.array([forms.integral(X[i] * dA) for i in range(3)]) / area[face]
    say(f"{face:>7}: {area[face]:8.2f} mm^2 about ({', '.join(f'{c:.2f}' for c in middle[face])})")
back = min(middle, key=lambda face: middle[face][0])
hole = min(middle, key=lambda face: np.linalg.norm(middle[face] - (40, 20, 3)))
say(f"the back is {back}, the hole {hole}")

# %% [markdown]
# The pin presses down on the wall of the hole with a dead traction: 60 N over its area. On curved
# faces quadrature is not exact, so the load has the degree that measured the area.

# %%
t = forms.load_factor(body)
u = forms.displacement(body, degree=2)
F = forms.deformation_gradient(u)
mu, lmbda = forms.energies.lame_from_young(E=50.0, nu=0.4)
psi = forms.energies.neo_hookean(F, mu, lmbda)
traction = ufl.as_vector((0, 0, -60.0 / area[hole] * t))
dA = body.ds(hole, degree=4)
load = forms.dead_traction(u, traction, dA)
fixed = forms.clamp(u, body.facets(back))

# %%
sigma = forms.stress.cauchy(psi, F)
deviator = sigma - ufl.tr(sigma) / 3 * ufl.Identity(3)
von_mises = ufl.sqrt(1.5 * ufl.inner(deviator, deviator))
vtx = forms.VTX(folder / "import_cad.bp", u, von_mises=von_mises)
path = forms.follow(psi * ufl.dx + load, u, [fixed], t, step=0.25, on_step=vtx)
vtx.close()
forms.picture(path, folder / "import_cad.png", von_mises, "von Mises\nstress [MPa]")

# %% [markdown]
# The check: the wall bears the load to the last digits that matter, its force and its moment (the
# hole has moved, so the lever is that of the deformed body). And no volume was lost on the way in.

# %%
force, moment = forms.resultant(path.problem, body.facets(back))
lever = [forms.integral(ufl.cross(X + u, traction)[i] * dA) for i in range(3)]
say(f"the wall bears {force[2]:.6f} N and {moment[1] / 1000:.6f} N m")
assert np.abs(force - (0, 0, 60)).max() < 1e-6 * 60
assert np.abs(moment + lever).max() < 1e-6 * np.abs(moment).max()
assert abs(volume - exact) < 1e-4 * exact
forms.summary(path, folder / "import_cad.json", force=force, volume=volume, volume_cad=exact)

# %% [markdown]
# Try next: a STEP file of your own, `scale=1e-3` for a model in meters, or the pin pushed sideways.
