# SPDX-License-Identifier: MIT
"""Tensor algebra over leading axes, and the checks that name an equation."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
Scalar = float | Array

EYE = np.eye(3)


def determinant(F: Array, equation: str) -> Array:
    """Determinant as a triple product, which takes complex steps."""
    rows = checked(F, equation)
    J: Array = np.sum(rows[..., 0, :] * np.cross(rows[..., 1, :], rows[..., 2, :]), axis=-1)
    return J


def over(scalar: Scalar, rank: int) -> Array:
    """Scalars of the leading axes, to be multiplied with tensors of a rank."""
    return np.asarray(scalar)[(..., *(None,) * rank)]


def transpose(tensor: Array) -> Array:
    return np.swapaxes(tensor, -1, -2)


def outer(a: Array, b: Array) -> Array:
    return np.einsum("...i,...j->...ij", a, b)


def dyad(a: Array, b: Array) -> Array:
    return np.einsum("...ij,...kl->...ijkl", a, b)


def squares(F: Array) -> Array:
    """F : F = tr C; no conjugate of complex steps."""
    return np.einsum("...ij,...ij->...", F, F)


def checked(tensor: Array, equation: str) -> Array:
    tensor = np.asarray(tensor)
    if tensor.shape[-2:] != (3, 3):
        raise ValueError(f"{equation} needs tensors (..., 3, 3), got shape {tensor.shape}.")
    return tensor


def regular(F: Array, equation: str) -> Array:
    """J, after checking that it is not zero."""
    J = determinant(F, equation)
    if np.any(J == 0):
        raise ValueError(f"{equation} divides by the determinant of a tensor, which is 0 here.")
    return J


def positive(F: Array, equation: str) -> Array:
    """J, after checking that it is positive."""
    J = determinant(F, equation)
    smallest = np.min(np.real(J))
    if not smallest > 0:
        raise ValueError(f"{equation} belongs to an energy with ln J, got J = {smallest:.3g} <= 0.")
    return J


def inverse(tensor: Array, equation: str) -> Array:
    regular(tensor, equation)
    return np.linalg.inv(tensor)


def unit_axis(A: Array, equation: str) -> Array:
    A = np.asarray(A)
    if A.shape[-1:] != (3,):
        raise ValueError(f"{equation} needs an axis with 3 components, got shape {A.shape}.")
    length = np.linalg.norm(A, axis=-1)
    if not np.allclose(length, 1, rtol=0, atol=1e-12):
        worst = np.ravel(length)[np.argmax(np.abs(length - 1))]
        raise ValueError(f"{equation} needs a unit axis, got |A| = {worst:.15g}: divide A by it.")
    return A


def gauss(t0: float, t1: float, points: int) -> tuple[Array, Array]:
    t, w = np.polynomial.legendre.leggauss(points)
    return (t0 + t1) / 2 + (t1 - t0) / 2 * t, (t1 - t0) / 2 * w


def symmetric_derivative(f: Callable[[Array], Array], C: Array) -> Array:
    """df/dC_KL for symmetric C, shape (..., K, L, shape of f), along 1/2 (e_K e_L + e_L e_K)."""
    same = np.einsum("ik,jl->ijkl", EYE, EYE)
    h = 1e-40  # no difference is formed, so h may be as small as floats are
    stepped = (
        checked(C, "(10)")[..., None, None, :, :] + 1j * h * (same + np.swapaxes(same, 2, 3)) / 2
    )
    return np.imag(f(stepped)) / h
