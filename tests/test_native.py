# SPDX-License-Identifier: MIT
"""Compiled code at work: caches, compilers, ranks; what it costs; within the bounds of arrays."""

import ctypes
import json
import shlex
import shutil
import subprocess
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest
import test_coarse
import ufl
from cases import LMBDA, MU, unit_mesh
from dolfinx import fem

from variform import forms
from variform.forms import energies
from variform.forms.native import jit, library

NO_COMPILER = """
from mpi4py import MPI
import ufl
from variform import forms
from dolfinx import mesh
u = forms.displacement(mesh.create_unit_cube(MPI.COMM_WORLD, 2, 2, 2))
psi = forms.energies.hencky(forms.deformation_gradient(u), 1.0, 1.0)
try:
    forms.Problem(psi * ufl.dx, u)
except RuntimeError as error:
    print(MPI.COMM_WORLD.gather(str(error)))
"""
AT_ONCE = """
from mpi4py import MPI
import ufl
from variform import forms
from dolfinx import mesh
u = forms.displacement(mesh.create_unit_cube(MPI.COMM_WORLD, 2, 2, 2))
u.interpolate(lambda x: 0.1 * x)
psi = forms.energies.hencky(forms.deformation_gradient(u), 1.0, 1.0)
energy = forms.Problem(psi * ufl.dx, u).energy()
if MPI.COMM_WORLD.rank == 0:
    print(energy)
"""


@pytest.mark.slow
def test_programs_that_start_at_once_share_an_empty_cache(run, tmp_path, monkeypatch):
    """Three programs of two ranks each compile the same kernels into one folder at a time."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    with ThreadPoolExecutor(3) as pool:
        done = list(pool.map(lambda _: run("-c", AT_ONCE, ranks=2), range(3)))
    wanted = 3 * np.log(1.1) ** 2 + 9 / 2 * np.log(1.1) ** 2
    assert [float(d.stdout) for d in done] == pytest.approx([wanted] * 3, rel=1e-12)
    assert len(list((tmp_path / "fenics").glob("libvariform_*"))) == 1


@pytest.mark.parametrize("ranks", [1, 2])
def test_a_missing_compiler_is_named(ranks, run, tmp_path, monkeypatch):
    """One sentence with the compiler's name on every rank, and no hang."""
    monkeypatch.setenv("CC", "no-such-compiler")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    out = run("-c", NO_COMPILER, ranks=ranks).stdout
    assert out.count("compiling the operators' kernels failed") == ranks
    assert out.count("is a C compiler installed (no-such-compiler)") == ranks


def test_the_clamp_is_1e_6():
    """Unless told otherwise T = (psi_2 + psi_3) / 1e-6 where s = (1, x, -x)."""
    F = np.diag([1.0, 0.5, -0.5])[None]
    for energy in (
        energies.as_rigid_as_possible,
        energies.principal(lambda s1, s2, s3, mu: mu * s1 * s2 * s3 + s1 + s2 + s3),
    ):
        P, A = energy.evaluate(F, MU)
        T = A[0, 1, 2, 1, 2] - A[0, 1, 2, 2, 1]
        assert T == pytest.approx((P[0, 1, 1] + P[0, 2, 2]) / 1e-6, rel=1e-12)


def test_only_indefinite_cells_pay_for_eigenvalues():
    """Rigid modes and unknowns without stiffness are no reason: a factorization tells that."""
    lib, ffi = library.library(MPI.COMM_SELF)
    lapack = ctypes.CDLL(PETSc.__file__)
    factorize, eigen = (
        ffi.cast("void *", ctypes.cast(f, ctypes.c_void_p).value)
        for f in (lapack.dpotrf_, lapack.dsyev_)
    )
    kind = "void(*)(char *, char *, int *, double *, int *, double *, double *, int *, int *)"
    solved, count = ffi.cast(kind, eigen), 0

    def counted(*arguments):
        nonlocal count
        count += 1
        solved(*arguments)

    counting = ffi.callback(kind, counted)
    body = unit_mesh(2, 2)
    u = forms.displacement(body)
    F = forms.deformation_gradient(u)
    psi = energies.saint_venant_kirchhoff(F, MU, LMBDA)
    cases = [(psi, 1.0, 0), (ufl.inner(ufl.grad(u[1]), ufl.grad(u[1])), 1.0, 0), (psi, 0.4, 8)]
    lib.projection_set(factorize, counting)
    try:
        for potential, stretch, cells in cases:
            u.interpolate(lambda x, stretch=stretch: (stretch - 1) * x[:2])
            tangent = forms.tangent(forms.residual(potential * ufl.dx, u), u)
            count = 0
            fem.assemble_matrix(forms.compiled(tangent, project=True))
            assert count == cells
    finally:
        lib.projection_set(factorize, eigen)


