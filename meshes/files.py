# SPDX-License-Identifier: MIT
"""Bodies from files: gmsh's meshes and scripts, CAD, surfaces of triangles, XDMF, VTK, Abaqus."""

import re
import warnings
from math import pi, sqrt
from os import PathLike
from pathlib import Path

from mpi4py import MPI

import numpy as np

from ._abaqus import read_abaqus
from ._arguments import check_order, check_positive
from ._gmsh import extract, generate, name_entities, require_groups, set_size
from ._grid import Grid
from ._meshio import read_meshio
from ._msh import read_msh, unreadable
from ._session import gmsh, merge, session
from ._xdmf import read_xdmf
from .body import Body, distribute

__all__ = ["read"]

CAD = (".step", ".stp", ".brep", ".iges", ".igs")
MESHES = (".msh", ".xdmf", ".vtu", ".vtk", ".inp")
SUFFIXES = (*MESHES, ".geo", *CAD, ".stl")

# Angle [rad] between neighboring triangles of an .stl above which there is an edge between faces.
STL_EDGE = 40 * pi / 180


def read(
    comm: MPI.Comm,
    path: str | PathLike[str],
    *,
    h: float | None = None,
    order: int | None = None,
    gdim: int | None = None,
    scale: float = 1.0,
) -> Body:
    """Read a body from a file, on rank 0, and distribute it. Collective.

    Names of regions and boundaries:
        .msh, .geo: those of the physical groups; a group without a name is called by its number.
            As in gmsh's own files, only what is in a physical group belongs to the mesh; if no
            group holds cells and there is one surface or volume, it is the region body.
        .step, .stp, .brep, .iges, .igs: volume1, volume2, … and face1, face2, … by gmsh's numbers,
            as its window shows them, or what gmsh knows the faces to be called; of a file with
            faces only, face1, … and edge1, ….
        .stl: volume1 and face2, face3, … likewise: its surface is cut along edges of more than 40
            degrees, and further where a face would not unroll into the plane.
        .inp: those of the sets of elements, surfaces and sets of nodes, the latter for the facets
            of the body's surface whose vertices are all in it.
        .xdmf, .vtu, .vtk: the tags, as "1", "2", …. Tags are whole numbers, one per cell, called
            gmsh:physical, cell_tags, regions, materials, … or the only ones of an integer type.
        Cells that have none are the region body. Names may overlap.

    Data of cells and points, which are not tags, are functions in `body.data`: attributes of an
    .xdmf, data of a .vtu and .vtk, $ElementData and $NodeData of a .msh; of several steps the last.

    Args:
        comm: Communicator of the mesh.
        path: The file, with one of the suffixes above.
        h: Edge length of the cells in the file's unit, where gmsh makes the mesh. None: what a .geo
            itself asks for; of other geometry 1/20 of the diagonal of its bounding box.
        order: Polynomial order of the geometry, 1 or 2. None: the file's own, 1 for CAD and .stl.
        gdim: Dimension of space, 2 or 3. None: 2 for a mesh of surfaces with z = 0, else 3.
        scale: Factor on all coordinates: 1e-3 turns mm into m. CAD files are read in mm, whatever
            unit they are written in. Data are taken as they are.

    Returns:
        The body.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: A suffix, an argument, or a file's content that makes no body.
        ImportError: No gmsh, meshio or h5py, where one of them reads the file.
    """
    file = Path(path)
    suffix = file.suffix.lower()
    if suffix not in SUFFIXES:
        raise ValueError(
            f"{file.name}: read knows the suffixes {', '.join(SUFFIXES)}, got {suffix!r}: convert "
            "the file, with gmsh or meshio say."
        )
    check_positive(h=h, scale=scale)
    if order is not None:
        check_order(order)
    if gdim not in (None, 2, 3):
        raise ValueError(f"gdim must be 2, 3 or None, got gdim={gdim}.")
    if h is not None and suffix in MESHES:
        raise ValueError(
            f"{file.name} is a mesh already, got h={h}: leave h out, or read the geometry."
        )

    def make() -> Grid:
        if not file.is_file():
            raise FileNotFoundError(f"no file '{file}' in '{Path.cwd()}': check the path.")
        readers = {".xdmf": read_xdmf, ".inp": read_abaqus}
        readers |= {".vtu": read_meshio, ".vtk": read_meshio, ".msh": read_msh}
        if suffix in readers:
            grid = readers[suffix](file, gdim)
        else:
            grid = _read_gmsh(file, h, order, gdim)
        if order is not None and grid.order != order:
            raise ValueError(
                f"{file.name}: a mesh of order {grid.order} cannot be read with order={order}: "
                "leave order out, or mesh the geometry again."
            )
        grid.points = scale * grid.points
        return grid

    return distribute(comm, make)


def _read_gmsh(file: Path, h: float | None, order: int | None, gdim: int | None) -> Grid:
    suffix = file.suffix.lower()
    if suffix == ".geo":
        _check_last_line(file)
    with session():
        try:
            merge(str(file))
        except Exception as error:  # gmsh raises bare Exceptions
            raise unreadable(file, error) from None
        if suffix == ".geo":
            _mesh_script(file.name, h, order)
        elif suffix == ".stl":
            _fill_surface(file)
        elif suffix in CAD:
            _join_solids()
        if suffix == ".stl" or suffix in CAD:
            dim = _name_by_number(file)
            x0, y0, z0, x1, y1, z1 = gmsh.model.getBoundingBox(-1, -1)
            set_size(h or sqrt((x1 - x0) ** 2 + (y1 - y0) ** 2 + (z1 - z0) ** 2) / 20)
            _mesh(file.name, dim, order or 1)
        return extract(file.name, gdim)


def _mesh(source: str, dim: int, order: int) -> None:
    try:
        generate(dim, order)
    except Exception as error:  # gmsh raises bare Exceptions
        raise ValueError(
            f"{source}: gmsh cannot mesh it ({error}): mend the geometry, or try another h."
        ) from None


def _check_last_line(file: Path) -> None:
    """Gmsh skips, without a word, a script's last line if no newline ends it."""
    last = file.read_bytes().rpartition(b"\n")[2].strip()
    if last and not last.startswith(b"//"):
        raise ValueError(
            f"{file.name}: its last line {last.decode(errors='replace')[-40:]!r} has no newline at "
            "the end, and gmsh would skip it: add one."
        )


def _mesh_script(source: str, h: float | None, order: int | None) -> None:
    """Mesh what a .geo describes, unless it has done so itself."""
    dim = gmsh.model.getDimension()
    if dim < 2:
        raise ValueError(f"{source}: no surface and no volume: a body needs cells.")
    require_groups(source, dim)
    if not len(gmsh.model.mesh.getElementTypes(dim)):
        if h is not None:
            gmsh.option.setNumber("Mesh.MeshSizeMax", h)
        _mesh(source, dim, order or int(gmsh.option.getNumber("Mesh.ElementOrder")))


def _fill_surface(file: Path) -> None:
    """Cut a closed surface of triangles into faces and make the volume inside."""
    mesh = gmsh.model.mesh
    mesh.removeDuplicateNodes()
    _, _, nodes = mesh.getElements(2)
    triangles = np.concatenate([n.reshape(-1, 3) for n in nodes] or [np.empty((0, 3))])
    if not len(triangles):
        raise ValueError(f"{file.name}: no triangles in it: it may be truncated, write it again.")
    edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    _, counts = np.unique(edges, axis=0, return_counts=True)
    if (counts != 2).any():
        raise ValueError(
            f"{file.name}: {(counts != 2).sum()} edges of its {len(triangles)} triangles do not "
            "join two of them: a body needs a closed surface, so fill the holes or write it again."
        )
    # First whole faces; where one cannot be unrolled (a sphere), again with faces cut further.
    for cut in False, True:
        try:
            mesh.classifySurfaces(STL_EDGE, True, cut, pi)
            mesh.createGeometry()
            break
        except Exception as error:  # gmsh raises bare Exceptions
            if cut:
                raise ValueError(
                    f"{file.name}: gmsh finds no faces on it ({error}): mend it, or make it finer."
                ) from None
            gmsh.model.remove()
            gmsh.model.add(file.name)
            gmsh.merge(str(file))
            mesh.removeDuplicateNodes()
    loop = gmsh.model.geo.addSurfaceLoop([face for _, face in gmsh.model.getEntities(2)])
    gmsh.model.geo.addVolume([loop])
    gmsh.model.geo.synchronize()


def _join_solids() -> None:
    """Let solids that touch share their faces: CAD files give each its own."""
    solids = gmsh.model.getEntities(3)
    if len(solids) > 1:
        gmsh.model.occ.fragment(solids, [])
        gmsh.model.occ.synchronize()


def _name_by_number(file: Path) -> int:
    """Name volumes and faces, or else faces and edges, by gmsh's numbers; the cells' dimension.

    Faces are called as gmsh knows them to be called, if it does.
    """
    dim = gmsh.model.getDimension()
    if dim < 2:
        raise ValueError(
            f"{file.name}: no volume and no face in it: it may be truncated, write it again."
        )
    kinds = {3: "volume", 2: "face", 1: "edge"}
    cells = [tag for _, tag in gmsh.model.getEntities(dim)]
    sides = [tag for _, tag in gmsh.model.getBoundary([(dim, c) for c in cells], False, False)]
    name_entities(dim, {f"{kinds[dim]}{tag}": [tag] for tag in cells})
    names: dict[str, list[int]] = {}
    called = 0
    for tag in sorted(set(sides)):
        name = gmsh.model.getEntityName(2, tag).rpartition("/")[2] if dim == 3 else ""
        called += bool(name)
        names.setdefault(name or f"{kinds[dim - 1]}{tag}", []).append(tag)
    name_entities(dim - 1, names)
    if dim == 3 and not called and file.suffix.lower() in (".step", ".stp"):
        _warn_of_lost_names(file)
    return dim


def _warn_of_lost_names(file: Path) -> None:
    """Say which names of faces gmsh has not read, and how to give them again."""
    text = file.read_text(encoding="utf-8", errors="replace")
    found = re.findall(r"ADVANCED_FACE\s*\(\s*'((?:[^']|'')*)'", text)
    lost = [name for name in dict.fromkeys(found) if name.strip() and name.upper() != "NONE"]
    if lost:
        shown = ", ".join(f"'{name}'" for name in lost[:5]) + (", …" if len(lost) > 5 else "")
        warnings.warn(
            f"{file.name}: gmsh does not read the names of its faces ({shown}), which have their "
            "numbers here: to keep names, look up the numbers in gmsh's window and read a "
            f'.geo of the lines Merge "{file.name}"; Physical Volume("body") = {{1}}; '
            f'Physical Surface("{lost[0]}") = {{3}}; and so on.',
            stacklevel=2,
        )
