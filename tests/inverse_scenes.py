# SPDX-License-Identifier: MIT
"""Small bodies with parameters of every kind, for the laws of gradients and of fits."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import ufl
from dolfinx import fem

from variform import forms, meshes

TIGHT = {"rtol": 1e-13, "ctol": 1e-11}


class Scene(NamedTuple):
    """A body that is solved anew for other parameters.

    Attributes:
        solve: Function that solves and returns the path.
        measured: What is differentiated, by name.
        parameters: Parameters by name, each with a direction: of a Constant numbers, of a Function
            or a support a function of points.
    """

    solve: object
    measured: dict
    parameters: dict


def wave(components=1):
    """A smooth function of points."""
    rows = (lambda x: np.sin(2 * x[0] + 1) + 0.5 * np.cos(3 * x[1]), lambda x: x[0] * x[1] - 0.3)
    picked = [rows[k % 2] for k in range(components)]
    return lambda x: picked[0](x) if components == 1 else np.array([f(x) for f in picked])


def field(body, element, value, name):
    f = fem.Function(fem.functionspace(body.mesh, element), name=name)
    f.interpolate(value) if callable(value) else f.x.array.__setitem__(slice(None), value)
    return f


def solid(comm, energy, body=None):
    """A cube pulled and loaded: Constants, moduli by cell, a load factor, a support's values."""
    body = body or meshes.block(comm, (1.0, 1.0, 1.0), n=(2, 2, 2))
    u, t = forms.displacement(body), forms.load_factor(body, 1.0)
    F, mesh = forms.deformation_gradient(u), body.mesh
    mu, lmbda = fem.Constant(mesh, 1.0), field(body, ("DG", 0), 2.0, "lmbda")
    b, pull = fem.Constant(mesh, np.array([0.0, 0.02, 0.03])), fem.Constant(mesh, 0.2)
    parameters = {
        "modulus": (mu, 0.7),
        "moduli": (lmbda, wave()),
        "load": (b, np.array([0.1, 0.2, -0.3])),
        "prescribed": (pull, 0.3),
        "factor": (t, 0.5),
    }
    if energy == "neo_hookean":
        psi = forms.energies.neo_hookean(F, mu, lmbda)
    elif energy == "hencky":
        psi = forms.energies.hencky(F, mu, lmbda)
    elif energy == "text":
        c = fem.Constant(mesh, 0.4)
        parameters["text"] = c, 0.2

        def psi_hat(s1, s2, s3):
            return (
                mu * ((s1 - 1) ** 2 + (s2 - 1) ** 2 + (s3 - 1) ** 2)
                + c * (s1 * s2 * s3 - ufl.ln(s1 * s2 * s3)) * lmbda
            )

        psi = forms.energies.principal(psi_hat)(F)
    elif energy == "activated":
        stretch = field(body, ("Lagrange", 1), lambda x: 1 + 0.1 * x[0], "stretch")
        parameters["activation"] = stretch, wave()
        A = ufl.as_matrix([[stretch, 0, 0], [0, 1, 0], [0, 0, 1]])
        psi = forms.energies.activated(F, A, mu) + forms.energies.neo_hookean(F, 0.3, lmbda)
    elif energy == "fibers":
        angle = field(body, ("Lagrange", 1), lambda x: 0.5 * x[2], "angle")
        parameters["angle"] = angle, wave()
        a = ufl.as_vector([ufl.cos(angle), ufl.sin(angle), 0])
        psi = forms.energies.guccione(F, mu, 2.0, 1.0, 1.5, a)
        psi += forms.energies.volumetric(F, lmbda)
    right = forms.translate(u, body.facets("right"), (pull * t, 0, 0.1 * t))
    left = forms.clamp(u, body.facets("left"))
    parameters["support"] = left, wave(3)
    potential = psi * ufl.dx + t * forms.body_force(u, b)
    problem = forms.Problem(potential, u, [left, right])
    measured = {
        "functional": ufl.inner(u, u) * ufl.dx + mu * u[0] * body.ds("top"),
        "force": forms.Reaction(body.facets("right"), (1.0, 0.5, 0.3)),
        "moment": forms.Reaction(body.facets("left"), (1.0, 0.5, 0.3), about=(0.0, 0.2, 0.0)),
    }
    return Scene(lambda: forms.solve(problem, **TIGHT), measured, parameters)