ONE_RANK_FIRST = """
from mpi4py import MPI
from variform.forms.operators.stretches import StretchFunction
function = StretchFunction(lambda a, b: a**2 + b**2, 2, "psi_hat")
if MPI.COMM_WORLD.rank == 0:
    function.compiled(MPI.COMM_SELF)
kernel, module = function.compiled(MPI.COMM_WORLD)
points = MPI.COMM_WORLD.gather(kernel.num_points)
if MPI.COMM_WORLD.rank == 0:
    print(*points)
"""


def test_a_rank_that_has_compiled_alone_takes_part_again(run):
    """Compiling is collective whatever a rank knows, and the jet is one of a single state."""
    assert run("-c", ONE_RANK_FIRST, ranks=2).stdout.strip() == "1 1"


SANITIZED = """
import os
os.environ.pop("LD_PRELOAD")  # the compiler goes without
from mpi4py import MPI
import numpy as np
import ufl
from dolfinx import fem, mesh
from variform import forms, meshes
from variform.forms import energies

rng = np.random.default_rng(1)
body = mesh.create_unit_square(MPI.COMM_SELF, 1, 1)
u = forms.displacement(body)
u.x.array[:] = 0.4 * rng.normal(size=u.x.array.size)
psi = energies.as_rigid_as_possible(forms.deformation_gradient(u), 1.0)
for potential in psi * ufl.dx(degree=2), (psi + ufl.inner(u, u)) * ufl.dx(degree=2):
    K = forms.tangent(forms.residual(potential, u), u)
    assert np.isfinite(fem.assemble_matrix(forms.compiled(K, project=True)).data).all()


def term(s):
    return ufl.conditional(ufl.lt(s, 1), s**2, s**2 + (s - 1) ** 3) - s


# The own loop into PETSc's arrays: cells, facets, springs, supports, two fields, a matrix again.
w = forms.displacement_pressure(body)
(v, p), left = ufl.split(w), mesh.locate_entities_boundary(body, 1, lambda x: np.isclose(x[0], 0))
F = forms.deformation_gradient(v)
mixed = energies.with_pressure(energies.isochoric_neo_hookean(F, 1.0), F, p)
plain = energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0)
u.x.array[:] *= 0.1
for potential, unknown, field in (
    (plain * ufl.dx + psi * ufl.ds + forms.spring(u, 2.0, ufl.ds), u, u),
    (mixed * ufl.dx + forms.spring(v, 2.0, ufl.ds), w, v),
):
    for held in [], [forms.roller(unknown, left, 0)], [forms.clamp(unknown, left)]:
        system = forms.Problem(potential, unknown, held)
        A = system.create_matrix()
        assert A.getAttr("variform_insertion") is not None
        for projected in [False, False] + [True] * system.minimization:
            system.tangent(A, projected)
            assert np.isfinite(A.norm())
        system.forms.use_moduli()  # of 16 cells, by kernels of several cells and of one
        if system.forms.moduli is not None:
            system.tangent(A)
            system.forms.moduli.fill()
            product = np.zeros_like(u.x.array)
            system.forms.moduli.multiply(u.x.array, product)
            assert np.isfinite(A.norm()) and np.isfinite(product).all()
            b = system.create_vector()
            system.residual(b)
            assert np.isfinite(b.norm()) and np.isfinite(system.energy())
assert forms.solve(plain * ufl.dx, u, [forms.clamp(u, left)]).completed


# Sweeps of a smoother: from zero with what is left, and again.
from variform.forms.solving.linear.sweeps import Sweeps
solid = meshes.block(MPI.COMM_SELF, (1.0, 1.0, 1.0), n=(2, 2, 2))
v = forms.displacement(solid)
K = forms.Problem(energies.fixed_corotated(forms.deformation_gradient(v), 1.0, 2.0) * ufl.dx, v)
K.forms.use_moduli()  # of linear simplices: energies in singular values of several cells at a time
A = K.create_matrix()
K.tangent(A)
b = K.create_vector()
K.residual(b)
assert b.norm() < 1e-12 and abs(K.energy()) < 1e-12
x, b, r = A.createVecs()[0], *A.createVecs()
b.set(1.0)
sweeps = Sweeps(A)
sweeps(b, x, r)
sweeps(b, x)
assert sweeps.possible and np.isfinite(x.norm()) and np.isfinite(r.norm())


# Bounds of J: blocks of cells that are full and that are not, parts, curved cells, axis, sheets.
from variform.forms.validity import VolumeBounds
CELL = mesh.CellType
for cell in CELL.triangle, CELL.quadrilateral, CELL.tetrahedron, CELL.hexahedron:
    flat = cell in (CELL.triangle, CELL.quadrilateral)
    for bend in 0, 0.05:
        if flat:
            bent = mesh.create_unit_square(MPI.COMM_SELF, 3, 3, cell)
        else:
            bent = mesh.create_unit_cube(MPI.COMM_SELF, 2, 2, 2, cell)
        bent.geometry.x[:, 1] += bend * bent.geometry.x[:, 0] * bent.geometry.x[:, 1]
        for degree in 1, 2, 3:
            v = forms.displacement(bent, degree)
            v.x.array[:] = 0.05 * rng.normal(size=v.x.array.size)
            for revolved in [False, True] if flat else [False]:
                assert np.isfinite(VolumeBounds(v, revolved)().upper)
sheet = meshes.spherical_sheet(MPI.COMM_SELF, 1.0, 0.5, 2, "octant")
v = forms.unknown(sheet, u=(("Lagrange", 1, (3,)), forms.Role.DISPLACEMENT))
v.x.array[:] = 0.1 * rng.normal(size=v.x.array.size)
assert 0 <= VolumeBounds(v)().lower < 1


three = energies.principal(lambda a, b, c: term(a) + term(b) + term(c) - 2 * a * b * c)
two = energies.principal(lambda a, b: term(a) + term(b) - 2 * a * b)
for energy, shape in (three, (3, 3)), (two, (3, 2)), (two, (2, 2)):
    F = np.eye(*shape) + 10 ** rng.uniform(-9, 0, (50, 1, 1)) * rng.normal(size=(50, *shape))
    F[3:6] = 0
    for n in 1, 5, 50:
        for project in False, True:
            assert np.isfinite(energy.evaluate(F[:n], project=project)[1]).all()
"""


