# SPDX-License-Identifier: MIT
"""Bounds of J over whole cells: are they ever wrong, how wide are they, what do they cost?

Random displacements of one cell, 100,000 for each element, from small ones to such that turn the
cell inside out, against J at a dense lattice of points: on straight and curved cells, in a meridian
plane at the axis, on surfaces in space. "above" counts bounds above a J of the lattice, "wide" such
that are wider than 2 % of the larger of |J| and of its range, "open" those that do not tell the
sign. Then the time of a call over that of the tangent, on a deformed and bent block. Run
``docker/enter python3 -m demos.benchmarks.validity`` (``--small``: toy sizes); one JSON line per
row, and ``results/validity.csv``; ``--write`` puts the tables into README.md. One process only.
"""

import itertools
import sys

from mpi4py import MPI

import basix
import basix.ufl
import numpy as np
import ufl
from dolfinx import mesh

from variform import forms, meshes
from variform.forms.validity import VolumeBounds

from .record import Table, insert, markdown, median_times

CELLS = {"P": {2: "triangle", 3: "tetrahedron"}, "Q": {2: "quadrilateral", 3: "hexahedron"}}
POINTS = {2: 33, 3: 11}  # of the lattice, along an edge
KINDS = ("straight", "curved", "at the axis", "surface")
BLOCKS = {"P1": 9, "P2": 7, "P3": 6, "Q1": 14, "Q2": 10, "Q3": 8}
NARROW = 0.02
TOLERANCE = 1e-10  # rounding, over the largest |J|


class OneCell:
    """A cell by itself, its unknown, and J of any displacement at a lattice of points.

    Args:
        kind: One of KINDS.
        dim: Dimension of the cell.
        element: "P1" to "Q3".
        rng: Generator of what bends the cell.
        order: Degree of the geometry; by default 1, and of a bent cell that of the element.
    """

    def __init__(self, kind, dim, element, rng, order=None):
        cell, self.degree, self.kind = CELLS[element[0]][dim], int(element[1]), kind
        bent = kind in ("curved", "surface")
        order = order or (self.degree if bent else 1)
        gdim = 3 if kind == "surface" else dim
        chart = basix.ufl.element("Lagrange", cell, order, shape=(gdim,))
        self.points = chart.sub_elements[0].basix_element.points
        x = np.zeros((len(self.points), gdim))
        x[:, :dim] = self.points
        if bent:
            x += 0.1 / order**2 * rng.uniform(-1, 1, x.shape)
        cells = np.arange(len(x))[None]
        self.body = mesh.create_mesh(MPI.COMM_SELF, cells=cells, x=x, e=ufl.Mesh(chart))
        self.u = displacement(self.body, self.degree)
        self.bounds = VolumeBounds(self.u, axisymmetric=kind == "at the axis")
        self.chart, self.cell, self.dim = chart.sub_elements[0], cell, dim
        self.usual = self.lattice(POINTS[dim])
        self.dofs = self.u.function_space.dofmap.list[0]
        self.on_axis = np.isclose(self.u.function_space.tabulate_dof_coordinates()[:, 0], 0)

    def lattice(self, points):
        """Bases of u and of its gradient, R and dX/dxi at a lattice."""
        cell = getattr(basix.CellType, self.cell)
        x = basix.create_lattice(cell, points - 1, basix.LatticeType.equispaced, True)
        if self.kind == "at the axis":
            x = x * (1 - 1e-6) + [1e-7, 0]  # J is 0/0 on the axis itself
        basis = self.u.function_space.ufl_element().sub_elements[0]
        N, B = parts(basis.tabulate(1, x))
        M, C = parts(self.chart.tabulate(1, x))
        X = self.body.geometry.x[self.body.geometry.dofmap[0], : self.body.geometry.dim]
        return N, B, M @ X, np.einsum("pak,ai->pik", C, X)

    def random(self, rng, count):
        """Displacements, shape (count, nodes, components), from small to large ones."""
        size = 10 ** rng.uniform(-2, 0, (count, 1, 1)) / self.degree
        u = size * rng.uniform(-1, 1, (count, len(self.dofs), self.body.geometry.dim))
        if self.kind == "at the axis":
            u[:, self.on_axis, 0] = 0
        return u

    def ratios(self, u, lattice=None):
        """J at a lattice, shape (count, points)."""
        N, B, R, D = lattice or self.usual
        at = u[:, self.dofs]
        J = size_of(D + np.einsum("pak,bai->bpik", B, at, optimize=True)) / size_of(D)
        if self.kind == "at the axis":
            J *= 1 + (at[:, :, 0] @ N.T) / R[:, 0]
        return J

    def bound(self, u):
        """Bounds of one displacement."""
        self.u.x.array[:] = u.ravel()
        return self.bounds()


def displacement(body, degree):
    """An unknown of any degree, also below that of the mesh."""
    element = "Lagrange", degree, (body.geometry.dim,)
    return forms.unknown(body, u=(element, forms.Role.DISPLACEMENT))


def parts(tabulated):
    """Values (points, nodes) and derivatives (points, nodes, variables) of a basis."""
    shape = tabulated.shape[1:3]
    tabulated = tabulated.reshape(len(tabulated), *shape)
    return tabulated[0], np.moveaxis(tabulated[1:], 0, -1)


