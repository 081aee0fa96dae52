# SPDX-License-Identifier: MIT
"""Checkpoints: a path that is taken up equals one without a break; a kill leaves the last whole."""

import json
import os
import re
import resource
import signal
import subprocess
import sys
import time
from collections import ChainMap
from functools import partial

from mpi4py import MPI

import basix.ufl
import numpy as np
import pytest
import ufl
from cases import at_plane, unit_mesh
from conftest import LIMIT
from dolfinx import fem
from dolfinx import mesh as dmesh

from variform import forms, meshes
from variform.forms.files.checkpoint import Archive
from variform.forms.solving.linear import presets as linear_presets


def neo_hookean(u):
    return forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 5.0) * ufl.dx


def twist():
    body = meshes.block(MPI.COMM_SELF, (1.0, 0.3, 0.3), h=0.2)
    t, u = forms.load_factor(body), forms.displacement(body, degree=2)
    turned = forms.rotate(u, body.facets("right"), 1.5 * t, axis=(1, 0, 0))
    return neo_hookean(u), u, [forms.clamp(u, body.facets("left")), turned], t


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


def shear(n=2, degree=1, amount=0.3, begin=0.0, mesh=None):
    """A unit square sheared by amount: the quick one."""
    mesh = mesh or unit_mesh(2, n)
    t, u = forms.load_factor(mesh, begin), forms.displacement(mesh, degree)
    moved = forms.translate(u, at_plane(mesh, 0, 1.0), (0.0, amount * t))
    return neo_hookean(u), u, [forms.clamp(u, at_plane(mesh, 0, 0.0)), moved], t


def multigrid():
    return twist()


SCENES = {
    "argvalues": [twist, mixed, projected, sheet, multigrid],
    "ids": lambda make: make.__name__,
}


class Stopped(Exception):
    """A run is broken off."""


def stop_after(steps):
    def stop(path):
        if len(path.steps) == steps:
            raise Stopped

    return stop


def follow(scene, folder=None, every=1, resume=True, **options):
    checkpoint = forms.Checkpoint(folder, every, resume) if folder else None
    return forms.follow(*scene, checkpoint=checkpoint, progress=False, **options)


def follow_to(steps, scene, folder, **options):
    """Follow a path that is broken off after so many steps."""
    with pytest.raises(Stopped):
        follow(scene, folder, on_step=stop_after(steps), **options)


def names(folder):
    return sorted(file.name for file in folder.iterdir())


def files(*numbers):
    return [f"checkpoint-{number:06d}.npz" for number in numbers]


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
    assert path.completed and path.reason == done.reason and path.seconds > 0.6
    assert np.array_equal(path.u.x.array, done.u.x.array)
    assert np.array_equal(path.record("top"), done.record("top"))
    assert names(tmp_path) == before


def test_the_way_and_the_steps_may_be_changed(tmp_path):
    """A path goes further than it was meant to; its steps become shorter or longer."""
    follow_to(3, shear(), tmp_path)
    shorter = follow(shear(), tmp_path, to=0.62, max_step=0.1)
    steps = np.diff([0, *(s.load for s in shorter.steps)])
    assert steps == pytest.approx([0.1, 0.15, 0.1, 0.1, 0.1, 0.07])
    follow(shear(), tmp_path, to=0.62001)
    further = follow(shear(), tmp_path, to=2.0, min_step=0.05)
    assert further.resumed == 0.62001 and further.load == 2
    assert further.steps[7].load == pytest.approx(0.67001)
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
        assert [warning.filename for warning in said] == [__file__]
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
    assert warning.filename == __file__
    assert np.array_equal(path.u.x.array, plain.u.x.array)
    assert names(tmp_path) == files(1, 2)
    path = follow(shear(), tmp_path)
    assert path.resumed == plain.steps[1].load and path.completed
    assert names(tmp_path) == files(len(plain.steps) - 1, len(plain.steps))


# Refusals


def graded():
    mesh = unit_mesh(2, 2)
    mesh.geometry.x[:, 1] **= 1.25
    return shear(mesh=mesh)


