# SPDX-License-Identifier: MIT
"""Bounds of the volume ratio J over whole cells, which prove J > 0 in every point. Collective."""

from __future__ import annotations

from typing import Any, NamedTuple

from mpi4py import MPI

import basix
import numpy as np
from dolfinx import fem
from numpy.typing import NDArray

from . import _checks, _dolfinx
from .bernstein import Array, Bernstein, derivative, scaled, sparse
from .kinematics import is_revolved
from .native.library import MAX_LINE, MAX_PARTS, TOGETHER, library
from .native.records import address
from .problems import Problem
from .unknowns import Field, displacement_field

_KINDS = {"solid": 0, "revolved": 1, "surface": 2}
_MAX_DEGREE = 3
SOME = 10_000  # cells whose nodes are placed at a time: for all at once it takes as much as a mesh
_SIMPLICES = ("triangle", "tetrahedron")
_CELLS = (*_SIMPLICES, "quadrilateral", "hexahedron")


class Bounds(NamedTuple):
    """Bounds of the smallest volume ratio of a body, lower <= min J <= upper.

    ``lower > 0`` proves J > 0 in every point of every cell, and ``upper <= 0`` that it is not so.

    Attributes:
        lower: No J of the body is smaller.
        upper: The smallest J that was seen.
        place: Where that is in the reference body: the middle of the cell, or part of a cell.
    """

    lower: float
    upper: float
    place: tuple[float, ...]


