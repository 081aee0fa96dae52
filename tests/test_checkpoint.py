# SPDX-License-Identifier: MIT
"""Checkpoints: a path that is taken up equals one without a break; which ones are kept."""

import re
import resource
import time
from functools import partial

from mpi4py import MPI

import broken_paths
import numpy as np
import pytest
import scenes
import ufl
from broken_paths import files, follow, follow_to, names, neo_hookean, shear, stop_after
from cases import at_plane, unit_mesh

from variform import forms, meshes
from variform.forms.solving.linear import presets as linear_presets


def twist():
    return scenes.twist(MPI.COMM_SELF, h=0.2, turn=1.5).path


def mixed():
    body = meshes.cook(MPI.COMM_SELF, n=4)
    t, w = forms.load_factor(body), forms.displacement_pressure(body)
    u, p = ufl.split(w)
    F = forms.deformation_gradient(u)
    soft = forms.energies.isochoric_neo_hookean(F, 80.0 * (1 + t))
    psi = forms.energies.with_pressure(soft, F, p, 4e5)
    load = forms.dead_traction(u, ufl.as_vector([0 * t, 6.0 * t]), body.ds("right"))
    return psi * ufl.dx + load, w, [forms.clamp(w, body.facets("left"))], t


def projected():
    body = meshes.block(MPI.COMM_SELF, (1.0, 0.3, 0.3), h=0.2)
    t, u = forms.load_factor(body), forms.displacement(body)
    psi = forms.energies.fixed_corotated(forms.deformation_gradient(u), 1.0, 5.0)
    turned = forms.rotate(u, body.facets("right"), 1.5 * t, axis=(1, 0, 0))
    return psi * ufl.dx, u, [forms.clamp(u, body.facets("left")), turned], t


def sheet():
    body = meshes.block(MPI.COMM_SELF, (2.0, 1.0), h=0.4)
    t, u = forms.load_factor(body), forms.displacement(body, degree=2)
    psi = partial(forms.energies.neo_hookean, mu=1.0, lmbda=2.0)
    pulled = forms.translate(u, body.facets("right"), (0.6 * t, 0.0))
    fixed = forms.clamp(u, body.facets("left"))
    return psi(forms.plane_stress(u, psi)) * ufl.dx, u, [fixed, pulled], t


def multigrid():
    return twist()


SCENES = {
    "argvalues": [twist, mixed, projected, sheet, multigrid],
    "ids": lambda make: make.__name__,
}


# The path


@pytest.mark.parametrize("make", **SCENES)
def test_a_path_taken_up_is_the_same(make, tmp_path, monkeypatch):
    """Steps, iterations, residuals and the last state are those of the path without a break.

    To the last bit: the steps before, the extrapolation, Newton's reference levels and its damping
    are the same. Only the thickness stretch of a sheet starts from another guess for its root,
    which is found to 1e-14.
    """
    options = {"projection": "always"} if make is projected else {}
    if make is multigrid:
        monkeypatch.setattr(linear_presets, "DIRECT_UP_TO", 0)
    # Kept operators of multigrid are built anew behind a checkpoint, with or without a break.
    plain = follow(make(), tmp_path / "plain", every=3, **options)
    tmp_path = tmp_path / "broken"
    follow_to(4, make(), tmp_path, every=3, **options)
    scene = make()
    path = follow(scene, tmp_path, every=3, **options)
    assert path.resumed == plain.steps[2].load and path.completed and plain.resumed is None
    assert [s.load for s in path.steps] == [s.load for s in plain.steps]
    assert np.abs(path.u.x.array - plain.u.x.array).max() < 1e-14 * np.abs(plain.u.x.array).max()
    assert float(scene[-1].value) == path.load == 1
    if make is not sheet:
        assert [s.convergence for s in path.steps] == [s.convergence for s in plain.steps]
        assert np.array_equal(path.u.x.array, plain.u.x.array)
        assert path.reason == plain.reason


def test_refused_steps_and_their_halves_are_taken_up(tmp_path):
    """Broken off after a step that was halved, the path goes on with the short steps."""
    options = {"step": 1.0, "max_step": 1.0, "options": {"snes_max_it": 2}}
    plain = follow(shear(amount=5.0), **options)
    assert plain.refused > 0
    follow_to(4, shear(amount=5.0), tmp_path, **options)
    path = follow(shear(amount=5.0), tmp_path, **options)
    assert [s.load for s in path.steps] == [s.load for s in plain.steps]
    assert path.refused == plain.refused and np.array_equal(path.u.x.array, plain.u.x.array)


