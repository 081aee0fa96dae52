# SPDX-License-Identifier: MIT
"""docker/enter with stand-ins for what it calls, so that it builds a tiny root."""

import os
import subprocess
from pathlib import Path

from conftest import LIMIT

REPOSITORY = Path(__file__).resolve().parent.parent
DOCKER = REPOSITORY / "docker"
ENTER = DOCKER / "enter"
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


def refusal(*command: str, **variables: object) -> str:
    answer = enter(*command, **variables)
    assert answer.returncode == 125
    assert answer.stdout == ""
    return answer.stderr.strip()
