"""Simulated annealing on a walk, with the changes of `moves`."""

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
from hrt_cli.planning.walk import Field, capacity, count_turns, next_uniform, walk_cost, walk_value

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
            cost = walk_cost(field, trial, n)
            if cost > field.limit + BUDGET_TOLERANCE:
                for t in range(low, high):
                    trial[t] = path[t]
                high = 0
        return low, high, n, 0.0, cost
    done, gain, cost = change(field, path, n, cost, count, edit, patches, state)
    if not done or (heat >= 0.0 and not _accepts(gain, heat, state)):
        undo(path, count, edit, patches)
        return 0, 0, n, 0.0, cost
    low, high, m = apply(path, n, edit, patches, trial)
    return low, high, m, gain, cost


@kernel
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
    trial, best = path.copy(), path.copy()
    count = np.zeros(field.free.size, np.int64)
    where = np.full(field.free.size, -1)
    seen = np.zeros(field.free.size, np.bool_)
    for t in range(n):
        count[path[t]] += 1
        where[path[t]] = t
    edit = np.zeros((2, 3), np.int64)
    patches = np.zeros((2, LONGEST_PATCH + SPARE), np.int64)
    value, cost = walk_value(field.value, path, n, gamma, seen), walk_cost(field, path, n)
    turns = count_turns(path, n)
    best_n, best_value, best_turns = n, value, turns
    cooling = (cold / hot) ** (1.0 / max(proposals, 1)) if hot > 0.0 else 1.0
    heat = hot
    greedy = tidy or gamma != 1.0
    for _ in range(proposals):
        heat *= cooling
        low, high, m, gain, new_cost = _tentative(
            field, path, n, cost, -1.0 if greedy else heat, count, where, edit, patches, trial, state
        )
        if high == 0:
            continue
        if greedy:
            gain = walk_value(field.value, trial, m, gamma, seen) - value
            new_turns = count_turns(trial, m) if tidy else 0
            straighter = not tidy or new_turns <= turns or gain > TIE * value
            if not (straighter and _accepts(gain, 0.0 if tidy else heat, state)):
                undo(path, count, edit, patches)
                trial[low : max(high, n)] = path[low : max(high, n)]
                continue
            turns = new_turns
        for t in range(low, high):
            path[t] = trial[t]
            where[path[t]] = t
        n, cost, value = m, new_cost, value + gain
        if value > best_value * (1.0 + TIE) or (tidy and value >= best_value and turns < best_turns):
            best[:n] = path[:n]
            best_n, best_value, best_turns = n, value, turns
    return best[:best_n].copy()
