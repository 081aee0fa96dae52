# SPDX-License-Identifier: MIT
"""Which rigid motions nothing holds: the reason behind most singular tangents, in words."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .._parallel import bounding_box
from ..paths import NotConverged, Path
from ..problems import Problem

Array = NDArray[np.float64]
HELD = 1e-8  # share of a held motion below which it counts as free


def free_motions(problem: Problem) -> list[str]:
    """Rigid motions that neither supports nor springs resist at u, in words. Collective.

    Supports are looked at alone first; of the motions they leave free those are named that the
    tangent does not resist either, |K v| <= 1e-8 |K| |v|.

    Args:
        problem: Problem, at a state without large rotations.

    Returns:
        Entries as "translation along x" and "rotation about the axis along z through (0, 0, 0)";
        empty where the body is held.
    """
    field = problem.displacement
    if field is None:
        return []
    W, numbers = field.collapsed
    dim = W.mesh.geometry.dim
    low, high = bounding_box(problem.comm, W.mesh.geometry.x)
    center, size = (low + high) / 2, float(np.linalg.norm(high - low))
    owned = W.dofmap.index_map.size_local
    x = np.asarray((W.tabulate_dof_coordinates()[:owned] - center) / size, np.float64)
    modes = _modes(x, dim)
    dofs = numbers[: owned * dim]
    held = np.isin(dofs, problem.constrained)
    kept = modes[held]
    if problem.slants is not None:
        kept = np.concatenate([kept, problem.slants.held(modes, dofs)])
    resisted = problem.comm.allreduce(kept.T @ kept)
    values, vectors = np.linalg.eigh(resisted)
    free = vectors[:, values <= HELD * max(values.max(), 1.0)]
    if free.size:
        free = free @ _not_resisted(problem, modes @ free, dofs)
    return _named(_pad(free, dim), center, size) if free.size else []


def _modes(x: Array, dim: int) -> Array:
    """Translations, then rotations, as columns over all components of all nodes."""
    planes = [(0, 1)] if dim == 2 else [(1, 2), (2, 0), (0, 1)]
    modes = np.zeros((len(x), dim, dim + len(planes)))
    for i in range(dim):
        modes[:, i, i] = 1
    for n, (i, j) in enumerate(planes, start=dim):
        modes[:, i, n], modes[:, j, n] = -x[:, j], x[:, i]
    return modes.reshape(len(x) * dim, -1)


def _not_resisted(problem: Problem, motions: Array, dofs: NDArray) -> Array:
    """Combinations (columns) of motions that the tangent does not resist."""
    A, b = problem.create_matrix(), problem.create_vector()
    problem.tangent(A)
    images = []
    x = b.duplicate()
    for motion in motions.T:
        x.set(0)
        x.array[dofs] = motion
        A.mult(x, b)
        images.append(b.array_r.copy())
    largest = A.norm() / np.sqrt(max(problem.size, 1)) or 1.0
    for item in (A, b, x):
        item.destroy()
    F = np.array(images).T / largest
    M = problem.comm.allreduce(np.stack([F.T @ F, motions.T @ motions]))
    if not np.all(np.isfinite(M)):
        return np.empty((motions.shape[1], 0))
    values, vectors = np.linalg.eigh(M[0])
    return vectors[:, values <= HELD**2 * np.trace(M[1])]


def _pad(free: Array, dim: int) -> Array:
    """Free motions as columns (translation, rotation) in space."""
    if dim == 3:
        return free
    space = np.zeros((6, free.shape[1]))
    space[[0, 1, 5]] = free
    return space


def _named(free: Array, center: Array, size: float) -> list[str]:
    """Words for the motions: pure translations first, then rotations about axes."""
    _, turning, right = np.linalg.svd(free[3:])
    turns = int((turning > 1e-6).sum())
    shifts, rotations = (free @ right[turns:].T)[:3], free @ right[:turns].T
    words = [f"translation along {_direction(d)}" for d in _neat(shifts)]
    slides = np.linalg.qr(shifts)[0]
    for spin in _neat(rotations[3:]):
        shift = rotations[:3] @ np.linalg.lstsq(rotations[3:], spin, rcond=None)[0]
        shift = shift - slides @ (slides.T @ shift)
        point = np.round(center + size * np.cross(spin, shift), 6) + 0.0
        words.append(
            f"rotation about the axis along {_direction(spin)} through "
            f"({', '.join(f'{p:g}' for p in point)})"
        )
    return words


def _neat(directions: Array) -> list[Array]:
    """A basis of a span of directions, along the axes of coordinates where they lie in it."""
    if not directions.size:
        return []
    Q = np.linalg.qr(directions)[0]
    inside = [e for e in np.eye(3) if np.linalg.norm(Q.T @ e) > 1 - 1e-6]
    return inside if len(inside) == Q.shape[1] else list(Q.T)


def _direction(d: Array) -> str:
    d = d / np.linalg.norm(d)
    for name, e in zip("xyz", np.eye(3), strict=True):
        if abs(d @ e) > 1 - 1e-6:
            return name
    return f"({', '.join(f'{c:.3g}' for c in d)})"


def failure(path: Path, sentence: str, advice: str = "") -> NotConverged:
    """Exception with the path so far, and advice. Collective.

    Where rigid motions are left that nothing holds, they are the cause, and named in place of the
    advice. Called with the unknown at the last converged state.
    """
    free = free_motions(path.problem)
    if free:
        advice = (
            f"Nothing holds the body against {', '.join(free)}: add a support, a pin or a spring."
        )
    sentence = f"{sentence} {advice}".rstrip()
    path.reason = sentence
    error = NotConverged(sentence)
    error.path = path
    return error
