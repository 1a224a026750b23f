from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from numpy.typing import NDArray
from skimage.segmentation import find_boundaries

from hrt_cli.errors import ArgumentError
from hrt_cli.evaluation.boundary import (
    MAX_REACH_PX,
    BoundaryScore,
    boundaries,
    boundary_score,
    count_met,
    default_tolerance_m,
    halo_px,
    reach_px,
)
from hrt_cli.evaluation.segment import evaluate_segmentation
from hrt_cli.raster.windows import blocks

Ids = NDArray[np.uint8]

shapes = st.tuples(st.integers(1, 14), st.integers(1, 14))
ids = st.sampled_from([0, 0, 0, 1, 1, 2, 255])
pairs = shapes.flatmap(
    lambda shape: st.tuples(npst.arrays(np.uint8, shape, elements=ids), npst.arrays(np.uint8, shape, elements=ids))
)
pixels = st.sampled_from([(1.0, 1.0), (0.1, 0.1), (0.7, 1.3), (2.1, 0.9)])
tolerances_px = st.sampled_from([0.0, 0.5, 1.0, 1.2, 1.5, 2.0, 2.3, 3.7, 30.0])


def edge_pixels(own: Ids, other: Ids) -> list[tuple[int, int]]:
    """Pixels that differ from the right or the lower neighbour, one by one."""
    rows, cols = own.shape
    found = []
    for r in range(rows):
        for c in range(cols):
            beside = [(r, c + 1), (r + 1, c)]
            here = [(i, j) for i, j in beside if i < rows and j < cols]
            known = [at for at in here if 255 not in (own[at], other[at], own[r, c], other[r, c])]
            if any(own[at] != own[r, c] for at in known):
                found.append((r, c))
    return found


def brute(classes: Ids, truth: Ids, pixel: tuple[float, float], tolerance: float) -> list[int]:
    found, true = edge_pixels(classes, truth), edge_pixels(truth, classes)

    def met(ours: list[tuple[int, int]], others: list[tuple[int, int]]) -> int:
        # A tolerance is met to a thousandth.
        limit = tolerance * 1.001
        return sum(any(np.hypot((r - i) * pixel[0], (c - j) * pixel[1]) <= limit for i, j in others) for r, c in ours)

    return [len(found), met(found, true), len(true), met(true, found)]


def blockwise(classes: Ids, truth: Ids, reach: NDArray[np.int64], size: int) -> list[int]:
    counts = np.zeros(4, np.int64)
    for window in blocks(classes.shape, size):
        wide = window.grown(halo_px(reach)).clipped(classes.shape)
        top, left = window.row - wide.row, window.col - wide.col
        core = (slice(top, top + window.height), slice(left, left + window.width))
        counts += count_met(classes[wide.slices], truth[wide.slices], core, reach)
    return counts.tolist()


@settings(deadline=None, max_examples=300)
@given(pairs, pixels, tolerances_px, st.integers(1, 15))
def test_counts_are_those_of_brute_force_in_blocks_of_any_size(
    pair: tuple[Ids, Ids], pixel: tuple[float, float], tolerance_px: float, size: int
) -> None:
    tolerance = tolerance_px * pixel[1]
    assert blockwise(*pair, reach_px(tolerance, pixel), size) == brute(*pair, pixel, tolerance)


@settings(deadline=None)
@given(shapes.flatmap(lambda shape: npst.arrays(np.uint8, shape, elements=st.integers(0, 3))))
def test_boundaries_seen_from_both_sides_are_those_of_scikit_image(labels: Ids) -> None:
    turned = boundaries(labels[::-1, ::-1])[::-1, ::-1]
    thick = find_boundaries(labels, connectivity=1, mode="thick", background=255)
    assert np.array_equal(boundaries(labels) | turned, thick)


@settings(deadline=None)
@given(pairs, st.permutations(range(3)))
def test_names_do_not_matter_and_swapping_swaps_precision_and_recall(
    pair: tuple[Ids, Ids], renaming: list[int]
) -> None:
    reach = reach_px(1.5, (1, 1))
    found = boundary_score(np.array(blockwise(*pair, reach, 99)))
    renamed = np.where(pair[0] == 255, 255, np.array([*renaming, *[0] * 253], np.uint8)[pair[0]]).astype(np.uint8)
    assert boundary_score(np.array(blockwise(renamed, pair[1], reach, 99))) == found
    swapped = boundary_score(np.array(blockwise(pair[1], pair[0], reach, 99)))
    assert (swapped.precision, swapped.recall) == (found.recall, found.precision)
    assert swapped.f == pytest.approx(found.f)


def test_scores_by_hand() -> None:
    assert boundary_score(np.array([4, 3, 6, 3])) == BoundaryScore(0.75, 0.5, pytest.approx(0.6))
    assert boundary_score(np.array([4, 0, 6, 0])) == BoundaryScore(0, 0, 0)
    assert boundary_score(np.array([0, 0, 6, 0])) == BoundaryScore(1, 0, 0)
    assert boundary_score(np.array([0, 0, 0, 0])) == BoundaryScore(1, 1, 1)


def test_a_shift_within_the_tolerance_costs_nothing_and_a_larger_one_everything() -> None:
    truth = np.zeros((20, 30), np.uint8)
    truth[:, 15:] = 1
    shifted = np.roll(truth, 5, axis=1)
    shifted[:, :5] = 0
    for tolerance, score in ((0.5, 1.0), (0.49, 0.0)):
        assert boundary_score(np.array(blockwise(shifted, truth, reach_px(tolerance, (0.1, 0.1)), 7))).f == score


@pytest.mark.parametrize("scale", [0.9996, 1.0009])
def test_a_tolerance_of_five_pixels_is_five_pixels_in_any_part_of_a_utm_zone(scale: float) -> None:
    assert reach_px(0.5, (0.1 / scale, 0.1 / scale))[0] == 5
    assert len(reach_px(0.5, (0.1 / scale, 0.1 / scale))) == 6


def test_the_default_tolerance() -> None:
    assert default_tolerance_m((100, 100), (0.02, 0.02), referenced=True) == 0.5
    assert default_tolerance_m((100, 100), (0.6, 0.8), referenced=True) == 0.8
    assert default_tolerance_m((300, 400), (1, 1), referenced=False) == pytest.approx(3.75)


def test_a_tolerance_that_would_not_fit_in_memory_is_refused() -> None:
    assert halo_px(reach_px(MAX_REACH_PX * 0.01, (0.01, 0.02))) == MAX_REACH_PX + 2
    with pytest.raises(ArgumentError, match=r"--tolerance-m: 20 is too large; it can be 10\.2"):
        reach_px(20, (0.01, 0.02))


def write(path: Path, labels: Ids, *, names: list[str] | None = None, crs: str | None = "EPSG:32633") -> Path:
    place = Affine(0.1, 0, 500_000, 0, -0.2, 5_400_000)
    with rasterio.open(
        path, "w", "GTiff", labels.shape[1], labels.shape[0], 1, crs, place if crs else None, "uint8", 255
    ) as raster:
        raster.write(labels, 1)
        if names:
            raster.update_tags(ns="HRT", NAMES=json.dumps(names))
    return path


def test_the_result_does_not_depend_on_the_block_size(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    pair = rng.integers(0, 3, (2, 6, 8), np.uint8).repeat(7, axis=1).repeat(6, axis=2)
    pair[1] = np.roll(pair[0], (3, 2), axis=(0, 1))
    pair[0, :9, 20:30] = 255
    first, second = write(tmp_path / "a.tif", pair[0]), write(tmp_path / "b.tif", pair[1])
    steps: list[tuple[int, int]] = []
    whole = evaluate_segmentation(first, second, tolerance_m=0.25, progress=lambda *at: steps.append(at))
    assert steps == [(0, 1), (1, 1)]
    counts = brute(pair[0], pair[1], (0.2, 0.1), 0.25)
    assert whole.boundary == boundary_score(np.array(counts))
    assert 0.1 < whole.boundary.f < 0.9
    for block_px in (1, 5, 16, 40):
        part = evaluate_segmentation(first, second, tolerance_m=0.25, block_px=block_px)
        assert part.boundary == whole.boundary
        assert np.array_equal(part.areas.confusion, whole.areas.confusion)


def hrt(*args: str | Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "hrt_cli.main", "evaluate", "segment", *map(str, args)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_the_command_tells_areas_boundaries_and_each_truth(tmp_path: Path) -> None:
    truth = np.zeros((12, 20), np.uint8)
    truth[:, 10:] = 1
    classes = np.where(np.roll(truth, 1, axis=1) == 1, 7, 3).astype(np.uint8)
    classes[:, 0] = 3
    first = write(tmp_path / "a.tif", classes)
    second = write(tmp_path / "b.tif", truth, names=["grass", "road"])
    done = hrt(first, second, "--json", "--figure", tmp_path / "f.png")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["per_class"] == [
        {
            "truth_id": 0,
            "name": "grass",
            "class_id": 3,
            "pixels": 120,
            "precision": 120 / 132,
            "recall": 1.0,
            "iou": 120 / 132,
            "vote_recall": 1.0,
        },
        {
            "truth_id": 1,
            "name": "road",
            "class_id": 7,
            "pixels": 120,
            "precision": 1.0,
            "recall": 0.9,
            "iou": 0.9,
            "vote_recall": 0.9,
        },
    ]
    assert found["mean_iou"] == pytest.approx((120 / 132 + 0.9) / 2)
    assert found["vote_recall"] == pytest.approx(0.95)
    assert [found[f"boundary_{key}"] for key in ("f", "precision", "recall", "tolerance_m")] == [1, 1, 1, 0.5]
    assert {"ari", "nmi", "accuracy", "confusion", "matching", "class_ids", "truth_ids"} <= set(found)
    assert (tmp_path / "f.png").stat().st_size > 10_000
    strict = hrt(first, second, "--tolerance-m", "0.05")
    assert strict.stdout.count("\n") == 1
    assert "boundary F 0.000 (0.05 m)" in strict.stdout
    plain = hrt(first, second, "--unreferenced", "--json")
    assert json.loads(plain.stdout)["boundary_tolerance_m"] == pytest.approx(0.0075 * np.hypot(12, 20))
    refused = hrt(first, second, "--tolerance-m", "1e6")
    assert refused.returncode == 1
    assert refused.stderr.startswith("Error: --tolerance-m")
    assert hrt(first, second, "--figure", first).returncode == 2
