"""Walks that need no learning: lawnmowers, greedy, spiral and random.

All of them enter free cells only, route around the others by shortest paths, and keep the budget exactly, the
way home included where the robot must return.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hrt_cli.planning.jit import kernel, lean_kernel
from hrt_cli.planning.walk import Field, capacity, may_step, next_uniform, walk_cost, walk_value

WINDOW_TRIALS = 2_000_000
"""Windows the rectangle lawnmower estimates from sums at most; beyond it, positions are strided."""

WINDOW_FINALISTS = 24
"""Windows whose walk is really made, out of the estimated ones."""


@lean_kernel
def greedy_step(field: Field, cell: int, left: float, seen: NDArray[np.bool_], state: NDArray[np.uint64]) -> int:
    """Return the allowed move to the best unvisited neighbour, -1 when there is no allowed move.

    Visited cells count as 0 and ties are drawn at random, so that the walk does not stick.
    """
    best, best_gain = -1, -1.0
    ties = 0
    for k in range(field.offsets.size):
        if not may_step(field, cell, k, left):
            continue
        after = cell + field.offsets[k]
        gain = 0.0 if seen[after] else field.value[after]
        if gain > best_gain:
            best, best_gain, ties = k, gain, 1
        elif gain == best_gain:
            ties += 1
            if next_uniform(state) * ties < 1.0:
                best = k
    return best


@kernel
def finish_greedily(field: Field, path: NDArray[np.int64], n: int, left: float, state: NDArray[np.uint64]) -> int:
    """Extend a walk of `n` cells with greedy moves until nothing fits `left`; return the number of cells."""
    seen = np.zeros(field.free.size, np.bool_)
    for t in range(n):
        seen[path[t]] = True
    while n < path.size:
        k = greedy_step(field, path[n - 1], left, seen, state)
        if k < 0:
            break
        left -= field.costs[k]
        path[n] = path[n - 1] + field.offsets[k]
        seen[path[n]] = True
        n += 1
    return n


@kernel
def spend_rest(field: Field, walk: NDArray[np.int64], seed: int) -> NDArray[np.int64]:
    """Return `walk` extended with greedy moves until nothing fits its budget any more."""
    path = np.zeros(capacity(field), np.int64)
    path[: walk.size] = walk
    state = np.full(1, np.uint64(seed), np.uint64)
    left = field.limit - walk_cost(field, walk, walk.size)
    return path[: finish_greedily(field, path, walk.size, left, state)]


@kernel
def greedy_walk(field: Field, seed: int) -> NDArray[np.int64]:
    """Return the walk that always takes the best neighbouring cell."""
    path = np.zeros(capacity(field), np.int64)
    path[0] = field.start
    state = np.full(1, np.uint64(seed), np.uint64)
    return path[: finish_greedily(field, path, 1, field.limit, state)]


@kernel
def random_walk(field: Field, seed: int) -> NDArray[np.int64]:
    """Return a walk whose moves are drawn evenly from the allowed ones."""
    path = np.zeros(capacity(field), np.int64)
    path[0] = field.start
    state = np.full(1, np.uint64(seed), np.uint64)
    left, n = field.limit, 1
    while n < path.size:
        choice, count = -1, 0
        for k in range(field.offsets.size):
            if may_step(field, path[n - 1], k, left):
                count += 1
                if next_uniform(state) * count < 1.0:
                    choice = k
        if choice < 0:
            break
        left -= field.costs[choice]
        path[n] = path[n - 1] + field.offsets[choice]
        n += 1
    return path[:n]


@lean_kernel
def _route(
    field: Field, source: int, target: int, stamp: NDArray[np.int64], mark: int, back: NDArray[np.int64],
    queue: NDArray[np.int64],
) -> bool:  # fmt: skip
    """Search breadth-first from `target` until `source` is met; `back[c]` is then the move to make at c."""
    queue[0] = target
    stamp[target] = mark
    head, tail = 0, 1
    while head < tail:
        cell = queue[head]
        head += 1
        if cell == source:
            return True
        for k in range(field.offsets.size):
            before = cell - field.offsets[k]
            if field.free[before] and stamp[before] != mark:
                stamp[before] = mark
                back[before] = k
                queue[tail] = before
                tail += 1
    return False


@kernel
def visit_in_order(field: Field, order: NDArray[np.int64], seed: int) -> NDArray[np.int64]:
    """Return a walk that goes through the cells of `order` by shortest paths until the budget is spent.

    Cells that are not free are left out. What remains of the budget, or the way home, is walked greedily.
    """
    path = np.zeros(capacity(field), np.int64)
    path[0] = field.start
    left, n = field.limit, 1
    stamp = np.zeros(field.free.size, np.int64)
    back = np.zeros(field.free.size, np.int64)
    queue = np.zeros(field.free.size, np.int64)
    for i in range(order.size):
        target = order[i]
        cell = path[n - 1]
        if not field.free[target] or target == cell:
            continue
        if not _route(field, cell, target, stamp, i + 1, back, queue):
            continue
        spent = False
        while cell != target:
            k = back[cell]
            if n == path.size or not may_step(field, cell, k, left):
                spent = True
                break
            cell += field.offsets[k]
            left -= field.costs[k]
            path[n] = cell
            n += 1
        if spent:
            break
    state = np.full(1, np.uint64(seed), np.uint64)
    return path[: finish_greedily(field, path, n, left, state)]


def _sweep(top: int, left: int, bottom: int, right: int, flip_rows: bool, flip_cols: bool, across: bool,
           width: int) -> NDArray[np.int64]:  # fmt: skip
    """Return the boustrophedon order of a window's cells, rows first unless `across`."""
    rows, cols = np.arange(top, bottom), np.arange(left, right)
    if flip_rows:
        rows = rows[::-1]
    if flip_cols:
        cols = cols[::-1]
    grid = rows[:, None] * width + cols[None, :]
    if across:
        grid = grid.T
    grid = grid.copy()
    grid[1::2] = grid[1::2, ::-1]
    return grid.ravel().astype(np.int64)


