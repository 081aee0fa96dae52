# SPDX-License-Identifier: MIT
"""Arc length: steps along the path's tangent, each returned to equilibrium in a plane."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from petsc4py import PETSc

import numpy as np
from dolfinx import fem
from numpy.typing import NDArray

from ...files.checkpoint import Saved
from ...paths import Convergence, Path
from ...problems import Problem
from ..bordered import Bordered
from ..supported import failure

DESIRED = 5  # Newton iterations of a step at which the next one is as long
SHARPEST = 0.8  # cosine of the largest angle between a step and the path's tangents at its ends
SHORTEST = 1e-6  # of the first step


class ArcLength:
    """Steps of a length along the path, until a load, a number of steps or a condition.

    Args:
        path: Path of the problem.
        bordered: Its solver.
        step: Change of q in the first step.
        to: Load factor at which the path ends; None for none.
        steps: Largest number of steps.
        until: Whether the path is at its end, told after each step.
        largest: Largest displacement of a step over the model's size.
        along: Direction in which the path is left, in place of that of growing q.
    """

    word, symbol = "arc length", "q"
    total: float | None = None

    def __init__(
        self,
        path: Path,
        bordered: Bordered,
        step: float,
        to: float | None,
        steps: int,
        until: Callable[[Problem], bool] | None,
        largest: float,
        along: fem.Function | None,
    ) -> None:
        self.path, self.bordered, self._step, self._to = path, bordered, step, to
        self._steps, self._until, self._largest = steps, until, largest
        self.plane = Plane(bordered, along)
        self.load, self.ended = bordered.load, ""
        self._before = path.u.x.array.copy()
        self._length = self._least = 0.0

    @property
    def done(self) -> float:
        """Steps that were taken."""
        return float(len(self.path.steps))

    def _ending(self, count: int) -> str:
        if self._to is not None and self.load == self._to:
            return f"Load factor {self._to:.6g} reached in {count} steps"
        if self._until is not None and count and self._until(self.bordered.problem):
            return f"The end of the path reached in {count} steps"
        return f"{self._steps} steps taken in {count} steps" if count >= self._steps else ""

    def begin(self) -> None:
        """Return to equilibrium where the start is not in it, and find the first tangent."""
        outcome = self.bordered.solve(HeldLoad(self.bordered, self.load))
        if not outcome.converged:
            sentence = f"{outcome.sentence()}, at the start, q = {self.load:.6g}."
            raise failure(self.path, sentence, outcome.advice)
        self._before = self.path.u.x.array.copy()
        self._length = self.plane.first(self._step)
        self._least = SHORTEST * self._length

    def propose(self) -> Convergence:
        """Leave along the tangent and return to the path. Collective."""
        most = self._largest * self.bordered.scaled.size / self.plane.largest
        self._length = min(self._length, most)
        self.plane.leave(self._length)
        return self.bordered.solve(self.plane)

    def accept(self, outcome: Convergence) -> tuple[Convergence, dict[str, Any]] | None:
        """Take the state, unless the path turns too far from the step; solve for ``to`` exactly."""
        plane, to = self.plane, self._to
        if plane.advance() < SHARPEST and self._length > 2 * self._least:
            plane.restore()
            self.path.refused += 1
            return None
        outcome = replace(outcome, negative=plane.negative)
        if to is not None and (self.load - to) * (self.bordered.load - to) <= 0:
            outcome = self.bordered.solve(HeldLoad(self.bordered, to))
            if not outcome.converged:
                raise failure(self.path, f"{outcome.sentence()}, at the load factor {to}.")
            self.bordered.q.value = to  # to the last digit, by which the end is known
        self._before, self.load = self.path.u.x.array.copy(), self.bordered.load
        plane.accept()
        easy = np.sqrt(DESIRED / max(outcome.iterations, 1))
        self._length *= float(np.clip(easy, 0.5, 1.5))
        return outcome, {}

    def stepped(self) -> None:
        """See whether the path is at its end."""
        self.ended = self._ending(len(self.path.steps))

    def refuse(self, outcome: Convergence) -> tuple[str, str]:
        """Halve the length; what to say where it is too short."""
        self.restore()
        self._length /= 2
        if self._length >= self._least:
            return "", ""
        return (
            f"{outcome.sentence()}, at q = {self.load:.6g} even for a step of {SHORTEST:g} of the "
            "first one. The last converged state is kept.",
            outcome.advice,
        )

    def restore(self) -> None:
        """Put the last converged state back."""
        self.path.u.x.array[:], self.bordered.q.value = self._before, self.load

    def memory(self) -> tuple[list[np.ndarray], dict[str, Any]]:
        """The last state and the path's tangent there, and the next length."""
        plane = self.plane
        numbers = {"length": self._length, "slope": plane.slope, "negative": plane.negative}
        return [self._before, plane.direction()], numbers

    def saved(self) -> None:
        """Nothing is kept that a run that is taken up would not have."""

    def resume(self, saved: Saved) -> None:
        """Go on where a checkpoint holds the path. Collective."""
        numbers = saved.control
        self.plane.resume(saved.states[1], numbers["slope"], numbers["negative"])
        self._before, self.load = saved.states[0], self.path.load
        self.restore()
        self.plane.accept()
        self._length = float(numbers["length"])
        self.stepped()

    def release(self, sound: bool) -> None:
        """Free the solver. Collective."""
        self.plane.destroy()
        self.bordered.destroy()


