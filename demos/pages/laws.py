# SPDX-License-Identifier: MIT
"""The test files of tests/README.md: their laws, how many tests they hold, the digits recorded."""

import ast
import json
import os
import re
import subprocess
import sys

from demos.benchmarks.record import markdown

from .energies import ROOT

# In the order of the package; a file that is not here comes last, with the first line of its
# docstring for a law. Where this says more than that line, it is because a table has room for it.
LAWS = {
    "kinematics": "strains and line elements (1)-(5), invariants (13), (22); plane models; "
    "P33 = 0 where condensed",
    "energies": "rest, objectivity, symmetry, moduli of small strains, (18), (19), (23), domains; "
    "isochoric energies against 110-digit differences",
    "variation": "residual and tangent are derivatives, every energy in every kinematics; "
    "(29), (32), (34), (52); (12), (27), (28)",
    "point_kernels": "signed singular values; stress and tangent of ten energies against 110-digit "
    "differences of the energy (reference.py); projection, inf and NaN",
    "quotients": "difference and sum quotients at every gap, the clamp; how many evaluations and "
    "sweeps they cost",
    "operators": "energies in singular values equal plain UFL in any form: cells, orders, facets, "
    "regions, parameters, products, mixed unknowns, sheets; document 002; the limits",
    "operator_errors": "what energies in singular values refuse, a sentence each, and where they "
    "are infinite",
    "native": "compiled code at work: caches, compilers, ranks, what it costs; nothing beyond an "
    "array's bounds",
    "compilation": "code is compiled once, ever, whatever was made before; kills at any moment, "
    "two at a time, no locks",
    "projection": "projected tangents; ruined states return to rest; the last iterations are "
    "quadratic",
    "membranes": "areas, volumes and sides of surfaces; sheet energies as derivatives and in "
    "several ways; a sphere under pressure",
    "evaluation": "any energy at arrays of F: closed forms, differences, equal singular values; "
    "compiled once",
    "loads": "pressure is the derivative of p V; signs; tangents of follower loads; points and "
    "lines whatever the mesh",
    "supports": "rigid motions at every node and load",
    "slants": "rollers along any direction: turned bars and cubes, a sector of a ring, a "
    "round wall; every way of solving; gradients; multigrid; 1, 2, 3 ranks",
    "solve": "uniaxial stretch, shear, sheets, tube; manufactured solutions; balance; units, mixed "
    "problems included",
    "cubic": "elements of degree 3 in mixed unknowns: uniform bodies, fields put and read; 1, 2, 3 "
    "ranks",
    "unknowns": "fields by name and role: a heated bar, pressure and volume ratio, damage; own "
    "mixed elements; 1, 2, 3 ranks",
    "intervals": "bounds of UFL scalars over boxes contain every value; of points they have no "
    "width",
    "obstacles": "distances in closed form, the barrier and its derivatives, its rule; what is "
    "refused",
    "barriers": "no step crosses an obstacle at any length, by moving ones neither; starts beyond "
    "one are refused",
    "contact": "uniform states of one equation, Hertz, balance; an arch on a floor, a balloon in "
    "a box; multigrid, restart, 1, 2, 3 ranks",
    "problems": "a second solve sets nothing up and knows of no earlier one; terms of one's own; "
    "no step passes a barrier",
    "entities": "measures given as lists count each entity once, and list what the mesh has",
    "insertion": "tangents in PETSc's arrays, and products without a matrix, are DOLFINx's own "
    "matrix: cells, orders, integrals, supports, ranks",
    "quadrature": "which degree an integrand gets, the same wherever forms compile; one point is "
    "exact for P1; the order of convergence stays",
    "control": "a balloon past its limit point, a load found from a displacement",
    "controls_several": "two scalars by two functionals: mean stretches, chambers, a guided end in "
    "closed form; limit points and bifurcations told apart, ledger, restart, gradients, fit, ranks",
    "sheets": "tension fields against closed forms, bending of a stretched sheet, flat starts, "
    "Hencky's disk, weight, enclosed gas, a balloon's stability",
    "paths": "arch and frame against published paths, PETSc's arc length, Euler's column and the "
    "elastica, pins",
    "stepping": "load steps, targets and arc length alike: broken off, a path goes on bit by bit; "
    "an interrupt names the checkpoint; how a path went, in a few lines",
    "following": "the path is the user's: the right state of README's twist, the account of its "
    "energy, events, jumps on purpose, SNES's monitor, ranks",
    "accounts": "the ledger closes up to the largest load; states within steps are the account's "
    "alone, also when resumed, and no nearer to equilibrium than these need; a jump stays "
    "unaccounted; ranks",
    "programs": "tables of loads, kinks on which steps end, loads that go back",
    "checkpoint": "a path taken up again is the uninterrupted one; broken files, full disks",
    "checkpoint_refusals": "checkpoints of another mesh, element, way or format are refused before "
    "anything is solved",
    "checkpoint_ranks": "checkpoints are of no partition; a path goes on, on other ranks; errors "
    "reach all",
    "kills": "kills at any moment leave a whole checkpoint",
    "sweeps": "multigrid's smoother is symmetric Gauss-Seidel, in single precision, in any units, "
    "over each rank's nodes; its cycle takes as many iterations as PETSc's",
    "multigrid": "multigrid over the order and the field split find MUMPS's solution, at "
    "iterations that hardly grow",
    "options": "PETSc's options hold wherever they are set, and stay the user's; linear solvers "
    "chosen by them agree",
    "failures": "failures and interrupts keep the last state; undefined states and starts are "
    "refused and named",
    "arguments": "wrong arguments of a solve or a path are refused before anything is solved",
    "stability": "rigid motions that nothing holds are named; negative eigenvalues count "
    "instabilities alone",
    "differentiation": "slack fibers, branches in powers, second derivatives that are infinite",
    "results": "resultants balance, of pins, points, lines and regions, too; values at points; "
    "JSON, VTX and pictures read back",
    "output": "VTU, OBJ, PLY and CSV are read back by PyVista, meshio and NumPy; 1, 2, 3 ranks",
    "validity": "bounds of J over whole cells are never above a J, tell the sign and are narrow: "
    "every element, curved cells, axis, sheets, ranks",
    "formulas_elasticity": "document 003, (1)-(12), (27), (28): strains, work, stresses and "
    "elasticity tensors against complex steps; laws of any state",
    "formulas_materials": "document 003, (13)-(26): isotropic and transversely isotropic materials "
    "against complex steps and UFL; their misprints measured",
    "formulas_shapes": "shape functions, faces and quadrature rules of hand-written elements",
    "formulas_element": "hand-written elements, (29)-(60), one by one; their misprints measured",
    "formulas_assembly": "bodies assembled by hand: R = T \u2212 F and K_c + K_sigma equal the "
    "automatic residual and tangent on tet4, tet10, hex8, hex27",
    "formulas_svd": "document 000: stress and dP/dF against 80-digit differences of psi(F); "
    "quotients at all gaps",
    "formulas_derivation": "document 000: the derivation in SymPy; blocks as derived, as printed, "
    "as divided",
    "formulas_membranes": "document 001: rates, invariants, sheet and eigensystems against "
    "60-digit differences",
    "formulas_polar": "document 002: R, dR, P, H against 80-digit differences, SO(3) and O(3)",
    "formulas_properties": "documents 000 to 002 at any state: isotropy, symmetry, scaling, 2D "
    "inside 3D",
    "match": "the automatic side equals documents 000, 001 and 002; what the printed tangents of "
    "003 cost Newton",
    "table": "the tables of forms/formulas/README.md are complete and name what exists",
    "parallel": "1, 2 and 3 ranks agree; errors reach all ranks",
    "meshes": "volumes, areas, normals and names of every generator; wrong arguments",
    "reading": "volumes, areas and names of files of every kind; 1, 2, 3 ranks",
    "files": "regions, boundaries and data of odd files and of arrays; 1, 2, 3 ranks",
    "meshio": "meshes of other programs: XDMF and its HDF5, .msh, Abaqus",
    "bad_files": "files that make no body are refused by name, with what is wrong and how often",
    "session": "a user's gmsh session comes back as it was",
    "fibers": "fibers of the ventricle against the parametrization that defines them; "
    "active tension",
    "demos": "every demo ends with its known number (demos/README.md)",
    "validation": "the validation gallery: closed forms, fits, comparison of numbers, known cases",
    "notebooks": "notebooks are their sources, executed; the solutions of their exercises run",
    "benchmarks": "every benchmark at toy size; the block of the peers, the estimate's formula",
    "environment": "docker/enter, its refusals, OpenBLAS, threads",
    "builds": "docker/enter makes a root once, whoever kills or doubles it",
    "generated": "tables and pictures of the pages follow from the code",
    "turning": "surfaces of the demos' bodies are kept, small and whole, beside their pictures",
    "pages": "links, code, commands and names of every page are there; forms for contributors",
    "walk": "in a fresh clone all that the pages show is typed, and no file of it changes",
    "browser": "a notebook's solutions and its slider in Chromium (ENTER_SITE=1 docker/enter)",
    "site": "the rendered site: no dead link, no raw TeX, no error in Chromium (ENTER_SITE=1)",
    "house": "imports point down as drawn, no circle, private names at home, one import name",
    "package": "wheel, versions, imports, the first screen of the README",
}

# Says what pytest would run, without running it.
COLLECT = """
import json, sys
import pytest

class Count:
    def pytest_collection_finish(self, session):
        found = {}
        for item in session.items:
            counts = found.setdefault(item.path.stem, [0, 0])
            counts[0] += 1
            counts[1] += item.get_closest_marker("slow") is not None
        print("COUNTS" + json.dumps(found))

words = ["--collect-only", "-q", "-q", "-m", "", "-p", "no:cacheprovider", "tests"]
sys.exit(pytest.main(words, plugins=[Count()]))
"""


def counts():
    """Numbers of all and of slow tests in each file, by pytest's collection in a new process.

    Raises:
        RuntimeError: a test file cannot be collected; pytest's words follow.
    """
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-c", COLLECT],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    found = re.search(r"COUNTS(\{.*\})", done.stdout)
    if done.returncode or not found:
        raise RuntimeError(f"pytest cannot collect the tests:\n{done.stdout}{done.stderr}")
    return {stem.removeprefix("test_"): n for stem, n in json.loads(found[1]).items()}


def recorded():
    """Digits that a run has recorded for the tests of a file: forms/formulas/README.md has them."""
    page = (ROOT / "forms" / "formulas" / "README.md").read_text()
    part = page.partition("<!-- capabilities: ")[2].partition("<!-- end of capabilities")[0]
    homes, alone, shared = {}, {}, {}
    for pattern in ("test_formulas_*.py", "test_match.py"):
        for file in (ROOT / "tests").glob(pattern):
            for node in ast.parse(file.read_text()).body:
                if isinstance(node, ast.FunctionDef):
                    homes.setdefault(node.name, set()).add(file.stem.removeprefix("test_"))
    for line in part.splitlines():
        cells = line.strip("| ").split(" | ")
        number = re.match(r"\d+", cells[-1])
        if len(cells) != 7 or not number:
            continue
        tests = re.findall(r"`(test_\w+)`", cells[-2])
        files = set().union(*(homes.get(test, set()) for test in tests))
        for file in files:
            (alone if len(files) == 1 else shared).setdefault(file, []).append(int(number[0]))
    # A row has the digits of its worst test: where all its tests stand in one file, that file's.
    return {file: (min(found), max(found)) for file, found in (shared | alone).items()}


def law(name):
    """Law of a test file: from LAWS, or the first line of its docstring."""
    if name in LAWS:
        return LAWS[name]
    doc = ast.get_docstring(ast.parse((ROOT / "tests" / f"test_{name}.py").read_text())) or ""
    return doc.split("\n")[0].rstrip(".")


def lines():
    """Lines of tests/README.md: file, law, number of tests, digits."""
    numbers, digits, table = counts(), recorded(), []
    for name in [*(n for n in LAWS if n in numbers), *sorted(set(numbers) - set(LAWS))]:
        total, slow = numbers[name]
        low, high = digits.get(name, ("", ""))
        span = str(low) if low == high else f"{low} to {high}"
        table.append([f"test_{name}", law(name), f"{total} ({slow} slow)" if slow else total, span])
    total, slow = (sum(n) for n in zip(*numbers.values(), strict=True))
    table.append(["together", "", f"{total} ({slow} slow)", ""])
    return markdown(("File", "Law", "Tests", "Digits recorded"), table)
