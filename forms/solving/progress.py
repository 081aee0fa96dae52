# SPDX-License-Identifier: MIT
"""One line on rank 0's screen that tells how far a long solve has come."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

from mpi4py import MPI

from tqdm import tqdm

OFTEN = 0.5  # seconds between words about the iterations


def bar_of(word: str, total: float | None, comm: MPI.Comm, shown: bool) -> tqdm:
    """Progress bar of a path: over a share of 1, over a number of steps, or open-ended (None)."""
    layout = "{desc} {n_fmt} {elapsed}{postfix}"
    if total == 1.0:
        layout = "{desc} {percentage:3.0f}%|{bar}| {elapsed}<{remaining}{postfix}"
    elif total is not None:
        layout = "{desc} {n_fmt}/{total_fmt} {elapsed}<{remaining}{postfix}"
    disabled = not shown or comm.rank != 0
    return tqdm(total=total, desc=word, bar_format=layout, file=sys.stderr, disable=disabled)


def watcher_of(bar: tqdm, state: Callable[[], str]) -> Callable[[float, float], None] | None:
    """What shows each iteration of a long solve behind the bar; None where no bar is shown."""
    if bar.disable:
        return None
    last = time.monotonic()

    def watch(norm: float, goal: float) -> None:
        nonlocal last
        if time.monotonic() - last > OFTEN:
            last = time.monotonic()
            bar.set_postfix_str(f"{state()}, |R| = {norm:.1e}, to go down to {goal:.1e}")

    return watch
