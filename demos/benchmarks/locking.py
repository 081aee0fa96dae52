# SPDX-License-Identifier: MIT
"""Locking: which element for which Poisson's ratio.

Two bodies, nu from 0.3 to 0.499999: Cook's panel in plane strain under its dead force (rise of the
corner), and a cantilever 4 x 1 x 1 pulled sideways at its end (deflection of a corner). Elements
P1, P2, Q1, Q2 with the displacement alone, P2-P1 and Q2-Q1 with a pressure. Energies: isochoric
neo-Hookean, and Ogden's (an energy in singular values), both with kappa/2 (J - 1)^2. The error is
relative to P2-P1 or Q2-Q1 on the finest mesh, for each nu its own. Run ``docker/enter python3 -m
demos.benchmarks.locking`` (``--small``: toy sizes); one JSON line per row, ``results/locking.csv``
``results/locking.png`` and ``.svg``; ``--write`` puts the table into README.md. One process only.
"""

import sys

from mpi4py import MPI

import ufl
from matplotlib.figure import Figure

from variform import forms, meshes
from variform.forms import energies

from .record import Table, insert, markdown, save

MU = 80.1938
NUS = (0.3, 0.4, 0.45, 0.49, 0.499, 0.4999, 0.49999, 0.499999)
ELEMENTS = ("P1", "P2", "Q1", "Q2", "P2-P1", "Q2-Q1")
# Cells across for elements of degree 1 (degree 2: half as many, so that unknowns compare), and of
# degree 2 for the reference.
SCENES = ("Cook", "neo-Hookean"), ("cantilever", "neo-Hookean"), ("Cook", "Ogden")
SIZES = {"Cook": (16, 32), "cantilever": (4, 5)}
STYLES = {"P1": "s--", "Q1": "D--", "P2": "^-", "Q2": "v-", "P2-P1": "o-", "Q2-Q1": "x-"}


def bulk_modulus(nu):
    """Kappa of a Poisson's ratio at rest."""
    return 2 * MU * (1 + nu) / (3 * (1 - 2 * nu))


# Both isochoric, with the shear modulus MU at rest.
ENERGIES = {
    "neo-Hookean": lambda F: energies.isochoric_neo_hookean(F, MU),
    "Ogden": lambda F: energies.ogden(F, [1.2 * MU, 0.1 * MU], [1.3, 4.4]),
}


def unknown(body, element, psi, kappa):
    """Unknown, displacement, energy density."""
    if "-" in element:
        w = forms.displacement_pressure(body)
        u, p = ufl.split(w)
        F = forms.deformation_gradient(u)
        return w, u, energies.with_pressure(psi(F), F, p, kappa)
    u = forms.displacement(body, int(element[1]))
    F = forms.deformation_gradient(u)
    return u, u, psi(F) + energies.volumetric(F, kappa)


def deflection(scene, element, n, nu, energy="neo-Hookean"):
    """Displacement [mm] of the point that is looked at, and the number of unknowns."""
    quads = element[0] == "Q"
    if scene == "Cook":
        cells = "quadrilateral" if quads else "triangle"
        body = meshes.cook(MPI.COMM_SELF, n=n, cells=cells)
        end, force, point = "right", (0, 100 / 16), (48, 60)
    else:
        cells = "hexahedron" if quads else "tetrahedron"
        size = (4.0, 1.0, 1.0)
        body = meshes.block(MPI.COMM_SELF, size, n=(4 * n, n, n), cells=cells)
        end, force, point = "right", (0, 0, 0.01 * MU), size
    t = forms.load_factor(body)
    w, u, psi = unknown(body, element, ENERGIES[energy], bulk_modulus(nu))
    load = forms.dead_traction(u, ufl.as_vector([t * f for f in force]), body.ds(end))
    held = [forms.clamp(w, body.facets("left"))]
    path = forms.follow(psi * ufl.dx + load, w, held, t, step=0.5, progress=False)
    return float(forms.at(forms.displacement_of(w), point)[-1]), path.problem.size


def measured(scene, nu, energy, elements, small):
    """Rows of one body, energy and nu, with errors against the reference."""
    n, finest = (2, 3) if small else SIZES[scene]
    best = "P2-P1" if scene == "Cook" else "Q2-Q1"
    reference, _ = deflection(scene, best, finest, nu, energy)
    for element in elements:
        across = n if element in ("P1", "Q1") else n // 2
        value, size = deflection(scene, element, across, nu, energy)
        yield {
            "scene": scene,
            "energy": energy,
            "element": element,
            "nu": nu,
            "dofs": size,
            "deflection": round(value, 6),
            "reference": round(reference, 6),
            "error": float(f"{abs(value / reference - 1):.3g}"),
        }


def picture(rows):
    """Error over 1/2 - nu, a panel for each body and energy."""
    panels = list(dict.fromkeys((row["scene"], row["energy"]) for row in rows))
    figure = Figure((4.2 * len(panels), 4.2), 150, layout="constrained")
    for axes, (scene, energy) in zip(
        figure.subplots(1, len(panels), sharey=True), panels, strict=True
    ):
        for n, (element, style) in enumerate(STYLES.items()):
            chosen = [r for r in rows if (r["scene"], r["energy"]) == (scene, energy)]
            chosen = [r for r in chosen if r["element"] == element]
            if chosen:
                x, y = zip(*((0.5 - r["nu"], r["error"]) for r in chosen), strict=True)
                axes.loglog(x, y, style, color=f"C{n}", label=element)
        axes.set(title=f"{scene}, {energy}", xlabel="1/2 - nu")
        axes.invert_xaxis()
        axes.grid(alpha=0.3)
    figure.axes[0].set_ylabel("relative error of the deflection")
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside right upper")
    save(figure, "locking")


def table(rows):
    """Errors in percent, a line for each body, energy and element."""
    nus = list(dict.fromkeys(row["nu"] for row in rows))
    lines = []
    for kind in dict.fromkeys((r["scene"], r["energy"], r["element"], r["dofs"]) for r in rows):
        found = [r for r in rows if (r["scene"], r["energy"], r["element"], r["dofs"]) == kind]
        scene, energy, element, dofs = kind
        errors = [f"{100 * r['error']:.2g}" for r in found]
        lines.append([f"{scene}, {energy}", element, f"{dofs:,}", *errors])
    return markdown(["body, energy", "element", "dofs", *(f"{nu:g}" for nu in nus)], lines)


def main(small=False, write=False):
    """Measure, print and write the table and the picture."""
    nus = (0.3, 0.4999) if small else NUS
    measurements = Table("locking")
    for scene, energy in SCENES:
        elements = ("P2-P1", "Q2-Q1") if energy == "Ogden" else ELEMENTS
        for nu in nus:
            for row in measured(scene, nu, energy, elements, small):
                measurements.add(**row)
    measurements.write()
    picture(measurements.rows)
    if write:
        insert("locking", table(measurements.rows))
    return measurements.rows


if __name__ == "__main__":
    main(small="--small" in sys.argv, write="--write" in sys.argv)
