# SPDX-License-Identifier: MIT
# %% [markdown]
# # Wobble: a soft body of fixed corotated energy is thrown spinning
#
# Nothing holds the body, which statics refuses and motion does not mind. The midpoint rule keeps
# its momentum and its angular momentum; implicit Euler, which animation loves, calms it down.
#
# psi = mu |F - R|^2 + lmbda/2 (J - 1)^2, mu = 2 kPa, lmbda = 4 kPa, rho = 1000 kg/m^3
#
# You get `results/wobble/`: `wobble.png`, `energy.png`, `wobble.gif`, `wobble.bp`, `wobble.json`.

# %%
from pathlib import Path

from mpi4py import MPI

import matplotlib
import numpy as np
import ufl

from variform import forms, meshes
from variform.forms.files.animations import Animation

matplotlib.use("Agg")
import matplotlib.pyplot as plt

folder = Path("results/wobble")
comm = MPI.COMM_WORLD
say = print if comm.rank == 0 else lambda *words: None
size, rho, to = (0.2, 0.1, 0.05), 1000.0, 0.6  # m, kg/m^3, s

body = meshes.block(comm, size, n=(6, 3, 2), cells="hexahedron")
t, u = forms.load_factor(body), forms.displacement(body)
F = forms.deformation_gradient(u)
potential = forms.energies.fixed_corotated(F, mu=2e3, lmbda=4e3) * ufl.dx

# %% [markdown]
# Thrown with 0.5 m/s upwards and 0.2 m/s aside, about three turns a second.

# %%
arm = ufl.SpatialCoordinate(body.mesh) - ufl.as_vector([s / 2 for s in size])
velocity = ufl.as_vector([0.2, 0.0, 0.5]) + ufl.cross(ufl.as_vector([0.0, 2.0, 18.0]), arm)
vtx, movie = forms.VTX(folder / "wobble.bp", u), Animation(folder / "wobble.gif", every=0.02)
thrown = {"rho": rho, "velocity": velocity, "to": to}
paths = {"euler": forms.transient(potential, u, (), t, scheme="euler", dt=2e-3, **thrown)}
u.x.array[:], t.value = 0, 0
paths["midpoint"] = forms.transient(
    potential,
    u,
    (),
    t,
    scheme="midpoint",
    on_step=lambda path: [write(path) for write in (vtx, movie)],
    **thrown,
)
vtx.close()
movie.close()
path = paths["midpoint"]


def kept(path, name):
    """Largest change of a momentum, over its size."""
    values = path.record(name)
    return np.abs(values - values[0]).max() / np.linalg.norm(values[0])


# %%
found = {}
for scheme, run in paths.items():
    account = run.ledger
    lost = sum(row.scheme for row in account) / run.record("kinetic")[0]
    found[scheme] = {name: kept(run, name) for name in ("momentum", "angular_momentum")}
    found[scheme] |= {"lost": lost, "unaccounted": account.missed / account.exchanged}
    words = ", ".join(f"{name} {value:.1e}" for name, value in found[scheme].items())
    say(f"{scheme}, {len(run.steps)} steps: {words}")
assert found["midpoint"]["momentum"] < 1e-12 and found["midpoint"]["angular_momentum"] < 1e-10
assert found["midpoint"]["unaccounted"] < 1e-3 and abs(found["midpoint"]["lost"]) < 1e-9
assert found["euler"]["lost"] > 0.01

forms.picture(path, folder / "wobble.png", title="in the air", label="|u| [m]")
if comm.rank == 0:
    figure, axes = plt.subplots(figsize=(8, 4.5))
    for (scheme, run), style in zip(paths.items(), ("--", "-"), strict=True):
        time = [step.load for step in run.steps]
        for name, color in (("stored", "C0"), ("kinetic", "C2")):
            values = np.cumsum([getattr(row, name) for row in run.ledger])
            axes.plot(time, 1e3 * values, style, color=color, label=f"{name}, {scheme}")
    axes.set(xlabel="time [s]", ylabel="energy since the start [mJ]")
    axes.legend()
    figure.savefig(folder / "energy.png", dpi=150)
forms.summary(path, folder / "wobble.json", **{k: found[k] for k in found})

# %% [markdown]
# Try next: scheme="newmark", whose angular momentum wavers; dissipation.kelvin_voigt(5.0), which
# stops the wobble and not the spin; forms.frequencies(path).
