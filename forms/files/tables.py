# SPDX-License-Identifier: MIT
"""Tables: a path in JSON, its records in CSV. Collective, correct on any number of ranks."""

from __future__ import annotations

import csv
import json
import platform
import resource
from collections.abc import Mapping, Sequence
from pathlib import Path as FilePath
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import dolfinx
import numpy as np

from .._parallel import on_rank_zero
from ..paths import Path


def summary(path: Path, filename: str | FilePath | None = None, **more: Any) -> dict[str, Any]:
    """Summary of a path: outcome, steps, norms, recorded quantities, mesh, versions.

    Args:
        path: Outcome of a solve.
        filename: JSON file that rank 0 writes; none for the dictionary alone.
        more: Further entries, as results and parameters of a demo.

    Returns:
        The dictionary, alike on all ranks.
    """
    problem = path.problem
    mesh = problem.u.function_space.mesh
    content = {
        "completed": path.completed,
        "reason": path.reason,
        "seconds": path.seconds,
        "peak_memory_mb": peak_memory(problem.comm),
        "refused_steps": path.refused,
        "tangents": path.tangents,
        "steps": [
            {"load": s.load, **vars(s.convergence), "records": s.records} for s in path.steps
        ],
        "events": [event._asdict() for event in path.events],
        "ledger": [row._asdict() for row in path.ledger],
        "unknowns": problem.size,
        "cells": mesh.topology.index_map(mesh.topology.dim).size_global,
        "ranks": problem.comm.size,
        "versions": {
            "dolfinx": dolfinx.__version__,
            "petsc": ".".join(map(str, PETSc.Sys.getVersion())),
            "python": platform.python_version(),
        },
        **more,
    }
    plain = _finite(json.loads(json.dumps(content, default=_plain)))
    if filename is not None:
        target = FilePath(filename)

        def write() -> None:
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_text(json.dumps(plain, indent=1) + "\n")

        on_rank_zero(problem.comm, write)
    return plain


def table(
    rows: Path | Sequence[Any], filename: str | FilePath | None = None
) -> list[dict[str, float | str]]:
    """Table of what was recorded at each step, or of any other rows, in CSV. Collective.

    ``table(path, "run.csv")`` has a row a step: load, iterations, and the records, an array's
    entries in columns of their own: ``force_0``, ``force_1``; ``J_lower`` of one with names.

    Args:
        rows: Path; or rows, as ``path.ledger`` and ``path.events``: mappings or named tuples.
        filename: CSV file that rank 0 writes; none for the rows alone.

    Returns:
        The rows, alike on all ranks; a column that a row lacks is left empty in the file.

    Raises:
        ValueError: the name does not end in .csv, or a row has no names.
        OSError: the file cannot be written; alike on all ranks.
    """
    target = None if filename is None else FilePath(filename)
    if target is not None and target.suffix != ".csv":
        raise ValueError(f"a table needs a name that ends in .csv, got {target.name}.")
    comm: MPI.Comm = MPI.COMM_WORLD
    given: Sequence[Any] = rows if not isinstance(rows, Path) else ()
    if isinstance(rows, Path):
        comm = rows.problem.comm
        given = [
            {"load": s.load, "iterations": s.convergence.iterations, **s.records}
            for s in rows.steps
        ]
    flat = [_flat(row) for row in given]
    if target is not None:

        def write() -> None:
            target.parent.mkdir(parents=True, exist_ok=True)
            with target.open("w", newline="") as file:
                writer = csv.DictWriter(file, list(dict.fromkeys(k for row in flat for k in row)))
                writer.writeheader()
                writer.writerows(flat)

        on_rank_zero(comm, write)
    return flat


def _flat(row: Any) -> dict[str, float | str]:
    """A row with a number or a text in each column."""
    named = row._asdict() if hasattr(row, "_asdict") else row
    if not isinstance(named, Mapping):
        raise ValueError(
            "a table needs a path, or rows that are mappings or named tuples, got a "
            f"{type(row).__name__}."
        )
    found: dict[str, float | str] = {}
    for key, value in named.items():
        if hasattr(value, "_asdict") or isinstance(value, Mapping):
            found |= {f"{key}_{name}": entry for name, entry in _flat(value).items()}
        elif isinstance(value, list | tuple | np.ndarray) and np.ndim(value):
            array = np.asarray(value)
            found |= {
                "_".join([key, *map(str, i)]): array[i].item() for i in np.ndindex(array.shape)
            }
        else:
            found[key] = value.item() if isinstance(value, np.generic | np.ndarray) else value
    return found


def peak_memory(comm: MPI.Comm) -> float:
    """Largest resident memory [MB] that all ranks together have used so far. Collective."""
    kilobytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return float(comm.allreduce(kilobytes)) / 1024


def _finite(value: Any) -> Any:
    """The same with None for numbers that JSON does not have: NaN and infinities."""
    if isinstance(value, dict):
        return {key: _finite(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_finite(entry) for entry in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


def _plain(value: Any) -> Any:
    """NumPy and mapping values as JSON has them."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Mapping):
        return dict(value)
    raise TypeError(
        f"a summary holds numbers, texts, lists and arrays, got {type(value).__name__}."
    )
