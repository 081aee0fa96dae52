# SPDX-License-Identifier: MIT
"""Rollers along any direction: a body turned with its supports does what it does unturned."""

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from cases import at_plane, unit_mesh
from dolfinx import fem
from scipy.optimize import brentq
from slanted import LMBDA, MU, TIGHT, WAYS, rotation, turn

from variform import forms, meshes

SCENES = """
import json
from mpi4py import MPI
from slanted import WAYS, bar, cube, ring, slope

comm, found = MPI.COMM_WORLD, {}
for way in WAYS:
    for degree in (1, 2):
        found[f"{way} {degree}"] = [bar(comm, degree, way, turned) for turned in (False, True)]
found["mixed 2"] = [bar(comm, 2, "mixed", turned) for turned in (False, True)]
for degree in (1, 2):
    found[f"cube {degree}"] = [cube(comm, degree, turned) for turned in (False, True)]
found["ring"] = [ring(comm, what) for what in ("whole", "sector", "wall", "sliding")]
found["slope"] = [slope(comm, way) for way in ("follow", "transient")]
if comm.rank == 0:
    print(json.dumps(found))
"""
BARS = [f"{way} {degree}" for way in WAYS for degree in (1, 2)] + ["mixed 2"]


@pytest.fixture(
    scope="module",
    params=[1, pytest.param(2, marks=pytest.mark.slow), pytest.param(3, marks=pytest.mark.slow)],
)
def found(request, parallel_once):
    """All scenes on a number of ranks."""
    return parallel_once(SCENES, request.param)


@pytest.mark.parametrize("case", BARS)
def test_a_turned_bar_does_what_the_bar_does(case, found):
    """Turned by 30 degrees: displacements, forces, energy to 1e-9, and |u . n| to rounding."""
    straight, turned = found[case]
    for name in ("u", "force", "energy", "loads"):
        assert np.abs(np.subtract(turned[name], straight[name])).max(initial=0) < 1e-9, name
    assert max(turned["off"]) < 1e-15
    # Of the roller the force along its direction counts, the bar's whole force on that face.
    assert np.abs(np.subtract(turned["support"], straight["support"])).max() < 1e-9


def lateral(stretch, axes):
    """Lateral stretch l of a bar without forces on its sides, of which `axes` are free."""

    def stress(s):
        return MU * (s - 1 / s) + LMBDA * np.log(stretch * s**axes) / s

    return brentq(stress, 0.3, 1.5, xtol=1e-15)


@pytest.mark.parametrize("case", [case for case in BARS if case.split()[0] in WAYS[:3]])
def test_a_turned_bar_has_the_lateral_stretch_in_closed_form(case, found):
    """Plane strain, lambda = 1.5: mu (l - 1/l) + lmbda ln(1.5 l)/l = 0, l - 1 = -0.2985900145."""
    assert abs(lateral(1.5, 1) - 1 + 0.2985900145) < 1e-10
    corner = found[case][1]["u"][0]
    assert corner == pytest.approx([1.0, lateral(1.5, 1) - 1], abs=1e-10)


@pytest.mark.parametrize("degree", [1, 2])
def test_three_slanted_planes_meet_in_edges_and_a_corner(degree, found):
    """A turned cube: closed form, stability, lowest mode, frequencies, the support's force."""
    straight, turned = found[f"cube {degree}"]
    sides = lateral(1.5, 2) - 1
    assert turned["u"] == pytest.approx([0.5, sides, sides], abs=1e-10)
    assert turned["force"] == pytest.approx(straight["force"], abs=1e-9)
    assert turned["unstable"] == 0
    assert turned["lowest"] == pytest.approx(straight["lowest"], rel=1e-7)
    assert turned["frequencies"] == pytest.approx(straight["frequencies"], rel=1e-7)


def test_a_sector_between_planes_of_symmetry_is_the_whole_ring(found):
    """A ninth of a ring under pressure: displacements at ten places to 1e-10."""
    whole, sector = (np.array(part["u"]) for part in found["ring"][:2])
    assert np.abs(whole).max() > 0.4
    assert np.abs(sector - whole).max() < 1e-10


def test_what_a_component_prescribes_goes_on_along_the_slope(found):
    """U_x = 0.3 t at the corner of a roller of slope 0.4: a translation, no stress."""
    for way in found["slope"]:
        assert np.abs(np.array(way["u"]) - [0.3, 0.12]).max() < 1e-12
        assert abs(way["energy"]) < 1e-14


