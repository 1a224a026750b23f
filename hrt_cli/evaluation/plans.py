"""What plans are worth on a scoremap, computed afresh from their cells, beside other methods and the bound."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from hrt_cli.artifacts.plan import PlanDocument, read_plan, team_members
from hrt_cli.errors import ArgumentError, InputError
from hrt_cli.evaluation.rewards import Curve, RewardChart, team_reward
from hrt_cli.evaluation.starts import StartsComparison, compare_over_starts, draw_starts, task_bounds
from hrt_cli.planning.planner import find_walks
from hrt_cli.planning.policy import default_policies_sha256
from hrt_cli.planning.problem import Budget, Problem
from hrt_cli.planning.resume import mark_driven
from hrt_cli.progress import Progress, silent
from hrt_cli.raster.grid import require_same_grid
from hrt_cli.raster.scoremap import Scoremap, read_scoremap
from hrt_cli.raster.track import plan_grid

PLANNERS = ("refined", "policy")
BASELINES = ("lawnmower", "rectangle", "greedy", "spiral", "random")

_Walks = list[NDArray[np.int32]]
"""The walks of a team, int32 [T + 1, 2] each."""


@dataclass(frozen=True)
class Worth:
    """What a walk, or a team's walks together, collect.

    The fractions are the shares of the bounds on `score` and `discounted_score`.
    """

    score: float
    discounted_score: float
    fraction_of_bound: float
    fraction_of_discounted_bound: float


@dataclass(frozen=True)
class Trials:
    """What plans are compared with.

    Attributes
    ----------
    seed : int
        Seed of every random choice, >= 0.
    planner : bool
        Whether the task is planned afresh, by `PLANNERS`, beside the baselines.
    starts : int
        Starts to draw, 0 for none; see `hrt_cli.evaluation.starts.draw_starts`.
    seeds : int
        Runs of each method from each of these starts, >= 1.
    """

    seed: int = 0
    planner: bool = True
    starts: int = 0
    seeds: int = 1

    @property
    def methods(self) -> tuple[str, ...]:
        """The methods that are run."""
        return (PLANNERS if self.planner else ()) + BASELINES

    def parameters(self) -> dict[str, Any]:
        """Return all that changes the results besides the files, as JSON values."""
        return {
            "methods": list(self.methods),
            "policy": default_policies_sha256() if self.planner else None,
            "seed": self.seed,
            "starts": self.starts,
            "seeds": self.seeds,
        }


@dataclass(frozen=True)
class PlanComparison:
    """Plans of one task (starts, budgets) on one scoremap, other walks of that task, and the bounds on any of them.

    Attributes
    ----------
    objective : {'total', 'discounted'}
        What the plans were made for.
    plans, planner, baselines : dict of str to Worth
        By file, and by method; `planner` is empty where the task was not planned afresh.
    upper_bound, discounted_upper_bound : float
        Proven bounds on `score` and `discounted_score` for that task.
    starts : StartsComparison or None
        The methods over other starts, where asked for.
    chart : RewardChart
        Cumulative rewards: of the plans and the methods, or the means over the starts.
    """

    objective: Literal["total", "discounted"]
    plans: dict[str, Worth]
    planner: dict[str, Worth]
    baselines: dict[str, Worth]
    upper_bound: float
    discounted_upper_bound: float
    starts: StartsComparison | None
    chart: RewardChart


def evaluate_plans(
    scoremap_path: Path,
    plan_paths: tuple[Path, ...],
    trials: Trials = Trials(),
    *,
    workers: int = 1,
    progress: Progress = silent,
) -> PlanComparison:
    """Value plans on a scoremap, beside what a user would do instead.

    Each plan is one robot's, or a team's, whose robots' plans stand beside it.

    Raises
    ------
    InputError
        A file cannot be used; a plan lies on another grid or enters a no-go cell; the plans differ in start, budget,
        neighbours or objective, so that no one bound and baseline could serve them all.
    ArgumentError
        More starts are asked for than there are cells to start from, or starts for a team.
    """
    scoremap = read_scoremap(scoremap_path)
    plans = {path: _read(path, scoremap_path, scoremap) for path in plan_paths}
    first_path, team = next(iter(plans.items()))
    for path, other in plans.items():
        if list(map(_task, other)) != list(map(_task, team)):
            raise InputError(path, f"has another start, budget, objective or neighbours than {first_path}")
    if trials.starts and len(team) > 1:
        raise ArgumentError(f"{first_path} is the plan of a team: other starts can be drawn for one robot only")
    problems = _problems(scoremap, team)
    first, problem = team[0], problems[0]
    starts = (
        draw_starts(problem.score, problem.start, problem.connectivity, trials.starts, trials.seed)
        if trials.starts
        else None
    )
    tick = _ticker(progress, len(trials.methods) + 1 + trials.starts * (trials.seeds + 1))
    walks: dict[str, _Walks] = {}
    for name in trials.methods:
        walks[name] = find_walks(problems, name, seed=trials.seed)
        tick()
    given: dict[str, _Walks] = {str(path): [np.array(plan.cells) for plan in plans[path]] for path in plans}
    worth, bounds = _valued(problems, [*given.values(), *walks.values()])
    tick()
    by_plan = dict(zip(given, worth, strict=False))
    by_method = dict(zip(walks, worth[len(given) :], strict=True))
    over = (
        None
        if starts is None
        else compare_over_starts(
            problem, trials.methods, starts, seed=trials.seed, seeds=trials.seeds, workers=workers, tick=tick
        )
    )
    return PlanComparison(
        first.objective,
        by_plan,
        {name: each for name, each in by_method.items() if name in PLANNERS},
        {name: each for name, each in by_method.items() if name in BASELINES},
        *bounds,
        over,
        _mean_chart(problem, first, scoremap, over) if over else _chart(problems, team, scoremap, given, walks, bounds),
    )


def _read(path: Path, scoremap_path: Path, scoremap: Scoremap) -> list[PlanDocument]:
    """Return the plan in a file, or those of the robots of the team in it."""
    team = [_read_one(each, scoremap_path, scoremap) for each in team_members(path) or [path]]
    if any(_shared(plan) != _shared(team[0]) for plan in team):
        raise InputError(path, "is the plan of robots that differ in more than start, end and budget")
    return team


def _read_one(path: Path, scoremap_path: Path, scoremap: Scoremap) -> PlanDocument:
    plan = read_plan(path)
    require_same_grid(path, plan_grid(path, plan), scoremap_path, scoremap.grid)
    left_in = {plan.start} & set(plan.collected)
    for row, col in plan.cells:
        if np.isnan(scoremap.score[row, col]) and (row, col) not in left_in:
            raise InputError(path, f"enters cell {row},{col}, which is no-go on {scoremap_path}")
    return plan


def _task(plan: PlanDocument) -> tuple[object, ...]:
    return plan.start, plan.end, plan.budget, _shared(plan)


def _shared(plan: PlanDocument) -> tuple[object, ...]:
    """Return what the robots of a team have in common."""
    before = tuple(plan.collected), tuple(plan.blocked)
    return plan.connectivity, plan.objective, plan.gamma, plan.budget.unit, before


def _problems(scoremap: Scoremap, team: Sequence[PlanDocument]) -> list[Problem]:
    stands = [plan.start for plan in team if plan.start in plan.collected]
    score = mark_driven(scoremap.score, team[0].collected, team[0].blocked, stands)
    return [
        Problem(
            score,
            plan.start,
            Budget(plan.budget.cells, 1.0 if plan.budget.unit == "steps" else float(np.sqrt(2.0))),
            connectivity=plan.connectivity,
            objective=plan.objective,
            gamma=plan.gamma,
            end=plan.start if plan.return_home else plan.end,
        )
        for plan in team
    ]


def _valued(problems: Sequence[Problem], teams: list[_Walks]) -> tuple[list[Worth], tuple[float, float]]:
    """Value walks of one task; the bounds in the plans may be of another map, or of nobody, so they are not used."""
    score, gamma = problems[0].score, problems[0].gamma
    found = [
        (float(team_reward(score, walks)[1][-1]), float(team_reward(score, walks, gamma)[1][-1])) for walks in teams
    ]
    bounds = task_bounds(problems, max(score for score, _ in found), max(discounted for _, discounted in found))
    shares = [[value / bound if bound > 0 else 1.0 for value, bound in zip(f, bounds, strict=True)] for f in found]
    return [Worth(*values, *share) for values, share in zip(found, shares, strict=True)], bounds


def _ticker(progress: Progress, total: int) -> Callable[[], None]:
    done = 0
    progress(done, total)

    def tick() -> None:
        nonlocal done
        done += 1
        progress(done, total)

    return tick


def _chart(
    problems: Sequence[Problem],
    team: Sequence[PlanDocument],
    scoremap: Scoremap,
    given: dict[str, _Walks],
    walks: dict[str, _Walks],
    bounds: tuple[float, float],
) -> RewardChart:
    problem, plan = problems[0], team[0]
    unit, scale = _unit(plan, scoremap)
    discounted = problem.objective == "discounted"
    gamma = problem.gamma if discounted else 1.0

    def curve(name: str, role: Literal["plan", "planner", "baseline"], walks: _Walks) -> Curve:
        travelled, reward = team_reward(problem.score, walks, gamma, problem.budget.diagonal_cost)
        return Curve(name, role, travelled * scale, reward)

    row, col = problem.start
    where = f"from cell {row},{col}{_home(plan)}" if len(team) == 1 else f"for each of {len(team)} robots"
    return RewardChart(
        f"cumulative reward, {_budget(plan)} {where}",
        unit,
        max(each.limit for each in problems) * scale,
        discounted,
        bounds[1 if discounted else 0],
        [curve(name, "plan", cells) for name, cells in given.items()]
        + [curve(name, _role(name), cells) for name, cells in walks.items()],
    )


def _mean_chart(problem: Problem, plan: PlanDocument, scoremap: Scoremap, found: StartsComparison) -> RewardChart:
    unit, scale = _unit(plan, scoremap)
    runs = f"{found.count} starts" + (f" and {found.seeds} seeds" if found.seeds > 1 else "")
    return RewardChart(
        f"cumulative reward, {_budget(plan)}{_home(plan)}: mean over {runs}; bands: 5 to 95 % of the starts",
        unit,
        problem.limit * scale,
        problem.objective == "discounted",
        found.bound,
        [
            Curve(name, _role(name), found.travelled * scale, each.mean, each.low, each.high)
            for name, each in found.curves.items()
        ],
    )


def _unit(plan: PlanDocument, scoremap: Scoremap) -> tuple[Literal["steps", "m"], float]:
    """Return the unit that travel is shown in, and how many of it one cell is."""
    return ("steps", 1.0) if plan.budget.unit == "steps" else ("m", scoremap.cell_size_m)


def _role(method: str) -> Literal["planner", "baseline"]:
    return "planner" if method in PLANNERS else "baseline"


def _budget(plan: PlanDocument) -> str:
    return f"{plan.budget.value:g} {plan.budget.unit}"


def _home(plan: PlanDocument) -> str:
    return " and back" if plan.return_home else ""
