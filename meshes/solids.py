# SPDX-License-Identifier: MIT
"""Bodies of revolution: cylinder and tube, shell of a sphere, ventricle; tetrahedra on CAD."""

from collections.abc import Callable
from math import inf, pi

from mpi4py import MPI

import numpy as np
from numpy.typing import NDArray

from ._arguments import check_order, check_positive
from ._gmsh import extract, generate, name_entities, set_size
from ._grid import Grid
from ._session import gmsh, session
from .body import Body, distribute

__all__ = ["cylinder", "ellipsoid", "sphere_octant"]

# Distance of points, shape (n, 3), from a surface.
Level = Callable[[NDArray[np.float64]], NDArray[np.float64]]


def cylinder(
    comm: MPI.Comm,
    radius: float,
    height: float,
    inner_radius: float = 0.0,
    *,
    h: float,
    order: int = 1,
    sector: float = 2 * pi,
) -> Body:
    """Cylinder or tube about the z axis, from z = 0 to z = height. Collective.

    Boundaries: bottom, top (z = 0, height), outer, and inner for a tube.  A sector has two more:
    y0, where it starts (y = 0), and where it ends x0 (x = 0) if it is a quarter, else cut.
    Region: body.

    Args:
        comm: Communicator of the mesh.
        radius: Outer radius [m].
        height: Height [m].
        inner_radius: Inner radius [m]; 0: a solid cylinder.
        h: Edge length of the tetrahedra [m].
        order: Polynomial order of the geometry, 1 or 2 (nodes amid the edges on the true surface).
        sector: Angle from the plane y = 0, x > 0 counterclockwise [rad]; pi/2: a quarter.

    Returns:
        The body.

    Raises:
        ValueError: Radii, height, h, order or sector that make no cylinder.
    """
    check_positive(radius=radius, height=height, h=h)
    check_order(order)
    if not 0 <= inner_radius < radius:
        raise ValueError(
            f"cylinder needs 0 <= inner_radius < radius, got inner_radius={inner_radius} and "
            f"radius={radius}."
        )
    if not 0 < sector <= 2 * pi:
        raise ValueError(f"cylinder needs 0 < sector <= 2 pi, got sector={sector}.")
    names: dict[str, Level] = {
        "bottom": lambda x: x[:, 2],
        "top": lambda x: x[:, 2] - height,
        "outer": lambda x: np.hypot(x[:, 0], x[:, 1]) - radius,
    }
    if inner_radius > 0:
        names["inner"] = lambda x: np.hypot(x[:, 0], x[:, 1]) - inner_radius
    if sector < 2 * pi:
        # Half planes, so that those of half a cylinder, both in y = 0, are told apart.
        names["y0"] = _half_plane(0.0)
        names["x0" if abs(sector - pi / 2) < 1e-12 else "cut"] = _half_plane(sector)

    def shape() -> None:
        occ = gmsh.model.occ
        solid = [(3, occ.addCylinder(0, 0, 0, 0, 0, height, radius, angle=sector))]
        if inner_radius > 0:
            hole = [(3, occ.addCylinder(0, 0, 0, 0, 0, height, inner_radius, angle=sector))]
            occ.cut(solid, hole)

    return distribute(comm, lambda: _mesh("cylinder", shape, names, h, order))


def sphere_octant(comm: MPI.Comm, inner: float, outer: float, h: float, order: int = 1) -> Body:
    """Eighth of a thick spherical shell about the origin, in x, y, z >= 0. Collective.

    Boundaries: inner, outer (the spheres), x0, y0, z0 (the symmetry planes x = 0, y = 0, z = 0).
    Region: body.

    Args:
        comm: Communicator of the mesh.
        inner: Inner radius [m].
        outer: Outer radius [m].
        h: Edge length of the tetrahedra [m].
        order: Polynomial order of the geometry, 1 or 2 (nodes amid the edges on the true surface).

    Returns:
        The body.

    Raises:
        ValueError: Radii, h or order that make no shell.
    """
    check_positive(inner=inner, outer=outer, h=h)
    check_order(order)
    if not inner < outer:
        raise ValueError(f"sphere_octant needs inner < outer, got inner={inner}, outer={outer}.")
    names: dict[str, Level] = {
        "inner": lambda x: np.linalg.norm(x, axis=1) - inner,
        "outer": lambda x: np.linalg.norm(x, axis=1) - outer,
        "x0": lambda x: x[:, 0],
        "y0": lambda x: x[:, 1],
        "z0": lambda x: x[:, 2],
    }

    def shape() -> None:
        occ = gmsh.model.occ
        ball, hole = (occ.addSphere(0, 0, 0, r, angle1=0, angle3=pi / 2) for r in (outer, inner))
        occ.cut([(3, ball)], [(3, hole)])

    return distribute(comm, lambda: _mesh("sphere_octant", shape, names, h, order))


