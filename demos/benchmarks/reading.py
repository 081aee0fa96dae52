# SPDX-License-Identifier: MIT
"""Time and memory of `meshes.read` beside DOLFINx's own readers, per rank.

`python3 -m demos.benchmarks.reading make FOLDER N` writes box.msh and box.xdmf of 6 N^3 tetrahedra
with two regions and eleven boundaries.  `python3 -m demos.benchmarks.reading FILE ours`, or with
`dolfinx`, on any number of ranks, reads one and prints a line of JSON: seconds, and of each rank
the peak and what stays [MB].  One reading per process: a peak never falls.
"""

import gc
import json
import resource
import sys
import time
from pathlib import Path
from typing import Any

from mpi4py import MPI


def make(folder: Path, n: int) -> None:
    """Write the box 1 x 1 x 2 of 6 n^3 tetrahedra, its two halves being regions."""
    import gmsh
    from dolfinx.io import XDMFFile

    from variform import meshes

    gmsh.initialize(readConfigFiles=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.option.setNumber("Mesh.Binary", 1)
    occ = gmsh.model.occ
    occ.fragment([(3, occ.addBox(0, 0, 0, 1, 1, 1))], [(3, occ.addBox(0, 0, 1, 1, 1, 1))])
    occ.synchronize()
    for _, curve in gmsh.model.getEntities(1):
        box = gmsh.model.getBoundingBox(1, curve)
        upright = box[5] - box[2] > 0.5
        gmsh.model.mesh.setTransfiniteCurve(curve, (n // 2 if upright else n) + 1)
    for dim in 2, 3:
        for _, entity in gmsh.model.getEntities(dim):
            if dim == 2:
                gmsh.model.mesh.setTransfiniteSurface(entity)
            else:
                gmsh.model.mesh.setTransfiniteVolume(entity)
    for tag, (_, volume) in enumerate(gmsh.model.getEntities(3), 1):
        gmsh.model.addPhysicalGroup(3, [volume], tag, f"half{tag}")
    for tag, (_, face) in enumerate(gmsh.model.getEntities(2), 11):
        gmsh.model.addPhysicalGroup(2, [face], tag, f"side{tag}")
    gmsh.model.mesh.generate(3)
    gmsh.write(str(folder / "box.msh"))
    gmsh.finalize()
    body = meshes.read(MPI.COMM_SELF, folder / "box.msh")
    with XDMFFile(MPI.COMM_SELF, folder / "box.xdmf", "w") as file:
        file.write_mesh(body.mesh)
        file.write_meshtags(body.cell_tags, body.mesh.geometry)
        file.write_meshtags(body.facet_tags, body.mesh.geometry)


def read(file: Path, who: str) -> Any:
    """Mesh, cell tags and facet tags: ours as a body, DOLFINx's as a tuple."""
    comm = MPI.COMM_WORLD
    if who == "ours":
        from variform import meshes

        return meshes.read(comm, file)
    if file.suffix == ".msh":
        from dolfinx.io import gmshio

        return gmshio.read_from_msh(str(file), comm, 0, gdim=3)
    from dolfinx.io import XDMFFile

    with XDMFFile(comm, file, "r") as xdmf:
        mesh = xdmf.read_mesh()
        mesh.topology.create_connectivity(2, 3)
        return mesh, *(xdmf.read_meshtags(mesh, name) for name in ("regions", "boundaries"))


def resident() -> float:
    """Memory in use [MB]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 1e6


def main() -> None:
    """As the module says."""
    if sys.argv[1] == "make":
        make(Path(sys.argv[2]), int(sys.argv[3]))
        return
    file, who = Path(sys.argv[1]), sys.argv[2]
    comm = MPI.COMM_WORLD
    import dolfinx.io

    from variform import meshes

    before = resident()
    comm.barrier()
    start = time.perf_counter()
    held = read(file, who)
    comm.barrier()
    seconds = time.perf_counter() - start
    gc.collect()
    mesh = getattr(held, "mesh", None) or held[0]
    cells = mesh.topology.index_map(3).size_global
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6 - before
    facts = comm.gather((round(peak), round(resident() - before)))
    if comm.rank == 0:
        peaks, stays = zip(*facts, strict=True)
        line = {"file": file.name, "who": who, "ranks": comm.size, "cells": cells}
        print(json.dumps(line | {"s": round(seconds, 1), "peak": peaks, "stays": stays}))
    assert meshes and dolfinx.io  # imported before the clock starts


if __name__ == "__main__":
    main()
