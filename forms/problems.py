# SPDX-License-Identifier: MIT
"""Problems: terms, an unknown and supports, made once and solved as often as one likes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from numpy.typing import NDArray

from . import _checks, _petsc
from .kinematics import is_revolved
from .slants import Slants
from .supports import Support
from .terms import FormTerm, Term
from .unknowns import Field, displacement_field, fields_of


class Problem:
    """A potential, its residual and tangent, compiled, with the supports. Collective.

    ``solve``, ``follow`` and the others take one in place of a potential, and one that is used
    again keeps its compiled forms, matrices and solver.

    Args:
        potential: Total potential [J], a functional of u; or a residual, a form linear in a test
            function, where there is no potential at all; or a list of a form and of other
            :class:`forms.terms.Term` objects.
        u: Unknown; the assembling methods evaluate at its present values.
        supports: Prescribed displacements, and other fields.
        virtual_work: Linear form added to the residual, for loads without a potential.

    Attributes:
        u: Unknown.
        supports: Prescribed displacements, and other fields.
        forms: The term of everything written in UFL.
        terms: All terms, that one first.
        minimization: Whether the solution minimizes the energy: a potential of fields that are all
            minimized over, with no load that is a virtual work.
        symmetric: Whether the tangent is symmetric.
        constrained: Local numbers of the owned degrees of freedom that supports prescribe.
        slants: What supports prescribe along other directions than components; None for nothing.
        solver: What a solver keeps with the problem; None before the first solve.
        motion: The :class:`forms.motion.Motion` that it is a step of; None in statics.
        repatterned: Whether the last tangent may have another pattern than the one before.

    Raises:
        ValueError: a form of the wrong kind, one that does not contain u or contains a part of it
            from w.split(), or supports of another unknown.
    """

    def __init__(
        self,
        potential: Any,
        u: fem.Function,
        supports: Iterable[Support] | Support = (),
        virtual_work: ufl.Form | None = None,
    ) -> None:
        field = displacement_field(_checks.function(u, "a solve"))
        degree = (field or next(iter(fields_of(u).values()))).degree
        self.u, self.supports = u, _listed(supports, u)
        self.solver: Any = None
        self._uncoupled: PETSc.Mat | None = None
        self._joined: set[int] = set()
        self.repatterned = False
        self.motion: Any = None
        potential, others = _parted(potential)
        _check_parts(potential, u)
        _checks.form_of(virtual_work, u.function_space.mesh, "a virtual work")
        self.forms = FormTerm(potential, u, degree, virtual_work, self.conditions)
        self.terms: tuple[Term, ...] = (self.forms, *others)
        if self.couples and is_revolved(self.forms.potential):
            raise ValueError(
                "contact of surfaces knows no bodies of revolution, got one: take forms.obstacle, "
                "or a sector of the body in space."
            )
        self.forms.set_stiffness()
        self.symmetric = self.forms.symmetric
        curvatures = {f.role.curvature for f in self.fields.values()}
        self.minimization = self.has_energy and self.symmetric and curvatures == {"+"}
        dofmap = u.function_space.dofmap
        dofs = [bc.dof_indices()[0] for bc in self.conditions]
        # dof_indices of 0.9 may count ghosts as owned in a blocked space: compare numbers instead.
        found = np.unique(np.concatenate([*dofs, np.empty(0, np.int32)]))
        owned = dofmap.index_map.size_local * dofmap.bs
        self.constrained: NDArray[np.int32] = found[found < owned].astype(np.int32)
        slanted = [s.slant for s in self.supports if s.slant is not None]
        self.slants = Slants(u.function_space, slanted, found) if slanted else None

    @property
    def comm(self) -> MPI.Comm:
        """Communicator of the mesh."""
        return self.u.function_space.mesh.comm

    @cached_property
    def conditions(self) -> list[fem.DirichletBC]:
        """Boundary conditions of all supports, in their order (the last one wins)."""
        return [bc for support in self.supports for bc in support.conditions]

    @property
    def has_energy(self) -> bool:
        """Whether a potential was given."""
        return self.forms.energy_form is not None

    def depends_on(self, t: fem.Constant) -> bool:
        """Whether the forms or the supports contain a constant."""
        if self.forms.hides_constants:
            return True
        inside = any(c is t for c in self.forms.constants)
        return inside or any(support.depends_on(t) for support in self.supports)

    @property
    def is_displacement(self) -> bool:
        """Whether the unknown is a displacement and nothing else."""
        return len(self.fields) == 1 and self.displacement is not None

    @property
    def fields(self) -> dict[str, Field]:
        """Fields of the unknown by name."""
        return fields_of(self.u)

    @property
    def displacement(self) -> Field | None:
        """The field that moves points of the body; None where there is none."""
        return displacement_field(self.u)

    @property
    def displacement_degree(self) -> int:
        """Degree of the displacement, or of the first field where there is none."""
        return (self.displacement or next(iter(self.fields.values()))).degree

    @property
    def size(self) -> int:
        """Degrees of freedom on all ranks."""
        dofmap = self.u.function_space.dofmap
        return dofmap.index_map.size_global * dofmap.bs

    def prepare(self) -> None:
        """Let each term do what the present state needs. Collective."""
        for term in self.terms:
            term.prepare()

    def energy(self) -> float:
        """Potential at u [J] over all ranks; 0 where only a residual was given. Collective."""
        if not self.has_energy:
            return 0.0
        self.prepare()
        return sum(term.energy() or 0.0 for term in self.terms)

    def create_vector(self) -> PETSc.Vec:
        """PETSc vector of the unknown's layout, with ghosts."""
        return self.forms.create_vector()

    def create_matrix(self) -> PETSc.Mat:
        """PETSc AIJ matrix for the tangent; marked symmetric where it is."""
        A = self.forms.create_matrix()
        self._joined.discard(A.handle)
        if self.symmetric:
            A.setOption(PETSc.Mat.Option.SYMMETRIC, True)
            A.setOption(PETSc.Mat.Option.SYMMETRY_ETERNAL, True)
        return A

    def residual(self, b: PETSc.Vec) -> None:
        """Assemble the residual at u into b: out-of-balance forces, and reactions at supports.

        No boundary condition enters. At a supported degree of freedom the entry is the force [N]
        that the support exerts on the body. Collective.
        """
        self._add_residual(b)
        b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)

    def energy_and_residual(self, b: PETSc.Vec) -> float:
        """Assemble the residual at u into b, as :meth:`residual`; the energy there [J]. Collective.

        For less than both by themselves. 0 where only a residual was given.
        """
        energy = self.forms.energy_and_residual(self._empty(b))
        for term in self.terms[1:]:
            term.residual(b)
            if energy is not None:
                energy += term.energy() or 0.0
        b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        return energy or 0.0

    def lifted_residual(self, b: PETSc.Vec) -> None:
        """Assemble R + K (prescribed - u) into b: the residual after a linear move to the supports.

        K is that of the forms. Entries at supported degrees of freedom have no meaning. Collective.
        """
        self._add_residual(b)
        if self.slants is None:
            self.forms.lift(b)
        else:
            target = self.u.x.array.copy()
            for condition in self.conditions:
                condition.set(target)
            self.slants.prescribe(target)
            self.forms.add_action(b, target - self.u.x.array)
        b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)

    def _add_residual(self, b: PETSc.Vec) -> None:
        self._empty(b)
        for term in self.terms:
            term.residual(b)

    def _empty(self, b: PETSc.Vec) -> PETSc.Vec:
        """Prepare the terms, and a vector for their residuals."""
        self.prepare()
        with b.localForm() as local:
            local.set(0)
        return b

    def tangent(self, A: PETSc.Mat, projected: bool = False) -> None:
        """Assemble the tangent at u into A, supported rows and columns those of identity.

        Args:
            A: Matrix of :meth:`create_matrix`.
            projected: Make each contribution positive semi-definite first (:meth:`Term.tangent`).
                Its Newton direction lowers the energy from any state.

        Raises:
            ValueError: projected, where the potential is no minimization.
        """
        if projected:
            self.prepare_projection()
        self.prepare()
        if self.couples:
            self._coupled_tangent(A, projected)
        else:
            for term in self.terms:
                term.tangent(A, projected)
        if len(self.terms) > 1:
            rows = self.constrained + A.getOwnershipRange()[0]
            A.zeroRowsColumns(rows.astype(PETSc.IntType), diag=1.0)
        if self.slants is not None:
            self.slants.apply(A)

    @property
    def couples(self) -> bool:
        """Whether a term joins unknowns that no cell joins: the tangent's pattern changes."""
        return any(getattr(term, "couples", False) for term in self.terms)

    def _coupled_tangent(self, A: PETSc.Mat, projected: bool) -> None:
        """Assemble as ever where nothing is joined; else a sum, of a pattern of its own."""
        coupled: list[Any] = [term for term in self.terms if getattr(term, "couples", False)]
        coupled = [term for term in coupled if term.joins()]
        self.repatterned = bool(coupled) or A.handle in self._joined
        if not self.repatterned:
            for term in self.terms:
                term.tangent(A, projected)
            return
        if self._uncoupled is None:
            self._uncoupled = self.forms.create_matrix()
        for term in self.terms:
            term.tangent(self._uncoupled, projected)
        couplings = [term.coupling(A, projected) for term in coupled]
        kept = A.getNearNullSpace()
        _petsc.replace_by_sum(A, [self._uncoupled, *couplings])
        self._joined.add(A.handle)
        for coupling in couplings:
            coupling.destroy()
        if kept:
            A.setNearNullSpace(kept)
        if self.symmetric:
            A.setOption(PETSc.Mat.Option.SYMMETRIC, True)
            A.setOption(PETSc.Mat.Option.SYMMETRY_ETERNAL, True)

    def prepare_projection(self) -> None:
        """Compile the projected tangent, once. Collective.

        Raises:
            ValueError: the tangent is no second derivative of an energy to be minimized, or has
                integrals that cannot be projected.
        """
        if not self.minimization:
            raise ValueError(
                "a projected tangent needs a potential of fields that are minimized over, got a "
                "multiplier, a virtual work or a residual: solve with projection='never'."
            )
        self.forms.prepare_projection()

    @property
    def bounds_steps(self) -> bool:
        """Whether a term may forbid part of a step: forms with obstacles do."""
        return len(self.terms) > 1 or bool(self.forms.barriers)

    def largest_step(self, step: PETSc.Vec, moves: Mapping[Any, float] | None = None) -> float:
        """Fraction of a step, at most 1, that no term forbids. Collective.

        Args:
            step: Of the unknown, with room for ghosts.
            moves: Of Constants beside it, as a load factor that is an unknown, too.
        """
        others = [term.largest_step(step) for term in self.terms[1:]]
        return min(self.forms.largest_step(step, moves), *others, 1.0)

    def crossed(self) -> str:
        """What the way from the last accepted state to u crosses, in words. Collective."""
        able: list[Any] = [term for term in self.terms if hasattr(term, "crossed")]
        words = (term.crossed() for term in able)
        return self.forms.barriers.crossed() or next(filter(None, words), "")

    def touches(self) -> bool:
        """Whether obstacles act at u. Collective."""
        able: list[Any] = [term for term in self.terms if hasattr(term, "near")]
        acting = [term.near() for term in able]
        return self.forms.barriers.near() or any(acting)

    def begin(self) -> None:
        """Take the present state for the start of a path. Collective.

        Raises:
            ValueError: the body touches an obstacle, or is beyond it.
        """
        if self.forms.barriers:
            self.forms.barriers.begin()
        for term in self.terms:
            if hasattr(term, "begin"):
                term.begin()

    def commit(self) -> None:
        """Take the present state for the last accepted one. Collective."""
        for term in self.terms:
            term.commit()

    def rollback(self) -> None:
        """Return to the last accepted state, the unknown's old values being back. Collective."""
        for support in self.supports:
            support.update()
        for term in self.terms:
            term.rollback()

    def history(self) -> dict[str, Any]:
        """What a checkpoint has to keep besides the unknown, by term and name."""
        return {
            f"{number}:{name}": values
            for number, term in enumerate(self.terms)
            for name, values in term.history().items()
        }

    def destroy(self) -> None:
        """Free the matrices and factors that the last solve has left here. Collective."""
        if self.solver is not None:
            self.solver[1].destroy()
            self.solver = None
        if self._uncoupled is not None:
            self._uncoupled.destroy()
            self._uncoupled = None

    def prescribe(self, x: PETSc.Vec) -> None:
        """Put the prescribed values into a vector; local."""
        fem_petsc.set_bc(x, self.conditions)
        if self.slants is not None:
            self.slants.prescribe(x.array)

    def put(self, array: Any, values: Any) -> None:
        """Put values, at :attr:`constrained`, where supports prescribe them; local.

        Args:
            array: Own entries of the unknown's layout, or with ghosts: of a displacement, or of
                its velocity.
            values: Own entries, of which those at supports count.
        """
        array[self.constrained] = values[self.constrained]
        if self.slants is not None:
            self.slants.put(array, values)

    def clear(self, array: Any) -> None:
        """Take out of an array, own entries, what is along directions of supports; local."""
        array[self.constrained] = 0
        if self.slants is not None:
            self.slants.clear(array)

    def held_part(self, array: Any) -> Any:
        """What :meth:`clear` would take out of an array; local."""
        free = np.array(array)
        self.clear(free)
        return array - free


