# SPDX-License-Identifier: MIT
"""Each demo runs as a reader would start it, in an empty folder, and reaches its known number."""

import json
from math import pi

import numpy as np
import pytest
from conftest import ROOT

DEMOS = sorted(file.stem for file in (ROOT / "demos").glob("[a-z]*.py"))


@pytest.fixture
def demo(run, tmp_path):
    """Run a demo and return the numbers it wrote, after checking its path and its files."""

    def start(name, *files, ranks=1):
        done = run("-m", f"demos.{name}", ranks=ranks, cwd=tmp_path)
        folder = tmp_path / "results" / name
        for file in (f"{name}.png", *files):
            assert (folder / file).stat().st_size > 10_000, file
        assert any((folder / f"{name}.bp").iterdir())
        assert {entry.name for entry in tmp_path.iterdir()} == {"results"}
        numbers = json.loads((folder / f"{name}.json").read_text())
        assert numbers["completed"] and numbers["ranks"] == ranks
        return numbers, done.stdout

    return start


def test_twist(demo):
    """One turn is reached; at small angles the moment is Saint-Venant's and some percent."""
    numbers, _ = demo("twist")
    assert numbers["steps"][-1]["load"] == pytest.approx(2 * pi, rel=1e-12)
    assert 1.0 < numbers["moment_over_saint_venant"] < 1.05


def test_cook(demo):
    """P2-P1 reach 6.93 mm from below, P1 lock, and the table shows it."""
    numbers, printed = demo("cook", "deflection.png")
    assert numbers["corner"] == pytest.approx(6.93, abs=0.01)
    table = numbers["table"]
    for rise in table.values():
        assert np.all(np.diff(rise) > 0) and rise[-1] < numbers["corner"]
    assert table["P1"][-1] < 4.5 < 6.7 < table["P2-P1"][0]
    assert f"{numbers['corner']:.4f}" in printed


def test_bar(demo):
    """The benchmark's point reaches its converged place (Land et al. 2015, problem 1)."""
    numbers, _ = demo("bar")
    assert numbers["z"] == pytest.approx(4.17, abs=0.01)
    assert numbers["x"] == pytest.approx(9.18, abs=0.01)
    assert numbers["volume"] == pytest.approx(10, rel=1e-9)


def test_torsion(demo):
    """Moment and force converge to Rivlin's with fourth order, the displacement with third."""
    numbers, _ = demo("torsion", "convergence.png")
    sizes, rates = np.array(numbers["sizes"]), numbers["rates"]
    assert numbers["errors"]["moment"][-1] < 2e-4 * pi / 2
    assert numbers["errors"]["force"][-1] < 1e-3 * pi / 4
    assert rates["moment"] == pytest.approx(4, abs=0.4)
    assert rates["force"] == pytest.approx(4, abs=0.4)
    assert rates["displacement"] == pytest.approx(3, abs=0.3)
    for name, errors in numbers["errors"].items():
        ends = np.log(errors[0] / errors[-1]) / np.log(sizes[0] / sizes[-1])
        assert rates[name] == pytest.approx(ends, abs=0.1), name


def test_import_cad(demo):
    """The wall bears 60 N, the mesh has the CAD's volume, and the table tells the faces apart."""
    numbers, printed = demo("import_cad", "bracket.step")
    assert numbers["force"] == pytest.approx([0, 0, 60], abs=1e-6 * 60)
    assert numbers["volume"] == pytest.approx(numbers["volume_cad"], rel=1e-4)
    assert numbers["volume_cad"] == pytest.approx(24303.009122724, rel=1e-9)
    # Two plates minus the hole, plus the fillet: r^2 (1 - pi/4) times the width.
    plates = 60 * 40 * 6 + 6 * 40 * 44
    assert plates - pi * 64 * 6 + 64 * (1 - pi / 4) * 40 == pytest.approx(numbers["volume_cad"])
    assert printed.count("mm^2 about") == 10


def test_muscle(demo):
    """The bar follows the arc to the error of its elements; the ring is almost free of energy."""
    numbers, _ = demo("muscle", "quarter.png", "half_closed.png")
    assert numbers["steps"][-1]["load"] == 1.0
    assert max(step["records"]["error"] for step in numbers["steps"]) < 1e-3
    assert numbers["ring"] < 1e-3 * numbers["straight"]


