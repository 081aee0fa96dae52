# SPDX-License-Identifier: MIT
"""Checkpoints of another mesh, element, way or format are refused before anything is solved."""

import sys

from mpi4py import MPI

import basix.ufl
import numpy as np
import pytest
import ufl
from broken_paths import follow, follow_to, shear
from cases import unit_mesh
from dolfinx import fem
from dolfinx import mesh as dmesh

from variform import forms
from variform.forms.files.checkpoint import Archive


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
    follow_to(5, shear(), tmp_path, step=0.15, max_step=0.15)
    with pytest.raises(ValueError, match=r"began at load factor 0, this one begins at 0.2: give"):
        follow(shear(begin=0.2), tmp_path)
    with pytest.raises(ValueError, match=r"at load factor 0.6.*the way from 0 to 0.5: start anew"):
        follow(shear(), tmp_path, to=0.5)
    with pytest.raises(ValueError, match="not on the way from 0 to -1"):
        follow(shear(), tmp_path, to=-1)


def test_another_format_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(sys.modules[Archive.__module__], "FORMAT", 7)
    follow_to(2, shear(), tmp_path)
    monkeypatch.undo()
    with pytest.raises(ValueError, match=r"has the format 7 of variform .*reads 2: go on with tha"):
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
