# SPDX-License-Identifier: MIT
"""Fixtures: MPI runs started from pytest, folders, a seeded generator, gmsh, point kernels."""

import json
import os
import signal
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

import pytest

if find_spec("dolfinx") is None:
    pytest.exit("the tests need DOLFINx: type docker/enter python3 -m pytest.", returncode=4)

import numpy as np
import recorder

ROOT = Path(__file__).resolve().parent.parent
# Files that take longest.
LONGEST = ["operators", "variation", "demos", "benchmarks", "parallel", "multigrid", "sheets"]
LONGEST += ["checkpoint_ranks", "insertion", "solve", "paths", "pages", "projection", "membranes"]
LONGEST += ["native"]
LIMIT = 900  # s, against hangs only: a slow machine compiles everything first


def pytest_addoption(parser):
    parser.addoption("--write-table", action="store_true", help="rewrite forms/formulas/README.md")


def pytest_xdist_auto_num_workers(config):
    """How many test files run at a time: two to four for the suite, one where few are asked for.

    A worker takes seconds to begin, and what it records for ``--write-table`` stays its own.
    """
    few = len(config.args) == 1 and not Path(config.args[0]).is_dir()
    option = config.option
    if few or option.keyword or option.collectonly or option.write_table:
        return 0
    cores = len(os.sched_getaffinity(0))
    return 0 if cores == 1 else min(cores, 4)


def pytest_configure(config):
    if config.option.write_table and config.getoption("numprocesses", 0):
        raise pytest.UsageError("--write-table records in one process: give no -n, or -n 0.")


def pytest_xdist_make_scheduler(config, log):
    """A file's tests, which share what they compile, stay together; slow ones go one by one.

    Those that take longest go first, so that no worker is left with one of them at the end.
    """
    from xdist.scheduler import LoadFileScheduling

    class LongestFirst(LoadFileScheduling):
        def _split_scope(self, nodeid):
            return nodeid if config.option.markexpr == "slow" else nodeid.partition("::")[0]

        def _assign_work_unit(self, node):
            def place(scope):
                name = Path(scope.partition("::")[0]).stem.removeprefix("test_")
                return LONGEST.index(name) if name in LONGEST else len(LONGEST)

            self.workqueue.move_to_end(min(self.workqueue, key=place), last=False)
            super()._assign_work_unit(node)

    return LongestFirst(config, log) if config.option.dist == "loadfile" else None


def pytest_runtest_logreport(report):
    if report.when == "call" and report.passed:
        recorder.finished.add(recorder.named(report.nodeid))


def pytest_terminal_summary(terminalreporter, exitstatus, config):
    if config.getoption("--write-table"):
        why = recorder.write() if exitstatus == 0 else "No table is written: tests failed."
        terminalreporter.write_line(why)


@pytest.fixture
def rng():
    return np.random.default_rng(20260101)


@pytest.fixture
def root():
    return ROOT


@pytest.fixture(scope="session")
def run():
    """Run a command of the repository; returns the finished process, fails with its output."""

    def start(*command, ranks=1, cwd=ROOT, check=True):
        words = [sys.executable, *map(str, command)]
        if ranks > 1:
            words = ["mpirun", "-n", str(ranks), *words]
        # tests/ for scenes.py, which scripts import.
        environment = {**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{ROOT / 'tests'}"}
        # What a killed mpirun leaves in the folder for all would stop a later one of its number.
        sessions = tempfile.TemporaryDirectory(prefix="mpi", ignore_cleanup_errors=True)
        if ranks > 1:
            environment["TMPDIR"] = sessions.name
        process = subprocess.Popen(
            words,
            cwd=cwd,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        try:
            out, err = process.communicate(timeout=LIMIT)
        except subprocess.TimeoutExpired:
            # The whole group: ranks outlive a killed mpirun.
            os.killpg(process.pid, signal.SIGKILL)
            out, err = process.communicate()
            pytest.fail(f"{' '.join(words)} did not end within {LIMIT} s\n{out}{err}")
        finally:
            sessions.cleanup()
        if check and process.returncode != 0:
            pytest.fail(f"{' '.join(words)} ended with {process.returncode}\n{out}{err}")
        return subprocess.CompletedProcess(words, process.returncode, out, err)

    return start


def printed(process):
    """The JSON that a finished process, or its rank 0, printed last."""
    return json.loads(process.stdout.strip().splitlines()[-1])


def scripts(run, folder):
    """Run scripts on several ranks in a folder and read the JSON that rank 0 prints last."""

    def start(script, ranks, *arguments):
        file = folder / "script.py"
        file.write_text(script)
        return printed(run(file, *arguments, ranks=ranks, cwd=folder))

    return start


@pytest.fixture(scope="module")
def kernels():
    from kernels import Kernels

    return Kernels()


@pytest.fixture
def session():
    """A gmsh session of the test's own, in which the files to be read are made."""
    import gmsh

    gmsh.initialize(readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    yield
    gmsh.finalize()


@pytest.fixture
def parallel(run, tmp_path):
    """Run a script on several ranks and read the JSON that its rank 0 prints last."""
    return scripts(run, tmp_path)


@pytest.fixture(scope="module")
def parallel_once(run, tmp_path_factory):
    """As parallel, for numbers that the tests of a module share."""
    return scripts(run, tmp_path_factory.mktemp("parallel"))
