# SPDX-License-Identifier: MIT
"""Run every benchmark, one after the other: ``docker/enter python3 -m demos.benchmarks``.

Names after it choose some; ``--small`` and ``--write`` go on to each of them. The comparison with
other codes is started by itself, see peers/README.md.
"""

import subprocess
import sys
import time

NAMES = (
    "operators",
    "moduli",
    "rates",
    "misprints",
    "hard_cases",
    "fidelity",
    "locking",
    "multigrid",
    "atlas",
    "newton_atlas",
    "work_precision",
    "scaling",
    "kills",
    "validity",
    "motion",
    "contact",
    "self_contact",
    "sensitivities",
)


def main(words):
    """Run the chosen ones; 1 if one of them failed."""
    options = [word for word in words if word.startswith("--")]
    names = [word for word in words if word not in options] or NAMES
    unknown = set(names) - set(NAMES)
    if unknown:
        print(f"There is no benchmark {', '.join(unknown)}: choose from {', '.join(NAMES)}.")
        return 2
    failed = []
    for name in names:
        print(f"--- {name}", flush=True)
        start = time.perf_counter()
        done = subprocess.run([sys.executable, "-m", f"demos.benchmarks.{name}", *options])
        if done.returncode:
            failed.append(name)
        print(f"--- {name}: {time.perf_counter() - start:.0f} s", flush=True)
    print(f"Failed: {', '.join(failed)}." if failed else "All benchmarks ran.")
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
