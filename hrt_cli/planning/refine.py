"""Simulated annealing on the walks of one robot or of several, with the changes of `moves`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hrt_cli.planning.jit import kernel, lean_kernel
from hrt_cli.planning.moves import (
    LONGEST_PATCH,
    REVERSAL_SHARE,
    SPARE,
    apply,
    change,
    clear,
    reverse,
    undo,
)
from hrt_cli.planning.problem import BUDGET_TOLERANCE
from hrt_cli.planning.walk import (
    Field,
    count_turns,
    next_below,
    next_uniform,
    step_cost,
    team_value,
    walk_cost,
)

HOTTEST = 0.20
COLDEST = 0.004
"""First and last temperature of the annealing, in mean scores of the cells of the walk."""

TIE = 1e-12
"""Relative difference below which two values are equal and the walk with fewer turns is preferred."""


@lean_kernel
def _accepts(gain: float, heat: float, state: NDArray[np.uint64]) -> bool:
    """Accept a gain always and a loss with the chance exp(gain / heat) (Metropolis et al. 1953)."""
    return gain >= 0.0 or (heat > 0.0 and next_uniform(state) < np.exp(gain / heat))


@lean_kernel
def _tentative(
    field: Field,
    limit: float,
    path: NDArray[np.int64],
    n: int,
    cost: float,
    heat: float,
    count: NDArray[np.int64],
    where: NDArray[np.int64],
    edit: NDArray[np.int64],
    patches: NDArray[np.int64],
    trial: NDArray[np.int64],
    state: NDArray[np.uint64],
) -> tuple[int, int, int, float, float]:
    """Make one change in `trial` if it fits the budget and its plain gain is accepted at `heat`.

    A negative heat leaves the judgement to the caller. Returns the range that differs (ending at 0 for no
    change), the new number of cells, the gain and the new cost.
    """
    if next_uniform(state) < REVERSAL_SHARE:
        clear(edit)
        low, high = reverse(field, path, n, where, trial, state)
        if high > 0 and not field.exact:
            # Turned round, the segment costs what it did: its two joints are new.
            cost += step_cost(field, trial[low] - path[low - 1]) - step_cost(field, path[low] - path[low - 1])
            if high < n:
                cost += step_cost(field, path[high] - trial[high - 1]) - step_cost(field, path[high] - path[high - 1])
            if cost > limit + BUDGET_TOLERANCE:
                for t in range(low, high):
                    trial[t] = path[t]
                high = 0
        return low, high, n, 0.0, cost
    done, gain, cost = change(field, limit, path, n, cost, count, edit, patches, state)
    if not done or (heat >= 0.0 and not _accepts(gain, heat, state)):
        undo(path, count, edit, patches)
        return 0, 0, n, 0.0, cost
    low, high, m = apply(path, n, edit, patches, trial)
    return low, high, m, gain, cost


@lean_kernel
def _turns_in(path: NDArray[np.int64], low: int, high: int) -> int:
    """Return how often the walk changes direction at a cell of [low, high), both neighbours being in the walk."""
    turns = 0
    for t in range(low, high):
        if path[t + 1] - path[t] != path[t] - path[t - 1]:
            turns += 1
    return turns


@lean_kernel
def _turns_gained(path: NDArray[np.int64], n: int, trial: NDArray[np.int64], m: int, low: int, high: int) -> int:
    """Return by how many turns `trial` has more than `path`, from which it differs in [low, high)."""
    first = max(low - 1, 1)
    if m != n:
        return int(_turns_in(trial, first, m - 1) - _turns_in(path, first, n - 1))
    last = min(high + 1, n - 1)
    return int(_turns_in(trial, first, last) - _turns_in(path, first, last))


@lean_kernel
def _discounted_gain(
    value: NDArray[np.float64],
    discount: NDArray[np.float64],
    path: NDArray[np.int64],
    n: int,
    trial: NDArray[np.int64],
    m: int,
    low: int,
    high: int,
    count: NDArray[np.int64],
    met: NDArray[np.int64],
    stamp: NDArray[np.int64],
    mark: int,
) -> float:
    """Return what `trial`, which differs from `path` in [low, high), gains in discounted score.

    `met` is the first visit of each cell in `path` (at least `n` where there is none), `count` the visits in
    `trial`. Where every cell that changes is visited once, before and after, the rest of the walk pays as before.
    Uses up the marks `mark` and `mark` + 1 of `stamp`.
    """
    local = m == n
    if local:
        for t in range(low, high):
            if count[trial[t]] != 1 or met[path[t]] != t:
                local = False
                break
            stamp[trial[t]] = mark
    if local:
        gain = 0.0
        for t in range(low, high):
            # Left for good, or visited within the range alone.
            if count[path[t]] > 1 or (count[path[t]] == 1 and stamp[path[t]] != mark):
                local = False
                break
            gain += discount[t] * (value[trial[t]] - value[path[t]])
        if local:
            return gain
    mark += 1
    gain = 0.0
    for t in range(low, m):
        cell = trial[t]
        if met[cell] >= low and stamp[cell] != mark:
            stamp[cell] = mark
            gain += discount[t] * value[cell]
    for t in range(low, n):
        if met[path[t]] == t:
            gain -= discount[t] * value[path[t]]
    return gain


@kernel
def anneal(
    field: Field,
    limits: NDArray[np.float64],
    walks: NDArray[np.int64],
    sizes: NDArray[np.int64],
    gamma: float,
    proposals: int,
    hot: float,
    cold: float,
    tidy: bool,
    seed: int,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Anneal the walks of all robots together and return the best ones met.

    A cell pays once, whichever robot comes; every change is made to one walk, drawn at random, and judged by what
    all of them collect.

    Parameters
    ----------
    field : Field
        The window, its free cells those that some robot can enter.
    limits : ndarray, float64 [robots]
        Budget of each robot, in cell units.
    walks : ndarray, int64 [robots, cells]
        Walks that keep the budgets; the columns hold the longest walk that the budgets allow.
    sizes : ndarray, int64 [robots]
        Number of cells of each walk.
    gamma : float
        Discount per move; 1 collects the plain score.
    proposals : int
        Changes proposed.
    hot, cold : float
        First and last temperature, in units of score (Metropolis acceptance, geometric cooling; Kirkpatrick
        et al. 1983).
    tidy : bool
        Accept no loss at all, and among equals only walks with no more turns: straightens without cost.
    seed : int
        Random seed.

    Returns
    -------
    walks : ndarray, int64 [robots, cells]
    sizes : ndarray, int64 [robots]
    """
    state = np.full(1, np.uint64(seed), np.uint64)
    robots, room = walks.shape[0], walks.shape[1] + 1
    paths = np.zeros((robots, room), np.int64)
    paths[:, : room - 1] = walks
    trials, best = paths.copy(), paths.copy()
    lengths, best_lengths = sizes.copy(), sizes.copy()
    count = np.zeros(field.free.size, np.int64)
    wheres = np.full((robots, field.free.size), -1)
    costs = np.zeros(robots)
    turns = 0
    for r in range(robots):
        for t in range(sizes[r]):
            count[paths[r, t]] += 1
            wheres[r, paths[r, t]] = t
        costs[r] = walk_cost(field, paths[r], sizes[r])
        turns += count_turns(paths[r], sizes[r])
    edit = np.zeros((2, 3), np.int64)
    patches = np.zeros((2, LONGEST_PATCH + SPARE), np.int64)
    seen = np.zeros(field.free.size, np.bool_)
    value = team_value(field.value, paths, lengths, gamma, seen)
    best_value, best_turns = value, turns
    cooling = (cold / hot) ** (1.0 / max(proposals, 1)) if hot > 0.0 else 1.0
    heat = hot
    early = gamma != 1.0
    discount = np.ones(room)
    for t in range(1, room):
        discount[t] = discount[t - 1] * gamma
    lone = early and robots == 1
    far = 1 << 60
    met = np.full(field.free.size if lone else 0, far)
    stamp = np.zeros(met.size, np.int64)
    mark = 0
    if lone:
        for t in range(lengths[0] - 1, -1, -1):
            met[paths[0, t]] = t
    r = 0
    path, trial, where = paths[0], trials[0], wheres[0]
    for _ in range(proposals):
        heat *= cooling
        if robots > 1:
            r = next_below(state, robots)
            path, trial, where = paths[r], trials[r], wheres[r]
        n = lengths[r]
        low, high, m, gain, new_cost = _tentative(
            field, limits[r], path, n, costs[r], -1.0 if early or tidy else heat, count, where, edit, patches,
            trial, state,
        )  # fmt: skip
        if high == 0:
            continue
        if lone:
            mark += 2
            gain = _discounted_gain(field.value, discount, path, n, trial, m, low, high, count, met, stamp, mark)
        elif early:
            lengths[r] = m
            gain = team_value(field.value, trials, lengths, gamma, seen) - value
            lengths[r] = n
        more_turns = 0
        if tidy or early:
            fits = gain >= -TIE * value if tidy else _accepts(gain, heat, state)
            if fits and tidy:
                more_turns = _turns_gained(path, n, trial, m, low, high)
                fits = more_turns <= 0 or gain > TIE * value
            if not fits:
                undo(path, count, edit, patches)
                for t in range(low, max(high, n)):
                    trial[t] = path[t]
                continue
        if lone:
            for t in range(low, n):
                if met[path[t]] >= low:
                    met[path[t]] = far
            for t in range(m - 1, low - 1, -1):
                if met[trial[t]] >= low:
                    met[trial[t]] = t
        turns += more_turns
        for t in range(low, high):
            path[t] = trial[t]
            where[path[t]] = t
        lengths[r], costs[r], value = m, new_cost, value + gain
        if value > best_value * (1.0 + TIE) or (tidy and value >= best_value and turns < best_turns):
            best[:] = paths
            best_lengths[:] = lengths
            best_value, best_turns = value, turns
    return best[:, : room - 1].copy(), best_lengths


