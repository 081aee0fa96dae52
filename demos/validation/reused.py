# SPDX-License-Identifier: MIT
"""Demos whose numbers are known: run as they are, and read from the files that they write."""

import contextlib
import io
import json
import runpy
import shutil
from pathlib import Path

from mpi4py import MPI

from variform import forms


def demo(name, folder, comm=MPI.COMM_WORLD):
    """Run a demo in this process; what its JSON file holds, and the names that it defined."""
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        names = runpy.run_module(f"demos.{name}")
    written, content = Path("results") / name, None
    if comm.rank == 0:
        content = json.loads((written / f"{name}.json").read_text())
        shutil.copyfile(written / f"{name}.png", folder / f"{name}.png")
    return comm.bcast(content), names


def bar(folder, comm):
    """Place of the point (10, 0.5, 1) [mm]."""
    found, _ = demo("bar", folder, comm)
    return {key: found[key] for key in ("x", "z", "volume")}


def cook(folder, comm):
    """Rise of the corner [mm] on 64 x 64 x 2 triangles, and on 16 x 16 x 2."""
    found, _ = demo("cook", folder, comm)
    return {"corner": found["corner"], "corner, n = 16": found["table"]["P2-P1"][3]}


def torsion(folder, comm):
    """Moment and axial force of the finest cylinder, from its state."""
    found, names = demo("torsion", folder, comm)
    force, moment = forms.resultant(names["path"], names["body"].facets("top"))
    rates = {f"rate, {name}": found["rates"][name] for name in ("moment", "force")}
    return {"moment": moment[2], "force": force[2], **rates}


def balloon(folder, comm):
    """Limit pressures of the sphere and of the clamped disk."""
    found, _ = demo("balloon", folder, comm)
    return {name: found["limits"][name][1] for name in ("sphere", "disk")}


def snap(folder, comm):
    """First limit load of the arch [N]."""
    found, _ = demo("snap", folder, comm)
    return {"limit": found["limit"]}


def reese(folder, comm):
    """How far the middle of the block goes [mm]."""
    found, _ = demo("reese", folder, comm)
    return {"middle": found["ends"]["Q2-Q1, 6 x 6 x 6"]}


def muscle(folder, comm):
    """Mean distance from the arc over the length, and the energy left over that kept straight."""
    found, _ = demo("muscle", folder, comm)
    distance = found["steps"][-1]["records"]["error"]
    return {"distance": distance, "energy": found["ring"] / found["straight"]}
