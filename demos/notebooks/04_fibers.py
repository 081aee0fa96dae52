# SPDX-License-Identifier: MIT

# %% [markdown]
# # 4. Fibers: transverse isotropy, and what mistakes in print do
#
# You will see how one direction enters an energy, how five constants follow from moduli that one
# can measure, and what a misprint in a stress, a tangent or a constant does to a computation. The
# formulas are those of [document 003](../documents/README.md) (V. W. L. Chan, *Compressible
# Hyperelastic Constitutive Relation*), (20) to (28).
#
# You should know $\mathbf F$, $\mathbf C = \mathbf F^T \mathbf F$, the Cauchy stress, and Newton's
# method. Lengths are in mm, stresses in MPa.

# %%
import tempfile
from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
import ufl
from IPython.display import Image

from variform import forms, meshes
from variform.forms.formulas import materials

plt.rcParams.update({"figure.dpi": 90, "font.size": 9})
scratch = tempfile.TemporaryDirectory()
folder = Path(scratch.name)

# %% [markdown]
# ## How does a direction enter an energy?
#
# Fibers run along a unit vector $\mathbf A$ and are carried to $\mathbf a = \mathbf{FA}$. Two more
# invariants of $\mathbf C$ see them, document 003, (22):
#
# $$IV = \mathbf A \cdot \mathbf C \mathbf A = \mathbf a \cdot \mathbf a, \qquad
# V = \mathbf A \cdot \mathbf C^2 \mathbf A.$$
#
# The energy (21) adds them to a neo-Hookean one (with $2\beta$ where the print has $\beta$: see
# below):
#
# $$\psi = \tfrac\mu2 (I - 3) - \mu \ln J + \tfrac\lambda2 (J-1)^2
# + [\alpha + 2\beta \ln J + \gamma (IV - 1)](IV - 1) - \tfrac\alpha2 (V - 1).$$
#
# **Question.** IV is the squared stretch of the fibers. Which deformation leaves IV alone but
# changes V, so that V is needed? Think before you read on.

# %%
along, g = np.array([1.0, 0.0, 0.0]), 0.3
names = {(0, 0): "stretch along A", (1, 1): "stretch across A"}
names |= {(0, 1): "shear along A", (1, 2): "shear across A"}
for entry, name in names.items():
    F = np.eye(3)
    F[entry] += g
    IV, V = materials.fiber_invariants(F, along)
    print(f"{name:17s} IV = {IV:.2f}   V = {V:.4f}   V - IV^2 = {V - IV**2:.4f}")
    assert abs(V - IV**2 - (g**2 if entry == (0, 1) else 0)) < 1e-14

# %% [markdown]
# Shear along the fibers: $V - IV^2 = |\mathbf{CA}|^2 - (\mathbf A \cdot \mathbf{CA})^2$ is the
# squared shear between the fibers and everything across them. That is why $\alpha$, the factor
# of V, sets the axial shear modulus. Neither of the two tells the directions across $\mathbf A$
# apart, nor sees the fibers slide past each other: the material is *transversely* isotropic.
#
# ## Do the moduli come back?
#
# Five constants that nobody can measure follow from four moduli that one can, (25): the shear
# modulus $\mu$ and Poisson's ratio $\nu$, and along the fibers $E_A$ and $G_A$.
#
# **Question.** How would you find out, without any theory, whether the constants are right? Think
# before you read on.
#
# By a test in a testing machine: pull a cube by a hundred thousandth, first along the fibers, then
# across, and shear it. (The modulus across is not free: $E_t = 2\mu(1+\nu)$.)

# %%
mu, nu, E_A, G_A = 1.3, 0.27, 9.0, 0.8
E_t = 2 * mu * (1 + nu)
constants = forms.energies.transversely_isotropic_constants(mu, nu, E_A, G_A)
cube = meshes.block(MPI.COMM_WORLD, (1.0, 1.0, 1.0), n=1, cells="hexahedron")
faces = [("left", "right"), ("front", "back"), ("bottom", "top")]  # of the axes x, y, z
fiber = ufl.as_vector([1.0, 0.0, 0.0])


