# SPDX-License-Identifier: MIT
"""Ways to P = dpsi/dF and dP/dF of energies in singular values, for demos.benchmarks.atlas.

A way is a function of a case, of F (n, 3, 3) and of what is right there; it yields P (n, 3, 3) and
dP/dF (n, 3, 3, 3, 3).
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem, mesh
from mpmath import mp, mpf

from variform.forms import energies
from variform.forms.formulas import quotients, svd_derivatives

MU, LMBDA = 1.0, 2.5
DIGITS, STEP = 110, mpf(10) ** -25
STEPS = 10.0 ** -np.arange(3, 8.1, 0.5)


@dataclass
class Case:
    """An energy, written once for UFL and mpmath, as NumPy's formulas, and as variform's kernels.

    Attributes:
        psi: psi_hat(s, ln) of three singular values.
        formulas: The same with its derivatives by hand.
        kernels: The same in variform.
        inverted: Whether the maps go to s2 + s3 = 0, or else to s2 - s3 = 0.
        smooth: Whether (psi_i + psi_j)/(s_i + s_j) has a limit.
    """

    psi: Callable
    formulas: quotients.Energy
    kernels: Callable
    inverted: bool = True
    smooth: bool = True

    @property
    def other(self):
        """The second axis of its map."""
        return "|s2 + s3|" if self.inverted else "|s2 - s3|"


def corotated(s, ln):
    """Fixed corotated energy."""
    return MU * sum((x - 1) ** 2 for x in s) + LMBDA / 2 * (s[0] * s[1] * s[2] - 1) ** 2


def saint_venant(s, ln):
    """St Venant-Kirchhoff energy."""
    e = [(x**2 - 1) / 2 for x in s]
    return MU * sum(x**2 for x in e) + LMBDA / 2 * sum(e) ** 2


def hencky(s, ln):
    """Hencky's energy."""
    e = [ln(x) for x in s]
    return MU * sum(x**2 for x in e) + LMBDA / 2 * sum(e) ** 2


CASES = {
    "fixed corotated": Case(
        corotated,
        quotients.fixed_corotated(MU, LMBDA),
        energies.fixed_corotated,
        smooth=False,
    ),
    "St Venant-Kirchhoff": Case(
        saint_venant,
        quotients.saint_venant_kirchhoff(MU, LMBDA),
        energies.saint_venant_kirchhoff_stretches,
    ),
    "Hencky": Case(hencky, quotients.hencky(MU, LMBDA), energies.hencky, inverted=False),
}


# Exact stress and tangent


def errors(found, right):
    """Relative errors, one for each F."""
    axes = tuple(range(1, right.ndim))
    norm = np.sqrt(np.sum(right**2, axes))
    return np.sqrt(np.sum((found - right) ** 2, axes)) / norm


def derivatives(psi, s):
    """psi_i and psi_ij by central differences in long arithmetic."""

    def value(*moves):
        return psi([x + STEP * sum(m for k, m in moves if k == i) for i, x in enumerate(s)], mp.log)

    middle = value()
    up, down = ([value((i, m)) for i in range(3)] for m in (1, -1))
    g = [(up[i] - down[i]) / (2 * STEP) for i in range(3)]
    H = np.empty((3, 3), object)
    for i in range(3):
        H[i, i] = (up[i] + down[i] - 2 * middle) / STEP**2
    for i, j in combinations(range(3), 2):
        both = value((i, 1), (j, 1)) + value((i, -1), (j, -1)) + 2 * middle
        H[i, j] = H[j, i] = (both - up[i] - down[i] - up[j] - down[j]) / (2 * STEP**2)
    return g, H


def exact(case, F):
    """P and dP/dF of one F in long arithmetic; NaN where they have no value."""
    with mp.workdps(DIGITS):
        U, s, Vt = mp.svd(mp.matrix(F.tolist()))
        s = list(s)
        for matrix, axis in ((U, 0), (Vt, 1)):
            if mp.det(matrix) < 0:
                s[2] = -s[2]
                for k in range(3):
                    matrix[(k, 2) if axis == 0 else (2, k)] *= -1
        g, H = derivatives(case.psi, s)
        T = np.zeros((3, 3, 3, 3), object)
        for i, j in combinations(range(3), 2):
            # So near are only states whose F has equal or opposite entries.
            near, flat = abs(s[i] - s[j]) < STEP, abs(s[i] + s[j]) < STEP
            difference = H[i, i] - H[i, j] if near else (g[i] - g[j]) / (s[i] - s[j])
            total = H[i, i] + H[i, j] if flat else (g[i] + g[j]) / (s[i] + s[j])
            total = mp.nan if flat and not case.smooth else total
            T[i, j, i, j] = T[j, i, j, i] = (difference + total) / 2
            T[i, j, j, i] = T[j, i, i, j] = (difference - total) / 2
        for i, j in np.ndindex(3, 3):
            T[i, i, j, j] = H[i, j]
        long = np.vectorize(lambda x: np.longdouble(mp.nstr(mpf(x), 25)), otypes=[np.longdouble])
        U, Vt = (long(np.array(matrix.tolist())) for matrix in (U, Vt))
        P = (U * long(np.array(g))) @ Vt
        A = np.einsum("abcd,ia,bj,kc,dl->ijkl", long(T), U, Vt, U, Vt, optimize=True)
    return P.astype(float), A.astype(float)


# Ways


def plain(C, epsilon=0.0):
    """Eigenvalues of C by Viete's cosines, as they are usually written."""
    q = ufl.tr(C) / 3
    B = C - q * ufl.Identity(3)
    p = ufl.sqrt(ufl.inner(B, B) / 6 + epsilon**2) if epsilon else ufl.sqrt(ufl.inner(B, B) / 6)
    r = ufl.det(B) / (2 * p**3)
    if epsilon:
        r = ufl.max_value(ufl.min_value(r, 1 - epsilon), epsilon - 1)
    return [q + 2 * p * ufl.cos((ufl.acos(r) - 2 * k * ufl.pi) / 3) for k in range(3)]


def squares(C, epsilon=3e-16):
    """The same with a discriminant that loses no digits by cancellation.

    It is the Gram determinant of (I, B, B^2), B the deviator of C: the sum of the squares of their
    3 x 3 minors.

    Source: the idea is Habera's and Zilian's, arXiv:2111.02117; their products are others.
    """
    B = C - ufl.tr(C) / 3 * ufl.Identity(3)
    entries = (0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)
    rows = [[matrix[k] for k in entries] for matrix in (ufl.Identity(3), B, B * B)]
    discriminant = epsilon**2
    for chosen in combinations(range(6), 3):
        minor = ufl.det(ufl.as_matrix([[row[k] for k in chosen] for row in rows]))
        # An entry off the diagonal stands twice in the inner product.
        discriminant += 2 ** sum(k > 2 for k in chosen) * minor**2
    p = ufl.sqrt(1.5 * ufl.inner(B, B) + epsilon**2)
    angle = ufl.atan2(ufl.sqrt(27 * discriminant), 27 * ufl.det(B))
    return [ufl.tr(C) / 3 + 2 * p * ufl.cos((angle - 2 * k * ufl.pi) / 3) / 3 for k in range(3)]


def differentiated(eigenvalues):
    """Automatic differentiation of psi_hat by UFL, compiled by DOLFINx."""

    def way(case, F, reference):
        line = mesh.create_interval(MPI.COMM_SELF, len(F), [0, 1])
        field = fem.Function(fem.functionspace(line, ("DG", 0, (3, 3))))
        field.x.array.reshape(-1, 9)[field.function_space.dofmap.list[:, 0]] = F.reshape(-1, 9)
        X = ufl.variable(field)
        s1, s2 = (ufl.sqrt(x) for x in eigenvalues(X.T * X)[:2])
        # Not the root of the third eigenvalue: J gives the sign, and digits of a small s3.
        P = ufl.diff(case.psi([s1, s2, ufl.det(X) / (s1 * s2)], ufl.ln), X)
        cells, shape = np.arange(len(F), dtype=np.int32), F.shape
        for expression in (P, ufl.diff(P, X)):
            values = fem.Expression(expression, np.array([[0.5]])).eval(line, cells)
            yield values.reshape(shape)
            shape = (*shape, 3, 3)

    return way


def decomposed(denominator):
    """NumPy's SVD and the blocks of document 000, with denominators of the user's."""

    def way(case, F, reference):
        U, s, V = svd_derivatives.signed_svd(F)
        g = case.formulas.gradient(s)
        blocks = []
        for i, j in quotients.PAIRS[3]:
            minus = (g[:, i] - g[:, j]) / denominator(s[:, i] - s[:, j])
            plus = (g[:, i] + g[:, j]) / denominator(s[:, i] + s[:, j])
            blocks.append(svd_derivatives.block_split(minus, plus))
        yield svd_derivatives.compose(U, g, V)
        yield svd_derivatives.tangent(U, V, case.formulas.hessian(s), np.stack(blocks, -3))

    return way


def differences(case, F, reference):
    """Central differences of psi, and of P; each with the step of the least median error."""

    def energy(F):
        return case.formulas.value(svd_derivatives.signed_svd(F)[1])

    def stress(F):
        return svd_derivatives.first_piola(case.formulas, F)

    for function, right in zip((energy, stress), reference, strict=True):
        best = None
        for h in STEPS:
            found = np.empty_like(right)
            for k, n in np.ndindex(3, 3):
                move = np.zeros((3, 3))
                move[k, n] = h
                found[..., k, n] = (function(F + move) - function(F - move)) / (2 * h)
            error = np.nanmedian(errors(found, right))
            if best is None or error < best[0]:
                best = error, found
        yield best[1]


def kernels(case, F, reference):
    """The compiled kernels that a solve uses."""
    yield from case.kernels.evaluate(F, MU, LMBDA)


WAYS = {
    "UFL, plain": differentiated(plain),
    "UFL, epsilon 1e-12": differentiated(lambda C: plain(C, 1e-12)),
    "UFL, sum of squares": differentiated(squares),
    "NumPy, naive": decomposed(lambda x: x),
    "NumPy, clamped 1e-6": decomposed(quotients.clamp),
    "differences": differences,
    "variform": kernels,
}
