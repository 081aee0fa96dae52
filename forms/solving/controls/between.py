# SPDX-License-Identifier: MIT
"""Where the account of a path needs states within its steps, and whether they help."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

from ...ledger import BETWEEN, KINK, NODES, ORDINARY, TOLERATED, Balance, exchange

AHEAD = 2  # states that follow a step whose powers are integrated through all there will be
NEAR = 4 * NODES  # states that are looked at
SHORTEST = 1 / 16  # of a step, of a piece that is not halved any more


class Gap(NamedTuple):
    """A step, or a piece of one, whose account misses too much: the states at its ends."""

    begin: Balance
    end: Balance


def gaps(balances: Sequence[Balance], floor: float, ahead: int, count: int = 1) -> list[Gap]:
    """Steps and pieces of them that miss more than a thousandth of their own work.

    Args:
        balances: States of a path.
        floor: Energy [J] below which nothing is told.
        ahead: States that are to follow a step.
        count: Steps that are looked at, the last ones.
    """
    known = balances[-NEAR:]
    ends = [n for n, each in enumerate(known) if each.kind not in (KINK, BETWEEN)]
    steps = list(pairwise(ends))
    found = []
    for first, last in steps[: len(steps) - ahead][-count:]:
        if known[last].kind != ORDINARY:
            continue
        whole = known[last].place - known[first].place
        for n in range(first + 1, last + 1):
            if known[n].kind == KINK or not known[n].place - known[n - 1].place > SHORTEST * whole:
                continue
            loads, supports, stored = exchange(known, n)
            missing, works = abs(loads + supports - stored), abs(loads) + abs(supports)
            if missing > max(TOLERATED * works, floor):
                found.append(Gap(known[n - 1], known[n]))
    return found


def joined(balances: list[Balance], gap: Gap, state: Balance) -> list[Balance]:
    """Balances with a state within a gap, if less is missing then; else as they were."""
    at = next(n for n in range(len(balances) - 1, 0, -1) if balances[n] is gap.end)
    found = [*balances[:at], state._replace(kind=BETWEEN), *balances[at:]]
    before = _missing(balances, at)
    after = _missing(found, at) + _missing(found, at + 1)
    return found if abs(after) < abs(before) else balances


def _missing(balances: Sequence[Balance], n: int) -> float:
    loads, supports, stored = exchange(balances, n)
    return loads + supports - stored