def gradients(turned):
    """Of a support's force by moduli, a load factor in a roller, and one in a translation."""
    Q = rotation(2) if turned else np.eye(2)
    body = turn(meshes.block(MPI.COMM_SELF, (2.0, 1.0), n=(4, 2)), Q)
    u, t = forms.displacement(body, 2), forms.load_factor(body)
    lame = fem.Constant(body.mesh, (MU, LMBDA))
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), *lame)
    bottom = forms.roller(u, body.facets("bottom"), Q[:, 1])
    left = forms.roller(u, body.facets("left"))
    shift = [t * c for c in Q @ [0.5, 0.2]]
    right = forms.translate(u, body.facets("top"), shift)
    path = forms.follow(psi * ufl.dx, u, [left, bottom, right], t, to=1.0, **TIGHT)
    force = forms.Reaction(left, direction=Q[:, 0])
    by_moduli, by_load = forms.gradient(path, force, [lame, t])
    return by_moduli, by_load, (path, left, force)


def test_gradients_go_through_rollers():
    """Turned and straight bars have the same gradients; the roller itself is no parameter."""
    straight, turned = gradients(False), gradients(True)
    assert turned[0] == pytest.approx(straight[0], rel=1e-9)
    assert turned[1] == pytest.approx(straight[1], rel=1e-9)
    path, left, force = turned[2]
    with pytest.raises(ValueError, match="prescribes no values to differentiate by"):
        forms.gradient(path, force, [left])


def test_gradients_by_what_a_roller_and_its_neighbors_prescribe():
    """By a roller's own load, and by a component that moves its corner: difference quotients."""
    body = meshes.block(MPI.COMM_SELF, (2.0, 1.0), n=(4, 2))
    body.mesh.geometry.x[:, 1] += 0.4 * body.mesh.geometry.x[:, 0]
    u = forms.displacement(body)
    by, pull = fem.Constant(body.mesh, 0.1), fem.Constant(body.mesh, 0.2)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), MU, LMBDA)
    end = forms.translate(u, body.facets("right"), (pull, None))
    supports = [
        forms.roller(u, body.facets("bottom"), by=by),
        forms.translate(u, body.facets("left"), (0.0, 0.0)),
        end,
    ]
    problem = forms.Problem(psi * ufl.dx, u, supports)
    energy = ufl.inner(u, u) * ufl.dx

    def at(a, b):
        by.value, pull.value, u.x.array[:] = a, b, 0.0
        forms.solve(problem, rtol=1e-12, ctol=1e-11)
        return forms.integral(energy)

    h = 1e-4
    wanted = [
        (at(0.1 + h, 0.2) - at(0.1 - h, 0.2)) / (2 * h),
        (at(0.1, 0.2 + h) - at(0.1, 0.2 - h)) / (2 * h),
    ]
    at(0.1, 0.2)
    found = forms.gradient(problem, energy, [by, pull])
    assert found == pytest.approx(wanted, rel=1e-6)
    by_support = forms.gradient(problem, energy, [end])[0]
    assert by_support.x.array.sum() == pytest.approx(wanted[1], rel=1e-6)


def test_products_without_a_matrix_are_the_tangent():
    """Also along held directions, which iterations may enter by rounding."""
    from variform.forms.solving.linear.action import Action

    body = turn(meshes.block(MPI.COMM_SELF, (1.0, 1.0, 1.0), n=2), rotation(3))
    u = forms.displacement(body, 2)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), MU, LMBDA)
    planes = [forms.roller(u, body.facets(name)) for name in ("left", "front")]
    problem = forms.Problem(psi * ufl.dx, u, [*planes, forms.clamp(u, body.facets("right"))])
    A = problem.create_matrix()
    problem.tangent(A)
    action = Action(problem, A)
    x, y, z = (problem.create_vector() for _ in range(3))
    x.array[:] = np.random.default_rng(1).normal(size=x.getLocalSize())
    A.mult(x, y)
    action.assembled = False
    action.mult(x, z)
    assert np.abs(y.array - z.array).max() < 1e-12 * np.abs(y.array).max()
    dense = A.convert("dense").getDenseArray()
    assert np.abs(dense - dense.T).max() < 1e-13 * np.abs(dense).max()


