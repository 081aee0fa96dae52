# SPDX-License-Identifier: MIT
"""Cost of an energy in singular values against a plain UFL one: assembled, and point by point.

Run ``docker/enter python3 -m demos.benchmarks.operators``; one JSON line per row, and
``results/operators.csv``. CPU time, variants interleaved in one process, medians; the ratios
are to the plain neo-Hookean energy with the same flags, quadrature and insertion.
"""

import sys
from functools import partial

from mpi4py import MPI

import basix
import basix.ufl
import numpy as np
import ufl
from dolfinx import fem, mesh
from dolfinx.fem import petsc as fem_petsc

from variform import forms, meshes
from variform.forms import energies, insertion
from variform.forms.compilation import compiled
from variform.forms.native import jit

from .record import Table, median_times

MU, LMBDA = 1.0, 2.5


class Stored:
    """The usual way: P and dP/dF stored at quadrature points, by batched NumPy SVDs."""

    def __init__(self, u, degree, v, du):
        V = u.function_space
        self.mesh = V.mesh
        self.F = ufl.Identity(3) + ufl.grad(u)
        points, _ = basix.make_quadrature(basix.CellType.tetrahedron, degree)
        self.operand = jit.expression(self.F, points, self.mesh)
        self.cells = np.arange(self.mesh.topology.index_map(3).size_local, dtype=np.int32)
        self.P, self.A = (fem.Function(self._space(degree, s)) for s in ((3, 3), (3, 3, 3, 3)))
        dx = ufl.dx(degree=degree)
        i, j, k, n = ufl.indices(4)
        change = ufl.as_tensor(self.A[i, j, k, n] * ufl.grad(du)[k, n], (i, j))
        self.residual = compiled(ufl.inner(self.P, ufl.grad(v)) * dx)
        self.tangent = compiled(ufl.inner(change, ufl.grad(v)) * dx)

    def _space(self, degree, shape):
        element = basix.ufl.quadrature_element("tetrahedron", value_shape=shape, degree=degree)
        return fem.functionspace(self.mesh, element)

    def _stretches(self):
        F = self.operand.eval(self.mesh, self.cells).reshape(-1, 3, 3)
        U, s, Vt = np.linalg.svd(F)
        turn_u, turn_v = np.linalg.det(U) < 0, np.linalg.det(Vt) < 0
        U[turn_u, :, 2] *= -1
        Vt[turn_v, 2] *= -1
        s[turn_u ^ turn_v, 2] *= -1
        return U, s, Vt

    def _gradient(self, s):
        others = np.stack([s[:, 1] * s[:, 2], s[:, 0] * s[:, 2], s[:, 0] * s[:, 1]], axis=1)
        J = s.prod(axis=1)
        return 2 * MU * (s - 1) + LMBDA * (J - 1)[:, None] * others, others, J

    def update_residual(self):
        """P of fixed corotated at every point."""
        U, s, Vt = self._stretches()
        g = self._gradient(s)[0]
        self.P.x.array[: 9 * len(s)] = ((U * g[:, None]) @ Vt).ravel()

    def update_tangent(self):
        """dP/dF of fixed corotated at every point, by the blocks A and B_ij."""
        U, s, Vt = self._stretches()
        g, others, J = self._gradient(s)
        M = np.zeros((len(s), 3, 3, 3, 3))
        for a in range(3):
            for b in range(3):
                M[:, a, a, b, b] = LMBDA * others[:, a] * others[:, b]
                if a == b:
                    M[:, a, a, a, a] += 2 * MU
                    continue
                k = 3 - a - b
                M[:, a, a, b, b] += LMBDA * (J - 1) * s[:, k]
                same = 2 * MU - LMBDA * (J - 1) * s[:, k]
                other = (g[:, a] + g[:, b]) / (s[:, a] + s[:, b])
                M[:, a, b, a, b] = (same + other) / 2
                M[:, a, b, b, a] = (same - other) / 2
        W = np.einsum("nia,nbj->nijab", U, Vt).reshape(-1, 9, 9)
        H = W @ M.reshape(-1, 9, 9) @ W.swapaxes(1, 2)
        self.A.x.array[: 81 * len(s)] = H.ravel()


