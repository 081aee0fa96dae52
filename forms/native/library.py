# SPDX-License-Identifier: MIT
"""The compiled kernels of points, cells, insertion, bounds: built once, beside DOLFINx's code."""

from __future__ import annotations

import hashlib
import shlex
import subprocess
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from mpi4py import MPI

import cffi

from .. import _dolfinx, _petsc
from . import jit
from .once import make_once

SOURCE = Path(__file__).parent / "kernels"
KERNELS = 64  # integrals with operators in one form

_TABULATE = (
    "typedef void (*tabulate_t)(double *, const double *, const double *, const double *, "
    "const int *, const uint8_t *%s);"
)
_INSERTION = """
typedef struct {
  int cells, owned, size, nodes; const int32_t *numbers; const int16_t *places;
  const int32_t *rows[3]; double *values[3]; const int8_t *held;
} target_t;
typedef struct {
  tabulate_t kernel; int facets, lanes; long count; const int32_t *entities; int width;
  const double *coefficients;
} part_t;
typedef struct { int nodes; const int32_t *numbers; const double *x; } geometry_t;
"""
_SUMS = """
double cells_sum(const part_t *p, const geometry_t *g, const double *constants);
double cells_add(const part_t *p, const geometry_t *g, const double *constants,
                 const int32_t *numbers, int nodes, int size, double *b);
"""
_DECLARATIONS = """
typedef struct {
  tabulate_t psi; int rows, cols, stretches, plane, improper, smooth, parameters; double clamp;
} operator_t;
typedef struct {
  operator_t op; tabulate_t operand; int points; int constants; int levels[3]; int coefficients;
  int pieces; int piece[16][3];
} jet_t;
typedef struct {
  tabulate_t form; int packed; int coefficients; int jets; int project_points; int project_rows;
  jet_t jet[8];
} integral_t;
long integrals_add(const integral_t *integrals, int count);
void integrals_release(long first, int count);
void points(const operator_t *op, long n, const double *X, int project, double *W, double *P,
            double *A);
void singular_values(int rows, int cols, int plane, int improper, long n, const double *F,
                     double *U, double *s, double *V);
void kernel_together(tabulate_t kernel, int cells, double *const *A, const double *const *w,
                     const double *c, const double *const *x);
void projection_set(void *factorize, void *eigen);
extern const tabulate_t kernels[64];
void insertion_rows(int owned, int size, const int64_t *starts, const int64_t *blocks,
                    int32_t *rows, int32_t *columns);
int insertion_places(const target_t *t, const int8_t *met, const int32_t *columns[3],
                     const int32_t *first, int16_t *places);
int insertion_diagonal(const int32_t *rows, const int32_t *columns, long count,
                       const int32_t *held, int32_t *places);
long insertion_add(const target_t *t, const part_t *p, const geometry_t *g,
                   const double *constants, double *K, double *x);
typedef struct {
  int kind, cells, nodes, space, dim; const int32_t *numbers; int rows[4]; const int32_t *start;
  const int32_t *node; const double *entry; const double *alone; double spread; int terms;
  int inner, outer; const int16_t *first; const int16_t *second; const double *inverse;
  int corners; const int16_t *corner; int width; const double *d; const int8_t *side;
  int directions; const int32_t *begin; const int16_t *lines; const int16_t *ends; int vertices;
  const double *vertex;
} validity_t;
void validity_coefficients(const validity_t *v, const double *x, double *room, double *out,
                           double *margins);
void validity_scan(const validity_t *v, const double *x, double *room, double *low, double *high,
                   double *most, double *where);
long validity_refine(const validity_t *v, const double *x, double best, double *room,
                     double *parts, double *low, double *high, double *most, double *where);
typedef struct {
  int nodes; int32_t *starts; int32_t *columns; float *blocks; float *inverse; double scale;
} sweeps_t;
long sweeps_count(int nodes, const int32_t *rows, const int32_t *columns);
double sweeps_fill(sweeps_t *s, const int32_t *rows, const int32_t *columns, const double *values);
void sweeps_apply(const sweeps_t *s, const double *b, double *x, int from_zero, double *r,
                  float *room);
typedef struct { const int32_t *rows, *columns; const double *values; } rows_t;
typedef struct { int nodes; const int32_t *starts, *columns; const double *values; } block_rows_t;
int blocks_full(const rows_t *p, int nodes, int R, int K);
void blocks_take(const rows_t *p, const int32_t *const *names, int nodes, int R, int K,
                 int32_t *starts, int32_t *columns, double *values);
int products_reach(const rows_t *A, const block_rows_t *P, int nodes, int R, int32_t *mark,
                   int32_t *starts, int32_t *columns);
void products_rows(int coarse, const int32_t *of_column[2], const int32_t *reach[2],
                   const int32_t *more[2], int32_t *mark, int32_t *starts, int32_t *columns);
void products_add(const rows_t *A, const block_rows_t *P, int nodes, int R, const int32_t *reach[2],
                  int32_t *mark, const int32_t *starts, const int32_t *columns, double *values,
                  double *room);
void products_add_rows(int count, const int32_t *rows, const int32_t *given_starts,
                       const int32_t *given, const double *numbers, const int32_t *starts,
                       const int32_t *columns, double *values);
void products_numbers(int count, const int32_t *starts, const int32_t *columns,
                      const int32_t *names, int32_t *rows, int32_t *out);
extern const long declared[18];
"""
_ELEMENT = """
extern void (*moduli_together)(tabulate_t, int, double *const *, const double *const *,
                               const double *, const double *const *);
extern const long moduli_sizes[3];
extern const long moduli_shape[2];
void moduli_fill(const part_t *p, const geometry_t *g, const double *constants, double *B);
void moduli_product(const part_t *p, const int32_t *numbers, const double *moduli,
                    const double *x, double *y);
long moduli_add(const target_t *t, const part_t *p, const geometry_t *g, const double *constants);
"""
_CELLS = """
typedef void *lanes_kernel_t;
extern const long cells_sizes[3];
extern const long lanes_counts[3], lanes_ids[], lanes_coefficients[], lanes_constants[];
extern const lanes_kernel_t lanes_kernels[];
"""
_STRUCTURES = (
    "operator_t",
    "jet_t",
    "integral_t",
    "target_t",
    "part_t",
    "geometry_t",
    "validity_t",
    "sweeps_t",
    "rows_t",
    "block_rows_t",
)
MAX_OPERATORS, MAX_PIECES, MAX_PARAMETERS = 8, 16, 64
TOGETHER, MAX_PARTS, MAX_LINE = 8, 256, 16  # cells at a time, parts of a cell, numbers in a line
MODES = 6  # rigid motions in space
# Products and sums in one, which C17 alone does not allow: loops over cells side by side gain by it
# (Mooney-Rivlin's moduli a fifth, products a twentieth), those of one point at a time do not.
FUSED = "-ffp-contract=fast"


