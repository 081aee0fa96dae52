# SPDX-License-Identifier: MIT
"""Laws of multigrid's smoother and cycle: the formula, any units, iterations as PETSc's."""

import sys

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest
import ufl
from dolfinx import fem

from variform import forms, meshes
from variform.forms.solving.linear.cycle import cycled
from variform.forms.solving.linear.rigid import rigid_modes
from variform.forms.solving.linear.sweeps import Sweeps

# forms.solve is the function: the module of that name is found by its path.
presets = sys.modules["variform.forms.solving.linear.presets"]
RANKS = """
import json
from mpi4py import MPI
from petsc4py import PETSc
import numpy as np
from variform.forms.solving.linear.sweeps import Sweeps

NODES = 12  # a chain, each node with three neighbors on either side


def dense():
    "Symmetric and positive definite, of 3x3 blocks."
    rng = np.random.default_rng(1)
    A = np.zeros((3 * NODES, 3 * NODES))
    for i in range(NODES):
        for j in range(max(0, i - 3), min(NODES, i + 4)):
            A[3 * i:3 * i + 3, 3 * j:3 * j + 3] = rng.standard_normal((3, 3))
    A = A + A.T
    return A + np.diag(1.2 * np.abs(A).sum(axis=1))


def matrix(A, comm=MPI.COMM_WORLD, block=3, whole=False):
    "The numbers of A as an AIJ matrix, shared out by nodes; zero blocks are stored if `whole`."
    size = len(A)
    nodes = size // block
    first, last = (nodes * k // comm.size for k in (comm.rank, comm.rank + 1))
    stored = A.reshape(nodes, block, nodes, block).any(axis=(1, 3)) | whole
    stored = np.kron(stored, np.ones((block, block), bool))[block * first:block * last]
    rows = np.concatenate([[0], np.cumsum(stored.sum(axis=1))]).astype(np.int32)
    columns = np.nonzero(stored)[1].astype(np.int32)
    local = (len(rows) - 1, size)
    made = PETSc.Mat().createAIJ(
        (local, local), comm=comm,
        csr=(rows, columns, A[block * first:block * last][stored]),
    )
    made.setBlockSize(block)
    made.assemble()
    return made


def own(A, comm=MPI.COMM_WORLD):
    "What couples nodes of one rank, for all ranks."
    rank = np.repeat(np.searchsorted(
        [len(A) // 3 * (k + 1) // comm.size for k in range(comm.size)], range(len(A) // 3), "right"
    ), 3)
    return np.where(rank[:, None] == rank, A, 0)


def formula(A):
    "M = (D + L) D^-1 (D + L^T) of an array, D its 3x3 blocks."
    node = np.arange(len(A)) // 3
    D = np.where(node[:, None] == node, A, 0)
    L = np.where(node[:, None] > node, A, 0)
    return (D + L) @ np.linalg.solve(D, D + L.T)


def deviations():
    "Of x, of b - A x and of an x that is improved, relative to the largest numbers in each."
    A = dense()
    P, M = matrix(A), formula(own(A))
    sweeps = Sweeps(P)
    b, x, r = (P.createVecLeft() for _ in range(3))
    begin, end = b.getOwnershipRange()
    given = np.cos(np.arange(3 * NODES))
    b.array[:] = given[begin:end]
    sweeps(b, x, r)
    first = np.linalg.solve(M, given)
    off = [np.abs(x.array_r - first[begin:end]).max() / np.abs(first).max()]
    left = given - A @ first
    off.append(np.abs(r.array_r - left[begin:end]).max() / np.abs(left).max())
    start = np.sin(np.arange(3 * NODES))
    x.array[:] = start[begin:end]
    sweeps(b, x)
    again = start + np.linalg.solve(M, given - A @ start)
    off.append(np.abs(x.array_r - again[begin:end]).max() / np.abs(again).max())
    return [MPI.COMM_WORLD.allreduce(float(o), MPI.MAX) for o in off]
"""
NAMES = {}
exec(compile(RANKS, __file__, "exec"), NAMES)
NODES, dense, matrix, formula = (NAMES[n] for n in ("NODES", "dense", "matrix", "formula"))
DIGITS = 2e-6  # of single precision, over some dozen operations


def test_sweeps_are_those_of_the_formula():
    """M^-1 b, what it leaves of b, and an x that is improved, to single precision."""
    assert max(NAMES["deviations"]()) <= DIGITS


@pytest.mark.parametrize("ranks", [2, 3])
def test_ranks_sweep_over_their_own_nodes(ranks, parallel):
    """M is that of each rank's own nodes, the residual that of the whole matrix."""
    script = (
        RANKS + "off = deviations()\nif MPI.COMM_WORLD.rank == 0:\n    print(json.dumps(off))\n"
    )
    assert max(parallel(script, ranks)) <= DIGITS


