# SPDX-License-Identifier: MIT
"""Every number that solves are tuned by, and the ladder of ways, in one object."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from .ladder import LADDER, Way
from .linear import presets


@dataclass(frozen=True)
class Settings:
    """Tuning of Newton's method, of linear solvers and of load steps; the defaults are measured.

    ``forms.follow(…, settings=Settings(most=60, ladder=LADDER[:4]))``

    Attributes:
        near: Fraction of the force level at which a search by the energy hands over to |R|.
        most: Newton iterations of a run (PETSc's snes_max_it goes over it).
        most_damped: Those of one that lowers the energy along damped steps; a sheet of wrinkles
            that turns slack and taut takes its time.
        most_near: Those of a damped one that lowers |R|.
        creeping: Iterations of a search by |R| in a row, each of which leaves more than a fraction
            of it, after which full steps are tried.
        ruined: Fraction of the eigenvalues that are negative above which a start is no neighbor of
            any equilibrium and is projected at once. A tenth is negative where a throw of the
            nodes by a tenth of the cells has inverted some; a buckled body has a few.
        light: Damping below which a tangent's eigenvalues are its own.
        ladder: What is tried after which failure.
        damping: First strength of the damping (Levenberg-Marquardt), and its least and largest.
        eased: Factor by which it falls after a full step.
        stiffened: Largest factor by which it grows after a step that was shortened.
        direct_up_to: Unknowns up to which a factorization by MUMPS is the preset in space.
        split_from: Unknowns from which displacement-pressure problems get the field split, by the
            kind of cell.
        slower: Iterations beyond the pace of the first solve, in sum, after which a preconditioner
            is built anew: that costs as much as 25 to 50 of them; twice as many of aggregation
            alone (elements of degree 1), whose set-up costs 50 to 60.
        slow: Iterations for a digit above which a factorization is faster, as in a body that is
            nearly incompressible and has no pressure of its own.
        factorized_up_to: Unknowns up to which one is then turned to; and where surfaces in contact
            make a tangent indefinite, whose part in it is projected beyond that.
        patience: A lagged preconditioner that fails is given up after so many times its first
            iterations.
        below: The last linear solve aims at this fraction of the goal, if ``digits`` are enough.
        digits: Digits of a linear solve that are enough for the last Newton step.
        loosest: Largest relative tolerance of a linear solve.
        exact: Relative tolerance of linear solves within a path.
        within: Of a state within a step, which the account alone needs: part of what that may miss
            by which its powers may be off, and of the step's largest displacement that its next
            correction may have.
        settle: Part of the tolerance of corrections that those of a path by kept factors reach.
        aim: First contraction that the next step of a path is to have.
        refuse: Contraction above which a step of a path is refused.
        reuse: Contraction up to which a tangent's factors are kept for the next correction.
        grow: Largest ratio of a step to the one before.
        shrink: Least ratio after a step that was refused, and largest.
        most_tangents: Tangents of a step, at most.
        remembered: States that the next one is extrapolated from.
        critical: Step, over the whole way, from which on a change of stability is passed.
        jump: Part of a step's work by which the energy may miss what loads and supports can do.
        doubt: Difference of two integration rules over a step's work that calls for a smaller one.
    """

    near: float = 1e-3
    most: int = 30
    most_damped: int = 200
    most_near: int = 12
    creeping: tuple[int, float] = (3, 0.8)
    ruined: float = 0.05
    light: float = 1e-8
    ladder: tuple[Way, ...] = LADDER
    damping: tuple[float, float, float] = (1e-6, 1e-10, 1e2)
    eased: float = 5.0
    stiffened: float = 100.0
    direct_up_to: int = field(default_factory=lambda: presets.DIRECT_UP_TO)
    split_from: Mapping[str, int] = field(default_factory=lambda: presets.SPLIT_FROM)
    slower: float = 25.0
    slow: float = 30.0
    factorized_up_to: int = 50_000
    patience: float = 4.0
    below: float = 0.3
    digits: int = 4
    loosest: float = 0.1
    exact: float = 1e-4
    within: tuple[float, float] = (5e-3, 3e-3)
    settle: float = 1e-2
    aim: float = 0.15
    refuse: float = 0.5
    reuse: float = 0.1
    grow: float = 2.0
    shrink: tuple[float, float] = (0.1, 0.5)
    most_tangents: int = 8
    remembered: int = 6
    critical: float = 1e-3
    jump: float = 0.02
    doubt: float = 0.01

    def __post_init__(self) -> None:
        if not all(isinstance(way, Way) for way in self.ladder):
            raise ValueError(
                "a ladder is a tuple of forms.solving.ladder.Way objects, got "
                f"{[type(way).__name__ for way in self.ladder]}."
            )
