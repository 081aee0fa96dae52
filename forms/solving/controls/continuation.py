# SPDX-License-Identifier: MIT
"""What all controls share: extrapolate, correct, certify, take the step or try a shorter one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from dolfinx import fem

from ...files.checkpoint import Saved
from ...ledger import BETWEEN, ORDINARY, Balance, verdict
from ...paths import Convergence, Event, Path
from ...validity import Bounds
from ..accounts import Accounts
from ..certificates import certified_clearance, certified_volume, crossing
from ..corrector import Corrector
from ..extrapolation import State, extrapolate
from ..ladder import Failure
from ..newton import Newton
from ..pace import Pace
from ..reuse import release
from ..supported import free_motions
from .branch import Branch

SHORT = 4.0  # least steps that are not too long to tell


class Continuation(Branch):
    """A path of equilibria by the place s along it.

    Each state is extrapolated from up to ``settings.remembered`` ones and corrected by plain
    Newton, whose contraction sets the steps (:mod:`forms.solving.corrector`). It is then refused,
    and the step halved, where the energy did what loads and supports cannot have done, or where the
    number of negative eigenvalues changes over a step that is not short.

    Args:
        path: Path of the problem.
        newton: Its solver.
        corrector: That of the path.
        q: Load factor, or the scalar unknowns in its place.
        pace: Lengths of the steps.
        way: Length of the whole way, or a measure of it.
        span: How far q goes, or its size.

    Attributes:
        refuse_inverted: Whether steps to inverted states are refused.
    """

    word, symbol = "load", "t"
    total: float | None = 1.0
    refuse_inverted = False

    def __init__(
        self,
        path: Path,
        newton: Newton,
        corrector: Corrector,
        q: Sequence[fem.Constant],
        pace: Pace,
        way: float,
        span: float,
    ) -> None:
        super().__init__(path, newton, corrector, q, way)
        self.pace, self._why, self.why = pace, "", ""
        problem = path.problem
        self._accounts = Accounts(problem, q, span) if problem.has_energy else None
        self._reading: Balance | None = None
        self.bounds: Bounds | None = None
        self._inverted = self._touching = False
        self._unheld: bool | None = None
        self._counted = self._spent = corrector.tangents

    @property
    def direction(self) -> float:
        """dq/ds of a load factor on which supports depend."""
        return 1.0

    def next_place(self) -> float:
        """Place of the next state; to be written."""
        raise NotImplementedError

    def begin(self) -> None:
        """Read energy and powers of the start, if that is an equilibrium. Collective."""
        problem, scaled = self.path.problem, self.newton.tangent.scaled
        for support in problem.supports:
            support.update()
        if scaled.rounding == 0:
            scaled.measure()
        b = problem.create_vector()
        reactions = scaled.residual(b)
        resting = b.norm() <= max(1e-6 * reactions, scaled.floor(), scaled.unknowable())
        b.destroy()
        if self._accounts is not None and resting:
            self.path.balances = [self._accounts.read(self.place, self.direction, self.direction)]
            self._accounts.keep(self.path.balances[-1].place)

    def propose(self) -> Convergence:
        """Correct the extrapolated state at the next place. Collective."""
        self._goal, self._why = self.next_place(), ""
        self.look_anew()
        if self._gates and (self._gates[0] - self._goal) * (self._goal - self.place) < 0:
            self._goal = self._gates[0]
            self.pace.step = abs(self._goal - self.place)
        self.aim(self._goal)
        self._order, found = extrapolate(self.path.problem, self._past, self._goal)
        self.guess(found)
        return self._corrected()

    def _corrected(self) -> Convergence:
        """Correct the guess; by the energy where that fails and an obstacle acts. Collective.

        Where contact begins the path bends, within so little that no contraction can be had; energy
        and stability of what is found tell whether it is the path's.
        """
        problem, newton = self.path.problem, self.newton
        guess = self.here(self._goal)
        outcome = self.corrector.solve(self.level)
        if outcome.converged or not (self.corrector.met or self._touching):
            return outcome
        self.move(guess)
        if self.corrector.border is not None or not problem.minimization:
            return self.corrector.solve(self.level, free=True)
        newton.predict()
        outcome = newton.solve()
        newton.tangent.projecting = False
        newton.tangent.forget_damping()
        if not outcome.converged:
            return outcome
        return replace(outcome, negative=self.corrector.refactor(), tried=())

    def guess(self, state: State) -> None:
        """Take the extrapolated scalars, where these are unknowns."""

    def accept(self, outcome: Convergence) -> tuple[Convergence, dict[str, Any]] | None:
        """Certify a state that was found, and take it. Collective."""
        self._why = self.refusal(outcome)
        if self._why:
            self.path.refused += 1
            return None
        self.take(self.here(self._goal), outcome)
        return replace(outcome, negative=self.count, tangents=self.spent()), {}

    def spent(self) -> int:
        """Tangents since the last accepted state, those of refused steps and events included."""
        self.count_tangents()
        spent, self._spent = self._counted - self._spent, self._counted
        return spent

    def count_tangents(self) -> None:
        """Bring the path's count of tangents up to date."""
        self.path.tangents += self.corrector.tangents - self._counted
        self._counted = self.corrector.tangents

    def refusal(self, outcome: Convergence) -> str:
        """Why a state that was found is not the path's; empty where it is. Collective."""
        self.bounds = certified_volume(self.path.problem)
        clear = certified_clearance(self.path.problem)
        if clear is not None and not clear.distance > 0:
            return clear.words()
        crossed = crossing(self.path.problem)
        return crossed or self._newly_inverted() or self._unbalanced() or self.unlike(outcome)

    def _newly_inverted(self) -> str:
        """Whether a state is inverted where the last one was not, in words, if that is refused."""
        if self.bounds is None or not self.refuse_inverted or self._inverted:
            return ""
        if self.bounds.lower > 0:
            return ""
        return f"cells are inverted, J is in {self.bounds.lower:.3g} to {self.bounds.upper:.3g}"

    def take(self, state: State, outcome: Convergence, kind: str = ORDINARY) -> None:
        """Remember a state, and set the next step."""
        self._touching = self.path.problem.touches()
        self._inverted = self.bounds is not None and not self.bounds.lower > 0
        still = kind == ORDINARY and state.place == self.place
        if still:  # a target where the path is already
            del self._past[0]
        self._past = [state, *self._past] if kind == ORDINARY else [state]
        del self._past[self.settings.remembered :]
        if self._reading is not None and self._accounts is not None and not still:
            known = self.path.balances
            known.append(self._reading._replace(kind=kind))
            works = self._accounts.keep(known[-1].place, anew=kind != ORDINARY)
            for n, work in enumerate(works, start=1):
                known[-n] = known[-n]._replace(work=work)
        if kind == ORDINARY:
            self.pace.accept(outcome.contraction or 0.0, max(self._order, 2))
        self.pace.ahead = max(self.pace.ahead, self.pass_gates() / 2)

    def _unbalanced(self) -> str:
        """Whether the energy did what loads and supports cannot have done, in words. Collective."""
        accounts, known = self._accounts, self.path.balances
        self._reading = None
        if accounts is None or self._goal == self.place:
            return ""
        length = self.length(self.here(self._goal))
        self._reading = accounts.read(length, self.direction, self.side())
        if not known:
            return ""
        floor = 100 * self.newton.criteria.goal * self.newton.tangent.scaled.size
        self.path.floor = max(self.path.floor, floor)
        found = verdict([*_since(known), self._reading], accounts.chord(), floor)
        if found.outside > self.settings.jump:
            return f"the energy misses the work of loads and supports by {found.outside:.2g} of it"
        if found.doubt > self.settings.doubt and self.pace.step > SHORT * self.pace.least:
            return f"two rules of integration of the step's work differ by {found.doubt:.2g}"
        return ""

    def side(self) -> float:
        """Of which side the powers of the state in question are to be taken, 0 for both."""
        return 0.0

    def length(self, here: State) -> float:
        """Place of a new state in the ledger."""
        return here.place

    def watch(self, watcher: Callable[[float, float], None] | None) -> None:
        """Have a function called with |R| and its goal at each iteration."""
        self.newton.criteria.watcher = watcher

    def stepped(self) -> None:
        """The steps alone tell the end."""

    def refuse(self, outcome: Convergence) -> tuple[str, str]:
        """Try less; what to say where no less is left."""
        self.count_tangents()
        self.restore()
        self.why = self._why or outcome.reason
        if self._located:
            return "", ""
        if not self.path.steps and self.is_unheld():
            return self.ending(outcome)
        theta = np.inf
        if outcome.converged or outcome.code == Failure.NO_CONTRACTION:
            theta = 1.0 if outcome.converged else outcome.contraction or 0.0
        if self.pace.refuse(theta, max(self._order, 2)):
            return "", ""
        return self.ending(outcome)

    def is_unheld(self) -> bool:
        """Whether rigid motions are free, which no shorter step would mend. Collective."""
        if self._unheld is None:
            self._unheld = bool(free_motions(self.path.problem))
        return self._unheld

    def ending(self, outcome: Convergence) -> tuple[str, str]:
        """What to say, and to advise, where no shorter step succeeds."""
        why = self._why or outcome.sentence()
        word = "eigenvalue" if self.count == 1 else "eigenvalues"
        count = f" with {self.count} negative {word}" if self.count else ""
        beyond = f", even for a step of {self.pace.step:.3g}: no equilibrium is connected beyond"
        return (
            f"{why[0].upper()}{why[1:]}, at load factor {self.load:.6g}{count}"
            f"{'' if self._unheld else beyond}. The last converged state is kept.",
            outcome.advice,
        )

    def restore(self) -> None:
        """Put the last accepted state back."""
        self.move(self._past[0])

    def memory(self) -> tuple[list[np.ndarray], dict[str, Any]]:
        """The last states, and the numbers that the next step depends on."""
        numbers = {
            "places": [state.place for state in self._past],
            # One number each, or a list: of one load factor as ever.
            "loads": [list(s.loads) if len(s.loads) > 1 else s.load for s in self._past],
            "balances": [list(balance) for balance in self.path.balances],
            "events": [list(event) for event in self.path.events],
            "tangents": self.path.tangents,
            "floor": self.path.floor,
            "gates": self._gates,
            "resumed": self._resumed_step,
            "level": self.level,
            "count": self.count,
            "inverted": self._inverted,
            "reactions": self.newton.criteria.reactions,
            "pace": self.pace.memory(),
            "newton": self.newton.tangent.memory(),
        }
        return [state.values for state in self._past], numbers

    def saved(self) -> None:
        """The run that is taken up has no preconditioner either."""
        if self.newton.tangent.kept.used:
            self.newton.runs.remake()

    def resume(self, saved: Saved) -> None:
        """Go on where a checkpoint holds the path. Collective."""
        numbers = saved.control
        pasts = zip(saved.states, numbers["loads"], numbers["places"], strict=True)
        self._past = [State(u, tuple(map(float, np.atleast_1d(q))), s) for u, q, s in pasts]
        self.path.balances = [_balance(each) for each in numbers["balances"]]
        self.path.events = [Event(*each) for each in numbers["events"]]
        self.path.tangents = numbers["tangents"]
        self.path.floor = numbers.get("floor", 0.0)
        self._counted = self._spent = self.corrector.tangents
        self._gates, self._resumed_step = list(numbers["gates"]), numbers["resumed"]
        self.level, self.count = numbers["level"], numbers["count"]
        self._inverted = numbers["inverted"]
        self.newton.criteria.reactions = numbers["reactions"]
        self.pace.recall(numbers["pace"])
        self.newton.recall(numbers["newton"])
        self.restore()
        self.path.problem.rollback()
        self._touching = self.path.problem.touches()
        self._recall_forces()

    def _recall_forces(self) -> None:
        """Have the forces at the last states again. Collective."""
        known, accounts = self.path.balances, self._accounts
        if accounts is None or not known:
            return
        accounts.cut(0)
        known = [each for each in known if each.kind != BETWEEN]
        for state, balance in reversed(list(zip(self._past, reversed(known), strict=False))):
            self.put(state)
            accounts.keep(balance.place)

    def release(self, sound: bool) -> None:
        """Give the solver back. Collective."""
        self.corrector.destroy()
        if self._accounts is not None:
            self._accounts.destroy()
        release(self.newton, sound)


def _balance(entries: Sequence[Any]) -> Balance:
    """A balance from a checkpoint, whose JSON knows no tuples."""
    found = Balance(*entries)
    return found._replace(others=tuple((q, slope) for q, slope in found.others))


def _since(known: Sequence[Balance]) -> Sequence[Balance]:
    """The last two states of one smooth piece of a path, none of those within steps."""
    if known[-1].kind != ORDINARY:
        return known[-1:]
    return [each for each in known[-3:] if each.kind != BETWEEN][-2:]