def plane(comm, kind):
    """A square, in plane strain, in condensed plane stress, or as a body of revolution."""
    body = meshes.block(comm, (1.0, 1.0), n=3)
    u, mesh = forms.displacement(body, degree=2), body.mesh
    mu, lmbda = fem.Constant(mesh, 1.0), field(body, ("DG", 0), 2.0, "lmbda")
    pull = fem.Constant(mesh, np.array([0.1, 0.05]))

    def psi(F):
        return forms.energies.neo_hookean(F, mu, lmbda)

    if kind == "plane stress":
        potential = psi(forms.plane_stress(u, psi)) * ufl.dx
    elif kind == "axisymmetric":
        potential = psi(forms.axisymmetric(u)) * forms.circumference(u) * ufl.dx
    else:
        potential = forms.energies.hencky(forms.deformation_gradient(u), mu, lmbda) * ufl.dx
    held = forms.clamp(u, body.facets("bottom"))
    if kind == "axisymmetric":
        held = forms.roller(u, body.facets("bottom"), 1)
        potential += forms.dead_traction(u, pull, body.ds("top"))
        supports = [held, forms.roller(u, body.facets("left"), 0)]
    else:
        supports = [held, forms.translate(u, body.facets("top"), (pull[0], pull[1]))]
    problem = forms.Problem(potential, u, supports)
    measured = {
        "functional": ufl.inner(u, u) * ufl.dx,
        "force": forms.Reaction(body.facets("bottom"), (0.4, 1.0)),
    }
    parameters = {
        "modulus": (mu, 0.7),
        "moduli": (lmbda, wave()),
        "pull": (pull, np.array([0.1, 0.2])),
        "support": (held, wave() if kind == "axisymmetric" else wave(2)),
    }
    return Scene(lambda: forms.solve(problem, **TIGHT), measured, parameters)


def mixed(comm):
    """Cook's panel with a pressure."""
    body = meshes.cook(comm, n=3)
    w = forms.displacement_pressure(body)
    u, p = ufl.split(w)
    F, mu = forms.deformation_gradient(u), fem.Constant(body.mesh, 80.0)
    kappa = field(body, ("DG", 0), 4e3, "kappa")
    f = fem.Constant(body.mesh, 2.0)
    psi = forms.energies.isochoric_neo_hookean(F, mu)
    psi = forms.energies.with_pressure(psi, F, p, kappa)
    potential = psi * ufl.dx + forms.dead_traction(u, (0 * f, f), body.ds("right"))
    held = forms.clamp(w, body.facets("left"))
    problem = forms.Problem(potential, w, [held])
    measured = {
        "functional": u[1] * body.ds("right") + 1e-3 * p**2 * ufl.dx,
        "moment": forms.Reaction(body.facets("left"), (0, 0, 1.0), about=(0.0, 0.0)),
    }
    parameters = {
        "modulus": (mu, 10.0),
        "bulk": (kappa, lambda x: 1e3 * wave()(x)),
        "load": (f, 0.5),
        "support": (held, wave(2)),
    }
    return Scene(lambda: forms.solve(problem, **TIGHT), measured, parameters)


def follower(comm):
    """A beam under a pressure that follows it: an unsymmetric tangent."""
    body = meshes.block(comm, (4.0, 1.0), n=(8, 2))
    u, p = forms.displacement(body), fem.Constant(body.mesh, 0.01)
    mu = field(body, ("DG", 0), 1.0, "mu")
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), mu, 2.0)
    load = forms.follower_pressure(u, p, ufl.TestFunction(u.function_space), body.ds("top"))
    held = forms.clamp(u, body.facets("left"))
    problem = forms.Problem(psi * ufl.dx, u, [held], virtual_work=load)
    measured = {
        "functional": u[1] * body.ds("right"),
        "force": forms.Reaction(body.facets("left"), (0.3, 1.0)),
    }
    parameters = {"moduli": (mu, wave()), "pressure": (p, 0.004), "support": (held, wave(2))}
    return Scene(lambda: forms.solve(problem, **TIGHT), measured, parameters)


def balloon(comm, controlled):
    """An octant of a balloon, at a pressure or at a volume, by a sheet's energy with a text."""
    body = meshes.spherical_sheet(comm, 1.0, 0.5, 2, "octant")
    u, p = forms.displacement(body, degree=2), fem.Constant(body.mesh, 0.3)
    mu, h = (
        fem.Constant(body.mesh, 1.0),
        field(body, ("Lagrange", 1), lambda x: 1 + 0.2 * x[2], "h"),
    )
    psi = forms.energies.principal(lambda s1, s2: mu * (s1**2 + s2**2 + (s1 * s2) ** -2 - 3) / 2)
    volume = forms.enclosed_volume(u, forms.membranes.orientation(body))
    potential = h * psi(forms.membrane_gradient(u)) * ufl.dx - p * volume
    held = [forms.roller(u, body.facets(f"{a}0"), k) for k, a in enumerate("xyz")]
    problem = forms.Problem(potential, u, held)
    measured = {"functional": ufl.inner(u, u) * ufl.dx}
    parameters = {"modulus": (mu, 0.2), "thickness": (h, wave()), "support": (held[0], wave())}
    if controlled:
        start = forms.integral(volume)
        measured["pressure"] = p

        def solve():
            p.value = 0.3
            return forms.control(
                problem, None, (), p, volume, [1.3 * start], progress=False, **TIGHT
            )

        return Scene(solve, measured, parameters)
    parameters["pressure"] = p, 0.02
    return Scene(lambda: forms.solve(problem, **TIGHT), measured, parameters)


SCENES = {
    "neo_hookean": lambda comm: solid(comm, "neo_hookean"),
    "hencky": lambda comm: solid(comm, "hencky"),
    "text": lambda comm: solid(comm, "text"),
    "activated": lambda comm: solid(comm, "activated"),
    "fibers": lambda comm: solid(comm, "fibers"),
    "plane stress": lambda comm: plane(comm, "plane stress"),
    "plane strain": lambda comm: plane(comm, "plane strain"),
    "axisymmetric": lambda comm: plane(comm, "axisymmetric"),
    "mixed": mixed,
    "follower": follower,
    "balloon": lambda comm: balloon(comm, False),
    "volume": lambda comm: balloon(comm, True),
}


def direction_of(m, given):
    """Changes of a parameter's own values for a unit step."""
    if isinstance(m, fem.Constant):
        return given
    if isinstance(m, fem.Function):
        return interpolated(m.function_space, given).x.array
    return [interpolated(part.value.function_space, given).x.array for part in m.parts]


def interpolated(V, given):
    f = fem.Function(V)
    f.interpolate(given)
    f.x.scatter_forward()
    return f


def move(m, start, along, h):
    """Put a parameter at start + h along."""
    if isinstance(m, fem.Constant):
        m.value = start + h * along
    elif isinstance(m, fem.Function):
        m.x.array[:] = start + h * along
    else:
        for part, values, change in zip(m.parts, start, along, strict=True):
            part.value.x.array[:] = values + h * change


def values_of(m):
    """Present values of a parameter."""
    if isinstance(m, fem.Constant):
        return np.array(m.value)
    if isinstance(m, fem.Function):
        return m.x.array.copy()
    return [part.value.x.array.copy() for part in m.parts]


def slope_along(problem, m, g, along):
    """A gradient times a direction, over all ranks."""
    comm = problem.comm
    if isinstance(m, fem.Constant):
        return float(np.sum(np.asarray(g) * along))
    if isinstance(m, fem.Function):
        return comm.allreduce(
            float(_own(g.x.array, m.function_space) @ _own(along, m.function_space))
        )
    b = problem.create_vector()
    kept = values_of(m)
    move(m, kept, along, 1.0)
    problem.prescribe(b)
    after = b.array_r.copy()
    move(m, kept, along, 0.0)
    problem.prescribe(b)
    return comm.allreduce(float(_own(g.x.array, problem.u.function_space) @ (after - b.array_r)))


def _own(array, V):
    return array[: V.dofmap.index_map.size_local * V.dofmap.bs]


def value(J, path):
    """What is differentiated, at the present state."""
    if isinstance(J, ufl.Form):
        return forms.integral(J)
    return J(path) if isinstance(J, forms.Reaction) else float(J.value)
