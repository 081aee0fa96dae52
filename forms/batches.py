# SPDX-License-Identifier: MIT
"""Integrals over cells by kernels that compute several cells at once, or one."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import basix
import basix.ufl
import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray
from ufl.algorithms import expand_derivatives
from ufl.algorithms.analysis import extract_constants

from . import _dolfinx
from .compilation import compiled, pointwise, subdomain
from .differentiation import dependents, expanded
from .entities import with_owned_entities
from .native import records
from .native.lanes import Kernels, kernels
from .native.library import library
from .operators.jets import Jet
from .quadrature import with_quadrature

_CELL = fem.IntegralType.cell


class Sums:
    """A functional, or a linear form and a functional: integrals over cells several at a time.

    Others go FFCx's way. Of energies in singular values the points of several cells are looked at
    together, where each cell has but one. A linear form and its functional are one kernel, which
    computes what both depend on once.

    Args:
        functional: Functional.
        linear: Linear form of a vector of Lagrange elements; None for the functional alone.
    """

    def __init__(self, functional: ufl.Form, linear: ufl.Form | None = None) -> None:
        self._mesh = _dolfinx.cpp_mesh(functional.ufl_domain())
        V: Any = None if linear is None else linear.arguments()[0].ufl_function_space()
        plain, beside, rest = _sorted(functional)
        forces, forces_beside, forces_rest = ([], [], []) if linear is None else _sorted(linear)
        made = several(_joined(V, plain, forces)) if plain or forces else None
        self._batches: list[tuple[Any, Any, Batch]] = []
        if made is not None and made.found is not None:
            self._batches.append((made.found.lib, made.found.ffi, made))
        else:
            rest, forces_rest = rest + plain, forces_rest + forces
        if beside or forces_beside:
            batch = one_by_one(_joined(V, beside, forces_beside))
            self._batches.append((*library(self._mesh.comm), batch))
        self._rest, self._rest_linear = (
            compiled(ufl.Form(others)) if others else None for others in (rest, forces_rest)
        )
        self._numbers: NDArray[np.int32] | None = None
        if V is not None:
            self._numbers, self._size = np.ascontiguousarray(V.dofmap.list, np.int32), V.dofmap.bs

    def value(self) -> float:
        """The functional on this rank. Local.

        Raises:
            TypeError: there is a linear form, whose kernels write more than one number.
        """
        if self._numbers is not None:
            raise TypeError("sums with a linear form give the functional by add_with_value().")
        total = self._others()
        for lib, _, *arguments in self._calls():
            total += lib.cells_sum(*arguments)
        return total

    def add(self, b: NDArray[np.float64]) -> None:
        """Add the linear form to values with room for ghosts. Local."""
        self._added(b)

    def add_with_value(self, b: NDArray[np.float64]) -> float:
        """Add the linear form to values with room for ghosts; return the functional. Local."""
        return self._others() + self._added(b)

    def _others(self) -> float:
        return 0.0 if self._rest is None else float(fem.assemble_scalar(self._rest))

    def _added(self, b: NDArray[np.float64]) -> float:
        """Add the linear form; what the functional has over cells."""
        assert self._numbers is not None
        if self._rest_linear is not None:
            fem.assemble_vector(b, self._rest_linear)
        total = 0.0
        for lib, ffi, *arguments in self._calls():
            numbers = ffi.cast("int32_t *", self._numbers.ctypes.data)
            to = ffi.cast("double *", b.ctypes.data)
            total += lib.cells_add(*arguments, numbers, self._numbers.shape[1], self._size, to)
        return total

    def _calls(self) -> Iterator[tuple[Any, ...]]:
        """Library, interface, part, places and Constants of each integral over cells."""
        for lib, ffi, batch in self._batches:
            constants = batch.constants()
            given = ffi.cast("double *", constants.ctypes.data)
            places, _kept = records.geometry(ffi, self._mesh)
            for part, _ in batch.parts(ffi):
                yield lib, ffi, part, places, given


def _sorted(form: ufl.Form) -> tuple[list[Any], list[Any], list[Any]]:
    """Integrals over cells without energies in singular values, those with, and others."""
    form = with_quadrature(with_owned_entities(expand_derivatives(expanded(form))))
    plain: list[Any] = []
    beside: list[Any] = []
    rest: list[Any] = []
    for integral in form.integrals():
        found = dependents(integral.integrand())
        if not is_over_cells(integral) or not all(isinstance(c, Jet) for c in found):
            rest.append(integral)
        else:
            (beside if found else plain).append(integral)
    return plain, beside, rest


def _joined(V: Any, functional: list[Any], linear: list[Any]) -> ufl.Form:
    """One form, linear in a field's test function and in one number of each cell behind it.

    The functional itself where V is None.
    """
    if V is None:
        return ufl.Form(functional)
    cell = getattr(basix.CellType, _dolfinx.cell_name(V.ufl_domain().ufl_cell()))
    number = basix.ufl.element("DG", cell, 0)
    element = basix.ufl.mixed_element([V.ufl_element(), number])
    test, one = ufl.split(ufl.TestFunction(ufl.FunctionSpace(V.ufl_domain(), element)))
    made = [
        i.reconstruct(integrand=ufl.replace(i.integrand(), {v: test}))
        for i in linear
        for v in ufl.Form([i]).arguments()
    ]
    made += [i.reconstruct(integrand=one * i.integrand()) for i in functional]
    return expand_derivatives(ufl.Form(made))


def is_over_cells(integral: Any) -> bool:
    """Whether an integral is one over cells by the default rule."""
    rule = integral.metadata().get("quadrature_rule", "default")
    return integral.integral_type() == "cell" and rule == "default"


class Batch:
    """A form's integrals over cells: kernels, cells, coefficients and Constants.

    Attributes:
        kernels: Of each integral.
        form: Form of DOLFINx that holds the rest.
        found: Where kernels compute several cells at once, their library; else None.
    """

    def __init__(self, kernels: list[Any], form: fem.Form, found: Kernels | None = None) -> None:
        self.kernels, self.form, self.found = kernels, form, found

    def constants(self) -> NDArray[np.float64]:
        """Present values of the Constants, one after the other."""
        return _dolfinx.constants(self.form)

    def parts(self, ffi: Any) -> list[tuple[Any, tuple[NDArray, NDArray]]]:
        """C structures part_t with the present coefficients, and the arrays that they point to."""
        lanes, integrals = self.found is not None, _dolfinx.integrals(self.form)
        return [
            records.part(ffi, kernel, cells, coefficients, lanes=lanes)
            for kernel, (_, cells, coefficients) in zip(self.kernels, integrals, strict=True)
        ]


def one_by_one(form: ufl.Form) -> Batch:
    """Integrals of values at points, cell by cell: with energies in singular values. Collective.

    Args:
        form: As :func:`forms.compilation.pointwise` takes it.
    """
    made = pointwise(form)
    return Batch(vars(made)["_kernels"], made)


def several(
    form: ufl.Form, derived: Callable[[], ufl.Form] | None = None, recipe: str = ""
) -> Batch | None:
    """Integrals by kernels that compute several cells at once. Collective.

    Args:
        form: Expanded form over cells, with quadrature degrees.
        derived: Function that returns the form whose kernels these are, if that is another: one
            that follows from it, and need not be written where its kernels are in the cache.
        recipe: What it follows by, in words that change when that does.

    Returns:
        None where the form contains energies in singular values, whose points are found cell by
        cell, or FFCx's kernels have no vectors.
    """
    domain = form.ufl_domain()
    mesh = _dolfinx.cpp_mesh(domain)
    found = None if dependents(form) else kernels(mesh.comm, form, derived, recipe)
    if found is None:
        return None
    known, constants = form.coefficients(), extract_constants(form)
    coefficients = [known[k] for k in found.coefficients]
    tags = subdomain(form, "cell")
    parts = [
        (
            int(found.ffi.cast("uintptr_t", kernel)),
            _dolfinx.integration_entities(mesh, _CELL, tags, number),
            len(coefficients),
        )
        for kernel, number in zip(found.kernels, found.ids, strict=True)
    ]
    used = [constants[k] for k in found.constants]
    made = _dolfinx.custom_form(mesh, [], {_CELL: parts}, coefficients, used, False)
    return Batch(found.kernels, made, found)
