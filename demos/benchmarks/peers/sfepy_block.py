# SPDX-License-Identifier: MIT
"""The block in SfePy, which has no compressible neo-Hookean law: written here as a term of its own.

SfePy assembles; Newton's steps are those of :mod:`.newton`, since SfePy's own put the prescribed
values of a step in at once, which turns cells inside out here.
"""

from typing import ClassVar

import numpy as np
import sfepy
from sfepy.base.base import output
from sfepy.discrete import Equation, Equations, FieldVariable, Integral, Material, Problem
from sfepy.discrete.fem import FEDomain, Field, Mesh
from sfepy.terms import Term, register_term
from sfepy.terms.terms_hyperelastic_tl import HyperElasticTLBase

from .newton import linear, medians, newton
from .problem import LMBDA, MU, Clock, arguments, bent, block, report, tolerance, turned

# Places of xx, yy, zz, xy, xz, yz, in which SfePy stores symmetric tensors.
FIRST, SECOND = np.array([[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]])
UNIT = np.array([1.0, 1, 1, 0, 0, 0])


class NeoHookean(HyperElasticTLBase):
    """S = mu (I - C^-1) + lmbda ln J C^-1."""

    name = "dw_tl_he_neohook_ln"
    arg_shapes: ClassVar = {"material": "1, 2", "virtual": ("D", "state"), "state": "D"}
    family_data_names = ("det_f", "sym_inv_c")

    @staticmethod
    def stress_function(out, moduli, J, inverse, **_):
        """Second Piola-Kirchhoff stress (cells, points, 6, 1)."""
        mu, lmbda = moduli[..., 0, 0, None], moduli[..., 0, 1, None]
        inverse = inverse[..., 0]
        out[..., 0] = mu * (UNIT - inverse) + lmbda * np.log(J[..., 0]) * inverse

    @staticmethod
    def tan_mod_function(out, moduli, J, inverse, **_):
        """2 dS/dC (cells, points, 6, 6)."""
        mu, lmbda = moduli[..., 0, :1, None], moduli[..., 0, 1:, None]
        inverse = inverse[..., 0]
        full = np.empty((*inverse.shape[:-1], 3, 3))
        full[..., FIRST, SECOND] = full[..., SECOND, FIRST] = inverse
        i, j, k, m = FIRST[:, None], SECOND[:, None], FIRST, SECOND
        product = full[..., i, k] * full[..., j, m] + full[..., i, m] * full[..., j, k]
        out[...] = lmbda * inverse[..., :, None] * inverse[..., None, :]
        out += (mu - lmbda * np.log(J)) * product


register_term(NeoHookean)


def main():
    """Solve, or assemble, and print the row."""
    given = arguments(solver=("pardiso", "superlu"))
    output.set_output(quiet=True)
    clock = Clock()
    points, cells = block(given.m)
    groups = [np.zeros(len(part), dtype=np.int32) for part in (points, cells)]
    mesh = Mesh.from_data(
        "block", points, groups[0], [cells.astype(np.int32)], [groups[1]], ["3_4"]
    )
    body = FEDomain("body", mesh).create_region("body", "all")
    field = Field.from_args("displacement", np.float64, "vector", body, approx_order=given.degree)
    u = FieldVariable("u", "unknown", field)
    v = FieldVariable("v", "test", field, primary_var_name="u")
    integral, rubber = Integral("i", order=given.degree), Material("m", moduli=[[MU, LMBDA]])
    term = Term.new(f"{NeoHookean.name}(m.moduli, v, u)", integral, body, m=rubber, v=v, u=u)
    equations = Equations([Equation("balance", term)])
    problem = Problem("block", equations=equations)
    problem.set_bcs()
    problem.time_update()
    problem.update_materials()
    equations.variables.init_state()
    matrix = equations.create_matrix_graph()

    def tangent(u):
        matrix.data[:] = 0.0
        return equations.eval_tangent_matrices(u, matrix)

    def residual(u):
        return equations.eval_residuals(u).copy()

    places = field.get_coor()
    about = {"dofs": places.size, "version": sfepy.__version__, "solver": given.solver}
    if given.assemble:
        u = bent(places).ravel()
        row = medians(given.assemble, residual=lambda: residual(u), tangent=lambda: tangent(u))
        report("SfePy", given, Clock(), **about, **row)
        return
    left, right = (np.flatnonzero(np.isclose(places[:, 0], at)) for at in (0, 1))
    fixed = (3 * np.concatenate([left, right])[:, None] + np.arange(3)).ravel()

    def prescribed(load):
        return np.concatenate([np.zeros(3 * len(left)), turned(places[right], load).ravel()])

    smallest, solve = tolerance(points), linear(given.solver, clock)
    with clock("solve loop"):
        u, iterations, norm = newton(
            residual, tangent, fixed, prescribed, places.size, given, clock, solve, smallest
        )
    about |= {"Newton": iterations, "residual": norm, "tolerance": smallest}
    report(f"SfePy {given.solver}", given, clock, u.reshape(-1, 3)[: len(points)], **about)


if __name__ == "__main__":
    main()
