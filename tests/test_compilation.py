# SPDX-License-Identifier: MIT
"""Compiled code: made once, ever, and by whoever lives, whatever was killed before."""

import io
import os
import random
import signal
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from cases import LMBDA, MU, unit_mesh
from dolfinx import fem

from demos.benchmarks.kills import kill, start
from variform.forms import energies
from variform.forms.native import canonical, jit, once
from variform.forms.operators import energy as operators
from variform.forms.operators import stretches

HANGS = 900  # s; against hangs only


def modules(cache):
    return sorted(p.name for p in Path(cache).glob("fenics/**/*.so"))


EVALUATED = """
import sys
import numpy as np
import ufl
from variform.forms import energies
for _ in range(int(sys.argv[1])):
    ufl.variable(ufl.as_ufl(1.0))
    ufl.Constant(ufl.Mesh(__import__("basix.ufl").ufl.element("P", "interval", 1, shape=(1,))))
F = 1.1 * np.eye(3)[None]
for mu in 1.0, 1.5:
    energies.fixed_corotated.evaluate(F, mu, 2.0)
    energies.fixed_corotated.energy(F, 2 * mu, np.array([2.0]))
    energies.ogden.evaluate(F, [mu, -0.5], [2.0, -2.0])
"""


def test_an_energy_on_arrays_is_compiled_once(run, tmp_path, monkeypatch):
    """Two energies, however often, with whatever numbers, in any process: two modules."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    for before in (0, 8):  # numbers 9 and 10 are sorted as words
        run("-c", EVALUATED, before)
        assert len([name for name in modules(tmp_path) if "ffcx" in name]) == 2


FORMS = """
import sys
from mpi4py import MPI
import ufl
from dolfinx import fem, mesh
from variform import forms
from variform.forms import energies, stress
body = mesh.create_unit_square(MPI.COMM_WORLD, 1, 2)
made = []
for _ in range(int(sys.argv[1])):
    ufl.variable(ufl.SpatialCoordinate(body)), ufl.Index()
    made += [fem.Constant(body, 1.0), forms.displacement(body)]
u = forms.displacement(body)
a, b = fem.Constant(body, 2.0), fem.Constant(body, 3.0)
F = forms.deformation_gradient(u)
field = forms.field(b * stress.cauchy(energies.neo_hookean(F, a, b), F), body, 0)
value = forms.integral((a * F[0, 0] + b * F[1, 1] + energies.hencky(F, a, b)) * ufl.dx)
sheet = forms.plane_stress(u, lambda F: energies.neo_hookean(F, a, b))
assert abs(value - 5) < 1e-12 and abs(forms.smallest_volume_ratio(sheet, body) - 1) < 1e-12
"""


def test_names_of_code_contain_no_running_numbers(run, tmp_path, monkeypatch):
    """Forms, fields, jets and operands of another process find the code of the first."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    found = []
    for seed, before in enumerate((0, 9)):  # Constants 0 and 1; 9 and 10, sorted as words
        monkeypatch.setenv("PYTHONHASHSEED", str(seed))
        run("-c", FORMS, before)
        found.append(modules(tmp_path))
    assert found[0] == found[1]
    assert len(found[0]) == 7  # the library; form, operand and jet; three expressions


def test_a_canonical_form_has_the_values_of_the_given_one():
    """Its Constants follow those that they stand for; variables and their derivatives are gone."""
    body = unit_mesh(2)
    many = [fem.Constant(body, float(k)) for k in range(12)]
    x = ufl.variable(ufl.SpatialCoordinate(body))
    inner = sum(c * ufl.inner(x, x) ** k for k, c in enumerate(many))
    written = canonical.canonical(ufl.diff(inner, x)[0] * ufl.dx)
    assert not {type(e).__name__ for e in _nodes(written)} & {"Variable", "Label"}
    assert [c.count() for c in written.constants()] == list(range(11))  # without the first
    one, other = (fem.form(f) for f in (written, ufl.diff(inner, x)[0] * ufl.dx))
    for value in (5.0, 7.0):
        many[3].value = value
        assert fem.assemble_scalar(one) == pytest.approx(fem.assemble_scalar(other), rel=1e-13)


def _nodes(form):
    for integral in form.integrals():
        yield from ufl.corealg.traversal.unique_pre_traversal(integral.integrand())


def test_a_second_call_derives_and_compiles_nothing(monkeypatch):
    """Numbers are input of the compiled kernel, and its derivation is kept with the energy."""
    F = np.eye(3)[None] + 0.1
    first = energies.ogden.evaluate(F, [1.0, -0.5], [2.0, -2.0])[0]
    extended = energies.extended(energies.hencky, 0.5)  # makes labels at each call
    low = extended.energy(F, MU, LMBDA)

    def refuse(*_, **__):
        raise AssertionError("called again")

    monkeypatch.setattr(stretches, "expand_derivatives", refuse)
    monkeypatch.setattr(jit, "compiled", refuse)
    again = energies.ogden.evaluate(F, [2.0, -1.0], [2.0, -2.0])[0]
    assert np.allclose(again, 2 * first, rtol=1e-14)
    assert extended.energy(F, 2 * MU, 2 * LMBDA) == pytest.approx(2 * low, rel=1e-14)
    with pytest.raises(AssertionError, match="called again"):
        energies.ogden.evaluate(F, [1.0], [2.0])  # another length is another text


