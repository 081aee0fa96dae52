# SPDX-License-Identifier: MIT
"""Files that many processes share and any of them may make, whatever is killed while it makes them.

A file is made in a folder of its own and moved to its place in one step, so that what has a place
is whole. A lock on a file beside it, which ends with the process that holds it, keeps others from
doing the same work: they wait as long as that process lives. Whoever has the lock removes what
killed ones have left. Where the file system knows no locks, each process does the work by itself.
"""

from __future__ import annotations

import fcntl
import os
import platform
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

PATIENCE = 60  # s before a process that waits says so
_PAUSE = 0.05  # s between two looks at a lock


def make_once(path: Path, make: Callable[[Path], Path]) -> None:
    """Make a file or folder unless it is there; local.

    Args:
        path: Its place.
        make: Function of an empty folder, beside the place, that makes it there and returns where.

    Raises:
        OSError: the folder of the place cannot be written. What ``make`` raises is passed on.
    """
    if path.exists():  # and no lock, as the cache may be readable only
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    # With the machine's name, as locks of some network folders are seen on one machine only.
    prefix = f"{path.name}.{platform.node()}."
    with _locked(path.with_name(path.name + ".lock")) as alone:
        if path.exists():
            return
        if alone:
            for left in path.parent.glob(prefix + "*"):
                shutil.rmtree(left, ignore_errors=True)  # its compiler may still write there
        with tempfile.TemporaryDirectory(
            dir=path.parent, prefix=prefix, ignore_cleanup_errors=True
        ) as folder:
            made = make(Path(folder))
            try:
                os.replace(made, path)
            except OSError:
                if not path.exists():  # another, without a lock, was first
                    raise


@contextmanager
def _locked(path: Path) -> Iterator[bool]:
    """Hold a lock; yields False where the file system has none. The file goes with the lock."""
    begin, said = time.monotonic(), False
    while True:
        file = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            taken = _try_lock(file)
            # The one that held it removes the file: then this lock is on a file of the past.
            if taken is None or (taken and _is(file, path)):
                try:
                    yield bool(taken)
                finally:
                    path.unlink(missing_ok=True)
                return
        finally:
            os.close(file)
        if not said and time.monotonic() - begin > PATIENCE:
            said = True
            print(
                f"variform: waiting for another process that compiles the same ({path}): if it "
                "hangs, end it, and this one goes on.",
                file=sys.stderr,
            )
        time.sleep(_PAUSE)


def _try_lock(file: int) -> bool | None:
    """Whether the lock is taken now; None where there are no locks."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return None
    return True


def _is(file: int, path: Path) -> bool:
    """Whether an open file is the one that a path names."""
    try:
        return os.path.samestat(os.fstat(file), path.stat())
    except FileNotFoundError:
        return False
