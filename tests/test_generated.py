# SPDX-License-Identifier: MIT
"""Tables and pictures of the pages follow from the code: rows, formulas, domains, curves."""

import functools

import numpy as np
import pytest
from conftest import ROOT

from demos.pages import bodies, energies, responses
from demos.pages.__main__ import PAGES
from variform import forms


@pytest.mark.parametrize("page, mark", PAGES, ids=lambda word: word)
def test_tables_are_those_that_the_code_gives(page, mark):
    """What stands between the marks is what ``python3 -m demos.pages`` would write now."""
    part = (ROOT / page).read_text().partition(f"<!-- {mark}: written by a run -->")[2]
    found = part.partition(f"<!-- end of {mark} -->")[0].strip().splitlines()
    wanted = PAGES[page, mark]()
    assert found == wanted, f"docker/enter python3 -m demos.pages --tables writes {page} anew."


def test_every_energy_has_one_row():
    """A new energy needs a row in demos/pages/energies.py, with its domain and a curve."""
    rows = [row for family in energies.FAMILIES for row in family.rows]
    assert sorted(row.name for row in rows) == sorted(energies.names())
    for family in energies.FAMILIES:
        for row in family.rows:
            assert row.domain in energies.DOMAINS, row.name
            assert bool(row.psi or row.same) == bool(family.name), row.name
            assert (row.psi is None and row.same) or energies.formula(row.name)


def test_a_docstring_without_a_formula_is_found(monkeypatch):
    def nothing(F):
        """An energy of which nothing is said."""

    monkeypatch.setattr(forms.energies, "yeoh", nothing)
    with pytest.raises(ValueError, match="docstring of yeoh says nowhere what psi is"):
        energies.formula("yeoh")


@pytest.mark.parametrize(
    "text, wanted",
    [
        ("mu/2 (J^(-2/3) I - 3) - mu ln J", "μ/2 (J^(~2/3) I ~ 3) ~ μ ln J"),
        ("mu |F A - R|^2", r"μ \|F A ~ R\|²"),
        ("sum_p mu_p/alpha_p (sum_i s_i^alpha_p - 3)", "Σₚ μₚ/αₚ (Σᵢ sᵢ^αₚ ~ 3)"),
        ("lmbda/2 (s_i^-2 - s1^(-1/2))", "λ/2 (sᵢ⁻² ~ s1^(~1/2))"),
    ],
)
def test_formulas_are_typeset(text, wanted):
    """In the signs of print; here ~ stands for the minus sign."""
    assert energies.typeset(text) == wanted.replace("~", "\u2212")


def test_every_body_has_one_row():
    """All functions of meshes that make a body from numbers are in the table."""
    assert [row.name for row in bodies.ROWS] == bodies.makers()


# Energies that are drawn together with another one: by themselves.
ALONE = {
    "guccione": lambda F, a: forms.energies.guccione(F, 1.0, 8.0, 2.0, 4.0, a),
    "active_tension": lambda F, a: forms.energies.active_tension(F, 1.0, a),
}
DRAWN = [
    pytest.param(row, family.kind, id=row.name)
    for family in energies.FAMILIES
    for row in family.rows
    if row.psi
]


@pytest.mark.parametrize("row, kind", DRAWN)
def test_energies_are_defined_where_the_table_says(row, kind):
    """The energy is finite, or not, in a mirrored state and in a flat one."""
    psi = ALONE.get(row.name, row.psi)
    mirrored, flat = {
        "J > 0": (False, False),
        "J ≠ 0": (True, False),
        "all F": (True, True),
        "I3 > 0": (True, False),
    }[row.domain]
    if kind == "fibers":
        psi = functools.partial(psi, a=energies.ALONG)
    P = responses.Stress(psi, (3, 2) if kind == "sheets" else (3, 3))
    shape = P.F.value.shape
    for last, finite in ((-0.8, mirrored), (0.0, flat)):
        F = np.zeros(shape)
        np.fill_diagonal(F, [1.2, 1.1, last] if shape == (3, 3) else [1.2, last])
        P(F)
        assert np.isfinite(P.energy) == finite, last


PICTURES = {
    **{f"energy_{f.name}.png": ("forms/README.md", 60) for f in energies.FAMILIES if f.name},
    **{f"mesh_{name}.png": ("meshes/README.md", 100) for name in bodies.SHEETS},
}


@pytest.mark.parametrize("name", PICTURES)
def test_pictures_are_there_and_shown(name):
    """More than an empty frame, small enough for a page, and on it."""
    page, most = PICTURES[name]
    assert 5 < (energies.FIGURES / name).stat().st_size / 1000 < most
    assert f"(../demos/figures/{name})" in (ROOT / page).read_text()


def test_responses_are_the_closed_forms():
    """Neo-Hookean, J = 1: l - l^-2 in one direction, l - l^-5 in two, gamma in shear.

    St Venant-Kirchhoff without stress sideways: b^2 = 1 - nu (l^2 - 1) across one stretch l, and
    P = E/2 (l^2 - 1) l. A sheet of it, both ways: P = E/(2 (1 - nu)) (l^2 - 1) l.
    """
    stretches = np.array([0.7, 1.0, 1.3])
    P = responses.Stress(lambda F: forms.energies.isochoric_neo_hookean(F, 1.0))
    for given, power in ((1, -2), (2, -5)):
        found = responses.response(P, stretches, given, "incompressible")
        np.testing.assert_allclose(found, stretches - stretches**power, atol=1e-9)
    np.testing.assert_allclose(
        responses.shear(P, stretches, "incompressible"), stretches, rtol=1e-9
    )
    E, nu, bent = energies.SHEET["E"], energies.NU, stretches * (stretches**2 - 1) / 2
    P = responses.Stress(lambda F: forms.energies.saint_venant_kirchhoff(F, 1.0, energies.LMBDA))
    np.testing.assert_allclose(
        responses.response(P, stretches, 1, "compressible"), E * bent, atol=1e-8
    )
    P = responses.Stress(lambda F: forms.energies.saint_venant_kirchhoff_sheet(F, E, nu), (3, 2))
    np.testing.assert_allclose(
        responses.response(P, stretches, 2, "sheets"), E / (1 - nu) * bent, atol=1e-9
    )
