from __future__ import annotations

import itertools
import math
from pathlib import Path

import numpy as np
import pytest
import rasterio
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from numpy.typing import NDArray
from rasterio.transform import from_origin
from sklearn.metrics import (
    adjusted_rand_score,
    jaccard_score,
    normalized_mutual_info_score,
    precision_score,
    recall_score,
)

from hrt_cli.errors import InputError
from hrt_cli.evaluation.segment import TruthAgreement, agreement, evaluate_segmentation

Ids = NDArray[np.uint8]


def table_of(classes: Ids, truth: Ids) -> NDArray[np.int64]:
    table = np.zeros((255, 255), np.int64)
    np.add.at(table, (classes, truth), 1)
    return table


def best_accuracy(classes: Ids, truth: Ids) -> float:
    """The largest share of equal ids over every one-to-one renaming of the classes."""
    ids, names = np.unique(classes), np.unique(truth)
    padded = [*names, *[None] * len(ids)]
    hits = {(k, t): int(np.sum((classes == k) & (truth == t))) for k in ids for t in names}
    return max(
        sum(hits.get((k, t), 0) for k, t in zip(ids, choice, strict=True))
        for choice in itertools.permutations(padded, len(ids))
    ) / len(classes)


labels = st.integers(1, 60).flatmap(
    lambda size: st.tuples(
        npst.arrays(np.uint8, size, elements=st.integers(0, 3)),
        npst.arrays(np.uint8, size, elements=st.sampled_from([0, 1, 7, 254])),
    )
)


@settings(deadline=None)
@given(labels)
def test_the_figures_are_those_of_scikit_learn_and_of_brute_force(pair: tuple[Ids, Ids]) -> None:
    classes, truth = pair
    found = agreement(table_of(classes, truth))
    assert found.ari == pytest.approx(adjusted_rand_score(truth, classes), abs=1e-9)
    assert found.nmi == pytest.approx(normalized_mutual_info_score(truth, classes), abs=1e-9)
    assert found.accuracy == pytest.approx(best_accuracy(classes, truth))
    assert 0 <= found.nmi <= 1
    matched = sum(int(np.sum((classes == k) & (truth == t))) for k, t in found.matching.items())
    assert matched / len(classes) == found.accuracy
    assert len(set(found.matching.values())) == len(found.matching)


@settings(deadline=None)
@given(labels)
def test_the_confusion_counts_every_pair(pair: tuple[Ids, Ids]) -> None:
    classes, truth = pair
    found = agreement(table_of(classes, truth))
    assert found.class_ids == sorted(set(classes.tolist()))
    assert found.truth_ids == sorted(set(truth.tolist()))
    for i, k in enumerate(found.class_ids):
        for j, t in enumerate(found.truth_ids):
            assert found.confusion[i, j] == np.sum((classes == k) & (truth == t))


@settings(deadline=None)
@given(labels, st.permutations(range(4)))
def test_the_numbers_of_the_classes_do_not_matter(pair: tuple[Ids, Ids], renaming: list[int]) -> None:
    classes, truth = pair
    found = agreement(table_of(classes, truth))
    renamed = agreement(table_of(np.array(renaming, np.uint8)[classes], truth))
    assert (renamed.ari, renamed.nmi) == pytest.approx((found.ari, found.nmi), abs=1e-12)
    assert renamed.accuracy == found.accuracy
    swapped = agreement(table_of(truth, classes))
    assert (swapped.ari, swapped.nmi) == pytest.approx((found.ari, found.nmi), abs=1e-12)


@settings(deadline=None)
@given(labels)
def test_a_renamed_truth_agrees_wholly(pair: tuple[Ids, Ids]) -> None:
    truth = pair[1]
    found = agreement(table_of(np.uint8(254) - truth, truth))
    assert (found.ari, found.nmi, found.accuracy) == pytest.approx((1, 1, 1))
    assert found.matching == {254 - t: t for t in sorted(set(truth.tolist()))}


@settings(deadline=None)
@given(labels)
def test_each_truth_has_the_figures_of_scikit_learn(pair: tuple[Ids, Ids]) -> None:
    classes, truth = pair
    found = agreement(table_of(classes, truth))
    renamed = np.array([found.matching.get(k, 255) for k in classes.tolist()])
    votes = {k: np.bincount(truth[classes == k]).argmax() for k in found.class_ids}
    voted = np.array([votes[k] for k in classes.tolist()])
    assert [each.truth_id for each in found.per_class] == found.truth_ids
    for each in found.per_class:
        t = [each.truth_id]
        assert each.pixels == np.sum(truth == t)
        assert each.class_id == {v: k for k, v in found.matching.items()}.get(each.truth_id)
        assert each.precision == pytest.approx(precision_score(truth, renamed, labels=t, average=None, zero_division=0))
        assert each.recall == pytest.approx(recall_score(truth, renamed, labels=t, average=None)[0])
        assert each.iou == pytest.approx(jaccard_score(truth, renamed, labels=t, average=None)[0])
        assert each.vote_recall == pytest.approx(recall_score(truth, voted, labels=t, average=None)[0])
    assert found.mean_iou == pytest.approx(np.mean([each.iou for each in found.per_class]))
    assert found.vote_recall == pytest.approx(np.mean([each.vote_recall for each in found.per_class]))