def size_of(d):
    """Determinants, or areas of surfaces."""
    columns = [[d[..., i, k] for i in range(d.shape[-2])] for k in range(d.shape[-1])]
    if d.shape[-2] == 2:
        (a, b), (c, e) = columns
        return a * e - b * c
    x, y = columns[:2]
    turns = [(1, 2), (2, 0), (0, 1)]
    normal = [x[i] * y[j] - x[j] * y[i] for i, j in turns]
    if d.shape[-1] == 2:
        return np.sqrt(sum(n**2 for n in normal))
    return sum(n * z for n, z in zip(normal, columns[2], strict=True))


def relative(width, least, largest):
    """A width over the larger of |min J| and of the range of J."""
    return width / np.maximum(np.maximum(np.abs(least), largest - least), 1e-300)


def sweep(kind, dim, element, count, seed=1, cells=5, order=None):
    """How often bounds of random displacements are wrong, wide, open."""
    rng = np.random.default_rng(seed)
    found = dict.fromkeys(("above", "wide", "open"), 0)
    margin, width = np.inf, 0.0
    for _ in range(cells):
        one = OneCell(kind, dim, element, rng, order)
        for _ in range(max(1, count // cells // 200)):
            u = one.random(rng, min(200, count // cells))
            J = one.ratios(u)
            lower, upper = np.array([one.bound(v)[:2] for v in u]).T
            largest, least = J.max(axis=1), J.min(axis=1)
            gap = (least - lower) / np.abs(J).max(axis=1)
            is_open = (lower <= 0) & (upper > 0)
            widths = relative(upper - lower, np.minimum(least, upper), largest)
            for k in np.flatnonzero((widths > NARROW) & ~is_open):  # the lattice misses some of it
                fine = one.ratios(u[k : k + 1], one.lattice(4 * POINTS[dim])).max()
                widths[k] = relative(upper[k] - lower[k], min(least[k], upper[k]), fine)
            found["above"] += int((gap < -TOLERANCE).sum())
            found["wide"] += int(((widths > NARROW * (1 + 1e-3)) & ~is_open).sum())
            found["open"] += int(is_open.sum())
            margin, width = min(margin, gap.min()), max(width, widths[~is_open].max(initial=0))
    return {**found, "margin": float(f"{margin:.2g}"), "widest": float(f"{width:.3g}")}


def cost(element, n):
    """CPU seconds of a call and of a tangent on a block of n cells along each edge."""
    cells = CELLS[element[0]][3]
    body = meshes.block(MPI.COMM_SELF, (1.0, 1.0, 1.0), n=(n, n, n), cells=cells)
    x = body.mesh.geometry.x
    x += 0.02 * np.sin(3 * x[:, [1, 2, 0]])
    u = forms.displacement(body, int(element[1]))
    u.interpolate(
        lambda x: np.array(
            [
                0.3 * x[0] + 0.2 * x[1] ** 2 + 0.15 * np.sin(4 * x[0] * x[1]),
                0.15 * np.sin(5 * x[2]) * x[1] - 0.1 * x[0] ** 2,
                0.2 * x[0] * x[1] * x[2] + 0.15 * np.cos(4 * x[0] + x[2]),
            ]
        )
    )
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0)
    problem = forms.Problem(psi * ufl.dx, u)
    A = problem.create_matrix()
    bounds = VolumeBounds(u)
    ways = {"tangent": lambda: problem.tangent(A), "bounds": bounds}
    for work in ways.values():
        work()
    times = median_times(ways, 3 if n <= 3 else 15)
    found, count = bounds(), body.mesh.topology.index_map(3).size_local
    return {
        "element": element,
        "cells": count,
        "tangent [us per cell]": float(f"{times['tangent'] / count * 1e6:.3g}"),
        "bounds [us per cell]": float(f"{times['bounds'] / count * 1e6:.3g}"),
        "ratio": float(f"{times['bounds'] / times['tangent']:.2g}"),
        "lower": found.lower,
        "upper": found.upper,
    }


def table(rows):
    """Random fields, a line for each kind of cell; what a call costs, a line for each element."""
    swept = [r for r in rows if "above" in r]
    names = "kind", "dim", "element", "fields", "above", "wide", "open", "widest"
    lines = markdown(
        names, [[f"{r[n]:,}" if n == "fields" else r[n] for n in names] for r in swept]
    )
    timed = [r for r in rows if "ratio" in r]
    names = "element", "cells", "tangent [us per cell]", "bounds [us per cell]", "ratio"
    return [*lines, "", *markdown(names, [[r[n] for n in names] for r in timed])]


def main(small=False, write=False):
    """Measure, print and write the tables."""
    measurements = Table("validity")
    fields = 100 if small else 100_000
    elements = [f"{family}{k}" for family in "PQ" for k in (1, 2, 3)]
    for kind, element in itertools.product(KINDS, elements):
        for dim in (2, 3) if kind in ("straight", "curved") else (2,):
            row = sweep(kind, dim, element, fields)
            measurements.add(kind=kind, dim=dim, element=element, fields=fields, **row)
    for element, n in BLOCKS.items():
        measurements.add(**cost(element, 2 if small else n))
    measurements.write()
    if write:
        insert("validity", table(measurements.rows))
    return measurements.rows


if __name__ == "__main__":
    main(small="--small" in sys.argv, write="--write" in sys.argv)
