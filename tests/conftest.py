# SPDX-License-Identifier: MIT
"""Fixtures: MPI runs started from pytest, folders, a seeded generator."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import recorder

ROOT = Path(__file__).resolve().parent.parent
LIMIT = 900  # s, against hangs only: a slow machine compiles everything first


def pytest_addoption(parser):
    parser.addoption("--write-table", action="store_true", help="rewrite forms/formulas/README.md")


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


@pytest.fixture
def run():
    """Run a command of the repository; returns the finished process, fails with its output."""

    def start(*command, ranks=1, cwd=ROOT, check=True):
        words = [sys.executable, *map(str, command)]
        if ranks > 1:
            words = ["mpirun", "-n", str(ranks), *words]
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
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
        if check and process.returncode != 0:
            pytest.fail(f"{' '.join(words)} ended with {process.returncode}\n{out}{err}")
        return subprocess.CompletedProcess(words, process.returncode, out, err)

    return start


@pytest.fixture
def parallel(run, tmp_path):
    """Run a script on several ranks and read the JSON that its rank 0 prints last."""

    def start(script, ranks, *arguments):
        file = tmp_path / "script.py"
        file.write_text(script)
        done = run(file, *arguments, ranks=ranks, cwd=tmp_path)
        return json.loads(done.stdout.strip().splitlines()[-1])

    return start
