# SPDX-License-Identifier: MIT
"""Scenes of sheets: wrinkles, flat starts, weight, enclosed gas, against closed forms."""

from math import pi

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from cases import MU, agree
from dolfinx import fem
from scipy import integrate, optimize
from test_control import sphere

from variform import forms, meshes
from variform.forms import energies

E, NU = 3.0, 0.4
FIELDS = {
    "saint_venant_kirchhoff": (energies.saint_venant_kirchhoff_tension_field, (E, NU)),
    "neo_hookean": (energies.neo_hookean_tension_field, (MU,)),
}


PLAIN = {
    "saint_venant_kirchhoff": lambda s1, s2, E, nu: (
        E / 8 / (1 - nu**2) * ((s1**2 - 1) ** 2 + (s2**2 - 1) ** 2)
        + E / 4 / (1 - nu**2) * nu * (s1**2 - 1) * (s2**2 - 1)
    ),
    "neo_hookean": lambda s1, s2, mu: mu / 2 * (s1**2 + s2**2 + 1 / (s1 * s2) ** 2 - 3),
}

WIDTH = {
    "saint_venant_kirchhoff": lambda a: ufl.sqrt(1 - NU * (a**2 - 1)),
    "neo_hookean": lambda a: 1 / ufl.sqrt(a),
}


def relaxed(name, s1, s2):
    """Stresses dpsi/ds of a tension field, written down for s1 >= s2; which regime it is in."""
    if name == "neo_hookean":
        width, uniaxial = s1**-0.5, MU * (s1 - s1**-2)
        taut = MU * (s1 - 1 / (s1**3 * s2**2)), MU * (s2 - 1 / (s2**3 * s1**2))
    else:
        e1, e2 = (s1**2 - 1) / 2, (s2**2 - 1) / 2
        width, uniaxial = np.sqrt(1 - NU * (s1**2 - 1)), E * e1 * s1
        taut = tuple(E / (1 - NU**2) * (a + NU * b) * s for a, b, s in ((e1, e2, s1), (e2, e1, s2)))
    if s1 <= 1:
        return (0.0, 0.0), "slack"
    return (taut, "taut") if s2 > width else ((uniaxial, 0.0), "wrinkled")


@pytest.mark.parametrize("name", FIELDS)
def test_a_tension_field_is_taut_wrinkled_or_slack(name, rng):
    """Principal stresses of each regime to 13 digits, none negative, and no negative stiffness."""
    energy, parameters = FIELDS[name]
    s = np.sort(rng.uniform(0.5, 1.5, (300, 2)))[:, ::-1]
    U = np.linalg.qr(rng.normal(size=(300, 3, 3)))[0][:, :, :2]
    V = np.linalg.qr(rng.normal(size=(300, 2, 2)))[0]
    F = np.einsum("nik,nk,njk->nij", U, s, V)
    P, slope = energy.evaluate(F, *parameters, residual=0)
    stresses, regimes = zip(*(relaxed(name, *state) for state in s), strict=True)
    wanted = np.einsum("nik,nk,njk->nij", U, np.array(stresses), V)
    agree(P, wanted, digits=13)
    assert np.linalg.eigvalsh(slope.reshape(-1, 6, 6)).min() > -1e-12
    assert set(regimes) == {"taut", "wrinkled", "slack"}
    full = energies.principal(PLAIN[name]).evaluate(F, *parameters)[0]
    named = energies.tension_field(
        lambda a, b: PLAIN[name](a, b, *parameters), lambda a: WIDTH[name](a)
    )
    agree(named.evaluate(F, residual=0)[0], wanted, digits=13)
    stiffer = energy.evaluate(F, *parameters, residual=0.3)[0]
    agree(stiffer, 0.7 * wanted + 0.3 * full, digits=13)


@pytest.mark.parametrize("name", FIELDS)
def test_the_stress_of_a_tension_field_has_no_jumps(name):
    """Across both borders the stress moves as little as the stretch does."""
    energy, parameters = FIELDS[name]
    for s, moved in (((1.2, relaxed_width(name, 1.2)), 1), ((1.0, 0.8), 0), ((1.0, 1.0), 0)):
        F = np.zeros((2, 3, 2))
        F[:, [0, 1], [0, 1]] = s
        F[:, moved, moved] += [-1e-9, 1e-9]
        below, above = energy.evaluate(F, *parameters)[0]
        assert np.abs(above - below).max() < 20e-9


def relaxed_width(name, s1):
    return s1**-0.5 if name == "neo_hookean" else np.sqrt(1 - NU * (s1**2 - 1))


