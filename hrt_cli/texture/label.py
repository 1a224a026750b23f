"""From scores of cells to classes of pixels."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

NODATA = 255
"""What stands in a class raster where there is no class."""

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]


@njit(cache=True, nogil=True)
def cell_scores(values: F32, mean: F32, gain: F32, offset: F32) -> F32:
    """Return gain · (values − mean) + offset for every cell, summed channel by channel.

    Parameters
    ----------
    values : ndarray [channels, rows, cols] float32
    mean : ndarray [channels] float32
    gain : ndarray [classes, channels] float32
    offset : ndarray [classes] float32

    Returns
    -------
    ndarray [classes, rows, cols] float32
        The class of least score is the nearest.
    """
    channels, rows, cols = values.shape
    out = np.empty((gain.shape[0], rows, cols), np.float32)
    for k in range(gain.shape[0]):
        for r in range(rows):
            line = out[k, r]
            line[:] = offset[k]
            for channel in range(channels):
                source, weight, centre = values[channel, r], gain[k, channel], mean[channel]
                for c in range(cols):
                    line[c] += weight * (source[c] - centre)
    return out


@njit(cache=True, nogil=True)
def label(
    scores: F32, defined: NDArray[np.bool_], valid: NDArray[np.bool_], step_px: int, first_row: int, first_col: int
) -> tuple[U8, NDArray[np.int64]]:
    """Give every pixel the class of least score, scores interpolated bilinearly between cell centres.

    Where one class wins at all four corners it wins between them, for bilinear weights are a convex combination; and a
    class that another one beats at all four corners wins nowhere between them.

    Parameters
    ----------
    scores : ndarray [classes, rows, cols] float32
        At the cells' centres, reaching one cell at least beyond the pixels.
    defined : ndarray [rows, cols] bool
        Cells whose pixels may have a class.
    valid : ndarray [height, width] bool
        Pixels that may have a class.
    step_px : int
        Cell side.
    first_row, first_col : int
        Where pixel (0, 0) lies, in pixels from the upper left corner of cell (0, 0).

    Returns
    -------
    classes : ndarray [height, width] uint8
        `NODATA` where there is no class.
    counts : ndarray [256] int64
        How often each value stands there.
    """
    kinds, rows, cols = scores.shape
    height, width = valid.shape
    classes = np.empty((height, width), np.uint8)
    best = _best(scores)
    rivals = np.empty(kinds, np.int64)
    begin, rise = np.empty(kinds, np.float32), np.empty(kinds, np.float32)
    parts = ((np.arange(step_px) + 0.5) / step_px).astype(np.float32)
    half = step_px // 2
    for r in range(rows - 1):
        top = max(r * step_px + half - first_row, 0)
        bottom = min((r + 1) * step_px + half - first_row, height)
        if bottom <= top:
            continue
        c = 0
        while c < cols - 1:
            left = max(c * step_px + half - first_col, 0)
            one = best[r, c]
            run = c
            while (
                run < cols - 1 and best[r, run + 1] == one and best[r + 1, run] == one and best[r + 1, run + 1] == one
            ):
                run += 1
            if run > c:
                # All corners agree from here to there: long lines are filled at once.
                right = min(run * step_px + half - first_col, width)
                for y in range(top, bottom):
                    classes[y, left:right] = one
                c = run
                continue
            right = min((c + 1) * step_px + half - first_col, width)
            corners = scores[:, r : r + 2, c : c + 2]
            count = _rivals(corners, best[r : r + 2, c : c + 2], rivals)
            for y in range(top, bottom):
                part_r = parts[first_row + y - half - r * step_px]
                for i in range(count):
                    k = rivals[i]
                    begin[i] = corners[k, 0, 0] + part_r * (corners[k, 1, 0] - corners[k, 0, 0])
                    rise[i] = corners[k, 0, 1] + part_r * (corners[k, 1, 1] - corners[k, 0, 1]) - begin[i]
                for x in range(left, right):
                    part_c = parts[first_col + x - half - c * step_px]
                    nearest, least = 0, begin[0] + part_c * rise[0]
                    for i in range(1, count):
                        score = begin[i] + part_c * rise[i]
                        if score < least:
                            nearest, least = i, score
                    classes[y, x] = rivals[nearest]
            c += 1
    _blank(classes, defined, valid, step_px, first_row, first_col)
    return classes, _count(classes)


@njit(cache=True, nogil=True)
def _best(scores: F32) -> U8:
    kinds, rows, cols = scores.shape
    best = np.zeros((rows, cols), np.uint8)
    for r in range(rows):
        for c in range(cols):
            for k in range(1, kinds):
                if scores[k, r, c] < scores[best[r, c], r, c]:
                    best[r, c] = k
    return best


@njit(cache=True, nogil=True)
def _rivals(corners: F32, best: U8, rivals: NDArray[np.int64]) -> int:
    """Write the classes that no corner's best beats at all four corners, ascending; return how many."""
    count = 0
    for k in range(corners.shape[0]):
        beaten = False
        for i in range(4):
            other = best[i // 2, i % 2]
            beaten |= (
                corners[other, 0, 0] < corners[k, 0, 0]
                and corners[other, 0, 1] < corners[k, 0, 1]
                and corners[other, 1, 0] < corners[k, 1, 0]
                and corners[other, 1, 1] < corners[k, 1, 1]
            )
        if not beaten:
            rivals[count] = k
            count += 1
    return count


@njit(cache=True, nogil=True)
def _blank(
    classes: U8, defined: NDArray[np.bool_], valid: NDArray[np.bool_], step_px: int, first_row: int, first_col: int
) -> None:
    height, width = classes.shape
    for y in range(height):
        line, inside = classes[y], valid[y]
        for x in range(width):
            line[x] = line[x] if inside[x] else np.uint8(NODATA)
    for r in range(defined.shape[0]):
        for c in range(defined.shape[1]):
            if not defined[r, c]:
                for y in range(max(r * step_px - first_row, 0), min((r + 1) * step_px - first_row, height)):
                    for x in range(max(c * step_px - first_col, 0), min((c + 1) * step_px - first_col, width)):
                        classes[y, x] = NODATA


@njit(cache=True, nogil=True)
def _count(classes: U8) -> NDArray[np.int64]:
    counts = np.zeros(256, np.int64)
    flat = classes.reshape(classes.size)
    whole = classes.size // 8
    # Neighbours are mostly alike: eight at once.
    for eight in flat[: 8 * whole].view(np.uint64):
        value = eight & np.uint64(255)
        if eight == value * np.uint64(0x0101010101010101):
            counts[value] += 8
        else:
            for k in range(8):
                counts[(eight >> np.uint64(8 * k)) & np.uint64(255)] += 1
    for one in flat[8 * whole :]:
        counts[one] += 1
    return counts
