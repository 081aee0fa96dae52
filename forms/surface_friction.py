# SPDX-License-Identifier: MIT
"""Coulomb friction of deformable surfaces with each other, as a dissipation potential that lags.

D(v) = sum mu N f(|v_T|) over the pairs of :class:`forms.surface_contact.Touching`

N is the barrier's force of a pair, v_T its sliding velocity in the plane of contact; N, that plane
and the pair's nearest points are those of the displacement that the step lags at. f is that of
:mod:`forms.coulomb`. By ipctk (Li et al., ACM Trans. Graph. 39 (2020) 49, section 5).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from petsc4py import PETSc

import numpy as np
from dolfinx import fem
from numpy.typing import NDArray

from .surface_contact import Touching


@dataclass(frozen=True)
class SurfaceFriction:
    """Friction in a contact of surfaces, for ``dissipation=``.

    Attributes:
        contact: The contact.
        mu: Coefficient of friction.
        speed: Below which surfaces stick [m/s].
        lags: True: a step is solved again until it is its own.
    """

    contact: Touching
    mu: float
    speed: float
    lags: bool = True


class Sliding:
    """Friction over a step in time, D(b u + d) / b: a term of its potential.

    Args:
        friction: What it is of.
        rate: b [1/s].
        inverse: 1 / b, or 0 where nothing dissipates.
        drift: d [m/s].
        lag: Displacement that it lags at.

    Attributes:
        couples: True: its tangent joins nodes that no cell joins.
    """

    couples = True

    def __init__(
        self,
        friction: SurfaceFriction,
        rate: fem.Constant,
        inverse: fem.Constant,
        drift: fem.Function,
        lag: fem.Function,
    ) -> None:
        contact = friction.contact
        self._contact, self._surface, self._mu = contact, contact.surface, friction.mu
        self._b, self._inverse, self._drift, self._lag = rate, inverse, drift, lag
        self._potential = contact.ipc.FrictionPotential(friction.speed)
        self._pairs = contact.ipc.TangentialCollisions()  # this rank's share
        self._x: NDArray = np.empty((0, 0))
        self._v: NDArray = np.empty((0, 0))

    def prepare(self) -> None:
        """Find velocities, and forces where they lag at another displacement. Collective."""
        contact, surface = self._contact, self._surface
        x = np.asfortranarray(surface.points + surface.gathered(self._lag.x.array))
        if not np.array_equal(self._x, x):
            self._x = x
            pairs = contact.share_of(contact.pairs_at(x))
            self._pairs = contact.ipc.TangentialCollisions()
            self._pairs.build(contact.mesh, x, pairs, contact.potential, self._mu)
        u, drift = contact.unknown.x.array, self._drift.x.array
        self._v = np.asfortranarray(surface.gathered(float(self._b.value) * u + drift))

    @property
    def _factor(self) -> float:
        return float(self._inverse.value)

    def energy(self) -> float:
        """D / b [J]. Collective."""
        own = 0.0
        if not self._pairs.empty() and np.all(np.isfinite(self._v)):
            own = self._factor * float(self._potential(self._pairs, self._contact.mesh, self._v))
        return float(sum(self._surface.comm.allgather(own)))

    def forces(self) -> NDArray:
        """Derivative of this rank's share of D by the points' velocities [N], shape (n, dim)."""
        if self._pairs.empty():
            return np.zeros_like(self._v)
        g = self._potential.gradient(self._pairs, self._contact.mesh, self._v)
        return np.asarray(g).reshape(self._v.shape)

    def power(self) -> float:
        """Power that friction takes at the present state [W]. Collective."""
        self.prepare()
        return float(sum(self._surface.comm.allgather(float(np.sum(self.forces() * self._v)))))

    def residual(self, b: PETSc.Vec) -> None:
        """Add the derivative of the energy. Collective."""
        factor = self._factor * float(self._b.value)
        numbers, values = self._surface.own_forces(factor * self.forces())
        with b.localForm() as local:
            local.array[numbers] += values

    def coupling(self, A: PETSc.Mat, projected: bool = False) -> PETSc.Mat:
        """Second derivative of the energy, of A's layout; a matrix of its own. Collective."""
        how = self._contact.ipc.PSDProjectionMethod
        project = how.CLAMP if projected else how.NONE
        H = self._potential.hessian(self._pairs, self._contact.mesh, self._v, project)
        return self._surface.stiffness(self._factor * float(self._b.value) ** 2 * H, A)

    def joins(self) -> bool:
        """Whether its tangent has entries at the state that was prepared. Collective."""
        return any(self._surface.comm.allgather(not self._pairs.empty()))

    def tangent(self, A: PETSc.Mat, projected: bool = False) -> None:
        """Nothing: it has entries where A has none, see :meth:`coupling`."""

    def largest_step(self, step: PETSc.Vec) -> float:
        """1: friction forbids nothing."""
        return 1.0

    def commit(self) -> None:
        """Nothing: what it lags at is the motion's."""

    def rollback(self) -> None:
        """Nothing."""

    def history(self) -> dict[str, Any]:
        """Nothing besides the unknown."""
        return {}
