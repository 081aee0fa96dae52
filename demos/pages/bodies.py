# SPDX-License-Identifier: MIT
"""The bodies of meshes/README.md: each is made, asked for its boundaries, and drawn."""

import inspect
from dataclasses import dataclass
from math import pi

from mpi4py import MPI

import numpy as np
from dolfinx import mesh, plot
from scipy import ndimage

from demos.benchmarks.record import markdown
from variform import meshes

from .energies import FIGURES
from .responses import save

COLORS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#d55e00", "#56b4e9")
TILE = (480, 400)  # pixels of one body, drawn at half the size


@dataclass(frozen=True)
class Row:
    """A function that makes a body.

    Attributes:
        name: Name in meshes.
        variants: What makes another set of boundaries, in words, with arguments after comm.
        note: Text of the column of parameters.
    """

    name: str
    variants: tuple[tuple[str, dict], ...]
    note: str = ""


ROWS = (
    Row(
        "block",
        (
            ("three lengths", {"size": (1.5, 1.0, 1.0), "h": 0.25}),
            ("two lengths", {"size": (1.5, 1.0), "h": 0.25}),
        ),
        'either `h`, edge length, or `n`, numbers of cells; `cells`: `"triangle"`, '
        '`"quadrilateral"`, `"tetrahedron"`, `"hexahedron"`',
    ),
    Row(
        "cook",
        (
            ("", {"n": 6}),
            ("with tetrahedra or hexahedra", {"n": 6, "cells": "hexahedron", "thickness": 12.0}),
        ),
        "as for `block`; `thickness` of a plate",
    ),
    Row(
        "cylinder",
        (
            ("", {"radius": 1.0, "height": 1.5, "h": 0.35}),
            ("with `inner_radius`", {"radius": 1.0, "height": 1.5, "inner_radius": 0.6, "h": 0.35}),
            (
                "with `sector=pi/2`",
                {"radius": 1.0, "height": 1.0, "inner_radius": 0.5, "h": 0.2, "sector": pi / 2},
            ),
            ("with another `sector`", {"radius": 1.0, "height": 1.0, "h": 0.4, "sector": 2.0}),
        ),
        "a sector starts at `y0` and ends at `x0` or `cut`",
    ),
    Row("sphere_octant", (("", {"inner": 0.6, "outer": 1.0, "h": 0.15}),), "radii"),
    Row(
        "ellipsoid",
        (("", {"h": 3.0}),),
        "half axes (short, long) of the inner and the outer surface, height of the base; by "
        "default the left ventricle of the cardiac benchmark (Land et al. 2015), apex down, in mm",
    ),
    Row(
        "square",
        (
            ("", {"side": 1.0, "h": 0.2}),
            ("with `quarter`", {"side": 1.0, "h": 0.1, "quarter": True}),
        ),
    ),
    Row(
        "disk",
        (
            ("", {"radius": 1.0, "h": 0.3}),
            ("with `inner_radius`", {"radius": 1.0, "inner_radius": 0.4, "h": 0.25}),
            (
                "with `inner_radius` and `quarter`",
                {"radius": 1.0, "inner_radius": 0.4, "h": 0.15, "quarter": True},
            ),
        ),
    ),
    Row(
        "spherical_sheet",
        (
            ('`part="whole"`', {"radius": 1.0, "h": 0.35}),
            ('`"hemisphere"`', {"radius": 1.0, "h": 0.3, "part": "hemisphere"}),
            ('`"octant"`', {"radius": 1.0, "h": 0.25, "part": "octant"}),
        ),
    ),
    Row("cylindrical_sheet", (("", {"radius": 0.6, "height": 1.2, "h": 0.25}),)),
    Row("pillow", (("", {"side": 1.0, "h": 0.2}),)),
)

# Pictures: which variant of which body, from where it is seen, and whether it is cut open
# in the plane y = 0.
SHEETS = {
    "solids": (
        ("block", 0, (1, -2, 1.1), False),
        ("block", 1, (0, 0, 1), False),
        ("cook", 0, (0, 0, 1), False),
        ("cook", 1, (0.7, -0.25, 1.2), False),
        ("cylinder", 1, (1, -2, 1.1), False),
        ("cylinder", 2, (1.6, 1.2, 1.1), False),
        ("sphere_octant", 0, (-1.6, -1.3, -1.0), False),
        ("ellipsoid", 0, (0.6, -2, 0.8), True),
    ),
    "sheets": (
        ("square", 0, (0, 0, 1), False),
        ("square", 1, (0, 0, 1), False),
        ("disk", 1, (0, 0, 1), False),
        ("disk", 2, (0, 0, 1), False),
        ("spherical_sheet", 1, (1, -2, -0.8), False),
        ("spherical_sheet", 2, (1.6, 1.3, 1.0), False),
        ("cylindrical_sheet", 0, (1, -2, 1.1), False),
        ("pillow", 0, (1, -2, 1.1), False),
    ),
}


