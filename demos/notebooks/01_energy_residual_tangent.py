# SPDX-License-Identifier: MIT

# %% [markdown]
# # 1. From an energy to a residual to a tangent
#
# You will differentiate one energy twice: for a bar by hand, for a tetrahedron in NumPy, for a body
# by `forms.residual` and `forms.tangent`. Then you will test derivatives by Taylor's theorem, and
# see what a wrong one costs Newton's method.
#
# Before: gradients of functions of several variables; $F = I + \nabla u$, $C = F^T F$, $J = \det
# F$. Equation numbers in parentheses are those of [document 003](../documents/README.md): V. W. L.
# Chan, *Compressible Hyperelastic Constitutive Relation*.

# %%
from mpi4py import MPI

import basix.ufl
import matplotlib.pyplot as plt
import numpy as np
import ufl
from dolfinx import fem, mesh

from variform import forms, meshes

plt.rcParams.update({"figure.dpi": 90, "font.size": 9})
rng = np.random.default_rng(1)
mu, lmbda = 1.0, 2.0  # Pa

# %% [markdown]
# ## One number
#
# The energy of the whole notebook is the neo-Hookean one (16):
#
# $$\psi(F) = \tfrac{\mu}{2}(\operatorname{tr} C - 3) - \mu \ln J + \tfrac{\lambda}{2} (\ln J)^2.$$
#
# A bar of unit length and cross-section is stretched by $u$ between rigid walls, so that
# $F = \operatorname{diag}(1 + u, 1, 1)$, and a dead force $t$ pulls at its end:
#
# $$E(u) = \tfrac{\mu}{2}(s^2 - 1) - \mu \ln s + \tfrac{\lambda}{2} (\ln s)^2 - t u,
#   \qquad s = 1 + u.$$
#
# **Question.** The bar rests where $E$ is least. Which equation says so, and what do you need to
# solve it? Think before you read on.
#
# The *residual* $R = E'$ must vanish, and Newton's method needs its slope, the *tangent* $K = E''$:
#
# $$R = \mu \left(s - \tfrac1s\right) + \lambda \tfrac{\ln s}{s} - t, \qquad
#   K = \mu \left(1 + \tfrac{1}{s^2}\right) + \lambda \tfrac{1 - \ln s}{s^2}.$$


# %%
def bar(u, t):
    """Residual and tangent at the displacement u under the force t."""
    s = 1 + u
    R = mu * (s - 1 / s) + lmbda * np.log(s) / s - t
    return R, mu * (1 + 1 / s**2) + lmbda * (1 - np.log(s)) / s**2


u, t = 0.0, 2.0  # m, N
for _ in range(5):
    R, K = bar(u, t)
    u -= R / K
    print(f"u = {u:.15f} m, |R| = {abs(bar(u, t)[0]):.1e} N")
assert abs(bar(u, t)[0]) < 1e-14

# %% [markdown]
# The exponent of $|R|$ doubles from line to line: five iterations from rest to fourteen digits.
#
# ## The same for a tensor
#
# **Question.** Now $u$ is a field and $E(u) = \int \psi(F)\,dV$. What takes the place of $E'$?
#
# The slope of $E$ along any field $v$, the *Gateaux derivative*. With $\delta F = \nabla v$ come
# $\delta J = J F^{-T} : \nabla v$ and $\delta F^{-T} = -F^{-T} (\nabla v)^T F^{-T}$, hence
#
# $$R[v] = \frac{d}{dh} E(u + h v)\Big|_{h=0} = \int P : \nabla v \,dV, \qquad
#   P = \mu (F - F^{-T}) + \lambda \ln J \, F^{-T},$$
#
# $$K[v, w] = \frac{d}{dh} R[v](u + h w)\Big|_{h=0} = \int \nabla v : A : \nabla w \,dV, \qquad
#   A : H = \mu H + (\mu - \lambda \ln J) F^{-T} H^T F^{-T} + \lambda (F^{-T} : H) F^{-T}.$$


# %%
def first_piola(F):
    """P = dpsi / dF."""
    G = np.linalg.inv(F).T
    return mu * (F - G) + lmbda * np.log(np.linalg.det(F)) * G


def first_elasticity(F):
    """A_iJkL = dP_iJ / dF_kL."""
    G, d = np.linalg.inv(F).T, np.eye(3)
    twisted = (mu - lmbda * np.log(np.linalg.det(F))) * np.einsum("iL,kJ->iJkL", G, G)
    return mu * np.einsum("ik,JL->iJkL", d, d) + twisted + lmbda * np.einsum("iJ,kL->iJkL", G, G)


