"""Multi-resolution features of the score still to be collected, centred on the robot.

Rings of eight blocks surround the robot; the blocks grow with distance, so that near cells are seen one by one
and far ones as means (Manderson, Manjanna and Dudek 2019). The rings are read relative to each action's heading
and left and right share a weight, so that a turned or mirrored map gives the turned or mirrored policy.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hrt_cli.planning.jit import kernel, lean_kernel
from hrt_cli.planning.walk import Field

RING = 8
"""Blocks per ring, clockwise from east."""

TIED = 5
"""Headings a weight tells apart: ahead, ahead to a side, abeam, behind to a side, behind."""

LAYOUTS = ("network", "rings", "manjanna24")

BLOCK_SIZES = {"network": (1, 3, 9), "rings": (1, 3, 9), "manjanna24": (1, 3)}
"""Side in cells of the blocks whose sums are kept, by layout; each ring lies one block away from the robot."""

WIDEST = {"network": 27, "rings": 27, "manjanna24": 3}
"""Side of the blocks of the widest ring; those of 27 are read as nine sums of 9, never kept."""

LEVELS = {"network": 18, "rings": 8, "manjanna24": 3}
"""Rings of features by layout."""

NEAR = ((0, 2), (1, 1), (2, 4))
"""Rings of 'network' between those that do not overlap: the level of their blocks, and how far away they lie."""

CONSTANTS = 2
"""Features of 'network' that are the same for every move: the share of the budget left, and 1."""

FAINTEST = 1e-3
"""Mean score, in units of the scale, that is added before a logarithm is taken: fainter blocks look alike."""

LOG_UNIT = 1.0 / float(np.log(1.0 / FAINTEST))
"""Factor of the logarithms: they run from 0 where nothing is left to about 1 at the scale."""

HINGES = {"network": 16, "rings": 0, "manjanna24": 0}
"""Hinge functions of the features that are added up beside a linear one, by layout; the second half counts
negative."""

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
    wide : ndarray, int64 [8, 9]
        Index steps to the centres of the nine blocks that make up each block of the widest ring.
    width, pad : int
        Cells per row of these arrays, and the frame they have around the field's own.
    far : ndarray, float64 [2, rows + 1, cols + 1]
        Summed-area tables of scaled score and of free cells; empty where no region reaches the map's edge.
    scale : float
        Score that counts as 1: the mean of the best cells the budget could pay for.
    levels : int
        Rings of features.
    constants : int
        Features behind those of the rings that are the same for every move.
    """

    sums: NDArray[np.float32]
    blocked: NDArray[np.float32]
    sizes: NDArray[np.int64]
    rings: NDArray[np.int64]
    wide: NDArray[np.int64]
    width: int
    pad: int
    far: NDArray[np.float64]
    scale: float
    levels: int
    constants: int


def feature_count(layout: str) -> int:
    """Return the number of features of a layout."""
    return LEVELS[layout] * TIED + (CONSTANTS if layout == "network" else 0)


def weight_count(layout: str) -> int:
    """Return the number of weights of a layout: one per feature for the linear part and for each hinge."""
    return feature_count(layout) * (1 + HINGES[layout])


