# SPDX-License-Identifier: MIT
"""Solving: Newton by PETSc SNES, linear presets, load paths, arc length, stability."""

from ..paths import Convergence, NotConverged, Path, Step
from .arclength import arc_length
from .following import follow, solve
from .newton import Newton
from .sensitivity import gradient
from .stability import lowest_modes, negative_eigenvalues
from .targets import control

__all__ = [
    "Convergence",
    "Newton",
    "NotConverged",
    "Path",
    "Step",
    "arc_length",
    "control",
    "follow",
    "gradient",
    "lowest_modes",
    "negative_eigenvalues",
    "solve",
]
