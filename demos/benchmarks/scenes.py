# SPDX-License-Identifier: MIT
"""Scenes of the work-precision charts: small ones whose answer is known, or can be computed.

Each is a function of an element ("P2", "Q2-Q1") and the number of cells n across its smallest
side, and gives a :class:`Problem`. mu = 1 throughout.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np
import ufl

from variform import forms, meshes
from variform.forms import energies

COMM = MPI.COMM_SELF


@dataclass
class Problem:
    """What is solved, in one step from rest, and the number that is looked at."""

    unknown: Any
    potential: Any
    supports: list
    value: Callable[[], float]
    exact: float | None = None


def guccione(F):
    """Heart muscle, fibers along x, with a soft volume term: an exponential of the strains."""
    fibers = {"bf": 18.48, "bt": 3.58, "bfs": 1.627, "fiber": (1, 0, 0)}
    return energies.guccione(F, C=0.5, **fibers) + energies.volumetric(F, 5.0, law="simo")


STRETCHES = energies.neo_hookean_stretches
SOLIDS = {
    "neo-Hookean": lambda F: energies.neo_hookean(F, 1.0, 1.5),
    "operator": lambda F: STRETCHES(F, 1.0, 1.5),
    "Guccione": guccione,
}
KAPPA = 5000.0  # nu = 0.4999


def unknowns(body, element, energy, kinematics=forms.deformation_gradient, kappa=None):
    """Unknown, displacement, energy density of an element; with a pressure if it has two names."""
    degree = int(element[1])
    if "-" in element:
        w = forms.displacement_pressure(body, degree)
        u, p = ufl.split(w)
        F = kinematics(u)
        return w, u, energies.with_pressure(energies.isochoric_neo_hookean(F, 1.0), F, p, kappa)
    u = forms.displacement(body, degree)
    F = kinematics(u)
    if energy == "nearly incompressible":
        return u, u, energies.isochoric_neo_hookean(F, 1.0) + energies.volumetric(F, KAPPA)
    return u, u, SOLIDS[energy](F)


def cells_of(element, dim=3):
    """Name of an element's cells."""
    names = ("quadrilateral", "hexahedron") if element[0] == "Q" else ("triangle", "tetrahedron")
    return names[dim - 2]


def component(w, point, axis):
    """Displacement of a point; curved cells may miss it by a little."""
    return float(forms.at(forms.displacement_of(w), point, 1e-3)[axis])


def way(w, radii):
    """Mean outward displacement of the points at the radii on the axes, on curved cells."""
    found, axes = forms.displacement_of(w), np.eye(w.function_space.mesh.geometry.dim)
    points = [(r, axis) for r in radii for axis in axes]
    return float(np.mean([forms.at(found, r * axis, 1e-3) @ axis for r, axis in points]))


def pad(element, n, energy="neo-Hookean", degree=None):
    """A cube between sliding walls, pressed from above by 0.2 (1 + cos pi x cos pi y), dead.

    Mirrored at its walls it is a layer without end or edge, so its solution is smooth. The number
    is the load's own displacement: its work over the load.
    """
    body = meshes.block(COMM, (1.0, 1.0, 1.0), n=n, cells=cells_of(element))
    w, u, psi = unknowns(body, element, energy, kappa=KAPPA)
    x, y, _ = ufl.SpatialCoordinate(body.mesh)
    # The same load for all elements: its own rule, finer than theirs.
    top = body.ds("top")(degree=10)
    load = 0.2 * (1 + ufl.cos(np.pi * x) * ufl.cos(np.pi * y)) * u[2] * top
    held = [forms.roller(w, body.facets("left", "right"), 0)]
    held += [forms.roller(w, body.facets("front", "back"), 1)]
    held += [forms.roller(w, body.facets("bottom"), 2)]
    dx = ufl.dx if degree is None else ufl.dx(degree=degree)
    return Problem(w, psi * dx + load, held, lambda: forms.integral(load) / 0.2)


def cantilever(element, n, width=None, power=1):
    """A plate 4 long and 1 thick, clamped, lifted at its other end by a dead 0.01 per area.

    In plane strain, or as a solid of a width, of which one half is meshed. The clamped edges are
    singular: with a power above 1 the cells get smaller towards them. The number is the rise of
    the end's middle.
    """
    size, numbers, up = (4.0, 1.0), (4 * n, n), (0, 0.01)
    if width:
        # Across the width only the free side needs cells as small as those along the plate.
        size, numbers, up = (4.0, width / 2, 1.0), (4 * n, 3 * n, n), (0, 0, 0.01)
    body = meshes.block(COMM, size, n=numbers, cells=cells_of(element, len(size)))
    x = body.mesh.geometry.x
    x[:, 0] = 4 * (x[:, 0] / 4) ** power
    across = 2 * x[:, len(size) - 1] - 1
    x[:, len(size) - 1] = (1 + np.sign(across) * (1 - (1 - abs(across)) ** power)) / 2
    if width:
        x[:, 1] = width / 2 * (1 - (1 - 2 * x[:, 1] / width) ** 2)
    w, u, psi = unknowns(body, element, "neo-Hookean")
    held = [forms.clamp(w, body.facets("left"))]
    held += [forms.roller(w, body.facets("front"), 1)] if width else []
    potential = psi * ufl.dx + forms.dead_traction(u, up, body.ds("right"))
    point = (4.0, 0.0, 0.5) if width else (4.0, 0.5)
    return Problem(w, potential, held, lambda: component(w, point, -1))


def bent(body, inner, outer):
    """Turn a block whose first two sides are 1 into a quarter of a ring: radius, then angle."""
    x = body.mesh.geometry.x
    r, angle = inner + (outer - inner) * x[:, 0], np.pi / 2 * x[:, 1]
    x[:, 0], x[:, 1] = r * np.cos(angle), r * np.sin(angle)
    return body


def lateral(body, u, F):
    """(x, y, 0) . cofactor(F) N, twice the rate of volume per area that a tube's wall encloses."""
    N, X = ufl.FacetNormal(body.mesh), ufl.SpatialCoordinate(body.mesh)
    N = ufl.as_vector([*N, 0][:3])
    return ufl.dot(ufl.as_vector([X[0] + u[0], X[1] + u[1], 0]), ufl.cofac(F) * N)


def tube(element, n, model):
    """An incompressible tube, radii 1 and 2, blown up to the inner radius 1.5 at a fixed length.

    sigma_rr' = mu (r^2/R^2 - R^2/r^2) / r with R^2 = r^2 - k, k = 1.5^2 - 1, from 1.5 to b.
    """
    k = 1.5**2 - 1
    b = np.sqrt(4 + k)
    p = np.log(2 / b) + np.log(1.5) + k / 2 * (1 / 1.5**2 - 1 / b**2)
    cells = cells_of(element, 3 if model == "solid" else 2)
    along = max(1, round(1.5 * n))
    if model == "axisymmetric":
        body = meshes.block(COMM, (1.0, 0.5), n=(n, 1), cells=cells, origin=(1.0, 0.0))
        w, u, psi = unknowns(body, element, "", forms.axisymmetric)
        r = ufl.SpatialCoordinate(body.mesh)[0] + u[0]
        inside = np.pi * r**2 * (1 + ufl.grad(u)[1, 1])
        held = [forms.roller(w, body.facets("bottom", "top"), 1)]
        potential = psi * forms.circumference(u) * ufl.dx - p * inside * body.ds("left")
        return Problem(w, potential, held, lambda: component(w, (1, 0.25), 0), 0.5)
    if model == "plane strain":
        body, ends = meshes.block(COMM, (1.0, 1.0), n=(n, along), cells=cells, order=2), []
        sides = "bottom", "top"
    else:
        numbers = (n, along, max(1, n // 2))
        body = meshes.block(COMM, (1.0, 1.0, 0.5), n=numbers, cells=cells, order=2)
        sides, ends = ("front", "back"), [("bottom", "top")]
    bent(body, 1, 2)
    w, u, psi = unknowns(body, element, "")
    held = [forms.roller(w, body.facets(side), 1 - i) for i, side in enumerate(sides)]
    held += [forms.roller(w, body.facets(*names), 2) for names in ends]
    # The pressure's potential about the axis: about the origin the top's rim would be loaded.
    potential = psi * ufl.dx + p / 2 * lateral(body, u, forms.deformation_gradient(u)) * body.ds(
        "left"
    )
    point = (1, 0, 0)[: body.mesh.geometry.dim]
    return Problem(w, potential, held, lambda: component(w, point, 0), 0.5)


def balloon(element, n, model):
    """An incompressible sphere of radius 1 and thickness 0.1, its inner radius stretched by 1.2.

    p = mu [2/l + 1/(2 l^4)] between the outer and the inner hoop stretch, by integrating
    (sigma_tt - sigma_rr) dl / (l (1 - l^3)) mu. The number is the way of the wall, the mean of its
    inner and outer radius, and over the poles on the axes; a membrane has one radius.
    """
    inner, outer = 0.95, 1.05
    now = 1.2 * inner
    stretch = (1 + (now**3 - inner**3) / outer**3) ** (1 / 3)
    p = 2 / stretch + 1 / (2 * stretch**4) - 2 / 1.2 - 1 / (2 * 1.2**4)
    exact = (now + stretch * outer) / 2 - 1
    if model == "axisymmetric":
        numbers = (max(1, n // 4), n)
        body = meshes.block(COMM, (1.0, 1.0), n=numbers, cells="quadrilateral", order=2)
        bent(body, inner, outer)
        w, u, psi = unknowns(body, element, "", forms.axisymmetric)
        F, r = forms.axisymmetric(u), forms.circumference(u)
        X, N = ufl.SpatialCoordinate(body.mesh), ufl.FacetNormal(body.mesh)
        place = ufl.as_vector([X[0] + u[0], X[1] + u[1], 0])
        flux = ufl.dot(place, ufl.cofac(F) * ufl.as_vector([N[0], N[1], 0])) / 3
        held = [
            forms.roller(w, body.facets(side), 1 - i) for i, side in enumerate(("bottom", "top"))
        ]
        potential = psi * r * ufl.dx + p * flux * r * body.ds("left")
        return Problem(w, potential, held, lambda: way(w, (inner, outer)), exact)
    if model == "membrane":
        radii, degree = (1.0,), int(element[1])
        body = meshes.spherical_sheet(COMM, 1.0, 1 / n, degree, "octant")
        w = forms.displacement(body, degree)
        psi = energies.neo_hookean_sheet(forms.membrane_gradient(w), 1.0)
        potential = 0.1 * psi * ufl.dx - p * forms.enclosed_volume(w)
    else:
        radii, body = (inner, outer), meshes.sphere_octant(COMM, inner, outer, 1 / n, 2)
        w, u, psi = unknowns(body, element, "")
        potential = psi * ufl.dx + forms.pressure_potential(u, p, body.ds("inner"))
    held = [forms.roller(w, body.facets(f"{axis}0"), "xyz".index(axis)) for axis in "xyz"]
    return Problem(w, potential, held, lambda: way(w, radii), exact)
