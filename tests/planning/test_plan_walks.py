from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from plan_worlds import check_walk, discounted_score, optimum, total_score, worlds

from hrt_cli.errors import ArgumentError
from hrt_cli.planning.families import FAMILIES, make_map
from hrt_cli.planning.planner import METHODS, plan
from hrt_cli.planning.policy import default_policies
from hrt_cli.planning.problem import Budget, Problem

RELAXED = {"deadline": None, "suppress_health_check": list(HealthCheck)}


def made(problem, method, seed=0):
    """A plan by the method, checked against every law."""
    found = plan(problem, method, effort=0.2, samples=8, seed=seed)
    cells = check_walk(problem, found.cells)
    assert found.cells.dtype == np.int32
    assert found.score == pytest.approx(total_score(problem, cells), rel=1e-12, abs=1e-12)
    assert found.discounted_score == pytest.approx(discounted_score(problem, cells), rel=1e-9, abs=1e-12)
    value = found.score if problem.objective == "total" else found.discounted_score
    assert found.score <= found.upper_bound * (1 + 1e-12)
    assert 0.0 <= found.gap <= 1.0
    if problem.objective == "discounted":
        assert value <= found.discounted_upper_bound * (1 + 1e-12)
        assert 0.0 <= found.discounted_gap <= 1.0
    assert found.method == method
    assert found.evaluations >= 1
    return value


@settings(max_examples=500, **RELAXED)
@given(problem=worlds(), seed=st.integers(0, 1000))
def test_refined_walk_obeys_every_law(problem, seed):
    made(problem, "refined", seed)


@settings(max_examples=25, **RELAXED)
@given(problem=worlds())
@pytest.mark.parametrize("method", [m for m in METHODS if m != "refined"])
def test_every_other_method_obeys_every_law(method, problem):
    made(problem, method)


@settings(max_examples=30, **RELAXED)
@given(problem=worlds())
def test_refined_is_never_below_its_seeds(problem):
    refined = made(problem, "refined")
    for method in ("greedy", "policy", "policy-sample", "rectangle"):
        assert refined >= made(problem, method) * (1 - 1e-12)


@settings(max_examples=25, **RELAXED)
@given(problem=worlds(), order=st.permutations(default_policies()))
def test_of_several_policies_the_best_walk_counts(problem, order):
    alone = [plan(problem, "policy", [policy], effort=0.05).score for policy in order]
    discounted = replace(problem, objective="discounted")
    early = [plan(discounted, "policy", [policy], effort=0.05).discounted_score for policy in order]
    assert plan(problem, "policy", order, effort=0.05).score == max(alone)
    assert plan(discounted, "policy", order, effort=0.05).discounted_score == max(early)


def test_a_planner_without_a_policy_is_refused():
    with pytest.raises(ArgumentError, match="at least one policy"):
        plan(Problem(np.ones((3, 3)), (0, 0), Budget(3.0)), "policy", [])


@settings(max_examples=40, **RELAXED)
@given(problem=worlds(most_side=4, most_moves=7, most_cells=12))
def test_refined_finds_nearly_the_optimum_of_tiny_worlds(problem):
    assert made(problem, "refined") >= 0.9 * optimum(problem) - 1e-12


@pytest.mark.parametrize("family", FAMILIES)
def test_larger_maps_of_every_family(family):
    score = make_map(family, (40, 30), np.random.default_rng(3))
    start, end = (tuple(int(x) for x in np.argwhere(~np.isnan(score))[k]) for k in (200, 500))
    made(Problem(score, start, Budget(120.0)), "refined")
    made(Problem(score, start, Budget(121.0), end=start), "refined")
    made(Problem(score, start, Budget(120.0), end=end), "refined")
    made(Problem(score, start, Budget(90.5, 2**0.5), connectivity=8), "refined")


def test_same_seed_gives_the_same_walk_and_another_seed_another():
    problem = Problem(make_map("noise", (30, 30), np.random.default_rng(0)), (4, 4), Budget(80.0))
    first, again, other = (plan(problem, effort=0.3, seed=seed) for seed in (5, 5, 6))
    assert np.array_equal(first.cells, again.cells)
    assert first.upper_bound == again.upper_bound
    assert not np.array_equal(first.cells, other.cells)


def test_flat_map_is_mown_in_straight_runs():
    found = plan(Problem(np.ones((20, 20)), (0, 0), Budget(199.0)))
    assert found.gap == pytest.approx(0.0, abs=1e-8)
    steps = np.diff(found.cells, axis=0)
    turns = int((steps[1:] != steps[:-1]).any(axis=1).sum())
    assert turns <= 40


def test_only_the_reachable_window_of_a_large_map_is_worked_on():
    score = np.ones((1000, 1000), np.float32)
    found = plan(Problem(score, (500, 500), Budget(40.0)), "refined")
    assert found.score == pytest.approx(41.0)
    assert found.gap == pytest.approx(0.0, abs=1e-8)


def test_the_robot_walks_around_a_wall_it_cannot_see_through():
    score = np.zeros((9, 9))
    score[:8, 4] = np.nan
    score[0, 5:] = 10.0
    found = plan(Problem(score, (0, 3), Budget(22.0)), "refined")
    assert found.score == pytest.approx(40.0)


def test_an_end_out_of_reach_is_refused_and_one_in_reach_is_reached_with_the_budget_spent():
    score = np.ones((1, 20))
    with pytest.raises(ArgumentError, match="end cell 0,19 cannot be reached"):
        plan(Problem(score, (0, 0), Budget(18.0), end=(0, 19)))
    found = plan(Problem(score, (0, 0), Budget(21.0), end=(0, 19)))
    assert tuple(found.cells[-1]) == (0, 19)
    assert len(found.cells) == 22
    # One move is left over where the parity of the budget does not fit.
    assert len(plan(Problem(score, (0, 0), Budget(20.0), end=(0, 19))).cells) == 20


def test_a_far_rich_spot_is_found_that_no_step_and_no_rectangle_from_the_start_points_to():
    rows, cols = np.indices((60, 60))
    score = np.zeros((60, 60))
    for row, col in ((8, 50), (50, 52), (52, 8)):
        score += np.exp(-((rows - row) ** 2 + (cols - col) ** 2) / 18.0)
    problem = Problem(score, (4, 4), Budget(250.0))
    found = plan(problem)
    assert found.gap < 0.03
    assert found.score > 1.5 * max(plan(problem, method).score for method in ("rectangle", "greedy"))