# %% [markdown]
# ## One element
#
# In a tetrahedron with four nodes the gradients $\nabla N_a$ of the shape functions are constant.
# With the displacements $u_a$ of its nodes, $\nabla u = \sum_a u_a \otimes \nabla N_a$.
#
# **Question.** $E$ is then a function of 12 numbers. What are its 12 slopes and its 12 x 12
# second derivatives, in terms of $P$ and $A$?
#
# For $v = N_a e_i$ the gradient is $e_i \otimes \nabla N_a$. So $R_{ai} = V P_{iJ} N_{a,J}$ and
# $K_{aibk} = V N_{a,J} A_{iJkL} N_{b,L}$.


# %%
def element(X, u):
    """Residual and tangent of one tetrahedron with nodes X (4, 3) and displacements u (4, 3)."""
    edges = X[1:] - X[0]
    G = np.vstack([-np.ones(3), np.eye(3)]) @ np.linalg.inv(edges).T  # row a: gradient of N_a
    V = np.linalg.det(edges) / 6
    F = np.eye(3) + u.T @ G
    R = V * np.einsum("iJ,aJ->ai", first_piola(F), G)
    K = V * np.einsum("aJ,iJkL,bL->aibk", G, first_elasticity(F), G)
    return R.ravel(), K.reshape(12, 12)


X = np.array([[0, 0, 0], [1, 0, 0], [0.2, 1, 0], [0.1, 0.3, 0.8]])
u = 0.15 * rng.uniform(-1, 1, (4, 3))
R_hand, K_hand = element(X, u)
print(f"sum of the nodal forces: {abs(R_hand.reshape(4, 3).sum(axis=0)).max():.0e}")
print("eigenvalues of K:", np.linalg.eigvalsh(K_hand).round(3) + 0.0)
assert np.allclose(K_hand, K_hand.T, atol=1e-14)

# %% [markdown]
# The forces add up to nothing, because a translation costs no energy; so three eigenvalues are
# zero, too. $K$ is symmetric: second derivatives do not ask which came first, which answers the
# "how can I show this??" of document 003 at (36).
#
# ## By machine
#
# **Question.** Nothing in the last two sections was specific to (16) but $P$ and $A$. Can a
# program find these from $\psi$?
#
# UFL keeps $\psi$ as an expression and differentiates it by the rules you have just used. The same
# element, as a DOLFINx mesh of one cell:

# %%
tetrahedron = ufl.Mesh(basix.ufl.element("Lagrange", "tetrahedron", 1, shape=(3,)))
one_cell = mesh.create_mesh(MPI.COMM_WORLD, cells=np.array([[0, 1, 2, 3]]), x=X, e=tetrahedron)
w = forms.displacement(one_cell)
w.x.array[:] = u.ravel()  # one cell: the nodes keep their order

F_ufl = forms.deformation_gradient(w)
psi = forms.energies.neo_hookean(F_ufl, mu, lmbda)
R = forms.residual(psi * ufl.dx, w)  # int P : grad v dV
K = forms.tangent(R, w)  # int grad v : A : grad w dV

R_ufl = fem.assemble_vector(forms.compiled(R)).array
K_ufl = fem.assemble_matrix(forms.compiled(K)).to_dense()
error_R, error_K = abs(R_ufl - R_hand).max(), abs(K_ufl - K_hand).max()
print(f"by machine minus by hand: {error_R:.0e}, {error_K:.0e} of {abs(K_hand).max():.1f}")
assert error_R < 1e-14 and error_K < 1e-14  # rounding: the entries are below 1

# %% [markdown]
# Two lines for what took two derivations and an `einsum` for each. The forms $R$ and $K$ are
# mathematics still, no arrays: `forms.compiled` turns them into C, `fem.assemble_…` runs it.
#
# **Question.** Document 003 writes the same $R$ as $\int S : \delta\dot E\,dV$ (29), and the same
# $K$, in the deformed body, as $\int \delta d : c : \varepsilon\,dv +
# \int \sigma : [(\nabla w)^T \nabla v]\,dv$ (34). Which of the two integrals of (34) is there at
# rest?

# %%
v, dw = ufl.TestFunction(w.function_space), ufl.TrialFunction(w.function_space)
S = forms.stress.second_piola(psi, F_ufl)
sigma = forms.stress.cauchy(psi, F_ufl)
c = forms.stress.spatial_elasticity(psi, F_ufl)
R_29 = forms.by_hand.material_virtual_work(S, F_ufl, w, v, ufl.dx)
K_34 = forms.by_hand.linearized_spatial(sigma, c, F_ufl, w, v, dw, ufl.dx)
error_R = abs(fem.assemble_vector(forms.compiled(R_29)).array - R_hand).max()
error_K = abs(fem.assemble_matrix(forms.compiled(K_34)).to_dense() - K_hand).max()
print(f"(29) and (34) minus by hand: {error_R:.0e}, {error_K:.0e}")
assert error_R < 1e-14 and error_K < 1e-14

