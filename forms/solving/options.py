# SPDX-License-Identifier: MIT
"""PETSc options of one solver: presets, and over them whatever the user set anywhere.

Each solver has a prefix of its own in PETSc's database, so that two of them share nothing; what the
user set under the prefix that a call names is copied there, and stays as it is.
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Mapping
from functools import cache
from typing import Any

from petsc4py import PETSc

from .. import _petsc
from .._checks import warn

_FILE = "-options_file"
_numbers = itertools.count(1)


class SolverOptions:
    """Options of one solver; local, to be made alike on all ranks.

    In rising order: presets, ``options=`` of a call, PETSc's database (``PETSc.Options()``,
    -options_file, $PETSC_OPTIONS, .petscrc), the command line.

    Args:
        prefix: Prefix that the user writes, as in ``-variform_snes_monitor``.
        options: Options of the call, without prefix.

    Attributes:
        prefix: The solver's own prefix, as ``variform_1_``, for PETSc's objects.
        user: What the user set, by names without prefix.
    """

    def __init__(self, prefix: str, options: Mapping[str, Any] | None = None) -> None:
        self.prefix = f"{prefix}{next(_numbers)}_"
        _insert_file()
        self.user = {**(options or {}), **_stored(prefix), **_command_line(prefix)}
        self._present: dict[str, Any] = {}
        self._used: set[str] = set()

    def apply(self, presets: Mapping[str, str]) -> None:
        """Put presets, and the user's options over them, in the place of those put before."""
        self.clear()
        for name, value in {**presets, **self.user}.items():
            self[name] = value

    def __setitem__(self, name: str, value: Any) -> None:
        """Set one option of this solver."""
        PETSc.Options()[self.prefix + name] = value
        self._present[name] = value

    def warn_of_unused(self) -> None:
        """Warn of options of the user that PETSc has not asked for."""
        self._note_used()
        if unused := [name for name in self.user if name not in self._used]:
            warn(
                f"PETSc did not use the options {', '.join(unused)}: are they misspelled, or meant "
                "for another solver?"
            )

    def rest(self) -> None:
        """Take the options out of the database, as long as the solver is not in use."""
        self._note_used()
        for name in self._present:
            PETSc.Options().delValue(self.prefix + name)

    def resume(self) -> None:
        """Put them back: some preconditioners ask for theirs at each set-up."""
        for name, value in self._present.items():
            PETSc.Options()[self.prefix + name] = value

    def clear(self) -> None:
        """Take the solver's own options back for good."""
        self.rest()
        self._present = {}

    def _note_used(self) -> None:
        self._used |= {n for n in self._present if _petsc.option_was_used(self.prefix + n)}


def _stored(prefix: str) -> dict[str, str]:
    """Options with the prefix in PETSc's database, but for those of solvers alive."""
    found = {}
    for name in PETSc.Options(prefix).getAll():
        alive = name.split("_")[0].isdigit()
        # What getAll splits at blanks are no names; asking for one marks it as used.
        if not alive and PETSc.Options().hasName(prefix + name):
            found[name] = PETSc.Options().getString(prefix + name, "")
    return found


def _command_line(prefix: str) -> dict[str, str]:
    """Options with the prefix on the command line, which petsc4py does not hand to PETSc."""
    words, found = sys.argv[1:], {}
    for n, word in enumerate(words):
        if word.startswith("-" + prefix):
            following = words[n + 1] if n + 1 < len(words) else ""
            is_value = following and not (following[0] == "-" and following[1:2].isalpha())
            found[word[1 + len(prefix) :]] = following if is_value else ""
    return found


@cache
def _insert_file() -> None:
    """Have PETSc read the file that the command line names by -options_file, once."""
    words = sys.argv[1:]
    if _FILE in words[:-1]:
        PETSc.Options().insertString(f"{_FILE} {words[words.index(_FILE) + 1]}")
