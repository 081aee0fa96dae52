# SPDX-License-Identifier: MIT
"""Bordered systems: one scalar unknown beside the field, one scalar equation beside equilibrium.

R(u, q) = 0,  g(u, q) = G

A pressure q that holds a volume G, a load factor that holds a displacement. Two solves with the
factors of K, the tangent of u, solve the bordered system [[K, R_q], [g_u, g_q]], which is regular
at a limit point too. Where K has no stiffness in some direction, as a flat sheet, it is damped.
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
from .damping import Damping
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
        functional: What is prescribed, a functional of u, as :func:`forms.enclosed_volume`, and
            perhaps of q: ``q * enclosed_volume(u)`` is an enclosed ideal gas, p V = n R T.
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
        g_q = _by_constant(functional, q)
        self.g_q = None if g_q.empty() else compiled(g_q)
        self.A, self.b = self.system.create_matrix(), self.system.create_vector()
        self.work = [self.b.duplicate() for _ in range(5)]
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
        self.damping: Damping | None = None

    def value(self) -> float:
        """The functional at u."""
        self.system.update_dependents()
        return self._integral(self.g)

    def _integral(self, form: fem.Form) -> float:
        return float(self.system.comm.allreduce(fem.assemble_scalar(form)))

    def solve(self, target: float) -> Convergence:
        """Newton iterations from present values; u and q are left at the last ones."""
        R, R_q = self.work[:2]
        scale = abs(target) or abs(target - self.start)
        if self.damping is not None:
            self.damping.restart()
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
            # A flat sheet's K is singular, and MUMPS need not notice.
            dq = self._step(off, damped=iteration == 0)
            if dq is None:
                reason = "the linear solver failed"
                break
            correction = self._move(dq)
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

    def _step(self, off: float, damped: bool) -> float | None:
        """Change of q, and of u in du, with g + dg = 0; None if no solve succeeds.

        u changes by -(K^-1 R + dq K^-1 R_q), so dg = -g_u . K^-1 R + dq (g_q - g_u . K^-1 R_q).

        Where K is singular, which a step longer than the model shows too, the damping grows.
        """
        R, R_q, du, du_q, g_u = self.work
        self._assemble(self.g_u, g_u)
        g_q = self._integral(self.g_q) if self.g_q is not None else 0.0
        while True:
            self.system.tangent(self.A)
            if damped:
                self._damp()
            self.ksp.setOperators(self.A)
            self.ksp.solve(R, du)
            if self.ksp.getConvergedReason() > 0:
                self.ksp.solve(R_q, du_q)
                dq = (off - g_u.dot(du)) / (g_u.dot(du_q) - g_q)
                du.axpy(dq, du_q)
                if du.norm(PETSc.NormType.INFINITY) <= self.size:
                    return float(dq)
            self.ksp.reset()  # MUMPS does not forget a failure
            if damped and self.damping is not None and not self.damping.stiffen():
                return None
            damped = True

    def _damp(self) -> None:
        """Add the damping to the tangent, made at its first use."""
        if self.damping is None:
            free = np.setdiff1d(np.arange(self.b.local_size), self.system.constrained)
            self.damping = Damping(self.system, self.A, free)
        self.damping.add(self.A)

    def _move(self, dq: float) -> float:
        """Change u by -du and q by dq; largest change of u."""
        du = self.work[2]
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
        if self.damping is not None:
            self.damping.destroy()
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