def tension(axis, constants, strain=1e-5):
    """E = stress over strain of a cube with fibers along x, and the ratios of contraction."""
    u = forms.displacement(cube)
    F = forms.deformation_gradient(u)
    psi = forms.energies.transversely_isotropic_neo_hookean(F, fiber=fiber, **constants)
    supports = [forms.roller(u, cube.facets(low), i) for i, (low, _) in enumerate(faces)]
    by = [strain if i == axis else None for i in range(3)]
    supports.append(forms.translate(u, cube.facets(faces[axis][1]), by))
    path = forms.solve(psi * ufl.dx, u, supports)
    force, _ = forms.resultant(path, cube.facets(faces[axis][1]))
    return force[axis] / strain, -forms.at(u, (1, 1, 1)) / strain


E_along, ratios = tension(0, constants)
E_across, others = tension(1, constants)
print(f"pulled along the fibers: E = {E_along:.4f}, nu y {ratios[1]:.4f}, z {ratios[2]:.4f}")
print(f"pulled across them:      E = {E_across:.4f}, nu x {others[0]:.4f}, z {others[2]:.4f}")
assert abs(E_along - E_A) < 1e-3 and abs(E_across - E_t) < 1e-3  # the strain of 1e-5 is not zero
assert abs(ratios[1] - nu) < 1e-3 and abs(others[2] - nu) < 1e-3
assert abs(others[0] - nu * E_t / E_A) < 1e-3

# %% [markdown]
# Shear is quicker: set the displacement, and read the modulus off the energy, $\psi = G g^2 / 2$.

# %%
u = forms.displacement(cube)
F = forms.deformation_gradient(u)
psi = forms.energies.transversely_isotropic_neo_hookean(F, fiber=fiber, **constants)
moduli, g = [], 1e-4
for i in (0, 1):  # planes slide along the fibers; fibers slide past each other
    u.interpolate(lambda X, i=i: g * X[i + 1] * np.eye(3)[i][:, None])
    moduli.append(2 * forms.integral(psi * ufl.dx) / g**2)
print(f"shear modulus along the fibers {moduli[0]:.4f}, across them {moduli[1]:.4f}")
assert np.allclose(moduli, [G_A, mu], atol=1e-4)

# %% [markdown]
# All moduli come back: $E_A = 9$, $E_t = 3.302$, $G_A = 0.8$, $\mu = 1.3$, and $\nu = 0.27$ both
# in the plane and under axial load.
#
# ## What is wrong in print, and by how much?
#
# Document 003 prints $n = E_A / E_t$ in (25) where it must be $n = E_t / E_A$, and $\beta \ln J$
# in (21) where the stress (23) belongs to $2 \beta \ln J$. `forms.formulas` has each formula
# right, and as printed by `as_printed=True`.
#
# **Question.** The material of the printed constants is a possible one: stable, symmetric, without
# stress at rest. Would you notice? Think before you read on.

# %%
printed = materials.transversely_isotropic_constants(mu, nu, E_A, G_A, as_printed=True)
wrong, ratios = tension(0, printed._asdict())
print(f"(25) as printed: E_A = {E_A} goes in, {wrong:.3f} comes out")
assert abs(wrong - 18.306) < 2e-3 and abs(ratios[1] - nu) < 1e-3
c = materials.transversely_isotropic_elasticity(np.eye(3), along, printed)
D = materials.voigt_elasticity(c)
assert np.array_equal(D, D.T) and np.linalg.eigvalsh(D)[0] > 0  # symmetric and stable
assert np.abs(materials.transversely_isotropic_cauchy(np.eye(3), along, printed)).max() < 1e-14

# %% [markdown]
# Only by testing it: the axial modulus is twice what was asked for, while $\nu$ under the same
# load is right. A misprint in constants gives smooth convergence to a wrong answer.
#
# For the energy (21) and for the tangents we need derivatives that trust no formula. A *complex
# step*, $f'(x) = \mathrm{Im}\, f(x + ih)/h$ with $h = 10^{-30}$, has all digits, as nothing is
# subtracted.

