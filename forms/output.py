# SPDX-License-Identifier: MIT
"""Files: VTX for ParaView, a JSON summary. All collective, correct on any number of ranks."""

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
import ufl
from dolfinx import fem, io

from ._parallel import on_rank_zero
from .fields import Evaluation, discontinuous
from .kinematics import Expr
from .results import displacement_of
from .solve.path import Path


class VTX:
    """Writer of the displacement and other fields at each load step, for ParaView.

    ``follow(…, on_step=VTX("twist.bp", u, sigma=stress.cauchy(psi, F)))``; a folder ``twist.bp`` is
    made. In ParaView apply "Warp by vector" with the displacement.

    Args:
        filename: Name that ends in .bp.
        u: Unknown; of a mixed one the displacement is written.
        fields: UFL expressions to be evaluated at each step. With any, all is written on
            discontinuous elements of the displacement's degree, u unchanged by that.

    Raises:
        ValueError: the name does not end in .bp.
        OSError: the folder cannot be made; alike on all ranks.
    """

    def __init__(self, filename: str | FilePath, u: fem.Function, **fields: Expr) -> None:
        self._file = FilePath(filename)
        if self._file.suffix != ".bp":
            raise ValueError(f"a VTX file needs a name that ends in .bp, got {self._file.name}.")
        self._unknown = u
        W = displacement_of(u).function_space
        mesh, degree = W.mesh, W.ufl_element().embedded_superdegree
        family = "Discontinuous Lagrange" if fields else "Lagrange"
        V = fem.functionspace(mesh, (family, degree, (mesh.geometry.dim,)))
        self._displacement = fem.Function(V, name="displacement")
        shapes = {name: ufl.as_ufl(e).ufl_shape for name, e in fields.items()}
        written = [
            fem.Function(discontinuous(mesh, degree, shape), name=name)
            for name, shape in shapes.items()
        ]
        self._fields = [Evaluation(e, f) for e, f in zip(fields.values(), written, strict=True)]
        on_rank_zero(mesh.comm, self._check_writable)
        outputs = [self._displacement, *written]
        self._writer = io.VTXWriter(mesh.comm, str(self._file), outputs, engine="BP4")

    def _check_writable(self) -> None:
        """Make the folder and a file in it: adios2 ends the process where it cannot."""
        self._file.mkdir(parents=True, exist_ok=True)
        probe = self._file / ".writable"
        probe.touch()
        probe.unlink()

    def __call__(self, path: Path) -> None:
        """Write the state of a path at its load factor."""
        self.write(path.load)

    def write(self, load: float) -> None:
        """Write the present state of the unknown under a load factor (ParaView's time)."""
        self._displacement.interpolate(displacement_of(self._unknown))
        for evaluation in self._fields:
            evaluation.update()
        self._writer.write(load)

    def close(self) -> None:
        """Close the file; further writes are errors."""
        self._writer.close()


def summary(path: Path, filename: str | FilePath | None = None, **more: Any) -> dict[str, Any]:
    """Summary of a path: outcome, steps, norms, recorded quantities, mesh, versions.

    Args:
        path: Outcome of a solve.
        filename: JSON file that rank 0 writes; none for the dictionary alone.
        more: Further entries, as results and parameters of a demo.

    Returns:
        The dictionary, alike on all ranks.
    """
    system = path.system
    mesh = system.u.function_space.mesh
    content = {
        "completed": path.completed,
        "reason": path.reason,
        "seconds": path.seconds,
        "peak_memory_mb": peak_memory(system.comm),
        "refused_steps": path.refused,
        "steps": [
            {"load": s.load, **vars(s.convergence), "records": s.records} for s in path.steps
        ],
        "unknowns": system.size,
        "cells": mesh.topology.index_map(mesh.topology.dim).size_global,
        "ranks": system.comm.size,
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

        on_rank_zero(system.comm, write)
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
