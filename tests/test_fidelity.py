# SPDX-License-Identifier: MIT
"""The benchmark of fidelity: paths against small steps, and what tells right from wrong."""

import json

import pytest

from demos.benchmarks import fidelity, fidelity_felupe, small_steps
from variform import forms


def test_benchmark_of_fidelity_runs(run, tmp_path):
    """Four cheap paths end where small steps do, one of them at a limit point before the end."""
    done = run("-m", "demos.benchmarks.fidelity", "--small", cwd=tmp_path)
    rows = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    ours = [row for row in rows if row["solver"] == "variform"]
    assert len(rows) == 12 and {row["verdict"] for row in ours} == {"right"}
    ends = {row["scene"]: row["part"] for row in ours if row["part"] < 1}
    # 1.2394 of 1.3 from 0.2 on, the limit pressure of a sphere, and that of its mesh.
    assert list(ends) == ["ball, blow 1300, sheet, P2 0.25"]
    assert list(ends.values()) == pytest.approx([(1.2394 - 0.2) / 1.1], abs=0.005)
    assert all(row["off"] < 1e-6 for row in ours if row["part"] == 1)
    assert all(row["unaccounted"] < 1e-3 for row in ours)
    assert (tmp_path / "results" / "fidelity.csv").stat().st_size > 1000


@pytest.mark.skipif(not fidelity_felupe.is_there(), reason="FElupe is not installed")
def test_felupe_ends_where_small_steps_do():
    """With its own elements and energies: nodes, supports and moduli are those of the scene."""
    (name,) = fidelity.chosen(["cube, shear 100, saint_venant_kirchhoff"])
    assert fidelity_felupe.can_express(name)
    assert not fidelity_felupe.can_express("bar, twist 90, fibers 5, P2 0.1")
    row = fidelity.by_felupe(fidelity.build(name), json.loads(fidelity.FILE.read_text())[name])
    assert row["verdict"] == "right" and row["off"] < 1e-6 and row["tangents"] > fidelity.STEPS


def test_fidelity_tells_wrong_from_right():
    """Small steps find what is kept; a state mirrored or short of the end is not taken for it."""
    (name,) = fidelity.chosen(["strip, tip 2,"])
    kept, scene = json.loads(fidelity.FILE.read_text())[name], fidelity.build(name)
    run = small_steps.walk(scene, 20)
    assert fidelity.verdict(scene, kept, run.load) == ("right", pytest.approx(0, abs=1e-8))
    assert scene.problem.energy() == pytest.approx(kept["energy"], rel=1e-8)
    # The trapezoidal rule's error falls with the square of the steps.
    assert kept["missed"][0] / kept["missed"][1] == pytest.approx(4, abs=0.3)
    scene.u.x.array[1::2] *= -1  # bent the other way, as long and with as much energy stored
    assert fidelity.verdict(scene, kept, run.load)[0] == "wrong"
    assert fidelity.verdict(scene, kept, run.load, noted=["a bifurcation"])[0] == "noted"
    assert fidelity.verdict(scene, kept, 0.99)[0] == "stopped"
    stops = {**kept, "reached": False, "load": 0.98}
    assert fidelity.verdict(scene, stops, 0.99)[0] == "right"
    assert fidelity.verdict(scene, stops, 0.95)[0] == "stopped"
    assert fidelity.verdict(scene, stops, 1.0)[0] == "wrong"


def test_fidelity_has_references():
    """Forty scenes and more, each with a reference, nine tenths of them beyond doubt."""
    kept = json.loads(fidelity.FILE.read_text())
    assert list(kept) == list(fidelity.NAMES) and len(kept) >= 40
    certain = [each for each in kept.values() if not each["doubts"]]
    assert len(certain) >= 0.9 * len(kept)


def test_an_event_that_factors_have_missed_is_found_afterwards():
    """A strut buckles just before a state whose last factors were those of an iterate before it.

    The next state's count tells; small steps pass the bifurcation at 0.529204.
    """
    (name,) = fidelity.chosen(["rod, column 12,"])
    scene = fidelity.build(name)
    scene.reset()
    path = forms.follow(scene.problem, t=scene.t, to=scene.to, progress=False)
    assert path.completed
    kept = json.loads(fidelity.FILE.read_text())[name]
    assert fidelity.verdict(scene, kept, path.load)[0] == "right"
    (event,) = path.events
    assert (event.kind, event.before, event.after) == ("bifurcation", 0, 1)
    assert event.load == pytest.approx(0.529204, abs=1e-5)
    for step in path.steps:
        assert step.convergence.negative == (step.load > event.load)
