# SPDX-License-Identifier: MIT
"""How exactly fields are known after a fit: data and regularization, near the parameters found.

The misfit r . r / 2 + g(m) is there close to a quadratic function of its Gauss-Newton matrix,

    A = J^T J + H,  J = dr/dm,  H = d2g/dm2:

covariance A^-1 (Laplace's approximation), of which the data decide tr(A^-1 J^T J) numbers. J by one
adjoint solve for each of the data, H by columns.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray
from ufl.algorithms import expand_derivatives

from ..differentiation import rate
from ..parameters import Slope
from .fitted import BLIND, SHOWN
from .linearized import Linearized
from .numbers import Numbers
from .rates import Rate
from .visits import Visits

Array = NDArray[np.float64]


def like(numbers: Numbers) -> Numbers:
    """Constants and Functions beside the parameters, of their shapes and spaces."""
    mesh = numbers.mesh
    made = [
        fem.Function(m.function_space, name=m.name)
        if isinstance(m, fem.Function)
        else fem.Constant(mesh, np.zeros(m.ufl_shape))
        for m in numbers.parameters
    ]
    return Numbers(made, None, None, numbers.mesh)


def slope_by_number(slope: Slope, m: Any) -> Any:
    """Derivative of a functional by each number of one parameter. Collective."""
    if isinstance(m, fem.Constant):
        return slope.numbers()
    found = fem.Function(m.function_space)
    slope.add_numbers(found)
    return found


def curvature(regularization: ufl.Form | None, numbers: Numbers) -> Array:
    """Second derivatives of the regularization by the numbers, dense, on all ranks. Collective."""
    found = np.zeros((numbers.size,) * 2)
    if regularization is None:
        return found
    along = like(numbers)
    pairs = zip(numbers.parameters, along.parameters, strict=True)
    slopes = [expand_derivatives(rate(regularization, m, dm)) for m, dm in pairs]
    total = sum((s for s in slopes if not s.empty()), ufl.Form([]))
    if total.empty():
        return found
    seconds = [Slope(total, m) for m in numbers.parameters]
    ones = np.eye(numbers.size)
    for k in range(numbers.size):
        along.put(ones[k])
        columns = zip(seconds, numbers.parameters, strict=True)
        found[k] = numbers.collected([slope_by_number(s, m) for s, m in columns])
    return found


def jacobian(visits: Visits, numbers: Numbers) -> list[Array]:
    """Derivatives of the residuals of each of a problem's data by the numbers. Collective.

    One adjoint solve for each of the data, at the states that the parameters' present values have.
    """
    assert visits.adjoint is not None
    adjoint, data = visits.adjoint, visits.data
    J = [np.zeros((*d.values.shape, numbers.size)) for d in data]
    sizes = [int(np.prod(d.shape, dtype=int)) for d in data]

    def look(n: int, linear: Linearized) -> list[Rate]:
        for k, d in enumerate(data):
            place = d.place(visits.loads[n])
            if place is None:
                continue
            rows = []
            for one in np.eye(sizes[k]):
                c = [one if i == k else np.zeros(size) for i, size in enumerate(sizes)]
                rows.append(numbers.collected(adjoint.adjoint(linear, c)))
            whole = np.reshape(rows, (*d.shape, numbers.size))
            J[k][place] = whole / np.asarray(d.spread[place])[..., None]
        return []

    visits.visit(numbers.get(), look)
    return [j.reshape(-1, numbers.size) for j in J]


def decided(J: Array, H: Array, scale: Array) -> tuple[Array, float, int]:
    """A^-1, how many numbers the data decide, and how many directions nothing does; local.

    Along directions that nothing decides the covariance is infinite.

    Args:
        J: Derivatives of the residuals, (data, numbers).
        H: Second derivatives of the regularization.
        scale: Size of each number.
    """
    own = (J * scale).T @ (J * scale)
    values, vectors = np.linalg.eigh(own + H * np.outer(scale, scale))
    blind = values <= BLIND * values.max()
    inverse = np.where(blind, 0.0, 1.0 / np.where(blind, 1.0, values))
    covariance = (vectors * inverse) @ vectors.T
    count = float(np.sum(covariance * own))
    lost = (vectors[:, blind] ** 2).sum(axis=1) > SHOWN**4
    covariance = covariance * np.outer(scale, scale)
    covariance[lost, lost] = np.inf
    return covariance, count, int(blind.sum())