def cases(order, degree, n):
    """Residual and tangent of one box for every way, as functions without arguments."""
    box = mesh.create_box(MPI.COMM_SELF, [[0, 0, 0], [1, 1, 1]], [n] * 3)
    u = forms.displacement(box, degree=order)
    u.interpolate(
        lambda x: 0.1 * np.array([np.sin(3 * x[0]) * x[1], x[1] * x[2], np.cos(2 * x[2]) * x[0]])
    )
    F = forms.deformation_gradient(u)
    dx = ufl.dx(degree=degree)
    systems = {
        "neo_hookean, plain UFL": forms.Problem(energies.neo_hookean(F, MU, LMBDA) * dx, u),
        "fixed_corotated": forms.Problem(energies.fixed_corotated(F, MU, LMBDA) * dx, u),
    }
    v, du = ufl.TestFunction(u.function_space), ufl.TrialFunction(u.function_space)
    stored = Stored(u, degree, v, du)
    vector = systems["fixed_corotated"].create_vector()
    A = systems["fixed_corotated"].create_matrix()
    foreign = fem_petsc.create_matrix(systems["fixed_corotated"].forms.tangent_form)
    residuals, solving, usual = {}, {}, {}

    def into_vector(form, before=None):
        def work():
            if before:
                before()
            with vector.localForm() as local:
                local.set(0)
            fem_petsc.assemble_vector(vector, form)

        return work

    def into_matrix(A, form, before=None):
        def work():
            if before:
                before()
            insertion.assemble(A, form, [])

        return work

    tangents = {}
    for name, system in systems.items():
        residuals[name] = into_vector(system.forms.residual_form)
        tangents[name] = (system.forms.tangent_form, None)
        tangents[name + ", projected"] = (compiled(system.forms.tangent_ufl, project=True), None)
    residuals["fixed_corotated, stored, NumPy"] = into_vector(
        stored.residual, stored.update_residual
    )
    tangents["fixed_corotated, stored, NumPy"] = (stored.tangent, stored.update_tangent)
    for name, (form, before) in tangents.items():
        solving[name] = into_matrix(A, form, before)
        usual[name] = into_matrix(foreign, form, before)
    cells = box.topology.index_map(3).size_local
    ways = {"residual": residuals, "tangent": solving, "tangent, PETSc's insertion": usual}
    return cells, ways


def sheets(order, n):
    """Tangents of a bulged sheet by plain UFL and by operators, at the default quadrature."""
    body = meshes.square(MPI.COMM_SELF, 1.0, 1 / n)
    u = forms.displacement(body, order)
    u.interpolate(lambda x: 0.1 * np.array([x[0], 2 * x[1], np.sin(3 * x[0])]))
    F = forms.membrane_gradient(u)
    same = energies.principal(lambda s1, s2: (s1**2 + s2**2 + 1 / (s1 * s2) ** 2 - 3) / 2)
    systems = {
        "neo_hookean_sheet, plain UFL": forms.Problem(
            energies.neo_hookean_sheet(F, 1.0) * ufl.dx, u
        ),
        "the same by principal": forms.Problem(same(F) * ufl.dx, u),
        "neo_hookean_tension_field": forms.Problem(
            energies.neo_hookean_tension_field(F, 1.0) * ufl.dx, u
        ),
    }
    A = next(iter(systems.values())).create_matrix()
    work = {name: partial(system.tangent, A) for name, system in systems.items()}
    return body.mesh.topology.index_map(2).size_local, work


def points(n):
    """Microseconds per point of the compiled kernels at random deformed states."""
    F = np.eye(3) + 0.1 * np.random.default_rng(0).normal(size=(n, 3, 3))
    evaluate = energies.fixed_corotated._evaluate
    variants = {
        "P": lambda: evaluate(F, (MU, LMBDA), {}, (1,), False),
        "P and dP/dF": lambda: evaluate(F, (MU, LMBDA), {}, (1, 2), False),
        "P and dP/dF, projected": lambda: evaluate(F, (MU, LMBDA), {}, (1, 2), True),
    }
    return {name: 1e6 * t / n for name, t in median_times(variants, 7).items()}


def main(small=False):
    """Measure, print and write the table."""
    repeats = 1 if small else 7
    table = Table("operators")
    sizes = {(1, 1): 3 if small else 26, (2, 2): 2 if small else 13}
    for (order, degree), n in sizes.items():
        cells, kinds = cases(order, degree, n)
        for kind, variants in kinds.items():
            times = median_times(variants, repeats)
            base = times["neo_hookean, plain UFL"]
            about = {"element": f"P{order}", "quadrature degree": degree, "what": kind}
            for name, t in times.items():
                per_cell = {"us per cell": round(1e6 * t / cells, 3), "ratio": round(t / base, 2)}
                table.add(**about, energy=name, **per_cell)
    for order in (1, 2):
        cells, variants = sheets(order, 5 if small else 100)
        times = median_times(variants, repeats)
        base = times["neo_hookean_sheet, plain UFL"]
        about = {"element": f"P{order}", "what": "sheet, tangent"}
        for name, t in times.items():
            per_cell = {"us per cell": round(1e6 * t / cells, 3), "ratio": round(t / base, 2)}
            table.add(**about, energy=name, **per_cell)
    for name, t in points(1_000 if small else 200_000).items():
        about = {"what": f"point kernel, {name}", "energy": "fixed_corotated"}
        table.add(**about, **{"us per point": round(t, 3)})
    table.write()
    return table.rows


if __name__ == "__main__":
    main(small="--small" in sys.argv)
