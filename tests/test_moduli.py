# SPDX-License-Identifier: MIT
"""Laws: moduli at the points give the tangent, whatever is in the energy, at every width of lanes.

That they do for all kinds of cells and supports, on any number of ranks: test_insertion.
"""

from mpi4py import MPI

import ffcx.codegeneration.lnodes as tree
import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx import mesh as dolfinx_mesh

from variform import forms, meshes
from variform.forms import energies
from variform.forms.batches import Sums
from variform.forms.moduli import Moduli
from variform.forms.native import jit, trees
from variform.forms.native.library import measured
from variform.forms.splitting import split

# Of 11 cells: lanes that are full and that are not, whatever the width.
CELLS = 11


def strip(degree=2):
    """A row of triangles with an uneven number of cells, bent."""
    points = np.array([[k / 2, k % 2 + 0.1 * k] for k in range(CELLS + 2)])
    cells = np.array([[k, k + 1, k + 2] for k in range(CELLS)])
    body = meshes.from_arrays(MPI.COMM_SELF, points, cells)
    u = forms.displacement(body, degree)
    u.interpolate(lambda x: np.stack([0.1 * x[0] * x[1], 0.05 * np.sin(2 * x[0])]))
    return body, u


def chain():
    """A row of tetrahedra with an uneven number of cells, bent."""
    corners = np.arange(CELLS + 3)
    points = np.stack([np.cos(2 * corners), np.sin(2 * corners), 0.4 * corners], axis=1)
    cells = np.array([[k, k + 1, k + 2, k + 3] for k in range(CELLS)])
    body = meshes.from_arrays(MPI.COMM_SELF, points, cells)
    u = forms.displacement(body, 1)
    u.interpolate(lambda x: np.stack([0.05 * x[2] ** 2, 0.02 * x[2] * x[0], 0.1 * x[1]]))
    return body, u


def branches(F, u, body):
    """Every relation, with numbers, Constants and functions on both sides."""
    C, J = F.T * F, ufl.det(F)
    a, b = C[0, 0], C[1, 1]
    one = fem.Constant(body.mesh, 1.0)
    both = ufl.And(ufl.lt(a, 1.2), ufl.Not(ufl.gt(b, one)))
    either = ufl.Or(ufl.ge(a, b), ufl.le(J, 0.9))
    return (
        ufl.conditional(both, a**2, a * b)
        + ufl.conditional(either, (J - 1) ** 2, 2 * (J - 1) ** 2)
        + ufl.conditional(ufl.ne(one, 2.0), a**2 * b, b**2)
        + ufl.conditional(ufl.eq(one, 2.0), a**2 * b, b**2)
        + ufl.max_value(a, b) ** 2
        + ufl.min_value(a, 1.1) ** 2
    )


def functions(F, u, body):
    """Every function of <math.h> that UFL has, powers of all kinds."""
    C, J = F.T * F, ufl.det(F)
    a, b, c = C[0, 0], C[1, 1], C[0, 1]
    p = fem.Constant(body.mesh, 0.7)
    of_one = (ufl.sqrt, ufl.exp, ufl.ln, ufl.cos, ufl.sin, ufl.atan, ufl.erf)
    hyperbolic = (ufl.cosh, ufl.sinh, ufl.tanh)
    return (
        sum(f(a) for f in (*of_one, *hyperbolic))
        + ufl.tan(a / 4)  # far from its pole, beside which rounding of C would be seen
        + ufl.acos(c / 4)
        + ufl.asin(c / 3)
        + ufl.atan2(a, b)
        + abs(c) ** 3
        + J ** (-2 / 3)
        + a**p
        + a**b
        + b**3
    )


def fields(F, u, body):
    """Moduli and fibers that are functions, of cells and of nodes; a modulus that is a Constant."""
    mu = fem.Function(fem.functionspace(body.mesh, ("DG", 0)))
    mu.x.array[:] = 1 + np.arange(len(mu.x.array)) / 7
    fiber = fem.Function(fem.functionspace(body.mesh, ("Lagrange", 1, (3,))))
    fiber.interpolate(lambda x: np.stack([np.cos(x[0]), np.sin(x[0]), 0 * x[0]]))
    lmbda = fem.Constant(body.mesh, 3.0)
    stretch = ufl.inner(F * fiber, F * fiber)
    return energies.neo_hookean(F, mu, lmbda) + fem.Constant(body.mesh, 0.5) * (stretch - 1) ** 2


