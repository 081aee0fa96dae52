# SPDX-License-Identifier: MIT
"""Stability of an equilibrium: negative eigenvalues of its tangent, and its lowest modes.

A state is stable under dead loads and pressures with a potential where the second derivative of
the potential is positive definite. Of a mixed displacement-pressure unknown the tangent has one
negative eigenvalue per pressure besides: of each field whose own block has no positive diagonal
entry. A field with one, as a temperature or a damage variable, is minimized over like u.
"""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
from dolfinx import fem

from ..problems import Problem
from .finite import ADVICE, not_finite
from .linear.diagonal import pressures, typical_diagonal


def negative_eigenvalues(problem: Problem) -> int:
    """Number of negative eigenvalues of the tangent at u; 0 where the state is stable. Collective.

    By Sylvester's law from the pivots of an LDL^T factorization. To be used as a record:
    ``record={"unstable": forms.negative_eigenvalues}``.

    Args:
        problem: Problem, or a path.

    Raises:
        ValueError: the problem has no potential, so that its tangent is not symmetric.
    """
    problem = getattr(problem, "problem", problem)
    _check_symmetric(problem)
    A = _finite_tangent(problem)
    ksp = _factored(A)
    count = inertia(ksp, problem)
    ksp.destroy()
    A.destroy()
    if count is None:
        raise ValueError("the tangent at this state could not be factorized: is the body held?")
    return count


def _finite_tangent(problem: Problem) -> PETSc.Mat:
    """The assembled tangent at u. Collective.

    Raises:
        ValueError: it is not finite.
    """
    A = problem.create_matrix()
    problem.tangent(A)
    cause = not_finite(problem, A)
    if cause:
        raise ValueError(f"{cause}. {ADVICE}")
    return A


def lowest_modes(problem: Problem, n: int = 1) -> tuple[list[float], list[fem.Function]]:
    """Lowest eigenvalues of the tangent at u, K v = lambda v, with their modes. Collective.

    Args:
        problem: Problem, or a path.
        n: How many.

    Returns:
        Eigenvalues [N/m] in ascending order and modes of the unknown's space, the largest
        displacement component of each 1 (positive where it is largest), 0 at supports.

    Raises:
        ValueError: no potential of displacements alone, or n below 1.
        ImportError: slepc4py is missing.
    """
    problem = getattr(problem, "problem", problem)
    _check_symmetric(problem)
    if len(problem.fields) > 1:
        raise ValueError("lowest_modes needs a displacement unknown, got a mixed one.")
    if not n >= 1:
        raise ValueError(f"lowest_modes needs n >= 1 modes, got {n}.")
    try:
        from slepc4py import SLEPc
    except ImportError as error:
        raise ImportError(
            "lowest_modes needs slepc4py, which is not installed: install Debian's "
            "python3-slepc4py, or variform's extra 'modes' beside a SLEPc of PETSc's version."
        ) from error
    A = _finite_tangent(problem)
    free = np.setdiff1d(np.arange(A.getLocalSize()[0]), problem.constrained)
    typical = typical_diagonal(A, free)
    diagonal = A.getDiagonal()
    diagonal.array[problem.constrained] = 1e6 * typical  # not among the lowest ones
    A.setDiagonal(diagonal)
    if problem.slants is not None:
        problem.slants.apply(A, 1e6 * typical)
    solver = SLEPc.EPS().create(problem.comm)
    solver.setOperators(A)
    solver.setProblemType(SLEPc.EPS.ProblemType.HEP)
    solver.setDimensions(n)
    solver.setTolerances(1e-10, 500)
    # Below all eigenvalues of interest, so that the shifted tangent is definite and the nearest
    # eigenvalues are the lowest.
    shift = -_bound_below(A, typical)
    solver.setWhichEigenpairs(SLEPc.EPS.Which.TARGET_REAL)
    solver.setTarget(shift)
    transform = solver.getST()
    transform.setType(SLEPc.ST.Type.SINVERT)
    transform.setShift(shift)
    _use_mumps(transform.getKSP())
    solver.solve()
    if solver.getConverged() < n:
        raise ValueError(f"only {solver.getConverged()} of {n} lowest modes were found.")
    values, modes = [], []
    vector = A.createVecRight()
    for k in range(n):
        values.append(float(solver.getEigenvalue(k).real))
        solver.getEigenvector(k, vector)
        modes.append(_mode(problem, vector))
    for item in (solver, vector, A):
        item.destroy()
    order = np.argsort(values)
    return [values[k] for k in order], [modes[k] for k in order]


def inertia(ksp: PETSc.KSP, problem: Problem) -> int | None:
    """Negative eigenvalues of the matrix last factorized, those of pressures left out. Collective.

    None where the solver has no LDL^T factors of MUMPS.
    """
    pc = ksp.getPC()
    counted = pc.getType() == "cholesky" and pc.getFactorSolverType() == "mumps"
    if not counted or not problem.symmetric or ksp.getConvergedReason() < 0:
        return None
    return _negative_pivots(pc) - pressures(problem, ksp.getOperators()[1])


def _mode(problem: Problem, vector: PETSc.Vec) -> fem.Function:
    mode = fem.Function(problem.u.function_space, name="mode")
    vector.copy(mode.x.petsc_vec)
    mode.x.scatter_forward()
    owned = vector.array_r
    at = int(np.abs(owned).argmax()) if owned.size else 0
    peaks = problem.comm.allgather(float(owned[at]) if owned.size else 0.0)
    peak = max(peaks, key=abs)
    mode.x.array[:] /= peak
    mode.x.array[np.abs(mode.x.array) < 1e-12] = 0
    return mode


def _bound_below(A: PETSc.Mat, typical: float) -> float:
    """A shift under the lowest eigenvalue: grown until the shifted matrix has no negative pivot."""
    shift = 1e-8 * typical
    while True:
        shifted = A.duplicate(copy=True)
        shifted.shift(shift)
        ksp = _factored(shifted)
        negative = _negative_pivots(ksp.getPC())
        ksp.destroy()
        shifted.destroy()
        if negative == 0 or shift > 1e3 * typical:
            return shift
        shift *= 10


def _negative_pivots(pc: PETSc.PC) -> int:
    # PETSc's getInertia wants null pivots detected, which would hide a singular tangent.
    return int(pc.getFactorMatrix().getMumpsInfog(12))


def _factored(A: PETSc.Mat) -> PETSc.KSP:
    ksp = PETSc.KSP().create(A.comm)
    ksp.setOperators(A)
    _use_mumps(ksp)
    ksp.getPC().setFactorSetUpSolverType()
    # Pivots are counted where the root of the elimination tree is not given to ScaLAPACK.
    ksp.getPC().getFactorMatrix().setMumpsIcntl(13, 1)
    ksp.setUp()
    return ksp


def _use_mumps(ksp: PETSc.KSP) -> None:
    ksp.setType("preonly")
    pc = ksp.getPC()
    pc.setType("cholesky")
    pc.setFactorSolverType("mumps")


def _check_symmetric(problem: Problem) -> None:
    if not problem.symmetric:
        raise ValueError(
            "eigenvalues of the tangent tell of stability where there is a potential, got a "
            "virtual work or a residual."
        )
