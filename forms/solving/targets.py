# SPDX-License-Identifier: MIT
"""Equilibrium while a functional of u goes through given values: volume or displacement control."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from petsc4py import PETSc

import ufl
from dolfinx import fem

from ..compilation import compiled
from ..paths import Path, Step, check_record, recorded
from ..problems import Problem
from ..quadrature import with_quadrature
from ..supports import Support
from ..variation import residual
from .bordered import Bordered, by_constant
from .progress import bar_of
from .supported import failure

MAX_HALVINGS = 8


def control(
    potential: ufl.Form,
    u: fem.Function,
    supports: Iterable[Support],
    q: fem.Constant,
    functional: ufl.Form,
    targets: Sequence[float],
    *,
    virtual_work: ufl.Form | None = None,
    rtol: float = 1e-8,
    ctol: float = 1e-6,
    max_iterations: int = 30,
    record: Mapping[str, Callable[[Problem], Any]] | None = None,
    on_step: Callable[[Path], None] | None = None,
    progress: bool = True,
) -> Path:
    """Follow equilibrium while a functional of u goes through given values. Collective.

    The constant q, a pressure or a load factor in the potential, is found along: past the limit
    point, where no larger q has an equilibrium, it falls again. A target that fails is approached
    in halved steps.

    Args:
        potential: Total potential [J] of u that contains q.
        u: Unknown, starting from its present values, in equilibrium or near it.
        supports: Prescribed displacements.
        q: Scalar unknown; its value is the first guess.
        functional: What is prescribed, a functional of u, as :func:`forms.enclosed_volume`, and
            perhaps of q: ``q * enclosed_volume(u)`` is an enclosed ideal gas, p V = n R T.
        targets: Its values, one step each.
        virtual_work: Linear form added to the residual, for loads without a potential.
        rtol: Tolerance of |R_free| relative to the force level, and of the functional relative to
            its target (or to its change from the start, where the target is 0).
        ctol: Tolerance of the last correction relative to the model's size.
        max_iterations: Newton iterations per step.
        record: Functions of the problem, evaluated after each step.
        on_step: Called with the path after each step.
        progress: Show a progress bar on rank 0.

    Returns:
        Path; ``load`` of each step is q, and its records hold "target".

    Raises:
        NotConverged: a step failed at MAX_HALVINGS halvings; u and q hold the last state.
        ValueError: the potential does not contain q, or the functional does not depend on u.
    """
    check_record(record)
    bordered = Bordered(potential, u, supports, q, virtual_work, rtol, ctol, max_iterations)
    held = _Held(bordered, functional)
    path, start = Path(u, bordered.problem, begin=bordered.load), time.perf_counter()
    reached = held.measure()
    before, load = u.x.array.copy(), bordered.load
    bar = bar_of("control", len(targets), bordered.problem.comm, progress)
    try:
        for target in map(float, targets):
            part, halvings = 1.0, 0
            while reached != target:
                held.aim = target if part == 1 else reached + part * (target - reached)
                outcome = bordered.solve(held)
                if outcome.converged:
                    before, load, reached, part = u.x.array.copy(), bordered.load, held.aim, 1.0
                    continue
                path.refused += 1
                u.x.array[:], q.value = before, load
                part, halvings = part / 2, halvings + 1
                if halvings > MAX_HALVINGS:
                    raise failure(
                        path,
                        f"{outcome.sentence()}, on the way to {target:.6g} from {reached:.6g}. The "
                        "last converged state is kept.",
                        outcome.advice or "Give targets that lie closer.",
                    )
            notes = recorded(record, bordered.problem)
            path.steps.append(Step(load, outcome, {"target": target, **notes}))
            bar.update()
            bar.set_postfix_str(f"q = {load:.4g}, {outcome.iterations} iterations")
            if on_step is not None:
                on_step(path)
    finally:
        u.x.array[:], q.value = before, load
        bordered.problem.prepare()
        bordered.destroy()
        bar.close()
        path.seconds = time.perf_counter() - start
    path.end(f"All {len(path.steps)} targets reached")
    return path


class _Held:
    """The constraint functional(u, q) = aim."""

    def __init__(self, bordered: Bordered, functional: ufl.Form) -> None:
        self.bordered = bordered
        functional = with_quadrature(functional, bordered.degree)
        self._g = compiled(functional)
        self._g_u = compiled(residual(functional, bordered.problem.u))
        g_q = by_constant(functional, bordered.q)
        self._g_q = None if g_q.empty() else compiled(g_q)
        self.start = self.aim = self.measure()

    def measure(self) -> float:
        """The functional at the present state."""
        return self.bordered.integral(self._g)

    @property
    def scale(self) -> float:
        return abs(self.aim) or abs(self.aim - self.start)

    def value(self) -> float:
        return self.measure() - self.aim

    def gradient(self, g_u: PETSc.Vec) -> float:
        self.bordered.assemble(self._g_u, g_u)
        return self.bordered.integral(self._g_q) if self._g_q is not None else 0.0
