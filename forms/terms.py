# SPDX-License-Identifier: MIT
"""Summands of a potential: what each adds to energy, residual and tangent.

All that is written in UFL is one :class:`FormTerm`, with one pattern and one insertion. Anything
else that has an energy and its derivatives is a class with the methods of :class:`Term`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

from petsc4py import PETSc

import numpy as np
import ufl
from dolfinx import default_scalar_type, fem
from dolfinx.fem import petsc as fem_petsc
from numpy.typing import NDArray
from ufl.algorithms.analysis import extract_constants

from . import _checks, _dolfinx, insertion
from .barriers import Barrier, Barriers
from .batches import Sums
from .compilation import compiled
from .differentiation import Dependent, dependents, expanded
from .kinematics import circumference, is_revolved
from .loads import with_kinematics
from .moduli import Moduli
from .operators.jets import Jet
from .quadrature import with_quadrature
from .variation import residual, tangent

SOFT = 0.2  # stiffness of obstacles over the body's own modulus


class Term(Protocol):
    """One summand of a problem's potential, or of its virtual work; all methods are collective.

    They evaluate at the unknown's present values. ``prepare`` comes before the others wherever
    these have changed, ``commit`` when a state is accepted, ``rollback`` when one is refused and
    the last accepted one is back.
    """

    def prepare(self) -> None:
        """Do what a state needs once: a local Newton method, a search of contacts."""

    def energy(self) -> float | None:
        """Energy [J] over all ranks; None where there is no potential."""

    def residual(self, b: PETSc.Vec) -> None:
        """Add the residual to a vector with ghosts, which are added up afterwards."""

    def tangent(self, A: PETSc.Mat, projected: bool = False) -> None:
        """Add the tangent, positive semi-definite if projected; supports are left out later."""

    def largest_step(self, step: PETSc.Vec) -> float:
        """Fraction of a step, at most 1, up to which the energy stays finite."""

    def commit(self) -> None:
        """Take the present state for the last accepted one."""

    def rollback(self) -> None:
        """Return to the last accepted state."""

    def history(self) -> dict[str, NDArray]:
        """What is kept besides the unknown; a path with such a term takes no checkpoints yet."""


class FormTerm:
    """All UFL forms of a problem: a potential or a residual, and virtual works.

    Args:
        potential: Total potential [J], a functional of u; or a residual, a form linear in a test
            function, where there is no potential at all.
        u: Unknown.
        degree: Degree of the displacements, for the default quadrature.
        virtual_work: Linear form added to the residual, for loads without a potential.
        conditions: Boundary conditions, whose rows and columns of the tangent are those of
            identity.

    Integrals without a quadrature degree get that of :func:`forms.quadrature.quadrature_degree`,
    the same in energy, residual and tangent, so that they are exact derivatives of each other.

    Attributes:
        energy_form: Compiled potential; None where only a residual was given.
        residual_form: Compiled residual.
        tangent_form: Compiled tangent.
        residual_ufl, tangent_ufl: Residual and tangent in UFL.
        potential: Total potential, or residual, that all of it was derived from.
        virtual_work: What was added to the residual, in UFL; None for nothing.
        constants: Constants in the forms.
        barriers: Obstacles of the potential.
        moduli: By which the tangent is assembled; None where FFCx's kernels do.
    """

    def __init__(
        self,
        potential: ufl.Form,
        u: fem.Function,
        degree: int,
        virtual_work: ufl.Form | None,
        conditions: list[fem.DirichletBC],
    ) -> None:
        need = "a potential must be a functional of u, or a residual in one test function"
        if isinstance(potential, ufl.Form):
            _checks.arity(potential, len(potential.arguments()), need)
        if isinstance(virtual_work, ufl.Form) and virtual_work.arguments():
            need = "virtual_work must be a form linear in one test function"
            _checks.arity(virtual_work, len(virtual_work.arguments()), need)
        potential, virtual_work = with_kinematics(potential, virtual_work)
        self.potential = potential = with_quadrature(potential, degree)
        is_energy = isinstance(potential, ufl.Form) and not potential.arguments()
        R = residual(potential, u) if is_energy else potential
        if virtual_work is not None:
            is_form = isinstance(virtual_work, ufl.Form)
            count = len(virtual_work.arguments()) if is_form else "no form"
            if count != 1:
                raise ValueError(
                    "virtual_work must be a form linear in one test function, got one with "
                    f"{count}; add a load's potential to the potential instead."
                )
            R = with_quadrature(R + virtual_work, degree)
            virtual_work = with_quadrature(virtual_work, degree)
        self.virtual_work = virtual_work
        self.residual_ufl, self.tangent_ufl = R, (K := tangent(R, u))
        parts = [expanded(potential), R]
        parts += [c.jets.packed for part in parts for c in dependents(part) if isinstance(c, Jet)]
        found = dict.fromkeys(c for part in parts for c in dependents(part))
        self.symmetric = is_energy and virtual_work is None
        self._u, self._conditions = u, conditions
        self.energy_form = compiled(potential) if is_energy else None
        self.residual_form, self.tangent_form = compiled(R), compiled(K)
        self.projected_form: fem.Form | None = None
        self.moduli: Moduli | None = None
        self._sums: tuple[Sums, Sums] | None = None  # energy; residual with energy
        self._action: fem.Form | None = None
        self._dependents: list[Dependent] = [c for c in found if not isinstance(c, Jet)]
        self.constants = tuple(c for part in parts for c in extract_constants(part))
        self.barriers = Barriers(potential, u.function_space.mesh.comm)

    @property
    def hides_constants(self) -> bool:
        """Whether coefficients that depend on the unknown may contain Constants unseen."""
        return bool(self._dependents)

    def prepare(self) -> None:
        """Bring coefficients that depend on the unknown up to date."""
        for coefficient in self._dependents:
            coefficient.update()

    def energy(self) -> float | None:
        """Potential at u [J] over all ranks; None where only a residual was given. Collective."""
        if self.energy_form is None:
            return None
        with np.errstate(all="ignore"):
            sums = self._sums
            own = fem.assemble_scalar(self.energy_form) if sums is None else sums[0].value()
            return float(self._u.function_space.mesh.comm.allreduce(own))

    def create_vector(self) -> PETSc.Vec:
        """PETSc vector of the unknown's layout, with ghosts."""
        return _dolfinx.create_vector(self.residual_form)

    def create_matrix(self) -> PETSc.Mat:
        """PETSc AIJ matrix for the tangent."""
        return insertion.create_matrix(self.tangent_form, self._conditions)

    def residual(self, b: PETSc.Vec) -> None:
        """Add the residual at u; no boundary condition enters."""
        if self._sums is None:
            fem_petsc.assemble_vector(b, self.residual_form)
            return
        with b.localForm() as local:
            self._sums[1].add(local.array)

    def energy_and_residual(self, b: PETSc.Vec) -> float | None:
        """Add the residual at u, as :meth:`residual`; the energy there, in one pass over the cells.

        None where only a residual was given. Collective.
        """
        if self._sums is None:
            self.residual(b)
            return self.energy()
        with b.localForm() as local, np.errstate(all="ignore"):
            own = self._sums[1].add_with_value(local.array)
        return float(self._u.function_space.mesh.comm.allreduce(own))

    def lift(self, b: PETSc.Vec, x: PETSc.Vec | None = None) -> None:
        """Add K (prescribed - x), x = u if not given, of entries at supports, by their cells alone.

        With u the change of the residual by a linear move to the supports.
        """
        x = self._u.x.petsc_vec if x is None else x
        fem_petsc.apply_lifting(b, [self.tangent_form], bcs=[self._conditions], x0=[x], alpha=-1.0)

    def add_action(self, b: PETSc.Vec, values: NDArray) -> None:
        """Add K v, the tangent without boundary conditions, of v with ghosts."""
        if self._action is None:
            self._along = fem.Function(self._u.function_space)
            self._action = compiled(ufl.action(self.tangent_ufl, self._along))
        self._along.x.array[:] = values
        fem_petsc.assemble_vector(b, self._action)

    def tangent(self, A: PETSc.Mat, projected: bool = False) -> None:
        """Assemble the tangent at u, in place of what was in A, supported rows those of identity.

        Args:
            A: Matrix of :meth:`create_matrix`.
            projected: Make each contribution positive semi-definite first: the second derivatives
                of energies in singular values at each point, the matrices of cells and facets of
                all other terms.
        """
        form, moduli = self.tangent_form, self.moduli
        if projected:
            self.prepare_projection()
            assert self.projected_form is not None
            form, moduli = self.projected_form, None
        insertion.assemble(A, form, self._conditions, moduli)

    def use_moduli(self) -> None:
        """Compile moduli and kernels of several cells, which assemble from now on. Collective.

        They pay from some thousand cells on; a tangent that is not symmetric has none.
        """
        if self.moduli is None and self.symmetric:
            moduli = Moduli(self.tangent_ufl)
            if moduli.rules:
                both = Sums(self.potential, self.residual_ufl)
                self.moduli, self._sums = moduli, (Sums(self.potential), both)

    def prepare_projection(self) -> None:
        """Compile the projected tangent, once. Collective.

        Raises:
            ValueError: the tangent has integrals that cannot be projected.
        """
        if self.projected_form is None:
            self.projected_form = compiled(self.tangent_ufl, project=True)

    def largest_step(self, step: PETSc.Vec, moves: Mapping[Any, float] | None = None) -> float:
        """1, or what obstacles leave of a step; states without a finite energy are refused.

        Args:
            step: Of the unknown, with room for ghosts.
            moves: Of Constants beside it.
        """
        if not self.barriers:
            return 1.0
        step.ghostUpdate(addv=PETSc.InsertMode.INSERT, mode=PETSc.ScatterMode.FORWARD)
        with step.localForm() as local:
            return self.barriers.largest_step(local.array_r, moves or {})

    def set_stiffness(self) -> None:
        """Give obstacles without a stiffness the body's own at rest on their boundary. Collective.

        k = sum K_ii h / (5 d A) over the nodes there, h apart, in d dimensions, and the area A: a
        fifth of a modulus, to two digits, alike on any number of ranks.

        Raises:
            ValueError: the tangent at rest has no diagonal there.
        """
        unset = [b for b in self.barriers.all if b.label.unset]
        if not unset:
            return
        u, reaches = self._u, [b.label.reach for b in self.barriers.all]
        kept, values = [float(c.value) for c in reaches], u.x.array.copy()
        u.x.array[:] = 0
        for c in reaches:
            c.value = -1e300  # nothing acts
        self.prepare()
        A = insertion.create_matrix(self.tangent_form)  # of supported nodes, too
        insertion.assemble(A, self.tangent_form, [])
        diagonal = A.getDiagonal().array_r.copy()
        A.destroy()
        u.x.array[:] = values
        for c, value in zip(reaches, kept, strict=True):
            c.value = value
        self.prepare()
        for barrier in unset:
            if barrier.label.unset:  # one of several distances may have set it
                barrier.label.stiffness.value = self._softened(barrier, diagonal)

    def _softened(self, barrier: Barrier, diagonal: NDArray) -> float:
        label, mesh = barrier.label, self._u.function_space.mesh
        mark = self.create_vector()
        with mark.localForm() as local:
            local.array[barrier.dofs] = 1
        mark.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        there = mark.array_r > 0
        mark.destroy()
        one = (
            circumference(self._u)
            if is_revolved(self.potential)
            else fem.Constant(mesh, default_scalar_type(1.0))
        )
        area = fem.assemble_scalar(compiled(one * label.measure))
        total, area = mesh.comm.allreduce(np.array([diagonal[there].sum(), area]))
        size = label.facet / label.field.degree
        k = SOFT * total / mesh.geometry.dim * size / area
        if not 0 < k < np.inf:
            raise ValueError(
                f"the body has no stiffness at rest where the obstacle {label.name} acts, from "
                f"which to take that of its barrier, got {k:.3g} Pa: give it a stiffness= of "
                "about the pressures expected."
            )
        return float(f"{k:.1e}")

    def commit(self) -> None:
        """Remember where the points of obstacles are."""
        self.barriers.remember()

    def rollback(self) -> None:
        """Bring coefficients up to date with the unknown's values."""
        self.prepare()
        self.barriers.remember()

    def history(self) -> dict[str, Any]:
        """Nothing besides the unknown."""
        return {}