def _parted(potential: Any) -> tuple[Any, list[Term]]:
    """The UFL form of a potential, and its other terms."""
    if not isinstance(potential, list | tuple):
        return potential, []
    forms = [part for part in potential if isinstance(part, ufl.Form)]
    if not forms:
        raise ValueError(
            f"a potential in parts needs a UFL form among them, got {len(potential)} others."
        )
    return sum(forms[1:], forms[0]), [part for part in potential if part not in forms]


def _listed(supports: Iterable[Support] | Support, u: fem.Function) -> tuple[Support, ...]:
    """Supports as a tuple, after checking that they are of this unknown."""
    listed: Sequence[Any] = (supports,) if isinstance(supports, Support) else tuple(supports)
    for support in listed:
        if not isinstance(support, Support):
            raise ValueError(
                "supports are what forms.clamp, roller, translate, rotate and prescribe return, "
                f"got {type(support).__name__}."
            )
        if support.space != u.function_space:
            raise ValueError(
                f"a support was made for another unknown than {u.name}: make it with the unknown "
                "that is solved for."
            )
    return tuple(listed)


def _check_parts(potential: Any, u: fem.Function) -> None:
    """Refuse w.split() and w.sub(0), by which nothing would be differentiated."""
    if isinstance(potential, np.ndarray):
        raise ValueError(
            f"the potential is an array of shape {potential.shape}, as there is a NumPy array in "
            'its energy: fill the x.array of a Function of ("DG", 0) with a value in each cell.'
        )
    if not isinstance(potential, ufl.Form):
        return
    if len(potential.ufl_domains()) > 1:
        raise ValueError(
            "the potential is integrated over two meshes: take measures and unknown from one body."
        )
    _checks.form_of(potential, u.function_space.mesh, "a potential")
    for c in potential.coefficients():
        if c is not u and isinstance(c, fem.Function) and np.shares_memory(c.x.array, u.x.array):
            raise ValueError(
                f"the potential contains {c.name}, a part of {u.name} that is not differentiated: "
                "write it with u, p = ufl.split(w), not with w.split() or w.sub()."
            )
