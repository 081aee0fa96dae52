# SPDX-License-Identifier: MIT
"""The documents' formulas in plain NumPy: the oracle that tests and notebooks compare with.

Nothing in ``forms`` imports this package, and it imports NumPy alone. Take the modules:
``from forms.formulas import elasticity, element, materials, quadrature, shapes``.
"""

from . import elasticity, element, materials, quadrature, shapes

__all__ = ["elasticity", "element", "materials", "quadrature", "shapes"]
