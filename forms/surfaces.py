# SPDX-License-Identifier: MIT
"""Surfaces that may touch each other, as flat pieces between points that follow the unknown.

Each facet is cut into parts, whose corners are combinations of the nodes on it. All ranks know all
points, and the places of all nodes that move them; forces and stiffnesses come in shares.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import basix
import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray

from ._parallel import bounding_box
from .boundaries import facet_type, points_on
from .unknowns import Field

Array = NDArray[Any]
SAME = 1e-9  # of the body's size, up to which two points are one


class Surface:
    """Points, segments and triangles of boundaries, and what moves them. Collective.

    Args:
        u: Unknown.
        field: Its displacement.
        measures: Of the boundaries; of membranes that of cells.
        parts: Parts of each edge of a facet.

    Attributes:
        points: Reference positions, shape (n, dim).
        edges, faces: Numbers of points; no faces in the plane.
        map: Displacements of the points from those of the nodes, sparse, shape (n, nodes).
        dofs: Global numbers of the nodes' degrees of freedom, shape (nodes, dim).
        comm: Communicator of the mesh.
    """

    def __init__(
        self, u: fem.Function, field: Field, measures: Sequence[ufl.Measure], parts: int
    ) -> None:
        self._u, mesh, dim = u, u.function_space.mesh, u.function_space.mesh.geometry.dim
        self.comm = comm = mesh.comm
        found = [self._facets(field, measure, parts) for measure in measures]
        gathered = [piece for pieces in comm.allgather(found) for piece in pieces]
        X = np.concatenate([piece[0] for piece in gathered])
        weights = np.concatenate([piece[1] for piece in gathered])
        dofs = np.concatenate([piece[2] for piece in gathered])
        offsets = np.cumsum([0] + [len(piece[0]) for piece in gathered[:-1]])
        cells = np.concatenate([p[3] + n for p, n in zip(gathered, offsets, strict=True)])
        low, high = bounding_box(comm, mesh.geometry.x)
        keys = np.round(X / (SAME * float(np.linalg.norm(high - low)))).astype(np.int64)
        # Two surfaces that lie on each other keep their points apart by what moves them.
        keys = np.c_[keys, np.where(weights > SAME, dofs[:, :, 0], -1).max(axis=1)]
        _, first, point = np.unique(keys, axis=0, return_index=True, return_inverse=True)
        point = point.ravel()
        self.points = np.asfortranarray(X[first])
        nodes, number = np.unique(dofs[first].reshape(-1, dim), axis=0, return_inverse=True)
        import scipy.sparse  # takes its time, and is for contact only

        rows = np.repeat(np.arange(len(first)), weights.shape[1])
        entries = (weights[first].ravel(), (rows, number.ravel()))
        self.map = scipy.sparse.csr_matrix(entries, shape=(len(first), len(nodes)))
        self.dofs = nodes
        cells = point[cells].astype(np.int32)
        corners = [(0, 1)] if cells.shape[1] == 2 else [(0, 1), (1, 2), (2, 0)]
        pairs = np.concatenate([np.sort(cells[:, pair], axis=1) for pair in corners])
        self.edges = np.asfortranarray(np.unique(pairs, axis=0).astype(np.int32))
        flat = cells if cells.shape[1] == 3 else np.empty((0, 3), np.int32)
        self.faces = np.asfortranarray(flat)
        self._own()

    def _facets(self, field: Field, measure: ufl.Measure, parts: int) -> tuple[Array, ...]:
        """This rank's points, their weights and global degrees of freedom, and pieces; local."""
        V = self._u.function_space
        cell = facet_type(V.mesh, measure)
        lattice, pieces = _lattice(cell, parts)
        rule, shares = basix.make_quadrature(cell, 2 * field.degree)
        inner = _inside(cell, lattice)
        X, weights, dofs = [], [], []
        for x, N, local in points_on(self._u, field, measure, np.concatenate([lattice, rule])):
            x, N, means = x[:, : len(lattice)], N[: len(lattice)], shares @ N[len(lattice) :]
            X.append(x.reshape(-1, x.shape[-1]))
            dofs.append(np.repeat(_global(V, local), len(lattice), axis=0))
            weights.append(
                np.tile(_even(N, means / shares.sum(), lattice, pieces, inner), (len(x), 1))
            )
        count = sum(len(x) for x in X) // len(lattice)
        cells = (np.arange(count)[:, None, None] * len(lattice) + pieces).reshape(
            -1, pieces.shape[1]
        )
        return np.concatenate(X), np.concatenate(weights), np.concatenate(dofs), cells

    def _own(self) -> None:
        """Find which of the nodes this rank has."""
        dofmap = self._u.function_space.dofmap
        first = dofmap.index_map.local_range[0] * dofmap.bs
        owned = dofmap.index_map.size_local * dofmap.bs
        local = self.dofs - first
        self._mine = np.flatnonzero(np.all((local >= 0) & (local < owned), axis=1))
        self._local = local[self._mine]

    def gathered(self, values: Array) -> Array:
        """Displacements of the points, from an array of the unknown, alike on all ranks."""
        total = np.zeros(self.dofs.shape)
        total[self._mine] = values[self._local]
        return self.map @ self._summed(total)

    def _summed(self, values: Array) -> Array:
        """Sum of the ranks' arrays, in place. Collective."""
        if self.comm.size > 1:
            self.comm.Allreduce(MPI.IN_PLACE, values)
        return values

    def places(self) -> Array:
        """Places of the points at u. Collective."""
        return np.asfortranarray(self.points + self.gathered(self._u.x.array))

    def own_forces(self, forces: Array) -> tuple[Array, Array]:
        """Forces at this rank's degrees of freedom: numbers, values. Collective.

        Args:
            forces: At the points, of this rank's share; those of all ranks are added up.
        """
        at_nodes = self._summed(self.map.T @ forces.reshape(self.points.shape))
        return self._local.ravel(), at_nodes[self._mine].ravel()

    def own_values(self, values: Array) -> tuple[Array, Array]:
        """Values at the points, as this rank's nodes have them, each from its nearest point.

        Returns:
            Numbers of the nodes' first components, and the values.
        """
        nearest = np.asarray(self.map.argmax(axis=0)).ravel()
        return self._local[:, 0], values[nearest][self._mine]

    def stiffness(self, H: Any, A: PETSc.Mat) -> PETSc.Mat:
        """Matrix of A's layout from a stiffness between the points. Collective.

        Args:
            H: Stiffness of this rank's share, sparse; those of all ranks are added up, in the
                order of the ranks.
            A: Matrix with the layout.
        """
        import scipy.sparse  # takes its time, and is for contact only

        dim, ranges = self.points.shape[1], A.getOwnershipRanges()
        # In blocks, which keep those of their entries that are zero: rows of nodes are alike.
        spread = scipy.sparse.kron(self.map, np.eye(dim), format="bsr")
        part = (spread.T @ H.tobsr(blocksize=(dim, dim)) @ spread).tocsr()
        names = self.dofs.ravel()
        # Nodes are sorted by the numbers of their first components, and so by their owners.
        parts = part.indptr[dim * np.searchsorted(self.dofs[:, 0], ranges)]
        rows = names[np.repeat(np.arange(len(names)), np.diff(part.indptr))]
        entries = rows, names[part.indices], part.data
        sent = [tuple(each[slice(*ends)] for each in entries) for ends in pairwise(parts)]
        found = self.comm.alltoall(sent) if self.comm.size > 1 else sent
        i, j, values = (np.concatenate(each) for each in zip(*found, strict=True))
        first = A.getOwnershipRange()[0]
        K = scipy.sparse.csr_matrix((values, (i - first, j)), shape=A.getSizes()[0])
        csr = K.indptr.astype(PETSc.IntType), K.indices.astype(PETSc.IntType), K.data
        return PETSc.Mat().createAIJ(A.getSizes(), A.getBlockSize(), csr=csr, comm=self.comm)


def _global(V: fem.FunctionSpace, dofs: Array) -> Array:
    """Global numbers of local degrees of freedom."""
    bs, imap = V.dofmap.bs, V.dofmap.index_map
    blocks = imap.local_to_global((dofs // bs).ravel().astype(np.int32))
    return np.asarray(blocks).reshape(dofs.shape) * bs + dofs % bs


def _inside(cell: basix.CellType, lattice: Array) -> Array:
    """Which points of a reference facet are on none of its edges."""
    last = 1 - lattice.sum(axis=1) if cell == basix.CellType.triangle else 1 - lattice.max(axis=1)
    return (lattice.min(axis=1) > SAME) & (last > SAME)


def _even(N: Array, means: Array, lattice: Array, pieces: Array, inner: Array) -> Array:
    """Values of shape functions at a facet's points, such that a uniform pressure is what it is.

    Forces at flat pieces are those of the trapezoid rule: of a pressure 1 they give the node of a
    quadratic facet's corner 2 / parts^2 more than its share, and the middle less. The points inside
    the facet take what is missing, which moves them by 1 / (12 parts^2) of the curvature.

    Args:
        N: Values, shape (points, functions).
        means: The functions' means over the facet.
        lattice: Points.
        pieces: Numbers of points.
        inner: Which points are inside.
    """
    corners = lattice[pieces]
    sides = corners[:, 1:] - corners[:, :1]
    sizes = np.abs(np.linalg.det(sides))
    shares: Array = np.zeros(len(lattice))
    np.add.at(shares, pieces, (sizes / (sizes.sum() * pieces.shape[1]))[:, None])
    if inner.any():
        N = N.copy()
        N[inner] += (means - shares @ N) / shares[inner].sum()
    return N


def _lattice(cell: basix.CellType, parts: int) -> tuple[Array, Array]:
    """Points on a reference facet, and segments or triangles between them."""
    s = np.linspace(0, 1, parts + 1)
    if cell == basix.CellType.interval:
        k = np.arange(parts)
        return s[:, None], np.stack([k, k + 1], axis=1)
    n = parts + 1
    if cell == basix.CellType.quadrilateral:
        x, y = np.meshgrid(s, s, indexing="ij")
        a = (np.arange(parts)[:, None] * n + np.arange(parts)).ravel()
        squares = np.stack([a, a + n, a + n + 1, a + 1], axis=1)
        halves = np.concatenate([squares[:, [0, 1, 2]], squares[:, [0, 2, 3]]])
        return np.c_[x.ravel(), y.ravel()], halves
    places = [(i, j) for i in range(n) for j in range(n - i)]
    number = {place: k for k, place in enumerate(places)}
    triangles = []
    for i, j in places:
        if i + j < parts:
            triangles.append([number[i, j], number[i + 1, j], number[i, j + 1]])
        if i + j < parts - 1:
            triangles.append([number[i + 1, j], number[i + 1, j + 1], number[i, j + 1]])
    return np.array(places, float) / parts, np.array(triangles)
