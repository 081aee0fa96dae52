# SPDX-License-Identifier: MIT
"""Entities of measures that are written as lists: checked, and each integrated by one rank."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

import numpy as np
import ufl
from numpy.typing import NDArray

from . import _dolfinx

# Numbers that describe an entity: a cell; (cell, local facet); the same for both sides of a facet.
_WIDTHS = {"cell": 1, "exterior_facet": 2, "interior_facet": 4}


def with_owned_entities(form: ufl.Form) -> ufl.Form:
    """The form, its lists of entities reduced to those that this rank owns. Collective.

    ``Measure(subdomain_data=[(number, entities), ..])`` says on each rank what is integrated
    there. DOLFINx adds up whatever comes, so that a ghost cell would count on each rank that
    knows it. Meshtags, whose ghosts DOLFINx leaves out itself, stay as they are.

    Raises:
        ValueError: an entity that the mesh does not have, alike on all ranks.
    """
    listed = {
        id(i.subdomain_data()): (i.integral_type(), i.subdomain_data())
        for i in form.integrals()
        if isinstance(i.subdomain_data(), list | tuple)
    }
    if not listed:
        return form
    mesh = _dolfinx.cpp_mesh(form.ufl_domain())
    owned, wrong = {}, ""
    for key, (kind, data) in listed.items():
        parts = []
        for number, entities in data:
            array = np.asarray(entities)
            wrong = wrong or _mistake(mesh, kind, number, array)
            parts.append((number, array if wrong else _owned(mesh, kind, array)))
        owned[key] = parts
    wrong = mesh.comm.allreduce(wrong, MPI.MAX)
    if wrong:
        raise ValueError(wrong)
    return ufl.Form(
        [
            i.reconstruct(subdomain_data=owned.get(id(i.subdomain_data()), i.subdomain_data()))
            for i in form.integrals()
        ]
    )


def _mistake(mesh: Any, kind: str, number: Any, entities: NDArray) -> str:
    """What is wrong with the entities of a list, in words; local."""
    width, topology = _WIDTHS.get(kind), mesh.topology
    if width is None or not entities.size:
        return ""
    words = {1: "cells", 2: "pairs (cell, local facet)", 4: "(cell, local facet) of both sides"}
    where = f"subdomain {number} of a measure over {kind.replace('_', ' ')}s lists {words[width]}"
    if entities.dtype.kind not in "iu" or entities.size % width:
        return f"{where}: whole numbers, {width} to an entity, got {entities.dtype} of shape " + (
            f"{entities.shape}."
        )
    cells = topology.index_map(topology.dim)
    count = cells.size_local + cells.num_ghosts
    pairs = entities.reshape(-1, min(width, 2))
    for column, most, word in ((0, count, "cells"), (1, _facets_of_a_cell(topology), "facets")):
        if column < pairs.shape[1]:
            low, high = int(pairs[:, column].min()), int(pairs[:, column].max())
            if low < 0 or high >= most:
                worst = low if low < 0 else high
                on = "of a cell" if column else f"of rank {mesh.comm.rank}"
                return f"{where}: the {word} {on} are 0 to {most - 1}, got {worst}."
    return ""


def _facets_of_a_cell(topology: Any) -> int:
    dim = topology.dim
    topology.create_connectivity(dim, dim - 1)
    numbers = topology.connectivity(dim, dim - 1)
    return len(numbers.links(0)) if numbers.num_nodes else 0


def _owned(mesh: Any, kind: str, entities: NDArray) -> NDArray[np.int32]:
    """The entities that this rank integrates over; a facet belongs to the facet's own rank."""
    width, topology = _WIDTHS.get(kind), mesh.topology
    if width is None or not entities.size:
        return entities.astype(np.int32)
    dim, rows = topology.dim, entities.reshape(-1, width).astype(np.int32)
    if width == 1:
        return rows[rows[:, 0] < topology.index_map(dim).size_local].ravel()
    topology.create_connectivity(dim, dim - 1)
    numbers = topology.connectivity(dim, dim - 1)
    facets = numbers.array.reshape(numbers.num_nodes, -1)[rows[:, 0], rows[:, 1]]
    return rows[facets < topology.index_map(dim - 1).size_local].ravel()