# %%
right = materials.Constants(**constants)
A = np.array([np.cos(np.pi / 6), np.sin(np.pi / 6), 0.0])  # fibers at 30 degrees to x
state = np.array([[1.4, -0.2, 0.0], [0.0, 0.9, 0.0], [0.0, 0.0, 0.93]])


def slopes(f, F, h=1e-30):
    """df/dF at F by complex steps, the two new axes last."""
    step = [[f(F + 1j * h * np.outer(a, b)).imag / h for b in np.eye(3)] for a in np.eye(3)]
    return np.moveaxis(np.array(step), (0, 1), (-2, -1))


def first_piola(F, sigma):
    """P = J sigma F^-T."""
    return np.linalg.det(F) * sigma(F) @ np.linalg.inv(F).T


def fibrous(F):
    """Cauchy stress (23)."""
    return materials.transversely_isotropic_cauchy(F, A, right)


def error(found, wanted):
    """Largest difference over the largest entry."""
    return np.abs(found - wanted).max() / np.abs(wanted).max()


for as_printed, name in ((False, "2 beta ln J"), (True, "beta ln J, as printed")):
    P = slopes(lambda F, p=as_printed: materials.transversely_isotropic(F, A, right, p), state)
    off = error(P, first_piola(state, fibrous))
    print(f"(21) with {name:22s} differs from the stress (23) by {off:.1e}")
    assert off > 0.01 if as_printed else off < 1e-14

# %% [markdown]
# The tangent (24) is wrong in three places: the factor $2J - 1$ of $\mathbf i$ should be $J -
# 1$; $\mathbf i$ and the 4-tensor $\mathbf a$ lack their minor symmetry, $c_{ijkl} = c_{ijlk}$.
# In (20) $\lambda' = \mu/J$ should be $\lambda/J$. We write (24) with a switch for each, turn it
# to $\partial \mathbf P / \partial \mathbf F$, and compare it with the complex steps.

# %%
EYE = np.eye(3)


def dyad(x, y):
    """The 4-tensor x_ij y_kl."""
    return np.einsum("ij,kl->ijkl", x, y)


def elasticity(F, volume=False, identity=False, tensor=False):
    """Spatial elasticity tensor (24), each of its three errors as printed (True) or corrected."""
    m, lmbda, alpha, beta, gamma = right
    J, a, b = np.linalg.det(F), F @ A, F @ F.T
    aa, i = np.outer(a, a), materials.fourth_order_identity(identity)
    c = lmbda * (2 * J - 1) * dyad(EYE, EYE) + 8 * gamma / J * dyad(aa, aa)
    c += 2 / J * (m - lmbda * J * ((2 * J - 1) if volume else (J - 1))) * i
    c += 4 * beta / J * (dyad(aa, EYE) + dyad(EYE, aa) - (a @ a - 1) * i)
    return c - alpha / J * materials.fiber_tensor(a, b, tensor)


def tangent(F, sigma, c):
    """dP_iJ / dF_kL = J F^-1_Jj F^-1_Ll (c_ijkl + delta_ik sigma_jl)."""
    G, geometric = np.linalg.inv(F), np.einsum("ik,jl->ijkl", EYE, sigma(F))
    return np.linalg.det(F) * np.einsum("Jj,Ll,ijkl->iJkL", G, G, c(F) + geometric)


def isotropic(F):
    """Cauchy stress (18) with lmbda = 2.1."""
    return materials.neo_hookean_cauchy(F, mu, 2.1)


# %% [markdown]
# ## What does a wrong tangent cost?
#
# **Question.** The stress is right in all that follows. Does a wrong tangent change the
# solution, or only the way to it? Think before you read on.
#
# The test is a strip of this material, pulled by 40 % in four steps and otherwise free. Its
# state is uniform, $\mathbf F = [[\ell, g, 0], [0, a, 0], [0, 0, b]]$, and the three unknowns
# $g, a, b$ follow from $P_{12} = P_{22} = P_{33} = 0$: Newton's method fits in ten lines.

