# SPDX-License-Identifier: MIT
"""A mesh whose boundaries and regions have names."""

import ctypes
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx.fem import Function
from dolfinx.mesh import Mesh, MeshTags, exterior_facet_indices
from numpy.typing import NDArray

from ._dolfinx import coordinate_element, create_tagged_mesh
from ._fields import functions
from ._grid import Grid
from ._groups import Tag

__all__ = ["Body", "distribute"]


@dataclass(frozen=True)
class Body:
    """A mesh with named boundaries and regions.

    Constructing one is collective: every name must own at least one facet (cell) of the mesh,
    on whichever rank.

    Attributes:
        mesh: The mesh.
        cell_tags: Tags of the cells.
        facet_tags: Tags of the named facets; facets without a name carry none.
        regions: Tag of each region's name; tags, where regions overlap, one of each part.
        boundaries: Tag, or tags, of each boundary's name.
        data: Functions of what a file holds beside the mesh, by name: values of cells are piecewise
            constant, those of points continuous and piecewise linear; NaN where there was none.
        interfaces: Names of the boundaries that lie wholly inside the body, between two cells.

    Raises:
        ValueError: A region without cells, or a boundary without facets.
    """

    mesh: Mesh
    cell_tags: MeshTags
    facet_tags: MeshTags
    regions: Mapping[str, Tag]
    boundaries: Mapping[str, Tag]
    data: Mapping[str, Function] = field(default_factory=dict)
    interfaces: tuple[str, ...] = field(init=False, default=())

    def __post_init__(self) -> None:
        topology = self.mesh.topology
        topology.create_connectivity(topology.dim - 1, topology.dim)
        exterior = exterior_facet_indices(topology)
        cells = [_find(self.cell_tags, _several(tag)) for tag in self.regions.values()]
        facets = [_find(self.facet_tags, _several(tag)) for tag in self.boundaries.values()]
        local = [len(c) for c in cells] + [len(f) for f in facets]
        local += [len(np.intersect1d(f, exterior)) for f in facets]
        counts = self.mesh.comm.allreduce(np.array(local, dtype=np.int64))
        in_region, on_facets, outside = np.split(counts, np.cumsum([len(cells), len(facets)]))
        for kind, what, names, numbers in (
            ("region", "cell", self.regions, in_region),
            ("boundary", "facet", self.boundaries, on_facets),
        ):
            for name, number in zip(names, numbers, strict=True):
                if number == 0:
                    raise ValueError(
                        f"the {kind} '{name}' holds no {what} of the mesh: give the name to "
                        "others, or remove it."
                    )
        inside = [name for name, n in zip(self.boundaries, outside, strict=True) if n == 0]
        object.__setattr__(self, "interfaces", tuple(inside))

    def facets(self, *names: str) -> NDArray[np.int32]:
        """Facets of the named boundaries. Local.

        Args:
            *names: Names of boundaries; none: the whole exterior boundary.

        Returns:
            Local indices of the facets, those of ghosts included, sorted, each once.

        Raises:
            ValueError: A name that is no boundary of this body.
        """
        if not names:
            return np.sort(exterior_facet_indices(self.mesh.topology))
        tags = self._tags("boundary", self.boundaries, names)
        return _find(self.facet_tags, tags)

    def cells(self, *names: str) -> NDArray[np.int32]:
        """Cells of the named regions. Local.

        Args:
            *names: Names of regions; none: all cells.

        Returns:
            Local indices of the cells, those of ghosts included, sorted, each once.

        Raises:
            ValueError: A name that is no region of this body.
        """
        if not names:
            cell_map = self.mesh.topology.index_map(self.mesh.topology.dim)
            return np.arange(cell_map.size_local + cell_map.num_ghosts, dtype=np.int32)
        tags = self._tags("region", self.regions, names)
        return _find(self.cell_tags, tags)

    def ds(self, *names: str, **metadata: Any) -> ufl.Measure:
        """Measure on exterior facets.

        Args:
            *names: Names of boundaries; none: the whole exterior boundary.
            **metadata: Passed to UFL, as in `body.ds("top", degree=2)`.

        Returns:
            The surface measure [m^2] (in two dimensions per thickness, [m]).

        Raises:
            ValueError: A name that is no boundary of this body, or one that lies inside it.
        """
        tags = self._tags("boundary", self.boundaries, names)
        for name in names:
            if name in self.interfaces:
                raise ValueError(
                    f"the boundary '{name}' lies inside the body, where ds is zero: integrate with "
                    "ufl.Measure('dS', domain=body.mesh, subdomain_data=body.facet_tags, "
                    f"subdomain_id={self.boundaries[name]})."
                )
        return self._measure("ds", self.facet_tags, tags, metadata)

    def dx(self, *names: str, **metadata: Any) -> ufl.Measure:
        """Measure on cells.

        Args:
            *names: Names of regions; none: the whole body.
            **metadata: Passed to UFL, as in `body.dx("muscle", degree=2)`.

        Returns:
            The volume measure [m^3] (in two dimensions per thickness, [m^2]).

        Raises:
            ValueError: A name that is no region of this body.
        """
        tags = self._tags("region", self.regions, names)
        return self._measure("dx", self.cell_tags, tags, metadata)

    def _measure(
        self, kind: str, data: MeshTags, tags: tuple[int, ...], metadata: dict[str, Any]
    ) -> ufl.Measure:
        measure = ufl.Measure(kind, domain=self.mesh, subdomain_data=data)
        return measure(tags, **metadata) if tags else measure(**metadata)

    def _tags(self, kind: str, known: Mapping[str, Tag], names: tuple[str, ...]) -> tuple[int, ...]:
        for name in names:
            if name not in known:
                has = ", ".join(sorted(known)) or "none"
                raise ValueError(f'no {kind} named "{name}"; this body has: {has}.')
        return tuple(dict.fromkeys(tag for name in names for tag in _several(known[name])))


def _several(tag: Tag) -> tuple[int, ...]:
    return tag if isinstance(tag, tuple) else (tag,)


def _find(tags: MeshTags, values: tuple[int, ...]) -> NDArray[np.int32]:
    """Local cells (facets) with one of some tags, sorted, each once."""
    return np.unique(np.concatenate([tags.find(value) for value in values]))


def distribute(comm: MPI.Comm, make: Callable[[], Grid]) -> Body:
    """Make a grid on rank 0, check it there, and distribute it. Collective.

    Args:
        comm: Communicator of the mesh.
        make: Called on rank 0 only.

    Returns:
        The body. The mesh has no ghost cells.

    Raises:
        Exception: Whatever `make` or the checks raised on rank 0, raised alike on all ranks.
    """
    grid, failure = None, None
    if comm.rank == 0:
        try:
            grid = make()
            _give_back()
            grid.check()
        except Exception as error:
            failure = error
    kinds = (ValueError, FileNotFoundError, ImportError, RuntimeError)
    kind = next((k for k in kinds if isinstance(failure, k)), RuntimeError)
    told = comm.bcast((kind, str(failure)) if failure else None)
    if told:
        raise told[0](told[1]) from failure
    header = None
    if grid is not None:
        shapes = grid.cells.shape[1], grid.facets.shape[1]
        header = grid.cell, grid.order, grid.gdim, grid.region_names, grid.boundary_names, shapes
    cell, order, gdim, regions, boundaries, shapes = comm.bcast(header)
    if grid is None:
        grid = Grid.empty(cell, order, gdim, *shapes)
    cell_data, point_data = grid.cell_data, grid.point_data
    rows = grid.points[:, :gdim], grid.cells, grid.regions, grid.facets, grid.boundaries
    shares = [_share(comm, array) for array in rows]
    del grid, rows  # before DOLFINx needs memory: rank 0 goes on with its share alone
    _give_back()
    mesh, cell_tags, facet_tags = create_tagged_mesh(
        comm, coordinate_element(cell, order, gdim), *shares
    )
    data = functions(mesh, cell_data, point_data)
    return Body(mesh, cell_tags, facet_tags, regions, boundaries, data)


def _share(comm: MPI.Comm, rows: NDArray[Any]) -> NDArray[Any]:
    """This rank's part of the rows that rank 0 holds, in their order; collective."""
    number = comm.bcast(len(rows))
    starts = [number * rank // comm.size for rank in range(comm.size + 1)]
    if comm.rank == 0:
        for rank in range(1, comm.size):
            comm.Send(np.ascontiguousarray(rows[starts[rank] : starts[rank + 1]]), dest=rank)
        return rows[: starts[1]].copy()
    mine = np.empty((starts[comm.rank + 1] - starts[comm.rank], *rows.shape[1:]), rows.dtype)
    comm.Recv(mine, source=0)
    return mine


def _give_back() -> None:
    """Give memory that was freed back to the system, where glibc keeps it: gmsh's, above all."""
    with suppress(AttributeError, OSError):  # another C library
        ctypes.CDLL(None).malloc_trim(0)
