# SPDX-License-Identifier: MIT
# %% [markdown]
# # 11. Contact: what does a barrier do?
#
# A body must not pass through a wall: an inequality, and this package only has potentials. A
# barrier makes one of the other, an energy that grows beyond all bounds towards the wall. You will
# see how far from the wall a body stays, what error that makes beside Hertz's solution and how it
# falls with the reach of the barrier, why no step jumps over an obstacle however long it is, what
# friction adds when the body moves, and a surface that meets itself.
#
# Before: notebook 1, an energy and its derivatives; for friction notebook 10.

# %%
from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
import ufl
from scipy.optimize import brentq

from variform import forms, meshes
from variform.forms import contact, dissipation, obstacles

plt.rcParams.update({"figure.dpi": 90, "font.size": 9})
comm = MPI.COMM_WORLD

# %% [markdown]
# ## An energy that keeps its distance
#
# With the distance $d$ from the wall, its reach $\hat d$ (`dhat`), $y = d/\hat d$ and a pressure
# $k$, per area of the boundary
#
# $$b(d) = -k\,\hat d\,(y - 1)^2 \ln y \quad (0 < y < 1), \qquad b = 0 \quad (y \ge 1) .$$
#
# **Question.** A block lies on a floor and is pressed on by $q$. How far from the floor does it
# rest, and what has its stiffness to do with it?
#
# Nothing: the barrier's pressure $-b'(d) = k\,((1 - y)^2/y - 2\,(1 - y)\ln y)$ has to carry $q$,
# one equation for $d$. Where it is met, in units of $\hat d$, depends on $q/k$ alone. The block
# between rollers, solved, beside the root:


# %%
def pressure(y):
    """-b'(d) over k."""
    return (1 - y) ** 2 / y - 2 * (1 - y) * np.log(y)


def gap_of(q):
    """Distance over dhat at which the pressure over k is q."""
    return brentq(lambda y: pressure(y) - q, 1e-6, 1.0, xtol=1e-15)


def rests(q, mu, k=1.0, dhat=0.02):
    """Distance over dhat of a block of shear modulus mu that is pressed by q on a floor."""
    body = meshes.block(comm, (1.0, 1.0), n=1, cells="quadrilateral", origin=(0.0, 0.9 * dhat))
    u, t = forms.displacement(body), forms.load_factor(body)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), mu, 2 * mu)
    floor = obstacles.plane((0, 0), (0, 1))
    potential = psi * ufl.dx + forms.obstacle(u, floor, body.ds("bottom"), dhat=dhat, stiffness=k)
    potential += forms.dead_traction(u, ufl.as_vector([0, -q * t]), body.ds("top"))
    held = [forms.roller(u, body.facets("left", "right"), 0)]
    path = forms.follow(potential, u, held, t, rtol=1e-12, ctol=1e-10, progress=False)
    return path.steps[-1].clearance.distance / dhat


loads = (0.1, 1.0, 10.0)
gaps = {mu: [rests(q, mu) for q in loads] for mu in (20.0, 200.0)}
for n, q in enumerate(loads):
    print(f"q = {q:4} k: root {gap_of(q):.6f} dhat, solves", [f"{g[n]:.6f}" for g in gaps.values()])
    assert all(abs(g[n] / gap_of(q) - 1) < 1e-6 for g in gaps.values())

y = np.linspace(0.02, 1.2, 400)
inside = np.where(y < 1, y, 1.0)
figure, axes = plt.subplots(1, 2, figsize=(8, 3.0), sharex=True)
axes[0].plot(y, -((inside - 1) ** 2) * np.log(inside))
axes[0].set(xlabel="d / dhat", ylabel="b / (k dhat)")
axes[1].semilogy(y, np.where(y < 1, pressure(inside), np.nan))
axes[1].semilogy(gaps[20.0], loads, "ko", label="solved")
axes[1].set(xlabel="d / dhat", ylabel="pressure / k", ylim=(1e-3, 1e2))
axes[1].legend()
figure.tight_layout()
plt.show()

# %% [markdown]
# A hundred times the load brings the block from $0.83\,\hat d$ to $0.12\,\hat d$, and none brings
# it to 0: the block never touches. So a barrier errs by a length, some tenths of $\hat d$, and
# always to the same side. At $\hat d$ energy, pressure and stiffness are zero, so Newton's method
# feels no switch.
#
# ## Hertz, and the error
#
# A cylinder of radius 1 on a plane, linearly elastic, in plane strain. Hertz: under a force $P$ the
# half-width is $a = \sqrt{4 P R / (\pi E^*)}$ and the pressure $p_0 \sqrt{1 - (x/a)^2}$ with
# $p_0 = 2P/(\pi a)$. Half of it is meshed, with cells of size $h$ where it touches, ten on the
# half-width.


