# SPDX-License-Identifier: MIT
"""Linear solver presets, chosen by size, dimension and symmetry; PETSc options override them."""

from __future__ import annotations

from typing import Any

from petsc4py import PETSc

from ...problems import Problem
from ...unknowns import Role
from .diagonal import pressures

# Measured with OpenBLAS: in 3D multigrid is faster from 2,000 degrees of freedom on, but a
# factorization also counts negative eigenvalues, and up to 5,000 it takes a hundredth of a second.
# In the plane it is faster at every size tried (100 thousand).
DIRECT_UP_TO = 5_000
# With a pressure: faster up to 10 thousand in a cube and 40 in a slender bar of tetrahedra, of
# hexahedra up to 20 and 80.
SPLIT_FROM = {"tetrahedron": 40_000, "hexahedron": 80_000}


def direct(symmetric: bool) -> dict[str, str]:
    """MUMPS: LDL^T (which takes indefinite tangents) if symmetric, else LU."""
    return {
        "ksp_type": "preonly",
        "pc_type": "cholesky" if symmetric else "lu",
        "pc_factor_mat_solver_type": "mumps",
        "mat_mumps_icntl_14": "60",
        # The root of the elimination tree is not given to ScaLAPACK, so that pivots are counted.
        "mat_mumps_icntl_13": "1",
    }


def multigrid(degree: int = 1) -> dict[str, str]:
    """CG with multigrid: by aggregation, for elements of degree 2 and 3 over the order first.

    Newton's method is content with a direction that is 1 % off.
    """
    krylov = {"ksp_type": "cg", "ksp_rtol": "1e-2", "ksp_max_it": "200"}
    if degree > 1:
        return {**krylov, "pc_type": "mg"}
    # Weak couplings left out: half the iterations on tetrahedra of degree 1. Aggregates of two
    # levels twice: a tenth of the time, for one more iteration in thirty.
    return {**krylov, **aggregation("0.02"), "pc_gamg_aggressive_coarsening": "2"}


def field_split() -> dict[str, str]:
    """GMRES with the block preconditioner of :mod:`forms.solving.linear.fieldsplit`.

    Preconditioned from the right: its tolerance is that of the out-of-balance forces.
    """
    return {
        "ksp_type": "gmres",
        "ksp_pc_side": "right",
        "ksp_gmres_restart": "100",
        "ksp_rtol": "1e-3",
        "ksp_max_it": "100",
        "pc_type": "python",
    }


def aggregation(threshold: str = "-1") -> dict[str, str]:
    """Smoothed aggregation, with Gauss-Seidel smoothing; weaker couplings are left out."""
    return {
        "pc_type": "gamg",
        "pc_gamg_threshold": threshold,
        "mg_levels_ksp_type": "richardson",
        "mg_levels_ksp_max_it": "1",
        "mg_levels_pc_type": "sor",
    }


def preset(problem: Problem, A: PETSc.Mat | None = None, settings: Any = None) -> dict[str, str]:
    """Options for a problem's tangent. Collective.

    Multigrid for symmetric displacement problems of bodies in 3D above 5 thousand degrees of
    freedom, with the field split for symmetric displacement-pressure problems of degree 2 above 40
    thousand (hexahedra 80), else MUMPS.

    Args:
        problem: What is solved.
        A: Matrix for its tangent, which may be assembled here to see the second field's block.
        settings: :class:`forms.solving.settings.Settings` with the sizes from which on.
    """
    V = problem.u.function_space
    if V.mesh.topology.dim != 3:
        return direct(problem.symmetric)
    direct_up_to = DIRECT_UP_TO if settings is None else settings.direct_up_to
    split_from = SPLIT_FROM if settings is None else settings.split_from
    degree = problem.displacement_degree
    if problem.minimization and problem.is_displacement and problem.size > direct_up_to:
        return multigrid(degree)
    if problem.couples:  # whose tangents change their pattern, as the blocks of a split do not
        return direct(problem.symmetric)
    most = split_from.get(V.mesh.topology.cell_name(), max(split_from.values()))
    if problem.symmetric and problem.size > most and degree == 2 and _has_one_scalar(problem):
        if any(field.role is Role.UNDECLARED for field in problem.fields.values()):
            A = problem.create_matrix() if A is None else A
            problem.tangent(A)
        if pressures(problem, A):
            return field_split()
    return direct(problem.symmetric)


def _has_one_scalar(problem: Problem) -> bool:
    """Whether the unknown is a displacement and one scalar."""
    others = [f for f in problem.fields.values() if not f.is_displacement]
    return problem.displacement is not None and [f.components for f in others] == [1]
