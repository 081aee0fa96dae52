# SPDX-License-Identifier: MIT
"""Potential -> residual -> tangent by Gateaux derivatives.

``residual(potential, u)`` is R[v] = d/dh potential(u + h v) at h = 0, ``tangent(residual, u)`` is
K[v, du] = d/dh R[v](u + h du). By hand: :mod:`forms.by_hand`.
"""

from __future__ import annotations

from typing import Any

import ufl
from dolfinx import fem

from ._checks import arity as check_arity
from ._types import Expr
from .differentiation import dependents, expanded, rate
from .loads import with_kinematics
from .operators.jets import Jet
from .unknowns import Field, field_of


def derivative(form: ufl.Form, u: fem.Function, du: Expr) -> ufl.Form:
    """Gateaux derivative of a form at u in direction du.

    D form(u)[du] = d/dh form(u + h du) at h = 0

    Args:
        form: Functional or linear form of u.
        u: Unknown: scalar, vector or mixed.
        du: Argument or function of the same space.

    Energies in singular values and coefficients that depend on u
    (:class:`~forms.differentiation.Dependent`) are differentiated through: the derivative is then
    taken in several coefficients at once, each in its own direction.
    """
    for c in dependents(expanded(form)):
        if isinstance(c, Jet):
            c.jets.check_parameters(u)
    return rate(form, u, du)


def residual(potential: ufl.Form, u: Any) -> ufl.Form:
    """Residual R[v] = D potential(u)[v], a linear form in a new test function v.

    Args:
        potential: Functional of the unknown.
        u: Unknown, or a field of it, as ``w["u"]``: then v's other fields have no part in R, as
            where the equations of those are virtual works of their own.

    Raises:
        ValueError: potential is no functional, or does not depend on u.
    """
    w, field = field_of(u, "residual")
    _check(potential, w, 0, "residual needs a potential (a functional of u)")
    (potential,) = with_kinematics(potential)
    v = ufl.TestFunction(w.function_space)
    if u is not w:
        v = _only(v, field)
    return derivative(potential, w, v)


def _only(v: Expr, field: Field) -> Expr:
    """A test function of a mixed space with 0 for all fields but one."""
    first = sum(max(1, field.space.sub(k).num_sub_spaces) for k in range(field.place or 0))
    own = range(first, first + field.components)
    return ufl.as_vector([v[k] if k in own else ufl.as_ufl(0) for k in range(len(v))])


def tangent(R: ufl.Form, u: fem.Function) -> ufl.Form:
    """Tangent K[v, du] = D R[v](u)[du], a bilinear form in a new trial function du.

    Raises:
        ValueError: R is no linear form, or does not depend on u.
    """
    _check(R, u, 1, "tangent needs a residual (a form linear in one test function)")
    return derivative(R, u, ufl.TrialFunction(u.function_space))


def _check(form: ufl.Form, u: fem.Function, arity: int, need: str) -> None:
    if not isinstance(form, ufl.Form):
        raise ValueError(f"{need}, got {type(form).__name__}; integrate a density with ufl.dx.")
    check_arity(form, arity, need)
    if u not in form.coefficients():
        raise ValueError(
            f"{need}, got a form that does not contain {u}: was it written with another Function?"
        )
