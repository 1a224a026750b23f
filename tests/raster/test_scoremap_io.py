from __future__ import annotations

import math
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from affine import Affine
from raster_files import ORIGIN, UTM33, write_raster, write_sparse
from rasterio.crs import CRS
from rasterio.enums import ColorInterp

from hrt_cli.artifacts.provenance import record
from hrt_cli.errors import InputError
from hrt_cli.raster.cog import cog_provenance
from hrt_cli.raster.grid import Grid
from hrt_cli.raster.scoremap import Scoremap, publish_scoremap, read_scoremap

METRE = Affine(1, 0, ORIGIN[0], 0, -1, ORIGIN[1])


def scores(rows: int = 12, cols: int = 9) -> np.ndarray:
    return np.random.default_rng(0).random((rows, cols), np.float32)


def write(path: Path, *bands: np.ndarray, transform: Affine = METRE, **options: Any) -> Path:
    return write_raster(path, np.stack(bands), transform=transform, **options)


@pytest.fixture(autouse=True)
def _silence_is_kept() -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        yield


def refused(path: Path, problem: str) -> None:
    with pytest.raises(InputError, match=problem) as refusal:
        read_scoremap(path)
    assert str(refusal.value).startswith(f"{path}: ")


def test_what_is_published_is_read(tmp_path: Path) -> None:
    score, sd = scores(), scores() / 10
    score[3, 4] = sd[3, 4] = np.nan
    grid = Grid(12, 9, METRE, CRS.from_string(UTM33))
    path = tmp_path / "a.tif"
    publish_scoremap(path, Scoremap(score, sd, grid, 1.0), record("t", 1, {}, {}), tags={"x": 1}, creation={})
    found = read_scoremap(path)
    np.testing.assert_array_equal(found.score, score)
    np.testing.assert_array_equal(found.sd, sd)
    assert (found.grid.shape, found.grid.transform, found.grid.crs) == (grid.shape, METRE, grid.crs)
    assert found.cell_size_m == pytest.approx(1.0, rel=1e-3)
    assert cog_provenance(path) is not None
    assert (tmp_path / "a.qml").exists()
    with rasterio.open(path) as dataset:
        assert dataset.descriptions == ("score", "sd")
        assert dataset.tags(ns="HRT")["CELL_SIZE_M"] == "1.0"


class TestTif:
    def test_one_band_has_no_doubt(self, tmp_path: Path) -> None:
        score = scores()
        score[0, 0] = np.nan
        found = read_scoremap(write(tmp_path / "a.tif", score))
        np.testing.assert_array_equal(found.score, score)
        assert np.isnan(found.sd[0, 0])
        assert (found.sd[1:] == 0).all()

    def test_nan_without_a_tag_is_no_go(self, tmp_path: Path) -> None:
        score = scores()
        score[2] = np.nan
        assert np.isnan(read_scoremap(write(tmp_path / "a.tif", score)).score[2]).all()

    @pytest.mark.parametrize("dtype", ["float32", "float64"])
    @pytest.mark.parametrize("nodata", [-9999.0, -3.4028234663852886e38, math.inf, -math.inf, math.nan, 0.0])
    def test_the_declared_value_is_no_go(self, tmp_path: Path, dtype: str, nodata: float) -> None:
        score = scores().astype(dtype) + 1
        score[2] = nodata
        score[3] = np.nan
        sd = np.zeros_like(score) + 0.5
        sd[2] = nodata
        found = read_scoremap(write(tmp_path / "a.tif", score, sd, nodata=nodata))
        assert np.isnan(found.score[2:4]).all()
        assert np.isnan(found.sd[2:4]).all()
        np.testing.assert_array_equal(found.score[4:], score[4:].astype(np.float32))

    def test_the_lowest_double_is_no_go_where_it_is_declared(self, tmp_path: Path) -> None:
        score = scores().astype(np.float64)
        score[2] = np.finfo(np.float64).min
        path = write(tmp_path / "a.tif", score, nodata=np.finfo(np.float64).min)
        assert np.isnan(read_scoremap(path).score[2]).all()

    def test_a_mask_is_no_go(self, tmp_path: Path) -> None:
        mask = np.ones((12, 9), bool)
        mask[5] = False
        found = read_scoremap(write(tmp_path / "a.tif", scores(), mask=mask))
        np.testing.assert_array_equal(np.isnan(found.score), ~mask)

    def test_an_alpha_band_is_a_mask_and_no_doubt(self, tmp_path: Path) -> None:
        alpha = np.full((12, 9), 255, np.float32)
        alpha[5] = 0
        colours = (ColorInterp.gray, ColorInterp.alpha)
        found = read_scoremap(write(tmp_path / "a.tif", scores(), alpha, colours=colours))
        np.testing.assert_array_equal(np.isnan(found.score), alpha == 0)
        assert (found.sd[alpha > 0] == 0).all()

    @pytest.mark.parametrize(
        ("value", "problem"),
        [
            (math.inf, r"an infinite score \(inf at cell 7,3\)"),
            (-math.inf, "an infinite score"),
            (-0.01, r"a negative score \(-0.01 at cell 7,3\)"),
            (-9999.0, "a negative score"),
        ],
    )
    def test_a_score_that_is_none_is_refused(self, tmp_path: Path, value: float, problem: str) -> None:
        score = scores()
        score[7, 3] = value
        refused(write(tmp_path / "a.tif", score), problem)

    def test_a_score_beyond_float32_is_refused(self, tmp_path: Path) -> None:
        score = scores().astype(np.float64)
        score[7, 3] = 1e300
        refused(write(tmp_path / "a.tif", score), "infinite score")

    @pytest.mark.parametrize(("value", "problem"), [(-1.0, "a negative"), (math.inf, "an infinite")])
    def test_a_doubt_that_is_none_is_refused(self, tmp_path: Path, value: float, problem: str) -> None:
        sd = scores()
        sd[7, 3] = value
        refused(write(tmp_path / "a.tif", scores(), sd), f"{problem} standard deviation")

    def test_nothing_to_enter_is_refused(self, tmp_path: Path) -> None:
        refused(write(tmp_path / "a.tif", np.full((4, 4), np.nan, np.float32)), "no cell that may be entered")

    @pytest.mark.parametrize("height", [0.97, 1.03, 2.0])
    def test_oblong_cells_are_refused(self, tmp_path: Path, height: float) -> None:
        oblong = Affine(1, 0, ORIGIN[0], 0, -height, ORIGIN[1])
        refused(write(tmp_path / "a.tif", scores(), transform=oblong), "a plan needs square ones")

    def test_cells_of_degrees_are_oblong(self, tmp_path: Path) -> None:
        degrees = Affine(1e-5, 0, 10, 0, -1e-5, 48)
        refused(write(tmp_path / "a.tif", scores(), transform=degrees, crs="EPSG:4326"), "a plan needs square ones")

    def test_the_cell_is_measured_on_the_ground(self, tmp_path: Path) -> None:
        mercator = Affine(1, 0, 1_200_000, 0, -1, 6_106_855)
        found = read_scoremap(write(tmp_path / "a.tif", scores(), transform=mercator, crs="EPSG:3857"))
        assert found.cell_size_m == pytest.approx(math.cos(math.radians(48)), rel=5e-3)

    @pytest.mark.parametrize("dtype", ["uint8", "int16"])
    def test_whole_numbers_are_refused(self, tmp_path: Path, dtype: str) -> None:
        refused(write(tmp_path / "a.tif", np.ones((4, 4), dtype)), "is not a scoremap")

    def test_three_bands_are_refused(self, tmp_path: Path) -> None:
        refused(write(tmp_path / "a.tif", scores(), scores(), scores()), "is not a scoremap")

    def test_no_crs_is_refused(self, tmp_path: Path) -> None:
        refused(write(tmp_path / "a.tif", scores(), crs=None), "no coordinate reference system")

    def test_too_many_cells_are_refused_unread(self, tmp_path: Path) -> None:
        path = write_sparse(tmp_path / "a.tif", 5000, 4000, dtype="float32", tiled=True)
        refused(path, "5000 x 4000 cells, more than")


class TestNpz:
    def save(self, path: Path, **arrays: Any) -> Path:
        np.savez(path, **arrays)
        return path

    def test_scores_alone_are_enough(self, tmp_path: Path) -> None:
        score = scores()
        score[1, 1] = np.nan
        found = read_scoremap(self.save(tmp_path / "a.npz", score=score))
        np.testing.assert_array_equal(found.score, score)
        assert found.grid.crs is None
        assert found.grid.shape == score.shape
        assert found.cell_size_m == 1.0
        np.testing.assert_array_equal(np.isnan(found.sd), np.isnan(score))
        assert np.nansum(found.sd) == 0

    def test_all_of_it(self, tmp_path: Path) -> None:
        no_go = np.zeros((12, 9), bool)
        no_go[4] = True
        found = read_scoremap(
            self.save(tmp_path / "a.NPZ.npz", score=scores(), sd=scores() / 2, cell_size_m=2.5, no_go=no_go)
        )
        np.testing.assert_array_equal(np.isnan(found.score), no_go)
        np.testing.assert_array_equal(np.isnan(found.sd), no_go)
        np.testing.assert_array_equal(found.score[~no_go], scores()[~no_go])
        assert found.cell_size_m == 2.5

    @pytest.mark.parametrize("dtype", ["uint8", "int64", "float16", "float64", "bool"])
    def test_any_real_type_will_do(self, tmp_path: Path, dtype: str) -> None:
        score = (scores() * 3).astype(dtype)
        found = read_scoremap(self.save(tmp_path / "a.npz", score=np.asfortranarray(score)))
        assert found.score.dtype == np.float32
        np.testing.assert_array_equal(found.score, score.astype(np.float32))

    @pytest.mark.parametrize(
        ("arrays", "problem"),
        [
            ({"scores": scores()}, "unknown array 'scores'"),
            ({"score": scores(), "extra": 1}, "unknown array 'extra'"),
            ({"sd": scores()}, "no array 'score'"),
            ({"score": scores()[0]}, "score is not a"),
            ({"score": scores()[None]}, "score is not a"),
            ({"score": np.zeros((0, 4))}, "score is not a"),
            ({"score": scores().astype(complex)}, "score is not a"),
            ({"score": scores().astype(str)}, "score is not a"),
            ({"score": scores(), "sd": scores()[:5]}, r"sd has shape \(5, 9\), score has \(12, 9\)"),
            ({"score": scores(), "no_go": np.zeros((9, 12), bool)}, r"no_go has shape \(9, 12\)"),
            ({"score": scores(), "cell_size_m": 0.0}, "cell_size_m is not"),
            ({"score": scores(), "cell_size_m": -1}, "cell_size_m is not"),
            ({"score": scores(), "cell_size_m": math.nan}, "cell_size_m is not"),
            ({"score": scores(), "cell_size_m": math.inf}, "cell_size_m is not"),
            ({"score": scores(), "cell_size_m": [1.0, 2.0]}, "cell_size_m is not"),
            ({"score": scores(), "cell_size_m": "1"}, "cell_size_m is not"),
            ({"score": scores(), "cell_size_m": True}, "cell_size_m is not"),
            ({"score": scores() - 2}, "a negative score"),
            ({"score": np.full((3, 3), np.inf)}, "an infinite score"),
            ({"score": np.full((3, 3), 1e300)}, "an infinite score"),
            ({"score": np.full((3, 3), np.nan)}, "no cell that may be entered"),
            ({"score": scores(), "no_go": np.ones((12, 9), bool)}, "no cell that may be entered"),
            ({"score": scores(), "sd": -scores()}, "a negative standard deviation"),
            ({"score": scores(), "provenance": np.array("{}")}, "provenance record is damaged"),
        ],
    )
    def test_what_is_no_scoremap_is_refused(self, tmp_path: Path, arrays: dict[str, Any], problem: str) -> None:
        refused(self.save(tmp_path / "a.npz", **arrays), problem)

    def test_a_pickle_is_never_opened(self, tmp_path: Path) -> None:
        marker = tmp_path / "marker"

        class Payload:
            def __reduce__(self) -> tuple[Any, ...]:
                return (Path.touch, (marker,))

        refused(self.save(tmp_path / "a.npz", score=np.array([[Payload()]], object)), "never unpickled")
        assert not marker.exists()

    def test_a_tif_by_that_name_is_refused(self, tmp_path: Path) -> None:
        refused(write(tmp_path / "a.tif", scores()).rename(tmp_path / "a.npz"), "is not a readable NPZ")
