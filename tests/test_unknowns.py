# SPDX-License-Identifier: MIT
"""Laws of unknowns: fields go by name and role, whatever their number, element and order."""

import json

from mpi4py import MPI

import basix.ufl
import numpy as np
import pytest
import ufl
from cases import unit_mesh, whole
from dolfinx import fem
from scipy.optimize import brentq

from variform import forms, meshes
from variform.forms import unknowns

PROBLEMS = """
import json
from mpi4py import MPI
import numpy as np, ufl
from variform import forms, meshes
from variform.forms import Role

COMM = MPI.COMM_WORLD
found = {}


def heated(clamped, order):
    "A bar that is 10 K warmer, between rollers: psi(F / (1 + alpha theta)) and steady conduction."
    body = meshes.block(COMM, (1.0, 1.0, 1.0), n=(2, 2, 2))
    fields = dict(theta=(("Lagrange", 1), Role.SCALAR))
    fields["u"] = ("Lagrange", 2, (3,)), Role.DISPLACEMENT
    w = forms.unknown(body, **{name: fields[name] for name in order})
    theta = w["theta"]
    psi = forms.energies.neo_hookean(forms.deformation_gradient(w["u"]) / (1 + 0.02 * theta), 1, 2)
    eta = ufl.split(ufl.TestFunction(w.function_space))[w.fields["theta"].place]
    R = forms.residual(psi * ufl.dx, w["u"])
    R += 3 * ufl.inner(ufl.grad(theta), ufl.grad(eta)) * ufl.dx
    sides = ["left", "front", "bottom"] + ["right"] * clamped
    held = [forms.roller(w, body.facets(side), "xyz".index(axis))
            for side, axis in zip(sides, "xyzx")]
    held += [forms.prescribe(theta, body.facets(side), 10.0) for side in ("left", "right")]
    forms.solve(R, w, held, rtol=1e-12, ctol=1e-10)
    moved = forms.at(forms.displacement_of(w), (1.0, 1.0, 1.0))
    return [*moved, *forms.at(forms.field(theta, body), (0.5, 0.5, 0.5))]


for clamped in False, True:
    found[f"heated, {clamped}"] = heated(clamped, ("u", "theta"))
found["heated, other order"] = heated(True, ("theta", "u"))


def stretched(cells, element, pressure, fields):
    "Two or three fields: displacement, pressure, and the volume ratio J~ that it is the price of."
    body = meshes.block(COMM, (1.0, 1.0, 1.0), n=(2, 2, 2), cells=cells)
    t = forms.load_factor(body)
    others = dict(p=(pressure, Role.PRESSURE), J=(pressure, Role.SCALAR))
    w = forms.unknown(body, u=((element, 2, (3,)), Role.DISPLACEMENT),
                      **{name: others[name] for name in "pJ"[: fields - 1]})
    F, p = forms.deformation_gradient(w["u"]), w["p"]
    if fields == 3:
        w.put("J", 1.0)
        Jt = w["J"]
        psi = (ufl.det(F) ** (-2 / 3) * ufl.inner(F, F) - 3) / 2
        psi += 25 * (Jt - 1) ** 2 + p * (ufl.det(F) - Jt)
    else:
        psi = (ufl.det(F) ** (-2 / 3) * ufl.inner(F, F) - 3) / 2
        psi += p * (ufl.det(F) - 1) - p**2 / 100
    held = [forms.clamp(w, body.facets("left")),
            forms.translate(w, body.facets("right"), (0.3 * t, 0.1 * t, 0))]
    path = forms.follow(psi * ufl.dx(degree=4), w, held, t, step=0.5, progress=False,
                        rtol=1e-12, ctol=1e-10)
    force, _ = forms.resultant(path, body.facets("right"))
    stable = {s.convergence.negative for s in path.steps} == {0}
    return [*forms.at(forms.displacement_of(w), (0.5, 1, 1)), *force, float(stable)]


for fields in 2, 3:
    found[f"P2, {fields}"] = stretched("tetrahedron", "Lagrange", ("DG", 1), fields)
    found[f"Q2, {fields}"] = stretched("hexahedron", "Lagrange", ("DPC", 1), fields)

body = meshes.block(COMM, (1.0, 1.0), n=(4, 4))
t = forms.load_factor(body)
w = forms.unknown(
    body, u=(("Lagrange", 1, (2,)), Role.DISPLACEMENT), d=(("Lagrange", 1), Role.SCALAR))
d, psi = w["d"], forms.energies.neo_hookean(forms.deformation_gradient(w["u"]), 1.0, 2.0)
crack = d**2 / 0.2 + 0.2 * ufl.inner(ufl.grad(d), ufl.grad(d))
held = [forms.roller(w, body.facets("left"), 0), forms.roller(w, body.facets("bottom"), 1),
        forms.translate(w, body.facets("right"), (0.4 * t, None))]
damage = ((1 - d) ** 2 * psi + 0.5 / 2 * crack) * ufl.dx
t.value = 1.0
path = forms.solve(damage, w, held, rtol=1e-12, ctol=1e-10)
found["damage"] = [*forms.at(forms.field(d, body), (0.3, 0.6)), forms.integral(psi * ufl.dx),
                   float(path.problem.minimization), float("full tangent" in
                   path.steps[-1].convergence.tried)]
if COMM.rank == 0:
    print(json.dumps(found))
"""


