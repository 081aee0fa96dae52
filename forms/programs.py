# SPDX-License-Identifier: MIT
"""Load programs: tables over the load factor, and where loads and supports have kinks in it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import ufl
from dolfinx import fem
from ufl.corealg.traversal import unique_pre_traversal

from ._types import Expr
from .problems import Problem

_BETWEEN = (ufl.classes.BinaryCondition, ufl.classes.MaxValue, ufl.classes.MinValue)


def table(t: Expr, times: Sequence[float], values: Sequence[float]) -> Expr:
    """Piecewise linear function of the load factor, constant before and behind the table.

    ``forms.table(t, [0, 1, 3], [0, 2, 2])`` rises to 2 while t goes to 1 and stays there until 3;
    :func:`forms.follow` has its steps end on 1.

    Args:
        t: Load factor, or any scalar expression.
        times: Where the values are, ascending, two at least.
        values: Numbers, as many.

    Raises:
        ValueError: times that do not ascend, or another number of values.
    """
    x, y = np.asarray(times, float), np.asarray(values, float)
    if x.ndim != 1 or len(x) < 2 or x.shape != y.shape or not np.all(np.diff(x) > 0):
        raise ValueError(
            "a table needs two or more ascending times and as many values, got times "
            f"{list(times)} and values {list(values)}."
        )
    if not np.all(np.isfinite(y)):
        raise ValueError(f"a table needs finite values, got {list(values)}.")
    result: Expr = ufl.as_ufl(float(y[-1]))
    slopes = np.diff(y) / np.diff(x)
    for n in reversed(range(len(slopes))):
        piece = float(y[n]) + float(slopes[n]) * (t - float(x[n]))
        result = ufl.conditional(ufl.lt(t, float(x[n + 1])), piece, result)
    return ufl.conditional(ufl.lt(t, float(x[0])), float(y[0]), result)


def kinks(problem: Problem, t: fem.Constant) -> list[float]:
    """Load factors at which loads or supports may have a kink, ascending.

    Where the factor itself is compared with a number: in :func:`table`, in a conditional, in
    ``max_value(t, 0.5)``.
    """
    found = set()
    for expression in _written(problem):
        for node in unique_pre_traversal(expression):
            if isinstance(node, _BETWEEN):
                found |= _compared(node.ufl_operands, t)
    return sorted(found)


def _compared(operands: Sequence[Expr], t: fem.Constant) -> set[float]:
    if not any(operand is t for operand in operands):
        return set()
    return {float(o) for o in operands if isinstance(o, ufl.classes.RealValue | ufl.classes.Zero)}


def _written(problem: Problem) -> Iterable[Expr]:
    """What the user wrote loads and supports with."""
    forms = [problem.forms.potential, problem.forms.virtual_work]
    for form in forms:
        if form is not None:
            yield from (integral.integrand() for integral in form.integrals())
    for support in problem.supports:
        for part in support.parts:
            if part.expression is not None:
                yield part.expression.ufl_expression
