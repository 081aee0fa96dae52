# SPDX-License-Identifier: MIT
"""Coulomb friction on rigid obstacles, as a dissipation potential that lags; of surfaces, too.

phi(v) = mu p f(|v_T|),  f(y) = y for y > e, else y^2/e - y^3/(3 e^2) + e/3

p is the pressure of the barrier and v_T the part of the velocity along the surface, both at the
displacement that the step is solved at: each step is solved again until it is its own. The force
mu p f'(|v_T|) is all of mu p from the speed e on; below it sticks, and creeps.

Source: Li et al., ACM Trans. Graph. 39 (2020) 49, section 5.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import ufl

from . import _checks
from ._types import Expr
from .dissipation import Dissipation
from .obstacles import Obstacle, barrier, obstacles_in
from .surface_contact import Touching
from .surface_friction import SurfaceFriction

ROUND = 1e-9  # of e, that rounds the tip of |v_T|


def friction(
    contact: ufl.Form | Touching,
    mu: float | Expr,
    speed: float,
    tool: Sequence[Expr] | None = None,
) -> list[Any]:
    """Coulomb friction in a contact, for ``dissipation=`` of :func:`forms.transient`.

    Args:
        contact: What :func:`forms.obstacle` or :func:`forms.touching` returned, the very one that
            is in the potential.
        mu: Coefficient of friction, not negative; of surfaces a number.
        speed: e [m/s], below which a body sticks: small against the speeds of the scene.
        tool: Velocity of the obstacle itself [m/s], as a conveyor's; by default 0.

    Raises:
        ValueError: no contact, mu negative, a speed that is not positive, or a tool of surfaces.
    """
    surfaces = isinstance(contact, Touching)
    found = [] if surfaces else obstacles_in(contact)
    if not (surfaces or found):
        raise ValueError(
            "friction needs the contact that it acts in, what forms.obstacle or forms.touching "
            f"returned, got {type(contact).__name__}."
        )
    number = _checks.number(mu)
    if number is not None and not number >= 0:
        raise ValueError(f"a coefficient of friction is not negative, got {number:g}.")
    if not (_checks.number(speed) is not None and speed > 0):
        raise ValueError(f"friction sticks below a speed above 0 [m/s], got {speed}.")
    if isinstance(contact, Touching):
        if number is None or tool is not None:
            raise ValueError(
                "friction of surfaces takes a number for mu and no tool, whose velocity is the "
                f"surfaces' own, got {type(mu).__name__} and {type(tool).__name__}."
            )
        return [SurfaceFriction(contact, number, float(speed))]
    dim = found[0][0].field.components
    moving = None if tool is None else _checks.vector(tool, (dim,), "a tool's velocity")
    return [
        Dissipation(_coulomb(label, mu, speed, moving), dx=label.measure, per_area=True, lags=True)
        for label, *_ in found
    ]


def _coulomb(
    label: Obstacle, mu: float | Expr, speed: float, tool: Expr | None
) -> Callable[[Expr, Expr], Expr]:
    def phi(v: Expr, lag: Expr) -> Expr:
        mesh = label.unknown.function_space.mesh
        place = ufl.variable(ufl.SpatialCoordinate(mesh) + lag)
        d = ufl.variable(label.distance(place))
        pressure = -ufl.diff(barrier(d, label.reach, label.stiffness), d)
        slope = ufl.diff(label.distance(place), place)
        normal = slope / ufl.sqrt(ufl.dot(slope, slope))
        relative = v if tool is None else v - tool
        along = relative - ufl.dot(relative, normal) * normal
        y = ufl.sqrt(ufl.dot(along, along) + (ROUND * speed) ** 2)
        sticking = y**2 / speed - y**3 / (3 * speed**2) + speed / 3
        return mu * pressure * ufl.conditional(ufl.gt(y, speed), y, sticking)

    return phi
