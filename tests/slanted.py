# SPDX-License-Identifier: MIT
"""Bodies on slanted rollers, beside the same ones on rollers along the axes of coordinates."""

from typing import Any

import numpy as np
import ufl
from dolfinx import fem

from variform import forms, meshes
from variform.forms.directions import Slant
from variform.forms.supports import Support

MU, LMBDA = 1.0, 10.0
TIGHT: dict[str, Any] = {"rtol": 1e-12, "ctol": 1e-11, "progress": False}
WAYS = ("solve", "follow", "control", "arc_length", "transient")
ANGLE = np.pi / 6


def rotation(dim: int) -> np.ndarray:
    """Of 30 degrees in the plane, about a crooked axis in space."""
    c, s = np.cos(ANGLE), np.sin(ANGLE)
    if dim == 2:
        return np.array([[c, -s], [s, c]])
    k = np.array([1.0, 2.0, -1.0]) / np.sqrt(6)
    K = np.cross(np.eye(3), k)
    return np.eye(3) + s * K + (1 - c) * K @ K


def turn(body: meshes.Body, Q: np.ndarray) -> meshes.Body:
    dim = body.mesh.geometry.dim
    body.mesh.geometry.x[:, :dim] = body.mesh.geometry.x[:, :dim] @ Q.T
    return body


def off(u: Any, facets: Any, n: Any) -> float:
    """Largest |u . n| at the nodes of a face."""
    moved = forms.displacement_of(u)
    V = moved.function_space
    nodes = fem.locate_dofs_topological(V, V.mesh.topology.dim - 1, facets)
    along = np.abs(moved.x.array.reshape(-1, len(n))[nodes] @ n).max(initial=0.0)
    return float(max(V.mesh.comm.allgather(float(along))))


def bar(comm: Any, degree: int, way: str, turned: bool) -> dict[str, Any]:
    """A bar 2 x 1 in plane strain, pulled to 1.5 of its length between rollers."""
    Q = rotation(2) if turned else np.eye(2)
    body = turn(meshes.block(comm, (2.0, 1.0), n=(4, 2)), Q)
    t = forms.load_factor(body)
    mixed = way == "mixed"
    u = forms.displacement_pressure(body) if mixed else forms.displacement(body, degree)
    y = ufl.split(u)[0] if mixed else u
    F = forms.deformation_gradient(y)
    psi = forms.energies.neo_hookean(F, MU, LMBDA)
    if mixed:
        psi = forms.energies.isochoric_neo_hookean(F, MU)
        psi = forms.energies.with_pressure(psi, F, u["p"], 10.0)
    left, bottom, right = (body.facets(name) for name in ("left", "bottom", "right"))
    supports = [forms.roller(u, left), forms.roller(u, bottom, Q[:, 1])]
    end = forms.roller(u, right, Q[:, 0], by=t)
    along = ufl.inner(y, ufl.as_vector(Q[:, 0].tolist()))
    pull = along * body.ds("right")
    potential, loads = psi * ufl.dx, None
    if way in ("follow", "mixed"):
        path = forms.follow(potential, u, [*supports, end], t, to=1.0, **TIGHT)
    elif way == "solve":
        t.value = 1.0
        path = forms.solve(potential, u, [*supports, end], rtol=1e-12, ctol=1e-11)
    elif way == "control":
        path = forms.control(potential - t * pull, u, supports, t, pull, [0.5, 1.0], **TIGHT)
    elif way == "arc_length":
        path = forms.arc_length(
            potential - t * pull, u, supports, t, to=1.17201602, step=0.5, **TIGHT
        )
    else:
        end = forms.roller(u, right, Q[:, 0], by=t**2)
        path = forms.transient(potential, u, [*supports, end], t, to=1.0, rho=0.5, dt=0.1, **TIGHT)
        loads = [row.supports for row in path.ledger]
    points = [(2.0, 1.0), (2.0, 0.0), (0.0, 1.0), (1.3, 0.6)]
    moved = forms.displacement_of(u)
    R = forms.resultant(path, left)
    return {
        "u": [(Q.T @ forms.at(moved, Q @ np.array(p))).tolist() for p in points],
        "off": [off(u, left, Q[:, 0]), off(u, bottom, Q[:, 1])],
        "force": (Q.T @ R[0][:2]).tolist(),
        "support": (Q.T @ forms.resultant(path, supports[0])[0][:2]).tolist(),
        "energy": forms.integral(psi * ufl.dx),
        "loads": loads or [],
    }


