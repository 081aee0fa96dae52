# SPDX-License-Identifier: MIT
"""Paths are the user's: the state that the load leads to, its events, where its energy went."""

from math import pi

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest
import ufl
from test_problems import Well
from test_stepping import arc, targets, walk

from variform import forms, meshes
from variform.forms.ledger import Balance, rows, verdict
from variform.forms.solving.corrector import Corrector
from variform.forms.solving.pace import Pace
from variform.forms.solving.settings import Settings


def rod(h=0.1, lmbda=10.0, degree=2, comm=MPI.COMM_SELF):
    """README's block, one end turned about its axis by t."""
    body = meshes.block(comm, (1.0, 0.2, 0.2), h=h)
    t, u = forms.load_factor(body), forms.displacement(body, degree)
    psi = forms.energies.fixed_corotated(forms.deformation_gradient(u), 1.0, lmbda) * ufl.dx
    turn = forms.rotate(u, body.facets("right"), angle=t, axis=(1, 0, 0))
    return psi, u, [forms.clamp(u, body.facets("left")), turn], t


def test_a_twist_of_360_degrees_is_still_a_twist():
    """The crushed block that has turned back has an energy of 0.0005; 60 small steps 0.0048983."""
    *scene, t = rod()
    path = forms.follow(*scene, t, to=2 * pi, progress=False)
    energy = path.problem.energy()
    assert energy == pytest.approx(0.0048983, abs=1e-6) and path.tangents <= 45
    small = forms.follow(*rod(), to=2 * pi, step=pi / 30, max_step=pi / 30, progress=False)
    assert np.abs(path.u.x.array - small.u.x.array).max() < 1e-7
    assert not path.events and all(step.convergence.negative == 0 for step in path.steps)
    # The power of the support that the ledger has is the moment: the slope of the energy.
    t.value = 2 * pi - 1e-3
    forms.solve(*scene)
    slope = (energy - path.problem.energy()) / 1e-3
    assert path.balances[-1].power == pytest.approx(slope, rel=1e-3)


PATHS = {"argvalues": [walk, targets, arc], "ids": ["follow", "control", "arc_length"]}


@pytest.mark.parametrize("lead", **PATHS)
def test_snes_tells_of_each_correction(lead, tmp_path):
    """-snes_monitor writes a line per correction and one per start, as in a solve."""
    file = tmp_path / "lines"
    path = lead(options={"snes_monitor": f"ascii:{file}"})
    lines = file.read_text().splitlines()
    assert all("SNES Function norm" in line for line in lines)
    last = path.steps[-1].convergence
    assert len(lines) > sum(step.convergence.iterations + 1 for step in path.steps[1:])
    found = [float(line.split("norm")[1]) for line in lines[-last.iterations - 1 :]]
    if lead is walk:  # without scalar equations beside the forces
        assert found == pytest.approx(last.residuals, rel=1e-6)
    assert [int(line.split("SNES")[0]) for line in lines[-last.iterations - 1 :]] == list(
        range(last.iterations + 1)
    )


@pytest.mark.parametrize("lead", **PATHS)
def test_every_joule_of_a_path_is_accounted_for(lead):
    """Work of loads and supports is what is stored, step by step, to a thousandth."""
    path = lead()
    account = path.ledger
    exchanged = sum(abs(row.loads) + abs(row.supports) for row in account)
    assert sum(abs(row.unaccounted) for row in account) < 1e-3 * exchanged
    stored = sum(row.stored for row in account)
    total = path.balances[-1].energy - path.balances[-1].linear
    assert stored == pytest.approx(total - path.balances[0].energy + path.balances[0].linear)


