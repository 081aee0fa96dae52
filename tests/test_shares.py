# SPDX-License-Identifier: MIT
"""Contact of surfaces on several ranks: shares of the pairs add up, and 1, 2, 3 ranks agree."""

from mpi4py import MPI

import numpy as np
import pytest
from conftest import scripts
from stacks import stack

from variform import forms
from variform.forms import surface_contact

pytest.importorskip("ipctk", reason="ipctk, an optional package, is not installed")

RANKS = """
import json
from mpi4py import MPI
import ufl
from stacks import stack
from variform import forms
from variform.forms import contact

body = stack(MPI.COMM_WORLD, 3, 4, 0.01, dim=3)
t, u = forms.load_factor(body), forms.displacement(body)
psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0) * ufl.dx
term = forms.touching(u, body.ds("low face", "up face"), stiffness=1.0, dhat=0.02)
held = [forms.clamp(u, body.facets("low end"))]
held.append(forms.translate(u, body.facets("up end"), (0.03 * t, 0, -0.1 * t)))
path = forms.follow([psi, term], u, held, t, rtol=1e-11, ctol=1e-9, progress=False)
force, _ = forms.resultant(path, body.facets("up end"))
place = forms.at(u, (1.0, 1.0, 1.0))
own = contact.force(path, body.facets("up face"))
p, g = contact.pressure(path), contact.gap(path)
fields = [forms.integral(f * body.ds(s)) for f in (p, g) for s in ("up face", "low face")]
# Pushed on along the face, with friction.
upper = ufl.gt(ufl.SpatialCoordinate(body.mesh)[2], 1.005)
V = ufl.as_vector([ufl.conditional(upper, 1.0, 0.0), 0, 0])
t.value, held = 1.0, [forms.clamp(u, body.facets("low end"))]
free = forms.transient(
    [psi, term], u, held, t, to=1.02, dt=0.004, rho=1.0, velocity=V, rtol=1e-11, ctol=1e-9,
    scheme="bdf2", dissipation=forms.friction(term, 0.3, 0.1), progress=False,
)
moved = forms.at(u, (1.0, 1.0, 1.01))
lost = sum(row.dissipated for row in free.ledger)
if MPI.COMM_WORLD.rank == 0:
    print(json.dumps([*map(float, [*force, *place, *own, *fields, *moved, lost])]))
"""


@pytest.mark.slow
def test_ranks_agree_on_surfaces(run, tmp_path):
    """1, 2 and 3 ranks: forces, places, pressure, gap, a motion with friction: 1e-8."""
    start = scripts(run, tmp_path)
    one = start(RANKS, 1)
    assert abs(one[2]) > 0.1 and one[-1] > 1e-4
    for ranks in (2, 3):
        assert start(RANKS, ranks) == pytest.approx(one, rel=1e-8, abs=1e-9)


TAKEN_UP = """
import json
import sys
from pathlib import Path
from mpi4py import MPI
import ufl
from stacks import stack
from variform import forms

comm, ends, resumed = MPI.COMM_WORLD, [], 0.0
for name, stops in (("whole", (None,)), ("broken", (3, None))):
    for stop in stops:
        body = stack(comm, 3, 4, 0.01)
        t, u = forms.load_factor(body), forms.displacement(body)
        psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0) * ufl.dx
        term = forms.touching(u, body.ds("low face", "up face"), stiffness=1.0, dhat=0.02)
        held = [forms.clamp(u, body.facets("low end"))]
        held.append(forms.translate(u, body.facets("up end"), (0.03 * t, -0.1 * t)))

        def breaks(path):
            if len(path.steps) == stop:
                assert term.near()
                raise KeyboardInterrupt

        kept = forms.Checkpoint(Path(sys.argv[1]) / name, every=1)
        try:
            path = forms.follow(
                [psi, term], u, held, t, on_step=breaks, checkpoint=kept, progress=False, rtol=1e-10
            )
        except KeyboardInterrupt:
            continue
    ends.append([*forms.at(u, (1.0, 2.01)), *forms.resultant(path, body.facets("up end"))[0]])
# The same state again: to the bit.
problem, found = path.problem, []
last = u.x.array.copy()
for _ in range(2):
    u.x.array[:] = 0
    problem.prepare()
    u.x.array[:] = last
    problem.prepare()
    b, A = problem.create_vector(), problem.create_matrix()
    with b.localForm() as local:
        local.set(0)
    term.residual(b)
    K = term.coupling(A)
    found.append((b.array.tobytes(), *(v.tobytes() for v in K.getValuesCSR())))
same = all(comm.allgather(found[0] == found[1]))
if comm.rank == 0:
    print(json.dumps([bool(same), float(path.resumed), *(list(map(float, end)) for end in ends)]))
"""


