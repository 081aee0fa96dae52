"""Laws of docker/: one package list, the right BLAS, quiet MPI, and refusals that say what to do.

Builds are tried with a stand-in for mmdebstrap that makes a tiny root out of the running system.
"""

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from conftest import LIMIT

REPOSITORY = Path(__file__).resolve().parent.parent
DOCKER = REPOSITORY / "docker"
ENTER = DOCKER / "enter"
SCRIPTS = ["docker/enter", "docker/image", "docker/entry", ".ci/run"]
PACKAGES = re.findall(r"^[^#\s]+", (DOCKER / "packages.txt").read_text(), re.MULTILINE)

# What the stand-in copies, with the libraries that these need, so that a command can run.
TOOLS = ["sh", "setpriv", "cat", "env", "printf", "sleep", "true"]

MAKE_TINY_ROOT = f"""#!/bin/bash
for argument; do
    case $argument in */root-*.new) root=$argument ;; esac
done
echo run >>"$RUNS"
mkdir -p "$root"/usr/{{bin,lib,lib64,sbin}} "$root"/{{etc,mnt}} "$root"/var/lib/dpkg
ln -s usr/bin usr/lib usr/lib64 usr/sbin "$root"
printf 'Package: tiny\\nVersion: 1\\n' >"$root/var/lib/dpkg/status"
touch "$root"/etc/{{passwd,group}}
for tool in {" ".join(TOOLS)}; do
    file=$(PATH=/usr/bin:/bin type -P "$tool")
    cp -L "$file" "$root/usr/bin"
    ldd "$file" | grep -o '/[^ ]*' | xargs -I@ cp -L --parents @ "$root"
done
sleep "${{PAUSE:-0}}"
"""


def environment(**variables: object) -> dict[str, str]:
    """This process's environment as it was before docker/enter, plus `variables`."""
    ours = ("ENTER", "OMP_", "OPENBLAS_", "OMPI_", "PRTE_", "PYTHONPATH")
    kept = {k: v for k, v in os.environ.items() if not k.startswith(ours)}
    return kept | {k: str(v) for k, v in variables.items()}


def enter(*command: str, script: Path = ENTER, **variables: object) -> subprocess.CompletedProcess:
    """Run docker/enter with nothing on stdin."""
    return subprocess.run(
        [script, *command],
        env=environment(**variables),
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=LIMIT,
    )


def commands(folder: Path, **scripts: str) -> str:
    """A PATH that finds stand-ins for commands, such as `df`, before the real ones.

    One for mmdebstrap is always there: no test may build or install in earnest.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in {"mmdebstrap": "exit 1", **scripts}.items():
        (folder / name).write_text(text if text.startswith("#!") else f"#!/bin/sh\n{text}\n")
        (folder / name).chmod(0o755)
    return f"{folder}:{os.environ['PATH']}"


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


@pytest.fixture(scope="session")
def native():
    """Skips where docker/enter cannot run a command right here."""
    answer = enter("true", ENTER="native")
    if answer.returncode:
        pytest.skip(answer.stderr)


# --- what is inside -------------------------------------------------------------------------------


@pytest.mark.skipif("ENTER_INSIDE" not in os.environ, reason="the BLAS is this system's choice")
def test_petsc_and_numpy_run_on_openblas():
    """The BLAS that PETSc and NumPy load is OpenBLAS; the reference BLAS is 3 times slower."""
    code = "import numpy; from petsc4py import PETSc; print(open('/proc/self/maps').read())"
    maps = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout
    libraries = {Path(line.split()[-1]) for line in maps.splitlines() if "/" in line}
    blas = {file.parent.name for file in libraries if file.name.startswith("libblas")}
    assert any(file.name.startswith("libpetsc") for file in libraries)
    assert blas == {"openblas-pthread"}


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({}, "1 1"),
        ({"OMP_NUM_THREADS": 3}, "3 3"),
        ({"OPENBLAS_NUM_THREADS": 2}, "1 2"),
    ],
)
def test_one_thread_per_rank_unless_told_otherwise(native, given, expected):
    """One thread by default; a user's OMP_NUM_THREADS holds for OpenBLAS as well."""
    show = 'echo "$OMP_NUM_THREADS $OPENBLAS_NUM_THREADS"'
    assert enter("sh", "-c", show, ENTER="native", **given).stdout.strip() == expected


