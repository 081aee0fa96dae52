# SPDX-License-Identifier: MIT
"""Small vibrations about an equilibrium: frequencies and modes, K v = omega^2 M v."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import dataclass
from typing import Any

from petsc4py import PETSc

import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray

from .. import _checks
from .._parallel import bounding_box
from ..inertia import Inertia, given
from ..kinematics import circumference, is_revolved
from ..paths import Path
from ..problems import Problem
from .linear.diagonal import pressures, typical_diagonal
from .stability import _factored, _finite_tangent, _mode, _negative_pivots, _use_mumps
from .supported import _modes, _named, _pad

RIGID = 1e-6  # of the first elastic omega^2, below which a mode may be a rigid motion
STRAY = 1e-3  # part of a mode outside of the rigid motions, up to which it is one


@dataclass(frozen=True)
class Modes:
    """Small vibrations, the slowest first.

    Attributes:
        omega2: Squares of the angular frequencies [1/s^2]; negative where the state is unstable.
        modes: Functions of the unknown's space, the largest displacement component of each 1;
            ``forms.picture(modes.modes[0], …, scale=…)`` draws one.
        names: Of rigid motions in words, which the first modes span; "" for vibrations.
    """

    omega2: NDArray[np.float64]
    modes: list[fem.Function]
    names: list[str]

    @property
    def frequencies(self) -> NDArray[np.float64]:
        """Frequencies [Hz]; of an unstable mode minus its rate of growth over 2 pi."""
        return np.sign(self.omega2) * np.sqrt(np.abs(self.omega2)) / (2 * np.pi)

    def __str__(self) -> str:
        """A line for each."""
        pairs = zip(self.frequencies, self.names, strict=True)
        return "\n".join(f"{value:14.6g} Hz  {name}".rstrip() for value, name in pairs)


def frequencies(
    problem: Problem | Path,
    rho: Any = None,
    count: int = 6,
    *,
    lumped: bool = False,
    thickness: Any = 1.0,
    dx: ufl.Measure | None = None,
) -> Modes:
    """Lowest frequencies and modes of small vibrations about the present state. Collective.

    K v = omega^2 M v with the tangent K at u, prestress included. By SLEPc, the inverse shifted
    below all of them; by the pivots of a factorization none is missed.

    Args:
        problem: Path or problem, of statics or of a motion, whose rho is taken.
        rho: Mass per reference volume [kg/m^3], a number or a scalar in UFL.
        count: How many.
        lumped: Whether the mass is lumped, as of :func:`forms.transient`.
        thickness: Of a sheet [m].
        dx: Measure of what has mass; by default all cells.

    Raises:
        ValueError: no potential, no mass density, count below 1 or above the number of free
            degrees of freedom.
        ImportError: slepc4py is missing.
    """
    found = problem.problem if isinstance(problem, Path) else problem
    motion, field = found.motion, found.displacement
    if not found.symmetric or field is None:
        raise ValueError(
            "frequencies are those of a body with a potential and a displacement, got a virtual "
            "work, a residual, or no displacement."
        )
    if rho is None and motion is None:
        raise ValueError("frequencies need the mass density, rho = 1000.0 [kg/m^3], got none.")
    number = _checks.number(rho)
    if number is not None and not 0 < number < np.inf:
        raise ValueError(f"frequencies need a mass density rho > 0 [kg/m^3], got {number:g}.")
    free = np.setdiff1d(field.dofs, found.constrained)
    slanted = 0 if found.slants is None else found.slants.count
    most = found.comm.allreduce(len(free) - slanted)
    if not 1 <= count <= most:
        raise ValueError(f"frequencies are from 1 to {most} here, got count = {count}.")
    if rho is None:
        inertia = motion.inertia
    else:
        revolved = is_revolved(found.forms.potential)
        weight = given(found.u.function_space.mesh, thickness, "a thickness")
        weight *= circumference(field.expression) if revolved else ufl.as_ufl(1.0)
        measure = _checks.measure(ufl.dx if dx is None else dx, "a mass")
        inertia = Inertia(found.u, field, rho, weight, measure, lumped)
    with nullcontext() if motion is None else motion.without_inertia():
        K = _finite_tangent(found)
        M = inertia.matrix()
        rows = (found.constrained + M.getOwnershipRange()[0]).astype(PETSc.IntType)
        M.zeroRowsColumns(rows, diag=0.0)
        if found.slants is not None:
            found.slants.apply(M, 0.0)
        values, modes = _lowest(found, K, M, free, count, most)
        for matrix in (K, M):
            matrix.destroy()
    order = np.argsort(values)
    omega2, modes = values[order], [modes[k] for k in order]
    return Modes(omega2, modes, _names(found, omega2, modes))


def _lowest(
    problem: Problem, K: PETSc.Mat, M: PETSc.Mat, free: NDArray, count: int, most: int
) -> tuple[NDArray, list[fem.Function]]:
    """The lowest ones, none of which is missed. Collective.

    Raises:
        ValueError: they were not found.
    """
    try:
        from slepc4py import SLEPc
    except ImportError as error:
        raise ImportError(
            "frequencies need slepc4py, which is not installed: install Debian's "
            "python3-slepc4py, or variform's extra 'modes' beside a SLEPc of PETSc's version."
        ) from error
    stiffness, mass = typical_diagonal(K, free), typical_diagonal(M, free)
    nodes = max(most // max(problem.u.function_space.mesh.geometry.dim, 1), 1)
    shift = 1e-2 * stiffness / mass / nodes ** (2 / problem.u.function_space.mesh.topology.dim)
    beside = pressures(problem, K)
    while _below(K, M, -shift) > beside:
        shift *= 10
    asked = count
    for _ in range(4):
        solver = SLEPc.EPS().create(problem.comm)
        solver.setOperators(K, M)
        solver.setProblemType(SLEPc.EPS.ProblemType.GHEP)
        solver.setDimensions(min(asked, most))
        solver.setTolerances(1e-12, 500)
        solver.setWhichEigenpairs(SLEPc.EPS.Which.TARGET_REAL)
        solver.setTarget(-shift)
        transform = solver.getST()
        transform.setType(SLEPc.ST.Type.SINVERT)
        transform.setShift(-shift)
        _use_mumps(transform.getKSP())
        solver.solve()
        number = solver.getConverged()
        values, modes = np.empty(number), []
        vector = K.createVecRight()
        for k in range(number):
            values[k] = solver.getEigenvalue(k).real
            solver.getEigenvector(k, vector)
            modes.append(_mode(problem, vector))
        for item in (solver, vector):
            item.destroy()
        order = np.argsort(values)[:count]
        if number >= count:
            highest = float(values[order[-1]])
            above = highest + 1e-6 * max(abs(highest), shift)
            lower = int(np.sum(values < above))
            if _below(K, M, above) - beside == lower:
                return values[order], [modes[k] for k in order]
        asked *= 2
    raise ValueError(f"the {count} lowest frequencies were not all found: ask for fewer.")


def _below(K: PETSc.Mat, M: PETSc.Mat, value: float) -> int:
    """Number of eigenvalues below one, those of pressures included. Collective."""
    shifted = K.duplicate(copy=True)
    shifted.axpy(-value, M, structure=PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
    ksp = _factored(shifted)
    negative = _negative_pivots(ksp.getPC())
    ksp.destroy()
    shifted.destroy()
    return negative


def _names(problem: Problem, omega2: NDArray, modes: list[fem.Function]) -> list[str]:
    """Words for the rigid motions among the modes. Collective."""
    field = problem.displacement
    assert field is not None
    mesh, comm = problem.u.function_space.mesh, problem.comm
    dim, numbers = field.components, field.collapsed[1].reshape(-1, field.components)
    owned = problem.u.function_space.dofmap
    own = numbers[np.all(numbers < owned.index_map.size_local * owned.bs, axis=1)]
    low, high = bounding_box(comm, mesh.geometry.x)
    center, size = (low + high) / 2, float(np.linalg.norm(high - low))
    places = fem.Function(problem.u.function_space)
    part = places if field.place is None else places.sub(field.place)
    part.interpolate(lambda x: x[:dim])
    x = (places.x.array + problem.u.x.array)[own] - center[:dim]
    rigid = _modes(np.pad(x, ((0, 0), (0, 3 - dim))) / size, dim)
    gram = comm.allreduce(rigid.T @ rigid)
    elastic = np.abs(omega2).max()
    found = []
    for value, mode in zip(omega2, modes, strict=True):
        v = mode.x.array[own].ravel()
        parts = comm.allreduce(np.append(rigid.T @ v, v @ v))
        inside = np.linalg.lstsq(gram, parts[:-1], rcond=1e-10)[0]
        stray = 1 - inside @ parts[:-1] / parts[-1]
        if abs(value) < RIGID * elastic and stray < STRAY**2:
            found.append(inside)
    if not found:
        return [""] * len(modes)
    words = _named(_pad(np.linalg.qr(np.array(found).T)[0], dim), center, size)
    words += ["a rigid motion"] * (len(found) - len(words))
    return [*words[: len(found)], *[""] * (len(modes) - len(found))]
