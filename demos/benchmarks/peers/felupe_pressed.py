# SPDX-License-Identifier: MIT
"""The cube on a rigid plane in FElupe: its ``ContactRigidPlane``, scaled by the solid's stiffness.

``--solver`` is the factor on that penalty, 1 by default; the linear solver is PARDISO.
"""

import felupe
import numpy as np

from .newton import linear
from .pressed import BY, LMBDA, MU, TOLERANCE, arguments, clocked, cube, report
from .problem import Clock


def main():
    """Solve in one step, and print the row."""
    given = arguments("1", "100", "10000")
    points, cells = cube(given.n)
    mesh = felupe.Mesh(points, cells, "hexahedron")
    mesh.add_points([0.5, 0.5, 0.0])  # of the plane
    field = felupe.FieldContainer([felupe.Field(felupe.RegionHexahedron(mesh), dim=3)])
    solid = felupe.SolidBody(felupe.NeoHookeCompressible(mu=MU, lmbda=LMBDA), field)
    x, y, z = mesh.points.T
    centre = np.arange(mesh.npoints) == mesh.npoints - 1
    lower, top = np.isclose(z, 0) & ~centre, np.isclose(z, 1)
    plane = felupe.ContactRigidPlane(
        field, lower, -1, [0, 0, 1], multiplier=float(given.solver), items=[solid]
    )
    sides = [(np.isclose(v, 0) | np.isclose(v, 1)) & ~centre for v in (x, y)]
    held = {
        "x": felupe.Boundary(field[0], mask=sides[0], skip=(0, 1, 1)),
        "y": felupe.Boundary(field[0], mask=sides[1], skip=(1, 0, 1)),
        "top": felupe.Boundary(field[0], mask=top, skip=(1, 1, 0)),
        "plane": felupe.Boundary(field[0], mask=centre),
    }
    prescribed, free = felupe.dof.partition(field, held)
    values = np.zeros_like(mesh.points)
    values[top, 2] = -BY

    def check(dx, x, f, xtol, ftol, dof1=None, dof0=None, items=None):
        norm = float(np.linalg.norm(f[dof1]))
        return float(np.linalg.norm(dx)), norm, norm <= ftol

    done, seconds = clocked(
        lambda: felupe.newtonraphson(
            items=[solid, plane],
            x0=field,
            dof0=prescribed,
            dof1=free,
            ext0=values.ravel()[prescribed],
            solver=linear("pardiso", Clock()),
            check=check,
            tol=TOLERANCE,
            maxiter=50,
            verbose=0,
        )
    )
    inner = solid.assemble.vector(field).toarray().reshape(-1, 3)
    P33 = np.mean(solid.evaluate.gradient(field)[0][2, 2], axis=0)
    beside = points[cells].mean(axis=1)[:, 2] < 1 / given.n
    about = {"dofs": points.size, "steps": 1, "tangents": done.iterations}
    about["version"] = felupe.__version__
    height = field[0].values[lower, 2]
    report("FElupe", given, inner[top, 2].sum(), P33[beside], height, seconds, **about)


if __name__ == "__main__":
    main()
