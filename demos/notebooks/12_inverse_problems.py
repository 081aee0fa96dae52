# SPDX-License-Identifier: MIT
# %% [markdown]
# # 12. Inverse problems: what data tell, and what they do not
#
# A model takes moduli and gives displacements. Measurements give displacements, and the moduli are
# wanted. You will differentiate a solution for the price of one linear solve, fit two numbers with
# their deviations, meet numbers that no data of a kind can tell, find a field with an L-curve, and
# turn a body that is known under load back to rest.
#
# Before: residual and tangent (notebook 1), least squares.

# %%
from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
import ufl
from dolfinx import fem

from variform import forms, meshes

plt.rcParams.update({"figure.dpi": 90, "font.size": 9})
comm = MPI.COMM_WORLD
quiet = {"progress": False}

# %% [markdown]
# ## The derivative of a solution
#
# $R(u, m) = 0$ makes $u$ a function of $m$. For a number $J(u, m)$,
#
# $$\frac{dJ}{dm} = J_m - \lambda\cdot R_m,\qquad K^T\lambda = J_u .$$
#
# **Question.** A block has 384 cells, each with a modulus of its own. How many solves does the
# gradient of the pulling force by all of them take, by differences and by this formula?

# %%
body = meshes.block(comm, (1.0, 1.0, 1.0), n=4)
u, t = forms.displacement(body), forms.load_factor(body, 0.2)
mu = fem.Function(fem.functionspace(body.mesh, ("DG", 0)), name="mu")
mu.x.array[:] = 1.0
psi = forms.energies.neo_hookean(forms.deformation_gradient(u), mu, 2.0)
pull = forms.translate(u, body.facets("right"), (t, 0, 0))
block = forms.Problem(psi * ufl.dx, u, [forms.clamp(u, body.facets("left")), pull])
tight = {"rtol": 1e-12, "ctol": 1e-10}
path = forms.solve(block, **tight)
force = forms.Reaction(body.facets("right"))
gradient = forms.gradient(path, force, mu)
print(f"{gradient.x.array.size} derivatives, the largest {gradient.x.array.max():.6f}")

# %% [markdown]
# One, whatever their number; 384 by differences, which are the test. Note that the remainder is to
# fall by four when the step is halved: a gradient that is off by a percent would show here.

# %%
cell, before, rest = 7, force(path), []
for h in (0.02, 0.01, 0.005):
    mu.x.array[cell] = 1 + h
    rest.append(force(forms.solve(block, **tight)) - before - h * gradient.x.array[cell])
    print(f"step {h:.3f}: remainder {rest[-1]:.2e}")
mu.x.array[cell] = 1.0
assert abs(np.log2(rest[1] / rest[2]) - 2) < 0.05

# %% [markdown]
# ## Two moduli from one curve
#
# **Question.** A clamped block is pulled, the force is measured at five lengths to 1 %. How well
# will $\mu$ and $\kappa$ be known, to 1 %, better, or worse?

# %%
u, t = forms.displacement(body), forms.load_factor(body)
m, k = fem.Constant(body.mesh, 1.0), fem.Constant(body.mesh, 4.0)
F = forms.deformation_gradient(u)
psi = forms.energies.isochoric_neo_hookean(F, m) + forms.energies.volumetric(F, k)
pull = forms.translate(u, body.facets("right"), (t, 0, 0))
held = [forms.clamp(u, body.facets("left")), pull]
specimen, loads = forms.Problem(psi * ufl.dx, u, held), [0.1, 0.2, 0.3, 0.4, 0.5]
steps = forms.follow(specimen, t=t, to=loads, record={"y": force}, **quiet).steps
exact = np.array([step.records["y"] for step in steps if step.load in loads])
u.x.array[:] = t.value = 0.0
noise = 0.01 * exact.max() * np.random.default_rng(3).normal(size=5)
curve = forms.Data(specimen, force, exact + noise, sigma=0.01 * exact.max(), t=t, loads=loads)
m.value, k.value = 1.5, 2.0
fit = forms.fit(curve, {"mu": m, "kappa": k}, bounds={"kappa": (0.1, 1e3)}, **quiet)
print(fit)
relative = fit.deviations / fit.values
assert relative[1] > 3 * relative[0]

# %% [markdown]
# Worse by far: many pairs give nearly the same curve. The ellipse of the covariance is long, narrow
# and oblique: one modulus is paid for with the other. Its short axis is what the force knows, and
# the sentence on what is open names the long one. Of the two $\kappa$ is known worse, as the volume
# hardly changes.

# %%
angle = np.linspace(0, 2 * np.pi, 200)
ring = np.linalg.cholesky(fit.covariance) @ np.array([np.cos(angle), np.sin(angle)])
figure, axis = plt.subplots(figsize=(4.2, 3.0))
for size in (1, 2, 3):
    axis.plot(*(fit.values[:, None] + size * ring), "C0", lw=1)
axis.plot(1.0, 4.0, "k*", label="that the data were made with")
axis.set(xlabel="mu", ylabel="kappa")
axis.legend(frameon=False)
plt.show()

# %% [markdown]
# ## What no data of a kind can tell
#
# **Question.** Instead of forces, displacements inside of the block are seen, its ends moved as
# before. What do they tell of $\mu$ and $\kappa$, however exact they are?

# %%
inside = forms.Displacements([(0.5, 1.0, 0.5), (0.3, 0.5, 1.0), (0.7, 0.2, 0.6)])
m.value, k.value = 1.0, 4.0
u.x.array[:], t.value = 0.0, 0.5
forms.solve(specimen)
seen = inside.values(specimen).reshape(1, *inside.shape(specimen))
u.x.array[:] = t.value = 0.0
places = forms.Data(specimen, inside, seen, sigma=1e-6, t=t, loads=[0.5])
fit = forms.fit(places, {"mu": m, "kappa": k}, **quiet)
print(fit.open[0])
assert len(fit.open) == 1 and np.all(np.isinf(fit.deviations))

# %% [markdown]
# Twice the moduli, the same displacements: their ratio, and no more. An eigenvector of the
# Gauss-Newton matrix $J^T J$ with the eigenvalue 0 is that sentence.
#
# ## A field, and an L-curve
#
# **Question.** A square has a stiff spot, its modulus $e^{m(x)}$ is a field of 81 numbers, and 162
# displacements are seen with 2 % noise. Why is the field that fits best not the best field?

# %%
square = meshes.block(comm, (1.0, 1.0), n=8)
v = forms.displacement(square)
log = fem.Function(fem.functionspace(square.mesh, ("Lagrange", 1)), name="m")
true = fem.Function(log.function_space)
true.interpolate(lambda x: 1.2 * np.exp(-25 * ((x[0] - 0.45) ** 2 + (x[1] - 0.6) ** 2)))
psi = forms.energies.neo_hookean(forms.deformation_gradient(v), ufl.exp(log), 2 * ufl.exp(log))
load = forms.dead_traction(v, (0.1, 0.4), square.ds("top"))
spotted = forms.Problem(psi * ufl.dx + load, v, [forms.clamp(v, square.facets("bottom"))])
log.x.array[:] = true.x.array
forms.solve(spotted)
s = np.linspace(0.1, 0.9, 9)
grid = forms.Displacements([(x, y) for x in s for y in s])
seen = grid.values(spotted).reshape(grid.shape(spotted))
sigma = 0.02 * np.abs(seen).max()
noisy = forms.Data(
    spotted, grid, seen + sigma * np.random.default_rng(0).normal(size=seen.shape), sigma=sigma
)
slope = ufl.inner(ufl.grad(log), ufl.grad(log)) * ufl.dx
rows = []
for weight in (1e-4, 1e-2, 1e-1, 1.0, 10.0, 100.0):
    log.x.array[:] = 0.0
    found = forms.fit(noisy, log, regularization=weight * slope, tolerance=1e-5, most=300, **quiet)
    far = forms.integral((log - true) ** 2 * ufl.dx) / forms.integral(true**2 * ufl.dx)
    chi = float(found.residuals @ found.residuals)
    rows.append((weight, chi, forms.integral(slope), np.sqrt(far)))
    print(f"weight {weight:7.4f}: sum of squares {chi:6.1f}, error of the field {rows[-1][3]:.2f}")
weights, squares, slopes, errors = np.array(rows).T

