# SPDX-License-Identifier: MIT
"""The energies of forms/README.md: formulas from docstrings, and the tests that use them."""

import ast
import inspect
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import ufl

from demos.benchmarks.record import markdown
from variform.forms import energies
from variform.forms.kinematics import isochoric

ROOT = Path(__file__).resolve().parent.parent.parent
FIGURES = ROOT / "demos" / "figures"

MU, LMBDA, NU = 1.0, 2.0, 1 / 3  # NU is LMBDA's; incompressible energies take their own
SHEET = {"E": 2 * MU * (1 + NU), "nu": NU}
ALONG, ACROSS = ufl.as_vector([1.0, 0.0, 0.0]), ufl.as_vector([0.0, 1.0, 0.0])
TRANSVERSE = energies.transversely_isotropic_constants(mu=MU, nu=0.3, E_A=8 * MU, G_A=2 * MU)

DOMAINS = ("J > 0", "J ≠ 0", "all F", "I3 > 0", "all F (quadratic), J > 0", "as given")


@dataclass(frozen=True)
class Row:
    """An energy of a family.

    Attributes:
        name: Name in forms.energies.
        domain: Where it is finite, one of DOMAINS.
        psi: The energy to draw, a function of F, of a fiber's direction too where the family has
            fibers; nothing where another row's curve is the same.
        label: Of its curve, if that is not the name.
        same: Energy whose docstring gives the formula or the source that this one's leaves out.
        call: How it is called, if not by its name alone.
    """

    name: str
    domain: str
    psi: Callable | None = None
    label: str = ""
    same: str = ""
    call: str = ""


@dataclass(frozen=True)
class Family:
    """Energies that share a picture and a table.

    Attributes:
        name: Of the picture, energy_NAME.png; nothing without one.
        title: Heading.
        rows: The energies.
        kind: "compressible", "incompressible" (a pressure keeps J = 1), "fibers" or "sheets".
        caption: Parameters of the curves.
        stretches: Ends of the axis of uniaxial and of equibiaxial stretch.
        shear: End of the axis of shear.
        stress: Ends of the axes of stress, P/mu.
    """

    name: str
    title: str
    rows: tuple[Row, ...]
    kind: str = "compressible"
    caption: str = ""
    stretches: tuple[tuple[float, float], tuple[float, float]] = ((0.5, 1.8), (0.6, 1.6))
    shear: float = 1.5
    stress: tuple[float, float] = (-4, 4)


