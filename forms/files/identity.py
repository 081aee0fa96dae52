# SPDX-License-Identifier: MIT
"""Nodes in an order that no partition of the mesh changes."""

from __future__ import annotations

import hashlib
from typing import Any

from mpi4py import MPI

import numpy as np
from numpy.typing import NDArray


class NodeOrder:
    """Nodes in the order of their first appearance in the cells as input; rank 0 knows it.

    Args:
        comm: Communicator.
        cells: Numbers of the owned cells as input.
        nodes: Local numbers of their nodes, shape (cells, nodes per cell).
        imap: Index map of the nodes.
        width: Values per node.

    ``digest``, on rank 0, is a hash of the cells' nodes in that order.
    """

    def __init__(
        self, comm: MPI.Comm, cells: NDArray, nodes: NDArray, imap: Any, width: int
    ) -> None:
        self._comm, self._width, self._owned = comm, width, imap.size_local * width
        table = imap.local_to_global(nodes.ravel()).reshape(nodes.shape)
        parts = comm.gather((cells, table, self._owned), root=0)
        self.digest = ""
        if parts is not None:
            numbers, tables, counts = map(list, zip(*parts, strict=True))
            table = np.concatenate(tables)[np.argsort(np.concatenate(numbers))]
            found, first, at = np.unique(table.ravel(), return_index=True, return_inverse=True)
            appearance = np.argsort(first)
            self._order, self._ends = found[appearance], np.cumsum(counts)[:-1]
            self.digest = hashlib.sha256(np.argsort(appearance)[at].tobytes()).hexdigest()

    def gather(self, values: NDArray[np.float64]) -> NDArray[np.float64] | None:
        """Values of all nodes, shape (nodes, width), on rank 0, from each rank's own."""
        parts = self._comm.gather(values[: self._owned], root=0)
        if parts is None:
            return None
        whole: NDArray[np.float64] = np.concatenate(parts)
        return whole.reshape(-1, self._width)[self._order]

    def scatter(self, values: NDArray[np.float64] | None) -> NDArray[np.float64]:
        """Each rank's own values from those of all nodes on rank 0."""
        parts = None
        if values is not None:
            whole = np.empty_like(values)
            whole[self._order] = values
            parts = np.split(whole.ravel(), self._ends)
        return self._comm.scatter(parts, root=0)
