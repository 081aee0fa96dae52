# SPDX-License-Identifier: MIT
"""Laws of the ladder: each way alone does what it is for, and the order is data."""

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from cases import at_plane, bending, unit_mesh

from variform import forms, meshes
from variform.forms.solving.ladder import LADDER, Failure, Merit, Way
from variform.forms.solving.linear import presets
from variform.forms.solving.settings import Settings


def only(**what):
    """Settings with those ways of the ladder that do something."""
    found = tuple(
        way for way in LADDER if all(getattr(way, key) == value for key, value in what.items())
    )
    assert len(found) == 1
    return Settings(ladder=found)


def pulled(n=3):
    """A cube stretched to twice its length in one step: a minimization."""
    mesh = unit_mesh(3, n)
    u = forms.displacement(mesh)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0)
    moved = forms.translate(u, at_plane(mesh, 0, 1.0), (0.5, 0.0, 0.0))
    return psi * ufl.dx, u, [forms.clamp(u, at_plane(mesh, 0, 0.0)), moved]


def test_without_a_ladder_the_energy_is_all_there_is():
    """The search by the energy ends near the solution; |R| from there on is a way of its own."""
    potential, u, held = pulled()
    with pytest.raises(forms.NotConverged, match="the energy cannot be lowered further") as failed:
        forms.solve(potential, u, held, settings=Settings(ladder=()))
    assert np.all(u.x.array == 0) and "by way of" not in str(failed.value)
    alone = forms.solve(potential, u, held, settings=only(merit=Merit.RESIDUAL, back=False))
    assert alone.steps[0].convergence.tried == ("full tangent", "|R|")
    values = u.x.array.copy()
    u.x.array[:] = 0
    whole = forms.solve(potential, u, held)
    assert np.array_equal(u.x.array, values)
    assert whole.steps[0].convergence.residuals == alone.steps[0].convergence.residuals


def test_mumps_takes_the_place_of_multigrid(monkeypatch):
    """A preset that fails: without the way the solve ends, with it alone it converges."""
    failing = {**presets.multigrid(), "ksp_max_it": "1", "ksp_rtol": "1e-12"}
    monkeypatch.setattr(presets, "preset", lambda *given: failing)
    potential, u, held = pulled()
    near = tuple(way for way in LADDER if way.merit is Merit.RESIDUAL)
    load = potential + forms.body_force(u, (0.1, 0.0, 0.0))
    held = held[:1]  # nothing to be carried along, where MUMPS takes over by itself
    with pytest.raises(forms.NotConverged, match="linear solver failed"):
        forms.solve(load, u, held, settings=Settings(ladder=near))
    way = only(linear="direct").ladder
    path = forms.solve(load, u, held, settings=Settings(ladder=(*way, *near)))
    assert path.steps[0].convergence.tried[-1] == "|R| with MUMPS"


def test_a_scrambled_state_needs_the_projected_tangent():
    """Inner nodes thrown about: no descent along the full tangent, rest along the projected one."""
    body = meshes.block(MPI.COMM_SELF, (1.0, 1.0, 1.0), n=(4, 4, 4))
    u = forms.displacement(body)
    psi = forms.energies.stable_neo_hookean(forms.deformation_gradient(u), 1.0, 10.0)
    held = [forms.clamp(u, body.facets(name)) for name in body.boundaries]
    x = u.function_space.tabulate_dof_coordinates()
    rng = np.random.default_rng(2)
    inside = ((x > 0.01) & (x < 0.99)).all(axis=1)
    throw = np.where(inside[:, None], rng.uniform(-1, 1, x.shape), 0)
    near = tuple(way for way in LADDER if way.merit is Merit.RESIDUAL)
    ruined = Settings(ladder=near, ruined=1.0)  # nor is it seen at once
    u.x.array[:] = throw.ravel()
    with pytest.raises(forms.NotConverged):
        forms.solve(psi * ufl.dx, u, held, settings=ruined)
    ladder = (*only(tangent="projected").ladder, *near)
    path = forms.solve(psi * ufl.dx, u, held, settings=Settings(ladder=ladder, ruined=1.0))
    assert path.steps[0].convergence.projected > 0
    assert np.abs(u.x.array).max() < 1e-8


