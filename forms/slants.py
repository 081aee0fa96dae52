# SPDX-License-Identifier: MIT
"""Supports along directions of their own, which no component of the displacement has.

A node's displacements that they leave free are a line or a plane, with the projection
P = I - sum_k r_k r_k^T onto it, the r_k orthonormal. The unknown keeps its components; where a
supported component has the row and column of identity, such a node has P K P + s (I - P) and P R,
and steps begin and end in the plane.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any
from zlib import crc32

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from dolfinx import fem
from numpy.typing import NDArray

from . import _petsc
from .directions import Slant

Array = NDArray[np.float64]
_NAME = "variform_slants"
SAME = 1e-6  # sine of the angle to other supports' directions below which nothing is left to hold
EPS = float(np.finfo(float).eps)


class Slants:
    """All slanted supports of a problem, node by node, beside supported components.

    At a node with several, or with supported components, all hold: what the others leave free of a
    direction counts, and nothing where that is less than 1e-6 of it.

    Args:
        space: Space of the unknown.
        listed: Slanted supports, the stronger ones first.
        held: Numbers of the components that other supports prescribe, ghosts included.

    Attributes:
        dofs: Numbers of each node's components, shape (nodes, d), the own nodes first.
        rows: Orthonormal directions r_k that are held, shape (nodes, d, d), rows of 0 behind.
        given: Prescribed r_k . u by the node's supported components, shape (nodes, d, d).
        weights: Prescribed r_k . u by the supports' own values, shape (nodes, d, supports).
        free: P, shape (nodes, d, d).
    """

    def __init__(
        self, space: fem.FunctionSpace, listed: Sequence[Slant], held: NDArray[np.int32]
    ) -> None:
        dofmap = space.dofmap
        self._space, dim = space, listed[0].dofs.shape[1]
        self._owned = dofmap.index_map.size_local * dofmap.bs
        size = self._owned + dofmap.index_map.num_ghosts * dofmap.bs
        first = np.unique(np.concatenate([s.dofs[:, 0] for s in listed]))
        node = np.full(size, -1, np.int64)
        node[first] = np.arange(len(first))
        self.dofs = np.zeros((len(first), dim), np.int32)
        supported = np.zeros(size, bool)
        supported[held] = True
        self.rows, self.given = (np.zeros((len(first), dim, dim)) for _ in range(2))
        self.weights = np.zeros((len(first), dim, len(listed)))
        self._values = [(k, s, node[s.dofs[:, 0]]) for k, s in enumerate(listed) if s.value]
        rank = np.zeros(len(first), np.int64)
        for k, s in enumerate(listed):
            at = node[s.dofs[:, 0]]
            self.dofs[at] = s.dofs
            fixed = supported[s.dofs]
            r, g = np.where(fixed, 0.0, s.normals), np.where(fixed, -s.normals, 0.0)
            h = np.tile(np.eye(len(listed))[k], (len(at), 1))
            for _ in range(2):  # twice is enough for orthogonality to rounding
                along = np.einsum("nki,ni->nk", self.rows[at], r)
                r = r - np.einsum("nk,nki->ni", along, self.rows[at])
                g = g - np.einsum("nk,nki->ni", along, self.given[at])
                h = h - np.einsum("nk,nki->ni", along, self.weights[at])
            length = np.linalg.norm(r, axis=1)
            new = length > SAME
            at, length = at[new], length[new, None]
            self.rows[at, rank[at]], self.given[at, rank[at]] = r[new] / length, g[new] / length
            self.weights[at, rank[at]] = h[new] / length
            rank[at] += 1
        self.free = np.eye(dim) - np.einsum("nki,nkj->nij", self.rows, self.rows)
        self._rank, self._scale = rank, np.ones(len(first))
        self._own = int(np.searchsorted(first, self._owned))

    @property
    def count(self) -> int:
        """Directions that are held at own nodes."""
        return int(self._rank[: self._own].sum())

    def _part(self, array: Any) -> slice:
        """Nodes of an array with ghosts, or of own entries only."""
        return slice(None if len(array) > self._owned else self._own)

    def clear(self, array: Any) -> None:
        """Replace x by P x; local."""
        part = self._part(array)
        dofs = self.dofs[part]
        array[dofs] = np.einsum("nij,nj->ni", self.free[part], array[dofs])

    def prescribe(self, array: Any) -> None:
        """Put the prescribed r_k . u into an array that has the other supports' values; local."""
        part = self._part(array)
        dofs, rows, given = self.dofs[part], self.rows[part], self.given[part]
        x = array[dofs]
        wrong = np.einsum("nki,ni->nk", given - rows, x)
        wrong += self._own_values()[part]
        # What rounding leaves stays, so that a second time changes nothing.
        wrong[np.abs(wrong) <= 4 * EPS * np.abs(x).max(axis=1, initial=0.0)[:, None]] = 0
        array[dofs] = x + np.einsum("nk,nki->ni", wrong, rows)

    def _own_values(self) -> Array:
        """Prescribed r_k . u by the supports' present values, shape (nodes, d)."""
        values = np.zeros(self.weights.shape[::2])
        for k, s, at in self._values:
            values[at, k] = s.value.x.array[s.at]
        return np.einsum("nks,ns->nk", self.weights, values)

    def put(self, array: Any, values: Any) -> None:
        """Give an array another one's r_k . u at own nodes; local."""
        dofs, free = self.dofs[: self._own], self.free[: self._own]
        change = values[dofs] - array[dofs]
        array[dofs] += change - np.einsum("nij,nj->ni", free, change)

    def pull(self, array: Any) -> None:
        """Add to forces on supported components those that go through the directions; local."""
        part = self._part(array)
        dofs = self.dofs[part]
        along = np.einsum("nki,ni->nk", self.rows[part], array[dofs])
        array[dofs] += np.einsum("nk,nki->ni", along, self.given[part])

    def held(self, modes: Array, dofs: NDArray[np.int32]) -> Array:
        """Rows r_k . v of own nodes, shape (k, columns), of columns v of some entries; local."""
        place = np.zeros(self._owned, np.int64)
        place[dofs] = np.arange(len(dofs))
        at = place[self.dofs[: self._own]]
        rows = np.einsum("nki,nic->nkc", self.rows[: self._own], modes[at])
        return np.asarray(rows.reshape(-1, modes.shape[1]))

    def mix(self, x: Any, y: Any) -> None:
        """Complete y = P K P x to (P K P + s (I - P)) x, own entries; local."""
        dofs, scale = self.dofs[: self._own], self._scale[: self._own, None]
        beside = x[dofs] - np.einsum("nij,nj->ni", self.free[: self._own], x[dofs])
        self.clear(y)
        y[dofs] += scale * beside

    def apply(self, A: PETSc.Mat, size: float | None = None) -> None:
        """Replace K by P K P + s (I - P). Collective.

        Args:
            A: Assembled AIJ matrix of the unknown's layout, in whose pattern all components of two
                nodes are joined if any are.
            size: s; by default the mean of the node's own diagonal entries in K.
        """
        places, (own, dim) = self._places(A), (slice(self._own), self.dofs.shape[1])
        scale: Any = np.full(self._own, 1.0 if size is None else size)
        if size is None:
            diagonal = np.abs(np.einsum("nii->ni", _petsc.values(A)[0][places.blocks]))
            scale = np.where(diagonal.any(axis=1), diagonal.mean(axis=1), 1.0)
            self._scale[own] = scale
        for values, (columns, free, rows, at) in zip(_petsc.values(A), places.parts, strict=True):
            values[columns] = np.einsum("mj,mji->mi", values[columns], free)
            values[rows] = np.einsum("mij,jm->im", self.free[at], values[rows])
        values = _petsc.values(A)[0]
        beside = scale[:, None, None] * (np.eye(dim) - self.free[own])
        values[places.blocks] += beside
        A.assemble()

    def matrix(self, order: NDArray[np.int32] | None = None) -> PETSc.Mat:
        """P, identity at all other rows. Collective.

        Args:
            order: Owned numbers of the unknown whose rows are meant, ascending; by default all.
        """
        rows: Any = np.arange(self._owned) if order is None else order
        place = np.full(self._owned, -1, np.int64)
        place[rows] = np.arange(len(rows))
        dofs, dim = place[self.dofs[: self._own]], self.dofs.shape[1]
        count, layout = len(rows), PETSc.Vec().createMPI((len(rows), None), comm=self._comm)
        first = layout.getOwnershipRange()[0]
        layout.destroy()
        slanted = np.zeros(count, bool)
        slanted[dofs] = True
        lengths = np.where(slanted, dim, 1)
        pointers: Any = np.concatenate([[0], np.cumsum(lengths)]).astype(PETSc.IntType)
        columns, values = np.zeros(pointers[-1], PETSc.IntType), np.ones(pointers[-1])
        columns[pointers[:-1][~slanted]] = np.flatnonzero(~slanted)
        at = pointers[dofs][:, :, None] + np.arange(dim)
        ordered = np.argsort(dofs, axis=1)  # columns of a row ascend
        sorted_dofs = np.take_along_axis(dofs, ordered, axis=1)
        columns[at] = sorted_dofs[:, None, :]
        values[at] = np.take_along_axis(self.free[: self._own], ordered[:, None, :], axis=2)
        sizes = ((count, None), (count, None))
        csr = pointers, (columns + first).astype(PETSc.IntType), values
        return PETSc.Mat().createAIJ(sizes, csr=csr, comm=self._comm)

    @property
    def _comm(self) -> MPI.Comm:
        return self._space.mesh.comm

    def _places(self, A: PETSc.Mat) -> _Places:
        """Where the nodes' entries are in a matrix, found once for each pattern."""
        parts, beside = _petsc.parts(A)
        parts = parts[: len(_petsc.values(A))]  # on one rank both are the same
        # Contact may put another pattern in the matrix.
        key = [(len(part.columns), crc32(part.columns.data)) for part in parts]
        kept = A.getAttr(_NAME)
        same = kept is not None and kept.of is self and kept.key == key
        if self._comm.allreduce(same, MPI.LAND):
            return kept
        first, (own, dim) = A.getOwnershipRange()[0], (self._own, self.dofs.shape[1])
        # A row may have columns that this rank has no ghosts of: a column brings its node along.
        table = np.zeros((self._owned, 2 + dim))
        dofs = self.dofs[:own]
        table[dofs, 0] = 1 + first + dofs[:, :1]
        table[dofs, 1] = np.arange(dim)
        table[dofs, 2:] = self.free[:own]
        tables = [table, *([_fetched(A, table, beside)] if len(parts) == 2 else [])]
        listed, blocks = [], np.zeros((own, dim, dim), np.int64)
        for k, (part, of) in enumerate(zip(parts, tables, strict=True)):
            columns, row, free = _columns(part, of)
            listed.append((columns, free, *_rows(part, dofs)))
            if k == 0:
                node = np.full(self._owned, -1, np.int64)
                node[dofs] = np.arange(own)[:, None]
                mine = table[row, 0] == table[part.columns[columns[:, 0]], 0]
                at = row[mine]
                blocks[node[at], table[at, 1].astype(int)] = columns[mine]
        places = _Places(self, key, listed, blocks)
        A.setAttr(_NAME, places)
        return places


