# SPDX-License-Identifier: MIT
"""The ledger closes: where loads come to an extremum, and where powers change within a step."""

from dataclasses import replace

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from broken_paths import Stopped, stop_after
from test_control import sphere

from variform import forms, meshes
from variform.forms.ledger import BETWEEN, TOLERATED, Balance, exchange, lagrange, rows, weights
from variform.forms.solving.accounts import Accounts
from variform.forms.solving.controls import load
from variform.forms.solving.controls.between import Gap, gaps, joined
from variform.forms.solving.corrector import Corrector
from variform.forms.solving.settings import Settings


def extremum(count, by):
    """A body of one x up to the largest q = sin x, in equal steps of q.

    By loads Pi = 1 - cos x - q x with Pi_q = -x; by supports Pi = x sin x + cos x - 1, dPi/dq = x.
    """
    states = []
    for q in np.linspace(0, 1, count + 1):
        x = np.arcsin(q)
        if by == "loads":
            states.append(Balance(q, q, 1 - np.cos(x) - q * x, -x, 0.0))
        else:
            states.append(Balance(q, q, x * q + np.cos(x) - 1, 0.0, x))
    return states


@pytest.mark.parametrize("by", ["loads", "supports"])
def test_up_to_the_largest_load_halved_steps_leave_a_quarter_at_most(by):
    """No polynomial in q follows x there, which goes with the root of what is left of q."""
    missed = []
    for count in (4, 8, 16):
        account = rows(extremum(count, by))
        missed.append(account.missed / account.exchanged)
    assert TOLERATED > missed[0] > 4 * missed[1] > 16 * missed[2] > 1e-12


def test_weights_integrate_polynomials():
    """int_a^b f dg of polynomials of degree 3 through 4 places, however far apart; slopes too."""
    x, f, g = np.array([0.0, 0.1, 1.0, 1.3]), np.poly1d([1, -2, 0.5, 3]), np.poly1d([2, 1, -1, 0])
    exact = np.polyint(f * g.deriv())
    assert f(x) @ weights(x, 0.1, 1.0) @ g(x) == pytest.approx(exact(1.0) - exact(0.1), rel=1e-12)
    values, slopes = lagrange(x, np.array([0.4, 1.3]))
    assert values @ f(x) == pytest.approx(f([0.4, 1.3]), rel=1e-12)
    assert slopes @ f(x) == pytest.approx(f.deriv()([0.4, 1.3]), rel=1e-12)


def test_energy_set_free_stays_unaccounted():
    """No rule of integration, and no state within, hides a jump of a hundredth of the work."""
    states = extremum(8, "supports")
    fallen = [b._replace(energy=b.energy - 0.01 * (n > 4)) for n, b in enumerate(states)]
    assert rows(fallen)[4].unaccounted == pytest.approx(0.01, rel=1e-3)
    (gap,) = gaps(fallen, 0.0, 0, 8)
    assert gap.begin is fallen[4] and gap.end is fallen[5]
    middle = extremum(16, "supports")[9]
    for energy in (middle.energy, middle.energy - 0.01):
        account = rows(joined(fallen, gap, middle._replace(energy=energy)))
        assert len(account) == 8
        assert account[4].unaccounted == pytest.approx(0.01, rel=1e-3)


def test_a_balloon_close_to_its_largest_pressure():
    """To 99.7 % of 1.2394629 in a few load steps: each closes to a thousandth of its work."""
    potential, u, held, p, _ = sphere(0.4, 2)
    u.interpolate(lambda x: 0.05 * x)
    p.value = 0.2
    forms.solve(potential, u, held)
    path = forms.follow(potential, u, held, p, to=1.236, progress=False)
    assert len(path.steps) < 12
    for row in path.ledger:
        assert abs(row.unaccounted) < TOLERATED * abs(row.loads)
    assert "Unaccounted" not in path.reason


def bend(comm=MPI.COMM_SELF, h=0.1, to=1.9, **options):
    """A bar, one end turned in its place across the axis, until it is about to snap."""
    body = meshes.block(comm, (1.0, 0.2, 0.2), h=h)
    u, t = forms.displacement(body, 2), forms.load_factor(body)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 1.5) * ufl.dx
    turned = forms.rotate(u, body.facets("right"), angle=t, axis=(0, 1, 0))
    held = [forms.clamp(u, body.facets("left")), turned]
    return forms.follow(psi, u, held, t, to=to, progress=False, **options)