def cube(comm: Any, degree: int, turned: bool = True) -> dict[str, Any]:
    """A cube on three slanted planes, pulled: their edges and the corner are held twice."""
    Q = rotation(3) if turned else np.eye(3)
    body = turn(meshes.block(comm, (1.0, 1.0, 1.0), n=2), Q)
    u, t = forms.displacement(body, degree), forms.load_factor(body)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), MU, LMBDA)
    planes = [forms.roller(u, body.facets(name)) for name in ("left", "front", "bottom")]
    end = forms.roller(u, body.facets("right"), by=t)
    path = forms.follow(psi * ufl.dx, u, [*planes, end], t, to=0.5, **TIGHT)
    values = Q.T @ forms.at(u, Q @ np.ones(3))
    return {
        "u": values.tolist(),
        "unstable": forms.negative_eigenvalues(path),
        "lowest": forms.lowest_modes(path)[0][0],
        "frequencies": forms.frequencies(path, 1.0, 3).frequencies.tolist(),
        "force": (Q.T @ forms.resultant(path, planes[0])[0]).tolist(),
    }


def annulus(comm: Any, whole: bool) -> tuple[meshes.Body, np.ndarray]:
    """A ring of 36 quadrilaterals around, or a ninth of it, and the angles of its nodes."""
    parts, count = (36, 4) if whole else (4, 4)
    angles = 2 * np.pi * np.arange(parts + (not whole)) / 36 + 0.2
    radii = np.linspace(1.0, 1.6, count)
    points = [(r * np.cos(a), r * np.sin(a)) for a in angles for r in radii]
    around, nodes = np.arange(parts)[:, None] * count, np.arange(count - 1)
    a = (around + nodes).ravel()
    b = (((around // count + 1) % len(angles)) * count + nodes).ravel()
    ends = np.arange(len(angles)) * count
    sides = {"inside": ends, "outside": ends + count - 1}
    if not whole:
        sides |= {"first": np.arange(count), "last": ends[-1] + np.arange(count)}
    cells = np.stack([a, a + 1, b + 1, b], axis=1)
    return meshes.from_arrays(
        comm, np.array(points), cells, boundaries=sides, cell="quadrilateral"
    ), angles


def ring(comm: Any, what: str) -> dict[str, Any]:
    """A ring under pressure, or a ninth of it between planes of symmetry; in a rigid wall, too."""
    body, angles = annulus(comm, what != "sector")
    u, t = forms.displacement(body, 2), forms.load_factor(body)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), MU, LMBDA)
    potential = psi * ufl.dx + forms.pressure_potential(u, t, body.ds("inside"))
    X = [(np.cos(a), np.sin(a)) for a in angles[0] + np.pi / 2 * np.arange(3)]
    if what == "whole":  # three directions at three nodes take the rigid motions and no more
        supports = [nodal(u, X[0], X[1]), nodal(u, X[2], X[1]), nodal(u, X[1], X[0])]
    elif what == "sector":
        supports = [forms.roller(u, body.facets("first")), forms.roller(u, body.facets("last"))]
    elif what == "wall":
        supports = [forms.clamp(u, body.facets("outside"))]
    else:
        supports = [forms.roller(u, body.facets("outside")), nodal(u, X[0], X[1])]
    forms.follow(potential, u, supports, t, to=0.3, **TIGHT)
    at = [(r * np.cos(b), r * np.sin(b)) for r in (1.0, 1.6) for b in angles[:5]]
    return {"u": [forms.at(u, p).tolist() for p in at]}


def nodal(u: Any, point: Any, direction: Any) -> Any:
    """No displacement of one node along a direction."""
    V = u.function_space
    x = V.tabulate_dof_coordinates()[:, :2]
    nodes = np.flatnonzero(np.linalg.norm(x - point, axis=1) < 1e-9)
    normals = np.tile(np.asarray(direction), (len(nodes), 1))
    return Support(V, (), Slant((2 * nodes[:, None] + [0, 1]).astype(np.int32), normals))


def slope(comm: Any, way: str) -> dict[str, Any]:
    """A wedge is pushed along a slope by a component that its corner shares: no stress."""
    body = meshes.block(comm, (2.0, 1.0), n=(4, 2))
    x = body.mesh.geometry.x
    x[:, 1] += 0.4 * x[:, 0]
    u, t = forms.displacement(body, 2), forms.load_factor(body)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), MU, LMBDA)
    supports = [
        forms.roller(u, body.facets("bottom")),
        forms.translate(u, body.facets("left"), (0.3 * t, None)),
    ]
    if way == "follow":
        forms.follow(psi * ufl.dx, u, supports, t, to=1.0, **TIGHT)
    else:
        forms.transient(
            psi * ufl.dx, u, supports, t, to=1.0, rho=1.0, dt=0.25, velocity=(0.3, 0.12), **TIGHT
        )
    values = [forms.at(u, p).tolist() for p in ((0.0, 0.0), (2.0, 1.8), (1.0, 0.9))]
    return {"u": values, "energy": forms.integral(psi * ufl.dx)}
