# SPDX-License-Identifier: MIT
"""Self-contact in motion: a bar twisted by four turns until it writhes, a cloth folded twice.

The bar, 1 x 0.1 x 0.1, ``neo_hookean`` mu = 1, lmbda = 10, density 1, quadratic tetrahedra of
h = 0.05: one end turns four times while it comes nearer, to 0.7 of the length, in 20 s, damped in
proportion to the mass, alpha = 2 / s. The cloth, 1 x 1, a neo-Hookean sheet of 1 N/m and
0.01 kg/m^2 in its weight, g = 1 m/s^2, lies above a floor: its right half goes over onto the left
one, then the back of both over onto the front: four layers. In each accepted state all pairs of
triangles are tested by a check of its own (:func:`crossings`), and J is bounded over whole cells.

Run ``docker/enter python3 -m demos.benchmarks.self_contact`` (``--small``: toy sizes); one JSON
line per scene, ``results/self_contact.csv`` and ``.png``; ``--write`` puts the table into
README.md. One process only; the bar takes minutes.
"""

import sys
import time

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx.mesh import locate_entities
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from scipy.spatial import cKDTree

from variform import forms, meshes
from variform.forms import dissipation

from .record import Table, insert, markdown, save

HOW = {"scheme": "bdf2", "refuse_inverted": True, "progress": False}

TURNS, NEARER = 4.0, 0.3


def crossings(x, triangles):
    """Pairs of triangles of which one's edge runs through the other, by signs of volumes.

    Nothing of ipctk: pairs are those whose middles are near, without those that share a corner.

    Args:
        x: Places of the points, shape (n, 3).
        triangles: Numbers of points, shape (m, 3).
    """
    corners = x[triangles]
    middles = corners.mean(axis=1)
    reach = np.linalg.norm(corners - middles[:, None], axis=2).max()
    pairs = cKDTree(middles).query_pairs(2 * reach, output_type="ndarray")
    a, b = triangles[pairs[:, 0]], triangles[pairs[:, 1]]
    pairs = pairs[~(a[:, :, None] == b[:, None, :]).any(axis=(1, 2))]
    low, high = corners.min(axis=1), corners.max(axis=1)
    i, j = pairs.T
    pairs = pairs[np.all((low[i] <= high[j]) & (low[j] <= high[i]), axis=1)]
    found = np.zeros(len(pairs), bool)
    for first, second in ((0, 1), (1, 0)):
        A, B = corners[pairs[:, first]], corners[pairs[:, second]]
        for k in range(3):
            found |= _pierces(A[:, k], A[:, (k + 1) % 3], *B.transpose(1, 0, 2))
    return int(found.sum())


def _pierces(p, q, a, b, c):
    """Whether the segments p q run through the triangles a b c."""

    def volume(a, b, c, d):
        return np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a)

    sides = volume(a, b, c, p) * volume(a, b, c, q) < 0
    turns = [volume(p, q, *edge) > 0 for edge in ((a, b), (b, c), (c, a))]
    return sides & (turns[0] == turns[1]) & (turns[1] == turns[2])


class Watch:
    """Checks each accepted state of a motion, and keeps what it is asked for.

    Args:
        term: The contact.
        show: Whether each step is printed.
    """

    def __init__(self, term, show=False):
        self.term, self.show, self.begin = term, show, time.process_time()
        self.crossed, self.least, self.touching, self.checking = 0, np.inf, 0, 0.0

    def __call__(self, path):
        """One more step."""
        start, step = time.process_time(), path.steps[-1]
        surface = self.term.surface
        self.crossed += crossings(surface.places(), surface.faces)
        self.touching += self.term.near()
        self.least = min(self.least, step.bounds.lower)
        self.checking += time.process_time() - start
        if self.show:
            seconds = time.process_time() - self.begin
            print(
                f"t {step.load:.4f} J {step.bounds.lower:.3f} crossed {self.crossed} "
                f"refused {path.refused} {step.convergence.iterations} iterations {seconds:.0f} s",
                file=sys.stderr,
                flush=True,
            )

    def row(self, scene, path):
        """What is written down of the motion."""
        seconds = time.process_time() - self.begin - self.checking
        return {
            "scene": scene,
            "dofs": path.problem.size,
            "triangles": len(self.term.surface.faces),
            "reached": f"{path.steps[-1].load:.4g}",
            "steps": len(path.steps),
            "touching": self.touching,
            "refused": path.refused,
            "iterations": sum(step.convergence.iterations for step in path.steps),
            "tangents": path.tangents,
            "crossed": self.crossed,
            "least J": float(f"{self.least:.3g}"),
            "seconds": round(seconds, 1),
        }


def smooth(x):
    """From 0 to 1, at rest at both ends."""
    return x * x * (3 - 2 * x)


def bar(h=0.05, turns=TURNS, nearer=NEARER, time=20.0, to=None, alpha=2.0, parts=None, show=False):
    """A bar twisted while its ends approach each other."""
    body = meshes.block(MPI.COMM_SELF, (1.0, 0.1, 0.1), h=h)
    t, u = forms.load_factor(body), forms.displacement(body, 2)
    # Points of degree 8: ln J holds the corners of cells in bends, too, which 4 points do not see.
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 10.0) * ufl.dx(degree=8)
    term = forms.touching(u, body.ds("front", "back", "top", "bottom"), stiffness=0.1, parts=parts)
    s = smooth(t / time)
    angle, shift = 2 * np.pi * turns * s, (-nearer * s, 0, 0)
    held = [
        forms.clamp(u, body.facets("left")),
        forms.rotate(u, body.facets("right"), angle, (1, 0, 0), shift=shift),
    ]
    watch = Watch(term, show)
    path = forms.transient(
        [psi, term],
        u,
        held,
        t,
        to=to or time,
        rho=1.0,
        tolerance=1e-3,
        dissipation=dissipation.mass_damping(alpha),
        on_step=watch,
        **HOW,
    )
    return watch, path


def folded(t, X, layer, turn, radius):
    """Displacement of a line along y at a height, whose back turns over onto its front.

    Args:
        t: Angle turned.
        X: Reference point.
        layer: Height of the front.
        turn: Where it begins to turn.
        radius: Of the turn, when the angle is pi.
    """
    length = np.pi * radius
    angle = t + 1e-9
    s = ufl.min_value(ufl.max_value(X[1] - turn, 0.0), length)
    rest = ufl.max_value(X[1] - turn - length, 0.0)
    front = ufl.min_value(X[1], turn)
    along = front + length / angle * ufl.sin(angle * s / length) + rest * ufl.cos(angle)
    up = 2 * length / angle * ufl.sin(angle * s / length / 2) ** 2 + rest * ufl.sin(angle)
    return along - X[1], layer + up


def cloth(n=24, time=12.0, alpha=4.0, show=False, to=None):
    """A cloth folded by three lines that carry it: its edges, and the middle between them."""
    gap = 0.144 / n  # so that cells are shorter than a fold is wide
    thickness = gap / 1.5
    s = np.linspace(0, 1, n + 1)
    x, y = np.meshgrid(s, s, indexing="ij")
    points = np.c_[x.ravel(), y.ravel(), 0 * y.ravel()]
    number = np.arange(len(points)).reshape(n + 1, n + 1)
    a, b, c, d = (
        part.ravel()
        for part in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:])
    )
    cells = np.concatenate([np.c_[a, b, c], np.c_[a, c, d]])
    body = meshes.from_arrays(MPI.COMM_SELF, points, cells, gdim=3)
    t, u = forms.load_factor(body), forms.displacement(body)
    X = ufl.SpatialCoordinate(body.mesh)
    psi = forms.energies.neo_hookean_sheet(forms.membrane_gradient(u), 1.0) * ufl.dx
    psi += 0.01 * u[2] * ufl.dx  # its weight
    floor = forms.obstacles.plane((0, 0, -2 * gap), (0, 0, 1))
    psi += forms.obstacle(u, floor, ufl.dx, dhat=gap, stiffness=0.1)
    term = forms.touching(
        u, ufl.dx, stiffness=0.1, dhat=gap - thickness, thickness=thickness, parts=1
    )
    over = np.pi * smooth(ufl.min_value(2 * t / time, 1.0))
    back = np.pi * smooth(ufl.max_value(2 * t / time - 1.0, 0.0))
    lifted = smooth(ufl.min_value(2 * t / time, 1.0))
    held = []
    for at, layer in ((0.0, 0), (0.5, 1), (1.0, 2)):
        line = locate_entities(body.mesh, 1, lambda x, at=at: np.isclose(x[0], at))
        along, up = folded(back, X, layer * gap * lifted, 0.5, (3 - layer) * gap)
        across = 0.0
        if layer == 2:  # a half circle about the middle, and up by two layers
            across, up = -0.5 * (1 - ufl.cos(over)), up + 0.5 * ufl.sin(over)
        held.append(forms.prescribe(u, line, [across, along, up]))
    watch = Watch(term, show)
    path = forms.transient(
        [psi, term],
        u,
        held,
        t,
        to=[time / 2, time] if to is None else to,
        rho=0.01,
        tolerance=2e-3,
        dissipation=dissipation.mass_damping(alpha),
        on_step=watch,
        **HOW,
    )
    return watch, path


def picture(ends):
    """The last state of each scene."""
    figure = Figure((10, 4), 130, layout="constrained")
    for k, (words, surface) in enumerate(ends.items()):
        axes = figure.add_subplot(1, len(ends), k + 1, projection="3d")
        x = surface.places()
        shown = Poly3DCollection(x[surface.faces], shade=True, facecolors=f"C{k}")
        axes.add_collection3d(shown)
        low, high = x.min(axis=0), x.max(axis=0)
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
        axes.set_box_aspect(np.maximum(high - low, 0.05))
        axes.set_title(words)
        axes.view_init(25, -60)
        axes.set_axis_off()
    save(figure, "self_contact")


def table(rows):
    """One line a scene."""
    names = list(rows[0])
    head = [{"seconds": "CPU time [s]", "least J": "J above"}.get(name, name) for name in names]
    return markdown(head, [[row[name] for name in names] for row in rows])


def main(small=False, write=False, show=False):
    """Run both scenes, print and write the table and the picture."""
    measurements, ends = Table("self_contact"), {}
    scenes = {
        "twisted bar": lambda: bar(show=show),
        "cloth folded twice": lambda: cloth(show=show),
    }
    if small:
        scenes = {"twisted bar": lambda: bar(0.1, 0.1, 0.05, 2.0, parts=1)}
        scenes["cloth folded twice"] = lambda: cloth(n=4, time=2.0, to=0.2)
    for name, scene in scenes.items():
        watch, path = scene()
        measurements.add(**watch.row(name, path))
        ends[name] = watch.term.surface
    picture(ends)
    measurements.write()
    if write:
        insert("self_contact", table(measurements.rows))
    return measurements.rows


if __name__ == "__main__":
    main(*(flag in sys.argv for flag in ("--small", "--write", "--show")))
