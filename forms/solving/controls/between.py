# SPDX-License-Identifier: MIT
"""Which steps of a path need a state within for their account, and whether it helps there."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from ...ledger import BETWEEN, KINK, NODES, ORDINARY, TOLERATED, Balance, rows

AHEAD = 2  # states that follow a step whose powers are integrated through all there will be
NEAR = 2 * NODES  # states that are looked at


class Gap(NamedTuple):
    """A step whose account misses too much: the states at its ends."""

    begin: Balance
    end: Balance


def gaps(balances: Sequence[Balance], floor: float, ahead: int, count: int = 1) -> list[Gap]:
    """Steps that miss more than a thousandth of their own work, and have no state within yet.

    Args:
        balances: States of a path.
        floor: Energy [J] below which nothing is told.
        ahead: States that are to follow a step.
        count: Steps that are looked at, the last ones.
    """
    known = balances[-NEAR:]
    ends = [n for n, each in enumerate(known) if each.kind not in (KINK, BETWEEN)]
    found = []
    for n in ends[1 : len(ends) - ahead][-count:]:
        if known[n].kind != ORDINARY or known[n - 1].kind == BETWEEN:
            continue
        (row,) = rows(known, n - 1, n)
        works = abs(row.loads) + abs(row.supports)
        if abs(row.unaccounted) > max(TOLERATED * works, floor):
            found.append(Gap(known[n - 1], known[n]))
    return found


def joined(balances: list[Balance], gap: Gap, state: Balance) -> list[Balance]:
    """Balances with a state within a step, if less is missing then; else as they were."""
    at = next(n for n in range(len(balances) - 1, 0, -1) if balances[n] is gap.end)
    found = [*balances[:at], state._replace(kind=BETWEEN), *balances[at:]]
    (before,), (after,) = rows(balances, at - 1, at), rows(found, at - 1, at + 1)
    return found if abs(after.unaccounted) < abs(before.unaccounted) else balances