# %% [markdown]
# All spellings are one form. At rest $\sigma = 0$, and the first integral of (34), the linear
# elasticity of your first course, is left.
#
# ## Taylor's test
#
# **Question.** You have written a derivative and no second opinion is at hand. How do you find out
# whether it is right, to the last term?
#
# By the remainders along any field $v$. For correct $R$ and $K$
#
# $$r_1 = |E(u + hv) - E(u)| = O(h), \quad r_2 = |\ldots - h R[v]| = O(h^2), \quad
#   r_3 = |\ldots - \tfrac{h^2}{2} K[v, v]| = O(h^3).$$
#
# A wrong $R$ leaves $r_2 = O(h)$, a wrong $K$ leaves $r_3 = O(h^2)$, however small the mistake.

# %%
body = meshes.block(MPI.COMM_WORLD, (2.0, 1.0, 1.0), n=(4, 2, 2))
u = forms.displacement(body)
E = forms.energies.neo_hookean(forms.deformation_gradient(u), mu, lmbda) * ufl.dx
R = forms.residual(E, u)
K = forms.tangent(R, u)

v = fem.Function(u.function_space)
u.interpolate(lambda x: 0.2 * np.sin(x))
v.interpolate(lambda x: np.cos(x[[1, 2, 0]]) + x)
start = u.x.array.copy()
# ufl.action puts a function into the last argument: R[v] and K[v, v] are numbers then.
energy, first, second = map(forms.compiled, (E, ufl.action(R, v), ufl.action(ufl.action(K, v), v)))
E0, E1, E2 = map(fem.assemble_scalar, (energy, first, second))


def remainders(h, E1, E2):
    """The numbers r_1, r_2, r_3 with the derivatives E1 and E2 along v."""
    u.x.array[:] = start + h * v.x.array
    rise = fem.assemble_scalar(energy) - E0
    u.x.array[:] = start
    return abs(rise), abs(rise - h * E1), abs(rise - h * E1 - h**2 / 2 * E2)


# %%
steps = 0.1 / 2 ** np.arange(9)
right = np.array([remainders(h, E1, E2) for h in steps])
wrong = np.array([remainders(h, E1, 1.01 * E2) for h in steps])
rates = np.log2(right[:-1] / right[1:])
print("rates of the last halving:", rates[-1].round(3), "; K off by 1 %:", end=" ")
print(np.log2(wrong[-2, 2] / wrong[-1, 2]).round(3))

figure, axes = plt.subplots(figsize=(6, 3.2), layout="constrained")
for n in range(3):
    axes.loglog(steps, right[:, n], "o-", ms=3)
    axes.annotate(f" $r_{n + 1}$, rate {rates[-1, n]:.2f}", (steps[0], right[0, n]))
axes.loglog(steps, wrong[:, 2], "k--", lw=1)
axes.annotate("$r_3$, $K$ off by 1 %  ", (steps[5], wrong[5, 2]), ha="right", va="bottom")
axes.set(xlabel="step h [-]", ylabel="remainder [J]", xlim=(steps[-1] * 0.8, 0.6))
plt.show()
assert np.allclose(rates[-1], [1, 2, 3], atol=0.05)

# %% [markdown]
# Slopes 1, 2, 3. A tangent that is off by 1 % cannot hide: its $r_3$ bends over to slope 2.
#
# ## What Newton's method makes of it
#
# **Question.** Suppose your tangent is off by 1 %, $\tilde K = 1.01\,K$. The residual is right.
# Does Newton's method converge? To the right solution? How many more iterations?

# %%
traction = ufl.as_vector((-0.1, 0.02, 0.0))  # Pa: a push that bends a little
loaded = E + forms.dead_traction(u, traction, body.ds("right"))
clamp = forms.clamp(u, body.facets("left"))
system = forms.Problem(loaded, u, [clamp])
free = np.setdiff1d(np.arange(system.size), system.constrained)
out_of_balance = forms.residual(loaded, u)
R_loaded, K_loaded = map(forms.compiled, (out_of_balance, forms.tangent(out_of_balance, u)))


