# SPDX-License-Identifier: MIT
"""Shapes at rest: loaded again they are the given ones, of every energy; a tube in closed form."""

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from cases import rates
from dolfinx import fem
from scipy.optimize import brentq
from test_problems import Well

from variform import forms, meshes

ENERGIES = {
    "neo_hookean": lambda F, a: forms.energies.neo_hookean(F, 1.0, 2.0),
    "hencky": lambda F, a: forms.energies.hencky(F, 1.0, 2.0),
    "activated": lambda F, a: (
        forms.energies.activated(F, ufl.Identity(3) + 0.1 * ufl.outer(a, a), 1.0)
        + forms.energies.volumetric(F, 2.0)
    ),
    "guccione": lambda F, a: (
        forms.energies.guccione(F, 1.0, 4.0, 2.0, 3.0, a) + forms.energies.volumetric(F, 3.0)
    ),
}


def beam(energy, order=1, comm=MPI.COMM_SELF, mixed=False):
    """A beam that is known under its weight and a pressure that follows it, with its fibers."""
    body = meshes.block(comm, (2.0, 0.5, 0.5), n=(4, 2, 2), order=order)
    w = forms.displacement_pressure(body) if mixed else forms.displacement(body, degree=order)
    t, u = forms.load_factor(body), w["u"]
    F = forms.deformation_gradient(u)
    fiber = fem.Function(fem.functionspace(body.mesh, ("DG", 0, (3,))), name="fiber")
    fiber.interpolate(lambda x: np.array([np.cos(x[2]), np.sin(x[2]), 0 * x[0]]))
    psi = ENERGIES[energy](F, fiber)
    if mixed:
        psi = forms.energies.isochoric_neo_hookean(F, 1.0)
        psi = forms.energies.with_pressure(psi, F, w["p"], 100.0)
    v = ufl.TestFunction(w.function_space)
    v = ufl.split(v)[0] if mixed else v
    press = forms.follower_pressure(u, 0.02 * t, v, body.ds("top"))
    weight = forms.body_force(u, (0, 0, -0.02 * t))
    held = [forms.clamp(w, body.facets("left"))]
    problem = forms.Problem(psi * ufl.dx + weight, w, held, virtual_work=press)
    return problem, t, fiber


@pytest.mark.parametrize(
    ("energy", "order", "mixed"),
    [*((name, 1, False) for name in ENERGIES), ("neo_hookean", 2, False), ("neo_hookean", 2, True)],
)
def test_loaded_again_it_is_the_given_shape(energy, order, mixed):
    """Every node comes back to its given place, to 1e-10 of the size; the mesh is at rest."""
    problem, t, _ = beam(energy, order, mixed=mixed)
    x = problem.u.function_space.mesh.geometry.x.copy()
    found = forms.unload(problem, t, progress=False)
    moved = np.abs(problem.u.function_space.mesh.geometry.x - x).max()
    assert found.distance < 1e-10 and moved > 0.1
    assert np.array_equal(found.given, x)
    assert found.path.completed and found.again.completed


def test_fibers_are_carried_along():
    """Directions known in the loaded shape are those that the rest's become under load."""
    problem, t, fiber = beam("guccione")
    loaded = fiber.x.array.reshape(-1, 3).copy()
    found = forms.unload(problem, t, carried=fiber, progress=False)
    assert found.distance < 1e-10 and found.turns > 1
    rest = fiber.x.array.reshape(-1, 3)
    assert np.linalg.norm(rest, axis=1) == pytest.approx(1.0, rel=1e-12)
    assert np.abs(rest - loaded).max() > 0.05
    F, V = forms.deformation_gradient(problem.u), fiber.function_space
    moved, now = F * fiber, fem.Function(V)
    points = V.element.interpolation_points()
    now.interpolate(fem.Expression(moved / ufl.sqrt(ufl.inner(moved, moved)), points))
    assert now.x.array.reshape(-1, 3) == pytest.approx(loaded, abs=1e-10)


def sheet(kind, comm=MPI.COMM_SELF):
    """A plane or curved body that is known under loads; and where its loads at points are."""
    points = []
    if kind == "membrane":
        body = meshes.spherical_sheet(comm, 1.0, 0.5, 2, "octant")
        u, t = forms.displacement(body, degree=2), forms.load_factor(body)
        psi = forms.energies.neo_hookean_sheet(forms.membrane_gradient(u), 1.0)
        potential = psi * ufl.dx - 0.4 * t * forms.enclosed_volume(u)
        held = [forms.roller(u, body.facets(f"{a}0"), k) for k, a in enumerate("xyz")]
        return forms.Problem(potential, u, held), t, points
    body = meshes.block(comm, (2.0, 0.5), n=(6, 2), cells="quadrilateral", order=2)
    body.mesh.geometry.x[:, 1] += 0.05 * np.sin(2 * body.mesh.geometry.x[:, 0])
    u, t = forms.displacement(body, degree=2), forms.load_factor(body)

    def psi(F):
        return forms.energies.neo_hookean(F, 1.0 + 0.2 * ufl.SpatialCoordinate(body.mesh)[0], 2.0)

    F = forms.plane_stress(u, psi) if kind == "plane stress" else forms.deformation_gradient(u)
    load = forms.body_force(u, (0, -0.02 * t))
    if kind == "points":
        load = forms.point_load(u, points_at := (1.9, 0.3), (0, -0.02 * t))
        load += forms.loads.line_load(u, (0.2, 0.2), (1.7, 0.4), (0.02 * t, -0.01 * t))
        points = [points_at]
    held = [forms.clamp(u, body.facets("left"))]
    return forms.Problem(psi(F) * ufl.dx + load, u, held), t, points


