"""Small patches anywhere in a raster, read tile by tile: memory does not grow with the raster nor with the number."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hrt_cli.raster.windows import Window


class Tiles:
    """The tiles that were read last.

    Parameters
    ----------
    load : callable
        Returns the values [height, width] of a window, which may reach outside the raster.
    side : int
        Side of a tile in pixels.
    keep : int
        Most tiles held at once.
    """

    def __init__(self, load: Callable[[Window], NDArray[Any]], side: int = 256, keep: int = 64) -> None:
        self._load, self._side, self._keep = load, side, keep
        self._held: OrderedDict[tuple[int, int], NDArray[Any]] = OrderedDict()

    def patch(self, window: Window) -> NDArray[Any]:
        """Return the values [height, width] of a window that is not empty."""
        side, bottom, right = self._side, window.row + window.height, window.col + window.width
        bands = []
        for i in range(window.row // side, (bottom - 1) // side + 1):
            rows = slice(max(window.row - i * side, 0), bottom - i * side)
            parts = [
                self._tile(i, j)[rows, max(window.col - j * side, 0) : right - j * side]
                for j in range(window.col // side, (right - 1) // side + 1)
            ]
            bands.append(parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1))
        return bands[0] if len(bands) == 1 else np.concatenate(bands)

    def _tile(self, i: int, j: int) -> NDArray[Any]:
        if (i, j) in self._held:
            self._held.move_to_end((i, j))
        else:
            while len(self._held) >= self._keep:
                self._held.popitem(last=False)
            self._held[i, j] = self._load(Window(i * self._side, j * self._side, self._side, self._side))
        return self._held[i, j]
