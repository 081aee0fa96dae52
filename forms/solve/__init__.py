# SPDX-License-Identifier: MIT
"""Solving: Newton by PETSc SNES, linear presets, load paths, controlled paths."""

from .bordered import control
from .continuation import Path, Step, follow, solve
from .newton import Convergence, Newton, NotConverged

__all__ = ["Convergence", "Newton", "NotConverged", "Path", "Step", "control", "follow", "solve"]
