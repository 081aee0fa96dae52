# SPDX-License-Identifier: MIT
"""Fits: parameters that are known come back, with the spread that is told; what data leave open."""

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem

from demos.validation import treloar
from variform import forms, meshes


def pulled(comm=MPI.COMM_SELF):
    """A clamped block that is pulled: problem, load factor, moduli, force."""
    body = meshes.block(comm, (1.0, 1.0, 1.0), n=2)
    u, t = forms.displacement(body), forms.load_factor(body)
    mu, lmbda = fem.Constant(body.mesh, 1.3), fem.Constant(body.mesh, 2.4)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), mu, lmbda)
    held = [
        forms.clamp(u, body.facets("left")),
        forms.translate(u, body.facets("right"), (t, 0, 0)),
    ]
    problem = forms.Problem(psi * ufl.dx, u, held)
    return problem, t, mu, lmbda, forms.Reaction(body.facets("right"))


LOADS = [0.1, 0.2, 0.35, 0.5]


def curve(problem, t, record):
    """What a path records at the loads; the problem is at rest again."""
    rows = forms.follow(
        problem, t=t, to=LOADS, record={"y": record}, progress=False, rtol=1e-12, ctol=1e-10
    ).steps
    problem.u.x.array[:] = t.value = 0.0
    return np.array([step.records["y"] for step in rows if step.load in LOADS])


def test_two_moduli_from_one_curve():
    """Without noise both moduli of a force-displacement curve come back to 1e-8."""
    problem, t, mu, lmbda, force = pulled()
    data = forms.Data(problem, force, curve(problem, t, force), t=t, loads=LOADS)
    mu.value, lmbda.value = 3.0, 1.0
    fit = forms.fit(data, {"mu": mu, "lmbda": lmbda}, progress=False)
    assert fit.converged and fit.values == pytest.approx([1.3, 2.4], rel=1e-8)
    assert float(mu.value) == fit.values[0] and not fit.open
    assert fit.evaluations < 15 and fit.history[0] > fit.history[-1]


def test_a_bound_that_holds_a_number_is_told():
    """The modulus would be 1.3; it may not be above 1."""
    problem, t, mu, _, force = pulled()
    data = forms.Data(problem, force, curve(problem, t, force), t=t, loads=LOADS)
    mu.value = 0.5
    fit = forms.fit(data, {"mu": mu}, bounds={"mu": (0.1, 1.0)}, progress=False)
    assert fit.values == pytest.approx([1.0], rel=1e-5) and "At a bound: mu." in fit.reason


def test_covariance_is_that_of_the_jacobian(tmp_path):
    """With sigma given it is (J^T J)^-1, J by differences of solves; the bars and a picture."""
    problem, t, mu, lmbda, force = pulled()
    y = curve(problem, t, force)
    data = forms.Data(problem, force, y, sigma=0.01, t=t, loads=LOADS, name="pull")
    fit = forms.fit(data, {"mu": mu, "lmbda": lmbda}, progress=False)
    columns = []
    for m in (mu, lmbda):
        start, found = float(m.value), []
        for h in (1e-4, -1e-4):
            problem.u.x.array[:] = t.value = 0.0
            m.value = start + h
            found.append(curve(problem, t, force))
        m.value = start
        columns.append((found[0] - found[1]) / 2e-4 / 0.01)
    J = np.array(columns).T
    assert fit.covariance == pytest.approx(np.linalg.inv(J.T @ J), rel=1e-5)
    assert fit.deviations == pytest.approx(np.sqrt(np.diag(fit.covariance)))
    assert "mu = 1.3 +- " in repr(fit)
    fit.plot(tmp_path / "fit.png")
    assert (tmp_path / "fit.png").stat().st_size > 10_000


def test_what_data_cannot_tell():
    """Displacements of a body whose boundary is moved tell a ratio of moduli, and no stiffness."""
    problem, t, mu, lmbda, _ = pulled()
    points = forms.Displacements([(0.5, 1.0, 0.3), (0.4, 0.5, 0.0)])
    y = curve(problem, t, lambda p: points.values(p).reshape(2, 3))
    data = forms.Data(problem, points, y, sigma=1e-3, t=t, loads=LOADS)
    fit = forms.fit(data, {"mu": mu, "lmbda": lmbda}, progress=False)
    assert fit.open == ["The data tell nothing of relative changes along 0.71 mu +0.71 lmbda."]
    assert fit.deviations == pytest.approx([np.inf, np.inf])


def test_a_pressure_curve_under_volume_control():
    """A balloon's modulus from pressures at given volumes, over the limit point."""
    body = meshes.spherical_sheet(MPI.COMM_SELF, 1.0, 0.5, 2, "octant")
    u, p = forms.displacement(body, degree=2), fem.Constant(body.mesh, 0.1)
    mu, volume = fem.Constant(body.mesh, 0.6), forms.enclosed_volume(u)
    psi = forms.energies.neo_hookean_sheet(forms.membrane_gradient(u), mu)
    held = [forms.roller(u, body.facets(f"{a}0"), k) for k, a in enumerate("xyz")]
    problem = forms.Problem(psi * ufl.dx - p * volume, u, held)
    targets = [forms.integral(volume) * s**3 for s in (1.2, 1.4, 1.7)]
    path = forms.control(problem, None, (), p, volume, targets, progress=False, rtol=1e-11)
    y = [step.load for step in path.steps if step.records["target"] in targets]
    u.x.array[:], p.value, mu.value = 0.0, 0.1, 1.0
    data = forms.Data(problem, p, y, t=p, loads=targets, held=volume)
    fit = forms.fit(data, mu, progress=False)
    assert fit.values == pytest.approx([0.6], rel=1e-7)


def inclusions(comm=MPI.COMM_SELF, n=12):
    """A square with two inclusions under known tractions, measured at its rim."""
    body = meshes.block(comm, (1.0, 1.0), n=n)
    u, X = forms.displacement(body), ufl.SpatialCoordinate(body.mesh)
    a, b = fem.Constant(body.mesh, 4.0), fem.Constant(body.mesh, 8.0)
    inside = [
        ufl.lt((X[0] - x) ** 2 + (X[1] - y) ** 2, 0.16**2) for x, y in ((0.3, 0.6), (0.7, 0.4))
    ]
    mu = ufl.conditional(inside[0], a, ufl.conditional(inside[1], b, 1.0))
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), mu, 2 * mu)
    load = forms.dead_traction(u, (0.0, 0.4), body.ds("top"))
    load += forms.dead_traction(u, (0.2, 0.0), body.ds("right"))
    problem = forms.Problem(
        psi * ufl.dx(degree=2) + load, u, [forms.clamp(u, body.facets("bottom"))]
    )
    s = np.linspace(0.05, 0.95, 13)
    rim = np.concatenate([[(0.0, y) for y in s], [(1.0, y) for y in s], [(x, 1.0) for x in s]])
    return problem, a, b, forms.Displacements(rim)


@pytest.mark.slow
def test_inclusions_within_their_deviations():
    """With 1 % noise both stiffnesses lie within 3 standard deviations in 19 of 20 seeds."""
    problem, a, b, rim = inclusions()
    forms.solve(problem, rtol=1e-11)
    exact = rim.values(problem).reshape(rim.shape(problem))
    sigma = 0.01 * np.abs(exact).max()
    inside = 0
    for seed in range(20):
        noise = sigma * np.random.default_rng(seed).normal(size=exact.shape)
        a.value = b.value = 2.0
        data = forms.Data(problem, rim, exact + noise, sigma=sigma)
        fit = forms.fit(data, {"a": a, "b": b}, progress=False, check=False)
        inside += bool(np.all(np.abs(fit.values - [4.0, 8.0]) < 3 * fit.deviations))
    assert inside >= 19


def blob(comm=MPI.COMM_SELF, n=8):
    """A square with a modulus exp(m): its data, m at 0, m as it was, a regularization."""
    body = meshes.block(comm, (1.0, 1.0), n=n)
    u = forms.displacement(body)
    m = fem.Function(fem.functionspace(body.mesh, ("Lagrange", 1)), name="m")
    exact = fem.Function(m.function_space)
    exact.interpolate(lambda x: 0.8 * np.exp(-20 * ((x[0] - 0.5) ** 2 + (x[1] - 0.6) ** 2)))
    m.x.array[:] = exact.x.array
    mu = ufl.exp(m)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), mu, 2 * mu)
    pull = forms.dead_traction(u, (0.0, 0.4), body.ds("top"))
    problem = forms.Problem(psi * ufl.dx + pull, u, [forms.clamp(u, body.facets("bottom"))])
    forms.solve(problem, rtol=1e-11)
    s = np.linspace(0.1, 0.9, 9)
    inner = forms.Displacements([(x, y) for x in s for y in s])
    y = inner.values(problem).reshape(inner.shape(problem))
    m.x.array[:] = 0.0
    smooth = 1e-2 * ufl.inner(ufl.grad(m), ufl.grad(m)) * ufl.dx
    return forms.Data(problem, inner, y, sigma=1e-3), m, exact, smooth


def test_a_field_with_regularization():
    """A modulus that varies in space comes back from inner displacements, to 2 % of its square."""
    data, m, exact, smooth = blob(n=6)
    before = forms.integral(exact**2 * ufl.dx)
    fit = forms.fit(data, m, regularization=smooth, progress=False)
    after = forms.integral((m - exact) ** 2 * ufl.dx)
    assert fit.converged and fit.covariance is None
    assert after < 0.02 * before and fit.names == ["m"]


