# SPDX-License-Identifier: MIT
"""Checks of what a user passes: one sentence on what was expected, what came, and what to do."""

from __future__ import annotations

import re
import sys
import warnings
from collections.abc import Callable
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray
from ufl.algorithms.analysis import extract_arguments, extract_constants

from . import _dolfinx
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
    return entities(mesh, found, mesh.topology.dim - 1, "a support")


def entities(mesh: Any, found: Any, dim: int, what: str) -> np.ndarray:
    """Local indices of facets, or of entities of another dimension, of a mesh; collective."""
    array = np.asarray(found) if isinstance(found, list | tuple | np.ndarray) else None
    if array is None or (array.size and array.dtype.kind not in "iu"):
        raise ValueError(
            'a boundary is given by its local facet indices, as body.facets("left"), got '
            f"{type(found).__name__} {found if isinstance(found, str) else ''}".rstrip()
            + "."
        )
    kind = "facets" if dim == mesh.topology.dim - 1 else f"entities of dimension {dim}"
    mesh.topology.create_entities(dim)
    imap = mesh.topology.index_map(dim)
    outside = int(np.sum((array < 0) | (array >= imap.size_local + imap.num_ghosts)))
    count, outside = mesh.comm.allreduce(np.array([array.size, outside]))
    if outside:
        raise ValueError(
            f"{outside} of {count} {kind} are not of this unknown's mesh: take them from the body "
            "that the unknown was made with."
        )
    if count == 0:
        raise ValueError(f"{what} needs {kind}, got none on any rank: is the boundary empty?")
    return array.astype(np.int32)


def measure(dx: Any, what: str) -> ufl.Measure:
    """A UFL measure."""
    if not isinstance(dx, ufl.Measure):
        raise ValueError(f'{what} needs a measure, as body.ds("right"), got {type(dx).__name__}.')
    return dx


def vector(v: Any, shape: tuple[int, ...], what: str) -> Expr:
    """A vector as UFL expression: a UFL one, or a sequence of numbers or expressions."""
    if isinstance(v, tuple | list | np.ndarray) and any(
        isinstance(entry, tuple | list | np.ndarray) and np.ndim(entry) for entry in v
    ):
        raise ValueError(
            f"{what} needs the shape {shape}, got an array of shape {np.shape(v)}: for a vector in "
            f'each cell fill the x.array of a Function of ("DG", 0, {shape}) with them.'
        )
    expr = ufl.as_vector(list(v)) if isinstance(v, tuple | list | np.ndarray) else ufl.as_ufl(v)
    if expr.ufl_shape != shape:
        raise ValueError(f"{what} needs the shape {shape}, got {expr.ufl_shape}.")
    return expr


def arity(form: Any, wanted: int, need: str) -> None:
    """Refuse a form whose summands have not all a number of test and trial functions."""
    found = {
        len(extract_arguments(part)) for i in form.integrals() for part in _summands(i.integrand())
    }
    if len(found) > 1:
        raise ValueError(
            f"{need}, got a sum of forms with {' and '.join(map(str, sorted(found)))} arguments: a "
            "virtual work, as follower_pressure returns it, is passed as virtual_work=, and not "
            "added to a potential."
        )
    if found - {wanted}:
        (count,) = found
        raise ValueError(f"{need}, got a form with {count} arguments.")


def _summands(e: Expr) -> list[Expr]:
    if not isinstance(e, ufl.classes.Sum):
        return [e]
    return [part for operand in e.ufl_operands for part in _summands(operand)]


def same_space(expression: Expr, mesh: Any, what: str) -> None:
    """Refuse Constants, as a load factor, of a mesh of another dimension.

    Args:
        expression: UFL expression.
        mesh: The mesh, or an expression on it.
        what: Who asks, for messages.
    """
    domain = ufl.domain.extract_unique_domain(mesh) if isinstance(mesh, Expr) else mesh.ufl_domain()
    own = _dolfinx.geometric_dimension(domain)
    for c in extract_constants(expression):
        dim = _dolfinx.geometric_dimension(ufl.domain.extract_unique_domain(c))
        if dim != own:
            raise ValueError(
                f"{what} on a mesh in {own} dimensions contains a Constant of a mesh in {dim}: "
                "make the load factor with this body, forms.load_factor(body)."
            )


def form_of(form: Any, mesh: Any, what: str) -> None:
    """Refuse forms with Constants of a mesh of another dimension; what is no form passes."""
    for integral in form.integrals() if isinstance(form, ufl.Form) else ():
        same_space(integral.integrand(), mesh, what)


def in_ufl(function: Callable[..., Any], name: str, *args: Any, **given: Any) -> Any:
    """What an energy of a user's own returns for UFL expressions, or one sentence.

    Raises:
        ValueError: it looks at numbers that UFL's expressions do not have.
    """
    try:
        return function(*args, **given)
    except (TypeError, ValueError) as error:
        text = str(error)
        if isinstance(error, TypeError) and re.search(r"argument:|arguments:|keyword|takes", text):
            raise ValueError(f"{name} cannot be called so: {text}.") from error
        number = isinstance(error, TypeError | np.linalg.LinAlgError)
        if not number and "as bool in a Python context" not in text:
            raise
        raise ValueError(
            f"{name} failed on UFL scalars ({text.rstrip('.')}): write it with ufl.ln, ufl.exp, "
            "ufl.max_value, ufl.conditional, .., not with Python's max and if, or NumPy's "
            "functions."
        ) from error


def number(value: Expr) -> float | None:
    """A plain or UFL number (0 * t is one) as float; None for any other expression."""
    return float(value) if isinstance(value, Real | ufl.classes.ConstantValue) else None


def not_negative(value: Any, what: str, name: str, unit: str) -> None:
    """Refuse what is neither a number from 0 on nor a scalar in UFL."""
    given = number(value)
    if given is None and not (isinstance(value, Expr) and value.ufl_shape == ()):
        raise ValueError(
            f"{what} is a number or a scalar in UFL, got {name} of type {type(value).__name__}"
            + (f" and shape {value.ufl_shape}." if isinstance(value, Expr) else ".")
        )
    if given is not None and not given >= 0:
        raise ValueError(f"{what} is not negative, got {name} = {given:g} {unit}.")


def direction(A: Any, what: str) -> Expr:
    """A direction in space, of length 1 where it consists of numbers."""
    expr = vector(A, (3,), what)
    if isinstance(expr, ufl.classes.Zero):
        raise ValueError(f"{what} needs a unit vector, got one of length 0.")
    if isinstance(expr, ufl.classes.ListTensor):
        values = [number(entry) for entry in expr.ufl_operands]
        length = 1.0 if None in values else float(np.linalg.norm(np.array(values, float)))
        if abs(length - 1) > 1e-8:
            raise ValueError(f"{what} needs a unit vector, got one of length {length:.6g}.")
    return expr


def numbers_of(values: Any, what: str, name: str) -> NDArray[np.float64]:
    """Values as an array of numbers, or one sentence."""
    try:
        if np.iscomplexobj(values):
            raise TypeError
        return np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        raise ValueError(f"{name} needs {what} as numbers, got {type(values).__name__}.") from None