@pytest.mark.parametrize("ranks", [1, 2])
def test_scramble(demo, ranks):
    """Four ruined starts return to rest within 12 iterations, whatever the number of ranks."""
    numbers, printed = demo("scramble", ranks=ranks)
    assert numbers["inverted"]["scrambled"] > 400 and numbers["inverted"]["a point"] > 800
    assert max(numbers["iterations"].values()) <= 12
    assert printed.count("|u| = ") == 4


def test_balloon(demo):
    """Sphere and clamped disk pass their limit pressures, 1.2394629 and 1.8791735."""
    numbers, _ = demo("balloon", "pressure.png")
    assert numbers["limits"]["sphere"][1] == pytest.approx(1.2394629, rel=1e-3)
    assert numbers["limits"]["disk"] == pytest.approx([1.17389, 1.8791735], rel=1e-2)
    assert numbers["error"] < 1e-3


@pytest.mark.slow
def test_sheet_or_solid(demo):
    """The sheet is 0.19 % off the solid; on two ranks alike."""
    numbers, printed = demo("sheet_or_solid")
    sheets, solids = np.array(numbers["sheets"]), np.array(numbers["solids"])
    assert numbers["error"] == pytest.approx(1.9e-3, abs=1e-4) and "0.19%" in printed
    assert np.all(np.diff(sheets[:, 1]) < 0) and np.all(np.diff(solids[:, 1]) > 0)
    two, _ = demo("sheet_or_solid", ranks=2)
    assert np.array(two["sheets"])[:, :2] == pytest.approx(sheets[:, :2], rel=1e-10)
    assert np.array(two["solids"])[:, :2] == pytest.approx(solids[:, :2], rel=1e-10)


def test_snap(demo):
    """The arch's first limit load is the beam's, 899, to 1.5 %; unstable states in between."""
    numbers, _ = demo("snap", "path.png")
    assert numbers["limit"] == pytest.approx(899, rel=0.015)
    counts = [step["negative"] for step in numbers["steps"]]
    assert counts[0] == counts[-1] == 0 and max(counts) == 1


def test_press(demo):
    """The force is that of a finer mesh, near the formula's, and grows with every step."""
    numbers, _ = demo("press", "force.png")
    assert numbers["force"] == pytest.approx(17.70, rel=0.02)
    assert numbers["force"] == pytest.approx(numbers["slab"], rel=0.08)
    force = [step["records"]["ball"][1] for step in numbers["steps"]]
    assert np.all(np.diff(force) > 0)


def test_wrap(demo):
    """The force on the cylinder is that of the closed form."""
    numbers, _ = demo("wrap", "force.png")
    assert numbers["ratio"] == pytest.approx(1, abs=0.01)
    assert numbers["steps"][-1]["records"]["roll"][2] < 0


def test_drape(demo):
    """With friction the cloth's weight rests on the ball, and it does; without much it is gone."""
    pytest.importorskip("ipctk", reason="ipctk, an optional package, is not installed")
    numbers, _ = demo("drape", "force.png")
    assert numbers["stays"]["force over weight"] == pytest.approx(1, abs=0.02)
    assert numbers["stays"]["speed"] < 5e-3 < numbers["slides"]["speed"]
    assert numbers["slides"]["force over weight"] == 0
    assert max(numbers[each]["unaccounted"] for each in ("stays", "slides")) < 1e-3


def test_airbag(demo):
    """The cushion's center rises by 217 mm, 3 %, on every mesh."""
    numbers, _ = demo("airbag", "study.png")
    assert list(numbers["rise"].values()) == pytest.approx([0.217] * 6, rel=0.03)


@pytest.mark.slow
def test_reese(demo):
    """Q2-Q1 end at -0.7605 mm, Q2 alone locks, no cell is inside out."""
    numbers, printed = demo("reese", "block.png")
    ends = numbers["ends"]
    assert ends["Q2-Q1, 6 x 6 x 6"] == pytest.approx(-0.7605, abs=2e-3)
    assert ends["Q2, 2 x 2 x 2"] > -0.55 and numbers["smallest_J"] > 0
    assert numbers["steps"][-1]["load"] == 100 and printed.count("Load factor 100 reached") == 4


@pytest.mark.slow
def test_identify(demo):
    """Both stiffnesses within 3 deviations; the field's error falls with the noise."""
    numbers, printed = demo("identify", "noise.png")
    assert numbers["two"] == pytest.approx([4.0, 8.0], rel=0.1)
    errors = [numbers["errors"][level] for level in ("0.001", "0.003", "0.01", "0.03")]
    assert errors == sorted(errors) and "+-" in printed


