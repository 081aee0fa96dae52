# SPDX-License-Identifier: MIT
"""Toy-sized runs of every benchmark, as a reader would start them."""

import csv
import json

import dolfinx
import ffcx.codegeneration.lnodes as tree
import numpy as np
import pytest

from demos.benchmarks import cluster, hard_cases, hard_scenes, rates
from demos.benchmarks.peers import pressed, stretched
from demos.benchmarks.peers.points import right_values, states
from demos.benchmarks.peers.problem import block, quadratic, turned
from demos.benchmarks.peers.ways import closed_form
from variform import forms


def test_benchmark_of_operators_runs(run, tmp_path):
    """The rows of the full benchmark, at toy size: every way is assembled and timed."""
    done = run("-m", "demos.benchmarks.operators", "--small", cwd=tmp_path)
    rows = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(rows) == 35 and all(row.get("ratio", 1) > 0 for row in rows)
    assert (tmp_path / "results" / "operators.csv").stat().st_size > 1000


def test_benchmark_of_moduli_runs(run, tmp_path):
    """The same numbers as FFCx's at every element, and paths that take the same iterations."""
    done = run("-m", "demos.benchmarks.moduli", "--small", cwd=tmp_path)
    rows = [json.loads(line) for line in done.stdout.splitlines()]
    single = [row for row in rows if "tangent" in row]
    assert len(rows) == 17 and len(single) == 15
    assert all(row["deviation"] < 1e-14 for row in single)
    paths = [row for row in rows if "path" in row]
    assert all(row["same"] and row["deviation"] < 1e-9 for row in paths)
    assert (tmp_path / "results" / "moduli.csv").stat().st_size > 1000


def test_benchmark_of_rates_runs(run, tmp_path):
    """A row: a product reads the matrix once, a residual does more than the energy."""
    command = ("-m", "demos.benchmarks.rates", "--row", "P1", "neo-Hookean", "2")
    row = json.loads(run(*command, cwd=tmp_path).stdout.splitlines()[-1])
    stored = row["product: operations"] / 2  # a product and a sum for each number stored
    assert row["product: bytes"] == pytest.approx(12 * stored + 20)
    assert 0 < row["energy: operations"] < row["residual: operations"]
    assert min(row[name] for name in rates.PIECES) > 0 and row["Newton"] > 2


@pytest.mark.parametrize("element, points", [("P1", 1), ("P2", 4)])
def test_tangents_by_moduli_are_counted_by_their_loops(element, points):
    """At a point 54 for each of n (n + 1)/2 blocks, 162 for a node, and the moduli's kernel."""
    problem, _ = rates.scene(element, "neo-Hookean", 1)
    problem.forms.use_moduli()
    found, own = rates.of_moduli(problem.forms.tangent_ufl)
    assert found == points and own > 45 * points
    cells = problem.u.function_space.mesh.topology.index_map(3).size_local
    nodes = problem.u.function_space.dofmap.list.shape[1]
    loops = points * (162 * nodes + 27 * nodes * (nodes + 1))
    assert rates.limits(problem, 1)["tangent"][1] == cells * (own + loops)


def test_operations_of_a_loop_are_counted():
    """sum_i a_i b_i + c of three turns: a product, a sum and what is added to, each time."""
    i, a, b, c, s = (tree.Symbol(name, dtype=tree.DataType.REAL) for name in "iabcs")
    added = tree.Add(tree.Mul(a, b), c)
    loop = tree.ForRange(i, 0, 3, body=[tree.AssignAdd(s, added)])
    assert rates.count(loop) == 3 * 3
    assert rates.count(tree.VariableDecl(s, tree.Sum([a, b, c]))) == 2
    assert rates.count(tree.Assign(s, tree.MathFunction("ln", [tree.Mul(a, b)]))) == 2


