# SPDX-License-Identifier: MIT
"""variform as the README does it: no option, its own tests of convergence, which are stricter.

``--solver same-residual`` stops at the absolute residual that the others are held to;
``--solver one-step`` goes to the end in one step instead of three; ``--solver reference`` solves to
a residual of 1e-12 of the forces.
"""

import time
from importlib import metadata

import numpy as np
import ufl

from variform import forms
from variform.forms import energies

from .fenicsx import COMM, at_vertices, create
from .problem import (
    LMBDA,
    MU,
    STEPS,
    STRETCH,
    TWIST,
    Clock,
    arguments,
    bent,
    block,
    report,
    tolerance,
)


def main():
    """Solve, or assemble, and print the row."""
    given = arguments(
        solver=("default", "same-residual", "one-step", "reference"),
        energy=("neo_hookean", "fixed_corotated"),
    )
    clock = Clock()
    body, left, right = create(given.m)
    t = forms.load_factor(body)
    u = forms.displacement(body, given.degree)
    F = forms.deformation_gradient(u)
    potential = getattr(energies, given.energy)(F, MU, LMBDA) * ufl.dx
    fixed = forms.clamp(u, left)
    twist = forms.rotate(u, right, angle=TWIST * t, axis=(1, 0, 0), shift=(STRETCH * t, 0, 0))
    about = {"dofs": u.function_space.dofmap.index_map.size_global * 3, "ranks": COMM.size}
    about |= {"version": metadata.version("fenics-dolfinx"), "solver": given.solver}
    if given.assemble:
        row = assemble(given.assemble, forms.Problem(potential, u, [fixed, twist]), u)
        if COMM.rank == 0:
            report(f"variform {given.energy}", given, Clock(), **about, **row)
        return
    options = {"same-residual": {"snes_atol": tolerance(block(given.m)[0])}}
    first = 1 if given.solver == "one-step" else 1 / STEPS
    tight = {"rtol": 1e-12} if given.solver == "reference" else {}
    with clock("compile"):
        forms.Problem(potential, u, [fixed, twist])
    with clock("set-up"):  # as the path below does it again, everything being in the cache
        forms.Problem(potential, u, [fixed, twist])
    with clock("solve loop"):
        path = forms.follow(
            potential,
            u,
            [fixed, twist],
            t,
            to=given.steps / STEPS,
            step=first,
            max_step=first,
            options=options.get(given.solver),
            progress=False,
            **tight,
        )
    for seconds in (clock.cpu, clock.wall):
        seconds["solve loop"] -= seconds["set-up"]
    ends = [step.convergence for step in path.steps]
    values = at_vertices(u)
    if COMM.rank == 0:
        row = {
            "Newton": [end.iterations for end in ends],
            "linear": [end.linear_iterations for end in ends],
            "residual": ends[-1].residual,
            "tolerance": tolerance(block(given.m)[0]),
        }
        report(f"variform {given.solver}", given, clock, values, **about, **row)


def assemble(times, system, u):
    """Median CPU seconds of residual and tangent at a bent state, supports in."""
    u.interpolate(lambda x: bent(x.T).T)
    A, b = system.create_matrix(), system.create_vector()
    seconds = {"residual": [], "tangent": []}
    for _ in range(times):
        for name, work in (("residual", system.residual), ("tangent", system.tangent)):
            start = time.process_time()
            work(b if name == "residual" else A)
            seconds[name].append(time.process_time() - start)
    return {f"{name}, once [s]": float(np.median(t)) for name, t in seconds.items()}


if __name__ == "__main__":
    main()