# %%
FREE = [(0, 1), (1, 1), (2, 2)]  # the entries of F that are unknown, and of P that vanish


def newton(sigma, c, stretch=1.4, steps=4):
    """Iterations of each step (None: it failed) and the last F."""
    F, counts = np.eye(3), []
    for F[0, 0] in np.linspace(1, stretch, steps + 1)[1:]:
        for count in range(60):
            R = [first_piola(F, sigma)[at] for at in FREE]
            if np.linalg.norm(R) < 1e-10:
                counts.append(count)
                break
            K = tangent(F, sigma, c)
            dF = np.linalg.solve([[K[i + j] for j in FREE] for i in FREE], R)
            F[tuple(np.transpose(FREE))] -= dF
            if min(F[1, 1], F[2, 2]) < 0.05:  # as good as turned inside out
                return None, F
    return counts if len(counts) == steps else None, F


# %%
iso = materials.neo_hookean_elasticity  # (19), (20)
rows = {
    "(20) corrected": (isotropic, lambda F: iso(F, mu, 2.1)),
    "(20) as printed": (isotropic, lambda F: iso(F, mu, 2.1, True)),
    "(24) corrected": (fibrous, lambda F: elasticity(F)),
    "(24) as printed": (fibrous, lambda F: elasticity(F, True, True, True)),
    "  only the factor 2J - 1": (fibrous, lambda F: elasticity(F, volume=True)),
    "  only i without symmetry": (fibrous, lambda F: elasticity(F, identity=True)),
    "  only a without symmetry": (fibrous, lambda F: elasticity(F, tensor=True)),
}
table = {}
print("tangent                          error   Newton's iterations per step")
for name, (sigma, c) in rows.items():
    exact = slopes(lambda F, s=sigma: first_piola(F, s), state)
    table[name] = (error(tangent(state, sigma, c), exact), *newton(sigma, c))
    print(f"{name:31s} {table[name][0]:.1e}   {table[name][1] or 'fails'}")

# %%
F_strip = table["(24) corrected"][2]
for name, (off, counts, F) in table.items():
    if "corrected" in name:
        assert off < 1e-14 and max(counts) <= 5
    else:
        assert off > 0.05 and (counts is None or min(counts) > 7)
    if name.startswith(("(24)", "  ")) and counts:
        assert np.allclose(F, F_strip, atol=1e-8)
print(np.round(F_strip, 4) + 0.0)

# %% [markdown]
# Where Newton's method ends, it ends at the same $\mathbf F$: the residual decides what the
# solution is. But 3 iterations a step become 12 to 22, and the factor $2J - 1$ alone, wrong by
# $-2\lambda\mathbf i$ already at rest, stops it altogether. Slow convergence is a message:
# compare the tangent with a difference of the residual. (A tangent that UFL derives from the
# energy cannot have this illness.)
#
# ## At which angle is it softest?
#
# Small strains again: the compliance matrix is the inverse of (28), and a strip cut at an angle
# $\theta$ to its fibers has $1/E(\theta) = \mathbf n\mathbf n : \mathbb S : \mathbf n\mathbf n$.
#
# **Question.** It is stiffest along the fibers. Is it softest across them? Think before you read
# on.


# %%
def stiffness(theta, G_A):
    """Young's modulus of strips at angles to the fibers."""
    chosen = materials.transversely_isotropic_constants(mu, nu, E_A, G_A)
    c = materials.transversely_isotropic_elasticity(np.eye(3), along, chosen)
    n = np.stack([np.cos(theta), np.sin(theta), 0 * theta], -1)
    stress = materials.voigt_stress(n[:, :, None] * n[:, None, :])
    strain = stress @ np.linalg.inv(materials.voigt_elasticity(c))
    return 1 / np.einsum("ni,ni->n", stress, strain)


theta = np.radians(np.arange(361))
figure, axes = plt.subplots(figsize=(4.2, 3.2), subplot_kw={"projection": "polar"})
for G, style in ((0.8, "-"), (1.5, "--"), (2.5, ":")):
    E = stiffness(theta, G)
    axes.plot(theta, E, style, label=f"$G_A$ = {G} MPa")
    softest = np.argmin(E[:91])
    print(f"G_A = {G}: E from {E.max():.3f} down to {E.min():.3f} MPa at {softest} degrees")