FAMILIES = (
    Family(
        "invariants",
        "In invariants",
        (
            Row("neo_hookean", "J > 0", lambda F: energies.neo_hookean(F, MU, LMBDA)),
            Row(
                "neo_hookean_quadratic",
                "J > 0",
                lambda F: energies.neo_hookean_quadratic(F, MU, LMBDA),
            ),
            Row(
                "saint_venant_kirchhoff",
                "all F",
                lambda F: energies.saint_venant_kirchhoff(F, MU, LMBDA),
            ),
            Row("stable_neo_hookean", "all F", lambda F: energies.stable_neo_hookean(F, MU, LMBDA)),
        ),
        caption="lmbda = 2 mu. `saint_venant_kirchhoff` ends where the thickness is zero",
    ),
    Family(
        "stretches",
        "In singular values",
        (
            Row("fixed_corotated", "all F", lambda F: energies.fixed_corotated(F, MU, LMBDA)),
            Row("corotated_linear", "all F", lambda F: energies.corotated_linear(F, MU, LMBDA)),
            Row("as_rigid_as_possible", "all F", lambda F: energies.as_rigid_as_possible(F, MU)),
            Row("symmetric_dirichlet", "J ≠ 0", lambda F: energies.symmetric_dirichlet(F, MU)),
            Row("hencky", "J > 0", lambda F: energies.hencky(F, MU, LMBDA)),
            Row(
                "extended",
                "all F",
                lambda F: energies.extended(energies.hencky, 0.8)(F, MU, LMBDA),
                label="extended(hencky, below=0.8)",
                call="extended(energy, below)",
            ),
            Row("neo_hookean_stretches", "J > 0", same="neo_hookean"),
            Row("saint_venant_kirchhoff_stretches", "all F", same="saint_venant_kirchhoff"),
            Row("stable_neo_hookean_stretches", "all F", same="stable_neo_hookean"),
        ),
        caption="lmbda = 2 mu where there is a lmbda",
    ),
    Family(
        "incompressible",
        "Isochoric, for incompressible bodies",
        (
            Row("isochoric_neo_hookean", "J > 0", lambda F: energies.isochoric_neo_hookean(F, MU)),
            Row(
                "mooney_rivlin", "J > 0", lambda F: energies.mooney_rivlin(F, 0.35 * MU, 0.15 * MU)
            ),
            Row("yeoh", "J > 0", lambda F: energies.yeoh(F, 0.5 * MU, -0.02 * MU, 0.005 * MU)),
            Row("ogden", "J > 0", lambda F: energies.ogden(F, [0.5 * MU, -0.25 * MU], [3.0, -2.0])),
        ),
        kind="incompressible",
        caption=(
            "c10, c01 = 0.35, 0.15 mu; c1, c2, c3 = 0.5, -0.02, 0.005 mu; "
            "mu_p = 0.5, -0.25 mu with alpha_p = 3, -2"
        ),
        stretches=((0.4, 3.0), (0.5, 2.4)),
        stress=(-5, 7),
    ),
    Family(
        "fibers",
        "With fibers",
        (
            Row(
                "transversely_isotropic_neo_hookean",
                "J > 0",
                lambda F, a: energies.transversely_isotropic_neo_hookean(F, **TRANSVERSE, fiber=a),
            ),
            Row(
                "guccione",
                "all F",
                lambda F, a: (
                    energies.guccione(isochoric(F), MU, 8.0, 2.0, 4.0, a)
                    + energies.volumetric(F, 100 * MU)
                ),
                label="guccione(isochoric(F), …) + volumetric",
            ),
            Row(
                "activated",
                "all F",
                lambda F, a: energies.activated(F, ufl.Identity(3) + 0.25 * ufl.outer(a, a), MU),
            ),
            Row(
                "active_tension",
                "all F",
                lambda F, a: (
                    energies.neo_hookean(F, MU, LMBDA) + energies.active_tension(F, 0.5 * MU, a)
                ),
                label="neo_hookean + active_tension",
            ),
        ),
        kind="fibers",
        caption=(
            "fibers along the pull (lines) and across it in the plane of the shear (dashes); "
            "E_A = 8 mu, G_A = 2 mu, nu = 0.3; C = mu, bf, bt, bfs = 8, 2, 4, kappa = 100 mu; "
            "A = 1.25 along the fibers; Ta = mu/2, lmbda = 2 mu"
        ),
        stretches=((0.7, 1.5), (0.75, 1.4)),
        shear=0.8,
    ),
    Family(
        "sheets",
        "Of sheets",
        (
            Row("neo_hookean_sheet", "I3 > 0", lambda F: energies.neo_hookean_sheet(F, MU)),
            Row(
                "mooney_rivlin_sheet",
                "I3 > 0",
                lambda F: energies.mooney_rivlin_sheet(F, 0.35 * MU, 0.15 * MU),
            ),
            Row(
                "saint_venant_kirchhoff_sheet",
                "all F",
                lambda F: energies.saint_venant_kirchhoff_sheet(F, **SHEET),
            ),
            Row(
                "neo_hookean_tension_field",
                "I3 > 0",
                lambda F: energies.neo_hookean_tension_field(F, MU),
                same="tension_field",
            ),
            Row(
                "saint_venant_kirchhoff_tension_field",
                "all F",
                lambda F: energies.saint_venant_kirchhoff_tension_field(F, **SHEET),
                same="tension_field",
            ),
        ),
        kind="sheets",
        caption="c10, c01 = 0.35, 0.15 mu; nu = 1/3, E = 2 (1 + nu) mu",
        stretches=((0.6, 2.0), (0.7, 1.8)),
        stress=(-2, 4),
    ),
    Family(
        "",
        "Of your own, and parts",
        (
            Row("isotropic", "as given", call="isotropic(F, psi)"),
            Row("principal", "as given", call="principal(psi_hat)"),
            Row("sheet", "as given", call="sheet(F, psi)"),
            Row("tension_field", "as given", call="tension_field(psi_hat, width)"),
            Row("volumetric", "all F (quadratic), J > 0", call="volumetric(F, kappa, law)"),
            Row("with_pressure", "as given", call="with_pressure(psi, F, p, kappa)"),
        ),
    ),
)


def names():
    """Names in forms.energies that are energies: what turns moduli into others is none."""
    moduli = ("lame_from_shear", "lame_from_young", "bulk_modulus")
    constants = ("transversely_isotropic_constants", "transversely_isotropic_constants_five")
    return set(energies.__all__) - {*moduli, *constants}


# --- what docstrings say ------------------------------------------------------------------------

SIGNS = (
    (r"\bsum_([ip])\b", r"Σ_\1"),
    (r"\bprod_i\b", "Π_i"),
    (r"\blmbda\b", "λ"),
    *(
        (rf"\b{word}(?=\b|_[ip]\b)", sign)
        for word, sign in zip(
            ("mu", "nu", "kappa", "alpha", "beta", "gamma"), "μνκαβγ", strict=True
        )
    ),
    (r"_i(?![A-Za-z])", "ᵢ"),
    (r"_p(?![A-Za-z])", "ₚ"),
    (r"\^-2", "⁻²"),
    (r"\^-1(?![/\d])", "⁻¹"),
    (r"\^2", "²"),
    (r"\^3", "³"),
    (r"\^T\b", "ᵀ"),
    (r"(?<=[(<= ^])-(?=[\d\w ()])", "\u2212"),  # the sign, not a hyphen
    (r"\s+", " "),
)


