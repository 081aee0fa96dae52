# SPDX-License-Identifier: MIT
"""Preconditioner of displacement-pressure problems: multigrid and a scaled pressure mass matrix."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from numpy.typing import NDArray

from ...compilation import compiled
from ...problems import Problem
from .order import OrderMultigrid

LEAST = 1e-8  # of the mean, of the weights of the pressure's mass matrix


class FieldSplit:
    """Block triangular preconditioner of a tangent [[K, B^T], [B, -C]].

    p = -S^-1 g,  u = M(f - B^T p),  S = C + W^(1/2) M_p W^(1/2),  w_i = (B diag(K)^-1 B^T)_ii / m_i

    M is one cycle of :class:`forms.solving.linear.order.OrderMultigrid` for K, S^-1 one symmetric
    Gauss-Seidel sweep, and M_p the pressure's mass matrix with the diagonal m. The Schur complement
    C + B K^-1 B^T is spectrally equivalent to S, with 1/mu as the weight of the mass matrix. The
    weights w are 1/mu up to a factor near 1 that depends on the element, so that no modulus has to
    be known, and where the stiffness differs from place to place, they do. C = M_p / kappa, or 0 of
    an incompressible body.

    A PETSc shell and not PCFIELDSPLIT: that one has its blocks behind its first set-up only, and
    either keeps all of them or none, while here the coarse operators alone are kept.

    Args:
        problem: Problem whose unknown is a displacement of degree 2 or more and a scalar.
        ksp: Solver whose preconditioner this is.
        prefix: Prefix of options; those for the pressure's sweep begin with ``pressure_``.
    """

    def __init__(self, problem: Problem, ksp: PETSc.KSP, prefix: str) -> None:
        W = problem.u.function_space
        self._comm, self._prefix = W.mesh.comm, prefix
        moves = problem.displacement
        assert moves is not None
        (other,) = (f for f in problem.fields.values() if f is not moves)
        (self._V, numbers), (self._Q, pressures) = moves.collapsed, other.collapsed
        owned = self._V.dofmap.index_map.size_local * self._V.dofmap.bs
        # Index sets have to be sorted, and the numbers in collapsed spaces are others.
        self._order = np.argsort(numbers[:owned])
        self._u = numbers[:owned][self._order]
        owned = self._Q.dofmap.index_map.size_local
        self._rank = np.argsort(np.argsort(pressures[:owned]))
        self._p = np.sort(pressures[:owned])
        self._problem = problem
        first = W.dofmap.index_map.local_range[0]
        self._sets = [
            PETSc.IS().createGeneral((own + first).astype(PETSc.IntType), comm=self._comm)
            for own in (self._u, self._p)
        ]
        self._levels: OrderMultigrid | None = None
        self._solvers = [PETSc.KSP().create(self._comm) for _ in range(2)]
        pc = ksp.getPC()
        pc.setType("python")
        pc.setPythonContext(_Shell(self))

    def update(self, A: PETSc.Mat, coarse: bool) -> None:
        """Take the blocks of a tangent, its coarse operator too if it is to be. Collective."""
        u, p = self._sets
        if self._levels is None:
            self.K, self.B = A.createSubMatrix(u, u), A.createSubMatrix(p, u)
            self.C = A.createSubMatrix(p, p)
            self._begin()
        else:
            A.createSubMatrix(u, u, submat=self.K)
            A.createSubMatrix(p, u, submat=self.B)
            A.createSubMatrix(p, p, submat=self.C)
        self._update_schur()
        if coarse and self._levels is not None:
            self._levels.update(self.K)

    def apply(self, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Solve for the pressure, then for the displacement. Collective."""
        below, above = self._solvers
        self._g.array[:] = x.array_r[self._p]
        below.solve(self._g, self._dp)
        self._dp.scale(-1)
        self.B.multTranspose(self._dp, self._f)
        self._f.array[:] = x.array_r[self._u] - self._f.array_r
        above.solve(self._f, self._du)
        y.array[self._u] = self._du.array_r
        y.array[self._p] = self._dp.array_r

    def destroy(self) -> None:
        """Free the matrices and solvers."""
        for item in (*self._solvers, *self._sets):
            item.destroy()
        if self._levels is not None:
            self._levels.destroy()
            vectors = (self._m, self._g, self._dp, self._du, self._f)
            for item in (self.K, self.B, self.C, self.S, self._mass, *vectors):
                item.destroy()

    def _begin(self) -> None:
        """Make the solvers of the blocks, once these are known."""
        self._mass = self._mass_matrix()
        self._m = self._mass.getDiagonal()
        # Room for both: on some ranks one of them reaches a column that the other does not.
        self.S = self.C.copy()
        self.S.axpy(1, self._mass, structure=PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
        self._g, self._dp = self._m.duplicate(), self._m.duplicate()
        self._du, self._f = self.K.createVecRight(), self.K.createVecRight()
        below, above = self._solvers
        for solver, matrix in ((below, self.S), (above, self.K)):
            solver.setType("preonly")
            solver.setOperators(matrix)
        below.getPC().setType("sor")
        below.setOptionsPrefix(f"{self._prefix}pressure_")
        below.setFromOptions()
        self._levels = OrderMultigrid(
            self._V,
            self._problem,
            above,
            self._prefix,
            added=False,
            order=self._order,
            rows=self._u.astype(np.int32),
        )

    def _mass_matrix(self) -> PETSc.Mat:
        """The pressure's mass matrix, numbered as the block is."""
        number = fem.Function(self._Q)
        first = self._Q.dofmap.index_map.local_range[0]
        number.x.array[: len(self._rank)] = self._rank + first
        number.x.scatter_forward()
        numbers = np.rint(number.x.array).astype(PETSc.IntType)
        mapping = PETSc.LGMap().create(numbers, comm=self._comm)
        M = self.C.duplicate()
        M.setLGMap(mapping, mapping)
        p, q = ufl.TrialFunction(self._Q), ufl.TestFunction(self._Q)
        # mypy sees the first of two overloads only.
        fem_petsc.assemble_matrix(M, compiled(p * q * ufl.dx))  # type: ignore[arg-type]
        M.assemble()
        return M

    def _update_schur(self) -> None:
        stiffness = self.K.getDiagonal()
        stiffness.sqrtabs()
        stiffness.reciprocal()
        scaled = self.B.copy()
        scaled.diagonalScale(None, stiffness)
        weight = self._m.duplicate()
        weight.array[:] = _squares(scaled)
        weight.pointwiseDivide(weight, self._m)
        # A node of the pressure among supported ones has no weight of its own.
        least = LEAST * weight.sum() / weight.getSize()
        weight.array[:] = np.sqrt(np.maximum(weight.array_r, least))
        self._mass.copy(self.S)
        self.S.diagonalScale(weight, weight)
        self.S.axpy(-1, self.C, structure=PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN)
        for item in (stiffness, scaled, weight):
            item.destroy()


class _Shell:
    """What PETSc calls; it would also call a method destroy, with an argument."""

    def __init__(self, blocks: FieldSplit) -> None:
        self._blocks = blocks

    def apply(self, pc: PETSc.PC, x: PETSc.Vec, y: PETSc.Vec) -> None:
        self._blocks.apply(x, y)


def _squares(A: PETSc.Mat) -> NDArray[np.float64]:
    """Sum of the squares of each owned row."""
    pointers, _, values = A.getValuesCSR()
    rows = np.repeat(np.arange(len(pointers) - 1), np.diff(pointers))
    sums = np.zeros(len(pointers) - 1)
    np.add.at(sums, rows, values**2)
    return sums
