"""A surface model, thermal units and a sensor's radius on files: what they make of a scoremap, and what they tell."""

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

from hrt_cli.artifacts.stage import Existing
from hrt_cli.drivability.interest import Interest
from hrt_cli.drivability.stage import ScoremapSummary, make_scoremap
from hrt_cli.drivability.surface import Relief
from hrt_cli.errors import ArgumentError, HrtError, InputError
from hrt_cli.main import cli
from hrt_cli.raster.cog import cog_provenance
from hrt_cli.raster.scoremap import Scoremap, read_scoremap

pytestmark = pytest.mark.filterwarnings("ignore:Use `@` matmul:PendingDeprecationWarning")

WILDFIRE = Path(__file__).parents[2] / "fixtures" / "wildfire"
# 180 km from the middle of its zone a metre of the map is one of ground.
EAST, NORTH = ORIGIN[0] + 180_000, ORIGIN[1]
ROWS, COLS = 12, 16
REPLACE = Existing(overwrite=True)


class Site:
    """Two classes in 12 x 16 cells of a metre; ground that is level, steep, rough or of unknown height."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        classes = np.zeros((ROWS * 10, COLS * 10), np.uint8)
        classes[:, 80:] = 1
        classes[:10, :10] = 255
        self.classes = write_raster(folder / "classes.tif", classes, transform=self.place(), nodata=255)
        self.scores = folder / "scores.json"
        table = {"0": {"alpha": 9, "beta": 1}, "1": {"alpha": 4, "beta": 4}}
        self.scores.write_text(json.dumps({"format": "hrt-scores", "version": 1, "scores": table}))

    @staticmethod
    def place(pixel: float = 0.1) -> Affine:
        return Affine(pixel, 0, EAST, 0, -pixel, NORTH)

    def dsm(self, name: str = "dsm.tif", slope: float = 0.0) -> Path:
        """Write heights: a slope in columns 4 to 6, a cliff at column 10, rubble in 13 and 14, none in rows 10, 11."""
        x = (np.arange(COLS * 10) + 0.5) / 10
        z = np.tile(100 + slope * np.clip(x - 3.5, 0, 4), (ROWS * 10, 1))
        z[:, 105:] += 3
        rubble = np.random.default_rng(1).choice([-0.2, 0.2], (ROWS * 4, 8))
        z[:, 130:150] += np.kron(rubble, np.ones((5, 5)))[: ROWS * 10, :20] * (np.arange(ROWS * 10) < 100)[:, None]
        z[100:] = -9999
        return write_raster(self.folder / name, z.astype(np.float32), transform=self.place(), nodata=-9999)

    def raster(self, values: np.ndarray, name: str = "heat.tif", **options: Any) -> Path:
        return write_raster(self.folder / name, values, **{"transform": self.place(), **options})

    def heat(self) -> np.ndarray:
        """Degrees Celsius in hundredths: warm ground with two hot spots."""
        values = np.random.default_rng(6).normal(24, 3, (ROWS * 10, COLS * 10)).round(2)
        values[33:36, 47:49] = 95.25
        values[72:75, 122:125] = 71.5
        return values

    def make(self, output: str = "s.tif", **options: Any) -> tuple[ScoremapSummary, Scoremap]:
        options = {"scores_path": self.scores, "existing": REPLACE, **options}
        done = make_scoremap(self.classes, self.folder / output, **options)
        return done, read_scoremap(self.folder / output)


@pytest.fixture
def site(tmp_path: Path) -> Site:
    return Site(tmp_path)


class TestRelief:
    def test_steep_and_rough_ground_is_no_go_and_mild_slopes_count_less(self, site: Site) -> None:
        _, plain = site.make("plain.tif")
        done, found = site.make(relief=Relief(site.dsm(slope=0.3)))
        factor = found.score / plain.score
        expected = 1 - (np.degrees(np.arctan(0.3)) / 35) ** 2
        np.testing.assert_allclose(factor[:9, 4:7], expected, rtol=2e-3)
        np.testing.assert_allclose((found.sd / plain.sd)[:9, 4:7], expected, rtol=2e-3)
        np.testing.assert_allclose(factor[1:9, 0:3], 1, rtol=1e-5)
        assert np.isnan(found.score[:9, 10]).all()
        assert np.isnan(found.score[:9, 13:15]).sum() > 8
        assert np.isfinite(found.score[11, 1:]).all()
        np.testing.assert_allclose(factor[11, 1:], 1, rtol=1e-5)
        no_go = np.isnan(found.score) & np.isfinite(plain.score)
        assert done.go_cells == np.isfinite(found.score).sum() == ROWS * COLS - 1 - no_go.sum()
        assert done.steep_cells is not None
        assert done.rough_cells is not None
        assert max(done.steep_cells, done.rough_cells) <= no_go.sum() <= done.steep_cells + done.rough_cells
        assert done.terrain_unknown_share == pytest.approx(
            (np.isfinite(found.score)[10:].sum()) / done.go_cells, abs=0.1
        )
        assert any("has no heights for" in note and "count as level" in note for note in done.notes)

    def test_the_share_without_heights_is_that_of_the_cells_to_go(self, site: Site) -> None:
        done, found = site.make(relief=Relief(site.dsm()), no_go_below=0.6)
        go = np.isfinite(found.score)
        assert go[10:].sum() == 2 * COLS // 2
        assert done.terrain_unknown_share == go[10:].sum() / go.sum()
        share = f"{16 / go.sum():.1%} of the cells to go, which count as level"
        assert done.notes == [f"{site.folder / 'dsm.tif'}: has no heights for {share}"]

    def test_the_limits_are_where_it_ends(self, site: Site) -> None:
        path = site.dsm(slope=0.3)
        slope = float(np.degrees(np.arctan(0.3)))
        for limit, closed in ((slope * 0.99, True), (slope * 1.02, False)):
            _, found = site.make(relief=Relief(path, limit))
            assert np.isnan(found.score[1:9, 4:7]).all() == closed
        most, _ = site.make(relief=Relief(path, 89.9, 1.0))
        assert (most.steep_cells, most.rough_cells) == (0, 0)
        assert most.go_cells == ROWS * COLS - 1

    def test_no_go_below_is_held_to_what_the_relief_leaves(self, site: Site) -> None:
        relief = Relief(site.dsm(slope=0.3), 18.0)
        _, plain = site.make("plain.tif", relief=relief)
        left = float(plain.score[5, 5])
        assert 0 < left < 0.3
        _, found = site.make(relief=relief, no_go_below=left * 1.1)
        assert np.isnan(found.score[1:9, 4:7]).all()
        _, near = site.make(relief=relief, no_go_below=left * 1.1, margin_m=1.0)
        assert np.isnan(near.score[1:9, 3]).all()
        assert np.isfinite(found.score[1:9, 2]).all()

    def test_exploring_does_not_open_what_is_steep(self, site: Site) -> None:
        _, found = site.make(relief=Relief(site.dsm()), explore=5.0)
        assert np.isnan(found.score[:9, 10]).all()

    def test_it_decides_before_interest_does(self, site: Site) -> None:
        values = np.zeros((ROWS * 10, COLS * 10), np.float32)
        values[:, 105] = 9
        values[55, 25] = 5
        interest = Interest(site.raster(values), (0, 5))
        done, found = site.make(interest=interest, relief=Relief(site.dsm()))
        assert np.isnan(found.score[:9, 10]).all()
        assert found.score[5, 2] == pytest.approx(0.9, rel=1e-3)
        assert done.interest_cells == 1 + np.isfinite(found.score[:, 10]).sum()

    def test_the_model_is_an_input(self, site: Site) -> None:
        relief = Relief(site.dsm(), 30.0)
        done, _ = site.make(relief=relief, existing=Existing())
        again, _ = site.make(relief=relief, existing=Existing())
        assert again.up_to_date
        told = ("steep_cells", "rough_cells", "terrain_unknown_share", "notes", "go_cells")
        assert [getattr(again, name) for name in told] == [getattr(done, name) for name in told]
        found = cog_provenance(site.folder / "s.tif")
        assert found is not None
        assert [each.role for each in found.inputs] == ["classes", "scores", "dsm"]
        assert found.parameters["relief"] == {"slope_limit_deg": 30.0, "rugosity_limit": 0.1}
        for other in (Relief(relief.path, 31.0), Relief(relief.path, 30.0, 0.2), None):
            with pytest.raises(HrtError, match="was not made by this run"):
                site.make(relief=other, existing=Existing())

    def test_a_coarse_model_is_told_of(self, site: Site) -> None:
        z = np.full((8, 10), 5, np.float32)
        for pixel, told in ((2.0, True), (0.4, False)):
            path = site.raster(np.kron(z, np.ones((5, 5), np.float32)), "c.tif", transform=site.place(pixel))
            done, _ = site.make(relief=Relief(path))
            assert any("obstacles smaller than that do not show" in note for note in done.notes) == told

    def test_a_place_without_any_height_is_refused(self, site: Site) -> None:
        path = site.raster(np.full((ROWS * 10, COLS * 10), np.nan, np.float32), "void.tif")
        with pytest.raises(InputError, match="tells the height of no cell that has a class"):
            site.make(relief=Relief(path))
        assert not (site.folder / "s.tif").exists()

    def test_if_all_is_steep_it_says_so(self, site: Site) -> None:
        z = np.tile(np.arange(COLS * 10, dtype=np.float32), (ROWS * 10, 1))
        with pytest.raises(InputError, match="or steep or rough by --dsm"):
            site.make(relief=Relief(site.raster(z, "cliff.tif")))


class TestThermal:
    def test_kelvin_and_centikelvin_make_the_same_scoremap_as_celsius(self, site: Site) -> None:
        celsius = site.heat()
        files = {
            "celsius": site.raster(celsius.astype(np.float32), "c.tif"),
            "kelvin": site.raster((celsius + 273.15).astype(np.float32), "k.tif"),
            "centikelvin": site.raster(np.round((celsius + 273.15) * 100).astype(np.uint16), "ck.tif"),
        }
        _, plain = site.make("plain.tif", interest=Interest(files["celsius"], (45, 90)))
        for units, path in files.items():
            for asked in (units, "auto"):
                if (asked, units) == ("auto", "celsius"):
                    continue
                done, found = site.make(interest=Interest(path, (45, 90), units=asked))
                np.testing.assert_allclose(found.score, plain.score, rtol=0, atol=1e-6)
                np.testing.assert_allclose(found.sd, plain.sd, rtol=0, atol=1e-6)
                assert done.thermal_units == units
                assert done.interest_range == (45, 90)
                assert any("taken to be" in note for note in done.notes) == (asked == "auto")
        assert np.nanmax(plain.score) > 0.5

    def test_the_limits_found_are_in_celsius(self, site: Site) -> None:
        path = site.raster((site.heat() + 273.15).astype(np.float32), "k.tif")
        done, _ = site.make(interest=Interest(path, units="kelvin"))
        assert done.interest_range == (pytest.approx(30, abs=3), pytest.approx(95.25, abs=1e-3))

    def test_a_guess_is_refused_and_nothing_is_written(self, site: Site) -> None:
        path = site.raster(site.heat().astype(np.float32))
        with pytest.raises(InputError, match=r"say --thermal-units celsius if that is right"):
            site.make(interest=Interest(path, (45, 90), units="auto"))
        assert not (site.folder / "s.tif").exists()

    def test_an_interest_that_all_cells_reach_is_refused(self, site: Site) -> None:
        raw = np.round((site.heat() + 273.15) * 100).astype(np.uint16)
        path = site.raster(raw)
        with pytest.raises(InputError, match=r"reaches 90 in every cell that may be entered \(.*another unit"):
            site.make(interest=Interest(path, (45, 90)))
        values = raw.astype(np.float32)
        values[60:] = np.nan  # elsewhere there is nothing of interest: then it says something
        done, _ = site.make(interest=Interest(site.raster(values, "half.tif"), (45, 90)))
        assert done.interest_cells == ROWS // 2 * COLS - 1

    def test_without_the_option_only_a_note_is_new(self, site: Site) -> None:
        path = site.raster((site.heat() + 273.15).astype(np.float32))
        done, _ = site.make(interest=Interest(path, (318.15, 363.15)))
        assert done.thermal_units is None
        assert [note for note in done.notes if "looks like temperatures in Kelvin" in note] == done.notes
        again, _ = site.make(interest=Interest(path, (318.15, 363.15)), existing=Existing())
        assert again.up_to_date
        assert again.notes == done.notes

    def test_the_unit_is_a_parameter(self, site: Site) -> None:
        path = site.raster((site.heat() + 273.15).astype(np.float32))
        site.make(interest=Interest(path, (45, 90), units="auto"))
        again, _ = site.make(interest=Interest(path, (45, 90), units="auto"), existing=Existing())
        assert (again.up_to_date, again.thermal_units) == (True, "kelvin")
        with pytest.raises(HrtError, match="was not made by this run"):
            site.make(interest=Interest(path, (45, 90), units="kelvin"), existing=Existing())


class TestRadius:
    def test_a_spot_on_a_cliff_is_sampled_from_beside_it(self, site: Site) -> None:
        values = np.zeros((ROWS * 10, COLS * 10), np.float32)
        values[52:55, 105] = 9
        interest = Interest(site.raster(values), (0, 9), radius_m=2.5)
        with pytest.raises(InputError, match="is nowhere above 0 where the robot may go"):
            site.make(interest=Interest(interest.path, (0, 9)), relief=Relief(site.dsm()))
        done, found = site.make(interest=interest, relief=Relief(site.dsm()))
        at = np.unravel_index(np.nanargmax(found.score), found.score.shape)
        assert at in ((5, 9), (5, 11))
        assert np.isnan(found.score[5, 10])
        assert done.interest_out_of_reach == 0
        rest = np.delete(found.score.ravel(), np.nanargmax(found.score))
        assert 0 < np.nansum(rest) < 0.25 * np.nanmax(found.score)

    def test_spots_out_of_reach_are_counted(self, site: Site) -> None:
        values = np.zeros((ROWS * 10, COLS * 10), np.float32)
        values[52:55, 45] = values[52:55, 125] = 9
        table = {"0": 0.9, "1": 0.0}
        site.scores.write_text(json.dumps({"format": "hrt-scores", "version": 1, "scores": table}))
        interest = Interest(site.raster(values), (0, 9), radius_m=2.0)
        done, found = site.make(interest=interest, no_go_below=0.5)
        assert done.interest_out_of_reach == 1
        assert found.score[5, 4] == pytest.approx(0.9)
        again, _ = site.make(interest=interest, no_go_below=0.5, existing=Existing())
        assert (again.up_to_date, again.interest_out_of_reach) == (True, 1)

    def test_out_of_reach_altogether_is_refused(self, site: Site) -> None:
        values = np.zeros((ROWS * 10, COLS * 10), np.float32)
        values[55, 125] = 9
        site.scores.write_text(json.dumps({"format": "hrt-scores", "version": 1, "scores": {"0": 0.9, "1": 0.0}}))
        with pytest.raises(InputError, match="nothing to plan for"):
            site.make(interest=Interest(site.raster(values), (0, 9), radius_m=2.0), no_go_below=0.5)

    @pytest.mark.parametrize("radius", [0.0, -1.0, float("nan"), float("inf")])
    def test_a_radius_is_a_length(self, radius: float) -> None:
        with pytest.raises(ArgumentError, match="--interest-radius"):
            Interest(Path("r.tif"), radius_m=radius)

    def test_it_is_in_metres_whatever_the_cells_measure(self, site: Site) -> None:
        values = np.zeros((ROWS * 10, COLS * 10), np.float32)
        values[55, 45] = 9
        for cell_m in (0.5, 1.0, 2.0):
            _, found = site.make(cell_m=cell_m, interest=Interest(site.raster(values), (0, 9), radius_m=3.0))
            rows, cols = np.nonzero(found.score > 0)
            reach = np.hypot(rows - int(5.55 / cell_m), cols - int(4.55 / cell_m)).max() * cell_m
            assert 1.4 < reach < 3.0


def run(*words: object) -> Result:
    return CliRunner().invoke(cli, ["scoremap", *map(str, words)])


class TestCommand:
    def test_scores_of_classes_that_are_not_there_are_told(self, tmp_path: Path) -> None:
        site = Site(tmp_path)
        done = run(site.classes, "-o", tmp_path / "s.tif", "--scores", site.scores)
        assert "which" not in done.stderr
        table = json.loads(site.scores.read_text())
        table["scores"] |= {"2": {"mean": 0.7}, "9": {"mean": 0.0}}
        site.scores.write_text(json.dumps(table))
        done = run(site.classes, "-o", tmp_path / "s.tif", "--scores", site.scores, "--overwrite")
        assert "has scores of class 2, 9, which" in done.stderr
        # A class that the raster names is none of those, though no pixel of a crop may hold it.
        names = len(json.loads((WILDFIRE / "world.json").read_text())["classes"])
        every = {str(k): 0.5 for k in range(names + 1)}
        site.scores.write_text(json.dumps({"scores": every}))
        done = run(WILDFIRE / "truth.tif", "-o", tmp_path / "t.tif", "--scores", site.scores)
        assert f"has scores of class {names}, which" in done.stderr

    def test_json_keys_and_notes(self, tmp_path: Path) -> None:
        words = (WILDFIRE / "truth.tif", "-o", tmp_path / "s.tif", "--dsm", WILDFIRE / "dsm.tif", "--json")
        heat = ("--interest", WILDFIRE / "thermal.tif", "--interest-range", "45,90", "--interest-radius", 2)
        done = run(*words, *heat, "--thermal-units", "auto")
        assert done.exit_code == 0, done.stderr
        data = json.loads(done.stdout)
        assert data["thermal_units"] == "celsius"
        assert data["interest_out_of_reach"] == 0
        assert data["steep_cells"] > 100
        assert data["rough_cells"] > 10
        assert data["terrain_unknown_share"] == 0
        assert "it says 'temperature in degrees Celsius'" in done.stderr
        plain = run(WILDFIRE / "truth.tif", "-o", tmp_path / "p.tif", "--json")
        new = {"thermal_units", "interest_out_of_reach", "steep_cells", "rough_cells", "terrain_unknown_share"}
        assert new.isdisjoint(json.loads(plain.stdout))

    def test_the_human_line_tells_what_is_steep_and_what_is_out_of_reach(self, tmp_path: Path) -> None:
        done = run(WILDFIRE / "truth.tif", "-o", tmp_path / "s.tif", "--dsm", WILDFIRE / "dsm.tif")
        assert " steep, " in done.stdout
        assert " rough, " in done.stdout

    @pytest.mark.parametrize(
        ("words", "owner"),
        [
            (("--slope-limit", "30"), "--dsm"),
            (("--rugosity-limit", "0.1"), "--dsm"),
            (("--interest-radius", "2"), "--interest"),
            (("--thermal-units", "auto"), "--interest"),
        ],
    )
    def test_options_without_their_raster_are_a_slip(self, tmp_path: Path, words: tuple[str, str], owner: str) -> None:
        done = run(WILDFIRE / "truth.tif", "-o", tmp_path / "s.tif", *words)
        assert done.exit_code == 2
        assert f"are for {owner}" in done.stderr

    @pytest.mark.parametrize(
        "words",
        [("--slope-limit", "0"), ("--slope-limit", "91"), ("--rugosity-limit", "0"), ("--rugosity-limit", "1.5")],
    )
    def test_limits_out_of_range_are_a_slip(self, tmp_path: Path, words: tuple[str, str]) -> None:
        done = run(WILDFIRE / "truth.tif", "-o", tmp_path / "s.tif", "--dsm", WILDFIRE / "dsm.tif", *words)
        assert done.exit_code == 2

    def test_a_vrt_of_heights_names_its_parts(self, tmp_path: Path) -> None:
        with rasterio.open(WILDFIRE / "dsm.tif") as dataset:
            rows, cols, place, crs = dataset.height, dataset.width, dataset.transform.to_gdal(), dataset.crs
        vrt = tmp_path / "dsm.vrt"
        vrt.write_text(
            f'<VRTDataset rasterXSize="{cols}" rasterYSize="{rows}"><SRS>{crs.to_string()}</SRS>'
            f"<GeoTransform>{','.join(map(str, place))}</GeoTransform>"
            '<VRTRasterBand dataType="Float32" band="1"><NoDataValue>-9999</NoDataValue><SimpleSource>'
            f'<SourceFilename relativeToVRT="0">{WILDFIRE / "dsm.tif"}</SourceFilename></SimpleSource>'
            "</VRTRasterBand></VRTDataset>"
        )
        for source, output in ((vrt, "a.tif"), (WILDFIRE / "dsm.tif", "b.tif")):
            assert run(WILDFIRE / "truth.tif", "-o", tmp_path / output, "--dsm", source).exit_code == 0
        found = cog_provenance(tmp_path / "a.tif")
        assert found is not None
        assert [each.role for each in found.inputs] == ["classes", "dsm", "dsm/0"]
        one, other = (read_scoremap(tmp_path / name).score for name in ("a.tif", "b.tif"))
        np.testing.assert_array_equal(one, other)
