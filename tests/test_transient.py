# SPDX-License-Identifier: MIT
"""transient: every kind of body, restart, ranks, load tables, lumped mass, settle, bad input."""

import shutil
from math import pi

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from conftest import scripts
from test_motion import beam

from variform import forms, meshes
from variform.forms import dissipation

RHO = 2.0


def tube():
    """A slice of a thick tube under a pressure that comes and goes, a body of revolution."""
    body = meshes.block(MPI.COMM_SELF, (1.0, 0.5), n=(3, 1), cells="quadrilateral", origin=(1, 0))
    t, u = forms.load_factor(body), forms.displacement(body)
    psi = forms.energies.neo_hookean(forms.axisymmetric(u), 10.0, 20.0)
    potential = psi * forms.circumference(u) * ufl.dx
    potential += forms.pressure_potential(u, 3 * ufl.sin(8 * t), body.ds("left"))
    held = [forms.roller(u, body.facets(name), 1) for name in ("bottom", "top")]
    X = ufl.SpatialCoordinate(body.mesh)
    return body, potential, u, held, t, RHO * 2 * pi * X[0], {}


def sheet():
    """A flat membrane, stretched and let go."""
    body = meshes.square(MPI.COMM_SELF, 1.0, 0.34)
    t, u = forms.load_factor(body), forms.displacement(body)
    psi = forms.energies.neo_hookean_sheet(forms.membrane_gradient(u), 5.0)
    X = ufl.SpatialCoordinate(body.mesh)
    sides = np.concatenate([body.facets(name) for name in ("left", "right", "bottom", "top")])
    edge = forms.prescribe(u, sides, [0.1 * X[0], 0.1 * X[1], 0.0])
    potential = 0.1 * psi * ufl.dx - forms.gravity(u, 0.05)
    return body, potential, u, [edge], t, RHO * 0.1, {"thickness": 0.1}


def soft():
    """A nearly incompressible beam, displacement and pressure."""
    body = meshes.block(MPI.COMM_SELF, (1.0, 0.3), n=(4, 1), cells="quadrilateral")
    t, w = forms.load_factor(body), forms.displacement_pressure(body)
    F = forms.deformation_gradient(w["u"])
    psi = forms.energies.isochoric_neo_hookean(F, 20.0)
    psi = forms.energies.with_pressure(psi, F, w["p"], 1e3)
    potential = psi * ufl.dx + forms.gravity(w["u"], RHO)
    return body, potential, w, [forms.clamp(w, body.facets("left"))], t, RHO, {}


@pytest.mark.parametrize("scheme", ["newmark", "midpoint", "bdf2"])
@pytest.mark.parametrize("kind", [tube, sheet, soft])
def test_every_kind_of_body_moves(kind, scheme):
    """Kinetic energy is that of rho with thickness or circumference; every joule is there."""
    _, potential, u, held, t, density, options = kind()
    path = forms.transient(
        *(potential, u, held, t), to=0.2, rho=RHO, scheme=scheme, progress=False, **options
    )
    v = path.velocity if kind is not soft else ufl.split(path.velocity)[0]
    kinetic = forms.integral(density / 2 * ufl.inner(v, v) * ufl.dx(degree=4))
    assert path.record("kinetic")[-1] == pytest.approx(kinetic, rel=1e-10) and kinetic > 1e-5
    assert path.ledger.missed < 2e-3 * path.ledger.exchanged
    assert all(step.bounds is None or step.bounds.lower > 0 for step in path.steps)


def test_steps_end_on_times_and_on_kinks():
    """Each of `to`, and where a table of a load bends; with dt, on its multiples."""
    body, psi, u, supports, t = beam(1)
    push = forms.table(t, [0, 0.013, 0.05], [0, 1, 0])
    psi += forms.dead_traction(u, (0, push), body.ds("top"))
    path = forms.transient(psi, u, supports, t, to=[0.021, 0.06], rho=1.0, progress=False)
    times = {step.load for step in path.steps}
    assert {0.013, 0.021, 0.05, 0.06} <= times
    t.value, u.x.array[:] = 0, 0
    path = forms.transient(psi, u, supports, t, to=0.06, rho=1.0, dt=0.004, progress=False)
    grid = {round(0.004 * n, 12) for n in range(1, 16)}
    assert grid | {0.013, 0.05} == {round(step.load, 12) for step in path.steps}


def test_lumped_masses_add_up():
    """The sum is the body's mass, off the diagonal there is nothing; refused where not positive."""
    for degree, cells in ((1, "quadrilateral"), (2, "quadrilateral"), (1, "triangle")):
        body = meshes.block(MPI.COMM_SELF, (1.0, 0.5), n=2, cells=cells)
        t, u = forms.load_factor(body), forms.displacement(body, degree)
        psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 1.0) * ufl.dx
        path = forms.transient(
            *(psi, u, (), t), to=0.1, rho=RHO, lumped=True, velocity=(1.0, 0.0), progress=False
        )
        M = path.problem.motion.inertia.matrix()
        dense = M.convert("dense").getDenseArray()
        assert np.abs(dense - np.diag(np.diag(dense))).max() < 1e-14 and np.diag(dense).min() > 0
        assert path.record("momentum")[-1] == pytest.approx([RHO * 0.5, 0], abs=1e-12)
        assert u.x.array.reshape(-1, 2)[:, 0] == pytest.approx(0.1, rel=1e-9)
    body = meshes.block(MPI.COMM_SELF, (1.0, 0.5), n=2)
    t, u = forms.load_factor(body), forms.displacement(body, 2)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 1.0) * ufl.dx
    with pytest.raises(
        ValueError, match=r"lumped mass needs linear elements.*degree 2 on triangles"
    ):
        forms.transient(psi, u, (), t, to=0.1, rho=RHO, lumped=True)


def test_damping_by_mass_fades_as_its_formula_says():
    """A bar's first axial vibration falls with exp(-alpha t / 2)."""
    body = meshes.block(MPI.COMM_SELF, (1.0, 0.1), n=(16, 1), cells="quadrilateral")
    t, u = forms.load_factor(body), forms.displacement(body)
    psi = forms.energies.saint_venant_kirchhoff(forms.deformation_gradient(u), 0.5, 0.0) * ufl.dx
    X, speed = ufl.SpatialCoordinate(body.mesh), 1e-4
    held = [forms.clamp(u, body.facets("left")), forms.roller(u, body.facets("bottom"), 1)]
    path = forms.transient(
        *(psi, u, held, t), to=16.0, rho=1.0, dt=0.02, progress=False,
        velocity=(speed * ufl.sin(pi / 2 * X[0]), 0), dissipation=dissipation.mass_damping(0.2),
    )  # fmt: skip
    kinetic, time = path.record("kinetic"), np.array([step.load for step in path.steps])
    peaks = [k for k in range(1, len(time) - 1) if kinetic[k] > max(kinetic[k - 1], kinetic[k + 1])]
    rate = -np.polyfit(time[peaks], np.log(kinetic[peaks]), 1)[0]
    assert rate == pytest.approx(0.2, rel=0.01)
    omega = pi / np.mean(np.diff(time[peaks]))
    assert omega == pytest.approx(np.sqrt((pi / 2) ** 2 - 0.01), rel=2e-3)


def test_an_arch_settles_beyond_its_limit_point():
    """Where follow stops, settle goes on to a stable state of lower energy; the joules add up."""
    body = meshes.block(MPI.COMM_SELF, (50.0, 1.0), n=(20, 1), cells="quadrilateral")
    x = body.mesh.geometry.x
    x[:, 1] += 5.0 * np.sin(pi * x[:, 0] / 100)
    q, u = forms.load_factor(body), forms.displacement(body, 2)
    psi = forms.energies.saint_venant_kirchhoff(forms.deformation_gradient(u), 0.5, 0.0) * ufl.dx
    psi += forms.body_force(u, ufl.as_vector([0 * q, -1e-5 * q]))
    held = [forms.clamp(u, body.facets("left")), forms.roller(u, body.facets("right"), 0)]
    with pytest.raises(forms.NotConverged, match=r"no equilibrium.*forms\.settle"):
        forms.follow(psi, u, held, q, to=3.0, progress=False)
    peak, before = float(q.value), forms.at(u, (50.0, 5.0))[1]
    path = forms.settle(psi, u, held, q, to=1.01 * peak, progress=False)
    assert q.value == 1.01 * peak and path.reason.startswith("At rest at t = ")
    account = path.ledger
    released = -sum(row.stored for row in account)
    lost = sum(row.scheme + row.dissipated for row in account)
    assert released > 0 and lost == pytest.approx(released, rel=1e-3)
    assert account.missed < 1e-3 * account.exchanged
    assert forms.negative_eigenvalues(path) == path.steps[-1].convergence.negative == 0
    assert forms.at(u, (50.0, 5.0))[1] < before - 4
    assert path.problem.motion is None and not path.velocity.x.array.any()
    with pytest.raises(ValueError, match="settle needs time > 0, got -1"):
        forms.settle(psi, u, held, time=-1)
    u.x.array[:] = 0
    with pytest.raises(forms.NotConverged, match=r"still moves at t = 1: give it more time="):
        forms.settle(psi, u, held, time=1.0, progress=False)


MOVE = """
import json, sys
from mpi4py import MPI
import numpy as np, ufl
from variform import forms, meshes
from variform.forms import dissipation

folder, last = sys.argv[1], int(sys.argv[2])
body = meshes.block(MPI.COMM_WORLD, (1.0, 0.2, 0.2), n=(5, 2, 2))
t, u = forms.load_factor(body), forms.displacement(body)
psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 40.0, 80.0) * ufl.dx
psi += forms.gravity(u, 1.0)
X = ufl.SpatialCoordinate(body.mesh)
spin = ufl.as_vector([0.1, -3 * X[2], 3 * X[1]])
shake = forms.translate(u, body.facets("left"), (0, 0, 0.05 * ufl.sin(9 * t)))


def stop(path):
    if len(path.steps) == last:
        raise StopIteration


found = {}
for scheme, held in (("bdf2", [shake]), ("midpoint", [])):
    u.x.array[:], t.value = 0, 0
    try:
        path = forms.transient(
            psi, u, held, t, to=0.1, rho=1.0, scheme=scheme, velocity=spin, rtol=1e-10,
            dissipation=dissipation.kelvin_voigt(0.1), progress=False, on_step=stop,
            checkpoint=forms.Checkpoint(f"{folder}-{scheme}", every=7),
        )
    except StopIteration:
        continue
    tip = forms.at(u, (1.0, 0.2, 0.2))
    speed = forms.at(path.velocity, (1.0, 0.2, 0.2))
    force, _ = forms.resultant(path, body.facets("left"))
    row = path.ledger[-1]
    numbers = [*tip, *speed, *force, path.record("kinetic")[-1], row.dissipated, row.supports]
    found[scheme] = {
        "numbers": numbers, "bits": [float(x).hex() for x in numbers], "steps": len(path.steps),
        "missed": path.ledger.missed / path.ledger.exchanged, "resumed": path.resumed,
    }
if MPI.COMM_WORLD.rank == 0:
    print(json.dumps(found))
"""


@pytest.mark.slow
def test_motions_are_alike_on_any_ranks_and_taken_up(run, tmp_path):
    """1, 2 and 3 ranks to 1e-8; taken up on as many ranks to the last bit, on others to 1e-8."""
    start = scripts(run, tmp_path)
    whole = {ranks: start(MOVE, ranks, f"whole{ranks}", 0) for ranks in (1, 2, 3)}
    start(MOVE, 2, "parts", 16)
    for scheme in ("bdf2", "midpoint"):
        shutil.copytree(tmp_path / f"parts-{scheme}", tmp_path / f"others-{scheme}")
    again, others = start(MOVE, 2, "parts", 0), start(MOVE, 3, "others", 0)
    for scheme in ("bdf2", "midpoint"):
        first = whole[1][scheme]
        assert again[scheme]["resumed"] and others[scheme]["resumed"]
        assert again[scheme]["bits"] == whole[2][scheme]["bits"]
        for run_ in (whole[2], whole[3], others):
            assert run_[scheme]["numbers"] == pytest.approx(first["numbers"], rel=1e-8, abs=1e-9)
            assert run_[scheme]["steps"] == first["steps"] > 20 and run_[scheme]["missed"] < 2e-3


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({}, "a motion needs the mass density, rho = 1000.0"),
        ({"rho": 0.0}, "a motion needs a mass density rho > 0 .kg/m.3., got 0"),
        ({"rho": -1}, "rho > 0 .kg/m.3., got -1"),
        ({"rho": (1, 2)}, "rho is a number or a scalar in UFL, got tuple"),
        ({"rho": 1.0, "dt": 0}, "a motion needs dt > 0, got 0"),
        ({"rho": 1.0, "tolerance": -1.0}, "a motion needs tolerance > 0"),
        ({"rho": 1.0, "to": 0.0}, "times ascend from the present one, t = 0, got to = 0.0"),
        ({"rho": 1.0, "to": [0.2, 0.1]}, "times ascend"),
        ({"rho": 1.0, "scheme": "rk4"}, "a scheme is one of euler, bdf2, newmark, midpoint"),
        ({"rho": 1.0, "scheme": 3}, "a scheme is one of .*, got int"),
        ({"rho": 1.0, "dissipation": 0.1}, "dissipation takes what forms.dissipation returns"),
        ({"rho": 1.0, "velocity": (1.0,)}, "a velocity needs the shape"),
    ],
)
def test_bad_input_of_a_motion_is_one_sentence(options, words):
    """Before anything is solved."""
    _, psi, u, supports, t = beam(1)
    with pytest.raises(ValueError, match=words) as caught:
        forms.transient(psi, u, supports, t, **{"to": 0.1, "progress": False, **options})
    assert str(caught.value).count(". ") == 0


def test_what_is_no_time_is_refused():
    """A float, a Function, nothing; negative viscosities; a motion's problem again."""
    body, psi, u, supports, t = beam(1)
    for time in (0.5, u, None):
        with pytest.raises(ValueError, match="a motion needs its time, the load factor of"):
            forms.transient(psi, u, supports, time, rho=1.0)
    for make in (
        lambda: dissipation.kelvin_voigt(-1.0),
        lambda: dissipation.mass_damping(-1.0),
        lambda: dissipation.dashpots(-1.0, body.ds),
    ):
        with pytest.raises(ValueError, match="not negative"):
            make()
    with pytest.raises(ValueError, match=r"got eta of type Unknown and shape \(2,\)"):
        dissipation.kelvin_voigt(u, 0.1)
    path = forms.transient(psi, u, supports, t, to=0.01, rho=1.0, progress=False)
    with pytest.raises(ValueError, match="needs a problem of statics"):
        forms.transient(path.problem, t=t, to=0.02, rho=1.0)