def test_more_ranks_than_cores_print_nothing_of_their_own(native):
    """`mpirun` starts more ranks than cores, as root or not, and adds no word of its own."""
    ranks = os.cpu_count() + 1
    code = "from mpi4py import MPI; MPI.COMM_WORLD.Barrier(); print('here')"
    answer = enter("mpirun", "-n", str(ranks), "python3", "-c", code, ENTER="native")
    assert answer.returncode == 0
    # Ranks may write into each other's lines.
    assert answer.stdout.count("here") == ranks
    assert answer.stdout.replace("here", "").strip() == ""
    assert answer.stderr == ""


def test_a_script_outside_the_repository_imports_the_packages(native, tmp_path):
    """A bare `python3 script.py` in any folder finds forms and meshes."""
    script = tmp_path / "script.py"
    script.write_text(
        "from importlib.util import find_spec as find\n"
        "print(find('meshes').submodule_search_locations[0])"
    )
    answer = enter("python3", str(script), ENTER="native")
    assert answer.stdout.strip() == str(REPOSITORY / "meshes")


@pytest.mark.skipif("ENTER_INSIDE" not in os.environ, reason="holds for roots and images")
def test_the_image_sets_the_same_variables_as_enter():
    """Every variable of the Dockerfile's environment has the same value behind docker/enter."""
    text = (DOCKER / "Dockerfile").read_text().split("\nFROM environment")[0]
    block = re.search(r"^ENV ((?:.*\\\n)*.*)", text, re.MULTILINE)[1].replace("\\\n", " ")
    image = dict(word.split("=", 1) for word in block.split())
    assert "OMPI_MCA_btl" in image
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        assert image.pop(name) == "1"
    assert {name: os.environ.get(name) for name in image} == image


@pytest.mark.skipif(shutil.which("Xvfb") is None, reason="Xvfb is not installed")
def test_entry_gives_a_display_stdin_and_the_exit_code():
    """docker/entry adds a display, and changes nothing else about the command."""
    variables = environment()
    variables.pop("DISPLAY", None)
    command = [DOCKER / "entry", "sh", "-c", 'echo "$DISPLAY $1"; cat; exit 7', "sh", "a  b"]
    answer = subprocess.run(command, env=variables, input="in", capture_output=True, text=True)
    assert re.fullmatch(r":\d+ a  b\nin", answer.stdout)
    assert answer.returncode == 7