def pair(*second):
    """Two triangles, the second one's nodes in some order."""
    points = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    cells = np.array([[0, 1, 2], second])
    domain = ufl.Mesh(basix.ufl.element("P", "triangle", 1, shape=(2,)))
    return shear(mesh=dmesh.create_mesh(MPI.COMM_SELF, cells, x=points, e=domain))


OTHERS = {
    "cells": (shear, lambda: shear(n=3), r"another mesh, 8 cells and 9 nodes, this one is 18 cell"),
    "places": (shear, graded, r"nodes up to 0.0796 m away or joined otherwise"),
    "turned": (lambda: pair(0, 2, 3), lambda: pair(2, 3, 0), r"nodes up to 0 m away or joined"),
    "degree": (shear, lambda: shear(degree=2), r"another element, .*triangle, 1,.*triangle, 2,"),
}


@pytest.mark.parametrize("other", OTHERS)
def test_another_mesh_or_element_is_refused(other, tmp_path):
    """In one sentence, before anything is solved; u and t keep their values."""
    first, second, sentence = OTHERS[other]
    follow_to(2, first(), tmp_path)
    scene = second()
    with pytest.raises(ValueError, match=sentence) as error:
        follow(scene, tmp_path)
    assert str(error.value).endswith("or start anew with Checkpoint(…, resume=False).")
    assert float(scene[-1].value) == 0 and not scene[1].x.array.any()
    assert follow(scene, tmp_path, resume=False).completed


def test_another_way_is_refused(tmp_path):
    follow_to(5, shear(), tmp_path)
    with pytest.raises(ValueError, match=r"began at load factor 0, this one begins at 0.2: give"):
        follow(shear(begin=0.2), tmp_path)
    with pytest.raises(ValueError, match=r"at load factor 0.65.*the way from 0 to 0.5: start anew"):
        follow(shear(), tmp_path, to=0.5)
    with pytest.raises(ValueError, match="not on the way from 0 to -1"):
        follow(shear(), tmp_path, to=-1)


def test_another_format_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(sys.modules[Archive.__module__], "FORMAT", 7)
    follow_to(2, shear(), tmp_path)
    monkeypatch.undo()
    with pytest.raises(ValueError, match=r"has the format 7 of variform .*reads 1: go on with tha"):
        follow(shear(), tmp_path)


def test_another_kind_of_path_is_refused(tmp_path):
    scene = shear()
    follow_to(2, scene, tmp_path)
    archive = Archive(forms.Checkpoint(tmp_path), scene[1], "arc")
    with pytest.raises(ValueError, match="of another path, path of follow, this one is arc"):
        archive.read()


def test_folders_and_arguments_are_checked_first(tmp_path):
    file = tmp_path / "file"
    file.touch()
    for folder in (file, file / "run", "/proc/none/run"):
        with pytest.raises(OSError, match=rf"written in {folder} \(.*\): give another folder"):
            follow(shear(), folder)
    with pytest.raises(ValueError, match=r'needs forms.Checkpoint\("folder"\), got str'):
        forms.follow(*shear(), checkpoint="results", progress=False)
    for every in (0, 1.5):
        with pytest.raises(ValueError, match=f"every 1, 2, … steps, got every = {every}"):
            forms.Checkpoint(tmp_path, every)


def test_elements_and_meshes_that_cannot_be_told_apart_are_refused(tmp_path):
    mesh = unit_mesh(2, 2)
    submesh = dmesh.create_submesh(mesh, 2, np.arange(4, dtype=np.int32))[0]
    for V in (fem.functionspace(mesh, ("N1curl", 1)), fem.functionspace(submesh, ("P", 1))):
        with pytest.raises(ValueError, match="no submesh and a Lagrange element, got .*without"):
            Archive(forms.Checkpoint(tmp_path), fem.Function(V), "path")


# Ranks