@dataclass(frozen=True, eq=False)
class _Places:
    """Places in a matrix's values: nodes' columns, with P, and rows in each part; own blocks."""

    of: Slants
    key: list[tuple[int, int]]
    parts: list[tuple[Any, Any, Any, Any]]
    blocks: NDArray[np.int64]


def _fetched(A: PETSc.Mat, table: Array, columns: NDArray[np.int32]) -> Array:
    """Rows of a table over a matrix's columns, by global numbers. Collective."""
    found = np.zeros((len(columns), table.shape[1]))
    whole, part = A.createVecRight(), PETSc.Vec().createSeq(len(columns))
    source = PETSc.IS().createGeneral(columns.astype(PETSc.IntType), comm=PETSc.COMM_SELF)
    scatter = PETSc.Scatter().create(whole, source, part, None)
    for k, values in enumerate(table.T):
        whole.array[:] = values
        scatter.scatter(whole, part, addv=PETSc.InsertMode.INSERT_VALUES)
        found[:, k] = part.array_r
    for item in (whole, part, source, scatter):
        item.destroy()
    return found


def _columns(part: _petsc.Part, table: Array) -> tuple[Any, Any, Any]:
    """Places of a node's entries in a row, shape (m, d), the rows, and P of the nodes."""
    dim = table.shape[1] - 2
    slanted = table[:, 0] > 0
    where = np.flatnonzero(slanted[part.columns])
    columns = part.columns[where]
    row = np.searchsorted(part.rows, where, side="right") - 1
    order = np.lexsort((table[columns, 1], table[columns, 0], row))
    where, row, columns = (a[order].reshape(-1, dim) for a in (where, row, columns))
    return where, row[:, 0], table[columns, 2:]


def _rows(part: _petsc.Part, dofs: NDArray[np.int32]) -> tuple[Any, Any]:
    """Places of a node's rows, shape (d, m), and the nodes of each of the m columns."""
    starts, lengths = part.rows[dofs], part.rows[dofs[:, 0] + 1] - part.rows[dofs[:, 0]]
    of = np.repeat(np.arange(len(dofs)), lengths)
    offset = np.arange(len(of)) - np.repeat(np.cumsum(lengths) - lengths, lengths)
    return starts[of].T + offset, of