def test_what_stands_in_psi_hat_is_never_mixed_up():
    """Alike functions with other captured values, and Constants, are read at each call."""
    body = unit_mesh(2)
    stiff = fem.Constant(body, 2.0)

    def law(k):
        return energies.principal(lambda a, b: k * ((a - 1) ** 2 + (b - 1) ** 2))

    F = 1.1 * np.eye(2)[None]
    weights = [1.0, 1.0 + 2**-50, 3.0, stiff]
    laws = [law(k) for k in weights]
    for value in (2.0, 5.0):
        stiff.value = value
        for k, energy in zip(weights, laws, strict=True):
            wanted = 0.02 * (value if k is stiff else k)
            assert energy.energy(F)[0] == pytest.approx(wanted, rel=1e-13)


def test_an_energy_remembers_so_many_texts_only():
    """Values that change in the text of psi_hat do not fill the memory."""
    k = 1.0
    energy = energies.principal(lambda a, b: k * ((a - 1) ** 2 + (b - 1) ** 2))
    kept = [k * 1.0 for k in range(1, operators.TEXTS + 5)]
    for weight in kept:
        k = weight  # the one that psi_hat sees
        energy._numeric({})
    assert len(energy._functions) == operators.TEXTS
    mapped = energy.mapped(lambda psi_hat: psi_hat, "mapped")
    assert not mapped._functions


COLD = """
from mpi4py import MPI
import ufl
from dolfinx import mesh
from variform import forms
body = mesh.create_unit_square(MPI.COMM_WORLD, 2, 2)
F = forms.deformation_gradient(forms.displacement(body, degree=2))
C = forms.stress.spatial_elasticity(forms.energies.neo_hookean(F, 1.0, 1.0), F)
forms.field(C, body, 1)
forms.integral(F[0, 0] * ufl.dx)
if MPI.COMM_WORLD.rank == 0:
    print("finished")
"""


def wait_for(condition, process):
    """Wait until something holds, while a process lives."""
    while not condition():
        assert process.poll() is None, process.communicate(timeout=HANGS)[1]
        time.sleep(0.002)


@pytest.mark.parametrize("how", ["KILL", "KILL on 2 ranks", "INT"])
def test_a_killed_compile_leaves_nothing_to_wait_for(how, run, tmp_path, monkeypatch):
    """The next run succeeds, alone and at once, whenever the one before was killed."""
    ranks = 2 if "2" in how else 1
    draw = random.Random(how)
    process = start(COLD, tmp_path, ranks)
    wait_for(lambda: list(tmp_path.glob("fenics/**/*.c")), process)
    time.sleep(draw.uniform(0, 0.1))
    if how == "INT":
        os.killpg(process.pid, signal.SIGINT)
        process.communicate(timeout=HANGS)
    else:
        kill(process)
    left = list(tmp_path.glob("fenics/*.*"))  # locks and unfinished folders
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert run("-c", COLD, ranks=ranks).stdout.strip() == "finished"
    assert len(modules(tmp_path)) == 2 and not list(tmp_path.glob("fenics/*.*"))
    assert how != "INT" or not left


ONCE = """
import sys, time
from pathlib import Path
from variform.forms.native.once import make_once
place, log = Path(sys.argv[1]), Path(sys.argv[2])
def make(folder):
    with log.open("a") as file:
        file.write("made ")
    (folder / "new").write_text("whole")
    time.sleep(float(sys.argv[3]))
    return folder / "new"
make_once(place, make)
print(place.read_text())
"""


def made_once(tmp_path, seconds):
    script = ONCE.replace("sys.argv[3]", repr(str(seconds)))
    for k, name in enumerate(("place", "log"), 1):
        script = script.replace(f"sys.argv[{k}]", repr(str(tmp_path / "cache" / name)))
    return start(script, tmp_path)


def test_others_wait_as_long_as_the_one_that_makes_it_lives(tmp_path):
    """Two at a time: one works, one waits; when the first is killed the second does the work."""
    cache = tmp_path / "cache"
    (tmp_path / "cache").mkdir()
    first = made_once(tmp_path, HANGS)
    wait_for((cache / "log").exists, first)
    others = [made_once(tmp_path, 0.1) for _ in range(2)]
    try:
        time.sleep(1.5)
        assert all(other.poll() is None for other in others)
        first.kill()
        first.communicate(timeout=HANGS)
        said = [other.communicate(timeout=HANGS) for other in others]
    finally:
        for process in (first, *others):
            process.kill()
    assert [out.strip() for out, _ in said] == ["whole"] * 2, said
    assert (cache / "log").read_text() == "made made "
    assert {p.name for p in cache.iterdir()} == {"log", "place"}