def test_benchmark_of_hard_cases_runs(run, tmp_path):
    """Five cheap ones: variform solves all, DOLFINx's Newton the two that its steps can reach.

    Those that are load paths end where small steps do, with the energy that is known.
    """
    done = run("-m", "demos.benchmarks.hard_cases", "--small", cwd=tmp_path)
    rows = [json.loads(line) for line in done.stdout.splitlines()]
    solved = {
        name: [r["case"] for r in rows if r["solver"] == name and r["solved"]]
        for name in ("variform", "DOLFINx")
    }
    assert len(rows) == 10 and len(solved["variform"]) == 5
    assert solved["DOLFINx"] == ["confined", "pressure"]
    assert all(row["tangents"] > 0 for row in rows)
    paths = [row for row in rows if row["case"] != "scrambled" and row["solved"]]
    assert all("energy" in row["numbers"] for row in paths)
    assert (tmp_path / "results" / "hard_cases.csv").stat().st_size > 1000


def test_hard_cases_refuse_another_branch():
    """A wrong energy, an event that is not the path's, and inverted cells are found."""
    case = hard_scenes.CASES["pressure"]()
    case.begin(None)
    path = case.call()
    assert hard_cases.faults(case, path)[0] == []
    case.end = case.end._replace(energy=1.01 * case.end.energy)
    wrong, _ = hard_cases.faults(case, path)
    assert len(wrong) == 1 and wrong[0].startswith("energy 0.9430312 for 0.95246")
    path.events.append(forms.paths.Event(0.5, "bifurcation", 0, 1))
    assert hard_cases.faults(case, path)[0][1] == "passed [('bifurcation', 0.5)] for []"
    case.u.x.array[:] = 0
    case.u.sub(0).interpolate(lambda x: -2 * x[0])
    assert any(word.startswith("J = -1") for word in hard_cases.faults(case, None)[0])


def test_ends_of_hard_cases_are_found_again(run, tmp_path):
    """Small steps, none refused and all work accounted for, lead to the numbers in the cases."""
    names = ("confined", "balloon")
    done = run("-m", "demos.benchmarks.hard_cases", "--ends", *names, cwd=tmp_path)
    for line in map(json.loads, done.stdout.splitlines()):
        end = hard_scenes.CASES[line["case"]]().end
        assert line["energy"] == pytest.approx(end.energy, rel=1e-7)
        assert line["negative"] == end.negative
        assert [kind for kind, _ in line["events"]] == [kind for kind, *_ in end.events]
        assert line["steps"] == 200 and line["refused"] == 0 and line["unaccounted"] < 1e-6


def test_benchmark_of_sensitivities_runs(run, tmp_path):
    """Every scene, its gradient compiled and taken again."""
    done = run("-m", "demos.benchmarks.sensitivities", "--small", cwd=tmp_path)
    rows = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    assert [row["parameters"] for row in rows] == [2, 32, 48, 162, 384]
    assert all(row["ratio"] > 0 for row in rows)
    assert (tmp_path / "results" / "sensitivities.csv").stat().st_size > 200


def test_benchmark_of_multigrid_runs(run, tmp_path):
    """Toy sizes: every element is solved both ways, the mixed ones in both bodies."""
    done = run("-m", "demos.benchmarks.multigrid", "--small", "P2", "Q2-Q1", cwd=tmp_path)
    rows = [json.loads(line) for line in done.stdout.splitlines()]
    assert [row["what"] for row in rows] == 3 * ["solve", "twist", "twist"]
    assert [row["body"] for row in rows] == 6 * ["bar"] + 3 * ["cube"]
    assert all(5 < row["iterations"] < 60 for row in rows if row["what"] == "solve")
    assert (tmp_path / "results" / "multigrid.csv").stat().st_size > 200


@pytest.mark.slow
def test_benchmark_of_locking_runs(run, tmp_path):
    """Two ratios on toy meshes: a pressure helps at nu = 0.4999 in both bodies."""
    done = run("-m", "demos.benchmarks.locking", "--small", cwd=tmp_path)
    rows = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(rows) == 28
    for scene in ("Cook", "cantilever"):
        found = [r for r in rows if (r["scene"], r["energy"]) == (scene, "neo-Hookean")]
        error = {r["element"]: r["error"] for r in found if r["nu"] == 0.4999}
        assert error["P2-P1"] < 0.8 * error["P2"] < error["P1"]
        assert error["Q2-Q1"] < 0.8 * error["Q2"] < error["Q1"]
    assert (tmp_path / "results" / "locking.png").stat().st_size > 10_000


