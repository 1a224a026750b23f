"""What the commands do with bad rasters and bad arguments: one line, the right exit code, nothing changed."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from affine import Affine
from raster_files import BAD_FILES, ORIGIN, RGB, RGBA, cut, patches, write_raster, write_vrt
from rasterio.enums import ColorInterp
from refusals import OLD, check_refused, contents, here, process, refused

METRE = Affine(1, 0, ORIGIN[0], 0, -1, ORIGIN[1])
pytestmark = pytest.mark.filterwarnings(
    "ignore:Use `@` matmul:PendingDeprecationWarning",
    "ignore::rasterio.errors.NotGeoreferencedWarning",
)


# -- segment ----------------------------------------------------------------------------------------------------------


def black(path: Path) -> None:
    write_raster(path, np.zeros((3, 96, 96), np.uint8), nodata=0)


def stale_mask(path: Path) -> None:
    write_raster(path, patches(), mask=np.zeros((96, 96), bool), internal_mask=False)


def two_colours(path: Path) -> None:
    pixels = np.full((3, 96, 96), 60, np.uint8)
    pixels[:, :, 48:] = 180
    write_raster(path, pixels)


BAD_ORTHOS: dict[str, tuple[Callable[[Path], object], str]] = {
    "all nodata": (black, "no valid pixel"),
    "all masked by a stale side-car": (stale_mask, "ortho é.tif.msk masks all of it"),
    "one colour": (lambda path: write_raster(path, np.full((3, 96, 96), 90, np.uint8)), "one value"),
    "one 16-bit value": (lambda path: write_raster(path, np.full((3, 96, 96), 900, np.uint16)), "one value"),
    "no number": (lambda path: write_raster(path, np.full((3, 96, 96), np.nan, np.float32)), "no valid pixel"),
    "alpha alone": (lambda path: write_raster(path, patches()[0], colours=(ColorInterp.alpha,)), "no colour"),
    "a network vrt": (lambda path: write_vrt(path, "/vsicurl/http://localhost:1/a.tif"), "network"),
    "a vrt of nothing": (lambda path: write_vrt(path, "absent.tif"), "no file on this machine"),
}
ALL_ORTHOS = {name: (make, "") for name, make in BAD_FILES.items()} | BAD_ORTHOS


@pytest.fixture
def ortho(tmp_path: Path) -> Path:
    return tmp_path / "ortho é.tif"


@pytest.mark.parametrize("name", ALL_ORTHOS)
def test_segment_refuses_a_bad_orthomosaic(ortho: Path, name: str, capfd: pytest.CaptureFixture[str]) -> None:
    make, problem = ALL_ORTHOS[name]
    make(ortho)
    args = ["segment", str(ortho), "-K", "4"]
    refused(lambda a: here(a, capfd), args, ortho.with_name("out.tif"), 1, "ortho é.tif", problem)


@pytest.mark.parametrize("name", ["cut in the pixels", "bomb", "one huge block", "all nodata", "one colour"])
def test_the_program_refuses_a_bad_orthomosaic(ortho: Path, name: str) -> None:
    ALL_ORTHOS[name][0](ortho)
    output = ortho.with_name("out.tif")
    output.write_bytes(OLD)
    before = contents(ortho.parent)
    outcome = process(["segment", str(ortho), "-K", "4", "-o", str(output), "--overwrite"])
    check_refused(outcome, 1, "ortho é.tif")
    assert contents(ortho.parent) == before


def test_segment_refuses_more_classes_than_there_are_colours(ortho: Path, capfd: pytest.CaptureFixture[str]) -> None:
    two_colours(ortho)
    args = ["segment", str(ortho), "-K", "5"]
    refused(
        lambda a: here(a, capfd), args, ortho.with_name("out.tif"), 1, "ortho é.tif", "fewer than 5 different colours"
    )


@pytest.mark.parametrize("classes", ["0", "1", "-3", "256", "1000000000", "nan", "2.5"])
def test_segment_refuses_a_number_of_classes_that_is_none(
    ortho: Path, classes: str, capfd: pytest.CaptureFixture[str]
) -> None:
    write_raster(ortho, patches())
    args = ["segment", str(ortho), "-K", classes]
    refused(lambda a: here(a, capfd), args, ortho.with_name("out.tif"), 2, "--classes")


@pytest.mark.parametrize(
    ("options", "code", "problem"),
    [
        (["--bands", "1,2,9"], 1, "bands 1 to 3"),
        (["--bands", "1,2"], 1, "bands 1 to 3"),
        (["--bands", "red"], 2, "'red'"),
        (["--nodata", "nan"], 2, "finite"),
        (["--co", "BLOCKSIZE=-5"], 1, "--co BLOCKSIZE"),
        (["--co", "COMPRESS=JPEG"], 1, "--co COMPRESS"),
        (["--co", "COMPRESS"], 2, "NAME=VALUE"),
    ],
)
def test_segment_refuses_an_option_that_does_not_fit(
    ortho: Path, options: list[str], code: int, problem: str, capfd: pytest.CaptureFixture[str]
) -> None:
    write_raster(ortho, patches())
    args = ["segment", str(ortho), "-K", "4", *options]
    refused(lambda a: here(a, capfd), args, ortho.with_name("out.tif"), code, "", problem)


def twelve_bits(path: Path) -> None:
    write_raster(path, patches().astype(np.uint16) * 16)


def unit_reals(path: Path) -> None:
    write_raster(path, (patches() / np.float32(255)).astype(np.float32))


def not_numbers(path: Path) -> None:
    pixels = patches().astype(np.float32)
    pixels[:, :, :20] = np.nan
    pixels[1, :, 20:24] = np.inf
    write_raster(path, pixels)


def transparent_quarter(path: Path) -> None:
    alpha = np.full((1, 96, 96), 255, np.uint8)
    alpha[..., :24] = 0
    write_raster(path, np.concatenate([patches(), alpha]), colours=RGBA)


def masked_half(path: Path) -> None:
    mask = np.zeros((96, 96), bool)
    mask[:, 48:] = True
    write_raster(path, patches(), mask=mask)


def undefined_band(path: Path) -> None:
    pixels = np.concatenate([patches(), patches()[:1] // 2])
    write_raster(path, pixels, colours=(*RGB, ColorInterp.undefined))


def no_red(path: Path) -> None:
    pixels = patches()
    pixels[0, :30] = 0
    write_raster(path, pixels, nodata=0)


def feet(path: Path) -> None:
    write_raster(path, patches(), crs="EPSG:2225", transform=Affine(0.33, 0, 6.2e6, 0, -0.33, 2e6))


def turned(path: Path) -> None:
    place = Affine(0.0866, 0.05, ORIGIN[0], 0.05, -0.0866, ORIGIN[1])
    write_raster(path, patches(), transform=place)


GOOD_ORTHOS: dict[str, tuple[Callable[[Path], object], float]] = {
    "12 bits in 16": (twelve_bits, 1.0),
    "reals from 0 to 1": (unit_reals, 1.0),
    "nan and inf without a tag": (not_numbers, 0.75),
    "alpha": (transparent_quarter, 0.75),
    "internal mask": (masked_half, 0.5),
    "an undefined fourth band": (undefined_band, 1.0),
    "dark in one band": (no_red, 1.0),
    "us survey feet": (feet, 1.0),
    "turned by 30 degrees": (turned, 1.0),
}


@pytest.mark.parametrize("name", GOOD_ORTHOS)
def test_segment_takes_an_odd_orthomosaic_for_what_it_is(
    ortho: Path, name: str, capfd: pytest.CaptureFixture[str]
) -> None:
    make, valid = GOOD_ORTHOS[name]
    make(ortho)
    outcome = here(["segment", str(ortho), "-K", "4", "-o", str(ortho.with_name("out.tif")), "--json"], capfd)
    assert outcome.code == 0, outcome.stderr
    result = json.loads(outcome.stdout)
    assert result["valid_pixels"] / result["pixels"] == pytest.approx(valid)
    # Four quarters of texture are four classes, not one of black and three of nothing.
    assert sorted(result["class_fractions"])[1] > 0.03


# -- scoremap ---------------------------------------------------------------------------------------------------------


def class_ids(dtype: str = "uint8") -> np.ndarray:
    return np.kron([[0, 1], [2, 0]], np.ones((10, 10))).astype(dtype)


def with_value(dtype: str, value: int) -> np.ndarray:
    values = class_ids(dtype)
    values[3, 3] = value
    return values


BAD_CLASSES: dict[str, tuple[Callable[[Path], object], str]] = {
    "absent": (lambda path: None, "no such file"),
    "negative ids": (lambda path: write_raster(path, with_value("int16", -1)), "the value -1"),
    "an id of 300": (lambda path: write_raster(path, with_value("int16", 300)), "the value 300"),
    "real numbers": (lambda path: write_raster(path, class_ids("float32")), "whole numbers"),
    "two bands": (lambda path: write_raster(path, np.stack([class_ids()] * 2)), "2 bands"),
    "no crs": (lambda path: write_raster(path, class_ids(), crs=None), "no coordinate reference system"),
    "all nodata": (lambda path: write_raster(path, np.full((20, 20), 255, np.uint8)), "all is nodata"),
    "pixels of metres": (
        lambda path: write_raster(path, class_ids(), transform=METRE * Affine.scale(3)),
        "smaller than a pixel",
    ),
    "cut": (lambda path: cut(write_raster(path, patches(500, 500)[0], compress="deflate"), 0.6), "damaged"),
    "class 200 is not in the table": (
        lambda path: write_raster(path, with_value("uint8", 200)),
        "nothing of class 200",
    ),
}

BAD_SCORES = {
    "nan": ('{"scores": {"0": NaN, "1": 0.5, "2": 0.5}}', "NaN"),
    "twice": ('{"scores": {"0": 0.1, "1": 0.5, "2": 0.5, "0": 0.9}}', "stands twice"),
    "above one": ('{"scores": {"0": 1.0001, "1": 0.5, "2": 0.5}}', "scores.0"),
    "a class short": ('{"scores": {"0": 0.1, "1": 0.5}}', "nothing of class 2"),
}


@pytest.fixture
def scores(tmp_path: Path) -> Path:
    path = tmp_path / "scores.json"
    path.write_text('{"scores": {"0": 0.9, "1": 0.5, "2": 0.1}}')
    return path


@pytest.mark.parametrize("name", BAD_CLASSES)
def test_scoremap_refuses_bad_classes(
    tmp_path: Path, scores: Path, name: str, capfd: pytest.CaptureFixture[str]
) -> None:
    make, problem = BAD_CLASSES[name]
    classes = tmp_path / "classes.tif"
    make(classes)
    named = "scores.json" if "table" in name else "" if "metres" in name else "classes.tif"
    args = ["scoremap", str(classes), "--scores", str(scores)]
    refused(lambda a: here(a, capfd), args, tmp_path / "out.tif", 1, named, problem)


@pytest.mark.parametrize("name", BAD_SCORES)
def test_scoremap_refuses_a_bad_table(
    tmp_path: Path, scores: Path, name: str, capfd: pytest.CaptureFixture[str]
) -> None:
    text, problem = BAD_SCORES[name]
    scores.write_text(text)
    classes = write_raster(tmp_path / "classes.tif", class_ids())
    args = ["scoremap", str(classes), "--scores", str(scores)]
    refused(lambda a: here(a, capfd), args, tmp_path / "out.tif", 1, "scores.json", problem)


def test_a_class_without_a_score_counts_as_unknown_when_asked(
    tmp_path: Path, scores: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    scores.write_text('{"scores": {"0": 0.1, "1": 0.5}}')
    classes = write_raster(tmp_path / "classes.tif", class_ids())
    out = tmp_path / "out.tif"
    args = ["scoremap", str(classes), "-o", str(out), "--scores", str(scores), "--unknown-as-prior", "--json"]
    done = here(args, capfd)
    assert done.code == 0
    assert json.loads(done.stdout)["unknown"] == [2]
    assert "says nothing of class 2" in done.stderr
    scores.write_text('{"scores": {"7": 0.1}}')
    args = ["scoremap", str(classes), "--scores", str(scores), "--unknown-as-prior"]
    refused(lambda a: here(a, capfd), args, tmp_path / "other.tif", 1, "scores.json", "nothing of class 0")


@pytest.mark.parametrize("cell", ["0", "-1", "nan", "inf", "x"])
def test_scoremap_refuses_a_cell_that_is_none(tmp_path: Path, cell: str, capfd: pytest.CaptureFixture[str]) -> None:
    classes = write_raster(tmp_path / "classes.tif", class_ids())
    args = ["scoremap", str(classes), "--cell", cell]
    refused(lambda a: here(a, capfd), args, tmp_path / "out.tif", 2, "--cell")


@pytest.mark.parametrize("name", ["negative ids", "cut", "class 200 is not in the table"])
def test_the_program_refuses_bad_classes(tmp_path: Path, scores: Path, name: str) -> None:
    BAD_CLASSES[name][0](tmp_path / "classes.tif")
    before = contents(tmp_path)
    args = ["scoremap", str(tmp_path / "classes.tif"), "--scores", str(scores), "-o", str(tmp_path / "out.tif")]
    check_refused(process(args), 1, ".json" if "table" in name else "classes.tif")
    assert contents(tmp_path) == before


# -- plan -------------------------------------------------------------------------------------------------------------


def score_map(path: Path, value: float = 0.5, dtype: str = "float32", **options: object) -> Path:
    """Write 20 x 20 cells with a wall of no-go in column 9 and a pocket closed on all sides at 3,15."""
    score = np.random.default_rng(0).random((20, 20)).astype(dtype)
    if dtype.startswith("f"):
        score[:, 9] = np.nan
        score[2:5, 14:17] = np.nan
        score[3, 15] = 0.5
        score[7, 3] = value
    return write_raster(path, score, **{"transform": METRE, **options})


BAD_SCOREMAPS: dict[str, tuple[Callable[[Path], object], str]] = {
    "absent": (lambda path: None, "no such file"),
    "a folder": (lambda path: path.mkdir(), ""),
    "empty": (lambda path: path.touch(), "is not a raster"),
    "infinite": (lambda path: score_map(path, math.inf), "infinite score"),
    "negative": (lambda path: score_map(path, -0.5), "negative score"),
    "undeclared nodata": (lambda path: score_map(path, -9999), "negative score"),
    "whole numbers": (lambda path: score_map(path, dtype="uint8"), "not a scoremap"),
    "oblong cells": (lambda path: score_map(path, transform=METRE * Affine.scale(1, 2)), "square"),
    "no crs": (lambda path: score_map(path, crs=None), "no coordinate reference system"),
    "all no-go": (lambda path: write_raster(path, np.full((9, 9), np.nan, np.float32), transform=METRE), "no cell"),
    "cut": (lambda path: cut(score_map(path, compress="deflate"), 0.6), ""),
}

BAD_REQUESTS: dict[str, tuple[list[str], int, str]] = {
    "start on no-go": (["--start", "cell:5,9"], 1, "5,9"),
    "start one cell outside": (["--start", "cell:20,0"], 1, "outside the map"),
    "start at -1": (["--start", "cell:-1,-1"], 1, "outside the map"),
    "start in a pocket": (["--start", "cell:3,15"], 1, ""),
    "start outside by a millimetre": (["--start", f"xy:{ORIGIN[0] - 0.001},{ORIGIN[1] - 1}"], 1, "outside the map"),
    "start in another country": (["--start", "lonlat:105,45"], 1, "outside the map"),
    "longitude and latitude exchanged": (["--start", "lonlat:45.1534,15.0001"], 1, "exchanged"),
    "no latitude": (["--start", "lonlat:15,95"], 1, "latitude"),
    "start nowhere": (["--start", "cell:nan,1"], 1, "--start"),
    "start by name": (["--start", "home"], 1, "--start"),
    "half a cell": (["--start", "cell:1.5,2"], 1, "whole numbers"),
    **{f"budget {b}": (["--budget", b], 1, "--budget") for b in ("0", "-1", "nan", "inf", "1e308", "2.5", "x", "5km")},
    "budget below a cell": (["--budget", "0.5m"], 1, "next cell"),
    "no speed": (["--speed", "0"], 2, "--speed"),
    "gamma above one": (["--gamma", "1.1"], 2, "--gamma"),
}


def some_start(options: list[str]) -> list[str]:
    """A good start, unless the options give another: every one given is for a robot of its own."""
    return [] if "--start" in options else ["--start", "cell:1,1"]


@pytest.mark.parametrize("name", BAD_SCOREMAPS)
def test_plan_refuses_a_bad_scoremap(tmp_path: Path, name: str, capfd: pytest.CaptureFixture[str]) -> None:
    make, problem = BAD_SCOREMAPS[name]
    path = tmp_path / "map.tif"
    make(path)
    args = ["plan", str(path), "--start", "cell:1,1", "--budget", "9"]
    refused(lambda a: here(a, capfd), args, tmp_path / "out.json", 1, "map.tif", problem)


@pytest.mark.parametrize("name", BAD_REQUESTS)
def test_plan_refuses_a_bad_request(tmp_path: Path, name: str, capfd: pytest.CaptureFixture[str]) -> None:
    options, code, problem = BAD_REQUESTS[name]
    path = score_map(tmp_path / "map.tif")
    args = ["plan", str(path), "--budget", "9", *some_start(options), *options]
    refused(lambda a: here(a, capfd), args, tmp_path / "out.json", code, "", problem)


@pytest.mark.parametrize("name", ["start on no-go", "budget nan"])
def test_the_program_refuses_a_bad_request(tmp_path: Path, name: str) -> None:
    options, code, problem = BAD_REQUESTS[name]
    path = score_map(tmp_path / "map.tif")
    before = contents(tmp_path)
    args = ["plan", str(path), "--budget", "9", *some_start(options), *options, "-o", str(tmp_path / "out.json")]
    check_refused(process(args), code, "", problem)
    assert contents(tmp_path) == before


def test_a_plan_never_enters_what_is_no_number(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = score_map(tmp_path / "map.tif")  # NaN without a nodata tag
    args = ["plan", str(path), "-o", str(tmp_path / "out.json"), "--start", "cell:1,1", "--budget", "60"]
    assert here([*args, "--method", "greedy"], capfd).code == 0
    cells = json.loads((tmp_path / "out.json").read_text())["cells"]
    assert len(cells) == 61
    assert all(col < 9 for _, col in cells)
