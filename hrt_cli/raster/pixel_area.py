"""An area in pixels of a grid: which pixels have their centre in it, which touch it, which lie wholly in it.

Whether a centre lies inside is decided by counting, pixel row by pixel row, the edges left of it (even-odd rule: Foley,
van Dam, Feiner, Hughes, Computer Graphics, 1990, section 3.6), with every crossing computed in coordinates of the whole
grid: a pixel's answer does not depend on the window it is asked for in, which a rasteriser that works in the window's
own coordinates does not promise.

Whether a whole pixel does is decided by the edges that come near it. An edge grown by a reach is a capsule, which is
convex: in each row of pixels it covers one interval of columns, and meets those pixels that the interval meets. A pixel
that no edge comes near lies wholly inside or wholly outside, as its centre does.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hrt_cli.raster.grid import Floats, Grid
from hrt_cli.raster.windows import Window

BEND_PX = 0.01
"""How far, in pixels along either axis, an edge may lie from where the file's straight line would come to."""
TOUCH_PX = 2 * BEND_PX
"""What comes so near a pixel is taken to touch it: more than bends along both axes, and rounding, can hide."""
_PAIRS = 2**18
"""Pairs of an edge and a row that are worked on at once."""


@dataclass(frozen=True)
class PixelArea:
    """An area in pixels of a grid.

    Attributes
    ----------
    grid : Grid
    edges : float64 [n, 4]
        Row and column of each edge's upper end, then of its lower.
    """

    grid: Grid
    edges: Floats

    @classmethod
    def of_rings(cls, grid: Grid, rings: list[Floats]) -> PixelArea:
        """Return the area within closed rings [n, 2] of (row, col)."""
        legs = [np.concatenate([ring[:-1], ring[1:]], axis=1) for ring in rings]
        edges = np.concatenate(legs) if legs else np.zeros((0, 4))
        downward = edges[:, 0] <= edges[:, 2]
        return cls(grid, np.asarray(np.where(downward[:, None], edges, edges[:, [2, 3, 0, 1]])))

    @cached_property
    def bounds(self) -> Window:
        """The smallest window of whole pixels on the grid that holds the area; empty where the area misses it."""
        if not len(self.edges):
            return Window(0, 0, 0, 0)
        rows, cols = self.edges[:, 0::2], self.edges[:, 1::2]
        top, left = math.floor(rows.min()), math.floor(cols.min())
        return Window(top, left, math.ceil(rows.max()) - top, math.ceil(cols.max()) - left).clipped(self.grid.shape)

    @property
    def misses_grid(self) -> bool:
        """Whether no part of the area lies on the grid, as far as its bounds tell."""
        return not (self.bounds.height and self.bounds.width)

    def mask(self, window: Window) -> NDArray[np.bool_]:
        """Return where pixel centres lie in the area [height, width]; the window may reach outside the grid."""
        # An edge crosses the rows whose centre lies at or below its upper end and above its lower end.
        first = np.maximum(np.ceil(self.edges[:, 0] - 0.5), window.row).astype(np.int64)
        last = np.minimum(np.ceil(self.edges[:, 2] - 0.5), window.row + window.height).astype(np.int64)
        odd = np.zeros((window.height, window.width + 1), np.bool_)
        for edge, row in _rows_of(first, last):
            row0, col0, row1, col1 = self.edges[edge].T
            crossing = col0 + (row + 0.5 - row0) / (row1 - row0) * (col1 - col0)
            # The parity changes at the first pixel whose centre lies at or right of the crossing.
            change = np.clip(np.ceil(crossing - 0.5), window.col, window.col + window.width).astype(np.int64)
            np.logical_xor.at(odd, (row - window.row, change - window.col), True)
        return np.asarray(np.logical_xor.accumulate(odd[:, :-1], axis=1))

    def touched(self, reach_px: float = 0.0) -> NDArray[np.bool_]:
        """Return which pixels of the grid [rows, cols] the area touches, or comes within a reach of.

        A pixel is its closed square: a corner or an edge in common counts, and so does an area far smaller than the
        pixel. What is left out is truly clear of the area; of what comes within `TOUCH_PX` some may be clear too.
        """
        return self._near_an_edge(reach_px) | self.mask(Window(0, 0, *self.grid.shape))

    def held(self, reach_px: float = 0.0) -> NDArray[np.bool_]:
        """Return which pixels of the grid [rows, cols] lie wholly in the area, further than a reach from its edge.

        What is returned truly does; a pixel within `TOUCH_PX` of the edge does not count.
        """
        return ~self._near_an_edge(reach_px) & self.mask(Window(0, 0, *self.grid.shape))

    def _near_an_edge(self, reach_px: float) -> NDArray[np.bool_]:
        """Return which pixels an edge comes within `reach_px` of, distances being in pixels."""
        reach = reach_px + TOUCH_PX
        rows, cols = self.grid.shape
        first = np.maximum(np.ceil(self.edges[:, 0] - reach) - 1, 0).astype(np.int64)
        last = np.minimum(np.floor(self.edges[:, 2] + reach) + 1, rows).astype(np.int64)
        # Of each interval of columns the first counts one up, that after the last one down.
        begins = np.zeros((rows, cols + 1), np.int32)
        for edge, row in _rows_of(first, last):
            row0, col0, row1, col1 = self.edges[edge].T
            right = _rightmost(row0, col0, row1, col1, reach, row)
            left = -_rightmost(row0, -col0, row1, -col1, reach, row)
            start, stop = np.maximum(np.ceil(left) - 1, 0), np.minimum(np.floor(right) + 1, cols)
            met = start < stop
            np.add.at(begins, (row[met], start[met].astype(np.int64)), 1)
            np.subtract.at(begins, (row[met], stop[met].astype(np.int64)), 1)
        return np.asarray(np.cumsum(begins[:, :-1], axis=1, dtype=np.int32) > 0)


