# SPDX-License-Identifier: MIT
"""Blocks and Cook's panel: bodies with six (four) flat sides."""

from collections.abc import Sequence
from math import ceil, prod

from mpi4py import MPI

from ._arguments import check_order, check_positive
from ._gmsh import extract, generate, name_entities, set_size
from ._grid import Grid
from ._session import gmsh, session
from .body import Body, distribute

__all__ = ["block", "cook"]

CELL_NAMES = {2: ("triangle", "quadrilateral"), 3: ("tetrahedron", "hexahedron")}


def block(
    comm: MPI.Comm,
    size: Sequence[float],
    h: float | None = None,
    n: int | Sequence[int] | None = None,
    cells: str | None = None,
    order: int = 1,
    origin: Sequence[float] | None = None,
) -> Body:
    """Rectangle or box with edges along the axes. Collective.

    Boundaries: left, right (x smallest, largest); in two dimensions bottom, top (y); in three
    front, back (y) and bottom, top (z).  Region: body.

    Args:
        comm: Communicator of the mesh.
        size: Edge lengths [m], two or three of them.
        h: Edge length of the cells [m]. Simplices are unstructured; quadrilaterals and hexahedra
            are structured, the fewest with edges no longer than h.
        n: Number of cells along each edge, or one number for all edges; structured.
        cells: "triangle" or "quadrilateral", "tetrahedron" or "hexahedron"; None: simplices.
        order: Polynomial order of the geometry, 1 or 2.
        origin: Corner with the smallest coordinates [m]; None: zero.

    Returns:
        The body.

    Raises:
        ValueError: Sizes, h, n, cells, order or origin that make no block.
    """
    dim = len(size)
    if dim not in (2, 3):
        raise ValueError(f"block needs two or three edge lengths, got {dim}: size={tuple(size)}.")
    check_positive(**{f"size[{i}]": length for i, length in enumerate(size)})
    if origin is None:
        origin = dim * (0.0,)
    if len(origin) != dim:
        raise ValueError(f"block needs {dim} coordinates of the origin, got {tuple(origin)}.")
    n = _numbers("block", dim, h, n)
    cells = _cell_name("block", dim, cells)
    check_order(order)
    if cells in ("quadrilateral", "hexahedron") and n is None and h is not None:
        n = [ceil(length / h * (1 - 1e-12)) for length in size]
    x0, y0 = (float(o) for o in origin[:2])
    x1, y1 = x0 + size[0], y0 + size[1]
    corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
    if dim == 2:
        sides, heights = ("bottom", "right", "top", "left"), [0.0]
    else:
        sides, heights = ("front", "right", "back", "left"), [origin[2], origin[2] + size[2]]
    ends = ("bottom", "top")
    return distribute(
        comm, lambda: _prism("block", corners, heights, sides, ends, h, n, cells, order)
    )


def cook(
    comm: MPI.Comm,
    n: int | Sequence[int] | None = None,
    h: float | None = None,
    cells: str = "triangle",
    thickness: float = 1.0,
    order: int = 1,
) -> Body:
    """Cook's panel, the tapered cantilever with corners (0, 0), (48, 44), (48, 60), (0, 44).

    Collective.  Boundaries: left (clamped in the benchmark), right (loaded), bottom, top; in three
    dimensions also back (z = 0) and front (z = thickness).  Region: body.

    Args:
        comm: Communicator of the mesh.
        n: Number of cells along the panel and across it, in three dimensions also through the
            thickness; or one number for length and width, and through the thickness as many as
            keep the cells about as thick as they are long. Structured.
        h: Edge length of the cells [m]; simplices are unstructured.
        cells: "triangle" or "quadrilateral"; "tetrahedron" or "hexahedron" for a thick panel.
        thickness: Thickness of a panel of tetrahedra or hexahedra [m].
        order: Polynomial order of the geometry, 1 or 2.

    Returns:
        The body.

    Raises:
        ValueError: n, h, cells, thickness or order that make no panel.

    Source:
        R. D. Cook, Improved two-dimensional finite element, J. Struct. Div. ASCE 100 (1974).
    """
    dim = 3 if cells in CELL_NAMES[3] else 2
    cells = _cell_name("cook", dim, cells, CELL_NAMES[2] + CELL_NAMES[3])
    check_positive(thickness=thickness)
    check_order(order)
    if isinstance(n, int) and dim == 3 and n > 0:
        n = (n, n, max(1, round(n * thickness / 48)))
    n = _numbers("cook", dim, h, n)
    if cells in ("quadrilateral", "hexahedron") and n is None and h is not None:
        n = [ceil(length / h) for length in (48.0, 44.0, thickness)[:dim]]
    corners = [(0.0, 0.0), (48.0, 44.0), (48.0, 60.0), (0.0, 44.0)]
    heights = [0.0, thickness] if dim == 3 else [0.0]
    sides = ("bottom", "right", "top", "left")
    return distribute(
        comm, lambda: _prism("cook", corners, heights, sides, ("back", "front"), h, n, cells, order)
    )


