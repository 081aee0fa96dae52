# SPDX-License-Identifier: MIT
"""Surfaces in space for membranes: flat, spherical, cylindrical, and a pillow of two sheets."""

from collections.abc import Callable
from math import pi

from mpi4py import MPI

import numpy as np
from numpy.typing import NDArray

from ._arguments import check_order, check_positive
from ._gmsh import extract, generate, name_entities, set_size
from ._grid import Grid
from ._session import gmsh, session
from .body import Body, distribute

__all__ = ["cylindrical_sheet", "disk", "pillow", "spherical_sheet", "square"]

# Distance of points, shape (n, 3), from a curve's surface.
Level = Callable[[NDArray[np.float64]], NDArray[np.float64]]


def disk(
    comm: MPI.Comm,
    radius: float,
    h: float,
    order: int = 1,
    inner_radius: float = 0.0,
    quarter: bool = False,
) -> Body:
    """Flat disk or annulus about the z axis in the plane z = 0, as a surface in space. Collective.

    Boundaries: outer, and inner for an annulus; of a quarter also x0, y0 (the planes of symmetry).
    Region: body.

    Args:
        comm: Communicator of the mesh.
        radius: Outer radius [m].
        h: Edge length of the triangles [m].
        order: Polynomial order of the geometry, 1 or 2.
        inner_radius: Radius of the hole [m].
        quarter: Only x, y >= 0.

    Raises:
        ValueError: Radii, h or order that make no disk.
    """
    check_positive(radius=radius, h=h)
    check_order(order)
    if not 0 <= inner_radius < radius:
        raise ValueError(
            f"disk needs 0 <= inner_radius < radius, got inner_radius={inner_radius} and "
            f"radius={radius}."
        )
    names: dict[str, Level] = {"outer": _circle(radius)}
    if inner_radius:
        names["inner"] = _circle(inner_radius)
    if quarter:
        names |= _planes("xy")

    def shape() -> None:
        occ = gmsh.model.occ
        sheet = [(2, occ.addDisk(0, 0, 0, radius, radius))]
        if inner_radius:
            sheet, _ = occ.cut(sheet, [(2, occ.addDisk(0, 0, 0, inner_radius, inner_radius))])
        if quarter:
            occ.intersect(sheet, [(2, occ.addRectangle(0, 0, 0, radius, radius))])

    return distribute(comm, lambda: _mesh("disk", shape, names, h, order))


def square(comm: MPI.Comm, side: float, h: float, order: int = 1, quarter: bool = False) -> Body:
    """Flat square about the origin in the plane z = 0, as a surface in space. Collective.

    Boundaries: left, right (x = -side/2, side/2), bottom, top (y); of a quarter, x, y >= 0, right,
    top, x0, y0. Region: body.

    Args:
        comm: Communicator of the mesh.
        side: Edge length of the whole square [m].
        h: Edge length of the triangles [m].
        order: Polynomial order of the geometry, 1 or 2.
        quarter: Only x, y >= 0.

    Raises:
        ValueError: Side, h or order that make no square.
    """
    check_positive(side=side, h=h)
    check_order(order)
    a = side / 2
    names = {"right": _at(0, a), "top": _at(1, a)}
    names |= _planes("xy") if quarter else {"left": _at(0, -a), "bottom": _at(1, -a)}
    low = 0.0 if quarter else -a

    def shape() -> None:
        gmsh.model.occ.addRectangle(low, low, 0, a - low, a - low)

    return distribute(comm, lambda: _mesh("square", shape, names, h, order))


def pillow(comm: MPI.Comm, side: float, h: float, order: int = 1) -> Body:
    """Two flat squares on each other in the plane z = 0, joined along their edges. Collective.

    A closed surface without volume: inflate it. The upper sheet's normal is z, the lower one's -z.
    No boundaries.  Regions: upper, lower.

    Args:
        comm: Communicator of the mesh.
        side: Edge length [m].
        h: Edge length of the triangles [m].
        order: Polynomial order of the geometry, 1 or 2.

    Raises:
        ValueError: Side, h or order that make no pillow.
    """
    check_positive(side=side, h=h)
    check_order(order)
    a = side / 2

    def make() -> Grid:
        with session():
            geo = gmsh.model.geo
            corners = [geo.addPoint(x, y, 0) for x, y in ((-a, -a), (a, -a), (a, a), (-a, a))]
            edges = [geo.addLine(corners[k], corners[(k + 1) % 4]) for k in range(4)]
            upper = geo.addPlaneSurface([geo.addCurveLoop(edges)])
            lower = geo.addPlaneSurface([geo.addCurveLoop([-e for e in reversed(edges)])])
            geo.synchronize()
            set_size(h)
            generate(2, order)
            name_entities(2, {"upper": [upper], "lower": [lower]})
            return extract("pillow", 3)

    return distribute(comm, make)


