# SPDX-License-Identifier: MIT
"""Meshes that several test files read, and what is measured of a body."""

from math import pi

from mpi4py import MPI

import gmsh
import numpy as np
import ufl
from dolfinx import fem
from dolfinx.mesh import Mesh, meshtags

from variform import meshes

COMM = MPI.COMM_WORLD


def integral(integrand: ufl.core.expr.Expr, measure: ufl.Measure) -> float:
    """Over all ranks. Tags of any name count as 1: a kernel that is compiled serves them all."""
    mesh, tags = measure.ufl_domain().ufl_cargo(), measure.subdomain_data()
    if tags is not None and measure.subdomain_id() != "everywhere":
        named = np.atleast_1d(measure.subdomain_id())
        found = np.flatnonzero(np.isin(tags.values, named))
        ones = np.ones(len(found), np.int32)
        one = meshtags(Mesh(mesh, measure.ufl_domain()), tags.dim, tags.indices[found], ones)
        measure = measure.reconstruct(subdomain_id=1, subdomain_data=one)
    return mesh.comm.allreduce(fem.assemble_scalar(fem.form(integrand * measure)))


def area(body: meshes.Body, *boundary: str, degree: int = 6) -> float:
    """Area of the named boundary; of the whole boundary without names."""
    return integral(fem.Constant(body.mesh, 1.0), body.ds(*boundary, degree=degree))


def size(body: meshes.Body, *boundary: str, degree: int = 6) -> float:
    """Area of the named boundary; of the body, its volume, without names."""
    if boundary:
        return area(body, *boundary, degree=degree)
    return integral(fem.Constant(body.mesh, 1.0), body.dx(degree=degree))


def volumes(body: meshes.Body) -> dict[str, float]:
    """Volume of each region."""
    one = fem.Constant(body.mesh, 1.0)
    return {name: integral(one, body.dx(name)) for name in body.regions}


def number_of_cells(body: meshes.Body) -> int:
    return body.mesh.topology.index_map(body.mesh.topology.dim).size_global


BODIES = {
    "bar": lambda: meshes.block(COMM, (1, 0.2, 0.3), h=0.1, origin=(1, 2, 3)),
    "bar2": lambda: meshes.block(COMM, (1, 0.2, 0.3), h=0.15, order=2),
    "bar_n": lambda: meshes.block(COMM, (1, 0.2, 0.3), n=(3, 2, 1)),
    "bar_n2": lambda: meshes.block(COMM, (1, 0.2, 0.3), n=(3, 2, 1), order=2),
    "bar_hex": lambda: meshes.block(COMM, (1, 0.2, 0.3), n=(3, 2, 1), cells="hexahedron"),
    "bar_hex2": lambda: meshes.block(COMM, (1, 0.2, 0.3), h=0.2, cells="hexahedron", order=2),
    "sheet": lambda: meshes.block(COMM, (1, 0.2), h=0.1),
    "sheet_n2": lambda: meshes.block(COMM, (1, 0.2), n=(3, 2), order=2, origin=(-1, 1)),
    "sheet_quad": lambda: meshes.block(COMM, (1, 0.2), n=2, cells="quadrilateral"),
    "sheet_quad2": lambda: meshes.block(COMM, (1, 0.2), n=2, cells="quadrilateral", order=2),
    "cook": lambda: meshes.cook(COMM, h=12.0),
    "cook_n2": lambda: meshes.cook(COMM, n=3, order=2),
    "cook_quad": lambda: meshes.cook(COMM, n=(4, 3), cells="quadrilateral"),
    "cook_tet": lambda: meshes.cook(COMM, n=4, cells="tetrahedron", thickness=10.0),
    "cook_hex2": lambda: meshes.cook(COMM, h=16.0, cells="hexahedron", thickness=10.0, order=2),
    "cylinder": lambda: meshes.cylinder(COMM, 1.0, 2.0, h=0.6),
    "tube2": lambda: meshes.cylinder(COMM, 1.0, 2.0, 0.5, h=0.5, order=2),
    "quarter": lambda: meshes.cylinder(COMM, 1.0, 0.5, 0.5, h=0.3, sector=pi / 2),
    "half": lambda: meshes.cylinder(COMM, 1.0, 0.5, 0.5, h=0.3, sector=pi),
    "octant": lambda: meshes.sphere_octant(COMM, 0.5, 1.0, h=0.3),
    "octant2": lambda: meshes.sphere_octant(COMM, 0.5, 1.0, h=0.4, order=2),
    "ellipsoid": lambda: meshes.ellipsoid(COMM, h=6.0),
}


def box(h: float = 0.4, order: int = 1) -> None:
    """Box 1 x 2 x 3 of two halves, soft below z = 1.5, with named ends and a named interface."""
    occ = gmsh.model.occ
    halves = [(3, occ.addBox(0, 0, z, 1, 2, 1.5)) for z in (0, 1.5)]
    occ.fragment(halves[:1], halves[1:])
    occ.synchronize()
    ends = {0: "base", 1.5: "interface", 3: ""}
    for z, name in ends.items():
        e = 1e-3
        found = gmsh.model.getEntitiesInBoundingBox(-e, -e, z - e, 1 + e, 2 + e, z + e, 2)
        gmsh.model.addPhysicalGroup(2, [tag for _, tag in found], 10 + int(2 * z), name)
    for tag, z, name in (1, 0, "soft"), (2, 1.5, "hard"):
        found = gmsh.model.getEntitiesInBoundingBox(-e, -e, z - e, 1 + e, 2 + e, z + 1.5 + e, 3)
        gmsh.model.addPhysicalGroup(3, [volume for _, volume in found], tag, name)
    gmsh.option.setNumber("Mesh.MeshSizeMax", h)
    gmsh.option.setNumber("Mesh.ElementOrder", order)
    gmsh.model.mesh.generate(3)
    gmsh.option.setNumber("Mesh.ElementOrder", 1)


GEO = """
SetFactory("OpenCASCADE");
Rectangle(1) = {0, 0, 0, 2, 1};
Disk(2) = {1, 0.5, 0, 0.2};
BooleanFragments{ Surface{1}; Delete; }{ Surface{2}; Delete; }
Physical Surface("soft") = {2};
Physical Surface("hard") = {3};
Physical Curve("left") = Curve In BoundingBox{-0.1, -0.1, -0.1, 0.1, 1.1, 0.1};
Mesh.MeshSizeMax = 0.2;
"""
SQUARE = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
TWO = ((2, 1, (1, 2, 3)), (2, 1, (1, 3, 4)))
CUBE = [(x, y, z) for z in (0, 1) for y in (0, 1) for x in (0, 1)]


def msh(points, elements, names=((2, 1, "body"), (1, 2, "left"))) -> str:
    """A .msh 2.2; elements are (gmsh's type, physical tag, nodes)."""
    lines = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat", "$PhysicalNames", str(len(names))]
    lines += [f'{dim} {tag} "{name}"' for dim, tag, name in names]
    lines += ["$EndPhysicalNames", "$Nodes", str(len(points))]
    lines += [f"{i} {x} {y} {z}" for i, (x, y, z) in enumerate(points, 1)]
    lines += ["$EndNodes", "$Elements", str(len(elements))]
    for i, (kind, tag, nodes) in enumerate(elements, 1):
        physical = f"2 {tag} {tag}" if tag else "0"
        lines.append(f"{i} {kind} {physical} {' '.join(map(str, nodes))}")
    return "\n".join([*lines, "$EndElements", ""])
