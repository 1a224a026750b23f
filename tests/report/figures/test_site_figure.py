"""The picture of a sample site, and the shading of its heights."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from world_files import GRASS, put_world

from hrt_cli.artifacts.stage import REFUSE
from hrt_cli.report.figures.site import band_of, draw_site, hillshade


def test_each_layer_has_its_panel(tmp_path: Path, drawn: list[Figure]) -> None:
    heights = np.add.outer(np.zeros(60), np.linspace(0, 3, 80)).astype(np.float32)
    heights[:5] = np.nan
    classes = np.full((60, 80), 255)
    classes[:, :20], classes[:, 20:60] = 0, 1
    names = {"0": GRASS, "1": GRASS | {"name": "mud"}}
    world = put_world(tmp_path / "site", heights, classes=classes, table=names)
    files = {name: world / f"{name}.tif" for name in ("ortho", "truth", "dsm")}
    assert not draw_site(files, tmp_path / "f.png", caption="a site", existing=REFUSE)
    assert draw_site(files, tmp_path / "f.png", caption="a site", existing=REFUSE)
    titles = [axes.get_title(loc="left") for axes in drawn[0].axes]
    assert titles[:3] == ["orthomosaic", "true classes", "heights"]
    entries = [text.get_text() for text in drawn[0].axes[1].get_legend().get_texts()]
    assert [entry.split()[-1] for entry in entries] == ["33%", "67%"]
    for axes in drawn[0].axes[:3]:
        for image in axes.images:
            assert image.get_extent() == pytest.approx([0, 8, 6, 0], rel=1e-3)


@pytest.mark.parametrize("slope", [0.0, 0.3, -0.8])
@pytest.mark.parametrize("toward_deg", [0, 90, 225, 315])
def test_a_plane_is_as_bright_as_its_normal_says(slope: float, toward_deg: float) -> None:
    # A plane that rises by `slope` to where `toward_deg` points, clockwise from the top of the picture.
    row, col = np.mgrid[:6, :7] * np.array([2.0, 0.5])[:, None, None]
    east, north = np.sin(np.radians(toward_deg)), np.cos(np.radians(toward_deg))
    heights = slope * (col * east - row * north)
    normal = np.array([-slope * east, -slope * north, 1]) / np.hypot(slope, 1)
    light = np.array([-0.5, 0.5, np.sqrt(0.5)])  # from the north-west, half way up
    np.testing.assert_allclose(hillshade(heights, 2.0, 0.5), max(0.0, normal @ light), atol=1e-12)


def test_values_that_are_none_are_left_out(tmp_path: Path) -> None:
    heights = np.arange(12, dtype=np.float32).reshape(3, 4)
    heights[1, 2] = np.nan
    world = put_world(tmp_path, heights)
    values, grid, step = band_of(world / "dsm.tif")
    np.testing.assert_array_equal(values, heights)
    assert (grid.shape, step) == ((3, 4), 1)
