# SPDX-License-Identifier: MIT
"""Where every joule of a path went: energies and powers of its states, and what does not add up.

Between two states of a path, dPi = int (Pi_q dq + R . du_p) + work of virtual works; Pi the total
potential, q the load factor, R . du_p the work of the reactions R on prescribed values u_p. What is
left over is the integration rule's error, or energy that a jump released.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path as FilePath
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

ROUGH = 0.1  # weight of the difference that two powers alone make
NODES = 6  # states whose powers are integrated through
TOLERATED = 1e-3  # of the energy exchanged, that may be missing without a word
ORDINARY, START, JUMP, KINK = "", "start", "jump", "kink"


class Balance(NamedTuple):
    """Energy and powers of a state, by the place s along its path.

    Attributes:
        place: s; its unit is that of who leads the path.
        load: Load factor q.
        energy: Total potential Pi [J].
        slope: Pi_q at fixed u [J].
        power: Power of the supports, R . du_p/ds.
        work: Work of the virtual works over the step to this state [J].
        kind: "" for a step of a path; "start" for one out of a singular state and "jump" for one
            on purpose; "kink" for the same state once more, with the powers behind it, where the
            load program bends.
    """

    place: float
    load: float
    energy: float
    slope: float
    power: float
    work: float = 0.0
    kind: str = ORDINARY

    @property
    def linear(self) -> float:
        """What of the potential is linear in the load factor [J]."""
        return self.load * self.slope


class Row(NamedTuple):
    """One step's account [J].

    Attributes:
        load: Load factor at its end.
        stored: Change of Pi - q Pi_q: of the energy without what is linear in the load factor.
        loads: Work of the loads, -int q dPi_q and that of virtual works.
        supports: Work of the supports.
        unaccounted: Work less what is stored: what a jump released, or the integration's error.
        kind: As of :class:`Balance`.
        kinetic: Kinetic energy gained, of motions, whose ``stored`` is the change of Pi in all.
        dissipated: By viscosity and friction.
        scheme: Dissipated by the scheme in time itself.
    """

    load: float
    stored: float
    loads: float
    supports: float
    unaccounted: float
    kind: str
    kinetic: float = 0.0
    dissipated: float = 0.0
    scheme: float = 0.0


class Verdict(NamedTuple):
    """What the last step's energies and powers say, relative to the step's work.

    Attributes:
        outside: How far the change of energy lies outside of the step times [least, largest power
            at its ends]; a jump, whatever the step, where powers are monotonic in between.
        doubt: Difference of the integral of the parabola through three powers from the trapezoid's.
            Of two powers alone a tenth of that of the change of energy from the latter.
    """

    outside: float
    doubt: float


class Ledger(list[Row]):
    """The accounts of a path, one a step; printed it is a table."""

    @property
    def moves(self) -> bool:
        """Whether it is that of a motion."""
        return any(row.kinetic or row.dissipated or row.scheme for row in self)

    @property
    def exchanged(self) -> float:
        """Work of loads and supports, and kinetic energy, each step's by its magnitude [J]."""
        return sum(abs(row.loads) + abs(row.supports) + abs(row.kinetic) for row in self)

    @property
    def missed(self) -> float:
        """What the steps of a smooth path leave unaccounted, by magnitude [J]."""
        return sum(abs(row.unaccounted) for row in self if row.kind == ORDINARY)

    def sentence(self, floor: float = 0.0) -> str:
        """Where joules are missing, if more than a thousandth are, and than a floor; else empty."""
        if not self.missed > max(TOLERATED * self.exchanged, floor):
            return ""
        worst = max((row for row in self if row.kind == ORDINARY), key=lambda r: abs(r.unaccounted))
        where = f"t = {worst.load:.6g}" if self.moves else f"load factor {worst.load:.6g}"
        return (
            f" Unaccounted: {self.missed:.3g} J of {self.exchanged:.3g} J, most of it before "
            f"{where}: shorter steps tell more."
        )

    def __str__(self) -> str:
        """The accounts as a table; of motions with their own columns."""
        names = {"load": "load factor", "stored": "stored"}
        if self.moves:
            names = {"load": "time", "stored": "stored", "kinetic": "kinetic"}
            names |= {"dissipated": "dissipated", "scheme": "by scheme"}
        names |= {"loads": "by loads", "supports": "by supports", "unaccounted": "unaccounted"}
        lines = ["".join(f"{word:>14}" for word in names.values())]
        for row in self:
            numbers = "".join(f"{getattr(row, name):14.6g}" for name in names)
            lines.append(f"{numbers}  {row.kind}".rstrip())
        return "\n".join(lines)

    def plot(self, filename: str | FilePath) -> None:
        """Draw what was stored, and the works, over the load factor; local.

        Args:
            filename: Image that is written, as "ledger.png".
        """
        from matplotlib.figure import Figure

        figure = Figure(figsize=(6.4, 4.0), layout="constrained")
        label = "time [s]" if self.moves else "load factor"
        axes = figure.add_subplot(xlabel=label, ylabel="energy since the start [J]")
        loads = [row.load for row in self]
        columns = {"stored": "k", "kinetic": "C2", "dissipated": "C4", "scheme": "C5"}
        columns |= {"loads": "C0", "supports": "C1", "unaccounted": "C3"}
        for name, color in columns.items():
            total = np.cumsum([getattr(row, name) for row in self])
            if np.any(total):
                # Dashes over the work that they are to equal, which else would hide them.
                style, level = ("--", 4) if name == "stored" else ("-", 3)
                axes.plot(loads, total, color, ls=style, marker=".", label=name, zorder=level)
        for row in self:
            if row.kind != ORDINARY:
                axes.axvline(row.load, color="0.7", zorder=0)
        axes.legend(frameon=False)
        figure.savefig(filename, dpi=150)


