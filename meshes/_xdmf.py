# SPDX-License-Identifier: MIT
"""XDMF files, as DOLFINx, meshio and others write them, to arrays."""

import warnings
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from ._dolfinx import from_vtk_order
from ._grid import Grid
from ._groups import row_keys
from ._hdf import has_h5py, read_by_dolfinx, read_dataset
from ._parts import Part, assemble, sets_of_tags, shaped, split_tags

__all__ = ["read_xdmf"]

# XDMF's topology types: cell and number of nodes. Its numbers appear in a topology of type Mixed.
TYPES = {
    "polyline": ("interval", 2),
    "edge_3": ("interval", 3),
    "triangle": ("triangle", 3),
    "triangle_6": ("triangle", 6),
    "quadrilateral": ("quadrilateral", 4),
    "quadrilateral_9": ("quadrilateral", 9),
    "tetrahedron": ("tetrahedron", 4),
    "tetrahedron_10": ("tetrahedron", 10),
    "hexahedron": ("hexahedron", 8),
    "hexahedron_27": ("hexahedron", 27),
}
SHORT = {"tri_6": "triangle_6", "quad_9": "quadrilateral_9", "tet_10": "tetrahedron_10"}
SHORT |= {"hex_27": "hexahedron_27"}
NUMBERS = {2: "polyline", 4: "triangle", 5: "quadrilateral", 6: "tetrahedron", 9: "hexahedron"}
NUMBERS |= {34: "edge_3", 35: "quadrilateral_9", 36: "triangle_6"}
NUMBERS |= {38: "tetrahedron_10", 50: "hexahedron_27"}


# Kinds of numbers: NumPy's letter, and the bytes of each where the file does not say.
KINDS = {"int": "i", "uint": "u", "float": "f", "char": "i1", "uchar": "u1"}


def read_xdmf(file: Path, gdim: int | None) -> Grid:
    """Read the mesh, the tags of its cells and facets, and its data on this process alone.

    Of a series in time the last step's data are taken.

    Raises:
        ValueError: A file that is no XDMF, is truncated, or holds no mesh that DOLFINx can read.
        ImportError: Numbers in HDF5 that h5py would have to read, and there is none.
    """
    try:
        domain = ElementTree.parse(file).getroot().find("./Domain")
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise ValueError(
            f"{file.name}: it is no whole XML ({error}): it may be truncated, write it again."
        ) from None
    all_grids = [] if domain is None else domain.findall("./Grid")
    grids = [grid for grid in all_grids if grid.find("Topology") is not None]
    meshes = [grid for grid in grids if grid.find("Geometry") is not None]
    if not meshes:
        raise ValueError(f"{file.name}: no grid with Topology and Geometry: it holds no mesh.")
    if len(meshes) > 1 and len({_place(grid.find("Geometry")) for grid in meshes}) > 1:
        names = ", ".join(grid.get("Name", "?") for grid in meshes)
        raise ValueError(f"{file.name}: it holds {len(meshes)} meshes ({names}): write one a file.")
    series = [steps[-1] for grid in all_grids if (steps := grid.findall("./Grid"))]
    try:
        _check_hdf(file, [*grids, *series])
        if not has_h5py() and _items([*grids, *series], "HDF"):
            return assemble(file.name, *read_by_dolfinx(file, grids, series), gdim=gdim)
        points = _numbers(file, meshes[0].find("Geometry")).astype(np.float64)
        parts: list[Part] = []
        for grid in grids:
            _add(parts, _parts(file, grid))
        point_data: dict[str, NDArray[Any]] = {}
        for grid in (*grids, *series):
            nodal = _attributes(file, grid, "node", len(points))
            point_data |= {name: shaped(values) for name, values in nodal.items()}
        for grid in series:
            sizes = {len(part.nodes): part for part in parts if part.dim == parts[0].dim}
            for name, values in _attributes(file, grid, "cell").items():
                if len(values) in sizes:
                    sizes[len(values)].data[name] = shaped(values)
    except (RuntimeError, OSError, KeyError, IndexError, ValueError, TypeError) as error:
        if str(error).startswith(file.name):
            raise
        raise ValueError(f"{file.name}: {error}: it may be truncated, write it again.") from error
    return assemble(file.name, points, parts, None, point_data, gdim)


