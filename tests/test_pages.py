# SPDX-License-Identifier: MIT
"""Every page names what is there: links, code, commands, names; forms for contributors."""

import ast
import builtins
import functools
import importlib
import importlib.util
import re
import shlex
import subprocess
import sys
from datetime import datetime

import numpy as np
import pytest
import ufl
from conftest import ROOT

from demos.pages import responses
from variform import forms, meshes

OUTSIDE = ("results", "build", "dist")  # what runs write
FILES = sorted(
    file
    for file in ROOT.glob("**/*.md")
    if not any(
        part in OUTSIDE or (part.startswith(".") and part != ".github")
        for part in file.relative_to(ROOT).parts
    )
)
every_page = pytest.mark.parametrize("page", FILES, ids=lambda f: str(f.relative_to(ROOT)))
# Words in commands that stand for a reader's own.
PLACEHOLDER = re.compile(r"…|\b[A-Z]{3,}\b|\bNN_|\bmy_")


# --- what stands on a page ----------------------------------------------------------------------


def fences(text):
    """Code blocks: language, code, and the comment before the block if there is one."""
    pattern = r"(?:<!--\s*((?:(?!-->).)*?)\s*-->\s*\n)?^```(\w*)\n(.*?)^```$"
    found = re.finditer(pattern, text, re.DOTALL | re.MULTILINE)
    return [(m[2], m[3], m[1] or "") for m in found]


def prose(text):
    """A page without its code blocks and comments."""
    text = re.sub(r"^```.*?^```$", "", text, flags=re.DOTALL | re.MULTILINE)
    return re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)


def spans(text):
    """Inline code of a page."""
    return re.findall(r"(?<!`)`([^`\n]+)`(?!`)", prose(text).replace("\\|", "|"))


@functools.cache
def anchors(file):
    """Anchors of a page's headings, as GitHub makes them."""
    found, seen = set(), {}
    for heading in re.findall(r"^#{1,6} +(.*?)(?: +#+)?$", prose(file.read_text()), re.MULTILINE):
        text = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", heading)
        slug = re.sub(r"[^\w\- ]", "", text.lower()).replace(" ", "-")
        number = seen.get(slug, 0)
        seen[slug] = number + 1
        found.add(f"{slug}-{number}" if number else slug)
    return found


def dead_links(file):
    """Links and pictures of a page that lead nowhere inside the repository."""
    text = re.sub(r"(?<!`)`[^`\n]+`(?!`)", "", prose(file.read_text()))
    targets = re.findall(r"\]\(<?([^)\s>]+)>?(?: \"[^\"]*\")?\)", text)
    targets += re.findall(r"<(?:img|a)\b[^>]*\b(?:src|href)=\"([^\"]+)\"", text)
    dead = []
    for target in targets:
        if re.match(r"[a-z]+:", target):
            continue
        path, _, anchor = target.partition("#")
        place = (file.parent / path).resolve() if path else file
        if not place.is_relative_to(ROOT) or not place.exists():
            dead.append(target)
        elif anchor and (place.suffix != ".md" or anchor not in anchors(place)):
            dead.append(target)
    return dead


@every_page
def test_links_lead_somewhere(page):
    """Every relative link, anchor and picture."""
    assert dead_links(page) == []


def test_dead_links_would_be_found(tmp_path, monkeypatch):
    monkeypatch.setitem(globals(), "ROOT", tmp_path)
    (tmp_path / "a.md").write_text(
        "# Two `words`, one\n## Two\n## Two\n[a](#two-words-one) [b](#two-1) [c](#two-2)\n"
        "[d](b.md) ![e](e.png) [f](../..) `[g](g)` [h](https://h.org/h)\n"
    )
    assert dead_links(tmp_path / "a.md") == ["#two-2", "b.md", "e.png", "../.."]


# --- code ---------------------------------------------------------------------------------------

BLOCKS = [
    pytest.param(code, comment, id=f"{file.relative_to(ROOT)}-{number}")
    for file in FILES
    for number, (language, code, comment) in enumerate(fences(file.read_text()), 1)
    if language == "python" and file != ROOT / "README.md"  # that one: test_package
]


@pytest.mark.parametrize("code, comment", BLOCKS)
def test_code_of_the_pages_runs(code, comment, run, tmp_path):
    """Each block by itself in an empty folder.

    ``<!-- runs after: CODE -->`` before it gives names that its page has spoken of, and
    ``<!-- not run: REASON -->`` says why it cannot run.
    """
    kind, _, rest = comment.partition(":")
    compile(code, "block", "exec")
    if kind == "not run":
        assert len(rest.split()) >= 3, "say why it is not run"
        return
    if kind == "runs after":
        code = f"{rest.strip()}\n{code}"
    (tmp_path / "block.py").write_text(code)
    run(tmp_path / "block.py", cwd=tmp_path)


