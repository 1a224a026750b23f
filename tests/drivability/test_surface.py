"""A surface model on the cells of a map: whatever its grid, unit and nodata, the ground is as steep."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from affine import Affine
from raster_files import ORIGIN, UTM33, write_raster
from rasterio.crs import CRS

from hrt_cli.drivability import surface
from hrt_cli.drivability.surface import Ground, Relief, ground_of
from hrt_cli.errors import ArgumentError, InputError
from hrt_cli.raster.gate import open_raster
from hrt_cli.raster.grid import Grid
from hrt_cli.raster.heights import height_unit_m, open_heights

pytestmark = pytest.mark.filterwarnings("ignore:Use `@` matmul:PendingDeprecationWarning")

# 180 km from the middle of its zone a metre of the map is one of ground.
EAST, NORTH = ORIGIN[0] + 180_000, ORIGIN[1]
CELLS = Grid(20, 30, Affine(1, 0, EAST, 0, -1, NORTH), CRS.from_string(UTM33))
STEEP = math.degrees(math.atan(0.5))


def heights_at(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """A ramp that rises half a metre per metre to the south-east."""
    return 200 + 0.5 * ((x - EAST) - (y - NORTH)) / math.sqrt(2)


def ramp(path: Path, pixel: float = 0.1, grid: Affine | None = None, edit: Any = None, **options: Any) -> Path:
    """Write the ramp on a raster that covers the cells and 2 m about them."""
    rows, cols = round(24 / pixel), round(34 / pixel)
    at = grid or Affine(pixel, 0, EAST - 2, 0, -pixel, NORTH + 2)
    j, i = np.meshgrid(np.arange(cols) + 0.5, np.arange(rows) + 0.5)
    z = heights_at(at.a * j + at.b * i + at.c, at.d * j + at.e * i + at.f)
    z = z if edit is None else edit(z)
    return write_raster(path, z.astype(options.pop("dtype", np.float32)), transform=at, **options)


def ground(path: Path, cells: Grid = CELLS, cell_m: float = 1.0) -> Ground:
    with open_heights(path) as raster:
        return ground_of(raster, cells, cell_m)


@pytest.mark.parametrize("pixel", [0.03, 0.1, 0.25, 0.5, 2.0])
def test_a_ramp_is_as_steep_at_any_resolution(tmp_path: Path, pixel: float) -> None:
    found = ground(ramp(tmp_path / "d.tif", pixel))
    inside = np.s_[1:-1, 1:-1] if pixel > 1 else np.s_[:, :]
    np.testing.assert_allclose(found.slope_deg[inside], STEEP, atol=0.05)
    assert found.rugosity[inside].max() < 1e-4


@pytest.mark.parametrize("cell_m", [0.1, 0.2, 0.25, 0.4, 0.6, 1.0, 3.0])
def test_a_ramp_is_as_steep_in_cells_of_any_size(tmp_path: Path, cell_m: float) -> None:
    cells = Grid(round(9 / cell_m), round(12 / cell_m), CELLS.transform @ Affine.scale(cell_m), CELLS.crs)
    np.testing.assert_allclose(ground(ramp(tmp_path / "d.tif"), cells, cell_m).slope_deg, STEEP, atol=0.05)


@pytest.mark.parametrize("turn", [0, 20, 45, 90, 200])
def test_cells_and_heights_may_be_turned(tmp_path: Path, turn: float) -> None:
    middle = Affine.translation(15, 10)
    cells = Grid(12, 12, CELLS.transform @ middle @ Affine.rotation(turn) @ Affine.translation(-6, -6), CELLS.crs)
    np.testing.assert_allclose(ground(ramp(tmp_path / "d.tif"), cells).slope_deg, STEEP, atol=0.1)
    about = CELLS.transform @ middle @ Affine.rotation(turn) @ Affine.translation(-20, -20) @ Affine.scale(0.2)
    path = ramp(tmp_path / "e.tif", 0.1, about)
    np.testing.assert_allclose(ground(path, Grid(12, 12, cells.transform, CELLS.crs)).slope_deg, STEEP, atol=0.1)


def test_lengths_are_those_of_the_ground_in_a_stretched_crs(tmp_path: Path) -> None:
    # In web-mercator at 60 degrees north two metres of the map are one of ground.
    crs = CRS.from_epsg(3857)
    at = Affine(1, 0, 1_000_000, 0, -1, 8_399_737.0)
    z = np.tile(np.arange(200) * 0.25, (160, 1)).astype(np.float32)
    path = write_raster(tmp_path / "d.tif", z, transform=at, crs="EPSG:3857")
    cells = Grid(20, 20, at @ Affine.translation(40, 40) @ Affine.scale(4), crs)
    row_m = cells.pixel_m[0]
    assert row_m == pytest.approx(2.0, rel=0.01)
    np.testing.assert_allclose(ground(path, cells, row_m).slope_deg, STEEP, atol=0.3)


@pytest.mark.parametrize(
    ("unit", "metres"), [("", 1.0), ("metre", 1.0), ("ft", 0.3048), ("US survey foot", 0.3048006), ("cm", 0.01)]
)
def test_the_unit_tag_counts(tmp_path: Path, unit: str, metres: float) -> None:
    import rasterio

    path = ramp(tmp_path / "d.tif", edit=lambda z: z / metres)
    if unit:
        with rasterio.open(path, "r+") as dataset:
            dataset.units = (unit,)
    np.testing.assert_allclose(ground(path).slope_deg, STEEP, atol=0.05)


@pytest.mark.parametrize(("code", "metres"), [("EPSG:32633+5703", 1.0), ("EPSG:32633+6360", 1200 / 3937)])
def test_the_unit_of_a_vertical_crs_counts(tmp_path: Path, code: str, metres: float) -> None:
    path = ramp(tmp_path / "d.tif", edit=lambda z: z / metres, crs=code)
    with open_heights(path) as raster:
        assert height_unit_m(raster) == pytest.approx(metres)
    np.testing.assert_allclose(ground(path).slope_deg, STEEP, atol=0.05)


def test_units_that_are_unknown_or_at_odds_are_refused(tmp_path: Path) -> None:
    import rasterio

    for crs, unit, problem in ((UTM33, "K", "'k', no unit of length"), ("EPSG:32633+6360", "m", "vertical CRS")):
        path = ramp(tmp_path / f"{unit}.tif", 0.5, crs=crs)
        with rasterio.open(path, "r+") as dataset:
            dataset.units = (unit,)
        with pytest.raises(InputError, match=problem) as refusal:
            ground(path)
        assert str(refusal.value).startswith(f"{path}: ")


def test_scale_and_offset_of_whole_numbers_count(tmp_path: Path) -> None:
    import rasterio

    path = ramp(tmp_path / "d.tif", edit=lambda z: np.round((z - 150) / 0.01), dtype=np.int16)
    with rasterio.open(path, "r+") as dataset:
        dataset.scales, dataset.offsets = (0.01,), (150.0,)
    np.testing.assert_allclose(ground(path).slope_deg, STEEP, atol=0.3)


@pytest.mark.parametrize("void", [-9999.0, -10000.0, -32767.0, float(np.finfo(np.float32).min), math.nan])
@pytest.mark.parametrize("declared", [True, False])
def test_no_data_is_no_cliff(tmp_path: Path, void: float, declared: bool) -> None:
    def bored(z: np.ndarray) -> np.ndarray:
        z[100:160, 100:160] = void
        return z

    found = ground(ramp(tmp_path / "d.tif", edit=bored, nodata=void if declared else None))
    assert not found.known[9:13, 9:13].any()
    assert found.known.sum() == 20 * 30 - 32
    np.testing.assert_allclose(found.slope_deg[found.known], STEEP, atol=1.5)


def test_what_is_smaller_than_a_cell_shows(tmp_path: Path) -> None:
    def stepped(z: np.ndarray) -> np.ndarray:
        z[:] = 7
        z[120:125, 150:155] += 0.5  # a rock of half a metre
        z[:, 273:] += 0.36  # a step in a cell's middle
        return z

    found = ground(ramp(tmp_path / "d.tif", edit=stepped))
    assert (found.slope_deg[:, 25] >= 35).all()
    assert found.slope_deg[10, 13] > 20
    level = np.ones(CELLS.shape, bool)
    level[:, 24:27] = False
    level[8:13, 11:16] = False
    assert (found.slope_deg[level] < 0.01).all()
    eased = found.ease(Relief(Path("d.tif")))
    assert (eased[:, 25] == 0).all()
    assert eased[10, 13] < 0.2
    assert (eased[level] > 0.999).all()


def test_beyond_the_model_nothing_is_known_and_counts_as_level(tmp_path: Path) -> None:
    half = Affine(0.1, 0, EAST + 15.02, 0, -0.1, NORTH + 2)
    found = ground(ramp(tmp_path / "d.tif", 0.1, half))
    assert not found.known[:, :15].any()
    assert found.known[:, 16:].all()
    assert (found.ease(Relief(Path("d.tif")))[:, :15] == 1).all()
    assert np.isnan(found.rugosity[:, :15]).all()


def test_blocks_change_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(2)
    path = ramp(tmp_path / "d.tif", edit=lambda z: z + rng.normal(0, 0.05, z.shape))
    for cell_m in (1.0, 0.1):
        cells = Grid(20, 30, CELLS.transform @ Affine.scale(cell_m), CELLS.crs)
        with monkeypatch.context() as patch:
            whole = ground(path, cells, cell_m)
            patch.setattr(surface, "_BLOCK_POINTS", 12)
            pieces = ground(path, cells, cell_m)
        np.testing.assert_allclose(pieces.slope_deg, whole.slope_deg, atol=2e-3)
        np.testing.assert_allclose(pieces.rugosity, whole.rugosity, atol=1e-4)


def test_what_is_no_surface_model_of_the_place_is_refused(tmp_path: Path) -> None:
    far = ramp(tmp_path / "far.tif", 0.5, Affine(0.5, 0, EAST + 900, 0, -0.5, NORTH))
    with pytest.raises(InputError, match="wholly beside"):
        ground(far)
    with pytest.raises(InputError, match="3 bands; a surface model has one"):
        ground(write_raster(tmp_path / "rgb.tif", np.ones((3, 9, 9), np.float32)))
    fine = write_raster(
        tmp_path / "fine.tif", np.ones((40, 40), np.float32), transform=Affine(0.001, 0, EAST, 0, -0.001, NORTH)
    )
    with pytest.raises(InputError, match="too fine for cells of 30 m"):
        ground(fine, Grid(2, 2, CELLS.transform @ Affine.scale(30), CELLS.crs), 30.0)


@pytest.mark.parametrize(
    "limits", [(0, 0.1), (-1, 0.1), (91, 0.1), (35, 0), (35, 1.1), (math.nan, 0.1), (35, math.nan)]
)
def test_limits_that_are_none_are_refused(limits: tuple[float, float]) -> None:
    with pytest.raises(ArgumentError, match="limit"):
        Relief(Path("d.tif"), *limits)


BRIGHTON = Path(__file__).parents[2].parent / "shared" / "data" / "brighton_beach"


@pytest.mark.real
@pytest.mark.skipif(not BRIGHTON.exists(), reason="the site of Brighton Beach is not here")
def test_on_a_surveyed_site_what_stands_on_the_ground_is_no_go_and_road_and_lawn_are_not() -> None:
    with open_raster(BRIGHTON / "ortho_3cm.tif") as ortho:
        cells = ortho.grid.coarse(1.0)
    found = ground(BRIGHTON / "dsm_5cm.tif", cells)
    eased = found.ease(Relief(BRIGHTON / "dsm_5cm.tif"))
    # Metres south and east of the corner, read off the orthomosaic.
    for what, south, east in (("car", 53, 90), ("pavilion", 73, 48), ("car", 71, 61), ("bush", 60, 25)):
        assert eased[south - 2 : south + 3, east - 2 : east + 3].min() < 0.01, what
    for what, south, east in (("road", 46, 57), ("lawn", 62, 38), ("lawn", 70, 30)):
        assert (eased[south - 2 : south + 3, east - 2 : east + 3] > 0.6).all(), what
