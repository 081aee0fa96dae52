# SPDX-License-Identifier: MIT
"""What the tests of the documents measure, and the tables that a run writes into the README.

``agree`` of tests/cases.py records the error of each comparison under the test that makes it,
``off`` the figures of misprints; ``pytest --write-table tests/test_formulas_*.py
tests/test_match.py`` writes both into forms/formulas/README.md.
"""

from __future__ import annotations

import math
import os
import re
from pathlib import Path

from capabilities import BOUNDS, CAPABILITIES, ERRATA

PAGE = Path(__file__).resolve().parent.parent / "forms" / "formulas" / "README.md"
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


def digits(test: str) -> int | str:
    """Digits of a test: those measured, or those that it asserts."""
    if test not in errors:
        return BOUNDS[test]
    found = DOUBLE if errors[test] == 0 else min(DOUBLE, math.floor(-math.log10(errors[test])))
    bound = BOUNDS.get(test, DOUBLE)
    return found if isinstance(bound, str) else min(found, bound)


def _least(tests: tuple[str, ...]) -> str:
    numbers = [d for d in map(digits, tests) if isinstance(d, int)]
    words = sorted({d for d in map(digits, tests) if isinstance(d, str)})
    return ", ".join([*map(str, numbers and [min(numbers)]), *words])


def _cell(names: tuple[str, ...]) -> str:
    return ", ".join(f"`{name}`" for name in names)


def capabilities() -> list[str]:
    """Lines of the table of all items."""
    lines = [
        "| Item | Document | Equation | What | Functions | Tests | Digits |",
        "| --- " * 7 + "|",
    ]
    for c in CAPABILITIES:
        cells = [str(c.item), c.document, c.equation, c.what, _cell(c.functions), _cell(c.tests)]
        lines.append(f"| {' | '.join([*cells, _least(c.tests)])} |")
    return lines


def errata() -> list[str]:
    """Lines of the table of printed errors."""
    lines = ["| No. | Document, place | Printed | Corrected | Effect of the print | Test |"]
    lines.append("| --- " * 6 + "|")
    for number, e in enumerate(ERRATA, 1):
        effect = e.effect.format(*(x for test in e.tests for x in figures.get(test, [])))
        cells = [str(number), e.place, e.printed, e.corrected, effect, _cell(e.tests)]
        lines.append(f"| {' | '.join(cells)} |")
    return lines


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
    wanted = {test for row in (*CAPABILITIES, *ERRATA) for test in row.tests}
    missing = sorted(wanted - finished)
    if missing:
        return f"{PAGE.name} is not written: {', '.join(missing)} did not pass or did not run."
    page = replaced(PAGE.read_text(), "capabilities", capabilities())
    PAGE.write_text(replaced(page, "misprints", errata()))
    return f"{PAGE.name}: {len(CAPABILITIES)} capabilities and {len(ERRATA)} misprints written."
