# SPDX-License-Identifier: MIT
# %% [markdown]
# # 8. Newton's method and the path: converged is not right
#
# You will see a solver converge at every load and end in a body that is not deformed at all, find
# out why nothing in it could notice, and then what does: how fast Newton's corrections shrink, and
# an account of every joule. Along the way: what line search and projection are for, and what to do
# where a path ends.
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
from dolfinx import fem
from IPython.display import Image
from scipy.sparse.linalg import splu

from variform import forms, meshes

plt.rcParams.update({"figure.dpi": 90, "font.size": 9})
comm = MPI.COMM_WORLD

# %% [markdown]
# ## One turn
#
# A block of 1 x 0.2 x 0.2 m is clamped at its left end; its right end is turned by 360 degrees. The
# solver lowers the energy, with a line search, and with a projected tangent where $K$ is
# indefinite: `forms.solve`. Load steps are equal, and each begins, as usual, with the last step
# taken once more, $2u_n - u_{n-1}$.
#
# **Question.** Each step converges to nine digits or more, and at the end $J > 0$ in every point.
# What can be wrong?


# %%
def block():
    """Body, unknown, potential, supports and angle of a block; lengths [m], moduli [Pa]."""
    body = meshes.block(comm, (1.0, 0.2, 0.2), h=0.1)
    u, angle = forms.displacement(body, degree=2), forms.load_factor(body)
    F = forms.deformation_gradient(u)
    potential = forms.energies.fixed_corotated(F, mu=1.0, lmbda=10.0) * ufl.dx
    left = forms.clamp(u, body.facets("left"))
    right = forms.rotate(u, body.facets("right"), angle=angle, axis=(1, 0, 0))
    return body, u, potential, [left, right], angle


def walk(steps):
    """Equal load steps by a solver that lowers the energy: angles, energies, moments, states."""
    body, u, potential, held, angle = block()
    problem = forms.Problem(potential, u, held)
    states, rows = [u.x.array.copy()], [(0.0, 0.0, 0.0)]
    print("degrees  iterations  |R|/level  energy [J]  moment [Nm]  smallest J")
    for turned in np.linspace(0, 2 * np.pi, steps + 1)[1:]:
        angle.value = turned
        if len(states) > 1:
            u.x.array[:] = 2 * states[-1] - states[-2]
        path = forms.solve(problem)
        run = path.steps[0].convergence
        moment = forms.resultant(problem, body.facets("right"))[1][0]
        states.append(u.x.array.copy())
        rows.append((turned, problem.energy(), moment))
        print(
            f"{np.degrees(turned):7.0f}{run.iterations:12d}{run.residual / run.force_level:11.0e}"
            f"{rows[-1][1]:12.6f}{moment:13.6f}{path.steps[0].bounds.lower:12.2f}"
        )
    return np.array(rows).T, states


for steps in (12, 16, 8):  # rounding decides where such a walk leads: the next one is at hand
    try:
        (angles, stored_energy, moments), states = walk(steps)
    except forms.NotConverged as error:
        print(error)
        continue
    if stored_energy[-1] < 0.004:
        break
assert stored_energy[-1] < 0.004

# %% [markdown]
# The block is turned by 360 degrees, and stores nothing (or far less than at half the turn). A face
# turned by 180 degrees is where a face turned by -180 degrees is. So at 180 degrees there are two
# states of the same energy, twisted to the right and to the left, and the iteration, thrown about
# by a long step, may fall into either. Look at the moment: it changes its sign in the middle of a
# turn. From there on "turning further" means untwisting, and a face turned by 360 degrees is where
# it was at the start. In some steps the block may even be crushed, with $J < 0$.
#
# **Why it passed.** $|R|$ is zero to rounding; the energy was lowered in each iteration; no
# eigenvalue is negative. All this is true: the state **is** an equilibrium, and the best of all.
# Nothing that looks at one state can see that it is the wrong one. What is asked for is the state
# that is *connected* with the last one, and that is a matter of the way from one to the next.
#
# ## An account
#
# **Question.** The support does work on the block, $\int M\,d\varphi$. Where should it be found?

