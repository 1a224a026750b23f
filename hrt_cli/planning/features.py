"""Multi-resolution features of the score still to be collected, centred on the robot.

Rings of eight blocks surround the robot; the blocks grow with distance, so that near cells are seen one by one
and far ones as means (Manderson, Manjanna and Dudek 2019). The rings are read relative to each action's heading
and left and right share a weight, so that a turned or mirrored map gives the turned or mirrored policy.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from hrt_cli.planning.walk import Field

RING = 8
"""Blocks per ring, clockwise from east."""

TIED = 5
"""Headings a weight tells apart: ahead, ahead to a side, abeam, behind to a side, behind."""

BLOCK_SIZES = {"rings": (1, 3, 9, 27), "manjanna24": (1, 3)}
"""Side in cells of the square blocks of each ring, by layout; each ring lies one block away from the robot."""

LAYOUTS = tuple(BLOCK_SIZES)

FAR_EDGE = 4
"""Layout 'manjanna24': the third ring is the eight regions beyond the 9 x 9 square around the robot."""


class Blocks(NamedTuple):
    """Block sums over a field, held so that a visit is a few subtractions.

    Attributes
    ----------
    sums : ndarray, float32 [levels, n]
        Sum of the scaled score over the block centred at each cell.
    blocked : ndarray, float32 [levels, n]
        Share of that block that cannot be entered (no-go or off the map).
    sizes : ndarray, int64 [levels]
        Side of the blocks in cells.
    rings : ndarray, int64 [levels, 8]
        Index steps from the robot to the centres of the blocks.
    width, pad : int
        Cells per row of these arrays, and the frame they have around the field's own.
    far : ndarray, float64 [2, rows + 1, cols + 1]
        Summed-area tables of scaled score and of free cells; empty where no region reaches the map's edge.
    scale : float
        Score that counts as 1: the mean of the best cells the budget could pay for.
    """

    sums: NDArray[np.float32]
    blocked: NDArray[np.float32]
    sizes: NDArray[np.int64]
    rings: NDArray[np.int64]
    width: int
    pad: int
    far: NDArray[np.float64]
    scale: float


def feature_count(layout: str) -> int:
    """Return the number of weights of a layout."""
    return 8 * TIED if layout == "rings" else 3 * TIED


def build_blocks(field: Field, layout: str) -> Blocks:
    """Return the block sums of an unvisited field for a layout of `LAYOUTS`."""
    sizes = BLOCK_SIZES[layout]
    pad = sizes[-1]
    shape = (field.free.size // field.width, field.width)
    best = np.sort(field.value[field.free])[::-1][: int(field.limit) + 1]
    scale = float(best.mean()) if best.size and best.max() > 0 else 1.0
    value = np.asarray((field.value / scale).reshape(shape), np.float64)
    blocked = np.asarray(1.0 - field.free.reshape(shape), np.float64)
    width = shape[1] + 2 * pad
    steps = np.array([0, 1, 1, 1, 0, -1, -1, -1]), np.array([1, 1, 0, -1, -1, -1, 0, 1])
    far = np.zeros((2, 0, 0))
    if layout == "manjanna24":
        far = np.stack([_summed_area(value), _summed_area(1.0 - blocked)])
    return Blocks(
        sums=np.stack([_block_sums(value, s, pad, 0.0) for s in sizes]),
        blocked=np.stack([_block_sums(blocked, s, pad, 1.0) / np.float32(s * s) for s in sizes]),
        sizes=np.array(sizes, np.int64),
        rings=np.array([s * (steps[0] * width + steps[1]) for s in sizes], np.int64),
        width=width,
        pad=pad,
        far=far,
        scale=scale,
    )


def _summed_area(values: NDArray[np.float64]) -> NDArray[np.float64]:
    table = np.zeros((values.shape[0] + 1, values.shape[1] + 1))
    table[1:, 1:] = values.cumsum(axis=0).cumsum(axis=1)
    return table


def _block_sums(values: NDArray[np.float64], size: int, pad: int, outside: float) -> NDArray[np.float32]:
    """Sum `values` over the `size` x `size` block at each cell of the padded grid; flat float32."""
    half = size // 2
    table = _summed_area(np.pad(values, pad + half, constant_values=outside))
    sums = table[size:, size:] - table[:-size, size:] - table[size:, :-size] + table[:-size, :-size]
    return np.maximum(sums, 0.0).astype(np.float32).ravel()


@njit(cache=True, nogil=True)
def padded_index(blocks: Blocks, width: int, cell: int) -> int:
    """Return the index into the block arrays of a field cell."""
    row = cell // width
    return (row + blocks.pad) * blocks.width + cell - row * width + blocks.pad


@njit(cache=True, nogil=True)
def take_out(blocks: Blocks, sums: NDArray[np.float32], at: int, value: float) -> None:
    """Subtract a visited cell's scaled `value` from every block that holds it."""
    amount = np.float32(value)
    for level in range(blocks.sizes.size):
        half = blocks.sizes[level] // 2
        span = 2 * half + 1
        for row in range(-half, half + 1):
            first = at + row * blocks.width - half
            line = sums[level, first : first + span]
            for i in range(span):
                line[i] -= amount