# %%
a0, per = 0.05, 10
h, E, nu = a0 / per, 1.0, 0.3


def graded(fine, length, ratio=1.25):
    """Coordinates of nodes: h apart up to fine, then farther and farther."""
    x, d = list(np.arange(0, fine + h / 2, h)), h
    while x[-1] < length:
        d *= ratio
        x.append(x[-1] + d)
    return np.array(x)


def hertz(reach):
    """Body, pressure, force of the half, of a cylinder pressed on a plane; dhat = reach h."""
    x, y = graded(2 * a0, 20 * a0), graded(a0, 20 * a0)
    n = len(x) - 1, len(y) - 1
    body = meshes.block(comm, (float(n[0]), float(n[1])), n=n, cells="quadrilateral")
    X = body.mesh.geometry.x
    X[:, 0] = np.interp(X[:, 0], np.arange(len(x)), x)
    height = np.interp(X[:, 1], np.arange(len(y)), y)
    X[:, 1] = height + X[:, 0] ** 2 / 2 * (1 - height / y[-1])
    u, t = forms.displacement(body), forms.load_factor(body)
    e = ufl.sym(forms.deformation_gradient(u)) - ufl.Identity(3)
    psi = E / (2 * (1 + nu)) * (ufl.inner(e, e) + nu / (1 - 2 * nu) * ufl.tr(e) ** 2)
    floor, dhat = obstacles.plane((0, 0), (0, 1)), reach * h
    wall = forms.obstacle(u, floor, body.ds("bottom"), dhat=dhat, gap=dhat)
    down = forms.translate(u, body.facets("top"), (None, -0.0045 * t))
    held = [forms.roller(u, body.facets("left"), 0), down]
    path = forms.follow(psi * ufl.dx + wall, u, held, t, progress=False)
    support = forms.resultant(path, body.facets("top"))[0][1]
    force = -contact.force(path)[1]
    assert abs(support / force + 1) < 1e-8
    return body, contact.pressure(path), force


def width(body, p, force):
    """Half-width by the second moment of the pressure, over Hertz's at this force."""
    x, ds = ufl.SpatialCoordinate(body.mesh)[0], body.ds("bottom", degree=6)
    second = forms.integral(p * x**2 * ds) / forms.integral(p * ds)
    return 2 * np.sqrt(second) / np.sqrt(8 * force / (np.pi * E / (1 - nu**2)))


# %% [markdown]
# **Question.** Reaches of $h$ and of $h/8$. Which pressure is lower in the middle, and which goes
# out too far?

# %%
reaches = (1.0, 0.5, 0.25, 0.125, 0.0625)
found = {reach: hertz(reach) for reach in reaches}
x = np.linspace(0, 1.6, 200)
plt.plot(x, np.sqrt(np.maximum(1 - x**2, 0)), "k", lw=0.8, label="Hertz")
peaks = {}
for reach, mark in ((1.0, "s-"), (0.125, "o-")):
    body, p, force = found[reach]
    a = np.sqrt(8 * force / (np.pi * E / (1 - nu**2)))
    p0 = 4 * force / (np.pi * a)
    nodes = p.function_space.tabulate_dof_coordinates()
    bottom = np.flatnonzero(np.abs(nodes[:, 1] - nodes[:, 0] ** 2 / 2) < 1e-9)
    bottom = bottom[np.argsort(nodes[bottom, 0])]
    plt.plot(nodes[bottom, 0] / a, p.x.array[bottom] / p0, mark, ms=3, label=f"dhat = {reach} h")
    peaks[reach] = p.x.array.max() / p0
plt.xlim(0, 1.6)
plt.xlabel("x / a")
plt.ylabel("p / p0")
plt.legend()
plt.show()
print({reach: round(float(peak), 3) for reach, peak in peaks.items()})
assert peaks[1.0] < peaks[0.125] and abs(peaks[0.125] - 1) < 0.02

# %% [markdown]
# The wide barrier carries where there should be no contact yet, and less in the middle. Below zero
# beside the edge is the drawing's fault: nodal forces, which push only, as a function of degree 1.
#
# **Question.** By what falls the error of the half-width as `dhat` is halved? And where does that
# end?

