# SPDX-License-Identifier: MIT
"""Bodies that the mouse turns, beside the gallery's pictures: pages by plotly, opened by a click.

Each is a page of its own in a frame, which is loaded when it is opened; plotly's script lies beside
them once, so nothing is asked of another server.
"""

import re

import numpy as np

from demos.pages.turning import FIGURES, TURNED, Surface

PICTURE = re.compile(r"!\[[^\]]*\]\(figures/(\w+)\.png\)")
# Browsers load a frame that is hidden, lazy or not: it has its address from the first opening on.
FRAME = """
<details ontoggle="const frame = this.querySelector('iframe'); frame.src ||= frame.dataset.page">
<summary>Turn it with the mouse</summary>
<iframe data-page="figures/{name}.html" title="{name}, to be turned with the mouse"
 style="width: 100%; aspect-ratio: 3 / 2; border: 0"></iframe>
<a href="figures/{name}.html">On a page of its own</a>
</details>
"""


def with_frames(text):
    """The gallery's page, with a frame after each picture of a body that can be turned."""

    def framed(found):
        return found[0] + (FRAME.format(name=found[1]) if found[1] in TURNED else "")

    return PICTURE.sub(framed, text)


def write(folder):
    """Write the pages of all bodies and plotly's script to a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in TURNED:
        figure(Surface.load(FIGURES / f"{name}.npz")).write_html(
            folder / f"{name}.html",
            include_plotlyjs="directory",
            config={"displaylogo": False, "modeBarButtons": [["resetCameraDefault3d"]]},
        )


def figure(surface):
    """A surface as a figure of plotly, seen from the front right above as the pictures are."""
    from plotly import graph_objects

    low, high = surface.limits
    # Six digits of the body's size: more would be the file's weight alone.
    digits = 6 - int(np.ceil(np.log10(np.ptp(surface.points, axis=0).max())))
    x, y, z = np.round(surface.points, digits).T
    number = len(surface.colors)
    body = graph_objects.Mesh3d(
        x=x[:number],
        y=y[:number],
        z=z[:number],
        **dict(zip("ijk", surface.triangles.T, strict=True)),
        intensity=np.round(surface.colors, 6 - int(np.ceil(np.log10(abs(high - low))))),
        colorscale="Viridis",
        cmin=low,
        cmax=high,
        colorbar={"title": surface.label.replace("\n", "<br>"), "thickness": 20, "len": 0.8},
        lighting={"ambient": 0.65, "diffuse": 0.5, "specular": 0.05},
        hoverinfo="skip",
    )
    # A gap after each piece, which has two ends.
    gaps = np.full((len(surface.lines), 1), np.nan)
    ends = [np.hstack([axis[surface.lines], gaps]).ravel() for axis in (x, y, z)]
    ends = [[None if np.isnan(value) else value for value in axis] for axis in ends]
    edges = graph_objects.Scatter3d(
        **dict(zip("xyz", ends, strict=True)),
        mode="lines",
        line={"color": "black", "width": 2},
        hoverinfo="skip",
        showlegend=False,
    )
    made = graph_objects.Figure([body, edges])
    eye = {"x": 0.8, "y": -1.6, "z": 0.8}
    axes = {f"{axis}axis": {"visible": False} for axis in "xyz"}
    # Its diagonal fits the frame, whichever way it is turned.
    size = np.ptp(surface.points, axis=0)
    ratio = dict(zip("xyz", 1.8 * size / np.linalg.norm(size), strict=True))
    scene = {"aspectmode": "manual", "aspectratio": ratio, "dragmode": "orbit", **axes}
    scene["camera"] = {"eye": eye}
    made.update_layout(scene=scene, margin={side: 0 for side in "lrtb"}, template="none")
    return made
