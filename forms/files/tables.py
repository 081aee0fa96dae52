# SPDX-License-Identifier: MIT
"""Tables: a summary of a path in JSON. Collective, correct on any number of ranks."""

from __future__ import annotations

import json
import platform
import resource
from collections.abc import Mapping
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
        "steps": [
            {"load": s.load, **vars(s.convergence), "records": s.records} for s in path.steps
        ],
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
