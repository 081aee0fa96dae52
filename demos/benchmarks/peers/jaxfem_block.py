# SPDX-License-Identifier: MIT
"""The block in JAX-FEM: the energy differentiated by JAX, its own solver, MUMPS or its default.

JAX-FEM fills its matrix by two methods of petsc4py that the version here has not, although its
PETSc has the functions behind them: :class:`Mat` adds them.
"""

import ctypes
import os

os.environ.setdefault(
    "XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
)

import contextlib
import logging
import sys
from importlib import metadata

from petsc4py import PETSc

import jax
import jax.numpy as jnp
import numpy as np

from .newton import medians
from .problem import (
    LMBDA,
    MU,
    STEPS,
    STRETCH,
    TWIST,
    Clock,
    arguments,
    bent,
    block,
    quadratic,
    report,
    tolerance,
)

with contextlib.redirect_stdout(sys.stderr):  # a banner
    from jax_fem import logger, solver
    from jax_fem.generate_mesh import Mesh
    from jax_fem.problem import Problem

PETSC = ctypes.CDLL(PETSc.__file__)
FLOATS = np.ctypeslib.ndpointer(np.float64, flags="C_CONTIGUOUS")
INTEGERS = np.ctypeslib.ndpointer(PETSc.IntType, flags="C_CONTIGUOUS")
PETSC.MatSetPreallocationCOO.argtypes = (ctypes.c_void_p, ctypes.c_int64, INTEGERS, INTEGERS)
PETSC.MatSetValuesCOO.argtypes = (ctypes.c_void_p, FLOATS, ctypes.c_int)


class Mat(PETSc.Mat):
    """A PETSc matrix that is filled from entries (row, column, value), equal places added."""

    def setPreallocationCOO(self, rows, columns):
        """Rows and columns of all entries."""
        # PETSc sorts them in place.
        parts = [np.array(part, dtype=PETSc.IntType) for part in (rows, columns)]
        check(PETSC.MatSetPreallocationCOO(self.handle, len(parts[0]), *parts))

    def setValuesCOO(self, values):
        """Values of the entries, in their order."""
        check(PETSC.MatSetValuesCOO(self.handle, np.ascontiguousarray(values), 1))


def check(error):
    """Raise on one of PETSc's error codes."""
    if error:
        raise PETSc.Error(error)


class Block(Problem):
    """The energy of :mod:`.problem`."""

    def get_tensor_map(self):
        """First Piola-Kirchhoff stress of a displacement gradient."""

        def energy(F):
            J = jnp.linalg.det(F)
            return MU / 2 * (jnp.sum(F * F) - 3) - MU * jnp.log(J) + LMBDA / 2 * jnp.log(J) ** 2

        return lambda gradient: jax.grad(energy)(gradient + jnp.eye(3))


def supports(load):
    """JAX-FEM's description of the two ends."""

    def component(i):
        def value(point):
            angle = load * TWIST
            y, z = point[1] - 0.1, point[2] - 0.1
            c, s = jnp.cos(angle), jnp.sin(angle)
            return jnp.array([STRETCH * load, c * y - s * z - y, s * y + c * z - z])[i]

        return value

    def end(at):
        # JAX-FEM counts the arguments: a second one would be given the number of the point.
        return lambda point: jnp.isclose(point[0], at)

    values = [lambda point: 0.0] * 3 + [component(i) for i in range(3)]
    return [[end(0.0)] * 3 + [end(1.0)] * 3, [0, 1, 2] * 2, values]


def main():
    """Solve, or assemble, and print the row."""
    given = arguments(solver=("mumps", "bicgstab"))
    logger.setLevel(logging.WARNING)
    PETSc.Mat = Mat
    clock = Clock()
    points, cells = block(given.m)
    vertices, smallest = len(points), tolerance(points)
    kind = "TET4"
    if given.degree == 2:
        points, cells = quadratic(points, cells)
        kind = "TET10"
    problem = Block(
        Mesh(points, cells, ele_type=kind),
        vec=3,
        dim=3,
        ele_type=kind,
        quadrature_order=given.degree,
        dirichlet_bc_info=supports(0.01),
    )
    about = {"dofs": points.size, "version": metadata.version("jax-fem"), "solver": given.solver}
    if given.assemble:
        report("JAX-FEM", given, Clock(), **about, **assemble(given.assemble, problem, points))
        return

    def mumps(A, b, x0, options):
        with clock("linear"):
            method = PETSc.KSP().create()
            method.setOperators(A)
            method.setType("preonly")
            method.pc.setType("lu")
            method.pc.setFactorSolverType("mumps")
            right = PETSc.Vec().createWithArray(np.array(b))
            x = right.duplicate()
            method.solve(right, x)
            method.destroy()
            return x.array.copy()

    options = {"linear": {"custom_solver": mumps} if given.solver == "mumps" else {}}
    iterations, norms = [], []
    update = problem.newton_update

    def counted(u):
        with clock("assembly"):
            R = jax.block_until_ready(update(u))
        inner = np.asarray(R[0])[free]
        norms.append(float(np.linalg.norm(inner)))
        return R

    free = ~(np.isclose(points[:, 0], 0) | np.isclose(points[:, 0], 1))
    problem.newton_update = counted
    with contextlib.redirect_stdout(sys.stderr):
        with clock("compile"):  # everything is traced and compiled in one iteration
            solver.solver(problem, {"newton": {**options, "rel_tol": 0.5, "tol": 0.0}})
        clock.cpu |= {"assembly": 0.0, "linear": 0.0}
        clock.wall |= {"assembly": 0.0, "linear": 0.0}
        with clock("solve loop"):
            for step in range(1, given.steps + 1):
                before = len(norms)
                problem.fes[0].update_Dirichlet_boundary_conditions(supports(step / STEPS))
                options |= {"rel_tol": 0.0, "tol": smallest}
                solution = solver.solver(problem, {"newton": options})
                options["initial_guess"] = solution
                iterations.append(len(norms) - before - 1)
    about |= {"Newton": iterations, "residual": norms[-1], "tolerance": smallest}
    values = np.asarray(solution[0])[:vertices]
    report(f"JAX-FEM {given.solver}", given, clock, values, **about)


def assemble(times, problem, points):
    """Median CPU seconds of residual and tangent; the tangent's brings the residual along."""
    u = [jnp.array(bent(points))]

    def residual():
        jax.block_until_ready(problem.compute_residual(u))

    def tangent():
        jax.block_until_ready(problem.newton_update(u))
        solver.get_A(problem)

    residual()
    tangent()
    return medians(times, residual=residual, tangent=tangent)


if __name__ == "__main__":
    main()
