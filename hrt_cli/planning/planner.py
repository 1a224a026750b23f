"""Plan a walk: one function for every method, with its score, its proven bound and its gap."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hrt_cli.errors import ArgumentError
from hrt_cli.planning import baselines
from hrt_cli.planning.bounds import upper_bound
from hrt_cli.planning.features import build_blocks
from hrt_cli.planning.policy import Policy, default_policy, roll_best, roll_many
from hrt_cli.planning.problem import Plan, Problem
from hrt_cli.planning.refine import COLDEST, HOTTEST, TIE, anneal
from hrt_cli.planning.walk import Field, build_field, count_turns, to_cells, walk_value
from hrt_cli.progress import Progress, silent

METHODS = ("refined", "policy", "policy-sample", "rectangle", "greedy", "lawnmower", "spiral", "random")
"""Every method of `plan`, the default first."""

SEED_WALKS = 4
"""Distinct walks that are annealed in the first round."""

FINAL_WALKS = 2
"""Walks of the first round that are annealed further."""

PROPOSALS_PER_MOVE = 4000
"""Changes proposed per move of the budget over all walks and both rounds, at effort 1."""

MOST_PROPOSALS = 20_000_000
"""Changes proposed at most at effort 1, however long the walk."""

DISCOUNTED_MOVES = 250
"""Budget above which fewer changes are proposed for a discounted plan: each is valued along the whole walk."""

FIRST_SHARE = 0.5
"""Share of the changes spent in the first round."""

REHEAT = 0.4
"""Starting temperature of the second round relative to the first."""

TIDY_SHARE = 0.1
"""Changes of the straightening pass, relative to the annealing."""

BOUND_ITERATIONS = 50
"""Subgradient steps of the Lagrangian bound at effort 1."""

MOST_SAMPLED_MOVES = 4_000_000
"""Moves of all sampled rollouts together; above it fewer walks are sampled."""

THREADS = 2
"""Walks annealed at the same time; the answer does not depend on it."""

Walk = NDArray[np.int64]


@dataclass
class _Bench:
    """Values walks of one problem and counts what was tried."""

    field: Field
    gamma: float
    evaluations: int = 0

    def __post_init__(self) -> None:
        self._seen = np.zeros(self.field.free.size, np.bool_)

    def value(self, walk: Walk) -> float:
        """Return the objective of a walk."""
        return float(walk_value(self.field.value, walk, walk.size, self.gamma, self._seen))

    def best(self, walks: list[Walk]) -> Walk:
        """Return the walk of the highest value; among equals, the one with the fewest turns."""
        values = [self.value(walk) for walk in walks]
        floor = max(values) * (1.0 - TIE)
        equals = [walk for walk, value in zip(walks, values, strict=True) if value >= floor]
        return min(equals, key=lambda walk: int(count_turns(walk, walk.size)))


def plan(
    problem: Problem,
    method: str = "refined",
    policy: Policy | None = None,
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
        rollouts; 'refined' anneals the best walks of the policy, the rectangle and the greedy method.
    policy : Policy, optional
        The policy of the methods that use one; the shipped one by default.
    effort : float
        Multiplies the changes 'refined' proposes and the steps spent on the bound; > 0.
    samples : int
        Rollouts sampled from the policy.
    seed : int
        Random seed, >= 0.
    progress : Progress
        Called with (stages done, stages).

    Raises
    ------
    ArgumentError
        When the method is unknown or a number is out of its range.
    """
    _check_arguments(method, effort, samples, seed)
    started = time.perf_counter()
    field = build_field(problem)
    gamma = problem.gamma if problem.objective == "discounted" else 1.0
    bench = _Bench(field, gamma)
    progress(0, 3)
    walk = _walk(bench, method, policy, effort, samples, seed, progress)
    progress(2, 3)
    value = bench.value(walk)
    score = value if gamma == 1.0 else _Bench(field, 1.0).value(walk)
    iterations = max(1, round(BOUND_ITERATIONS * effort))
    bound = upper_bound(field, score, 1.0, iterations)
    discounted_bound = None if problem.objective == "total" else upper_bound(field, value, gamma, iterations)
    progress(3, 3)
    return Plan(
        cells=to_cells(field, walk),
        score=score,
        discounted_score=_Bench(field, problem.gamma).value(walk),
        upper_bound=bound,
        gap=_gap(score, bound),
        discounted_upper_bound=discounted_bound,
        discounted_gap=None if discounted_bound is None else _gap(value, discounted_bound),
        method=method,
        seconds=time.perf_counter() - started,
        evaluations=bench.evaluations,
    )


def _check_arguments(method: str, effort: float, samples: int, seed: int) -> None:
    if method not in METHODS:
        raise ArgumentError(f"unknown method {method!r} (one of: {', '.join(METHODS)})")
    if not (math.isfinite(effort) and effort > 0):
        raise ArgumentError(f"the effort must be a positive number, not {effort}")
    if samples < 1:
        raise ArgumentError(f"at least one rollout must be sampled, not {samples}")
    if seed < 0:
        raise ArgumentError(f"the seed must not be negative, not {seed}")


