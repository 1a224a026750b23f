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
_WHITE_SHARES = np.asarray(_LINEAR_TO_XYZ / _LINEAR_TO_XYZ.sum(axis=1, keepdims=True), np.float32)
_CIE_EPSILON = (6 / 29) ** 3
_LINE = 512
"""Values worked on at once."""
_POWER_08 = tuple(
    map(np.float32, (0.031431895, 1.3856672, -1.0283719, 1.2923286, -1.1181022, 0.55598485, -0.118940204))
)
"""v^0.8 for v in [0.3, 1], constant term first: least relative error of degree 6."""
_POWER_43 = tuple(
    map(np.float32, (-0.010440051, 0.46231762, 1.0352039, -0.9603127, 0.7607536, -0.36380473, 0.076283686))
)
"""w^(4/3) for w in [0.3, 1], likewise."""


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
    (top, left), (rows, cols) = origin, cells
    whole = bool(valid[top : top + rows * step_px, left : left + cols * step_px].all())
    sums = _cell_sums(planes, valid, whole, top, left, rows, cols, step_px)
    mean = sums[:3].astype(np.float32)
    mean /= np.maximum(sums[3], 1).astype(np.float32)
    return mean, sums[3].astype(np.float32) * np.float32(1 / step_px**2)


@njit(cache=True, nogil=True)
def _cell_sums(
    planes: U8, valid: NDArray[np.bool_], whole: bool, top: int, left: int, rows: int, cols: int, step_px: int
) -> NDArray[np.int32]:
    """Sum the valid pixels of cells (all of them where they are `whole`): red, green, blue and their number."""
    width = cols * step_px
    out = np.zeros((4, rows, cols), np.int32)
    # 32 rows of 255 are the most that a column of a cell adds up to.
    line = np.empty(width, np.uint16)
    for i in range(rows):
        first, last = top + i * step_px, top + (i + 1) * step_px
        for k in range(3):
            line[:] = 0
            for r in range(first, last):
                if whole:
                    _add(planes[k, r, left : left + width], line)
                else:
                    inside = valid[r, left : left + width].view(np.uint8)
                    _add_valid(planes[k, r, left : left + width], inside, line)
            _sum_groups(line, step_px, out[k, i])
        if whole:
            out[3, i] = step_px * step_px
        else:
            line[:] = 0
            for r in range(first, last):
                _add(valid[r, left : left + width].view(np.uint8), line)
            _sum_groups(line, step_px, out[3, i])
    return out


@njit(cache=True, nogil=True)
def _add(values: U8, line: NDArray[np.uint16]) -> None:
    for c in range(line.shape[0]):
        line[c] += values[c]


@njit(cache=True, nogil=True)
def _add_valid(values: U8, inside: U8, line: NDArray[np.uint16]) -> None:
    for c in range(line.shape[0]):
        line[c] += values[c] * inside[c]


@njit(cache=True, nogil=True)
def _sum_groups(line: NDArray[np.uint16], size: int, out: NDArray[np.int32]) -> None:
    for j in range(out.shape[0]):
        total = np.int32(0)
        for c in range(j * size, (j + 1) * size):
            total += np.int32(line[c])
        out[j] = total


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
    out = np.empty(rgb.shape, np.float32)
    flat = np.ascontiguousarray(rgb, np.float32).reshape(3, -1)
    _lab(flat, _WHITE_SHARES, out.reshape(3, -1))
    return out


@njit(cache=True, nogil=True, fastmath={"contract"})
def _lab(rgb: F32, shares: F32, out: F32) -> None:
    linear = np.empty((3, _LINE), np.float32)
    curves = np.empty((3, _LINE), np.float32)
    for begin in range(0, rgb.shape[1], _LINE):
        end = min(begin + _LINE, rgb.shape[1])
        for k in range(3):
            _linearise(rgb[k, begin:end], linear[k])
        for k in range(3):
            _curve(linear[0], linear[1], linear[2], shares[k, 0], shares[k, 2], curves[k])
        lightness, a, b = out[0, begin:end], out[1, begin:end], out[2, begin:end]
        x, y, z = curves[0], curves[1], curves[2]
        for c in range(lightness.shape[0]):
            lightness[c] = np.float32(116) * y[c] - np.float32(16)
            a[c] = np.float32(500) * (x[c] - y[c])
            b[c] = np.float32(200) * (y[c] - z[c])


@njit(cache=True, nogil=True, fastmath={"contract"})
def _linearise(values: F32, out: F32) -> None:
    """Turn sRGB in [0, 255] into linear light; u^2.4 as u² times a polynomial in √u that is √u^0.8 within 3e-6."""
    p0, p1, p2, p3, p4, p5, p6 = _POWER_08
    for c in range(values.shape[0]):
        scaled = values[c] * np.float32(1 / 255)
        u = (scaled + np.float32(0.055)) * np.float32(1 / 1.055)
        v = np.sqrt(u)
        power = p0 + v * (p1 + v * (p2 + v * (p3 + v * (p4 + v * (p5 + v * p6)))))
        out[c] = scaled * np.float32(1 / 12.92) if scaled <= np.float32(0.04045) else u * u * power


@njit(cache=True, nogil=True, fastmath={"contract"})
def _curve(red: F32, green: F32, blue: F32, red_share: np.float32, blue_share: np.float32, out: F32) -> None:
    """Take CIE's f of one of X, Y, Z over the white point; the cube root as a polynomial in t^¼, within 3e-6."""
    p0, p1, p2, p3, p4, p5, p6 = _POWER_43
    for c in range(out.shape[0]):
        # Written as differences, grey is neutral to the last bit.
        t = green[c] + red_share * (red[c] - green[c]) + blue_share * (blue[c] - green[c])
        t = t if t > np.float32(0) else np.float32(0)
        w = np.sqrt(np.sqrt(t))
        root = p0 + w * (p1 + w * (p2 + w * (p3 + w * (p4 + w * (p5 + w * p6)))))
        low = t * np.float32(841 / 108) + np.float32(4 / 29)
        out[c] = root if t > np.float32(_CIE_EPSILON) else low


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
