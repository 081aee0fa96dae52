# SPDX-License-Identifier: MIT
"""Solving: Newton by PETSc SNES, linear presets, load paths, arc length, stability."""

from .arclength import arc_length
from .continuation import follow, solve
from .control import control
from .convergence import Convergence, NotConverged
from .newton import Newton
from .path import Path, Step
from .stability import lowest_modes, negative_eigenvalues

__all__ = [
    "Convergence",
    "Newton",
    "NotConverged",
    "Path",
    "Step",
    "arc_length",
    "control",
    "follow",
    "lowest_modes",
    "negative_eigenvalues",
    "solve",
]