@pytest.mark.skipif(shutil.which("Xvfb") is None, reason="Xvfb is not installed")
def test_entry_hands_on_the_signal_that_ends_a_container():
    """SIGTERM, which `docker stop` sends, ends the command at once."""
    variables = environment()
    variables.pop("DISPLAY", None)
    command = [DOCKER / "entry", "sh", "-c", "echo started; exec sleep 3600"]
    with subprocess.Popen(command, env=variables, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "started\n"
        process.terminate()
        assert process.wait(timeout=LIMIT) == 128 + signal.SIGTERM


# --- the files ------------------------------------------------------------------------------------


@pytest.mark.skipif(shutil.which("shellcheck") is None, reason="shellcheck is not installed")
@pytest.mark.parametrize("script", SCRIPTS)
def test_shellcheck_finds_nothing(script):
    """The first code that a stranger runs is free of the known traps."""
    answer = subprocess.run(["shellcheck", REPOSITORY / script], capture_output=True, text=True)
    assert answer.returncode == 0, answer.stdout


def test_compose_runs_what_there_is():
    """Every service runs the image, and in it a module of this repository or a notebook server."""
    yaml = pytest.importorskip("yaml")
    services = yaml.safe_load((DOCKER / "compose.yml").read_text())["services"]
    tag = re.search(r"^tag=(\w+)$", (DOCKER / "image").read_text(), re.MULTILINE)[1]
    assert {"demo", "mpi", "gallery", "notebook"} == set(services)
    for name, service in services.items():
        assert service["image"] == tag and service["init"]
        modules = re.findall(r"python3 -m ([\w.]+)", service["command"])
        assert modules or service["command"].startswith("jupyter notebook"), name
        for module in modules:
            place = REPOSITORY / module.replace(".", "/")
            assert place.with_suffix(".py").exists() or (place / "__main__.py").exists(), module


@pytest.mark.parametrize("file", ["docker/enter", "docker/Dockerfile"])
def test_packages_are_listed_once(file):
    """The scripts read packages.txt, and name no Python package themselves."""
    text = (REPOSITORY / file).read_text()
    assert "packages.txt" in text
    assert re.findall(r"python3-\w+", text) == []


def test_the_recorded_versions_cover_the_list():
    """docker/versions.lock is sorted and has a version of every package that is asked for."""
    lines = (DOCKER / "versions.lock").read_text().splitlines()
    assert lines == sorted(lines)
    assert set(PACKAGES) - {line.split()[0] for line in lines} == set()


def test_no_host_is_named():
    """Mirrors and registries are the user's choice: no file in docker/ names one."""
    host = re.compile(r"\w+://|\b[\w-]+\.(?:org|com|net|io|dev|de|eu)\b")
    files = [file for file in DOCKER.iterdir() if file.is_file()]
    assert files
    assert {file.name: host.findall(file.read_text()) for file in files} == {
        file.name: [] for file in files
    }


def test_every_variable_is_explained():
    """What docker/enter reads, `docker/enter --help` and docker/README.md explain."""
    read = set(re.findall(r"\$\{(ENTER\w*)", ENTER.read_text())) - {"ENTER_INSIDE"}
    assert {"ENTER", "ENTER_CACHE", "ENTER_MIRROR"} <= read
    usage = enter("--help").stdout
    readme = (DOCKER / "README.md").read_text()
    assert [name for name in read if not re.search(rf"\b{name}\b", usage)] == []
    assert [name for name in read if not re.search(rf"\b{name}\b", readme)] == []


# --- refusals -------------------------------------------------------------------------------------


def refusal(*command: str, **variables: object) -> str:
    answer = enter(*command, **variables)
    assert answer.returncode == 125
    assert answer.stdout == ""
    return answer.stderr.strip()


def test_refuses_an_unknown_way():
    assert refusal("true", ENTER="podman") == (
        "enter: ENTER=podman is no way in: use native, apt, root or docker, or unset ENTER"
    )


def test_refuses_another_suite_anywhere_but_in_a_private_debian():
    assert refusal("true", ENTER="native", ENTER_SUITE="sid") == (
        "enter: ENTER_SUITE=sid is a private Debian only: unset ENTER"
    )


def test_refuses_an_unknown_option():
    assert refusal("--frobnicate") == "enter: no option --frobnicate: see docker/enter --help"


def test_refuses_a_system_that_lacks_modules(tmp_path):
    path = commands(tmp_path / "bin", python3="echo 'dolfinx 0.9 (found 0.8.0) gmsh'")
    assert re.fullmatch(
        r"enter: ENTER=native, but missing here: .*dolfinx 0.9 \(found 0.8.0\) gmsh: "
        r"install it or unset ENTER",
        refusal("true", ENTER="native", PATH=path),
    )


def test_refuses_a_cpu_without_packages(tmp_path):
    path = commands(tmp_path / "bin", uname="echo sparc64")
    message = refusal("true", ENTER="root", ENTER_CACHE=tmp_path / "cache", PATH=path)
    assert message == (
        "enter: no DOLFINx packages for the CPU sparc64: use a machine with amd64 or arm64"
    )


def test_refuses_a_snapshot_without_an_archive(tmp_path):
    given = {"ENTER_CACHE": tmp_path / "cache", "ENTER_SNAPSHOT": "20260901T000000Z"}
    message = refusal("true", ENTER="root", PATH=commands(tmp_path / "bin"), **given)
    assert message == (
        "enter: ENTER_SNAPSHOT=20260901T000000Z names no archive: "
        "set ENTER_SNAPSHOT_ARCHIVE to its URL"
    )


def test_refuses_a_cache_that_cannot_be_written(tmp_path):
    path = commands(tmp_path / "bin")
    assert refusal("true", ENTER="root", ENTER_CACHE="/proc/cache", PATH=path) == (
        "enter: cannot write in /proc/cache: set ENTER_CACHE to a folder of yours"
    )


def test_refuses_a_full_disk(tmp_path):
    path = commands(tmp_path / "bin", df="echo disk 9000000 8000000 1000000 90% /")
    cache = tmp_path / "cache"
    assert refusal("true", ENTER="root", ENTER_CACHE=cache, PATH=path) == (
        f"enter: only 1 GB free in {cache}, 4 are needed: "
        "free some, or set ENTER_CACHE to a folder on another disk"
    )


def test_refuses_where_nothing_can_be_made(tmp_path):
    """Neither namespaces nor what is needed on this system nor Docker: all in one sentence."""
    path = commands(tmp_path / "bin", unshare="exit 1", docker="exit 1", python3="echo gmsh")
    message = refusal("true", ENTER_CACHE=tmp_path / "cache", PATH=path)
    assert re.fullmatch(
        r"enter: (root may not mount|this user may not make namespaces).*, or install Docker",
        message,
    )


def test_refuses_docker_without_an_engine(tmp_path):
    path = commands(tmp_path / "bin", docker="exit 1")
    assert refusal("true", ENTER="docker", PATH=path) == (
        "enter: ENTER=docker, but no Docker engine answers `docker info`: start it"
    )


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


# --- builds ---------------------------------------------------------------------------------------


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
