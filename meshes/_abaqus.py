# SPDX-License-Identifier: MIT
"""Abaqus' .inp: nodes, elements, and sets of both, to arrays."""

# Not by meshio, which gives a set that stands in an *ELEMENT to the block of the same number.

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ._dolfinx import from_vtk_order
from ._grid import Grid
from ._parts import Part, assemble

__all__ = ["read_abaqus"]

SOLIDS = {4: "tetrahedron", 10: "tetrahedron", 8: "hexahedron"}
FLAT = {3: "triangle", 6: "triangle", 65: "triangle", 4: "quadrilateral", 9: "quadrilateral"}
LINES = {"T2D2": 2, "T3D2": 2, "B21": 2, "B31": 2, "T2D3": 3, "T3D3": 3, "B22": 3, "B32": 3}

# Vertices of the faces S1, S2, …, which are edges in the plane.
FACES = {
    "triangle": ((0, 1), (1, 2), (2, 0)),
    "quadrilateral": ((0, 1), (1, 2), (2, 3), (3, 0)),
    "tetrahedron": ((0, 1, 2), (0, 3, 1), (1, 3, 2), (2, 3, 0)),
    "hexahedron": (
        *((0, 1, 2, 3), (4, 7, 6, 5), (0, 4, 5, 1)),
        *((1, 5, 6, 2), (2, 6, 7, 3), (3, 7, 4, 0)),
    ),
}
FACE_CELLS = {"triangle": "interval", "quadrilateral": "interval"}
FACE_CELLS |= {"tetrahedron": "triangle", "hexahedron": "quadrilateral"}

Block = tuple[str, dict[str, str], list[str]]


def read_abaqus(file: Path, gdim: int | None) -> Grid:
    """Read the mesh and its sets on this process alone.

    Sets of elements are regions, those of edges or faces boundaries, as are surfaces of elements;
    sets of nodes are boundaries of the facets whose vertices are all in it.

    Raises:
        ValueError: A file that is truncated, of several parts, or that holds no mesh.
    """
    source = file.name
    try:
        return _Model(source, _blocks(file)).grid(gdim)
    except (KeyError, IndexError, UnicodeError) as error:
        raise ValueError(
            f"{source}: it refers to {error}, which is not in it: it may be truncated, write it "
            "again."
        ) from None
    except ValueError as error:
        if str(error).startswith(source):
            raise
        raise ValueError(
            f"{source}: {error}: it may be truncated or no .inp at all, write it again."
        ) from None


def _blocks(file: Path, depth: int = 0) -> Iterator[Block]:
    """Keyword, parameters and lines of data of each block; included files in their place."""
    block: Block | None = None
    head = ""
    for line in file.read_text(encoding="utf-8", errors="replace").splitlines():
        line = line.strip()
        if not line or line.startswith("**"):
            continue
        if line.startswith("*") or head:
            head += line
            if head.endswith(","):
                continue
            if block:
                yield block
            block = _keyword(head)
            head = ""
            if block[0] == "INCLUDE":
                name = block[1].get("INPUT", "")
                if depth > 8 or not (file.parent / name).is_file():
                    raise ValueError(f"it includes '{name}', which is not beside it")
                yield from _blocks(file.parent / name, depth + 1)
                block = None
        elif block:
            block[2].append(line)
    if block:
        yield block


def _keyword(head: str) -> Block:
    word, *rest = (part.strip() for part in head.lstrip("*").split(","))
    parameters = {}
    for part in rest:
        key, _, value = part.partition("=")
        parameters[key.strip().upper()] = value.strip().strip('"')
    return " ".join(word.upper().split()), parameters, []


class _Model:
    """What the blocks have told so far."""

    def __init__(self, source: str, blocks: Iterator[Block]) -> None:
        self.source = source
        self.nodes: dict[int, list[float]] = {}
        self.elements: list[tuple[str, NDArray[np.int64]]] = []
        self.node_sets: dict[str, list[int]] = {}
        self.element_sets: dict[str, list[int]] = {}
        self.surfaces: dict[str, list[tuple[str, str]]] = {}
        self.spelled: dict[str, str] = {}
        parts, assembly, instance = 0, False, False
        for word, parameters, lines in blocks:
            parts += word in ("PART", "INSTANCE") and not (word == "INSTANCE" and parts == 1)
            assembly = word == "ASSEMBLY" or (assembly and word != "END ASSEMBLY")
            instance = word == "INSTANCE" or (instance and word != "END INSTANCE")
            if parts > 1 or (word == "INSTANCE" and lines):
                raise ValueError(
                    f"{source}: it has several parts, or one that is moved: write a flat input "
                    "file of one part."
                )
            # Nodes of the assembly itself are reference points, with numbers of their own.
            if not (assembly and not instance and word in ("NODE", "ELEMENT")):
                self.take(word, parameters, lines)

    def take(self, word: str, parameters: dict[str, str], lines: list[str]) -> None:
        if word == "NODE":
            found = []
            for line in lines:
                number, *x = line.rstrip(",").split(",")
                self.nodes[int(number)] = [float(c) for c in x[:3]]
                found.append(int(number))
            if "NSET" in parameters:
                self.add(self.node_sets, parameters["NSET"], found)
        elif word == "ELEMENT":
            self.take_elements(parameters, lines)
        elif word in ("NSET", "ELSET"):
            sets = self.node_sets if word == "NSET" else self.element_sets
            name = parameters.get(word, "")
            items = [item.strip() for line in lines for item in line.split(",") if item.strip()]
            members: list[int] = []
            if "GENERATE" in parameters:
                for line in lines:
                    numbers = [int(n) for n in line.rstrip(",").split(",")]
                    members += range(numbers[0], numbers[1] + 1, *numbers[2:])
            else:
                for item in items:
                    item = item.rpartition(".")[2]  # instance.number
                    members += [int(item)] if item.isdigit() else sets[item.upper().strip('"')]
            self.add(sets, name, members)
        elif word == "SURFACE" and parameters.get("TYPE", "ELEMENT").upper() == "ELEMENT":
            name = parameters.get("NAME", "")
            self.spelled.setdefault(name.upper(), name)
            for line in lines:
                of, side, *_ = [item.strip() for item in line.split(",")] + ["", ""]
                self.surfaces.setdefault(name.upper(), []).append((of, side.upper()))

    def add(self, sets: dict[str, list[int]], name: str, members: list[int]) -> None:
        self.spelled.setdefault(name.upper(), name)
        sets.setdefault(name.upper(), []).extend(members)

    def take_elements(self, parameters: dict[str, str], lines: list[str]) -> None:
        kind = parameters.get("TYPE", "").upper()
        if match := re.match(r"(?:DC|AC|C)3D(\d+)", kind):
            number = int(match[1])
            cell = SOLIDS.get(number, "")
        elif kind in LINES:
            cell, number = "interval", LINES[kind]
        elif match := re.match(r"[A-Z]+(?:2D|3D)?(\d+)", kind):
            number = {65: 6}.get(int(match[1]), int(match[1]))
            cell = FLAT.get(number, "")
        else:
            cell = ""
        if not cell:
            raise ValueError(
                f"{self.source}: elements of the type '{kind}': a body needs one type, of "
                "triangles, quadrilaterals, tetrahedra or hexahedra of order 1 or 2."
            )
        flat = [int(n) for line in lines for n in line.split(",") if n.strip()]
        if len(flat) % (number + 1):
            raise ValueError(f"the last element of type {kind} is not whole")
        rows = np.array(flat, dtype=np.int64).reshape(-1, number + 1)
        self.elements.append((cell, rows))
        if "ELSET" in parameters:
            self.add(self.element_sets, parameters["ELSET"], [int(n) for n in rows[:, 0]])

    def grid(self, gdim: int | None) -> Grid:
        if not self.nodes or not self.elements:
            raise ValueError("it has no nodes or no elements")
        index = {number: i for i, number in enumerate(self.nodes)}
        width = max(len(x) for x in self.nodes.values())
        points = np.array([x + (width - len(x)) * [0.0] for x in self.nodes.values()])
        where: dict[int, tuple[int, int]] = {}
        parts: list[Part] = []
        labels = []
        sets: list[dict[str, list[int]]] = [{} for _ in self.elements]
        for cell, rows in self.elements:
            nodes = np.array([[index[int(n)] for n in row] for row in rows[:, 1:]])
            for i, number in enumerate(int(n) for n in rows[:, 0]):
                if where.setdefault(number, (len(parts), i)) != (len(parts), i):
                    raise ValueError(f"{self.source}: two elements have the number {number}.")
            parts.append(Part(cell, cell, nodes))
            labels.append(rows[:, 0])
        for name, members in self.element_sets.items():
            for number in members:
                block, i = where[number]
                sets[block].setdefault(self.spelled[name], []).append(i)
        for part, own in zip(parts, sets, strict=True):
            part.sets = {name: np.unique(those) for name, those in own.items()}
        surfaces = self.find_surfaces(parts, where)
        tdim = max(part.dim for part in parts)
        numbers = np.concatenate([n for n, p in zip(labels, parts, strict=True) if p.dim == tdim])
        for part in parts:
            part.nodes = part.nodes[:, from_vtk_order(part.cell, part.nodes.shape[1])]
        node_sets = {
            self.spelled[name]: np.array([index[n] for n in members], dtype=np.int64)
            for name, members in self.node_sets.items()
            if members
        }
        return assemble(self.source, points, [*parts, *surfaces], node_sets, None, gdim, numbers)

    def find_surfaces(self, parts: list[Part], where: dict[int, tuple[int, int]]) -> list[Part]:
        """Facets of the surfaces of elements, nodes still in Abaqus' order."""
        rows: dict[str, list[NDArray[np.int64]]] = {}
        sets: dict[str, dict[str, list[int]]] = {}
        for name, pieces in self.surfaces.items():
            for of, side in pieces:
                of = of.rpartition(".")[2]
                members = [int(of)] if of.isdigit() else self.element_sets[of.upper()]
                for number in members:
                    block, i = where[number]
                    cell = parts[block].cell
                    if not re.fullmatch(r"[SE]\d", side):
                        continue  # the side of a shell, or the whole outside: no facets
                    corners = list(FACES[cell][int(side[1]) - 1])
                    those = rows.setdefault(FACE_CELLS[cell], [])
                    own = sets.setdefault(FACE_CELLS[cell], {})
                    own.setdefault(self.spelled[name], []).append(len(those))
                    those.append(parts[block].nodes[i, corners])
        return [
            Part("surface", cell, np.array(rows[cell]), {n: np.array(m) for n, m in own.items()})
            for cell, own in sets.items()
        ]
