"""Simulated annealing on a walk: small changes that keep it connected, free and exactly on its budget.

The changes are those of lattice-polymer sampling (corner flips, bumps in and out, tail regrowth, backbites;
Madras and Sokal 1988), 2-opt reversals of a segment, and regrowth of a segment between its ends. Every change
is one or two splices of the path: cells out, cells in.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from hrt_cli.planning.walk import (
    Field,
    capacity,
    count_turns,
    next_below,
    next_uniform,
    step_cost,
    walk_cost,
    walk_value,
)

HOTTEST = 0.20
COLDEST = 0.004
"""First and last temperature of the annealing, in mean scores of the cells of the walk."""

LONGEST_PATCH = 24
"""Most moves that a regrowth replaces at once."""

REMOVAL_TRIES = 6
"""Random places looked at for a bump whose removal pays for another's insertion."""

SPUR_SHARE = 0.125
"""Share of the inserted bumps that go out to one cell and come back the same way."""

FLIP_SHARE, BUMP_SHARE, PATCH_SHARE, TAIL_SHARE = 0.30, 0.30, 0.22, 0.10
"""How often each change is proposed; the rest are reversals."""

TIE = 1e-12
"""Relative difference below which two values are equal and the walk with fewer turns is preferred."""


@njit(cache=True, nogil=True)
def _enter(count: NDArray[np.int64], value: NDArray[np.float64], cell: int) -> float:
    """Count one more visit of a cell; return what that adds to the score."""
    count[cell] += 1
    return value[cell] if count[cell] == 1 else 0.0


@njit(cache=True, nogil=True)
def _leave(count: NDArray[np.int64], value: NDArray[np.float64], cell: int) -> float:
    """Count one visit of a cell less; return what that takes from the score."""
    count[cell] -= 1
    return value[cell] if count[cell] == 0 else 0.0


@njit(cache=True, nogil=True)
def _grow(
    field: Field,
    count: NDArray[np.int64],
    cell: int,
    target: int,
    moves: int,
    patch: NDArray[np.int64],
    state: NDArray[np.uint64],
) -> tuple[bool, float, int]:
    """Grow `moves` random moves from `cell` into `patch`, preferring rich unvisited cells.

    With `target` >= 0 the last move must end on it. Returns whether that worked, the score gained, and the
    number of cells entered, `target` not counted; their visits are counted.
    """
    gain, grown = 0.0, 0
    width = field.width
    stop = moves - 1 if target >= 0 else moves
    for step in range(stop):
        left = moves - step - 1
        best, best_key = -1, -1.0
        for k in range(field.offsets.size):
            after = cell + field.offsets[k]
            if not field.free[after]:
                continue
            if target >= 0 and _moves_between(after, target, width, field.offsets.size) > left:
                continue
            worth = field.value[after] if count[after] == 0 else 0.0
            key = next_uniform(state) * (worth + 1e-3 * field.value[after] + 1e-12)
            if key > best_key:
                best, best_key = after, key
        if best < 0:
            return False, gain, grown
        cell = best
        patch[grown] = cell
        grown += 1
        gain += _enter(count, field.value, cell)
    reached = target < 0 or step_cost(field, target - cell) < np.inf
    return reached, gain, grown


