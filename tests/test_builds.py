# SPDX-License-Identifier: MIT
"""docker/enter makes a root once, whoever kills or doubles it, and hands a command on as it is.

A stand-in for mmdebstrap makes a tiny root out of the running system.
"""

import os
import re
import shutil
import signal
import subprocess
import time
from pathlib import Path

import pytest
from conftest import LIMIT
from entering import (
    DOCKER,
    ENTER,
    MAKE_TINY_ROOT,
    REPOSITORY,
    commands,
    enter,
    environment,
    refusal,
)


@pytest.fixture
def builder(tmp_path):
    """Variables with which docker/enter builds a tiny root, in a cache folder of its own."""
    if os.getuid() != 0:
        pytest.skip("a user's build needs mmdebstrap and subordinate numbers")
    if subprocess.run(["unshare", "--mount", "true"], capture_output=True).returncode:
        pytest.skip("root may not mount here")
    return {
        "ENTER": "root",
        "ENTER_CACHE": tmp_path / "cache",
        "PATH": commands(tmp_path / "bin", mmdebstrap=MAKE_TINY_ROOT),
        "RUNS": tmp_path / "runs",
    }


@pytest.mark.parametrize(
    ("log", "sentence"),
    [
        (
            "W: Failed to fetch x  Temporary failure resolving 'mirror'",
            "the Debian archive is out of reach: check the network, "
            "or set ENTER_MIRROR to a mirror's URL",
        ),
        (
            "dpkg: error: failed to write: No space left on device",
            "the disk is full: free 4 GB, or set ENTER_CACHE to a folder on another disk",
        ),
        (
            "W: GPG error: trixie InRelease: NO_PUBKEY 6ED0E7B82643E131",
            "Debian 13's signing key is not known here: "
            "as root, apt-get install debian-archive-keyring",
        ),
        (
            "E: Unable to locate package python3-dolfin",
            f"Unable to locate package python3-dolfin: correct {DOCKER}/packages.txt",
        ),
    ],
)
def test_a_failed_build_says_why_and_leaves_nothing(builder, tmp_path, log, sentence):
    """The cause is read from mmdebstrap's log; a later call finds no half-made root."""
    builder["PATH"] = commands(tmp_path / "bin", mmdebstrap=f"cat >&2 <<'END'\n{log}\nEND\nexit 1")
    message = refusal("true", **builder)
    assert message.splitlines()[-1] == f"enter: {sentence}"
    assert list(builder["ENTER_CACHE"].glob("root-*")) == []


def test_a_command_keeps_its_arguments_folder_stdin_and_exit_code(builder, tmp_path):
    """A command sees what it would see without docker/enter, in paths with spaces as well."""
    clone = tmp_path / "a clone"
    shutil.copytree(DOCKER, clone / "docker")
    command = ["sh", "-c", 'pwd; printf "[%s]" "$@"; cat; exit 7', "sh", "a", "", "b  c"]
    answer = subprocess.run(
        [clone / "docker/enter", *command],
        env=environment(**builder),
        cwd=clone,
        input="in",
        capture_output=True,
        text=True,
    )
    assert answer.stdout == f"{clone}\n[a][][b  c]in"
    assert answer.returncode == 7


def test_a_first_build_says_that_other_versions_ask_for_nothing(builder):
    """Debian's packages are never all of the versions that were recorded."""
    assert (
        "enter: ready; 1 packages are not of the versions in docker/versions.lock, as Debian mends "
        "some now and then: nothing to do"
    ) in enter("true", **builder).stderr.splitlines()


def test_the_second_call_builds_nothing_and_says_nothing(builder):
    """A root is made once; afterwards docker/enter adds no word to the command's."""
    assert "making a private Debian 13" in enter("true", **builder).stderr
    again = enter("printf", "here", **builder)
    assert (again.stdout, again.stderr) == ("here", "")
    assert builder["RUNS"].read_text() == "run\n"


def test_the_hosts_python_stays_outside(builder):
    """Variables of the host's virtual environments and libraries do not reach the root."""
    foreign = {"VIRTUAL_ENV": "/v", "CONDA_PREFIX": "/c", "PYTHONHOME": "/h"}
    inside = enter("env", **builder, **foreign).stdout.splitlines()
    names = {line.split("=")[0] for line in inside}
    assert names & set(foreign) == set()
    assert f"PYTHONPATH={REPOSITORY}" in inside
    assert "PYTHONNOUSERSITE=1" in inside


def test_another_list_makes_another_root_beside_the_first(builder, tmp_path):
    """Clones with different lists share the cache folder; a comment makes no difference."""
    clone = tmp_path / "clone"
    shutil.copytree(DOCKER, clone / "docker")
    packages = clone / "docker/packages.txt"
    for text in ("tiny\n", "# why\ntiny  # because\n", "tiny\nsmall\n"):
        packages.write_text(text)
        assert enter("true", script=clone / "docker/enter", **builder).returncode == 0
    assert len(list(builder["ENTER_CACHE"].glob("root-*"))) == 2


def test_a_root_with_a_browser_stands_beside_the_other(builder, tmp_path):
    """ENTER_SITE adds the packages of a second list, and makes no change to the first root."""
    script = MAKE_TINY_ROOT + 'echo "$*" >>"$RUNS"\n'
    builder["PATH"] = commands(tmp_path / "bin", mmdebstrap=script)
    assert enter("true", **builder).returncode == 0
    assert "chromium" not in builder["RUNS"].read_text()
    assert enter("true", **builder, ENTER_SITE=1).returncode == 0
    more = re.findall(r"^[^#\s]+", (DOCKER / "packages-site.txt").read_text(), re.MULTILINE)
    assert {"chromium", "python3-selenium"} <= set(more)
    assert all(name in builder["RUNS"].read_text() for name in more)
    assert len(list(builder["ENTER_CACHE"].glob("root-*"))) == 2


