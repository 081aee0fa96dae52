# SPDX-License-Identifier: MIT
"""Load paths of the fidelity benchmark: bodies x loads x energies x elements, one row each.

A row is a body, a load with its size, an energy with its modulus, and an element with its edge
length. mu = 1; the energies' second number is lmbda (kappa of "mooney_rivlin", none of "mixed").
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem

from variform import forms, meshes
from variform.forms import energies
from variform.forms.solving.settings import Settings

COMM = MPI.COMM_SELF
ROWS = [
    ("bar", "twist 360", "fixed_corotated 10", "P2 0.1"),
    ("bar", "twist 360", "fixed_corotated 1.5", "P2 0.1"),
    ("bar", "twist 90", "neo_hookean 10", "P2 0.1"),
    ("bar", "twist 180", "neo_hookean 10", "P2 0.1"),
    ("bar", "twist 360", "neo_hookean 1.5", "P2 0.1"),
    ("bar", "twist 360", "neo_hookean 100", "P2 0.1"),
    ("bar", "twist 180", "fixed_corotated 1.5", "P1 0.1"),
    ("bar", "twist 360", "fixed_corotated 10", "P1 0.1"),
    ("bar", "twist 360", "stable_neo_hookean 10", "P2 0.2"),
    ("bar", "twist 360", "fixed_corotated 100", "P2 0.2"),
    ("cube", "push 40", "neo_hookean 5", "P2 0.4"),
    ("cube", "push 40", "fixed_corotated 5", "P2 0.4"),
    ("cube", "pull 200", "neo_hookean 5", "P2 0.4"),
    ("cube", "pull 200", "fixed_corotated 10", "P2 0.4"),
    ("cube", "shear 100", "neo_hookean 1.5", "P2 0.4"),
    ("cube", "shear 100", "stable_neo_hookean 10", "P1 0.2"),
    ("slab", "push 30", "neo_hookean 10", "P2 0.2"),
    ("slab", "push 30", "fixed_corotated 10", "P2 0.2"),
    ("bar", "bend 180", "neo_hookean 1.5", "P2 0.1"),
    ("bar", "bend 270", "fixed_corotated 1.5", "P2 0.1"),
    ("bar", "arc 180", "neo_hookean 10", "P2 0.1"),
    ("bar", "arc 270", "neo_hookean 10", "P2 0.1"),
    ("bar", "arc 270", "fixed_corotated 100", "P2 0.2"),
    ("bar", "tip 30", "neo_hookean 1.5", "P2 0.1"),
    ("bar", "tip 100", "fixed_corotated 10", "P2 0.1"),
    ("bar", "tip 100", "stable_neo_hookean 1.5", "P1 0.1"),
    ("bar", "tip 100", "neo_hookean 100", "P2 0.2"),
    ("bar", "press 20", "neo_hookean 10", "P2 0.1"),
    ("bar", "twist 180", "mixed", "P2 0.2"),
    ("cube", "push 30", "mixed", "P2 0.4"),
    # The rows above are those of the prototype that the path follower came from.
    ("rod", "buckle 20", "neo_hookean 1.5", "P2 0.2"),
    ("rod", "buckle 20", "fixed_corotated 10", "Q2 0.2"),
    ("slab", "buckle 30", "neo_hookean 10", "P2 0.2"),
    ("rod", "column 12", "saint_venant_kirchhoff 1.5", "Q2 0.2"),
    ("bar", "wring 360", "neo_hookean 1.5", "Q2 0.1"),
    ("bar", "wring 720", "stable_neo_hookean 10", "Q1 0.05"),
    ("rod", "weigh 60", "saint_venant_kirchhoff 1.5", "P2 0.2"),
    ("rod", "weigh 200", "neo_hookean 10", "P3 0.2"),
    ("bar", "twist 180", "mooney_rivlin 10", "P2 0.1"),
    ("bar", "twist 90", "fibers 5", "P2 0.1"),
    ("bar", "tip 50", "fibers 5", "Q2 0.1"),
    ("cube", "shear 100", "saint_venant_kirchhoff 1.5", "Q1 0.2"),
    ("cube", "pull 100", "mooney_rivlin 20", "Q2 0.35"),
    ("cube", "shear 150", "hencky 5", "P2 0.4"),
    ("bar", "press 20", "fixed_corotated 1.5", "P3 0.2"),
    ("rod", "tip 20", "stable_neo_hookean 10", "Q1 0.1"),
    ("bar", "arc 360", "fixed_corotated 1.5", "P2 0.1"),
    ("bar", "wring 270", "mixed", "Q2 0.1"),
    ("bar", "press 15", "mixed", "P2 0.2"),
    ("strip", "tip 2", "neo_hookean 10", "P2 0.5"),
    ("strip", "arc 270", "fixed_corotated 10", "Q2 0.5"),
    ("strip", "buckle 100", "saint_venant_kirchhoff 1.5", "Q2 0.5"),
    ("strip", "press 2", "stable_neo_hookean 10", "P1 0.25"),
    ("tube", "blow 300", "neo_hookean 10", "Q2 0.25"),
    ("tube", "blow 300", "mixed", "P2 0.25"),
    ("tube", "pull 100", "fixed_corotated 10", "P2 0.25"),
    ("disk", "blow 1300", "sheet", "P2 0.1"),
    ("ball", "blow 1200", "sheet", "P2 0.25"),
    ("ball", "blow 1300", "sheet", "P2 0.25"),
    ("bar", "twist 180", "neo_hookean 1.5", "P2 0.1 multigrid"),
    ("bar", "twist 360", "fixed_corotated 10", "P1 0.05 multigrid"),
    ("bar", "tip 30", "neo_hookean 10", "P2 0.1 multigrid"),
    ("cube", "push 40", "neo_hookean 5", "P2 0.3 multigrid"),
    ("bar", "arc 180", "fixed_corotated 10", "Q1 0.05 multigrid"),
    ("bar", "twist 360", "neo_hookean 1.5", "P2 0.05"),
    ("cube", "shear 100", "fixed_corotated 10", "P1 0.08"),
    ("rod", "arc 180", "neo_hookean 10", "Q2 0.0667"),
]
NAMES = {", ".join(row): row for row in ROWS}
SIZES = {
    "bar": (1.0, 0.2, 0.2),
    "cube": (1.0, 1.0, 1.0),
    "slab": (1.0, 1.0, 0.2),
    "rod": (2.0, 0.2, 0.2),
    "strip": (10.0, 1.0),
    "tube": (1.0, 2.0),
}


def fibers(F, lmbda):
    """Fibers along the diagonal of x and y, a few times as stiff as the rest."""
    constants = {"alpha": -0.5, "beta": 0.5, "gamma": 2.0, "fiber": (np.sqrt(0.5), np.sqrt(0.5), 0)}
    return energies.transversely_isotropic_neo_hookean(F, 1.0, lmbda, **constants)


ENERGIES = {
    "mooney_rivlin": lambda F, kappa: (
        energies.mooney_rivlin(F, 0.3, 0.2) + energies.volumetric(F, kappa)
    ),
    "fibers": fibers,
    "hencky": lambda F, lmbda: energies.hencky(F, 1.0, lmbda),
}


@dataclass
class Scene:
    """One load path, and what it takes to start it anew.

    Attributes:
        name: Its row in words.
        problem: Potential, unknown, supports, virtual work.
        t: Load factor.
        to: Its last value.
        F: Deformation gradient; None of a membrane, whose volume ratio is none.
        begin: First load factor.
        start: Values of the unknown there.
        settings: Those of variform's solver.
        nodes: Numbers of the displacement's dofs at three nodes, shape (3, components).
        moved: Numbers of all dofs of the displacement.
        potential: That of the problem.
    """

    name: str
    problem: forms.Problem
    t: fem.Constant
    to: float
    F: Any = None
    begin: float = 0.0
    start: Any = 0.0
    settings: Settings = field(default_factory=Settings)
    nodes: Any = None
    moved: Any = None
    potential: Any = None

    @property
    def u(self):
        """Unknown."""
        return self.problem.u

    def reset(self):
        """Put the unknown and the load factor back to the start."""
        self.u.x.array[:] = self.start
        self.go(self.begin)

    def go(self, load):
        """Set the load factor and the supports."""
        self.t.value = load
        for support in self.problem.supports:
            support.update()


@dataclass
class _Making:
    """What a load adds to: supports, potential, virtual work."""

    body: Any
    size: tuple
    w: Any
    u: Any
    F: Any
    t: Any
    potential: Any
    ends: tuple = ("left", "right")
    axis: int = 0
    held: list = field(default_factory=list)
    work: Any = None

    def vector(self, value, axis):
        """A vector along an axis."""
        return ufl.as_vector([value if k == axis else 0 for k in range(len(self.size))])

    def clamp(self):
        """Hold the first end."""
        self.held += [forms.clamp(self.w, self.body.facets(self.ends[0]))]

    def turn(self, angle, axis, shift=None):
        """Turn the other end."""
        facets = self.body.facets(self.ends[1])
        self.held += [forms.rotate(self.w, facets, angle, axis, shift=shift)]

    def move(self, value, axis):
        """Move the other end along an axis."""
        by = [value if k == axis else 0 for k in range(len(self.size))]
        self.held += [forms.translate(self.w, self.body.facets(self.ends[1]), by)]


def twist(m, degrees):
    """One end turned about the axis."""
    m.turn(m.t, (1, 0, 0))
    return np.radians(degrees)


def wring(m, degrees):
    """The same, and pulled by a half for each turn."""
    m.turn(m.t, (1, 0, 0), (m.t / (4 * np.pi), 0, 0))
    return np.radians(degrees)


def bend(m, degrees):
    """One end turned across the axis, in its place."""
    m.turn(m.t, (0, 1, 0))
    return np.radians(degrees)


def arc(m, degrees):
    """One end turned and moved, as if the axis became a circle."""
    length, a = m.size[0], ufl.max_value(m.t, 1e-9)
    along, up = (ufl.sin(a) / a - 1) * length, (1 - ufl.cos(a)) / a * length
    if len(m.size) == 3:
        m.turn(m.t, (0, 1, 0), (along, 0, -up))
    else:
        m.turn(m.t, (0, 0, 1), (along, up))
    return np.radians(degrees)


def pull(m, percent):
    """One end moved away."""
    m.move(m.t, m.axis)
    return percent / 100


def push(m, percent):
    """One end moved towards the other."""
    m.move(-m.t, m.axis)
    return percent / 100


def shear(m, percent):
    """One end moved across."""
    m.move(m.t, 1)
    return percent / 100


def tip(m, size):
    """Dead traction across the end."""
    load = m.vector(size / 1e3 * m.t, len(m.size) - 1)
    m.potential += forms.dead_traction(m.u, load, m.body.ds("right"))
    return 1.0


def column(m, size):
    """Dead traction along the axis on the end of a body that is bent a little."""
    m.potential += forms.dead_traction(m.u, m.vector(-size / 1e3 * m.t, 0), m.body.ds("right"))
    return 1.0


def weigh(m, size):
    """Weight."""
    m.potential += forms.body_force(m.u, m.vector(-size / 1e3 * m.t, len(m.size) - 1))
    return 1.0


def press(m, size, side="bottom"):
    """Follower pressure on a side, a virtual work."""
    v = ufl.TestFunction(m.w.function_space)
    v = ufl.split(v)[0] if m.u is not m.w else v
    m.work = forms.follower_pressure(m.u, size / 1e3 * m.t, v, m.body.ds(side))
    return 1.0


LOADS = {f.__name__: f for f in (twist, wring, bend, arc, pull, push, shear, tip, column, weigh)}
LOADS |= {"press": press, "buckle": push}
# Bodies that a load bends from a shape without a bend: by a part of the length, and its shape.
BENT = {
    "buckle": (5e-3, lambda s: (1 - np.cos(2 * np.pi * s)) / 2),
    "column": (2e-3, lambda s: 1 - np.cos(np.pi * s / 2)),
}


def build(name):
    """The scene of a name."""
    shape, load, energy, element = NAMES[name]
    load, size = load.split()
    element, h, *preset = element.split()
    if shape in ("disk", "ball"):
        scene = _membrane(name, shape, float(size) / 1e3, int(element[1]), float(h))
    else:
        make = partial(_solid, name, shape, load, float(size))
        scene = make(energy.split(), element, float(h))
    if preset:
        scene.settings = Settings(direct_up_to=0)
    scene.moved, scene.nodes = _three(scene.u)
    return scene


def _solid(name, shape, load, amount, energy, element, h):
    size = SIZES[shape]
    solid, degree = len(size) == 3, int(element[1])
    kinds = {"P": ("triangle", "tetrahedron"), "Q": ("quadrilateral", "hexahedron")}
    origin = (1.0, 0.0) if shape == "tube" else None
    body = meshes.block(COMM, size, h=h, cells=kinds[element[0]][solid], origin=origin)
    if load in BENT:
        part, curve = BENT[load]
        x = body.mesh.geometry.x
        x[:, len(size) - 1] += part * size[0] * curve(x[:, 0] / size[0])
    kinematics: Callable = forms.axisymmetric if shape == "tube" else forms.deformation_gradient
    if energy[0] == "mixed":
        w = forms.displacement_pressure(body, degree)
        u, p = ufl.split(w)
        F = kinematics(u)
        psi = energies.with_pressure(energies.isochoric_neo_hookean(F, 1.0), F, p)
    else:
        w = u = forms.displacement(body, degree)
        F = kinematics(u)
        plain = getattr(energies, energy[0], None)
        law = ENERGIES.get(energy[0]) or (lambda F, lmbda: plain(F, mu=1.0, lmbda=lmbda))
        psi = law(F, float(energy[1]))
    weight = forms.circumference(u) if shape == "tube" else 1
    m = _Making(body, size, w, u, F, forms.load_factor(body), psi * weight * ufl.dx)
    if shape == "tube":
        m.ends, m.axis = ("bottom", "top"), 1
    m.clamp()
    if load == "blow":
        m.held += [forms.clamp(w, body.facets("top"))]
        to = press(m, amount, "left")
    else:
        to = LOADS[load](m, amount)
    problem = forms.Problem(m.potential, w, m.held, m.work)
    return Scene(name, problem, m.t, float(to), F, potential=m.potential)


def _membrane(name, shape, pressure, degree, h):
    """A disk that its rim holds taut by 5 %, or an octant of a sphere a little blown up."""
    if shape == "disk":
        body = meshes.disk(COMM, 1.0, h, degree, quarter=True)
    else:
        body = meshes.spherical_sheet(COMM, 1.0, h, degree, "octant")
    u, t = forms.displacement(body, degree), forms.load_factor(body)
    psi = energies.neo_hookean_sheet(forms.membrane_gradient(u), 1.0)
    potential = psi * ufl.dx - t * forms.enclosed_volume(u)
    planes = "xy" if shape == "disk" else "xyz"
    held = [forms.roller(u, body.facets(f"{a}0"), k) for k, a in enumerate(planes)]
    if shape == "disk":
        X = ufl.SpatialCoordinate(body.mesh)
        held += [forms.prescribe(u, body.facets("outer"), [0.05 * X[0], 0.05 * X[1], 0.0])]
    scene = Scene(name, forms.Problem(potential, u, held), t, pressure, potential=potential)
    u.interpolate(lambda x: 0.05 * x)
    scene.begin = 0.0 if shape == "disk" else 0.2
    scene.go(scene.begin)
    forms.solve(scene.problem)
    scene.start = u.x.array.copy()
    return scene


def _three(w):
    """All dofs of the displacement, and those at the nodes nearest to three points of its box."""
    V = w.function_space
    numbers = np.arange(V.dofmap.index_map.size_local * V.dofmap.bs)
    if V.num_sub_spaces == 2 and V.dofmap.bs == 1:  # with a pressure
        V, numbers = V.sub(0).collapse()
        numbers = np.asarray(numbers).ravel()
    x, size = V.tabulate_dof_coordinates(), V.dofmap.bs
    low, high = x.min(axis=0), x.max(axis=0)
    found = []
    for part in ((1.0, 0.5, 1.0), (0.5, 1.0, 0.5), (0.7, 0.0, 0.3)):
        away = np.linalg.norm(x - (low + np.array(part) * (high - low)), axis=1)
        # Of nodes as near as each other the first one in space, whatever their order.
        near = np.flatnonzero(away <= away.min() + 1e-9)
        node = near[np.lexsort(np.round(x[near], 9).T)[0]]
        found.append(numbers[node * size + np.arange(size)])
    return numbers, np.array(found)
