from __future__ import annotations

import math

import numpy as np
import pytest

from hrt_cli.errors import ArgumentError
from hrt_cli.planning.planner import plan
from hrt_cli.planning.problem import Budget, Problem

FLAT = np.ones((4, 6))


def walled(grid):
    return np.where(np.array(grid) > 0, 1.0, np.nan)


@pytest.mark.parametrize(
    ("start", "message"),
    [
        ((12, -1), "start cell 12,-1 is outside the map of 4 x 6 cells"),
        ((-1, -1), "outside the map"),
        ((4, 0), "outside the map"),
        ((0, 6), "outside the map"),
    ],
)
def test_start_outside_the_map_is_named(start, message):
    with pytest.raises(ArgumentError, match=message):
        Problem(FLAT, start, Budget(5.0))


def test_start_on_a_no_go_cell_is_named():
    score = FLAT.copy()
    score[1:4, 2:5] = np.nan
    score[2, 1] = np.nan
    # Of the cells two steps away only 0,3 and 4,3 are open; the first of equals is named.
    with pytest.raises(ArgumentError, match=r"start cell 2,3 is a no-go cell; .* is cell:0,3$"):
        Problem(score, (2, 3), Budget(5.0))


def test_walled_in_start_is_refused_and_a_diagonal_gap_counts_with_8_neighbours():
    score = walled([[1, 0, 1], [0, 1, 1], [1, 1, 1]])
    with pytest.raises(ArgumentError, match="walled in"):
        Problem(score, (0, 0), Budget(5.0))
    assert Problem(score, (0, 0), Budget(5.0), connectivity=8).start == (0, 0)
    with pytest.raises(ArgumentError, match="walled in"):
        Problem(np.ones((1, 1)), (0, 0), Budget(5.0))


@pytest.mark.parametrize("limit", [0.0, -1.0, 0.5, math.nan, math.inf, 1e308, 2e7])
def test_impossible_budgets_are_refused(limit):
    with pytest.raises(ArgumentError, match="budget"):
        Budget(limit)


@pytest.mark.parametrize("cost", [0.0, 0.5, 3.0, math.nan])
def test_impossible_diagonal_costs_are_refused(cost):
    with pytest.raises(ArgumentError, match="diagonal"):
        Budget(5.0, cost)


@pytest.mark.parametrize(
    "kind",
    [
        {"connectivity": 6},
        {"objective": "best"},
        {"gamma": 0.0},
        {"gamma": 1.1},
        {"gamma": math.nan},
        {"budget": Budget(1.0), "end": (0, 0)},
    ],
)
def test_impossible_parameters_are_refused(kind):
    with pytest.raises(ArgumentError):
        Problem(**{"score": FLAT, "start": (0, 0), "budget": Budget(5.0), **kind})


@pytest.mark.parametrize(("value", "word"), [(-0.1, "negative"), (math.inf, "infinite"), (-math.inf, "infinite")])
def test_scores_that_are_no_scores_are_named(value, word):
    score = FLAT.copy()
    score[1, 2] = value
    with pytest.raises(ArgumentError, match=f"cell 1,2 .*{word}"):
        Problem(score, (0, 0), Budget(5.0))


@pytest.mark.parametrize("score", [np.ones((0, 4)), np.ones(5), np.ones((3, 3), np.int32)])
def test_arrays_that_are_no_maps_are_refused(score):
    with pytest.raises(ArgumentError, match="score map"):
        Problem(score, (0, 0), Budget(5.0))


@pytest.mark.parametrize("change", [{"method": "best"}, {"effort": 0.0}, {"effort": math.nan}, {"samples": 0},
                                    {"seed": -1}])  # fmt: skip
def test_bad_planner_arguments_are_refused(change):
    with pytest.raises(ArgumentError):
        plan(Problem(FLAT, (0, 0), Budget(5.0)), **change)


def test_float32_maps_and_odd_closed_walks():
    found = plan(Problem(FLAT.astype(np.float32), (0, 0), Budget(9.0), end=(0, 0)))
    assert len(found.cells) == 9
    assert found.cells[-1].tolist() == [0, 0]
    assert found.score == pytest.approx(8.0)
