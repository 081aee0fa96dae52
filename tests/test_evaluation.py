# SPDX-License-Identifier: MIT
"""Any energy at arrays of F: closed forms, differences, equal singular values; compiled once."""

import re
from pathlib import Path

import numpy as np
import pytest
import ufl
from cases import (
    ENERGIES,
    FIBER,
    KAPPA,
    LMBDA,
    MU,
    STRETCHES,
    off,
    random_rotation,
    random_state,
    unit_mesh,
)
from dolfinx import fem

from variform import forms
from variform.forms import energies, formulas

RNG = np.random.default_rng(4)
STATES = np.array([random_state(RNG, 0.2) for _ in range(5)])


def differences(f, F, h=2e-3):
    """Derivative of f by F, (8 (f1 - f-1) - (f2 - f-2)) / 12 h: wrong by h^4 and rounding / h."""
    steps = h * np.eye(9).reshape(9, 1, 3, 3)
    moved = np.stack([F + k * steps for k in (1, -1, 2, -2)])  # in one call: (4, 9, n, 3, 3)
    values = f(moved.reshape(-1, 3, 3))
    values = values.reshape(*moved.shape[:3], *values.shape[1:])
    slopes = (8 * (values[0] - values[1]) - (values[2] - values[3])) / (12 * h)
    return np.moveaxis(slopes, 0, -1).reshape(*slopes.shape[1:], 3, 3)


@pytest.mark.parametrize("name", [*ENERGIES, *STRETCHES])
def test_stress_and_tangent_are_derivatives(name):
    """P and A against differences of psi and P: every energy, h^4 = 2e-11 times 5th derivatives."""
    energy = (ENERGIES | STRETCHES)[name]
    psi, P, A = forms.evaluate(energy, STATES)
    assert psi.shape == (5,) and P.shape == (5, 3, 3) and A.shape == (5, 3, 3, 3, 3)
    assert off(P, differences(lambda F: forms.evaluate(energy, F, derivatives=0)[0], STATES)) < 1e-7
    assert off(A, differences(lambda F: forms.evaluate(energy, F, derivatives=1)[1], STATES)) < 1e-7
    # The order of the derivatives does not matter, and A is dP/dF and not its transpose anyway.
    assert off(A, A.transpose(0, 3, 4, 1, 2)) < 1e-13


def test_parameters_may_vary_from_state_to_state():
    """Document 003's closed forms of energy and Cauchy stress, with a modulus for each F."""
    mu = RNG.uniform(0.5, 2, 5)
    psi, P, _ = forms.evaluate(energies.neo_hookean, STATES, mu, lmbda=LMBDA)
    sigma = P @ STATES.transpose(0, 2, 1) / np.linalg.det(STATES)[:, None, None]
    wanted, moduli = formulas.materials, list(zip(STATES, mu, strict=True))
    assert off(psi, [wanted.neo_hookean(F, m, LMBDA) for F, m in moduli]) < 1e-13
    assert off(sigma, [wanted.neo_hookean_cauchy(F, m, LMBDA) for F, m in moduli]) < 1e-13


def test_fibers_are_vectors_or_arrays():
    """A tuple is one direction for all; an array has one each; one F has arrays without n."""
    given = 2.0, 8.0, 2.0, 4.0
    same = forms.evaluate(energies.guccione, STATES, *given, tuple(FIBER))
    each = forms.evaluate(energies.guccione, STATES, *given, np.tile(FIBER, (5, 1)))
    for a, b in zip(same, each, strict=True):
        assert off(a, b) < 1e-14
    Q = np.array([random_rotation(RNG) for _ in range(5)])
    turned = forms.evaluate(energies.guccione, STATES @ Q.transpose(0, 2, 1), *given, Q @ FIBER)
    assert off(turned[0], same[0]) < 1e-12
    alone = forms.evaluate(energies.guccione, STATES[2], *given, FIBER)
    assert [a.shape for a in alone] == [(), (3, 3), (3, 3, 3, 3)]
    for a, b in zip(alone, same, strict=True):
        assert off(a, b[2]) < 1e-14