def test_states_within_steps_are_the_accounts_alone(monkeypatch):
    """They close it; steps, states and what the path says are those without them."""
    path = bend()
    monkeypatch.setattr(load, "gaps", lambda *arguments: [])
    plain = bend()
    within = [each for each in path.balances if each.kind == BETWEEN]
    assert within and [b for b in path.balances if b.kind != BETWEEN] == plain.balances
    assert [step.load for step in path.steps] == [step.load for step in plain.steps]
    assert np.array_equal(path.u.x.array, plain.u.x.array)
    assert len(path.ledger) == len(path.steps)
    for row in path.ledger:
        assert abs(row.unaccounted) < TOLERATED * abs(row.supports)
    assert path.ledger.missed < plain.ledger.missed / 4
    spent = path.tangents - plain.tangents
    assert len(within) <= spent <= 2 * len(within)
    assert sum(step.convergence.tangents for step in path.steps) == path.tangents


def twist(to, by="supports", h=0.1, degree=2, **options):
    """A bar whose end is turned, whose top is loaded, or both, up to a load factor."""
    body = meshes.block(MPI.COMM_SELF, (1.0, 0.2, 0.2), h=h)
    u, t = forms.displacement(body, degree=degree), forms.load_factor(body)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 1.5) * ufl.dx
    held = [forms.clamp(u, body.facets("left"))]
    if by != "loads":
        held.append(forms.rotate(u, body.facets("right"), angle=t, axis=(1, 0, 0)))
    if by != "supports":
        psi += forms.dead_traction(u, ufl.as_vector([0, 0, 0.02 * t]), body.ds("top"))
    return (psi, u, held, t), {"to": to, "step": to, **options}


def mixed():
    """The same of displacement and pressure, hardly compressible."""
    body = meshes.block(MPI.COMM_SELF, (1.0, 0.2, 0.2), n=(10, 2, 2), cells="tetrahedron")
    t, w = forms.load_factor(body), forms.displacement_pressure(body)
    u, p = ufl.split(w)
    F = forms.deformation_gradient(u)
    psi = forms.energies.with_pressure(forms.energies.isochoric_neo_hookean(F, 1.0), F, p, 1e3)
    held = [
        forms.clamp(w, body.facets("left")),
        forms.rotate(w, body.facets("right"), angle=t, axis=(1, 0, 0)),
    ]
    return (psi * ufl.dx, w, held, t), {"to": 1.0}


def balloon():
    """An octant of a sheet under pressure, not far from its largest one."""
    potential, u, held, p, _ = sphere(0.4, 2)
    u.interpolate(lambda x: 0.05 * x)
    p.value = 0.2
    forms.solve(potential, u, held)
    return (potential, u, held, p), {"to": 1.2}


SCENES = {
    "supports": lambda: twist(0.35),
    "supports, multigrid": lambda: twist(0.35, h=0.06),
    "supports, degree 1, multigrid": lambda: twist(0.35, h=0.03, degree=1),
    "loads": lambda: twist(1.0, "loads"),
    "loads, multigrid": lambda: twist(0.5, "loads", h=0.06),
    "both": lambda: twist(0.5, "both"),
    "a sheet, pressure": balloon,
    "displacement and pressure": mixed,
}


@pytest.mark.parametrize("by", ["supports", "loads"])
def test_powers_with_forces_out_of_balance_are_off_by_the_second_order(by):
    """An error h v of an equilibrium makes one of h^2 in dPi/ds, and of h without these forces."""
    (*scene, t), _ = twist(1.0, by, h=0.2, degree=1)
    u, states, ds = scene[1], [], 1e-3
    for t.value in (0.3 - ds, 0.3 + ds, 0.3):
        forms.solve(*scene, rtol=1e-13)
        states.append(u.x.array.copy())
    problem = forms.Problem(*scene)
    accounts, v = Accounts(problem, [t], 1.0), np.random.default_rng(1).normal(size=u.x.array.size)
    problem.clear(v)
    exact = accounts.read(0.3)
    errors = []
    for h in (4e-4, 2e-4, 1e-4):
        u.x.array[:] = states[2] + h * v
        found, rest = accounts.read_near(0.3, 1.0, (states[1] - states[0]) / (2 * ds))
        error = found.power + found.slope - exact.power - exact.slope
        errors.append((error, error - rest))
    rates = np.log2(np.abs(errors[:-1]) / np.abs(errors[1:]))
    assert rates[:, 0] == pytest.approx(2, abs=0.1)
    assert rates[:, 1] == pytest.approx(1, abs=0.1)


