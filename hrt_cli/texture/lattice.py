"""The lattice of square cells on which texture is measured, and smoothing on it.

Cells are `step_px` pixels a side and are fixed to the raster's anchor, so a cell holds the same pixels
whatever block, crop or tile it is computed from. Everything downstream is defined per cell; this is what makes
the classes independent of how the raster is cut.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from hrt_cli.raster.windows import Window

GAUSSIAN_REACH = 2.5
"""Gaussian windows are cut at this many standard deviations."""

F32 = NDArray[np.float32]


@dataclass(frozen=True)
class CellGrid:
    """A rectangle of cells.

    Parameters
    ----------
    step_px : int
        Side of a cell in pixels.
    row, col : int
        Upper left cell, counted on the lattice fixed to the anchor.
    rows, cols : int
        Number of cells along each axis.
    """

    step_px: int
    row: int
    col: int
    rows: int
    cols: int

    @classmethod
    def covering(cls, window: Window, anchor: tuple[int, int], step_px: int) -> CellGrid:
        """Return the smallest grid whose cells cover `window`."""
        top, left = window.row + anchor[0], window.col + anchor[1]
        row, col = top // step_px, left // step_px
        bottom = -((-top - window.height) // step_px)
        right = -((-left - window.width) // step_px)
        return cls(step_px, row, col, bottom - row, right - col)

    def grown(self, rows: int, cols: int) -> CellGrid:
        """Return the grid with `rows` and `cols` cells more on each side."""
        return CellGrid(self.step_px, self.row - rows, self.col - cols, self.rows + 2 * rows, self.cols + 2 * cols)

    def window(self, anchor: tuple[int, int]) -> Window:
        """Return the pixels of the grid, as a window of the raster with this anchor."""
        step = self.step_px
        return Window(self.row * step - anchor[0], self.col * step - anchor[1], self.rows * step, self.cols * step)


def gaussian_taps(sigma: float) -> F32:
    """Return one side of a Gaussian, centre first, so that centre + 2 × the rest is 1.

    Parameters
    ----------
    sigma : float
        Standard deviation in samples, >= 0; 0 gives the identity.
    """
    reach = int(np.ceil(GAUSSIAN_REACH * sigma))
    if reach == 0:
        return np.ones(1, np.float32)
    taps = np.exp(-0.5 * (np.arange(reach + 1) / sigma) ** 2)
    normalised: F32 = (taps / (taps[0] + 2 * taps[1:].sum())).astype(np.float32)
    return normalised


def smooth(values: F32, weights: F32, row_taps: F32, col_taps: F32) -> tuple[F32, F32]:
    """Average cells over a Gaussian window, counting each with its weight (normalised convolution).

    Knutsson and Westin 1993. Cells of weight zero contribute nothing.

    Parameters
    ----------
    values : ndarray [channels, rows, cols] float32
    weights : ndarray [rows, cols] float32 in [0, 1]
    row_taps, col_taps : ndarray float32
        From `gaussian_taps`, for the two axes.

    Returns
    -------
    smoothed : ndarray [channels, rows − 2·reach, cols − 2·reach] float32
        0 where no cell in reach has weight.
    weight : ndarray [rows − 2·reach, cols − 2·reach] float32 in [0, 1]
        The share of the window that has data.
    """
    rows, cols = (n - 2 * (len(taps) - 1) for n, taps in zip(weights.shape, (row_taps, col_taps), strict=True))
    out, total = np.empty((len(values), rows, cols), np.float32), np.empty((rows, cols), np.float32)
    _smooth(values, weights, row_taps, col_taps, out, total)
    return out, total


@njit(cache=True, nogil=True, error_model="numpy")
def _smooth(values: F32, weights: F32, row_taps: F32, col_taps: F32, out: F32, total: F32) -> None:
    _convolve(weights, row_taps, col_taps, total)
    weighted = np.empty(weights.shape, np.float32)
    for channel in range(values.shape[0]):
        for r in range(weights.shape[0]):
            _multiply(values[channel, r], weights[r], weighted[r])
        _convolve(weighted, row_taps, col_taps, out[channel])
        for r in range(total.shape[0]):
            _divide(total[r], out[channel, r])


@njit(cache=True, nogil=True)
def _convolve(image: F32, row_taps: F32, col_taps: F32, out: F32) -> None:
    """Convolve with a symmetric separable kernel; the result is smaller by the reach on each side."""
    reach_r, reach_c = row_taps.shape[0] - 1, col_taps.shape[0] - 1
    line = np.empty(image.shape[1], np.float32)
    for r in range(out.shape[0]):
        _scale(image[r + reach_r], row_taps[0], line)
        for t in range(1, reach_r, 2):
            _fold_two(
                line, image[r + reach_r - t], image[r + reach_r + t], image[r + reach_r - t - 1],
                image[r + reach_r + t + 1], row_taps[t], row_taps[t + 1],
            )  # fmt: skip
        if reach_r % 2:
            _fold(line, image[r], image[r + 2 * reach_r], row_taps[reach_r])
        found = out[r]
        _scale(line[reach_c:], col_taps[0], found)
        for t in range(1, reach_c, 2):
            _fold_two(
                found, line[reach_c - t :], line[reach_c + t :], line[reach_c - t - 1 :], line[reach_c + t + 1 :],
                col_taps[t], col_taps[t + 1],
            )  # fmt: skip
        if reach_c % 2:
            _fold(found, line, line[2 * reach_c :], col_taps[reach_c])


# Plain loops over lines: an expression of whole lines would make new arrays.
@njit(cache=True, nogil=True)
def _multiply(left: F32, right: F32, out: F32) -> None:
    for x in range(out.shape[0]):
        out[x] = left[x] * right[x]


@njit(cache=True, nogil=True, error_model="numpy")
def _divide(total: F32, out: F32) -> None:
    for x in range(out.shape[0]):
        quotient = out[x] / total[x]
        out[x] = quotient if total[x] > np.float32(0) else np.float32(0)


@njit(cache=True, nogil=True)
def _scale(values: F32, tap: np.float32, out: F32) -> None:
    for x in range(out.shape[0]):
        out[x] = tap * values[x]


@njit(cache=True, nogil=True)
def _fold(acc: F32, a: F32, b: F32, tap: np.float32) -> None:
    for x in range(acc.shape[0]):
        acc[x] += tap * (a[x] + b[x])


@njit(cache=True, nogil=True)
def _fold_two(acc: F32, a: F32, b: F32, c: F32, d: F32, first: np.float32, second: np.float32) -> None:
    for x in range(acc.shape[0]):
        acc[x] += first * (a[x] + b[x]) + second * (c[x] + d[x])
