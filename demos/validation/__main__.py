# SPDX-License-Identifier: MIT
"""Cases with known answers: ``docker/enter python3 -m demos.validation``.

Names after it choose some; ``mpirun -n 2`` before python3 runs them on two ranks. Pictures and
numbers go to ``results/validation``. ``--write`` puts them on this folder's page and keeps the
numbers there. ``--compare FILE`` runs nothing: it compares the numbers of the last run with a file.
"""

import argparse
import json
import sys
import time
from pathlib import Path

from mpi4py import MPI

from .cases import CASES
from .page import COLUMNS, compare, row, shrink, write

OUTPUT = Path("results") / "validation"
HERE = Path(__file__).resolve().parent


def run(names, comm=MPI.COMM_WORLD):
    """Run cases one after the other; what each found, with seconds, on every rank."""
    if comm.rank == 0:
        OUTPUT.mkdir(parents=True, exist_ok=True)
    comm.barrier()
    found = {}
    for name in names:
        if comm.rank == 0:
            print(f"{name}: {CASES[name].title}", flush=True)
        start = time.perf_counter()
        numbers = {key: float(value) for key, value in CASES[name].run(OUTPUT, comm).items()}
        seconds = time.perf_counter() - start
        found[name] = {"numbers": numbers, "seconds": round(seconds, 1), "ranks": comm.size}
        if comm.rank == 0:
            for cells in (COLUMNS, *(row(CASES[name], *item) for item in numbers.items())):
                print("  {:26} {:>16} {:>12} {:>9} {:>9}".format(*cells).rstrip())
            print(f"  {seconds:.1f} s", flush=True)
            (OUTPUT / f"{name}.json").write_text(json.dumps(found[name], indent=1) + "\n")
            keep({name: found[name]})
    return found


def keep(found):
    """Add what was found to ``results/validation/numbers.json``."""
    file = OUTPUT / "numbers.json"
    kept = json.loads(file.read_text()) if file.exists() else {}
    kept |= {name: case["numbers"] for name, case in found.items()}
    kept = {name: kept[name] for name in CASES if name in kept}
    file.write_text(json.dumps(kept, indent=1) + "\n")


def missed(found):
    """Numbers that are further off their reference than their tolerance."""
    return [
        f"{name}: {key}"
        for name, case in found.items()
        for key, known in CASES[name].known.items()
        if not abs(case["numbers"][key] - known.reference) <= known.tolerance
    ]


def main(words, comm=MPI.COMM_WORLD):
    """Run or compare; 1 if a number is off, 2 if the command is wrong."""
    parser = argparse.ArgumentParser(prog="demos.validation", description=__doc__.split("\n")[0])
    add = parser.add_argument
    add("names", nargs="*", help=f"of {', '.join(CASES)}; none: all")
    add("--write", action="store_true", help="renew this folder's page and numbers")
    add("--compare", metavar="FILE", type=Path, help="compare the numbers of the last run")
    add("--rtol", type=float, default=1e-8, help="relative tolerance of --compare")
    chosen = parser.parse_args(words)
    unknown = [name for name in chosen.names if name not in CASES]
    if unknown:
        if comm.rank == 0:
            print(f"There is no case {', '.join(unknown)}: choose from {', '.join(CASES)}.")
        return 2
    if chosen.compare is not None:
        if comm.rank > 0:
            return 0
        return compare(OUTPUT / "numbers.json", chosen.compare, chosen.rtol, chosen.names)
    found = run(chosen.names or CASES, comm)
    if comm.rank == 0 and chosen.write:
        for name in found:
            shrink(OUTPUT / f"{CASES[name].picture}.png", HERE / "figures" / f"{name}.png")
        write(OUTPUT, {name: case["numbers"] for name, case in found.items()})
    off = missed(found)
    if comm.rank == 0:
        print(f"Off: {'; '.join(off)}." if off else "Every number is within its tolerance.")
    return int(bool(off))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
