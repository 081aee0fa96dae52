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


CELLS = {
    "triangle": lambda order: meshes.block(MPI.COMM_SELF, (1.0, 1.0), n=4, order=order),
    "quadrilateral": lambda order: meshes.block(
        MPI.COMM_SELF, (1.0, 1.0), n=4, cells="quadrilateral", order=order
    ),
    "tetrahedron": lambda order: meshes.block(MPI.COMM_SELF, (1.0, 1.0, 1.0), n=4, order=order),
    "hexahedron": lambda order: meshes.block(
        MPI.COMM_SELF, (1.0, 1.0, 1.0), n=4, cells="hexahedron", order=order
    ),
}


@pytest.mark.parametrize("cells", CELLS)
@pytest.mark.parametrize("degree", [1, 2, 3])
def test_a_point_load_s_work_is_the_force_times_the_displacement(cells, degree, rng):
    """- f . u(X) of a random displacement to rounding: inside, on facets, edges, corners."""
    body = CELLS[cells](1)
    u = forms.displacement(body, degree)
    u.x.array[:] = rng.normal(size=u.x.array.size)
    dim = body.mesh.geometry.dim
    f = np.array([2.0, -1.0, 0.5])[:dim]
    for point in (0.31, 0.17, 0.68), (0.5, 0.5, 0.3), (0.25, 0.5, 0.75), (1, 0, 1), (0, 0.4, 1):
        x = point[:dim]
        value = forms.integral(forms.point_load(u, x, f))
        assert value == pytest.approx(-f @ forms.at(u, x), abs=1e-12)


@pytest.mark.parametrize("cells", CELLS)
def test_a_point_load_in_curved_cells(cells, rng):
    """Exact there, too: the weights are those of the rule that the form is integrated by."""
    body = CELLS[cells](2)
    x = body.mesh.geometry.x
    x[:, 0] += 0.05 * np.sin(3 * x[:, 1]) * x[:, 0]
    u = forms.displacement(body, 2)
    u.x.array[:] = rng.normal(size=u.x.array.size)
    dim = body.mesh.geometry.dim
    f = np.array([2.0, -1.0, 0.5])[:dim]
    for point in (0.31, 0.17, 0.68), (0.5, 0.5, 0.3):
        value = forms.integral(forms.point_load(u, point[:dim], f))
        assert value == pytest.approx(-f @ forms.at(u, point[:dim]), abs=1e-10)


@pytest.mark.parametrize("cells", CELLS)
@pytest.mark.parametrize("degree", [1, 2, 3])
def test_a_line_load_s_work_is_the_integral_along_the_line(cells, degree):
    """|x - 1/2|^k, which has a kink at facets, along lines across cells, in facets and on edges."""
    body = CELLS[cells](1)
    u = forms.displacement(body, degree)
    dim = body.mesh.geometry.dim
    u.interpolate(lambda x: [abs(x[0] - 0.5) ** degree, 0 * x[0], 0 * x[0]][:dim])
    for a, b in (
        ((0.1, 0.2, 0.3), (0.93, 0.77, 0.61)),
        ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0)),
        ((0.13, 0.5, 0.0), (0.9, 0.5, 0.4)),
        ((0.5, 0.25, 0.25), (0.9, 0.25, 0.25)),
        ((0.5, 0.3, 0.2), (0.5, 0.8, 0.2)),
    ):
        first, last = np.array(a[:dim]), np.array(b[:dim])
        value = forms.integral(forms.loads.line_load(u, first, last, [3.0, 1.0, 1.0][:dim]))
        # The primitive of |y|^k is y |y|^k / (k + 1).
        y0, y1 = first[0] - 0.5, last[0] - 0.5
        length = np.linalg.norm(last - first)
        wanted = 0.0
        if y0 != y1:
            ends = [y * abs(y) ** degree / (degree + 1) for y in (y0, y1)]
            wanted = length * (ends[1] - ends[0]) / (y1 - y0)
        # gmsh's vertices lie at 0.5 to 1e-12.
        assert value == pytest.approx(-3 * wanted, abs=1e-11)


def test_loads_on_sheets_in_space(rng):
    """Points and lines of a surface mesh, along its boundary and across cells."""
    body = meshes.square(MPI.COMM_SELF, 1.0, 0.2)
    u = forms.displacement(body, 2)
    low = body.mesh.geometry.x.min(axis=0)
    u.x.array[:] = rng.normal(size=u.x.array.size)
    x = low + np.array([0.33, 0.21, 0.0])
    value = forms.integral(forms.point_load(u, x, (1, 2, 3)))
    assert value == pytest.approx(-np.dot([1, 2, 3], forms.at(u, x)), abs=1e-12)
    u.interpolate(lambda x: (0 * x[0], 0 * x[0], (x[0] - low[0]) ** 2))
    for a, b in (([0, 0, 0], [1, 0, 0]), ([0, 0.1, 0], [1, 0.9, 0])):
        value = forms.integral(forms.loads.line_load(u, low + a, low + b, (0, 0, 1.0)))
        assert value == pytest.approx(-np.linalg.norm(np.subtract(b, a)) / 3, abs=1e-12)


