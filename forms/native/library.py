# SPDX-License-Identifier: MIT
"""The compiled kernels of points, cells, insertion, bounds: built once, beside DOLFINx's code."""

from __future__ import annotations

import hashlib
import shlex
import subprocess
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
void projection_set(void *factorize, void *eigen);
extern const tabulate_t kernels[64];
typedef struct {
  int cells, owned, size, nodes; const int32_t *numbers; const int16_t *places;
  const int32_t *rows[3]; double *values[3]; const int8_t *held;
} target_t;
typedef struct {
  tabulate_t kernel; int facets; long count; const int32_t *entities; int width;
  const double *coefficients;
} part_t;
typedef struct { int nodes; const int32_t *numbers; const double *x; } geometry_t;
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
extern const long declared[14];
"""
_STRUCTURES = (
    "operator_t",
    "jet_t",
    "integral_t",
    "target_t",
    "part_t",
    "geometry_t",
    "validity_t",
)
MAX_OPERATORS, MAX_PIECES, MAX_PARAMETERS = 8, 16, 64
TOGETHER, MAX_PARTS, MAX_LINE = 8, 256, 16  # cells at a time, parts of a cell, numbers in a line


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


def _path(flags: tuple[str, ...]) -> Path:
    digest = hashlib.sha256()
    for source in sorted(SOURCE.iterdir()):
        digest.update(source.read_bytes())
    digest.update(repr((flags, _definitions(), jit.compiler())).encode())
    return jit.folder() / f"libvariform_{digest.hexdigest()[:24]}.so"


def _definitions() -> list[str]:
    return ["-DVARIFORM_CUSTOM_DATA"] if _dolfinx.CUSTOM_DATA else []


def _build(made: Path, flags: tuple[str, ...]) -> Path:
    command = [*shlex.split(jit.compiler()), "-std=c17", "-fPIC", "-shared", *flags]
    command += [*_definitions(), "-o", str(made), str(SOURCE / "library.c"), "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise OSError((done.stderr or done.stdout).strip().splitlines()[0])
    return made


@cache
def _load(path: Path) -> tuple[Any, Any]:
    ffi = cffi.FFI()
    ffi.cdef(_TABULATE % (", void *" if _dolfinx.CUSTOM_DATA else ""))
    ffi.cdef(_DECLARATIONS)
    loaded: Any = ffi.dlopen(str(path))
    ours = [*map(ffi.sizeof, _STRUCTURES), KERNELS, MAX_OPERATORS, MAX_PIECES, MAX_PARAMETERS]
    ours += [TOGETHER, MAX_PARTS, MAX_LINE]
    if list(loaded.declared) != ours:
        raise RuntimeError(
            f"{path} declares other structures than Python, sizes and limits {ours} here and "
            f"{list(loaded.declared)} there: the declarations of {Path(__file__).name} and of "
            f"{SOURCE.name}/*.h have to be the same."
        )
    addresses = _petsc.lapack("dpotrf", "dsyev")
    loaded.projection_set(*(ffi.cast("void *", address) for address in addresses))
    return loaded, ffi


def pointer(ffi: Any, kernel: Any) -> Any:
    """A kernel of another cffi module as one of ours."""
    return ffi.cast("tabulate_t", int(ffi.cast("uintptr_t", kernel)))