def library(comm: MPI.Comm) -> tuple[Any, Any]:
    """The loaded library and its cffi interface. Collective.

    Built on rank 0, and whole once it is in the cache, whatever is killed meanwhile. The name holds
    the source, the flags (with the CPU) and the release of DOLFINx.

    Raises:
        RuntimeError: the compiler is missing or failed; alike on all ranks.
    """
    flags = tuple(jit.flags(comm))
    path = _path(flags)

    def build() -> None:
        if comm.rank == 0:
            make_once(path, lambda folder: _build(folder / path.name, flags))

    jit.alike(comm, build, "the operators' kernels")
    return jit.alike(comm, lambda: _load(path), "the operators' kernels")


def element_library(comm: MPI.Comm, text: str) -> tuple[Any, Any]:
    """The loaded loops for one element and its points, and their cffi interface. Collective.

    Args:
        comm: Communicator.
        text: C code that defines what kernels/moduli.h asks for, and includes it.

    Raises:
        RuntimeError: the compiler is missing or failed; alike on all ranks.
    """
    lib, ffi = _made(comm, text, lambda: text, _ELEMENT, "moduli")
    ours, our_ffi = library(comm)
    together = our_ffi.cast("uintptr_t", our_ffi.addressof(ours, "kernel_together"))
    lib.moduli_together = ffi.cast(ffi.typeof(lib.moduli_together), int(together))
    return lib, ffi


def cells_library(comm: MPI.Comm, name: str, text: Callable[[], str]) -> tuple[Any, Any]:
    """The loaded kernels of a form that compute several cells, with kernels/cells.h. Collective.

    Args:
        comm: Communicator.
        name: Digest of the form.
        text: Function that writes the C code, called where it is not in the cache.

    Raises:
        RuntimeError: the compiler is missing or failed; alike on all ranks.
    """
    return _made(comm, name, text, _SUMS + _CELLS, "cells")


def measured(comm: MPI.Comm, name: str, measure: Callable[[], float]) -> float:
    """A number that was measured once on this CPU, so that all runs decide alike. Collective.

    Args:
        comm: Communicator.
        name: What was measured.
        measure: Function that measures it on rank 0, called where it is not in the cache.
    """
    path = _path(tuple(jit.flags(comm)), name).with_suffix(".txt")

    def write(folder: Path) -> Path:
        made = folder / path.name
        made.write_text(repr(measure()))
        return made

    def read() -> float | None:
        if comm.rank:
            return None
        make_once(path, write)
        return float(path.read_text())

    value = comm.bcast(jit.alike(comm, read, "a measurement"))
    assert value is not None
    return float(value)


def _made(
    comm: MPI.Comm, name: str, text: Callable[[], str], declarations: str, kind: str
) -> tuple[Any, Any]:
    """A library of generated code, built on rank 0 where it is not in the cache."""
    flags = (*jit.flags(comm), FUSED)
    path = _path(flags, name)

    def build() -> None:
        if comm.rank == 0:
            make_once(path, lambda folder: _build(folder / path.name, flags, text()))

    jit.alike(comm, build, "loops over cells")
    return jit.alike(comm, lambda: _load_made(path, declarations, kind), "loops over cells")


def _path(flags: tuple[str, ...], text: str = "") -> Path:
    digest = hashlib.sha256(text.encode())
    for source in sorted(SOURCE.iterdir()):
        digest.update(source.read_bytes())
    digest.update(repr((flags, _definitions(), jit.compiler())).encode())
    return jit.folder() / f"libvariform_{digest.hexdigest()[:24]}.so"


def _definitions() -> list[str]:
    return ["-DVARIFORM_CUSTOM_DATA"] if _dolfinx.CUSTOM_DATA else []


def _build(made: Path, flags: tuple[str, ...], text: str = "") -> Path:
    command = [*shlex.split(jit.compiler()), "-std=c17", "-fPIC", "-shared", *flags]
    command += [*_definitions(), "-o", str(made), "-I", str(SOURCE)]
    command += ["-x", "c", "-" if text else str(SOURCE / "library.c"), "-lm"]
    done = subprocess.run(command, input=text, capture_output=True, text=True, check=False)
    if done.returncode:
        raise OSError((done.stderr or done.stdout).strip().splitlines()[0])
    return made


@cache
def _interface(declarations: str) -> cffi.FFI:
    """One for all libraries of a kind: to read the declarations takes 5 ms."""
    ffi = cffi.FFI()
    ffi.cdef(_TABULATE % (", void *" if _dolfinx.CUSTOM_DATA else ""))
    ffi.cdef(declarations)
    return ffi


@cache
def _load(path: Path) -> tuple[Any, Any]:
    ffi = _interface(_INSERTION + _SUMS + _DECLARATIONS)
    loaded: Any = ffi.dlopen(str(path))
    ours = [*map(ffi.sizeof, _STRUCTURES), KERNELS, MAX_OPERATORS, MAX_PIECES, MAX_PARAMETERS]
    ours += [TOGETHER, MAX_PARTS, MAX_LINE, MODES]
    if list(loaded.declared) != ours:
        raise RuntimeError(
            f"{path} declares other structures than Python, sizes and limits {ours} here and "
            f"{list(loaded.declared)} there: the declarations of {Path(__file__).name} and of "
            f"{SOURCE.name}/*.h have to be the same."
        )
    addresses = _petsc.lapack("dpotrf", "dsyev")
    loaded.projection_set(*(ffi.cast("void *", address) for address in addresses))
    return loaded, ffi


@cache
def _load_made(path: Path, declarations: str, kind: str) -> tuple[Any, Any]:
    ffi = _interface(_INSERTION + declarations)
    loaded: Any = ffi.dlopen(str(path))
    ours = [ffi.sizeof(name) for name in ("target_t", "part_t", "geometry_t")]
    there = list(getattr(loaded, f"{kind}_sizes"))
    if there != ours:
        raise RuntimeError(
            f"{path} declares other structures than Python, sizes {ours} here and {there} there: "
            f"the declarations of {Path(__file__).name} and of {SOURCE.name}/insertion.h have to "
            "be the same."
        )
    return loaded, ffi


def pointer(ffi: Any, kernel: Any) -> Any:
    """A kernel of another cffi module as one of ours."""
    return ffi.cast("tabulate_t", int(ffi.cast("uintptr_t", kernel)))