# %%
widths = np.array([width(*found[reach]) for reach in reaches])
for reach, w in zip(reaches, widths, strict=True):
    print(f"dhat = {reach:6} h: half-width {100 * (w - 1):+.2f} %")
changes = -np.diff(widths)
rates = np.log2(changes[:-1] / changes[1:])
print("rates of the changes:", rates.round(2))
plt.loglog(reaches, np.abs(widths - 1), "o-", label="from Hertz")
plt.loglog(reaches, (widths[0] - 1) * np.array(reaches), "k", lw=0.8, label="slope 1")
plt.xlabel("dhat / h")
plt.ylabel("relative error of the half-width")
plt.legend()
plt.show()
assert np.all(np.abs(rates - 1) < 0.2) and abs(widths[-1] - 1) < 0.005

# %% [markdown]
# A barrier is a method of first order in $\hat d$, until only the mesh's own error is left, some
# tenths of a percent and here of the other sign: the curve dives below the line and would end in a
# plateau. At `dhat = h/10`, the default, both are below one percent. A smaller $\hat d$ costs
# iterations and buys nothing; a finer mesh brings its smaller $\hat d$ along.
#
# ## Why no step tunnels
#
# A soft beam falls on a pin that is thinner than a cell is long. Its load is applied in one solve.
#
# **Question.** The pin stands halfway between the beam and where it would come to rest without one.
# Of a step that goes there straight away, start and end are both in the free: what would a check of
# distances at its end find?


# %%
def falls(pin=None, **options):
    """Places of the beam's lower nodes after one solve; the path; beam of 20 cells of 0.05 m."""
    body = meshes.block(comm, (1.0, 0.1), n=(20, 2), cells="quadrilateral")
    u = forms.displacement(body)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 10.0, 20.0)
    potential = psi * ufl.dx + forms.gravity(u, 0.2, g=1.0)
    if pin is not None:
        disk = obstacles.sphere(*pin)
        potential += forms.obstacle(u, disk, body.ds("bottom"), dhat=5e-3, **options)
    path = forms.solve(potential, u, [forms.clamp(u, body.facets("left"))])
    X = u.function_space.tabulate_dof_coordinates()
    lower = np.flatnonzero(np.isclose(X[:, 1], 0))
    lower = lower[np.argsort(X[lower, 0])]
    return X[lower, :2] + u.x.array.reshape(-1, 2)[lower], path


free, _ = falls()
start, end = np.array([0.8, 0.0]), free[16]
pin = tuple(map(float, (start + end) / 2)), 0.02
held, path = falls(pin)
ways = start + np.linspace(0, 1, 400)[:, None] * (end - start)
along = np.linalg.norm(ways - pin[0], axis=1) - pin[1]
print(f"distance of the node at 0.8: {along[0]:.3f} m, on its way {along.min():.3f} m,", end=" ")
print(f"at the end {along[-1]:.3f} m")
closest = path.steps[-1].clearance
print(f"with the pin: {closest.distance:.5f} m from the {closest.obstacle}")
turn = np.linspace(0, 2 * np.pi, 60)
plt.plot(*free.T, label="no pin")
plt.plot(*held.T, label="pin")
plt.fill(pin[0][0] + pin[1] * np.cos(turn), pin[0][1] + pin[1] * np.sin(turn), "k")
plt.axis("equal")
plt.legend()
plt.show()
assert along[0] > 0.1 and along[-1] > 0.1 and along.min() < -0.9 * pin[1]
assert 0 < closest.distance < 5e-3
assert np.all(np.linalg.norm(held - pin[0], axis=1) > pin[1])

# %% [markdown]
# Nothing: it would accept the step. Therefore a step is checked over its whole way: bounds of the
# distance on intervals of places, halved until they decide, and the step is shortened so that each
# point of the integral keeps a tenth of its distance. `step.clearance` is the smallest one at the
# end, where, and from which obstacle.
#
# ## Friction in motion
#
# A block of 80 kg/m lies on a slope, $\mu = 0.5$. Friction is a dissipation potential,
# $\mu p\,|v_T|$ with a round tip below the speed $e$, added to the step in time as viscosity is.
#
# **Question.** For slopes with $\tan\alpha = 0.8\,\mu$ and $1.5\,\mu$: how fast is the block after
# half a second, and where are the joules?


# %%
mu, g, rho, area = 0.5, 9.81, 1000.0, 0.08


