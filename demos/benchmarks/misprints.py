# SPDX-License-Identifier: MIT
"""What the misprints of document 003 cost: Newton's iterations with exact and printed tangents.

Two stacked hexahedra: the bottom held, the top moved 40 % up and 20 % sideways in 4 steps, the
middle layer free; iterations per step until |R| < 1e-10. Run ``docker/enter python3 -m
demos.benchmarks.misprints``; one JSON line per row, and ``results/misprints.csv``; ``--write`` puts
the table into forms/formulas/README.md. NumPy alone, by :mod:`forms.formulas`.
"""

import sys
from pathlib import Path

import numpy as np

from variform.forms.formulas import element, materials, quadrature, shapes

from .record import Table, insert, markdown

PAGE = Path(__file__).resolve().parents[2] / "forms" / "formulas" / "README.md"
MU, LMBDA = 1.3, 2.1
AXIS = np.array([0.8, 0.6, 0.0])
CONSTANTS = materials.transversely_isotropic_constants(mu=1.3, nu=0.27, E_A=9.0, G_A=0.8)
TOLERANCE, MOST = 1e-10, 60


def neo_hookean(as_printed):
    """Stress (18) and the tangent (19) with the moduli (20)."""
    return (
        lambda F: materials.neo_hookean_cauchy(F, MU, LMBDA),
        lambda F: materials.neo_hookean_elasticity(F, MU, LMBDA, as_printed),
    )


def fibers(volume, identity, tensor):
    """Stress (23) and the tangent (24) with each of its three errors as printed (True) or not."""

    def elasticity(F):
        c = materials.transversely_isotropic_elasticity(F, AXIS, CONSTANTS)
        J = np.linalg.det(F)[..., None, None, None, None]
        a, b = F @ AXIS, F @ np.swapaxes(F, -1, -2)
        mu, lmbda, alpha, beta, _ = CONSTANTS
        square = np.einsum("...i,...i->...", a, a)[..., None, None, None, None]
        first = mu - lmbda * J * (J - 1)
        factor = mu - lmbda * J * (2 * J - 1) if volume else first
        right, printed = (materials.fourth_order_identity(p) for p in (False, identity))
        change = 2 / J * (factor * printed - first * right)
        change = change - 4 * beta / J * (square - 1) * (printed - right)
        lost = materials.fiber_tensor(a, b, tensor) - materials.fiber_tensor(a, b)
        return c + change - alpha / J * lost

    return lambda F: materials.transversely_isotropic_cauchy(F, AXIS, CONSTANTS), elasticity


ROWS = {
    ("exact", "neo-Hookean (16)"): neo_hookean(False),
    ("(20) as printed, lambda' = mu / J", "neo-Hookean (16)"): neo_hookean(True),
    ("exact", "transversely isotropic (21)"): fibers(False, False, False),
    ("(24) as printed", "transversely isotropic (21)"): fibers(True, True, True),
    ("(24), the factor of i corrected", "transversely isotropic (21)"): fibers(False, True, True),
    ("(24), factor and i corrected", "transversely isotropic (21)"): fibers(False, False, True),
}


class Stack:
    """Two unit cubes on top of each other, each a hex8 with 2x2x2 points."""

    def __init__(self):
        layers = [shapes.NODES["hex8"][:4, :2] / 2 + 0.5]
        self.X = np.concatenate([np.c_[layers[0], np.full(4, float(z))] for z in range(3)])
        self.cells = np.array([np.arange(8), np.arange(4, 12)])
        points, self.weights = quadrature.hexahedron(2)
        self.dN = shapes.shape_gradients("hex8", points)
        self.G0, _ = element.gradients(self.dN, self.X[self.cells])

    def system(self, x, material):
        """Residual T and its tangent at nodes x."""
        sigma, c = material
        G, det = element.gradients(self.dN, x[self.cells])
        F, dv = element.deformation_gradient(x[self.cells], self.G0), self.weights * det
        D = materials.voigt_elasticity(c(F))
        T = element.internal_force(sigma(F), G, dv)
        K = element.element_tangent(G, D, sigma(F), dv)
        nodes = len(self.X)
        return (
            element.assemble_vector(T, self.cells, nodes),
            element.assemble_matrix(K, self.cells, nodes),
        )

    def iterations(self, material, steps=4):
        """Newton's iterations of each step; an empty list where one fails."""
        x, free, counts = self.X.copy(), np.arange(12, 24), []
        for _ in range(steps):
            x[8:] += np.array([0.2 * 2, 0.0, 0.4 * 2]) / steps
            for count in range(MOST + 1):
                try:
                    T, K = self.system(x, material)
                except ValueError:  # an element inside out
                    return []
                if np.linalg.norm(T[free]) < TOLERANCE:
                    counts.append(count)
                    break
                if count == MOST:
                    return []
                x.ravel()[free] -= np.linalg.solve(K[np.ix_(free, free)], T[free])
        return counts


def main(write=False):
    """Run, print and write the table."""
    table = Table("misprints")
    for (tangent, name), material in ROWS.items():
        counts = ", ".join(map(str, Stack().iterations(material))) or "fails"
        table.add(tangent=tangent, material=name, **{"iterations per step": counts})
    table.write()
    if write:
        columns = ["Tangent", "Material", "Iterations per step"]
        insert("newton", markdown(columns, [row.values() for row in table.rows]), PAGE)
    return table.rows


if __name__ == "__main__":
    main(write="--write" in sys.argv)