@pytest.mark.parametrize("by", ["supports", "loads"])
def test_halved_steps_leave_a_quarter_unaccounted_at_most(by):
    """A block pulled apart in 8, 16 and 32 steps; what is left is far above rounding."""
    missed = []
    for n in (8, 16, 32):
        body = meshes.block(MPI.COMM_SELF, (1.0, 0.5, 0.5), n=(3, 2, 2))
        t, u = forms.load_factor(body), forms.displacement(body)
        psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0) * ufl.dx
        held = [forms.clamp(u, body.facets("left"))]
        if by == "supports":
            held.append(forms.translate(u, body.facets("right"), (t, 0, 0)))
        else:
            psi += forms.dead_traction(u, (1.5 * t, 0, 0), body.ds("right"))
        size = {"step": 1 / n, "max_step": 1 / n, "rtol": 1e-12, "ctol": 1e-11}
        account = forms.follow(psi, u, held, t, progress=False, **size).ledger
        missed.append(account.missed / account.exchanged)
    assert missed[0] > 4 * missed[1] > 16 * missed[2] > 1e-10


def test_loads_work_by_their_place():
    """A weight at the end of a bar: the work of a dead load, P u at P held, is in its column."""
    body = meshes.block(MPI.COMM_SELF, (1.0, 0.2, 0.2), n=(4, 1, 1))
    t, u = forms.load_factor(body), forms.displacement(body)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0) * ufl.dx
    pull = forms.dead_traction(u, (0.3 * t, 0, 0), body.ds("right"))
    held = [
        forms.roller(u, body.facets(side), axis)
        for axis, side in enumerate(("left", "front", "bottom"))
    ]
    path = forms.follow(psi + pull, u, held, t, progress=False)
    account = path.ledger
    stored = forms.integral(psi)
    assert sum(row.stored for row in account) == pytest.approx(stored, rel=1e-9)
    assert sum(row.loads for row in account) == pytest.approx(stored, rel=1e-5)
    assert all(row.supports == 0 for row in account)


def test_the_account_finds_a_jump():
    """An energy that falls by more than any load did is no path's, however long the step."""
    a, b = Balance(0.0, 0.0, 0.0, 0.0, 1.0), Balance(1.0, 1.0, 1.0, 0.0, 1.0)
    assert verdict([a, b], (0.0, 0.0), 0.0).outside == 0
    fallen = verdict([a, b._replace(energy=0.5)], (0.0, 0.0), 0.0)
    assert fallen.outside == pytest.approx(0.5)
    assert rows([a, b._replace(energy=0.5)])[0].unaccounted == pytest.approx(0.5)


def test_steps_aim_at_a_contraction():
    """(aim / theta)^(1/p), bounded; none grows behind one that was refused."""
    pace = Pace(1.0, 1e-3, settings=Settings())
    pace.toward(10.0)
    pace.accept(0.15, 4)
    assert pace.ahead == pytest.approx(1.0)
    pace.toward(10.0)
    pace.accept(0.15 / 16 * 1e-3, 4)
    assert pace.ahead == pytest.approx(2.0)
    pace.toward(10.0)
    assert pace.refuse(0.15 * 16, 2) and pace.ahead == pytest.approx(0.5)
    pace.toward(10.0)
    pace.accept(1e-9, 2)
    assert pace.ahead == pytest.approx(0.5)
    pace.toward(10.0)
    pace.accept(1e-9, 2)
    assert pace.ahead == pytest.approx(1.0)
    assert pace.toward(1.1) == 1.1 and pace.toward(1.9) == 0.95


def square(n=2):
    """Unit square in plane strain under all-round dead traction t; mu = 1, lmbda = 100."""
    body = meshes.block(MPI.COMM_SELF, (1.0, 1.0), n=(n, n), cells="quadrilateral")
    u, t = forms.displacement(body, 2), forms.load_factor(body)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 100.0) * ufl.dx
    pull = forms.dead_traction(u, (t, 0 * t), body.ds("right"))
    pull += forms.dead_traction(u, (0 * t, t), body.ds("top"))
    held = [forms.roller(u, body.facets("left"), 0), forms.roller(u, body.facets("bottom"), 1)]
    return psi + pull, u, held, t


BREAKS, LIMIT, VALLEY = 2.02030649, 75.99530385, 49.9072  # loads in closed form


