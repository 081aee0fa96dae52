# SPDX-License-Identifier: MIT
"""What was measured, at which loads, and how exactly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray

from ..measured import Displacements
from ..problems import Problem

Array = NDArray[np.float64]


@dataclass(eq=False)
class Data:
    """What was measured on one problem, at one load or along a path.

    Args:
        problem: Whose solution is to give the values.
        what: A :class:`forms.Reaction`, a functional, :class:`forms.Displacements` at points, or
            the t (one of several) that ``held`` goes with.
        values: What was measured: one value (or an array of points and components) for each of the
            loads; without loads one alone.
        sigma: Standard deviation of each value, or of all; None where it is not known: values then
            count relative to their root mean square.
        t: Load factor; with ``held`` the scalar that ``forms.control`` finds, or a list of them.
        loads: Load factors, in the order of the path, at which was measured; with ``held`` the
            values of the functional, or of several rows.
        held: Functional that is held, as by ``forms.control``, or a list of them.
        name: Name for pictures.

    Raises:
        ValueError: values of another shape, or that are not finite, sigma that is not positive.
    """

    problem: Problem
    what: Any
    values: Any
    sigma: Any = None
    t: fem.Constant | Sequence[fem.Constant] | None = None
    loads: Sequence[Any] | None = None
    held: ufl.Form | Sequence[ufl.Form] | None = None
    name: str = ""
    shape: tuple[int, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if not isinstance(self.problem, Problem):
            raise ValueError(
                f"data belong to a forms.Problem, got {type(self.problem).__name__}: make one of "
                "the potential, the unknown and the supports."
            )
        if (self.loads is None) != (self.t is None):
            raise ValueError("data along a path need both its load factor t= and loads=.")
        if self.loads is not None and any(np.ndim(load) for load in self.loads):
            self.loads = [tuple(float(x) for x in row) for row in self.loads]
        self.values = np.asarray(self.values, float)
        self.shape = ()
        if isinstance(self.what, Displacements):
            self.shape = self.what.shape(self.problem)
        wanted = self.shape if self.loads is None else (len(self.loads), *self.shape)
        if self.values.shape != wanted:
            raise ValueError(
                f"data need values of shape {wanted}: one for each load"
                f"{' and point' if self.shape else ''}, got {self.values.shape}."
            )
        if not np.all(np.isfinite(self.values)):
            raise ValueError("data need finite values: leave out what was not measured.")
        if self.sigma is not None:
            try:
                self.sigma = np.broadcast_to(np.asarray(self.sigma, float), wanted)
            except ValueError:
                self.sigma = np.zeros(1)
            if not np.all(self.sigma > 0):
                raise ValueError(
                    "sigma is a positive standard deviation of all values, or one of each."
                )

    @property
    def factors(self) -> tuple[fem.Constant, ...]:
        """The load factor, the scalars that are found, or none."""
        return _listed(self.t)

    @property
    def functionals(self) -> tuple[ufl.Form, ...]:
        """The functionals that are held, or none."""
        return _listed(self.held)

    def place(self, load: Any) -> Any:
        """Index of a load's values; all of them without loads, None where there are none."""
        if self.loads is None:
            return ...
        listed = list(self.loads)
        return listed.index(load) if load in listed else None

    @property
    def spread(self) -> Array:
        """What errors are divided by, of the values' shape."""
        if self.sigma is not None:
            return self.sigma
        size = float(np.sqrt(np.mean(self.values**2)))
        return np.full(self.values.shape, size or 1.0)


def _listed(given: Any) -> tuple[Any, ...]:
    if given is None:
        return ()
    return tuple(given) if isinstance(given, list | tuple) else (given,)
