# SPDX-License-Identifier: MIT
"""Ways to stress and tangent of fixed corotated: functions of gradients (n, 3, 3), per library.

The library is imported where it is used: each is in an environment of its own.
"""

import os

import numpy as np

from .problem import LMBDA, MU


def closed_form(F):
    """P and dP/dF (n, 9, 9) in NumPy, the usual function of an external operator."""
    U, s, Vt = np.linalg.svd(F)
    signs = np.sign(np.linalg.det(U)), np.sign(np.linalg.det(Vt))
    U[:, :, 2] *= signs[0][:, None]
    Vt[:, 2] *= signs[1][:, None]
    s[:, 2] *= signs[0] * signs[1]
    rows = np.roll(F, -1, 1), np.roll(F, -2, 1)
    cofactor = np.cross(*rows)
    J = (F * cofactor).sum((1, 2)) / 3
    P = 2 * MU * (F - U @ Vt) + LMBDA * (J - 1)[:, None, None] * cofactor
    flat = cofactor.reshape(-1, 9)
    D = LMBDA * flat[:, :, None] * flat[:, None, :]
    D[:, range(9), range(9)] += 2 * MU
    for i, j in ((0, 1), (0, 2), (1, 2)):
        twist = U[:, :, i, None] * Vt[:, None, j] - U[:, :, j, None] * Vt[:, None, i]
        twist = twist.reshape(-1, 9)
        with np.errstate(divide="ignore", invalid="ignore"):
            weight = 2 * MU / (s[:, i] + s[:, j])
            D -= weight[:, None, None] * twist[:, :, None] * twist[:, None, :]
    permutation = np.zeros((3, 3, 3))
    permutation[[0, 1, 2], [1, 2, 0], [2, 0, 1]] = 1
    permutation[[0, 2, 1], [2, 1, 0], [1, 0, 2]] = -1
    second = np.einsum("ikp,jlq,npq->nijkl", permutation, permutation, F, optimize=True)
    return P, D + LMBDA * (J - 1)[:, None, None] * second.reshape(-1, 9, 9)


def by_numpy():
    """The closed form in NumPy."""
    return {"NumPy closed form": closed_form}


def by_variform():
    """This package's compiled kernel."""
    from variform.forms import energies

    return {"variform": lambda F: energies.fixed_corotated.evaluate(F, MU, LMBDA)}


def by_ufl():
    """Eigenvalues of C by Cardano's formula in UFL, its derivatives by UFL.

    A small number under the root keeps it from 0/0 at equal stretches.
    """
    from mpi4py import MPI

    import ufl
    from dolfinx import fem, mesh

    def compiled(small):
        kept = {}

        def evaluate(values):
            if len(values) not in kept:
                kept.clear()
                kept[len(values)] = prepare(len(values))
            F, both, cells = kept[len(values)]
            F.x.array[:] = values.ravel()
            return [part.eval(F.function_space.mesh, cells) for part in both]

        def prepare(count):
            body = mesh.create_unit_interval(MPI.COMM_SELF, count)
            f = fem.Function(fem.functionspace(body, ("DG", 0, (3, 3))))
            F = ufl.variable(f)
            C = F.T * F
            mean = ufl.tr(C) / 3
            B = C - mean * ufl.Identity(3)
            size = ufl.sqrt(ufl.inner(B, B) / 6 + small)
            angle = ufl.acos(ufl.det(B) / (2 * size**3) * (1 - 1e3 * small)) / 3
            roots = [mean + 2 * size * ufl.cos(angle + 2 * np.pi * k / 3) for k in range(3)]
            psi = MU * sum((ufl.sqrt(root) - 1) ** 2 for root in roots)
            P = ufl.diff(psi + LMBDA / 2 * (ufl.det(F) - 1) ** 2, F)
            point = np.array([[0.5]])
            both = [fem.Expression(part, point) for part in (P, ufl.diff(P, F))]
            # DG0 has one unknown block per cell, numbered as the cells.
            return f, both, np.arange(count, dtype=np.int32)

        return evaluate

    return {"UFL eigenvalues": compiled(0.0), "UFL eigenvalues, + 1e-12": compiled(1e-12)}


def by_jax():
    """JAX through its svd, of F - R or of s - 1. J by products: det's derivatives divide by J."""
    os.environ.setdefault(
        "XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
    )
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)

    def signed(F):
        U, s, Vt = jnp.linalg.svd(F)
        a, b = jnp.sign(jnp.linalg.det(U)), jnp.sign(jnp.linalg.det(Vt))
        return U.at[:, 2].multiply(a), s.at[2].multiply(a * b), Vt.at[2].multiply(b)

    def volume(F):
        return LMBDA / 2 * (jnp.cross(F[0], F[1]) @ F[2] - 1) ** 2

    def polar(F):
        U, _, Vt = signed(F)
        return MU * jnp.sum((F - U @ Vt) ** 2) + volume(F)

    def stretches(F):
        return MU * jnp.sum((signed(F)[1] - 1) ** 2) + volume(F)

    def both(psi):
        work = jax.jit(jax.vmap(lambda F: (jax.grad(psi)(F), jax.jacfwd(jax.grad(psi))(F))))
        return lambda F: jax.block_until_ready(work(F))

    return {"JAX svd, F - R": both(polar), "JAX svd, s": both(stretches)}


def by_torch():
    """The same two by torch's svd."""
    import torch
    from torch.func import grad, jacrev, vmap

    torch.set_num_threads(1)

    def signed(F):
        U, s, Vt = torch.linalg.svd(F)
        sign = torch.sign(torch.linalg.det(U) * torch.linalg.det(Vt)).detach()
        signs = torch.stack([torch.ones_like(sign), torch.ones_like(sign), sign])
        return U * signs, s * signs, Vt

    def volume(F):
        return LMBDA / 2 * (torch.linalg.cross(F[0], F[1]) @ F[2] - 1) ** 2

    def polar(F):
        U, _, Vt = signed(F)
        return MU * ((F - U @ Vt) ** 2).sum() + volume(F)

    def stretches(F):
        return MU * ((signed(F)[1] - 1) ** 2).sum() + volume(F)

    def both(psi):
        work = vmap(lambda F: (grad(psi)(F), jacrev(grad(psi))(F)))
        return lambda F: [part.detach().numpy() for part in work(torch.tensor(F))]

    return {"torch svd, F - R": both(polar), "torch svd, s": both(stretches)}


def by_felupe():
    """FElupe's differentiation through the eigenvalues of C; J is their root."""
    import felupe
    import tensortrax.math as tm

    def psi(C):
        squares = tm.linalg.eigvalsh(C)
        J = tm.sqrt(tm.linalg.det(C))
        return MU * tm.sum((tm.sqrt(squares) - 1) ** 2) + LMBDA / 2 * (J - 1) ** 2

    law = felupe.Hyperelastic(psi)

    def both(F):
        F = [np.ascontiguousarray(np.moveaxis(F, 0, -1))[..., None], None]
        return [np.moveaxis(part[0][..., 0], -1, 0) for part in (law.gradient(F), law.hessian(F))]

    return {"FElupe eigvalsh": both}


# With the number of points at which each is timed.
WAYS = {
    "numpy": (by_numpy, 50_000),
    "variform": (by_variform, 200_000),
    "ufl": (by_ufl, 50_000),
    "jax": (by_jax, 20_000),
    "torch": (by_torch, 5_000),
    "felupe": (by_felupe, 10_000),
}