@pytest.mark.parametrize("share", [0.1, 0.25, 0.35, 0.42])
def test_bending_of_a_stretched_sheet(share):
    """Stein and Hedgepeth's band of wrinkles: b/h = 3 M/(P h) - 1/2 where M/(P h) > 1/6.

    A strip of height 1 whose right end is turned, so that its fibers have the strain e(y) >= 0
    where taut; small strains, no Poisson effect.
    """
    kappa = 2e-4
    if share > 1 / 6:
        b = 3 * share - 1 / 2
        force = kappa / 2 * (1 - b) ** 2
    else:  # taut everywhere: a beam, its neutral fiber outside
        force = kappa / (12 * share)
        b = 1 / 2 - force / kappa
    body = meshes.block(MPI.COMM_SELF, (2.0, 1.0), n=(4, 60), cells="quadrilateral")
    u, x = forms.displacement(body, 2), ufl.SpatialCoordinate(body.mesh)
    psi = energies.saint_venant_kirchhoff_tension_field(forms.deformation_gradient(u), 1.0, 0.0)
    turned = 2.0 * kappa * (x[1] - b)
    held = [
        forms.clamp(u, body.facets("left")),
        forms.translate(u, body.facets("right"), (turned, None)),
    ]
    path = forms.solve(psi * ufl.dx, u, held)
    reaction, moment = forms.resultant(path.problem, body.facets("right"), about=(2, 0.5, 0))
    assert reaction[0] == pytest.approx(force, rel=2e-3)
    assert -moment[-1] / reaction[0] == pytest.approx(share, rel=2e-3)


FLAT = {
    "neo_hookean": lambda F: energies.neo_hookean_sheet(F, 1.0),
    "operator": lambda F: energies.neo_hookean_tension_field(F, 1.0),
}


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("name", FLAT)
def test_a_flat_sheet_is_blown_up_in_one_call(name, degree):
    """A clamped disk without any stiffness across its plane: the state that control finds too."""
    flat = meshes.disk(MPI.COMM_SELF, 1.0, 0.2, degree, quarter=True)
    u, p = forms.displacement(flat, degree), fem.Constant(flat.mesh, 1.5)
    volume = forms.enclosed_volume(u)
    potential = FLAT[name](forms.membrane_gradient(u)) * ufl.dx - p * volume
    held = [
        forms.clamp(u, flat.facets("outer")),
        forms.roller(u, flat.facets("x0"), 0),
        forms.roller(u, flat.facets("y0"), 1),
    ]
    path = forms.solve(potential, u, held, rtol=1e-12, ctol=1e-10)
    assert path.steps[0].convergence.iterations <= 15
    inside, found = forms.integral(volume), u.x.array.copy()
    u.x.array[:], p.value = 0, 0
    path = forms.control(
        potential, u, held, p, volume, [inside], rtol=1e-12, ctol=1e-10, progress=False
    )
    assert path.refused == 0
    assert p.value == pytest.approx(1.5, rel=1e-9)
    assert np.abs(u.x.array - found).max() < 1e-8


def test_hencky_s_disk():
    """w0/a = (p a/(E h))^(1/3) sum a_2n, by Hencky's power series, at a small pressure."""
    b0 = 1.7244  # for nu = 0.3
    terms = [1, 1 / 2, 5 / 9, 55 / 72, 7 / 6, 205 / 108, 17051 / 5292]
    series = sum(a / b0 ** (1 + 3 * k) for k, a in enumerate(terms))
    pressure = 1e-6
    flat = meshes.disk(MPI.COMM_SELF, 1.0, 0.1, 2, quarter=True)
    u = forms.displacement(flat, 2)
    psi = energies.saint_venant_kirchhoff_sheet(forms.membrane_gradient(u), 1.0, 0.3)
    held = [
        forms.clamp(u, flat.facets("outer")),
        forms.roller(u, flat.facets("x0"), 0),
        forms.roller(u, flat.facets("y0"), 1),
    ]
    forms.solve(psi * ufl.dx - pressure * forms.enclosed_volume(u), u, held)
    assert forms.at(u, (0, 0, 0))[2] == pytest.approx(pressure ** (1 / 3) * series, rel=1e-3)


@pytest.mark.parametrize("kind", ["function", "expression"])
def test_a_curtain_hangs_by_its_weight(kind):
    """Dead weight of a sheet whose thickness varies: s (s^2 - 1)/2 E h = weight below, 5 digits."""

    def thickness(y):
        return 1 + 0.8 * y  # y from -1/2 to 1/2

    body = meshes.square(MPI.COMM_SELF, 1.0, 0.05)
    u, x = forms.displacement(body, 2), ufl.SpatialCoordinate(body.mesh)
    h = thickness(x[1])
    if kind == "function":
        h = fem.Function(fem.functionspace(body.mesh, ("Lagrange", 1)))
        h.interpolate(lambda x: thickness(x[1]))
    psi = energies.saint_venant_kirchhoff_sheet(forms.membrane_gradient(u), 1.0, 0.0)
    weight = ufl.as_vector([0, -0.5 * h, 0])
    potential = h * psi * ufl.dx + forms.body_force(u, weight)
    held = [forms.clamp(u, body.facets("top"))]
    path = forms.solve(potential, u, held)

    def stretch(y):
        below = 0.5 * integrate.quad(thickness, -0.5, y)[0]
        return optimize.brentq(lambda s: s * (s**2 - 1) / 2 - below / thickness(y), 1, 3)

    drop = integrate.quad(lambda y: stretch(y) - 1, -0.5, 0.5)[0]
    assert -forms.at(u, (0, -0.5, 0))[1] == pytest.approx(drop, rel=1e-5)
    reaction, _ = forms.resultant(path.problem, body.facets("top"))
    assert reaction == pytest.approx([0, 0.5, 0], abs=1e-10)


