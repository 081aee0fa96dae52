# SPDX-License-Identifier: MIT
# %% [markdown]
# # Cook's panel: bending without volume change, and elements that lock
#
# A tapered panel of nearly incompressible rubber (plane strain, in mm and MPa) is clamped on its
# left edge; a dead force of 100 N per mm of thickness pulls the right one up.
#
# psi = mu/2 (J^(-2/3) I1 - 3) + kappa/2 (J - 1)^2,  mu = 80.1938,  kappa = 400942
#
# With a pressure as second unknown the corner (48, 60) rises by 6.93 mm; linear triangles lock. You
# get `results/cook/`: `deflection.png` (rise over unknowns), `cook.png`, `cook.bp`, `cook.json`.

# %%
from functools import partial
from pathlib import Path

from mpi4py import MPI

import matplotlib
import ufl

from variform import forms, meshes

matplotlib.use("Agg")
import matplotlib.pyplot as plt

folder = Path("results/cook")
comm = MPI.COMM_WORLD
say = print if comm.rank == 0 else lambda *words: None
mu, kappa = 80.1938, 400942.0

# %% [markdown]
# Two ways to see the volume: kappa/2 (J - 1)^2 at every point, or an unknown pressure p, which asks
# for J - 1 = p / kappa only in the mean over its own, coarser space.


# %%
def displacement(body, degree):
    """Unknown, displacement and energy with one unknown field."""
    u = forms.displacement(body, degree)
    F = forms.deformation_gradient(u)
    psi = forms.energies.isochoric_neo_hookean(F, mu) + forms.energies.volumetric(F, kappa)
    return u, u, psi


def taylor_hood(body):
    """Unknown, displacement and energy with two: u and p."""
    w = forms.displacement_pressure(body)
    u, p = ufl.split(w)
    F = forms.deformation_gradient(u)
    psi = forms.energies.isochoric_neo_hookean(F, mu)
    return w, u, forms.energies.with_pressure(psi, F, p, kappa)


P1, P2 = (partial(displacement, degree=k) for k in (1, 2))
elements = {"P1": P1, "P2": P2, "P2-P1": taylor_hood}

# %% [markdown]
# The traction 100/16 on the right edge, 16 mm long, grows with the load factor.


# %%
def solve(n, element):
    """Path to the full load, and the rise of the corner [mm]."""
    body = meshes.cook(comm, n=n)
    t = forms.load_factor(body)
    w, u, psi = elements[element](body)
    potential = psi * ufl.dx + forms.dead_traction(u, (0, t * 100 / 16), body.ds("right"))
    fixed = forms.clamp(w, body.facets("left"))
    path = forms.follow(potential, w, [fixed], t, step=0.25, progress=False)
    return path, float(forms.at(forms.displacement_of(w), (48, 60))[1])


# %% [markdown]
# The table: every element on finer and finer panels of n x n cells, each cut into two triangles.

# %%
ns = (2, 4, 8, 16, 32)
unknowns, rise = {e: [] for e in elements}, {e: [] for e in elements}
say("  n" + "".join(f"{e:>7} unknowns  u_y [mm]" for e in elements))
for n in ns:
    for e in elements:
        path, corner = solve(n, e)
        unknowns[e].append(path.problem.size)
        rise[e].append(corner)
    say(f"{n:3}" + "".join(f"{unknowns[e][-1]:16} {rise[e][-1]:9.4f}" for e in elements))
path, corner = solve(64, "P2-P1")
say(f" 64{path.problem.size:66} {corner:9.4f}")

# %% [markdown]
# On the last panel p is the mean stress, positive in tension. It is singular in the upper left
# corner, so the colors end at -20 MPa. The chart tells what an element's unknowns buy.

# %%
_, p = ufl.split(path.u)
forms.picture(path, folder / "cook.png", p, "pressure p\n[MPa]", limits=(-20, 12))
vtx = forms.VTX(folder / "cook.bp", path.u, p=p)
vtx(path)
vtx.close()
if comm.rank == 0:
    figure, axes = plt.subplots(figsize=(6, 4), dpi=150, layout="constrained")
    axes.axhline(6.93, color="gray", linewidth=0.8, label="6.93 mm")
    for e, marker in zip(elements, "s^o", strict=True):
        axes.semilogx(unknowns[e], rise[e], marker=marker, label=e)
    axes.set(xlabel="unknowns", ylabel="rise of the corner (48, 60) [mm]")
    axes.legend()
    figure.savefig(folder / "deflection.png")

# %% [markdown]
# The check: 6.93 mm, while linear triangles still lack a third of it on the panel of 32 x 32.

# %%
assert abs(corner - 6.93) < 0.01 and abs(rise["P2-P1"][-1] - 6.93) < 0.01
assert rise["P1"][-1] < 0.65 * 6.93
forms.summary(path, folder / "cook.json", corner=corner, n=ns, table=rise, unknowns_of=unknowns)

# %% [markdown]
# Try next: quadrilaterals (`meshes.cook(comm, n=n, cells="quadrilateral")`), or kappa = 100.