@pytest.mark.slow
def test_unload(demo):
    """Loaded again, every node of the ventricle is where it was; the wall keeps its volume."""
    numbers, _ = demo("unload")
    assert numbers["distance"] < 1e-8
    assert numbers["rest"][0] == pytest.approx(numbers["seen"][0], rel=1e-3)


@pytest.mark.slow
def test_pose(demo):
    """The bar's middle line meets the drawn curve to 0.2 % of its length."""
    numbers, _ = demo("pose", "fit.png")
    assert numbers["distance"] < 2e-3 and numbers["energy"] < 0.05 * numbers["straight"]


@pytest.mark.slow
def test_twist_on_two_ranks_gives_the_numbers_of_one(demo):
    """Moment and volume ratio at the default tolerances: where loads are the same, and at the end.

    The first steps are alike to the tolerance. Later ones go by the contraction, which
    iterative solves know to their tolerance only and which partitions of the mesh make another, so
    that the way may take a quarter more steps or less.
    """
    one, _ = demo("twist")
    two, _ = demo("twist", ranks=2)
    steps, others = one["steps"], two["steps"]
    assert abs(len(steps) - len(others)) <= len(steps) / 4
    for n, rel in (*((n, 1e-5) for n in range(5)), (-1, 1e-6)):
        assert others[n]["load"] == pytest.approx(steps[n]["load"], rel=rel)
        assert others[n]["records"] == pytest.approx(steps[n]["records"], rel=rel)
    for run in one, two:
        assert all(step["negative"] in (0, None) for step in run["steps"]) and not run["events"]


@pytest.mark.parametrize("name", DEMOS)
def test_demos_keep_their_form(name):
    """Cells, a title, an assert, "Try next" last; at most 120 lines; a place in README."""
    text = (ROOT / "demos" / f"{name}.py").read_text()
    lines, cells = text.splitlines(), text.split("# %%")[1:]
    assert lines[0] == "# SPDX-License-Identifier: MIT"
    assert len(lines) <= 120 and max(map(len, lines)) <= 100
    assert cells[0].lstrip().startswith("[markdown]\n# # ")
    assert cells[-1].lstrip().startswith("[markdown]\n# Try next")
    assert "assert " in text and f'Path("results/{name}")' in text and "def main" not in text
    page, figure = (ROOT / "demos" / "README.md").read_text(), ROOT / "demos" / "figures"
    assert f"| `{name}` |" in page and f"`docker/enter python3 -m demos.{name}`" in page
    assert f"(figures/{name}.png)" in page
    assert 10_000 < (figure / f"{name}.png").stat().st_size <= 100_000


def test_swing(demo):
    """The tip swings as Turek and Hron's, and every joule is accounted for."""
    numbers, _ = demo("swing", "energy.png", "swing.gif")
    assert numbers["amplitude"] == pytest.approx([14.305, 65.160], rel=0.03)
    assert numbers["mean"] == pytest.approx([-14.305, -63.607], rel=0.03)
    assert numbers["frequency"] == pytest.approx(1.0995, rel=0.01)
    assert numbers["unaccounted"] < 1e-3


def test_jump(demo):
    """What is released is lost in the end, and the crown is where one sine wave puts it."""
    numbers, printed = demo("jump", "ledger.png", "jump.gif")
    assert numbers["peak"] == pytest.approx(0.2768, abs=1e-3)
    assert numbers["lost"] == pytest.approx(numbers["released"], rel=1e-3)
    assert numbers["down"] == pytest.approx(-10.19, rel=0.01)
    assert "no equilibrium is connected beyond" in printed


def test_wobble(demo):
    """The midpoint rule keeps momenta and every joule; implicit Euler loses a tenth or more."""
    numbers, _ = demo("wobble", "energy.png", "wobble.gif")
    kept, calmed = numbers["midpoint"], numbers["euler"]
    assert kept["momentum"] < 1e-12 and kept["angular_momentum"] < 1e-10
    assert kept["unaccounted"] < 1e-3 and abs(kept["lost"]) < 1e-9
    assert calmed["lost"] > 0.1 and calmed["angular_momentum"] > 0.05
    assert calmed["unaccounted"] < 1e-6