@pytest.mark.parametrize(
    "kind",
    ["points", *(pytest.param(k, marks=pytest.mark.slow) for k in ("plane stress", "membrane"))],
)
def test_sheets_and_loads_at_points(kind):
    """Loaded again they are the given shape to 1e-10; a point load acts where it was seen."""
    problem, t, points = sheet(kind)
    x = problem.u.function_space.mesh.geometry.x.copy()
    found = forms.unload(problem, t, progress=False)
    moved = np.abs(problem.u.function_space.mesh.geometry.x - x).max()
    assert found.distance < 1e-10 and moved > 0.03
    for point in points:
        # The force's work in u + X is that at the point where it was seen in the loaded shape.
        mesh = problem.u.function_space.mesh
        place = problem.u + ufl.SpatialCoordinate(mesh)
        loads = [c for c in problem.forms.potential.coefficients() if c.name == "load"]
        works = [[forms.integral(g * p * g.dx) for p in (1 + 0 * place[0], *place)] for g in loads]
        assert any(work == pytest.approx([1.0, *point], abs=1e-9) for work in works)
        assert [work[0] for work in works] == pytest.approx([1.0, np.hypot(1.5, 0.2)], abs=1e-9)


def tube(n):
    """Errors of the rest radii of a thick tube whose radii 1, 2 are known under pressure."""
    body = meshes.block(MPI.COMM_SELF, (1.0, 0.5), n=(n, 1), cells="quadrilateral", order=2)
    body.mesh.geometry.x[:, 0] += 1.0
    w, t = forms.displacement_pressure(body), forms.load_factor(body)
    u, p = ufl.split(w)
    F, ring = forms.axisymmetric(u), forms.circumference(u)
    psi = forms.energies.with_pressure(forms.energies.isochoric_neo_hookean(F, 1.0), F, p)
    v, _ = ufl.split(ufl.TestFunction(w.function_space))
    press = forms.follower_pressure(u, 0.5 * t * ring, v, body.ds("left"), F)
    held = [forms.roller(w, body.facets(name), 1) for name in ("bottom", "top")]
    problem = forms.Problem(psi * ring * ufl.dx(degree=6), w, held, virtual_work=press)
    found = forms.unload(problem, t, progress=False)
    assert found.distance < 1e-10
    r = body.mesh.geometry.x[:, 0]

    def pressure(k):
        """Of radii 1, 2 that were the roots of 1 - k, 4 - k; mu = 1."""
        a, b = 1.0, 2.0
        inner = 0.5 * np.log((b**2 - k) / (a**2 - k)) - np.log(b / a)
        return inner - k / 2 * (b**-2 - a**-2)

    k = brentq(lambda k: pressure(k) - 0.5, 0.0, 0.999, xtol=1e-15)
    return abs(r.min() - np.sqrt(1 - k)), abs(r.max() - np.sqrt(4 - k))


def test_rest_radii_of_a_thick_tube():
    """Against the closed form, at the rate of quadratic elements or better; 1e-6 in the end."""
    errors = np.array([tube(n) for n in (2, 4, 8, 16)])
    assert np.all(rates(errors[:, 0])[1:] > 2.8) and errors[-1].max() < 1e-6


SCRIPT = """
import json
from mpi4py import MPI
import ufl
from variform import forms
from test_unloading import beam, sheet

problem, t, fiber = beam("guccione", comm=MPI.COMM_WORLD)
found = forms.unload(problem, t, carried=fiber, progress=False)
mesh = problem.u.function_space.mesh
X = ufl.SpatialCoordinate(mesh)
numbers = [forms.integral(x * ufl.dx(domain=mesh)) for x in (1 + 0 * X[0], X[0], X[1], X[2])]
problem, t, _ = sheet("points", MPI.COMM_WORLD)
points = forms.unload(problem, t, progress=False)
X = ufl.SpatialCoordinate(mesh := problem.u.function_space.mesh)
numbers += [forms.integral(x * ufl.dx(domain=mesh)) for x in (X[0], X[1], X[0] * X[1])]
if MPI.COMM_WORLD.rank == 0:
    print(json.dumps([*numbers, found.distance < 1e-10 and points.distance < 1e-10]))
"""


