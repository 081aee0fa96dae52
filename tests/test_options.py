# SPDX-License-Identifier: MIT
"""Laws of PETSc's options: wherever the user sets them they hold, and they stay the user's."""

import json
import sys

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest
import ufl
from cases import at_plane, bending, unit_mesh

from variform import forms, meshes
from variform.forms.solving.linear import presets as linear_presets
from variform.forms.solving.options import SolverOptions


@pytest.fixture
def scene():
    """A square under traction: its potential, unknown and supports."""
    body = meshes.block(MPI.COMM_SELF, (1.0, 1.0), n=2)
    u = forms.displacement(body)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0)
    load = forms.dead_traction(u, ufl.as_vector([0.1, 0.0]), body.ds("right"))
    return psi * ufl.dx + load, u, [forms.clamp(u, body.facets("left"))]


@pytest.fixture
def database():
    """PETSc's options, emptied of what a test has put there."""
    options, before = PETSc.Options(), set(PETSc.Options().getAll())
    yield options
    for name in set(options.getAll()) - before:
        options.delValue(name)


def test_the_database_holds_and_stays(scene, database):
    """PETSc.Options() goes over presets and options=, and is the same after the solve."""
    database["variform_snes_max_it"] = 1
    database["variform_snes_linesearch_type"] = "basic"
    for options in (None, {"snes_max_it": 40}):
        with pytest.raises(forms.NotConverged, match="stopped after 1 iterations"):
            forms.solve(*scene, options=options)
    assert database.getInt("variform_snes_max_it") == 1
    assert database.getString("variform_snes_linesearch_type") == "basic"
    assert forms.solve(*scene, prefix="other_").completed


def test_a_solver_leaves_nothing_behind(scene, database):
    """After a solve the database is what it was, presets and options= gone."""
    before = database.getAll()
    forms.solve(*scene, options={"snes_max_it": 40})
    assert database.getAll() == before


def test_values_with_blanks_arrive_whole(database):
    """A value of several words, which PETSc's list of all options splits, is copied whole."""
    database["blank_view"] = "ascii:a file:ascii_info -append"
    options = SolverOptions("blank_")
    options.apply({"ksp_type": "cg"})
    assert options.user == {"view": "ascii:a file:ascii_info -append"}
    assert database.getString(f"{options.prefix}view") == "ascii:a file:ascii_info -append"
    options.clear()


def test_two_solvers_share_nothing(scene, database):
    """A second Newton that ends takes none of the first one's options with it."""
    before = database.getAll()  # of solvers that other tests have left alive, too
    system = forms.Problem(*scene)
    first = forms.solving.Newton(system, {"snes_max_it": 7, "ksp_type": "gmres"})
    second = forms.solving.Newton(system, {"snes_max_it": 9})
    kinds = [newton.snes.getKSP().getType() for newton in (first, second)]
    assert kinds == ["gmres", "preonly"]
    second.destroy()
    first.snes.setFromOptions()
    assert first.snes.getTolerances()[3] == 7
    assert first.snes.getKSP().getType() == "gmres"
    first.predict()
    assert first.solve().converged
    first.destroy()
    assert database.getAll() == before


SOURCES = """
import json, sys
from mpi4py import MPI
from petsc4py import PETSc
import ufl
from variform import forms, meshes

body = meshes.block(MPI.COMM_SELF, (1.0, 1.0), n=2)
u = forms.displacement(body)
psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0)
potential = psi * ufl.dx + forms.dead_traction(u, ufl.as_vector([0.1, 0.0]), body.ds("right"))
found = {}
for prefix in sys.argv[1].split(","):
    problem = forms.Problem(potential, u, [forms.clamp(u, body.facets("left"))])
    newton = forms.solving.Newton(problem, prefix=prefix)
    found[prefix] = newton.snes.getTolerances()[3]
    newton.destroy()
    newton = forms.solving.Newton(problem, prefix=prefix)  # the options were not taken away
    found[prefix] = [found[prefix], newton.snes.getTolerances()[3]]
    newton.predict()
    newton.solve()
    newton.destroy()
print(json.dumps(found))
"""


def test_files_variables_and_the_command_line(run, tmp_path, monkeypatch):
    """-options_file, .petscrc, $PETSC_OPTIONS and the command line hold, the last one most."""
    (tmp_path / "script.py").write_text(SOURCES)
    (tmp_path / "options.txt").write_text("-file_snes_max_it 11\n-both_snes_max_it 12\n")
    (tmp_path / ".petscrc").write_text("-home_snes_max_it 13\n")
    monkeypatch.setenv("PETSC_OPTIONS", "-variable_snes_max_it 14 -line_snes_max_it 15")
    line = ["-line_snes_max_it", 16, "-both_snes_max_it", 17, "-options_file", "options.txt"]
    done = run("script.py", "file_,home_,variable_,line_,both_", *line, cwd=tmp_path)
    assert json.loads(done.stdout) == {
        "file_": [11, 11],
        "home_": [13, 13],
        "variable_": [14, 14],
        "line_": [16, 16],
        "both_": [17, 17],
    }
    # PETSc would name options that were given and not used.
    assert "not used" not in done.stdout + done.stderr


