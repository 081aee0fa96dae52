# SPDX-License-Identifier: MIT

# %% [markdown]
# # 3. The residual form by hand
#
# You will write the tetrahedron of [document 003](../documents/README.md) in twenty lines, force
# and tangent, and assemble a body from it; the automatic derivatives must agree to the last digit.
# Then you will leave parts out, as the document's print does, and see who notices.
#
# Before: notebooks 1 and 2. Equation numbers in parentheses are those of document 003: V. W. L.
# Chan, *Compressible Hyperelastic Constitutive Relation*, sections VII and VIII.

# %%
import inspect

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
import ufl
from dolfinx import fem

from variform import forms, meshes
from variform.forms.formulas import element, materials, quadrature, shapes

plt.rcParams.update({"figure.dpi": 90, "font.size": 9})
rng = np.random.default_rng(3)
mu, lmbda = 1.3, 2.1  # Pa

# %% [markdown]
# ## One element
#
# A virtual velocity $N_a e_i$ of one node does the work of the internal force (55)
#
# $$T_a = \int \sigma \nabla N_a \,dv,$$
#
# and the change of $T_a$ with the place of node $b$ is the tangent $K_c + K_\sigma$ (48), (51):
#
# $$K_{c,ab} = \int B_a^T D B_b \,dv, \qquad
#   K_{\sigma,ab} = \int \nabla N_a \cdot \sigma \nabla N_b \,dv \; I.$$
#
# **Question.** In a tetrahedron with four nodes, which of these integrands vary inside the
# element? How many quadrature points do you need?
#
# None, because all gradients are constant: each integral is its integrand times the present volume.


# %%
def tet4(X, x):
    """T (cells, 4, 3), K_c and K_sigma (cells, 4, 3, 4, 3) of tetrahedra with nodes X, now at x."""
    dN = np.vstack([-np.ones(3), np.eye(3)])  # gradients on the reference cell
    map_X, map_x = (np.einsum("cai,aj->cij", nodes, dN) for nodes in (X, x))
    G0, G = dN @ np.linalg.inv(map_X), dN @ np.linalg.inv(map_x)  # row a: gradient of N_a
    v = abs(np.linalg.det(map_x)) / 6  # DOLFINx counts some cells clockwise
    F = np.einsum("cai,caI->ciI", x, G0)  # (43)
    J = np.linalg.det(F)[:, None, None]
    b = F @ F.transpose(0, 2, 1)
    sigma = mu / J * (b - np.eye(3)) + lmbda / J * np.log(J) * np.eye(3)  # (18)
    T = np.einsum("cij,caj,c->cai", sigma, G, v)  # (55)

    D = np.zeros((len(X), 6, 6))  # (49)
    D[:, :3, :3] = lmbda / J
    D += (mu - lmbda * np.log(J)) / J * np.diag([2, 2, 2, 1, 1, 1])
    B = np.zeros((len(X), 4, 6, 3))  # (47): strains 11, 22, 33, 12, 23, 13
    B[:, :, [0, 3, 5], 0] = G
    B[:, :, [3, 1, 4], 1] = G
    B[:, :, [5, 4, 2], 2] = G
    K_c = np.einsum("caIi,cIJ,cbJj,c->caibj", B, D, B, v, optimize=True)  # (48)
    K_sigma = np.einsum("cai,cij,cbj,c,kl->cakbl", G, sigma, G, v, np.eye(3), optimize=True)  # (51)
    return T, K_c, K_sigma


X = shapes.NODES["tet4"][None]  # one cell
x = X + 0.1 * rng.uniform(-1, 1, X.shape)
T, K_c, K_sigma = tet4(X, x)

h = 1e-6
dx = rng.uniform(-1, 1, X.shape)
slope = (tet4(X, x + h * dx)[0] - tet4(X, x - h * dx)[0]) / (2 * h)
error = abs(slope - np.einsum("caibj,cbj->cai", K_c + K_sigma, dx)).max()
print(f"slope of T minus K: {error:.0e} N/m; without K_sigma:", end=" ")
print(f"{abs(slope - np.einsum('caibj,cbj->cai', K_c, dx)).max():.0e} N/m")
assert error < 1e-9  # h^2 and the rounding of T over h, 1e-10


# %%
def material(F):
    """Stress and elasticity tensor of the energy (16)."""
    return materials.neo_hookean_cauchy(F, mu, lmbda), materials.neo_hookean_elasticity(
        F, mu, lmbda
    )


