# SPDX-License-Identifier: MIT
"""What the text of an energy psi_hat says at a call, in UFL, and whether it says the same again."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import basix.ufl
import ufl
from ufl.corealg.traversal import unique_post_traversal

from .._checks import in_ufl
from .._types import Expr

# The jet is compiled without a mesh; UFL wants constants to live on one.
NOWHERE = ufl.Mesh(basix.ufl.element("Lagrange", "interval", 1, shape=(1,)))
# Stand-ins for the singular values, in one process always the same.
PROBES = {n: ufl.Constant(NOWHERE, shape=(n,)) for n in (2, 3)}


@lru_cache(256)
def stand_in(k: int) -> Expr:
    """Stands for the k-th parameter of any psi_hat, in one process always the same; local."""
    return ufl.Constant(NOWHERE)


def text(psi_hat: Callable[..., Expr], n: int, name: str) -> Expr:
    """What psi_hat says of the singular values, the same stand-ins for them at every call; local.

    Raises:
        ValueError: psi_hat cannot be called with UFL scalars.
    """
    return ufl.as_ufl(in_ufl(psi_hat, name, *(PROBES[n][i] for i in range(n))))


def fingerprint(psi: Expr) -> tuple[Any, ...]:
    """A text as nodes: equal for equal texts, whatever numbers its labels and indices got; local.

    Constants and coefficients are what they are: another one makes another text.
    """
    places: dict[Expr, int] = {}
    counted: dict[Any, int] = {}
    nodes: list[Any] = []
    for e in unique_post_traversal(psi):
        if isinstance(e, ufl.classes.Label):
            node: Any = ("label", counted.setdefault(e, len(counted)))
        elif isinstance(e, ufl.classes.MultiIndex):
            node = ("indices", *(_place(i, counted) for i in e))
        elif isinstance(e, ufl.classes.ScalarValue):
            node = ("number", type(e), e.value())
        else:
            inside = [places[operand] for operand in e.ufl_operands]
            node = e if e._ufl_is_terminal_ else (e._ufl_typecode_, *inside)
        places[e] = len(nodes)
        nodes.append(node)
    return tuple(nodes)


def _place(index: Any, counted: dict[Any, int]) -> int:
    """Where a free index was met first; for a fixed one a number below 0."""
    if isinstance(index, ufl.classes.FixedIndex):
        return ~int(index)
    return counted.setdefault(index, len(counted))
