# SPDX-License-Identifier: MIT
"""Tangents from moduli at the points: the second derivatives of the energy there, kept or not.

Of a tangent's integral over cells, linear in the gradients of both its functions, all that depends
on the energy is a symmetric matrix at each point: the moduli, with respect to the gradients on the
reference cell. Of one that is linear in their values, as inertia's is, it is one with respect to
these. FFCx compiles them, as values at the points of the rule, and the rest is the same for every
energy: products and cell matrices of several cells at a time (kernels/moduli.h).
"""

from __future__ import annotations

import inspect
import time
from collections.abc import Callable
from typing import Any

from mpi4py import MPI

import basix
import numpy as np
import ufl
from numpy.typing import NDArray

from . import _dolfinx
from .batches import one_by_one, several
from .compilation import compiled
from .native import records
from .native.library import element_library, measured
from .splitting import form_of_moduli, is_shared, moduli_of, of_degree, split

ALIGNED = 64  # bytes: the largest vector register
REPEATS = 10  # of a measurement, of which the shortest counts
FEWEST = 500  # cells of a rank that can be measured: fewer are lost among the calls


class Moduli:
    """Moduli of the integrals of a tangent that have them.

    B[aA, bB] = w |det J| sum_ij d2psi/dG_ai dG_bj  J^-1_Ai J^-1_Bj,  G = grad u,

    at each point of weight w, J the Jacobian of the cell; symmetric, so that of 9 rows in space 45
    numbers are kept. With them  K = sum_q D^T B D,  D the gradients of the shape functions; or
    B[a, b] = w |det J| d2psi/du_a du_b,  and D their values.

    Args:
        tangent: Bilinear form, symmetric.

    Attributes:
        rest: Compiled integrals that have none: over facets, of values times gradients, of elements
            that are not those of one vector of Lagrange elements. None for nothing.
        rest_ufl: The same in UFL.
    """

    def __init__(self, tangent: ufl.Form) -> None:
        groups, rest = split(tangent)
        self.rest_ufl = ufl.Form(rest) if rest else None
        self.rest = compiled(self.rest_ufl) if rest else None
        self.rules = [_Rule(own, tangent, *kind) for kind, own in groups.items()]

    def fill(self) -> None:
        """Compute the moduli at the present state, to be kept for :meth:`multiply`. Local."""
        for rule in self.rules:
            rule.fill()

    def multiply(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> None:
        """Add K x to y by the moduli that were kept; both with room for ghosts. Local."""
        for rule in self.rules:
            rule.multiply(x, y)

    def seconds_over(self, mult: Callable[[], float], comm: MPI.Comm) -> float:
        """Time of a product over that of one with a matrix, measured once on this CPU. Collective.

        Once for each size of rank 0's part, up to a factor of two; 0 where that has too few cells.

        Args:
            mult: Function that does one with the rank's own part of a matrix, and takes its time.
            comm: Communicator.
        """
        cells = comm.bcast(self.rules[0].cells)
        if cells < FEWEST:
            return 0.0
        # A small matrix is in the CPU's caches.
        name = f"products {[rule.text for rule in self.rules]} {cells.bit_length()}"
        return measured(comm, name, lambda: self._over(mult))

    def _over(self, mult: Callable[[], float]) -> float:
        self.fill()
        x = np.ones(self.rules[0].size)
        y = np.zeros_like(x)

        def product() -> float:
            start = time.perf_counter()
            self.multiply(x, y)
            return time.perf_counter() - start

        # By turns, so that what else the machine does falls on both.
        seconds = np.array([(product(), mult()) for _ in range(REPEATS)])
        return float(np.divide(*seconds.min(axis=0)))

    def add(self, target: Any) -> int:
        """Add the tangent at the present state to the arrays of an insertion. Local.

        Returns:
            Number of cells left out, since the arrays have no places for them.
        """
        return sum(rule.add(target) for rule in self.rules)


class _Rule:
    """Moduli at the points of one rule.

    Args:
        integrals: Those of this rule, expanded.
        tangent: Form that they are of.
        derivatives: 1 of integrals of gradients, 0 of values.
        degree: Quadrature degree.
    """

    def __init__(
        self, integrals: list[Any], tangent: ufl.Form, derivatives: int, degree: int
    ) -> None:
        V: Any = tangent.arguments()[0].ufl_function_space()
        mesh, domain = V.mesh, tangent.ufl_domain()
        cell = getattr(basix.CellType, _dolfinx.cell_name(domain.ufl_cell()))
        shared = is_shared(integrals, domain)
        if shared:  # one point has them for all
            integrals = [of_degree(i, 0) for i in integrals]

        def derived() -> ufl.Form:
            return form_of_moduli(integrals, tangent, derivatives, 0 if shared else degree)

        recipe = f"{inspect.getsource(moduli_of)} {derivatives}"
        found = several(ufl.Form(integrals), derived, recipe)
        self._batch = one_by_one(derived()) if found is None else found
        points, weights = basix.make_quadrature(cell, degree)
        scales = np.sqrt(weights / weights.sum()) if shared else None
        self.text = _text(V, points, derivatives, scales)
        self.cells = mesh.topology.index_map(mesh.topology.dim).size_local
        self._lib, self._ffi = element_library(mesh.comm, self.text)
        self.size = (V.dofmap.index_map.size_local + V.dofmap.index_map.num_ghosts) * V.dofmap.bs
        self._numbers = np.ascontiguousarray(V.dofmap.list, np.int32)
        self._geometry, self._keep = records.geometry(self._ffi, mesh)
        self._kept: list[tuple[Any, Any, NDArray]] = []  # part, its cells, moduli

    def _at(self, kind: str, array: NDArray) -> Any:
        """Address of an array that lives as long as it is used."""
        return self._ffi.cast(kind, array.ctypes.data)

    def fill(self) -> None:
        """See :meth:`Moduli.fill`."""
        parts, constants = self._batch.parts(self._ffi), self._batch.constants()
        if not self._kept:
            width, numbers = self._lib.moduli_shape
            self._kept = [
                (part, kept[0], _aligned(-(-part.count // width) * width * numbers))
                for part, kept in parts
            ]
        for (part, _), (_, _, B) in zip(parts, self._kept, strict=True):
            self._lib.moduli_fill(
                part, self._geometry, self._at("double *", constants), self._at("double *", B)
            )

    def multiply(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> None:
        """See :meth:`Moduli.multiply`."""
        numbers, given, to = (
            self._at("int32_t *", self._numbers),
            self._at("double *", x),
            self._at("double *", y),
        )
        for part, _, B in self._kept:
            self._lib.moduli_product(part, numbers, self._at("double *", B), given, to)

    def add(self, target: Any) -> int:
        """See :meth:`Moduli.add`."""
        constants = self._batch.constants()
        given = self._ffi.cast("target_t *", target)
        return sum(
            self._lib.moduli_add(given, part, self._geometry, self._at("double *", constants))
            for part, _ in self._batch.parts(self._ffi)
        )


def _text(
    V: Any, points: NDArray[np.float64], derivatives: int, scales: NDArray[np.float64] | None
) -> str:
    """C code of an element at points, for kernels/moduli.h: its gradients, or its values.

    Scaled at each point where a cell has one set of moduli.
    """
    tables = V.element.basix_element.tabulate(derivatives, points)[derivatives:, :, :, 0]
    tables[abs(tables) < 1e-14] = 0  # shape (reference directions, points, nodes)
    if scales is not None:
        tables *= scales[:, None]
    written = repr(np.ascontiguousarray(tables.transpose(1, 2, 0)).tolist())
    corners = _dolfinx.geometry_dofmap(V.mesh).shape[1]
    dim, count, nodes = tables.shape
    return (
        f"#define NODES {nodes}\n#define POINTS {count}\n#define SIZE {V.dofmap.bs}\n"
        f"#define DIM {dim}\n#define CORNERS {corners}\n"
        f"#define SETS {count if scales is None else 1}\n"
        f"static const double G[{count}][{nodes}][{dim}] = "
        f"{written.replace('[', '{').replace(']', '}')};\n"
        '#include "moduli.h"\n'
    )


def _aligned(size: int) -> NDArray[np.float64]:
    """Room for numbers that vector registers are loaded from."""
    room = np.empty(size + ALIGNED // 8)
    start = -room.ctypes.data % ALIGNED // 8
    return room[start : start + size]
