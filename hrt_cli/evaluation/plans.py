"""What plans are worth on a scoremap, computed afresh from their cells, beside the baselines and the bound."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from affine import Affine
from rasterio.crs import CRS

from hrt_cli.artifacts.carriers import json_provenance
from hrt_cli.artifacts.jsonio import read_model
from hrt_cli.artifacts.plan import PlanDocument
from hrt_cli.errors import InputError
from hrt_cli.planning.planner import plan as make_plan
from hrt_cli.planning.planner import score_bound
from hrt_cli.planning.problem import Budget, Problem
from hrt_cli.raster.grid import Grid, require_same_grid
from hrt_cli.raster.scoremap import Scoremap, read_scoremap

BASELINES = ("lawnmower", "rectangle", "greedy", "spiral", "random")


@dataclass(frozen=True)
class Worth:
    """What one walk collects; `fraction_of_bound` is the share of the bound on `score`."""

    score: float
    discounted_score: float
    fraction_of_bound: float


@dataclass(frozen=True)
class PlanComparison:
    """Plans and baselines of one start and budget on one scoremap, with the bound on any of them."""

    plans: dict[str, Worth]
    baselines: dict[str, Worth]
    upper_bound: float


def evaluate_plans(scoremap_path: Path, plan_paths: tuple[Path, ...], *, seed: int = 0) -> PlanComparison:
    """Value plans on a scoremap, beside what a user would do instead.

    Raises
    ------
    InputError
        A file cannot be used; a plan lies on another grid or enters a no-go cell; the plans differ in start, budget,
        neighbours or objective, so that no one bound and baseline could serve them all.
    """
    scoremap = read_scoremap(scoremap_path)
    plans = {path: _read(path, scoremap_path, scoremap) for path in plan_paths}
    first_path, first = next(iter(plans.items()))
    for path, other in plans.items():
        if _task(other) != _task(first):
            raise InputError(path, f"has another start, budget, objective or neighbours than {first_path}")
    problem = Problem(
        scoremap.score,
        first.start,
        Budget(first.budget.cells, 1.0 if first.budget.unit == "steps" else float(np.sqrt(2.0))),
        connectivity=first.connectivity,
        objective=first.objective,
        gamma=first.gamma,
        return_home=first.return_home,
    )
    made = {name: make_plan(problem, name, seed=seed) for name in BASELINES}
    collected = {str(path): _collected(each, scoremap) for path, each in plans.items()}
    # The bounds in the plans may be of another map, or of nobody: this map's is computed from this map.
    best = max([score for score, _ in collected.values()] + [each.score for each in made.values()])
    bound = score_bound(problem, best)

    def worth(score: float, discounted: float) -> Worth:
        return Worth(score, discounted, score / bound if bound > 0 else 1.0)

    return PlanComparison(
        {name: worth(*found) for name, found in collected.items()},
        {name: worth(each.score, each.discounted_score) for name, each in made.items()},
        bound,
    )


def _read(path: Path, scoremap_path: Path, scoremap: Scoremap) -> PlanDocument:
    plan = read_model(path, PlanDocument)
    json_provenance(path)
    grid = Grid(
        plan.grid.rows,
        plan.grid.cols,
        Affine(*plan.grid.transform),
        None if plan.grid.crs is None else CRS.from_user_input(plan.grid.crs),
    )
    require_same_grid(path, grid, scoremap_path, scoremap.grid)
    for row, col in plan.cells:
        if np.isnan(scoremap.score[row, col]):
            raise InputError(path, f"enters cell {row},{col}, which is no-go on {scoremap_path}")
    return plan


def _task(plan: PlanDocument) -> tuple[object, ...]:
    return plan.start, plan.budget, plan.connectivity, plan.objective, plan.gamma, plan.return_home


def _collected(plan: PlanDocument, scoremap: Scoremap) -> tuple[float, float]:
    """Return the score and the discounted score of a walk: each cell pays once, at its first visit."""
    seen: set[tuple[int, int]] = set()
    score = discounted = 0.0
    for step, cell in enumerate(plan.cells):
        if cell not in seen:
            seen.add(cell)
            score += float(scoremap.score[cell])
            discounted += plan.gamma**step * float(scoremap.score[cell])
    return score, discounted