LOADED = """
import json
import sys
from mpi4py import MPI
import numpy as np
import ufl
from variform import forms, meshes

n, cells = int(sys.argv[1]), sys.argv[2]
body = meshes.block(MPI.COMM_WORLD, (10.0, 1.0), n=(n, 4), cells=cells)
u, t = forms.displacement(body, 2), forms.load_factor(body)
psi = forms.energies.saint_venant_kirchhoff(forms.deformation_gradient(u), 1.0, 0.0)
found = {}
held = forms.clamp(u, body.facets("left"))
for name, load in {
    "point": forms.point_load(u, (6.03, 0.5), (0.0, -1e-6 * t)),
    "line": forms.loads.line_load(u, (0.0, 0.52), (10.0, 0.52), (0.0, -1e-7 * t)),
    "gravity": forms.gravity(u, 1e-7 * t / 9.81),
}.items():
    u.x.array[:], t.value = 0, 0
    path = forms.follow(psi * ufl.dx + load, u, held, t, step=1.0, progress=False)
    force, moment = forms.resultant(path, body.facets("left"))
    found[name] = [forms.at(u, (10.0, 0.5))[1], *force, moment[2]]
if body.mesh.comm.rank == 0:
    print(json.dumps(found))
"""


def test_a_cantilever_under_a_point_a_line_and_its_weight(parallel):
    """Timoshenko's beam, E = 2, G = 1, I = 1/12, and the balance with the support; two meshes.

    P a^2 (3 L - a) / (6 E I) + 6/5 P a / G; q L^4 / (8 E I) + 6/5 q L^2 / (2 G). The clamp holds
    the section, and the load is 1e-6 of E: 0.3 %.
    """
    bends = 1e-6 * 6.03**2 * (30 - 6.03) / 1 + 1.2e-6 * 6.03
    sags = 1e-7 * 1e4 / (8 * 2 / 12) + 1.2e-7 * 50
    wanted = {
        "point": (bends, 1e-6, 6.03e-6),
        "line": (sags, 1e-6, 5e-6),
        "gravity": (sags, 1e-6, 5e-6),
    }
    first = parallel(LOADED, 1, 40, "triangle")
    for found in (first, parallel(LOADED, 1, 33, "quadrilateral")):
        for name, (deflection, force, moment) in wanted.items():
            v, fx, fy, fz, m = found[name]
            assert -v == pytest.approx(deflection, rel=3e-3), name
            assert (fx, fy, fz) == pytest.approx((0, force, 0), abs=1e-13)
            assert m == pytest.approx(moment, rel=1e-4)  # of the deformed state
    for ranks in (2, 3):
        other = parallel(LOADED, ranks, 40, "triangle")
        for name, values in first.items():
            assert other[name] == pytest.approx(values, rel=1e-8, abs=1e-13)


def test_a_point_load_of_a_mixed_unknown_and_by_control(rng):
    """The displacement's part of w; the same potential with another load factor."""
    mesh = unit_mesh(2, 3)
    w, t = forms.displacement_pressure(mesh), forms.load_factor(mesh, 2.0)
    w.x.array[:] = rng.normal(size=w.x.array.size)
    load = forms.point_load(ufl.split(w)[0], (0.3, 0.4), (t, 3 * t))
    u = forms.displacement_of(w)
    for value in (2.0, 5.0):
        t.value = value
        wanted = -value * np.dot([1, 3], forms.at(u, (0.3, 0.4)))
        assert forms.integral(load) == pytest.approx(wanted, abs=1e-12)


def test_gravity_points_down():
    """Against the last coordinate, or along a direction of any length; g by name."""
    for dim in (2, 3):
        mesh = unit_mesh(dim, 2)
        u = forms.displacement(mesh)
        u.x.array[:] = np.tile(0.5 * (1 + np.arange(dim)), u.x.array.size // dim)
        value = forms.integral(forms.gravity(u, 2.0))
        assert value == pytest.approx(2 * 9.81 * 0.5 * dim, rel=1e-13)
        along = forms.gravity(u, 2.0, g=1.62, direction=(3.0, *[0.0] * (dim - 1)))
        assert forms.integral(along) == pytest.approx(-1.62, rel=1e-13)
        for wrong in ((0.0,) * dim, (1.0,) * (dim + 1)):
            with pytest.raises(ValueError, match=rf"direction of {dim} components.* got \("):
                forms.gravity(u, 2.0, direction=wrong)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda u, x: forms.point_load(u, (1.5, 0.0), (0, 1)),
            r"the point \(1.5, 0.0\) lies 0.5 outside the mesh",
        ),
        (
            lambda u, x: forms.loads.line_load(u, (0, 0), (1, 1.2), (0, 1)),
            r"the line's point \(0.9.*\) lies 0.1.* outside the mesh",
        ),
        (lambda u, x: forms.loads.line_load(u, (0, 0), (0, 0), (0, 1)), "got .* twice: use point"),
        (lambda u, x: forms.point_load(u, (0, 0, 0), (0, 1)), "a point of 2 finite coordinates"),
        (lambda u, x: forms.point_load(u, (0, 0), (0, 0, 1)), r"needs the shape \(2,\), got \(3,"),
        (lambda u, x: forms.point_load(u, (0, 0), (0, x[0])), "constant in space, got .*: write"),
        (lambda u, x: forms.point_load(2 * x, (0, 0), (0, 1)), "the displacement, a vector of one"),
    ],
)
def test_loads_at_no_place_are_refused(call, message):
    mesh = unit_mesh(2, 2)
    with pytest.raises(ValueError, match=message):
        call(forms.displacement(mesh), ufl.SpatialCoordinate(mesh))


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
