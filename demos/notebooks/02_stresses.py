# SPDX-License-Identifier: MIT

# %% [markdown]
# # 2. Stresses and push-forwards
#
# One energy, four stresses: you will compute $P$, $S$, $\tau$ and $\sigma$ of the same states, see
# the same material stiffen in one and soften in another, and carry stress and stiffness from the
# reference body into the deformed one.
#
# Before: notebook 1. Equation numbers in parentheses are those of [document
# 003](../documents/README.md): V. W. L. Chan, *Compressible Hyperelastic Constitutive Relation*,
# sections I to IV.

# %%
from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
import ufl
from dolfinx import fem, mesh

from variform import forms
from variform.forms import energies, stress
from variform.forms.formulas import elasticity, materials

plt.rcParams.update({"figure.dpi": 90, "font.size": 9})
rng = np.random.default_rng(2)
mu, lmbda = 1.0, 2.0  # Pa
N = 61

# %% [markdown]
# ## One energy, four stresses
#
# **Question.** A force acts on a small area inside a body. In which three ways can you divide the
# one by the other, when both are turned and stretched on the way?
#
# - $P = \partial\psi/\partial F$: the present force per *reference* area, (6);
# - $\sigma = J^{-1} P F^T$: the present force per *present* area, Cauchy's stress;
# - $S = F^{-1} P$: the force pulled back, too, per reference area. Nobody can feel it, but it is
#   symmetric, and it does not turn with the body.
#
# The fourth, $\tau = J \sigma$, is Cauchy's per reference volume. To evaluate them at many states
# without solving anything, we put each state into a cell of its own, of any mesh:

# %%
line = mesh.create_unit_interval(MPI.COMM_WORLD, N)
states = fem.Function(fem.functionspace(line, ("DG", 0, (3, 3))))
F = ufl.variable(states)
psi = energies.neo_hookean(F, mu, lmbda)  # (16)
four = {
    "P": stress.first_piola(psi, F),
    "S": stress.second_piola(psi, F),
    "tau": stress.kirchhoff(psi, F),
    "sigma": stress.cauchy(psi, F),
}


def evaluate(expression, gradients):
    """Values of a UFL expression of F at N gradients, shape (N, 3, 3)."""
    states.x.array[:] = np.ravel(gradients)
    return forms.field(expression, line, degree=0).x.array.reshape(N, *expression.ufl_shape)


gradients = np.eye(3) + 0.2 * rng.uniform(-1, 1, (N, 3, 3))
P, S, tau, sigma = (evaluate(expression, gradients) for expression in four.values())
by_hand = materials.neo_hookean_cauchy(gradients, mu, lmbda)  # (18)
print(f"sigma against (18): {abs(sigma - by_hand).max():.0e} Pa")
for name, value in zip(four, (P, S, tau, sigma), strict=True):
    print(f"{name:>5}: unsymmetric by {abs(value - value.transpose(0, 2, 1)).max():.0e} Pa")
assert abs(sigma - by_hand).max() < 1e-14  # rounding of numbers below 2

# %% [markdown]
# Only $P$ is unsymmetric: its rows belong to the present body, its columns to the reference.
#
# **Question.** Turn the deformed body by a rotation $Q$. Which of the four notice?

# %%
Q = np.linalg.qr(rng.normal(size=(3, 3)))[0]
Q *= np.linalg.det(Q)  # a rotation, no reflection
turned = [evaluate(expression, Q @ gradients) for expression in four.values()]
expected = [Q @ P, S, Q @ tau @ Q.T, Q @ sigma @ Q.T]
for name, found, wanted in zip(four, turned, expected, strict=True):
    print(f"{name:>5} of Q F against its rule: {abs(found - wanted).max():.0e} Pa")
    assert abs(found - wanted).max() < 1e-13

# %% [markdown]
# $S(QF) = S(F)$, $P(QF) = Q P$, $\sigma(QF) = Q \sigma Q^T$: each turns with as many legs as it has
# in the present body.
#
# ## Stiffer or softer?
#
# **Question.** A rubber rod is pulled along x, its sides are free. $P_{11}$ over the stretch $s$
# bends downwards. Does the material soften?
#
# The lateral stretch $a$ follows from $P_{22} = \mu (a - 1/a) + \lambda \ln(s a^2) / a = 0$.

