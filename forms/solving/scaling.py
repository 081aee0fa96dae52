# SPDX-License-Identifier: MIT
"""A problem in one unit: fields of mixed unknowns scaled, so that every equation is a force."""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from numpy.typing import NDArray

from .._parallel import bounding_box
from ..problems import Problem
from ..unknowns import Field
from .linear.diagonal import has_positive, typical_diagonal

EPS = float(np.finfo(float).eps)


class Scaled:
    """Residual and tangent of a problem in y, where u = D y: D R and D K D.

    D is 1 for displacements and s = typical K_ii / h^(d - 1) [Pa] for pressures and multipliers, h
    a typical cell's size; of a field that is minimized over it makes the typical entry of its own
    block that of the displacements: all entries of the residual are then forces [N] and those of
    the tangent stiffnesses, in any units.

    Args:
        problem: What is scaled.
        A: Matrix for the problem's tangent, in which the stiffness is measured at the start.

    Attributes:
        size: Diagonal of the mesh's bounding box [m].
        displacements: Owned local numbers of displacement components.
        free: Those of them that are not supported.
        others: Owned local numbers of all other fields.
        rounding: Error of the forces [N], eps * typical K_ii * size * sqrt(n); 0 until measured.
            It is the body's; :meth:`floor` adds that of stiff springs.
    """

    def __init__(self, problem: Problem, A: PETSc.Mat) -> None:
        self.problem, self.A = problem, A
        self.size = self._size()
        moves = problem.displacement or next(iter(problem.fields.values()))
        self.displacements = moves.dofs
        self.others = np.setdiff1d(np.arange(A.getLocalSize()[0]), self.displacements)
        self._beside = [field for field in problem.fields.values() if field is not moves]
        self.free = np.setdiff1d(self.displacements, problem.constrained)
        self.D = problem.create_vector()
        self.D.set(1)
        self.mixed = bool(self._beside)
        self.rounding = 0.0
        self._stiffness = np.empty(0)
        self._minimized: list[NDArray[np.int32]] = []

    def begin(self) -> None:
        """Measure anew at the next state. Collective."""
        self.D.set(1)
        self.rounding, self.size = 0.0, self._size()

    def _size(self) -> float:
        mesh = self.problem.u.function_space.mesh
        low, high = bounding_box(self.problem.comm, mesh.geometry.x)
        return float(np.linalg.norm(high - low))

    def measure(self) -> None:
        """Find the forces' rounding error, and the scale of a pressure, at u. Collective."""
        problem = self.problem
        problem.tangent(self.A)
        diagonal = typical_diagonal(self.A, self.free)
        self.rounding = EPS * diagonal * self.size * np.sqrt(problem.size)
        self._stiffness = np.abs(self.A.getDiagonal().array_r[self.free])
        mesh = problem.u.function_space.mesh
        if diagonal > 0:
            dim = mesh.topology.dim
            h = self.size / mesh.topology.index_map(dim).size_global ** (1 / dim)
            self._minimized = [f.dofs for f in self._beside if self._is_minimized_over(f)]
            for field in self._beside:
                scale = diagonal / h ** (dim - 1)
                if self._is_minimized_over(field):
                    own = typical_diagonal(self.A, np.setdiff1d(field.dofs, problem.constrained))
                    scale = np.sqrt(diagonal / own) if own > 0 else 1.0
                self.D.array[field.dofs] = scale

    def _is_minimized_over(self, field: Field) -> bool:
        """Whether a field has stiffness of its own; collective where its role does not say."""
        if field.role.curvature == "?":
            return has_positive(self.A, np.setdiff1d(field.dofs, self.problem.constrained))
        return field.role.curvature == "+"

    def correction(self, x: PETSc.Vec, before: PETSc.Vec) -> float:
        """Largest change of a displacement [m] from one scaled state to another. Collective.

        Of other fields that are minimized over the change relative to the field's largest value
        counts, times the body's size, or the change itself, as the smaller one may be.
        """
        change = np.abs(x.array_r - before.array_r)
        largest = float(change[self.displacements].max(initial=0.0))
        largest = self.problem.comm.allreduce(largest, MPI.MAX)
        for dofs in self._minimized:
            values = np.abs(x.array_r[dofs]).max(initial=0.0), change[dofs].max(initial=0.0)
            level, moved = (self.problem.comm.allreduce(float(v), MPI.MAX) for v in values)
            relative = moved / level * self.size if level > 0 else np.inf
            largest = max(largest, min(moved, relative))
        return float(largest)

    def moved(self, values: NDArray[np.float64], before: NDArray[np.float64]) -> float:
        """Largest change of a displacement [m] from one state of the unknown to another.

        Collective.
        """
        change = np.abs(values[self.displacements] - before[self.displacements])
        return float(self.problem.comm.allreduce(float(change.max(initial=0.0)), MPI.MAX))

    def floor(self) -> float:
        """Error of the forces [N] at u: that of the body, or eps |K_ii u_i|, if it is larger.

        A stiff spring between u and a place that moves resists what u is rounded by. Collective.
        """
        own = self._stiffness * self.problem.u.x.array[self.free]
        with np.errstate(over="ignore", invalid="ignore"):
            springs = EPS * np.sqrt(self.problem.comm.allreduce(float(own @ own)))
        return max(self.rounding, float(springs)) if np.isfinite(springs) else self.rounding

    def unknowable(self) -> float:
        """Forces [N] that rounding may make at rest, by the stiffest of all entries. Collective.

        A flat sheet's typical entry is as small as rounding itself.
        """
        own = float(self._stiffness.max(initial=0.0))
        return 1e3 * EPS * self.problem.comm.allreduce(own, MPI.MAX) * self.size

    def residual(self, b: PETSc.Vec) -> float:
        """Assemble the forces at free degrees of freedom into b; norm of those at supports [N]."""
        self.problem.residual(b)
        return self._scaled(b)

    def energy_and_residual(self, b: PETSc.Vec) -> tuple[float, float]:
        """Energy [J], and what :meth:`residual` returns. Collective."""
        energy = self.problem.energy_and_residual(b)
        return energy, self._scaled(b)

    def _scaled(self, b: PETSc.Vec) -> float:
        """Leave out the forces at supports, of which the norm is returned."""
        b.pointwiseMult(b, self.D)
        held = self.problem.held_part(b.array_r)
        # A trial state may be so far off that its forces overflow; it is refused as not finite.
        with np.errstate(over="ignore", invalid="ignore"):
            reactions = np.sqrt(self.problem.comm.allreduce(float(held @ held)))
        self.problem.clear(b.array)
        return float(reactions)

    def tangent(self, projected: bool = False) -> None:
        """Assemble the tangent into A. Collective."""
        self.problem.tangent(self.A, projected)
        if self.mixed:
            self.A.diagonalScale(self.D, self.D)

    def is_finite(self) -> bool:
        """Whether the assembled tangent is finite: its diagonal, which no cell spares. Collective.

        A derivative that is not finite spoils all entries of its cell's matrix, the diagonal too.
        """
        diagonal = self.A.getDiagonal()
        finite = bool(np.all(np.isfinite(diagonal.array_r)))
        diagonal.destroy()
        return bool(self.problem.comm.allreduce(finite, MPI.LAND))

    def prescribe(self, y: PETSc.Vec) -> None:
        """Put the prescribed values, scaled, into a state; local."""
        held = self.problem.constrained
        self.problem.prescribe(y)
        y.array[held] = y.array_r[held] / self.D.array_r[held]

    def put(self, y: PETSc.Vec) -> None:
        """Copy D y into the unknown, ghosts included."""
        target = self.problem.u.x.petsc_vec
        target.pointwiseMult(y, self.D)
        target.ghostUpdate(addv=PETSc.InsertMode.INSERT, mode=PETSc.ScatterMode.FORWARD)

    def get(self, y: PETSc.Vec) -> None:
        """Copy the unknown into y."""
        y.pointwiseDivide(self.problem.u.x.petsc_vec, self.D)

    def destroy(self) -> None:
        """Free the scale."""
        self.D.destroy()
