# SPDX-License-Identifier: MIT
"""torch-fem's published box, forward and backward: ``python3 -m demos.benchmarks.peers.stretched``.

4 x n x n hexahedra of size 1/n, psi = mu/2 (I_C - 3) - mu ln J + lmbda/2 (ln J)^2, E = 1000, nu =
0.3; u_x = 0 on the left and prescribed on the right, u_y = 0 and u_z = 0 on the nodes of the middle
planes; pulled to ten times its thickness in ten geometric steps. Forward is the path, backward the
derivative of the total reaction on the right by mu and lmbda. All stress is uniaxial, so that both
are known. From the checkout, outside docker/enter; ``--write`` puts the table into
demos/benchmarks/README.md, ``--n`` chooses the size (64, the published one).

Source: torch-fem, benchmarks/hyperelasticity.py, commit 41893ad.
"""

import argparse
import json
import math
import resource
import statistics
import subprocess
import sys
from pathlib import Path

from .codes import ENTER, PYTHON, ROOT, Code

E, NU, STRETCH, STEPS = 1000.0, 0.3, 10.0, 10
MU, LMBDA = E / (2 * (1 + NU)), E * NU / ((1 + NU) * (1 - 2 * NU))
ROUNDS, LONG = 3, 200.0  # seconds of a process from which on one run is enough
OUTPUT = Path("results") / "peers" / "stretched.json"


def factors():
    """Load factors at the end of each step, of the whole displacement."""
    return [(STRETCH ** (k / STEPS) - 1) / (STRETCH - 1) for k in range(1, STEPS + 1)]


def response(mu=MU, lmbda=LMBDA, s=STRETCH):
    """Force per area at rest of uniaxial tension at a stretch s, and its derivatives by the moduli.

    mu (q^2 - 1) + lmbda ln(s q^2) = 0 gives the stretch q aside, and P = mu (s - 1/s) + lmbda
    ln(s q^2)/s the force. With Q = q^2: dQ/dmu = (1 - Q)/D, dQ/dlmbda = -ln(s Q)/D, D = mu +
    lmbda/Q.
    """
    low, high = 1e-6, 1.0
    for _ in range(200):  # bisection: the left side grows with Q
        Q = (low + high) / 2
        low, high = (low, Q) if mu * (Q - 1) + lmbda * math.log(s * Q) > 0 else (Q, high)
    D, ln_J = mu + lmbda / Q, math.log(s * Q)
    by_mu = s - 1 / s + lmbda / (Q * s) * (1 - Q) / D
    by_lmbda = ln_J / s - lmbda / (Q * s) * ln_J / D
    return [mu * (s - 1 / s) + lmbda * ln_J / s, by_mu, by_lmbda]


def arguments():
    """Command line of a code: cells across."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--n", type=int, default=64)
    return parser.parse_args()


def report(code, given, found, clock, **numbers):
    """Print a row: force and derivatives found, their errors over those known, seconds, memory."""
    row = {"code": code, "n": given.n, "found": [float(value) for value in found]}
    row["errors"] = [a / b - 1 for a, b in zip(row["found"], response(), strict=True)]
    row |= {f"{part}, CPU [s]": seconds for part, seconds in clock.cpu.items()}
    row |= {f"{part}, wall [s]": seconds for part, seconds in clock.wall.items()}
    row["peak [MB]"] = round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
    print(json.dumps(row | numbers, default=float), flush=True)


CODES = [
    Code("variform", "variform_stretched"),
    Code("torch-fem, CG + AMG (default)", "torchfem_stretched", "", "torch-fem"),
]
TIMES = [f"{part}, {of} [s]" for of in ("CPU", "wall") for part in ("forward", "backward")]


def table():
    """Put the rows that were measured into the page; where NumPy and PETSc are."""
    from demos.benchmarks.record import insert, markdown

    lines = []
    for row in json.loads(OUTPUT.read_text()):
        if "error" in row:
            lines.append([row["name"], row["error"], *[""] * 7])
            continue
        cpu, wall = (
            [row[f"{part}, {of} [s]"] for part in ("forward", "backward")] for of in ("CPU", "wall")
        )
        times = [f"{cpu[0]:.3g} ({wall[0]:.3g})", f"{cpu[1]:.3g} ({wall[1]:.3g})"]
        errors = [f"{value:+.0e}" for value in row["errors"]]
        cells = [row["name"], f"{row['dofs']:,}", row["Newton"], *times]
        lines.append([*cells, f"{cpu[1] / cpu[0]:.3f}", *errors[:1], ", ".join(errors[1:])])
        lines[-1].append(row["peak [MB]"])
    head = ["code", "unknowns", "Newton", "forward: CPU (wall), s", "backward: CPU (wall), s"]
    head += ["ratio", "force, error", "derivatives by mu, lmbda, errors", "MB"]
    insert("gradients beside a peer", markdown(head, lines))


def main():
    """Run all that is installed in turns, long ones once, and keep of each the medians."""
    given, rows = sys.argv, {}
    small = "--small" in given
    n = int(given[given.index("--n") + 1]) if "--n" in given else (4 if small else 64)
    for turn in range(1 if small else ROUNDS):
        for code in CODES[:1] if small else CODES:
            last = rows.get(code, [{}])[-1]
            if code.there and (turn == 0 or last.get("whole process, wall [s]", LONG) < LONG):
                rows.setdefault(code, []).extend(code.run("--n", n, limit=1200))
                print(json.dumps({"name": code.name} | rows[code][-1]), flush=True)
    kept = []
    for code, found in rows.items():
        row = {"name": code.name} | found[-1]
        if "error" not in row:
            row |= {key: statistics.median(r[key] for r in found) for key in TIMES}
        kept.append(row | {"runs": len(found)})
    OUTPUT.parent.mkdir(parents=True, exist_ok=True)
    OUTPUT.write_text(json.dumps(kept, indent=1) + "\n")
    if "--write" in given:
        command = [*ENTER, PYTHON, "-m", "demos.benchmarks.peers.stretched", "--table"]
        subprocess.run(command, cwd=ROOT, check=True)


if __name__ == "__main__":
    table() if "--table" in sys.argv else main()
