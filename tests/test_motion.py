# SPDX-License-Identifier: MIT
"""Bodies in motion: orders in time, momenta, the joules of each step, supports, viscosity."""

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem

from variform import forms, meshes
from variform.forms import dissipation
from variform.forms.solving.controls.time import TimeSteps

ETA = 0.3
SCHEMES = [("euler", 1), ("bdf2", 2), ("newmark", 2), ("midpoint", 2)]


def flow(t, dim=2):
    """A homogeneous motion that turns by radians and stretches by halves, F(t), as UFL."""
    a, s = 1.2 * ufl.sin(1.5 * t), 0.3 * ufl.sin(2 * t)
    Q = ufl.as_matrix([[ufl.cos(a), -ufl.sin(a)], [ufl.sin(a), ufl.cos(a)]])
    return Q * ufl.as_matrix([[1 + s, 0.2 * s], [0.2 * s, 1 - s / 2]])


def manufactured(viscous):
    """A square that body forces and tractions lead through that motion, held on one side by it."""
    body = meshes.block(MPI.COMM_SELF, (1.0, 1.0), h=0.5)
    t, u = forms.load_factor(body), forms.displacement(body)
    X, n, time = ufl.SpatialCoordinate(body.mesh), ufl.FacetNormal(body.mesh), ufl.variable(t)
    A = flow(time)
    rate = ufl.diff(A, time)
    G = ufl.variable(ufl.as_matrix([[A[0, 0], A[0, 1], 0], [A[1, 0], A[1, 1], 0], [0, 0, 1]]))
    P = ufl.diff(forms.energies.neo_hookean(G, 1.0, 2.0), G)
    P = ufl.as_matrix([[P[i, j] for j in range(2)] for i in range(2)])
    if viscous:
        P += A * (2 * ETA) * ufl.sym(A.T * rate)
    there = (A - ufl.Identity(2)) * X
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0) * ufl.dx
    psi += forms.body_force(u, 0.7 * ufl.diff(rate, time) * X)
    psi += forms.dead_traction(u, P * n, ufl.ds)
    left = forms.translate(u, body.facets("left"), [there[0], there[1]])
    return psi, u, [left], t, there, rate * X


def left_over(scene, dt, **options):
    """Errors of u and v at nodes at the end of a motion by steps of dt."""
    psi, u, supports, t, there, speed = scene
    V = u.function_space
    exact = [fem.Function(V), fem.Function(V)]
    points = V.element.interpolation_points()
    made = [fem.Expression(e, points) for e in (there, speed)]
    t.value = 0.3
    for function, expression in zip(exact, made, strict=True):
        function.interpolate(expression)
    u.x.array[:] = exact[0].x.array
    options |= {"dt": dt, "rtol": 1e-11, "progress": False, "rho": 0.7}
    path = forms.transient(psi, u, supports, t, to=1.3, velocity=exact[1], **options)
    for function, expression in zip(exact, made, strict=True):
        function.interpolate(expression)
    errors = [
        np.linalg.norm(f.x.array - e.x.array)
        for f, e in zip((path.u, path.velocity), exact, strict=True)
    ]
    return errors, path


@pytest.mark.parametrize("viscous", [False, True], ids=["elastic", "viscous"])
@pytest.mark.parametrize(("scheme", "order"), SCHEMES)
def test_errors_fall_with_the_order_of_the_scheme(scheme, order, viscous):
    """Displacements and velocities of a manufactured large motion; so does what is unaccounted."""
    scene = manufactured(viscous)
    options = {"scheme": scheme}
    if viscous:
        options["dissipation"] = dissipation.kelvin_voigt(ETA)
    runs = [left_over(scene, dt, **options) for dt in (1 / 60, 1 / 120, 1 / 240)]
    errors = np.array([run[0] for run in runs])
    rates = np.log2(errors[:-1] / errors[1:])
    assert np.all(np.abs(rates[-1] - order) < 0.1), (errors, rates)
    missed = [run[1].ledger.missed / run[1].ledger.exchanged for run in runs]
    if scheme != "euler":
        assert 3.5 < missed[-2] / missed[-1] < 4.5 and missed[-1] < 1e-3
    else:
        assert missed[-1] < 1e-8


def spun(scheme, steps, dt=0.02, **options):
    """A soft block thrown spinning, held by nothing."""
    body = meshes.block(MPI.COMM_SELF, (1.0, 0.4, 0.2), n=(4, 2, 1))
    t, u = forms.load_factor(body), forms.displacement(body)
    psi = forms.energies.fixed_corotated(forms.deformation_gradient(u), 10.0, 20.0) * ufl.dx
    X = ufl.SpatialCoordinate(body.mesh)
    spin = ufl.cross(ufl.as_vector([0.3, 0.5, 2.0]), X - ufl.as_vector([0.5, 0.2, 0.1]))
    options |= {"rho": 1.0, "dt": dt, "progress": False, "scheme": scheme}
    options |= {"velocity": ufl.as_vector([1.0, 0.2, 0.1]) + spin}
    return forms.transient(psi, u, (), t, to=steps * dt, **options)


