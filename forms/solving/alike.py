# SPDX-License-Identifier: MIT
"""Which of several functionals, or scalars, are no different from others, and are refused."""

from __future__ import annotations

from collections.abc import Sequence

from petsc4py import PETSc

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]
REGULAR = 1e-12  # smallest singular value, over the largest, of a system that can be solved


def dependent(schur: Values) -> list[int]:
    """Numbers of the rows of a Schur complement that follow from one another; empty if none do.

    Rows and columns are brought to one size first: each has a unit of its own.
    """
    even = schur
    for axis in (1, 0):
        size = np.abs(even).max(axis=axis, keepdims=True)
        even = even / np.where(size > 0, size, 1.0)
    if not np.all(np.isfinite(even)):
        return [*range(len(even))]
    left, sizes, _ = np.linalg.svd(even)
    return [] if sizes[-1] > REGULAR * sizes[0] else _parts(left[:, -1])


def refuse_alike(
    vectors: Sequence[PETSc.Vec], plain: NDArray[np.bool_], name: str, does: str
) -> None:
    """Refuse vectors that are 0 or follow from one another, among those marked. Collective.

    Args:
        vectors: Derivatives of the functionals by u, or of the residual by each q.
        plain: Which of them tell all of it.
        name: What each is of, for messages.
        does: What it is to do, for messages.

    Raises:
        ValueError: they do not differ.
    """
    numbers, norms = np.flatnonzero(plain), np.array([v.norm() for v in vectors])
    for n in numbers:
        if norms[n] == 0:
            raise ValueError(
                f"control needs each {name} to {does}, got number {n + 1} that does not at the "
                "start: give another, or start elsewhere."
            )
    gram = [[vectors[i].dot(vectors[j]) / (norms[i] * norms[j]) for j in numbers] for i in numbers]
    if len(numbers) > 1:
        sizes, combinations = np.linalg.eigh(np.array(gram))
        if not sizes[0] > REGULAR:
            alike = counted([numbers[n] for n in _parts(combinations[:, 0])])
            raise ValueError(
                f"control needs each {name} to {does} in its own way, got numbers {alike} that do "
                "so alike at the start: leave one out, or give another."
            )


def _parts(combination: Values) -> list[int]:
    """Entries of a unit vector that count."""
    return [int(n) for n in np.flatnonzero(np.abs(combination) > 0.05)]


def counted(numbers: Sequence[int]) -> str:
    """Numbers in words, from 1 on."""
    return " and ".join(str(n + 1) for n in numbers)
