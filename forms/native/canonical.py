# SPDX-License-Identifier: MIT
"""Forms and expressions as every process writes them, so that each is compiled once, ever.

The name of what FFCx compiles is a digest of its text. Two running numbers stand in that text: the
label of a ``ufl.variable``, and, where operands of a sum or product are sorted by their names as
words, those of Constants ("10" before "9"). Without variables, and with Constants numbered from 0,
the text is the same however many objects the process has made before.
"""

from __future__ import annotations

import ufl
from ufl.algorithms import expand_derivatives
from ufl.algorithms.analysis import extract_constants
from ufl.algorithms.map_integrands import map_integrand_dags
from ufl.corealg.map_dag import map_expr_dag
from ufl.corealg.multifunction import MultiFunction
from ufl.corealg.traversal import unique_pre_traversal

from .._types import Expr

_PENDING = (
    ufl.classes.CoefficientDerivative,
    ufl.classes.VariableDerivative,
    ufl.classes.CoordinateDerivative,
)


def canonical(integrand: Expr) -> Expr:
    """A form or expression, equal to the given one, whose text contains no running number; local.

    Its Constants stand for the given ones, in their order, and have their values; coefficients and
    arguments are the given ones, as far as they are still in it.
    """
    if _contains(integrand, _PENDING):
        integrand = expand_derivatives(integrand)
    return _mapped(_Canonical(extract_constants(integrand)), integrand)


def without_variables(expression: Expr) -> Expr:
    """An expression with its variables replaced by what they stand for; local."""
    return _mapped(_WithoutVariables(), expression)


class _WithoutVariables(MultiFunction):
    def expr(self, o: Expr, *operands: Expr) -> Expr:
        return self.reuse_if_untouched(o, *operands)

    def terminal(self, o: Expr) -> Expr:
        return o

    def variable(self, o: Expr, operand: Expr, label: Expr) -> Expr:
        return operand


class _Canonical(_WithoutVariables):
    """Operands are sorted anew wherever something below them is replaced."""

    def __init__(self, constants: list[Expr]) -> None:
        super().__init__()
        self._numbered = {c: _Numbered(c, k) for k, c in enumerate(constants)}

    def constant(self, o: Expr) -> Expr:
        return self._numbered[o]


class _Numbered(ufl.Constant):
    """A Constant under another number, with the same value."""

    def __init__(self, constant: Expr, number: int) -> None:
        super().__init__(constant.ufl_domain(), constant.ufl_shape, count=number)
        if hasattr(constant, "_cpp_object"):  # UFL's own have none
            self._cpp_object = constant._cpp_object


def _contains(integrand: Expr, kinds: tuple[type, ...]) -> bool:
    whole = isinstance(integrand, ufl.Form)
    parts = [i.integrand() for i in integrand.integrals()] if whole else [integrand]
    return any(isinstance(e, kinds) for part in parts for e in unique_pre_traversal(part))


def _mapped(function: MultiFunction, integrand: Expr) -> Expr:
    if isinstance(integrand, ufl.Form):
        return map_integrand_dags(function, integrand)
    return map_expr_dag(function, integrand)