# --- commands -----------------------------------------------------------------------------------

STARTS = r"(?:sudo |[A-Z_]+=\S+ )*(?:docker/|python3 |mpirun |bash |sbatch |\.ci/)"


def commands(text):
    """Commands on a page: lines of sh blocks, indented lines and inline code."""
    lines = "\n".join(code for kind, code, _ in fences(text) if kind in ("sh", "bash", "console"))
    # Indented code comes after an empty line; what stands in a list does not count as code.
    lines += "\n" + "\n".join(re.findall(r"(?<=\n\n)((?: {4}.*\n)+)", prose(text)))
    lines = re.sub(r"\\\n\s*", "", lines)
    found = [line.strip().removeprefix("$ ") for line in lines.splitlines()] + spans(text)
    return [line for line in found if re.match(STARTS, line)]


@functools.cache
def pytest_options():
    """Options of pytest and of tests/conftest.py."""
    words = [sys.executable, "-m", "pytest", "--help", "-p", "no:cacheprovider", "tests"]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True)
    return set(re.findall(r"(?<![\w-])--?[a-zA-Z][\w-]*", done.stdout))


def sources(module):
    """Text of a module of the repository, a package's with all its files; nothing of others."""
    spec = importlib.util.find_spec(module)
    if spec is None or not spec.origin or not spec.origin.startswith(str(ROOT)):
        return ""
    if not spec.submodule_search_locations:
        return (ROOT / spec.origin).read_text()
    folder = (ROOT / spec.origin).parent
    return "".join(file.read_text() for file in folder.glob("*.py"))


def wrong_words(command):
    """Files, modules and options of a command that do not exist."""
    words = shlex.split(command.replace("…", " … "), comments=True)
    wrong, module = [], ""
    while words:
        word = words.pop(0)
        if PLACEHOLDER.search(word) or re.match(r"[A-Z_]+=|[<>|]", word):
            continue
        if word == "-m" and not module and words:
            module = words.pop(0)
            if PLACEHOLDER.search(module):
                return wrong
            if importlib.util.find_spec(module) is None:
                wrong.append(module)
            continue
        if word == "-c":  # code of its own: it has to compile, or to be the shell's
            code = words.pop(0)
            if module == "" and "python3" in command.partition("-c")[0]:
                ast.parse(re.sub("…", "", code))
            return wrong
        if module == "pytest" and word.startswith("-"):
            known = word.partition("=")[0] in pytest_options()
            wrong += [] if known else [word]
            if word in ("-m", "-k", "-n", "-p") and words:
                words.pop(0)
        elif word.startswith("--") and module:
            wrong += [] if f'"{word}"' in sources(module) else [word]
        elif word.startswith("--") and not module:
            script = command.split()[0]
            if (ROOT / script).is_file() and word not in (ROOT / script).read_text():
                wrong.append(word)
        elif re.search(r"\.(py|sh|md|txt|lock|yml)$", word) or word.startswith(("docker/", ".ci/")):
            if not list(ROOT.glob(word)):
                wrong.append(word)
    return wrong


@every_page
def test_commands_name_what_exists(page):
    """Modules, files and options of every command shown."""
    wrong = {line: wrong_words(line) for line in commands(page.read_text())}
    assert {line: words for line, words in wrong.items() if words} == {}


def test_the_first_screen_shows_the_two_commands():
    assert {"docker/enter python3 -m demos.twist", "docker/enter python3 -m pytest"} <= set(
        commands((ROOT / "README.md").read_text())
    )


@pytest.mark.parametrize(
    "command, wrong",
    [
        ("docker/enter python3 -m demos.twist -variform_snes_monitor", []),
        ("docker/enter mpirun -n 2 python3 -m demos.twits", ["demos.twits"]),
        ("docker/enter python3 -m demos.pages --tables --tabels", ["--tabels"]),
        (
            "docker/enter python3 -m pytest -m slow --write-tabel tests/test_nothing.py",
            ["--write-tabel", "tests/test_nothing.py"],
        ),
        ("docker/enter python3 -m pytest --write-table tests/test_formulas_*.py", []),
        ("bash .ci/runs", [".ci/runs"]),
        ("docker/enter --remove", []),
        ("docker/enter --removes", ["--removes"]),
        ("docker/enter python3 my_script.py", []),
    ],
)
def test_wrong_commands_would_be_found(command, wrong):
    assert wrong_words(command) == wrong


# --- names --------------------------------------------------------------------------------------