def test_an_activation_for_each_state():
    """P = 2 mu (F A - R) A^T with R of NumPy's own decomposition: document 002."""
    A = np.eye(3) + 0.2 * RNG.normal(size=(5, 3, 3))
    _, P, _ = forms.evaluate(energies.activated, STATES, A, MU)
    U, _, Vt = np.linalg.svd(STATES @ A)
    assert np.all(np.linalg.det(U @ Vt) > 0)
    assert off(P, 2 * MU * (STATES @ A - U @ Vt) @ A.transpose(0, 2, 1)) < 1e-12


@pytest.mark.parametrize("wrap", [False, True], ids=["operator", "in a function"])
def test_equal_singular_values_are_exact(wrap):
    """As the polynomial that the operator is equal to: one, two and three equal stretches."""
    stretches = energies.saint_venant_kirchhoff_stretches
    energy = (lambda F: stretches(F, MU, LMBDA)) if wrap else stretches
    given = () if wrap else (MU, LMBDA)
    Q = random_rotation(RNG)
    F = [np.eye(3), 1.1 * Q, np.diag([1.2, 1.2, 0.7]) @ Q, np.diag([1.2, 1.2 + 1e-9, 1.0])]
    found = forms.evaluate(energy, F, *given)
    wanted = forms.evaluate(energies.saint_venant_kirchhoff, F, MU, LMBDA)
    assert np.abs(found[0] - wanted[0]).max() < 1e-14
    assert off(found[1], wanted[1]) < 1e-13 and off(found[2], wanted[2]) < 1e-13


def test_sheets():
    """A 3x2 gradient; the stress of saint_venant_kirchhoff_sheet is F S."""
    E, nu = 3.0, 0.3
    F = np.eye(3)[:, :2] + 0.2 * RNG.normal(size=(4, 3, 2))
    _, P, A = forms.evaluate(energies.saint_venant_kirchhoff_sheet, F, E, nu)
    e = (F.transpose(0, 2, 1) @ F - np.eye(2)) / 2
    trace = np.trace(e, axis1=1, axis2=2)[:, None, None] * np.eye(2)
    assert off(P, F @ ((1 - nu) * e + nu * trace) * E / (1 - nu**2)) < 1e-13
    assert A.shape == (4, 3, 2, 3, 2)


def test_constants_have_their_present_values():
    """A Constant of a mesh may stand in the text; a later value needs nothing anew."""
    mu = fem.Constant(unit_mesh(3), 1.0)

    def energy(F):
        return energies.neo_hookean(F, mu, 0.0) + energies.as_rigid_as_possible(F, 1.0)

    (first,) = forms.evaluate(energy, STATES, derivatives=0)
    mu.value = 3.0
    (third,) = forms.evaluate(energy, STATES, derivatives=0)
    (unit,) = forms.evaluate(energies.neo_hookean, STATES, 1.0, 0.0, derivatives=0)
    assert off(third - first, 2 * unit) < 1e-12


def test_a_number_may_be_looked_at():
    """An energy that branches by its parameter is written with the number itself."""

    def energy(F, k):
        return ufl.inner(F, F) ** 2 if k > 2 else ufl.inner(F, F)

    squares = (STATES**2).sum(axis=(1, 2))
    for k, wanted in ((1.0, squares), (3.0, squares**2)):
        assert off(forms.evaluate(energy, STATES, k)[0], wanted) < 1e-14


