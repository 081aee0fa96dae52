# SPDX-License-Identifier: MIT
"""Muscles: the energy mu |F A - R|^2 of an activated material."""

from __future__ import annotations

import numpy as np
import ufl
from numpy.typing import ArrayLike

from .._types import Expr
from ..operators.energy import SingularValueEnergy
from .moduli import check_moduli
from .stretches import as_rigid_as_possible

_improper = SingularValueEnergy(
    lambda s1, s2, s3, mu: mu * ((s1 - 1) ** 2 + (s2 - 1) ** 2 + (s3 - 1) ** 2),
    improper=True,
    check=check_moduli,
)


def activated(F: Expr, A: Expr | ArrayLike, mu: Expr, improper: bool = False) -> Expr:
    """Energy of a material whose state of rest is F = R A^-1: an activation A that shapes it.

    psi = mu |F A - R|^2,  R the rotation of F A = R S;  P = 2 mu (F A - R) A^T

    A fiber a with A a = 2 a wants to contract to half its length. Add a term against the change of
    volume, as :func:`volumetric`.

    Args:
        F: Deformation gradient, shape (3, 3).
        A: Activation, symmetric or not, shape (3, 3), or (2, 2) on a plane body: numbers, Constant,
            Function or expression, as of a load factor.
        mu: Shear modulus [Pa].
        improper: Take the orthogonal polar factor in O(3), so that inverted states rest, too,
            instead of the rotation in SO(3).

    Returns:
        Energy per reference volume [J/m^3], finite for every F.

    Raises:
        ValueError: F is not 3x3, or A of another shape.

    Source: document 002, with A^T for an A that is not symmetric.
    """
    matrix = ufl.as_matrix(np.asarray(A).tolist()) if _is_array(A) else A
    if not isinstance(matrix, ufl.core.expr.Expr):
        raise ValueError(
            f"activated needs A as a matrix of numbers or in UFL, got {type(A).__name__}."
        )
    if F.ufl_shape != (3, 3):
        raise ValueError(
            f"activated needs a 3x3 F, got shape {F.ufl_shape}: pass forms.deformation_gradient(u)."
        )
    if matrix.ufl_shape == (2, 2):
        a = matrix
        matrix = ufl.as_matrix([[a[0, 0], a[0, 1], 0], [a[1, 0], a[1, 1], 0], [0, 0, 1]])
    if matrix.ufl_shape != (3, 3):
        raise ValueError(f"activated needs A of shape (3, 3), got {matrix.ufl_shape}.")
    energy = _improper if improper else as_rigid_as_possible
    return energy(F * matrix, mu)


def _is_array(A: Expr | ArrayLike) -> bool:
    return isinstance(A, list | tuple | np.ndarray)
