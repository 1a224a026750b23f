"""From class pixels to grid cells: how much of each cell each class covers, and what score that makes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from hrt_cli.artifacts.scores import ClassScore
from hrt_cli.errors import ArgumentError
from hrt_cli.progress import Progress, silent
from hrt_cli.raster.grid import Grid
from hrt_cli.raster.scoremap import MAX_CELLS
from hrt_cli.raster.windows import Window

NODATA = 255
MIN_COVERED = 0.5
"""Share of a cell that must have a class for the cell to be entered: most of it was seen."""

# Rows are read in bands that fit in little memory however wide the raster is.
_BAND_ROWS = 512
_BAND_PX = 2**24

# Classes that all score just the limit make a cell that does: the last bits of the mean must not say otherwise.
_ROUNDING = 1e-9
_MAX_COUNTS = 2**28
"""Counters held at once: 1 GB."""

ReadClasses = Callable[[Window], NDArray[np.uint8]]


@dataclass(frozen=True)
class Cover:
    """How many pixels of each class lie in each cell.

    Attributes
    ----------
    counts : int32 [class, rows, cols]
        Pixels of each class whose centre lies in the cell.
    pixels_per_cell : float
        Pixels of a whole cell.
    grid : Grid
        The cells.
    """

    counts: NDArray[np.int32]
    pixels_per_cell: float
    grid: Grid

    @property
    def classes(self) -> list[int]:
        """Ids of the classes that occur."""
        return [int(k) for k in np.flatnonzero(self.counts.any(axis=(1, 2)))]

    @property
    def seen(self) -> NDArray[np.bool_]:
        """Cells [rows, cols] of which enough has a class for them to be entered."""
        return np.asarray(self.counts.sum(axis=0, dtype=np.int64) >= MIN_COVERED * self.pixels_per_cell)


def cover(fine: Grid, read: ReadClasses, cell_m: float, progress: Progress = silent) -> Cover:
    """Count class pixels per cell in one pass over the rows of a class raster.

    Parameters
    ----------
    fine : Grid
        The class raster's geometry.
    read : callable
        Reads uint8 classes in a window; 255 is nodata.
    cell_m : float
        Side of a cell in metres on the ground.

    Raises
    ------
    ArgumentError
        A cell would be smaller than a pixel, or there would be too many cells.
    """
    row_m, col_m = fine.pixel_m
    if cell_m < max(row_m, col_m) * (1 - 1e-6):
        raise ArgumentError(f"a cell of {cell_m:g} m is smaller than a pixel of {max(row_m, col_m):.3g} m")
    grid = fine.coarse(cell_m)
    if grid.rows * grid.cols > MAX_CELLS:
        raise ArgumentError(f"a cell of {cell_m:g} m makes {grid.rows} x {grid.cols} cells; use larger ones")
    step_row, step_col = cell_m / row_m, cell_m / col_m
    cell_of_col = _cells_of(0, fine.cols, step_col, grid.cols)
    counts = np.zeros((0, grid.rows, grid.cols), np.int32)
    band_rows = max(1, min(_BAND_ROWS, _BAND_PX // fine.cols))
    for top in range(0, fine.rows, band_rows):
        height = min(band_rows, fine.rows - top)
        classes = read(Window(top, 0, height, fine.cols))
        cell_of_row = _cells_of(top, height, step_row, grid.rows)
        if cell_of_row.size:
            counts = _add(counts, classes[: cell_of_row.size, : cell_of_col.size], cell_of_row, cell_of_col, grid)
        progress(top + height, fine.rows)
    return Cover(counts, step_row * step_col, grid)


@dataclass(frozen=True)
class Rule:
    """How classes become the score of a cell: what `score_cells` takes beside them and the ground's relief."""

    explore: float = 0.0
    no_go_below: float | None = None
    no_go_share: float = 1.0
    margin_m: float = 0.0


def score_cells(
    covered: Cover,
    scores: dict[int, ClassScore],
    explore: float = 0.0,
    no_go_below: float | None = None,
    no_go_share: float = 1.0,
    margin_m: float = 0.0,
    ease: NDArray[np.float64] | None = None,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the expected score of each cell and its standard deviation.

    The score of a cell is the mean of its classes' expected scores weighted by the ground they cover; with
    independent posteriors its variance is the sum of (share^2 x variance). `explore` B adds B standard deviations
    to the score (upper confidence bound: Auer 2002), so that what is not known draws the robot. `ease` [rows, cols],
    0 to 1, is by what the ground's relief lets it count: expected score and deviation are multiplied by it.

    Returns
    -------
    score, sd : float32 [rows, cols]
        NaN where less than half of the cell has a class; where `ease` is 0; where the expected score (before
        exploration) is below `no_go_below`; where classes whose expected score is cover more than `no_go_share` of the
        cell; or where the centre of such a cell is at most `margin_m` away.
    """
    total = covered.counts.sum(axis=0, dtype=np.int64)
    score = np.zeros(covered.grid.shape)
    variance = np.zeros(covered.grid.shape)
    barred = np.zeros(covered.grid.shape)
    for index in covered.classes:
        share = covered.counts[index] / np.maximum(total, 1)
        score += share * scores[index].mean
        variance += (share * scores[index].sd) ** 2
        if no_go_below is not None and scores[index].mean < no_go_below:
            barred += share
    no_go = ~covered.seen
    if ease is not None:
        score *= ease
        variance *= ease * ease
        no_go |= ease <= 0.0
    if no_go_below is not None:
        poor = (score < no_go_below - _ROUNDING) | (barred > no_go_share + _ROUNDING)
        no_go |= _within(poor & ~no_go, margin_m / math.sqrt(math.prod(covered.grid.pixel_m)))
    sd = np.sqrt(variance)
    score = score + explore * sd
    score[no_go] = np.nan
    sd[no_go] = np.nan
    return score.astype(np.float32), sd.astype(np.float32)


def _within(cells: NDArray[np.bool_], reach: float) -> NDArray[np.bool_]:
    """Return the cells that are at most `reach` cells, centre to centre, from those given."""
    if reach < 1.0 - _ROUNDING or not cells.any():
        return cells
    away = ndimage.distance_transform_edt(~cells)
    return np.asarray(away <= reach + _ROUNDING)


def _cells_of(first: int, count: int, step: float, cells: int) -> NDArray[np.int64]:
    """Return the cell of each of `count` pixels from `first` on; pixels beyond the last cell are left out."""
    found = ((np.arange(first, first + count) + 0.5) / step).astype(np.int64)
    return found[found < cells]


def _add(
    counts: NDArray[np.int32],
    classes: NDArray[np.uint8],
    cell_of_row: NDArray[np.int64],
    cell_of_col: NDArray[np.int64],
    grid: Grid,
) -> NDArray[np.int32]:
    present = np.flatnonzero(np.bincount(classes.ravel(), minlength=NODATA + 1)[:NODATA])
    if present.size and present[-1] >= len(counts):
        if (present[-1] + 1) * grid.rows * grid.cols > _MAX_COUNTS:
            raise ArgumentError(
                f"{grid.rows} x {grid.cols} cells are too many for {present[-1] + 1} classes; use larger"
            )
        counts = np.concatenate([counts, np.zeros((present[-1] + 1 - len(counts), *grid.shape), np.int32)])
    first = int(cell_of_row[0])
    span = int(cell_of_row[-1]) - first + 1
    # One histogram of (class, cell row, cell column) for the whole band of rows.
    cell = (cell_of_row - first)[:, None] * grid.cols + cell_of_col[None, :]
    valid = classes != NODATA
    key = classes[valid].astype(np.int64) * (span * grid.cols) + cell[valid]
    found = np.bincount(key, minlength=len(counts) * span * grid.cols)
    counts[:, first : first + span] += found.reshape(len(counts), span, grid.cols).astype(np.int32)
    return counts
