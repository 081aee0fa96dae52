# SPDX-License-Identifier: MIT
"""Supports along directions of their own, which no component of the displacement has.

A node's displacements that they leave free are a line or a plane, with the projection
P = I - sum_k r_k r_k^T onto it, the r_k orthonormal. The unknown keeps its components; where a
supported component has the row and column of identity, such a node has P K P + s (I - P) and P R,
and steps begin and end in the plane.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any
from zlib import crc32

from mpi4py import MPI
from petsc4py import PETSc

import basix
import numpy as np
import ufl
from dolfinx import fem, la
from dolfinx.mesh import meshtags
from numpy.typing import NDArray

from . import _checks, _dolfinx, _petsc
from .boundaries import facet_type
from .compilation import compiled
from .native import jit
from .unknowns import Field

Array = NDArray[np.float64]
_NAME = "variform_slants"
SAME = 1e-6  # sine of the angle to other supports' directions below which nothing is left to hold
TURN = np.cos(np.deg2rad(40))  # mean of the facets' normals at a node, over their sizes
EPS = float(np.finfo(float).eps)


@dataclass(frozen=True, eq=False)
class Slant:
    """Nodes that do not move along a direction each, or as prescribed; local, ghosts included.

    Attributes:
        dofs: Numbers of a node's components in the unknown, shape (nodes, d).
        normals: Its direction n, of length 1, shape (nodes, d).
        value: Function whose values are the prescribed u . n; None for 0.
        at: The nodes' numbers in it.
    """

    dofs: NDArray[np.int32]
    normals: Array
    value: Any = None
    at: Any = None


def slant(w: fem.Function, field: Field, facets: NDArray[np.int32], direction: Any) -> Slant:
    """Directions at the nodes of facets: given ones, or the facets' normals. Collective.

    Args:
        w: Unknown.
        field: Its displacement.
        facets: Local facet indices.
        direction: Vector of any length, of numbers or in UFL, evaluated once; None for the normals.

    Raises:
        ValueError: a direction of length 0, or of another shape; no facets on any rank; facets that
            have no normal, or that meet at an edge.
    """
    mesh, dim = w.function_space.mesh, field.components
    facets = _checks.facets(mesh, facets)
    W, numbers = field.collapsed
    nodes = np.sort(fem.locate_dofs_topological(W, mesh.topology.dim - 1, facets))
    n = fem.Function(W)
    if direction is None:
        _put_normals(n, field, facets, nodes)
    else:
        given = _checks.vector(direction, (dim,), "a roller's direction")
        _checks.same_space(given, mesh, "a roller's direction")
        if ufl.algorithms.analysis.extract_type(given, ufl.classes.FacetNormal):
            raise ValueError(
                "a roller's direction is evaluated at nodes: leave it out for the facets' normals."
            )
        numbers_ = [_checks.number(entry) for entry in getattr(given, "ufl_operands", ())]
        if isinstance(given, ufl.classes.ListTensor) and None not in numbers_:
            n.x.array.reshape(-1, dim)[:] = numbers_
        else:
            n.interpolate(jit.expression(given, _dolfinx.interpolation_points(W), mesh))
            n.x.scatter_forward()
    normals = n.x.array.reshape(-1, dim)[nodes]
    lengths = np.linalg.norm(normals, axis=1)
    bad = ~(np.isfinite(lengths) & (lengths > 0))
    _refuse(W, nodes[bad], "a roller needs a direction of a length above 0, got none at {}.")
    return Slant(numbers.reshape(-1, dim)[nodes], normals / lengths[:, None])


def coordinate_axis(slant: Slant, comm: MPI.Comm) -> tuple[int, float] | None:
    """The axis of coordinates that all directions are along, and their sign. Collective."""
    for sign in (1.0, -1.0):
        least = np.min(comm.allgather((sign * slant.normals).min(axis=0, initial=1.0)), axis=0)
        axis = int(np.argmax(least))
        if least[axis] > 1 - 1e-14:
            return axis, sign
    return None


def _put_normals(
    n: fem.Function, field: Field, facets: NDArray[np.int32], nodes: NDArray[np.int32]
) -> None:
    """Sum of the normals of the facets at each node, over their sizes there. Collective."""
    W = n.function_space
    mesh, fdim = W.mesh, W.mesh.topology.dim - 1
    if mesh.topology.dim != mesh.geometry.dim:
        raise ValueError(
            "the edges of a surface have no normals of their own: give the roller a direction."
        )
    facets = np.unique(facets).astype(np.int32)
    tags = meshtags(mesh, fdim, facets, np.ones(len(facets), np.int32))
    ds = ufl.ds(1, domain=mesh, subdomain_data=tags)
    # Values at the nodes alone, so that each has a part of every facet.
    kind, lagrange = basix.ElementFamily.P, basix.LagrangeVariant.gll_warped
    points = basix.create_element(kind, facet_type(mesh, ds), field.degree, lagrange).points
    rule = {
        "quadrature_rule": "custom",
        "quadrature_points": tuple(tuple(map(float, point)) for point in points),
        "quadrature_weights": (1.0,) * len(points),
        "quadrature_degree": field.degree,
    }
    v, one = ufl.TestFunction(W), ufl.as_vector([1.0] + [0.0] * (field.components - 1))
    sums = []
    for direction in (ufl.FacetNormal(mesh), one):
        b = la.vector(W.dofmap.index_map, W.dofmap.index_map_bs)
        b.array[:] = 0
        fem.assemble_vector(b.array, compiled(ufl.inner(direction, v) * ds(metadata=rule)))
        b.scatter_reverse(la.InsertMode.add)
        b.scatter_forward()
        sums.append(b.array.reshape(-1, field.components)[nodes])
    normals, sizes = sums[0], sums[1][:, 0]
    inner = sizes == 0
    _refuse(W, nodes[inner], "facets inside a body, as at {}, have no normal: give a direction.")
    means = np.linalg.norm(normals, axis=1) / np.abs(np.where(inner, 1.0, sizes))
    _refuse(
        W,
        nodes[means < TURN],
        "the facets of a roller turn too much at {} to have a normal there: give each smooth side "
        "a roller of its own, or this one a direction.",
    )
    n.x.array.reshape(-1, field.components)[nodes] = normals


def _refuse(W: fem.FunctionSpace, nodes: NDArray[np.int32], sentence: str) -> None:
    """Refuse what is wrong at some nodes on any rank. Collective."""
    x = W.tabulate_dof_coordinates()[:, : W.mesh.geometry.dim]
    places = np.where(np.abs(x[nodes]) < 1e-9 * np.abs(x).max(initial=0.0), 0.0, x[nodes])
    found = [tuple(place) for part in W.mesh.comm.allgather(places.tolist()) for place in part]
    if found:
        where = ", ".join(f"{coordinate:.4g}" for coordinate in min(found))
        raise ValueError(sentence.format(f"({where})"))


class Slants:
    """All slanted supports of a problem, node by node, beside supported components.

    At a node with several, or with supported components, all hold: what the others leave free of a
    direction counts, and nothing where that is less than 1e-6 of it.

    Args:
        space: Space of the unknown.
        listed: Slanted supports, the stronger ones first.
        held: Numbers of the components that other supports prescribe, ghosts included.

    Attributes:
        dofs: Numbers of each node's components, shape (nodes, d), the own nodes first.
        rows: Orthonormal directions r_k that are held, shape (nodes, d, d), rows of 0 behind.
        given: Prescribed r_k . u by the node's supported components, shape (nodes, d, d).
        weights: Prescribed r_k . u by the supports' own values, shape (nodes, d, supports).
        free: P, shape (nodes, d, d).
    """

    def __init__(
        self, space: fem.FunctionSpace, listed: Sequence[Slant], held: NDArray[np.int32]
    ) -> None:
        dofmap = space.dofmap
        self._space, dim = space, listed[0].dofs.shape[1]
        self._owned = dofmap.index_map.size_local * dofmap.bs
        size = self._owned + dofmap.index_map.num_ghosts * dofmap.bs
        first = np.unique(np.concatenate([s.dofs[:, 0] for s in listed]))
        node = np.full(size, -1, np.int64)
        node[first] = np.arange(len(first))
        self.dofs = np.zeros((len(first), dim), np.int32)
        supported = np.zeros(size, bool)
        supported[held] = True
        self.rows, self.given = (np.zeros((len(first), dim, dim)) for _ in range(2))
        self.weights = np.zeros((len(first), dim, len(listed)))
        self._values = [(k, s, node[s.dofs[:, 0]]) for k, s in enumerate(listed) if s.value]
        rank = np.zeros(len(first), np.int64)
        for k, s in enumerate(listed):
            at = node[s.dofs[:, 0]]
            self.dofs[at] = s.dofs
            fixed = supported[s.dofs]
            r, g = np.where(fixed, 0.0, s.normals), np.where(fixed, -s.normals, 0.0)
            h = np.tile(np.eye(len(listed))[k], (len(at), 1))
            for _ in range(2):  # twice is enough for orthogonality to rounding
                along = np.einsum("nki,ni->nk", self.rows[at], r)
                r = r - np.einsum("nk,nki->ni", along, self.rows[at])
                g = g - np.einsum("nk,nki->ni", along, self.given[at])
                h = h - np.einsum("nk,nki->ni", along, self.weights[at])
            length = np.linalg.norm(r, axis=1)
            new = length > SAME
            at, length = at[new], length[new, None]
            self.rows[at, rank[at]], self.given[at, rank[at]] = r[new] / length, g[new] / length
            self.weights[at, rank[at]] = h[new] / length
            rank[at] += 1
        self.free = np.eye(dim) - np.einsum("nki,nkj->nij", self.rows, self.rows)
        self._rank, self._scale = rank, np.ones(len(first))
        self._own = int(np.searchsorted(first, self._owned))

    @property
    def count(self) -> int:
        """Directions that are held at own nodes."""
        return int(self._rank[: self._own].sum())

    def _part(self, array: Any) -> slice:
        """Nodes of an array with ghosts, or of own entries only."""
        return slice(None if len(array) > self._owned else self._own)

    def clear(self, array: Any) -> None:
        """Replace x by P x; local."""
        part = self._part(array)
        dofs = self.dofs[part]
        array[dofs] = np.einsum("nij,nj->ni", self.free[part], array[dofs])

    def prescribe(self, array: Any) -> None:
        """Put the prescribed r_k . u into an array that has the other supports' values; local."""
        part = self._part(array)
        dofs, rows, given = self.dofs[part], self.rows[part], self.given[part]
        x = array[dofs]
        wrong = np.einsum("nki,ni->nk", given - rows, x)
        wrong += self._own_values()[part]
        # What rounding leaves stays, so that a second time changes nothing.
        wrong[np.abs(wrong) <= 4 * EPS * np.abs(x).max(axis=1, initial=0.0)[:, None]] = 0
        array[dofs] = x + np.einsum("nk,nki->ni", wrong, rows)

    def _own_values(self) -> Array:
        """Prescribed r_k . u by the supports' present values, shape (nodes, d)."""
        values = np.zeros(self.weights.shape[::2])
        for k, s, at in self._values:
            values[at, k] = s.value.x.array[s.at]
        return np.einsum("nks,ns->nk", self.weights, values)

    def put(self, array: Any, values: Any) -> None:
        """Give an array another one's r_k . u at own nodes; local."""
        dofs, free = self.dofs[: self._own], self.free[: self._own]
        change = values[dofs] - array[dofs]
        array[dofs] += change - np.einsum("nij,nj->ni", free, change)

    def pull(self, array: Any) -> None:
        """Add to forces on supported components those that go through the directions; local."""
        part = self._part(array)
        dofs = self.dofs[part]
        along = np.einsum("nki,ni->nk", self.rows[part], array[dofs])
        array[dofs] += np.einsum("nk,nki->ni", along, self.given[part])

    def held(self, modes: Array, dofs: NDArray[np.int32]) -> Array:
        """Rows r_k . v of own nodes, shape (k, columns), of columns v of some entries; local."""
        place = np.zeros(self._owned, np.int64)
        place[dofs] = np.arange(len(dofs))
        at = place[self.dofs[: self._own]]
        rows = np.einsum("nki,nic->nkc", self.rows[: self._own], modes[at])
        return np.asarray(rows.reshape(-1, modes.shape[1]))

    def mix(self, x: Any, y: Any) -> None:
        """Complete y = P K P x to (P K P + s (I - P)) x, own entries; local."""
        dofs, scale = self.dofs[: self._own], self._scale[: self._own, None]
        beside = x[dofs] - np.einsum("nij,nj->ni", self.free[: self._own], x[dofs])
        self.clear(y)
        y[dofs] += scale * beside

    def apply(self, A: PETSc.Mat, size: float | None = None) -> None:
        """Replace K by P K P + s (I - P). Collective.

        Args:
            A: Assembled AIJ matrix of the unknown's layout, in whose pattern all components of two
                nodes are joined if any are.
            size: s; by default the mean of the node's own diagonal entries in K.
        """
        places, (own, dim) = self._places(A), (slice(self._own), self.dofs.shape[1])
        scale: Any = np.full(self._own, 1.0 if size is None else size)
        if size is None:
            diagonal = np.abs(np.einsum("nii->ni", _petsc.values(A)[0][places.blocks]))
            scale = np.where(diagonal.any(axis=1), diagonal.mean(axis=1), 1.0)
            self._scale[own] = scale
        for values, (columns, free, rows, at) in zip(_petsc.values(A), places.parts, strict=True):
            values[columns] = np.einsum("mj,mji->mi", values[columns], free)
            values[rows] = np.einsum("mij,jm->im", self.free[at], values[rows])
        values = _petsc.values(A)[0]
        beside = scale[:, None, None] * (np.eye(dim) - self.free[own])
        values[places.blocks] += beside
        A.assemble()

    def matrix(self, order: NDArray[np.int32] | None = None) -> PETSc.Mat:
        """P, identity at all other rows. Collective.

        Args:
            order: Owned numbers of the unknown whose rows are meant, ascending; by default all.
        """
        rows: Any = np.arange(self._owned) if order is None else order
        place = np.full(self._owned, -1, np.int64)
        place[rows] = np.arange(len(rows))
        dofs, dim = place[self.dofs[: self._own]], self.dofs.shape[1]
        count, layout = len(rows), PETSc.Vec().createMPI((len(rows), None), comm=self._comm)
        first = layout.getOwnershipRange()[0]
        layout.destroy()
        slanted = np.zeros(count, bool)
        slanted[dofs] = True
        lengths = np.where(slanted, dim, 1)
        pointers: Any = np.concatenate([[0], np.cumsum(lengths)]).astype(PETSc.IntType)
        columns, values = np.zeros(pointers[-1], PETSc.IntType), np.ones(pointers[-1])
        columns[pointers[:-1][~slanted]] = np.flatnonzero(~slanted)
        at = pointers[dofs][:, :, None] + np.arange(dim)
        ordered = np.argsort(dofs, axis=1)  # columns of a row ascend
        sorted_dofs = np.take_along_axis(dofs, ordered, axis=1)
        columns[at] = sorted_dofs[:, None, :]
        values[at] = np.take_along_axis(self.free[: self._own], ordered[:, None, :], axis=2)
        sizes = ((count, None), (count, None))
        csr = pointers, (columns + first).astype(PETSc.IntType), values
        return PETSc.Mat().createAIJ(sizes, csr=csr, comm=self._comm)

    @property
    def _comm(self) -> MPI.Comm:
        return self._space.mesh.comm

    def _places(self, A: PETSc.Mat) -> _Places:
        """Where the nodes' entries are in a matrix, found once for each pattern."""
        parts, beside = _petsc.parts(A)
        parts = parts[: len(_petsc.values(A))]  # on one rank both are the same
        # Contact may put another pattern in the matrix.
        key = [(len(part.columns), crc32(part.columns.data)) for part in parts]
        kept = A.getAttr(_NAME)
        same = kept is not None and kept.of is self and kept.key == key
        if self._comm.allreduce(same, MPI.LAND):
            return kept
        first, (own, dim) = A.getOwnershipRange()[0], (self._own, self.dofs.shape[1])
        # A row may have columns that this rank has no ghosts of: a column brings its node along.
        table = np.zeros((self._owned, 2 + dim))
        dofs = self.dofs[:own]
        table[dofs, 0] = 1 + first + dofs[:, :1]
        table[dofs, 1] = np.arange(dim)
        table[dofs, 2:] = self.free[:own]
        tables = [table, *([_fetched(A, table, beside)] if len(parts) == 2 else [])]
        listed, blocks = [], np.zeros((own, dim, dim), np.int64)
        for k, (part, of) in enumerate(zip(parts, tables, strict=True)):
            columns, row, free = _columns(part, of)
            listed.append((columns, free, *_rows(part, dofs)))
            if k == 0:
                node = np.full(self._owned, -1, np.int64)
                node[dofs] = np.arange(own)[:, None]
                mine = table[row, 0] == table[part.columns[columns[:, 0]], 0]
                at = row[mine]
                blocks[node[at], table[at, 1].astype(int)] = columns[mine]
        places = _Places(self, key, listed, blocks)
        A.setAttr(_NAME, places)
        return places


