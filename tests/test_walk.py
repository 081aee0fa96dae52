# SPDX-License-Identifier: MIT
"""A reader's walk: in a fresh clone, in the folder named, all that the pages show is typed."""

import contextlib
import hashlib
import os
import re
import shutil
import signal
import subprocess
import time
import urllib.request
from pathlib import Path

import pytest
from conftest import LIMIT, ROOT
from entering import environment
from test_pages import FILES, STARTS

pytestmark = pytest.mark.slow
# Blocks of code, after a comment if there is one, and indented lines, in the order of the page.
BLOCK = re.compile(
    r"(?:<!--\s*(?P<comment>(?:(?!-->).)*?)\s*-->\s*\n)?"
    r"^```(?P<kind>\w*)\n(?P<code>.*?)^```$|(?<=\n\n)(?P<indented>(?: {4}[^\n]*\n)+)",
    re.DOTALL | re.MULTILINE,
)
# Not walked, and why.
ELSEWHERE = {
    r"pytest": "the test command",
    r"\.ci/run": "the test command, with all that it needs",
    r"git clone": "the clone is made already",
    r"docker/image": "needs Docker",
    r"benchmarks[./]peers": "other codes, 8 GB of them, outside docker/enter",
    r"demos\.notebooks --check": "minutes; tests/test_notebooks.py does it one by one",
    r"my_script": "stands for a reader's own",
    r"docker/enter\s*(#|$)": "an interactive shell",
    r">docker/versions\.lock": "records the versions of the machine that it runs on",
}
PAGES = [
    page
    for page in FILES
    if any(
        part["kind"] in ("sh", "bash", "console", "python")
        or re.match(STARTS, part["indented"] or "")
        for part in BLOCK.finditer(page.read_text())
    )
]


@pytest.fixture
def clone(tmp_path):
    """What a clone has, and nothing that runs or tools have left beside it."""
    ignored = [line.rstrip("/") for line in (ROOT / ".gitignore").read_text().split()]
    folder = tmp_path / "variform"
    shutil.copytree(ROOT, folder, symlinks=True, ignore=shutil.ignore_patterns(".git", *ignored))
    return folder


def contents(folder):
    """A digest of each file."""
    files = (Path(top) / name for top, _, names in os.walk(folder) for name in names)
    return {
        str(file.relative_to(folder)): hashlib.sha256(file.read_bytes()).hexdigest()
        for file in files
    }


@pytest.mark.parametrize("page", PAGES, ids=lambda file: str(file.relative_to(ROOT)))
def test_what_a_page_shows_can_be_typed(page, clone):
    """Every command and block of Python, one after the other; no file of the clone has changed."""
    text, before, fresh = page.read_text(), 0, contents(clone)
    for part in BLOCK.finditer(text):
        if part["kind"] == "python":
            told, before = text[before : part.start()], part.end()
            walk_python(part["code"], part["comment"] or "", told, clone)
        elif part["kind"] == "sh" or part["indented"]:
            for command in commands(part["code"] or part["indented"]):
                walk_command(command, clone)
    now = contents(clone)
    assert [name for name in fresh if now.get(name) != fresh[name]] == []


def commands(code):
    joined = re.sub(r"\\\n\s*", "", code)
    lines = [line.strip().removeprefix("$ ") for line in joined.splitlines()]
    lines = [re.sub(r"\s+#.*", "", line) if re.match(STARTS, line) else line for line in lines]
    return [line for line in lines if line and not line.startswith("#")]


def walk_python(code, comment, told, clone):
    """Save a block by the name that the page gives it, and start it if no command will."""
    if comment.startswith("not run"):
        return
    named = re.findall(r"`(my_\w+\.py)`", told)
    if not named and comment.startswith("runs after:"):
        code = f"{comment.removeprefix('runs after:').strip()}\n{code}"
    name = named[-1] if named else "block.py"
    (clone / name).write_text(code)
    finish(f"docker/enter python3 {name}", clone)


def walk_command(command, clone):
    if any(re.search(pattern, command) for pattern in ELSEWHERE):
        return
    if not re.match(rf"{STARTS}|cp ", command):
        return
    if "jupyter notebook" in command:
        serve(command, clone)
    else:
        finish(command, clone)


def started(command, clone):
    return subprocess.Popen(
        ["bash", "-c", command],
        cwd=clone,
        env=environment(),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )


def finish(command, clone):
    process = started(command, clone)
    try:
        out, _ = process.communicate(timeout=LIMIT)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        pytest.fail(f"{command} did not end within {LIMIT} s")
    assert process.returncode == 0, f"{command} ended with {process.returncode}\n{out}"


def serve(command, clone):
    """Start a server, ask for the page whose address it prints, and end it."""
    process = started(f"{command} --no-browser --port-retries=50", clone)
    try:
        said, address = "", None
        os.set_blocking(process.stdout.fileno(), False)
        begun = time.monotonic()
        while address is None and process.poll() is None and time.monotonic() - begun < 120:
            with contextlib.suppress(BlockingIOError):
                said += os.read(process.stdout.fileno(), 65536).decode()
            address = re.search(r"http://(?:localhost|127\.0\.0\.1):\d+/\S*token=\w+", said)
            time.sleep(0.2)
        assert address is not None, said
        with urllib.request.urlopen(address[0], timeout=60) as page:
            assert page.status == 200
            assert b"upyter" in page.read()
    finally:
        os.killpg(process.pid, signal.SIGTERM)
        process.communicate(timeout=60)


def test_the_walk_sees_blocks_and_commands():
    """Both kinds of blocks, lines that go on, comments behind commands."""
    text = "a\n\n    docker/enter x \\\n        y  # why\n\n```sh\n$ cp a b\n```\n"
    found = [part["code"] or part["indented"] for part in BLOCK.finditer(text)]
    assert [commands(code) for code in found] == [["docker/enter x y"], ["cp a b"]]
