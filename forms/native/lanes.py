# SPDX-License-Identifier: MIT
"""Kernels with a cell in each lane of a vector register, compiled and found again."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from mpi4py import MPI

import ufl
from ufl.corealg.traversal import unique_pre_traversal

from .. import _dolfinx
from .canonical import canonical
from .library import cells_library

# What is in the cache was written by the same lines.
_WRITER = Path(__file__).with_name("trees.py").read_text()


class Kernels(NamedTuple):
    """Kernels of a form that compute several cells at once.

    Attributes:
        lib: Library with the loops of kernels/cells.h.
        ffi: Its cffi interface.
        kernels: One for each integral, in the order of their subdomains' numbers.
        ids: These numbers; -1 for the whole mesh.
        coefficients: Places, among the form's coefficients, of those that the kernels read.
        constants: The same of constants.
    """

    lib: Any
    ffi: Any
    kernels: list[Any]
    ids: list[int]
    coefficients: list[int]
    constants: list[int]


def kernels(
    comm: MPI.Comm,
    form: ufl.Form,
    derived: Callable[[], ufl.Form] | None = None,
    recipe: str = "",
) -> Kernels | None:
    """Compile a form's kernels for several cells at once. Collective.

    Args:
        comm: Communicator.
        form: Expanded form of integrals over cells, by which the kernels are found again.
        derived: Function that returns the form to compile, which follows from that one and has no
            other coefficients and Constants; called where it is not in the cache.
        recipe: What it follows by: another recipe has other kernels in the cache.

    Returns:
        None where a function of the form has no vectors, or FFCx is of a release whose tree is
        another.

    Raises:
        RuntimeError: the compiler is missing or failed; alike on all ranks.
    """
    parts = [i.integrand() for i in form.integrals()]
    scalar = ufl.classes.BesselFunction
    if not _dolfinx.TREES or any(
        isinstance(e, scalar) for part in parts for e in unique_pre_traversal(part)
    ):
        return None
    name = _dolfinx.signature(canonical(form), f"{_WRITER} {recipe}")

    def text() -> str:
        from .trees import text  # of other releases of FFCx it cannot even be imported

        return text(form, derived or (lambda: form))

    lib, ffi = cells_library(comm, name, text)
    count, *lengths = lib.lanes_counts
    found = [
        list(ffi.unpack(getattr(lib, f"lanes_{what}"), n))
        for what, n in zip(("ids", "coefficients", "constants"), (count, *lengths), strict=True)
    ]
    return Kernels(lib, ffi, [lib.lanes_kernels[k] for k in range(count)], *found)
