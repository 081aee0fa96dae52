# SPDX-License-Identifier: MIT
"""Default quadrature degrees, by what an integrand is made of: one rule wherever forms compile."""

from __future__ import annotations

from typing import Any

import ufl
from ufl.checks import is_cellwise_constant

from . import _dolfinx
from ._types import Expr
from .differentiation import Dependent, nodes

SIMPLICES = ("interval", "triangle", "tetrahedron")
_GRADIENTS = (
    ufl.classes.Grad,
    ufl.classes.Div,
    ufl.classes.Curl,
    ufl.classes.NablaGrad,
    ufl.classes.NablaDiv,
)
_PENDING = (ufl.classes.CoefficientDerivative, ufl.classes.CoordinateDerivative)


def with_quadrature(form: ufl.Form, degree: int | None = None) -> ufl.Form:
    """The form with a quadrature degree on every integral that has none.

    Integrals written with ``ufl.dx`` also get the subdomains of those beside them that were written
    with ``body.dx("name")``: DOLFINx wants them alike.

    Args:
        form: Any form; of a potential before it is differentiated, so that residual and tangent
            get its degree.
        degree: Degree k of the displacements; by default that of the functions whose gradients
            the form contains. Without any, it is no energy, and UFL's estimate is used.
    """
    if not isinstance(form, ufl.Form):
        return form
    k = _gradient_degree(form) if degree is None else degree
    integrals: list[Any] = []
    subdomains = {
        i.integral_type(): i.subdomain_data() for i in form.integrals() if i.subdomain_data()
    }
    for integral in form.integrals():
        metadata = dict(integral.metadata())
        if k:
            metadata.setdefault("quadrature_degree", quadrature_degree(integral, k))
        data = integral.subdomain_data() or subdomains.get(integral.integral_type())
        integrals.append(integral.reconstruct(metadata=metadata, subdomain_data=data))
    return ufl.Form(integrals)


def default_degree(kind: str, k: int) -> int:
    """Quadrature degree for functions of degree k: 2 k in cells, max(2 k, 3 k - 1) on facets."""
    return 2 * k if kind == "cell" else max(2 * k, 3 * k - 1)


def is_straight(domain: Any) -> bool:
    """Whether a mesh is of straight-sided simplices, where derivatives of places are constant."""
    return (
        _dolfinx.cell_name(domain.ufl_cell()) in SIMPLICES
        and domain.ufl_coordinate_element().embedded_superdegree == 1
    )


def quadrature_degree(integral: Any, k: int) -> int:
    """Default degree for one integral of a form of displacements of degree k.

    2 k in cells and max(2 k, 3 k - 1) on facets. In straight-sided simplices the energy of a
    gradient takes less: 2 m, m the largest degree of a function, or of a gradient, in the
    integrand, at least 1. For psi(grad u) with constant parameters m = k - 1: one point for k = 1,
    where the gradient is constant, and the order of convergence stays that of exact integration
    (Ciarlet, The Finite Element Method for Elliptic Problems, section 4.1).
    """
    kind = integral.integral_type()
    most = default_degree(kind, k)
    domain = integral.ufl_domain()
    if kind != "cell" or not is_straight(domain):
        return most
    return min(most, max(1, 2 * _degree(integral.integrand(), k, {})))


def _degree(e: Expr, k: int, known: dict[Expr, int]) -> int:
    """Largest degree of the functions, and of the gradients of functions, in an expression."""
    if e in known:
        return known[e]
    if isinstance(e, _PENDING):
        found = k  # what it will contain is not seen yet
    elif isinstance(e, _GRADIENTS):
        found = max(0, _degree(e.ufl_operands[0], k, known) - 1)
    elif not e._ufl_is_terminal_:
        found = max((_degree(o, k, known) for o in e.ufl_operands), default=0)
    elif (operand := _operand(e)) is not None:
        found = _degree(operand, k, known)
    elif isinstance(e, Dependent):
        found = k
    elif isinstance(e, (ufl.classes.Coefficient, ufl.classes.Argument)):
        found = e.ufl_element().embedded_superdegree
    else:
        found = 0 if is_cellwise_constant(e) else 1
    known[e] = found
    return found


def _gradient_degree(e: ufl.Form | Expr) -> int:
    """Largest degree of the functions whose gradients are inside; 0 where there are none."""
    found = 0
    for node in nodes(e):
        if (operand := _operand(node)) is not None:
            found = max(found, _gradient_degree(operand))
        elif isinstance(node, _GRADIENTS):
            degrees = [c.ufl_element().embedded_superdegree for c in _functions(node)]
            found = max([found, *degrees])
    return found


def _operand(e: Expr) -> Expr | None:
    """What an energy in singular values, or a derivative of one, is computed from."""
    return getattr(getattr(e, "jets", None), "packed", None) if e._ufl_is_terminal_ else None


def _functions(e: Expr) -> list[Any]:
    kinds = (ufl.classes.Coefficient, ufl.classes.Argument)
    return [node for node in nodes(e) if isinstance(node, kinds)]
