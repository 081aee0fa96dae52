# SPDX-License-Identifier: MIT
"""Derivatives where UFL has none: slack fibers, branches, powers below 2 at zero."""

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from cases import unit_mesh
from dolfinx import fem

from variform import forms, meshes

SLACK = {
    "max_value": lambda x: ufl.max_value(x, 0) ** 1.5,
    "scaled": lambda x: 2**1.5 * (ufl.max_value(0, x) / 2) ** 1.5,
    "conditional": lambda x: ufl.conditional(ufl.gt(x, 0), x, 0) ** 1.5,
    "conditional, >=": lambda x: ufl.conditional(ufl.ge(x, 0), x, 0) ** 1.5,
    "root": lambda x: ufl.sqrt(ufl.max_value(x, 0) ** 3),
    "|x|": lambda x: ((x + abs(x)) / 2) ** 1.5,
}


def fibered(power, n=2):
    """Unit cube between rollers, pressed along its fiber to 0.9; lateral faces free."""
    body = meshes.block(MPI.COMM_WORLD, (1.0, 1.0, 1.0), n=(n, n, n))
    u, t = forms.displacement(body), forms.load_factor(body)
    F = forms.deformation_gradient(u)
    I4, _ = forms.kinematics.fiber_invariants(F, ufl.as_vector([1, 0, 0]))
    psi = forms.energies.neo_hookean(F, 1.0, 10.0) + power(I4 - 1)
    sides = ("left", "front", "bottom")
    held = [forms.roller(u, body.facets(name), axis) for axis, name in enumerate(sides)]
    held.append(forms.translate(u, body.facets("right"), (-0.1 * t, None, None)))
    return body, psi * ufl.dx, u, held, t


@pytest.mark.parametrize("call", ["solve", "follow"])
@pytest.mark.parametrize("case", SLACK)
def test_a_slack_fiber_has_a_tangent(case, call):
    """Powers below 2 of what is 0 in compression, inf * 0 for UFL: the fiber is slack.

    The cube is that without one: mu (s^2 - 1) + lmbda ln(0.9 s^2) = 0, lateral stretch s.
    """
    body, potential, u, held, t = fibered(SLACK[case])
    if call == "solve":
        t.value = 1.0
        path = forms.solve(potential, u, held)
    else:
        path = forms.follow(potential, u, held, t, progress=False)
    s = 1 + forms.at(u, (1.0, 1.0, 1.0))[1]
    assert s == pytest.approx(1.0488326289, abs=1e-9)
    assert s**2 - 1 + 10 * np.log(0.9 * s**2) == pytest.approx(0, abs=1e-9)
    force, _ = forms.resultant(path, body.facets("right"))
    assert abs(force[0]) == pytest.approx(0.3222776482, abs=1e-9)


def test_branches_are_moved_out_of_powers_only_where_they_must():
    """Whole powers, exponentials and powers of other things stay what they are; values stay."""
    from variform.forms.differentiation import with_branches_outside

    mesh = unit_mesh(2)
    x = fem.Constant(mesh, 0.0)
    for kept in (ufl.max_value(x, 0) ** 2, ufl.exp(ufl.max_value(x, 0)), x**1.5, abs(x)):
        assert with_branches_outside(kept) == kept
    moved = [
        (ufl.max_value(2 * x, x / 3) ** 1.5, lambda v: max(2 * v, v / 3) ** 1.5 if v > 0 else None),
        (ufl.min_value(x, 1) ** 0.5, lambda v: min(v, 1) ** 0.5 if v > 0 else None),
        (ufl.sqrt(3 + abs(x)), lambda v: np.sqrt(3 + abs(v))),
        ((x + abs(x)) ** 1.5, lambda v: (v + abs(v)) ** 1.5),
        ((abs(x) - x) ** 1.5, lambda v: (abs(v) - v) ** 1.5),
        (ufl.conditional(ufl.lt(x, 0), 5, 1 + x) ** 1.5, lambda v: (5 if v < 0 else 1 + v) ** 1.5),
    ]
    for expression, right in moved:
        other = with_branches_outside(expression)
        assert isinstance(other, ufl.classes.Conditional)
        for value in (-2.0, -0.5, 0.0, 0.5, 2.0):
            wanted = right(value)
            if wanted is not None:
                assert other((), mapping={x: value}) == pytest.approx(wanted, rel=1e-15)


@pytest.mark.parametrize("call", ["solve", "follow", "arc_length", "negative_eigenvalues"])
def test_a_second_derivative_that_is_infinite_is_named(call):
    """|x|**1.5 at x = 0: the summand, the place, and what to do; nothing of PETSc's own."""
    body, potential, u, held, t = fibered(lambda x: abs(x) ** 1.5)
    place = r"\(0\.\d+, 0\.\d+, 0\.\d+\)"
    named = rf"the second derivative of the summand .*1\.5.* is not finite at {place}"
    with pytest.raises((forms.NotConverged, ValueError), match=named) as failed:
        if call == "solve":
            t.value = 1.0
            forms.solve(potential, u, held)
        elif call == "follow":
            forms.follow(potential, u, held, t, progress=False)
        elif call == "arc_length":
            load = forms.dead_traction(u, ufl.as_vector([t, 0, 0]), body.ds("right"))
            forms.arc_length(potential + load, u, held[:3], t, step=0.1, progress=False)
        else:
            forms.negative_eigenvalues(forms.Problem(potential, u, held))
    assert "Write the energy so that its second derivative exists there" in str(failed.value)
    assert "in steps" not in str(failed.value)
    assert np.all(u.x.array == 0)
