# SPDX-License-Identifier: MIT
"""A whole mesh as arrays on one process, and the checks on it."""

from dataclasses import dataclass, field

import basix
import numpy as np
from numpy.typing import NDArray

from ._dolfinx import coordinate_element
from ._groups import Tag, check_held, row_keys

__all__ = ["Grid"]

# Relative size below which a Jacobian determinant counts as zero: det J against the product of the
# lengths of J's columns, a number between 0 and 1 that does not depend on units.
DEGENERATE = 1e-10

# Facets that are looked at together: what they take does not grow with the mesh.
CHUNK = 2**15


@dataclass
class Grid:
    """Points, cells and tagged facets on one process, nodes in DOLFINx's order.

    Attributes:
        source: What the messages call it: a file's name or a function's.
        cell: DOLFINx's name of the cell type.
        order: Polynomial order of the geometry.
        gdim: Dimension of the space the body lies in, 2 or 3.
        points: Coordinates, shape (N, 3).
        cells: Nodes of each cell, shape (number of cells, nodes per cell); no cell comes twice.
        regions: Tag of each cell.
        facets: Nodes of each tagged facet, of which the vertices come first; each facet once.
        boundaries: Tag of each of these facets.
        region_names: Tag, or tags, of each region's name.
        boundary_names: Tag, or tags, of each boundary's name.
        labels: Number that the source gives to each cell; empty: count from 0.
        cell_data: Values of the cells by name, shape (number of cells, …).
        point_data: Values of the points by name, shape (N, …).
    """

    source: str
    cell: str
    order: int
    gdim: int
    points: NDArray[np.float64]
    cells: NDArray[np.int64]
    regions: NDArray[np.int32]
    facets: NDArray[np.int64]
    boundaries: NDArray[np.int32]
    region_names: dict[str, Tag]
    boundary_names: dict[str, Tag]
    labels: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))
    cell_data: dict[str, NDArray[np.float64]] = field(default_factory=dict)
    point_data: dict[str, NDArray[np.float64]] = field(default_factory=dict)

    @classmethod
    def empty(cls, cell: str, order: int, gdim: int, cell_nodes: int, facet_nodes: int) -> "Grid":
        """What the ranks without the mesh hold."""
        tags = np.empty(0, np.int32)
        cells, facets = (np.empty((0, n), np.int64) for n in (cell_nodes, facet_nodes))
        return cls("", cell, order, gdim, np.empty((0, 3)), cells, tags, facets, tags, {}, {})

    @property
    def facet_cell(self) -> str:
        """DOLFINx's name of the facets' type."""
        return basix.cell.subentity_types(self._cell_type)[self.tdim - 1][0].name

    @property
    def facet_corners(self) -> int:
        """Number of a facet's vertices."""
        return len(basix.topology(self._cell_type)[self.tdim - 1][0])

    @property
    def tdim(self) -> int:
        """Dimension of the cells."""
        return len(basix.topology(self._cell_type)) - 1

    @property
    def _cell_type(self) -> basix.CellType:
        return basix.CellType[self.cell]

    def _facets_of_cells(self) -> NDArray[np.int32]:
        """Vertices of each cell's facets, ascending: all cells' first, then all second, ….

        Shape (facets of a cell x number of cells, vertices of a facet).
        """
        corners = basix.topology(self._cell_type)[self.tdim - 1]
        # 32 bits: there are four of them for each cell, and rank 0 holds all.
        cells = self.cells.astype(np.int32)
        rows = np.concatenate([cells[:, c] for c in corners])
        rows.sort(axis=1)
        return rows

    def exterior_facets(self) -> NDArray[np.int64]:
        """Vertices of the facets that belong to one cell only."""
        rows = self._facets_of_cells()
        _, first, counts = np.unique(row_keys(rows), return_index=True, return_counts=True)
        return rows[first[counts == 1]].astype(np.int64)

    def check(self) -> None:
        """Refuse a mesh on which an energy would be wrong without a word, and drop unused points.

        Raises:
            ValueError: A name without members, a named facet that no cell has, a facet of three
                cells, a cell that is degenerate, turned inside out or folded over its neighbor.
        """
        check_held(self.source, "region", self.regions, self.region_names)
        check_held(self.source, "boundary", self.boundaries, self.boundary_names)
        rows = self._facets_of_cells()
        order, same = self._complete_facets(rows)
        self._check_shape()
        if self.gdim == self.tdim:
            self._check_folds(rows, order, same)
        self._drop_unused_points()

    def _drop_unused_points(self) -> None:
        used = np.zeros(len(self.points), dtype=bool)
        used[self.cells] = True
        if used.all():
            return
        new = np.cumsum(used) - 1
        self.points, self.cells, self.facets = self.points[used], new[self.cells], new[self.facets]
        self.point_data = {name: values[used] for name, values in self.point_data.items()}

    def _complete_facets(
        self, rows: NDArray[np.int32]
    ) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Add the nodes that are no vertices; refuse facets of no cell: they would vanish.

        Returns:
            The order that sorts the cells' facets, so that the same ones are neighbors, and
            whether each in that order is the same as the next.
        """
        number = len(self.facets)
        keys = row_keys(np.concatenate([rows, self.facets]) if number else rows)
        keys, named = keys[: len(rows)], keys[len(rows) :]
        order = np.argsort(keys, kind="stable")
        keys = keys[order]
        place = np.minimum(np.searchsorted(keys, named), len(keys) - 1)
        found, loose = order[place], keys[place] != named
        for name, tag in self.boundary_names.items():
            mine = np.isin(self.boundaries, tag)
            if (loose & mine).any():
                raise ValueError(
                    f"{self.source}: {(loose & mine).sum()} of {mine.sum()} facets of '{name}' are "
                    "no facets of its cells: put these into another group, or add their cells."
                )
        element = coordinate_element(self.cell, self.order, self.gdim).basix_element
        closure = np.array(element.entity_closure_dofs[self.tdim - 1])
        cell, side = found % len(self.cells), found // len(self.cells)
        self.facets = self.cells[cell[:, None], closure[side]]
        return order, keys[1:] == keys[:-1]

    def relative_jacobians(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Smallest and largest det J / (product of J's column lengths) in each cell.

        Sampled at the points of a lattice of twice the polynomial degree of det J.  Of a surface
        in space the root of det(J^T J) stands for det J.
        """
        tdim, lattice = self.tdim, max(1, self.tdim * self.order)
        points = basix.create_lattice(self._cell_type, lattice, basix.LatticeType.equispaced, True)
        element = coordinate_element(self.cell, self.order, self.gdim).basix_element
        gradients = element.tabulate(1, points)[1:, :, :, 0]
        if self.order == 1 and self.cell in ("triangle", "tetrahedron"):
            gradients = gradients[:, :1]
        low, high = np.empty(len(self.cells)), np.empty(len(self.cells))
        for start in range(0, len(self.cells), 4096):
            chunk = slice(start, start + 4096)
            x = self.points[self.cells[chunk], : self.gdim]
            J = np.einsum("tqn,cni->cqit", gradients, x)
            if self.gdim == tdim:
                det = np.linalg.det(J)
            else:
                det = np.sqrt(np.maximum(np.linalg.det(np.swapaxes(J, 2, 3) @ J), 0))
            scale = np.prod(np.linalg.norm(J, axis=2), axis=2)
            relative = np.divide(det, scale, out=np.zeros_like(det), where=scale > 0)
            low[chunk], high[chunk] = relative.min(axis=1), relative.max(axis=1)
        return low, high

    def _check_shape(self) -> None:
        if not np.isfinite(self.points).all():
            raise ValueError(f"{self.source}: some coordinates are not finite numbers.")
        low, high = self.relative_jacobians()
        # Only a change of sign counts: DOLFINx takes |det J|, so cells numbered clockwise are fine.
        flat = (low <= DEGENERATE) & (high >= -DEGENERATE)
        if flat.any():
            raise ValueError(
                f"{self.source}: {flat.sum()} of {len(flat)} cells are degenerate or turned inside "
                f"out (det J <= 0), the first is number {self._label(np.flatnonzero(flat)[0])}: "
                "refine the mesh there, or take order 1."
            )

    def _check_folds(
        self, rows: NDArray[np.int32], order: NDArray[np.int64], same: NDArray[np.bool_]
    ) -> None:
        """Refuse neighbors on the same side of their common facet, however they are numbered."""
        x = self.points[:, : self.gdim]
        if (same[1:] & same[:-1]).any():
            number = (same[1:] & same[:-1]).sum()
            raise ValueError(
                f"{self.source}: {number} facets belong to three cells or more: cells overlap, "
                "remove the surplus ones."
            )
        one, two = order[:-1][same], order[1:][same]
        cells = one % len(self.cells), two % len(self.cells)
        vertices = self.cells[:, : len(basix.topology(self._cell_type)[0])]
        folded = np.empty(len(one), dtype=bool)
        for start in range(0, len(one), CHUNK):
            chunk = slice(start, start + CHUNK)
            p = x[rows[one[chunk]]]
            normal: NDArray[np.floating] = p[:, 1] - p[:, 0]
            if self.gdim == 3:
                normal = np.cross(normal, p[:, 2] - p[:, 0])
            else:
                normal = normal[:, ::-1] * [1, -1]
            center = p.mean(axis=1)
            middles = (x[vertices[k[chunk]]].mean(axis=1) for k in cells)
            sides = [np.sum(normal * (middle - center), axis=1) for middle in middles]
            folded[chunk] = sides[0] * sides[1] > 0
        if folded.any():
            count = np.zeros((2, len(self.cells)), dtype=int)
            for k in cells:
                np.add.at(count[0], k, 1)
                np.add.at(count[1], k[folded], 1)
            bad = 2 * count[1] > count[0]
            first = np.flatnonzero(bad if bad.any() else count[1])[0]
            raise ValueError(
                f"{self.source}: {max(bad.sum(), 1)} of {len(bad)} cells are inverted (folded over "
                f"their neighbors), the first is number {self._label(first)}: mesh again, or move "
                "its nodes back."
            )

    def _label(self, cell: int) -> int:
        return int(self.labels[cell]) if len(self.labels) else int(cell)
