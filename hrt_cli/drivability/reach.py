"""From where what is of interest can be sampled, by a sensor that reaches beyond the cell that the robot is in.

A cell pays once, but if every cell within the sensor's radius of a hot one paid as much, a planner would collect the
whole disc and miss other spots. So each hot spot pays at one station, with little about it.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

ABOUT_SHARE = 0.1
"""What all cells about a station pay together, as a share of what the station does: lingering does not pay."""

_ROUNDING = 1e-9
_HALF_DIAGONAL = math.sqrt(0.5)

kernel: Any = njit(cache=True, nogil=True)
"""One hot cell after the other, as each depends on those before it."""


def interest_at_stations(values: NDArray[np.floating], share: Floats, go: Mask, radius: float) -> tuple[Floats, int]:
    """Return how much each cell is worth a visit if what lies within a radius of it is sampled from it.

    Hot cells (interest above 0) are taken from the hottest on. One that no station reaches yet (a cell hotter than its
    neighbours, which hides a peak somewhere in it: reaches all of it) makes the cell that may
    be entered nearest to it, itself if it may be, a station with its interest, and other cells within the radius of the
    hot cell worth less: falling linearly with the distance to 0 at the radius, all of a disc together `ABOUT_SHARE`.
    What several give a cell does not add up: the most counts. Ground of the largest region (4-neighbours) has stations
    of its own, so has the rest: a robot gets from one to the other by no way.

    Parameters
    ----------
    values : [rows, cols]
        By which cells are hotter; NaN where there is no data. Of equal ones the first, row by row, comes first.
    share : float64 [rows, cols]
        Their interest, 0 to 1, not falling with the value.
    go : bool [rows, cols]
        Cells that may be entered.
    radius : float
        In cells, from middle to middle.

    Returns
    -------
    share : float64 [rows, cols]
        0 where no robot may go.
    out_of_reach : int
        Spots (hot cells and their hot 8-neighbours) of which no cell lies within the radius of one to go.
    """
    out = np.zeros(go.shape)
    reached = np.zeros(go.shape, np.bool_)
    peak = values >= ndimage.maximum_filter(np.where(share > 0, values, -np.inf), size=3)
    for region in _regions(go):
        away, nearest = ndimage.distance_transform_edt(~region, return_indices=True)
        hot = (share > 0) & (away <= radius + _ROUNDING)
        if hot.any():
            reached |= hot
            _set_stations(out, np.where(hot, values, np.nan), share, peak, nearest, region, radius)
    spots, count = ndimage.label(share > 0, structure=np.ones((3, 3)))
    return out, count - np.unique(spots[reached]).size


def _regions(go: Mask) -> list[Mask]:
    labels, count = ndimage.label(go)
    if count < 2:
        return [go] * count
    largest = labels == 1 + int(np.argmax(np.bincount(labels.ravel())[1:]))
    return [largest, go & ~largest]


def _set_stations(
    out: Floats,
    values: NDArray[np.floating],
    share: Floats,
    peak: Mask,
    nearest: NDArray[np.int32],
    region: Mask,
    radius: float,
) -> None:
    """Put what the stations of one region are worth into `out`; hot are the cells whose value is not NaN."""
    flat = np.flatnonzero(~np.isnan(values))
    hot = flat[np.argsort(-values.ravel()[flat].astype(np.float64), kind="stable")]
    at = np.ravel_multi_index((nearest[0].ravel()[hot], nearest[1].ravel()[hot]), region.shape)
    side = math.floor(radius + _ROUNDING)
    offsets = np.hypot(*np.ogrid[-side : side + 1, -side : side + 1])
    disc = offsets <= radius + _ROUNDING
    whole = offsets <= radius - _HALF_DIAGONAL + _ROUNDING
    chosen = stations_of(hot, at, peak.ravel()[hot], np.argwhere(disc) - side, whole[disc], *region.shape)
    _paint_about(out, hot[chosen], share.ravel()[hot[chosen]], offsets, disc, region, radius)
    np.maximum.at(out.ravel(), at[chosen], share.ravel()[hot[chosen]])


@kernel
def stations_of(
    hot: NDArray[np.intp],
    at: NDArray[np.intp],
    peak: NDArray[np.bool_],
    disc: NDArray[np.intp],
    whole: NDArray[np.bool_],
    rows: int,
    cols: int,
) -> NDArray[np.bool_]:
    """Return which hot cells are given a station: those that no station before them reaches.

    Parameters
    ----------
    hot, at : int [n]
        Flat indices of the hot cells in their order, and of the cells from where each would be sampled.
    peak : bool [n]
        Those of which all has to be reached.
    disc : int [m, 2]
        Rows and columns of the cells within reach, from the middle one.
    whole : bool [m]
        Those of which all is.
    rows, cols : int
        Size of the map.
    """
    reached = np.zeros(rows * cols, np.uint8)
    chosen = np.zeros(hot.size, np.bool_)
    for n in range(hot.size):
        if reached[hot[n]] > peak[n]:
            continue
        chosen[n] = True
        row, col = at[n] // cols, at[n] % cols
        for m in range(disc.shape[0]):
            i, j = row + disc[m, 0], col + disc[m, 1]
            if 0 <= i < rows and 0 <= j < cols:
                reached[i * cols + j] = max(reached[i * cols + j], 1 + whole[m])
    return chosen


def _paint_about(
    out: Floats,
    hot: NDArray[np.intp],
    worth: Floats,
    offsets: Floats,
    disc: Mask,
    region: Mask,
    radius: float,
) -> None:
    """Make the cells of `region` about hot cells (flat indices) worth their share, by one offset after the other."""
    fall = np.where(disc & (offsets > 0), 1.0 - offsets / max(radius, 1.0), 0.0).clip(0.0)
    if fall.sum() <= _ROUNDING:
        return
    fall *= ABOUT_SHARE / fall.sum()
    side = offsets.shape[0] // 2
    row, col = np.divmod(hot, region.shape[1])
    for i, j in np.argwhere(fall > 0):
        to_row, to_col = row + i - side, col + j - side
        there = (to_row >= 0) & (to_row < region.shape[0]) & (to_col >= 0) & (to_col < region.shape[1])
        there[there] = region[to_row[there], to_col[there]]
        onto = to_row[there], to_col[there]
        # Hot cells are distinct, so are the cells at one offset from them.
        out[onto] = np.maximum(out[onto], worth[there] * fall[i, j])