# %%
s, a = np.linspace(0.4, 2.8, N), np.ones(N)
for _ in range(30):
    slope = mu * (1 + 1 / a**2) + lmbda * (2 - np.log(s * a**2)) / a**2
    a -= (mu * (a - 1 / a) + lmbda * np.log(s * a**2) / a) / slope
uniaxial = np.stack([np.diag(row) for row in np.stack([s, a, a], axis=1)])
shear = np.linspace(0, 2, N)
sheared = np.eye(3) + shear[:, None, None] * np.outer([1, 0, 0], [0, 1, 0])

pulled = {name: evaluate(four[name], uniaxial) for name in ("P", "S", "sigma")}
slid = {name: evaluate(four[name], sheared) for name in ("P", "S", "sigma")}
assert abs(pulled["sigma"][:, 1, 1]).max() < 1e-14

# %%
figure, (left, middle, right) = plt.subplots(1, 3, figsize=(7, 3.0), layout="constrained")
labels = {"P": "$P$", "S": "$S$", "sigma": r"$\sigma$"}
for name, color in zip(labels, ("C0", "C1", "C2"), strict=True):
    left.plot(s, pulled[name][:, 0, 0], color=color, label=labels[name])
    middle.plot(shear, slid[name][:, 0, 1], color=color, ls="-" if name == "P" else (0, (3, 3)))
    right.plot(shear, slid[name][:, 0, 0], color=color)
    right.annotate(f" {labels[name]}", (2, slid[name][-1, 0, 0]), va="center")
middle.annotate(r"$P$, $S$ and $\sigma$", (0.4, 1.4))
left.set(xlabel="stretch s [-]", ylabel="11 component [Pa]", ylim=(-6, 6), title="uniaxial")
middle.set(xlabel=r"shear $\gamma$ [-]", ylabel="12 component [Pa]", title="simple shear")
right.set(xlabel=r"shear $\gamma$ [-]", ylabel="11 component [Pa]", xlim=(0, 2.4))
right.set(title="simple shear")
left.legend(loc="lower right")
plt.show()

# %%
young = mu * (3 * lmbda + 2 * mu) / (lmbda + mu)
moduli = {name: np.gradient(value[:, 0, 0], s) for name, value in pulled.items()}
at_rest = {name: np.interp(1, s, modulus) for name, modulus in moduli.items()}
for name, modulus in moduli.items():
    print(f"slope of {name:5}: {at_rest[name]:.2f} Pa at rest, {modulus[-1]:.2f} Pa at s = 2.8")
assert np.allclose(list(at_rest.values()), young, rtol=0.01)  # differences of the curves, ds = 0.04
assert np.allclose(slid["sigma"][:, 0, 0], shear**2)
assert np.allclose(slid["S"][:, 0, 0], -(shear**2))

# %% [markdown]
# All leave rest with Young's modulus, $\mu (3\lambda + 2\mu) / (\lambda + \mu) = 2.67$ Pa; then
# $\sigma$ stiffens, $P$ and $S$ soften. "Softening" says nothing before the measure is named. In
# simple shear the shear stresses are all $\mu\gamma$, but along x the Cauchy stress pulls,
# $\mu\gamma^2$, while $S_{11} = -\mu\gamma^2$ would have you think that it pushes.
#
# ## Poynting's effect
#
# **Question.** A block is sheared. Which forces, besides the shearing one, do its faces need to
# keep that shape? Linear elasticity says: none.


# %%
def draw(axes, gamma):
    """The sheared square and Cauchy's tractions on its faces."""
    F = np.array([[1, gamma, 0], [0, 1, 0], [0, 0, 1]])
    sigma = materials.neo_hookean_cauchy(F, mu, lmbda)
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 0]]) - [0.5, 0.5, 0]
    axes.plot(*(F @ square.T)[:2], color="0.3", lw=1)
    for normal in np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]]):
        n = np.linalg.inv(F).T @ normal
        n /= np.linalg.norm(n)
        for t, color in ((sigma @ n, "C2"), (n @ sigma @ n * n, "C3")):
            if np.linalg.norm(t) > 1e-12:
                style = {"arrowstyle": "->", "color": color, "lw": 1.5}
                place = (F @ normal / 2)[:2]
                axes.annotate("", place + t[:2] / 2, place, arrowprops=style)
    axes.set(xlim=(-2.2, 2.2), ylim=(-0.9, 0.9), aspect="equal", title=rf"$\gamma$ = {gamma:.1f}")
    axes.set(xlabel="x [m]", ylabel="y [m]")


