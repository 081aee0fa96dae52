# SPDX-License-Identifier: MIT
"""Gradients of what is measured on a solution: Taylor's remainder, closed forms, ranks."""

from mpi4py import MPI
from petsc4py import PETSc

import inverse_scenes as scenes
import numpy as np
import pytest
import ufl
from dolfinx import fem
from every_kind import EVERY
from test_problems import Well

from variform import forms, meshes
from variform.forms.measured import measured
from variform.forms.solving.linear.conjugate import conjugate_gradients
from variform.forms.solving.linear.kept import Kept
from variform.forms.solving.linearized import NEAR, Linearized
from variform.forms.solving.rates import Rates
from variform.forms.solving.settings import Settings

STEPS = (0.004, 0.002, 0.001)


def remainders(scene, J, m, along, gradient):
    """J(m + h dm) - J(m) - h dJ/dm dm, solved anew for each h."""
    path = scene.solve()
    start, before = scenes.values_of(m), scenes.value(J, path)
    slope = scenes.slope_along(path.problem, m, gradient, along)
    found = []
    for h in STEPS:
        scenes.move(m, start, along, h)
        found.append(scenes.value(J, scene.solve()) - before - h * slope)
    scenes.move(m, start, along, 0.0)
    scene.solve()
    return np.abs(found)


@pytest.mark.parametrize("name", scenes.SCENES)
def test_gradients_are_the_derivatives(name):
    """J(m + h dm) = J(m) + h dJ/dm dm + O(h^2): halving h divides the remainder by 4."""
    check_rates(scenes.SCENES[name](MPI.COMM_SELF))


@pytest.mark.slow
@pytest.mark.parametrize("kind", EVERY)
def test_every_kind_of_parameter_in_every_body(kind):
    """The same of all kinds of parameters at once, in solids, plane, thin and bound by a volume."""
    check_rates(EVERY[kind](MPI.COMM_SELF))


def check_rates(scene):
    """Taylor's remainder of all that a scene measures by all its parameters, one after another."""
    names, given = zip(*scene.parameters.items(), strict=True)
    for J in scene.measured.values():
        found = forms.gradient(scene.solve(), J, [m for m, _ in given])
        for what, (m, along), g in zip(names, given, found, strict=True):
            along = scenes.direction_of(m, along)
            rest = remainders(scene, J, m, along, g)
            # Of the first two steps the third order has its part in the rate; where J is linear
            # in the parameter nothing is left over.
            if rest[0] > 1e-9:
                rate = np.log2(rest[1] / rest[2])
                assert rate == pytest.approx(2, abs=0.05), (what, rest)


SCRIPT = """
import json
from mpi4py import MPI
import inverse_scenes as scenes
from every_kind import EVERY
from variform import forms

comm, found = MPI.COMM_WORLD, {}
for name in NAMES:
    scene = {**scenes.SCENES, **{f"every kind, {k}": EVERY[k] for k in EVERY}}[name](comm)
    names, given = zip(*scene.parameters.items(), strict=True)
    for what, J in scene.measured.items():
        path = scene.solve()
        parts = forms.gradient(path, J, [m for m, _ in given], rtol=1e-12)
        for key, (m, along), g in zip(names, given, parts, strict=True):
            along = scenes.direction_of(m, along)
            found[f"{name} {what} {key}"] = scenes.slope_along(path.problem, m, g, along)
if comm.rank == 0:
    print(json.dumps(found))
"""


FEW, EACH = ["text"], [f"every kind, {kind}" for kind in EVERY]


@pytest.mark.parametrize(
    ("names", "ranks"),
    [
        (FEW, (2,)),
        pytest.param([*scenes.SCENES], (2, 3), marks=pytest.mark.slow),
        pytest.param(EACH, (2, 3), marks=pytest.mark.slow),
    ],
    ids=["few", "all", "every kind"],
)
def test_ranks_agree(parallel, names, ranks):
    """Gradients are the same on 1, 2 and 3 ranks, to 1e-10."""
    script = SCRIPT.replace("NAMES", repr(names))
    one, *others = (parallel(script, n) for n in (1, *ranks))
    for other in others:
        assert other == pytest.approx(one, rel=1e-10, abs=1e-12)


def square(**given):
    """A square that is pulled, solved."""
    body = meshes.block(MPI.COMM_SELF, (1.0, 1.0), n=2)
    u, mu = forms.displacement(body), fem.Constant(body.mesh, 1.0)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), mu, 2.0)
    held = [
        forms.clamp(u, body.facets("left")),
        forms.translate(u, body.facets("right"), (0.1, 0.0)),
    ]
    return forms.Problem(psi * ufl.dx, u, held), body, mu


def test_a_bar_by_hand():
    """Uniaxial strain l: the force mu (l - 1/l) + lmbda ln(l)/l, and its derivatives, exactly."""
    body = meshes.block(MPI.COMM_SELF, (1.0, 1.0, 1.0), n=2)
    u, mesh = forms.displacement(body), body.mesh
    mu, lmbda, pull = (fem.Constant(mesh, x) for x in (1.3, 2.0, 0.4))
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), mu, lmbda)
    held = [forms.roller(u, body.facets(a), k) for k, a in enumerate(("left", "front", "bottom"))]
    held += [forms.roller(u, body.facets(a), k) for k, a in ((1, "back"), (2, "top"))]
    held.append(forms.translate(u, body.facets("right"), (pull, None, None)))
    path = forms.solve(psi * ufl.dx, u, held, **scenes.TIGHT)
    force, s = forms.Reaction(body.facets("right")), 1.4
    assert force(path) == pytest.approx(1.3 * (s - 1 / s) + 2 * np.log(s) / s, rel=1e-12)
    found = forms.gradient(path, force, [mu, lmbda, pull])
    by_stretch = 1.3 * (1 + 1 / s**2) + 2 * (1 - np.log(s)) / s**2
    assert found == pytest.approx([s - 1 / s, np.log(s) / s, by_stretch], rel=1e-10)


def test_a_gradient_leaves_the_problem_as_it_was():
    """In the midst of a path, or after it: the path is the same to the last digit."""
    problem, body, mu = square()
    force = forms.Reaction(body.facets("right"))
    t = forms.load_factor(body)
    u = forms.displacement(body)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), mu, 2.0)
    held = [
        forms.clamp(u, body.facets("left")),
        forms.translate(u, body.facets("right"), (0.3 * t, 0.0)),
    ]
    problem = forms.Problem(psi * ufl.dx, u, held)
    ends, slopes = [], []
    for record in ({}, {"dF": lambda p: forms.gradient(p, force, mu)}, {}):
        t.value, u.x.array[:] = 0.0, 0.0
        path = forms.follow(problem, t=t, to=1.0, record=record, progress=False)
        ends.append(u.x.array.copy())
        slopes += [path.record("dF")[-1]] if record else []
        slopes.append(forms.gradient(path, force, mu))
    assert np.array_equal(ends[0], ends[1]) and np.array_equal(ends[0], ends[2])
    assert slopes == pytest.approx([slopes[0]] * 4, rel=1e-9)


