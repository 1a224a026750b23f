"""Lines against areas, and areas as fences: judged by shapely in a projection of the test's own."""

from __future__ import annotations

import functools
import itertools
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

from hrt_cli.errors import InputError
from hrt_cli.raster.aoi import Aoi
from hrt_cli.raster.grid import Grid

LON, LAT = 15.2, 47.1
WGS84 = CRS.from_epsg(4326)
LOCAL = f"+proj=aeqd +lat_0={LAT} +lon_0={LON} +datum=WGS84"
CLEAR_M = 0.02
"""Nearer than this it may depend on what a straight line is in which projection."""


def area(shape: Any, crs: int | CRS) -> Aoi:
    return Aoi(Path("area.geojson"), CRS.from_user_input(crs), shape)


@functools.cache
def between(source: Any, target: Any) -> Transformer:
    return Transformer.from_crs(source, target, always_xy=True)


def moved(shape: Any, source: Any, target: Any) -> Any:
    transformer = between(source, target)
    return shapely.transform(shape, lambda p: np.stack(transformer.transform(p[:, 0], p[:, 1]), axis=1))


offsets = st.tuples(st.floats(-200, 200), st.floats(-200, 200))


@settings(max_examples=60)
@given(
    crs=st.sampled_from([4326, 32633, 32632, 3857, 4258]),
    centre=offsets,
    size=st.floats(0.1, 150),
    hole=st.booleans(),
    line=st.lists(offsets, min_size=1, max_size=6),
)
def test_legs_meet_and_are_held_as_on_a_local_plane(
    crs: int, centre: tuple[float, float], size: float, hole: bool, line: list[tuple[float, float]]
) -> None:
    shape = shapely.Point(centre).buffer(size, quad_segs=3)
    if hole:
        shape = shape.difference(shapely.Point(centre).buffer(size * 0.6, quad_segs=2))
    drawn = area(moved(shape, LOCAL, crs), crs)
    points = shapely.get_coordinates(moved(shapely.MultiPoint(line), LOCAL, 4326))
    met, held = drawn.meets(points), drawn.holds(points)
    legs = [shapely.LineString(leg) for leg in itertools.pairwise(line)] or [shapely.Point(line[0])]
    assert met.shape == held.shape == (len(legs),)
    for leg, is_met, is_held in zip(legs, met, held, strict=True):
        if shapely.distance(leg, shape.boundary) > CLEAR_M:
            assert is_met == leg.intersects(shape)
            assert is_held == leg.within(shape)
        assert is_met or not is_held


def test_positions_may_be_given_in_another_crs() -> None:
    drawn = area(shapely.box(500_000, 5_000_000, 500_010, 5_000_010), 32633)
    line = [(499_990, 5_000_005), (500_005, 5_000_005), (500_006, 5_000_005), (500_020, 5_000_020)]
    assert drawn.meets(line, CRS.from_epsg(32633)).tolist() == [True, True, True]
    assert drawn.holds(line, CRS.from_epsg(32633)).tolist() == [False, True, False]
    assert drawn.meets([line[0]], CRS.from_epsg(32633)).tolist() == [False]


def test_a_touch_is_a_meeting_and_an_edge_still_inside() -> None:
    drawn = area(shapely.box(0, 0, 1, 1), 4326)
    assert drawn.meets([(1, 0.5), (2, 0.5)]).tolist() == [True]
    assert drawn.holds([(0, 0), (1, 0), (1, 1)]).tolist() == [True, True]
    assert drawn.meets([(1.0001, 0), (1.0001, 1)]).tolist() == [False]


def test_a_long_leg_is_straight_in_longitude_and_latitude() -> None:
    # 40 km along a parallel; its chord in UTM passes 30 m north of it.
    drawn = area(shapely.Point(*moved(shapely.Point(15.25, 47.1), 4326, 32633).coords[0]).buffer(3), 32633)
    assert drawn.meets([(15.0, 47.1), (15.5, 47.1)]).tolist() == [True]
    assert drawn.meets([(15.0, 47.1001), (15.5, 47.1001)]).tolist() == [False]


@pytest.mark.parametrize("crs", [4326, 32601, 4258])
def test_across_the_antimeridian(crs: int) -> None:
    west = shapely.box(179.999, -17.001, 180.0, -17.0)
    east = shapely.box(-180.0, -17.001, -179.999, -17.0)
    parts = shapely.MultiPolygon([west, east]) if crs in (4326, 4258) else None
    whole = shapely.box(179.999, -17.001, 180.001, -17.0)
    drawn = area(parts if parts else moved(whole, 4326, crs), crs)
    line = [(179.9995, -17.0005), (-179.9995, -17.0005), (-179.998, -17.0005), (-179.997, -17.0005)]
    assert drawn.holds(line).tolist() == [True, False, False]
    assert drawn.meets(line).tolist() == [True, True, False]
    for place in (32601, 32701, 32660, 4326):
        x, y = between(4326, place).transform(179.9985, -16.9995)
        size = 1e-5 if place == 4326 else 1.0
        grid = Grid(210, 330, Affine(size, 0, x, 0, -size, y), CRS.from_epsg(place))
        row, col = np.mgrid[:210, :330] + 0.5
        lon, lat = grid.lonlat(*grid.xy(row.ravel(), col.ravel()))
        inside = (abs(abs(lon) - 180) < 0.00098) & (lat < -17.00002) & (lat > -17.00098)
        outside = (abs(abs(lon) - 180) > 0.00102) | (lat > -16.99998) | (lat < -17.00102)
        held, touched = drawn.on(grid).held().ravel(), drawn.on(grid).touched().ravel()
        assert inside.sum() > 1000
        assert held[inside].all()
        assert touched[inside].all()
        assert not touched[outside].any()
    lons = drawn.lonlat_polygons()[0][0][:, 0]
    assert (abs(lons) <= 180).all()
    assert (abs(lons) > 179.99).all()


def test_a_position_without_a_place_is_refused() -> None:
    with pytest.raises(InputError, match=r"area\.geojson: cannot be compared with a line"):
        area(shapely.box(0, 0, 1, 1), 32633).meets([(15, 91), (15, 92)])


@pytest.mark.parametrize("crs", [32633, 3857, 2154])
def test_fences_follow_edges_that_bend(crs: int) -> None:
    place = (2.0, 46.5) if crs == 2154 else (LON, LAT)
    x, y = between(4326, crs).transform(*place)
    shape = shapely.box(x, y, x + 8000, y + 5000).difference(shapely.box(x + 100, y + 100, x + 900, y + 300))
    other = shapely.box(x - 9000, y, x - 1000, y + 50)
    ((outer, holes), (second, none)) = area(shapely.MultiPolygon([shape, other]), crs).lonlat_polygons()
    assert len(holes) == 1
    assert not none
    for ring, drawn in ((outer, shape.exterior), (holes[0], shape.interiors[0]), (second, other.exterior)):
        assert (ring[0] == ring[-1]).all()
        fence = shapely.segmentize(shapely.LineString(ring), 1e-4)
        assert shapely.hausdorff_distance(moved(fence, 4326, crs), drawn, densify=0.01) < 1000  # the same ring
        assert shapely.distance(shapely.points(shapely.get_coordinates(moved(fence, 4326, crs))), drawn).max() < 0.05
        assert len(ring) < 300


def test_fences_in_longitude_and_latitude_are_the_file_s() -> None:
    shape = shapely.box(8, 47, 9, 48)
    ((outer, holes),) = area(shape, 4326).lonlat_polygons()
    np.testing.assert_array_equal(outer, shapely.get_coordinates(shape.exterior))
    assert not holes
