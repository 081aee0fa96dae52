# SPDX-License-Identifier: MIT
# %% [markdown]
# # 10. Motion: why does implicit Euler calm everything?
#
# A step in time is a minimization, like equilibrium: of the potential, plus inertia as a spring
# that pulls to where the body would go freely. Which spring, says the scheme. You will let a beam
# swing by four of them, see what each makes of its energy, how exact it is and what that costs,
# and find out where the joules go that implicit Euler loses.
#
# Before: notebook 1, Newton's second law. Times are those of the machine that ran the notebook; no
# number in the text is one of them.

# %%
import time

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
import ufl
from IPython.display import Image

from variform import forms, meshes
from variform.forms import dissipation
from variform.forms.files.animations import Animation

plt.rcParams.update({"figure.dpi": 90, "font.size": 9})
comm = MPI.COMM_WORLD

# %% [markdown]
# ## A step is a minimization
#
# **Question.** Implicit Euler asks for $u$ with $v = (u - u_n)/\Delta t$ and
# $\rho\,(v - v_n)/\Delta t = -\Pi'(u)$. Of which functional is that the stationary point?
#
# Put the first into the second: $\rho\,(u - u_n - \Delta t\,v_n)/\Delta t^2 + \Pi'(u) = 0$. With
# $u^* = u_n + \Delta t\,v_n$, the place where the body would be without forces,
#
# $$\min_u\; \Pi(u) + \frac{1}{2\,\Delta t^2} \int \rho\,|u - u^*|^2\,dX .$$
#
# Other schemes have another $u^*$ and another factor $c$ in place of $1/\Delta t^2$. The smaller
# the step, the stiffer the spring: the sum is convex however bad $\Pi$ is, and Newton's method
# needs two or three iterations.
#
# By hand for one mass on a spring, $\Pi = k u^2/2$, against the closed motion:


# %%
def by_hand(dt, to, k=1.0, rho=1.0):
    """A mass let go at 1, by minimizing k u^2 / 2 + rho / (2 dt^2) (u - u*)^2 in each step."""
    u, v, found = 1.0, 0.0, [1.0]
    for _ in range(round(to / dt)):
        star = u + dt * v
        new = (rho / dt**2) * star / (k + rho / dt**2)
        u, v = new, (new - u) / dt
        found.append(u)
    return np.array(found)


for dt in (0.4, 0.2, 0.1):
    u = by_hand(dt, 20.0)
    plt.plot(dt * np.arange(len(u)), u, label=f"implicit Euler, dt = {dt}")
t = np.linspace(0, 20, 400)
plt.plot(t, np.cos(t), "k", lw=0.8, label="cos t")
plt.legend()
plt.xlabel("t")
plt.show()

# Each step multiplies the amplitude by 1 / sqrt(1 + (omega dt)^2).
amplitude = np.abs(by_hand(0.1, 20 * np.pi))
assert abs(amplitude[-1] / (1 + 0.1**2) ** (-len(amplitude) / 2) - 1) < 0.2

# %% [markdown]
# The amplitude falls by $1/\sqrt{1 + (\omega\,\Delta t)^2}$ a step, the faster the vibration the
# faster. Nothing in the model does that: it is the scheme.
#
# ## A beam that swings
#
# A soft beam is let go and falls about its clamp.

# %%
body = meshes.block(comm, (1.0, 0.1), n=(10, 1), cells="quadrilateral")
t, u = forms.load_factor(body), forms.displacement(body, 2)
psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 4e5, 6e5)
potential = psi * ufl.dx + forms.gravity(u, 1000.0, 4.0)
clamp = forms.clamp(u, body.facets("left"))
tip = (1.0, 0.05)


def swing(scheme, energy=potential, **options):
    """The motion of four seconds from rest."""
    u.x.array[:], t.value = 0, 0
    options = {"to": 4.0, "rho": 1000.0, "progress": False, **options}
    record = {"tip": lambda problem: forms.at(u, tip)}
    return forms.transient(energy, u, clamp, t, scheme=scheme, record=record, **options)


