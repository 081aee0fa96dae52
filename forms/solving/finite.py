# SPDX-License-Identifier: MIT
"""Where a tangent is not finite though energy and forces are, and which summand is to blame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import ufl
from ufl.algorithms import expand_derivatives

from .. import _dolfinx
from ..compilation import compiled
from ..differentiation import expanded
from ..insertion import assemble, create_matrix
from ..paths import REASONS, Convergence
from ..problems import Problem
from ..variation import residual, tangent
from .ladder import Failure

NAN = "nan or infinite"
LONGEST = 100  # characters of a summand in a sentence
ADVICE = (
    "Write the energy so that its second derivative exists there (with a power of 2 or more), or "
    "begin from another state."
)


def not_finite(problem: Problem, A: PETSc.Mat) -> str:
    """What of an assembled tangent is not finite, in words; empty where all of it is.

    As inf * 0 in the second derivative of a power below 2 of something that vanishes. Collective;
    compiles a form per summand of the potential, so it is for failures only.

    Args:
        problem: Problem, at the state that the tangent was assembled at.
        A: The tangent.
    """
    found = _first_row(problem, A)
    if found is None:
        return ""
    place = f"({', '.join(f'{x:.3g}' for x in found)})"
    culprit = next((str(s) for s, form in _summands(problem) if _spoils(problem, form)), "")
    if len(culprit) > LONGEST:
        culprit = f"{culprit[: LONGEST // 2]} … {culprit[-LONGEST // 2 :]}"
    what = f"of the summand {culprit} " if culprit else ""
    return f"the second derivative {what}is not finite at {place}"


def explained(outcome: Convergence, problem: Problem, A: PETSc.Mat) -> Convergence:
    """An outcome, with the cause of linear solves that fail where the tangent at it shows one."""
    if outcome.converged or outcome.code != Failure.LINEAR:
        return outcome
    problem.tangent(A)
    cause = not_finite(problem, A)
    return replace(outcome, reason=cause, advice=ADVICE) if cause else outcome


def undefined(problem: Problem) -> str:
    """Why the energy is not finite at the start, in words. Collective."""
    if not all(np.all(np.isfinite(c.value)) for c in problem.forms.constants):
        return f"{REASONS[-1]}: a Constant in the potential is {NAN}"
    if not np.isfinite(problem.u.x.petsc_vec.norm()):
        return f"{REASONS[-1]}: the unknown holds {NAN}"
    return f"{REASONS[-1]}: cells are inverted there, or a parameter is out of its range"


def _first_row(problem: Problem, A: PETSc.Mat) -> tuple[float, ...] | None:
    """Place of the first node whose row is not finite, alike on all ranks; None if all are."""
    x = A.createVecRight()
    x.set(1.0)
    b = A.createVecLeft()
    A.mult(x, b)
    rows = np.flatnonzero(~np.isfinite(b.array_r))
    here = None
    if rows.size:
        here = tuple(_place(problem, int(rows[0])))
    for item in (x, b):
        item.destroy()
    places = [place for place in problem.comm.allgather(here) if place is not None]
    return places[0] if places else None


def _place(problem: Problem, dof: int) -> list[float]:
    """Middle of a cell that has a degree of freedom of this rank; local."""
    mesh, dofmap = problem.u.function_space.mesh, problem.u.function_space.dofmap
    cell = int(np.flatnonzero((dofmap.list == dof // dofmap.bs).any(axis=1))[0])
    nodes = _dolfinx.geometry_dofmap(mesh)[cell]
    return mesh.geometry.x[nodes].mean(axis=0)[: mesh.geometry.dim].tolist()


def _summands(problem: Problem) -> Iterator[tuple[ufl.core.expr.Expr, ufl.Form]]:
    """Summands of the potential, each with its functional."""
    if problem.forms.potential.arguments():
        return
    for integral in problem.forms.potential.integrals():
        for summand in _terms(integral.integrand()):
            yield summand, ufl.Form([integral.reconstruct(integrand=summand)])


def _terms(e: ufl.core.expr.Expr) -> Iterator[ufl.core.expr.Expr]:
    """Terms of a sum, of sums in it, and of a sum times a factor."""
    if isinstance(e, ufl.classes.Sum):
        for operand in e.ufl_operands:
            yield from _terms(operand)
    elif isinstance(e, ufl.classes.Product) and isinstance(e.ufl_operands[1], ufl.classes.Sum):
        for term in _terms(e.ufl_operands[1]):
            yield e.ufl_operands[0] * term
    else:
        yield e


def _spoils(problem: Problem, functional: ufl.Form) -> bool:
    """Whether a functional's tangent is not finite. Collective."""
    form = expand_derivatives(expanded(functional))
    if form.empty() or problem.u not in form.coefficients():
        return False
    K = expand_derivatives(tangent(residual(form, problem.u), problem.u))
    if K.empty():
        return False
    compiled_form = compiled(K)
    A = create_matrix(compiled_form)
    assemble(A, compiled_form, [])
    finite = bool(np.isfinite(A.norm()))
    A.destroy()
    return not problem.comm.allreduce(finite, MPI.LAND)
