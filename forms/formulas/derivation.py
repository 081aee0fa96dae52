# SPDX-License-Identifier: MIT
"""Document 000, the symbolic derivation of dP/dF(Sigma) in SymPy, and code made of its result.

The steps are those of the document's Mathematica code, under its names: F(S) with the parameters
S = (s, u, v), dF/dS at u = v = e, its limit for e -> 0 from above, the inverse, dP/dS in the same
way with unspecified principal stresses t_i(s), and the product. Nothing is assumed of the t_i, so
the result is that of any isotropic energy, t_i = psi_i. The printed limit in 2D lacks its "]".

This module needs SymPy, which no other part of the package imports.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import sympy as sp  # type: ignore[import-untyped]

from ._algebra import Array
from .quotients import Energy, stretches

E = sp.Symbol("e", positive=True)  # the small rotation; positive: the limit is one from above


class Derivation(NamedTuple):
    """What the document's code computes; matrices are 9 x 9 or 4 x 4, in its order of entries."""

    parameters: tuple[Any, ...]  # var: s, u, v
    principal: tuple[Any, ...]  # t_i(s)
    F: Any  # U Sigma V^T
    P: Any  # U diag(t) V^T
    dFdS: Any  # dFdS1, the limit
    dSdF: Any  # dSdF0, its inverse
    dPdS: Any  # dPdS1, the limit
    dPdF: Any  # dPdS dSdF, simplified


def _checked(dimension: int, what: str) -> int:
    if dimension not in (2, 3):
        raise ValueError(f"{what} exists in 2 and 3 dimensions, got {dimension}.")
    return dimension


def rotation(r: tuple[Any, ...]) -> Any:
    """Rodrigues' formula for three parameters, the plane rotation for one angle."""
    if len(r) == 1:
        c, s = sp.cos(r[0]), sp.sin(r[0])
        return sp.Matrix([[c, -s], [s, c]])
    norm = sp.sqrt(sum(x**2 for x in r))
    K = sp.Matrix([[0, -r[2], r[1]], [r[2], 0, -r[0]], [-r[1], r[0], 0]]) / norm
    return sp.eye(3) + sp.sin(norm) * K + (1 - sp.cos(norm)) * K * K


@cache
def _limit(expression: Any) -> Any:
    return sp.simplify(sp.limit(expression, E, 0, "+"))


def _limits(derivative: Any, parts: list[Any]) -> Any:
    """Limits for e -> 0 of entries that are linear in the stretches, stresses and their slopes."""

    def entry(x: Any) -> Any:
        terms = sp.collect(sp.expand(x), parts, evaluate=False)
        return sum(part * _limit(factor) for part, factor in terms.items())

    return derivative.applyfunc(entry)


@cache
def derive(dimension: int = 3) -> Derivation:
    """The whole derivation (some seconds in 3D; the result is kept).

    dFdS can be inverted because its entries are symbols; its determinant is, up to the sign, the
    product of all s_i^2 - s_j^2, so at equal or opposite stretches dPdF holds by continuity.
    """
    d = _checked(dimension, "The derivation")
    angles = 1 if d == 2 else 3
    s = sp.symbols(f"s1:{d + 1}")
    u, v = sp.symbols(f"u1:{angles + 1}"), sp.symbols(f"v1:{angles + 1}")
    t = tuple(sp.Function(f"t{i + 1}")(*s) for i in range(d))
    slopes = [sp.diff(t_i, s_j) for t_i in t for s_j in s]
    S = (*s, *u, *v)
    at = {x: E for x in (*u, *v)}
    U, V = rotation(u), rotation(v)
    F, P = (U * sp.diag(*principal) * V.T for principal in (s, t))
    dFdS = _limits(F.reshape(d * d, 1).jacobian(S).subs(at), [*s])
    dPdS = _limits(P.reshape(d * d, 1).jacobian(S).subs(at), [*slopes, *t])
    dSdF = dFdS.to_DM().to_field().inv().to_Matrix()
    return Derivation(S, t, F, P, dFdS, dSdF, dPdS, (dPdS * dSdF).applyfunc(sp.factor))


# Code made of the result


def _slots(dimension: int) -> tuple[Any, list[Any]]:
    """The result in plain symbols p_i for t_i and h_ij for dt_i/ds_j, and the arguments s, p, h."""
    d, result = dimension, derive(dimension)
    s, t = result.parameters[:d], result.principal
    p = sp.symbols(f"p1:{d + 1}")
    h = [[sp.Symbol(f"h{i + 1}{j + 1}") for j in range(d)] for i in range(d)]
    slopes = {sp.diff(t[i], s[j]): h[i][j] for i in range(d) for j in range(d)}
    plain = result.dPdF.subs(slopes).subs(dict(zip(t, p, strict=True)))
    return plain, [*s, *p, *(x for row in h for x in row)]