class VolumeBounds:
    """Bounds of the smallest volume ratio, or area ratio of a membrane, from tables made once.

    J = det(dx/dxi) / det(dX/dxi),  x = X + u, xi in the reference cell
    body of revolution: J = r det(dx/dxi) / (R det(dX/dxi))
    membrane: a = |x,1 x x,2| / |X,1 x X,2|

    Numerator n and denominator d are polynomials in each cell. With their coefficients n_i and
    d_i > 0 in a Bernstein basis, min n_i / d_i bounds J from below, and coefficients at corners are
    values. Cells that do not tell the sign, or tell min J to less than 2 % of the larger of |min J|
    and max J - min J over the cell, are halved, where that tells most, into 256 parts at most;
    beyond that the bounds are wider. Numbers are right to rounding, and ``lower`` is positive only
    if rounding cannot have made it so.

    Args:
        u: Unknown whose displacement is of Lagrange elements of degree 1 to 3, on straight or
            curved cells of degree 1 to 3.
        axisymmetric: Whether the mesh is a meridian plane of coordinates (r, z).

    Raises:
        ValueError: another element or cell, no displacement, or a body of revolution that is no
            plane mesh.

    Where the mesh is moved afterwards, make another. Collective.

    Source: Johnen, Remacle, Geuzaine, J. Comput. Phys. 233 (2013) 359-372.
    """

    def __init__(self, u: fem.Function, axisymmetric: bool = False) -> None:
        obstacle = _obstacle(u, axisymmetric)
        if obstacle:
            raise ValueError(obstacle)
        field = displacement_field(u)
        assert field is not None
        mesh = u.function_space.mesh
        dim, self._space = mesh.topology.dim, mesh.geometry.dim
        kind = "revolved" if axisymmetric else "solid" if dim == self._space else "surface"
        self.u, self._comm, self._root = u, mesh.comm, kind == "surface"
        self._lib, self._ffi = library(mesh.comm)
        self._keep: list[NDArray] = []
        self._chart = mesh.ufl_domain().ufl_coordinate_element().sub_elements[0]
        cells = mesh.topology.index_map(dim).size_local
        self._geometry = mesh.geometry.x, _dolfinx.geometry_dofmap(mesh)[:cells]
        v = self._struct = self._ffi.new("validity_t *")
        v.kind, v.cells, v.space, v.dim = _KINDS[kind], cells, self._space, dim
        self._put_nodes(field)
        self._put_products(kind)
        self._put_reference()

    def __call__(self) -> Bounds:
        """Bounds at the unknown's present values, alike on all ranks. Collective."""
        u, (low, high, _) = self.u.x.array, self._bounds
        np.add(self._rest, u, out=self._now)
        self._lib.validity_scan(self._struct, *self._addresses)
        best = self._comm.allreduce(float(high.min(initial=np.inf)), MPI.MIN)
        x, room, *bounds = self._addresses
        parts = self._at(self._parts)
        self._lib.validity_refine(self._struct, x, best, room, parts, *bounds)
        lower, upper = float(low.min(initial=np.inf)), float(high.min(initial=np.inf))
        found = self._comm.allgather((lower, upper, self._place(np.flatnonzero(high == upper))))
        _, upper, place = min((one for one in found if one[2]), key=lambda one: one[1:])
        lower = min(upper, *(one[0] for one in found))
        if self._root:
            lower, upper = np.sqrt(np.maximum([lower, upper], 0)).tolist()
        return Bounds(lower, upper, place)

    def _place(self, cells: NDArray[np.intp]) -> tuple[float, ...]:
        """The first, by its coordinates, of the points found in some owned cells."""
        if not len(cells):
            return ()
        x, nodes = self._geometry
        N = self._chart.tabulate(0, self._where[cells])[0]
        points = np.einsum("ca,cai->ci", N, x[nodes[cells], : self._space])
        return min(map(tuple, points.tolist()))

    def _put_nodes(self, field: Field) -> None:
        """First number of each of the cells' nodes, and positions at rest, beside those of u.

        X is an interpolant in u's own space. A geometry of higher degree has nodes of its own,
        whose basis goes beside that of u.
        """
        v, (x, geometry), space = self._struct, self._geometry, self._space
        dofmap = field.view.dofmap
        numbers = dofmap.list[: v.cells]
        numbers = space * numbers if field.place is None else numbers[:, ::space]
        element = _element(field).sub_elements[0]
        self._bases, count = [element], len(self.u.x.array)
        if self._chart.degree <= element.degree:
            N = self._chart.tabulate(0, element.basix_element.points)[0]
            N[np.abs(N) < 1e-14] = 0  # no node is beside an axis of revolution that it is on
            self._x: Array = np.zeros(count)
            for n in range(0, v.cells, SOME):
                at, X = numbers[n : n + SOME, :, None], x[geometry[n : n + SOME], :space]
                self._x[at + np.arange(space)] = np.einsum("pa,cai->cpi", N, X)
        else:
            self._bases.append(self._chart)
            self._x = np.concatenate([np.zeros(count), x[:, :space].ravel()])
            numbers = np.hstack([numbers, count + space * geometry])
        self._rest, self._now = self._x[:count].copy(), self._x[:count]
        v.nodes, v.numbers = numbers.shape[1], self._kept(numbers, np.int32)

    def _put_products(self, kind: str) -> None:
        """Maps from nodes to coefficients of derivatives, and the tables of their products."""
        v, simplex = self._struct, self._chart.cell_type.name in _SIMPLICES
        degree = max(element.degree for element in self._bases)
        whole = Bernstein(simplex, (degree,) * v.dim)
        parts = [derivative(whole, k) for k in range(v.dim)]
        tables = [scaled(p, self._tabulated(1 + k, p.points)) for k, p in enumerate(parts)]
        if kind == "revolved":
            parts.append(whole)
            tables.append(scaled(whole, self._tabulated(0, whole.points)))
        counts = [len(p.indices) for p in parts]
        v.rows = [*counts[: v.dim], *[0] * (3 - v.dim), counts[-1] if kind == "revolved" else 0]
        rows = [row for table in tables for row in table]
        start, node, entry = sparse(rows)
        multinomials = np.concatenate([p.multinomials for p in parts])
        v.start, v.node = self._kept(start, np.int32), self._kept(node, np.int32)
        v.entry, v.alone = self._kept(entry, float), self._kept(1 / multinomials, float)
        v.spread = max(np.abs(row).sum() / m for row, m in zip(rows, multinomials, strict=True))
        f, g = parts[-2:] if kind == "solid" and v.dim == 3 else parts[:2]
        inner, first = f.times(g)
        outer, second = inner, first[:0]
        if kind == "surface":
            outer, second = inner.times(inner)
        elif len(parts) == 3:
            outer, second = parts[0 if kind == "solid" else 2].times(inner)
        v.inner, v.outer = len(inner.indices), len(outer.indices)
        v.first, v.second = self._kept(first, np.int16), self._kept(second, np.int16)
        v.terms = 8 + 2 * sum(np.bincount(t.ravel()).max(initial=0) for t in (first, second))
        v.inverse = self._kept(1 / outer.multinomials, float)
        v.corners, v.corner = len(outer.corners), self._kept(outer.corners, np.int16)
        v.directions = len(outer.directions)
        lines = [[k for line in found for k in (len(line), *line)] for _, found in outer.directions]
        assert max(len(line) for _, found in outer.directions for line in found) <= MAX_LINE
        v.begin = self._kept(np.cumsum([0, *map(len, lines)]), np.int32)
        v.lines = self._kept(np.concatenate(lines), np.int16)
        v.ends = self._kept([way for way, _ in outer.directions], np.int16)
        v.vertices, v.vertex = len(outer.vertices), self._kept(outer.vertices, float)

    def _put_reference(self) -> None:
        """Denominators and room."""
        v = self._struct
        count = v.nodes * (v.space + 1) + v.space * sum(v.rows) + 3 * v.inner + 2 * v.outer
        self._room = np.empty(TOGETHER * count)
        d, margins = np.empty((v.cells, v.outer)), np.empty(v.cells)
        addresses = [self._at(a) for a in (self._x, self._room, d, margins)]
        self._lib.validity_coefficients(v, *addresses)
        side = np.where(d.sum(axis=1) < 0, -1, 1)
        d *= side[:, None]
        # Rounding on an axis of revolution, where d vanishes and nothing else does.
        d[np.abs(d) <= 1e-13 * d.max(axis=1, initial=0)[:, None]] = 0
        # Constant in straight simplices and parallelepipeds; a rank of these alone keeps one each.
        varies = (np.ptp(d, axis=1) > 1e-12 * d.max(axis=1, initial=0)).any()
        d = d if varies else d[:, :1].copy()
        v.width, v.d, v.side = d.shape[1], self._kept(d, float), self._kept(side, np.int8)
        self._parts = np.empty(MAX_PARTS * (2 * v.outer + v.vertices * v.dim))
        self._bounds = np.empty((3, v.cells))
        self._where = np.empty((v.cells, v.dim))
        arrays = self._x, self._room, *self._bounds, self._where
        self._addresses = [self._at(a) for a in arrays]

    def _tabulated(self, which: int, points: Array) -> Array:
        """Value (0) or a derivative of the basis that positions are made of, (points, nodes)."""
        return np.hstack(
            [element.tabulate(min(which, 1), points)[which] for element in self._bases]
        )

    def _kept(self, values: Any, kind: Any) -> Any:
        """Address of an array that is kept here."""
        self._keep.append(np.ascontiguousarray(values, kind))
        return self._at(self._keep[-1])

    def _at(self, array: NDArray) -> Any:
        """Address of an array that lives as long as it is used."""
        return address(self._ffi, array)


