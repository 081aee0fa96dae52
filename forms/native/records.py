# SPDX-License-Identifier: MIT
"""Arrays for C; structures of insertion.h: a mesh's places, an integral with what it is over."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _dolfinx

Array = NDArray[np.float64]
_C = {"b": "int8_t", "h": "int16_t", "i": "int32_t", "f": "float", "d": "double"}


def address(ffi: Any, array: NDArray) -> Any:
    """Address of an array, of its own type in C; who calls keeps the array."""
    return ffi.cast(f"{_C[array.dtype.char]} *", array.ctypes.data)


def geometry(ffi: Any, mesh: Any) -> tuple[Any, tuple[NDArray[np.int32], Array]]:
    """A geometry_t, and the arrays that it points to, which must outlive it."""
    table = np.ascontiguousarray(_dolfinx.geometry_dofmap(mesh), np.int32)
    made = ffi.new("geometry_t *")
    made.nodes, made.numbers = table.shape[1], ffi.cast("int32_t *", table.ctypes.data)
    made.x = ffi.cast("double *", mesh.geometry.x.ctypes.data)
    return made, (table, mesh.geometry.x)


def part(
    ffi: Any,
    kernel: Any,
    entities: NDArray[np.int32],
    coefficients: Array,
    *,
    facets: bool = False,
    lanes: bool = False,
) -> tuple[Any, tuple[NDArray[np.int32], Array]]:
    """A part_t, and the arrays that it points to, which must outlive it.

    Args:
        ffi: Interface of the library that takes it.
        kernel: The kernel, or its address.
        entities: Cells, or each facet's cell and its number there.
        coefficients: Packed, of each entity.
        facets: Whether it is summed over facets.
        lanes: Whether the kernel computes several cells at once.
    """
    entities = np.ascontiguousarray(entities, np.int32)
    made = ffi.new("part_t *")
    made.kernel, made.facets, made.lanes = ffi.cast("tabulate_t", kernel), facets, lanes
    made.count, made.width = entities.size // (2 if facets else 1), coefficients.shape[1]
    made.entities = ffi.cast("int32_t *", entities.ctypes.data)
    made.coefficients = ffi.cast("double *", coefficients.ctypes.data)
    return made, (entities, coefficients)
