# SPDX-License-Identifier: MIT
"""Laws of docker/: one package list, the right BLAS, quiet MPI, refusals that say what to do."""

import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import LIMIT
from entering import DOCKER, ENTER, REPOSITORY, commands, enter, environment, refusal

SCRIPTS = ["docker/enter", "docker/image", "docker/entry", ".ci/run"]
PACKAGES = re.findall(r"^[^#\s]+", (DOCKER / "packages.txt").read_text(), re.MULTILINE)


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
