# SPDX-License-Identifier: MIT
"""Solutions against closed forms, rates of convergence, and failures that leave the state whole."""

import functools

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from cases import at_plane, bending, rates, tube_pressure, unit_mesh, whole
from dolfinx import fem
from dolfinx import mesh as dmesh
from scipy.optimize import brentq

from variform import forms, meshes

TIGHT = {"rtol": 1e-12, "ctol": 1e-10}


def pulled(psi, dim=3, stretch=1.5, mixed=False):
    """A unit cube (square) between rollers, stretched along x; the path and the system."""
    mesh = unit_mesh(dim, 2)
    u = forms.displacement_pressure(mesh) if mixed else forms.displacement(mesh)
    supports = [forms.roller(u, at_plane(mesh, axis, 0.0), axis) for axis in range(dim)]
    ends = (stretch - 1, *[None] * (dim - 1))
    supports.append(forms.translate(u, at_plane(mesh, 0, 1.0), ends))
    path = forms.solve(psi(u), u, supports, **TIGHT)
    force, _ = forms.resultant(path.problem, at_plane(mesh, 0, 1.0))
    return forms.displacement_of(u), force[0]


def test_uniaxial_stretch_of_a_compressible_block():
    """P11(L, l, l) is the force, where P22(L, l, l) = 0: neo-Hookean, L = 1.5."""
    mu, lmbda, L = 1.3, 2.1, 1.5

    def psi(u):
        return forms.energies.neo_hookean(forms.deformation_gradient(u), mu, lmbda) * ufl.dx

    def P22(side):
        return mu * (side - 1 / side) + lmbda * np.log(L * side**2) / side

    side = brentq(P22, 0.3, 1.5, xtol=1e-15)
    u, force = pulled(psi, stretch=L)
    assert force == pytest.approx(mu * (L - 1 / L) + lmbda * np.log(L * side**2) / L, rel=1e-11)
    assert forms.at(u, (1, 1, 1)) == pytest.approx([L - 1, side - 1, side - 1], rel=1e-10)


def test_uniaxial_stretch_of_an_incompressible_block():
    """P11 = (2 c10 + 2 c01 / L)(L - L^-2), Mooney-Rivlin with a pressure unknown."""
    c10, c01, L = 0.4, 0.25, 1.8

    def psi(w):
        u, p = ufl.split(w)
        F = forms.deformation_gradient(u)
        energy = forms.energies.mooney_rivlin(F, c10, c01)
        return forms.energies.with_pressure(energy, F, p) * ufl.dx

    u, force = pulled(psi, stretch=L, mixed=True)
    assert force == pytest.approx((2 * c10 + 2 * c01 / L) * (L - L**-2), rel=1e-10)
    assert forms.at(u, (0, 1, 1))[1:] == pytest.approx([L**-0.5 - 1] * 2, rel=1e-10)


@pytest.mark.parametrize("model", ["incompressible", "condensed"])
def test_uniaxial_stretch_of_a_sheet(model):
    """Plane stress is uniaxial tension: mu (L - L^-2) incompressible, else the 3D bar's force."""
    mu, lmbda, L = 1.3, 2.1, 1.4
    neo_hookean = forms.energies.neo_hookean

    def psi(u):
        if model == "incompressible":
            F = forms.plane_stress_incompressible(u)
            return forms.energies.isochoric_neo_hookean(F, mu) * ufl.dx
        F = forms.plane_stress(u, lambda F: neo_hookean(F, mu, lmbda))
        return neo_hookean(F, mu, lmbda) * ufl.dx

    _, force = pulled(psi, dim=2, stretch=L)
    if model == "incompressible":
        assert force == pytest.approx(mu * (L - L**-2), rel=1e-11)
        return
    side = brentq(lambda s: mu * (s - 1 / s) + lmbda * np.log(L * s**2) / s, 0.3, 1.5, xtol=1e-15)
    P11 = mu * (L - 1 / L) + lmbda * np.log(L * side**2) / L
    assert force == pytest.approx(P11, rel=1e-11)


