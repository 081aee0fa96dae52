# SPDX-License-Identifier: MIT
"""Deformation gradients of solids, plane and axisymmetric bodies, strains and invariants.

Every deformation gradient is 3x3, whatever the dimension of the mesh, so that one energy serves all
of them; it is a ``ufl.variable``, so that ``ufl.diff(psi, F)`` is the stress.
Equation numbers are those of document 003 (see forms/README.md).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import ufl

from . import _dolfinx
from ._checks import direction, vector
from ._types import Expr
from .differentiation import nodes


def deformation_gradient(u: Expr) -> Expr:
    """Deformation gradient of a solid, or of a plane body in plane strain.

    F = I + grad u  (1), (2);  plane strain: F = [[I + grad u, 0], [0, 1]]

    Args:
        u: Displacement [m], shape (3,) on a 3D mesh or (2,) on a plane one.

    Returns:
        F, shape (3, 3), a ``ufl.variable``.

    Raises:
        ValueError: u is no vector of two or three components.
    """
    dim = _dimension(u, "deformation_gradient")
    if dim == 3:
        return ufl.variable(ufl.Identity(3) + ufl.grad(u))
    return _embed(u, 1)


def axisymmetric(u: Expr) -> Expr:
    """Deformation gradient of a body of revolution about the axis r = 0, without twist.

    F = [[1 + u_r,r, u_r,z, 0], [u_z,r, 1 + u_z,z, 0], [0, 0, 1 + u_r / r]];  u_r,r at r = 0

    Integrate over the meridian plane with the weight :func:`circumference`, 2 pi r.

    Args:
        u: Displacement (u_r, u_z) [m] on a plane mesh of coordinates (r, z), r >= 0.

    Returns:
        F in the axes (r, z, hoop), shape (3, 3), a ``ufl.variable``.

    Raises:
        ValueError: u has not two components.
    """
    if _dimension(u, "axisymmetric") != 2:
        raise ValueError(f"axisymmetric needs u = (u_r, u_z), got shape {u.ufl_shape}.")
    r = ufl.SpatialCoordinate(ufl.domain.extract_unique_domain(u))[0]
    # Quadrature points lie inside cells, but fields are evaluated at nodes on the axis, too.
    hoop = ufl.conditional(ufl.gt(r, 0), u[0] / r, ufl.grad(u)[0, 0])
    return _embed(u, 1 + hoop, Revolved())


class Revolved(ufl.classes.Label):
    """Label of the deformation gradient of a body of revolution, by which it is known again."""


def is_axisymmetric(F: Expr) -> bool:
    """Whether an expression is an F of :func:`axisymmetric` itself."""
    return isinstance(F, ufl.classes.Variable) and isinstance(F.label(), Revolved)


def is_revolved(form: Any) -> bool:
    """Whether a deformation gradient of :func:`axisymmetric` is anywhere in a form."""
    labels = (n.label() for n in nodes(form) if isinstance(n, ufl.classes.Variable))
    return any(isinstance(label, Revolved) for label in labels)


def circumference(u: Expr) -> Expr:
    """Length of the circle through a point of the meridian plane, 2 pi r [m].

    ``psi * circumference(u) * dx`` is the energy [J] of the whole body of revolution.
    """
    return 2 * np.pi * ufl.SpatialCoordinate(ufl.domain.extract_unique_domain(u))[0]


def plane_stress_incompressible(u: Expr) -> Expr:
    """Deformation gradient of an incompressible sheet in plane stress.

    F = [[I + grad u, 0], [0, 1 / det(I + grad u)]], so that det F = 1 and no pressure is needed.

    Args:
        u: In-plane displacement [m], shape (2,).

    Returns:
        F, shape (3, 3), a ``ufl.variable``; energies are per reference volume, integrate over the
        plane times the thickness. For compressible energies see :func:`forms.plane_stress`.

    Raises:
        ValueError: u has not two components.
    """
    if _dimension(u, "plane_stress_incompressible") != 2:
        raise ValueError(
            f"plane_stress_incompressible needs a plane displacement, got shape {u.ufl_shape}."
        )
    return _embed(u, 1 / ufl.det(ufl.Identity(2) + ufl.grad(u)))


def right_cauchy_green(F: Expr) -> Expr:
    """Right Cauchy-Green tensor C = F^T F (3)."""
    k, G = _factored(F)
    return k * (G.T * G)


def left_cauchy_green(F: Expr) -> Expr:
    """Left Cauchy-Green tensor b = F F^T (4)."""
    return F * F.T


def volume_ratio(F: Expr) -> Expr:
    """Volume ratio J = det F = dv / dV."""
    return ufl.det(F)


def isochoric(F: Expr) -> Expr:
    """Volume-preserving part J^(-1/3) F of a 3x3 deformation gradient; NaN where J < 0.

    Its strains and invariants by this module, and :func:`isochoric_invariants`, have the power of J
    outside, as J^(-2/3) (F^T F). With it in each entry, as ``ufl.inner`` of this tensor has it, a
    tangent takes up to six times as long to compile, and up to four times as long to run.
    """
    return ufl.det(F) ** (-1 / 3) * F


def isochoric_invariants(F: Expr) -> tuple[Expr, Expr]:
    """Invariants of the isochoric C-bar = J^(-2/3) F^T F, for energies psi(I1, I2) of rubber.

    I1 = tr C-bar = J^(-2/3) F : F
    I2 = ((tr C-bar)^2 - C-bar : C-bar) / 2 = J^(-4/3) cof F : cof F,  cof F = J F^-T

    I2 is the classical second invariant, not the II of :func:`invariants`. Both are 3 at rest and
    larger elsewhere; NaN where J < 0.

    Args:
        F: Deformation gradient, shape (3, 3), not its isochoric part.
    """
    k, cofactors = ufl.det(F) ** (-2 / 3), ufl.cofac(F)
    # Squares of cofactors do not cancel, as I1^2 and C : C do under large stretches.
    return k * ufl.inner(F, F), k**2 * ufl.inner(cofactors, cofactors)


def green_strain(F: Expr) -> Expr:
    """Green (Lagrangian) strain E = 1/2 (C - I) (5)."""
    return (right_cauchy_green(F) - ufl.Identity(3)) / 2


def almansi_strain(F: Expr) -> Expr:
    """Almansi (Eulerian) strain e = 1/2 (I - b^-1) (5)."""
    return (ufl.Identity(3) - ufl.inv(left_cauchy_green(F))) / 2


def spatial_product(F: Expr, dX1: Expr, dX2: Expr) -> Expr:
    """Product dx1 . dx2 = dX1 . C dX2 of two deformed line elements (3), from the material ones."""
    return ufl.dot(F * dX1, F * dX2)


def material_product(F: Expr, dx1: Expr, dx2: Expr) -> Expr:
    """Product dX1 . dX2 = dx1 . b^-1 dx2 of two material line elements (4), from the deformed."""
    return ufl.dot(dx1, ufl.inv(left_cauchy_green(F)) * dx2)


def invariants(F: Expr) -> tuple[Expr, Expr, Expr]:
    """Invariants of C as document 003 defines them (13).

    I = tr C,  II = C : C,  III = det C = J^2.

    II is not the classical second invariant, which is (I^2 - II) / 2: for that of rubber see
    :func:`isochoric_invariants`.
    """
    k, G = _factored(F)
    C = G.T * G
    return k * ufl.tr(C), k**2 * ufl.inner(C, C), ufl.det(F) ** 2


def deformed_fiber(F: Expr, A: Expr) -> Expr:
    """Deformed fiber a = F A; |a| is its stretch when A is a unit vector."""
    return F * vector(A, (3,), "a fiber")


def fiber_invariants(F: Expr, A: Expr) -> tuple[Expr, Expr]:
    """Pseudo-invariants of C for the fiber A (22): IV = A . C A = a . a,  V = A . C^2 A.

    Args:
        F: Deformation gradient, shape (3, 3).
        A: Unit fiber direction in the reference body, shape (3,).

    Raises:
        ValueError: A is no vector of three components (also on a plane mesh), or one of numbers
            whose length is not 1.
    """
    k, G = _factored(F)
    a = deformed_fiber(G, direction(A, "a fiber"))
    Ca = G.T * a
    return k * ufl.dot(a, a), k**2 * ufl.dot(Ca, Ca)


def _factored(F: Expr) -> tuple[Expr, Expr]:
    """Factor k and G of F^T F = k G^T G: J^(-2/3) and F for ``isochoric(F)``, 1 and F for others.

    The isochoric part is known by its form, and not by a ``ufl.variable``: one could be
    differentiated by, which would give 0 where only its F is left.
    """
    if isinstance(F, ufl.classes.ComponentTensor):
        entry, indices = F.ufl_operands
        for factor in entry.ufl_operands if isinstance(entry, ufl.classes.Product) else ():
            if isinstance(factor, ufl.classes.Indexed) and factor.ufl_operands[1] == indices:
                G = factor.ufl_operands[0]
                if G.ufl_shape == (3, 3) and ufl.det(G) ** (-1 / 3) in entry.ufl_operands:
                    return ufl.det(G) ** (-2 / 3), G
    return 1, F


def _dimension(u: Expr, name: str) -> int:
    """Number of components of a displacement, after checking it against the mesh."""
    if u.ufl_shape not in ((2,), (3,)):
        raise ValueError(
            f"{name} needs a displacement with 2 or 3 components, got shape {u.ufl_shape}."
        )
    dim = u.ufl_shape[0]
    domain = ufl.domain.extract_unique_domain(u)
    mesh_dim = _dolfinx.geometric_dimension(domain)
    if _dolfinx.topological_dimension(domain) != mesh_dim:
        raise ValueError(
            f"{name} needs a body that fills its space, got cells of dimension "
            f"{_dolfinx.topological_dimension(domain)} in {mesh_dim} dimensions: for a "
            "surface in space use forms.membrane_gradient."
        )
    if dim != mesh_dim:
        raise ValueError(
            f"{name} needs {mesh_dim} components on this mesh, got {dim}; "
            "for a mixed unknown w pass the u of u, p = ufl.split(w)."
        )
    return dim


def _embed(u: Expr, F33: Expr, label: Expr | None = None) -> Expr:
    G = ufl.grad(u)
    F = ufl.as_matrix([[1 + G[0, 0], G[0, 1], 0], [G[1, 0], 1 + G[1, 1], 0], [0, 0, F33]])
    return ufl.classes.Variable(F, label)
