# SPDX-License-Identifier: MIT
"""The one loop of all paths: propose, solve, accept or refuse, record, save."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from tqdm import tqdm

from ..files.checkpoint import Archive, Saved
from ..paths import Convergence, Path, Step, recorded
from ..problems import Problem
from ..validity import Bounds
from .certificates import certified_clearance
from .progress import bar_of, watcher_of
from .supported import failure


class Control(Protocol):
    """Proposes states, takes or refuses them, and remembers the last one; all collective.

    Attributes:
        path: The path that it leads along.
        word: Of the progress bar; ``total`` its length, None where it is open.
        symbol: Of the load factor.
        why: Why the last state was refused, in words.
        bounds: Of the smallest volume ratio of the last accepted state, where they are known.
    """

    path: Path
    word: str
    total: float | None
    symbol: str
    why: str
    bounds: Bounds | None

    @property
    def load(self) -> float:
        """Load factor of the last accepted state."""

    @property
    def done(self) -> float:
        """How far along ``total`` the path has come."""

    @property
    def ended(self) -> str:
        """Why the path is at its end, in words; empty on the way."""

    def begin(self) -> None:
        """Find the first state, where it is not in equilibrium."""

    def propose(self) -> Convergence:
        """Move to the next state: predict and solve."""

    def accept(self, outcome: Convergence) -> tuple[Convergence, dict[str, Any]] | None:
        """Take the state of a solve that converged: how it was found, and notes for its step.

        None where it is on the way to a step, or is refused after all.
        """

    def watch(self, watcher: Callable[[float, float], None] | None) -> None:
        """Have a function called with |R| and its goal at each iteration."""

    def stepped(self) -> None:
        """The step is in the path: see whether that is at its end."""

    def refuse(self, outcome: Convergence) -> tuple[str, str]:
        """Put the last accepted state back and try less; sentence and advice where no less is."""

    def restore(self) -> None:
        """Put the last accepted state back."""

    def memory(self) -> tuple[Sequence[np.ndarray], dict[str, Any]]:
        """States and numbers that a checkpoint has to keep."""

    def saved(self) -> None:
        """A checkpoint was written: go on as the run that is taken up from it."""

    def resume(self, saved: Saved) -> None:
        """Go on from a checkpoint; the path has its steps already."""

    def release(self, sound: bool) -> None:
        """Give the solver back: kept if the path ended well."""


def advance(
    control: Control,
    record: Mapping[str, Callable[[Problem], Any]] | None,
    on_step: Callable[[Path], None] | None,
    archive: Archive | None,
    progress: bool,
) -> Path:
    """Lead a path to its end. Collective.

    Args:
        control: Who proposes the states.
        record: Functions of the problem, evaluated after each step and kept.
        on_step: Called with the path after each step.
        archive: Checkpoints; a path of an earlier run is taken up from them.
        progress: Whether a bar is shown on rank 0, and in the end how it went.

    Returns:
        The control's path, whatever it ended by noted in it.

    Raises:
        ValueError: checkpoints of a problem whose terms keep a state beside the unknown.
        NotConverged: no smaller step converges; the last accepted state is left behind, as it is
            after any other exception, Ctrl-C included.
    """
    path, start = control.path, time.perf_counter()
    bar = bar_of(control.word, control.total, path.problem.comm, progress)
    control.watch(watcher_of(bar, lambda: f"{control.symbol} = {control.load:.4g}"))

    def save(now: bool) -> None:
        path.seconds = time.perf_counter() - start
        if archive is not None and path.steps:
            states, numbers = control.memory()
            counts = {"refused": path.refused, "seconds": path.seconds}
            if archive.write(states, path.steps, {**numbers, **counts}, now):
                control.saved()

    try:
        if archive is not None and (kept := sorted(path.problem.history())):
            raise ValueError(
                f"a checkpoint holds the unknown only, and terms keep more, {', '.join(kept)}: "
                "lead this path without one."
            )
        control.begin()
        if archive is not None and (saved := archive.read()) is not None:
            path.take_up(saved.steps, saved.control)
            control.resume(saved)
            start -= path.seconds
            bar.update(control.done)
            where = "t =" if control.word == "motion" else "load factor"
            _say(bar, path, f"Resumed at {where} {control.load:.6g} from {archive.folder}.")
        while not control.ended:
            outcome = control.propose()
            refused = path.refused
            step = control.accept(outcome) if outcome.converged else None
            if step is not None:
                outcome, notes = step
                path.problem.commit()
                notes |= recorded(record, path.problem)
                clear = certified_clearance(path.problem)
                path.steps.append(Step(control.load, outcome, notes, control.bounds, clear))
                control.stepped()
                bar.update(control.done - bar.n)
                words = f"{control.symbol} = {control.load:.4g}, {outcome.iterations} iterations"
                bar.set_postfix_str(words)
                if on_step is not None:
                    on_step(path)
                save(now=bool(control.ended))
            elif not outcome.converged or path.refused > refused:
                path.refused = refused + 1
                sentence, advice = control.refuse(outcome)
                path.problem.rollback()
                if sentence:
                    save(now=True)
                    raise failure(path, sentence, advice)
                bar.set_postfix_str(f"a shorter step: {control.why}")
            else:  # a state on the way to a step
                path.problem.commit()
        path.end(control.ended)
        if progress:
            _say(bar, path, path.reason)
    except KeyboardInterrupt:
        if archive is not None and path.steps:
            _say(bar, path, f"Interrupted: the last checkpoint is in {archive.folder}.")
        raise
    finally:
        control.restore()
        control.watch(None)
        path.problem.rollback()
        control.release(bool(path.reason) and bool(control.ended))
        bar.close()
        path.seconds = time.perf_counter() - start
    return path


def _say(bar: tqdm, path: Path, sentence: str) -> None:
    if path.problem.comm.rank == 0:
        bar.write(sentence, sys.stderr)
