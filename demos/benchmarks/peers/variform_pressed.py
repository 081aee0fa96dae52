# SPDX-License-Identifier: MIT
"""The cube on a rigid plane in variform, and two cubes of 8^3 and 13^3 cells on each other.

dhat is a hundredth of a cell; the barrier begins where the bodies touch, and its stiffness is the
default of obstacles.
"""

from mpi4py import MPI

import numpy as np
import ufl

from demos.benchmarks.stacks import stack
from variform import forms, meshes
from variform.forms import obstacles

from .pressed import BLOCKS, BY, LMBDA, MU, arguments, clocked, cube, report


def main():
    """Follow the path with the defaults, and print the row."""
    given = arguments("obstacle", "surfaces")
    two, comm = given.solver == "surfaces", MPI.COMM_SELF
    dhat = 0.01 / given.n
    if two:
        points, cells, names = stack(BLOCKS[0], given.n, dhat, dim=3)
    else:
        points, cells = cube(given.n)
        names = {"up face": np.flatnonzero(points[:, 2] == 0)}
        names["up end"] = np.flatnonzero(points[:, 2] == 1)
        for axis in (0, 1):
            names[f"side {axis}"] = np.flatnonzero(np.isin(points[:, axis], (0, 1)))
    body = meshes.from_arrays(comm, points, cells, cell="hexahedron", boundaries=names)
    u, t = forms.displacement(body), forms.load_factor(body)
    F = forms.deformation_gradient(u)
    psi = forms.energies.neo_hookean(F, MU, LMBDA)
    held = [forms.roller(u, body.facets(f"side {axis}"), axis) for axis in (0, 1)]
    low, by = (1.0 + dhat, 2 * BY + dhat) if two else (0.0, BY)
    held.append(forms.translate(u, body.facets("up end"), (None, None, -by * t)))
    if two:
        held.append(forms.roller(u, body.facets("low end"), 2))
        faces = body.ds("low face", "up face")
        potential = [psi * ufl.dx, forms.touching(u, faces, stiffness=0.1, dhat=dhat)]
    else:
        plane = obstacles.plane((0, 0, 0), (0, 0, 1))
        wall = forms.obstacle(u, plane, body.ds("up face"), dhat=dhat, gap=dhat)
        potential = psi * ufl.dx + wall
    forms.Problem(potential, u, held)  # compiles
    path, seconds = clocked(lambda: forms.follow(potential, u, held, t, progress=False))
    force = forms.resultant(path, body.facets("up end"))[0][2]
    P33 = forms.field(forms.stress.first_piola(psi, F)[2, 2], body.mesh, 0).x.array
    middle = body.mesh.geometry.x[body.mesh.geometry.dofmap].mean(axis=1)[:, 2]
    beside = (middle > low) & (middle < low + 1 / given.n)
    X = u.function_space.tabulate_dof_coordinates()
    # Over the plane where both would be half as high as they are together.
    height = u.x.array.reshape(-1, 3)[np.isclose(X[:, 2], low), 2] + (BY + dhat if two else 0.0)
    about = {"dofs": path.problem.size, "steps": len(path.steps), "tangents": path.tangents}
    report("variform", given, force, P33[beside], height, seconds, **about)


if __name__ == "__main__":
    main()
