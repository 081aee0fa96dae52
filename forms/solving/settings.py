# SPDX-License-Identifier: MIT
"""Every number that solves are tuned by, and the ladder of ways, in one object."""

from __future__ import annotations

from dataclasses import dataclass

from .ladder import LADDER, Way


@dataclass(frozen=True)
class Settings:
    """Tuning of Newton's method and of load steps; the defaults are measured.

    Attributes:
        near: Fraction of the force level at which a search by the energy hands over to |R|.
        most: Newton iterations of a run (PETSc's snes_max_it goes over it).
        most_damped: Those of one that lowers the energy along damped steps; a sheet of wrinkles
            that turns slack and taut takes its time.
        most_near: Those of a damped one that lowers |R|.
        ruined: Fraction of the eigenvalues that are negative above which a start is no neighbor of
            any equilibrium and is projected at once. A tenth is negative where a throw of the
            nodes by a tenth of the cells has inverted some; a buckled body has a few.
        light: Damping below which a tangent's eigenvalues are its own.
        ladder: What is tried after which failure.
        easy: Newton iterations up to which the next load step grows.
        remembered: States that the next one is extrapolated from.
        bent: Distance of the parabola from the line, over the step, from which on a path is no
            smooth curve.
    """

    near: float = 1e-3
    most: int = 30
    most_damped: int = 200
    most_near: int = 12
    ruined: float = 0.05
    light: float = 1e-8
    ladder: tuple[Way, ...] = LADDER
    easy: int = 5
    remembered: int = 3
    bent: float = 0.25