movie = Animation("swing.gif", every=0.1)
path = swing("newmark", on_step=movie)
movie.close()
print(path.reason)
Image("swing.gif")

# %% [markdown]
# **Question.** The ledger of a motion has a row a step: what was stored, what moves, what was
# dissipated, what the scheme itself lost. The beam is elastic and the clamp does no work. Which
# columns must add up to zero?

# %%
print(forms.ledger.Ledger(path.ledger[-3:]))
account = path.ledger
print(f"unaccounted: {account.missed / account.exchanged:.1e} of what is exchanged")
assert account.missed < 1e-3 * account.exchanged
assert abs(sum(row.scheme for row in account)) < 1e-6 * account.exchanged

# %% [markdown]
# ## Four schemes, one step
#
# **Question.** With the same step of 20 ms: whose energy falls, whose wavers, whose stays?

# %%
figure, axes = plt.subplots(1, 2, figsize=(9, 3.2), sharex=True)
lost = {}
for scheme in ("euler", "bdf2", "newmark", "midpoint"):
    path = swing(scheme, dt=0.02)
    times = [step.load for step in path.steps]
    energy = np.cumsum([row.stored + row.kinetic for row in path.ledger])
    axes[0].plot(times, path.record("tip")[:, 1], label=scheme)
    axes[1].plot(times, energy, label=scheme)
    lost[scheme] = sum(row.scheme for row in path.ledger)
    print(f"{scheme:10} lost by the scheme: {lost[scheme]:9.3g} J/m")
axes[0].set(xlabel="t [s]", ylabel="tip [m]")
axes[1].set(xlabel="t [s]", ylabel="energy since the start [J/m]")
axes[1].legend()
plt.show()
assert lost["euler"] > 10 * abs(lost["bdf2"]) > 10 * abs(lost["newmark"])

# %% [markdown]
# Implicit Euler's loss has a formula: $\frac12\rho|v - v_n|^2$, and by how much the potential lies
# above its tangent. Where that is convex both are never negative: it cannot but calm. BDF2 loses at
# the third order, the trapezoidal rule and the midpoint rule nothing at all.
#
# ## Work and precision
#
# **Question.** Halve the step: by how much falls the error of each? And for a given error, which is
# cheapest?
#
# A start from rest under sudden weight rings in all vibrations at once, of which no step resolves
# the fast ones. Push the beam without weight in its lowest mode instead; a little of the others
# comes in all the same, as its motion is not small.

# %%
u.x.array[:] = 0
lowest = forms.frequencies(forms.Problem(psi * ufl.dx, u, clamp), 1000.0, 1)
print(lowest)
push, to = {"energy": psi * ufl.dx, "velocity": 0.2 * lowest.modes[0]}, 0.5
fine = swing("midpoint", dt=to / 1600, to=to, rtol=1e-10, ctol=1e-10, **push).u.x.array.copy()
figure, axes = plt.subplots(1, 2, figsize=(9, 3.2), sharey=True)
orders = {}
for scheme, mark in (("euler", "o"), ("bdf2", "s"), ("newmark", "^"), ("midpoint", "v")):
    steps, errors, seconds = [50, 100, 200, 400], [], []
    for count in steps:
        start = time.process_time()
        found = swing(scheme, dt=to / count, to=to, rtol=1e-10, ctol=1e-10, **push).u.x.array
        seconds.append(time.process_time() - start)
        errors.append(np.abs(found - fine).max() / np.abs(fine).max())
    axes[0].loglog([to / n for n in steps], errors, mark + "-", label=scheme)
    axes[1].loglog(seconds, errors, mark + "-", label=scheme)
    orders[scheme] = np.log2(errors[0] / errors[-1]) / 3
axes[0].set(xlabel="step [s]", ylabel="relative error of u")
axes[1].set(xlabel="CPU time [s]")
axes[0].legend()
plt.show()
print({name: round(float(order), 2) for name, order in orders.items()})
assert 0.8 < orders["euler"] < 1.1
assert all(1.6 < orders[name] < 2.3 for name in ("bdf2", "newmark", "midpoint"))

