# SPDX-License-Identifier: MIT
"""What ranks give each other for a product by blocks: rows of P, parts of rows of the result."""

from __future__ import annotations

from typing import NamedTuple

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from numpy.typing import NDArray

from ... import _petsc

Indices = NDArray[np.int32]


class Lists(NamedTuple):
    """Lists of nodes one after the other: where each begins, and at last ends; all members."""

    starts: Indices
    members: Indices

    def places(self, chosen: NDArray[np.integer]) -> NDArray[np.intp]:
        """Where the members of some of the lists are."""
        return entries(self.starts, chosen)


class Exchange:
    """Items that each rank has for others, sorted by these. Collective.

    Args:
        comm: Communicator.
        counts: How many items this rank has for each.

    Attributes:
        taken: How many each has for this rank.
    """

    def __init__(self, comm: MPI.Comm, counts: NDArray[np.integer]) -> None:
        self._comm, self._given = comm, np.ascontiguousarray(counts, np.int32)
        self.taken: Indices = np.empty_like(self._given)
        comm.Alltoall(self._given, self.taken)

    def __call__(self, values: NDArray) -> NDArray:
        """The items of all for this rank, by ranks; an item is a row of the array. Collective."""
        width = int(np.prod(values.shape[1:]))
        found = np.empty((int(self.taken.sum()), *values.shape[1:]), values.dtype)
        given = [np.ascontiguousarray(values), self._given * width]
        self._comm.Alltoallv(given, [found, self.taken * width])
        return found


class Halo:
    """Rows of P that others have, for the columns of A that are theirs. Collective.

    Args:
        A: Matrix.
        own: Lengths of this rank's rows.

    Attributes:
        lengths: Of the others' rows.
    """

    def __init__(self, A: PETSc.Mat, own: Indices) -> None:
        comm, R = A.comm.tompi4py(), A.getBlockSize()
        ranges = A.getOwnershipRanges() // R
        names = columns_of_others(A)[::R] // R
        ask = Exchange(comm, _by_owner(ranges, names))
        asked = ask(names) - ranges[comm.rank]
        self.lengths = Exchange(comm, ask.taken)(own[asked])
        self._entries = entries(np.concatenate([[0], np.cumsum(own)]), asked)
        self._give = Exchange(comm, _summed(ask.taken, own[asked]))

    def __call__(self, each: NDArray) -> NDArray:
        """What others have for each block of these rows, by what this rank has. Collective."""
        return self._give(each[self._entries])


class Shared:
    """Rows of the result of which one rank makes a part and another one is the owner. Collective.

    Args:
        comm: Communicator.
        rows: The nodes in each row, as far as this rank makes it.
        names: The nodes' numbers in the whole, ascending.
        others: The rows that others own.
        ranges: First node of each rank.

    Attributes:
        rows: Own rows that others make a part of, one after the other, counted from the first own.
        given: Their nodes, by the numbers in the whole.
    """

    def __init__(
        self,
        comm: MPI.Comm,
        rows: Lists,
        names: Indices,
        others: NDArray[np.integer],
        ranges: Indices,
    ) -> None:
        counts, lengths = _by_owner(ranges, names[others]), np.diff(rows.starts)[others]
        give = Exchange(comm, counts)
        self.rows: Indices = give(names[others]) - ranges[comm.rank]
        starts = np.concatenate([[0], np.cumsum(give(lengths))]).astype(np.int32)
        self._give = Exchange(comm, _summed(counts, lengths))
        self.given = Lists(starts, self._give(names[rows.members[rows.places(others)]]))

    def by_row(self, members: Indices, first: int, count: int) -> Lists:
        """All nodes of each row of all who make a part of it.

        Args:
            members: The nodes by their numbers here.
            first: Number of the first own row.
            count: Of all rows.
        """
        lengths = np.bincount(self.rows + first, np.diff(self.given.starts), count)
        starts = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int32)
        return Lists(starts, members[self.given.places(np.argsort(self.rows, kind="stable"))])

    def values(self, blocks: NDArray[np.float64], places: NDArray[np.intp]) -> NDArray[np.float64]:
        """The numbers of the rows that others make a part of, for those made here. Collective."""
        return self._give(blocks[places])


def entries(starts: NDArray[np.integer], rows: NDArray[np.integer]) -> NDArray[np.intp]:
    """Numbers of all entries of some rows."""
    lengths = np.diff(starts)[rows]
    ends = np.cumsum(lengths)
    first = np.repeat(starts[rows] - ends + lengths, lengths)
    return np.arange(len(first)) + first


def columns_of_others(A: PETSc.Mat) -> Indices:
    """Numbers in the whole of the columns that belong to other ranks; ascending."""
    return _petsc.parts(A)[1] if A.getType() == "mpiaij" else np.empty(0, np.int32)


def _by_owner(ranges: Indices, names: Indices) -> NDArray[np.intp]:
    """How many of ascending numbers each rank has."""
    return np.diff(np.searchsorted(names, ranges))


def _summed(counts: NDArray[np.integer], lengths: Indices) -> NDArray[np.intp]:
    """Sum of the lengths of each rank's items, of which there are so many."""
    whose = np.repeat(np.arange(len(counts)), counts)
    return np.bincount(whose, lengths, len(counts)).astype(np.intp)
