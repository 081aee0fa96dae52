# SPDX-License-Identifier: MIT
"""Files of meshes as text: two tetrahedra on both sides of z = 0, in every format."""

# Two tetrahedra on both sides of z = 0: volumes 1/6 and 1/3.
POINTS = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, -2)]
TETS = [(0, 1, 2, 3), (0, 2, 1, 4)]
SQUARE = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]


def msh2(points=POINTS, cells=TETS, tags=(1, 2), names=(), kind=4, entity=None, more="") -> str:
    """A .msh of version 2.2; the elementary entity is the tag unless told."""
    lines = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat"]
    if names:
        lines += ["$PhysicalNames", str(len(names))]
        lines += [f'{dim} {tag} "{name}"' for dim, tag, name in names] + ["$EndPhysicalNames"]
    lines += ["$Nodes", str(len(points))]
    lines += [f"{i} {' '.join(map(str, p))}" for i, p in enumerate(points, 1)]
    lines += ["$EndNodes", "$Elements", str(len(cells))]
    for i, (cell, tag) in enumerate(zip(cells, tags, strict=True), 1):
        own = tag if entity is None else entity
        lines.append(f"{i} {kind} 2 {tag} {own} {' '.join(str(n + 1) for n in cell)}")
    return "\n".join([*lines, "$EndElements", ""]) + more


def data2(name: str, values: dict[int, float], section: str = "ElementData") -> str:
    """A section of data of a .msh."""
    rows = "".join(f"{i} {v}\n" for i, v in values.items())
    head = f'${section}\n1\n"{name}"\n1\n0.0\n3\n0\n1\n{len(values)}\n'
    return f"{head}{rows}$End{section}\n"


MSH4 = """$MeshFormat
4.1 0 8
$EndMeshFormat
{names}$Entities
0 0 0 {entities}
$EndEntities
$Nodes
1 5 1 5
3 1 0 5
1
2
3
4
5
0 0 0
1 0 0
0 1 0
0 0 1
0 0 -2
$EndNodes
$Elements
{elements}
$EndElements
"""


def msh4(groups: str, names: str = "", entities: int = 2) -> str:
    """A .msh of version 4.1 of two volumes (or one), whose groups are given."""
    text = "\n".join(f"{i} 0 0 -2 1 1 1 {g} 0" for i, g in enumerate(groups.split("|"), 1))
    if entities == 2:
        elements = "2 2 1 2\n3 1 4 1\n1 1 2 3 4\n3 2 4 1\n2 1 3 2 5"
    else:
        elements = "1 2 1 2\n3 1 4 2\n1 1 2 3 4\n2 1 3 2 5"
    named = f"$PhysicalNames\n{names.count(chr(10))}\n{names}$EndPhysicalNames\n" if names else ""
    return MSH4.format(names=named, entities=f"{entities}\n{text}", elements=elements)


def item(text: object, shape: str, kind: str = "Int") -> str:
    words = " ".join(map(str, text)) if isinstance(text, (list, tuple)) else str(text)
    return f'<DataItem DataType="{kind}" Dimensions="{shape}" Format="XML">{words}</DataItem>'


def attribute(name: str, text: str, shape: str = "2", kind: str = "Int", center="Cell") -> str:
    return f'<Attribute Name="{name}" Center="{center}">{item(text, shape, kind)}</Attribute>'


def grid(attributes: str = "", cells=TETS, kind: str = "Tetrahedron", points=POINTS) -> str:
    """A grid of an .xdmf, without the frame."""
    flat = [n for cell in cells for n in cell]
    x = [c for p in points for c in p]
    topology = item(flat, f"{len(cells)} {len(cells[0])}")
    return (
        f'<Grid Name="g"><Topology TopologyType="{kind}">{topology}</Topology>'
        f'<Geometry GeometryType="XYZ">{item(x, f"{len(points)} 3", "Float")}</Geometry>'
        f"{attributes}</Grid>"
    )


def xdmf(attributes: str = "", **other) -> str:
    return f"<Xdmf><Domain>{grid(attributes, **other)}</Domain></Xdmf>"


def mixed(flat: list[int], values: str = "") -> str:
    number = len(values.split())
    tags = attribute("gmsh:physical", values, str(number)) if values else ""
    topology = f'<Topology TopologyType="Mixed">{item(flat, str(len(flat)))}</Topology>'
    x = item([c for p in POINTS for c in p], "5 3", "Float")
    return (
        f'<Xdmf><Domain><Grid Name="g">{topology}<Geometry GeometryType="XYZ">{x}</Geometry>{tags}'
        "</Grid></Domain></Xdmf>"
    )


INP = """*HEADING
two cells
*NODE
10, 0., 0., 0.
20, 1., 0., 0.
30, 0., 1., 0.
40, 0., 0., 1.
50, 0., 0., -2.
*ELEMENT, TYPE=C3D4
7, 10, 20, 30, 40
9, 10, 30, 20, 50
"""


def vtk(cells=TETS, kind: int = 10, more: str = "", points=POINTS) -> str:
    rows = "\n".join(f"{len(c)} {' '.join(map(str, c))}" for c in cells)
    x = "\n".join(" ".join(map(str, p)) for p in points)
    size = sum(len(c) + 1 for c in cells)
    kinds = "\n".join(len(cells) * [str(kind)])
    return (
        "# vtk DataFile Version 3.0\nodd\nASCII\nDATASET UNSTRUCTURED_GRID\n"
        f"POINTS {len(points)} double\n{x}\nCELLS {len(cells)} {size}\n{rows}\n"
        f"CELL_TYPES {len(cells)}\n{kinds}\n{more}"
    )


def vtu(data: str = "", kinds: str = "10 10", connectivity: str = "0 1 2 3 0 2 1 4") -> str:
    x = " ".join(str(c) for p in POINTS for c in p)
    three = 'NumberOfComponents="3"'
    array = '<DataArray type="{}" Name="{}" {} format="ascii">{}</DataArray>'.format
    return (
        '<?xml version="1.0"?><VTKFile type="UnstructuredGrid" version="0.1" '
        'byte_order="LittleEndian"><UnstructuredGrid><Piece NumberOfPoints="5" NumberOfCells="2">'
        f"<Points>{array('Float64', 'Points', three, x)}</Points>"
        f"<Cells>{array('Int64', 'connectivity', '', connectivity)}"
        f"{array('Int64', 'offsets', '', '4 8')}{array('UInt8', 'types', '', kinds)}</Cells>"
        f"<CellData>{data}</CellData></Piece></UnstructuredGrid></VTKFile>"
    )


FIBER = attribute("fiber", "1 0 0 0 0 1", "2 3", "Float")
TAGS = attribute("materials", "1 2")
