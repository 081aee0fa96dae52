# SPDX-License-Identifier: MIT
"""The one place that knows DOLFINx's version; everything else calls these functions.

Tested with 0.9 (UFL 2024.2, PETSc 3.22) and 0.11 (UFL 2026.1, PETSc 3.25). Each difference names
the release that made it; delete the older branch when that release is no longer supported.
"""

from __future__ import annotations

from typing import Any

import dolfinx
import numpy as np
from dolfinx import fem, geometry
from dolfinx.fem import petsc as fem_petsc
from numpy.typing import NDArray

VERSION = tuple(int(part) for part in dolfinx.__version__.split(".")[:2])
if not (0, 9) <= VERSION < (0, 12):
    raise ImportError(
        f"variform needs DOLFINx 0.9 to 0.11, found {dolfinx.__version__}: "
        "run it through docker/enter, or install one of these releases."
    )
LATER = VERSION >= (0, 10)


def geometric_dimension(domain: Any) -> int:
    """Geometric dimension of a UFL mesh (a method up to UFL 2025.1, a property later)."""
    dim = domain.geometric_dimension
    return int(dim() if callable(dim) else dim)


def topological_dimension(domain: Any) -> int:
    """Topological dimension of a UFL mesh (a method up to UFL 2025.1, a property later)."""
    dim = domain.topological_dimension
    return int(dim() if callable(dim) else dim)


def geometry_degree(mesh: dolfinx.mesh.Mesh) -> int:
    """Polynomial degree of a mesh's geometry (0.11: a list of coordinate elements)."""
    geometry = mesh.geometry
    return int((geometry.cmaps[0] if hasattr(geometry, "cmaps") else geometry.cmap).degree)


def interpolation_points(V: fem.FunctionSpace) -> NDArray[np.float64]:
    """Reference points of a space's degrees of freedom (a method up to 0.9)."""
    points = V.element.interpolation_points
    return points() if callable(points) else points


def collapse(view: fem.FunctionSpace) -> tuple[fem.FunctionSpace, NDArray[np.int32]]:
    """Space of a view, and its degrees of freedom in the whole (0.11: a list per cell type)."""
    V, numbers = view.collapse()
    return V, np.asarray(numbers, dtype=np.int32).ravel()


def create_vector(form: fem.Form) -> Any:
    """PETSc vector with ghosts of a linear form (0.10: of a function space)."""
    if LATER:
        return fem_petsc.create_vector(form.function_spaces[0])
    return fem_petsc.create_vector(form)


def bounding_boxes(
    mesh: dolfinx.mesh.Mesh, dim: int, entities: NDArray[np.int32]
) -> geometry.BoundingBoxTree:
    """Tree of the bounding boxes of entities (0.10: these go by name only)."""
    return geometry.bb_tree(mesh, dim, entities=entities)
