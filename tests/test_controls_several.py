# SPDX-License-Identifier: MIT
"""Several scalars that hold as many functionals: mean stretches, two chambers, an end's turn."""

from itertools import pairwise

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from broken_paths import Stopped, stop_after
from cases import at_plane
from dolfinx import fem

from variform import forms, meshes
from variform.forms.measured import measured
from variform.forms.solving.linearized import Linearized
from variform.forms.solving.rates import Rates

TIGHT = {"rtol": 1e-12, "ctol": 1e-10, "progress": False}
ROWS = [(0.2, -0.05), (0.5, 0.1), (0.3, 0.4)]  # mean elongations of a block


class Block:
    """A neo-Hookean block on rollers under dead tractions, as many mean elongations held."""

    def __init__(self, dim, comm=MPI.COMM_SELF, cells=None, count=2):
        body = meshes.block(comm, (1.0,) * dim, n=2, cells=cells)
        self.u = u = forms.displacement(body)
        self.q = [fem.Constant(body.mesh, 0.0) for _ in range(count)]
        self.mu, self.lmbda = fem.Constant(body.mesh, 1.0), fem.Constant(body.mesh, 2.0)
        F = forms.deformation_gradient(u)
        potential = forms.energies.neo_hookean(F, self.mu, self.lmbda) * ufl.dx
        ends = (("right", "top") if dim == 2 else ("right", "back", "top"))[:count]
        for k, (end, t) in enumerate(zip(ends, self.q, strict=True)):
            pull = ufl.as_vector([t if i == k else 0 * t for i in range(dim)])
            potential += forms.dead_traction(u, pull, body.ds(end))
        fixed = ("left", "bottom") if dim == 2 else ("left", "front", "bottom")
        held = [forms.roller(u, body.facets(name), k) for k, name in enumerate(fixed)]
        self.problem = forms.Problem(potential, u, held)
        self.means = [u[k] * body.ds(end) for k, end in enumerate(ends)]

    def control(self, targets=ROWS, **options):
        return forms.control(
            self.problem, None, (), self.q, self.means, targets, **{"progress": False} | options
        )


def tractions(dim, elongations):
    """P_i = mu (l_i - 1/l_i) + lmbda ln J / l_i; l_3 = 1 in plane strain, in space P_3 = 0."""
    given, free = 1 + np.array(elongations), 1.0
    J = np.prod(given)
    for _ in range(40 if dim == 3 and len(given) == 2 else 0):  # mu (l^2 - 1) + lmbda ln J l = 0
        free -= (free**2 - 1 + 2 * np.log(J * free)) / (2 * free + 2 / free)
    return given - 1 / given + 2 * np.log(J * free) / given


@pytest.mark.parametrize(("dim", "count"), [(2, 2), (3, 2), (3, 3)])
def test_mean_stretches_by_as_many_tractions(dim, count):
    """A block whose mean stretches are given is uniform, its tractions in closed form."""
    rows = [(*row, -0.1)[:count] for row in ROWS]
    path = Block(dim, count=count).control(rows, **TIGHT)
    assert path.completed and path.record("target").tolist() == [list(row) for row in rows]
    exact = np.array([tractions(dim, row) for row in rows])
    assert np.abs(path.record("q") - exact).max() < 1e-9
    assert [step.load for step in path.steps] == path.record("q")[:, 0].tolist()


@pytest.mark.parametrize(("dim", "unit"), [(2, 1.0), (3, 1.0), (2, 1e-6)])
def test_the_ledger_closes_around_corners(dim, unit):
    """Work of both tractions is what is stored, where the way bends, too, in any units.

    Six targets on each leg make polynomials of degree 5 and 3e-7; over the corners it is 1e-4.
    """
    corners = np.array([(0.0, 0.0), *ROWS, (0.0, 0.0)])
    shares = np.linspace(0.0, 1.0, 7)[1:, None]
    rows = [a + shares * (b - a) for a, b in pairwise(corners)]
    block = Block(dim)
    block.means[1] = unit * block.means[1]
    path = block.control(np.concatenate(rows) * (1.0, unit))
    stored = sum(row.stored for row in path.ledger)
    assert path.ledger.missed < 2e-6 * path.ledger.exchanged and path.ledger.exchanged > 0.3
    assert abs(stored) < 1e-6 * path.ledger.exchanged  # at rest again
    assert "Unaccounted" not in path.reason


