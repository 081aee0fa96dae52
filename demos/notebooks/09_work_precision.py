# SPDX-License-Identifier: MIT
# %% [markdown]
# # 9. Speed and accuracy: reading the work-precision chart
#
# "How fast is it?" has no answer before "how exact?". You will measure both for linear, quadratic
# and cubic elements, see which of the knobs (degree, mesh, quadrature, tolerance, linear solver)
# buys digits and which only time, and read the chart that this package keeps.
#
# Before: orders of convergence, and notebook 1. Times are those of the machine that ran the
# notebook; no number in the text is one of them.

# %%
import io
import time
from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
import ufl
from IPython.display import Image
from PIL import Image as Pixels

from variform import forms, meshes

plt.rcParams.update({"figure.dpi": 90, "font.size": 9})
comm = MPI.COMM_WORLD

# %% [markdown]
# ## A solution that is known
#
# **Question.** An error needs an exact solution, and nonlinear elasticity has few. How can you have
# one for any mesh and any energy?
#
# Choose the displacement $u^*$ first, and load the body with the force that it needs,
# $b = -\operatorname{Div} P(F(u^*))$. UFL differentiates twice for you (a manufactured solution).


# %%
def manufactured(k, n, **quadrature):
    """Unknown, potential, supports, and the relative error of the gradient as a function."""
    body = meshes.block(comm, (1.0, 1.0), n=n)
    x, u = ufl.SpatialCoordinate(body.mesh), forms.displacement(body, k)
    exact = ufl.as_vector([ufl.sin(np.pi * x[0]) * ufl.cos(2 * x[1]), x[0] * ufl.sin(np.pi * x[1])])
    exact *= 0.1
    known = forms.deformation_gradient(exact)
    P = forms.stress.first_piola(forms.energies.neo_hookean(known, 1.0, 2.0), known)
    b = -ufl.div(ufl.as_matrix([[P[i, j] for j in range(2)] for i in range(2)]))
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0)
    load = forms.body_force(u, b, ufl.dx(degree=2 * k + 1))
    held = [forms.prescribe(u, body.facets(*body.boundaries), list(exact))]

    def error():
        dx, parts = ufl.dx(degree=2 * k + 2), (ufl.grad(u - exact), ufl.grad(exact))
        return np.sqrt(np.divide(*(forms.integral(ufl.inner(g, g) * dx) for g in parts)))

    return u, psi * ufl.dx(**quadrature) + load, held, error


def timed(u, potential, held):
    """CPU seconds of matrices, Newton's method and linear solves, without compiling; best of 3."""
    system, seconds = forms.Problem(potential, u, held), []
    for _ in range(3):
        u.x.array[:] = 0
        start, newton = time.process_time(), forms.solving.Newton(system)
        newton.predict()
        assert newton.solve().converged
        newton.destroy()
        seconds.append(time.process_time() - start)
    return min(seconds)


# %% [markdown]
# ## Error over the mesh, error over time
#
# **Question.** The mesh is refined by two. By what are the error of the gradient (of stress) and
# the time multiplied, for elements of degree $k = 1, 2, 3$?

# %%
sizes = {1: (8, 16, 32, 64, 128), 2: (4, 8, 16, 32, 64), 3: (2, 4, 8, 16, 32)}
rows = {}
for degree, numbers in sizes.items():
    print(f"\nP{degree}:    n    unknowns    error      rate   CPU s")
    for n in numbers:
        u, potential, held, error = manufactured(degree, n)
        seconds = timed(u, potential, held)
        rows.setdefault(degree, []).append((u.x.array.size, error(), seconds))
        found = np.array(rows[degree])
        rate = np.log2(found[-2, 1] / found[-1, 1]) if len(found) > 1 else np.nan
        print(f"{n:9d} {u.x.array.size:10d}   {found[-1, 1]:.2e} {rate:8.2f}   {seconds:.4f}")
    assert abs(rate - degree) < 0.05
rows = {degree: np.array(found) for degree, found in rows.items()}

# %%
figure, axes = plt.subplots(1, 2, figsize=(7, 3.0), sharey=True)
for degree, found in rows.items():
    axes[0].loglog(found[:, 0], found[:, 1], "o-", ms=4, label=f"P{degree}")
    axes[1].loglog(found[:, 2], found[:, 1], "o-", ms=4)
axes[0].set(xlabel="unknowns [-]", ylabel="relative error of the gradient [-]")
axes[1].set(xlabel="CPU time [s]")
for axis in axes:
    axis.axhline(1e-2, color="k", lw=0.8, ls=":")
    axis.grid(alpha=0.3)
axes[0].legend()
figure.tight_layout()
plt.show()

# %% [markdown]
# The error falls like $h^k$, the unknowns grow like $h^{-2}$ in the plane, and the time at least as
# fast. So the slope over the unknowns is $-k/2$ (in 3D $-k/3$), and over the time not steeper once
# the meshes are fine. On coarse meshes the right curves drop steeply: there the time is that of
# Python and of set-up, and a finer mesh is free. Read such a chart **across**: choose the error, go
# to the leftmost curve. How far apart are the curves at 1 %?

# %%
needed = {}
for degree, found in rows.items():
    line = np.polyfit(np.log(found[-3:, 1]), np.log(found[-3:, 0]), 1)
    needed[degree] = {goal: np.exp(np.polyval(line, np.log(goal))) for goal in (1e-1, 1e-2, 1e-3)}
    print(
        f"P{degree}:", *(f"{goal:.1%}: {n:9.0f} unknowns  " for goal, n in needed[degree].items())
    )
    assert abs(line[0] + 2 / degree) < 0.05
gain = {goal: needed[1][goal] / needed[2][goal] for goal in needed[1]}
print("P1 over P2:", {f"{goal:.1%}": round(factor) for goal, factor in gain.items()})
assert gain[1e-1] < gain[1e-2] < gain[1e-3] and gain[1e-3] > 50 * gain[1e-1]
level = 1e-1 * gain[1e-1] / 5  # the gain is proportional to one over the error
print(f"were an unknown of P2 five times as dear, P1 would be ahead above an error of {level:.0%}")
assert 0.1 < level < 0.2

# %% [markdown]
# P2 wins below a certain error because its curve is steeper, whatever an unknown costs: a tenth of
# the error costs P1 a hundred times the unknowns, P2 ten times. If an unknown of P2 took five times
# as long (it has more neighbors), P1 would be ahead where the error may be large, and nowhere else.
# This holds for **smooth** solutions; the chart below shows another case.
#
# ## Quadrature is a knob, too
#
# **Question.** The default rule for P2 triangles has degree 2, three points. What does degree 6
# improve, what does degree 1 spoil?

# %%
options = {"snes_max_it": 10}
for n in (8, 16):
    for degree in (1, 2, 4, 6):
        u, potential, held, error = manufactured(2, n, degree=degree)
        try:
            forms.solve(potential, u, held, options=options, projection="never")
            print(f"n = {n:2d}, degree {degree}: error {error():.5e}")
            defaults = rows[2][sizes[2].index(n), 1]
            assert degree > 1 and abs(error() / defaults - 1) < 1e-3
        except forms.NotConverged as failed:
            print(f"n = {n:2d}, degree {degree}: {str(failed).split(',')[0]}")
            assert degree == 1

# %% [markdown]
# Nothing: the error of the mesh is all there is to see; from $2k - 2$ on the order is kept, and
# each point costs. One point per cell is too few: six nodes have modes that do not strain its
# middle, the tangent gets singular. More points are for states near inversion, and for parameters
# that vary within a cell.
#
# ## How small must |R| be?
#
# **Question.** The mesh of 32 x 32 cells P2 has an error of 0.06 %. Which tolerance of Newton's
# method is enough, and what does $10^{-12}$ cost?

# %%
errors = {}
for rtol in (1e-1, 1e-2, 1e-3, 1e-8, 1e-12):
    u, potential, held, error = manufactured(2, 32)
    run = forms.solve(potential, u, held, rtol=rtol, ctol=1.0).steps[0].convergence
    errors[rtol] = error()
    print(f"rtol {rtol:.0e}: {run.iterations} iterations, error {errors[rtol]:.3e}")
assert errors[1e-2] > 2 * errors[1e-12]  # too loose: the solver's error is the larger one
assert abs(errors[1e-3] / errors[1e-12] - 1) < 1e-4

# %% [markdown]
# No iteration at all: the step that carries the new boundary values into the body, a tangent solve,
# comes before the first one and was enough for $10^{-1}$. $10^{-3}$ gives the same error as
# $10^{-12}$ to four digits. But $10^{-2}$ is too loose, so a tolerance below the mesh's error has
# to be kept. Since Newton's method is quadratic the digits between $10^{-3}$ and $10^{-8}$ cost one
# iteration: the default is tight and hardly a waste. It is one with linear solvers that take their
# time for each digit; so multigrid solves Newton's directions to 1 %.
#
# ## Direct or iterative?
#
# **Question.** Double the cells of a cube in each direction. What becomes of the fill-in of a
# factorization, and of the number of multigrid's iterations?

# %%
ways = {
    "MUMPS": {"ksp_type": "preonly", "pc_type": "cholesky", "pc_factor_mat_solver_type": "mumps"},
    "multigrid": {"ksp_type": "cg", "pc_type": "gamg", "ksp_rtol": 1e-2},
    "default": {},
}
linear, tips = {}, {}
for n in (5, 10, 16):
    cube = meshes.block(comm, (1.0, 1.0, 1.0), n=n)
    u = forms.displacement(cube)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0)
    shear = forms.dead_traction(u, ufl.as_vector([0, 0.05, 0]), cube.ds("right"))
    held, words = [forms.clamp(u, cube.facets("left"))], []
    for way, options in ways.items():
        u.x.array[:] = 0
        path = forms.solve(psi * ufl.dx + shear, u, held, options=options)
        run = path.steps[0].convergence
        linear[way, n] = run.linear_iterations / run.iterations
        tips[way, n] = forms.at(u, (1.0, 0.5, 0.5))[1]
        words.append(f"{way} {path.seconds:.2f} s ({linear[way, n]:.0f} per step)")
    print(f"{u.x.array.size:6d} unknowns:", ", ".join(words))
    assert np.ptp([tips[way, n] for way in ways]) < 1e-6
