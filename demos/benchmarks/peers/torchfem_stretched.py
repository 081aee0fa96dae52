# SPDX-License-Identifier: MIT
"""The pulled box in torch-fem, with its own defaults: CG, multigrid by pyamg, tolerances.

Each Newton solve of its path is differentiated implicitly, and the chain of them backwards: an
adjoint system for each step, with the multigrid of that step's first iteration.
"""

from importlib import metadata

import torch
import torchfem.sparse
from torchfem import Solid
from torchfem.materials import Hyperelastic3D
from torchfem.mesh import cube_hexa

from .problem import Clock
from .stretched import LMBDA, MU, STRETCH, arguments, factors, report
from .torchfem_block import energy


def main():
    """Solve, differentiate, and print the row."""
    given = arguments()
    torch.set_num_threads(1)
    torch.set_default_dtype(torch.float64)
    thick, clock, systems = 4 / given.n, Clock(), []
    points, cells = cube_hexa(5, given.n + 1, given.n + 1, thick, 1.0, 1.0)
    moduli = torch.tensor([MU, LMBDA], requires_grad=True)
    body = Solid(points, cells, Hyperelastic3D(energy, moduli))
    left, right = (torch.isclose(points[:, 0], torch.tensor(x)) for x in (0.0, thick))
    body.constraints[left | right, 0] = True
    for axis in (1, 2):
        body.constraints[torch.isclose(points[:, axis], torch.tensor(0.5)), axis] = True
    body.displacements[right, 0] = (STRETCH - 1) * thick
    solve = torchfem.sparse.sparse_solve

    def counted(*parts, **named):
        found = solve(*parts, **named)
        systems.append(found[-1])
        return found

    torchfem.sparse.sparse_solve = counted
    with clock("forward"):
        _, forces, *_ = body.solve(
            increments=torch.tensor([0.0, *factors()]), differentiable_parameters=moduli
        )
        force = forces[right, 0].sum()
    about = {"dofs": points.numel(), "Newton": len(systems), "CG forward": sum(systems)}
    systems.clear()
    with clock("backward"):
        force.backward()
    about |= {"adjoint systems": len(systems), "CG backward": sum(systems)}
    found = [force.item(), *moduli.grad.tolist()]
    report("torch-fem", given, found, clock, version=metadata.version("torch-fem"), **about)


if __name__ == "__main__":
    main()
