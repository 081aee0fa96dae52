# SPDX-License-Identifier: MIT
"""The demos of demos/README.md: what each shows and checks, its picture, and how long it takes."""

import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from demos.benchmarks.record import machine, markdown
from demos.validation.page import shrink

from . import turning
from .energies import FIGURES, ROOT

TIMES = Path(__file__).resolve().parent / "times.json"


@dataclass(frozen=True)
class Demo:
    """A demo's row and picture.

    Attributes:
        name: Of the module in demos, and of its picture.
        shows: What there is to see.
        number: What it ends with.
        source: Where that is known from.
        picture: What the picture shows.
        more: Further pictures, and what they show.
    """

    name: str
    shows: str
    number: str
    source: str
    picture: str
    more: str = ""


DEMOS = (
    Demo(
        "twist",
        shows="a block turned by 360 degrees: from an energy to adaptive load steps and a picture",
        number="moment at small angles: that of Saint-Venant (within the 15 % that clamped "
        "ends add)",
        source="Timoshenko and Goodier, *Theory of Elasticity*, section 109",
        picture="A square block twisted once around, colored by the von Mises stress",
    ),
    Demo(
        "cook",
        shows="Cook's panel, nearly incompressible: elements P2-P1 converge, P1 lock",
        number="rise of the corner 6.93 mm ± 0.01",
        source="our own refinement: 6.919, 6.926, 6.930 mm on 16, 32, 64 cells a side",
        picture="Cook's panel pulled up at its right edge, colored by the pressure",
        more="`deflection.png`, the rise over the unknowns of three elements",
    ),
    Demo(
        "bar",
        shows="heart muscle bent by a pressure that follows it: Guccione's energy, a load "
        "without potential",
        number="the point (10, 0.5, 1) goes to z = 4.17 mm, x = 9.18 mm, both ± 0.01",
        source="Land et al., *Proc. R. Soc. A* 471 (2015) 20150641, problem 1",
        picture="A bar bent upwards by a pressure on its lower side, colored by the stretch "
        "of its fibers",
    ),
    Demo(
        "torsion",
        shows="Rivlin's incompressible cylinder: errors against the exact solution, and "
        "their rates",
        number="moment π/2 N m (0.02 %), axial force -π/4 N (0.1 %), rates 4.1, 3.8 and "
        "(displacement) 3.1",
        source="M = π C1 τ A⁴, N = -π/2 C1 τ² A⁴, worked out below",
        picture="A cylinder twisted by one radian, colored by where its material was at rest",
        more="`convergence.png`, the errors over the size of the cells",
    ),
    Demo(
        "import_cad",
        shows="a bracket from a STEP file, its faces found by area and centroid",
        number="reaction = load of 60 N (to 1e-6), volume = that of the CAD kernel (to 1e-4)",
        source="equilibrium; gmsh's OpenCASCADE",
        picture="An L-shaped bracket bent down by a pin in its hole, colored by the von Mises"
        " stress",
    ),
    Demo(
        "muscle",
        shows="fibers that roll a bar up to a ring: the energy of document 002, an "
        "activation that grows",
        number="distance from the exact arc below 0.2 % of the length, energy below 0.1 % of"
        " the bar kept straight",
        source="F A = R has the arc of curvature k as its solution",
        picture="A bar rolled up to a ring, colored by the stretch of its fibers",
        more="`quarter.png`, `half_closed.png`",
    ),
    Demo(
        "scramble",
        shows="a box with 490 to 836 flat or inverted cells: projected Newton",
        number="back at rest, |u| < 1e-8, in at most 12 iterations",
        source="rest is the one state without stress",
        picture="Four ruined boxes, and how the out-of-balance forces fall in each",
    ),
    Demo(
        "balloon",
        shows="sheets blown up past the largest pressure, the volume prescribed and the "
        "pressure found",
        number="limit pressures 1.2394629 of the sphere (0.1 %), 1.8791735 of the clamped "
        "disk (0.2 %), p r / (μ t)",
        source="2 (1/l \u2212 1/l⁷) at l = 7^(1/6); known limit pressure of the clamped disk",
        picture="A quarter of a flat disk blown up to a dome, colored by its thickness",
        more="`pressure.png`, the pressures beside the closed form",
    ),
    Demo(
        "snap",
        shows="a deep arch falls over: arc length over all limit points, unstable states marked",
        number="first limit load 899 N (1.5 %): 904.4 N",
        source="DaDeppo and Schmidt, *J. Appl. Mech.* 42 (1975) 894-896; the path that the "
        "program fenics_arclength ships",
        picture="A circular arch before and after it has fallen over, hanging in a loop",
        more="`path.png`, the load over the crown's displacement",
    ),
    Demo(
        "press",
        shows="a rigid ball pressed into rubber: a tool that is a formula, moved by the load "
        "factor, contact without a second mesh",
        number="force at a depth of a tenth of the radius 17.70 N (2 %)",
        source="our own refinement; Hertz, and Dimitriadis et al., *Biophys. J.* 82 (2002) "
        "2798-2810, beside it",
        picture="A ball's dent in a slab's meridian plane, colored by the stretch along the axis",
        more="`force.png`, the force over the depth",
    ),
    Demo(
        "wrap",
        shows="a cylinder pushed through a sheet that slides on it: contact of a membrane",
        number="force on the cylinder 2 T sin a (1 %)",
        source="tension, angle and stretch in closed form, worked out in the demo",
        picture="A sheet over a cylinder, colored by the contact pressure",
        more="`force.png`, the force over the rise",
    ),
    Demo(
        "drape",
        shows="a cloth falls on a ball and stays there by friction, or slides off: contact in "
        "motion, with itself, too",
        number="force on the ball over the weight 1 (2 %), and 0 with little friction",
        source="statics: what rests on the ball weighs on it",
        picture="A square of cloth hanging over a ball in folds",
        more="`force.png`, the force on the ball over time with much and with little friction",
    ),
    Demo(
        "airbag",
        shows="a cushion of two square sheets blown up, wrinkled along its seam: a tension "
        "field, solved from the flat sheet in one call",
        number="the center rises by 217 mm (3 %): 215 mm on each of six meshes",
        source="the scene of Contri and Schrefler, *Commun. Appl. Numer. Methods* 4 (1988) 5-15",
        picture="A quarter of a blown-up cushion, colored by how much it is wrinkled",
        more="`study.png`, the rise of the center on six meshes",
    ),
    Demo(
        "sheet_or_solid",
        shows="one clamped disk under a following pressure as a membrane and as a solid: "
        "errors over CPU time",
        number="the sheet's apex within 1 % of the solid's (0.19 %) at a tenth of the time "
        "or less (1/50)",
        source="our own refinement of the solid: 63.2810, 63.2955, 63.3029 mm with 48, 102, "
        "768 hexahedra; `forms.axisymmetric` on far finer cells: 63.306 mm",
        picture="Error of the apex's rise over CPU time of a sheet and of a solid on several "
        "meshes",
    ),
    Demo(
        "reese",
        shows="a nearly incompressible block pressed down to a quarter of its height by a "
        "dead load, in one call: Q2-Q1 beside Q2",
        number="the middle goes down by 0.7605 mm ± 0.002",
        source="our own refinement: 0.7596, 0.7603, 0.7605 mm with 216, 512, 1000 hexahedra Q2-Q1",
        picture="How far the middle of a pressed block goes down, over the load, on four meshes",
        more="`block.png`, the pressed quarter",
    ),
    Demo(
        "swing",
        shows="a heavy bar behind a cylinder is let go: motion by the trapezoidal rule, and where "
        "every joule of a step is",
        number="amplitude of the tip 14.305 mm (3 %) and 65.160 mm (1 %), 1.0995 Hz (1 %)",
        source="Turek and Hron, *Lecture Notes in Computational Science and Engineering* 53 "
        "(2006) 371-385, test CSM3",
        picture="A bar that swings under its own weight, two seconds after it was let go",
        more="`energy.png`, what is stored and what moves, and `swing.gif`",
    ),
    Demo(
        "jump",
        shows="a shallow arch at its limit load: one line, `settle`, carries it by damped motion "
        "to the state at rest behind",
        number="what is released is lost in the end (0.1 %); the crown goes down by 10.18 (1 %)",
        source="the arch in one sine wave, EI (H - a) + EA/4 (H² - a²) a = q (L/π)⁴",
        picture="A half arch hung through, and where it was",
        more="`ledger.png`, the joules of the jump, and `jump.gif`",
    ),
    Demo(
        "wobble",
        shows="a soft body of fixed corotated energy is thrown spinning: what implicit Euler loses "
        "and the midpoint rule keeps",
        number="momentum kept to 1e-12, angular momentum to 1e-10, every joule to 1e-3",
        source="both are invariants of the midpoint rule",
        picture="A soft block that was thrown spinning, and where it was",
        more="`energy.png`, what is stored and what moves by both schemes, and `wobble.gif`",
    ),
    Demo(
        "identify",
        shows="two stiff inclusions found from displacements of the rim with noise: two numbers "
        "with their deviations, then a field of moduli",
        number="both stiffnesses within 3 standard deviations; both disks in the field",
        source="the moduli 4 and 8 that the data were made with",
        picture="A square pulled upwards, colored by the logarithm of the modulus that was found: "
        "two stiff disks",
        more="`noise.png`, the error of the field over the noise",
    ),
    Demo(
        "unload",
        shows="a ventricle that is known under pressure, and its shape at rest",
        number="loaded again, every node is at its given place to 1e-8 of the size; the wall "
        "keeps its volume",
        source="the given shape: Land et al., *Proc. R. Soc. A* 471 (2015) 20150641, problem 2",
        picture="A ventricle under pressure, colored by how far its points are from their places "
        "at rest",
    ),
    Demo(
        "pose",
        shows="the contraction that makes a bar follow a drawn curve: `muscle` the other way round",
        number="the middle line within 0.2 % of the length of the curve, at 5 % of the energy of "
        "the bar kept straight",
        source="F A = R has any curve of the bar's length as its solution",
        picture="A bar bent to a wave, colored by the activation that was found",
        more="`fit.png`, places found over places drawn",
    ),
)


