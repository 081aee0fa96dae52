# SPDX-License-Identifier: MIT
"""What a solution is differentiated by: Constants, Functions, and the values of supports."""

from __future__ import annotations

from typing import Any

import numpy as np
import ufl
from dolfinx import fem, la
from dolfinx.fem import petsc as fem_petsc
from numpy.typing import NDArray
from ufl.algorithms import expand_derivatives
from ufl.algorithms.analysis import extract_coefficients, extract_constants

from . import _dolfinx
from .compilation import compiled
from .differentiation import rate, update_dependents
from .native import jit
from .problems import Problem
from .supports import Prescribed, Support

Array = NDArray[np.float64]


def check_parameters(
    parameters: Any, problem: Problem, what: str, supports: bool = True
) -> list[Any]:
    """Parameters as a list; with or without supports among them.

    Raises:
        ValueError: one that is no Constant, Function of the mesh or support of the problem, or is
            the unknown itself.
    """
    listed = list(parameters) if isinstance(parameters, list | tuple) else [parameters]
    if not listed:
        raise ValueError(f"{what} needs at least one parameter, got none.")
    for m in listed:
        if isinstance(m, Support) and supports:
            if m not in problem.supports:
                raise ValueError(
                    f"{what} got a support that is not one of the problem's: pass the object that "
                    "the problem was made with."
                )
            if m.slant is not None:
                raise ValueError(
                    f"{what} got a roller along directions of their own, which prescribes no "
                    "values to differentiate by: leave it out."
                )
        elif not isinstance(m, fem.Constant | fem.Function):
            raise ValueError(
                f"{what} needs parameters that can change: Constants, Functions"
                f"{' or supports' * supports}, got {type(m).__name__} {m}: write the potential "
                "with a fem.Constant."
            )
        elif m is problem.u:
            raise ValueError(f"{what} got the unknown {m.name} as a parameter: it is solved for.")
        elif (
            isinstance(m, fem.Function)
            and m.function_space.mesh is not problem.u.function_space.mesh
        ):
            raise ValueError(f"{what} got {m.name}, a Function of another mesh than the unknown's.")
    return listed


def name_of(m: Any) -> str:
    """What a parameter is called in messages."""
    if isinstance(m, fem.Function):
        return f"the Function {m.name}"
    if isinstance(m, Support):
        return "a support"
    shape = f" of shape {m.ufl_shape}" if m.ufl_shape else ""
    return f"the Constant {m.value}{shape}"


class Slope:
    """Derivative of a form by a Constant or Function, compiled: of a functional, or of a residual.

    Args:
        form: Functional; for a Constant also a linear form.
        m: Constant or Function.

    Attributes:
        empty: Whether the form does not depend on m.
    """

    def __init__(self, form: ufl.Form, m: fem.Constant | fem.Function) -> None:
        self._m = m
        du, self._along = _direction(m)
        slope = expand_derivatives(rate(form, m, du))
        self.empty = slope.empty()
        self._form = None if self.empty else compiled(slope)
        self._whole = slope

    def numbers(self) -> Array:
        """Derivative of a functional by a Constant, of its shape. Collective."""
        found = np.zeros(self._m.ufl_shape)
        if self._form is not None:
            for k in self.entries():
                own = fem.assemble_scalar(self._form)
                found[k] = self._form.mesh.comm.allreduce(own)
        return found

    def entries(self) -> Any:
        """Indices of a Constant's components, one after the other the direction that is taken."""
        update_dependents(self._whole)
        for k in np.ndindex(self._m.ufl_shape):
            if self._along is not None:
                self._along.value[...] = 0
                self._along.value[k] = 1
            yield k

    def add_numbers(self, to: fem.Function, factor: float = 1.0) -> None:
        """Add the derivative of a functional by each value of a Function, weighed. Collective."""
        if self._form is None:
            return
        update_dependents(self._whole)
        b = la.vector(to.function_space.dofmap.index_map, to.function_space.dofmap.index_map_bs)
        b.array[:] = 0
        fem.assemble_vector(b.array, self._form)
        b.scatter_reverse(la.InsertMode.add)
        b.scatter_forward()
        to.x.array[:] += factor * b.array

    def add_vector(self, b: Any) -> None:
        """Add the derivative of a linear form, along the present component. Collective."""
        if self._form is not None:
            fem_petsc.assemble_vector(b, self._form)


def _direction(m: Any) -> tuple[Any, fem.Constant | None]:
    """Direction that a parameter moves along: a test function; for a tensor a Constant of units."""
    if isinstance(m, fem.Function):
        return ufl.TestFunction(m.function_space), None
    if m.ufl_shape == ():
        return ufl.as_ufl(1), None
    along = fem.Constant(m.ufl_domain(), np.zeros(m.ufl_shape))
    return along, along


class SupportSlopes:
    """How the prescribed values of a problem move with a Constant, or as they are themselves.

    Args:
        problem: Whose supports.
        m: Constant; other parameters do not move a support.

    Raises:
        ValueError: m is a Function that a support is written with.
    """

    def __init__(self, problem: Problem, m: Any) -> None:
        self._problem, self._moving = problem, []
        parts = [part for support in problem.supports for part in support.parts]
        self._parts = parts
        for part in parts:
            if part.expression is None or isinstance(m, Support):
                continue
            written = part.expression.ufl_expression
            if isinstance(m, fem.Function):
                if m in extract_coefficients(written):
                    raise ValueError(
                        f"{name_of(m)} stands in a support: pass the support itself as the "
                        "parameter, whose gradient is that of its values at the nodes."
                    )
            elif m in extract_constants(written):
                self._moving.append((part, *_part_slope(part, written, m)))
        self._m = m

    @property
    def empty(self) -> bool:
        """Whether no support depends on the Constant."""
        return not self._moving

    def entries(self, b: Any) -> Any:
        """Indices of a Constant's components; b holds the prescribed values' change. Collective."""
        kept = [part.value.x.array.copy() for part in self._parts]
        for k in np.ndindex(self._m.ufl_shape):
            for part in self._parts:
                part.value.x.array[:] = 0
            for part, expression, along in self._moving:
                if along is not None:
                    along.value[...] = 0
                    along.value[k] = 1
                part.value.interpolate(expression, part.cells)
                part.value.x.scatter_forward()
            b.set(0)
            self._problem.prescribe(b)
            for part, values in zip(self._parts, kept, strict=True):
                part.value.x.array[:] = values
            yield k


def _part_slope(part: Prescribed, written: Any, m: fem.Constant) -> tuple[Any, Any]:
    """Derivative of a prescribed value by a Constant, as what is interpolated."""
    W = part.value.function_space
    du, along = _direction(m)
    slope = expand_derivatives(rate(written, m, du))
    return jit.expression(slope, _dolfinx.interpolation_points(W), W.mesh), along


def held_by(problem: Problem, support: Support) -> NDArray[np.int32]:
    """Owned degrees of freedom whose value a support prescribes, and no later one. Collective."""
    mine = problem.create_vector()
    for other in problem.supports:
        for condition in other.conditions:
            mine.array[_owned(condition, mine.getLocalSize())] = float(other is support)
    found = np.flatnonzero(mine.array_r).astype(np.int32)
    mine.destroy()
    return found


def _owned(condition: fem.DirichletBC, count: int) -> NDArray[np.int32]:
    dofs = condition.dof_indices()[0]
    return dofs[dofs < count]
