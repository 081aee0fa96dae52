# SPDX-License-Identifier: MIT
"""How many wrong formulas do the tests notice? Mutants of the formulas, operators and kernels.

``docker/enter python3 -m tests.mutate --count 300 --seed 1 --minutes 60`` copies the repository
into a scratch folder, changes one operator, sign, comparison, constant or term at a time there, and
runs the tests of that module. It prints which mutants survive; a second call with the same folder
goes on where the first stopped (remove the folder when the sources have changed). With
``--survivors LOG`` and another folder it runs what the log.jsonl of an earlier run does not say was
caught, after tests have been added. Not part of the test suite: it takes hours.
"""

from __future__ import annotations

import argparse
import ast
import difflib
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parent.parent
# Files of each module, quick ones first.
OPERATORS = ["test_point_kernels", "test_quotients", "test_match", "test_projection"]
OPERATORS += ["test_operators", "test_operator_errors", "test_native"]
ELASTICITY = ["test_formulas_elasticity", "test_formulas_materials"]
ELEMENT = ["test_formulas_shapes", "test_formulas_element", "test_formulas_assembly"]
TESTS = {
    "formulas/_algebra.py": [*ELASTICITY, "test_formulas_polar"],
    "formulas/derivation.py": ["test_formulas_derivation"],
    "formulas/elasticity.py": [*ELASTICITY, *ELEMENT],
    "formulas/element.py": ELEMENT,
    "formulas/materials.py": [*ELASTICITY, *ELEMENT],
    "formulas/membrane_eigensystems.py": ["test_formulas_membranes", "test_formulas_properties"],
    "formulas/membrane_invariants.py": ["test_formulas_membranes", "test_formulas_properties"],
    "formulas/polar.py": ["test_formulas_polar", "test_formulas_properties"],
    "formulas/quadrature.py": ELEMENT,
    "formulas/quotients.py": ["test_formulas_svd", "test_formulas_derivation"],
    "formulas/shapes.py": ELEMENT,
    "formulas/svd_derivatives.py": ["test_formulas_svd", "test_formulas_derivation"],
    "operators/": OPERATORS,
    "native/kernels/": OPERATORS,
    "native/kernels/validity.h": ["test_validity"],
}
SWAPS = {
    **{ast.Add: "-", ast.Sub: "+", ast.Mult: "/", ast.Div: "*", ast.Pow: "*"},
    **{ast.Lt: "<=", ast.LtE: "<", ast.Gt: ">=", ast.GtE: ">", ast.Eq: "!=", ast.NotEq: "=="},
}
C_SWAPS = {
    **{" + ": " - ", " - ": " + ", " * ": " / ", " / ": " * ", " += ": " -= ", " -= ": " += "},
    **{" < ": " <= ", " <= ": " < ", " > ": " >= ", " >= ": " > ", " == ": " != ", " != ": " == "},
    **{" && ": " || ", " || ": " && "},
}
TOO_SLOW, REFUSED = "time limit", "did not compile"
COMPILER = r"CompileError|VerificationError|^E +OSError: .*(error|warning):"


class Mutant(NamedTuple):
    """Bytes start to end of a file, replaced."""

    path: str
    start: int
    end: int
    text: str

    def applied(self, source: bytes) -> bytes:
        """The file with this change."""
        return source[: self.start] + self.text.encode() + source[self.end :]


def mutants(path: str, source: bytes) -> list[Mutant]:
    """All mutants of one file."""
    found = _of_python(source) if path.endswith(".py") else _of_c(source)
    return [Mutant(path, *change) for change in sorted(set(found))]


