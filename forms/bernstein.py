# SPDX-License-Identifier: MIT
"""Bernstein polynomials on simplices and cubes: tables from which the kernels bound a determinant.

On a simplex, B_a = n! / a! lambda^a of barycentric coordinates, |a| = n; on a cube, products of
those in one variable. A polynomial lies between the least and the largest of its coefficients;
those at corners are its values there. Coefficients times their multinomials ("scaled") convolve
where polynomials are multiplied: multi-indices add up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations, product
from math import comb, factorial, prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Lines = list[list[int]]


@dataclass(frozen=True)
class Bernstein:
    """A space of polynomials by its Bernstein basis.

    Attributes:
        simplex: On the unit simplex; else on the unit cube.
        degrees: Degree in each variable; on a simplex the total one, for each variable alike.
    """

    simplex: bool
    degrees: tuple[int, ...]

    @cached_property
    def indices(self) -> list[tuple[int, ...]]:
        """Multi-index of each coefficient; on a simplex the first entry belongs to the origin."""
        found = list(product(*(range(n + 1) for n in self.degrees)))
        if self.simplex:
            n = self.degrees[0]
            found = [(n - sum(a), *a) for a in found if sum(a) <= n]
        return found

    @cached_property
    def multinomials(self) -> Array:
        """Number that each coefficient is scaled by, shape (coefficients,)."""
        if self.simplex:
            n = self.degrees[0]
            found = [factorial(n) // prod(map(factorial, a)) for a in self.indices]
        else:
            found = [prod(map(comb, self.degrees, a)) for a in self.indices]
        return np.array(found, float)

    @cached_property
    def points(self) -> Array:
        """A lattice that determines the coefficients, shape (coefficients, dim)."""
        inside = 1 / (len(self.degrees) + 1) if self.simplex else 1 / 2
        columns = np.array(self.indices, float)[:, 1 if self.simplex else 0 :].T
        rows = [x / n if n else x + inside for x, n in zip(columns, self.degrees, strict=True)]
        return np.array(rows).T.copy()

    def values(self, x: Array) -> Array:
        """Basis at points, shape (points, coefficients)."""
        if self.simplex:
            x = np.column_stack([1 - x.sum(axis=1), x])
            powers = [np.prod(x**a, axis=1) for a in np.array(self.indices)]
        else:
            n = np.array(self.degrees)
            powers = [np.prod(x**a * (1 - x) ** (n - a), axis=1) for a in np.array(self.indices)]
        return np.array(powers).T * self.multinomials

    def coefficients(self, values: Array) -> Array:
        """Coefficients of polynomials whose values at ``points`` are given, (points, ...)."""
        found = np.linalg.solve(self.values(self.points), values)
        # Zeros as such: what vanishes on an axis of revolution has to, and sums are shorter.
        return np.where(np.abs(found) > 1e-12 * np.abs(found).max(), found, 0)

    @cached_property
    def corners(self) -> list[list[int]]:
        """For each corner the coefficient that is the value there, and the next on each edge."""
        place = {a: k for k, a in enumerate(self.indices)}
        whole = sum(self.degrees[:1]) if self.simplex else 0
        found = []
        for a in self.indices:
            if self.simplex and max(a) == whole:
                i = a.index(whole)
                steps = [(i, j) for j in range(len(a)) if j != i]
                beside = [_moved(a, {i: -1, j: 1} if whole else {}) for i, j in steps]
            elif not self.simplex and all(
                k in (0, n) for k, n in zip(a, self.degrees, strict=True)
            ):
                beside = [_moved(a, {k: -1 if a[k] else 1}) for k in range(len(a))]
                beside = [b if b in place else a for b in beside]
            else:
                continue
            found.append([place[b] for b in (a, *beside)])
        return found

    def times(self, other: Bernstein) -> tuple[Bernstein, NDArray[Any]]:
        """Space of products, and the coefficient there that two others add to, one by one."""
        degrees = tuple(map(int.__add__, self.degrees, other.degrees))
        space = Bernstein(self.simplex, degrees)
        place = {a: k for k, a in enumerate(space.indices)}
        sums = [[place[tuple(map(int.__add__, a, b))] for b in other.indices] for a in self.indices]
        return space, np.array(sums, np.int16)

    @cached_property
    def directions(self) -> list[tuple[tuple[int, int, int, int], Lines]]:
        """Ways to halve the cell, each with the lines of coefficients that it acts on.

        Along an edge of a simplex, between its two vertices and in all coordinates, or along an
        axis of a cube, between the lowest and highest corner in that coordinate.
        """
        dim, found = len(self.degrees), []
        if self.simplex:
            ways = [(i, j, 0, dim) for i, j in combinations(range(dim + 1), 2)]
        else:
            ways = [(0, 1, k, k + 1) for k in range(dim)]
        for way in ways:
            lines: dict[tuple[int, ...], list[tuple[int, int]]] = {}
            for number, a in enumerate(self.indices):
                i, j = way[:2] if self.simplex else (way[2], way[2])
                key = [n for k, n in enumerate(a) if k not in (i, j)]
                # On an edge a sum of both indices is kept, too; from its first vertex onwards.
                key += [a[i] + a[j]] if self.simplex else []
                lines.setdefault(tuple(key), []).append((a[j], number))
            found.append((way, [[k for _, k in sorted(line)] for line in lines.values()]))
        return found

    @property
    def vertices(self) -> Array:
        """Vertices of the simplex, or lowest and highest corner of the cube."""
        dim = len(self.degrees)
        if self.simplex:
            return np.vstack([np.zeros(dim), np.eye(dim)])
        return np.vstack([np.zeros(dim), np.ones(dim)])


def _moved(index: tuple[int, ...], steps: dict[int, int]) -> tuple[int, ...]:
    return tuple(n + steps.get(k, 0) for k, n in enumerate(index))


def derivative(space: Bernstein, k: int) -> Bernstein:
    """Space of the derivatives by variable k of a space's polynomials."""
    n = space.degrees
    if space.simplex:
        return Bernstein(True, tuple(i - 1 for i in n))
    return Bernstein(False, (*n[:k], n[k] - 1, *n[k + 1 :]))


def scaled(space: Bernstein, values: Array) -> Array:
    """Scaled coefficients of polynomials given by their values at the space's points."""
    return space.multinomials[:, None] * space.coefficients(values)


def sparse(rows: Sequence[Array]) -> tuple[NDArray[np.int32], NDArray[np.int32], Array]:
    """Where the entries of each row start, their columns, and they themselves."""
    found = [np.flatnonzero(row) for row in rows]
    starts = np.concatenate([[0], np.cumsum([len(f) for f in found])])
    entries = [row[f] for row, f in zip(rows, found, strict=True)]
    return starts.astype(np.int32), np.concatenate(found).astype(np.int32), np.concatenate(entries)
