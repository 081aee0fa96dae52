# SPDX-License-Identifier: MIT
"""Data of cells and points, held by rank 0 in the file's order, as functions on a mesh."""

from collections.abc import Mapping
from typing import Any

from mpi4py import MPI

import numpy as np
from dolfinx.fem import Function, functionspace
from dolfinx.mesh import Mesh
from numpy.typing import NDArray

from ._dolfinx import geometry_dofmap

__all__ = ["functions"]


def functions(
    mesh: Mesh,
    cell_data: Mapping[str, NDArray[np.float64]],
    point_data: Mapping[str, NDArray[np.float64]],
) -> dict[str, Function]:
    """Make a function of each array; collective.

    Args:
        mesh: Made of cells and points that the ranks had in the order of the file.
        cell_data: On rank 0 the values of each cell, shape (number of cells, …), in the order in
            which the cells were given; elsewhere empty.
        point_data: Likewise those of the points, shape (number of points, …).

    Returns:
        By name: piecewise constants of the cells' values, continuous and piecewise linear functions
        of the points' (on cells of order 2 their values at the vertices).
    """
    comm, topology, made = mesh.comm, mesh.topology, {}
    shapes = [{k: v.shape[1:] for k, v in data.items()} for data in (cell_data, point_data)]
    cell_shapes, point_shapes = comm.bcast(shapes)
    cells = topology.original_cell_index
    for name, shape in cell_shapes.items():
        f = Function(functionspace(mesh, ("DG", 0, shape)), name=name)
        values = _fetch(comm, cell_data.get(name), np.asarray(cells, np.int64), shape)
        _fill(f, f.function_space.dofmap.list[:, 0], values)
        made[name] = f
    for name, shape in point_shapes.items():
        f = Function(functionspace(mesh, ("Lagrange", 1, shape)), name=name)
        dofs = f.function_space.dofmap.list
        # The vertices come first among the geometry's nodes of a cell.
        nodes = mesh.geometry.input_global_indices[
            geometry_dofmap(mesh.geometry)[:, : dofs.shape[1]]
        ]
        unique, first = np.unique(dofs, return_index=True)
        values = _fetch(comm, point_data.get(name), nodes.ravel()[first].astype(np.int64), shape)
        _fill(f, unique, values)
        made[name] = f
    return made


def _fill(f: Function, dofs: NDArray[np.int32], values: NDArray[np.float64]) -> None:
    size = f.function_space.dofmap.bs
    f.x.array.reshape(-1, size)[dofs] = values.reshape(-1, size)
    f.x.scatter_forward()


def _fetch(
    comm: MPI.Comm,
    values: NDArray[np.float64] | None,
    wanted: NDArray[np.int64],
    shape: tuple[int, ...],
) -> Any:
    """Rows of an array of rank 0, asked for by each rank; one rank after the other."""
    numbers = comm.gather(len(wanted))
    if comm.rank > 0:
        comm.Send(wanted, dest=0)
        got = np.empty((len(wanted), *shape))
        comm.Recv(got, source=0)
        return got
    assert values is not None and numbers is not None
    for rank in range(1, comm.size):
        theirs = np.empty(numbers[rank], dtype=np.int64)
        comm.Recv(theirs, source=rank)
        comm.Send(np.ascontiguousarray(values[theirs]), dest=rank)
    return values[wanted]