library = element.Integrator("tet4", X[0], x[0], material)
library.process(*quadrature.tetrahedron(1))
error_T = abs(T[0] - library.force).max()
error_K = abs((K_c + K_sigma)[0] - library.stiffness).max()
print(f"against forms.formulas: T {error_T:.0e} N, K {error_K:.0e} N/m of {abs(K_c).max():.1f}")
assert error_T < 1e-15 and error_K < 1e-14

# %% [markdown]
# ## A body
#
# **Question.** What does an element need to know of its neighbors?
#
# Nothing: forces of shared nodes are added up, and so are stiffnesses. A body force $f$ per
# reference volume puts $f V / 4$ on each node (53).

# %%
body = meshes.block(MPI.COMM_WORLD, (10.0, 1.0, 1.0), n=(16, 2, 2))
u = forms.displacement(body)
nodes = u.function_space.tabulate_dof_coordinates()
cells = u.function_space.dofmap.list


def assembled(y):
    """T, K_c and K_sigma of the body with displacements y of its nodes, shape (3 nodes,)."""
    T, *blocks = tet4(nodes[cells], (nodes + y.reshape(-1, 3))[cells])
    vector = element.assemble_vector(T, cells, len(nodes))
    return vector, *(element.assemble_matrix(K, cells, len(nodes)) for K in blocks)


f = np.array([0.0, 0.0, 1e-3])  # N/m^3


def volumes(y):
    """Volumes of the deformed elements."""
    x = (nodes + y.reshape(-1, 3))[cells]
    return np.linalg.det(x[:, 1:] - x[:, :1]) / 6


rest = volumes(np.zeros(nodes.size))
shares = abs(rest)[:, None, None] / 4 * np.broadcast_to(f, (len(cells), 4, 3))
load = element.assemble_vector(shares, cells, len(nodes))

# %% [markdown]
# **Question.** The automatic way knows neither $B$ nor $D$ nor $K_\sigma$. It has differentiated
# $\psi$ in the reference body, where we have integrated $\sigma$ over the deformed one. Will the
# numbers agree in all digits, or to the order of the elements?

# %%
psi = forms.energies.neo_hookean(forms.deformation_gradient(u), mu, lmbda)
R_form = forms.residual(psi * ufl.dx + forms.body_force(u, ufl.as_vector(f)), u)
K_form = forms.tangent(R_form, u)

u.x.array[:] = 0.02 * rng.uniform(-1, 1, u.x.array.size)
T, K_c, K_sigma = assembled(u.x.array)
R = fem.assemble_vector(forms.compiled(R_form)).array
K = fem.assemble_matrix(forms.compiled(K_form)).to_dense()
print(f"{len(cells)} elements, {len(R)} unknowns")
print(f"T - F against R:         {abs(T - load - R).max():.0e} of {abs(R).max():.2f} N")
print(f"K_c + K_sigma against K: {abs(K_c + K_sigma - K).max():.0e} of {abs(K).max():.1f} N/m")
assert abs(T - load - R).max() < 1e-13 * abs(R).max()
assert abs(K_c + K_sigma - K).max() < 1e-13 * abs(K).max()

# %%
lines = len(inspect.getsource(tet4).splitlines()), len(inspect.getsource(assembled).splitlines())
print(f"by hand: {sum(lines)} lines, from (18), (20), (43), (47)-(51), (55); automatic: 3 lines")

# %% [markdown]
# They are one discrete problem: only rounding differs. By hand, another energy needs a new $\sigma$
# and a new $D$ (two pages in document 003 for fibers, with five errors: notebook 4), other elements
# need quadrature, and there is a function to test for each. By machine, both are a word.
#
# ## Missing weights
#
# With more points (58) is a sum over them, $T_a = \sum_i W_i\, \sigma(\xi_i) \nabla N_a(\xi_i)
# \det J^{(e)}(\xi_i)$. Print has no $W_i$ in (59), (60), puts one $\sigma$ in front of the sum in
# (58), and adds over $a$ where the $T_a$ should be stacked.
#
# **Question.** You implement what is printed and test it on the element you have. On which elements
# do you notice?

