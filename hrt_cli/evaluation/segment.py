"""How well a class raster agrees with the truth, whatever numbers its classes bear."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hrt_cli.errors import InputError
from hrt_cli.evaluation.boundary import (
    BoundaryScore,
    boundary_score,
    count_met,
    default_tolerance_m,
    halo_px,
    reach_px,
)
from hrt_cli.progress import Progress, silent
from hrt_cli.raster.classes import NODATA, ClassRaster, open_classes
from hrt_cli.raster.grid import require_same_grid
from hrt_cli.raster.windows import Window, blocks

BLOCK_PX = 2048


@dataclass(frozen=True)
class TruthAgreement:
    """How well one class of the truth is found.

    Attributes
    ----------
    truth_id : int
    name : str or None
        As the truth's raster calls it.
    class_id : int or None
        The class matched to it; None where no class is left for it.
    pixels : int
        Its size in the truth.
    precision, recall, iou : float
        Of the matched class (Jaccard 1912: intersection over union), 0 where there is none.
    vote_recall : float
        Share of it in classes that vote for it, each class for the truth that most of its pixels lie in.
    """

    truth_id: int
    name: str | None
    class_id: int | None
    pixels: int
    precision: float
    recall: float
    iou: float
    vote_recall: float


@dataclass(frozen=True)
class Agreement:
    """Agreement of two labellings of the same pixels.

    Attributes
    ----------
    ari : float
        Adjusted Rand index (Hubert & Arabie 1985), 1 for equal partitions, about 0 for chance.
    nmi : float
        Normalised mutual information, arithmetic mean of the entropies, 0 to 1.
    accuracy : float
        Share of pixels labelled right under the best one-to-one matching of ids (Kuhn 1955), 0 to 1.
    matching : dict of int to int
        Class id -> truth id in that matching.
    confusion : int64 [classes, truths]
        Pixels of each class in each truth.
    class_ids, truth_ids : list of int
        Rows and columns of `confusion`.
    per_class : list of TruthAgreement
        One for each of `truth_ids`.
    mean_iou, vote_recall : float
        Means over `per_class`. `vote_recall` is for a segmentation of more classes than the truth has, where
        several may stand for one: the matching leaves all but one of them out.
    """

    ari: float
    nmi: float
    accuracy: float
    matching: dict[int, int]
    confusion: NDArray[np.int64]
    class_ids: list[int]
    truth_ids: list[int]
    per_class: list[TruthAgreement]
    mean_iou: float
    vote_recall: float


@dataclass(frozen=True)
class SegmentationScore:
    """What `evaluate_segmentation` found: areas, boundaries, and the tolerance of those in ground metres."""

    areas: Agreement
    boundary: BoundaryScore
    tolerance_m: float


def evaluate_segmentation(
    classes_path: Path,
    truth_path: Path,
    *,
    tolerance_m: float | None = None,
    unreferenced: bool = False,
    block_px: int = BLOCK_PX,
    progress: Progress = silent,
) -> SegmentationScore:
    """Compare two class rasters that lie pixel on pixel, over the pixels where both have a class.

    Parameters
    ----------
    classes_path, truth_path : Path
    tolerance_m : float, optional
        How far boundaries may lie apart, ground metres (pixels where unreferenced). Default: `default_tolerance_m`.
    unreferenced : bool
        Accept plain images.
    block_px : int
        How much is in memory at once; the result is the same.
    progress : Progress
        Called with (blocks done, blocks).

    Raises
    ------
    InputError
        A raster cannot be used, they do not lie on one grid, or no pixel has both.
    ArgumentError
        The tolerance is too large for the pixels.
    """
    table = np.zeros((NODATA + 1, NODATA + 1), np.int64)
    counts = np.zeros(4, np.int64)
    with (
        open_classes(classes_path, unreferenced=unreferenced) as classes,
        open_classes(truth_path, unreferenced=unreferenced) as truth,
    ):
        grid = truth.grid
        require_same_grid(classes_path, classes.grid, truth_path, grid)
        if tolerance_m is None:
            tolerance_m = default_tolerance_m(grid.shape, grid.pixel_m, referenced=not unreferenced)
        reach = reach_px(tolerance_m, grid.pixel_m)
        windows = list(blocks(grid.shape, block_px))
        for done, window in enumerate(windows):
            progress(done, len(windows))
            ids, true_ids, core = _read_pair(classes, truth, window, halo_px(reach))
            pair = ids[core].astype(np.int64) * (NODATA + 1) + true_ids[core]
            table += np.bincount(pair.ravel(), minlength=table.size).reshape(table.shape)
            counts += count_met(ids, true_ids, core, reach)
        progress(len(windows), len(windows))
        names = truth.names
    table = table[:NODATA, :NODATA]
    if not table.any():
        raise InputError(classes_path, f"shares no classified pixel with {truth_path}")
    return SegmentationScore(agreement(table, names), boundary_score(counts), tolerance_m)


def _read_pair(
    classes: ClassRaster, truth: ClassRaster, window: Window, halo: int
) -> tuple[NDArray[np.uint8], NDArray[np.uint8], tuple[slice, slice]]:
    """Read a block of both rasters with its halo, as far as they reach, and say where in it the block lies."""
    wide = window.grown(halo).clipped(truth.grid.shape)
    core = Window(window.row - wide.row, window.col - wide.col, window.height, window.width)
    return classes.read(wide), truth.read(wide), core.slices


def agreement(table: NDArray[np.int64], names: Sequence[str] = ()) -> Agreement:
    """Return the figures of a contingency table [class, truth] of counts; empty rows and columns are dropped.

    Parameters
    ----------
    table : int64 [classes, truths]
    names : sequence of str
        Names of the truth's ids from 0 on, as far as they are known.
    """
    from scipy.optimize import linear_sum_assignment

    class_ids = np.flatnonzero(table.any(axis=1))
    truth_ids = np.flatnonzero(table.any(axis=0))
    counts = table[np.ix_(class_ids, truth_ids)]
    rows, cols = linear_sum_assignment(counts, maximize=True)
    per_class = _per_class(counts, dict(zip(cols.tolist(), rows.tolist(), strict=True)), class_ids, truth_ids, names)
    return Agreement(
        ari=_adjusted_rand(counts),
        nmi=_normalised_mutual_information(counts),
        accuracy=float(counts[rows, cols].sum() / counts.sum()),
        matching={int(class_ids[r]): int(truth_ids[c]) for r, c in zip(rows, cols, strict=True)},
        confusion=counts,
        class_ids=[int(k) for k in class_ids],
        truth_ids=[int(k) for k in truth_ids],
        per_class=per_class,
        mean_iou=float(np.mean([each.iou for each in per_class])),
        vote_recall=float(np.mean([each.vote_recall for each in per_class])),
    )


def _per_class(
    counts: NDArray[np.int64],
    matched: dict[int, int],
    class_ids: NDArray[np.int64],
    truth_ids: NDArray[np.int64],
    names: Sequence[str],
) -> list[TruthAgreement]:
    of_class, of_truth = counts.sum(axis=1), counts.sum(axis=0)
    vote = counts.argmax(axis=1)
    found = []
    for col, truth_id in enumerate(truth_ids.tolist()):
        row = matched.get(col)
        hits = 0 if row is None else int(counts[row, col])
        size, labelled = int(of_truth[col]), 0 if row is None else int(of_class[row])
        found.append(
            TruthAgreement(
                truth_id=truth_id,
                name=names[truth_id] if truth_id < len(names) else None,
                class_id=None if row is None else int(class_ids[row]),
                pixels=size,
                precision=hits / labelled if labelled else 0.0,
                recall=hits / size,
                iou=hits / (size + labelled - hits),
                vote_recall=float(counts[vote == col, col].sum() / size),
            )
        )
    return found


def _adjusted_rand(counts: NDArray[np.int64]) -> float:
    def pairs(n: NDArray[np.int64]) -> float:
        # In float64: the squares of pixel counts of a large raster do not fit in 64-bit integers.
        real = n.astype(np.float64)
        return float((real * (real - 1) / 2).sum())

    together, by_class, by_truth = pairs(counts), pairs(counts.sum(axis=1)), pairs(counts.sum(axis=0))
    total = pairs(np.array([counts.sum()]))
    expected = by_class * by_truth / total if total else 0.0
    largest = (by_class + by_truth) / 2
    return 1.0 if largest == expected else (together - expected) / (largest - expected)


def _normalised_mutual_information(counts: NDArray[np.int64]) -> float:
    joint = counts / counts.sum()
    row, col = joint.sum(axis=1), joint.sum(axis=0)
    some = joint > 0
    mutual = float((joint[some] * np.log(joint[some] / np.outer(row, col)[some])).sum())
    entropies = -float((row * np.log(row)).sum()) - float((col * np.log(col)).sum())
    return 1.0 if entropies == 0 else float(np.clip(2 * mutual / entropies, 0.0, 1.0))
