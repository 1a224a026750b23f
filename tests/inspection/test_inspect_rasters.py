"""`hrt inspect` of files and folders: what is found, that it is said as JSON, and that what it says to run does run."""

from __future__ import annotations

import json
import shlex
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from affine import Affine
from click.testing import CliRunner
from mapping_files import heights, metashape_tiles, model, odm, odm_project, pix4d_project, tag
from raster_files import PLACE, patches, write_raster
from rasterio.warp import transform_bounds

from hrt_cli import main as shell
from hrt_cli.errors import HrtError, InputError
from hrt_cli.inspection.project import inspect_folder
from hrt_cli.inspection.rasters import inspect_raster

WILDFIRE = Path(__file__).parents[2] / "fixtures" / "wildfire"
SHARED = Path(__file__).parents[3] / "shared" / "data"

KEYS_OF_BEFORE = {
    *("file", "bytes", "driver", "rows", "cols", "bands", "dtypes", "band_colours", "nodata", "compression", "block"),
    *("overviews", "mask", "software", "made_by", "crs", "pixel_m", "extent_m", "scale_variation"),
    *("placeholder_georeference", "colour_bands", "alpha_band", "valid_share", "megapixels", "segment_seconds"),
    *("segment_memory_mb", "notes", "usable", "refusal"),
}


def inspect(*args: object) -> dict[str, Any]:
    """Run `hrt inspect --json`, and the same for people."""
    done = CliRunner().invoke(shell.cli, ["inspect", "--json", *map(str, args)])
    assert done.exit_code == 0, done.output
    assert CliRunner().invoke(shell.cli, ["inspect", *map(str, args)]).exit_code == 0
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def kinds(project: dict[str, Any]) -> dict[str, str]:
    return {one["path"]: one["kind"] for one in project["found"]}


class TestOneRaster:
    def test_everything_is_said_as_json(self, tmp_path: Path) -> None:
        path = tag(odm(tmp_path / "a b.tif"), TIFFTAG_SOFTWARE="ODM 3.5.4")
        found = inspect(path)
        assert set(found) >= KEYS_OF_BEFORE
        assert found["made_with"] == "OpenDroneMap 3.5.4"
        assert (found["made_with_by"], found["software"], found["made_by"]) == ("tag", "ODM 3.5.4", None)
        assert (found["kind"], found["kind_certainty"]) == ("orthomosaic", "likely")
        assert found["used_by"] == [f"hrt segment '{path}' -o classes.tif --classes 5"]
        assert (found["usable"], found["refusal"], found["values"]) == (True, None, None)
        with rasterio.open(path) as raster:
            bounds = transform_bounds(raster.crs, "EPSG:4326", *raster.bounds)
        assert found["bounds_lonlat"] == pytest.approx(bounds, abs=2e-7)

    def test_heights_are_described_and_segment_would_refuse_them(self, tmp_path: Path) -> None:
        path = model(tmp_path / "dsm.tif")
        found = inspect(path)
        assert found["kind"] == "surface model"
        assert [use.split(" ")[1] for use in found["used_by"]] == ["scoremap", "feedback", "drive"]
        assert (found["usable"], found["crs"]) == (False, "EPSG:32633")
        assert "-b 1 takes it as a grey picture" in found["refusal"]
        assert "stretched" not in "".join(found["notes"])
        low, middle, high = np.quantile(heights()[20:], (0.01, 0.5, 0.99))
        assert found["values"] == pytest.approx([low, middle, high])
        assert inspect(path, "-b", "1")["usable"]

    def test_what_has_no_place_is_described_all_the_same(self, tmp_path: Path) -> None:
        found = inspect(write_raster(tmp_path / "a.tif", patches(), crs=None))
        assert "no coordinate reference system" in found["refusal"]
        assert (found["kind"], "crs" in found) == ("orthomosaic", False)

    def test_one_without_any_valid_pixel_keeps_its_place(self, tmp_path: Path) -> None:
        found = inspect(write_raster(tmp_path / "a.tif", np.zeros((3, 96, 96), np.uint8), nodata=0))
        assert "no valid pixel" in found["refusal"]
        assert found["crs"] == "EPSG:32633"

    def test_people_are_told_the_same_in_words(self, tmp_path: Path) -> None:
        done = CliRunner().invoke(shell.cli, ["inspect", str(model(tmp_path / "dsm.tif"))])
        assert "is         surface model (likely): its name says so" in done.stdout
        assert "values     29" in done.stdout
        assert "for        hrt feedback --dsm" in done.stdout

    @pytest.mark.parametrize("damage", ["text", "absent", "cut"])
    def test_what_is_no_raster_is_refused(self, tmp_path: Path, damage: str) -> None:
        path = tmp_path / "a.tif"
        if damage == "text":
            path.write_text("no raster")
        elif damage == "cut":
            write_raster(path, patches(500, 500), compress="deflate")
            path.write_bytes(path.read_bytes()[:4000])
        with pytest.raises(InputError, match=r"a\.tif"):
            inspect_raster(path)


class TestSeveralFiles:
    def test_tiles_are_looked_at_as_one(self, tmp_path: Path) -> None:
        tiles = sorted(metashape_tiles(tmp_path / "ortho").iterdir())
        found = inspect(*tiles)
        assert (found["tiles"], found["rows"], found["cols"]) == (4, 192, 192)
        assert found["bytes"] == sum(tile.stat().st_size for tile in tiles)
        assert found["made_with"] == "Agisoft Metashape Professional 2.1.0"
        assert found["used_by"] == ["hrt segment " + shlex.join(map(str, tiles)) + " -o classes.tif --classes 5"]

    def test_what_does_not_go_together_would_be_refused(self, tmp_path: Path) -> None:
        found = inspect(odm(tmp_path / "a.tif"), model(tmp_path / "dsm.tif"))
        assert "does not go with" in found["refusal"]


@pytest.mark.parametrize("option", ["--bands=1,2,3", "--unreferenced"])
def test_options_for_one_raster_are_not_passed_over_in_silence(tmp_path: Path, option: str) -> None:
    tiles = metashape_tiles(tmp_path)
    assert CliRunner().invoke(shell.cli, ["inspect", option, str(tiles)]).exit_code == 2
    if option == "--unreferenced":
        assert CliRunner().invoke(shell.cli, ["inspect", option, *map(str, sorted(tiles.iterdir()))]).exit_code == 2


class TestFolders:
    def test_a_project_of_opendronemap(self, tmp_path: Path) -> None:
        folder = odm_project(tmp_path / "my project")
        found = inspect(folder)
        assert found["project"] == "OpenDroneMap"
        assert kinds(found) == {
            "odm_orthophoto/odm_orthophoto.tif": "orthomosaic",
            "odm_dem/dsm.tif": "surface model",
            "odm_dem/dtm.tif": "terrain model",
        }
        assert [one["made_with"] for one in found["found"]] == ["OpenDroneMap 3.5.4", "OpenDroneMap", "OpenDroneMap"]
        assert [one["made_with_by"] for one in found["found"]] == ["tag", "name", "name"]
        assert found["notes"] == []
        ortho = shlex.quote(str(folder / "odm_orthophoto" / "odm_orthophoto.tif"))
        dsm = shlex.quote(str(folder / "odm_dem" / "dsm.tif"))
        assert found["commands"] == [
            f"hrt segment {ortho} -o classes.tif --classes 5",
            f"hrt scoremap classes.tif -o scoremap.tif --dsm {dsm}",
            "hrt plan scoremap.tif -o plan.json --start auto --budget 400m",
            "hrt export plan.json -o mission.plan",
        ]

    def test_one_without_gps_exports_no_mission(self, tmp_path: Path) -> None:
        (tmp_path / "odm_orthophoto").mkdir()
        nowhere = Affine(0.1, 0, 0, 0, -0.1, 0)
        write_raster(tmp_path / "odm_orthophoto" / "odm_orthophoto.tif", patches(), crs="EPSG:32630", transform=nowhere)
        assert [command.split()[1] for command in inspect(tmp_path)["commands"]] == ["segment", "scoremap", "plan"]

    @pytest.mark.parametrize("inside", ["", "3_dsm_ortho"])
    def test_a_project_of_pix4d_prefers_the_transparent_mosaic(self, tmp_path: Path, inside: str) -> None:
        found = inspect(pix4d_project(tmp_path) / inside)
        assert found["project"] == "Pix4Dmapper"
        base = "" if inside else "3_dsm_ortho/"
        expected = {
            f"{base}2_mosaic/site_transparent_mosaic_group1.tif": "orthomosaic",
            f"{base}1_dsm/site_dsm.tif": "surface model",
            f"{base}2_mosaic/site_mosaic_group1.tif": "orthomosaic",
            **({} if inside else {"4_index/indices/ndvi/site_index_ndvi.tif": "index map"}),
        }
        assert list(kinds(found).items()) == list(expected.items())
        assert "site_transparent_mosaic_group1.tif" in found["commands"][0]
        assert "--dsm" in found["commands"][1]

    def test_pix4ds_tiles_stand_in_for_the_mosaic(self, tmp_path: Path) -> None:
        metashape_tiles(tmp_path / "3_dsm_ortho" / "2_mosaic" / "tiles")
        found = inspect(tmp_path)
        assert found["project"] == "Pix4Dmapper"
        assert [(one["path"], one["tiles"]) for one in found["found"]] == [("3_dsm_ortho/2_mosaic/tiles", 4)]

    def test_a_folder_of_tiles_is_one_orthomosaic(self, tmp_path: Path) -> None:
        found = inspect(metashape_tiles(tmp_path / "blocks", 3))
        (one,) = found["found"]
        assert (one["path"], one["tiles"], one["rows"], one["kind"]) == (".", 9, 192, "orthomosaic")
        assert found["commands"][0] == f"hrt segment {tmp_path / 'blocks'} -o classes.tif --classes 5"

    def test_orthomosaics_that_are_no_tiles_say_why(self, tmp_path: Path) -> None:
        odm(tmp_path / "a.tif")
        odm(tmp_path / "b.tif")
        write_raster(tmp_path / "c.tif", patches(), transform=PLACE @ Affine.translation(0.5, 0))
        found = inspect(tmp_path)
        assert len(found["found"]) == 3
        assert "they are no tiles of one orthomosaic" in found["notes"][0]

    def test_a_site_of_ours_is_listed(self) -> None:
        found = inspect(WILDFIRE)
        assert kinds(found) == {
            "dsm.tif": "surface model",
            "ortho.tif": "orthomosaic",
            "thermal.tif": "thermal orthomosaic",
            "truth.tif": "class raster",
        }
        assert "--dsm" in found["commands"][1]
        assert "--interest" in found["commands"][1]

    def test_a_damaged_raster_is_named_among_the_others(self, tmp_path: Path) -> None:
        folder = odm_project(tmp_path)
        (folder / "odm_dem" / "dsm.tif").write_bytes(b"nothing")
        found = inspect(folder)
        assert "dsm.tif: is not a raster" in found["found"][1]["refusal"]
        assert len(found["commands"]) == 4

    @pytest.mark.parametrize("content", [{}, {"readme.txt": b"", "sub": None}])
    def test_a_folder_without_rasters_is_refused(self, tmp_path: Path, content: dict[str, bytes | None]) -> None:
        for name, data in content.items():
            (tmp_path / name).mkdir() if data is None else (tmp_path / name).write_bytes(data)
        with pytest.raises(HrtError, match="without rasters"):
            inspect_folder(tmp_path)


class TestAlignment:
    def test_a_model_that_lies_elsewhere_is_told_of_and_not_used(self, tmp_path: Path) -> None:
        folder = odm_project(tmp_path)
        model(folder / "odm_dem" / "dsm.tif", transform=PLACE @ Affine.translation(5000, 0))
        found = inspect(folder)
        assert (
            "odm_dem/dsm.tif (the surface model) lies wholly beside odm_orthophoto/odm_orthophoto.tif"
            in found["notes"][0]
        )
        assert "--dsm" not in found["commands"][1]

    def test_one_that_covers_half_says_so(self, tmp_path: Path) -> None:
        folder = odm_project(tmp_path)
        model(folder / "odm_dem" / "dsm.tif", transform=PLACE @ Affine.translation(96, 0))
        (note,) = inspect(folder)["notes"]
        assert "covers 48% of" in note or "covers 50% of" in note or "covers 52% of" in note

    def test_another_crs_and_coarser_pixels_are_told_of(self, tmp_path: Path) -> None:
        folder = odm_project(tmp_path)
        with rasterio.open(folder / "odm_dem" / "dsm.tif") as dataset:
            x, y = rasterio.warp.transform("EPSG:32633", "EPSG:32632", [dataset.transform.c], [dataset.transform.f])
        place = Affine(0.4, 0, x[0] - 30, 0, -0.4, y[0] + 30)
        model(folder / "odm_dem" / "dsm.tif", crs="EPSG:32632", transform=place)
        told = "\n".join(inspect(folder)["notes"])
        assert (
            "is in another CRS (EPSG:32632) than odm_orthophoto/odm_orthophoto.tif (EPSG:32633); hrt reprojects" in told
        )
        assert "are 0.399 m, those of odm_orthophoto/odm_orthophoto.tif 0.1 m" in told


def test_every_command_that_is_printed_has_the_options_it_is_printed_with() -> None:
    for command in inspect(WILDFIRE)["commands"]:
        program, name, *args = shlex.split(command)
        assert program == "hrt"
        shown = CliRunner().invoke(shell.cli, [name, "--help"]).stdout
        wanted = {arg for arg in args if arg.startswith("-")}
        assert all(option in shown for option in wanted)


@pytest.mark.slow
def test_the_commands_for_a_project_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    odm_project(tmp_path / "project")
    shutil.rmtree(tmp_path / "project" / "odm_dem")
    monkeypatch.chdir(tmp_path)
    for command in inspect("project")["commands"]:
        _, *args = shlex.split(command)
        done = CliRunner().invoke(shell.cli, args)
        assert done.exit_code == 0, f"{command}: {done.output}"
    assert (tmp_path / "mission.plan").is_file()


@pytest.mark.real
@pytest.mark.skipif(not SHARED.is_dir(), reason="../shared/data is absent")
class TestReal:
    @pytest.mark.parametrize(
        ("name", "kind", "maker"),
        [
            ("pix4d_fields/pix4d_alpha_nodata.tif", "orthomosaic", "Pix4Dmapper"),
            ("australia/ortho_18mm_nodata0.tif", "orthomosaic", "SimActive Inc."),
            ("brighton_beach/ortho_3cm.tif", "orthomosaic", None),
            ("brighton_beach/dsm_5cm.tif", "surface model", None),
            ("caliterra/dsm_25cm.tif", "surface model", None),
            ("savanna/ortho_10cm.tif", "orthomosaic", None),
            ("sjer/SJER_002.tif", "orthomosaic", None),
        ],
    )
    def test_real_rasters_are_known_for_what_they_are(self, name: str, kind: str, maker: str | None) -> None:
        found = inspect(SHARED / name)
        assert (found["kind"], found["made_with"]) == (kind, maker)
        assert found["usable"] == (kind == "orthomosaic")

    def test_a_survey_and_its_heights_go_together(self) -> None:
        found = inspect(SHARED / "brighton_beach")
        assert kinds(found) == {"dsm_5cm.tif": "surface model", "ortho_3cm.tif": "orthomosaic"}
        assert len(found["commands"]) == 4
        assert not any("beside" in note for note in found["notes"])