def newton(factor, most=25):
    """Norms of the out-of-balance forces with the tangent times a factor."""
    u.x.array[:] = 0
    norms = []
    while len(norms) < most:
        force = fem.assemble_vector(R_loaded).array[free]
        norms.append(np.linalg.norm(force))
        if norms[-1] < 1e-14:
            break
        tangent = fem.assemble_matrix(K_loaded).to_dense()[np.ix_(free, free)]
        u.x.array[free] -= np.linalg.solve(factor * tangent, force)
    return np.array(norms), u.x.array.copy()


runs = {factor: newton(factor) for factor in (1.0, 1.01, 1.1)}

# %%
figure, axes = plt.subplots(figsize=(6, 3.0), layout="constrained")
names = {1.0: "exact", 1.01: "1 % off", 1.1: "10 % off"}
for factor, (norms, _) in runs.items():
    axes.semilogy(norms, "o-", ms=3)
    axes.annotate(f"  {names[factor]}", (len(norms) - 1, norms[-1]), va="center")
    print(f"{names[factor]:>8}: {len(norms) - 1:2d} iterations, last |R| {norms[-1]:.0e} N")
axes.set(xlabel="iteration [-]", ylabel="|R| [N]", xlim=(-0.5, 18), xticks=range(0, 18, 2))
plt.show()

(exact, solution), (off, other) = runs[1.0], runs[1.01]
print("exact, new |R| over the square of the old one:", (exact[1:-1] / exact[:-2] ** 2).round(1))
print("1 % off, new |R| over the old one:            ", (off[5:-1] / off[4:-2]).round(4))
assert np.ptp(np.log(exact[1:-1] / exact[:-2] ** 2)) < np.log(2)  # the same constant throughout
assert abs(off[6] / off[5] - (1 - 1 / 1.01)) < 1e-4
assert abs(solution - other).max() < 1e-12  # |R| < 1e-14 over the smallest eigenvalue, 0.01

# %% [markdown]
# The exact tangent squares the error: |R| is about 15 times its old square, each time, until
# rounding stops it. A tangent off by 1 % multiplies it by $1 - 1/1.01 = 0.0099$, two digits an
# iteration; 10 % off, one digit. The solution is the same, because the residual says where it is;
# the tangent only says how to get there. So Newton's iterations tell whether a tangent is right,
# and `forms` always has the exact one:

# %%
u.x.array[:] = 0
path = forms.solve(loaded, u, [clamp])
print(path.reason)
assert abs(u.x.array - solution).max() < 1e-8

# %% [markdown]
# ## Exercises
#
# **Exercise 1.** Document 003 has a second neo-Hookean energy in (21), with $\tfrac{\lambda}{2}(J -
# 1)^2$ instead of $\tfrac{\lambda}{2}(\ln J)^2$. Find its $P$ by hand, put it into the NumPy
# element, and compare with the automatic residual of `forms.energies.neo_hookean_quadratic`.
#
# <details><summary><b>Solution</b> (click to show it)</summary>
#
# $\delta \tfrac{\lambda}{2}(J - 1)^2 = \lambda (J - 1)\, \delta J
# = \lambda (J - 1) J F^{-T} : \nabla v$.
#
# ```python
# def first_piola(F):
#     G, J = np.linalg.inv(F).T, np.linalg.det(F)
#     return mu * (F - G) + lmbda * (J - 1) * J * G
#
# by_hand, _ = element(X, w.x.array.reshape(4, 3))
# quadratic = forms.energies.neo_hookean_quadratic(F_ufl, mu, lmbda) * ufl.dx
# by_machine = fem.assemble_vector(forms.compiled(forms.residual(quadratic, w))).array
# assert abs(by_hand - by_machine).max() < 1e-14
# ```
# </details>

# %% [markdown]
# **Exercise 2.** Solve the bar with the tangent at rest, $K(0)$, in all iterations (the *modified*
# Newton method). By which factor does $|R|$ fall per iteration? Predict it before you measure.
#
# <details><summary><b>Solution</b> (click to show it)</summary>
#
# Near the solution $u_*$ the error is multiplied by $1 - K(u_*) / K(0)$. The bar is so much softer
# there that the factor is 0.62: some seventy iterations instead of five.
#
# ```python
# s, norms = 0.0, [t]
# while norms[-1] > 1e-14:
#     s -= bar(s, t)[0] / bar(0.0, t)[1]
#     norms.append(abs(bar(s, t)[0]))
# predicted = 1 - bar(s, t)[1] / bar(0.0, t)[1]
# print(f"{len(norms) - 1} iterations, factor {norms[31] / norms[30]:.4f}, {predicted:.4f}")
# assert len(norms) > 60 and abs(norms[31] / norms[30] - predicted) < 1e-3
# ```
# </details>

# %%
# Your answer to exercise 2:
