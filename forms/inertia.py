# SPDX-License-Identifier: MIT
"""The mass of a body: nodal momenta, kinetic energy, momentum and angular momentum."""

from __future__ import annotations

from typing import Any

from petsc4py import PETSc

import numpy as np
import ufl
from dolfinx import default_scalar_type, fem
from dolfinx.fem import petsc as fem_petsc
from numpy.typing import NDArray

from . import _checks, _dolfinx, insertion
from ._types import Expr
from .compilation import compiled
from .quadrature import SIMPLICES, with_quadrature
from .slants import Slants
from .unknowns import Field
from .variation import residual, tangent

Array = NDArray[np.float64]


class Inertia:
    """int rho/2 |y|^2 dX of a field y beside an unknown, and its derivatives M y and M. Collective.

    Args:
        u: Unknown.
        field: Its displacement.
        rho: Mass per reference volume [kg/m^3].
        weight: Thickness, or circumference, by which it is multiplied.
        dx: Measure of what has mass.
        lumped: Whether the mass is lumped at the nodes.

    Attributes:
        rho: Mass density in UFL.
        dx: Measure, of points at the nodes where it is lumped.
        nodes: Numbers in an array of u of each node's components, ghosts included.
        others: Those of all other fields.
    """

    def __init__(
        self,
        u: fem.Function,
        field: Field,
        rho: Any,
        weight: Expr,
        dx: ufl.Measure,
        lumped: bool,
    ) -> None:
        V = u.function_space
        self._u, self._field, self._weight = u, field, weight
        self.rho = given(V.mesh, rho, "rho")
        self.dx = _lumping(dx, u, field.degree) if lumped else dx
        self.carrier = fem.Function(V)
        form = with_quadrature(self.form(self.part(self.carrier)), field.degree)
        self._ufl = residual(form, self.carrier)
        self._form = compiled(self._ufl)
        owned = V.dofmap.index_map.size_local * V.dofmap.bs
        self.nodes = field.collapsed[1].reshape(-1, field.components)
        self.others = np.setdiff1d(np.arange(u.x.array.size), self.nodes)
        self._own = self.nodes[np.all(self.nodes < owned, axis=1)]
        self._places = self._coordinates()

    def part(self, f: fem.Function) -> Expr:
        """The displacement's part of a Function of the unknown's space."""
        return f if self._field.place is None else ufl.split(f)[self._field.place]

    def form(self, y: Expr, factor: Any = 1.0) -> ufl.Form:
        """Factor int rho/2 |y|^2 dX."""
        return factor / 2 * self.rho * self._weight * ufl.inner(y, y) * self.dx

    def of(self, values: Array) -> Array:
        """M y, own entries: of a velocity nodal momenta, of an acceleration forces. Collective."""
        self.carrier.x.array[:] = values
        b = fem_petsc.create_vector(self._form)
        fem_petsc.assemble_vector(b, self._form)
        b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        found = np.asarray(b.array_r.copy())
        b.destroy()
        return found

    def balance(self, forces: Array, x: Array) -> Array:
        """Sum of nodal forces, and of their moments about the origin, shape (6,). Collective.

        Args:
            forces: Own entries.
            x: Displacement, with ghosts.
        """
        f = self._space(forces[self._own])
        places = self._space(self._places + x[self._own])
        own = np.concatenate([f.sum(axis=0), np.cross(places, f).sum(axis=0)])
        return np.asarray(self._u.function_space.mesh.comm.allreduce(own))

    def rigid(self, balance: Array, x: Array, masses: Array, turns: bool) -> Array:
        """Velocity of a rigid motion with given momenta, own entries; masses lumped. Collective.

        Args:
            balance: Momentum and angular momentum about the origin, as :meth:`balance` has them.
            x: Displacement, with ghosts.
            masses: M of the field that is 1 everywhere, own entries.
            turns: Whether the body can turn.
        """
        comm = self._u.function_space.mesh.comm
        m, places = masses[self._own], self._space(self._places + x[self._own])
        dim = m.shape[1]
        modes: NDArray = np.zeros((len(m), 3, 6))
        modes[:, range(3), range(3)] = 1
        for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            modes[:, j, 3 + i], modes[:, k, 3 + i] = -places[:, k], places[:, j]
        modes = modes[:, :dim]
        # A plane body turns about z alone, one of revolution moves along its axis alone.
        free = {3: [*range(6)] if turns else [2], 2: [0, 1, 5] if turns else [1]}[dim]
        modes = modes[:, :, free]
        B = comm.allreduce(np.einsum("nij,ni,nik->jk", modes, m, modes))
        found = np.zeros(len(masses))
        found[self._own] = modes @ np.linalg.lstsq(B, balance[free], rcond=1e-12)[0]
        return found

    @staticmethod
    def _space(values: Array) -> Array:
        return np.pad(values, ((0, 0), (0, 3 - values.shape[1])))

    def matrix(self) -> PETSc.Mat:
        """M, of the unknown's layout; 0 for fields without inertia. Collective."""
        form = compiled(tangent(self._ufl, self.carrier))
        A = insertion.create_matrix(form, [])
        insertion.assemble(A, form, [])
        return A

    def solve(self, forces: Array, held: NDArray[np.int32], slants: Slants | None = None) -> Array:
        """M^-1 f, own entries, 0 where something is prescribed. Collective."""
        A = self.matrix()
        free = np.setdiff1d(self._own.ravel(), held)
        left = np.setdiff1d(np.arange(A.getLocalSize()[0]), free)
        rows = (left + A.getOwnershipRange()[0]).astype(PETSc.IntType)
        A.zeroRowsColumns(rows, diag=1.0)
        b, x = A.createVecs()
        b.array[free] = forces[free]
        if slants is not None:
            slants.apply(A)
            slants.clear(b.array)
        ksp = PETSc.KSP().create(A.comm)
        ksp.setOperators(A)
        ksp.setType("cg")
        ksp.getPC().setType("jacobi")
        ksp.setTolerances(rtol=1e-14, max_it=1000)
        ksp.solve(b, x)
        found = np.asarray(x.array_r.copy())
        for item in (ksp, A, b, x):
            item.destroy()
        return found

    def momenta(self, velocity: Array, momentum: Array, turns: bool) -> dict[str, Any]:
        """Kinetic energy, momentum and angular momentum about the origin. Collective.

        Args:
            velocity: v, with ghosts.
            momentum: M v, own entries.
            turns: Whether the body can turn: not one of revolution.

        Returns:
            "kinetic" [J], "momentum" [kg m/s], "angular_momentum" [kg m^2/s]: a vector, or a number
            on plane bodies; none of bodies of revolution.
        """
        q, dim = momentum[self._own], self._field.components
        v = velocity[self._own]
        x = self._places + self._u.x.array[self._own]
        x, q = self._space(x), self._space(q)
        own = np.concatenate([[np.sum(v * q[:, :dim])], q.sum(axis=0), np.cross(x, q).sum(axis=0)])
        total = self._u.function_space.mesh.comm.allreduce(own)
        found = {"kinetic": float(total[0] / 2), "momentum": total[1 : 1 + dim]}
        if turns:
            found["angular_momentum"] = total[4:] if dim == 3 else float(total[6])
        return found

    def _coordinates(self) -> Array:
        """Reference positions of the nodes, in the displacement's entries of an array."""
        x, dim = fem.Function(self._u.function_space), self._field.components
        part = x if self._field.place is None else x.sub(self._field.place)
        part.interpolate(lambda y: y[:dim])
        return np.asarray(x.x.array)[self._own]


def given(mesh: Any, value: Any, what: str) -> Expr:
    """A number as a Constant, which another number does not compile again; or an expression."""
    number = _checks.number(value)
    if number is not None:
        return fem.Constant(mesh, default_scalar_type(number))
    if not isinstance(value, ufl.core.expr.Expr) or value.ufl_shape != ():
        raise ValueError(
            f"{what} is a number or a scalar in UFL, got {type(value).__name__}: for regions take "
            "a DG0 Function."
        )
    return value


def _lumping(dx: ufl.Measure, u: fem.Function, degree: int) -> ufl.Measure:
    """A measure whose points are the nodes.

    Raises:
        ValueError: lumped masses would not be positive.
    """
    cell = _dolfinx.cell_name(u.function_space.mesh.ufl_cell())
    if (degree > 1 and cell in SIMPLICES) or degree > 2:
        raise ValueError(
            f"a lumped mass needs linear elements, or quadratic ones on quadrilaterals and "
            f"hexahedra, where all nodes get a positive part; got degree {degree} on {cell}s."
        )
    rule = {"quadrature_rule": "vertex", "quadrature_degree": 1}
    if degree == 2:
        rule = {"quadrature_rule": "GLL", "quadrature_degree": 3}
    return dx(metadata={**dx.metadata(), **rule})