def test_who_waits_long_says_for_what(tmp_path, monkeypatch):
    """One sentence with the lock's name, and the wait goes on."""
    monkeypatch.setattr(once, "PATIENCE", 0)
    # Not pytest's capture: what is written between its read and its truncation is lost.
    monkeypatch.setattr(sys, "stderr", written := io.StringIO())
    place = tmp_path / "place"
    with ThreadPoolExecutor(1) as pool:
        with once._locked(tmp_path / "place.lock"):
            waiting = pool.submit(once.make_once, place, lambda folder: folder)
            while "this one goes on." not in written.getvalue():
                assert not waiting.done()
                time.sleep(0.01)
        waiting.result()
    said = written.getvalue()
    assert said.count("variform: waiting for another process") == 1
    assert f"({tmp_path}/place.lock): if it hangs, end it" in said


def test_where_files_cannot_be_locked_each_works_by_itself(tmp_path, monkeypatch):
    """As on some network folders: the one that ends first is taken, and nothing fails."""

    def no_locks(*_):
        raise OSError(37, "No locks available")

    monkeypatch.setattr(once.fcntl, "flock", no_locks)
    place, made = tmp_path / "place", []

    def make(folder):
        (folder / "new").mkdir()
        (folder / "new" / "text").write_text(f"of {len(made)}")
        made.append(folder)
        if len(made) == 1:  # another begins and ends meanwhile
            once.make_once(place, make)
        return folder / "new"

    once.make_once(place, make)
    assert (place / "text").read_text() == "of 1" and len(made) == 2
    assert [p.name for p in tmp_path.iterdir()] == ["place"]


@pytest.mark.slow
def test_a_slow_compile_of_another_is_no_failure(tmp_path):
    """Two cold runs, and a compiler that takes 70 s: longer than any patience there was."""
    slow = tmp_path / "slow-cc"
    sleep_once = f"[ -e {tmp_path}/slept ] || {{ touch {tmp_path}/slept; sleep 70; }}"
    slow.write_text(f'#!/bin/sh\n{sleep_once}\nexec {jit.compiler()} "$@"\n')
    slow.chmod(0o755)
    both = [start(COLD, tmp_path, CC=str(slow)) for _ in range(2)]
    said = [process.communicate(timeout=HANGS) for process in both]
    assert [out.strip() for out, _ in said] == ["finished"] * 2, said


ONE_RANK_ALONE = """
from mpi4py import MPI
import numpy as np
from variform.forms.operators.stretches import StretchFunction
function = StretchFunction(lambda a, b: a**4 + b**4, 2, "psi_hat")
if MPI.COMM_WORLD.rank == 1:
    function.compiled(MPI.COMM_SELF)
function.compiled(MPI.COMM_WORLD)
print("finished")
"""


def test_a_lock_is_never_held_while_ranks_wait_for_each_other(run, tmp_path, monkeypatch):
    """Rank 1 compiles by itself what rank 0 compiles for both."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    out = run("-c", ONE_RANK_ALONE, ranks=2).stdout
    assert out.count("finished") == 2


def test_a_form_that_cannot_be_compiled_is_named_alike_on_all_ranks(run):
    """The error of rank 0, which compiles, reaches the others."""
    script = """
from mpi4py import MPI
import ufl
from variform import forms
from dolfinx import mesh
body = mesh.create_unit_square(MPI.COMM_WORLD, 2, 2)
try:
    forms.integral(ufl.variable(ufl.cell_avg(ufl.SpatialCoordinate(body)[0])) * ufl.dx)
except RuntimeError as error:
    said = MPI.COMM_WORLD.gather(str(error))
    if MPI.COMM_WORLD.rank == 0:
        print(*said, sep="\\n")
"""
    alone, *both = (
        line for ranks in (1, 2) for line in run("-c", script, ranks=ranks).stdout.splitlines()
    )
    assert alone.startswith("compiling a form failed (") and both == [alone, alone]


def test_what_is_there_is_used_without_a_lock(tmp_path, monkeypatch):
    """So the cache may be readable only."""
    monkeypatch.delattr(once, "_locked")
    place = tmp_path / "place"
    place.write_text("whole")
    once.make_once(place, lambda folder: folder)
    assert place.read_text() == "whole"


COMPILER = """#!/bin/sh
for word; do
    case $word in {refused}) echo "unknown value 'native' for $word" >&2; exit 1 ;; esac
done
exec gcc "$@"
"""


@pytest.mark.parametrize(
    ("refused", "native"),
    [
        ("-none", ["-march=native"]),
        ("-march=native", ["-mcpu=native"]),
        ("-m*=native", []),
    ],
)
def test_a_compiler_without_march_native_is_served(refused, native, tmp_path, monkeypatch):
    """Where -march=native is refused, -mcpu=native is tried, as clang on arm64 wants, or none."""
    other = tmp_path / "cc"
    other.write_text(COMPILER.format(refused=refused))
    other.chmod(0o755)
    monkeypatch.setenv("CC", str(other))
    jit._native.cache_clear()
    try:
        assert [f for f in jit.flags(MPI.COMM_SELF) if "native" in f] == native
    finally:
        jit._native.cache_clear()