class Chambers:
    """Octants of two spheres, radii 1 and 1/2, shear moduli 1 and 2, a pressure and volume each."""

    def __init__(self, which=(0, 1), comm=MPI.COMM_SELF, stiff=2.0):
        sheet = meshes.spherical_sheet(MPI.COMM_SELF, 1.0, 0.5, 1, "octant").mesh.geometry
        x, cells = sheet.x, np.array(sheet.dofmap)
        # The second one lies across the origin: the same three planes are those of symmetry.
        parts = [(x, cells), (-0.5 * x, cells[:, ::-1])]
        points = np.concatenate([parts[n][0] for n in which])
        joined = np.concatenate([parts[n][1] + k * len(x) for k, n in enumerate(which)])
        tags = np.repeat(which, len(cells))
        body = meshes.from_arrays(
            comm, points, joined, regions={f"{n}": tags == n for n in which}, gdim=3
        )
        self.u = u = forms.displacement(body)
        self.q = [fem.Constant(body.mesh, 0.1) for _ in which]
        F, potential, self.volumes = forms.membrane_gradient(u), 0, []
        side = forms.membranes.orientation(body)
        for n, p in zip(which, self.q, strict=True):
            dx = body.dx(f"{n}")
            self.volumes.append(forms.enclosed_volume(u, side, dx))
            mu = fem.Constant(body.mesh, (1.0, stiff)[n])
            potential += forms.energies.neo_hookean_sheet(F, mu) * dx - p * self.volumes[-1]
        planes = [at_plane(body.mesh, k, 0.0) for k in range(3)]
        held = [forms.roller(u, facets, k) for k, facets in enumerate(planes)]
        self.problem = forms.Problem(potential, u, held)
        self.start = np.array([forms.integral(v) for v in self.volumes])

    def control(self, stretches, **options):
        targets = self.start * np.array(stretches) ** 3
        if len(self.q) == 1:
            return forms.control(
                self.problem, None, (), *self.q, *self.volumes, targets[:, 0], **TIGHT, **options
            )
        return forms.control(
            self.problem, None, (), self.q, self.volumes, targets, **TIGHT, **options
        )


STRETCHES = np.column_stack([np.linspace(1.1, 2.0, 10), np.linspace(1.05, 1.3, 10)])


def test_two_chambers_are_two_single_ones():
    """Each has the pressures that it has alone, over the limit point of one of them.

    That lies at the stretch 7^(1/6) = 1.383 of both; the other chamber's pressure does not turn.
    """
    both = Chambers()
    path = both.control(STRETCHES)
    for n in (0, 1):
        alone = Chambers([n]).control(STRETCHES[:, n : n + 1])
        found = np.array([step.load for step in alone.steps])
        assert path.record("q")[:, n] == pytest.approx(found, rel=1e-9)
    first, second = path.record("q").T
    assert 0 < first.argmax() < 9 and second.argmax() == 9
    assert path.ledger.missed < 1e-3 * path.ledger.exchanged
    (event,) = path.events
    assert (event.kind, event.before, event.after) == ("limit point", 0, 1)
    assert event.load == pytest.approx(first.max(), rel=1e-2)


def test_two_limit_points_at_once():
    """Chambers that are filled alike pass theirs together: no bifurcation of the held path."""
    alike = Chambers(stiff=0.5)  # by half the size, half the modulus has the same pressure
    path = alike.control(np.column_stack([STRETCHES[:, 0]] * 2))
    assert path.record("q")[:, 1] == pytest.approx(path.record("q")[:, 0], rel=1e-8)
    (event,) = path.events
    assert (event.kind, event.before, event.after) == ("limit point", 0, 2)


