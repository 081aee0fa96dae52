# SPDX-License-Identifier: MIT
"""Paths through limit points and past bifurcations: arch, frame, column, against the literature."""

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest
import ufl
from cases import unit_mesh
from dolfinx import fem
from scipy.special import ellipk

from variform import forms, meshes
from variform.forms._dolfinx import geometry_dofmap


def strip(length, n, curve, plates, comm=MPI.COMM_SELF):
    """Thin strip of height 1 (times ``curve``'s normal) along a curve, stiff plates at its ends.

    ``curve(s, t)`` are the points at the arc length s and the offset t in [-1/2, 1/2]; ``plates``
    tells at which ends one more cell, a thousand times as stiff, keeps the face straight. Returns
    the body, the plates' and the cells' places along the curve.
    """
    cell = length / n
    low, high = (cell if end in plates else 0.0 for end in ("left", "right"))
    count = n + len(plates)
    body = meshes.block(comm, (length + low + high, 1.0), n=(count, 1), cells="quadrilateral")
    mesh = body.mesh
    s, t = mesh.geometry.x[:, 0] - low, mesh.geometry.x[:, 1] - 0.5
    middle = s[geometry_dofmap(mesh)].mean(axis=1)
    mesh.geometry.x[:, 0], mesh.geometry.x[:, 1] = curve(s, t)
    stiff = fem.Function(fem.functionspace(mesh, ("DG", 0)))
    stiff.x.array[:] = np.where((middle < 0) | (middle > length), 1e3, 1.0)
    return body, stiff, middle


def patch(body, cells):
    """Load of size 1 over cells: a piecewise constant with the integral 1."""
    spread = fem.Function(fem.functionspace(body.mesh, ("DG", 0)))
    spread.x.array[:] = cells
    spread.x.array[:] /= forms.integral(spread * ufl.dx)
    return spread


def node(u, point):
    """Number of the node at a point."""
    x = u.function_space.tabulate_dof_coordinates()[:, :2]
    return int(np.linalg.norm(x - point, axis=1).argmin())


def deviation(path, name, reference, scales):
    """Largest distance of reference points (load, u_x, u_y) from the path as a polyline."""
    ours = np.c_[[step.load for step in path.steps], path.record(name)]
    ours = np.r_[np.zeros((1, 3)), ours] / scales
    off = []
    for point in reference / scales:
        a, d = ours[:-1], np.diff(ours, axis=0)
        along = np.clip(((point - a) * d).sum(1) / (d * d).sum(1), 0, 1)
        off.append(np.linalg.norm(a + along[:, None] * d - point, axis=1).min())
    return max(off)


# Geometrically exact beams, from the reference solutions of the program fenics_arclength.
ARCH = np.array(
    [
        [374.12995920, -18.94465782, -22.57738040],
        [657.29504513, -48.10615329, -69.03037963],
        [899.33630820, -61.29194049, -114.09075532],
        [705.47498818, -64.66053690, -120.05461035],
        [325.80356944, -64.41785633, -119.85646569],
        [-13.93415375, -60.62936380, -118.41618563],
        [-69.45008306, -58.31892331, -120.11396222],
        [-2.07755514, -38.36371082, -148.26391087],
        [212.06686231, -2.69156193, -175.65961463],
        [607.36318682, 3.85920796, -194.49237978],
    ]
)


def test_a_circular_arch_of_215_degrees():
    """Clamped and hinged, loaded at its crown: limit load 899 (1.5 %), and the path behind it."""
    radius, span = 100.0, np.radians(215)
    n = 95

    def curve(s, t):
        angle = np.pi / 2 - span / 2 + s / radius
        return (radius + t) * np.cos(angle), (radius + t) * np.sin(angle)

    body, stiff, middle = strip(radius * span, n, curve, ("right",))
    u, q = forms.displacement(body, 2), fem.Constant(body.mesh, 0.0)
    F = forms.deformation_gradient(u)
    psi = stiff * forms.energies.saint_venant_kirchhoff(F, 0.6e7, 0.0)  # mu = E/2, nu = 0
    spread = patch(body, np.arange(n + 1) == np.abs(middle - radius * span / 2).argmin())
    potential = psi * ufl.dx + forms.body_force(u, ufl.as_vector([0 * q, -q * spread]))
    hinge = (radius * np.cos(np.pi / 2 + span / 2), radius * np.sin(np.pi / 2 + span / 2))
    held = [forms.clamp(u, body.facets("left")), forms.pin(u, hinge)]
    crown = node(u, (0, radius))
    path = forms.arc_length(
        potential,
        u,
        held,
        q,
        step=50,
        until=lambda system: abs(q.value) > 1000,
        record={"crown": lambda system: u.x.array[2 * crown : 2 * crown + 2].copy()},
        progress=False,
    )
    loads = np.array([step.load for step in path.steps])
    first = np.flatnonzero(np.diff(loads) < 0)[0]
    assert loads[first] == pytest.approx(899, rel=0.015)
    assert deviation(path, "crown", ARCH, (900, 100, 100)) < 0.02
    negative = [step.convergence.negative for step in path.steps]
    assert negative[first - 1] == 0 and negative[first + 1] == 1 and negative[-1] == 0
    assert "Unstable from load factor 90" in path.reason


# Lee's frame: the corner of two beams of length 120, height 2 and width 3, both far ends hinged.
LEE = np.array(
    [
        [0.50000000, 0.30058606, -3.70250148],
        [1.06454391, 2.24241106, -11.75471445],
        [1.76832705, 15.72620011, -37.72098340],
        [1.81010012, 36.61891158, -54.61684692],
        [1.29148261, 59.20680530, -60.87031387],
        [0.14271741, 78.43641050, -54.34826173],
        [-0.98066124, 89.88471321, -57.29721389],
        [-0.54929974, 94.38339452, -76.05674982],
        [1.64739908, 86.18117892, -92.28403192],
    ]
)


def test_lee_s_frame():
    """Loaded at 24 from its corner: over limit points of the load and of the displacement."""
    side, h, n = 120.0, 2.0, 120

    def curve(s, t):
        # A leg upwards, then one to the right; the cross-section at the corner is its diagonal.
        corner = np.isclose(s, side)
        x = np.where(s < side, -h * t, s - side)
        y = np.where(s < side, s, side + h * t)
        return np.where(corner, -h * t, x), np.where(corner, side + h * t, y)

    body, stiff, middle = strip(2 * side, n, curve, ("left", "right"))
    u, q = forms.displacement(body, 2), fem.Constant(body.mesh, 0.0)
    F = forms.deformation_gradient(u)
    psi = 3 * stiff * forms.energies.saint_venant_kirchhoff(F, 360.0, 0.0)
    spread = patch(body, np.abs(middle - side - 24) < 1.2 * 2 * side / n)
    potential = psi * ufl.dx + forms.body_force(u, ufl.as_vector([0 * q, -q * spread]))
    held = [forms.pin(u, (0, 0)), forms.pin(u, (side, side))]
    loaded = node(u, (24, side))
    path = forms.arc_length(
        potential,
        u,
        held,
        q,
        step=0.2,
        until=lambda system: q.value > 1.6 and u.x.array[2 * loaded + 1] < -90,
        record={"loaded": lambda system: u.x.array[2 * loaded : 2 * loaded + 2].copy()},
        progress=False,
    )
    loads = np.array([step.load for step in path.steps])
    first = np.flatnonzero(np.diff(loads) < 0)[0]
    assert loads[first] == pytest.approx(1.877, rel=0.015)
    # The frame's corner is a solid square of 2 x 2 where the beams' is a point.
    assert deviation(path, "loaded", LEE, (1.9, 95, 95)) < 0.03


def column(n=25, comm=MPI.COMM_SELF):
    """Cantilever of length 50 and height 1 under a dead axial end load, E = 1.2e7, nu = 0."""
    body = meshes.block(comm, (50.0, 1.0), n=(n, 1), cells="quadrilateral")
    u, q = forms.displacement(body, 2), fem.Constant(body.mesh, 0.0)
    psi = forms.energies.saint_venant_kirchhoff(forms.deformation_gradient(u), 0.6e7, 0.0)
    load = forms.dead_traction(u, ufl.as_vector([-q, 0 * q]), body.ds("right"))
    return body, u, q, psi * ufl.dx + load, [forms.clamp(u, body.facets("left"))]


EULER = np.pi**2 / 4 * 1e6 / 50**2  # pi^2 E I / (4 L^2)


def test_euler_s_column_and_the_elastica():
    """The critical load to 0.5 %, and on the bent branch P/Pcr = 1.15172 at 60 degrees to 1 %."""
    _, u, q, potential, held = column()
    path = forms.arc_length(potential, u, held, q, step=0.5 * EULER, to=0.9 * EULER, progress=False)
    lowest = []
    for load in (0.9, 1.1):
        q.value = load * EULER
        solved = forms.solve(potential, u, held)
        lowest.append(forms.lowest_modes(solved)[0][0])
        assert forms.negative_eigenvalues(solved) == (load > 1)
    # The lowest eigenvalue is linear in the load.
    critical = 0.9 * EULER + 0.2 * EULER * lowest[0] / (lowest[0] - lowest[1])
    assert critical == pytest.approx(EULER, rel=5e-3)
    mode = forms.lowest_modes(solved)[1][0]
    end = [node(u, (50, y)) for y in (0, 1)]

    def tip(system):
        x = u.x.array.reshape(-1, 2)
        across = x[end[1]] - x[end[0]] + [0, 1]
        return np.degrees(np.arctan2(abs(across[0]), across[1]))

    path = forms.arc_length(
        potential,
        u,
        held,
        q,
        step=1.0,
        along=mode,
        until=lambda system: tip(system) > 62,
        record={"tip": tip},
        progress=False,
    )
    loads = np.array([step.load for step in path.steps]) / EULER
    angles = path.record("tip")
    assert np.interp(60, angles, loads) == pytest.approx(1.15171962, rel=0.01)
    # Elastica: P/Pcr = (2 K(sin(a/2)) / pi)^2.
    exact = (2 / np.pi * ellipk(np.sin(np.radians(angles) / 2) ** 2)) ** 2
    assert loads[1:] == pytest.approx(exact[1:], rel=0.01)
    assert all(step.convergence.negative == 0 for step in path.steps[1:])


def test_the_imperfect_column_bends_by_itself():
    """A side load of a thousandth leads into the bent branch under load steps alone."""
    body, u, q, potential, held = column()
    side = forms.dead_traction(u, ufl.as_vector([0 * q, 1e-3 * EULER]), body.ds("right"))
    forms.follow(potential + side, u, held, q, 1.2 * EULER, progress=False)
    top = node(u, (50, 1))
    assert u.x.array[2 * top + 1] > 25


def test_steps_used_up_are_no_completed_path():
    """Neither `to` nor `until` is reached: said so; without either nothing more was asked."""
    _, u, q, potential, held = column(3)
    for end, completed in (({"to": 300.0}, False), ({"until": lambda _: False}, False), ({}, True)):
        u.x.array[:], q.value = 0, 0
        path = forms.arc_length(
            potential, u, held, q, step=1.0, steps=2, largest=1e-6, progress=False, **end
        )
        assert path.completed == completed and path.reason.startswith("2 steps taken")


def test_a_functional_that_nothing_moves_is_told():
    """At rest u^2 has no slope: the bordered system is singular, and no bare division by zero."""
    _, u, q, potential, held = column(3)
    with pytest.raises(forms.NotConverged, match="the bordered system is singular"):
        forms.control(potential, u, held, q, ufl.inner(u, u) * ufl.dx, [1.0], progress=False)


@pytest.mark.parametrize("to", [317.0, 0.1, 1 / 3, 123.456])
def test_an_exact_load_at_the_end(to):
    _, u, q, potential, held = column(5)
    path = forms.arc_length(potential, u, held, q, step=to / 30, to=to, progress=False)
    assert path.load == to and path.completed
    moved = u.x.array.copy()
    u.x.array[:] = 0
    forms.solve(potential, u, held)
    assert np.abs(u.x.array - moved).max() < 1e-8


def test_a_path_by_its_length_is_taken_up_again(tmp_path):
    """Bit for bit, as if it had not been interrupted; a completed one comes back at once."""

    def run(steps, folder):
        body, u, q, potential, held = column(6)
        side = forms.dead_traction(u, ufl.as_vector([0 * q, 1e-2 * EULER]), body.ds("right"))
        kept = forms.Checkpoint(folder, every=2) if folder else None
        path = forms.arc_length(
            potential + side, u, held, q, step=100.0, steps=steps, checkpoint=kept, progress=False
        )
        return path, u.x.array.copy()

    whole, end = run(11, None)
    run(5, tmp_path / "kept")
    path, found = run(11, tmp_path / "kept")
    assert path.resumed == whole.steps[4].load
    assert [s.load for s in path.steps] == [s.load for s in whole.steps]
    assert np.array_equal(found, end)
    path, found = run(11, tmp_path / "kept")
    assert path.completed and np.array_equal(found, end)


SCRIPT = """
import json, sys
sys.path.insert(0, {tests!r})
from mpi4py import MPI
from petsc4py import PETSc
from variform import forms
from test_paths import EULER, column
body, u, q, potential, held = column(20, MPI.COMM_WORLD)
side = forms.dead_traction(u, __import__("ufl").as_vector([0 * q, 1e-2 * EULER]), body.ds("right"))
path = forms.arc_length(potential + side, u, held, q, step=100.0, steps=12, rtol=1e-12,
                        ctol=1e-11, progress=False)
lowest = forms.lowest_modes(path, 2)[0]
counts = [step.convergence.negative for step in path.steps]
if MPI.COMM_WORLD.rank == 0:
    print(json.dumps([*(step.load for step in path.steps), *lowest, *counts]))
"""


def test_ranks_agree(parallel, root):
    """Loads of a path of fixed lengths, the lowest eigenvalues and the counts on 1, 2, 3 ranks."""
    script = SCRIPT.format(tests=str(root / "tests"))
    one, two, three = (parallel(script, ranks) for ranks in (1, 2, 3))
    assert two == pytest.approx(one, rel=1e-6) and three == pytest.approx(one, rel=1e-6)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"step": 0}, "step is the first change of q, a number but not 0, got 0"),
        ({"to": 0.0}, "to must be a load factor other than the present 0.0"),
        ({"steps": 0}, "steps at least 1, got 0.05 and 0"),
        ({"until": 3}, "until is a function of the problem, got int"),
        ({"q": 1.0}, "needs a scalar Constant q, got float"),
    ],
)
def test_bad_input_gets_one_sentence(change, message):
    _, u, q, potential, held = column(2)
    with pytest.raises(ValueError, match=message):
        q = change.pop("q", q)
        forms.arc_length(potential, u, held, q, **{"step": 1.0, "progress": False, **change})


@pytest.mark.parametrize(
    ("point", "axes", "message"),
    [
        ((0.3, 0.2), None, r"where the unknown has a node, got \[0.3, 0.2\]; the nearest node"),
        ((0.0,), None, r"a point of 2 finite coordinates, got \(0.0,\)"),
        (((0, 0), (0, 0.7)), None, r"where the unknown has a node, got \[0.0, 0.7\]; the nearest"),
        ("left", None, "a point of 2 finite coordinates, got left"),
        ((0.0, 0.0), (2,), r"axes between 0 and 1, got \[2\]"),
    ],
)
def test_a_pin_needs_a_node(point, axes, message):
    u = forms.displacement(unit_mesh(2, 2))
    with pytest.raises(ValueError, match=message):
        forms.pin(u, point, axes)


def shallow_arch(rise=4.0, n=20):
    """Clamped at both ends, a dead traction -q on its back; the crown's vertical unknown."""
    body, _, _ = strip(100.0, n, lambda s, t: (s, 2 * t + rise * np.sin(np.pi * s / 100)), ())
    u, q = forms.displacement(body, 2), fem.Constant(body.mesh, 0.0)
    F = forms.deformation_gradient(u)
    psi = forms.energies.saint_venant_kirchhoff(F, 0.5, 0.0)
    held = [forms.clamp(u, body.facets(end)) for end in ("left", "right")]
    load = forms.dead_traction(u, ufl.as_vector([0 * q, -q]), body.ds("top"))
    return u, q, psi * ufl.dx, load, held, 2 * node(u, (50, rise + 1)) + 1


def test_petsc_s_own_arc_length_finds_the_same_path():
    """SNES newtonal (dead loads, fixed steps) is on our path over both limit points, to 1 %."""
    u, q, inside, load, held, crown = shallow_arch()
    path = forms.arc_length(
        inside + load,
        u,
        held,
        q,
        step=1e-5,
        until=lambda system: u.x.array[crown] < -11,
        largest=0.004,
        record={"crown": lambda system: u.x.array[crown]},
        progress=False,
    )
    crowns, loads = path.record("crown"), np.array([step.load for step in path.steps])
    assert np.any(np.diff(loads) < 0) and np.all(np.diff(crowns) < 0)

    u.x.array[:], q.value = 0, 1
    system, whole = forms.Problem(inside, u, held), forms.Problem(inside + load, u, held)
    A, b, dead = system.create_matrix(), system.create_vector(), system.create_vector()
    whole.residual(dead)  # at rest all of it is the load's
    dead.scale(-1)
    dead.array[system.constrained] = 0
    unscaled, found = dead.copy(), []

    def residual(snes, x, f):
        u.x.array[:] = x.array_r
        system.residual(f)
        f.array[system.constrained] = 0

    def tangent(snes, x, A, P):
        u.x.array[:] = x.array_r
        system.tangent(A)

    def monitor(snes, iteration, norm):
        factor = snes.getRhs().dot(unscaled) / unscaled.dot(unscaled)
        found.append((snes.getSolution().array_r[crown], factor, norm / unscaled.norm()))

    options = {
        "snes_type": "newtonal",
        "snes_newtonal_step_size": 3.0,
        "snes_newtonal_psisq": 0,
        "snes_newtonal_lambda_min": -1,
        "snes_newtonal_lambda_max": loads[-1],
        "snes_rtol": 1e-9,
        "ksp_type": "preonly",
        "pc_type": "lu",
    }
    for key, value in options.items():
        PETSc.Options()["newtonal_" + key] = value
    snes = PETSc.SNES().create(MPI.COMM_SELF)
    snes.setOptionsPrefix("newtonal_")
    snes.setFunction(residual, b)
    snes.setJacobian(tangent, A)
    snes.setMonitor(monitor)
    snes.setFromOptions()
    snes.solve(dead, dead.duplicate())
    for key in options:
        PETSc.Options().delValue("newtonal_" + key)
    theirs = np.array([(x, factor) for x, factor, norm in found if norm < 1e-9 and x < 0])
    assert len(theirs) > 20 and np.ptp(np.sign(np.diff(theirs[:, 1]))) == 2
    inside_ours = theirs[:, 0] > crowns[-1]
    on_path = np.interp(-theirs[inside_ours, 0], -crowns, loads)
    assert np.abs(theirs[inside_ours, 1] - on_path).max() < 0.01 * loads.max()


def test_a_path_speaks_of_its_start():
    """Before the first step the load is where the path begins."""
    body = meshes.block(MPI.COMM_SELF, (1.0, 1.0), n=2)
    u, q = forms.displacement(body), forms.load_factor(body)
    q.value = 0.7
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0) * ufl.dx
    load = forms.dead_traction(u, ufl.as_vector([q, 0 * q]), body.ds("right"))
    held = [forms.clamp(u, body.facets("left"))]
    limit = {"snes_max_it": 1, "snes_rtol": 1e-14}
    for call in (forms.follow, forms.arc_length):
        how = {"to": 0.9} if call is forms.follow else {"to": 0.9, "step": 0.1}
        with pytest.raises(forms.NotConverged, match="^SNES stopped after 1 iterations") as failed:
            call(psi + load, u, held, q, options=limit, progress=False, **how)
        assert failed.value.path.load == 0.7 == q.value
