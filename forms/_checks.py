# SPDX-License-Identifier: MIT
"""Checks of what a user passes: one sentence on what was expected, what came, and what to do."""

from __future__ import annotations

import sys
import warnings
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np
import ufl
from dolfinx import fem

from ._types import Expr


def warn(sentence: str) -> None:
    """Warn at the line that called the package, however deep inside it this is; local."""
    inside, frame, level = str(Path(__file__).parent), sys._getframe(1), 2
    while frame.f_back is not None and frame.f_code.co_filename.startswith(inside):
        frame, level = frame.f_back, level + 1
    warnings.warn(sentence, stacklevel=level)


def function(u: Any, what: str) -> fem.Function:
    """U, which has to be a whole unknown and neither an expression nor a mesh."""
    if not isinstance(u, fem.Function):
        raise ValueError(
            f"{what} needs the unknown itself, a Function as forms.displacement returns it, got "
            f"{type(u).__name__}; of a mixed one pass w and not a part of ufl.split(w)."
        )
    return u


def mesh_of(body: Any) -> Any:
    """The mesh of a body, or the mesh itself."""
    return getattr(body, "mesh", body)


def facets(mesh: Any, found: Any) -> np.ndarray:
    """Local facet indices after checking them against the mesh; collective."""
    array = np.asarray(found) if isinstance(found, list | tuple | np.ndarray) else None
    if array is None or (array.size and array.dtype.kind not in "iu"):
        raise ValueError(
            'a boundary is given by its local facet indices, as body.facets("left"), got '
            f"{type(found).__name__} {found if isinstance(found, str) else ''}".rstrip()
            + "."
        )
    dim = mesh.topology.dim - 1
    mesh.topology.create_entities(dim)
    imap = mesh.topology.index_map(dim)
    outside = int(np.sum((array < 0) | (array >= imap.size_local + imap.num_ghosts)))
    count, outside = mesh.comm.allreduce(np.array([array.size, outside]))
    if outside:
        raise ValueError(
            f"{outside} of {count} facets are not of this unknown's mesh: take them from the body "
            "that the unknown was made with."
        )
    if count == 0:
        raise ValueError("a support needs facets, got none on any rank: is the boundary empty?")
    return array.astype(np.int32)


def measure(dx: Any, what: str) -> ufl.Measure:
    """A UFL measure."""
    if not isinstance(dx, ufl.Measure):
        raise ValueError(f'{what} needs a measure, as body.ds("right"), got {type(dx).__name__}.')
    return dx


def vector(v: Any, shape: tuple[int, ...], what: str) -> Expr:
    """A vector as UFL expression: a UFL one, or a sequence of numbers or expressions."""
    expr = ufl.as_vector(list(v)) if isinstance(v, tuple | list | np.ndarray) else ufl.as_ufl(v)
    if expr.ufl_shape != shape:
        raise ValueError(f"{what} needs the shape {shape}, got {expr.ufl_shape}.")
    return expr


def number(value: Expr) -> float | None:
    """A plain or UFL number (0 * t is one) as float; None for any other expression."""
    return float(value) if isinstance(value, Real | ufl.classes.ConstantValue) else None


def direction(A: Any, what: str) -> Expr:
    """A direction in space, of length 1 where it consists of numbers."""
    expr = vector(A, (3,), what)
    if isinstance(expr, ufl.classes.ListTensor):
        values = [number(entry) for entry in expr.ufl_operands]
        length = 1.0 if None in values else float(np.linalg.norm(np.array(values, float)))
        if abs(length - 1) > 1e-8:
            raise ValueError(f"{what} needs a unit vector, got one of length {length:.6g}.")
    return expr