def test_a_bifurcation_is_none_of_the_scalars():
    """A column shortened at constant width buckles at pi^2 EI / (4 L^2), E = 2 mu as nu = 0."""
    body = meshes.block(MPI.COMM_SELF, (10.0, 1.0), n=(20, 2), cells="quadrilateral")
    u, q = forms.displacement(body, 2), [fem.Constant(body.mesh, 0.0) for _ in range(2)]
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 0.0) * ufl.dx
    shorter = -u[0] * body.ds("right")
    wider = u[1] * body.ds("top") - u[1] * body.ds("bottom")
    held = [forms.clamp(u, body.facets("left"))]
    problem = forms.Problem(psi - q[0] * shorter - q[1] * wider, u, held)
    rows = [(0.01, 0.0), (0.03, 0.0), (0.05, 0.0)]
    path = forms.control(problem, None, (), q, [shorter, wider], rows, progress=False)
    (event,) = path.events
    assert (event.kind, event.before, event.after) == ("bifurcation", 0, 1)
    assert event.load == pytest.approx(np.pi**2 * 2 / 12 / 400, rel=0.02)
    assert "Unaccounted" not in path.reason


def test_a_force_and_a_moment_guide_an_end():
    """An end that goes down without a turn: the moment is F L / 2, whatever the shear.

    The turn is held at 0, where it is from the start, to the scale of the body.
    """
    length, height = 10.0, 1.0
    body = meshes.block(MPI.COMM_SELF, (length, height), n=(20, 4), cells="quadrilateral")
    u, X = forms.displacement(body, 2), ufl.SpatialCoordinate(body.mesh)
    force, moment = (fem.Constant(body.mesh, 0.0) for _ in range(2))
    end, arm = body.ds("right"), X[1] - height / 2
    down, turn = -u[1] * end, -arm * u[0] * end
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 0.0) * ufl.dx
    potential = psi - force * down - moment * turn
    held = [forms.clamp(u, body.facets("left"))]
    problem = forms.Problem(potential, u, held)
    path = forms.control(
        problem, None, (), [force, moment], [down, turn], [(0.01, 0.0), (0.02, 0.0)], **TIGHT
    )
    # F acts on the whole end of area 1; the moment of the tractions m y is m I.
    F, m = path.steps[-1].records["q"]
    assert m / 12 == pytest.approx(F * length / 2, rel=2e-3)
    assert abs(forms.integral(turn)) < 1e-10
    assert sum(step.convergence.iterations for step in path.steps) < 10
    # From a turn that is 0 to the tolerance only.
    on = forms.control(problem, None, (), [force, moment], [down, turn], [(0.03, 0.0)], **TIGHT)
    assert on.load == pytest.approx(1.5 * F, rel=1e-3)
    assert on.steps[0].convergence.iterations < 6
    moved = u.x.array.copy()
    u.x.array[:] = 0
    forms.solve(problem, rtol=1e-12, ctol=1e-10)
    assert np.abs(u.x.array - moved).max() < 1e-8 * np.abs(moved).max()