def test_a_balloon_filled_with_gas():
    """As n R T = p V grows: through the limit point of the pressure, on the exact curve."""
    potential, u, held, p, volume = sphere(0.3, 2)
    p.value = 0
    stretches = np.array([1.1, 1.3, 1.6, 2.2, 3.0])
    exact = 2 * (1 / stretches - stretches**-7.0)
    gas = exact * pi / 6 * stretches**3
    record = {"volume": lambda system: forms.integral(volume)}
    path = forms.control(
        potential, u, held, p, p * volume, gas, record=record, progress=False, rtol=1e-10
    )
    found = np.array([step.load for step in path.steps])
    assert found == pytest.approx(exact, rel=2e-3)
    assert found * path.record("volume") == pytest.approx(gas, rel=1e-9)
    assert found.argmax() == 1


def test_the_stability_of_a_whole_balloon():
    """Stable until its limit point; past it one negative eigenvalue: stable at a held volume only.

    The tangent restricted to changes that keep the volume is positive definite where the whole has
    one negative eigenvalue and its pressure falls with the volume.
    """
    body = meshes.spherical_sheet(MPI.COMM_SELF, 1.0, 0.5, 2)
    u, p = forms.displacement(body, 2), fem.Constant(body.mesh, 0.0)
    volume = forms.enclosed_volume(u)
    psi = energies.neo_hookean_sheet(forms.membrane_gradient(u), 1.0)
    nodes = u.function_space.tabulate_dof_coordinates()

    def pin(point, axes):
        return forms.pin(u, nodes[np.linalg.norm(nodes - point, axis=1).argmin()], axes)

    held = [pin((0, 0, 1), (0, 1, 2)), pin((0, 0, -1), (0, 1)), pin((1, 0, 0), (1,))]
    stretches = np.array([1.2, 1.36, 1.41, 1.8, 2.4])
    path = forms.control(
        psi * ufl.dx - p * volume,
        u,
        held,
        p,
        volume,
        forms.integral(volume) * stretches**3,
        record={"unstable": forms.negative_eigenvalues},
        progress=False,
    )
    loads = [step.load for step in path.steps]
    assert loads == pytest.approx(2 * (1 / stretches - stretches**-7), rel=2e-3)
    assert list(path.record("unstable")) == [0, 0, 1, 1, 1]
    values, modes = forms.lowest_modes(path, 2)
    assert values[0] < 0 < values[1]
    # The one unstable mode is the sphere's own growth, from the pole that is held.
    outward = (modes[0].x.array.reshape(-1, 3) * nodes).sum(axis=1)
    assert outward.min() * np.sign(outward.sum()) > -1e-3 * np.abs(outward).max()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda F: energies.saint_venant_kirchhoff_tension_field(F, -1.0, 0.3), "positive, got -1"),
        (lambda F: energies.saint_venant_kirchhoff_tension_field(F, 1.0, 0.7), "got nu = 0.7"),
        (lambda F: energies.neo_hookean_tension_field(F, 0.0), "mu must be positive, got 0.0"),
        (
            lambda F: energies.neo_hookean_tension_field(F, 1.0, residual=1.0),
            "residual stiffness must be at least 0 and below 1, got 1.0",
        ),
        (lambda F: energies.tension_field(lambda s1, s2: s1 * s2, 1.0), "as a function, .* float"),
        (lambda F: energies.tension_field(lambda s: s, lambda s: s), "two stretches and"),
    ],
)
def test_bad_input_gets_one_sentence(call, message):
    body = meshes.square(MPI.COMM_SELF, 1.0, 1.0)
    with pytest.raises(ValueError, match=message):
        call(forms.membrane_gradient(forms.displacement(body)))


def test_a_path_tells_what_was_tried():
    """Ordinary solves by the full tangent say no more; a flat sheet names the ways in turn."""
    potential, u, held, _, _ = sphere(0.5, 1)
    path = forms.solve(potential, u, held)
    assert path.steps[0].convergence.tried == ("full tangent", "|R|")
    assert "by way of" not in path.reason
    flat = meshes.disk(MPI.COMM_SELF, 1.0, 0.3, quarter=True)
    u = forms.displacement(flat)
    psi = energies.neo_hookean_sheet(forms.membrane_gradient(u), 1.0)
    held = [forms.clamp(u, flat.facets("outer")), forms.roller(u, flat.facets("x0"), 0)]
    held.append(forms.roller(u, flat.facets("y0"), 1))
    path = forms.solve(psi * ufl.dx - 0.5 * forms.enclosed_volume(u), u, held)
    assert path.steps[0].convergence.tried == ("full tangent", "projected tangent", "|R|")
    assert "by way of full tangent, projected tangent, |R| (both tolerances" in path.reason
