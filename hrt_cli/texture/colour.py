"""Colour of cells: mean sRGB, CIE Lab, and a hue histogram in which grey does not count."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

F32 = NDArray[np.float32]

HUE_BINS = 12
_HUE_FLOOR = 4.0
"""Chroma (Lab units) that a window must exceed before its hue histogram reaches half its full weight."""
_LUMA = (0.299, 0.587, 0.114)
_LINEAR_TO_XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)
_CIE_EPSILON = (6 / 29) ** 3


@njit(cache=True, nogil=True)
def cell_means(rgb: NDArray[np.uint8], valid: NDArray[np.bool_], step_px: int) -> tuple[F32, F32, F32]:
    """Average the valid pixels of every cell.

    Parameters
    ----------
    rgb : ndarray [rows, cols, 3] uint8
    valid : ndarray [rows, cols] bool
    step_px : int
        Cell side; divides rows and cols.

    Returns
    -------
    mean : ndarray [3, cell rows, cell cols] float32 in [0, 255]
        0 where no pixel is valid. Sums are of integers, so they are exact.
    share : ndarray [cell rows, cell cols] float32 in [0, 1]
        Share of valid pixels.
    luma : ndarray [rows, cols] float32 in [0, 255]
        Rec. 601 luma of every pixel.
    """
    rows, cols = valid.shape[0] // step_px, valid.shape[1] // step_px
    mean, share = np.zeros((3, rows, cols), np.float32), np.zeros((rows, cols), np.float32)
    luma = np.empty(valid.shape, np.float32)
    wr, wg, wb = np.float32(_LUMA[0]), np.float32(_LUMA[1]), np.float32(_LUMA[2])
    for r in range(valid.shape[0]):
        for c in range(valid.shape[1]):
            red, green, blue = rgb[r, c, 0], rgb[r, c, 1], rgb[r, c, 2]
            luma[r, c] = wr * np.float32(red) + wg * np.float32(green) + wb * np.float32(blue)
    for i in range(rows):
        for j in range(cols):
            count, red_sum, green_sum, blue_sum = 0, 0, 0, 0
            for r in range(i * step_px, (i + 1) * step_px):
                for c in range(j * step_px, (j + 1) * step_px):
                    if valid[r, c]:
                        count += 1
                        red_sum += rgb[r, c, 0]
                        green_sum += rgb[r, c, 1]
                        blue_sum += rgb[r, c, 2]
            if count:
                mean[0, i, j] = red_sum / count
                mean[1, i, j] = green_sum / count
                mean[2, i, j] = blue_sum / count
                share[i, j] = count / (step_px * step_px)
    return mean, share, luma


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
