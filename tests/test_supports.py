# SPDX-License-Identifier: MIT
"""Supports: rigid motions are exact, follow the load factor, and bad ones are refused."""

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from cases import at_plane, unit_mesh
from dolfinx import fem
from dolfinx.mesh import CellType, create_box

from variform import forms, meshes


def apply(u, *supports):
    for support in supports:
        support.update()
        for condition in support.conditions:
            condition.set(u.x.array)


def rotation(axis, angle):
    k = np.asarray(axis, float) / np.linalg.norm(axis)
    K = np.cross(np.eye(3), k)
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("mixed", [False, True])
def test_rotation_is_rigid_and_follows_the_load(degree, mixed):
    """U = (R - I)(X - c) + shift at every node of the facets at any load; free elsewhere."""
    mesh = unit_mesh(3, 2)
    w = forms.displacement_pressure(mesh) if mixed else forms.displacement(mesh, degree)
    t = forms.load_factor(mesh)
    axis, center, shift = (1, 2, -1), np.array([1.0, 0.2, 0.3]), np.array([0.5, 0.0, -0.1])
    facets = at_plane(mesh, 0, 1.0)
    turn = forms.rotate(w, facets, 2 * t, axis, center, shift=[t * s for s in shift])
    for load in (0.0, 0.4, 3.0):
        t.value = load
        apply(w, turn)
        u = forms.displacement_of(w)
        X = u.function_space.tabulate_dof_coordinates()
        moved = u.x.array.reshape(-1, 3)
        wanted = (X - center) @ (rotation(axis, 2 * load) - np.eye(3)).T + load * shift
        on = np.isclose(X[:, 0], 1)
        assert np.abs(moved - wanted)[on].max() < 1e-14
        assert np.abs(moved[~on]).max() == 0


def test_rotation_center_is_the_middle_of_the_facets():
    mesh = unit_mesh(2, 2)
    u, t = forms.displacement(mesh), forms.load_factor(mesh, np.pi)
    apply(u, forms.rotate(u, at_plane(mesh, 0, 1.0), t))
    corner = forms.at(u, (1.0, 0.0))
    assert corner == pytest.approx([0.0, 1.0], abs=1e-14)


def test_components_are_prescribed_one_by_one():
    """translate(0.2 t, None, 0): the second component stays free."""
    mesh = unit_mesh(3)
    u, t = forms.displacement(mesh), forms.load_factor(mesh, 2.0)
    u.x.array[:] = 7.0
    apply(u, forms.translate(u, at_plane(mesh, 1, 1.0), (0.2 * t, None, 0.0)))
    values = u.x.array.reshape(-1, 3)
    on = np.isclose(u.function_space.tabulate_dof_coordinates()[:, 1], 1)
    assert values[on] == pytest.approx(np.tile([0.4, 7.0, 0.0], (on.sum(), 1)))
    assert np.all(values[~on] == 7)


def test_clamp_and_roller():
    mesh = unit_mesh(2)
    u = forms.displacement(mesh)
    u.x.array[:] = 7.0
    apply(u, forms.roller(u, at_plane(mesh, 0, 0.0), 0), forms.clamp(u, at_plane(mesh, 1, 0.0)))
    x = u.function_space.tabulate_dof_coordinates()
    values = u.x.array.reshape(-1, 2)
    assert np.all(values[np.isclose(x[:, 1], 0)] == 0)
    corner = np.isclose(x[:, 0], 0) & np.isclose(x[:, 1], 1)
    assert values[corner].ravel() == pytest.approx([0.0, 7.0])


@pytest.mark.parametrize("mixed", [False, True])
def test_every_node_of_the_facets_is_reached(mixed):
    """Few cells and nodes: each cell that touches the facets is evaluated, whatever its number."""
    mesh = create_box(
        MPI.COMM_SELF, [[0, 0, 0], [4, 1, 1]], [4, 1, 1], cell_type=CellType.hexahedron
    )
    w = forms.displacement_pressure(mesh) if mixed else forms.displacement(mesh, 2)
    t = forms.load_factor(mesh, 0.5)
    for axis, place in ((0, 0.0), (0, 4.0), (1, 1.0)):
        w.x.array[:] = 0
        apply(w, forms.translate(w, at_plane(mesh, axis, place), (0.2 * t, t, -t)))
        u = forms.displacement_of(w)
        on = np.isclose(u.function_space.tabulate_dof_coordinates()[:, axis], place)
        values = u.x.array.reshape(-1, 3)
        assert np.abs(values[on] - [0.1, 0.5, -0.5]).max() < 1e-15
        assert np.all(values[~on] == 0)


