# SPDX-License-Identifier: MIT
"""One run of PETSc SNES: its callbacks, line searches and convergence test."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from .. import _petsc
from ..problems import Problem
from .criteria import Criteria
from .ladder import Failure, Merit
from .options import SolverOptions
from .settings import Settings
from .tangents import Tangent

CONVERGED, NOT_FINITE = 2, -4  # SNES_CONVERGED_FNORM_ABS, SNES_DIVERGED_FNORM_NAN
NO_STEP = 4  # SNES_CONVERGED_SNORM_RELATIVE: PETSc's word for a search that led nowhere
Callbacks = tuple[Callable[..., Any], Callable[..., Any], Callable[..., Any], Callable[..., Any]]


class Run(NamedTuple):
    """How a run ended: PETSc's reason, counts, |R| at its start and after each iteration."""

    code: int
    iterations: int
    linear_iterations: int
    residuals: tuple[float, ...]
    raised: str


class Runs:
    """SNES objects, one for each merit that a line search lowers; they share the linear solver.

    Args:
        problem: What is solved.
        tangent: Its tangent and linear solver.
        criteria: When it has converged.
        options: PETSc options.
        settings: Numbers that it is tuned by.
        ruined: Whether the start is no neighbor of any equilibrium, to be asked after a tangent.

    Attributes:
        x: State, scaled.
        b: Room for a residual.
        merit: What the present run lowers.
        until: Fraction of the force level at which a run that lowers the energy ends.
        ruined: Whether the last run ended because its start was ruined.
        patient: Whether a search by |R| may creep.
        snes: SNES of the first merit.
    """

    def __init__(
        self,
        problem: Problem,
        tangent: Tangent,
        criteria: Criteria,
        options: SolverOptions,
        settings: Settings,
        ruined: Callable[[], bool],
    ) -> None:
        self.problem, self.tangent, self.criteria = problem, tangent, criteria
        self._options, self._settings, self._is_ruined = options, settings, ruined
        self.b = problem.create_vector()
        self.x, self._before = self.b.duplicate(), self.b.duplicate()
        self.merit, self.until, self.ruined = Merit.ENERGY, settings.near, False
        self.patient = True
        self._known: tuple[np.ndarray, float] | None = None
        self._history: list[float] = []
        self._resumed = False
        self._make()

    def _make(self) -> None:
        base = {
            "snes_type": "newtonls",
            "snes_linesearch_type": "bt",
            "snes_max_it": str(self._settings.most),
            "snes_divergence_tolerance": "-1",
        }
        self._path: PETSc.SNES | None = None
        self.tangent.configure(base)
        self.snes = self._create(None)
        ksp = self.snes.getKSP()
        self._solvers = {Merit.RESIDUAL: self.snes}
        if self.problem.minimization:
            # An objective once set cannot be taken back.
            self._solvers = {Merit.ENERGY: self.snes, Merit.RESIDUAL: self._create(ksp)}
            self.snes.setObjective(self._objective)
        if "snes_linesearch_type" not in self._options.user:
            self._options["snes_linesearch_type"] = "basic"
            self._solvers[Merit.NONE] = self._create(ksp)
            self._options["snes_linesearch_type"] = base["snes_linesearch_type"]
        self.tangent.attach(ksp)

    def _create(self, ksp: PETSc.KSP | None) -> PETSc.SNES:
        callbacks = self._residual, self._jacobian, self._test, self._check_step
        matrices = self.tangent.product, self.tangent.A
        return self._with_options(callbacks, self.b, matrices, ksp)

    def create(
        self,
        callbacks: Callbacks,
        vector: PETSc.Vec,
        matrices: tuple[PETSc.Mat, PETSc.Mat],
        ksp: PETSc.KSP,
    ) -> PETSc.SNES:
        """SNES with the user's options and full steps, if no other line search was chosen.

        On the tangent's own linear solver it is the same one for every path of the problem.

        Args:
            callbacks: Function, Jacobian, convergence test, check of a step.
            vector: Of the layout of its state.
            matrices: The operator, and that of which a preconditioner is built.
            ksp: Its linear solver.
        """
        own = ksp.handle == self.snes.getKSP().handle
        if own and self._path is not None:
            _call(self._path, callbacks, self._path.getFunction()[0], matrices)
            return self._path
        mine = "snes_linesearch_type" not in self._options.user
        if mine:
            self._options["snes_linesearch_type"] = "basic"
        snes = self._with_options(callbacks, vector, matrices, ksp)
        if mine:
            self._options["snes_linesearch_type"] = "bt"
        if own:
            self._path = snes
        return snes

    def _with_options(
        self,
        callbacks: Callbacks,
        vector: PETSc.Vec,
        matrices: tuple[PETSc.Mat, PETSc.Mat],
        ksp: PETSc.KSP | None,
    ) -> PETSc.SNES:
        snes = PETSc.SNES().create(self.problem.comm)
        snes.setOptionsPrefix(self._options.prefix)
        _call(snes, callbacks, vector.duplicate(), matrices)
        if ksp is not None:
            snes.setKSP(ksp)
        try:
            snes.setFromOptions()
        except PETSc.Error as error:
            self._options.clear()
            raise ValueError(f"PETSc refused its options, {_petsc.said(error)}.") from None
        return snes

    def remake(self) -> None:
        """Make SNES and its linear solver anew. Collective."""
        self.tangent.detach()
        for snes in self._all():
            snes.destroy()
        self._make()

    def _all(self) -> list[PETSc.SNES]:
        return [*self._solvers.values(), *([] if self._path is None else [self._path])]

    @property
    def solvers(self) -> list[PETSc.SNES]:
        """All that may iterate, on the one linear solver."""
        return list(self._solvers.values())

    def knows(self, merit: Merit) -> bool:
        """Whether there is a SNES for a merit: the user may have chosen the line search."""
        return merit in self._solvers

    @property
    def words(self) -> str:
        """What the present run does, in words."""
        way = self.merit.value
        if self.merit is Merit.ENERGY:
            plain = "full tangent" if self.tangent.damping is None else "damped tangent"
            way = "projected tangent" if self.tangent.projecting else plain
        return f"{way} with MUMPS" if self.tangent.left_multigrid else way

    def run(self, resumed: bool) -> Run:
        """Iterate from x until the test ends it; x and u are left at the last state. Collective.

        Args:
            resumed: Whether an earlier run has led here, so that nothing has converged yet.
        """
        tangent, settings = self.tangent, self._settings
        snes, energetic = self._solvers[self.merit], self.merit is Merit.ENERGY
        self._resumed, self._known, self._history = resumed, None, []
        tangent.spoiled = False
        damped = tangent.projecting or tangent.damping is not None
        if "snes_max_it" not in self._options.user:
            longest = settings.most_damped if energetic else settings.most_near
            snes.setTolerances(max_it=longest if damped else settings.most)
        self.x.copy(self._before)
        self.criteria.correction = np.inf
        tangent.forget_failure()
        code, counts, raised = Failure.LINEAR.value, (0, 0), ""
        try:
            snes.solve(None, self.x)
            counts = snes.getIterationNumber(), snes.getLinearSolveIterations()
            # A step of zero length counts as converged for PETSc.
            code = code if tangent.spoiled else int(snes.getConvergedReason())
            code = Failure.NO_DESCENT.value if code == NO_STEP else code
        except PETSc.Error as error:  # its vectors stay locked: all is made anew
            raised, counts = _petsc.said(error), (max(0, len(self._history) - 1), 0)
            self.x, self.b = self.b.duplicate(), self.b.duplicate()
            self._before.copy(self.x)
            self.remake()
        tangent.scaled.put(self.x)
        return Run(code, *counts, tuple(self._history), raised)

    def _objective(self, snes: PETSc.SNES, x: PETSc.Vec) -> float:
        # A line search begins with the energy of the state at which the last one ended.
        known = self._known is not None and np.array_equal(self._known[0], x.array_r)
        if not self.problem.comm.allreduce(known, MPI.LAND):
            self.tangent.scaled.put(x)
            self._known = x.array_r.copy(), self.problem.energy()
        assert self._known is not None
        return self._known[1]

    def _residual(self, snes: PETSc.SNES, x: PETSc.Vec, f: PETSc.Vec) -> None:
        scaled, energy = self.tangent.scaled, 0.0
        scaled.put(x)
        if self.merit is Merit.ENERGY:
            self.criteria.reactions = scaled.residual(self.b)
        else:
            energy, self.criteria.reactions = scaled.energy_and_residual(self.b)
        self.b.copy(f)
        # A state without a finite energy is refused also where the search goes by |R|: ln J with
        # J < 0 spoils the energy before every part of the residual.
        if not np.isfinite(energy):
            f.set(np.nan)

    def _jacobian(self, snes: PETSc.SNES, x: PETSc.Vec, A: PETSc.Mat, P: PETSc.Mat) -> None:
        self.tangent.scaled.put(x)
        self.tangent.assemble()

    def _check_step(self, x: PETSc.Vec, step: PETSc.Vec) -> bool:
        """Keep a step within what terms allow, and stiffen damping until it lowers the energy.

        Returns:
            Whether the step was changed.
        """
        tangent, changed = self.tangent, False
        if tangent.damping is None or self.merit is not Merit.ENERGY:
            return self._bounded(step)
        force = self.snes.getFunction()[0]
        while not force.dot(step) > 0 and tangent.damping.stiffen():
            tangent.assemble()
            tangent.forget_failure()
            tangent.solve(force, step)
            changed = True
        tangent.forget_failure()
        return self._bounded(step) or changed

    def _bounded(self, step: PETSc.Vec) -> bool:
        """Shorten a step that a term forbids; whether it was changed. Collective."""
        if not self.problem.bounds_steps:
            return False
        fraction = self.allowed(step)
        step.scale(min(fraction, 1.0))
        return fraction < 1

    def allowed(self, step: PETSc.Vec, moves: Mapping[Any, float] | None = None) -> float:
        """Fraction of a scaled step, and of Constants' moves, that no term forbids. Collective."""
        self.b.pointwiseMult(step, self.tangent.scaled.D)
        self.b.scale(-1)  # SNES takes x - step
        return self.problem.largest_step(self.b, moves)

    def _test(self, snes: PETSc.SNES, iteration: int, norms: tuple[float, float, float]) -> int:
        """SNES's convergence test: 0 to go on, else a code of :class:`Failure` or PETSc."""
        tangent, criteria, before = self.tangent, self.criteria, self.criteria.last
        energetic, x = self.merit is Merit.ENERGY, snes.getSolution()
        self._history.append(float(norms[2]))
        if not np.isfinite(norms[2]):
            return NOT_FINITE
        if iteration:
            criteria.corrected(x, self._before)
            if energetic and tangent.damping is not None:
                self._before.axpy(-1, x)
                step = snes.getSolutionUpdate().norm()
                tangent.damping.after(self._before.norm() / step if step else 1.0)
        x.copy(self._before)
        if tangent.spoiled:
            return Failure.LINEAR
        criteria.take(norms[2])
        tangent.kept.goal = criteria.goal
        first = iteration == 0 and not self._resumed
        if criteria.hold(before, first, iterative=tangent.kept.used and iteration > 0):
            return CONVERGED
        if energetic and norms[2] <= self.until * criteria.force:
            return Failure.NEAR
        if tangent.kept.slow:
            return Failure.LINEAR
        if iteration == 1 and energetic and self._is_ruined():
            self.ruined = True
            return Failure.NO_DESCENT
        if self._creeps():
            return Failure.CREEPING
        return Failure.USED_UP if iteration >= snes.getTolerances()[3] else 0

    def _creeps(self) -> bool:
        """Whether a search by |R| has lowered it by little in each of its last iterations."""
        count, slow = self._settings.creeping
        if self.patient or self.merit is not Merit.RESIDUAL or len(self._history) <= count:
            return False
        last = np.array(self._history[-count - 1 :])
        return bool(np.all(last[1:] > slow * last[:-1]))

    def destroy(self) -> None:
        """Free the PETSc objects, whose callbacks refer to this one."""
        for item in (*self._all(), self.b, self.x, self._before):
            item.destroy()


def _call(
    snes: PETSc.SNES,
    callbacks: Callbacks,
    vector: PETSc.Vec,
    matrices: tuple[PETSc.Mat, PETSc.Mat],
) -> None:
    """Have SNES call these functions."""
    function, jacobian, test, check = callbacks
    snes.setFunction(function, vector)
    snes.setJacobian(jacobian, *matrices)
    snes.setConvergenceTest(test)
    snes.setLineSearchPreCheck(check)
