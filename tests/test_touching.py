# SPDX-License-Identifier: MIT
"""Contact of deformable surfaces: derivatives, stacked blocks, a crushed ring, bad input."""

import re
from itertools import combinations

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem
from quotients import rates
from stacks import stack

from demos.benchmarks import self_contact
from demos.benchmarks.self_contact import crossings
from variform import forms, meshes
from variform.forms import contact
from variform.forms.solving.linear.patch import touched
from variform.forms.solving.settings import Settings

pytest.importorskip("ipctk", reason="ipctk, an optional package, is not installed")


def pressed(comm, below, above, dhat, degree=1, dim=2, parts=None, by=0.1, **options):
    """The stack pressed together between rollers, so that all stress is uniform."""
    body = stack(comm, below, above, 0.5 * dhat, dim)
    t, u = forms.load_factor(body), forms.displacement(body, degree)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0) * ufl.dx
    faces = body.ds("low face", "up face")
    term = forms.touching(u, faces, stiffness=1.0, dhat=dhat, parts=parts)
    held = [forms.roller(u, body.facets(f"side {k}"), k) for k in range(dim - 1)]
    held.append(forms.roller(u, body.facets("low end"), dim - 1))
    down = [None] * (dim - 1) + [-by * t]
    held.append(forms.translate(u, body.facets("up end"), down))
    return body, term, forms.follow([psi, term], u, held, t, progress=False, **options)


def deviation(body, path):
    """Largest deviation of the normal stress beside the interface from its mean."""
    F, dim = forms.deformation_gradient(path.u), body.mesh.geometry.dim
    P = forms.stress.first_piola(forms.energies.neo_hookean(F, 1.0, 2.0), F)
    stress = forms.field(P[dim - 1, dim - 1], body.mesh, 0).x.array
    middle = body.mesh.geometry.x[body.mesh.geometry.dofmap].mean(axis=1)[:, dim - 1]
    beside = stress[np.abs(middle - 1) < (1 / 8 if dim == 2 else 1 / 3)]
    return np.abs(beside / beside.mean() - 1).max()


def test_a_turned_stack_between_slanted_rollers_carries_the_same_force():
    """Pairs in contact join nodes that rollers hold along directions of their own."""
    angle, found = 0.5, []
    Q = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    for turn in (np.eye(2), Q):
        body = stack(MPI.COMM_SELF, 3, 4, 0.01)
        body.mesh.geometry.x[:, :2] = body.mesh.geometry.x[:, :2] @ turn.T
        t, u = forms.load_factor(body), forms.displacement(body)
        psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0) * ufl.dx
        term = forms.touching(u, body.ds("low face", "up face"), stiffness=1.0, dhat=0.02)
        held = [forms.roller(u, body.facets(name)) for name in ("side 0", "low end")]
        held.append(forms.roller(u, body.facets("up end"), by=-0.1 * t))
        path = forms.follow([psi, term], u, held, t, rtol=1e-10, ctol=1e-10, progress=False)
        found.append(turn.T @ forms.resultant(path, held[-1])[0][:2])
    assert found[0][1] < -0.1
    assert found[1] == pytest.approx(found[0], abs=1e-8)


def test_derivatives_of_the_barrier_have_their_rates():
    """E, R and K of two rough faces: differences along a random direction are of rate 2."""
    rng = np.random.default_rng(1)
    body = stack(MPI.COMM_SELF, 3, 4, 0.05)
    u = forms.displacement(body, 2)
    term = forms.touching(u, body.ds("low face", "up face"), stiffness=1.0, dhat=0.08)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1e-3, 1e-3) * ufl.dx
    problem = forms.Problem([psi, term], u)
    # Aside, so that no corner lies above another, where nearest points change places.
    u.interpolate(lambda x: np.stack([0.027 * (x[1] > 1.02), 0 * x[0]]))
    u.x.array[:] += 0.004 * rng.standard_normal(len(u.x.array))
    problem.prepare()
    assert term.near() and term.energy() > 0
    first, second = rates(problem, rng.standard_normal(len(u.x.array)), (4e-5, 2e-5, 1e-5))
    assert first == pytest.approx(2, abs=0.1) and second == pytest.approx(2, abs=0.1)


