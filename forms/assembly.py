# SPDX-License-Identifier: MIT
"""Energy, residual and tangent as numbers and PETSc objects: the one place that assembles."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from numpy.typing import NDArray
from ufl.algorithms.analysis import extract_constants

from . import _checks, _dolfinx, insertion
from .compilation import compiled
from .differentiation import Dependent, dependents, expanded
from .loads import with_kinematics
from .operators.jets import Jet
from .quadrature import with_quadrature
from .supports import Support
from .unknowns import Field, displacement_field, fields_of
from .variation import residual, tangent


@dataclass(eq=False)
class System:
    """A potential, its residual and tangent, compiled, with the supports.

    Attributes:
        u: Unknown; the assembling methods evaluate at its present values.
        supports: Prescribed displacements.
        minimization: Whether the solution minimizes the energy: a potential of fields that are all
            minimized over, with no load that is a virtual work.
        symmetric: Whether the tangent is symmetric.
        constants: Constants in the forms.
        potential: Total potential, or residual, that all of it was derived from.
        constrained: Local numbers of the owned degrees of freedom that supports prescribe.
    """

    u: fem.Function
    supports: Sequence[Support]
    minimization: bool
    symmetric: bool
    energy_form: fem.Form | None
    residual_form: fem.Form
    tangent_form: fem.Form
    tangent_ufl: ufl.Form
    _dependents: list[Dependent]
    constants: tuple[fem.Constant, ...]
    potential: ufl.Form
    constrained: NDArray[np.int32] = field(init=False)
    projected_form: fem.Form | None = field(init=False, default=None)

    def __post_init__(self) -> None:
        imap, bs = self.u.function_space.dofmap.index_map, self.u.function_space.dofmap.bs
        owned = imap.size_local * bs
        dofs = [bc.dof_indices()[0] for bc in self.conditions]
        # dof_indices of 0.9 may count ghosts as owned in a blocked space: compare numbers instead.
        found = np.unique(np.concatenate([*dofs, np.empty(0, np.int32)]))
        self.constrained = found[found < owned].astype(np.int32)

    @property
    def comm(self) -> MPI.Comm:
        """Communicator of the mesh."""
        return self.u.function_space.mesh.comm

    @property
    def conditions(self) -> list[fem.DirichletBC]:
        """Boundary conditions of all supports, in their order (the last one wins)."""
        return [bc for support in self.supports for bc in support.conditions]

    @property
    def has_energy(self) -> bool:
        """Whether a potential was given."""
        return self.energy_form is not None

    def depends_on(self, t: fem.Constant) -> bool:
        """Whether the forms or the supports contain a constant."""
        if self._dependents:  # they may contain it unseen
            return True
        inside = list(self.constants)
        for support in self.supports:
            for part in support.parts:
                if part.expression is not None:
                    inside += extract_constants(part.expression.ufl_expression)
        return any(c is t for c in inside)

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
    def size(self) -> int:
        """Degrees of freedom on all ranks."""
        dofmap = self.u.function_space.dofmap
        return dofmap.index_map.size_global * dofmap.bs

    def update_dependents(self) -> None:
        """Bring coefficients that depend on the unknown up to date."""
        for coefficient in self._dependents:
            coefficient.update()

    def energy(self) -> float:
        """Potential at u [J] over all ranks; 0 where only a residual was given. Collective."""
        if self.energy_form is None:
            return 0.0
        self.update_dependents()
        with np.errstate(all="ignore"):
            return float(self.comm.allreduce(fem.assemble_scalar(self.energy_form)))

    def create_vector(self) -> PETSc.Vec:
        """PETSc vector of the unknown's layout, with ghosts."""
        return _dolfinx.create_vector(self.residual_form)

    def create_matrix(self) -> PETSc.Mat:
        """PETSc AIJ matrix for the tangent; marked symmetric where it is."""
        A = insertion.create_matrix(self.tangent_form, self.conditions)
        if self.symmetric:
            A.setOption(PETSc.Mat.Option.SYMMETRIC, True)
            A.setOption(PETSc.Mat.Option.SYMMETRY_ETERNAL, True)
        return A

    def residual(self, b: PETSc.Vec) -> None:
        """Assemble the residual at u into b: out-of-balance forces, and reactions at supports.

        No boundary condition enters. At a supported degree of freedom the entry is the force [N]
        that the support exerts on the body. Collective.
        """
        self.update_dependents()
        with b.localForm() as local:
            local.set(0)
        fem_petsc.assemble_vector(b, self.residual_form)
        b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)

    def lifted_residual(self, b: PETSc.Vec) -> None:
        """Assemble R + K (prescribed - u) into b: the residual after a linear move to the supports.

        Entries at supported degrees of freedom have no meaning. Collective.
        """
        self.update_dependents()
        with b.localForm() as local:
            local.set(0)
        fem_petsc.assemble_vector(b, self.residual_form)
        x = self.u.x.petsc_vec
        fem_petsc.apply_lifting(b, [self.tangent_form], bcs=[self.conditions], x0=[x], alpha=-1.0)
        b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)

    def tangent(self, A: PETSc.Mat, projected: bool = False) -> None:
        """Assemble the tangent at u into A, supported rows and columns those of identity.

        Args:
            A: Matrix of :meth:`create_matrix`.
            projected: Make each contribution positive semi-definite first: the second derivatives
                of energies in singular values at each point, the matrices of cells and facets of
                all other terms. Its Newton direction lowers the energy from any state.

        Raises:
            ValueError: projected, where the potential is none of the displacement alone.
        """
        form = self.tangent_form
        if projected:
            self.prepare_projection()
            assert self.projected_form is not None
            form = self.projected_form
        self.update_dependents()
        insertion.assemble(A, form, self.conditions)

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
        if self.projected_form is None:
            self.projected_form = compiled(self.tangent_ufl, project=True)

    def prescribe(self, x: PETSc.Vec) -> None:
        """Put the prescribed values into a vector; local."""
        fem_petsc.set_bc(x, self.conditions)


