# SPDX-License-Identifier: MIT
"""Tangents from moduli at the points: the second derivatives of the energy there, kept or not.

Of a tangent's integral over cells, linear in the gradients of both its functions, all that depends
on the energy is a symmetric matrix at each point: the moduli, with respect to the gradients on the
reference cell. FFCx compiles them, as values at the points of the rule, and the rest is the same
for every energy: products and cell matrices of several cells at a time (kernels/moduli.h).
"""

from __future__ import annotations

import inspect
import time
from collections.abc import Callable
from typing import Any

from mpi4py import MPI

import basix
import basix.ufl
import numpy as np
import ufl
from numpy.typing import NDArray
from ufl.algorithms import expand_derivatives

from . import _dolfinx
from ._types import Expr
from .batches import is_over_cells, one_by_one, several
from .compilation import compiled
from .differentiation import expanded, nodes
from .entities import with_owned_entities
from .native import records
from .native.library import element_library, measured
from .quadrature import with_quadrature

ALIGNED = 64  # bytes: the largest vector register
REPEATS = 5  # of a measurement, of which the shortest counts
FEWEST = 500  # cells of a rank that can be measured: fewer are lost among the calls
MOST_NODES = 64  # of a cell: the matrices of several lie on the stack


class Moduli:
    """Moduli of the integrals of a tangent that have them.

    B[aA, bB] = w |det J| sum_ij d2psi/dG_ai dG_bj  J^-1_Ai J^-1_Bj,  G = grad u,

    at each point of weight w, J the Jacobian of the cell; symmetric, so that of 9 rows in space 45
    numbers are kept. With them  K = sum_q D^T B D,  D the gradients of the shape functions.

    Args:
        tangent: Bilinear form, symmetric.

    Attributes:
        rest: Compiled integrals that have none: over facets, of the functions themselves, of
            elements that are not those of one vector of Lagrange elements. None for nothing.
        rest_ufl: The same in UFL.
    """

    def __init__(self, tangent: ufl.Form) -> None:
        own, rest = split(tangent)
        self.rest_ufl = ufl.Form(rest) if rest else None
        self.rest = compiled(self.rest_ufl) if rest else None
        degrees = sorted({i.metadata()["quadrature_degree"] for i in own})
        self.rules = [
            _Rule([i for i in own if i.metadata()["quadrature_degree"] == d], tangent, d)
            for d in degrees
        ]

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

        0 where rank 0 has too few cells to tell.

        Args:
            mult: Function that does one with the rank's own part of a matrix, and takes its time.
            comm: Communicator.
        """
        if comm.bcast(self.rules[0].cells) < FEWEST:
            return 0.0
        return measured(
            comm, f"products {[rule.text for rule in self.rules]}", lambda: self._over(mult)
        )

    def _over(self, mult: Callable[[], float]) -> float:
        self.fill()
        x = np.ones(self.rules[0].size)
        y = np.zeros_like(x)

        def product() -> float:
            start = time.perf_counter()
            self.multiply(x, y)
            return time.perf_counter() - start

        return min(product() for _ in range(REPEATS)) / min(mult() for _ in range(REPEATS))

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
        degree: Quadrature degree.
    """

    def __init__(self, integrals: list[Any], tangent: ufl.Form, degree: int) -> None:
        V: Any = tangent.arguments()[0].ufl_function_space()
        mesh, domain = V.mesh, tangent.ufl_domain()
        cell = getattr(basix.CellType, _dolfinx.cell_name(domain.ufl_cell()))
        rows = V.dofmap.bs * mesh.topology.dim
        element = basix.ufl.quadrature_element(cell, degree=degree)
        values = basix.ufl.blocked_element(element, shape=(rows * (rows + 1) // 2,))
        test = ufl.TestFunction(ufl.FunctionSpace(domain, values))

        def derived() -> ufl.Form:
            made = [ufl.inner(_moduli(i, tangent), test) for i in integrals]
            pairs = zip(integrals, made, strict=True)
            return ufl.Form([i.reconstruct(integrand=m) for i, m in pairs])

        recipe = inspect.getsource(_moduli)
        found = several(ufl.Form(integrals), derived, recipe)
        self._batch = one_by_one(derived()) if found is None else found
        points = basix.make_quadrature(cell, degree)[0]
        self.text = _text(V, points)
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


def split(tangent: ufl.Form) -> tuple[list[Any], list[Any]]:
    """Integrals of a tangent that have moduli, expanded, and those that have none."""
    form = with_quadrature(with_owned_entities(expand_derivatives(expanded(tangent))))
    own: list[Any] = []
    rest: list[Any] = []
    fits = _is_one_vector(tangent)
    for integral in form.integrals():
        (own if fits and _has_moduli(integral) else rest).append(integral)
    return own, rest


def _is_one_vector(tangent: ufl.Form) -> bool:
    """Whether both arguments are those of one vector of Lagrange elements."""
    V, other = (a.ufl_function_space() for a in tangent.arguments())
    element = V.ufl_element()
    return bool(
        V == other
        and V.dofmap.bs == element.block_size > 1
        and element.reference_value_shape == (element.block_size,)
        and element.family_name == "P"
        and not V.element.needs_dof_transformations
        and V.dofmap.list.shape[1] <= MOST_NODES
    )


def _has_moduli(integral: Any) -> bool:
    """Whether an integral over cells contains its arguments in gradients only."""
    if not is_over_cells(integral):
        return False
    gradient, argument = ufl.classes.Grad, ufl.classes.Argument
    pairs = [(e, o) for e in nodes(integral.integrand()) for o in e.ufl_operands]
    alone = any(isinstance(o, argument) and not isinstance(e, gradient) for e, o in pairs)
    second = any(isinstance(e, gradient) and isinstance(o, gradient) for e, o in pairs)
    return not (alone or second)


def _moduli(integral: Any, tangent: ufl.Form) -> Expr:
    """Upper triangle of the moduli, without the weights and the volume, as a vector."""
    test, trial = tangent.arguments()
    inverse = ufl.JacobianInverse(tangent.ufl_domain())
    size, dim = test.ufl_shape[0], inverse.ufl_shape[0]

    def unit(row: int) -> Expr:
        """Gradient of a field whose gradient on the reference cell is 1 in one component."""
        a, A = divmod(row, dim)
        columns = range(inverse.ufl_shape[1])
        return ufl.as_tensor(
            [[inverse[A, i] if c == a else 0 for i in columns] for c in range(size)]
        )

    given, rows = integral.integrand(), range(size * dim)
    columns = [ufl.replace(given, {ufl.grad(trial): unit(c)}) for c in rows]
    return ufl.as_vector(
        [ufl.replace(columns[c], {ufl.grad(test): unit(r)}) for r in rows for c in rows if c >= r]
    )


def _text(V: Any, points: NDArray[np.float64]) -> str:
    """C code of an element at points, for kernels/moduli.h."""
    scalar = V.element.basix_element
    gradients = scalar.tabulate(1, points)[1:, :, :, 0]  # (reference directions, points, nodes)
    gradients[abs(gradients) < 1e-14] = 0
    table = np.ascontiguousarray(gradients.transpose(1, 2, 0)).tolist()
    written = repr(table).replace("[", "{").replace("]", "}")
    corners = _dolfinx.geometry_dofmap(V.mesh).shape[1]
    dim, count, nodes = gradients.shape
    return (
        f"#define NODES {nodes}\n#define POINTS {count}\n#define SIZE {V.dofmap.bs}\n"
        f"#define DIM {dim}\n#define CORNERS {corners}\n"
        f"static const double G[{count}][{nodes}][{dim}] = {written};\n"
        '#include "moduli.h"\n'
    )


def _aligned(size: int) -> NDArray[np.float64]:
    """Room for numbers that vector registers are loaded from."""
    room = np.empty(size + ALIGNED // 8)
    start = -room.ctypes.data % ALIGNED // 8
    return room[start : start + size]
