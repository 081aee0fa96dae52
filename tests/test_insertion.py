# SPDX-License-Identifier: MIT
"""Laws: the tangent in our places is DOLFINx's matrix, on any number of ranks; so is its action."""

import functools

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx.fem import petsc as fem_petsc

from variform import forms, meshes
from variform.forms import energies, insertion

SCENES = """
import json, sys
from mpi4py import MPI
import numpy as np, ufl
from dolfinx import mesh
from dolfinx.fem import petsc as fem_petsc
from variform import forms, meshes
from variform.forms import energies

Action = sys.modules["variform.forms.solving.linear.action"].Action
COMM = MPI.COMM_WORLD
CELLS = [4, 2, 2]


def solid(cells, degree, energy="neo_hookean"):
    "Block with a clamped end, a roller, springs; one half is stiffer where that compiles fast."
    body = meshes.block(COMM, (1.0, 0.5, 0.5), n=tuple(CELLS), cells=cells)
    u = forms.displacement(body, degree)
    left = mesh.locate_entities(body.mesh, 3, lambda x: x[0] <= 0.5)
    tags = mesh.meshtags(body.mesh, 3, left, np.full(len(left), 7, np.int32))
    dx = ufl.Measure("dx", body.mesh, subdomain_data=tags)
    psi = getattr(energies, energy)(forms.deformation_gradient(u), 1.0, 2.5)
    potential = psi * dx
    if degree == 1 or energy != "neo_hookean":  # each part is compiled by itself
        potential += 3 * psi * dx(7)
    potential += forms.spring(u, 2.0, body.ds("right")) + forms.spring(u, 1.0, body.ds("top"))
    held = [forms.clamp(u, body.facets("left")), forms.roller(u, body.facets("front"), 1)]
    return u, potential, held


def plane(cells, degree):
    body = meshes.cook(COMM, n=4, cells=cells)
    u = forms.displacement(body, degree)
    F = forms.deformation_gradient(u)
    return u, energies.neo_hookean(F, 1.0, 2.5) * ufl.dx, [forms.clamp(u, body.facets("left"))]


def mixed():
    body = meshes.block(COMM, (1.0, 0.5, 0.5), n=tuple(CELLS))
    w = forms.displacement_pressure(body)
    u, p = ufl.split(w)
    F = forms.deformation_gradient(u)
    psi = energies.with_pressure(energies.isochoric_neo_hookean(F, 1.0), F, p)
    return w, psi * ufl.dx, [forms.clamp(w, body.facets("left"))]


def sheet():
    body = meshes.disk(COMM, 1.0, 0.4)
    u = forms.displacement(body, 2)
    psi = energies.neo_hookean_sheet(forms.membrane_gradient(u), 1.0)
    return u, psi * ufl.dx, [forms.clamp(u, body.facets("outer"))]


SCENES = {
    "tetrahedra P1": lambda: solid("tetrahedron", 1),
    "tetrahedra P2": lambda: solid("tetrahedron", 2),
    "tetrahedra P3": lambda: solid("tetrahedron", 3),
    "hexahedra P1": lambda: solid("hexahedron", 1),
    "hexahedra P2": lambda: solid("hexahedron", 2),
    "operator P1": lambda: solid("tetrahedron", 1, "fixed_corotated"),
    "operator P2": lambda: solid("tetrahedron", 2, "fixed_corotated"),
    "triangles P2": lambda: plane("triangle", 2),
    "quadrilaterals P1": lambda: plane("quadrilateral", 1),
    "mixed": mixed,
    "sheet": sheet,
}
"""

COMPARE = """
found, sums = {}, {}


def compare(name, u, potential, held):
    system = forms.Problem(potential, u, held)
    V = u.function_space
    is_mixed = V.num_sub_spaces and V.dofmap.bs == 1
    displacement = V.sub(0).collapse()[0] if is_mixed else V
    bend = lambda x: 0.05 * np.array([x[0] * x[1], x[1] + x[0], x[0] ** 2])
    count = displacement.num_sub_spaces
    (u.sub(0) if is_mixed else u).interpolate(lambda x: bend(x)[:count])
    A = system.create_matrix()
    ours = A.getAttr("variform_insertion") is not None
    ways = {"": False, ", projected": True} if "operator" in name else {"": False}
    for way, projected in ways.items():
        system.tangent(A, projected)
        system.tangent(A, projected)  # places hold, nothing is left of the first
        form = system.forms.projected_form if projected else system.forms.tangent_form
        B = fem_petsc.create_matrix(form)
        fem_petsc.assemble_matrix(B, form, system.conditions)
        B.assemble()
        size = B.norm()
        A.axpy(-1, B)
        found[name + way] = [ours, A.norm() / size, size]
    system.tangent(B)
    found[name].append(product(system, B))
    b, c = system.create_vector(), system.create_vector()
    system.residual(b)
    energy = system.energy()
    system.forms.use_moduli()
    if system.forms.moduli is not None:
        A = system.create_matrix()
        system.tangent(A)
        system.tangent(A)
        A.axpy(-1, B)
        system.residual(c)
        c.axpy(-1, b)
        found[name + ", moduli"] = [ours, A.norm() / B.norm(), size, product(system, B)]
        sums[name] = [c.norm() / b.norm(), abs(system.energy() / energy - 1)]


def product(system, B):
    "How far a product without a matrix is from that with it."
    action = Action(system, B)
    x, y, z = (B.createVecRight() for _ in range(3))
    x.array[:] = np.random.default_rng(COMM.rank).standard_normal(x.getLocalSize())
    action.update()
    for action.assembled, result in ((False, y), (True, z)):
        action.matrix.mult(x, result)
    y.axpy(-1, z)
    return y.norm() / z.norm()


sizes = {"": [4, 2, 2]}
if COMM.size == 3:  # the boundary of the box
    sizes["few cells, "] = [2, 1, 1]
for size, cells in sizes.items():
    CELLS[:] = cells
    for name, scene in SCENES.items():
        compare(size + name, *scene())
if COMM.rank == 0:
    print(json.dumps([found, sums]))
"""


