# SPDX-License-Identifier: MIT
"""The one loop of all paths: each control saves, goes on bit by bit, and tells how it went."""

from mpi4py import MPI

import numpy as np
import pytest
import scenes
from broken_paths import Stopped, files, names, stop_after
from broken_paths import neo_hookean as solid
from test_control import sphere
from test_problems import Well

from variform import forms, meshes

STRETCHES = (1.05, 1.15, 1.3, 1.5, 1.8, 3.0)


def targets(once=False, **options):
    """A balloon's volumes."""
    potential, u, held, p, volume = sphere(0.5, 1)
    aims = forms.integral(volume) * np.array(STRETCHES) ** 3
    scene = (forms.Problem(potential, u, held),) if once else (potential, u, held)
    options = {"q": p, "functional": volume, "targets": aims, "progress": False} | options
    return forms.control(*scene, **options)


def arc(once=False, **options):
    """A block that is bent, in lengths of its own choice."""
    body = meshes.block(MPI.COMM_SELF, (4.0, 1.0), n=(8, 2), cells="quadrilateral")
    u, q = forms.displacement(body), forms.load_factor(body)
    load = forms.dead_traction(u, (0 * q, -0.2 * q), body.ds("right"))
    held = [forms.clamp(u, body.facets("left"))]
    scene = (forms.Problem(solid(u) + load, u, held),) if once else (solid(u) + load, u, held)
    options = {"q": q, "step": 0.1, "to": 1.0, "progress": False} | options
    return forms.arc_length(*scene, **options)


def walk(once=False, **options):
    """A block that is twisted by load steps."""
    *scene, t = scenes.twist(MPI.COMM_SELF, h=0.2, turn=1.5).path
    scene = (forms.Problem(*scene),) if once else scene
    return forms.follow(*scene, t=t, **{"progress": False, **options})


PATHS = {"argvalues": [walk, targets, arc], "ids": ["follow", "control", "arc_length"]}


@pytest.mark.parametrize("lead", **PATHS)
def test_a_path_broken_off_goes_on_bit_by_bit(lead, tmp_path):
    """Loads, iterations, residuals, records and the last state are those without a break."""
    options = {"record": {"least": lambda problem: float(problem.u.x.array.min())}}
    plain = lead(checkpoint=forms.Checkpoint(tmp_path / "plain"), **options)
    broken = {"checkpoint": forms.Checkpoint(tmp_path / "broken"), **options}
    with pytest.raises(Stopped):
        lead(on_step=stop_after(3), **broken)
    path = lead(**broken)
    assert len(plain.steps) > 4 and plain.resumed is None
    assert path.resumed == plain.steps[1].load and path.completed
    assert path.steps == plain.steps and path.refused == plain.refused
    assert np.array_equal(path.u.x.array, plain.u.x.array)
    assert path.reason == plain.reason


@pytest.mark.parametrize("lead", **PATHS)
def test_a_problem_leads_the_same_path(lead):
    """A Problem in place of potential, unknown and supports: step for step the same."""
    parts, whole = lead(), lead(once=True)
    assert whole.steps == parts.steps and np.array_equal(whole.u.x.array, parts.u.x.array)


@pytest.mark.parametrize("lead", **PATHS)
def test_a_completed_path_comes_back_at_once(lead, tmp_path):
    """A second run solves nothing, and hands on the same steps."""
    first = lead(checkpoint=forms.Checkpoint(tmp_path))
    kept = names(tmp_path)
    more = stop_after(len(first.steps) + 1)
    second = lead(checkpoint=forms.Checkpoint(tmp_path), on_step=more)
    assert second.steps == first.steps and second.completed and names(tmp_path) == kept


@pytest.mark.parametrize("lead", **PATHS)
def test_an_interrupt_names_the_checkpoint(lead, tmp_path, capsys):
    """Ctrl-C during a step: the states so far are in the folder that the sentence names."""

    def interrupt(path):
        if len(path.steps) == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        lead(checkpoint=forms.Checkpoint(tmp_path), on_step=interrupt)
    sentence = f"Interrupted: the last checkpoint is in {tmp_path}."
    assert sentence in capsys.readouterr().err and names(tmp_path) == files(1, 2)


@pytest.mark.parametrize("lead", **PATHS)
def test_a_path_tells_how_it_went(lead):
    """At most ten lines: unknowns, load factors, steps, iterations, its end and its records."""
    path = lead(record={"least": lambda problem: float(problem.u.x.array.min())})
    words = repr(path)
    assert len(words.splitlines()) <= 10
    iterations = sum(step.convergence.iterations for step in path.steps)
    for part in (
        f"{path.problem.size} unknowns",
        f"to {path.load:.6g} in {len(path.steps)} steps ({path.refused} refused)",
        f"{iterations} iterations",
        path.reason,
        "recorded: least",
    ):
        assert part in words


def test_a_checkpoint_that_would_forget_is_refused(tmp_path):
    """A term's own state is in no checkpoint: said before the first step."""
    *scene, t = scenes.twist(MPI.COMM_SELF, h=0.2, turn=1.5).path
    potential, u, held = scene
    problem = forms.Problem([potential, Well(u, 1.0, 0.0)], u, held)
    with pytest.raises(ValueError, match="holds the unknown only, and terms keep more, 1:calls:"):
        forms.follow(problem, t=t, checkpoint=forms.Checkpoint(tmp_path), progress=False)
    assert names(tmp_path) == [] and not u.x.array.any()
