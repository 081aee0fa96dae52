# SPDX-License-Identifier: MIT
"""Solving: Newton by PETSc SNES, linear presets, load paths, arc length, stability."""

from ..paths import Convergence, NotConverged, Path, Step
from .arclength import arc_length
from .data import Data
from .fitted import Fit
from .fitting import fit
from .following import follow, solve
from .motions import transient
from .newton import Newton
from .sensitivity import gradient
from .settling import settle
from .stability import lowest_modes, negative_eigenvalues
from .targets import control
from .unloading import unload
from .vibrations import frequencies

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
    "frequencies",
    "gradient",
    "lowest_modes",
    "negative_eigenvalues",
    "settle",
    "solve",
    "transient",
    "unload",
]
