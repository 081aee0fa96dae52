# SPDX-License-Identifier: MIT
"""The hard cases: bodies, loads, variform's calls, and where their connected paths end."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem
from scipy.optimize import brentq
from scipy.special import ellipk

from variform import forms, meshes
from variform.forms import energies

COMM = MPI.COMM_SELF
MU, LMBDA = 1.0, 1.5
SHORT = 1 / 200  # steps of the paths that the ends were found by


class End(NamedTuple):
    """Where a connected path ends.

    Found by ``docker/enter python3 -m demos.benchmarks.hard_cases --ends``: 200 or more small
    steps of plain Newton, none of them refused, all work accounted for.

    Attributes:
        energy: Total potential [J] at the last load.
        negative: Negative eigenvalues there; None where the tangent is not symmetric.
        events: What the path passes: kind, load factor and its tolerance.
    """

    energy: float
    negative: int | None = 0
    events: tuple[tuple[str, float, float], ...] = ()


@dataclass
class Case:
    """A problem, variform's call, and what is known of the solution.

    Attributes:
        u: Unknown.
        supports: Prescribed displacements, which may depend on t.
        t: Load factor.
        potential: Total potential.
        call: Variform's one call; returns its path.
        known: What is checked besides forces, supports, J and end: name, value found, value
            expected and its tolerance. It is given the path, or None for DOLFINx.
        virtual_work: Load without a potential.
        to: Last load factor of DOLFINx's steps; None: where variform's path ended.
        steps: Number of these steps.
        starts: Displacements to start from, one solve each.
        force: Scale of forces [N] where the solution has none.
        positive: Whether the energy needs J > 0.
        end: Where the path ends; None for starts that lead back to rest.
        small: The path in small steps, by which ``end`` was found.
    """

    u: fem.Function
    supports: list
    t: fem.Constant
    potential: ufl.Form
    call: Callable[[], forms.Path]
    known: Callable[[forms.Path | None], list] = lambda path: []
    virtual_work: ufl.Form | None = None
    to: float | None = 1.0
    steps: int = 10
    starts: list = field(default_factory=lambda: [None])
    force: float = 0.0
    positive: bool = True
    end: End | None = None
    small: Callable[[], forms.Path] | None = None

    def begin(self, start):
        """Put the unknown and the load factor back to the start."""
        self.u.x.array[:] = 0 if start is None else start
        self.t.value = 0
        for support in self.supports:
            support.update()


def block(size, n=None, h=None, degree=2, cells="hexahedron"):
    """Body, displacement, deformation gradient, load factor."""
    body = meshes.block(COMM, size, h=h, n=n, cells=cells)
    u = forms.displacement(body, degree)
    return body, u, forms.deformation_gradient(u), forms.load_factor(body)


def follow(case, **options):
    """Load path to t = 1."""
    return forms.follow(
        case.potential,
        case.u,
        case.supports,
        case.t,
        virtual_work=case.virtual_work,
        progress=False,
        **options,
    )


def solve(case):
    """The whole load, t = 1, in one step."""
    case.t.value = 1
    return forms.solve(case.potential, case.u, case.supports, virtual_work=case.virtual_work)


def made(u, supports, t, potential, call=follow, **more):
    """A case whose call is one of the functions above."""
    case = Case(u, supports, t, potential, lambda: call(case), **more)
    case.small = lambda: follow(case, step=SHORT, max_step=SHORT)
    return case


def opposite(case, body, one, other, moment=False):
    """Resultants of two supports: they are to be equal and opposite."""
    system = forms.Problem(case.potential, case.u, case.supports)
    a, b = (np.array(forms.resultant(system, body.facets(face))) for face in (one, other))
    what = "moments" if moment else "forces"
    largest = np.abs(a[int(moment)]).max()
    return [(f"sum of the {what}", np.abs(a + b)[int(moment)].max() / largest, 0, 1e-5)]


def twist():
    """1: a clamped block twisted by 720 degrees."""
    body, u, F, t = block((1.0, 0.2, 0.2), n=(10, 2, 2))
    held = [forms.clamp(u, body.facets("left"))]
    held += [forms.rotate(u, body.facets("right"), 4 * np.pi * t, (1, 0, 0))]
    case = made(u, held, t, energies.neo_hookean(F, MU, LMBDA) * ufl.dx)
    case.end = End(0.017526557, 2, (("bifurcation", 0.71276, 1e-3),))
    case.known = lambda path: opposite(case, body, "left", "right", moment=True)
    return case


def moved(by, faces, degree):
    """Unit cube, one face clamped, the other moved along x; degree of the quadrature."""
    body, u, F, t = block((1.0, 1.0, 1.0), n=4)
    held = [forms.clamp(u, body.facets(faces[0]))]
    held += [forms.translate(u, body.facets(faces[1]), (by * t, 0, 0))]
    case = made(u, held, t, energies.neo_hookean(F, MU, LMBDA) * ufl.dx(degree=degree))
    case.known = lambda path: opposite(case, body, *faces)
    return case


def stretch():
    """2: a block stretched to ten times its length."""
    case = moved(9.0, ("left", "right"), 4)
    case.end = End(48.942981)
    return case


def shear():
    """15: a block sheared by 2."""
    case = moved(2.0, ("bottom", "top"), 6)
    case.end = End(1.6748126)
    return case


def confined():
    """3: a confined block pressed to 5 % of its height."""
    body, u, F, t = block((1.0, 1.0, 1.0), h=0.4, cells="tetrahedron")
    walls = {"left": 0, "right": 0, "front": 1, "back": 1, "bottom": 2}
    held = [forms.roller(u, body.facets(name), axis) for name, axis in walls.items()]
    held += [forms.translate(u, body.facets("top"), (None, None, -0.95 * t))]
    case = made(u, held, t, energies.neo_hookean(F, MU, LMBDA) * ufl.dx)
    case.end = End(9.2277912)
    exact = MU * (0.05 - 1 / 0.05) + LMBDA * np.log(0.05) / 0.05

    def known(path):
        system = forms.Problem(case.potential, u, held)
        force = forms.resultant(system, body.facets("top"))[0][2]
        return [("force", force, exact, 1e-6 * abs(exact))]

    case.known = known
    return case


def symmetric(u, body):
    """Rollers on the planes x = 0, y = 0, z = 0 of a block."""
    return [forms.roller(u, body.facets(f), k) for k, f in enumerate(("left", "front", "bottom"))]


def corner(u):
    """Displacement of the corner (1, 1, 1)."""
    return forms.at(u, (1, 1, 1))


def pressure():
    """4: a cube under a follower pressure of 5 mu."""
    body, u, F, t = block((1.0, 1.0, 1.0), n=3)
    v = ufl.TestFunction(u.function_space)
    work = sum(
        forms.follower_pressure(u, 5 * MU * t, v, body.ds(face))
        for face in ("right", "back", "top")
    )
    psi = energies.neo_hookean(F, MU, LMBDA)
    case = made(u, symmetric(u, body), t, psi * ufl.dx, virtual_work=work)
    case.end = End(0.94303124, None)
    exact = brentq(lambda s: MU * (1 - s * s) - 3 * LMBDA * np.log(s) - 5 * MU * s**3, 0.1, 1)
    case.known = lambda path: [
        (f"stretch {k + 1}", 1 + corner(u)[k], exact, 1e-6) for k in range(3)
    ]
    return case


def ruined(kinds):
    """Unit cube held all around, its inner nodes thrown about."""
    n = 6
    body, u, F, t = block((1.0, 1.0, 1.0), n=n, degree=1, cells="tetrahedron")
    held = [forms.clamp(u, body.facets(name)) for name in body.boundaries]
    x = u.function_space.tabulate_dof_coordinates()
    inside = np.all((x > 1e-9) & (x < 1 - 1e-9), axis=1)
    throw = np.random.default_rng(0).uniform(-2, 2, (n + 1, n + 1, n + 1, 3)) / n
    grid = np.round(x * n).astype(int)
    to = {
        "scrambled": throw[grid[:, 0], grid[:, 1], grid[:, 2]],
        "flat": x * (0, 0, -1) + (0, 0, 0.5),
        "mirrored": x * (0, 0, -2) + (0, 0, 1),
    }
    potential = energies.stable_neo_hookean(F, 1.0, 10.0) * ufl.dx
    case = made(u, held, t, potential, solve, steps=1, positive=False, force=1.0)
    case.starts = [np.where(inside[:, None], to[kind], 0).ravel() for kind in kinds]
    case.known = lambda path: [("|u|", np.abs(u.x.array).max(), 0, 1e-6)]
    return case


def scrambled():
    """5: a box whose inner nodes are thrown about."""
    return ruined(["scrambled"])


def flat_and_mirrored():
    """6: the same box with its inside in a plane, and upside down."""
    return ruined(["flat", "mirrored"])


def column():
    """7: a slender column with a slight bend under 1.5 times Euler's load."""
    length, n = 50.0, 50
    body, u, F, t = block((length, 1.0), n=(n, 2), cells="quadrilateral")
    x = body.mesh.geometry.x
    x[:, 1] += length / 1000 * (1 - np.cos(np.pi * x[:, 0] / (2 * length)))
    critical = np.pi**2 / 12 / (4 * length**2)  # E = 1, I = 1/12
    psi = energies.saint_venant_kirchhoff(F, 0.5, 0.0)
    load = forms.dead_traction(u, ufl.as_vector([-1.5 * critical * t, 0]), body.ds("right"))
    case = made(u, [forms.clamp(u, body.facets("left"))], t, psi * ufl.dx + load)
    case.end = End(-7.6191466e-4)
    k = brentq(lambda k: (2 * ellipk(k * k) / np.pi) ** 2 - 1.5, 0.01, 0.99)
    exact = 2 * k / ellipk(k * k)
    tip = (length, 0.5 + length / 1000)  # on the axis; the imperfection points to +y
    case.known = lambda path: [("sideways/L", forms.at(u, tip)[1] / length, exact, 0.01)]
    return case