def made(row, variant):
    """The body of a row's variant, on this process alone."""
    return getattr(meshes, row.name)(MPI.COMM_SELF, **row.variants[variant][1])


def makers():
    """Names in meshes of functions that make a body from numbers."""
    functions = [name for name in meshes.__all__ if inspect.isfunction(getattr(meshes, name))]
    body = (meshes.Body, "Body")
    return [
        name
        for name in functions
        if inspect.signature(getattr(meshes, name)).return_annotation in body
        and name not in ("read", "from_arrays")
    ]


def corners(body, name):
    """Corners of the facets of a boundary, shape (facets, corners, 3)."""
    facets, dim = body.facets(name), body.mesh.topology.dim
    nodes = mesh.entities_to_geometry(body.mesh, dim - 1, facets)
    return body.mesh.geometry.x[nodes]


# --- the table ----------------------------------------------------------------------------------


def signature(name):
    """A call with the names of all arguments; a * before those that need their name."""
    words, starred = [], False
    for p in inspect.signature(getattr(meshes, name)).parameters.values():
        if p.kind is p.KEYWORD_ONLY and not starred:
            words, starred = [*words, "*"], True
        words.append(p.name)
    return f"{name}({', '.join(words)})"


def shape(name):
    """First sentence of the docstring, without what it says of ranks."""
    first = inspect.getdoc(getattr(meshes, name)).split("\n\n")[0].replace("\n", " ")
    return first.replace(" Collective.", "").rstrip(".")


def plane(body, name):
    """Coordinate that is constant on a boundary, x, y or z; nothing on a curved or oblique one."""
    points = corners(body, name).reshape(-1, 3)
    size = np.ptp(body.mesh.geometry.x, axis=0).max()
    flat = np.ptp(points, axis=0) < 1e-9 * size
    flat &= np.ptp(body.mesh.geometry.x, axis=0) > 1e-9 * size  # of sheets, all of which is flat
    return "xyz"[int(np.argmax(flat))] if flat.sum() == 1 else ""


def boundaries(body):
    """Names of a body's boundaries, those across one axis together, and of its regions if many."""
    groups = {}
    for name in sorted(body.boundaries):
        groups.setdefault(plane(body, name), []).append(name)
    parts = []
    for axis, names in sorted(groups.items()):
        if axis:
            names.sort(key=lambda name: corners(body, name)[..., "xyz".index(axis)].min())
        parts.append(" ".join(f"`{name}`" for name in names) + (f" ({axis})" if axis else ""))
    text = ", ".join(parts) or "none"
    if list(body.regions) != ["body"]:
        text += "; regions " + " ".join(f"`{name}`" for name in sorted(body.regions))
    return text


def lines():
    """Lines of meshes/README.md: both pictures, and the table of all functions."""
    out = []
    for sheet, tiles in SHEETS.items():
        what = ", ".join(dict.fromkeys(name for name, *_ in tiles))
        out += [f"![Boundaries of {what}](../demos/figures/mesh_{sheet}.png)", ""]
    table = []
    for row in ROWS:
        texts = [
            (f"{words}: " if words else "") + boundaries(made(row, k))
            for k, (words, _) in enumerate(row.variants)
        ]
        table.append([f"`{signature(row.name)}`", shape(row.name), "; ".join(texts), row.note])
    read = [f"`{signature('read')}`", "your own, see below", "the file's", "`scale=1e-3`: mm to m"]
    arrays = [f"`{signature('from_arrays')}`", "your own, see below", "as given", ""]
    return out + markdown(("Function", "Shape", "Boundaries", "Parameters"), [*table, read, arrays])


# --- the pictures -------------------------------------------------------------------------------


def _axes(view):
    """Unit vectors to the right, upwards and to the eye of a view."""
    eye = np.asarray(view, float) / np.linalg.norm(view)
    vertical = np.array([0.0, 1.0, 0.0] if abs(eye[2]) > 0.75 else [0.0, 0.0, 1.0])
    right = np.cross(vertical, eye)
    right /= np.linalg.norm(right)
    return right, np.cross(eye, right), eye


def _facets(body, name, shift, keep):
    """A boundary as pyvista draws it, moved away from the body."""
    import pyvista

    x = corners(body, name)
    x = x[keep(x.mean(axis=1))] + shift
    n, width, _ = x.shape
    if width == 4:
        x = x[:, [0, 1, 3, 2]]  # DOLFINx numbers quadrilaterals as a tensor product
    links = np.insert(np.arange(n * width).reshape(n, width), 0, width, axis=1).ravel()
    return (
        pyvista.PolyData(x.reshape(-1, 3), lines=links)
        if width == 2
        else pyvista.PolyData(x.reshape(-1, 3), faces=links)
    )


