"""The figure of a comparison: colours mean what the legend says, and it is an artifact like any other."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import rasterio
from affine import Affine
from numpy.typing import NDArray

from hrt_cli.artifacts.png import png_provenance
from hrt_cli.artifacts.stage import REFUSE, Existing
from hrt_cli.errors import InputError, OutputError
from hrt_cli.evaluation.segment import agreement, evaluate_segmentation
from hrt_cli.raster.classes import open_classes
from hrt_cli.raster.style import class_colour, rgb_of
from hrt_cli.report.figures import agreement as drawn
from hrt_cli.report.figures import palette

Ids = NDArray[np.uint8]


def write(path: Path, ids: Ids) -> Path:
    place = Affine(0.1, 0, 500_000, 0, -0.1, 5_400_000)
    with rasterio.open(path, "w", "GTiff", ids.shape[1], ids.shape[0], 1, "EPSG:32633", place, "uint8", 255) as raster:
        raster.write(ids, 1)
    return path


@pytest.fixture
def pair(tmp_path: Path) -> tuple[Path, Path]:
    truth = np.zeros((60, 80), np.uint8)
    truth[:, 40:] = 1
    classes = np.where(truth == 1, 5, 2).astype(np.uint8)
    classes[:20, 60:] = 8
    classes[40:50, :10] = 5
    classes[:5, :5] = 255
    return write(tmp_path / "classes.tif", classes), write(tmp_path / "truth.tif", truth)


def test_classes_take_the_colour_of_their_truth_and_the_rest_is_grey(pair: tuple[Path, Path]) -> None:
    table = evaluate_segmentation(*pair).areas
    true_colours, colours = drawn._colours(table)
    assert tuple(colours[2]) == tuple(true_colours[0]) == rgb_of(class_colour(0))
    assert tuple(colours[5]) == tuple(true_colours[1]) == rgb_of(class_colour(1))
    assert np.ptp(colours[8]) == 0
    assert not np.array_equal(colours[8], colours[255])


def test_the_map_of_differences(pair: tuple[Path, Path]) -> None:
    table = evaluate_segmentation(*pair).areas
    with open_classes(pair[0]) as classes, open_classes(pair[1]) as truth:
        picture = drawn._differences(
            drawn.thinned(classes.read, classes.grid.shape, drawn.PANEL_PX)[0],
            drawn.thinned(truth.read, truth.grid.shape, drawn.PANEL_PX)[0],
            table,
        )
    assert picture.shape == (60, 80, 3)
    right, wrong, unmatched, void = (
        (picture == rgb_of(colour)).all(axis=2).sum()
        for colour in (palette.RIGHT, palette.WRONG, palette.UNMATCHED, palette.VOID)
    )
    assert (wrong, unmatched, void) == (100, 400, 25)
    assert right / (right + wrong + unmatched) == pytest.approx(table.accuracy)


@pytest.mark.parametrize("rows", [1, 32])
def test_a_large_raster_is_thinned_as_it_is_read(tmp_path: Path, rows: int) -> None:
    ids = np.broadcast_to((np.arange(2101) // 300).astype(np.uint8), (rows, 2101))
    with open_classes(write(tmp_path / "wide.tif", ids)) as raster:
        small, _ = drawn.thinned(raster.read, raster.grid.shape, drawn.PANEL_PX)
    assert small.shape == (-(-rows // 4), 526)
    assert np.array_equal(small[0], ids[0, ::4])


def test_the_figure_is_cached_signed_and_the_same_bytes(pair: tuple[Path, Path], tmp_path: Path) -> None:
    table = evaluate_segmentation(*pair).areas
    figure = tmp_path / "f.png"
    assert not drawn.draw_agreement(*pair, figure, table, "ARI 0.5", existing=REFUSE)
    before = figure.read_bytes()
    assert drawn.draw_agreement(*pair, figure, table, "ARI 0.5", existing=REFUSE)
    assert not drawn.draw_agreement(*pair, figure, table, "ARI 0.5", existing=Existing(force=True))
    assert figure.read_bytes() == before
    found = png_provenance(figure)
    assert found is not None
    assert [each.role for each in found.inputs] == ["classes", "truth"]
    with pytest.raises(OutputError, match="--overwrite"):
        drawn.draw_agreement(*pair, figure, table, "ARI 0.6", existing=REFUSE)


def test_the_picture_shows_both_maps_and_the_errors(pair: tuple[Path, Path], tmp_path: Path) -> None:
    table = evaluate_segmentation(*pair).areas
    drawn.draw_agreement(*pair, tmp_path / "f.png", table, "ARI 0.5", existing=REFUSE)
    picture = cv2.cvtColor(cv2.imread(str(tmp_path / "f.png")), cv2.COLOR_BGR2RGB)
    rows, cols = picture.shape[:2]
    quarters = {
        "truth": picture[: rows // 2, : cols // 2],
        "classes": picture[: rows // 2, cols // 2 :],
        "differences": picture[rows // 2 : rows * 9 // 10, : cols // 2],
    }

    def share(name: str, colour: str) -> float:
        return float((quarters[name] == rgb_of(colour)).all(axis=2).mean())

    assert share("truth", class_colour(0)) == pytest.approx(share("truth", class_colour(1)), rel=0.05)
    assert share("truth", class_colour(0)) > 0.3
    assert share("classes", class_colour(0)) < 0.97 * share("truth", class_colour(0))
    assert share("differences", palette.UNMATCHED) > 3 * share("differences", palette.WRONG) > 0
    assert share("differences", class_colour(0)) == 0


def test_many_classes_are_drawn_without_labels(tmp_path: Path) -> None:
    ids = (np.arange(40 * 200) % 200).astype(np.uint8).reshape(40, 200)
    first, second = write(tmp_path / "a.tif", ids), write(tmp_path / "b.tif", (ids // 2).astype(np.uint8))
    table = evaluate_segmentation(first, second).areas
    assert not drawn.draw_agreement(first, second, tmp_path / "f.png", table, "many", existing=REFUSE)


def test_rasters_that_do_not_lie_on_each_other_are_refused(pair: tuple[Path, Path], tmp_path: Path) -> None:
    other = write(tmp_path / "other.tif", np.zeros((60, 81), np.uint8))
    table = agreement(np.eye(255, dtype=np.int64))
    with pytest.raises(InputError, match="does not lie on"):
        drawn.draw_agreement(pair[0], other, tmp_path / "f.png", table, "", existing=REFUSE)
    assert not (tmp_path / "f.png").exists()