@pytest.fixture(scope="module")
def problems(run, tmp_path_factory):
    """Numbers of the three problems on 1, 2 and 3 ranks."""
    file = tmp_path_factory.mktemp("fields") / "script.py"
    file.write_text(PROBLEMS)
    return {n: json.loads(run(file, ranks=n).stdout.splitlines()[-1]) for n in (1, 2, 3)}


@pytest.mark.parametrize("ranks", [1, 2, 3])
def test_a_heated_bar_expands(problems, ranks):
    """Free: u = alpha theta X. Clamped along x: sigma_yy = 0 at F_e = diag(1, s, s) / 1.2.

    mu (s - 1/s) + lmbda ln(J_e) / s = 0 with s = F_e22: (s^2 - 1) + 2 ln(s^2 / 1.2) = 0.
    """
    assert problems[ranks]["heated, False"] == pytest.approx([0.2, 0.2, 0.2, 10], rel=1e-10)
    s = brentq(lambda s: s**2 - 1 + 2 * np.log(s**2 / 1.2), 1.0, 1.3, xtol=1e-15)
    for name in ("heated, True", "heated, other order"):
        right = [0, 1.2 * s - 1, 1.2 * s - 1, 10]
        assert problems[ranks][name] == pytest.approx(right, rel=1e-10, abs=1e-12)


@pytest.mark.parametrize("ranks", [1, 2, 3])
@pytest.mark.parametrize("element", ["P2", "Q2"])
def test_three_fields_are_two(problems, element, ranks):
    """(u, p, J~) on [P2, DG1, DG1], [Q2, dP1, dP1] is (u, p) with the energy of J~ eliminated."""
    two, three = (problems[ranks][f"{element}, {n}"] for n in (2, 3))
    assert three == pytest.approx(two, rel=1e-9, abs=1e-9)
    assert two == pytest.approx(problems[1][f"{element}, 2"], rel=1e-10, abs=1e-10)
    assert two[-1] == 1.0 and abs(two[0]) > 0.1


@pytest.mark.parametrize("ranks", [1, 2, 3])
def test_damage_is_minimized_over(problems, ranks):
    """Uniform d = 2 psi / (2 psi + Gc/l), found along the energy's search."""
    d, psi, minimization, searched = problems[ranks]["damage"]
    assert d == pytest.approx(2 * psi / (2 * psi + 0.5 / 0.2), rel=1e-10)
    assert d > 0.1 and minimization == searched == 1.0


def test_a_manufactured_temperature_field_converges():
    """Conduction with a source, -k lap theta = q for sin(pi x) sin(pi y): rate 2 in L2 of P1."""
    errors = []
    for n in (4, 8, 16):
        mesh = unit_mesh(2, n)
        w = forms.unknown(
            mesh,
            u=(("Lagrange", 1, (2,)), forms.Role.DISPLACEMENT),
            theta=(("Lagrange", 1), forms.Role.SCALAR),
        )
        x, theta = ufl.SpatialCoordinate(mesh), w["theta"]
        exact = ufl.sin(np.pi * x[0]) * ufl.sin(np.pi * x[1])
        F = forms.deformation_gradient(w["u"])
        psi = forms.energies.neo_hookean(F / (1 + 0.1 * theta), 1.0, 2.0)
        eta = ufl.split(ufl.TestFunction(w.function_space))[1]
        heat = ufl.inner(ufl.grad(theta), ufl.grad(eta)) - 2 * np.pi**2 * exact * eta
        held = [forms.clamp(w, whole(mesh)), forms.prescribe(theta, whole(mesh), 0.0)]
        forms.solve(forms.residual(psi * ufl.dx, w["u"]) + heat * ufl.dx, w, held)
        errors.append(np.sqrt(forms.integral((theta - exact) ** 2 * ufl.dx(degree=6))))
    rates = np.log2(np.divide(errors[:-1], errors[1:]))
    assert rates[-1] == pytest.approx(2, abs=0.1)


