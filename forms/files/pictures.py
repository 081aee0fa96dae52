# SPDX-License-Identifier: MIT
"""Pictures of deformed bodies by pyvista, off-screen, from any number of ranks."""

from __future__ import annotations

import atexit
import os
import shutil
import subprocess
from pathlib import Path as FilePath
from typing import Any

import numpy as np
import ufl
from dolfinx import fem, plot
from numpy.typing import NDArray

from .._parallel import on_rank_zero
from .._types import Expr
from ..fields import discontinuous, field
from ..results import displacement_of


def picture(
    shown: Any,
    filename: str | FilePath,
    color: Expr | None = None,
    label: str = "|u|",
    *,
    limits: tuple[float, float] | None = None,
    view: tuple[float, float, float] | None = None,
    title: str = "",
    scale: float = 1.0,
    reference: bool = True,
    size: tuple[int, int] = (1200, 800),
) -> None:
    """Draw the deformed body, colored by a scalar field, into a PNG. Collective; rank 0 draws.

    Args:
        shown: Path, or an unknown (for a mixed one its displacement is shown).
        filename: PNG file.
        color: UFL scalar to color by; by default the displacement's magnitude.
        label: Text of the color bar, with the unit.
        limits: Least and largest value of the color bar; by default those of the field.
        view: Direction from the body to the camera; by default from the front right above in 3D,
            along z for plane bodies.
        title: Text above the picture.
        scale: Factor on the displacement.
        reference: Show the outline of the reference body.
        size: Width and height in pixels.

    Raises:
        ValueError: the color is no scalar, or the name does not end in .png.
        RuntimeError: no display can be made (Xvfb is not installed).
    """
    if FilePath(filename).suffix != ".png":
        raise ValueError(f"a picture needs a name that ends in .png, got {filename}.")
    u = displacement_of(getattr(shown, "u", shown))
    color = ufl.sqrt(ufl.inner(u, u)) if color is None else color
    if ufl.as_ufl(color).ufl_shape != ():
        raise ValueError(f"a picture is colored by a scalar, got shape {color.ufl_shape}.")
    comm = u.function_space.mesh.comm
    on_rank_zero(comm, ensure_display)
    parts = comm.gather(part_of(u, color), root=0)
    dim = u.function_space.mesh.geometry.dim

    def draw() -> None:
        grid = merged(parts)
        draw_grid(grid, filename, label, limits, view, title, scale, reference, size, dim)

    on_rank_zero(comm, draw)


def part_of(u: fem.Function, color: Expr) -> tuple[NDArray, ...]:
    """This rank's owned cells: VTK connectivity, types, points, displacements, colors."""
    mesh, degree = u.function_space.mesh, u.function_space.ufl_element().embedded_superdegree
    moved = fem.Function(discontinuous(mesh, degree, (mesh.geometry.dim,)))
    moved.interpolate(u)
    c = field(color, mesh, degree)
    owned = np.arange(mesh.topology.index_map(mesh.topology.dim).size_local, dtype=np.int32)
    # mypy sees the overload for meshes only.
    cells, types, points = plot.vtk_mesh(c.function_space, owned)  # type: ignore[arg-type]
    d = np.zeros((len(points), 3))
    d[:, : mesh.geometry.dim] = moved.x.array.reshape(-1, mesh.geometry.dim)
    return cells, types, points, d, c.x.array.copy()


