# SPDX-License-Identifier: MIT
"""Each kind of body with each kind of parameter at once, for the laws of gradients.

Constants, moduli by cell, angles of fibers, an activation, parameters and texts of energies in
singular values, load factors, prescribed values by a Constant and at the nodes.
"""

from __future__ import annotations

import ufl
from dolfinx import fem
from inverse_scenes import TIGHT, Scene, field, wave

from variform import forms, meshes


class Kinds:
    """Parameters of every kind, and the energy of solids that they stand in."""

    def __init__(self, body):
        mesh = body.mesh
        self.mu, self.c, self.pull = (fem.Constant(mesh, x) for x in (0.5, 0.4, 0.1))
        self.t = forms.load_factor(body, 1.0)
        self.lmbda = field(body, ("DG", 0), 1.5, "lmbda")
        self.angle = field(body, ("Lagrange", 1), lambda x: 0.4 + 0.3 * x[0], "angle")
        self.stretch = field(body, ("Lagrange", 1), lambda x: 1 + 0.1 * x[0], "stretch")
        self.parameters = {
            "singular values": (self.mu, 0.3),
            "moduli": (self.lmbda, wave()),
            "angle": (self.angle, wave()),
            "activation": (self.stretch, lambda x: 0.3 * wave()(x)),
            "text": (self.c, 0.2),
            "factor": (self.t, 0.5),
            "prescribed": (self.pull, 0.1),
        }

    def plain(self, F):
        """Energy of a solid in invariants: an activation, fibers, moduli by cell."""
        A = ufl.as_matrix([[self.stretch, 0, 0], [0, 1, 0], [0, 0, 1]])
        a = ufl.as_vector([ufl.cos(self.angle), ufl.sin(self.angle), 0])
        along = ufl.inner(F * a, F * a)
        psi = forms.energies.neo_hookean(F * A, 0.3, 0.2) + 0.2 * (along - 1) ** 2
        return psi + forms.energies.neo_hookean(F, self.mu, self.lmbda)

    def solid(self, F):
        """The same with energies in singular values, and the activated one among them."""
        A = ufl.as_matrix([[self.stretch, 0, 0], [0, 1, 0], [0, 0, 1]])
        psi = self.plain(F)
        psi += forms.energies.principal(
            lambda s1, s2, s3: self.c / 2 * ((s1 - 1) ** 2 + (s2 - 1) ** 2 + (s3 - 1) ** 2)
        )(F)
        return (
            psi
            + forms.energies.hencky(F, self.mu, self.lmbda)
            + forms.energies.activated(F, A, 0.2)
        )

    def sheet(self, F):
        """Energy of a sheet: F with two columns."""
        A = ufl.as_matrix([[self.stretch, 0], [0, 1]])
        a = ufl.as_vector([ufl.cos(self.angle), ufl.sin(self.angle)])
        along = ufl.inner(F * a, F * a)
        psi = forms.energies.neo_hookean_sheet(F * A, 0.3) + 0.2 * (along - 1) ** 2
        psi += self.lmbda * ufl.inner(F, F) / 20
        psi += forms.energies.principal(
            lambda s1, s2: self.c / 2 * ((s1 - 1) ** 2 + (s2 - 1) ** 2)
        )(F)
        return psi + forms.energies.principal(
            lambda s1, s2: self.mu / 2 * (s1**2 + s2**2 + (s1 * s2) ** -2 - 3)
        )(F)


def bulky(comm, kind):
    """A block, a square or a body of revolution, pulled and loaded."""
    flat = kind != "solid"
    body = meshes.block(comm, (1.0, 1.0) if flat else (1.0, 1.0, 1.0), n=2)
    kinds = Kinds(body)
    w = forms.displacement_pressure(body) if kind == "mixed" else forms.displacement(body, 2)
    u, ring = w["u"], 1.0
    psi = kinds.plain if kind == "plane stress" else kinds.solid
    F = forms.deformation_gradient(u)
    if kind == "plane stress":
        F = forms.plane_stress(u, psi)
    elif kind == "axisymmetric":
        F, ring = forms.axisymmetric(u), forms.circumference(u)
    density = psi(F)
    if kind == "mixed":
        density = forms.energies.with_pressure(density, F, w["p"], 50.0)
    end = (None, kinds.pull) if flat else (None, None, kinds.pull)
    pulled = forms.translate(w, body.facets("top"), end)
    held = [forms.clamp(w, body.facets("bottom")), pulled]
    if kind == "axisymmetric":
        held[0] = forms.roller(w, body.facets("bottom"), 1)
        held.append(forms.roller(w, body.facets("left"), 0))
    push = kinds.t * ring * 0.1 * u[0] * body.ds("right")
    problem = forms.Problem(density * ring * ufl.dx(degree=4) - push, w, held)
    at_nodes = wave() if kind == "axisymmetric" else wave(2 if flat else 3)
    parameters = {**kinds.parameters, "support": (held[0], at_nodes)}
    if kind == "plane stress":  # whose thickness is no matter of singular values
        del parameters["text"]
        parameters["modulus"] = parameters.pop("singular values")
    measured = {
        "functional": ufl.inner(u, u) * ufl.dx,
        "force": forms.Reaction(body.facets("top"), (0.0, 1.0) if flat else (0.3, 0.2, 1.0)),
    }
    return Scene(lambda: forms.solve(problem, **TIGHT), measured, parameters)


def thin(comm, kind):
    """An octant of a balloon at a pressure, or at a volume; its rim is pulled."""
    body = meshes.spherical_sheet(comm, 1.0, 0.5, 2, "octant")
    kinds, u = Kinds(body), forms.displacement(body, degree=2)
    volume = forms.enclosed_volume(u, forms.membranes.orientation(body))
    p = fem.Constant(body.mesh, 0.3)
    # Under a volume the pressure is found, and the load factor that of another load.
    load = p * volume if kind == "volume" else 0.3 * kinds.t * volume
    load += 0.02 * kinds.t * u[2] * ufl.dx
    held = [forms.roller(u, body.facets(f"{a}0"), k) for k, a in enumerate("xy")]
    pulled = forms.translate(u, body.facets("z0"), (None, None, -kinds.pull / 2))
    problem = forms.Problem(
        kinds.sheet(forms.membrane_gradient(u)) * ufl.dx - load, u, [*held, pulled]
    )
    measured = {
        "functional": ufl.inner(u, u) * ufl.dx,
        "force": forms.Reaction(body.facets("z0"), (0.0, 0.0, 1.0)),
    }
    parameters = {**kinds.parameters, "support": (held[0], wave())}
    if kind == "membrane":
        return Scene(lambda: forms.solve(problem, **TIGHT), measured, parameters)
    measured["pressure"] = p
    goal = 1.3 * forms.integral(volume)

    def solve():
        p.value = 0.3
        return forms.control(problem, None, (), p, volume, [goal], progress=False, **TIGHT)

    return Scene(solve, measured, parameters)


EVERY = {
    **{
        kind: lambda comm, kind=kind: bulky(comm, kind)
        for kind in ("solid", "plane strain", "plane stress", "axisymmetric", "mixed")
    },
    **{kind: lambda comm, kind=kind: thin(comm, kind) for kind in ("membrane", "volume")},
}
