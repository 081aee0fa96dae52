# SPDX-License-Identifier: MIT
"""A cube pressed on a rigid plane beside FElupe: ``python3 -m demos.benchmarks.peers.pressed``.

A unit cube of n^3 hexahedra, psi = mu/2 (I_C - 3) - mu ln J + lmbda/2 (ln J)^2, rollers at its
sides, its top moved down by a tenth; the plane, which it touches at first, holds it by contact
alone, without friction. All stress is uniform, of one equation. From the checkout, outside
docker/enter; ``--write`` puts the table into demos/benchmarks/README.md. FElupe's contact is of
nodes with rigid planes and cylinders, by penalty; two deformable bodies are variform's alone.
"""

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from .codes import ENTER, PYTHON, ROOT, Code

MU, LMBDA, BY = 1.0, 2.0, 0.1
TOLERANCE = 1e-9  # absolute norm of the residual, to forces of 0.4
SIZES, BLOCKS = (8, 13, 20), (8, 13)
ROUNDS, LONG = 3, 9.0  # seconds, from which on one run is enough
OUTPUT = Path("results") / "peers" / "pressed.json"


def cube(n):
    """Points (m, 3) and hexahedra (n^3, 8) of a unit cube, corners in VTK's order."""
    axis = np.linspace(0, 1, n + 1)
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    number = np.arange(len(points)).reshape((n + 1,) * 3)
    corners = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
    corners += [(x, y, 1) for x, y, _ in corners]
    cells = [number[x : x + n, y : y + n, z : z + n].ravel() for x, y, z in corners]
    return points, np.stack(cells, axis=1)


def response(stretch):
    """Force on the top at a stretch along z, none aside; pressure is negative."""
    return MU * (stretch - 1 / stretch) + LMBDA * np.log(stretch) / stretch


def arguments(*solvers):
    """Command line of a code: its way, cells along an edge."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--n", type=int, default=8)
    parser.add_argument("--solver", default=solvers[0], choices=solvers)
    return parser.parse_args()


def report(code, given, force, stresses, plane, seconds, **numbers):
    """Print a row: errors of the force, evenness of P33 beside the plane, where its nodes are."""
    row = {"code": code, "n": given.n, "force, error": force / response(1 - BY) - 1}
    row["stress, largest deviation"] = float(np.abs(stresses / np.mean(stresses) - 1).max())
    row["height of the lower nodes"] = [float(np.min(plane)), float(np.max(plane))]
    print(json.dumps(row | numbers | {"seconds": round(seconds, 3)}, default=float), flush=True)


def clocked(work):
    """What a call returns, and the CPU seconds that it takes."""
    start = time.process_time()
    found = work()
    return found, time.process_time() - start


CODES = [
    Code("variform, obstacle", "variform_pressed", "obstacle"),
    Code("FElupe, penalty 1 (default)", "felupe_pressed", "1", "felupe"),
    Code("FElupe, penalty 100", "felupe_pressed", "100", "felupe"),
    Code("FElupe, penalty 10,000", "felupe_pressed", "10000", "felupe"),
    Code("variform, 13 on 8 as surfaces", "variform_pressed", "surfaces"),
]


def table():
    """Put the rows that were measured into the page; where NumPy and PETSc are."""
    from demos.benchmarks.record import insert, markdown

    lines = []
    for row in json.loads(OUTPUT.read_text()):
        if "error" in row:
            lines.append([row["name"], row["error"], *[""] * 6])
            continue
        low, high = row["height of the lower nodes"]
        cells = [row["name"], f"{row['dofs']:,}", f"{100 * row['force, error']:+.3f}"]
        cells += [f"{100 * row['stress, largest deviation']:.2g}", f"{low:+.1e} to {high:+.1e}"]
        lines.append([*cells, row["steps"], row["tangents"], f"{row['seconds']:.2f} s"])
    head = ["code", "dofs", "force, error [%]", "stress beside, largest deviation [%]"]
    head += ["heights of the nodes", "steps", "tangents", "CPU time"]
    insert("contact beside a peer", markdown(head, lines))


def main():
    """Run all that is installed, three times where it is short, and keep the median ones."""
    rows, small = [], "--small" in sys.argv
    for n in (3,) if small else SIZES:
        for code in CODES[:1] if small else CODES:
            # Two blocks have meshes of their own.
            if not code.there or (code.solver == "surfaces" and n != BLOCKS[1]):
                continue
            found = code.run("--n", n)
            while len(found) < ROUNDS and found[0].get("seconds", LONG) < LONG:
                found += code.run("--n", n)
            found.sort(key=lambda row: row.get("seconds", 0))
            rows.append({"name": code.name} | found[len(found) // 2])
            print(json.dumps(rows[-1]), flush=True)
    OUTPUT.parent.mkdir(parents=True, exist_ok=True)
    OUTPUT.write_text(json.dumps(rows, indent=1) + "\n")
    if "--write" in sys.argv:
        command = [*ENTER, PYTHON, "-m", "demos.benchmarks.peers.pressed", "--table"]
        subprocess.run(command, cwd=ROOT, check=True)


if __name__ == "__main__":
    table() if "--table" in sys.argv else main()