def build_blocks(field: Field, layout: str) -> Blocks:
    """Return the block sums of an unvisited field for a layout of `LAYOUTS`."""
    sizes = BLOCK_SIZES[layout]
    pad = WIDEST[layout] + WIDEST[layout] // 3
    shape = (field.free.size // field.width, field.width)
    best = np.sort(field.value[field.free])[::-1][: int(field.limit) + 1]
    scale = float(best.mean()) if best.size and best.max() > 0 else 1.0
    worth = _summed_area(np.asarray(field.value / scale).reshape(shape))
    open_cells = _summed_area(field.free.reshape(shape).astype(np.float64))
    width = shape[1] + 2 * pad
    steps = np.array([0, 1, 1, 1, 0, -1, -1, -1]), np.array([1, 1, 0, -1, -1, -1, 0, 1])
    around = steps[0] * width + steps[1]
    regions = layout == "manjanna24"
    covered = sizes if regions else (*sizes, WIDEST[layout])
    areas = np.array([size * size for size in covered], np.float32)[:, None]
    return Blocks(
        sums=block_sums(worth, np.array(sizes, np.int64), pad),
        blocked=1.0 - block_sums(open_cells, np.array(covered, np.int64), pad) / areas,
        sizes=np.array(sizes, np.int64),
        rings=np.array([s * around for s in covered], np.int64),
        wide=(covered[-1] * around)[:, None] + sizes[-1] * np.append(around, 0)[None, :],
        width=width,
        pad=pad,
        far=np.stack([worth, open_cells]) if regions else np.zeros((2, 0, 0)),
        scale=scale,
        levels=LEVELS[layout],
        constants=CONSTANTS if layout == "network" else 0,
    )


def _summed_area(values: NDArray[np.float64]) -> NDArray[np.float64]:
    table = np.zeros((values.shape[0] + 1, values.shape[1] + 1))
    table[1:, 1:] = values.cumsum(axis=0).cumsum(axis=1)
    return table


@kernel
def block_sums(table: NDArray[np.float64], sizes: NDArray[np.int64], pad: int) -> NDArray[np.float32]:
    """Return the sums over the blocks of each size centred at each cell of a grid framed by `pad` cells.

    float32 [sizes, cells] from the summed-area table [rows + 1, cols + 1]; outside the grid there is nothing.
    """
    rows, cols = table.shape[0] - 1, table.shape[1] - 1
    width = cols + 2 * pad
    sums = np.zeros((sizes.size, (rows + 2 * pad) * width), np.float32)
    for level in range(sizes.size):
        half = sizes[level] // 2
        for row in range(rows + 2 * pad):
            top = min(max(row - pad - half, 0), rows)
            bottom = min(max(row - pad + half + 1, 0), rows)
            if top == bottom:
                continue
            for col in range(width):
                left = min(max(col - pad - half, 0), cols)
                right = min(max(col - pad + half + 1, 0), cols)
                total = table[bottom, right] - table[top, right] - table[bottom, left] + table[top, left]
                sums[level, row * width + col] = max(total, 0.0)
    return sums


@lean_kernel
def padded_index(blocks: Blocks, width: int, cell: int) -> int:
    """Return the index into the block arrays of a field cell."""
    row = cell // width
    return (row + blocks.pad) * blocks.width + cell - row * width + blocks.pad


@lean_kernel
def take_out(blocks: Blocks, sums: NDArray[np.float32], at: int, value: float) -> None:
    """Subtract a visited cell's scaled `value` from every block that holds it."""
    amount = np.float32(value)
    for level in range(blocks.sizes.size):
        half = blocks.sizes[level] // 2
        for row in range(-half, half + 1):
            first = at + row * blocks.width - half
            for i in range(first, first + 2 * half + 1):
                sums[level, i] -= amount


@lean_kernel
def put_back(blocks: Blocks, sums: NDArray[np.float32], at: int) -> None:
    """Restore every block that holds the cell `at` to its unvisited sum."""
    for level in range(blocks.sizes.size):
        half = blocks.sizes[level] // 2
        for row in range(-half, half + 1):
            first = at + row * blocks.width - half
            for i in range(first, first + 2 * half + 1):
                sums[level, i] = blocks.sums[level, i]


@lean_kernel
def read_rings(
    blocks: Blocks,
    sums: NDArray[np.float32],
    at: int,
    paid: NDArray[np.int32],
    scores: NDArray[np.float64],
    count: int,
    rings: NDArray[np.float64],
) -> None:
    """Fill `rings` [rings + 1, 8] with the features around cell `at` of the block arrays; the last row is spare.

    `paid[:, :count]` are rows and columns of the cells that paid so far, and `scores[:count]` what they paid, scaled;
    only the regions of 'manjanna24' need them.
    """
    kept = blocks.sizes.size
    for level in range(kept):
        share = 1.0 / (blocks.sizes[level] * blocks.sizes[level])
        for k in range(RING):
            rings[level, k] = sums[level, np.uint64(at + blocks.rings[level, k])] * share
    if blocks.far.size > 0:
        _read_regions(blocks, at, paid, scores, count, rings, kept)
        return
    share = 1.0 / (9 * blocks.sizes[kept - 1] * blocks.sizes[kept - 1])
    for k in range(RING):
        total = np.float32(0.0)
        for i in range(9):
            total += sums[kept - 1, np.uint64(at + blocks.wide[k, i])]
        rings[kept, k] = total * share
    for level in range(kept + 1):
        for k in range(RING):
            rings[kept + 1 + level, k] = blocks.blocked[level, np.uint64(at + blocks.rings[level, k])]


@lean_kernel
def _sector(row: int, col: int) -> int:
    """Return the ring position of an offset whose signs are `row` and `col`; the centre is -1."""
    if row == 0:
        return 0 if col > 0 else (4 if col < 0 else -1)
    if row > 0:
        return 1 if col > 0 else (3 if col < 0 else 2)
    return 7 if col > 0 else (5 if col < 0 else 6)


@lean_kernel
def _third(offset: int) -> int:
    """Return 0, 1 or 2: before, within or beyond the inner square."""
    return (1 if offset >= -FAR_EDGE else 0) + (1 if offset > FAR_EDGE else 0)


@lean_kernel
def _box_sum(tables: NDArray[np.float64], which: int, r0: int, r1: int, c0: int, c1: int) -> float:
    """Return the sum over rows r0..r1 and columns c0..c1 (ends excluded) from a summed-area table."""
    total = tables[which, r1, c1] - tables[which, r0, c1] - tables[which, r1, c0] + tables[which, r0, c0]
    return float(total)


@lean_kernel
def _read_regions(
    blocks: Blocks,
    at: int,
    paid: NDArray[np.int32],
    scores: NDArray[np.float64],
    count: int,
    rings: NDArray[np.float64],
    ring: int,
) -> None:
    """Fill row `ring` with the mean remaining score between the inner square and the edges.

    The next row is used up: it takes the numbers of cells.
    """
    row, col = at // blocks.width - blocks.pad, at % blocks.width - blocks.pad
    rows, cols = blocks.far.shape[1] - 1, blocks.far.shape[2] - 1
    row_cuts = (0, max(row - FAR_EDGE, 0), min(row + FAR_EDGE + 1, rows), rows)
    col_cuts = (0, max(col - FAR_EDGE, 0), min(col + FAR_EDGE + 1, cols), cols)
    for i in range(3):
        for j in range(3):
            k = _sector(i - 1, j - 1)
            if k >= 0:
                for which in range(2):
                    rings[ring + which, k] = _box_sum(
                        blocks.far, which, row_cuts[i], row_cuts[i + 1], col_cuts[j], col_cuts[j + 1]
                    )
    for i in range(count):
        k = _sector(_third(paid[0, i] - row) - 1, _third(paid[1, i] - col) - 1)
        if k >= 0:
            rings[ring, k] -= scores[i]
    for k in range(RING):
        cells = rings[ring + 1, k]
        rings[ring, k] = max(rings[ring, k], 0.0) / cells if cells > 0.5 else 0.0


@lean_kernel
def tie_rings(rings: NDArray[np.float64], move: int, heading: int, phi: NDArray[np.float32]) -> None:
    """Fill row `move` of `phi` with the rings as seen along `heading` (0..7): the two sides are added up."""
    around = np.uint64(heading)
    for level in range(rings.shape[0] - 1):
        base = level * TIED
        phi[move, base] = rings[level, around]
        for turn in range(1, TIED - 1):
            right = (around + np.uint64(turn)) & np.uint64(7)
            left = (around + np.uint64(RING - turn)) & np.uint64(7)
            phi[move, base + turn] = rings[level, right] + rings[level, left]
        phi[move, base + TIED - 1] = rings[level, (around + np.uint64(4)) & np.uint64(7)]


@lean_kernel
def read_more(
    field: Field,
    blocks: Blocks,
    sums: NDArray[np.float32],
    at: int,
    cell: int,
    last: NDArray[np.int64],
    came: int,
    rings: NDArray[np.float64],
) -> None:
    """Fill the rings that only 'network' has, behind those of `read_rings`.

    The logarithm of the mean scores, in which faint blocks differ as rich ones do; which of the eight cells
    around were visited; the heading of the last move, `came` (-1 at the start); the mean scores of the rings of
    `NEAR`; and, where all the blocks around are as good as empty, the pull of what lies beyond. `at` is the index
    of `cell` in the block arrays.
    """
    kept = blocks.sizes.size + 1
    for level in range(kept):
        for k in range(RING):
            rings[2 * kept + level, k] = np.log(max(rings[level, k], 0.0) + FAINTEST) * LOG_UNIT + 1.0
    width = field.width
    around = (1, width + 1, width, width - 1, -1, -width - 1, -width, 1 - width)
    for k in range(RING):
        rings[3 * kept, k] = 1.0 if last[cell + around[k]] >= 0 else 0.0
        rings[3 * kept + 1, k] = 1.0 if k == came else 0.0
    for i in range(len(NEAR)):
        level, away = NEAR[i]
        share = 1.0 / (blocks.sizes[level] * blocks.sizes[level])
        for k in range(RING):
            rings[3 * kept + 2 + i, k] = sums[level, np.uint64(at + away * blocks.rings[0, k])] * share
    seen = 0.0
    for k in range(RING):
        rings[3 * kept + 2 + len(NEAR), k] = 0.0
        seen += rings[kept - 1, k]
    if seen < FAINTEST:
        _read_beyond(blocks, sums, at, rings, 3 * kept + 2 + len(NEAR))


@lean_kernel
def _read_beyond(blocks: Blocks, sums: NDArray[np.float32], at: int, rings: NDArray[np.float64], ring: int) -> None:
    """Fill row `ring`, all zeros, with each direction's share of the pull of the whole map.

    The map is read in the largest blocks that are kept; each pulls with its score over its squared distance.
    """
    level = blocks.sizes.size - 1
    size = blocks.sizes[level]
    row, col = at // blocks.width, at % blocks.width
    total = 0.0
    for r in range(row % size, blocks.sums.shape[1] // blocks.width, size):
        for c in range(col % size, blocks.width, size):
            score = sums[level, r * blocks.width + c]
            down, right = r - row, c - col
            if score > FAINTEST and (down != 0 or right != 0):
                k = _sector(down if 2 * abs(down) > abs(right) else 0, right if 2 * abs(right) > abs(down) else 0)
                pull = score / (down * down + right * right)
                rings[ring, k] += pull
                total += pull
    if total > 0.0:
        for k in range(RING):
            rings[ring, k] /= total
