# SPDX-License-Identifier: MIT
"""External operators: energies in singular values, computed in the cell loop."""

from .energy import SingularValueEnergy

__all__ = ["SingularValueEnergy"]