def merged(parts: list[tuple[NDArray, ...]]) -> Any:
    """One grid of all ranks' cells; values at coinciding nodes are averaged."""
    import pyvista

    types, points, d, c = (np.concatenate([part[i] for part in parts]) for i in range(1, 5))
    width = max(len(part[0]) // max(len(part[1]), 1) for part in parts)
    offsets = np.cumsum([0] + [len(part[2]) for part in parts])
    cells = np.concatenate(
        [part[0].reshape(-1, width)[:, 1:] + n for part, n in zip(parts, offsets, strict=False)]
    )
    keys = np.round(points / (1e-7 * np.ptp(points, axis=0).max())).astype(np.int64)
    _, first, node = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    node = node.ravel()
    count = np.bincount(node)
    connectivity = np.insert(node[cells], 0, width - 1, axis=1)
    grid = pyvista.UnstructuredGrid(connectivity.ravel(), types, points[first])
    grid["u"] = np.stack([np.bincount(node, d[:, i]) / count for i in range(3)], axis=1)
    c = np.bincount(node, c) / count
    grid["color"] = np.where(np.abs(c) > 1e-12 * np.abs(c).max(), c, 0)  # a rounded 0 reads 0
    return grid


def draw_grid(
    grid: Any,
    filename: str | FilePath,
    label: str,
    limits: tuple[float, float] | None,
    view: tuple[float, float, float] | None,
    title: str,
    scale: float,
    reference: bool,
    size: tuple[int, int],
    dim: int,
    within: NDArray | None = None,
) -> None:
    """Draw a grid; local, on rank 0. ``within`` are points that the picture fits, of all frames."""
    import pyvista

    FilePath(filename).parent.mkdir(parents=True, exist_ok=True)
    plotter = pyvista.Plotter(off_screen=True, window_size=list(size))
    plotter.set_background("white")
    deformed = grid.copy()
    deformed.points = grid.points + scale * grid["u"]
    surface = _surface(deformed)
    bar = {
        "title": label + "\n",
        "vertical": True,
        "position_x": 0.86,
        "position_y": 0.2,
        "height": 0.6,
        "width": 0.06,
        "color": "black",
        "title_font_size": 22,
        "label_font_size": 20,
        "fmt": "%.3g",
        "n_labels": 5,
    }
    # Mostly ambient light: shading must not turn a color into another one of the bar.
    light: dict[str, Any] = {"lighting": False} if dim == 2 else {"ambient": 0.55, "diffuse": 0.5}
    light |= {"scalars": "color", "cmap": "viridis", "clim": limits}
    plotter.add_mesh(surface, scalar_bar_args=bar, **light)
    edges = surface.extract_feature_edges(40, boundary_edges=True, non_manifold_edges=False)
    if edges.n_points:
        plotter.add_mesh(edges, color="black", line_width=1.5)
    if reference:
        outline = _surface(grid).extract_feature_edges(40)
        if outline.n_points:
            plotter.add_mesh(outline, color="gray", line_width=1.5, opacity=0.6)
    if title:
        plotter.add_text(title, position="upper_edge", font_size=12, color="black")
    direction = view or ((0.0, 0.0, 1.0) if dim == 2 else (1.0, -2.0, 1.0))
    shown = np.concatenate([surface.points, grid.points]) if reference else surface.points
    _aim(
        plotter,
        shown if within is None else within,
        np.asarray(direction, float),
        size,
        bool(title),
    )
    plotter.screenshot(str(filename))
    # Close before the display ends, or X reports a fatal error at exit.
    plotter.close()


def _surface(grid: Any) -> Any:
    """Surface of a grid; curved faces in flat pieces, halved twice, smooth to the eye."""
    import pyvista

    # pyvista 0.47 warns unless it is told the way that earlier releases take anyhow.
    named = {"algorithm": "dataset_surface"} if pyvista.version_info >= (0, 47) else {}
    return grid.extract_surface(nonlinear_subdivision=2, **named)


def _aim(
    plotter: Any, points: NDArray, direction: NDArray, size: tuple[int, int], title: bool
) -> None:
    """Parallel view that fits the points tightly beside the color bar."""
    d = direction / np.linalg.norm(direction)
    vertical = np.array([0.0, 1.0, 0.0] if abs(d[2]) > 0.999 else [0.0, 0.0, 1.0])
    right = np.cross(vertical, d)
    right /= np.linalg.norm(right)
    up = np.cross(d, right)
    across, along = points @ right, points @ up
    aspect = size[0] / size[1]
    # The bar takes the right sixth of the width, a title some of the height.
    scale = max(np.ptp(along) * (0.62 if title else 0.55), np.ptp(across) * 0.63 / aspect)
    middle = right * (across.max() + across.min()) / 2 + up * (along.max() + along.min()) / 2
    focus = middle + right * 0.16 * scale * aspect + up * (0.06 * scale if title else 0)
    camera = plotter.camera
    camera.parallel_projection = True
    camera.focal_point = focus + d * np.mean(points @ d)
    camera.position = np.asarray(camera.focal_point) + d * 10 * np.ptp(points, axis=0).max()
    camera.up = up
    camera.parallel_scale = scale
    plotter.renderer.reset_camera_clipping_range()


def ensure_display() -> None:
    """Start Xvfb if there is no display: VTK as Debian builds it draws through X only."""
    if os.environ.get("DISPLAY") or os.name != "posix":
        return
    if shutil.which("Xvfb") is None:
        raise RuntimeError(
            "a picture needs a display or Xvfb, found neither: apt-get install xvfb, or run "
            "through docker/enter."
        )
    read, write = os.pipe()
    server = subprocess.Popen(
        ["Xvfb", "-displayfd", str(write), "-screen", "0", "1600x1200x24", "-nolisten", "tcp"],
        pass_fds=(write,),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # Ctrl-C is for us; the server ends with us all the same.
    )
    os.close(write)
    with open(read) as pipe:
        # Up to the newline: Xvfb writes twice and dies of SIGPIPE if the pipe closes in between.
        number = pipe.readline().strip()
    if not number:
        raise RuntimeError("Xvfb did not start; run it by hand to see why.")
    os.environ["DISPLAY"] = f":{number}"
    atexit.register(server.terminate)
