"""What a cell is worth: the mapping by hand, the stage on files, and the command."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from affine import Affine
from click.testing import CliRunner, Result
from raster_files import ORIGIN, write_raster
from rasterio.enums import ColorInterp
from rasterio.warp import transform

from hrt_cli.artifacts.stage import Existing
from hrt_cli.drivability.interest import Interest, degree, open_interest, weighed
from hrt_cli.drivability.stage import ScoremapSummary, make_scoremap
from hrt_cli.errors import ArgumentError, HrtError, InputError
from hrt_cli.main import cli
from hrt_cli.raster.cog import cog_provenance
from hrt_cli.raster.gate import open_raster
from hrt_cli.raster.scoremap import Scoremap, read_scoremap

pytestmark = pytest.mark.filterwarnings("ignore:Use `@` matmul:PendingDeprecationWarning")

WILDFIRE = Path(__file__).parents[2] / "fixtures" / "wildfire"
ROWS, COLS = 6, 8
# 180 km from the middle of its zone a metre of the map is one of ground: a cell of a metre is ten pixels.
EAST = ORIGIN[0] + 180_000
PIXEL = 0.1


def place(pixel: float = PIXEL, right: float = 0.0, down: float = 0.0) -> Affine:
    return Affine(pixel, 0, EAST + right, 0, -pixel, ORIGIN[1] - down)


class Site:
    """A map of 6 x 8 cells of about ten pixels a side, a table of scores, and no-go cells."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        rng = np.random.default_rng(5)
        classes = rng.integers(0, 3, (ROWS * 10, COLS * 10)).astype(np.uint8)
        classes[:10, :10] = 255
        classes[10:20, 30:40] = 2
        self.classes = write_raster(folder / "classes.tif", classes, transform=place(), nodata=255)
        self.scores = folder / "scores.json"
        table = {"0": {"alpha": 9, "beta": 1}, "1": {"alpha": 2, "beta": 2}, "2": {"mean": 0.1}}
        self.scores.write_text(json.dumps({"format": "hrt-scores", "version": 1, "scores": table}))
        with open_raster(self.classes) as raster:
            row_m, col_m = raster.grid.pixel_m
        self.cell_m = 10 * max(row_m, col_m)

    def raster(self, values: np.ndarray, name: str = "heat.tif", **options: Any) -> Path:
        return write_raster(self.folder / name, values, **{"transform": place(), **options})

    def heat(self) -> np.ndarray:
        values = np.random.default_rng(6).normal(20, 5, (ROWS * 10, COLS * 10)).astype(np.float32)
        values[33, 47] = 250
        values[:10, :10] = 900  # where the robot may not go
        values[40:50, 20:30] = np.nan
        return values

    def make(
        self, interest: Interest | None, output: str = "s.tif", **options: Any
    ) -> tuple[ScoremapSummary, Scoremap]:
        path = self.folder / output
        options = {"no_go_below": 0.2, "existing": Existing(overwrite=True), **options}
        done = make_scoremap(
            self.classes, path, scores_path=self.scores, cell_m=self.cell_m, interest=interest, **options
        )
        return done, read_scoremap(path)


@pytest.fixture
def site(tmp_path: Path) -> Site:
    return Site(tmp_path)


def by_cell(values: np.ndarray, cell: str) -> np.ndarray:
    """Reduce each block of 10 x 10 pixels, pixel by pixel."""
    out = np.full((ROWS, COLS), np.nan)
    for row in range(ROWS):
        for col in range(COLS):
            block = values[row * 10 : row * 10 + 10, col * 10 : col * 10 + 10]
            real = block[np.isfinite(block)]
            if real.size:
                out[row, col] = real.max() if cell == "max" else real.astype(float).mean()
    return out


class TestMapping:
    def test_it_is_linear_between_the_limits(self) -> None:
        values = np.array([[-5, 10, 15, 30, 40, np.nan]], np.float32)
        share, low, high = degree(Interest(Path("r"), (10, 30)), values, np.ones((1, 6), bool))
        assert share.tolist() == [[0, 0, 0.25, 1, 1, 0]]
        assert (low, high) == (10, 30)

    def test_without_limits_they_are_the_median_and_the_maximum_of_the_cells_to_go(self) -> None:
        values = np.array([[10, 20, 30, 60, 900, np.nan]], np.float32)
        go = np.array([[True, True, True, True, False, True]])
        share, low, high = degree(Interest(Path("r")), values, go)
        assert (low, high) == (25, 60)
        np.testing.assert_allclose(share, [[0, 0, 1 / 7, 1, 1, 0]])

    def test_weight(self) -> None:
        score = np.array([[0.8, 0.8, np.nan]], np.float32)
        share = np.array([[0.0, 0.5, 1.0]])
        np.testing.assert_allclose(weighed(score, share, 1.0), [[0, 0.4, np.nan]])
        np.testing.assert_allclose(weighed(score, share, 0.25), [[0.6, 0.7, np.nan]], rtol=1e-6)

    @pytest.mark.parametrize(
        ("values", "limits", "problem"),
        [
            ([5.0, 5.0, 5.0], None, "is the same in all cells"),
            ([1.0, 5.0, 5.0], None, "is highest in half of the cells"),
            ([np.nan] * 3, None, "holds no value"),
            ([np.nan] * 3, (0.0, 1.0), "holds no value"),
            ([1.0, 2.0, 3.0], (3.0, 9.0), "is nowhere above 3 where the robot may go"),
        ],
    )
    def test_what_gives_nothing_to_plan_for_is_refused(
        self, values: list[float], limits: tuple[float, float] | None, problem: str
    ) -> None:
        hot_but_closed = np.array([[*values, 99]], np.float32)
        with pytest.raises(InputError, match=f"^r: {problem}"):
            degree(Interest(Path("r"), limits), hot_but_closed, np.array([[True, True, True, False]]))

    @pytest.mark.parametrize("limits", [(3.0, 3.0), (4.0, 3.0)])
    def test_limits_the_wrong_way_round_are_refused(self, limits: tuple[float, float]) -> None:
        with pytest.raises(ArgumentError, match="must be below"):
            Interest(Path("r"), limits)


class TestStage:
    @pytest.mark.parametrize("cell", ["max", "mean"])
    @pytest.mark.parametrize("weight", [1.0, 0.3])
    @pytest.mark.parametrize("explore", [0.0, 2.0])
    def test_a_score_is_drivability_times_interest(self, site: Site, cell: Any, weight: float, explore: float) -> None:
        values = site.heat()
        _, plain = site.make(None, "plain.tif", explore=explore)
        interest = Interest(site.raster(values), (15.0, 40.0), cell, weight)
        done, found = site.make(interest, explore=explore)
        share = np.nan_to_num(np.clip((by_cell(values, cell) - 15) / 25, 0, 1))
        factor = (1 - weight) + weight * share
        np.testing.assert_allclose(found.score, plain.score * factor, rtol=1e-4, atol=1e-7)
        np.testing.assert_allclose(found.sd, plain.sd * factor, rtol=1e-4, atol=1e-7)
        np.testing.assert_array_equal(np.isnan(found.score), np.isnan(plain.score))
        go = np.isfinite(plain.score)
        assert np.isnan(found.score[[0, 1], [0, 3]]).all()
        assert done.interest_range == (15.0, 40.0)
        assert done.interest_cells == ((share > 0) & go).sum()
        assert done.go_cells == go.sum() == ROWS * COLS - 2

    def test_the_limits_found_are_those_of_the_cells_to_go(self, site: Site) -> None:
        values = site.heat()
        _, plain = site.make(None, "plain.tif")
        done, _ = site.make(Interest(site.raster(values)))
        cells = by_cell(values, "max")[np.isfinite(plain.score)]
        assert done.interest_range == (pytest.approx(np.nanmedian(cells)), 250)

    def test_one_hot_pixel_is_found_wherever_in_the_cell_it_lies(self, site: Site) -> None:
        for at in range(0, 100, 7):
            values = np.full((ROWS * 10, COLS * 10), 17, np.float32)
            values[30 + at // 10, 40 + at % 10] = 250
            _, found = site.make(Interest(site.raster(values, f"{at}.tif")))
            assert np.argwhere(found.score > 0).tolist() == [[3, 4]]

    def test_pixels_larger_than_a_cell_are_interpolated(self, site: Site) -> None:
        values = np.zeros((5, 5), np.float32)
        values[2, 2] = 100
        path = site.raster(values, transform=place(4.0, -6.0, -7.0))
        _, plain = site.make(None, "plain.tif")
        _, found = site.make(Interest(path, (0, 100)))
        share = found.score / plain.score
        assert 0.75 < np.nanmax(share) < 1
        assert len(np.unique(np.round(share[np.isfinite(share)], 4))) > 6

    def test_another_crs_and_a_smaller_extent(self, site: Site) -> None:
        with rasterio.open(site.classes) as dataset:
            x, y = EAST + 4.55, ORIGIN[1] - 3.45
            lon, lat = transform(dataset.crs, "EPSG:4326", [x], [y])
        values = np.full((40, 40), 5, np.float32)
        values[20, 20] = 80
        step = 1e-6
        spot = Affine(step, 0, lon[0] - 20.5 * step, 0, -step, lat[0] + 20.5 * step)
        path = site.raster(values, transform=spot, crs="EPSG:4326")
        done, found = site.make(Interest(path, (10, 80)))
        assert np.argwhere(found.score > 0).tolist() == [[3, 4]]
        assert done.interest_cells == 1

    def test_off_the_map_is_refused(self, site: Site) -> None:
        path = site.raster(site.heat(), transform=place(right=500))
        with pytest.raises(InputError, match="wholly beside") as refusal:
            site.make(Interest(path))
        assert str(refusal.value).startswith(f"{path}: ")
        assert not (site.folder / "s.tif").exists()

    @pytest.mark.parametrize("count", [2, 3])
    def test_several_bands_are_refused_by_number(self, site: Site, count: int) -> None:
        path = site.raster(np.stack([site.heat()] * count))
        with pytest.raises(InputError, match=f"has {count} bands; a raster of interest has one"):
            site.make(Interest(path))

    def test_alpha_and_a_mask_are_no_second_band(self, site: Site) -> None:
        values = np.full((ROWS * 10, COLS * 10), 9, np.uint8)
        values[30:40, 40:50] = 200
        values[50:60, 50:60] = 250
        seen = values != 250
        pixels = np.stack([values, seen.astype(np.uint8) * 255])
        alpha = site.raster(pixels, "alpha.tif", colours=(ColorInterp.gray, ColorInterp.alpha))
        masked = site.raster(values, "mask.tif", mask=seen)
        for path in (alpha, masked):
            with open_interest(path):
                pass
            done, found = site.make(Interest(path))
            assert done.interest_range == (9, 200)
            assert np.argwhere(found.score > 0).tolist() == [[3, 4]]

    def test_the_raster_is_an_input(self, site: Site) -> None:
        interest = Interest(site.raster(site.heat()), (15, 40))
        done, _ = site.make(interest, existing=Existing())
        again, _ = site.make(interest, existing=Existing())
        assert again.up_to_date
        assert (again.interest_range, again.interest_cells) == (done.interest_range, done.interest_cells)
        found = cog_provenance(site.folder / "s.tif")
        assert found is not None
        assert [each.role for each in found.inputs] == ["classes", "scores", "interest"]
        assert found.parameters["interest"] == {"range": [15, 40], "cell": "max", "weight": 1.0}
        with open_raster(site.folder / "s.tif") as raster:
            assert json.loads(raster.hrt_tags["INTEREST_RANGE"]) == [15, 40]
        for other in (Interest(interest.path, (15, 41)), Interest(interest.path, (15, 40), "mean"), None):
            with pytest.raises(HrtError, match="was not made by this run"):
                site.make(other, existing=Existing())
        site.raster(site.heat() + 1)
        with pytest.raises(HrtError, match="was not made by this run"):
            site.make(interest, existing=Existing())

    def test_without_interest_nothing_tells_of_it(self, site: Site) -> None:
        done, _ = site.make(None)
        assert done.interest_range is done.interest_cells is None
        found = cog_provenance(site.folder / "s.tif")
        assert found is not None
        assert set(found.parameters) == {"cell_m", "explore", "no_go_below", "creation"}
        with open_raster(site.folder / "s.tif") as raster:
            assert set(raster.hrt_tags) == {"CELL_SIZE_M", "PROVENANCE"}


def run(*words: object) -> Result:
    return CliRunner().invoke(cli, ["scoremap", *map(str, words)])


class TestCommand:
    def make(self, output: Path, *words: object) -> Result:
        return run(WILDFIRE / "truth.tif", "-o", output, "--interest", WILDFIRE / "thermal.tif", *words)

    def test_the_hottest_spots_are_of_interest(self, tmp_path: Path) -> None:
        world = json.loads((WILDFIRE / "world.json").read_text())
        done = self.make(tmp_path / "s.tif", "--interest-range", "60,200", "--json")
        assert done.exit_code == 0, done.stderr
        data = json.loads(done.stdout)
        assert data["interest_range"] == [60, 200]
        found = read_scoremap(tmp_path / "s.tif")
        assert data["interest_cells"] == (found.score > 0).sum() < 100
        spots = sorted(world["hotspots"], key=lambda spot: -spot["peak_c"])
        for spot in spots:
            row, col = (int(at) for at in found.grid.rowcol(*spot["xy"]))
            expected = 0.5 * min(1.0, (spot["peak_c"] - 60) / 140)
            assert found.score[row, col] >= expected * (1 - 1e-5)
        assert np.nanmax(found.score) == 0.5
        assert "counts 0 and" not in done.stderr

    def test_limits_that_were_not_given_are_told(self, tmp_path: Path) -> None:
        done = self.make(tmp_path / "s.tif")
        assert done.exit_code == 0
        assert "27.9 counts 0 and 281.4 counts 1, the median and the maximum" in done.stderr
        assert "of interest" in done.stdout
        again = self.make(tmp_path / "s.tif")
        assert "up to date" in again.stdout
        assert "27.9 counts 0 and 281.4 counts 1" in again.stderr

    def test_a_map_without_interest_has_no_such_keys(self, tmp_path: Path) -> None:
        done = run(WILDFIRE / "truth.tif", "-o", tmp_path / "s.tif", "--json")
        assert not {"interest_range", "interest_cells"} & set(json.loads(done.stdout))

    @pytest.mark.parametrize("text", ["60", "60,", "60,200,300", "a,b", "60;200", "nan,1", "0,inf"])
    def test_limits_that_are_none_are_a_slip(self, tmp_path: Path, text: str) -> None:
        assert self.make(tmp_path / "s.tif", "--interest-range", text).exit_code == 2

    @pytest.mark.parametrize(
        "words", [("--interest-range", "1,2"), ("--interest-cell", "max"), ("--interest-weight", "1")]
    )
    def test_its_options_need_a_raster(self, tmp_path: Path, words: tuple[str, str]) -> None:
        done = run(WILDFIRE / "truth.tif", "-o", tmp_path / "s.tif", *words)
        assert done.exit_code == 2
        assert "are for --interest" in done.stderr

    @pytest.mark.parametrize("weight", ["0", "-1", "1.1", "nan"])
    def test_a_weight_is_a_share(self, tmp_path: Path, weight: str) -> None:
        assert self.make(tmp_path / "s.tif", "--interest-weight", weight).exit_code == 2

    @pytest.mark.parametrize(("limits", "problem"), [("200,60", "must be below"), ("400,500", "nothing to plan for")])
    def test_what_cannot_be_is_refused(self, tmp_path: Path, limits: str, problem: str) -> None:
        done = self.make(tmp_path / "s.tif", "--interest-range", limits)
        assert isinstance(done.exception, HrtError)
        assert done.exception.exit_code == 1
        assert problem in str(done.exception)
        assert not (tmp_path / "s.tif").exists()
