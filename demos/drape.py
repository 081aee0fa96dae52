# SPDX-License-Identifier: MIT
# %% [markdown]
# # Drape: a cloth falls on a ball, and friction decides whether it stays
#
# A square of cloth is let go above a rigid ball, a little beside its middle. With much friction it
# stays on the ball, with little it slides off. The ball is a distance, the friction a dissipation
# potential of the speed along it; the air damps in proportion to the mass. The cloth passes through
# itself nowhere (ipctk, an optional package, finds what comes near).
#
# W = int mu/2 (I2 + I3^-2 - 3) dA + int b(|x - c| - R) dA + int rho g z dA + barriers between its
# parts, and per second int f p |v_t| + eta D : D + alpha rho/2 |v|^2 dA, p the pressure on the ball
#
# You get `results/drape/`: `drape.png`, `force.png`, `drape.bp` and `drape.json`.

# %%
from pathlib import Path

from mpi4py import MPI

import matplotlib
import numpy as np
import ufl

from variform import forms, meshes

matplotlib.use("Agg")
import matplotlib.pyplot as plt

folder = Path("results/drape")
comm = MPI.COMM_WORLD
say = print if comm.rank == 0 else lambda *words: None
side, aside, R, mu, rho, g, to = 1.0, 0.08, 0.25, 50.0, 0.2, 9.81, 2.0  # m, N/m, kg/m^2, s

# %%
n = 10
s = np.linspace(-side / 2, side / 2, n + 1)
x, y = np.meshgrid(s + aside, s, indexing="ij")
points = np.c_[x.ravel(), y.ravel(), 0 * y.ravel()]
number = np.arange(len(points)).reshape(n + 1, n + 1)
a, b, c, d = (
    part.ravel() for part in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:])
)
cloth = meshes.from_arrays(comm, points, np.concatenate([np.c_[a, b, c], np.c_[a, c, d]]), gdim=3)

# %% [markdown]
# Implicit Euler calms what a cloth would flutter, and its account closes at steps of any size; how
# much the scheme itself takes stands in the ledger beside what friction and air take.

# %%
t, u = forms.load_factor(cloth), forms.displacement(cloth)
psi = forms.energies.neo_hookean_sheet(forms.membrane_gradient(u), mu)
sphere = forms.obstacles.sphere((0, 0, -R - 0.02), R)
ball = forms.obstacle(u, sphere, ufl.dx, dhat=0.01, stiffness=mu, name="ball")
itself = forms.touching(u, ufl.dx, stiffness=mu, dhat=0.005, thickness=0.005, parts=1)
potential = [psi * ufl.dx + ball + forms.gravity(u, rho, g), itself]
viscous = [
    forms.dissipation.mass_damping(6.0),
    forms.dissipation.kelvin_voigt(0.05, F=forms.membrane_gradient),
]


def fall(friction, on_step=None):
    """Let the cloth go."""
    u.x.array[:], t.value = 0, 0
    return forms.transient(
        *(potential, u, (), t),
        to=to,
        rho=rho,
        scheme="euler",
        tolerance=2e-2,
        dissipation=[*forms.friction(ball, friction, speed=0.02), *viscous],
        record={"ball": forms.contact.recorder("ball")},
        on_step=on_step,
    )


# %%
slides = fall(0.05)
under = float(forms.at(u, (aside, 0.0, 0.0))[2])
vtx = forms.VTX(folder / "drape.bp", u)
stays = fall(0.8, vtx)
vtx.close()
weight, area = rho * g * side**2, side**2
found = {"weight": weight}
for name, path in (("slides", slides), ("stays", stays)):
    account = path.ledger
    force, speed = -path.record("ball")[-1, 2], path.record("momentum")[-1] / (rho * area)
    found[name] = {
        "force over weight": float(force / weight),
        "speed": float(np.linalg.norm(speed)),
        "unaccounted": account.missed / account.exchanged,
    }
    say(f"{name}: " + ", ".join(f"{what} {value:.3g}" for what, value in found[name].items()))
    assert found[name]["unaccounted"] < 1e-3
    assert all(step.clearance.distance > 0 for step in path.steps)
assert itself.certified()  # no two triangles cross
assert abs(found["stays"]["force over weight"] - 1) < 0.02 and found["stays"]["speed"] < 5e-3
assert found["slides"]["force over weight"] == 0 and under < -2 * R

# %%
forms.picture(stays, folder / "drape.png", title="with friction", label="|u| [m]")
if comm.rank == 0:
    figure, axes = plt.subplots(figsize=(7, 4.5))
    for label, path in (("friction 0.8", stays), ("friction 0.05", slides)):
        times = [step.load for step in path.steps]
        axes.plot(times, -path.record("ball")[-len(times) :, 2] / weight, label=label)
    axes.axhline(1, color="k", lw=0.8, ls=":")
    axes.set(xlabel="time [s]", ylabel="force on the ball / weight of the cloth")
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig(folder / "force.png", dpi=150)
forms.summary(stays, folder / "drape.json", **found)

# %% [markdown]
# Try next: a finer grid, whose wrinkles are finer; scheme="newmark", which flutters; the cloth
# without its contact with itself, in half the time: does it cross?
