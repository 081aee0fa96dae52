# SPDX-License-Identifier: MIT
"""Where every joule of a path went: energies and powers of its states, and what does not add up.

Between two states of a path, dPi = int (Pi_q dq + R . du_p) + work of virtual works; Pi the total
potential, q the load factor (or several scalars, Pi_q dq a sum over them), R . du_p the work of the
reactions R on prescribed values u_p. What is left over is the integration rule's error, or energy
that a jump released.

Powers f are integrated by polynomials in s, in f, or in both together, s/ds + f/df over the states
around: where a load comes to its largest value no power is a polynomial of it, but it is one of
the powers.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from itertools import product
from pathlib import Path as FilePath
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

ROUGH = 0.1  # weight of the difference that two powers alone make
NODES = 6  # states whose powers are integrated through
TOLERATED = 1e-3  # of the energy exchanged, that may be missing without a word
ORDINARY, START, JUMP, KINK, BETWEEN = "", "start", "jump", "kink", "between"


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
            load program bends; "between" for one within a step, solved for the account alone and
            no further than that needs: what forces out of balance do along the path is in its
            powers.
        others: q and Pi_q of each further scalar.
    """

    place: float
    load: float
    energy: float
    slope: float
    power: float
    work: float = 0.0
    kind: str = ORDINARY
    others: tuple[tuple[float, float], ...] = ()

    @property
    def loads(self) -> tuple[float, ...]:
        """Every q."""
        return (self.load, *(q for q, _ in self.others))

    @property
    def slopes(self) -> tuple[float, ...]:
        """Pi_q by every q."""
        return (self.slope, *(slope for _, slope in self.others))

    @property
    def linear(self) -> float:
        """What of the potential is linear in the load factor [J]."""
        return sum(self.linears)

    @property
    def linears(self) -> tuple[float, ...]:
        """The same of every q."""
        return tuple(q * slope for q, slope in zip(self.loads, self.slopes, strict=True))


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


def rows(balances: Sequence[Balance], first: int = 0, last: int | None = None) -> Ledger:
    """Accounts of the steps between states, the powers integrated through up to six of them.

    Args:
        balances: States.
        first: Number of the one at which the accounts begin, an end of a step.
        last: Number of that at which they end; None for all.
    """
    found = Ledger()
    sums = np.zeros(3)
    for n in range(first + 1, len(balances) if last is None else last + 1):
        b = balances[n]
        if b.kind != KINK:
            sums += exchange(balances, n)
        if b.kind not in (KINK, BETWEEN):
            loads, supports, stored = (float(each) for each in sums)
            found.append(Row(b.load, stored, loads, supports, loads + supports - stored, b.kind))
            sums[:] = 0
    return found


def exchange(balances: Sequence[Balance], n: int) -> tuple[float, float, float]:
    """Work of loads and of supports, and what is stored, from state n - 1 to state n [J]."""
    a, b = balances[n - 1 : n + 1]
    explicit, supports = _work_within(balances, n)
    linear = b.linear - a.linear
    return explicit - linear + b.work, supports, b.energy - a.energy - linear


