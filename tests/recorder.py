# SPDX-License-Identifier: MIT
"""What the tests of the documents prove and measure, and the columns of the README that hold it.

A test says by a mark which capabilities it proves and which misprint's effect it measures.
``agree`` of tests/cases.py records the error of each comparison under the test that makes it,
``off`` the figures of misprints; ``pytest --write-table tests/test_formulas_*.py
tests/test_match.py`` writes both, and the names of the tests, into the last two columns of the
tables of forms/formulas/README.md.
"""

from __future__ import annotations

import ast
import math
import os
import re
from functools import cache
from pathlib import Path
from typing import Any

TESTS = Path(__file__).resolve().parent
PAGE = TESTS.parent / "forms" / "formulas" / "README.md"
FILES = ("test_formulas_", "test_match.")  # of the tests that the tables speak of
DOUBLE = 15  # digits that are credited at most
errors: dict[str, float] = {}  # the largest of each test
figures: dict[str, list[float]] = {}  # what each test measured, in order
finished: set[str] = set()  # tests that passed


def named(node: str) -> str:
    """Name of a test without file and parameters; nothing for those of other files."""
    file, _, test = node.partition("::")
    return (
        re.sub(r"[\[ ].*$", "", test, flags=re.DOTALL) if Path(file).name.startswith(FILES) else ""
    )


def _test() -> str:
    return named(os.environ.get("PYTEST_CURRENT_TEST", ""))


def error(value: float) -> None:
    """Keep the error of a comparison."""
    errors[_test()] = max(errors.get(_test(), 0.0), float(value))


def figure(*values: float) -> None:
    """Keep figures for the table of misprints."""
    figures.setdefault(_test(), []).extend(map(float, values))


@cache
def marks(name: str) -> dict[str, list[tuple[Any, ...]]]:
    """Arguments of the marks of a name, for each test of the tables' files that has them.

    Read from the decorators, so that no file is imported and a test's parameters do not count.
    """
    found: dict[str, list[tuple[Any, ...]]] = {}
    for file in sorted(TESTS.glob("test_*.py")):
        for node in ast.parse(file.read_text()).body if file.name.startswith(FILES) else ():
            for mark in node.decorator_list if isinstance(node, ast.FunctionDef) else ():
                if isinstance(mark, ast.Call) and ast.unparse(mark.func) == f"pytest.mark.{name}":
                    words = tuple(map(ast.literal_eval, mark.args))
                    found.setdefault(node.name, []).append(words)
    return found


def proofs() -> dict[int, list[str]]:
    """The tests of each item, by their marks."""
    return _turned({test: sum(found, ()) for test, found in marks("capability").items()})


def prints() -> dict[int, list[str]]:
    """The tests of each misprint, by their marks."""
    found = marks("misprint").items()
    return _turned({test: tuple(number for number, _ in each) for test, each in found})


def _turned(numbers: dict[str, tuple[int, ...]]) -> dict[int, list[str]]:
    found: dict[int, list[str]] = {}
    for test, its in numbers.items():
        for number in its:
            found.setdefault(number, []).append(test)
    return found


def digits(test: str) -> int | str:
    """Digits of a test: those measured, or those that it asserts."""
    ((bound,),) = marks("digits").get(test, [(DOUBLE,)])
    if test not in errors:
        if test not in marks("digits"):
            raise ValueError(f"{test} compares nothing by agree: mark it by the digits it asserts.")
        return bound
    found = DOUBLE if errors[test] == 0 else min(DOUBLE, math.floor(-math.log10(errors[test])))
    return found if isinstance(bound, str) else min(found, bound)


def _least(tests: list[str]) -> str:
    numbers = [d for d in map(digits, tests) if isinstance(d, int)]
    words = sorted({d for d in map(digits, tests) if isinstance(d, str)})
    return ", ".join([*map(str, numbers and [min(numbers)]), *words])


def _effect(number: int, tests: list[str]) -> str:
    effects = [
        effect.format(*figures.get(test, []))
        for test in tests
        for one, effect in marks("misprint")[test]
        if one == number
    ]
    return "; ".join(effects)


def rows(page: str, name: str) -> list[list[str]]:
    """Cells of the table between the two markers of a name, without its head."""
    part = page.partition(f"<!-- {name}: ")[2].partition(f"<!-- end of {name} -->")[0]
    lines = [line for line in part.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line[1:-1].split(" | ")] for line in lines[2:]]


def _ordered(row: list[str], found: dict[int, list[str]]) -> list[str]:
    """The tests of a row as the page has them; those that it has not come last."""
    named = re.findall(r"`(test_\w+)`", " ".join(row))
    return sorted(found[int(row[0])], key=lambda t: named.index(t) if t in named else len(named))


def _line(cells: list[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _cell(tests: list[str]) -> str:
    return ", ".join(f"`{test}`" for test in tests)


def capabilities(page: str) -> list[str]:
    """Lines of the table of all items: the page's own cells, the tests, their digits."""
    head = ["Item", "Document", "Equation", "What", "Functions", "Tests", "Digits"]
    lines = [_line(head), "| --- " * len(head) + "|"]
    for row in rows(page, "capabilities"):
        tests = _ordered(row, proofs())
        lines.append(_line([*row[:5], _cell(tests), _least(tests)]))
    return lines


def misprints(page: str) -> list[str]:
    """Lines of the table of printed errors: the page's own cells, what they do, the tests."""
    head = ["No.", "Document, place", "Printed", "Corrected", "Effect of the print", "Test"]
    lines = [_line(head), "| --- " * len(head) + "|"]
    for row in rows(page, "misprints"):
        tests = _ordered(row, prints())
        lines.append(_line([*row[:4], _effect(int(row[0]), tests), _cell(tests)]))
    return lines


def strangers(page: str) -> list[str]:
    """What marks and tables do not have in common, in sentences."""
    found = []
    for name, tests in (("capabilities", proofs()), ("misprints", prints())):
        numbers = {int(row[0]) for row in rows(page, name)}
        for number in sorted(numbers - set(tests)):
            found.append(f"no test is marked with {number} of the {name}")
        for number in sorted(set(tests) - numbers):
            found.append(f"{', '.join(tests[number])}: there is no {number} of the {name}")
    return found


def replaced(page: str, name: str, lines: list[str]) -> str:
    """The page with new lines between the two markers of a name."""
    begin, end = f"<!-- {name}: written by a run -->", f"<!-- end of {name} -->"
    head, _, rest = page.partition(begin)
    _, found, tail = rest.partition(end)
    if not found:
        raise ValueError(f"{PAGE.name} needs the markers {begin} and {end}, and has them not.")
    return "\n".join([head + begin, "", *lines, "", end + tail])


def write() -> str:
    """Write both tables; a sentence on what was done."""
    page = PAGE.read_text()
    if strange := strangers(page):
        return f"{PAGE.name} is not written: {'; '.join(strange)}."
    missing = sorted({*marks("capability"), *marks("misprint")} - finished)
    if missing:
        return f"{PAGE.name} is not written: {', '.join(missing)} did not pass or did not run."
    first, second = capabilities(page), misprints(page)
    page = replaced(page, "capabilities", first)
    PAGE.write_text(replaced(page, "misprints", second))
    items, errata = len(first) - 2, len(second) - 2
    return f"{PAGE.name}: {items} capabilities and {errata} misprints written."
