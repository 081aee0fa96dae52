# SPDX-License-Identifier: MIT
"""A whole mesh as arrays on one process, and the checks on it."""

from collections.abc import Iterator
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

# Facets that are sorted together, and pairs of cells that are looked at together: what they take
# does not grow with the mesh.
BATCH = 2**18
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

    def _facets(self) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int32]]]:
        """The cells' facets in batches, all cells' copies of a facet in one of them.

        A batch is the facets whose smallest vertices are in a range: what is held at once does not
        grow with the mesh.

        Yields:
            Number of each facet, that of its cell plus that of its side times the number of cells,
            and its vertices, ascending.
        """
        corners = basix.topology(self._cell_type)[self.tdim - 1]
        lowest = np.concatenate([self.cells[:, c].min(axis=1).astype(np.int32) for c in corners])
        counts = np.cumsum(np.bincount(lowest, minlength=1))
        start = 0
        while start < len(counts):
            done = counts[start - 1] if start else 0
            stop = max(start + 1, int(np.searchsorted(counts, done + BATCH, side="right")))
            numbers = np.flatnonzero((lowest >= start) & (lowest < stop))
            cell, side = numbers % len(self.cells), numbers // len(self.cells)
            rows = self.cells[cell[:, None], np.array(corners)[side]].astype(np.int32)
            rows.sort(axis=1)
            yield numbers, rows
            start = stop

    def exterior_facets(self) -> NDArray[np.int64]:
        """Vertices of the facets that belong to one cell only."""
        found = [np.empty((0, self.facet_corners), np.int64)]
        for _, rows in self._facets():
            _, first, counts = np.unique(row_keys(rows), return_index=True, return_counts=True)
            found.append(rows[first[counts == 1]].astype(np.int64))
        return np.concatenate(found)

    def check(self) -> None:
        """Refuse a mesh on which an energy would be wrong without a word, and drop unused points.

        Raises:
            ValueError: A name without members, a named facet that no cell has, a facet of three
                cells, a cell that is degenerate, turned inside out or folded over its neighbor.
        """
        check_held(self.source, "region", self.regions, self.region_names)
        check_held(self.source, "boundary", self.boundaries, self.boundary_names)
        surplus, shared, folded = self._complete_facets()
        self._check_shape()
        if self.gdim == self.tdim:
            self._check_folds(surplus, shared, folded)
        self._drop_unused_points()

    def _drop_unused_points(self) -> None:
        used = np.zeros(len(self.points), dtype=bool)
        used[self.cells] = True
        if used.all():
            return
        new = np.cumsum(used) - 1
        self.points, self.cells, self.facets = self.points[used], new[self.cells], new[self.facets]
        self.point_data = {name: values[used] for name, values in self.point_data.items()}

    def _complete_facets(self) -> tuple[int, NDArray[np.int8], NDArray[np.int8]]:
        """Add the nodes that are no vertices; refuse facets of no cell: they would vanish.

        Returns:
            How many pairs of a facet's cells there are beside one each; and of each cell, how many
            facets it shares, and how many of these with a cell on the same side.
        """
        found = np.full(len(self.facets), -1, dtype=np.int64)
        lowest = self.facets.min(axis=1) if len(found) else found
        shared, folded = np.zeros((2, len(self.cells)), dtype=np.int8)
        surplus = 0
        for numbers, rows in self._facets():
            low = rows[:, 0]
            named = np.flatnonzero((lowest >= low.min()) & (lowest <= low.max()))
            keys = row_keys(np.concatenate([rows, self.facets[named]]) if len(named) else rows)
            keys, wanted = keys[: len(rows)], keys[len(rows) :]
            order = np.argsort(keys, kind="stable")
            keys = keys[order]
            place = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
            found[named] = np.where(keys[place] == wanted, numbers[order[place]], -1)
            same = keys[1:] == keys[:-1]
            surplus += int((same[1:] & same[:-1]).sum())
            one, two = order[:-1][same], order[1:][same]
            cells = numbers[one] % len(self.cells), numbers[two] % len(self.cells)
            wrong = self._same_side(rows[one], cells) if self.gdim == self.tdim else None
            for k in cells:
                np.add.at(shared, k, 1)
                if wrong is not None:
                    np.add.at(folded, k[wrong], 1)
        loose = found < 0
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
        return surplus, shared, folded

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

    def _same_side(
        self, facets: NDArray[np.int32], cells: tuple[NDArray[np.int64], NDArray[np.int64]]
    ) -> NDArray[np.bool_]:
        """Whether two cells lie on the same side of their common facet, given by its vertices."""
        x = self.points[:, : self.gdim]
        vertices = self.cells[:, : len(basix.topology(self._cell_type)[0])]
        wrong = np.empty(len(facets), dtype=bool)
        for start in range(0, len(facets), CHUNK):
            chunk = slice(start, start + CHUNK)
            p = x[facets[chunk]]
            with np.errstate(invalid="ignore", over="ignore"):  # of points that are refused later
                normal: NDArray[np.floating] = p[:, 1] - p[:, 0]
                if self.gdim == 3:
                    normal = np.cross(normal, p[:, 2] - p[:, 0])
                else:
                    normal = normal[:, ::-1] * [1, -1]
                center = p.mean(axis=1)
                middles = (x[vertices[k[chunk]]].mean(axis=1) for k in cells)
                sides = [np.sum(normal * (middle - center), axis=1) for middle in middles]
                wrong[chunk] = sides[0] * sides[1] > 0
        return wrong

    def _check_folds(
        self, surplus: int, shared: NDArray[np.int8], folded: NDArray[np.int8]
    ) -> None:
        """Refuse neighbors on the same side of their common facet, however they are numbered."""
        if surplus:
            raise ValueError(
                f"{self.source}: {surplus} facets belong to three cells or more: cells overlap, "
                "remove the surplus ones."
            )
        if folded.any():
            bad = 2 * folded > shared
            first = np.flatnonzero(bad if bad.any() else folded)[0]
            raise ValueError(
                f"{self.source}: {max(bad.sum(), 1)} of {len(bad)} cells are inverted (folded over "
                f"their neighbors), the first is number {self._label(first)}: mesh again, or move "
                "its nodes back."
            )

    def _label(self, cell: int) -> int:
        return int(self.labels[cell]) if len(self.labels) else int(cell)
