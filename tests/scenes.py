# SPDX-License-Identifier: MIT
"""Scenes that scripts of several test files solve, on any number of ranks."""

from __future__ import annotations

from typing import Any, NamedTuple

from mpi4py import MPI

import ufl

from variform import forms, meshes


class Scene(NamedTuple):
    """What a path takes, a boundary that carries a force, and points whose displacement is read."""

    body: meshes.Body
    t: Any
    u: Any
    F: Any
    potential: ufl.Form
    supports: list
    held: Any
    points: list[tuple[float, ...]]

    @property
    def path(self) -> tuple[ufl.Form, Any, list, Any]:
        """What follow and control take first."""
        return self.potential, self.u, self.supports, self.t


def twist(comm: MPI.Comm, h: float, turn: float) -> Scene:
    """A bar of quadratic elements whose right end is turned by t times an angle."""
    body = meshes.block(comm, (1.0, 0.3, 0.3), h=h)
    t, u = forms.load_factor(body), forms.displacement(body, degree=2)
    F = forms.deformation_gradient(u)
    potential = forms.energies.neo_hookean(F, 1.0, 5.0) * ufl.dx
    supports = [
        forms.clamp(u, body.facets("left")),
        forms.rotate(u, body.facets("right"), turn * t, axis=(1, 0, 0)),
    ]
    points = [(0.5, 0.3, 0.3), (1.0, 0.0, 0.1), (0.21, 0.1, 0.15)]
    return Scene(body, t, u, F, potential, supports, body.facets("right"), points)


def mixed(comm: MPI.Comm, n: int, force: float) -> Scene:
    """Cook's panel, nearly incompressible, with a pressure and t times a traction on the right."""
    body = meshes.cook(comm, n=n)
    t, u = forms.load_factor(body), forms.displacement_pressure(body)
    v, p = ufl.split(u)
    F = forms.deformation_gradient(v)
    psi = forms.energies.isochoric_neo_hookean(F, 80.0)
    psi = forms.energies.with_pressure(psi, F, p, 4e5)
    pull = forms.dead_traction(v, ufl.as_vector([0 * t, force * t]), body.ds("right"))
    supports = [forms.clamp(u, body.facets("left"))]
    points = [(48.0, 60.0), (20.0, 30.0)]
    return Scene(body, t, u, F, psi * ufl.dx + pull, supports, body.facets("left"), points)
