# SPDX-License-Identifier: MIT
"""Integrals over cells by kernels that compute several cells at once, or one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray
from ufl.algorithms.analysis import extract_constants

from . import _dolfinx
from .compilation import pointwise
from .differentiation import dependents
from .native.lanes import kernels

_CELL = fem.IntegralType.cell


class Batch:
    """A form's integrals over cells: kernels, cells, coefficients and Constants. Collective.

    Several cells at once, but one by one where the form contains energies in singular values, whose
    points are found cell by cell, or FFCx's kernels have no vectors.

    Args:
        form: Expanded form over cells, with quadrature degrees.
        derived: Function that returns the form whose kernels these are, if that is another: one
            that follows from it, and need not be written where its kernels are in the cache.

    Attributes:
        found: :class:`forms.native.lanes.Kernels`; None where cells are computed one by one.
    """

    def __init__(self, form: ufl.Form, derived: Callable[[], ufl.Form] | None = None) -> None:
        domain = form.ufl_domain()
        mesh = _dolfinx.cpp_mesh(domain)
        self.mesh = mesh
        self.found = None if dependents(form) else kernels(mesh.comm, form, derived)
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
