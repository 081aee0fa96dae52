# SPDX-License-Identifier: MIT
"""A smoother that solves exactly where a body is in contact."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
from dolfinx import fem, la
from numpy.typing import NDArray

from ...problems import Problem


class Patch:
    """Jacobi by the blocks of nodes, with one block for all nodes in contact, factorized.

    M = diag(K_cc, K_11, K_22, …),  c what obstacles and surfaces act on, the rest node by node

    A barrier joins the nodes of surfaces by stiffness of any size, which neither single nodes nor
    a coarse level see. A context of PETSc's ``python`` preconditioner; it follows the tangent and
    the contact that the problem has when it is set up.

    Args:
        problem: Whose tangent it is; a displacement.
    """

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self._nodes = PETSc.PC()
        self._inner = PETSc.KSP()
        self._rows: NDArray[np.int32] = np.empty(0, np.int32)

    def setUp(self, pc: PETSc.PC) -> None:
        """Factorize the block of what is in contact. Collective."""
        A = pc.getOperators()[1]
        if not self._nodes:
            self._nodes.create(A.comm)
            self._nodes.setType("pbjacobi")
        self._nodes.setOperators(A)
        self._nodes.setUp()
        self._inner.destroy()
        self._rows = touched(self._problem)
        if not self._problem.comm.allreduce(len(self._rows)):
            return
        numbers = (self._rows + A.getOwnershipRange()[0]).astype(PETSc.IntType)
        chosen = PETSc.IS().createGeneral(numbers, comm=A.comm)
        block = A.createSubMatrix(chosen, chosen)
        self._b, self._x = block.createVecs()
        self._inner.create(A.comm)
        self._inner.setType("preonly")
        self._inner.setOperators(block)
        solver = self._inner.getPC()
        solver.setType("cholesky")
        solver.setFactorSolverType("mumps")
        self._inner.setUp()
        for item in (chosen, block):
            item.destroy()

    def apply(self, pc: PETSc.PC, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """Put M^-1 b into x. Collective."""
        self._nodes.apply(b, x)
        if self._inner:
            self._b.array[:] = b.array_r[self._rows]
            self._inner.solve(self._b, self._x)
            x.array[self._rows] = self._x.array_r

    def destroy(self, pc: PETSc.PC) -> None:
        """Free the factors."""
        for item in (self._nodes, self._inner):
            item.destroy()


def may_touch(problem: Problem) -> bool:
    """Whether a problem has obstacles, or surfaces in contact."""
    return bool(problem.forms.barriers) or any(hasattr(term, "acting") for term in problem.terms)


def touched(problem: Problem) -> NDArray[np.int32]:
    """Owned degrees of freedom that contact acts on at u, ascending, none of supports. Collective.

    Of obstacles those of the facets with a point within reach; of surfaces those with a force.
    """
    found = fem.Function(problem.u.function_space)
    found.x.array[problem.forms.barriers.acting()] = 1
    found.x.scatter_reverse(la.InsertMode.add)
    dofmap = problem.u.function_space.dofmap
    own = found.x.array[: dofmap.index_map.size_local * dofmap.bs]
    for term in problem.terms:
        if hasattr(term, "acting"):
            own[term.acting()] = 1
    own[problem.constrained] = 0
    return np.flatnonzero(own).astype(np.int32)
