"""Colour of cells: mean sRGB, CIE Lab, and a hue histogram in which grey does not count."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]

HUE_BINS = 12
_HUE_FLOOR = 4.0
"""Chroma (Lab units) that a window must exceed before its hue histogram reaches half its full weight."""
LUMA = (np.float32(0.299), np.float32(0.587), np.float32(0.114))
"""Rec. 601."""
_LINEAR_TO_XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)
_CIE_EPSILON = (6 / 29) ** 3


def cell_means(
    planes: U8, valid: NDArray[np.bool_], origin: tuple[int, int], cells: tuple[int, int], step_px: int
) -> tuple[F32, F32]:
    """Average the valid pixels of every cell.

    Parameters
    ----------
    planes : ndarray [3, rows, cols] uint8
        Red, green, blue.
    valid : ndarray [rows, cols] bool
    origin : (int, int)
        Pixel at which the first cell starts.
    cells : (int, int)
        Rows and columns of cells.
    step_px : int
        Cell side.

    Returns
    -------
    mean : ndarray [3, cell rows, cell cols] float32 in [0, 255]
        0 where no pixel is valid. Sums are of integers, so they are exact.
    share : ndarray [cell rows, cell cols] float32 in [0, 1]
        Share of valid pixels.
    """
    sums = _cell_sums(planes, valid, origin[0], origin[1], cells[0], cells[1], step_px)
    mean = sums[:3].astype(np.float32)
    mean /= np.maximum(sums[3], 1).astype(np.float32)
    return mean, sums[3].astype(np.float32) * np.float32(1 / step_px**2)


@njit(cache=True, nogil=True)
def _cell_sums(
    planes: U8, valid: NDArray[np.bool_], top: int, left: int, rows: int, cols: int, step_px: int
) -> NDArray[np.int32]:
    """Sum the valid pixels of cells: red, green, blue and their number."""
    width = cols * step_px
    out = np.zeros((4, rows, cols), np.int32)
    line = np.empty((4, width), np.int32)
    for i in range(rows):
        line[:] = 0
        for r in range(top + i * step_px, top + (i + 1) * step_px):
            mask = valid[r, left : left + width]
            red, green = planes[0, r, left : left + width], planes[1, r, left : left + width]
            blue = planes[2, r, left : left + width]
            for c in range(width):
                inside = np.int32(mask[c])
                line[0, c] += inside * np.int32(red[c])
                line[1, c] += inside * np.int32(green[c])
                line[2, c] += inside * np.int32(blue[c])
                line[3, c] += inside
        for k in range(4):
            for j in range(cols):
                for c in range(j * step_px, (j + 1) * step_px):
                    out[k, i, j] += line[k, c]
    return out


def luma(mean: F32) -> F32:
    """Return Rec. 601 luma of sRGB, float32 in the unit of `mean` [3, ...]."""
    value: F32 = LUMA[0] * mean[0] + LUMA[1] * mean[1] + LUMA[2] * mean[2]
    return value


def lab(rgb: F32) -> F32:
    """Convert sRGB to CIE Lab (IEC 61966-2-1; CIE 15, D65 white).

    Parameters
    ----------
    rgb : ndarray [3, ...] float32 in [0, 255]

    Returns
    -------
    ndarray [3, ...] float32
        L in [0, 100], a and b; equal channels give a = b = 0 exactly.
    """
    scaled = rgb * np.float32(1 / 255)
    linear = np.where(
        scaled <= np.float32(0.04045),
        scaled * np.float32(1 / 12.92),
        ((scaled + np.float32(0.055)) * np.float32(1 / 1.055)) ** np.float32(2.4),
    )
    red, green, blue = linear[0], linear[1], linear[2]
    curves = []
    for row in _LINEAR_TO_XYZ:
        # Rows are scaled to the white point; written as differences, grey is neutral to the last bit.
        weight = (row / row.sum()).astype(np.float32)
        curves.append(_cie_curve(green + weight[0] * (red - green) + weight[2] * (blue - green)))
    x, y, z = curves
    return np.stack([np.float32(116) * y - np.float32(16), np.float32(500) * (x - y), np.float32(200) * (y - z)])


def _cie_curve(t: F32) -> F32:
    low = t * np.float32(841 / 108) + np.float32(4 / 29)
    return np.where(t > np.float32(_CIE_EPSILON), np.cbrt(t), low)


def hue_votes(lab_cells: F32) -> F32:
    """Spread every cell's chroma over its two nearest hue bins.

    Parameters
    ----------
    lab_cells : ndarray [3, rows, cols] float32

    Returns
    -------
    ndarray [HUE_BINS, rows, cols] float32
        Chroma per bin; grey cells vote for nothing.
    """
    a, b = lab_cells[1], lab_cells[2]
    chroma = np.sqrt(a * a + b * b)
    position = (np.arctan2(b, a) * np.float32(0.5 / np.pi) + np.float32(0.5)) * np.float32(HUE_BINS)
    lower = np.floor(position).astype(np.int64)
    upper_share = position - lower.astype(np.float32)
    votes = np.zeros((HUE_BINS, *chroma.shape), np.float32)
    for bin_index in range(HUE_BINS):
        votes[bin_index] = np.where(lower % HUE_BINS == bin_index, chroma * (1 - upper_share), votes[bin_index])
        votes[bin_index] += np.where((lower + 1) % HUE_BINS == bin_index, chroma * upper_share, np.float32(0))
    return votes


def hue_histogram(smoothed_votes: F32) -> F32:
    """Return the square-rooted histogram of smoothed votes (Hellinger), faded where there is little chroma.

    Parameters
    ----------
    smoothed_votes : ndarray [HUE_BINS, rows, cols] float32
        `hue_votes`, averaged over a window.
    """
    total = np.float32(_HUE_FLOOR) * np.ones(smoothed_votes.shape[1:], np.float32)
    for one in smoothed_votes:
        total = total + one
    return np.sqrt(smoothed_votes / total)
