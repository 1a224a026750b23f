from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from plan_worlds import collectable, optimum, worlds

from hrt_cli.errors import ArgumentError
from hrt_cli.planning.bounds import lagrangian_bound, prove_bounds, scheduling_bound, scheduling_profile
from hrt_cli.planning.problem import Budget, Problem
from hrt_cli.planning.tours import cheapest_orders, cut_regions, share_out
from hrt_cli.planning.walk import build_field, capacity, join_fields

RELAXED = {"deadline": None, "suppress_health_check": list(HealthCheck)}


def proven(problem, known=0.0, worth=0.0):
    """The bounds of one robot, with the discounted one."""
    fields, joint = join_fields([build_field(problem)])
    cuts = cut_regions(fields, joint, early=True)
    return prove_bounds(fields, joint, cuts, known, problem.gamma, worth, 30), cuts


@settings(max_examples=500, **RELAXED)
@given(problem=worlds(most_side=5, most_moves=8, most_cells=12))
def test_no_walk_beats_the_bounds(problem):
    field = build_field(problem)
    best = optimum(replace(problem, objective="total")) * (1 - 1e-12)
    early = optimum(replace(problem, objective="discounted")) * (1 - 1e-12)
    bounds, cuts = proven(problem)
    assert bounds.score >= best
    assert bounds.discounted >= early
    assert scheduling_bound(field) >= best
    assert scheduling_bound(field, problem.gamma) >= early
    assert lagrangian_bound([field], field, 0.9 * best, 1.0, 30)[0] >= best
    assert lagrangian_bound([field], field, 0.9 * early, problem.gamma, 30)[0] >= early
    assert min(cut.bound() for cut in cuts) >= best * (1 - 1e-9)


@settings(max_examples=150, **RELAXED)
@given(problem=worlds(most_side=5, most_moves=7, most_cells=12))
def test_no_first_moves_beat_the_profiles(problem):
    """What n moves can collect, for every n up to the budget."""
    fields, joint = join_fields([build_field(problem)])
    moves = capacity(joint) - 1
    profiles = [scheduling_profile(fields, joint), lagrangian_bound(fields, joint, 0.0, 1.0, 10)[1]]
    profiles += [cut.profile(moves) for cut in cut_regions(fields, joint, early=True)]
    if problem.end is not None:
        return
    for n in range(1, moves + 1):
        assert min(profile[n] for profile in profiles) >= _in_moves(problem, n) * (1 - 1e-9)


def _in_moves(problem, n):
    """What n moves collect at most; where diagonals cost more, what the cost n pays for, which is no more moves."""
    return optimum(
        replace(problem, objective="total", budget=Budget(min(n, problem.limit), problem.budget.diagonal_cost))
    )


@settings(max_examples=120, **RELAXED)
@given(problem=worlds(most_side=4, most_moves=5, most_cells=9), seed=st.integers(0, 99))
def test_no_team_beats_its_bounds(problem, seed):
    """Two robots by exhaustive search over the sets of cells that each can collect."""
    rng = np.random.default_rng(seed)
    free = np.argwhere(~np.isnan(problem.score))
    row, col = free[rng.integers(len(free))]
    try:
        other = replace(problem, start=(int(row), int(col)), end=None)
    except ArgumentError:
        return
    problem = replace(problem, end=None, objective="total")
    team = [problem, replace(other, objective="total")]
    fields, joint = join_fields([build_field(each) for each in team])
    bounds = prove_bounds(fields, joint, cut_regions(fields, joint), 0.0)
    best = max(
        sum(float(problem.score[cell]) for cell in one | two)
        for one in collectable(team[0])
        for two in collectable(team[1])
    )
    assert bounds.score >= best * (1 - 1e-12)
    assert lagrangian_bound(fields, joint, 0.9 * best, 1.0, 20)[0] >= best * (1 - 1e-12)


