# SPDX-License-Identifier: MIT
"""Loads: potentials and virtual works agree, tangents are derivatives, signs are right."""

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from cases import ENERGIES, at_plane, rates, tube_pressure, unit_mesh, whole
from dolfinx import fem
from dolfinx.mesh import meshtags

from variform import forms, meshes


def facet_measure(mesh, facets):
    tags = meshtags(mesh, mesh.topology.dim - 1, np.sort(facets), np.full(len(facets), 1, np.int32))
    return ufl.Measure("ds", domain=mesh, subdomain_data=tags)(1)


def vector(form):
    return fem.assemble_vector(fem.form(form)).array


@pytest.mark.parametrize("dim", [2, 3])
def test_pressure_on_a_closed_boundary_has_the_volume_as_potential(dim, rng):
    """D (p V)[v] = p int n . v da on the whole boundary, for any deformation."""
    mesh = unit_mesh(dim, 2)
    u = forms.displacement(mesh, degree=2)
    u.x.array[:] = 0.05 * rng.normal(size=u.x.array.size)
    ds = facet_measure(mesh, whole(mesh))(metadata={"quadrature_degree": 6})
    v = ufl.TestFunction(u.function_space)
    work = vector(forms.follower_pressure(u, 1.7, v, ds))
    potential = forms.pressure_potential(u, 1.7, ds)
    gradient = vector(forms.residual(potential, u))
    assert np.abs(gradient - work).max() < 1e-12 * np.abs(work).max()
    F = forms.deformation_gradient(u)
    volume = forms.volume(F, ufl.dx(mesh, metadata={"quadrature_degree": 6}))
    assert forms.integral(potential) == pytest.approx(1.7 * volume, rel=1e-12)


def test_pressure_potential_with_symmetry_planes(rng):
    """A rim that slides in coordinate planes through the origin adds no force of its own."""
    mesh = unit_mesh(3, 2)
    u = forms.displacement(mesh)
    u.x.array[:] = 0.1 * rng.normal(size=u.x.array.size)
    free = np.full(u.x.array.size, True)
    for axis in range(3):
        roller = forms.roller(u, at_plane(mesh, axis, 0.0), axis)
        fixed = roller.conditions[0].dof_indices()[0]
        u.x.array[fixed], free[fixed] = 0, False
    loaded = np.concatenate([at_plane(mesh, axis, 1.0) for axis in range(3)])
    ds = facet_measure(mesh, loaded)(metadata={"quadrature_degree": 4})
    v = ufl.TestFunction(u.function_space)
    difference = vector(forms.follower_pressure(u, 1.0, v, ds))
    difference -= vector(forms.residual(forms.pressure_potential(u, 1.0, ds), u))
    assert np.abs(difference[free]).max() < 1e-14
    assert np.abs(difference[~free]).max() > 1e-3  # there the rim's force is real


def test_follower_pressure_pushes_against_the_normal():
    """A pressure on x = 1 of the undeformed cube pushes along -x with force p A."""
    mesh = unit_mesh(3)
    u = forms.displacement(mesh)
    ds = facet_measure(mesh, at_plane(mesh, 0, 1.0))
    work = vector(forms.follower_pressure(u, 2.5, ufl.TestFunction(u.function_space), ds))
    assert -work.reshape(-1, 3).sum(axis=0) == pytest.approx([-2.5, 0, 0], abs=1e-14)


def test_follower_pressure_turns_with_the_body():
    """After a rotation Q the force of the pressure is Q times the old one."""
    mesh = unit_mesh(3)
    u = forms.displacement(mesh)
    c, s = np.cos(0.7), np.sin(0.7)
    Q = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    u.interpolate(lambda x: (Q - np.eye(3)) @ x)
    ds = facet_measure(mesh, at_plane(mesh, 0, 1.0))
    work = vector(forms.follower_pressure(u, 2.5, ufl.TestFunction(u.function_space), ds))
    assert -work.reshape(-1, 3).sum(axis=0) == pytest.approx(Q @ [-2.5, 0, 0], abs=1e-14)


