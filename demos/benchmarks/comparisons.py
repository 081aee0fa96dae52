# SPDX-License-Identifier: MIT
"""Comparisons of the work-precision charts: which solves make which curve of which chart."""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

from . import scenes

SCENES = {
    "pad": {"UFL": scenes.pad, "operator": partial(scenes.pad, energy="operator")},
    "pad, nu = 0.4999": {"": partial(scenes.pad, energy="nearly incompressible")},
    "pad, Guccione": {"": partial(scenes.pad, energy="Guccione")},
    "cantilever": {
        "even": scenes.cantilever,
        "graded": partial(scenes.cantilever, power=2),
        "reference": partial(scenes.cantilever, power=3),
    },
    "slab": {
        "solid": partial(scenes.cantilever, width=20, power=2),
        "plane strain": partial(scenes.cantilever, power=2),
    },
    "tube": {m: partial(scenes.tube, model=m) for m in ("solid", "plane strain", "axisymmetric")},
    "balloon": {m: partial(scenes.balloon, model=m) for m in ("solid", "axisymmetric", "membrane")},
}


class Case(NamedTuple):
    """One solve; method is "preset", "MUMPS", or multigrid with a tolerance, INEXACT or FULL."""

    scene: str
    model: str
    element: str
    n: int | float
    method: str = "preset"
    degree: int | None = None


class Curve(NamedTuple):
    """Solves of one kind on finer and finer meshes."""

    label: str
    model: str
    element: str
    sizes: Sequence[float]
    method: str = "preset"
    degree: int | None = None


# Scene, and cases of its reference; the other scenes have closed forms.
REFERENCES = {
    "pad": ("UFL", "Q3", (2, 4, 8)),
    "pad, nu = 0.4999": ("", "Q3-Q2", (2, 4, 6)),
    "pad, Guccione": ("", "Q3", (2, 4, 8)),
    "cantilever": ("reference", "Q3", (4, 8, 16)),
    "slab": ("solid", "Q2", (1, 2, 4)),
}
SIZES = {
    "P1": (4, 8, 16, 32),
    "P2": (2, 4, 8, 12, 16),
    "P3": (1, 2, 3, 4, 6, 8),
    "Q1": (4, 8, 16, 32),
    "Q2": (1, 2, 4, 8, 12),
    "Q3": (1, 2, 3, 4, 5, 6),
}
INEXACT, FULL = "multigrid to 1e-2", "multigrid to 1e-8"
PLANE = {"P1": (8, 16, 32, 64), "P2": (2, 4, 8, 16, 32), "P3": (2, 4, 8, 16), "Q2": (2, 4, 8, 16)}
PANELS = {
    "elements, smooth": ("pad", [Curve(e, "UFL", e, n) for e, n in SIZES.items()]),
    "elements, singular edges": (
        "cantilever",
        [Curve(e, "even", e, n) for e, n in PLANE.items()]
        + [Curve(f"{e}, graded", "graded", e, PLANE[e]) for e in ("P2", "P3", "Q2")],
    ),
    "linear solver, Newton": (
        "pad",
        [
            Curve(f"{e}, {way}", "UFL", e, [n for n in SIZES[e] if 1 < n <= most], way)
            for e, largest in (("P2", 12), ("P3", 8))
            for way, most in (("MUMPS", largest * 3 // 4), (INEXACT, largest), (FULL, largest))
        ],
    ),
    "UFL and operator": (
        "pad",
        [
            Curve(f"{e}, {model}", model, e, SIZES[e])
            for e in ("P1", "P2", "P3")
            for model in ("UFL", "operator")
        ],
    ),
    "nearly incompressible": (
        "pad, nu = 0.4999",
        # Without a pressure multigrid takes a thousand iterations: they get the better solver.
        [Curve(e, "", e, n, "MUMPS") for e, n in (("P1", (4, 8, 16)), ("P2", (2, 4, 8)))]
        + [Curve(e, "", e, n, "MUMPS") for e, n in (("Q2", (2, 4, 6)), ("P3", (2, 4)))]
        + [Curve(e, "", e, n) for e, n in (("P2-P1", (2, 4, 8)), ("Q2-Q1", (2, 4, 8)))]
        + [Curve(e, "", e, n) for e, n in (("P3-P2", (2, 4, 6)), ("Q3-Q2", (1, 2, 4, 6)))],
    ),
    "tube": (
        "tube",
        [
            Curve("3D, P2-P1", "solid", "P2-P1", (1, 2, 4, 6, 8)),
            Curve("3D, Q2-Q1", "solid", "Q2-Q1", (1, 2, 4, 6, 8)),
            Curve("plane strain, Q2-Q1", "plane strain", "Q2-Q1", (1, 2, 4, 8)),
            Curve("axisymmetric, Q2-Q1", "axisymmetric", "Q2-Q1", (1, 2, 4, 8)),
        ],
    ),
    "slab": (
        "slab",
        [
            Curve("3D, P2", "solid", "P2", (1, 2, 4)),
            Curve("3D, Q2", "solid", "Q2", (1, 2, 3)),
            Curve("plane strain, P2", "plane strain", "P2", (1, 2, 4, 8)),
            Curve("plane strain, Q2", "plane strain", "Q2", (1, 2, 4, 8)),
        ],
    ),
    "balloon": (
        "balloon",
        [
            Curve("3D, P2-P1", "solid", "P2-P1", (3, 6, 12, 20)),
            Curve("axisymmetric, Q2-Q1", "axisymmetric", "Q2-Q1", (2, 4, 8)),
            Curve("membrane, P1", "membrane", "P1", (2, 4, 8, 16, 32)),
            Curve("membrane, P2", "membrane", "P2", (2, 4, 8, 16)),
        ],
    ),
}
# Degrees of the rule over those of the displacements, k; with P1 0 and 1 are one rule.
RULES = {"2k - 2": -2, "2k - 1": -1, "2k": 0, "2k + 2": 2}
QUADRATURE = {
    f"quadrature, {name}": (
        scene,
        [
            Curve(f"{e}, {rule}", model, e, n, "preset", 2 * int(e[1]) + more)
            for e, n in (("P1", (4, 8, 16)), ("P2", (2, 4, 8)), ("P3", (2, 3, 4)))
            for rule, more in RULES.items()
            if 2 * int(e[1]) + more > 0
        ],
    )
    for name, scene, model in (("neo-Hookean", "pad", "UFL"), ("Guccione", "pad, Guccione", ""))
}
# Toy runs: these curves with their first two meshes, and other references.
SMALL = {
    "elements, smooth": ("P1", "P2"),
    "nearly incompressible": ("P2-P1",),
    "balloon": ("axisymmetric, Q2-Q1", "membrane, P2"),
    "quadrature, neo-Hookean": ("P1, 2k - 1", "P1, 2k"),
}
SMALL_REFERENCES = {"pad": ("UFL", "P2", (2, 3, 4)), "pad, nu = 0.4999": ("", "P2-P1", (2, 3, 4))}
