"""The picture of a raster shows what is read of it: pixels, validity, and how the values lie."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from raster_files import UTM33, patches, write_raster
from world_files import place_of

from hrt_cli.artifacts.stage import REFUSE
from hrt_cli.errors import InputError, OutputError
from hrt_cli.report.figures.look import draw_raster


def put(path: Path, values: np.ndarray, **profile) -> Path:
    return write_raster(path, values, crs=UTM33, transform=place_of(0.1), **profile)


def draw(path: Path, picture: bool, **more) -> bool:
    return draw_raster([path], path.with_suffix(".png"), caption="a raster", picture=picture, existing=REFUSE, **more)


def test_a_picture_is_shown_as_it_is_seen(tmp_path: Path, drawn: list[Figure]) -> None:
    rgb = patches(40, 60)
    rgb[:, :10] = 0
    path = put(tmp_path / "o.tif", rgb, nodata=0)
    assert not draw(path, True)
    assert draw(path, True)
    axes, below = drawn[0].axes
    shown = np.asarray(axes.images[0].get_array())
    valid = (rgb != 0).any(axis=0)
    np.testing.assert_array_equal(shown[..., :3][valid], np.moveaxis(rgb, 0, -1)[valid])
    np.testing.assert_array_equal(shown[..., 3] > 0, valid)
    for line, band in zip(below.lines, rgb, strict=True):
        np.testing.assert_array_equal(line.get_ydata(), np.bincount(band[valid], minlength=256))
    (entry,) = axes.get_legend().get_texts()
    assert entry.get_text() == f"not valid, {1 - valid.mean():.1%}"
    with pytest.raises(OutputError, match="--overwrite"):
        draw(path, True, bands=(3, 2, 1))


def test_sixteen_bits_are_shown_stretched(tmp_path: Path, drawn: list[Figure]) -> None:
    draw(put(tmp_path / "o.tif", patches(40, 60).astype(np.uint16) * 7 + 300), True)
    counts = sum(line.get_ydata() for line in drawn[0].axes[1].lines)
    assert counts[:10].sum() > 0
    assert counts[-10:].sum() > 0


def test_values_are_shown_with_their_bar(tmp_path: Path, drawn: list[Figure]) -> None:
    heights = np.linspace(150, 160, 2400, dtype=np.float32).reshape(40, 60)
    heights[:4] = np.nan
    draw(put(tmp_path / "d.tif", heights[None], nodata=np.nan), False)
    axes, below = drawn[0].axes[:2]
    np.testing.assert_array_equal(np.ma.filled(axes.images[0].get_array(), np.nan), heights)
    assert sum(bar.get_height() for bar in below.patches) == 36 * 60
    assert axes.get_legend().get_texts()[0].get_text() == "not valid, 10.0%"


def test_values_without_a_place_are_shown_in_pixels(tmp_path: Path, drawn: list[Figure]) -> None:
    path = write_raster(tmp_path / "d.tif", np.arange(600, dtype=np.float32).reshape(1, 20, 30), crs=None)
    draw(path, False)
    assert any(text.get_text().endswith(" px") for text in drawn[0].axes[0].texts)
    with pytest.raises(InputError, match="give one of them"):
        draw_raster(
            [path, put(tmp_path / "e.tif", np.ones((1, 20, 30), np.float32))], tmp_path / "f.png", caption="",
            picture=False, existing=REFUSE,
        )  # fmt: skip