def test_another_suite_makes_a_root_of_its_own(builder, tmp_path):
    """ENTER_SUITE reaches mmdebstrap, its root stands beside the other, lacks are named."""
    script = MAKE_TINY_ROOT + 'echo "suite: $*" >>"$RUNS"\necho "left out: newest"\n'
    builder["PATH"] = commands(tmp_path / "bin", mmdebstrap=script)
    assert enter("true", **builder).returncode == 0
    answer = enter("true", **builder, ENTER_SUITE="sid")
    assert answer.returncode == 0
    assert "making a private Debian sid in" in answer.stderr
    assert answer.stderr.endswith(
        "enter: Debian sid cannot install now, and goes without: newest\n"
    )
    first, second = re.findall(r"suite: .*", builder["RUNS"].read_text().replace("\n ", " "))
    assert " trixie /" in first and " sid /" in second
    assert len(list(builder["ENTER_CACHE"].glob("root-*"))) == 2
    assert enter("printf", "here", **builder, ENTER_SUITE="sid").stderr == ""


def test_two_at_once_build_once(builder):
    """The second waits for the first, says so, and then both run their command."""
    start = [ENTER, "printf", "here"]
    options = {"env": environment(**builder, PAUSE=2), "text": True}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    both = [subprocess.Popen(start, **options, **pipes) for _ in range(2)]
    answers = [process.communicate(timeout=LIMIT) for process in both]
    assert [out for out, _ in answers] == ["here", "here"]
    assert sum("waiting for another docker/enter" in error for _, error in answers) == 1
    assert builder["RUNS"].read_text() == "run\n"


def wait_for(path: Path) -> None:
    for _ in range(20 * LIMIT):
        if path.exists():
            return
        time.sleep(0.05)
    raise AssertionError(f"{path} did not appear in {LIMIT} s")


def ended(group: int) -> bool:
    """Whether nothing of a process group is left; the dead may wait a moment to be counted."""
    for _ in range(20 * LIMIT):
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.05)
    return False


def test_a_killed_front_leaves_a_build_that_goes_on(builder):
    """After `kill -9` of docker/enter alone, the next call waits for the root and uses it."""
    process = subprocess.Popen(
        [ENTER, "true"], env=environment(**builder, PAUSE=3), stderr=subprocess.DEVNULL
    )
    wait_for(builder["RUNS"])
    process.kill()
    process.wait()
    assert enter("printf", "here", **builder).stdout == "here"
    assert builder["RUNS"].read_text() == "run\n"


def test_a_killed_build_is_cleared_and_made_anew(builder):
    """`kill -9` of docker/enter and its build leaves mmdebstrap running; the next call ends it."""
    process = subprocess.Popen(
        [ENTER, "true"], env=environment(**builder, PAUSE=3600), stderr=subprocess.DEVNULL
    )
    wait_for(builder["RUNS"])
    process.kill()
    process.wait()
    os.kill(int((builder["ENTER_CACHE"] / "builder").read_text().split()[1]), signal.SIGKILL)
    assert enter("printf", "here", **builder).stdout == "here"
    assert builder["RUNS"].read_text() == "run\nrun\n"
    assert list(builder["ENTER_CACHE"].glob("*.new")) == []


def test_an_interrupted_build_leaves_nothing(builder):
    """SIGTERM ends the build as a whole, and the exit code is the signal's."""
    process = subprocess.Popen(
        [ENTER, "true"], env=environment(**builder, PAUSE=3600), stderr=subprocess.PIPE, text=True
    )
    wait_for(builder["RUNS"])
    group = int((builder["ENTER_CACHE"] / "builder").read_text().split()[1])
    process.terminate()
    _, error = process.communicate(timeout=LIMIT)
    assert error.splitlines()[-1] == "enter: stopped; nothing is left behind"
    assert process.returncode == 128 + signal.SIGTERM
    assert list(builder["ENTER_CACHE"].glob("root-*")) == []
    assert ended(group)


def test_a_signal_reaches_the_command(builder):
    """docker/enter becomes the command: SIGTERM ends it, and nothing stays between."""
    command = [ENTER, "sh", "-c", "echo started; exec sleep 3600"]
    with subprocess.Popen(command, env=environment(**builder), stdout=subprocess.PIPE) as process:
        assert process.stdout.readline() == b"started\n"
        process.terminate()
        # The output ends only when nobody is left who could write to it.
        assert process.communicate(timeout=LIMIT) == (b"", None)
        assert process.returncode == -signal.SIGTERM


def test_remove_deletes_roots_and_nothing_else(tmp_path):
    """`--remove` names what it deletes, follows no link, and spares whatever is not a root."""
    spared = [tmp_path / "root-mine", tmp_path / "root-0123", tmp_path / "other"]
    for folder in [tmp_path / "root-0123456789ab", *spared]:
        folder.mkdir()
    (tmp_path / "root-aaaaaaaaaaaa").symlink_to(tmp_path / "other")
    answer = enter("--remove", ENTER_CACHE=tmp_path)
    assert answer.returncode == 0
    assert f"removing {tmp_path}/root-0123456789ab" in answer.stderr
    assert not (tmp_path / "root-0123456789ab").exists()
    assert all(folder.exists() for folder in [*spared, tmp_path / "root-aaaaaaaaaaaa"])
    assert "nothing to remove" in enter("--remove", ENTER_CACHE=tmp_path).stderr
