# SPDX-License-Identifier: MIT
"""Unknowns: one Function, mixed if need be, whose fields have names and roles; the load factor."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from typing import Any
from weakref import WeakKeyDictionary

import basix.ufl
import numpy as np
import ufl
from dolfinx import default_scalar_type, fem
from numpy.typing import NDArray

from . import _checks, _dolfinx
from ._types import Expr

Element = Any  # of basix.ufl, or (family, degree) or (family, degree, shape)


class Role(Enum):
    """What a field is to the potential, by the sign of its own block of the tangent.

    ``curvature``: "+", minimized over, none of its eigenvalues is negative where the state is
    stable; "-" and "0", a pressure or another multiplier, as many negative ones as it has unknowns;
    "?", told by the tangent's diagonal, "+" where an entry is positive.
    """

    DISPLACEMENT = "displacement", "+"
    PRESSURE = "pressure", "-"
    MULTIPLIER = "multiplier", "0"
    SCALAR = "scalar", "+"
    UNDECLARED = "undeclared", "?"

    @property
    def curvature(self) -> str:
        """Sign of the field's own block."""
        return self.value[1]


@dataclass(frozen=True, eq=False)
class Field:
    """One field of an unknown.

    Attributes:
        name: Its name.
        role: What it is to the potential.
        expression: The field in UFL, part of ``ufl.split`` of the unknown, or the unknown itself.
        space: Space of the whole unknown.
        place: Its number among the parts of a mixed space; None where it is the only one.
    """

    name: str
    role: Role
    expression: Expr
    space: fem.FunctionSpace
    place: int | None

    @property
    def view(self) -> fem.FunctionSpace:
        """The field's part of the unknown's space."""
        return self.space if self.place is None else self.space.sub(self.place)

    @cached_property
    def collapsed(self) -> tuple[fem.FunctionSpace, NDArray[np.int32]]:
        """A space of the field alone, and the number in the whole of each of its own."""
        if self.place is None:
            dofmap = self.space.dofmap
            count = (dofmap.index_map.size_local + dofmap.index_map.num_ghosts) * dofmap.bs
            return self.space, np.arange(count, dtype=np.int32)
        return _dolfinx.collapse(self.view)

    @cached_property
    def dofs(self) -> NDArray[np.int32]:
        """Local numbers, in the whole, of this rank's own degrees of freedom."""
        dofmap = self.space.dofmap
        numbers = self.collapsed[1]
        return numbers[numbers < dofmap.index_map.size_local * dofmap.bs]

    @property
    def components(self) -> int:
        """Number of components; 1 of a scalar."""
        return max(1, self.view.num_sub_spaces)

    @property
    def degree(self) -> int:
        """Polynomial degree."""
        whole = self.space.ufl_element()
        element = whole if self.place is None else whole.sub_elements[self.place]
        return max(1, element.embedded_superdegree)

    @property
    def is_displacement(self) -> bool:
        """Whether it moves points of the body."""
        return self.role is Role.DISPLACEMENT


class Unknown(fem.Function):
    """A Function whose fields have names and roles.

    ``w["u"]`` is a field in UFL, for energies and for supports; w itself goes to solves.

    Args:
        space: Its space, mixed where there are several fields.
        roles: Role of each field by name, in the order of the space's parts.
        name: Name for files.

    Attributes:
        fields: The fields by name.
    """

    def __init__(self, space: fem.FunctionSpace, roles: dict[str, Role], name: str) -> None:
        super().__init__(space, name=name)
        parts = [self] if len(roles) == 1 else ufl.split(self)
        places = [None] if len(roles) == 1 else range(len(roles))
        self.fields = {
            key: Field(key, role, part, space, place)
            for (key, role), part, place in zip(roles.items(), parts, places, strict=True)
        }

    def __getitem__(self, key: Any) -> Expr:
        """A field by its name, or a component as UFL has it."""
        if not isinstance(key, str):
            return super().__getitem__(key)
        if key not in self.fields:
            raise ValueError(f"{self.name} has the fields {', '.join(self.fields)}, got {key!r}.")
        return self.fields[key].expression

    def put(self, name: str, value: float | Callable[[NDArray], Any]) -> None:
        """Give a field a value: a number, or a function of points as ``interpolate`` takes it."""
        self[name]  # refuses a name that is none
        W, numbers = self.fields[name].collapsed
        part = fem.Function(W)
        if callable(value):
            part.interpolate(value)
        else:
            part.x.array[:] = value
        part.x.scatter_forward()
        self.x.array[numbers] = part.x.array


def unknown(body: Any, **fields: tuple[Element, Role]) -> Unknown:
    """An unknown of named fields. Collective.

    ``unknown(body, u=(("Lagrange", 2, (3,)), Role.DISPLACEMENT), p=(("DG", 1), Role.PRESSURE))``

    Args:
        body: Mesh, or an object with a ``mesh``.
        **fields: Element and role of each field: an element of ``basix.ufl`` or (family, degree),
            (family, degree, shape). With one field it is the Function of that element.

    Raises:
        ValueError: no field, an entry that is no pair of an element and a role, a displacement
            with another number of components than the body has, or two of them.
    """
    mesh = _checks.mesh_of(body)
    elements, roles = [], {}
    for name, entry in fields.items():
        if not (isinstance(entry, tuple) and len(entry) == 2 and isinstance(entry[1], Role)):
            raise ValueError(
                f"an unknown needs {name} = (element, role), as (('Lagrange', 1), "
                f"forms.Role.SCALAR), got {entry!r}."
            )
        elements.append(_element(mesh, name, entry[0]))
        roles[name] = entry[1]
        shape = elements[-1].reference_value_shape
        if entry[1] is Role.DISPLACEMENT and shape != (mesh.geometry.dim,):
            raise ValueError(
                f"a displacement in {mesh.geometry.dim} dimensions has as many components, got "
                f"{name} of shape {shape}."
            )
    if not elements or list(roles.values()).count(Role.DISPLACEMENT) > 1:
        raise ValueError(
            f"an unknown needs at least one field and at most one displacement, got {fields}."
        )
    whole = elements[0] if len(elements) == 1 else basix.ufl.mixed_element(elements)
    return Unknown(fem.functionspace(mesh, whole), roles, "_".join(roles))