figure, row = plt.subplots(1, 2, figsize=(7, 2.4), layout="constrained", sharey=True)
for axes, gamma in zip(row, (0.5, 1.2), strict=True):
    draw(axes, gamma)
    axes.label_outer()
plt.show()

# %% [markdown]
# Green: the traction, 1 Pa drawn half a meter long. Red: its part across the face. The inclined
# faces must be pushed, with $\mu\gamma^2 / (1 + \gamma^2)$, or else the block grows along x. With a
# running kernel, the next cell has a slider for the shear.


# %%
def one(gamma=1.0):
    """One square, for the slider."""
    draw(plt.subplots(figsize=(4, 2.6), layout="constrained")[1], gamma)
    plt.show()


try:
    from ipywidgets import interact
except ImportError:
    print("no slider: ipywidgets is not installed")
else:
    interact(one, gamma=(0.0, 2.0, 0.1))

# %%
rivals = {
    "neo-Hookean (16)": psi,
    "Mooney-Rivlin": energies.mooney_rivlin(F, c10=0.3, c01=0.2) + energies.volumetric(F, kappa=5),
    "Saint Venant-Kirchhoff": energies.saint_venant_kirchhoff(F, mu, lmbda),
}
print("at shear 2 [Pa]          s11 - s22  s22 - s33      s12")
for name, energy in rivals.items():
    t = evaluate(stress.cauchy(energy, F), sheared)
    first, second = t[:, 0, 0] - t[:, 1, 1], t[:, 1, 1] - t[:, 2, 2]
    print(f"{name:22s} {first[-1]:10.2f} {second[-1]:10.2f} {t[-1, 0, 1]:8.2f}")
    assert np.allclose(first, shear * t[:, 0, 1])

# %% [markdown]
# The normal stresses differ from energy to energy, even in sign, but one relation holds for all of
# them: $\sigma_{11} - \sigma_{22} = \gamma\,\sigma_{12}$, Rivlin's *universal relation*. A
# measurement that violates it proves that no isotropic energy whatever describes the material.
#
# ## Work
#
# **Question.** $P : \dot F$ is the power per reference volume. With which rates do $S$ and $\tau$
# give the same number? Document 003 prints two answers in (7). Are they right?

# %%
F_dot = rng.uniform(-1, 1, (N, 3, 3))
E_dot = elasticity.strain_derivative(gradients, F_dot)  # sym(F^T F_dot)
d = elasticity.rate_of_deformation(F_dot @ np.linalg.inv(gradients))
powers = {
    "P : F_dot": np.sum(P * F_dot, axis=(1, 2)),
    "S : E_dot": np.sum(S * E_dot, axis=(1, 2)),
    "tau : d": np.sum(tau * d, axis=(1, 2)),
    "last term of (7), as printed": elasticity.stress_power_green(S, E_dot, as_printed=True),
}
for name, power in powers.items():
    print(f"{name}: {power[0]:.6f} W/m^3")
assert np.allclose(powers["S : E_dot"], powers["P : F_dot"], rtol=0, atol=1e-13)
assert np.allclose(powers["tau : d"], powers["P : F_dot"], rtol=0, atol=1e-13)


# %%
# The rod again, pulled from rest: C_11 = s^2, and its sides do no work.
rest = np.argmin(abs(s - 1))
stored = evaluate(psi, uniaxial)[-1]
printed = np.trapezoid(pulled["S"][rest:, 0, 0], s[rest:] ** 2)
print(f"stored {stored:.3f} J/m^3, int S : C_dot dt as (7) prints it {printed:.3f} J/m^3")
assert abs(printed / stored - 2) < 5e-3  # trapezoids of width 0.1 in s^2 err by some 0.1 %

# %% [markdown]
# The integral in (7) lacks a factor 1/2 and the last term has one too many: twice the energy, half
# the power. $S$ is conjugate to $\dot E$, not to $\dot C = 2 \dot E$.
#
# ## Pushing the stiffness forward
#
# The material tensor $\mathbb C = \partial S/\partial E$ (10) becomes the spatial one,
# $c_{ijkl} = J^{-1} F_{iI} F_{jJ} F_{kK} F_{lL} \mathbb C_{IJKL}$ (12), and (11) says
# $\overset{\circ}{\sigma} = c : d$.
#
# **Question.** Why the circle? What is wrong with $\dot\sigma = c : d$ while a body spins?