@dataclass(frozen=True, eq=False)
class _Places:
    """Places in a matrix's values: nodes' columns, with P, and rows in each part; own blocks."""

    of: Slants
    key: list[tuple[int, int]]
    parts: list[tuple[Any, Any, Any, Any]]
    blocks: NDArray[np.int64]


def _fetched(A: PETSc.Mat, table: Array, columns: NDArray[np.int32]) -> Array:
    """Rows of a table over a matrix's columns, by global numbers. Collective."""
    found = np.zeros((len(columns), table.shape[1]))
    whole, part = A.createVecRight(), PETSc.Vec().createSeq(len(columns))
    source = PETSc.IS().createGeneral(columns.astype(PETSc.IntType), comm=PETSc.COMM_SELF)
    scatter = PETSc.Scatter().create(whole, source, part, None)
    for k, values in enumerate(table.T):
        whole.array[:] = values
        scatter.scatter(whole, part, addv=PETSc.InsertMode.INSERT_VALUES)
        found[:, k] = part.array_r
    for item in (whole, part, source, scatter):
        item.destroy()
    return found


def _columns(part: _petsc.Part, table: Array) -> tuple[Any, Any, Any]:
    """Places of a node's entries in a row, shape (m, d), the rows, and P of the nodes."""
    dim = table.shape[1] - 2
    slanted = table[:, 0] > 0
    where = np.flatnonzero(slanted[part.columns])
    columns = part.columns[where]
    row = np.searchsorted(part.rows, where, side="right") - 1
    order = np.lexsort((table[columns, 1], table[columns, 0], row))
    where, row, columns = (a[order].reshape(-1, dim) for a in (where, row, columns))
    return where, row[:, 0], table[columns, 2:]


def _rows(part: _petsc.Part, dofs: NDArray[np.int32]) -> tuple[Any, Any]:
    """Places of a node's rows, shape (d, m), and the nodes of each of the m columns."""
    starts, lengths = part.rows[dofs], part.rows[dofs[:, 0] + 1] - part.rows[dofs[:, 0]]
    of = np.repeat(np.arange(len(dofs)), lengths)
    offset = np.arange(len(of)) - np.repeat(np.cumsum(lengths) - lengths, lengths)
    return starts[of].T + offset, of