class Plane:
    """The constraint t . (y - y_n) = s in the scaled unknown, over its displacements."""

    def __init__(self, bordered: Bordered, along: fem.Function | None) -> None:
        self.bordered = bordered
        self.t, self.base, self.y = (bordered.b.duplicate() for _ in range(3))
        self._earlier = bordered.b.duplicate()
        self.slope, self._length, self.scale = 0.0, 0.0, bordered.scaled.size
        self.negative: int | None = None
        self._along = along

    def first(self, step: float) -> float:
        """Set the first tangent; length of the first step."""
        bordered = self.bordered
        self.negative = bordered.tangent()
        norm = self._take(bordered.du_q, -1.0)
        if norm == 0:
            raise ValueError("the load does not move the body: nothing to follow.")
        if not np.isfinite(norm):
            raise ValueError(
                "the tangent at the start could not be factorized: is the body held, and the "
                "energy's second derivative finite there?"
            )
        length, self.slope = abs(step) * norm, 1 / norm
        if self._along is not None:
            self._turn(self._along.x.array)
            length, self.slope = abs(step) / self.largest, 0.0
        if step < 0:
            self.t.scale(-1)
            self.slope *= -1
        bordered.scaled.get(self.base)
        return length

    def direction(self) -> NDArray[np.float64]:
        """The tangent as values of the unknown."""
        values = fem.Function(self.bordered.problem.u.function_space)
        values.x.petsc_vec.pointwiseMult(self.t, self.bordered.scaled.D)
        values.x.scatter_forward()
        return values.x.array

    def resume(self, direction: NDArray[np.float64], slope: float, negative: int | None) -> None:
        """Take the tangent of an earlier path."""
        self._turn(direction)
        self.slope, self.negative = slope, negative

    def _turn(self, direction: NDArray[np.float64]) -> None:
        """Make t the unit vector of values of the unknown."""
        u = self.bordered.problem.u
        before = u.x.array.copy()
        u.x.array[:] = direction
        self.bordered.scaled.get(self.y)
        u.x.array[:] = before
        self._take(self.y, 1.0)

    @property
    def largest(self) -> float:
        """Largest displacement component of t."""
        return self.bordered.largest(self.t)

    def leave(self, length: float) -> None:
        """Move along the tangent by a length."""
        self._length = length
        self.bordered.move(length, self.t, length * self.slope)

    def value(self) -> float:
        """Distance from the plane. Collective."""
        self.bordered.scaled.get(self.y)
        self.y.axpy(-1, self.base)
        return float(self.t.dot(self.y)) - self._length

    def gradient(self, g_u: PETSc.Vec) -> float:
        """Its normal t, into a vector; nothing by q."""
        self.t.copy(g_u)
        return 0.0

    def advance(self) -> float:
        """Take the tangent of the new state; cosine of the larger angle with the step's chord."""
        bordered = self.bordered
        self.t.copy(self._earlier)
        self._before = (self.slope, self.negative)
        bordered.scaled.get(self.y)
        self.y.axpy(-1, self.base)
        self._mask(self.y)
        chord = self.y.norm()
        self.negative = bordered.tangent()
        norm = self._take(bordered.du_q, -1.0)
        self.slope = 1 / norm
        if self.t.dot(self._earlier) < 0:
            self.t.scale(-1)
            self.slope *= -1
        angles = self._earlier.dot(self.y) / chord, self.t.dot(self.y) / chord
        return float(min(angles))

    def accept(self) -> None:
        """Start the next step from the present state."""
        self.bordered.scaled.get(self.base)

    def restore(self) -> None:
        """Return to the tangent before :meth:`advance`."""
        self._earlier.copy(self.t)
        self.slope, self.negative = self._before

    def _take(self, direction: PETSc.Vec, sign: float) -> float:
        """Make t the unit vector of a direction's displacements; its norm."""
        direction.copy(self.t)
        self._mask(self.t)
        norm = float(self.t.norm())
        if norm > 0:
            self.t.scale(sign / norm)
        return norm

    def _mask(self, x: PETSc.Vec) -> None:
        x.array[self.bordered.scaled.others] = 0

    def destroy(self) -> None:
        """Free the vectors."""
        for item in (self.t, self.base, self.y, self._earlier):
            item.destroy()


class HeldLoad:
    """The constraint q = to."""

    def __init__(self, bordered: Bordered, to: float) -> None:
        self.bordered, self.to, self.scale = bordered, to, abs(to) or 1.0

    def value(self) -> float:
        """Distance of q from its value."""
        return self.bordered.load - self.to

    def gradient(self, g_u: PETSc.Vec) -> float:
        """Nothing by u; 1 by q."""
        g_u.set(0)
        return 1.0
