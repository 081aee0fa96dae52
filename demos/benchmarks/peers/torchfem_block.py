# SPDX-License-Identifier: MIT
"""The block in torch-fem: its hyperelastic solid, differentiated by torch, and its own solver.

It scales prescribed displacements in proportion, so its three steps go to the end along straight
lines, not along arcs; where that turns cells inside out it halves its steps by itself. ln J is
written as its documentation wants it.
"""

from importlib import metadata

import numpy as np
import torch
import torchfem.sparse
from torchfem import Solid
from torchfem.materials import Hyperelastic3D

from .newton import medians
from .problem import (
    LMBDA,
    MU,
    STEPS,
    Clock,
    arguments,
    bent,
    block,
    quadratic,
    report,
    tolerance,
    turned,
)


def energy(F, moduli):
    """Neo-Hookean energy of one deformation gradient."""
    C = F.transpose(-1, -2) @ F
    log_J = torch.logdet(C) / 2
    return moduli[0] / 2 * (torch.trace(C) - 3) - moduli[0] * log_J + moduli[1] / 2 * log_J**2


def main():
    """Solve, or assemble, and print the row."""
    given = arguments(solver=("direct", "cg"))
    torch.set_num_threads(1)
    torch.set_default_dtype(torch.float64)
    clock = Clock()
    points, cells = block(given.m)
    vertices, smallest = len(points), tolerance(points)
    if given.degree == 2:
        points, cells = quadratic(points, cells)
    body = Solid(torch.tensor(points), torch.tensor(cells), Hyperelastic3D(energy, [MU, LMBDA]))
    about = {"dofs": points.size, "version": metadata.version("torch-fem"), "solver": given.solver}
    if given.assemble:
        report("torch-fem", given, Clock(), **about, **assemble(given.assemble, body, points))
        return
    ends = [np.isclose(points[:, 0], at) for at in (0, 1)]
    moved = np.zeros_like(points)
    moved[ends[1]] = turned(points[ends[1]], given.steps / STEPS)
    body.displacements = torch.tensor(moved)
    body.constraints = torch.tensor(np.repeat((ends[0] | ends[1])[:, None], 3, axis=1))
    norms, systems, solve = [], [], torchfem.sparse.sparse_solve
    original = body._residual

    def residual(*parts):
        with clock("assembly"):
            R, K = original(*parts)
        norms.append(float(torch.linalg.norm(R)))
        return R, K

    def timed(*parts, **named):
        systems.append(len(norms))
        with clock("linear"):
            return solve(*parts, **named)

    body._residual, torchfem.sparse.sparse_solve = residual, timed
    with clock("solve loop"):
        u, *_ = body.solve(
            increments=torch.linspace(0, 1, given.steps + 1),
            rtol=0.0,
            atol=smallest,
            method=given.solver,
        )
    about |= {"Newton": [len(systems)], "residual": norms[-1], "tolerance": smallest}
    values = u.detach().numpy()[:vertices]
    report(f"torch-fem {given.solver}", given, clock, values, **about)


def assemble(times, body, points):
    """Median CPU seconds of residual and tangent at a bent state."""
    u = torch.tensor(bent(points))
    body.K = torch.empty(0)  # as its solver does
    cells = (body.n_int, body.n_elem)
    shape = (*cells, *body.n_flux)
    rest = (torch.zeros_like(u), body.initial_grad.expand(shape), torch.zeros(shape))
    state = torch.zeros(*cells, body.n_state)
    none = torch.zeros(0, dtype=torch.int64)

    def integrate(stiffness):
        return body.integrate_material(
            *rest,
            state,
            u.ravel(),
            torch.zeros_like(body._external_gradient),
            0,
            compute_stiffness=stiffness,
        )

    def residual():
        body.assemble_rhs(integrate(False)[1])

    def tangent():
        body.assemble_matrix(integrate(True)[0], none)

    return medians(times, residual=residual, tangent=tangent)


if __name__ == "__main__":
    main()
