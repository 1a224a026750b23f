"""Areas of interest and keep-outs on the scoremap: no walk over its cells leaves the one or enters the other."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
import shapely
from area_files import FORMS, GRIDS, HALF_M, LOCAL, as_kml, classes_on, crs_of, drawn, moved, polygons
from click.testing import CliRunner, Result
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from raster_files import write_raster

from hrt_cli.artifacts.stage import Existing
from hrt_cli.drivability.interest import Interest
from hrt_cli.drivability.limits import Limits
from hrt_cli.drivability.stage import ScoremapSummary, make_scoremap
from hrt_cli.errors import HrtError, InputError
from hrt_cli.main import cli
from hrt_cli.planning.planner import plan
from hrt_cli.planning.problem import Budget, NothingLeftError, Problem
from hrt_cli.raster.cog import cog_provenance
from hrt_cli.raster.gate import open_raster
from hrt_cli.raster.grid import Grid
from hrt_cli.raster.scoremap import Scoremap, read_scoremap

pytestmark = pytest.mark.filterwarnings("ignore:Use `@` matmul:PendingDeprecationWarning")


@pytest.fixture(scope="module", params=GRIDS)
def classes(request: pytest.FixtureRequest) -> Iterator[Path]:
    with TemporaryDirectory() as folder:
        yield classes_on(Path(folder), request.param)


def cells_of(grid: Grid) -> Any:
    """Return every cell as a square of the local projection."""
    row, col = np.mgrid[: grid.rows, : grid.cols]
    squares = shapely.box(col, row, col + 1, row + 1)
    return moved(shapely.transform(squares, lambda p: np.stack(grid.xy(p[:, 1], p[:, 0]), axis=1)), crs_of(grid), LOCAL)


def make(classes: Path, output: Path, limits: Limits, **options: Any) -> tuple[ScoremapSummary, Scoremap]:
    options = {"existing": Existing(overwrite=True), "cell_m": 1.0, **options}
    done = make_scoremap(classes, output, limits=limits, **options)
    return done, read_scoremap(output)


@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.filter_too_much])
@given(
    aoi=st.none() | polygons(2 * HALF_M),
    keep_out=polygons(HALF_M / 2),
    forms=st.tuples(FORMS, FORMS),
    margin_m=st.sampled_from([0.0, 0.0, 0.8, 2.5]),
    connectivity=st.sampled_from([4, 8]),
    method=st.sampled_from(["greedy", "random", "refined"]),
    where=st.floats(0, 1, exclude_max=True),
)
def test_no_walk_enters_a_keep_out_or_leaves_the_area(
    classes: Path, aoi: Any, keep_out: Any, forms: tuple[str, str], margin_m: float, connectivity: int, method: str,
    where: float,
) -> None:  # fmt: skip
    with TemporaryDirectory() as name:
        folder = Path(name)
        limits = Limits(
            drawn(folder, "aoi", aoi, forms[0]) if aoi else None, (drawn(folder, "keep", keep_out, forms[1]),)
        )
        try:
            _, found = make(classes, folder / "s.tif", limits, margin_m=margin_m)
        except InputError as error:
            # Only where there is nowhere to go: nothing else may be wrong with these files.
            if not re.search("leaves nowhere to go|lies outside", str(error)):
                raise
            return
    go = np.argwhere(np.isfinite(found.score))
    start = tuple(map(int, go[int(where * len(go))]))
    try:
        walk = plan(Problem(found.score, start, Budget(30), connectivity), method, effort=0.01, samples=4).cells
    except NothingLeftError:
        walk = np.array([start])
    x, y = found.grid.xy(walk[:, 0] + 0.5, walk[:, 1] + 0.5)
    path = moved(shapely.LineString(np.stack([x, y], axis=1).repeat(2, axis=0)), crs_of(found.grid), LOCAL)
    assert shapely.distance(path, keep_out) > margin_m
    if aoi:
        assert path.within(aoi)
        assert shapely.distance(path, aoi.boundary) > margin_m


class TestCells:
    SHAPE = shapely.Polygon([(-5, -4), (6, -5), (4, 5), (-3, 3)], [[(-1, -1), (2, -1), (2, 2), (-1, 2)]])

    @pytest.mark.parametrize("margin_m", [0.0, 1.7])
    def test_those_that_a_keep_out_touches_and_no_others_are_taken(
        self, tmp_path: Path, classes: Path, margin_m: float
    ) -> None:
        done, found = make(
            classes, tmp_path / "s.tif", Limits(None, (drawn(tmp_path, "k", self.SHAPE),)), margin_m=margin_m
        )
        away = shapely.distance(cells_of(found.grid), self.SHAPE)
        taken = np.isnan(found.score)
        assert taken[away <= margin_m].all()
        assert not taken[away > margin_m * 1.02 + 0.03].any()
        assert done.keep_out_cells == taken.sum()
        assert done.aoi_cells is None
        np.testing.assert_array_equal(taken, np.isnan(found.sd))
        if not margin_m:
            assert not taken[shapely.covered_by(cells_of(found.grid), shapely.Point(0.5, 0.5).buffer(1))].any()

    @pytest.mark.parametrize("margin_m", [0.0, 0.6])
    def test_those_wholly_in_the_area_and_no_others_stay(self, tmp_path: Path, classes: Path, margin_m: float) -> None:
        done, found = make(
            classes, tmp_path / "s.tif", Limits(drawn(tmp_path, "a", self.SHAPE, "kml")), margin_m=margin_m
        )
        inside = shapely.covered_by(cells_of(found.grid), self.SHAPE)
        from_edge = shapely.distance(cells_of(found.grid), self.SHAPE.boundary)
        stay = np.isfinite(found.score)
        assert (inside & (from_edge > margin_m))[stay].all()
        assert stay[inside & (from_edge > margin_m * 1.02 + 0.03)].all()
        assert done.aoi_cells == (~stay).sum()
        assert done.keep_out_cells is None


@pytest.fixture
def site(tmp_path: Path) -> Path:
    return classes_on(tmp_path, "utm")


def box(size: float, x: float = 0.0, y: float = 0.0) -> Any:
    return shapely.box(x - size, y - size, x + size, y + size)


class TestStage:
    def test_each_cell_is_counted_once_for_what_took_it(self, site: Path, tmp_path: Path) -> None:
        with_nodata = classes_on(tmp_path, "utm", seed=1)
        plain, _ = make(with_nodata, tmp_path / "p.tif", Limits(), no_go_below=0.4)
        aoi, one = drawn(tmp_path, "aoi", box(6)), drawn(tmp_path, "one", box(3, 5, 5), "kml")
        two = drawn(tmp_path, "two", box(2, 4, 4), "EPSG:3857")
        done, _ = make(with_nodata, tmp_path / "s.tif", Limits(aoi, (one, two)), no_go_below=0.4)
        alone, _ = make(with_nodata, tmp_path / "a.tif", Limits(aoi), no_go_below=0.4)
        assert done.aoi_cells == alone.aoi_cells == plain.go_cells - alone.go_cells > 0
        assert done.keep_out_cells == alone.go_cells - done.go_cells > 0

    def test_what_is_told_is_told_again(self, site: Path, tmp_path: Path) -> None:
        limits = Limits(
            drawn(tmp_path, "aoi", box(6)), (drawn(tmp_path, "k", box(1)), drawn(tmp_path, "far", box(1, 500)))
        )
        done, _ = make(site, tmp_path / "s.tif", limits)
        again, _ = make(site, tmp_path / "s.tif", limits, existing=Existing())
        assert again.up_to_date
        assert (again.aoi_cells, again.keep_out_cells) == (done.aoi_cells, done.keep_out_cells)
        assert again.notes == done.notes == [f"{limits.keep_out[1]}: lies outside {site}"]

    def test_the_files_are_inputs(self, site: Path, tmp_path: Path) -> None:
        aoi, keep_out = drawn(tmp_path, "aoi", box(6)), drawn(tmp_path, "k", box(1), "kml")
        make(site, tmp_path / "s.tif", Limits(aoi, (keep_out, keep_out)))
        found = cog_provenance(tmp_path / "s.tif")
        assert found is not None
        assert [each.role for each in found.inputs] == ["classes", "aoi", "keep_out/0", "keep_out/1"]
        with open_raster(tmp_path / "s.tif") as raster:
            assert {"AOI_CELLS", "KEEP_OUT_CELLS"} <= set(raster.hrt_tags)
        for other in (Limits(aoi), Limits(None, (keep_out,)), Limits()):
            with pytest.raises(HrtError, match="was not made by this run"):
                make(site, tmp_path / "s.tif", other, existing=Existing())
        drawn(tmp_path, "k", box(1.1), "kml")
        with pytest.raises(HrtError, match="was not made by this run"):
            make(site, tmp_path / "s.tif", Limits(aoi, (keep_out, keep_out)), existing=Existing())

    def test_without_limits_a_map_is_what_it_was(self, site: Path, tmp_path: Path) -> None:
        make(site, tmp_path / "s.tif", Limits())
        found = cog_provenance(tmp_path / "s.tif")
        assert found is not None
        assert set(found.parameters) == {"cell_m", "explore", "no_go_below", "creation"}
        with open_raster(tmp_path / "s.tif") as raster:
            assert set(raster.hrt_tags) == {"CELL_SIZE_M", "PROVENANCE"}

    def test_what_is_kept_out_of_does_not_set_the_limits_of_interest(self, site: Path, tmp_path: Path) -> None:
        with open_raster(site) as raster:
            grid = raster.grid
        heat = np.random.default_rng(1).normal(20, 1, grid.shape).astype(np.float32)
        heat[34:38, 34:38] = 500
        interest = Interest(write_raster(tmp_path / "h.tif", heat, crs="EPSG:32633", transform=grid.transform))
        done, _ = make(site, tmp_path / "s.tif", Limits(None, (drawn(tmp_path, "k", box(2)),)), interest=interest)
        assert done.interest_range is not None
        assert done.interest_range[1] < 30
        assert done.keep_out_cells

    @pytest.mark.parametrize("form", ["kml", "EPSG:32633"])
    def test_a_limit_that_leaves_nothing_is_refused_by_name(self, site: Path, tmp_path: Path, form: str) -> None:
        small, all_of_it = drawn(tmp_path, "small", box(0.4), form), drawn(tmp_path, "all", box(99), form)
        some = drawn(tmp_path, "some", box(2))
        for limits, path, why in (
            (Limits(small), small, "no cell that may be entered lies wholly in it"),
            (Limits(None, (some, all_of_it)), all_of_it, "no cell that may be entered keeps clear of it"),
        ):
            with pytest.raises(InputError, match="leaves nowhere to go") as refusal:
                make(site, tmp_path / "s.tif", limits)
            assert str(refusal.value).startswith(f"{path}: ")
            assert why in str(refusal.value)
            assert not (tmp_path / "s.tif").exists()

    def test_a_map_without_a_place_has_no_limits(self, tmp_path: Path) -> None:
        plain = write_raster(tmp_path / "c.tif", np.zeros((20, 20), np.uint8), crs=None, transform=None, nodata=255)
        with pytest.raises(InputError):
            make(plain, tmp_path / "s.tif", Limits(None, (drawn(tmp_path, "k", box(2)),)))


def run(*words: object) -> Result:
    return CliRunner().invoke(cli, ["scoremap", *map(str, words)])


class TestCommand:
    def test_it_tells_what_the_limits_took(self, site: Path, tmp_path: Path) -> None:
        words = ["--aoi", drawn(tmp_path, "aoi", box(6)), "--keep-out", drawn(tmp_path, "k", box(1), "kml")]
        done = run(site, "-o", tmp_path / "s.tif", *words, "--keep-out", drawn(tmp_path, "l", box(1, 3)))
        assert done.exit_code == 0, done.stderr
        again = json.loads(run(site, "-o", tmp_path / "t.tif", *words, "--json").stdout)
        assert f"{again['aoi_cells']} outside the area of interest, " in done.stdout
        assert "kept out of, mean score" in done.stdout
        assert again["keep_out_cells"] > 0
        assert again["notes"] == []

    def test_a_map_without_limits_has_no_such_keys(self, site: Path, tmp_path: Path) -> None:
        done = run(site, "-o", tmp_path / "s.tif", "--json")
        assert not {"aoi_cells", "keep_out_cells", "limit_notes"} & set(json.loads(done.stdout))

    def test_longitude_and_latitude_exchanged_are_suspected_aloud(self, site: Path, tmp_path: Path) -> None:
        swapped = shapely.transform(moved(box(3), LOCAL, "EPSG:4326"), lambda p: p[:, ::-1])
        path = tmp_path / "k.kml"
        path.write_text(as_kml(swapped))
        done = run(site, "-o", tmp_path / "s.tif", "--keep-out", path)
        assert done.exit_code == 0
        assert f"Note: {path}: lies outside {site} (longitude and latitude seem to be exchanged" in done.stderr
        refused = run(site, "-o", tmp_path / "t.tif", "--aoi", path)
        assert isinstance(refused.exception, InputError)
        assert "seem to be exchanged" in str(refused.exception)

    def test_a_margin_is_for_any_limit_and_only_for_one(self, site: Path, tmp_path: Path) -> None:
        path = drawn(tmp_path, "a", box(5))
        assert run(site, "-o", tmp_path / "s.tif", "--margin", 1).exit_code == 2
        for words in (("--aoi", path), ("--keep-out", path), ("--no-go-below", "0.1")):
            done = run(site, "-o", tmp_path / "s.tif", "--margin", "1.5", *words, "--overwrite")
            assert done.exit_code == 0, done.stderr

    def test_labels_of_google_earth_are_told_of(self, site: Path, tmp_path: Path) -> None:
        path = drawn(tmp_path, "k", box(2), "kml")
        path.write_text(path.read_text().replace("</kml>", "<Placemark><Point/></Placemark></kml>"))
        path.write_text(path.read_text().replace('2.2">', '2.2"><Document>').replace("</kml>", "</Document></kml>"))
        done = run(site, "-o", tmp_path / "s.tif", "--keep-out", path)
        assert f"Note: {path}: placemarks that are points" in done.stderr


def test_a_margin_is_measured_on_the_ground(tmp_path: Path) -> None:
    # Web-mercator at 47 degrees: a metre of the map is two thirds of one on the ground.
    site = classes_on(tmp_path, "mercator")
    _, found = make(site, tmp_path / "s.tif", Limits(None, (drawn(tmp_path, "k", box(0.1)),)), margin_m=4.0, cell_m=0.5)
    away = shapely.distance(cells_of(found.grid), box(0.1))
    barred = np.isnan(found.score)
    assert barred[away <= 4.0].all()
    assert not barred[away > 4.15].any()
    assert barred.sum() * 0.25 == pytest.approx(math.pi * 4.6**2, rel=0.15)


def test_a_margin_wider_than_the_map_reaches_as_far_as_any_other(tmp_path: Path) -> None:
    site, keep_out = classes_on(tmp_path, "turned"), drawn(tmp_path, "k", box(1, 80))
    _, found = make(site, tmp_path / "s.tif", Limits(None, (keep_out,)), margin_m=80.0)
    away = shapely.distance(cells_of(found.grid), box(1, 80))
    assert np.isnan(found.score)[away <= 80].all()
    assert np.isfinite(found.score)[away > 82].all()
    assert np.isfinite(found.score).any()
    done, _ = make(site, tmp_path / "t.tif", Limits(drawn(tmp_path, "a", box(2000))), margin_m=1900.0)
    assert done.aoi_cells == 0
