# SPDX-License-Identifier: MIT
"""Laws of problems: made once, solved often; terms beside the forms; found again by the calls."""

import json

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from cases import at_plane, unit_mesh
from dolfinx import fem

from variform import forms, meshes
from variform.forms import terms
from variform.forms.solving import reuse


def scene(n=2, load=0.1):
    """A square between a clamped and a loaded edge."""
    body = meshes.block(MPI.COMM_SELF, (1.0, 1.0), n=n)
    u, t = forms.displacement(body), forms.load_factor(body, 1.0)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0)
    pull = forms.dead_traction(u, ufl.as_vector([load * t, 0.0]), body.ds("right"))
    return psi * ufl.dx + pull, u, [forms.clamp(u, body.facets("left"))], t


def test_a_second_solve_sets_nothing_up(monkeypatch):
    """No form, no matrix, no solver is made again while the objects are the same."""
    potential, u, held, t = scene()
    first = forms.solve(potential, u, held)

    def refuse(*arguments, **options):
        raise AssertionError("set up again")

    monkeypatch.setattr(terms, "compiled", refuse)
    monkeypatch.setattr(reuse, "Newton", refuse)
    monkeypatch.setattr(forms.Problem, "create_matrix", refuse)
    t.value = 1.5
    second = forms.solve(potential, u, held)
    assert second.problem is first.problem
    assert second.steps[0].convergence.iterations > 0
    t.value = 0.0
    u.x.array[:] = 0
    assert len(forms.follow(potential, u, held, t, progress=False).steps) > 2
    with pytest.raises(AssertionError, match="set up again"):
        forms.solve(potential, u, held, rtol=1e-10)


def test_a_solve_does_not_know_of_earlier_ones():
    """Whatever was solved before with the same problem, states are the same bit by bit."""
    potential, u, held, t = scene(4)
    problem = forms.Problem(potential, u, held)
    ends = []
    for before in ((), (3.0,), (-0.4, 2.0)):
        for load in before:
            t.value = load
            forms.solve(problem)
        u.x.array[:] = 0
        t.value = 0.0
        path = forms.follow(problem, t=t, progress=False)
        ends.append((u.x.array.copy(), [s.convergence.residuals for s in path.steps]))
    for values, residuals in ends[1:]:
        assert np.array_equal(values, ends[0][0]) and residuals == ends[0][1]


def test_calls_take_a_problem_or_its_parts():
    """A problem comes with its unknown and supports; with another's it is refused."""
    potential, u, held, _ = scene()
    problem = forms.Problem(potential, u, held)
    moved = forms.solve(problem).u.x.array.copy()
    u.x.array[:] = 0
    assert forms.solve(potential, u, held).problem is not problem
    assert np.array_equal(u.x.array, moved)
    assert forms.solve(problem, u, held).problem is problem
    other = forms.displacement(u.function_space.mesh)
    for wrong in ((problem, other), (problem, u, held[:0] + held + held)):
        with pytest.raises(ValueError, match="a problem comes with its unknown, supports and virt"):
            forms.solve(*wrong)
    with pytest.raises(ValueError, match="a solve needs the unknown itself.* got NoneType"):
        forms.solve(potential)
    with pytest.raises(ValueError, match="needs a UFL form among them, got 1 others"):
        forms.Problem([Well(u, 1.0, 1.0)], u)


def test_a_solve_within_a_path_leaves_its_solver_alone():
    """A record that solves another problem, or the same one, while the path goes on."""
    potential, u, held, t = scene()
    t.value = 0.0
    other, v, clamped, _ = scene(3)
    paths = []
    for record in (
        None,
        {"other": lambda p: forms.solve(other, v, clamped).problem.energy()},
        {"same": lambda p: forms.solve(p).problem.energy()},
    ):
        u.x.array[:], t.value = 0, 0.0
        paths.append(forms.follow(potential, u, held, t, record=record, progress=False))
    counts = [[s.convergence.iterations for s in path.steps] for path in paths]
    assert counts[0] == counts[1] == counts[2]
    assert np.ptp(paths[1].record("other")) == 0


class Well:
    """k/4 (|u|^2 - a^2)^2 at each node of this rank: an energy that no form knows."""

    def __init__(self, u, k, a):
        self.u, self.k, self.a, self.calls = u, k, a, []
        V = u.function_space
        self.nodes, self.dim = V.dofmap.index_map.size_local, V.dofmap.bs

    def _values(self):
        return self.u.x.array.reshape(-1, self.dim)[: self.nodes]

    def prepare(self):
        self.calls.append("prepare")

    def energy(self):
        u = self._values()
        own = self.k / 4 * float(((u * u).sum(axis=1) - self.a**2).dot((u * u).sum(1) - self.a**2))
        return self.u.function_space.mesh.comm.allreduce(own)

    def residual(self, b):
        u = self._values()
        with b.localForm() as local:
            force = self.k * ((u * u).sum(axis=1) - self.a**2)[:, None] * u
            local.array[: force.size] += force.ravel()

    def tangent(self, A, projected=False):
        u, first = self._values(), A.getOwnershipRange()[0]
        s = (u * u).sum(axis=1) - self.a**2
        for node in range(self.nodes):
            K = self.k * (s[node] * np.eye(self.dim) + 2 * np.outer(u[node], u[node]))
            if projected:
                values, vectors = np.linalg.eigh(K)
                K = vectors @ np.diag(np.maximum(values, 0)) @ vectors.T
            rows = np.arange(first + self.dim * node, first + self.dim * (node + 1), dtype=np.int32)
            A.setValues(rows, rows, K.ravel(), addv=True)
        A.assemble()

    def largest_step(self, step):
        return 1.0

    def commit(self):
        self.calls.append("commit")

    def rollback(self):
        self.calls.append("rollback")

    def history(self):
        return {"calls": np.array([len(self.calls)])}