def every_step(known, floor, ahead, count=1):
    """The last step as a gap, whatever it misses."""
    if len(known) < 2 or BETWEEN in (known[-1].kind, known[-2].kind):
        return []
    loads, supports, _ = exchange(known, len(known) - 1)
    return [Gap(known[-2], known[-1], max(TOLERATED * (abs(loads) + abs(supports)), floor))]


def always(balances, gap, state):
    """Balances with a state within a gap."""
    return [*balances[:-1], state._replace(kind=BETWEEN), balances[-1]]


@pytest.mark.parametrize("name", SCENES)
def test_states_within_are_solved_for_as_far_as_accounts_need(name, monkeypatch):
    """Powers are equilibria's to 1e-5 of a step's work, by fewer iterations, linear ones too."""
    monkeypatch.setattr(load, "gaps", every_step)
    monkeypatch.setattr(load, "joined", always)
    solve, spent = Corrector.solve, []

    def counted(self, *arguments, enough=None, **named):
        outcome = solve(self, *arguments, enough=enough, **named)
        if enough is not None:
            spent[-1] += outcome.iterations, outcome.linear_iterations
        return outcome

    monkeypatch.setattr(Corrector, "solve", counted)
    found = []
    for within in (Settings().within, (0.0, 0.0)):
        scene, options = SCENES[name]()
        spent.append(np.zeros(2, dtype=int))
        settings = replace(Settings(), within=within)
        path = forms.follow(*scene, **options, settings=settings, progress=False)
        found.append((path.balances, path.ledger, path.u.x.array.copy()))
    (known, ledger, u), (exact, whole, u_exact) = found
    assert np.array_equal(u, u_exact) and [b.kind for b in known] == [b.kind for b in exact]
    works = iter(abs(row.loads) + abs(row.supports) for row in whole)
    steps = zip(known, known[1:], known[2:], exact[1:], strict=False)
    within = [each for each in steps if each[1].kind == BETWEEN]
    assert len(within) == len(whole)
    for (before, here, after, wanted), work in zip(within, works, strict=True):
        off = abs(here.power - wanted.power) + abs(here.slope - wanted.slope)
        assert off * (after.place - before.place) < 1e-5 * work
    for row, wanted in zip(ledger, whole, strict=True):
        assert row.unaccounted == pytest.approx(wanted.unaccounted, abs=1e-5 * ledger.exchanged)
    assert np.all(spent[0] < spent[1]) and spent[0][1] <= 0.75 * spent[1][1]


def test_multigrid_is_as_if_there_were_no_states_within(monkeypatch):
    """They neither count for nor decide when it is built anew: each bit of the path is the same."""
    settings = Settings(doubt=10.0, refuse=0.9, jump=0.5)  # long steps, whose accounts need them
    options = {"h": 0.06, "to": 1.5, "step": 0.75, "max_step": 0.75, "settings": settings}
    path = bend(**options)
    assert BETWEEN in [each.kind for each in path.balances]
    monkeypatch.setattr(load, "gaps", lambda *arguments: [])
    plain = bend(**options)
    assert np.array_equal(path.u.x.array, plain.u.x.array) and path.reason == plain.reason


def test_a_resumed_path_has_the_same_account(tmp_path):
    """Bit by bit, whether it was broken off before a state within a step or behind one."""
    plain = bend(checkpoint=forms.Checkpoint(tmp_path / "plain"))
    for steps in (3, 5):
        folder = tmp_path / str(steps)
        with pytest.raises(Stopped):
            bend(checkpoint=forms.Checkpoint(folder), on_step=stop_after(steps))
        path = bend(checkpoint=forms.Checkpoint(folder))
        assert path.resumed and path.balances == plain.balances and path.ledger == plain.ledger


SCRIPT = """
import json
from mpi4py import MPI
from test_accounts import bend
path = bend(MPI.COMM_WORLD)
if MPI.COMM_WORLD.rank == 0:
    print(json.dumps([[b.place for b in path.balances], [b.kind for b in path.balances],
                      [row.supports for row in path.ledger], path.tangents]))
"""


def test_ranks_agree(parallel):
    """1, 2 and 3 ranks: states within the same steps, the same works."""
    one, two, three = (parallel(SCRIPT, ranks) for ranks in (1, 2, 3))
    assert BETWEEN in one[1]
    for other in (two, three):
        assert other[0] == pytest.approx(one[0], rel=1e-6) and other[1] == one[1]
        assert other[2] == pytest.approx(one[2], rel=1e-6) and other[3] == one[3]