def test_multigrid_that_failed_is_not_tried_again(tmp_path, monkeypatch):
    """The run that takes a path up begins with the factorization that the first one turned to."""
    failing = {"ksp_type": "cg", "pc_type": "gamg", "ksp_max_it": "1", "ksp_rtol": "1e-12"}
    monkeypatch.setattr(linear_presets, "preset", lambda *given: failing)
    plain = follow(shear())
    follow_to(3, shear(), tmp_path)
    path = follow(shear(), tmp_path)
    assert [s.convergence for s in path.steps] == [s.convergence for s in plain.steps]
    assert np.array_equal(path.u.x.array, plain.u.x.array)


def test_a_completed_path_comes_back_at_once(tmp_path, monkeypatch, capsys):
    """No solve, no file, no call of on_step; loads, records, the time and the state are there."""
    record = {"top": lambda system: forms.at(system.u, (1, 1))}
    slow = {"record": record, "on_step": lambda path: time.sleep(0.1)}
    done = follow(shear(), tmp_path, every=4, **slow)
    assert capsys.readouterr().err == ""
    before = names(tmp_path)
    monkeypatch.setattr(forms.solving.Newton, "solve", None)
    path = follow(shear(), tmp_path, on_step=stop_after(len(done.steps)))
    assert capsys.readouterr().err == f"Resumed at load factor 1 from {tmp_path}.\n"
    assert path.completed and path.reason == done.reason and path.seconds >= 0.1 * len(done.steps)
    assert np.array_equal(path.u.x.array, done.u.x.array)
    assert np.array_equal(path.record("top"), done.record("top"))
    assert names(tmp_path) == before


def test_the_way_and_the_steps_may_be_changed(tmp_path):
    """A path goes further than it was meant to; its steps become shorter or longer."""
    follow_to(3, shear(), tmp_path, to=2.0, max_step=0.15)
    shorter = follow(shear(), tmp_path, to=0.62, max_step=0.1)
    steps = np.diff([0, *(s.load for s in shorter.steps)])
    assert steps[:2] == pytest.approx([0.15, 0.15]) and steps[2:].max() < 0.1 + 1e-12
    follow(shear(), tmp_path, to=0.62001)
    further = follow(shear(), tmp_path, to=2.0, step=0.05)
    assert further.resumed == 0.62001 and further.load == 2
    assert further.steps[len(shorter.steps) + 1].load > 0.65
    plain = follow(shear(), to=2.0, rtol=1e-12)
    assert further.u.x.array == pytest.approx(plain.u.x.array, abs=1e-10)


def test_a_path_that_fails_is_saved_where_it_failed(tmp_path):
    """Whatever every is; a smaller min_step then goes on from there."""
    crushed = {"min_step": 0.02, "every": 100}
    mesh = unit_mesh(2, 2)

    def scene():
        u, t = forms.displacement(mesh), forms.load_factor(mesh)
        moved = forms.translate(u, at_plane(mesh, 0, 1.0), (-2 * t, 0.0))
        return neo_hookean(u), u, [forms.clamp(u, at_plane(mesh, 0, 0.0)), moved], t

    with pytest.raises(forms.NotConverged) as first:
        follow(scene(), tmp_path, **crushed)
    assert names(tmp_path) == files(1)
    with pytest.raises(forms.NotConverged) as second:
        follow(scene(), tmp_path, min_step=0.002)
    more = len(second.value.path.steps) - len(first.value.path.steps)
    assert names(tmp_path) == files(more, more + 1)
    assert second.value.path.resumed == first.value.path.load
    assert first.value.path.load < second.value.path.load < 0.5
    assert second.value.path.refused > first.value.path.refused


def test_records_come_back(tmp_path):
    """Numbers, texts, arrays, lists and dictionaries, to the last bit; NaN and infinities too."""
    given = {
        "number": np.float64(1 / 3),
        "whole": np.int64(7),
        "array": np.array([[1 / 3, np.nan], [np.inf, -0.0]]),
        "few": np.zeros((0, 3), np.float32),
        "deep": {"list": [1.5, "text", None, True, np.arange(3)]},
    }
    record = {name: lambda system, value=value: value for name, value in given.items()}
    follow_to(2, shear(), tmp_path, record=record)
    path = follow(shear(), tmp_path, record=record)
    for step in path.steps:
        for name in ("number", "whole", "array", "few"):
            np.testing.assert_array_equal(step.records[name], given[name])
            assert np.asarray(step.records[name]).dtype == np.asarray(given[name]).dtype
        *deep, last = step.records["deep"]["list"]
        assert deep == [1.5, "text", None, True] and np.array_equal(last, [0, 1, 2])
    assert path.record("array").shape == (len(path.steps), 2, 2)


