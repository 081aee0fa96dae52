# SPDX-License-Identifier: MIT
"""What petsc4py has no call for, by ctypes: matrices' arrays, options, lags, LAPACK's addresses."""

from __future__ import annotations

import ctypes
from typing import Any, NamedTuple

from petsc4py import PETSc

import numpy as np
from numpy.typing import NDArray

_LIBRARY = ctypes.CDLL(PETSc.__file__)  # finds what it is linked to: PETSc, LAPACK
_NUMBERS = 10  # of PETSc's MatInfo; the third is the number of stored entries
_LOCAL = 1  # PETSc's MAT_LOCAL


class Part(NamedTuple):
    """One of the arrays of a matrix: its values, row after row, and where each row starts."""

    rows: NDArray[np.int32]
    columns: NDArray[np.int32]
    values: NDArray[np.float64]


def parts(A: PETSc.Mat) -> tuple[list[Part], NDArray[np.int32]]:
    """Diagonal and off-diagonal part of an AIJ matrix, and the latter's columns in the whole.

    Local. On one rank both parts are the matrix itself, and no columns are returned. The arrays are
    PETSc's own and live as long as the matrix has its pattern.
    """
    matrices, names = _sequential(A)
    found = []
    for matrix, stored in zip(matrices, values(A), strict=True):
        count, done = ctypes.c_int32(), ctypes.c_int32()
        rows, columns = (ctypes.POINTER(ctypes.c_int32)() for _ in range(2))
        plain = (ctypes.c_int32(0),) * 3  # numbers from 0, the pattern as it is, not of blocks
        _call("MatGetRowIJ", matrix, *plain, *map(ctypes.byref, (count, rows, columns, done)))
        found.append(Part(_array(rows, count.value + 1), _array(columns, len(stored)), stored))
    width = int(found[-1].columns.max(initial=-1)) + 1 if len(found) == 2 else 0
    return [found[0], found[-1]], _array(names, width)


def values(A: PETSc.Mat) -> list[NDArray[np.float64]]:
    """PETSc's arrays of an assembled AIJ matrix, for writing before ``A.assemble()``; local."""
    arrays = []
    for part in _sequential(A)[0]:
        address, info = ctypes.POINTER(ctypes.c_double)(), (ctypes.c_double * _NUMBERS)()
        _call("MatSeqAIJGetArray", part, ctypes.byref(address))
        _call("MatGetInfo", part, _LOCAL, info)
        arrays.append(_array(address, int(info[2])))
        # Returned before it is written to: A.assemble() always follows.
        _call("MatSeqAIJRestoreArray", part, ctypes.byref(address))
    return arrays


def said(error: PETSc.Error) -> str:
    """What PETSc says of an error, in one line."""
    words = str(error).strip().splitlines()[-1].split("] ", 1)[-1]
    return f"PETSc's error {error.ierr}: {words}"


def option_was_used(name: str) -> bool:
    """Whether PETSc has asked for an option of this whole name, prefix included."""
    used = ctypes.c_int(0)
    _call("PetscOptionsUsed", None, name.encode(), ctypes.byref(used))
    return bool(used.value)


def replace_by_sum(A: PETSc.Mat, summands: list[PETSc.Mat]) -> None:
    """Let A be the sum of matrices, with their joint pattern, for all who hold it. Collective."""
    total = ctypes.c_void_p()
    _call("MatDuplicate", ctypes.c_void_p(summands[0].handle), 1, ctypes.byref(total))
    for other in summands[1:]:
        one, pattern = ctypes.c_double(1.0), 0  # DIFFERENT_NONZERO_PATTERN
        _call("MatAXPY", total, one, ctypes.c_void_p(other.handle), pattern)
    _call("MatHeaderReplace", ctypes.c_void_p(A.handle), ctypes.byref(total))


def lag_jacobian(snes: PETSc.SNES, lag: int) -> None:
    """How often SNES assembles its Jacobian: 1 always, -1 never again, -2 once more; collective."""
    _call("SNESSetLagJacobian", ctypes.c_void_p(snes.handle), lag)


def lapack(*names: str) -> list[int]:
    """Addresses of LAPACK's functions in the library that PETSc is linked to."""
    found = [ctypes.cast(getattr(_LIBRARY, f"{name}_"), ctypes.c_void_p).value for name in names]
    return [address or 0 for address in found]


def _sequential(A: PETSc.Mat) -> tuple[list[ctypes.c_void_p], Any]:
    """The matrices that an AIJ matrix is made of: itself, or two parts and the latter's columns."""
    whole, names = ctypes.c_void_p(A.handle), ctypes.POINTER(ctypes.c_int32)()
    if A.getType() != "mpiaij":
        return [whole], names
    two = [ctypes.c_void_p(), ctypes.c_void_p()]
    _call("MatMPIAIJGetSeqAIJ", whole, *map(ctypes.byref, (*two, names)))
    return two, names


def _array(address: Any, size: int) -> NDArray:
    """View of C's memory."""
    return np.ctypeslib.as_array(address, (size,)) if size else np.empty(0, address._type_)


def _call(name: str, *arguments: Any) -> None:
    """Call a function of PETSc."""
    error = getattr(_LIBRARY, name)(*arguments)
    if error:
        raise PETSc.Error(error)
