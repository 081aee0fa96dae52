# SPDX-License-Identifier: MIT
"""Plane stress of compressible energies: the thickness stretch condensed at quadrature points."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import basix.ufl
import numpy as np
import ufl
from dolfinx import fem
from ufl.algorithms import expand_derivatives

from ._checks import in_ufl
from ._types import Expr
from .differentiation import Pointwise, contains, partial
from .kinematics import _dimension, _embed
from .native import jit

MAX_ITERATIONS = 50


class ThicknessStretch(fem.Function):
    """Stretch F33 of a sheet, the root of dpsi/dF33 = 0 at each quadrature point.

    A function of the displacement: dF33[du] = - (d2psi/dF33 dF : DF[du]) / d2psi/dF33^2, by which
    :func:`forms.derivative` differentiates through it. ``update`` runs Newton's method point by
    point; a point where it does not converge becomes NaN, so that a solve refuses the state.

    Args:
        V: Functions at quadrature points.
        written: F, d2psi/dF33 dF, dpsi/dF33 and d2psi/dF33^2 with the stretch that it is given.
    """

    def __init__(
        self, V: fem.FunctionSpace, written: Callable[[ThicknessStretch], tuple[Expr, ...]]
    ) -> None:
        super().__init__(V, name="thickness_stretch")
        self.x.array[:] = 1
        self.written = self.F, self._mixed, self._stress, self._slope = written(self)
        mesh, points = V.mesh, V.ufl_element().custom_quadrature()[0]
        self._newton = jit.expression(ufl.as_vector([self._stress, self._slope]), points, mesh)
        imap = mesh.topology.index_map(mesh.topology.dim)
        self._cells = np.arange(imap.size_local + imap.num_ghosts, dtype=np.int32)

    def direction(self, unknown: Any, du: Expr) -> Expr:
        """Change of the thickness stretch when the displacement, or a parameter, moves by du.

        A parameter p changes it by - d2psi/dF33 dp[dp] / d2psi/dF33^2.
        """
        moved = expand_derivatives(partial(self.F, (unknown,), (du,)))
        if not isinstance(moved, ufl.classes.Zero):
            return -ufl.inner(self._mixed, moved) / self._slope
        return -partial(self._stress, (unknown,), (du,)) / self._slope

    def update(self) -> None:
        """Solve dpsi/dF33 = 0 at every quadrature point; local."""
        mesh = self.function_space.mesh
        stretch = self.x.array.reshape(-1)
        stretch[~np.isfinite(stretch)] = 1
        where = self.function_space.dofmap.list.ravel()
        for _ in range(MAX_ITERATIONS):
            values = self._newton.eval(mesh, self._cells).reshape(-1, 2)
            old = stretch[where]
            step = -values[:, 0] / values[:, 1]
            # The stretch stays positive: at most halved in one step. Away from the minimum the
            # slope may be negative; the stress's sign then still tells the way.
            step = np.where(values[:, 1] > 0, step, -np.sign(values[:, 0]) * old / 4)
            step = np.clip(step, -old / 2, old)
            stretch[where] = old + step
            if not np.any(np.abs(step) > 1e-14 * np.abs(old)):
                return
        stretch[where[np.abs(step) > 1e-10 * np.abs(old)]] = np.nan


def plane_stress(u: fem.Function, psi: Callable[[Expr], Expr], degree: int | None = None) -> Expr:
    """Deformation gradient of a compressible sheet in plane stress.

    F = [[I + grad u, 0], [0, F33]],  dpsi/dF33 = 0

    Args:
        u: In-plane displacement [m] on a plane mesh.
        psi: Energy density [J/m^3] as a function of the 3x3 deformation gradient, as
            ``lambda F: neo_hookean(F, mu, lmbda)``.
        degree: Degree of the quadrature rule that the thickness stretch lives on and that the
            potential must be integrated with; by default the one a solve uses, 2 k for
            displacements of degree k.

    Returns:
        F, shape (3, 3), a ``ufl.variable``. Use it in psi(F) once more for the potential; the
        residual and the tangent contain the change of F33 (static condensation).

    Raises:
        ValueError: u has not two components, or psi is no function.
    """
    if _dimension(u, "plane_stress") != 2:
        raise ValueError(f"plane_stress needs a plane displacement, got shape {u.ufl_shape}.")
    if isinstance(psi, ufl.core.expr.Expr) or not callable(psi):  # UFL's can be called, too
        raise ValueError(
            "plane_stress needs the energy as a function of F, as lambda F: neo_hookean(F, 1, 2), "
            f"got {type(psi).__name__}."
        )
    if contains(in_ufl(psi, "plane_stress's psi", _embed(u, 1)), Pointwise):
        raise ValueError(
            "plane_stress condenses energies in plain UFL, whose derivatives UFL knows; for one in "
            "singular values use neo_hookean or another that is written in F, or plane strain."
        )
    if degree is None:
        degree = 2 * u.function_space.element.basix_element.degree

    def written(stretch: ThicknessStretch) -> tuple[Expr, ...]:
        F = _embed(u, stretch)
        P = ufl.diff(psi(F), F)
        A = ufl.diff(P, F)
        i, J = ufl.indices(2)
        return F, ufl.as_tensor(A[2, 2, i, J], (i, J)), P[2, 2], A[2, 2, 2, 2]

    mesh = u.function_space.mesh
    Q = basix.ufl.quadrature_element(mesh.basix_cell(), degree=degree)
    return ThicknessStretch(fem.functionspace(mesh, Q), written).F