def taylor_hood(body, mu, kappa=None):
    """Mixed unknown, displacement, gradient, potential of an isochoric neo-Hookean body."""
    w = forms.displacement_pressure(body)
    u, p = ufl.split(w)
    F = forms.deformation_gradient(u)
    psi = energies.with_pressure(energies.isochoric_neo_hookean(F, mu), F, p, kappa)
    return w, u, F, psi


def bulk(mu, nu):
    """Bulk modulus."""
    return 2 * mu * (1 + nu) / (3 * (1 - 2 * nu))


def pressed():
    """8: a nearly incompressible block between bonded plates, pressed by a quarter."""
    body = meshes.block(COMM, (1.0, 1.0, 1.0), n=4, cells="hexahedron")
    t = forms.load_factor(body)
    w, _, F, psi = taylor_hood(body, MU, bulk(MU, 0.4999))
    held = [forms.clamp(w, body.facets("bottom"))]
    held += [forms.translate(w, body.facets("top"), (0, 0, -0.25 * t))]
    case = made(w, held, t, psi * ufl.dx(degree=10))
    case.end = End(0.14070484)
    case.known = lambda path: [("volume", forms.volume(F, body.dx()), 1, 2e-3)]
    return case


def cook():
    """9: Cook's panel, nearly incompressible, under five times the usual load."""
    body = meshes.cook(COMM, n=16)
    t = forms.load_factor(body)
    w, u, _, psi = taylor_hood(body, 80.194, bulk(80.194, 0.49999))
    load = forms.dead_traction(u, ufl.as_vector([0, 500 / 16 * t]), body.ds("right"))
    held = [forms.clamp(w, body.facets("left"))]
    case = made(w, held, t, psi * ufl.dx + load)
    case.end = End(-6842.4512)

    def known(path):
        force = forms.resultant(forms.Problem(case.potential, w, held), body.facets("left"))[0]
        rise = forms.at(forms.displacement_of(w), (48, 60))[1]
        return [("reaction", force[1], -500, 1e-3), ("rise", rise, None, None)]

    case.known = known
    return case


