# SPDX-License-Identifier: MIT
"""PETSc options of a prefix: which were given, which were used."""

from __future__ import annotations

import ctypes
import os
import shlex
import sys

from petsc4py import PETSc


def was_used(name: str) -> bool:
    """Whether PETSc has asked for an option; petsc4py has no function for it."""
    used = ctypes.c_int(0)
    ctypes.CDLL(PETSc.__file__).PetscOptionsUsed(None, name.encode(), ctypes.byref(used))
    return bool(used.value)


def given(prefix: str) -> dict[str, str]:
    """Options with the prefix from $PETSC_OPTIONS and the command line (which wins)."""
    words = shlex.split(os.environ.get("PETSC_OPTIONS", "")) + sys.argv[1:]
    found = {}
    for n, word in enumerate(words):
        if word.startswith("-" + prefix):
            following = words[n + 1] if n + 1 < len(words) else ""
            is_value = following and not (following[0] == "-" and following[1:2].isalpha())
            found[word[1 + len(prefix) :]] = following if is_value else ""
    return found