def block_on_floor():
    """Time, displacement, energy, contact, and a pin for the start of a block on y = 0."""
    body = meshes.block(comm, (0.4, 0.2), n=(4, 2), cells="quadrilateral", origin=(0, 0.003))
    t, u = forms.load_factor(body), forms.displacement(body)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1e6, 2e6) * ufl.dx
    plane = obstacles.plane((0, 0), (0, 1))
    floor = forms.obstacle(u, plane, body.ds("bottom"), dhat=0.005, stiffness=2e5)
    return t, u, psi, floor, forms.pin(u, (0, 0.003), axes=[0])


def slide(ratio, to=0.5):
    """Angle and motion from rest on a slope of tan(angle) = ratio mu."""
    t, u, psi, floor, pin = block_on_floor()
    angle = np.arctan(ratio * mu)
    pressed = psi + floor + forms.gravity(u, rho * np.cos(angle), g)
    forms.solve(pressed, u, pin)
    pull = forms.gravity(u, rho * np.sin(angle) * forms.table(t, [0, 0.05], [0, 1]), g, (1, 0))
    damped = [*forms.friction(floor, mu, 1e-3), dissipation.kelvin_voigt(2e3)]
    return angle, forms.transient(
        pressed + pull, u, (), t, to=to, rho=rho, scheme="bdf2", dissipation=damped, progress=False
    )  # fmt: skip


speeds = {}
for ratio in (0.8, 1.5):
    angle, path = slide(ratio)
    times = np.array([step.load for step in path.steps])
    speed = path.record("momentum")[:, 0] / (rho * area)
    lost = np.cumsum([row.dissipated for row in path.ledger])
    moved = path.u.x.array.reshape(-1, 2)[:, 0].mean()
    work = mu * rho * area * g * np.cos(angle) * moved
    plt.plot(times, speed, ".-", label=f"tan = {ratio} mu")
    speeds[ratio] = speed[-1]
    print(f"{ratio} mu: {speed[-1]:.2e} m/s, dissipated {lost[-1]:.3g} J/m")
    if ratio > 1:
        print(f"friction's force times the path: {work:.3g} J/m")
        print(forms.ledger.Ledger(path.ledger[-3:]))
        rate = g * (np.sin(angle) - mu * np.cos(angle))
        plt.plot(times, rate * np.maximum(times - 0.05 * 5 / 6, 0), "k", lw=0.8, label="rigid")
        later = times > 0.25
        assert abs(np.polyfit(times[later], speed[later], 1)[0] / rate - 1) < 0.02
        assert abs(lost[-1] / work - 1) < 0.02
    assert path.ledger.missed < 2e-3 * path.ledger.exchanged
plt.xlabel("t [s]")
plt.ylabel("speed [m/s]")
plt.legend()
plt.show()
assert abs(speeds[0.8] / 0.553e-3 - 1) < 0.05 and speeds[1.5] > 0.8

# %% [markdown]
# The first one creeps, slower than $e$: that is what sticking is here, $2y - y^2 = 0.8$ at
# $y = v/e = 0.55$. The second slides with $g(\sin\alpha - \mu\cos\alpha)$, and the column
# `dissipated` adds up to friction's force times the path, and a percent that the viscosity takes as
# the block rocks.
#
# ## A surface that meets itself
#
# A soft ring is crushed between two plates until its inner face lies on itself.
#
# **Question.** The plates are formulas, the inner face is not: its distance from itself is the
# solution. What takes the place of $d$?
#
# All pairs of a point and a segment that come nearer than $\hat d$, found anew at each state, each
# with a barrier of that kind: `forms.touching`, a term in a list beside the potential.

# %%
n = 48
angles = np.linspace(0, 2 * np.pi, n, endpoint=False)
points = np.array([[r * np.cos(a), r * np.sin(a)] for a in angles for r in (0.9, 1.0)])
k, after = np.arange(n), (np.arange(n) + 1) % n
cells = np.stack([2 * k, 2 * k + 1, 2 * after + 1, 2 * after], axis=1)
names = {"inner": 2 * k, "outer": 2 * k + 1}
ring = meshes.from_arrays(comm, points, cells, cell="quadrilateral", boundaries=names)
t, u = forms.load_factor(ring), forms.displacement(ring)
psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0) * ufl.dx
psi += 5e-5 * ufl.inner(u, u) * ufl.dx  # nothing else holds it sideways
for sign in (1, -1):
    plate = obstacles.plane((0, sign * (1.005 - 0.88 * t)), (0, -sign))
    psi += forms.obstacle(u, plate, ring.ds("outer"), dhat=0.01, stiffness=1.0)