def volume_bounds(of: Any, axisymmetric: bool | None = None) -> Bounds:
    """Bounds of the smallest volume ratio J of a body (area ratio of a membrane). Collective.

    ``forms.follow(…, record={"J": forms.validity.volume_bounds})`` keeps them with each step.

    Args:
        of: Path, its problem, or an unknown, whose present values are looked at.
        axisymmetric: Whether it is a body of revolution; by default as the problem's potential
            says, and of an unknown alone that it is none.

    Returns:
        Bounds as :class:`VolumeBounds` finds them. In plane stress J is that of the plane, without
        the stretch of the thickness.

    Raises:
        ValueError: there are no bounds of such an element, see :func:`can_bound`.
    """
    problem = getattr(of, "problem", of)
    u = getattr(problem, "u", problem)
    if axisymmetric is None:
        axisymmetric = isinstance(problem, Problem) and is_revolved(problem.forms.potential)
    kept: dict[bool, VolumeBounds] = _checks.function(u, "a bound of J").__dict__.setdefault(
        "_volume_bounds", {}
    )
    if axisymmetric not in kept:
        kept[axisymmetric] = VolumeBounds(u, axisymmetric)
    return kept[axisymmetric]()


def can_bound(u: fem.Function, axisymmetric: bool = False) -> bool:
    """Whether there are bounds for the displacement of an unknown; local."""
    known = axisymmetric in getattr(u, "_volume_bounds", {})  # it takes as long as the bounds do
    return known or not _obstacle(u, axisymmetric)


def _obstacle(u: fem.Function, axisymmetric: bool) -> str:
    """Why there are no bounds, as a sentence."""
    field = displacement_field(_checks.function(u, "a bound of J"))
    if field is None:
        return f"a volume ratio needs a displacement, and {u.name} has none."
    mesh = u.function_space.mesh
    dim, space, cell = mesh.topology.dim, mesh.geometry.dim, mesh.topology.cell_name()
    if axisymmetric and (dim, space) != (2, 2):
        return (
            "a body of revolution needs a plane mesh of coordinates (r, z), got cells of "
            f"dimension {dim} in {space} dimensions."
        )
    element = _element(field)
    parts = [*element.sub_elements[:1], mesh.ufl_domain().ufl_coordinate_element().sub_elements[0]]
    lagrange = all(
        getattr(part, "element_family", None) == basix.ElementFamily.P
        and 1 <= part.degree <= _MAX_DEGREE
        and _is_nodal(part.basix_element)
        for part in parts
    )
    if cell not in _CELLS or len(parts) < 2 or not lagrange or u.x.array.dtype != np.float64:
        return (
            "bounds of J are known for Lagrange elements of degree 1 to "
            f"{_MAX_DEGREE} in triangles, quadrilaterals, tetrahedra and hexahedra of degree 1 to "
            f"{_MAX_DEGREE}, got {element} on {cell} cells of degree "
            f"{_dolfinx.geometry_degree(mesh)}: look at forms.smallest_volume_ratio."
        )
    return ""


def _element(field: Field) -> Any:
    whole = field.space.ufl_element()
    return whole if field.place is None else whole.sub_elements[field.place]


def _is_nodal(element: Any) -> bool:
    """Whether degrees of freedom are values at points."""
    if element.points.shape[0] != element.dim:
        return False
    return bool(np.allclose(element.tabulate(0, element.points)[0, :, :, 0], np.eye(element.dim)))