def disk():
    """10: a flat clamped membrane blown up from rest."""
    body = meshes.disk(COMM, 1.0, 0.1, 2, quarter=True)
    u, t = forms.displacement(body, 2), forms.load_factor(body)
    F = forms.membrane_gradient(u)
    potential = energies.neo_hookean_sheet(F, MU) * ufl.dx - 1.3 * t * forms.enclosed_volume(u)
    held = [forms.roller(u, body.facets("x0"), 0), forms.roller(u, body.facets("y0"), 1)]
    held += [forms.clamp(u, body.facets("outer"))]
    case = made(u, held, t, potential, solve, positive=False)
    case.end = End(-0.23509871)
    case.known = lambda path: [("apex", forms.at(u, (0, 0, 0))[2], 0.63306, 0.005 * 0.63306)]
    return case


def airbag():
    """11: a flat cushion of cloth blown up from rest."""
    body = meshes.square(COMM, 0.844, 0.05, quarter=True)
    u, t = forms.displacement(body, 1), forms.load_factor(body)
    F = forms.membrane_gradient(u)
    psi = 0.6e-3 * energies.saint_venant_kirchhoff_tension_field(F, 588e6, 0.4)
    held = [forms.roller(u, body.facets("x0"), 0), forms.roller(u, body.facets("y0"), 1)]
    held += [forms.roller(u, body.facets(seam), 2) for seam in ("right", "top")]
    potential = psi * ufl.dx - 5e3 * t * forms.enclosed_volume(u)
    case = made(u, held, t, potential, solve, positive=False)
    case.known = lambda path: [("rise", forms.at(u, (0, 0, 0))[2], 0.217, 0.03 * 0.217)]
    return case


