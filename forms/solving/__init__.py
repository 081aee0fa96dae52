# SPDX-License-Identifier: MIT
"""Solving: Newton by PETSc SNES, linear presets, load paths, arc length, stability."""

from ..paths import Convergence, NotConverged, Path, Step
from .arclength import arc_length
from .data import Data
from .fitted import Fit
from .fitting import fit
from .following import follow, solve
from .newton import Newton
from .sensitivity import gradient
from .stability import lowest_modes, negative_eigenvalues
from .targets import control
from .unloading import unload

__all__ = [
    "Convergence",
    "Newton",
    "Data",
    "Fit",
    "NotConverged",
    "Path",
    "Step",
    "arc_length",
    "control",
    "fit",
    "follow",
    "gradient",
    "lowest_modes",
    "negative_eigenvalues",
    "solve",
    "unload",
]
