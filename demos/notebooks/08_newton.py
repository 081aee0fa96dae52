# SPDX-License-Identifier: MIT
# %% [markdown]
# # 8. Newton, projection, line search: why solvers fail and what to do
#
# You will make Newton's method fail in every usual way, first with one and two unknowns, where you
# can see all of it, then with hundreds. You will know what each failure looks like, what it is
# cured by, and when a solver that says "converged" has not found what you wanted.
#
# Before: Newton's method, eigenvalues of symmetric matrices, and notebook 1 (energy, residual $R$,
# tangent $K$).

# %%
import tempfile
from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
import ufl
from IPython.display import Image

from variform import forms, meshes

plt.rcParams.update({"figure.dpi": 90, "font.size": 9})
comm = MPI.COMM_WORLD

# %% [markdown]
# ## One unknown
#
# A bar of length 1 has the energy $\psi(l) = \tfrac12(\ln l)^2$ at the length $l$, least at rest.
# So
#
# $$R = \frac{\ln l}{l}, \qquad K = \frac{1 - \ln l}{l^2}, \qquad \Delta l = -\frac{R}{K}.$$
#
# **Question.** Start at $l = 2$ and at $l = 4$. Where does the first step of Newton's method go?
# Compute both before you read on.


# %%
def stored(x):
    """Energy of the bar; infinite where the bar has no length left."""
    return 0.5 * np.log(x) ** 2 if x > 0 else np.inf


def newton(x, projected, search, floor=0.1):
    """Lengths that Newton's method goes through."""
    lengths = [x]
    while len(lengths) < 30 and 0 < x < 1e3:
        R, K = np.log(x) / x, (1 - np.log(x)) / x**2
        step = -R / (max(K, floor) if projected else K)
        while search and abs(step) > 1e-12 and stored(x + step) > stored(x):
            step /= 2
        x += step
        lengths.append(x)
    return lengths


for start in (2.0, 4.0):
    for projected, search in ((False, False), (False, True), (True, True)):
        found = newton(start, projected, search)
        words = f"projected: {projected!s:5}, search: {search!s:5}"
        print(f"from {start}, {words}:", *(f"{x:.3f}" for x in found[:4]), f"... {found[-1]:.6g}")
        returns = abs(found[-1] - 1) < 1e-9
        assert returns == (projected or (search and start == 2.0))

# %% [markdown]
# From 2 the step is too long: it ends at $l = -2.5$, where the logarithm does not exist. A **line
# search** that takes the energy as its measure and refuses what is not finite halves it, and all is
# well. From 4 the step is in the wrong **direction**: $K < 0$, the step leads uphill,
# $R\,\Delta l = -R^2/K > 0$, and no part of it lowers the energy. The search gets stuck at its
# start. There the tangent has to be replaced by a positive one (**projection**), and the search
# then limits the step.
#
# ## Two unknowns
#
# Two springs join the points $(\pm 1, 0)$ to a node that is at rest in $(0, h)$ and, just as well,
# in $(0, -h)$: a truss that snaps through. In two unknowns projection means: take the eigenvalues
# of $K$ and lift the negative ones.
#
# **Question.** From which places does Newton's method find one of the two states of rest? What else
# can it find, and does a line search alone help?

# %%
h, ends = 0.5, np.array([[-1.0, 0.0], [1.0, 0.0]])
rest = np.hypot(1, h)


def derivatives(x):
    """Energy, residual and tangent of the truss with its node at x, shape (n, 2)."""
    d = x[:, None] - ends
    length = np.linalg.norm(d, axis=-1, keepdims=True)
    n, strain = d / length, length - rest
    nn = n[..., :, None] * n[..., None, :]
    K = nn + (strain / length)[..., None] * (np.eye(2) - nn)
    return (strain**2).sum((1, 2)) / 2, (strain * n).sum(1), K.sum(1)


def directions(R, K, projected):
    """Newton steps, of the tangent itself or of the projected one."""
    values, vectors = np.linalg.eigh(K)
    values = np.maximum(values, 1e-3) if projected else values
    return -np.einsum("nij,nj,nkj,nk->ni", vectors, 1 / values, vectors, R)


