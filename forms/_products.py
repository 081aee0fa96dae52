# SPDX-License-Identifier: MIT
"""A function of ours in place of PETSc's product P^T A P, where its multigrid asks for one.

PETSc asks the first matrix of a product how it is computed, by an entry in its table of operations,
and where the second one has another entry by a function of a composed name. Both are public; the
entry's number differs by release and is found by looking at what PETSc itself enters.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

from petsc4py import PETSc

from ._petsc import call

_FUNCTION = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p)
_PTAP = 4  # PETSc's MATPRODUCT_PtAP
_LOOKED_AT = range(60, 140)  # numbers of operations
_FAILED = 76  # PETSC_ERR_LIB
_AIJ = "seqaij", "mpiaij"


class Products:
    """How to compute P^T A P, for matrices that say so.

    It has to live as long as the process: products keep the addresses of its functions.

    Args:
        fits: Whether A and P are for it; alike on all ranks.
        compute: Puts the product of A and P into a third matrix, which has its sizes and type.
    """

    def __init__(
        self,
        fits: Callable[[PETSc.Mat, PETSc.Mat], bool],
        compute: Callable[[PETSc.Mat, PETSc.Mat, PETSc.Mat], None],
    ) -> None:
        self._fits, self._compute = fits, compute
        self._choose, self._shape, self._fill = map(
            self._guarded, (self._chosen, self._shaped, self._filled)
        )
        self._before: dict[str, ctypes.c_void_p] = {}
        self._marked: list[PETSc.Mat] = []
        self._active = False
        self._failure: BaseException | None = None

    @contextmanager
    def of(self, A: PETSc.Mat) -> Iterator[None]:
        """Compute products with A, and with what comes of these, this way. Collective.

        Not where the user chooses PETSc's, by ``-matptap_via``.
        """
        chosen = PETSc.Options().hasName("matptap_via")
        if not chosen and A.getType() in _AIJ and _symbolic():
            self._active = True
            self._mark(A)
        try:
            yield
        except PETSc.Error:
            if self._failure is None:
                raise
            raise self._failure from None
        finally:
            self._failure, self._active = None, False
            for each in self._marked:
                _set(each, -1, self._before[each.getType()])
                _compose(each, None)
            self._marked = []

    def _mark(self, A: PETSc.Mat) -> None:
        self._before.setdefault(A.getType(), _operation(A, _symbolic() - 1))
        _set(A, -1, self._choose)
        _compose(A, self._choose)
        self._marked.append(A)

    def _chosen(self, C: PETSc.Mat) -> None:
        """How the product C is computed; PETSc may ask twice."""
        if _operation(C, _symbolic()).value is not None:
            return
        kind = ctypes.c_int()
        call("MatProductGetType", ctypes.c_void_p(C.handle), ctypes.byref(kind))
        A, P = _factors(C)
        if kind.value == _PTAP and self._fits(A, P):
            _set(C, 0, self._shape)
            return
        if error := ctypes.cast(self._before[A.getType()], _FUNCTION)(C.handle):
            raise PETSc.Error(error)

    def _shaped(self, C: PETSc.Mat) -> None:
        """Size and type of the product C."""
        A, P = _factors(C)
        C.setSizes((P.getSizes()[1],) * 2)
        C.setType(A.getType())
        C.setBlockSize(P.getBlockSizes()[1])
        _set(C, 1, self._fill)

    def _filled(self, C: PETSc.Mat) -> None:
        """The numbers of the product C."""
        self._compute(*_factors(C), C)
        if self._active:
            self._mark(C)

    def _guarded(self, function: Callable[[PETSc.Mat], None]) -> Any:
        """What PETSc calls: an error is kept, and PETSc told of one."""

        def run(handle: int) -> int:
            try:
                function(_wrapped(handle))
            except BaseException as error:
                self._failure = error
                return _FAILED
            return 0

        return _FUNCTION(run)


def _factors(C: PETSc.Mat) -> tuple[PETSc.Mat, PETSc.Mat]:
    """The matrices A and P of a product."""
    found = ctypes.c_void_p(), ctypes.c_void_p()
    call("MatProductGetMats", ctypes.c_void_p(C.handle), *map(ctypes.byref, found), None)
    return _wrapped(found[0].value), _wrapped(found[1].value)


@cache
def _symbolic() -> int:
    """Number of the operation that gives a product its pattern; 0 where it is not to be found.

    Before it comes that which chooses how, behind it that which computes.
    """
    A, product = PETSc.Mat().createAIJ((1, 1), nnz=1, comm=PETSc.COMM_SELF), ctypes.c_void_p()
    A.setValue(0, 0, 1)
    A.assemble()
    a = ctypes.c_void_p(A.handle)
    call("MatProductCreate", a, a, None, ctypes.byref(product))
    call("MatProductSetType", product, _PTAP)
    call("MatProductSetAlgorithm", product, b"default")
    C = _wrapped(product.value)
    before = [_operation(C, n).value for n in _LOOKED_AT]
    call("MatProductSetFromOptions", product)
    after = [_operation(C, n).value for n in _LOOKED_AT]
    changed = [n for n, a, b in zip(_LOOKED_AT, before, after, strict=True) if a != b]
    found = len(changed) == 1 and _operation(A, changed[0] - 1).value is not None
    C.destroy()
    call("MatDestroy", ctypes.byref(product))
    A.destroy()
    return changed[0] if found else 0


def _operation(A: PETSc.Mat, number: int) -> ctypes.c_void_p:
    """Address of a function of a matrix."""
    found = ctypes.c_void_p()
    call("MatGetOperation", ctypes.c_void_p(A.handle), number, ctypes.byref(found))
    return found


def _set(A: PETSc.Mat, after: int, function: Any) -> None:
    """Set one of the three functions of products: -1, 0 or 1 from that of the pattern."""
    address = ctypes.cast(function, ctypes.c_void_p)
    call("MatSetOperation", ctypes.c_void_p(A.handle), _symbolic() + after, address)


def _compose(A: PETSc.Mat, function: Any) -> None:
    """Let a function choose how products of A with another of its type are computed."""
    kind = A.getType()
    name = f"MatProductSetFromOptions_{kind}_{kind}_C".encode()
    address = ctypes.cast(function, ctypes.c_void_p) if function is not None else None
    call("PetscObjectComposeFunction_Private", ctypes.c_void_p(A.handle), name, address)


@cache
def _wrap() -> Any:
    """petsc4py's function that makes its object of a matrix, from what it offers to C."""
    capsule = PETSc.__pyx_capi__["PyPetscMat_New"]
    name, pointer = ctypes.pythonapi.PyCapsule_GetName, ctypes.pythonapi.PyCapsule_GetPointer
    name.restype, name.argtypes = ctypes.c_char_p, [ctypes.py_object]
    pointer.restype, pointer.argtypes = ctypes.c_void_p, [ctypes.py_object, ctypes.c_char_p]
    made = ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.c_void_p)
    return made(pointer(capsule, name(capsule)))


def _wrapped(handle: Any) -> PETSc.Mat:
    """petsc4py's object of a matrix; it holds a reference to it."""
    return _wrap()(handle)