def test_nothing_is_read_or_written_beyond_its_array(run, tmp_path, monkeypatch):
    """The compiler's sanitizers of addresses and of undefined behavior find nothing in the C.

    In point and cell kernels, projection, insertion with supports and facets, sweeps, products by
    blocks, bounds of J.
    """
    libraries = []
    for name in "libasan.so", "libubsan.so", "libstdc++.so.6":
        command = [*shlex.split(jit.compiler()), f"-print-file-name={name}"]
        found = subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()
        if not Path(found).is_absolute():
            pytest.skip(f"the compiler has no {name}")
        libraries.append(found)
    flags = ["-O0", "-fsanitize=address,undefined", "-fno-sanitize-recover=undefined"]
    flags += jit._native()
    options = {"cffi_extra_compile_args": flags}
    (tmp_path / "dolfinx_jit_options.json").write_text(json.dumps(options))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("LD_PRELOAD", " ".join(libraries))
    monkeypatch.setenv("ASAN_OPTIONS", "detect_leaks=0")
    if run("-c", "from mpi4py import MPI", check=False).returncode:
        pytest.skip("MPI itself does not start with this compiler's libasan loaded")
    products = f"{test_coarse.RANKS}\nassert max(deviations()) <= {test_coarse.DIGITS}"
    done = run("-c", f"{SANITIZED}\n{products}\nprint('finished')", cwd=tmp_path)
    assert done.stdout.strip() == "finished"
    assert list((tmp_path / "cache" / "fenics").glob("libvariform_*"))


STRICT = ["-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Wcast-qual", "-Wpedantic", "-Werror"]


@pytest.mark.parametrize("data", [[], ["-DVARIFORM_CUSTOM_DATA"]], ids=["0.9", "0.10"])
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_the_c_code_compiles_without_a_warning(compiler, data):
    """The library, and each of its headers by itself, for both of DOLFINx's kernel signatures."""
    if shutil.which(compiler) is None:
        pytest.skip(f"{compiler} is not installed")
    options = ["-std=c17", "-O2", "-march=native", *STRICT, *data, "-fsyntax-only", "-x", "c"]
    headers = sorted(library.SOURCE.glob("*.h"))
    headers.remove(library.SOURCE / "moduli.h")  # for the text of an element, as element.c has one
    sources = [*(library.SOURCE / name for name in ("library.c", "element.c")), *headers]
    assert len(sources) > 9
    for source in sources:
        # Functions of a header that nobody calls yet are no fault of it.
        alone = [] if source.suffix == ".c" else ["-Wno-unused-function", "-Wno-unused-variable"]
        text = f'#include "{source}"\n'
        command = [compiler, *options, *alone, "-"]
        done = subprocess.run(command, input=text, capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"{source.name}: {done.stderr}"


def test_structures_are_compared_with_the_librarys(monkeypatch):
    """Python's declaration of a C structure with a field less is refused when it is loaded."""
    flags = tuple(jit.flags(MPI.COMM_SELF))
    library.library(MPI.COMM_SELF)
    known = library._INSERTION
    monkeypatch.setattr(library, "_INSERTION", known.replace("int facets, lanes; long", "long"))
    assert library._INSERTION != known
    with pytest.raises(RuntimeError, match="declares other structures than Python"):
        library._load.__wrapped__(library._path(flags))


def test_structures_are_compared_with_those_of_generated_code(monkeypatch):
    """The same of the loops for an element, built of a text of their own."""
    text = (library.SOURCE / "element.c").read_text()
    library.element_library(MPI.COMM_SELF, text)
    known = library._INSERTION
    monkeypatch.setattr(library, "_INSERTION", known.replace("int facets, lanes; long", "long"))
    with pytest.raises(RuntimeError, match=r"declares other structures.*insertion\.h have to be"):
        path = library._path((*jit.flags(MPI.COMM_SELF), library.FUSED), text)
        library._load_made.__wrapped__(path, library._ELEMENT, "moduli")