def test_stacked_blocks_of_different_meshes_press_evenly():
    """8 cells on 13: forces balance to rounding; the stress beside them is even within 1 %."""
    found = {}
    for dhat in (1 / 260, 1 / 1040):
        for parts in (1, 3):
            body, _, path = pressed(MPI.COMM_SELF, 8, 13, dhat, parts=parts)
            up, low = (forms.resultant(path, body.facets(f"{n} end"))[0][1] for n in ("up", "low"))
            assert abs(up + low) < 1e-10 * abs(up)
            found[dhat, parts] = deviation(body, path)
    near, far = 1 / 1040, 1 / 260
    assert found[far, 3] < 0.01 and found[far, 1] > 0.01  # at vertices alone 1.4 %
    assert found[near, 3] < found[far, 3] < found[far, 1] and found[near, 1] < found[far, 1]
    # The closed state: two blocks in series, the gap in between.
    body, term, path = pressed(MPI.COMM_SELF, 8, 13, near)
    gap = np.diff(np.sort(np.unique(np.round(term.surface.places()[:, 1], 9)))).max()
    left = (2 + 0.5 * near - 0.1 - gap) / 2
    exact = -1.0 * (left - 1 / left) - 2.0 * np.log(left) / left
    force = -forms.resultant(path, body.facets("up end"))[0][1]
    assert force == pytest.approx(exact, rel=2e-3)


@pytest.mark.parametrize(
    ("degree", "dim"), [(2, 2), (1, 3), pytest.param(2, 3, marks=pytest.mark.slow)]
)
def test_stacked_blocks_of_degree_2_and_in_space(degree, dim):
    """Even within 1 % with the default parts at dhat = h / 20; nothing crosses."""
    below, above = (8, 13) if dim == 2 else (3, 4)
    body, term, path = pressed(MPI.COMM_SELF, below, above, 0.05 / above, degree, dim)
    assert deviation(body, path) < 0.01 and term.certified() and term.near()
    assert all(step.bounds.lower > 0 for step in path.steps)


@pytest.mark.parametrize(("degree", "dim"), [(1, 2), (2, 2), (1, 3)])
def test_pressure_gap_and_force_of_stacked_blocks(degree, dim):
    """Forces are opposite, 1e-10; the pressure is even, 3 %; the gap is that of the points, 2 %."""
    below, above = (8, 13) if dim == 2 else (3, 4)
    dhat = 0.05 / above
    body, term, path = pressed(MPI.COMM_SELF, below, above, dhat, degree, dim)
    support = forms.resultant(path, body.facets("up end"))[0]
    up = contact.force(path, body.facets("up face"))
    low = contact.force(path, body.facets("low face"))
    assert up[dim - 1] == pytest.approx(support[dim - 1], rel=1e-6) and up[dim - 1] < 0
    assert np.abs(up + low).max() < 1e-10 * np.abs(up).max()
    assert np.abs(contact.force(path, "surfaces")).max() < 1e-10 * np.abs(up).max()
    p, g = contact.pressure(path), contact.gap(path, "surfaces")
    for side in ("up face", "low face"):
        load = forms.integral(p * body.ds(side))
        assert load == pytest.approx(-up[dim - 1], rel=1e-4)  # the faces tilt a little
        assert forms.integral((p / load - 1) ** 2 * body.ds(side)) < 0.03**2
        gaps = forms.integral(g * body.ds(side))
        x = term.surface.places()[:, dim - 1]
        between = x[term.surface.points[:, dim - 1] > 1 + dhat / 4].mean()
        between -= x[term.surface.points[:, dim - 1] < 1 + dhat / 4].mean()
        assert gaps == pytest.approx(between, rel=2e-2) and gaps < dhat
    assert forms.at(p, [0.5] * dim)[0] == 0
    with pytest.raises(ValueError, match="has the contacts surfaces, got 'floor'"):
        contact.pressure(path, "floor")
    with pytest.raises(ValueError, match="contact.clearance needs a problem with an obstacle"):
        contact.clearance(path)


def test_pressure_where_dhat_is_longer_than_the_pieces():
    """Forces at the points alternate there; pressure is force over area all the same: 1 %."""
    body, _, path = pressed(MPI.COMM_SELF, 8, 13, 0.035, by=0.04)
    up = contact.force(path, body.facets("up face"))[1]
    for side in ("up face", "low face"):
        load = forms.integral(contact.pressure(path) * body.ds(side))
        assert load == pytest.approx(-up, rel=1e-2)  # of wavy faces