def spherical_sheet(
    comm: MPI.Comm, radius: float, h: float, order: int = 1, part: str = "whole"
) -> Body:
    """Sphere about the origin, or a part of it, as a surface; normal outward. Collective.

    Boundaries: none of the whole sphere; z0 of a hemisphere (its rim in z = 0, the body in z >= 0);
    x0, y0, z0 of an octant (the planes of symmetry).  Region: body.

    Args:
        comm: Communicator of the mesh.
        radius: Radius [m].
        h: Edge length of the triangles [m].
        order: Polynomial order of the geometry, 1 or 2 (nodes amid the edges on the sphere).
        part: "whole", "hemisphere" or "octant".

    Raises:
        ValueError: Radius, h, order or part that make no sphere.
    """
    check_positive(radius=radius, h=h)
    check_order(order)
    planes = {"whole": "", "hemisphere": "z", "octant": "xyz"}
    if part not in planes:
        raise ValueError(f"spherical_sheet knows the parts {', '.join(planes)}, got {part!r}.")

    def shape() -> None:
        occ = gmsh.model.occ
        if part == "octant":
            ball = occ.addSphere(0, 0, 0, radius, angle1=0, angle3=pi / 2)
        else:
            ball = occ.addSphere(0, 0, 0, radius, angle1=0 if part == "hemisphere" else -pi / 2)
        occ.synchronize()
        flat = [s for s in gmsh.model.getEntities(2) if gmsh.model.getType(*s) == "Plane"]
        occ.remove([(3, ball)])
        occ.remove(flat)

    names = _planes(planes[part])
    return distribute(comm, lambda: _mesh("spherical_sheet", shape, names, h, order))


def cylindrical_sheet(
    comm: MPI.Comm, radius: float, height: float, h: float, order: int = 1
) -> Body:
    """Cylinder about the z axis without its ends, as a surface; normal outward. Collective.

    Boundaries: bottom, top (z = 0, height).  Region: body.

    Args:
        comm: Communicator of the mesh.
        radius: Radius [m].
        height: Height [m].
        h: Edge length of the triangles [m].
        order: Polynomial order of the geometry, 1 or 2 (nodes amid the edges on the cylinder).

    Raises:
        ValueError: Radius, height, h or order that make no cylinder.
    """
    check_positive(radius=radius, height=height, h=h)
    check_order(order)

    def shape() -> None:
        occ = gmsh.model.occ
        solid = occ.addCylinder(0, 0, 0, 0, 0, height, radius)
        occ.synchronize()
        flat = [s for s in gmsh.model.getEntities(2) if gmsh.model.getType(*s) == "Plane"]
        occ.remove([(3, solid)])
        occ.remove(flat)

    names = {"bottom": _at(2, 0.0), "top": _at(2, height)}
    return distribute(comm, lambda: _mesh("cylindrical_sheet", shape, names, h, order))


def _circle(radius: float) -> Level:
    return lambda x: np.hypot(x[:, 0], x[:, 1]) - radius


def _at(axis: int, value: float) -> Level:
    return lambda x: x[:, axis] - value


def _planes(axes: str) -> dict[str, Level]:
    return {f"{axis}0": _at("xyz".index(axis), 0.0) for axis in axes}


def _mesh(
    source: str, shape: Callable[[], None], names: dict[str, Level], h: float, order: int
) -> Grid:
    """Mesh the surfaces that `shape` builds; each rim bears the name whose level it is on."""
    with session():
        shape()
        gmsh.model.occ.synchronize()
        set_size(h)
        generate(2, order)
        # A seam, where a closed surface is cut open for its parametrization, is no boundary.
        surfaces = gmsh.model.getEntities(2)
        rims = {
            abs(curve)
            for _, curve in gmsh.model.getBoundary(surfaces, combined=True, oriented=False)
        }
        curves: dict[str, list[int]] = {name: [] for name in names}
        for curve in sorted(rims):
            x = gmsh.model.mesh.getNodes(1, curve, includeBoundary=True)[1].reshape(-1, 3)
            off = {name: np.abs(level(x)).max() for name, level in names.items()}
            nearest = min(off, key=lambda name: off[name], default="")
            if nearest and off[nearest] <= 1e-6 * max(np.abs(x).max(), h):
                curves[nearest].append(curve)
        name_entities(1, curves)
        name_entities(2, {"body": [surface for _, surface in surfaces]})
        return extract(source, 3)
