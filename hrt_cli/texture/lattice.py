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
    total = _convolve(weights, row_taps, col_taps)
    out = np.empty((values.shape[0], *total.shape), np.float32)
    for channel in range(values.shape[0]):
        _smooth_channel(values[channel], weights, total, row_taps, col_taps, out[channel])
    return out, total


@njit(cache=True, nogil=True)
def _fold(acc: F32, upper: F32, lower: F32, tap: np.float32) -> None:
    for x in range(acc.shape[0]):
        acc[x] += tap * (upper[x] + lower[x])


@njit(cache=True, nogil=True)
def _convolve(image: F32, row_taps: F32, col_taps: F32) -> F32:
    """Convolve with a symmetric separable kernel; the result is smaller by the reach on each side."""
    reach_r, reach_c = row_taps.shape[0] - 1, col_taps.shape[0] - 1
    rows, cols = image.shape[0] - 2 * reach_r, image.shape[1] - 2 * reach_c
    out = np.empty((rows, cols), np.float32)
    line = np.empty(image.shape[1], np.float32)
    for r in range(rows):
        line[:] = row_taps[0] * image[r + reach_r]
        for t in range(1, reach_r + 1):
            _fold(line, image[r + reach_r - t], image[r + reach_r + t], row_taps[t])
        out[r] = col_taps[0] * line[reach_c : reach_c + cols]
        for t in range(1, reach_c + 1):
            _fold(out[r], line[reach_c - t :][:cols], line[reach_c + t :][:cols], col_taps[t])
    return out


@njit(cache=True, nogil=True)
def _smooth_channel(values: F32, weights: F32, total: F32, row_taps: F32, col_taps: F32, out: F32) -> None:
    weighted = np.empty(values.shape, np.float32)
    for r in range(values.shape[0]):
        for c in range(values.shape[1]):
            weighted[r, c] = values[r, c] * weights[r, c]
    summed = _convolve(weighted, row_taps, col_taps)
    for r in range(out.shape[0]):
        for c in range(out.shape[1]):
            out[r, c] = summed[r, c] / total[r, c] if total[r, c] > 0 else np.float32(0)
