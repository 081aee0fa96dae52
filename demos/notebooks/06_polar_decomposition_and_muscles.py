# SPDX-License-Identifier: MIT

# %% [markdown]
# # 6. The polar decomposition, and muscles
#
# You will differentiate the rotation in $\mathbf G = \mathbf{RS}$, see what happens to the formulas
# where $\det\mathbf G < 0$, and let a strip bend by an energy that measures the distance from a
# rotation. The formulas are those of [document 002](../documents/README.md), *Derivatives of
# Polar-Decomposition-Based Energy Density*.
#
# You should know the singular value decomposition and $\mathbf P = \partial\psi/\partial\mathbf F$.

# %%
import tempfile
from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
import ufl
from IPython.display import Image

from variform import forms, meshes
from variform.forms.formulas import polar, svd_derivatives

plt.rcParams.update({"figure.dpi": 90, "font.size": 9})
scratch = tempfile.TemporaryDirectory()
rng = np.random.default_rng(6)

# %% [markdown]
# ## Which rotation is in a deformation?
#
# $\mathbf G = \mathbf U \boldsymbol\Sigma \mathbf V^T = (\mathbf U\mathbf V^T) (\mathbf
# V\boldsymbol\Sigma\mathbf V^T) = \mathbf{RS}$: stretch along three perpendicular lines, then
# turn.
#
# **Question.** Of all rotations $\mathbf Q$, which is nearest to $\mathbf G$, in the norm
# $|\mathbf G - \mathbf Q|$? Think before you read on.

# %%
G = np.array([[1.3, -0.5, 0.0], [0.9, 0.6, 0.0], [0.0, 0.0, 0.5]])
R, S, U, s, V = polar.polar(G)
angles = np.radians(np.linspace(-180, 180, 721))
c, n, zero = np.cos(angles), np.sin(angles), np.zeros_like(angles)
turns = np.stack([c, -n, zero, n, c, zero, zero, zero, zero + 1], 1).reshape(-1, 3, 3)
distance = np.linalg.norm(G - turns, axis=(1, 2))
nearest, of_R = angles[distance.argmin()], np.arctan2(R[1, 0], R[0, 0])
print(f"nearest turn: {np.degrees(nearest):.1f} degrees, R turns by {np.degrees(of_R):.2f}")
assert abs(nearest - of_R) < np.radians(0.5)  # the spacing of the angles that were tried
others = svd_derivatives.rodrigues(2 * rng.normal(size=(10_000, 3)))  # about any axis
smallest = min(distance.min(), np.linalg.norm(G - others, axis=(1, 2)).min())
print(f"|G - Q| is {smallest:.4f} at least, |G - R| is {np.linalg.norm(G - R):.4f}")
assert smallest >= np.linalg.norm(G - R) and np.allclose(R @ S, G)

# %%
letter = (
    np.array([[0, 0], [0, 5], [3, 5], [3, 4], [1, 4], [1, 3], [2, 3], [2, 2], [1, 2], [1, 0]]) / 5
)
names = {"reference": np.eye(3), "stretched: S": S, "then turned: R S": G, "R alone": R}
figure, axes = plt.subplots(1, 4, figsize=(7, 2.1), sharey=True, layout="constrained")
for ax, (name, matrix) in zip(axes, names.items(), strict=True):
    x, y = (letter @ matrix[:2, :2].T).T
    ax.fill(x, y, color="C0" if name != "R alone" else "C1", alpha=0.6)
    for axis in V[:2, :2].T:
        ax.plot(*np.outer([-0.5, 0.5], matrix[:2, :2] @ axis).T, "k-", linewidth=1)
    ax.set(title=name, xlim=(-1.0, 1.0), ylim=(-0.7, 1.3), xlabel="x [-]", aspect="equal")
axes[0].set_ylabel("y [-]")
plt.show()

