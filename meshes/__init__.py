# SPDX-License-Identifier: MIT
"""Bodies: meshes whose boundaries and regions have names, made by gmsh or read from files."""

from .blocks import block, cook
from .body import Body
from .files import read
from .sheets import cylindrical_sheet, disk, pillow, spherical_sheet, square
from .solids import cylinder, ellipsoid, sphere_octant

__all__ = [
    "block",
    "cook",
    "cylinder",
    "sphere_octant",
    "ellipsoid",
    "square",
    "disk",
    "spherical_sheet",
    "cylindrical_sheet",
    "pillow",
    "read",
    "Body",
]
