# SPDX-License-Identifier: MIT
"""Damping of Newton steps where the tangent is singular: flat sheets, slack cloth, loose parts."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import ufl
from dolfinx.fem import petsc as fem_petsc
from numpy.typing import NDArray

from ..compilation import compiled
from ..problems import Problem
from .linear.diagonal import typical_diagonal
from .settings import Settings


class Damping:
    """Levenberg-Marquardt: s L is added to the tangent, L the stiffness of a uniform tension.

    L = c int grad v : grad du dx,  c such that typical entries of L and of the tangent are equal,
    field by field

    Where the tangent has no stiffness at all, as a flat sheet across its plane, the step is that
    of a prestretched sheet, which is smooth on every mesh. s falls after each full step and
    grows after one that the line search had to shorten, by as much as it was shortened (up to a
    limit), so that full steps come back.

    Args:
        problem: Displacement problem.
        A: Assembled tangent to be compared with.
        free: Local numbers of the degrees of freedom that are compared.
        settings: Numbers that it is tuned by.
        otherwise: Stiffness [N/m] to be compared with where all diagonal entries of A are 0.
    """

    def __init__(
        self,
        problem: Problem,
        A: PETSc.Mat,
        free: NDArray[np.int32],
        settings: Settings,
        otherwise: float = 1.0,
    ) -> None:
        self._settings = settings
        V = problem.u.function_space
        du, v = ufl.TrialFunction(V), ufl.TestFunction(V)
        uniform = compiled(ufl.inner(ufl.grad(du), ufl.grad(v)) * ufl.dx)
        self.L = fem_petsc.assemble_matrix(uniform, problem.conditions)
        self.L.assemble()
        diagonal = self.L.getDiagonal()
        diagonal.array[problem.constrained] = 0
        self.L.setDiagonal(diagonal)
        if problem.slants is not None:
            problem.slants.apply(self.L, 0.0)
        self._balance(problem)
        # A potential on a part of the mesh only has fewer entries than L.
        same = _entries(A) == _entries(self.L)
        kinds = PETSc.Mat.Structure
        self._structure = kinds.SUBSET_NONZERO_PATTERN if same else kinds.DIFFERENT_NONZERO_PATTERN
        own = typical_diagonal(self.L, free)
        stiffness = typical_diagonal(A, free) or otherwise
        self.scale = stiffness / own if own else 0.0
        self.strength = self._settings.damping[0]

    def _balance(self, problem: Problem) -> None:
        """Scale the other fields' stiffness like the first one's, as the tangent is scaled."""
        fields = list(problem.fields.values())
        if len(fields) == 1:
            return
        scale = self.L.createVecRight()
        scale.set(1.0)
        free = [np.setdiff1d(field.dofs, problem.constrained) for field in fields]
        typical = [typical_diagonal(self.L, rows) for rows in free]
        for rows, own in zip(free[1:], typical[1:], strict=True):
            scale.array[rows] = np.sqrt(typical[0] / own) if own > 0 else 1.0
        self.L.diagonalScale(scale, scale)
        scale.destroy()

    def restart(self) -> None:
        """Return to the first strength."""
        self.strength = self._settings.damping[0]

    def add(self, A: PETSc.Mat) -> None:
        """Add the damping to a tangent. Collective."""
        A.axpy(self.strength * self.scale, self.L, self._structure)

    def after(self, fraction: float) -> None:
        """Adapt the strength to the fraction of the last step that the line search took."""
        _, least, most = self._settings.damping
        if fraction >= 0.99:
            self.strength = max(self.strength / self._settings.eased, least)
        elif fraction < 0.3:
            grown = min(1 / max(fraction, 1e-300), self._settings.stiffened)
            self.strength = min(self.strength * grown, most)

    def stiffen(self) -> bool:
        """Grow after a step that does not lower the energy; False where that is no use."""
        first, _, most = self._settings.damping
        grown = self.strength < most
        self.strength = min(max(self._settings.stiffened * self.strength, first), most)
        return grown

    def destroy(self) -> None:
        """Free the matrix."""
        self.L.destroy()


def _entries(A: PETSc.Mat) -> float:
    return float(A.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"])