# %%
work = np.concatenate([[0], np.cumsum(np.diff(angles) * (moments[1:] + moments[:-1]) / 2)])
missing = np.diff(work) - np.diff(stored_energy)
largest = int(np.abs(missing).argmax())
figure, axis = plt.subplots(figsize=(5.6, 2.4))
axis.plot(np.degrees(angles), 1e3 * work, "C1o-", ms=3, label="work of the support")
axis.plot(np.degrees(angles), 1e3 * stored_energy, "k.-", label="stored")
axis.set(xlabel="angle [degrees]", ylabel="energy [mJ]")
axis.legend()
figure.tight_layout()
plt.show()
print(f"step to {np.degrees(angles[largest + 1]):.0f} degrees: {missing[largest]:+.5f} J missing")
assert np.abs(missing).max() > 0.3 * np.abs(np.diff(stored_energy)).max()

# %% [markdown]
# In the energy, and nowhere else: there is no other place. The trapezoidal rule of a dozen steps is
# good to a few percent, and what is missing is as much as a step stores. An account needs no second
# solution to compare with, and no knowledge of the problem.
#
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
# Both make more starts converge. Neither says *where to*.
#
# ## Orders, and a number that knows the way
#
# The bar is pulled by a force $f$: $R = \ln l/l - f$. Keep the tangent $K_0$ of the start for two
# corrections,
#
# $$\Delta_0 = -K_0^{-1}R(l_0),\qquad \bar\Delta_1 = -K_0^{-1}R(l_0+\Delta_0),\qquad
# \Theta = |\bar\Delta_1|/|\Delta_0|.$$
#
# **Question.** With the kept tangent the errors shrink by a constant factor, with a new one each
# time the number of digits doubles. What does $\Theta$ have to do with either?


# %%
def residual(x, f):
    """Out-of-balance force of the bar of length x under the force f."""
    return np.log(x) / x - f


def tangent(x):
    """Stiffness of the bar."""
    return (1 - np.log(x)) / x**2


def contraction(x, f):
    """Theta of a step from the length x to the force f."""
    first = -residual(x, f) / tangent(x)
    return abs(residual(x + first, f) / tangent(x) / first)


def errors(f, kept, exact, x=1.0):
    """Errors of the length, iteration by iteration."""
    found, K = [], tangent(x)
    for _ in range(6):
        found.append(abs(x - exact))
        x -= residual(x, f) / (K if kept else tangent(x))
    return np.array(found)


for f in (0.05, 0.1, 0.2):
    exact = 1.0
    for _ in range(30):
        exact -= residual(exact, f) / tangent(exact)
    full, kept = errors(f, False, exact), errors(f, True, exact)
    ratio = kept[2] / kept[1]
    print(f"f = {f}: Theta = {contraction(1.0, f):.3f}; kept tangent: factor {ratio:.3f}")
    print("  new tangents: errors", " ".join(f"{e:.0e}" for e in full[:5]))
    assert abs(contraction(1.0, f) / f - 1.5) < 0.4 and ratio < 2.5 * contraction(1.0, f)
    assert full[2] < 3 * full[1] ** 2

# %% [markdown]
# $\Theta$ is half the factor of the kept tangent, and $\Theta|\Delta_0|$ is what a new tangent
# leaves: both orders begin with it. It grows in proportion to the step, so it says how long the
# next step may be. A small $\Theta$ says that $K$ hardly changes over the step: then a solution is
# near, the one that belongs to the start. Beyond 1/2 (Deuflhard's limit) there may be none near,
# and full steps find something, or nothing. So each correction is asked, and a step with a larger
# $\Theta$ is refused before it converges to something.


# %%
def corrected(x, f):
    """Length at the force f by Newton's method from x, and the first Theta; none above 1/2."""
    first = theta = contraction(x, f)
    while theta <= 0.5 and abs(residual(x, f)) > 1e-13:
        x -= residual(x, f) / tangent(x)
        theta = contraction(x, f) if abs(residual(x, f)) > 1e-10 else 0.0
    return (x, first) if theta <= 0.5 else (None, theta)


def march(to, step, aim=0.15):
    """Follow the bar by steps whose contraction is near the aim: forces, lengths, thetas."""
    x, f, rows = 1.0, 0.0, []
    while f < to and step > 1e-8:
        found, theta = corrected(x, min(f + step, to))
        if found is None:
            step /= 2
            continue
        x, f = found, min(f + step, to)
        rows.append((f, x, theta))
        step *= min(2, aim / theta)
    return np.array(rows)


rows = march(to=1.0, step=0.1)
print("   force  length  Theta")
for force, length, theta in rows[:: len(rows) // 6]:
    print(f"{force:8.5f}{length:8.3f}{theta:7.2f}")
print(f"{len(rows)} steps, the last one at {rows[-1, 0]:.6f}; 1/e = {1 / np.e:.6f}")
assert abs(rows[-1, 0] - 1 / np.e) < 1e-5 and np.all(np.diff(rows[:, 1]) > 0)

# %% [markdown]
# The steps shrink to nothing at $f = 1/e$, where $K = 0$: the largest force that this bar bears.
# That is no failure of the method. It is the answer: no state is connected beyond.
#
# ## The path of the block
#
# **Question.** How far may the block be turned in its first step, by $\Theta \le 1/2$? Guess: 36
# degrees, as many take?

# %%
body, u, potential, held, angle = block()
problem = forms.Problem(potential, u, held)
free = np.setdiff1d(np.arange(u.x.array.size), problem.constrained)
K = fem.assemble_matrix(problem.forms.tangent_form).to_scipy().tocsc()
factors = splu(K[free][:, free])


def out_of_balance(state):
    """Residual at a state."""
    u.x.array[:] = state
    return fem.assemble_vector(problem.forms.residual_form).array


def theta_at(turned):
    """Theta of a first step from rest."""
    angle.value = turned
    first = np.zeros_like(u.x.array)
    for support in held:
        support.update()
    for condition in problem.conditions:
        condition.set(first)
    first[free] = -factors.solve((K @ first)[free])  # at rest R = 0
    second = factors.solve(out_of_balance(first)[free])
    return np.linalg.norm(second) / np.linalg.norm(first)


for degrees in (1, 2, 4, 9, 18, 36):
    print(f"{degrees:3d} degrees: Theta = {theta_at(np.radians(degrees)):.3f}")
assert theta_at(np.radians(2)) < 0.5 < theta_at(np.radians(6)) and theta_at(np.radians(36)) > 10

# %% [markdown]
# Four. Points move along straight lines in a correction: half-way to a face turned by 36 degrees a
# cross-section is 5 % too small, and volume is expensive here. The first correction is followed by
# one that is tens of times as long. That a search then finds *some* equilibrium is no merit.
#
# `forms.follow` corrects by plain Newton, without search and projection, sets its steps by
# $\Theta$, and extrapolates through up to six states, so that corrections are small.
#
# **Question.** How many tangents does it take, after the solver above took some hundreds?

# %%
body, u, potential, held, angle = block()
followed = forms.follow(potential, u, held, angle, to=2 * np.pi, progress=False)
print(followed.reason)
print(f"{followed.tangents} tangents, energy {followed.problem.energy():.7f} J")
print("degrees  Theta  tangents  smallest J")
for step in followed.steps:
    run = step.convergence
    print(
        f"{np.degrees(step.load):7.1f}{run.contraction:7.3f}{run.tangents:8d}"
        f"{step.bounds.lower:14.3f}"
    )
assert followed.completed and abs(followed.problem.energy() / 0.0048983 - 1) < 1e-4
assert followed.tangents < 60 and all(
    step.convergence.contraction <= 0.5 for step in followed.steps
)

# %%
print(followed.ledger)
with tempfile.TemporaryDirectory() as folder:
    followed.ledger.plot(name := str(Path(folder) / "ledger.png"))
    shown = Image(name, width=420)
assert followed.ledger.missed < 1e-5 * followed.ledger.exchanged
shown

# %% [markdown]
# `follow` keeps this account at every step, and refuses one whose energy did what loads and
# supports cannot have done; `path.reason` says what is left unaccounted, if it is more than a
# thousandth. `step.bounds` holds the smallest $J$ over whole cells, and `path.events` what was
# passed: nothing here.
#
# ## Where a path ends
#
# **Question.** A shallow arch, clamped at both ends, under a dead load, most of it in the middle.
# There is a largest load. What will `follow` do there, and what would you like?


# %%
def arch(rise=1.6, span=20.0):
    """Unknown, potential, supports and load factor of a sine-shaped arch."""
    body = meshes.block(comm, (span, 1.0), n=(20, 1), cells="quadrilateral")
    x = body.mesh.geometry.x
    x[:, 1] += rise * np.sin(np.pi * x[:, 0] / span) - 0.5
    u, q = forms.displacement(body, 2), forms.load_factor(body)
    X = ufl.SpatialCoordinate(body.mesh)
    load = ufl.as_vector([0 * q, -q * ufl.sin(np.pi * X[0] / span)])
    F = forms.deformation_gradient(u)
    psi = forms.energies.saint_venant_kirchhoff(F, mu=0.5, lmbda=0.0)
    ends = [forms.clamp(u, body.facets(name)) for name in ("left", "right")]
    return u, psi * ufl.dx + forms.body_force(u, load), ends, q


crown = {"crown": lambda problem: -forms.at(problem.u, (10.0, 1.6))[1]}
u, potential, ends, q = arch()
try:
    forms.follow(potential, u, ends, q, to=6e-4, record=crown, progress=False)
except forms.NotConverged as error:
    stopped = error.path
    print(error, "\n")
u, potential, ends, q = arch()
options = {"to": 6e-4, "record": crown, "progress": False}
through = forms.arc_length(potential, u, ends, q, step=2e-5, largest=0.01, **options)
print(through.reason, "\n")
u, potential, ends, q = arch()
jumped = forms.follow(potential, u, ends, q, jump=True, **options)
print(jumped.reason)
limit = next(event.load for event in through.events if event.kind == "limit point")
freed = next(event.released for event in jumped.events if event.kind == "jump")
assert abs(stopped.load / limit - 1) < 0.02 and freed > 0
assert abs(jumped.record("crown")[-1] / through.record("crown")[-1] - 1) < 1e-6

# %%
figure, axis = plt.subplots(figsize=(5.6, 2.6))
for found, style, name in (
    (through, "k.-", "arc_length"),
    (jumped, "C1o--", "follow, jump=True"),
    (stopped, "C0s-", "follow"),
):
    loads = [0.0, *(1e3 * step.load for step in found.steps)]
    axis.plot([0.0, *found.record("crown")], loads, style, ms=4, label=name)
axis.set(xlabel="crown moved down by [m]", ylabel="load factor [10⁻³]")
axis.legend()
figure.tight_layout()
plt.show()

# %% [markdown]
# `follow` stops below the largest load, keeps its state, and says so. If you control the load in an
# experiment, the arch snaps now: `jump=True` lets it, to the state at rest that lies downhill, and
# notes as an event how many joules were set free (they would become sound and heat). If you are
# interested in the way between, `arc_length` walks over the top, and counts the negative
# eigenvalue. All three are right; a solver that arrives at the same state without a word is not.
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
    how = {"projection": projection, "options": {"snes_max_it": 200}}  # "never" wanders
    runs[projection] = forms.solve(potential, u, walls, **how).steps[0].convergence
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
# All three arrive, "never" after three times the iterations or more, by the rounding of the machine
# at hand: its search wanders where $K$ is indefinite. "auto" starts with the full tangent, sees
# after one step that too many eigenvalues are negative, and projects. The last steps are those of
# the full tangent in all three: $|R|$ falls quadratically.
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
# A solve of one state is for such starts: for shapes that have no path to follow, and for the first
# state of one, as of a flat sheet. Its messages name how it stopped, the forces that are left and
# those that they are compared with, and what to do; the full list is in
# [forms/solving](../../forms/solving/README.md).
#
# | Symptom | Cause | Remedy |
# | --- | --- | --- |
# | energy not finite at the start | inverted cells | `follow` from rest; an energy for all $F$ |
# | iterations used up | far away, indefinite tangent | `follow`; `projection="always"` |
# | line search found no lower value | direction leads uphill | `projection="auto"` |
# | "Nothing holds the body …" | a rigid motion is free | a support, a pin, a spring |
# | "no equilibrium is connected beyond" | limit point | `arc_length`, `control`, `jump=True` |
# | "Unaccounted: …" | few long steps, or a jump | `max_step`; look at `path.ledger` |
# | "Unstable …", "Passed: …" | equilibrium, no minimum | `arc_length` along `lowest_modes` |
# | "Cells are inverted …" | no wall at $J = 0$, or coarse cells | finer cells; another energy |
#
# ## Exercises
#
# **Exercise 1.** For which starts $l$ does the plain Newton method of the bar without a force
# return to 1?
#
# <details><summary><b>Solution</b> (click to show it)</summary>
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
# **Exercise 2.** At half the largest force, how long a step may the bar take by $\Theta \le 1/2$?
# And at 99 % of it? What does this say of equal load steps?
#
# <details><summary><b>Solution</b> (click to show it)</summary>
#
# By bisection: 0.32 and 0.012. The last one is longer than what is left of the way: $\Theta$ alone,
# of one step, does not know that there is no solution; the next tangents would. Equal steps are too
# short at one end and too long at the other.
#
# ```python
# def longest(share):
#     x = np.interp(share / np.e, rows[:, 0], rows[:, 1])
#     for _ in range(30):
#         x -= residual(x, share / np.e) / tangent(x)
#     steps = np.linspace(1e-4, 0.5, 5000)
#     return steps[np.argmax([contraction(x, share / np.e + s) > 0.5 for s in steps])]
#
# print(longest(0.5), longest(0.99))
# assert longest(0.99) < longest(0.5) / 10
# ```
# </details>

# %%
# Your answer to exercise 2:

# %% [markdown]
# **Exercise 3.** The account is for every problem. For this one, which point would have told at 180
# degrees that the block was twisted to the wrong side? Check it in the states of both walks.
#
# <details><summary><b>Solution</b> (click to show it)</summary>
#
# One in the middle of the block: it has to have turned half as far as the face, to the same side.
# In the walk of the first section it has not.
#
# ```python
# def half_turn(field):
#     """Angle by which a point in the middle has turned, below 360 degrees."""
#     y, z = np.array([0.1, 0.0]) + forms.at(field, (0.5, 0.2, 0.1))[1:]
#     return np.degrees(np.arctan2(z, y)) % 360
#
# print(f"followed: {half_turn(followed.u):.0f} degrees")
# assert abs(half_turn(followed.u) - 180) < 5
# other = fem.Function(followed.u.function_space)
# other.x.array[:] = states[-1]
# print(f"walked: {half_turn(other):.0f} degrees")
# assert min(half_turn(other), 360 - half_turn(other)) < 90
# ```
# </details>

# %%
# Your answer to exercise 3:
