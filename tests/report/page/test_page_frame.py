"""The page's ground: true metres, true north, whatever CRS the files have."""

from __future__ import annotations

import numpy as np
import pytest
from affine import Affine
from hypothesis import given
from hypothesis import strategies as st
from pyproj import Geod
from rasterio.crs import CRS

from hrt_cli.raster.grid import Grid
from hrt_cli.report.page.frame import Frame, frame_about, side_of, together

GEOD = Geod(ellps="WGS84")
UTM32 = Grid(400, 600, Affine(0.5, 0, 431_000, 0, -0.5, 5_210_000), CRS.from_epsg(32632))
TURNED = Grid(300, 300, Affine.translation(431_000, 5_210_000) @ Affine.rotation(30) @ Affine.scale(1, -1), UTM32.crs)
DEGREES = Grid(500, 500, Affine(1e-5, 0, 8.0, 0, -1e-5, 47.0), CRS.from_epsg(4326))
FEET = Grid(500, 500, Affine(1, 0, 2_000_000, 0, -1, 6_560_000), CRS.from_epsg(2225))


@pytest.mark.parametrize("grid", [UTM32, TURNED, DEGREES, FEET], ids=["utm", "turned", "degrees", "feet"])
def test_places_are_metres_east_and_north_as_a_geodesic_has_them(grid: Grid) -> None:
    rows, cols = np.array([0.0, grid.rows, grid.rows / 3]), np.array([0.0, grid.cols, grid.cols / 4])
    lon, lat = grid.lonlat(*grid.xy(rows, cols))
    frame = frame_about(lon.tolist(), lat.tolist())
    east, north = frame.of_cells(grid, rows, cols)
    azimuth, _, metres = GEOD.inv(np.full(3, frame.lon), np.full(3, frame.lat), lon, lat)
    np.testing.assert_allclose(np.hypot(east, north), metres, atol=2e-3)
    np.testing.assert_allclose(east, metres * np.sin(np.radians(azimuth)), atol=2e-3)
    affine, off = frame.affine_of(grid)
    assert off < 0.05
    col_east, col_north = np.array(affine @ (cols[2], rows[2])) - [east[2], north[2]]
    assert np.hypot(col_east, col_north) < 0.05 * max(grid.pixel_m)


def test_a_large_raster_in_degrees_is_known_to_be_bent() -> None:
    bent = Grid(600, 600, Affine(2e-4, 0, 8.0, 0, -2e-4, 60.0), CRS.from_epsg(4326))
    assert Frame(8.06, 59.94).affine_of(bent)[1] > 0.25


@given(
    lon=st.floats(-180, 180),
    lat=st.floats(-70, 70),
    east=st.floats(-1500, 1500),
    north=st.floats(-1500, 1500),
)
def test_a_page_tells_degrees_to_a_centimetre(lon: float, lat: float, east: float, north: float) -> None:
    frame = Frame(round(lon, 7), round(lat, 7))
    fit = frame.degrees_over((-1500.0, -1500.0, 1500.0, 1500.0))
    assert fit is not None
    u, v = (east - fit["middle"][0]) / fit["scale"], (north - fit["middle"][1]) / fit["scale"]  # type: ignore[index, operator]
    told_lon, told_lat = (
        sum(k * u**i * v**j for k, (i, j) in zip(fit[name], fit["powers"], strict=True))  # type: ignore[call-overload]
        for name in ("lon", "lat")
    )
    azimuth, _, metres = GEOD.inv(frame.lon, frame.lat, told_lon, told_lat)
    # The frame's own scale grows by d^2 / 2R^2 away from its meridian: 3e-8 here.
    assert abs(metres * np.sin(np.radians(azimuth)) - east) < 0.01
    assert abs(metres * np.cos(np.radians(azimuth)) - north) < 0.01


def test_a_site_across_the_meridian_180_has_its_middle_there() -> None:
    assert frame_about([179.99, -179.98], [10.0, 10.01]).lon == pytest.approx(-179.995)


def test_without_georeference_places_are_lengths_from_the_first_corner() -> None:
    cells = Grid(10, 20, Affine(2.0, 0, 0, 0, -2.0, 0), None)
    assert [np.asarray(each).tolist() for each in Frame().of_cells(cells, [0, 5], [0, 10])] == [[0, 20], [0, -10]]
    placeholder = Grid(10, 20, Affine(0.9996, 0, 0, 0, -0.9996, 0), CRS.from_epsg(32630))
    assert side_of(placeholder) == pytest.approx(placeholder.pixel_m[0], rel=1e-3)
    with pytest.raises(ValueError, match="without georeference"):
        Frame().of_lonlat([8.0], [47.0])


@given(st.lists(st.tuples(st.integers(0, 40), st.integers(0, 40), st.integers(1, 6), st.integers(1, 6)), max_size=9))
def test_what_lies_together_is_the_transitive_closure_of_what_lies_close(corners: list[tuple[int, ...]]) -> None:
    boxes = [(float(x), float(y), float(x + w), float(y + h)) for x, y, w, h in corners]

    def close(a: tuple[float, ...], b: tuple[float, ...]) -> bool:
        gap = max(max(a[0], b[0]) - min(a[2], b[2]), max(a[1], b[1]) - min(a[3], b[3]))
        return gap <= 0.5 * max(a[2] - a[0], a[3] - a[1], b[2] - b[0], b[3] - b[1])

    reach = np.array([[close(a, b) for b in boxes] for a in boxes], bool).reshape(len(boxes), len(boxes))
    for _ in boxes:
        reach = reach | (reach.astype(int) @ reach.astype(int) > 0)
    wanted = {tuple(np.flatnonzero(row).tolist()) for row in reach}
    assert {tuple(group) for group in together(boxes)} == wanted
