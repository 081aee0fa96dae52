# SPDX-License-Identifier: MIT
"""The list of cases: what is run, which numbers are known, and from where."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from math import pi

from . import hertz, inflation, land, reused, treloar

LAND = "Land et al., *Proc. R. Soc. A* 471 (2015) 20150641"


@dataclass(frozen=True)
class Known:
    """A number that is known: its reference, how far off we may be, both in the unit."""

    reference: float
    tolerance: float
    unit: str = ""


@dataclass(frozen=True)
class Case:
    """One scene with known numbers.

    Attributes:
        title: One line for the page.
        source: Where the references come from.
        run: Function (folder, comm) that writes pictures and returns numbers by name. Collective.
        known: References, by the name of the number; numbers without one are kept all the same.
        picture: The PNG file, of those that are written, that the page shows.
    """

    title: str
    source: str
    run: Callable[..., dict[str, float]]
    known: dict[str, Known]
    picture: str
    text: str = field(default="")


def _pressure(n):
    """The closed form's pressure at the largest radius, to half a percent (a thousandth)."""
    exact = inflation.closed_form(n, inflation.RADII[-1])
    return Known(exact, (1e-3 if n == 2 else 5e-3) * exact, "MPa")


CASES = {
    "land1": Case(
        "Heart muscle: a bar bent by a pressure",
        f"{LAND}, problem 1: the point (10, 0.5, 1)",
        reused.bar,
        {
            "z": Known(4.17, 0.01, "mm"),
            "x": Known(9.18, 0.01, "mm"),
            "volume": Known(10.0, 1e-6, "mm³"),
        },
        "bar",
    ),
    "land2": Case(
        "Heart muscle: a ventricle blown up",
        f"{LAND}, problem 2: height of the apex inside and outside",
        partial(land.run, 2),
        {
            "endo": Known(-26.61, 0.05, "mm"),
            "epi": Known(-28.28, 0.05, "mm"),
            "volume over that at rest": Known(1.0, 1e-6),
            "endo of the section": Known(-26.61, 0.01, "mm"),
            "epi of the section": Known(-28.28, 0.01, "mm"),
        },
        "land2",
        "669 tetrahedra P3-P2, and the meridian section by `forms.axisymmetric`.",
    ),
    "land3": Case(
        "Heart muscle: a ventricle that contracts",
        f"{LAND}, problem 3: height of the apex inside and outside",
        partial(land.run, 3),
        {
            "endo": Known(-12.35, 0.4, "mm"),
            "epi": Known(-15.45, 0.15, "mm"),
            "volume over that at rest": Known(1.0, 1e-6),
            "endo of the section": Known(-12.35, 0.05, "mm"),
            "epi of the section": Known(-15.45, 0.05, "mm"),
        },
        "land3",
        "804 tetrahedra P3-P2, of 0.35 mm at the apex. There fibers meet from all sides; inside, "
        "its place depends on the size of the cells. Hence the tolerance of 0.4 mm, and the same "
        "problem as a body of revolution that turns, its section in 640 cells Q2-Q1.",
    ),
    "cook": Case(
        "Cook's panel, nearly incompressible",
        "our own refinement, [demos](../README.md)",
        reused.cook,
        {"corner": Known(6.93, 0.01, "mm")},
        "cook",
    ),
    "torsion": Case(
        "Rivlin's torsion of a cylinder",
        "closed form, [demos](../README.md#the-exact-numbers-of-torsion)",
        reused.torsion,
        {
            "moment": Known(pi / 2, 2e-4 * pi / 2, "N m"),
            "force": Known(-pi / 4, 1e-3 * pi / 4, "N"),
        },
        "torsion",
    ),
    "inflation": Case(
        "A thick tube and a thick sphere blown up to twice their inner radius",
        "closed forms of incompressible Mooney-Rivlin, see `inflation.py`",
        inflation.run,
        {"tube": _pressure(2), "sphere": _pressure(3)},
        "inflation",
    ),
    "treloar": Case(
        "Rubber: Ogden and Mooney-Rivlin fitted to three tests at once",
        "Treloar, *Trans. Faraday Soc.* 40 (1944) 59-70; Ogden, *Proc. R. Soc. Lond. A* 326 (1972) "
        "565-584; digitized by the sources that the files in `data` name",
        treloar.run,
        {
            "Ogden, uniaxial": Known(0, 0.1101),
            "Ogden, equibiaxial": Known(0, 0.0461),
            "Ogden, pure shear": Known(0, 0.0349),
        },
        "treloar",
        "Root mean square of the errors over that of the stresses. Tolerances are what Ogden's own "
        "three terms of 1972 leave. `spread` is how far digitizations of the same measurements lie "
        "apart (median); no fit can be asked to beat it. Mooney-Rivlin has no upturn.",
    ),
    "membranes": Case(
        "Rubber sheets: limit pressures of a sphere and of a clamped disk",
        "2 (1/l - 1/l^7) at l = 7^(1/6); known limit pressure of the disk; p r / (mu t)",
        reused.balloon,
        {"sphere": Known(1.2394629, 1.2e-3), "disk": Known(1.8791735, 3.8e-3)},
        "balloon",
    ),
    "arch": Case(
        "A deep arch falls over",
        "DaDeppo and Schmidt, *J. Appl. Mech.* 42 (1975) 894-896: first limit load",
        reused.snap,
        {"limit": Known(899.0, 13.5, "N")},
        "snap",
    ),
    "reese": Case(
        "A nearly incompressible block pressed to a quarter of its height",
        "our own refinement, [demos](../README.md)",
        reused.reese,
        {"middle": Known(-0.7605, 0.002, "mm")},
        "reese",
    ),
    "muscle": Case(
        "A bar that rolls itself up to a ring",
        "the exact arc: mean distance over the length, energy over that of the bar kept straight",
        reused.muscle,
        {"distance": Known(0, 2e-3), "energy": Known(0, 1e-3)},
        "muscle",
    ),
    "hertz": Case(
        "Contact: a cylinder and a sphere pressed on a plane",
        "Hertz's closed forms, at the force that is found",
        hertz.hertz,
        {
            **{
                f"{kind}, {what}": Known(1, 0.01)
                for kind in ("cylinder", "sphere")
                for what in ("half-width", "peak")
            },
            "cylinder, profile": Known(0, 0.02),
            "sphere, profile": Known(0, 0.02),
        },
        "hertz",
        "Of linear elasticity, a/R = 0.05, 20 a wide and high, plane strain and a body of "
        "revolution; quadrilaterals of degree 1, a/h = 40 at the contact, dhat = h/10. "
        "Half-width by the second moment of the projected pressure, and its largest value, over "
        "Hertz's; profile is the root mean square of p - p_Hertz over that of p_Hertz. What other "
        "cells and reaches make of it: [benchmarks](../benchmarks/README.md#contact).",
    ),
    "press": Case(
        "Contact: two blocks of different meshes pressed evenly",
        "closed form, two blocks in series with the gap that the barrier leaves",
        hertz.press,
        {
            "force": Known(1, 2e-3),
            "stress beside, low": Known(0, 5e-3),
            "stress beside, up": Known(0, 5e-3),
            "stress, largest": Known(0, 1e-2),
        },
        "press",
        "Plane strain between rollers, 8 x 8 cells below and 13 x 13 above, pressed together by a "
        "tenth of a block's height; dhat = 1/1040 of it. The force over that of the closed form, "
        "and P22 over its mean, less 1: root mean squares over the rows of cells beside the "
        "contact, and the largest of any cell. Surfaces need ipctk.",
    ),
}