def test_a_team_is_bounded_no_worse_than_its_robots_alone_where_they_cannot_meet():
    score = np.random.default_rng(4).random((3, 60))
    ends = [Problem(score, start, Budget(12.0)) for start in ((1, 2), (1, 57))]
    fields, joint = join_fields([build_field(each) for each in ends])
    alone = [lagrangian_bound([field], field, 0.0, 1.0, 60)[0] for field in map(build_field, ends)]
    together, profile = lagrangian_bound(fields, joint, 0.0, 1.0, 60)
    assert together == pytest.approx(sum(alone), rel=0.03)
    assert profile[0] >= score[1, 2] + score[1, 57]
    twice = lagrangian_bound([build_field(ends[0])] * 2, build_field(ends[0]), 0.0, 1.0, 60)[0]
    assert alone[0] < twice < 2 * alone[0]


def test_the_regions_tell_spots_that_exclude_each_other():
    # Two rich corridors, 30 cells of nothing between them: time for either, not for both.
    score = np.zeros((1, 71))
    score[0, :20] = score[0, 51:] = 1.0
    problem = Problem(score, (0, 35), Budget(50.0))
    bounds, cuts = proven(problem)
    assert scheduling_bound(build_field(problem)) > 30.0
    assert bounds.score == pytest.approx(20.0)
    (order,), _ = min(cuts, key=lambda cut: cut.bound()).orders()
    assert order.size == 1


def test_cheapest_orders_are_those_of_all_permutations():
    rng = np.random.default_rng(2)
    between, first, home = rng.random((5, 5)), rng.random(5), rng.random(5)
    cost, _ = cheapest_orders(between, first, home)
    assert cost[0] == 0.0
    for chosen in range(1, 32):
        members = [i for i in range(5) if chosen >> i & 1]
        ways = [
            first[p[0]] + sum(between[a, b] for a, b in itertools.pairwise(p)) + home[p[-1]]
            for p in itertools.permutations(members)
        ]
        assert cost[chosen] == pytest.approx(min(ways))


def test_a_set_is_shared_out_as_cheaply_as_by_all_splits():
    rng = np.random.default_rng(3)
    one, other = rng.random(16), rng.random(16)
    best, part = share_out(one, other)
    for chosen in range(16):
        splits = {s: one[s] + other[chosen ^ s] for s in range(16) if s & chosen == s}
        assert best[chosen] == pytest.approx(min(splits.values()))
        assert splits[int(part[chosen])] == pytest.approx(best[chosen])


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
    problem = Problem(np.array([[1.0, 2.0, 4.0, 100.0]]), (0, 0), Budget(5.0), end=(0, 0))
    assert scheduling_bound(build_field(problem)) == pytest.approx(7.0)


def test_lagrangian_bound_sees_that_far_clusters_exclude_each_other():
    # A corridor with a rich cell every four steps either way: time slots suffice for both sides.
    score = np.zeros((1, 41))
    score[0, ::4] = 1.0
    field = build_field(Problem(score, (0, 20), Budget(20.0)))
    assert scheduling_bound(field) == pytest.approx(10.0)
    assert lagrangian_bound([field], field, 6.0, 1.0, 60)[0] < 9.0


def test_more_steps_never_loosen_the_bound():
    field = build_field(Problem(np.random.default_rng(0).random((20, 20)), (3, 3), Budget(60.0)))
    bounds = [lagrangian_bound([field], field, 40.0, 1.0, n)[0] for n in (1, 10, 50)]
    assert bounds == sorted(bounds, reverse=True)


def test_the_relaxation_is_left_out_where_it_would_not_fit(monkeypatch):
    monkeypatch.setattr("hrt_cli.planning.bounds.MAX_LAYER_CELLS", 100)
    problem = Problem(np.ones((20, 20)), (3, 3), Budget(60.0))
    assert lagrangian_bound([build_field(problem)], build_field(problem), 1.0)[0] == float("inf")
    assert proven(problem)[0].score == pytest.approx(61.0)


def test_on_large_maps_fewer_levels_and_prices_are_tried(monkeypatch):
    monkeypatch.setattr("hrt_cli.planning.tours.SEARCHED_CELLS", 2000)
    problem = Problem(np.random.default_rng(1).random((30, 30)), (3, 3), Budget(60.0))
    bounds, cuts = proven(problem)
    assert len(cuts) == 1
    assert len(cuts[0].priced) == 1
    assert 61.0 * 0.5 < bounds.score < 61.0
