# SPDX-License-Identifier: MIT
"""Build the notebooks: each NN_idea.py is executed and written as NN_idea.ipynb beside it.

docker/enter python3 -m demos.notebooks            # all
docker/enter python3 -m demos.notebooks 03 07      # those whose names begin so
docker/enter python3 -m demos.notebooks --check    # execute, write nothing

After the notebook's own cells its solutions are executed in the same kernel, and then left out.
A notebook is written only if no cell raised, nothing went to stderr, and it is small enough.
"""

import argparse
import os
import re
import sys
import tempfile
import time
from pathlib import Path

import jupytext
import nbformat
import zmq
from jupyter_client import AsyncKernelClient
from jupyter_client.channels import AsyncZMQSocketChannel
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError, CellTimeoutError, DeadKernelError
from traitlets import Type

HERE = Path(__file__).resolve().parent
LIMIT = 600_000  # bytes of an executed notebook
WIDGET = "application/vnd.jupyter.widget-view+json"


def read(source):
    """Notebook without outputs of a percent script; the license line before the cells is left out.

    Metadata and cell ids are the same from run to run.
    """
    text = source.read_text()
    notebook = jupytext.reads(text[text.index("# %%") :], fmt="py:percent")
    cells = [{**cell, "id": f"cell-{n}"} for n, cell in enumerate(notebook.cells, 1)]
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    metadata = {"kernelspec": kernel, "language_info": {"name": "python"}}
    return nbformat.from_dict(
        {"nbformat": 4, "nbformat_minor": 5, "metadata": metadata, "cells": cells}
    )


def solutions(notebook):
    """The python blocks inside <details>, as code cells."""
    text = "\n".join(cell.source for cell in notebook.cells if cell.cell_type == "markdown")
    hidden = "\n".join(re.findall(r"<details>.*?</details>", text, re.DOTALL))
    return [
        nbformat.v4.new_code_cell(block)
        for block in re.findall(r"^```python\n(.*?)^```$", hidden, re.DOTALL | re.MULTILINE)
    ]


class ShellChannel(AsyncZMQSocketChannel):
    """The channel on which cells go to the kernel and replies come back."""

    def send(self, message):
        """Send, then look whether a reply came meanwhile.

        The output of a slider is sent back to the kernel while the cell's reply is awaited. Such a
        send goes past asyncio and may take from ZeroMQ the only signal that the reply has come:
        nobody would look before the cell's time is up.
        """
        super().send(message)
        self.socket.get(zmq.EVENTS)  # asking is what makes asyncio look


class KernelClient(AsyncKernelClient):
    """A client whose shell loses no reply."""

    shell_channel_class = Type(ShellChannel)


class Runner(NotebookClient):
    """nbclient's, with such a client."""

    def create_kernel_manager(self):
        """As NotebookClient says."""
        manager = super().create_kernel_manager()
        manager.client_factory = KernelClient
        return manager


def execute(notebook, seconds=900):
    """Run all cells in place, in an empty folder; raises where one of them does, or is too slow."""
    with tempfile.TemporaryDirectory() as folder:
        client = Runner(
            notebook,
            timeout=seconds,
            startup_timeout=900,
            record_timing=False,
            resources={"metadata": {"path": folder}},
        )
        client.execute()


def settled(outputs):
    """Outputs that do not depend on the run: pieces of stdout joined, sliders left out.

    A slider's output names an object in the kernel that is gone.
    """
    kept = []
    for output in outputs:
        if WIDGET in output.get("data", {}):
            continue
        names = [one.get("name") for one in (*kept[-1:], output)]
        if names == ["stdout", "stdout"]:
            kept[-1].text += output.text
        else:
            kept.append(output)
    return kept


def build(source):
    """Executed notebook of a source as text, and what is wrong with it."""
    notebook = read(source)
    own, metadata = list(notebook.cells), dict(notebook.metadata)
    notebook.cells = own + solutions(notebook)
    try:
        execute(notebook)
    except (CellExecutionError, CellTimeoutError, DeadKernelError) as error:
        return "", re.sub(r"\x1b\[[0-9;]*m", "", str(error))
    streams = [
        output
        for cell in notebook.cells
        for output in cell.get("outputs", [])
        if output.get("name") == "stderr"
    ]
    if streams:
        return "", f"these words went to stderr: {streams[0].text}"
    notebook.cells, notebook.metadata = own, nbformat.from_dict(metadata)
    for cell in own:
        cell.metadata.clear()  # jupytext's and nbclient's
        if cell.cell_type == "code":
            cell.outputs = settled(cell.outputs)
    nbformat.validate(notebook)
    text = nbformat.writes(notebook) + "\n"
    size = len(text.encode())
    return text, f"{size} bytes, more than {LIMIT}" if size > LIMIT else ""


def main():
    """Build the chosen notebooks; exit code 1 if one of them failed."""
    parser = argparse.ArgumentParser(prog="python3 -m demos.notebooks", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("prefix", nargs="*", help="how the names begin, such as 03 (default: all)")
    parser.add_argument("--check", action="store_true", help="execute only, write nothing")
    arguments = parser.parse_args()
    prefixes = tuple(arguments.prefix) or ("",)
    sources = [f for f in sorted(HERE.glob("[0-9][0-9]_*.py")) if f.name.startswith(prefixes)]
    if not sources:
        parser.error(f"no notebook's name begins with {' or '.join(prefixes)}")
    paths = (str(HERE.parent.parent), os.environ.get("PYTHONPATH"))
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, paths))
    # A debugger's remark about frozen modules, which the kernel prints at its start.
    os.environ["PYDEVD_DISABLE_FILE_VALIDATION"] = "1"
    # A kernel that is told to end may write to a socket that is closed: PETSc would report a crash.
    given = (os.environ.get("PETSC_OPTIONS"), "-no_signal_handler")
    os.environ["PETSC_OPTIONS"] = " ".join(filter(None, given))
    failed = False
    for source in sources:
        start = time.perf_counter()
        text, fault = build(source)
        seconds = f"{time.perf_counter() - start:6.1f} s"
        if fault:
            failed = True
            print(f"{source.stem:40s} {seconds}  not written: {fault}", file=sys.stderr, flush=True)
            continue
        if not arguments.check:
            source.with_suffix(".ipynb").write_text(text)
        print(f"{source.stem:40s} {seconds} {len(text.encode()) / 1000:6.0f} kB", flush=True)
    sys.exit(failed)


if __name__ == "__main__":
    main()
