# SPDX-License-Identifier: MIT
"""What is proved of each state of a path, beside its equilibrium and its stability."""

from __future__ import annotations

from ..barriers import Clearance
from ..problems import Problem
from ..validity import Bounds, can_bound, volume_bounds


def certified_volume(problem: Problem) -> Bounds | None:
    """Bounds of the smallest volume ratio at u; None for elements without. Collective."""
    return volume_bounds(problem) if can_bound(problem.u) else None


def crossing(problem: Problem) -> str:
    """Whether surfaces of a term cross at u, found anew, in words; empty if not. Collective."""
    checked = [term.certified() for term in problem.terms if hasattr(term, "certified")]
    return "" if all(checked) else "surfaces cross"


def certified_clearance(problem: Problem) -> Clearance | None:
    """Smallest distance from obstacles at u, found anew; None without any. Collective."""
    return problem.forms.barriers.clearance() if problem.forms.barriers else None