def _element(mesh: Any, name: str, given: Element) -> Any:
    if not isinstance(given, tuple | list):
        return given
    family, degree, *shape = given
    return basix.ufl.element(family, mesh.basix_cell(), degree, shape=shape[0] if shape else None)


def load_factor(body: Any, value: float = 0.0) -> fem.Constant:
    """Load factor t, a UFL constant that loads and supports are written with.

    Args:
        body: Mesh, or an object with a ``mesh``.
        value: Value before the first load step.
    """
    return fem.Constant(_checks.mesh_of(body), default_scalar_type(value))


def displacement(body: Any, degree: int = 1) -> Unknown:
    """Displacement unknown [m], continuous Lagrange of the given degree, one value per dimension.

    Args:
        body: Mesh, or an object with a ``mesh``.
        degree: Polynomial degree, 1 or more, not below the order of the mesh: linear displacements
            do not contain the rotations of curved cells.

    Raises:
        ValueError: degree below 1 or below the order of the mesh.
    """
    mesh = _checks.mesh_of(body)
    k = _degree(degree, 1)
    if k < _dolfinx.geometry_degree(mesh):
        raise ValueError(
            f"displacements of degree {k} cannot rotate a mesh of order "
            f"{_dolfinx.geometry_degree(mesh)} rigidly: take degree "
            f"{_dolfinx.geometry_degree(mesh)} or more, or a mesh of order {k}."
        )
    V = fem.functionspace(mesh, ("Lagrange", k, (mesh.geometry.dim,)))
    return Unknown(V, {"u": Role.DISPLACEMENT}, "displacement")


def displacement_pressure(body: Any, degree: int = 2) -> Unknown:
    """Mixed unknown w = (u, p): Taylor-Hood, displacement of the degree, pressure of one less.

    Use ``w["u"]`` and ``w["p"]`` (or ``u, p = ufl.split(w)``) in energies, w itself in supports and
    solves.

    Args:
        body: Mesh, or an object with a ``mesh``.
        degree: Degree of the displacement, 2 or more (with 1 the pressure would oscillate).

    Raises:
        ValueError: degree below 2.
    """
    mesh = _checks.mesh_of(body)
    k, cell = _degree(degree, 2), mesh.basix_cell()
    U = basix.ufl.element("Lagrange", cell, k, shape=(mesh.geometry.dim,))
    Q = basix.ufl.element("Lagrange", cell, k - 1)
    V = fem.functionspace(mesh, basix.ufl.mixed_element([U, Q]))
    return Unknown(V, {"u": Role.DISPLACEMENT, "p": Role.PRESSURE}, "w")


_INFERRED: WeakKeyDictionary[fem.Function, dict[str, Field]] = WeakKeyDictionary()


def fields_of(u: fem.Function) -> dict[str, Field]:
    """Fields of an unknown by name; of a plain Function, those that its space shows.

    There the first vector of as many components as the body has is the displacement "u", and of
    any other part of a mixed space the tangent tells what it is.
    """
    if isinstance(u, Unknown):
        return u.fields
    if u not in _INFERRED:
        _INFERRED[u] = _inferred(u)
    return _INFERRED[u]


def _inferred(u: fem.Function) -> dict[str, Field]:
    V, dim = u.function_space, u.function_space.mesh.geometry.dim
    if not is_mixed(V):
        role = Role.DISPLACEMENT if V.num_sub_spaces == dim else Role.SCALAR
        return {"u": Field("u", role, u, V, None)}
    found, parts = {}, ufl.split(u)
    moves = [V.sub(k).num_sub_spaces == dim for k in range(V.num_sub_spaces)]
    for k, part in enumerate(parts):
        is_displacement = moves[k] and True not in moves[:k]
        name = "u" if is_displacement else f"field{k}"
        role = Role.DISPLACEMENT if is_displacement else Role.UNDECLARED
        found[name] = Field(name, role, part, V, k)
    return found


def displacement_field(u: fem.Function) -> Field | None:
    """The field of an unknown that moves points of the body, if there is one."""
    return next((f for f in fields_of(u).values() if f.is_displacement), None)


def is_mixed(V: fem.FunctionSpace) -> bool:
    """Whether V is a product of spaces (and not merely blocked, as a vector space is)."""
    return V.num_sub_spaces > 0 and V.dofmap.bs == 1


def field_of(u: Any, what: str) -> tuple[fem.Function, Field]:
    """An unknown and the field of it that is meant: its displacement, or a field as w["theta"].

    Raises:
        ValueError: neither an unknown nor one of its fields.
    """
    if isinstance(u, fem.Function):
        fields = fields_of(u)
        return u, displacement_field(u) or next(iter(fields.values()))
    for w in ufl.algorithms.extract_coefficients(u) if isinstance(u, Expr) else ():
        if isinstance(w, fem.Function):
            for field in fields_of(w).values():
                if field.expression == u:
                    return w, field
    _checks.function(u, what)
    raise AssertionError("unreachable")


def _degree(degree: int, least: int) -> int:
    if not isinstance(degree, int) or degree < least:
        raise ValueError(f"the degree must be a whole number of at least {least}, got {degree}.")
    return degree