@pytest.mark.slow
def test_ranks_agree(parallel):
    """The rest shape's volume and middle are the same on 1 and 2 ranks."""
    one, two = (parallel(SCRIPT, ranks) for ranks in (1, 2))
    assert two == pytest.approx(one, rel=1e-9) and one[-1]


@pytest.mark.slow
def test_where_there_is_no_rest_shape():
    """Saint Venant-Kirchhoff's bar carries E/(3 sqrt 3) in compression at most: t = 0.19245."""
    body = meshes.block(MPI.COMM_SELF, (1.0, 1.0, 1.0), n=1)
    u, t = forms.displacement(body), forms.load_factor(body)
    psi = forms.energies.saint_venant_kirchhoff(forms.deformation_gradient(u), 0.5, 0.0)
    push = forms.dead_traction(u, (-t, 0, 0), body.ds("right"))
    held = [forms.roller(u, body.facets(a), k) for k, a in enumerate(("left", "front", "bottom"))]
    problem = forms.Problem(psi * ufl.dx + push, u, held)
    x = body.mesh.geometry.x.copy()
    with pytest.raises(forms.NotConverged, match="no shape at rest .* beyond load factor 0.192"):
        forms.unload(problem, t, progress=False)
    assert np.array_equal(body.mesh.geometry.x, x) and not u.x.array.any()


def odd(kind):
    """A problem that cannot be unloaded."""
    if kind == "rim":
        body = meshes.spherical_sheet(MPI.COMM_SELF, 1.0, 0.5, 1, "octant")
        u, t = forms.displacement(body), forms.load_factor(body)
        psi = forms.energies.neo_hookean_sheet(forms.membrane_gradient(u), 1.0)
        return forms.Problem(psi * ufl.dx - t * u[2] * body.ds("z0"), u), t
    body = meshes.block(MPI.COMM_SELF, (1.0, 1.0), n=2)
    u, t = forms.displacement(body, degree=2 if kind == "order" else 1), forms.load_factor(body)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0)
    load = forms.body_force(u, (0, -t))
    if kind == "size":
        load = -t * u[1] * ufl.CellVolume(body.mesh) * ufl.dx
    potential = psi * ufl.dx + load
    if kind == "between":
        potential += ufl.avg(u[0] ** 2) * ufl.dS
    parts = [potential, Well(u, 1.0, 0.1)] if kind == "terms" else potential
    held = [forms.clamp(u, body.facets("left"))]
    if kind == "turned":
        held.append(forms.rotate(u, body.facets("right"), 0.1 * t))
    problem = forms.Problem(parts, u, held)
    return problem, t


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("order", "with displacements of degree 2 make the mesh of order 2, got one of order 1"),
        ("size", "unload does not know .* of the body at rest: write it as a Function"),
        ("rim", "unload knows no loads on the rim of a surface: give them per area, or at points"),
        ("scalar", "unload needs a displacement, got the unknown theta"),
        ("between", "over cells and exterior facets, got one of type interior_facet"),
        ("terms", "needs a problem of UFL forms alone"),
        ("carried", r"directions of 2 components on the problem's mesh, got s of shape \(\)"),
        ("turned", "needs supports whose values do not depend on places"),
        ("factor", "unload needs a load factor, got float"),
        ("problem", "unload needs a forms.Problem, got Form"),
    ],
)
def test_bad_input_gets_one_sentence(kind, message):
    problem, t = odd(kind)
    mesh = problem.u.function_space.mesh
    if kind == "scalar":
        theta = fem.Function(fem.functionspace(mesh, ("Lagrange", 1)), name="theta")
        problem = forms.Problem(ufl.inner(ufl.grad(theta), ufl.grad(theta)) * ufl.dx, theta)
    carried = ()
    if kind == "carried":
        carried = fem.Function(fem.functionspace(mesh, ("DG", 0)), name="s")
    given = problem.forms.potential if kind == "problem" else problem
    with pytest.raises(ValueError, match=message):
        forms.unload(given, 1.0 if kind == "factor" else t, carried=carried, progress=False)


@pytest.mark.slow
def test_the_ventricle_of_lands_second_problem():
    """Known at 10 kPa, it is unloaded and blown up again: given places to 1e-8 of its size."""
    body = meshes.ellipsoid(MPI.COMM_SELF, 6.0, order=2)
    t, w = forms.load_factor(body), forms.displacement_pressure(body)
    u, p = ufl.split(w)
    F = forms.deformation_gradient(u)
    psi = forms.energies.guccione(
        forms.kinematics.isochoric(F), 10.0, 1.0, 1.0, 1.0, meshes.ellipsoid_fiber_field(body)
    )
    v, _ = ufl.split(ufl.TestFunction(w.function_space))
    press = forms.follower_pressure(u, 10 * t, v, body.ds("endo"))
    held = [forms.clamp(w, body.facets("base"))]
    problem = forms.Problem(
        forms.energies.with_pressure(psi, F, p) * ufl.dx, w, held, virtual_work=press
    )
    found = forms.unload(problem, t, step=0.1, progress=False)
    assert found.distance < 1e-8