@pytest.mark.slow
@pytest.mark.parametrize("degree, cells, n", [(1, "tetrahedron", 12), (2, "hexahedron", 6)])
def test_multigrid_needs_no_more_iterations(degree, cells, n):
    """A turned cube of 6,000 degrees of freedom on three slanted planes: up to a tenth more."""
    counts = []
    for turned in (False, True):
        Q = rotation(3) if turned else np.eye(3)
        body = turn(meshes.block(MPI.COMM_SELF, (1.0, 1.0, 1.0), n=n, cells=cells), Q)
        u = forms.displacement(body, degree)
        psi = forms.energies.neo_hookean(forms.deformation_gradient(u), MU, LMBDA)
        planes = [forms.roller(u, body.facets(name)) for name in ("left", "front", "bottom")]
        load = ufl.inner(u, ufl.as_vector((Q @ [0.1, 0.05, 0]).tolist())) * body.ds("right")
        problem = forms.Problem(psi * ufl.dx - load, u, planes)
        assert problem.size > 5000
        newton = forms.solving.Newton(problem, options={"ksp_rtol": 1e-8})
        newton.tangent.scaled.measure()
        newton.tangent.assemble()
        ksp, b = newton.tangent.ksp, problem.create_vector()
        newton.tangent.scaled.residual(b)
        ksp.setOperators(newton.tangent.product, newton.tangent.A)
        assert newton.tangent.solve(b, b.duplicate())
        assert ksp.getPC().getType() == ("python" if degree == 1 else "mg")
        counts.append(ksp.getIterationNumber())
        newton.destroy()
    assert counts[1] <= 1.1 * counts[0]


def test_directions_are_those_asked_for():
    """Axes, their opposites and flat faces across an axis are ordinary rollers of one component."""
    mesh = unit_mesh(3, 2)
    u, face = forms.displacement(mesh), at_plane(mesh, 0, 1.0)
    for axis in (0, None, (-2, 0, 0), ufl.as_vector([1.0, 0.0, 0.0])):
        support = forms.roller(u, face, axis, by=0.1)
        assert support.slant is None and len(support.parts) == 1
        sign = -1 if isinstance(axis, tuple) else 1
        assert support.parts[0].value.x.array == pytest.approx(0.1 * sign)


def test_a_ring_that_may_slide_along_a_round_wall_does_what_one_does_that_may_not(found):
    """Normals of a round face, one a node, are radial: pressed against it, nothing slides."""
    held, sliding = (np.array(part["u"]) for part in found["ring"][2:])
    assert np.abs(held).max() > 0.01
    assert np.abs(sliding - held).max() < 1e-10


def test_normals_of_a_curved_face_are_means():
    """Of unit length, and those of a cylinder radial as its facets allow."""
    body = meshes.cylinder(MPI.COMM_SELF, 1.0, 1.0, h=0.5)
    u, X = forms.displacement(body), ufl.SpatialCoordinate(body.mesh)
    mean = forms.roller(u, body.facets("outer")).slant
    exact = forms.roller(u, body.facets("outer"), ufl.as_vector([X[0], X[1], 0.0])).slant
    assert np.linalg.norm(mean.normals, axis=1) == pytest.approx(1)
    assert np.abs(mean.normals - exact.normals).max() < 0.1


def two_sides(u, face):
    mesh = u.function_space.mesh
    return np.union1d(face, at_plane(mesh, 1, 0.0)).astype(np.int32)


def inside(mesh):
    mesh.topology.create_connectivity(2, 3)
    count = mesh.topology.connectivity(2, 3).num_nodes
    links = [len(mesh.topology.connectivity(2, 3).links(k)) for k in range(count)]
    return np.flatnonzero(np.array(links) == 2).astype(np.int32)[:1]


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda u, f: forms.roller(u, f, 1.5), "axis from 0 to 2, got 1.5"),
        (lambda u, f: forms.roller(u, f, (1, 1)), r"roller's direction needs the shape \(3,\)"),
        (lambda u, f: forms.roller(u, f, (0, 0, 0)), r"length above 0, got none at \(0, 0, 0\)"),
        (
            lambda u, f: forms.roller(u, f, ufl.FacetNormal(u.function_space.mesh)),
            "leave it out for the facets' normals",
        ),
        (lambda u, f: forms.roller(u, two_sides(u, f)), r"turn too much at \(0, 0, 0\) to have"),
        (
            lambda u, f: forms.roller(u, inside(u.function_space.mesh)),
            "facets inside a body, as at .* have no normal: give a direction",
        ),
        (lambda u, f: forms.roller(u, f[:0]), "got none on any rank"),
        (lambda u, f: forms.roller(u, f, (1, 1, 0), by="x"), "scalar UFL.* got str"),
    ],
)
def test_bad_rollers_are_refused(call, message):
    mesh = unit_mesh(3)
    with pytest.raises(ValueError, match=message):
        call(forms.displacement(mesh), at_plane(mesh, 0, 0.0))


def test_edges_of_a_surface_have_no_normals():
    body = meshes.spherical_sheet(MPI.COMM_SELF, 1.0, 0.5, 2, "octant")
    u = forms.displacement(body, 2)
    with pytest.raises(ValueError, match="give the roller a direction"):
        forms.roller(u, body.facets("x0"))
    assert forms.roller(u, body.facets("x0"), (1, 1, 0)).slant is not None
