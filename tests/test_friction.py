# SPDX-License-Identifier: MIT
"""Coulomb friction: a block on a slope sticks and slides, a conveyor takes it along, its work."""

from mpi4py import MPI

import numpy as np
import pytest
import ufl

from variform import forms, meshes
from variform.forms import dissipation

MU, G, RHO, AREA = 0.5, 9.81, 1000.0, 0.08


def block():
    """A block that rests on the plane y = 0, its weight along the normal for a slope's angle."""
    start = 0.003
    body = meshes.block(
        MPI.COMM_SELF, (0.4, 0.2), n=(4, 2), cells="quadrilateral", origin=(0, start)
    )
    t, u = forms.load_factor(body), forms.displacement(body)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1e6, 2e6) * ufl.dx
    plane = forms.obstacles.plane((0, 0), (0, 1))
    floor = forms.obstacle(u, plane, body.ds("bottom"), dhat=0.005, stiffness=2e5)
    return t, u, psi, floor, forms.pin(u, (0, start), axes=[0])


def slide(ratio, to, ramp, scheme, speed, tool=None):
    """A block on a slope of tan(angle) = ratio mu, whose pull along it grows over a time."""
    t, u, psi, floor, pin = block()
    angle = np.arctan(ratio * MU)
    pressed = psi + floor + forms.gravity(u, RHO * np.cos(angle), G)
    forms.solve(pressed, u, pin)
    along = RHO * np.sin(angle) * forms.table(t, [0, ramp], [0, 1])
    damped = [*forms.friction(floor, MU, speed, tool), dissipation.kelvin_voigt(2e3)]
    return angle, forms.transient(
        pressed + forms.gravity(u, along, G, direction=(1, 0)), u, (), t, to=to, rho=RHO,
        scheme=scheme, dissipation=damped, progress=False,
    )  # fmt: skip


def test_a_block_sticks_below_the_angle_of_friction():
    """At 0.99 of it the speed stays below that of the regularization, and creeps at 0.9 of it."""
    _, path = slide(0.99, 1.0, 0.5, "bdf2", 1e-2)
    speed = path.record("momentum")[:, 0] / (RHO * AREA)
    assert speed.max() < 1e-2
    # 2 y - y^2 = 0.99 at y = 0.9.
    assert speed[-1] == pytest.approx(0.9e-2, rel=1e-2)
    assert all(step.clearance.distance > 0 for step in path.steps)


@pytest.mark.parametrize("scheme", ["newmark", "bdf2"])
def test_a_block_slides_above_it(scheme):
    """At 1.5 of it with g (sin - mu cos), 1 %; the work of friction is force times path, 1 %."""
    angle, path = slide(1.5, 0.5, 1e-6, scheme, 1e-3)
    speed = path.record("momentum")[:, 0] / (RHO * AREA)
    times = np.array([step.load for step in path.steps])
    later = times > 0.25
    rate = np.polyfit(times[later], speed[later], 1)[0]
    assert rate == pytest.approx(G * (np.sin(angle) - MU * np.cos(angle)), rel=1e-2)
    moved = path.u.x.array.reshape(-1, 2)[:, 0].mean()
    work = MU * RHO * AREA * G * np.cos(angle) * moved
    lost = sum(row.dissipated for row in path.ledger)
    assert lost == pytest.approx(work, rel=1e-2)
    assert path.ledger.missed < 1e-3 * path.ledger.exchanged


def test_a_conveyor_takes_a_block_along():
    """With mu g, rocking, until it is as fast as the belt, and no faster."""
    _, path = slide(1e-12, 0.3, 0.1, "bdf2", 1e-3, tool=(0.5, 0.0))
    speed = path.record("momentum")[:, 0] / (RHO * AREA)
    times = np.array([step.load for step in path.steps])
    rising = (times > 0.02) & (times < 0.08)
    assert np.polyfit(times[rising], speed[rising], 1)[0] == pytest.approx(MU * G, rel=5e-2)
    assert speed[-1] == pytest.approx(0.5, rel=1e-2) and speed.max() < 0.53


def test_a_press_with_friction_bulges():
    """A plate comes down on a block: with friction it is held there as if it were bonded to it."""
    force, spread = {}, {}
    for name in ("smooth", "rough", "bonded"):
        body = meshes.block(MPI.COMM_SELF, (0.4, 0.2), n=(8, 4), cells="quadrilateral")
        t, u = forms.load_factor(body), forms.displacement(body)
        psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1e6, 2e6) * ufl.dx
        held = [forms.clamp(u, body.facets("bottom"))]
        plate = forms.obstacles.plane((0, 0.202 - 0.02 * t), (0, -1))
        top = forms.obstacle(u, plate, body.ds("top"), dhat=2e-3, stiffness=1e6, name="plate")
        if name == "bonded":
            held.append(forms.roller(u, body.facets("top"), 0))
            path = forms.follow(psi + top, u, held, t, progress=False)
        else:
            friction = forms.friction(top, 0.8, 1e-5) if name == "rough" else []
            path = forms.transient(
                *(psi + top, u, held, t), rho=RHO, to=1.0, scheme="euler", progress=False,
                dissipation=[*friction, dissipation.kelvin_voigt(2e3)],
            )  # fmt: skip
        force[name] = forms.contact.force(path)[1]
        spread[name] = forms.at(u, (0.4, 0.2))[0]
    assert force["rough"] == pytest.approx(force["bonded"], rel=5e-3)
    assert force["rough"] > 1.05 * force["smooth"] > 0
    assert abs(spread["rough"]) < 1e-2 * spread["smooth"]


def test_bad_input_of_friction():
    """No obstacle in the form, mu below 0, a speed of 0, a tool that is no vector."""
    _, _, psi, floor, _ = block()
    for arguments, words in (
        ((psi, 0.3, 1e-3), "friction needs the contact that it acts in"),
        ((None, 0.3, 1e-3), "got NoneType"),
        ((floor, -0.1, 1e-3), "a coefficient of friction is not negative, got -0.1"),
        ((floor, 0.3, 0.0), "friction sticks below a speed above 0 .*, got 0.0"),
        ((floor, 0.3, 1e-3, (1.0,)), "a tool's velocity needs the shape"),
    ):
        with pytest.raises(ValueError, match=words):
            forms.friction(*arguments)
