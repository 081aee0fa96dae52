# SPDX-License-Identifier: MIT
"""Energy and powers at a state of a path, for its ledger."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from petsc4py import PETSc

import numpy as np
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from numpy.typing import NDArray

from ..compilation import compiled
from ..ledger import NODES, Balance, weights
from ..problems import Problem

SMALL = 1e-5  # of the load factor's way, for difference quotients


class _Virtual(NamedTuple):
    """Forces of virtual works at a state."""

    place: float
    u: NDArray[np.float64]
    forces: NDArray[np.float64]


class Accounts:
    """Reads energy, powers and virtual works' forces at equilibria.

    Powers are central difference quotients by the load factor at fixed u, of the supports'
    prescribed values and of the potential.

    Args:
        problem: Problem with a potential.
        q: Load factor, or the scalar unknowns in its place.
        span: How far q goes, or its size: a measure for difference quotients.
    """

    def __init__(self, problem: Problem, q: Sequence[fem.Constant], span: float) -> None:
        self.problem, self._q, self._h = problem, tuple(q), SMALL * span
        hidden, constants = problem.forms.hides_constants, problem.forms.constants
        self._explicit = [hidden or any(c is each for c in constants) for each in q]
        self._moving = any(support.depends_on(q[0]) for support in problem.supports)
        virtual = problem.forms.virtual_work
        self._virtual = None if virtual is None else compiled(virtual)
        self._b = problem.create_vector()
        self._states: list[_Virtual] = []  # of one smooth piece, the latest first

    @property
    def by_forces(self) -> bool:
        """Whether virtual works act, which are integrated by forces and states."""
        return self._virtual is not None

    def read(self, place: float, way: float = 1.0, side: float = 0.0) -> Balance:
        """Energy and powers at the present state. Collective.

        Args:
            place: Where it is along the path.
            way: Change of the load factor by the place, where supports depend on it.
            side: 1 or -1 for quotients above or below the load factor alone, where it has a kink.
        """
        return self._balance(place, self._powers(side)[0] * way if self._moving else 0.0, side)

    def read_near(
        self, place: float, way: float, velocity: NDArray[np.float64]
    ) -> tuple[Balance, float]:
        """The same at a state that is near the equilibrium at its place. Collective.

        There Pi_q dq/ds + R . du/ds, of the whole R and du/ds, misses what the equilibrium's powers
        are by a product of two small errors, that of the state and that of du/ds:
        d/du (R . du/ds + Pi_q dq/ds) = K du/ds + R_q dq/ds, which is 0 along the path.

        Args:
            place: Where it is along the path.
            way: Change of the load factor by the place, 1 or -1.
            velocity: du/ds there of a curve through states around, own entries first.

        Returns:
            Energy at the state, and powers with what forces out of balance do along the curve; and
            that part by itself, by the place [J].
        """
        power, rest = self._powers(0.0, velocity)
        found = self._balance(place, power * way, 0.0)
        if self._moving:
            return found._replace(power=found.power + rest), rest
        return found._replace(slope=found.slope + rest * way), rest

    def _balance(self, place: float, power: float, side: float) -> Balance:
        """Energy, and Pi_q of every scalar, beside the power of the supports. Collective."""
        energy = self.problem.energy()
        loads = [float(c.value) for c in self._q]
        slopes = [
            self._slope(c, side) if explicit else 0.0
            for c, explicit in zip(self._q, self._explicit, strict=True)
        ]
        others = tuple(zip(loads[1:], slopes[1:], strict=True))
        return Balance(place, loads[0], energy, slopes[0], power, others=others)

    def _slope(self, c: fem.Constant, side: float) -> float:
        """Pi_q by one of the scalars, at fixed u. Collective."""
        q, found = float(c.value), 0.0
        for offset, weight in _quotient(side):
            c.value = q + offset * self._h
            found += weight / self._h * self.problem.energy()
        c.value = q
        return found

    def _powers(self, side: float, along: NDArray[np.float64] | None = None) -> tuple[float, float]:
        """R . du_p/dq at prescribed values, and R . ``along`` at all others. Collective."""
        problem, c = self.problem, self._q[0]
        q = float(c.value)
        velocity = np.zeros(self._b.getLocalSize())
        for offset, weight in _quotient(side):
            c.value = q + offset * self._h
            for support in problem.supports:
                support.update()
            self._b.set(0)
            problem.prescribe(self._b)
            velocity += weight / self._h * self._b.array_r
        c.value = q
        for support in problem.supports:
            support.update()
        problem.residual(self._b)
        own = [float(self._b.array_r @ velocity), 0.0]
        if along is not None:
            problem.clear(self._b.array)
            own[1] = float(self._b.array_r @ along[: velocity.size])
        held, free = problem.comm.allreduce(np.array(own))
        return float(held), float(free)

    def chord(self) -> tuple[float, float]:
        """Work of the virtual works since the state last kept, by the forces there and here."""
        if self._virtual is None or not self._states:
            return 0.0, 0.0
        then = self._states[0]
        now, state = self._forces()
        own = [-float(f @ (state - then.u)) for f in (then.forces, now)]
        before, after = self.problem.comm.allreduce(np.array(own))
        return float(before), float(after)

    def keep(self, place: float, anew: bool = False) -> list[float]:
        """Take the present state for the last one of the path. Collective.

        Args:
            place: Where it is in the ledger.
            anew: Whether no smooth curve leads here from the states before.

        Returns:
            Work of the virtual works over the last steps, the latest first, by polynomials through
            the forces and states of up to six of them.
        """
        if self._virtual is None:
            return []
        forces, state = self._forces()
        before = self._states[:1] if anew else self._states[: NODES - 1]
        nodes = self._states = [_Virtual(place, state, forces), *before]
        local = np.array([[f.forces @ g.u for g in nodes] for f in nodes])
        products = self.problem.comm.allreduce(local)
        x = np.array([node.place for node in nodes])
        works = [-float(np.sum(weights(x, x[n + 1], x[n]) * products)) for n in range(len(x) - 1)]
        if anew:
            del self._states[1:]
        return works

    def cut(self, kept: int = 1) -> None:
        """Forget all states but some of the last ones."""
        del self._states[kept:]

    def _forces(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Virtual works' part of the residual at the present state, and the state; own entries."""
        b = self._b
        self.problem.prepare()
        with b.localForm() as local:
            local.set(0)
        assert self._virtual is not None
        fem_petsc.assemble_vector(b, self._virtual)
        b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        forces = b.array_r.copy()
        return forces, self.problem.u.x.array[: forces.size].copy()

    def destroy(self) -> None:
        """Free the vector."""
        self._b.destroy()


def _quotient(side: float) -> tuple[tuple[float, float], ...]:
    """Places and weights of a difference quotient of second order."""
    if side == 0:
        return (1.0, 0.5), (-1.0, -0.5)
    return (0.0, -1.5 * side), (side, 2.0 * side), (2.0 * side, -0.5 * side)