@pytest.mark.parametrize("dim", [2, 3])
def test_follower_tangent_is_the_derivative(dim, rng):
    """R(u + h v) = R + h K v + O(h^2); K is not symmetric on an open boundary."""
    mesh = unit_mesh(dim)
    u = forms.displacement(mesh, degree=2)
    u.x.array[:] = 0.1 * rng.normal(size=u.x.array.size)
    ds = facet_measure(mesh, at_plane(mesh, 0, 1.0))(metadata={"quadrature_degree": 4})
    work = forms.follower_pressure(u, 1.0, ufl.TestFunction(u.function_space), ds)
    K = fem.assemble_matrix(fem.form(forms.tangent(work, u))).to_dense()
    assert np.abs(K - K.T).max() > 0.01 * np.abs(K).max()
    start, v = u.x.array.copy(), rng.normal(size=u.x.array.size)
    R, remainders = vector(work), []
    for h in (0.1, 0.05, 0.025):
        u.x.array[:] = start + h * v
        remainders.append(np.abs(vector(work) - R - h * K @ v).max())
    if dim == 2:  # the normal of a curve is linear in u: no remainder at all
        assert max(remainders) < 1e-13
    else:
        assert rates(remainders) == pytest.approx(2, abs=0.05)


def test_dead_loads_and_springs_have_the_forces_they_name():
    """- D load[v] sums to the force: b V, t A; a spring pulls back with k A per displacement."""
    mesh = unit_mesh(3, 2)
    u = forms.displacement(mesh)
    ds = facet_measure(mesh, at_plane(mesh, 2, 1.0))
    forces = {
        "body": (forms.body_force(u, (0.1, 0.2, 0.3)), [0.1, 0.2, 0.3]),
        "dead": (forms.dead_traction(u, ufl.as_vector([1.0, 0, -2]), ds), [1, 0, -2]),
    }
    for load, force in forces.values():
        summed = -vector(forms.residual(load, u)).reshape(-1, 3).sum(axis=0)
        assert summed == pytest.approx(force, abs=1e-14)
    u.interpolate(lambda x: (0.1 + 0 * x[0], 0 * x[0], 0.2 + 0 * x[0]))
    spring = vector(forms.residual(forms.spring(u, 5.0, ds), u)).reshape(-1, 3).sum(axis=0)
    assert spring == pytest.approx([0.5, 0, 1.0], abs=1e-14)
    along = forms.spring(u, 5.0, ds, ufl.as_vector([0, 0, 1.0]))
    assert vector(forms.residual(along, u)).reshape(-1, 3).sum(axis=0) == pytest.approx([0, 0, 1])


def test_axisymmetric_follower_pressure_is_the_volume_derivative(rng):
    """In the meridian plane: D (p V)[v] for the ring between r = 0 and r = 1, the sides fixed."""
    mesh = unit_mesh(2, 2)
    u = forms.displacement(mesh)
    u.x.array[:] = 0.05 * rng.normal(size=u.x.array.size)
    F, ring = forms.axisymmetric(u), forms.circumference(u)
    dx = ufl.dx(metadata={"quadrature_degree": 6})
    volume = vector(forms.residual(1.3 * ring * ufl.det(F) * dx, u))
    # The boundary at r = 0 has no area: the pressure acts on the other three sides.
    sides = np.concatenate([at_plane(mesh, 0, 1.0), at_plane(mesh, 1, 0.0), at_plane(mesh, 1, 1.0)])
    ds = facet_measure(mesh, sides)(metadata={"quadrature_degree": 6})
    v = ufl.TestFunction(u.function_space)
    work = vector(forms.follower_pressure(u, 1.3, v, ds, F))
    weighted = vector(forms.follower_pressure(u, 1.3 * ring, v, ds, F))
    assert np.abs(work - weighted).max() < 1e-15
    on_axis = fem.locate_dofs_geometrical(u.function_space, lambda x: np.isclose(x[0], 0))
    free = np.setdiff1d(np.arange(len(work)), np.concatenate([2 * on_axis, 2 * on_axis + 1]))
    assert np.abs(work - volume)[free].max() < 1e-12