def ellipsoid(
    comm: MPI.Comm,
    h: float,
    order: int = 1,
    endo: tuple[float, float] = (7.0, 17.0),
    epi: tuple[float, float] = (10.0, 20.0),
    base: float = 5.0,
    apex: float | None = None,
) -> Body:
    """Ventricle: space between two half-axes' ellipsoids of revolution, below a plane. Collective.

    x = (rs sin u cos v, rs sin u sin v, rl cos u), with (rs, rl) = endo on the inner surface and
    epi on the outer one, both cut off at z = base; the apex points to -z.
    The defaults are the geometry of the benchmark, in mm.

    Boundaries: endo, epi, base.  Region: body.

    Args:
        comm: Communicator of the mesh.
        h: Edge length of the tetrahedra, in the unit of the axes; smaller where ten of them would
            not reach around a circle of curvature.
        order: Polynomial order of the geometry, 1 or 2 (nodes amid the edges on the true surface,
            but for coarse cells that it would turn inside out).
        endo: Short and long half axis of the inner surface.
        epi: Short and long half axis of the outer surface.
        base: Height of the plane that cuts both off.
        apex: Edge length at the inner apex, from where the cells grow to h; by default h.

    Returns:
        The body.

    Raises:
        ValueError: Axes, base, h or order that make no ventricle.

    Source:
        S. Land et al., Verification of cardiac mechanics software: benchmark problems and solutions
        for testing active and passive material behaviour, Proc. R. Soc. A 471 (2015) 20150641,
        problems 2 and 3.
    """
    check_positive(h=h, apex=apex, **{"endo[0]": endo[0], "endo[1]": endo[1]})
    check_order(order)
    if not (endo[0] < epi[0] < inf and endo[1] < epi[1] < inf):
        raise ValueError(
            f"ellipsoid needs both half axes of endo smaller than epi's, got endo={tuple(endo)} "
            f"and epi={tuple(epi)}."
        )
    if not abs(base) < endo[1]:
        raise ValueError(
            f"ellipsoid needs |base| < {endo[1]}, the long half axis of endo, got base={base}."
        )
    names: dict[str, Level] = {
        "endo": _spheroid(*endo),
        "epi": _spheroid(*epi),
        "base": lambda x: x[:, 2] - base,
    }

    def shape() -> None:
        occ = gmsh.model.occ
        solids = []
        for short, long in epi, endo:
            # The equator of OCC's sphere goes through the apex: its poles, where the
            # parametrization is singular, would else sit where the mesh should be best.
            ball = [(3, occ.addSphere(0, 0, 0, 1))]
            occ.rotate(ball, 0, 0, 0, 0, 1, 0, pi / 2)
            occ.dilate(ball, 0, 0, 0, short, short, long)
            solids.append(ball)
        wall, _ = occ.cut(*solids)
        above = occ.addBox(-2 * epi[0], -2 * epi[0], base, 4 * epi[0], 4 * epi[0], 2 * epi[1])
        occ.cut(wall, [(3, above)])
        # At the sharply curved apex cells of edge h would not fit between the surfaces.
        gmsh.option.setNumber("Mesh.MeshSizeFromCurvature", 10)
        if apex is not None:
            size = gmsh.model.mesh.field.add("MathEval")
            distance = f"Sqrt(x*x+y*y+(z+{endo[1]!r})*(z+{endo[1]!r}))"
            gmsh.model.mesh.field.setString(size, "F", f"{apex!r}+0.6*{distance}")
            gmsh.model.mesh.field.setAsBackgroundMesh(size)
        # HXT, whose cells stay valid between the curved sides where those of the default tangle.
        gmsh.option.setNumber("Mesh.Algorithm3D", 10)

    return distribute(comm, lambda: _mesh("ellipsoid", shape, names, h, order))


def _half_plane(angle: float) -> Level:
    """Distance from the half plane through the z axis at the given angle."""
    along = np.array([np.cos(angle), np.sin(angle), 0.0])
    across = np.array([-np.sin(angle), np.cos(angle), 0.0])
    return lambda x: np.hypot(x @ across, np.minimum(x @ along, 0))


def _spheroid(short: float, long: float) -> Level:
    """Distance, to first order, from a spheroid about the z axis."""
    return lambda x: short * (np.linalg.norm(x / [short, short, long], axis=1) - 1)


def _mesh(
    source: str, shape: Callable[[], None], names: dict[str, Level], h: float, order: int
) -> Grid:
    """Mesh the one solid that `shape` builds; each surface bears the name whose level it is on."""
    with session():
        shape()
        gmsh.model.occ.synchronize()
        set_size(h)
        try:
            generate(3, order)
        except Exception as failure:  # gmsh's own, of no other kind
            raise ValueError(_too_large(source, h, f"gmsh: {failure}")) from failure
        surfaces: dict[str, list[int]] = {name: [] for name in names}
        x0, y0, z0, x1, y1, z1 = gmsh.model.getBoundingBox(-1, -1)
        size = max(x1 - x0, y1 - y0, z1 - z0)
        for _, surface in gmsh.model.getEntities(2):
            nodes = gmsh.model.mesh.getNodes(2, surface, includeBoundary=True)[1].reshape(-1, 3)
            # The median: nodes of straightened cells may be off their surface.
            off = {name: np.median(np.abs(level(nodes))) for name, level in names.items()}
            nearest = min(off, key=lambda name: off[name])
            if off[nearest] > 1e-6 * size:
                found = f"half the nodes of a surface are {off[nearest]:.1e} off '{nearest}'"
                raise ValueError(_too_large(source, h, found))
            surfaces[nearest].append(surface)
        name_entities(2, surfaces)
        name_entities(3, {"body": [volume for _, volume in gmsh.model.getEntities(3)]})
        return extract(source, 3)


def _too_large(source: str, h: float, found: str) -> str:
    return (
        f"{source}: no mesh of its curved surfaces with cells of {h:g} ({found}): take a smaller "
        "h, of a few thicknesses of the wall at most."
    )
