# SPDX-License-Identifier: MIT
"""Checkpoints: states, steps and step lengths of a path in a file, to be gone on with later.

Arrays stand in an order that no partition changes: nodes as they first appear in the cells as these
were input. So any number of ranks reads them, on the mesh that the script makes anew. Rank 0
gathers and writes, not ADIOS2, which hangs on several ranks and aborts on one where a disk is full.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path as FilePath
from typing import Any

import numpy as np
from dolfinx import fem
from numpy.typing import NDArray

from .. import _dolfinx
from .._checks import warn
from .._parallel import on_rank_zero
from ..barriers import Clearance
from ..paths import Convergence, Step
from ..validity import Bounds
from .identity import NodeOrder

FORMAT = 2
ANEW = "or start anew with Checkpoint(…, resume=False)"


@dataclass(frozen=True)
class Checkpoint:
    """A folder for checkpoints of a path, from which the same script goes on when started again.

    With ``follow(…, checkpoint=Checkpoint("results/run", every=5))`` the last converged state is
    written after every fifth step, at the end, and where no smaller step converges. A run killed at
    any moment leaves its last checkpoint whole. Started again, on any number of ranks, the script
    says where it resumes: on as many ranks it goes along the same path to the last digits, on
    others to the tolerances; a completed path comes back at once.

    Mesh and element are compared with the checkpoint's. The potential, the supports and u's first
    state are not: after changing a parameter start anew. ``to``, ``min_step`` and ``max_step`` may
    change on the way; ``step`` then has no effect. ``on_step`` is not called again for earlier
    steps: give a :class:`forms.VTX` another file name. Records come back as rank 0 had them, tuples
    as lists. Where a checkpoint cannot be written (a full disk), the run warns once and goes on.

    Args:
        folder: Folder for this path alone, made where it is missing; holds two checkpoints of
            three states each. Only rank 0 reads and writes it, and has these states in its memory.
        every: Load steps between checkpoints.
        resume: Whether to go on from a checkpoint in the folder. If not, the first new one replaces
            those of earlier runs.

    Raises:
        ValueError: every is no positive integer.
    """

    folder: str | FilePath
    every: int = 1
    resume: bool = True

    def __post_init__(self) -> None:
        if not (isinstance(self.every, int) and self.every > 0):
            raise ValueError(
                f"a checkpoint is written every 1, 2, … steps, got every = {self.every!r}."
            )


@dataclass(frozen=True)
class Saved:
    """What a checkpoint holds.

    Attributes:
        states: Values of the unknown with its ghosts, of the last converged loads, latest first.
        steps: The steps of the path.
        control: Numbers of the follower: step lengths, counts.
    """

    states: list[NDArray[np.float64]]
    steps: list[Step]
    control: dict[str, Any]


class Archive:
    """Writer and reader of one path's checkpoints; its methods are collective.

    Args:
        checkpoint: Where and how often.
        u: Unknown of the path, on its mesh as it is now.
        path: What is followed, in words; a path of another kind is refused.

    Raises:
        ValueError: no Checkpoint, or a mesh or element that cannot be recognized again.
        OSError: the folder cannot be made or written.
    """

    def __init__(self, checkpoint: Checkpoint, u: fem.Function, path: str) -> None:
        if not isinstance(checkpoint, Checkpoint):
            raise ValueError(
                f'checkpoint needs forms.Checkpoint("folder"), got {type(checkpoint).__name__}.'
            )
        self.folder, self._every = FilePath(checkpoint.folder), checkpoint.every
        self._resume, self._u = checkpoint.resume, u
        self._scratch = self.folder / "checkpoint.new"
        V, mesh = u.function_space, u.function_space.mesh
        self._comm, cells = mesh.comm, _dolfinx.original_cells(mesh)
        if cells is None or V.element.needs_dof_transformations:
            raise ValueError(
                "checkpoints need a mesh that is no submesh and a Lagrange element, got "
                f"{V.ufl_element()}: follow without."
            )
        geometry = _dolfinx.geometry_dofmap(mesh)[: len(cells)], mesh.geometry.index_map()
        dofs, bs = V.dofmap, V.dofmap.index_map_bs
        points = NodeOrder(mesh.comm, cells, *geometry, 3)
        self._order = NodeOrder(mesh.comm, cells, dofs.list[: len(cells)], dofs.index_map, bs)
        x: NDArray[Any] = mesh.geometry.x
        self._points = points.gather(x.ravel())
        self._identity = {
            "path": path,
            "mesh": f"{mesh.comm.allreduce(len(cells))} cells and {geometry[1].size_global} nodes",
            "element": str(V.ufl_element()),
            "joined": [points.digest, self._order.digest],
        }
        # On rank 0: steps as JSON, files of this path, sentences about broken ones.
        self._lines, self._kept, self._broken = list[str](), list[FilePath](), list[str]()
        self._number, self._written, self._warned = 0, 0, False
        on_rank_zero(mesh.comm, self._open_folder)

    def read(self) -> Saved | None:
        """Last whole checkpoint in the folder; None where there is none or resume is off.

        Raises:
            ValueError: it is of another mesh, element, kind of path or format, or none is whole.
        """
        saved: Saved | None = None
        whole: list[NDArray] = []  # states of all nodes, on rank 0

        def load() -> None:
            nonlocal saved, whole
            saved, whole = self._newest()

        if self._resume:
            on_rank_zero(self._comm, load)
        saved, count, broken = self._comm.bcast((saved, len(whole), self._broken), root=0)
        if saved is None:
            return None
        if broken:
            warn(f"{'; '.join(broken)}: the one before is taken.")
        x, before = self._u.x, self._u.x.array.copy()
        for n in range(count):
            owned = self._order.scatter(whole[n] if whole else None)
            x.array[: len(owned)] = owned
            x.scatter_forward()
            saved.states.append(x.array.copy())
        x.array[:] = before
        self._written = len(saved.steps)
        return saved

    def write(
        self,
        states: Sequence[NDArray[np.float64]],
        steps: Sequence[Step],
        control: Mapping[str, Any],
        now: bool = False,
    ) -> bool:
        """Write a checkpoint where one is due after so many steps, or now; see :class:`Saved`.

        Returns:
            Whether one was due, alike on all ranks.

        Raises:
            ValueError: a record holds none of numbers, texts, lists, dictionaries and arrays.
        """
        lines = self._lines
        on_rank_zero(self._comm, lambda: lines.extend(map(_line, steps[len(lines) :])))
        due = now or len(steps) % self._every == 0
        if not due or self._written == len(steps):
            return False
        self._written = len(steps)
        gathered = [self._order.gather(state) for state in states]
        try:
            on_rank_zero(self._comm, lambda: self._store(gathered, control))
        except OSError as error:
            if not self._warned:
                warn(
                    f"no checkpoint of step {len(steps)} was written in {self.folder} ({error}): "
                    "the last whole one is kept and the run goes on; make room for the next."
                )
            self._warned = True
        return True

    # All below runs on rank 0 alone.

    def _open_folder(self) -> None:
        """Make the folder and, to see whether that is possible, a file in it."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._scratch.touch()
            self._scratch.unlink()
        except OSError as error:
            raise OSError(
                f"checkpoints cannot be written in {self.folder} ({error}): give another folder."
            ) from error
        self._number = max(map(_number, self._files()), default=0)

    def _files(self) -> list[FilePath]:
        """Checkpoints in the folder, the newest last."""
        return sorted(filter(_number, self.folder.iterdir()), key=_number)

    def _newest(self) -> tuple[Saved | None, list[NDArray]]:
        """Newest checkpoint that is whole, and its states."""
        for file in reversed(self._files()):
            try:
                head, arrays = _load(file)
            except Exception as error:  # a damaged file fails in many ways
                self._broken.append(f"{file} is broken ({error or type(error).__name__})")
                continue
            self._check(file, head, arrays["points"])
            self._lines, self._kept = json.loads(arrays["steps"].tobytes()), [file]
            steps = [_step(line) for line in self._lines]
            states = [arrays[f"state{n}"] for n in range(head["states"])]
            return Saved([], steps, head["control"]), states
        if self._broken:
            raise ValueError(f"{'; '.join(self._broken)}: put back a copy, {ANEW}.")
        return None, []

    def _check(self, file: FilePath, head: dict[str, Any], points: NDArray) -> None:
        """Refuse a checkpoint that is none of this path."""
        if head["format"] != FORMAT:
            raise ValueError(
                f"{file} has the format {head['format']} of variform {head['variform']}, this "
                f"release reads {FORMAT}: go on with that one, {ANEW}."
            )
        for what in ("path", "mesh", "element"):
            then, now = head["identity"][what], self._identity[what]
            if then != now:
                raise ValueError(
                    f"{file} is of another {what}, {then}, this one is {now}: make it as in that "
                    f"run, {ANEW}."
                )
        size = float(np.linalg.norm(np.ptp(points, axis=0)))
        off = float(np.abs(points - self._points).max())
        if head["identity"]["joined"] != self._identity["joined"] or off > 1e-9 * size:
            raise ValueError(
                f"{file} is of another mesh of as many cells, its nodes up to {off:.3g} m away or "
                "joined otherwise: make it as in that run (one refined in parallel on as many "
                f"ranks), {ANEW}."
            )

    def _store(self, states: Sequence[NDArray | None], control: Mapping[str, Any]) -> None:
        """Write a whole file under another name, give it its own, then remove older ones."""
        head = {
            "format": FORMAT,
            "variform": _version(),
            "identity": self._identity,
            "states": len(states),
            "control": dict(control),
        }
        texts = {"head": json.dumps(head, default=_plain), "steps": json.dumps(self._lines)}
        arrays = {f"state{n}": state for n, state in enumerate(states)} | {"points": self._points}
        arrays |= {name: np.frombuffer(text.encode(), np.uint8) for name, text in texts.items()}
        buffer = io.BytesIO()
        # mypy takes the arrays for savez's own argument allow_pickle.
        np.savez(buffer, **arrays)  # type: ignore[arg-type]
        target = self.folder / f"checkpoint-{self._number + 1:06d}.npz"
        try:
            with open(self._scratch, "wb") as file:
                file.write(buffer.getbuffer())
                file.flush()
                # Else a loss of power may leave the new name with nothing behind it.
                os.fsync(file.fileno())
            os.replace(self._scratch, target)
        except OSError:
            self._scratch.unlink(missing_ok=True)
            raise
        self._number += 1
        self._kept = [*self._kept, target][-2:]
        for other in self._files():
            if other not in self._kept:
                other.unlink(missing_ok=True)


def _number(file: FilePath) -> int:
    """Number of a checkpoint's file; 0 for any other."""
    match = re.fullmatch(r"checkpoint-(\d+)\.npz", file.name)
    return int(match[1]) if match else 0


def _load(file: FilePath) -> tuple[dict[str, Any], dict[str, NDArray]]:
    """Head and arrays of a file, whose check sums NumPy compares in reading."""
    # np.load given a name would leave a file open that is no archive.
    with open(file, "rb") as stream, np.load(stream, allow_pickle=False) as data:
        arrays = {name: data[name] for name in data.files}
    return json.loads(arrays["head"].tobytes()), arrays


def _line(step: Step) -> str:
    """A step as JSON, in which floats keep all their bits."""
    parts = [step.load, vars(step.convergence), step.records, step.bounds]
    if step.clearance is not None:
        parts.append(step.clearance)
    return json.dumps(parts, default=_plain)


def _step(line: str) -> Step:
    load, entries, records, bounds, *more = json.loads(line, object_hook=_restored)
    for name in ("residuals", "tried"):
        entries[name] = tuple(entries[name])
    if bounds is not None:
        bounds = Bounds(bounds[0], bounds[1], tuple(bounds[2]))
    clearance = Clearance(more[0][0], tuple(more[0][1]), more[0][2]) if more else None
    return Step(load, Convergence(**entries), records, bounds, clearance)


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return {"ndarray": value.tolist(), "dtype": str(value.dtype), "shape": value.shape}
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Mapping):
        return dict(value)
    raise ValueError(
        "a checkpoint keeps records of numbers, texts, lists and arrays, got "
        f"{type(value).__name__}: let the record return one of these."
    )


def _restored(entries: dict[str, Any]) -> Any:
    if entries.keys() != {"ndarray", "dtype", "shape"}:
        return entries
    return np.array(entries["ndarray"], entries["dtype"]).reshape(entries["shape"])


def _version() -> str:
    with contextlib.suppress(metadata.PackageNotFoundError):
        return metadata.version("variform")
    return "of a checkout"