# %%
figure, axes = plt.subplots(1, 2, figsize=(7, 3.0))
axes[0].loglog(squares, slopes, "o-")
for weight, x, y in zip(weights, squares, slopes, strict=True):
    axes[0].annotate(f"{weight:g}", (x, y), textcoords="offset points", xytext=(5, 3))
axes[0].axvline(162, color="k", lw=0.8, ls=":")
axes[0].set(xlabel="sum of squares", ylabel="integral of the squared slope")
axes[1].loglog(weights, errors, "o-")
axes[1].set(xlabel="weight of the regularization", ylabel="relative error of the field")
figure.tight_layout()
plt.show()
best = int(np.argmin(errors))
assert 0 < best < len(errors) - 1 and 0.7 * 162 < squares[best] < 1.3 * 162

# %% [markdown]
# On the left end noise is fitted: the sum of squares is below the number of data, and the field is
# rough. On the right the data are no longer met. The corner of the L, where the sum of squares is
# about the number of data (dotted), is also where the field is nearest, which nobody knows outside
# of a notebook.
#
# ## A shape at rest
#
# **Question.** A beam is known as it hangs. Its shape at rest: take the displacement under its
# weight, with the reverse sign?

# %%
beam = meshes.block(comm, (2.0, 0.3), n=(16, 2), cells="quadrilateral", order=2)
w, t = forms.displacement(beam, degree=2), forms.load_factor(beam)
psi = forms.energies.neo_hookean(forms.deformation_gradient(w), 1.0, 2.0)
weight = forms.body_force(w, (0, -0.006 * t))
wall = [forms.clamp(w, beam.facets("left"))]
hanging = forms.Problem(psi * ufl.dx + weight, w, wall)
forms.follow(hanging, t=t, **quiet)
naive = -forms.at(w, (2.0, 0.15))[1]
w.x.array[:] = t.value = 0.0
end = np.argmin(np.linalg.norm(beam.mesh.geometry.x - (2.0, 0.15, 0), axis=1))
found = forms.unload(hanging, t, **quiet)
rise = beam.mesh.geometry.x[end, 1] - found.given[end, 1]
print(f"the end rises by {rise:.4f} at rest, the reversed displacement says {naive:.4f}")
print(f"loaded again, nodes are off by {found.distance:.0e} of the size")
assert found.distance < 1e-8 and abs(rise / naive - 1) > 0.02

# %% [markdown]
# No: the weight has another lever on the beam that is bent up. The places at rest are the unknown
# of one solve, and the test is to load it again.
#
# ## Exercises
#
# **Exercise 1.** What is the derivative of the stored energy by prescribed displacements? Guess,
# and compare with `forms.gradient` by the support that pulls the first block.
#
# <details><summary><b>Solution</b> (click to show it)</summary>
#
# The force: $d\Pi = R \cdot du_p$. The adjoint is 0, as $\Pi_u = R = 0$ where nothing is held.
#
# ```python
# path = forms.solve(block, **tight)
# g = forms.gradient(path, block.forms.potential, block.supports[1])
# assert abs(g.x.array.reshape(-1, 3)[:, 0].sum() - force(path)) < 1e-9
# ```
# </details>

# %% [markdown]
# **Exercise 2.** Half the noise, or four times as many data: which makes a fit more exact?
#
# <details><summary><b>Solution</b> (click to show it)</summary>
#
# Neither: the covariance is $(J^T J)^{-1}$, and $J$ goes with one over the noise and, row by row,
# with the data.
#
# ```python
# m.value, k.value = 1.0, 4.0
# found = {}
# for name, count, sigma in (("plain", 1, 0.01), ("half", 1, 0.005), ("four", 4, 0.01)):
#     u.x.array[:] = curve.t.value = 0.0
#     data = [forms.Data(specimen, force, exact, sigma=sigma, t=curve.t, loads=loads)
#             for _ in range(count)]
#     found[name] = forms.fit(data, {"mu": m, "kappa": k}, **quiet).deviations
# assert np.allclose(found["half"], found["four"], rtol=1e-4)
# assert np.allclose(found["half"], found["plain"] / 2, rtol=1e-4)
# ```
# </details>

# %%
# Your answer to exercise 2:
