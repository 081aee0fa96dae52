# SPDX-License-Identifier: MIT
"""Hertz's contact: a parabola of a cylinder or sphere on a plane, in the plane and in space."""

import time
from pathlib import Path
from tempfile import TemporaryDirectory

from mpi4py import MPI

import numpy as np
import ufl

from variform import forms, meshes
from variform.forms import contact, obstacles

A, R, E, NU = 0.05, 1.0, 1.0, 0.3
STIFF = E / (1 - NU**2)
# A quarter of a cylinder; sizes grow with the distance from the disk that will be in contact.
SOLID = """SetFactory("OpenCASCADE");
Cylinder(1) = {{0, 0, 0, 0, 0, {long}, {long}, Pi/2}};
a = -1e-6; b = {long} + 1e-6;
Physical Volume("body") = {{1}};
Physical Surface("bottom") = Surface In BoundingBox{{a, a, a, b, b, -a}};
Physical Surface("top") = Surface In BoundingBox{{a, a, {long} + a, b, b, b}};
Physical Surface("left") = Surface In BoundingBox{{a, a, a, -a, b, b}};
Physical Surface("front") = Surface In BoundingBox{{a, a, a, b, -a, b}};
Mesh.MeshSizeExtendFromBoundary = 0;
Mesh.MeshSizeFromPoints = 0;
Field[1] = MathEval;
Field[1].F = "{h} + {grow} * sqrt(z^2 + ((sqrt(x^2 + y^2) - {fine}
    + sqrt((sqrt(x^2 + y^2) - {fine})^2)) / 2)^2)";
Background Field = 1;
"""


def graded(h, fine, length, ratio=1.15):
    """Coordinates of nodes: h apart up to a length, then farther and farther."""
    x, d = list(np.arange(0, fine + h / 2, h)), h
    even = len(x)
    while x[-1] < length:
        d *= ratio
        x.append(x[-1] + d)
    x = np.array(x)
    x[even:] = fine + (x[even:] - fine) * (length - fine) / (x[-1] - fine)
    return x


def parabola(kind, degree, per, reach, stiffness=None, comm=MPI.COMM_SELF, **options):
    """Path of a parabola of a "cylinder" or "sphere" that is pressed on a plane, and its body."""
    h = A / per
    x, y = graded(h, 2 * A, 20 * A), graded(h, A, 20 * A)
    n = len(x) - 1, len(y) - 1
    size = (float(n[0]), float(n[1]))
    body = meshes.block(comm, size, n=n, cells="quadrilateral", order=degree)
    X = body.mesh.geometry.x
    X[:, 0] = np.interp(X[:, 0], np.arange(len(x)), x)
    depth = np.interp(X[:, 1], np.arange(len(y)), y)
    X[:, 1] = depth + X[:, 0] ** 2 / (2 * R) * (1 - depth / y[-1])
    u, t = forms.displacement(body, degree), forms.load_factor(body)
    ball = kind == "sphere"
    F = forms.axisymmetric(u) if ball else forms.deformation_gradient(u)
    e = ufl.sym(F) - ufl.Identity(3)
    psi = E / (2 * (1 + NU)) * (ufl.inner(e, e) + NU / (1 - 2 * NU) * ufl.tr(e) ** 2)
    psi = psi * forms.circumference(u) if ball else psi
    floor, dhat = obstacles.plane((0, 0), (0, 1)), reach * h
    wall = forms.obstacle(u, floor, body.ds("bottom"), dhat=dhat, gap=dhat, stiffness=stiffness)
    down = forms.translate(u, body.facets("top"), (None, -(0.0027 if ball else 0.0045) * t))
    held = [forms.roller(u, body.facets("left"), 0), down]
    return forms.follow(psi * ufl.dx + wall, u, held, t, progress=False, **options), body


def known(kind, force):
    """Hertz's half-width and largest pressure at a force on what is meshed: half a cylinder."""
    if kind == "sphere":
        a = (3 * force * R / (4 * STIFF)) ** (1 / 3)
        return a, 3 * force / (2 * np.pi * a**2)
    a = np.sqrt(8 * force * R / (np.pi * STIFF))
    return a, 4 * force / (np.pi * a)


def width(kind, p, body):
    """Half-width by the second moment of a pressure p on the bottom. Collective."""
    r, ds = ufl.SpatialCoordinate(body.mesh)[0], body.ds("bottom", degree=6)
    weight, moment = (r, 2 / 5) if kind == "sphere" else (1.0, 1 / 4)
    second = forms.integral(p * weight * r**2 * ds) / forms.integral(p * weight * ds)
    return np.sqrt(second / moment)


def solid(h, grow=0.2, long=20 * A):
    """A quarter of a body of revolution, a paraboloid below: curved tetrahedra, graded."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / "solid.geo"
        text = SOLID.format(h=h, grow=grow, fine=1.15 * A, long=long)
        file.write_text(text.replace("\n    +", " +"))
        body = meshes.read(MPI.COMM_SELF, file, order=2)
    X = body.mesh.geometry.x
    r2 = X[:, 0] ** 2 + X[:, 1] ** 2
    X[:, 2] += r2 / (2 * R) * (1 - X[:, 2] / long)
    return body


def in_space(per, reach):
    """A row: sphere on a plane in space, a quarter of it, 20 a wide and high, P2."""
    h = A / per
    body, dhat = solid(h), reach * h
    u, t = forms.displacement(body, 2), forms.load_factor(body)
    e = ufl.sym(forms.deformation_gradient(u)) - ufl.Identity(3)
    psi = E / (2 * (1 + NU)) * (ufl.inner(e, e) + NU / (1 - 2 * NU) * ufl.tr(e) ** 2)
    plane = obstacles.plane((0, 0, 0), (0, 0, 1))
    floor = forms.obstacle(u, plane, body.ds("bottom"), dhat=dhat, gap=dhat)
    held = [forms.roller(u, body.facets(side), axis) for side, axis in (("left", 0), ("front", 1))]
    held.append(forms.translate(u, body.facets("top"), (None, None, -0.00245 * t)))
    start = time.process_time()
    path = forms.follow(psi * ufl.dx + floor, u, held, t, progress=False)
    seconds = time.process_time() - start
    p = contact.pressure(path)
    a, peak = known("sphere", -4 * contact.force(path)[2])
    x, ds = ufl.SpatialCoordinate(body.mesh), body.ds("bottom", degree=6)
    second = forms.integral(p * (x[0] ** 2 + x[1] ** 2) * ds) / forms.integral(p * ds)
    return {
        "body": "sphere in space",
        "element": "P2",
        "a/h": float(f"{a / h:.3g}"),
        "dhat/h": reach,
        "dofs": path.problem.size,
        "width": float(f"{np.sqrt(2.5 * second) / a - 1:.3g}"),
        "peak": float(f"{p.x.array.max() / peak - 1:.3g}"),
        "a/R": float(f"{a / R:.3g}"),
        "steps": len(path.steps),
        "tangents": path.tangents,
        "seconds": round(seconds, 2),
    }