def test_simple_shear():
    """F = I + k e1 (x) e2 on the whole boundary: the top's force is (mu k, P22 = 0, 0)."""
    mu, lmbda, k = 1.3, 2.1, 0.8
    mesh = unit_mesh(3, 2)
    u = forms.displacement(mesh)
    X = ufl.SpatialCoordinate(mesh)
    support = forms.prescribe(u, whole(mesh), (k * X[1], 0.0, 0.0))
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), mu, lmbda)
    u.x.array[:] = 0.05 * np.random.default_rng(1).normal(size=u.x.array.size)
    path = forms.solve(psi * ufl.dx, u, [support], **TIGHT)
    assert forms.at(u, (0.4, 0.5, 0.3)) == pytest.approx([0.5 * k, 0, 0], abs=1e-12)
    # P = mu (F - F^-T) is homogeneous; nodes on the top's edges also feel the sides: average it.
    P = forms.stress.first_piola(psi, psi_F(psi))
    assert forms.integral(P[0, 1] * ufl.dx) == pytest.approx(mu * k, rel=1e-12)
    assert forms.integral(P[1, 1] * ufl.dx) == pytest.approx(0, abs=1e-12)
    assert forms.integral(P[1, 0] * ufl.dx) == pytest.approx(mu * k, rel=1e-12)
    assert path.completed


def psi_F(psi):
    """The variable an energy was written with."""
    from ufl.corealg.traversal import unique_pre_traversal

    return next(e for e in unique_pre_traversal(psi) if isinstance(e, ufl.classes.Variable))


def test_tube_inflation_converges_to_the_closed_form():
    """Axisymmetric P2-P1 tube under a follower pressure: the inner radius, at rate >= 3.5."""
    inner, outer, mu, a = 1.0, 2.0, 1.0, 1.5
    pressure = tube_pressure(inner, outer, a, mu)
    errors = []
    for n in (2, 4, 8):
        body = meshes.block(
            MPI.COMM_SELF, (outer - inner, 0.5), n=(n, 1), cells="quadrilateral", origin=(inner, 0)
        )
        w, t = forms.displacement_pressure(body), forms.load_factor(body)
        u, p = ufl.split(w)
        F, ring = forms.axisymmetric(u), forms.circumference(u)
        psi = forms.energies.with_pressure(forms.energies.isochoric_neo_hookean(F, mu), F, p)
        v, _ = ufl.TestFunctions(w.function_space)
        density = forms.follower_pressure(u, t * pressure * ring, v, body.ds("left"), F)
        level = [forms.roller(w, body.facets("bottom", "top"), 1)]
        forms.follow(
            psi * ring * ufl.dx, w, level, t, step=0.5, virtual_work=density, progress=False
        )
        moved = forms.at(forms.displacement_of(w), (inner, 0.25))
        errors.append(abs(inner + moved[0] - a))
    assert errors[-1] < 2e-5
    assert rates(errors)[-1] > 3.5


@pytest.mark.parametrize(("degree", "order"), [(1, 2), (2, 3), (3, 4)])
def test_manufactured_solution_converges(degree, order):
    """B = -div P(u*) gives back u* in L2 with rates 2, 3, 4 for P1, P2, P3."""
    errors = []
    for n in (4, 8, 16):
        mesh = dmesh.create_unit_square(MPI.COMM_SELF, n, n)
        x = ufl.SpatialCoordinate(mesh)
        u = forms.displacement(mesh, degree)
        exact = 0.1 * ufl.as_vector(
            [ufl.sin(np.pi * x[0]) * ufl.cos(2 * x[1]), x[0] * ufl.sin(np.pi * x[1])]
        )
        F = forms.deformation_gradient(exact)
        P = forms.stress.first_piola(forms.energies.neo_hookean(F, 1.0, 2.0), F)
        b = -ufl.div(ufl.as_matrix([[P[0, 0], P[0, 1]], [P[1, 0], P[1, 1]]]))
        psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0)
        dx = ufl.dx(metadata={"quadrature_degree": 2 * degree + 2})
        potential = psi * dx + forms.body_force(u, b, dx)
        forms.solve(potential, u, [forms.prescribe(u, whole(mesh), list(exact))])
        difference = u - exact
        fine = ufl.dx(metadata={"quadrature_degree": 2 * degree + 4})
        errors.append(np.sqrt(forms.integral(ufl.inner(difference, difference) * fine)))
    assert rates(errors)[-1] == pytest.approx(order, abs=0.15)


def test_reactions_balance_the_loads():
    """Force and moment of the clamp are minus those of the dead load on the deformed body."""
    path, body = bending(rtol=1e-12)
    force, moment = path.record("force")[-1]
    assert force == pytest.approx([0, 0.01, 0], abs=1e-13)
    x = ufl.SpatialCoordinate(body.mesh) + path.u
    arm = forms.integral(x[0] * body.ds("right"))
    assert moment[2] == pytest.approx(0.01 * arm, rel=1e-9)