@pytest.mark.parametrize("stiffness", [1e-12, 1.0, 1e12])
@pytest.mark.parametrize("force", [1e-200, 1.0, 1e200])
def test_units_do_not_matter(stiffness, force):
    """Numbers far beyond those of single precision."""
    A = dense()
    P = matrix(stiffness * A, MPI.COMM_SELF)
    b, x, r = (P.createVecLeft() for _ in range(3))
    b.array[:] = force * np.cos(np.arange(3 * NODES))
    Sweeps(P)(b, x, r)
    wanted = np.linalg.solve(formula(A), b.array_r / force)
    assert x.array_r * (stiffness / force) == pytest.approx(wanted, abs=DIGITS * wanted.max())
    x.array[:] *= 0.5
    Sweeps(P)(b, x)
    left = np.cos(np.arange(3 * NODES)) - A @ wanted / 2
    wanted = wanted / 2 + np.linalg.solve(formula(A), left)
    assert x.array_r * (stiffness / force) == pytest.approx(wanted, abs=DIGITS * wanted.max())


def test_the_numbers_of_a_changed_matrix_are_taken():
    """And where a node becomes 1e6 times as stiff one way as another, that is told, and is over."""
    A = dense()
    P = matrix(A, MPI.COMM_SELF)
    sweeps = Sweeps(P)
    b, x, r = (P.createVecLeft() for _ in range(3))
    b.set(1.0)
    sweeps(b, x, r)
    before = x.array.copy()
    P.scale(4.0)
    sweeps.update()
    sweeps(b, x, r)
    assert x.array_r == pytest.approx(before / 4, rel=1e-6)
    stiff = 1e6 * np.abs(A).max() * np.ones((3, 3))  # along the diagonal of a cube
    for sign in (1, -1):
        P.setValues(range(6, 9), range(6, 9), sign * stiff, addv=PETSc.InsertMode.ADD_VALUES)
        P.assemble()
        sweeps.update()
        assert sweeps.possible == (sign < 0)


def test_the_cycle_is_that_of_the_formula():
    """Of two levels, by dense matrices; kept for a tangent 3 times as large it smooths on that."""
    problem = block((5, 5, 5), "tetrahedron")
    A = problem.create_matrix()
    problem.tangent(A)
    A.setNearNullSpace(rigid_modes(problem.u.function_space))
    ksp = PETSc.KSP().create(A.comm)
    options = PETSc.Options("cycle_")
    given = {**presets.aggregation(), "pc_gamg_coarse_eq_limit": "300"}
    for name, value in given.items():
        options[name] = value
    ksp.setOptionsPrefix("cycle_")
    ksp.setFromOptions()
    cycled(ksp, ())
    ksp.setOperators(A)
    pc = ksp.getPC()
    pc.setUp()
    for name in given:
        options.delValue(name)
    levels = pc.getPythonContext().levels
    assert levels.getMGLevels() == 2
    full = [M.convert("dense", PETSc.Mat()) for M in (A, levels.getMGInterpolation(1))]
    K, prolongation = (M.getDenseArray().copy() for M in full)  # views of what they own
    below, given = levels.getMGCoarseSolve(), levels.getMGInterpolation(1).createVecRight()
    found = given.duplicate()
    b, x = A.createVecs()
    b.array[:] = np.cos(np.arange(len(b.array_r)))
    problem.clear(b.array)
    for factor in (1.0, 3.0):
        M = formula(factor * K)
        wanted = np.linalg.solve(M, b.array_r)
        left = b.array_r - factor * K @ wanted
        given.array[:] = prolongation.T @ left
        below.solve(given, found)
        wanted += prolongation @ found.array_r
        wanted += np.linalg.solve(M, b.array_r - factor * K @ wanted)
        pc.apply(b, x)
        assert x.array_r == pytest.approx(wanted, abs=DIGITS * np.abs(wanted).max())
        A.scale(3.0)
        pc.setReusePreconditioner(True)
    ksp.destroy()


def test_what_has_no_inverse_stays_at_zero_and_what_is_not_a_number_is_seen():
    """A node without stiffness, or with one along an axis; b = 0; b with NaN or infinity."""
    A = dense()
    A[3:6], A[:, 3:6], A[9:12], A[:, 9:12] = 0, 0, 0, 0
    A[3:6, 3:6], A[10, 10] = 0, 2.0
    P = matrix(A, MPI.COMM_SELF, whole=True)
    b, x, r = (P.createVecLeft() for _ in range(3))
    sweeps = Sweeps(P)
    b.set(1.0)
    sweeps(b, x, r)
    assert np.isfinite(x.array_r).all()
    assert not x.array_r[3:6].any()
    assert x.array_r[9:12] == pytest.approx([0, 0.5, 0])
    b.set(0.0)
    sweeps(b, x, r)
    assert not x.array_r.any() and not r.array_r.any()
    for number in (np.nan, np.inf):
        b.array[5] = number
        sweeps(b, x, r)
        assert np.isnan(x.array_r).all()


