# SPDX-License-Identifier: MIT
"""gmsh's .msh: by gmsh, or by meshio what gmsh cannot tell."""

import re
from mmap import ACCESS_READ, mmap
from pathlib import Path

from ._gmsh import extract
from ._grid import Grid
from ._meshio import read_meshio
from ._session import gmsh, merge, session

__all__ = ["read_msh", "unreadable"]


def read_msh(file: Path, gdim: int | None) -> Grid:
    """Read a .msh by gmsh; by meshio what gmsh cannot tell.

    Of a file of version 2 gmsh knows to which groups an entity belongs, and not which element to
    which of them, and drops elements of negative ones. In one of meshio's version 4.1 it misses the
    entities.
    """
    with file.open("rb") as stream:
        found = re.match(rb"\s*\$MeshFormat\s+(\d)", stream.read(200))
    version = int(found[1]) if found else 1
    with session():
        try:
            merge(str(file))
        except Exception as error:  # gmsh raises bare Exceptions
            if "Unknown entity" in str(error) and version > 3:
                return read_meshio(file, gdim)
            raise unreadable(file, error) from None
        _check_names(file)
        if version == 2 and _number_of_elements(file) != sum(
            len(numbers) for numbers in gmsh.model.mesh.getElements()[1]
        ):
            return read_meshio(file, gdim)
        if version < 4:
            for dim in 1, 2, 3:
                groups: dict[int, str] = {}
                for _, tag in gmsh.model.getPhysicalGroups(dim):
                    name = gmsh.model.getPhysicalName(dim, tag) or str(tag)
                    for entity in gmsh.model.getEntitiesForPhysicalGroup(dim, tag):
                        other = groups.setdefault(entity, name)
                        if other == name:
                            continue
                        if version == 2:
                            return read_meshio(file, gdim)
                        raise ValueError(
                            f"{file.name}: entity {entity} of dimension {dim} is in both '{other}' "
                            f"and '{name}', and a file of version {version} is not read then: "
                            "write it again as version 4."
                        )
        return extract(file.name, gdim)


def _number_of_elements(file: Path) -> int:
    """What a .msh of version 2 says that it holds."""
    with file.open("rb") as stream, mmap(stream.fileno(), 0, access=ACCESS_READ) as text:
        at = text.find(b"$Elements")
        return int(text[at + 9 : at + 40].split()[0]) if at >= 0 else 0


def _check_names(file: Path) -> None:
    """Refuse names that gmsh drops: of two groups alike, and of cells where none is in a group."""
    with file.open("rb") as stream:
        head = stream.read(2**20).decode(errors="replace")
    section = re.search(r"\$PhysicalNames(.*?)\$EndPhysicalNames", head, re.DOTALL)
    rows = re.findall(r'(\d+)\s+(-?\d+)\s+"(.*)"', section[1]) if section else []
    named: dict[tuple[int, str], int] = {}
    for dim, tag, name in rows:
        if named.setdefault((int(dim), name), int(tag)) != int(tag):
            raise ValueError(
                f"{file.name}: two physical groups of dimension {dim} are named '{name}': rename "
                "one."
            )
    tdim = gmsh.model.getDimension()
    names = [name for dim, name in named if dim == tdim]
    if names and tdim > 1 and not gmsh.model.getPhysicalGroups(tdim):
        raise ValueError(
            f"{file.name}: it names '{names[0]}', and says of no cell what it is called, as "
            "meshio's version 4.1 does: write it with file_format='gmsh22'."
        )


def unreadable(file: Path, error: Exception) -> ValueError:
    return ValueError(
        f"{file.name}: gmsh cannot read it ({error}): it may be truncated or no "
        f"{file.suffix.lower()} at all, write it again."
    )