def singular(F, u, body):
    """An operator and plain UFL in one integral."""
    return energies.fixed_corotated(F, 1.0, 2.0) + energies.neo_hookean(F, 1.0, 2.0)


def difference(K, u):
    """Moduli's product against FFCx's matrix times a vector: difference over the largest."""
    moduli = Moduli(K)
    assert moduli.rules
    A = fem.assemble_matrix(forms.compiled(K)).to_dense()
    x = np.random.default_rng(1).standard_normal(len(u.x.array))
    product = np.zeros_like(x)
    moduli.fill()
    moduli.multiply(x, product)
    if moduli.rest is not None:
        product += fem.assemble_matrix(moduli.rest).to_dense() @ x
    return np.abs(product - A @ x).max() / np.abs(A @ x).max()


def sums_agree(psi, u):
    """Energy and residual of our loops are those of DOLFINx's, 1e-14 and 1e-13 of the largest."""
    R = forms.residual(psi, u)
    b = fem.assemble_vector(forms.compiled(R)).array
    value = fem.assemble_scalar(forms.compiled(psi))
    both, found, again = Sums(psi, R), np.zeros_like(b), np.zeros_like(b)
    assert both.add_with_value(found) == pytest.approx(value, rel=1e-14)
    assert found == pytest.approx(b, abs=1e-13 * np.abs(b).max())
    both.add(again)
    assert np.array_equal(again, found)
    with pytest.raises(TypeError, match="by add_with_value"):
        both.value()
    assert Sums(psi).value() == pytest.approx(value, rel=1e-14)


@pytest.mark.parametrize("dim, width", [(2, 4), (3, 2), (3, 8)])
def test_operators_of_several_cells_are_looked_at_side_by_side(dim, width, monkeypatch):
    """K x, R, energy by linear simplices, one operand each: inverted, flat, at rest, 1e-14.

    A cell beyond the energy's domain makes infinite what its own nodes have, and nothing else.
    """
    usual = jit.flags(MPI.COMM_SELF)
    monkeypatch.setattr(jit, "flags", lambda comm: [*usual, f"-DWIDTH={width}"])
    _, u = strip(1) if dim == 2 else chain()
    nodes = u.x.array.reshape(-1, dim)
    nodes[3] -= 2.5 * np.arange(1, dim + 1)  # turns its cells inside out
    F = forms.deformation_gradient(u)
    psi = energies.fixed_corotated(F, 1.0, 2.0) * ufl.dx
    K = forms.tangent(forms.residual(psi, u), u)
    assert Sums(psi)._rest is None
    assert difference(K, u) < 1e-14
    sums_agree(psi, u)
    u.x.array[:] = 0
    assert difference(K, u) < 1e-14
    cells = u.function_space.dofmap.list
    last = cells[(cells == cells.max()).any(axis=1)][0]
    corner = next(n for n in last if (cells == n).sum() == 1)  # of no other cell
    places = u.function_space.tabulate_dof_coordinates()[:, :dim]
    nodes[corner] = 2 * (places[last[last != corner]].mean(axis=0) - places[corner])
    psi = energies.hencky(F, 1.0, 2.0) * ufl.dx
    R = forms.residual(psi, u)
    moduli = Moduli(forms.tangent(R, u))
    moduli.fill()
    x, product = np.ones_like(u.x.array), np.zeros_like(u.x.array)
    moduli.multiply(x, product)
    forces = np.zeros_like(product)
    assert Sums(psi, R).add_with_value(forces) == np.inf
    for found in product, forces:
        lost = ~np.isfinite(found.reshape(-1, dim)).all(axis=1)
        assert set(np.flatnonzero(lost)) == set(last)
    assert Sums(psi).value() == np.inf


@pytest.mark.parametrize("width", [2, 4, 8])
@pytest.mark.parametrize("energy", [branches, functions, fields, singular])
def test_products_are_the_matrix_s(energy, width, monkeypatch):
    """K x, R and energy by kernels of several cells, 1e-14: branches, functions, coefficients."""
    usual = jit.flags(MPI.COMM_SELF)
    monkeypatch.setattr(jit, "flags", lambda comm: [*usual, f"-DWIDTH={width}"])
    body, u = strip()
    psi = energy(forms.deformation_gradient(u), u, body) * ufl.dx
    R = forms.residual(psi, u)
    assert difference(forms.tangent(R, u), u) < 1e-14
    sums_agree(psi, u)


