# SPDX-License-Identifier: MIT
"""Directions along which nodes of facets are supported: given ones, or the facets' normals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import basix
import numpy as np
import ufl
from dolfinx import fem, la
from dolfinx.mesh import meshtags
from numpy.typing import NDArray

from . import _checks, _dolfinx
from .boundaries import facet_type
from .compilation import compiled
from .native import jit
from .unknowns import Field

Array = NDArray[np.float64]
TURN = np.cos(np.deg2rad(40))  # mean of the facets' normals at a node, over their sizes


@dataclass(frozen=True, eq=False)
class Slant:
    """Nodes that do not move along a direction each, or as prescribed; local, ghosts included.

    Attributes:
        dofs: Numbers of a node's components in the unknown, shape (nodes, d).
        normals: Its direction n, of length 1, shape (nodes, d).
        value: Function whose values are the prescribed u . n; None for 0.
        at: The nodes' numbers in it.
    """

    dofs: NDArray[np.int32]
    normals: Array
    value: Any = None
    at: Any = None


def slant(w: fem.Function, field: Field, facets: NDArray[np.int32], direction: Any) -> Slant:
    """Directions at the nodes of facets: given ones, or the facets' normals. Collective.

    Args:
        w: Unknown.
        field: Its displacement.
        facets: Local facet indices.
        direction: Vector of any length, of numbers or in UFL, evaluated once; None for the normals.

    Raises:
        ValueError: a direction of length 0, or of another shape; no facets on any rank; facets that
            have no normal, or that meet at an edge.
    """
    mesh, dim = w.function_space.mesh, field.components
    facets = _checks.facets(mesh, facets)
    W, numbers = field.collapsed
    nodes = np.sort(fem.locate_dofs_topological(W, mesh.topology.dim - 1, facets))
    n = fem.Function(W)
    if direction is None:
        _put_normals(n, field, facets, nodes)
    else:
        given = _checks.vector(direction, (dim,), "a roller's direction")
        _checks.same_space(given, mesh, "a roller's direction")
        if ufl.algorithms.analysis.extract_type(given, ufl.classes.FacetNormal):
            raise ValueError(
                "a roller's direction is evaluated at nodes: leave it out for the facets' normals."
            )
        numbers_ = [_checks.number(entry) for entry in getattr(given, "ufl_operands", ())]
        if isinstance(given, ufl.classes.ListTensor) and None not in numbers_:
            n.x.array.reshape(-1, dim)[:] = numbers_
        else:
            n.interpolate(jit.expression(given, _dolfinx.interpolation_points(W), mesh))
            n.x.scatter_forward()
    normals = n.x.array.reshape(-1, dim)[nodes]
    lengths = np.linalg.norm(normals, axis=1)
    bad = ~(np.isfinite(lengths) & (lengths > 0))
    _refuse(W, nodes[bad], "a roller needs a direction of a length above 0, got none at {}.")
    return Slant(numbers.reshape(-1, dim)[nodes], normals / lengths[:, None])


def coordinate_axis(slant: Slant, comm: MPI.Comm) -> tuple[int, float] | None:
    """The axis of coordinates that all directions are along, and their sign. Collective."""
    for sign in (1.0, -1.0):
        least = np.min(comm.allgather((sign * slant.normals).min(axis=0, initial=1.0)), axis=0)
        axis = int(np.argmax(least))
        if least[axis] > 1 - 1e-14:
            return axis, sign
    return None


def _put_normals(
    n: fem.Function, field: Field, facets: NDArray[np.int32], nodes: NDArray[np.int32]
) -> None:
    """Sum of the normals of the facets at each node, over their sizes there. Collective."""
    W = n.function_space
    mesh, fdim = W.mesh, W.mesh.topology.dim - 1
    if mesh.topology.dim != mesh.geometry.dim:
        raise ValueError(
            "the edges of a surface have no normals of their own: give the roller a direction."
        )
    facets = np.unique(facets).astype(np.int32)
    tags = meshtags(mesh, fdim, facets, np.ones(len(facets), np.int32))
    ds = ufl.ds(1, domain=mesh, subdomain_data=tags)
    # Values at the nodes alone, so that each has a part of every facet.
    kind, lagrange = basix.ElementFamily.P, basix.LagrangeVariant.gll_warped
    points = basix.create_element(kind, facet_type(mesh, ds), field.degree, lagrange).points
    rule = {
        "quadrature_rule": "custom",
        "quadrature_points": tuple(tuple(map(float, point)) for point in points),
        "quadrature_weights": (1.0,) * len(points),
        "quadrature_degree": field.degree,
    }
    v, one = ufl.TestFunction(W), ufl.as_vector([1.0] + [0.0] * (field.components - 1))
    sums = []
    for direction in (ufl.FacetNormal(mesh), one):
        b = la.vector(W.dofmap.index_map, W.dofmap.index_map_bs)
        b.array[:] = 0
        fem.assemble_vector(b.array, compiled(ufl.inner(direction, v) * ds(metadata=rule)))
        b.scatter_reverse(la.InsertMode.add)
        b.scatter_forward()
        sums.append(b.array.reshape(-1, field.components)[nodes])
    normals, sizes = sums[0], sums[1][:, 0]
    inner = sizes == 0
    _refuse(W, nodes[inner], "facets inside a body, as at {}, have no normal: give a direction.")
    means = np.linalg.norm(normals, axis=1) / np.abs(np.where(inner, 1.0, sizes))
    _refuse(
        W,
        nodes[means < TURN],
        "the facets of a roller turn too much at {} to have a normal there: give each smooth side "
        "a roller of its own, or this one a direction.",
    )
    n.x.array.reshape(-1, field.components)[nodes] = normals


def _refuse(W: fem.FunctionSpace, nodes: NDArray[np.int32], sentence: str) -> None:
    """Refuse what is wrong at some nodes on any rank. Collective."""
    x = W.tabulate_dof_coordinates()[:, : W.mesh.geometry.dim]
    places = np.where(np.abs(x[nodes]) < 1e-9 * np.abs(x).max(initial=0.0), 0.0, x[nodes])
    found = [tuple(place) for part in W.mesh.comm.allgather(places.tolist()) for place in part]
    if found:
        where = ", ".join(f"{coordinate:.4g}" for coordinate in min(found))
        raise ValueError(sentence.format(f"({where})"))
