# SPDX-License-Identifier: MIT
"""Document 003, VI-VIII: isoparametric elements, stiffness, internal force and residual.

Numbers in parentheses are the document's equations. Arrays end in the axes named here; leading axes
(cells) are carried along. n nodes, q integration points:

    N (..., q, n) shape functions      G (..., q, n, 3) their gradients in x, or G0 in X
    x, X (..., n, 3) nodes [m]         dv, dV (..., q) weight times Jacobian determinant [m^3]
    sigma, S (..., q, 3, 3) [Pa]       c, CC (..., q, 3, 3, 3, 3), D (..., q, 6, 6) [Pa]

D is in the Voigt order 11, 22, 33, 12, 23, 13. Positions may be complex, for complex steps.
``as_printed=True`` gives what the document prints where that is wrong.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .elasticity import strain_derivative, strain_rate_derivative, volume_ratio
from .materials import effective_moduli, voigt_elasticity
from .shapes import shape_gradients

Array = NDArray[Any]


# VI. Linearized equilibrium


def internal_work(S: Array, E_dot: Array, dV: Array) -> Array:
    """Virtual work int S : dE_dot dV (29) [W]."""
    return np.einsum("...qij,...qij,...q->...", S, E_dot, dV)


def linearized_material(
    S: Array, CC: Array, F: Array, grad_v: Array, grad_u: Array, dV: Array
) -> Array:
    """D dW_int[u] = int (DE[dv] : CC : DE[u] + S : [(grad0 u)^T grad0 dv]) dV (30), (32)."""
    DE_v, DE_u = strain_derivative(F, grad_v), strain_derivative(F, grad_u)
    constitutive = np.einsum("...qij,...qijkl,...qkl->...q", DE_v, CC, DE_u)
    initial = strain_rate_derivative(
        grad_v, grad_u, as_printed=True
    )  # inside S : [...] it is right
    return np.sum((constitutive + np.einsum("...qij,...qij->...q", S, initial)) * dV, axis=-1)


def small_strain(grad_u: Array) -> Array:
    """Strain eps = 1/2 (grad u + (grad u)^T), below (33); of dv: the virtual rate dd (35)."""
    grad_u = np.asarray(grad_u)
    return (grad_u + np.swapaxes(grad_u, -1, -2)) / 2


def linearized_spatial(sigma: Array, c: Array, grad_v: Array, grad_u: Array, dv: Array) -> Array:
    """D dW_int[u] = int (dd : c : eps + sigma : [(grad u)^T grad dv]) dv (34)."""
    dd, eps = small_strain(grad_v), small_strain(grad_u)
    constitutive = np.einsum("...qij,...qijkl,...qkl->...q", dd, c, eps)
    initial = np.einsum("...qij,...qki,...qkj->...q", sigma, grad_u, grad_v)
    return np.sum((constitutive + initial) * dv, axis=-1)


# VII. Discretization


def interpolate(N: Array, values: Array) -> Array:
    """Position x = sum_a N_a x_a (37); likewise velocities (38) and displacements (39)."""
    _check_nodes(N.shape[-1], values, "(37)")
    return np.einsum("...qa,...ai->...qi", N, values)


def jacobian(dN: Array, x: Array) -> Array:
    """J^(e) = dx/dxi = sum_a x_a (x) dN_a/dxi in (58), shape (..., q, 3, 3)."""
    _check_nodes(dN.shape[-2], x, "(58)")
    return np.einsum("...ai,...qaj->...qij", x, dN)


def gradients(dN: Array, x: Array) -> tuple[Array, Array]:
    """Gradients G of the shape functions with respect to x, and det J^(e), from those in xi.

    Raises:
        ValueError: a determinant that is not positive.
    """
    J = jacobian(dN, x)
    det = volume_ratio(J)
    if not np.all(np.real(det) > 0):
        worst = np.min(np.real(det))
        raise ValueError(f"(58) needs det J^(e) > 0, got {worst:.3g}: the element is inside out.")
    return np.einsum("...qaj,...qji->...qai", dN, np.linalg.inv(J)), det


def velocity_gradient(v: Array, G: Array) -> Array:
    """Velocity gradient l = sum_a v_a (x) grad N_a (40)."""
    _check_nodes(G.shape[-2], v, "(40)")
    return np.einsum("...ai,...qaj->...qij", v, G)


def virtual_velocity_gradient(v: Array, G: Array, as_printed: bool = False) -> Array:
    """Virtual velocity gradient dl = sum_a dv_a (x) grad N_a (41).

    Printed: sum_a dv_a (x) N_a, a vector (pass N as G), which is no gradient at all.
    """
    return interpolate(G, v) if as_printed else velocity_gradient(v, G)


def virtual_rate(v: Array, G: Array) -> Array:
    """Virtual rate dd = 1/2 sum_a (dv_a (x) grad N_a + grad N_a (x) dv_a) (42)."""
    half = np.einsum("...ai,...qaj->...qij", v, G)
    other = np.einsum("...qai,...aj->...qij", G, v)
    return (half + other) / 2


def deformation_gradient(x: Array, G0: Array) -> Array:
    """F_iI = sum_a x_a,i dN_a/dX_I (43)."""
    _check_nodes(G0.shape[-2], x, "(43)")
    return np.einsum("...ai,...qaI->...qiI", x, G0)


def constitutive_work(v: Array, G_a: Array, c: Array, u: Array, G_b: Array, dv: Array) -> Array:
    """D dW_c for one node a and one node b (44), the second bracket with u_b in both terms.

    int 1/2 (dv (x) grad N_a + grad N_a (x) dv) : c : 1/2 (u (x) grad N_b + grad N_b (x) u) dv;
    v, u (..., 3) and G_a, G_b (..., q, 3).
    """
    left = small_strain(np.einsum("...i,...qj->...qij", v, G_a))
    right = small_strain(np.einsum("...i,...qj->...qij", u, G_b))
    return np.einsum("...qij,...qijkl,...qkl,...q->...", left, c, right, dv)


def strain_displacement(G: Array) -> Array:
    """B_a (47), shape (..., n, 6, 3): the Voigt strain (45) is sum_a B_a u_a."""
    x, y, z = (G[..., j] for j in range(3))
    zero = np.zeros_like(x)
    rows = [
        *([x, zero, zero], [zero, y, zero], [zero, zero, z]),
        *([y, x, zero], [zero, z, y], [z, zero, x]),
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def constitutive_stiffness(G: Array, D: Array, dv: Array) -> Array:
    """K_c,ab = int B_a^T D B_b dv (48), shape (..., n, 3, n, 3), for any D."""
    B = strain_displacement(G)
    return np.einsum("...qaIi,...qIJ,...qbJj,...q->...aibj", B, D, B, dv, optimize=True)


def isotropic_matrix(lmbda: Array | float, mu: Array | float) -> Array:
    """The matrix D of (49) from lmbda', mu'."""
    lmbda, mu = np.broadcast_arrays(lmbda, mu)
    D = np.zeros((*lmbda.shape, 6, 6), dtype=np.result_type(lmbda, mu))
    D[..., :3, :3] = lmbda[..., None, None]
    for i in range(6):
        D[..., i, i] += (2 if i < 3 else 1) * mu
    return D


def neo_hookean_matrix(J: Array, mu: float, lmbda: float) -> Array:
    """D of (49) for the neo-Hookean energy (16); its det J is J = det F, not det J^(e)."""
    return isotropic_matrix(*effective_moduli(J, mu, lmbda))


def initial_stress_work(
    v: Array, G_a: Array, sigma: Array, u: Array, G_b: Array, dv: Array
) -> Array:
    """D dW_sigma = int sigma : [(u (x) grad N_b)^T (dv (x) grad N_a)] dv (50), one a, one b."""
    grad_v, grad_u = (np.einsum("...i,...qj->...qij", w, G) for w, G in ((v, G_a), (u, G_b)))
    return np.einsum("...qij,...qki,...qkj,...q->...", sigma, grad_u, grad_v, dv)


def initial_stress_stiffness(G: Array, sigma: Array, dv: Array) -> Array:
    """K_sigma,ab = (int grad N_a . sigma grad N_b dv) I (51), shape (..., n, 3, n, 3)."""
    scalar = np.einsum("...qai,...qij,...qbj,...q->...ab", G, sigma, G, dv, optimize=True)
    return np.einsum("...ab,ij->...aibj", scalar, np.eye(3))


def element_tangent(G: Array, D: Array, sigma: Array, dv: Array) -> Array:
    """K_c + K_sigma (48), (51), the derivative of T_a (55) with respect to x_b."""
    return constitutive_stiffness(G, D, dv) + initial_stress_stiffness(G, sigma, dv)


# VIII. Residual form


def virtual_work(
    sigma: Array, dd: Array, dv: Array, f: Array, v: Array, t: Array, v_s: Array, da: Array
) -> Array:
    """Virtual work int sigma : dd dv - int f . dv dv - int t . dv da (52).

    f, v (..., q, 3): force per volume and virtual velocity; t, v_s, da: traction, virtual velocity
    and weighted area at points of the surface. It vanishes for the assembled body, not per element.
    """
    internal = np.einsum("...qij,...qij,...q->...", sigma, dd, dv)
    body = np.einsum("...qi,...qi,...q->...", f, v, dv)
    return internal - body - np.einsum("...qi,...qi,...q->...", t, v_s, da)


def internal_force(sigma: Array, G: Array, dv: Array) -> Array:
    """T_a = int sigma grad N_a dv (55), shape (..., n, 3) [N]."""
    return np.einsum("...qij,...qaj,...q->...ai", sigma, G, dv)


def external_force(N: Array, f: Array, measure: Array) -> Array:
    """One integral of F_a = int N_a f dv + int N_a t da (53)-(55), shape (..., n, 3) [N].

    Args:
        N: Shape functions at the points of the volume or of the surface, (..., q, n).
        f: Body force [N/m^3] or traction [Pa] there, (..., q, 3).
        measure: dv or da, (..., q); dead loads per reference volume and area take dV and dA.
    """
    return np.einsum("...qa,...qi,...q->...ai", N, f, measure)


def surface_element(dN: Array, x: Array, tangents: Array) -> Array:
    """Vector n da per weight at points of a face, shape (..., q, 3); its length is da [m^2].

    tangents (2, 3) are those of :func:`forms.formulas.shapes.facet_map`.
    """
    along = np.einsum("...qij,sj->...qsi", jacobian(dN, x), tangents)
    return np.cross(along[..., 0, :], along[..., 1, :])


def residual(T: Array, F: Array) -> Array:
    """R = T - F (57)."""
    return T - F


def element_vector(T: Array, as_printed: bool = False) -> Array:
    """T^(e) = [T_1; ...; T_n] of (56), (58), shape (..., 3 n).

    Printed: sum_a T_a, which is zero whatever the stress is, because sum_a grad N_a = 0.
    """
    return np.sum(T, axis=-2) if as_printed else T.reshape(*T.shape[:-2], -1)


def element_matrix(K: Array) -> Array:
    """Blocks K_ab (..., n, 3, n, 3) as a matrix (..., 3 n, 3 n), in the order of the vector."""
    size = 3 * K.shape[-2]
    return K.reshape(*K.shape[:-4], size, size)


def quadrature_force(
    sigma: Array, G: Array, weights: Array, det: Array, as_printed: bool = False
) -> Array:
    """T_a = sum_i W_i sigma(xi_i) grad N_a(xi_i) det J^(e)(xi_i) (58), shape (..., n, 3).

    J^(e) is that of the present configuration. Printed: one sigma (..., 3, 3) in front of the sum.
    """
    if as_printed:
        summed = np.einsum("...qaj,...q,...q->...aj", G, weights, det)
        return np.einsum("...ij,...aj->...ai", sigma, summed)
    return np.einsum("...qij,...qaj,...q,...q->...ai", sigma, G, weights, det)


def point_force(
    sigma: Array, G: Array, weight: float, det: float, as_printed: bool = False
) -> Array:
    """I_a = W_i det J^(e) sigma grad N_a at one point (59), (60), shape (n, 3).

    sigma (3, 3), G (n, 3). Printed: without the weight.
    """
    return (1.0 if as_printed else weight) * det * (G @ np.transpose(sigma))


@dataclass
class Integrator:
    """Element force and stiffness, gathered point by point (59), (60).

    Args:
        cell: Kind of cell, as in :mod:`forms.formulas.shapes`.
        X: Nodes of the reference configuration [m], shape (n, 3).
        x: Nodes of the present one.
        material: Cauchy stress (3, 3) and elasticity tensor c (3, 3, 3, 3) of F.
        as_printed: Leave out the weights in the force, as (59) does.

    Attributes:
        force: Sum so far of T_a, shape (n, 3) [N].
        stiffness: Sum so far of K_c + K_sigma, shape (n, 3, n, 3) [N/m].
    """

    cell: str
    X: Array
    x: Array
    material: Callable[[Array], tuple[Array, Array]]
    as_printed: bool = False
    force: Array = field(init=False)
    stiffness: Array = field(init=False)

    def __post_init__(self) -> None:
        n = len(self.X)
        self.force, self.stiffness = np.zeros((n, 3)), np.zeros((n, 3, n, 3))

    def at_point(self, p: Array, w: float, dv: float) -> None:
        """Add the point p of weight w; dv = det J^(e) of the present configuration there."""
        dN = shape_gradients(self.cell, np.asarray(p)[None])
        (G,), (G0, _) = gradients(dN, self.x)[0], gradients(dN, self.X)
        sigma, c = self.material(deformation_gradient(self.x, G0)[0])
        self.force += point_force(sigma, G, w, dv, self.as_printed)
        D = voigt_elasticity(c)[None]
        self.stiffness += element_tangent(G[None], D, sigma[None], np.array([w * dv]))

    def process(self, points: Array, weights: Array) -> None:
        """Visit all points of a rule."""
        dets = gradients(shape_gradients(self.cell, points), self.x)[1]
        for p, w, dv in zip(points, weights, dets, strict=True):
            self.at_point(p, w, dv)


def assemble_vector(vectors: Array, cells: Array, nodes: int) -> Array:
    """Sum of nodal vectors (cells, n, 3) into a vector (3 nodes,); cells (cells, n) are numbers.

    External forces of any cells or faces, or of single nodes, are added the same way.
    """
    total = np.zeros((nodes, 3))
    np.add.at(total, cells, vectors)
    return total.reshape(-1)


def assemble_matrix(blocks: Array, cells: Array, nodes: int) -> Array:
    """Sum of blocks K_ab (cells, n, 3, n, 3) into a matrix (3 nodes, 3 nodes)."""
    dofs = (3 * cells[..., None] + np.arange(3)).reshape(len(cells), -1)
    total = np.zeros((3 * nodes, 3 * nodes))
    np.add.at(total, (dofs[:, :, None], dofs[:, None, :]), element_matrix(blocks))
    return total


def _check_nodes(n: int, values: Array, equation: str) -> None:
    if values.shape[-2:] != (n, 3):
        raise ValueError(
            f"{equation} needs a vector at each of {n} nodes, shape (..., {n}, 3), "
            f"got {values.shape}."
        )