def truss(x, projected, search):
    """Where 40 iterations lead to."""
    for _ in range(40):
        energy, R, K = derivatives(x)
        step = directions(R, K, projected)
        for _ in range(30 if search else 0):
            higher = derivatives(x + step)[0] > energy + 1e-15
            step[higher] /= 2
        x = x + (np.where(higher[:, None], 0, step) if search else step)
    return x


# %%
ways = {"full steps": (False, False), "+ line search": (False, True), "+ projection": (True, True)}
plane = np.stack(np.meshgrid(np.linspace(-1.5, 1.5, 151), np.linspace(-1.2, 1.2, 121)), -1)
starts = plane.reshape(-1, 2) + np.array([1e-3, 2e-3])  # off the lines of symmetry
figure, axes = plt.subplots(1, 3, figsize=(7, 2.5), sharey=True)
share, colors = {}, ["#9ecae1", "#fdae6b", "#de2d26"]
for axis, (name, way) in zip(axes, ways.items(), strict=True):
    x = truss(starts, *way)
    R = derivatives(x)[1]
    up, down = (np.linalg.norm(x - (0, y), axis=1) < 1e-6 for y in (h, -h))
    share[name] = np.mean(up | down), np.mean((np.linalg.norm(R, axis=1) < 1e-9) & ~(up | down))
    kind = np.where(up, 0, np.where(down, 1, 2)).reshape(plane.shape[:2])
    axis.contourf(*np.moveaxis(plane, -1, 0), kind, levels=[-0.5, 0.5, 1.5, 2.5], colors=colors)
    axis.plot(*ends.T, "k^", ms=5)
    axis.plot([0, 0], [h, -h], "k.")
    axis.set(xlabel="x [-]", aspect="equal")
    axis.set_title(f"{name}: {share[name][0]:.0%} at rest", fontsize=9)
axes[0].set_ylabel("y [-]")
figure.tight_layout()
plt.show()
_, R, K = derivatives(starts)
uphill = [np.mean(np.sum(R * directions(R, K, p), axis=1) > 0) for p in (False, True)]
print(f"uphill: {uphill[0]:.0%} of Newton's directions, {uphill[1]:.0%} of the projected ones")
for name, (_, other) in share.items():
    print(f"{name}: {other:.0%} end in an equilibrium that is no state of rest")
assert share["+ line search"][0] < share["full steps"][0] < 0.9 and share["full steps"][1] > 0.1
assert share["+ projection"][0] == 1 and uphill[0] > 0.1 and uphill[1] == 0

# %% [markdown]
# Blue starts end at the upper state, orange ones at the lower, red ones at neither. Full steps jump
# about and find, from a fifth of all places, an **unstable equilibrium**: $R = 0$ holds there as
# well, and Newton's method knows nothing but $R$. The line search makes it worse: where the
# direction leads uphill it can only stop. With the projected tangent every direction leads
# downhill, every start ends at rest, though a long step may take it into the other valley.
#
# ## Hundreds of unknowns
#
# The nodes inside a cube are thrown about by up to two cells, its faces held at rest. A third of
# the cells are inverted. `forms.solve` has both remedies; `projection` chooses.
#
# **Question.** What do you expect of `projection="never"`, `"auto"` and `"always"`?

# %%
n = 4
box = meshes.block(comm, (1.0, 1.0, 1.0), n=n)
u = forms.displacement(box)
F = forms.deformation_gradient(u)
walls = [forms.clamp(u, box.facets(*box.boundaries))]
x = u.function_space.tabulate_dof_coordinates()
inside = np.all((x > 1e-9) & (x < 1 - 1e-9), axis=1)
throw = np.where(inside[:, None], np.random.default_rng(0).uniform(-2, 2, x.shape) / n, 0)
potential = forms.energies.fixed_corotated(F, mu=1.0, lmbda=10.0) * ufl.dx
u.x.array[:] = throw.ravel()
J = forms.field(ufl.det(F), box, degree=0).x.array
print(f"{np.sum(J < 0)} of {len(J)} cells are inverted")
assert 0.3 < np.mean(J < 0) < 0.4