def test_the_midpoint_rule_keeps_momenta_and_bounds_the_energy():
    """10^4 steps are a benchmark's; implicit Euler beside it loses a part of the spin."""
    path = spun("midpoint", 300, rtol=1e-12)
    momentum, turning = path.record("momentum"), path.record("angular_momentum")
    assert np.abs(momentum - momentum[0]).max() < 1e-12 * np.linalg.norm(momentum[0])
    assert np.abs(turning - turning[0]).max() < 1e-11 * np.linalg.norm(turning[0])
    energy = np.cumsum([row.stored + row.kinetic for row in path.ledger])
    assert np.ptp(energy[150:]) < 1.1 * np.ptp(energy[:150])
    assert momentum[0] == pytest.approx(0.08 * np.array([1.0, 0.2, 0.1]))
    calmed = spun("euler", 300).record("angular_momentum")
    assert np.linalg.norm(calmed[-1] - calmed[0]) > 0.1 * np.linalg.norm(calmed[0])


def beam(degree=2, comm=MPI.COMM_SELF):
    """A beam clamped at one end, under its own weight."""
    body = meshes.block(comm, (1.0, 0.2), n=(6, 1), cells="quadrilateral")
    t, u = forms.load_factor(body), forms.displacement(body, degree)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 40.0, 80.0) * ufl.dx
    psi += forms.gravity(u, 1.0)
    return body, psi, u, [forms.clamp(u, body.facets("left"))], t


@pytest.mark.parametrize("scheme", [name for name, _ in SCHEMES])
def test_every_joule_of_a_swing_is_accounted_for(scheme):
    """At default steps, to a thousandth of what is exchanged; damped, the loss is the damping's."""
    _, *scene = beam()
    damping = [dissipation.mass_damping(2.0), dissipation.kelvin_voigt(0.05)]
    path = forms.transient(
        *scene, to=0.7, rho=1.0, scheme=scheme, dissipation=damping, progress=False
    )
    account = path.ledger
    assert account.missed < 1e-3 * account.exchanged
    lost = sum(row.dissipated for row in account)
    falls = -sum(row.stored for row in account)
    moves = path.record("kinetic")[-1]
    own = sum(row.scheme for row in account)
    assert falls == pytest.approx(lost + moves + own, rel=3e-3) and lost > 0.2 * falls
    if scheme in ("newmark", "midpoint"):
        assert abs(own) < 1e-9 * falls
    else:
        assert abs(own) < (0.05 if scheme == "euler" else 1e-3) * falls


def test_the_error_that_a_step_is_said_to_make_is_the_one_it_makes():
    """Of the trapezoidal rule, by a step in a hundred pieces from the same state."""
    _, psi, u, supports, t = beam(1)
    forms.transient(psi, u, supports, t, to=0.2, rho=1.0, dt=0.002, progress=False, scheme="bdf2")
    path = forms.transient(psi, u, supports, t, to=0.25, rho=1.0, dt=0.002, progress=False)
    start, speed = u.x.array.copy(), path.velocity
    ends = []
    for count in (1, 100):
        u.x.array[:], t.value = start, 0.0
        run = forms.transient(
            *(psi, u, supports, t),
            to=0.004,
            rho=1.0,
            dt=0.004 / count,
            velocity=speed,
            progress=False,
            rtol=1e-10,
        )
        ends.append(u.x.array.copy())
        if count == 1:
            told = run.record("error")[0]
    made = np.abs(ends[0] - ends[1]).max()
    assert 0.5 * told < made < 2 * told


def test_refused_steps_leave_the_motion_as_it_was(monkeypatch):
    """First steps far too long are tried: u, v, a and t are the last state's after each of them."""
    _, *scene = beam(1)
    u, t, known, refused = scene[1], scene[3], [], []

    def state(path):
        parts = (u, path.velocity, path.acceleration)
        return [f.x.array.copy() for f in parts] + [float(t.value)]

    def refuse(steps, outcome):
        said = kept(steps, outcome)
        refused.append((state(steps.path), known[-1] if known else None))
        return said

    kept = TimeSteps.refuse
    monkeypatch.setattr(TimeSteps, "refuse", refuse)
    forms.transient(
        *scene,
        to=0.2,
        rho=1.0,
        step=0.01,
        progress=False,
        on_step=lambda path: known.append(state(path)),
        tolerance=1e-6,
    )
    later = [pair for pair in refused if pair[1] is not None]
    assert later
    for now, before in later:
        assert all(np.array_equal(a, b) for a, b in zip(now, before, strict=True))


def test_supports_that_move_have_a_velocity_and_an_acceleration():
    """A bar shaken rigidly: u, v, a are the support's everywhere, and its work is what moves."""
    body, psi, u, _, t = beam(1)
    stiff = 1e6 * psi
    shake = forms.translate(u, body.facets("left"), (0.8 * t**3, 0))
    path = forms.transient(
        stiff - forms.gravity(u, 1e6),
        u,
        [shake],
        t,
        to=0.5,
        rho=1.0,
        dt=0.005,
        progress=False,
        scheme="bdf2",
    )
    time = 0.5
    v, a = 2.4 * time**2, 4.8 * time
    nodes = path.velocity.x.array.reshape(-1, 2)[:, 0]
    assert nodes == pytest.approx(v, rel=1e-3)
    assert path.acceleration.x.array.reshape(-1, 2)[:, 0] == pytest.approx(a, rel=1e-2)
    work = sum(row.supports for row in path.ledger)
    assert work == pytest.approx(0.2 * v**2 / 2, rel=1e-2)
    force, _ = forms.resultant(path, body.facets("left"))
    assert force[0] == pytest.approx(0.2 * a, rel=1e-2)
