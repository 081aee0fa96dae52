# SPDX-License-Identifier: MIT
"""Laws: a measure written as a list of entities counts each once, and lists what the mesh has."""

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh

from variform import forms
from variform.forms import energies

LISTED = """
import json
from mpi4py import MPI
import numpy as np, ufl
from dolfinx import cpp, fem, mesh
from variform import forms

COMM = MPI.COMM_WORLD
body = mesh.create_unit_square(COMM, 9, 9, ghost_mode=mesh.GhostMode.shared_facet)
topology = body.topology
for pair in ((1, 2), (2, 1)):
    topology.create_connectivity(*pair)
cells = topology.index_map(2)
everything = np.arange(cells.size_local + cells.num_ghosts, dtype=np.int32)
of_cells, of_facets = topology.connectivity(2, 1), topology.connectivity(1, 2)
outside, inside = [], []
for facet in range(of_facets.num_nodes):
    beside = of_facets.links(facet)
    sides = [(c, list(of_cells.links(c)).index(facet)) for c in beside]
    # A facet of one known cell only may lie between a ghost and a cell of another rank.
    middle = mesh.compute_midpoints(body, 1, np.array([facet], np.int32))[0]
    if np.isclose(middle[:2], 0).any() or np.isclose(middle[:2], 1).any():
        outside += sides
    elif len(sides) == 2:
        inside.append(sides)
u = forms.displacement(body, 2)
u.interpolate(lambda x: (0.1 * np.sin(5 * x[0]), 0.05 * x[0] * x[1]))
psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0)
operator = forms.energies.fixed_corotated(forms.deformation_gradient(u), 1.0, 2.0)
jump = ufl.inner(ufl.jump(ufl.grad(u)), ufl.jump(ufl.grad(u)))


def numbers(potential):
    system = forms.Problem(potential, u)
    A, b = system.create_matrix(), system.create_vector()
    system.tangent(A)
    system.residual(b)
    return [system.energy(), b.norm(), A.norm(), forms.integral(potential)]


def listed(name, entities):
    return ufl.Measure(name, body, subdomain_data=[(1, np.array(entities, np.int32))])(1)


found = [
    [numbers(psi * listed("dx", everything)), numbers(psi * ufl.dx)],
    [numbers(operator * listed("dx", everything)), numbers(operator * ufl.dx)],
    [numbers(psi * listed("ds", outside)), numbers(psi * ufl.ds)],
    [numbers(operator * listed("ds", np.ravel(outside))), numbers(operator * ufl.ds)],
    [numbers(jump * listed("dS", inside)), numbers(jump * ufl.dS)],
]
if COMM.rank == 0:
    print(json.dumps(found))
"""


@pytest.mark.parametrize("ranks", [1, 2, 3])
def test_ghosts_in_a_list_count_once(parallel, ranks):
    """A list of all cells (facets) that a rank knows is integrated as dx (ds, dS) is, to rounding.

    Each sum has the order of its own list: sqrt(n) eps of n = 162 cells, tenfold.
    """
    for ours, usual in parallel(LISTED, ranks):
        assert usual[0] > 1e-4
        assert ours == pytest.approx(usual, rel=3e-14)


WRONG = """
import sys
from mpi4py import MPI
import numpy as np, ufl
from dolfinx import mesh
from variform import forms

body = mesh.create_unit_square(MPI.COMM_WORLD, 4, 4)
cells = np.arange(3) if MPI.COMM_WORLD.rank == 0 else np.array([0, 4711])
u = forms.displacement(body)
psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0)
dx = ufl.Measure("dx", body, subdomain_data=[(1, cells.astype(np.int32))])
try:
    forms.Problem(psi * dx(1), u)
except ValueError as error:
    sys.stdout.write(f"refused: {error}\\n")  # at once: the ranks share the stream
"""


def test_a_cell_that_one_rank_does_not_have_is_refused_on_all(run, tmp_path):
    """A number outside the mesh on one rank: the same sentence on both, and no rank waits."""
    (tmp_path / "script.py").write_text(WRONG)
    lines = run(tmp_path / "script.py", ranks=2).stdout.splitlines()
    assert len(lines) == 2 and lines[0] == lines[1]
    assert "subdomain 1 of a measure over cells lists cells: the cells of rank 1 are" in lines[0]
    assert lines[0].endswith("got 4711.")


@pytest.mark.parametrize(
    ("kind", "entities", "sentence"),
    [
        ("dx", [-1, 0], r"cells of rank 0 are 0 to 7, got -1\."),
        ("dx", [0.0, 1.5], r"whole numbers, 1 to an entity, got float64 of shape \(2,\)\."),
        ("ds", [0, 1, 2], r"pairs \(cell, local facet\): whole numbers, 2 to an entity, got int64"),
        ("ds", [[0, 3]], r"the facets of a cell are 0 to 2, got 3\."),
        ("ds", [[8, 0]], r"the cells of rank 0 are 0 to 7, got 8\."),
        ("dS", [[0, 1, 9, 1]], r"the cells of rank 0 are 0 to 7, got 9\."),
    ],
)
def test_entities_that_are_none_are_refused(kind, entities, sentence):
    """Numbers out of range, of another kind, or not as many as an entity has."""
    body = mesh.create_unit_square(MPI.COMM_SELF, 2, 2)
    measure = ufl.Measure(kind, body, subdomain_data=[(3, np.array(entities))])
    one = fem.Constant(body, 1.0)
    with pytest.raises(ValueError, match=r"^subdomain 3 of a measure over .*" + sentence):
        forms.integral((one("+") if kind == "dS" else one) * measure(3))


def test_a_form_on_other_cells_is_refused():
    """A matrix has places for the cells of its form: another form's are not written anywhere."""
    body = mesh.create_unit_square(MPI.COMM_SELF, 2, 2)
    u = forms.displacement(body)
    psi = energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0)

    def tangent_on(cells):
        dx = ufl.Measure("dx", body, subdomain_data=[(1, np.array(cells, np.int32))])
        return forms.Problem(psi * dx(1), u)

    system, other = tangent_on([0, 1, 2]), tangent_on([0, 1, 2, 3, 7])
    A = system.create_matrix()
    with pytest.raises(ValueError, match="2 cells or facets of the form are none of those"):
        other.tangent(A)
    system.tangent(A)
    assert A.norm() > 1
