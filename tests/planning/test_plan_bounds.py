from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from plan_worlds import optimum, worlds

from hrt_cli.planning.bounds import lagrangian_bound, scheduling_bound, upper_bound
from hrt_cli.planning.problem import Budget, Problem
from hrt_cli.planning.walk import build_field

RELAXED = {"deadline": None, "suppress_health_check": list(HealthCheck)}


@settings(max_examples=250, **RELAXED)
@given(problem=worlds(most_side=5, most_moves=8, most_cells=12))
def test_no_walk_beats_the_bounds(problem):
    field = build_field(problem)
    gamma = problem.gamma if problem.objective == "discounted" else 1.0
    best = optimum(problem) * (1 - 1e-12)
    assert scheduling_bound(field, gamma) >= best
    assert lagrangian_bound(field, 0.9 * best, gamma, 30) >= best
    assert upper_bound(field, best, gamma, 30) >= best


def test_scheduling_bound_by_hand():
    # From the left end of a corridor, two moves reach the third cell at most; the rich fourth is out of reach.
    field = build_field(Problem(np.array([[1.0, 2.0, 4.0, 100.0]]), (0, 0), Budget(2.0)))
    assert scheduling_bound(field) == pytest.approx(7.0)
    assert scheduling_bound(field, 0.5) == pytest.approx(1.0 + 1.0 + 1.0)


def test_scheduling_bound_knows_the_parity_of_a_4_grid():
    # The start's four neighbours are only entered at odd times: one in three moves is lost to coming back.
    score = np.full((3, 3), np.nan)
    score[1, :] = 1.0
    score[:, 1] = 1.0
    problem = Problem(score, (1, 1), Budget(3.0))
    assert scheduling_bound(build_field(problem)) == pytest.approx(3.0)
    assert optimum(problem) == pytest.approx(3.0)


def test_scheduling_bound_keeps_time_for_the_way_home():
    problem = Problem(np.array([[1.0, 2.0, 4.0, 100.0]]), (0, 0), Budget(5.0), return_home=True)
    assert scheduling_bound(build_field(problem)) == pytest.approx(7.0)


def test_lagrangian_bound_sees_that_far_clusters_exclude_each_other():
    # A corridor with a rich cell every four steps either way: time slots suffice for both sides.
    score = np.zeros((1, 41))
    score[0, ::4] = 1.0
    field = build_field(Problem(score, (0, 20), Budget(20.0)))
    assert scheduling_bound(field) == pytest.approx(10.0)
    assert lagrangian_bound(field, 6.0, 1.0, 60) < 9.0


def test_more_steps_never_loosen_the_bound():
    field = build_field(Problem(np.random.default_rng(0).random((20, 20)), (3, 3), Budget(60.0)))
    bounds = [lagrangian_bound(field, 40.0, 1.0, n) for n in (1, 10, 50)]
    assert bounds == sorted(bounds, reverse=True)


def test_the_relaxation_is_left_out_where_it_would_not_fit(monkeypatch):
    monkeypatch.setattr("hrt_cli.planning.bounds.MAX_LAYER_CELLS", 100)
    field = build_field(Problem(np.ones((20, 20)), (3, 3), Budget(60.0)))
    assert lagrangian_bound(field, 1.0) == float("inf")
    assert upper_bound(field, 1.0) == pytest.approx(61.0)
