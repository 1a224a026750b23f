"""How well a class raster agrees with the truth, whatever numbers its classes bear."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hrt_cli.errors import InputError
from hrt_cli.raster.classes import NODATA, open_classes
from hrt_cli.raster.grid import require_same_grid
from hrt_cli.raster.windows import blocks


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
    """

    ari: float
    nmi: float
    accuracy: float
    matching: dict[int, int]
    confusion: NDArray[np.int64]
    class_ids: list[int]
    truth_ids: list[int]


def evaluate_segmentation(classes_path: Path, truth_path: Path, *, unreferenced: bool = False) -> Agreement:
    """Compare two class rasters that lie pixel on pixel, over the pixels where both have a class.

    Raises
    ------
    InputError
        A raster cannot be used, they do not lie on one grid, or no pixel has both.
    """
    table = np.zeros((NODATA + 1, NODATA + 1), np.int64)
    with (
        open_classes(classes_path, unreferenced=unreferenced) as classes,
        open_classes(truth_path, unreferenced=unreferenced) as truth,
    ):
        require_same_grid(classes_path, classes.grid, truth_path, truth.grid)
        for window in blocks(classes.grid.shape, 2048):
            pair = classes.read(window).astype(np.int64) * (NODATA + 1) + truth.read(window)
            table += np.bincount(pair.ravel(), minlength=table.size).reshape(table.shape)
    table = table[:NODATA, :NODATA]
    if not table.any():
        raise InputError(classes_path, f"shares no classified pixel with {truth_path}")
    return agreement(table)


def agreement(table: NDArray[np.int64]) -> Agreement:
    """Return the figures of a contingency table [class, truth] of counts; empty rows and columns are dropped."""
    from scipy.optimize import linear_sum_assignment

    class_ids = np.flatnonzero(table.any(axis=1))
    truth_ids = np.flatnonzero(table.any(axis=0))
    counts = table[np.ix_(class_ids, truth_ids)]
    rows, cols = linear_sum_assignment(counts, maximize=True)
    return Agreement(
        ari=_adjusted_rand(counts),
        nmi=_normalised_mutual_information(counts),
        accuracy=float(counts[rows, cols].sum() / counts.sum()),
        matching={int(class_ids[r]): int(truth_ids[c]) for r, c in zip(rows, cols, strict=True)},
        confusion=counts,
        class_ids=[int(k) for k in class_ids],
        truth_ids=[int(k) for k in truth_ids],
    )


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
