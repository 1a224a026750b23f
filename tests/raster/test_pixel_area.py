"""Which pixels an area touches and which it holds, against shapely's distances between every pixel and the area."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from affine import Affine
from hypothesis import given, settings
from hypothesis import strategies as st
from pyproj import Transformer
from rasterio.crs import CRS

from hrt_cli.raster import pixel_area
from hrt_cli.raster.aoi import Aoi
from hrt_cli.raster.grid import Grid
from hrt_cli.raster.pixel_area import TOUCH_PX, PixelArea

ROWS, COLS = 14, 19
GRID = Grid(ROWS, COLS, Affine(1, 0, 500_000, 0, -1, 5_000_000), CRS.from_epsg(32633))
ROUNDING = 1e-6


def squares(grid: Grid) -> Any:
    """Return every pixel as a closed square in (col, row)."""
    row, col = np.mgrid[: grid.rows, : grid.cols]
    return shapely.box(col, row, col + 1, row + 1)


def on_pixels(shape: Any, grid: Grid = GRID) -> PixelArea:
    """Place a shape that is drawn in pixels (col, row)."""
    assert grid.crs is not None
    on_map = shapely.transform(shape, lambda p: np.stack(grid.xy(p[:, 1], p[:, 0]), axis=1))
    return Aoi(Path("area.geojson"), grid.crs, on_map).on(grid)


@st.composite
def shapes(draw: st.DrawFn) -> Any:
    """Draw polygons from a hundredth of a pixel to all of the grid; corners often on corners and edges of pixels."""
    parts = []
    for _ in range(draw(st.integers(1, 3))):
        col, row = draw(st.floats(-3, COLS + 3)), draw(st.floats(-3, ROWS + 3))
        count = draw(st.integers(3, 9))
        radii = np.array(draw(st.lists(st.floats(0.2, 1), min_size=count, max_size=count)))
        angles = np.arange(count) / count * 2 * np.pi + draw(st.sampled_from([0, np.pi / 4, 0.3]))
        size = draw(st.sampled_from([0.02, 0.7, 3, 12]))
        corners = [col, row] + (radii * size)[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        if draw(st.booleans()):
            corners = np.round(corners)
        shape = shapely.make_valid(shapely.Polygon(corners))
        if draw(st.booleans()):
            shape = shape.difference(shapely.Point(col, row).buffer(size * draw(st.floats(0.1, 0.5))))
        parts += [part for part in shapely.get_parts(shape) if isinstance(part, shapely.Polygon)]
    return shapely.union_all(parts)


@settings(max_examples=150)
@given(shape=shapes(), reach=st.sampled_from([0.0, 0.3, 1.0, 2.7]))
def test_a_pixel_is_touched_or_held_as_its_distance_says(shape: Any, reach: float) -> None:
    area = on_pixels(shape)
    away = shapely.distance(squares(GRID), shape)
    touched = area.touched(reach)
    assert touched[away <= reach].all()
    assert not touched[~(away <= reach + TOUCH_PX + ROUNDING)].any()
    inside = shapely.covers(shape, squares(GRID))
    from_edge = shapely.distance(squares(GRID), shape.boundary)
    held = area.held(reach)
    assert (inside & (from_edge > reach))[held].all()
    assert held[inside & (from_edge > reach + TOUCH_PX + ROUNDING)].all()


def test_a_corner_in_common_is_a_touch() -> None:
    area = on_pixels(shapely.box(3, 4, 5, 6))
    assert np.argwhere(area.touched()).tolist() == [[r, c] for r in range(3, 7) for c in range(2, 6)]
    assert not area.held().any()
    grown = on_pixels(shapely.box(2.9, 3.9, 5.1, 6.1))
    assert np.argwhere(grown.held()).tolist() == [[r, c] for r in (4, 5) for c in (3, 4)]


def test_an_area_far_smaller_than_a_pixel_is_not_lost() -> None:
    area = on_pixels(shapely.box(7.3, 8.3, 7.301, 8.301))
    assert np.argwhere(area.touched()).tolist() == [[8, 7]]


def test_it_does_not_matter_how_many_edges_are_worked_on_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    area = on_pixels(shapely.Point(9, 7).buffer(6).difference(shapely.Point(9, 7).buffer(2.2)))
    touched, held = area.touched(0.5), area.held(0.5)
    assert touched.any()
    assert held.any()
    for pairs in (1, 7):
        monkeypatch.setattr(pixel_area, "_PAIRS", pairs)
        np.testing.assert_array_equal(area.touched(0.5), touched)
        np.testing.assert_array_equal(area.held(0.5), held)


@pytest.mark.parametrize("lat", [0.0, 47.0, -75.0])
@pytest.mark.parametrize("turned", [False, True])
def test_edges_that_bend_on_the_map_are_followed(lat: float, turned: bool) -> None:
    # 20 km in cells of 80 m: a line along a parallel bends by metres on the map, a hundredth of a cell by centimetres.
    zone = 32633 if lat >= 0 else 32733
    x, y = Transformer.from_crs("OGC:CRS84", zone, always_xy=True).transform(15.6, lat)
    place = Affine.rotation(33 if turned else 0) @ Affine.scale(80, -80)
    grid = Grid(26, 250, Affine.translation(x, y + 1000) @ place, CRS.from_epsg(zone))
    shape = shapely.Polygon([(15.2, lat - 0.4), (16.3, lat - 0.4), (16.3, lat), (15.2, lat)])
    area = Aoi(Path("area.geojson"), CRS.from_epsg(4326), shape).on(grid)
    # The test follows every edge by positions ten metres apart.
    dense = shapely.segmentize(shape, 1e-4)
    to_map = Transformer.from_crs("OGC:CRS84", zone, always_xy=True)

    def on_grid(points: np.ndarray) -> np.ndarray:
        col, row = ~grid.transform @ to_map.transform(points[:, 0], points[:, 1])
        return np.stack([col, row], axis=1)

    drawn = shapely.transform(dense, on_grid)
    shapely.prepare(drawn)
    touched, held = area.touched(), area.held()
    assert 0 < touched.sum() < touched.size
    np.testing.assert_array_equal(touched | shapely.intersects(drawn, squares(grid)), touched)
    np.testing.assert_array_equal(held & shapely.contains_properly(drawn, squares(grid)), held)
    assert (touched & ~shapely.dwithin(drawn, squares(grid), 0.03)).sum() == 0