def _useful(field: Field, order: NDArray[np.int64]) -> NDArray[np.int64]:
    """Keep the free cells of an order, and no more of them than the budget can visit."""
    return order[field.free[order]][: int(field.limit) + 1]


def lawnmower(field: Field, seed: int = 0) -> NDArray[np.int64]:
    """Return the fixed boustrophedon from the start: along its row, then row by row to the map's end.

    The rows above the start follow when those below are done; the scores play no part.
    """
    height = field.free.size // field.width
    row, col = divmod(field.start, field.width)
    first = np.arange(field.start, (row + 1) * field.width, dtype=np.int64)
    below = _sweep(row + 1, 0, height, field.width, False, True, False, field.width)
    rest = np.arange(row * field.width, row * field.width + col, dtype=np.int64)[::-1]
    above = _sweep(0, 0, row, field.width, True, False, False, field.width)
    order = np.concatenate([first, below, rest, above])
    return np.asarray(visit_in_order(field, _useful(field, order), seed))


def spiral(field: Field, seed: int = 0) -> NDArray[np.int64]:
    """Return the square spiral around the start."""
    height = field.free.size // field.width
    row, col = divmod(field.start, field.width)
    reach = min(max(row, col, height - row, field.width - col), int(field.limit) + 1)
    rows, cols = [0], [0]
    dr, dc = 0, 1
    for arm in range(2, 4 * reach + 2):
        for _ in range(arm // 2):
            rows.append(rows[-1] + dr)
            cols.append(cols[-1] + dc)
        dr, dc = dc, -dr
    at_row, at_col = np.array(rows) + row, np.array(cols) + col
    inside = (at_row >= 0) & (at_row < height) & (at_col >= 0) & (at_col < field.width)
    order = (at_row * field.width + at_col)[inside].astype(np.int64)
    return np.asarray(visit_in_order(field, _useful(field, order), seed))


@kernel
def _estimate_windows(
    table: NDArray[np.float64], steps: NDArray[np.float64], budget: float, heights: NDArray[np.int64], stride: int
) -> NDArray[np.float64]:
    """Return, for each window position, height and corner, its sum and shape.

    float64 [k, 6]: sum, top, left, height, width, corner. The width is what the budget still pays for after
    the way from the start to the corner.
    """
    rows, cols = table.shape[0] - 1, table.shape[1] - 1
    count = ((rows - 1) // stride + 1) * ((cols - 1) // stride + 1) * heights.size * 4
    found = np.zeros((count, 6))
    n = 0
    for row in range(0, rows, stride):
        for col in range(0, cols, stride):
            cells = budget + 1.0 - steps[row, col]
            if cells < 1.0:
                continue
            for h in heights:
                width = int(cells / h)
                for corner in range(4):
                    top = row - h + 1 if corner & 1 else row
                    left = col - width + 1 if corner & 2 else col
                    if width < 1 or top < 0 or left < 0 or top + h > rows or left + width > cols:
                        continue
                    found[n, 0] = (
                        table[top + h, left + width] - table[top, left + width]
                        - table[top + h, left] + table[top, left]
                    )  # fmt: skip
                    found[n, 1:] = (top, left, h, width, corner)
                    n += 1
    return found[:n]


def rectangle(field: Field, gamma: float = 1.0, seed: int = 0) -> NDArray[np.int64]:
    """Return the best lawnmower over one rectangle, its window chosen from the scores.

    Every window whose sweep the budget pays for, the way from the start to a corner included, is estimated by
    a summed-area table; the best ones are walked along rows and along columns, and the best walk is returned.
    """
    shape = (field.free.size // field.width, field.width)
    table = np.zeros((shape[0] + 1, shape[1] + 1))
    table[1:, 1:] = field.value.reshape(shape).cumsum(axis=0).cumsum(axis=1)
    budget = field.limit
    top_height = int(min(shape[0], budget + 1))
    heights = np.unique(np.geomspace(1, top_height, 48).astype(np.int64))
    cells = shape[0] * shape[1]
    stride = max(1, int(np.ceil(np.sqrt(cells * heights.size * 4 / WINDOW_TRIALS))))
    steps = field.reach.min(axis=0).reshape(shape)
    windows = _estimate_windows(table, steps, budget, heights, stride)
    best = lawnmower(field, seed)
    seen = np.zeros(field.free.size, np.bool_)
    best_value = walk_value(field.value, best, best.size, gamma, seen)
    for index in np.argsort(-windows[:, 0], kind="stable")[:WINDOW_FINALISTS]:
        top, left, height, width, corner = (int(x) for x in windows[index, 1:])
        for across in (False, True):
            order = _sweep(
                top, left, top + height, left + width, bool(corner & 1), bool(corner & 2), across, field.width
            )
            walk = visit_in_order(field, _useful(field, order), seed)
            value = walk_value(field.value, walk, walk.size, gamma, seen)
            if value > best_value:
                best, best_value = walk, value
    return best
