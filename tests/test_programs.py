# SPDX-License-Identifier: MIT
"""Load programs: tables, kinks on which steps end, loads that go back."""

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from test_following import rod

from variform import forms, meshes
from variform.forms.programs import kinks


def bar(amount):
    """A bar that is pulled by an amount of the load factor, and held sideways nowhere."""
    body = meshes.block(MPI.COMM_SELF, (1.0, 0.5), n=(4, 2))
    u, t = forms.displacement(body), forms.load_factor(body)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0) * ufl.dx
    pull = forms.translate(u, body.facets("right"), (amount(t), None))
    held = [forms.roller(u, body.facets("left"), 0), forms.roller(u, body.facets("bottom"), 1)]
    return psi, u, [*held, pull], t


def test_a_table_is_piecewise_linear():
    """Values between its times, constant before and behind."""
    body = meshes.block(MPI.COMM_SELF, (1.0, 1.0), n=1)
    t = forms.load_factor(body)
    f = forms.table(t, [0.0, 1.0, 3.0], [1.0, 2.0, -2.0]) * ufl.dx(domain=body.mesh)
    for load in (-1.0, 0.0, 0.25, 1.0, 2.0, 3.0, 9.0):
        t.value = load
        assert forms.integral(f) == pytest.approx(np.interp(load, [0, 1, 3], [1, 2, -2]))


@pytest.mark.parametrize(
    ("times", "values", "words"),
    [
        ([0, 1, 1], [0, 1, 2], "ascending times"),
        ([0, 1], [0, 1, 2], "as many values"),
        ([0], [1], "two or more"),
        ([0, 1], [0, np.nan], "finite values"),
    ],
)
def test_tables_are_checked(times, values, words):
    body = meshes.block(MPI.COMM_SELF, (1.0, 1.0), n=1)
    with pytest.raises(ValueError, match=words):
        forms.table(forms.load_factor(body), times, values)


def test_steps_end_on_kinks_of_loads_and_supports():
    """Up, on, and down again: a state at each bend, whatever the steps; energy as by the table."""
    *scene, t = bar(lambda t: forms.table(t, [0.0, 0.37, 0.8, 1.0], [0.0, 0.2, 0.2, 0.1]))
    path = forms.follow(*scene, t, progress=False)
    loads = [step.load for step in path.steps]
    assert {0.37, 0.8, 1.0} <= set(loads)
    ends = {0.37: 0.2, 0.8: 0.2, 1.0: 0.1}
    for load, row in zip(loads, path.balances[1:], strict=False):
        assert row.place <= 1.0 and load <= 1.0
    for load, amount in ends.items():
        *other, s = bar(lambda s, amount=amount: amount * s)
        s.value = 1.0
        energy = forms.solve(*other).problem.energy()
        found = next(b.energy for b in path.balances if b.load == load)
        assert found == pytest.approx(energy, rel=1e-9)
    assert path.ledger.missed < 1e-4 * path.ledger.exchanged
    assert len(path.ledger) == len(path.steps)


def test_kinks_are_found_in_what_the_user_wrote():
    """In tables, conditionals and max_value, of loads and supports; smooth loads have none."""
    *scene, t = bar(lambda t: 0.1 * ufl.max_value(t, 0.3))
    body = scene[1].function_space.mesh
    load = forms.body_force(scene[1], (ufl.conditional(ufl.gt(t, 0.6), t, 0.6), 0 * t))
    problem = forms.Problem(scene[0] + load, *scene[1:])
    assert kinks(problem, t) == [0.3, 0.6]
    other = fem_constant(body)
    assert kinks(problem, other) == []
    *scene, t = bar(lambda t: 0.1 * t)
    assert kinks(forms.Problem(*scene), t) == []


def fem_constant(mesh):
    return forms.load_factor(mesh)


def test_a_load_goes_back(tmp_path):
    """To 0.3, 1 and back to 0.5: steps on each; elastic, the end is that of 0.5; resumed, too."""
    *scene, t = rod(0.2, degree=1)
    path = forms.follow(*scene, t, to=[0.3, 1.0, 0.5], progress=False)
    loads = [step.load for step in path.steps]
    assert loads[-1] == 0.5 and 0.3 in loads and max(loads) == 1.0
    assert path.ledger.missed < 1e-4 * path.ledger.exchanged
    end = scene[1].x.array.copy()
    *scene, t = rod(0.2, degree=1)
    forms.follow(*scene, t, to=0.5, progress=False)
    assert np.abs(scene[1].x.array - end).max() < 1e-8
    *scene, t = rod(0.2, degree=1)
    kept = forms.Checkpoint(tmp_path)

    def stop(path):
        if path.load < 1 and len(path.steps) > 3 and path.steps[-2].load > path.load:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        forms.follow(*scene, t, to=[0.3, 1.0, 0.5], checkpoint=kept, on_step=stop, progress=False)
    *scene, t = rod(0.2, degree=1)
    again = forms.follow(*scene, t, to=[0.3, 1.0, 0.5], checkpoint=kept, progress=False)
    assert again.resumed == 1.0 and [step.load for step in again.steps] == loads
    assert np.array_equal(scene[1].x.array, end)


@pytest.mark.parametrize("to", [[0.3, 0.3], [], [0.0, 1.0]])
def test_loads_that_do_not_move_are_refused(to):
    *scene, t = rod(0.2, degree=1)
    with pytest.raises(ValueError, match="the load factors of to= differ|already"):
        forms.follow(*scene, t, to=to, progress=False)