def table():
    """Lines of the table, with the times that were kept."""
    times = json.loads(TIMES.read_text())
    rows = [
        [f"`{demo.name}`", demo.shows, demo.number, demo.source, "{:.0f} s, {:.0f} s".format(*kept)]
        for demo in DEMOS
        for kept in [times["seconds"][demo.name]]
    ]
    columns = ("demo", "what it shows", "the number it checks", "its source", "first run, later")
    lines = markdown(columns, [[cell.replace("|", "\\|") for cell in row] for row in rows])
    return [
        *lines,
        "",
        "Times on the clock, on one core; the first run compiles the forms, later ones find them "
        f"in the cache. {times['processor']}, {times['date']}.",
    ]


def gallery():
    """Lines of the gallery: each command with its picture."""
    lines = []
    for demo in DEMOS:
        more = f" (and {demo.more})" if demo.more else ""
        lines += [f"`docker/enter python3 -m demos.{demo.name}`{more}", ""]
        lines += [f"![{demo.picture}](figures/{demo.name}.png)", ""]
    return lines[:-1]


def run(names=()):
    """Run demos twice, the first time with no form compiled; keep times, pictures, surfaces.

    All of them, or those of some names: the times of the others stay.
    """
    about, seconds = machine(), json.loads(TIMES.read_text())["seconds"] if names else {}
    for demo in DEMOS:
        if names and demo.name not in names:
            continue
        with tempfile.TemporaryDirectory() as folder:
            clean = {"XDG_CACHE_HOME": f"{folder}/cache", "PYTHONPATH": str(ROOT)}
            environment = {**os.environ, **clean}
            seconds[demo.name] = []
            for _ in range(2):
                start = time.perf_counter()
                command = [sys.executable, "-m", f"demos.{demo.name}"]
                said = subprocess.run(command, cwd=folder, env=environment, capture_output=True)
                said.check_returncode()
                seconds[demo.name].append(round(time.perf_counter() - start, 1))
            picture = Path("results") / demo.name / f"{demo.name}.png"
            shrink(folder / picture, FIGURES / picture.name)
            if demo.name in turning.TURNED:
                command[2:] = "demos.pages.turning", demo.name
                said = subprocess.run(command, cwd=folder, env=environment, capture_output=True)
                said.check_returncode()
        print(f"{demo.name}: {seconds[demo.name]} s", flush=True)
    kept = {"processor": about["processor"], "date": about["date"], "seconds": seconds}
    TIMES.write_text(json.dumps(kept, indent=1) + "\n")
