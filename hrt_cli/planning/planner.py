"""Plan walks of one robot or several: one function for every method, with the score, its proven bound and its gap."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hrt_cli.errors import ArgumentError
from hrt_cli.planning import baselines
from hrt_cli.planning.bounds import Bounds, prove_bounds
from hrt_cli.planning.features import build_blocks
from hrt_cli.planning.policy import Policy, default_policies, roll_best, roll_many
from hrt_cli.planning.problem import Plan, Problem, TeamPlan
from hrt_cli.planning.refine import COLDEST, HOTTEST, TIE, anneal, widen
from hrt_cli.planning.tours import Cut, cut_regions, follow
from hrt_cli.planning.walk import (
    Field,
    build_field,
    capacity,
    count_turns,
    fit,
    join_fields,
    team_value,
    to_cells,
    to_path,
    walk_value,
)
from hrt_cli.progress import Progress, silent

METHODS = ("refined", "policy", "policy-sample", "rectangle", "greedy", "lawnmower", "spiral", "random")
"""Every method of `plan`, the default first."""

MOST_ROBOTS = 64
"""Robots that one plan is made for at most."""

POLICY_WALKS = 4
"""Sampled rollouts that are annealed, besides the walks of the other methods."""

ROUNDS = ((0.35, 1.0, 12), (0.3, 0.6, 3), (0.35, 0.4, 2))
"""Of each round of annealing: share of the changes, first temperature relative to `HOTTEST`, walks at most."""

LONGEST_WIDENED = 20_000
"""Moves above which a tour of regions is not widened by its best detours one by one."""

PROPOSALS_PER_MOVE = 4000
"""Changes proposed per move of the budget over all walks and both rounds, at effort 1."""

MOST_PROPOSALS = 20_000_000
"""Changes proposed at most at effort 1, however long the walk."""

DISCOUNTED_MOVES = 500
"""Moves of all robots above which a discounted plan is changed less often: each change is valued along the walk."""

DISCOUNTED_SHARE = 0.6
"""Share of the changes proposed where the score is discounted: they cost more to value."""

TIDY_SHARE = 0.1
"""Changes of the straightening pass, relative to the annealing."""

BOUND_ITERATIONS = 50
"""Subgradient steps of the Lagrangian bound at effort 1."""

MOST_SAMPLED_MOVES = 4_000_000
"""Moves of all sampled rollouts together; above it fewer walks are sampled."""

MOST_REREAD_MOVES = 800_000_000
"""The same, times the moves of a walk, for features that go over all of the walk at every move."""

FEWEST_SAMPLED = 8
"""Walks that are sampled all the same, however long."""

THREADS = 2
"""Walks annealed and levels cut at the same time; the answer does not depend on it."""

Walk = NDArray[np.int64]
Team = list[Walk]
"""One walk per robot."""


class _Bench:
    """The robots' fields on one window; values their walks and counts what was tried."""

    def __init__(self, problems: Sequence[Problem]) -> None:
        self.fields, self.joint = join_fields([build_field(problem) for problem in problems])
        self.gamma = problems[0].gamma if problems[0].objective == "discounted" else 1.0
        self.limits = np.array([field.limit for field in self.fields])
        self.cells = max(capacity(field) for field in self.fields)
        self.evaluations = 0
        self._seen = np.zeros(self.joint.free.size, np.bool_)

    def value(self, team: Team, gamma: float | None = None) -> float:
        """Return what the walks of all robots are worth together, by the objective or by another discount."""
        paths, sizes = self.pack(team)
        return float(team_value(self.joint.value, paths, sizes, self.gamma if gamma is None else gamma, self._seen))

    def pack(self, team: Team) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the walks as rows of one array, int64 [robots, cells], and their lengths."""
        paths = np.zeros((len(team), self.cells), np.int64)
        for row, walk in zip(paths, team, strict=True):
            row[: walk.size] = walk
        return paths, np.array([walk.size for walk in team], np.int64)

    def left_over(self, robot: int, team: Team) -> Field:
        """Return the field of a robot on which the cells of the walks of `team` pay nothing more."""
        value = self.joint.value.copy()
        for walk in team:
            value[walk] = 0.0
        return self.fields[robot]._replace(value=value)

    def in_turn(self, walk: Callable[[Field], Walk]) -> Team:
        """Return walks made one after the other, each on what the others leave."""
        team: Team = []
        for robot in range(len(self.fields)):
            team.append(walk(self.left_over(robot, team)))
        self.evaluations += len(team)
        return team

    @staticmethod
    def is_whole(walk: Walk, field: Field) -> bool:
        """Tell whether a walk spends a budget of moves exactly, as every walk must whose moves all cost 1."""
        return not field.exact or walk.size == capacity(field)

    def best(self, teams: Sequence[Team]) -> Team:
        """Return the walks of the highest value; among equals, those with the fewest turns."""
        values = [self.value(team) for team in teams]
        floor = max(values) * (1.0 - TIE)
        equals = [team for team, value in zip(teams, values, strict=True) if value >= floor]
        return min(equals, key=lambda team: sum(int(count_turns(walk, walk.size)) for walk in team))

    def distinct(self, teams: Sequence[Team], count: int) -> list[Team]:
        """Return the `count` best that differ in the cells they visit, the best first."""
        kept: list[Team] = []
        cells: list[list[set[int]]] = []
        for team in sorted(teams, key=self.value, reverse=True):
            visited = [set(walk.tolist()) for walk in team]
            if visited not in cells:
                kept.append(team)
                cells.append(visited)
            if len(kept) == count:
                break
        return kept


def plan(
    problem: Problem,
    method: str = "refined",
    policies: Sequence[Policy] | None = None,
    effort: float = 1.0,
    samples: int = 256,
    seed: int = 0,
    progress: Progress = silent,
) -> Plan:
    """Return a walk for `problem` made by `method`, with its value and a proven bound.

    Parameters
    ----------
    problem : Problem
        The map, the start and the budget.
    method : str
        One of `METHODS`. 'policy' takes the likeliest move each time, 'policy-sample' the best of `samples`
        rollouts; 'refined' anneals the best walks of the policies, the rectangle and the greedy method, and tours of
        the rich regions.
    policies : sequence of Policy, optional
        The policies of the methods that use any, which give the best walk of them all; the shipped ones by default.
    effort : float
        Multiplies the changes 'refined' proposes and the steps spent on the bound; > 0.
    samples : int
        Rollouts sampled from the policies, shared out among them.
    seed : int
        Random seed, >= 0.
    progress : Progress
        Called with (stages done, stages).

    Raises
    ------
    ArgumentError
        When the method is unknown, a number is out of its range, or the end cannot be reached.
    """
    return plan_team([problem], method, policies, effort, samples, seed, progress).together


def plan_team(
    problems: Sequence[Problem],
    method: str = "refined",
    policies: Sequence[Policy] | None = None,
    effort: float = 1.0,
    samples: int = 256,
    seed: int = 0,
    progress: Progress = silent,
) -> TeamPlan:
    """Return one walk for each of `problems`, which differ in start, end and budget only; a cell pays once.

    'refined' anneals all walks together; the other methods plan the robots one after the other, each on what the
    others leave. Other arguments as for `plan`.
    """
    _check_arguments(problems, method, effort, samples, seed)
    started = time.perf_counter()
    bench = _Bench(problems)
    chosen = _chosen(policies)
    progress(0, 4)
    discounted = problems[0].objective == "discounted"
    cuts = _cuts(bench, problems[0])
    progress(1, 4)
    team = _walks(bench, method, chosen, cuts, effort, samples, seed, progress)
    progress(3, 4)
    gamma = problems[0].gamma
    score, worth = bench.value(team, 1.0), bench.value(team, gamma)
    iterations = max(1, round(BOUND_ITERATIONS * effort))
    bounds = prove_bounds(bench.fields, bench.joint, cuts, score, gamma if discounted else None, worth, iterations)
    progress(4, 4)
    together = Plan(
        cells=to_cells(bench.joint, team[0]),
        score=score,
        discounted_score=worth,
        upper_bound=bounds.score,
        gap=_gap(score, bounds.score),
        discounted_upper_bound=bounds.discounted,
        discounted_gap=None if bounds.discounted is None else _gap(worth, bounds.discounted),
        method=method,
        seconds=time.perf_counter() - started,
        evaluations=bench.evaluations,
    )
    return TeamPlan(together, [to_cells(bench.joint, walk) for walk in team], _shares(bench.joint, team))


def plans_alone(problems: Sequence[Problem], found: TeamPlan) -> list[Plan]:
    """Return the plan of each robot of a team as if it were alone: its own scores, and its own bounds."""
    plans = []
    for problem, cells in zip(problems, found.cells, strict=True):
        bench = _Bench([problem])
        walk = to_path(bench.joint, cells)
        score, worth = bench.value([walk], 1.0), bench.value([walk], problem.gamma)
        bounds = bound_of([problem], score, worth if problem.objective == "discounted" else None)
        plans.append(
            replace(
                found.together,
                cells=cells,
                score=score,
                discounted_score=worth,
                upper_bound=bounds.score,
                gap=_gap(score, bounds.score),
                discounted_upper_bound=bounds.discounted,
                discounted_gap=None if bounds.discounted is None else _gap(worth, bounds.discounted),
            )
        )
    return plans


def _shares(field: Field, team: Team) -> list[float]:
    """Return the score of the cells that each robot is the first to visit."""
    seen: set[int] = set()
    shares = [0.0] * len(team)
    for t in range(max(walk.size for walk in team)):
        for robot, walk in enumerate(team):
            if t < walk.size and int(walk[t]) not in seen:
                seen.add(int(walk[t]))
                shares[robot] += float(field.value[walk[t]])
    return shares


def _check_arguments(problems: Sequence[Problem], method: str, effort: float, samples: int, seed: int) -> None:
    if not 1 <= len(problems) <= MOST_ROBOTS:
        raise ArgumentError(f"plans are made for 1 to {MOST_ROBOTS} robots, not {len(problems)}")
    first = problems[0]
    for other in problems[1:]:
        same = _task(other) == _task(first)
        if other.score is not first.score or not same:
            raise ArgumentError(
                "robots of one team need the same map, neighbours, objective and unit of budget, and all or none an end"
            )
    if method not in METHODS:
        raise ArgumentError(f"unknown method {method!r} (one of: {', '.join(METHODS)})")
    if not (math.isfinite(effort) and effort > 0):
        raise ArgumentError(f"the effort must be a positive number, not {effort}")
    if samples < 1:
        raise ArgumentError(f"at least one rollout must be sampled, not {samples}")
    if seed < 0:
        raise ArgumentError(f"the seed must not be negative, not {seed}")


def _task(problem: Problem) -> tuple[object, ...]:
    """Return what the problems of one team have in common."""
    return problem.connectivity, problem.objective, problem.gamma, problem.counts_moves, problem.end is None


def bound_of(problems: Sequence[Problem], score: float, discounted_score: float | None = None) -> Bounds:
    """Return proven bounds for `problems` where walks of a known score (and discounted score) exist."""
    bench = _Bench(problems)
    early = discounted_score is not None
    cuts = cut_regions(bench.fields, bench.joint, early, THREADS)
    gamma = problems[0].gamma if early else None
    return prove_bounds(bench.fields, bench.joint, cuts, score, gamma, discounted_score or 0.0, BOUND_ITERATIONS)


def find_walks(
    problems: Sequence[Problem],
    method: str = "refined",
    policies: Sequence[Policy] | None = None,
    effort: float = 1.0,
    samples: int = 256,
    seed: int = 0,
) -> list[NDArray[np.int32]]:
    """Return the cells, int32 [T + 1, 2], of the walks that `plan_team` makes, without the time its bounds take.

    Raises
    ------
    ArgumentError
        As `plan_team`.
    """
    _check_arguments(problems, method, effort, samples, seed)
    bench = _Bench(problems)
    chosen = _chosen(policies)
    cuts = _cuts(bench, problems[0]) if method == "refined" else []
    team = _walks(bench, method, chosen, cuts, effort, samples, seed, silent)
    return [to_cells(bench.joint, walk) for walk in team]


def _cuts(bench: _Bench, problem: Problem) -> list[Cut]:
    return cut_regions(bench.fields, bench.joint, problem.objective == "discounted", THREADS)


def _gap(value: float, bound: float) -> float:
    """Return 1 - value / bound; rounding must not make it negative."""
    return max(0.0, 1.0 - value / bound) if bound > 0 else 0.0


def _walks(
    bench: _Bench,
    method: str,
    policies: Sequence[Policy],
    cuts: Sequence[Cut],
    effort: float,
    samples: int,
    seed: int,
    progress: Progress,
) -> Team:
    gamma = bench.gamma
    walkers: dict[str, Callable[[Field], Walk]] = {
        "rectangle": lambda field: baselines.rectangle(field, gamma, seed),
        "greedy": lambda field: baselines.greedy_walk(field, seed),
        "lawnmower": lambda field: baselines.lawnmower(field, seed),
        "spiral": lambda field: baselines.spiral(field, seed),
        "random": lambda field: baselines.random_walk(field, seed),
        "policy": lambda field: _ranked(bench, field, _likeliest(field, policies, seed))[0],
        "policy-sample": lambda field: _sampled(bench, field, policies, samples, seed)[0],
    }
    if method in walkers:
        return bench.in_turn(walkers[method])
    teams = [bench.in_turn(walkers[name]) for name in ("policy", "rectangle", "greedy")]
    if len(bench.fields) == 1:
        teams += [[walk] for walk in _sampled(bench, bench.joint, policies, samples, seed)[:POLICY_WALKS]]
    else:
        teams.append(bench.in_turn(walkers["policy-sample"]))
    horizon = None if gamma == 1.0 else min(bench.cells - 1, math.ceil(1.0 / (1.0 - gamma)))
    tours = [_tour(bench, cut, horizon, seed) for cut in cuts]
    teams += [team for team in tours if all(map(bench.is_whole, team, bench.fields))]
    progress(2, 4)
    return _refine(bench, teams, effort, seed)


def _chosen(policies: Sequence[Policy] | None) -> Sequence[Policy]:
    chosen = default_policies() if policies is None else policies
    if not chosen:
        raise ArgumentError("at least one policy is needed")
    return chosen


def _likeliest(field: Field, policies: Sequence[Policy], seed: int) -> list[Walk]:
    """Return the walk of each policy that takes its likeliest move each time."""
    return [roll_best(field, build_blocks(field, policy.layout), policy.weights, seed) for policy in policies]


def _sampled(bench: _Bench, field: Field, policies: Sequence[Policy], samples: int, seed: int) -> list[Walk]:
    """Return sampled rollouts and the likeliest, the best first."""
    count = min(samples, max(FEWEST_SAMPLED, int(MOST_SAMPLED_MOVES / field.limit)))
    walks = _likeliest(field, policies, seed)
    for index, policy in enumerate(policies):
        share = len(range(index, count, len(policies)))
        blocks = build_blocks(field, policy.layout)
        if blocks.far.size:
            share = min(share, max(FEWEST_SAMPLED, int(MOST_REREAD_MOVES / field.limit**2)))
        paths, lengths = roll_many(field, blocks, policy.weights, share, seed)
        walks += [paths[i, : lengths[i]] for i in range(share)]
    bench.evaluations += len(walks)
    return _ranked(bench, field, walks)


def _ranked(bench: _Bench, field: Field, walks: Sequence[Walk]) -> list[Walk]:
    """Return walks of one robot, the best first."""
    seen = np.zeros(field.free.size, np.bool_)
    values = np.array([walk_value(field.value, walk, walk.size, bench.gamma, seen) for walk in walks])
    return [walks[i] for i in np.argsort(-values, kind="stable")]


def _tour(bench: _Bench, cut: Cut, horizon: int | None, seed: int) -> Team:
    """Return walks through the rich regions in the order of the paths that are worth the bound."""
    orders, price = cut.orders(horizon)
    team: Team = []
    for robot, order in enumerate(orders):
        field = bench.left_over(robot, team)
        way = follow(bench.joint, field.start, cut.label, cut.group, order, price, capacity(field))
        walk = fit(field, way)
        if field.limit <= LONGEST_WIDENED:
            walk = widen(field, field.limit, walk)
        team.append(np.asarray(baselines.spend_rest(field, walk, seed)))
    bench.evaluations += len(team)
    return team


def _refine(bench: _Bench, teams: list[Team], effort: float, seed: int) -> Team:
    """Anneal all walks a little, the best ones further, then straighten the winner without cost."""
    total = float(bench.limits.sum())
    proposals = min(PROPOSALS_PER_MOVE * total, MOST_PROPOSALS) * effort
    if bench.gamma != 1.0:
        proposals *= DISCOUNTED_SHARE * min(1.0, DISCOUNTED_MOVES / total)
    heat = float(np.mean([bench.joint.value[walk].mean() for team in teams for walk in team]))
    if min(walk.size for team in teams for walk in team) < 2 or heat <= 0.0:
        return bench.best(teams)

    def anneal_one(team: Team, changes: int, hot: float, cold: float, tidy: bool, salt: int) -> Team:
        paths, sizes = anneal(bench.joint, bench.limits, *bench.pack(team), bench.gamma, changes, hot, cold, tidy, salt)
        walks = [path[:size] for path, size in zip(paths, sizes, strict=True)]
        done: Team = []
        for robot, walk in enumerate(walks):
            field = bench.left_over(robot, done + walks[robot + 1 :])
            done.append(np.asarray(baselines.spend_rest(field, walk, seed)))
        bench.evaluations += changes
        return done

    found = teams
    with ThreadPoolExecutor(THREADS) as pool:
        for turn, (share, warmth, most) in enumerate(ROUNDS):
            # Tours of regions collect little before they are annealed: the first round takes every kind.
            starts = teams[:most] if turn == 0 else bench.distinct(found, most)
            changes = max(1, int(proposals * share / len(starts)))
            hot, cold = HOTTEST * warmth * heat, COLDEST * heat
            jobs = [
                pool.submit(anneal_one, team, changes, hot, cold, False, seed * 1_000_003 + turn * 1009 + index)
                for index, team in enumerate(starts)
            ]
            found = found + [job.result() for job in jobs]
    winner = bench.best(found)
    return bench.best([winner, anneal_one(winner, max(1, int(proposals * TIDY_SHARE)), 0.0, 0.0, True, seed)])
