"""Starts lie where the robot could begin, and the figures over them are those of a plain computation."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from hrt_cli.errors import ArgumentError
from hrt_cli.evaluation.rewards import cumulative_reward, distance_travelled
from hrt_cli.evaluation.starts import RESAMPLES, compare_over_starts, draw_starts, spread
from hrt_cli.planning.planner import bound_of, find_walks, plan
from hrt_cli.planning.problem import Budget, Problem

QUICK = ("policy", "greedy", "random")


def split_map() -> np.ndarray:
    """Two regions that touch at a corner only, the first with a hole."""
    score = np.full((12, 12), np.nan, np.float32)
    score[1:7, 1:7] = np.random.default_rng(1).random((6, 6))
    score[7:11, 7:11] = 0.5
    score[3, 3] = np.nan
    return score


def test_starts_are_of_the_region_of_the_plan_each_as_likely() -> None:
    score = split_map()
    near = {(int(r), int(c)) for r, c in np.argwhere(~np.isnan(score)) if r < 7}
    drawn = draw_starts(score, (1, 1), 4, len(near), 0)
    assert {(int(r), int(c)) for r, c in drawn} == near
    both = draw_starts(score, (1, 1), 8, len(near) + 16, 0)
    assert {(int(r), int(c)) for r, c in both} == {(int(r), int(c)) for r, c in np.argwhere(~np.isnan(score))}
    firsts = [tuple(draw_starts(score, (8, 8), 4, 1, seed)[0]) for seed in range(800)]
    _, counts = np.unique(firsts, axis=0, return_counts=True)
    assert counts.size == 16
    assert stats.chisquare(counts).pvalue > 0.001


def test_starts_depend_on_the_seed_and_fewer_are_the_first_of_more() -> None:
    score = split_map()
    assert np.array_equal(draw_starts(score, (1, 1), 4, 5, 3), draw_starts(score, (1, 1), 4, 9, 3)[:5])
    assert not np.array_equal(draw_starts(score, (1, 1), 4, 9, 3), draw_starts(score, (1, 1), 4, 9, 4))


def test_more_starts_than_cells_are_refused() -> None:
    with pytest.raises(ArgumentError, match="17 starts cannot be drawn: only 16 cells"):
        draw_starts(split_map(), (8, 8), 4, 17, 0)


def test_the_interval_is_the_percentile_bootstrap_over_starts() -> None:
    rng = np.random.default_rng(5)
    values = rng.gamma(2.0, size=(40, 3))
    resamples = rng.integers(0, 40, (RESAMPLES, 40))
    found = spread(values, resamples)
    means = sorted(float(np.mean([values[start].mean() for start in pick])) for pick in resamples)
    assert found.low == pytest.approx(np.percentile(means, 2.5))
    assert found.high == pytest.approx(np.percentile(means, 97.5))
    assert found.mean == pytest.approx(values.mean())
    assert found.worst == values.min()
    peer = stats.bootstrap(
        (values.mean(axis=1),), np.mean, n_resamples=20_000, method="percentile", rng=np.random.default_rng(6)
    ).confidence_interval
    assert (found.low, found.high) == pytest.approx((peer.low, peer.high), abs=0.1 * (peer.high - peer.low))


@pytest.mark.parametrize(
    ("connectivity", "budget", "objective"),
    [(4, Budget(20), "total"), (8, Budget(17.5, 2**0.5), "discounted")],
)
def test_methods_over_starts_are_the_runs_one_by_one(connectivity: int, budget: Budget, objective: str) -> None:
    score = split_map()
    problem = Problem(score, (1, 1), budget, connectivity=connectivity, objective=objective, gamma=0.95)
    starts = draw_starts(score, (1, 1), 4, 4, 2)
    found = compare_over_starts(problem, QUICK, starts, seed=11, seeds=3)
    worth = {name: np.zeros((4, 3, 2)) for name in QUICK}
    curves = {name: np.zeros((4, 3, found.travelled.size)) for name in QUICK}
    bounds = np.zeros((4, 2))
    for i, (row, col) in enumerate(starts.tolist()):
        here = Problem(score, (row, col), budget, connectivity=connectivity, objective=objective, gamma=0.95)
        for name in QUICK:
            for k in range(3):
                walk = plan(here, name, seed=11 + k)
                worth[name][i, k] = walk.score, walk.discounted_score
                gains = cumulative_reward(score, walk.cells, 1.0 if objective == "total" else 0.95)
                travelled = distance_travelled(walk.cells, budget.diagonal_cost)
                curves[name][i, k] = [gains[travelled <= at + 1e-6][-1] for at in found.travelled]
        known = [max(worth[name][i, :, which].max() for name in QUICK) for which in (0, 1)]
        proven = bound_of([here], *known)
        bounds[i] = proven.score, proven.discounted
    for name in QUICK:
        each = found.methods[name]
        for which, whole, share in (
            (0, each.score, each.fraction_of_bound),
            (1, each.discounted_score, each.fraction_of_discounted_bound),
        ):
            values = worth[name][..., which]
            assert (whole.mean, whole.worst) == pytest.approx((values.mean(), values.min()))
            assert whole.low <= whole.mean <= whole.high
            fractions = values / bounds[:, which, None]
            assert (share.mean, share.worst) == pytest.approx((fractions.mean(), fractions.min()))
            assert share.high <= 1.0
        of_starts = curves[name].mean(axis=1)
        assert found.curves[name].mean == pytest.approx(of_starts.mean(axis=0))
        assert found.curves[name].low == pytest.approx(np.percentile(of_starts, 5, axis=0))
        assert found.curves[name].high == pytest.approx(np.percentile(of_starts, 95, axis=0))
    assert found.bound == pytest.approx(bounds[:, 0 if objective == "total" else 1].mean())


def test_threads_do_not_change_the_result_and_every_run_ticks() -> None:
    score = split_map()
    problem = Problem(score, (1, 1), Budget(15))
    starts = draw_starts(score, (1, 1), 4, 5, 0)
    ticks = [0]

    def tick() -> None:
        ticks[0] += 1

    one = compare_over_starts(problem, QUICK, starts, seeds=2, tick=tick)
    assert ticks == [5 * (2 + 1)]
    three = compare_over_starts(problem, QUICK, starts, seeds=2, workers=3)
    assert one.methods == three.methods
    assert one.bound == three.bound
    for name in QUICK:
        assert np.array_equal(one.curves[name].mean, three.curves[name].mean)


def test_a_map_of_nothing_is_wholly_collected() -> None:
    problem = Problem(np.zeros((5, 5), np.float32), (2, 2), Budget(6))
    found = compare_over_starts(problem, ("greedy",), np.array([[2, 2]]))
    assert found.methods["greedy"].fraction_of_bound.mean == 1.0


def test_a_walk_is_found_without_its_bounds() -> None:
    problem = Problem(np.random.default_rng(2).random((8, 8)), (4, 4), Budget(12), objective="discounted")
    for method in (*QUICK, "refined"):
        assert np.array_equal(find_walks([problem], method, seed=3)[0], plan(problem, method, seed=3).cells)
    with pytest.raises(ArgumentError, match="unknown method"):
        find_walks([problem], "sweep")
