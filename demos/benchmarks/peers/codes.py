# SPDX-License-Identifier: MIT
"""The codes, where each is installed and how it is started there. Standard library alone."""

import importlib.util
import json
import os
import platform
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "variform" / "peers"
# Already inside if DOLFINx is found here.
INSIDE = importlib.util.find_spec("dolfinx") is not None
ENTER = [] if INSIDE else [str(ROOT / "docker" / "enter")]
PYTHON = sys.executable if INSIDE else "python3"
LIBRARIES = f"/usr/lib/{platform.machine()}-linux-gnu"
ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS"), "1"
)


@dataclass(frozen=True)
class Code:
    """A code with one of its solvers.

    Attributes:
        name: Name in tables.
        module: Module of this package that runs it.
        solver: Its ``--solver``.
        place: Folder in the cache, or one of DOLFINx's two BLAS.
        energy: Energy of variform, if not the block's.
    """

    name: str
    module: str
    solver: str = ""
    place: str = "OpenBLAS"
    energy: str = ""

    @property
    def key(self):
        """Name of a folder."""
        return "_".join(self.name.replace(",", "").replace("+", "").split())

    @property
    def there(self):
        """Whether its environment is installed."""
        if self.place == "OpenBLAS":
            return True
        if self.place == "reference BLAS":
            return platform.system() == "Linux"
        return (CACHE / self.place / "ready").exists()

    def python(self):
        """Command line of the Python that has it."""
        folder = CACHE / self.place
        if self.place == "OpenBLAS":
            return [*ENTER, PYTHON]
        if self.place == "reference BLAS":
            path = f"LD_LIBRARY_PATH={LIBRARIES}/blas:{LIBRARIES}/lapack"
            return [*ENTER, "env", path, PYTHON]
        if self.place == "getfem":
            packages = folder / "usr" / "lib"
            path = f"LD_LIBRARY_PATH={packages / LIBRARIES.rpartition('/')[2]}"
            modules = f"PYTHONPATH={ROOT}:{packages / 'python3' / 'dist-packages'}"
            return [*ENTER, "env", path, modules, PYTHON]
        python = str(folder / "bin" / "python")
        return [*ENTER, python] if self.place == "jax-fem" else [python]

    def run(self, *arguments, limit=600):
        """JSON rows that it prints, or one row with the error."""
        command = [*self.python(), "-m", f"demos.benchmarks.peers.{self.module}"]
        command += [str(argument) for argument in arguments]
        if self.solver:
            command += ["--solver", self.solver]
        if self.energy:
            command += ["--energy", self.energy]
        start = time.perf_counter()
        environment = {**os.environ, **ONE_THREAD, "PYTHONPATH": str(ROOT)}
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, timeout=limit, env=environment, check=False
            )
        except subprocess.TimeoutExpired:
            return [{"error": f"stopped after {limit} s"}]
        rows = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
        if done.returncode or not rows:
            said = (done.stderr or done.stdout).strip().splitlines() or ["no word"]
            rows = [{"error": f"exit code {done.returncode}: {said[-1]}"}]
        seconds = round(time.perf_counter() - start, 1)
        return [row | {"whole process, wall [s]": seconds} for row in rows]


REFERENCE = Code("reference", "variform", "reference")
SECOND = Code("DOLFINx, to rounding", "vanilla", "tight")
VANILLA = Code("DOLFINx, MUMPS", "vanilla", "mumps")
VARIFORM = [
    Code("variform", "variform", "default"),
    Code("variform, test of the others", "variform", "same-residual"),
    Code("variform, in one step", "variform", "one-step"),
]
DOLFINX = [VANILLA, Code("DOLFINx, CG + GAMG", "vanilla", "gamg")]
SLOW_BLAS = Code("DOLFINx, MUMPS, reference BLAS", "vanilla", "mumps", "reference BLAS")
PEERS = [
    Code("FElupe, PARDISO", "felupe_block", "pardiso", "felupe"),
    Code("SfePy, PARDISO", "sfepy_block", "pardiso", "sfepy"),
    Code("GetFEM, MUMPS", "getfem_block", "", "getfem"),
    Code("JAX-FEM, MUMPS", "jaxfem_block", "mumps", "jax-fem"),
    Code("scikit-fem, PARDISO", "skfem_block", "pardiso", "scikit-fem"),
    Code("torch-fem, PARDISO", "torchfem_block", "direct", "torch-fem"),
]
# What a user gets who asks for no solver.
DEFAULTS = [
    Code("FElupe, SuperLU", "felupe_block", "superlu", "felupe"),
    Code("JAX-FEM, BiCGStab", "jaxfem_block", "bicgstab", "jax-fem"),
]
ASSEMBLY = [
    Code("variform", "variform"),
    Code("variform, fixed corotated", "variform", energy="fixed_corotated"),
    Code("DOLFINx", "vanilla"),
    *(Code(code.name.partition(",")[0], code.module, "", code.place) for code in PEERS),
]
POINTS = {
    "variform": Code("variform", "points"),
    "numpy": Code("NumPy", "points"),
    "ufl": Code("UFL", "points"),
    "jax": Code("JAX", "points", "", "jax-fem"),
    "torch": Code("torch", "points", "", "torch-fem"),
    "felupe": Code("FElupe", "points", "", "felupe"),
}