@pytest.mark.slow
def test_benchmark_of_contact_runs(run, tmp_path):
    """Toy sizes: a smaller dhat is nearer to Hertz; multigrid and MUMPS meet with and without."""
    done = run("-m", "demos.benchmarks.contact", "--small", cwd=tmp_path)
    rows = [json.loads(line) for line in done.stdout.splitlines()]
    for kind in ("cylinder", "sphere"):
        for element in ("Q1", "Q2"):
            found = [r for r in rows if (r.get("body"), r.get("element")) == (kind, element)]
            far, near = (abs(r["width"]) for r in sorted(found, key=lambda r: -r["dhat/h"]))
            assert near < far and near < 0.03
    assert sum(r.get("what") == "presets" for r in rows) == 8
    assert next(r for r in rows if r.get("what") == "overhead")["ratio, surfaces"] > 0
    two = next(r for r in rows if r.get("body") == "two cylinders")
    assert (
        max(abs(two[f"{what}, {side}"]) for what in ("width",) for side in ("upper", "lower"))
        < 0.02
    )
    sphere = next(r for r in rows if r.get("body") == "sphere in space")
    assert abs(sphere["width"]) < 0.1 and abs(sphere["peak"]) < 0.15
    assert (tmp_path / "results" / "contact.png").stat().st_size > 10_000


def test_benchmark_of_self_contact_runs(run, tmp_path):
    """Toy sizes: a bar that turns a little, a cloth that begins to fold."""
    pytest.importorskip("ipctk", reason="ipctk, an optional package, is not installed")
    done = run("-m", "demos.benchmarks.self_contact", "--small", cwd=tmp_path)
    rows = [json.loads(line) for line in done.stdout.splitlines()]
    assert [row["crossed"] for row in rows] == [0, 0] and min(r["least J"] for r in rows) > 0.5
    assert (tmp_path / "results" / "self_contact.png").stat().st_size > 10_000


def test_benchmark_of_points_runs(run, tmp_path):
    """A coarse map: equal stretches are right by variform only; the clamp is the documented one."""
    done = run("-m", "demos.benchmarks.atlas", "--small", cwd=tmp_path)
    rows = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(rows) == 14
    tangents = {row["way"]: row for row in rows if row["quantity"] == "dP/dF"}
    equal = {way: row["wrong for first <="] for way, row in tangents.items()}
    # Differences are off by less than the 1e-6 that count as wrong.
    assert [way for way, gap in equal.items() if gap is None] == [
        "differences",
        "variform",
        "F rounded once more",
    ]
    assert equal["NumPy, clamped 1e-6"] == 1e-8 and tangents["UFL, plain"]["not finite"] > 0.3
    ours = tangents["variform"]
    assert ours["right"] == tangents["F rounded once more"]["right"] and not ours["not finite"]
    # 4 mu / (clamp s1) at s2 + s3 = 0, largest for the least s1 = 0.75.
    assert ours["largest without a value"] == pytest.approx(4 / 0.75e-6, rel=1e-9)
    assert tangents["NumPy, naive"]["largest without a value"] is None
    assert (tmp_path / "results" / "atlas.png").stat().st_size > 10_000
    assert (tmp_path / "results" / "atlas_map.csv").stat().st_size > 10_000


def test_benchmark_of_newton_runs(run, tmp_path):
    """Toy sizes: full steps solve the easy corner only, variform's two projections everything."""
    done = run("-m", "demos.benchmarks.newton_atlas", "--small", cwd=tmp_path)
    rows = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(rows) == 40
    right = {}
    for row in rows:
        right.setdefault(row["method"], []).append(not row["failure"])
    assert all(right["variform, auto"] + right["variform, always"])
    assert right["DOLFINx, full steps"] == 2 * [True, False, False, False]
    assert not all(right["SNES, bt along R"]) and not all(right["variform, never"])
    always = [row["iterations"] for row in rows if row["method"] == "variform, always"]
    assert max(always) <= 25
    assert (tmp_path / "results" / "newton_atlas.png").stat().st_size > 10_000