def _rightmost(row0: Floats, col0: Floats, row1: Floats, col1: Floats, reach: float, row: NDArray[np.int64]) -> Floats:
    """Return the greatest column of each edge's capsule between the rows `row` and `row + 1`.

    The capsule's right side is a concave function of the row: the arc about the upper end, the edge's own line moved
    out by the reach, the arc about the lower end. It is highest beside the end that lies further right.
    """
    down, right = row1 - row0, col1 - col0
    length = np.maximum(np.hypot(down, right), np.finfo(np.float64).tiny)
    out_row, out_col = -right / length * reach, down / length * reach
    highest = np.where(right > 0, row1, row0)
    at = np.clip(np.clip(highest, row, row + 1), row0 - reach, row1 + reach)
    upper, lower = at <= row0 + out_row, at >= row1 + out_row
    with np.errstate(divide="ignore", invalid="ignore"):
        line = col0 + out_col + (at - row0 - out_row) / down * right
    arc_row, arc_col = np.where(upper, row0, row1), np.where(upper, col0, col1)
    arc = arc_col + np.sqrt(np.maximum(reach**2 - (at - arc_row) ** 2, 0.0))
    return np.asarray(np.where(upper | lower, arc, line))


def _rows_of(first: NDArray[np.int64], last: NDArray[np.int64]) -> Iterator[tuple[NDArray[np.int64], ...]]:
    """Yield, some at a time, the pairs (edge, row) of all rows from `first` to before `last` of each edge."""
    met = np.flatnonzero(first < last)
    counts = (last - first)[met]
    ends = counts.cumsum()
    start = 0
    while start < len(met):
        before = int(ends[start] - counts[start])
        stop = max(start + 1, int(np.searchsorted(ends, before + _PAIRS, side="right")))
        these, many = met[start:stop], counts[start:stop]
        edge = np.repeat(these, many)
        row = np.arange(many.sum()) + np.repeat(first[these] - (many.cumsum() - many), many)
        yield edge, row
        start = stop