def test_multigrid_solves_exactly_where_surfaces_touch():
    """The block of all nodes in contact, in the smoother of degree 2: CG to 1e-6 in fewer steps."""
    body = stack(MPI.COMM_SELF, 4, 6, 0.002, 3)
    u = forms.displacement(body, 2)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0) * ufl.dx
    term = forms.touching(u, body.ds("low face", "up face"), stiffness=1.0, dhat=0.01)
    held = [forms.clamp(u, body.facets(f"{name} end")) for name in ("low", "up")]
    problem, counts = forms.Problem([psi, term], u, held), {}
    problem.prepare()
    rows = touched(problem)
    assert len(rows) == 3 * (9**2 + 13**2)  # all nodes of both faces
    for smoother in ("python", "pbjacobi"):
        options = {"ksp_rtol": 1e-6} | (
            {} if smoother == "python" else {"smoother_pc_type": smoother}
        )
        newton = forms.solving.Newton(problem, options=options)
        newton.tangent.projecting = True
        newton.tangent.assemble()
        ksp = newton.tangent.ksp
        ksp.setOperators(newton.tangent.product, newton.tangent.A)
        assert ksp.getPC().getMGSmoother(1).getPC().getType() == smoother
        b, x = problem.create_vector(), problem.create_vector()
        b.array[rows] = np.cos(np.arange(len(rows)))
        assert newton.tangent.solve(b, x), ksp.getConvergedReason()
        counts[smoother] = ksp.getIterationNumber()
        newton.destroy()
    assert counts["python"] < 0.7 * counts["pbjacobi"]


def test_beyond_the_size_of_factors_contact_is_projected():
    """Blocks come to touch by multigrid alone, which needs definite tangents; the same state."""
    ends = []
    for size in (0, 10**9):
        settings = Settings(direct_up_to=0, factorized_up_to=size)
        how = {"degree": 2, "dim": 3, "by": 0.02, "settings": settings, "rtol": 1e-10}
        _, term, path = pressed(MPI.COMM_SELF, 2, 3, 0.005, **how)
        assert term.majorized == (size == 0) and path.completed
        by_multigrid = sum(step.convergence.linear_iterations for step in path.steps)
        newton = sum(step.convergence.iterations for step in path.steps)
        assert (by_multigrid > 2 * newton) == (size == 0)  # factors take one iteration each
        # Of the projected tangent eigenvalues say nothing.
        assert (path.steps[-1].convergence.negative is None) == (size == 0)
        ends.append(path.u.x.array)
    assert ends[0] == pytest.approx(ends[1], abs=1e-8)


def test_a_state_in_which_surfaces_cross_is_no_solution(monkeypatch):
    """Solve, as paths, certifies that nothing crosses, and refuses what does."""
    body = stack(MPI.COMM_SELF, 2, 3, 0.01)
    u = forms.displacement(body)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0) * ufl.dx
    term = forms.touching(u, body.ds("low face", "up face"), stiffness=1.0, dhat=0.02)
    held = [forms.clamp(u, body.facets("low end")), forms.clamp(u, body.facets("up end"))]
    monkeypatch.setattr(term, "certified", lambda: False)
    with pytest.raises(forms.NotConverged, match="[Ss]urfaces cross"):
        forms.solve([psi, term], u, held)
    assert np.all(u.x.array == 0)


@pytest.mark.parametrize("cells", ["triangle", "quadrilateral", "tetrahedron", "hexahedron"])
@pytest.mark.parametrize("degree", [1, 2, 3])
def test_a_uniform_pressure_at_the_points_is_one_at_the_nodes(cells, degree):
    """Areas of the points, shared out to the nodes, are the integrals of their functions: 1e-12."""
    dim = 2 if cells in ("triangle", "quadrilateral") else 3
    body = meshes.block(MPI.COMM_SELF, (1.0, 0.7, 0.8)[:dim], n=2, cells=cells)
    u = forms.displacement(body, degree)
    term = forms.touching(u, body.ds("top", "left"), stiffness=1.0, parts=4)
    numbers, values = term.surface.own_forces(np.repeat(term.mesh.vertex_areas, dim))
    ones = ufl.as_vector([1.0] * dim)
    form = fem.form(ufl.inner(ones, ufl.TestFunction(u.function_space)) * body.ds("top", "left"))
    exact = fem.assemble_vector(form).array
    assert values == pytest.approx(exact[numbers], abs=1e-12)
    assert np.abs(values).sum() > 1 and np.allclose(term.surface.map.sum(axis=1), 1.0)
    X = u.function_space.tabulate_dof_coordinates()[term.surface.dofs[:, 0] // dim, :dim]
    assert term.surface.map @ X == pytest.approx(term.surface.points, abs=1e-12)


def crossing(x, pairs):
    """Pairs of segments that cross, by signs of areas: nothing of the package's."""

    def area(a, b, c):
        return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])

    found = 0
    for (a, b), (c, d) in combinations(pairs, 2):
        if {a, b} & {c, d}:
            continue
        p, q, r, s = x[a], x[b], x[c], x[d]
        found += area(p, q, r) * area(p, q, s) < 0 and area(r, s, p) * area(r, s, q) < 0
    return found