FIELDS = """
import json, sys
from mpi4py import MPI
import basix.ufl, numpy as np
from dolfinx import fem, mesh
from variform import forms, meshes
from variform.forms.files.checkpoint import Archive

folder, what = sys.argv[1:]
comm = MPI.COMM_WORLD
bodies = {
    "gmsh": meshes.block(comm, (1.0, 0.3, 0.3), h=0.15).mesh,
    "square": mesh.create_unit_square(comm, 5, 4),
    "cube": mesh.create_unit_cube(comm, 3, 2, 2),
    "hexahedra": mesh.create_unit_cube(comm, 3, 2, 2, mesh.CellType.hexahedron),
    "surface": meshes.spherical_sheet(comm, 1.0, 0.4, 2, "octant").mesh,
}
off = {}
for name, body in bodies.items():
    cell, d = body.basix_cell(), body.geometry.dim
    vectors = [basix.ufl.element("P", cell, k, shape=(d,)) for k in (1, 2, 3)]
    mixed = basix.ufl.mixed_element([vectors[1], basix.ufl.element("P", cell, 1)])
    for degree, element in zip((1, 2, 3, "mixed"), (*vectors, mixed)):
        u = fem.Function(fem.functionspace(body, element))
        field = lambda x: np.array([np.sin(5 * x[0] + x[1]), x[1] ** 3 - x[2], x[2] * x[0]])[:d]
        for part in [u.sub(0), u.sub(1)] if degree == "mixed" else [u]:
            scalar = not part.function_space.num_sub_spaces
            part.interpolate((lambda x: 2 + field(x)[0]) if scalar else field)
        u.x.scatter_forward()
        wanted = u.x.array.copy()
        archive = Archive(forms.Checkpoint(f"{folder}/{name}{degree}"), u, "field")
        if what != "1":
            u.x.array[:] = 0
            found, other = archive.read().states
            assert not u.x.array.any()
            errors = np.abs(found - wanted).max(), np.abs(other - 2 * wanted).max()
            off[f"{name} {degree}"] = comm.allreduce(max(errors), MPI.MAX)
        outcome = forms.paths.Convergence(True, "", 2, 1, 0, 1, 0.0, 0.0, 0.0, ())
        step = forms.paths.Step(0.5, outcome, {})
        archive.write([wanted, 2 * wanted], [step] * int(what), {}, now=True)
if comm.rank == 0:
    print(json.dumps(off))
"""


def test_checkpoints_are_of_no_partition(parallel, tmp_path):
    """Written on 1, 2, 3 ranks and read on 2, 3, 1: each value is back at its point.

    P1, P2, P3, P2-P1 on tetrahedra, triangles, hexahedra and a surface in space.
    """
    for turn, ranks in enumerate((1, 2, 3, 1)):
        off = parallel(FIELDS, ranks, tmp_path / "run", turn + 1)
        assert len(off) == (20 if turn else 0)
        assert max(off.values(), default=0) < 1e-13, off