def _of_python(source: bytes) -> list[tuple[int, int, str]]:
    starts = [0]
    for line in source.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))

    def first(node: ast.AST) -> int:
        return starts[node.lineno - 1] + node.col_offset

    def last(node: ast.AST) -> int:
        return starts[node.end_lineno - 1] + node.end_col_offset

    found = []

    def between(left: ast.AST, right: ast.AST, text: str) -> None:
        gap = source[last(left) : first(right)]
        operator = re.search(rb"\*\*|[<>=!]=|[-+*/<>]", re.sub(rb"[()\s]", b" ", gap))
        if operator:
            at = last(left)
            found.append((at + operator.start(), at + operator.end(), text))

    def visit(node: ast.AST) -> None:
        # Messages and types are no formulas.
        if isinstance(node, ast.Raise | ast.JoinedStr | ast.AnnAssign | ast.ClassDef | ast.Import):
            if not isinstance(node, ast.ClassDef):
                return
        if isinstance(node, ast.FunctionDef):
            for child in (*node.args.defaults, *node.args.kw_defaults, *node.body):
                if child is not None:
                    visit(child)
            return
        if isinstance(node, ast.BinOp) and type(node.op) in SWAPS:
            between(node.left, node.right, SWAPS[type(node.op)])
            if isinstance(node.op, ast.Add | ast.Sub):
                kept = source[first(node.left) : last(node.left)]
                if kept.count(b"(") == kept.count(b")"):
                    found.append((first(node), last(node), kept.decode()))
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
            operand = source[first(node.operand) : last(node.operand)]
            found.append((first(node), last(node), operand.decode()))
        elif isinstance(node, ast.Compare) and type(node.ops[0]) in SWAPS:
            between(node.left, node.comparators[0], SWAPS[type(node.ops[0])])
        elif isinstance(node, ast.Constant) and type(node.value) in (int, float):
            value = node.value + 1 if isinstance(node.value, int) else node.value * 1.5
            found.append((first(node), last(node), repr(value or 1)))
        for child in ast.iter_child_nodes(node):
            visit(child)

    visit(ast.parse(source))
    return found


def _of_c(source: bytes) -> list[tuple[int, int, str]]:
    text = source.decode("latin-1")

    def blank(match: re.Match[str]) -> str:
        return re.sub(r"[^\n]", "@", match.group())

    # Comments, preprocessor lines with their continuations, strings.
    hidden = re.sub(
        r"/\*.*?\*/|//[^\n]*|^#(?:[^\n]*\\\n)*[^\n]*|\"[^\"\n]*\"", blank, text, flags=re.S | re.M
    )
    found = []
    for old, new in C_SWAPS.items():
        found += [(m.start(), m.end(), new) for m in re.finditer(f"(?={re.escape(old)})", hidden)]
        found = [(a, a + len(old) if a == b else b, t) for a, b, t in found]
    for m in re.finditer(r"(?<![\w.])\d+(?:\.\d*)?(?:e-?\d+)?(?![\w.\]])", hidden):
        number = m.group()
        value = (
            repr(float(number) * 1.5 or 1.0) if re.search(r"[.e]", number) else str(int(number) + 1)
        )
        found.append((m.start(), m.end(), value))
    for m in re.finditer(r"(?<=[=(,?:] )-(?=\w)|(?<=\()-(?=\w)|(?<=return )-(?=\w)", hidden):
        found.append((m.start(), m.end(), ""))
    return found


def tests_of(path: str, root: Path) -> list[str]:
    """Test files of a module, as far as they exist."""
    name = path.removeprefix("forms/")
    files = TESTS[max((key for key in TESTS if name.startswith(key)), key=len)]
    return [f"tests/{file}.py" for file in files if (root / f"tests/{file}.py").exists()]