def test_numbers_of_any_kind_are_values():
    """Python, NumPy and UFL numbers, 0 * t among them."""
    mesh = unit_mesh(3)
    u, t = forms.displacement(mesh), forms.load_factor(mesh)
    apply(u, forms.translate(u, at_plane(mesh, 0, 1.0), (0 * t, np.int64(2), np.float64(0.5))))
    assert forms.at(u, (1, 1, 1)) == pytest.approx([0, 2, 0.5])


def test_prescribed_field_of_the_reference_point():
    """Any UFL expression of X and t: bending a face into a parabola."""
    mesh = unit_mesh(3, 2)
    u, t = forms.displacement(mesh, degree=2), forms.load_factor(mesh, 0.5)
    X = ufl.SpatialCoordinate(mesh)
    apply(u, forms.prescribe(u, at_plane(mesh, 2, 1.0), (0.0, 0.0, t * X[0] * (1 - X[0]))))
    assert forms.at(u, (0.5, 0.5, 1.0)) == pytest.approx([0, 0, 0.125], abs=1e-14)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda u, f: forms.translate(u, f, (0.0, 0.0)), r"needs 3 values.* got \(0.0, 0.0\)"),
        (lambda u, f: forms.translate(u, f, (None,) * 3), "at least one value"),
        (lambda u, f: forms.roller(u, f, 3), "axis from 0 to 2, got 3"),
        (lambda u, f: forms.rotate(u, f, 1.0, (0, 0, 0)), r"not all zero; got \(0, 0, 0\)"),
        (lambda u, f: forms.clamp(u, f[:0]), "got none on any rank"),
        (lambda u, f: forms.clamp(u, "left"), r'as body.facets\("left"\), got str left'),
        (lambda u, f: forms.clamp(u, u), "local facet indices.* got Unknown"),
        (lambda u, f: forms.clamp(u, f + 1000), "2 of 2 facets are not of this unknown's mesh"),
        (lambda u, f: forms.clamp(f, u), "needs the unknown itself.* got ndarray"),
        (lambda u, f: forms.clamp(ufl.split(u)[0], f), "needs the unknown itself.* got Indexed"),
        (lambda u, f: forms.translate(u, f, 0.1), "needs 3 values.* got 0.1"),
        (lambda u, f: forms.translate(u, f, (0, 0, lambda x: x)), "scalar UFL.* got function"),
        (
            lambda u, f: forms.translate(u, f, (ufl.FacetNormal(u.function_space.mesh)[0], 0, 0)),
            "at nodes, where there is no facet normal",
        ),
        (lambda u, f: forms.rotate(u, f, (1, 0, 0)), "scalar UFL expression.* got tuple"),
        (lambda u, f: forms.roller(fem.Function(scalar(u)), f, 0), "got u of f.* with 1"),
        (lambda u, f: forms.displacement(u.function_space.mesh, 0), "at least 1, got 0"),
        (lambda u, f: forms.displacement_pressure(u.function_space.mesh, 1), "at least 2, got 1"),
    ],
)
def test_bad_supports_are_refused(call, message):
    mesh = unit_mesh(3)
    with pytest.raises(ValueError, match=message):
        call(forms.displacement(mesh), at_plane(mesh, 0, 0.0))


def test_linear_displacements_of_curved_cells_are_refused():
    """They do not contain rotations: 90 degrees gave stresses of 4 mu."""
    body = meshes.block(MPI.COMM_SELF, (1.0, 1.0), n=1, order=2)
    with pytest.raises(
        ValueError, match="degree 1 cannot rotate a mesh of order 2 rigidly: take d"
    ):
        forms.displacement(body, 1)
    assert forms.displacement(body, 2).x.array.size == 18


def test_plane_rotation_needs_the_normal_as_axis():
    mesh = unit_mesh(2)
    with pytest.raises(ValueError, match=r"axis \(0, 0, 1\), got \(1, 0, 0\)"):
        forms.rotate(forms.displacement(mesh), at_plane(mesh, 0, 0.0), 1.0, (1, 0, 0))


def scalar(u):
    return fem.functionspace(u.function_space.mesh, ("Lagrange", 1))
