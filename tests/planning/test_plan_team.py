"""Several robots: every robot obeys the laws of one, and together they collect each cell once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from plan_worlds import check_walk, worlds

from hrt_cli.errors import ArgumentError
from hrt_cli.planning.families import make_map
from hrt_cli.planning.planner import METHODS, plan, plan_team, plans_alone
from hrt_cli.planning.problem import Budget, Problem

RELAXED = {"deadline": None, "suppress_health_check": list(HealthCheck)}


def tuples(cells):
    return [(int(row), int(col)) for row, col in cells]


def by_hand(problem, walks, gamma):
    """What each robot adds to the team's score, and the team's discounted score: the earliest visit pays."""
    shares, worth, seen = [0.0] * len(walks), 0.0, set()
    for t in range(max(map(len, walks))):
        for robot, walk in enumerate(walks):
            if t < len(walk) and walk[t] not in seen:
                seen.add(walk[t])
                shares[robot] += float(problem.score[walk[t]])
                worth += gamma**t * float(problem.score[walk[t]])
    return shares, worth


@settings(max_examples=80, **RELAXED)
@given(
    problem=worlds(),
    robots=st.integers(2, 4),
    apart=st.booleans(),
    method=st.sampled_from(["refined", "refined", *METHODS]),
    seed=st.integers(0, 99),
)
def test_every_robot_obeys_every_law_and_each_cell_pays_once(problem, robots, apart, method, seed):
    rng = np.random.default_rng(seed)
    team = [problem]
    free = np.argwhere(~np.isnan(problem.score))
    for _ in range(robots - 1):
        start = tuple(int(x) for x in free[rng.integers(len(free))]) if apart else problem.start
        limit = max(2.0, problem.budget.limit - float(rng.integers(0, 3)))
        end = start if problem.end is not None else None
        try:
            team.append(replace(problem, start=start, end=end, budget=replace(problem.budget, limit=limit)))
        except ArgumentError:
            return
    found = plan_team(team, method, effort=0.1, samples=8, seed=seed)
    walks = [check_walk(one, cells) for one, cells in zip(team, found.cells, strict=True)]
    shares, worth = by_hand(problem, walks, problem.gamma)
    assert found.shares == pytest.approx(shares, abs=1e-12)
    assert found.together.score == pytest.approx(sum(shares), rel=1e-12, abs=1e-12)
    assert found.together.discounted_score == pytest.approx(worth, rel=1e-9, abs=1e-12)
    assert found.together.score <= found.together.upper_bound * (1 + 1e-12)
    if problem.objective == "discounted":
        assert worth <= found.together.discounted_upper_bound * (1 + 1e-12)
    for one, alone, walk in zip(team, plans_alone(team, found), walks, strict=True):
        assert alone.score == pytest.approx(sum(float(one.score[c]) for c in set(walk)), rel=1e-12, abs=1e-12)
        assert alone.score <= alone.upper_bound * (1 + 1e-12)


def test_two_robots_share_two_spots_that_one_cannot_visit():
    rows, cols = np.indices((41, 61))
    score = sum(np.exp(-((rows - 20) ** 2 + (cols - col) ** 2) / 20.0) for col in (6, 54))
    problem = Problem(score, (20, 30), Budget(70.0))
    one, two = plan(problem), plan_team([problem, problem])
    assert one.score < 0.6 * score.sum()
    assert two.together.score > 1.8 * one.score
    assert min(two.shares) > 0.4 * two.together.score
    assert two.together.gap < 0.06


def test_planning_together_is_no_worse_than_in_turn():
    gains = []
    for seed in range(4):
        score = make_map("gaussians", (40, 40), np.random.default_rng(seed))
        problem = Problem(score, (20, 20), Budget(90.0))
        together = plan_team([problem] * 3, effort=0.5).together.score
        left, in_turn = score.copy(), 0.0
        for _ in range(3):
            walk = plan(replace(problem, score=left), effort=0.5)
            in_turn += walk.score
            left = left.copy()
            left[walk.cells[:, 0], walk.cells[:, 1]] = 0.0
        gains.append(together / in_turn)
    assert np.mean(gains) > 0.99
    assert min(gains) > 0.96


def test_a_team_is_one_map_and_one_objective():
    problem = Problem(np.ones((5, 5)), (0, 0), Budget(5.0))
    for other in (
        replace(problem, score=np.ones((5, 5))),
        replace(problem, connectivity=8),
        replace(problem, objective="discounted"),
        replace(problem, end=(1, 1)),  # the annealing holds the ends of all paths, or of none
    ):
        with pytest.raises(ArgumentError, match="robots of one team"):
            plan_team([problem, other])
    with pytest.raises(ArgumentError, match="1 to 64 robots"):
        plan_team([])