def _pieces(body, cut):
    """What is drawn: name, its surface or line, moved apart from the others, and its color."""
    import pyvista

    dim, points = body.mesh.topology.dim, body.mesh.geometry.x
    size, center = np.ptp(points, axis=0).max(), (points.max(axis=0) + points.min(axis=0)) / 2
    out = []
    if dim == 2:
        grid = pyvista.UnstructuredGrid(*plot.vtk_mesh(body.mesh, dim))
        if list(body.regions) == ["body"]:
            out.append(("", grid, "#d9d9d9"))
        else:  # layers on each other
            for k, name in enumerate(sorted(body.regions)):
                layer = grid.extract_cells(body.cells(name))
                layer.points = layer.points + np.array([0, 0, 0.25 * size * k])
                out.append((name, layer, COLORS[k]))
    keep = (lambda m: m[:, 1] > 0) if cut else (lambda m: np.full(len(m), True))
    for k, name in enumerate(body.boundaries):
        middle = corners(body, name).reshape(-1, 3).mean(axis=0)
        apart = 0.75 if dim == 3 and not cut else 0.0
        out.append((name, _facets(body, name, apart * (middle - center), keep), COLORS[k]))
    return out


def render(body, view, cut):
    """Picture of a body, its boundaries in colors, and where on it their names go.

    Returns:
        Pixels, shape (height, width, 3); names with color and place, (x, y) from the upper left.
    """
    import pyvista

    pieces, (right, up, eye) = _pieces(body, cut), _axes(view)
    shown = np.concatenate([piece.points for _, piece, _ in pieces])
    across, along = shown @ right, shown @ up
    focus = right * (across.max() + across.min()) / 2 + up * (along.max() + along.min()) / 2

    def shot(flat=False):
        plotter = pyvista.Plotter(off_screen=True, window_size=list(TILE))
        plotter.set_background("white")
        for k, (_, piece, color) in enumerate(pieces):
            line = piece.n_lines if isinstance(piece, pyvista.PolyData) else 0
            style = {"line_width": 7} if line else {"show_edges": True, "edge_color": "#666666"}
            if flat:
                style |= {"color": (0, 0, 20 * (k + 1)), "show_edges": False, "lighting": False}
            else:
                style |= {"color": color, "ambient": 0.6, "diffuse": 0.45}
            plotter.add_mesh(piece, **style)
        camera = plotter.camera
        camera.parallel_projection = True
        camera.focal_point = focus + eye * np.mean(shown @ eye)
        camera.position = np.asarray(camera.focal_point) + eye * 10 * np.ptp(shown, axis=0).max()
        camera.up = up
        camera.parallel_scale = 0.65 * max(np.ptp(along), np.ptp(across) * TILE[1] / TILE[0])
        plotter.renderer.reset_camera_clipping_range()
        pixels = plotter.screenshot(return_img=True)
        plotter.close()
        return pixels

    # The second picture, of one color each, tells which pixels of each boundary are seen.
    numbers, names = shot(flat=True)[..., :3], []
    for k, (name, piece, color) in enumerate(pieces):
        if not name:
            continue
        seen = np.all(numbers == (0, 0, 20 * (k + 1)), axis=2)
        if not seen.any():
            raise ValueError(f"nothing is seen of {name}: choose another view.")
        if isinstance(piece, pyvista.PolyData) and piece.n_lines:
            where = np.argwhere(seen)
            y, x = where[np.argmin(np.linalg.norm(where - where.mean(axis=0), axis=1))]
        else:  # deepest inside what is seen
            y, x = np.unravel_index(np.argmax(ndimage.distance_transform_edt(seen)), seen.shape)
        names.append((name, color, (x, y)))
    return shot(), names


def sheet(name):
    """Figure of small multiples with the names of all boundaries in it."""
    from matplotlib.figure import Figure

    tiles, columns = SHEETS[name], 4
    rows = -(-len(tiles) // columns)
    figure = Figure(figsize=(9.6, 2.2 * rows), dpi=100)
    known = {row.name: row for row in ROWS}
    for k, (body, variant, view, cut) in enumerate(tiles):
        axes = figure.add_axes(
            (k % columns / columns, 1 - (k // columns + 1) / rows, 1 / columns, 0.88 / rows)
        )
        pixels, names = render(made(known[body], variant), view, cut)
        axes.imshow(pixels, interpolation="antialiased")
        axes.axis("off")
        words = known[body].variants[variant][0].replace("`", "").removeprefix("with ")
        title = body + (f", {words}" if words else "") + (", cut open" if cut else "")
        axes.set_title(title, fontsize=10, pad=2)
        for text, color, place in names:
            axes.text(
                *place,
                text,
                fontsize=9,
                ha="center",
                va="center",
                bbox={"fc": "white", "ec": color, "lw": 1.2, "pad": 1.5, "alpha": 0.9},
            )
    return figure


def pictures():
    """Draw both sheets."""
    from variform.forms.files.pictures import ensure_display

    ensure_display()
    for name in SHEETS:
        save(sheet(name), FIGURES / f"mesh_{name}.png")
        yield FIGURES / f"mesh_{name}.png"
