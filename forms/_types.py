# SPDX-License-Identifier: MIT
"""Types that UFL and PETSc have no stubs for."""

from ufl.core.expr import Expr

__all__ = ["Expr"]
