"""The grid as the kernels see it, distances on it, and what a walk is worth.

A `Field` is the part of the map the robot can reach within its budget, framed by one blocked cell on each side
and flattened, so that a move is one addition and no kernel ever tests for the map's edge.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hrt_cli.errors import ArgumentError
from hrt_cli.planning.jit import kernel, lean_kernel
from hrt_cli.planning.problem import BUDGET_TOLERANCE, NEIGHBOURS_8, Problem

UNREACHED = np.inf


class Field(NamedTuple):
    """The reachable window of a problem, flattened; passed to the kernels as it is.

    Attributes
    ----------
    value : ndarray, float64 [n]
        Score of each cell, 0 where it cannot be entered.
    free : ndarray, bool [n]
        Cells that some walk within the budget can enter.
    width : int
        Cells per row of the window, frame included.
    offsets, costs : ndarray, int64 and float64 [4 or 8]
        Index step and budget cost of each move, clockwise from east.
    start : int
        Index of the start.
    reach : ndarray, float64 [2, n]
        Cost of the cheapest walk from the start with an even and with an odd number of moves; where diagonals
        cost more than 1, both rows hold the cheapest cost whatever the number of moves.
    home : ndarray, float64 [2, n]
        What must be left of the budget at a cell, by the parity of what is left: zeros, or the cost of getting
        to `end`.
    limit : float
        The budget in cell units, less the one move that parity can take from a walk with a given end.
    row, col : int
        Map position of the window's index 0.
    end : int
        Index of the cell where the walk must end, -1 where it may end anywhere.
    exact : bool
        Whether every move costs 1, so that a walk has exactly `limit` moves.
    """

    value: NDArray[np.float64]
    free: NDArray[np.bool_]
    width: int
    offsets: NDArray[np.int64]
    costs: NDArray[np.float64]
    start: int
    reach: NDArray[np.float64]
    home: NDArray[np.float64]
    limit: float
    row: int
    col: int
    end: int
    exact: bool


@kernel
def parity_steps(free: NDArray[np.bool_], offsets: NDArray[np.int64], source: int, limit: float) -> NDArray[np.float64]:
    """Return the fewest moves from `source` to each cell, for even and odd move counts, up to `limit`.

    Breadth-first search on (parity, cell); float64 [2, n], inf where there is no such walk.
    """
    n = free.size
    steps = np.full(2 * n, np.inf)
    queue = np.empty(2 * n, np.int64)
    steps[source] = 0.0
    queue[0] = source
    head, tail = 0, 1
    while head < tail:
        node = queue[head]
        head += 1
        reached = steps[node] + 1.0
        if reached > limit:
            break
        odd = node >= n
        cell = node - n if odd else node
        for k in range(offsets.size):
            after = cell + offsets[k]
            if not free[after]:
                continue
            target = after if odd else after + n
            if steps[target] == np.inf:
                steps[target] = reached
                queue[tail] = target
                tail += 1
    return steps.reshape((2, n))


@kernel
def travel_costs(
    free: NDArray[np.bool_],
    offsets: NDArray[np.int64],
    costs: NDArray[np.float64],
    source: int,
    limit: float,
) -> NDArray[np.float64]:
    """Return the cheapest cost from `source` to each cell, up to `limit` (Dijkstra 1959); inf beyond."""
    best = np.full(free.size, np.inf)
    best[source] = 0.0
    heap = [(0.0, source)]
    while len(heap) > 0:
        cost, cell = heapq.heappop(heap)
        if cost > best[cell]:
            continue
        for k in range(offsets.size):
            after = cell + offsets[k]
            reached = cost + costs[k]
            if free[after] and reached < best[after] and reached <= limit + BUDGET_TOLERANCE:
                best[after] = reached
                heapq.heappush(heap, (reached, after))
    return best


def build_field(problem: Problem) -> Field:
    """Return the reachable window of `problem` as a `Field`.

    Cells that no walk within the budget can enter (and leave in time for its end, where that is given) are not
    free.

    Raises
    ------
    ArgumentError
        When the end cannot be reached within the budget.
    """
    row0, col0, score = _nearby(problem)
    framed = np.pad(score, 1, constant_values=np.nan)
    width = framed.shape[1]
    flat = framed.ravel()
    free = ~np.isnan(flat)
    start = (problem.start[0] - row0 + 1) * width + problem.start[1] - col0 + 1
    offsets = np.array([dr * width + dc for dr, dc in problem.neighbours], np.int64)
    diagonal = 1.0 if problem.counts_moves else problem.budget.diagonal_cost
    costs = np.array([diagonal if dr and dc else 1.0 for dr, dc in problem.neighbours])
    reach = _reach(free, offsets, costs, start, problem)
    limit, end, home = problem.limit, -1, np.zeros_like(reach)
    if problem.end is not None:
        row, col = problem.end[0] - row0 + 1, problem.end[1] - col0 + 1
        end = row * width + col if 0 < row < framed.shape[0] - 1 and 0 < col < width - 1 else 0
        home = reach if problem.end == problem.start else _reach(free, offsets, costs, end, problem)
        limit = _limit_to_end(problem, reach[:, end])
    onward = reach.min(axis=0) + home.min(axis=0)
    free &= onward <= limit + BUDGET_TOLERANCE
    reach = np.where(free, reach, UNREACHED)
    if problem.end is not None:
        home = np.where(free, home, UNREACHED)
    value = np.where(free, np.nan_to_num(flat), 0.0)
    return _crop(
        Field(
            value, free, width, offsets, costs, start, reach, home, limit,
            row0 - 1, col0 - 1, end, problem.counts_moves,
        ),
        problem.neighbours,
    )  # fmt: skip


def _limit_to_end(problem: Problem, reach: NDArray[np.float64]) -> float:
    """Return the budget, less one move where its parity does not fit a walk to the end.

    `reach` [2] is the cost of the cheapest walk to the end by the parity of its moves.
    """
    limit = problem.limit
    if float(reach.min()) > limit + BUDGET_TOLERANCE:
        row, col = problem.end or (-1, -1)
        raise ArgumentError(f"the end cell {row},{col} cannot be reached from the start within the budget")
    if problem.counts_moves and reach[int(limit) % 2] > limit:
        return limit - 1.0
    return limit


def _nearby(problem: Problem) -> tuple[int, int, NDArray[np.float64]]:
    """Cut the map to the square no walk can leave; return its upper left cell and its scores."""
    span = int(problem.limit // 2 if problem.end == problem.start else problem.limit)
    row, col = problem.start
    row0, col0 = max(row - span, 0), max(col - span, 0)
    part = problem.score[row0 : row + span + 1, col0 : col + span + 1]
    return row0, col0, np.asarray(part, np.float64)


def _reach(
    free: NDArray[np.bool_],
    offsets: NDArray[np.int64],
    costs: NDArray[np.float64],
    start: int,
    problem: Problem,
) -> NDArray[np.float64]:
    if problem.counts_moves:
        steps: NDArray[np.float64] = parity_steps(free, offsets, start, problem.limit)
        return steps
    return np.tile(travel_costs(free, offsets, costs, start, problem.limit), (2, 1))


def _crop(field: Field, neighbours: tuple[tuple[int, int], ...]) -> Field:
    """Cut a field to the bounding box of its free cells and the frame around it."""
    shape = (field.free.size // field.width, field.width)
    rows, cols = np.nonzero(field.free.reshape(shape))
    top, left = int(rows.min()) - 1, int(cols.min()) - 1
    box = (slice(top, int(rows.max()) + 2), slice(left, int(cols.max()) + 2))
    width = box[1].stop - left

    def cut(flat: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.ascontiguousarray(flat.reshape(*flat.shape[:-1], *shape)[..., box[0], box[1]]).reshape(
            *flat.shape[:-1], -1
        )

    start_row, start_col = divmod(field.start, field.width)
    return field._replace(
        value=cut(field.value),
        free=np.ascontiguousarray(field.free.reshape(shape)[box]).ravel(),
        width=width,
        offsets=np.array([dr * width + dc for dr, dc in neighbours], np.int64),
        start=(start_row - top) * width + start_col - left,
        end=-1 if field.end < 0 else (field.end // field.width - top) * width + field.end % field.width - left,
        reach=cut(field.reach),
        home=cut(field.home),
        row=field.row + top,
        col=field.col + left,
    )


def join_fields(fields: Sequence[Field]) -> tuple[list[Field], Field]:
    """Return the fields on one common window, and the window with every cell that some robot can enter.

    The common field has the start, the end and the distances of the first robot.
    """
    if len(fields) == 1:
        return list(fields), fields[0]
    shapes = [(field.free.size // field.width, field.width) for field in fields]
    top, left = min(field.row for field in fields), min(field.col for field in fields)
    bottom = max(field.row + rows for field, (rows, _) in zip(fields, shapes, strict=True))
    right = max(field.col + cols for field, (_, cols) in zip(fields, shapes, strict=True))
    width = right - left

    def place(flat: NDArray[Any], shape: tuple[int, int], field: Field, outside: float) -> NDArray[Any]:
        wide = np.full((*flat.shape[:-1], bottom - top, width), outside, flat.dtype)
        rows, cols = (
            slice(field.row - top, field.row - top + shape[0]),
            slice(field.col - left, field.col - left + shape[1]),
        )
        wide[..., rows, cols] = flat.reshape(*flat.shape[:-1], *shape)
        return wide.reshape(*flat.shape[:-1], -1)

    def move(index: int, field: Field) -> int:
        row, col = divmod(index, field.width)
        return (row + field.row - top) * width + col + field.col - left

    kinds = NEIGHBOURS_8[:: 8 // fields[0].offsets.size]
    offsets = np.array([dr * width + dc for dr, dc in kinds], np.int64)
    placed = [
        field._replace(
            value=place(field.value, shape, field, 0.0),
            free=place(field.free, shape, field, False),
            width=width,
            offsets=offsets,
            start=move(field.start, field),
            reach=place(field.reach, shape, field, UNREACHED),
            home=place(field.home, shape, field, UNREACHED if field.end >= 0 else 0.0),
            row=top,
            col=left,
            end=-1 if field.end < 0 else move(field.end, field),
        )
        for field, shape in zip(fields, shapes, strict=True)
    ]
    value, free = placed[0].value, placed[0].free
    for field in placed[1:]:
        value, free = np.maximum(value, field.value), free | field.free
    placed = [field._replace(value=value) for field in placed]
    return placed, placed[0]._replace(free=free)


def to_cells(field: Field, path: NDArray[np.int64]) -> NDArray[np.int32]:
    """Return the map rows and columns, int32 [n, 2], of a walk of field indices."""
    rows, cols = np.divmod(path, field.width)
    return np.stack([rows + field.row, cols + field.col], axis=1).astype(np.int32)


def to_path(field: Field, cells: NDArray[np.integer]) -> NDArray[np.int64]:
    """Return the field indices, int64 [n], of map cells [n, 2]; the inverse of `to_cells`."""
    return ((cells[:, 0] - field.row) * field.width + cells[:, 1] - field.col).astype(np.int64)


@lean_kernel
def walk_value(
    value: NDArray[np.float64], path: NDArray[np.int64], n: int, gamma: float, seen: NDArray[np.bool_]
) -> float:
    """Return the sum of gamma^t times the value at each first visit; `seen` is all false before and after."""
    total, discount = 0.0, 1.0
    for t in range(n):
        cell = path[t]
        if not seen[cell]:
            seen[cell] = True
            total += discount * value[cell]
        discount *= gamma
    for t in range(n):
        seen[path[t]] = False
    return total


@lean_kernel
def team_value(
    value: NDArray[np.float64], paths: NDArray[np.int64], sizes: NDArray[np.int64], gamma: float,
    seen: NDArray[np.bool_],
) -> float:  # fmt: skip
    """Return what several walks are worth together: each cell pays once, at the earliest visit of any of them.

    `paths` [robots, cells] and `sizes` [robots]; `seen` is all false before and after.
    """
    total, discount = 0.0, 1.0
    for t in range(paths.shape[1]):
        for r in range(sizes.size):
            if t < sizes[r]:
                cell = paths[r, t]
                if not seen[cell]:
                    seen[cell] = True
                    total += discount * value[cell]
        discount *= gamma
    for r in range(sizes.size):
        for t in range(sizes[r]):
            seen[paths[r, t]] = False
    return total


@lean_kernel
def step_cost(field: Field, move: int) -> float:
    """Return what the index step `move` costs, inf when it is no move."""
    size = abs(move)
    if size == 1 or size == field.width:
        return 1.0
    if field.offsets.size == 8 and (size == field.width - 1 or size == field.width + 1):
        return float(field.costs[1])
    return np.inf


@lean_kernel
def walk_cost(field: Field, path: NDArray[np.int64], n: int) -> float:
    """Return the cost of the first `n` cells of a walk, inf when two of them are not neighbours."""
    cost = 0.0
    for t in range(1, n):
        cost += step_cost(field, path[t] - path[t - 1])
    return cost


@lean_kernel
def splice_cost(
    field: Field, path: NDArray[np.int64], n: int, at: int, cut: int, patch: NDArray[np.int64], put: int
) -> float:
    """Return what replacing `path[at:at + cut]` by `patch[:put]` adds to the cost of the walk."""
    cost = 0.0
    end = at + cut
    for t in range(at, min(end + 1, n)):
        cost -= step_cost(field, path[t] - path[t - 1])
    before = path[at - 1]
    for i in range(put):
        cost += step_cost(field, patch[i] - before)
        before = patch[i]
    if end < n:
        cost += step_cost(field, path[end] - before)
    return cost


@lean_kernel
def moves_between(a: int, b: int, width: int, kinds: int) -> int:
    """Return the fewest moves between two cells of an open grid."""
    rows = abs(a // width - b // width)
    cols = abs(a % width - b % width)
    return max(rows, cols) if kinds == 8 else rows + cols


@lean_kernel
def count_turns(path: NDArray[np.int64], n: int) -> int:
    """Return how often a walk changes direction."""
    turns = 0
    for t in range(2, n):
        if path[t] - path[t - 1] != path[t - 1] - path[t - 2]:
            turns += 1
    return turns


@lean_kernel
def may_step(field: Field, cell: int, k: int, left: float) -> bool:
    """Tell whether move `k` out of `cell` keeps the walk within its budget `left`, the way home included."""
    after = cell + field.offsets[k]
    if not field.free[after]:
        return False
    rest = left - field.costs[k]
    if rest < -BUDGET_TOLERANCE:
        return False
    needed = float(field.home[int(rest + 0.5) & 1, after])
    return bool(needed <= rest + BUDGET_TOLERANCE)


@lean_kernel
def capacity(field: Field) -> int:
    """Return the largest number of cells a walk can have."""
    return int(field.limit + BUDGET_TOLERANCE) + 1


@lean_kernel
def next_uniform(state: NDArray[np.uint64]) -> float:
    """Return a number in [0, 1) and advance `state`, uint64 [1] (splitmix64, Steele et al. 2014)."""
    state[0] += np.uint64(0x9E3779B97F4A7C15)
    z = state[0]
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return np.float64(z >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@lean_kernel
def next_below(state: NDArray[np.uint64], n: int) -> int:
    """Return an integer in [0, n) and advance `state`."""
    return int(next_uniform(state) * n)


@kernel
def fit(field: Field, way: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the longest beginning of a way that the budget allows, and from there the cheapest way to the end.

    `way` int64 [k] are neighbouring cells from the start on; without a given end the walk stops where they do.
    """
    path = np.empty(capacity(field) + 1, np.int64)
    path[0] = field.start
    n, left = 1, field.limit
    for i in range(1, way.size):
        move = -1
        for k in range(field.offsets.size):
            if path[n - 1] + field.offsets[k] == way[i] and may_step(field, path[n - 1], k, left):
                move = k
        if move < 0:
            break
        left -= field.costs[move]
        path[n] = way[i]
        n += 1
    while field.end >= 0 and path[n - 1] != field.end:
        best, least = -1, np.inf
        for k in range(field.offsets.size):
            if may_step(field, path[n - 1], k, left):
                after = path[n - 1] + field.offsets[k]
                onward = field.home[int(left - field.costs[k] + 0.5) & 1, after] + field.costs[k]
                if onward < least:
                    best, least = k, onward
        if best < 0:
            break
        left -= field.costs[best]
        path[n] = path[n - 1] + field.offsets[best]
        n += 1
    return path[:n].copy()
