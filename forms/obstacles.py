# SPDX-License-Identifier: MIT
"""Rigid obstacles: a barrier of the distance between a boundary and a surface given by a formula.

``psi * dx + obstacle(u, plane((0, 0, 0), (0, 0, 1)), ds)``: one more summand of the potential, in
plain UFL. A distance is a function of the deformed place x = X + u, UFL in and UFL out, positive
where the body may be; written with the load factor t it moves.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import ufl
from dolfinx import default_scalar_type, fem

from . import _checks
from ._types import Expr
from .boundaries import KINDS, facet_type, rule, sizes
from .intervals import Intervals
from .kinematics import circumference, is_axisymmetric
from .loads import of_kinematics
from .unknowns import Field, field_of

FINE = 0.1  # of the smallest facet of a boundary: reach of a barrier


@dataclass(frozen=True)
class Distance:
    """A distance whose gradient has length 1, as those of this module have.

    Attributes:
        of: Function of the place x, UFL in and UFL out.
        words: What it is the distance from.
    """

    of: Callable[[Expr], Expr]
    words: str = "surface"

    def __call__(self, x: Expr) -> Expr:
        """The distance of a place."""
        return self.of(x)


class Obstacle(ufl.classes.Label):
    """Label of the distance in a barrier, by which obstacles are known again in a potential.

    Attributes:
        name: Of the obstacle.
        unknown, field: Function and field that move the boundary.
        measure: Where it acts.
        bounds: The distance, from which no step may take all, on intervals of places.
        reach: Distance dhat from which on nothing acts [m], a Constant.
        stiffness: Pressure scale [Pa]; a Constant where a problem is to find it, see ``unset``.
        unset: Whether the stiffness has not been found yet.
        facet: Typical size of the facets [m].
        shift: The gap, where it is a number.
        distance: The distance of a place, gap included, UFL in and UFL out.
    """

    name: str
    unknown: fem.Function
    field: Field
    measure: ufl.Measure
    bounds: Intervals
    reach: fem.Constant
    stiffness: Any
    facet: float
    shift: float | None
    distance: Callable[[Expr], Expr]

    @property
    def unset(self) -> bool:
        """Whether the stiffness is still to be found."""
        return isinstance(self.stiffness, fem.Constant) and not np.isfinite(self.stiffness.value)


def barrier(d: Expr, dhat: Expr, stiffness: Expr) -> Expr:
    """Smooth logarithmic barrier of a distance [J/m^2].

    b(d) = -k dhat (y - 1)^2 ln y, y = d / dhat, for 0 < d < dhat; 0 from dhat on

    It vanishes with its first and second derivatives at dhat, is infinite at 0, and not defined
    (NaN) below. Its pressure is -b' = k ((1 - y)^2 / y - 2 (1 - y) ln y): k at y = 0.53, about
    3 k (1 - y)^2 near dhat.

    Args:
        d: Distance [m].
        dhat: Reach [m].
        stiffness: k, a pressure [Pa].

    Source: Li et al., ACM Trans. Graph. 39 (2020) 49, (6), scaled.
    """
    y = d / dhat
    # Written so that a distance that is NaN, far from where it is needed, counts as out of reach.
    return ufl.conditional(ufl.lt(d, dhat), -stiffness * dhat * (y - 1) ** 2 * ufl.ln(y), 0)


def obstacle(
    u: Expr,
    distance: Any,
    ds: ufl.Measure,
    dhat: float | None = None,
    stiffness: Any = None,
    gap: Any = 0.0,
    name: str = "obstacle",
    parts: int | None = None,
) -> ufl.Form:
    """Potential of a rigid obstacle without friction, int b(phi / |grad phi| + gap) dA. Collective.

    b is :func:`forms.obstacles.barrier`. phi / |grad phi| at x = X + u is the distance to first
    order, so that phi need not be a true distance. The integral has a rule of its own, with points
    at all nodes of degree 1 and 2, each of which the barrier keeps on its side: solves shorten
    their steps so that none crosses, however long a step is, and by a moving obstacle neither.

    Args:
        u: Displacement [m]; of a mixed unknown w["u"].
        distance: phi, a function of the place, as :func:`forms.obstacles.plane` returns one, or one
            of your own: UFL in, UFL out, of the place, numbers and Constants (the load factor)
            alone, positive where the body may be. Several in a list, each with a barrier of its
            own, are one obstacle.
        ds: Boundary that may touch it, as ``body.ds("top")``; of a membrane ``ufl.dx``.
        dhat: Distance from which on the barrier acts [m], not above the smallest facet; by default
            a tenth of that. Error and effort both grow as it gets smaller or larger.
        stiffness: Pressure scale k [Pa] of the barrier, a number or UFL; by default a fifth of
            the body's own, by the tangent's diagonal at rest on this boundary, found when a
            :class:`forms.Problem` is made of it. A pressure of k/10 leaves a gap of 0.83 dhat, k
            0.53 dhat, 10 k 0.12 dhat.
        gap: Moves the surface back, away from the body, by so much [m], a number or UFL of
            Constants: dhat lets a body touch it at the start; one that falls with the load factor
            closes it. Negative, half its thickness for a sheet.
        name: For records and messages.
        parts: Parts that each edge of a facet is cut into for the rule; by default the degree of u.

    Returns:
        Functional to be added to the potential; on a body of revolution it gets the weight 2 pi R
        from the deformation gradient beside it, as pressures do.

    Raises:
        ValueError: an argument of the wrong kind or shape, a boundary without facets, dhat larger
            than the smallest facet, or a distance of anything but the place and Constants.
    """
    w, field = field_of(u, "an obstacle")
    mesh = w.function_space.mesh
    if not field.is_displacement:
        raise ValueError(f"an obstacle needs the displacement, got the field {field.name}.")
    ds = _measure(ds, mesh)
    smallest, typical = sizes(mesh, ds)
    if dhat is None:
        dhat = FINE * smallest
    if not (_checks.number(dhat) is not None and 0 < dhat <= smallest):
        raise ValueError(
            f"dhat of {name} is a length above 0 and up to the smallest facet of its boundary, "
            f"{smallest:.4g}, got {dhat}: a tenth of the facets is the default."
        )
    if (value := _checks.number(stiffness)) is not None and not 0 < value < np.inf:
        raise ValueError(f"the stiffness of {name} is a pressure above 0, got {stiffness}.")
    parts = field.degree if parts is None else parts
    if not isinstance(parts, int) or parts < 1:
        raise ValueError(f"parts of {name} is a whole number of at least 1, got {parts}.")
    points, weights = rule(facet_type(mesh, ds), parts)
    own = {
        "quadrature_rule": "custom",
        "quadrature_points": tuple(tuple(map(float, point)) for point in points),
        "quadrature_weights": tuple(map(float, weights)),
        "quadrature_degree": max(2, 2 * field.degree),
    }
    ds = ds(metadata=own)
    distances = list(distance) if isinstance(distance, list | tuple) else [distance]
    reach = fem.Constant(mesh, default_scalar_type(dhat))
    if stiffness is None:
        stiffness = fem.Constant(mesh, default_scalar_type(np.nan))
    if not distances:
        raise ValueError(f"the obstacle {name} has no distance.")
    flat = (mesh.topology.dim, mesh.geometry.dim) == (2, 2)  # and perhaps a body of revolution
    total = []
    for one in distances:
        label = Obstacle()
        label.name, label.unknown, label.field, label.measure = name, w, field, ds
        label.reach, label.stiffness, label.facet = reach, stiffness, typical
        label.shift = _checks.number(gap)
        place = ufl.SpatialCoordinate(mesh)
        label.bounds = Intervals(_shifted(one, place, gap, name, exact=True), place, name)
        label.distance = partial(_shifted, one, gap=gap, name=name)
        d = ufl.classes.Variable(label.distance(place + u), label)
        b = barrier(d, reach, stiffness)

        def density(F: Expr, b: Expr = b) -> Expr:
            return circumference(u) * b if is_axisymmetric(F) else b

        total.append((of_kinematics(u, None, density) if flat else b) * ds)
    return sum(total[1:], total[0])


def obstacles_in(form: Any) -> list[tuple[Obstacle, Expr, Any]]:
    """Obstacles of a potential: label, distance in UFL, integral, in the order of its integrals."""
    found: list[tuple[Obstacle, Expr, Any]] = []
    for integral in form.integrals() if isinstance(form, ufl.Form) else ():
        for node in ufl.corealg.traversal.unique_pre_traversal(integral.integrand()):
            if isinstance(node, ufl.classes.Variable) and isinstance(node.label(), Obstacle):
                if all(node.label() is not label for label, *_ in found):
                    found.append((node.label(), node, integral))
    return found


def _shifted(distance: Any, x: Expr, gap: Any, name: str, exact: bool = False) -> Expr:
    """Phi / |grad phi| + gap at a place; where only its sign counts phi alone if it may be."""
    if not callable(distance):
        raise ValueError(
            f"the distance of {name} is a function of the place, as forms.obstacles.plane returns "
            f"one, got {type(distance).__name__}."
        )
    place = ufl.variable(x)
    phi = ufl.as_ufl(_checks.in_ufl(distance, f"the distance of {name}", place))
    if phi.ufl_shape != ():
        raise ValueError(f"the distance of {name} is a scalar, got shape {phi.ufl_shape}.")
    if not isinstance(distance, Distance) and not (exact and _checks.number(gap) == 0):
        slope = ufl.diff(phi, place)
        phi = phi / ufl.sqrt(ufl.dot(slope, slope))
    return phi + gap


def _measure(ds: Any, mesh: Any) -> ufl.Measure:
    ds = _checks.measure(ds, "an obstacle")
    dim = mesh.topology.dim
    surface = dim < mesh.geometry.dim
    if ds.integral_type() not in KINDS or (ds.integral_type() == "cell" and not surface):
        raise ValueError(
            'an obstacle needs the measure of a boundary, as body.ds("top"), or of a membrane, '
            f"ufl.dx; got one over {ds.integral_type().replace('_', ' ')}s."
        )
    if ds.metadata():
        raise ValueError(
            f"an obstacle has a quadrature rule of its own, got a measure with {ds.metadata()}: "
            "leave that out, parts= makes the rule finer."
        )
    return ds if ds.ufl_domain() is not None else ds(domain=mesh)


def plane(point: Any, normal: Any) -> Distance:
    """Half-space that the body keeps out of, phi = n . (x - point).

    Args:
        point: On the plane [m], numbers or UFL, as ``(0, 0, 1 - t)``.
        normal: Towards the body, of any length.
    """
    n = _direction(normal)

    def phi(x: Expr) -> Expr:
        return ufl.dot(_checks.vector(n, x.ufl_shape, "a normal"), _from(point, x))

    return Distance(phi, "plane")


def sphere(center: Any, radius: Any, inside: bool = False) -> Distance:
    """Ball, phi = |x - center| - radius; in the plane a disk, of a body of revolution a torus.

    Args:
        center: Its center [m], numbers or UFL.
        radius: Its radius [m].
        inside: The body is inside a hollow ball.
    """
    sign = -1 if inside else 1
    return Distance(lambda x: sign * (_length(_from(center, x)) - radius), "sphere")


def cylinder(point: Any, axis: Any, radius: Any, inside: bool = False) -> Distance:
    """Endless cylinder in space, phi = |distance from its axis| - radius.

    Args:
        point: On its axis [m], numbers or UFL.
        axis: Direction of the axis, of any length.
        radius: Its radius [m].
        inside: The body is inside a tube.
    """
    a, sign = _direction(axis), -1 if inside else 1

    def phi(x: Expr) -> Expr:
        if x.ufl_shape != (3,):
            raise ValueError(
                "a cylinder is one in space: take sphere for its cut in the plane, or plane for "
                "one about the axis of a body of revolution."
            )
        _, beside = _parts(_from(point, x), _checks.vector(a, (3,), "an axis"))
        return sign * (beside - radius)

    return Distance(phi, "cylinder")


def cone(apex: Any, axis: Any, angle: float) -> Distance:
    """Endless cone, in the plane a wedge, with the distance of its apex beside that of its side.

    phi = r cos a - z sin a beside it, |x - apex| above, z along the axis, r away from it

    Args:
        apex: Its tip [m], numbers or UFL.
        axis: Direction in which it widens, of any length.
        angle: Half its opening a [rad], between 0 and pi/2.
    """
    if not 0 < angle < np.pi / 2:
        raise ValueError(f"the half angle of a cone is between 0 and pi/2, got {angle}.")
    a, cos, sin = _direction(axis), float(np.cos(angle)), float(np.sin(angle))

    def phi(x: Expr) -> Expr:
        y = _from(apex, x)
        z, r = _parts(y, _checks.vector(a, x.ufl_shape, "an axis"))
        return ufl.conditional(ufl.lt(r * sin + z * cos, 0), _length(y), r * cos - z * sin)

    return Distance(phi, "cone")


def box(lower: Sequence[Any], upper: Sequence[Any]) -> Distance:
    """Solid box between two corners, with the distances of its faces, edges and corners.

    Args:
        lower: Least coordinates [m], numbers or UFL.
        upper: Largest coordinates.
    """

    def phi(x: Expr) -> Expr:
        ends = [_checks.vector(end, x.ufl_shape, "a corner of a box") for end in (lower, upper)]
        q = [
            abs(x[k] - (a[k] + b[k]) / 2) - (b[k] - a[k]) / 2 for a, b in [ends] for k in _range(x)
        ]
        out = [ufl.max_value(one, 0) for one in q]
        most = q[0]
        for one in q[1:]:
            most = ufl.max_value(most, one)
        return ufl.sqrt(sum(one**2 for one in out)) + ufl.min_value(most, 0)

    return Distance(phi, "box")


def container(lower: Sequence[Any], upper: Sequence[Any]) -> list[Distance]:
    """Walls of a box that the body is in, a plane each; None leaves one open.

    Args:
        lower: Least coordinates [m], numbers or UFL or None.
        upper: Largest coordinates.
    """
    walls = []
    for ends, sign in ((lower, 1), (upper, -1)):
        for k, end in enumerate(ends):
            if end is not None:
                walls.append(_wall(k, end, sign))
    return walls


def _wall(k: int, end: Any, sign: int) -> Distance:
    return Distance(lambda x: sign * (x[k] - end), "wall")


def _range(x: Expr) -> range:
    return range(x.ufl_shape[0])


def _from(point: Any, x: Expr) -> Expr:
    return x - _checks.vector(point, x.ufl_shape, "a point of an obstacle")


def _direction(v: Any) -> Any:
    """A direction made a unit vector, of numbers in numbers."""
    listed = isinstance(v, list | tuple | np.ndarray)
    found = [_checks.number(one) for one in v] if listed else []
    numbers = [one for one in found if one is not None]
    if numbers and len(numbers) == len(found):
        length = float(np.linalg.norm(numbers))
        if not 0 < length < np.inf:
            raise ValueError(f"a direction of an obstacle has a length above 0, got {tuple(v)}.")
        return tuple(one / length for one in numbers)
    expr = ufl.as_vector(list(v)) if isinstance(v, list | tuple) else v
    return expr / _length(expr)


def _length(v: Expr) -> Expr:
    return ufl.sqrt(ufl.dot(v, v))


def _parts(y: Expr, a: Expr) -> tuple[Expr, Expr]:
    """Length along a unit vector, and away from it."""
    z = ufl.dot(y, a)
    if y.ufl_shape == (2,):
        return z, abs(y[0] * a[1] - y[1] * a[0])
    return z, _length(y - z * a)