@cache
def _kernel(dimension: int) -> Callable[..., list[Any]]:
    plain, arguments = _slots(dimension)
    kernel: Callable[..., list[Any]] = sp.lambdify(arguments, list(plain), "numpy", cse=True)
    return kernel


def tangent_matrix(s: Array, gradient: Array, hessian: Array) -> Array:
    """dP/dF(Sigma), (..., 9, 9) or (..., 4, 4), by the generated code from s, psi_i and psi_ij.

    The code divides by s_i^2 - s_j^2, as the document's result does: a ValueError where one is 0.
    """
    s = stretches(s, "The generated dP/dF")
    d = s.shape[-1]
    gradient, hessian = np.asarray(gradient), np.asarray(hessian)
    if gradient.shape[-1:] != (d,) or hessian.shape[-2:] != (d, d):
        raise ValueError(
            f"The generated dP/dF needs psi_i (..., {d}) and psi_ij (..., {d}, {d}),"
            f" got shapes {gradient.shape} and {hessian.shape}."
        )
    gaps = s[..., :, None] ** 2 - s[..., None, :] ** 2 + np.eye(d)
    if np.any(gaps == 0):
        raise ValueError("The generated dP/dF divides by s_i^2 - s_j^2, which is 0 here.")
    rows = [*np.moveaxis(s, -1, 0), *np.moveaxis(gradient, -1, 0)]
    rows += [hessian[..., i, j] for i in range(d) for j in range(d)]
    entries = np.broadcast_arrays(*_kernel(d)(*rows), rows[0])[: d**4]
    return np.stack(entries, -1).reshape(*entries[0].shape, d * d, d * d)


def c_code(dimension: int = 3) -> str:
    """The same as a C function, void dPdF(s, p, h, out): psi_i in p, psi_ij in h, row by row."""
    d = _checked(dimension, "The generated code")
    plain, arguments = _slots(d)
    names = [f"{a}[{i}]" for a, n in (("s", d), ("p", d), ("h", d * d)) for i in range(n)]
    shared, entries = sp.cse(list(plain), symbols=sp.numbered_symbols("x"))
    lines = [f"  const double {a} = {n};" for a, n in zip(arguments, names, strict=True)]
    lines += [f"  const double {x} = {sp.ccode(value)};" for x, value in shared]
    lines += [f"  out[{k}] = {sp.ccode(value)};" for k, value in enumerate(entries)]
    head = "void dPdF(const double *s, const double *p, const double *h, double *out)"
    return "\n".join([head, "{", *lines, "}", ""])


def energy(psi: Any, s: tuple[Any, ...]) -> Energy:
    """The energy of a SymPy expression in the symbols s, its derivatives by differentiation.

    Parameters must be numbers by now; psi must not change when stretches are exchanged.
    """
    d = _checked(len(s), "The energy of an expression")
    others = sorted(map(str, psi.free_symbols - set(s)))
    if others:
        raise ValueError(f"psi(s) needs numbers for its parameters, {', '.join(others)} are left.")
    for i in range(1, d):
        swapped = psi.subs({s[0]: s[i], s[i]: s[0]}, simultaneous=True)
        if sp.simplify(swapped - psi) != 0:
            raise ValueError(f"psi(s) changes when {s[0]} and {s[i]} are exchanged.")
    slopes = [sp.diff(psi, x) for x in s]
    curvatures = [sp.diff(slope, x) for slope in slopes for x in s]

    def function(entries: list[Any], shape: tuple[int, ...]) -> Callable[[Array], Array]:
        kernel = sp.lambdify(s, entries, "numpy", cse=True)

        def evaluated(x: Array) -> Array:
            x = stretches(x, "psi(s)")
            if x.shape[-1] != d:
                raise ValueError(f"psi(s) needs stretches (..., {d}), got shape {x.shape}.")
            columns = np.moveaxis(x, -1, 0)
            found = np.broadcast_arrays(*kernel(*columns), columns[0])[: len(entries)]
            return np.stack(found, -1).reshape(*x.shape[:-1], *shape)

        return evaluated

    return Energy(function([psi], ()), function(slopes, (d,)), function(curvatures, (d, d)))
