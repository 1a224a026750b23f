from __future__ import annotations

import numpy as np
import pytest
from affine import Affine
from hypothesis import given
from hypothesis import strategies as st
from rasterio.crs import CRS
from rasterio.warp import transform

from hrt_cli.raster.grid import Grid
from hrt_cli.raster.tiles import Tiles
from hrt_cli.raster.windows import Window


@given(st.integers(-30, 30), st.integers(-30, 30), st.integers(1, 25), st.integers(1, 25), st.integers(1, 9))
def test_a_patch_is_what_the_window_holds(row: int, col: int, height: int, width: int, keep: int) -> None:
    def load(window: Window) -> np.ndarray:
        rows = np.arange(window.row, window.row + window.height)
        return rows[:, None] * 1000 + np.arange(window.col, window.col + window.width)

    tiles, window = Tiles(load, side=8, keep=keep), Window(row, col, height, width)
    for _ in range(2):
        np.testing.assert_array_equal(tiles.patch(window), load(window))


def test_the_last_tiles_are_kept_and_no_more() -> None:
    loaded: list[tuple[int, int]] = []

    def load(window: Window) -> np.ndarray:
        loaded.append((window.row, window.col))
        return np.zeros((window.height, window.width))

    tiles = Tiles(load, side=4, keep=2)
    for col in (0, 4, 0, 8, 0, 4):
        tiles.patch(Window(0, col, 4, 4))
    assert loaded == [(0, 0), (0, 4), (0, 8), (0, 4)]


@pytest.mark.parametrize("code", [32633, 4326, 3857])
@pytest.mark.parametrize("heading", [0.0, 37.0, 90.0, 200.0, -45.0])
def test_a_step_towards_a_heading_goes_there(code: int, heading: float) -> None:
    (x,), (y,) = transform("EPSG:4326", f"EPSG:{code}", [16.5], [45.0])
    pixel = 1e-6 if code == 4326 else 0.1
    place = Affine.translation(x, y) @ Affine.rotation(20) @ Affine.scale(pixel, -pixel)
    grid = Grid(100, 100, place, CRS.from_epsg(code))
    row, col = grid.steps_towards(10.0, 20.0, heading)
    rows, cols = np.array([10.0, 10 + row[0] * 5]), np.array([20.0, 20 + col[0] * 5])
    np.testing.assert_allclose(grid.ground_length_m(rows, cols), 5.0, rtol=1e-4)
    lon, lat = grid.lonlat(*grid.xy(rows, cols))
    east, north = np.diff(lon)[0] * np.cos(np.radians(45)), np.diff(lat)[0]
    off = (np.degrees(np.arctan2(east, north)) - heading + 180) % 360 - 180
    assert abs(off) < 0.3


def test_without_a_crs_north_is_up() -> None:
    row, col = Grid(9, 9, Affine.identity(), None).steps_towards([5, 5], 5, [0.0, 90.0])
    np.testing.assert_allclose((row, col), ([-1, 0], [0, 1]), atol=1e-12)