def blown(case, volume, targets):
    """Equilibrium at given volumes, the pressure found."""
    case.t.value = 0.1
    return forms.control(
        case.potential, case.u, case.supports, case.t, volume, targets, progress=False
    )


def balloon():
    """12: a spherical membrane past its limit point."""
    body = meshes.spherical_sheet(COMM, 1.0, 0.3, 2, "octant")
    u, p = forms.displacement(body, 2), forms.load_factor(body)
    F, volume = forms.membrane_gradient(u), forms.enclosed_volume(u)
    potential = energies.neo_hookean_sheet(F, MU) * ufl.dx - p * volume
    held = [forms.roller(u, body.facets(f"{a}0"), k) for k, a in enumerate("xyz")]
    stretches = np.linspace(1.05, 2, 20)
    rest = np.pi / 6  # of an octant
    case = Case(u, held, p, potential, lambda: blown(case, volume, rest * stretches**3))
    case.end = End(-0.14716756, 1, (("limit point", 1.23946, 1e-3),))
    finely = np.linspace(stretches[0], stretches[-1], 200)
    case.small = lambda: blown(case, volume, rest * finely**3)
    case.to, case.positive = None, False

    def known(path):
        end = 1 + forms.at(u, (0, 0, 1), 1e-3)[2]
        found = [("stretch", end, 2, 2e-3)]
        if path is not None:
            exact = 2 * (1 / stretches - stretches**-7.0)
            off = np.abs(np.array([step.load for step in path.steps]) / exact - 1).max()
            found += [("error of the pressures", off, 0, 1e-3)]
        return found

    case.known = known
    return case


def thick_sphere():
    """13: an incompressible thick sphere past its limit point."""
    body = meshes.block(COMM, (1.0, 1.0), n=(6, 8), cells="quadrilateral", order=2)
    x = body.mesh.geometry.x
    radius, angle = 0.5 + 0.5 * x[:, 0], np.pi / 2 * x[:, 1]
    x[:, 0], x[:, 1] = radius * np.cos(angle), radius * np.sin(angle)
    w, p = forms.displacement_pressure(body), forms.load_factor(body)
    u, q = ufl.split(w)
    F = forms.axisymmetric(u)
    psi = energies.with_pressure(energies.isochoric_neo_hookean(F, MU), F, q)
    r = forms.circumference(u)
    N = ufl.FacetNormal(body.mesh)
    X = ufl.SpatialCoordinate(body.mesh)
    place = ufl.as_vector([X[0] + u[0], X[1] + u[1], 0])
    area = ufl.cofac(F) * ufl.as_vector([N[0], N[1], 0])
    volume = -ufl.inner(place, area) / 3 * r * body.ds("left")
    stretches = np.linspace(1.1, 3, 39)
    rest = 2 / 3 * np.pi / 8
    held = [forms.roller(w, body.facets("bottom"), 1), forms.roller(w, body.facets("top"), 0)]
    potential = psi * r * ufl.dx - p * volume
    case = Case(w, held, p, potential, lambda: blown(case, volume, rest * stretches**3))
    case.end = End(0.37451162, 1, (("limit point", 0.8164236, 1e-4),))
    finely = np.linspace(stretches[0], stretches[-1], 200)
    case.small = lambda: blown(case, volume, rest * finely**3)
    case.to = None

    def known(path):
        inner = 1 + forms.at(forms.displacement_of(w), (0.5, 0))[0] / 0.5
        return [("inner stretch", inner, 3, 0.01)]

    case.known = known
    return case


def arch():
    """14: a shallow arch snaps through."""
    span, rise, n = 100.0, 5.0, 80
    body = meshes.block(COMM, (span, 1.0), n=(n, 1), cells="quadrilateral")
    x = body.mesh.geometry.x
    stiff = fem.Function(fem.functionspace(body.mesh, ("DG", 0)))
    edge = span / 2 - span / n
    stiff.interpolate(lambda x: np.where(np.abs(x[0] - span / 2) > edge, 1e3, 1.0))
    x[:, 1] += rise * np.sin(np.pi * x[:, 0] / span) - 0.5
    u, q = forms.displacement(body, 2), forms.load_factor(body)
    F = forms.deformation_gradient(u)
    psi = stiff * energies.saint_venant_kirchhoff(F, 0.5, 0.0)
    X = ufl.SpatialCoordinate(body.mesh)
    sine = ufl.sin(np.pi * X[0] / span)
    potential = psi * ufl.dx + forms.body_force(u, ufl.as_vector([0 * q, -q * sine]))
    held = [forms.pin(u, (0, 0)), forms.pin(u, (span, 0))]

    # One sine wave a sin(pi x / L) of a shallow arch: EI (H - a) + EA/4 (H^2 - a^2) a = q (L/pi)^4
    def load(a):
        return (np.pi / span) ** 4 * ((rise - a) / 12 + (rise**2 - a**2) * a / 4)

    limit = load(np.sqrt((rise**2 - 1 / 3) / 3))
    end = 1.2 * limit
    crown = brentq(lambda a: load(a) - end, -3 * rise, -rise) - rise
    case = Case(u, held, q, potential, lambda: None, to=end, positive=False)
    case.end = End(
        -0.0072443294,
        0,
        (
            ("bifurcation", 0.1280 * limit, 1e-3 * limit),
            ("limit point", 0.27685 * limit, 1e-3 * limit),
            ("limit point", -0.19403 * limit, 1e-3 * limit),
            ("bifurcation", -0.06267 * limit, 1e-3 * limit),
        ),
    )

    def call(largest=0.05):
        return forms.arc_length(
            potential, u, held, q, step=limit / 10, to=end, largest=largest, progress=False
        )

    case.small = lambda: call(0.002)
    case.known = lambda path: [("crown", forms.at(u, (span / 2, rise))[1], crown, 0.03 * -crown)]
    case.call = call
    return case


def tension():
    """16: St Venant-Kirchhoff stretched to 3 by a dead load."""
    body, u, F, t = block((1.0, 1.0, 1.0), n=3)
    E, nu = 1.0, 0.1
    psi = energies.saint_venant_kirchhoff(F, *energies.lame_from_young(E, nu))
    load = forms.dead_traction(u, ufl.as_vector([12 * E * t, 0, 0]), body.ds("right"))
    case = made(u, symmetric(u, body), t, psi * ufl.dx + load)
    case.end = End(-16.0)
    exact = 3, np.sqrt(1 - 8 * nu), np.sqrt(1 - 8 * nu)
    case.known = lambda path: [
        (f"stretch {k + 1}", 1 + corner(u)[k], exact[k], 1e-6) for k in range(3)
    ]
    return case


def bar():
    """17: the bar of heart muscle, its pressure in one step."""
    body = meshes.block(COMM, (10.0, 1.0, 1.0), n=(20, 2, 2), cells="hexahedron")
    w, t = forms.displacement_pressure(body), forms.load_factor(body)
    u, p = ufl.split(w)
    F = forms.deformation_gradient(u)
    fiber = ufl.as_vector((1.0, 0.0, 0.0))
    psi = energies.with_pressure(energies.guccione(F, 2.0, 8.0, 2.0, 4.0, fiber), F, p)
    v, _ = ufl.split(ufl.TestFunction(w.function_space))
    work = forms.follower_pressure(u, 0.004 * t, v, body.ds("bottom"))
    held = [forms.clamp(w, body.facets("left"))]
    case = made(w, held, t, psi * ufl.dx, solve, virtual_work=work, steps=1)
    case.end = End(0.026363458, None)
    X = np.array((10, 0.5, 1))

    def known(path):
        place = X + forms.at(forms.displacement_of(w), X)
        return [("x", place[0], 9.18, 0.01), ("z", place[2], 4.17, 0.01)]

    case.known = known
    return case


def turn():
    """18: a beam turned by 180 degrees at one end, the other free."""
    body, u, F, t = block((10.0, 1.0, 1.0), n=(20, 2, 2))
    held = [forms.rotate(u, body.facets("left"), np.pi * t, (0, 0, 1))]
    psi = energies.neo_hookean(F, MU, LMBDA)
    case = made(u, held, t, psi * ufl.dx, force=1.0)
    case.end = End(0.0)
    x = u.function_space.tabulate_dof_coordinates()
    rigid = np.stack([-2 * x[:, 0], 1 - 2 * x[:, 1], 0 * x[:, 2]], axis=1)

    def known(path):
        return [("error of u", np.abs(u.x.array.reshape(-1, 3) - rigid).max(), 0, 1e-5)]

    case.known = known
    return case


def contrast():
    """19: a block with a much stiffer cube inside, pressed by 30 %."""
    body, u, F, t = block((1.0, 1.0, 1.0), n=4)
    stiff = fem.Function(fem.functionspace(body.mesh, ("DG", 0)))
    stiff.interpolate(lambda x: np.where(np.all(np.abs(x - 0.5) < 0.25, axis=0), 1e6, 1.0))
    held = [forms.clamp(u, body.facets("bottom"))]
    held += [forms.translate(u, body.facets("top"), (0, 0, -0.3 * t))]
    case = made(u, held, t, stiff * energies.neo_hookean(F, MU, LMBDA) * ufl.dx)
    case.end = End(0.27388878)
    # The forces of a shorter first step are lost in the rounding of the stiff cube's.
    case.small = lambda: follow(case, step=0.02, max_step=0.02)

    def known(path):
        E = forms.kinematics.green_strain(F)
        weight = ufl.conditional(ufl.gt(stiff, 1e3), 1.0, 0.0)
        strain = np.sqrt(forms.integral(weight * ufl.inner(E, E) * ufl.dx) / 0.125)
        return [("strain of the cube", strain, 0, 1e-5), *opposite(case, body, "bottom", "top")]

    case.known = known
    return case


def hanging():
    """20: a dead force that in one step turns elements inside out."""
    body, u, F, t = block((4.0, 1.0, 1.0), n=(8, 2, 2))
    load = forms.dead_traction(u, ufl.as_vector([0, 0, -0.1 * t]), body.ds("right"))
    held = [forms.clamp(u, body.facets("left"))]
    psi = energies.neo_hookean(F, MU, LMBDA)
    case = made(u, held, t, psi * ufl.dx + load, solve, steps=1)
    case.end = End(-0.24461453)

    def known(path):
        force = forms.resultant(forms.Problem(case.potential, u, held), body.facets("left"))[0]
        return [("reaction", force[2], 0.1, 1e-6)]

    case.known = known
    return case


CASES = {
    "twist": twist,
    "stretch": stretch,
    "confined": confined,
    "pressure": pressure,
    "scrambled": scrambled,
    "flat, mirrored": flat_and_mirrored,
    "column": column,
    "pressed block": pressed,
    "Cook": cook,
    "disk": disk,
    "airbag": airbag,
    "balloon": balloon,
    "thick sphere": thick_sphere,
    "arch": arch,
    "shear": shear,
    "tension": tension,
    "bar": bar,
    "turn": turn,
    "contrast": contrast,
    "hanging": hanging,
}
