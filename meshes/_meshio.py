# SPDX-License-Identifier: MIT
"""Files that meshio reads: .vtk, .vtu, and the .msh that gmsh does not understand."""

import re
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from ._dolfinx import from_vtk_order
from ._grid import Grid
from ._parts import Part, assemble, sets_of_tags, shaped, split_tags

__all__ = ["read_meshio"]

FORMATS = {".vtk": "vtk", ".vtu": "vtu", ".msh": "gmsh"}

CELLS = {
    "line": "interval",
    "line3": "interval",
    "triangle": "triangle",
    "triangle6": "triangle",
    "quad": "quadrilateral",
    "quad9": "quadrilateral",
    "tetra": "tetrahedron",
    "tetra10": "tetrahedron",
    "hexahedron": "hexahedron",
    "hexahedron27": "hexahedron",
}


def read_meshio(file: Path, gdim: int | None) -> Grid:
    """Read cells, sets, tags and data by meshio on this process alone.

    Raises:
        ValueError: A file that meshio cannot read, or that holds no mesh that DOLFINx can read.
        ImportError: There is no meshio.
    """
    suffix = file.suffix.lower()
    try:
        meshio = import_module("meshio")
    except ImportError as error:
        raise ImportError(
            f"{file.name}: it is read by meshio, which cannot be imported ({error}): install "
            "Debian's python3-meshio or PyPI's meshio."
        ) from error
    try:
        mesh = getattr(meshio, FORMATS[suffix]).read(str(file))
    except (Exception, SystemExit) as error:  # meshio raises of many kinds, and exits
        reason = str(error).strip() or type(error).__name__
        raise ValueError(
            f"{file.name}: meshio cannot read it ({reason}): it may be truncated or no {suffix} at "
            "all, write it again."
        ) from None
    if suffix == ".vtu":
        stated = re.findall(rb"<Piece[^>]*NumberOfCells=.(\d+)", file.read_bytes())
        held, promised = sum(len(block.data) for block in mesh.cells), sum(map(int, stated))
        if held != promised:
            raise ValueError(
                f"{file.name}: meshio reads {held} of its {promised} cells: it has cells of a type "
                "that meshio does not know, so write the others alone."
            )
    blocks = [(i, block) for i, block in enumerate(mesh.cells) if len(block.data)]
    tdim = max((block.dim for _, block in blocks), default=0)
    strange = sorted({b.type for _, b in blocks if b.dim == tdim and b.type not in CELLS})
    if strange or tdim < 2:
        raise ValueError(
            f"{file.name}: it holds cells of meshio's type {' and '.join(strange) or 'none'}: a "
            "body needs one type, of triangles, quadrilaterals, tetrahedra or hexahedra of order "
            "1 or 2."
        )
    blocks = [(i, block) for i, block in blocks if block.type in CELLS]
    arrays = {
        name: np.concatenate([np.asarray(values[i]) for i, _ in blocks])
        for name, values in mesh.cell_data.items()
    }
    arrays = {name: v.reshape(len(v), -1) if v.ndim > 2 else v for name, v in arrays.items()}
    chosen, data = split_tags(arrays)
    called = {(int(tag), int(dim)): name for name, (tag, dim) in _names(mesh).items()}
    parts, start = [], 0
    for i, block in blocks:
        nodes = np.asarray(block.data, dtype=np.int64)
        here = slice(start, start + len(nodes))
        start += len(nodes)
        cell = CELLS[block.type]
        part = Part(block.type, cell, nodes[:, from_vtk_order(cell, nodes.shape[1])])
        if chosen is not None:
            values = arrays[chosen][here]
            # gmsh's negative tags are of the same group, turned around.
            sets, tags = sets_of_tags(abs(values) if chosen == "gmsh:physical" else values)
            if chosen == "gmsh:physical":
                sets.pop("0", None)  # in no group
            part.sets = {called.get((tags[n], block.dim), n): m for n, m in sets.items()}
            part.tags = {called.get((tag, block.dim), n): tag for n, tag in tags.items()}
        for name, members in mesh.cell_sets.items():
            own = members[i] if name != "gmsh:bounding_entities" else None
            if own is not None and len(own) and name not in part.sets:
                part.sets[name] = np.asarray(own, dtype=np.int64)
        part.data = {name: shaped(values[here]) for name, values in data.items()}
        parts.append(part)
    if suffix == ".msh":
        parts = _only_in_groups(file.name, parts, tdim, called)
    point_sets = {
        name: np.asarray(m, dtype=np.int64) for name, m in mesh.point_sets.items() if len(m)
    }
    point_data = {
        name: shaped(np.asarray(values))
        for name, values in mesh.point_data.items()
        if np.asarray(values).dtype.kind in "iufb" and name != "gmsh:dim_tags"
    }
    points = np.asarray(mesh.points, dtype=np.float64)
    return assemble(file.name, points, parts, point_sets, point_data, gdim)


def _names(mesh: Any) -> dict[str, Any]:
    return {name: value for name, value in mesh.field_data.items() if np.size(value) == 2}


def _only_in_groups(
    source: str, parts: list[Part], tdim: int, called: dict[tuple[int, int], str]
) -> list[Part]:
    """Drop cells of no physical group, as gmsh does, unless there are no groups at all."""
    cells = [part for part in parts if part.dim == tdim]
    if not any(part.sets for part in cells):
        names = [name for (_, dim), name in called.items() if dim == tdim]
        if names:
            raise ValueError(
                f"{source}: it names '{names[0]}', and says of no cell what it is called, as "
                "meshio's version 4.1 does: write it with file_format='gmsh22'."
            )
        return parts
    for part in cells:
        named = np.zeros(len(part.nodes), dtype=bool)
        for members in part.sets.values():
            named[members] = True
        new = np.cumsum(named) - 1
        part.nodes = part.nodes[named]
        part.sets = {name: new[members] for name, members in part.sets.items()}
        part.data = {name: values[named] for name, values in part.data.items()}
    return parts
