# SPDX-License-Identifier: MIT
"""Products with the tangent that need no assembled tangent."""

from __future__ import annotations

import time

from petsc4py import PETSc

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc

from ...compilation import compiled
from ...problems import Problem

# Products without a matrix, over those with it, that still pay: assembling a tangent costs some 20
# of the latter, and a solve takes about as many.
DEAREST = 2.0


class Action:
    """K x cell by cell: by the moduli at the points, else by the residual's derivative along x.

    From degree 2 on it costs as much as a product with the assembled matrix or less, by moduli
    less than half, and saves assembling one at each iteration; supported rows and columns are
    those of identity. Moduli are those of the state of the last :meth:`update`.

    Args:
        problem: Problem whose tangent it is.
        A: Matrix for the assembled tangent.

    Attributes:
        matrix: PETSc matrix that does nothing but multiply.
        assembled: Whether A holds the present tangent, damped or projected as it may be: the
            product is then with A.
    """

    def __init__(self, problem: Problem, A: PETSc.Mat) -> None:
        self.assembled, self._problem, self._A = True, problem, A
        V = problem.u.function_space
        self._x = fem.Function(V)
        self._moduli = moduli = problem.forms.moduli
        without = problem.forms.tangent_ufl if moduli is None else moduli.rest_ufl
        self._form = None if without is None else compiled(ufl.action(without, self._x))
        held = [bc.dof_indices()[0] for bc in problem.conditions]
        self._held = np.unique(np.concatenate([*held, np.empty(0, np.int32)]).astype(np.int32))
        self._y = problem.create_vector()
        self.matrix = PETSc.Mat().createPython(A.getSizes(), _Shell(self), comm=A.comm)
        self.matrix.setBlockSize(A.getBlockSize())
        self.matrix.setOption(PETSc.Mat.Option.SYMMETRIC, problem.symmetric)
        self.matrix.setUp()

    def pays(self) -> bool:
        """Whether it is worth while on this CPU: by moduli as measured, else always. Collective."""
        if self._moduli is None:
            return True
        A, x = self._A.getDiagonalBlock(), self._A.getDiagonalBlock().createVecRight()
        y = x.duplicate()

        def mult() -> float:
            start = time.perf_counter()
            A.mult(x, y)
            return time.perf_counter() - start

        ratio = self._moduli.seconds_over(mult, self._problem.comm)
        for vector in (x, y):
            vector.destroy()
        return ratio <= DEAREST

    def update(self) -> None:
        """Take the present state for that of products. Local."""
        if self._moduli is not None:
            self._moduli.fill()

    def mult(self, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Put K x, K at the problem's u, into y. Collective."""
        if self.assembled:
            self._A.mult(x, y)
            return
        ours = self._x.x.petsc_vec
        x.copy(ours)
        ours.ghostUpdate(addv=PETSc.InsertMode.INSERT, mode=PETSc.ScatterMode.FORWARD)
        self._x.x.array[self._held] = 0
        slants = self._problem.slants
        if slants is not None:
            slants.clear(self._x.x.array)
        with self._y.localForm() as local:
            local.set(0)
            if self._moduli is not None:
                self._moduli.multiply(self._x.x.array, local.array)
        if self._form is not None:
            fem_petsc.assemble_vector(self._y, self._form)
        self._y.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        y.array[:] = self._y.array_r
        y.array[self._problem.constrained] = x.array_r[self._problem.constrained]
        if slants is not None:
            slants.mix(x.array_r, y.array)

    def destroy(self) -> None:
        """Free the matrix, which refers to this one."""
        self.matrix.destroy()
        self._y.destroy()


class _Shell:
    """What PETSc calls; it would also call a method destroy, with an argument."""

    def __init__(self, action: Action) -> None:
        self._action = action

    def mult(self, matrix: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        self._action.mult(x, y)
