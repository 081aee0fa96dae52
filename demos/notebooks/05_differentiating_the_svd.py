# SPDX-License-Identifier: MIT

# %% [markdown]
# # 5. Differentiating the singular value decomposition
#
# Many energies are written in the singular values of $\mathbf F$. You will derive their tangent
# with SymPy, see where it divides by zero (at rest, where every simulation starts), and how to
# compute it to 15 digits all the same. The formulas are those of [document
# 000](../documents/README.md), *Computing ∂P/∂F*.
#
# You should know the singular value decomposition and the first Piola-Kirchhoff stress
# $\mathbf P = \partial\psi/\partial\mathbf F$.

# %%
import tempfile
from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
import mpmath
import numpy as np
import sympy as sp
import ufl
from IPython.display import Image

from variform import forms, meshes
from variform.forms.formulas import quotients, svd_derivatives

plt.rcParams.update({"figure.dpi": 90, "font.size": 9})
scratch = tempfile.TemporaryDirectory()
rng = np.random.default_rng(5)

# %% [markdown]
# ## How does one differentiate through a decomposition?
#
# $\mathbf F = \mathbf U \boldsymbol\Sigma \mathbf V^T$ with rotations $\mathbf U$, $\mathbf V$
# and $\boldsymbol\Sigma = \mathrm{diag}(s_i)$; the energy is $\hat\psi(s_1, s_2)$ and the stress
# $\mathbf P = \mathbf U\, \mathrm{diag}(t_i)\, \mathbf V^T$ with $t_i =
# \partial\hat\psi/\partial s_i$.
#
# **Question.** $\mathbf P$ depends on $\mathbf F$ through $s$, $\mathbf U$ and $\mathbf V$, of
# which we have no formula. How can one differentiate nevertheless? Think before you read on.
#
# We *do* have the formula of the way back: $\mathbf F(s_1, s_2, u, v)$. In 2D four parameters
# make four entries. So $\partial\mathbf P/\partial\mathbf F = (\partial\mathbf P/\partial
# \mathbf S) (\partial\mathbf F/\partial\mathbf S)^{-1}$, at angles that go to zero, so that
# $\mathbf F = \boldsymbol\Sigma$.

# %%
s1, s2, u, v = S = sp.symbols("s1 s2 u v")
t1, t2 = (sp.Function(name)(s1, s2) for name in ("t1", "t2"))


def rotation(a):
    """Rotation of the plane by an angle."""
    return sp.Matrix([[sp.cos(a), -sp.sin(a)], [sp.sin(a), sp.cos(a)]])


def slopes(principal):
    """Derivative of U diag(principal) V^T, entries 11, 12, 21, 22, at u = v = 0."""
    matrix = rotation(u) * sp.diag(*principal) * rotation(v).T
    return matrix.reshape(4, 1).jacobian(S).applyfunc(lambda x: sp.limit(sp.limit(x, u, 0), v, 0))


dFdS, dPdS = slopes((s1, s2)), slopes((t1, t2))
print("det dF/dS =", sp.factor(dFdS.det()))
K = (dPdS * dFdS.inv()).applyfunc(sp.simplify)
K

# %% [markdown]
# **Question.** The determinant vanishes for $s_1 = s_2$. Is the tangent singular there, or only our
# way to it? Think before you read on.
#
# Rows and columns in the order 11, 22 | 12, 21 give two blocks, $\mathbf A$ with the second
# derivatives $\hat\psi_{,ij}$, and $\mathbf B_{12}$. Partial fractions of $\mathbf B_{12}$
# answer the question.

# %%
order = [0, 3, 1, 2]
blocks = K.extract(order, order)
A, B = blocks[:2, :2], blocks[2:, 2:]
assert blocks[:2, 2:] == sp.zeros(2, 2) and blocks[2:, :2] == sp.zeros(2, 2)
assert A == sp.Matrix(2, 2, lambda i, j: sp.diff((t1, t2)[i], S[j]))
difference, total = (t1 - t2) / (s1 - s2), (t1 + t2) / (s1 + s2)
split = difference / 2 * sp.ones(2, 2) + total / 2 * sp.Matrix([[1, -1], [-1, 1]])
assert (B - split).applyfunc(sp.simplify) == sp.zeros(2, 2)
B

