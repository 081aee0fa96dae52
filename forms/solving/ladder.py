# SPDX-License-Identifier: MIT
"""How Newton's method is tried, as data: which way is taken after which failure of the last one."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, IntEnum


class Failure(IntEnum):
    """Why a run of SNES ended, by PETSc's codes."""

    LINEAR = -3  # the linear solver failed
    NOT_FINITE = -4  # full steps led out of where the energy is finite
    USED_UP = -5  # the iterations
    NO_DESCENT = -6  # the line search found no lower value
    CREEPING = -8  # a search by |R| lowers it by little, time and again
    NO_CONTRACTION = -9  # corrections that do not shrink fast enough, within a path
    NEAR = 3  # so near the solution that the energy drowns in rounding: no failure


class Merit(Enum):
    """What the line search lowers."""

    ENERGY = "energy"
    RESIDUAL = "|R|"
    NONE = "full steps"


@dataclass(frozen=True)
class Way:
    """What is tried after a failure; what is left out stays as it was.

    Attributes:
        words: What it is, for pages.
        on: Failures of the run before, after which it is tried.
        after: Only after a run that lowered this.
        merit: What the line search lowers.
        tangent: "full"; "projected", positive semi-definite and damped; "damped"
            (Levenberg-Marquardt); "stiffer", with more damping than before.
        linear: "direct", MUMPS in place of multigrid; "faster", the same where multigrid takes
            longer than a factorization; "renewed", the preconditioner of the present tangent in
            place of a lagged one.
        until: Fraction of the force level below which a search by the energy hands over to |R|.
        back: Whether it begins where the way before began to creep.
    """

    words: str
    on: frozenset[Failure]
    after: Merit | None = None
    merit: Merit | None = None
    tangent: str | None = None
    linear: str | None = None
    until: float | None = None
    back: bool = False


def _way(words: str, *on: Failure, **what: object) -> Way:
    return Way(words, frozenset(on), **what)  # type: ignore[arg-type]


# The first one that fits is taken, and the run goes on from the state that was reached.
LADDER = (
    _way("MUMPS, where multigrid is slower than a factorization", Failure.LINEAR, linear="faster"),
    _way("multigrid of the present tangent, not an old one's", Failure.LINEAR, linear="renewed"),
    _way("more damping", Failure.LINEAR, tangent="stiffer"),
    _way(
        "the energy along the projected and damped tangent",
        Failure.LINEAR,
        Failure.USED_UP,
        Failure.NO_DESCENT,
        after=Merit.ENERGY,
        tangent="projected",
    ),
    _way("MUMPS in place of multigrid", Failure.LINEAR, linear="direct"),
    # Differences of the energy are quadratic in |R| and drown in its rounding long before |R|
    # reaches a tight tolerance.
    _way(
        "|R| along the full tangent, from near the solution on or where no descent is left",
        Failure.NO_DESCENT,
        Failure.NEAR,
        after=Merit.ENERGY,
        merit=Merit.RESIDUAL,
        tangent="full",
    ),
    # |R| has local minima where sheets turn slack or taut: go on downhill, nearer.
    _way(
        "the energy again along the damped tangent, until nearer",
        Failure.USED_UP,
        Failure.NO_DESCENT,
        merit=Merit.ENERGY,
        tangent="damped",
        until=1e-5,
    ),
    # |R| is no measure of the distance where bending is much softer than stretching: full steps go
    # where a descent of |R| creeps, from the start or from nearby.
    _way(
        "full steps: from the start without an energy, else from near the solution",
        Failure.CREEPING,
        Failure.USED_UP,
        Failure.NO_DESCENT,
        merit=Merit.NONE,
        tangent="full",
    ),
    _way(
        "|R| to the end, from where it crept",
        Failure.USED_UP,
        Failure.NO_DESCENT,
        Failure.NOT_FINITE,
        after=Merit.NONE,
        merit=Merit.RESIDUAL,
        back=True,
    ),
)