def test_units_change_nothing():
    """Moduli times 1e9, lengths times 1e-3: the same iterations and the same shape."""
    (plain, _), (scaled, _) = bending(), bending(1e9, 1e-3)
    counts = [[s.convergence.iterations for s in p.steps] for p in (plain, scaled)]
    assert counts[0] == counts[1]
    tip = forms.at(plain.u, (4.0, 1.0))
    assert 1e3 * forms.at(scaled.u, (4e-3, 1e-3)) == pytest.approx(tip, rel=1e-8)
    assert abs(tip[1]) > 0.5


@functools.cache
def bent(mu, L):
    """A nearly incompressible block under a load at its end: iterations, and its tip over L."""
    size = (2 * L, L, L)
    body = meshes.block(MPI.COMM_SELF, size, n=(4, 2, 2))
    w, t = forms.displacement_pressure(body), forms.load_factor(body)
    u, p = ufl.split(w)
    F = forms.deformation_gradient(u)
    constants = [fem.Constant(body.mesh, c * mu) for c in (1.0, 0.05)]
    energy = forms.energies.isochoric_neo_hookean(F, constants[0])
    psi = forms.energies.with_pressure(energy, F, p)
    load = forms.dead_traction(u, ufl.as_vector([0 * t, 0 * t, constants[1] * t]), body.ds("right"))
    fixed = forms.clamp(w, body.facets("left"))
    path = forms.follow(psi * ufl.dx + load, w, [fixed], t, progress=False)
    tip = forms.at(forms.displacement_of(w), size) / L
    return [s.convergence.iterations for s in path.steps], tip


@pytest.mark.parametrize(("mu", "L"), [(1e-9, 1.0), (1e12, 1.0), (1e3, 1e-6), (1e-3, 1e3)])
def test_units_change_nothing_in_mixed_problems(mu, L):
    """Forces and volumes stand in one residual: it is scaled, so that any units give the same."""
    (counts, tip), (plain_counts, plain_tip) = bent(mu, L), bent(1.0, 1.0)
    assert counts == plain_counts
    assert tip == pytest.approx(plain_tip, rel=1e-8)


def test_a_failed_solve_of_a_sheet_gives_the_old_thickness_back():
    """The condensed stretch goes back with the displacement, and follows it when it is set."""
    mesh = unit_mesh(2, 2)
    u = forms.displacement(mesh)
    neo_hookean = forms.energies.neo_hookean
    F = forms.plane_stress(u, lambda F: neo_hookean(F, 1.0, 2.0))
    edge = at_plane(mesh, 0, 1.0)
    supports = [forms.clamp(u, at_plane(mesh, 0, 0.0)), forms.translate(u, edge, (0.5, 0.5))]
    dx = ufl.dx(mesh, metadata={"quadrature_degree": 2})
    with pytest.raises(forms.NotConverged):
        forms.solve(neo_hookean(F, 1.0, 2.0) * dx, u, supports, options={"snes_max_it": 1})
    assert forms.volume(F, dx) == pytest.approx(1, rel=1e-13)
    u.interpolate(lambda x: (0.3 * x[0], 0 * x[1]))
    stretch = forms.at(forms.field(F[2, 2], mesh), (0.5, 0.5))[0]
    assert stretch < 0.95
    assert forms.volume(F, dx) == pytest.approx(1.3 * stretch, rel=1e-12)
    assert forms.smallest_volume_ratio(F, mesh) == pytest.approx(1.3 * stretch, rel=1e-12)


def test_rest_is_converged_at_once():
    """Without loads the state of rest is the solution: no iteration, whatever the force level."""
    path, _ = bending(scale=1e6, to=1e-30)
    assert path.steps[-1].convergence.iterations <= 1
    assert np.abs(path.u.x.array).max() < 1e-25


def test_quadratic_convergence_near_the_solution():
    """Newton's corrections square: the last two residuals have a ratio of orders near 2."""
    mesh = unit_mesh(3, 2)
    u = forms.displacement(mesh)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0)
    supports = [
        forms.clamp(u, at_plane(mesh, 0, 0.0)),
        forms.translate(u, at_plane(mesh, 0, 1.0), (0.0, 0.3, 0.0)),
    ]
    newton = forms.solving.Newton(forms.Problem(psi * ufl.dx, u, supports), rtol=1e-13, ctol=1e-12)
    norms = []
    for snes in newton.runs.solvers:
        snes.setMonitor(lambda snes, it, norm: norms.append(norm))
    newton.predict()
    assert newton.solve().converged
    newton.destroy()
    norms = [n for i, n in enumerate(norms) if n > 1e-13 and (i == 0 or n < norms[i - 1])]
    orders = np.log(norms[2:]) / np.log(norms[1:-1])
    assert orders[-1] > 1.7


