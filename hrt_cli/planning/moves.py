"""Small changes of a walk that keep it connected, free and on its budget.

The changes are those of lattice-polymer sampling (corner flips, bumps in and out, tail regrowth, backbites;
Madras and Sokal 1988), 2-opt reversals of a segment, and regrowth of a segment between its ends. Every change
is a reversal, or one or two splices of the path: cells out, cells in. A splice is three numbers, `edit[s]` =
(position, cells cut, cells put; position -1 for none), and the cells put, `patches[s]`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hrt_cli.planning.jit import lean_kernel
from hrt_cli.planning.problem import BUDGET_TOLERANCE
from hrt_cli.planning.walk import Field, moves_between, next_below, next_uniform, splice_cost, step_cost

LONGEST_PATCH = 24
"""Most moves that a regrowth replaces at once."""

SPARE = 8
"""Room in a patch beyond `LONGEST_PATCH`, for the moves that a regrowth adds."""

REMOVAL_TRIES = 6
"""Random places looked at for a bump whose removal pays for another's insertion."""

SPUR_SHARE = 0.125
"""Share of the inserted bumps that go out to one cell and come back the same way."""

REVERSAL_SHARE = 0.08
"""Share of reversals among all changes."""

FLIP_SHARE, BUMP_SHARE, PATCH_SHARE = 0.30, 0.30, 0.22
"""Shares of the other changes; what is left regrows the tail (a patch where the end is given)."""


@lean_kernel
def _enter(count: NDArray[np.int64], value: NDArray[np.float64], cell: int) -> float:
    """Count one more visit of a cell; return what that adds to the score."""
    count[cell] += 1
    return value[cell] if count[cell] == 1 else 0.0


@lean_kernel
def _leave(count: NDArray[np.int64], value: NDArray[np.float64], cell: int) -> float:
    """Count one visit of a cell less; return what that takes from the score."""
    count[cell] -= 1
    return value[cell] if count[cell] == 0 else 0.0


@lean_kernel
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
    width, kinds = field.width, field.offsets.size
    stop = moves - 1 if target >= 0 else moves
    for step in range(stop):
        left = moves - step - 1
        bound = target >= 0 and moves_between(cell, target, width, kinds) >= left
        best, best_key = -1, -1.0
        for k in range(field.offsets.size):
            after = cell + field.offsets[k]
            if not field.free[after]:
                continue
            if bound and moves_between(after, target, width, kinds) > left:
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


@lean_kernel
def _removable(field: Field, path: NDArray[np.int64], n: int, j: int, cells: int) -> bool:
    """Tell whether the `cells` cells after position `j` can be cut out of the walk."""
    last = j + cells + 1
    if j < 0 or last >= n:
        return False
    return bool(step_cost(field, path[last] - path[j]) < np.inf)


@lean_kernel
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


@lean_kernel
def _cut_out(field: Field, path: NDArray[np.int64], at: int, cut: int, count: NDArray[np.int64]) -> float:
    """Uncount `path[at:at + cut]`; return the score lost."""
    lost = 0.0
    for t in range(at, at + cut):
        lost += _leave(count, field.value, path[t])
    return lost


@lean_kernel
def clear(edit: NDArray[np.int64]) -> None:
    """Make an edit of no splices."""
    for s in range(2):
        edit[s, 0], edit[s, 1], edit[s, 2] = -s, 0, 0


@lean_kernel
def _propose_flip(
    field: Field,
    path: NDArray[np.int64],
    n: int,
    count: NDArray[np.int64],
    edit: NDArray[np.int64],
    patch: NDArray[np.int64],
    state: NDArray[np.uint64],
) -> tuple[bool, float]:
    """Propose another cell between two cells of the walk."""
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


@lean_kernel
def _propose_bump(
    field: Field,
    path: NDArray[np.int64],
    n: int,
    count: NDArray[np.int64],
    edit: NDArray[np.int64],
    patch: NDArray[np.int64],
    state: NDArray[np.uint64],
) -> tuple[bool, float]:
    """Propose to put a bump in or to take one out."""
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


@lean_kernel
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
    clear(edit)
    kind = next_uniform(state)
    if kind < FLIP_SHARE:
        done, gain = _propose_flip(field, path, n, count, edit, patch, state)
        return done, gain
    if kind < FLIP_SHARE + BUMP_SHARE:
        done, gain = _propose_bump(field, path, n, count, edit, patch, state)
        return done, gain
    if kind < FLIP_SHARE + BUMP_SHARE + PATCH_SHARE or field.end >= 0:
        done, gain = _propose_patch(field, path, n, count, edit, patch, state)
        return done, gain
    cut = 1 + next_below(state, min(LONGEST_PATCH, n - 1))
    lost = _cut_out(field, path, n - cut, cut, count)
    edit[0, 0], edit[0, 1] = n - cut, cut
    done, gain, put = _grow(field, count, path[n - cut - 1], -1, cut, patch, state)
    edit[0, 2] = put
    return done, gain - lost


