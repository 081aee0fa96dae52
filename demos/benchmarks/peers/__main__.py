# SPDX-License-Identifier: MIT
"""Run every code that is installed on the same block, and compare: table, CSV file and chart.

From the checkout, outside docker/enter: ``python3 -m demos.benchmarks.peers``. Each run is a
process of its own in the environment of its code, one at a time, the codes taking turns; rows go to
``results/peers/rows.jsonl`` as they come. Standard library alone, any Python from 3.11.
"""

import argparse
import json
import os
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path

from .codes import (
    ASSEMBLY,
    DEFAULTS,
    DOLFINX,
    ENTER,
    PEERS,
    POINTS,
    PYTHON,
    REFERENCE,
    ROOT,
    SECOND,
    SLOW_BLAS,
    VANILLA,
    VARIFORM,
)

OUTPUT = Path("results") / "peers"
STEPS = 3
ROUNDS = 3
# Runs longer than this [s] are done once.
LONG = 9.0


@dataclass(frozen=True)
class Runs:
    """Codes on one mesh, and how many of the three load steps; those of ``once`` take one turn."""

    size: str
    degree: int
    m: int
    steps: int
    codes: list
    once: list
    rounds: int = 1


def plan(small):
    """What is run, in order.

    At 58k and 70k the peers do the first step only, and torch-fem nothing: it takes minutes for
    that, as it halves the step several times. At 200k and 176k DOLFINx alone is run, one step.
    """
    if small:
        codes = [VARIFORM[0], VANILLA]
        return [Runs("toy", degree, 3 - degree, STEPS, codes, [REFERENCE]) for degree in (1, 2)]
    full = [*VARIFORM, *DOLFINX]
    first = [VARIFORM[0], VANILLA, *PEERS[:-1]]
    once = [REFERENCE, SECOND, *DEFAULTS]
    return [
        Runs("10k", degree, m, STEPS, [*full, *PEERS, SLOW_BLAS], once, ROUNDS)
        for degree, m in ((1, 8), (2, 4))
    ] + [
        Runs("58k", 1, 15, STEPS, full, [REFERENCE]),
        Runs("70k", 2, 8, STEPS, full, [REFERENCE]),
        Runs("58k", 1, 15, 1, first, [REFERENCE]),
        Runs("70k", 2, 8, 1, first, [REFERENCE]),
        Runs("200k", 1, 23, 1, [VARIFORM[0], *DOLFINX], [REFERENCE]),
        Runs("176k", 2, 11, 1, [VARIFORM[0], *DOLFINX], [REFERENCE]),
    ]


class Log:
    """Rows, printed and kept in a file as they come."""

    def __init__(self):
        OUTPUT.mkdir(parents=True, exist_ok=True)
        self.file = OUTPUT / "rows.jsonl"
        self.file.write_text("")

    def add(self, row):
        """Print and keep a row."""
        line = json.dumps(row)
        print(line, flush=True)
        with self.file.open("a") as file:
            file.write(line + "\n")


def follow(runs, log):
    """B1: the load path."""
    seconds = {}
    for turn in range(runs.rounds):
        for code in [*([] if turn else runs.once), *runs.codes]:
            if not code.there or seconds.get(code, 0) > LONG:
                continue
            start = time.perf_counter()
            at = ("--degree", runs.degree, "--m", runs.m, "--steps", runs.steps)
            (row,) = code.run(*at, "--output", OUTPUT.resolve() / code.key)
            seconds[code] = time.perf_counter() - start
            about = {"what": "path", "name": code.name, "size": runs.size, "turn": turn}
            about |= {"degree": runs.degree, "m": runs.m, "steps": runs.steps}
            log.add(about | row | {"folder": code.key})


def assemble(small, log):
    """B2: one residual and one tangent."""
    codes = [ASSEMBLY[0], ASSEMBLY[2]] if small else ASSEMBLY
    sizes = [("toy", 1, 2)] if small else [("58k", 1, 15), ("70k", 2, 8)]
    for size, degree, m in sizes:
        for code in codes:
            if code.there:
                (row,) = code.run("--degree", degree, "--m", m, "--assemble", 3)
                about = {"what": "assembly", "name": code.name, "size": size}
                log.add(about | {"degree": degree, "m": m} | row)


def points(small, log):
    """B3: energies in singular values."""
    for way in ["variform", "numpy"] if small else POINTS:
        if POINTS[way].there:
            for row in POINTS[way].run(way):
                log.add({"what": "points", "name": way} | row)


def main():
    """Run, then have the results compared where NumPy, matplotlib and PETSc are."""
    parser = argparse.ArgumentParser(prog="python3 -m demos.benchmarks.peers")
    parser.add_argument("--small", action="store_true", help="toy sizes, variform and DOLFINx only")
    parser.add_argument("--sizes", nargs="+", help="of 10k 58k 70k 200k 176k")
    parser.add_argument("--compare", action="store_true", help="no runs: the rows of the last ones")
    parser.add_argument("--write", action="store_true", help="tables into README.md")
    given = parser.parse_args()
    if not given.compare:
        log = Log()
        missing = {code.place for code in [*PEERS, *DEFAULTS] if not code.there}
        if missing and not given.small:
            log.add({"what": "not installed", "names": sorted(missing)})
        for runs in plan(given.small):
            if given.sizes is None or runs.size in given.sizes:
                follow(runs, log)
        assemble(given.small, log)
        points(given.small, log)
    command = [*ENTER, PYTHON, "-m", "demos.benchmarks.peers.compare", str(OUTPUT.resolve())]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    subprocess.run(command + ["--write"] * given.write, check=True, env=environment)


if __name__ == "__main__":
    main()