# %% [markdown]
# It is $\mathbf R$: energies that ask "how far is this from a rotation?" use it for that. The
# black lines are the columns of $\mathbf V$, which $\mathbf S$ only stretches.
#
# ## How does the rotation change?
#
# **Question.** In $\mathrm d\mathbf G = \mathrm d\mathbf R\,\mathbf S + \mathbf R\,\mathrm
# d\mathbf S$ there are two unknowns and one equation. What else do we know? Think before you
# read on.
#
# $\boldsymbol\Omega = \mathbf R^T\mathrm d\mathbf R$ is skew and $\mathrm d\mathbf S$ symmetric.
# In the axes $\mathbf V$, with $\mathbf M = \mathbf U^T \mathrm d\mathbf G\,\mathbf V$, the
# difference $M_{ij} - M_{ji}$ has lost $\mathrm d\mathbf S$ (document 002, 3.3):
#
# $$\tilde\Omega_{ij} = \frac{M_{ij} - M_{ji}}{s_i + s_j}, \qquad
# \mathrm d\mathbf R = \mathbf U\tilde{\boldsymbol\Omega}\mathbf V^T.$$

# %%
G, dG = np.eye(3) + 0.3 * rng.normal(size=(3, 3)), rng.normal(size=(3, 3))
R, S, U, s, V = polar.polar(G)
M = U.T @ dG @ V
Omega = (M - M.T) / (s[:, None] + s[None, :])
dR = U @ Omega @ V.T
step = 1e-6
difference = (polar.polar(G + step * dG).R - polar.polar(G - step * dG).R) / (2 * step)
print(f"det G = {np.linalg.det(G):.2f}, singular values", s.round(3))
print(f"dR against a difference: {np.abs(dR - difference).max():.0e}")
print(f"R^T dR + dR^T R: {np.abs(R.T @ dR + dR.T @ R).max():.0e}")
print(f"tr(dR^T G): {np.trace(dR.T @ G):.0e}")
assert np.abs(dR - difference).max() < 1e-8  # step^2, and rounding over step
assert abs(np.trace(dR.T @ G)) < 1e-14

# %% [markdown]
# The last line is a gift: $\mathrm{tr}(\mathrm d\mathbf R^T\mathbf G) =
# \mathrm{tr}(\boldsymbol\Omega^T \mathbf S) = 0$, skew times symmetric. So the gradient of $\psi
# = |\mathbf G - \mathbf R|^2 = \mathrm{tr}\,\mathbf G^T\mathbf G - 2\,\mathrm{tr}\,\mathbf
# R^T\mathbf G + 3$ knows nothing of $\mathrm d\mathbf R$: the nearest rotation is a minimum, and
# moving it costs nothing to first order.
#
# ## What is the stress of an activated material?
#
# Now let $\mathbf G = \mathbf{FA}$ with an activation $\mathbf A$, and $\psi = |\mathbf{FA} -
# \mathbf R|^2$. Document 002 asks for a symmetric $\mathbf A$ and finds $\mathbf P =
# 2(\mathbf{FA} - \mathbf R)\,\mathbf A$.
#
# **Question.** Where did the derivation use the symmetry, and what should stand there without it?
# Think before you read on.

# %%
A = np.array([[1.1, 0.4, -0.2], [-0.1, 0.9, 0.3], [0.2, -0.25, 1.3]])
arap = forms.energies.as_rigid_as_possible  # mu |G - R|^2 of an array G


def gradient(f, F):
    """df/dF by central differences."""
    found = np.zeros((3, 3))
    for at in np.ndindex(3, 3):
        E = np.zeros((3, 3))
        E[at] = step
        found[at] = (f(F + E) - f(F - E)) / (2 * step)
    return found


def off(found, wanted):
    """Largest difference over the largest entry."""
    return np.abs(found - wanted).max() / np.abs(wanted).max()


F = G
wanted = gradient(lambda F: arap.energy((F @ A)[None], 1.0)[0], F)
R = polar.polar(F @ A).R
printed, right = 2 * (F @ A - R) @ A, 2 * (F @ A - R) @ A.T
kernels = arap.evaluate((F @ A)[None], 1.0)[0][0] @ A.T
print(f"P as printed: off by {off(printed, wanted):.2f};  with A^T: {off(right, wanted):.0e}")
assert (
    abs(off(printed, wanted) - 0.60) < 0.01
    and off(right, wanted) < 1e-8
    and off(kernels, right) < 1e-13
)

