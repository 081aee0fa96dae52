# SPDX-License-Identifier: MIT
"""The tables of forms/formulas/README.md: complete, naming what exists, with the digits reached."""

import ast
import operator
import re
from importlib import import_module

import pytest
import recorder
from conftest import ROOT

from demos.benchmarks import misprints
from variform import forms

PAGE = (ROOT / "forms" / "formulas" / "README.md").read_text()


def collectable():
    """Test functions of the files that the tables speak of, with the files that define them."""
    found = {}
    for file in (ROOT / "tests").glob("test_*.py"):
        if not file.name.startswith(recorder.FILES):
            continue
        for node in ast.parse(file.read_text()).body:
            if isinstance(node, ast.FunctionDef) and node.name.startswith("test_"):
                found.setdefault(node.name, []).append(file.name)
    return found


def names(cell):
    return re.findall(r"`(.*?)`", cell)


def test_the_table_has_all_82_items():
    """Items 1 to 82 of documents 000 to 003, each with a test that bears its mark."""
    assert not recorder.strangers(PAGE)
    table, found = recorder.rows(PAGE, "capabilities"), recorder.proofs()
    assert [int(row[0]) for row in table] == list(range(1, 83))
    assert [row[1] for row in table] == ["000"] * 23 + ["001"] * 16 + ["002"] * 11 + ["003"] * 32
    for item, _, equation, what, functions, tests, _ in table:
        assert equation and what and names(functions), item
        assert sorted(names(tests)) == sorted(found[int(item)]), item


def test_an_unknown_mark_is_refused(monkeypatch):
    """A mark with a number that the tables have not, and a number that no test bears."""
    marked = {**recorder.marks("capability"), "test_a": [(83, 1)]}
    del marked["test_storage_and_permutation"]  # all that item 8 has
    monkeypatch.setattr(recorder, "marks", {"capability": marked, "misprint": {}}.__getitem__)
    first, second, third = recorder.strangers(PAGE)[:3]
    assert first == "no test is marked with 8 of the capabilities"
    assert second == "test_a: there is no 83 of the capabilities"
    assert third == "no test is marked with 1 of the misprints"


def test_no_mark_is_overlooked():
    """Marks stand on functions of the files that the tables speak of, and nowhere else."""
    kinds = ("capability", "misprint", "digits")
    seen = sum(len(found) for kind in kinds for found in recorder.marks(kind).values())
    text = "".join(file.read_text() for file in recorder.TESTS.glob("*.py"))
    assert seen == len(re.findall(rf"mark\.(?:{'|'.join(kinds)})\b", text)) > 100


def test_every_function_named_exists():
    """In forms.formulas, or where its full name says."""
    for row in recorder.rows(PAGE, "capabilities"):
        for name in names(row[4]):
            if name.startswith("forms."):
                assert callable(operator.attrgetter(name.removeprefix("forms."))(forms)), name
            else:
                module, _, function = name.partition(".")
                inside = import_module(f"variform.forms.formulas.{module}")
                assert callable(getattr(inside, function)), name


def test_every_test_named_exists():
    """Each name is that of one test, so that it needs no file."""
    found = collectable()
    marked = {*recorder.marks("capability"), *recorder.marks("misprint")}
    for name in marked | set(re.findall(r"`(test_\w+)`", PAGE)):
        assert len(found.get(name, [])) == 1, (name, found.get(name))
    assert set(recorder.marks("digits")) <= marked


def test_no_row_has_fewer_than_nine_digits():
    """A number, or how it is proved without one."""
    for row in recorder.rows(PAGE, "capabilities"):
        numbers = re.findall(r"\d+", row[6])
        assert all(9 <= int(n) <= recorder.DOUBLE for n in numbers)
        assert re.fullmatch(r"(\d+)?(, )?((symbolic|exact)(, )?)*", row[6]) and row[6], row


def test_a_test_without_digits_is_refused():
    """Nothing that agree recorded, and no mark."""
    with pytest.raises(ValueError, match="test_a compares nothing by agree: mark it by the digits"):
        recorder.digits("test_a")


def test_the_misprints_are_seventeen_with_their_effects():
    """All of them, each with a test; no brace of a figure is left."""
    table, found = recorder.rows(PAGE, "misprints"), recorder.prints()
    assert [int(row[0]) for row in table] == list(range(1, 18))
    for number, *printed, effect, tests in table:
        assert all(printed) and len(printed) == 3, number
        assert sorted(names(tests)) == sorted(found[int(number)]), number
        assert "{" not in effect and effect


def test_a_table_needs_its_markers():
    """A page without the markers is an error, and nothing is written."""
    with pytest.raises(ValueError, match=r"README.md needs the markers <!-- other: .* has them no"):
        recorder.replaced(PAGE, "other", [])
    assert recorder.replaced("a<!-- x: written by a run -->b<!-- end of x -->c", "x", ["d"]) == (
        "a<!-- x: written by a run -->\n\nd\n\n<!-- end of x -->c"
    )


def test_the_table_of_newton_has_the_rows_of_its_script():
    """Tangents and materials of demos/benchmarks/misprints.py, exact ones with 4 or 5 steps."""
    rows = recorder.rows(PAGE, "newton")
    assert [tuple(row[:2]) for row in rows] == list(misprints.ROWS)
    assert all(re.fullmatch(r"[45](, [45]){3}", row[2]) for row in rows if row[0] == "exact")
