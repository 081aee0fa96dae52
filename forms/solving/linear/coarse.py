# SPDX-License-Identifier: MIT
"""Coarse operators of multigrid by aggregation: P^T A P by the blocks of nodes.

PETSc multiplies numbers: it looks for the place of each in the result, and on several ranks keeps
A P and P^T, which is as much as A. By blocks it is one place for 36 numbers, and of A P there is
never more than a row (forms/native/kernels/products.h).
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from numpy.typing import NDArray

from ... import _petsc
from ..._products import Products
from ...native.library import MODES, library
from ...native.records import address
from .exchange import Halo, Indices, Lists, Shared, columns_of_others

BLOCKS = (3, MODES)  # rows of a node: of displacements, and of rigid motions


class Blocks(NamedTuple):
    """Rows of blocks: where each begins, the node of each block, the numbers row by row."""

    starts: Indices
    columns: Indices
    values: NDArray[np.float64]


def fits(A: PETSc.Mat, P: PETSc.Mat) -> bool:
    """Whether matrices are of full blocks, R x R and R x 6, R = 3 or 6. Collective."""
    R, K = P.getBlockSizes()
    if np.dtype(PETSc.IntType) != np.int32 or A.getType() != P.getType():
        return False
    if K != MODES or R not in BLOCKS or A.getBlockSize() != R:
        return False
    native, full = _native(), True
    for M, width in ((A, R), (P, K)):
        parts, found = native.rows(M)
        names = columns_of_others(M)
        by_node = names[: len(names) // width * width].reshape(-1, width)
        full &= len(names) % width == 0 and bool(np.all(np.diff(by_node, axis=1) == 1))
        full &= bool(np.all(by_node[:, :1] % width == 0))
        full &= bool(native.lib.blocks_full(parts, len(found[0].rows) // R, R, width))
    return bool(A.comm.tompi4py().allreduce(full, MPI.MIN))


def compute(A: PETSc.Mat, P: PETSc.Mat, C: PETSc.Mat) -> None:
    """Put P^T A P into C, for matrices that :func:`fits`. Collective."""
    comm, native, R = A.comm.tompi4py(), _native(), A.getBlockSize()
    parts, kept = native.rows(A)
    nodes = len(kept[0].rows) // R
    mine = _rows_of(native, A, P)
    ranges = P.getOwnershipRangesColumn() // MODES
    ends = ranges[comm.rank : comm.rank + 2]
    names = np.union1d(mine.columns, np.arange(*ends, dtype=np.int32))
    mine = mine._replace(columns=_numbers(names, mine.columns))
    reach, most = _reach(native, parts, mine, len(names), nodes, R)
    of_columns = _transposed(mine, nodes, len(names))
    none = Lists(np.zeros(len(names) + 1, np.int32), np.empty(0, np.int32))
    rows = _pattern(native, of_columns, reach, none)
    first, last = np.searchsorted(names, ends)
    shared = None
    if comm.size > 1:
        others = np.r_[0:first, last : len(names)]
        shared = Shared(comm, rows, names, others, ranges)
        wider = np.union1d(names, shared.given.members)
        to, names = _numbers(wider, names), wider
        others = to[others]
        mine, reach = mine._replace(columns=to[mine.columns]), Lists(reach[0], to[reach[1]])
        first, last = np.searchsorted(names, ends)
        given = _numbers(names, shared.given.members)
        of_columns = _transposed(mine, nodes, len(names))
        rows = _pattern(native, of_columns, reach, shared.by_row(given, first, len(names)))

    at, size = native.at, MODES * MODES
    values = np.zeros(size * len(rows.members))
    room, mark = np.empty(R * MODES * most), np.empty(len(names), np.int32)
    place = [*map(at, rows), at(values)]
    native.lib.products_add(
        parts, native.blocks(mine), nodes, R, native.pair(*reach), at(mark), *place, at(room)
    )
    if shared is not None:
        numbers = shared.values(values.reshape(-1, size), rows.places(others))
        lists = (shared.rows + first).astype(np.int32), shared.given.starts, given, numbers
        native.lib.products_add_rows(len(shared.rows), *map(at, lists), *place)
    low, high = rows.starts[first], rows.starts[last]
    own = rows.starts[first : last + 1] - low, rows.members[low:high], names
    count = int(last - first)
    starts, columns = np.empty(MODES * count + 1, np.int32), np.empty(size * (high - low), np.int32)
    native.lib.products_numbers(count, *map(at, (*own, starts, columns)))
    del mine, reach, room  # PETSc copies the numbers
    C.setPreallocationCSR((starts, columns, values[size * low : size * high]))


products = Products(fits, compute)


class _Native:
    """The kernels, called with arrays."""

    def __init__(self) -> None:
        self.lib, self.ffi = library(MPI.COMM_SELF)  # built already, so that nobody waits

    def at(self, array: NDArray) -> Any:
        """Address of an array that is kept by who calls."""
        return address(self.ffi, array)

    def pair(self, first: NDArray, second: NDArray) -> Any:
        """Addresses of two arrays."""
        return self.ffi.new("const int32_t *[2]", [self.at(first), self.at(second)])

    def rows(self, A: PETSc.Mat) -> tuple[Any, list[_petsc.Part]]:
        """Both parts of an AIJ matrix, and their arrays; a sequential one has an empty second."""
        found, _ = _petsc.parts(A)
        if A.getType() == "seqaij":
            found[1] = _petsc.Part(np.zeros_like(found[0].rows), np.empty(0, np.int32), np.empty(0))
        parts = self.ffi.new("rows_t[2]")
        for part, own in zip(parts, found, strict=True):
            part.rows, part.columns, part.values = (self.at(each) for each in own)
        return parts, found

    def blocks(self, own: Blocks) -> Any:
        """Rows of blocks."""
        return self.ffi.new("block_rows_t *", [len(own.starts) - 1, *(self.at(a) for a in own)])


@cache
def _native() -> _Native:
    return _Native()


def _rows_of(native: _Native, A: PETSc.Mat, P: PETSc.Mat) -> Blocks:
    """Rows of P as blocks, those of this rank and behind them those of A's other columns.

    Their columns are numbers in the whole. Collective.
    """
    R, K = P.getBlockSizes()
    parts, found = native.rows(P)
    lengths = sum(np.diff(each.rows)[::R] for each in found) // K
    halo = Halo(A, lengths) if A.comm.size > 1 else None
    counts = lengths if halo is None else np.concatenate([lengths, halo.lengths])
    starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
    made = Blocks(starts, np.empty(starts[-1], np.int32), np.empty(R * K * starts[-1]))
    begin, end = (each // K for each in P.getOwnershipRangeColumn())
    names = np.arange(begin, end, dtype=np.int32), columns_of_others(P)[::K] // K
    sizes = len(lengths), R, K
    native.lib.blocks_take(parts, native.pair(*names), *sizes, *(native.at(a) for a in made))
    if halo is not None:
        own = starts[len(lengths)]
        for each in (made.columns, made.values.reshape(-1, R * K)):
            each[own:] = halo(each[:own])
    return made


def _reach(
    native: _Native, parts: Any, P: Blocks, coarse: int, nodes: int, R: int
) -> tuple[Lists, int]:
    """Coarse nodes in each row of A P, and the most in a row."""
    at, mark, starts = native.at, np.empty(coarse, np.int32), np.empty(nodes + 1, np.int32)
    most, members, to = 0, np.empty(0, np.int32), native.ffi.NULL
    for counted in (False, True):
        if counted:
            members = np.empty(starts[-1], np.int32)
            to = at(members)
        mark.fill(-1)
        most = native.lib.products_reach(
            parts, native.blocks(P), nodes, R, at(mark), at(starts), to
        )
    return Lists(starts, members), most


def _transposed(P: Blocks, nodes: int, coarse: int) -> Lists:
    """The own nodes in each column of P."""
    columns = P.columns[: P.starts[nodes]]
    rows = np.repeat(np.arange(nodes, dtype=np.int32), np.diff(P.starts[: nodes + 1]))
    starts = np.concatenate([[0], np.cumsum(np.bincount(columns, minlength=coarse))])
    return Lists(starts.astype(np.int32), rows[np.argsort(columns, kind="stable")])


def _pattern(native: _Native, of_columns: Lists, reach: Lists, more: Lists) -> Lists:
    """Nodes in each row of the result, ascending.

    Args:
        native: Kernels.
        of_columns: Nodes in each column of P.
        reach: Coarse nodes in each row of A P.
        more: Nodes in each row of the result that others know of.
    """
    at, coarse = native.at, len(more.starts) - 1
    mark, starts = np.empty(coarse, np.int32), np.empty(coarse + 1, np.int32)
    members, to = np.empty(0, np.int32), native.ffi.NULL
    for counted in (False, True):
        if counted:
            members = np.empty(starts[-1], np.int32)
            to = at(members)
        mark.fill(-1)
        lists = [native.pair(*each) for each in (of_columns, reach, more)]
        native.lib.products_rows(coarse, *lists, at(mark), at(starts), to)
    return Lists(starts, members)


def _numbers(names: Indices, wanted: Indices) -> Indices:
    """Where numbers stand among ascending ones."""
    return np.searchsorted(names, wanted).astype(np.int32)
