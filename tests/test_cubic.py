# SPDX-License-Identifier: MIT
"""Elements of degree 3 on unstructured meshes: a field of its own has its edges' nodes in order."""

import numpy as np
import pytest

SCENE = """
import json, sys
from mpi4py import MPI
import numpy as np, ufl
from variform import forms, meshes

comm = MPI.COMM_WORLD
G = np.array([[0.2, 0.1, -0.05], [0.0, -0.1, 0.15], [0.1, 0.05, 0.1]])
ELEMENTS = {"P3 x P2": ("Lagrange", 2), "P3 x DG1": ("DG", 1), "P3": None}


def sheared(dim, other):
    "A body whose boundary is prescribed G X, component by component, turned by all fields' ways."
    sizes = (1.0,) * dim
    body = meshes.block(comm, sizes, h=0.4)
    fields = {"u": (("Lagrange", 3, (dim,)), forms.Role.DISPLACEMENT)}
    if other is not None:
        fields["p"] = (other, forms.Role.PRESSURE)
    w = forms.unknown(body, **fields)
    F = forms.deformation_gradient(w["u"] if other else w)
    psi = forms.energies.neo_hookean(F, 1.0, 2.0)
    if other is not None:
        p = w["p"]
        psi = psi + p * (ufl.det(F) - 1) - p**2 / 20
    X = ufl.SpatialCoordinate(body.mesh)
    values = [sum(float(G[i, j]) * X[j] for j in range(dim)) for i in range(dim)]
    facets = np.concatenate([body.facets(name) for name in body.boundaries])
    supports = [forms.prescribe(w, facets, [v if i == k else None for k in range(dim)])
                for i, v in enumerate(values)]
    path = forms.solve(psi * ufl.dx, w, supports, rtol=1e-12, ctol=1e-11)
    u = forms.displacement_of(w)
    points = np.random.default_rng(3).uniform(0.02, 0.98, (40, dim))
    off = max(np.abs(forms.at(u, x) - G[:dim, :dim] @ x).max() for x in points)
    force = forms.resultant(path, facets)[0]
    total = sum(forms.resultant(path, body.facets(name))[1] for name in body.boundaries)
    at_rest = forms.unknown(body, **fields)
    if other is not None:
        at_rest.put("u", lambda x: np.array([x[0]**3, x[0] * x[1]**2, x[1]**3])[:dim])
        v = forms.displacement_of(at_rest)
        cubic = max(np.abs(forms.at(v, x)[:2] - [x[0]**3, x[0] * x[1]**2]).max() for x in points)
        whole = ufl.split(at_rest)[0]
        Y = ufl.SpatialCoordinate(body.mesh)
        wrong = forms.integral((whole[0] - Y[0]**3)**2 * ufl.dx)
    else:
        cubic = wrong = 0.0
    return {"off": off, "force": np.abs(force).max(), "cubic": cubic, "wrong": wrong}


found = {}
for dim in (2, 3):
    for name, other in ELEMENTS.items():
        found[f"{name} {dim}"] = sheared(dim, other)
if comm.rank == 0:
    print(json.dumps(found))
"""


@pytest.fixture(
    scope="module",
    params=[1, pytest.param(2, marks=pytest.mark.slow), pytest.param(3, marks=pytest.mark.slow)],
)
def found(request, parallel_once):
    return parallel_once(SCENE, request.param)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("element", ["P3 x P2", "P3 x DG1", "P3"])
def test_a_body_prescribed_on_its_boundary_is_uniform(element, dim, found):
    """U = G X at any point inside to 1e-9; fields put and read are the cubics that they are."""
    case = found[f"{element} {dim}"]
    assert case["off"] < 1e-9
    assert case["force"] < 1e-9
    assert case["cubic"] < 1e-12
    assert np.sqrt(case["wrong"]) < 1e-12