@njit(cache=True, nogil=True)
def _moves_between(a: int, b: int, width: int, kinds: int) -> int:
    """Return the fewest moves between two cells of an open grid."""
    rows = abs(a // width - b // width)
    cols = abs(a % width - b % width)
    return max(rows, cols) if kinds == 8 else rows + cols


@njit(cache=True, nogil=True)
def _removable(field: Field, path: NDArray[np.int64], n: int, j: int, cells: int) -> bool:
    """Tell whether the `cells` cells after position `j` can be cut out of the walk."""
    last = j + cells + 1
    if j < 0 or last >= n:
        return False
    return step_cost(field, path[last] - path[j]) < np.inf


@njit(cache=True, nogil=True)
def _bump(field: Field, a: int, b: int, patch: NDArray[np.int64], state: NDArray[np.uint64]) -> int:
    """Write into `patch` the cells of a detour between neighbours `a` and `b`; return how many, 0 for none."""
    offsets = field.offsets
    if offsets.size == 8 and next_uniform(state) < 0.75:
        cell = a + offsets[next_below(state, 8)]
        if cell != b and field.free[cell] and step_cost(field, b - cell) < np.inf:
            patch[0] = cell
            return 1
        return 0
    side = offsets[next_below(state, offsets.size)]
    first, second = a + side, b + side
    if next_uniform(state) < SPUR_SHARE:
        second = a
    if first == b or not field.free[first]:
        return 0
    if not field.free[second] or (second == a and first == b):
        return 0
    patch[0], patch[1] = first, second
    return 2


@njit(cache=True, nogil=True)
def _splice_cost(
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


@njit(cache=True, nogil=True)
def _cut_out(field: Field, path: NDArray[np.int64], at: int, cut: int, count: NDArray[np.int64]) -> float:
    """Uncount `path[at:at + cut]`; return the score lost."""
    lost = 0.0
    for t in range(at, at + cut):
        lost += _leave(count, field.value, path[t])
    return lost


@njit(cache=True, nogil=True)
def _propose(
    field: Field,
    path: NDArray[np.int64],
    n: int,
    count: NDArray[np.int64],
    edit: NDArray[np.int64],
    patch: NDArray[np.int64],
    state: NDArray[np.uint64],
) -> tuple[bool, float]:
    """Propose the first splice of a change, in `edit[0]` = (at, cut, put) and `patch`.

    Returns whether there is one and the score gained; visits are counted as if it were made.
    """
    edit[:, :] = 0
    edit[1, 0] = -1
    kind = next_uniform(state)
    if kind < FLIP_SHARE:
        if n < 3:
            return False, 0.0
        i = 1 + next_below(state, n - 2)
        a, b = path[i - 1], path[i + 1]
        if field.offsets.size == 4 and a != b:
            cell = a + b - path[i]
        else:
            cell = a + field.offsets[next_below(state, field.offsets.size)]
        if cell == path[i] or not field.free[cell] or step_cost(field, b - cell) == np.inf:
            return False, 0.0
        edit[0, 0], edit[0, 1], edit[0, 2] = i, 1, 1
        patch[0] = cell
        return True, _enter(count, field.value, cell) - _leave(count, field.value, path[i])
    if kind < FLIP_SHARE + BUMP_SHARE:
        i = next_below(state, n - 1)
        if next_uniform(state) < 0.5:
            put = _bump(field, path[i], path[i + 1], patch, state)
            gain = 0.0
            for k in range(put):
                gain += _enter(count, field.value, patch[k])
            edit[0, 0], edit[0, 2] = i + 1, put
            return put > 0, gain
        cut = 1 + next_below(state, 2) if field.offsets.size == 8 else 2
        if not _removable(field, path, n, i, cut):
            return False, 0.0
        edit[0, 0], edit[0, 1] = i + 1, cut
        return True, -_cut_out(field, path, i + 1, cut, count)
    if kind < FLIP_SHARE + BUMP_SHARE + PATCH_SHARE or field.returns:
        return _propose_patch(field, path, n, count, edit, patch, state)
    cut = 1 + next_below(state, min(LONGEST_PATCH, n - 1))
    lost = _cut_out(field, path, n - cut, cut, count)
    edit[0, 0], edit[0, 1] = n - cut, cut
    done, gain, put = _grow(field, count, path[n - cut - 1], -1, cut, patch, state)
    edit[0, 2] = put
    return done, gain - lost


@njit(cache=True, nogil=True)
def _propose_patch(
    field: Field,
    path: NDArray[np.int64],
    n: int,
    count: NDArray[np.int64],
    edit: NDArray[np.int64],
    patch: NDArray[np.int64],
    state: NDArray[np.uint64],
) -> tuple[bool, float]:
    """Propose to regrow a segment between its ends, sometimes with more or fewer moves."""
    if n < 4:
        return False, 0.0
    span = 2 + next_below(state, min(LONGEST_PATCH, n - 1) - 1)
    i = next_below(state, n - span)
    moves = span
    if next_uniform(state) < 0.4:
        moves += 2 * (next_below(state, 7) - 3)
        moves = min(moves, LONGEST_PATCH)
    nearest = _moves_between(path[i], path[i + span], field.width, field.offsets.size)
    if moves < max(nearest, 1) or (moves == span and span == nearest and nearest < 2):
        return False, 0.0
    lost = _cut_out(field, path, i + 1, span - 1, count)
    edit[0, 0], edit[0, 1] = i + 1, span - 1
    done, gain, put = _grow(field, count, path[i], path[i + span], moves, patch, state)
    edit[0, 2] = put
    return done, gain - lost


@njit(cache=True, nogil=True)
def _compensate(
    field: Field,
    path: NDArray[np.int64],
    n: int,
    need: int,
    count: NDArray[np.int64],
    edit: NDArray[np.int64],
    patch: NDArray[np.int64],
    state: NDArray[np.uint64],
) -> tuple[bool, float]:
    """Add a second splice, `edit[1]` and `patch`, that takes `need` cells out (puts -need in when negative)."""
    at, end = edit[0, 0], edit[0, 0] + edit[0, 1]
    at_tail = not field.returns and (next_uniform(state) < 0.5 or abs(need) > 2)
    if at_tail and need > 0:
        if n - need <= end:
            return False, 0.0
        edit[1, 0], edit[1, 1] = n - need, need
        return True, -_cut_out(field, path, n - need, need, count)
    if at_tail:
        if end >= n or -need > patch.size:
            return False, 0.0
        edit[1, 0] = n
        done, gain, put = _grow(field, count, path[n - 1], -1, -need, patch, state)
        edit[1, 2] = put
        return done, gain
    if abs(need) > 2:
        return False, 0.0
    for _ in range(REMOVAL_TRIES):
        j = next_below(state, n - 1)
        if need > 0:
            if (j >= end or j + need + 1 < at) and _removable(field, path, n, j, need):
                edit[1, 0], edit[1, 1] = j + 1, need
                return True, -_cut_out(field, path, j + 1, need, count)
        elif j >= end or j + 1 < at:
            put = _bump(field, path[j], path[j + 1], patch, state)
            if put == -need:
                gain = 0.0
                for k in range(put):
                    gain += _enter(count, field.value, patch[k])
                edit[1, 0], edit[1, 2] = j + 1, put
                return True, gain
    return False, 0.0


@njit(cache=True, nogil=True)
def _undo(
    path: NDArray[np.int64], count: NDArray[np.int64], edit: NDArray[np.int64], patches: NDArray[np.int64]
) -> None:
    """Take a proposed change's visits back."""
    for s in range(2):
        for t in range(edit[s, 0], edit[s, 0] + edit[s, 1]):
            count[path[t]] += 1
        for i in range(edit[s, 2]):
            count[patches[s, i]] -= 1


@njit(cache=True, nogil=True)
def _apply(
    path: NDArray[np.int64],
    n: int,
    edit: NDArray[np.int64],
    patches: NDArray[np.int64],
    trial: NDArray[np.int64],
) -> int:
    """Write the changed walk into `trial`; return its number of cells."""
    first = 0 if edit[1, 0] < 0 or edit[0, 0] <= edit[1, 0] else 1
    read, m = 0, 0
    for turn in range(2):
        s = first if turn == 0 else 1 - first
        if edit[s, 0] < 0:
            continue
        size = edit[s, 0] - read
        trial[m : m + size] = path[read : edit[s, 0]]
        m += size
        put = edit[s, 2]
        trial[m : m + put] = patches[s, :put]
        m += put
        read = edit[s, 0] + edit[s, 1]
    trial[m : m + n - read] = path[read:n]
    return m + n - read


@njit(cache=True, nogil=True)
def _reverse(
    field: Field,
    path: NDArray[np.int64],
    n: int,
    where: NDArray[np.int64],
    trial: NDArray[np.int64],
    state: NDArray[np.uint64],
) -> int:
    """Write into `trial` the walk with one segment reversed (2-opt, or a backbite at its end); 0 for none."""
    i = next_below(state, n - 1)
    cell = path[i] + field.offsets[next_below(state, field.offsets.size)]
    j = where[cell]
    if j <= i + 1 or j >= n or path[j] != cell:
        return 0
    if j == n - 1:
        if field.returns:
            return 0
    elif step_cost(field, path[j + 1] - path[i + 1]) == np.inf:
        return 0
    trial[: i + 1] = path[: i + 1]
    for t in range(i + 1, j + 1):
        trial[t] = path[i + 1 + j - t]
    trial[j + 1 : n] = path[j + 1 : n]
    return n


@njit(cache=True, nogil=True)
def _change(
    field: Field,
    path: NDArray[np.int64],
    n: int,
    cost: float,
    count: NDArray[np.int64],
    edit: NDArray[np.int64],
    patches: NDArray[np.int64],
    state: NDArray[np.uint64],
) -> tuple[bool, float, float]:
    """Propose a whole change that keeps the budget; return whether there is one, its gain, and the new cost."""
    done, gain = _propose(field, path, n, count, edit, patches[0], state)
    if not done:
        return False, 0.0, cost
    if field.exact:
        need = edit[0, 2] - edit[0, 1]
    else:
        cost += _splice_cost(field, path, n, edit[0, 0], edit[0, 1], patches[0], edit[0, 2])
        over = cost - field.limit
        need = int(np.ceil(over - 1e-9)) if over > 0 else -int(-over + 1e-9)
    if need != 0:
        done, more = _compensate(field, path, n, need, count, edit, patches[1], state)
        gain += more
        if done and not field.exact:
            cost += _splice_cost(field, path, n, edit[1, 0], edit[1, 1], patches[1], edit[1, 2])
        elif not done and not field.exact and need < 0:
            done = True
            for i in range(edit[1, 2]):
                gain -= _leave(count, field.value, patches[1, i])
            edit[1, 0], edit[1, 1], edit[1, 2] = -1, 0, 0
    return done and cost <= field.limit + 1e-9, gain, cost


@njit(cache=True, nogil=True)
def anneal(
    field: Field,
    walk: NDArray[np.int64],
    gamma: float,
    proposals: int,
    hot: float,
    cold: float,
    tidy: bool,
    seed: int,
) -> NDArray[np.int64]:
    """Anneal a walk and return the best one met.

    Parameters
    ----------
    field : Field
        The reachable window.
    walk : ndarray, int64 [n]
        A walk that keeps the budget.
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
    """
    state = np.full(1, np.uint64(seed), np.uint64)
    n = walk.size
    path = np.zeros(capacity(field) + 1, np.int64)
    path[:n] = walk
    trial = np.zeros_like(path)
    count = np.zeros(field.free.size, np.int64)
    where = np.full(field.free.size, -1)
    seen = np.zeros(field.free.size, np.bool_)
    for t in range(n):
        count[path[t]] += 1
        where[path[t]] = t
    edit = np.zeros((2, 3), np.int64)
    patches = np.zeros((2, LONGEST_PATCH + 8), np.int64)
    value = walk_value(field.value, path, n, gamma, seen)
    cost = walk_cost(field, path, n)
    turns = count_turns(path, n)
    best, best_n, best_value, best_turns = path.copy(), n, value, turns
    cooling = (cold / hot) ** (1.0 / max(proposals, 1)) if hot > 0 else 1.0
    heat = hot
    reversal = 1.0 - (FLIP_SHARE + BUMP_SHARE + PATCH_SHARE + TAIL_SHARE)
    for _ in range(proposals):
        heat *= cooling
        reversing = next_uniform(state) < reversal
        if reversing:
            m, gain = _reverse(field, path, n, where, trial, state), 0.0
            new_cost = cost
            if m > 0 and not field.exact:
                new_cost = walk_cost(field, trial, m)
            if m == 0 or new_cost > field.limit + 1e-9:
                continue
        else:
            done, gain, new_cost = _change(field, path, n, cost, count, edit, patches, state)
            hopeless = gamma == 1.0 and gain < 0.0 and (tidy or next_uniform(state) >= np.exp(gain / heat))
            if not done or hopeless:
                _undo(path, count, edit, patches)
                continue
            m = _apply(path, n, edit, patches, trial)
        accepted = True
        if gamma != 1.0:
            gain = walk_value(field.value, trial, m, gamma, seen) - value
            accepted = gain >= 0.0 or (not tidy and next_uniform(state) < np.exp(gain / heat))
        new_turns = count_turns(trial, m) if tidy else 0
        if tidy and gain <= TIE * value and new_turns > turns:
            accepted = False
        if not accepted:
            if not reversing:
                _undo(path, count, edit, patches)
            continue
        path, trial = trial, path
        n, cost, value, turns = m, new_cost, value + gain, new_turns
        for t in range(n):
            where[path[t]] = t
        if value > best_value * (1.0 + TIE) or (tidy and value >= best_value and turns < best_turns):
            best[:n] = path[:n]
            best_n, best_value, best_turns = n, value, turns
    return best[:best_n].copy()