def test_a_volume_held_reads_the_database_too(scene, database, capfd):
    """Control and arc_length: the same options as solve's, and a view that shows them."""
    potential, u, supports = scene
    q = forms.load_factor(u.function_space.mesh)
    load = forms.dead_traction(u, ufl.as_vector([0.0, 0.1 * q]), ufl.ds(domain=q.ufl_domain()))
    database["variform_pc_type"] = "lu"
    database["variform_ksp_view"] = None
    path = forms.arc_length(potential + load, u, supports, q, step=0.1, steps=1, progress=False)
    assert len(path.steps) == 1
    sys.stdout.flush()
    assert "type: lu" in capfd.readouterr().out
    assert database.hasName("variform_pc_type")


@pytest.mark.parametrize(
    ("options", "looser"),
    [
        ({"snes_rtol": 1e-2}, True),
        ({"snes_atol": 1e-3}, True),
        ({"snes_type": "newtontr"}, False),
        ({"snes_linesearch_type": "l2"}, False),
        ({"ksp_type": "gmres", "pc_type": "ilu", "ksp_rtol": 1e-10}, False),
    ],
)
def test_options_reach_petsc(options, looser):
    """PETSc's tolerances, globalizations and linear solvers are chosen by its own names."""
    plain, _ = bending()
    chosen, _ = bending(options=options, ctol=1.0 if looser else 1e-6)
    distance = np.abs(plain.u.x.array - chosen.u.x.array).max()
    assert (distance > 1e-6) == looser


def test_a_line_search_of_ones_own_leaves_supports_where_they_are_prescribed():
    """It may shorten a step, but not the way to moved supports: the path is the plain one."""
    found = []
    for options in ({}, {"snes_linesearch_type": "l2"}):
        body = meshes.block(MPI.COMM_SELF, (1.0, 0.2, 0.2), h=0.2)
        u, t = forms.displacement(body), forms.load_factor(body)
        psi = forms.energies.fixed_corotated(forms.deformation_gradient(u), 1.0, 10.0)
        turn = forms.rotate(u, body.facets("right"), angle=t, axis=(1, 0, 0))
        supports = [forms.clamp(u, body.facets("left")), turn]
        forms.follow(psi * ufl.dx, u, supports, t, to=2.0, options=options, progress=False)
        found.append(u.x.array.copy())
    assert np.abs(found[1] - found[0]).max() < 1e-5


def test_options_end_with_their_solve():
    """A solve's options do not reach the next one with its prefix; misspelled ones are named."""
    with pytest.warns(UserWarning, match="did not use the options snes_typ: are they") as said:
        bending(options={"snes_typ": "newtontr"})
    assert [warning.filename for warning in said] == [bending.__code__.co_filename]
    with pytest.raises(forms.NotConverged):
        bending(options={"snes_max_it": 1}, min_step=0.09)
    path, _ = bending()
    assert max(s.convergence.iterations for s in path.steps) > 1


def test_an_absolute_tolerance_is_named():
    path, _ = bending(options={"snes_atol": 1e-3}, ctol=1.0)
    assert path.steps[0].convergence.reason == "snes_atol = 0.001 reached"


@pytest.mark.parametrize("linear", ["cholesky", "gamg"])
def test_linear_solvers_agree(linear):
    """Multigrid with rigid body modes and the factorization reach the same solution."""
    mesh = unit_mesh(3, 4)
    u = forms.displacement(mesh)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0) * ufl.dx
    supports = [
        forms.clamp(u, at_plane(mesh, 0, 0.0)),
        forms.translate(u, at_plane(mesh, 0, 1.0), (0.0, 0.3, 0.0)),
    ]
    options = linear_presets.multigrid() if linear == "gamg" else {}
    path = forms.solve(psi, u, supports, options=options, prefix=f"{linear}_", rtol=1e-12)
    ksp_its = path.steps[0].convergence.linear_iterations
    assert (ksp_its > path.steps[0].convergence.iterations) == (linear == "gamg")
    assert forms.at(u, (0.5, 0.5, 0.5)) == pytest.approx(MIDDLE, rel=1e-8, abs=1e-10)


@pytest.mark.parametrize("pc", ["cholesky", "jacobi", "gamg"])
def test_a_trust_region_reaches_the_same_state(pc):
    """SNES newtontr with Steihaug's conjugate gradients, by options alone."""
    mesh = unit_mesh(3, 4)
    u = forms.displacement(mesh)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0) * ufl.dx
    supports = [
        forms.clamp(u, at_plane(mesh, 0, 0.0)),
        forms.translate(u, at_plane(mesh, 0, 1.0), (0.0, 0.3, 0.0)),
    ]
    options = {"snes_type": "newtontr", "ksp_type": "stcg", "pc_type": pc, "snes_max_it": 100}
    path = forms.solve(psi, u, supports, options=options, prefix="trust_", rtol=1e-12)
    assert path.steps[0].convergence.negative is None
    assert forms.at(u, (0.5, 0.5, 0.5)) == pytest.approx(MIDDLE, rel=1e-8, abs=1e-9)


MIDDLE = [0.0, 0.15, 0.0]  # by the point symmetry of the sheared cube about its middle