# %%
figure, axis = plt.subplots(figsize=(5.6, 2.6))
runs = {}
for projection, style in (("never", "C3s-"), ("auto", "C0o-"), ("always", "C2.--")):
    u.x.array[:] = throw.ravel()
    runs[projection] = forms.solve(potential, u, walls, projection=projection).steps[0].convergence
    print(f"{projection:6s} {runs[projection].sentence()}")
    assert np.abs(u.x.array).max() < 1e-6  # back at rest, within the tolerance of a correction
    axis.semilogy(runs[projection].residuals, style, ms=4, label=projection)
axis.set(xlabel="Newton iteration [-]", ylabel="out-of-balance force |R| [N]")
axis.legend()
figure.tight_layout()
plt.show()
assert runs["auto"].iterations < runs["never"].iterations / 2
assert runs["never"].projected == 0 < runs["auto"].projected

# %% [markdown]
# All three arrive, "never" after about three times the iterations: its search wanders where $K$ is
# indefinite. "auto" starts with the full tangent, sees after one step that too many eigenvalues are
# negative, and projects. The last steps are those of the full tangent in all three: $|R|$ falls
# quadratically.
#
# ## Energies that do not exist everywhere
#
# **Question.** The same start with a neo-Hookean energy, which has $\ln J$ in it? And, from a box
# whose inside is mirrored, symmetric Dirichlet, $\tfrac\mu4\sum(s_i^2 + s_i^{-2} - 2)$, which
# exists for $J < 0$, but not at $J = 0$?

# %%
energies = forms.energies
u.x.array[:] = throw.ravel()
try:
    forms.solve(energies.neo_hookean(F, mu=1.0, lmbda=10.0) * ufl.dx, u, walls)
except forms.NotConverged as error:
    print(message := str(error))
assert "the energy is not finite at the start: cells are inverted there" in message
assert np.array_equal(u.x.array, throw.ravel())  # a solve that fails leaves u as it was

mirror = np.where(inside[:, None], [0.0, 0.0, 1.0] - x * [0.0, 0.0, 2.0], 0.0)  # upside down
for name, term in {
    "symmetric Dirichlet": energies.symmetric_dirichlet(F, mu=1.0),
    "fixed corotated": energies.fixed_corotated(F, mu=1.0, lmbda=10.0),
}.items():
    u.x.array[:] = mirror.ravel()
    path = forms.solve(term * ufl.dx, u, walls)
    least, most = forms.smallest_volume_ratio(F, box.mesh), np.abs(u.x.array).max()
    print(f"\n{name}: {path.reason}\nsmallest J = {least:.2f}, largest |u| = {most:.2g}")
    assert (least < -1 and most > 0.4) if "Dirichlet" in name else most < 1e-6

# %% [markdown]
# The logarithm refuses, which is honest. Symmetric Dirichlet converges, to an equilibrium with
# inverted cells: its infinite wall at $J = 0$ keeps them on the wrong side. **Converged means
# $R = 0$, not right.** Look at the smallest $J$. An energy that is finite and smooth across $J = 0$
# (fixed corotated, `stable_neo_hookean`, `extended(…)`) brings such a start back; a wall is good
# for paths that begin at rest, where the line search keeps $J$ positive at every quadrature point.
#
# ## Too much at once
#
# **Question.** A bar of neo-Hookean rubber is turned by 270 degrees in one step. The supports say
# where the end face goes. Where are the nodes next to it?


# %%
def bar(length=1.0, mu=1.0):
    """Unknown, potential, supports and load factor of a twisted bar; lengths [m], moduli [Pa]."""
    body = meshes.block(comm, (length, length / 4, length / 4), n=(8, 2, 2))
    t, u = forms.load_factor(body), forms.displacement(body)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), mu=mu, lmbda=4 * mu)
    middle = (0, length / 8, length / 8)
    turned = forms.rotate(u, body.facets("right"), angle=t, axis=(1, 0, 0), center=middle)
    return u, psi * ufl.dx, [forms.clamp(u, body.facets("left")), turned], t


u, potential, held, t = bar()
t.value = 1.5 * np.pi
try:
    forms.solve(potential, u, held)
except forms.NotConverged as error:
    print(message := str(error))
assert "not finite" in message and "Reach the load in steps with forms.follow" in message

u, potential, held, t = bar()
path = forms.follow(potential, u, held, t, to=1.5 * np.pi, step=1.5 * np.pi, progress=False)
print(f"\n{path.reason}")
print([(round(np.degrees(s.load)), s.convergence.iterations) for s in path.steps])
assert path.refused > 0 and np.isclose(path.load, 1.5 * np.pi)

u, potential, held, t = bar()
careful = forms.follow(potential, u, held, t, to=1.5 * np.pi, step=0.4, progress=False)
print(f"\n{careful.reason}")
assert careful.refused == 0

# %% [markdown]
# The nodes next to the face are still at rest, so the outermost cells are inverted before the first
# iteration. `follow` halves a step that fails, starts again from the last converged state, guesses
# the next one by extrapolation, and lets the steps grow again after easy ones. The list shows
# degrees and iterations. With a first step of 23 degrees nothing is refused, and the sum of the
# iterations is hardly larger; those of refused steps are not in it.
#
# ## Converged to what?
#
# **Question.** A dead load presses the bar along its axis. The straight bar is an equilibrium under
# any load. Will Newton's method tell you that the bar buckles?

# %%
body = meshes.block(comm, (1.0, 0.25, 0.25), n=(8, 2, 2))
u = forms.displacement(body)
psi = forms.energies.neo_hookean(forms.deformation_gradient(u), mu=1.0, lmbda=4.0)
press = forms.dead_traction(u, ufl.as_vector([-0.15, 0, 0]), body.ds("right"))
clamped = [forms.clamp(u, body.facets("left"))]
found = {}
for projection in ("never", "auto"):
    u.x.array[:] = 0
    path = forms.solve(psi * ufl.dx + press, u, clamped, projection=projection)
    energy = forms.integral(psi * ufl.dx + press)
    tip = forms.at(u, (1.0, 0.125, 0.125))
    found[projection] = energy, forms.negative_eigenvalues(path)
    print(f"{projection}: {path.reason}\n  tip moves by {tip.round(3)}, energy {energy:.5f} J\n")
assert found["never"][1] > 0 == found["auto"][1] and found["auto"][0] < found["never"][0]
with tempfile.TemporaryDirectory() as folder:
    forms.picture(path, name := str(Path(folder) / "bar.png"), label="|u| [m]", size=(600, 320))
    shown = Image(name)
shown

# %% [markdown]
# "never" is done after a few iterations, in the state that is pressed but hardly bent, and the
# sentence says *unstable*: read it. "auto" found nothing lower along its direction, projected, and
# fell sideways into the buckled state, whose energy is far lower. That took some fifty iterations:
# the way through a flat valley is long. For the load at which it happens use a path
# (`forms.follow`, `forms.arc_length`) and its negative eigenvalues.
#
# ## What is small?
#
# **Question.** A tolerance $|R| < 10^{-8}$: newtons or millinewtons? Your colleague computes in mm
# and kPa, you in m and Pa. Who iterates longer?

# %%
paths = []
for length, mu in ((1.0, 5e5), (1e3, 5e2)):  # m, Pa and N; mm, kPa and mN
    u, potential, held, t = bar(length, mu)
    paths.append(forms.follow(potential, u, held, t, to=1.0, progress=False))
for path, unit in zip(paths, ("N", "mN"), strict=True):
    last = path.steps[-1].convergence
    counts = [step.convergence.iterations for step in path.steps]
    print(counts, f"|R| = {last.residual:.0e} {unit}, force level {last.force_level:.2e} {unit}")
one, other = (np.array([s.convergence.iterations for s in p.steps]) for p in paths)
assert np.array_equal(one, other)
assert np.allclose(paths[0].u.x.array, paths[1].u.x.array / 1e3, atol=1e-10)

# %% [markdown]
# Neither. Two numbers decide, and both are ratios: $|R|$ over the forces at work (reactions, or the
# imbalance that the load step made) and the last correction over the size of the model. A residual
# alone says nothing: it is small in a soft body, far from its equilibrium.
#
# ## Read the message
#
# **Question.** What is wrong with this model?

# %%
plate = meshes.block(comm, (1.0, 1.0), n=4)
u = forms.displacement(plate)
psi = forms.energies.neo_hookean(forms.deformation_gradient(u), mu=1.0, lmbda=2.0)
pull = forms.dead_traction(u, ufl.as_vector([0.0, -0.1]), plate.ds("right"))
wall = [forms.roller(u, plate.facets("left"), 0)]
try:
    forms.solve(psi * ufl.dx + pull, u, wall)
except forms.NotConverged as error:
    print(message := str(error))
assert "Nothing holds the body against translation along y" in message

# %% [markdown]
# **Question.** And here, the bar under twenty times the load, with `projection="never"`?

# %%
u = forms.displacement(body)
F = forms.deformation_gradient(u)
press = forms.dead_traction(u, ufl.as_vector([-3.0, 0, 0]), body.ds("right"))
potential = forms.energies.neo_hookean(F, mu=1.0, lmbda=4.0) * ufl.dx + press
clamped = [forms.clamp(u, body.facets("left"))]
try:
    forms.solve(potential, u, clamped, projection="never")
except forms.NotConverged as error:
    print(message := str(error))
assert "the line search found no lower value" in message or "used up" in message
path = forms.solve(potential, u, clamped)
print(f"\n{path.reason}")
assert path.completed and path.steps[0].convergence.projected > 0

# %% [markdown]
# Stuck: the search went by $|R|$, which stops falling where nothing is in equilibrium; projection
# is the way out. Each message names in turn: how it stopped, after how many iterations, by which
# ways; the forces that are left and those that they are compared with; the last correction; what
# was kept; what to do. The full list is in [forms/solve](../../forms/solving/README.md).
#
# | Symptom | Cause | Remedy |
# | --- | --- | --- |
# | energy not finite at the start | inverted cells | `follow` from rest; an energy for all $F$ |
# | iterations used up | far away, indefinite tangent | `follow`; `projection="always"` |
# | line search found no lower value | direction leads uphill | `projection="auto"` |
# | "Nothing holds the body …" | a rigid motion is free | a support, a pin, a spring |
# | steps halved to nothing at a load | limit point | `control`, `arc_length` (notebook 7) |
# | converged, "Unstable …" | equilibrium, no minimum | `arc_length` along `lowest_modes` |
# | converged, smallest $J < 0$ | no wall at $J = 0$, or behind it | check $J$; another energy |
#
# ## Exercises
#
# **Exercise 1.** For which starts $l$ does the plain Newton method of the first section return to
# 1?
#
# <details><summary>Solution</summary>
#
# The step keeps $l$ positive if $1 - \ln l/(1 - \ln l) > 0$, so $\ln l < 1/2$: up to
# $l = \sqrt e = 1.649$. All shorter bars return, too.
#
# ```python
# assert abs(newton(1.64, False, False)[-1] - 1) < 1e-9 and newton(1.66, False, False)[-1] < 0
# assert abs(newton(0.2, False, False)[-1] - 1) < 1e-9
# ```
# </details>

# %% [markdown]
# **Exercise 2.** Press the buckling bar with the St Venant-Kirchhoff energy and a load of 1 Pa.
# What did it converge to?
#
# <details><summary>Solution</summary>
#
# This energy has no wall at $J = 0$ and even softens under compression: the bar collapses through
# itself, and that is an equilibrium. The smallest J is negative.
#
# ```python
# u.x.array[:] = 0
# press = forms.dead_traction(u, ufl.as_vector([-1.0, 0, 0]), body.ds("right"))
# soft = forms.energies.saint_venant_kirchhoff(F, mu=1.0, lmbda=4.0) * ufl.dx + press
# assert forms.solve(soft, u, clamped).completed
# assert forms.smallest_volume_ratio(F, body.mesh) < -0.5
# ```
# </details>