@pytest.mark.skipif(
    not dolfinx.__version__.startswith("0.9"),
    reason="peers/vanilla.py is written as DOLFINx 0.9's own demos are",
)
def test_benchmark_of_peers_runs(run, tmp_path):
    """Toy blocks: DOLFINx and variform agree with the reference, and every file is written."""
    run("-m", "demos.benchmarks.peers", "--small", cwd=tmp_path)
    lines = (tmp_path / "results" / "peers" / "rows.jsonl").read_text().splitlines()
    rows = [json.loads(line) for line in lines]
    assert not [row for row in rows if "error" in row]
    paths = [row for row in rows if row["what"] == "path"]
    assert len(paths) == 6 and all(row["residual"] <= row["tolerance"] for row in paths)
    with (tmp_path / "results" / "peers.csv").open() as file:
        compared = [row for row in csv.DictReader(file) if row["what"] == "path"]
    assert len(compared) == 6 and all(float(row["off by"]) < 1e-6 for row in compared)
    (ours,) = (row for row in rows if row.get("way") == "variform")
    smooth = [state for state in states() if state not in ("rank 1", "zero")]
    assert len(smooth) == 8 and all(ours[state] == "right / right" for state in smooth)
    assert (tmp_path / "results" / "peers.png").stat().st_size > 10_000


def test_benchmark_of_a_pressed_cube_runs(run, tmp_path):
    """At toy size: the stress is uniform to rounding, and the force off by dhat's share alone."""
    run("-m", "demos.benchmarks.peers.pressed", "--small", cwd=tmp_path)
    (row,) = json.loads((tmp_path / "results" / "peers" / "pressed.json").read_text())
    assert row["stress, largest deviation"] < 1e-9 and -0.02 < row["force, error"] < 0
    points, cells = pressed.cube(2)
    corners = points[cells]
    assert len(points) == 27 and np.allclose(corners.mean(axis=1).mean(axis=0), 0.5)
    assert np.all(np.linalg.det(corners[:, [1, 3, 4]] - corners[:, :1]) > 0)


# Reaction of 4 x 8 x 8 cells and its derivatives by mu and lmbda, as torch-fem 0.14.0 has found
# them with its default tolerances, by demos/benchmarks/peers/torchfem_stretched.py --n 8.
TORCH_FEM = [3839.480813565053, 9.974081421174786, 0.005712462741608908]


def test_benchmark_of_a_stretched_box_runs(run, tmp_path):
    """Force and derivatives are those of uniaxial tension, and torch-fem's, on any mesh."""
    run("-m", "demos.benchmarks.peers.stretched", "--small", cwd=tmp_path)
    (row,) = json.loads((tmp_path / "results" / "peers" / "stretched.json").read_text())
    assert np.abs(row["errors"]).max() < 1e-7
    assert stretched.response() == pytest.approx(TORCH_FEM, rel=1e-9)
    assert row["found"] == pytest.approx(TORCH_FEM, rel=1e-7)
    h, at = 1e-3, (stretched.MU, stretched.LMBDA)
    for k in range(2):
        ends = [
            stretched.response(*(m + s * h * (k == i) for i, m in enumerate(at)))[0]
            for s in (1, -1)
        ]
        assert (ends[0] - ends[1]) / (2 * h) == pytest.approx(TORCH_FEM[1 + k], rel=1e-6)


def test_peers_blocks_are_the_same_body():
    """Volumes add up to 0.04 for both elements; the turned end keeps its lengths."""
    points, cells = block(2)
    corners = points[cells]
    volumes = np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6
    assert volumes.min() > 0 and volumes.sum() == pytest.approx(0.04, rel=1e-12)
    more, ten = quadratic(points, cells)
    assert ten.shape == (len(cells), 10) and np.array_equal(more[: len(points)], points)
    edge = more[ten[:, 4]] - points[cells[:, [0, 1]]].mean(axis=1)
    assert np.abs(edge).max() < 1e-15
    end = points[np.isclose(points[:, 0], 1)]
    moved = end + turned(end, 0.7)
    before, after = (np.linalg.norm(x[:, None] - x, axis=-1) for x in (end, moved))
    assert np.abs(after - before).max() < 1e-15


