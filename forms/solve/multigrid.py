# SPDX-License-Identifier: MIT
"""Multigrid over the order: elements of degree 2 and 3, degree 1 below by aggregation."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from petsc4py import PETSc

import basix.ufl
import numpy as np
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from numpy.typing import NDArray

from ..assembly import System
from . import linear

# Iterations for a digit, over those of the first solve, at which a preconditioner is built anew: an
# assembly of its operators costs as much as 10 to 25 iterations.
SLOWER = 2.0
# Iterations for a digit above which a factorization is faster, up to so many unknowns: in a body
# that is nearly incompressible and has no pressure of its own.
SLOW, FACTORIZED_UP_TO = 30, 50_000
# A kept one that fails is given up after so many times its first iterations.
PATIENCE = 4
# The last linear solve aims this much below the goal, if so many digits are enough for it.
BELOW, DIGITS = 0.3, 4
LOOSEST = 0.1
TWO_PRODUCTS_UP_TO = 20_000
# Of the smoother beside the coarse correction: between 1/3 and 1 it changes little.
WEIGHT = "0.5"


class Kept:
    """When a multigrid preconditioner is built, and how far its linear solves go.

    It is built at the start of a path, and again when it slows down. What is kept are the coarser
    operators, and where no tangent is assembled (:class:`forms.solve.action.Action`) the smoother
    too; else smoothers, and the blocks of a mixed unknown, see the present tangent. Newton's
    directions are solved for to the preset's tolerance, the last one as far as
    it takes to get below the goal.

    Args:
        system: Problem that is solved.
        ksp: Solver with its options set.
        preset: Options in use that are the package's own; empty where the user chose.
        prefix: Prefix of the options.
        user: Options that are the user's.

    Attributes:
        used: Whether there is anything to keep.
        due: Whether it is built anew at the next tangent.
        stale: Whether the last solve used a preconditioner of an earlier state.
        slow: Whether a factorization would be faster.
        goal: Norm of the forces [N] at which Newton's method is to end; 0 where unknown.
    """

    def __init__(
        self,
        system: System,
        ksp: PETSc.KSP,
        preset: Mapping[str, str],
        prefix: str,
        user: Mapping[str, Any],
    ) -> None:
        from .fieldsplit import FieldSplit  # which has a use for multigrid itself

        self.used, self.goal = preset.get("ksp_type") in ("cg", "gmres"), 0.0
        self._levels: OrderMultigrid | None = None
        self._blocks: FieldSplit | None = None
        kind = preset.get("pc_type") if self.used else None
        if kind == "mg":
            V = system.u.function_space
            self._levels = OrderMultigrid(V, system.constrained, ksp, prefix)
        elif kind == "python":
            self._blocks = FieldSplit(system, ksp, prefix)
        self._ksp, self.stale, self.due, self._first = ksp, False, True, 0.0
        self._system = system
        self.slow, self._small = False, system.size <= FACTORIZED_UP_TO
        self._own = "ksp_rtol" not in user, "ksp_max_it" not in user
        self._rtol, *_, self._most = ksp.getTolerances()
        self._asked = self._rtol
        if self.used:
            # Not earlier: SNES asks for a new preconditioner after each tangent.
            ksp.setPreSolve(self._begin)

    def _begin(self, ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """Say what is kept, and set the tolerances of this solve. Collective."""
        ksp.getPC().setReusePreconditioner(self.stale)
        norm = b.norm()
        enough = BELOW * self.goal / norm if norm > 0 else 0.0
        self._asked = self._rtol
        if self._own[0] and enough >= 10.0**-DIGITS:
            self._asked = min(enough, LOOSEST)
        most = self._most
        if self._own[1] and self.stale:
            most = min(most, max(20, int(PATIENCE * self._first * -np.log10(self._asked))))
        ksp.setTolerances(rtol=self._asked, max_it=most)
        if not self.stale:
            with _faster_products(ksp, self._system):
                ksp.setUp()

    def renew(self) -> None:
        """Build anew at the next tangent."""
        self.due = True

    def prepare(self, A: PETSc.Mat) -> None:
        """Build the preconditioner for a tangent just assembled, or keep it. Collective."""
        if not self.used:
            return
        if self.due and self._levels is not None:
            self._levels.update(A)
        if self._blocks is not None:
            self._blocks.update(A, coarse=self.due)
        if self.due:
            self._first = 0.0
        self.stale, self.due = not self.due, False

    def count(self) -> None:
        """Take note of the iterations of the linear solve that has just ended."""
        if not self.used:
            return
        each = self._ksp.getIterationNumber() / -np.log10(self._asked)
        self._first = self._first or each
        if each > SLOWER * self._first:
            self.renew()
        exhausted = self._ksp.getConvergedReason() == PETSc.KSP.ConvergedReason.DIVERGED_MAX_IT
        self.slow = self._small and not self.stale and (each > SLOW or exhausted)

    def destroy(self) -> None:
        """Free the matrices."""
        for item in (self._levels, self._blocks):
            if item is not None:
                item.destroy()
        self.used, self._levels, self._blocks = False, None, None


@contextmanager
def _faster_products(ksp: PETSc.KSP, system: System) -> Iterator[None]:
    """Coarse operators by two products instead of PETSc's default, a third of the set-up less.

    On one rank, where PETSc has this way, and where its memory does not matter; PETSc reads the
    option without a prefix.
    """
    options, name = PETSc.Options(), "matptap_via"
    small = ksp.comm.size == 1 and system.size <= TWO_PRODUCTS_UP_TO
    ours = small and not options.hasName(name)
    if ours:
        options[name] = "rap"
    try:
        yield
    finally:
        if ours:
            options.delValue(name)


class OrderMultigrid:
    """A two-level preconditioner: the unknown's elements, and linear ones by a cycle of GAMG.

    K_1 = P^T K P,  P the interpolation from degree 1, without supported degrees of freedom

    Added:       M^-1 = w D^-1 + P M_1^-1 P^T,  D the blocks of the nodes on K's diagonal
    Multiplied:  SSOR, the correction by M_1 of what is left, SSOR again

    The sum needs more iterations, but each costs one product with K instead of four. Smoothed
    aggregation alone needs three to four times as many iterations on elements of degree 2, whose
    rows have hundreds of entries.

    Args:
        V: Space of displacements of degree 2 or more.
        constrained: Local numbers of the owned rows that are supported.
        ksp: Solver whose preconditioner this is; its other options are left alone.
        prefix: Prefix of the options of both levels: smoother_ and coarse_.
        added: The sum, as a Krylov method wants it, or the product, as one application of many.
        order: Owned degrees of freedom of V in the order of the rows, where it is another one.
    """

    def __init__(
        self,
        V: fem.FunctionSpace,
        constrained: NDArray[np.int32],
        ksp: PETSc.KSP,
        prefix: str,
        added: bool = True,
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
        kinds = PETSc.PC.MGType
        self._pc.setMGType(kinds.ADDITIVE if added else kinds.MULTIPLICATIVE)
        self._pc.setMGInterpolation(1, self.P)
        smoothing = {"ksp_type": "richardson", "ksp_max_it": "1", "pc_type": "sor"}
        if added:
            smoothing |= {"pc_type": "pbjacobi", "ksp_richardson_scale": WEIGHT}
        _set(self._pc.getMGSmoother(1), f"{prefix}smoother_", smoothing)
        below = {"ksp_type": "preonly", **linear.aggregation()}
        _set(self._pc.getMGCoarseSolve(), f"{prefix}coarse_", below)

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