def test_a_square_that_loses_its_symmetry_says_so():
    """The loads at which it breaks and ends are told; no branch is changed without a word."""
    *scene, t = square()
    u = scene[1]
    with pytest.raises(forms.NotConverged, match="no equilibrium is connected beyond") as failed:
        forms.follow(*scene, t, to=80.0, progress=False)
    path = failed.value.path
    assert path.load == pytest.approx(LIMIT, rel=1e-3) and path.load < LIMIT
    assert path.events[0].load == pytest.approx(BREAKS, abs=80e-6)
    assert path.events[0].before == 0 and path.events[0].kind == "bifurcation"
    assert "with forms.arc_length, or to the next state at rest" in path.reason
    corner = forms.at(u, (1, 1))
    assert corner[0] == pytest.approx(corner[1], rel=1e-10)


def test_arc_length_stays_on_the_branch_of_squares():
    """Over the limit load and the valley behind it, symmetric to ten digits."""
    *scene, t = square()
    u = scene[1]
    corner = {"corner": lambda problem: forms.at(u, (1, 1)).copy()}
    path = forms.arc_length(*scene, t, step=1.0, steps=2000, record=corner, progress=False,
                            until=lambda p: forms.at(u, (1, 1))[0] > 20)  # fmt: skip
    limits = [event.load for event in path.events if event.kind == "limit point"]
    assert limits == pytest.approx([LIMIT, VALLEY], abs=76e-6)
    assert path.events[0].load == pytest.approx(BREAKS, abs=76e-6)
    x = path.record("corner")
    assert np.abs(x[:, 0] - x[:, 1]).max() < 1e-10


def arch(height=0.3):
    """Shallow arch of span 10, clamped, under a dead load on its crown."""
    body = meshes.block(MPI.COMM_SELF, (10.0, 0.2), n=(20, 1), cells="quadrilateral")
    x = body.mesh.geometry.x
    x[:, 1] += height * np.sin(np.pi * x[:, 0] / 10)
    u, t = forms.displacement(body, 2), forms.load_factor(body)
    psi = forms.energies.saint_venant_kirchhoff(forms.deformation_gradient(u), 1.0, 0.0) * ufl.dx
    load = forms.dead_traction(u, (0 * t, -t * 1e-3), body.ds("top"))
    return psi + load, u, [forms.clamp(u, body.facets(side)) for side in ("left", "right")], t


def test_a_jump_is_made_on_purpose_only():
    """An arch snaps: follow stops below its limit load; with jump=True it says what was freed."""
    *scene, t = arch()
    with pytest.raises(forms.NotConverged, match="no equilibrium is connected beyond") as failed:
        forms.follow(*scene, t, to=0.05, progress=False)
    stopped = failed.value.path
    *scene, t = arch()
    path = forms.follow(*scene, t, to=0.05, jump=True, progress=False)
    assert path.completed and path.load == 0.05
    (jump,) = [event for event in path.events if event.kind == "jump"]
    assert jump.load > stopped.load and jump.released > 0
    row = next(row for row in path.ledger if row.kind == "jump")
    assert row.unaccounted == jump.released
    assert (
        path.steps[-1].convergence.negative == 0
        and f"{jump.released:.4g} J released" in path.reason
    )
    # The same by the energies of the states on either side, at nearly one load.
    before = next(b for b, c in zip(path.balances, path.balances[1:], strict=False) if c.kind)
    after = next(b for b in path.balances if b.kind)
    assert before.energy - after.energy + after.slope * (after.load - before.load) == pytest.approx(
        jump.released, rel=1e-6
    )


SCRIPT = """
import json, sys
from math import pi
from mpi4py import MPI
from test_following import rod
from variform import forms
*scene, t = rod(0.1, comm=MPI.COMM_WORLD)
path = forms.follow(*scene, t, to=pi, progress=False)
if MPI.COMM_WORLD.rank == 0:
    print(json.dumps([[s.load for s in path.steps], path.tangents,
                      [row.supports for row in path.ledger]]))
"""


def test_ranks_agree(parallel):
    """1, 2 and 3 ranks: the same steps and works."""
    one, two, three = (parallel(SCRIPT, ranks) for ranks in (1, 2, 3))
    for other in (two, three):
        assert other[0] == pytest.approx(one[0], rel=1e-6) and other[1] == one[1]
        assert other[2] == pytest.approx(one[2], rel=1e-6)


