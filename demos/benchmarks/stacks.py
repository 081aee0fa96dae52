# SPDX-License-Identifier: MIT
"""Two blocks of different meshes on each other, by NumPy alone."""

import numpy as np


def stack(below, above, gap, dim=2):
    """Two unit blocks of below and above cells along each edge, a gap between them.

    Returns:
        Points (n, dim); cells, quadrilaterals or hexahedra; numbers of the points of "low face",
        "up face", "low end", "up end" and of "side 0", "side 1", which both blocks have.
    """
    points, cells, names, start = [], [], {}, 0
    for name, n, y in (("low", below, 0.0), ("up", above, 1.0 + gap)):
        axes = [np.linspace(0, 1, n + 1)] * dim
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, dim)
        number = np.arange((n + 1) ** dim).reshape((n + 1,) * dim)
        i = [
            number[tuple(slice(a, a + n) for a in corner)].ravel()
            for corner in np.ndindex((2,) * dim)
        ]
        order = [0, 2, 3, 1] if dim == 2 else [0, 4, 6, 2, 1, 5, 7, 3]
        cells.append(np.stack([i[k] for k in order], axis=1) + start)
        ids = np.arange(len(grid)) + start
        names[f"{name} face"] = ids[grid[:, -1] == (1.0 if name == "low" else 0.0)]
        names[f"{name} end"] = ids[grid[:, -1] == (0.0 if name == "low" else 1.0)]
        for axis in range(dim - 1):
            for value in (0.0, 1.0):
                side = names.setdefault(f"side {axis}", np.empty(0, int))
                names[f"side {axis}"] = np.r_[side, ids[grid[:, axis] == value]]
        grid = grid.copy()
        grid[:, -1] += y
        points.append(grid)
        start += len(grid)
    return np.concatenate(points), np.concatenate(cells), names