def test_a_users_own_mixed_element_is_welcome():
    """[Q1, P0] and the displacement second: same numbers as in the order of names."""
    body = meshes.block(MPI.COMM_SELF, (1.0, 1.0), n=(3, 3), cells="quadrilateral")
    cell, found = body.mesh.basix_cell(), []
    U = basix.ufl.element("Lagrange", cell, 1, shape=(2,))
    Q = basix.ufl.element("DG", cell, 0)
    for order in ([U, Q], [Q, U]):
        space = fem.functionspace(body.mesh, basix.ufl.mixed_element(order))
        w = fem.Function(space, name="w")
        moves = unknowns.displacement_field(w)
        u, (p,) = moves.expression, [f for f in ufl.split(w) if f.ufl_shape == ()]
        psi = forms.energies.isochoric_neo_hookean(forms.deformation_gradient(u), 1.0)
        psi = forms.energies.with_pressure(psi, forms.deformation_gradient(u), p, 10.0)
        held = [
            forms.clamp(w, body.facets("left")),
            forms.translate(w, body.facets("right"), (0.2, 0)),
        ]
        path = forms.solve(psi * ufl.dx, w, held)
        assert path.steps[0].convergence.negative == 0
        found.append(forms.at(forms.displacement_of(w), (0.5, 1.0)))
    assert found[0] == pytest.approx(found[1], rel=1e-9)


def test_fields_have_names_values_and_numbers(rng):
    """Each degree of freedom belongs to one field; put() fills that field alone."""
    mesh = unit_mesh(2, 3)
    w = forms.unknown(
        mesh,
        a=(("DG", 0), forms.Role.MULTIPLIER),
        u=(("Lagrange", 2, (2,)), forms.Role.DISPLACEMENT),
    )
    numbers = np.concatenate([field.dofs for field in w.fields.values()])
    assert np.array_equal(np.sort(numbers), np.arange(len(w.x.array)))
    w.put("a", 3.0)
    w.put("u", lambda x: (x[0], x[1] ** 2))
    assert forms.integral(w["a"] * ufl.dx) == pytest.approx(3)
    assert forms.integral(w["u"][1] * ufl.dx) == pytest.approx(1 / 3)
    assert w["u"].ufl_shape == (2,) and w[0].ufl_shape == ()
    assert unknowns.fields_of(w) is w.fields
    plain = forms.displacement(mesh)
    assert plain["u"] is plain and plain.fields["u"].role is forms.Role.DISPLACEMENT


def test_bad_fields_are_refused():
    mesh = unit_mesh(2)
    u = (("Lagrange", 1, (2,)), forms.Role.DISPLACEMENT)
    w = forms.unknown(mesh, u=u, theta=(("Lagrange", 1), forms.Role.SCALAR))
    with pytest.raises(ValueError, match=r"w?u_theta has the fields u, theta, got 'p'"):
        w["p"]
    with pytest.raises(ValueError, match=r"needs a = \(element, role\).* got \('Lagrange', 1\)"):
        forms.unknown(mesh, a=("Lagrange", 1))
    with pytest.raises(ValueError, match=r"in 2 dimensions has as many .* got u of shape \(3,\)"):
        forms.unknown(mesh, u=(("Lagrange", 1, (3,)), forms.Role.DISPLACEMENT))
    with pytest.raises(ValueError, match="at most one displacement"):
        forms.unknown(mesh, u=u, v=u)
    with pytest.raises(ValueError, match=r"got theta of u_theta with 1: use forms.prescribe"):
        forms.roller(w["theta"], whole(mesh), 0)
    with pytest.raises(ValueError, match="a support needs 1 values, one per component"):
        forms.prescribe(w["theta"], whole(mesh), [1.0, 2.0])
    with pytest.raises(ValueError, match="needs the unknown itself"):
        forms.prescribe(2 * w["theta"], whole(mesh), 1.0)


@pytest.mark.parametrize(("cells", "degree"), [("tetrahedron", 2), ("hexahedron", 3)])
def test_a_part_of_a_mixed_unknown_is_that_part(cells, degree):
    """Values at points, supports that turn and resultants see the nodes that the form sees."""
    body = meshes.block(MPI.COMM_SELF, (1.0, 1.0, 1.0), n=(2, 2, 2), cells=cells)
    w, t = forms.displacement_pressure(body, degree), forms.load_factor(body, 0.4)
    u, p = ufl.split(w)
    F = forms.deformation_gradient(u)
    psi = forms.energies.isochoric_neo_hookean(F, 1.0)
    psi = forms.energies.with_pressure(psi, F, p, 10.0) * ufl.dx
    turned = forms.rotate(w, whole(body.mesh), angle=t, axis=(1, 2, 3), center=(0, 0, 0))
    path = forms.solve(psi, w, [turned])
    moved = forms.displacement_of(w)
    assert forms.integral(ufl.inner(moved - u, moved - u) * ufl.dx) < 1e-20
    assert path.problem.energy() < 1e-16  # a rigid rotation, inside as well
    force, moment = forms.resultant(path, body.facets("left"))
    assert np.abs(force).max() < 1e-8 and np.abs(moment).max() < 1e-8
