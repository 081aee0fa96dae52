# SPDX-License-Identifier: MIT
"""The package as a user meets it: README, wheel, versions, imports."""

import ast
import re
import subprocess
import sys
import tomllib

import pytest
from conftest import ROOT

from variform import forms, meshes

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


def test_the_code_of_the_readme_runs(run, tmp_path):
    """The lines of the first screen, as they stand, end with a picture and a finished path."""
    code = re.search(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)[1]
    assert len(code.strip().splitlines()) <= 15
    file = tmp_path / "readme.py"
    file.write_text(code + "\nassert path.completed and abs(path.load - 2 * pi) < 1e-12\n")
    run(file, cwd=tmp_path)
    assert (tmp_path / "twist.png").stat().st_size > 10_000


def test_versions_agree():
    """pyproject.toml, CITATION.cff and CHANGELOG.md name the same version."""
    version = PROJECT["project"]["version"]
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text()
    assert f"## {version} " in (ROOT / "CHANGELOG.md").read_text()


@pytest.mark.parametrize("package", [forms, meshes, forms.energies])
def test_public_names_exist_and_are_documented(package):
    """Every name in __all__ exists and has a docstring, once."""
    assert len(set(package.__all__)) == len(package.__all__)
    for name in package.__all__:
        assert getattr(package, name).__doc__, name


def test_the_wheel_works_outside_the_checkout(tmp_path):
    """Built, installed into a fresh environment, imported from there and not from here."""
    source = tmp_path / "source"
    source.mkdir()
    for name in ("pyproject.toml", "README.md", "LICENSE", "variform", "forms", "meshes"):
        subprocess.run(["cp", "-r", ROOT / name, source], check=True)
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "-q"]
    alone = ["--no-index", "--no-build-isolation"]  # dependencies are checked, not fetched
    subprocess.run([*pip, "wheel", *alone, "--no-deps", "-w", tmp_path, source], check=True)
    (wheel,) = tmp_path.glob("variform-*.whl")
    venv = tmp_path / "venv"
    make = [sys.executable, "-m", "venv", "--system-site-packages", "--without-pip", venv]
    subprocess.run(make, check=True)
    subprocess.run([*pip, "--python", venv / "bin/python", "install", *alone, wheel], check=True)
    script = (
        "import importlib.metadata as m, pathlib\n"
        "from variform import forms, meshes\n"
        "print(forms.__file__, m.version('variform'))\n"
        "assert (pathlib.Path(forms.__file__).parent / 'py.typed').exists()\n"
        "forms.energies.as_rigid_as_possible.evaluate([[[2, 0, 0], [0, 1, 0], [0, 0, 1]]], 1)\n"
    )
    done = subprocess.run(
        [venv / "bin/python", "-c", script],
        cwd=tmp_path,
        env={"PATH": "/usr/bin:/bin", "HOME": str(tmp_path)},
        capture_output=True,
        text=True,
        check=True,
    )
    where, version = done.stdout.split()
    assert where.startswith(str(venv)) and version == PROJECT["project"]["version"]


WITHOUT = """
import sys
sys.modules["gmsh"] = sys.modules["slepc4py"] = None  # as if they were not installed
from mpi4py import MPI
from dolfinx import io, mesh
import ufl
from variform import forms, meshes

square = mesh.create_unit_square(MPI.COMM_WORLD, 2, 2)
with io.XDMFFile(MPI.COMM_WORLD, "square.xdmf", "w") as file:
    file.write_mesh(square)
print(meshes.read(MPI.COMM_WORLD, "square.xdmf").mesh.topology.dim, "dimensions")
u = forms.displacement(square)
psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0)
for call in (lambda: meshes.block(MPI.COMM_WORLD, (1.0, 1.0), n=2),
             lambda: forms.lowest_modes(forms.Problem(psi * ufl.dx, u))):
    try:
        call()
    except ImportError as error:
        print(error)
"""


@pytest.mark.parametrize("ranks", [1, 2])
def test_extras_are_needed_where_they_are_used_only(run, tmp_path, ranks):
    """Without gmsh and SLEPc both packages import and read XDMF; what needs one says how to get."""
    (tmp_path / "script.py").write_text(WITHOUT)
    said = run(tmp_path / "script.py", cwd=tmp_path, ranks=ranks).stdout
    for words in ("dimensions", "is meshed or read by gmsh, which", "lowest_modes needs slepc4py,"):
        assert said.count(words) == ranks


def test_every_import_is_declared():
    """What the packages import is a dependency or in an extra of pyproject.toml."""
    project = PROJECT["project"]
    extras = [name for names in project["optional-dependencies"].values() for name in names]
    declared = {re.match(r"[\w-]+", name)[0] for name in project["dependencies"] + extras}
    declared = {name.removeprefix("fenics-").replace("pillow", "PIL") for name in declared}
    # Parts of DOLFINx's own dependencies, and of Python's library.
    declared |= {"basix", "ffcx", *sys.stdlib_module_names}
    found = {}
    for top in ("forms", "meshes"):
        for file in (ROOT / top).glob("**/*.py"):
            for node in ast.walk(ast.parse(file.read_text())):
                names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
                if isinstance(node, ast.ImportFrom) and not node.level:
                    names = [node.module]
                found |= {name.split(".")[0]: file for name in names}
    assert {"gmsh", "slepc4py", "tqdm"} <= declared
    assert {name: file for name, file in found.items() if name not in declared} == {}


def test_another_dolfinx_is_refused_in_one_sentence(tmp_path):
    """Outside 0.9 to 0.11 the import says what it needs and what it found."""
    code = "import dolfinx; dolfinx.__version__ = '0.8.0'; from variform import forms"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert "ImportError: variform needs DOLFINx 0.9 to 0.11, found 0.8.0" in done.stderr


@pytest.mark.parametrize("code", ["from variform import forms", "import demos.twist"])
def test_without_dolfinx_one_sentence_says_what_to_type(code):
    """Python without Debian's packages, as outside docker/enter."""
    process = subprocess.run(
        [sys.executable, "-S", "-c", code], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert process.stderr.strip().splitlines()[-1] == (
        "ImportError: variform needs mpi4py, petsc4py, dolfinx, which this Python has not: in the "
        "folder of variform type docker/enter before the command, as docker/enter python3 -m "
        "demos.twist, or install DOLFINx 0.9 to 0.11."
    )


def test_the_other_codes_start_without_dolfinx():
    """Any Python starts the peers, and those run in environments of their own."""
    for words in (["demos.benchmarks.peers", "--help"], ["demos.benchmarks.peers.codes"]):
        command = [sys.executable, "-S", "-m", *words]
        process = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
        assert (process.returncode, process.stderr) == (0, "")


def test_tests_without_dolfinx_end_in_one_sentence():
    """Pytest alone, without DOLFINx: not an error for each file."""
    code = (
        "import sys, importlib.util as util; found = util.find_spec;"
        "util.find_spec = lambda name, *a: None if name == 'dolfinx' else found(name, *a);"
        "import pytest; sys.exit(pytest.main(['-q', '-p', 'no:xdist', 'tests/test_intervals.py']))"
    )
    process = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert process.returncode == 4
    assert "the tests need DOLFINx: type docker/enter python3 -m pytest." in (
        process.stdout + process.stderr
    )
