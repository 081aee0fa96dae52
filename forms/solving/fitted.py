# SPDX-License-Identifier: MIT
"""Outcome of a fit: parameters, how exactly the data determine them, and what they leave open."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path as FilePath
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LOOSE = 0.5  # relative standard deviation from which on a direction counts as open
BLIND = 1e-10  # eigenvalue of the Gauss-Newton matrix, over the largest, that rounding may make
SHOWN = 0.2  # entries of a unit direction that are named


@dataclass
class Fit:
    """Parameters that fit data, found by :func:`forms.fit`; they hold the values found.

    Attributes:
        names: Names of the numbers that were found; of a Function one for all of it.
        values: The numbers: Constants, then the values of Functions, one after the other.
        fitted: What the solution gives for each of the data, in the shape of its values.
        residuals: (fitted - measured) / sigma, all data one after the other.
        misfit: Half the sum of the residuals' squares, and the regularization.
        covariance: Of the numbers, (J^T J)^-1 with J the Jacobian of the residuals; times the
            residuals' variance where no sigma was given. Infinite along what the data cannot tell.
            With a regularization g (J^T J + d2g/dm2)^-1, Laplace's approximation, and None where
            ``fit`` was not asked for it.
        spread: Standard deviations, for each parameter a Constant or Function of its kind.
        open: What the data leave open, a sentence for each direction.
        evaluations: How often all data were computed.
        history: The misfit at each evaluation.
        converged: Whether the minimization came to its end.
        reason: How it ended, in words.
    """

    names: list[str]
    values: Array
    data: Sequence[Any]
    fitted: list[Array]
    residuals: Array
    misfit: float
    counts: list[int]
    covariance: Array | None = None
    spread: list[Any] = field(default_factory=list)
    open: list[str] = field(default_factory=list)
    evaluations: int = 0
    history: list[float] = field(default_factory=list)
    converged: bool = False
    reason: str = ""

    @property
    def deviations(self) -> Array:
        """Standard deviation of each number; NaN where none is known."""
        if self.covariance is None:
            return np.full(len(self.values), np.nan)
        return np.sqrt(np.diag(self.covariance))

    def __repr__(self) -> str:
        """The numbers with their standard deviations, the misfit, and what is open."""
        lines = [f"<Fit of {len(self.residuals)} data, misfit {self.misfit:.4g}: {self.reason}"]
        if self.covariance is not None:
            ends = np.cumsum(self.counts)[:-1]
            parts = np.split(self.values, ends), np.split(self.deviations, ends)
            for name, values, std in zip(self.names, *parts, strict=True):
                if len(values) == 1:
                    lines.append(f" {name} = {values[0]:.6g} +- {std[0]:.2g}")
                else:
                    told = f"+- {std.min():.2g} to {std.max():.2g}"
                    lines.append(f" {name}: {len(values)} numbers, {told}")
        else:
            lines.append(f" {', '.join(self.names)}: {len(self.values)} numbers")
        return "\n".join([*lines, *(f" {sentence}" for sentence in self.open)]) + ">"

    def plot(self, filename: str | FilePath) -> None:
        """Draw each of the data and its fit: over the loads, or one over the other; local.

        Args:
            filename: Image that is written, as "fit.png".
        """
        from matplotlib.figure import Figure

        count = len(self.data)
        figure = Figure(figsize=(4.2 * min(count, 3), 3.4 * -(-count // 3)), layout="constrained")
        grid = figure.subplots(-(-count // 3), min(count, 3), squeeze=False).ravel()
        for axes, data, fitted in zip(grid, self.data, self.fitted, strict=False):
            if fitted.ndim == 1 and data.loads is not None and len(fitted) > 1:
                bars = data.sigma if data.sigma is not None and np.any(data.sigma > 0) else None
                loads = [float(np.ravel(load)[0]) for load in data.loads]  # of rows the first
                axes.errorbar(loads, data.values, bars, fmt="k.", label="data")
                axes.plot(loads, fitted, "C0", label="fit")
                axes.set_xlabel("load")
                axes.legend(frameon=False)
            else:
                low, high = np.min(data.values), np.max(data.values)
                axes.plot([low, high], [low, high], "0.7")
                axes.plot(np.ravel(data.values), np.ravel(fitted), "C0.", ms=3)
                axes.set(xlabel="data", ylabel="fit")
            axes.set_title(data.name or "", fontsize="medium")
        for axes in grid[count:]:
            axes.remove()
        figure.savefig(filename, dpi=150)


def determined(
    J: Array, values: Array, names: Sequence[str], variance: float
) -> tuple[Array, list[str]]:
    """Covariance of numbers, and sentences on the directions that data leave open; local.

    Args:
        J: Jacobian of the residuals by the numbers, (data, numbers).
        values: The numbers.
        names: Their names.
        variance: Variance of a residual.
    """
    scale = np.where(values != 0, np.abs(values), 1.0)
    eigenvalues, vectors = np.linalg.eigh((J * scale).T @ (J * scale))
    blind = eigenvalues <= BLIND * eigenvalues.max()
    with np.errstate(divide="ignore"):
        spread = np.where(blind, np.inf, variance / np.where(blind, 1.0, eigenvalues))
    sentences = []
    for wide, v, is_blind in zip(np.sqrt(spread), vectors.T, blind, strict=True):
        if wide > LOOSE:
            v = v * np.sign(v[np.argmax(np.abs(v))])
            parts = [f"{c:+.2g} {n}" for c, n in zip(v, names, strict=True) if abs(c) > SHOWN]
            told = "nothing" if is_blind else f"no more than +-{wide:.0%}"
            what = f"relative changes along {' '.join(parts).lstrip('+')}"
            if len(parts) == 1:
                what = next(n for c, n in zip(v, names, strict=True) if abs(c) > SHOWN)
            sentences.append(f"The data tell {told} of {what}.")
    covariance = np.empty((len(values),) * 2)
    known = np.where(blind, 0.0, spread)
    covariance[:] = np.outer(scale, scale) * ((vectors * known) @ vectors.T)
    lost = (vectors[:, blind] ** 2).sum(axis=1) > SHOWN**4
    covariance[lost, lost] = np.inf
    return covariance, sentences
