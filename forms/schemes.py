# SPDX-License-Identifier: MIT
"""Schemes in time, each a minimization: what a step lowers, and the motion that follows from it.

A step from t_n to t_n + dt finds the displacement s that makes

Pi(s; t) + c/2 int rho |s - u*|^2 dX + 1/b int phi(b s + d) dX

stationary: total potential, inertia, and a dissipation potential of the velocity b s + d. The
acceleration is c (s - u*). A scheme says c, b, and u* and d as sums over what is known, u, v, a at
t_n and u, v at the state before. With small steps the sum is convex whatever Pi is.

Rates of a strain e(u), objective ones of Green's strain among them, are

b0 e(s) + b1 e(u_n) + b2 e(u_n-1) + g e'(u_n)[v_n] + k e''(u_n)[v_n, v_n]

of the scheme's own order in dt.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

Weights = tuple[float, float, float, float, float]  # of u_n, v_n, a_n, u_n-1, v_n-1
Strain = tuple[float, float, float, float, float]  # b0, b1, b2, g, k


class Stage(NamedTuple):
    """What a step minimizes.

    Attributes:
        inertia: c [1/s^2].
        start: u* by weights.
        rate: b [1/s].
        drift: d by weights.
        strain: Weights of a strain's rate.
    """

    inertia: float
    start: Weights
    rate: float
    drift: Weights
    strain: Strain


class Scheme(Protocol):
    """A scheme in time.

    Attributes:
        order: Order of the displacements and velocities at a time.
        middle: Whether s is the displacement at the middle of the step, and not at its end.
        two_step: Whether the state before the last one is needed.
    """

    @property
    def order(self) -> int:
        """Order of the displacements and velocities at a time."""

    middle: bool
    two_step: bool

    def stage(self, dt: float, before: float) -> Stage:
        """What a step of dt minimizes, after one of ``before``, which is 0 for the first one."""

    def error(self, dt: float, before: float) -> float:
        """Weight e [s^2] of the local error e (a - a_n), or e a of a scheme of order 1."""


@dataclass(frozen=True)
class Euler:
    """Implicit Euler: v = (u - u_n) / dt, a = (v - v_n) / dt. Order 1; calms whatever moves.

    c = 1/dt^2, u* = u_n + dt v_n; local error dt^2/2 a
    """

    order = 1
    middle = two_step = False

    def stage(self, dt: float, before: float) -> Stage:
        """What a step of dt minimizes."""
        r = 1 / dt
        return Stage(r**2, (1, dt, 0, 0, 0), r, (-r, 0, 0, 0, 0), (r, -r, 0, 0, 0))

    def error(self, dt: float, before: float) -> float:
        """Weight of the acceleration in the local error."""
        return dt**2 / 2


@dataclass(frozen=True)
class BDF2:
    """Backward differences over two steps of any lengths; the first step is implicit Euler's.

    v = r0 u + r1 u_n + r2 u_n-1, a = r0 v + r1 v_n + r2 v_n-1, with w = dt / dt_before and
    r0 = (1 + 2 w) / ((1 + w) dt), r1 = -(1 + w) / dt, r2 = w^2 / ((1 + w) dt). Order 2; calms fast
    vibrations. c = r0^2; local error (1 + w)^2 / (6 w (1 + 2 w)) dt^3 u'''.
    """

    order = 2
    middle, two_step = False, True

    def stage(self, dt: float, before: float) -> Stage:
        """What a step of dt minimizes."""
        if not before:
            return Euler().stage(dt, before)
        w = dt / before
        r0, r1, r2 = (1 + 2 * w) / ((1 + w) * dt), -(1 + w) / dt, w**2 / ((1 + w) * dt)
        start = (-r1 / r0, -r1 / r0**2, 0.0, -r2 / r0, -r2 / r0**2)
        return Stage(r0**2, start, r0, (r1, 0, 0, r2, 0), (r0, r1, r2, 0, 0))

    def error(self, dt: float, before: float) -> float:
        """Weight of the change of acceleration in the local error."""
        if not before:
            return Euler().error(dt, before)
        w = dt / before
        return (1 + w) ** 2 / (6 * w * (1 + 2 * w)) * dt**2


@dataclass(frozen=True)
class Newmark:
    """Newmark's scheme, by default the trapezoidal rule, which damps nothing.

    u = u_n + dt v_n + dt^2 ((1/2 - beta) a_n + beta a), v = v_n + dt ((1 - gamma) a_n + gamma a)

    c = 1 / (beta dt^2), u* = u_n + dt v_n + dt^2 (1/2 - beta) a_n

    Order 2 with gamma = 1/2, else 1; local error (beta - 1/6) dt^2 (a - a_n). Source: N. M.
    Newmark, J. Eng. Mech. Div. ASCE 85 (1959) 67.

    Raises:
        ValueError: beta is not positive, or gamma below 1/2, where vibrations grow.
    """

    beta: float = 0.25
    gamma: float = 0.5
    middle = two_step = False

    def __post_init__(self) -> None:
        if not (self.beta > 0 and self.gamma >= 0.5):
            raise ValueError(
                "Newmark's scheme needs beta > 0 and gamma >= 1/2 (below, vibrations grow), got "
                f"beta = {self.beta}, gamma = {self.gamma}."
            )

    @property
    def order(self) -> int:
        """2 with gamma = 1/2, else 1."""
        return 2 if self.gamma == 0.5 else 1

    def stage(self, dt: float, before: float) -> Stage:
        """What a step of dt minimizes."""
        beta, gamma = self.beta, self.gamma
        b, later = gamma / (beta * dt), dt**2 * (0.5 - beta)
        drift = (-b, 1 - b * dt, dt * (1 - gamma) - b * later, 0.0, 0.0)
        strain = (2 / dt, -2 / dt, 0.0, -1.0, 0.0)
        return Stage(1 / (beta * dt**2), (1, dt, later, 0, 0), b, drift, strain)

    def error(self, dt: float, before: float) -> float:
        """Weight of the change of acceleration in the local error."""
        return max(abs(self.beta - 1 / 6), 1 / 24) * dt**2


@dataclass(frozen=True)
class Midpoint:
    """Midpoint rule: rho (v - v_n) / dt = -Pi'(s), s = (u + u_n) / 2, v + v_n = 2 (u - u_n) / dt.

    c = 4/dt^2, u* = u_n + dt/2 v_n; order 2. Symplectic; keeps linear and angular momentum to the
    tolerance of the solves, and no vibration grows or fades. Pressures and other fields without
    inertia are those of the middle of the step. Local error dt^3/12 u'''.
    """

    order = 2
    middle, two_step = True, False

    def stage(self, dt: float, before: float) -> Stage:
        """What a step of dt minimizes."""
        h = dt / 2
        # Along the chord to s the strain's rate lags by h/2 e''[v, v].
        strain = (1 / h, -1 / h, 0.0, 0.0, h / 2)
        return Stage(1 / h**2, (1, h, 0, 0, 0), 1 / h, (-1 / h, 0, 0, 0, 0), strain)

    def error(self, dt: float, before: float) -> float:
        """Weight of the change of acceleration from middle to middle in the local error."""
        return dt**3 / (6 * (dt + before))


SCHEMES: dict[str, Scheme] = {
    "euler": Euler(),
    "bdf2": BDF2(),
    "newmark": Newmark(),
    "midpoint": Midpoint(),
}


def scheme_of(scheme: str | Scheme) -> Scheme:
    """A scheme by its name, or itself.

    Raises:
        ValueError: no scheme's name.
    """
    if isinstance(scheme, str):
        if scheme not in SCHEMES:
            raise ValueError(
                f"a scheme is one of {', '.join(SCHEMES)}, or an object of forms.schemes as "
                f"Newmark(beta=0.3, gamma=0.6), got {scheme!r}."
            )
        return SCHEMES[scheme]
    if not callable(getattr(scheme, "stage", None)):
        raise ValueError(
            f"a scheme is one of {', '.join(SCHEMES)}, or an object of forms.schemes, got "
            f"{type(scheme).__name__}."
        )
    return scheme