def test_a_term_of_ones_own_is_a_summand_like_any_other(rng):
    """Energy, residual and tangent of form and term agree to third order; the sum is solved."""
    potential, u, held, _ = scene(3)
    problem = forms.Problem([potential, Well(u, 300.0, 0.0)], u, held)
    u.x.array[:] = 0.1 * rng.normal(size=u.x.array.size)
    u.x.array[problem.constrained] = 0
    v = rng.normal(size=u.x.array.size)
    v[problem.constrained] = 0
    A, b = problem.create_matrix(), problem.create_vector()
    problem.tangent(A)
    problem.residual(b)
    x, y = b.duplicate(), b.duplicate()
    x.array[:] = v
    A.mult(x, y)
    start, E = u.x.array.copy(), problem.energy()
    remainders = []
    for h in (2e-4, 1e-4, 5e-5):
        u.x.array[:] = start + h * v
        taylor = E + h * b.array @ v + h**2 / 2 * y.array @ v
        remainders.append(abs(problem.energy() - taylor))
    assert np.log2(np.divide(remainders[:-1], remainders[1:])) == pytest.approx(3, abs=0.1)
    u.x.array[:] = 0
    path = forms.solve(problem)
    stiff = forms.at(u, (1.0, 0.5))[0]
    assert path.steps[0].convergence.converged
    assert problem.history() == {"1:calls": np.array([len(problem.terms[1].calls)])}
    u.x.array[:] = 0
    forms.solve(potential, u, held)
    assert forms.at(u, (1.0, 0.5))[0] > 1.01 * stiff > 0.01


class Wall(Well):
    """-k ln(gap - u_x) at each node: infinite from the wall on, and no step may reach it."""

    def __init__(self, u, k, gap):
        super().__init__(u, k, gap)
        self.nearest = []

    def energy(self):
        left = self.a - self._values()[:, 0]
        self.nearest.append(left.min())
        return -self.k * float(np.log(left).sum()) if left.min() > 0 else np.inf

    def residual(self, b):
        force = np.zeros((self.nodes, self.dim))
        force[:, 0] = self.k / (self.a - self._values()[:, 0])
        with b.localForm() as local:
            local.array[: force.size] += force.ravel()

    def tangent(self, A, projected=False):
        second = self.k / (self.a - self._values()[:, 0]) ** 2
        for node in range(self.nodes):
            A.setValue(self.dim * node, self.dim * node, second[node], addv=True)
        A.assemble()

    def largest_step(self, step):
        left = self.a - self._values()[:, 0]
        ahead = np.maximum(step.array_r.reshape(-1, self.dim)[:, 0], 1e-300)
        return float(min(1.0, 0.9 * (left / ahead).min()))


def test_no_step_passes_a_barrier():
    """A load that would go 5 times as far: every trial state is on its side of the wall."""
    potential, u, held, t = scene(3, load=1.0)
    forms.solve(potential, u, held)
    free = u.x.array[::2].max()
    u.x.array[:] = 0
    wall = Wall(u, 1e-4, free / 5)
    problem = forms.Problem([potential, wall], u, held)
    path = forms.solve(problem)
    assert path.completed and 0 < wall.a - u.x.array[::2].max() < 0.02 * free
    assert min(wall.nearest) > 0
    assert wall.calls.count("commit") == 1
    with pytest.raises(forms.NotConverged):
        t.value = 50.0
        forms.solve(problem, options={"snes_max_it": 1})
    assert wall.calls.count("commit") == 1 and "rollback" in wall.calls


PARALLEL = """
import json
from mpi4py import MPI
import ufl
from variform import forms, meshes
from test_problems import Well

body = meshes.block(MPI.COMM_WORLD, (1.0, 1.0), n=6)
u = forms.displacement(body)
psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0)
pull = forms.dead_traction(u, ufl.as_vector([0.2, 0.1]), body.ds("right"))
held = [forms.clamp(u, body.facets("left"))]
problem = forms.Problem([psi * ufl.dx + pull, Well(u, 3.0, 0.1)], u, held)
found = []
for _ in range(2):
    path = forms.solve(problem, rtol=1e-12, ctol=1e-10)
    found += [*forms.at(u, (1.0, 0.5)), problem.energy(), path.steps[0].convergence.negative]
if MPI.COMM_WORLD.rank == 0:
    print(json.dumps(found))
"""


def test_terms_and_reuse_on_ranks(run, root, tmp_path):
    """1, 2 and 3 ranks: the same displacement, energy and inertia, at the second solve, too."""
    file = tmp_path / "script.py"
    file.write_text(f"import sys; sys.path.insert(0, {str(root / 'tests')!r})\n{PARALLEL}")
    found = [json.loads(run(file, ranks=n).stdout.splitlines()[-1]) for n in (1, 2, 3)]
    for numbers in found:
        assert numbers == pytest.approx(found[0], rel=1e-10)
    assert abs(found[0][0]) > 0.01 and found[0][3] == 0


def test_memory_is_given_back_when_another_problem_is_solved():
    """Calls keep the solver of the last problem only; a problem of one's own frees it itself."""
    potential, u, held, _ = scene()
    first = forms.solve(potential, u, held).problem
    assert first.solver is not None
    own = forms.Problem(potential, u, held)
    forms.solve(own)
    mesh = unit_mesh(2, 2)
    v = forms.displacement(mesh)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(v), 1.0, 2.0)
    forms.solve(psi * ufl.dx, v, [forms.clamp(v, at_plane(mesh, 0, 0.0))])
    assert first.solver is None and own.solver is not None
    own.destroy()
    assert own.solver is None and forms.solve(own).completed
    assert isinstance(u, fem.Function)