# %%
CC, c = (
    evaluate(f(psi, F), gradients) for f in (stress.material_elasticity, stress.spatial_elasticity)
)
pushed = elasticity.push_forward_elasticity(CC, gradients)
print(f"(12) against the automatic c: {abs(pushed - c).max():.0e} of {abs(c).max():.1f} Pa")

h = 1e-5
ahead, behind = (evaluate(four["sigma"], gradients + sign * h * F_dot) for sign in (1, -1))
sigma_dot = (ahead - behind) / (2 * h)
l = F_dot @ np.linalg.inv(gradients)  # noqa: E741
truesdell = elasticity.truesdell_rate(sigma, sigma_dot, l)
c_d = elasticity.stress_rate(c, d)
print(f"Truesdell's rate minus c : d: {abs(truesdell - c_d).max():.0e} Pa/s")
print(f"sigma_dot minus c : d:        {abs(sigma_dot - c_d).max():.1f} Pa/s")
assert abs(pushed - c).max() < 1e-13 and abs(truesdell - c_d).max() < 1e-8  # h^2 times some

# %% [markdown]
# A stressed bar that only spins has $d = 0$ and yet $\dot\sigma \ne 0$. Truesdell's rate,
# $\dot\sigma - l\sigma - \sigma l^T + \operatorname{tr}(l)\,\sigma$, is the push-forward of
# $\dot S$: it does not count the turning and stretching of the frame.
#
# **Question.** For (16) $c$ has the form of Hooke's law with $\lambda' = \lambda/J$ and
# $\mu' = (\mu - \lambda \ln J)/J$ (19), (20). Document 003 prints $\lambda' = \mu/J$. For which
# Poisson ratio does nobody notice?

# %%
for nu in (0.1, 0.25, 0.4, 0.49):
    _, other = materials.lame_from_shear(mu, nu)
    exact, printed = (
        materials.neo_hookean_elasticity(gradients, mu, other, as_printed=p) for p in (False, True)
    )
    error = abs(printed - exact).max() / abs(exact).max()
    print(f"nu = {nu:.2f}: (20) as printed is off by {error:.0%}")
    assert (error < 1e-12) == (nu == 0.25)
assert np.allclose(materials.neo_hookean_elasticity(gradients, mu, lmbda), c, atol=1e-13)

# %% [markdown]
# At $\nu = 1/4$, where $\lambda = \mu$: a favorite number for tests. Try formulas where constants
# differ.
#
# ## Exercises
#
# **Exercise 1.** The Saint Venant-Kirchhoff rod between rigid walls, $F = \operatorname{diag}(s, 1,
# 1)$, is pressed together. At which $s$ is the force greatest? What do $S_{11}$ and $\sigma_{11}$
# do there?
#
# <details><summary><b>Solution</b> (click to show it)</summary>
#
# $S_{11} = (\lambda + 2\mu)(s^2 - 1)/2$ goes on falling, but $P_{11} = s S_{11}$ is least at
# $s = 1/\sqrt3$; below it the rod gives way. $\sigma_{11} = P_{11}$, since the cross-section stays.
#
# ```python
# pressed = np.linspace(0.2, 1.0, N)
# walls = np.stack([np.diag([x, 1, 1]) for x in pressed])
# law = energies.saint_venant_kirchhoff(F, mu, lmbda)
# force = evaluate(stress.first_piola(law, F), walls)[:, 0, 0]
# assert abs(pressed[force.argmin()] - 1 / np.sqrt(3)) < 0.01
# assert np.all(np.diff(evaluate(stress.second_piola(law, F), walls)[:, 0, 0]) > 0)
# assert np.allclose(evaluate(stress.cauchy(law, F), walls)[:, 0, 0], force)
# ```
# </details>

# %% [markdown]
# **Exercise 2.** Show that the tangent of $P$, $A = \partial P / \partial F$, is not zero along a
# spin $\dot F = W F$ with $W = -W^T$, where the energy does not change. What is $A : \dot F$?
#
# <details><summary><b>Solution</b> (click to show it)</summary>
#
# $P(QF) = Q P(F)$, so $\dot P = W P$: the stress turns. This is what the geometric stiffness of
# notebook 3 is about.
#
# ```python
# W = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 0]])
# A = evaluate(stress.first_elasticity(psi, F), gradients)
# P_dot = np.einsum("nijkl,nkl->nij", A, W @ gradients)
# assert np.allclose(P_dot, W @ P, atol=1e-13)
# ```
# </details>

# %%
# Your answer to exercise 2:
