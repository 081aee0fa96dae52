# SPDX-License-Identifier: MIT
"""Laws of contact with obstacles: uniform states, balance, Hertz; paths, sheets, ranks, restart."""

import json

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem
from scipy.optimize import brentq

from demos.benchmarks import hertz
from variform import forms, meshes
from variform.forms import contact, obstacles

MU, LMBDA, DHAT, K = 1.0, 2.0, 0.02, 1.5


def pressure_of(d):
    """-b'(d) of the barrier [Pa]."""
    y = d / DHAT
    return K * ((1 - y) ** 2 / y - 2 * (1 - y) * np.log(y)) if y < 1 else 0.0


def uniaxial(s, free):
    """Nominal stress along z at a stretch s; sideways free of stress, or held."""
    a = 1.0
    if free:
        a = brentq(lambda a: MU * (a - 1 / a) + LMBDA * np.log(a * a * s) / a, 0.5, 2, xtol=1e-15)
    return MU * (s - 1 / s) + LMBDA * np.log(a * a * s) / s


def block(kind, degree, cells):
    """A block that a plane presses from 1.05 to 0.75 of its height, on rollers."""
    dim = 3 if kind == "space" else 2
    body = meshes.block(MPI.COMM_SELF, (1.0,) * dim, n=2, cells=cells)
    w = forms.displacement(body, degree)
    if kind == "pressure":
        w = forms.displacement_pressure(body)
    u, t = w["u"], forms.load_factor(body)
    F = forms.axisymmetric(u) if kind == "revolution" else forms.deformation_gradient(u)
    psi = forms.energies.neo_hookean(F, MU, LMBDA)
    if kind == "pressure":  # the same energy: p stands for lmbda ln J / J, and J varies linearly
        J = ufl.det(F)
        psi = (
            forms.energies.neo_hookean(F, MU, 0.0) + w["p"] * ufl.ln(J) - w["p"] ** 2 / (2 * LMBDA)
        )
    if kind == "revolution":
        psi = psi * forms.circumference(u)
    point, normal = [0.0] * dim, [0.0] * dim
    point[-1], normal[-1] = 1.05 - 0.3 * t, -1.0
    tool = obstacles.plane(point, normal)
    wall = forms.obstacle(u, tool, body.ds("top"), dhat=DHAT, stiffness=K, name="tool")
    held = [
        forms.roller(w, body.facets("bottom"), dim - 1),
        forms.roller(w, body.facets("left"), 0),
    ]
    if dim == 3:
        held.append(forms.roller(w, body.facets("front"), 1))
    if kind in ("held", "pressure"):
        held.append(forms.roller(w, body.facets("right"), 0))
    return body, psi * ufl.dx + wall, w, held, t


@pytest.mark.parametrize(
    "kind, degree, cells",
    [
        ("space", 1, "hexahedron"),
        ("space", 2, "tetrahedron"),
        ("held", 1, "triangle"),
        ("held", 2, "quadrilateral"),
        ("pressure", 2, "triangle"),
        ("revolution", 1, "quadrilateral"),
    ],
)
def test_a_pressed_block_is_the_uniform_state(kind, degree, cells):
    """Stretch s of one equation, P(s) + p(0.75 - s) = 0: 1e-8; forces balance: 1e-10."""
    body, potential, w, held, t = block(kind, degree, cells)
    path = forms.follow(
        potential, w, held, t, rtol=1e-12, ctol=1e-10, progress=False,
        record={"tool": contact.recorder("tool")},
    )  # fmt: skip
    free = kind in ("space", "revolution")
    s = brentq(lambda s: uniaxial(s, free) + pressure_of(0.75 - s), 0.7301, 0.7499, xtol=1e-15)
    u = forms.displacement_of(w)
    top = [0.3, 0.4, 1.0] if kind == "space" else [0.3, 1.0]
    assert forms.at(u, top)[-1] == pytest.approx(s - 1, abs=1e-8)
    area = np.pi if kind == "revolution" else 1.0
    force = path.record("tool")[-1]
    assert np.delete(force, 0)[np.argmax(np.abs(np.delete(force, 0)))] == pytest.approx(
        area * pressure_of(0.75 - s), rel=1e-8
    )
    support, _ = forms.resultant(path.problem, body.facets("bottom"))
    up = 2 if kind == "space" else 1
    assert abs(support[up] - force[up]) < 1e-10 * force[up]
    p, g = contact.pressure(path, "tool"), contact.gap(path)
    assert forms.at(p, top)[0] == pytest.approx(pressure_of(0.75 - s), rel=1e-8)
    assert forms.at(g, top)[0] == pytest.approx(0.75 - s, abs=1e-8)
    assert forms.at(p, [0.5, 0.5, 0.2][: len(top)])[0] == 0
    closest = contact.clearance(path)
    assert closest.distance == pytest.approx(0.75 - s, abs=1e-8) and closest.obstacle == "tool"
    assert path.steps[-1].clearance == closest and path.completed
    # the tool's work is in the ledger: nothing is left over
    assert abs(path.ledger[-1].unaccounted or 0) < 2e-2 * path.problem.energy()


def test_a_gap_that_falls_is_a_tool_that_comes():
    """From 0.3 beyond the body, gap = 0.3 (1 - t) closes: the path of the moving plane, 1e-10."""
    ends = []
    for falls in (False, True):
        body = meshes.block(MPI.COMM_SELF, (1.0, 1.0), n=2, cells="quadrilateral")
        u, t = forms.displacement(body), forms.load_factor(body)
        psi = forms.energies.neo_hookean(forms.deformation_gradient(u), MU, LMBDA)
        plane = obstacles.plane((0, 0.75 if falls else 1.05 - 0.3 * t), (0, -1))
        gap = 0.3 * (1 - t) if falls else 0.0
        wall = forms.obstacle(u, plane, body.ds("top"), dhat=DHAT, stiffness=K, gap=gap)
        held = [forms.clamp(u, body.facets("bottom"))]
        path = forms.follow(psi * ufl.dx + wall, u, held, t, progress=False, rtol=1e-12, ctol=1e-10)
        ends.append(u.x.array.copy())
        assert path.completed and contact.force(path)[1] > 0.1
    assert ends[1] == pytest.approx(ends[0], abs=1e-10)


def over_hertz(kind, degree, per, reach):
    """Half-width and peak of the pressure over Hertz's, of a parabola on a plane."""
    path, body = hertz.parabola(kind, degree, per, reach)
    p = contact.pressure(path)
    a, peak = hertz.known(kind, -contact.force(path)[1])
    assert a / (hertz.A / per) > 0.9 * per
    return hertz.width(kind, p, body) / a, p.x.array.max() / peak


@pytest.mark.parametrize("kind", ["cylinder", "sphere"])
def test_hertz(kind):
    """Half-width by the second moment, and peak, within 1 % at a / h = 20, dhat = h / 10, Q1."""
    width, peak = over_hertz(kind, 1, 20, 0.1)
    assert width == pytest.approx(1, abs=0.01) and peak == pytest.approx(1, abs=0.01)
    assert abs(over_hertz(kind, 1, 10, 0.4)[0] - 1) > 2 * abs(width - 1)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["cylinder", "sphere"])
def test_hertz_of_degree_two(kind):
    """The same of Q2 on curved cells."""
    width, peak = over_hertz(kind, 2, 20, 0.1)
    assert width == pytest.approx(1, abs=0.01) and peak == pytest.approx(1, abs=0.01)


def arch(floor):
    """A flat arch, clamped at both ends, under its growing weight."""
    body = meshes.block(MPI.COMM_SELF, (2.0, 0.02), n=(24, 1), cells="quadrilateral")
    x = body.mesh.geometry.x
    x[:, 1] += 0.1 * (1 - (x[:, 0] - 1) ** 2)
    u, q = forms.displacement(body, degree=2), fem.Constant(body.mesh, 0.0)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 1.5)
    potential = psi * ufl.dx + forms.gravity(u, 1e-3 * q, g=1.0)
    if floor is not None:
        ground = obstacles.plane((0, floor), (0, 1))
        potential += forms.obstacle(u, ground, body.ds("bottom"), dhat=0.01, name="floor")
    return u, potential, [forms.clamp(u, body.facets(end)) for end in ("left", "right")], q


def test_an_arch_snaps_onto_a_floor():
    """Arc length: the path without a floor until it touches, then stable, the floor carries it."""
    crown = {"crown": lambda p: forms.at(p.u, (1.0, 0.1))[1]}
    u, potential, held, q = arch(None)
    free = forms.arc_length(potential, u, held, q, step=0.05, steps=5, record=crown, progress=False)
    u, potential, held, q = arch(-0.03)
    path = forms.arc_length(
        potential,
        u,
        held,
        q,
        step=0.05,
        steps=150,
        to=0.6,
        record={**crown, "floor": contact.recorder("floor")},
        progress=False,
    )
    loads = [step.load for step in path.steps]
    force = path.record("floor")[:, 1]
    first = int(np.argmax(force < 0))
    assert loads[:5] == pytest.approx([step.load for step in free.steps[:5]], rel=1e-8)
    peak = max(event.load for event in path.events if event.kind == "limit point")
    assert peak == pytest.approx(0.43, abs=2e-3) and min(loads[first - 3 : first]) < 0.25 * peak
    assert max(step.convergence.negative for step in path.steps[:first]) == 2
    assert path.steps[-1].convergence.negative == 0 and path.completed
    # At its crown it is on the floor, 0.1 + 0.03 below and up to dhat above
    assert path.record("crown")[-1] == pytest.approx(-0.125, abs=0.006)
    assert np.all(np.diff(-force[first:]) > 0)
    assert all(0 < step.clearance.distance <= 0.0301 for step in path.steps)
    weight = 1e-3 * 0.04 * 1.0
    assert 0.3 * weight < -force[-1] < weight


def test_a_balloon_in_a_box():
    """Volume prescribed: a ball of 1.2 fits; later each wall carries p times its flat part."""
    ball = meshes.spherical_sheet(MPI.COMM_SELF, 1.0, 0.25, 2, "octant")
    u, p = forms.displacement(ball, degree=2), fem.Constant(ball.mesh, 0.0)
    volume = forms.enclosed_volume(u)
    psi = forms.energies.neo_hookean_sheet(forms.membrane_gradient(u), mu=1.0)
    walls = obstacles.container((None, None, None), (1.3, 1.3, 1.3))
    box = forms.obstacle(u, walls, ufl.dx, name="box", dhat=0.02)
    held = [forms.roller(u, ball.facets(f"{axis}0"), "xyz".index(axis)) for axis in "xyz"]
    start = forms.integral(volume)
    x, dhat = ufl.SpatialCoordinate(ball.mesh) + u, 0.02
    up = forms.membranes.area_vector(forms.membrane_gradient(u))[2]

    def flat(share):
        """Area nearer to the wall than a share of dhat."""
        near = ufl.conditional(ufl.gt(x[2], 1.3 - share * dhat), up, 0.0)
        return lambda problem: abs(forms.integral(near * ufl.dx(degree=12)))

    record = {"box": contact.recorder(), "all": flat(1.0), "firm": flat(0.85)}
    path = forms.control(
        psi * ufl.dx - p * volume + box,
        u,
        held,
        p,
        volume,
        start * np.array([1.2**3, 2.4, 3.0, 3.4]),
        record=record,
        progress=False,
    )
    stretch = 1.2
    assert path.steps[0].load == pytest.approx(2 * (1 / stretch - stretch**-7), rel=1e-3)
    assert not np.any(path.record("box")[0])
    last = path.record("box")[-1]
    assert last == pytest.approx(last.mean(), rel=5e-3)  # the same on three walls, on one mesh
    # a sheet on the wall hands its pressure on, to some percent where it is near, less beside
    p = path.steps[-1].load
    assert 0.95 * p * path.record("firm")[-1] < last[2] < p * path.record("all")[-1]
    assert path.record("firm")[-1] > 0.6 * path.record("all")[-1]
    assert all(step.clearance.distance > 0 for step in path.steps)
    assert [step.convergence.negative for step in path.steps] == [0] * 4


def ball_scene(comm, n=4, lift=0.0):
    """A ball pressed into a block, or a block lifted towards the ball."""
    body = meshes.block(comm, (1.0, 1.0, 1.0), n=n)
    u, t = forms.displacement(body), forms.load_factor(body)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), MU, LMBDA)
    ball = obstacles.sphere((0.5, 0.5, 1.55 - 0.3 * t), 0.5)
    wall = forms.obstacle(u, ball, body.ds("top"), name="ball")
    potential = psi * ufl.dx + wall
    if lift:
        potential += forms.dead_traction(u, (0, 0, lift), body.ds("top"))
    return body, potential, u, [forms.clamp(u, body.facets("bottom"))], t


def test_solve_finds_contact_from_afar():
    """One solve, weight from rest, a beam that falls on a disk; the path's state: 1e-8."""
    ends = []
    for together in (True, False):
        body = meshes.block(MPI.COMM_SELF, (1.0, 0.1), n=(20, 2), cells="quadrilateral")
        u, t = forms.displacement(body), forms.load_factor(body, 1.0)
        psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 10.0, 20.0)
        pin = forms.obstacle(u, obstacles.sphere((0.8, -0.15), 0.02), body.ds("bottom"), dhat=5e-3)
        potential = psi * ufl.dx + forms.gravity(u, 0.1 * t, g=1.0) + pin
        held = [forms.clamp(u, body.facets("left"))]
        tight = {"rtol": 1e-11, "ctol": 1e-10}
        if together:
            path = forms.solve(potential, u, held, **tight)
        else:
            t.value = 0.0
            path = forms.follow(potential, u, held, t, progress=False, **tight)
        ends.append(u.x.array.copy())
        assert 0 < path.steps[-1].clearance.distance < 5e-3
        assert path.steps[-1].convergence.negative == 0
        weight, support = 0.01, forms.resultant(path.problem, body.facets("left"))[0]
        assert support - contact.force(path) == pytest.approx([0, weight, 0], abs=1e-10 * weight)
    assert np.abs(ends[1] - ends[0]).max() < 1e-8


def test_projected_tangents_and_multigrid_find_the_same_state():
    """Barriers are projected by facet, and kept by multigrid: 1e-7 of the body."""
    ends = []
    for how in ({}, {"projection": "always"}, {"settings": multigrid()}):
        _, potential, u, held, _ = ball_scene(MPI.COMM_SELF, lift=0.5)
        path = forms.solve(potential, u, held, rtol=1e-10, ctol=1e-9, **how)
        ends.append(u.x.array.copy())
        outcome = path.steps[-1].convergence
        assert path.steps[-1].clearance.distance > 0
        if "projection" in how:
            assert outcome.projected > 0
    assert outcome.linear_iterations > outcome.iterations  # by multigrid
    for values in ends[1:]:
        assert np.abs(values - ends[0]).max() < 1e-7


def multigrid():
    """Settings with multigrid at any size."""
    return forms.solving.settings.Settings(direct_up_to=0, factorized_up_to=0)


RANKS = """
import json
from mpi4py import MPI
import numpy as np
from variform import forms
from test_contact import ball_scene

body, potential, u, held, t = ball_scene(MPI.COMM_WORLD, n=3)
path = forms.follow(potential, u, held, t, 0.6, rtol=1e-11, ctol=1e-10, progress=False)
p, g = forms.contact.pressure(path), forms.contact.gap(path)
closest, support = forms.contact.clearance(path), forms.resultant(path, body.facets("bottom"))[0]
found = [
    *forms.contact.force(path, "ball"), *support, *forms.at(u, (0.5, 0.5, 1.0)),
    forms.integral(p * body.ds("top")), *forms.at(p, (0.5, 0.5, 1.0)),
    *forms.at(g, (0.5, 0.5, 1.0)),
    closest.distance, path.problem.energy(), len(path.steps),
    float(path.problem.forms.barriers.all[0].label.stiffness.value),
]
try:
    t.value = 1.6
    forms.solve(potential, u, held)
except ValueError as error:
    found.append(str(error).count("beyond the obstacle ball"))
if MPI.COMM_WORLD.rank == 0:
    print(json.dumps([float(x) for x in found]))
"""


def test_ranks_agree(run, root, tmp_path):
    """1, 2 and 3 ranks, some without a facet of the boundary: 1e-8; a refusal reaches all."""
    file = tmp_path / "script.py"
    file.write_text(RANKS)
    found = [json.loads(run(file, ranks=n).stdout.splitlines()[-1]) for n in (1, 2, 3)]
    for numbers in found:
        assert numbers == pytest.approx(found[0], rel=1e-8, abs=1e-8)
    assert found[0][-1] == 1 and found[0][2] > 0.1
    assert found[0][:3] == pytest.approx(found[0][3:6], rel=1e-9)


def test_a_path_with_contact_is_taken_up(tmp_path):
    """Broken off after contact has begun, a path goes on as the uninterrupted one: bit by bit."""
    ends, runs = [], []
    for stop in (None, 4):
        folder = tmp_path / str(stop)
        for _ in range(1 if stop is None else 2):
            _, potential, u, held, t = ball_scene(MPI.COMM_SELF)

            def breaks(path, stop=stop):
                if stop is not None and len(path.steps) == stop and path.resumed is None:
                    raise KeyboardInterrupt

            try:
                path = forms.follow(
                    potential, u, held, t, on_step=breaks, progress=False,
                    checkpoint=forms.Checkpoint(folder, every=1),
                )  # fmt: skip
            except KeyboardInterrupt:
                assert contact.force(forms.Problem(potential, u, held))[2] >= 0
        ends.append(u.x.array.copy())
        runs.append([(step.load, step.clearance) for step in path.steps])
    assert path.resumed is not None and path.resumed < 1
    assert np.array_equal(ends[0], ends[1]) and runs[0] == runs[1]


def test_what_contact_needs():
    """A path with an obstacle of that name, one sentence each."""
    _, potential, u, held, _ = ball_scene(MPI.COMM_SELF)
    problem = forms.Problem(potential, u, held)
    with pytest.raises(ValueError, match=r"has the contacts ball, got 'floor'"):
        contact.force(problem, "floor")
    with pytest.raises(ValueError, match=r"contact.gap needs a path or a problem, got Unknown"):
        contact.gap(u)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), MU, LMBDA)
    without = forms.Problem(psi * ufl.dx, u, held)
    with pytest.raises(ValueError, match=r"contact.pressure needs a problem with an obstacle"):
        contact.pressure(without)
    assert forms.solve(without).steps[0].clearance is None
