# SPDX-License-Identifier: MIT
"""Surfaces of the demos' bodies, which the site lets the mouse turn beside their pictures.

A surface is kept as the demo's picture shows it, in demos/figures/NAME.npz: points and colors in
16 bits, small enough to lie beside the picture. ``python3 -m demos.pages.turning NAME`` runs a demo
and keeps its surface; ``python3 -m demos.pages --demos`` does so for all.
"""

import runpy
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

FIGURES = Path(__file__).resolve().parents[1] / "figures"

# Demos whose body is in space.
TURNED = ("twist", "bar", "torsion", "import_cad", "muscle", "balloon", "wrap", "airbag")
TURNED += ("wobble", "unload", "drape")

LEVELS = 2**16 - 1
MOST = 20_000  # triangles


@dataclass(frozen=True)
class Surface:
    """A colored surface in space and its edges.

    Attributes:
        points: Coordinates, shape (N, 3).
        triangles: Points of each, shape (n, 3).
        colors: Value of each point, shape (N,).
        lines: Points at the ends of each piece of an edge, shape (m, 2).
        label: Text of the color bar.
        limits: Least and largest value of the color bar.
    """

    points: NDArray[np.float64]
    triangles: NDArray[np.int64]
    colors: NDArray[np.float64]
    lines: NDArray[np.int64]
    label: str
    limits: tuple[float, float]

    @classmethod
    def load(cls, file):
        """Read what :func:`keep` wrote; right to 16 bits of the body's size."""
        with np.load(file) as data:
            points = data["low"] + data["points"] / LEVELS * data["size"]
            low, high = data["range"]
            colors = low + data["colors"] / LEVELS * (high - low)
            triangles, lines = (data[name].astype(np.int64) for name in ("triangles", "lines"))
            limits = tuple(map(float, data["limits"]))
            return cls(points, triangles, colors, lines, str(data["label"]), limits)


def keep(grid, label, limits, scale, file):
    """Write the surface of a grid of :mod:`variform.forms`' pictures, deformed."""
    deformed = grid.copy()
    deformed.points = grid.points + scale * grid["u"]
    for halved in (2, 1, 0):
        surface = deformed.extract_surface(nonlinear_subdivision=halved).triangulate()
        surface = surface.clean()
        if surface.n_cells <= MOST:
            break
    edges = surface.extract_feature_edges(40, boundary_edges=True, non_manifold_edges=False)
    low, size = surface.points.min(axis=0), np.ptp(surface.points, axis=0).max()
    colors = np.asarray(surface["color"], float)
    bottom, top = colors.min(), max(colors.max(), colors.min() + 1e-12)
    whole = np.concatenate([surface.points, edges.points]) if edges.n_points else surface.points
    lines = edges.lines.reshape(-1, 3)[:, 1:] + surface.n_points if edges.n_points else []
    kept = "u2" if len(whole) < 2**16 else "u4"
    np.savez_compressed(
        file,
        points=np.round((whole - low) / size * LEVELS).clip(0, LEVELS).astype("u2"),
        low=low,
        size=size,
        triangles=surface.faces.reshape(-1, 4)[:, 1:].astype(kept),
        lines=np.asarray(lines).reshape(-1, 2).astype(kept),
        colors=np.round((colors - bottom) / (top - bottom) * LEVELS).astype("u2"),
        range=(bottom, top),
        limits=limits or (bottom, top),
        label=label,
    )


def record(name, file):
    """Run a demo, and keep the surface of the picture that bears its name."""
    from variform.forms.files import pictures

    draw = pictures.draw_grid

    def draw_and_keep(grid, filename, label, limits, view, title, scale, *rest):
        draw(grid, filename, label, limits, view, title, scale, *rest)
        if Path(filename).name == f"{name}.png":
            keep(grid, label, limits, scale, file)

    pictures.draw_grid = draw_and_keep
    try:
        runpy.run_module(f"demos.{name}", run_name="__main__")
    finally:
        pictures.draw_grid = draw


if __name__ == "__main__":
    record(sys.argv[1], FIGURES / f"{sys.argv[1]}.npz")
