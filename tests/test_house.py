# SPDX-License-Identifier: MIT
"""The house as it is drawn: imports point down, private names stay in their folder, one name."""

import ast
import inspect
import re
import sys
from importlib import import_module
from pkgutil import iter_modules

import pytest
from conftest import ROOT

from variform import forms, meshes

PACKAGES = [forms, forms.energies, forms.operators, meshes]


def imports(top):
    """Pairs (module, imported module or None, names) of a package's relative imports."""
    files = {".".join(f.relative_to(ROOT).with_suffix("").parts): f for f in modules_of(top)}
    found = []
    for name, file in files.items():
        package = name.removesuffix(".__init__") if file.stem == "__init__" else _parent(name)
        for node in ast.walk(ast.parse(file.read_text())):
            if not isinstance(node, ast.ImportFrom) or not node.level:
                continue
            base = package.split(".")[: len(package.split(".")) - node.level + 1]
            target = ".".join([*base, *filter(None, [node.module])])
            for alias in node.names:
                whole = f"{target}.{alias.name}"
                known = [n for n in (whole, f"{whole}.__init__", target) if n in files]
                found.append((name, known[0] if known else f"{target}.__init__", alias.name))
    return found


def modules_of(top):
    return sorted((ROOT / top).glob("**/*.py"))


def _parent(name):
    return name.rpartition(".")[0]


def floors():
    """Rooms of the drawing in forms/README.md, the lowest first: one set of names a line."""
    text = (ROOT / "forms" / "README.md").read_text()
    lines = text.partition("no line above")[2].partition("```")[2].partition("```")[0]
    drawn = [re.split(r"\s{2,}", line)[0] for line in lines.strip().splitlines()]
    return [set(line.split(", ")) for line in reversed(drawn)]


def room(module):
    """The room of a module: the deepest of its folders that is drawn, or the module at the top."""
    *folders, _ = inside = module.split(".")[1:]
    drawn = set().union(*floors())
    for depth in range(len(folders), 1, -1):
        if (deep := "/".join([*folders[:depth], ""])) in drawn:
            return deep
    return f"{folders[0]}/" if folders else inside[0]


def test_the_drawing_shows_every_room_once():
    """Each module of forms is in one line, but for the public face and the oracle."""
    drawn = [name for floor in floors() for name in floor]
    assert len(set(drawn)) == len(drawn)
    names = (".".join(f.relative_to(ROOT).with_suffix("").parts) for f in modules_of("forms"))
    rooms = {room(n) for n in names} - {"__init__", "formulas/"}
    assert rooms == set(drawn)


def test_arrows_point_down():
    """An import goes to a lower line of the drawing, or stays in its room."""
    level = {name: k for k, floor in enumerate(floors()) for name in floor}
    wrong = []
    for module, target, _ in imports("forms"):
        here, there = room(module), room(target)
        if {here, there} & {"__init__", "formulas/"} or here == there:
            continue
        if level[there] >= level[here]:
            wrong.append((module, target))
    assert wrong == []


@pytest.mark.parametrize("top", ["forms", "meshes"])
def test_there_is_no_circle(top):
    """The modules can be put in an order in which each imports earlier ones only."""
    waiting = {module: set() for module, _, _ in imports(top)}
    for module, target, _ in imports(top):
        if target.removesuffix(".__init__") != _parent(module):  # a package imports its modules
            waiting[module].add(target)
    done = set()
    while ready := {m for m, needs in waiting.items() if not (needs & set(waiting)) - done} - done:
        done |= ready
    assert sorted(set(waiting) - done) == []


def test_packages_know_each_other_as_drawn():
    """Meshes and forms know nothing of each other or of demos; imports inside are relative."""
    for top in ("forms", "meshes"):
        for file in modules_of(top):
            found = re.findall(
                r"^\s*(?:from|import) (forms|meshes|demos|tests|variform)\b",
                file.read_text(),
                re.MULTILINE,
            )
            assert found == [], file
            if file.name not in ("_dolfinx.py", "tables.py"):
                assert "__version__" not in file.read_text(), file


def test_no_private_name_crosses_a_folder():
    """A name with an underscore is imported in its own folder only; so do the demos."""
    wrong = [
        (module, target, name)
        for top in ("forms", "meshes")
        for module, target, name in imports(top)
        if name.startswith("_") and _parent(module) != _parent(target) and "._" not in target
    ]
    assert wrong == []
    for file in (ROOT / "demos").glob("**/*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("variform"):
                private = [a.name for a in node.names if a.name.startswith("_")]
                assert not [n for n in private if not n.startswith("_dolfinx")], file


@pytest.mark.parametrize("package", PACKAGES, ids=lambda p: p.__name__)
def test_no_function_bears_the_name_of_a_module_beside_it(package):
    """A name is a function or a module of its package, so that both can be imported."""
    modules = {info.name for info in iter_modules(package.__path__)}
    functions = {name for name in package.__all__ if not inspect.ismodule(getattr(package, name))}
    assert modules & functions == set()
    for name in modules:
        module = import_module(f"{package.__name__}.{name}")
        assert inspect.ismodule(getattr(package, name)) and getattr(package, name) is module


def test_everything_has_one_name(run, tmp_path):
    """Nothing is loaded as forms or meshes; importing either in a clone says what to write."""
    code = """
import sys
from variform import forms, meshes
print(sorted(name for name in sys.modules if name.split(".")[0] in ("forms", "meshes")))
for name in "forms", "meshes":
    try:
        __import__(name)
    except ImportError as error:
        print(error)
"""
    lines = run("-c", code, cwd=ROOT).stdout.splitlines()
    sentence = "the packages have one name: write `from variform import forms, meshes`."
    assert lines == ["[]", sentence, sentence]


def test_names_that_have_moved_say_where():
    """An AttributeError with the new place, where the name is; of others as Python has it."""
    assert len(forms.__all__) <= 73
    for name, place in forms._MOVED.items():
        with pytest.raises(AttributeError, match=rf"forms.{name} is now forms.{place}.{name}\."):
            getattr(forms, name)
        assert hasattr(import_module(f"variform.forms.{place}"), name)
    with pytest.raises(AttributeError, match=r"forms.system is now forms.Problem\."):
        forms.system  # noqa: B018
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        forms.nothing  # noqa: B018


def test_packages_are_all_listed():
    """Each folder with modules is in the wheel's list."""
    project = (ROOT / "pyproject.toml").read_text()
    listed = set(re.findall(r'^    "(variform[\w.]*)",$', project, re.MULTILINE))
    found = {
        ".".join(("variform", *init.parent.relative_to(ROOT).parts))
        for top in ("forms", "meshes")
        for init in (ROOT / top).glob("**/__init__.py")
    }
    assert found | {"variform"} == listed
    assert "variform" in sys.modules
