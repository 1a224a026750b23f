"""A folder of rasters as a site to drive in: what it holds, on what grid, and what is refused."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from pyproj import Geod, Transformer
from raster_files import UTM33, write_raster
from world_files import GRASS, ORIGIN, SCALE, WALL, chequers, place_of, put_truth, put_world

from hrt_cli.errors import InputError
from hrt_cli.raster.grid import Grid
from hrt_cli.world.site import SLIPS_FROM, STEEPEST, STEP_M, STEP_REACH_M, UNKNOWN, load_site, site_files, upright

REAL = Path(__file__).parents[2].parent / "shared" / "data" / "brighton_beach"
FLAT = np.full((80, 100), 10.0, np.float32)


def quarters(rows: int = 80, cols: int = 100) -> np.ndarray:
    """Class 0 everywhere but 1 in the lower right quarter."""
    row, col = np.mgrid[:rows, :cols]
    return ((row >= rows // 2) & (col >= cols // 2)).astype(np.uint8)


def refusal(folder: Path) -> str:
    with pytest.raises(InputError) as error:
        load_site(folder)
    return str(error.value)


def test_a_world_of_two_rasters(tmp_path: Path) -> None:
    site = load_site(put_world(tmp_path / "w", FLAT))
    assert site.grid.shape == site.classes.shape == site.surface_m.shape == site.rgb.shape[:2] == (80, 100)
    assert site.pixel_m == pytest.approx(0.1, rel=1e-5)
    assert (site.classes == UNKNOWN).all()
    assert site.seen.all()
    assert not site.obstacle.any()
    assert (site.clearance_m > 100).all()
    np.testing.assert_array_equal(np.moveaxis(site.rgb, -1, 0), chequers(80, 100))
    np.testing.assert_allclose(site.speed_factor, 1.0)
    np.testing.assert_allclose(site.ground_m, 10.0, atol=1e-4)
    assert (site.target, site.names, site.under_water) == (None, {}, False)
    for name in ("rgb", "surface_m", "ground_m", "seen", "classes", "speed_factor", "obstacle", "clearance_m"):
        assert getattr(site, name).shape[:2] == site.grid.shape, name


@pytest.mark.parametrize("gone", ["ortho.tif", "dsm.tif"])
def test_a_file_that_is_needed_and_absent_is_named(tmp_path: Path, gone: str) -> None:
    folder = put_world(tmp_path / "w", FLAT)
    (folder / gone).unlink()
    assert f"holds no {gone}" in refusal(folder)


def test_what_is_no_folder_of_a_world_is_named(tmp_path: Path) -> None:
    assert "no such folder" in refusal(tmp_path / "absent")
    (tmp_path / "file").touch()
    assert "is a file; a world is a folder" in refusal(tmp_path / "file")


def test_classes_and_their_drivability_go_together(tmp_path: Path) -> None:
    folder = put_world(tmp_path / "w", FLAT, classes=quarters())
    assert set(site_files(folder)) == {"ortho", "dsm", "truth", "world"}
    text = (folder / "world.json").read_text()
    (folder / "world.json").unlink()
    assert "holds truth.tif but no world.json" in refusal(folder)
    (folder / "truth.tif").rename(folder / "classes.tif")
    assert "holds classes.tif but no world.json" in refusal(folder)
    (folder / "world.json").write_text(text)
    assert load_site(folder).names == {0: "grass", 1: "wall"}
    (folder / "classes.tif").unlink()
    assert "holds world.json but no truth.tif" in refusal(folder)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"classes": {"0": GRASS}}, "says nothing of class 1, which truth.tif holds"),
        ({"classes": {"0": GRASS, "1": WALL}, "target_class": "moss"}, "looks for the class 'moss'"),
        ({"classes": {"0": GRASS, "1": {"drivability": 1.5}}}, "drivability"),
        ({"classes": {"0": GRASS, "255": WALL}}, "not a class id"),
        ({"classes": {"0": GRASS, "01": WALL}}, "not a class id"),
        ({"classes": {}}, "classes"),
        ({"classes": {"0": GRASS}, "clases": {}}, "clases"),
    ],
)
def test_a_world_that_does_not_say_what_is_needed(tmp_path: Path, content: dict, message: str) -> None:
    folder = put_world(tmp_path / "w", FLAT, classes=quarters())
    (folder / "world.json").write_text(json.dumps({"format": "hrt-world", **content}))
    found = refusal(folder)
    assert message in found
    assert "world.json" in found


def test_drivability_obstacles_target_and_water(tmp_path: Path) -> None:
    table = {"0": {"name": "grass", "drivability": 0.6}, "1": WALL, "7": {"name": "none here", "drivability": 0.1}}
    folder = put_world(tmp_path / "w", FLAT, classes=quarters(), table=table, target_class="wall", scene="reef")
    site = load_site(folder)
    np.testing.assert_array_equal(site.classes, quarters())
    np.testing.assert_array_equal(site.obstacle, quarters() == 1)
    np.testing.assert_allclose(site.speed_factor[quarters() == 0], 0.6, rtol=1e-5)
    assert site.names[7] == "none here"
    assert site.target == 1
    assert site.under_water
    assert site.clearance_m[40, 20] == pytest.approx(3.0, rel=1e-4)


@pytest.mark.parametrize("climb", [0.2, 0.3, 0.43])
def test_tall_things_are_obstacles_and_slopes_slow_down(tmp_path: Path, climb: float) -> None:
    _row, col = np.mgrid[:150, :150]
    surface = (climb * 0.1 * col).astype(np.float32)
    box = np.s_[70:80, 70:80]
    surface[box] += np.float32(1.0)
    site = load_site(put_world(tmp_path / "w", surface))
    assert site.obstacle[box].mean() > 0.9
    # The box, and the foot of its walls, up to the two pixels away from which they are a step.
    around = np.zeros(surface.shape, np.bool_)
    around[68:82, 68:82] = True
    assert not (site.obstacle & ~around).any()
    assert np.median(site.speed_factor) == pytest.approx(1.0, abs=0.01)
    steep = load_site(put_world(tmp_path / "steep", (0.58 * 0.1 * col).astype(np.float32)))
    middle = steep.speed_factor[40:110, 60:90]
    assert np.median(middle) == pytest.approx((STEEPEST - 0.58) / (STEEPEST - SLIPS_FROM), abs=0.02)
    assert (site.ground_m <= site.surface_m + 1e-6).all()


def test_heights_in_feet_and_voids_that_nothing_declares_are_what_they_are(tmp_path: Path) -> None:
    _row, col = np.mgrid[:80, :80]
    surface = (0.3 * 0.1 * col).astype(np.float32)
    surface[30:40, 30:40] += np.float32(1.0)
    site = load_site(put_world(tmp_path / "metres", surface))
    feet = put_world(tmp_path / "feet", surface / np.float32(0.3048))
    with rasterio.open(feet / "dsm.tif", "r+") as dataset:
        dataset.units = ("ft",)
    np.testing.assert_allclose(load_site(feet).surface_m, site.surface_m, atol=1e-4)
    np.testing.assert_array_equal(load_site(feet).obstacle, site.obstacle)
    surface[:10] = -9999.0
    with_void = load_site(put_world(tmp_path / "void", surface))
    assert not with_void.seen[:10].any()
    assert with_void.surface_m.min() > -1


@pytest.mark.parametrize("pixel_m", [0.05, 0.1])
@pytest.mark.parametrize(
    ("kerb_m", "climb", "stops"),
    [(0.4, 0.0, True), (0.4, 0.3, True), (STEP_M + 0.05, 0.0, True), (STEP_M - 0.05, 0.0, False), (0.15, 0.3, False),
     (0.0, 0.3, False)],
)  # fmt: skip
def test_a_step_is_an_obstacle_and_a_slope_is_none(
    tmp_path: Path, pixel_m: float, kerb_m: float, climb: float, stops: bool
) -> None:
    """A kerb in the middle of a slope, wider than anything that stands on the ground."""
    rows, cols = round(3 / pixel_m), round(30 / pixel_m)
    surface = np.broadcast_to(climb * pixel_m * np.arange(rows)[:, None], (rows, cols)).copy()
    surface[:, cols // 2 :] += kerb_m
    site = load_site(put_world(tmp_path / "w", surface, pixel_m=pixel_m))
    near = np.zeros(cols, np.bool_)
    reach = math.ceil(STEP_REACH_M / 2 / pixel_m)
    near[cols // 2 - reach : cols // 2 + reach] = True
    assert not site.obstacle[:, ~near].any()
    if stops:
        assert site.obstacle[:, cols // 2 - 1 : cols // 2 + 1].all()
    else:
        assert not site.obstacle.any()


def test_where_no_height_is_known_there_is_no_step(tmp_path: Path) -> None:
    surface = FLAT.copy()
    surface[:, 50:] += np.float32(1.0)
    surface[:, 40:60] = np.nan
    site = load_site(put_world(tmp_path / "w", surface))
    assert not site.obstacle[:, 41:59].any()


def test_gaps_in_heights_and_colours_are_not_seen(tmp_path: Path) -> None:
    surface = FLAT.copy()
    surface[20:40, 30:50] = np.nan
    folder = put_world(tmp_path / "w", surface)
    mask = np.ones((80, 100), np.bool_)
    mask[60:, :10] = False
    write_raster(folder / "ortho.tif", chequers(80, 100), mask=mask, transform=place_of(0.1))
    site = load_site(folder)
    expected = mask & np.isfinite(surface)
    assert (site.seen == expected).mean() > 0.99
    assert np.isfinite(site.surface_m).all()
    np.testing.assert_allclose(site.surface_m, 10.0, atol=1e-3)
    assert not site.obstacle.any()
    assert site.rgb.min() >= 119
    assert not site.is_seen(4.0, 3.0)
    assert site.is_seen(1.5, 1.5)
    assert not site.is_seen(-0.01, 1.0)
    assert not site.is_seen(1.0, 8.01)


def test_a_dsm_without_heights_or_elsewhere_is_refused(tmp_path: Path) -> None:
    folder = put_world(tmp_path / "w", FLAT * np.nan)
    assert "holds no height on the orthomosaic" in refusal(folder)
    write_raster(folder / "dsm.tif", FLAT, transform=Affine(0.1, 0, 600_000, 0, -0.1, 5_000_000))
    found = refusal(folder)
    assert "dsm.tif" in found
    assert "beside" in found
    write_raster(folder / "dsm.tif", FLAT, crs=None, transform=place_of(0.1))
    assert "dsm.tif" in refusal(folder)


@pytest.mark.parametrize("pixel_m", [0.05, 0.25, 0.7])
def test_a_dsm_of_another_resolution(tmp_path: Path, pixel_m: float) -> None:
    folder = put_world(tmp_path / "w", FLAT)
    side = (round(8 / pixel_m) + 2, round(10 / pixel_m) + 2)
    col = (np.arange(side[1]) + 0.5) * pixel_m
    write_raster(folder / "dsm.tif", np.broadcast_to((0.1 * col).astype(np.float32), side), transform=place_of(pixel_m))
    site = load_site(folder)
    expected = 0.1 * (np.arange(100) + 0.5) * 0.1
    np.testing.assert_allclose(site.surface_m[40, 10:90], expected[10:90], atol=0.02)


def test_a_dsm_and_truth_in_another_crs(tmp_path: Path) -> None:
    folder = put_world(tmp_path / "w", FLAT)
    to = Transformer.from_crs(UTM33, "EPSG:4326", always_xy=True)
    lon, lat = to.transform(ORIGIN[0] - 2, ORIGIN[1] + 2)
    step = 0.1 / 111_000
    transform = Affine(step / math.cos(math.radians(lat)), 0, lon, 0, -step, lat)
    col = (np.arange(160) * 0.1 - 2.0).astype(np.float32)
    write_raster(folder / "dsm.tif", np.broadcast_to(10 + 0.1 * col, (140, 160)), crs="EPSG:4326", transform=transform)
    classes = np.broadcast_to(np.where(col < 5, 0, 1), (140, 160))
    put_truth(folder, classes, {"0": GRASS, "1": WALL}, crs="EPSG:4326", transform=transform)
    site = load_site(folder)
    np.testing.assert_allclose(site.surface_m[40], 10 + 0.1 * (np.arange(100) + 0.5) * 0.1, atol=0.02)
    assert (site.classes[:, :48] == 0).all()
    assert (site.classes[:, 52:] == 1).all()


def test_an_orthomosaic_in_degrees_has_square_ground_pixels(tmp_path: Path) -> None:
    step = 1e-6
    transform = Affine(step, 0, 15.0, 0, -step, 45.0)
    folder = put_world(tmp_path / "w", np.full((120, 160), 5, np.float32), crs="EPSG:4326", transform=transform)
    site = load_site(folder)
    east, north = Geod(ellps="WGS84").inv(15.0, 45.0, 15.0 + 160 * step, 45.0)[2], 120 * step * 111_132
    assert site.pixel_m == pytest.approx(0.1111, abs=0.001)
    assert site.grid.cols * site.pixel_m == pytest.approx(east, abs=site.pixel_m)
    assert site.grid.rows * site.pixel_m == pytest.approx(north, abs=site.pixel_m)
    assert site.grid.pixel_m == pytest.approx((site.pixel_m, site.pixel_m), rel=1e-4)


@pytest.mark.parametrize("turn", [0.0, 30.0, 90.0, 200.0])
def test_a_turned_orthomosaic_knows_where_up_is(tmp_path: Path, turn: float) -> None:
    transform = place_of(0.1) @ Affine.rotation(turn)
    classes = quarters()
    site = load_site(put_world(tmp_path / "w", FLAT, classes=classes, transform=transform))
    np.testing.assert_array_equal(site.classes, classes)
    assert math.degrees(site.up_bearing_rad) % 360 == pytest.approx(pyproj_up_bearing(site.grid) % 360, abs=0.2)


def pyproj_up_bearing(grid: Grid) -> float:
    to = Transformer.from_crs(grid.crs.to_wkt(), "EPSG:4326", always_xy=True)
    x, y = grid.xy([grid.rows / 2 + 5, grid.rows / 2 - 5], [grid.cols / 2, grid.cols / 2])
    lon, lat = to.transform(x, y)
    return Geod(ellps="WGS84").inv(lon[0], lat[0], lon[1], lat[1])[0]


def test_up_is_true_north_plus_the_convergence_of_the_meridians(tmp_path: Path) -> None:
    transform = Affine(0.1, 0, 330_000, 0, -0.1, 6_900_000)
    site = load_site(put_world(tmp_path / "w", FLAT, transform=transform))
    expected = pyproj_up_bearing(site.grid)
    assert abs(expected) > 2
    assert math.degrees(site.up_bearing_rad) == pytest.approx(expected, abs=0.01)


def test_a_mirrored_orthomosaic_is_turned_upright(tmp_path: Path) -> None:
    """South up: the first row lies in the south."""
    side = 0.1 * SCALE
    south_up = Affine(side, 0, ORIGIN[0], 0, side, ORIGIN[1] - 80 * side)
    plain = load_site(put_world(tmp_path / "a", FLAT, classes=quarters()))
    folder = put_world(tmp_path / "b", FLAT, classes=quarters()[::-1], transform=south_up)
    turned = load_site(folder)
    a, b, _, d, e, _ = turned.grid.transform[:6]
    assert a * e - b * d < 0
    np.testing.assert_array_equal(turned.classes, plain.classes)
    np.testing.assert_allclose(turned.map_xy(np.array([[1.0, 2.0]])), plain.map_xy(np.array([[1.0, 2.0]])), atol=1e-3)
    assert upright(plain.grid) is plain.grid


@pytest.mark.parametrize(("fine_m", "asked", "pixel_m"), [(0.03, None, 0.05), (0.03, 0.2, 0.2), (0.1, 0.02, 0.1)])
def test_pixels_are_no_finer_than_is_of_use(tmp_path: Path, fine_m: float, asked: float | None, pixel_m: float) -> None:
    rows, cols = 200, 300
    row, col = np.mgrid[:rows, :cols]
    classes = ((row * fine_m > 3.0) & (col * fine_m > 4.5)).astype(np.uint8)
    rgb = np.where(classes, 200, 50).astype(np.uint8)[None].repeat(3, axis=0)
    folder = put_world(tmp_path / "w", np.zeros((rows, cols)), classes=classes, rgb=rgb, pixel_m=fine_m)
    site = load_site(folder, asked)
    assert site.pixel_m == pytest.approx(pixel_m, rel=1e-4)
    assert site.grid.rows == pytest.approx(rows * fine_m / pixel_m, abs=1)
    inside, outside = site.pixel(7.0, 5.0), site.pixel(2.0, 2.0)
    assert (site.classes[inside], site.classes[outside]) == (1, 0)
    assert site.rgb[inside].tolist() == [200, 200, 200]
    assert site.rgb[outside].tolist() == [50, 50, 50]


def test_a_site_in_an_orthomosaic_of_many_files_or_without_place_is_refused(tmp_path: Path) -> None:
    folder = put_world(tmp_path / "w", FLAT)
    write_raster(folder / "ortho.tif", np.full((3, 80, 100), 9, np.uint8), crs=None, transform=None)
    assert "ortho.tif" in refusal(folder)


def test_a_truth_that_covers_only_a_part_is_known_only_there(tmp_path: Path) -> None:
    folder = put_world(tmp_path / "w", FLAT)
    put_truth(folder, np.zeros((40, 100)), {"0": {"drivability": 0.5}}, transform=place_of(0.1))
    site = load_site(folder)
    assert (site.classes[:39] == 0).all()
    assert (site.classes[41:] == UNKNOWN).all()
    np.testing.assert_allclose(site.speed_factor[:39], 0.5, rtol=1e-5)
    np.testing.assert_allclose(site.speed_factor[41:], 1.0, rtol=1e-5)


@pytest.mark.real
def test_the_ground_of_a_real_site_is_not_below_its_surface(tmp_path: Path) -> None:
    if not REAL.exists():
        pytest.skip(f"no real data at {REAL}")
    os.symlink(REAL / "ortho_3cm.tif", tmp_path / "ortho.tif")
    os.symlink(REAL / "dsm_5cm.tif", tmp_path / "dsm.tif")
    site = load_site(tmp_path)
    assert site.pixel_m == pytest.approx(0.05, rel=1e-3)
    assert site.ground_m.min() > 150
    assert site.surface_m.min() > 150
    assert (site.ground_m <= site.surface_m + 1e-4).all()
    assert 0.001 < site.obstacle[site.seen].mean() < 0.2
    assert site.names == {}
