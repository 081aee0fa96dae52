# SPDX-License-Identifier: MIT
"""Steps in time: each a minimization, as long as its local error allows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ...files.checkpoint import Saved
from ...ledger import Row
from ...motion import Motion
from ...paths import Convergence, Path
from ...programs import kinks
from ...validity import Bounds
from ..certificates import certified_volume, crossing
from ..corrector import Corrector
from ..ladder import Failure
from ..motion_accounts import MotionAccounts
from ..newton import Newton
from ..pace import Pace
from ..reuse import release

SAFE = 0.6  # of the tolerance, that the next step's local error aims at
ROUGH = 1e-3  # of the body's size, a displacement that schemes which begin by order 1 resolve
LAG = 1e-4  # of the force level, that forces which lag may be off
AGREEMENTS = 20  # solves for them, at most
SIMILAR = 1.3  # ratio of c up to which factors of the last step are tried


class TimeSteps:
    """From time to time, by plain Newton from where the motion leads freely.

    Where that does not contract, the same step's potential is minimized
    (:class:`forms.solving.newton.Newton`); where that fails too, or the local error is above the
    tolerance, the step is refused, and half or less is tried.

    Args:
        path: Path of the motion's problem.
        newton: Its solver.
        motion: Body in motion.
        to: Times that end a step.
        pace: Lengths of the steps.
        dt: Fixed length of the steps; None where the local error sets it.
        tolerance: Local error of a displacement over the largest one, or over the body's size.
        rests: Whether the motion ends where it has come to rest.

    Attributes:
        refuse_inverted: Whether steps to inverted states are refused.
    """

    word, symbol = "motion", "t"
    total: float | None = 1.0
    refuse_inverted = False

    def __init__(
        self,
        path: Path,
        newton: Newton,
        motion: Motion,
        to: Sequence[float],
        pace: Pace,
        dt: float | None,
        tolerance: float,
        rests: Callable[[Path], bool] | None = None,
    ) -> None:
        self.path, self.newton, self.motion, self.pace = path, newton, motion, pace
        self._dt, self._tolerance, self._rests = dt, tolerance, rests
        self._begin, self._stops = float(motion.t.value), [float(stop) for stop in to]
        bends = kinks(path.problem, motion.t)
        inside = [b for b in bends if self._begin < b < self._stops[-1]]
        self._ends = sorted({*self._stops, *inside})
        self.corrector = Corrector(newton)
        self._accounts = MotionAccounts(motion) if path.problem.has_energy else None
        self._time, self._scale, self._level = self._begin, 0.0, 0.0
        self._inertia = self._ratio = 0.0
        self._part: float | None = None
        self.why, self._why = "", ""
        self.bounds: Bounds | None = None
        self._counted = self._spent = self.corrector.tangents
        self._velocity: Any = None
        self._at_rest = False

    def start_with(self, velocity: Any) -> None:
        """Set the first velocity."""
        self._velocity = velocity

    @property
    def load(self) -> float:
        """Time of the last accepted state."""
        return self._time

    @property
    def done(self) -> float:
        """Share of the time that has gone."""
        if self.total is None:
            return self._time
        return min((self._time - self._begin) / (self._stops[-1] - self._begin), 1.0)

    @property
    def ended(self) -> str:
        """Whether the last time is reached, in words."""
        count = f"in {len(self.path.steps)} steps"
        if self._at_rest:
            return f"At rest at t = {self._time:.6g} {count}"
        return f"t = {self._time:.6g} reached {count}" if self._time >= self._stops[-1] else ""

    def begin(self) -> None:
        """Find the first acceleration, and the first account. Collective."""
        self.motion.begin(self._velocity)
        self._read_start()
        # Here, and not at the first solve, which may be that of a motion that is taken up.
        self.motion.aim(self.pace.toward(self._ends[0] - self._time))
        self.motion.stay()
        self.newton.tangent.scaled.measure()
        self.restore()

    def _read_start(self) -> None:
        if self._accounts is not None:
            self._accounts.begin()
            inertia = self._accounts.inertia
        else:
            inertia = self.motion.inertia.of(self.motion.acceleration.x.array)
        self._level = self._norm(inertia)

    def _norm(self, forces: np.ndarray) -> float:
        """Norm of forces where nothing is prescribed. Collective."""
        free = forces.copy()
        self.path.problem.clear(free)
        return float(np.sqrt(self.path.problem.comm.allreduce(float(free @ free))))

    def propose(self) -> Convergence:
        """Solve for the end of the next step. Collective."""
        motion, self._why = self.motion, ""
        end = next(end for end in self._ends if end > self._time)
        left = end - self._time
        step = self.pace.toward(left)
        if self._dt is not None:  # its multiples, behind a step that was refused, too
            count = np.floor((self._time - self._begin) / self._dt + 1e-6) + 1
            left = min(left, self._begin + self._dt * count - self._time)
            step = self.pace.step = min(self.pace.ahead, left)
        if left - step < 1e-9 * step:  # no rest of rounding
            step = left
        motion.t.value = self._time
        motion.aim(step)
        inertia = motion.stage.inertia
        similar = 1 / SIMILAR < inertia / self._inertia < SIMILAR if self._inertia else False
        outcome = self.corrector.solve(self._level, keep=similar)
        if outcome.code == Failure.NOT_FINITE:
            motion.stay()
            outcome = self.corrector.solve(self._level)
        if self.corrector.tangents > self._counted or not similar:
            self._inertia = inertia
        self._count_tangents()
        outcome = outcome if outcome.converged else self._minimize(outcome)
        return self._agree(outcome) if self.motion.lags and outcome.converged else outcome

    def _agree(self, outcome: Convergence) -> Convergence:
        """Solve again until forces that lag are those of the step itself. Collective."""
        scaled, iterations = self.newton.tangent.scaled, outcome.iterations
        b = self.path.problem.create_vector()
        for _ in range(AGREEMENTS):
            self.motion.relag()
            level = max(scaled.residual(b), self._level, outcome.force_level)
            if b.norm() <= max(LAG * level, scaled.floor()):
                break
            outcome = self.corrector.solve(level, keep=True)
            iterations += outcome.iterations
            if not outcome.converged:
                break
        else:
            outcome = replace(outcome, converged=False, reason="friction does not settle")
        self._count_tangents()
        b.destroy()
        return replace(outcome, iterations=iterations)

    def _minimize(self, first: Convergence) -> Convergence:
        """The same step by a minimization, from the last state. Collective."""
        self.motion.stay()
        self.newton.criteria.imbalance = self._level or None
        outcome = self.newton.solve()
        self._count_tangents()
        self.corrector.forget_factors()
        return replace(outcome, iterations=outcome.iterations + first.iterations)

    def accept(self, outcome: Convergence) -> tuple[Convergence, dict[str, Any]] | None:
        """Measure the step's local error, and take it. Collective."""
        motion, path = self.motion, self.path
        found = motion.found()
        (error, scale), row, sound = motion.error(found), None, True
        if self._accounts is not None:
            row, sound = self._accounts.step(found)
        motion.u.x.array[:] = found.u
        crossed = path.problem.crossed() if motion.scheme.middle else ""
        crossed = crossed or crossing(path.problem)
        self.bounds = certified_volume(path.problem)
        size = self.newton.tangent.scaled.size
        least = ROUGH * size if motion.scheme.order == 1 or motion.scheme.two_step else 0.0
        scale = min(max(self._scale, scale, least), size)
        ratio = error / (self._tolerance * scale) if scale > 0 else 0.0
        if ratio > 1 and not motion.step:
            # Where loads grow from nothing the error stays a part of what has moved, whatever dt.
            part, before = error / scale, self._part
            self._part = part
            ratio = 1.0 if before is not None and part > 0.5 * before else ratio
        self._why = crossed or self._refusal(ratio, sound)
        if self._why:
            self._ratio = ratio
            path.refused += 1
            return None
        self._scale = scale
        motion.take(found)
        self._time = float(motion.t.value)
        end = next((end for end in self._ends if abs(end - self._time) < 1e-9 * motion.dt), None)
        if end is not None:
            self._time = motion.t.value = end
        order, refused = motion.scheme.order + 1, self.pace.calm
        self.pace.accept(self.pace.settings.aim * ratio / SAFE, order)
        if self._dt is not None:
            self.pace.ahead = self.pace.step if refused else self._dt
        if row is not None and self._accounts is not None:
            path.accounts.append(row)
            self._accounts.take()
            momentum, inertia = self._accounts.momentum, self._accounts.inertia
        else:
            momentum = motion.inertia.of(motion.velocity.x.array)
            inertia = motion.inertia.of(motion.acceleration.x.array)
        self._level = self._norm(inertia)
        # Of the tangent with inertia in it the eigenvalues say nothing of the body's stability.
        outcome = replace(outcome, negative=None, tangents=self._spent_tangents())
        notes = {**motion.records(momentum), "inertia": self._level}
        return outcome, {**notes, "error": error, "dt": motion.dt}

    def _refusal(self, ratio: float, sound: bool) -> str:
        if not sound:
            return "the energy at the end of the step is not finite"
        if self.refuse_inverted and self.bounds is not None and not self.bounds.lower > 0:
            return f"cells are inverted, J is in {self.bounds.lower:.3g} to {self.bounds.upper:.3g}"
        if self._dt is None and ratio > 1:
            return f"the local error is {ratio:.2g} times its tolerance"
        return ""

    def _spent_tangents(self) -> int:
        spent, self._spent = self._counted - self._spent, self._counted
        return spent

    def _count_tangents(self) -> None:
        self.path.tangents += self.corrector.tangents - self._counted
        self._counted = self.corrector.tangents

    def watch(self, watcher: Callable[[float, float], None] | None) -> None:
        """Have a function called with |R| and its goal at each iteration."""
        self.newton.criteria.watcher = watcher

    def stepped(self) -> None:
        """See whether the body has come to rest, where that ends the motion."""
        self._at_rest = self._rests is not None and self._rests(self.path)

    def refuse(self, outcome: Convergence) -> tuple[str, str]:
        """Return to the last state, and try a shorter step."""
        self.restore()
        self.why = self._why or outcome.reason
        order = self.motion.scheme.order + 1
        theta = self.pace.settings.aim * self._ratio / SAFE if outcome.converged else np.inf
        if self.pace.refuse(theta, order):
            return "", ""
        why = self._why or outcome.sentence()
        return (
            f"{why[0].upper()}{why[1:]}, at t = {self._time:.6g}, even for a step of "
            f"{self.pace.step:.3g}. The last state is kept.",
            outcome.advice,
        )

    def restore(self) -> None:
        """Put the last accepted state back. Collective."""
        self.motion.begun = self._time
        self.motion.back()

    def memory(self) -> tuple[list[np.ndarray], dict[str, Any]]:
        """The last states, and the numbers that the next step depends on."""
        numbers = {
            "time": self._time,
            "begin": self._begin,
            "scheme": repr(self.motion.scheme),
            "step": self.motion.step,
            "momenta": self.motion.momenta.tolist(),
            "scale": self._scale,
            "tangents": self.path.tangents,
            "accounts": [list(row) for row in self.path.accounts],
            "reactions": self.newton.criteria.reactions,
            "pace": self.pace.memory(),
            "newton": self.newton.tangent.memory(),
        }
        states = self.motion.memory()
        if self._accounts is not None:
            forces, numbers["account"] = self._accounts.memory()
            states += forces
        return states, numbers

    def saved(self) -> None:
        """The run that is taken up has no factors either."""
        self.corrector.forget_factors()
        self._inertia = 0.0
        if self.newton.tangent.kept.used:
            self.newton.runs.remake()

    def resume(self, saved: Saved) -> None:
        """Go on where a checkpoint holds the motion. Collective."""
        numbers = saved.control
        if numbers["begin"] != self._begin or numbers["scheme"] != repr(self.motion.scheme):
            raise ValueError(
                f"the checkpoint's motion is {numbers['scheme']}'s from t = "
                f"{numbers['begin']:.6g}, this one {self.motion.scheme!r}'s from "
                f"{self._begin:.6g}: give each motion a folder of its own."
            )
        self._time = self.motion.t.value = numbers["time"]
        self.motion.recall(saved.states, numbers["step"])
        self.path.problem.rollback()
        self.motion.momenta = np.array(numbers["momenta"])
        self._scale = numbers["scale"]
        self.path.tangents = numbers["tangents"]
        self._counted = self._spent = self.corrector.tangents
        self.path.accounts[:] = [Row(*each) for each in numbers["accounts"]]
        self.newton.criteria.reactions = numbers["reactions"]
        self.pace.recall(numbers["pace"])
        self.newton.recall(numbers["newton"])
        self._read_start()
        if self._accounts is not None:
            self._accounts.recall(saved.states[-2:], numbers["account"])

    def release(self, sound: bool) -> None:
        """Give the solver back. Collective."""
        self.corrector.destroy()
        if self._accounts is not None:
            self._accounts.destroy()
        release(self.newton, sound)
