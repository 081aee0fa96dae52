# SPDX-License-Identifier: MIT
"""The pulled box in variform, with its own defaults; compiled by a first path."""

from demos.benchmarks.sensitivities import box
from variform import forms

from .problem import Clock
from .stretched import arguments, report


def main():
    """Solve, differentiate, and print the row."""
    given, clock = arguments(), Clock()
    problem, t, loads, force, moduli = box(given.n)

    def forward():
        t.value = problem.u.x.array[:] = 0.0
        return forms.follow(problem, t=t, to=loads, step=loads[0], progress=False)

    forms.gradient(forward(), force, moduli)
    with clock("forward"):
        path = forward()
        value = force(path)
    with clock("backward"):
        found = forms.gradient(path, force, moduli)
    told = [step.convergence for step in path.steps]
    about = {"dofs": problem.size, "Newton": sum(c.iterations for c in told)}
    about["CG forward"] = sum(c.linear_iterations for c in told)
    report("variform", given, [value, *found], clock, **about)


if __name__ == "__main__":
    main()
