# SPDX-License-Identifier: MIT
"""What several test files share: the energies with parameters, states, and ways to evaluate."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import recorder
import ufl
from dolfinx import fem, mesh

from variform import forms, meshes
from variform.forms import energies, stress
from variform.forms.differentiation import update_dependents
from variform.forms.operators.evaluate import at_points

MU, LMBDA, KAPPA = 1.3, 2.1, 4.0
FIBER = np.array([0.8, 0.6, 0.0])
TRANSVERSE = {"mu": 1.3, "nu": 0.27, "E_A": 9.0, "G_A": 0.8}


def fiber():
    return ufl.as_vector(FIBER.tolist())


def _isochoric(psi):
    return lambda F: psi(F) + energies.volumetric(F, KAPPA, "simo")


ENERGIES = {
    "neo_hookean": lambda F: energies.neo_hookean(F, MU, LMBDA),
    "neo_hookean_quadratic": lambda F: energies.neo_hookean_quadratic(F, MU, LMBDA),
    # neo-Hookean (16) written in the invariants, with a C : C term that is free of stress at rest
    "isotropic": lambda F: energies.isotropic(
        F,
        lambda I1, CC, J2: (
            MU / 2 * (I1 - 3 - ufl.ln(J2)) + LMBDA / 8 * ufl.ln(J2) ** 2 + 0.1 * (CC - 2 * I1 + 3)
        ),
    ),
    "isochoric_neo_hookean": _isochoric(lambda F: energies.isochoric_neo_hookean(F, MU)),
    "volumetric_quadratic": lambda F: (
        energies.isochoric_neo_hookean(F, MU) + energies.volumetric(F, KAPPA)
    ),
    "volumetric_log": lambda F: (
        energies.isochoric_neo_hookean(F, MU) + energies.volumetric(F, KAPPA, "log")
    ),
    "mooney_rivlin": _isochoric(lambda F: energies.mooney_rivlin(F, 0.4, 0.25)),
    "yeoh": _isochoric(lambda F: energies.yeoh(F, 0.65, -0.05, 0.02)),
    "saint_venant_kirchhoff": lambda F: energies.saint_venant_kirchhoff(F, MU, LMBDA),
    "stable_neo_hookean": lambda F: energies.stable_neo_hookean(F, MU, LMBDA),
    "transversely_isotropic": lambda F: energies.transversely_isotropic_neo_hookean(
        F, **energies.transversely_isotropic_constants(**TRANSVERSE), fiber=fiber()
    ),
    "guccione": lambda F: (
        energies.guccione(F, 2.0, 8.0, 2.0, 4.0, fiber()) + energies.volumetric(F, KAPPA)
    ),
}

# The same for energies in singular values.
STRETCHES = {
    "fixed_corotated": lambda F: energies.fixed_corotated(F, MU, LMBDA),
    "corotated_linear": lambda F: energies.corotated_linear(F, MU, LMBDA),
    "as_rigid_as_possible": lambda F: (
        energies.as_rigid_as_possible(F, MU) + energies.volumetric(F, KAPPA)
    ),
    "symmetric_dirichlet": lambda F: energies.symmetric_dirichlet(F, MU),
    "hencky": lambda F: energies.hencky(F, MU, LMBDA),
    "ogden": _isochoric(lambda F: energies.ogden(F, [1.6, -0.13], [1.5, -2.0])),
    "neo_hookean_stretches": lambda F: energies.neo_hookean_stretches(F, MU, LMBDA),
    "saint_venant_kirchhoff_stretches": lambda F: energies.saint_venant_kirchhoff_stretches(
        F, MU, LMBDA
    ),
    "stable_neo_hookean_stretches": lambda F: energies.stable_neo_hookean_stretches(F, MU, LMBDA),
    "extended_hencky": lambda F: energies.extended(energies.hencky, 0.9)(F, MU, LMBDA),
    "activated": lambda F: (energies.activated(F, np.eye(3), MU) + energies.volumetric(F, KAPPA)),
    "written_by_a_user": lambda F: energies.principal(
        lambda s1, s2, s3: MU / 2 * (s1**2 + s2**2 + s3**2 - 3) - MU * (s1 * s2 * s3 - 1)
    )(F)
    + energies.volumetric(F, KAPPA),
}


def unit_mesh(dim, n=1, cells=None):
    """A unit square or cube on this rank alone."""
    if dim == 2:
        kind = cells or mesh.CellType.triangle
        return mesh.create_unit_square(MPI.COMM_SELF, n, n, kind)
    return mesh.create_unit_cube(MPI.COMM_SELF, n, n, n, cells or mesh.CellType.tetrahedron)


def whole(body, where=lambda x: np.full(x.shape[1], True)):
    """Boundary facets of a mesh at given places."""
    dim = body.topology.dim
    body.topology.create_connectivity(dim - 1, dim)
    return mesh.locate_entities_boundary(body, dim - 1, where)


def at_plane(body, axis, value):
    """Boundary facets in the plane x_axis = value."""
    return whole(body, lambda x: np.isclose(x[axis], value))


class Pointwise:
    """psi, P and the spatial elasticity (Voigt) of an energy at one F, by one compiled kernel."""

    def __init__(self, psi):
        self.mesh = unit_mesh(3)
        self.F = fem.Constant(self.mesh, np.eye(3))
        F = ufl.variable(self.F)
        density = psi(F)
        P, S = stress.first_piola(density, F), stress.second_piola(density, F)
        sigma = stress.cauchy(density, F)
        c = stress.voigt_elasticity(stress.spatial_elasticity(density, F))
        parts = [density, *_entries(P), *_entries(S), *_entries(sigma), *_entries(c)]
        point = np.full((1, 3), 0.25)
        self._parts = at_points(ufl.as_vector(parts), self.mesh, point)
        self._kernel = fem.Expression(self._parts, point)

    def __call__(self, F):
        self.F.value[:] = F
        update_dependents(self._parts)
        v = self._kernel.eval(self.mesh, np.array([0], dtype=np.int32)).ravel()
        tensors = v[1:28].reshape(3, 3, 3)
        return {
            "psi": v[0],
            "P": tensors[0],
            "S": tensors[1],
            "sigma": tensors[2],
            "c": v[28:].reshape(6, 6),
        }


def _entries(tensor):
    rows, columns = tensor.ufl_shape
    return [tensor[i, j] for i in range(rows) for j in range(columns)]


def random_rotation(rng):
    Q, R = np.linalg.qr(rng.normal(size=(3, 3)))
    Q *= np.sign(np.diag(R))
    return Q if np.linalg.det(Q) > 0 else -Q


def random_state(rng, amount=0.3):
    """A deformation gradient with det F > 0.3."""
    while True:
        F = np.eye(3) + amount * rng.normal(size=(3, 3))
        if np.linalg.det(F) > 0.3:
            return F


def rates(errors, factor=2.0):
    """Observed orders between successive errors when the parameter is divided by factor."""
    errors = np.asarray(errors)
    return np.log(errors[:-1] / errors[1:]) / np.log(factor)


def bending(scale=1.0, length=1.0, **solving):
    """A short cantilever under a dead load at its end; lengths and moduli scaled."""
    body = meshes.block(MPI.COMM_SELF, (4 * length, length), n=(8, 2), cells="quadrilateral")
    u, t = forms.displacement(body), forms.load_factor(body)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0 * scale, 2.0 * scale)
    load = forms.dead_traction(u, ufl.as_vector([0 * t, -0.01 * scale * t]), body.ds("right"))
    path = forms.follow(
        psi * ufl.dx + load,
        u,
        [forms.clamp(u, body.facets("left"))],
        t,
        progress=False,
        record={"force": lambda s: forms.resultant(s, body.facets("left"))},
        **solving,
    )
    return path, body


def off(found, wanted):
    """Relative difference of two arrays of one shape, a figure of the page where it is printed."""
    value = _off(found, wanted)
    recorder.figure(value)
    return value


def _off(found, wanted):
    found, wanted = np.asarray(found), np.asarray(wanted)
    assert found.shape == wanted.shape
    return np.abs(found - wanted).max() / np.abs(wanted).max()


def agree(found, wanted, digits):
    """Compare, and record how well they agreed."""
    error = _off(found, wanted)
    recorder.error(error)
    assert error < 10.0**-digits


def tube_pressure(inner, outer, a, mu):
    """Inner pressure of an incompressible neo-Hookean tube in plane strain, inner radius now a.

    sigma_rr' = (sigma_tt - sigma_rr)/r = mu (r^2/R^2 - R^2/r^2)/r with R^2 = r^2 - k,
    k = a^2 - A^2; integrated from a to b.
    """
    k = a**2 - inner**2
    b = np.sqrt(outer**2 + k)
    return mu * (np.log(outer / b) - np.log(inner / a) + k / 2 * (1 / a**2 - 1 / b**2))
