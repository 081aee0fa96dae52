# SPDX-License-Identifier: MIT
"""Compare what lanes.c printed on two processors: ``python3 tests/lanes.py HERE THERE``.

Numbers of one name are as exact as its largest: 1e-13, those in single precision 1e-5.
"""

import sys
from pathlib import Path

import numpy as np


def numbers(path):
    """Arrays by name."""
    found = {}
    for line in Path(path).read_text().splitlines():
        name, _, number = line.rpartition(" ")
        found.setdefault(name, []).append(float(number))
    return {name: np.array(values) for name, values in found.items()}


def main(here, there):
    """1 where they differ."""
    ours, theirs = numbers(here), numbers(there)
    failed = ours.keys() != theirs.keys() or not ours
    for name, values in ours.items():
        off = np.abs(values - theirs[name]).max() / np.abs(values).max()
        print(f"{name}: {len(values)} numbers, {off:.1e} apart")
        failed |= not off <= (1e-5 if name.startswith("single") else 1e-13)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
