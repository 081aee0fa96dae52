# SPDX-License-Identifier: MIT
"""The documents' formulas in plain NumPy: the oracle that tests and notebooks compare with.

Nothing in ``forms`` imports this package, and it imports NumPy alone. Take the modules:
``from forms.formulas import elasticity, element, materials, quadrature, shapes`` (document 003),
``quotients, svd_derivatives`` (000), ``membrane_invariants, membrane_eigensystems`` (001) and
``polar`` (002). The symbolic ``derivation`` (000) needs SymPy, so it is imported when it is named.
"""

from . import (
    elasticity,
    element,
    materials,
    membrane_eigensystems,
    membrane_invariants,
    polar,
    quadrature,
    quotients,
    shapes,
    svd_derivatives,
)

__all__ = [
    "elasticity",
    "element",
    "materials",
    "membrane_eigensystems",
    "membrane_invariants",
    "polar",
    "quadrature",
    "quotients",
    "shapes",
    "svd_derivatives",
]
