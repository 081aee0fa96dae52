# SPDX-License-Identifier: MIT
"""Bodies assembled by hand, (29)-(60), equal the automatic residual and tangent."""

from mpi4py import MPI

import basix
import basix.ufl
import numpy as np
import pytest
import ufl
from cases import ENERGIES, agree, at_plane
from dolfinx import fem
from dolfinx import mesh as dmesh
from elements import KINDS, MATERIALS, basix_order, every_material

from variform import forms
from variform.forms.formulas import element as fe
from variform.forms.formulas import materials as ma
from variform.forms.formulas import shapes

LOAD = 0.03  # small enough for full Newton steps in four load steps
BODIES = {
    "tet4": ("tet4", False, 2),
    "tet10": ("tet10", False, 3),
    "tet10-curved": ("tet10", True, 4),
    "hex8": ("hex8", False, 3),
    "hex27": ("hex27", False, 5),
}


def body(cell, curved=False):
    """Two cubes of these cells; curved: geometry of order 2."""
    kind = getattr(dmesh.CellType, KINDS[cell][0])
    mesh = dmesh.create_box(MPI.COMM_SELF, [[0, 0, 0], [2, 1, 1]], [2, 1, 1], kind)
    if not curved:
        return mesh
    V = fem.functionspace(mesh, ("Lagrange", 2))
    cells, x = V.dofmap.list, V.tabulate_dof_coordinates()
    element = basix.ufl.element("Lagrange", KINDS[cell][0], 2, shape=(3,))
    return dmesh.create_mesh(MPI.COMM_SELF, cells=cells, x=x, e=ufl.Mesh(element))


def shake(mesh, rng):
    """Move all nodes of the geometry at random."""
    mesh.geometry.x[:] += rng.uniform(-0.04, 0.04, size=mesh.geometry.x.shape)


class ByHand:
    """The same body, loads and points without DOLFINx but for its node numbers and coordinates.

    Tetrahedra of DOLFINx may be inside out (it takes |det J|): their nodes are read mirrored, x and
    y of the reference cell exchanged, and so are the points of the rule.
    """

    def __init__(self, V, cell, degree):
        kind, _ = KINDS[cell]
        self.cell, self.X = cell, V.tabulate_dof_coordinates()
        points, weights = basix.make_quadrature(getattr(basix.CellType, kind), degree)
        face = basix.CellType.quadrilateral if cell[0] == "h" else basix.CellType.triangle
        face_points, face_weights = basix.make_quadrature(face, degree)
        if cell[0] == "h":  # [0, 1] -> [-1, 1]
            points, weights = 2 * points - 1, 8 * weights
            face_points, face_weights = 2 * face_points - 1, 4 * face_weights
        self.weights, self.face = weights, (face_points, face_weights)
        self.cells, self.points = [], []
        for dofs in V.dofmap.list:
            straight = dofs[basix_order(cell)]
            first = fe.jacobian(shapes.shape_gradients(cell, points[:1]), self.X[straight])
            mirrored = np.linalg.det(first)[0] < 0
            self.cells.append(dofs[basix_order(cell, mirrored)])
            self.points.append(points[:, [1, 0, 2]] if mirrored else points)
        self.cells, self.points = np.array(self.cells), np.array(self.points)
        self.N = shapes.shape_functions(cell, self.points)
        self.dN = shapes.shape_gradients(cell, self.points)
        self.G0, det0 = fe.gradients(self.dN, self.X[self.cells])
        self.dV = self.weights * det0

    def boundary(self):
        """Cell and face of each face that belongs to one cell alone."""
        faces = {}
        for i, nodes in enumerate(self.cells):
            for facet, corners in enumerate(shapes.FACETS[self.cell]):
                faces.setdefault(frozenset(nodes[list(corners)]), []).append((i, facet))
        return [owners[0] for owners in faces.values() if len(owners) == 1]

    def load(self, b, t):
        """F of dead loads: b per reference volume, t per reference area on all of the boundary."""
        X = fe.interpolate(self.N, self.X[self.cells])
        total = fe.assemble_vector(
            fe.external_force(self.N, b(X), self.dV), self.cells, len(self.X)
        )
        for i, facet in self.boundary():
            xi, tangents = shapes.facet_map(self.cell, facet, self.face[0])
            N, dN = shapes.shape_functions(self.cell, xi), shapes.shape_gradients(self.cell, xi)
            nodes = self.X[self.cells[i]]
            dA = self.face[1] * np.linalg.norm(fe.surface_element(dN, nodes, tangents), axis=-1)
            F = fe.external_force(N, t(fe.interpolate(N, nodes)), dA)
            total += fe.assemble_vector(F[None], self.cells[[i]], len(self.X))
        return total

    def internal(self, material, u):
        """Assembled T and K_c + K_sigma at displacements (nodes, 3)."""
        _, sigma, c = material
        x = (self.X + u)[self.cells]
        G, det = fe.gradients(self.dN, x)
        F = fe.deformation_gradient(x, self.G0)
        dv = self.weights * det
        T = fe.internal_force(sigma(F), G, dv)
        K = fe.element_tangent(G, ma.voigt_elasticity(c(F)), sigma(F), dv)
        nodes = len(self.X)
        return fe.assemble_vector(T, self.cells, nodes), fe.assemble_matrix(K, self.cells, nodes)


def body_load(X):
    x, y, z = (X[..., i] for i in range(3))
    return LOAD * np.stack([0.3 + 0 * x, -0.2 * x * y, 0.5 + z], axis=-1)


def traction(X):
    x, y, z = (X[..., i] for i in range(3))
    return LOAD * np.stack([0.1 * y, 0.2 + x, -0.3 * z], axis=-1)


def potential(u, name, degree):
    """psi, body force and dead traction, the loads written once more in UFL."""
    x, y, z = ufl.SpatialCoordinate(u.function_space.mesh)
    metadata = {"quadrature_degree": degree}
    dx, ds = ufl.dx(metadata=metadata), ufl.ds(metadata=metadata)
    b = LOAD * ufl.as_vector([0.3, -0.2 * x * y, 0.5 + z])
    t = LOAD * ufl.as_vector([0.1 * y, 0.2 + x, -0.3 * z])
    psi = ENERGIES[name](forms.deformation_gradient(u))
    return psi * dx + forms.body_force(u, b, dx) + forms.dead_traction(u, t, ds)


@pytest.mark.capability(80, 82)
@every_material
@pytest.mark.parametrize("name_of_body", BODIES)
def test_automatic_residual_and_tangent_are_those_by_hand(name_of_body, name, rng):
    """R = T - F and K = K_c + K_sigma, assembled by hand, equal the Gateaux derivatives."""
    cell, curved, degree = BODIES[name_of_body]
    mesh = body(cell, curved)
    shake(mesh, rng)
    u = forms.displacement(mesh, degree=KINDS[cell][1])
    u.x.array[:] = rng.uniform(-0.04, 0.04, size=u.x.array.size)
    R_form = forms.residual(potential(u, name, degree), u)
    R = fem.assemble_vector(fem.form(R_form)).array
    K = fem.assemble_matrix(fem.form(forms.tangent(R_form, u))).to_dense()
    hand = ByHand(u.function_space, cell, degree)
    T, K_hand = hand.internal(MATERIALS[name], u.x.array.reshape(-1, 3))
    F = hand.load(body_load, traction)
    assert np.abs(F).max() > 1e-2 * np.abs(R).max()
    agree(fe.residual(T, F), R, 12)
    agree(K_hand, K, 12)
    agree(K_hand, K_hand.T, 14)


@pytest.mark.capability(81)
def test_newton_by_hand_finds_the_solution_of_snes(rng):
    """Assembly and Newton-Raphson with R = T - F and its tangent end where forms.solve ends."""
    mesh = body("hex8")
    left = at_plane(mesh, 0, 0)
    shake(mesh, rng)
    u = forms.displacement(mesh)
    degree = BODIES["hex8"][2]
    forms.solve(potential(u, "neo_hookean", degree), u, [forms.clamp(u, left)])
    hand = ByHand(u.function_space, "hex8", degree)
    fixed = fem.locate_dofs_topological(u.function_space, 2, left)
    free = np.setdiff1d(np.arange(u.x.array.size), 3 * fixed[:, None] + np.arange(3))
    F, found = hand.load(body_load, traction), np.zeros((len(hand.X), 3))
    for factor in (0.25, 0.5, 0.75, 1.0):
        norms = []
        for _ in range(8):
            T, K = hand.internal(MATERIALS["neo_hookean"], found)
            R = fe.residual(T, factor * F)[free]
            norms.append(np.linalg.norm(R))
            found.ravel()[free] -= np.linalg.solve(K[np.ix_(free, free)], R)
        assert norms[-1] < 1e-14, norms
    assert np.abs(found).max() > 0.05
    agree(u.x.array, found.ravel(), 9)
