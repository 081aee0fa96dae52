# SPDX-License-Identifier: MIT
"""Deformed surfaces as OBJ and PLY files, a frame a step. Collective, on any number of ranks."""

from __future__ import annotations

from pathlib import Path as FilePath
from typing import Any

import basix
import numpy as np
from dolfinx import fem
from dolfinx.mesh import exterior_facet_indices
from numpy.typing import NDArray

from .._parallel import on_rank_zero
from ..paths import Path
from .nodes import Nodes, values

Array = NDArray[np.float64]


class Surfaces:
    """Writer of the deformed surface at each load step, for Blender, MeshLab, 3D printing.

    ``follow(…, on_step=forms.files.Surfaces("twist.obj", u))`` writes twist_0000.obj, … of
    triangles: a facet of a displacement of degree k is cut into k^2 of them, at its nodes. Solids
    show their boundary, with outward normals; plane bodies and surfaces in space all cells.

    Args:
        filename: Name that ends in .obj or .ply.
        u: Unknown; of a mixed one the displacement is taken.
        scale: Factor on the displacement.

    Raises:
        ValueError: the name ends otherwise.
        OSError: a file cannot be written; alike on all ranks.
    """

    def __init__(self, filename: str | FilePath, u: fem.Function, scale: float = 1.0) -> None:
        self._file = FilePath(filename)
        if self._file.suffix not in (".obj", ".ply"):
            raise ValueError(
                f"a surface needs a name that ends in .obj or .ply, got {self._file.name}."
            )
        self._nodes, self._scale, self._frames = Nodes(u, {}), scale, 0
        V = self._nodes.displacement.function_space
        found = V.mesh.comm.gather(_triangles(V), root=0)
        own = V.tabulate_dof_coordinates()[: V.dofmap.index_map.size_local]
        points = V.mesh.comm.gather(own, root=0)
        if found is not None and points is not None:
            shown, triangles = np.unique(np.concatenate(found), return_inverse=True)
            self._shown, self._triangles = shown, triangles.reshape(-1, 3)
            self._points = np.concatenate(points)[shown]

    def __call__(self, path: Path) -> None:
        """Write the state of a path."""
        self.write()

    def write(self) -> None:
        """Write the present state of the unknown as the next frame."""
        self._nodes.update()
        u = values(self._nodes.displacement)
        name = f"{self._file.stem}_{self._frames:04}{self._file.suffix}"
        self._frames += 1

        def write() -> None:
            assert u is not None
            x = self._points.copy()
            x[:, : u.shape[1]] += self._scale * u[self._shown]
            self._file.parent.mkdir(parents=True, exist_ok=True)
            text = _obj if self._file.suffix == ".obj" else _ply
            self._file.with_name(name).write_bytes(text(x, self._triangles))

        on_rank_zero(self._nodes.displacement.function_space.mesh.comm, write)


def _obj(x: Any, triangles: Any) -> bytes:
    lines = [f"v {a!r} {b!r} {c!r}" for a, b, c in x.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (triangles + 1).tolist()]
    return ("\n".join(lines) + "\n").encode()


def _ply(x: Array, triangles: NDArray[np.int64]) -> bytes:
    head = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(x)}\n"
        "property double x\nproperty double y\nproperty double z\n"
        f"element face {len(triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    faces = np.empty(len(triangles), [("n", "u1"), ("nodes", "<i4", 3)])
    faces["n"], faces["nodes"] = 3, triangles
    return head.encode() + x.astype("<f8").tobytes() + faces.tobytes()


def _triangles(V: fem.FunctionSpace) -> NDArray[np.int64]:
    """Global node numbers of this rank's triangles, shape (n, 3). Collective."""
    mesh, dim = V.mesh, V.mesh.topology.dim
    cells, local = _facets(mesh)
    x = V.tabulate_dof_coordinates()
    found = [np.empty((0, 3), np.int64)]
    for i in np.unique(local):
        here = cells[local == i]
        nodes = V.dofmap.list[here]
        triangles = nodes[:, _pattern(V, min(dim, 2), int(i))]
        corners = x[triangles]
        normal = np.cross(
            corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :]
        )
        # Out of the cell; a plane body looks up, a surface in space as its cells are numbered.
        out = corners.mean(axis=2) - x[nodes].mean(axis=1)[:, None] if dim == 3 else normal
        out = np.broadcast_to([0.0, 0.0, 1.0], normal.shape) if mesh.geometry.dim == 2 else out
        wrong = np.einsum("ftk,ftk->ft", normal, out) < 0
        triangles[wrong] = triangles[wrong][:, ::-1]
        found.append(V.dofmap.index_map.local_to_global(triangles.ravel()).reshape(-1, 3))
    return np.concatenate(found)


def _facets(mesh: Any) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Owned exterior facets of a solid, as cells and local numbers; else all cells, number 0."""
    topology, dim = mesh.topology, mesh.topology.dim
    topology.create_connectivity(dim - 1, dim)
    topology.create_connectivity(dim, dim - 1)
    owned = np.arange(topology.index_map(dim).size_local, dtype=np.int32)
    if dim < 3:
        return owned, np.zeros_like(owned)
    facets = exterior_facet_indices(topology)
    links, numbers = topology.connectivity(dim - 1, dim), topology.connectivity(dim, dim - 1)
    cells = np.array([links.links(f)[0] for f in facets], dtype=np.int32)
    pairs = zip(cells, facets, strict=True)
    local = [int(np.flatnonzero(numbers.links(c) == f)[0]) for c, f in pairs]
    return cells, np.array(local, dtype=np.int32)


def _pattern(V: fem.FunctionSpace, fdim: int, facet: int) -> NDArray[np.int32]:
    """Local nodes of the triangles of a facet of the reference cell, shape (n, 3)."""
    whole: Any = V.ufl_element()
    element = whole.sub_elements[0] if whole.block_size > 1 else whole
    k = element.embedded_superdegree
    cell = getattr(basix.CellType, V.mesh.topology.cell_name())
    corners = basix.geometry(cell)[basix.topology(cell)[fdim][facet]]
    closure = element.entity_closure_dofs[fdim][facet]
    # Coordinates along two sides of the facet, 0 to k at its nodes.
    sides = np.stack([corners[1] - corners[0], corners[2] - corners[0]], axis=1)
    arms = (element.basix_element.points[closure] - corners[0]).T
    places = np.rint(k * np.linalg.lstsq(sides, arms, rcond=None)[0]).astype(int)
    at = {(int(i), int(j)): n for i, j, n in zip(*places, closure, strict=True)}
    found = []
    for i, j in np.ndindex(k, k):
        halves = [(i, j), (i + 1, j), (i, j + 1)], [(i + 1, j + 1), (i, j + 1), (i + 1, j)]
        found += [[at[p] for p in half] for half in halves if all(p in at for p in half)]
    return np.array(found, dtype=np.int32)
