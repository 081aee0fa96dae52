# SPDX-License-Identifier: MIT
"""Solving: Newton by PETSc SNES, linear presets, load paths, arc length, stability."""

from ..paths import Convergence, NotConverged, Path, Step
from .arclength import arc_length
from .following import follow, solve
from .motions import transient
from .newton import Newton
from .settling import settle
from .stability import lowest_modes, negative_eigenvalues
from .targets import control
from .vibrations import frequencies

__all__ = [
    "Convergence",
    "Newton",
    "NotConverged",
    "Path",
    "Step",
    "arc_length",
    "control",
    "follow",
    "frequencies",
    "lowest_modes",
    "negative_eigenvalues",
    "settle",
    "solve",
    "transient",
]
