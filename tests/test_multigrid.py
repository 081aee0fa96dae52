# SPDX-License-Identifier: MIT
"""Laws of multigrid over the order and of the field split: exact, bounded, free of units."""

import sys

from mpi4py import MPI

import numpy as np
import pytest
import ufl

from variform import forms, meshes

# forms.solve is the function: the module of that name is found by its path.
presets = sys.modules["variform.forms.solving.linear.presets"]
CASES = {
    "P2": ("tetrahedron", None),
    "Q2": ("hexahedron", None),
    "P2-P1, nu = 0.49": ("tetrahedron", 50.0),
    "P2-P1, nu = 1/2": ("tetrahedron", np.inf),
    "Q2-Q1, nu = 0.4999": ("hexahedron", 5000.0),
    "Q2-Q1, nu = 1/2": ("hexahedron", np.inf),
}
SCENE = """
import json, sys
from mpi4py import MPI
from petsc4py import PETSc
import numpy as np, ufl
from dolfinx import fem
from variform import forms, meshes


def bent(cells, n, kappa, mu=1.0, length=1.0, contrast=1.0):
    "Block, clamped at one end and pulled sideways at the other; kappa: mixed (in units of mu)."
    body = meshes.block(MPI.COMM_WORLD, (2 * length, length, length), n=(2 * n, n, n), cells=cells)
    t = forms.load_factor(body)
    x = ufl.SpatialCoordinate(body.mesh)
    # Constants: other numbers are no other form, which would be compiled again.
    half, more, mu = (fem.Constant(body.mesh, c) for c in (length / 2, contrast * mu, mu))
    stiff = ufl.conditional(ufl.lt(x[1], half), more, mu)
    if kappa is None:
        w = u = forms.displacement(body, 2)
        psi = forms.energies.neo_hookean(forms.deformation_gradient(u), stiff, 1.5 * mu)
    else:
        w = forms.displacement_pressure(body)
        u, p = ufl.split(w)
        F = forms.deformation_gradient(u)
        bulk = None if kappa == np.inf else fem.Constant(body.mesh, kappa) * mu
        psi = forms.energies.isochoric_neo_hookean(F, stiff)
        psi = forms.energies.with_pressure(psi, F, p, bulk)
    load = forms.dead_traction(u, ufl.as_vector([0, 0.05 * mu * t, 0]), body.ds("right"))
    return body, w, t, psi * ufl.dx + load, [forms.clamp(w, body.facets("left"))]


def iterations(w, potential, held):
    "Of one tangent solve, for forces that vary from node to node."
    system = forms.Problem(potential, w, held)
    newton = forms.solving.Newton(system, options={"ksp_rtol": 1e-8})
    newton.tangent.scaled.measure()
    newton.tangent.assemble()
    ksp = newton.snes.getKSP()
    ksp.setOperators(newton.tangent.A)
    b = newton.runs.b.duplicate()
    V = w.function_space
    mixed = V.num_sub_spaces == 2
    nodes, numbers = V.sub(0).collapse() if mixed else (V, np.arange(b.getLocalSize()))
    x = nodes.tabulate_dof_coordinates()
    x = x / MPI.COMM_WORLD.allreduce(x.max(), MPI.MAX)
    values = np.stack([np.sin(40 * x @ [1, 2, 3] + i) for i in range(3)], axis=1).ravel()
    numbers = np.asarray(numbers).ravel()
    own = numbers < b.getLocalSize()
    b.array[numbers[own]] = values[: len(numbers)][own]
    b.array[system.constrained] = 0
    x = b.duplicate()
    ksp.solve(b, x)
    assert ksp.getConvergedReason() > 0
    newton.destroy()
    return ksp.getPC().getType(), ksp.getIterationNumber()
"""
NAMES = {}
exec(compile(SCENE, __file__, "exec"), NAMES)
bent, iterations = NAMES["bent"], NAMES["iterations"]


def iterative_from(monkeypatch, size):
    """The presets of large problems from a size on."""
    monkeypatch.setattr(presets, "DIRECT_UP_TO", size)
    monkeypatch.setattr(presets, "SPLIT_FROM", dict.fromkeys(presets.SPLIT_FROM, size))


@pytest.fixture
def iterative(monkeypatch):
    """The presets of large problems at any size."""
    iterative_from(monkeypatch, 0)


@pytest.mark.parametrize("case", CASES)
def test_the_solution_is_the_factorization_s(case, monkeypatch):
    """Iterative and direct linear solves end in the same state."""
    states = []
    for up_to in (10**9, 0):
        iterative_from(monkeypatch, up_to)
        _, w, t, potential, held = bent(CASES[case][0], 2, CASES[case][1])
        path = forms.follow(potential, w, held, t, step=0.5, rtol=1e-11, progress=False)
        states.append(w.x.array.copy())
        counts = [(s.convergence.iterations, s.convergence.linear_iterations) for s in path.steps]
        assert all(linear > 3 * newton for newton, linear in counts) == (up_to == 0)
    assert np.abs(states[0]).max() > 0.2
    assert np.abs(states[1] - states[0]).max() <= 1e-8 * np.abs(states[0]).max()


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("state", ["rest", "bent"])
def test_iterations_are_bounded_under_refinement(case, state, iterative):
    """Half the cell size takes at most half as many iterations more, at rest and under load."""
    counts = []
    for n in (2, 4):
        _, w, t, potential, held = bent(CASES[case][0], n, CASES[case][1])
        if state == "bent":
            forms.follow(potential, w, held, t, step=0.5, progress=False)
        kind, count = iterations(w, potential, held)
        assert kind == ("mg" if CASES[case][1] is None else "python")
        counts.append(count)
    assert counts[1] <= 1.5 * counts[0] and counts[1] < 60


@pytest.mark.parametrize("cells", ["tetrahedron", "hexahedron"])
def test_units_and_contrast_do_not_matter_to_the_field_split(cells, iterative):
    """Pa and mm: the same iterations; half the body 100 times as stiff: at most half more."""
    changes = {}, {"mu": 3e5, "length": 1e3}, {"contrast": 100.0}
    counts = []
    for change in changes:
        _, w, _, potential, held = bent(cells, 4, np.inf, **change)
        counts.append(iterations(w, potential, held)[1])
    reference, scaled, contrast = counts
    assert abs(scaled - reference) <= 1
    assert contrast <= 1.5 * reference


@pytest.mark.slow
@pytest.mark.parametrize("cells", ["tetrahedron", "hexahedron"])
def test_the_field_split_on_two_ranks(cells, parallel):
    """The same state, and iterations within a fifth of those on one rank, and two."""
    script = (
        SCENE
        + """
linear = sys.modules["variform.forms.solving.linear.presets"]
linear.DIRECT_UP_TO = 0
linear.SPLIT_FROM = dict.fromkeys(linear.SPLIT_FROM, 0)
body, w, t, potential, held = bent(sys.argv[1], 3, np.inf)
forms.follow(potential, w, held, t, step=0.5, rtol=1e-11, progress=False)
kind, count = iterations(w, potential, held)
top = forms.at(forms.displacement_of(w), (2, 1, 1))
if MPI.COMM_WORLD.rank == 0:
    print(json.dumps([kind, count, list(map(float, top))]))
"""
    )
    one, two = (parallel(script, ranks, cells) for ranks in (1, 2))
    assert one[0] == two[0] == "python"
    assert two[1] <= 1.2 * one[1] + 2
    assert two[2] == pytest.approx(one[2], abs=1e-9)


def test_a_field_split_that_fails_gives_way_to_the_factorization(monkeypatch):
    """GMRES stopped after one iteration: MUMPS goes on, and stays for the next load."""
    _, w, t, potential, held = bent("tetrahedron", 2, np.inf)
    forms.follow(potential, w, held, t, step=0.5, rtol=1e-11, progress=False)
    wanted = w.x.array.copy()
    w.x.array[:], t.value = 0, 0.0
    failing = {**presets.field_split(), "ksp_max_it": "1", "ksp_rtol": "1e-12"}
    monkeypatch.setattr(presets, "preset", lambda *given: failing)
    path = forms.follow(potential, w, held, t, step=0.5, rtol=1e-11, progress=False)
    assert w.x.array == pytest.approx(wanted, abs=1e-9)
    last = path.steps[-1].convergence
    assert last.linear_iterations == last.iterations and last.negative == 0


def test_the_field_split_is_for_large_symmetric_bodies_in_space(monkeypatch):
    """Not for small ones, plane ones, nor those with a load that has no potential."""

    def kind(cells="tetrahedron", work=False):
        body, w, t, potential, held = bent(cells, 2, np.inf)
        v = ufl.split(ufl.TestFunction(w.function_space))[0]
        load = None
        if work:
            load = forms.follower_pressure(ufl.split(w)[0], 0.01 * t, v, body.ds("right"))
        return presets.preset(forms.Problem(potential, w, held, load))["pc_type"]

    assert kind() == "cholesky"
    iterative_from(monkeypatch, 100)
    assert kind() == kind("hexahedron") == "python" and kind(work=True) == "lu"
    body = meshes.cook(MPI.COMM_WORLD, n=8)
    w = forms.displacement_pressure(body)
    u, p = ufl.split(w)
    F = forms.deformation_gradient(u)
    psi = forms.energies.with_pressure(forms.energies.isochoric_neo_hookean(F, 1.0), F, p)
    plane = forms.Problem(psi * ufl.dx, w, [forms.clamp(w, body.facets("left"))])
    assert plane.size > 100 and presets.preset(plane)["pc_type"] == "cholesky"


def test_multigrid_that_fails_while_supports_are_carried_gives_way_too(monkeypatch):
    """The first solve of a step with a moved support: MUMPS solves it again, alike."""
    body = meshes.block(MPI.COMM_WORLD, (1.0, 0.5, 0.5), n=(4, 2, 2))
    states = []
    for options in (presets.direct(True), {**presets.multigrid(2), "ksp_max_it": "1"}):
        monkeypatch.setattr(presets, "preset", lambda *given, options=options: options)
        u, t = forms.displacement(body, 2), forms.load_factor(body)
        psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 1.5) * ufl.dx
        held = [forms.clamp(u, body.facets("left"))]
        held += [forms.translate(u, body.facets("right"), (0.2 * t, 0, 0))]
        forms.follow(psi, u, held, t, step=0.5, rtol=1e-11, progress=False)
        states.append(u.x.array.copy())
    assert states[1] == pytest.approx(states[0], abs=1e-9)
