# SPDX-License-Identifier: MIT
"""Shape functions N_a(xi) of document 003, (37): tet4, tet10, hex8, hex27.

Tetrahedra have the corners (0,0,0), (1,0,0), (0,1,0), (0,0,1), hexahedra are the cube [-1, 1]^3.

Order of the nodes (``NODES`` has their places): corners; then midpoints of ``EDGES``; then, in
hex27, midpoints of the faces -x, +x, -y, +y, -z, +z; then the center. Hexahedra count the corners
around the face -z, then around +z. ``FACETS`` lists the corners of each face counterclockwise, seen
from outside.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

_TET_EDGES = ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3))
_HEX_EDGES = (
    *((0, 1), (1, 2), (2, 3), (3, 0)),
    *((4, 5), (5, 6), (6, 7), (7, 4)),
    *((0, 4), (1, 5), (2, 6), (3, 7)),
)
_TET_FACETS = ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1))
_HEX_FACETS = (
    *((0, 4, 7, 3), (1, 2, 6, 5), (0, 1, 5, 4)),
    *((3, 7, 6, 2), (0, 3, 2, 1), (4, 5, 6, 7)),
)
_TET = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
_SQUARE = [[-1, -1], [1, -1], [1, 1], [-1, 1]]
_HEX = np.array([[*p, z] for z in (-1, 1) for p in _SQUARE], dtype=float)


def _middles(corners: Array, groups: tuple[tuple[int, ...], ...]) -> Array:
    return np.array([corners[list(group)].mean(axis=0) for group in groups])


EDGES = {"tet4": _TET_EDGES, "tet10": _TET_EDGES, "hex8": _HEX_EDGES, "hex27": _HEX_EDGES}
FACETS = {"tet4": _TET_FACETS, "tet10": _TET_FACETS, "hex8": _HEX_FACETS, "hex27": _HEX_FACETS}
NODES = {
    "tet4": _TET,
    "tet10": np.vstack([_TET, _middles(_TET, _TET_EDGES)]),
    "hex8": _HEX,
    "hex27": np.vstack(
        [_HEX, _middles(_HEX, _HEX_EDGES), _middles(_HEX, _HEX_FACETS), np.zeros((1, 3))]
    ),
}


def shape_functions(cell: str, xi: Array) -> Array:
    """N_a(xi) of (37), shape (..., n), at points xi of shape (..., 3).

    tet4: L_a;  tet10: L_a (2 L_a - 1) and 4 L_a L_b, L = (1 - x - y - z, x, y, z)
    hex8, hex27: products over the directions of N(x), c the coordinate of the node;
    hex8: N = (1 + c x) / 2;  hex27: N = 1 - x^2 for c = 0, x (x + c) / 2 for c = -1, 1

    Raises:
        ValueError: unknown cell, or points without three coordinates.
    """
    xi = _points(cell, xi)
    if cell.startswith("hex"):
        return np.prod(_line(cell, xi)[0], axis=-1)
    L = _barycentric(xi)
    if cell == "tet4":
        return L
    edges = [4 * L[..., a] * L[..., b] for a, b in _TET_EDGES]
    return np.concatenate([L * (2 * L - 1), np.stack(edges, axis=-1)], axis=-1)


def shape_gradients(cell: str, xi: Array) -> Array:
    """dN_a/dxi_j, shape (..., n, 3), of :func:`shape_functions`."""
    xi = _points(cell, xi)
    if cell.startswith("hex"):
        N, dN = _line(cell, xi)
        x, y, z = (N[..., j] for j in range(3))
        columns = [dN[..., 0] * y * z, x * dN[..., 1] * z, x * y * dN[..., 2]]
        return np.stack(columns, axis=-1)
    dL = np.vstack([-np.ones(3), np.eye(3)])
    if cell == "tet4":
        return np.broadcast_to(dL, (*xi.shape[:-1], 4, 3)).copy()
    L = _barycentric(xi)[..., None]
    edges = [4 * (L[..., a, :] * dL[b] + L[..., b, :] * dL[a]) for a, b in _TET_EDGES]
    return np.concatenate([(4 * L - 1) * dL, np.stack(edges, axis=-2)], axis=-2)


def facet_map(cell: str, facet: int, points: Array) -> tuple[Array, Array]:
    """Points of a face in the cell, and the tangents of that (affine) map.

    Args:
        cell: Kind of cell.
        facet: Number in ``FACETS``.
        points: Shape (q, 2), in the triangle (0,0), (1,0), (0,1), or in the square [-1, 1]^2.

    Returns:
        xi (q, 3), and (2, 3): the derivatives of xi. Their cross product points outward.

    Raises:
        ValueError: unknown cell or face.
    """
    if not 0 <= facet < len(_known(cell, FACETS)):
        raise ValueError(f"{cell} has the faces 0 to {len(FACETS[cell]) - 1}, got {facet}.")
    corners = NODES[cell][list(FACETS[cell][facet])]
    tangents = np.array([corners[1] - corners[0], corners[-1] - corners[0]])
    if cell.startswith("tet"):
        return corners[0] + np.asarray(points) @ tangents, tangents
    return corners.mean(axis=0) + np.asarray(points) @ (tangents / 2), tangents / 2


def _barycentric(xi: Array) -> Array:
    return np.concatenate([1 - np.sum(xi, axis=-1, keepdims=True), xi], axis=-1)


def _line(cell: str, xi: Array) -> tuple[Array, Array]:
    """Factors of the three directions and their derivatives, shape (..., n, 3)."""
    c, x = NODES[cell], xi[..., None, :]
    if cell == "hex8":
        return (1 + c * x) / 2, np.broadcast_to(c / 2, np.broadcast_shapes(c.shape, x.shape))
    N = np.where(c == 0, 1 - x**2, x * (x + c) / 2)
    return N, np.where(c == 0, -2 * x, x + c / 2)


def _known(cell: str, table: dict[str, Any]) -> Any:
    if cell not in table:
        raise ValueError(f"(37) is here for {', '.join(NODES)}, got {cell!r}.")
    return table[cell]


def _points(cell: str, xi: Array) -> Array:
    _known(cell, NODES)
    xi = np.asarray(xi)
    if xi.shape[-1:] != (3,):
        raise ValueError(f"(37) needs points (..., 3), got shape {xi.shape}.")
    return xi
