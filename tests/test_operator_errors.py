# SPDX-License-Identifier: MIT
"""What energies in singular values refuse, in one sentence each, and where they are infinite."""

import numpy as np
import pytest
import ufl
from cases import LMBDA, MU, unit_mesh, whole
from dolfinx import fem, mesh

from variform import forms
from variform.forms import energies, stress


def test_two_sets_of_tags_are_refused():
    body = unit_mesh(3)
    cells = np.arange(6, dtype=np.int32)
    tags = [mesh.meshtags(body, 3, cells, np.full(6, k, np.int32)) for k in (1, 2)]
    u = forms.displacement(body)
    psi = energies.hencky(forms.deformation_gradient(u), MU, LMBDA)
    one, two = (ufl.Measure("dx", body, subdomain_data=t) for t in tags)
    with pytest.raises(ValueError, match="2 different sets of tags for its cell integrals"):
        forms.compiled(psi * one(1) + psi * two(2))


def test_states_without_an_energy_are_infinite_and_refused():
    """Ln of an inverted state: the energy is inf, so that a line search turns back."""
    body = unit_mesh(3)
    u = forms.displacement(body)
    u.interpolate(lambda x: np.array([-2 * x[0], 0 * x[0], 0 * x[0]]))
    psi = energies.hencky(forms.deformation_gradient(u), MU, LMBDA)
    assert forms.integral(psi * ufl.dx) == np.inf
    with pytest.raises(forms.NotConverged, match="energy is not finite at the start"):
        forms.solve(psi * ufl.dx, u, [forms.clamp(u, whole(body, lambda x: x[2] < 1e-9))])


def quadratic(u):
    return forms.deformation_gradient(forms.displacement(u.function_space.mesh, degree=2))