def test_regions_have_moduli_of_their_own():
    """Integrals over parts of the cells, of several degrees, in one tangent."""
    body, u = strip()
    tags = dolfinx_mesh.meshtags(
        body.mesh, 2, np.arange(5, dtype=np.int32), np.full(5, 3, np.int32)
    )
    dx = ufl.Measure("dx", body.mesh, subdomain_data=tags)
    F = forms.deformation_gradient(u)
    psi = energies.neo_hookean(F, 1.0, 2.0)
    potential = psi * dx + 2 * psi * dx(3) + psi**2 * dx(degree=5) + ufl.inner(u, u) * dx
    K = forms.tangent(forms.residual(potential, u), u)
    moduli = Moduli(K)
    assert len(moduli.rules) == 3 and moduli.rest_ufl is None
    assert difference(K, u) < 1e-14


def test_what_has_no_moduli_is_left():
    """Loads on facets, values times gradients, second gradients, bodies of revolution, fields."""
    body, u = strip()
    F = forms.deformation_gradient(u)
    psi = energies.neo_hookean(F, 1.0, 2.0)
    curvature = ufl.inner(ufl.grad(ufl.grad(u)), ufl.grad(ufl.grad(u)))
    for other in (
        forms.spring(u, 2.0, ufl.ds(body.mesh)),
        ufl.inner(u, u) * ufl.tr(F) * ufl.dx,
        curvature * ufl.dx,
    ):
        own, rest = split(forms.tangent(forms.residual(psi * ufl.dx + other, u), u))
        assert list(own) == [(1, 2)] and len(rest) == 1
    revolved = (
        energies.neo_hookean(forms.axisymmetric(u), 1.0, 2.0) * forms.circumference(u) * ufl.dx
    )
    assert not split(forms.tangent(forms.residual(revolved, u), u))[0]
    w = forms.displacement_pressure(body)
    v, p = ufl.split(w)
    G = forms.deformation_gradient(v)
    mixed = energies.with_pressure(energies.isochoric_neo_hookean(G, 1.0), G, p) * ufl.dx
    assert not split(forms.tangent(forms.residual(mixed, w), w))[0]


def test_inertia_has_moduli_of_its_own():
    """Terms of the values, of a density that is a function: in the tangent and in products."""
    body, u = strip()
    rho = fem.Function(fem.functionspace(body.mesh, ("DG", 0)))
    rho.x.array[:] = 1 + np.arange(len(rho.x.array)) / 3
    stiff = ufl.as_matrix([[2, 0.5], [0.5, 1]])
    psi = energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0)
    potential = psi * ufl.dx + rho * ufl.inner(u, stiff * u) ** 2 * ufl.dx(degree=6)
    K = forms.tangent(forms.residual(potential, u), u)
    own, rest = split(K)
    assert list(own) == [(0, 6), (1, 2)] and not rest
    assert difference(K, u) < 1e-14
    # What is constant in a cell has one set of moduli for all its points.
    kinetic = rho * ufl.inner(u, stiff * u) * ufl.dx
    K = forms.tangent(forms.residual(psi * ufl.dx + kinetic, u), u)
    assert ["#define SETS 1" in rule.text for rule in Moduli(K).rules] == [True, False]
    assert difference(K, u) < 1e-14
    problem = forms.Problem(potential, u)
    A, B = problem.create_matrix(), problem.create_matrix()
    problem.tangent(A)
    problem.forms.use_moduli()
    problem.tangent(B)
    off = B.getValuesCSR()[2] - A.getValuesCSR()[2]
    assert np.abs(off).max() < 1e-14 * np.abs(A.getValuesCSR()[2]).max()


def test_a_tangent_that_is_not_symmetric_has_none():
    """A pressure that follows the surface as a virtual work: FFCx's kernels assemble it."""
    body, u = strip()
    psi = energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0)
    work = forms.follower_pressure(u, 0.1, ufl.TestFunction(u.function_space), ufl.ds(body.mesh))
    problem = forms.Problem(psi * ufl.dx, u, virtual_work=work)
    problem.forms.use_moduli()
    assert problem.forms.moduli is None


def test_moduli_are_those_of_the_last_fill():
    """Products stay those of the state that they were filled at, and follow with the next one."""
    _, u = strip()
    K = forms.tangent(
        forms.residual(energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0) * ufl.dx, u), u
    )
    moduli, x = Moduli(K), np.random.default_rng(1).standard_normal(len(u.x.array))

    def product():
        y = np.zeros_like(x)
        moduli.multiply(x, y)
        return y

    moduli.fill()
    before = product()
    u.x.array[:] *= 0.5
    assert np.array_equal(product(), before)
    moduli.fill()
    after = fem.assemble_matrix(forms.compiled(K)).to_dense() @ x
    assert product() == pytest.approx(after, abs=1e-14 * np.abs(after).max())
    assert np.abs(after - before).max() > 1e-3 * np.abs(after).max()


