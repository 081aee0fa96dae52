# SPDX-License-Identifier: MIT
"""Multigrid over the order: elements of degree 2 and 3 smoothed, degree 1 below by aggregation."""

from __future__ import annotations

from collections.abc import Mapping

from petsc4py import PETSc

import basix.ufl
import numpy as np
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from numpy.typing import NDArray

from ..assembly import System
from . import linear

SLOWER = 3  # times the first solve's iterations, at which a preconditioner is built anew


class Kept:
    """When a multigrid preconditioner is built: once per load step, and again when it slows down.

    The smoothers always see the present tangent, and so do the blocks of a mixed unknown; what is
    kept are the coarser operators.

    Args:
        system: Problem that is solved.
        ksp: Solver with its options set.
        preset: Options in use that are the package's own; empty where the user chose.
        prefix: Prefix of the options.

    Attributes:
        used: Whether there is anything to keep.
        stale: Whether the last solve used a preconditioner of an earlier state.
    """

    def __init__(
        self, system: System, ksp: PETSc.KSP, preset: Mapping[str, str], prefix: str
    ) -> None:
        from .fieldsplit import FieldSplit  # which has a use for multigrid itself

        self.used = preset.get("ksp_type") in ("cg", "gmres")
        self._levels: OrderMultigrid | None = None
        self._blocks: FieldSplit | None = None
        kind = preset.get("pc_type") if self.used else None
        if kind == "mg":
            V = system.u.function_space
            self._levels = OrderMultigrid(V, system.constrained, ksp, prefix)
        elif kind == "python":
            self._blocks = FieldSplit(system, ksp, prefix)
        self._ksp, self.stale, self._due, self._first = ksp, False, True, 0

    def renew(self) -> None:
        """Build anew at the next tangent."""
        self._due = True

    def prepare(self, A: PETSc.Mat) -> None:
        """Build, or keep, the preconditioner for a tangent just assembled. Collective."""
        if not self.used:
            return
        self._ksp.getPC().setReusePreconditioner(not self._due)
        if self._due and self._levels is not None:
            self._levels.update(A)
        if self._blocks is not None:
            self._blocks.update(A, coarse=self._due)
        if self._due:
            self._first = 0
        self.stale, self._due = not self._due, False

    def count(self, iterations: int) -> None:
        """Take note of a linear solve's iterations."""
        self._first = self._first or iterations
        if iterations > SLOWER * self._first:
            self.renew()

    def destroy(self) -> None:
        """Free the matrices."""
        for item in (self._levels, self._blocks):
            if item is not None:
                item.destroy()
        self.used, self._levels, self._blocks = False, None, None


class OrderMultigrid:
    """A two-level preconditioner: SSOR on the unknown's elements, one cycle of GAMG on linear ones.

    K_1 = P^T K P,  P the interpolation from degree 1, without supported degrees of freedom

    Smoothed aggregation alone needs three to four times as many iterations on elements of degree 2,
    whose rows have hundreds of entries.

    Args:
        V: Space of displacements of degree 2 or more.
        constrained: Local numbers of the owned rows that are supported.
        ksp: Solver whose preconditioner this is; its other options are left alone.
        prefix: Prefix of the coarse solver's options.
        order: Owned degrees of freedom of V in the order of the rows, where it is another one.
    """

    def __init__(
        self,
        V: fem.FunctionSpace,
        constrained: NDArray[np.int32],
        ksp: PETSc.KSP,
        prefix: str,
        order: NDArray[np.intp] | None = None,
    ) -> None:
        cell = V.mesh.basix_cell()
        element = basix.ufl.element("Lagrange", cell, 1, shape=(V.mesh.geometry.dim,))
        V1 = fem.functionspace(V.mesh, element)
        self.P = _without_supports(fem_petsc.interpolation_matrix(V1, V), constrained, order)
        self._modes = linear.rigid_modes(V1)
        self.coarse: PETSc.Mat | None = None
        self._pc = ksp.getPC()
        self._pc.setType("mg")
        self._pc.setMGLevels(2)
        self._pc.setMGType(PETSc.PC.MGType.MULTIPLICATIVE)
        self._pc.setMGInterpolation(1, self.P)
        smoother = self._pc.getMGSmoother(1)
        smoother.setType("richardson")
        smoother.setTolerances(max_it=1)
        smoother.getPC().setType("sor")
        below = self._pc.getMGCoarseSolve()
        options, key = PETSc.Options(), f"{prefix}coarse_"
        below.setOptionsPrefix(key)
        ours = {"ksp_type": "preonly", **linear.aggregation()}
        ours = {k: v for k, v in ours.items() if not options.hasName(key + k)}
        for name, value in ours.items():
            options[key + name] = value
        below.setFromOptions()
        for name in ours:
            options.delValue(key + name)

    def update(self, A: PETSc.Mat) -> None:
        """Take the coarse operator of a tangent. Collective."""
        if self.coarse is None:
            self.coarse = A.ptap(self.P)
            self.coarse.setNearNullSpace(self._modes)
        else:
            A.ptap(self.P, self.coarse)
        self._pc.getMGCoarseSolve().setOperators(self.coarse)

    def destroy(self) -> None:
        """Free the matrices."""
        self.P.destroy()
        if self.coarse is not None:
            self.coarse.destroy()


def _without_supports(
    P: PETSc.Mat, constrained: NDArray[np.int32], order: NDArray[np.intp] | None = None
) -> PETSc.Mat:
    """The interpolation with supported rows and columns emptied, but for a vertex onto itself.

    That entry keeps the diagonal of the coarse operator from being 0 at supports.
    """
    P.assemble()
    pointers, columns, values = P.getValuesCSR()
    sizes = P.getBlockSizes()
    if order is not None:
        entries = np.argsort(np.argsort(order)[_rows(pointers)], kind="stable")
        columns, values, sizes = columns[entries], values[entries], (1, sizes[1])
        lengths = np.diff(pointers)[order]
        pointers = np.concatenate([[0], np.cumsum(lengths)]).astype(pointers.dtype)
    rows = _rows(pointers)
    held = np.zeros(len(pointers) - 1)
    held[constrained] = 1
    # Interpolated values that are 0 are stored: a vertex' row is the one with a 1.
    vertex = np.isclose(values, 1)
    flags = P.createVecRight()
    flags.setValues(columns[vertex], held[rows[vertex]], addv=PETSc.InsertMode.ADD_VALUES)
    flags.assemble()
    needed, inverse = np.unique(columns, return_inverse=True)
    source = PETSc.IS().createGeneral(needed.astype(PETSc.IntType), comm=PETSc.COMM_SELF)
    found = PETSc.Vec().createSeq(len(needed))
    scatter = PETSc.Scatter().create(flags, source, found, None)
    scatter.scatter(flags, found, addv=PETSc.InsertMode.INSERT_VALUES)
    column_held = found.array_r[inverse] > 0.5
    row_held = held[rows] > 0.5
    values = np.where((row_held | column_held) & ~(row_held & column_held & vertex), 0.0, values)
    Q = PETSc.Mat().createAIJ(P.getSizes(), comm=P.comm, csr=(pointers, columns, values))
    Q.setBlockSizes(*sizes)
    for item in (P, flags, found, scatter, source):
        item.destroy()
    return Q


def _rows(pointers: NDArray[np.int32]) -> NDArray[np.intp]:
    """Row of each stored entry."""
    return np.repeat(np.arange(len(pointers) - 1), np.diff(pointers))