def verdict(balances: Sequence[Balance], chord: tuple[float, float], floor: float) -> Verdict:
    """Judge the last step.

    Args:
        balances: States, the last one that in question.
        chord: Work [J] of the virtual works along the chord of u, by the forces at either end.
        floor: Energy [J] below which nothing is told: what tolerances leave in forces, times the
            model's size.
    """
    a, b = balances[-2:]
    ds, change, linear = b.place - a.place, b.energy - a.energy, b.linear - a.linear
    outside, scale = np.inf, max(abs(linear), floor)
    # Near an extremum of a load factor q its change tells nothing, but that of Pi_q does.
    ways = (False,) if a.power or b.power else (False, True)
    for turned in product(ways, repeat=len(a.loads)):
        low, high, rest = min(chord), max(chord), change
        for n, by_slope in enumerate(turned):
            dq, slopes = b.loads[n] - a.loads[n], (a.slopes[n], b.slopes[n])
            ends = [each * dq for each in slopes]
            if by_slope:
                ends = [-q * (slopes[1] - slopes[0]) for q in (a.loads[n], b.loads[n])]
                rest -= b.linears[n] - a.linears[n]
            if n == 0:
                ends = [ends[0] + a.power * ds, ends[1] + b.power * ds]
            low, high = low + min(ends), high + max(ends)
        if not any(turned):
            scale = max(scale, abs(low), abs(high))
        outside = min(outside, _outside(rest, low, high))
    line = sum(_work((a, b), 1))
    if len(balances) > 2:
        doubt = sum(_work(balances[-3:], 2)) - line
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
    smooth = ORDINARY, BETWEEN
    first = last = n
    while first > 0 and balances[first].kind in smooth:
        first -= 1
    while last + 1 < len(balances) and balances[last + 1].kind in smooth:
        last += 1
    begin = min(max(first, n - NODES // 2), max(first, last - NODES + 1))
    return balances[begin : min(begin + NODES, last + 1)]


def _work_within(balances: Sequence[Balance], n: int) -> tuple[float, float]:
    """Integrals of Pi_q dq and of R . du_p over a step, in the coordinate that tells them better.

    Better is the one in which the state farthest from the step makes less of a difference.
    """
    nodes = _window(balances, n)
    places = [node.place for node in nodes]
    at = places.index(balances[n].place)
    found, least = (0.0, 0.0), np.inf
    for x in _coordinates(nodes):
        works, doubt = _integrals(nodes, x, at), 0.0
        if len(nodes) > 2:
            far = 0 if 2 * at - 1 > len(nodes) - 1 else len(nodes) - 1
            fewer = [node for k, node in enumerate(nodes) if k != far]
            doubt = abs(sum(_integrals(fewer, np.delete(x, far), at - (far == 0))) - sum(works))
        if doubt < least:
            found, least = works, doubt
    return found


def _coordinates(nodes: Sequence[Balance]) -> list[NDArray[np.float64]]:
    """Places of states; and powers, alone and with places, where these grow or fall throughout."""
    s = np.array([node.place for node in nodes])
    way = np.array(nodes[-1].loads) - np.array(nodes[0].loads)
    way = way / (np.abs(way).max() or 1.0)
    f = np.array([float(way @ node.slopes) + node.power for node in nodes])
    steps = np.diff(f)
    if len(nodes) < 3 or not (np.all(steps > 0) or np.all(steps < 0)):
        return [s]
    s, f = (s - s[0]) / (s[-1] - s[0]), (f - f[0]) / (f[-1] - f[0])
    return [s, s + f, f]


def _work(nodes: Sequence[Balance], at: int) -> tuple[float, float]:
    """Integrals of Pi_q dq and of R . du_p to a state from the one before it, by polynomials."""
    return _integrals(nodes, np.array([each.place for each in nodes]), at)


def _integrals(nodes: Sequence[Balance], x: NDArray[np.float64], at: int) -> tuple[float, float]:
    """The same by polynomials in a coordinate x of the states."""
    s, q, slope, power = (
        np.array([getattr(each, name) for each in nodes])
        for name in ("place", "loads", "slopes", "power")
    )
    by_change = weights(x, x[at - 1], x[at])
    explicit = sum(float(f @ by_change @ g) for f, g in zip(slope.T, q.T, strict=True))
    return explicit, float(power @ by_change @ s)


def weights(x: NDArray[np.float64], a: float, b: float) -> NDArray[np.float64]:
    """Weights W of int_a^b f dg = f W g, for polynomials f, g through their values at places x.

    Args:
        x: Places of the values.
        a: Where the integral begins.
        b: Where it ends.
    """
    points, gauss = _gauss(len(x))
    values, slopes = lagrange(x, (a + b) / 2 + (b - a) / 2 * points)
    return (values.T * ((b - a) / 2 * gauss)) @ slopes


_gauss = cache(np.polynomial.legendre.leggauss)


def lagrange(
    x: NDArray[np.float64], at: float | NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Values and slopes at points of the polynomials that are 1 at one of x, 0 at the others.

    Args:
        x: Where the polynomials are 1, shape (n,).
        at: Point, or points of any shape.

    Returns:
        Values and slopes, each of the shape of the points and (n,).
    """
    count, own = len(x), np.eye(len(x), dtype=bool)
    lengths = np.where(own, 1.0, x[:, None] - x)
    factors = np.where(own, 1.0, (np.asarray(at)[..., None, None] - x) / lengths)
    values = factors.prod(axis=-1)
    # Each slope is a sum over the factors, of which one is left out in turn.
    without = np.where(own, 1.0, np.repeat(factors[..., None, :], count, axis=-2)).prod(axis=-1)
    return values, np.where(own, 0.0, without / lengths).sum(axis=-1)
