# SPDX-License-Identifier: MIT
"""Notebooks are their sources, executed, and the solutions of their exercises run."""

import itertools
import re
import time

import pytest
from conftest import ROOT

jupytext = pytest.importorskip("jupytext")
nbformat = pytest.importorskip("nbformat")

FOLDER = ROOT / "demos" / "notebooks"
SOURCES = sorted(FOLDER.glob("[0-9][0-9]_*.py"))
each = pytest.mark.parametrize("source", SOURCES, ids=lambda file: file.stem)


def notebook(source):
    return nbformat.read(source.with_suffix(".ipynb"), as_version=4)


def code_cells(source):
    return [cell for cell in notebook(source).cells if cell.cell_type == "code"]


def test_numbers_have_no_gaps():
    """01 to 12, a notebook for each source, and a line of the table for each notebook."""
    assert [file.stem[:2] for file in SOURCES] == [f"{n:02d}" for n in range(1, 13)]
    built = sorted(file.stem for file in FOLDER.glob("*.ipynb"))
    assert built == [file.stem for file in SOURCES]
    rows = re.findall(r"^\| .*\[(.+?)\]\((\w+)\.ipynb\)", (FOLDER / "README.md").read_text(), re.M)
    titles = [notebook(file).cells[0].source.split("\n")[0][2:] for file in SOURCES]
    assert rows == list(zip(titles, built, strict=True))


@each
def test_cells_are_those_of_the_source(source):
    """Type and text of every cell; the license line stays out of sight."""
    license_line, text = source.read_text().split("\n", 1)
    assert license_line == "# SPDX-License-Identifier: MIT"
    wanted = jupytext.reads(text.lstrip(), fmt="py:percent").cells
    found = notebook(source).cells
    assert [(c.cell_type, c.source) for c in found] == [(c.cell_type, c.source) for c in wanted]


@each
def test_cells_were_executed_in_order_without_errors(source):
    """Execution counts 1 to n, nothing on stderr, no slider's shell, below 600 kB."""
    cells = code_cells(source)
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1))
    outputs = [output for cell in cells for output in cell.outputs]
    assert any(output.output_type == "stream" for output in outputs)
    assert {output.get("name", "stdout") for output in outputs} == {"stdout"}
    assert "error" not in {output.output_type for output in outputs}
    assert not any("widget" in kind for output in outputs for kind in output.get("data", {}))
    assert source.with_suffix(".ipynb").stat().st_size < 600_000


@each
def test_nothing_of_the_run_is_left(source):
    """No paths, no objects' addresses, no metadata: the next run writes the same file."""
    outputs = [output for cell in code_cells(source) for output in cell.outputs]
    shown = [output.get("text", output.get("data", {}).get("text/plain", "")) for output in outputs]
    assert not re.search(r"/tmp/|/root/|/home/|at 0x[0-9a-f]{6}", "\n".join(shown))
    assert set(notebook(source).metadata) == {"kernelspec", "language_info"}
    assert not any(cell.metadata for cell in notebook(source).cells)


@each
def test_title_questions_and_exercises(source):
    """A numbered title, a question in each part, exercises at the end with hidden solutions."""
    cells = [cell.source for cell in notebook(source).cells if cell.cell_type == "markdown"]
    text = "\n".join(cells)
    assert cells[0].startswith(f"# {int(source.stem[:2])}. ")
    parts = re.findall(r"^## (.+)$", text, re.M)
    assert 4 <= len(parts) - 1 <= 8 and parts[-1] == "Exercises"
    assert text.count("**Question.**") >= len(parts) - 1
    exercises = text[text.index("## Exercises") :]
    assert exercises.count("<details>") == exercises.count("</details>") >= 2
    every = notebook(source).cells
    for cell, after in itertools.pairwise(every):
        if number := re.match(r"\*\*Exercise (\d+)\.", cell.source):
            answer = f"# Your answer to exercise {number[1]}:"
            assert (after.cell_type, after.source) == ("code", answer)
    for solution in re.findall("<details>.*?</details>", exercises, re.S):
        blocks = re.findall(r"^```python\n(.*?)^```$", solution, re.M | re.S)
        assert re.search(r"^ *(assert |raise AssertionError)", "".join(blocks), re.M), solution


@pytest.mark.slow
@each
def test_runs_with_its_solutions(source, run):
    """The builder runs cells and solutions, refuses what raises or warns, and writes nothing."""
    if "forms.touching" in source.read_text():
        pytest.importorskip("ipctk", reason="ipctk, an optional package, is not installed")
    before = source.with_suffix(".ipynb").read_bytes()
    done = run("-m", "demos.notebooks", "--check", source.stem)
    assert re.fullmatch(rf"{source.stem} +[\d.]+ s +\d+ kB\n", done.stdout)
    assert done.stderr == ""
    assert source.with_suffix(".ipynb").read_bytes() == before


def test_no_reply_is_lost_beside_a_slider(monkeypatch):
    """A slider's output goes to the kernel just when the cell's reply is there: it is found."""
    pytest.importorskip("ipywidgets")
    output_widget = pytest.importorskip("nbclient.output_widget").OutputWidget
    builder = pytest.importorskip("demos.notebooks.__main__")
    sync_state = output_widget.sync_state

    def late(widget):
        time.sleep(0.3)  # the event loop stands still meanwhile, and the reply comes
        sync_state(widget)

    monkeypatch.setattr(output_widget, "sync_state", late)
    source = "from ipywidgets import interact\ninteract(lambda g: print('here'), g=(0, 9))"
    cells = [nbformat.v4.new_code_cell(source) for _ in range(2)]
    start = time.monotonic()
    builder.execute(nbformat.v4.new_notebook(cells=cells), seconds=60)
    assert time.monotonic() - start < 60  # nbclient looks once more when the time is up
    assert [cell.execution_count for cell in cells] == [1, 2]