def _cell_name(who: str, dim: int, cells: str | None, known: Sequence[str] = ()) -> str:
    known = known or CELL_NAMES[dim]
    if cells is None:
        return known[0]
    if cells not in known:
        raise ValueError(
            f"{who} in {dim} dimensions makes cells of {' or '.join(known)}, got cells={cells!r}."
        )
    return cells


def _numbers(
    who: str, dim: int, h: float | None, n: int | Sequence[int] | None
) -> list[int] | None:
    """Check h and n, of which one must be given; n as one number for each direction."""
    if (h is None) == (n is None):
        raise ValueError(
            f"{who} needs either h (edge length of the cells) or n (numbers of cells), "
            f"got h={h} and n={n}."
        )
    check_positive(h=h)
    if n is None:
        return None
    numbers = [n] * dim if isinstance(n, int) else list(n)
    if len(numbers) != dim or any(int(m) != m or m < 1 for m in numbers):
        raise ValueError(f"{who} needs {dim} positive whole numbers of cells, got n={n}.")
    return [int(m) for m in numbers]


def _prism(
    source: str,
    corners: Sequence[tuple[float, float]],
    heights: Sequence[float],
    sides: Sequence[str],
    ends: Sequence[str],
    h: float | None,
    n: Sequence[int] | None,
    cells: str,
    order: int,
) -> Grid:
    """Quadrilateral in the plane z = heights[0], or the prism over it up to z = heights[1].

    sides[i] names the side on the edge from corners[i] to the next; ends names the two planes.
    """
    geo = gmsh.model.geo
    with session():
        p = [[geo.addPoint(x, y, z) for x, y in corners] for z in heights]
        rings = [[geo.addLine(q[i], q[(i + 1) % 4]) for i in range(4)] for q in p]
        faces = [geo.addPlaneSurface([geo.addCurveLoop(ring)]) for ring in rings]
        dim, rises, walls = 2, [], []
        if len(heights) == 2:
            dim = 3
            rises = [geo.addLine(p[0][i], p[1][i]) for i in range(4)]
            for i in range(4):
                edges = [rings[0][i], rises[(i + 1) % 4], -rings[1][i], -rises[i]]
                walls.append(geo.addPlaneSurface([geo.addCurveLoop(edges)]))
            geo.addVolume([geo.addSurfaceLoop(faces + walls)])
        geo.synchronize()
        if n is None and h is not None:
            set_size(h)
        elif n is not None:
            _structure(n, p, rings, rises, walls, faces, cells in ("quadrilateral", "hexahedron"))
        if dim == 2:
            name_entities(1, {name: [curve] for name, curve in zip(sides, rings[0], strict=True)})
        else:
            named = zip((*sides, *ends), walls + faces, strict=True)
            name_entities(2, {name: [surface] for name, surface in named})
        name_entities(dim, {"body": [1]})
        generate(dim, order)
        grid = extract(source, dim)
    if n is not None and len(grid.cells) % prod(n):
        raise RuntimeError(f"{source}: gmsh made {len(grid.cells)} cells for n={tuple(n)}.")
    return grid


def _structure(
    n: Sequence[int],
    points: Sequence[Sequence[int]],
    rings: Sequence[Sequence[int]],
    rises: Sequence[int],
    walls: Sequence[int],
    faces: Sequence[int],
    recombine: bool,
) -> None:
    """Ask gmsh for n[0] x n[1] (x n[2]) cells, each cut into simplices unless recombined."""
    mesh = gmsh.model.mesh
    for ring in rings:
        for i, curve in enumerate(ring):
            mesh.setTransfiniteCurve(curve, n[i % 2] + 1)
    for curve in rises:
        mesh.setTransfiniteCurve(curve, n[2] + 1)
    corners = dict(zip(faces, points, strict=True))
    for wall, (i, j) in zip(walls, ((0, 1), (1, 2), (3, 2), (0, 3)), strict=False):
        corners[wall] = [points[0][i], points[0][j], points[1][j], points[1][i]]
    for surface, quad in corners.items():
        # The corners start at the least one on every face: the diagonals then are those along which
        # gmsh cuts the volume's cells. In any other order surface and volume do not fit.
        mesh.setTransfiniteSurface(surface, "Left", quad)
        if recombine:
            mesh.setRecombine(2, surface)
    if walls:
        mesh.setTransfiniteVolume(1, [q for ring in points for q in ring])