BAD = {
    "not symmetric": (
        lambda F, u: energies.principal(lambda s1, s2, s3: s1 + 2 * s2 + s3)(F),
        r"must not depend on the order of the singular values, got .* \[1, 3, 2\]",
    ),
    "not finite": (
        lambda F, u: energies.principal(lambda s1, s2, s3: ufl.ln(s1 + s2 + s3 - 4))(F),
        "must be finite near rest, got nan",
    ),
    "no scalar": (
        lambda F, u: energies.principal(lambda s1, s2, s3: F * s1)(F),
        r"must return a scalar, got the shape \(3, 3\)",
    ),
    "arguments": (
        lambda F, u: energies.principal(lambda mu, a, b, c: mu * a),
        r"singular values first, as .*, got \(mu, a, b, c\)",
    ),
    "no function": (lambda F, u: energies.principal(F), "is a function of them, .* got Variable"),
    "clamp": (
        lambda F, u: energies.principal(lambda a, b, c: a, clamp=0.0),
        "clamp must be between 0 and 1, got 0.0",
    ),
    "shape": (
        lambda F, u: energies.fixed_corotated(u, 1, 1),
        r"needs an F of shape \(3, 3\) or \(2, 2\), got \(3,\)",
    ),
    "two stretches": (
        lambda F, u: energies.principal(lambda s1, s2: s1 + s2)(F),
        r"of 2 singular values needs an F of shape \(2, 2\) or \(3, 2\), got \(3, 3\)",
    ),
    "parameters": (lambda F, u: energies.hencky(F, 1.0), "missing a required argument: 'lmbda'"),
    "negative": (lambda F, u: energies.hencky(F, -1.0, 1.0), "mu must be positive, got -1.0"),
    "second derivative by UFL": (
        lambda F, u: forms.compiled(
            ufl.derivative(
                forms.residual(energies.hencky(F, 1, 1) * ufl.dx, u)
                + ufl.inner(u, ufl.TestFunction(u.function_space)) * ufl.dx,
                u,
            )
        ),
        "which would take it for a constant",
    ),
    "diff of a stress": (
        lambda F, u: forms.compiled(
            ufl.diff(stress.first_piola(energies.hencky(F, 1, 1), F), F)[0, 0, 0, 0] * ufl.dx
        ),
        "which would take it for a constant",
    ),
    "gradient in space": (
        lambda F, u: forms.compiled((1 + energies.hencky(quadratic(u), 1, 1).dx(0)) * ufl.dx),
        "have no derivative in space",
    ),
    "divergence of a stress": (
        lambda F, u: forms.compiled(
            (u[0] + ufl.div(stress.first_piola(energies.hencky(F, 1, 1), F))[0]) * ufl.dx
        ),
        "have no derivative in space",
    ),
    "stress of a parameter in F": (
        lambda F, u: stress.first_piola(energies.hencky(F, 1 + ufl.tr(F) ** 2, 1.0), F),
        "a parameter of hencky depends on the unknown",
    ),
    "test function": (
        lambda F, u: energies.hencky(F, 1 + ufl.TestFunction(u.function_space)[0], 1.0),
        "a test or trial function has no place in them",
    ),
    "no mesh": (
        lambda F, u: energies.hencky(1.1 * ufl.Identity(3), 1.0, 1.0),
        "needs an F of a mesh, got one of numbers only",
    ),
    "zero": (
        lambda F, u: forms.compiled(
            forms.derivative(
                energies.hencky(F, 1, 1) * ufl.dx,
                forms.displacement(u.function_space.mesh),
                ufl.TestFunction(u.function_space),
            )
        ),
        "the form is zero",
    ),
    "no value": (
        lambda F, u: forms.compiled(
            ufl.Coefficient(u.ufl_function_space())[0] * energies.hencky(F, 1, 1) * ufl.dx
        ),
        "has no value: use a Function or Constant of DOLFINx",
    ),
    "complex": (
        lambda F, u: energies.hencky.evaluate(1j * np.ones((1, 3, 3)), 1.0, 1.0),
        "evaluate needs F as numbers",
    ),
    "nan parameter": (
        lambda F, u: energies.hencky.evaluate([np.eye(3)], np.array([np.nan]), 1.0),
        r"needs finite parameters, got \[nan\]",
    ),
    "reserved name": (
        lambda F, u: energies.principal(lambda s1, s2, s3, project: s1),
        "may not be named project",
    ),
    "nameless": (
        lambda F, u: energies.principal(lambda s1, s2, s3, *more: s1),
        "needs parameters with names",
    ),
    "deep": (
        lambda F, u: forms.compiled(
            forms.tangent(forms.residual(energies.hencky(F, 1, 1) * ufl.dx(degree=40), u), u)
        ),
        "MiB per cell for .*, more than 4: lower the quadrature degree",
    ),
    "no parameter": (
        lambda F, u: energies.hencky(F, "1", 1.0),
        "hencky needs mu as a number or a UFL scalar, got str",
    ),
    "tensor": (
        lambda F, u: energies.hencky(F, F, 1.0),
        r"needs mu as a number or a UFL scalar, got Variable of shape \(3, 3\)",
    ),
    "unknown parameter": (
        lambda F, u: energies.hencky(F, 1.0, 1.0, nu=3),
        r"hencky\(F, mu, lmbda\): got an unexpected keyword argument 'nu'",
    ),
    "independent": (
        lambda F, u: energies.principal(lambda a, b, c: 0 * a)(F),
        "does not depend on the singular values, got 0",
    ),
    "NumPy": (
        lambda F, u: energies.principal(lambda a, b, c: np.log(a))(F),
        "failed on UFL scalars .* write it with ufl.ln",
    ),
    "no UFL": (
        lambda F, u: energies.hencky(np.eye(3), 1.0, 1.0),
        "needs a deformation gradient in UFL, got ndarray; for arrays there is hencky.evaluate",
    ),
    "no numbers": (
        lambda F, u: energies.hencky.evaluate("F", 1.0, 1.0),
        "hencky.evaluate needs F as numbers, got str",
    ),
    "parameters of another length": (
        lambda F, u: energies.hencky.evaluate([np.eye(3)], np.ones(2), 1.0),
        r"numbers or one per F, shape \(1,\), got \(2,\)",
    ),
    "activation of another kind": (
        lambda F, u: energies.activated(F, "A", 1.0),
        "needs A as a matrix of numbers or in UFL, got str",
    ),
    "terms": (
        lambda F, u: energies.ogden(F, [1.0], [2.0, 3.0]),
        "as many mu as alpha, got 1 and 2",
    ),
    "no list": (lambda F, u: energies.ogden(F, 1.0, 2.0), "needs mu as a list, .* got 1.0"),
    "extension": (
        lambda F, u: energies.extended(energies.hencky, 1.5),
        "stretch below between 0 and 1, got 1.5",
    ),
    "extended what": (
        lambda F, u: energies.extended(energies.neo_hookean, 0.5),
        "needs an energy in singular values, as hencky, got neo_hookean",
    ),
    "activation": (
        lambda F, u: energies.activated(F, np.eye(4), 1.0),
        r"needs A of shape \(3, 3\), got \(4, 4\)",
    ),
    "activated": (
        lambda F, u: energies.activated(u, np.eye(3), 1.0),
        r"activated needs a 3x3 F, got shape \(3,\)",
    ),
    "interior facets": (
        lambda F, u: forms.compiled(energies.hencky(F, 1.0, 1.0)("+") * ufl.dS),
        "over cells and exterior facets, got an integral of type interior_facet",
    ),
    "interior beside": (
        lambda F, u: forms.compiled(energies.hencky(F, 1.0, 1.0) * ufl.dx + u("+")[0] * ufl.dS),
        "over cells and exterior facets, got 1 of those and 1 others",
    ),
    "rule": (
        lambda F, u: forms.compiled(
            energies.hencky(F, 1.0, 1.0) * ufl.dx(scheme="vertex", degree=1)
        ),
        "by the default rule, got vertex",
    ),
    "ufl.derivative": (
        lambda F, u: forms.compiled(ufl.derivative(energies.hencky(F, 1.0, 1.0) * ufl.dx, u)),
        "by forms.derivative, forms.residual",
    ),
    "ufl.diff": (
        lambda F, u: forms.compiled(ufl.diff(energies.hencky(F, 1.0, 1.0), F)[0, 0] * ufl.dx),
        "not by ufl.derivative or ufl.diff",
    ),
    "fem.form": (
        lambda F, u: fem.form(energies.hencky(F, 1.0, 1.0) * ufl.dx),
        "is compiled by forms.compiled",
    ),
    "nested": (
        lambda F, u: forms.compiled(energies.hencky(energies.hencky(F, 1, 1) * F, 1, 1) * ufl.dx),
        "contains an energy in singular values itself",
    ),
    "dependent parameter": (
        lambda F, u: forms.residual(energies.hencky(F, 1 + u[0] ** 2, 1.0) * ufl.dx, u),
        "a parameter of hencky depends on the unknown",
    ),
    "third derivative": (
        lambda F, u: forms.derivative(
            forms.tangent(forms.residual(energies.hencky(F, 1, 1) * ufl.dx, u), u), u, u
        ),
        "the third derivative of an energy in singular values is not available",
    ),
    "array": (
        lambda F, u: energies.hencky.evaluate(np.eye(3), 1.0, 1.0),
        r"needs F of shape \(n, 3, 3\), got \(3, 3\)",
    ),
    "nan": (
        lambda F, u: energies.hencky.evaluate(np.full((2, 3, 3), np.nan), 1.0, 1.0),
        r"needs finite F, got \[\[nan, .* at 0",
    ),
    "no number": (
        lambda F, u: energies.principal(lambda a, b, c: u[0] * (a + b + c)).evaluate([np.eye(3)]),
        "which has no value outside a mesh",
    ),
    "many parameters": (
        lambda F, u: energies.ogden(F, [1.0] * 40, [2.0] * 40),
        "may have 64 parameters, got 80",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_gets_one_sentence(case):
    call, message = BAD[case]
    u = forms.displacement(unit_mesh(3))
    with pytest.raises(ValueError, match=message):
        call(forms.deformation_gradient(u), u)


def test_parameters_of_another_mesh_are_refused():
    u = forms.displacement(unit_mesh(3))
    other = fem.Function(fem.functionspace(unit_mesh(3), ("DG", 0)))
    with pytest.raises(ValueError, match="hencky's parameters and F must be of one mesh"):
        energies.hencky(forms.deformation_gradient(u), other, 1.0)


def test_plane_stress_wants_plain_energies():
    u = forms.displacement(unit_mesh(2))
    with pytest.raises(ValueError, match="condenses energies in plain UFL"):
        forms.plane_stress(u, lambda F: energies.hencky(F, 1.0, 1.0))


def test_64_parameters_act_and_65_are_refused(rng):
    def weighted(s1, s2, s3, mu):
        total = sum((k + 1) * m for k, m in enumerate(mu))
        return total * ((s1 - 1) ** 2 + (s2 - 1) ** 2 + (s3 - 1) ** 2)

    F = np.eye(3)[None] + 0.1 * rng.normal(size=(1, 3, 3))
    mu = rng.uniform(1, 2, 64)
    found = energies.principal(weighted).energy(F, mu.tolist())[0]
    wanted = energies.as_rigid_as_possible.energy(F, mu @ np.arange(1, 65))[0]
    assert found == pytest.approx(wanted, rel=1e-13)
    with pytest.raises(ValueError, match="may have 64 parameters, got 65"):
        energies.principal(weighted).energy(F, [1.0] * 65)
