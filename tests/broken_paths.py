# SPDX-License-Identifier: MIT
"""Paths that are broken off after some steps, and taken up again."""

import pytest
import ufl
from cases import at_plane, unit_mesh

from variform import forms


def neo_hookean(u):
    return forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 5.0) * ufl.dx


def shear(n=2, degree=1, amount=0.3, begin=0.0, mesh=None):
    """A unit square sheared by amount: the quick one."""
    mesh = mesh or unit_mesh(2, n)
    t, u = forms.load_factor(mesh, begin), forms.displacement(mesh, degree)
    moved = forms.translate(u, at_plane(mesh, 0, 1.0), (0.0, amount * t))
    return neo_hookean(u), u, [forms.clamp(u, at_plane(mesh, 0, 0.0)), moved], t


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
