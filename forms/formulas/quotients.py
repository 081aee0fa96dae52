# SPDX-License-Identifier: MIT
"""Document 000: energies in principal stretches and the two quotients of the blocks B_ij.

psi^(s) is the energy of F = U Sigma V^T as a function of the signed singular values s, shape
(..., d) with d = 2 or 3; psi_i and psi_ij are its derivatives; leading axes are carried along.
Indices i, j count from 0. Moduli are numbers or arrays of the leading axes, in Pa = J/m^3, as are
energies and their derivatives. The three functions of an energy take complex steps.

Nothing is misprinted in document 000. What it leaves open is how to divide: the difference quotient
has a limit for every isotropic energy, the sum quotient only for those that are smooth in F.
Every ValueError names the formula: stretches of another shape, stretches outside the logarithm of
an energy, indices that are no pair, a clamp of 0.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ._algebra import Array, Scalar, over

LEAST = 1e-6  # the document's bound on the magnitude of s_i + s_j
PAIRS = {2: ((0, 1),), 3: ((0, 1), (0, 2), (1, 2))}  # the order of the blocks B_ij


class Energy(NamedTuple):
    """An isotropic energy: psi^(s) (...), psi_i (..., d) and psi_ij (..., d, d) from s (..., d).

    psi^ must not change when stretches are exchanged; any three such functions make an energy.
    """

    value: Callable[[Array], Array]
    gradient: Callable[[Array], Array]
    hessian: Callable[[Array], Array]


def stretches(s: Array, formula: str) -> Array:
    """The stretches as an array, after checking that there are two or three."""
    s = np.asarray(s)
    s = s.astype(float) if s.dtype.kind in "iu" else s
    if s.shape[-1:] not in ((2,), (3,)):
        raise ValueError(f"{formula} needs stretches (..., 2) or (..., 3), got shape {s.shape}.")
    return s


def volume_derivatives(s: Array) -> tuple[Array, Array, Array]:
    """J = prod s, dJ/ds_i and d2J/ds_i ds_j as products of the others: stretches may be 0."""
    s = stretches(s, "J = prod s")
    d = s.shape[-1]
    first = np.stack([np.prod(np.delete(s, i, -1), -1) for i in range(d)], -1)
    second = np.zeros((*s.shape, d), dtype=s.dtype)
    for i, j in PAIRS[d]:
        second[..., i, j] = second[..., j, i] = np.prod(np.delete(s, (i, j), -1), -1)
    return np.prod(s, -1), first, second


def _diagonal(entries: Array) -> Array:
    return entries[..., None] * np.eye(entries.shape[-1])


def _square(vector: Array) -> Array:
    return vector[..., :, None] * vector[..., None, :]


def _logarithm(x: Array, energy: str, name: str) -> Array:
    smallest = np.min(np.real(x))
    if not smallest > 0:
        raise ValueError(
            f"{energy} contains ln {name} and needs {name} > 0, got {name} = {smallest:.3g}."
        )
    return np.asarray(np.log(x))


# Energies


def fixed_corotated(mu: Scalar, lmbda: Scalar) -> Energy:
    """psi^ = mu sum (s_i - 1)^2 + lmbda/2 (J - 1)^2: for all s, inverted ones too."""

    def value(s: Array) -> Array:
        s = stretches(s, "fixed corotated energy")
        return np.asarray(mu * np.sum((s - 1) ** 2, -1) + lmbda / 2 * (np.prod(s, -1) - 1) ** 2)

    def gradient(s: Array) -> Array:
        J, first, _ = volume_derivatives(s)
        return 2 * over(mu, 1) * (np.asarray(s) - 1) + over(lmbda * (J - 1), 1) * first

    def hessian(s: Array) -> Array:
        J, first, second = volume_derivatives(s)
        volumetric = over(lmbda, 2) * _square(first) + over(lmbda * (J - 1), 2) * second
        return 2 * over(mu, 2) * np.eye(first.shape[-1]) + volumetric

    return Energy(value, gradient, hessian)


def arap(mu: Scalar) -> Energy:
    """As rigid as possible: psi^ = mu sum (s_i - 1)^2."""
    return fixed_corotated(mu, 0.0)


def neo_hookean(mu: Scalar, lmbda: Scalar) -> Energy:
    """psi^ = mu/2 (sum s_i^2 - d) - mu ln J + lmbda/2 (ln J)^2, (16) of document 003; J > 0."""

    def log_volume(s: Array) -> Array:
        s = stretches(s, "neo-Hookean energy")
        return _logarithm(np.prod(s, -1), "neo-Hookean energy", "J")

    def value(s: Array) -> Array:
        lnJ, squares = log_volume(s), np.sum(np.square(s), -1)
        return mu / 2 * (squares - np.shape(s)[-1]) - mu * lnJ + lmbda / 2 * lnJ**2

    def gradient(s: Array) -> Array:
        pressure = over(lmbda * log_volume(s) - mu, 1)
        return over(mu, 1) * s + pressure / s

    def hessian(s: Array) -> Array:
        pressure = over(lmbda * log_volume(s) - mu, 1)
        return over(lmbda, 2) / _square(np.asarray(s)) + _diagonal(
            over(mu, 1) - pressure / np.square(s)
        )

    return Energy(value, gradient, hessian)


def hencky(mu: Scalar, lmbda: Scalar) -> Energy:
    """psi^ = mu sum (ln s_i)^2 + lmbda/2 (ln J)^2; all s_i > 0."""

    def logarithms(s: Array) -> tuple[Array, Array]:
        logs = _logarithm(stretches(s, "Hencky energy"), "Hencky energy", "s")
        return logs, np.sum(logs, -1)

    def value(s: Array) -> Array:
        logs, lnJ = logarithms(s)
        return np.asarray(mu * np.sum(logs**2, -1) + lmbda / 2 * lnJ**2)

    def gradient(s: Array) -> Array:
        logs, lnJ = logarithms(s)
        return (2 * over(mu, 1) * logs + over(lmbda * lnJ, 1)) / s

    def hessian(s: Array) -> Array:
        logs, lnJ = logarithms(s)
        bend = 2 * over(mu, 1) * (1 - logs) - over(lmbda * lnJ, 1)
        return over(lmbda, 2) / _square(np.asarray(s)) + _diagonal(bend / np.square(s))

    return Energy(value, gradient, hessian)


def saint_venant_kirchhoff(mu: Scalar, lmbda: Scalar) -> Energy:
    """psi^ = mu sum E_i^2 + lmbda/2 (sum E_i)^2, E_i = (s_i^2 - 1)/2: smooth in F, for all s."""

    def strains(s: Array) -> tuple[Array, Array]:
        E = (stretches(s, "Saint Venant-Kirchhoff energy") ** 2 - 1) / 2
        return E, np.sum(E, -1)

    def value(s: Array) -> Array:
        E, trace = strains(s)
        return np.asarray(mu * np.sum(E**2, -1) + lmbda / 2 * trace**2)

    def second_piola(s: Array) -> Array:
        E, trace = strains(s)
        return 2 * over(mu, 1) * E + over(lmbda * trace, 1)

    def gradient(s: Array) -> Array:
        return s * second_piola(s)

    def hessian(s: Array) -> Array:
        stiffness = over(lmbda, 2) * _square(np.asarray(s))
        return stiffness + _diagonal(second_piola(s) + 2 * over(mu, 1) * np.square(s))

    return Energy(value, gradient, hessian)


# Quotients


def pair(s: Array, i: int, j: int, formula: str) -> tuple[Array, Array, Array]:
    """The stretches, s_i and s_j, after checking the indices."""
    s = stretches(s, formula)
    d = s.shape[-1]
    if i == j or not (0 <= i < d and 0 <= j < d):
        raise ValueError(f"{formula} needs two of the indices 0 to {d - 1}, got {i} and {j}.")
    return s, s[..., i], s[..., j]


def clamp(x: Array, least: float = LEAST) -> Array:
    """The denominator with its magnitude raised to at least 1e-6; its sign kept, that of 0 is +."""
    if not least > 0:
        raise ValueError(f"The clamp needs a bound > 0, got {least}.")
    return np.where(np.asarray(x) >= 0, 1.0, -1.0) * np.maximum(np.abs(x), least)


def segment_mean(
    hessian: Callable[[Array], Array],
    s: Array,
    i: int,
    j: int,
    sign: int = 1,
    points: int = 8,
    where: Array | bool = True,
) -> Array:
    """Mean of psi_ii - sign psi_ij from (sign s_j, sign s_i) to (s_i, s_j), by Gauss's points.

    sign = 1: (psi_i - psi_j)/(s_i - s_j), as psi^(s_i, s_j) = psi^(s_j, s_i); sign = -1:
    (psi_i + psi_j)/(s_i + s_j) where psi^(s_i, s_j) = psi^(-s_j, -s_i), so for energies smooth
    in F. Nothing is divided. Exact for polynomials psi^ of degree <= 2 points + 1. Where where is
    false, the Hessian is taken at s: no state outside the energy's domain is visited.
    """
    s, si, sj = pair(s, i, j, "segment mean")
    mean = np.zeros(si.shape)
    for t, w in zip(*np.polynomial.legendre.leggauss(points), strict=True):
        x = np.array(s)
        x[..., i] = np.where(where, (si + sign * sj) / 2 + t * (si - sign * sj) / 2, si)
        x[..., j] = np.where(where, (sj + sign * si) / 2 + t * (sj - sign * si) / 2, sj)
        H = hessian(x)
        mean = mean + w / 2 * (H[..., i, i] - sign * H[..., i, j])
    return mean


def _quotient(
    energy: Energy, s: Array, i: int, j: int, sign: int, points: int, switch: float | None
) -> Array:
    """The mean where |s_i - sign s_j| <= switch |s_i + sign s_j|/2, elsewhere the fraction."""
    if switch is None:
        return segment_mean(energy.hessian, s, i, j, sign, points)
    gap = s[..., i] - sign * s[..., j]
    near = np.abs(gap) <= switch / 2 * np.abs(s[..., i] + sign * s[..., j])
    psi = energy.gradient(s)
    fraction = (psi[..., i] - sign * psi[..., j]) / np.where(near, 1.0, gap)
    mean = segment_mean(energy.hessian, s, i, j, sign, points, near)
    return np.where(near, mean, fraction)


def difference_quotient(
    energy: Energy, s: Array, i: int, j: int, points: int = 8, switch: float | None = 0.3
) -> Array:
    """(psi_i - psi_j)/(s_i - s_j), with its limit psi_ii - psi_ij at s_i = s_j.

    Args:
        energy: Isotropic energy.
        s: Stretches, shape (..., d).
        i: Index of the first stretch.
        j: Index of the second one.
        points: Gauss points of :func:`segment_mean`.
        switch: Gap, over the mean of s_i and s_j, up to which the mean of the segment is taken; at
            0.3, 8 points leave 1e-15. None takes it everywhere, as is right for polynomials.
    """
    s, _, _ = pair(s, i, j, "(psi_i - psi_j)/(s_i - s_j)")
    return _quotient(energy, s, i, j, 1, points, switch)


def sum_quotient(
    energy: Energy,
    s: Array,
    i: int,
    j: int,
    least: float = LEAST,
    smooth: bool = False,
    points: int = 8,
    switch: float | None = 0.3,
) -> Array:
    """(psi_i + psi_j)/(s_i + s_j), the denominator clamped; of smooth energies with its limit.

    For an energy that is smooth in F, with psi^(s_i, s_j) = psi^(-s_j, -s_i), the limit is
    psi_ii + psi_ij: the clamp would put 0 there. Other energies are unbounded: -4 mu/(s_i + s_j)
    in the fixed corotated one.
    """
    s, si, sj = pair(s, i, j, "(psi_i + psi_j)/(s_i + s_j)")
    if smooth:
        return _quotient(energy, s, i, j, -1, points, switch)
    psi = energy.gradient(s)
    return (psi[..., i] + psi[..., j]) / clamp(si + sj, least)
