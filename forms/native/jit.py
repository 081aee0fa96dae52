# SPDX-License-Identifier: MIT
"""Compiling: the flags every kernel gets, where the results are kept, and one clear error.

The flags let the compiler reorder sums, which is what vectorizes an element kernel, and keep NaN
and inf meaningful: rounding differs in the last digits and nothing else. As they use the CPU's own
instructions, the cache is keyed by the CPU; ranks on unlike CPUs go without.
"""

from __future__ import annotations

import hashlib
import logging
import os
import platform
import shlex
import subprocess
import sysconfig
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import default_scalar_type, fem, jit
from numpy.typing import NDArray

from .. import _dolfinx
from .canonical import canonical
from .once import make_once

REORDER = ["-fno-math-errno", "-fno-trapping-math", "-fno-signed-zeros", "-fassociative-math"]
# Words in the names of errors that are the compiler's or the folder's, and not the form's.
_COMPILERS = ("Compile", "Link", "Verification", "FileNotFound", "Permission", "OSError", "gcc")
_DEFAULTS = (["-O2"], ["-O2", "-g0"])  # DOLFINx's own; anything else is the user's choice


class _Failure(Exception):
    """What went wrong on the rank that compiled, in its words."""


def flags(comm: MPI.Comm) -> list[str]:
    """Compiler flags for kernels on the CPUs of a communicator. Collective."""
    chosen = list(jit.get_options()["cffi_extra_compile_args"])
    if chosen not in _DEFAULTS:
        return chosen
    alike = comm.size == 1 or len(set(comm.allgather((_cpu(), *_native())))) == 1
    own = [*_native(), f"-DVARIFORM_CPU={_cpu()}"] if alike else []
    return ["-O3", *own, *REORDER]


def folder() -> Path:
    """Where compiled code is kept: DOLFINx's own cache."""
    return Path(jit.get_options()["cache_dir"])


def compiled(comm: MPI.Comm, ufl_object: Any) -> tuple[Any, Any, Any]:
    """Compile a form, or an expression with its points, by FFCx. Collective.

    Returns:
        FFCx's structure; the module that it lives in, which must outlive every use of it; and the
        form or expression as it was compiled, whose coefficients and Constants the structure takes.

    Raises:
        RuntimeError: the compiler is missing or failed; alike on all ranks.
    """
    if isinstance(ufl_object, tuple):
        written = canonical(ufl_object[0])
        ufl_object = written, ufl_object[1]
    else:
        ufl_object = written = canonical(ufl_object)

    def compile() -> tuple[Any, Any]:
        options = _prepared(comm, ufl_object)
        return jit.ffcx_jit(comm, ufl_object, _compiler_options(), options)[:2]

    return *alike(comm, compile, "a form"), written


def form(ufl_form: ufl.Form) -> fem.Form:
    """DOLFINx's form of a UFL form that it can compile. Collective.

    Raises:
        RuntimeError: the compiler is missing or failed; alike on all ranks.
    """
    comm = _dolfinx.cpp_mesh(ufl_form.ufl_domain()).comm
    written = canonical(ufl_form)
    return alike(comm, lambda: fem.form(written, jit_options=_prepared(comm, written)), "a form")


def expression(value: Any, points: NDArray[np.float64], mesh: Any) -> fem.Expression:
    """DOLFINx's expression of a UFL expression at points of the reference cell. Collective.

    Raises:
        RuntimeError: the compiler is missing or failed; alike on all ranks.
    """
    written = canonical(value)

    def compile() -> fem.Expression:
        options = _prepared(mesh.comm, (written, points), jit.get_options())
        return fem.Expression(
            written, points, mesh.comm, jit_options=options, dtype=default_scalar_type
        )

    made = alike(mesh.comm, compile, "an expression")
    made._ufl_expression = value  # as it was given, with its own Constants
    return made


def _prepared(
    comm: MPI.Comm, ufl_object: Any, options: dict[str, Any] | None = None
) -> dict[str, Any]:
    """Options with which DOLFINx finds an object compiled, in a folder of its own. Collective.

    FFCx by itself leaves a file behind when it is killed, and then every later run waits for it.
    Rank 0 compiles; where ranks share no cache, so does one of each.

    Args:
        comm: Communicator.
        ufl_object: Form, or expression with its points.
        options: Options of DOLFINx; its own with our flags by default.
    """
    chosen = options or {"cffi_extra_compile_args": flags(comm)}

    def make(folder: Path) -> Path:
        made = folder / "made"
        with handlers_kept():
            jit.ffcx_jit(
                MPI.COMM_SELF, ufl_object, _compiler_options(), {**chosen, "cache_dir": made}
            )
        return made

    problem: tuple[str, bool] | None = None
    for turn in (0, 1)[: comm.size]:
        try:
            if turn == min(comm.rank, 1):
                name = _dolfinx.signature(ufl_object, _kind(chosen))
                place = folder() / f"variform_{name}"
                make_once(place, make)
        except Exception as error:  # whatever it is: the other ranks wait in allgather
            if comm.size == 1:
                raise
            problem = f"{type(error).__name__}: {error}", isinstance(error, ValueError)
        if comm.size > 1:
            problems = [p for p in comm.allgather(problem) if p is not None]
            if problems:
                text, of_the_form = max(problems)
                raise ValueError(text.partition(": ")[2]) if of_the_form else _Failure(text)
    return {**chosen, "cache_dir": place}


def _kind(options: dict[str, Any]) -> str:
    """What code depends on besides the form: the C compiler's options, Python, the scalars."""
    chosen = jit.get_options(options)
    cffi = [(key, str(chosen[key])) for key in sorted(chosen) if key.startswith("cffi_")]
    python = [sysconfig.get_config_var(name) for name in ("SOABI", "CFLAGS")]
    return f"{cffi} {python} {_compiler_options()}"


def _compiler_options() -> dict[str, Any]:
    return {"scalar_type": default_scalar_type}  # named as DOLFINx names it


@contextmanager
def handlers_kept() -> Iterator[None]:
    """Give the log its handlers back, which FFCx takes away while it compiles."""
    root = logging.getLogger()
    handlers = root.handlers.copy()
    try:
        yield
    finally:
        root.handlers = handlers


def alike(comm: MPI.Comm, compile: Callable[[], Any], what: str) -> Any:
    """Run a compilation that fails on all ranks or on none; raise the same sentence everywhere."""
    result, failure = None, ""
    try:
        result = compile()
    except ValueError:  # of the form, and not of the compiler: alike on all ranks
        raise
    except Exception as error:  # whatever it is: the other ranks wait in allgather
        text = error if isinstance(error, _Failure) else f"{type(error).__name__}: {error}"
        failure = " ".join(str(text).split())[:300]
    failure = max(comm.allgather(failure), key=len)
    if not failure:
        return result
    hint = ": is it one that DOLFINx can compile?"
    if any(word in failure for word in _COMPILERS):
        hint = f": is a C compiler installed ({compiler()}), and {folder()} writable?"
    raise RuntimeError(f"compiling {what} failed ({failure}){hint}")


@cache
def _native() -> list[str]:
    """The compiler's option for the CPU's own instructions; empty where it has none."""
    command = [*shlex.split(compiler()), "-x", "c", "-fsyntax-only", os.devnull]
    for option in ("-march=native", "-mcpu=native"):
        try:
            done = subprocess.run([*command, option], capture_output=True, check=False)
        except OSError:  # no compiler: what the cache holds was made with the first
            return ["-march=native"]
        if done.returncode == 0:
            return [option]
    return []


@cache
def _cpu() -> str:
    """A short name of this CPU's instruction set."""
    try:
        text = Path("/proc/cpuinfo").read_text()
        lines = {line for line in text.splitlines() if line.startswith(("flags", "Features"))}
        described = min(lines, default="")
    except OSError:
        described = platform.processor()
    described = f"{platform.machine()} {described}"
    return hashlib.sha256(described.encode()).hexdigest()[:12]


def compiler() -> str:
    """Name of the C compiler: CC, or the one that Python was built with."""
    return os.environ.get("CC") or str(sysconfig.get_config_var("CC")).split()[0]