# %% [markdown]
# $$\mathbf B_{ij} = \frac12 \frac{\hat\psi_{,i} - \hat\psi_{,j}}{s_i - s_j}
# \begin{pmatrix} 1 & 1 \\ 1 & 1 \end{pmatrix}
# + \frac12 \frac{\hat\psi_{,i} + \hat\psi_{,j}}{s_i + s_j}
# \begin{pmatrix} 1 & -1 \\ -1 & 1 \end{pmatrix}.$$
#
# The first quotient has a limit at $s_i = s_j$, $\hat\psi_{,ii} - \hat\psi_{,ij}$, because
# $\hat\psi$ does not change when stretches are exchanged. Only the way was singular. And since
# the two matrices have the eigenvectors $(1, 1)$ and $(1, -1)$, the quotients *are* the
# eigenvalues of $\mathbf B$.
#
# In 3D, with three parameters of each rotation (`forms.formulas.derivation.derive(3)`, some
# seconds), the same happens: a $3\times3$ block and three $2\times2$ blocks.

# %%
stretches = np.array([1.4, 0.9, 0.6])
hencky, document = forms.energies.hencky, quotients.hencky(1.0, 2.0)
_, dPdF = hencky.evaluate(np.diag(stretches)[None], mu=1.0, lmbda=2.0)
K3 = svd_derivatives.to_matrix(dPdF[0])
by_hand = svd_derivatives.block_diagonal(*svd_derivatives.tangent_blocks(document, stretches))
assert np.allclose(svd_derivatives.permuted(K3), by_hand, rtol=0, atol=1e-13 * np.abs(K3).max())
names = np.array("11 12 13 21 22 23 31 32 33".split())
figure, axes = plt.subplots(1, 2, figsize=(6, 3), layout="constrained")
for ax, matrix, chosen, title in (
    (axes[0], K3, range(9), "as it is stored"),
    (axes[1], svd_derivatives.permuted(K3), svd_derivatives.ORDER[3], "permuted: A, B12, B13, B23"),
):
    ax.spy(np.abs(matrix) > 1e-12, marker="s", markersize=8)
    ax.set(xticks=range(9), yticks=range(9), title=f"∂P/∂F(Σ), {title}")
    ax.set_xticklabels(names[list(chosen)])
    ax.set_yticklabels(names[list(chosen)])
plt.show()
assert np.count_nonzero(np.abs(K3) > 1e-12) == 9 + 3 * 4

# %% [markdown]
# The program (`evaluate` runs the kernels in C that a solve uses) and the formulas agree.
#
# ## How bad is the quotient?
#
# **Question.** $(\hat\psi_{,i} - \hat\psi_{,j}) / (s_i - s_j)$ in double precision: how many
# digits are left when $s_i - s_j = 10^{-8}$? Is it better to raise the denominator to $10^{-6}$,
# as document 000 does for sums? Think before you read on.
#
# Hencky's energy, $\hat\psi = \mu \sum (\ln s_i)^2 + \frac\lambda2 (\ln J)^2$, against 50 digits:

# %%
mpmath.mp.dps = 50
mu, lmbda = 1.0, 2.0


def quotient(s):
    """The difference quotient of the first two stretches, or its limit, in 50 digits."""
    si, sj, sk = map(mpmath.mpf, s.tolist())
    pressure = lmbda * mpmath.log(si * sj * sk)
    if si == sj:
        return (2 * mu * (1 - mpmath.log(si)) - pressure) / si**2  # psi_ii - psi_ij
    psi_i, psi_j = ((2 * mu * mpmath.log(x) + pressure) / x for x in (si, sj))
    return (psi_i - psi_j) / (si - sj)


gaps = 10.0 ** np.arange(-16, 0.01, 0.25)
s = np.stack([1.2 + gaps, np.full_like(gaps, 1.2), np.full_like(gaps, 0.7)], 1)
psi = document.gradient(s)
above, below = psi[:, 0] - psi[:, 1], s[:, 0] - s[:, 1]
_, dPdF = hencky.evaluate(s[:, :, None] * np.eye(3), mu, lmbda)
with np.errstate(invalid="ignore"):  # 0/0
    found = {"naive": above / below, "clamped at 1e-6": above / np.maximum(below, 1e-6)}
found["variform"] = dPdF[:, 0, 1, 0, 1] + dPdF[:, 0, 1, 1, 0]  # B_11 + B_12

# %%
exact = np.array([quotient(x) for x in s])
with np.errstate(invalid="ignore"):
    errors = {name: np.abs((exact - q) / exact).astype(float) for name, q in found.items()}
figure, ax = plt.subplots(figsize=(6, 3), layout="constrained")
for (name, e), marker in zip(errors.items(), "osv", strict=True):
    ax.loglog(gaps, np.maximum(e, 1e-17), marker, markersize=4, label=name)
ax.loglog(gaps, 1e-16 / gaps, "k:", linewidth=1)
ax.text(3e-10, 4e-6, "$10^{-16}$ / gap")
ax.set(xlabel="gap $s_1 - s_2$ [-]", ylabel="relative error [-]", ylim=(1e-18, 20))
ax.legend(loc="center left", bbox_to_anchor=(1, 0.5), frameon=False)
plt.show()
small = gaps < 1e-7
print("NaN:", np.isnan(errors["naive"]).sum(), "of", len(gaps), "gaps by the naive quotient")
assert np.isnan(errors["naive"][0]) and np.nanmax(errors["naive"]) > 0.01
assert errors["clamped at 1e-6"][small].min() > 0.9
assert 1e-10 < errors["naive"][np.abs(np.log10(gaps) + 8) < 0.6].max() < 1e-7  # half the digits
assert errors["variform"].max() < 2e-14

# %% [markdown]
# The naive quotient loses a digit with each digit of the gap, half of them at $10^{-8}$, and is
# 0/0 where the two stretches are the same number; below $10^{-6}$ the clamp puts 0 in its place,
# and all is lost. What helps is not to divide: the quotient is the *mean* of $\hat\psi_{,ii} -
# \hat\psi_{,ij}$ on the way from $(s_j, s_i)$ to $(s_i, s_j)$, and a few Gauss points take that
# mean to 15 digits.
#
# ## What happens at rest?
#
# **Question.** Equal stretches look like a rare accident. When does a simulation meet them? Think
# before you read on.
#
# At its first step, in every point: $s_1 = s_2 = s_3 = 1$. The fraction $1/(s_i^2 - s_j^2)$ of
# $\mathbf B$ as SymPy found it is 0/0 then (`forms.formulas` refuses it), the clamped one
# finite. In truth the tangent must be Hooke's law, $\lambda\, \delta_{ij}\delta_{kl} +
# \mu(\delta_{ik}\delta_{jl} + \delta_{il}\delta_{jk})$.

# %%
EYE = np.eye(3)
hooke = lmbda * np.einsum("ij,kl->ijkl", EYE, EYE)
hooke += mu * (np.einsum("ik,jl->ijkl", EYE, EYE) + np.einsum("il,jk->ijkl", EYE, EYE))


def clamped_tangent(energy, s, U, V):
    """The tangent by its blocks, differences clamped as document 000 clamps the sums."""
    psi, B = energy.gradient(s), []
    for i, j in quotients.PAIRS[3]:
        bounds = quotients.clamp(s[i] - s[j]), quotients.clamp(s[i] + s[j])
        above = psi[i] - psi[j], psi[i] + psi[j]
        B.append(svd_derivatives.block_split(above[0] / bounds[0], above[1] / bounds[1]))
    return svd_derivatives.tangent(U, V, energy.hessian(s), np.stack(B))


try:
    svd_derivatives.block_single(document, np.ones(3), 0, 1)
except ValueError as refusal:
    print(refusal)
else:
    raise AssertionError("0/0 was not refused")
_, at_rest = hencky.evaluate(EYE[None], mu, lmbda)
clamped = clamped_tangent(document, np.ones(3), EYE, EYE)
off = [np.abs(T - hooke).max() / np.abs(hooke).max() for T in (clamped, at_rest[0])]
print(f"off Hooke's law at rest: clamped {off[0]:.2f}, variform {off[1]:.1e}")
print(f"shear modulus: {hooke[0, 1, 0, 1]} wanted, {clamped[0, 1, 0, 1]} if clamped")
assert off[0] > 0.2 and off[1] < 1e-15 and np.linalg.matrix_rank(clamped.reshape(9, 9)) == 3

# %% [markdown]
# The clamped tangent has no shear stiffness at rest at all: six of its nine eigenvalues are 0,
# where three rotations should be, and the first Newton matrix of a model is useless. And it is
# not even a function of $\mathbf F$: for $\mathbf F = 1.2\, \mathbf I$ the rotation $\mathbf U =
# \mathbf V$ may be any, and the tangent depends on which one the library happens to return.

# %%
Q = svd_derivatives.rodrigues(np.array([0.4, -0.7, 0.5]))
s = np.full(3, 1.2)
one, other = (clamped_tangent(document, s, R, R) for R in (EYE, Q))
blocks = svd_derivatives.tangent_blocks(document, s)
right, same = (svd_derivatives.tangent(R, R, *blocks) for R in (EYE, Q))


def jump(a, b):
    """Largest difference over the largest entry."""
    return np.abs(a - b).max() / np.abs(a).max()


print(f"two decompositions of 1.2 I: clamped {jump(one, other):.2f}, right {jump(right, same):.1e}")
assert jump(one, other) > 0.02 and jump(right, same) < 1e-14

# %% [markdown]
# ## Which sign have the singular values?
#
# A library returns $s_i \ge 0$, and $\mathbf U$, $\mathbf V$ with determinants $\pm1$.
#
# **Question.** An element is turned inside out, $\det\mathbf F < 0$. What energy do unsigned
# stretches give to its perfect mirror image? Think before you read on.
#
# The fixed corotated energy, $\mu \sum (s_i - 1)^2 + \frac\lambda2 (J - 1)^2$, exists for all
# $\mathbf F$. We compare with differences of the energy itself.

# %%
corotated, by_formula = forms.energies.fixed_corotated, quotients.fixed_corotated(mu, lmbda)
F = Q @ np.diag([1.3, 0.9, -0.5]) @ Q
U, s, Vt = np.linalg.svd(F)
unsigned = U @ np.diag(by_formula.gradient(s)) @ Vt
h, P = 1e-5, np.zeros((3, 3))
for i, j in np.ndindex(3, 3):
    ends = np.stack([F + h * np.outer(EYE[i], EYE[j]), F - h * np.outer(EYE[i], EYE[j])])
    P[i, j] = -np.diff(corotated.energy(ends, mu, lmbda))[0] / (2 * h)
signed = svd_derivatives.first_piola(by_formula, F)
print(f"stress: unsigned off by {jump(P, unsigned):.2f}, signed by {jump(P, signed):.0e}")
mirror = np.diag([1.0, 1.0, -1.0])
print("mirror image:", by_formula.value(np.abs(np.diag(mirror))), "if unsigned,", end=" ")
print(corotated.energy(mirror[None], mu, lmbda)[0], "if signed")
assert abs(jump(P, unsigned) - 1.23) < 0.01 and jump(P, signed) < 1e-9
assert np.allclose(svd_derivatives.signed_svd(F)[1], [1.3, 0.9, -0.5])

# %% [markdown]
# Unsigned, the stress is off by 123 %: it belongs to another energy, in which the mirror image
# is at rest, and an inverted element would never find back. The convention of document 000 makes
# $\mathbf U$ and $\mathbf V$ rotations, and the smallest stretch carries the sign.
#
# ## Where is the tangent indefinite?
#
# The eigenvalues of $\partial\mathbf P/\partial\mathbf F$ are those of $\mathbf A$ and the six
# quotients. For $\hat\psi = \mu\sum(s_i - 1)^2$ (ARAP) they are $2\mu$, six times, and $2\mu -
# 4\mu/(s_i + s_j)$.
#
# **Question.** How much may one squeeze this material before Newton's matrix can turn indefinite?
# Think before you read on.

# %%
arap = forms.energies.as_rigid_as_possible
squeeze = np.linspace(0.4, 1.6, 49)
F = squeeze[:, None, None] * EYE
lowest = {}
for name, project in (("full", False), ("projected", True)):
    _, dPdF = arap.evaluate(F, mu, project=project)
    lowest[name] = np.linalg.eigvalsh(svd_derivatives.to_matrix(dPdF))[:, 0]
figure, ax = plt.subplots(figsize=(5, 2.6), layout="constrained")
ax.axhline(0, color="gray", linewidth=0.8)
for (name, values), style in zip(lowest.items(), ("-", "--"), strict=True):
    ax.plot(squeeze, values / mu, style, label=name)
ax.set(xlabel="uniform stretch $s$ [-]", ylabel="lowest eigenvalue / $\\mu$ [-]")
ax.legend(frameon=False)
plt.show()
assert np.allclose(lowest["full"], mu * (2 - 2 / squeeze), atol=1e-13)
assert np.allclose(lowest["projected"], np.maximum(lowest["full"], 0), atol=1e-13)

# %% [markdown]
# Not at all: it is indefinite as soon as some $s_i + s_j < 2$. The eigenvector $(1, -1)$ of
# $\mathbf B$ is a rotation: compressed material gains by turning away, as a column does that
# buckles. That is physics, no fault of the energy. The projection puts 0 in place of negative
# eigenvalues, so that every Newton step goes downhill; near the solution the package takes the
# full tangent again.
#
# ## Does it work in a finite element?
#
# **Question.** For the user none of this should be visible. What must be written to solve with an
# energy of one's own? Think before you read on.
#
# $\hat\psi$ alone. A cube of Hencky's material is pulled from rest, where naive quotients are 0/0.
# The exact nominal stress is $E \ln\ell / \ell$, as Hencky's law is Hooke's with logarithms.

# %%
own = forms.energies.principal(
    lambda s1, s2, s3, mu, lmbda: (
        mu * (ufl.ln(s1) ** 2 + ufl.ln(s2) ** 2 + ufl.ln(s3) ** 2)
        + lmbda / 2 * ufl.ln(s1 * s2 * s3) ** 2
    )
)
cube = meshes.block(MPI.COMM_WORLD, (1.0, 1.0, 1.0), n=2, cells="hexahedron")
t = forms.load_factor(cube)
displacement = forms.displacement(cube)
psi = own(forms.deformation_gradient(displacement), mu=mu, lmbda=lmbda)
walls = ("left", "front", "bottom")
supports = [forms.roller(displacement, cube.facets(w), i) for i, w in enumerate(walls)]
supports.append(forms.translate(displacement, cube.facets("right"), (t, None, None)))
pull = {"force": lambda system: forms.resultant(system, cube.facets("right"))[0][0]}
path = forms.follow(psi * ufl.dx, displacement, supports, t, record=pull, progress=False)
length = 1 + np.array([step.load for step in path.steps])
E = mu * (3 * lmbda + 2 * mu) / (lmbda + mu)
print(path.reason)
print(f"force at stretch 2: {path.record('force')[-1]:.9f} N, exact {E * np.log(2) / 2:.9f} N")
assert np.allclose(path.record("force"), E * np.log(length) / length, rtol=1e-8)

# %% [markdown]
# Where the tangent is right, Newton's method gains more digits with each iteration.
# A bar of the same material, one end turned by 60 degrees in one step, from rest:

# %%
bar = meshes.block(MPI.COMM_WORLD, (3.0, 1.0, 1.0), n=(9, 3, 3), cells="hexahedron")
displacement = forms.displacement(bar)
psi = own(forms.deformation_gradient(displacement), mu=mu, lmbda=lmbda)
held = forms.clamp(displacement, bar.facets("left"))
turned = forms.rotate(displacement, bar.facets("right"), angle=np.pi / 3, axis=(1, 0, 0))
path = forms.solve(psi * ufl.dx, displacement, [held, turned], rtol=1e-12)
residuals = np.array(path.steps[-1].convergence.residuals)
print("out-of-balance force [N]:", *(f"{r:.0e}" for r in residuals))
assert residuals[-1] < 1e-13 and np.log(residuals[-2]) < 1.4 * np.log(residuals[-3])
picture = Path(scratch.name) / "bar.png"
forms.picture(path, picture, label="|u| [m]", size=(640, 360))
Image(filename=picture)

