"""Class rasters and scoremaps: every planted change is named, and what is stored otherwise is the same."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from affine import Affine
from compare_files import (
    NAMES,
    PLACE,
    UTM33,
    compare,
    differing,
    figures,
    ids,
    put_classes,
    put_scoremap,
    recoded,
    scores_map,
)
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from raster_files import write_raster
from rasterio.crs import CRS
from sklearn.metrics import adjusted_rand_score

from hrt_cli.errors import InputError
from hrt_cli.evaluation.compare.classes import compare_classes
from hrt_cli.progress import silent
from hrt_cli.raster.grid import Grid, lattice_offset

PIXELS = {"changed", "iou", "ari"}


@pytest.fixture
def classes(tmp_path: Path) -> Path:
    return put_classes(tmp_path / "a.tif")


@pytest.fixture
def scoremap(tmp_path: Path) -> Path:
    return put_scoremap(tmp_path / "s.tif")


def test_one_pixel_of_another_class_is_found(classes: Path, tmp_path: Path) -> None:
    values = ids()
    values[20, 7] = 1
    other = put_classes(tmp_path / "b.tif", values)
    assert differing(classes, other) == PIXELS
    found = figures(classes, other)
    pixels = 40 * 50 - 12
    assert found["changed"]["difference"] == pytest.approx(1 / pixels)
    valid = ids() != 255
    assert found["ari"]["similarity"] == pytest.approx(adjusted_rand_score(ids()[valid], values[valid]))
    zeros, ones = int((ids() == 0).sum()), int((ids() == 1).sum())
    assert found["iou"]["similarity"] == pytest.approx(min((zeros - 1) / zeros, ones / (ones + 1)))


def test_one_pixel_without_a_class_is_found(classes: Path, tmp_path: Path) -> None:
    values = ids()
    values[20, 7] = 255
    assert differing(classes, put_classes(tmp_path / "b.tif", values)) == {"changed", "iou"}


def test_swapped_classes_differ_though_the_areas_are_the_same_and_it_is_said(classes: Path, tmp_path: Path) -> None:
    other = put_classes(tmp_path / "b.tif", np.array([1, 0, 2, *range(3, 256)], np.uint8)[ids()])
    assert differing(classes, other) == {"changed", "iou"}
    done = compare(classes, other)
    assert "renumbered: the same areas bear other ids: 0 -> 1, 1 -> 0" in done.stdout
    found = json.loads(compare(classes, other, "--json").stdout)
    assert found["renumbered"] is True
    assert found["matching"] == {"0": 1, "1": 0, "2": 2}
    assert found["matched_accuracy"] == 1
    # The Rand index does not see ids: tolerating it tolerates no other ids.
    assert differing(classes, other, "--tolerance", "ari=1") == {"changed", "iou"}
    assert differing(classes, other, "--tolerance", "changed=1") == set()


def test_two_classes_that_became_one_are_no_renumbering(classes: Path, tmp_path: Path) -> None:
    other = put_classes(tmp_path / "b.tif", np.array([1, 1, 2, *range(3, 256)], np.uint8)[ids()])
    assert json.loads(compare(classes, other, "--json").stdout)["renumbered"] is False
    assert differing(classes, other) == PIXELS


@pytest.mark.parametrize("tolerance", ["changed=0.001", "iou=0.01"])
def test_a_change_within_a_tolerance_passes(classes: Path, tmp_path: Path, tolerance: str) -> None:
    values = ids()
    values[20, 7] = 1
    other = put_classes(tmp_path / "b.tif", values)
    assert differing(classes, other, "--tolerance", tolerance) == set()
    assert differing(classes, other, "--tolerance", "changed=0.0001") == {"changed"}
    assert differing(classes, other, "--tolerance", "changed=0.001", "--tolerance", "ari=0.00001") == {"ari"}


def test_a_class_called_otherwise_is_found(classes: Path, tmp_path: Path) -> None:
    other = put_classes(tmp_path / "b.tif", names=["grass", "mud", "rock"])
    assert differing(classes, other) == {"names"}
    assert "class 1 is called 'sand' in A and 'mud' in B" in compare(classes, other).stdout
    assert differing(classes, other, "--tolerance", "names=1") == set()


def test_a_raster_stored_otherwise_is_the_same(classes: Path, scoremap: Path, tmp_path: Path) -> None:
    assert differing(classes, classes) == set()
    assert differing(classes, put_classes(tmp_path / "b.tif", COMPRESS="LZW", BLOCKSIZE="128")) == set()
    assert differing(classes, recoded(classes, tmp_path / "plain.tif")) == set()
    assert differing(scoremap, recoded(scoremap, tmp_path / "plain_s.tif", compress="deflate")) == set()


@pytest.mark.parametrize("kind", ["classes", "scoremap"])
def test_the_same_grid_said_otherwise_is_the_same(request: pytest.FixtureRequest, kind: str, tmp_path: Path) -> None:
    source = request.getfixturevalue(kind)
    noisy = PLACE @ Affine.translation(1e-9, -1e-9)
    assert differing(source, recoded(source, tmp_path / "noise.tif", transform=noisy)) == set()
    text = re.sub(r',AUTHORITY\["EPSG","\d+"\]', "", UTM33.to_wkt())
    assert differing(source, recoded(source, tmp_path / "wkt.tif", crs=CRS.from_wkt(text))) == set()


@pytest.mark.parametrize("kind", ["classes", "scoremap"])
def test_a_raster_shifted_by_one_pixel_is_compared_where_it_lies(
    request: pytest.FixtureRequest, kind: str, tmp_path: Path
) -> None:
    source = request.getfixturevalue(kind)
    moved = PLACE @ Affine.translation(1, 0)
    other = recoded(source, tmp_path / "moved.tif", transform=moved)
    names = differing(source, other)
    assert "shift_m" in names
    assert names & {"changed", "max"}, "its pixels lie on others now"
    assert figures(source, other)["shift_m"]["difference"] == pytest.approx(1.0, rel=1e-3)
    # What lies where it lay is not said to differ: the whole map moved one pixel back by its content.
    if kind == "classes":
        values = np.full_like(ids(), 255)
        values[:, :-1] = ids()[:, 1:]
        back = put_classes(tmp_path / "back.tif", values, transform=moved)
        assert differing(source, back) == {"shift_m"}


@pytest.mark.parametrize("kind", ["classes", "scoremap"])
@pytest.mark.parametrize(
    ("change", "wanted"),
    [
        ({"crs": CRS.from_epsg(32632)}, {"crs", "shift_m"}),
        ({"transform": PLACE @ Affine.translation(0.5, 0)}, {"shift_m"}),
        ({"transform": PLACE @ Affine.scale(1.01)}, {"shift_m", "pixel_m"}),
        ({"transform": PLACE @ Affine.rotation(1)}, {"shift_m"}),
    ],
)
def test_pixels_that_do_not_lie_on_one_another_are_not_compared(
    request: pytest.FixtureRequest, kind: str, tmp_path: Path, change: dict[str, object], wanted: set[str]
) -> None:
    source = request.getfixturevalue(kind)
    other = recoded(source, tmp_path / "other.tif", **change)
    names = differing(source, other)
    assert wanted <= names
    assert names <= wanted | {"pixel_m"}
    assert not (PIXELS | {"max", "rmse"}) & set(figures(source, other))
    assert "they do not lie on one another" in compare(source, other).stdout
    tolerated = ("--tolerance", "shift_m=1e9", "--tolerance", "pixel_m=1")
    assert differing(source, other, *tolerated) == wanted - {"shift_m", "pixel_m"}


def test_a_crop_is_compared_where_both_are(classes: Path, tmp_path: Path) -> None:
    crop = put_classes(tmp_path / "crop.tif", ids()[10:30, 5:], transform=PLACE @ Affine.translation(5, 10))
    assert differing(classes, crop) == {"size", "shift_m"}
    assert json.loads(compare(classes, crop, "--json").stdout)["pixels"] == 20 * 45


def test_plain_images_are_compared_in_pixels(tmp_path: Path) -> None:
    a = write_raster(tmp_path / "a.tif", ids(), crs=None, transform=None, nodata=255)
    assert differing(a, a) == set()
    smaller = write_raster(tmp_path / "b.tif", ids()[:-1], crs=None, transform=None, nodata=255)
    assert {"size"} <= differing(a, smaller) <= {"size", "shift_m"}
    placed = put_classes(tmp_path / "c.tif", names=[""])
    assert {"crs", "shift_m"} <= differing(a, placed) <= {"crs", "shift_m", "pixel_m", "names"}


@given(st.integers(-60, 60), st.integers(-60, 60))
def test_an_offset_of_whole_pixels_is_found(down: int, right: int) -> None:
    place = Affine.translation(400_000.3, 5_000_000.7) @ Affine.rotation(20) @ Affine.scale(0.1, -0.1)
    grid = Grid(40, 50, place @ Affine.translation(right, down), UTM33)
    assert lattice_offset(grid, Grid(30, 70, place, UTM33)) == (down, right)
    assert lattice_offset(grid, Grid(30, 70, place @ Affine.translation(0.02, 0), UTM33)) is None


@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(0, 2**32 - 1), st.sampled_from([7, 16, 64]))
def test_figures_are_those_of_the_whole_arrays_whatever_the_block(tmp_path: Path, seed: int, block: int) -> None:
    rng = np.random.default_rng(seed)
    a, b = (rng.choice(np.array([0, 1, 5, 255], np.uint8), (18, 23)) for _ in range(2))
    paths = [write_raster(tmp_path / f"{name}.tif", each, nodata=255) for name, each in (("x", a), ("y", b))]
    found = compare_classes(*paths, silent, block)
    named = {figure.name: figure for figure in found.figures}
    some = (a != 255) | (b != 255)
    assert named["changed"].difference == pytest.approx((a != b)[some].mean())
    both = (a != 255) & (b != 255)
    assert named["ari"].similarity == pytest.approx(adjusted_rand_score(a[both], b[both]))
    for each in found.detail["per_class"]:
        k = each["id"]
        assert each["iou"] == pytest.approx(((a == k) & (b == k)).sum() / ((a == k) | (b == k)).sum())


def test_one_score_off_is_found(scoremap: Path, tmp_path: Path) -> None:
    score = scores_map()
    score[3, 5] += 0.25
    other = put_scoremap(tmp_path / "b.tif", score)
    assert differing(scoremap, other) == {"rmse", "max"}
    found = figures(scoremap, other)
    assert found["max"]["difference"] == pytest.approx(0.25, abs=1e-6)
    assert found["rmse"]["difference"] == pytest.approx(0.25 / np.sqrt(20 * 24 - 4), rel=1e-5)
    assert "farthest apart: cell 3,5" in compare(scoremap, other).stdout
    assert differing(scoremap, other, "--tolerance", "rmse=0.02") == set()
    assert differing(scoremap, other, "--tolerance", "max=0.26") == set()
    assert differing(scoremap, other, "--tolerance", "rmse=0.02", "--tolerance", "max=0.2") == {"max"}


def test_a_cell_that_became_no_go_or_go_is_found(scoremap: Path, tmp_path: Path) -> None:
    score = scores_map()
    score[3, 5] = np.nan
    other = put_scoremap(tmp_path / "b.tif", score)
    assert differing(scoremap, other) == {"no_go"}
    assert differing(other, scoremap) == {"go"}
    assert "cell 3,5 is no-go in B only" in compare(scoremap, other).stdout
    assert differing(scoremap, other, "--tolerance", "no_go=1") == set()


def test_a_standard_deviation_off_is_found(scoremap: Path, tmp_path: Path) -> None:
    sd = np.where(np.isnan(scores_map()), np.nan, 0.1).astype(np.float32)
    sd[0, 0] = 0.3
    other = put_scoremap(tmp_path / "b.tif", sd=sd)
    assert differing(scoremap, other) == {"sd_rmse", "sd_max"}
    assert figures(scoremap, other)["sd_max"]["difference"] == pytest.approx(0.2, abs=1e-6)


def test_scoremaps_without_a_place_are_compared_cell_by_cell(tmp_path: Path) -> None:
    score = np.nan_to_num(scores_map())
    np.savez(tmp_path / "a.npz", score=score, cell_size_m=2.0)
    np.savez_compressed(tmp_path / "same.npz", score=score, cell_size_m=2.0, sd=np.zeros_like(score))
    np.savez(tmp_path / "cell.npz", score=score, cell_size_m=3.0)
    np.savez(tmp_path / "off.npz", score=score + np.eye(20, 24, dtype=np.float32), cell_size_m=2.0)
    assert differing(tmp_path / "a.npz", tmp_path / "same.npz") == set()
    assert differing(tmp_path / "a.npz", tmp_path / "cell.npz") == {"pixel_m", "shift_m"}
    assert differing(tmp_path / "a.npz", tmp_path / "off.npz") == {"rmse", "max"}
    assert "crs" in differing(tmp_path / "a.npz", put_scoremap(tmp_path / "b.tif"))


def test_a_raster_that_is_no_artifact_is_refused(classes: Path, tmp_path: Path) -> None:
    picture = write_raster(tmp_path / "p.tif", np.zeros((3, 40, 50), np.uint8))
    heights = write_raster(tmp_path / "dsm.tif", np.ones((40, 50), np.float32))
    damaged = tmp_path / "d.tif"
    damaged.write_bytes(classes.read_bytes()[:-300])
    for path, told in ((picture, "3 bands"), (heights, "surface model"), (damaged, "d.tif")):
        for pair in ((classes, path), (path, classes)):
            done = compare(*pair)
            assert isinstance(done.exception, InputError), path
            assert told in str(done.exception)
            assert done.stdout == ""


def test_names_are_those_of_the_rasters(classes: Path) -> None:
    found = json.loads(compare(classes, classes, "--json").stdout)
    assert [each["name"] for each in found["per_class"]] == NAMES
    assert found["kind"] == "classes"
    assert found["origin"]["same_inputs"] is True
