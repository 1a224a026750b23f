from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from mapping_files import heights, model, odm, pix4d_mosaic, tag
from numpy.typing import NDArray
from raster_files import patches, write_raster

from hrt_cli.artifacts.provenance import record
from hrt_cli.raster.classes import publishing_classes
from hrt_cli.raster.gate import open_raster
from hrt_cli.raster.recognise import Kind, Maker, made_with, take_sample, what_it_is
from hrt_cli.raster.scoremap import Scoremap, publish_scoremap
from hrt_cli.raster.windows import Window

FLOATS = heights()


def kind(path: Path) -> Kind:
    with open_raster(path) as raster:
        return what_it_is(raster, take_sample(raster))


def maker(path: Path) -> Maker:
    with open_raster(path) as raster:
        return made_with(raster)


@pytest.mark.parametrize(
    ("text", "program"),
    [
        ("ODM 3.5.4", "OpenDroneMap 3.5.4"),
        ("ODM", "OpenDroneMap"),
        ("pix4dmapper", "Pix4Dmapper"),
        ("Pix4Dmapper 4.8.4", "Pix4Dmapper 4.8.4"),
        ("Agisoft Metashape Professional 2.1.0", "Agisoft Metashape Professional 2.1.0"),
        ("Agisoft PhotoScan", "Agisoft PhotoScan"),
        ("SimActive Inc.", "SimActive Inc."),
        ("ODMETER 1", "ODMETER 1"),
    ],
)
def test_the_software_tag_tells_who_made_it(tmp_path: Path, text: str, program: str) -> None:
    path = tag(write_raster(tmp_path / "odm_orthophoto.tif", patches()), TIFFTAG_SOFTWARE=text)
    assert maker(path) == Maker(program, "tag")


@pytest.mark.parametrize(
    ("name", "program"),
    [
        ("odm_orthophoto.tif", "OpenDroneMap"),
        ("odm_dem/dsm.tif", "OpenDroneMap"),
        ("site_transparent_mosaic_group1.tif", "Pix4Dmapper"),
        ("site_mosaic_group1.tif", "Pix4Dmapper"),
        ("3_dsm_ortho/1_dsm/site_dsm.tif", "Pix4Dmapper"),
        ("site_index_ndvi.tif", "Pix4Dmapper"),
        ("site_dsm.tif", None),
        ("mosaic.tif", None),
        ("ortho.tif", None),
    ],
)
def test_without_a_tag_the_name_may(tmp_path: Path, name: str, program: str | None) -> None:
    path = tmp_path / name
    path.parent.mkdir(parents=True, exist_ok=True)
    assert maker(write_raster(path, patches())) == Maker(program, "name" if program else None)


def describe(path: Path, description: str = "", unit: str = "") -> Path:
    with rasterio.open(path, "r+") as dataset:
        if description:
            dataset.set_band_description(1, description)
        if unit:
            dataset.set_band_unit(1, unit)
    return path


SPREAD = np.linspace(0, 1, FLOATS.size).reshape(FLOATS.shape)
ONE_BAND: list[tuple[str, NDArray[Any], dict[str, Any], str, str]] = [
    ("dsm.tif", FLOATS, {}, "surface model", "likely"),
    ("SiteDSM_5cm.tif", FLOATS, {"nodata": -9999}, "surface model", "likely"),
    ("field-dtm.tif", FLOATS, {}, "terrain model", "likely"),
    ("dem.tif", FLOATS.astype(np.int16), {}, "surface model", "likely"),
    ("site_thermal.tif", FLOATS, {}, "thermal orthomosaic", "likely"),
    ("lwir.tif", (SPREAD * 2000 + 29000).astype(np.uint16), {}, "thermal orthomosaic", "likely"),
    ("a.tif", (SPREAD * 2000 + 29000).astype(np.uint16), {}, "thermal orthomosaic", "unclear"),
    ("a.tif", (SPREAD * 60000).astype(np.uint16), {}, "orthomosaic", "unclear"),
    ("a_ndvi.tif", SPREAD.astype(np.float32), {}, "index map", "likely"),
    ("a.tif", (SPREAD * 2 - 1).astype(np.float32), {}, "index map", "unclear"),
    ("a.tif", FLOATS, {}, "measured values", "unclear"),
    ("a.tif", FLOATS, {"nodata": -9999}, "measured values", "unclear"),
    ("a.tif", patches()[0], {}, "orthomosaic", "unclear"),
    ("thermal.tif", patches()[0], {}, "orthomosaic", "unclear"),
    ("a.tif", patches()[0] % 7, {}, "class raster", "unclear"),
    ("a.tif", patches()[0] % 7, {"palette": {k: (k, k, k, 255) for k in range(7)}}, "class raster", "likely"),
    ("a.tif", np.full_like(FLOATS, np.nan), {}, "unknown", "unclear"),
]


@pytest.mark.parametrize(
    ("name", "values", "options", "expected", "certainty"),
    ONE_BAND,
    ids=[f"{name} {values.dtype} {expected}" for name, values, _, expected, _ in ONE_BAND],
)
def test_one_band_is_told_by_name_and_values_and_how_sure_that_is(
    tmp_path: Path, name: str, values: NDArray[Any], options: dict[str, Any], expected: str, certainty: str
) -> None:
    found = kind(write_raster(tmp_path / name, values, **options))
    assert (found.name, found.certainty) == (expected, certainty)
    assert found.because


@pytest.mark.parametrize(
    ("description", "unit", "expected"),
    [
        ("height above the datum in metres", "", "surface model"),
        ("temperature in degrees Celsius", "", "thermal orthomosaic"),
        ("", "metre", "surface model"),
        ("", "degC", "thermal orthomosaic"),
        ("NDVI", "", "index map"),
    ],
)
def test_what_the_file_says_of_its_band_comes_before_its_name(
    tmp_path: Path, description: str, unit: str, expected: str
) -> None:
    path = describe(write_raster(tmp_path / "dtm.tif", FLOATS), description, unit)
    assert kind(path).name == expected


def test_folders_of_the_programs_tell_too(tmp_path: Path) -> None:
    (tmp_path / "1_dsm").mkdir()
    assert kind(write_raster(tmp_path / "1_dsm" / "a.tif", FLOATS)).name == "surface model"


def test_nodata_and_what_is_transparent_has_no_part_in_the_values(tmp_path: Path) -> None:
    values = SPREAD.astype(np.float32)
    values[:60] = -10000
    assert kind(write_raster(tmp_path / "a.tif", values, nodata=-10000)).name == "index map"
    alpha = np.where(values < 0, 0, 255).astype(np.float32)
    colours = (rasterio.enums.ColorInterp.gray, rasterio.enums.ColorInterp.alpha)
    assert kind(write_raster(tmp_path / "b.tif", np.stack([values, alpha]), colours=colours)).name == "index map"


class TestPictures:
    def test_colours_that_are_declared_make_it_likely(self, tmp_path: Path) -> None:
        for path in (odm(tmp_path / "a.tif", "float32"), pix4d_mosaic(tmp_path / "b.tif", transparent=False)):
            assert (kind(path).name, kind(path).certainty) == ("orthomosaic", "likely")

    def test_bands_of_unknown_colour_and_pictures_of_heights_are_unclear(self, tmp_path: Path) -> None:
        bands = np.repeat(patches()[:1], 5, axis=0).astype(np.uint16)
        multi = kind(write_raster(tmp_path / "a.tif", bands, photometric="MINISBLACK"))
        shaded = kind(write_raster(tmp_path / "dsm_relief.tif", patches()))
        assert (multi.name, multi.certainty) == (shaded.name, shaded.certainty) == ("orthomosaic", "unclear")
        assert "picture of a surface model" in shaded.because


class TestOurs:
    def test_classes_and_scoremaps_are_known_by_their_tags(self, tmp_path: Path) -> None:
        with open_raster(write_raster(tmp_path / "a.tif", patches())) as raster:
            grid = raster.grid
        whole = Window(0, 0, *grid.shape)
        made = record("segment", 1, {}, {})
        with publishing_classes(tmp_path / "dsm.tif", grid, ["a", "b"], made, tags={}, creation={}) as writer:
            writer.write(whole, patches()[0] % 2)
        score = np.full(grid.shape, 0.5, np.float32)
        scores = Scoremap(score, score, grid, 0.1)
        publish_scoremap(tmp_path / "thermal.tif", scores, record("scoremap", 1, {}, {}), tags={}, creation={})
        assert kind(tmp_path / "dsm.tif") == Kind("class raster", "declared", "so its tags of hrt say")
        assert kind(tmp_path / "thermal.tif") == Kind("scoremap", "declared", "so its tags of hrt say")
        assert maker(tmp_path / "dsm.tif") == Maker("hrt segment", "tag")

    def test_damaged_tags_are_no_tags(self, tmp_path: Path) -> None:
        path = write_raster(tmp_path / "a.tif", patches())
        with rasterio.open(path, "r+") as dataset:
            dataset.update_tags(ns="HRT", PROVENANCE="{")
        assert kind(path).name == "orthomosaic"
        assert maker(path) == Maker(None, None)

    def test_bands_called_score_and_sd_are_a_scoremap_of_someone(self, tmp_path: Path) -> None:
        path = write_raster(tmp_path / "a.tif", np.stack([SPREAD, SPREAD]).astype(np.float32))
        assert kind(path).name == "unknown"
        with rasterio.open(path, "r+") as dataset:
            dataset.descriptions = ("score", "sd")
        assert (kind(path).name, kind(path).certainty) == ("scoremap", "likely")


def test_a_look_at_a_large_raster_is_bounded(tmp_path: Path) -> None:
    path = write_raster(tmp_path / "a.tif", np.zeros((1, 3000, 5000), np.uint8), compress="deflate")
    with open_raster(path) as raster:
        assert take_sample(raster).of(1).size <= 36 * 128**2


def test_a_model_without_a_telling_name_is_not_called_one(tmp_path: Path) -> None:
    found = kind(model(tmp_path / "a.tif"))
    assert re.fullmatch(r"values from 29\d\.\d+ to 30\d\.\d+, nodata -9999: heights or temperatures", found.because)