def test_stiff_springs_do_not_loosen_the_tolerance():
    """Springs of 1e14 mu at the foot give, under a small load, what a roller there gives."""
    mesh = unit_mesh(2, 4)
    facets = at_plane(mesh, 0, 0.0)
    tags = dmesh.meshtags(mesh, 1, np.sort(facets), np.full(len(facets), 1, np.int32))
    foot = ufl.Measure("ds", domain=mesh, subdomain_data=tags)(1)
    ends = []
    for stiff in (False, True):
        u = forms.displacement(mesh)
        psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 0.0) * ufl.dx
        potential = psi + forms.body_force(u, (1e-3, 0.0))
        supports = [forms.roller(u, at_plane(mesh, 1, 0.0), 1)]
        if stiff:
            potential += forms.spring(u, 1e14, foot, ufl.as_vector([1.0, 0.0]))
        else:
            supports.append(forms.roller(u, facets, 0))
        forms.solve(potential, u, supports)
        ends.append(forms.at(u, (1.0, 1.0)))
    assert ends[0][0] > 2e-4
    assert ends[1] == pytest.approx(ends[0], rel=1e-9)


def test_spring_holds_a_free_body():
    """A bar on springs without any support: stretch of the springs = load / stiffness."""
    mesh = unit_mesh(3, 1)
    u = forms.displacement(mesh)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 1.0) * ufl.dx
    springs = forms.spring(u, 4.0, ufl.dx)
    path = forms.solve(psi + springs + forms.body_force(u, (0.2, 0, -0.4)), u)
    mean = [forms.integral(u[i] * ufl.dx) for i in range(3)]
    assert mean == pytest.approx([0.05, 0, -0.1], abs=1e-10)
    assert path.steps[0].convergence.converged


def test_measures_with_and_without_names_mix():
    """ufl.dx beside body.dx("name") in one potential, as DOLFINx alone refuses."""
    body = meshes.block(MPI.COMM_SELF, (1.0, 1.0), n=1)
    u = forms.displacement(body)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 1.0)
    load = forms.body_force(u, (0.3, 0.0))
    forms.solve(psi * ufl.dx + forms.spring(u, 3.0, body.dx("body")) + load, u)
    assert forms.integral(u[0] * ufl.dx) == pytest.approx(0.1, rel=1e-9)


def test_a_scalar_minimization():
    """Int u^2 / 2 - u over any scalar space: u = 1."""
    mesh = unit_mesh(2, 2)
    u = fem.Function(fem.functionspace(mesh, ("Lagrange", 1)))
    forms.solve((u**2 / 2 - u + ufl.inner(ufl.grad(u), ufl.grad(u))) * ufl.dx, u)
    assert u.x.array == pytest.approx(1, rel=1e-9)


def test_a_residual_without_potential():
    """A linear form in place of the potential: R[v] = int P : grad v - t . v."""
    path, body = bending(rtol=1e-12)
    u = forms.displacement(body)
    psi = forms.energies.neo_hookean(F := forms.deformation_gradient(u), 1.0, 2.0)
    v = ufl.TestFunction(u.function_space)
    P = forms.stress.first_piola(psi, F)
    P2 = ufl.as_matrix([[P[0, 0], P[0, 1]], [P[1, 0], P[1, 1]]])
    t = forms.load_factor(body)
    R = ufl.inner(P2, ufl.grad(v)) * ufl.dx - t * ufl.inner(ufl.as_vector([0, -0.01]), v) * body.ds(
        "right"
    )
    forms.follow(R, u, [forms.clamp(u, body.facets("left"))], t, rtol=1e-12, progress=False)
    assert u.x.array == pytest.approx(path.u.x.array, abs=1e-10)


def test_negative_and_decreasing_loads():
    """The load factor may fall, and start anywhere."""
    mesh = unit_mesh(2, 1)
    u, t = forms.displacement(mesh), forms.load_factor(mesh, 0.5)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0) * ufl.dx
    supports = [forms.prescribe(u, whole(mesh), (t * ufl.SpatialCoordinate(mesh)[0], 0.0))]
    path = forms.follow(psi, u, supports, t, to=-0.25, step=0.25, progress=False)
    loads = [s.load for s in path.steps]
    assert loads[0] == 0.25 and loads[-1] == -0.25 and max(np.diff(loads)) < 0
    assert forms.at(u, (1, 1)) == pytest.approx([-0.25, 0])
