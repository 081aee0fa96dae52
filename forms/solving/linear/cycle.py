# SPDX-License-Identifier: MIT
"""The V-cycle over the levels of PETSc's GAMG, with a smoother of our own."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from petsc4py import PETSc

from ...native.library import library
from .coarse import products
from .sweeps import Sweeps


class Cycle:
    """One V-cycle: PETSc's GAMG finds the levels, :class:`Sweeps` smooth on them.

    On each level, from x = 0: a symmetric sweep, the correction P A_c^-1 P^T of what is left by the
    level below, a symmetric sweep again. It is what PETSc's own cycle with PCSOR does, which is
    the smoother where these sweeps are not possible. A context of PETSc's ``python``
    preconditioner; where that is kept for another tangent, the finest level still sees this one.

    Args:
        levels: PETSc's GAMG with its options set.
    """

    def __init__(self, levels: PETSc.PC) -> None:
        self.levels = levels
        self._loaded = library(levels.comm.tompi4py())  # once: to ask for it takes messages
        self._all: list[_Level] = []

    def setUp(self, pc: PETSc.PC) -> None:
        """Find the levels of the matrix. Collective."""
        self._free()
        self.levels.setOperators(*pc.getOperators())
        with products.of(pc.getOperators()[1]):
            self.levels.setUp()
        self._coarse = self.levels.getMGCoarseSolve()
        numbers = range(1, self.levels.getMGLevels())
        self._all = [_Level(self.levels, n, self._loaded) for n in numbers]

    def apply(self, pc: PETSc.PC, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """Put M^-1 b into x. Collective."""
        if self._all:
            self._all[-1].update()
        self._descend(len(self._all), b, x)

    def _descend(self, n: int, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """A cycle of the n levels above the coarsest."""
        if n == 0:
            self._coarse.solve(b, x)
            return
        level = self._all[n - 1]
        level.smooth(b, x)
        level.P.multTranspose(level.r, level.b)
        self._descend(n - 1, level.b, level.x)
        level.P.multAdd(level.x, x, x)
        level.smooth_again(b, x)

    def reset(self, pc: PETSc.PC) -> None:
        """Forget the levels: the next matrix has another pattern."""
        self._free()
        self.levels.reset()

    def view(self, pc: PETSc.PC, viewer: PETSc.Viewer) -> None:
        """Show the levels, whose own smoothers are in use where sweeps are not possible."""
        self.levels.view(viewer)

    def _free(self) -> None:
        for level in self._all:
            level.destroy()
        self._all = []

    def destroy(self, pc: PETSc.PC) -> None:
        """Free the levels."""
        self._free()
        self.levels.destroy()


class _Level:
    """A level above the coarsest one.

    Attributes:
        P: Interpolation from the level below.
        r: What the first smoothing leaves of the right-hand side.
        b, x: Right-hand side and solution of the level below.
    """

    def __init__(self, levels: PETSc.PC, n: int, loaded: tuple[Any, Any]) -> None:
        self._solver, self.P = levels.getMGSmoother(n), levels.getMGInterpolation(n)
        self._A = self._solver.getOperators()[1]
        self._sweeps = Sweeps(self._A, loaded)
        self.r = self._A.createVecLeft()
        self.b, self.x = self.P.createVecRight(), self.P.createVecRight()

    def update(self) -> None:
        """Take the numbers of the matrix. Collective."""
        self._sweeps.update()

    def smooth(self, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """Solve roughly from x = 0."""
        if self._sweeps.possible:
            self._sweeps(b, x, self.r)
            return
        self._solver.setInitialGuessNonzero(False)
        self._solver.solve(b, x)
        self._A.mult(x, self.r)
        self.r.aypx(-1, b)

    def smooth_again(self, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """Improve x."""
        if self._sweeps.possible:
            self._sweeps(b, x)
            return
        self._solver.setInitialGuessNonzero(True)
        self._solver.solve(b, x)

    def destroy(self) -> None:
        """Free the vectors."""
        self._sweeps.destroy()
        for item in (self.r, self.b, self.x):
            item.destroy()


def cycled(ksp: PETSc.KSP, options: Iterable[str]) -> None:
    """Let :class:`Cycle` apply a solver's GAMG, unless an option of the user's asks how to smooth.

    Args:
        ksp: Solver whose preconditioner is GAMG, its options set.
        options: Names of the user's options, without prefix.
    """
    if any(name.startswith(("mg_levels_", "mg_fine_", "pc_mg_")) for name in options):
        return
    outer = PETSc.PC().create(ksp.comm)
    outer.setType("python")
    outer.setPythonContext(Cycle(ksp.getPC()))
    ksp.setPC(outer)