@pytest.mark.slow
def test_a_path_on_ranks_is_taken_up(run, tmp_path):
    """Broken off it ends as the uninterrupted one, 1e-8; shares of a state are the same, bitwise.

    Not the path: MUMPS on ranks adds up in another order each time, which is 1e-13 of u.
    """
    start = scripts(run, tmp_path)
    for ranks in (2, 3):
        (tmp_path / str(ranks)).mkdir()
        same, resumed, whole, broken = start(TAKEN_UP, ranks, str(tmp_path / str(ranks)))
        assert same and 0 < resumed < 1 and whole[-2] < -0.1
        assert broken == pytest.approx(whole, rel=1e-8, abs=1e-10)


BY_MULTIGRID = """
import json
from mpi4py import MPI
import ufl
from stacks import stack
from variform import forms
from variform.forms.solving.linear.patch import touched
from variform.forms.solving.settings import Settings

comm = MPI.COMM_WORLD
body = stack(comm, 2, 3, 0.002, dim=3)
t, u = forms.load_factor(body), forms.displacement(body, 2)
psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0) * ufl.dx
floor = forms.obstacles.plane((0, 0, -0.01), (0, 0, 1))
psi += forms.obstacle(u, floor, body.ds("low end"), dhat=0.02, stiffness=1.0)
term = forms.touching(u, body.ds("low face", "up face"), stiffness=1.0, dhat=0.005)
held = [forms.roller(u, body.facets(f"side {k}"), k) for k in (0, 1)]
held.append(forms.translate(u, body.facets("up end"), (None, None, -0.02 * t)))
how = {"settings": Settings(direct_up_to=0, factorized_up_to=0), "rtol": 1e-11, "ctol": 1e-9}
path = forms.follow([psi, term], u, held, t, progress=False, **how)
acting = comm.allreduce(len(touched(path.problem)))
force, place = forms.contact.force(path), forms.at(u, (1.0, 1.0, 1.0))
if comm.rank == 0:
    print(json.dumps([acting, term.majorized, *map(float, [*force, *place])]))
"""


@pytest.mark.slow
def test_multigrid_in_contact_is_alike_on_ranks(run, tmp_path):
    """A block of all that obstacle and surfaces act on, shared out: the same nodes and forces."""
    start = scripts(run, tmp_path)
    one = start(BY_MULTIGRID, 1)
    # m^2 nodes on the floor and on both faces; rollers hold one number at m nodes on four sides.
    faces = [3 * m**2 - 4 * m for m in (5, 5, 7)]
    assert one[0] == sum(faces) and one[1] and abs(one[4]) > 0.01
    for ranks in (2, 3):
        assert start(BY_MULTIGRID, ranks) == pytest.approx(one, rel=1e-8, abs=1e-9)


def test_shares_of_pairs_add_up_to_all():
    """Energy, forces and tangent of 1, 3 and 7 shares are those of all pairs: 1e-13; all even."""
    body = stack(MPI.COMM_SELF, 3, 4, 0.01, dim=3)
    u = forms.displacement(body)
    term = forms.touching(u, body.ds("low face", "up face"), stiffness=1.0, dhat=0.02)
    x = term.surface.places()
    x[:, :2] += 0.002 * np.random.default_rng(1).standard_normal((len(x), 2))
    pairs, how = term.pairs_at(x), term.ipc.PSDProjectionMethod.CLAMP

    def found(of):
        V, of = term.potential, (of, term.mesh, x)
        return [V(*of), V.gradient(*of), V.hessian(*of, how).toarray()]

    for size in (1, 3, 7):
        shares = [surface_contact.share(pairs, rank, size) for rank in range(size)]
        counts = [len(each) for each in shares]
        assert sum(counts) == len(pairs) and max(counts) - min(counts) <= 4
        for whole, parts in zip(found(pairs), zip(*map(found, shares), strict=True), strict=True):
            assert np.abs(sum(parts) - whole).max() < 1e-13 * np.abs(whole).max()
    # More ranks than pairs: some have nothing to do.
    none = term.pairs_at(x + np.where(x[:, 2:] > 1.005, [0, 0, 0.1], 0))
    assert surface_contact.share(none, 1, 2).empty()