def test_functions_without_vectors_are_computed_cell_by_cell():
    """Bessel's: FFCx's own kernels, with the same numbers."""
    _, u = strip()
    psi = ufl.bessel_J(1, ufl.tr(forms.deformation_gradient(u))) * ufl.dx
    R = forms.residual(psi, u)
    assert Moduli(forms.tangent(R, u)).rules[0]._batch.found is None
    assert difference(forms.tangent(R, u), u) < 1e-14
    b = fem.assemble_vector(forms.compiled(R)).array
    both, found = Sums(psi, R), np.zeros_like(b)
    assert both.add_with_value(found) == fem.assemble_scalar(forms.compiled(psi))
    assert np.array_equal(found, b) and not both._batches


def test_matrices_too_large_for_the_stack_have_no_moduli():
    """Hexahedra of degree 4 have 125 nodes: their tangent is FFCx's."""
    body = meshes.block(MPI.COMM_SELF, (1.0, 1.0, 1.0), n=(1, 1, 1), cells="hexahedron")
    for degree, count in ((3, 1), (4, 0)):
        u = forms.displacement(body, degree)
        psi = energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0) * ufl.dx
        own, rest = split(forms.tangent(forms.residual(psi, u), u))
        assert (len(own), len(rest)) == (count, 1 - count)


def test_an_array_that_begins_with_numbers_is_refused():
    """FFCx begins sums with zeros; anything else would be written wrongly."""
    start = tree.ArrayDecl(tree.Symbol("x", tree.DataType.SCALAR), sizes=2, values=np.ones(2))
    with pytest.raises(RuntimeError, match="begins with other numbers than zeros"):
        trees._Formatter().c_format(start)


def test_few_cells_are_not_measured(monkeypatch):
    """Eleven cells would tell how long a call takes: products go without a matrix, as elsewhere."""
    monkeypatch.setattr("variform.forms.moduli.measured", lambda *_: pytest.fail("measured"))
    _, u = strip()
    psi = energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0) * ufl.dx
    moduli = Moduli(forms.tangent(forms.residual(psi, u), u))
    assert moduli.seconds_over(lambda: 1.0, MPI.COMM_SELF) == 0


def test_what_is_measured_is_measured_once(tmp_path, monkeypatch):
    """Runs on one CPU decide alike: the first one's measurement is kept beside the kernels."""
    monkeypatch.setattr(jit, "folder", lambda: tmp_path)
    times = iter([0.25, 0.5])
    for name, number in (("one", 0.25), ("one", 0.25), ("other", 0.5), ("one", 0.25)):
        assert measured(MPI.COMM_SELF, name, lambda: next(times)) == number


def test_products_that_cost_more_are_done_with_the_matrix(monkeypatch):
    """Where products by moduli are thrice as dear, none are used; the solution is the same."""
    ends = {}
    for over in (0.5, 3.0):
        monkeypatch.setattr(Moduli, "seconds_over", lambda *_, over=over: over)
        body = meshes.block(MPI.COMM_SELF, (2.0, 1.0, 1.0), n=(8, 5, 5))
        u = forms.displacement(body, 2)
        psi = energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0) * ufl.dx
        held = [
            forms.clamp(u, body.facets("left")),
            forms.translate(u, body.facets("right"), (0.3, 0, 0)),
        ]
        problem = forms.Problem(psi, u, held)
        forms.solve(problem, rtol=1e-11)
        ends[over] = u.x.array.copy()
        assert (problem.solver[1].tangent._action is None) == (over > 1)
    assert ends[0.5] == pytest.approx(ends[3.0], abs=1e-9 * np.abs(ends[3.0]).max())


def test_a_release_with_other_trees_gets_ffcx_s_own_kernels(monkeypatch):
    """Where FFCx describes kernels otherwise, cells are computed one by one, and the same."""
    monkeypatch.setattr(forms._dolfinx, "TREES", False)
    _, u = strip()
    psi = energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0)
    K = forms.tangent(forms.residual(psi * ufl.dx, u), u)
    assert Moduli(K).rules[0]._batch.found is None
    assert difference(K, u) < 1e-14