def resolves(name):
    """Whether a dotted name is a module, or something in one."""
    words = name.split(".")
    if words[0] in ("forms", "meshes"):
        words = ["variform", *words]
    for k in range(len(words), 0, -1):
        try:
            found = importlib.util.find_spec(".".join(words[:k]))
        except ModuleNotFoundError:
            continue
        if found is None:
            continue
        if k == len(words):
            return True
        thing = importlib.import_module(".".join(words[:k]))
        for word in words[k:]:
            if not hasattr(thing, word):
                return False
            thing = getattr(thing, word)
        return True
    return False


@functools.cache
def repository():
    """Names of all files."""
    return {
        file.name
        for pattern in ("*", ".ci/*", ".github/**/*", "*/**/*")
        for file in ROOT.glob(pattern)
        if not {*OUTSIDE, ".git"} & set(file.relative_to(ROOT).parts)
    }


def unknown_names(text):
    """Names in inline code, and test files anywhere, that nothing in the repository bears."""
    unknown = []
    for span in spans(text):
        for name in re.findall(r"(?<![\w./])((?:forms|meshes|demos)(?:\.[A-Za-z_]\w*)+)", span):
            if not (PLACEHOLDER.search(name) or resolves(name)):
                unknown.append(name)
        if re.fullmatch(r"[\w./]+\.(?:py|h|md|sh|lock)", span) and not PLACEHOLDER.search(span):
            unknown += [] if span.rpartition("/")[2] in repository() else [span]
    for name in re.findall(r"\b(?:tests/)?(test_\w+\.py)\b", text):
        unknown += [] if name in repository() else [name]
    return unknown


@every_page
def test_names_exist(page):
    """``forms.x``, ``meshes.x``, ``demos.x`` and file names in inline code."""
    assert unknown_names(page.read_text()) == []


def test_unknown_names_would_be_found():
    text = "`forms.solve(potential)` `forms.slove` `meshes.block().x` `nothing.py` test_no.py"
    assert unknown_names(text) == ["forms.slove", "nothing.py", "test_no.py"]


@pytest.mark.parametrize("page", ["demos/documents", "forms/formulas"])
def test_formulas_by_hand_exist(page):
    """``elasticity.invariants`` and others of forms/formulas in inline code."""
    files = {file.stem for file in (ROOT / "forms" / "formulas").glob("[a-z]*.py")}
    names = re.findall(
        r"^(\w+)\.(\w+)$", "\n".join(spans((ROOT / page / "README.md").read_text())), re.M
    )
    named = [(module, name) for module, name in names if module in files]
    assert len(named) > 50
    for module, name in named:
        assert hasattr(importlib.import_module(f"variform.forms.formulas.{module}"), name), name


def known():
    """Names that a page about forms may call without saying where they are."""
    places = [forms, forms.energies, forms.kinematics, forms.membranes, forms.stress]
    places += [meshes, meshes.Body, forms.Path, forms.dissipation, forms.schemes, ufl, builtins]
    return {name for place in places for name in dir(place)} | {"psi"}  # a reader's own


@pytest.mark.parametrize("page", ["README.md", "forms/README.md", "meshes/README.md"])
def test_calls_exist(page):
    """Functions that are called in inline code, as ``clamp(u, …)``."""
    names = known()
    for span in spans((ROOT / page).read_text()):
        for name in re.findall(r"(?<![\w.])([a-z]\w+)\(", span):
            assert name in names, span


# --- for contributors ---------------------------------------------------------------------------

GITHUB = ROOT / ".github"
CONTRIBUTING = (ROOT / "CONTRIBUTING.md").read_text()


def test_forms_for_reports_are_complete():
    """Each has what GitHub asks of a form; the command for the versions runs and tells them."""
    yaml = pytest.importorskip("yaml")
    files = [f for f in (GITHUB / "ISSUE_TEMPLATE").glob("*.yml") if f.name != "config.yml"]
    assert len(files) >= 2
    for file in files:
        form = yaml.safe_load(file.read_text())
        assert {"name", "description", "body"} <= set(form)
        ids = [part["id"] for part in form["body"]]
        assert len(set(ids)) == len(ids) and any(
            part.get("validations", {}).get("required") for part in form["body"]
        )
        for part in form["body"]:
            assert part["type"] in ("textarea", "input", "dropdown", "checkboxes")
            assert part["attributes"]["label"]
        assert [w for line in spans(file.read_text()) for w in wrong_words(line)] == []


def test_the_command_for_the_versions_tells_them(run):
    """What bug.yml asks for ends with the versions of all that counts."""
    text = (GITHUB / "ISSUE_TEMPLATE" / "bug.yml").read_text()
    code = re.search(r'docker/enter python3 -c "(.*?)"`', text)[1]
    told = ast.literal_eval(run("-c", code).stdout.strip())
    assert {"Python", "PETSc", "fenics-dolfinx", "fenics-ufl"} <= set(told)


