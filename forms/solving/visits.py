# SPDX-License-Identifier: MIT
"""States of a problem at several loads, found anew, from those before, as parameters change."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..measured import measured
from ..paths import Held, NotConverged
from .data import Data
from .following import follow, solve
from .linearized import Linearized
from .numbers import Numbers
from .rates import Rate, Rates
from .sensitivity import Sensitivity
from .targets import control

Array = NDArray[np.float64]
EXACT: dict[str, Any] = {"rtol": 1e-11, "ctol": 1e-9}


class Visits:
    """States of one problem at all loads of its data, found anew as parameters change.

    Args:
        data: Of one problem and one load factor.
        numbers: Parameters.
        forward: Whether rates by each number are wanted, or adjoints.

    Attributes:
        loads: Load factors, in the order of the path; one None where there is no path.
        measured: What is measured, of each of the data.
        rates, adjoint: The compiled derivatives; one of them is None.
        empty: Whether nothing depends on a parameter, of each.
    """

    def __init__(self, data: list[Data], numbers: Numbers, forward: bool) -> None:
        first = data[0]
        self.problem, self.held, self.data = first.problem, first.functionals, data
        self.t = first.factors
        sequences = [list(d.loads) for d in data if d.loads is not None]
        same = all(s == sequences[0] for s in sequences)
        self.loads: list[Any] = [None]
        if sequences:
            self.loads = [*(sequences[0] if same else sorted({x for s in sequences for x in s}))]
        border = Held(self.t, self.held) if self.held else None
        self.measured = [measured(d.what, self.problem, border, "fit") for d in data]
        self.rates = self.adjoint = None
        if forward:
            self.rates = Rates(self.problem, self.measured, numbers.parameters, border)
            self.empty = self.rates.empty
        else:
            self.adjoint = Sensitivity(self.problem, self.measured, numbers.parameters, border)
            self.empty = [slopes.empty for slopes in self.adjoint.slopes]
        self._start = self.problem.u.x.array.copy(), self._factors()
        self._states: list[tuple[Array, Array, list[Rate]] | None] = [None] * len(self.loads)
        self._at: Array | None = None

    def _factors(self) -> Array:
        return np.array([float(t.value) for t in self.t])

    def forget(self) -> None:
        """Begin anew at the start of the path."""
        self._states = [None] * len(self.loads)

    def visit(self, m: Array, look: Callable[[int, Linearized], list[Rate]]) -> None:
        """Look at the states of all loads, with the parameters at m. Collective."""
        self._put(*self._start)
        last = self._start
        found = []
        for n in range(len(self.loads)):
            self._reach(n, last, m)
            with Linearized(self.problem) as linear:
                rates = look(n, linear)
            last = self.problem.u.x.array.copy(), self._factors()
            found.append((*last, rates))
        self._states, self._at = list(found), m.copy()

    def _put(self, u: Array, factors: Array) -> None:
        self.problem.u.x.array[:] = u
        for t, factor in zip(self.t, factors, strict=True):
            t.value = factor

    def _reach(self, n: int, last: tuple[Array, Array], m: Array) -> None:
        """Find the state of a load: near its last one, or along the path from the load before."""
        state, load = self._states[n], self.loads[n]
        if state is not None and self._at is not None:
            u, factors, rates = state
            change = m - self._at
            for rate, d in zip(rates, change, strict=False):
                u = u + d * rate.du
                if self.held:
                    factors = factors + d * rate.dq
            self._put(u, factors if self.held or load is None else np.array([load]))
            try:
                self._solve(load)
                return
            except NotConverged:
                pass
        self._put(*last)
        self._follow(load)

    def _solve(self, load: Any) -> None:
        if not self.held:
            solve(self.problem, **EXACT)
        else:
            self._control(load)

    def _control(self, load: Any) -> None:
        target = [np.atleast_1d(load)]
        control(self.problem, None, (), self.t, self.held, target, progress=False, **EXACT)

    def _follow(self, load: Any) -> None:
        if self.held:
            self._control(load)
        elif load is None or not self.t or load == self._factors()[0]:
            solve(self.problem, **EXACT)
        else:
            way = abs(load - self._factors()[0])
            follow(self.problem, t=self.t[0], to=load, step=way, progress=False, **EXACT)
