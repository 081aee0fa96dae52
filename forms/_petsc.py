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


def owned_part(A: PETSc.Mat) -> Part:
    """Diagonal part of an AIJ matrix, for reading: its state stays the same. Local."""
    matrix = _sequential(A)[0][0]
    return _part(matrix, _stored(matrix, "Read"))


def parts(A: PETSc.Mat) -> tuple[list[Part], NDArray[np.int32]]:
    """Diagonal and off-diagonal part of an AIJ matrix, and the latter's columns in the whole.

    Local; the state stays the same. On one rank both parts are the matrix itself, and no columns
    are returned. The arrays are PETSc's own and live as long as the matrix has its pattern.
    """
    matrices, names = _sequential(A)
    found = [_part(each, _stored(each, "Read")) for each in matrices]
    width = int(found[-1].columns.max(initial=-1)) + 1 if len(found) == 2 else 0
    return [found[0], found[-1]], _array(names, width)


class OffDiagonal:
    """What couples the rows of this rank of an MPIAIJ matrix to columns of others. Collective.

    Args:
        A: The matrix, assembled; its numbers may change, its pattern not.
    """

    def __init__(self, A: PETSc.Mat) -> None:
        (_, self._part), names = _sequential(A)
        rows, columns = ctypes.c_int32(), ctypes.c_int32()
        call("MatGetLocalSize", self._part, *map(ctypes.byref, (rows, columns)))
        self._ghosts, self._product = PETSc.Vec(), PETSc.Vec()
        self._ghosts.createSeq(columns.value)
        self._product.createSeq(rows.value)
        wanted = PETSc.IS().createGeneral(_array(names, columns.value), comm=PETSc.COMM_SELF)
        x = A.createVecRight()
        self._scatter = PETSc.Scatter().create(x, wanted, self._ghosts, None)
        for item in (wanted, x):
            item.destroy()

    def __call__(self, x: PETSc.Vec) -> NDArray[np.float64]:
        """Its product with a vector of all ranks; valid until the next one. Collective."""
        self._scatter.scatter(x, self._ghosts)
        handles = (ctypes.c_void_p(v.handle) for v in (self._ghosts, self._product))
        call("MatMult", self._part, *handles)
        return self._product.array_r

    def destroy(self) -> None:
        """Free PETSc's objects."""
        for item in (self._ghosts, self._product, self._scatter):
            item.destroy()


def values(A: PETSc.Mat) -> list[NDArray[np.float64]]:
    """PETSc's arrays of an assembled AIJ matrix, for writing before ``A.assemble()``; local."""
    return [_stored(part) for part in _sequential(A)[0]]


def said(error: PETSc.Error) -> str:
    """What PETSc says of an error, in one line."""
    words = str(error).strip().splitlines()[-1].split("] ", 1)[-1]
    return f"PETSc's error {error.ierr}: {words}"


def option_was_used(name: str) -> bool:
    """Whether PETSc has asked for an option of this whole name, prefix included."""
    used = ctypes.c_int(0)
    call("PetscOptionsUsed", None, name.encode(), ctypes.byref(used))
    return bool(used.value)


def replace_by_sum(A: PETSc.Mat, summands: list[PETSc.Mat]) -> None:
    """Let A be the sum of matrices, with their joint pattern, for all who hold it. Collective."""
    total = ctypes.c_void_p()
    call("MatDuplicate", ctypes.c_void_p(summands[0].handle), 1, ctypes.byref(total))
    for other in summands[1:]:
        one, pattern = ctypes.c_double(1.0), 0  # DIFFERENT_NONZERO_PATTERN
        call("MatAXPY", total, one, ctypes.c_void_p(other.handle), pattern)
    call("MatHeaderReplace", ctypes.c_void_p(A.handle), ctypes.byref(total))


def lag_jacobian(snes: PETSc.SNES, lag: int) -> None:
    """How often SNES assembles its Jacobian: 1 always, -1 never again, -2 once more; collective."""
    call("SNESSetLagJacobian", ctypes.c_void_p(snes.handle), lag)


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
    call("MatMPIAIJGetSeqAIJ", whole, *map(ctypes.byref, (*two, names)))
    return two, names


def _part(matrix: ctypes.c_void_p, stored: NDArray[np.float64]) -> Part:
    """Values of a sequential matrix with its pattern."""
    count, done = ctypes.c_int32(), ctypes.c_int32()
    rows, columns = (ctypes.POINTER(ctypes.c_int32)() for _ in range(2))
    plain = (ctypes.c_int32(0),) * 3  # numbers from 0, the pattern as it is, not of blocks
    call("MatGetRowIJ", matrix, *plain, *map(ctypes.byref, (count, rows, columns, done)))
    return Part(_array(rows, count.value + 1), _array(columns, len(stored)), stored)


def _stored(matrix: ctypes.c_void_p, way: str = "") -> NDArray[np.float64]:
    """PETSc's array of a sequential matrix."""
    address, info = ctypes.POINTER(ctypes.c_double)(), (ctypes.c_double * _NUMBERS)()
    call(f"MatSeqAIJGetArray{way}", matrix, ctypes.byref(address))
    call("MatGetInfo", matrix, _LOCAL, info)
    found = _array(address, int(info[2]))
    # Returned before it is written to: A.assemble() always follows.
    call(f"MatSeqAIJRestoreArray{way}", matrix, ctypes.byref(address))
    return found


def _array(address: Any, size: int) -> NDArray:
    """View of C's memory."""
    return np.ctypeslib.as_array(address, (size,)) if size else np.empty(0, address._type_)


def call(name: str, *arguments: Any) -> None:
    """Call a function of PETSc."""
    error = getattr(_LIBRARY, name)(*arguments)
    if error:
        raise PETSc.Error(error)