# %% [markdown]
# $\mathrm d\mathbf G = \mathrm d\mathbf F\,\mathbf A$ gives $\mathbf P = 2(\mathbf{FA} - \mathbf
# R)\, \mathbf A^T$, for every $\mathbf A$: the document has it one line before its result, and
# with this $\mathbf A$ the result is off by 60 %. A muscle whose fibers also shear has such an
# $\mathbf A$, and the package takes it.
#
# ## What if the body is turned inside out?
#
# Document 002 calls $\mathbf R$ a rotation and $\mathbf S$ positive semi-definite.
#
# **Question.** Can both be true when $\det\mathbf G < 0$? Think before you read on.
#
# No: $\det\mathbf G = \det\mathbf R\,\det\mathbf S$. One may keep $\mathbf R$ in SO(3), and let
# $s_3$ carry the sign; or $\mathbf S$, with a reflection $\mathbf R$ in O(3). These are two
# materials:

# %%
s3 = np.linspace(-1.5, 1.5, 61)
states = np.zeros((61, 3, 3))
states[:, 0, 0], states[:, 1, 1], states[:, 2, 2] = 1.6, 1.55, s3
figure, ax = plt.subplots(figsize=(5, 2.6), layout="constrained")
for group, style in (("SO(3)", "-"), ("O(3)", "--")):
    ax.plot(s3, polar.energy(states, np.eye(3), group), style, label=f"R in {group}")
ax.set(xlabel="$G_{33}$, negative where inverted [-]", ylabel="$|G - R|^2$ [-]")
ax.legend(frameon=False)
plt.show()
base = 0.6**2 + 0.55**2
assert np.allclose(polar.energy(states, np.eye(3), "SO(3)"), base + (s3 - 1) ** 2)
assert np.allclose(polar.energy(states, np.eye(3), "O(3)"), base + (np.abs(s3) - 1) ** 2)
for group in ("SO(3)", "O(3)"):  # dR where G is inverted
    dR = polar.rotation_differential(states[10], dG, group)
    ahead, behind = (polar.polar(states[10] + x * dG, group).R for x in (step, -step))
    assert np.abs(dR - (ahead - behind) / (2 * step)).max() < 1e-7

# %% [markdown]
# With O(3) the mirror image rests, and there is a kink where the body is flat; with SO(3), the
# package's default, the energy pulls every inverted element back (`activated(…, improper=True)`
# is O(3)). All formulas above hold in both, if $s$ is the one that belongs to $\mathbf R$.
#
# **Question.** What if one takes a rotation $\mathbf R$, but the library's $s_3 \ge 0$ in $s_i +
# s_j$? Think before you read on.

# %%
G = np.linalg.qr(rng.normal(size=(3, 3)))[0] @ np.diag([1.6, 0.9, 0.5])
G[:, 0] *= -np.sign(np.linalg.det(G))
_, _, U, s, V = polar.polar(G)


def hessian(s):
    """dP/dF for A = I, with given singular values in the denominators."""
    H = np.zeros((3, 3, 3, 3))
    for at in np.ndindex(3, 3):
        dG = np.zeros((3, 3))
        dG[at] = 1
        M = U.T @ dG @ V
        H[:, :, *at] = 2 * (dG - U @ ((M - M.T) / (s[:, None] + s)) @ V.T)
    return H


exact = arap.evaluate(G[None], 1.0)[1][0]
print("signed singular values", s.round(3))
print(f"Hessian with them: off by {off(hessian(s), exact):.0e}")
print(f"with |s_3| instead: off by {off(hessian(np.abs(s)), exact):.2f}")
assert off(hessian(s), exact) < 1e-13 and abs(off(hessian(np.abs(s)), exact) - 0.89) < 0.01
lowest = np.linalg.eigvalsh(exact.reshape(9, 9))[:3]
assert np.allclose(lowest, np.sort([2 - 4 / (s[i] + s[j]) for i, j in ((0, 1), (0, 2), (1, 2))]))