def test_the_account_is_a_table_and_a_plot(tmp_path):
    """A line a step with its joules; in the summary too; a path that loses some says where."""
    path = walk()
    lines = str(path.ledger).splitlines()
    assert lines[0].split() == "load factor stored by loads by supports unaccounted".split()
    assert len(lines) == len(path.steps) + 1
    assert float(lines[-1].split()[0]) == pytest.approx(path.load, rel=1e-5)
    assert forms.summary(path)["ledger"][-1]["supports"] == path.ledger[-1].supports
    path.ledger.plot(tmp_path / "ledger.png")
    assert (tmp_path / "ledger.png").stat().st_size > 5000
    assert "Unaccounted" not in path.reason and path.ledger.sentence() == ""
    path.balances[-1] = path.balances[-1]._replace(energy=0.0)
    lost = path.ledger
    assert f"most of it before load factor {path.load:.6g}" in lost.sentence()


def corner(**options):
    """A coarse cube pulled to three times its length: an edge of its end turns inside out."""
    body = meshes.block(MPI.COMM_SELF, (1.0, 1.0, 1.0), h=0.4)
    t, u = forms.load_factor(body), forms.displacement(body, 2)
    psi = forms.energies.fixed_corotated(forms.deformation_gradient(u), 1.0, 10.0) * ufl.dx
    moved = forms.translate(u, body.facets("right"), (2 * t, 0, 0))
    held = [forms.clamp(u, body.facets("left")), moved]
    return forms.follow(psi, u, held, t, progress=False, **options)


def test_an_inverted_corner_is_noted_or_refused():
    """By bounds that no point escapes; the path goes on where nothing jumps, or stops if asked."""
    path = corner()
    bounds = [step.bounds for step in path.steps]
    assert bounds[0].lower > 0 and bounds[-1].upper < 0 and path.completed
    since = next(s.load for s in path.steps if not s.bounds.lower > 0)
    assert f"Cells are inverted from load factor {since:.6g} on" in path.reason
    with pytest.raises(forms.NotConverged, match="[Cc]ells are inverted, J is in") as failed:
        corner(refuse_inverted=True)
    stopped = failed.value.path
    assert 0 < stopped.load < since and all(s.bounds.lower > 0 for s in stopped.steps)


@pytest.mark.parametrize("lead", **PATHS)
def test_a_run_says_how_it_went(lead, capsys):
    """One line behind the bar; nothing at all without progress."""
    path = lead(progress=True)
    said = capsys.readouterr()
    assert said.out == "" and said.err.count(path.reason) == 1
    lead(progress=False)
    assert capsys.readouterr() == ("", "")


def test_the_bar_moves_within_a_long_solve(monkeypatch, capsys):
    """Iterations, and the norm that they are to reach, are shown between two steps."""
    monkeypatch.setattr("variform.forms.solving.progress.OFTEN", 0.0)
    walk(progress=True)
    assert "to go down to" in capsys.readouterr().err


def test_multigrid_finds_the_bifurcation_that_factors_find():
    """By negative curvature that CG meets, after which MUMPS counts and locates."""
    loads = []
    for size in (5000, 0):
        body = meshes.block(MPI.COMM_SELF, (2.0, 0.2, 0.2), n=(24, 3, 3), cells="hexahedron")
        u, t = forms.displacement(body), forms.load_factor(body)
        psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0) * ufl.dx
        pressed = forms.translate(u, body.facets("right"), (-t, 0, 0))
        held = [forms.clamp(u, body.facets("left")), pressed]
        settings = Settings(direct_up_to=size)
        path = forms.follow(psi, u, held, t, to=0.12, settings=settings, progress=False)
        (event,) = path.events
        assert (event.before, event.after) == (0, 2)
        loads.append(event.load)
    assert loads[1] == pytest.approx(loads[0], rel=1e-6)


def test_loads_without_a_potential_are_accounted_for_to_high_order(tmp_path):
    """A pressure that follows a bending block: its work by forces and states, also when resumed."""

    def lead(**options):
        body = meshes.block(MPI.COMM_SELF, (1.0, 0.2, 0.2), h=0.2)
        t, u = forms.load_factor(body), forms.displacement(body, 2)
        psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 10.0) * ufl.dx
        v = ufl.TestFunction(u.function_space)
        work = forms.follower_pressure(u, 0.02 * t, v, body.ds("bottom"))
        held = [forms.clamp(u, body.facets("left"))]
        return forms.follow(psi, u, held, t, virtual_work=work, progress=False, **options)

    path = lead()
    stored = path.problem.energy()
    assert sum(row.stored for row in path.ledger) == pytest.approx(stored, rel=1e-12)
    assert path.ledger.missed < 1e-3 * path.ledger.exchanged
    missed = [lead(step=1 / n, max_step=1 / n).ledger.missed for n in (10, 20)]
    assert missed[0] > 4 * missed[1]

    def stop(path):
        if len(path.steps) == 5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        lead(checkpoint=forms.Checkpoint(tmp_path), on_step=stop)
    again = lead(checkpoint=forms.Checkpoint(tmp_path))
    assert again.resumed is not None and again.ledger == path.ledger


def test_multigrid_leads_a_problem_again():
    """Path after path on one problem: the same states, by the one SNES that it keeps."""
    *scene, t = rod(0.1, 1.5)
    problem = forms.Problem(*scene)
    ends = []
    for _ in range(3):
        scene[1].x.array[:], t.value = 0, 0
        settings = Settings(direct_up_to=0)
        path = forms.follow(problem, t=t, to=pi / 2, settings=settings, progress=False)
        ends.append((problem.energy(), path.tangents))
    assert ends[1:] == [pytest.approx(ends[0], rel=1e-12)] * 2


def test_a_step_out_of_a_singular_start_is_told():
    """A flat sheet has no stiffness against pressure: the energy is minimized, which is said."""
    body = meshes.disk(MPI.COMM_SELF, 1.0, 0.3)
    u, t = forms.displacement(body, 2), forms.load_factor(body)
    F = forms.membrane_gradient(u)
    psi = 0.01 * forms.energies.mooney_rivlin(forms.membranes.incompressible_sheet(F), 0.4, 0.1)
    potential = psi * ufl.dx - 0.01 * t * forms.enclosed_volume(u)
    held = [forms.clamp(u, body.facets("outer"))]
    path = forms.follow(potential, u, held, t, progress=False)
    assert path.completed and [row.kind for row in path.ledger].count("start") == 1
    assert path.ledger[0].kind == "start" and path.ledger[1].kind == ""
    assert "1 of the steps by minimizing the energy, from a singular state" in path.reason


class Shy(Well):
    """A weak well that lets Newton take half of each long correction."""

    def largest_step(self, step):
        longest = step.norm(PETSc.NormType.INFINITY)
        return min(1.0, 0.004 / longest) if longest > 0.004 else 1.0


def test_a_term_that_shortens_corrections_leaves_supports_where_they_are_prescribed():
    """The rest of the way is gone by the next corrections; the state is that without a bound."""
    ends = []
    for kind in (Well, Shy):
        body = meshes.block(MPI.COMM_SELF, (1.0, 1.0), n=(3, 3))
        u = forms.displacement(body)
        psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0) * ufl.dx
        moved = forms.translate(u, body.facets("right"), (0.01, 0.005))
        held = [forms.clamp(u, body.facets("left")), moved]
        newton = forms.solving.Newton(forms.Problem([psi, kind(u, 1e-3, 0.0)], u, held))
        corrector = Corrector(newton)
        assert corrector.solve(free=True).converged
        assert forms.at(u, (1.0, 0.5)) == pytest.approx([0.01, 0.005], abs=1e-12)
        ends.append(u.x.array.copy())
        corrector.destroy()
        newton.destroy()
    assert np.abs(ends[0] - ends[1]).max() < 1e-8