def test_a_record_that_cannot_be_kept_is_refused_at_the_first_step(tmp_path):
    scene = shear()
    with pytest.raises(ValueError, match="lists and arrays, got set: let the record return one"):
        follow(scene, tmp_path, every=100, record={"x": lambda system: {1, 2}})
    assert float(scene[-1].value) == 0.1


# The folder


def test_two_checkpoints_are_kept(tmp_path):
    """Every third step and the end; what else is in the folder stays."""
    (tmp_path / "notes.txt").write_text("mine")
    seen = []
    look = {"on_step": lambda path: seen.append(names(tmp_path)[:-1])}
    follow(shear(), tmp_path, 3, step=0.125, max_step=0.125, **look)
    assert seen == [[], [], [], files(1), files(1), files(1), files(1, 2), files(1, 2)]
    assert names(tmp_path) == [*files(2, 3), "notes.txt"]


def test_starting_anew_replaces_the_old_checkpoints(tmp_path):
    """Not before the first new one is whole; a scratch file of a killed run is no obstacle."""
    follow(shear(), tmp_path)
    old = names(tmp_path)
    (tmp_path / "checkpoint.new").write_bytes(b"half")
    seen = []
    follow_to(3, shear(), tmp_path, every=2, resume=False)
    path = follow(
        shear(amount=0.2),
        tmp_path,
        every=2,
        resume=False,
        max_step=0.2,
        on_step=lambda path: seen.append(names(tmp_path)),
    )
    first = int(re.search(r"\d+", old[-1])[0]) + 1
    assert path.resumed is None and seen[0] == seen[1] == files(first)
    assert seen[2] == seen[3] == files(first + 1) and seen[4] == files(first + 1, first + 2)
    assert follow(shear(amount=0.2), tmp_path).resumed == 1


def test_a_broken_checkpoint_gives_way_to_the_one_before(tmp_path):
    """Cut short, or with one bit changed; where both are broken that is said."""
    plain = follow(shear())
    follow_to(4, shear(), tmp_path)
    whole = {file: file.read_bytes() for file in sorted(tmp_path.iterdir())}
    older, newer = whole
    changed = [bytearray(whole[newer]) for _ in range(2)]
    changed[0][whole[newer].index(b"NUMPY") + 200] ^= 1  # in the first state
    changed[1][whole[newer].index(b"residual")] ^= 1
    for damaged in (b"", whole[newer][:-1], whole[newer][:1000], *map(bytes, changed)):
        for file in tmp_path.iterdir():
            file.unlink()
        older.write_bytes(whole[older])
        newer.write_bytes(damaged)
        with pytest.warns(
            UserWarning, match=rf"{newer.name} is broken \(.*the one before is"
        ) as said:
            path = follow(shear(), tmp_path)
        # Where follow is called.
        assert [warning.filename for warning in said] == [broken_paths.__file__]
        assert path.resumed == plain.steps[1].load
        assert np.array_equal(path.u.x.array, plain.u.x.array)
        assert older not in tmp_path.iterdir() and newer not in tmp_path.iterdir()
    for file in tmp_path.iterdir():
        file.write_bytes(whole[older][:100])
    with pytest.raises(ValueError, match=r"is broken \(.*; .*: put back a copy, or start anew"):
        follow(shear(), tmp_path)
    assert follow(shear(), tmp_path, resume=False).resumed is None


def test_a_disk_that_is_full_ends_no_run(tmp_path):
    """One warning; the path goes on, and the last whole checkpoint is there to resume from."""
    plain = follow(shear())
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)

    def fill(path):
        if len(path.steps) == 3:
            resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limits[1]))

    try:
        with pytest.warns(UserWarning) as caught:
            path = follow(shear(), tmp_path, on_step=fill)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    (warning,) = caught
    assert re.search(r"no checkpoint of step 3 .*File too large.*run goes on", str(warning.message))
    assert warning.filename == broken_paths.__file__
    assert np.array_equal(path.u.x.array, plain.u.x.array)
    assert names(tmp_path) == files(1, 2)
    path = follow(shear(), tmp_path)
    assert path.resumed == plain.steps[1].load and path.completed
    assert names(tmp_path) == files(len(plain.steps) - 1, len(plain.steps))
