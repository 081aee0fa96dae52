# SPDX-License-Identifier: MIT
"""What becomes of the numbers: lines on the screen, the page, the comparison with stored ones."""

import json
from pathlib import Path

from demos.benchmarks.record import insert, machine, markdown

from .cases import CASES

HERE = Path(__file__).resolve().parent
PAGE = HERE / "README.md"
COLUMNS = ("number", "found", "reference", "error", "tolerance")
WIDTH, LARGEST = 600, 100_000  # pixels, and bytes of a picture that is kept


def row(case, key, value):
    """Name, value, reference, error and tolerance of one number, as text."""
    known = case.known.get(key)
    if known is None:
        return key, f"{value:.8g}", "", "", ""
    unit = f" {known.unit}" if known.unit else ""
    error = f"{value - known.reference:+.2g}"
    return key, f"{value:.8g}{unit}", f"{known.reference:.8g}", error, f"{known.tolerance:.2g}"


def shrink(source, target):
    """A picture in small: at most 600 pixels wide and 100 kB, with fewer colors if need be."""
    from PIL import Image

    target.parent.mkdir(exist_ok=True)
    with Image.open(source) as picture:
        small = picture.convert("RGB")
    wide = WIDTH
    while wide > 100:
        size = (wide, round(small.height * wide / small.width))
        smaller = small.resize(size, Image.Resampling.LANCZOS)
        for version in (smaller, smaller.quantize(256)):
            version.save(target, optimize=True)
            if target.stat().st_size <= LARGEST:
                return
        wide = round(0.9 * wide)


def write(output, numbers):
    """Renew ``numbers.json`` and the tables of the page, of the cases that were run."""
    stored = HERE / "numbers.json"
    kept = json.loads(stored.read_text()) if stored.exists() else {}
    kept |= numbers
    kept = {name: kept[name] for name in CASES if name in kept}
    stored.write_text(json.dumps(kept, indent=1) + "\n")
    for name in numbers:
        insert(name, _section(name, json.loads((output / f"{name}.json").read_text())), PAGE)
    about = machine()
    line = f"Last run on {about['processor']}, DOLFINx {about['fenics-dolfinx']}, {about['date']}."
    insert("machine", [line], PAGE)


def _section(name, found):
    """Lines of the page about one case."""
    case = CASES[name]
    lines = [f"### {name}: {case.title}", "", f"Source: {case.source}."]
    lines += [case.text] if case.text else []
    ranks = f" on {found['ranks']} ranks" if found["ranks"] > 1 else ""
    lines += [f"{found['seconds']:.0f} s{ranks}.", ""]
    lines += markdown(COLUMNS, [row(case, *item) for item in found["numbers"].items()])
    return [*lines, "", f"![{case.title}](figures/{name}.png)"]


def compare(found, stored, rtol, names=()):
    """Print the numbers of two files that differ; 1 if any does, 2 if a file cannot be read."""
    try:
        ours, theirs = (json.loads(Path(file).read_text()) for file in (found, stored))
    except (OSError, ValueError) as error:
        print(f"Cannot compare: {error}. Run `python3 -m demos.validation` first, or name a file.")
        return 2
    ours, theirs = (_flat(numbers, names) for numbers in (ours, theirs))
    count = 0
    for key in dict.fromkeys([*theirs, *ours]):
        a, b = ours.get(key), theirs.get(key)
        if a is None or b is None:
            print(f"{key}: only in {stored if a is None else found}")
        elif not abs(a - b) <= rtol * max(abs(a), abs(b)):
            print(f"{key}: {a!r} here, {b!r} there, relative difference {_relative(a, b):.1e}")
        else:
            continue
        count += 1
    same = len(set(ours) | set(theirs)) - count
    print(f"{same} numbers agree to {rtol:g}, {count} do not.")
    return int(count > 0)


def _flat(numbers, names):
    chosen = [name for name in numbers if not names or name in names]
    return {f"{name}: {key}": float(v) for name in chosen for key, v in numbers[name].items()}


def _relative(a, b):
    return abs(a - b) / max(abs(a), abs(b))
