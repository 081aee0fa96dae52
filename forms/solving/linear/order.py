# SPDX-License-Identifier: MIT
"""Multigrid over the order: elements of degree 2 and 3, degree 1 below by aggregation."""

from __future__ import annotations

from collections.abc import Mapping

from petsc4py import PETSc

import basix.ufl
import numpy as np
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from numpy.typing import NDArray

from ...problems import Problem
from .cycle import cycled
from .patch import Patch, may_touch
from .presets import aggregation
from .rigid import rigid_modes

# Of the smoother beside the coarse correction: between 1/3 and 1 it changes little.
WEIGHT = "0.5"


class OrderMultigrid:
    """A two-level preconditioner: the unknown's elements, and linear ones by a cycle of GAMG.

    K_1 = P^T K P,  P the interpolation from degree 1, without supported degrees of freedom

    Added:       M^-1 = w D^-1 + P M_1^-1 P^T,  D the blocks of the nodes on K's diagonal
    Multiplied:  SSOR, the correction by M_1 of what is left, SSOR again

    With obstacles or surfaces D has one block for all that is in contact (:class:`Patch`).

    The sum needs more iterations, but each costs one product with K instead of four. Smoothed
    aggregation alone needs three to four times as many iterations on elements of degree 2, whose
    rows have hundreds of entries.

    Args:
        V: Space of displacements of degree 2 or more.
        problem: Problem with the supports.
        ksp: Solver whose preconditioner this is; its other options are left alone.
        prefix: Prefix of the options of both levels: smoother_ and coarse_.
        added: The sum, as a Krylov method wants it, or the product, as one application of many.
        order: Owned degrees of freedom of V in the order of the rows, where it is another one.
        rows: Owned numbers of the unknown whose rows are meant, ascending, where they are not all.
    """

    def __init__(
        self,
        V: fem.FunctionSpace,
        problem: Problem,
        ksp: PETSc.KSP,
        prefix: str,
        added: bool = True,
        order: NDArray[np.intp] | None = None,
        rows: NDArray[np.int32] | None = None,
    ) -> None:
        cell = V.mesh.basix_cell()
        element = basix.ufl.element("Lagrange", cell, 1, shape=(V.mesh.geometry.dim,))
        V1 = fem.functionspace(V.mesh, element)
        held = problem.constrained
        if rows is not None:
            held = np.flatnonzero(np.isin(rows, held)).astype(np.int32)
        self.P = _without_supports(fem_petsc.interpolation_matrix(V1, V), held, order)
        if problem.slants is not None:
            free, kept = problem.slants.matrix(rows), self.P
            self.P = free.matMult(kept)
            self.P.setBlockSizes(*kept.getBlockSizes())
            for item in (free, kept):
                item.destroy()
        self._modes = rigid_modes(V1)
        self.coarse: PETSc.Mat | None = None
        self._pc = ksp.getPC()
        self._pc.setType("mg")
        self._pc.setMGLevels(2)
        kinds = PETSc.PC.MGType
        self._pc.setMGType(kinds.ADDITIVE if added else kinds.MULTIPLICATIVE)
        self._pc.setMGInterpolation(1, self.P)
        smoothing = {"ksp_type": "richardson", "ksp_max_it": "1", "pc_type": "sor"}
        if added:
            smoothing |= {"pc_type": "pbjacobi", "ksp_richardson_scale": WEIGHT}
        smoother = self._pc.getMGSmoother(1)
        _set(smoother, f"{prefix}smoother_", smoothing)
        chosen = PETSc.Options().hasName(f"{prefix}smoother_pc_type")
        if added and may_touch(problem) and not chosen:
            smoother.getPC().setType("python")
            smoother.getPC().setPythonContext(Patch(problem))
        below = {"ksp_type": "preonly", **aggregation()}
        _set(self._pc.getMGCoarseSolve(), f"{prefix}coarse_", below)
        coarse = self._pc.getMGCoarseSolve()
        # The product is for one application of many, by GMRES, which wants it linear to the last
        # digit.
        if added and coarse.getPC().getType() == "gamg":
            cycled(coarse, PETSc.Options(f"{prefix}coarse_").getAll())

    def update(self, A: PETSc.Mat) -> None:
        """Take the coarse operator of a tangent. Collective."""
        if self.coarse is None:
            self.coarse = A.ptap(self.P)
            self.coarse.setNearNullSpace(self._modes)
        else:
            A.ptap(self.P, self.coarse)
        self._pc.getMGCoarseSolve().setOperators(self.coarse)

    def forget(self) -> None:
        """Free the coarse operator: the next tangent has another pattern. Collective."""
        if self.coarse is not None:
            self.coarse.destroy()
            self.coarse = None

    def destroy(self) -> None:
        """Free the matrices."""
        self.P.destroy()
        self.forget()


def _set(ksp: PETSc.KSP, prefix: str, presets: Mapping[str, str]) -> None:
    """Give a level's solver its options; those of the user go over ours."""
    options = PETSc.Options()
    ksp.setOptionsPrefix(prefix)
    ours = {k: v for k, v in presets.items() if not options.hasName(prefix + k)}
    for name, value in ours.items():
        options[prefix + name] = value
    ksp.setFromOptions()
    for name in ours:
        options.delValue(prefix + name)


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
