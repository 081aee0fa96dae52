# SPDX-License-Identifier: MIT
"""Assembly of a tangent into the arrays of a PETSc AIJ matrix, at places found once.

PETSc looks for the place of every number again at each assembly, which costs more than computing
it. Here the places of each cell's blocks are found at the start, as numbers of two bytes, and the
kernels that DOLFINx would call are called in a loop of our own (kernels/insertion.h). Rows that
other ranks own go by PETSc's usual way.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from numpy.typing import NDArray

from . import _dolfinx, _petsc
from .native import records
from .native.library import library

_NAME = "variform_insertion"
_WIDTHS = {fem.IntegralType.cell: 1, fem.IntegralType.exterior_facet: 2}  # numbers of an entity


def create_matrix(form: fem.Form, conditions: Sequence[fem.DirichletBC] = ()) -> PETSc.Mat:
    """AIJ matrix for :func:`assemble`. Collective.

    Assembly is fast for integrals over cells and exterior facets on one space whose functions need
    no change of sign from cell to cell, as those of Lagrange elements; other forms are assembled
    as DOLFINx does it.

    Args:
        form: Bilinear form.
        conditions: Boundary conditions that will be assembled with it.
    """
    if not _possible(form):
        return fem_petsc.create_matrix(form)
    pattern = fem.create_sparsity_pattern(form)
    pattern.finalize()
    A = _zeros(form.mesh.comm, pattern, form.function_spaces[0].dofmap.index_map_bs)
    try:
        insertion = _Insertion(A, pattern, form, conditions)
    except OverflowError:
        insertion = None
    # A row may be too long on one rank only.
    if form.mesh.comm.allreduce(insertion is not None, MPI.LAND):
        A.setAttr(_NAME, insertion)
    return A


def assemble(
    A: PETSc.Mat,
    form: fem.Form,
    conditions: Sequence[fem.DirichletBC],
    moduli: Any = None,
) -> None:
    """Assemble a bilinear form into a matrix, supported rows and columns those of identity.

    Collective.

    Args:
        A: Matrix of :func:`create_matrix` with the same boundary conditions, or any other.
        form: Form on the spaces, and with the integrals, of that which the matrix was made for.
        conditions: Boundary conditions.
        moduli: The form's :class:`forms.moduli.Moduli`, by which it is then assembled.

    Raises:
        ValueError: the form is integrated over cells that the matrix was not made for.
    """
    insertion = A.getAttr(_NAME)
    if insertion is not None:
        insertion.assemble(A, form if moduli is None else moduli.rest, moduli)
        return
    A.zeroEntries()
    # mypy sees the first of two overloads only.
    fem_petsc.assemble_matrix(A, form, list(conditions))  # type: ignore[arg-type]
    A.assemble()


def _possible(form: fem.Form) -> bool:
    """Whether our loop knows everything that the form needs; alike on all ranks."""
    cpp, spaces = form._cpp_object, form.function_spaces
    return (
        "_kernels" in vars(form)
        and (PETSc.ScalarType, PETSc.IntType) == (np.float64, np.int32)
        and all(kind in _WIDTHS for kind in cpp.integral_types)
        and not cpp.needs_facet_permutations
        and spaces[0] == spaces[1]
        and not spaces[0].element.needs_dof_transformations
    )


def _zeros(comm: MPI.Comm, pattern: Any, size: int) -> PETSc.Mat:
    """AIJ matrix with a zero stored at each entry of a pattern of square blocks. Collective.

    Its arrays are written at once: to let PETSc place a zero at each entry costs more than an
    assembly.
    """
    lib, ffi = library(comm)
    nodes, pointers = (np.ascontiguousarray(array) for array in pattern.graph)
    imap, names = pattern.index_map(0), _dolfinx.column_map(pattern)
    owned = imap.size_local
    pointers = pointers[: owned + 1].astype(np.int64)
    found = names.local_to_global(nodes[: pointers[-1]].astype(np.int32)).astype(np.int64)
    rows = np.empty(owned * size + 1, PETSc.IntType)
    columns = np.empty(pointers[-1] * size**2, PETSc.IntType)
    lib.insertion_rows(
        owned,
        size,
        ffi.cast("int64_t *", pointers.ctypes.data),
        ffi.cast("int64_t *", found.ctypes.data),
        ffi.cast("int32_t *", rows.ctypes.data),
        ffi.cast("int32_t *", columns.ctypes.data),
    )
    local, total = owned * size, imap.size_global * size
    A = PETSc.Mat().createAIJWithArrays(
        ((local, total), (local, total)), (rows, columns, np.zeros(len(columns))), comm=comm
    )
    A.setBlockSize(size)
    if comm.size > 1:  # there PETSc has copied the arrays
        A.setAttr("__csr__", None)
    for option in (
        PETSc.Mat.Option.NEW_NONZERO_LOCATION_ERR,
        PETSc.Mat.Option.KEEP_NONZERO_PATTERN,
    ):
        A.setOption(option, True)
    maps = []
    for m in (imap, names):
        numbers = np.arange(m.size_local + m.num_ghosts, dtype=np.int32)
        known = m.local_to_global(numbers).astype(PETSc.IntType)
        maps.append(PETSc.LGMap().create(known, bsize=size, comm=comm))
    A.setLGMap(*maps)
    return A


class _Insertion:
    """Places of all cells' blocks in a matrix, and the loop that adds to them.

    Args:
        A: Matrix with a number stored at each of its places.
        pattern: Its sparsity pattern.
        form: Form that it is made for.
        conditions: Boundary conditions.

    Raises:
        OverflowError: a row is too long for places of two bytes.
    """

    def __init__(
        self, A: PETSc.Mat, pattern: Any, form: fem.Form, conditions: Sequence[fem.DirichletBC]
    ) -> None:
        self._lib, self._ffi = library(form.mesh.comm)
        V: Any = form.function_spaces[0]  # DOLFINx's own, in C++
        mesh = form.mesh
        imap = mesh.topology.index_map(mesh.topology.dim)
        cells = imap.size_local + imap.num_ghosts
        owned, size = V.dofmap.index_map.size_local, V.dofmap.bs
        numbers = np.ascontiguousarray(V.dofmap.map()[:cells], np.int32)
        ghosts = V.dofmap.index_map.ghosts
        self._held = np.zeros((owned + len(ghosts)) * size, np.int8)
        for condition in conditions:
            self._held[condition.dof_indices()[0]] = 1
        nodes = numbers.shape[1]
        self._places = np.empty((cells, nodes, nodes), np.int16)
        parts, beside = _petsc.parts(A)
        self._waiting = _ghost_rows(pattern, owned, size)
        parts.append(self._waiting.part)
        # A node's columns begin, in the diagonal part, at its number; beside it they are counted.
        first = np.concatenate(
            [np.arange(owned) * size, np.searchsorted(beside, ghosts * size)]
        ).astype(np.int32)
        self._matrix = self._ffi.new("target_t *")
        self._matrix.cells, self._matrix.owned = cells, owned
        self._matrix.size, self._matrix.nodes = size, nodes
        self._matrix.numbers, self._matrix.places = self._at(numbers), self._at(self._places)
        self._matrix.held = self._at(self._held)
        self._matrix.rows = [self._at(part.rows) for part in parts]
        columns = self._ffi.new("int32_t *[3]", [self._at(part.columns) for part in parts])
        held = np.flatnonzero(self._held[: owned * size]).astype(np.int32)
        self._diagonal = np.empty_like(held)
        # Only these have entries in the pattern: an own facet of a ghost cell, but not each ghost.
        met = np.zeros(cells, np.int8)
        for kind, entities, _ in _dolfinx.integrals(form):
            met[entities.reshape(-1, _WIDTHS[kind])[:, 0]] = 1
        found = self._lib.insertion_places(
            self._matrix, self._at(met), columns, self._at(first), self._at(self._places)
        ) and self._lib.insertion_diagonal(
            self._matrix.rows[0], columns[0], len(held), self._at(held), self._at(self._diagonal)
        )
        if not found:
            raise OverflowError("a row of the tangent is too long for places of two bytes.")
        self._geometry, places = records.geometry(self._ffi, mesh)
        self._room = np.empty((nodes * size) ** 2), np.empty(3 * self._geometry.nodes)
        self._keep = numbers, places, [part.rows for part in parts]

    def _at(self, array: NDArray) -> Any:
        """Address of an array that lives as long as it is used."""
        return records.address(self._ffi, array)

    def assemble(self, A: PETSc.Mat, form: fem.Form | None, moduli: Any = None) -> None:
        """See the function of that name, the form without what has moduli. Collective."""
        own, waiting = _petsc.values(A), self._waiting
        for values in (*own, waiting.part.values):
            values[:] = 0
        self._matrix.values = [self._at(v) for v in (own[0], own[-1], waiting.part.values)]
        left_out = 0 if moduli is None else moduli.add(self._matrix)
        if form is not None:
            left_out += self._add(form)
        own[0][self._diagonal] = 1
        if waiting.rows.size:
            starts, values = waiting.part.rows, waiting.part.values
            add = PETSc.InsertMode.ADD_VALUES
            A.setValuesIJV(starts, waiting.columns, values, addv=add, rowmap=waiting.rows)
        A.assemble()
        left_out = A.comm.tompi4py().allreduce(left_out)
        if left_out:
            raise ValueError(
                f"{left_out} cells or facets of the form are none of those that the matrix was "
                "made for: make a matrix for this form."
            )

    def _add(self, form: fem.Form) -> int:
        """Add a form's integrals; the number of entities without places. Local."""
        constants, left_out = _dolfinx.constants(form), 0
        integrals = zip(vars(form)["_kernels"], _dolfinx.integrals(form), strict=True)
        for kernel, (kind, entities, coefficients) in integrals:
            facets = kind == fem.IntegralType.exterior_facet
            part, _kept = records.part(self._ffi, kernel, entities, coefficients, facets=facets)
            left_out += self._lib.insertion_add(
                self._matrix, part, self._geometry, self._at(constants), *map(self._at, self._room)
            )
        return left_out


class _Waiting(NamedTuple):
    """Rows that other ranks own, and their columns, by global numbers."""

    rows: NDArray[np.int32]
    columns: NDArray[np.int32]
    part: _petsc.Part


def _ghost_rows(pattern: Any, owned: int, size: int) -> _Waiting:
    """Room for the rows of ghosts."""
    nodes, starts = (np.asarray(array) for array in pattern.graph)
    nodes, starts = nodes[starts[owned] :].astype(np.int32), starts[owned:] - starts[owned]
    lengths = np.repeat(np.diff(starts) * size, size)
    rows = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int32)

    def unrolled(numbers: NDArray) -> NDArray[np.int32]:
        whole = (numbers[:, None] * size + np.arange(size)).astype(np.int32)
        parts = [np.tile(whole[a:b].ravel(), size) for a, b in itertools.pairwise(starts)]
        return np.concatenate([*parts, np.empty(0, np.int32)])

    # Not PETSc's local numbers: its map of the columns is not that of the pattern.
    ghosts = pattern.index_map(0).ghosts[:, None] * size + np.arange(size)
    columns = unrolled(_dolfinx.column_map(pattern).local_to_global(nodes))
    part = _petsc.Part(rows, unrolled(nodes), np.zeros(len(columns)))
    return _Waiting(ghosts.ravel().astype(np.int32), columns, part)