itself = forms.touching(u, ring.ds("inner"), stiffness=1.0, dhat=0.02)
stops, states = [0.4, 0.8, 1.0], []


def keep(path):
    """The deformed cells at the stops."""
    if path.load in stops:
        V = u.function_space
        x = V.tabulate_dof_coordinates()[:, :2] + u.x.array.reshape(-1, 2)
        states.append(x[V.dofmap.list[:, [0, 1, 3, 2]]])


path = forms.follow([psi, itself], u, [], t, to=stops, on_step=keep, progress=False)
figure, axes = plt.subplots(1, 3, figsize=(8, 2.4), sharex=True, sharey=True)
for axis, quads, stop in zip(axes, states, stops, strict=True):
    for quad in quads:
        axis.fill(*quad.T, facecolor="C0", edgecolor="k", lw=0.4)
    for sign in (1, -1):
        axis.axhline(sign * (1.005 - 0.88 * stop), color="k", lw=0.8)
    axis.set(aspect="equal", title=f"t = {stop}")
figure.tight_layout()
plt.show()
inner = itself.surface.places()
print(f"inner face {np.ptp(inner[:, 1]):.3f} high, {np.ptp(inner[:, 0]):.2f} wide,", end=" ")
print(f"smallest J {min(step.bounds.lower for step in path.steps):.2f}")
assert path.completed and itself.certified() and itself.near() and np.ptp(inner[:, 1]) < 0.1
assert all(step.bounds.lower > 0 and step.clearance.distance > 0 for step in path.steps)

# %% [markdown]
# ## Exercises
#
# **Exercise 1.** Near $\hat d$ the pressure is about $3k(1 - y)^2$. What does a load of $q \ll k$
# leave as a gap, and how stiff is the barrier there?
#
# <details><summary><b>Solution</b> (click to show it)</summary>
#
# $1 - y = \sqrt{q/(3k)}$, and the stiffness $-dp/dd = 6k(1 - y)/\hat d = 2\sqrt{3kq}/\hat d$: it is
# as soft as the load is small, which is why contact begins without a jolt.
#
# ```python
# for q in (1e-4, 1e-6):
#     assert abs((1 - gap_of(q)) / np.sqrt(q / 3) - 1) < 2 * np.sqrt(q)
#     stiff = (pressure(gap_of(q) - 1e-7) - pressure(gap_of(q) + 1e-7)) / 2e-7
#     assert abs(stiff / (2 * np.sqrt(3 * q)) - 1) < 3 * np.sqrt(q)
# ```
# </details>

# %% [markdown]
# **Exercise 2.** Distances are looked at in points: nodes and middles of edges, here. Which pin can
# pass through the beam, and what helps?
#
# <details><summary><b>Solution</b> (click to show it)</summary>
#
# One that fits between two points with its radius and `dhat`. `parts=` sets more points.
#
# ```python
# thin = (0.8125, -0.15), 2e-4
# fallen, _ = falls(thin)
# stopped, path = falls(thin, parts=8)
# assert np.abs(fallen - free).max() < 1e-6
# assert stopped[16, 1] > -0.16 > free[16, 1] and path.steps[-1].clearance.distance > 0
# ```
# </details>

# %%
# Your answer to exercise 2:

# %% [markdown]
# **Exercise 3.** Throw the block along a level floor at 1 m/s. How far does it get?
#
# <details><summary><b>Solution</b> (click to show it)</summary>
#
# $v^2/(2 \mu g) = 0.10$ m, whatever its mass.
#
# ```python
# t, u, psi, floor, pin = block_on_floor()
# pressed = psi + floor + forms.gravity(u, rho, g)
# forms.solve(pressed, u, pin)
# rest = u.x.array.reshape(-1, 2)[:, 0].mean()
# damped = [*forms.friction(floor, mu, 1e-3), dissipation.kelvin_voigt(2e3)]
# thrown = forms.transient(
#     pressed, u, (), t, to=0.4, rho=rho, scheme="bdf2", dissipation=damped,
#     velocity=ufl.as_vector([1.0, 0.0]), progress=False,
# )
# way = u.x.array.reshape(-1, 2)[:, 0].mean() - rest
# assert abs(way * 2 * mu * g - 1) < 0.02
# ```
# </details>

# %%
# Your answer to exercise 3:
