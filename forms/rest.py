# SPDX-License-Identifier: MIT
"""Forms of a body at rest, written on the shape that it is moved to: inverse elastostatics.

On the shape x = X + u that is known, u a function of x, so that f = dX/dx = I - grad u:

    F = f^-1,  Grad v = grad v f^-1,  dX = det f dx,  N dA = det f f^-T n da.

On a surface in space, x = x(xi) and J = dx/dxi, what stands for f^-1 is J J0^+ with J0 = f J and
J0^+ = (J0^T J0)^-1 J0^T. A force at a point of the body, or on a piece of a line, is the same.

Elements on x, carried to X, are elements there with the same points of integration, so that the
equations are those of the body at rest, to the last digit.
Source: Govindjee, Mihalic, Comput. Methods Appl. Mech. Engrg. 136 (1996) 47-57.
"""

from __future__ import annotations

from typing import Any

import ufl
from dolfinx import fem
from ufl.algorithms import expand_derivatives
from ufl.algorithms.map_integrands import map_integrand_dags
from ufl.corealg.map_dag import map_expr_dag
from ufl.corealg.multifunction import MultiFunction

from . import _dolfinx
from ._types import Expr
from .condensation import ThicknessStretch
from .differentiation import contains, expanded
from .operators.jets import Jet, Jets
from .points import Representer
from .unknowns import Field


def on_given_shape(form: ufl.Form, field: Field) -> ufl.Form:
    """A form of the body at rest as one over the shape that its displacement leads to.

    Args:
        form: Form in which the mesh stands for the body at rest.
        field: Its displacement; in the form returned a function of the known places.

    Raises:
        ValueError: integrals between cells or over the rim of a surface, second gradients, or
            geometry that this is not known of.
    """
    form = expand_derivatives(expanded(form))
    mapped = _Given(form.ufl_domain(), field)
    form = map_integrand_dags(mapped, form)
    integrals = []
    for integral in form.integrals():
        kind, integrand = integral.integral_type(), integral.integrand()
        if kind not in ("cell", "exterior_facet"):
            raise ValueError(
                f"unload knows integrals over cells and exterior facets, got one of type {kind}."
            )
        if kind != "cell" and mapped.area is None:
            raise ValueError(
                "unload knows no loads on the rim of a surface: give them per area, or at points."
            )
        # The integrals of these are forces at points, whatever the volume of the cell.
        if not contains(integrand, Representer):
            integrand *= mapped.volume if kind == "cell" else mapped.area
        integrals.append(integral.reconstruct(integrand=integrand))
    return ufl.Form(integrals)


class _Given(MultiFunction):
    """Replace what depends on the places of points."""

    def __init__(self, domain: Any, field: Field) -> None:
        super().__init__()
        d = _dolfinx.geometric_dimension(domain)
        self._u = field.expression
        f = ufl.Identity(d) - expand_derivatives(ufl.grad(self._u))
        J = ufl.Jacobian(domain)
        self._jacobian, self.area = f * J, None
        if _dolfinx.topological_dimension(domain) == d:
            self._inverse, self.volume = ufl.inv(f), ufl.det(f)
            self._normal = self._inverse.T * ufl.FacetNormal(domain)
            self.area = self.volume * ufl.sqrt(ufl.inner(self._normal, self._normal))
        else:
            metric = self._jacobian.T * self._jacobian
            self._inverse = J * ufl.inv(metric) * self._jacobian.T
            self.volume = ufl.sqrt(ufl.det(metric) / ufl.det(J.T * J))
        self._jets: dict[Jets, Jets] = {}
        self._stretches: dict[ThicknessStretch, ThicknessStretch] = {}

    def expr(self, o: Expr, *operands: Expr) -> Expr:
        return self.reuse_if_untouched(o, *operands)

    def terminal(self, o: Expr) -> Expr:
        return o

    def grad(self, o: Expr) -> Expr:
        (f,) = o.ufl_operands
        if not f._ufl_is_terminal_:
            raise ValueError("unload knows first gradients only, got a gradient of a gradient.")
        head, (k, j) = ufl.indices(len(f.ufl_shape)), ufl.indices(2)
        return ufl.as_tensor(o[(*head, k)] * self._inverse[k, j], (*head, j))

    def spatial_coordinate(self, o: Expr) -> Expr:
        return o - self._u

    def jacobian(self, o: Expr) -> Expr:
        return self._jacobian

    def facet_normal(self, o: Expr) -> Expr:
        return self._normal / ufl.sqrt(ufl.inner(self._normal, self._normal))

    def geometric_quantity(self, o: Expr) -> Expr:
        raise ValueError(f"unload does not know {o} of the body at rest: write it as a Function.")

    def coefficient(self, o: Expr) -> Expr:
        if isinstance(o, Jet):
            jets = o.jets
            if jets not in self._jets:
                packed = [map_expr_dag(self, expand_derivatives(e)) for e in jets.packed]
                self._jets[jets] = Jets(tuple(packed), jets.kind)
            return self._jets[jets][o.level]
        if isinstance(o, ThicknessStretch):
            if o not in self._stretches:
                ThicknessStretch(o.function_space, lambda new: self._condensed(o, new))
            return self._stretches[o]
        return o

    def _condensed(self, o: ThicknessStretch, new: ThicknessStretch) -> tuple[Expr, ...]:
        """What a thickness stretch is written with, of the one that takes its place."""
        self._stretches[o] = new
        return tuple(map_expr_dag(self, expand_derivatives(e)) for e in o.written)


def nodes_of(u: fem.Function, field: Field) -> Any:
    """Values of a displacement at the nodes of the mesh, shape of its coordinates; local.

    Raises:
        ValueError: the displacement is of another degree than the mesh.
    """
    mesh = u.function_space.mesh
    order = _dolfinx.geometry_degree(mesh)
    if field.degree != order:
        raise ValueError(
            f"unload finds a rest shape that the mesh can have: with displacements of degree "
            f"{field.degree} make the mesh of order {field.degree}, got one of order {order}."
        )
    element = mesh.ufl_domain().ufl_coordinate_element()
    V = fem.functionspace(mesh, element)
    at = fem.Function(V)
    W, numbers = field.collapsed
    part = fem.Function(W)
    part.x.array[:] = u.x.array[numbers]
    at.interpolate(part)
    at.x.scatter_forward()
    moved = 0.0 * mesh.geometry.x
    table = _dolfinx.geometry_dofmap(mesh)
    dim = mesh.geometry.dim
    moved[table, :dim] = at.x.array.reshape(-1, dim)[V.dofmap.list]
    return moved
