from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from affine import Affine
from hypothesis import given
from hypothesis import strategies as st
from pyproj import Transformer
from rasterio.crs import CRS
from rasterio.features import geometry_mask

from hrt_cli.errors import InputError
from hrt_cli.raster.aoi import Aoi, read_aoi
from hrt_cli.raster.grid import Grid
from hrt_cli.raster.pixel_area import PixelArea
from hrt_cli.raster.windows import Window

UTM = CRS.from_epsg(32633)
GRID = Grid(120, 160, Affine(0.1, 0, 500_000, 0, -0.1, 5_000_000), UTM)
WHOLE = Window(0, 0, 120, 160)
FIXTURES = Path(__file__).parents[2] / "fixtures"


def on_map(rows_cols: Any, grid: Grid = GRID) -> list[list[float]]:
    """Turn pixel positions into a closed ring of map coordinates."""
    x, y = grid.xy(*np.transpose(rows_cols))
    ring = [[float(a), float(b)] for a, b in zip(x, y, strict=True)]
    return ring if ring[0] == ring[-1] else [*ring, ring[0]]


def lonlat(ring: list[list[float]], crs: str = "EPSG:32633") -> list[list[float]]:
    transformer = Transformer.from_crs(crs, "OGC:CRS84", always_xy=True)
    return [list(map(float, transformer.transform(x, y))) for x, y in ring]


def polygon(*rings: list[list[float]]) -> dict[str, Any]:
    return {"type": "Polygon", "coordinates": list(rings)}


def feature(geometry: Any) -> dict[str, Any]:
    return {"type": "Feature", "properties": {"name": "x"}, "geometry": geometry, "id": 7}


def collection(*geometries: Any, **members: Any) -> dict[str, Any]:
    return {"type": "FeatureCollection", "features": [feature(g) for g in geometries], "name": "any", **members}


def in_utm(*geometries: Any, name: str = "urn:ogc:def:crs:EPSG::32633") -> dict[str, Any]:
    return collection(*geometries, crs={"type": "name", "properties": {"name": name}})


def written(folder: Path, document: Any) -> Path:
    path = folder / "area.geojson"
    path.write_text(document if isinstance(document, str) else json.dumps(document), encoding="utf-8")
    return path


SQUARE = [(10, 20), (10, 60), (50, 60), (50, 20)]
HOLE = [(20, 30), (20, 40), (30, 40), (30, 30)]


def square_mask(hole: bool = False) -> np.ndarray:
    mask = np.zeros((120, 160), bool)
    mask[10:50, 20:60] = True
    mask[20:30, 30:40] &= not hole
    return mask


class TestRead:
    @pytest.mark.parametrize("hole", [False, True])
    @pytest.mark.parametrize("wrap", [lambda g: g, feature, collection, lambda g: {**g, "bbox": [0], "x": None}])
    def test_every_wrapping_of_a_polygon(self, tmp_path: Path, wrap: Any, hole: bool) -> None:
        # An edge on the boundary between two pixels is far from every centre: rounding decides nothing.
        rings = [lonlat(on_map(ring)) for ring in ([SQUARE, HOLE] if hole else [SQUARE])]
        area = read_aoi(written(tmp_path, wrap(polygon(*rings)))).on(GRID)
        np.testing.assert_array_equal(area.mask(WHOLE), square_mask(hole))

    def test_several_polygons_are_taken_together(self, tmp_path: Path) -> None:
        left, right, over = SQUARE, [(r, c + 60) for r, c in SQUARE], [(r + 5, c + 30) for r, c in SQUARE]
        multi = {"type": "MultiPolygon", "coordinates": [[lonlat(on_map(left))], [lonlat(on_map(right))]]}
        path = written(tmp_path, collection(multi, polygon(lonlat(on_map(over)))))
        expected = square_mask() | np.roll(square_mask(), 60, 1) | np.roll(square_mask(), (5, 30), (0, 1))
        np.testing.assert_array_equal(read_aoi(path).on(GRID).mask(WHOLE), expected)

    @pytest.mark.parametrize("name", ["EPSG:32633", "urn:ogc:def:crs:EPSG::32633", "urn:ogc:def:crs:EPSG:9.8:32633"])
    def test_a_crs_member_names_the_coordinates(self, tmp_path: Path, name: str) -> None:
        aoi = read_aoi(written(tmp_path, in_utm(polygon(on_map(SQUARE)), name=name)))
        assert aoi.crs == UTM
        np.testing.assert_array_equal(aoi.on(GRID).mask(WHOLE), square_mask())

    @pytest.mark.parametrize("name", ["urn:ogc:def:crs:OGC:1.3:CRS84", "OGC:CRS84", "urn:ogc:def:crs:EPSG::4326"])
    def test_longitude_comes_first_by_any_name(self, tmp_path: Path, name: str) -> None:
        aoi = read_aoi(written(tmp_path, in_utm(polygon(lonlat(on_map(SQUARE))), name=name)))
        np.testing.assert_array_equal(aoi.on(GRID).mask(WHOLE), square_mask())

    def test_heights_are_passed_over(self, tmp_path: Path) -> None:
        ring = [[*position, 417.5] for position in lonlat(on_map(SQUARE))]
        area = read_aoi(written(tmp_path, polygon(ring))).on(GRID)
        np.testing.assert_array_equal(area.mask(WHOLE), square_mask())

    @pytest.mark.parametrize("site", ["meadow", "wildfire", "reef"])
    def test_the_areas_of_the_sample_sites(self, site: str) -> None:
        assert read_aoi(FIXTURES / site / "aoi.geojson").shape.area > 0


RING = lonlat(on_map(SQUARE))
BAD: dict[str, tuple[Any, str]] = {
    "not json": ("{", "is not valid JSON"),
    "nan": ('{"type": "Polygon", "coordinates": [[[NaN, 1]]]}', "NaN is not a number"),
    "twice": ('{"type": "Polygon", "type": "Polygon"}', "stands twice"),
    "a list": ([1], "the document is no object"),
    "no type": ({"coordinates": []}, "an object has no type"),
    "a point": ({"type": "Point", "coordinates": [1, 2]}, "holds a Point; an area is made of Polygons"),
    "a line": (collection({"type": "LineString", "coordinates": RING}), "holds a LineString"),
    "topology": ({"type": "Topology"}, "holds a Topology"),
    "no features": ({"type": "FeatureCollection"}, "a FeatureCollection has no list of features"),
    "empty": (collection(), "holds no polygon"),
    "a feature that is none": ({"type": "FeatureCollection", "features": [polygon(RING)]}, "a feature that is none"),
    "no geometry": (collection(None), "a feature without geometry"),
    "a feature in itself": (feature(feature(polygon(RING))), "a feature without geometry"),
    "no coordinates": ({"type": "Polygon"}, "a Polygon has no list of coordinates"),
    "no rings": (polygon(), "without rings"),
    "open": (polygon(RING[:-1]), "not closed"),
    "short": (polygon(RING[:2] + RING[:1]), "fewer than four positions"),
    "flat": (polygon([RING[0], RING[1], RING[1], RING[0]]), "not valid"),
    "a bow tie": (polygon([RING[0], RING[2], RING[1], RING[3], RING[0]]), "not valid: Self-intersection at 15"),
    "a hole outside": (polygon(RING, [[x + 1, y] for x, y in RING]), "not valid: Hole lies outside"),
    "latitude": (polygon([[15, 105], [16, 105], [16, 106], [15, 105]]), r"\[15, 105\] is no longitude and latitude"),
    "longitude": (polygon([[181, 5], [182, 5], [182, 6], [181, 5]]), "is no longitude and latitude"),
    "metres without a crs": (polygon(on_map(SQUARE)), "is no longitude .* name the CRS in a crs member"),
    "a huge number": (polygon([[10**400, 5], [182, 5], [182, 6], [181, 5]]), "is no longitude and latitude"),
    "far away": (in_utm(polygon([[1e12, 5], [0, 5], [9, 6], [1e12, 5]])), "too far away to lie on the Earth"),
    "text": (polygon([["15", 5], [16, 5], [16, 6], ["15", 5]]), "which is no list of numbers"),
    "true": (polygon([[True, 5], [16, 5], [16, 6], [True, 5]]), "which is no list of numbers"),
    "one number": (polygon([[1], [2], [3], [1]]), "which is no list of numbers"),
    "null": (polygon([None, None, None, None]), "which is no list of numbers"),
    "an unknown crs": (in_utm(polygon(RING), name="EPSG:999999"), "names 'EPSG:999999', no CRS that is known"),
    "a crs by proj": (in_utm(polygon(RING), name="+proj=utm +zone=33"), "no CRS that is known"),
    "a crs by link": ({**polygon(RING), "crs": {"type": "link", "properties": {"href": "x"}}}, "names none"),
    "no crs": ({**polygon(RING), "crs": None}, "names none, no CRS that is known"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_is_no_area_is_refused_by_name(tmp_path: Path, name: str) -> None:
    document, problem = BAD[name]
    path = written(tmp_path, document)
    with pytest.raises(InputError, match=problem) as refusal:
        read_aoi(path)
    assert str(refusal.value).startswith(f"{path}: ")
    assert "\n" not in str(refusal.value)
    assert len(str(refusal.value)) < len(str(path)) + 200


def test_too_many_positions_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hrt_cli.raster.polygons.MAX_POSITIONS", 9)
    path = written(tmp_path, collection(polygon(RING), polygon(RING)))
    with pytest.raises(InputError, match="more than 9 positions"):
        read_aoi(path)


def pixel_area(shape: Any, grid: Grid = GRID) -> PixelArea:
    """Place a shapely geometry given in map coordinates of the grid's CRS."""
    assert grid.crs is not None
    return Aoi(Path("area.geojson"), grid.crs, shape).on(grid)


@st.composite
def stars(draw: st.DrawFn) -> Any:
    """Draw a star-shaped polygon, perhaps with a hole, about the grid; corners often on centres and edges of pixels."""
    step = draw(st.sampled_from([0.0, 0.5, 1.0]))
    row, col = draw(st.floats(-20, 140)), draw(st.floats(-20, 180))
    count = draw(st.integers(3, 12))
    angles = np.arange(count) / count * 2 * np.pi
    radii = np.array(draw(st.lists(st.floats(2, 90), min_size=count, max_size=count)))
    corners = np.stack([row + radii * np.sin(angles), col + radii * np.cos(angles)], axis=1)
    if step:
        corners = np.round(corners / step) * step
    shape = shapely.Polygon(corners)
    if draw(st.booleans()):
        shape = shape.difference(shapely.Point(row, col).buffer(draw(st.floats(1, 30))))
    return shapely.make_valid(shape)


def area_of_pixels(shape: Any) -> tuple[PixelArea, Any]:
    """Return the area of a shape drawn in pixels (row, col), and the shape as it came to lie, (col, row)."""
    on_the_map = shapely.transform(shape, lambda p: np.stack(GRID.xy(p[:, 0], p[:, 1]), axis=1))
    area = pixel_area(on_the_map)
    back = shapely.transform(on_the_map, lambda p: np.stack(~GRID.transform @ (p[:, 0], p[:, 1]), axis=1))
    return area, back


@given(shape=stars(), row=st.integers(-30, 130), col=st.integers(-30, 170), size=st.tuples(*[st.integers(1, 99)] * 2))
def test_the_answer_does_not_depend_on_the_window(shape: Any, row: int, col: int, size: tuple[int, int]) -> None:
    area, _ = area_of_pixels(shape)
    around = Window(-40, -40, 280, 320)
    window = Window(row, col, *size)
    shifted = Window(row + 40, col + 40, *size)
    np.testing.assert_array_equal(area.mask(window), area.mask(around)[shifted.slices])


@given(shape=stars())
def test_a_pixel_is_in_the_area_where_its_centre_is(shape: Any) -> None:
    area, drawn = area_of_pixels(shape)
    mask = area.mask(WHOLE)
    col, row = np.meshgrid(np.arange(160) + 0.5, np.arange(120) + 0.5)
    clear = ~shapely.dwithin(drawn.boundary, shapely.points(col, row), 1e-4)  # rounding on the map may decide others
    np.testing.assert_array_equal(mask[clear], shapely.contains_xy(drawn, col, row)[clear])
    if drawn.area:
        np.testing.assert_array_equal(mask[clear], ~geometry_mask([drawn], (120, 160), Affine.identity())[clear])


@given(shape=stars())
def test_the_bounds_hold_every_pixel_of_the_area(shape: Any) -> None:
    area, drawn = area_of_pixels(shape)
    mask = area.mask(WHOLE)
    outside = mask.copy()
    outside[area.bounds.slices] = False
    assert not outside.any()
    if area.bounds.height and area.bounds.width:
        left, top, right, bottom = drawn.bounds
        assert area.bounds.row >= math.floor(top - 1e-6)
        assert area.bounds.col >= math.floor(left - 1e-6)
        assert area.bounds.row + area.bounds.height <= math.ceil(bottom + 1e-6)
        assert area.bounds.col + area.bounds.width <= math.ceil(right + 1e-6)


@pytest.mark.parametrize("lat", [0.0, 47.0, -75.0])
def test_long_edges_are_straight_in_the_files_coordinates(lat: float) -> None:
    # 12 km along a parallel: the straight line between its ends in UTM lies metres away from it.
    zone = "EPSG:32633" if lat >= 0 else "EPSG:32733"
    to_map = Transformer.from_crs("OGC:CRS84", zone, always_xy=True)
    x, y = to_map.transform(15.5, lat)
    grid = Grid(2000, 120_000, Affine(0.1, 0, x, 0, -0.1, y + 100), CRS.from_user_input(zone))
    shape = shapely.box(15.3, lat - 1, 15.9, lat)
    area = Aoi(Path("area.geojson"), CRS.from_epsg(4326), shape).on(grid)
    to_earth = Transformer.from_crs(zone, "OGC:CRS84", always_xy=True)
    for col in range(0, 120_000, 7_001):
        window = Window(0, col, 2000, 3)
        rows, cols = np.mgrid[:2000, col : col + 3] + 0.5
        lon, latitude = to_earth.transform(*grid.xy(rows, cols))
        metres = (np.asarray(latitude) - lat) * 111_000
        found = area.mask(window)
        clear = np.abs(metres) > 0.002  # a fiftieth of a pixel
        inside = (np.asarray(latitude) < lat) & (np.asarray(lon) > 15.3) & (np.asarray(lon) < 15.9)
        np.testing.assert_array_equal(found[clear], inside[clear])


def test_an_area_larger_than_any_map_covers_all() -> None:
    world = Aoi(Path("area.geojson"), CRS.from_epsg(4326), shapely.box(-180, -90, 180, 90))
    for place, crs in (((500_000, 5_000_000), 32633), ((500_000, 100), 32601), ((0, 0), 3031), ((1e6, 5e6), 3857)):
        grid = Grid(50, 60, Affine(0.1, 0, place[0], 0, -0.1, place[1]), CRS.from_epsg(crs))
        area = world.on(grid)
        assert area.mask(Window(0, 0, 50, 60)).all()
        assert area.bounds == Window(0, 0, 50, 60)


def test_an_area_that_misses_the_raster_is_refused_with_both_names(tmp_path: Path) -> None:
    path = written(tmp_path, polygon([[x + 1, y] for x, y in RING]))
    aoi = read_aoi(path)
    assert not aoi.on(GRID).mask(WHOLE).any()
    with pytest.raises(InputError, match=r"area\.geojson: lies outside ortho\.tif$"):
        aoi.require_on(GRID, "ortho.tif")


def test_longitude_and_latitude_exchanged_are_suspected(tmp_path: Path) -> None:
    path = written(tmp_path, polygon([[y, x] for x, y in RING]))
    with pytest.raises(InputError, match=r"lies outside ortho\.tif \(longitude and latitude seem to be exchanged"):
        read_aoi(path).require_on(GRID, "ortho.tif")


def test_a_grid_without_a_crs_has_no_place_for_an_area(tmp_path: Path) -> None:
    grid = Grid(120, 160, Affine.identity(), None)
    with pytest.raises(InputError, match="has no coordinate reference system"):
        read_aoi(written(tmp_path, polygon(RING))).require_on(grid, "a.png")
