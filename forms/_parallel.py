# SPDX-License-Identifier: MIT
"""Work that one rank does for all, such as writing a file, and extents over all ranks."""

from __future__ import annotations

from collections.abc import Callable

from mpi4py import MPI

import numpy as np
from numpy.typing import NDArray


def on_rank_zero(comm: MPI.Comm, work: Callable[[], None]) -> None:
    """Run work on rank 0; if it raises there, raise the same on every rank. Collective.

    Without this the others would wait for rank 0 in the next collective call for ever.
    """
    failure: Exception | None = None
    if comm.rank == 0:
        try:
            work()
        except Exception as error:
            failure = error
    failure = comm.bcast(failure, root=0)
    if failure is not None:
        raise failure


def bounding_box(
    comm: MPI.Comm, points: NDArray
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lowest and highest coordinates of the points, shape (n, 3), of all ranks. Collective."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    comm.Allreduce(points.min(axis=0, initial=np.inf), low, MPI.MIN)
    comm.Allreduce(points.max(axis=0, initial=-np.inf), high, MPI.MAX)
    return low, high