def system(
    potential: ufl.Form,
    u: fem.Function,
    supports: Iterable[Support] = (),
    virtual_work: ufl.Form | None = None,
) -> System:
    """Compile a potential (or a residual) with its derivatives. Collective.

    Args:
        potential: Total potential [J], a functional of u; or a residual, a form linear in a test
            function, where there is no potential at all.
        u: Unknown.
        supports: Prescribed displacements.
        virtual_work: Linear form added to the residual, for loads without a potential.

    Integrals without a quadrature degree get that of :func:`forms.quadrature.quadrature_degree`,
    the same in energy, residual and tangent, so that they are exact derivatives of each other.

    Raises:
        ValueError: a form of the wrong kind, one that does not contain u or contains a part of it
            from w.split(), or supports of another unknown.
    """
    degree = displacement_degree(_checks.function(u, "a solve"))
    supports = _listed(supports, u)
    _check_parts(potential, u)
    potential, virtual_work = with_kinematics(potential, virtual_work)
    potential = with_quadrature(potential, degree)
    is_energy = isinstance(potential, ufl.Form) and not potential.arguments()
    R = residual(potential, u) if is_energy else potential
    if virtual_work is not None:
        count = len(virtual_work.arguments()) if isinstance(virtual_work, ufl.Form) else "no form"
        if count != 1:
            raise ValueError(
                "virtual_work must be a form linear in one test function, got one with "
                f"{count}; add a load's potential to the potential instead."
            )
        R = with_quadrature(R + virtual_work, degree)
    K = tangent(R, u)
    parts = [expanded(potential), R]
    parts += [c.jets.packed for part in parts for c in dependents(part) if isinstance(c, Jet)]
    found = dict.fromkeys(c for part in parts for c in dependents(part))
    energetic = is_energy and virtual_work is None
    curvatures = {f.role.curvature for f in fields_of(u).values()}
    return System(
        u=u,
        supports=supports,
        minimization=energetic and curvatures == {"+"},
        symmetric=energetic,
        energy_form=compiled(potential) if is_energy else None,
        residual_form=compiled(R),
        tangent_form=compiled(K),
        tangent_ufl=K,
        _dependents=[c for c in found if not isinstance(c, Jet)],
        constants=tuple(c for part in parts for c in extract_constants(part)),
        potential=potential,
    )


def _listed(supports: Iterable[Support] | Support, u: fem.Function) -> tuple[Support, ...]:
    """Supports as a tuple, after checking that they are of this unknown."""
    listed = (supports,) if isinstance(supports, Support) else tuple(supports)
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
    return listed


def _check_parts(potential: Any, u: fem.Function) -> None:
    """Refuse w.split() and w.sub(0), by which nothing would be differentiated."""
    if not isinstance(potential, ufl.Form):
        return
    if len(potential.ufl_domains()) > 1:
        raise ValueError(
            "the potential is integrated over two meshes: take measures and unknown from one body."
        )
    for c in potential.coefficients():
        if c is not u and isinstance(c, fem.Function) and np.shares_memory(c.x.array, u.x.array):
            raise ValueError(
                f"the potential contains {c.name}, a part of {u.name} that is not differentiated: "
                "write it with u, p = ufl.split(w), not with w.split() or w.sub()."
            )


def displacement_degree(u: fem.Function) -> int:
    """Degree of an unknown's displacement, or of its first field where it has none."""
    field = displacement_field(u) or next(iter(fields_of(u).values()))
    return field.degree
