from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from plan_worlds import cost_of, is_open, total_score, worlds

from hrt_cli.planning.baselines import greedy_walk, random_walk
from hrt_cli.planning.moves import LONGEST_PATCH, SPARE, apply, change, clear, reverse, undo
from hrt_cli.planning.refine import _discounted_gain, anneal, widen
from hrt_cli.planning.walk import build_field, capacity, to_cells

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
            done, gain, new_cost = change(field, field.limit, path, n, cost, count, edit, patches, state)
            if done:
                low, high, m = apply(path, n, edit, patches, trial)
        if not done:
            undo(path, count, edit, patches)
            np.testing.assert_array_equal(count, visits(field, path[:n]))
            continue
        changed = tuples(field, trial[:m])
        assert changed[0] == problem.start
        assert problem.end in (None, changed[-1])
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


def annealed(field, walks, gamma, tidy, seed):
    """The annealed walks as a list, and what they are worth."""
    heat = 0.0 if tidy else 0.3
    paths = np.zeros((len(walks), capacity(field)), np.int64)
    for row, walk in zip(paths, walks, strict=True):
        row[: walk.size] = walk
    sizes = np.array([walk.size for walk in walks])
    limits = np.full(len(walks), field.limit)
    paths, sizes = anneal(field, limits, paths, sizes, gamma, 2000, heat, heat * 0.02, tidy, seed)
    return [path[:size] for path, size in zip(paths, sizes, strict=True)]


def together(problem, field, walks, gamma):
    """What walks are worth together, by hand: each cell at its earliest visit by any robot."""
    total, seen = 0.0, set()
    for t in range(max(walk.size for walk in walks)):
        for walk in walks:
            if t < walk.size:
                cell = tuples(field, walk[t : t + 1])[0]
                if cell not in seen:
                    seen.add(cell)
                    total += gamma**t * float(problem.score[cell])
    return total


@settings(max_examples=80, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    problem=worlds(),
    gamma=st.sampled_from([1.0, 0.9]),
    tidy=st.booleans(),
    robots=st.integers(1, 3),
    seed=st.integers(0, 99),
)
def test_annealing_returns_the_best_walks_it_met(problem, gamma, tidy, robots, seed):
    field = build_field(problem)
    walks = [greedy_walk(field, seed + k) for k in range(robots)]
    if min(walk.size for walk in walks) < 2:
        return
    better = annealed(field, walks, gamma, tidy, seed)
    before, after = (together(problem, field, each, gamma) for each in (walks, better))
    assert after >= before * (1 - 1e-11)
    for walk in better:
        cells = tuples(field, walk)
        assert cells[0] == problem.start
        assert problem.end in (None, cells[-1])
        assert price(problem, cells) <= field.limit + 1e-6
    again = annealed(field, walks, gamma, tidy, seed)
    for one, other in zip(better, again, strict=True):
        np.testing.assert_array_equal(one, other)


@settings(max_examples=120, deadline=None, suppress_health_check=list(HealthCheck))
@given(problem=worlds(most_moves=40), seed=st.integers(0, 10_000))
def test_the_discounted_gain_is_that_of_the_whole_walks(problem, seed):
    """However short the way it was computed: over the range alone, or from the change on."""
    field = build_field(problem)
    walk = random_walk(field, seed)
    if walk.size < 3:
        return
    n, gamma = walk.size, 0.9
    path = np.zeros(capacity(field) + 1, np.int64)
    path[:n] = walk
    trial, count = path.copy(), visits(field, walk)
    where, met = np.full(field.free.size, -1), np.full(field.free.size, 1 << 60)
    where[path[:n]] = np.arange(n)
    for t in range(n - 1, -1, -1):
        met[path[t]] = t
    stamp = np.zeros(field.free.size, np.int64)
    discount = gamma ** np.arange(path.size)
    edit, patches = np.zeros((2, 3), np.int64), np.zeros((2, LONGEST_PATCH + SPARE), np.int64)
    state = np.full(1, seed, np.uint64)
    cost = price(problem, tuples(field, walk))
    before = together(problem, field, [walk], gamma)
    for turn in range(40):
        trial[:] = path
        if turn % 5 == 0:
            clear(edit)
            low, high = reverse(field, path, n, where, trial, state)
            done, m = high > 0, n
        else:
            done, _, _ = change(field, field.limit, path, n, cost, count, edit, patches, state)
            if done:
                low, high, m = apply(path, n, edit, patches, trial)
        if done:
            gain = _discounted_gain(
                field.value, discount, path, n, trial, m, low, high, count, met, stamp, 2 * turn + 2
            )
            assert gain == pytest.approx(together(problem, field, [trial[:m]], gamma) - before, abs=1e-9)
        undo(path, count, edit, patches)


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(problem=worlds(), seed=st.integers(0, 99))
def test_detours_only_add(problem, seed):
    field = build_field(problem)
    walk = random_walk(field, seed)
    walk = walk[: max(1, walk.size // 2)]
    wide = widen(field, field.limit, walk)
    cells = tuples(field, wide)
    assert price(problem, cells) <= field.limit + 1e-6
    assert set(tuples(field, walk)) <= set(cells)
    assert (cells[0], cells[-1]) == (tuples(field, walk)[0], tuples(field, walk)[-1])
