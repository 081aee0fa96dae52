# SPDX-License-Identifier: MIT
"""gmsh, imported when first used, and a session that leaves the user's own as it was."""

import re
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from importlib import import_module
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

__all__ = ["gmsh", "merge", "session"]

# What is meshed must depend neither on the user's session or ~/.gmshrc nor on gmsh's version.
OPTIONS = {
    "General.AbortOnError": 2,
    "General.Terminal": 0,
    "General.NumThreads": 1,
    "Mesh.Algorithm": 6,
    "Mesh.Algorithm3D": 1,
    "Mesh.ElementOrder": 1,
    "Mesh.HighOrderOptimize": 0,
    "Mesh.MeshSizeExtendFromBoundary": 1,
    "Mesh.MeshSizeFactor": 1,
    "Mesh.MeshSizeFromCurvature": 0,
    "Mesh.MeshSizeFromPoints": 1,
    "Mesh.MeshSizeMax": 1e22,
    "Mesh.MeshSizeMin": 0,
    "Mesh.RecombineAll": 0,
    "Mesh.SecondOrderIncomplete": 0,
    "Mesh.SecondOrderLinear": 0,
}

# The one option that gmsh's restoreDefaults forgets.
FORGOTTEN = "Mesh.MetisAlgorithm"

_numbers = count(1)


class _Gmsh:
    """The module gmsh, imported when it is first used: bodies from arrays and XDMF go without."""

    def __getattr__(self, name: str) -> Any:
        try:
            module = import_module("gmsh")
        except ImportError as error:
            raise ImportError(
                f"this body is meshed or read by gmsh, which cannot be imported ({error}): install "
                "Debian's python3-gmsh or variform's extra 'meshes', or read an .xdmf."
            ) from error
        return getattr(module, name)


gmsh = _Gmsh()


@contextmanager
def session() -> Iterator[None]:
    """An empty current gmsh model, quiet, with gmsh's defaults and those options above.

    A session that is already running goes on afterwards with its models, its views, its variables,
    and all its options as they were; otherwise one is started and finalized.
    """
    started = not gmsh.isInitialized()
    if started:
        # No handler for Ctrl-C: it can be installed in the main thread only.
        gmsh.initialize(readConfigFiles=False, interruptible=False)
    try:
        with nullcontext() if started else _kept():
            for name, value in OPTIONS.items():
                gmsh.option.setNumber(name, value)
            known = set(gmsh.model.list())
            gmsh.model.add(next(n for i in _numbers if (n := f"variform{i}") not in known))
            yield
    finally:
        if started:
            gmsh.finalize()


@contextmanager
def _kept() -> Iterator[None]:
    """Put the running session into its first state, and back into the one that it had."""
    options, variables = _options(), _variables()
    current, models = gmsh.model.getCurrent(), set(gmsh.model.list())
    views, parameters = set(gmsh.view.getTags()), set(gmsh.onelab.getNames())
    try:
        gmsh.option.restoreDefaults()
        gmsh.parser.clear()
        yield
    finally:
        for name in set(gmsh.model.list()) - models:
            gmsh.model.setCurrent(name)
            gmsh.model.remove()
        if current in models:
            gmsh.model.setCurrent(current)
        for view in set(gmsh.view.getTags()) - views:
            gmsh.view.remove(view)
        for name in set(gmsh.onelab.getNames()) - parameters:
            gmsh.onelab.clear(name)
        gmsh.parser.clear()
        for name, (numbers, strings) in variables.items():
            if len(numbers):
                gmsh.parser.setNumber(name, numbers)
            else:
                gmsh.parser.setString(name, strings)
        gmsh.option.restoreDefaults()
        for name, value in options.items():
            _set(name, value)


def _options() -> dict[str, Any]:
    """All options that are not at gmsh's defaults: it lists them when it writes an .opt."""
    with TemporaryDirectory() as folder:
        file = Path(folder, "differing.opt")
        gmsh.write(str(file))
        text = file.read_text(errors="replace")
    found = re.findall(r"^(\w+(?:\[\d+\])?)\.(Color\.)?(\w+) = (.)", text, re.MULTILINE)
    options = {FORGOTTEN: gmsh.option.getNumber(FORGOTTEN)}
    for group, color, option, first in found:
        # By gmsh's functions and not as the file has them: it rounds, and drops transparency.
        kind = "Color" if color else "String" if first == '"' else "Number"
        with suppress(Exception):  # gmsh raises bare Exceptions, for what has no function
            name = f"{group}.{option}"
            options[name] = getattr(gmsh.option, f"get{kind}")(name)
    return options


def _set(name: str, value: Any) -> None:
    """Set an option unless it has that value already: some are read-only."""
    kind = "Color" if isinstance(value, tuple) else "String" if isinstance(value, str) else "Number"
    with suppress(Exception):  # a read-only one, which nothing has changed
        if getattr(gmsh.option, f"get{kind}")(name) != value:
            values = value if isinstance(value, tuple) else (value,)
            getattr(gmsh.option, f"set{kind}")(name, *values)


def _variables() -> dict[str, tuple[Any, Any]]:
    """Variables of the scripts that were read: a script could see those of the one before."""
    return {
        name: (gmsh.parser.getNumber(name), gmsh.parser.getString(name))
        for name in gmsh.parser.getNames()
    }


def merge(path: str) -> None:
    """Read a file into the current model.

    Raises:
        Exception: gmsh's own, when it cannot.
    """
    try:
        gmsh.merge(path)
    except Exception:  # gmsh knows no narrower one; raised again below
        # The parser keeps the unread rest of a script with an error, and would take it for the
        # start of the next one: let it swallow harmless ones until it has done with the rest.
        with TemporaryDirectory() as folder:
            harmless = Path(folder, "harmless.geo")
            harmless.write_text("Mesh.MeshSizeFactor = 1;\n")
            for _ in range(1000):
                try:
                    gmsh.merge(str(harmless))
                    break
                except Exception:  # the rest of the script, still being swallowed
                    continue
        raise
