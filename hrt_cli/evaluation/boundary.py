"""How well the boundaries between classes lie where those of the truth lie, whatever the classes are called."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hrt_cli.errors import ArgumentError
from hrt_cli.raster.classes import NODATA

DEFAULT_TOLERANCE_M = 0.5
DIAGONAL_SHARE = 0.0075
"""Tolerance as a share of the image diagonal where there are no metres (Csurka et al. 2013)."""
MAX_REACH_PX = 1024

# A whole number of pixels is meant to be within a tolerance of that many, but a map projection stretches the ground
# size of a pixel by up to one thousandth against its nominal one (UTM: 0.9996 to 1.001).
_SLACK = 1e-3
_FAR_PX = 1 << 20

Ids = NDArray[np.uint8]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class BoundaryScore:
    """Agreement of two sets of boundary pixels (Martin, Fowlkes and Malik 2004; Csurka et al. 2013).

    Attributes
    ----------
    precision : float
        Share of the classes' boundary pixels within the tolerance of a boundary of the truth; 1 where there are none.
    recall : float
        Share of the truth's boundary pixels within the tolerance of a boundary of the classes; 1 where there are none.
    f : float
        Harmonic mean of the two, 0 where both are 0.
    """

    precision: float
    recall: float
    f: float


def default_tolerance_m(shape: tuple[int, int], pixel_m: tuple[float, float], *, referenced: bool) -> float:
    """Return 0.5 m, or one pixel where that is more; 0.75 % of the diagonal in pixels for an unreferenced image."""
    if not referenced:
        return DIAGONAL_SHARE * math.hypot(*shape)
    return max(DEFAULT_TOLERANCE_M, *pixel_m)


def reach_px(tolerance_m: float, pixel_m: tuple[float, float]) -> NDArray[np.int64]:
    """Return how many columns the tolerance spans at 0, 1, 2... rows away: an ellipse of pixels, one quadrant of it.

    Raises
    ------
    ArgumentError
        The tolerance is more than `MAX_REACH_PX` pixels: blocks and their halo would no longer fit in memory.
    """
    row_m, col_m = pixel_m
    most = MAX_REACH_PX * min(pixel_m)
    if tolerance_m > most:
        raise ArgumentError(
            f"--tolerance-m: {tolerance_m:g} is too large; it can be {most:.3g} ({MAX_REACH_PX} pixels)"
        )
    limit = tolerance_m * (1 + _SLACK)
    down = np.arange(math.floor(limit / row_m) + 1) * row_m
    return np.asarray(np.floor(np.sqrt(np.maximum(limit**2 - down**2, 0)) / col_m), np.int64)


def halo_px(reach: NDArray[np.int64]) -> int:
    """Return how far around a block `count_met` has to see: the tolerance, and a neighbour to tell a boundary."""
    return max(len(reach) - 1, int(reach[0])) + 1


def count_met(classes: Ids, truth: Ids, core: tuple[slice, slice], reach: NDArray[np.int64]) -> NDArray[np.int64]:
    """Count the boundary pixels of one block, and those that a boundary of the other raster meets.

    Both rasters are first cut to the pixels where both have a class, so that what one of them leaves out is no
    boundary of either.

    Parameters
    ----------
    classes, truth : uint8 [height, width]
        The block and its halo.
    core : (slice, slice)
        Where in it the block itself lies: only its pixels are counted.
    reach : int64 [rows]
        From `reach_px`.

    Returns
    -------
    int64 [4]
        Boundary pixels of the classes, those met, boundary pixels of the truth, those met.
    """
    void = (classes == NODATA) | (truth == NODATA)
    found = boundaries(np.where(void, NODATA, classes))
    true = boundaries(np.where(void, NODATA, truth))
    inside = np.zeros(void.shape, np.bool_)
    inside[core] = True
    counts = [
        count
        for ours, others in ((found, true), (true, found))
        for count in (int((ours & inside).sum()), _met(ours & inside, others, reach))
    ]
    return np.array(counts, np.int64)


def boundaries(ids: Ids) -> Mask:
    """Return where the class differs from that of the right or the lower neighbour; nodata has no boundary."""
    edge = np.zeros(ids.shape, np.bool_)
    some = ids != NODATA
    edge[:, :-1] |= (ids[:, :-1] != ids[:, 1:]) & some[:, :-1] & some[:, 1:]
    edge[:-1] |= (ids[:-1] != ids[1:]) & some[:-1] & some[1:]
    return edge


def boundary_score(counts: NDArray[np.int64]) -> BoundaryScore:
    """Return the scores of the counts of `count_met`, summed over the blocks."""
    found, found_met, true, true_met = (int(count) for count in counts)
    precision = found_met / found if found else 1.0
    recall = true_met / true if true else 1.0
    both = precision + recall
    return BoundaryScore(precision, recall, 2 * precision * recall / both if both else 0.0)


def _met(ours: Mask, others: Mask, reach: NDArray[np.int64]) -> int:
    """Count the pixels of `ours` that have one of `others` within reach.

    The Euclidean distance transform in two passes (Saito and Toriwaki 1994): along the rows everywhere, across them
    only for the pixels asked about. Both passes are of whole numbers, so blocks cannot differ in the last bit.
    """
    rows, cols = np.nonzero(ours)
    total = len(rows)
    if not (total and others.any()):
        return 0
    gap = _along_rows(others)
    for down, width in enumerate(reach):
        for step in (-down, down) if down else (0,):
            row = rows + step
            seen = (row >= 0) & (row < len(gap))
            far = ~seen | (gap[np.where(seen, row, 0), cols] > width)
            rows, cols = rows[far], cols[far]
    return total - len(rows)


def _along_rows(mask: Mask) -> NDArray[np.int32]:
    """Return the distance in columns to the next pixel of `mask` in the same row; far where there is none."""
    here = np.arange(mask.shape[1], dtype=np.int32)
    before = np.maximum.accumulate(np.where(mask, here, np.int32(-_FAR_PX)), axis=1)
    after = np.minimum.accumulate(np.where(mask, here, np.int32(_FAR_PX))[:, ::-1], axis=1)[:, ::-1]
    return np.asarray(np.minimum(here - before, after - here))
