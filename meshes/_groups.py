# SPDX-License-Identifier: MIT
"""Names of sets that may overlap, as tags of which each cell or facet carries one."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

__all__ = ["Tag", "check_held", "encode", "merge_copies", "row_keys"]

# What Body.regions and Body.boundaries hold: one tag, or those of the parts that overlap others.
Tag = int | tuple[int, ...]


def row_keys(rows: NDArray[np.integer]) -> NDArray[np.int64]:
    """One number per row, the same for two rows if and only if they hold the same numbers.

    Rows of numbers >= 0 in any order, shape (n, k); much faster than np.unique(axis=0).
    """
    rows = rows.astype(np.int32)
    rows.sort(axis=1)
    if not len(rows):
        return np.empty(0, np.int64)
    size = int(rows.max()) + 1
    keys, bound = rows[:, 0].astype(np.int64), size
    for column in rows.T[1:]:
        if bound * size >= 2**63:
            _, keys = np.unique(keys, return_inverse=True)
            keys, bound = keys.ravel(), len(rows)
        keys *= size  # in place: rank 0 holds the keys of all cells
        keys += column
        bound *= size
    return keys


def merge_copies(
    keys: NDArray[np.int64], sets: Mapping[str, NDArray[np.int64]]
) -> tuple[NDArray[np.int64], dict[str, NDArray[np.int64]], int]:
    """Make one of the copies of a cell (facet) that bear different names, as gmsh writes them.

    Args:
        keys: The same number for copies.
        sets: Indices of each name's members.

    Returns:
        Index of the first copy of each, ascending; the names' members among these; and the number
        of copies that bear no other name than one before.
    """
    ascending = np.sort(keys)
    if not (ascending[1:] == ascending[:-1]).any():
        return np.arange(len(keys)), dict(sets), 0
    _, first, which = np.unique(keys, return_index=True, return_inverse=True)
    place = np.empty(len(first), dtype=np.int64)
    place[np.argsort(first)] = np.arange(len(first))
    which = place[which.ravel()]
    copies, names = np.bincount(which), np.zeros(len(first), dtype=np.int64)
    surplus, merged = 0, {}
    for name, members in sets.items():
        merged[name] = np.unique(which[members])
        surplus += len(members) - len(merged[name])
        names[merged[name]] += 1
    surplus += int(np.maximum(copies - np.maximum(names, 1), 0).sum()) if not surplus else 0
    return np.sort(first), merged, surplus


def encode(
    number: int,
    groups: Mapping[str, NDArray[np.int64]],
    tags: Mapping[str, int],
    rest: str | None = None,
) -> tuple[NDArray[np.int32], dict[str, Tag]]:
    """Tag the members of named groups, each combination of names with a tag of its own.

    Args:
        number: How many cells or facets there are.
        groups: Indices of each name's members; names may overlap.
        tags: Tag of each name's members that bear no other name.
        rest: Name of the members of no group; None: they get the tag -1, and no name.

    Returns:
        Tag of each cell or facet, and the tags of each name: one number unless it overlaps others.
    """
    combinations: list[tuple[str, ...]] = [()]
    codes = np.zeros(number, dtype=np.int64)
    for name, members in groups.items():
        held = codes[members]
        for code in np.unique(held):
            codes[members[held == code]] = len(combinations)
            combinations.append((*combinations[code], name))
    present = np.unique(codes)
    free = max(0, *tags.values()) + 1 if tags else 1
    tag_of = np.full(len(combinations), -1, dtype=np.int32)
    names: dict[str, list[int]] = {name: [] for name in groups}
    for code in present:
        combination = combinations[code] or ((rest,) if rest else ())
        if not combination:
            continue
        if len(combinations[code]) == 1:
            tag = tags[combination[0]]
        else:
            tag, free = free, free + 1
        tag_of[code] = tag
        for name in combination:
            names.setdefault(name, []).append(tag)
    found: dict[str, Tag] = {}
    for name, those in names.items():
        found[name] = (those or [tags[name]])[0] if len(those) < 2 else tuple(sorted(those))
    return tag_of[codes], found


def check_held(source: str, kind: str, tags: NDArray[np.int32], names: Mapping[str, Tag]) -> None:
    """Raise ValueError for a name that no cell (facet) bears."""
    present = {int(tag) for tag in np.unique(tags)}
    what = {"region": "cell", "boundary": "facet"}[kind]
    for name, tag in names.items():
        if present.isdisjoint(tag if isinstance(tag, tuple) else (tag,)):
            raise ValueError(
                f"{source}: the {kind} '{name}' holds no {what} of the mesh: give the name to "
                "others, or remove it."
            )
