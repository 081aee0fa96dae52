# SPDX-License-Identifier: MIT
"""Write the pages' tables and pictures: ``docker/enter python3 -m demos.pages``.

``--tables`` leaves the pictures as they are. What is written stands in forms/README.md,
meshes/README.md and tests/README.md between two marks each, and in demos/figures.
"""

import sys

from demos.benchmarks.record import insert

from . import bodies, energies, laws, responses

PAGES = {  # page, mark: what writes the lines
    ("forms/README.md", "energies"): energies.lines,
    ("meshes/README.md", "bodies"): bodies.lines,
    ("tests/README.md", "laws"): laws.lines,
}


def main(words):
    """Write all tables, and all pictures."""
    unknown = set(words) - {"--tables"}
    if unknown:
        print(f"There is no option {', '.join(sorted(unknown))}: --tables is the only one.")
        return 2
    for (page, mark), lines in PAGES.items():
        insert(mark, lines(), energies.ROOT / page)
        print(f"{page}: {mark}", flush=True)
    for part in () if words else (responses, bodies):
        for file in part.pictures():
            print(f"{file.relative_to(energies.ROOT)}: {file.stat().st_size / 1000:.0f} kB")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