def score_bound(problem: Problem, value: float) -> float:
    """Return a proven bound on the score of any walk of `problem`; `value` is the best score known of one."""
    return upper_bound(build_field(problem), value, 1.0, BOUND_ITERATIONS)


def _gap(value: float, bound: float) -> float:
    """Return 1 - value / bound; rounding must not make it negative."""
    return max(0.0, 1.0 - value / bound) if bound > 0 else 0.0


def _walk(
    bench: _Bench,
    method: str,
    policy: Policy | None,
    effort: float,
    samples: int,
    seed: int,
    progress: Progress,
) -> Walk:
    field = bench.field
    simple: dict[str, Callable[[], Walk]] = {
        "rectangle": lambda: baselines.rectangle(field, bench.gamma, seed),
        "greedy": lambda: baselines.greedy_walk(field, seed),
        "lawnmower": lambda: baselines.lawnmower(field, seed),
        "spiral": lambda: baselines.spiral(field, seed),
        "random": lambda: baselines.random_walk(field, seed),
    }
    if method in simple:
        bench.evaluations += 1
        return simple[method]()
    chosen = default_policy() if policy is None else policy
    if method == "policy":
        return _likeliest(bench, chosen, seed)
    sampled = _sampled(bench, chosen, samples, seed)
    if method == "policy-sample":
        return bench.best([sampled[0], _likeliest(bench, chosen, seed)])
    progress(1, 3)
    others = [_likeliest(bench, chosen, seed), simple["rectangle"](), simple["greedy"]()]
    return _refine(bench, sampled[: SEED_WALKS * 2] + others, effort, seed)


def _likeliest(bench: _Bench, policy: Policy, seed: int) -> Walk:
    bench.evaluations += 1
    path, n = roll_best(bench.field, build_blocks(bench.field, policy.layout), policy.weights, seed)
    return np.asarray(path[:n])


def _sampled(bench: _Bench, policy: Policy, samples: int, seed: int) -> list[Walk]:
    """Return sampled rollouts, the best first."""
    field = bench.field
    count = min(samples, max(8, int(MOST_SAMPLED_MOVES / field.limit)))
    blocks = build_blocks(field, policy.layout)
    paths, lengths = roll_many(field, blocks, policy.weights, count, seed)
    walks = [paths[i, : lengths[i]] for i in range(count)]
    bench.evaluations += count
    values = np.array([bench.value(walk) for walk in walks])
    return [walks[i] for i in np.argsort(-values, kind="stable")]


def _distinct(bench: _Bench, walks: list[Walk], count: int) -> list[Walk]:
    """Return the `count` best walks that differ in the cells they visit, the best first."""
    kept: list[Walk] = []
    sets: list[set[int]] = []
    for walk in sorted(walks, key=bench.value, reverse=True):
        cells = set(walk.tolist())
        if all(cells != other for other in sets):
            kept.append(walk)
            sets.append(cells)
        if len(kept) == count:
            break
    return kept


def _refine(bench: _Bench, walks: list[Walk], effort: float, seed: int) -> Walk:
    """Anneal the best walks in two rounds, then straighten the winner without cost."""
    field = bench.field
    if min(walk.size for walk in walks) < 2:
        return bench.best(walks)
    proposals = min(PROPOSALS_PER_MOVE * field.limit, MOST_PROPOSALS) * effort
    if bench.gamma < 1.0:
        proposals *= min(1.0, DISCOUNTED_MOVES / field.limit)
    heat = float(np.mean([field.value[walk].mean() for walk in walks]))
    if heat <= 0.0:
        return bench.best(walks)

    def round_of(starts: list[Walk], share: float, warmth: float, salt: int) -> list[Walk]:
        each = max(1, int(proposals * share / len(starts)))
        hot, cold = HOTTEST * warmth * heat, COLDEST * heat
        bench.evaluations += each * len(starts)

        def one(job: tuple[int, Walk]) -> Walk:
            start_seed = seed * 1_000_003 + salt * 1009 + job[0]
            walk = anneal(field, job[1], bench.gamma, each, hot, cold, False, start_seed)
            return np.asarray(baselines.spend_rest(field, walk, seed))

        with ThreadPoolExecutor(THREADS) as pool:
            return list(pool.map(one, enumerate(starts)))

    first = round_of(_distinct(bench, walks, SEED_WALKS), FIRST_SHARE, 1.0, 1)
    second = round_of(_distinct(bench, first, FINAL_WALKS), 1.0 - FIRST_SHARE, REHEAT, 2)
    winner = bench.best(walks + first + second)
    moves = max(1, int(proposals * TIDY_SHARE))
    bench.evaluations += moves
    tidied = anneal(field, winner, bench.gamma, moves, 0.0, 0.0, True, seed)
    return bench.best([winner, np.asarray(baselines.spend_rest(field, tidied, seed))])
