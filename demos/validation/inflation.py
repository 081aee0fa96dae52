# SPDX-License-Identifier: MIT
"""A thick tube and a thick sphere blown up: incompressible Mooney-Rivlin against closed forms.

psi = c10 (I1 - 3) + c01 (I2 - 3) + p (J - 1),  c10, c01 = 0.4, 0.1 MPa

The radius R of the material goes to r with r^n - R^n = a^n - A^n, n = 2 for the tube in plane
strain, 3 for the sphere. With W(l) the energy at the hoop stretch l = r / R the pressure is

q = int W'(l) / (l^n - 1) dl  from l(B) to l(A),  A, B the inner and the outer radius.

The volume of the hole is prescribed and the pressure found.
"""

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem
from matplotlib.figure import Figure
from scipy.integrate import quad

from variform import forms, meshes

C10, C01 = 0.4, 0.1
INNER, OUTER = 1.0, 2.0
RADII = np.linspace(1.0, 2.0, 11)[1:]


def closed_form(n, a):
    """Pressure of the tube (n = 2) or the sphere (n = 3) whose inner radius is now a."""

    def slope(k):
        """W'(l), by hand from W(l) of the stretches (1/l, l, 1) or (1/l^2, l, l)."""
        if n == 2:
            return 2 * (C10 + C01) * (k - k**-3)
        return 4 * C10 * (k - k**-5) + 4 * C01 * (k**3 - k**-3)

    grown = a**n - INNER**n
    inside, outside = ((grown + R**n) ** (1 / n) / R for R in (INNER, OUTER))
    found = quad(lambda k: slope(k) / (k**n - 1), outside, inside, epsabs=1e-14, epsrel=1e-13)
    return found[0]


def tube(comm):
    """A quarter of the ring in plane strain: body, loaded boundary, planes of symmetry."""
    body = meshes.block(comm, (1.0, 1.0), n=(4, 8), cells="quadrilateral", order=2)
    x = body.mesh.geometry.x
    r, angle = INNER + (OUTER - INNER) * x[:, 0], np.pi / 2 * x[:, 1]
    x[:, 0], x[:, 1] = r * np.cos(angle), r * np.sin(angle)
    return body, "left", {"bottom": 1, "top": 0}


def sphere(comm):
    """An eighth of the shell: body, loaded boundary, planes of symmetry."""
    body = meshes.sphere_octant(comm, INNER, OUTER, h=0.35, order=2)
    return body, "inner", {"x0": 0, "y0": 1, "z0": 2}


def blown_up(n, comm=MPI.COMM_WORLD):
    """Pressures at the inner radii RADII, the path and its F."""
    body, inside, planes = (tube if n == 2 else sphere)(comm)
    w, q = forms.displacement_pressure(body), fem.Constant(body.mesh, 0.0)
    u, p = ufl.split(w)
    F = forms.deformation_gradient(u)
    psi = forms.energies.with_pressure(forms.energies.mooney_rivlin(F, C10, C01), F, p)
    potential = psi * ufl.dx + forms.pressure_potential(u, q, body.ds(inside))
    hole = -forms.pressure_potential(u, 1.0, body.ds(inside))
    held = [forms.roller(w, body.facets(name), axis) for name, axis in planes.items()]
    # The mesh's own hole grows as the true one, from which it differs by the error of its sides.
    targets = forms.integral(hole) * (RADII / INNER) ** n
    path = forms.control(
        potential, w, held, q, hole, targets, rtol=1e-12, ctol=1e-10, progress=False
    )
    return np.array([step.load for step in path.steps]), path, F


def run(folder, comm=MPI.COMM_WORLD):
    """Pressures of both at twice the inner radius, the chart and the pictures."""
    numbers, found = {}, {}
    for name, n in (("tube", 2), ("sphere", 3)):
        found[name], path, F = blown_up(n, comm)
        numbers[name] = found[name][-1]
        exact = np.array([closed_form(n, a) for a in RADII])
        numbers[f"{name}, largest error"] = np.abs(found[name] / exact - 1).max()
        hoop = ufl.sqrt(forms.kinematics.invariants(F)[0])
        forms.picture(path, folder / f"{name}.png", hoop, "|F| [-]")
    if comm.rank == 0:
        axes = (figure := Figure((6, 4), 150, layout="constrained")).subplots()
        fine = np.linspace(1, RADII[-1], 101)[1:]
        for (name, n), color in zip((("tube", 2), ("sphere", 3)), ("C0", "C1"), strict=True):
            axes.plot(fine, [closed_form(n, a) for a in fine], color, label=f"{name}, closed form")
            axes.plot(RADII, found[name], color + "o", label=f"{name}, computed")
        axes.set(xlabel="inner radius now / at rest [-]", ylabel="pressure inside [MPa]")
        axes.legend()
        figure.savefig(folder / "inflation.png")
    return numbers