axes.set(rticks=[3, 6, 9], rmax=10)
axes.set_rlabel_position(65)
axes.set_title("Young's modulus [MPa] over the angle to the fibers", fontsize=9)
axes.legend(loc="center left", bbox_to_anchor=(1.1, 0.5), frameon=False)
plt.show()
E = stiffness(theta, G_A)
assert abs(E[0] - E_A) < 1e-12 and abs(E[90] - E_t) < 1e-12
assert 45 < np.argmin(E[:91]) < 70 and E[:91].min() < 0.75 * E_t

# %% [markdown]
# Not with $G_A = 0.8$: it is softest at 52 degrees, with 2.42 MPa instead of 3.30 across the
# fibers, because there the strip gives way by sliding along its fibers. With $G_A = 2.5$ the
# softest direction is the one across.
#
# ## What does a strip do that is pulled off its axis?
#
# **Question.** Fibers at 30 degrees, a pull along the strip. Which way will it shear: will its
# fibers turn towards the pull or away from it? Think before you read on.

# %%
strip = meshes.block(MPI.COMM_WORLD, (4.0, 1.0, 0.5), n=(16, 4, 2), cells="hexahedron")
oblique = ufl.as_vector(A.tolist())


def fibers_in(u):
    """F and the energy of the strip."""
    F = forms.deformation_gradient(u)
    return F, forms.energies.transversely_isotropic_neo_hookean(F, fiber=oblique, **constants)


t = forms.load_factor(strip)
u = forms.displacement(strip)
F, psi = fibers_in(u)
P11 = first_piola(F_strip, fibrous)[0, 0]
pull = forms.dead_traction(u, (t * P11, 0, 0), strip.ds("right"))
pull += forms.dead_traction(u, (-t * P11, 0, 0), strip.ds("left"))
# Against rigid motions; the second pin keeps F_21 = 0, as above.
pins = [forms.pin(u, (0, 0, 0)), forms.pin(u, (4, 0, 0), [1, 2]), forms.pin(u, (0, 1, 0), [2])]
path = forms.follow(psi * ufl.dx + pull, u, pins, t, progress=False)
F_FE = EYE + np.stack([forms.at(u, X) for X in np.eye(3) * (4, 1, 0.5)], 1) / (4, 1, 0.5)
print(np.round(F_FE, 4) + 0.0)  # + 0.0 turns -0 into 0
assert np.allclose(F_FE, F_strip, atol=1e-6) and abs(F_strip[0, 1] + 0.37) < 0.01

# %% [markdown]
# 128 elements whose ends are pulled, but not held, find what three unknowns found by hand: the
# strip shears by $g = -0.37$. Its ends lean back, so that the fibers turn towards the pull, from
# 30 degrees to 21.5. In a testing machine the grips forbid that.

# %%
u = forms.displacement(strip)
F, psi = fibers_in(u)
t.value = 0.0
grips = [
    forms.clamp(u, strip.facets("left")),
    forms.translate(u, strip.facets("right"), (1.6 * t, 0, 0)),
]
path = forms.follow(psi * ufl.dx, u, grips, t, progress=False)
force, moment = forms.resultant(path, strip.facets("right"), about=(5.6, 0.5, 0.25))
a = F * oblique
angle = ufl.atan2(a[1], a[0]) * 180 / np.pi
picture = folder / "strip.png"
forms.picture(path, picture, angle, "angle of the\nfibers [deg]", view=(0, 0, 1), size=(700, 320))
nominal = force[0] / 0.5
print(f"nominal stress: {nominal:.3f} MPa between grips, {P11:.3f} MPa with free ends")
middle = forms.at(forms.field(angle, strip), (2, 0.5, 0.25))[0]
turned = np.degrees(np.arctan2(*(F_strip @ A)[[1, 0]]))
print(f"fibers: {middle:.1f} degrees amid the grips, {turned:.1f} with free ends, 30 at rest")
assert abs(nominal / P11 - 1.15) < 0.01 and abs(moment[2]) > 0.1
assert abs(turned - 21.5) < 0.1 and turned < middle < 30
Image(filename=picture)