@pytest.fixture(scope="module")
def compared(parallel_once):
    """What a number of ranks finds, by one run for each."""
    return functools.cache(lambda ranks: parallel_once(SCENES + COMPARE, ranks))


@pytest.mark.parametrize("ranks", [1, 2, 3])
def test_matrix_is_that_of_dolfinx(compared, ranks):
    """All kinds of cells, integrals and supports: equal to rounding, and by our own loop."""
    found = {k: v for k, v in compared(ranks)[0].items() if not k.startswith("few cells")}
    assert len(found) == 23
    for name, (ours, difference, size, *product) in found.items():
        assert ours and size > 0.1, name
        # By moduli the sums have another order.
        assert difference < (1e-14 if "moduli" in name else 1e-15), (name, difference)
        # Without a matrix the sums have another order, and singular values another state of sweeps.
        assert all(off < 1e-14 for off in product), (name, product)


@pytest.fixture
def system():
    body = meshes.block(MPI.COMM_SELF, (1.0, 1.0, 1.0), n=(2, 2, 2))
    u = forms.displacement(body, 1)
    psi = energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0)
    return forms.Problem(psi * ufl.dx, u, [forms.clamp(u, body.facets("left"))])


def assembled(system):
    B = fem_petsc.create_matrix(system.forms.tangent_form)
    fem_petsc.assemble_matrix(B, system.forms.tangent_form, system.conditions)
    B.assemble()
    return B


def test_foreign_matrix_is_assembled_the_usual_way(system):
    """A matrix that was made elsewhere has no places, and gets the same numbers."""
    A = fem_petsc.create_matrix(system.forms.tangent_form)
    for _ in range(2):
        system.tangent(A)
        A.axpy(-1, assembled(system))
        assert A.norm() == 0


def test_row_too_long_is_assembled_the_usual_way(system, monkeypatch):
    """Where places of two bytes do not reach, DOLFINx's insertion is used."""

    def refuse(*arguments):
        raise OverflowError("a row of the tangent is too long for places of two bytes.")

    monkeypatch.setattr(insertion, "_Insertion", refuse)
    A = system.create_matrix()
    assert A.getAttr("variform_insertion") is None
    system.tangent(A)
    A.axpy(-1, assembled(system))
    assert A.norm() == 0


def test_interior_facets_are_assembled_the_usual_way():
    """A penalty on jumps of the gradient is an integral that our loop does not know."""
    body = meshes.block(MPI.COMM_SELF, (1.0, 1.0, 1.0), n=(2, 2, 2))
    u = forms.displacement(body, 1)
    psi = energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0)
    jump = ufl.jump(ufl.grad(u))
    system = forms.Problem(psi * ufl.dx + ufl.inner(jump, jump) * ufl.dS, u)
    A = system.create_matrix()
    assert A.getAttr("variform_insertion") is None
    system.tangent(A)
    A.axpy(-1, assembled(system))
    assert A.norm() == 0


def test_places_last_while_the_matrix_is_changed(system):
    """Damping adds another matrix and shifts: the next assembly starts from zero all the same."""
    A, B = system.create_matrix(), assembled(system)
    system.tangent(A)
    A.axpy(0.5, B)
    A.shift(2.0)
    system.tangent(A)
    A.axpy(-1, B)
    assert A.norm() <= 1e-15 * B.norm()


def test_supports_are_identity(system):
    """Rows and columns of supported degrees of freedom are those of identity."""
    A = system.create_matrix()
    system.tangent(A)
    rows = system.constrained
    pointers, columns, values = A.getValuesCSR()
    for row in rows:
        part = slice(pointers[row], pointers[row + 1])
        assert np.array_equal(values[part], columns[part] == row)
    others = np.setdiff1d(np.arange(A.getSize()[0]), rows)
    for row in others:
        part = slice(pointers[row], pointers[row + 1])
        assert not values[part][np.isin(columns[part], rows)].any()


@pytest.mark.parametrize("ranks", [1, 2, 3])
def test_residual_and_energy_by_kernels_of_several_cells_are_ffcx_s(compared, ranks):
    """To 1e-13 of their size, as large parts cancel: all scenes that have moduli."""
    sums = compared(ranks)[1]
    assert len([name for name in sums if not name.startswith("few cells")]) == 10
    for name, off in sums.items():
        assert max(off) < 1e-13, (name, off)


def test_boundary_of_a_box(compared):
    """Ranks with few rows of their own: more ranks than rows of cells."""
    found = {k: v for k, v in compared(3)[0].items() if k.startswith("few cells")}
    assert len(found) == 23
    for name, value in found.items():
        assert value[1] < (1e-14 if "moduli" in name else 1e-15), name
