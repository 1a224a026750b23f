"""Windows and blocks of a raster: which pixels to work on, and which to read around them."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

_PROBE_PX = 128
_PROBE_BLOCK_PX = 256
"""A probe keeps to blocks of this size, whatever the file's, so that it sees the same in one file and in tiles."""


@dataclass(frozen=True)
class Window:
    """A rectangle of pixels; it may reach outside the raster, where a reader pads.

    Parameters
    ----------
    row, col : int
        The upper left pixel (negative above or left of the raster).
    height, width : int
        The size in pixels.
    """

    row: int
    col: int
    height: int
    width: int

    def grown(self, halo: int) -> Window:
        """Return the window with `halo` pixels more on each side."""
        return Window(self.row - halo, self.col - halo, self.height + 2 * halo, self.width + 2 * halo)

    def clipped(self, shape: tuple[int, int]) -> Window:
        """Return the part of the window inside a raster of `shape` (rows, cols); empty gives zero size."""
        top, left = max(self.row, 0), max(self.col, 0)
        bottom = min(self.row + self.height, shape[0])
        right = min(self.col + self.width, shape[1])
        return Window(top, left, max(bottom - top, 0), max(right - left, 0))

    @property
    def slices(self) -> tuple[slice, slice]:
        """Index a whole-raster array with this window (only where it lies inside)."""
        return slice(self.row, self.row + self.height), slice(self.col, self.col + self.width)


Planes = tuple[NDArray[np.uint8], NDArray[np.bool_]]


class ImageSource(Protocol):
    """An RGB image that can be read window by window: what `texture` works on.

    Attributes
    ----------
    shape : (int, int)
        Rows and columns.
    pixel_m : (float, float)
        Ground metres per pixel step along the rows axis and along the columns axis (1.0 each for an
        unreferenced image: then lengths are pixels).
    anchor : (int, int)
        The raster's origin in pixels of a lattice fixed to the coordinate system, so that a crop of a raster
        shares the lattice of the whole: work aligned to `(pixel + anchor) % n == 0` does not move with the crop.
    """

    @property
    def shape(self) -> tuple[int, int]: ...  # noqa: D102

    @property
    def pixel_m(self) -> tuple[float, float]: ...  # noqa: D102

    @property
    def anchor(self) -> tuple[int, int]: ...  # noqa: D102

    def read_planes(self, window: Window, out: Planes | None = None) -> Planes:
        """Return `(planes [3, height, width] uint8, valid [height, width] bool)`: red, green, blue.

        The window may reach outside: there `valid` is False and the colour is arbitrary. Where `out` is given, arrays
        of those shapes, it is filled and returned. Safe to call from several threads at once.
        """
        ...


def blocks(shape: tuple[int, int], size: int, anchor: tuple[int, int] = (0, 0)) -> Iterator[Window]:
    """Cut a raster into blocks of at most `size` pixels a side, row by row.

    Cuts fall where `(pixel + anchor) % size == 0`, so blocks of a crop lie on the lattice of the whole.
    """
    row_edges = _edges(shape[0], size, anchor[0])
    col_edges = _edges(shape[1], size, anchor[1])
    for top, bottom in itertools.pairwise(row_edges):
        for left, right in itertools.pairwise(col_edges):
            yield Window(top, left, bottom - top, right - left)


def _edges(length: int, size: int, anchor: int) -> list[int]:
    first = (-anchor) % size
    inner = range(first, length, size)
    return sorted({0, length, *inner})


def probe_windows(shape: tuple[int, int], along: int) -> list[Window]:
    """Return windows on a lattice of `along` x `along` over a raster, each inside one block; all where it is small."""
    if max(shape) <= along * _PROBE_PX // 2:
        return list(blocks(shape, _PROBE_PX * 4))
    middles = (np.arange(along) + 0.5) / along
    tops = np.clip(middles * shape[0] - _PROBE_PX / 2, 0, max(shape[0] - _PROBE_PX, 0)).astype(int)
    lefts = np.clip(middles * shape[1] - _PROBE_PX / 2, 0, max(shape[1] - _PROBE_PX, 0)).astype(int)
    tops, lefts = _in_blocks(tops), _in_blocks(lefts)
    return [
        Window(int(top), int(left), min(_PROBE_PX, shape[0]), min(_PROBE_PX, shape[1]))
        for top in sorted(set(tops))
        for left in sorted(set(lefts))
    ]


def _in_blocks(starts: NDArray[Any]) -> NDArray[Any]:
    """Move windows that reach into the next block back into theirs, so that each costs the decoding of one only."""
    return np.asarray(np.minimum(starts, starts // _PROBE_BLOCK_PX * _PROBE_BLOCK_PX + _PROBE_BLOCK_PX - _PROBE_PX))
