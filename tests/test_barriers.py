# SPDX-License-Identifier: MIT
"""Laws of barriers: no step takes a point across an obstacle, whatever its length; starts."""

from mpi4py import MPI

import numpy as np
import pytest
import ufl

from variform import forms, meshes
from variform.forms import obstacles


def scene(distance, dim=2, degree=1, where="bottom", **given):
    """A block with an obstacle, and its one barrier."""
    body = meshes.block(MPI.COMM_SELF, (1.0,) * dim, n=3)
    u = forms.displacement(body, degree)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0)
    given = {"stiffness": 1.0, "name": "it", **given}
    t = forms.load_factor(body)
    distance = distance if isinstance(distance, obstacles.Distance) else distance(t)
    wall = forms.obstacle(u, distance, body.ds(where), **given)
    problem = forms.Problem(psi * ufl.dx + wall, u)
    return problem, problem.forms.barriers.all[0], t


def largest(problem, values, moves=None):
    """Allowed fraction of a step of the unknown."""
    step = problem.create_vector()
    step.array[:] = values
    return problem.largest_step(step, moves)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("degree", [1, 2])
def test_a_step_leaves_a_tenth_of_the_distance(dim, degree, rng):
    """Of a plane the exact fraction, 0.9 d / v at the worst point, to 4 %: twice NARROW."""
    up = (0.3, 1.0, 0.2)[:dim] if dim == 2 else (0.3, 0.2, 1.0)
    problem, barrier, _ = scene(obstacles.plane((0,) * dim, up), dim, degree, gap=0.2)
    n = np.array(up) / np.linalg.norm(up)
    for scale in 10.0 ** np.arange(-3, 7):
        step = scale * rng.normal(size=problem.u.x.array.size)
        d = barrier.places() @ n + 0.2
        v = -(barrier.ways(step) @ n)
        exact = min(1.0, (0.9 * d[v > 0] / v[v > 0]).min())
        found = largest(problem, step)
        assert found <= exact * (1 + 1e-12) and found > 0.96 * exact
    assert largest(problem, 0 * step) == 1


SHAPES = {
    "thin disk": lambda t: obstacles.sphere((0.4, -0.3), 0.004),
    "hollow": lambda t: obstacles.sphere((0.5, 0.4), 1.1, inside=True),
    "thin box": lambda t: obstacles.box((0.2, -0.4), (0.9, -0.395)),
    "needle": lambda t: obstacles.cone((0.35, -0.2), (0, -1), 0.02),
    "one's own": lambda t: lambda x: (x[1] + 0.3 - 0.2 * ufl.sin(9 * x[0])) * (2 + x[0] ** 2),
}


@pytest.mark.parametrize("name", SHAPES)
def test_no_step_tunnels(name, rng):
    """Steps of 1e-2 to 1e4 lengths of the body: no point is beyond at 2000 places of its way."""
    problem, barrier, _ = scene(SHAPES[name], degree=2)
    stopped = 0
    for scale in 10.0 ** rng.uniform(-2, 4, 30):
        step = np.zeros(problem.u.x.array.size)
        step += scale * rng.normal(size=len(step)) * rng.choice([0.01, 1.0])
        step += np.tile(scale * rng.normal(size=2), len(step) // 2)
        fraction = largest(problem, step)
        x, dx = barrier.places(), barrier.ways(step)
        start = barrier.label.bounds(x, x)[0]
        way = x + np.linspace(0, fraction, 2000)[:, None, None] * dx
        way = way.reshape(-1, 2)
        d = barrier.label.bounds(way, way)[0].reshape(2000, -1)
        assert np.all(d > 0.099 * start)
        stopped += fraction < 1
    assert 3 < stopped < 30


def test_tools_that_move_do_not_pass():
    """A thin tool that jumps over the boundary by its load factor is seen, and where."""
    problem, barrier, t = scene(lambda t: obstacles.sphere((0.5, -0.5 + t), 0.01))
    assert problem.crossed() == ""
    t.value = 1.2  # far on the other side
    assert barrier.clearance().distance > 0.3
    assert problem.crossed() == "the body would cross the obstacle it on its way to (0.5, 0)"
    t.value = 0.4
    assert problem.crossed() == ""
    t.value = 0.0
    # a tool and a boundary that go towards each other, with 0.49 between them
    step = np.tile([0.0, -1.0], problem.u.x.array.size // 2)
    both = largest(problem, step, {t: 1.0})
    assert both == pytest.approx(0.9 * 0.49 / 2, rel=0.04)
    assert largest(problem, step) == pytest.approx(0.9 * 0.49, rel=0.04)
    assert largest(problem, 0 * step, {t: 1e5}) == pytest.approx(0.9 * 0.49 / 1e5, rel=0.04)
    t.value = 0.4
    problem.commit()
    t.value = 1.2
    assert problem.crossed() != ""
    problem.rollback()
    assert problem.crossed() == ""


def test_a_start_beyond_is_refused():
    """Where, how much, of which obstacle, and the gap from which it would start; that starts."""
    floor = obstacles.plane((0, 0.1), (0, 1))
    problem, *_ = scene(floor, name="floor", dhat=0.1)
    with pytest.raises(ValueError) as caught:
        forms.solve(problem)
    words = str(caught.value)
    assert "at (" in words and "the body is 0.1 beyond the obstacle floor" in words
    gap = float(words.partition("gap=")[2].partition(",")[0])
    assert gap == pytest.approx(0.2, abs=2e-3)
    problem, *_ = scene(floor, gap=gap, dhat=0.1)
    problem.begin()
    assert problem.energy() == 0
    touching, *_ = scene(obstacles.plane((0, 0), (0, 1)), name="table")
    with pytest.raises(ValueError, match=r"the obstacle table: move one of the two, or start with"):
        touching.begin()
    u, body = touching.u, touching.u.function_space.mesh
    falling = 0.2 * forms.load_factor(body)
    ds = ufl.ds(domain=body)
    wall = forms.obstacle(u, floor, ds, gap=falling, stiffness=1.0, dhat=0.1)
    with pytest.raises(ValueError, match=r"start with a gap larger by 0\.2,"):
        forms.Problem(wall + forms.spring(u, 1.0, ufl.dx), u).begin()


def test_supports_beyond_an_obstacle_are_named():
    """A support that pushes the boundary through is no state: the sentence says through what."""
    body = meshes.block(MPI.COMM_SELF, (1.0, 1.0), n=3)
    u, t = forms.displacement(body), forms.load_factor(body, 1.0)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0)
    wall = forms.obstacle(u, obstacles.sphere((0.5, -0.3), 0.1), body.ds("bottom"), name="pin")
    held = forms.translate(u, body.facets("bottom"), (0.0, -1.0 * t))
    with pytest.raises(
        forms.NotConverged, match="the body would cross the obstacle pin on its way"
    ):
        forms.solve(psi * ufl.dx + wall, u, [held])
    assert not np.any(u.x.array)
    t.value = 0.0
    with pytest.raises(forms.NotConverged, match="pin|obstacle"):
        forms.follow(psi * ufl.dx + wall, u, [held], t, step=1.0, progress=False)
    assert 0 < forms.contact.clearance(forms.Problem(psi * ufl.dx + wall, u)).distance < 0.05


def test_a_way_that_is_not_finite_is_not_gone():
    """A singular tangent's direction: nothing of it is allowed, and nothing warns."""
    problem, _, _ = scene(obstacles.plane((0, 0), (0, 1)), gap=0.2)
    for value in (np.inf, -np.inf, np.nan):
        assert largest(problem, value) == 0
