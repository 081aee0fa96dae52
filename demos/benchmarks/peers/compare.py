# SPDX-License-Identifier: MIT
"""Displacements against the reference, medians, tables and chart of the rows of all codes."""

import argparse
import json
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from ..record import Table, insert, markdown, save
from .codes import REFERENCE, SECOND, VANILLA
from .points import states

AGREES = 1e-6
PAGE = Path(__file__).resolve().parent / "README.md"
LOOP, RESIDUAL, TANGENT = "solve loop [s]", "residual, once [s]", "tangent, once [s]"


def merged(rows, folder):
    """One row per code, mesh and number of steps: medians of its turns, and how far it is off."""
    groups = {}
    for row in rows:
        if row["what"] == "path":
            at = row["degree"], row["m"], row["steps"]
            groups.setdefault((row["name"], *at), []).append(row)
    result = []
    for (_, *at), turns in groups.items():
        row = dict(turns[-1])
        errors = [turn["error"] for turn in turns if "error" in turn]
        if errors:
            row["error"] = errors[0]
        else:
            for name in row:
                if name.endswith("[s]"):
                    row[name] = float(np.median([turn[name] for turn in turns]))
            row["off by"] = distance(row, groups.get((REFERENCE.name, *at)), folder)
            row["agrees"] = row["off by"] <= AGREES and row["residual"] <= row["tolerance"]
        result.append(row | {"runs": len(turns)})
    return result


def distance(row, reference, folder):
    """Largest difference of displacements over the largest displacement; infinite if unknown."""
    if not reference or "file" not in reference[0]:
        return np.inf
    u, right = (np.load(folder / r["folder"] / r["file"]) for r in (row, reference[0]))
    off = float(np.abs(u - right).max() / np.abs(right).max())
    return off if np.isfinite(off) else np.inf


def cell(row, vanilla):
    """Seconds, and in brackets their ratio to vanilla's; or why they do not count."""
    if row is None:
        return ""
    if "error" in row:
        return "failed"
    if not row["agrees"]:
        return f"**off by {row['off by']:.0e}, residual {row['residual']:.0e}**"
    text = f"{row[LOOP]:.3g}"
    if vanilla and vanilla.get("agrees"):
        text += f" ({row[LOOP] / vanilla[LOOP]:.2g})"
    return text


def path_tables(rows):
    """Columns and lines of B1: the whole path, and its first step."""
    for steps in sorted({row["steps"] for row in rows}, reverse=True):
        chosen = [row for row in rows if row["steps"] == steps]
        sizes = list(dict.fromkeys((row["degree"], row["size"]) for row in chosen))
        known = {(row["name"], row["degree"], row["size"]): row for row in chosen}
        first = {row["name"]: row.get(LOOP, np.inf) for row in reversed(chosen)}
        names = [n for n in sorted(first, key=first.get) if n not in (REFERENCE.name, SECOND.name)]
        lines = []
        for name in names:
            own = [known.get((name, *at)) for at in sizes]
            cells = [
                cell(row, known.get((VANILLA.name, *at)))
                for row, at in zip(own, sizes, strict=True)
            ]
            good = [row for row in own if row and "error" not in row]
            newton = ", ".join(str(sum(row["Newton"])) for row in good)
            off = max((row["off by"] for row in good), default=np.inf)
            memory = ", ".join(f"{row['peak [MB]']:.0f}" for row in good)
            lines.append([name, *cells, newton, f"{off:.0e}", memory])
        heads = [f"P{degree} {size}" for degree, size in sizes]
        what = "three steps" if steps == 3 else "first step"
        yield markdown([what, *heads, "Newton iterations", "off by at most", "MB"], lines)


def assembly_table(rows):
    """Columns and lines of B2."""
    rows = [row for row in rows if row["what"] == "assembly"]
    sizes = list(dict.fromkeys((row["degree"], row["size"]) for row in rows))
    known = {(row["name"], row["degree"], row["size"]): row for row in rows}
    heads = [
        f"P{degree} {size}: {part}"
        for degree, size in sizes
        for part in ("residual, ms", "tangent, ms", "ratio")
    ]
    lines = []
    for name in dict.fromkeys(row["name"] for row in rows):
        cells = []
        for at in sizes:
            row, vanilla = known[name, *at], known.get(("DOLFINx", *at), {})
            if "error" in row:
                cells += ["failed", "", ""]
                continue
            parts = [row[RESIDUAL], row[TANGENT]]
            both = [vanilla.get(RESIDUAL, np.nan), vanilla.get(TANGENT, np.nan)]
            cells += [f"{1e3 * part:.3g}" for part in parts] + [f"{sum(parts) / sum(both):.2g}"]
        lines.append([name, *cells])
    return markdown(["one assembly", *heads], lines)


def points_table(rows):
    """Columns and lines of B3: a line per way."""
    rows = [row for row in rows if row["what"] == "points" and "way" in row]
    lines = []
    for row in rows:
        words = [row[name].split(" / ") for name in states()]
        cells = [a if a == b else f"{a} / {b}" for a, b in words]
        cells = [text.replace("wrong", "**wrong**") for text in cells]
        lines.append([row["way"], *cells, f"{row['points per second'] / 1e3:.0f}"])
    return markdown(["stress / tangent", *states(), "thousand points/s"], lines)


def picture(rows):
    """CPU seconds of every code that agrees, P1 and P2: whole path at 10k, first step larger."""
    rows = [r for r in rows if r.get("agrees") and r["name"] not in (REFERENCE.name, SECOND.name)]
    first = min(rows, key=lambda r: r["m"] if r["degree"] == 1 else np.inf)["size"]
    inner = {r["name"]: r[LOOP] for r in rows if r["size"] == first and r["degree"] == 1}
    names = sorted({r["name"] for r in rows}, key=lambda n: -inner.get(n, np.inf))
    figure = Figure((10, 1.5 + 0.28 * len(names)), 150, layout="constrained")
    for axes, degree in zip(figure.subplots(1, 2, sharex=True, sharey=True), (1, 2), strict=True):
        own = [r for r in rows if r["degree"] == degree]
        kinds = list(dict.fromkeys((r["size"], r["steps"]) for r in own))
        for n, (size, steps) in enumerate(kinds):
            chosen = [r for r in own if (r["size"], r["steps"]) == (size, steps)]
            label = f"{size}, {'first step' if steps == 1 else f'{steps} steps'}"
            axes.plot(
                [r[LOOP] for r in chosen],
                [names.index(r["name"]) for r in chosen],
                "osD^v"[n % 5],
                color=f"C{n}",
                fillstyle="none" if steps == 1 else "full",
                label=label,
            )
        axes.set(title=f"P{degree}", xlabel="CPU seconds of the solve loop", xscale="log")
        axes.xaxis.set_major_formatter("{x:g}")
        axes.set_yticks(range(len(names)), names)
        axes.grid(alpha=0.3)
        axes.legend(fontsize="small")
    save(figure, "peers")


def main():
    """Compare, print and write."""
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("--write", action="store_true")
    given = parser.parse_args()
    lines = (given.folder / "rows.jsonl").read_text().splitlines()
    rows = [json.loads(line) for line in lines]
    paths = merged(rows, given.folder)
    table = Table("peers")
    table.rows = [*paths, *(row for row in rows if row["what"] in ("assembly", "points"))]
    table.write()
    second = [row for row in paths if row["name"] == SECOND.name]
    for row in second:
        print(f"reference against DOLFINx to rounding, P{row['degree']}: {row['off by']:.1e}")
    tables = {"peers, path": [], "peers, assembly": assembly_table(rows)}
    for part in path_tables(paths):
        tables["peers, path"] += ["", *part] if tables["peers, path"] else part
    tables["peers, points"] = points_table(rows)
    for mark, part in tables.items():
        print("\n".join(part), "\n")
        if given.write:
            insert(mark, part, PAGE)
    picture(paths)


if __name__ == "__main__":
    main()
