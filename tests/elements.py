# SPDX-License-Identifier: MIT
"""Distorted and deformed elements of document 003, at whose points everything is known."""

import basix
import basix.ufl
import materials
import numpy as np
import pytest

from variform.forms.formulas import element as fe
from variform.forms.formulas import quadrature, shapes

CELLS = ("tet4", "tet10", "hex8", "hex27")
RULES = {
    "tet4": quadrature.tetrahedron(1),
    "tet10": quadrature.tetrahedron(2),
    "hex8": quadrature.hexahedron(2),
    "hex27": quadrature.hexahedron(3),
}
MATERIALS = {name: materials.MATERIALS[name] for name in ("neo_hookean", "transversely_isotropic")}
every_cell = pytest.mark.parametrize("cell", CELLS)
every_material = pytest.mark.parametrize("name", MATERIALS)


def distorted(cell):
    """Nodes of an element that is not affine."""
    X = shapes.NODES[cell]
    return X + 0.05 * np.sin(7 * np.arange(X.size)).reshape(X.shape)


def moved(X):
    """Nodes after a motion that is not affine."""
    x, y, z = X.T
    motion = [x + 0.2 * x * y, y + 0.15 * x - 0.1 * z**2, z + 0.25 * x * z - 0.1 * y]
    return np.stack(motion, axis=-1)


class State:
    """Everything at the points of one deformed element."""

    def __init__(self, cell, rule=None, x=None):
        self.points, self.weights = rule or RULES[cell]
        self.X = distorted(cell)
        self.x = moved(self.X) if x is None else x
        self.N, dN = (
            shapes.shape_functions(cell, self.points),
            shapes.shape_gradients(cell, self.points),
        )
        self.G, self.det = fe.gradients(dN, self.x)
        self.G0, det0 = fe.gradients(dN, self.X)
        self.dv, self.dV = self.weights * self.det, self.weights * det0
        self.F = fe.deformation_gradient(self.x, self.G0)


def basix_order(cell, mirrored=False):
    """Number in basix's order of each of our nodes, by their places.

    basix counts the corners of the cube [0, 1]^3 row by row, where we go around the faces, and has
    the edges of the tetrahedron in another order. ``mirrored``: x and y of our cell exchanged.
    """
    kind, degree = KINDS[cell]
    e = basix.create_element(basix.ElementFamily.P, getattr(basix.CellType, kind), degree)
    places = shapes.NODES[cell] if cell[0] == "t" else (shapes.NODES[cell] + 1) / 2
    places = places[:, [1, 0, 2]] if mirrored else places
    distance = np.abs(places[:, None] - e.points[None]).max(axis=-1)
    assert np.sum(distance < 1e-12) == len(places)
    return np.argmin(distance, axis=1)


KINDS = {
    "tet4": ("tetrahedron", 1),
    "tet10": ("tetrahedron", 2),
    "hex8": ("hexahedron", 1),
    "hex27": ("hexahedron", 2),
}
