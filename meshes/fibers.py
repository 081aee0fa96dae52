# SPDX-License-Identifier: MIT
"""Fibers of the ventricle that :func:`meshes.ellipsoid` makes, as arrays and as a UFL field."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import ufl
from numpy.typing import NDArray

from ._arguments import check_positive
from .body import Body

__all__ = ["ellipsoid_depth", "ellipsoid_fiber_field", "ellipsoid_fibers"]

Array = NDArray[np.float64]
Axes = tuple[float, float]

# Newton's iterations for the depth: four reach rounding in the default wall, five in thick ones.
ITERATIONS = 5
# How far out of the wall, over its thickness, points may be: cells with straight edges cut corners.
SLACK = 0.25


def ellipsoid_depth(x: Array, endo: Axes = (7.0, 17.0), epi: Axes = (10.0, 20.0)) -> Array:
    """Depth t in the wall of an ellipsoid: 0 on its inner surface, 1 on its outer one. Local.

    The root of (r / rs)^2 + (z / rl)^2 = 1 with (rs, rl) = (1 - t) endo + t epi, r^2 = x^2 + y^2.

    Args:
        x: Points, shape (n, 3).
        endo: Short and long half axis of the inner surface.
        epi: Short and long half axis of the outer surface.

    Returns:
        Depths, shape (n,); a little below 0 or above 1 for points beside the wall.

    Raises:
        ValueError: Axes that make no wall, points of another shape, or one that lies out of the
            wall by more than a quarter of its thickness.
    """
    _check(endo, epi)
    x = np.asarray(x, dtype=np.float64)
    if x.ndim != 2 or x.shape[1] != 3:
        raise ValueError(f"points have the shape (n, 3), got {x.shape}.")
    # Far outside the iteration may pass a half axis of length 0; what comes out is refused below.
    with np.errstate(all="ignore"):
        t = np.asarray(_depth(_NUMPY, x.T, endo, epi))
    outside = np.flatnonzero(~(np.abs(t - 0.5) <= 0.5 + SLACK))
    if outside.size:
        first = tuple(float(c) for c in x[outside[0]])
        raise ValueError(
            f"{outside.size} of {len(x)} points lie outside the wall between the half axes "
            f"{tuple(endo)} and {tuple(epi)}, the first is {first}: give the axes, and the unit, "
            "that the ellipsoid was made with."
        )
    return t


def ellipsoid_fibers(
    x: Array,
    endo: Axes = (7.0, 17.0),
    epi: Axes = (10.0, 20.0),
    angles: tuple[float, float] = (90.0, -90.0),
) -> Array:
    """Unit vectors along the muscle fibers in the wall of an ellipsoid. Local.

    f = n(dx/du) sin a + n(dx/dv) cos a,  n(y) = y / |y|,  a = (1 - t) angles[0] + t angles[1]
    x = (rs sin u cos v, rs sin u sin v, rl cos u) with -pi < u < 0, so that dx/du points from the
    apex to the base and dx/dv counterclockwise about the z axis

    Args:
        x: Points, shape (n, 3).
        endo: Short and long half axis of the inner surface.
        epi: Short and long half axis of the outer surface.
        angles: Angle a on the inner and on the outer surface [degrees], linear in between; beside
            the wall that of the nearer surface.

    Returns:
        Unit vectors, shape (n, 3). On the z axis, where the field has no limit, those for v = pi.

    Raises:
        ValueError: As :func:`ellipsoid_depth`.

    Source:
        S. Land et al., Proc. R. Soc. A 471 (2015) 20150641, problem 3, whose numbers the defaults
        are; u and v as there.
    """
    t = ellipsoid_depth(x, endo, epi)
    return np.array(_fiber(_NUMPY, np.asarray(x, float).T, t, endo, epi, angles)).T


def ellipsoid_fiber_field(
    body: Body,
    endo: Axes = (7.0, 17.0),
    epi: Axes = (10.0, 20.0),
    angles: tuple[float, float] = (90.0, -90.0),
) -> Any:
    """The fibers of :func:`ellipsoid_fibers` as a UFL expression of the coordinates. Collective.

    It is the field itself at every quadrature point, and no interpolation of it: of unit length,
    for any degree, and without data that processes would have to exchange.

    Args:
        body: Ventricle, as :func:`meshes.ellipsoid` makes it; or its meridian section, a plane body
            with the coordinates (r, z).
        endo: Short and long half axis of the inner surface, as for the body.
        epi: Short and long half axis of the outer surface.
        angles: Angle on the inner and on the outer surface [degrees].

    Returns:
        UFL vector of three components, to be passed as ``fiber`` of an energy; of a meridian
        section along r, around the axis, and along z.

    Raises:
        ValueError: Axes that make no wall, or whose wall is not where the body is.
    """
    mesh, failure = body.mesh, ""
    X, nodes = ufl.SpatialCoordinate(mesh), np.asarray(mesh.geometry.x, dtype=np.float64)
    x, order = list(X), [0, 1, 2]
    if mesh.geometry.dim == 2:
        x, order = [X[0], 0.0, X[1]], [0, 2, 1]
    try:
        ellipsoid_depth(nodes[:, order], endo, epi)
    except ValueError as error:
        failure = str(error)
    failure = max(mesh.comm.allgather(failure), key=len)
    if failure:
        raise ValueError(failure)
    return ufl.as_vector(_fiber(_UFL, x, _depth(_UFL, x, endo, epi), endo, epi, angles))


# The few functions that arrays and expressions do not share.
_NUMPY = SimpleNamespace(
    sqrt=np.sqrt,
    sin=np.sin,
    cos=np.cos,
    within=lambda t: np.clip(t, 0.0, 1.0),
    at_zero=lambda r, value, other: np.where(r == 0, value, other),
)
_UFL = SimpleNamespace(
    sqrt=ufl.sqrt,
    sin=ufl.sin,
    cos=ufl.cos,
    within=lambda t: ufl.min_value(ufl.max_value(t, 0.0), 1.0),
    at_zero=lambda r, value, other: ufl.conditional(ufl.eq(r, 0.0), value, other),
)


def _depth(lib: Any, x: Any, endo: Axes, epi: Axes) -> Any:
    """Newton's method for G(t) = q^(-1/2) = 1, q = (r / rs)^2 + (z / rl)^2, from t = 0.

    G is concave and almost linear in t (it is linear where rs and rl grow in proportion), so that
    the iterates rise to the root without passing it.
    """
    (ds, dl), r2, z2 = (epi[0] - endo[0], epi[1] - endo[1]), x[0] ** 2 + x[1] ** 2, x[2] ** 2
    t: Any = 0.0
    for _ in range(ITERATIONS):
        rs, rl = endo[0] + ds * t, endo[1] + dl * t
        q = r2 / rs**2 + z2 / rl**2
        slope = r2 * ds / rs**3 + z2 * dl / rl**3  # -q'/2
        t = t + (lib.sqrt(q) - 1) * q / slope  # (1 - G) / G', G' = slope q^(-3/2)
    return t


def _fiber(
    lib: Any, x: Any, t: Any, endo: Axes, epi: Axes, angles: tuple[float, float]
) -> list[Any]:
    """Components of the unit vector along the fibers at points of depth t."""
    rs, rl = (inner + (outer - inner) * t for inner, outer in zip(endo, epi, strict=True))
    a = (angles[0] + (angles[1] - angles[0]) * lib.within(t)) * (np.pi / 180)
    r = lib.sqrt(x[0] ** 2 + x[1] ** 2)
    over = lib.at_zero(r, 1.0, r)
    radial = lib.at_zero(r, 1.0, x[0] / over), x[1] / over
    out, up = -rs * x[2] / rl, rl * r / rs  # dx/du: along the radius and along z
    length = lib.sqrt(out**2 + up**2)
    s, c = lib.sin(a), lib.cos(a)
    return [
        s * out / length * radial[0] - c * radial[1],
        s * out / length * radial[1] + c * radial[0],
        s * up / length,
    ]


def _check(endo: Axes, epi: Axes) -> None:
    check_positive(**{"endo[0]": endo[0], "endo[1]": endo[1]})
    if not (endo[0] < epi[0] < np.inf and endo[1] < epi[1] < np.inf):
        raise ValueError(
            f"a wall needs both half axes of endo smaller than epi's, got endo={tuple(endo)} and "
            f"epi={tuple(epi)}."
        )
