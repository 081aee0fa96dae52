# SPDX-License-Identifier: MIT
"""The block in GetFEM: the energy in its assembly language, its own solver with MUMPS.

Prescribed displacements by multipliers, which bring them in with the first linear system; put in at
once, as without multipliers, they turn cells inside out in steps of this size. Full Newton steps:
the search along the residual, its default, is misled by the multipliers (9 iterations for 5).
"""

from importlib import metadata

import getfem
import numpy as np

from .newton import medians
from .problem import (
    LMBDA,
    MU,
    STEPS,
    Clock,
    arguments,
    bent,
    block,
    report,
    tolerance,
    turned,
)

ENERGY = "mu/2*(Norm_sqr(F)-3) - mu*log(Det(F)) + lmbda/2*sqr(log(Det(F)))"


def main():
    """Solve, or assemble, and print the row."""
    given = arguments(solver=("mumps",))
    getfem.util_trace_level(0)
    getfem.util_warning_level(0)
    clock = Clock()
    points, cells = block(given.m)
    mesh = getfem.Mesh("empty", 3)
    mesh.add_point(points.T)
    simplex = getfem.GeoTrans("GT_PK(3,1)")
    mesh.add_convex(simplex, np.ascontiguousarray(points[cells].transpose(2, 1, 0)))
    field = getfem.MeshFem(mesh, 3)
    field.set_fem(getfem.Fem(f"FEM_PK(3,{given.degree})"))
    inside = getfem.MeshIm(mesh, getfem.Integ(f"IM_TETRAHEDRON({given.degree})"))
    # Products of two functions of the multipliers' space are to be exact.
    exact = getfem.MeshIm(mesh, getfem.Integ("IM_TETRAHEDRON(5)"))
    for region, at in ((1, 0.0), (2, 1.0)):
        box = [at - 1e-9, -1, -1], [at + 1e-9, 2, 2]
        mesh.set_region(region, mesh.outer_faces_in_box(*box))
    model = getfem.Model("real")
    model.add_fem_variable("u", field)
    model.add_initialized_data("mu", MU)
    model.add_initialized_data("lmbda", LMBDA)
    model.add_initialized_fem_data("end", field, np.zeros(field.nbdof()))
    with clock("compile"):
        model.add_nonlinear_term(inside, ENERGY.replace("F", "(Id(3)+Grad_u)"))
    places = field.basic_dof_nodes().T
    component = np.arange(len(places)) % 3
    rows = np.arange(len(places))
    about = {"dofs": len(places), "version": version(), "solver": given.solver}
    if given.assemble:
        model.set_variable("u", bent(places)[rows, component])
        row = medians(
            given.assemble,
            residual=lambda: model.assembly("build_rhs"),
            tangent=lambda: model.assembly("build_matrix"),
        )
        report("GetFEM", given, Clock(), **about, **row)
        return
    model.add_Dirichlet_condition_with_multipliers(exact, "u", field, 1)
    model.add_Dirichlet_condition_with_multipliers(exact, "u", field, 2, "end")
    smallest, iterations = tolerance(points), []
    with clock("solve loop"):
        for step in range(1, given.steps + 1):
            model.set_variable("end", turned(places, step / STEPS)[rows, component])
            done = model.solve(
                "max_res", smallest, "max_iter", 30, "lsolver", "mumps", "lsearch", "basic"
            )
            iterations.append(int(np.ravel(done)[0]))
    # Of the equations of the free unknowns: multipliers have no part in these.
    fixed = np.isclose(places[:, 0], 0) | np.isclose(places[:, 0], 1)
    model.assembly("build_rhs")
    first, size = model.interval_of_variable("u")
    norm = float(np.linalg.norm(model.rhs()[first : first + size][~fixed]))
    about |= {"Newton": iterations, "residual": norm, "tolerance": smallest}
    values = in_order(points, places[::3], model.variable("u").reshape(-1, 3))
    report(f"GetFEM {given.solver}", given, clock, values, **about)


def in_order(points, places, values):
    """Values at the points, out of values at places in another order."""

    def key(point):
        return tuple(np.round(1e6 * point).astype(int))

    numbers = {key(place): number for number, place in enumerate(places)}
    return values[[numbers[key(point)] for point in points]]


def version():
    """Of Debian's package, which tells Python none."""
    try:
        return metadata.version("getfem")
    except metadata.PackageNotFoundError:
        return "5.4.4"


if __name__ == "__main__":
    main()