# %% [markdown]
# A step costs the same whatever the scheme; only the exponent differs. First order is paid for with
# every digit.
#
# ## Real damping
#
# **Question.** You want the beam to come to rest. Why not let implicit Euler do it?
#
# Because then the step decides how fast, and which vibrations. Viscosity in the rate of Green's
# strain is a dissipation potential, added like any energy, and converges to something.

# %%
for scheme, dt in (("euler", 0.04), ("euler", 0.02), ("newmark", 0.04), ("newmark", 0.02)):
    damping = [] if scheme == "euler" else dissipation.kelvin_voigt(8000.0)
    path = swing(scheme, dt=dt, dissipation=damping)
    label = f"{scheme}, dt = {dt}" + (", viscous" if scheme == "newmark" else "")
    plt.plot([step.load for step in path.steps], path.record("tip")[:, 1], label=label)
plt.legend()
plt.xlabel("t [s]")
plt.ylabel("tip [m]")
plt.show()

# %% [markdown]
# ## Exercises
#
# **Exercise 1.** What does a step of the trapezoidal rule do to a mass on a spring? Show that
# $k u^2 + \rho v^2$ stays.
#
# <details><summary><b>Solution</b> (click to show it)</summary>
#
# With $u - u_n = \Delta t\,(v + v_n)/2$ and $\rho\,(v - v_n) = -\Delta t\,k\,(u + u_n)/2$, multiply
# the second by $v + v_n$: $\rho\,(v^2 - v_n^2) = -k\,(u + u_n)(u - u_n)$. A hundred steps of it,
# with $k = \rho = 1$:
#
# ```python
# dt = 0.4
# A, B = np.array([[1, -dt / 2], [dt / 2, 1]]), np.array([[1, dt / 2], [-dt / 2, 1]])
# state = np.array([1.0, 0.0])  # u and v
# for _ in range(100):
#     state = np.linalg.solve(A, B @ state)
# assert abs(state @ state - 1) < 1e-12 and abs(state[0] - 1) > 0.1
# ```
# </details>

# %% [markdown]
# **Exercise 2.** Throw the beam spinning, held by nothing, by the trapezoidal and by the midpoint
# rule. Whose angular momentum stays?
#
# <details><summary><b>Solution</b> (click to show it)</summary>
#
# The midpoint rule's: it keeps invariants that are quadratic in place and velocity.
#
# ```python
# X = ufl.SpatialCoordinate(body.mesh)
# spin = ufl.as_vector([-8 * (X[1] - 0.05), 8 * (X[0] - 0.5)])
# changes = {}
# for scheme in ("newmark", "midpoint"):
#     u.x.array[:], t.value = 0, 0
#     thrown = forms.transient(
#         psi * ufl.dx, u, (), t, to=1.0, dt=0.01, rho=1000.0, scheme=scheme, velocity=spin,
#         progress=False,
#     )
#     L = thrown.record("angular_momentum")
#     changes[scheme] = np.abs(L - L[0]).max() / abs(L[0])
# assert changes["midpoint"] < 1e-11 < 1e-7 < changes["newmark"]
# ```
# </details>

# %%
# Your answer to exercise 2:

# %% [markdown]
# **Exercise 3.** What are the lowest frequencies about rest, and about the state under the beam's
# own weight?
#
# <details><summary><b>Solution</b> (click to show it)</summary>
#
# The beam hangs, and its weight stretches it: the lowest frequency rises.
#
# ```python
# u.x.array[:] = 0
# rest = forms.frequencies(forms.Problem(potential, u, clamp), 1000.0, 2)
# load = forms.load_factor(body)
# hanging = forms.follow(load * potential, u, clamp, load, progress=False)
# bent = forms.frequencies(forms.Problem(potential, u, clamp), 1000.0, 2)
# assert bent.frequencies[0] > 1.005 * rest.frequencies[0]
# ```
# </details>

# %%
# Your answer to exercise 3:
