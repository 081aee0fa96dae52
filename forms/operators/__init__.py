# SPDX-License-Identifier: MIT
"""External operators: energies in singular values, computed in the cell loop."""

from .energy import SingularValueEnergy
from .lowering import compiled

__all__ = ["SingularValueEnergy", "compiled"]
