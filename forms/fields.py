# SPDX-License-Identifier: MIT
"""UFL expressions as functions of discontinuous elements, for files, pictures and points."""

from __future__ import annotations

from typing import Any

from petsc4py import PETSc

import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from ufl.algorithms import extract_coefficients

from . import _checks, _dolfinx
from ._types import Expr
from .compilation import compiled
from .differentiation import update_dependents
from .native import jit
from .operators.evaluate import at_points
from .operators.jets import Jet


def field(expression: Expr, mesh: Any, degree: int = 1, name: str = "field") -> fem.Function:
    """An expression as a function of discontinuous Lagrange elements. Collective.

    By interpolation; where the expression lives at quadrature points only (as the thickness stretch
    of :func:`forms.plane_stress` does), by the L2 projection in each cell.

    Args:
        expression: UFL scalar, vector or tensor, as ``stress.cauchy(psi, F)``.
        mesh: Mesh, or an object with a ``mesh``.
        degree: Degree of the elements; 0 takes the value at the middle of a cell.
        name: Name for files and pictures.
    """
    mesh = _checks.mesh_of(mesh)
    f = fem.Function(discontinuous(mesh, degree, ufl.as_ufl(expression).ufl_shape), name=name)
    Evaluation(expression, f).update()
    return f


def discontinuous(mesh: Any, degree: int, shape: tuple[int, ...] = ()) -> fem.FunctionSpace:
    """Discontinuous Lagrange space of scalars, or of tensors of a shape."""
    element = ("Discontinuous Lagrange", degree)
    return fem.functionspace(mesh, (*element, shape) if shape else element)


def quadrature_degrees(expression: Expr) -> list[int]:
    """Degrees of the quadrature rules that coefficients of an expression live on."""
    found = []
    for c in extract_coefficients(ufl.as_ufl(expression)):
        if isinstance(c, Jet):
            found += quadrature_degrees(c.jets.packed)
        elif c.ufl_element().has_custom_quadrature:
            found.append(c.ufl_element().embedded_superdegree)
    return found


class Evaluation:
    """An expression compiled for being written into a function again and again.

    Args:
        expression: UFL expression of the function's shape.
        f: Function of discontinuous Lagrange elements.
    """

    def __init__(self, expression: Expr, f: fem.Function) -> None:
        self._f, self._source = f, ufl.as_ufl(expression)
        V = f.function_space
        degrees = quadrature_degrees(expression)
        self._projected = bool(degrees)
        if not self._projected:
            points = _dolfinx.interpolation_points(V)
            self._source = at_points(expression, V.mesh, points)
            self._expression = jit.expression(self._source, points, V.mesh)
            return
        dx = ufl.dx(domain=V.mesh, metadata={"quadrature_degree": max(degrees)})
        v, w = ufl.TestFunction(V), ufl.TrialFunction(V)
        self._mass = compiled(ufl.inner(w, v) * dx)
        self._moments = compiled(ufl.inner(expression, v) * dx)

    def update(self) -> None:
        """Evaluate the expression at present values. Collective."""
        update_dependents(self._source)
        if self._projected:
            self._project()
        else:
            self._f.interpolate(self._expression)
        self._f.x.scatter_forward()

    def _project(self) -> None:
        M, b = fem_petsc.create_matrix(self._mass), _dolfinx.create_vector(self._moments)
        # mypy sees the first of two overloads only.
        fem_petsc.assemble_matrix(M, self._mass)  # type: ignore[arg-type]
        M.assemble()
        fem_petsc.assemble_vector(b, self._moments)
        ksp = PETSc.KSP().create(self._f.function_space.mesh.comm)
        ksp.setOperators(M)
        ksp.setType("preonly")
        ksp.getPC().setType("lu")
        ksp.getPC().setFactorSolverType("mumps")
        ksp.solve(b, self._f.x.petsc_vec)
        for item in (ksp, M, b):
            item.destroy()