# %%
rules = {
    "tet4, 1 point": ("tet4", *quadrature.tetrahedron(1)),
    "tet10, 4 points": ("tet10", *quadrature.tetrahedron(2)),
    "hex8, 2 x 2 x 2 points": ("hex8", *quadrature.hexahedron(2)),
    "hex8, 3 x 3 x 3 points": ("hex8", *quadrature.hexahedron(3)),
}
errors = {}
print("relative error of T:   without W_i  one sigma  max |sum of T_a|")
for name, (cell, points, weights) in rules.items():
    X = shapes.NODES[cell]
    x = X + 0.1 * rng.uniform(-1, 1, X.shape)
    forces = []
    for as_printed in (False, True):
        gathered = element.Integrator(cell, X, x, material, as_printed)
        gathered.process(points, weights)
        forces.append(gathered.force)
    exact, printed = forces
    dN = shapes.shape_gradients(cell, points)
    G, det = element.gradients(dN, x)
    F = element.deformation_gradient(x, element.gradients(dN, X)[0])
    middle = material(F.mean(axis=0))[0]
    one_stress = element.quadrature_force(middle, G, weights, det, as_printed=True)
    errors[name] = [abs(wrong - exact).max() / abs(exact).max() for wrong in (printed, one_stress)]
    added = abs(element.element_vector(exact, as_printed=True)).max()
    print(f"{name:22s} {errors[name][0]:11.2f} {errors[name][1]:10.2f} {added:15.0e} N")
assert errors["hex8, 2 x 2 x 2 points"][0] < 1e-14 and errors["tet4, 1 point"][1] < 1e-14

# %% [markdown]
# Two Gauss points in each direction have weights of 1: the favorite hexahedron forgives (59). Four
# nodes have one stress: the tetrahedron forgives (58). The factors 5 and 23 are $1/W_i - 1$. And
# $\sum_a T_a = 0$ in every element, whatever the stress, because $\sum_a \nabla N_a = 0$.
#
# ## Who needs the geometric stiffness?
#
# $K_\sigma$ knows nothing of the material. It is what turns the stress when the body turns.
#
# **Question.** A guitar string is light and thin. Where does its stiffness against plucking come
# from, $K_c$ or $K_\sigma$?
#
# We hold both ends of our bar, stretch it, load it sideways by $f$, and solve by Newton's method,
# with and without $K_\sigma$. Near the solution the iteration without it, $u - K_c^{-1} R$,
# multiplies the error by $I - K_c^{-1} K = -K_c^{-1} K_\sigma$, whose largest eigenvalue decides.

# %%
ends = np.isclose(nodes[:, 0], 0) | np.isclose(nodes[:, 0], 10)
free = np.flatnonzero(np.repeat(~ends, 3))
inner = np.ix_(free, free)


def newton(stretch, geometric, most=40):
    """Displacements of the bar, stretched and loaded, and the norms of T - F on the way."""
    y, norms = np.zeros(nodes.size), []
    y[0::3] = stretch * nodes[:, 0]
    while len(norms) < most and (volumes(y) / rest).min() > 0:
        T, K_c, K_sigma = assembled(y)
        R = (T - load)[free]
        norms.append(np.linalg.norm(R))
        if not 1e-13 < norms[-1] < 1e3:
            break
        K = K_c + K_sigma if geometric else K_c
        y[free] -= np.linalg.solve(K[inner], R)
    return y, np.array(norms)


def largest_factor(y):
    """Largest modulus of the eigenvalues of K_c^-1 K_sigma."""
    _, K_c, K_sigma = assembled(y)
    return abs(np.linalg.eigvals(np.linalg.solve(K_c[inner], K_sigma[inner]))).max()


# %%
shown = (0.01, 0.03, 0.04, 0.1)
full = {s: newton(s, geometric=True) for s in shown}
part = {s: newton(s, geometric=False)[1] for s in shown}
for s in shown:
    predicted, measured = largest_factor(full[s][0]), (part[s][1:] / part[s][:-1])[-5]
    found = f"|R| times {measured:.3f}" if predicted < 1 else "elements turn inside out"
    print(f"stretched {s:4.0%}: {len(full[s][1]) - 1} iterations with K_sigma; without: {found},")
    print(f"                largest eigenvalue {predicted:.3f}")
    assert len(full[s][1]) == 5
    assert predicted > 1 or abs(measured - predicted) < 1e-3
    assert predicted < 1 or part[s].min() > 1e-6

