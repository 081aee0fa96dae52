# SPDX-License-Identifier: MIT
"""The one place that knows DOLFINx's version; everything else calls these functions.

Tested with 0.9 (UFL 2024.2, PETSc 3.22) and 0.11 (UFL 2026.1, PETSc 3.25). Each difference names
the release that made it; delete the older branch when that release is no longer supported.
"""

from __future__ import annotations

import logging
from typing import Any

import dolfinx
import ffcx
import ffcx.naming
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
# FFCx 0.9 sends Python's warnings, ours with them, to a logger that nobody reads.
logging.captureWarnings(False)
LATER = VERSION >= (0, 10)
CUSTOM_DATA = LATER  # FFCx kernels take a pointer more
TREES = not LATER  # FFCx's trees of kernels are those that native/trees.py writes


def geometric_dimension(domain: Any) -> int:
    """Geometric dimension of a UFL mesh (a method up to UFL 2025.1, a property later)."""
    dim = domain.geometric_dimension
    return int(dim() if callable(dim) else dim)


def topological_dimension(domain: Any) -> int:
    """Topological dimension of a UFL mesh (a method up to UFL 2025.1, a property later)."""
    dim = domain.topological_dimension
    return int(dim() if callable(dim) else dim)


def cell_name(cell: Any) -> str:
    """Name of a UFL cell (a method up to UFL 2024.2, a property later)."""
    name = cell.cellname
    return str(name() if callable(name) else name)


def geometry_degree(mesh: dolfinx.mesh.Mesh) -> int:
    """Polynomial degree of a mesh's geometry (0.11: a list of coordinate elements)."""
    geometry = mesh.geometry
    return int((geometry.cmaps[0] if hasattr(geometry, "cmaps") else geometry.cmap).degree)


def geometry_dofmap(mesh: Any) -> NDArray[np.int32]:
    """Nodes of each cell's geometry, shape (cells, nodes), of a mesh or a C++ mesh.

    From 0.10 one array per cell type; the C++ mesh of 0.9 has a method for them.
    """
    tables = getattr(mesh.geometry, "dofmaps", None)
    if tables is None:
        return mesh.geometry.dofmap
    return tables(0) if callable(tables) else tables[0]


def original_cells(mesh: dolfinx.mesh.Mesh) -> NDArray[np.int64] | None:
    """Numbers of the owned cells as they were input; None for a submesh, which has none."""
    topology = mesh.topology
    try:
        numbers = np.asarray(topology.original_cell_index)
    except RuntimeError:
        return None
    owned = topology.index_map(topology.dim).size_local
    return numbers[:owned] if numbers.size >= owned else None


def interpolation_points(V: fem.FunctionSpace) -> NDArray[np.float64]:
    """Reference points of a space's degrees of freedom (a method up to 0.9)."""
    points = V.element.interpolation_points
    return points() if callable(points) else points


def collapse(view: fem.FunctionSpace) -> tuple[fem.FunctionSpace, NDArray[np.int32]]:
    """Space of a view, and its degrees of freedom in the whole (0.11: a list per cell type).

    From degree 3 on a space of its own: in the one that DOLFINx makes the nodes of an edge are in
    another order in some cells, so that functions of it jump there.
    """
    element = view.ufl_element()
    if element.embedded_superdegree <= 2:
        V, numbers = view.collapse()
        return V, np.asarray(numbers, dtype=np.int32).ravel()
    V = fem.functionspace(view.mesh, element)
    size, imap = V.dofmap.bs, V.dofmap.index_map
    numbers = np.zeros((imap.size_local + imap.num_ghosts, size), dtype=np.int32)
    cells, whole = V.dofmap.list, view.dofmap
    named = whole.list[:, :, None] * whole.bs + np.arange(whole.bs)
    numbers[cells] = named.reshape(*cells.shape, size)
    return V, numbers.ravel()


def create_vector(form: fem.Form) -> Any:
    """PETSc vector with ghosts of a linear form (0.10: of a function space)."""
    if LATER:
        return fem_petsc.create_vector(form.function_spaces[0])
    return fem_petsc.create_vector(form)


def integrals(form: fem.Form) -> list[tuple[fem.IntegralType, NDArray[np.int32], NDArray]]:
    """Type, entities and packed coefficients of each integral, in FFCx's order.

    An integral goes by the number of its subdomain; from 0.10 by its place in the order.
    """
    cpp, found = form._cpp_object, []
    packed = dolfinx.cpp.fem.pack_coefficients(cpp)
    for kind in sorted(cpp.integral_types, key=lambda kind: kind.value):
        keys = range(cpp.num_integrals(kind, 0)) if LATER else cpp.integral_ids(kind)
        found += [(kind, cpp.domains(kind, key), packed[kind, key]) for key in keys]
    return found


def constants(form: fem.Form) -> NDArray[np.float64]:
    """Values of a form's constants, one after the other."""
    return dolfinx.cpp.fem.pack_constants(form._cpp_object)


def create_matrix(comm: Any, pattern: Any) -> Any:
    """Empty PETSc AIJ matrix of a sparsity pattern."""
    return dolfinx.cpp.la.petsc.create_matrix(comm, pattern)


def column_map(pattern: Any) -> Any:
    """Index map of a finalized sparsity pattern's columns (0.10: index_map(1))."""
    return pattern.index_map(1) if LATER else pattern.column_index_map()


def bounding_boxes(
    mesh: dolfinx.mesh.Mesh, dim: int, entities: NDArray[np.int32]
) -> geometry.BoundingBoxTree:
    """Tree of the bounding boxes of entities (0.10: these go by name only)."""
    return geometry.bb_tree(mesh, dim, entities=entities)


def signature(ufl_object: Any, tag: str) -> str:
    """FFCx's digest of a form, or of an expression with its points, its options and a tag."""
    tag = f"{tag} {sorted((k, str(v)) for k, v in ffcx.get_options().items())}"
    return str(ffcx.naming.compute_signature([ufl_object], tag))


def cpp_mesh(domain: Any) -> Any:
    """DOLFINx's C++ mesh of a UFL mesh."""
    mesh = domain.ufl_cargo()
    return getattr(mesh, "_cpp_object", mesh)


def custom_form(
    mesh: Any,
    spaces: list[fem.FunctionSpace],
    integrals: dict[fem.IntegralType, list[tuple[int, NDArray[np.int32], int]]],
    coefficients: list[fem.Function],
    constants: list[fem.Constant],
    permutations: bool,
) -> fem.Form:
    """Form on a C++ mesh of integrals given by kernel address, entities, coefficients packed."""
    listed = {
        kind: [
            # 0.10 wants the numbers 0, 1, .. here and not the subdomains'.
            (number, address, entities, np.arange(count, dtype=np.int8))
            for number, (address, entities, count) in enumerate(parts)
        ]
        for kind, parts in integrals.items()
    }
    arguments: tuple[Any, ...] = (
        [V._cpp_object for V in spaces],
        listed,
        [f._cpp_object for f in coefficients],
        [c._cpp_object for c in constants],
        permutations,
        [] if LATER else {},
        mesh,
    )
    return fem.Form(fem.form_cpp_class(np.float64)(*arguments))


def integration_entities(
    mesh: Any, kind: fem.IntegralType, subdomain: Any, number: int
) -> NDArray[np.int32]:
    """Entities of an integral as DOLFINx wants them; -1: the whole mesh, owned entities only."""
    topology, dim = mesh.topology, mesh.topology.dim
    if subdomain is None and number != -1:
        return np.empty(0, np.int32)
    facets = kind == fem.IntegralType.exterior_facet
    if subdomain is not None and number != -1 and not hasattr(subdomain, "find"):
        found = [np.asarray(entities) for tag, entities in subdomain if tag == number]
        return np.concatenate([*found, np.empty(0)]).astype(np.int32)
    if facets:
        topology.create_connectivity(dim - 1, dim)
        topology.create_connectivity(dim, dim - 1)
    if number != -1:
        entities = subdomain.find(number)
    elif facets:
        entities = dolfinx.cpp.mesh.exterior_facet_indices(topology)
    else:
        return np.arange(topology.index_map(dim).size_local, dtype=np.int32)
    compute = dolfinx.cpp.fem.compute_integration_domains
    if LATER:
        return np.asarray(compute(kind, topology, entities)).ravel()
    found = compute(kind, topology, entities, dim - 1 if facets else dim)
    return np.asarray(found).ravel()