def test_covariance_of_a_field():
    """(J^T J + H)^-1, J by differences of solves, H assembled; and what the data decide."""
    data, m, _, smooth = blob(n=2)
    data = forms.Data(data.problem, data.what, data.values, sigma=0.02)
    offset = fem.Constant(m.function_space.mesh, 0.1)
    smooth += (0.1 * m**4 + 0.3 * (m - offset) ** 2 + offset**2) * ufl.dx(degree=4)
    given = {"m": m, "offset": offset}
    fit = forms.fit(data, given, regularization=smooth, covariance=True, progress=False)
    columns = []
    for k in range(m.x.array.size):
        found, start = [], m.x.array[k]
        for h in (1e-4, -1e-4):
            m.x.array[k] = start + h
            forms.solve(data.problem, rtol=1e-12)
            found.append(data.what.values(data.problem))
        m.x.array[k] = start
        columns.append((found[0] - found[1]) / 2e-4 / 0.02)
    J = np.column_stack([*columns, np.zeros(len(columns[0]))])
    v, du = ufl.TestFunction(m.function_space), ufl.TrialFunction(m.function_space)
    slope = ufl.derivative(smooth, m, v)
    H = np.zeros((J.shape[1],) * 2)
    H[:-1, :-1] = fem.assemble_matrix(fem.form(ufl.derivative(slope, m, du))).to_dense()
    H[-1, :-1] = H[:-1, -1] = fem.assemble_vector(fem.form(-0.6 * v * ufl.dx)).array
    H[-1, -1] = 2.6
    expected = np.linalg.inv(J.T @ J + H)
    size = np.abs(expected).max()
    assert fit.covariance == pytest.approx(expected, abs=1e-6 * size)
    count = np.trace(expected @ J.T @ J)
    told = f"The data decide {count:.3g} of 10 numbers, and the regularization {10 - count:.3g}."
    assert 1 < count < 9 and fit.open == [told]
    assert fit.spread[0].x.array == pytest.approx(fit.deviations[:-1])
    std = fit.deviations[:-1]
    assert f" m: 9 numbers, +- {std.min():.2g} to {std.max():.2g}" in repr(fit)
    assert f" offset = {fit.values[-1]:.6g} +- {fit.deviations[-1]:.2g}" in repr(fit)


def test_what_nothing_decides():
    """A modulus in cells where it has no part is of infinite deviation, and told."""
    body = meshes.block(MPI.COMM_SELF, (1.0, 1.0), n=2)
    u, m = forms.displacement(body), fem.Function(fem.functionspace(body.mesh, ("DG", 0)))
    mu = ufl.conditional(ufl.lt(ufl.SpatialCoordinate(body.mesh)[0], 0.5), ufl.exp(m), 1.0)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), mu, 2.0)
    pull = forms.dead_traction(u, (0.0, 0.4), body.ds("top"))
    problem = forms.Problem(psi * ufl.dx + pull, u, [forms.clamp(u, body.facets("bottom"))])
    forms.solve(problem)
    points = forms.Displacements([(x, y) for x in (0.0, 0.5, 1.0) for y in (0.5, 1.0)])
    data = forms.Data(problem, points, points.values(problem).reshape(6, 2), sigma=0.01)
    fit = forms.fit(data, m, covariance=True, progress=False)
    middles = fem.Function(m.function_space)
    middles.interpolate(lambda x: x[0])
    assert np.array_equal(np.isinf(fit.spread[0].x.array), middles.x.array > 0.5)
    assert fit.open == ["The data decide 4 of 8 numbers, and nothing decides 4."]


SCRIPT = """
import json
from mpi4py import MPI
import numpy as np
from variform import forms
import ufl
from test_fitting import blob, inclusions

comm = MPI.COMM_WORLD
problem, a, b, rim = inclusions(comm, 8)
forms.solve(problem, rtol=1e-11)
y = rim.values(problem).reshape(rim.shape(problem))
y += 1e-3 * np.random.default_rng(1).normal(size=y.shape)
a.value = b.value = 2.0
fit = forms.fit(forms.Data(problem, rim, y, sigma=1e-3), [a, b], progress=False)
data, m, exact, smooth = blob(comm, 5)
few = {"most": 10, "check": False, "progress": False}
field = forms.fit(data, m, regularization=smooth, covariance=True, **few)
moments = [forms.integral(f * ufl.dx) for f in (m, m**2, field.spread[0])]
if comm.rank == 0:
    print(json.dumps([*fit.values.tolist(), *fit.deviations.tolist(), *moments]))
"""


@pytest.mark.slow
def test_ranks_agree(parallel):
    """A fit is the same on 1 and 2 ranks to its tolerance, of a field the first evaluations are."""
    one, two = (parallel(SCRIPT, ranks) for ranks in (1, 2))
    assert two[:4] == pytest.approx(one[:4], rel=1e-7)
    assert two[4:] == pytest.approx(one[4:], rel=1e-6)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("few", "fit has 2 numbers to find from 1 data: add a regularization"),
        ("outside", r"the measured point \(0.5, 3.0, 0.0\) lies 2 outside"),
        ("elsewhere", "fit by the Constant 7.0: neither a potential, .* turned into a number"),
        ("support", "needs parameters that can change: Constants, Functions, got Support"),
        ("shape", r"data need values of shape \(4,\): one for each load, got \(3,\)"),
        ("nan", "data need finite values"),
        ("sigma", "sigma is a positive standard deviation"),
        ("no loads", "need both its load factor t= and loads="),
        ("path", "data belong to a forms.Problem, got Path"),
        ("bounds", r"bounds are 2 pairs \(least, largest\), one for each parameter"),
        ("name", "bounds are of the parameters mu, lmbda, got nu"),
        ("dense", "finds a covariance of 2000 numbers at most, got 2880: leave it out"),
        ("nothing", "fit needs data, one or several forms.Data"),
        ("points", r"at finite points of shape \(k, 2\) or \(k, 3\), got \(1, 4\)"),
    ],
)
def test_bad_input_gets_one_sentence(change, message):
    problem, t, mu, lmbda, force = pulled()
    y = [0.1, 0.2, 0.3, 0.4]
    data = forms.Data(problem, force, y, t=t, loads=LOADS)
    both = {"mu": mu, "lmbda": lmbda}
    other = fem.Constant(problem.u.function_space.mesh, 7.0)
    fine = fem.Function(fem.functionspace(problem.u.function_space.mesh, ("DG", 3, (3,))))
    quiet = {"progress": False}
    calls = {
        "few": lambda: forms.fit(forms.Data(problem, force, 0.1), both, **quiet),
        "outside": lambda: forms.fit(
            forms.Data(problem, forms.Displacements([(0.5, 3.0, 0.0)]), [[0.0] * 3]), both, **quiet
        ),
        "elsewhere": lambda: forms.fit(data, [mu, other], **quiet),
        "support": lambda: forms.fit(data, [problem.supports[0]], **quiet),
        "shape": lambda: forms.Data(problem, force, y[:3], t=t, loads=LOADS),
        "nan": lambda: forms.Data(problem, force, [np.nan] * 4, t=t, loads=LOADS),
        "sigma": lambda: forms.Data(problem, force, y, sigma=-1.0, t=t, loads=LOADS),
        "no loads": lambda: forms.Data(problem, force, y, t=t),
        "path": lambda: forms.Data(forms.solve(problem), force, y),
        "bounds": lambda: forms.fit(data, both, bounds=[(0, 1)], **quiet),
        "name": lambda: forms.fit(data, both, bounds={"nu": (0, 1)}, **quiet),
        "dense": lambda: forms.fit(data, fine, covariance=True, **quiet),
        "nothing": lambda: forms.fit([], both, **quiet),
        "points": lambda: forms.Displacements([(1.0, 2.0, 3.0, 4.0)]),
    }
    with pytest.raises(ValueError, match=message):
        calls[change]()


@pytest.mark.slow
def test_treloars_data_through_solves():
    """Ogden's constants from solves of the three specimens are those from formulas, to 1e-6."""
    body = meshes.block(MPI.COMM_SELF, (1.0, 1.0), n=1, cells="quadrilateral")
    c = fem.Constant(body.mesh, treloar.ENERGIES["Ogden"][1])
    data = []
    for mode in treloar.MODES:
        stretches, stresses = treloar.measured(mode)
        u, t = forms.displacement(body), forms.load_factor(body, 1.0)
        F = forms.plane_stress_incompressible(u)
        psi = forms.energies.ogden(F, [c[0], c[1], c[2]], [c[3], c[4], c[5]])
        held = [forms.roller(u, body.facets(a), k) for k, a in enumerate(("left", "bottom"))]
        held.append(forms.translate(u, body.facets("right"), (t - 1, None)))
        if mode != "uniaxial":
            rise = t - 1 if mode == "equibiaxial" else 0 * t
            held.append(forms.translate(u, body.facets("top"), (None, rise)))
        problem = forms.Problem(psi * ufl.dx, u, held)
        sigma = np.linalg.norm(stresses)
        force = forms.Reaction(body.facets("right"))
        data.append(forms.Data(problem, force, stresses, sigma=sigma, t=t, loads=[*stretches]))
    fit = forms.fit(data, c, progress=False)
    assert fit.values == pytest.approx(treloar.fit("Ogden")[0], rel=1e-6)
