# SPDX-License-Identifier: MIT
# %% [markdown]
# # 7. Membranes, their eigensystems, and balloons past the limit point
#
# You will see how a sheet in space deforms in six ways and no more, how stiff it is against each,
# and why it wrinkles when it is pressed. Then you blow up a balloon past the largest pressure that
# it can bear, where a solver that prescribes the pressure must stop.
#
# Before: singular value decomposition, eigenvalues, and notebook 1 (potential, residual, tangent).
# Document 001 is J. Panetta, *Analytic Eigensystems for Isotropic Membrane Energies* (2019).

# %%
from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
import ufl

from variform import forms, meshes
from variform.forms.formulas import membrane_eigensystems as sheets
from variform.forms.formulas import membrane_invariants as membranes

plt.rcParams.update({"figure.dpi": 90, "font.size": 9})
comm = MPI.COMM_WORLD

# %% [markdown]
# ## A gradient of three rows and two columns
#
# A sheet has two coordinates at rest and three when it is deformed, so $F$ is $3\times 2$. Its
# columns $f_1, f_2$ are tangents of the deformed surface. The decomposition
# $F = U\,[\mathrm{diag}(\sigma_1, \sigma_2);\,0]\,V^T$ has the normal as the third column of $U$,
# and the document builds on
#
# $$I_1 = \sigma_1 + \sigma_2, \quad I_2 = \sigma_1^2 + \sigma_2^2, \qquad I_3 = \sigma_1\sigma_2.$$
#
# **Question.** For which of the three do you need no singular value decomposition, only products of
# $F$'s columns? Think before you read on.

# %%
rng = np.random.default_rng(7)
F = np.array([[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]]) + 0.4 * rng.standard_normal((3, 2))
U, s, V = membranes.svd(F)
f1, f2 = F.T
normal = np.cross(f1, f2)
I2, I3 = np.sum(F * F), np.linalg.norm(normal)
print("stretches", s.round(4), " I1, I2, I3 =", membranes.invariants(s).round(4))
assert np.allclose(membranes.invariants(s), [np.sqrt(I2 + 2 * I3), I2, I3], rtol=1e-14)
assert np.isclose(abs(U[:, 2] @ normal), I3)  # the third column of U is the normal, up to its sign

# %% [markdown]
# For none. $I_2 = F : F$, $I_3 = |f_1\times f_2|$ is the ratio of areas, and
# $I_1 = \sqrt{I_2 + 2 I_3}$. That is how `forms.membranes.membrane_invariants` writes them in UFL.

# %% [markdown]
# ## Six ways to deform
#
# **Question.** The Hessian of $I_3$ is a $6\times 6$ matrix. Its eigenvalues will depend on the
# state. Must its eigenvectors depend on $\sigma_1$ and $\sigma_2$, too?
#
# Look along $U$ and $V$: put $\dot F = U M V^T$ with $M$ of the entries $a, b; c, d; e, f$ (the
# document's section 1.1). To second order $\sigma_1\sigma_2 = |f_1\times f_2|$ changes by $ad - bc$
# from the plane part, a quadratic form whose matrix holds only the numbers 1 and -1, and by
# $\tfrac12(\tfrac{\sigma_2}{\sigma_1}e^2 + \tfrac{\sigma_1}{\sigma_2}f^2)$ from the slope of the
# sheet. So the eigenmatrices are fixed once $U$ and $V$ are: two stretches, a twist, a flip, two
# turns of the normal, about $u_2$ and about $u_1$. $I_1$ has the same ones. Only the eigenvalues
# know $\sigma$:

# %%
names = ["stretch", "opposite stretches", "twist", "flip", "normal about u2", "normal about u1"]
Q, values = membranes.basis(U, V), membranes.eigenvalues(s)
for name, one, three in zip(names, values[0], values[2], strict=True):
    print(f"{name:20s} H1: {one:7.4f}   H3: {three:7.4f}")


def curvature(k, direction, h=1e-4):
    """Second derivative of I_k along a direction, by differences that know nothing of U, s, V."""
    ahead, here, behind = membranes.invariants_of_gradient(
        np.stack([F + h * direction, F, F - h * direction])
    )[:, k]
    return (ahead - 2 * here + behind) / h**2


for k in (0, 2):
    for i, q in enumerate(Q):
        assert abs(curvature(k, q) - values[k, i]) < 1e-6  # rounding / h^2 = 1e-8, and h^2
        for j in range(i):  # no mixed terms: the matrices are eigenmatrices
            assert abs(curvature(k, q + Q[j]) - values[k, i] - values[k, j]) < 1e-6

# %% [markdown]
# Differences of the invariants confirm the closed form. $H_1$ has rank 3: neither the stretches nor
# the flip change $I_1$ to second order.
#
# **Question.** What do the six matrices look like? Take a square at rest (dashed), displace it by a
# part of each matrix, and look from above and from the side.

# %%
eye = np.linalg.svd(np.eye(3, 2))  # U = V = I: the square's own axes
flat = membranes.basis(eye[0], np.eye(2))
square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]]) / 2
views = {
    "from above": np.eye(2, 3),
    "from the side": np.array([[0.94, 0.34, 0], [-0.16, 0.45, 0.88]]),
}
figure, axes = plt.subplots(2, 6, figsize=(7, 2.5), sharex=True, sharey=True)
for row, (view, look) in zip(axes, views.items(), strict=True):
    row[0].set_ylabel(view)
    for axis, q in zip(row, flat, strict=True):
        rest, bent = square @ np.eye(2, 3), square @ (np.eye(3, 2) + 0.4 * q).T
        axis.plot(*(look @ rest.T), "k--", lw=0.8)
        axis.fill(*(look @ bent.T), color="C0", alpha=0.35, lw=0)
        axis.plot(*(look @ bent.T), "C0", lw=1.4)
        axis.set(aspect="equal", xticks=[], yticks=[])
        axis.spines[:].set_visible(False)
for axis, name in zip(axes[0], names, strict=True):
    axis.set_title(name.replace(" ", "\n", 1), fontsize=9)
figure.tight_layout()
plt.show()

# %% [markdown]
# From above the last two leave the square alone: they turn its normal, and only the side view shows
# them. The twist is a small rotation in the plane.
#
# ## The sheet's energy, and two eigenvalues exchanged in print
#
# An incompressible sheet is thinner by $1/I_3$, so the neo-Hookean energy is
# $\psi_\text{sheet} = \tfrac{\mu}{2}(I_2 + I_3^{-2} - 3)$. Four of its eigenpairs are twist, flip
# and the two normals. The last two mix the stretches, because $\partial I_3/\partial F$ does:
#
# $$\begin{bmatrix}\beta - \gamma\\ 4 I_3\end{bmatrix},\quad
# \begin{bmatrix}\beta + \gamma\\ 4 I_3\end{bmatrix},\qquad
# \lambda = \mu + \mu\,\frac{3 I_2 \pm \gamma}{2 I_3^4},\qquad
# \beta = 3(\sigma_2^2 - \sigma_1^2),\quad \gamma = \sqrt{16 I_3^2 + \beta^2}.$$
#
# **Question.** In its last display the document gives the first vector the eigenvalue with
# $+\gamma$, the second the one with $-\gamma$. You suspect that they are exchanged. Which check
# finds it: the trace, the determinant, a comparison with a library's eigenvalues?

# %%
mu = 1.0
H = membranes.to_matrix(sheets.sheet_hessian_short(U, s, V, mu))


def residuals(pairs):
    """|H q - lambda q| of each pair, the matrices having unit length."""
    return [np.linalg.norm(H @ q.ravel() - v * q.ravel()) for v, q in zip(*pairs, strict=True)]


found = sheets.last_eigenpairs(U, s, V, mu)
printed = sheets.last_eigenpairs(U, s, V, mu, as_printed=True)
library = np.linalg.eigvalsh(H)
print("eigenvalues:", found[0].round(4), " printed:", printed[0].round(4))
print(f"|H q - lambda q|: below 1e-12, printed: {max(residuals(printed)):.2f}")
assert max(residuals(found)) < 1e-12 and min(residuals(printed)) > 0.1
assert np.allclose(np.sort(sheets.eigensystem(U, s, V, mu)[0]), library)
beside = sheets.reduced_eigenpairs(s, mu, as_printed=True)[0]  # those beside v1 and v2
assert not np.isclose(beside.sum(), found[0].sum())
assert np.isclose(printed[0].sum(), found[0].sum())
assert np.isclose(printed[0].prod(), found[0].prod())

# %% [markdown]
# None of the three. Trace, determinant and sorted eigenvalues are those of the right pairs; only
# the product $Hq$ tells. A projected tangent made of the printed pairs would be stiff where the
# sheet is soft. (Beside $v_1, v_2$ the document has $+\gamma$ twice, which the trace does find.)
#
# ## Pressed sheets
#
# **Question.** The eigenvalue of a turn of the normal is
# $\lambda = \mu\,(1 - \sigma_2/(\sigma_1 I_3^3))$. When is it negative? Compare with the stress
# $P_1 = \partial\hat\psi/\partial\sigma_1 = \mu\,(\sigma_1 - \sigma_1^{-3}\sigma_2^{-2})$.

# %%
grid = np.linspace(0.55, 1.6, 211)
S = np.stack(np.meshgrid(grid, grid, indexing="ij"), -1)
axes3, axes2 = (np.broadcast_to(np.eye(d), (*S.shape[:2], d, d)) for d in (3, 2))  # U = V = I
four = sheets.four_eigenpairs(axes3, S, axes2, mu)[0]
stress = mu * (S - 1 / (S * np.prod(S, -1, keepdims=True) ** 2))
assert np.allclose(four[..., 2:], stress / S)  # lambda = P_i / sigma_i
soft = np.sum(four[..., 2:] < 0, -1)
twist_alone = (four[..., 0] < 0) & (soft == 0)
assert not twist_alone.any()  # the twist turns negative only where a normal has done so before

figure, axis = plt.subplots(figsize=(4.4, 3.2))
colors = ["#cfe3f5", "#f6d9a8", "#eeaaa0"]
axis.contourf(*np.moveaxis(S, -1, 0), soft, levels=[-0.5, 0.5, 1.5, 2.5], colors=colors)
axis.plot(grid[grid >= 1], grid[grid >= 1] ** -0.5, "k", lw=1)
axis.plot(grid[grid >= 1] ** -0.5, grid[grid >= 1], "k", lw=1)
axis.contour(*np.moveaxis(S, -1, 0), four[..., 0], levels=[0], colors="C3", linestyles="--")
axis.plot(1.3, 0.8, "ko", ms=4)
words = ("pulled\nboth ways", 1.32, 1.3), ("pressed\nalong 2", 1.36, 0.68), ("both ways", 0.62, 0.7)
for word, x, y in (*words, ("pressed\nalong 1", 0.6, 1.36)):
    axis.text(x, y, word, fontsize=8)
axis.set(xlabel=r"$\sigma_1$ [-]", ylabel=r"$\sigma_2$ [-]", aspect="equal")
axis.set_title("negative eigenvalues of the normals: 0, 1, 2", fontsize=9)
figure.tight_layout()
plt.show()

# %% [markdown]
# $\lambda = P_1/\sigma_1$: a sheet gives way sideways exactly where its own stress is compression.
# The black lines are the natural widths $\sigma_2 = \sigma_1^{-1/2}$ of a strip that is pulled:
# narrower than that it is pressed across, the energy is indefinite, and the sheet wrinkles. The
# twist (dashed where it is zero, $I_3 = 1$) never is the first to turn negative.
#
# **Question.** A sheet without bending stiffness is held flat at $\sigma = (1.3, 0.8)$, the dot, by
# its rim. How many unstable modes has it on a mesh, and on one twice as fine?

# %%
energies = forms.energies


def unstable(energy, n):
    """Negative eigenvalues of the flat state, and how far its nodes are out of the plane."""
    body = meshes.square(comm, 1.0, 1 / n)
    u, X = forms.displacement(body), ufl.SpatialCoordinate(body.mesh)
    rim = forms.prescribe(u, body.facets(*body.boundaries), [0.3 * X[0], -0.2 * X[1], 0.0])
    u.interpolate(lambda x: np.stack([0.3 * x[0], -0.2 * x[1], 0 * x[0]]))
    psi = energy(forms.membrane_gradient(u), mu=1.0)
    path = forms.solve(psi * ufl.dx, u, [rim], projection="never")
    flat = np.abs(u.x.array.reshape(-1, 3)[:, 2]).max()
    return forms.negative_eigenvalues(path), flat


counts = {n: unstable(energies.neo_hookean_sheet, n) for n in (6, 12, 24)}
relaxed = {n: unstable(energies.neo_hookean_tension_field, n) for n in (6, 12, 24)}
for n in counts:
    print(f"1/h = {n:2d}: {counts[n][0]:3d} unstable modes, tension field: {relaxed[n][0]}")
assert all(flat == 0 for _, flat in [*counts.values(), *relaxed.values()])
assert 2 < counts[12][0] / counts[6][0] < 8 and 3 < counts[24][0] / counts[12][0] < 5
assert all(count == 0 for count, _ in relaxed.values())

# %% [markdown]
# Four times the nodes, about four times the modes: without bending nothing sets a length of the
# wrinkles, and each mesh makes its own. The tension field (Pipkin 1986) replaces the energy by the
# least one that wrinkles can reach, $\hat\psi(\sigma_1, \sigma_1^{-1/2})$ where $\sigma_2$ is below
# the natural width. It has no compression, hence no unstable mode, and the mesh no say.

# %% [markdown]
# ## A balloon
#
# A sphere of radius 1, thickness 1 and modulus $\mu$ is blown up: all stretches are $l$. The energy
# is $4\pi\,\tfrac{\mu}{2}(2 l^2 + l^{-4} - 3)$, the volume $\tfrac{4\pi}{3} l^3$, and
#
# $$p = \frac{dE}{dV} = \frac{dE/dl}{dV/dl} = 2\mu\left(\frac1l - \frac1{l^7}\right).$$
#
# **Question.** Is there a largest pressure? What will a solver do that is told to go beyond it?


# %%
def pressure(stretch):
    """Pressure of the sphere over mu thickness / radius."""
    return 2 * (1 / stretch - stretch**-7.0)


limit = 7 ** (1 / 6)
ball = meshes.spherical_sheet(comm, 1.0, 0.5, 2, "octant")
u, p = forms.displacement(ball, degree=2), forms.load_factor(ball)
inside = forms.enclosed_volume(u)
psi = energies.neo_hookean_sheet(forms.membrane_gradient(u), mu=1.0)
held = [forms.roller(u, ball.facets(f"{axis}0"), i) for i, axis in enumerate("xyz")]
potential = psi * ufl.dx - p * inside
start = forms.integral(inside)
size = {"l": lambda system: (forms.integral(inside) / start) ** (1 / 3)}
try:
    forms.follow(potential, u, held, p, to=1.5, min_step=0.01, record=size, progress=False)
except forms.NotConverged as error:
    pushed = error.path
print(f"largest pressure {pressure(limit):.5f} at l = {limit:.4f}")
print(f"load control stopped at p = {pushed.load:.4f}, l = {pushed.record('l')[-1]:.4f}")
assert pressure(limit) > max(pressure(limit - 1e-3), pressure(limit + 1e-3))
assert not pushed.completed and pushed.load < 1.001 * pressure(limit)
assert pushed.record("l")[-1] < limit

# %% [markdown]
# There is: $dp/dl = 0$ at $l = 7^{1/6}$. Beyond $p = 1.2395$ there is no equilibrium, so there is
# nothing to converge to, and no smaller step helps.
#
# **Question.** What grows all the way? Prescribe that.

# %%
u.x.array[:], p.value = 0, 0
lengths = np.linspace(1.03, 2.6, 25)
path = forms.control(potential, u, held, p, inside, start * lengths**3, record=size, progress=False)
print(path.reason)
found = np.array([step.load for step in path.steps])
negative = np.array([step.convergence.negative for step in path.steps])
error = np.abs(found / pressure(lengths) - 1).max()
cells = ball.mesh.topology.index_map(2).size_local
print(f"{cells} curved triangles, largest error of p: {error:.1e}")
assert path.completed and error < 5e-4
assert np.array_equal(negative, (lengths > limit).astype(int))

# %%
figure, axis = plt.subplots(figsize=(5.6, 3.0))
fine = np.linspace(1, 2.6, 300)
axis.plot(fine, pressure(fine), "k", lw=1, label="$2(1/l - 1/l^7)$")
axis.plot(lengths, found, "C0.", label="volume prescribed")
axis.plot(pushed.record("l"), [s.load for s in pushed.steps], "C3x", label="pressure prescribed")
axis.axvline(limit, color="0.6", lw=0.8, ls=":")
axis.text(limit + 0.02, 0.05, "$7^{1/6}$")
axis.set(xlabel="stretch l [-]", ylabel=r"pressure $p\,r/(\mu\,t)$ [-]", ylim=(0, 1.4))
axis.legend(loc="lower right")
figure.tight_layout()
plt.show()

# %% [markdown]
# The volume takes the solver through. Past the limit point the tangent at fixed pressure has one
# negative eigenvalue, exactly there: such a balloon is stable on a pump that doses air, and runs
# away on one that holds the pressure.
#
# ## Exercises
#
# **Exercise 1.** At rest, which of the six eigenvalues of $\psi_\text{sheet}$ are zero, and why
# must they be?
#
# <details><summary><b>Solution</b> (click to show it)</summary>
#
# The twist at rest is a small rotation in the plane, the two normals are rotations out of it: no
# energy. The flip is a shear (2 mu), the stretches have 6 mu (both) and 2 mu (opposite).
#
# ```python
# rest = sheets.eigensystem(np.eye(3), np.ones(2), np.eye(2), 1.0)[0]
# assert np.allclose(rest, [0, 2, 0, 0, 2, 6])
# ```
# </details>

# %% [markdown]
# **Exercise 2.** The document prints the rank-one term of $\psi_\text{sheet}$'s Hessian as
# $6 I_3^{-4}\,\partial I_2/\partial F\otimes\partial I_2/\partial F$ in one line and with other
# factors in the next. Derive the term by the chain rule and say which line is right.
#
# <details><summary><b>Solution</b> (click to show it)</summary>
#
# $I_3^{-2}$ has the second derivative $6 I_3^{-4}$ in $I_3$, so it is
# $\partial I_3/\partial F\otimes\partial I_3/\partial F$, as in the second line.
#
# ```python
# lines = [sheets.sheet_hessian(U, s, V, mu, as_printed=x) for x in (False, True)]
# right, printed = (membranes.to_matrix(line) for line in lines)
# assert np.allclose(right, H) and np.abs(printed - H).max() > 0.1 * np.abs(H).max()
# ```
# </details>

# %%
# Your answer to exercise 2:

# %% [markdown]
# **Exercise 3.** A Mooney-Rivlin balloon has $p = 2(1/l - 1/l^7)(1 + k l^2)$ (with $k =
# c_{01}/c_{10}$ and $2 c_{10} = \mu$). From which $k$ on does the pressure have no peak any more?
#
# <details><summary><b>Solution</b> (click to show it)</summary>
#
# The slope must nowhere be negative: $k$ is at least the largest value of $-a'/(a l^2)'$, where
# $a = 1/l - 1/l^7$. That is 0.2145: rubber with more of it swells without a jump.
#
# ```python
# x = np.linspace(1.0, 10, 100001)
# slope, other = -(x**-2) + 7 * x**-8, 1 + 5 * x**-6
# k = np.max(-slope / other)
# assert abs(k - 0.2145) < 1e-4
# ```
# </details>

# %%
# Your answer to exercise 3:

# %% [markdown]
# **Exercise 4.** Let a gas do the work: prescribe $p V$ (constant temperature) instead of $V$. Does
# it pass the limit point?
#
# <details><summary><b>Solution</b> (click to show it)</summary>
#
# Yes: $p V \sim l^2 - l^{-4}$ grows for all $l$. The functional contains the unknown pressure.
#
# ```python
# u.x.array[:], p.value = 0, 0.1
# amount = pressure(np.linspace(1.1, 2.2, 12)) * start * np.linspace(1.1, 2.2, 12) ** 3
# gas = forms.control(potential, u, held, p, p * inside, amount, record=size, progress=False)
# assert np.allclose(gas.record("l"), np.linspace(1.1, 2.2, 12), rtol=1e-3)
# ```
# </details>

# %%
# Your answer to exercise 4:
