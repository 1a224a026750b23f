"""How steep and how rough the ground is: a plane through the heights of a surface model around a place."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hrt_cli.errors import InputError
from hrt_cli.raster.align import field_on, part_of, window_on
from hrt_cli.raster.gate import Raster
from hrt_cli.raster.grid import Grid
from hrt_cli.raster.heights import VOID, in_metres
from hrt_cli.raster.tiles import Tiles
from hrt_cli.raster.windows import Window

_CELL_M = 0.1
_HALF = 5
"""Cells on either side of the place: a window of 1.1 m, about a robot's length."""
_FEWEST = (2 * _HALF + 1) ** 2 // 2

_ALONG = np.arange(-_HALF, _HALF + 1) * _CELL_M
_PLANE = np.stack([*(a.ravel() for a in np.meshgrid(_ALONG, _ALONG, indexing="ij")), np.ones((2 * _HALF + 1) ** 2)], 1)


class Terrain:
    """Heights of a surface model around places on another raster.

    Parameters
    ----------
    dsm : Raster
        Of `open_heights`; of any resolution, extent and CRS.
    grid : Grid
        The raster that places are given on.
    """

    def __init__(self, dsm: Raster, grid: Grid) -> None:
        row_m, col_m = grid.pixel_m
        self._dsm = dsm
        self._cells_per_px = row_m / _CELL_M, col_m / _CELL_M
        step = type(grid.transform).scale(_CELL_M / col_m, _CELL_M / row_m)
        self._grid = Grid(grid.rows, grid.cols, grid.transform @ step, grid.crs)
        self._tiles = Tiles(self._load, side=128)
        self._fine = max(dsm.grid.pixel_m) < _CELL_M

    def at(self, row: float, col: float) -> tuple[float, float]:
        """Return slope in degrees and rugosity in metres at a position in pixels of the raster.

        The slope is that of the least-squares plane through the heights within half a metre, the rugosity the standard
        deviation of the heights about it. NaN where less than half of these are known.
        """
        i, j = int(np.floor(row * self._cells_per_px[0])), int(np.floor(col * self._cells_per_px[1]))
        side = 2 * _HALF + 1
        heights = self._tiles.patch(Window(i - _HALF, j - _HALF, side, side)).ravel().astype(np.float64)
        known = np.isfinite(heights)
        if known.sum() < _FEWEST:
            return math.nan, math.nan
        design, heights = _PLANE[known], heights[known]
        heights -= heights.mean()
        plane = np.linalg.lstsq(design, heights, rcond=None)[0]
        rugosity = float(np.std(heights - design @ plane))
        return math.degrees(math.atan(math.hypot(plane[0], plane[1]))), rugosity

    def _load(self, window: Window) -> NDArray[Any]:
        part = part_of(self._grid, window)
        try:
            window_on(self._dsm.path, self._dsm.grid, part)
        except InputError:
            return np.full((window.height, window.width), np.nan, np.float32)  # the model ends before it
        return in_metres(self._dsm, field_on(self._dsm, part, "average" if self._fine else "bilinear", void=VOID))
