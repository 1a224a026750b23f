"""Which classes lie under a robot: shares of the pixels of a disc on a class raster."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from hrt_cli.errors import ArgumentError
from hrt_cli.raster.grid import Grid
from hrt_cli.raster.tiles import Tiles
from hrt_cli.raster.windows import Window

NODATA = 255
Shares = dict[int, float]
"""Class id -> share of the ground that has a class; empty where none has."""

_MOST_PX = 2**24


class Footprints:
    """Discs on a class raster.

    Parameters
    ----------
    grid : Grid
        The class raster's geometry.
    read : callable
        Reads uint8 classes in a window inside it; 255 is nodata.
    """

    def __init__(self, grid: Grid, read: Callable[[Window], NDArray[np.uint8]]) -> None:
        self._grid, self._read = grid, read
        self._tiles = Tiles(self._load)

    def shares(self, row: float, col: float, radius_m: float) -> Shares:
        """Return the shares of the classes of the pixels whose centres lie in a disc of ground.

        A disc that holds no centre is the pixel that it lies in. Pixels without a class do not count.
        """
        counts = self._counts(row, col, radius_m)[0]
        return {int(k): float(counts[k] / counts.sum()) for k in np.flatnonzero(counts)}

    def covered(self, row: float, col: float, radius_m: float) -> float:
        """Return the share of a disc of ground that has a class."""
        counts, pixels = self._counts(row, col, radius_m)
        return float(counts.sum()) / max(pixels, 1)

    def _counts(self, row: float, col: float, radius_m: float) -> tuple[NDArray[np.int64], int]:
        """Return the pixels of each class in a disc, and how many there are, those off the raster included."""
        row_m, col_m = self._grid.pixel_m
        high, wide = radius_m / row_m, radius_m / col_m
        if 4 * high * wide > _MOST_PX:
            raise ArgumentError(f"a robot of radius {radius_m:g} m covers more than {_MOST_PX} pixels of the raster")
        top, left = int(np.floor(row - high)), int(np.floor(col - wide))
        window = Window(top, left, int(np.floor(row + high)) - top + 1, int(np.floor(col + wide)) - left + 1)
        inside = window.clipped(self._grid.shape)
        rows = (np.arange(window.row, window.row + window.height) + 0.5 - row) * row_m
        cols = (np.arange(window.col, window.col + window.width) + 0.5 - col) * col_m
        pixels = max(1, int((rows[:, None] ** 2 + cols[None, :] ** 2 <= radius_m**2).sum()))
        if not (inside.height and inside.width):
            return np.zeros(NODATA, np.int64), pixels
        along = (np.arange(inside.row, inside.row + inside.height) + 0.5 - row) * row_m
        across = (np.arange(inside.col, inside.col + inside.width) + 0.5 - col) * col_m
        disc = along[:, None] ** 2 + across[None, :] ** 2 <= radius_m**2
        values = self._tiles.patch(inside)
        found = values[disc] if disc.any() else self._pixel(row, col)
        return np.bincount(found, minlength=NODATA + 1)[:NODATA], pixels

    def _pixel(self, row: float, col: float) -> NDArray[np.uint8]:
        return self._tiles.patch(Window(int(np.floor(row)), int(np.floor(col)), 1, 1)).ravel()

    def _load(self, window: Window) -> NDArray[np.uint8]:
        out = np.full((window.height, window.width), NODATA, np.uint8)
        inside = window.clipped(self._grid.shape)
        if inside.height and inside.width:
            out[: inside.height, : inside.width] = self._read(inside)
        return out


def new_ahead(ahead: Shares, under: Shares) -> Shares:
    """Return what lies ahead of a robot and not under it, as shares; all that lies ahead where nothing is new."""
    new = {k: share - under.get(k, 0.0) for k, share in ahead.items() if share > under.get(k, 0.0)}
    total = sum(new.values())
    return {k: share / total for k, share in new.items()} if total > 0 else ahead
