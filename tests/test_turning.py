# SPDX-License-Identifier: MIT
"""Bodies that the site lets the mouse turn: surfaces kept beside the demos' pictures."""

import numpy as np
import pytest
from conftest import ROOT

from demos.pages import turning


@pytest.mark.parametrize("name", turning.TURNED)
def test_bodies_to_turn_are_those_of_the_pictures(name):
    """Beside each picture there is a small surface: triangles of its points, colors, edges."""
    file = ROOT / "demos" / "figures" / f"{name}.npz"
    assert file.with_suffix(".png").is_file() and file.stat().st_size <= 150_000
    surface = turning.Surface.load(file)
    number = len(surface.colors)
    assert 100 < len(surface.triangles) <= turning.MOST and len(surface.lines)
    assert set(surface.triangles.ravel()) == set(range(number))
    assert 0 <= surface.lines.min() and surface.lines.max() < len(surface.points)
    assert surface.limits[0] < surface.limits[1] and surface.label
    assert np.isfinite(surface.points).all() and np.ptp(surface.points, axis=0).min() > 0


@pytest.mark.parametrize(("name", "volume"), [("torsion", np.pi), ("bar", 10.0)])
def test_an_incompressible_body_to_turn_has_its_volume(name, volume):
    """Deformed, and with its triangles all the same way around: sum of x . (y x z) / 6."""
    surface = turning.Surface.load(ROOT / "demos" / "figures" / f"{name}.npz")
    x, y, z = (surface.points[surface.triangles[:, k]] for k in range(3))
    found = np.sum(x * np.cross(y, z)) / 6
    assert abs(found) == pytest.approx(volume, rel=0.01)
