# SPDX-License-Identifier: MIT
"""Symmetric Gauss-Seidel by the blocks of nodes in single precision: multigrid's smoother."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from numpy.typing import NDArray

from ... import _petsc
from ...native.library import library
from ...native.records import address

LEAST = 1e-4  # pivot of a node's block over its diagonal: three digits of seven are left
ROOM, BLOCK, INVERSE = 8, 9, 12  # numbers a node, a block, an inverse (kernels/sweeps.h)


class Sweeps:
    """One sweep forwards and one backwards over the nodes of each rank.

    x + M^-1 (b - A x),  M = (D + L) D^-1 (D + L^T),  A_own = L + D + L^T

    D are the blocks of the nodes on the diagonal of what couples the nodes of one rank. Half of it
    is read, in single precision: of M a preconditioner needs no more, and a Krylov method, whose
    own products stay exact, converges to any tolerance.

    Args:
        A: Symmetric AIJ matrix of 3x3 blocks.
        loaded: The library of kernels and its interface, where they are at hand.

    Attributes:
        possible: Whether A is one, and no node so much stiffer one way than another (fibers, stiff
            springs, contact: 1e4 times) that the other way would be lost; alike on all ranks.
    """

    def __init__(self, A: PETSc.Mat, loaded: tuple[Any, Any] | None = None) -> None:
        self._comm = comm = A.comm.tompi4py()
        self._A, (self._lib, self._ffi) = A, loaded or library(comm)
        count = nodes = -1
        if A.getType() in ("seqaij", "mpiaij"):
            part = _petsc.owned_part(A)
            nodes, odd = divmod(len(part.rows) - 1, 3)
            count = -1 if odd else self._lib.sweeps_count(nodes, *map(self._at, part[:2]))
        self.possible = False
        self._record: Any = None
        self._beside: _petsc.OffDiagonal | None = None
        if comm.allreduce(count < 0):
            return
        self._arrays = (
            np.empty(nodes + 1, np.int32),
            np.empty(count, np.int32),
            np.empty(BLOCK * count + 1, np.float32),
            np.empty(INVERSE * nodes, np.float32),
        )
        self._room = np.empty(ROOM * nodes, np.float32)
        self._record = r = self._ffi.new("sweeps_t *")
        r.nodes = nodes
        r.starts, r.columns, r.blocks, r.inverse = map(self._at, self._arrays)
        if A.getType() == "mpiaij":
            self._beside, self._given = _petsc.OffDiagonal(A), A.createVecLeft()
        self._state = -1
        self.update()

    def _at(self, array: NDArray) -> Any:
        """Address of an array that lives as long as it is used."""
        return address(self._ffi, array)

    def update(self) -> None:
        """Take the numbers that the matrix has now, if they are others. Collective."""
        if self._record is None or self._state == self._A.stateGet():
            return
        self._state = self._A.stateGet()
        part = _petsc.owned_part(self._A)
        least = self._lib.sweeps_fill(self._record, *(self._at(array) for array in part))
        self.possible = bool(self._comm.allreduce(least, MPI.MIN) >= LEAST)

    def __call__(self, b: PETSc.Vec, x: PETSc.Vec, r: PETSc.Vec | None = None) -> None:
        """Improve x; or begin at x = 0 and put b - A x into r. Collective."""
        begins, given = r is not None, b
        if self._beside is not None and not begins:
            given = self._given
            given.array[:] = b.array_r - self._beside(x)
        left = self._ffi.NULL if r is None else self._at(r.array)
        numbers = self._at(given.array_r), self._at(x.array)
        self._lib.sweeps_apply(self._record, *numbers, begins, left, self._at(self._room))
        if r is not None and self._beside is not None:
            r.array[:] -= self._beside(x)

    def destroy(self) -> None:
        """Free PETSc's objects."""
        if self._beside is not None:
            self._beside.destroy()
            self._given.destroy()