# %% [markdown]
# ## Exercises

# %% [markdown]
# **Exercise 1.** Show with SymPy that for the fixed corotated energy in 2D the difference
# quotient needs no division at all, and find the part of the sum quotient that is unbounded as
# $s_1 + s_2 \to 0$.
#
# <details><summary><b>Solution</b> (click to show it)</summary>
#
# $2\mu - \lambda (J - 1)$, and $2\mu + \lambda(J - 1) - 4\mu/(s_1 + s_2)$: the last term.
#
# ```python
# m, k = sp.symbols("mu lambda")
# p = m * ((s1 - 1) ** 2 + (s2 - 1) ** 2) + k / 2 * (s1 * s2 - 1) ** 2
# p1, p2 = sp.diff(p, s1), sp.diff(p, s2)
# J = s1 * s2
# assert sp.simplify((p1 - p2) / (s1 - s2) - (2 * m - k * (J - 1))) == 0
# rest = sp.simplify((p1 + p2) / (s1 + s2) - (2 * m + k * (J - 1)))
# assert sp.simplify(rest + 4 * m / (s1 + s2)) == 0
# ```
# </details>

# %%
# Your answer to exercise 1:

# %% [markdown]
# **Exercise 2.** Saint Venant-Kirchhoff's energy is smooth in $\mathbf F$: $\hat\psi_{,i} +
# \hat\psi_{,j} \to 0$ as $s_i + s_j \to 0$, and the sum quotient has the limit $\hat\psi_{,ii} +
# \hat\psi_{,ij}$. By how much is a clamp wrong there, and what does the package return?
#
# <details><summary><b>Solution</b> (click to show it)</summary>
#
# The clamp makes the quotient 0 instead of -2.37: wrong by 100 %. The package finds out by
# itself that the energy is smooth, and needs no clamp.
#
# ```python
# stvk = quotients.saint_venant_kirchhoff(1.0, 4.0)
# flat = np.array([1.2, 0.5, -0.5])
# limit = stvk.hessian(flat)[1, 1] + stvk.hessian(flat)[1, 2]
# _, dPdF = forms.energies.saint_venant_kirchhoff_stretches.evaluate(np.diag(flat)[None], 1.0, 4.0)
# found = dPdF[0, 1, 2, 1, 2] - dPdF[0, 1, 2, 2, 1]
# print(limit, found, quotients.sum_quotient(stvk, flat, 1, 2))
# assert abs(found - limit) < 1e-13 and abs(quotients.sum_quotient(stvk, flat, 1, 2)) < 1e-9
# ```
# </details>

# %%
# Your answer to exercise 2:

# %% [markdown]
# **Exercise 3.** Where is Hencky's tangent indefinite in uniaxial tension? Plot or search the
# eigenvalues of `hencky.evaluate` for $\mathbf F = \mathrm{diag}(\ell, \ell^{-\nu}, \ell^{-\nu})$.
#
# <details><summary><b>Solution</b> (click to show it)</summary>
#
# From $\ell = e$ on, where the nominal stress $E \ln\ell/\ell$ has its maximum.
#
# ```python
# nu, l = lmbda / (2 * (lmbda + mu)), np.linspace(1.01, 3, 200)
# states = np.stack([l, l**-nu, l**-nu], 1)[:, :, None] * EYE
# _, dPdF = hencky.evaluate(states, mu, lmbda)
# lows = np.linalg.eigvalsh(svd_derivatives.to_matrix(dPdF))[:, 0]
# first = l[np.argmax(lows < -1e-6)]  # one eigenvalue is 0 throughout: a turn about the axis
# print(f"indefinite from a stretch of {first:.2f} on")
# assert abs(first - np.e) < 0.02
# ```
# </details>

# %%
# Your answer to exercise 3:
