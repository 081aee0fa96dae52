# SPDX-License-Identifier: MIT
"""Sheets as surfaces in space: the 3x2 deformation gradient, its invariants, normal and volume.

On a surface mesh (cells of dimension 2 in three dimensions) F maps the tangent plane, with an
orthonormal frame (e1, e2) in each point, into space. F is no square matrix: it has two singular
values and knows nothing of the thickness. Document 001 writes I1, I2, I3 for what it depends on.
"""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray

from . import _checks, _dolfinx
from ._types import Expr


def membrane_gradient(u: Expr) -> Expr:
    """Deformation gradient of a sheet, from its tangent plane into space.

    F = [e1 + (grad u) e1, e2 + (grad u) e2],  e1, e2 orthonormal in the reference surface

    e1 points along the first edge of a cell; isotropic energies do not depend on the choice.

    Args:
        u: Displacement [m], shape (3,), on a surface mesh, flat or curved.

    Returns:
        F, shape (3, 2), a ``ufl.variable``.

    Raises:
        ValueError: u is no vector of three components on a surface in space.
    """
    E = frame(u)
    return ufl.variable(E + ufl.grad(u) * E)


def frame(u: Expr) -> Expr:
    """Orthonormal vectors (e1, e2) of the reference surface as columns, shape (3, 2)."""
    J = ufl.Jacobian(_surface(u))
    a, b = (ufl.as_vector([J[i, k] for i in range(3)]) for k in range(2))
    e1 = a / ufl.sqrt(ufl.dot(a, a))
    n = ufl.cross(a, b)
    e2 = ufl.cross(n / ufl.sqrt(ufl.dot(n, n)), e1)
    return ufl.as_matrix([[e1[i], e2[i]] for i in range(3)])


def membrane_invariants(F: Expr) -> tuple[Expr, Expr, Expr]:
    """Invariants of a 3x2 deformation gradient as document 001 defines them.

    I1 = s1 + s2 = sqrt(I2 + 2 I3),  I2 = F : F = s1^2 + s2^2,  I3 = s1 s2 = |f1 x f2|

    I3 is the ratio of areas, its inverse the normal stretch of an incompressible sheet. Its second
    derivative is singular where the area vanishes.
    """
    _check_shape(F, "membrane_invariants")
    I2 = ufl.inner(F, F)
    area = area_vector(F)
    I3 = ufl.sqrt(ufl.dot(area, area))
    return ufl.sqrt(I2 + 2 * I3), I2, I3


def area_vector(F: Expr) -> Expr:
    """Vector f1 x f2 = I3 n of a sheet: its deformed normal times the ratio of areas."""
    f1, f2 = _columns(F, "area_vector")
    return ufl.cross(f1, f2)


def incompressible_sheet(F: Expr) -> Expr:
    """3x3 deformation gradient of an incompressible sheet in plane stress, det = 1.

    [f1, f2, n / I3] with n the deformed normal, in the frame (e1, e2, e1 x e2)

    With it any incompressible energy of a solid becomes that of a sheet:
    ``mooney_rivlin(incompressible_sheet(F), c10, c01)``; no pressure is needed.

    Source: document 001, section 4.
    """
    f1, f2 = _columns(F, "incompressible_sheet")
    area = ufl.cross(f1, f2)
    normal = area / ufl.dot(area, area)  # of length 1 / I3
    return ufl.variable(ufl.as_matrix([[f1[i], f2[i], normal[i]] for i in range(3)]))


def orientation(body: Any) -> fem.Function:
    """+1 or -1 in each cell: which side of the cells, as numbered, is the surface's. Collective.

    On an oriented surface all cells are +1. A cell numbered the other way round than its neighbors
    is -1. On a closed surface the normal points outward, so that the volume is positive.

    Args:
        body: Surface mesh, or an object with a ``mesh``.

    Returns:
        Function of piecewise constants, to be multiplied to :func:`area_vector`.

    Raises:
        ValueError: three cells meet at an edge, or the surface has one side only (as a Moebius
            strip has).
    """
    mesh = _checks.mesh_of(body)
    _surface(mesh.ufl_domain())
    vertices, x, owned = _cells(mesh)
    comm = mesh.comm
    gathered = comm.gather((vertices, x))
    signs: list[NDArray[np.float64]] | None = None
    failure = ""
    if comm.rank == 0:
        cells = np.concatenate([part[0] for part in gathered])
        corners = np.concatenate([part[1] for part in gathered])
        try:
            counts = np.cumsum([len(part[0]) for part in gathered])[:-1]
            signs = np.split(_signs(cells, corners), counts)
        except ValueError as error:
            failure = str(error)
    failure = comm.bcast(failure)
    if failure:
        raise ValueError(failure)
    own = comm.scatter(signs)
    side = fem.Function(fem.functionspace(mesh, ("DG", 0)), name="orientation")
    side.x.array[side.function_space.dofmap.list[:owned].ravel()] = own
    side.x.scatter_forward()
    return side


def enclosed_volume(u: Expr, side: Expr = 1, dx: ufl.Measure = ufl.dx) -> ufl.Form:
    """Volume [m^3] between the deformed surface and the origin, int 1/3 x . n da.

    Of a closed surface it is the volume inside; of an open one that of the cone over it, which
    differs from the volume of interest by what the rim does not change (a rim that is fixed or
    slides in planes through the origin).

    Args:
        u: Displacement [m] on a surface mesh.
        side: :func:`orientation`, where the cells are not all numbered alike.
        dx: Measure of the reference surface.

    ``- p * enclosed_volume(u)`` is the potential of a pressure p inside.
    """
    x = ufl.SpatialCoordinate(_surface(u)) + u
    density = side * ufl.dot(x, area_vector(membrane_gradient(u))) / 3
    return density * _checks.measure(dx, "a volume")


def membrane_pressure(
    u: Expr, p: Expr, v: Expr, side: Expr = 1, dx: ufl.Measure = ufl.dx
) -> ufl.Form:
    """Virtual work of a pressure that stays normal to a deformed sheet, - int p n . v da.

    A pressure p > 0 pushes along the normal. For surfaces that are open at a moving rim; elsewhere
    it is the derivative of ``- p * enclosed_volume(u, side)``, which is symmetric.

    Args:
        u: Displacement [m] on a surface mesh.
        p: Pressure per deformed area [Pa].
        v: Test function of u's space.
        side: :func:`orientation`.
        dx: Measure of the reference surface.
    """
    _surface(u)
    p, v = ufl.as_ufl(p), ufl.as_ufl(v)
    if p.ufl_shape != () or v.ufl_shape != (3,):
        raise ValueError(
            "membrane_pressure needs a scalar p and a test function v of shape (3,), got shapes "
            f"{p.ufl_shape} and {v.ufl_shape}; the order is (u, p, v, side, dx)."
        )
    load = side * p * ufl.dot(area_vector(membrane_gradient(u)), v)
    return -load * _checks.measure(dx, "a pressure")


def _surface(u: Any) -> Any:
    """UFL mesh of a displacement (or a mesh) after checking that it is a surface in space."""
    domain = u if isinstance(u, ufl.Mesh) else ufl.domain.extract_unique_domain(u)
    dims = (_dolfinx.topological_dimension(domain), _dolfinx.geometric_dimension(domain))
    if dims != (2, 3):
        raise ValueError(
            "a membrane needs a surface mesh, cells of dimension 2 in three dimensions, got "
            f"{dims[0]} in {dims[1]}; for bodies and plane sheets use forms.deformation_gradient."
        )
    if not isinstance(u, ufl.Mesh) and u.ufl_shape != (3,):
        raise ValueError(f"a membrane needs a displacement of shape (3,), got {u.ufl_shape}.")
    return domain


def _check_shape(F: Expr, name: str) -> None:
    if F.ufl_shape != (3, 2):
        raise ValueError(
            f"{name} needs a 3x2 F, got shape {F.ufl_shape}: pass forms.membrane_gradient(u)."
        )


def _columns(F: Expr, name: str) -> tuple[Expr, Expr]:
    _check_shape(F, name)
    f1, f2 = (ufl.as_vector([F[i, k] for i in range(3)]) for k in range(2))
    return f1, f2


def _cells(mesh: Any) -> tuple[NDArray[np.int64], NDArray[np.float64], int]:
    """Owned cells: their corners in order around the cell, as global numbers and coordinates."""
    topology = mesh.topology
    owned = topology.index_map(2).size_local
    topology.create_connectivity(2, 0)
    around = [0, 1, 2] if topology.cell_name() == "triangle" else [0, 1, 3, 2]
    local = topology.connectivity(2, 0).array.reshape(-1, len(around))[:owned]
    x = mesh.geometry.x[_dolfinx.geometry_dofmap(mesh)[:owned][:, around]]
    numbers = topology.index_map(0).local_to_global(local[:, around].ravel().astype(np.int32))
    return numbers.reshape(-1, len(around)), x, owned


def _signs(cells: NDArray[np.int64], x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sides of the cells by walking from neighbor to neighbor; rank 0, all cells."""
    n = cells.shape[1]
    edges: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for cell in range(len(cells)):
        for k in range(n):
            a, b = int(cells[cell, k]), int(cells[cell, (k + 1) % n])
            edges.setdefault((min(a, b), max(a, b)), []).append((cell, 1 if a < b else -1))
    neighbors: list[list[tuple[int, int]]] = [[] for _ in cells]
    for there in edges.values():
        if len(there) > 2:
            raise ValueError(
                f"{len(there)} cells meet at an edge: a membrane has two sides; make it of sheets."
            )
        if len(there) == 2:
            (a, one), (b, two) = there
            neighbors[a].append((b, -one * two))
            neighbors[b].append((a, -one * two))
    signs = np.zeros(len(cells))
    volume = _volumes(x)
    closed = all(len(there) == 2 for there in edges.values())
    for first in range(len(cells)):
        if signs[first]:
            continue
        signs[first] = 1
        part, ahead = [first], deque([first])
        while ahead:
            cell = ahead.popleft()
            for other, same in neighbors[cell]:
                if not signs[other]:
                    signs[other] = same * signs[cell]
                    part.append(other)
                    ahead.append(other)
                elif signs[other] != same * signs[cell]:
                    raise ValueError(
                        "the surface has one side only (as a Moebius strip has): it has no "
                        "inside for a pressure to act in."
                    )
        if closed and volume[part] @ signs[part] < 0:
            signs[part] *= -1
        elif not closed and signs[part].sum() < 0:
            signs[part] *= -1
    return signs


def _volumes(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Volume of the cone from the surface's middle over each cell."""
    x = x - x.reshape(-1, 3).mean(axis=0)
    fans = range(1, x.shape[1] - 1)
    return sum(np.linalg.det(x[:, [0, k, k + 1]]) for k in fans) / 6 + np.zeros(len(x))
