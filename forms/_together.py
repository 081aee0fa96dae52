# SPDX-License-Identifier: MIT
"""An exception that ends one rank ends all: without it the others wait for that rank for ever."""

from __future__ import annotations

import sys
import time
import traceback
from types import TracebackType

from mpi4py import MPI

GRACE = 3.0  # seconds in which the other ranks may end by an exception of their own


def end_together() -> None:
    """Let an uncaught exception on any rank end the whole program, its message shown. Local.

    The rank prints its traceback and waits a little. If all ranks raise, as they do on wrong
    input, each ends by itself; if not, MPI ends the others. One rank alone, and programs with an
    excepthook of their own, are left as they are.
    """
    if MPI.COMM_WORLD.size > 1 and sys.excepthook is sys.__excepthook__:
        sys.excepthook = _ended


def _ended(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    comm = MPI.COMM_WORLD
    text = "".join(traceback.format_exception(kind, error, trace))
    print(f"rank {comm.rank} of {comm.size} ended:\n{text}", file=sys.stderr, end="", flush=True)
    everyone = comm.Ibarrier()
    start = time.monotonic()
    while not everyone.Test():
        if time.monotonic() - start > GRACE:
            comm.Abort(1)
        time.sleep(0.05)
