# SPDX-License-Identifier: MIT
"""Controlled paths: a pressure past its limit point, a load found from a displacement."""

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from cases import rates
from dolfinx import fem

from variform import forms, meshes
from variform.forms.solving.border import Border
from variform.forms.solving.controls.target import Held
from variform.forms.solving.corrector import Corrector


def sphere(h, degree, comm=MPI.COMM_SELF):
    """An octant of a unit sphere: potential at pressure p, its unknown, supports, volume."""
    body = meshes.spherical_sheet(comm, 1.0, h, degree, "octant")
    u, p = forms.displacement(body, degree=degree), fem.Constant(body.mesh, 0.1)
    volume = forms.enclosed_volume(u)
    psi = forms.energies.neo_hookean_sheet(forms.membrane_gradient(u), 1.0)
    held = [forms.roller(u, body.facets(f"{a}0"), k) for k, a in enumerate("xyz")]
    return psi * ufl.dx - p * volume, u, held, p, volume


STRETCHES = np.concatenate([np.linspace(1.05, 1.6, 12), np.linspace(1.8, 3, 7)])


@pytest.mark.parametrize("degree", [1, 2])
def test_a_balloon_past_its_limit_point(degree):
    """Pressure 2 mu t/r (1/l - 1/l^7) up to l = 3, over the peak 1.2394629 at l = 7^(1/6)."""
    exact, errors = 2 * (1 / STRETCHES - STRETCHES**-7.0), []
    for h in (0.4, 0.2):
        potential, u, held, p, volume = sphere(h, degree)
        start = forms.integral(volume)
        path = forms.control(potential, u, held, p, volume, start * STRETCHES**3, progress=False)
        found = np.array([step.load for step in path.steps])
        errors.append(np.abs(found - exact).max())
        peak = found.argmax()
        assert 0 < peak < 8 and np.all(np.diff(found[peak:]) < 0)
        assert path.completed and path.refused == 0
    order = rates(errors)[-1]
    assert order == pytest.approx(2, abs=0.4) if degree == 1 else order > 3
    assert errors[-1] < {1: 0.02, 2: 1e-4}[degree]


def test_the_limit_point_itself():
    """Through the peak in fine steps: 1.2394629 at the stretch 7^(1/6), to the mesh's 1e-4."""
    potential, u, held, p, volume = sphere(0.3, 2)
    start = forms.integral(volume)
    stretches = np.linspace(1.3, 1.46, 17)
    path = forms.control(potential, u, held, p, volume, start * stretches**3, progress=False)
    found = np.array([step.load for step in path.steps])
    a, b, c = np.polyfit(stretches[4:13], found[4:13], 2)
    assert -b / (2 * a) == pytest.approx(7 ** (1 / 6), abs=2e-3)
    assert c - b**2 / (4 * a) == pytest.approx(1.2394629, rel=1e-4)


@pytest.mark.parametrize("count, end", [(2, 3.0), (3, 3.0), (4, 2.0), (5, 1.6), (6, 1.6), (8, 3.0)])
def test_a_peak_between_any_targets_is_a_limit_point(count, end):
    """Wherever steps lie around it, two states or many: 1.2394629 to the mesh's 5e-4."""
    potential, u, held, p, volume = sphere(0.5, 2)
    targets = forms.integral(volume) * np.linspace(1.05, end, count) ** 3
    (event,) = forms.control(potential, u, held, p, volume, targets, progress=False).events
    assert (event.kind, event.before, event.after) == ("limit point", 0, 1)
    assert event.load == pytest.approx(1.2394629, rel=5e-4)


def test_a_load_found_from_a_displacement():
    """The traction that moves the end as far as a given traction does is that traction."""
    body = meshes.block(MPI.COMM_SELF, (4.0, 1.0), n=(8, 2), cells="quadrilateral")
    u, t = forms.displacement(body), forms.load_factor(body)
    psi = forms.energies.fixed_corotated(forms.deformation_gradient(u), 1.0, 2.0)
    load = forms.dead_traction(u, ufl.as_vector([0 * t, -0.02 * t]), body.ds("right"))
    held = [forms.clamp(u, body.facets("left"))]
    end = u[1] * body.ds("right")
    forms.follow(psi * ufl.dx + load, u, held, t, progress=False, rtol=1e-12, ctol=1e-10)
    deflection, moved = forms.integral(end), u.x.array.copy()
    u.x.array[:], t.value = 0, 0.5
    path = forms.control(
        psi * ufl.dx + load,
        u,
        held,
        t,
        end,
        [0.5 * deflection, deflection],
        rtol=1e-12,
        ctol=1e-10,
        progress=False,
        record={"end": lambda s: forms.integral(end)},
    )
    assert path.load == pytest.approx(1, rel=1e-9)
    assert path.steps[-1].records["end"] == pytest.approx(deflection, rel=1e-11)
    assert np.abs(u.x.array - moved).max() < 1e-9 * np.abs(moved).max()
    residuals = path.steps[-1].convergence.residuals
    assert residuals[-1] < 1e-9 * residuals[1]


def test_a_target_that_is_far_is_reached_in_halves_or_refused():
    """A far target is approached; one that no state has leaves the last one, and says so."""
    potential, u, held, p, volume = sphere(0.5, 1)
    start = forms.integral(volume)
    path = forms.control(potential, u, held, p, volume, [20 * start], progress=False)
    assert path.refused > 0 and forms.integral(volume) == pytest.approx(20 * start, rel=1e-7)
    with pytest.raises(forms.NotConverged, match="on the way to nan from") as failure:
        forms.control(potential, u, held, p, volume, [np.nan], progress=False)
    assert not failure.value.path.steps
    assert forms.integral(volume) == pytest.approx(20 * start, rel=1e-7)


def test_the_account_of_a_way_there_and_back():
    """Every joule of a balloon blown up and let down, the steps around the turn included: 2e-5."""
    potential, u, held, p, volume = sphere(0.4, 2)
    stretches = [*np.linspace(1.1, 2, 8), *np.linspace(1.9, 1.2, 8)]
    targets = forms.integral(volume) * np.array(stretches)
    record = {"sheet": lambda s: s.energy() + float(p.value) * forms.integral(volume)}
    path = forms.control(potential, u, held, p, volume, targets, record=record, progress=False)
    rows, stored = list(path.ledger), [step.records["sheet"] for step in path.steps]
    assert [row.stored for row in rows] == pytest.approx(np.diff(stored), rel=1e-9)
    assert max(abs(row.unaccounted) for row in rows) < 2e-5 * max(stored)
    assert abs(rows[6].unaccounted) + abs(rows[7].unaccounted) < 5e-6 * max(stored)


def test_a_scalar_inside_an_operand_is_found():
    """The activation at which a free block is 1/1.1 as long is 1.1: F A = R, without stress."""
    body = meshes.block(MPI.COMM_SELF, (1.0, 1.0), n=1)
    u, q = forms.displacement(body), fem.Constant(body.mesh, 1.0)
    A = ufl.as_matrix([[q, 0, 0], [0, 1, 0], [0, 0, 1]])
    psi = forms.energies.activated(forms.deformation_gradient(u), A, 1.0)
    held = [forms.roller(u, body.facets("left"), 0), forms.roller(u, body.facets("bottom"), 1)]
    right = u[0] * body.ds("right")
    forms.control(psi * ufl.dx, u, held, q, right, [1 / 1.1 - 1], progress=False)
    assert float(q.value) == pytest.approx(1.1, rel=1e-8)


SCRIPT = """
import json, sys
sys.path.insert(0, {tests!r})
from mpi4py import MPI
from variform import forms
from test_control import sphere
potential, u, held, p, volume = sphere(0.4, 2, MPI.COMM_WORLD)
start = forms.integral(volume)
path = forms.control(potential, u, held, p, volume, [start * l**3 for l in (1.1, 1.4, 2.0)],
                     rtol=1e-12, ctol=1e-10, progress=False)
if MPI.COMM_WORLD.rank == 0:
    print(json.dumps([step.load for step in path.steps]))
"""


def test_ranks_agree(parallel, root):
    script = SCRIPT.format(tests=str(root / "tests"))
    one, two, three = (parallel(script, ranks) for ranks in (1, 2, 3))
    assert two == pytest.approx(one, rel=1e-10) and three == pytest.approx(one, rel=1e-10)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"q": 1.0}, "needs a scalar Constant q, got float"),
        ({"q": "other"}, "the potential does not contain q"),
        ({"functional": "none"}, "residual needs a potential"),
        ({"targets": []}, "control needs a functional of u, .* got Form and 0 targets"),
    ],
)
def test_bad_input_gets_one_sentence(change, message):
    potential, u, held, p, volume = sphere(1.0, 1)
    mesh = u.function_space.mesh
    q = {"other": fem.Constant(mesh, 1.0)}.get(change.get("q"), change.get("q", p))
    functional = fem.Constant(mesh, 1.0) * ufl.dx if "functional" in change else volume
    with pytest.raises(ValueError, match=message):
        aims = change.get("targets", [1.0])
        forms.control(potential, u, held, q, functional, aims, progress=False)


def test_two_scalars_hold_two_averages():
    """A block with two load factors, in one bordered system: quadratic, and both means are met."""
    body = meshes.block(MPI.COMM_SELF, (1.0, 1.0), n=(3, 3))
    u = forms.displacement(body, 2)
    p, q = forms.load_factor(body), forms.load_factor(body)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0) * ufl.dx
    loads = forms.dead_traction(u, (p, 0 * p), body.ds("right"))
    loads += forms.dead_traction(u, (0 * q, q), body.ds("top"))
    problem = forms.Problem(psi + loads, u, [forms.clamp(u, body.facets("left"))])
    newton = forms.solving.Newton(problem)
    border = Border(problem, [p, q], newton.tangent)
    means = [u[0] * body.ds("right"), u[1] * body.ds("top")]
    held = [Held(border, mean) for mean in means]
    border.constraints = held
    held[0].aim, held[1].aim = 0.2, 0.1
    corrector = Corrector(newton, border)
    outcome = corrector.solve(free=True)
    assert outcome.converged and outcome.iterations <= 7
    assert [forms.integral(mean) for mean in means] == pytest.approx([0.2, 0.1], rel=1e-9)
    moved, found = u.x.array.copy(), (float(p.value), float(q.value))
    corrector.destroy()
    newton.destroy()
    u.x.array[:] = 0
    forms.solve(psi + loads, u, problem.supports)
    assert np.abs(u.x.array - moved).max() < 1e-8 and min(map(abs, found)) > 0.05