@lean_kernel
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
    nearest = moves_between(path[i], path[i + span], field.width, field.offsets.size)
    if moves < max(nearest, 1) or (moves == span and span == nearest and nearest < 2):
        return False, 0.0
    lost = _cut_out(field, path, i + 1, span - 1, count)
    edit[0, 0], edit[0, 1] = i + 1, span - 1
    done, gain, put = _grow(field, count, path[i], path[i + span], moves, patch, state)
    edit[0, 2] = put
    return done, gain - lost


@lean_kernel
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
    at_tail = field.end < 0 and (next_uniform(state) < 0.5 or abs(need) > 2)
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


@lean_kernel
def undo(
    path: NDArray[np.int64], count: NDArray[np.int64], edit: NDArray[np.int64], patches: NDArray[np.int64]
) -> None:
    """Take a proposed change's visits back."""
    for s in range(2):
        for t in range(edit[s, 0], edit[s, 0] + edit[s, 1]):
            count[path[t]] += 1
        for i in range(edit[s, 2]):
            count[patches[s, i]] -= 1


@lean_kernel
def apply(
    path: NDArray[np.int64],
    n: int,
    edit: NDArray[np.int64],
    patches: NDArray[np.int64],
    trial: NDArray[np.int64],
) -> tuple[int, int, int]:
    """Make a change in `trial`, which equals `path` before; return the range that differs and the new length."""
    first = 0 if edit[1, 0] < 0 or edit[0, 0] <= edit[1, 0] else 1
    low = edit[first, 0]
    read, m = low, low
    for turn in range(2):
        s = first if turn == 0 else 1 - first
        if edit[s, 0] < 0:
            continue
        while read < edit[s, 0]:
            trial[m] = path[read]
            read += 1
            m += 1
        for i in range(edit[s, 2]):
            trial[m] = patches[s, i]
            m += 1
        read += edit[s, 1]
    if m == read:
        return low, m, n
    while read < n:
        trial[m] = path[read]
        read += 1
        m += 1
    return low, m, m


@lean_kernel
def reverse(
    field: Field,
    path: NDArray[np.int64],
    n: int,
    where: NDArray[np.int64],
    trial: NDArray[np.int64],
    state: NDArray[np.uint64],
) -> tuple[int, int]:
    """Reverse one segment in `trial` (2-opt, or a backbite at its end); return its range, empty for none."""
    i = next_below(state, n - 1)
    cell = path[i] + field.offsets[next_below(state, field.offsets.size)]
    j = where[cell]
    if j <= i + 1 or j >= n or path[j] != cell:
        return 0, 0
    if j == n - 1:
        if field.end >= 0:
            return 0, 0
    elif step_cost(field, path[j + 1] - path[i + 1]) == np.inf:
        return 0, 0
    for t in range(i + 1, j + 1):
        trial[t] = path[i + 1 + j - t]
    return i + 1, j + 1


@lean_kernel
def change(
    field: Field,
    limit: float,
    path: NDArray[np.int64],
    n: int,
    cost: float,
    count: NDArray[np.int64],
    edit: NDArray[np.int64],
    patches: NDArray[np.int64],
    state: NDArray[np.uint64],
) -> tuple[bool, float, float]:
    """Propose a whole change that keeps the budget `limit`; return whether there is one, its gain, and the new cost."""
    done, gain = _propose(field, path, n, count, edit, patches[0], state)
    if not done:
        return False, 0.0, cost
    if field.exact:
        need = edit[0, 2] - edit[0, 1]
    else:
        cost += splice_cost(field, path, n, edit[0, 0], edit[0, 1], patches[0], edit[0, 2])
        over = cost - limit
        need = int(np.ceil(over - BUDGET_TOLERANCE)) if over > 0 else -int(-over + BUDGET_TOLERANCE)
    if need != 0:
        done, more = _compensate(field, path, n, need, count, edit, patches[1], state)
        gain += more
        if done and not field.exact:
            cost += splice_cost(field, path, n, edit[1, 0], edit[1, 1], patches[1], edit[1, 2])
        elif not done and not field.exact and need < 0:
            done = True
            for i in range(edit[1, 2]):
                gain -= _leave(count, field.value, patches[1, i])
            edit[1, 0], edit[1, 1], edit[1, 2] = -1, 0, 0
    return done and cost <= limit + BUDGET_TOLERANCE, gain, cost
