# SPDX-License-Identifier: MIT
"""Laws of multigrid's coarse operators by blocks: P^T A P, on any ranks; else PETSc's product."""

import sys

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest
from test_sweeps import block

from variform import forms
from variform.forms.solving.linear.coarse import fits, products
from variform.forms.solving.linear.cycle import cycled
from variform.forms.solving.linear.rigid import rigid_modes

presets = sys.modules["variform.forms.solving.linear.presets"]
RANKS = """
import json
from mpi4py import MPI
from petsc4py import PETSc
import numpy as np
from variform.forms.solving.linear import coarse


def matrix(D, rows, columns, comm=MPI.COMM_WORLD):
    "The blocks of D that are not 0, shared out by nodes."
    n, m = D.shape[0] // rows, D.shape[1] // columns
    r, c = ([k * each // comm.size for k in (comm.rank, comm.rank + 1)] for each in (n, m))
    stored = D.reshape(n, rows, m, columns).any(axis=(1, 3))
    own = slice(rows * r[0], rows * r[1])
    stored = np.kron(stored, np.ones((rows, columns), bool))[own]
    starts = np.concatenate([[0], np.cumsum(stored.sum(axis=1))]).astype(np.int32)
    sizes = (rows * (r[1] - r[0]), len(D)), (columns * (c[1] - c[0]), D.shape[1])
    csr = starts, np.nonzero(stored)[1].astype(np.int32), D[own][stored]
    made = PETSc.Mat().createAIJ(sizes, comm=comm, csr=csr)
    made.setBlockSizes(rows, columns)
    return made


def pair(R, nodes, below, seed=1):
    "A, not symmetric, with neighbors and some far away; P with one to three nodes in a row."
    rng = np.random.default_rng(seed)
    A, P = np.zeros((R * nodes, R * nodes)), np.zeros((R * nodes, 6 * below))
    for i in range(nodes):
        for j in range(nodes):
            if abs(i - j) < 3 or rng.random() < 0.05:
                A[R * i:R * i + R, R * j:R * j + R] = rng.standard_normal((R, R))
        home = i * below // nodes
        for k in {home, min(below - 1, home + i % 2), int(rng.integers(below))}:
            P[R * i:R * i + R, 6 * k:6 * k + 6] = rng.standard_normal((R, 6))
    return A, P


def rows_of(C):
    "This rank's rows as an array; ascending in each."
    starts, columns, values = C.getValuesCSR()
    rows = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
    assert np.all(np.diff(rows * C.getSize()[1] + columns) > 0)
    found = np.zeros((len(starts) - 1, C.getSize()[1]))
    found[rows, columns] = values
    return found


def deviation(R, nodes, below):
    "Of P^T A P from dense matrices, of that of other numbers, and of PETSc's; relative."
    A, P = pair(R, nodes, below)
    a, p = matrix(A, R, R), matrix(P, R, 6)
    assert coarse.fits(a, p)
    off = []
    with coarse.products.of(a):
        C = a.ptap(p)
    for factor in (1.0, 3.0):
        begin, end = C.getOwnershipRange()
        wanted = (P.T @ (factor * A) @ P)
        off.append(np.abs(rows_of(C) - wanted[begin:end]).max(initial=0) / np.abs(wanted).max())
        a.scale(3.0)
        with coarse.products.of(a):
            a.ptap(p, C)
    assert C.getBlockSizes() == (6, 6)
    theirs = a.ptap(p)
    theirs.axpy(-1, C)
    off.append(theirs.norm() / C.norm())
    return [MPI.COMM_WORLD.allreduce(float(o), MPI.MAX) for o in off]


def deviations():
    "On both kinds of levels; with fewer nodes below than ranks."
    return [d for R in (3, 6) for below in (7, 2) for d in deviation(R, 40, below)]
"""
NAMES = {}
exec(compile(RANKS, __file__, "exec"), NAMES)
matrix, pair, rows_of = (NAMES[n] for n in ("matrix", "pair", "rows_of"))
DIGITS = 1e-14


def counted(monkeypatch):
    """How often products by blocks are computed, as a list that grows."""
    calls, compute = [], products._compute

    def count(*matrices):
        calls.append(matrices[0].getSize()[0])
        compute(*matrices)

    monkeypatch.setattr(products, "_compute", count)
    return calls


def test_the_product_is_that_of_dense_matrices():
    """Also of other numbers of the same pattern, as PETSc's own."""
    assert max(NAMES["deviations"]()) <= DIGITS


@pytest.mark.parametrize("ranks", [2, 3])
def test_ranks_make_parts_of_each_other_s_rows(ranks, parallel):
    """Rows of P from others, rows of the product for others, ranks without any of these."""
    script = (
        RANKS + "off = deviations()\nif MPI.COMM_WORLD.rank == 0:\n    print(json.dumps(off))\n"
    )
    assert max(parallel(script, ranks)) <= DIGITS


def holes(A, P):
    """A without one entry, which is stored as no zero."""
    rows, columns = np.nonzero(A)
    keep = (rows != 4) | (columns != 4)
    M = PETSc.Mat().createAIJ(A.shape, nnz=[len(A)] * len(A), comm=MPI.COMM_SELF)
    for i, j in zip(rows[keep], columns[keep], strict=True):
        M.setValue(i, j, A[i, j])
    M.assemble()
    M.setBlockSize(3)
    return M, matrix(P, 3, 6, MPI.COMM_SELF)


