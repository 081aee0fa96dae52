# SPDX-License-Identifier: MIT
"""One line on rank 0's screen that tells how far a long solve has come."""

from __future__ import annotations

import sys

from mpi4py import MPI

from tqdm import tqdm


def bar_of(word: str, total: float | None, comm: MPI.Comm, shown: bool) -> tqdm:
    """Progress bar of a path: over a share of 1, over a number of steps, or open-ended (None)."""
    layout = "{desc} {n_fmt} {elapsed}{postfix}"
    if total == 1.0:
        layout = "{desc} {percentage:3.0f}%|{bar}| {elapsed}{postfix}"
    elif total is not None:
        layout = "{desc} {n_fmt}/{total_fmt} {elapsed}{postfix}"
    disabled = not shown or comm.rank != 0
    return tqdm(total=total, desc=word, bar_format=layout, file=sys.stderr, disable=disabled)
