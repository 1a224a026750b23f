"""A raster on another grid, held against pixels that NumPy picks one by one."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from affine import Affine
from raster_files import ORIGIN, UTM33, write_raster
from rasterio.crs import CRS
from rasterio.enums import ColorInterp

from hrt_cli.errors import InputError
from hrt_cli.raster import align, gather
from hrt_cli.raster.align import Rule, field_on, part_of, window_on
from hrt_cli.raster.gate import open_raster
from hrt_cli.raster.grid import Grid, transform_points
from hrt_cli.raster.windows import Window

pytestmark = pytest.mark.filterwarnings("ignore:Use `@` matmul:PendingDeprecationWarning")

UTM = CRS.from_string(UTM33)
RULES: tuple[Rule, ...] = ("bilinear", "average", "max", "nearest", "mode")


@pytest.fixture(autouse=True)
def _no_warning() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        yield


def placed(pixel_m: float, right_m: float = 0.0, down_m: float = 0.0, degrees: float = 0.0) -> Affine:
    """Return a transform with its first corner so far from the origin, turned about it."""
    corner = Affine.translation(ORIGIN[0] + right_m, ORIGIN[1] - down_m)
    return corner @ Affine.rotation(degrees) @ Affine.scale(pixel_m, -pixel_m)


def grid(rows: int, cols: int, transform: Affine, crs: CRS = UTM) -> Grid:
    return Grid(rows, cols, transform, crs)


def noise(rows: int, cols: int, holes: float = 0.0, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    values = rng.normal(20, 5, (rows, cols)).astype(np.float32)
    values[rng.random((rows, cols)) < holes] = np.nan
    return values


def laid(path: Path, values: np.ndarray, transform: Affine, target: Grid, rule: Rule, **options: Any) -> np.ndarray:
    with open_raster(write_raster(path, values, transform=transform, **options)) as raster:
        found = field_on(raster, target, rule)
    assert found.dtype == np.float32
    assert found.shape == target.shape
    return found


def by_middles(values: np.ndarray, source: Grid, target: Grid, reduce: Callable[[np.ndarray], Any]) -> np.ndarray:
    """Take each pixel alone to the cell in which its middle lies."""
    row, col = np.indices(values.shape) + 0.5
    x, y = source.xy(row.ravel(), col.ravel())
    assert source.crs is not None
    assert target.crs is not None
    x, y = transform_points(source.crs, target.crs, x, y)
    members: dict[tuple[int, int], list[float]] = {}
    for px, py, value in zip(x, y, values.ravel(), strict=True):
        at = target.rowcol(px, py)
        if not math.isnan(value):
            members.setdefault((math.floor(at[0]), math.floor(at[1])), []).append(value)
    out = np.full(target.shape, np.nan)
    for (r, c), found in members.items():
        if 0 <= r < target.rows and 0 <= c < target.cols:
            out[r, c] = reduce(np.array(found))
    return out


def by_area(values: np.ndarray, source: Grid, target: Grid, fine: int = 40) -> np.ndarray:
    """Average what lies under many points of each cell."""
    row, col = ((np.arange(side * fine) + 0.5) / fine for side in target.shape)
    x, y = target.xy(row[:, None], col[None, :])
    back = ~source.transform
    at_row = np.floor(back.d * x + back.e * y + back.f).astype(int)
    at_col = np.floor(back.a * x + back.b * y + back.c).astype(int)
    inside = (at_row >= 0) & (at_row < source.rows) & (at_col >= 0) & (at_col < source.cols)
    points = np.where(inside, values[np.clip(at_row, 0, source.rows - 1), np.clip(at_col, 0, source.cols - 1)], np.nan)
    cells = points.reshape(target.rows, fine, target.cols, fine).swapaxes(1, 2).reshape(*target.shape, -1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        return np.asarray(np.nanmean(cells, axis=-1))


def exactly(values: np.ndarray, source: Grid, target: Grid) -> np.ndarray:
    """Average on an upright grid inside an upright one by the lengths that pixels and cells have in common."""

    def shares(cells: np.ndarray, pixels: np.ndarray) -> np.ndarray:
        low = np.maximum(cells[:-1, None], pixels[None, :-1])
        return np.asarray(np.clip(np.minimum(cells[1:, None], pixels[None, 1:]) - low, 0, None))

    (x, y), (px, py) = (each.xy(np.arange(each.rows + 1), np.arange(each.cols + 1)) for each in (target, source))
    weight = shares(-y, -py), shares(x, px)
    total = weight[0].sum(axis=1)[:, None] * weight[1].sum(axis=1)
    return np.asarray(weight[0] @ values @ weight[1].T / total)


class TestTheSameGrid:
    @pytest.mark.parametrize("rule", RULES)
    @pytest.mark.parametrize("dtype", ["float32", "float64", "uint8", "int16", "uint16"])
    def test_every_rule_leaves_a_raster_as_it_is(self, tmp_path: Path, rule: Rule, dtype: str) -> None:
        values = noise(30, 41).astype(dtype)
        found = laid(tmp_path / "a.tif", values, placed(0.5), grid(30, 41, placed(0.5)), rule)
        np.testing.assert_array_equal(found, values.astype(np.float32))

    @pytest.mark.parametrize("rule", RULES)
    def test_holes_stay_holes(self, tmp_path: Path, rule: Rule) -> None:
        values = noise(30, 41, holes=0.3)
        found = laid(tmp_path / "a.tif", values, placed(0.5), grid(30, 41, placed(0.5)), rule)
        np.testing.assert_array_equal(found, values)

    @pytest.mark.parametrize("rule", RULES)
    def test_zero_is_a_value(self, tmp_path: Path, rule: Rule) -> None:
        found = laid(tmp_path / "a.tif", np.zeros((9, 9), np.float32), placed(1), grid(9, 9, placed(1)), rule)
        assert (found == 0).all()

    @pytest.mark.parametrize("rule", RULES)
    def test_one_mirrored_is_turned_back(self, tmp_path: Path, rule: Rule) -> None:
        values = noise(8, 12)
        south_up = Affine(1, 0, ORIGIN[0], 0, 1, ORIGIN[1] - 8)
        found = laid(tmp_path / "a.tif", values[::-1], south_up, grid(8, 12, placed(1)), rule)
        np.testing.assert_array_equal(found, values)

    @pytest.mark.parametrize("rule", RULES)
    def test_a_quarter_turn(self, tmp_path: Path, rule: Rule) -> None:
        values = noise(8, 12)
        turned = Affine.translation(ORIGIN[0] + 12, ORIGIN[1]) @ Affine.rotation(-90) @ Affine.scale(1, -1)
        found = laid(tmp_path / "a.tif", np.rot90(values), turned, grid(8, 12, placed(1)), rule)
        np.testing.assert_allclose(found, values, rtol=1e-6)


class TestOutside:
    @pytest.mark.parametrize("rule", RULES)
    @pytest.mark.parametrize("pixel_m", [0.25, 1.0, 4.0])
    def test_beside_the_source_there_is_nothing(self, tmp_path: Path, rule: Rule, pixel_m: float) -> None:
        side = round(16 / pixel_m)
        found = laid(
            tmp_path / "a.tif",
            np.full((side, side), 7, np.float32),
            placed(pixel_m),
            grid(40, 40, placed(1, -8, -8)),
            rule,
        )
        inside = np.zeros((40, 40), bool)
        inside[8:24, 8:24] = True
        np.testing.assert_array_equal(np.isfinite(found), inside)
        np.testing.assert_allclose(found[inside], 7, rtol=1e-6)

    @pytest.mark.parametrize("rule", RULES)
    def test_a_source_much_larger_is_read_where_it_is_needed(self, tmp_path: Path, rule: Rule) -> None:
        values = noise(300, 300)
        found = laid(tmp_path / "a.tif", values, placed(1), grid(5, 6, placed(1, 200, 100)), rule)
        np.testing.assert_allclose(found, values[100:105, 200:206], rtol=1e-6)

    def test_only_the_part_and_a_margin_is_read(self) -> None:
        source = grid(300, 300, placed(1))
        window = window_on(Path("a.tif"), source, grid(5, 6, placed(1, 200, 100)))
        assert window == Window(96, 196, 13, 14)
        part = part_of(source, window)
        assert part.shape == (13, 14)
        np.testing.assert_allclose(part.xy(0, 0), source.xy(96, 196))

    @pytest.mark.parametrize(("right", "down"), [(400, 0), (-200, 0), (0, 300), (0, -101), (5000, 5000)])
    def test_a_raster_wholly_beside_it_is_refused(self, tmp_path: Path, right: float, down: float) -> None:
        with pytest.raises(InputError, match="wholly beside") as refusal:
            laid(tmp_path / "a.tif", noise(100, 200), placed(1, right, down), grid(100, 100, placed(1)), "average")
        assert str(refusal.value).startswith(f"{tmp_path / 'a.tif'}: ")

    @pytest.mark.parametrize("crs", ["EPSG:32601", "EPSG:32733", "EPSG:2225"])
    def test_a_raster_of_another_continent_is_refused(self, tmp_path: Path, crs: str) -> None:
        with pytest.raises(InputError, match=r"beside the other|cannot be laid on the other"):
            laid(tmp_path / "a.tif", noise(20, 20), placed(1), grid(20, 20, placed(1)), "average", crs=crs)

    def test_too_much_at_once_is_refused(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(align, "MAX_PX", 99)
        with pytest.raises(InputError, match="10 x 10 pixels there, more than"):
            laid(tmp_path / "a.tif", noise(10, 10), placed(1), grid(1, 1, placed(10)), "max")


class TestFinerSources:
    @pytest.mark.parametrize("holes", [0.0, 0.4, 0.97])
    def test_the_average_is_the_mean_of_the_block(self, tmp_path: Path, holes: float) -> None:
        values = noise(60, 80, holes)
        source, target = grid(60, 80, placed(0.1)), grid(6, 8, placed(1))
        found = laid(tmp_path / "a.tif", values, placed(0.1), target, "average")
        np.testing.assert_allclose(found, by_middles(values, source, target, np.mean), rtol=1e-5)

    @pytest.mark.parametrize("holes", [0.0, 0.4, 0.97])
    def test_the_maximum_is_that_of_the_block(self, tmp_path: Path, holes: float) -> None:
        values = noise(60, 80, holes)
        source, target = grid(60, 80, placed(0.1)), grid(6, 8, placed(1))
        found = laid(tmp_path / "a.tif", values, placed(0.1), target, "max")
        np.testing.assert_array_equal(found, by_middles(values, source, target, np.max).astype(np.float32))

    def test_one_hot_pixel_is_found_wherever_it_lies(self, tmp_path: Path) -> None:
        for at in range(100):
            values = np.full((30, 30), 17, np.float32)
            values[10 + at // 10, 10 + at % 10] = 300
            found = laid(tmp_path / f"{at}.tif", values, placed(0.1), grid(3, 3, placed(1)), "max")
            assert found.tolist() == [[17, 17, 17], [17, 300, 17], [17, 17, 17]]

    @pytest.mark.parametrize("pixel_m", [0.1, 0.3, 0.7, 1.0, 1.3])
    @pytest.mark.parametrize("degrees", [0.0, 0.02, 5.0, 45.0, 130.0])
    def test_no_hot_pixel_is_lost_or_doubled(self, tmp_path: Path, pixel_m: float, degrees: float) -> None:
        values = noise(60, 60, 0.1)
        place = placed(pixel_m, 3.1, 2.7, 7.0)
        source = grid(60, 60, place)
        middle = Affine.translation(*(float(at) for at in source.xy(30, 30)))
        turned = Affine.rotation(degrees) @ Affine.scale(1, -1)
        target = grid(9, 11, middle @ turned @ Affine.translation(-5.3, -4.1))
        found = laid(tmp_path / "a.tif", values, place, target, "max")
        expected = by_middles(values, source, target, np.max).astype(np.float32)
        filled = np.isfinite(expected)
        np.testing.assert_array_equal(found[filled], expected[filled])
        assert filled.mean() > 0.3

    def test_a_cell_a_little_larger_than_ten_pixels_takes_no_eleventh(self, tmp_path: Path) -> None:
        values = np.full((100, 100), 17, np.float32)
        values[:, 9] = 300
        found = laid(tmp_path / "a.tif", values, placed(0.1), grid(9, 9, placed(0.9996, 0, 0)), "max")
        assert (found[:, 0] == 300).all()
        assert (found[:, 1:] == 17).all()

    @pytest.mark.parametrize("rule", ["average", "mode", "max"])
    @pytest.mark.parametrize("degrees", [0, 40])
    def test_the_size_of_strips_does_not_matter(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rule: Rule, degrees: float
    ) -> None:
        values = np.round(noise(50, 40, 0.2))
        target = grid(40, 9, placed(0.4, 3, -2, degrees))
        whole = laid(tmp_path / "a.tif", values, placed(0.2), target, rule)
        monkeypatch.setattr(gather, "_STRIP_PX", 100)
        monkeypatch.setattr(gather, "_BLOCK_PX", 9)
        np.testing.assert_allclose(laid(tmp_path / "b.tif", values, placed(0.2), target, rule), whole, rtol=1e-6)

    @pytest.mark.parametrize("step", [2.5, 3.7])
    def test_pixels_cut_by_the_edge_count_by_their_share(self, tmp_path: Path, step: float) -> None:
        values = noise(60, 60)
        source, target = grid(60, 60, placed(0.2)), grid(10, 10, placed(0.2 * step, 0.1, 0.05))
        found = laid(tmp_path / "a.tif", values, placed(0.2), target, "average")
        np.testing.assert_allclose(found, by_area(values, source, target, 200), atol=0.05)
        inside = grid(4, 4, placed(0.2 * step, 1.1, 2.05))
        found = laid(tmp_path / "b.tif", values, placed(0.2), inside, "average")
        np.testing.assert_allclose(found, exactly(values, source, inside), rtol=1e-5)

    @pytest.mark.parametrize("degrees", [3.0, 30.0, 45.0, 80.0])
    @pytest.mark.parametrize("holes", [0.0, 0.3])
    def test_a_turned_cell_averages_what_it_covers(self, tmp_path: Path, degrees: float, holes: float) -> None:
        values = noise(100, 100, holes)
        source, target = grid(100, 100, placed(0.2)), grid(8, 9, placed(1, 4, 12, degrees))
        found = laid(tmp_path / "a.tif", values, placed(0.2), target, "average")
        expected = by_area(values, source, target)
        assert np.isfinite(expected).mean() > 0.5
        np.testing.assert_array_equal(np.isnan(found), np.isnan(expected))
        np.testing.assert_allclose(found, expected, atol=0.6)
        assert np.nanstd(found - expected) < 0.2 * np.nanstd(expected)


class TestClasses:
    def test_the_commonest_class_wins(self, tmp_path: Path) -> None:
        values = np.full((20, 30), 255, np.uint8)
        values[:10, :10] = np.r_[[3] * 51, [1] * 49].reshape(10, 10)
        values[:10, 10:20] = np.r_[[255] * 90, [4] * 6, [0] * 4].reshape(10, 10)
        values[10:, 20:] = np.random.default_rng(0).permutation([7] * 40 + [8] * 35 + [9] * 25).reshape(10, 10)
        found = laid(tmp_path / "a.tif", values, placed(0.1), grid(2, 3, placed(1)), "mode", nodata=255)
        np.testing.assert_array_equal(found, [[3, 4, np.nan], [np.nan, np.nan, 7]])

    def test_so_it_does_where_the_cell_is_turned(self, tmp_path: Path) -> None:
        values = np.zeros((100, 100), np.uint8)
        values[:, 50:] = 1
        values[50:, 50:] = 255
        target = grid(8, 8, placed(1, 0.5, 5.2, 45))
        found = laid(tmp_path / "a.tif", values, placed(0.1), target, "mode", nodata=255)
        row, col = np.indices(target.shape) + 0.5
        x, y = target.xy(row, col)
        at_row, at_col = (ORIGIN[1] - y) * 10, (x - ORIGIN[0]) * 10
        clear = (np.abs(at_col - 50) > 10) & (np.abs(at_row - 50) > 10)
        inside = (at_row > 8) & (at_row < 92) & (at_col > 8) & (at_col < 92)
        expected = np.where(at_col < 50, 0.0, np.where(at_row < 50, 1.0, np.nan))
        assert (clear & inside).sum() > 5
        np.testing.assert_array_equal(found[clear & inside], expected[clear & inside])

    @pytest.mark.parametrize("degrees", [0.0, 20.0, 45.0])
    def test_nearest_mixes_no_classes(self, tmp_path: Path, degrees: float) -> None:
        values = np.random.default_rng(1).choice([0, 5, 200], (40, 40)).astype(np.uint8)
        source, target = grid(40, 40, placed(1)), grid(50, 50, placed(0.37, 9.1, 12.3, degrees))
        found = laid(tmp_path / "a.tif", values, placed(1), target, "nearest")
        np.testing.assert_array_equal(found, by_area(values, source, target, 1))


class TestBetweenPixels:
    @pytest.mark.parametrize("rule", ["bilinear", "average"])
    def test_half_a_pixel_aside_lies_the_mean_of_both(self, tmp_path: Path, rule: Rule) -> None:
        values = noise(20, 30)
        found = laid(tmp_path / "a.tif", values, placed(1), grid(20, 29, placed(1, 0.5)), rule)
        np.testing.assert_allclose(found, (values[:, 1:] + values[:, :-1]) / 2, rtol=1e-5)

    def test_of_two_the_one_with_data_counts(self, tmp_path: Path) -> None:
        values = np.array([[1, np.nan, 3, 4, np.nan, np.nan]], np.float32).repeat(4, axis=0)
        found = laid(tmp_path / "a.tif", values, placed(1), grid(4, 5, placed(1, 0.5)), "average")
        np.testing.assert_allclose(found, [[1, 3, 3.5, 4, np.nan]] * 4, rtol=1e-6)

    @pytest.mark.parametrize("degrees", [0.0, 30.0, 45.0])
    def test_a_slope_is_a_slope_between_pixels_too(self, tmp_path: Path, degrees: float) -> None:
        source = grid(40, 40, placed(2))
        row, col = np.indices(source.shape) + 0.5
        plane = (3 * row - 2 * col).astype(np.float32)
        target = grid(25, 25, placed(0.6, 30, 40, degrees))
        found = laid(tmp_path / "a.tif", plane, placed(2), target, "bilinear")
        x, y = target.xy(*(np.indices(target.shape) + 0.5))
        expected = 3 * (ORIGIN[1] - y) / 2 - 2 * (x - ORIGIN[0]) / 2
        np.testing.assert_allclose(found, expected, atol=1e-3)


class TestNoData:
    @pytest.mark.parametrize("rule", RULES)
    @pytest.mark.parametrize("nodata", [-9999.0, 0.0, math.nan, -3.4028234663852886e38])
    def test_the_declared_value_is_none(self, tmp_path: Path, rule: Rule, nodata: float) -> None:
        values = np.full((40, 40), 20, np.float32)
        values[:20, :20] = nodata
        found = laid(tmp_path / "a.tif", values, placed(0.5), grid(20, 20, placed(1)), rule, nodata=nodata)
        assert np.isnan(found[:10, :10]).all()
        assert np.isnan(found).sum() == 100
        np.testing.assert_allclose(found[np.isfinite(found)], 20, rtol=1e-6)

    @pytest.mark.parametrize("rule", RULES)
    @pytest.mark.parametrize("kind", ["mask", "side-car", "alpha"])
    def test_what_is_masked_is_none(self, tmp_path: Path, rule: Rule, kind: str) -> None:
        values = np.full((40, 40), 20, np.uint8)
        values[:20, :20] = 250
        seen = values == 20
        options: dict[str, Any] = {"mask": seen, "internal_mask": kind == "mask"}
        pixels = values
        if kind == "alpha":
            pixels = np.stack([values, np.where(seen, 3, 0).astype(np.uint8)])
            options = {"colours": (ColorInterp.gray, ColorInterp.alpha)}
        found = laid(tmp_path / "a.tif", pixels, placed(0.5), grid(20, 20, placed(1)), rule, **options)
        assert np.isnan(found).sum() == 100
        assert np.isnan(found[:10, :10]).all()
        np.testing.assert_array_equal(found[np.isfinite(found)], 20)

    def test_a_second_band_that_is_not_declared_masks_nothing(self, tmp_path: Path) -> None:
        values = np.stack([noise(9, 9), np.zeros((9, 9), np.float32)])
        assert np.isfinite(laid(tmp_path / "a.tif", values, placed(1), grid(9, 9, placed(1)), "average")).all()

    @pytest.mark.parametrize("value", [math.inf, -math.inf, 1e300])
    def test_what_is_no_float32_is_none(self, tmp_path: Path, value: float) -> None:
        values = noise(9, 9).astype(np.float64)
        values[4, 4] = value
        found = laid(tmp_path / "a.tif", values, placed(1), grid(9, 9, placed(1)), "max")
        assert np.argwhere(np.isnan(found)).tolist() == [[4, 4]]


class TestAnotherCrs:
    def place(self, crs: str, pixel: float, rows: int, cols: int) -> Affine:
        """Return a transform in `crs` whose raster has its middle 40 m right of and 40 m below the origin."""
        x, y = transform_points(UTM, CRS.from_string(crs), ORIGIN[0] + 40, ORIGIN[1] - 40)
        return Affine(pixel, 0, x[0] - cols / 2 * pixel, 0, -pixel, y[0] + rows / 2 * pixel)

    @pytest.mark.parametrize(("crs", "pixel"), [("EPSG:32632", 0.4), ("EPSG:4326", 4e-6), ("EPSG:3857", 0.5)])
    def test_every_pixel_counts_where_it_lies(self, tmp_path: Path, crs: str, pixel: float) -> None:
        place = self.place(crs, pixel, 150, 160)
        values = noise(150, 160, 0.1)
        target = grid(14, 15, placed(2, 20, 20))
        source = grid(150, 160, place, CRS.from_string(crs))
        found = laid(tmp_path / "a.tif", values, place, target, "max", crs=crs)
        np.testing.assert_array_equal(found, by_middles(values, source, target, np.max).astype(np.float32))
        mean = laid(tmp_path / "b.tif", values, place, target, "average", crs=crs)
        expected = by_middles(values, source, target, np.mean)
        assert np.std(mean - expected) < 0.4 * np.std(expected)

    @pytest.mark.parametrize("rule", RULES)
    @pytest.mark.parametrize(("crs", "pixel"), [("EPSG:32632", 0.4), ("EPSG:4326", 4e-6), ("EPSG:32632", 4.0)])
    def test_a_field_keeps_its_place(self, tmp_path: Path, crs: str, pixel: float, rule: Rule) -> None:
        side = round(150 * min(1.0, 0.4 / pixel)) if pixel > 1e-3 else 150
        side = max(side, 30)
        place = self.place(crs, pixel, side, side)
        source = grid(side, side, place, CRS.from_string(crs))
        x, y = source.xy(*(np.indices(source.shape).reshape(2, -1) + 0.5))
        assert source.crs is not None
        east, north = transform_points(source.crs, UTM, x, y)
        values = (0.3 * (east - ORIGIN[0]) + 0.5 * (north - ORIGIN[1])).reshape(source.shape).astype(np.float32)
        target = grid(30, 30, placed(1, 25, 25))
        found = laid(tmp_path / "a.tif", values, place, target, rule, crs=crs)
        x, y = target.xy(*(np.indices(target.shape) + 0.5))
        expected = 0.3 * (x - ORIGIN[0]) + 0.5 * (y - ORIGIN[1])
        assert np.isfinite(found).all()
        pixel_m = max(source.pixel_m)
        slack = {"bilinear": 0.08, "average": 0.3 * max(pixel_m, 0.4), "nearest": 0.5 * max(pixel_m, 1), "mode": 2.5}
        assert np.abs(found - expected).max() < slack.get(rule, 0.8 * max(pixel_m, 1)) + 0.05

    def test_positions_between_nodes_are_exact_to_a_thousandth(self) -> None:
        source = grid(700, 900, self.place("EPSG:32632", 0.5, 700, 900), CRS.from_epsg(32632))
        target = grid(100, 100, placed(1))
        rows, cols = np.arange(700) + 0.5, np.arange(900) + 0.5
        found = gather.places(source, target, rows, cols)
        x, y = source.xy(*(a.ravel() for a in np.meshgrid(rows, cols, indexing="ij")))
        x, y = transform_points(CRS.from_epsg(32632), UTM, x, y)
        back = ~target.transform
        np.testing.assert_allclose(found[0].ravel(), back.d * x + back.e * y + back.f, atol=1e-3)
        np.testing.assert_allclose(found[1].ravel(), back.a * x + back.b * y + back.c, atol=1e-3)
        one = gather.places(source, target, rows[5:6], cols[7:8])
        np.testing.assert_allclose(one, [[[found[0][5, 7]]], [[found[1][5, 7]]]], atol=1e-3)
