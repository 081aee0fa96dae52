# SPDX-License-Identifier: MIT
"""FElupe's Newton in the fidelity benchmark, for the scenes that its elements and loads express.

Left out: fixed corotated and Hencky energies, functions of singular values; mixed elements, which
are other ones there; P3; sheets; bodies of revolution and of plane strain; dead tractions, weights
and pressures, whose nodal forces would not be FElupe's; fibers.
"""

import json
import os
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from .fidelity_scenes import NAMES
from .peers.codes import CACHE, ONE_THREAD, ROOT

BODIES = ("bar", "cube", "slab", "rod")
LOADS = ("twist", "wring", "bend", "arc", "pull", "push", "shear", "buckle")
ENERGIES = ("neo_hookean", "saint_venant_kirchhoff", "stable_neo_hookean", "mooney_rivlin")
ELEMENTS = ("P1", "P2", "Q1", "Q2")
LIMIT = 120  # s of its process


def is_there():
    """Whether FElupe is installed: demos/benchmarks/peers/install felupe."""
    return (CACHE / "felupe" / "ready").exists()


def can_express(name):
    """Whether FElupe's elements, loads and energies make the scene."""
    body, load, energy, element = NAMES[name]
    parts = (body, load.split()[0], energy.split()[0], element.split()[0])
    return all(
        part in known
        for part, known in zip(parts, (BODIES, LOADS, ENERGIES, ELEMENTS), strict=True)
    )


def run(scene, steps):
    """Follow a scene by FElupe in equal steps; u and the load factor are left at its end.

    Returns:
        Row with tangents, seconds and the reason where it did not reach the end.
    """
    _, _, energy, element = NAMES[scene.name]
    x = scene.problem.create_vector()
    held, values = scene.problem.constrained, []
    ahead = scene.to - scene.begin
    for step in range(1, steps + 1):
        scene.go(scene.begin + ahead * step / steps)
        x.set(0)
        scene.problem.prescribe(x)
        values.append(x.array_r[held].copy())
    x.destroy()
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scene.npz"
        _save(file, scene, energy.split(), int(element[1]), held, values)
        command = [str(CACHE / "felupe" / "bin" / "python")]
        # By its path: the packages above it need DOLFINx, which FElupe's environment has not.
        command += [
            "-P",
            str(ROOT / "demos" / "benchmarks" / "peers" / "felupe_paths.py"),
            str(file),
        ]
        environment = {**os.environ, **ONE_THREAD}
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=LIMIT, env=environment, check=True
        )
        row = json.loads(done.stdout.splitlines()[-1])
        scene.reset()
        scene.u.x.array[:] = np.load(f"{file}.npy").ravel()
    scene.t.value = (
        scene.to if row["steps"] == steps else scene.begin + ahead * row["steps"] / steps
    )
    return row


def _save(file, scene, energy, degree, held, values):
    V = scene.u.function_space
    np.savez(
        file,
        points=V.tabulate_dof_coordinates(),
        cells=V.dofmap.list,
        kind=V.mesh.topology.cell_name(),
        degree=degree,
        reference=V.element.basix_element.points,
        energy=energy[0],
        number=float(energy[1]),
        prescribed=held,
        values=np.array(values),
    )