def test_the_list_of_a_pull_request_is_that_of_contributing():
    """Each question of CONTRIBUTING.md, or its beginning, in the same order."""
    asked = re.findall(r"^\d\. ((?:Would|Does|Has|Are) .*)$", CONTRIBUTING, re.MULTILINE)
    boxes = re.findall(r"^- \[ \] (.*)$", (GITHUB / "PULL_REQUEST_TEMPLATE.md").read_text(), re.M)
    assert len(asked) == len(boxes) == 6
    for question, box in zip(asked, boxes, strict=True):
        assert question.startswith(box.removesuffix("."))


def test_the_citation_has_what_its_format_requires():
    """Fields that the Citation File Format 1.2.0 requires, and those that a citation needs."""
    yaml = pytest.importorskip("yaml")
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert {"cff-version", "message", "title", "authors", "version", "license"} <= set(citation)
    assert citation["cff-version"] == "1.2.0" and citation["type"] == "software"
    for author in citation["authors"]:
        assert author.get("name") or (author.get("family-names") and author.get("given-names"))
    assert all(isinstance(citation[key], str) for key in ("message", "title", "version", "license"))


def test_workflows_run_what_there_is():
    """They are YAML with jobs of steps, and each command of theirs names what exists."""
    yaml = pytest.importorskip("yaml")
    files = sorted((GITHUB / "workflows").glob("*.yml"))
    assert [file.stem for file in files] == ["site", "tests"]
    for file in files:
        workflow = yaml.safe_load(file.read_text())
        steps = [step for job in workflow["jobs"].values() for step in job["steps"]]
        assert all(("uses" in step) != ("run" in step) for step in steps)
        typed = [step["run"] for step in steps if "run" in step]
        assert typed and all(re.match(STARTS, command) for command in typed)
        assert [word for command in typed for word in wrong_words(command)] == []


def test_the_paper_has_the_figures_of_the_benchmark():
    """Its table is that of the page, row by row; all that is cited is listed, and no more."""
    paper, list_ = ((ROOT / name).read_text() for name in ("paper.md", "paper.bib"))
    rows = re.findall(r"^\|.*\|$", paper, re.MULTILINE)
    page = (ROOT / "demos" / "benchmarks" / "README.md").read_text()
    assert len(rows) == 6 and [row for row in rows if f"\n{row}\n" not in page] == []
    cited = set(re.findall(r"@(\w+)", paper))
    assert cited == set(re.findall(r"^@\w+\{(\w+),$", list_, re.MULTILINE))


def test_the_paper_has_what_its_journal_asks_for():
    """Front matter, sections and references as the Journal of Open Source Software's."""
    yaml = pytest.importorskip("yaml")
    _, front, text = (ROOT / "paper.md").read_text().split("---\n", 2)
    about = yaml.safe_load(front)
    assert {"title", "tags", "authors", "affiliations", "date", "bibliography"} == set(about)
    known = {str(place["index"]) for place in about["affiliations"] if place["name"]}
    for author in about["authors"]:
        assert author["name"] and set(str(author["affiliation"]).split(", ")) <= known
    assert len(about["tags"]) >= 3 and datetime.strptime(about["date"], "%d %B %Y")
    heads = re.findall(r"^# (.*)$", text, re.MULTILINE)
    assert heads[:2] == ["Summary", "Statement of need"] and heads[-1] == "References"
    assert 250 <= len(text.split()) <= 1750
    entries = (ROOT / about["bibliography"]).read_text().strip().split("\n\n")
    for entry in entries:
        assert re.match(r"@(article|misc|techreport|inproceedings)\{\w+,\n", entry), entry
        assert entry.count("{") == entry.count("}") and entry.endswith("\n}"), entry
        fields = set(re.findall(r"^  (\w+) = \{.*\},?$", entry, re.MULTILINE))
        assert {"author", "title", "year"} <= fields, entry
        assert len(fields) == entry.count("\n") - 1, entry  # one a line


def test_the_energy_of_contributing_is_right():
    """Uniaxially P = mu Jm (l - l^-2) / (Jm - I1 + 3)."""
    block = next(code for kind, code, _ in fences(CONTRIBUTING) if kind == "python")
    names = {}
    exec(block, names)
    s, Jm = np.array([0.8, 1.0, 1.5]), 20.0
    P = responses.Stress(lambda F: names["gent"](F, 1.0, Jm))
    wanted = Jm * (s - s**-2) / (Jm - (s**2 + 2 / s) + 3)
    np.testing.assert_allclose(responses.response(P, s, 1, "incompressible"), wanted, atol=1e-9)