def test_each_truth_by_hand() -> None:
    table = np.zeros((255, 255), np.int64)
    table[:4, :3] = [[6, 1, 0], [0, 3, 0], [2, 0, 0], [0, 2, 0]]
    found = agreement(table, ["grass", "road"])
    assert found.per_class == [
        TruthAgreement(0, "grass", 0, 8, 6 / 7, 6 / 8, 6 / 9, 1.0),
        TruthAgreement(1, "road", 1, 6, 3 / 3, 3 / 6, 3 / 6, 5 / 6),
    ]
    assert found.mean_iou == pytest.approx((6 / 9 + 3 / 6) / 2)
    assert found.vote_recall == pytest.approx((1 + 5 / 6) / 2)


def test_a_truth_that_no_class_is_left_for_counts_zero() -> None:
    table = np.zeros((255, 255), np.int64)
    table[5, [2, 9]] = [7, 3]
    found = agreement(table, ["a", "b", "c"])
    assert found.per_class == [
        TruthAgreement(2, "c", 5, 7, 0.7, 1.0, 0.7, 1.0),
        TruthAgreement(9, None, None, 3, 0.0, 0.0, 0.0, 0.0),
    ]
    assert found.mean_iou == pytest.approx(0.35)


def test_the_counts_of_a_huge_raster_do_not_overflow() -> None:
    small = table_of(np.array([0, 0, 0, 1, 1, 2], np.uint8), np.array([0, 0, 1, 1, 1, 0], np.uint8))
    huge, larger = agreement(small * 10**12), agreement(small * 10**9)
    assert huge.ari == pytest.approx(larger.ari, abs=1e-6)
    assert -1 < huge.ari < 1
    assert huge.nmi == pytest.approx(agreement(small).nmi)
    assert huge.accuracy == pytest.approx(agreement(small).accuracy)


def test_chance_is_about_zero() -> None:
    rng = np.random.default_rng(0)
    found = agreement(table_of(*rng.integers(0, 5, (2, 20_000), np.uint8)))
    assert abs(found.ari) < 0.005
    assert found.nmi < 0.01


def raster(path: Path, ids: Ids, *, east: float = 500_000.0, crs: str = "EPSG:32633", nodata: int | None = 255) -> Path:
    rows, cols = ids.shape
    with rasterio.open(
        path,
        "w",
        driver="GTiff",
        height=rows,
        width=cols,
        count=1,
        dtype="uint8",
        crs=crs,
        transform=from_origin(east, 5_400_000.0, 0.1, 0.1),
        nodata=nodata,
    ) as dataset:
        dataset.write(ids, 1)
    return path


def test_only_pixels_where_both_have_a_class_count(tmp_path: Path) -> None:
    classes = np.array([[0, 0, 1, 1], [0, 255, 1, 255]], np.uint8)
    truth = np.array([[3, 3, 3, 5], [255, 3, 5, 255]], np.uint8)
    first, second = raster(tmp_path / "a.tif", classes), raster(tmp_path / "b.tif", truth, nodata=None)
    found = evaluate_segmentation(first, second).areas
    assert found.confusion.tolist() == [[2, 0], [1, 2]]
    assert (found.class_ids, found.truth_ids) == ([0, 1], [3, 5])
    assert found.accuracy == pytest.approx(0.8)
    assert found.matching == {0: 3, 1: 5}


def test_a_raster_of_more_than_one_block_is_counted_whole(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    classes, truth = rng.integers(0, 3, (2, 30, 2100), np.uint8)
    found = evaluate_segmentation(raster(tmp_path / "a.tif", classes), raster(tmp_path / "b.tif", truth)).areas
    assert found.confusion.sum() == classes.size
    assert found.ari == pytest.approx(adjusted_rand_score(truth.ravel(), classes.ravel()), abs=1e-12)
    assert math.isclose(found.nmi, normalized_mutual_info_score(truth.ravel(), classes.ravel()), abs_tol=1e-12)


@pytest.mark.parametrize("difference", ["shape", "place", "crs", "nothing in common"])
def test_rasters_that_cannot_be_compared_are_refused(tmp_path: Path, difference: str) -> None:
    ids = np.array([[0, 1, 1], [1, 0, 0]], np.uint8)
    empty = np.full_like(ids, 255)
    first = raster(tmp_path / "a.tif", ids)
    second = {
        "shape": lambda path: raster(path, ids[:, :2]),
        "place": lambda path: raster(path, ids, east=500_000.1),
        "crs": lambda path: raster(path, ids, crs="EPSG:32634"),
        "nothing in common": lambda path: raster(path, empty),
    }[difference](tmp_path / "b.tif")
    with pytest.raises(InputError, match=r"a\.tif: (does not lie on|shares no classified pixel with) .*b\.tif"):
        evaluate_segmentation(first, second)
