# SPDX-License-Identifier: MIT
"""Where the joules of a step in time went: stored, moved, dissipated, and the scheme's own part."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from petsc4py import PETSc

import numpy as np
from dolfinx.fem import petsc as fem_petsc
from numpy.typing import NDArray

from ..compilation import compiled
from ..ledger import ORDINARY, Row
from ..motion import Motion, State
from ..schemes import Euler

Array = NDArray[np.float64]


class MotionAccounts:
    """Reads energies and works of steps in time; all collective.

    Works are those of the forces' mean at both ends of a step, of the middle's by the midpoint
    rule, of the end's by implicit Euler: what is left over falls with dt^2. What the scheme itself
    dissipates is the work of inertia along the step less the kinetic energy gained,
    1/2 (M a_n + M a) . (u - u_n) - (T - T_n); of implicit Euler, whose forces are the end's, also
    Pi'(u) . (u - u_n) - (Pi(u) - Pi(u_n)), and the same of the dissipation.

    Args:
        motion: Body in motion, whose problem has a potential.
    """

    def __init__(self, motion: Motion) -> None:
        problem = motion.problem
        self._motion, self._problem = motion, problem
        self._explicit = problem.forms.hides_constants
        self._explicit |= any(c is motion.t for c in problem.forms.constants)
        virtual = problem.forms.virtual_work
        self._virtual = None if virtual is None else compiled(virtual)
        self._b = problem.create_vector()
        self._own = self._b.getLocalSize()
        self._euler = isinstance(motion.scheme, Euler)

    def begin(self) -> None:
        """Read the first state, as :meth:`forms.motion.Motion.begin` or ``recall`` leaves it."""
        motion = self._motion
        self._energy = self._potential(motion.u.x.array.copy(), float(motion.t.value))
        self.momentum = motion.inertia.of(motion.velocity.x.array)
        self.inertia = motion.inertia.of(motion.acceleration.x.array)
        self._kinetic = self._dot(motion.velocity.x.array[: self._own], self.momentum) / 2
        self._power = motion.dissipated_power()
        self._forces, self._loads = self._read_forces()

    def step(self, state: State) -> tuple[Row, bool]:
        """The account of a step that was found, before it is taken, and whether it is finite."""
        motion, own = self._motion, self._own
        t, dt = motion.begun, motion.dt
        then, now = motion.last[:own].copy(), state.u[:own]
        change = now - then
        momentum, inertia = motion.inertia.of(state.v), motion.inertia.of(state.a)
        kinetic = self._dot(state.v[:own], momentum) / 2
        power, (forces, loads) = motion.dissipated_power(), self._read_forces()
        whole = motion.last.copy()
        energy = self._potential(state.u, t + dt)
        one_sided = motion.scheme.middle or self._euler
        taken = dt * (power if one_sided else (power + self._power) / 2)
        reactions = forces + inertia
        if not one_sided:
            reactions = (reactions + self._forces + self.inertia) / 2
            loads_mean = (loads + self._loads) / 2
        else:
            loads_mean = loads
        supports = self._dot(self._problem.held_part(reactions), self._problem.held_part(change))
        virtual = -self._dot(loads_mean, change)
        explicit, later = 0.0, self._energy
        if self._explicit:
            if motion.scheme.middle:
                explicit = self._potential(state.s, t + dt) - self._potential(state.s, t)
            else:
                later = self._potential(whole, t + dt)
                explicit = later - self._energy
                if not self._euler:
                    explicit = (explicit + energy - self._potential(state.u, t)) / 2
        inert = inertia if one_sided else (inertia + self.inertia) / 2
        scheme = self._dot(inert, change) - (kinetic - self._kinetic)
        if self._euler:
            scheme += self._dot(forces - loads, change) - (energy - later) - taken
        stored, moved = energy - self._energy, kinetic - self._kinetic
        works = explicit + virtual, supports
        left = sum(works) - stored - moved - taken - scheme
        row = Row(t + dt, stored, *works, left, ORDINARY, moved, taken, scheme)
        self._next = (energy, momentum, inertia, kinetic, power, forces, loads)
        motion.u.x.array[:] = state.s
        return row, bool(np.isfinite(energy))

    def take(self) -> None:
        """The step was taken."""
        self._energy, self.momentum, self.inertia, self._kinetic, self._power = self._next[:5]
        self._forces, self._loads = self._next[5:]

    def memory(self) -> tuple[list[Array], dict[str, float]]:
        """What a checkpoint keeps of the last state."""
        whole = [np.zeros_like(self._motion.last) for _ in range(2)]
        for target, values in zip(whole, (self._forces, self._loads), strict=True):
            target[: self._own] = values
        return whole, {"energy": self._energy, "kinetic": self._kinetic, "power": self._power}

    def recall(self, states: Sequence[Array], numbers: Mapping[str, float]) -> None:
        """Go on from a checkpoint. Collective."""
        self.begin()
        self._forces, self._loads = (values[: self._own].copy() for values in states)
        self._energy, self._kinetic = numbers["energy"], numbers["kinetic"]
        self._power = numbers["power"]

    def _potential(self, values: Array, time: float) -> float:
        """Potential energy of a displacement at a time. Collective."""
        motion, t = self._motion, self._motion.t
        kept, now = motion.u.x.array.copy(), float(t.value)
        motion.u.x.array[:], t.value = values, time
        with motion.without_inertia():
            energy = self._problem.energy()
        motion.u.x.array[:], t.value = kept, now
        return energy

    def _read_forces(self) -> tuple[Array, Array]:
        """Residual without inertia, and that of virtual works, at the present state; own entries.

        Zero where no account needs them.
        """
        b, zero = self._b, np.zeros(self._own)
        forces = loads = zero
        if self._euler or self._motion.held.moves:
            with self._motion.without_inertia(viscous=True):
                self._problem.residual(b)
            forces = b.array_r.copy()
        if self._virtual is not None:
            self._problem.prepare()
            with b.localForm() as local:
                local.set(0)
            fem_petsc.assemble_vector(b, self._virtual)
            b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
            loads = b.array_r.copy()
        return forces, loads

    def _dot(self, x: Any, y: Any) -> float:
        return float(self._problem.comm.allreduce(float(x @ y)))

    def destroy(self) -> None:
        """Free the vector. Collective."""
        self._b.destroy()
