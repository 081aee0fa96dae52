# SPDX-License-Identifier: MIT
"""Compiling: the flags every kernel gets, where the results are kept, and one clear error.

The flags let the compiler reorder sums, which is what vectorizes an element kernel, and keep NaN
and inf meaningful: rounding differs in the last digits and nothing else. As they use the CPU's own
instructions, the cache is keyed by the CPU; ranks on unlike CPUs go without.
"""

from __future__ import annotations

import hashlib
import os
import platform
import sysconfig
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from mpi4py import MPI

from dolfinx import jit

REORDER = ["-fno-math-errno", "-fno-trapping-math", "-fno-signed-zeros", "-fassociative-math"]
# Words in the names of errors that are the compiler's or the folder's, and not the form's.
_COMPILERS = ("Compile", "Link", "Verification", "FileNotFound", "Permission", "OSError", "gcc")
_DEFAULTS = (["-O2"], ["-O2", "-g0"])  # DOLFINx's own; anything else is the user's choice


def flags(comm: MPI.Comm) -> list[str]:
    """Compiler flags for kernels on the CPUs of a communicator. Collective."""
    chosen = list(jit.get_options()["cffi_extra_compile_args"])
    if chosen not in _DEFAULTS:
        return chosen
    alike = comm.size == 1 or len(set(comm.allgather(_cpu()))) == 1
    own = ["-march=native", f"-DVARIFORM_CPU={_cpu()}"] if alike else []
    return ["-O3", *own, *REORDER]


def jit_options(comm: MPI.Comm) -> dict[str, Any]:
    """Options for DOLFINx's own compilation. Collective."""
    # How long a program waits for the same form compiled by another: DOLFINx's 10 s are short on a
    # busy machine.
    patience = max(60, int(jit.get_options()["timeout"]))
    return {"cffi_extra_compile_args": flags(comm), "timeout": patience}


def folder() -> Path:
    """Where compiled code is kept: DOLFINx's own cache."""
    return Path(jit.get_options()["cache_dir"])


def compiled(comm: MPI.Comm, ufl_object: Any) -> tuple[Any, Any]:
    """Compile a form, or an expression with its points, by FFCx. Collective.

    Returns:
        FFCx's structure and the module that it lives in, which must outlive every use of it.

    Raises:
        RuntimeError: the compiler is missing or failed; alike on all ranks.
    """
    options = jit_options(comm)
    result, module, _ = alike(
        comm, lambda: jit.ffcx_jit(comm, ufl_object, jit_options=options), "a form"
    )
    return result, module


def alike(comm: MPI.Comm, compile: Callable[[], Any], what: str) -> Any:
    """Run a compilation that fails on all ranks or on none; raise the same sentence everywhere."""
    result, failure = None, ""
    try:
        result = compile()
    except ValueError:  # of the form, and not of the compiler: alike on all ranks
        raise
    except Exception as error:
        failure = " ".join(f"{type(error).__name__}: {error}".split())[:300]
    failure = max(comm.allgather(failure), key=len)
    if not failure:
        return result
    hint = ": is it one that DOLFINx can compile?"
    if any(word in failure for word in _COMPILERS):
        hint = f": is a C compiler installed ({compiler()}), and {folder()} writable?"
    raise RuntimeError(f"compiling {what} failed ({failure}){hint}")


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
