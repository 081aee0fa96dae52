# SPDX-License-Identifier: MIT
"""Failures and options: the last converged state is kept, and every message says what to do."""

from mpi4py import MPI

import basix.ufl
import numpy as np
import pytest
import ufl
from cases import at_plane, bending, unit_mesh, whole
from dolfinx import fem
from dolfinx import mesh as dmesh

from variform import forms, meshes
from variform.forms.solving.linear import presets as linear_presets
from variform.forms.solving.supported import free_motions


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
    energy = forms.Problem.energy
    monkeypatch.setattr(forms.Problem, "energy", lambda s: seen.append(energy(s)) or seen[-1])
    forms.solve(potential, u, supports, virtual_work=work)
    assert not np.all(np.isfinite(seen))
    stretch = (-3 + np.sqrt(13)) / 2  # mu (L - 1/L) = -3 mu
    assert forms.at(u, (1.0, 0.0))[0] == pytest.approx(stretch - 1, rel=1e-8)


@pytest.mark.parametrize(
    ("options", "looser"),
    [
        ({"snes_rtol": 1e-2}, True),
        ({"snes_atol": 1e3}, True),
        ({"snes_type": "newtontr"}, False),
        ({"snes_linesearch_type": "l2"}, False),
        ({"ksp_type": "gmres", "pc_type": "ilu", "ksp_rtol": 1e-10}, False),
    ],
)
def test_options_reach_petsc(options, looser):
    """PETSc's tolerances, globalizations and linear solvers are chosen by its own names."""
    plain, _ = bending()
    chosen, _ = bending(options=options, ctol=1.0 if looser else 1e-6)
    its = [sum(s.convergence.iterations for s in p.steps) for p in (plain, chosen)]
    assert (its[1] < its[0]) == looser
    distance = np.abs(plain.u.x.array - chosen.u.x.array).max()
    assert (distance > 1e-6) == looser


def test_options_end_with_their_solve():
    """A solve's options do not reach the next one with its prefix; misspelled ones are named."""
    with pytest.warns(UserWarning, match="did not use the options snes_typ: are they") as said:
        bending(options={"snes_typ": "newtontr"})
    assert [warning.filename for warning in said] == [bending.__code__.co_filename]
    with pytest.raises(forms.NotConverged):
        bending(options={"snes_max_it": 1}, min_step=0.09)
    path, _ = bending()
    assert max(s.convergence.iterations for s in path.steps) > 1


def test_an_absolute_tolerance_is_named():
    path, _ = bending(options={"snes_atol": 1e3}, ctol=1.0)
    assert path.steps[0].convergence.reason == "snes_atol = 1000 reached"


@pytest.mark.parametrize("linear", ["cholesky", "gamg"])
def test_linear_solvers_agree(linear):
    """Multigrid with rigid body modes and the factorization reach the same solution."""
    mesh = unit_mesh(3, 4)
    u = forms.displacement(mesh)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0) * ufl.dx
    supports = [
        forms.clamp(u, at_plane(mesh, 0, 0.0)),
        forms.translate(u, at_plane(mesh, 0, 1.0), (0.0, 0.3, 0.0)),
    ]
    options = linear_presets.multigrid() if linear == "gamg" else {}
    path = forms.solve(psi, u, supports, options=options, prefix=f"{linear}_", rtol=1e-12)
    ksp_its = path.steps[0].convergence.linear_iterations
    assert (ksp_its > path.steps[0].convergence.iterations) == (linear == "gamg")
    assert forms.at(u, (0.5, 0.5, 0.5)) == pytest.approx(MIDDLE, rel=1e-8, abs=1e-10)


@pytest.mark.parametrize("pc", ["cholesky", "jacobi", "gamg"])
def test_a_trust_region_reaches_the_same_state(pc):
    """SNES newtontr with Steihaug's conjugate gradients, by options alone."""
    mesh = unit_mesh(3, 4)
    u = forms.displacement(mesh)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0) * ufl.dx
    supports = [
        forms.clamp(u, at_plane(mesh, 0, 0.0)),
        forms.translate(u, at_plane(mesh, 0, 1.0), (0.0, 0.3, 0.0)),
    ]
    options = {"snes_type": "newtontr", "ksp_type": "stcg", "pc_type": pc, "snes_max_it": 100}
    path = forms.solve(psi, u, supports, options=options, prefix="trust_", rtol=1e-12)
    assert path.steps[0].convergence.negative is None
    assert forms.at(u, (0.5, 0.5, 0.5)) == pytest.approx(MIDDLE, rel=1e-8, abs=1e-9)


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


MIDDLE = [0.0, 0.15, 0.0]  # by the point symmetry of the sheared cube about its middle


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


def test_no_way_to_go_is_refused():
    mesh = unit_mesh(2)
    u, t = forms.displacement(mesh), forms.load_factor(mesh, 1.0)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0) * ufl.dx
    with pytest.raises(ValueError, match=r"the load factor is at 1.0 already: use solve"):
        forms.follow(psi, u, [], t, to=1.0, progress=False)


@pytest.mark.parametrize(("name", "value"), [("step", 0.0), ("min_step", -1.0), ("max_step", 0.0)])
def test_steps_that_are_not_positive_are_refused(name, value):
    mesh = unit_mesh(2)
    u, t = forms.displacement(mesh), forms.load_factor(mesh)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0) * ufl.dx
    with pytest.raises(ValueError, match=f"{name} = {value}"):
        forms.follow(psi, u, [], t, **{name: value}, progress=False)


def test_a_load_factor_that_nothing_depends_on_is_refused():
    mesh = unit_mesh(2)
    u, t = forms.displacement(mesh), forms.load_factor(mesh)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0) * ufl.dx
    fixed = forms.clamp(u, at_plane(mesh, 0, 0.0))
    with pytest.raises(ValueError, match="nothing depends on the load factor t"):
        forms.follow(psi, u, [fixed], t, progress=False)
    with pytest.raises(ValueError, match=r"load factor of forms.load_factor, got float"):
        forms.follow(psi, u, [fixed], 0.0, progress=False)


def test_supports_of_another_unknown_are_refused():
    """They would be ignored, or read beyond the unknown's end."""
    mesh = unit_mesh(2)
    u, other = forms.displacement(mesh), forms.displacement(mesh, 2)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0) * ufl.dx
    left = at_plane(mesh, 0, 0.0)
    for wrong in (forms.clamp(other, left), forms.clamp(forms.displacement(mesh), left)):
        with pytest.raises(ValueError, match="made for another unknown than displacement"):
            forms.solve(psi, u, [wrong])
    with pytest.raises(ValueError, match="what forms.clamp, .* got DirichletBC"):
        forms.solve(psi, u, forms.clamp(u, left).conditions)
    assert forms.solve(psi, u, forms.clamp(u, left)).completed  # one alone needs no list


def test_parts_of_a_mixed_unknown_are_refused():
    """w.split() gives functions that nothing is differentiated by."""
    mesh = unit_mesh(2)
    w = forms.displacement_pressure(mesh)
    F, (_, p) = forms.deformation_gradient(w.split()[0]), ufl.split(w)
    psi = forms.energies.with_pressure(forms.energies.isochoric_neo_hookean(F, 1.0), F, p, 1.0)
    with pytest.raises(ValueError, match="a part of w that is not differentiated"):
        forms.solve(psi * ufl.dx, w, [forms.clamp(w, at_plane(mesh, 0, 0.0))])
    with pytest.raises(ValueError, match="needs the unknown itself.* got Sum"):
        forms.solve(psi * ufl.dx, psi, [])


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


FREE = {
    "no support": ([], ["translation along x", "translation along y", "translation along z"], 3),
    "a roller": ([("x0", 0)], ["translation along y", "translation along z"], 1),
    "two rollers": ([("x0", 0), ("y0", 1)], ["translation along z"], 0),
    "three rollers": ([("x0", 0), ("y0", 1), ("z0", 2)], [], 0),
}


@pytest.mark.parametrize("mixed", [False, True])
@pytest.mark.parametrize("case", FREE)
def test_rigid_motions_that_nothing_holds_are_named(case, mixed):
    """Of a body, of a mixed unknown too; springs hold as supports do."""
    rollers, translations, rotations = FREE[case]
    mesh = unit_mesh(3, 2)
    u = forms.displacement_pressure(mesh) if mixed else forms.displacement(mesh)
    v, p = ufl.split(u) if mixed else (u, None)
    F = forms.deformation_gradient(v)
    psi = forms.energies.neo_hookean(F, 1.0, 0.0 if mixed else 2.0)
    psi = forms.energies.with_pressure(psi, F, p) if mixed else psi
    held = [forms.roller(u, at_plane(mesh, axis, 0.0), axis) for _, axis in rollers]
    found = free_motions(forms.Problem(psi * ufl.dx, u, held))
    assert [words for words in found if "translation" in words] == translations
    assert sum("rotation" in words for words in found) == rotations
    spring = forms.spring(v, 1e-3, ufl.ds(mesh))
    assert free_motions(forms.Problem(psi * ufl.dx + spring, u, held)) == []


def test_a_plane_body_on_a_pin_turns_about_it():
    mesh = unit_mesh(2, 2)
    u = forms.displacement(mesh)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0)
    system = forms.Problem(psi * ufl.dx, u, [forms.pin(u, (1, 0))])
    assert free_motions(system) == ["rotation about the axis along z through (1, 0, 0)"]


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


@pytest.mark.parametrize("n", [2, 8])
@pytest.mark.parametrize("energy", ["neo_hookean", "fixed_corotated"])
def test_a_body_without_any_support_is_told_apart(energy, n):
    """MUMPS fails and has to be started anew; the cause takes the place of other advice."""
    body = meshes.block(MPI.COMM_WORLD, (1.0, 0.25, 0.25), n=(n, 2, 2))
    u = forms.displacement(body)
    psi = getattr(forms.energies, energy)(forms.deformation_gradient(u), mu=1.0, lmbda=4.0)
    load = forms.body_force(u, ufl.as_vector([0.1, 0, 0]))
    with pytest.raises(forms.NotConverged) as failed:
        forms.solve(psi * ufl.dx + load, u, [])
    message = str(failed.value)
    assert (
        "kept. Nothing holds the body against translation along x, translation along y" in message
    )
    assert message.count("projected tangent") <= 1 and "Reach the load" not in message


def test_a_stable_mixed_state_has_no_negative_eigenvalue():
    """The one per pressure is left out; compressed, a column of it buckles."""
    mesh = unit_mesh(2, 4)
    w = forms.displacement_pressure(mesh)
    u, p = ufl.split(w)
    F = forms.deformation_gradient(u)
    psi = forms.energies.with_pressure(forms.energies.neo_hookean(F, 1.0, 0.0), F, p, 100.0)
    held = [
        forms.clamp(w, at_plane(mesh, 1, 0.0)),
        forms.translate(w, at_plane(mesh, 1, 1.0), (0, 0.2)),
    ]
    path = forms.solve(psi * ufl.dx, w, held)
    assert path.steps[0].convergence.negative == 0
    assert forms.negative_eigenvalues(path) == 0
    assert "Unstable" not in path.reason


SECOND_FIELDS = {
    "beside": lambda psi, a: psi + a**2 / 2 + ufl.inner(ufl.grad(a), ufl.grad(a)) / 20 - a / 10,
    "coupled": lambda psi, a: (1 - a) * psi + a**2 / 2,
}


@pytest.mark.parametrize("case", SECOND_FIELDS)
def test_a_second_field_that_is_minimized_over_counts_like_the_first(case):
    """A scalar with a positive definite block: no eigenvalue is left out, and none is negative."""
    body = meshes.block(MPI.COMM_WORLD, (1.0, 1.0), n=(4, 4))
    cell = body.mesh.basix_cell()
    fields = [basix.ufl.element("Lagrange", cell, 2, shape=(2,)), basix.ufl.element("P", cell, 1)]
    w = fem.Function(fem.functionspace(body.mesh, basix.ufl.mixed_element(fields)), name="w")
    u, a = ufl.split(w)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0)
    potential = SECOND_FIELDS[case](psi, a) * ufl.dx
    held = [
        forms.clamp(w, body.facets("left")),
        forms.translate(w, body.facets("right"), (0.1, 0)),
    ]
    path = forms.solve(potential, w, held)
    assert path.steps[0].convergence.negative == 0 == forms.negative_eigenvalues(path)
    assert "Unstable" not in path.reason


@pytest.mark.parametrize("is_pressure", [False, True])
def test_only_pressures_get_the_field_split(is_pressure, monkeypatch):
    """Above its size a displacement and a scalar: the split for a pressure, MUMPS for another."""
    monkeypatch.setattr(linear_presets, "SPLIT_FROM", {"tetrahedron": 0})
    mesh = unit_mesh(3, 2)
    w = fem.Function(forms.displacement_pressure(mesh).function_space)  # no role is declared
    u, a = ufl.split(w)
    F = forms.deformation_gradient(u)
    psi = forms.energies.neo_hookean(F, 1.0, 0.0 if is_pressure else 2.0)
    psi = forms.energies.with_pressure(psi, F, a) if is_pressure else psi + a**2 / 2
    held = [forms.clamp(w, at_plane(mesh, 0, 0.0))]
    newton = forms.solving.Newton(forms.Problem(psi * ufl.dx, w, held))
    kind = newton.snes.getKSP().getPC().getType()
    newton.destroy()
    assert kind == ("python" if is_pressure else "cholesky")


def test_three_fields_count_one_negative_eigenvalue_per_multiplier():
    """psi(J~) + p (J - J~): the pressures count, the volume ratios J~ do not."""
    body = meshes.block(MPI.COMM_WORLD, (1.0, 1.0), n=(3, 3))
    cell = body.mesh.basix_cell()
    volume = basix.ufl.element("DG", cell, 0)
    vector = basix.ufl.element("Lagrange", cell, 2, shape=(2,))
    mixed = basix.ufl.mixed_element([vector, volume, volume])
    w = fem.Function(fem.functionspace(body.mesh, mixed), name="w")
    w.sub(2).interpolate(lambda x: np.ones(x.shape[1]))
    u, p, Jt = ufl.split(w)
    F = forms.deformation_gradient(u)
    psi = forms.energies.isochoric_neo_hookean(F, 1.0) + 50 * (Jt - 1) ** 2
    held = [
        forms.clamp(w, body.facets("left")),
        forms.translate(w, body.facets("right"), (0.05, 0)),
    ]
    path = forms.solve((psi + p * (ufl.det(F) - Jt)) * ufl.dx, w, held)
    assert path.steps[0].convergence.negative == 0 == forms.negative_eigenvalues(path)


SLACK = {
    "max_value": lambda x: ufl.max_value(x, 0) ** 1.5,
    "scaled": lambda x: 2**1.5 * (ufl.max_value(0, x) / 2) ** 1.5,
    "conditional": lambda x: ufl.conditional(ufl.gt(x, 0), x, 0) ** 1.5,
    "conditional, >=": lambda x: ufl.conditional(ufl.ge(x, 0), x, 0) ** 1.5,
    "root": lambda x: ufl.sqrt(ufl.max_value(x, 0) ** 3),
    "|x|": lambda x: ((x + abs(x)) / 2) ** 1.5,
}


def fibered(power, n=2):
    """Unit cube between rollers, pressed along its fiber to 0.9; lateral faces free."""
    body = meshes.block(MPI.COMM_WORLD, (1.0, 1.0, 1.0), n=(n, n, n))
    u, t = forms.displacement(body), forms.load_factor(body)
    F = forms.deformation_gradient(u)
    I4, _ = forms.kinematics.fiber_invariants(F, ufl.as_vector([1, 0, 0]))
    psi = forms.energies.neo_hookean(F, 1.0, 10.0) + power(I4 - 1)
    sides = ("left", "front", "bottom")
    held = [forms.roller(u, body.facets(name), axis) for axis, name in enumerate(sides)]
    held.append(forms.translate(u, body.facets("right"), (-0.1 * t, None, None)))
    return body, psi * ufl.dx, u, held, t


@pytest.mark.parametrize("call", ["solve", "follow"])
@pytest.mark.parametrize("case", SLACK)
def test_a_slack_fiber_has_a_tangent(case, call):
    """Powers below 2 of what is 0 in compression, inf * 0 for UFL: the fiber is slack.

    The cube is that without one: mu (s^2 - 1) + lmbda ln(0.9 s^2) = 0, lateral stretch s.
    """
    body, potential, u, held, t = fibered(SLACK[case])
    if call == "solve":
        t.value = 1.0
        path = forms.solve(potential, u, held)
    else:
        path = forms.follow(potential, u, held, t, progress=False)
    s = 1 + forms.at(u, (1.0, 1.0, 1.0))[1]
    assert s == pytest.approx(1.0488326289, abs=1e-9)
    assert s**2 - 1 + 10 * np.log(0.9 * s**2) == pytest.approx(0, abs=1e-9)
    force, _ = forms.resultant(path, body.facets("right"))
    assert abs(force[0]) == pytest.approx(0.3222776482, abs=1e-9)


def test_branches_are_moved_out_of_powers_only_where_they_must():
    """Whole powers, exponentials and powers of other things stay what they are; values stay."""
    from variform.forms.differentiation import with_branches_outside

    mesh = unit_mesh(2)
    x = fem.Constant(mesh, 0.0)
    for kept in (ufl.max_value(x, 0) ** 2, ufl.exp(ufl.max_value(x, 0)), x**1.5, abs(x)):
        assert with_branches_outside(kept) == kept
    moved = [
        (ufl.max_value(2 * x, x / 3) ** 1.5, lambda v: max(2 * v, v / 3) ** 1.5 if v > 0 else None),
        (ufl.min_value(x, 1) ** 0.5, lambda v: min(v, 1) ** 0.5 if v > 0 else None),
        (ufl.sqrt(3 + abs(x)), lambda v: np.sqrt(3 + abs(v))),
        ((x + abs(x)) ** 1.5, lambda v: (v + abs(v)) ** 1.5),
        ((abs(x) - x) ** 1.5, lambda v: (abs(v) - v) ** 1.5),
        (ufl.conditional(ufl.lt(x, 0), 5, 1 + x) ** 1.5, lambda v: (5 if v < 0 else 1 + v) ** 1.5),
    ]
    for expression, right in moved:
        other = with_branches_outside(expression)
        assert isinstance(other, ufl.classes.Conditional)
        for value in (-2.0, -0.5, 0.0, 0.5, 2.0):
            wanted = right(value)
            if wanted is not None:
                assert other((), mapping={x: value}) == pytest.approx(wanted, rel=1e-15)


@pytest.mark.parametrize("call", ["solve", "follow", "arc_length", "negative_eigenvalues"])
def test_a_second_derivative_that_is_infinite_is_named(call):
    """|x|**1.5 at x = 0: the summand, the place, and what to do; nothing of PETSc's own."""
    body, potential, u, held, t = fibered(lambda x: abs(x) ** 1.5)
    place = r"\(0\.\d+, 0\.\d+, 0\.\d+\)"
    named = rf"the second derivative of the summand .*1\.5.* is not finite at {place}"
    with pytest.raises((forms.NotConverged, ValueError), match=named) as failed:
        if call == "solve":
            t.value = 1.0
            forms.solve(potential, u, held)
        elif call == "follow":
            forms.follow(potential, u, held, t, progress=False)
        elif call == "arc_length":
            load = forms.dead_traction(u, ufl.as_vector([t, 0, 0]), body.ds("right"))
            forms.arc_length(potential + load, u, held[:3], t, step=0.1, progress=False)
        else:
            forms.negative_eigenvalues(forms.Problem(potential, u, held))
    assert "Write the energy so that its second derivative exists there" in str(failed.value)
    assert "in steps" not in str(failed.value)
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
    assert path.refused == 0 and len(path.steps) == 6
    assert max(s.convergence.iterations for s in path.steps) <= 4
    assert forms.at(u, (0.5, 0.5, 0.0)) == pytest.approx([0.3, 0.2, 0.1], abs=1e-9)