def test_matrices_that_are_not_of_full_blocks_are_none():
    """Blocks of two, a block with a hole, one that is missing on the diagonal."""
    A = dense()
    assert Sweeps(matrix(A, MPI.COMM_SELF)).possible
    assert not Sweeps(matrix(A[:32, :32], MPI.COMM_SELF, 2)).possible
    holes = A.copy()
    holes[4, 7] = holes[7, 4] = 0
    assert not Sweeps(matrix(holes, MPI.COMM_SELF, 1)).possible
    A[6:9, 6:9] = 0
    assert not Sweeps(matrix(A, MPI.COMM_SELF)).possible


SCENES = {  # cells along the edges, kind of cell, and what is unusual
    "cube": ((7, 7, 7), "tetrahedron", {}),
    "in pascals": ((7, 7, 7), "tetrahedron", {"mu": 8e10}),
    "contrast": ((8, 8, 8), "hexahedron", {"contrast": 1e6}),
    "slender": ((200, 2, 2), "hexahedron", {"size": (200.0, 1.0, 1.0)}),
    "nearly incompressible": ((8, 8, 8), "hexahedron", {"lmbda": 100.0}),
    "stiff fibers": ((8, 8, 8), "hexahedron", {"fibers": 1e3}),
    "fibers of another kind": ((8, 8, 8), "hexahedron", {"fibers": 1e8}),
}


def block(n, cells, size=(1.0, 1.0, 1.0), lmbda=1.5, contrast=1.0, mu=1.0, fibers=0.0):
    """A block clamped at one end; half of it stiffer; fibers along its diagonal."""
    body = meshes.block(MPI.COMM_SELF, size, n=n, cells=cells)
    u = forms.displacement(body)
    F, x = forms.deformation_gradient(u), ufl.SpatialCoordinate(body.mesh)
    # Constants: other numbers are no other form, which would be compiled again.
    mu, more, ratio, k = (
        fem.Constant(body.mesh, c) for c in (mu, contrast * mu, lmbda, fibers * mu)
    )
    stiff = ufl.conditional(ufl.lt(x[1], 0.5), more, mu)
    a = ufl.as_vector([1, 1, 1]) / np.sqrt(3)
    psi = forms.energies.neo_hookean(F, stiff, ratio * stiff)
    psi += k / 2 * (ufl.inner(F * a, F * a) - 1) ** 2
    return forms.Problem(psi * ufl.dx, u, [forms.clamp(u, body.facets("left"))])


def solved(problem, options):
    """Iterations of a tangent solve to 1e-8, kind of preconditioner, and how symmetric that is."""
    newton = forms.solving.Newton(problem, options={"ksp_rtol": 1e-8, **options})
    newton.tangent.scaled.measure()
    newton.tangent.assemble()
    ksp = newton.tangent.ksp
    ksp.setOperators(newton.tangent.product, newton.tangent.A)
    b, y, z = (problem.create_vector() for _ in range(3))
    b.array[:] = np.sin(0.7 * np.arange(len(b.array_r)))
    problem.clear(b.array)
    assert newton.tangent.solve(b, y)
    count, kind = ksp.getIterationNumber(), ksp.getPC().getType()
    c = b.duplicate()
    c.array[:] = np.cos(np.arange(len(c.array_r)) ** 1.1)
    problem.clear(c.array)
    ksp.getPC().apply(b, y)
    ksp.getPC().apply(c, z)
    skew = abs(c.dot(y) - b.dot(z)) / np.sqrt(b.dot(y) * c.dot(z))
    newton.destroy()
    return count, kind, skew


@pytest.mark.parametrize("scene", SCENES)
def test_the_cycle_needs_as_few_iterations_as_petsc_s(scene, monkeypatch):
    """By one iteration in twenty, and one; symmetric to single precision. The user's go first."""
    monkeypatch.setattr(presets, "DIRECT_UP_TO", 0)
    n, cells, unusual = SCENES[scene]
    problem = block(n, cells, **unusual)
    ours, kind, skew = solved(problem, {})
    theirs, usual, _ = solved(problem, {"mg_levels_pc_type": "sor"})
    assert (kind, usual) == ("python", "gamg")
    assert ours <= 1.05 * theirs + 1
    assert skew <= 1e-5