def test_a_ring_is_crushed_flat_between_two_plates():
    """Its inner face meets itself; nothing crosses by a check of its own, J > 0 everywhere."""
    n, radii = 32, (0.9, 1.0)
    angles = np.linspace(0, 2 * np.pi, n, endpoint=False)
    points = np.array([[r * np.cos(a), r * np.sin(a)] for a in angles for r in radii])
    k = np.arange(n)
    cells = np.stack([2 * k, 2 * k + 1, 2 * ((k + 1) % n) + 1, 2 * ((k + 1) % n)], axis=1)
    names = {"inner": 2 * k, "outer": 2 * k + 1}
    body = meshes.from_arrays(MPI.COMM_SELF, points, cells, cell="quadrilateral", boundaries=names)
    t, u = forms.load_factor(body), forms.displacement(body)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0) * ufl.dx
    psi += 5e-5 * ufl.inner(u, u) * ufl.dx  # sideways nothing else holds it
    for sign in (1, -1):
        plate = forms.obstacles.plane((0, sign * (1.005 - 0.9 * t)), (0, -sign))
        psi += forms.obstacle(u, plate, body.ds("outer"), dhat=0.01, stiffness=1.0)
    term = forms.touching(u, body.ds("inner"), stiffness=1.0, dhat=0.02)
    path = forms.follow([psi, term], u, [], t, progress=False)
    assert path.completed and term.near()
    x = term.surface.places()
    assert np.ptp(x[:, 1]) < 0.1 and crossing(x, term.surface.edges.tolist()) == 0
    assert term.certified() and all(step.bounds.lower > 0 for step in path.steps)
    assert all(step.clearance.distance > 0 for step in path.steps)


def test_a_thrown_block_lands_on_a_soft_one():
    """In motion, without friction: momentum goes over, every joule is there, nothing crosses."""
    body = stack(MPI.COMM_SELF, 2, 3, 0.1)
    t, u = forms.load_factor(body), forms.displacement(body)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 50.0, 100.0) * ufl.dx
    term = forms.touching(u, body.ds("low face", "up face"), stiffness=10.0, dhat=0.05)
    X = ufl.SpatialCoordinate(body.mesh)
    velocity = ufl.as_vector([0, ufl.conditional(ufl.gt(X[1], 1.05), -1.0, 0.0)])
    path = forms.transient(
        [psi, term], u, (), t, to=0.4, rho=1.0, velocity=velocity, progress=False
    )
    momentum = path.record("momentum")
    assert np.abs(momentum - momentum[0]).max() < 1e-8 and momentum[0][1] == pytest.approx(-1)
    assert path.ledger.missed < 5e-3 * path.ledger.exchanged and term.certified()
    # One block hits its like: the struck one moves on with most of the speed.
    V = path.velocity.x.array.reshape(-1, 2)[:, 1]
    low = u.function_space.tabulate_dof_coordinates()[:, 1] < 1.05
    assert V[low].mean() < -0.5 and V[~low].mean() > -0.5


def test_a_path_of_surfaces_is_taken_up(tmp_path):
    """Broken off after contact has begun, it goes on as the uninterrupted one: bit by bit."""
    ends, runs = [], []
    for stop in (None, 6):
        for _ in range(1 if stop is None else 2):

            def breaks(path, stop=stop):
                if stop is not None and len(path.steps) == stop and path.resumed is None:
                    assert path.problem.terms[1].near()
                    raise KeyboardInterrupt

            options = {"checkpoint": forms.Checkpoint(tmp_path / str(stop), every=1)}
            try:
                _, _, path = pressed(MPI.COMM_SELF, 3, 4, 0.02, on_step=breaks, **options)
            except KeyboardInterrupt:
                continue
        ends.append(path.u.x.array.copy())
        runs.append([step.load for step in path.steps])
    assert path.resumed is not None and path.resumed < 1
    assert np.array_equal(ends[0], ends[1]) and runs[0] == runs[1]


