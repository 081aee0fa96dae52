# SPDX-License-Identifier: MIT
# %% [markdown]
# # Scramble: a box whose inside is upside down finds back
#
# The outer faces of a rubber cube are held at rest; all nodes inside are thrown about, pressed into
# a plane, mirrored, or collapsed to a point. Hundreds of cells are inverted. The only state without
# stress is rest, and Newton's method has to find it.
#
# psi = mu sum (s_i - 1)^2 + lmbda/2 (J - 1)^2  in the signed singular values of F
#
# You get `results/scramble/`: `scramble.png`, `scramble.bp`, and `scramble.json`.

# %%
from pathlib import Path

from mpi4py import MPI

import matplotlib
import numpy as np
import ufl

from variform import forms, meshes

matplotlib.use("Agg")
import matplotlib.pyplot as plt

folder = Path("results/scramble")
comm = MPI.COMM_WORLD
say = print if comm.rank == 0 else lambda *words: None

# %% [markdown]
# Six cubes of six tetrahedra along each edge. The energy has a meaning for every F, so the start
# may be anything.

# %%
n = 6
body = meshes.block(comm, (1.0, 1.0, 1.0), n=(n, n, n))
u = forms.displacement(body)
F = forms.deformation_gradient(u)
potential = forms.energies.fixed_corotated(F, mu=1.0, lmbda=10.0) * ufl.dx
held = [forms.clamp(u, body.facets(name)) for name in body.boundaries]
x = u.function_space.tabulate_dof_coordinates()
owned = body.mesh.topology.index_map(3).size_local
inside = np.all((x > 1e-9) & (x < 1 - 1e-9), axis=1)

# %% [markdown]
# The random numbers belong to places, not to the numbering, so that any number of ranks starts
# alike.

# %%
throw = np.random.default_rng(0).uniform(-2, 2, (n + 1, n + 1, n + 1, 3)) / n
grid = np.round(x * n).astype(int)
starts = {
    "scrambled": throw[grid[:, 0], grid[:, 1], grid[:, 2]],
    "flattened": np.stack([0 * x[:, 0], 0 * x[:, 0], 0.5 - x[:, 2]], axis=1),
    "mirrored": np.stack([0 * x[:, 0], 0 * x[:, 0], 1 - 2 * x[:, 2]], axis=1),
    "a point": 0.5 - x,
}


def corners():
    """Deformed corners of all cells, on rank 0."""
    cells = u.function_space.dofmap.list[:owned]
    parts = comm.gather((x + u.x.array.reshape(-1, 3))[cells])
    return np.concatenate(parts) if parts else None


# %% [markdown]
# The tangent is projected: where it has directions of negative curvature, of which an inverted cell
# has many, they are flattened out. Near rest the full tangent takes over, and the last steps are
# quadratic.

# %%
shapes, runs, inverted = {}, {}, {}
vtx = forms.VTX(folder / "scramble.bp", u)
for name, d in starts.items():
    u.x.array[:] = np.where(inside[:, None], d, 0).ravel()
    J = forms.field(ufl.det(F), body, degree=0).x.array[:owned]
    inverted[name] = int(comm.allreduce(np.sum(J < 1e-9)))
    shapes[name] = corners()
    path = forms.solve(potential, u, held, projection="always", rtol=1e-10)
    runs[name] = path.steps[0].convergence
    distance = comm.allreduce(np.abs(u.x.array).max(), MPI.MAX)
    say(
        f"{name}: {inverted[name]} flat or inverted cells, {runs[name].sentence()}, "
        f"|u| = {distance:.0e}"
    )
    assert distance < 1e-8 and runs[name].iterations <= 12
vtx(path)
vtx.close()

# %%
if comm.rank == 0:
    figure = plt.figure(figsize=(12, 8))
    edges = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
    for place, (name, cells) in enumerate(shapes.items(), 1):
        axes = figure.add_subplot(2, 4, place, projection="3d")
        for a, b in edges:
            axes.plot(
                *np.insert(cells[:, [a, b]], 2, np.nan, axis=1).reshape(-1, 3).T, "C0", lw=0.25
            )
        axes.set(title=f"{name}: {inverted[name]} cells\nflat or inverted")
        axes.set_axis_off()
    axes = figure.add_subplot(2, 1, 2)
    for name, run in runs.items():
        axes.semilogy(run.residuals, "o-", label=name)
    axes.set(xlabel="Newton iteration", ylabel="out-of-balance force |R| [N]")
    axes.grid(alpha=0.3)
    axes.legend()
    figure.tight_layout()
    figure.savefig(folder / "scramble.png", dpi=100)
counts = {name: run.iterations for name, run in runs.items()}
forms.summary(path, folder / "scramble.json", iterations=counts, inverted=inverted)

# %% [markdown]
# Try next: `projection="never"` (five times the iterations, and the point fails), other seeds, or
# `energies.stable_neo_hookean`, whose cells' matrices are projected although it is plain UFL.