def _place(element: ElementTree.Element | None) -> str:
    item = None if element is None else element.find("DataItem")
    return "" if item is None else (item.text or "").strip()


def _items(grids: list[ElementTree.Element], form: str) -> list[ElementTree.Element]:
    return [i for grid in grids for i in grid.iter("DataItem") if i.get("Format") == form]


def _check_hdf(file: Path, grids: list[ElementTree.Element]) -> None:
    """Refuse a file whose numbers have gone: HDF5 tells it in many lines."""
    for item in _items(grids, "HDF"):
        data = (item.text or "").strip().split(":")[0]
        if not (file.parent / data).is_file():
            raise ValueError(f"its numbers are in '{data}', which is not beside it")


def _add(parts: list[Part], more: list[Part]) -> None:
    """Add the parts of a grid; cells that come again in a grid of their own give tags and data."""
    first = parts[0] if parts else None
    for part in more:
        before = [p for p in parts if p.dim == part.dim and p.sets]
        if part.sets and before:
            raise ValueError(
                f"{len(before) + 1} sets of tags of dimension {part.dim} "
                f"({', '.join(p.name for p in (*before, part))}), of which each cell needs one"
            )
        # Only the first grid may hold cells of one type in several runs.
        if first is not None and part.cell == first.cell:
            _transfer(part, first)
        else:
            parts.append(part)


def _transfer(part: Part, mesh: Part) -> None:
    """Give the tags and data of cells written a second time to the mesh's own."""
    if np.array_equal(mesh.nodes, part.nodes):  # as DOLFINx writes them
        mesh.sets |= part.sets
        mesh.tags |= part.tags
        mesh.data |= part.data
        return
    rows = np.concatenate([mesh.nodes, part.nodes])
    keys = row_keys(rows)
    order = np.argsort(keys[: len(mesh.nodes)], kind="stable")
    place = np.searchsorted(keys[: len(mesh.nodes)], keys[len(mesh.nodes) :], sorter=order)
    found = order[np.minimum(place, len(order) - 1)]
    if (keys[found] != keys[len(mesh.nodes) :]).any():
        raise ValueError(f"the grid '{part.name}' has cells that are none of '{mesh.name}'")
    mesh.sets |= {name: found[members] for name, members in part.sets.items()}
    mesh.tags |= part.tags
    for name, values in part.data.items():
        whole = np.full((len(mesh.nodes), *values.shape[1:]), np.nan)
        whole[found] = values
        mesh.data[name] = whole


def _parts(file: Path, grid: ElementTree.Element) -> list[Part]:
    """Cells and facets of one grid, with tags and data."""
    topology = grid.find("Topology")
    assert topology is not None
    name = grid.get("Name", "")
    kind = topology.get("TopologyType", topology.get("Type", "")).lower()
    kind = SHORT.get(kind, kind)
    numbers = _numbers(file, topology).astype(np.int64)
    rows: dict[str, tuple[NDArray[np.int64], NDArray[np.int64]]]
    if kind == "mixed":
        rows = _unmix(numbers.ravel())
    elif kind in TYPES:
        nodes: NDArray[Any] = numbers.reshape(-1, TYPES[kind][1])
        rows = {kind: (nodes, np.arange(len(nodes)))}
    else:
        raise ValueError(f"its topology type '{kind}' is not one of {', '.join(TYPES)}")
    total = sum(len(nodes) for nodes, _ in rows.values())
    arrays = _attributes(file, grid, "cell", total)
    chosen, data = split_tags(arrays, only=grid.find("Geometry") is None)
    found = []
    for kind, (nodes, places) in rows.items():
        cell, length = TYPES[kind]
        part = Part(name, cell, nodes[:, from_vtk_order(cell, length)])
        if chosen is not None:
            part.sets, part.tags = sets_of_tags(arrays[chosen][places])
        part.data = {key: shaped(values[places]) for key, values in data.items()}
        found.append(part)
    return found


def _unmix(flat: NDArray[np.int64]) -> dict[str, tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Nodes of each type in a topology of type Mixed, and which of all its cells these are."""
    rows: dict[str, list[NDArray[np.int64]]] = {}
    places: dict[str, list[NDArray[np.int64]]] = {}
    at = count = 0
    while at < len(flat):
        code = int(flat[at])
        if code not in NUMBERS:
            raise ValueError(f"its mixed topology has a cell of type {code}, which is not read")
        kind = NUMBERS[code]
        skip = 2 if kind == "polyline" else 1
        stride = skip + TYPES[kind][1]
        # Cells of one type usually follow each other: all of them at once.
        run = flat[at::stride] != code
        number = int(np.argmax(run)) if run.any() else len(run)
        block = flat[at : at + number * stride]
        if len(block) < number * stride:
            raise ValueError(f"its mixed topology ends within a {kind}")
        rows.setdefault(kind, []).append(block.reshape(number, stride)[:, skip:])
        places.setdefault(kind, []).append(np.arange(count, count + number))
        at, count = at + number * stride, count + number
    return {kind: (np.concatenate(rows[kind]), np.concatenate(places[kind])) for kind in rows}


def _attributes(
    file: Path, grid: ElementTree.Element, center: str, number: int | None = None
) -> dict[str, NDArray[Any]]:
    """Values of the attributes of one grid at cells or nodes, shape (number, …)."""
    found: dict[str, NDArray[Any]] = {}
    for attribute in grid.findall("Attribute"):
        if attribute.get("Center", "Node").lower() != center:
            continue
        name = attribute.get("Name", "")
        values = _numbers(file, attribute)
        if number is not None and (not values.ndim or len(values) != number):
            values = values.reshape(number, -1) if number and values.size % number == 0 else values
            if len(values) != number:
                raise ValueError(
                    f"its attribute '{name}' has {values.size} numbers for {number} {center}s"
                )
        if name in found:
            raise ValueError(f"two of its attributes are named '{name}'")
        found[name] = values
    return found


def _numbers(file: Path, parent: ElementTree.Element | None) -> NDArray[Any]:
    """Numbers of the DataItem in an element, in the shape that it states."""
    item = None if parent is None else parent.find("DataItem")
    tag = "grid" if parent is None else parent.tag
    text = None if item is None else (item.text or "").strip()
    if item is None or not text or item.find("DataItem") is not None:
        raise ValueError(f"no plain numbers in a {tag}")
    try:
        shape = [int(n) for n in item.get("Dimensions", "").split()]
    except ValueError:
        raise ValueError(f"the dimensions {item.get('Dimensions')!r} of a {tag}") from None
    word = item.get("DataType", item.get("NumberType", "Float")).lower()
    if word not in KINDS:
        raise ValueError(f"the type of number '{word}' of a {tag} is not one of {', '.join(KINDS)}")
    kind, form = KINDS[word], item.get("Format", "XML").lower()
    data: NDArray[Any]
    if form == "hdf":
        data = read_dataset(file, text)
    elif form == "binary":
        size = "" if len(kind) > 1 else item.get("Precision", "4")
        end = ">" if item.get("Endian", "").lower() == "big" else "<"
        offset = int(item.get("Seek", "0"))
        data = np.fromfile(file.parent / text, np.dtype(f"{end}{kind}{size}"), offset=offset)
    elif form == "xml":
        with warnings.catch_warnings():
            warnings.simplefilter("error", DeprecationWarning)  # what is no number
            try:
                dtype = np.float64 if kind == "f" else np.int64
                data = np.fromstring(text, dtype=dtype, sep=" ")
            except DeprecationWarning:
                raise ValueError(f"a {tag} holds other things than numbers") from None
    else:
        raise ValueError(f"the format '{form}' of a {tag} is not one of XML, HDF, Binary")
    if shape and data.size != np.prod(shape):
        raise ValueError(f"a {tag} has {data.size} numbers and not {' x '.join(map(str, shape))}")
    return data.reshape(shape or -1)