def test_ways_begin_at_the_last_accepted_state():
    """Where a path is taken up its way begins there, not where the run began, beyond a surface."""
    body = stack(MPI.COMM_SELF, 2, 3, 0.1)
    u = forms.displacement(body)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0) * ufl.dx
    term = forms.touching(u, body.ds("low face", "up face"), stiffness=1.0, dhat=0.02)
    problem = forms.Problem([psi, term], u, [forms.clamp(u, body.facets("low end"))])
    u.interpolate(lambda x: np.stack([0 * x[0], -3.0 * (x[1] > 1.05)]))  # to the other side
    assert problem.crossed() == "surfaces would pass each other"
    problem.rollback()
    assert problem.crossed() == ""


def test_bad_input_of_surfaces():
    """Surfaces that cross at the start, dhat larger than the cells, no modulus, no boundary."""
    body = stack(MPI.COMM_SELF, 2, 3, -0.05)
    t, u = forms.load_factor(body), forms.displacement(body)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0) * ufl.dx
    faces = body.ds("low face", "up face", "side 0")
    for options, words in (
        ({"stiffness": 0.0}, "the stiffness of contact is a pressure above 0"),
        (
            {"stiffness": 1.0, "dhat": 0.9},
            "dhat of contact is a length above 0 and up to the small",
        ),
        ({"stiffness": 1.0, "parts": 0}, "parts of contact is a whole number of at least 1, got 0"),
        ({"stiffness": 1.0, "thickness": -1}, "a thickness is not negative, got -1"),
    ):
        with pytest.raises(ValueError, match=words):
            forms.touching(u, faces, **options)
    round_ = forms.energies.neo_hookean(forms.axisymmetric(u), 1.0, 2.0) * forms.circumference(u)
    with pytest.raises(ValueError, match="contact of surfaces knows no bodies of revolution"):
        forms.Problem([round_ * ufl.dx, forms.touching(u, faces, stiffness=1.0)], u)
    with pytest.raises(ValueError, match="contact needs a measure"):
        forms.touching(u, body.facets("side 0"), stiffness=1.0)
    term = forms.touching(u, faces, stiffness=1.0)
    held = [forms.clamp(u, body.facets("low end")), forms.clamp(u, body.facets("up end"))]
    with pytest.raises(ValueError, match=r"surfaces cross or touch at the start, at \(") as caught:
        forms.solve([psi, term], u, held)
    place = re.search(r"\((\S+), (\S+)\)", str(caught.value))
    assert abs(float(place[2]) - 0.975) < 0.1  # where they do, and not somewhere
    assert t is not None


def test_triangles_that_cross_are_found():
    """One through another, beside it, above it; corners in common do not count."""
    a = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], float)
    two = np.array([[0, 1, 2], [3, 4, 5]])
    right, up = np.array([1.0, 1, 0]), np.array([0, 0, 0.6])
    through = np.array([[0.2, 0.2, -0.5], [0.3, 0.2, 0.5], [0.2, 0.3, 0.5]])
    for b, found in ((through, 1), (through + right, 0), (through + up, 0), (a, 0)):
        assert crossings(np.r_[a, b], two) == found
    assert crossings(np.r_[a, through[1:]], np.array([[0, 1, 2], [0, 3, 4]])) == 0


@pytest.mark.slow
def test_a_cloth_is_folded_twice():
    """In motion, in four layers: nothing crosses by a check of its own, no triangle vanishes."""
    watch, path = self_contact.cloth(n=8, time=6.0)
    assert path.completed and path.steps[-1].load == 6.0
    assert watch.crossed == 0 and watch.least > 0.5 and watch.touching > 50
    x = watch.term.surface.places()
    assert np.ptp(x[:, 0]) < 0.6 and np.ptp(x[:, 1]) < 0.6  # a quarter of what it was


@pytest.mark.slow
def test_a_twisted_bar_writhes():
    """Four turns while its ends approach: it touches itself, crosses nowhere, and J > 0."""
    watch, path = self_contact.bar(h=0.1, time=10.0, to=8.2, parts=2)
    assert path.completed and path.steps[-1].load == 8.2
    assert watch.crossed == 0 and watch.least > 0 and watch.touching > 10