@kernel
def widen(field: Field, limit: float, walk: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return a walk with the best detours put in, one after the other, until none pays or fits the budget.

    A detour replaces a move by two or three over cells beside it, where the gain per cost is highest.
    """
    room = int(limit + BUDGET_TOLERANCE) + 1
    path = np.zeros(max(room, walk.size) + 2, np.int64)
    n = min(walk.size, room)
    path[:n] = walk[:n]
    seen = np.zeros(field.free.size, np.bool_)
    for t in range(n):
        seen[path[t]] = True
    left = limit - walk_cost(field, path, n)
    while True:
        # A last single move cannot leave the end and come back: it is spent on the way, even for nothing.
        best = -1.0 if field.exact and field.end >= 0 and left < 2.0 else 0.0
        at, put, first, second, spent = -1, 0, 0, 0, 0.0
        for i in range(n - 1):
            a, b = path[i], path[i + 1]
            straight = step_cost(field, b - a)
            for k in range(field.offsets.size):
                c = a + field.offsets[k]
                if c == b or not field.free[c]:
                    continue
                gain = 0.0 if seen[c] else field.value[c]
                over = field.costs[k] + step_cost(field, b - c) - straight
                if over <= left + BUDGET_TOLERANCE and gain > best * over and n + 1 <= room:
                    best, at, put, first, spent = gain / max(over, TIE), i, 1, c, over
                d = b + field.offsets[k]
                over = 2.0 * field.costs[k]
                if field.free[d] and d != a and over <= left + BUDGET_TOLERANCE and n + 2 <= room:
                    gain += 0.0 if seen[d] else field.value[d]
                    if gain > best * over:
                        best, at, put, first, second, spent = gain / over, i, 2, c, d, over
        if at < 0:
            return path[:n].copy()
        for t in range(n - 1, at, -1):
            path[t + put] = path[t]
        path[at + 1] = first
        seen[first] = True
        if put == 2:
            path[at + 2] = second
            seen[second] = True
        n += put
        left -= spent
