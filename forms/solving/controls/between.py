# SPDX-License-Identifier: MIT
"""Where the account of a path needs states within its steps, and whether they help."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ...ledger import BETWEEN, KINK, NODES, ORDINARY, TOLERATED, Balance, exchange
from ..accounts import Accounts
from ..extrapolation import State, slope

AHEAD = 2  # states that follow a step whose powers are integrated through all there will be
NEAR = 4 * NODES  # states that are looked at
DOUBT = 5e-3  # of du/ds through the states around, at least: measured over one step of a twist
SHORTEST = 1 / 16  # of a step, of a piece that is not halved any more


class Gap(NamedTuple):
    """A step, or a piece of one, whose account misses too much.

    Attributes:
        begin: State at its begin.
        end: State at its end.
        may: What it may miss [J].
    """

    begin: Balance
    end: Balance
    may: float

    @property
    def middle(self) -> float:
        """Place of a state within."""
        return (self.begin.place + self.end.place) / 2

    @property
    def way(self) -> float:
        """Whether the load factor grows or falls, 1 or -1."""
        return float(np.sign(self.end.load - self.begin.load))


class Reader:
    """Reads what an account needs, at iterates for a state within a gap; tells when one will do.

    Powers P at an iterate are those with what its forces out of balance, f, do along the curve
    through the states around (:meth:`forms.solving.accounts.Accounts.read_near`). A part of that,
    f . du/ds, is wrong as du/ds is: what of its last change did not show up in P,
    |P - P_before| / |f . du/ds - (f . du/ds)_before|. It is taken for all of it at the first
    iterate, and where loads and moved supports share it in a way that is not known.

    Args:
        accounts: Accounts of the path.
        gap: The gap.
        around: States on either side, at places of their own.
        moved: Largest displacement [m] from the gap's begin to its end.
        near: Part of what may be missing that powers may be off by, and part of ``moved`` that the
            next correction may make.

    Attributes:
        reading: The last one.
    """

    def __init__(
        self,
        accounts: Accounts,
        gap: Gap,
        around: Sequence[State],
        moved: float,
        near: tuple[float, float],
    ) -> None:
        self.reading: Balance | None = None
        self._accounts, self._gap, self._around = accounts, gap, around
        self._off = near[0] * gap.may / (gap.end.place - gap.begin.place)
        self._most = near[1] * moved
        self._before: tuple[float, float] | None = None

    def __call__(self, correction: float) -> bool:
        """Read at the present state; whether it will do. Collective.

        Args:
            correction: Displacement [m] that is expected of the next correction.
        """
        u, way = self._accounts.problem.u.x.array, self._gap.way
        here = State(u, self._around[0].loads, self._gap.middle)
        velocity = slope([here, *self._around]).values
        self.reading, rest = self._accounts.read_near(here.place, way, velocity)
        power, doubt = self.reading.power + self.reading.slope * way, 1.0
        if self._before is not None and not (self.reading.power and self.reading.slope):
            changed, by = power - self._before[0], rest - self._before[1]
            doubt = max(abs(changed / by), DOUBT) if by else 1.0
        self._before = power, rest
        return doubt * abs(rest) <= self._off and correction <= self._most


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
            may = max(TOLERATED * works, floor)
            if missing > may:
                found.append(Gap(known[n - 1], known[n], may))
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