# %% [markdown]
# The stress contains no $s_i + s_j$ and stays right; the Hessian is off by 89 %, and all one
# would see is a Newton's method that converges slowly or not at all. The right Hessian's
# eigenvalues for $\mathbf A = \mathbf I$ are 2, six times, and $2 - 4/(s_i + s_j)$.
#
# ## How far does a muscle bend a strip?
#
# $\psi = \mu|\mathbf{FA} - \mathbf R|^2$ is zero where $\mathbf F = \mathbf{RA}^{-1}$: with
# $\mathbf A = \mathrm{diag}(\frac1{1-c}, 1, 1)$ the material rests when its fibers, along x, have
# contracted by the part $c$. We glue such a layer onto a passive one of the same thickness $h/2$.
#
# **Question.** Both layers cannot rest at once, so the strip bends. Will a stiffer material,
# with twice the $\mu$, bend more or less? Think before you read on.
#
# Just as much: only the ratio of the two moduli matters, as in a bimetal. Timoshenko's formula
# (*J. Opt. Soc. Am.* 11 (1925) 233-255), for equal thicknesses, a ratio $n$ of the moduli and a
# difference $c$ of the lengths at rest, is
#
# $$\kappa h = \frac{24\, c}{12 + (1 + n)(1 + 1/n)}.$$
#
# Along the fibers $\psi = \mu (\ell/(1-c) - 1)^2 = \mu (1-c)^{-2} (\ell - (1 - c))^2$: quadratic
# in the stretch $\ell$, so that $n = (1-c)^{-2}$ holds for large contractions, too. Here
# $\kappa$ is the angle turned per length *before* the contraction.

# %%
length, h = 4.0, 0.2
body = meshes.block(MPI.COMM_WORLD, (length, h), n=(40, 4), cells="quadrilateral")
X = ufl.SpatialCoordinate(body.mesh)


def bend(active, most, lmbda=0.0):
    """Path of a strip whose fibers contract by up to most where active is 1."""
    t = forms.load_factor(body)
    u = forms.displacement(body, degree=2)
    F = forms.deformation_gradient(u)
    A = ufl.as_matrix([[1 / (1 - most * t * active), 0, 0], [0, 1, 0], [0, 0, 1]])
    psi = forms.energies.activated(F, A, mu=1.0) + lmbda / 2 * (ufl.det(F * A) - 1) ** 2

    def section(x):  # from the lower to the upper edge, as a complex number
        across = forms.at(u, (x * length, h)) - forms.at(u, (x * length, 0.0))
        return across[0] + 1j * (h + across[1])

    def curvature(a, b):
        return np.angle(section(b) / section(a)) / ((b - a) * length)

    record = {"left": lambda system: curvature(0.2, 0.3), "right": lambda s: curvature(0.7, 0.8)}
    wall = forms.clamp(u, body.facets("left"))
    return forms.follow(psi * ufl.dx, u, [wall], t, record=record, progress=False)


# %% [markdown]
# A worm has muscles on both sides. In the left half the upper layer contracts, in the right half
# the lower one:


# %%
def chosen(condition):
    """1 where the condition holds, elsewhere 0."""
    return ufl.conditional(condition, 1.0, 0.0)


upper, left = chosen(ufl.gt(X[1], h / 2)), chosen(ufl.lt(X[0], length / 2))
active = left * upper + (1 - left) * (1 - upper)
path = bend(active, 0.21)
picture = Path(scratch.name) / "strip.png"
a = forms.deformation_gradient(path.u) * ufl.as_vector([1, 0, 0])
stretch = ufl.sqrt(ufl.inner(a, a))
shortest = forms.field(stretch, body).x.array.min()
forms.picture(path, picture, stretch, "stretch of\nthe fibers [-]", size=(640, 400))
print(path.reason)
Image(filename=picture)

# %%
c = 0.21 * np.array([step.load for step in path.steps])
bent = h * np.stack([path.record("left"), -path.record("right")])


def timoshenko(c):
    """Curvature times thickness of a bimetal."""
    n = (1 - c) ** -2
    return 24 * c / (12 + (1 + n) * (1 + 1 / n))


fine = np.linspace(0, 0.21)
figure, ax = plt.subplots(figsize=(5, 2.8), layout="constrained")
ax.plot(fine, timoshenko(fine), "-", label="Timoshenko")
ax.plot(c, bent[0], "o", label="left half")
ax.plot(c, bent[1], "x", color="k", label="right half, the other way")
ax.set(xlabel="contraction of the active fibers $c$ [-]", ylabel=r"curvature $\kappa h$ [-]")
ax.legend(frameon=False)
plt.show()
off_formula = np.abs(bent / timoshenko(c) - 1).max()
print(f"largest difference from Timoshenko's formula: {100 * off_formula:.2f} %")
assert off_formula < 1e-3 and shortest < 0.75
assert np.allclose(bent[:, -1] / h * length / 2, np.pi, rtol=0.02)  # each half turns by 180 degrees

