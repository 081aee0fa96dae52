# SPDX-License-Identifier: MIT
"""Animations of deformed bodies: frames of a path as a .gif."""

from __future__ import annotations

import tempfile
from pathlib import Path as FilePath
from typing import Any

import numpy as np
import ufl

from .._parallel import on_rank_zero
from .._types import Expr
from ..paths import Path
from ..results import displacement_of
from .pictures import draw_grid, ensure_display, merged, part_of

MOST = 120  # frames: beyond, every second one is dropped
FINER = 2  # times the size, that frames are drawn in
COLORS = 64  # of a frame: fewer make steps in the colors, more make the file larger


class Animation:
    """Frames of a path, drawn into a .gif when it is closed, all alike in frame and colors.

    ``movie = Animation("results/swing.gif", every=0.02)``, ``transient(…, on_step=movie)``,
    ``movie.close()``. Frames are kept on rank 0: for bodies that are drawn, not for those of
    millions of cells.

    Args:
        filename: File that is written, with .gif.
        every: Load factor, or time, between frames; by default each step is one. Twice as long each
            time there are 120.
        color: UFL scalar to color by; by default the displacement's magnitude.
        label: Text of the color bar, with the unit.
        limits: Least and largest value of the color bar; by default those of all frames.
        view: Direction from the body to the camera, as of :func:`forms.picture`.
        size: Width and height in pixels.
        rate: Frames a second.

    Raises:
        ValueError: a name that does not end in .gif, or a color that is no scalar.
    """

    def __init__(
        self,
        filename: str | FilePath,
        every: float = 0.0,
        color: Expr | None = None,
        label: str = "|u|",
        *,
        limits: tuple[float, float] | None = None,
        view: tuple[float, float, float] | None = None,
        size: tuple[int, int] = (480, 320),
        rate: float = 20.0,
    ) -> None:
        if FilePath(filename).suffix != ".gif":
            raise ValueError(f"an animation needs a name that ends in .gif, got {filename}.")
        if color is not None and ufl.as_ufl(color).ufl_shape != ():
            raise ValueError(f"an animation is colored by a scalar, got {color.ufl_shape}.")
        self._file, self._every, self._color = FilePath(filename), every, color
        self._label, self._limits, self._view, self._size = label, limits, view, size
        self._rate, self._next = rate, -np.inf
        self._count, self._first = 0, 0.0
        self._frames: list[tuple[float, Any]] = []
        self._comm: Any = None
        self._dim = 0

    def __call__(self, path: Path) -> None:
        """Keep the present state as a frame, if its time has come. Collective."""
        if path.load < self._next - 1e-9 * self._every:
            return
        self._first = path.load if self._count == 0 else self._first
        self._next = path.load + self._every
        u = displacement_of(path.u)
        self._comm, self._dim = u.function_space.mesh.comm, u.function_space.mesh.geometry.dim
        color = ufl.sqrt(ufl.inner(u, u)) if self._color is None else self._color
        parts = self._comm.gather(part_of(u, color), root=0)
        if self._comm.rank == 0:
            self._frames.append((path.load, parts))
        self._count += 1
        if self._count == MOST:
            first = self._first
            self._every = 2 * max(self._every, (path.load - first) / MOST)
            del self._frames[1::2]
            self._count = MOST // 2

    def close(self) -> None:
        """Draw the frames into the file. Collective.

        Raises:
            ValueError: there are none.
        """
        if self._comm is None:
            raise ValueError("an animation has no frame: pass it as on_step= before it is closed.")
        on_rank_zero(self._comm, self._write)
        self._frames.clear()

    def _write(self) -> None:
        from PIL import Image

        ensure_display()
        grids = [(time, merged(parts)) for time, parts in self._frames]
        within = np.concatenate([grid.points + grid["u"] for _, grid in grids])
        colors = np.concatenate([grid["color"] for _, grid in grids])
        limits = self._limits or (float(colors.min()), float(colors.max()))
        label, view, size = self._label, self._view, self._size
        drawn = FINER * size[0], FINER * size[1]  # words of the same part of it as in a picture
        images = []
        with tempfile.TemporaryDirectory() as folder:
            file = FilePath(folder) / "frame.png"
            for time, grid in grids:
                words = f"t = {time:.3g}"
                draw_grid(
                    *(grid, file, label, limits, view, words, 1.0, False, drawn, self._dim), within
                )
                with Image.open(file) as image:
                    images.append(image.convert("RGB").resize(size).quantize(COLORS))
        self._file.parent.mkdir(parents=True, exist_ok=True)
        duration = round(1000 / self._rate)
        images[0].save(
            self._file,
            save_all=True,
            append_images=images[1:],
            duration=duration,
            loop=0,
            optimize=True,
        )
