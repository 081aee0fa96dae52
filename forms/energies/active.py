# SPDX-License-Identifier: MIT
"""Active stress: the tension that muscle adds along its fibers."""

from __future__ import annotations

from .._checks import direction
from .._types import Expr
from ..kinematics import fiber_invariants
from .invariants import _checked


def active_tension(F: Expr, Ta: Expr, fiber: Expr) -> Expr:
    """Energy of a tension along the fibers, to be added to that of the passive muscle.

    psi = Ta/2 (A . C A - 1)

    Its second Piola-Kirchhoff stress is S = Ta A A, whatever the stretch of the fibers.

    Args:
        F: Deformation gradient, shape (3, 3); not its isochoric part, which would take the mean
            stress away from S.
        Ta: Tension per reference area [Pa], as ``60e3 * t``; negative where fibers push.
        fiber: Unit direction A in the reference body, shape (3,).

    Returns:
        Energy per reference volume [J/m^3], finite for every F, zero at F = I, where its stress is
        Ta A A: active muscle is not at rest.

    Raises:
        ValueError: F is not 3x3, fiber is no vector in space or, where it consists of numbers, of
            another length than 1, or Ta a number that is not finite.

    Source: Land et al., Proc. R. Soc. A 471 (2015) 20150641, section 2, problem 3.
    """
    _checked(F, "active_tension", Ta=Ta)
    IV, _ = fiber_invariants(F, direction(fiber, "a fiber"))
    return Ta / 2 * (IV - 1)
