# SPDX-License-Identifier: MIT
"""The block that every code solves: mesh, load, energy, and the row that each run prints.

NumPy alone, so that each code can import it in an environment of its own.

Block 1 x 0.2 x 0.2 of 5 m x m x m cubes of six tetrahedra (Kuhn's); psi = mu/2 (I_C - 3) - mu ln J
+ lmbda/2 (ln J)^2; the end x = 0 clamped, the end x = 1 turned by 60 degrees about the axis and
pulled by 0.1, in 3 equal load steps. Quadrature of degree 1 (P1) or 2 (P2).
"""

import argparse
import itertools
import json
import resource
import time
from pathlib import Path

import numpy as np

MU, LMBDA = 1.0, 1.5
TWIST, STRETCH = np.pi / 3, 0.1
STEPS = 3
# DOLFINx's NewtonSolver stops at |R| <= 1e-8 |first right-hand side|, which in a step driven by
# supports is the norm of the prescribed increments, whatever the forces. That, ten times tighter,
# is the absolute residual in units of force that everyone is held to: with 1e-8 DOLFINx stops an
# iteration early at 200k unknowns, its displacements 6e-6 off.
RTOL = 1e-9
# Cubes across by degree and size: about 10, 60 and 200 thousand degrees of freedom.
SIZES = {
    ("P1", "10k"): 8,
    ("P2", "10k"): 4,
    ("P1", "58k"): 15,
    ("P2", "70k"): 8,
    ("P1", "200k"): 23,
    ("P2", "176k"): 11,
}


def block(m):
    """Points (n, 3) and tetrahedra (5 m^3 6, 4), all of positive volume."""
    shape = (5 * m, m, m)
    axes = [np.linspace(0, size, k + 1) for size, k in zip((1.0, 0.2, 0.2), shape, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    strides = np.array([(m + 1) ** 2, m + 1, 1])
    corners = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), -1).reshape(-1, 3)
    cells = []
    for order in itertools.permutations(range(3)):
        path = np.cumsum([0, *strides[list(order)]])
        if np.linalg.det(np.eye(3)[list(order)]) < 0:
            path[[2, 3]] = path[[3, 2]]
        cells.append((corners @ strides)[:, None] + path)
    return points, np.stack(cells, axis=1).reshape(-1, 4).astype(np.int64)


def turned(points, load):
    """Displacements (n, 3) of points of the end x = 1 at a load factor from 0 to 1."""
    angle = TWIST * load
    y, z = points[:, 1] - 0.1, points[:, 2] - 0.1
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([np.full(len(points), STRETCH * load), c * y - s * z - y, s * y + c * z - z], 1)


def tolerance(points):
    """Absolute residual [force] that everyone is held to, for nodes of the end x = 1."""
    end = points[np.isclose(points[:, 0], 1)]
    return RTOL * float(np.linalg.norm(turned(end, 1 / STEPS)))


def quadratic(points, cells):
    """Points and cells of 10-node tetrahedra: edges 01 12 02 03 13 23 after the corners."""
    pairs = [(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)]
    edges = np.sort(np.concatenate([cells[:, pair] for pair in pairs]), axis=1)
    found, inverse = np.unique(edges, axis=0, return_inverse=True)
    middles = points[found].mean(axis=1)
    numbers = len(points) + inverse.reshape(6, -1).T
    return np.concatenate([points, middles]), np.concatenate([cells, numbers], axis=1)


def bent(points):
    """A smooth displacement (n, 3) at which residuals and tangents are assembled."""
    x, y, z = points.T
    return 0.05 * np.stack([x * y, y * z + x, x**2], axis=1)


def arguments(**choices):
    """Command line of a code: element, cubes across, load steps run, and its own choices."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--degree", type=int, default=1, choices=(1, 2))
    parser.add_argument("--m", type=int, default=8, help="cubes across")
    parser.add_argument("--steps", type=int, default=STEPS, help="load steps run, of 3")
    parser.add_argument("--assemble", type=int, default=0, help="assemble so often instead")
    parser.add_argument("--output", type=Path, help="folder for the displacements of the vertices")
    for name, options in choices.items():
        parser.add_argument(f"--{name}", default=options[0], choices=options)
    return parser.parse_args()


class Clock:
    """CPU and wall seconds of named parts: ``with clock("tangent"): ...``."""

    def __init__(self):
        self.cpu, self.wall = {}, {}
        self._open = []

    def __call__(self, name):
        """Name of the part that begins."""
        self._open.append((name, time.process_time(), time.perf_counter()))
        return self

    def __enter__(self):
        return self

    def __exit__(self, *error):
        name, cpu, wall = self._open.pop()
        self.cpu[name] = self.cpu.get(name, 0.0) + time.process_time() - cpu
        self.wall[name] = self.wall.get(name, 0.0) + time.perf_counter() - wall


def report(code, given, clock, u=None, **numbers):
    """Print a run's JSON row; u are the displacements of the vertices in :func:`block`'s order."""
    row = {"code": code, "degree": given.degree, "m": given.m, "steps": given.steps, **numbers}
    row |= {f"{name} [s]": round(seconds, 4) for name, seconds in clock.cpu.items()}
    row |= {f"{name}, wall [s]": round(seconds, 4) for name, seconds in clock.wall.items()}
    row["peak [MB]"] = round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
    if u is not None and given.output:
        given.output.mkdir(parents=True, exist_ok=True)
        name = f"{code}_P{given.degree}_{given.m}_{given.steps}.npy".replace(" ", "_")
        np.save(given.output / name, u)
        row["file"] = name
    print(json.dumps(row, default=float), flush=True)