# %% [markdown]
# Both halves follow the formula of a beam within 0.02 %, up to two half circles and fibers
# shorter by a quarter. No force acts on the strip from outside, and there is no "bending
# energy": a bend is where two layers' wishes meet.
#
# ## Exercises

# %% [markdown]
# **Exercise 1.** An activation that is not symmetric: let all of the strip have $\mathbf A =
# [[1, 0.3], [0, 1]]$, start from rest, and find its shape and its energy. Does the printed
# $\mathbf P = 2(\mathbf{FA} - \mathbf R)\mathbf A$ vanish in the same state?
#
# <details><summary><b>Solution</b> (click to show it)</summary>
#
# $\mathbf F = \mathbf{RA}^{-1}$ is uniform, so the strip reaches it and its energy is 0, if its
# end may turn: pins instead of a wall. The printed $\mathbf P$ vanishes there, too, as
# $\mathbf{FA} = \mathbf R$; it is wrong everywhere else.
#
# ```python
# shear = np.array([[1.0, 0.3], [0.0, 1.0]])
# u = forms.displacement(body, degree=2)
# F = forms.deformation_gradient(u)
# psi = forms.energies.activated(F, shear, mu=1.0)
# pins = [forms.pin(u, (0, 0)), forms.pin(u, (length, 0), [1])]
# path = forms.solve(psi * ufl.dx, u, pins)
# found = np.eye(2) + np.stack(
#     [forms.at(u, (length, 0)) / length, (forms.at(u, (0, h)) - forms.at(u, (0, 0))) / h], 1
# )
# print("energy", path.problem.energy(), "F A", (found @ shear).round(6).tolist())
# assert abs(path.problem.energy()) < 1e-12
# assert np.allclose(shear.T @ found.T @ found @ shear, np.eye(2), atol=1e-6)
# ```
# </details>

# %%
# Your answer to exercise 1:

# %% [markdown]
# **Exercise 2.** Only the upper quarter of the thickness contracts. Timoshenko's general formula
# with $m = a_1/a_2$, the ratio of the thicknesses of the passive and the active layer, and $n =
# E_1/E_2$ is $\kappa h = 6 c (1 + m)^2 / (3 (1 + m)^2 + (1 + mn)(m^2 + 1/(mn)))$. Does the strip
# bend less than with equal layers?
#
# <details><summary><b>Solution</b> (click to show it)</summary>
#
# Yes, by a fifth: a thin layer pulls at a longer lever, but with less force.
#
# ```python
# quarter = chosen(ufl.gt(X[1], 0.75 * h))
# path = bend(quarter, 0.1)
# m, n = 3.0, (1 - 0.1) ** 2  # passive over active: its modulus is the smaller one
# wanted = 6 * 0.1 * (1 + m) ** 2 / (3 * (1 + m) ** 2 + (1 + m * n) * (m**2 + 1 / (m * n)))
# found = h * path.record("left")[-1]
# print(f"curvature {found:.5f}, formula {wanted:.5f}, equal layers {timoshenko(0.1):.5f}")
# assert abs(found / wanted - 1) < 1e-3 and wanted < 0.85 * timoshenko(0.1)
# ```
# </details>

# %%
# Your answer to exercise 2:

# %% [markdown]
# **Exercise 3.** Muscle keeps its volume. Add $\frac\lambda2(\det\mathbf{FA} - 1)^2$ by
# `lmbda=2.0` in `bend`. Does a strip in plane strain then bend more or less? What does the
# formula say?
#
# <details><summary><b>Solution</b> (click to show it)</summary>
#
# Just as much: the moduli of both layers grow alike, and their ratio is all that the formula
# knows. It still holds within 0.1 %.
#
# ```python
# path = bend(upper, 0.1, lmbda=2.0)
# found = h * path.record("left")[-1]
# print(f"curvature {found:.5f}, formula {timoshenko(0.1):.5f}")
# assert abs(found / timoshenko(0.1) - 1) < 1e-3
# ```
# </details>

# %%
# Your answer to exercise 3:
