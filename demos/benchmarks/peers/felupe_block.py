# SPDX-License-Identifier: MIT
"""The block in FElupe: its neo-Hookean solid and its Newton method, with PARDISO or SuperLU.

Its own test divides the residual by the reactions, and takes sums of magnitudes for norms; here the
test is everyone's.
"""

import felupe
import numpy as np

from .newton import linear, medians
from .problem import (
    LMBDA,
    MU,
    STEPS,
    Clock,
    arguments,
    bent,
    block,
    quadratic,
    report,
    tolerance,
    turned,
)


def main():
    """Solve, or assemble, and print the row."""
    given = arguments(solver=("pardiso", "superlu"))
    clock = Clock()
    points, cells = block(given.m)
    vertices, smallest = len(points), tolerance(points)
    if given.degree == 2:
        points, cells = quadratic(points, cells)
        region = felupe.RegionQuadraticTetra(felupe.Mesh(points, cells, "tetra10"))
    else:
        region = felupe.RegionTetra(felupe.Mesh(points, cells, "tetra"))
    field = felupe.FieldContainer([felupe.Field(region, dim=3)])
    solid = felupe.SolidBody(felupe.NeoHookeCompressible(mu=MU, lmbda=LMBDA), field)
    about = {"dofs": points.size, "version": felupe.__version__, "solver": given.solver}
    if given.assemble:
        field[0].values[:] = bent(points)
        row = medians(
            given.assemble,
            residual=lambda: solid.assemble.vector(field),
            tangent=lambda: solid.assemble.matrix(field),
        )
        report("FElupe", given, Clock(), **about, **row)
        return
    for name, kind in (("residual", "vector"), ("tangent", "matrix")):
        setattr(solid.assemble, kind, timed(clock, name, getattr(solid.assemble, kind)))
    ends = {
        "left": felupe.Boundary(field[0], fx=0),
        "right": felupe.Boundary(field[0], fx=1),
    }
    prescribed, free = felupe.dof.partition(field, ends)
    end = np.isclose(points[:, 0], 1)
    solve, iterations, norms = linear(given.solver, clock), [], []

    def check(dx, x, f, xtol, ftol, dof1=None, dof0=None, items=None):
        norms.append(float(np.linalg.norm(f[dof1])))
        return float(np.linalg.norm(dx)), norms[-1], norms[-1] <= ftol

    with clock("solve loop"):
        for step in range(1, given.steps + 1):
            values = np.zeros_like(points)
            values[end] = turned(points[end], step / STEPS)
            done = felupe.newtonraphson(
                items=[solid],
                x0=field,
                dof0=prescribed,
                dof1=free,
                ext0=values.ravel()[prescribed],
                solver=solve,
                check=check,
                tol=smallest,
                maxiter=30,
                verbose=0,
            )
            iterations.append(done.iterations)
    about |= {"Newton": iterations, "residual": norms[-1], "tolerance": smallest}
    report(f"FElupe {given.solver}", given, clock, field[0].values[:vertices], **about)


def timed(clock, name, work):
    """The same work, its time counted under a name."""

    def counted(*positional, **named):
        with clock(name):
            return work(*positional, **named)

    return counted


if __name__ == "__main__":
    main()
