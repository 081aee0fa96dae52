# SPDX-License-Identifier: MIT
"""Solving at one load, and following a load path with adaptive steps."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import ufl
from dolfinx import fem

from ..files.checkpoint import Archive, Checkpoint, Saved
from ..paths import Convergence, Path, Step, check_record, instability, recorded
from ..problems import Problem
from ..supports import Support
from .newton import Newton
from .progress import bar_of
from .reuse import newton_for, problem_for, release
from .settings import Settings
from .supported import failure


def solve(
    potential: ufl.Form | Problem,
    u: fem.Function | None = None,
    supports: Iterable[Support] = (),
    *,
    virtual_work: ufl.Form | None = None,
    options: Mapping[str, Any] | None = None,
    prefix: str = "variform_",
    rtol: float = 1e-8,
    ctol: float = 1e-6,
    projection: str = "auto",
    settings: Settings | None = None,
    record: Mapping[str, Callable[[Problem], Any]] | None = None,
    load: float = 1.0,
) -> Path:
    """Solve for u at the present loads, in one step from its present values. Collective.

    Args:
        potential: Total potential [J] (or a residual, linear in a test function); or a
            :class:`forms.Problem`, which comes with its unknown and supports.
        u: Unknown; holds the solution afterwards, or its old values if the solve fails.
        supports: Prescribed displacements.
        virtual_work: Linear form added to the residual, for loads without a potential.
        options: PETSc options over the presets, without prefix, as ``{"snes_max_it": 50}``.
        prefix: Prefix of the options on the command line, which wins over ``options``.
        rtol: Tolerance of |R_free| relative to the force level, see :class:`Newton`.
        ctol: Tolerance of the last correction relative to the model's size.
        projection: When to make the tangent positive semi-definite: "auto", "always" or "never",
            see :class:`Newton`.
        settings: Numbers that the solver is tuned by, and the ladder of its ways.
        record: Functions of the problem, evaluated at the solution; collective.
        load: Load factor to be noted in the path and its files.

    Returns:
        Path of one step.

    Raises:
        NotConverged: Newton's method failed; u has its old values.
        ValueError: forms or supports of the wrong kind.
    """
    check_record(record)
    problem = problem_for(potential, u, supports, virtual_work)
    u = problem.u
    newton = newton_for(problem, options, prefix, rtol, ctol, projection, settings)
    path, start = Path(u, problem), time.perf_counter()
    before = u.x.array.copy()
    converged = False
    try:
        outcome = _attempt(newton)
        converged = outcome.converged
    finally:
        if not converged:
            u.x.array[:] = before
            problem.rollback()
        release(newton, converged)
    path.seconds = time.perf_counter() - start
    if not converged:
        shown = f"; -{prefix}snes_monitor shows each iteration" if outcome.iterations else ""
        raise failure(
            path,
            f"{outcome.sentence()}. The old state is kept.",
            outcome.advice or f"Reach the load in steps with forms.follow{shown}.",
        )
    problem.commit()
    path.steps.append(Step(load, outcome, recorded(record, problem)))
    path.completed = True
    path.reason = f"{outcome.sentence()}.{instability(path.steps)}"
    return path


def follow(
    potential: ufl.Form | Problem,
    u: fem.Function | None = None,
    supports: Iterable[Support] = (),
    t: fem.Constant | None = None,
    to: float = 1.0,
    *,
    step: float | None = None,
    min_step: float | None = None,
    max_step: float | None = None,
    virtual_work: ufl.Form | None = None,
    options: Mapping[str, Any] | None = None,
    prefix: str = "variform_",
    rtol: float = 1e-8,
    ctol: float = 1e-6,
    projection: str = "auto",
    settings: Settings | None = None,
    record: Mapping[str, Callable[[Problem], Any]] | None = None,
    on_step: Callable[[Path], None] | None = None,
    checkpoint: Checkpoint | None = None,
    progress: bool = True,
) -> Path:
    """Follow the solution while the load factor goes from its present value to a last one.

    A step that fails is halved and tried again from the last converged state; a step that took few
    iterations lets the next one grow by half. Collective.

    Args:
        potential: Total potential [J] (or a residual, linear in a test function); or a
            :class:`forms.Problem`, which comes with its unknown and supports.
        u: Unknown, starting from its present values.
        supports: Prescribed displacements, which may depend on t.
        t: Load factor that the potential and the supports were written with.
        to: Last load factor.
        step: First step of t; by default a tenth of the way.
        min_step: Smallest step; by default 1/1000 of the way.
        max_step: Largest step; by default twice the first.
        virtual_work: Linear form added to the residual, for loads without a potential.
        options: PETSc options over the presets, without prefix.
        prefix: Prefix of the options on the command line, which wins over ``options``.
        rtol: Tolerance of |R_free| relative to the force level, see :class:`Newton`.
        ctol: Tolerance of the last correction relative to the model's size.
        projection: When to make the tangent positive semi-definite: "auto", "always" or "never",
            see :class:`Newton`.
        settings: Numbers that the solver is tuned by, and the ladder of its ways.
        record: Functions of the problem, evaluated after each step and kept; collective.
        on_step: Called with the path after each step, as a :class:`forms.VTX` writer.
        checkpoint: Where the path is saved, and taken up when the script is started again; see
            :class:`forms.Checkpoint`.
        progress: Show a progress bar on rank 0.

    Returns:
        Path with all steps.

    Raises:
        NotConverged: the step became smaller than min_step; u and t hold the last converged state,
            and the exception's ``path`` the steps so far.
        ValueError: forms or supports of the wrong kind, steps that are not positive, nothing that
            depends on t, or a checkpoint of another path.
        OSError: checkpoints cannot be written from the start.
    """
    if not isinstance(t, fem.Constant):
        raise ValueError(
            f"follow needs the load factor of forms.load_factor, got {type(t).__name__}."
        )
    walk = _Walk.start(float(t.value), to, step, min_step, max_step)
    check_record(record)
    problem = problem_for(potential, u, supports, virtual_work)
    u = problem.u
    if not problem.depends_on(t):
        raise ValueError(
            "nothing depends on the load factor t: write a load or a support with it, or use solve."
        )
    archive = None if checkpoint is None else Archive(checkpoint, u, "path of follow")
    newton = newton_for(problem, options, prefix, rtol, ctol, projection, settings)
    path, start = Path(u, problem, begin=float(t.value)), time.perf_counter()
    bar = bar_of("load", 1.0, problem.comm, progress)
    past, reached = [_State(u.x.array.copy(), walk.done)], float(t.value)

    def save(now: bool) -> None:
        path.seconds = time.perf_counter() - start
        if archive is not None and path.steps:
            control = {**vars(walk), "places": [s.done for s in past]}
            control["newton"] = newton.tangent.memory()
            counts = {"refused": path.refused, "seconds": path.seconds}
            states = [s.values for s in past]
            if archive.write(states, path.steps, {**control, **counts}, now):
                newton.tangent.kept.renew()  # as the run that goes on from this checkpoint has to

    try:
        if archive is not None and (saved := archive.read()) is not None:
            past, reached = _resume(saved, path, walk, newton, t), float(t.value)
            start -= path.seconds
            bar.update(walk.fraction)
            if problem.comm.rank == 0:
                resumed = f"Resumed at load factor {reached:.6g} from {archive.folder}."
                bar.write(resumed, sys.stderr)
        while not walk.finished:
            t.value = walk.aim()
            _extrapolate(problem, past, walk.done + walk.ahead, newton.settings.bent)
            outcome = _attempt(newton)
            if outcome.converged:
                reached = float(t.value)
                problem.commit()
                past = [_State(u.x.array.copy(), walk.done + walk.ahead), *past]
                del past[newton.settings.remembered :]
                path.steps.append(Step(reached, outcome, recorded(record, problem)))
                walk.advance(outcome.iterations <= newton.settings.easy)
                bar.update(walk.fraction - bar.n)
                bar.set_postfix_str(f"t = {reached:.4g}, {outcome.iterations} iterations")
                if on_step is not None:
                    on_step(path)
                save(now=walk.finished)
                continue
            path.refused += 1
            u.x.array[:] = past[0].values
            t.value = reached
            problem.rollback()
            if not walk.halve():
                save(now=True)
                raise failure(
                    path,
                    f"{outcome.sentence()}, at load factor {reached:.6g} even for a step of "
                    f"{2 * walk.ahead:.3g}. The last converged state is kept.",
                    outcome.advice
                    or f"Try a smaller min_step; -{prefix}snes_monitor shows each iteration.",
                )
            bar.set_postfix_str(f"step halved to {walk.ahead:.3g} ({outcome.reason})")
    finally:
        # Whatever ended the path, Ctrl-C included: the last converged state is left behind.
        u.x.array[:] = past[0].values
        t.value = reached
        problem.rollback()
        release(newton, walk.finished)
        bar.close()
        path.seconds = time.perf_counter() - start
    path.end(f"Load factor {reached:.6g} reached in {len(path.steps)} steps")
    return path


@dataclass
class _Walk:
    """Lengths of load steps: halved on failure, grown by half after an easy step."""

    begin: float
    end: float
    ahead: float
    least: float
    most: float
    done: float = 0.0

    @classmethod
    def start(
        cls, begin: float, end: float, step: float | None, least: float | None, most: float | None
    ) -> _Walk:
        """Steps with their defaults; refuses lengths that are not positive."""
        way = abs(end - begin)
        if way == 0:
            raise ValueError(f"the load factor is at {end} already: use solve, or another to=.")
        first = way / 10 if step is None else step
        least = way / 1000 if least is None else least
        most = 2 * first if most is None else most
        if not (np.isfinite(way) and min(first, least, most) > 0):
            raise ValueError(
                f"load steps must be positive and the way finite, got step = {first}, min_step = "
                f"{least}, max_step = {most} from {begin} to {end}."
            )
        return cls(begin, end, first, min(least, first), max(most, first))

    @property
    def finished(self) -> bool:
        return self.done >= abs(self.end - self.begin)

    @property
    def fraction(self) -> float:
        return min(self.done / abs(self.end - self.begin), 1.0)

    def aim(self) -> float:
        """Load factor of the next step, the last one exactly."""
        left = abs(self.end - self.begin) - self.done
        # A remainder that is only rounding would become a step of its own.
        if left <= self.ahead * (1 + 1e-9):
            self.ahead = left
            return self.end
        return self.begin + np.sign(self.end - self.begin) * (self.done + self.ahead)

    def advance(self, easily: bool) -> None:
        """A step has converged."""
        self.done += self.ahead
        if easily:
            self.ahead = min(self.most, 1.5 * self.ahead)

    def halve(self) -> bool:
        """A step has failed; whether a smaller one may be tried."""
        self.ahead /= 2
        return self.ahead >= self.least

    def resume(self, saved: Mapping[str, float]) -> None:
        """Go on from the numbers of an earlier walk; refuses one of another way."""
        if saved["begin"] != self.begin:
            raise ValueError(
                f"the checkpoint's path began at load factor {saved['begin']:.6g}, this one begins "
                f"at {self.begin:.6g}: give each path a folder of its own."
            )
        way, done = self.end - self.begin, saved["done"] * np.sign(saved["end"] - self.begin)
        if not 0 < done / way <= 1 + 1e-9:
            raise ValueError(
                f"the checkpoint is at load factor {self.begin + done:.6g}, which is not on the "
                f"way from {self.begin:.6g} to {self.end:.6g}: start anew, or go further."
            )
        self.done, self.ahead = saved["done"], min(max(saved["ahead"], self.least), self.most)


class _State(NamedTuple):
    """Values of the unknown, ghosts included, and how far along the way they belong."""

    values: np.ndarray
    done: float


def _attempt(newton: Newton) -> Convergence:
    """One Newton solve at the present load, boundary values carried along first."""
    _predict(newton)
    return newton.solve()


def _predict(newton: Newton) -> None:
    for support in newton.problem.supports:
        support.update()
    newton.predict()


def _resume(saved: Saved, path: Path, walk: _Walk, newton: Newton, t: fem.Constant) -> list[_State]:
    """Take a path up where a checkpoint holds it; its last states."""
    first = replace(walk).aim()
    walk.resume(saved.control)
    if not walk.finished:
        # Newton takes its reference levels from the first step: it has to see that one again.
        t.value = first
        _predict(newton)
        newton.recall(saved.control["newton"])
        newton.tangent.kept.renew()
    path.steps += [Step(*step) for step in saved.steps]
    path.refused, path.seconds = saved.control["refused"], saved.control["seconds"]
    path.resumed = path.load
    path.u.x.array[:] = saved.states[0]
    t.value = path.load
    return [_State(*s) for s in zip(saved.states, saved.control["places"], strict=True)]


def _extrapolate(problem: Problem, past: Sequence[_State], to: float, bent: float) -> None:
    """Move u on along the curve through the last states, if the energy stays finite there.

    Along the parabola through three of them where it bends little, else along the line through two.
    """
    u, last = problem.u.x.array, past[0].values
    guesses = [_through(past[:count], to) for count in range(2, len(past) + 1)]
    if len(guesses) == 2:
        line, curve = guesses
        dofmap = problem.u.function_space.dofmap
        owned = slice(dofmap.index_map.size_local * dofmap.bs)
        squares = [float(d @ d) for d in ((curve - line)[owned], (line - last)[owned])]
        bend, way = problem.comm.allreduce(np.array(squares))
        if bend > bent**2 * way:
            guesses.pop()
    for guess in reversed(guesses):
        u[:] = guess
        if not problem.has_energy or np.isfinite(problem.energy()):
            return
    u[:] = last


def _through(states: Sequence[_State], to: float) -> np.ndarray:
    """Value at a place of the polynomial through states (Lagrange)."""
    places = [s.done for s in states]
    result = np.zeros_like(states[0].values)
    for state in states:
        others = [place for place in places if place != state.done]
        weight = np.prod([(to - place) / (state.done - place) for place in others])
        result += weight * state.values
    return result
