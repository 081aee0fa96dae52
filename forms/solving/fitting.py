# SPDX-License-Identifier: MIT
"""Parameters from data: least squares through solves, with exact derivatives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import ufl
from numpy.typing import NDArray

from ..parameters import Slope, check_parameters, name_of
from ..paths import NotConverged
from ..results import integral
from .data import Data
from .fitted import BLIND, Fit, determined
from .linearized import Linearized
from .numbers import Numbers
from .progress import bar_of
from .rates import Rate
from .spread import curvature, decided, jacobian, like, slope_by_number
from .visits import Visits

Array = NDArray[np.float64]
STEPS = 20  # of Gauss-Newton at the end
STUCK = 1e-6  # distance from a bound, in a number's scale, that counts as none
DENSE = 2000  # numbers whose covariance is an array
TERMS = 20  # corrections that the quasi-Newton method remembers


def fit(
    data: Data | Sequence[Data],
    parameters: Any,
    *,
    bounds: Mapping[Any, tuple[float, float]] | Sequence[tuple[float, float]] | None = None,
    regularization: ufl.Form | None = None,
    tolerance: float = 1e-10,
    most: int = 1000,
    check: bool = True,
    covariance: bool = False,
    progress: bool = True,
) -> Fit:
    """Find the parameters with which solutions give what was measured. Collective.

    sum_i ((y_i(m) - d_i) / sigma_i)^2 / 2 + regularization(m)  is made as small as possible

    With Constants alone it is a problem of least squares (SciPy's trust-region method), the
    Jacobian by one linear solve for each number and load; with Functions, or a regularization, a
    minimization by L-BFGS-B with one adjoint solve for each load. The first states are found along
    the path from the problem's present state, later ones from those before.

    Args:
        data: One or several, of one problem or of several.
        parameters: Constants and Functions; a list, or a dict that gives them names. Their present
            values are the first guess.
        bounds: Least and largest value, a pair for each parameter in their order, or a dict by the
            parameters' names; None for no bounds.
        regularization: Functional of the parameters, in the misfit's unit 1, as
            ``1e-3 * ufl.inner(ufl.grad(m), ufl.grad(m)) * ufl.dx``.
        tolerance: Relative change of misfit and of parameters at which it ends.
        most: Evaluations at most.
        check: Whether the path is followed once more from the start with the final parameters, and
            the data compared: states that lie on another branch are told.
        covariance: Whether the covariance is found of Functions, too, or with a regularization
            (without both it always is): by one adjoint solve for each of the data, as an array of
            all numbers, 2000 at most. Bounds have no part in it.
        progress: Show a line on rank 0.

    Returns:
        Fit; the parameters hold the values found, the unknowns the last state.

    Raises:
        ValueError: more numbers than data without a regularization, or too many for a covariance,
            a parameter that nothing contains, data outside the body.
        NotConverged: no solution at the first guess, or states on another branch in the end.
    """
    listed = [data] if isinstance(data, Data) else list(data)
    if not listed or not all(isinstance(d, Data) for d in listed):
        raise ValueError("fit needs data, one or several forms.Data.")
    names = list(parameters) if isinstance(parameters, Mapping) else None
    given = list(parameters.values()) if isinstance(parameters, Mapping) else parameters
    found = check_parameters(given, listed[0].problem, "fit", supports=False)
    numbers = Numbers(found, names, bounds, listed[0].problem.u.function_space.mesh)
    if covariance and numbers.size > DENSE:
        raise ValueError(
            f"fit finds a covariance of {DENSE} numbers at most, got {numbers.size}: leave it out, "
            "or give the field on a coarser mesh."
        )
    count = sum(d.values.size for d in listed)
    if regularization is None and numbers.size > count:
        raise ValueError(
            f"fit has {numbers.size} numbers to find from {count} data: add a regularization, or "
            "fewer parameters."
        )
    misfit = _Misfit(listed, numbers, regularization, progress)
    return misfit.minimized(tolerance, most, check, covariance)


class _Misfit:
    """The sum of squares, with its derivatives, as SciPy asks for it."""

    def __init__(
        self,
        data: list[Data],
        numbers: Numbers,
        regularization: ufl.Form | None,
        progress: bool,
    ) -> None:
        self.data, self.numbers, self._regularization = data, numbers, regularization
        self.forward = regularization is None and not numbers.fields
        groups: dict[tuple[int, ...], list[Data]] = {}
        for d in data:
            key = id(d.problem), *map(id, d.factors), *map(id, d.functionals)
            groups.setdefault(key, []).append(d)
        self._visits = [Visits(group, numbers, self.forward) for group in groups.values()]
        self._slopes = [
            None if regularization is None else Slope(regularization, m) for m in numbers.parameters
        ]
        for n, m in enumerate(numbers.parameters):
            slope = self._slopes[n]
            if all(v.empty[n] for v in self._visits) and (slope is None or slope.empty):
                raise ValueError(
                    f"fit by {name_of(m)}: neither a potential, nor supports, nor what was "
                    "measured contain it; was it turned into a number on the way, as by float() "
                    "or .value?"
                )
        self.history: list[float] = []
        self.fitted = [np.empty(d.values.shape) for d in data]
        self._shown = progress
        self._z: Array | None = None
        self._r: Array = np.empty(0)
        self._J: Array = np.empty(0)
        self._value, self._gradient = np.inf, np.empty(0)
        self._first = True

    def minimized(self, tolerance: float, most: int, check: bool, covariance: bool) -> Fit:
        """The fit. Collective."""
        from scipy.optimize import least_squares, minimize

        numbers = self.numbers
        z = numbers.get() / numbers.scale
        low, high = numbers.low / numbers.scale, numbers.high / numbers.scale
        z = np.clip(z, low, high)
        with bar_of("fit", None, numbers.comm, self._shown) as self._bar:
            self._evaluate(z)
            self._first = False
            if self.forward:
                ends = {"ftol": tolerance**1.4, "xtol": tolerance, "gtol": tolerance**1.4}
                result = least_squares(
                    self._residuals, z, self._jacobian, (low, high), max_nfev=most, **ends
                )
            else:
                options: dict[str, Any] = {"maxfun": most, "maxiter": most, "maxcor": TERMS}
                options |= {"ftol": tolerance, "gtol": tolerance}
                pairs = list(zip(low, high, strict=True))
                result = minimize(
                    self._both, z, jac=True, method="L-BFGS-B", bounds=pairs, options=options
                )
            z = numbers.comm.bcast(result.x)
            self._evaluate(z, anew=True)
            if self.forward:
                z = self._polished(z, low, high, tolerance)
            if check:
                self._check(z)
        fit = self._fit(z, bool(result.success), str(result.message))
        if covariance and not self.forward:
            self._spread(fit)
        if fit.covariance is not None:
            spread = like(numbers)
            spread.put(fit.deviations)
            fit.spread = spread.parameters
        return fit

    def _polished(self, z: Array, low: Array, high: Array, tolerance: float) -> Array:
        """Gauss-Newton steps to the end: squares no longer fall long before numbers stand still."""
        last = np.inf
        for _ in range(STEPS):
            step = -np.linalg.lstsq(self._J, self._r, rcond=BLIND**0.5)[0]
            length = float(np.linalg.norm(step))
            inside = np.all((z + step > low) & (z + step < high))
            if not (inside and tolerance < length < min(last, 0.1)):
                break
            before = self._value
            self._evaluate(z + step)
            if not self._value <= before * (1 + 1e-6):
                self._evaluate(z)
                break
            z, last = z + step, length
        return z

    def _fit(self, z: Array, converged: bool, reason: str) -> Fit:
        numbers = self.numbers
        fit = Fit(
            numbers.names,
            z * numbers.scale,
            self.data,
            self.fitted,
            self._r,
            self._value,
            numbers.counts,
        )
        fit.evaluations, fit.history = len(self.history), self.history
        fit.converged, fit.reason = converged, reason.rstrip(".") + "."
        low, high = numbers.low, numbers.high
        near = STUCK * numbers.scale
        bound = np.flatnonzero((fit.values <= low + near) | (fit.values >= high - near))
        if len(bound) and not numbers.fields:
            fit.reason += f" At a bound: {', '.join(numbers.names[n] for n in bound)}."
        if self.forward:
            J, variance = self._J / numbers.scale, self._variance(numbers.size)
            fit.covariance, fit.open = determined(J, fit.values, numbers.names, variance)
        return fit

    def _variance(self, decided: float) -> float:
        """Variance of a residual, where so many numbers were decided by the data."""
        if all(d.sigma is not None for d in self.data):
            return 1.0
        return float(self._r @ self._r) / max(1.0, len(self._r) - decided)

    def _spread(self, fit: Fit) -> None:
        """Covariance of fields, and what decides them. Collective."""
        numbers = self.numbers
        J = np.concatenate([j for visits in self._visits for j in jacobian(visits, numbers)])
        H = curvature(self._regularization, numbers)
        found = decided(J, H, numbers.scale) if numbers.comm.rank == 0 else None
        covariance, count, blind = numbers.comm.bcast(found)
        fit.covariance = self._variance(count) * covariance
        told = f"The data decide {count:.3g} of {numbers.size} numbers"
        if self._regularization is not None:
            told += f", and the regularization {numbers.size - blind - count:.3g}"
        fit.open.append(f"{told}, and nothing decides {blind}." if blind else f"{told}.")

    def _residuals(self, z: Array) -> Array:
        self._evaluate(z)
        return self._r

    def _jacobian(self, z: Array) -> Array:
        self._evaluate(z)
        return self._J

    def _both(self, z: Array) -> tuple[float, Array]:
        self._evaluate(z)
        return self._value, self._gradient

    def _check(self, z: Array) -> None:
        """Go along the paths once more, and compare. Collective."""
        before = self._r.copy()
        for visits in self._visits:
            visits.forget()
        self._evaluate(z, anew=True)
        off = float(np.abs(self._r - before).max())
        if off > 1e-5 * max(1.0, float(np.abs(before).max())):
            raise NotConverged(
                "the states that were fitted are not those that the path from the start leads to: "
                f"they differ by {off:.2g} sigma; give loads in smaller steps."
            )

    def _evaluate(self, z: Array, anew: bool = False) -> None:
        """All data at some numbers, with derivatives; kept until others are asked for."""
        if not anew and self._z is not None and np.array_equal(z, self._z):
            return
        numbers = self.numbers
        m = z * numbers.scale
        numbers.put(m)
        self._z = z.copy()
        try:
            parts = [self._visited(visits, m) for visits in self._visits]
        except NotConverged:
            if self._first or anew:
                raise
            # The trust region, or the line search, takes a shorter step.
            self._r = np.full_like(self._r, np.inf)
            self._value = 10 * abs(self._value) + 1
            return
        order = [self.data.index(d) for visits in self._visits for d in visits.data]
        blocks: list[Any] = [None] * len(self.data)
        rows = [block for part in parts for block in part[0]]
        for place, block in zip(order, rows, strict=True):
            blocks[place] = block
        bcast = numbers.comm.bcast
        self._r = bcast(np.concatenate([b[0].ravel() for b in blocks]))
        self._value = 0.5 * float(self._r @ self._r)
        if self.forward:
            self._J = bcast(np.concatenate([b[1] for b in blocks]) * numbers.scale)
        else:
            gradient = sum(part[1] for part in parts)
            if self._regularization is not None:
                self._value += integral(self._regularization)
                gradient = gradient + numbers.collected(
                    [
                        slope_by_number(s, m)
                        for s, m in zip(self._slopes, numbers.parameters, strict=True)
                        if s is not None
                    ]
                )
            self._value = bcast(self._value)
            self._gradient = bcast(gradient * numbers.scale)
        self.history.append(self._value)
        self._bar.update(1)
        self._bar.set_postfix_str(f"misfit {self._value:.4e}")

    def _visited(self, visits: Visits, m: Array) -> tuple[list[Any], Array]:
        """Residuals and Jacobian of each of a problem's data, or their common gradient."""
        numbers, data = self.numbers, visits.data
        residuals = [np.empty(d.values.shape) for d in data]
        J = [np.zeros((*d.values.shape, numbers.size)) for d in data] if self.forward else []
        gradient: Array = np.zeros(numbers.size)

        def look(n: int, linear: Linearized) -> list[Rate]:
            nonlocal gradient
            c: list[Array] = []
            places = [d.place(visits.loads[n]) for d in data]
            for k, (d, what) in enumerate(zip(data, visits.measured, strict=True)):
                place = places[k]
                size = int(np.prod(d.shape, dtype=int))
                if place is None:
                    c.append(np.zeros(size))
                    continue
                values = what.values(visits.problem).reshape(d.shape)
                spread = d.spread[place]
                self.fitted[self.data.index(d)][place] = values
                residuals[k][place] = (values - d.values[place]) / spread
                c.append(np.ravel(residuals[k][place] / spread))
            if visits.rates is None:
                assert visits.adjoint is not None
                gradient = gradient + numbers.collected(visits.adjoint.adjoint(linear, c))
                return []
            rates, columns = visits.rates(linear)
            for k, (d, column) in enumerate(zip(data, columns, strict=True)):
                if places[k] is not None:
                    whole = column.reshape(*d.shape, numbers.size)
                    J[k][places[k]] = whole / np.asarray(d.spread[places[k]])[..., None]
            return rates

        visits.visit(m, look)
        if not self.forward:
            return [(r, None) for r in residuals], gradient
        pairs = zip(residuals, J, strict=True)
        return [(r, j.reshape(-1, numbers.size)) for r, j in pairs], gradient
