# SPDX-License-Identifier: MIT
"""Bordered systems: one scalar unknown beside the field, one scalar equation beside equilibrium.

R(u, q) = 0,  g(u) = G

A pressure q that holds a volume G, a load factor that holds a displacement. The tangent K of u may
be singular, as it is at a limit point; the bordered one [[K, R_q], [g_u, 0]] is regular there. Two
solves with the factors of K solve it.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from petsc4py import PETSc

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from tqdm import tqdm
from ufl.algorithms import expand_derivatives
from ufl.algorithms.analysis import extract_constants

from .._parallel import bounding_box
from ..assembly import System, system, with_quadrature
from ..operators.chain import dependents, expanded
from ..operators.jets import Jet
from ..operators.lowering import compiled
from ..supports import Support
from ..variation import residual
from . import linear
from .continuation import Path, Step
from .newton import Convergence, NotConverged

MAX_HALVINGS = 8
PREFIX = "variform_bordered_"


def control(
    potential: ufl.Form,
    u: fem.Function,
    supports: Iterable[Support],
    q: fem.Constant,
    functional: ufl.Form,
    targets: Sequence[float],
    *,
    rtol: float = 1e-8,
    ctol: float = 1e-6,
    max_iterations: int = 30,
    record: Mapping[str, Callable[[System], Any]] | None = None,
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
        functional: What is prescribed, a functional of u, as :func:`forms.enclosed_volume`.
        targets: Its values, one step each.
        rtol: Tolerance of |R_free| relative to the force level, and of the functional relative to
            its target (or to its change from the start, where the target is 0).
        ctol: Tolerance of the last correction relative to the model's size.
        max_iterations: Newton iterations per step.
        record: Functions of the system, evaluated after each step.
        on_step: Called with the path after each step.
        progress: Show a progress bar on rank 0.

    Returns:
        Path; ``load`` of each step is q, and its records hold "target".

    Raises:
        NotConverged: a step failed at MAX_HALVINGS halvings; u and q hold the last state.
        ValueError: the potential does not contain q, or the functional does not depend on u.
    """
    problem = _Bordered(potential, u, supports, q, functional, rtol, ctol, max_iterations)
    path, start = Path(u, problem.system), time.perf_counter()
    reached = problem.value()
    before, load = u.x.array.copy(), float(q.value)
    bar = tqdm(
        total=len(targets),
        desc="control",
        bar_format="{desc} {n_fmt}/{total_fmt} {elapsed}{postfix}",
        file=sys.stderr,
        disable=not progress or problem.system.comm.rank != 0,
    )
    try:
        for target in map(float, targets):
            part, halvings = 1.0, 0
            while reached != target:
                aim = target if part == 1 else reached + part * (target - reached)
                outcome = problem.solve(aim)
                if outcome.converged:
                    before, load, reached, part = u.x.array.copy(), float(q.value), aim, 1.0
                    continue
                path.refused += 1
                u.x.array[:], q.value = before, load
                part, halvings = part / 2, halvings + 1
                if halvings > MAX_HALVINGS:
                    error = NotConverged(
                        f"{outcome.sentence()}, on the way to {target:.6g} from {reached:.6g}. The "
                        "last converged state is kept. Give targets that lie closer."
                    )
                    error.path, path.reason = path, str(error)
                    raise error
            notes = {name: f(problem.system) for name, f in (record or {}).items()}
            path.steps.append(Step(load, outcome, {"target": target, **notes}))
            bar.update()
            bar.set_postfix_str(f"q = {load:.4g}, {outcome.iterations} iterations")
            if on_step is not None:
                on_step(path)
    finally:
        u.x.array[:], q.value = before, load
        problem.system.update_dependents()
        problem.destroy()
        bar.close()
        path.seconds = time.perf_counter() - start
    path.completed = True
    path.reason = (
        f"All {len(path.steps)} targets reached ({path.refused} refused), "
        f"{sum(s.convergence.iterations for s in path.steps)} iterations."
    )
    return path


