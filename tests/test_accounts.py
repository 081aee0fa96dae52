# SPDX-License-Identifier: MIT
"""The ledger closes: where loads come to an extremum, and where powers change within a step."""

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from broken_paths import Stopped, stop_after
from test_control import sphere

from variform import forms, meshes
from variform.forms.ledger import BETWEEN, TOLERATED, Balance, lagrange, rows, weights
from variform.forms.solving.controls import load
from variform.forms.solving.controls.between import gaps, joined


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


def bend(comm=MPI.COMM_SELF, **options):
    """A bar, one end turned in its place across the axis, until it is about to snap."""
    body = meshes.block(comm, (1.0, 0.2, 0.2), h=0.1)
    u, t = forms.displacement(body, 2), forms.load_factor(body)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 1.5) * ufl.dx
    turned = forms.rotate(u, body.facets("right"), angle=t, axis=(0, 1, 0))
    held = [forms.clamp(u, body.facets("left")), turned]
    return forms.follow(psi, u, held, t, to=1.9, progress=False, **options)


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
