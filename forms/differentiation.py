# SPDX-License-Identifier: MIT
"""Chain rule through what UFL cannot differentiate: coefficients and functions of the unknown.

A :class:`Dependent` coefficient knows its own derivative; a :class:`Pointwise` function is computed
outside UFL and stands in an expression until :func:`expanded` puts its coefficients there.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Protocol, runtime_checkable

import basix.ufl
import ufl
from ufl.algorithms import expand_derivatives, extract_coefficients
from ufl.algorithms.map_integrands import map_integrand_dags
from ufl.checks import is_cellwise_constant
from ufl.corealg.map_dag import map_expr_dag
from ufl.corealg.multifunction import MultiFunction
from ufl.corealg.traversal import unique_pre_traversal

from . import _dolfinx
from ._types import Expr


@runtime_checkable
class Dependent(Protocol):
    """A coefficient that is a function of the unknown and knows its own derivative.

    ``derivative`` differentiates through it: in direction du it moves by ``direction(u, du)``, u
    the unknown, or a Constant or Function that is a parameter. Before every assembly ``update()``
    brings its values up to date.
    """

    def direction(self, unknown: Any, du: Expr) -> Expr:
        """Change of the coefficient when the unknown, or a parameter, moves by du."""

    def update(self) -> None:
        """Recompute the coefficient from the unknown's present values; collective."""


class Pointwise(ufl.classes.MathFunction):
    """A scalar function of one packed UFL vector, evaluated point by point outside UFL.

    UFL treats it as an unknown function of its operand: it finds the coefficients inside, replaces
    them, and stops with a sentence where it would have to differentiate or compile it.
    """

    def __init__(self, operand: Expr) -> None:
        ufl.classes.Operator.__init__(self, (operand,))
        self._name = "psi_hat"

    def _ufl_expr_reconstruct_(self, operand: Expr) -> Pointwise:
        return type(self)(operand)

    def derivative(self) -> Expr:
        """Refuse UFL's own differentiation, which asks here for d psi_hat / d operand."""
        raise ValueError(
            "an energy in singular values is differentiated by forms.derivative, forms.residual, "
            "forms.tangent and forms.stress, not by ufl.derivative or ufl.diff."
        )

    @property
    def value(self) -> Expr:
        """Coefficient that stands for the function's value."""
        raise NotImplementedError


_PENDING = (
    ufl.classes.CoefficientDerivative,
    ufl.classes.VariableDerivative,
    ufl.classes.CoordinateDerivative,
)


class _Expansion(MultiFunction):
    """Replace pointwise functions, innermost first, by their values."""

    def expr(self, o: Expr, *operands: Expr) -> Expr:
        return self.reuse_if_untouched(o, *operands)

    def terminal(self, o: Expr) -> Expr:
        return o

    def math_function(self, o: Expr, operand: Expr) -> Expr:
        o = self.reuse_if_untouched(o, operand)
        return o.value if isinstance(o, Pointwise) else o


def nodes(expression: Expr) -> Iterator[Expr]:
    """All nodes of a form or expression."""
    if isinstance(expression, ufl.Form):
        for integral in expression.integrals():
            yield from unique_pre_traversal(integral.integrand())
    else:
        yield from unique_pre_traversal(ufl.as_ufl(expression))


def contains(expression: Expr, kinds: Any) -> bool:
    """Whether a form or expression has a node of one of the given classes."""
    return any(isinstance(e, kinds) for e in nodes(expression))


def _check_derivatives(expression: Expr) -> None:
    """Refuse derivatives that UFL would take for 0, as it knows nothing of the operand inside.

    The values and derivatives of operators are coefficients to UFL: constant in space, and
    independent of every unknown that a derivative does not list beside them.
    """
    for e in nodes(expression):
        if not isinstance(e, ufl.classes.Derivative):
            continue
        inside = [c for c in nodes(e.ufl_operands[0]) if isinstance(c, Dependent)]
        if isinstance(e, _PENDING):
            listed = e.ufl_operands[1].ufl_operands if isinstance(e, _PENDING[0]) else ()
            if any(c not in listed for c in inside):
                raise ValueError(
                    "a form or stress of an energy in singular values is differentiated by "
                    "forms.derivative, forms.tangent and forms.stress, not by ufl.derivative or "
                    "ufl.diff, which would take it for a constant."
                )
        elif any(hasattr(c, "slope") for c in inside) or contains(e.ufl_operands[0], Pointwise):
            raise ValueError(
                "an energy in singular values, and its stress, have no derivative in space: "
                "project them to a field first (forms.field)."
            )


def expanded(expression: Expr) -> Expr:
    """A form or expression with every pointwise function replaced by the coefficient of its value.

    Derivatives by UFL that wait inside are taken first, so that they meet the function, which
    refuses them, and not its coefficient, whose derivative they would take for 0.
    """
    _check_derivatives(expression)
    if not contains(expression, Pointwise):
        return expression
    if contains(expression, _PENDING):
        expression = expand_derivatives(expression)
    if isinstance(expression, ufl.Form):
        return map_integrand_dags(_Expansion(), expression)
    return map_expr_dag(_Expansion(), ufl.as_ufl(expression))


class _BranchesOutside(MultiFunction):
    """Move the branches of a base or radicand outside, where a derivative is one of each branch."""

    def expr(self, o: Expr, *operands: Expr) -> Expr:
        return self.reuse_if_untouched(o, *operands)

    def terminal(self, o: Expr) -> Expr:
        return o

    def power(self, o: Expr, base: Expr, exponent: Expr) -> Expr:
        whole = isinstance(exponent, ufl.classes.IntValue) and int(exponent) >= 0
        return self._outside(o, base, lambda x: x**exponent, plain=whole, rest=(exponent,))

    def sqrt(self, o: Expr, radicand: Expr) -> Expr:
        return self._outside(o, radicand, ufl.sqrt)

    def _outside(
        self, o: Expr, e: Expr, function: Any, plain: bool = False, rest: tuple[Expr, ...] = ()
    ) -> Expr:
        found = None if plain else _branches(e)
        if found is None:
            return self.reuse_if_untouched(o, e, *rest)
        condition, first, second = found
        return ufl.conditional(condition, function(first), function(second))


def _branches(e: Expr) -> tuple[Expr, Expr, Expr] | None:
    """Condition and branches of an expression that is one or the other; None if it is none.

    Where both are equal it is the constant one, whose derivatives are 0.
    """
    if not e.ufl_operands:
        return None
    a, *b = e.ufl_operands
    if isinstance(e, ufl.classes.MaxValue | ufl.classes.MinValue):
        is_a = ufl.gt if isinstance(e, ufl.classes.MaxValue) else ufl.lt
        first, second = (b[0], a) if is_cellwise_constant(a) else (a, b[0])
        return is_a(first, second), first, second
    if isinstance(e, ufl.classes.Conditional):
        return _strict(a, b[0], b[1]), b[0], b[1]
    if isinstance(e, ufl.classes.Abs):
        return ufl.gt(a, 0), a, -a
    if isinstance(e, ufl.classes.Sum) and (found := _branches(b[0])):
        return found[0], _sum(a, found[1]), _sum(a, found[2])
    if isinstance(e, ufl.classes.Sum) and (found := _branches(a)):
        return found[0], _sum(found[1], b[0]), _sum(found[2], b[0])
    if isinstance(e, ufl.classes.Product) and (found := _branches(b[0])):
        return found[0], a * found[1], a * found[2]
    if isinstance(e, ufl.classes.Product) and (found := _branches(a)):
        return found[0], found[1] * b[0], found[2] * b[0]
    if isinstance(e, ufl.classes.Division) and (found := _branches(a)):
        return found[0], found[1] / b[0], found[2] / b[0]
    if isinstance(e, ufl.classes.Power) and (found := _branches(a)):
        return found[0], found[1] ** b[0], found[2] ** b[0]
    return None


def _strict(condition: Expr, first: Expr, second: Expr) -> Expr:
    """X > y for x >= y where that chooses between x - y and 0, which are equal at x = y."""
    if isinstance(condition, ufl.classes.GE | ufl.classes.LE) and second == 0:
        x, y = condition.ufl_operands
        if isinstance(condition, ufl.classes.GE) and first in (x - y, -(y - x)):
            return ufl.gt(x, y)
        if isinstance(condition, ufl.classes.LE) and first in (y - x, -(x - y)):
            return ufl.lt(x, y)
    return condition


def _sum(a: Expr, b: Expr) -> Expr:
    """A + b, 0 where one is minus the other, as in x + |x| where x < 0."""
    return ufl.as_ufl(0) if a == -b or b == -a else a + b


def with_branches_outside(expression: Expr) -> Expr:
    """The same value, ``max_value(x, 0)**1.5`` as ``conditional(x > 0, x**1.5, 0)``.

    UFL differentiates the former to 0.75 max_value(x, 0)**-0.5 (x > 0 ? 1 : 0)^2, inf times 0 where
    x < 0, and the latter branch by branch. Bases of powers and radicands, times whatever factors.
    """
    kinds = ufl.classes
    switches = (kinds.MaxValue, kinds.MinValue, kinds.Conditional, kinds.Abs)
    if not contains(expression, switches) or not contains(
        expression, (ufl.classes.Power, ufl.classes.Sqrt)
    ):
        return expression
    if isinstance(expression, ufl.Form):
        return map_integrand_dags(_BranchesOutside(), expression)
    return map_expr_dag(_BranchesOutside(), ufl.as_ufl(expression))


def dependents(form: ufl.Form | Expr) -> list[Dependent]:
    """Coefficients of a form or expression that depend on the unknown, in their order."""
    return [c for c in extract_coefficients(form) if isinstance(c, Dependent)]


def update_dependents(integrand: ufl.Form | Expr) -> None:
    """Bring the coefficients of a form or an expression that depend on the unknown up to date."""
    for c in dependents(integrand):
        c.update()


def rate(expression: Expr, u: Any, du: Expr) -> Expr:
    """Gateaux derivative of an expression or form at u in direction du, through its dependents.

    With coefficients c_k of u in it, it is the derivative in (u, c_1, ..) in the directions
    (du, c_1'[du], ..). Derivative nodes inside are left for UFL to expand. u is a Function, or a
    Constant, for which a coefficient stands in.
    """
    expression = with_branches_outside(expanded(expression))
    chained = dependents(expression)
    # A derivative node inside a direction is not lowered, so expand it first.
    moved = [expand_derivatives(c.direction(u, du)) for c in chained]
    return partial(expression, (u, *chained), (du, *moved))


def partial(expression: Expr, at: tuple[Any, ...], directions: tuple[Expr, ...]) -> Expr:
    """Gateaux derivative in some coefficients at once; the first may be a Constant.

    What depends on the unknown, and is not among them, is held fixed.
    """
    if not isinstance(at[0], ufl.classes.Constant):
        return ufl.derivative(expression, at, directions)
    stand_in = _coefficient_like(at[0])
    seen = ufl.replace(expand_derivatives(expression), {at[0]: stand_in})
    found = ufl.derivative(seen, (stand_in, *at[1:]), directions)
    return ufl.replace(expand_derivatives(found), {stand_in: at[0]})


def _coefficient_like(c: Expr) -> ufl.Coefficient:
    """Coefficient of a Constant's shape, constant in each cell."""
    domain = ufl.domain.extract_unique_domain(c)
    element = basix.ufl.element(
        "DG", _dolfinx.cell_name(domain.ufl_cell()), 0, shape=c.ufl_shape or None
    )
    return ufl.Coefficient(ufl.FunctionSpace(domain, element))


def diff(expression: Expr, variable: Expr) -> Expr:
    """D expression / d variable, as ``ufl.diff``, also through pointwise functions of the variable.

    Args:
        expression: UFL expression of any shape.
        variable: A ``ufl.variable``, as the deformation gradient.

    Returns:
        Derivative, shape of the expression followed by that of the variable.
    """
    expression = with_branches_outside(expanded(expression))
    total = expand_derivatives(ufl.diff(expression, variable))
    for jet in [c for c in extract_coefficients(expression) if hasattr(c, "slope")]:
        stand_in = ufl.variable(jet)
        seen = ufl.replace(expand_derivatives(expression), {jet: stand_in})
        outer = expand_derivatives(ufl.diff(seen, stand_in))
        inner = jet.slope(variable)
        shape = len(jet.ufl_shape)
        head = ufl.indices(len(outer.ufl_shape) - shape)
        mid, tail = ufl.indices(shape), ufl.indices(len(variable.ufl_shape))
        product = _entry(outer, head + mid) * _entry(inner, mid + tail)
        total += ufl.as_tensor(product, head + tail) if head + tail else product
    return total


def _entry(tensor: Expr, indices: tuple) -> Expr:
    return tensor[indices] if indices else tensor
