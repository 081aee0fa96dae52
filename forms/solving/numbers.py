# SPDX-License-Identifier: MIT
"""Constants and Functions as one vector of numbers, the same on all ranks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from dolfinx import fem
from dolfinx.mesh import Mesh
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Numbers:
    """The values of parameters, one after the other, Functions by their global numbers.

    Args:
        parameters: Constants and Functions.
        names: Their names; None for those that they have.
        bounds: Least and largest value of each, in their order or by name; None for none.
        mesh: Their mesh.

    Attributes:
        size: How many numbers.
        names: Name of each number of a Constant, of each Function.
        counts: How many numbers each name stands for.
        scale: Size of each number, by which minimizers see it.
        low, high: Bounds of each number.
        fields: Whether there are Functions.

    Raises:
        ValueError: bounds of a name that is none, or that are no pairs.
    """

    def __init__(
        self, parameters: list[Any], names: Sequence[str] | None, bounds: Any, mesh: Mesh
    ) -> None:
        self.parameters, self.mesh, self.comm = parameters, mesh, mesh.comm
        self.fields = any(isinstance(m, fem.Function) for m in parameters)
        called = [_called(m, n) for n, m in enumerate(parameters)] if names is None else list(names)
        sizes = [_size(m) for m in parameters]
        self._ends = np.cumsum([0, *sizes])
        self.size = int(self._ends[-1])
        self.names = [
            name if isinstance(m, fem.Function) or m.ufl_shape == () else f"{name}{list(k)}"
            for name, m in zip(called, parameters, strict=True)
            for k in ([()] if isinstance(m, fem.Function) else np.ndindex(m.ufl_shape))
        ]
        self.counts = [
            size
            for m, n in zip(parameters, sizes, strict=True)
            for size in ([n] if isinstance(m, fem.Function) else [1] * n)
        ]
        pairs = _pairs(bounds, called)
        self.low, self.high = (
            np.concatenate([np.full(n, p[side]) for n, p in zip(sizes, pairs, strict=True)])
            for side in (0, 1)
        )
        values, self.scale = self.get(), np.ones(self.size)
        for begin, end, m in zip(self._ends[:-1], self._ends[1:], parameters, strict=True):
            own = np.abs(values[begin:end])
            if isinstance(m, fem.Function):
                own = np.full(end - begin, own.max(initial=0.0))
            self.scale[begin:end] = np.where(own > 0, own, 1.0)

    def get(self) -> Array:
        """The present values. Collective."""
        return self.collected(self.parameters)

    def collected(self, found: Sequence[Any]) -> Array:
        """A vector of arrays for Constants and of Functions, one for each parameter. Collective."""
        parts = []
        for m, value in zip(self.parameters, found, strict=True):
            if isinstance(m, fem.Function):
                parts.append(np.concatenate(self.comm.allgather(_owned(value))))
            else:
                value = value.value if isinstance(value, fem.Constant) else value
                parts.append(np.ravel(np.asarray(value, float)))
        return np.concatenate(parts)

    def put(self, values: Array) -> None:
        """Give the parameters these values."""
        for begin, end, m in zip(self._ends[:-1], self._ends[1:], self.parameters, strict=True):
            own = values[begin:end]
            if isinstance(m, fem.Function):
                dofmap = m.function_space.dofmap
                first, last = (dofmap.index_map_bs * k for k in dofmap.index_map.local_range)
                m.x.array[: last - first] = own[first:last]
                m.x.scatter_forward()
            else:
                m.value = own.reshape(m.ufl_shape)


def _called(m: Any, n: int) -> str:
    return m.name if isinstance(m, fem.Function) else f"m{n}"


def _size(m: Any) -> int:
    if isinstance(m, fem.Function):
        dofmap = m.function_space.dofmap
        return int(dofmap.index_map.size_global * dofmap.index_map_bs)
    return int(np.prod(m.ufl_shape, dtype=int))


def _owned(f: fem.Function) -> Array:
    dofmap = f.function_space.dofmap
    return f.x.array[: dofmap.index_map.size_local * dofmap.index_map_bs]


def _pairs(bounds: Any, names: Sequence[str]) -> list[tuple[float, float]]:
    none = (-np.inf, np.inf)
    if bounds is None:
        return [none] * len(names)
    if isinstance(bounds, Mapping):
        strange = [name for name in bounds if name not in names]
        if strange:
            raise ValueError(f"bounds are of the parameters {', '.join(names)}, got {strange[0]}.")
        bounds = [bounds.get(name, none) for name in names]
    if len(bounds) != len(names) or not all(np.shape(p) == (2,) and p[0] < p[1] for p in bounds):
        raise ValueError(
            f"bounds are {len(names)} pairs (least, largest), one for each parameter, got {bounds}."
        )
    return [(float(a), float(b)) for a, b in bounds]
