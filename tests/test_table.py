# SPDX-License-Identifier: MIT
"""The tables of forms/formulas/README.md: complete, naming what exists, with the digits reached."""

import ast
import operator
import re
from importlib import import_module

import pytest
import recorder
from capabilities import BOUNDS, CAPABILITIES, ERRATA
from conftest import ROOT

from demos.benchmarks import misprints
from variform import forms

PAGE = (ROOT / "forms" / "formulas" / "README.md").read_text()


def table(name):
    """Cells of the rows between two markers, without the head."""
    part = PAGE.partition(f"<!-- {name}: ")[2].partition(f"<!-- end of {name} -->")[0]
    lines = [line for line in part.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line[1:-1].split(" | ")] for line in lines[2:]]


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


def test_the_table_has_all_82_items():
    """Items 1 to 82 of documents 000 to 003, as capabilities.py has them."""
    rows = table("capabilities")
    assert [int(row[0]) for row in rows] == list(range(1, 83))
    for row, c in zip(rows, CAPABILITIES, strict=True):
        assert row[1:4] == [c.document, c.equation, c.what]
        assert tuple(re.findall(r"`(.*?)`", row[4])) == c.functions and c.functions
        assert tuple(re.findall(r"`(.*?)`", row[5])) == c.tests and c.tests
    assert [row[1] for row in rows] == ["000"] * 23 + ["001"] * 16 + ["002"] * 11 + ["003"] * 32


def test_every_function_named_exists():
    """In forms.formulas, or where its full name says."""
    for c in CAPABILITIES:
        for name in c.functions:
            if name.startswith("forms."):
                assert callable(operator.attrgetter(name.removeprefix("forms."))(forms)), name
            else:
                module, _, function = name.partition(".")
                inside = import_module(f"variform.forms.formulas.{module}")
                assert callable(getattr(inside, function)), name


def test_every_test_named_exists():
    """Each name is that of one test, so that it needs no file."""
    found = collectable()
    named = {test for row in (*CAPABILITIES, *ERRATA) for test in row.tests}
    for name in named | set(re.findall(r"`(test_\w+)`", PAGE)):
        assert len(found.get(name, [])) == 1, (name, found.get(name))
    assert set(BOUNDS) <= named


def test_no_row_has_fewer_than_nine_digits():
    """A number, or how it is proved without one."""
    for row in table("capabilities"):
        numbers = re.findall(r"\d+", row[6])
        assert all(9 <= int(n) <= recorder.DOUBLE for n in numbers)
        assert re.fullmatch(r"(\d+)?(, )?((symbolic|exact)(, )?)*", row[6]) and row[6], row


def test_the_misprints_are_seventeen_with_their_effects():
    """All of them, each with a test; no brace of a figure is left."""
    rows = table("misprints")
    assert [int(row[0]) for row in rows] == list(range(1, 18))
    for row, e in zip(rows, ERRATA, strict=True):
        assert row[1:4] == [e.place, e.printed, e.corrected]
        assert "{" not in row[4] and row[4]


def test_a_table_needs_its_markers():
    """A page without the markers is an error, and nothing is written."""
    with pytest.raises(ValueError, match=r"README.md needs the markers <!-- other: .* has them no"):
        recorder.replaced(PAGE, "other", [])
    assert recorder.replaced("a<!-- x: written by a run -->b<!-- end of x -->c", "x", ["d"]) == (
        "a<!-- x: written by a run -->\n\nd\n\n<!-- end of x -->c"
    )


def test_the_table_of_newton_has_the_rows_of_its_script():
    """Tangents and materials of demos/benchmarks/misprints.py, exact ones with 4 or 5 steps."""
    rows = table("newton")
    assert [tuple(row[:2]) for row in rows] == list(misprints.ROWS)
    assert all(re.fullmatch(r"[45](, [45]){3}", row[2]) for row in rows if row[0] == "exact")
