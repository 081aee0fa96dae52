# SPDX-License-Identifier: MIT
"""What benchmarks do with their rows: print, keep, name the machine, write files and tables."""

import csv
import json
import os
import platform
import time
from importlib import metadata
from pathlib import Path

from petsc4py import PETSc

import numpy as np

OUTPUT = Path("results")
PAGE = Path(__file__).resolve().parent / "README.md"


class Table:
    """Rows of one benchmark: one JSON line each as they come, all of them in a CSV file.

    Args:
        name: Name of the files, as in ``results/name.csv``.
        speaks: Whether this process prints and writes (rank 0).
    """

    def __init__(self, name, speaks=True):
        self.name, self.speaks, self.rows = name, speaks, []

    def add(self, **row):
        """Print and keep one row."""
        self.rows.append(row)
        if self.speaks:
            print(json.dumps(row, ensure_ascii=False, default=float), flush=True)

    def write(self):
        """Write ``results/name.csv``, and beside it the machine and versions as JSON."""
        if not self.speaks:
            return
        OUTPUT.mkdir(exist_ok=True)
        columns = list(dict.fromkeys(key for row in self.rows for key in row))
        with (OUTPUT / f"{self.name}.csv").open("w", newline="") as file:
            writer = csv.DictWriter(file, columns)
            writer.writeheader()
            writer.writerows(self.rows)
        text = json.dumps(machine(), indent=1)
        (OUTPUT / f"{self.name}_machine.json").write_text(text + "\n")


def machine():
    """Processor, load and versions that figures were measured with."""
    cpu, memory = platform.processor(), 0.0
    if Path("/proc/cpuinfo").exists():
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
        cpu = names[0] if names else cpu
        memory = round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30, 1)
    packages = ("fenics-dolfinx", "fenics-ufl", "fenics-ffcx", "petsc4py", "numpy", "mpi4py")
    return {
        "processor": cpu,
        "cores": len(os.sched_getaffinity(0)),
        "memory [GiB]": memory,
        "load": round(os.getloadavg()[0], 1),
        "date": time.strftime("%Y-%m-%d"),
        "Python": platform.python_version(),
        "PETSc": ".".join(map(str, PETSc.Sys.getVersion())),
        **{name: _version(name) for name in packages},
    }


def _version(package):
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "unknown"


def median_times(variants, repeats):
    """CPU seconds of each variant, interleaved: medians over the rounds."""
    times = {name: [] for name in variants}
    for _ in range(repeats):
        for name, work in variants.items():
            start = time.process_time()
            work()
            times[name].append(time.process_time() - start)
    return {name: float(np.median(t)) for name, t in times.items()}


def save(figure, name):
    """Write a figure as ``results/name.png`` and ``results/name.svg``."""
    OUTPUT.mkdir(exist_ok=True)
    for kind in ("png", "svg"):
        figure.savefig(OUTPUT / f"{name}.{kind}")


def markdown(columns, rows):
    """Lines of a Markdown table."""
    lines = ["| " + " | ".join(map(str, columns)) + " |", "| --- " * len(columns) + "|"]
    return lines + ["| " + " | ".join(map(str, row)) + " |" for row in rows]


def insert(mark, lines, page=PAGE):
    """Put lines between ``<!-- mark: written by a run -->`` and ``<!-- end of mark -->``.

    Raises:
        ValueError: the page has no such place.
    """
    begin, end = f"<!-- {mark}: written by a run -->", f"<!-- end of {mark} -->"
    head, found, rest = page.read_text().partition(begin)
    _, closed, tail = rest.partition(end)
    if not (found and closed):
        raise ValueError(f"{page.name} has no place for {mark}: write {begin} and {end} there.")
    page.write_text("\n".join([head + begin, "", *lines, "", end + tail]))
