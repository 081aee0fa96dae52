# SPDX-License-Identifier: MIT
"""Integrals over cells by kernels that compute several cells at once, or one."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray
from ufl.algorithms import expand_derivatives
from ufl.algorithms.analysis import extract_constants

from . import _dolfinx
from .compilation import compiled, pointwise
from .differentiation import dependents, expanded
from .entities import with_owned_entities
from .native.lanes import kernels
from .quadrature import with_quadrature

_CELL = fem.IntegralType.cell


class Sums:
    """A functional or a linear form: integrals over cells several at a time, others by FFCx's way.

    Args:
        form: With at most one argument, a vector of Lagrange elements.
    """

    def __init__(self, form: ufl.Form) -> None:
        form = with_quadrature(with_owned_entities(expand_derivatives(expanded(form))))
        own: list[Any] = []
        rest: list[Any] = []
        for integral in form.integrals():
            several = is_over_cells(integral) and not dependents(integral.integrand())
            (own if several else rest).append(integral)
        batch = Batch(ufl.Form(own), several=True) if own else None
        self._batch = batch
        self._found: Any = None if batch is None else batch.found
        if batch is None or self._found is None:
            rest = list(form.integrals())
        else:
            self._geometry, self._keep = geometry(self._found.ffi, batch.mesh)
        self._rest = compiled(ufl.Form(rest)) if rest else None
        if form.arguments():
            V: Any = form.arguments()[0].ufl_function_space()
            self._numbers, self._size = np.ascontiguousarray(V.dofmap.list, np.int32), V.dofmap.bs

    def value(self) -> float:
        """The functional on this rank. Local."""
        total = 0.0 if self._rest is None else float(fem.assemble_scalar(self._rest))
        for lib, *arguments in self._calls():
            total += lib.cells_sum(*arguments)
        return total

    def add(self, b: NDArray[np.float64]) -> None:
        """Add the linear form to values with room for ghosts. Local."""
        if self._rest is not None:
            fem.assemble_vector(b, self._rest)
        for lib, *arguments in self._calls():
            ffi = self._found.ffi
            numbers = ffi.cast("int32_t *", self._numbers.ctypes.data)
            to = ffi.cast("double *", b.ctypes.data)
            lib.cells_add(*arguments, numbers, self._numbers.shape[1], self._size, to)

    def _calls(self) -> Iterator[tuple[Any, ...]]:
        """Library, kernel, part, geometry and Constants for each integral over cells."""
        batch, found = self._batch, self._found
        if batch is None or found is None:
            return
        constants = batch.constants()
        given = found.ffi.cast("double *", constants.ctypes.data)
        for kernel, (part, _) in zip(batch.kernels, batch.parts(found.ffi), strict=True):
            yield found.lib, kernel, part, self._geometry, given


def is_over_cells(integral: Any) -> bool:
    """Whether an integral is one over cells by the default rule."""
    rule = integral.metadata().get("quadrature_rule", "default")
    return integral.integral_type() == "cell" and rule == "default"


def geometry(ffi: Any, mesh: Any) -> tuple[Any, tuple[NDArray, NDArray]]:
    """C structure geometry_t of a mesh, and the arrays that it points to."""
    table = np.ascontiguousarray(_dolfinx.geometry_dofmap(mesh), np.int32)
    made = ffi.new("geometry_t *")
    made.nodes, made.numbers = table.shape[1], ffi.cast("int32_t *", table.ctypes.data)
    made.x = ffi.cast("double *", mesh.geometry.x.ctypes.data)
    return made, (table, mesh.geometry.x)


class Batch:
    """A form's integrals over cells: kernels, cells, coefficients and Constants. Collective.

    Several cells at once, but one by one where the form contains energies in singular values, whose
    points are found cell by cell, or FFCx's kernels have no vectors.

    Args:
        form: Expanded form over cells, with quadrature degrees.
        derived: Function that returns the form whose kernels these are, if that is another: one
            that follows from it, and need not be written where its kernels are in the cache.
        recipe: What it follows by, in words that change when that does.
        several: Several cells at once or not at all.

    Attributes:
        found: :class:`forms.native.lanes.Kernels`; None where cells are computed one by one.
    """

    def __init__(
        self,
        form: ufl.Form,
        derived: Callable[[], ufl.Form] | None = None,
        recipe: str = "",
        several: bool = False,
    ) -> None:
        domain = form.ufl_domain()
        mesh = _dolfinx.cpp_mesh(domain)
        self.mesh = mesh
        self.found = None if dependents(form) else kernels(mesh.comm, form, derived, recipe)
        if self.found is None and several:
            return
        if self.found is None:
            self._form = pointwise(form if derived is None else derived())
            self.kernels: list[Any] = vars(self._form)["_kernels"]
        else:
            self.kernels = self.found.kernels
            known, constants = form.coefficients(), extract_constants(form)
            tags = {
                id(d): d for d in form.subdomain_data()[domain].get("cell", ()) if d is not None
            }
            subdomain = next(iter(tags.values()), None)
            coefficients = [known[k] for k in self.found.coefficients]
            parts = [
                (
                    int(self.found.ffi.cast("uintptr_t", kernel)),
                    _dolfinx.integration_entities(mesh, _CELL, subdomain, number),
                    len(coefficients),
                )
                for kernel, number in zip(self.kernels, self.found.ids, strict=True)
            ]
            self._form = _dolfinx.custom_form(
                mesh,
                [],
                {_CELL: parts},
                coefficients,
                [constants[k] for k in self.found.constants],
                False,
            )

    def constants(self) -> NDArray[np.float64]:
        """Present values of the Constants, one after the other."""
        return _dolfinx.constants(self._form)

    def parts(self, ffi: Any) -> list[tuple[Any, tuple[NDArray, NDArray]]]:
        """C structures part_t with the present coefficients, and the arrays that they point to."""
        made = []
        integrals = zip(self.kernels, _dolfinx.integrals(self._form), strict=True)
        for kernel, (_, cells, coefficients) in integrals:
            part = ffi.new("part_t *")
            cells = np.ascontiguousarray(cells, np.int32)
            part.kernel = ffi.cast("tabulate_t", kernel)
            part.facets, part.lanes = 0, self.found is not None
            part.count, part.width = len(cells), coefficients.shape[1]
            part.entities = ffi.cast("int32_t *", cells.ctypes.data)
            part.coefficients = ffi.cast("double *", coefficients.ctypes.data)
            made.append((part, (cells, coefficients)))
        return made
