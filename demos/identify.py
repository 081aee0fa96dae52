# SPDX-License-Identifier: MIT
# %% [markdown]
# # Identify: stiff inclusions seen from outside
#
# A soft square with two stiff disks is pulled, sheared, squeezed and bent; only its rim is seen,
# with 1 % noise.
#
# min over m of sum_i ((y_i(m) - d_i) / sigma_i)^2 / 2 + regularization(m)
#
# First the disks' places are known and their stiffness is looked for: two numbers, with their
# standard deviations. Then nothing is known: the modulus is exp(m), m a field.
# You get `results/identify/`: `identify.png`, `noise.png`, `identify.bp`, and `identify.json`.

# %%
from pathlib import Path

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem
from matplotlib.figure import Figure

from variform import forms, meshes

folder = Path("results/identify")
comm = MPI.COMM_WORLD
say = print if comm.rank == 0 else lambda *words: None

# %% [markdown]
# Moduli are relative to the soft part's, 1. The square is held below; four dead loads.

# %%
body = meshes.block(comm, (1.0, 1.0), n=16)
X, dx = ufl.SpatialCoordinate(body.mesh), ufl.dx(degree=2)
a, b = fem.Constant(body.mesh, 4.0), fem.Constant(body.mesh, 8.0)
left = ufl.lt((X[0] - 0.3) ** 2 + (X[1] - 0.65) ** 2, 0.15**2)
right = ufl.lt((X[0] - 0.7) ** 2 + (X[1] - 0.4) ** 2, 0.15**2)
disks = ufl.conditional(left, a, ufl.conditional(right, b, 1.0))
m = fem.Function(fem.functionspace(body.mesh, ("Lagrange", 1)), name="log_modulus")
loads = {
    "pulled": {"top": (0.0, 0.4)},
    "sheared": {"top": (0.3, 0.0)},
    "squeezed": {"right": (0.3, 0.0), "left": (-0.3, 0.0)},
    "bent": {"right": (0.0, 0.2), "left": (0.0, -0.2)},
}


def problem(load, mu):
    """The square under one of the loads, with some modulus."""
    u = forms.displacement(body)
    potential = forms.energies.neo_hookean(forms.deformation_gradient(u), mu, 2 * mu) * dx
    for side, t in loads[load].items():
        potential += forms.dead_traction(u, t, body.ds(side))
    return forms.Problem(potential, u, [forms.clamp(u, body.facets("bottom"))])


known = {load: problem(load, disks) for load in loads}
unknown = {load: problem(load, ufl.exp(m)) for load in loads}

# %% [markdown]
# What is seen: displacements at 87 points of the rim; the noise is a part of the largest one.

# %%
s = np.linspace(0.02, 0.98, 29)
rim = forms.Displacements([*((x, 1.0) for x in s), *((x, y) for y in s for x in (0.0, 1.0))])
rng, exact = np.random.default_rng(1), {}
for load, each in known.items():
    forms.solve(each)
    exact[load] = rim.values(each).reshape(rim.shape(each))
noise = {load: rng.normal(size=exact[load].shape) for load in loads}


def seen(level, problems):
    """Data of all loads, with noise."""
    size = {load: level * np.abs(exact[load]).max() for load in loads}
    return [
        forms.Data(problems[n], rim, exact[n] + size[n] * noise[n], sigma=size[n], name=n)
        for n in loads
    ]


# %%
a.value = b.value = 2.0
two = forms.fit(seen(0.01, known), {"left": a, "right": b}, progress=False)
say(two)
assert np.all(np.abs(two.values - [4.0, 8.0]) < 3 * two.deviations)

# %% [markdown]
# A field: of all that explain the rim to its noise, one that is flat but for edges (its total
# variation, rounded off). One adjoint solve for each trial and load.

# %%
edges = 20 * ufl.sqrt(ufl.inner(ufl.grad(m), ufl.grad(m)) + 0.1**2) * ufl.dx
true, errors = ufl.ln(ufl.conditional(left, 4.0, ufl.conditional(right, 8.0, 1.0))), {}
for level in (0.001, 0.003, 0.03, 0.01):
    m.x.array[:] = 0.0
    fit = forms.fit(seen(level, unknown), m, regularization=edges, tolerance=1e-4, progress=False)
    errors[level] = np.sqrt(forms.integral((m - true) ** 2 * dx) / forms.integral(true**2 * dx))
    say(f"{level:.1%} noise: {fit.evaluations} evaluations, error of the field {errors[level]:.2f}")
path = forms.solve(unknown["pulled"])
forms.picture(path, folder / "identify.png", m, "log of the\nmodulus [-]")
vtx = forms.VTX(folder / "identify.bp", path.u, modulus=m)
vtx(path)
vtx.close()
if comm.rank == 0:
    figure = Figure((5, 3.5), 150, layout="constrained")
    axes = figure.add_subplot(xlabel="noise [%]", ylabel="relative L2 error of the field", ylim=0)
    axes.semilogx(*np.array(sorted((100 * k, v) for k, v in errors.items())).T, "o-")
    figure.savefig(folder / "noise.png")
stiff = [forms.at(m, place)[0] for place in ((0.3, 0.65), (0.7, 0.4), (0.15, 0.2))]
say("moduli in the disks and beside them:", *(f"{np.exp(value):.2f}" for value in stiff))
assert stiff[0] > 0.8 and stiff[1] > 1.0 and abs(stiff[2]) < 0.3 and max(errors.values()) < 0.8
forms.summary(path, folder / "identify.json", two=two.values, errors=errors, log_moduli=stiff)

# %% [markdown]
# Try next: fewer loads, a weaker regularization (noise is fitted then), or points inside.
