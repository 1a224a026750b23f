from __future__ import annotations

import math
import re

import numpy as np
import pytest
from affine import Affine
from hypothesis import given, settings
from hypothesis import strategies as st
from pyproj import CRS as ProjCRS
from pyproj import Geod, Transformer
from rasterio.crs import CRS

from hrt_cli.errors import InputError
from hrt_cli.raster.grid import Grid, require_measurable, require_same_grid, transform_points

pytestmark = pytest.mark.filterwarnings("ignore:Use `@` matmul:PendingDeprecationWarning")

QUICK = settings(deadline=None, max_examples=60)
GEOD = Geod(ellps="WGS84")
FOOT_M = 1200 / 3937

# name: (EPSG, x and y of the raster's middle, pixel width and height in CRS units, rotation in degrees)
PLACES = {
    "utm mid-zone": (32633, (500_000, 5_000_000), (0.1, 0.1), 0),
    "utm edge": (32633, (170_000, 200_000), (0.1, 0.1), 0),
    "utm south": (32733, (300_000, 6_200_000), (0.05, 0.05), 0),
    "us feet": (2225, (6_200_000, 2_000_000), (0.1 / FOOT_M, 0.1 / FOOT_M), 0),
    "degrees at the equator": (4326, (10, 0), (1e-6, 1e-6), 0),
    "degrees at 45": (4326, (10, 45), (1e-6, 1e-6), 0),
    "degrees at 70": (4326, (25, 70), (3e-6, 1e-6), 0),
    "web mercator at 48": (3857, (1_200_000, 6_106_855), (0.1, 0.1), 0),
    "world mercator": (3395, (1_200_000, 6_070_000), (0.1, 0.1), 0),
    "british national grid": (27700, (400_000, 300_000), (0.25, 0.25), 0),
    "rotated": (32633, (480_000, 5_000_000), (0.1, 0.1), 30),
    "rotated web mercator": (3857, (1_200_000, 6_106_855), (0.1, 0.1), 30),
    "not square": (32633, (480_000, 5_000_000), (0.1, 0.25), 0),
    "not square, rotated": (32633, (480_000, 5_000_000), (0.1, 0.25), -17),
}


def place(name: str, rows: int = 900, cols: int = 700) -> Grid:
    epsg, (x, y), (width, height), turn = PLACES[name]
    centred = Affine.translation(x, y) * Affine.rotation(turn) * Affine.scale(width, -height)
    return Grid(rows, cols, centred * Affine.translation(-cols / 2, -rows / 2), CRS.from_epsg(epsg))


def geodesic_m(grid: Grid, start: tuple[float, float], end: tuple[float, float]) -> float:
    """Length on the WGS 84 ellipsoid between two pixel positions (row, col), by pyproj alone."""
    to_lonlat = Transformer.from_crs(ProjCRS(grid.crs.to_wkt()), "EPSG:4326", always_xy=True)
    lon0, lat0 = to_lonlat.transform(*(grid.transform * start[::-1]))
    lon1, lat1 = to_lonlat.transform(*(grid.transform * end[::-1]))
    return GEOD.inv(lon0, lat0, lon1, lat1)[2]


@pytest.mark.parametrize("name", PLACES)
def test_the_ground_size_of_a_pixel_is_the_geodesic_one(name: str) -> None:
    grid = place(name)
    row, col = grid.rows / 2, grid.cols / 2
    # Over 200 pixels the two formulas of a short distance differ by less than 1e-6 of it.
    down = geodesic_m(grid, (row - 100, col), (row + 100, col)) / 200
    across = geodesic_m(grid, (row, col - 100), (row, col + 100)) / 200
    assert grid.pixel_m == pytest.approx((down, across), rel=2e-5)
    require_measurable("a.tif", grid)


@pytest.mark.parametrize("name", PLACES)
def test_the_length_of_a_path_is_the_geodesic_one(name: str) -> None:
    grid = place(name)
    rng = np.random.default_rng(1)
    rows, cols = rng.uniform(0, grid.rows, 30), rng.uniform(0, grid.cols, 30)
    legs = [geodesic_m(grid, (rows[i], cols[i]), (rows[i + 1], cols[i + 1])) for i in range(len(rows) - 1)]
    np.testing.assert_allclose(grid.ground_length_m(rows, cols), legs, rtol=2e-5)


@pytest.mark.parametrize("name", PLACES)
def test_cells_of_the_coarse_grid_are_square_metres_from_the_first_corner(name: str) -> None:
    grid = place(name)
    cells = grid.coarse(5.0)
    assert cells.xy(0, 0) == grid.xy(0, 0)
    middle = (cells.rows // 2, cells.cols // 2)
    assert geodesic_m(cells, middle, (middle[0] + 1, middle[1])) == pytest.approx(5.0, rel=1e-3)
    assert geodesic_m(cells, middle, (middle[0], middle[1] + 1)) == pytest.approx(5.0, rel=1e-3)
    # The cells end where the raster does, to half a cell.
    row, col = cells.rowcol(*map(float, grid.xy(grid.rows, grid.cols)))
    assert abs(cells.rows - row) <= 0.5
    assert abs(cells.cols - col) <= 0.5


def test_cells_are_whole_to_half_a_cell() -> None:
    grid = Grid(500, 300, Affine(0.1, 0, 0, 0, -0.1, 0), None)
    assert Grid(500, 300, grid.transform, None).coarse(10.0).shape == (50, 30)
    assert grid.coarse(7.0).shape == (71, 43)


def test_an_unreferenced_raster_is_measured_in_pixels() -> None:
    grid = Grid(20, 30, Affine.identity(), None)
    assert grid.pixel_m == (1.0, 1.0)
    assert grid.ground_length_m([0, 3], [0, 4]).tolist() == [5.0]
    assert grid.crs_text() is None
    assert grid.anchor == (0, 0)
    with pytest.raises(ValueError, match="no coordinate reference system"):
        grid.lonlat(0, 0)
    with pytest.raises(ValueError, match="no coordinate reference system"):
        grid.xy_of_lonlat(0, 0)


@pytest.mark.parametrize(
    ("epsg", "x", "y", "pixel"), [(4326, 180.0, 10.0, 1e-5), (32660, 833_000.0, 100_000.0, 0.5), (3832, 3.34e6, 0, 1)]
)
def test_the_antimeridian_is_no_wall(epsg: int, x: float, y: float, pixel: float) -> None:
    grid = Grid(100, 200, Affine(pixel, 0, x - 100 * pixel, 0, -pixel, y + 50 * pixel), CRS.from_epsg(epsg))
    require_measurable("a.tif", grid)
    expected = geodesic_m(grid, (50, 0), (50, 200))
    assert grid.ground_length_m([50, 50], [0, 200])[0] == pytest.approx(expected, rel=1e-5)
    assert grid.pixel_m[1] == pytest.approx(expected / 200, rel=1e-5)


def test_longitudes_are_given_from_minus_180_to_180() -> None:
    grid = Grid(10, 10, Affine(1e-5, 0, 190, 0, -1e-5, 10), CRS.from_epsg(4326))
    require_measurable("a.tif", grid)
    assert grid.lonlat([190.0, 350.0, 179.5], [1.0, 2.0, 3.0])[0].tolist() == [-170.0, -10.0, 179.5]


REFUSED = {
    "no area": (Affine(0.1, 0.1, 5e5, 0.1, 0.1, 5e6), 32633, "degenerate"),
    "nan": (Affine(math.nan, 0, 5e5, 0, -0.1, 5e6), 32633, "degenerate"),
    "infinite": (Affine(0.1, 0, math.inf, 0, -0.1, 5e6), 32633, "degenerate"),
    "sheared": (Affine(0.1, 0.05, 5e5, 0, -0.1, 5e6), 32633, "sheared"),
    "slivers": (Affine(0.1, 0, 5e5, 0, -0.5, 5e6), 32633, "too far from square"),
    "degrees of a high latitude as squares": (Affine(1e-6, 0, 10, 0, -1e-6, 80), 4326, "too far from square"),
    "a continent": (Affine(3000.0, 0, 0, 0, -3000.0, 8e6), 32633, "varies by"),
    "half the world": (Affine(0.1, 0, -90, 0, -0.1, 45), 4326, "varies by"),
    "beyond the pole": (Affine(1e-3, 0, 10, 0, -1e-3, 95), 4326, "place on the Earth"),
    "metres called degrees": (Affine(0.1, 0, 5e5, 0, -0.1, 5e6), 4326, "place on the Earth"),
    "local metres called degrees": (Affine(0.01, 0, 700, 0, -0.01, 50), 4326, "place on the Earth"),
    "off the projection": (Affine(0.1, 0, 5e12, 0, -0.1, 5e12), 32633, "place on the Earth"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_has_no_one_ground_size_is_refused(name: str) -> None:
    transform, epsg, problem = REFUSED[name]
    with pytest.raises(InputError, match=problem) as refusal:
        require_measurable("a.tif", Grid(1000, 1000, transform, CRS.from_epsg(epsg)))
    assert str(refusal.value).startswith("a.tif: ")


def test_a_local_crs_without_a_datum_is_refused() -> None:
    local = CRS.from_wkt('LOCAL_CS["site",UNIT["metre",1],AXIS["X",EAST],AXIS["Y",NORTH]]')
    with pytest.raises(InputError, match="no known place on the Earth"):
        require_measurable("a.tif", Grid(10, 10, Affine(0.1, 0, 0, 0, -0.1, 0), local))


def test_one_point_without_a_place_spoils_the_whole_call() -> None:
    with pytest.raises(ValueError, match="no place on the Earth"):
        transform_points(CRS.from_epsg(32633), CRS.from_epsg(4326), [5e5, 5e12], [5e6, 5e12])


offsets = st.integers(0, 60_000)


@QUICK
@given(offsets, offsets, st.sampled_from(sorted(PLACES)), st.sampled_from([0.0, 0.5, 0.25, 0.1]) | st.floats(-0.5, 0.5))
def test_crops_share_the_lattice_of_the_whole(top: int, left: int, name: str, phase: float) -> None:
    whole = place(name, 70_000, 70_000)
    # Crops made by GDAL have their origin rounded to what a double holds; 1e-9 px of noise must not matter.
    whole = Grid(whole.rows, whole.cols, whole.transform * Affine.translation(phase, phase / 2), whole.crs)
    crop = Grid(4000, 4000, whole.transform * Affine.translation(left, top), whole.crs)
    near = 0.3819660113  # the fraction at which the lattice is rounded: next to it, noise may decide
    row, col = whole.anchor
    _, _, (width, height), turn = PLACES[name]
    x, y = whole.transform * (0, 0)
    pixel_col, pixel_row = ~(Affine.rotation(turn) * Affine.scale(width, -height)) * (x, y)
    if any(abs((p + near) % 1 - round((p + near) % 1)) < 1e-4 for p in (pixel_row, pixel_col)):
        return
    assert crop.anchor == (row + top, col + left)


@pytest.mark.parametrize(("pixel", "x"), [(0.03, 412.32), (0.02, 512_345.62), (0.1, 499_999.9), (0.07, 350_000.07)])
def test_noise_in_the_origin_of_a_crop_does_not_move_its_lattice(pixel: float, x: float) -> None:
    # The origin is a whole number of pixels but for the last bits, as it is of most orthomosaics.
    origin = round(x / pixel) * pixel
    crs = CRS.from_epsg(32633)
    places = [Affine(pixel, 0, origin + i * pixel, 0, -pixel, origin - i * pixel) for i in range(3000)]
    anchors = np.array([Grid(9, 9, transform, crs).anchor for transform in places])
    np.testing.assert_array_equal(np.diff(anchors, axis=0), 1)


@QUICK
@given(st.sampled_from(sorted(PLACES)), st.floats(-50, 1000), st.floats(-50, 1000))
def test_positions_round_trip(name: str, row: float, col: float) -> None:
    grid = place(name)
    x, y = (float(v) for v in grid.xy(row, col))
    assert grid.rowcol(x, y) == pytest.approx((row, col), abs=1e-4)
    lon, lat = grid.lonlat(x, y)
    back = grid.xy_of_lonlat(float(lon[0]), float(lat[0]))
    assert grid.rowcol(*back) == pytest.approx((row, col), abs=2e-2)


def test_pixel_centres_lie_half_a_pixel_in() -> None:
    grid = Grid(10, 10, Affine(0.5, 0, 100, 0, -0.5, 200), CRS.from_epsg(32633))
    assert tuple(map(float, grid.xy(0.5, 0.5))) == (100.25, 199.75)


@pytest.mark.parametrize(
    ("epsg", "x", "y", "expected"),
    [
        (32630, 0.0, 0.0, True),
        (32630, 0.0, 800.0, True),
        (32630, 500_000.0, 0.0, False),
        (32630, 500_000.0, 4_000_000.0, False),
        (27700, 0.0, 0.0, False),
        (4326, 0.0, 0.0, False),
    ],
)
def test_a_made_up_place_is_known_as_one(epsg: int, x: float, y: float, expected: bool) -> None:
    grid = Grid(1000, 1000, Affine(0.1, 0, x, 0, -0.1, y), CRS.from_epsg(epsg))
    assert grid.placeholder_georeference is expected


def test_the_placeholder_of_opendronemap_is_known_by_its_proj_string() -> None:
    crs = CRS.from_string("+proj=utm +zone=30 +datum=WGS84 +units=m +no_defs")
    assert Grid(1000, 1000, Affine(0.1, 0, 0, 0, -0.1, 0), crs).placeholder_georeference


def test_a_crs_is_named_by_its_code_or_in_full() -> None:
    assert Grid(1, 1, Affine.scale(1), CRS.from_epsg(32633)).crs_text() == "EPSG:32633"
    odd = CRS.from_string("+proj=tmerc +lat_0=1.5 +lon_0=3.25 +k=0.9997 +x_0=1234 +datum=WGS84")
    assert "1234" in str(Grid(1, 1, Affine.scale(1), odd).crs_text())


class TestSameGrid:
    here = Grid(300, 400, Affine(0.1, 0, 5e5, 0, -0.1, 5e6), CRS.from_epsg(32633))

    def beside(self, grid: Grid) -> None:
        require_same_grid("b.tif", grid, "a.tif", self.here)

    @pytest.mark.parametrize("shift", [(0.1, 0), (0, -0.1), (0.005, 0), (1e6, 0)])
    def test_a_shift_is_refused(self, shift: tuple[float, float]) -> None:
        moved = Grid(300, 400, Affine.translation(*shift) * self.here.transform, self.here.crs)
        with pytest.raises(InputError, match=r"b.tif: does not lie on a.tif: the pixels are up to .* px apart"):
            self.beside(moved)

    def test_noise_passes(self) -> None:
        self.beside(Grid(300, 400, Affine(0.1 + 1e-12, 0, 5e5 + 1e-10, 0, -0.1, 5e6 - 1e-10), self.here.crs))

    def test_a_growing_offset_is_refused(self) -> None:
        with pytest.raises(InputError, match="px apart"):
            self.beside(Grid(300, 400, Affine(0.10001, 0, 5e5, 0, -0.1, 5e6), self.here.crs))

    def test_another_zone_is_refused(self) -> None:
        with pytest.raises(InputError, match="coordinate reference systems differ"):
            self.beside(Grid(300, 400, self.here.transform, CRS.from_epsg(32634)))

    def test_no_crs_is_refused(self) -> None:
        with pytest.raises(InputError, match="coordinate reference systems differ"):
            self.beside(Grid(300, 400, self.here.transform, None))

    def test_another_size_is_refused(self) -> None:
        with pytest.raises(InputError, match="400 x 300 pixels against 300 x 400"):
            self.beside(Grid(400, 300, self.here.transform, self.here.crs))

    @pytest.mark.parametrize("form", ["+proj=utm +zone=33 +datum=WGS84 +units=m +no_defs", "wkt", "wkt without codes"])
    def test_the_same_crs_written_otherwise_passes(self, form: str) -> None:
        wkt = CRS.from_epsg(32633).to_wkt()
        if form == "wkt without codes":
            crs = CRS.from_wkt(re.sub(r',AUTHORITY\["EPSG","\d+"\]', "", wkt))
        else:
            crs = CRS.from_wkt(wkt) if form == "wkt" else CRS.from_string(form)
        self.beside(Grid(300, 400, self.here.transform, crs))