def rows(balances: Sequence[Balance]) -> Ledger:
    """Accounts of the steps between states, the powers integrated through up to six of them."""
    found = Ledger()
    for n in range(1, len(balances)):
        a, b = balances[n - 1 : n + 1]
        if b.kind == KINK:
            continue
        explicit, supports = _work(_window(balances, n), a, b)
        linear = b.linear - a.linear
        stored, loads = b.energy - a.energy - linear, explicit - linear + b.work
        found.append(Row(b.load, stored, loads, supports, loads + supports - stored, b.kind))
    return found


def verdict(balances: Sequence[Balance], chord: tuple[float, float], floor: float) -> Verdict:
    """Judge the last step.

    Args:
        balances: States, the last one that in question.
        chord: Work [J] of the virtual works along the chord of u, by the forces at either end.
        floor: Energy [J] below which nothing is told: what tolerances leave in forces, times the
            model's size.
    """
    a, b = balances[-2:]
    ds, dq = b.place - a.place, b.load - a.load
    ends = [each.slope * dq + each.power * ds for each in (a, b)]
    low, high = min(ends) + min(chord), max(ends) + max(chord)
    change, linear = b.energy - a.energy, b.linear - a.linear
    scale = max(abs(low), abs(high), abs(linear), floor)
    outside = _outside(change, low, high)
    if not (a.power or b.power):
        # Near an extremum of the load factor q its change tells nothing, but that of Pi_q does.
        ends = [-each.load * (b.slope - a.slope) for each in (a, b)]
        low, high = min(ends) + min(chord), max(ends) + max(chord)
        outside = min(outside, _outside(change - linear, low, high))
    line = sum(_work((a, b), a, b))
    if len(balances) > 2:
        doubt = sum(_work(balances[-3:], a, b)) - line
    else:
        doubt = ROUGH * (change - line - sum(chord) / 2)
    return Verdict(outside / scale, abs(doubt) / scale)


def _outside(value: float, low: float, high: float) -> float:
    return max(low - value, value - high, 0.0)


def _window(balances: Sequence[Balance], n: int) -> Sequence[Balance]:
    """States around a step, as many on either side as there are, none over a start or a jump."""
    a, b = balances[n - 1 : n + 1]
    if b.kind == JUMP:  # from the state before at its load; what follows is the new branch's work
        return [a._replace(slope=b.slope, power=b.power), b]
    if b.kind == START:
        return [a, b]
    first = last = n
    while first > 0 and balances[first].kind == ORDINARY:
        first -= 1
    while last + 1 < len(balances) and balances[last + 1].kind == ORDINARY:
        last += 1
    begin = min(max(first, n - NODES // 2), max(first, last - NODES + 1))
    return balances[begin : min(begin + NODES, last + 1)]


def _work(nodes: Sequence[Balance], a: Balance, b: Balance) -> tuple[float, float]:
    """Integrals of Pi_q dq and of R . du_p from a to b, by polynomials through nodes."""
    x = np.array([each.place for each in nodes])
    q, slope, power = (
        np.array([getattr(each, name) for each in nodes]) for name in ("load", "slope", "power")
    )
    by_change, by_place = weights(x, a.place, b.place)
    return float(slope @ by_change @ q), float(by_place @ power)


def weights(
    x: NDArray[np.float64], a: float, b: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Weights W, w of int_a^b f dg = f W g and int_a^b f ds = w f, for polynomials through places.

    Args:
        x: Places s of the values f and g.
        a: Where the integral begins.
        b: Where it ends.
    """
    middle, half = (a + b) / 2, (b - a) / 2
    points, gauss = np.polynomial.legendre.leggauss(len(x))
    by_change, by_place = np.zeros((len(x), len(x))), np.zeros(len(x))
    for point, weight in zip(middle + half * points, gauss * half, strict=True):
        values, slopes = lagrange(x, point)
        by_change += weight * np.outer(values, slopes)
        by_place += weight * values
    return by_change, by_place


def lagrange(x: NDArray[np.float64], at: float) -> tuple[NDArray, NDArray]:
    """Values and slopes at a point of the polynomials that are 1 at one of x, 0 at the others."""
    values, slopes = np.empty(len(x)), np.zeros(len(x))
    for j, own in enumerate(x):
        others = np.delete(x, j)
        factors, lengths = at - others, own - others
        values[j] = np.prod(factors / lengths)
        for k in range(len(others)):
            slopes[j] += np.prod(np.delete(factors / lengths, k)) / lengths[k]
    return values, slopes