class _Bordered:
    """Newton's method for (u, q)."""

    def __init__(
        self,
        potential: ufl.Form,
        u: fem.Function,
        supports: Iterable[Support],
        q: fem.Constant,
        functional: ufl.Form,
        rtol: float,
        ctol: float,
        max_iterations: int,
    ) -> None:
        self.system = system(potential, u, supports)
        self.q, self.rtol, self.ctol, self.most = q, rtol, ctol, max_iterations
        if not isinstance(q, fem.Constant) or q.ufl_shape != ():
            raise ValueError(f"control needs a scalar Constant q, got {type(q).__name__}.")
        if q not in potential.constants():
            raise ValueError("the potential does not contain q: write a load with it.")
        degree = max(1, u.function_space.ufl_element().embedded_superdegree)
        functional = with_quadrature(functional, degree)
        R = with_quadrature(residual(potential, u), degree)
        self.g = compiled(functional)
        self.g_u = compiled(residual(functional, u))
        self.R_q = compiled(_by_constant(R, q))
        self.A, self.b = self.system.create_matrix(), self.system.create_vector()
        self.work = [self.b.duplicate() for _ in range(4)]
        self.ksp = PETSc.KSP().create(self.system.comm)
        self.ksp.setOptionsPrefix(PREFIX)
        options, preset = PETSc.Options(), linear.direct(self.system.symmetric)
        ours = [key for key in preset if not options.hasName(PREFIX + key)]
        for key in ours:
            options[PREFIX + key] = preset[key]
        self.ksp.setFromOptions()
        for key in ours:
            options.delValue(PREFIX + key)
        low, high = bounding_box(self.system.comm, u.function_space.mesh.geometry.x)
        self.size = float(np.linalg.norm(high - low))
        self.start = self.value()

    def value(self) -> float:
        """The functional at u."""
        self.system.update_dependents()
        return float(self.system.comm.allreduce(fem.assemble_scalar(self.g)))

    def solve(self, target: float) -> Convergence:
        """Newton iterations from present values; u and q are left at the last ones."""
        R, R_q, du, du_q = self.work
        scale = abs(target) or abs(target - self.start)
        correction, level, residuals = np.inf, 0.0, []
        reason, converged, iteration = "the iterations were used up", False, 0
        for iteration in range(self.most + 1):
            self.system.residual(self.b)
            held = self.b.array_r[self.system.constrained]
            reactions = np.sqrt(self.system.comm.allreduce(float(held @ held)))
            self._free(self.b, R)
            self._assemble(self.R_q, R_q)
            # The load itself, q R_q, is what the residual is the imbalance of.
            level = max(level, reactions, abs(float(self.q.value)) * R_q.norm())
            residuals.append(R.norm())
            off = self.value() - target
            if not np.isfinite(residuals[-1] + off):
                reason = "the state is not finite"
                break
            if residuals[-1] <= self.rtol * level and abs(off) <= self.rtol * scale:
                converged = correction <= self.ctol * self.size
                if converged:
                    reason = "both tolerances reached"
                    break
            if iteration == self.most:
                break
            self.system.tangent(self.A)
            self.ksp.setOperators(self.A)
            self.ksp.solve(R, du)
            self.ksp.solve(R_q, du_q)
            if self.ksp.getConvergedReason() < 0:
                reason = "the linear solver failed"
                break
            correction = self._move(off, R, du, du_q)
        return Convergence(
            converged=converged,
            reason=reason,
            code=2 if converged else -5,
            iterations=iteration,
            projected=0,
            linear_iterations=2 * iteration,
            residual=residuals[-1],
            force_level=level,
            correction=float(correction),
            residuals=tuple(residuals),
        )

    def _move(self, off: float, g_u: PETSc.Vec, du: PETSc.Vec, du_q: PETSc.Vec) -> float:
        """Change u by -(du + dq du_q), with g + g_u . change = 0, and q by dq; largest change."""
        self._assemble(self.g_u, g_u)
        dq = (off - g_u.dot(du)) / g_u.dot(du_q)
        du.axpy(dq, du_q)
        x = self.system.u.x.petsc_vec
        x.axpy(-1, du)
        x.ghostUpdate(addv=PETSc.InsertMode.INSERT, mode=PETSc.ScatterMode.FORWARD)
        self.q.value = float(self.q.value) + dq
        return float(du.norm(PETSc.NormType.INFINITY))

    def _assemble(self, form: fem.Form, b: PETSc.Vec) -> None:
        with self.b.localForm() as local:
            local.set(0)
        fem_petsc.assemble_vector(self.b, form)
        self.b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        self._free(self.b, b)

    def _free(self, source: PETSc.Vec, b: PETSc.Vec) -> None:
        source.copy(b)
        b.array[self.system.constrained] = 0

    def destroy(self) -> None:
        """Free the PETSc objects."""
        for item in (self.ksp, self.A, self.b, *self.work):
            item.destroy()


def _by_constant(form: ufl.Form, q: fem.Constant) -> ufl.Form:
    """Derivative of a form with respect to a scalar Constant."""
    form = expand_derivatives(expanded(form))
    if any(q in extract_constants(c.jets.packed) for c in dependents(form) if isinstance(c, Jet)):
        raise ValueError(
            "q stands inside the operand of an energy in singular values, whose derivative by it "
            "is not available: let q be a load or a pressure."
        )
    variable = ufl.variable(q)
    integrals = []
    for integral in form.integrals():
        seen = ufl.replace(integral.integrand(), {q: variable})
        slope = expand_derivatives(ufl.diff(seen, variable))
        if not isinstance(slope, ufl.classes.Zero):
            integrals.append(integral.reconstruct(integrand=slope))
    return ufl.Form(integrals)
