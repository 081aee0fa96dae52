# SPDX-License-Identifier: MIT
"""Bodies: meshes whose boundaries and regions have names, made by gmsh or read from files."""

from .blocks import block, cook
from .body import Body
from .files import read
from .solids import cylinder, ellipsoid, sphere_octant

__all__ = ["block", "cook", "cylinder", "sphere_octant", "ellipsoid", "read", "Body"]