def typeset(text):
    """A docstring's formula in the signs of print, as a cell of a table."""
    for pattern, sign in SIGNS:
        text = re.sub(pattern, sign, text)
    return text.strip().replace("|", "\\|")


def formula(name):
    """What the docstring of an energy says that psi is: from psi to the end of the paragraph.

    Raises:
        ValueError: the docstring has no formula.
    """
    doc = inspect.getdoc(getattr(energies, name)) or ""
    for paragraph in re.split(r"\n\s*\n", doc):
        found = re.search(
            r"psi(?:\([^)=]*\))? = .*|(?:quadratic:|psi \+).*|Energy psi\(I.*", paragraph, re.DOTALL
        )
        if found and not paragraph.startswith(("Args", "Returns", "Source")):
            lines = [line.strip() for line in found[0].splitlines()]
            # A line that goes on with a sum belongs to the one above, another formula does not.
            text = lines[0]
            for line in lines[1:]:
                text += ("; " if re.match(r"\w+ = ", line) and text[-1] not in ";," else " ") + line
            text = re.sub(r" ?\[J/m\^3\]| \(ARAP\)|^psi = |^Energy ", "", text)
            text = re.split(r"(?<=\S)\.(?:\s|$)|;\s+(?:J > 0|infinite|without)", text)[0]
            return re.sub(r"\s+", " ", text)
    raise ValueError(f"the docstring of {name} says nowhere what psi is: write psi = … there.")


def source(name):
    """Source that the docstring of an energy names: its first sentence; nothing without one."""
    doc = inspect.getdoc(getattr(energies, name)) or ""
    found = re.search(r"^Source: (.*(?:\n(?!\n).+)*)", doc, re.MULTILINE)
    text = re.sub(r"\s+", " ", found[1]) if found else ""
    return re.split(r"; |: |\.$|\. (?=The )", text)[0]


def _formula_cell(row):
    if row.psi is None and row.same:
        return f"that of `{row.same}`, to compare the two ways"
    return typeset(formula(row.name))


def _source_cell(row):
    return typeset(source(row.name) or (source(row.same) if row.same else ""))


# --- which tests use them -----------------------------------------------------------------------


def used_in(text):
    """Energies that Python code uses, as energies.NAME, and what it takes of what tests share."""
    tree, found, taken = ast.parse(text), set(), set()
    chosen = "getattr(energies, " in text  # by a name in quotes
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute):
            base = getattr(node.value, "attr", getattr(node.value, "id", ""))
            if base == "energies":
                found.add(node.attr)
            taken.add((base, node.attr))
        elif isinstance(node, ast.ImportFrom):
            inside = {alias.name for alias in node.names}
            found |= inside if node.module == "forms.energies" else set()
            taken |= {(node.module, name) for name in inside}
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            found |= {node.value} if chosen else set()
            # A script to run.
            found.update(re.findall(r"\benergies\.(\w+)", node.value))
            taken.update(re.findall(r"\b(scenes)\.(\w+)", node.value))
    return found & names(), taken


def shared():
    """Energies that stand in tests/*.py for several test files, by the module and what has them."""
    found = {}
    for file in (ROOT / "tests").glob("*.py"):
        if file.name.startswith(("test_", "conftest")):
            continue
        for node in ast.parse(file.read_text()).body:
            if isinstance(node, ast.Assign) and isinstance(node.value, ast.Dict):
                found[file.stem, node.targets[0].id] = used_in(ast.unparse(node))[0]
            elif isinstance(node, ast.FunctionDef | ast.ClassDef):
                found[file.stem, node.name] = used_in(ast.unparse(node))[0]
    return found


def tests():
    """For each energy the test files that use it, by name or through what several of them share."""
    groups, found = shared(), {name: [] for name in names()}
    for file in sorted((ROOT / "tests").glob("test_*.py")):
        used, taken = used_in(file.read_text())
        for name in used.union(*(groups.get(what, ()) for what in taken)):
            found[name].append(file.stem.removeprefix("test_"))
    return found


# --- the table ----------------------------------------------------------------------------------


def lines():
    """Lines of forms/README.md: each family with its picture and its table."""
    used, out = tests(), []
    for family in FAMILIES:
        out += [f"### {family.title}", ""]
        if family.name:
            picture = f"../demos/figures/energy_{family.name}.png"
            what = "Uniaxial, equibiaxial and shear response of energies"
            out += [f"![{what}: {family.title.lower()}]({picture})", "", f"{_caption(family)}", ""]
        table = [
            [
                f"`{row.call or row.name}`",
                _formula_cell(row),
                row.domain,
                _source_cell(row),
                ", ".join(used[row.name]),
            ]
            for row in family.rows
        ]
        out += [*markdown(("Function", "psi", "Defined for", "Source", "Tests"), table), ""]
    return out[:-1]


def _caption(family):
    free = "a pressure keeps J = 1" if family.kind == "incompressible" else "nothing acts sideways"
    given = typeset(family.caption)
    return f"Nominal stress over stretch, where {free}, and over simple shear: {given}."
