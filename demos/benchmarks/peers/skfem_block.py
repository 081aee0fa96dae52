# SPDX-License-Identifier: MIT
"""The block in scikit-fem: residual and tangent written by its user, as are Newton's steps."""

import numpy as np
import skfem
from skfem.helpers import ddot, det, grad, inv, mul, trace, transpose

from .newton import linear, medians, newton
from .problem import LMBDA, MU, Clock, arguments, bent, block, report, tolerance, turned


@skfem.LinearForm
def residual_form(v, w):
    """P : grad v."""
    return ddot(w["P"], grad(v))


@skfem.BilinearForm
def tangent_form(u, v, w):
    """Derivative of P in the direction of u, times grad v."""
    change, inverse = grad(u), w["inverse"]
    turned_back = mul(inverse, change)
    dP = (
        MU * change
        + LMBDA * trace(turned_back) * transpose(inverse)
        - (LMBDA * w["log_J"] - MU) * transpose(mul(turned_back, inverse))
    )
    return ddot(dP, grad(v))


def main():
    """Solve, or assemble, and print the row."""
    given = arguments(solver=("pardiso", "superlu"))
    clock = Clock()
    points, cells = block(given.m)
    element = skfem.ElementTetP1() if given.degree == 1 else skfem.ElementTetP2()
    mesh = skfem.MeshTet(points.T.copy(), cells.T.copy())
    basis = skfem.Basis(mesh, skfem.ElementVector(element), intorder=given.degree)
    places = basis.doflocs.T
    component = np.zeros(basis.N, dtype=int)
    for k in range(3):
        component[basis.nodal_dofs[k]] = k
        if given.degree == 2:
            component[basis.edge_dofs[k]] = k

    def kinematics(u):
        F = np.asarray(basis.interpolate(u).grad) + np.eye(3)[:, :, None, None]
        return F, inv(F), np.log(det(F))

    def residual(u):
        F, inverse, log_J = kinematics(u)
        return residual_form.assemble(basis, P=MU * F + (LMBDA * log_J - MU) * transpose(inverse))

    def tangent(u):
        _, inverse, log_J = kinematics(u)
        return tangent_form.assemble(basis, inverse=inverse, log_J=log_J)

    about = {"dofs": int(basis.N), "version": skfem.__version__, "solver": given.solver}
    if given.assemble:
        u = bent(places)[np.arange(basis.N), component]
        row = medians(given.assemble, residual=lambda: residual(u), tangent=lambda: tangent(u))
        report("scikit-fem", given, Clock(), **about, **row)
        return
    left, right = (np.flatnonzero(np.isclose(places[:, 0], at)) for at in (0, 1))

    def prescribed(load):
        moved = turned(places[right], load)[np.arange(len(right)), component[right]]
        return np.concatenate([np.zeros(len(left)), moved])

    smallest = tolerance(points)
    with clock("solve loop"):
        u, iterations, norm = newton(
            residual,
            tangent,
            np.concatenate([left, right]),
            prescribed,
            basis.N,
            given,
            clock,
            linear(given.solver, clock),
            smallest,
        )
    about |= {"Newton": iterations, "residual": norm, "tolerance": smallest}
    report(f"scikit-fem {given.solver}", given, clock, u[basis.nodal_dofs].T, **about)


if __name__ == "__main__":
    main()
