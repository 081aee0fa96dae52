# SPDX-License-Identifier: MIT
"""Where stress and tangent of energies in singular values are right: a map for each way.

F = U diag(s) V^T with |s1 - s2| from 1 down to 1e-16 and 0 across, and |s2 + s3| (near flat and
inverted states; Hencky's energy, which has none: |s2 - s3|) upwards; in each place one F with
U = V = I and two with random rotations, of which the worst counts. Ways: automatic differentiation
by UFL of closed-form eigenvalues of C (plain, with an epsilon, with the discriminant as a sum of
squares), NumPy's SVD with naive and with clamped quotients, central differences, and the kernels
of variform. Errors are relative to 110-digit arithmetic at the same rounded F. Where the energy is
not smooth there is no right value at s2 + s3 = 0: there only finite numbers are asked for. Run
``docker/enter python3 -m demos.benchmarks.atlas`` (``--small``: a coarse map of one energy, without
the way that takes long to compile); one JSON line per row, ``results/atlas.csv``, the maps in
``results/atlas_map.csv``, ``results/atlas.png`` and ``.svg``; ``--write`` puts the tables into
README.md. One process only.
"""

import sys

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize, to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from variform.forms.formulas import svd_derivatives

from .record import Table, insert, markdown, save
from .ways import CASES, WAYS, errors, exact

RIGHT, WRONG = 1e-10, 1e-6
EPS = np.finfo(float).eps
LIMIT = "F rounded once more"
QUANTITIES = "P", "dP/dF"
SHADES = ScalarMappable(Normalize(-16, 0), "viridis")
BAD, VOID, EDGE = "red", "lightgray", "magenta"


def states(levels, inverted):
    """F of shape (second axis, first axis, 3, 3, 3), three for each pair of distances."""
    rng = np.random.default_rng(0)
    first, second = np.meshgrid(levels, levels)
    middle = 0.75 if inverted else 1.25
    last = second - middle if inverted else middle - second
    s = np.stack([middle + first, np.full_like(first, middle), last], -1)[:, :, None]
    U, _, V = svd_derivatives.signed_svd(rng.normal(size=(*first.shape, 3, 3, 3)))
    U[:, :, 0] = V[:, :, 0] = np.eye(3)
    return svd_derivatives.compose(U, s, V)


def measured(name, levels, ways):
    """Rows of one energy, each with its map of errors: NaN where nothing is right."""
    case = CASES[name]
    F = states(levels, case.inverted)
    places, F = F.shape[:3], F.reshape(-1, 3, 3)
    right = [np.stack(values) for values in zip(*(exact(case, f) for f in F), strict=True)]
    nudge = 1 + EPS * np.random.default_rng(1).choice([-1, 1], F.shape)
    rounded = [np.stack(v) for v in zip(*(exact(case, f) for f in F * nudge), strict=True)]
    blank = np.zeros(places[:2], bool)
    blank[levels == 0] = case.inverted and not case.smooth
    for way in (*ways, LIMIT):
        with np.errstate(all="ignore"):
            results = rounded if way == LIMIT else list(WAYS[way](case, F, right))
        for quantity, found, value in zip(QUANTITIES, results, right, strict=True):
            finite = np.isfinite(found).all(tuple(range(1, found.ndim))).reshape(places)
            error = errors(found, value).reshape(places)
            if way == LIMIT:  # rounding may lead to a state without a value
                finite, error = np.ones(places, bool), np.where(finite, error, 1.0)
            error = np.where(finite, error, np.inf).max(-1)
            error[blank] = np.where(finite.all(-1), np.nan, np.inf)[blank]
            row = {"way": way, "energy": name, "quantity": quantity}
            row |= summary(error, blank, levels)
            if blank.any() and found.ndim == 5 and way != LIMIT:
                row["largest without a value"] = largest(found.reshape(*places, 9, 9)[blank])
            yield row, error


def largest(tangents):
    """Largest stiffness of any tangent, None if one is not finite."""
    finite = np.isfinite(tangents).all()
    return float(np.linalg.norm(tangents, 2, axis=(-2, -1)).max()) if finite else None


def summary(error, blank, levels):
    """Shares of the map and where it fails."""
    known = error[~blank]
    wrong = (error > WRONG) & ~blank
    # Where the other distance is 1, so that its own trouble does not count.
    failing = levels[wrong[-1]], levels[wrong[:, -1]]
    first, second = (float(f"{x.max():.1g}") if x.size else None for x in failing)
    finite = known[np.isfinite(known)]
    return {
        "right": round(float(np.mean(known <= RIGHT)), 4),
        "wrong": round(float(np.mean(known > WRONG)), 4),
        "not finite": round(float(np.mean(~np.isfinite(known))), 4),
        "worst": float(f"{finite.max():.2g}") if finite.size else None,
        "wrong for first <=": first,
        "wrong for second <=": second,
    }


# Picture, tables


def picture(maps, levels):
    """Panels: a column for each way, two rows for each energy."""
    names = list(dict.fromkeys(name for _, name, _ in maps))
    ways = [way for way in dict.fromkeys(way for way, _, _ in maps) if way != LIMIT]
    rows = [(name, quantity) for name in names for quantity in QUANTITIES]
    figure = Figure((1.75 * len(ways) + 2.0, 1.7 * len(rows) + 1.4), 100, layout="constrained")
    panels = figure.subplots(len(rows), len(ways), sharex=True, sharey=True, squeeze=False)
    for line, (name, quantity) in zip(panels, rows, strict=True):
        for axes, way in zip(line, ways, strict=True):
            panel(axes, maps[way, name, quantity], maps[LIMIT, name, quantity])
        line[0].set_ylabel(f"{name}, {quantity}\n{CASES[name].other}")
    for axes, way in zip(panels[0], ways, strict=True):
        axes.set_title(way)
    marks = [k for k, x in enumerate(levels) if x == 0 or round(np.log10(x), 6) in (-12, -6, 0)]
    labels = ["0" if levels[k] == 0 else f"$10^{{{round(np.log10(levels[k]))}}}$" for k in marks]
    panels[0, 0].set_xticks(marks, labels)
    panels[0, 0].set_yticks(marks, labels)
    for axes in panels.flat:
        axes.label_outer(remove_inner_ticks=True)
    for axes in panels[-1]:
        axes.set_xlabel("|s1 - s2|")
    bar = figure.colorbar(SHADES, ax=panels, shrink=0.8, aspect=40, extend="both", pad=0.01)
    bar.set_label("log10 of the relative error")
    legend = [
        Patch(facecolor="gold", edgecolor="black", hatch="///", label="error above 1e-6"),
        Patch(facecolor=BAD, label="NaN or inf"),
        Patch(facecolor=VOID, label="no right value, but finite"),
        Line2D([], [], color=EDGE, linestyle="--", label="below: rounding of F alone makes 1e-6"),
    ]
    figure.legend(handles=legend, loc="outside lower center", ncols=4, frameon=False)
    save(figure, "atlas")


def panel(axes, error, limit):
    """One map of errors with its failing places marked."""
    with np.errstate(divide="ignore"):
        colors = SHADES.to_rgba(np.log10(np.maximum(error, 1e-17)))
    colors[np.isnan(error)] = to_rgba(VOID)
    colors[np.isposinf(error)] = to_rgba(BAD)
    axes.imshow(colors, origin="lower", interpolation="none", aspect="auto")
    wrong = np.nan_to_num(error, nan=0.0, posinf=0.0) > WRONG
    if wrong.any():
        # Contours join the middles of places: half a place is added around the map.
        middles = np.arange(-1, len(error) + 1)
        padded = np.pad(wrong, 1, mode="edge")
        axes.contourf(middles, middles, padded, [0.5, 1.5], colors="none", hatches=["///"])
        axes.set(xlim=(-0.5, len(error) - 0.5), ylim=(-0.5, len(error) - 0.5))
    below = np.flatnonzero((limit > WRONG).all(1))
    if below.size:
        axes.axhline(below.max() + 0.5, color=EDGE, linestyle="--", linewidth=1.2)


def tables(rows):
    """Share of the map that is right and the worst error; then where the tangent fails."""
    names = list(dict.fromkeys(row["energy"] for row in rows))
    found = {(row["way"], row["energy"], row["quantity"]): row for row in rows}
    ways = list(dict.fromkeys(row["way"] for row in rows))
    heads = [f"{name}: {quantity}" for name in names for quantity in QUANTITIES]
    shares, bounds = [], []
    for way in ways:
        chosen = [found[way, name, quantity] for name in names for quantity in QUANTITIES]
        shares.append([way, *(_share(row) for row in chosen)])
        bounds.append([way, *(_bounds(row, CASES[row["energy"]].other) for row in chosen[1::2])])
    return [
        *markdown(["right to 1e-10 (worst error)", *heads], shares),
        "",
        *markdown(["dP/dF is off by more than 1e-6", *names], bounds),
    ]


def _share(row):
    worst = "none finite" if row["worst"] is None else f"{row['worst']:.0e}"
    worst = "not finite" if row["not finite"] else worst
    return f"{100 * row['right']:.0f} % ({worst})"


def _bounds(row, other):
    # Without the bars, which would end a cell of the table.
    limits = (("s1 - s2", "wrong for first <="), (other.strip("|"), "wrong for second <="))
    words = [f"{label} ≤ {row[key]:.0e}" for label, key in limits if row[key] is not None]
    return f"{100 * row['wrong']:.0f} %" + (f": {', '.join(words)}" if words else "")


def main(small=False, write=False):
    """Measure, print and write the tables, the maps and the picture."""
    decades = np.arange(-16, 0.1, 4 if small else 0.5)
    levels = np.append(0, 10.0**decades)
    ways = [way for way in WAYS if not (small and way == "UFL, sum of squares")]
    measurements, places, maps = Table("atlas"), Table("atlas_map"), {}
    for name in ["fixed corotated"] if small else CASES:
        for row, error in measured(name, levels, ways):
            measurements.add(**row)
            key = row["way"], name, row["quantity"]
            maps[key] = error
            for k, n in np.ndindex(error.shape):
                numbers = levels[n], levels[k], error[k, n]
                short = (float(f"{x:.3g}") for x in numbers)
                columns = "way", "energy", "quantity", "|s1 - s2|", "other distance", "error"
                places.rows.append(dict(zip(columns, (*key, *short), strict=True)))
    measurements.write()
    places.write()
    picture(maps, levels)
    if write:
        insert("atlas", tables(measurements.rows))
    return measurements.rows


if __name__ == "__main__":
    main(small="--small" in sys.argv, write="--write" in sys.argv)