@pytest.mark.parametrize("given", [False, True])
def test_axisymmetric_pressure_has_the_volume_as_potential(given, rng):
    """D potential[v] = p int n . v da where the rim moves in planes z = const, and it is p V.

    Whether F is given, or known from the energy that the load is added to.
    """
    mesh = unit_mesh(2, 2)
    mesh.geometry.x[:, 0] += 0.5
    u = forms.displacement(mesh)
    u.x.array[:] = 0.05 * rng.normal(size=u.x.array.size)
    rims = fem.locate_dofs_geometrical(u.function_space, lambda x: np.abs(x[1] - 0.5) > 0.49)
    u.x.array[2 * rims + 1] = 0
    F, ring = forms.axisymmetric(u), forms.circumference(u)
    energy = forms.energies.neo_hookean(F, 1.0, 2.0) * ring * ufl.dx
    ds = facet_measure(mesh, at_plane(mesh, 0, 1.5))(metadata={"quadrature_degree": 6})
    v = ufl.TestFunction(u.function_space)
    load = forms.pressure_potential(u, 1.3, ds, F if given else None)
    work = vector(forms.follower_pressure(u, 1.3, v, ds, F))
    both = forms.compiled(forms.residual(energy + load, u))
    alone = forms.compiled(forms.residual(energy, u))
    gradient = fem.assemble_vector(both).array - fem.assemble_vector(alone).array
    free = np.setdiff1d(np.arange(len(work)), 2 * rims + 1)
    assert np.abs(gradient - work)[free].max() < 1e-13
    assert np.abs(work).max() > 0.1
    # The cylinder between the axis and the surface r = 1.5 + u_r.
    r = 1.5 + u[0]
    volume = forms.integral(np.pi * r**2 * (1 + ufl.grad(u)[1, 1]) * ds)
    value = forms.integral(energy + load) - forms.integral(energy)
    assert value == pytest.approx(1.3 * volume, rel=1e-12)


PRESSURES = {
    "potential": lambda u, p, v, ds, F: (forms.pressure_potential(u, p, ds), None),
    "potential with F": lambda u, p, v, ds, F: (forms.pressure_potential(u, p, ds, F), None),
    "work": lambda u, p, v, ds, F: (0, forms.follower_pressure(u, p, v, ds)),
    "work with F": lambda u, p, v, ds, F: (0, forms.follower_pressure(u, p, v, ds, F)),
}


@pytest.mark.parametrize("way", PRESSURES)
def test_a_thick_tube_is_blown_up_by_each_pressure(way):
    """Mooney-Rivlin 80, 20 (mu = 200), radii 7 and 18.625, p = 100: the inner grows by 3.2115."""
    body = meshes.block(
        MPI.COMM_SELF, (11.625, 1.0), n=(16, 1), cells="quadrilateral", origin=(7.0, 0)
    )
    w, t = forms.displacement_pressure(body), forms.load_factor(body)
    (u, p), v = ufl.split(w), ufl.split(ufl.TestFunction(w.function_space))[0]
    F = forms.axisymmetric(u)
    psi = forms.energies.with_pressure(forms.energies.mooney_rivlin(F, 80.0, 20.0), F, p)
    load, work = PRESSURES[way](u, 100 * t, v, body.ds("left"), F)
    path = forms.follow(
        psi * forms.circumference(u) * ufl.dx + load,
        w,
        [forms.roller(w, body.facets("bottom", "top"), 1)],
        t,
        virtual_work=work,
        progress=False,
    )
    grown = forms.at(forms.displacement_of(path.u), (7.0, 0.5))[0]
    assert grown == pytest.approx(3.2115, abs=5e-5)
    # 16 elements of degree 2: 2e-7.
    assert tube_pressure(7.0, 18.625, 7.0 + grown, 200.0) == pytest.approx(100, rel=1e-6)


def test_bad_loads_are_refused():
    mesh = unit_mesh(2)
    u = forms.displacement(mesh)
    x = ufl.SpatialCoordinate(mesh)
    with pytest.raises(ValueError, match=r"body force needs the shape \(2,\).* got \(3,\)"):
        forms.body_force(u, (0, 0, 1))
    with pytest.raises(ValueError, match=r"traction needs the shape \(2,\).* got \(\)"):
        forms.dead_traction(u, 1.0, ufl.ds)
    with pytest.raises(ValueError, match=r"as body.ds\(.right.\), got ndarray"):
        forms.dead_traction(u, np.array([1.0, 0.0]), at_plane(mesh, 0, 0.0))
    v = ufl.TestFunction(u.function_space)
    with pytest.raises(ValueError, match=r"the order is \(u, p, v, ds\)"):
        forms.follower_pressure(u, v, 1.0, ufl.ds)
    w = forms.displacement_pressure(mesh)
    with pytest.raises(ValueError, match=r"shape \(2,\), got \(3,\); of a mixed unknown"):
        forms.pressure_potential(w, 1.0, ufl.ds)
    for varying in (x[0], u[0]):
        with pytest.raises(ValueError, match="varies in space has no potential"):
            forms.pressure_potential(u, varying, ufl.ds)
    assert ENERGIES
