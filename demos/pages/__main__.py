# SPDX-License-Identifier: MIT
"""Write the pages' tables and pictures: ``docker/enter python3 -m demos.pages``.

``--tables`` leaves the pictures as they are; ``--demos`` runs every demo twice before, for their
times and pictures, and once more for the surfaces that the site turns; ``--demos=swing,jump`` some
of them. What is written stands in forms/README.md, forms/solving/README.md, meshes/README.md,
tests/README.md and demos/README.md between two marks each, and in demos/figures.
"""

import sys

from demos.benchmarks.record import insert

from . import bodies, energies, gallery, ladder, laws, responses

PAGES = {  # page, mark: what writes the lines
    ("forms/README.md", "energies"): energies.lines,
    ("meshes/README.md", "bodies"): bodies.lines,
    ("forms/solving/README.md", "ladder"): ladder.lines,
    ("tests/README.md", "laws"): laws.lines,
    ("demos/README.md", "demos"): gallery.table,
    ("demos/README.md", "gallery"): gallery.gallery,
}


def main(words):
    """Write all tables, and all pictures."""
    asked = [word for word in words if word.startswith("--demos")]
    unknown = {word for word in words if word != "--tables"} - set(asked)
    if unknown:
        print(f"There is no option {', '.join(sorted(unknown))}: --tables and --demos are all.")
        return 2
    if asked:
        gallery.run([name for name in asked[0].partition("=")[2].split(",") if name])
    for (page, mark), lines in PAGES.items():
        insert(mark, lines(), energies.ROOT / page)
        print(f"{page}: {mark}", flush=True)
    for part in () if "--tables" in words else (responses, bodies):
        for file in part.pictures():
            print(f"{file.relative_to(energies.ROOT)}: {file.stat().st_size / 1000:.0f} kB")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