def run(copy: Path, cache: Path, files: list[str], limit: float) -> tuple[str, str]:
    """Outcome of the tests, "passed", "failed" or another, and the first test that failed."""
    environment = {**os.environ, "PYTHONPATH": str(copy), "XDG_CACHE_HOME": str(cache)}
    environment |= {"PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, "-m", "pytest", "-n0", "-x", "-q", "-p", "no:cacheprovider", *files]
    process = subprocess.Popen(
        command,
        cwd=copy,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )
    try:
        out, _ = process.communicate(timeout=limit)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        return TOO_SLOW, ""
    last = re.findall(r"^(?:FAILED|ERROR) (.*)$", out, re.MULTILINE)
    if re.search(COMPILER, out, re.MULTILINE):
        return REFUSED, ""
    return ("passed" if process.returncode == 0 else "failed"), (last[0][:160] if last else "")


def outcomes(log: Path) -> dict[Mutant, str]:
    """What a run has written."""
    rows = map(json.loads, log.read_text().splitlines())
    return {Mutant(*row["mutant"]): row["outcome"] for row in rows}


def difference(mutant: Mutant, source: bytes) -> list[str]:
    """Changed lines, with the number of the first."""
    old, new = (x.decode().splitlines() for x in (source, mutant.applied(source)))
    lines = list(difflib.unified_diff(old, new, n=0, lineterm=""))[3:]
    line = source[: mutant.start].count(b"\n") + 1
    return [f"{mutant.path}:{line}", *lines]


def main(arguments: list[str] | None = None) -> None:
    """Run a sample and print the outcome."""
    parser = argparse.ArgumentParser(description=__doc__, prog="python3 -m tests.mutate")
    parser.add_argument("--count", type=int, default=300, help="mutants in the sample")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--minutes", type=float, default=60.0, help="stop after this time")
    parser.add_argument("--limit", type=float, default=300.0, help="seconds for one mutant")
    parser.add_argument("--only", default="", help="part of the path, as native/kernels")
    parser.add_argument("--folder", type=Path, default=Path("results/mutants"), help="scratch")
    parser.add_argument(
        "--survivors",
        type=Path,
        nargs="+",
        default=[],
        metavar="LOG",
        help="earlier runs of the same sources: count what they caught, run the others",
    )
    given = parser.parse_args(arguments)
    end = time.monotonic() + 60 * given.minutes
    copy, cache, log = (given.folder.resolve() / name for name in ("copy", "cache", "log.jsonl"))
    if not copy.exists():
        unwanted = shutil.ignore_patterns(".git", "__pycache__", "results", ".*_cache", "*.pyc")
        # With links as links: a second copy of forms in variform would stay without mutants.
        shutil.copytree(ROOT, copy, symlinks=True, ignore=unwanted)
    sources = {
        str(file.relative_to(copy)): file.read_bytes()
        for folder in ("formulas", "operators", "native/kernels")
        for file in sorted((copy / "forms" / folder).rglob("*"))
        if file.suffix in (".py", ".c", ".h") and file.name not in ("__init__.py", "library.c")
    }
    every = [m for path, source in sources.items() for m in mutants(path, source)]
    sample = random.Random(given.seed).sample(every, min(given.count, len(every)))
    sample = [m for m in sample if given.only in m.path]
    done = {}
    for earlier in given.survivors:
        done |= {m: outcome for m, outcome in outcomes(earlier).items() if outcome != "passed"}
    if log.exists():
        done |= outcomes(log)
    todo = sum(mutant not in done for mutant in sample)
    print(f"{len(every)} mutants, {len(sample)} in the sample, {todo} to run", flush=True)
    checked: set[str] = set()
    for mutant in sample:
        if mutant in done:
            continue
        if time.monotonic() > end:
            break
        file, source = copy / mutant.path, sources[mutant.path]
        files = tests_of(mutant.path, copy)
        if str(files) not in checked:
            outcome, why = run(copy, cache, files, 3 * given.limit)
            if outcome != "passed":
                sys.exit(f"{files} {outcome} without any mutant: {why}")
            checked.add(str(files))
        try:
            file.write_bytes(mutant.applied(source))
            outcome, why = run(copy, cache, files, given.limit)
        finally:
            file.write_bytes(source)
        done[mutant] = outcome
        row = {"mutant": mutant, "outcome": outcome, "why": why}
        with log.open("a") as lines:
            lines.write(json.dumps(row) + "\n")
        print(outcome, difference(mutant, source)[0], flush=True)
    for mutant in sample:
        if done.get(mutant) == "passed":
            print("survived:", *difference(mutant, sources[mutant.path]), sep="\n  ")
    report(sample, done)


def report(sample: list[Mutant], done: dict[Mutant, str]) -> None:
    """Caught and survived, per folder."""
    for folder in ("forms/formulas", "forms/operators", "forms/native/kernels"):
        at = [done[m] for m in sample if m in done and str(Path(m.path).parent) == folder]
        caught = sum(outcome in ("failed", TOO_SLOW) for outcome in at)
        print(
            f"{folder}: {caught} caught, {at.count('passed')} survived, {at.count(REFUSED)} "
            f"{REFUSED}"
        )


if __name__ == "__main__":
    main()