def test_peers_right_values_are_those_of_the_closed_form():
    """Differences of the energy find stress and tangent to 1e-7, a hundredth of what is asked."""
    for name, F in states().items():
        if name not in ("rank 1", "zero"):
            P, D = closed_form(F[None])
            for found, right in zip(right_values(F), (P, D), strict=True):
                assert np.abs(found - right.reshape(found.shape)).max() < 1e-7, name


def test_benchmark_of_work_and_precision_runs(run, tmp_path):
    """Toy sizes: errors fall with the mesh, a membrane's down to that of its model."""
    done = run("-m", "demos.benchmarks.work_precision", "--small", cwd=tmp_path)
    rows = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(rows) == 14 and all(row["converged"] and row["seconds"] > 0 for row in rows)
    curves = {(row["comparison"], row["curve"]): [] for row in rows}
    for row in rows:
        curves[row["comparison"], row["curve"]].append(row["error"])
    assert all(fine < 0.6 * coarse for coarse, fine in curves.values())
    # Closed forms: 1e-4 by a body of revolution, the membrane stays at 0.105 % (thickness 1/10).
    assert curves["balloon", "axisymmetric, Q2-Q1"][1] < 1e-4
    assert 1e-3 < curves["balloon", "membrane, P2"][1] < 2e-3
    # One point or four: the same error with linear elements.
    rules = [curves["quadrature, neo-Hookean", f"P1, {d}"] for d in ("2k - 1", "2k")]
    assert rules[0] == pytest.approx(rules[1], rel=0.02)
    for name in ("work_precision.csv", "work_precision.png", "work_precision_quadrature.svg"):
        assert (tmp_path / "results" / name).stat().st_size > 1000


@pytest.mark.slow
def test_benchmark_of_scaling_runs(run, tmp_path):
    """Toy size on 1 and 2 ranks: the cells are shared out, and the solve is the same."""
    done = run("-m", "demos.benchmarks.scaling", "--small", cwd=tmp_path)
    rows = [json.loads(line) for line in done.stdout.splitlines()]
    kinds = [(row["what"], row["ranks"]) for row in rows if "what" in row]
    expected = [("strong", 1), ("apart", 1), ("strong", 2), ("weak", 1), ("weak", 2), ("mesh", 1)]
    assert kinds == expected
    one, two = (row for row in rows if row["what"] == "strong")
    assert one["dofs"] == two["dofs"] and one["stored"] == two["stored"]
    assert one["energy"] == pytest.approx(two["energy"], rel=1e-10)
    # Aggregates end at the border of a rank: the linear solves differ, to tolerances of their own.
    assert abs(one["iterations"] - two["iterations"]) <= 2
    assert abs(one["Newton"] - two["Newton"]) <= 1
    assert one["SpMV [B]"] == 0 and one["SpMV, messages"] == 0
    # A cut has 9 x 9 nodes of 3 numbers; a product needs at least the half of them it does not own.
    assert 12 * 81 <= two["SpMV [B]"] <= 2 * 24 * 81 and two["SpMV, messages"] == 1
    assert 1 <= two["imbalance"] < 1.1
    assert all(row["step, efficiency"] > 0 for row in rows if row["what"] != "mesh")
    assert (tmp_path / "results" / "scaling.png").stat().st_size > 10_000


def test_benchmark_of_validity_runs(run, tmp_path):
    """No bound above a J, none too wide; only surfaces, which may collapse, stay open."""
    done = run("-m", "demos.benchmarks.validity", "--small", cwd=tmp_path)
    rows = [json.loads(line) for line in done.stdout.splitlines()]
    swept, timed = rows[:36], rows[36:]
    assert all(row["above"] == row["wide"] == 0 for row in swept)
    assert {row["kind"] for row in swept if row["open"]} <= {"surface"}
    assert [row["element"] for row in timed] == ["P1", "P2", "P3", "Q1", "Q2", "Q3"]
    assert all(0 < row["lower"] <= row["upper"] < 1 for row in timed)
    assert (tmp_path / "results" / "validity.csv").stat().st_size > 1000


def test_estimate_follows_its_formula():
    """Ten times the cores: a tenth of the work each; all waiting where there is no work."""
    seconds = {"residual [s]": 0.04, "tangent [s]": 0.2, "SpMV [s]": 0.015, "V-cycle [s]": 0.09}
    seconds |= {"set-up [s]": 3.0, "solve [s]": 1.6, "step [s]": 10.0}
    names = "SpMV", "V-cycle", "set-up"
    pieces = {f"{p}, {k}": 10.0 for p in names for k in ("messages", "reductions")}
    row = {"what": "strong", "element": "P1", "m": 23, "dofs": 200_000, "stored": 8_000_000}
    row |= {"coarsest": 12, "levels": 6, "iterations": 14, "linear": 42, "SpMV [B]": 14_000.0}
    row |= {"memory before [MB]": 160, "memory [MB]": 560, **seconds, **pieces}
    made = {"what": "mesh", "cells": 1e6, "memory before [MB]": 100, "memory [MB]": 1100}
    rows = [row | {"ranks": 1}, row | {"ranks": 2, "dofs": 400_000}]
    e = cluster.Estimate([*rows, made | {"checkpoint [B]": 2e8}])
    few, many = e.times(100), e.times(1000)
    assert few["assembly"] == pytest.approx(10 * many["assembly"], rel=1e-2)
    assert few["waiting"] < many["waiting"] < e.times(1e6)["waiting"] < 1
    assert e.times(e.half())["waiting"] == pytest.approx(0.5, abs=0.02)
    assert e.halo(3e6) == pytest.approx(100 * e.halo(3e3))
    assert dict(e.limits())["numbers of rows, in PETSc's integers of 32 bits"] == 2**31 - 1


@pytest.mark.slow
def test_benchmark_of_kills_runs(run, tmp_path):
    """Two kills and two runs at a time on each number of ranks: nothing fails afterwards."""
    done = run("-m", "demos.benchmarks.kills", "--small", cwd=tmp_path)
    rows = [json.loads(line) for line in done.stdout.splitlines()]
    killed = [row for row in rows if "next run" in row]
    assert len(rows) == 8 and len(killed) == 4
    assert all(row["next run"] == "succeeds" and not row["unfinished then"] for row in killed)
    assert {row.get("two at a time", "both succeed") for row in rows} == {"both succeed"}


def test_benchmark_of_motion_runs(run, tmp_path):
    """A coarse bar swings as published, a thrown body keeps its momenta, schemes have orders."""
    done = run("-m", "demos.benchmarks.motion", "--small", cwd=tmp_path)
    rows = [json.loads(line) for line in done.stdout.splitlines()]
    swings, throws, errors, costs = (
        [row for row in rows if row["part"] == part]
        for part in ("swing", "thrown", "scheme", "cost")
    )
    assert all(abs(row["Hz"] / 1.0995 - 1) < 0.01 for row in swings)
    assert all(abs(row["uy amplitude"] / 65.160 - 1) < 0.02 for row in swings)
    assert 3 < swings[0]["unaccounted"] / swings[1]["unaccounted"] < 5
    midpoint, euler = throws
    assert midpoint["momentum"] < 1e-12 and midpoint["angular momentum"] < 1e-9
    assert midpoint["second half's excursion"] < 1.1 and euler["angular momentum"] > 0.05
    assert {row["scheme"] for row in errors} == {"euler", "bdf2", "newmark", "midpoint"}
    assert all(row["error"] < 0.2 for row in errors) and len(costs) == 1
    assert (tmp_path / "results" / "motion.csv").stat().st_size > 1000
