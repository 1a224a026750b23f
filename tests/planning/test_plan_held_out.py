"""What the shipped planner reaches on maps of families that it was never trained on, one of each."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from hrt_cli.planning.planner import plan
from hrt_cli.planning.problem import Budget, Problem

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
from planning_maps import HELD_OUT, held_out

METHODS = ("lawnmower", "greedy", "rectangle", "policy", "refined")


@pytest.fixture(scope="module")
def worth() -> dict[str, np.ndarray]:
    """Score of each method and the bound, one entry per family."""
    found: dict[str, list[float]] = {name: [] for name in (*METHODS, "bound", "best cells")}
    for family in HELD_OUT:
        score, start = held_out(family, 1)
        problem = Problem(score, start, Budget(250.0))
        for method in METHODS:
            made = plan(problem, method, effort=1.0 if method == "refined" else 0.02)
            found[method].append(made.score)
        found["bound"].append(made.upper_bound)
        found["best cells"].append(float(np.sort(score[~np.isnan(score)])[-251:].sum()))
    return {name: np.array(values) for name, values in found.items()}


def test_refined_plans_come_close_to_the_bound(worth: dict[str, np.ndarray]) -> None:
    share = worth["refined"] / worth["bound"]
    assert share.mean() > 0.96
    assert share.min() > 0.88
    assert np.all(worth["refined"] >= worth["rectangle"])
    assert (worth["refined"] / worth["best cells"]).sum() > 1.15 * (worth["rectangle"] / worth["best cells"]).sum()


def test_the_policy_alone_beats_greedy_and_lawnmower(worth: dict[str, np.ndarray]) -> None:
    of_best = {name: (worth[name] / worth["best cells"]).mean() for name in METHODS}
    assert of_best["policy"] > 1.2 * of_best["greedy"]
    assert of_best["policy"] > 2.5 * of_best["lawnmower"]