PATHS = """
import json, sys
from mpi4py import MPI
import ufl
from variform import forms, meshes

comm = MPI.COMM_WORLD
neo_hookean = forms.energies.neo_hookean


class Stopped(Exception):
    pass


def follow(scene, folder, stop, rtol):
    if scene == "twist":
        body = meshes.block(comm, (1.0, 0.3, 0.3), h=0.2)
        t, u = forms.load_factor(body), forms.displacement(body, degree=2)
        F = forms.deformation_gradient(u)
        potential = neo_hookean(F, 1.0, 5.0) * ufl.dx
        supports = [forms.clamp(u, body.facets("left")),
                    forms.rotate(u, body.facets("right"), 1.5 * t, axis=(1, 0, 0))]
        held, points = body.facets("right"), [(0.5, 0.3, 0.3), (1.0, 0.0, 0.1), (0.21, 0.1, 0.15)]
    elif scene == "mixed":
        body = meshes.cook(comm, n=4)
        t, u = forms.load_factor(body), forms.displacement_pressure(body)
        v, p = ufl.split(u)
        F = forms.deformation_gradient(v)
        psi = forms.energies.isochoric_neo_hookean(F, 80.0)
        psi = forms.energies.with_pressure(psi, F, p, 4e5)
        right = body.ds("right")
        potential = psi * ufl.dx + forms.dead_traction(v, ufl.as_vector([0 * t, 6.0 * t]), right)
        supports = [forms.clamp(u, body.facets("left"))]
        held, points = body.facets("left"), [(48.0, 60.0), (20.0, 30.0)]

    def on_step(path):
        if path.load > stop:
            raise Stopped

    path = forms.follow(potential, u, supports, t, step=0.1, max_step=0.1, on_step=on_step,
                        checkpoint=forms.Checkpoint(folder),
                        record={"load": lambda s: float(t.value)}, rtol=rtol, progress=False)
    moved = forms.displacement_of(u)
    force, moment = forms.resultant(path.problem, held)
    numbers = {
        "displacement": [forms.at(moved, point).tolist() for point in points],
        "force": force.tolist(), "moment": moment.tolist(),
        "square": forms.integral(ufl.inner(u, u) * ufl.dx),
    }
    return {"numbers": numbers, "resumed": path.resumed, "loads": path.record("load").tolist()}


found = {}
for scene, folder, stop, rtol in json.loads(sys.argv[1]):
    try:
        found[folder] = follow(scene, folder, stop, rtol)
    except Stopped:
        found[folder] = "broken off"
    except Exception as error:  # the others go on
        found[folder] = f"{type(error).__name__}: {error}"
if comm.rank == 0:
    print(json.dumps(found))
"""
PATHS_ON_RANKS = {
    "twist": ("twist", (1, 2, 3), 1e-12, 1e-8),
    "mixed": ("mixed", (3, 2, 1), 1e-12, 1e-8),
    "twist on 2": ("twist", (2, 2, 2), 1e-8, 1e-10),
}


@pytest.fixture(scope="module")
def followed(run, tmp_path_factory):
    """All paths without a break, and broken off twice: one run for each number of ranks in turn."""
    folder = tmp_path_factory.mktemp("paths")
    (folder / "script.py").write_text(PATHS)
    found = []
    for turn, stop in enumerate((0.25, 0.55, 2.0)):
        jobs = {}
        for name, (scene, ranks, rtol, _) in PATHS_ON_RANKS.items():
            jobs.setdefault(ranks[turn], []).append((scene, f"{name}, broken off", stop, rtol))
            if turn == 0:
                jobs[ranks[0]].append((scene, f"{name}, plain", 2.0, rtol))
        done = [
            run("script.py", json.dumps(paths), ranks=ranks, cwd=folder)
            for ranks, paths in jobs.items()
        ]
        answers = [json.loads(one.stdout.strip().splitlines()[-1]) for one in done]
        found.append((dict(ChainMap(*answers)), "".join(one.stderr for one in done)))
    return found


@pytest.mark.parametrize("name", PATHS_ON_RANKS)
def test_a_path_goes_on_on_ranks(name, followed):
    """Broken off twice, it ends where it ends without a break, on these or other ranks."""
    allowed = PATHS_ON_RANKS[name][-1]
    broken = f"{name}, broken off"
    wanted = followed[0][0][f"{name}, plain"]
    for turn, (answers, errors) in enumerate(followed[:2]):
        assert answers[broken] == "broken off"
        assert errors.count(f"Resumed at load factor 0.2 from {broken}") == turn
    found = followed[2][0][broken]
    assert found["resumed"] == pytest.approx(0.5) and wanted["resumed"] is None
    assert found["loads"] == wanted["loads"]
    for key, values in wanted["numbers"].items():
        off = np.abs(np.subtract(found["numbers"][key], values)).max()
        assert off < allowed * np.abs(values).max(), key


FAILURES = """
import pathlib, resource, sys, warnings
from mpi4py import MPI
import ufl
from variform import forms, meshes

comm = MPI.COMM_WORLD

def attempt(what):
    mesh = meshes.block(comm, (1.0, 1.0), n=(3 if what == "mesh" else 4, 4))
    u, t = forms.displacement(mesh), forms.load_factor(mesh)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 5.0) * ufl.dx
    supports = [forms.clamp(u, mesh.facets("left")),
                forms.translate(u, mesh.facets("right"), (0.0, 0.3 * t))]
    record = {"x": lambda system: {comm.rank}} if what == "record" else None
    folder = "/proc/none" if what == "folder" else "run"
    checkpoint = forms.Checkpoint(folder, resume=what not in ("record", "full", "shown"))
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    warnings.simplefilter("default" if what == "shown" else "error")
    if what in ("full", "shown") and comm.rank == 0:
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limits[1]))
    try:
        forms.follow(psi, u, supports, t, record=record, progress=False, checkpoint=checkpoint)
    except (Exception, Warning) as error:
        return f"{what}: {type(error).__name__} {error}\\n"
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    return f"{what}: no error\\n"

said = [attempt(what) for what in ("write", "mesh", "record", "full", "shown", "folder")]
comm.barrier()
if comm.rank == 0:
    for file in pathlib.Path("run").iterdir():
        file.write_bytes(b"PK")
comm.barrier()
said.append(attempt("broken"))
sys.stdout.write("".join(said))  # one write, so that ranks do not mix
"""


def test_errors_reach_all_ranks(run, tmp_path):
    """Each of two ranks raises the same sentence; none waits for another."""
    (tmp_path / "script.py").write_text(FAILURES)
    done = run("script.py", ranks=2, cwd=tmp_path)
    for sentence in (
        "write: no error",
        "mesh: ValueError run/checkpoint-000006.npz is of another mesh, 32 cells and 25 nodes, ",
        "record: ValueError a checkpoint keeps records of numbers",
        "full: UserWarning no checkpoint of step 1 was written in run ([Errno 27]",
        "shown: no error",
        "folder: OSError checkpoints cannot be written in /proc/none",
        "broken: ValueError run/checkpoint-000006.npz is broken (",
    ):
        assert done.stdout.count(sentence) == 2, done.stdout
    assert done.stderr.count("UserWarning: no checkpoint of step 1 was written in run (") == 2


# Kills

MOMENTS = """
import io, json, os, signal, sys, warnings
from mpi4py import MPI
import numpy as np
from variform import forms, meshes
import variform.forms.files.checkpoint

warnings.simplefilter("error")  # none is broken
checkpoint = sys.modules["variform.forms.files.checkpoint"]
die = lambda: os.kill(os.getpid(), signal.SIGKILL)
u = forms.displacement(meshes.block(MPI.COMM_SELF, (1.0, 1.0), n=(40, 40)))
size = len(u.x.array)
step = forms.paths.Step(0.5, forms.paths.Convergence(True, "", 2, 1, 0, 1, 0.0, 0.0, 0.0, ()), {})

def write(archive, number):
    archive.write(2 * [np.full(size, 1.0 * number)], number * [step], {"number": number})

class Half(io.FileIO):
    def write(self, data):
        super().write(data[: len(data) // 2])
        die()

def opened(file, mode, *rest):
    return Half(file, mode) if "w" in mode else open(file, mode, *rest)

def after(action):
    def both(*arguments, **named):
        action(*arguments, **named)
        die()
    return both

path = type(checkpoint.FilePath())
faults = {
    "half": (checkpoint, "open", opened),
    "written": (os, "fsync", lambda number: die()),
    "synced": (os, "fsync", after(os.fsync)),
    "named": (os, "replace", after(os.replace)),
    "removing": (path, "unlink", lambda *arguments, **named: die()),
    "removed": (path, "unlink", after(path.unlink)),
}
found = {}
for name, (where, what, fault) in faults.items():
    archive = checkpoint.Archive(forms.Checkpoint(name), u, "path")
    for number in (1, 2, 3):
        write(archive, number)
    child = os.fork()
    if child == 0:
        setattr(where, what, fault)
        write(archive, 4)
        os._exit(0)
    killed = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL
    again = checkpoint.Archive(forms.Checkpoint(name), u, "path")
    saved = again.read()
    number = saved.control["number"]
    same = all(np.all(state == number) for state in saved.states)
    write(again, 5)
    files = sorted(file for file in os.listdir(name))
    found[name] = [killed, number, len(saved.steps), same, len(files)]
print(json.dumps(found))
"""


def test_a_kill_at_each_moment_of_writing_leaves_a_whole_checkpoint(parallel):
    """The old one while the file is written, the new one once it has its name."""
    found = parallel(MOMENTS, 1)
    for name in ("half", "written", "synced"):
        assert found[name] == [True, 3, 3, True, 2], name
    for name in ("named", "removing", "removed"):
        assert found[name] == [True, 4, 4, True, 2], name


KILLED = """
import sys
from mpi4py import MPI
import os
import numpy as np, ufl
from variform import forms, meshes

folder, to = sys.argv[1], float(sys.argv[2])
comm = MPI.COMM_WORLD
body = meshes.block(comm, (1.0, 0.3), n=(30, 9))
t, u = forms.load_factor(body), forms.displacement(body, degree=2)
psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 5.0) * ufl.dx
supports = [forms.clamp(u, body.facets("left")),
            forms.translate(u, body.facets("right"), (0.2 * t, 0.3 * t))]
pids = comm.gather(os.getpid())

def on_step(path):
    if pids and (path.resumed is None or path.load > path.resumed):
        # In one piece: a kill between two writes would leave half a line.
        print(" ".join(map(str, [*pids, path.load])), flush=True)

checkpoint = None if folder == "none" else forms.Checkpoint(folder)
path = forms.follow(psi, u, supports, t, to=to, step=1e-4, min_step=1e-6, max_step=1e-4,
                    on_step=on_step, checkpoint=checkpoint, rtol=1e-10, progress=False)
square = forms.integral(ufl.inner(u, u) * ufl.dx)
total = u.x.petsc_vec.sum()
if comm.rank == 0:
    print(repr(square), path.load, len(path.steps), repr(total))
"""


def kill_after(delay, ranks, folder, root):
    """Start a run, kill all its ranks some seconds after its first step; last load, errors."""
    words = [sys.executable, "killed.py", "run", "1.0"]
    process = subprocess.Popen(
        ["mpirun", "-n", str(ranks), *words] if ranks > 1 else words,
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(root)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    *pids, load = process.stdout.readline().split() or [0]
    time.sleep(delay)
    for pid in map(int, pids):  # ranks have process groups of their own
        os.kill(pid, signal.SIGKILL)
    os.killpg(process.pid, signal.SIGKILL)
    out, errors = process.communicate(timeout=LIMIT)
    assert pids, errors
    return float([load, *(line.split()[-1] for line in out.splitlines())][-1]), errors


@pytest.mark.slow
@pytest.mark.parametrize(("ranks", "kills"), [(1, 20), (2, 5)])
def test_kills_at_random_moments(ranks, kills, run, root, tmp_path, rng):
    """After each kill -9 the next run resumes at the last step or, killed in writing, before it."""
    (tmp_path / "killed.py").write_text(KILLED)
    reached = 0.0
    for kill in range(kills):
        load, errors = kill_after(rng.uniform(0, 0.5), ranks, tmp_path, root)
        assert ("Resumed" in errors) == (kill > 0) and "broken" not in errors, errors
        if kill:
            resumed = float(re.search(r"Resumed at load factor (\S+) from run", errors)[1])
            assert reached - 1.01e-4 < resumed < reached + 1e-9
        assert load > reached
        reached = load
    to = reached + 1e-3
    found, wanted = (
        run("killed.py", folder, to, ranks=ranks, cwd=tmp_path).stdout.splitlines()[-1]
        for folder in ("run", "none")
    )
    if ranks == 1:
        assert found == wanted
    assert np.array(found.split(), float) == pytest.approx(np.array(wanted.split(), float), 1e-10)
