# SPDX-License-Identifier: MIT
"""Bodies: meshes whose boundaries and regions have names, made by gmsh or read from files."""

if __name__ == "meshes":
    raise ImportError("the packages have one name: write `from variform import forms, meshes`.")

from .arrays import from_arrays
from .blocks import block, cook
from .body import Body
from .fibers import ellipsoid_depth, ellipsoid_fiber_field, ellipsoid_fibers
from .files import read
from .sheets import cylindrical_sheet, disk, pillow, spherical_sheet, square
from .solids import cylinder, ellipsoid, sphere_octant

__all__ = [
    "block",
    "cook",
    "cylinder",
    "sphere_octant",
    "ellipsoid",
    "ellipsoid_depth",
    "ellipsoid_fibers",
    "ellipsoid_fiber_field",
    "square",
    "disk",
    "spherical_sheet",
    "cylindrical_sheet",
    "pillow",
    "read",
    "from_arrays",
    "Body",
]