@njit(cache=True, nogil=True)
def put_back(blocks: Blocks, sums: NDArray[np.float32], at: int) -> None:
    """Restore every block that holds the cell `at` to its unvisited sum."""
    for level in range(blocks.sizes.size):
        half = blocks.sizes[level] // 2
        for row in range(-half, half + 1):
            first = at + row * blocks.width - half
            sums[level, first : first + 2 * half + 1] = blocks.sums[level, first : first + 2 * half + 1]


@njit(cache=True, nogil=True)
def read_rings(
    blocks: Blocks,
    sums: NDArray[np.float32],
    at: int,
    width: int,
    path: NDArray[np.int64],
    n: int,
    fresh: NDArray[np.float64],
    rings: NDArray[np.float64],
) -> None:
    """Fill `rings` [rings, 8] with the features around cell `at` of the block arrays.

    `path[:n]` is the walk so far and `fresh[t]` the scaled score it collected at t; only the regions of
    'manjanna24' need them.
    """
    levels = blocks.sizes.size
    for level in range(levels):
        area = blocks.sizes[level] * blocks.sizes[level]
        for k in range(RING):
            centre = at + blocks.rings[level, k]
            rings[level, k] = max(sums[level, centre], np.float32(0.0)) / area
            if blocks.far.size == 0:
                rings[levels + level, k] = blocks.blocked[level, centre]
    if blocks.far.size > 0:
        _read_regions(blocks, width, path, n, fresh, rings[levels])


@njit(cache=True, nogil=True)
def _sector(row: int, col: int) -> int:
    """Return the ring position of an offset whose signs are `row` and `col`; the centre is -1."""
    if row == 0:
        return 0 if col > 0 else (4 if col < 0 else -1)
    if row > 0:
        return 1 if col > 0 else (3 if col < 0 else 2)
    return 7 if col > 0 else (5 if col < 0 else 6)


@njit(cache=True, nogil=True)
def _beyond(offset: int) -> int:
    """Return the sign of an offset that leaves the inner square, 0 inside it."""
    return 1 if offset > FAR_EDGE else (-1 if offset < -FAR_EDGE else 0)


@njit(cache=True, nogil=True)
def _read_regions(
    blocks: Blocks,
    width: int,
    path: NDArray[np.int64],
    n: int,
    fresh: NDArray[np.float64],
    ring: NDArray[np.float64],
) -> None:
    """Fill `ring` [8] with the mean remaining score of the regions between the inner square and the edges."""
    row, col = path[n - 1] // width, path[n - 1] % width
    rows, cols = blocks.far.shape[1] - 1, blocks.far.shape[2] - 1
    row_cuts = (0, max(row - FAR_EDGE, 0), min(row + FAR_EDGE + 1, rows), rows)
    col_cuts = (0, max(col - FAR_EDGE, 0), min(col + FAR_EDGE + 1, cols), cols)
    cells = np.zeros(RING)
    for i in range(3):
        for j in range(3):
            k = _sector(i - 1, j - 1)
            if k >= 0:
                r0, r1, c0, c1 = row_cuts[i], row_cuts[i + 1], col_cuts[j], col_cuts[j + 1]
                table = blocks.far
                ring[k] = table[0, r1, c1] - table[0, r0, c1] - table[0, r1, c0] + table[0, r0, c0]
                cells[k] = table[1, r1, c1] - table[1, r0, c1] - table[1, r1, c0] + table[1, r0, c0]
    for t in range(n):
        if fresh[t] > 0.0:
            k = _sector(_beyond(path[t] // width - row), _beyond(path[t] % width - col))
            if k >= 0:
                ring[k] -= fresh[t]
    for k in range(RING):
        ring[k] = max(ring[k], 0.0) / cells[k] if cells[k] > 0.5 else 0.0


@njit(cache=True, nogil=True)
def tie_rings(rings: NDArray[np.float64], heading: int, phi: NDArray[np.float64]) -> None:
    """Fill `phi` [rings * 5] with the rings as seen along `heading` (0..7): sides are added up."""
    for level in range(rings.shape[0]):
        ring = rings[level]
        base = level * TIED
        phi[base] = ring[heading]
        for turn in range(1, TIED - 1):
            phi[base + turn] = ring[(heading + turn) & 7] + ring[(heading - turn) & 7]
        phi[base + TIED - 1] = ring[(heading + 4) & 7]