def test_multigrid_and_factors_agree():
    """By multigrid kept from an earlier state the gradient is that by MUMPS, to the tolerance.

    The same by one that is due to be renewed, which is left to the next solve.
    """
    body = meshes.block(MPI.COMM_SELF, (1.0, 1.0, 1.0), n=4)
    found = {}
    for degree in (1, 2):
        u = forms.displacement(body, degree=degree)
        mu = scenes.field(body, ("DG", 0), lambda x: 1 + 0.5 * x[0], "mu")
        psi = forms.energies.neo_hookean(forms.deformation_gradient(u), mu, 2.0)
        pull = forms.translate(u, body.facets("right"), (0.3, 0.1, 0.0))
        problem = forms.Problem(psi * ufl.dx, u, [forms.clamp(u, body.facets("left")), pull])
        force = forms.Reaction(body.facets("right"), (1.0, 0.4, 0.0))
        for J in (force, ufl.inner(u, u) * ufl.dx, u[1] * body.ds("top") + mu * u[0] * ufl.dx):
            for most in (10, 10**6):
                path = forms.solve(problem, settings=Settings(direct_up_to=most), **scenes.TIGHT)
                kept = problem.solver[1].tangent.kept
                assert kept.used == (most == 10)
                kept.due = kept.used
                parts = forms.gradient(path, J, [mu, pull])
                found[most] = [part.x.array.copy() for part in parts]
                assert kept.due == kept.used
            for near, exact in zip(found[10], found[10**6], strict=True):
                assert 0 < np.linalg.norm(near - exact) < NEAR * np.linalg.norm(exact)


@pytest.mark.parametrize("asked", [1e-1, 1e-3, 1e-5])
def test_conjugate_gradients_end_at_an_error_in_energy(asked):
    """The error that is estimated lies below the one asked for, and no more than 30 times."""
    n = 12
    one = np.diag(np.full(n, 2.0)) - np.diag(np.ones(n - 1), 1) - np.diag(np.ones(n - 1), -1)
    eye, rng = np.eye(n), np.random.default_rng(0)
    K = np.kron(np.kron(one, eye), eye) + np.kron(np.kron(eye, one), eye)
    K += np.kron(np.kron(eye, eye), one) + np.diag(rng.random(n**3))
    A = PETSc.Mat().createDense(K.shape, array=K, comm=PETSc.COMM_SELF)
    pc = PETSc.PC().create(PETSc.COMM_SELF)
    pc.setOperators(A)
    pc.setType("jacobi")
    exact = rng.normal(size=n**3)
    energy = exact @ K @ exact
    x, r = A.createVecs()
    x.set(0)
    r.array[:] = K @ exact
    near, count = conjugate_gradients(A, pc, x, r, lambda x, r: asked**2 * energy, 0.0, 500)
    error = exact - x.array_r
    assert near and count > 1
    assert asked / 30 < np.sqrt(error @ K @ error / energy) <= asked
    assert r.array_r == pytest.approx(K @ error, abs=1e-10 * np.sqrt(energy))
    # Not enough iterations; and a matrix that is not positive definite.
    x.set(0)
    r.array[:] = K @ exact
    assert conjugate_gradients(A, pc, x, r, lambda x, r: 0.0, 0.0, 5) == (False, 5)
    A.shift(-2.0)
    assert not conjugate_gradients(A, pc, x, r, lambda x, r: 0.0, 0.0, 500)[0]


class Spring(Well):
    """A term that keeps nothing."""

    def history(self):
        return {}


def test_a_term_of_ones_own_takes_part():
    """A term that no form knows: its tangent is in the adjoint system, at supports too."""
    body = meshes.block(MPI.COMM_SELF, (1.0, 1.0), n=2)
    u, mu = forms.displacement(body), fem.Constant(body.mesh, 1.0)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), mu, 2.0)
    pull = forms.translate(u, body.facets("right"), (0.1, 0.0))
    held = [forms.clamp(u, body.facets("left")), pull]
    problem = forms.Problem([psi * ufl.dx, Spring(u, 3.0, 0.2)], u, held)
    scene = scenes.Scene(lambda: forms.solve(problem, **scenes.TIGHT), {}, {})
    force = forms.Reaction(body.facets("right"), (1.0, 0.4))
    for m, given in ((mu, 1.0), (pull, scenes.wave(2))):
        g, along = forms.gradient(scene.solve(), force, m), scenes.direction_of(m, given)
        rest = remainders(scene, force, m, along, g)
        assert np.log2(rest[1] / rest[2]) == pytest.approx(2, abs=0.05)


def test_a_function_in_a_support_is_refused():
    """Its own values are what a support moves with: by those the gradient is available."""
    body = meshes.block(MPI.COMM_SELF, (1.0, 1.0), n=2)
    u, pull = forms.displacement(body), scenes.field(body, ("Lagrange", 1), 0.1, "pull")
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0)
    held = [
        forms.clamp(u, body.facets("left")),
        forms.translate(u, body.facets("right"), (pull, 0)),
    ]
    path = forms.solve(psi * ufl.dx, u, held)
    with pytest.raises(ValueError, match="the Function pull stands in a support: pass the support"):
        forms.gradient(path, u[0] * ufl.dx, pull)
    assert forms.gradient(path, u[0] * ufl.dx, held[1]).x.array.any()


def test_the_scalar_that_control_found_is_no_parameter():
    """It moves with the parameters."""
    scene = scenes.SCENES["volume"](MPI.COMM_SELF)
    path = scene.solve()
    with pytest.raises(ValueError, match="the scalar that control has found is no parameter"):
        forms.gradient(path, scene.measured["functional"], path.held.q[0])


def thrown(path):
    """The path, its unknown moved away from the solution."""
    path.u.x.array[8] += 0.1
    return path


def test_terms_with_a_history_are_refused():
    """What a path in time leads to depends on more than the last state."""
    problem, _, mu = square()
    path = forms.solve(problem)
    path.velocity = problem.u
    with pytest.raises(ValueError, match="a state at rest: paths in time are not differentiated"):
        forms.gradient(path, problem.u[0] * ufl.dx, mu)
    path.velocity = None
    problem.terms[0].history = lambda: {"velocity": np.zeros(3)}
    with pytest.raises(ValueError, match="keeps a history, FormTerm: paths in time are not"):
        forms.gradient(path, problem.u[0] * ufl.dx, mu)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("number", "needs parameters that can change: .* got float 3.0"),
        ("none", "needs at least one parameter, got none"),
        ("elsewhere", "by the Constant 7.0: neither the potential, .* turned into a number"),
        ("unknown", "got the unknown displacement as a parameter"),
        ("other mesh", "got other, a Function of another mesh than the unknown's"),
        ("other support", "got a support that is not one of the problem's"),
        ("path", "needs a path or a problem at its solution, got Unknown"),
        ("J", "differentiates a functional .* got float"),
        ("unsolved", "needs a state in equilibrium, got forces of 0.21 N out of balance"),
        ("displacements", "differentiates one number, got displacements: integrate them"),
        ("axes", r"displacements of this body have the axes 0 to 1, got \(2,\)"),
        ("linear form", "a gradient needs a functional"),
        ("direction", "needs a direction of 2 or 3 components, got 1"),
    ],
)
def test_bad_input_gets_one_sentence(change, message):
    problem, body, mu = square()
    path = forms.solve(problem)
    other = meshes.block(MPI.COMM_SELF, (1.0, 1.0), n=2)
    strange = fem.Function(fem.functionspace(other.mesh, ("DG", 0)), name="other")
    J = problem.u[0] * ufl.dx
    calls = {
        "number": lambda: forms.gradient(path, J, 3.0),
        "none": lambda: forms.gradient(path, J, []),
        "elsewhere": lambda: forms.gradient(path, J, [mu, fem.Constant(body.mesh, 7.0)]),
        "unknown": lambda: forms.gradient(path, J, problem.u),
        "other mesh": lambda: forms.gradient(path, J, strange),
        "other support": lambda: forms.gradient(
            path, J, forms.clamp(problem.u, body.facets("left"))
        ),
        "path": lambda: forms.gradient(problem.u, J, mu),
        "J": lambda: forms.gradient(path, 1.0, mu),
        "unsolved": lambda: forms.gradient(thrown(path), J, mu),
        "displacements": lambda: forms.gradient(path, forms.Displacements([(0.5, 0.5)]), mu),
        "axes": lambda: forms.Displacements([(0.5, 0.5)], axes=(2,)).values(problem),
        "linear form": lambda: forms.gradient(path, problem.forms.residual_ufl, mu),
        "direction": lambda: forms.Reaction(body.facets("left"), 1),
    }
    with pytest.raises(ValueError, match=message):
        calls[change]()


@pytest.mark.parametrize("name", scenes.SCENES)
def test_forward_and_adjoint_agree(name):
    """Rates of the solution by Constants give the derivatives that adjoints give."""
    scene = scenes.SCENES[name](MPI.COMM_SELF)
    constants = [m for m, _ in scene.parameters.values() if isinstance(m, fem.Constant)]
    path = scene.solve()
    found = [measured(J, path.problem, path.held, "this") for J in scene.measured.values()]
    with Linearized(path.problem) as linear:
        _, columns = Rates(path.problem, found, constants, path.held)(linear)
    for J, column in zip(scene.measured.values(), columns, strict=True):
        gradients = [np.ravel(g) for g in forms.gradient(path, J, constants)]
        assert column[0] == pytest.approx(np.concatenate(gradients), rel=1e-8, abs=1e-10)


def cube(mixed, settings):
    """A nearly incompressible cube, solved with some preset; its gradient by moduli."""
    body = meshes.block(MPI.COMM_SELF, (1.0, 1.0, 1.0), n=3, cells="hexahedron")
    w = forms.displacement_pressure(body) if mixed else forms.displacement(body)
    mu = scenes.field(body, ("DG", 0), lambda x: 1 + 0.5 * x[0], "mu")
    F = forms.deformation_gradient(w["u"])
    psi = forms.energies.neo_hookean(F, mu, 2.0)
    if mixed:
        psi = forms.energies.isochoric_neo_hookean(F, mu)
        psi = forms.energies.with_pressure(psi, F, w["p"], 50.0)
    pull = forms.translate(w, body.facets("right"), (0.1, 0.05, 0.0))
    problem = forms.Problem(psi * ufl.dx, w, [forms.clamp(w, body.facets("left")), pull])
    path = forms.solve(problem, settings=settings, **scenes.TIGHT)
    force = forms.Reaction(body.facets("right"))
    return problem, forms.gradient(path, force, mu).x.array.copy()


@pytest.mark.slow
def test_a_field_split_solves_for_adjoints_too():
    """Blocks of a mixed unknown, kept from the solve, give the gradient of a factorization."""
    problem, split = cube(True, Settings(split_from={"hexahedron": 10}))
    assert problem.solver[1].tangent.kept.used
    problem, whole = cube(True, None)
    assert not problem.solver[1].tangent.kept.used
    assert split == pytest.approx(whole, abs=1e-5 * np.abs(whole).max())


def test_where_multigrid_fails_there_is_a_factorization(monkeypatch):
    """A linear solver that gives up, as in an unstable state, is replaced for this gradient."""
    _, whole = cube(False, None)
    monkeypatch.setattr(Kept, "solve_near", lambda *_: None)
    monkeypatch.setattr(Kept, "solve_to", lambda *_: False)
    _, found = cube(False, Settings(direct_up_to=10))
    assert found == pytest.approx(whole, abs=1e-10 * np.abs(whole).max())


def test_a_singular_tangent_is_told():
    """A body that nothing holds: no adjoint, and a sentence."""
    body = meshes.block(MPI.COMM_SELF, (1.0, 1.0), n=2)
    u, mu = forms.displacement(body), fem.Constant(body.mesh, 1.0)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), mu, 2.0)
    with pytest.raises(forms.NotConverged, match="is the state a limit point, or not in"):
        forms.gradient(forms.Problem(psi * ufl.dx, u), u[0] * ufl.dx, mu)