def test_full_steps_go_where_a_descent_creeps():
    """A slender beam by virtual work alone: |R| creeps, full steps from the start arrive."""
    body = meshes.block(MPI.COMM_SELF, (20.0, 1.0), n=(20, 1), cells="quadrilateral")
    u = forms.displacement(body, 2)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0)
    load = forms.dead_traction(u, ufl.as_vector([0.0, -5e-4]), body.ds("right"))
    R, held = forms.residual(psi * ufl.dx + load, u), [forms.clamp(u, body.facets("left"))]
    with pytest.raises(forms.NotConverged, match="the descent of .R. crept"):
        forms.solve(R, u, held, settings=Settings(ladder=()))
    path = forms.solve(R, u, held, settings=only(merit=Merit.NONE))
    assert path.steps[0].convergence.tried == ("|R|", "full steps")
    tip = forms.at(u, (20.0, 0.5))
    u.x.array[:] = 0
    forms.solve(psi * ufl.dx + load, u, held)
    assert forms.at(u, (20.0, 0.5)) == pytest.approx(tip, rel=1e-6)


def test_a_ladder_is_made_of_ways():
    with pytest.raises(ValueError, match=r"a tuple of forms.solving.ladder.Way .* got \['str'\]"):
        Settings(ladder=("full steps",))


def test_the_order_is_that_of_the_page(root):
    """forms/solving/README.md lists the ways as the ladder has them."""
    page = (root / "forms" / "solving" / "README.md").read_text()
    part = page.partition("<!-- ladder: written by a run -->")[2].partition("<!-- end of ladder")[0]
    listed = [line.partition(". ")[2] for line in part.strip().splitlines()]
    assert len(listed) == len(LADDER) == 9
    for line, way in zip(listed, LADDER, strict=True):
        assert line.startswith(way.words)
    # Corrections that do not shrink refuse a step of a path, where nothing else is to be tried.
    handled = {failure for way in LADDER for failure in way.on}
    assert handled == set(Failure) - {Failure.NO_CONTRACTION}
    assert all(isinstance(way, Way) for way in LADDER)


def test_a_search_that_creeps_gives_way_to_full_steps():
    """A U of a soft strip under a pressure that follows it: the same state, in half the steps."""

    def bent(**options):
        body = meshes.block(MPI.COMM_SELF, (12.0, 0.5), n=(24, 2), cells="quadrilateral")
        x, leg = body.mesh.geometry.x, 6.0 - 0.75 * np.pi
        s, b = x[:, 0] - 6.0, x[:, 1] - 0.25
        angle = np.clip(s, leg - 6.0, 6.0 - leg) / 1.5 - np.pi / 2
        x[:, 0], x[:, 1] = (1.5 + b) * np.cos(angle), (1.5 + b) * np.sin(angle)
        x[:, 1] += np.maximum(np.abs(s) - (6.0 - leg), 0.0)
        u = forms.displacement(body, 2)
        F = forms.deformation_gradient(u)
        psi = forms.energies.saint_venant_kirchhoff(F, 1.0, 2.0) * ufl.dx
        v = ufl.TestFunction(u.function_space)
        work = forms.follower_pressure(u, 2e-4, v, body.ds("bottom"))
        held = [forms.clamp(u, body.facets("left"))]
        path = forms.solve(psi, u, held, virtual_work=work, **options)
        return path.steps[0].convergence, u.x.array.copy()

    ours, u = bent()
    full, v = bent(options={"snes_linesearch_type": "basic"})
    assert ours.tried == ("|R|", "full steps") and ours.iterations <= full.iterations + 5 < 25
    assert np.abs(u - v).max() < 1e-7 * np.abs(v).max()
    patient, w = bent(settings=Settings(creeping=(10**6, 1.0)))
    assert patient.iterations > 2 * ours.iterations and np.abs(u - w).max() < 1e-7 * np.abs(w).max()


def test_settings_reach_what_they_name():
    """Sizes of presets, iterations, what is remembered: another number, another course."""
    potential, u, held = pulled()
    kinds = []
    for size in (0, 10_000):
        problem = forms.Problem(potential, u, held)
        newton = forms.solving.Newton(problem, settings=Settings(direct_up_to=size))
        kinds.append(newton.snes.getKSP().getType())
        newton.destroy()
    assert kinds == ["cg", "preonly"]
    with pytest.raises(forms.NotConverged, match="after 1 iterations"):
        forms.solve(potential, u, held, settings=Settings(most=1, ladder=()))
    plain, _ = bending()
    forgetful, _ = bending(settings=Settings(remembered=1))
    counts = [sum(s.convergence.iterations for s in p.steps) for p in (plain, forgetful)]
    assert counts[0] < counts[1]
