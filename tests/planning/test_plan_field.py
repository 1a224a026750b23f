from __future__ import annotations

import heapq
import math

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from plan_worlds import cost_of, is_open, steps_of, worlds

from hrt_cli.planning.problem import Budget, Problem
from hrt_cli.planning.walk import build_field, count_turns, to_cells, to_path, walk_cost

RELAXED = {"deadline": None, "suppress_health_check": list(HealthCheck)}


def costs_by_parity(problem, source):
    """Cheapest cost to each (cell, parity of moves), by Dijkstra's algorithm on dictionaries."""
    best = {(source, 0): 0.0}
    heap = [(0.0, source, 0)]
    while heap:
        cost, cell, parity = heapq.heappop(heap)
        if cost > best[cell, parity]:
            continue
        for dr, dc in steps_of(problem):
            after = (cell[0] + dr, cell[1] + dc)
            if not is_open(problem, after):
                continue
            key = (after, 1 - parity)
            reached = cost + cost_of(problem, cell, after)
            if reached < best.get(key, math.inf):
                best[key] = reached
                heapq.heappush(heap, (reached, *key))
    return best


@settings(max_examples=150, **RELAXED)
@given(problem=worlds())
def test_distances_and_reachable_cells(problem):
    field = build_field(problem)
    costs = costs_by_parity(problem, problem.start)
    onward = costs_by_parity(problem, problem.end) if problem.end is not None else {}

    def through(cell):
        """The cheapest walk by way of a cell."""
        least = min(costs.get((cell, parity), math.inf) for parity in (0, 1))
        return least + (min(onward.get((cell, p), math.inf) for p in (0, 1)) if problem.end is not None else 0.0)

    for index in range(field.free.size):
        cell = tuple(int(x) for x in to_cells(field, np.array([index]))[0])
        nearest = min((costs.get((cell, parity), math.inf) for parity in (0, 1)), default=math.inf)
        assert field.free[index] == (through(cell) <= field.limit + 1e-9)
        if not field.free[index]:
            continue
        assert field.value[index] == problem.score[cell]
        assert field.reach[:, index].min() == pytest.approx(nearest)
        for parity in (0, 1):
            exact = costs.get((cell, parity), math.inf)
            if problem.counts_moves and exact <= field.limit:
                assert field.reach[parity, index] == exact
    assert field.free.sum() == len({cell for cell, _ in costs if through(cell) <= field.limit + 1e-9})


def test_cells_and_paths_round_trip():
    field = build_field(Problem(np.ones((40, 50)), (20, 30), Budget(5.0)))
    assert field.width == 13
    path = np.array([field.start, field.start + 1, field.start + 1 + field.width])
    cells = to_cells(field, path)
    assert cells.tolist() == [[20, 30], [20, 31], [21, 31]]
    np.testing.assert_array_equal(to_path(field, cells), path)


def test_cost_and_turns_of_a_walk():
    field = build_field(Problem(np.ones((9, 9)), (4, 4), Budget(9.0, math.sqrt(2)), connectivity=8))
    path = to_path(field, np.array([[4, 4], [4, 5], [5, 6], [6, 7], [6, 6], [6, 5]]))
    assert walk_cost(field, path, 6) == pytest.approx(3 + 2 * math.sqrt(2))
    assert count_turns(path, 6) == 2
    assert walk_cost(field, np.array([field.start, field.start + 2]), 2) == math.inf
