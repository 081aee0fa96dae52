# SPDX-License-Identifier: MIT
"""Failures and interrupts keep the last converged state; what is undefined is named."""

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from cases import at_plane, bending, unit_mesh, whole
from dolfinx import fem
from dolfinx import mesh as dmesh

from variform import forms, meshes
from variform.forms.solving.linear import presets as linear_presets


def test_a_failed_path_keeps_the_last_converged_state():
    """A load that no step can follow: u and t hold the last converged state, the path its steps."""
    mesh = unit_mesh(2, 2)
    u, t = forms.displacement(mesh), forms.load_factor(mesh)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0) * ufl.dx
    # The wall would pass through the other one at t = 1: det F = 0 there.
    supports = [
        forms.clamp(u, at_plane(mesh, 0, 0.0)),
        forms.translate(u, at_plane(mesh, 0, 1.0), (-2 * t, 0.0)),
    ]
    states = []
    with pytest.raises(
        forms.NotConverged, match=r"SNES stopped after \d+ .* load factor 0\.4"
    ) as e:
        forms.follow(
            psi,
            u,
            supports,
            t,
            min_step=0.01,
            progress=False,
            on_step=lambda path: states.append((path.load, u.x.array.copy())),
        )
    assert "last converged state is kept" in str(e.value)
    assert float(t.value) == e.value.path.load == states[-1][0] < 0.5
    assert np.array_equal(u.x.array, states[-1][1])
    assert not e.value.path.completed and e.value.path.refused > 0
    assert e.value.path.reason == str(e.value)


def test_a_failed_solve_gives_the_old_state_back():
    mesh = unit_mesh(2, 2)
    u = forms.displacement(mesh)
    u.x.array[:] = 0.001
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0) * ufl.dx
    support = forms.translate(u, at_plane(mesh, 0, 1.0), (0.5, 0.5))
    supports = [forms.clamp(u, at_plane(mesh, 0, 0.0)), support]
    with pytest.raises(
        forms.NotConverged, match="Reach the load in steps with forms.follow; -mine_"
    ):
        forms.solve(psi, u, supports, options={"snes_max_it": 1}, prefix="mine_")
    assert np.all(u.x.array == 0.001)


def test_a_start_off_its_supports_by_rounding_is_no_jump():
    """1e-14 off, the solve goes through the line search as it does from the supports exactly."""
    mesh = unit_mesh(2, 2)
    u = forms.displacement(mesh)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0) * ufl.dx
    supports = [forms.clamp(u, at_plane(mesh, 0, 0.0))]
    load = forms.dead_traction(u, ufl.as_vector((-0.6, 0.2)), right_edge(mesh))
    iterations = []
    for start in (0.0, 1e-14):
        u.x.array[:] = start
        path = forms.solve(psi + load, u, supports)
        iterations.append(path.steps[0].convergence.residuals[0])
    assert iterations[1] == pytest.approx(iterations[0], rel=1e-6)


def right_edge(mesh):
    """Measure of the edge x = 1."""
    facets = at_plane(mesh, 0, 1.0)
    tags = dmesh.meshtags(mesh, 1, np.sort(facets), np.full(len(facets), 1, np.int32))
    return ufl.Measure("ds", domain=mesh, subdomain_data=tags)(1)


@pytest.mark.parametrize("mode", ["energy", "residual"])
def test_states_without_a_finite_energy_are_refused(mode):
    """Inside out, the residual mu (F - F^-T) is finite but the energy is not: no solution."""
    mesh = unit_mesh(2, 1)
    u = forms.displacement(mesh)
    u.interpolate(lambda x: (-2 * x[0], 0 * x[1]))
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 0.0) * ufl.dx
    v = ufl.TestFunction(u.function_space)
    work = forms.follower_pressure(u, 1e-3, v, ufl.ds(mesh)) if mode == "residual" else None
    support = forms.prescribe(u, whole(mesh), [-2 * ufl.SpatialCoordinate(mesh)[0], 0.0])
    with pytest.raises(forms.NotConverged, match=r"0 iterations \(the energy is not finite"):
        forms.solve(psi, u, [support], virtual_work=work)


@pytest.mark.parametrize("mode", ["energy", "residual"])
def test_the_search_refuses_such_states_on_its_way(mode, monkeypatch):
    """A traction of -3 mu: the first full step is to a stretch of -1/2, the solution at 0.303."""
    mesh = unit_mesh(2, 2)
    u = forms.displacement(mesh)
    potential = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 0.0) * ufl.dx
    supports = [forms.roller(u, at_plane(mesh, axis, 0.0), axis) for axis in range(2)]
    load = forms.dead_traction(u, (-3.0, 0.0), right_edge(mesh))
    work = None
    if mode == "energy":
        potential = potential + load
    else:
        work = forms.residual(load, u)
    seen = []

    def watched(function):
        return lambda *given: seen.append(function(*given)) or seen[-1]

    for name in "energy", "energy_and_residual":
        monkeypatch.setattr(forms.Problem, name, watched(getattr(forms.Problem, name)))
    forms.solve(potential, u, supports, virtual_work=work)
    assert not np.all(np.isfinite(seen))
    stretch = (-3 + np.sqrt(13)) / 2  # mu (L - 1/L) = -3 mu
    assert forms.at(u, (1.0, 0.0))[0] == pytest.approx(stretch - 1, rel=1e-8)


@pytest.mark.parametrize(
    ("start", "value", "message"),
    [
        (0.0, np.nan, "at the start: a Constant in the potential is nan or infinite"),
        (-2.0, 1.0, "at the start: cells are inverted there, or a parameter is out of its range"),
        (np.nan, 1.0, "at the start: the unknown holds nan or infinite"),
    ],
)
def test_an_undefined_start_is_explained(start, value, message):
    mesh = unit_mesh(2, 2)
    u, mu = forms.displacement(mesh), fem.Constant(mesh, value)
    u.interpolate(lambda x: (start * x[0], 0 * x[1]))
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), mu, 1.0)
    with pytest.raises(forms.NotConverged, match=message):
        forms.solve(psi * ufl.dx, u, [forms.clamp(u, at_plane(mesh, 0, 0.0))])


def test_an_interrupted_path_leaves_the_last_converged_state():
    """An exception in the middle (here from on_step) leaves u and t at the last converged load."""
    mesh = unit_mesh(2, 2)
    u, t = forms.displacement(mesh), forms.load_factor(mesh)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0) * ufl.dx
    supports = [
        forms.clamp(u, at_plane(mesh, 0, 0.0)),
        forms.translate(u, at_plane(mesh, 0, 1.0), (0.3 * t, 0.0)),
    ]

    def interrupt(path):
        if len(path.steps) == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        forms.follow(psi, u, supports, t, on_step=interrupt, progress=False)
    assert 0.3 <= float(t.value) < 1
    assert forms.at(u, (1.0, 0.5)) == pytest.approx([0.3 * float(t.value), 0], abs=1e-14)


@pytest.mark.parametrize("start", ["rest", "near"])
def test_multigrid_that_fails_gives_way_to_the_factorization(start, monkeypatch):
    """CG stopped after one iteration: MUMPS goes on, whether energy or |R| was being lowered."""
    mesh = unit_mesh(3, 2)
    u = forms.displacement(mesh)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0) * ufl.dx
    left, right = at_plane(mesh, 0, 0.0), at_plane(mesh, 0, 1.0)
    supports = [forms.clamp(u, left), forms.translate(u, right, (0.0, 0.3, 0.0))]
    forms.solve(psi, u, supports)
    potential = psi + forms.body_force(u, (0, 0, 1e-5))
    solved = u.x.array.copy()
    forms.solve(potential, u, supports, rtol=1e-12)
    wanted = u.x.array.copy()
    u.x.array[:] = solved if start == "near" else 0
    failing = {**linear_presets.multigrid(), "ksp_max_it": "1", "ksp_rtol": "1e-12"}
    monkeypatch.setattr(linear_presets, "preset", lambda system, A: failing)
    forms.solve(potential, u, supports, rtol=1e-12)
    assert u.x.array == pytest.approx(wanted, abs=1e-11)
    assert np.abs(wanted - solved).max() > 1e-7


def test_a_solve_that_is_interrupted_gives_the_old_state_back(monkeypatch):
    """Ctrl-C in the middle of Newton's method: u has its old values."""
    mesh = unit_mesh(2, 2)
    u = forms.displacement(mesh)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0) * ufl.dx
    right = forms.translate(u, at_plane(mesh, 0, 1.0), (0.3, 0.3))

    def interrupt(newton):
        raise KeyboardInterrupt

    monkeypatch.setattr(forms.solving.Newton, "solve", interrupt)
    with pytest.raises(KeyboardInterrupt):
        forms.solve(psi, u, [forms.clamp(u, at_plane(mesh, 0, 0.0)), right])
    assert np.all(u.x.array == 0)


def test_a_record_that_fails_loses_no_converged_step():
    """An exception in a record leaves u and t at the step that has just converged."""
    mesh = unit_mesh(2)
    u, t = forms.displacement(mesh), forms.load_factor(mesh)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0) * ufl.dx
    supports = [forms.prescribe(u, whole(mesh), (t * ufl.SpatialCoordinate(mesh)[0], 0.0))]

    def broken(system):
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        forms.follow(psi, u, supports, t, step=0.5, record={"x": broken}, progress=False)
    assert float(t.value) == 0.5
    assert forms.at(u, (1, 1)) == pytest.approx([0.5, 0])


def test_virtual_work_beside_measures_without_names():
    """A named measure in the virtual work beside ufl.ds in the potential: one residual of both."""
    mesh = unit_mesh(2, 2)
    u = forms.displacement(mesh)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0) * ufl.dx
    facets = at_plane(mesh, 0, 1.0)
    tags = dmesh.meshtags(mesh, 1, np.sort(facets), np.full(len(facets), 1, np.int32))
    right = ufl.Measure("ds", domain=mesh, subdomain_data=tags)(1)
    work = forms.follower_pressure(u, 0.1, ufl.TestFunction(u.function_space), right)
    fixed = forms.clamp(u, at_plane(mesh, 0, 0.0))
    path = forms.solve(psi + forms.spring(u, 1e-3, ufl.ds), u, [fixed], virtual_work=work)
    assert path.completed and forms.at(u, (1.0, 0.5))[0] < -0.01
    with pytest.raises(ValueError, match="linear in one test function, got one with no form"):
        forms.solve(psi, u, [fixed], virtual_work=u[0])


def test_a_failed_solve_names_the_missing_support():
    mesh = unit_mesh(2, 2)
    u = forms.displacement(mesh)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0)
    load = forms.dead_traction(u, ufl.as_vector((0.0, -0.1)), right_edge(mesh))
    held = [forms.roller(u, at_plane(mesh, 0, 0.0), 0)]
    with pytest.raises(
        forms.NotConverged, match="Nothing holds the body against translation along y: add a supp"
    ):
        forms.solve(psi * ufl.dx + load, u, held)
    assert np.all(u.x.array == 0)


def test_what_petsc_raises_is_a_sentence():
    """Options that PETSc does not know, and a linear solver told to raise."""
    with pytest.raises(ValueError, match=r"PETSc refused its options, .*error 86: .* PC type gmag"):
        bending(options={"pc_type": "gmag"})
    options = {"ksp_type": "cg", "pc_type": "none", "ksp_max_it": 2}
    raising = {**options, "ksp_error_if_not_converged": None}
    with pytest.raises(forms.NotConverged, match="linear solver failed|PETSc's error"):
        bending(options=raising, min_step=0.09)
    path, _ = bending()  # and nothing is left of it
    assert path.completed


@pytest.mark.parametrize("degree", [1, 2])
def test_stiff_springs_set_the_rounding_floor(degree):
    """K = 1e9 between a body and a place that moves: eps k u is what a force can be known to."""
    body = meshes.block(MPI.COMM_WORLD, (1.0, 1.0, 1.0), n=(2, 2, 2))
    t, u = forms.load_factor(body), forms.displacement(body, degree)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 10.0)
    moved = ufl.as_vector([0.3, 0.2, 0.1])
    spring = forms.spring(u - t * moved, 1e9, body.ds("bottom"))
    held = [forms.translate(u, body.facets("top"), (0.3 * t, 0.1 * t, 0.2 * t))]
    path = forms.follow(psi * ufl.dx + spring, u, held, t, progress=False)
    assert path.refused == 0 and len(path.steps) <= 6
    assert max(s.convergence.iterations for s in path.steps) <= 4
    assert forms.at(u, (0.5, 0.5, 0.0)) == pytest.approx([0.3, 0.2, 0.1], abs=1e-9)
