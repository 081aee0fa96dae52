# SPDX-License-Identifier: MIT
"""DOLFINx as its tutorial does it: NonlinearProblem, NewtonSolver, MUMPS or CG with GAMG.

Its stopping test is set to the absolute residual of :func:`.problem.tolerance`; the default divides
by a norm that is a displacement, and stops a step early on some meshes. ``--solver tight`` goes on
to rounding error, as a second opinion on the reference.
"""

import time

from petsc4py import PETSc

import dolfinx
import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from dolfinx.nls.petsc import NewtonSolver

from .fenicsx import COMM, at_vertices, blas, create
from .problem import LMBDA, MU, STEPS, Clock, arguments, bent, block, report, tolerance, turned


class Timed(fem_petsc.NonlinearProblem):
    """The problem, its assemblies timed."""

    def __init__(self, clock, *positional, **named):
        self.clock = clock
        super().__init__(*positional, **named)

    def F(self, x, b):
        """Residual."""
        with self.clock("residual"):
            super().F(x, b)

    def J(self, x, A):
        """Tangent."""
        with self.clock("tangent"):
            super().J(x, A)


def rigid_modes(V):
    """Orthonormal rigid motions, the near null space that multigrid wants."""
    x, modes = V.tabulate_dof_coordinates(), []
    for k in range(6):
        mode = fem.Function(V)
        values = mode.x.array.reshape(-1, 3)
        if k < 3:
            values[:, k] = 1
        else:
            i, j = [(0, 1), (1, 2), (2, 0)][k - 3]
            values[:, i], values[:, j] = -x[:, j], x[:, i]
        modes.append(mode.x.petsc_vec.copy())
    for k, mode in enumerate(modes):
        for other in modes[:k]:
            mode.axpy(-mode.dot(other), other)
        mode.normalize()
    return PETSc.NullSpace().create(vectors=modes)


def main():
    """Solve, or assemble, and print the row."""
    given = arguments(solver=("mumps", "gamg", "tight"))
    clock = Clock()
    body, left, right = create(given.m)
    V = fem.functionspace(body, ("Lagrange", given.degree, (3,)))
    u, v = fem.Function(V), ufl.TestFunction(V)
    F = ufl.variable(ufl.Identity(3) + ufl.grad(u))
    J = ufl.det(F)
    psi = MU / 2 * (ufl.tr(F.T * F) - 3) - MU * ufl.ln(J) + LMBDA / 2 * ufl.ln(J) ** 2
    dx = ufl.dx(metadata={"quadrature_degree": given.degree})
    end = fem.Function(V)
    supports = [
        fem.dirichletbc(np.zeros(3), fem.locate_dofs_topological(V, 2, left), V),
        fem.dirichletbc(end, fem.locate_dofs_topological(V, 2, right)),
    ]
    with clock("compile"):
        residual = ufl.inner(ufl.grad(v), ufl.diff(psi, F)) * dx
        problem = Timed(clock, residual, u, bcs=supports)
    about = {"dofs": V.dofmap.index_map.size_global * 3, "ranks": COMM.size}
    about |= {"version": dolfinx.__version__, "solver": given.solver, "BLAS": blas()}
    if given.assemble:
        row = assemble(given.assemble, problem, u)
        if COMM.rank == 0:
            report("DOLFINx", given, Clock(), **about, **row)
        return
    solver = NewtonSolver(COMM, problem)
    solver.convergence_criterion = "residual"
    smallest = tolerance(block(given.m)[0])
    solver.rtol, solver.atol, solver.max_it = 1e-14, smallest, 30
    if given.solver == "tight":
        solver.rtol, solver.atol = 1e-16, 1e-5 * smallest
    ksp = solver.krylov_solver
    if given.solver != "gamg":
        ksp.setType("preonly")
        ksp.getPC().setType("lu")
        ksp.getPC().setFactorSolverType("mumps")
    else:
        ksp.setType("cg")
        ksp.setTolerances(rtol=1e-8)
        ksp.getPC().setType("gamg")
        solver.A.setNearNullSpace(rigid_modes(V))
    iterations = []
    clock.cpu["residual"] = clock.cpu["tangent"] = 0.0
    with clock("solve loop"):
        for step in range(1, given.steps + 1):
            end.interpolate(lambda x, load=step / STEPS: turned(x.T, load).T)
            iterations.append(solver.solve(u)[0])
    values, residual = at_vertices(u), out_of_balance(problem, u)
    if COMM.rank == 0:
        row = {"Newton": iterations, "residual": residual, "tolerance": smallest}
        report(f"DOLFINx {given.solver}", given, clock, values, **about, **row)


def out_of_balance(problem, u):
    """Norm of the residual, which is zero where u is prescribed."""
    b = fem_petsc.create_vector(problem.L)
    problem.F(u.x.petsc_vec, b)
    return b.norm()


def assemble(times, problem, u):
    """Median CPU seconds of residual and tangent at a bent state, supports in."""
    u.interpolate(lambda x: bent(x.T).T)
    A, b = fem_petsc.create_matrix(problem.a), fem_petsc.create_vector(problem.L)
    x = u.x.petsc_vec
    seconds = {"residual": [], "tangent": []}
    for _ in range(times):
        for name, work in (("residual", problem.F), ("tangent", problem.J)):
            start = time.process_time()
            work(x, b if name == "residual" else A)
            seconds[name].append(time.process_time() - start)
    return {f"{name}, once [s]": float(np.median(t)) for name, t in seconds.items()}


if __name__ == "__main__":
    main()
