# SPDX-License-Identifier: MIT
"""Which integrals of a tangent have moduli at the points, and these in UFL."""

from __future__ import annotations

from typing import Any

import basix
import basix.ufl
import ufl
from ufl.algorithms import expand_derivatives

from . import _dolfinx
from ._types import Expr
from .batches import is_over_cells
from .differentiation import expanded, nodes
from .entities import with_owned_entities
from .quadrature import is_straight, with_quadrature

MOST_NODES = 64  # of a cell: the matrices of several lie on the stack


def split(tangent: ufl.Form) -> tuple[dict[tuple[int, int], list[Any]], list[Any]]:
    """Integrals of a tangent, expanded: those with moduli, and those without.

    The former by whether they are of gradients (1) or values (0), and by quadrature degree.
    """
    form = with_quadrature(with_owned_entities(expand_derivatives(expanded(tangent))))
    groups: dict[tuple[int, int], list[Any]] = {}
    rest: list[Any] = []
    fits = _is_one_vector(tangent)
    for integral in form.integrals():
        derivatives = _derivatives(integral) if fits and is_over_cells(integral) else None
        if derivatives is None:
            rest.append(integral)
        else:
            kind = derivatives, integral.metadata()["quadrature_degree"]
            groups.setdefault(kind, []).append(integral)
    return dict(sorted(groups.items())), rest


def _is_one_vector(tangent: ufl.Form) -> bool:
    """Whether both arguments are those of one vector of Lagrange elements."""
    V, other = (a.ufl_function_space() for a in tangent.arguments())
    element = V.ufl_element()
    return bool(
        V == other
        and V.dofmap.bs == element.block_size > 1
        and element.reference_value_shape == (element.block_size,)
        and element.family_name == "P"
        and not V.element.needs_dof_transformations
        and V.dofmap.list.shape[1] <= MOST_NODES
    )


def _derivatives(integral: Any) -> int | None:
    """1 where an integral contains its arguments in gradients only, 0 for values; else None."""
    gradient, argument = ufl.classes.Grad, ufl.classes.Argument
    pairs = [(e, o) for e in nodes(integral.integrand()) for o in e.ufl_operands]
    second = any(isinstance(e, gradient) and isinstance(o, gradient) for e, o in pairs)
    kinds = {int(isinstance(e, gradient)) for e, o in pairs if isinstance(o, argument)}
    return kinds.pop() if len(kinds) == 1 and not second else None


def is_shared(integrals: list[Any], domain: Any) -> bool:
    """Whether all that moduli depend on is constant in each cell, as a density often is."""
    if not is_straight(domain):
        return False
    kinds = ufl.classes.Coefficient, ufl.classes.GeometricQuantity
    given = [e for i in integrals for e in nodes(i.integrand()) if isinstance(e, kinds)]
    return all(e.is_cellwise_constant() for e in given)


def of_degree(integral: Any, degree: int) -> Any:
    """The integral by a rule of another degree."""
    return integral.reconstruct(metadata={**integral.metadata(), "quadrature_degree": degree})


def moduli_of(integral: Any, tangent: ufl.Form, derivatives: int) -> Expr:
    """Upper triangle of the moduli, without the weights and the volume, as a vector."""
    test, trial = tangent.arguments()
    inverse = ufl.JacobianInverse(tangent.ufl_domain())
    size, dim = test.ufl_shape[0], inverse.ufl_shape[0] if derivatives else 1

    def unit(row: int) -> Expr:
        """Gradient of a field whose gradient on the reference cell is 1 in one component."""
        a, A = divmod(row, dim)
        if not derivatives:
            return ufl.as_vector([int(c == a) for c in range(size)])
        columns = range(inverse.ufl_shape[1])
        return ufl.as_tensor(
            [[inverse[A, i] if c == a else 0 for i in columns] for c in range(size)]
        )

    if derivatives:
        test, trial = ufl.grad(test), ufl.grad(trial)
    given, rows = integral.integrand(), range(size * dim)
    columns = [ufl.replace(given, {trial: unit(c)}) for c in rows]
    return ufl.as_vector(
        [ufl.replace(columns[c], {test: unit(r)}) for r in rows for c in rows if c >= r]
    )


def form_of_moduli(
    integrals: list[Any], tangent: ufl.Form, derivatives: int, degree: int
) -> ufl.Form:
    """Moduli as a form: linear in values at the points of a rule, by whose kernels FFCx gives them.

    Args:
        integrals: Those of one kind and rule, of :func:`split`.
        tangent: Form that they are of.
        derivatives: 1 of integrals of gradients, 0 of values.
        degree: Of the rule.
    """
    V, domain = tangent.arguments()[0].ufl_function_space(), tangent.ufl_domain()
    cell = getattr(basix.CellType, _dolfinx.cell_name(domain.ufl_cell()))
    rows = V.dofmap.bs * (V.mesh.topology.dim if derivatives else 1)
    element = basix.ufl.quadrature_element(cell, degree=degree)
    values = basix.ufl.blocked_element(element, shape=(rows * (rows + 1) // 2,))
    test = ufl.TestFunction(ufl.FunctionSpace(domain, values))
    made = [ufl.inner(moduli_of(i, tangent, derivatives), test) for i in integrals]
    pairs = zip(integrals, made, strict=True)
    return ufl.Form([i.reconstruct(integrand=m) for i, m in pairs])
