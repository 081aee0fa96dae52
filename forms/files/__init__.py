# SPDX-License-Identifier: MIT
"""Files: checkpoints, VTX, VTU, surfaces, tables, pictures; collective, on any number of ranks."""

from .surfaces import Surfaces
from .tables import table
from .vtu import VTU

__all__ = ["VTU", "Surfaces", "table"]
