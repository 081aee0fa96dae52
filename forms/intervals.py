# SPDX-License-Identifier: MIT
"""Scalar UFL expressions of a place and of Constants on arrays of intervals; local.

The value of every operation on intervals contains the values at all points in them, so that what is
positive there is positive everywhere between (Moore, *Interval Analysis*, 1966). Rounding is not
directed: bounds are right to a few digits less than those of a double.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray
from ufl.algorithms import expand_derivatives, strip_variables
from ufl.algorithms.expand_indices import expand_indices
from ufl.corealg.traversal import unique_post_traversal

from ._types import Expr

Array = NDArray[np.float64]
Interval = tuple[Array, Array]
c = ufl.classes

_RISING: dict[type, Callable[[Array], Array]] = {
    c.Exp: np.exp,
    c.Ln: np.log,
    c.Sqrt: np.sqrt,
    c.Atan: np.arctan,
    c.Asin: np.arcsin,
    c.Sinh: np.sinh,
    c.Tanh: np.tanh,
}
_LEAST = {c.Ln: 0.0, c.Sqrt: 0.0, c.Asin: -1.0, c.Acos: -1.0}
_MOST = {c.Asin: 1.0, c.Acos: 1.0}
_COMPARED = {c.LT: (0, 1, False), c.LE: (0, 1, True), c.GT: (1, 0, False), c.GE: (1, 0, True)}


class Intervals:
    """An expression compiled for intervals.

    Args:
        expression: UFL scalar of the components of a place, numbers and Constants.
        place: UFL vector that stands for the place, a terminal.
        what: What the expression is, for messages.

    Attributes:
        constants: The Constants in it.

    Raises:
        ValueError: it contains anything else, or a function that has no bounds here.
    """

    def __init__(self, expression: Expr, place: Expr, what: str) -> None:
        self._place = place
        # expand_indices takes all components of a variable for the one that it has met first.
        plain = strip_variables(expand_derivatives(ufl.as_ufl(expression)))
        self._root = expand_indices(plain)
        self._nodes = list(unique_post_traversal(self._root))
        self.constants: list[fem.Constant] = []
        for node in self._nodes:
            if isinstance(node, fem.Constant):
                self.constants.append(node)
            elif not _known(node, place):
                raise ValueError(
                    f"{what} is a function of the place x, of numbers and of Constants as the load "
                    f"factor, got {node} in it ({type(node).__name__})."
                )

    def __call__(self, low: Array, high: Array, moves: Mapping[Any, Any] | None = None) -> Interval:
        """Bounds of the expression over boxes.

        Args:
            low: Least coordinates of the places, shape (n, dim).
            high: Largest ones.
            moves: Least and largest values (each of shape (n,), or alike for all) of Constants; of
                the others the present values.

        Returns:
            Bounds, shape (n,) each.
        """
        found: dict[Expr, Any] = {}
        with np.errstate(all="ignore"):
            for node in self._nodes:
                found[node] = self._of(node, found, low, high, moves or {})
        a, b = found[self._root]
        shape = low.shape[:1]
        return np.broadcast_to(a, shape), np.broadcast_to(b, shape)

    def _of(self, node: Any, found: dict, low: Array, high: Array, moves: Mapping) -> Any:
        kind: Any = type(node)
        if isinstance(node, c.ScalarValue | c.Zero):
            value = np.float64(0.0 if isinstance(node, c.Zero) else float(node))
            return value, value
        if isinstance(node, fem.Constant):
            return moves.get(node, (np.asarray(node.value), np.asarray(node.value)))
        if node == self._place or isinstance(node, c.MultiIndex | c.Label):
            return None
        if isinstance(node, c.Indexed):
            operand, index = node.ufl_operands
            numbers = tuple(int(i) for i in index.indices())
            if operand == self._place:
                return low[:, numbers[0]], high[:, numbers[0]]
            return tuple(np.asarray(bound)[numbers] for bound in found[operand])
        parts: list[Any] = [found.get(o) for o in node.ufl_operands]
        if kind in _COMPARED:
            first, second, alike = _COMPARED[kind]
            (a, b), (d, e) = parts[first], parts[second]
            return (b <= d, a <= e) if alike else (b < d, a < e)
        return _whole(_operation(node, parts))


def _known(node: Expr, place: Expr) -> bool:
    """Whether an operation has bounds here."""
    kinds = (c.ScalarValue, c.Zero, c.MultiIndex, c.Indexed, c.Variable, c.Label, c.Conditional)
    more = (c.Sum, c.Product, c.Division, c.Power, c.Abs, c.MinValue, c.MaxValue, c.Atan2)
    logic = (c.AndCondition, c.OrCondition, c.NotCondition, c.EQ, c.NE)
    named = (c.Cos, c.Sin, c.Tan, c.Acos, c.Cosh)
    functions = (*_RISING, *_COMPARED)
    return node == place or isinstance(node, (*kinds, *more, *logic, *named, *functions))


def _whole(bounds: Any) -> Any:
    """Bounds without NaN, which stands for what may be anything."""
    low, high = bounds
    if np.asarray(low).dtype == bool:
        return bounds
    return np.where(np.isnan(low), -np.inf, low), np.where(np.isnan(high), np.inf, high)


def _operation(node: Expr, parts: list) -> Any:
    """Bounds of one operation from those of its operands."""
    kind = type(node)
    if kind is c.Variable:
        return parts[0]
    if kind is c.Conditional:
        (certain, possible), (a, b), (d, e) = parts
        hull = np.minimum(a, d), np.maximum(b, e)
        return tuple(
            np.where(certain, yes, np.where(possible, both, no))
            for yes, no, both in zip((a, b), (d, e), hull, strict=True)
        )
    if kind is c.NotCondition:
        return np.logical_not(parts[0][1]), np.logical_not(parts[0][0])
    a, b = parts[0]
    if kind in (c.Abs, c.Cosh):
        most = np.maximum(-a, b)
        least = np.maximum(np.maximum(a, -b), 0.0)
        return (least, most) if kind is c.Abs else (np.cosh(least), np.cosh(most))
    if kind in _RISING:
        least, most = _LEAST.get(kind, -np.inf), _MOST.get(kind, np.inf)
        return tuple(_RISING[kind](np.clip(bound, least, most)) for bound in (a, b))
    if kind is c.Acos:
        return np.arccos(np.clip(b, -1, 1)), np.arccos(np.clip(a, -1, 1))
    if kind in (c.Cos, c.Sin):
        return _cosine(a, b) if kind is c.Cos else _cosine(a - np.pi / 2, b - np.pi / 2)
    if kind is c.Tan:
        same = np.floor(a / np.pi + 0.5) == np.floor(b / np.pi + 0.5)
        return np.where(same, np.tan(a), -np.inf), np.where(same, np.tan(b), np.inf)
    d, e = parts[1]
    if kind is c.AndCondition:
        return a & d, b & e
    if kind is c.OrCondition:
        return a | d, b | e
    if kind in (c.EQ, c.NE):
        same, may = (a == b) & (d == e) & (a == d), (a <= e) & (d <= b)
        return (same, may) if kind is c.EQ else (~may, ~same)
    if kind is c.Sum:
        return a + d, b + e
    if kind is c.MinValue:
        return np.minimum(a, d), np.minimum(b, e)
    if kind is c.MaxValue:
        return np.maximum(a, d), np.maximum(b, e)
    if kind is c.Product:
        if node.ufl_operands[0] == node.ufl_operands[1]:
            return _power(a, b, 2)
        return _hull(a * d, a * e, b * d, b * e)
    if kind is c.Division:
        low, high = _hull(a / d, a / e, b / d, b / e)
        through = (d <= 0) & (e >= 0)
        return np.where(through, -np.inf, low), np.where(through, np.inf, high)
    if kind is c.Power:
        if np.all(d == e) and np.ptp(d) == 0 and float(np.max(d)).is_integer():
            return _power(a, b, int(np.max(d)))
        a, b = np.maximum(a, 0.0), np.maximum(b, 0.0)
        return _hull(a**d, a**e, b**d, b**e)
    assert kind is c.Atan2
    jumps = (d <= 0) & (a < 0) & (b >= 0)
    angles = _hull(*(np.arctan2(y, x) for y in (a, b) for x in (d, e)))
    return np.where(jumps, -np.pi, angles[0]), np.where(jumps, np.pi, angles[1])


def _hull(*corners: Array) -> Interval:
    low = high = corners[0]
    for corner in corners[1:]:
        low, high = np.minimum(low, corner), np.maximum(high, corner)
    return low, high


def _power(a: Array, b: Array, n: int) -> Interval:
    """Bounds of a whole power."""
    if n < 0:
        low, high = _power(a, b, -n)
        through = (low <= 0) & (high >= 0)
        return np.where(through, -np.inf, 1 / high), np.where(through, np.inf, 1 / low)
    if n % 2:
        return a**n, b**n
    least, most = np.maximum(np.maximum(a, -b), 0.0), np.maximum(-a, b)
    return least**n, most**n


def _cosine(a: Array, b: Array) -> Interval:
    """Bounds of the cosine: those of the ends, and 1 or -1 where one lies between."""
    turn = 2 * np.pi
    top = np.floor(b / turn) >= np.ceil(a / turn)
    bottom = np.floor((b - np.pi) / turn) >= np.ceil((a - np.pi) / turn)
    low, high = _hull(np.cos(a), np.cos(b))
    return np.where(bottom, -1.0, low), np.where(top, 1.0, high)
