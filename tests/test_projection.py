# SPDX-License-Identifier: MIT
"""Projected tangents, and Newton's method from states where full tangents lead astray."""

from mpi4py import MPI

import basix.ufl
import numpy as np
import pytest
import ufl
from cases import LMBDA, MU, agree, at_plane, unit_mesh, whole
from dolfinx import mesh
from scipy.sparse import csr_matrix

from variform import forms
from variform.forms import energies
from variform.meshes._dolfinx import create_mesh

N = 6
SIMPLEX = {2: "triangle", 3: "tetrahedron"}


@pytest.fixture(scope="module")
def box():
    """A cube of 6 x 6 x 6 cubes of six tetrahedra, all outer faces held."""
    body = mesh.create_unit_cube(MPI.COMM_SELF, N, N, N)
    u = forms.displacement(body)
    x = u.function_space.tabulate_dof_coordinates()
    inside = np.all((x > 1e-9) & (x < 1 - 1e-9), axis=1)
    return u, forms.clamp(u, whole(body)), x, inside


def start(x, inside, kind, seed=0):
    """Displacements of the nodes: scrambled by 2 h, flat, mirrored, one point, anywhere."""
    rng = np.random.default_rng(seed)
    to = {
        "scrambled": lambda: x + rng.uniform(-2, 2, x.shape) / N,
        "flattened": lambda: x * (1, 1, 0) + (0, 0, 0.5),
        "mirrored": lambda: x * (1, 1, -1) + (0, 0, 1),
        "point": lambda: np.full_like(x, 0.5),
        "random": lambda: rng.uniform(0, 1, x.shape),
    }[kind]()
    return np.where(inside[:, None], to - x, 0).ravel()


MATERIALS = {
    "fixed_corotated": energies.fixed_corotated,
    "stable_neo_hookean_stretches": energies.stable_neo_hookean_stretches,
    "stable_neo_hookean, plain UFL": energies.stable_neo_hookean,
    "fixed_corotated and plain UFL": lambda F, mu, lmbda: (
        energies.as_rigid_as_possible(F, mu) + lmbda / 2 * (ufl.det(F) - 1) ** 2
    ),
}


@pytest.mark.parametrize("name", MATERIALS)
def test_a_scrambled_box_returns_to_rest(box, name):
    """With mu = 1, lmbda = 10, about 500 inverted cells: <= 12 iterations to 1e-10, |u| < 1e-8."""
    u, held, x, inside = box
    potential = MATERIALS[name](forms.deformation_gradient(u), 1.0, 10.0) * ufl.dx(degree=1)
    for seed in range(5):
        u.x.array[:] = start(x, inside, "scrambled", seed)
        path = forms.solve(potential, u, [held], projection="always", rtol=1e-10)
        run = path.steps[0].convergence
        assert run.iterations <= 12 and 0 < run.projected < run.iterations
        assert run.residuals[-1] < 1e-10 * run.residuals[0]
        assert np.abs(u.x.array).max() < 1e-8


@pytest.mark.parametrize("projection", ["always", "auto"])
@pytest.mark.parametrize("kind", ["flattened", "mirrored", "point", "random"])
@pytest.mark.parametrize("name", ["fixed_corotated", "stable_neo_hookean_stretches"])
def test_other_ruined_states_recover_too(box, name, kind, projection):
    u, held, x, inside = box
    potential = MATERIALS[name](forms.deformation_gradient(u), 1.0, 10.0) * ufl.dx(degree=1)
    u.x.array[:] = start(x, inside, kind)
    options = {"snes_max_it": 100}
    forms.solve(potential, u, [held], projection=projection, rtol=1e-10, options=options)
    assert np.abs(u.x.array).max() < 1e-8


def test_the_last_iterations_are_quadratic(box):
    """|R_k+1| <= C |R_k|^2: the order between the last three residuals above rounding is 2."""
    u, held, x, inside = box
    potential = energies.fixed_corotated(forms.deformation_gradient(u), 1.0, 10.0) * ufl.dx
    u.x.array[:] = start(x, inside, "scrambled", 1)
    path = forms.solve(potential, u, [held], projection="always", rtol=1e-13)
    R = [r for r in path.steps[0].convergence.residuals if r > 1e-11][-3:]
    order = np.log(R[2] / R[1]) / np.log(R[1] / R[0])
    assert order == pytest.approx(2, abs=0.35)