# %% [markdown]
# Between grips the strip takes the shape of an S, and needs a moment and 15 % more force. A
# modulus read off this test would be too large: that is why off-axis specimens are made long and
# thin.
#
# ## Exercises

# %% [markdown]
# **Exercise 1.** Real tissue has one Poisson's ratio in the plane and another under axial load:
# `forms.energies.transversely_isotropic_constants_five`. Take $E_A = 9$, $E_t = 3$, $\nu_t = 0.4$,
# $\nu_A = 0.2$, $G_A = 0.8$ and show by `tension` that all come back.
#
# <details><summary><b>Solution</b> (click to show it)</summary>
#
# Both ratios are independent now; under load across the fibers they contract by $\nu_A E_t / E_A$.
#
# ```python
# five = forms.energies.transversely_isotropic_constants_five(9.0, 3.0, 0.4, 0.2, 0.8)
# E1, by_axial = tension(0, five)
# E2, by_transverse = tension(1, five)
# assert np.allclose([E1, E2], [9, 3], atol=1e-3)
# assert np.allclose([by_axial[1], by_transverse[2]], [0.2, 0.4], atol=1e-3)
# assert abs(by_transverse[0] - 0.2 * 3 / 9) < 1e-3
# ```
# </details>

# %%
# Your answer to exercise 1:

# %% [markdown]
# **Exercise 2.** For which ratio $E_A / E_t$ do the printed constants cease to exist, and what
# does the package say there? Hint: $m$ in (25) is divided by.
#
# <details><summary><b>Solution</b> (click to show it)</summary>
#
# With $n = E_A / E_t$ one has $m = 1 - \nu - 2 n \nu^2 = 0$ at $n = (1 - \nu) / (2 \nu^2) =
# 5.01$: no fibers could be more than five times as stiff as what lies between them.
#
# ```python
# largest = (1 - nu) / (2 * nu**2)
# materials.transversely_isotropic_constants(mu, nu, 0.999 * largest * E_t, G_A, as_printed=True)
# try:
#     too_stiff = 1.001 * largest * E_t
#     materials.transversely_isotropic_constants(mu, nu, too_stiff, G_A, as_printed=True)
# except ValueError as refusal:
#     print(refusal)
# else:
#     raise AssertionError("not refused")
# materials.transversely_isotropic_constants(mu, nu, 100 * E_t, G_A)  # the corrected ones exist
# ```
# </details>

# %%
# Your answer to exercise 2:

# %% [markdown]
# **Exercise 3.** There is an angle between 0 and 90 degrees at which a strip pulled by a small
# strain does not shear at all. Find it for $G_A = 0.8$, and what is special about the modulus
# there.
#
# <details><summary><b>Solution</b> (click to show it)</summary>
#
# The shear strain is a quarter of the derivative of $\sigma/E$ by the angle: turn $\mathbf n$ in
# $\mathbf n\mathbf n : \mathbb S : \mathbf n\mathbf n$. So the strip does not shear where it is
# softest.
#
# ```python
# D = materials.voigt_elasticity(materials.transversely_isotropic_elasticity(EYE, along, right))
#
#
# def shear(degrees):
#     c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
#     n, m = np.array([c, s, 0]), np.array([-s, c, 0])
#     strain = np.linalg.solve(D, materials.voigt_stress(np.outer(n, n)))
#     return n @ materials.strain_from_voigt(strain) @ m
#
#
# low, high = 20.0, 80.0
# for _ in range(60):
#     half = (low + high) / 2
#     low, high = (half, high) if shear(half) * shear(20) > 0 else (low, half)
# print(f"no shear at {low:.1f} degrees")
# assert abs(low - np.argmin(stiffness(theta, G_A)[:91])) < 1
# ```
# </details>

# %%
# Your answer to exercise 3:
