# SPDX-License-Identifier: MIT
# %% [markdown]
# # Jump: a shallow arch snaps through, and every joule of the jump is accounted for
#
# A sine-shaped arch under a load of one sine wave. At the limit load no equilibrium is connected
# ahead: `follow` stops there, and one line, `settle`, lets the arch move, damped, to the state at
# rest on the other side. Its ledger has what was released, what moved, and what was lost.
#
# psi = E : E/2 (St Venant-Kirchhoff, nu = 0, modulus 1), span 100, rise 5, height 1, rho = 1
#
# You get `results/jump/`: `jump.png`, `ledger.png`, `jump.gif`, `jump.bp` and `jump.json`.

# %%
from pathlib import Path

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem

from variform import forms, meshes
from variform.forms.files.animations import Animation

folder = Path("results/jump")
comm = MPI.COMM_WORLD
say = print if comm.rank == 0 else lambda *words: None
span, rise, n = 100.0, 5.0, 48

# %% [markdown]
# Half of the arch, on rollers in its middle: a whole one would sway aside before. The end hangs on
# a pin in a stiff cell.

# %%
body = meshes.block(comm, (span / 2, 1.0), n=(n // 2, 1), cells="quadrilateral")
x = body.mesh.geometry.x
stiff = fem.Function(fem.functionspace(body.mesh, ("DG", 0)))
stiff.interpolate(lambda x: np.where(x[0] < span / n, 1e3, 1.0))
x[:, 1] += rise * np.sin(np.pi * x[:, 0] / span) - 0.5
q, u = forms.load_factor(body), forms.displacement(body, degree=2)
psi = stiff * forms.energies.saint_venant_kirchhoff(forms.deformation_gradient(u), 0.5, 0.0)
sine = ufl.sin(np.pi * ufl.SpatialCoordinate(body.mesh)[0] / span)
potential = psi * ufl.dx + forms.body_force(u, ufl.as_vector([0 * q, -q * sine]))
held = [forms.pin(u, (0, 0)), forms.roller(u, body.facets("right"), axis=0)]
crown = (span / 2, rise)

# %% [markdown]
# The limit load of a shallow arch in one sine wave of height a:
# q (L/pi)^4 = EI (H - a) + EA/4 (H^2 - a^2) a.

# %%
a = np.sqrt((rise**2 - 1 / 3) / 3)
limit = (np.pi / span) ** 4 * ((rise - a) / 12 + (rise**2 - a**2) * a / 4)
try:
    forms.follow(potential, u, held, q, to=1.2 * limit)
except forms.NotConverged as stopped:
    say(stopped)
peak = float(q.value)
say(f"the path ends at {peak / limit:.4f} of the one-wave limit load")

# %%
vtx, movie = forms.VTX(folder / "jump.bp", u), Animation(folder / "jump.gif", every=300.0)
path = forms.settle(
    *(potential, u, held, q),
    to=1.01 * peak,
    rho=1.0,
    on_step=lambda path: [write(path) for write in (vtx, movie)],
)
vtx.close()
movie.close()

account = path.ledger
released = -sum(row.stored for row in account)
lost = sum(row.dissipated + row.scheme for row in account)
moved = path.record("kinetic").max()
say(f"released {released:.6g} J/m, at most {moved:.3g} moved, lost {lost:.6g}")
assert abs(lost / released - 1) < 1e-3 and account.missed < 1e-3 * account.exchanged
assert forms.negative_eigenvalues(path) == 0

# %% [markdown]
# The state at rest is that which statics has beyond the jump: the load factor goes up from the
# arch hung through from the start, one sine wave of height a < -rise.

# %%
down = forms.at(u, crown)[1]
heights = np.linspace(-2 * rise, -rise, 100001)
loads = (np.pi / span) ** 4 * ((rise - heights) / 12 + (rise**2 - heights**2) * heights / 4)
known = float(np.interp(-1.01 * peak, -loads, heights)) - rise
say(f"the crown went to {down:.4f}, one sine wave would go to {known:.4f}")
assert abs(down / known - 1) < 0.01

forms.picture(path, folder / "jump.png", title="at rest again, behind the jump", label="|u|")
if comm.rank == 0:
    account.plot(folder / "ledger.png")
forms.summary(
    path, folder / "jump.json", peak=peak / limit, released=released, lost=lost, down=down
)

# %% [markdown]
# Try next: `follow(…, jump=True)`, which minimizes the energy at the next load; a whole arch.