def matrices(potential, u):
    """Full and projected tangent as dense matrices."""
    system = forms.Problem(potential, u)
    A = system.create_matrix()
    out = []
    for projected in (False, True):
        system.tangent(A, projected)
        rows, columns, values = A.getValuesCSR()
        out.append(csr_matrix((values, columns, rows)).toarray())
    return out


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("dim", [2, 3])
def test_a_cell_matrix_becomes_the_nearest_semidefinite_one(dim, degree, rng):
    """One cell in compression: the projection clamps the eigenvalues of its matrix at 0."""
    element = basix.ufl.element("Lagrange", SIMPLEX[dim], 1, shape=(dim,))
    points = np.vstack([np.zeros(dim), np.eye(dim)])
    cell = create_mesh(MPI.COMM_SELF, element, points, np.arange(dim + 1, dtype=np.int64)[None])
    u = forms.displacement(cell, degree=degree)
    u.interpolate(lambda x: -0.3 * x[:dim])
    u.x.array[:] += 0.05 * rng.normal(size=u.x.array.size)
    F = forms.deformation_gradient(u)
    full, projected = matrices(energies.saint_venant_kirchhoff(F, MU, LMBDA) * ufl.dx, u)
    values, vectors = np.linalg.eigh(full)
    assert values[0] < -0.01 * values[-1] < 0
    wanted = vectors * np.maximum(values, 0) @ vectors.T
    assert np.abs(projected - wanted).max() < 1e-13 * values[-1]


def test_projection_leaves_stable_tangents_alone(rng):
    """Where every cell (every point) is positive semi-definite nothing changes, to rounding."""
    u = forms.displacement(unit_mesh(3))
    u.x.array[:] = 0.001 * rng.normal(size=u.x.array.size)
    F = forms.deformation_gradient(u)
    for energy in (energies.neo_hookean, energies.saint_venant_kirchhoff_stretches):
        # A stretched body has tensile stresses, which stabilize.
        u.interpolate(lambda x: 0.1 * x)
        full, projected = matrices(energy(F, MU, LMBDA) * ufl.dx, u)
        agree(projected, full, 13)


def test_projected_tangents_are_semidefinite(rng):
    """Operators, plain terms, squares of operators and a pressure potential: no negative mode."""
    body = unit_mesh(3, 2)
    u = forms.displacement(body)
    u.x.array[:] = 0.4 * rng.normal(size=u.x.array.size)
    F = forms.deformation_gradient(u)
    psi = energies.fixed_corotated(F, MU, LMBDA)
    top = ufl.Measure(
        "ds",
        body,
        subdomain_data=mesh.meshtags(
            body, 2, np.sort(at_plane(body, 2, 1.0)), np.full(8, 7, np.int32)
        ),
    )
    for potential in (
        psi * ufl.dx,
        psi**2 * ufl.dx,
        -psi * ufl.dx,
        psi * ufl.dx - energies.as_rigid_as_possible(F, 3 * MU) * ufl.dx,
        (ufl.SpatialCoordinate(body)[0] - 0.5) * psi * ufl.dx,
        psi * ufl.dx + energies.stable_neo_hookean(F, MU, LMBDA) * ufl.dx,
        psi * ufl.dx + 5 * ufl.det(F) * top(7),
    ):
        full, projected = matrices(potential, u)
        assert np.linalg.eigvalsh(full)[0] < -1e-3
        values = np.linalg.eigvalsh(projected)
        assert values[0] > -1e-12 * values[-1]
        agree(projected, projected.T, 13)


def test_automatic_projection_gives_way_where_it_cannot_be(box):
    """A penalty on interior facets has no projected tangent: the search goes on without."""
    u, held, x, inside = box
    F = forms.deformation_gradient(u)
    jump = ufl.jump(ufl.grad(u))
    potential = energies.stable_neo_hookean(F, 1.0, 10.0) * ufl.dx
    potential += 1e-3 * ufl.inner(jump, jump) * ufl.dS
    u.x.array[:] = 0.2 * start(x, inside, "scrambled")
    path = forms.solve(potential, u, [held], options={"snes_max_it": 100})
    assert path.steps[0].convergence.projected == 0
    assert np.abs(u.x.array).max() < 1e-6
    with pytest.raises(ValueError, match="a projected form may have 64 integrals.* and 1 others"):
        forms.solve(potential, u, [held], projection="always")


def test_where_no_projection_is_possible_one_sentence_says_so():
    body = unit_mesh(2)
    w = forms.displacement_pressure(body)
    v, p = ufl.split(w)
    F = forms.deformation_gradient(v)
    mixed = energies.with_pressure(energies.isochoric_neo_hookean(F, MU), F, p) * ufl.dx
    held = [forms.clamp(w, at_plane(body, 0, 0.0))]
    with pytest.raises(
        ValueError, match="needs a potential of fields that are minimized over, got a m"
    ):
        forms.solve(mixed, w, held, projection="always")
    u = forms.displacement(body)
    F = forms.deformation_gradient(u)
    work = forms.follower_pressure(u, 0.1, ufl.TestFunction(u.function_space), ufl.ds)
    psi = energies.neo_hookean(F, MU, LMBDA) * ufl.dx
    held = [forms.clamp(u, at_plane(body, 0, 0.0))]
    with pytest.raises(ValueError, match="solve with projection='never'"):
        forms.solve(psi, u, held, virtual_work=work, projection="always")
    with pytest.raises(ValueError, match="one of auto, always, never, got 'sometimes'"):
        forms.solve(psi, u, held, projection="sometimes")