@pytest.mark.parametrize("lead", [lambda: Block(3), Chambers], ids=["block", "chambers"])
def test_a_path_broken_off_goes_on_bit_by_bit(lead, tmp_path):
    """Loads, iterations, records, the account and the last state are those without a break."""
    aims = STRETCHES if lead is Chambers else ROWS
    plain = lead().control(aims, checkpoint=forms.Checkpoint(tmp_path / "plain"))
    broken = {"checkpoint": forms.Checkpoint(tmp_path / "broken")}
    with pytest.raises(Stopped):
        lead().control(aims, on_step=stop_after(len(aims) // 2 + 1), **broken)
    path = lead().control(aims, **broken)
    assert path.resumed == plain.steps[len(aims) // 2 - 1].load and path.completed
    assert path.steps == plain.steps and path.balances == plain.balances
    assert np.array_equal(path.u.x.array, plain.u.x.array) and path.events == plain.events
    with pytest.raises(
        ValueError, match=r"checkpoint's targets were \[\[.*, these begin with \[\["
    ):
        lead().control(np.array(aims) + 0.01, **broken)


def test_gradients_hold_both_functionals():
    """J(m + h dm) = J(m) + h dJ/dm dm + O(h^2), both functionals kept; forward as backward.

    The functionals are not those that the tractions work on, and one contains q and mu.
    """
    block = Block(3, cells="tetrahedron")
    mesh = block.u.function_space.mesh
    weighted = (1 + ufl.SpatialCoordinate(mesh)[0]) * ufl.inner(block.u, block.u) * ufl.dx
    first, second = block.means
    block.means = [
        first + 0.5 * second + 0.1 * block.mu * block.q[1] * ufl.dx(domain=mesh),
        second,
    ]
    m = [block.mu, block.lmbda]

    def solve():
        block.u.x.array[:] = 0
        return block.control([(0.3, 0.1)], **TIGHT)

    def values(h):
        block.mu.value, block.lmbda.value = 1 + 0.3 * h, 2 - 0.5 * h
        path = solve()
        return np.array([forms.integral(weighted), *path.steps[-1].records["q"]])

    before, path = values(0.0), solve()
    slopes = [forms.gradient(path, J, m) @ np.array([0.3, -0.5]) for J in (weighted, *block.q)]
    remainders = [np.abs(values(h) - before - h * np.array(slopes)) for h in (0.04, 0.02, 0.01)]
    for rest in np.transpose(remainders):
        assert np.log2(np.divide(rest[:-1], rest[1:])) == pytest.approx(2, abs=0.1)
    values(0.0)
    found = [measured(J, block.problem, path.held, "this") for J in (weighted, *block.q)]
    with Linearized(block.problem) as linear:
        columns = Rates(block.problem, found, m, path.held)(linear)[1]
    forward = np.concatenate(columns) @ np.array([0.3, -0.5])
    assert forward == pytest.approx(slopes, rel=1e-8)


def test_pressures_that_follow_are_found_again():
    """By an unsymmetric tangent: what two pressures without a potential move, finds them."""
    body = meshes.block(MPI.COMM_SELF, (2.0, 1.0), n=(4, 2), cells="quadrilateral")
    u, p = forms.displacement(body), [fem.Constant(body.mesh, x) for x in (0.1, -0.2)]
    v, mu = ufl.TestFunction(u.function_space), fem.Constant(body.mesh, 1.0)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), mu, 2.0) * ufl.dx
    work = forms.follower_pressure(u, p[0], v, body.ds("top"))
    work += forms.follower_pressure(u, p[1], v, body.ds("right"))
    held = [forms.clamp(u, body.facets("left"))]
    problem = forms.Problem(psi, u, held, virtual_work=work)
    means = [u[1] * body.ds("top"), u[0] * body.ds("right")]
    forms.solve(problem, rtol=1e-12, ctol=1e-10)
    targets = np.array([forms.integral(mean) for mean in means])

    def values(h):
        u.x.array[:], mu.value = 0, 1.0 + h
        for each in p:
            each.value = 0.0
        path = forms.control(problem, None, (), p, means, targets * [[0.5], [1.0]], **TIGHT)
        return np.array([*path.steps[-1].records["q"]]), path

    before, path = values(0.0)
    assert before == pytest.approx([0.1, -0.2], rel=1e-9)
    assert path.ledger.exchanged > 1e-2 and path.steps[-1].convergence.negative is None
    slopes = np.array([forms.gradient(path, each, mu) for each in p])
    rest = [np.abs(values(h)[0] - before - h * slopes) for h in (0.04, 0.02, 0.01)]
    rates = np.log2(np.divide(rest[:-1], rest[1:]))
    assert rates == pytest.approx(np.full((2, 2), 2), abs=0.1)


def test_a_fit_to_both_tractions(tmp_path):
    """Both moduli from the second traction at three pairs of mean stretches, in closed form."""
    block = Block(3)
    y = [tractions(3, row)[1] for row in ROWS]
    data = forms.Data(block.problem, block.q[1], y, t=block.q, loads=ROWS, held=block.means)
    block.mu.value, block.lmbda.value = 0.8, 2.5
    fit = forms.fit(data, {"mu": block.mu, "lmbda": block.lmbda}, progress=False)
    assert fit.values == pytest.approx([1.0, 2.0], rel=1e-7)
    fit.plot(tmp_path / "fit.png")  # over the first of the functionals
    assert (tmp_path / "fit.png").stat().st_size > 1000


SCRIPT = """
import json, sys
sys.path.insert(0, {tests!r})
from mpi4py import MPI
from test_controls_several import ROWS, STRETCHES, TIGHT, Block, Chambers
chambers = Chambers(comm=MPI.COMM_WORLD)
paths = Block(3, MPI.COMM_WORLD).control(**TIGHT), chambers.control(STRETCHES[::3])
if MPI.COMM_WORLD.rank == 0:
    print(json.dumps([float(x) for path in paths for x in path.record("q").ravel()]))
"""


def test_ranks_agree(parallel, root):
    """Both scalars of every target are the same on 1, 2 and 3 ranks."""
    script = SCRIPT.format(tests=str(root / "tests"))
    one, two, three = (parallel(script, ranks) for ranks in (1, 2, 3))
    assert two == pytest.approx(one, rel=1e-10) and three == pytest.approx(one, rel=1e-10)


def other(block):
    return fem.Constant(block.u.function_space.mesh, 1.0)


@pytest.mark.parametrize(
    ("q", "functionals", "targets", "message"),
    [
        ([0], [0, 1], [(1, 1)], "as many scalars q as it holds functionals, got 1 and 2"),
        ([0, 1], [0, 1], [(1, 1), (1, 2, 3)], r"2 numbers for each target.*\(3,\) as target 2"),
        ([0, 1], [0, 1], [1.0, 2.0], r"2 numbers for each target, .* shape \(\) as target 1"),
        ([0, 1], [0, 1], [], "got Form and 0 targets"),
        ([0, 0], [0, 1], [(1, 1)], "needs each q once, got number 2 twice"),
        ([0, 1], [1, 1], [(1, 1)], "needs each functional once, got number 2 twice"),
        ([0, None], [0, 1], [(1, 1)], "the potential does not contain q number 2"),
        ([0, 1], [0, None], [(1, 1)], "residual needs a potential"),
        ([0, 1], [0, "threefold"], [(1, 1)], "each functional to change .* numbers 1 and 2 that"),
        ([0, 1], ["square", 1], [(1, 1)], "each functional to change with u, got number 1 that"),
    ],
)
def test_bad_input_gets_one_sentence(q, functionals, targets, message):
    block = Block(2)
    known = {None: other(block) * ufl.dx, "threefold": 3 * block.means[0] + 0 * block.means[1]}
    known |= {"square": ufl.inner(block.u, block.u) * ufl.dx, 0: block.means[0], 1: block.means[1]}
    scalars = [other(block) if n is None else block.q[n] for n in q]
    with pytest.raises(ValueError, match=message):
        forms.control(
            block.problem,
            None,
            (),
            scalars,
            [known[n] for n in functionals],
            targets,
            progress=False,
        )


def test_scalars_that_load_alike_are_told():
    """Two tractions on the same end cannot hold two functionals; none of them is of no use."""
    block = Block(2)
    u, q = block.u, [other(block), other(block)]
    pull = (q[0] + 2 * q[1]) * block.means[0]
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0) * ufl.dx
    problem = forms.Problem(psi - pull, u, block.problem.supports)
    with pytest.raises(
        ValueError, match="each q to load the body in its own way, got numbers 1 and"
    ):
        forms.control(problem, None, (), q, block.means, [(0.1, 0.1)], progress=False)


def test_a_functional_that_no_scalar_changes_is_told():
    """Of two blocks apart, both loads act on the one: nothing moves the other's mean."""
    square = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)])
    body = meshes.from_arrays(
        MPI.COMM_SELF,
        np.concatenate([square, square + np.array([0.0, 2.0])]),
        np.arange(8).reshape(2, 4),
        regions={"one": [0], "other": [1]},
    )
    u = forms.displacement(body)
    q = [fem.Constant(body.mesh, 0.0) for _ in range(2)]
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0) * ufl.dx
    load = forms.body_force(u, (q[0], q[1]), body.dx("one"))
    held = [forms.clamp(u, at_plane(body.mesh, 0, 0.0))]
    means = [u[0] * body.dx("one"), u[0] * body.dx("other")]
    with pytest.raises(forms.NotConverged, match="singular, no q changes functional 2"):
        forms.control(psi + load, u, held, q, means, [(0.1, 0.1)], progress=False)
