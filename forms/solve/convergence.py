# SPDX-License-Identifier: MIT
"""How a nonlinear solve ended, in numbers and in words."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from typing import Any

USUAL = {"full tangent", "|R|"}

REASONS = {
    -1: "the energy is not finite at the start",
    -3: "the linear solver failed",
    -4: "the residual is not finite",
    -5: "the iterations were used up",
    -6: "the line search found no lower value",
    -8: "a local minimum of the residual was reached",
    -9: "the residual grew too large",
    -11: "the trust region became too small",
    -14: "the energy is not finite",  # a code later than PETSc 3.22
}


class NotConverged(RuntimeError):
    """A solve that did not reach its tolerances; the unknown holds the last converged state."""

    path: Any = None


@dataclass(frozen=True)
class Convergence:
    """How a Newton solve ended.

    Attributes:
        converged: Whether both tolerances were reached.
        reason: Why it stopped, in words.
        code: PETSc's SNESConvergedReason.
        iterations: Newton iterations.
        projected: Those of them that used the projected tangent.
        linear_iterations: Iterations of the linear solver in all.
        residual: Norm of the out-of-balance forces at free degrees of freedom [N].
        force_level: Force [N] that the residual is compared with.
        correction: Largest last change of a displacement component [m].
        residuals: Norm of the out-of-balance forces at the start and after each iteration [N].
        negative: Negative eigenvalues of the last tangent that was factorized, 0 where the state
            is stable; None where it is not known (multigrid, LU, projected, damped tangents).
        tried: Ways that were taken in turn, the last one to this end, as "full tangent", "|R|".
        advice: What to do where the cause is known; empty where it is not.
        solver: Whose iterations these are, in words.
    """

    converged: bool
    reason: str
    code: int
    iterations: int
    projected: int
    linear_iterations: int
    residual: float
    force_level: float
    correction: float
    residuals: tuple[float, ...] = ()
    negative: int | None = None
    tried: tuple[str, ...] = ()
    advice: str = ""
    solver: str = "SNES"

    def sentence(self) -> str:
        """One sentence: outcome, iterations, norms."""
        verb = "converged" if self.converged else "stopped"
        projected = f", {self.projected} of them projected" if self.projected else ""
        unusual = set(self.tried) - USUAL
        ways = f" by way of {', '.join(dict.fromkeys(self.tried))}" if unusual else ""
        # There is no last correction where no iteration was made.
        last = f", last correction {self.correction:.1e}" if isfinite(self.correction) else ""
        return (
            f"{self.solver} {verb} after {self.iterations} iterations{projected}{ways} "
            f"({self.reason}), |R| = {self.residual:.1e} at a force level of "
            f"{self.force_level:.1e}{last}"
        )
