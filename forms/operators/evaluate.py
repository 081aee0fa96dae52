# SPDX-License-Identifier: MIT
"""Operators outside a form: on NumPy arrays, and at given points of the cells of a mesh."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

import basix
import basix.ufl
import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray
from ufl.algorithms import expand_derivatives, extract_coefficients

from .._types import Expr
from ..differentiation import expanded, update_dependents
from ..native import jit
from ..native.library import library, pointer
from .jets import Jet, Kind

Array = NDArray[np.float64]


def evaluate(
    kind: Kind, X: Array, levels: tuple[int, ...], project: bool = False
) -> tuple[Array, ...]:
    """Value and derivatives of an operator by the compiled kernels; local.

    Args:
        kind: The operator.
        X: Operands, flattened row by row, and parameters, shape (n, rows cols + parameters).
        levels: Which of value (0), first (1) and second (2) derivative to return.
        project: Make the second derivative positive semi-definite.

    Returns:
        Arrays of shape (n,), (n, rows, cols), (n, rows, cols, rows, cols).
    """
    lib, ffi = library(MPI.COMM_SELF)
    psi, _module = kind.function.compiled(MPI.COMM_SELF)
    record = ffi.new("operator_t *")
    describe(ffi, record, kind, psi)
    X = np.ascontiguousarray(X, dtype=np.float64)
    out = {level: np.empty((len(X), *(level * kind.shape))) for level in levels}
    pointers = [
        ffi.cast("double *", out[level].ctypes.data) if level in out else ffi.NULL
        for level in range(3)
    ]
    lib.points(record, len(X), ffi.cast("double *", X.ctypes.data), project, *pointers)
    return tuple(out[level] for level in levels)


class PointValues(fem.Function):
    """A jet at given points of each cell: a coefficient for expressions that are evaluated there.

    It depends on the unknown: ``update`` computes it anew.
    """

    def __init__(self, jet: Jet, mesh: Any, points: Array) -> None:
        cell = getattr(basix.CellType, mesh.topology.cell_name())
        element = basix.ufl.quadrature_element(
            cell, value_shape=jet.ufl_shape, points=points, weights=np.ones(len(points))
        )
        super().__init__(fem.functionspace(mesh, element))
        self.jet, self._points = jet, len(points)
        packed = expand_derivatives(jet.jets.packed)
        self._packed = packed
        self._operand = jit.expression(packed, points, mesh)
        imap = mesh.topology.index_map(mesh.topology.dim)
        self._cells = np.arange(imap.size_local + imap.num_ghosts, dtype=np.int32)

    def direction(self, unknown: Any, du: Expr) -> Expr:
        """Not available: these values are for looking at."""
        raise ValueError("values of an operator at points cannot be differentiated.")

    def update(self) -> None:
        """Evaluate the operator at the operand's present values; local."""
        update_dependents(self._packed)
        X = self._operand.eval(self.function_space.mesh, self._cells)
        X = X.reshape(len(self._cells) * self._points, -1)
        (values,) = evaluate(self.jet.jets.kind, X, (self.jet.level,))
        block = self.function_space.dofmap.bs
        where = self.function_space.dofmap.list[: len(self._cells)].ravel()
        self.x.array.reshape(-1, block)[where] = values.reshape(-1, block)


def at_points(expression: Expr, mesh: Any, points: Array) -> Expr:
    """The expression with its operators given at points of each cell, ready for compiling.

    Call ``update_dependents`` on the outcome before each evaluation.
    """
    expression = ufl.as_ufl(expression)
    expression = expanded(expression)
    expression = expand_derivatives(expression)
    jets = [c for c in extract_coefficients(expression) if isinstance(c, Jet)]
    if not jets:
        return expression
    points = np.asarray(points, dtype=np.float64)
    return ufl.replace(expression, {jet: PointValues(jet, mesh, points) for jet in jets})


def describe(ffi: Any, record: Any, kind: Kind, psi: Any) -> None:
    """Fill the C structure operator_t."""
    record.psi = pointer(ffi, psi.tabulate_tensor_float64)
    record.rows, record.cols = kind.shape
    record.stretches = kind.function.n
    record.plane, record.improper, record.smooth = kind.plane, kind.improper, kind.smooth
    record.parameters = len(kind.function.parameters)
    record.clamp = kind.clamp
