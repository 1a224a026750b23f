from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from plan_worlds import cost_of, is_open, total_score, worlds

from hrt_cli.planning.baselines import greedy_walk, random_walk
from hrt_cli.planning.moves import LONGEST_PATCH, SPARE, apply, change, clear, reverse, undo
from hrt_cli.planning.refine import anneal
from hrt_cli.planning.walk import build_field, capacity, to_cells, walk_value

PROPOSALS = 150


def tuples(field, path):
    return [(int(r), int(c)) for r, c in to_cells(field, path)]


def price(problem, cells):
    assert all(is_open(problem, cell) for cell in cells)
    return sum(cost_of(problem, a, b) for a, b in itertools.pairwise(cells))


def visits(field, path):
    return np.bincount(path, minlength=field.free.size)


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(problem=worlds(most_moves=40), seed=st.integers(0, 10_000))
def test_changes_keep_the_books(problem, seed):
    """Gain, cost and visit counts of every proposed change equal those of the walk it makes."""
    field = build_field(problem)
    walk = random_walk(field, seed)
    if walk.size < 2:
        return
    n = walk.size
    path = np.zeros(capacity(field) + 1, np.int64)
    path[:n] = walk
    trial, count = path.copy(), visits(field, walk)
    where = np.full(field.free.size, -1)
    where[path[:n]] = np.arange(n)
    edit, patches = np.zeros((2, 3), np.int64), np.zeros((2, LONGEST_PATCH + SPARE), np.int64)
    state = np.full(1, seed, np.uint64)
    cells = tuples(field, path[:n])
    cost = price(problem, cells)
    for turn in range(PROPOSALS):
        new_cost = cost
        if turn % 5 == 0:
            clear(edit)
            low, high = reverse(field, path, n, where, trial, state)
            done, gain, m = high > 0, 0.0, n
            new_cost = price(problem, tuples(field, trial[:n]))
        else:
            done, gain, new_cost = change(field, path, n, cost, count, edit, patches, state)
            if done:
                low, high, m = apply(path, n, edit, patches, trial)
        if not done:
            undo(path, count, edit, patches)
            np.testing.assert_array_equal(count, visits(field, path[:n]))
            continue
        changed = tuples(field, trial[:m])
        assert changed[0] == problem.start
        assert not field.returns or changed[-1] == problem.start
        assert m == n or not field.exact
        assert total_score(problem, changed) - total_score(problem, cells) == pytest.approx(gain, abs=1e-9)
        assert price(problem, changed) == pytest.approx(new_cost, abs=1e-9)
        np.testing.assert_array_equal(count, visits(field, trial[:m]))
        np.testing.assert_array_equal(trial[:low], path[:low])
        if new_cost > problem.limit + 1e-9:
            undo(path, count, edit, patches)
            trial[:] = path
            continue
        path[:] = trial
        where[path[:m]] = np.arange(m)
        n, cost, cells = m, new_cost, changed


@settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))
@given(problem=worlds(), gamma=st.sampled_from([1.0, 0.9]), tidy=st.booleans(), seed=st.integers(0, 99))
def test_annealing_returns_the_best_walk_it_met(problem, gamma, tidy, seed):
    field = build_field(problem)
    walk = greedy_walk(field, seed)
    if walk.size < 2:
        return
    heat = 0.0 if tidy else 0.3
    better = anneal(field, walk, gamma, 2000, heat, heat * 0.02, tidy, seed)
    seen = np.zeros(field.free.size, np.bool_)
    before = walk_value(field.value, walk, walk.size, gamma, seen)
    assert walk_value(field.value, better, better.size, gamma, seen) >= before * (1 - 1e-11)
    assert price(problem, tuples(field, better)) <= field.limit + 1e-6
    np.testing.assert_array_equal(anneal(field, walk, gamma, 2000, heat, heat * 0.02, tidy, seed), better)