# %%
sweep = np.linspace(0, 0.1, 11)
factors = [largest_factor(newton(s, geometric=True)[0]) for s in sweep]
figure, (left, right) = plt.subplots(1, 2, figsize=(7, 3.0), layout="constrained")
for s in shown:
    left.semilogy(part[s][:25], "o-", ms=2.5)
    at = min(len(part[s]), 25) - 1
    left.annotate(f" {s:.0%}", (at, part[s][at]), va="center", color=left.lines[-1].get_color())
left.semilogy(full[0.04][1], "k--", lw=1)
left.annotate(" with $K_\\sigma$, 4%", (4, full[0.04][1][4]), va="top")
left.set(
    xlabel="iteration [-]",
    ylabel="|R| [N]",
    xlim=(-1, 29),
    ylim=(1e-15, 1e3),
    title="without $K_\\sigma$",
)
right.plot(100 * sweep, factors, "o-", ms=3)
right.axhline(1, color="0.5", lw=1)
right.annotate("diverges", (0.2, 1.05))
right.set(
    xlabel="stretch of the bar [%]", ylabel=r"largest $|\mathrm{eig}\,K_c^{-1} K_\sigma|$ [-]"
)
plt.show()
assert np.interp(1.0, factors, sweep) < 0.05

# %% [markdown]
# With $K_\sigma$ four iterations, whatever the stretch. Without it the error falls by a
# constant factor, 0.21 at a stretch of 1 %, 0.88 at 4 %, and from 4.5 % on it grows: there more of
# the bar's stiffness against bending comes from its tension than from its material, as in a string.
# Automatic differentiation leaves out nothing.
#
# ## Exercises
#
# **Exercise 1.** In compression $K_\sigma$ is negative. At which strain does the tangent of the
# straight, unloaded bar cease to be positive definite? Predict it from `largest_factor` at 1 %;
# then follow the smallest eigenvalues of $K_c + K_\sigma$ and of $K_c$ up to 5 %, and extrapolate.
# Euler's strain for clamped ends is $4 \pi^2 I / (A L^2) = 3.3$ %.
#
# <details><summary><b>Solution</b> (click to show it)</summary>
#
# $K_\sigma$ grows about as the strain, so the eigenvalue of $K_c^{-1} K_\sigma$ reaches $-1$ near
# 1 % over its modulus there. $K_c$ notices nothing. The bar buckles much later than Euler's,
# because linear tetrahedra are too stiff in bending.
#
# ```python
# load = 0 * load
# strains, softest = np.linspace(0.01, 0.05, 5), []
# for strain in strains:
#     _, K_c, K_sigma = assembled(newton(-strain, geometric=True)[0])
#     softest.append([np.linalg.eigvalsh(K[inner])[0] for K in (K_c + K_sigma, K_c)])
# softest = np.array(softest)
# buckles = np.roots(np.polyfit(strains, softest[:, 0], 2))
# buckles = buckles[buckles > 0].min()
# predicted = 0.01 / largest_factor(newton(-0.01, geometric=True)[0])
# print(f"buckles at {buckles:.2%}, predicted {predicted:.2%}")
# assert abs(predicted / buckles - 1) < 0.2 and np.all(np.diff(softest[:, 1]) > 0)
# ```
# </details>

# %% [markdown]
# **Exercise 2.** Turn a deformed tetrahedron as a whole by a rotation $Q$. How does $T$ change?
# What are $K_c$ and $K_\sigma$ times the velocities $\omega \times x_a$ of a spin?
#
# <details><summary><b>Solution</b> (click to show it)</summary>
#
# $T_a$ becomes $Q T_a$. A spin strains nothing, so $K_c$ gives nothing, but the forces must turn:
# that is the work of $K_\sigma$.
#
# ```python
# X = shapes.NODES["tet4"][None]
# x = X + 0.1 * rng.uniform(-1, 1, X.shape)
# T, K_c, K_sigma = tet4(X, x)
# omega = np.array([0.3, -0.2, 0.5])
# spin = np.cross(omega, x)
# assert np.allclose(np.einsum("caibj,cbj->cai", K_c, spin), 0, atol=1e-14)
# assert np.allclose(np.einsum("caibj,cbj->cai", K_sigma, spin), np.cross(omega, T), atol=1e-14)
# Q = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
# assert np.allclose(tet4(X, x @ Q.T)[0], T @ Q.T, atol=1e-14)
# ```
# </details>

# %%
# Your answer to exercise 2:
