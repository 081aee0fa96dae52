# SPDX-License-Identifier: MIT
"""Rigid motions that nothing holds are named; negative eigenvalues count instabilities alone."""

from mpi4py import MPI

import basix.ufl
import numpy as np
import pytest
import ufl
from cases import at_plane, unit_mesh
from dolfinx import fem

from variform import forms, meshes
from variform.forms.solving.linear import presets as linear_presets
from variform.forms.solving.supported import free_motions

FREE = {
    "no support": ([], ["translation along x", "translation along y", "translation along z"], 3),
    "a roller": ([("x0", 0)], ["translation along y", "translation along z"], 1),
    "two rollers": ([("x0", 0), ("y0", 1)], ["translation along z"], 0),
    "three rollers": ([("x0", 0), ("y0", 1), ("z0", 2)], [], 0),
}


@pytest.mark.parametrize("mixed", [False, True])
@pytest.mark.parametrize("case", FREE)
def test_rigid_motions_that_nothing_holds_are_named(case, mixed):
    """Of a body, of a mixed unknown too; springs hold as supports do."""
    rollers, translations, rotations = FREE[case]
    mesh = unit_mesh(3, 2)
    u = forms.displacement_pressure(mesh) if mixed else forms.displacement(mesh)
    v, p = ufl.split(u) if mixed else (u, None)
    F = forms.deformation_gradient(v)
    psi = forms.energies.neo_hookean(F, 1.0, 0.0 if mixed else 2.0)
    psi = forms.energies.with_pressure(psi, F, p) if mixed else psi
    held = [forms.roller(u, at_plane(mesh, axis, 0.0), axis) for _, axis in rollers]
    found = free_motions(forms.Problem(psi * ufl.dx, u, held))
    assert [words for words in found if "translation" in words] == translations
    assert sum("rotation" in words for words in found) == rotations
    spring = forms.spring(v, 1e-3, ufl.ds(mesh))
    assert free_motions(forms.Problem(psi * ufl.dx + spring, u, held)) == []


def test_a_plane_body_on_a_pin_turns_about_it():
    mesh = unit_mesh(2, 2)
    u = forms.displacement(mesh)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0)
    system = forms.Problem(psi * ufl.dx, u, [forms.pin(u, (1, 0))])
    assert free_motions(system) == ["rotation about the axis along z through (1, 0, 0)"]


@pytest.mark.parametrize("n", [2, 8])
@pytest.mark.parametrize("energy", ["neo_hookean", "fixed_corotated"])
def test_a_body_without_any_support_is_told_apart(energy, n):
    """MUMPS fails and has to be started anew; the cause takes the place of other advice."""
    body = meshes.block(MPI.COMM_WORLD, (1.0, 0.25, 0.25), n=(n, 2, 2))
    u = forms.displacement(body)
    psi = getattr(forms.energies, energy)(forms.deformation_gradient(u), mu=1.0, lmbda=4.0)
    load = forms.body_force(u, ufl.as_vector([0.1, 0, 0]))
    with pytest.raises(forms.NotConverged) as failed:
        forms.solve(psi * ufl.dx + load, u, [])
    message = str(failed.value)
    assert (
        "kept. Nothing holds the body against translation along x, translation along y" in message
    )
    assert message.count("projected tangent") <= 1 and "Reach the load" not in message


def test_a_stable_mixed_state_has_no_negative_eigenvalue():
    """The one per pressure is left out; compressed, a column of it buckles."""
    mesh = unit_mesh(2, 4)
    w = forms.displacement_pressure(mesh)
    u, p = ufl.split(w)
    F = forms.deformation_gradient(u)
    psi = forms.energies.with_pressure(forms.energies.neo_hookean(F, 1.0, 0.0), F, p, 100.0)
    held = [
        forms.clamp(w, at_plane(mesh, 1, 0.0)),
        forms.translate(w, at_plane(mesh, 1, 1.0), (0, 0.2)),
    ]
    path = forms.solve(psi * ufl.dx, w, held)
    assert path.steps[0].convergence.negative == 0
    assert forms.negative_eigenvalues(path) == 0
    assert "Unstable" not in path.reason


SECOND_FIELDS = {
    "beside": lambda psi, a: psi + a**2 / 2 + ufl.inner(ufl.grad(a), ufl.grad(a)) / 20 - a / 10,
    "coupled": lambda psi, a: (1 - a) * psi + a**2 / 2,
}


@pytest.mark.parametrize("case", SECOND_FIELDS)
def test_a_second_field_that_is_minimized_over_counts_like_the_first(case):
    """A scalar with a positive definite block: no eigenvalue is left out, and none is negative."""
    body = meshes.block(MPI.COMM_WORLD, (1.0, 1.0), n=(4, 4))
    cell = body.mesh.basix_cell()
    fields = [basix.ufl.element("Lagrange", cell, 2, shape=(2,)), basix.ufl.element("P", cell, 1)]
    w = fem.Function(fem.functionspace(body.mesh, basix.ufl.mixed_element(fields)), name="w")
    u, a = ufl.split(w)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0)
    potential = SECOND_FIELDS[case](psi, a) * ufl.dx
    held = [
        forms.clamp(w, body.facets("left")),
        forms.translate(w, body.facets("right"), (0.1, 0)),
    ]
    path = forms.solve(potential, w, held)
    assert path.steps[0].convergence.negative == 0 == forms.negative_eigenvalues(path)
    assert "Unstable" not in path.reason


@pytest.mark.parametrize("is_pressure", [False, True])
def test_only_pressures_get_the_field_split(is_pressure, monkeypatch):
    """Above its size a displacement and a scalar: the split for a pressure, MUMPS for another."""
    monkeypatch.setattr(linear_presets, "SPLIT_FROM", {"tetrahedron": 0})
    mesh = unit_mesh(3, 2)
    w = fem.Function(forms.displacement_pressure(mesh).function_space)  # no role is declared
    u, a = ufl.split(w)
    F = forms.deformation_gradient(u)
    psi = forms.energies.neo_hookean(F, 1.0, 0.0 if is_pressure else 2.0)
    psi = forms.energies.with_pressure(psi, F, a) if is_pressure else psi + a**2 / 2
    held = [forms.clamp(w, at_plane(mesh, 0, 0.0))]
    newton = forms.solving.Newton(forms.Problem(psi * ufl.dx, w, held))
    kind = newton.snes.getKSP().getPC().getType()
    newton.destroy()
    assert kind == ("python" if is_pressure else "cholesky")


def test_three_fields_count_one_negative_eigenvalue_per_multiplier():
    """psi(J~) + p (J - J~): the pressures count, the volume ratios J~ do not."""
    body = meshes.block(MPI.COMM_WORLD, (1.0, 1.0), n=(3, 3))
    cell = body.mesh.basix_cell()
    volume = basix.ufl.element("DG", cell, 0)
    vector = basix.ufl.element("Lagrange", cell, 2, shape=(2,))
    mixed = basix.ufl.mixed_element([vector, volume, volume])
    w = fem.Function(fem.functionspace(body.mesh, mixed), name="w")
    w.sub(2).interpolate(lambda x: np.ones(x.shape[1]))
    u, p, Jt = ufl.split(w)
    F = forms.deformation_gradient(u)
    psi = forms.energies.isochoric_neo_hookean(F, 1.0) + 50 * (Jt - 1) ** 2
    held = [
        forms.clamp(w, body.facets("left")),
        forms.translate(w, body.facets("right"), (0.05, 0)),
    ]
    path = forms.solve((psi + p * (ufl.det(F) - Jt)) * ufl.dx, w, held)
    assert path.steps[0].convergence.negative == 0 == forms.negative_eigenvalues(path)


def test_an_unheld_body_is_told_at_once():
    """After one tangent, not after steps of a ten-thousandth of the way."""
    body = meshes.block(MPI.COMM_SELF, (1.0, 1.0, 1.0), n=(2, 2, 2))
    u, t = forms.displacement(body), forms.load_factor(body)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0) * ufl.dx
    pull = forms.dead_traction(u, (0.1 * t, 0, 0), body.ds("right"))
    with pytest.raises(forms.NotConverged, match="Nothing holds the body against") as failed:
        forms.follow(psi + pull, u, [], t, progress=False)
    assert failed.value.path.tangents <= 2 and "even for a step" not in str(failed.value)


def test_an_unstable_element_with_a_pressure_is_not_taken_for_a_body():
    """A square pressed to 0.7 by rollers: Taylor-Hood counts instabilities, Biot's limit is 0.54.

    Their number grows with the mesh, and plain Q2 has none; the verdict says so.
    """
    counts, reasons = [], []
    for n in (4, 8):
        body = meshes.block(MPI.COMM_SELF, (1.0, 1.0), n=(n, n), cells="quadrilateral")
        w, t = forms.displacement_pressure(body), forms.load_factor(body)
        u, p = ufl.split(w)
        F = forms.deformation_gradient(u)
        psi = forms.energies.isochoric_neo_hookean(F, 1.0)
        psi = forms.energies.with_pressure(psi, F, p, 1000.0) * ufl.dx
        held = [forms.roller(w, body.facets("left"), 0), forms.roller(w, body.facets("bottom"), 1)]
        held += [forms.translate(w, body.facets("top"), (None, -0.3 * t))]
        path = forms.follow(psi, w, held, t, progress=False)
        counts.append(path.steps[-1].convergence.negative)
        reasons.append(path.reason)
    assert 0 < counts[0] < counts[1]
    assert all("Of the discrete element, perhaps" in reason for reason in reasons)
    body = meshes.block(MPI.COMM_SELF, (1.0, 1.0), n=(4, 4), cells="quadrilateral")
    u, t = forms.displacement(body, 2), forms.load_factor(body)
    F = forms.deformation_gradient(u)
    psi = forms.energies.isochoric_neo_hookean(F, 1.0) + forms.energies.volumetric(F, 1000.0)
    held = [forms.roller(u, body.facets("left"), 0), forms.roller(u, body.facets("bottom"), 1)]
    held += [forms.translate(u, body.facets("top"), (None, -0.3 * t))]
    path = forms.follow(psi * ufl.dx, u, held, t, progress=False)
    assert path.steps[-1].convergence.negative == 0 and "Unstable" not in path.reason