EVALUATED = """
import sys
import numpy as np
import ufl
from variform import forms
from variform.forms import energies
for _ in range(int(sys.argv[1])):
    ufl.variable(ufl.as_ufl(1.0))
    ufl.Constant(ufl.Mesh(__import__("basix.ufl").ufl.element("P", "interval", 1, shape=(1,))))
F = 1.1 * np.eye(3)[None]
for mu in 1.0, 1.5:
    forms.evaluate(energies.neo_hookean, F, mu, 2.0)
    forms.evaluate(energies.neo_hookean, np.tile(F, (3, 1, 1)), np.full(3, mu), lmbda=np.ones(3))
    forms.evaluate(lambda F, mu: energies.hencky(F, mu, 2.0) + energies.volumetric(F, mu), F, mu)
"""


def test_an_energy_is_compiled_once(run, tmp_path, monkeypatch):
    """With whatever numbers, in any process: neo-Hookean; and sum, operand and jet of the other."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    for before in (0, 8):  # numbers 9 and 10 are sorted as words
        run("-c", EVALUATED, before)
        found = {p.name for p in Path(tmp_path).glob("fenics/**/*.so") if "ffcx" in p.name}
        assert len(found) == 4


def body_function():
    f = fem.Function(fem.functionspace(unit_mesh(3), ("DG", 0)), name="modulus")
    return lambda F: f * ufl.inner(F, F)


@pytest.mark.parametrize(
    "call, sentence",
    [
        (
            lambda: forms.evaluate(ufl.as_ufl(2.0), STATES),
            "evaluate needs an energy as a function psi(F, ...), got FloatValue: pass",
        ),
        (
            lambda: forms.evaluate(energies.yeoh, STATES[0, 0], 1.0, 0.0, 0.0),
            "yeoh needs F of shape (n, 3, 3) or (3, 3), got (3,).",
        ),
        (
            lambda: forms.evaluate(energies.yeoh, STATES * np.nan, 1.0, 0.0, 0.0),
            "yeoh needs finite F, got 45 others.",
        ),
        (
            lambda: forms.evaluate(energies.yeoh, STATES, np.inf, 0.0, 0.0),
            "yeoh needs a finite parameter 1, got inf.",
        ),
        (
            lambda: forms.evaluate(energies.guccione, STATES, 1.0, 1.0, 1.0, 1.0, FIBER),
            "guccione needs parameter 5 as an array with an entry per F, 5 of them, got the shape "
            "(3,): pass a tuple for a vector",
        ),
        (
            lambda: forms.evaluate(energies.guccione, STATES, 1.0, 1.0, 1.0, 1.0, (2.0, 0.0, 0.0)),
            "a fiber needs a unit vector, got one of length 2.",
        ),
        (lambda: forms.evaluate(lambda F: 2 * F, STATES), "the energy must return a scalar, got"),
        (lambda: forms.evaluate(lambda F: 2.0, STATES), "the energy does not depend on F, got 2.0"),
        (
            lambda: forms.evaluate(body_function(), STATES),
            "the energy contains modulus, which has no value outside a mesh: pass numbers",
        ),
        (
            lambda: forms.evaluate(energies.yeoh, STATES, 1.0, 0.0, 0.0, derivatives=3),
            "derivatives must be 0, 1 or 2, got 3.",
        ),
        (lambda: forms.evaluate(energies.yeoh, "F", 1.0, 0.0, 0.0), "yeoh needs F as numbers, got"),
    ],
)
def test_what_cannot_be_evaluated_is_named(call, sentence):
    """One sentence each."""
    with pytest.raises(ValueError, match=re.escape(sentence)):
        call()


def test_kappa_of_the_volume_term():
    """kappa/2 (J - 1)^2 in closed form, P = kappa (J - 1) J F^-T."""
    psi, P, _ = forms.evaluate(energies.volumetric, STATES, KAPPA)
    J = np.linalg.det(STATES)
    assert off(psi, KAPPA / 2 * (J - 1) ** 2) < 1e-12
    cofactor = J[:, None, None] * np.linalg.inv(STATES).transpose(0, 2, 1)
    assert off(P, KAPPA * (J - 1)[:, None, None] * cofactor) < 1e-12
