# SPDX-License-Identifier: MIT
"""Equilibrium paths through limit points, where neither load nor displacement grows steadily."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Any

from petsc4py import PETSc

import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray

from ..files.checkpoint import Archive, Checkpoint, Saved
from ..paths import Path, Step, check_record, recorded
from ..problems import Problem
from ..supports import Support
from .bordered import Bordered
from .progress import bar_of
from .supported import failure

DESIRED = 5  # Newton iterations of a step at which the next one is as long
SHARPEST = 0.8  # cosine of the largest angle between a step and the path's tangents at its ends
SHORTEST = 1e-6  # of the first step


def arc_length(
    potential: ufl.Form,
    u: fem.Function,
    supports: Iterable[Support],
    q: fem.Constant,
    *,
    step: float,
    to: float | None = None,
    steps: int = 1000,
    until: Callable[[Problem], bool] | None = None,
    largest: float = 0.05,
    along: fem.Function | None = None,
    virtual_work: ufl.Form | None = None,
    rtol: float = 1e-8,
    ctol: float = 1e-6,
    max_iterations: int = 15,
    record: Mapping[str, Callable[[Problem], Any]] | None = None,
    on_step: Callable[[Path], None] | None = None,
    checkpoint: Checkpoint | None = None,
    progress: bool = True,
) -> Path:
    """Follow an equilibrium path by its length: over limit points of load and displacement.

    t . (u - u_n) = s,  t the unit tangent of the path at the last state (u_n, q_n)

    Each step starts along t and returns to equilibrium in the plane at the distance s (Riks'
    method). s grows after easy steps and is halved where Newton's method fails or the path turns
    by more than 37 degrees from the step. Collective.

    Args:
        potential: Total potential [J] of u that contains q.
        u: Unknown, starting from its present values, in equilibrium at the present q or near it.
        supports: Prescribed displacements; they do not depend on q.
        q: Load factor, found along.
        step: Change of q in the first step; its sign is the direction in which the path is left.
        to: Load factor at which the path ends when it is first passed, solved for exactly.
        steps: Largest number of steps.
        until: Function of the problem that tells, after each step, whether the path is at its end.
        largest: Largest displacement of a step over the model's size.
        along: Direction in which the path is left, in place of that of growing q: a mode of
            :func:`forms.lowest_modes` turns into another branch at a bifurcation. ``step`` is then
            the largest displacement [m] of the first step.
        virtual_work: Linear form added to the residual, for loads without a potential.
        rtol: Tolerance of |R_free| relative to the force level.
        ctol: Tolerance of the last correction relative to the model's size.
        max_iterations: Newton iterations per step.
        record: Functions of the problem, evaluated after each step.
        on_step: Called with the path after each step.
        checkpoint: Where the path is saved, and taken up when the script is started again; see
            :class:`forms.Checkpoint`.
        progress: Show a line of progress on rank 0.

    Returns:
        Path; not ``completed`` where the steps were used up before ``to`` or ``until``. ``load`` of
        each step is q, and ``convergence.negative`` the number of negative
        eigenvalues of the tangent in that state.

    Raises:
        NotConverged: a step failed at SHORTEST of the first length; u and q hold the last state.
        ValueError: the potential does not contain q, or steps without length or end.
    """
    _check(step, to, steps, until, largest, float(getattr(q, "value", 0.0)))
    check_record(record)
    bordered = Bordered(potential, u, supports, q, virtual_work, rtol, ctol, max_iterations)
    path, start = Path(u, bordered.problem, begin=bordered.load), time.perf_counter()
    before, load = u.x.array.copy(), bordered.load
    bar = bar_of("arc length", None, bordered.problem.comm, progress)
    plane, ended = _Plane(bordered, along), ""
    archive = None if checkpoint is None else Archive(checkpoint, u, "path of arc_length")

    def ending() -> str:
        if to is not None and load == to:
            return f"Load factor {to:.6g} reached"
        if until is not None and path.steps and until(bordered.problem):
            return "The end of the path reached"
        return f"{steps} steps taken" if len(path.steps) >= steps else ""

    try:
        outcome = bordered.solve(_Load(bordered, load))  # where the start is not in equilibrium
        if not outcome.converged:
            raise failure(
                path, f"{outcome.sentence()}, at the start, q = {load:.6g}.", outcome.advice
            )
        before = u.x.array.copy()
        length = plane.first(step)
        least = SHORTEST * length
        if archive is not None and (saved := archive.read()) is not None:
            length = _resume(saved, path, plane)
            before, load, ended = u.x.array.copy(), bordered.load, ending()
            start -= path.seconds
        while not ended:
            length = min(length, largest * bordered.scaled.size / plane.largest)
            plane.leave(length)
            outcome = bordered.solve(plane)
            turned = False
            if outcome.converged:
                turned = plane.advance() < SHARPEST and length > 2 * least
                if turned:
                    plane.restore()
            if outcome.converged and not turned:
                outcome = replace(outcome, negative=plane.negative)
                if to is not None and (load - to) * (bordered.load - to) <= 0:
                    outcome = bordered.solve(_Load(bordered, to))
                    if not outcome.converged:
                        raise failure(path, f"{outcome.sentence()}, at the load factor {to}.")
                    q.value = to  # to the last digit, by which the end is known
                before, load = u.x.array.copy(), bordered.load
                plane.accept()
                path.steps.append(Step(load, outcome, recorded(record, bordered.problem)))
                bar.update()
                bar.set_postfix_str(f"q = {load:.4g}, {outcome.iterations} iterations")
                if on_step is not None:
                    on_step(path)
                length *= float(np.clip(np.sqrt(DESIRED / max(outcome.iterations, 1)), 0.5, 1.5))
                ended = ending()
                if archive is not None:
                    path.seconds = time.perf_counter() - start
                    states = (before, plane.direction())
                    archive.write(states, path.steps, _control(path, plane, length), bool(ended))
                continue
            path.refused += 1
            u.x.array[:], q.value = before, load
            length /= 2
            if length < least:
                raise failure(
                    path,
                    f"{outcome.sentence()}, at q = {load:.6g} even for a step of {SHORTEST:g} of "
                    "the first one. The last converged state is kept.",
                    outcome.advice,
                )
    finally:
        plane.destroy()
        u.x.array[:], q.value = before, load
        bordered.problem.prepare()
        bordered.destroy()
        bar.close()
        path.seconds = time.perf_counter() - start
    path.end(f"{ended} in {len(path.steps)} steps")
    path.completed = not (ended.endswith("steps taken") and (to is not None or until is not None))
    return path


def _control(path: Path, plane: _Plane, length: float) -> dict[str, Any]:
    """What a checkpoint keeps beside the state and the direction."""
    numbers = {"length": length, "slope": plane.slope, "negative": plane.negative}
    return {**numbers, "refused": path.refused, "seconds": path.seconds}


def _resume(saved: Saved, path: Path, plane: _Plane) -> float:
    """Take a path up where a checkpoint holds it; length of the next step. Collective."""
    control = saved.control
    path.steps += [Step(*step) for step in saved.steps]
    path.refused, path.seconds = control["refused"], control["seconds"]
    path.resumed = path.load
    plane.resume(saved.states[1], control["slope"], control["negative"])
    path.u.x.array[:] = saved.states[0]
    plane.bordered.q.value = path.load
    plane.accept()
    return float(control["length"])


class _Plane:
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
        self.bordered.scaled.get(self.y)
        self.y.axpy(-1, self.base)
        return float(self.t.dot(self.y)) - self._length

    def gradient(self, g_u: PETSc.Vec) -> float:
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


class _Load:
    """The constraint q = to."""

    def __init__(self, bordered: Bordered, to: float) -> None:
        self.bordered, self.to, self.scale = bordered, to, abs(to) or 1.0

    def value(self) -> float:
        return self.bordered.load - self.to

    def gradient(self, g_u: PETSc.Vec) -> float:
        g_u.set(0)
        return 1.0


def _check(
    step: float,
    to: float | None,
    steps: int,
    until: Callable[[Problem], bool] | None,
    largest: float,
    q: float,
) -> None:
    if not (np.isfinite(step) and step != 0):
        raise ValueError(f"step is the first change of q, a number but not 0, got {step}.")
    if not (largest > 0 and steps >= 1):
        raise ValueError(
            f"largest must be positive and steps at least 1, got {largest} and {steps}."
        )
    if to is not None and (not np.isfinite(to) or to == q):
        raise ValueError(f"to must be a load factor other than the present {q}, got {to}.")
    if until is not None and not callable(until):
        raise ValueError(f"until is a function of the problem, got {type(until).__name__}.")