def of_three(A, P):
    """P for translations alone."""
    return matrix(A, 3, 3, MPI.COMM_SELF), matrix(P[:, :21], 3, 3, MPI.COMM_SELF)


@pytest.mark.parametrize("made", [holes, of_three])
def test_what_is_not_of_such_blocks_is_petsc_s(made, monkeypatch):
    """A block with a hole; columns of three."""
    calls = counted(monkeypatch)
    a, p = made(*pair(3, 30, 7))
    assert not fits(a, p)
    with products.of(a):
        C = a.ptap(p)
    dense = [M.convert("dense", PETSc.Mat()) for M in (a, p)]
    A, P = (M.getDenseArray().copy() for M in dense)
    assert not calls
    assert rows_of(C) == pytest.approx(P.T @ A @ P, abs=1e-12)


def test_other_products_with_the_matrix_are_petsc_s():
    """A B, A^T B and B A, while P^T A P is ours."""
    A, P = pair(3, 20, 4)
    a, p = matrix(A, 3, 3, MPI.COMM_SELF), matrix(P, 3, 6, MPI.COMM_SELF)
    with products.of(a):
        C = a.ptap(p)
        found = a.matMult(p), a.transposeMatMult(p), a.matMult(a), C.matMult(C)
    wanted = A @ P, A.T @ P, A @ A, (P.T @ A @ P) @ (P.T @ A @ P)
    for one, two in zip(found, wanted, strict=True):
        assert rows_of(one) == pytest.approx(two, abs=1e-13 * np.abs(two).max())


def test_only_in_the_context_and_not_against_the_user_s_choice(monkeypatch):
    """Before, behind, and with -matptap_via products are PETSc's."""
    calls = counted(monkeypatch)
    A, P = pair(3, 20, 4)
    a, p = matrix(A, 3, 3, MPI.COMM_SELF), matrix(P, 3, 6, MPI.COMM_SELF)
    a.ptap(p)
    PETSc.Options()["matptap_via"] = "scalable"
    try:
        with products.of(a):
            a.ptap(p)
    finally:
        PETSc.Options().delValue("matptap_via")
    assert not calls
    with products.of(a):
        C = a.ptap(p)
    assert len(calls) == 1
    a.ptap(p)
    assert len(calls) == 1
    a.ptap(p, C)  # the same product again, by what has made it
    assert len(calls) == 2
    C.ptap(C)
    assert len(calls) == 2


def test_an_error_within_is_the_one_that_is_raised(monkeypatch):
    """Not PETSc's of a function that failed; products work again afterwards."""
    A, P = pair(3, 20, 4)
    a, p = matrix(A, 3, 3, MPI.COMM_SELF), matrix(P, 3, 6, MPI.COMM_SELF)

    def fail(*matrices):
        raise MemoryError("no room for a coarse operator")

    with monkeypatch.context() as patch, pytest.raises(MemoryError, match="no room"):
        patch.setattr(products, "_compute", fail)
        with products.of(a):
            a.ptap(p)
    with products.of(a):
        C = a.ptap(p)
    assert rows_of(C) == pytest.approx(P.T @ A @ P, abs=1e-12)


def levels_of(problem, options):
    """Coarse operators of a tangent's multigrid."""
    A = problem.create_matrix()
    problem.tangent(A)
    A.setNearNullSpace(rigid_modes(problem.u.function_space))
    ksp, given = PETSc.KSP().create(A.comm), PETSc.Options()
    for name, value in options.items():
        given[name] = value
    ksp.setFromOptions()
    cycled(ksp, ())
    ksp.setOperators(A)
    ksp.getPC().setUp()
    for name in options:
        given.delValue(name)
    levels = ksp.getPC().getPythonContext().levels
    found = [levels.getMGSmoother(n).getOperators()[1] for n in range(levels.getMGLevels())]
    return [M.convert("dense", PETSc.Mat()).getDenseArray().copy() for M in found[:-1]]


def test_the_levels_of_a_body_are_those_of_petsc_s_products(monkeypatch):
    """Two levels of a cube or more, below the finest, to 1e-12: all products are by blocks."""
    calls = counted(monkeypatch)
    problem = block((6, 6, 6), "tetrahedron")
    options = {**presets.aggregation(), "pc_gamg_coarse_eq_limit": "20"}
    ours = levels_of(problem, options)
    assert len(calls) == len(ours)
    theirs = levels_of(problem, {**options, "matptap_via": "scalable"})
    assert len(ours) == len(theirs) >= 2
    for one, two in zip(ours, theirs, strict=True):
        assert one == pytest.approx(two, abs=1e-12 * np.abs(two).max())


def test_what_is_read_does_not_count_as_changed(monkeypatch):
    """Multigrid of one tangent is set up once for three solves."""
    monkeypatch.setattr(presets, "DIRECT_UP_TO", 0)
    calls = counted(monkeypatch)
    problem = block((8, 8, 8), "tetrahedron")
    newton = forms.solving.Newton(problem)
    newton.tangent.scaled.measure()
    newton.tangent.assemble()
    ksp = newton.tangent.ksp
    ksp.setOperators(newton.tangent.product, newton.tangent.A)
    b, x = problem.create_vector(), problem.create_vector()
    b.set(1.0)
    problem.clear(b.array)
    for _ in range(3):
        assert newton.tangent.solve(b, x)
    assert calls.count(problem.size) == 1
    newton.destroy()