assert all(linear["MUMPS", n] == 1 for n in (5, 10, 16))
assert linear["multigrid", 16] < 2 * linear["multigrid", 5]
assert linear["default", 10] == 1 < linear["default", 16]

# %% [markdown]
# In 3D a factorization costs about $N^2$ operations and $N^{4/3}$ numbers. Multigrid's iterations
# hardly grow while the unknowns grow by more than twenty, so it costs a constant times $N$, with a
# larger constant. Somewhere they cross; `forms.solve` turns to multigrid at 5,000 unknowns. In the
# plane ($N^{3/2}$, and fill-in like $N \log N$) a factorization is hard to beat at any size seen
# here.
#
# ## The chart
#
# Here are two of the nine comparisons in [the whole chart](../figures/work_precision.png), which is
# described in [benchmarks](../benchmarks/README.md#work-and-precision): a smooth scene, and a
# clamped plate whose edges are singular.

# %%
repository = Path(forms.__file__).resolve().parents[1]
with Pixels.open(repository / "demos/figures/work_precision.png") as chart:
    width, height = chart.size
    parts = [
        chart.crop((int(a * width), 0, int(b * width), int(height / 3)))
        for a, b in ((0, 0.363), (0.68, 1))
    ]
row = Pixels.new("RGB", (sum(p.width for p in parts), parts[0].height), "white")
row.paste(parts[0].convert("RGB"), (0, 0))
row.paste(parts[1].convert("RGB"), (parts[0].width, 0))
row = row.resize((700, round(700 * row.height / row.width)))
stored = io.BytesIO()
row.save(stored, "PNG", optimize=True)
Image(stored.getvalue())

# %% [markdown]
# **Question.** Left: which element is the cheapest for 1 %, which for 0.001 %? Right: why do P2, P3
# and Q2 (solid) lie on one line, and what do the dashed ones do differently?
#
# Left, at 1 % all elements of degree 2 and 3 are equal, at 0.001 % only degree 3 is in time. Right,
# the stress is infinite at the clamp's edges: the error is that of a few cells there, falls with a
# power of $h$ that the edge sets, and the degree buys nothing. Cells that get smaller towards the
# edge (dashed) do. Grade first, then refine, then raise the degree.
#
# The gray band is the limit of what can be seen: the reference itself is not known better.
#
# ## Exercises
#
# **Exercise 1.** How many unknowns would P1 need for the error that P3 has with 32 x 32 cells?
# Would they fit into 64 GB, if the tangent takes 150 bytes per unknown?
#
# <details><summary><b>Solution</b> (click to show it)</summary>
#
# Extrapolate with the slope -1/2: the error is to be divided by more than a thousand, so the
# unknowns are multiplied by its square. Some $10^{11}$ of them, more than 10 TB: no.
#
# ```python
# (_, coarse, _), goal = rows[1][-1], rows[3][-1][1]
# unknowns = rows[1][-1][0] * (coarse / goal) ** 2
# assert 5e10 < unknowns < 2e11 and 150 * unknowns > 10e12 > 64e9
# ```
# </details>

# %% [markdown]
# **Exercise 2.** The error of the displacement itself falls like $h^{k+1}$. Measure it for P2.
#
# <details><summary><b>Solution</b> (click to show it)</summary>
#
# ```python
# found = []
# for n in (8, 16):
#     u, potential, held, _ = manufactured(2, n)
#     forms.solve(potential, u, held)
#     x = ufl.SpatialCoordinate(u.function_space.mesh)
#     exact = [0.1 * ufl.sin(np.pi * x[0]) * ufl.cos(2 * x[1]), 0.1 * x[0] * ufl.sin(np.pi * x[1])]
#     d = u - ufl.as_vector(exact)
#     found.append(np.sqrt(forms.integral(ufl.inner(d, d) * ufl.dx(degree=6))))
# assert abs(np.log2(found[0] / found[1]) - 3) < 0.1
# ```
# </details>

# %%
# Your answer to exercise 2:

# %% [markdown]
# **Exercise 3.** Look at the whole chart. Which curves end in a floor, and what is it that no mesh
# can mend?
#
# <details><summary><b>Solution</b> (click to show it)</summary>
#
# Slab in plane strain and balloon as a membrane: a model's own error. They are the right choice
# above it (1 %) and none below. Read the choices off the table beside the chart:
#
# ```python
# text = (repository / "demos/benchmarks/README.md").read_text()
# table = {row.split("|")[1].strip(): row.split("|")[2:] for row in text.splitlines()
#          if row.startswith("| ") and row.count("|") == 6}
# assert "plane strain" in table["slab"][0] and "none measured" in table["slab"][2]
# assert "3" in table["elements, smooth"][2].split(":")[0]
# ```
# </details>

# %%
# Your answer to exercise 3:
